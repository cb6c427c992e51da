"""What ``[input]`` of a recipe tells the readers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["reading_options"]

_COLUMNS = ("x", "z", "feed", "time")


def reading_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a reader for the keys of ``[input]``.

    Examples
    --------
    >>> reading_options({"files": ["a.csv"], "x": {"column": "X", "unit": "mm"}, "z": "z_um"})
    {'x': ('X', 'mm'), 'z': 'z_um'}
    """
    options = {k: v for k, v in given.items() if k != "files"}
    for key in _COLUMNS:
        value = options.get(key)
        if isinstance(value, Mapping):
            if "scale" in value:
                options["scale"] = value["scale"]
            options[key] = (value["column"], value["unit"]) if "unit" in value else value["column"]
    return options
