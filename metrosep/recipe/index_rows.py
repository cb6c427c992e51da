"""The index of a batch in the long form: the rows that CSV and Parquet share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

NUMBERS = frozenset({"value", "lower", "upper", "U"})
"""Columns that hold numbers, in the unit of the column ``unit``; the others hold texts."""

_UNIT = ("file", "key")
_CHARACTERISTIC = (
    "characteristic", "metric", "value", "unit", "lower", "upper", "U", "verdict",
)  # fmt: skip
_END = ("status", "reason", "result")


def index_columns(document: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the columns."""
    others = {*_UNIT, *_CHARACTERISTIC, *_END}
    groups = (f"{g} (group)" if g in others else g for g in document["groups"])
    return (*_UNIT, *groups, *_CHARACTERISTIC, *_END)


def index_rows(document: Mapping[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield a row for each characteristic, one for each unit without any, or that is not begun."""
    groups = list(document["groups"])
    keys = ("name", *_CHARACTERISTIC[1:])
    for row in document["rows"]:
        head = (row["unit"], row["key"], *(row["groups"].get(g, "") for g in groups))
        tail = (row["status"], row["reason"], row["link"])
        each: Sequence[Mapping[str, Any]] = row["characteristics"] or ({},)
        for characteristic in each:
            yield (*head, *(characteristic.get(k) for k in keys), *tail)
    for name in (document.get("not_begun") or {}).get("units", ()):
        empty = (None,) * (len(keys))
        yield (name, None, *("" for _ in groups), *empty, "not begun", None, None)
