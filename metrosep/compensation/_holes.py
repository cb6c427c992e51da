"""Holes in the runs that a table is dry-run against: bridged where three other runs or more were measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from metrosep.compensation.area_errors import AxisUnits
from metrosep.compensation.measured import Curve, Measured
from metrosep.core._arrays import FloatArray

_HOLE, _LONG_STEP = 0.05, 2.5

_WITNESSES = 3
"""Other runs that must be measured in a hole: as many as a table needs, or nothing tells what repeats."""

OF_RUNS = 0.5
"""Share of a run that must be measured inside the table."""


def spacing_of(span: tuple[float, float], entries: FloatArray | None) -> float:
    return (span[1] - span[0]) / max((2 if entries is None else entries.size) - 1, 1)


def _holes(
    x: FloatArray, common: tuple[float, float], most: float, long: float
) -> list[tuple[float, float]]:
    """Return between which readings of a run, inside the table, nothing was measured."""
    steps = np.diff(x)
    inside = (x[1:] > common[0]) & (x[:-1] < common[1])
    usual = float(np.median(steps))
    # of a list of targets the usual step counts
    longest = _LONG_STEP * usual if long < 2.0 * usual else most
    wide = np.flatnonzero(inside & (steps > longest * (1.0 + 1e-9)))
    return [(float(x[i]), float(x[i + 1])) for i in wide]


def without_holes(
    measured: Measured,
    span: tuple[float, float],
    common: tuple[float, float],
    entries: FloatArray | None,
    units: AxisUnits,
) -> tuple[Measured, tuple[list[str], list[str]]]:
    """Return the runs, a hole of one that three others cover bridged; what is refused, and warnings.

    In a hole a run takes the shape of the mean of those that were measured there, and a line on top
    that joins it to its own readings: a straight line across would count as an error of the table.
    It cannot be a witness there: with n runs of which m were measured, the deviations of these from their
    mean grow by sqrt(n (n - 1) / (m (m - 1))), so that the scatter of n runs is that of m.
    """
    long = _HOLE * (span[1] - span[0])
    most = max(2.0 * spacing_of(span, entries), long)
    found = {
        (i, d): _holes(x, common, most, long)
        for i, row in enumerate(measured.rows)
        for d, x in row.places.items()
    }
    curves = [dict(row.curves) for row in measured.rows]
    bridged: list[tuple[int, int, float, float]] = []
    refused: list[str] = []
    warnings: list[str] = []
    for (i, d), holes in found.items():
        row, missing = measured.rows[i], sum(b - a for a, b in holes)
        for a, b in holes:
            there = [
                j
                for (j, way), theirs in found.items()
                if way == d and j != i and not any(low < b and high > a for low, high in theirs)
            ]
            where = (
                f"run {row.name} was not measured between {units.place(a, digits=6)} and "
                f"{units.place(b, digits=6)}"
            )
            if len(there) >= _WITNESSES and missing < OF_RUNS * (common[1] - common[0]):
                others = [measured.rows[j].curves[d] for j in there]
                n = len(curves) - sum(
                    way == d and low < b and high > a for _, way, low, high in bridged
                )
                curves[i][d] = _joined(curves[i][d], others, a, b, 0.0)
                for j in there:
                    curves[j][d] = _joined(curves[j][d], others, a, b, math.sqrt(n / (n - 2.0)))
                bridged.append((i, d, a, b))
                warnings.append(
                    f"{where}, inside the table: there it is judged by the {len(there)} runs that were"
                )
            else:
                refused.append(f"{where}, inside the table: measure there, or leave it out")
    rows = tuple(
        replace(row, curves=curves[i], bridged=_by_direction(bridged, i))
        for i, row in enumerate(measured.rows)
    )
    return replace(measured, rows=rows), (refused, warnings)


def _by_direction(
    bridged: list[tuple[int, int, float, float]], row: int
) -> dict[int, tuple[tuple[float, float], ...]]:
    """Return the bridged places of one row, by direction."""
    return {d: tuple((a, b) for i, way, a, b in bridged if (i, way) == (row, d)) for d in (1, -1)}


def _joined(curve: Curve, others: list[Curve], a: float, b: float, share: float) -> Curve:
    """Return a curve that between a and b has the shape of the mean of others, and no step.

    `share` of its own deviation from that shape is kept.
    """
    ends = np.array([a, b])

    def shape(of: Curve, p: FloatArray) -> FloatArray:
        return of(p) - np.interp(p, ends, of(ends))

    def at(p: FloatArray) -> FloatArray:
        found = np.array(curve(p))
        here = (p > a) & (p < b)
        if (
            here.any()
        ):  # elsewhere the others are not asked: with many holes that would take forever
            q = p[here]
            mean = np.mean([shape(other, q) for other in others], axis=0)
            inside = mean + np.interp(q, ends, curve(ends))
            if share:
                inside = inside + share * (shape(curve, q) - mean)
            found[here] = inside
        return found

    return at
