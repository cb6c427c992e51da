"""A table at equal steps, for controllers that take nothing else, with what the resampling costs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.table import CompensationTable
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotUniformError, TableError
from metrosep.core.provenance import Step
from metrosep.core.units import format_ends, format_length

Outside = Literal["refuse", "hold", "zero", "taper"]

_SAME = 1e-9
"""Positions off a uniform grid by this share of the step are on it (specification, check 2)."""

_MAX_ENTRIES = 1_000_000
"""More entries than any controller takes: the step was given in the wrong unit."""


def is_uniform(positions: ArrayLike) -> bool:
    """Return whether positions are equally spaced within 1e-9 of the step.

    Parameters
    ----------
    positions : array_like, shape (n,), m
        Rising positions, n >= 2.

    Returns
    -------
    bool
        False also for positions that do not rise.

    Examples
    --------
    >>> is_uniform([0.0, 0.1, 0.2, 0.3]), is_uniform([0.0, 0.1, 0.21])
    (True, False)
    """
    p = np.asarray(positions, dtype=np.float64)
    if p.ndim != 1 or p.size < 2 or not np.isfinite(p).all():
        return False
    step = float(p[-1] - p[0]) / (p.size - 1)
    even = p[0] + step * np.arange(p.size)
    # positions far from zero carry the rounding of their own size
    rounding = 4.0 * np.finfo(np.float64).eps * float(np.abs(p).max())
    return bool(step > 0.0 and float(np.abs(p - even).max()) <= _SAME * step + rounding)


def uniform_spacing(positions: ArrayLike) -> tuple[float, float]:
    """Return start and step of equally spaced positions.

    Parameters
    ----------
    positions : array_like, shape (n,), m
        Rising positions, n >= 2.

    Returns
    -------
    tuple of (float, float), m
        First position, step.

    Raises
    ------
    NotUniformError
        If they are not equally spaced within 1e-9 of the step.
    """
    p = np.asarray(positions, dtype=np.float64)
    if not is_uniform(p):
        where = ""
        if p.ndim == 1 and p.size > 2 and np.isfinite(p).all():
            steps = np.diff(p)
            i = int(np.abs(steps - np.median(steps)).argmax())
            where = (
                f": the step from {p[i] * 1e3:.9g} mm is {steps[i] * 1e3:.9g} mm, most are "
                f"{float(np.median(steps)) * 1e3:.9g} mm"
            )
        raise NotUniformError(
            f"the positions are not equally spaced{where}; use resample_uniform, which reports what "
            "it costs"
        )
    return float(p[0]), float(p[-1] - p[0]) / (p.size - 1)


def resample_uniform(
    table: CompensationTable,
    *,
    start: float | str,
    step: float | str,
    n: int | None = None,
    span: float | str | None = None,
    outside: Outside = "refuse",
    taper: float | None = None,
    slope_max: float | None = None,
) -> CompensationTable:
    """Return a table at equal steps.

    Parameters
    ----------
    table : CompensationTable
        Corrections at any rising positions.
    start : float or str, m
        First position.
    step : float or str, m
        Step, positive; "0.5 mm" works, too.
    n : int, optional
        Number of entries; or give `span`.
    span : float or str, m, optional
        Length from the first to the last entry, a multiple of the step.
    outside : {"refuse", "hold", "zero", "taper"}, optional
        For entries beyond the old table: refuse, end value, zero, or a line down to zero.
    taper : float, m, optional
        Length of that line.
    slope_max : float, optional
        Largest slope in m per m that the way to zero may have.

    Returns
    -------
    CompensationTable
        The source of the old one is kept for the dry-run; `interpolation_error` is the old one
        plus what the resampling adds. The table itself if its positions are these already.

    Raises
    ------
    DataError
        If step, number or span cannot be, or `outside` is unknown.
    TableError
        If entries lie beyond the old table and `outside` refuses; if the way to zero is steeper
        than `slope_max`, or the taper has no length.

    Notes
    -----
    A zero that does not lie on the new grid would be missed by the interpolation: the entries are
    shifted so that the correction looked up there is zero (`offset_removed`), the end value where
    the zero lies outside the new table.

    Examples
    --------
    >>> from metrosep.compensation import CompensationTable
    >>> t = CompensationTable([0, 1e-3, 3e-3], [0, 1e-6, 0], None, "X", "Z", 0.0)
    >>> r = resample_uniform(t, start=0.0, step=1e-3, n=4)
    >>> (r.forward * 1e9).round(6).tolist(), r.interpolation_error
    ([0.0, 1000.0, 500.0, 0.0], 0.0)
    """
    start = numbers.quantity(start, "start", "length")
    step = numbers.positive(step, "step", dimension="length")
    taper = None if taper is None else numbers.quantity(taper, "taper", "length")
    grid = _grid(start, step, n, span)
    p = table.positions
    margin = _SAME * step
    if p.size == grid.size and np.abs(p - grid).max() <= margin:
        return table
    numbers.choice(outside, "outside", ("refuse", "hold", "zero", "taper"))
    beyond = grid[(grid < p[0] - margin) | (grid > p[-1] + margin)]
    if beyond.size:
        _check_outside(table, beyond, step, outside, taper, slope_max)
    # a node of the old table within rounding of the grid keeps its exact value
    right = np.clip(np.searchsorted(p, grid), 1, p.size - 1)
    near = np.where(grid - p[right - 1] < p[right] - grid, p[right - 1], p[right])
    at = np.where(np.abs(near - grid) <= margin, near, grid)
    forward = _continued(table, 1, at, outside, taper)
    offset = float(np.interp(table.reference, grid, forward))
    reverse = None
    if table.reverse is not None:
        reverse = _continued(table, -1, at, outside, taper) - offset
    new = replace(
        table,
        positions=grid,
        forward=forward - offset,
        reverse=reverse,
        u=None if table.u is None else np.interp(grid, p, table.u),
        offset_removed=table.offset_removed + offset,
    )
    added = resampling_error(table, new)
    known = table.interpolation_error
    parameters = {
        "start_mm": start * 1e3,
        "step_mm": step * 1e3,
        "n": int(grid.size),
        "outside": outside,
        "resampling_error_nm": added * 1e9,
        "shifted_nm": offset * 1e9,
    }
    return replace(
        new,
        interpolation_error=added if known is None else known + added,
        history=(*table.history, Step("resample_uniform", parameters)),
    )


def resampling_error(old: CompensationTable, new: CompensationTable) -> float:
    """Return the largest difference of two tables where both are defined.

    Parameters
    ----------
    old, new : CompensationTable
        Two tables of one axis, each linear between its entries.

    Returns
    -------
    float, m
        Exact: two polylines differ most at a node of one of them. Both directions.

    Raises
    ------
    TableError
        If they do not overlap.
    """
    first = max(old.span[0], new.span[0])
    last = min(old.span[1], new.span[1])
    if not last > first:
        raise TableError(
            f"the tables cover {format_ends(old.span[0], old.span[1])} and "
            f"{format_ends(new.span[0], new.span[1])}: they do not overlap"
        )
    nodes = np.union1d(old.positions, new.positions)
    nodes = np.r_[first, nodes[(nodes > first) & (nodes < last)], last]
    return max(
        float(np.abs(old.correction(nodes, d) - new.correction(nodes, d)).max()) for d in (1, -1)
    )


def _grid(start: float, step: float, n: int | None, span: float | str | None) -> FloatArray:
    if (n is None) == (span is None):
        raise DataError("give the number of entries n or the span, one of them")
    if span is not None:
        count = numbers.quantity(span, "span", "length") / step
        if abs(count - round(count)) > _SAME * max(abs(count), 1.0):
            raise DataError(
                f"the span {span!r} is not a multiple of the step {format_length(step)}"
            )
        n = round(count) + 1
    if n is None or not 2 <= n <= _MAX_ENTRIES or n != int(n):
        raise DataError(f"a table has 2 to {_MAX_ENTRIES} entries, got {n}: check step and unit")
    return np.asarray(start + step * np.arange(int(n)), dtype=np.float64)


def _check_outside(
    table: CompensationTable,
    beyond: FloatArray,
    step: float,
    outside: Outside,
    taper: float | None,
    slope_max: float | None,
) -> None:
    low, high = table.span
    if outside == "refuse":
        raise TableError(
            f"{beyond.size} entries from {beyond[0] * 1e3:.9g} mm on lie beyond the table "
            f"{format_ends(low, high)}: a correction is not extrapolated; "
            "measure further, or choose outside='hold', 'zero' or 'taper'"
        )
    if outside == "hold":
        return
    if slope_max is not None:
        numbers.positive(slope_max, "slope_max")
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    ends = [c[0] for c in columns if beyond[0] < low] + [
        c[-1] for c in columns if beyond[-1] > high
    ]
    largest = max(abs(float(c)) for c in ends)
    length = step if outside == "zero" else taper
    if length is None or not (math.isfinite(length) and length > 0.0):
        raise TableError(f"outside='taper' needs a positive length taper=, got {taper!r}")
    if slope_max is not None and largest > slope_max * length:
        raise TableError(
            f"the correction ends at {format_length(largest)}; over {format_length(length)} down to "
            f"zero it would slope {largest / length:.3g} m per m, allowed are {slope_max:.3g}: use a "
            f"taper of at least {format_length(largest / slope_max)}"
        )


def _continued(
    table: CompensationTable, direction: int, at: FloatArray, outside: Outside, taper: float | None
) -> FloatArray:
    """Return the correction of one direction, continued beyond the ends."""
    values = table.correction(at, direction)
    distance = np.maximum(table.positions[0] - at, at - table.positions[-1])
    if outside == "zero":
        values = np.where(distance > 0.0, 0.0, values)
    elif outside == "taper" and taper is not None:
        values = values * np.clip(1.0 - np.maximum(distance, 0.0) / taper, 0.0, 1.0)
    return np.asarray(values)
