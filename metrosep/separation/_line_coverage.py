"""Which samples of an artefact the probes of a row read, and whether they read any of them twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotUniformError, UnitError
from metrosep.core.units import format_length
from metrosep.separation._line_probes import GRID_RTOL, Row, Rows


def needed_travel(row: Row) -> float:
    """Return the travel below which no place of the artefact is read by two probes that count, m.

    As many probes as the carriage needs must each overlap with its neighbour, of more one pair.
    """
    gaps = np.diff(row.offsets)
    least = len(row.offsets) == (3 if row.pitch else 2)
    return float(gaps.max() if least else gaps.min()) * (1.0 - GRID_RTOL)


def check_overlap(row: Row, x: FloatArray, what: str) -> None:
    """Refuse probes farther apart than the carriage travels: no place is read twice."""
    travel, needed = float(x[-1] - x[0]), needed_travel(row)
    if travel >= needed:
        return
    needed /= 1.0 - GRID_RTOL
    raise UnitError(
        f"{what}: the carriage travels {format_length(travel)}, but the probes are "
        f"{format_length(needed)} apart: no place of the artefact is read by both, so nothing is "
        "separated; distances and positions are given in m, or travel farther"
    )


def check_steps(row: Row, x: FloatArray, what: str) -> None:
    """Refuse positions that are not one step of the sums apart."""
    worst = float(np.abs(np.diff(x) - row.step).max(initial=0.0))
    if worst > 2.0 * GRID_RTOL * row.step:
        raise NotUniformError(
            f"{what}: the positions x differ by up to {format_length(worst)} from steps of "
            f"{format_length(row.step)}, and 'sequential' sums are over equal steps; leave out step, "
            "or use method='least_squares'"
        )


def probe_places(row: Row, x: FloatArray, grid: FloatArray) -> list[FloatArray]:
    """Return where each probe reads: on the grid itself where steps are equal and offsets whole."""
    even = np.abs(np.diff(x) - row.step).max() <= 2.0 * GRID_RTOL * row.step
    if row.shifts is not None and even:
        return [grid[k : k + x.size] for k in row.shifts]
    return [x + o for o in row.offsets]


def read_samples(
    rows: Rows, places: list[FloatArray], at: NDArray[np.intp], grid: FloatArray, step: float
) -> NDArray[np.bool_]:
    """Return which samples lie less than a step from a reading that takes part in a row.

    A sample a whole step away from every reading lies between samples that were read: what an
    estimator makes of it is a guess.
    """
    touched = rows.touched
    here = [np.empty(0)] + [p[at[touched[s]]] for s, p in enumerate(places)]
    index = (np.concatenate(here) - grid[0]) / step
    read = np.zeros(grid.size, dtype=bool)
    low = np.floor(index + GRID_RTOL)
    exact = np.abs(index - low) <= 2.0 * GRID_RTOL
    for sample in (low, low[~exact] + 1.0):
        read[np.clip(sample, 0, grid.size - 1).astype(np.intp)] = True
    return read
