"""Maps as callers give them: surfaces or arrays, checked, stacked, with their grid."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface

PIXELS = "no lateral step is known: positions x and y are in pixels, square ones"

_LEAST = 8


@dataclass(frozen=True, slots=True)
class MapGrid:
    """Where the pixels of a stack of maps lie, about the centre of rotation."""

    shape: tuple[int, int]  # rows and columns
    dx: float  # m: lateral steps; 1 where they are not known
    dy: float
    # of (float, float), m: position (x, y) of the centre of rotation from pixel [0, 0]
    centre: tuple[float, float]
    calibrated: bool  # whether the steps are in m

    @property
    def x(self) -> FloatArray:
        """Columns from the centre, shape (n_x,)."""
        return np.asarray(np.arange(self.shape[1]) * self.dx - self.centre[0], dtype=np.float64)

    @property
    def y(self) -> FloatArray:
        """Rows from the centre, shape (n_y,)."""
        return np.asarray(np.arange(self.shape[0]) * self.dy - self.centre[1], dtype=np.float64)


def map_stack(
    maps: Sequence[ArrayLike | Surface] | ArrayLike,
    *,
    what: str,
    names: Sequence[str] | None = None,
    least: int = 1,
    one_frame: bool = False,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
) -> tuple[FloatArray, MapGrid, tuple[Step, ...]]:
    """Return maps as one array with their grid, or refuse them."""
    items = _items(maps, what)
    called = list(names) if names is not None else [f"map {i + 1}" for i in range(len(items))]
    if len(called) != len(items):
        raise DataError(f"{what} needs {len(called)} maps ({', '.join(called)}), got {len(items)}")
    if len(items) < least:
        raise TooFewSamplesError(f"{what} needs at least {least} maps, got {len(items)}")
    surfaces = [i for i in items if isinstance(i, Surface)]
    if surfaces and len(surfaces) != len(items):
        raise DataError(f"{what}: give all maps as surfaces, or all as arrays, not mixed")
    if surfaces:
        if dx is not None or dy is not None:
            raise DataError(f"{what}: surfaces carry their own dx and dy; do not give them again")
        dx, dy = _common_steps(surfaces, what)
        if one_frame:
            _check_origins(surfaces, dx, what)
    arrays = [_array(i, name, what) for i, name in zip(items, called, strict=True)]
    shapes = {a.shape for a in arrays}
    if len(shapes) != 1:
        listed = ", ".join(str(a.shape) for a in arrays)
        raise DataError(f"{what}: maps of one shape are needed, got {listed}; resample them")
    ny, nx = shapes.pop()
    if min(ny, nx) < _LEAST:
        raise TooFewSamplesError(
            f"{what} needs maps of at least {_LEAST} x {_LEAST} pixels, got {ny} x {nx}"
        )
    grid = _grid((ny, nx), dx, dy, centre, what)
    history = tuple(step for s in surfaces for step in s.history)
    return np.stack(arrays), grid, history


def require_overlap(stack: FloatArray, what: str, *, least: int = 30) -> NDArray[np.bool_]:
    """Return the pixels that all maps have measured."""
    common: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(stack), axis=0)
    if common.sum() < least:
        raise DataError(
            f"{what}: only {int(common.sum())} pixels were measured in all maps, at least {least} "
            "are needed: the masks do not overlap; register and crop the maps first"
        )
    return common


def require_scale(grid: MapGrid, u_registration: ArrayLike, what: str) -> None:
    """Refuse an uncertainty of registration in m where steps are in pixels."""
    if not grid.calibrated and np.any(np.asarray(u_registration) != 0.0):
        raise DataError(
            f"{what}: u_registration is in m, but no lateral step is known; give dx= in m as well"
        )


def checked_u(value: object, name: str, unit: str = "m") -> float | None:
    """Return a stated uncertainty, or refuse it."""
    if value is None:
        return None
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if not isinstance(value, (int, float, np.integer, np.floating)):
        raise DataError(
            f"{name} must be one number, a standard uncertainty in {unit}, got {value!r}"
        )
    if not (math.isfinite(value) and value >= 0.0):
        raise DataError(f"{name} is {value}; it must be a standard uncertainty >= 0 in {unit}")
    return float(value)


def checked_angles(angles: ArrayLike, n: int, what: str) -> FloatArray:
    """Return rotation angles in rad, or refuse them."""
    try:
        found = np.atleast_1d(np.array(_real(angles), dtype=np.float64))
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{what}: angles hold no numbers ({exc})") from None
    if found.shape != (n,):
        raise DataError(
            f"{what} needs one angle for each of {n} maps, got an array of shape {found.shape}"
        )
    if not np.isfinite(found).all():
        raise DataError(f"{what}: angles must be finite, got {found.tolist()}")
    if np.abs(found).max() > 4.0 * np.pi + 1e-9:
        raise DataError(
            f"{what}: an angle is {float(np.abs(found).max()):.6g} rad, more than two turns; these "
            "look like degrees: give numpy.radians(angles)"
        )
    return found


def _items(
    maps: Sequence[ArrayLike | Surface] | ArrayLike, what: str
) -> list[ArrayLike | Surface]:
    one = isinstance(maps, Surface)
    if one or getattr(maps, "ndim", 3) < 3:
        raise InvalidSamplesError(
            f"{what} needs several maps: a list, or an array of shape (n, n_y, n_x)"
        )
    try:
        return list(maps)  # type: ignore[arg-type]
    except TypeError:
        raise InvalidSamplesError(
            f"{what} needs a list of maps, got {type(maps).__name__}"
        ) from None


def _array(item: ArrayLike | Surface, name: str, what: str) -> FloatArray:
    try:
        z = _real(item.z if isinstance(item, Surface) else item)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{what}: {name} holds no numbers ({exc})") from None
    if z.ndim != 2:
        raise InvalidSamplesError(f"{what}: {name} must have rows and columns, got {z.shape}")
    if np.isinf(z).any():
        i, j = (int(v) for v in np.argwhere(np.isinf(z))[0])
        raise InvalidSamplesError(
            f"{what}: {name} is infinite at [{i}, {j}]; mark what was not measured as NaN"
        )
    if z.size and np.isnan(z).all():
        raise InvalidSamplesError(f"{what}: {name} has no measured pixel")
    return z


def _real(values: ArrayLike) -> FloatArray:
    """Return a copy in float64, NaN where masked; complex numbers and text are refused."""
    if np.asarray(values).dtype.kind in "SU":
        raise TypeError("text")
    return as_float(values)


def _check_origins(surfaces: list[Surface], dx: float | None, what: str) -> None:
    first = surfaces[0].origin
    for i, other in enumerate(surfaces[1:], start=2):
        away = max(abs(a - b) for a, b in zip(first, other.origin, strict=True))
        if away > 1e-3 * (1.0 if dx is None else dx):
            raise DataError(
                f"{what}: map {i} begins at {other.origin} m, map 1 at {first} m; pixels are compared "
                "one by one, so crop the maps to one field and give them one origin"
            )


def _common_steps(surfaces: list[Surface], what: str) -> tuple[float | None, float | None]:
    first = surfaces[0]
    for i, other in enumerate(surfaces[1:], start=2):
        for name in ("dx", "dy"):
            a, b = getattr(first, name), getattr(other, name)
            if (a is None) != (b is None) or (a is not None and abs(a - b) > 1e-6 * a):
                raise DataError(
                    f"{what}: {name} of map {i} is {b} m, of map 1 {a} m; the maps must have one "
                    "lateral scale"
                )
    return first.dx, first.dy


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def _grid(
    shape: tuple[int, int],
    dx: float | None,
    dy: float | None,
    centre: tuple[float, float] | None,
    what: str,
) -> MapGrid:
    for name, step in (("dx", dx), ("dy", dy)):
        if step is None:
            continue
        if not _is_number(step):
            raise DataError(f"{what}: {name} must be a number in m, got {step!r}")
        if not (math.isfinite(step) and step > 0.0):
            raise DataError(f"{what}: {name} is {step} m; a lateral step must be positive")
    calibrated = dx is not None or dy is not None
    dx = dy if dx is None else dx
    step_x = 1.0 if dx is None else float(dx)
    step_y = step_x if dy is None else float(dy)
    middle = ((shape[1] - 1) / 2.0 * step_x, (shape[0] - 1) / 2.0 * step_y)
    if centre is None:
        return MapGrid(shape, step_x, step_y, middle, calibrated)
    try:
        cx, cy = (float(v) for v in centre)
    except (TypeError, ValueError):
        raise DataError(
            f"{what}: centre must be two numbers (x, y) in m, got {centre!r}"
        ) from None
    if not (0.0 <= cx <= 2.0 * middle[0] and 0.0 <= cy <= 2.0 * middle[1]):
        raise DataError(
            f"{what}: the centre ({cx:.6g}, {cy:.6g}) lies outside the map, which reaches from 0 to "
            f"{2 * middle[0]:.6g} in x and {2 * middle[1]:.6g} in y"
            + (" m" if calibrated else " pixels")
        )
    return MapGrid(shape, step_x, step_y, (cx, cy), calibrated)
