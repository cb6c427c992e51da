"""What the page shows of a measurement, in the table ``[view]`` of its recipe: runs ignore it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from metrosep.core.errors import DataError

__all__ = ["VIEW_KEYS", "checked_view", "shown_view", "view_of", "with_view"]

VIEW_KEYS = ("tab", "colours", "hill_shade", "section_mm", "section_px", "band_mm")
"""Tab, colours of the map, hill-shade, ends of the section, limits of the band of wavelengths."""

_FARTHEST = 1e9
"""No machine is larger, mm; pixels neither."""


def checked_view(given: Any) -> dict[str, Any]:
    """Return what the page wants to be remembered, or refuse it."""
    if not isinstance(given, Mapping):
        raise DataError("view is an object of what is shown")
    unknown = [k for k in given if k not in VIEW_KEYS]
    if unknown:
        raise DataError(f"there is no view key {unknown[0]!r}; there are {', '.join(VIEW_KEYS)}")
    found = {k: v for k, v in given.items() if v is not None}
    for key, value in found.items():
        if not _fits(key, value):
            raise DataError(f"view: {key} = {value!r} is not what belongs there")
    return found


def shown_view(view: object) -> dict[str, Any]:
    """Return what the page can show of a table ``[view]``, which may have been written by hand.

    Examples
    --------
    >>> shown_view({"tab": "report", "section_mm": [1, 2], "band_mm": [2, -1]})
    {'tab': 'report'}
    """
    if not isinstance(view, Mapping):
        return {}
    return {k: v for k, v in view.items() if k in VIEW_KEYS and _fits(k, v)}


def _fits(key: str, value: Any) -> bool:
    if key in ("tab", "colours"):
        return isinstance(value, str) and len(value) <= 40 and value.isprintable()
    if key == "hill_shade":
        return isinstance(value, bool)
    if key == "band_mm":
        return _numbers(value) and 0 < value[0] < value[1]
    two = isinstance(value, list) and len(value) == 2 and all(_numbers(end) for end in value)
    return two and value[0] != value[1]


def _numbers(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(
            isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _FARTHEST
            for v in value
        )
    )


def view_of(text: str) -> dict[str, Any]:
    r"""Return the table ``[view]`` of a recipe.

    Examples
    --------
    >>> view_of("metrosep = 1\n[view]\ntab = 'report'\n")
    {'tab': 'report'}
    """
    found = tomllib.loads(text).get("view", {})
    return dict(found) if isinstance(found, Mapping) else {}


def with_view(text: str, view: Mapping[str, Any]) -> str:
    r"""Return a recipe with another table ``[view]``; all else stays as it is written.

    Examples
    --------
    >>> print(with_view("metrosep = 1  # first\n", {"tab": "table"}))
    metrosep = 1  # first
    <BLANKLINE>
    [view]
    tab = "table"
    <BLANKLINE>
    """
    import tomlkit

    if view_of(text) == dict(view):
        return text
    made = tomlkit.parse(text)
    if "view" in made:
        del made["view"]
    plain = str(tomlkit.dumps(made)).rstrip("\n") + "\n"
    if not view:
        return plain
    table = tomlkit.document()
    table.add("view", tomlkit.item(dict(view)))
    return f"{plain}\n{tomlkit.dumps(table)}"
