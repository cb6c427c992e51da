"""From the index of a batch to the texts, series and links that its page and its workbook show."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote

from metrosep.core.errors import DataError
from metrosep.parameters.capability import Capability, ControlLimits, capability_of, control_limits
from metrosep.parameters.rounding_floor import constant, floors
from metrosep.recipe.part_order import parts_in_order
from metrosep.report.comparison import known_number
from metrosep.report.rows import one_line
from metrosep.report.text import Stamp, decimals_for, readable_unit, stamp

__all__ = [
    "INDEX_SCHEMA",
    "Series",
    "link_of",
    "require_index",
    "rounding_floors",
    "series_of",
    "spark_points",
    "status_stamp",
]

Document = Mapping[str, Any]
_Key = tuple[str, str, str, int]

INDEX_SCHEMA = "metrosep.index/1"
_VERDICTS = {"accepted": "accept", "rejected": "reject", "inconclusive": "inconclusive"}
_OTHERS = {
    "measured": stamp(None),
    "failed": Stamp("FAILED", "!", "#6A1B5A", "The unit could not be measured."),
    "refused": Stamp("NOT BEGUN", "∅", "#3F4A56", "The unit was not begun."),
}


@dataclass(frozen=True, slots=True)
class Series:
    """One characteristic over all units of a batch."""

    metric: str  # what it is
    name: str
    unit: str  # printed unit of all numbers here; empty for pure ones
    factor: float  # of the unit, to SI
    decimals: int  # to print
    # of (float or None): by row of the index; ``None`` where it is not there
    values: tuple[float | None, ...]
    verdicts: tuple[str | None, ...]  # of (str or None): by row
    lower: float | None  # limits, where they are the same in every row
    upper: float | None
    same_limits: bool  # whether they are
    capability: Capability | None  # of the values, where there are enough and limits
    # of the values in the order of the parts; None, as capability, where they differ by rounding
    # only
    control: ControlLimits | None
    trend: bool  # whether the recipe asks for its trend
    number: int = 1  # from 1; 2 for the second check of one metric under one name
    # of (float or None): values in the order of the parts, as charts show them; parts without a
    # place are left out
    ordered: tuple[float | None, ...] = ()
    moves: bool = True  # whether the values differ by more than rounding


def require_index(document: Any) -> Sequence[Document]:
    """Return the rows of an index."""
    found = document.get("schema") if isinstance(document, Mapping) else type(document).__name__
    if found != INDEX_SCHEMA:
        raise DataError(
            f"this is not the index of a batch (schema {found!r}, expected {INDEX_SCHEMA!r}); give the "
            "index.json that 'metrosep batch' wrote"
        )
    rows = document.get("rows") or []
    if not isinstance(rows, Sequence) or not all(isinstance(r, Mapping) for r in rows):
        raise DataError("the rows of the index are not a list of units; write the index again")
    return rows


def status_stamp(status: Any) -> Stamp:
    """Return word, symbol and colour of the status of a unit.

    Examples
    --------
    >>> status_stamp("rejected").word, status_stamp("failed").symbol
    ('REJECT', '!')
    """
    if status in _VERDICTS:
        return stamp(_VERDICTS[status])
    if status not in _OTHERS:
        known = ", ".join([*_VERDICTS, *_OTHERS])
        raise DataError(f"unknown status {status!r} in the index; expected one of {known}")
    return _OTHERS[status]


def link_of(link: Any) -> str | None:
    """Return a link below the folder of the index, safe in a page.

    Examples
    --------
    >>> link_of("part 7/result.json"), link_of("../x"), link_of("javascript:alert(1)")
    ('part%207/result.json', None, 'javascript%3Aalert%281%29')
    """
    if not isinstance(link, str) or not link or link.startswith(("/", "\\")):
        return None
    if ".." in link.replace("\\", "/").split("/"):
        return None
    return quote(link.encode("utf-8", "replace"), safe="/")


def rounding_floors(document: Document) -> dict[str, float]:
    """Return the spread up to which values of a batch differ by rounding only, by SI unit."""
    entries = [
        e
        for row in require_index(document)
        for e in row.get("characteristics") or []
        if isinstance(e, Mapping)
    ]
    numbers = (
        (one_line(e.get("unit") or "1"), known_number(e.get(k), k))
        for e in entries
        for k in ("value", "lower", "upper")
    )
    return floors((unit, value) for unit, value in numbers if value is not None)


def series_of(document: Document) -> list[Series]:
    """Return the characteristics of a batch, those with a trend first."""
    rows = require_index(document)
    found: dict[_Key, dict[int, Document]] = {}
    for i, row in enumerate(rows):
        counted: Counter[tuple[str, str, str]] = Counter()
        for entry in row.get("characteristics") or []:
            if not isinstance(entry, Mapping):
                raise DataError(
                    "a characteristic of the index is not a value; write the index again"
                )
            metric = one_line(
                entry.get("metric") or entry.get("symbol") or entry.get("name") or "?"
            )
            key = (
                metric,
                one_line(entry.get("name") or metric),
                one_line(entry.get("unit") or "1"),
            )
            counted[key] += 1
            found.setdefault((*key, counted[key]), {})[i] = entry
    wanted = {one_line(t) for t in document.get("trend") or []}
    order = parts_in_order(document)
    floor = rounding_floors(document)
    made = [
        _series(k, entries, len(rows), wanted, order, floor.get(k[2], 0.0))
        for k, entries in found.items()
    ]
    return sorted(made, key=lambda s: (not s.trend, not any(s.verdicts)))


def _series(
    key: _Key,
    entries: Mapping[int, Document],
    n: int,
    wanted: set[str],
    order: Sequence[int],
    floor: float,
) -> Series:
    metric, name, si, number = key
    columns = {
        k: [known_number(entries.get(i, {}).get(k), f"{k} of {metric}") for i in range(n)]
        for k in ("value", "lower", "upper", "U", "u")
    }
    limits = {(columns["lower"][i], columns["upper"][i]) for i in entries}
    same = len(limits) == 1
    lower, upper = next(iter(limits)) if same else (None, None)
    known = [v for v in columns["value"] if v is not None]
    shown: list[float | None] = [v for v in (lower, upper) if v] or list(known)
    unit, factor = readable_unit(shown, si)
    spreads = [v / factor for k in ("u", "U") for v in columns[k] if v is not None and v > 0.0]
    largest = max((abs(v) / factor for v in known), default=0.0)
    verdicts = tuple(entries.get(i, {}).get("verdict") for i in range(n))
    for verdict in verdicts:
        stamp(verdict)  # refuses an unknown one
    values = tuple(None if v is None else v / factor for v in columns["value"])
    ordered = tuple(values[i] for i in order)
    low, high = (None if v is None else v / factor for v in (lower, upper))
    in_order = low is None or high is None or low < high
    moves = not constant(known, floor)
    return Series(
        metric,
        name,
        "" if unit == "1" else unit,
        factor,
        min(decimals_for(min(spreads, default=None), largest), 6),
        values,
        verdicts,
        low,
        high,
        same,
        capability_of(values, lower=low, upper=high) if same and in_order and moves else None,
        control_limits(ordered) if moves else None,
        trend=bool(wanted & {metric, name}),
        number=number,
        ordered=ordered,
        moves=moves,
    )


def spark_points(values: Sequence[float | None]) -> list[list[tuple[float, float]]]:
    """Return the pieces of a sparkline, 100 wide and 20 high; a gap parts them."""
    known = [v for v in values if v is not None and math.isfinite(v)]
    if not known:
        return []
    low, high = min(known), max(known)
    size = (high - low) or 1.0
    across = max(len(values) - 1, 1)
    pieces: list[list[tuple[float, float]]] = [[]]
    for i, value in enumerate(values):
        if value is None or not math.isfinite(value):
            pieces.append([])
            continue
        pieces[-1].append(
            (round(100.0 * i / across, 2), round(18.0 - 16.0 * (value - low) / size, 2))
        )
    return [p for p in pieces if p]
