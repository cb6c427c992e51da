"""What objects of the core do by upper layers: a place for each, which the top fills.

The core imports nothing from above, not even by a string; `metrosep._assembly` sets these once,
when the package is imported.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol


class Explore(Protocol):
    """Show an object in a notebook, and return the widget."""

    def __call__(self, obj: Any, /, **options: Any) -> Any:
        """Return the widget that shows an object."""


class _Attached:
    explore: Explore
    plot: Callable[..., Any]  # draw an object into axes
    to_frame: Callable[[Any], Any]  # a data frame of an object
    to_xarray: Callable[[Any], Any]
    save: Callable[[Any, Any], Any]  # an object into a file
    load_document: Callable[[Any], Any]  # a result of its result.json
    verbs: Mapping[str, Callable[..., Any]]  # what maps and profiles do by upper layers, by name
    # packages whose ``METHODS`` recipes, the command line and `separate` know by name
    method_packages: tuple[str, ...]


attached = _Attached()
