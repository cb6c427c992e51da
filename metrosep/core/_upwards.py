"""The one place where objects of the core reach for what lies above it, when they are asked to.

`Surface.explore` and `Profile.explore` are short for `metrosep.app.notebook.explore`. The core
imports nothing from above: the module is loaded by its name, at the call.
"""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["explored"]


def explored(obj: object, options: dict[str, Any]) -> Any:
    """Return the widget of a notebook that shows an object."""
    return importlib.import_module("metrosep.app.notebook").explore(obj, **options)
