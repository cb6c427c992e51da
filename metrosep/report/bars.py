"""Where a value lies between its limits, as fractions of a bar: limits, guard bands, U, value.

The guard band of a limit is the zone around it in which nothing is decided: limit - g to limit + g.
"""

from __future__ import annotations

from typing import Any

from metrosep.report.rows import CharacteristicRow

__all__ = ["bar_of"]

_MARGIN = 0.25
"""Of the range between the limits (or of the limit itself), shown beyond it."""

_MOST = 3.0
"""Ranges beyond a limit at which a bar ends; a value further out is drawn at the end."""


def bar_of(row: CharacteristicRow) -> dict[str, Any] | None:
    """Return the bar of a characteristic.

    Examples
    --------
    >>> row = CharacteristicRow("", "", "", "Sq", "Sq", "m", 4.0, 0.0, 8.0, None, 1.0, 1.0, "accept")
    >>> bar_of(row)["limits"]
    [0.2143, 0.7857]
    """
    limits = [v for v in (row.lower, row.upper) if v is not None]
    if not limits or row.value is None:
        return None
    low, high = _range(row, limits)
    guard = row.guard or 0.0
    start = low if row.lower is None else row.lower + guard
    stop = high if row.upper is None else row.upper - guard

    def at(number: float) -> float:
        return round(min(max((number - low) / (high - low), 0.0), 1.0), 4)

    spread = row.U
    return {
        "value": at(row.value),
        "spread": None if spread is None else [at(row.value - spread), at(row.value + spread)],
        "limits": [at(v) for v in limits],
        "guards": [[at(v - guard), at(v + guard)] for v in limits if guard > 0.0],
        "zone": [at(start), at(stop)] if start < stop else None,
        "beyond": -1 if row.value < low else int(row.value > high),
    }


def _range(row: CharacteristicRow, limits: list[float]) -> tuple[float, float]:
    """Return the ends of the bar: limits with a margin, the value with U as far as that is sensible."""
    value, spread, guard = row.value or 0.0, row.U or 0.0, row.guard or 0.0
    if len(limits) == 2:
        low, high = limits
    elif row.upper is not None:
        low, high = min(0.0, row.upper), max(0.0, row.upper)
    else:
        low, high = limits[0], limits[0] + abs(limits[0])
    size = (high - low) or abs(high) or max(abs(value), spread, guard) or 1.0
    first = min(low, value - spread, *(v - guard for v in limits))
    last = max(high, value + spread, *(v + guard for v in limits))
    one_sided = len(limits) == 1 and row.upper is not None and value - spread >= 0.0 and low == 0.0
    below = 0.0 if one_sided else _MARGIN * size
    return (
        max(first - below, low - _MOST * size),
        min(last + _MARGIN * size, high + _MOST * size),
    )
