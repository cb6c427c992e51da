"""Private: what of a table was measured: its length, holes in the readings, the range of its line."""

from __future__ import annotations

import numpy as np

from metrosep.compensation._acceptance import Reason
from metrosep.compensation.area_errors import AxisUnits
from metrosep.compensation.measured import Measured
from metrosep.core._arrays import FloatArray

__all__ = ["COVERED", "alignment", "coverage"]


COVERED, _HOLE, _LONG_STEP, _OF_RUNS = 0.95, 0.05, 2.5, 0.5


def coverage(
    measured: Measured,
    span: tuple[float, float],
    common: tuple[float, float],
    entries: FloatArray | None,
    how: str,
    units: AxisUnits,
) -> tuple[list[Reason], list[str]]:
    """Return 1.9: the share of the table that was measured, holes in it, and the share of the runs."""
    refused, warnings = [], []
    length = span[1] - span[0]
    n = 2 if entries is None else entries.size
    spacing = length / max(n - 1, 1)
    share = (common[1] - common[0]) / length
    ranges = (
        f"the table covers {units.place(span[0])} ... {units.place(span[1])}, the measurement "
        f"{units.place(common[0])} ... {units.place(common[1])} of it"
    )
    if share < COVERED:
        refused.append(
            f"{ranges} ({100.0 * share:.3g} %): measure the whole table, or make it shorter"
        )
    elif length * (1.0 - share) > spacing * (1.0 + 1e-9):
        warnings.append(f"{ranges}: the rest is not proven")
    if how == "runs":
        refused += _holes(measured, common, spacing, length, units)
        whole = measured.span[1] - measured.span[0]
        if (common[1] - common[0]) / whole < _OF_RUNS:
            warnings.append(
                f"the table covers {100.0 * (common[1] - common[0]) / whole:.3g} % of what was measured: "
                "check the origin and the unit of the positions"
            )
    return [Reason("refused", "coverage", text) for text in refused], warnings


def _holes(
    measured: Measured,
    common: tuple[float, float],
    spacing: float,
    length: float,
    units: AxisUnits,
) -> list[str]:
    """Return the first hole of the readings inside the table, of each run that has one."""
    found = []
    for row in measured.rows:
        for x in row.places.values():
            steps = np.diff(x)
            inside = (x[1:] > common[0]) & (x[:-1] < common[1])
            usual = float(np.median(steps))
            most = max(2.0 * spacing, _HOLE * length)
            if _HOLE * length < 2.0 * usual:  # a list of targets
                most = _LONG_STEP * usual
            wide = np.flatnonzero(inside & (steps > most * (1.0 + 1e-9)))
            if wide.size:
                i = int(wide[0])
                found.append(
                    f"run {row.name} was not measured between {units.place(float(x[i]), digits=6)} and "
                    f"{units.place(float(x[i + 1]), digits=6)}, inside the table: measure there, or leave it out"
                )
    return found[:1]


def alignment(
    measured: Measured, space: str, aligned: tuple[float, float], units: AxisUnits
) -> list[Reason]:
    """Return that a line cannot be compared where the runs do not reach as far as it was removed."""
    if space != "line":
        return []
    low, high = max(aligned[0], measured.span[0]), min(aligned[1], measured.span[1])
    if high - low >= COVERED * (aligned[1] - aligned[0]):
        return []
    return [
        Reason(
            "inconclusive",
            "inconclusive",
            f"the line of the table was removed over {units.place(aligned[0])} ... "
            f"{units.place(aligned[1])}, the runs cover {units.place(low)} ... "
            f"{units.place(high)} of it: they cannot show its tilt; measure the whole range",
        )
    ]
