"""Sub-apertures as callers give them: maps or profiles with positions, brought to one grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers
from metrosep.spectral._checks import real_number

MOST_PIXELS = 60_000_000
"""Largest stitched map; beyond it a position is more likely wrong than the part that large."""

_LARGEST_STEP = 0.1
"""In m: a coarser pixel is more likely in another unit."""

_LARGEST_SPAN = 1e-3
"""In m: no interferometer measures more in one sub-aperture."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Sub-apertures with their positions, in one lateral scale."""

    # of ndarray, shape (n_y, n_x), m: readings; profiles have one row
    values: tuple[FloatArray, ...]
    # shape (n, 2), m: position (x, y) of the first pixel of each, as if it were not turned
    corners: FloatArray
    # shape (n,), rad: by which each lies turned on the part, counter-clockwise about its centre
    turns: FloatArray
    dx: float  # m: lateral steps
    dy: float
    line: bool  # whether they are profiles
    history: tuple[Step, ...] = ()  # of all of them
    calibrated: bool = True  # whether steps and positions are in m
    doubts: tuple[str, ...] = ()  # units that look wrong
    known: FloatArray | None = None  # shape (n_y, n_x), m: reference that was subtracted

    def __len__(self) -> int:
        return len(self.values)

    @property
    def kind(self) -> str:
        """What a sub-aperture is called in messages."""
        return "profile" if self.line else "map"


def pieces_of(
    maps: Sequence[ArrayLike | Surface | Profile],
    positions: ArrayLike | None,
    rotations: ArrayLike | None,
    dx: float | None,
    dy: float | None,
) -> Pieces:
    """Return sub-apertures of any accepted kind, checked."""
    items: list[Any] = _listed(maps)
    kinds = {type(i) if isinstance(i, Surface | Profile) else np.ndarray for i in items}
    if len(kinds) > 1:
        raise DataError(
            "stitch: give all sub-apertures as surfaces, profiles or arrays, not mixed"
        )
    kind = kinds.pop()
    own_steps = kind in (Surface, Profile)
    if own_steps and (dx is not None or dy is not None):
        raise DataError("stitch: surfaces and profiles carry their own step; leave out dx and dy")
    arrays = [_array(i.z if own_steps else i, k) for k, i in enumerate(items)]
    line = arrays[0].ndim == 1
    if any(a.ndim != arrays[0].ndim for a in arrays) or arrays[0].ndim not in (1, 2):
        shapes = ", ".join(str(a.shape) for a in arrays)
        raise InvalidSamplesError(
            f"stitch needs maps (2-D) or profiles (1-D), got shapes {shapes}"
        )
    step_x, step_y, calibrated = _steps(items, kind, dx, dy, line)
    corners = _corners(items, kind, positions, line, step_x, step_y)
    turns = _turns(rotations, len(items), line)
    _sane(corners, turns, arrays, step_x, step_y, calibrated=calibrated)
    history = tuple(s for i in items if own_steps for s in i.history)
    values = tuple(np.atleast_2d(a) for a in arrays)
    doubts = _unit_doubts(values, step_x, step_y) if calibrated else ()
    return Pieces(values, corners, turns, step_x, step_y, line, history, calibrated, doubts)


def _listed(maps: Any) -> list[Any]:
    if isinstance(maps, Surface | Profile) or (isinstance(maps, np.ndarray) and maps.ndim < 2):
        raise InvalidSamplesError("stitch needs several sub-apertures: a list of maps or profiles")
    try:
        items = list(maps)
    except TypeError:
        raise InvalidSamplesError(f"stitch needs a list, got {type(maps).__name__}") from None
    if len(items) < 2:
        raise TooFewSamplesError(f"stitch needs at least 2 sub-apertures, got {len(items)}")
    return items


def _array(item: Any, k: int) -> FloatArray:
    z = as_numbers(item, f"stitch: sub-aperture {k + 1} must hold numbers in m")
    if np.isinf(z).any():
        raise InvalidSamplesError(
            f"stitch: sub-aperture {k + 1} is infinite somewhere; mark what was not measured as NaN"
        )
    if np.count_nonzero(~np.isnan(z)) < 4:
        raise InvalidSamplesError(
            f"stitch: sub-aperture {k + 1} has fewer than 4 measured samples"
        )
    return z


def _steps(
    items: list[Any], kind: type, dx: float | None, dy: float | None, line: bool
) -> tuple[float, float, bool]:
    if kind is Profile:
        steps = [(p.dx, p.dx) for p in items]
    elif kind is Surface:
        if any(s.dx is None or s.dy is None for s in items):
            raise DataError("stitch: a surface has no lateral step; positions need dx and dy in m")
        steps = [(s.dx, s.dy) for s in items]
    else:
        calibrated = dx is not None
        if dx is None and dy is not None:
            raise DataError("stitch: dy is given without dx; give dx, or both, in m")
        first = 1.0 if dx is None else real_number(dx, "stitch: dx", "a step in m")
        second = first if dy is None else real_number(dy, "stitch: dy", "a step in m")
        steps = [(first, second)]
        for name, value in zip(("dx", "dy"), steps[0], strict=True):
            if not (math.isfinite(value) and value > 0.0):
                raise DataError(f"stitch: {name} is {value} m; a lateral step must be positive")
        return steps[0][0], steps[0][1], calibrated
    for k, (sx, sy) in enumerate(steps[1:], start=2):
        for name, value, first in (("dx", sx, steps[0][0]), ("dy", sy, steps[0][1])):
            if abs(value - first) > 1e-6 * first and not (line and name == "dy"):
                raise DataError(
                    f"stitch: {name} of sub-aperture {k} is {value:.9g} m, of the first "
                    f"{first:.9g} m; resample them to one lateral step"
                )
    return steps[0][0], steps[0][1], True


def _corners(
    items: list[Any], kind: type, positions: ArrayLike | None, line: bool, dx: float, dy: float
) -> FloatArray:
    n = len(items)
    if positions is None:
        if kind is Profile:
            return np.array([(p.x[0], 0.0) for p in items])
        if kind is Surface:
            return np.array([s.origin for s in items], dtype=np.float64)
        raise DataError("stitch: arrays need positions: where the first sample of each lies, in m")
    found = as_numbers(positions, "stitch: positions must be numbers in m")
    if line and found.shape == (n,):
        found = np.column_stack([found, np.zeros(n)])
    if found.shape != (n, 2):
        want = f"({n},)" if line else f"({n}, 2), x and y of the first pixel of each map"
        raise DataError(f"stitch: positions have the shape {found.shape}, needed is {want}")
    if not np.isfinite(found).all():
        raise InvalidSamplesError("stitch: a position is not finite")
    return found


def _turns(rotations: ArrayLike | None, n: int, line: bool) -> FloatArray:
    if rotations is None:
        return np.zeros(n)
    turns = np.atleast_1d(as_numbers(rotations, "stitch: rotations must be angles in rad"))
    if turns.shape != (n,) or not np.isfinite(turns).all():
        raise DataError(f"stitch: rotations must be {n} finite angles in rad")
    if line and np.any(turns != 0.0):
        raise DataError("stitch: profiles cannot be turned")
    if np.abs(turns).max() > 2.0 * np.pi + 1e-9:
        raise DataError(
            f"stitch: a rotation is {np.abs(turns).max():.6g} rad, more than one turn; this looks "
            "like degrees: give numpy.radians(rotations)"
        )
    return turns


def _sane(
    corners: FloatArray,
    turns: FloatArray,
    arrays: list[FloatArray],
    dx: float,
    dy: float,
    *,
    calibrated: bool,
) -> None:
    shapes = [np.atleast_2d(a).shape for a in arrays]
    span = np.ptp(corners, axis=0) / np.array([dx, dy])
    wide, high = span[0] + max(s[1] for s in shapes), span[1] + max(s[0] for s in shapes)
    if wide * high > MOST_PIXELS:
        raise DataError(
            f"stitch: the positions span {wide:.4g} x {high:.4g} pixels, more than can be stitched; "
            "are positions and steps both in m?"
        )
    if span.max() < 1.0 and np.ptp(turns) == 0.0:
        hint = (
            f"({dx:.3g} m), so nothing is stitched; are positions and steps both in m?"
            if calibrated
            else "(pixels, as dx was not given), so nothing is stitched; give dx in m."
        )
        raise DataError(
            f"stitch: all positions lie within {span.max():.3g} of one lateral step {hint} Repeats at "
            "one place are for repeatable"
        )


def _unit_doubts(values: tuple[FloatArray, ...], dx: float, dy: float) -> tuple[str, ...]:
    out = []
    if max(dx, dy) > _LARGEST_STEP:
        out.append(f"the lateral step is {max(dx, dy):.3g} m; is it in m? 10 um is 1e-5")
    span = max(float(np.nanmax(v) - np.nanmin(v)) for v in values)
    if span > _LARGEST_SPAN:
        out.append(f"the heights of one sub-aperture span {span:.3g} m; are they in m?")
    return tuple(out)
