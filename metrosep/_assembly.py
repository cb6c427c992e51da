"""The top of the house: what objects of the core can do by upper layers is attached here.

Nothing is loaded before it is used.
"""

from __future__ import annotations

from typing import Any

from metrosep.core.attached import attached

__all__: list[str] = []


def _explore(obj: Any, /, **options: Any) -> Any:
    from metrosep.app.notebook import explore

    return explore(obj, **options)


attached.explore = _explore
attached.method_packages = ("metrosep.separation", "metrosep.recipe")
