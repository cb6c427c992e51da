"""The table ``[batch]`` of a recipe: which files are units, what they are called, what is listed."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Any

from metrosep.recipe.schema import Field, Place, checked_table

__all__ = ["BATCH", "COLUMNS", "ORDERS", "batch_table"]

BATCH = {
    "each": Field("text", choices=("file", "folder")),
    "pattern": Field("text"),
    "key": Field("texts"),
    "on_error": Field("text", choices=("continue", "stop")),
    "index": Field("texts"),
    "trend": Field("texts"),
    "order": Field("text"),
}

COLUMNS = (
    "file", "key", "characteristic", "metric", "value", "unit", "lower", "upper", "U", "verdict",
    "status", "reason", "result", "hash",
)  # fmt: skip
"""Columns of the index; a group of the pattern may not take their names."""

ORDERS = ("name", "time", "file_time")
"""Orders of the parts beside the groups: by name, measuring date, time of change of the file."""


def batch_table(data: Mapping[str, Any], place: Place) -> dict[str, Any]:
    """Return the table ``[batch]`` checked, with its defaults.

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
    order = table.get("order", "name")
    _require_order(order, groups, place)
    return {
        "each": table.get("each"),
        "pattern": pattern,
        "key": key,
        "groups": (*key, *(g for g in groups if g not in key)),
        "on_error": table.get("on_error", "continue"),
        "index": tuple(table.get("index", ("csv",))),
        "trend": tuple(table.get("trend", ())),
        "order": order,
    }


def _groups(pattern: str | None, place: Place) -> tuple[str, ...]:
    if pattern is None:
        return ()
    try:
        groups = tuple(re.compile(pattern).groupindex)
    except re.error as exc:
        at = "" if exc.pos is None else f" at character {exc.pos + 1}"
        raise place.error(
            f"pattern is no regular expression: {exc.msg}{at}; write it in single quotes, so that "
            "backslashes stay",
            "pattern",
        ) from None
    for name in groups:
        if name in COLUMNS:
            raise place.error(
                f'pattern: the group "{name}" has the name of a column of the index; give it another '
                f"one, such as (?P<part_{name}>...)",
                "pattern",
            )
    return groups


def _require_order(order: str, groups: tuple[str, ...], place: Place) -> None:
    """Refuse an order that is nothing, or two things at once."""
    if order in ORDERS and order in groups:
        raise place.error(
            f'order = "{order}" is the group "{order}" of the pattern and an order of its own; give '
            f"the group another name, such as (?P<part_{order}>...)",
            "order",
        )
    if order not in ORDERS and order not in groups:
        known = [*ORDERS, *groups]
        near = difflib.get_close_matches(order, known, n=1)
        hint = f' Did you mean "{near[0]}"?' if near else ""
        raise place.error(
            f'order = "{order}" is not one of {", ".join(known)} (the last are groups of the pattern)'
            f".{hint}"
            if groups
            else f'order = "{order}" is not one of {", ".join(known)}; an order by a part of the name '
            f"needs a pattern with that group.{hint}",
            "order",
        )


def _once(items: Any, name: str, place: Place) -> None:
    """Refuse an empty list that was written out, and a name that occurs twice."""
    if name == "key" and isinstance(items, list) and not items:
        raise place.error("key is empty: name groups of the pattern, or leave it out", name)
    for i, item in enumerate(items):
        if not item:
            raise place.error(f"{name} holds an empty text", name)
        if item in items[:i]:
            raise place.error(f'{name} names "{item}" twice', name)
