"""The table ``[batch]`` of a recipe: which files are units, what they are called, what is listed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from metrosep.recipe.schema import Field, Place, checked_table

__all__ = ["BATCH", "batch_table"]

BATCH = {
    "each": Field("text", choices=("file", "folder")),
    "pattern": Field("text"),
    "key": Field("texts"),
    "on_error": Field("text", choices=("continue", "stop")),
    "index": Field("texts"),
    "trend": Field("texts"),
}


def batch_table(data: Mapping[str, Any], place: Place) -> dict[str, Any]:
    """Return the table ``[batch]`` checked, with its defaults.

    Parameters
    ----------
    data : mapping
        What TOML holds; empty where the recipe has no such table.
    place : Place
        Where it stands.

    Returns
    -------
    dict
        ``each`` (what a unit is: "file", "folder", None: as the recipe reads), ``pattern`` (None:
        the stem of each file names it), ``key`` (named groups), ``on_error``, ``index`` (formats),
        ``trend`` (names of characteristics).

    Raises
    ------
    RecipeError
        With file and line, if a key is unknown, the pattern is no regular expression, or ``key``
        names a group that the pattern has not.

    Examples
    --------
    >>> place = Place("r.toml", "")
    >>> batch_table({"pattern": r"(?P<part>[A-Z]+)_(?P<serial>[0-9]+)[.]x3p"}, place)["key"]
    ('part', 'serial')
    """
    table = checked_table(data, BATCH, place, what="[batch]")
    pattern = table.get("pattern")
    groups = _groups(pattern, place)
    key = tuple(table.get("key", groups))
    if "key" in table and pattern is None:
        raise place.error(
            "key names groups of a pattern, and there is none: add "
            "pattern = '(?P<part>[A-Z]+)_(?P<serial>[0-9]+)[.]x3p'",
            "key",
        )
    for name in key:
        if name not in groups:
            known = ", ".join(groups) or "none"
            raise place.error(f'key: the pattern has no group "{name}"; it has {known}', "key")
    for name in ("key", "index", "trend"):
        _once(table.get(name, ()), name, place)
    return {
        "each": table.get("each"),
        "pattern": pattern,
        "key": key,
        "on_error": table.get("on_error", "continue"),
        "index": tuple(table.get("index", ("csv",))),
        "trend": tuple(table.get("trend", ())),
    }


def _groups(pattern: str | None, place: Place) -> tuple[str, ...]:
    if pattern is None:
        return ()
    try:
        return tuple(re.compile(pattern).groupindex)
    except re.error as exc:
        at = "" if exc.pos is None else f" at character {exc.pos + 1}"
        raise place.error(
            f"pattern is no regular expression: {exc.msg}{at}; write it in single quotes, so that "
            "backslashes stay",
            "pattern",
        ) from None


def _once(items: Any, name: str, place: Place) -> None:
    """Refuse an empty list that was written out, and a name that occurs twice."""
    if name == "key" and isinstance(items, list) and not items:
        raise place.error("key is empty: name groups of the pattern, or leave it out", name)
    for i, item in enumerate(items):
        if not item:
            raise place.error(f"{name} holds an empty text", name)
        if item in items[:i]:
            raise place.error(f'{name} names "{item}" twice', name)
