"""Repeats as callers give them, on common positions, laterally aligned."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers

_MOST_PASSES = 50
_SETTLED = 1e-3


def common_stack(
    repeats: Any, x: ArrayLike | None
) -> tuple[
    FloatArray,
    FloatArray | None,
    tuple[float, float] | None,
    tuple[Step, ...],
    dict[str, Any],
]:
    """Return repeats as one array with positions, steps, history and notes for the audit."""
    if isinstance(repeats, Profile | Surface):
        raise TooFewSamplesError("repeatable needs at least 2 repeats: a list of them")
    try:
        items = list(repeats)
    except TypeError:
        raise InvalidSamplesError(
            f"repeatable needs a list, got {type(repeats).__name__}"
        ) from None
    profiles = [i for i in items if isinstance(i, Profile)]
    surfaces = [i for i in items if isinstance(i, Surface)]
    if (profiles or surfaces) and len(items) not in (len(profiles), len(surfaces)):
        raise DataError("repeatable: give all repeats as profiles, surfaces or arrays, not mixed")
    if profiles or surfaces:
        if x is not None:
            raise DataError("repeatable: profiles and surfaces bring their positions, leave out x")
        if len(items) < 2:
            raise TooFewSamplesError(f"repeatable needs at least 2 repeats, got {len(items)}")
        history = tuple(s for i in items for s in i.history)
        if profiles:
            stack, positions, notes = _on_common_positions(profiles)
            return stack, positions, None, history, notes
        stack, steps = _maps(surfaces)
        return stack, None, steps, history, {}
    needs = "repeatable: repeats must be arrays of numbers of one shape"
    rows = [as_numbers(i, needs) for i in items]
    shapes = sorted({r.shape for r in rows})
    if len(shapes) > 1:
        raise InvalidSamplesError(f"{needs}, got {shapes}")
    stack = np.array(rows)
    if x is None:
        return stack, None, None, (), {}
    positions = as_numbers(x, "repeatable: x must be positions in m (or angles in rad)")
    if positions.ndim != 1 or not np.isfinite(positions).all():
        raise InvalidSamplesError("repeatable: x must be one row of finite positions")
    return stack, positions, None, (), {}


def _maps(surfaces: list[Surface]) -> tuple[FloatArray, tuple[float, float] | None]:
    first = surfaces[0]
    for k, s in enumerate(surfaces[1:], start=2):
        if s.shape != first.shape or s.dx != first.dx or s.dy != first.dy:
            raise DataError(
                f"repeatable: map {k} has {s.shape} pixels of {s.dx} x {s.dy} m, the first "
                f"{first.shape} of {first.dx} x {first.dy} m; resample them to the same pixels"
            )
    steps = None if first.dx is None else (first.dx, first.dy or first.dx)
    return np.stack([s.z for s in surfaces]), steps


def _on_common_positions(
    profiles: list[Profile],
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    first = profiles[0]
    if all(len(p) == len(first) and np.array_equal(p.x, first.x) for p in profiles):
        return np.stack([p.z for p in profiles]), first.x.copy(), {}
    start, stop = max(p.x[0] for p in profiles), min(p.x[-1] for p in profiles)
    step = float(np.median([np.median(np.diff(p.x)) for p in profiles if len(p) > 1]))
    n = int(np.floor((stop - start) / step + 1e-9)) + 1 if stop > start else 0
    if n < 8:
        raise DataError(
            f"repeatable: the repeats share {max(stop - start, 0.0):.3g} m of positions, less than 8 "
            "steps; do they start at the same place, all in m?"
        )
    x = start + step * np.arange(n)
    stack = np.stack([_interpolated(p.x, p.z, x) for p in profiles])
    return (
        stack,
        x,
        {"resampled_step_um": 1e6 * step, "resampled": "linear, over the common range"},
    )


def _interpolated(x: FloatArray, z: FloatArray, at: FloatArray) -> FloatArray:
    """Interpolate linearly; NaN outside, and where a neighbour with weight was not measured."""
    hole = np.isnan(z)
    out = np.interp(at, x, np.where(hole, 0.0, z))
    near = np.interp(at, x, hole.astype(np.float64)) > 1e-9
    margin = 1e-9 * (x[-1] - x[0])
    return np.where(near | (at < x[0] - margin) | (at > x[-1] + margin), np.nan, out)


def shifted_to_first(
    stack: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray, dict[str, Any]]:
    """Return profiles moved along x onto the first, on the positions that all then have."""
    if not np.all(np.diff(x) > 0.0):
        raise DataError('repeatable: shift="fit" needs x that rises; sort x and the repeats')
    shifts = np.array([0.0, *(_shift(x, stack[0], z) for z in stack[1:])])
    low, high = x[0] + max(0.0, *(-shifts)), x[-1] - max(0.0, *shifts)
    keep = (x >= low) & (x <= high)
    out = np.stack([_interpolated(x, z, x[keep] + s) for z, s in zip(stack, shifts, strict=True)])
    return out, x[keep].copy(), {"shifts_um": (1e6 * shifts).tolist()}


def _shift(x: FloatArray, first: FloatArray, z: FloatArray) -> float:
    """Return s of least squares of ``z(x + s) - first(x)``, a line free."""
    step = float(np.median(np.diff(x)))
    slope = np.gradient(first, x)
    s = 0.0
    for _ in range(_MOST_PASSES):
        d = _interpolated(x, z, x + s) - first
        good = np.isfinite(d) & np.isfinite(slope)
        if good.sum() < x.size / 2:
            break
        u = np.linspace(-1.0, 1.0, x.size)
        basis = np.column_stack([slope, np.ones(x.size), u])[good]
        size = np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
        found = np.linalg.lstsq(basis / size, d[good], rcond=1e-10)[0] / size
        change = float(np.clip(-found[0], -2 * step, 2 * step))
        s += change
        if abs(change) < _SETTLED * step:
            return s
    raise NotConvergedError(
        "repeatable: a lateral shift did not settle; the repeats differ too much for it, or start more "
        'than a few of their shortest waves apart: align them first, or use shift="trust"'
    )
