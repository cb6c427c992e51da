"""Maps as callers give them: surfaces or arrays, checked, stacked, with their grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray, IntArray, as_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import not_negative, positive, real
from metrosep.core.options import option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation.contract import Unobservable, as_stated, not_known, type_a

PIXELS = "no lateral step is known: positions x and y are in pixels, square ones"

_LEAST = 8
_DIMENSIONS = {"m": "length", "rad": "angle"}


def removed_option() -> Any:
    """Return the option of the terms that are set-up of a flat."""
    what = "terms that are set-up, not form: piston,tilt or piston,tilt,power"
    return option(("piston", "tilt"), kind="texts", help=what)


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
    """Return a stated uncertainty in SI, or None."""
    return None if value is None else not_negative(value, name, dimension=_DIMENSIONS.get(unit))


def stored_in_si(method: object, check: Callable[..., float], **dimensions: str) -> None:
    """Check fields of a frozen method that are stated, and store them in SI."""
    for name, dimension in dimensions.items():
        value = getattr(method, name)
        if value is not None:
            object.__setattr__(method, name, check(value, name, dimension=dimension))


def checked_removed(removed: Sequence[str]) -> None:
    """Refuse what alignment cannot decide."""
    for item in removed:
        if item not in REMOVABLE:
            raise DataError(f"removed may hold {', '.join(REMOVABLE)}, got {item!r}")


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


def _grid(
    shape: tuple[int, int],
    dx: float | None,
    dy: float | None,
    centre: tuple[float, float] | None,
    what: str,
) -> MapGrid:
    calibrated = dx is not None or dy is not None
    step_x, step_y = (
        1.0 if step is None else positive(step, f"{what}: {name}", dimension="length")
        for name, step in (("dx", dy if dx is None else dx), ("dy", dx if dy is None else dy))
    )
    middle = ((shape[1] - 1) / 2.0 * step_x, (shape[0] - 1) / 2.0 * step_y)
    if centre is None:
        return MapGrid(shape, step_x, step_y, middle, calibrated)
    try:
        cx, cy = (real(v, f"{what}: centre", dimension="length") for v in centre)
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


# ---- maps by classes of angular orders: which can be told apart, and sums of turned and mirrored maps ----
# Turns by multiples of 2 pi/N leave the angular orders m with the same remainder q = m mod N together
# (class q), so a separation is one small system of equations for each class. Its solution, put back
# together, is a sum of the readings, turned by multiples of 2 pi/N and mirrored, with fixed weights.

MOST_POSITIONS = 24
"""Largest N of turns by 2 pi/N that is worked pixel by pixel; beyond, polar or Zernike methods."""

LISTED_ORDERS = 60
"""Angular orders up to this one are listed where they are not observable."""

RIGID = ("piston", "tilt")
"""What alignment decides in each reading, unless the caller says otherwise."""

_ANGLE_TOLERANCE = 1e-6
_RANK_TOLERANCE = 1e-9
_USED = 1e-14


@dataclass(frozen=True, slots=True)
class Solved:
    """Least squares of one class or one order."""

    # of complex, shape (unknowns, readings): pseudo-inverse of the design: the least of all
    # solutions
    weights: ComplexArray
    seen: NDArray[np.bool_]  # shape (unknowns,): which unknowns are determined
    rank: int  # of the design
    # shape (unknowns,): standard deviation of each unknown for that of one reading
    gain: FloatArray


def solve_order(design: FloatArray | ComplexArray) -> Solved:
    """Return the least-squares solution of one design and what it determines."""
    u, s, vh = np.linalg.svd(np.asarray(design, dtype=np.complex128), full_matrices=True)
    floor = _RANK_TOLERANCE * (s[0] if s.size and s[0] > 0 else 1.0)
    rank = int((s > floor).sum())
    weights = (vh[:rank].conj().T / s[:rank]) @ u[:, :rank].conj().T
    hidden = np.sqrt((np.abs(vh[rank:]) ** 2).sum(axis=0))
    return Solved(weights, hidden < 1e-6, rank, np.sqrt((np.abs(weights) ** 2).sum(axis=1)))


def coarse(stack: FloatArray, grid: MapGrid, pixels: int) -> tuple[FloatArray, MapGrid]:
    """Return every k-th pixel of maps, symmetrically about the middle."""
    ny, nx = grid.shape
    k = max(1, max(ny, nx) // pixels)
    first_y, first_x = (ny - 1) % k // 2, (nx - 1) % k // 2
    small = stack[:, first_y::k, first_x::k]
    centre = (grid.centre[0] - first_x * grid.dx, grid.centre[1] - first_y * grid.dy)
    shape = (int(small.shape[1]), int(small.shape[2]))
    return small, MapGrid(shape, grid.dx * k, grid.dy * k, centre, grid.calibrated)


def common_step(angles: FloatArray) -> int | None:
    """Return the least N of which all angles are multiples of 2 pi/N."""
    for n in range(1, MOST_POSITIONS + 1):
        steps = angles * n / (2.0 * np.pi)
        if np.max(np.abs(steps - np.round(steps))) * 2.0 * np.pi / n < _ANGLE_TOLERANCE:
            return n
    return None


def class_share(q: int, n: int) -> float:
    """Return 1 for the classes 0 and N/2, which are real, and 2 for pairs q and N - q."""
    return 1.0 if q == 0 or 2 * q == n else 2.0


def orders_of(classes: Iterable[int], n: int, *, highest: int = LISTED_ORDERS) -> tuple[int, ...]:
    """Return the angular orders of classes q and N - q."""
    wanted = {q % n for q in classes} | {-q % n for q in classes}
    return tuple(m for m in range(highest + 1) if m % n in wanted)


def combined(
    stack: FloatArray,
    grid: MapGrid,
    direct: FloatArray,
    mirrored: FloatArray | None = None,
    *,
    flip: str = "x",
    offset: float = 0.0,
) -> FloatArray:
    """Return sums of turned and mirrored readings."""
    n_out, _, n = direct.shape
    out = np.zeros((n_out, *grid.shape))
    # R(k) after a mirror is a mirror after R(-k): both are summed first, and turned once
    back = None if mirrored is None else mirrored[:, :, -np.arange(n) % n]
    flipped = None if mirrored is None else np.ascontiguousarray(mirror(stack, flip))
    for rest, steps in _by_rest(n, quarters_by_index(grid)):
        weights = [direct[:, :, k] for k, _ in steps]
        weights += [] if back is None else [back[:, :, k] for k, _ in steps]
        squares = (np.stack(weights) ** 2).sum(axis=(0, 2))
        used = np.flatnonzero(squares > _USED**2)
        if used.size == 0:
            continue
        sums = np.zeros((used.size, *grid.shape))
        for k, quarters in steps:
            for i, p in enumerate(used):
                one = _weighted(stack, direct[p, :, k])
                if back is not None and flipped is not None:
                    one += _weighted(flipped, back[p, :, k])
                sums[i] += np.rot90(one, -quarters)
        out[used] += turned(sums, rest + offset, grid)[0]
    return out


def _by_rest(n: int, quarters: bool) -> list[tuple[float, list[tuple[int, int]]]]:
    """Return angles to interpolate by, each with its steps k and their quarter turns by index."""
    found: dict[int, list[tuple[int, int]]] = {}
    for k in range(n):
        turns, rest = divmod(4 * k, n) if quarters else (0, 4 * k)
        found.setdefault(rest, []).append((k, turns))
    return [(np.pi / 2.0 * rest / n, steps) for rest, steps in found.items()]


def mirror(z: FloatArray, flip: str) -> FloatArray:
    """Return a map (or a stack) with x or y reversed about the middle."""
    return z[..., ::-1] if flip == "x" else z[..., ::-1, :]


def _weighted(stack: FloatArray, weights: FloatArray) -> FloatArray:
    out = np.zeros(stack.shape[1:])
    for z, w in zip(stack, weights, strict=True):
        if abs(w) > _USED:
            out += w * z
    return out


def without_plane(
    z: FloatArray,
    grid: MapGrid,
    *,
    removed: Sequence[str] = RIGID,
    mask: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Return a map, or each map of a stack, minus its least-squares piston, tilt or power."""
    if z.ndim == 3:
        return np.stack([without_plane(one, grid, removed=removed, mask=mask) for one in z])
    valid = np.isfinite(z) if mask is None else mask & np.isfinite(z)
    if valid.sum() < 6:
        return np.full(z.shape, np.nan)
    x = grid.x / max(np.abs(grid.x).max(), np.abs(grid.y).max())
    y = grid.y / max(np.abs(grid.x).max(), np.abs(grid.y).max())
    columns = [np.ones(z.shape)] if "piston" in removed else []
    if "tilt" in removed:
        columns += [np.broadcast_to(x, z.shape), np.broadcast_to(y[:, None], z.shape)]
    if "power" in removed:
        columns.append(x**2 + y[:, None] ** 2)
    if not columns:
        return z.copy()
    chosen = np.stack([c[valid] for c in columns])
    found = np.linalg.lstsq(chosen @ chosen.T, chosen @ z[valid], rcond=None)[0]
    rest = z.copy()
    for c, column in zip(found, columns, strict=True):
        rest -= c * column
    return rest


# ---- turned, shifted and mirrored maps: exact by index where possible, else by polynomials -----
# Interpolation is by Lagrange polynomials through the 6 x 6 pixels around each position (exact for
# polynomials up to degree 5), without a global prefilter: a missing pixel costs its neighbours only.
# The error of a wave with L pixels per period is below ``0.005 (2 pi / L)**6`` of its amplitude: 1e-7 at
# L = 40, 1e-3 at L = 8.

_NODES = np.arange(-2.0, 4.0)
_BLOCK = 65536
_SNAP = 1e-9


def turned(
    stack: FloatArray,
    angle: float,
    grid: MapGrid,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
) -> tuple[FloatArray, float]:
    """Return maps turned counter-clockwise and the share of a white variance that is left."""
    by_index = _by_index(stack, angle, grid, shift)
    if by_index is not None:
        return by_index, 1.0
    c, s = math.cos(angle), math.sin(angle)
    x, y = grid.x - shift[0], grid.y - shift[1]
    columns = ((c * x + s * y[:, None] + grid.centre[0]) / grid.dx).ravel()
    rows = ((-s * x + c * y[:, None] + grid.centre[1]) / grid.dy).ravel()
    found, share = interpolated(stack, rows, columns)
    return found.reshape(stack.shape), share


def interpolated(
    stack: FloatArray, rows: FloatArray, columns: FloatArray
) -> tuple[FloatArray, float]:
    """Return values of maps at fractional indices by 6 x 6 Lagrange polynomials."""
    n_rows, n_columns = stack.shape[1:]
    flat = np.ascontiguousarray(stack.reshape(stack.shape[0], -1))
    measured: NDArray[np.bool_] = np.logical_or.reduce(np.isfinite(flat), axis=0)
    out = np.full((flat.shape[0], rows.size), np.nan)
    total, count = 0.0, 0
    for start in range(0, rows.size, _BLOCK):
        r, c = rows[start : start + _BLOCK], columns[start : start + _BLOCK]
        i, j = np.floor(r).astype(np.intp) - 2, np.floor(c).astype(np.intp) - 2
        inside = (i >= 0) & (i + 5 < n_rows) & (j >= 0) & (j + 5 < n_columns)
        first = i * n_columns + j
        inside[inside] = measured[first[inside] + 2 * n_columns + 2]
        chosen = np.flatnonzero(inside)
        if chosen.size == 0:
            continue
        first = first[chosen]
        wx, wy = lagrange_weights(c[chosen]), lagrange_weights(r[chosen])
        total += float(((wx**2).sum(axis=0) * (wy**2).sum(axis=0)).sum())
        count += chosen.size
        for k in range(flat.shape[0]):
            out[k, start + chosen] = _sum_of_36(flat[k], first, n_columns, wx, wy)
    return out, total / count if count else 1.0


def _sum_of_36(
    values: FloatArray, first: NDArray[np.intp], width: int, wx: FloatArray, wy: FloatArray
) -> FloatArray:
    found, line, term = np.zeros((3, first.size))
    for a in range(6):
        line[:] = 0.0
        for b in range(6):
            np.take(values[a * width + b :], first, out=term, mode="clip")
            term *= wx[b]
            line += term
        line *= wy[a]
        found += line
    return found


def quarters_by_index(grid: MapGrid) -> bool:
    """Return whether turns by 90 degrees only move indices."""
    ny, nx = grid.shape
    return _about_middle(grid) and ny == nx and abs(grid.dx / grid.dy - 1.0) <= _SNAP


def _about_middle(grid: MapGrid) -> bool:
    ny, nx = grid.shape
    x, y = grid.centre[0] / grid.dx - (nx - 1) / 2.0, grid.centre[1] / grid.dy - (ny - 1) / 2.0
    return max(abs(x), abs(y)) <= _SNAP


def _by_index(
    stack: FloatArray, angle: float, grid: MapGrid, shift: tuple[float, float]
) -> FloatArray | None:
    """Return maps that only indices have to be moved for, else None."""
    if shift != (0.0, 0.0):
        columns, rows = shift[0] / grid.dx, shift[1] / grid.dy
        whole = abs(columns - round(columns)) < _SNAP and abs(rows - round(rows)) < _SNAP
        if not whole or abs(angle) > 1e-12:
            return None
        return _moved(stack, round(columns), round(rows))
    quarter = angle / (np.pi / 2.0)
    turns = round(quarter)
    if abs(quarter - turns) > _SNAP:
        return None
    if turns % 4 == 0:
        return stack.copy()
    if not (quarters_by_index(grid) if turns % 2 else _about_middle(grid)):
        return None
    return np.rot90(stack, -turns, axes=(1, 2)).copy()  # rows grow with y: counter-clockwise


def _moved(stack: FloatArray, columns: int, rows: int) -> FloatArray:
    ny, nx = stack.shape[1:]
    y, x = np.arange(ny) - rows, np.arange(nx) - columns
    inside = np.outer((y >= 0) & (y < ny), (x >= 0) & (x < nx))
    taken = stack[:, np.clip(y, 0, ny - 1)][:, :, np.clip(x, 0, nx - 1)]
    return np.where(inside, taken, np.nan)


def lagrange_weights(position: FloatArray) -> FloatArray:
    """Return the weights of the six samples around each position."""
    t = position - np.floor(position)
    d = t - _NODES[:, None]
    weights = np.empty((6, position.size))
    for a, node in enumerate(_NODES):
        others = [b for b in range(6) if b != a]
        scale = float(np.prod([node - _NODES[b] for b in others]))
        np.multiply(d[others[0]], d[others[1]] / scale, out=weights[a])
        for b in others[2:]:
            weights[a] *= d[b]
    return weights


# ---- what separations of maps share: noise from redundancy, terms that alignment decides -------

REMOVABLE = {"piston": ("piston",), "tilt": ("tilt x", "tilt y"), "power": ("defocus",)}
"""What may be removed from each reading, and the terms that this is."""

_FEWEST_FREEDOMS = 10.0


def noise_of(residual: FloatArray, freedom: float, u_reading: float | None) -> Quantity:
    """Return the noise of one pixel, stated or pooled from the residual."""
    if u_reading is not None:
        return as_stated(float(u_reading), "m", "pixel of one reading")
    if freedom < _FEWEST_FREEDOMS:
        return not_known("m", "pixel")
    known = np.isfinite(residual).all(axis=0)
    value = math.sqrt(float((residual[:, known] ** 2).sum()) / freedom)
    text = "standard deviation of one pixel of one reading, from what the model leaves (type A)"
    return type_a(value, "m", text, freedom)


def rigid_terms(parts: Sequence[str], removed: Sequence[str]) -> tuple[Unobservable, ...]:
    """Return piston, tilt and what else alignment decides, for each part."""
    terms = tuple(term for item in removed for term in REMOVABLE[item])
    if not terms:
        return ()
    reason = "each set-up is aligned anew, so these terms are removed by least squares"
    return tuple(Unobservable(part, "term", terms, reason) for part in parts)


# ---- variance, pixel by pixel, of sums of turned and mirrored maps with white noise ------------
# A turned map is interpolated: its value is a sum of 6 x 6 pixels. Near the axis the same reading,
# turned by two angles, takes the same pixels twice, and on the lines that a mirror keeps, the reading
# and its mirror image do: their noise adds with its sign there and not as squares. The overlap of two
# such sums is a product of one along x and one along y.

_REACH = 6.0
_DEGREE = 5


class TurnedNoise:
    """Overlaps of the turned and mirrored copies of one white map."""

    def __init__(self, grid: MapGrid, n: int, flip: str = "x", offset: float = 0.0) -> None:
        self.grid, self.n, self.flip = grid, n, flip
        self.angles = offset + 2.0 * np.pi * np.arange(n) / n
        # turned by 90 deg more, both copies take the same pixels of a square map turned back
        self.orbit = 4 if n % 4 == 0 and quarters_by_index(grid) else 1
        x, y = np.broadcast_arrays(grid.x, grid.y[:, None])
        self.x, self.y = x.ravel(), y.ravel()
        self.radius = np.hypot(self.x, self.y)
        self.reach = _REACH * math.hypot(grid.dx, grid.dy)

    def variance(self, direct: FloatArray, mirrored: FloatArray | None = None) -> FloatArray:
        """Return the variance of sums of copies for readings with noise of variance 1."""
        shape = (direct.shape[0], *self.grid.shape)
        total = self._one_kind(direct).reshape(shape)
        if mirrored is not None:
            total = total + mirror(self._one_kind(mirrored).reshape(shape), self.flip)
            total = total + 2.0 * self._both_kinds(direct, mirrored).reshape(shape)
        return np.asarray(np.maximum(total, 0.0))

    def _one_kind(self, weights: FloatArray) -> FloatArray:
        products = np.einsum("psk,psl->pkl", weights, weights)
        out = np.zeros((weights.shape[0], self.x.size))
        for k, other, product in self._orbits(products):
            if k == other:
                out += np.outer(product, self._own(k))
            else:
                turn = abs(math.sin((self.angles[k] - self.angles[other]) / 2.0))
                near = np.flatnonzero(self.radius < self.reach / (2.0 * turn))
                self._add(out, near, product, self._at(k, near), self._at(other, near))
        return out

    def _both_kinds(self, direct: FloatArray, mirrored: FloatArray) -> FloatArray:
        products = np.einsum("psk,psl->pkl", direct, mirrored)
        out = np.zeros((direct.shape[0], self.x.size))
        strips: dict[int, IntArray] = {}
        for k, other, product in self._orbits(products):
            apart = (k - other) % self.n
            if apart not in strips:
                strips[apart] = self._strip(k, other)
            near = strips[apart]
            self._add(out, near, product, self._at(k, near), self._at(other, near, mirror=True))
        return out

    def _orbits(self, products: FloatArray) -> list[tuple[int, int, FloatArray]]:
        """Return pairs of copies with other overlaps, and what they count in each sum."""
        step = self.n // self.orbit
        out = []
        for k in range(step):
            for other in range(self.n):
                j = step * np.arange(self.orbit)
                product = products[:, (k + j) % self.n, (other + j) % self.n].sum(axis=1)
                if np.abs(product).max() > _USED:
                    out.append((k, other, product))
        return out

    def _strip(self, k: int, other: int) -> IntArray:
        """Return the pixels along the line that the two copies take from the same place."""
        half = (self.angles[k] - self.angles[other]) / 2.0
        line = half + (np.pi / 2.0 if self.flip == "x" else 0.0)
        away = np.abs(self.y * math.cos(line) - self.x * math.sin(line))
        return np.flatnonzero(away < self.reach / 2.0)

    def _at(
        self, k: int, chosen: IntArray | slice, *, mirror: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the columns and rows that a copy takes its values from."""
        x, y = self.x[chosen], self.y[chosen]
        if mirror:
            x, y = (-x, y) if self.flip == "x" else (x, -y)
        c, s = math.cos(self.angles[k]), math.sin(self.angles[k])
        columns = (c * x + s * y + self.grid.centre[0]) / self.grid.dx
        rows = (-s * x + c * y + self.grid.centre[1]) / self.grid.dy
        return _whole_where_close(columns), _whole_where_close(rows)

    def _own(self, k: int) -> FloatArray:
        columns, rows = self._at(k, slice(None))
        return _sum_of_squares(columns) * _sum_of_squares(rows)

    @staticmethod
    def _add(
        out: FloatArray,
        near: IntArray,
        product: FloatArray,
        first: tuple[FloatArray, FloatArray],
        second: tuple[FloatArray, FloatArray],
    ) -> None:
        close = (np.abs(first[0] - second[0]) < _REACH) & (np.abs(first[1] - second[1]) < _REACH)
        if not close.any():
            return
        value = overlap(first[0][close], second[0][close])
        value *= overlap(first[1][close], second[1][close])
        out[:, near[close]] += np.outer(product, value)


def overlap(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sum of the products of the interpolation weights of two positions on a line."""
    whole_a, whole_b = np.floor(a), np.floor(b)
    apart = (whole_b - whole_a).astype(np.intp)
    wa, wb = lagrange_weights(a), lagrange_weights(b)
    out = np.zeros(a.size)
    for d in range(-5, 6):
        here = np.flatnonzero(apart == d)
        if here.size:
            mine, other = slice(max(0, d), 6 + min(0, d)), slice(max(0, -d), 6 + min(0, -d))
            out[here] = np.einsum("ij,ij->j", wa[mine][:, here], wb[other][:, here])
    return out


def _whole_where_close(position: FloatArray) -> FloatArray:
    nearest = np.round(position)
    return np.where(np.abs(position - nearest) < 1e-9, nearest, position)


def _sum_of_squares(position: FloatArray) -> FloatArray:
    """Return `overlap` of positions with themselves: a polynomial in (t - 1/2)**2."""
    t = position - np.floor(position)
    return np.asarray(np.polynomial.polynomial.polyval((t - 0.5) ** 2, _SQUARES))


def _square_polynomial() -> FloatArray:
    t = (1.0 - np.cos(np.pi * np.arange(_DEGREE + 1) / _DEGREE)) / 4.0
    values = (lagrange_weights(t) ** 2).sum(axis=0)
    found: FloatArray = np.linalg.solve(np.vander((t - 0.5) ** 2, increasing=True), values)
    return found


_SQUARES = _square_polynomial()


# ---- whether what a model leaves of maps is noise, and whether maps are in the units they should be ----

_SMOOTHER = 1.2
_NEGLIGIBLE = 1e-3
_HIGHEST = 1e-3
_COARSEST = 0.1


def mirrored_trials(
    stack: FloatArray, left: Callable[[FloatArray], float]
) -> Iterator[tuple[float, int, str]]:
    """Yield what is left of the readings with one of them mirrored, which one, and how."""
    for i in range(stack.shape[0]):
        for axis in ("x", "y"):
            flipped = stack.copy()
            flipped[i] = mirror(stack[i], axis)
            yield left(flipped), i, axis


def smoothness(residual: FloatArray) -> float:
    """Return the RMS of maps over that of the steps between neighbours, 1 for white noise."""
    steps = np.concatenate([np.diff(residual, axis=k).ravel() for k in (1, 2)])
    steps, known = steps[np.isfinite(steps)], residual[np.isfinite(residual)]
    if steps.size == 0 or not known.any():
        return 1.0
    rough = math.sqrt(float(np.mean(steps**2)) / 2.0)
    return math.sqrt(float(np.mean(known**2))) / rough if rough > 0.0 else math.inf


def residual_warnings(
    residual: FloatArray, readings: FloatArray, *, expected: float = 1.0
) -> tuple[str, ...]:
    """Say that the residual is not noise: neighbours resemble each other more than noise would."""
    known = residual[np.isfinite(residual)]
    read = readings[np.isfinite(readings)]
    if known.size < 200 or read.size == 0:
        return ()
    left = math.sqrt(float(np.mean(known**2)))
    size = math.sqrt(float(np.mean(read**2)))
    found = smoothness(residual)
    if left <= _NEGLIGIBLE * size or found <= (_SMOOTHER + 3.0 / math.sqrt(known.size)) * expected:
        return ()
    text = (
        f"the residuals are not noise: {left * 1e9:.3g} nm RMS are left and neighbouring pixels "
        "resemble each other; check the set-up (angles, order and sign of the maps, which part was "
        "turned, centring). u takes them as noise of single pixels and does not cover such errors"
    )
    return (text,)


def unit_warnings(
    stack: FloatArray, grid: MapGrid, angles: FloatArray | None = None
) -> tuple[str, ...]:
    """Say that heights, steps or angles look as if they were in other units."""
    found = []
    span = float(np.nanmax(stack) - np.nanmin(stack))
    if span > _HIGHEST:
        found.append(
            f"the heights span {span:.3g} m, more than 1 mm; heights are in m: are these nm or um?"
        )
    step = max(grid.dx, grid.dy)
    if grid.calibrated and step > _COARSEST:
        found.append(f"the lateral step is {step:.3g} m; steps are in m: is this mm or um?")
    if angles is not None and angles.size:
        most = float(np.abs(angles).max())
        if most > 2.0 * math.pi + 1e-9:
            found.append(
                f"an angle is {most:.6g} rad, more than a turn ({math.degrees(most):.4g} deg); "
                "if it is in degrees, give numpy.radians(angles)"
            )
    return tuple(found)
