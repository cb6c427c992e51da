"""The order of the parts of a batch in charts, drifts and correlations; one order for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from metrosep.core.errors import DataError
from metrosep.core.natural_order import by_number
from metrosep.io.measuring_time import moment_of

__all__ = ["order_notes", "order_of", "order_words", "parts_in_order"]

Document = Mapping[str, Any]

_CLOCKS = {"time": "measured_at", "file_time": "file_time"}
_WORDS = {
    "name": "in the order of their names, not of time",
    "time": "in the order of measuring, as their files state it",
    "file_time": "in the order in which their files were last changed",
}


def order_of(document: Document) -> str:
    """Return what orders the parts."""
    order = str(document.get("order") or "name")
    if not order.isidentifier():
        raise DataError(
            f"the order of the parts in this index is damaged ({order[:40]!r}); write the index again"
        )
    return order


def order_words(document: Document) -> str:
    """Return the order of the parts in words."""
    order = order_of(document)
    return _WORDS.get(order, f"in the order of {order}, which their names state")


def parts_in_order(document: Document) -> list[int]:
    """Return the places of the rows of an index in the order of the parts."""
    rows = document.get("rows") or []
    if order_of(document) == "name":
        return sorted(range(len(rows)), key=lambda i: by_number(str(rows[i].get("unit"))))
    places = {i: _place(row, order_of(document)) for i, row in enumerate(rows)}
    known = [i for i, place in places.items() if place is not None]
    return sorted(known, key=lambda i: (places[i], by_number(str(rows[i].get("unit")))))


def order_notes(document: Document) -> list[str]:
    """Return what is to be known about the order: parts without a place, clocks that differ."""
    order = order_of(document)
    rows = [r for r in document.get("rows") or [] if r.get("characteristics")]
    if order == "name" or not rows:
        return []
    notes = []
    lost = sum(_place(r, order) is None for r in rows)
    if lost:
        why, cure = _MISSING.get(
            order, (f'have no "{order}" in their names', "check the pattern of [batch]")
        )
        which = "all parts" if lost == len(rows) else f"{lost} of {len(rows)} parts"
        notes.append(
            f'[batch] order = "{order}": {which} {why} and are not in charts and drifts; {cure}'
        )
    zoned = {_has_offset(str(r["measured_at"])) for r in rows if r.get("measured_at")}
    if order == "time" and len(zoned) > 1:
        notes.append(
            '[batch] order = "time": some files state the offset of their clock and others do not; the first '
            "are ordered by UTC and the others as written, so that both may be hours apart"
        )
    return notes


_NOT_ASKED = (
    'name a group of the pattern, or ask for order = "file_time"; results of a metrosep that did not '
    "look for it are made again by --fresh"
)
_MISSING = {
    "time": ("state no date of measuring", _NOT_ASKED),
    "file_time": ("have no time of their file", "run the batch to its end"),
}


def _place(row: Document, order: str) -> Any:
    """Return what sorts a row, None where it does not tell it."""
    if order in _CLOCKS:
        text = row.get(_CLOCKS[order])
        try:
            return None if not text else moment_of(str(text))
        except ValueError:
            return None
    groups = row.get("groups")
    text = groups.get(order) if isinstance(groups, Mapping) else None
    return by_number(str(text)) if text else None


def _has_offset(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False
