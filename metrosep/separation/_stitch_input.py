"""Sub-apertures as callers give them: maps or profiles with positions, brought to one grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MOST_PIXELS = 60_000_000
"""Largest stitched map; beyond it a position is more likely wrong than the part that large."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Sub-apertures with their positions, in one lateral scale.

    Parameters
    ----------
    values : tuple of ndarray, shape (n_y, n_x), m
        Readings; profiles have one row.
    corners : ndarray, shape (n, 2), m
        Position (x, y) of the first pixel of each, as if it were not turned.
    turns : ndarray, shape (n,), rad
        By which each lies turned on the part, counter-clockwise about its centre.
    dx, dy : float, m
        Lateral steps.
    line : bool
        Whether they are profiles.
    history : tuple of Step
        Of all of them.
    calibrated : bool
        Whether steps and positions are in m.
    """

    values: tuple[FloatArray, ...]
    corners: FloatArray
    turns: FloatArray
    dx: float
    dy: float
    line: bool
    history: tuple[Step, ...] = ()
    calibrated: bool = True

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
    """Return sub-apertures of any accepted kind, checked.

    Parameters
    ----------
    maps : sequence
        Surfaces, profiles or arrays, all of one kind.
    positions : array_like or None, m
        Of arrays: (n, 2) for maps, (n,) for profiles.
    rotations : array_like or None, rad
        Of maps.
    dx, dy : float or None, m
        Steps of arrays.

    Returns
    -------
    Pieces
        Copies.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If they cannot be stitched.
    """
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
    _sane(corners, arrays, step_x, step_y)
    history = tuple(s for i in items if own_steps for s in i.history)
    values = tuple(np.atleast_2d(a) for a in arrays)
    return Pieces(values, corners, turns, step_x, step_y, line, history, calibrated)


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
    try:
        z = np.array(item, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"stitch: sub-aperture {k + 1} holds no numbers ({exc})"
        ) from None
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
        first = 1.0 if dx is None else float(dx)
        steps = [(first, first if dy is None else float(dy))]
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
    try:
        found = np.array(positions, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"stitch: positions hold no numbers ({exc})") from None
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
    turns = np.atleast_1d(np.array(rotations, dtype=np.float64))
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


def _sane(corners: FloatArray, arrays: list[FloatArray], dx: float, dy: float) -> None:
    shapes = [np.atleast_2d(a).shape for a in arrays]
    wide = np.ptp(corners[:, 0]) / dx + max(s[1] for s in shapes)
    high = np.ptp(corners[:, 1]) / dy + max(s[0] for s in shapes)
    if wide * high > MOST_PIXELS:
        raise DataError(
            f"stitch: the positions span {wide:.4g} x {high:.4g} pixels, more than can be stitched; "
            "are positions and steps both in m?"
        )
