"""Rotations of a part in front of an instrument: what turns with the part and what stays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.core.numbers import not_negative, positive
from metrosep.core.options import Option, option
from metrosep.core.surface import Surface
from metrosep.separation.contract import U_READING, Parts, Separation, Unobservable
from metrosep.separation.maps._map_input import (
    LISTED_ORDERS,
    RIGID,
    MapGrid,
    TurnedNoise,
    checked_angles,
    checked_removed,
    class_share,
    coarse,
    combined,
    common_step,
    interpolated,
    mirrored_trials,
    noise_of,
    orders_of,
    removed_option,
    require_scale,
    residual_warnings,
    rigid_terms,
    smoothness,
    solve_order,
    stored_in_si,
    turned,
    unit_warnings,
    without_plane,
)
from metrosep.separation.maps._map_method import MapMethod, MapReadings, map_separation
from metrosep.separation.maps.registration import (
    extended,
    map_gradient,
    registration_spread,
)


@described_by(MapMethod)
@dataclass(frozen=True, slots=True)
class RotationTest(MapMethod):
    """Part measured in several rotations: ``M_i(p) = I(p) + P(R(-angle_i) p)`` and a plane each.

    One map for each angle. Parts: ``part``, as it lies at angle 0, and ``instrument``, without the
    angular orders (listed up to 60) and terms of the null space; ``unseparated``, the sum of both in
    those orders. A simulated map is NaN where the turned part would need pixels that are missing.

    Parameters
    ----------
    largest_gain : float, optional
        Orders whose noise would grow by more than this factor are taken as not observable.
    """

    angles: Sequence[float] = option(
        kind="angles",
        help="turn of the part in each map, counter-clockwise (from +x towards +y), in their order",
    )
    dx: float | None = None
    dy: float | None = None
    centre: tuple[float, float] | None = None
    removed: tuple[str, ...] = removed_option()
    u_registration: float = option(
        0.0,
        kind="uncertainty",
        help="standard uncertainty of the centring of each rotated reading along x and along y",
    )
    u_angle: float = option(0.0, kind="angle", help="standard uncertainty of each angle")
    largest_gain: float = 20.0

    name = "rotation_average"
    what = "part and instrument from maps of the part in several rotations; a file an angle"
    reads = "maps"
    arguments: ClassVar[Mapping[str, Option]] = U_READING
    truth_parts = ("part",)
    error_parts = ("instrument",)

    def __post_init__(self) -> None:
        given = np.atleast_1d(np.asarray(self.angles, dtype=object))
        angles = checked_angles(self.angles, given.size, self.name)
        object.__setattr__(self, "angles", tuple(angles.tolist()))
        away = np.abs(np.exp(1j * (angles - angles[0])) - 1.0).max()
        if angles.size < 2 or away < 1e-6:
            raise NotSeparableError(
                f"{self.name}: the part was not turned ({angles.size} readings at one angle), so "
                "part and instrument cannot be distinguished; measure at two angles or more"
            )
        checked_removed(self.removed)
        stored_in_si(self, positive, dx="length", dy="length")
        stored_in_si(self, not_negative, u_registration="length", u_angle="angle")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        (part, instrument), grid = self._given(truth, errors)
        return np.stack([instrument + turned(part[None], a, grid)[0][0] for a in self.angles])

    def null_space(self) -> tuple[Unobservable, ...]:
        hidden = RotationSolver(np.array(self.angles), self.largest_gain).hidden
        n = common_step(np.array(self.angles) - self.angles[0])
        further = (
            f"; further orders follow in steps of {n}"
            if n is not None and n <= LISTED_ORDERS
            else ""
        )
        reason = (
            "the turned part looks the same at all these angles, so only the sum of part and "
            f"instrument is known (part 'unseparated'){further}; an angle between would tell more of them"
        )
        orders = tuple(
            Unobservable(p, "angular order", hidden, reason) for p in ("part", "instrument")
        )
        return orders + rigid_terms(("part", "instrument"), self.removed)

    def _names(self) -> list[str]:
        return [f"map {i + 1}" for i in range(len(self.angles))]

    def _separated(self, read: MapReadings) -> Separation:
        stack, grid, common, u_reading, history = read
        require_scale(grid, self.u_registration, self.name)
        stack = without_plane(stack, grid, removed=self.removed, mask=common)
        angles = np.array(self.angles)
        solver = RotationSolver(angles, self.largest_gain)
        solution = solver.solve(stack, grid, removed=self.removed)
        instrument, part, _ = solution.parts
        if not np.isfinite(part).any():
            raise DataError(
                f"{self.name}: no pixel has its turned counterparts in all maps; give maps with a "
                "common round aperture about the centre of rotation"
            )
        noise = noise_of(solution.residual, solution.freedom, u_reading)
        u = noise.value * np.sqrt(solution.variance)
        named = {"part": part, "instrument": instrument, "unseparated": solution.parts[2]}
        u_maps = {
            name: np.where(np.isfinite(named[name]), s, np.nan)
            for name, s in zip(named, (u[1], u[0], u[2]), strict=True)
        }
        if self.u_registration > 0.0 or self.u_angle > 0.0:
            # the unseparated sum may be the part's: its slopes count wholly, an upper bound
            known = np.isfinite(part)

            def linear(readings: FloatArray) -> FloatArray:
                found = solver.parts(readings, grid)
                return without_plane(found, grid, removed=self.removed, mask=known)

            whole = self._effects(part, solution.parts[2], grid)
            shares = np.asarray(registration_spread(linear, angles.size, whole))
            for name, share in zip(("instrument", "part", "unseparated"), shares, strict=True):
                both = np.hypot(u_maps[name], share)
                u_maps[name] = np.where(np.isfinite(named[name]), both, np.nan)
        messages = warnings_of_rotations(stack, angles, grid, self.largest_gain)
        if not messages:
            messages = residual_warnings(solution.residual, stack, expected=solution.smoothness)
        messages = (*unit_warnings(stack, grid, angles), *messages, *lost_pixels(stack, part))
        audit = {
            "angles_deg": [math.degrees(a) for a in self.angles],
            "method": "pixels, classes of angular orders" if solver.n else "circles",
            "positions_in_a_turn": solver.n,
            "removed": ", ".join(self.removed),
            "n_pixels_common": int(np.isfinite(stack).all(axis=0).sum()),
            "n_pixels_result": int(np.isfinite(part).sum()),
            "u_registration_um": self.u_registration * 1e6,
            "u_angle_mrad": self.u_angle * 1e3,
        }
        return map_separation(
            self.name, grid, named, u_maps, self.null_space(), noise, audit, messages, history,
            {"angles_rad": list(self.angles)},
        )  # fmt: skip

    def _effects(
        self, part: FloatArray, unseparated: FloatArray, grid: MapGrid
    ) -> Iterator[tuple[int, FloatArray]]:
        """Yield what centring and angle of each reading change in it: gradient times shift."""
        for i, angle in enumerate(self.angles):
            moved = turned(part[None], angle, grid)[0][0] + unseparated
            gx, gy = (extended(g) for g in map_gradient(moved, grid))
            if self.u_registration > 0.0:
                yield i, gx * self.u_registration
                yield i, gy * self.u_registration
            if self.u_angle > 0.0:
                yield i, (grid.x * gy - grid.y[:, None] * gx) * self.u_angle


@described_by(RotationTest, RotationTest.separate)
def rotation_average(
    surfaces: Sequence[ArrayLike | Surface],
    angles: ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    removed: tuple[str, ...] = ("piston", "tilt"),
    u_reading: float | None = None,
    u_registration: float = 0.0,
    u_angle: float = 0.0,
) -> Separation:
    """Return part and instrument from maps of the part in several rotations (N-position test).

    Parameters
    ----------
    surfaces : sequence of Surface or array_like, shape (n_y, n_x), m
        One map for each angle; NaN = not measured.
    u_registration : float, m, optional
        Standard uncertainty of the centring of each map along x and along y. It enters by the slopes
        of ``part + unseparated``: an upper bound, as if the unseparated sum were all of the part.

    Returns
    -------
    Separation
        ``.part`` (as it lies at angle 0) and ``.instrument`` without the orders of the null space;
        ``.unseparated``, the sum of both in those orders.

    Notes
    -----
    Model: ``M_i(r, t) = I(r, t) + P(r, t - angle_i)`` and a plane for each map. For each angular
    order m the readings are ``I_m + exp(-j m angle_i) P_m``: least squares with the determinant
    ``n**2 - |sum exp(j m angle_i)|**2``. It is zero for m = 0 and, with n equal steps, for m = k n:
    there only the sum is known. The rotationally symmetric share is never separable by turns.
    n equal steps give ``I = mean M_i - U``, ``P = mean R(-angle_i) M_i - U``, with the variance
    ``s**2 (1 - 1/n)/n``. Angles that are multiples of one step 2 pi/N, N <= 24, are worked pixel by
    pixel; a result pixel needs its N turned counterparts. Other angles go by Fourier series on
    circles; a circle with a gap is lost. Turns by 90 degrees are exact, others interpolate
    (an error of 1e-3 for waves of 8 pixels) and lose about three at the rim, circles about six.

    References
    ----------
    C. J. Evans, R. N. Kestner, Appl. Opt. 35 (1996) 1015-1021.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 65)
    >>> part = 20e-9 * (x**3 - x) * x[:, None]
    >>> maps = [np.rot90(part, -k) + 5e-9 * x * x[:, None] for k in range(4)]
    >>> result = rotation_average(maps, np.radians([0, 90, 180, 270]))
    >>> result.null_space[0].indices[:3]
    (0, 4, 8)
    """
    turns, maps = cast(Any, angles), cast(Any, surfaces)
    method = RotationTest(turns, dx, dy, centre, tuple(removed), u_registration, u_angle)
    return method.separate(maps, u_reading=u_reading)


# ---- warnings about maps that a separation can raise itself: mirrored maps, angles of the other sign ----

_COARSE = 64
_BETTER = 0.5
_ROUND_OFF = 1e-6
_RIM = 9.0
_MUCH = 0.02


def warnings_of_rotations(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> tuple[str, ...]:
    """Return what would explain the readings much better: other signs, a mirrored map."""
    small, small_grid = coarse(stack, grid, _COARSE)
    solver = RotationSolver(angles, largest_gain)
    if solver.n is None:
        return ()
    as_given = _left(solver, small, small_grid)
    size = math.sqrt(float(np.nanmean(small**2)))
    if not as_given > _ROUND_OFF * size:
        return ()
    other = _left(RotationSolver(-angles, largest_gain), small, small_grid)
    if other < _BETTER * as_given:
        text = (
            "the readings fit angles of the opposite sign much better "
            f"({other * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm): angles count "
            "counter-clockwise from +x (columns) towards +y (rows); check rows and sign"
        )
        return (text,)
    trials = mirrored_trials(small, lambda maps: _left(solver, maps, small_grid))
    found = [trial for trial in trials if trial[0] < _BETTER * as_given]
    if not found:
        return ()
    left, i, axis = min(found)
    text = (
        f"map {i + 1} looks mirrored: with {axis} reversed the readings fit much better "
        f"({left * 1e9:.3g} nm left instead of {as_given * 1e9:.3g} nm)"
    )
    return (text,)


def lost_pixels(stack: FloatArray, part: FloatArray) -> tuple[str, ...]:
    """Say that gaps cost much more than themselves: their turned counterparts, or whole circles."""
    from scipy import ndimage

    common: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(stack), axis=0)
    field = np.pad(ndimage.binary_fill_holes(common), 1)
    inner = ndimage.distance_transform_edt(field)[1:-1, 1:-1] > _RIM
    lost = int((inner & common & ~np.isfinite(part)).sum())
    if lost <= _MUCH * inner.sum():
        return ()
    text = (
        f"{lost} pixels that all maps have measured, away from the rim, have no result: a gap or a corner costs its "
        "turned counterparts, and its whole circle where the angles are not multiples of one step"
    )
    return (text,)


def _left(solver: RotationSolver, stack: FloatArray, grid: MapGrid) -> float:
    if not np.isfinite(solver.parts(stack, grid)).all(axis=0).any():
        return math.nan
    residual = solver.solve(stack, grid).residual
    known = residual[np.isfinite(residual)]
    return math.sqrt(float(np.mean(known**2))) if known.size else math.nan


# ---- least squares of an N-position test: by pixels and classes of orders, or on circles -------

_SEED = 20260727
_INNER = 44
_RINGS = 14
_TRIALS = 150
_AT_ONCE = 30


@dataclass(frozen=True, slots=True)
class RotationSolution:
    """Maps of one evaluation."""

    # shape (3, n_y, n_x): instrument, part at angle 0, sum of both that is not separable
    parts: FloatArray
    residual: FloatArray  # shape (S, n_y, n_x): what the model leaves of each reading
    freedom: float  # degrees of freedom of the residual
    # shape (3, n_y, n_x): of each part for white noise of variance 1, pixel by pixel
    variance: FloatArray
    # RMS over steps between neighbours (`smoothness`) that the residual of white noise has
    smoothness: float = 1.0


class RotationSolver:
    """The linear operation from readings to parts for one set of angles."""

    def __init__(self, angles: FloatArray, largest_gain: float) -> None:
        self.largest_gain = largest_gain
        self.n, self.first = common_step(angles), 0.0
        relative = common_step(angles - angles[0])
        if relative is not None and (self.n is None or relative < self.n):
            # the part is found as it lies in the first reading, and turned back at the end
            self.n, self.first = relative, float(angles[0])
        self.angles = angles - self.first
        angles = self.angles
        self.weights: FloatArray | None = None
        self.freedom = 0.0
        if self.n is not None:
            self.weights, lost, self.freedom = _pixel_weights(angles, self.n, largest_gain)
            self.hidden = orders_of(lost, self.n)
        else:
            self.hidden = order_weights(tuple(angles.tolist()), LISTED_ORDERS, largest_gain)[1]

    def parts(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return instrument, part at angle 0 and inseparable sum."""
        return self._at_zero(self._parts_in_first(stack, grid), stack, grid)

    def _parts_in_first(self, stack: FloatArray, grid: MapGrid) -> FloatArray:
        """Return the parts, the turned one as it lies in the first reading."""
        if self.weights is not None:
            return combined(stack, grid, self.weights)
        return solve_polar(stack, self.angles, grid, self.largest_gain)

    def _at_zero(self, parts: FloatArray, stack: FloatArray, grid: MapGrid) -> FloatArray:
        if self.weights is None or self.first == 0.0:
            return parts
        back = combined(stack, grid, self.weights[1:2], offset=-self.first)
        return np.stack([parts[0], back[0], parts[2]])

    def solve(
        self, stack: FloatArray, grid: MapGrid, *, removed: Sequence[str] = RIGID
    ) -> RotationSolution:
        """Return the parts of readings with what is left of each reading."""
        parts, residual, exact = self._once(stack, grid, removed)
        if not np.isfinite(residual).any():
            return RotationSolution(parts, residual, 0.0, np.full(parts.shape, np.nan))
        n_pixels = float(np.isfinite(residual).all(axis=0).sum())
        if exact and self.weights is not None:
            variance = self._variance(self.weights, grid)
            return RotationSolution(parts, residual, self.freedom * n_pixels, variance)
        # interpolation smooths noise: the same operations on noise of variance 1 say by how much
        rng = np.random.default_rng(_SEED)
        small, small_grid = coarse(stack, grid, 128)
        unit = np.where(np.isfinite(small), rng.standard_normal(small.shape), np.nan)
        left = self._once(unit, small_grid, removed)[1]
        known = np.isfinite(left).all(axis=0)
        if not known.any():
            return RotationSolution(parts, residual, 0.0, np.full(parts.shape, np.nan))
        freedom = float((left[:, known] ** 2).sum(axis=0).mean())
        if self.weights is not None:
            variance = self._variance(self.weights, grid)
        else:
            variance = self._variance_on_circles(grid)
        return RotationSolution(parts, residual, freedom * n_pixels, variance, smoothness(left))

    def _variance(self, weights: FloatArray, grid: MapGrid) -> FloatArray:
        n = weights.shape[2]
        variance = TurnedNoise(grid, n).variance(weights)
        if self.first != 0.0:
            variance[1] = TurnedNoise(grid, n, offset=-self.first).variance(weights[1:2])[0]
        return variance

    def _variance_on_circles(self, grid: MapGrid) -> FloatArray:
        """Return the variance by radius: a small circle shows few orders, a large one many."""
        step = min(grid.dx, grid.dy)
        fractions = tuple(
            round(c / d % 1.0, 6) for c, d in zip(grid.centre, (grid.dx, grid.dy), strict=True)
        )
        angles = tuple(self.angles.tolist())
        radii, near = _variance_near_axis(
            angles, self.largest_gain, fractions, (grid.dx / step, grid.dy / step)
        )
        place = np.hypot(grid.x, grid.y[:, None]) / step
        outer = np.arange(_RINGS, math.ceil(place.max()) + 2.0)
        law = _share_of_orders(self.angles, self.largest_gain, np.concatenate([radii, outer]))
        joined = slice(radii.size // 2, radii.size)
        profile = law * (near[:, joined].mean(axis=1) / law[:, joined].mean(axis=1))[:, None]
        profile[:, : radii.size] = near
        return np.stack([np.interp(place, np.concatenate([radii, outer]), p) for p in profile])

    def _once(
        self, stack: FloatArray, grid: MapGrid, removed: Sequence[str]
    ) -> tuple[FloatArray, FloatArray, bool]:
        parts = self._parts_in_first(stack, grid)
        parts = without_plane(parts, grid, removed=removed)
        residual, exact = [], True
        for z, angle in zip(stack, self.angles, strict=True):
            moved, share = turned(parts[1:2], float(angle), grid)
            exact = exact and share == 1.0
            rest = z - parts[0] - moved[0] - parts[2]
            residual.append(rest)
        at_zero = self._at_zero(parts, stack, grid)
        if at_zero is not parts:
            at_zero[1] = without_plane(at_zero[1], grid, removed=removed)
        return at_zero, without_plane(np.stack(residual), grid, removed=removed), exact


@lru_cache(maxsize=32)
def _variance_near_axis(
    angles: tuple[float, ...],
    largest_gain: float,
    fractions: tuple[float, ...],
    steps: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Return radii, in steps, and the variance of the three parts there, by trials with noise."""
    rng = np.random.default_rng(_SEED)
    centre = tuple((_INNER // 2 + f) * d for f, d in zip(fractions, steps, strict=True))
    field = MapGrid((_INNER + 1, _INNER + 1), *steps, (centre[0], centre[1]), False)
    radius = np.hypot(field.x, field.y[:, None]).ravel()
    ring = np.minimum(2.0 * radius, 2 * _RINGS).astype(np.intp)
    sums = np.zeros((3, 2 * _RINGS + 1))
    for _ in range(_TRIALS // _AT_ONCE):
        noise = rng.standard_normal((_AT_ONCE, len(angles), *field.shape))
        found = np.nan_to_num(parts_on_circles(noise, np.array(angles), field, largest_gain))
        sums += [np.bincount(ring, z.ravel()) for z in (found**2).sum(axis=0)]
    count = np.bincount(ring)[:-1]
    filled = count > 0
    radii = np.bincount(ring, radius)[:-1][filled] / count[filled]
    variance = sums[:, :-1][:, filled] / (count[filled] * _TRIALS)
    for values in (radii, variance):
        values.setflags(write=False)
    return radii, variance


def _share_of_orders(angles: FloatArray, largest_gain: float, radii: FloatArray) -> FloatArray:
    """Return the variance at radii, in steps, where white noise has equal orders up to pi r."""
    highest = math.ceil(math.pi * radii.max())
    weights, _ = order_weights(tuple(angles.tolist()), highest, largest_gain)
    squares = (np.abs(weights) ** 2).sum(axis=2).T
    squares[:, 1:] *= 2.0
    top = math.pi * radii
    sums = np.stack([np.interp(top, np.arange(highest + 1), row.cumsum()) for row in squares])
    return np.asarray(np.maximum(sums / (2.0 * top + 1.0), np.finfo(float).tiny))


def _pixel_weights(
    angles: FloatArray, n: int, largest_gain: float
) -> tuple[FloatArray, list[int], float]:
    """Return weights (3, S, N), the classes that are not separable, freedoms for each pixel."""
    s = angles.size
    weights = np.zeros((3, s, n))
    turns = 2.0 * np.pi * np.arange(n) / n
    lost, freedom = [], 0.0
    for q in range(n // 2 + 1):
        share = class_share(q, n) / n
        turn = np.exp(-1j * q * angles)
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        back = np.exp(1j * q * turns)
        freedom += share * (s - solved.rank)
        if solved.seen.all() and solved.gain.max() <= largest_gain:
            for p in range(2):
                weights[p] += share * np.real(np.outer(solved.weights[p], back))
        else:
            lost.append(q)
            weights[2] += share * np.real(np.outer(np.full(s, 1.0 / s), back))
    return weights, lost, freedom


# ---- rotations by any angles: maps on circles, one least-squares system for each angular order ----


def polar_grid(grid: MapGrid) -> tuple[FloatArray, int]:
    """Return radii at the pitch of the pixels and a number of angles that is as dense at the rim."""
    from scipy.fft import next_fast_len

    step = min(grid.dx, grid.dy)
    largest = math.hypot(np.abs(grid.x).max(), np.abs(grid.y).max())
    radii = np.asarray((np.arange(math.ceil(largest / step)) + 0.5) * step, dtype=np.float64)
    return radii, 2 * int(next_fast_len(math.ceil(1.3 * math.pi * radii[-1] / step)))


def to_polar(stack: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over (radius, angle)."""
    radii, n = polar_grid(grid)
    angle = 2.0 * np.pi * np.arange(n) / n
    columns = (radii[:, None] * np.cos(angle) + grid.centre[0]) / grid.dx
    rows = (radii[:, None] * np.sin(angle) + grid.centre[1]) / grid.dy
    found, _ = interpolated(stack, rows.ravel(), columns.ravel())
    return found.reshape(stack.shape[0], radii.size, n)


def from_polar(polar: FloatArray, grid: MapGrid) -> FloatArray:
    """Return maps over rows and columns from those over (radius, angle)."""
    n = polar.shape[2]
    inner = np.roll(polar[:, :3][:, ::-1], n // 2, axis=2)  # through the centre to the other side
    whole = np.concatenate([inner, polar], axis=1)
    whole = np.concatenate([whole[:, :, -3:], whole, whole[:, :, :4]], axis=2)
    step = min(grid.dx, grid.dy)
    radius = np.hypot(grid.x, grid.y[:, None]) / step - 0.5 + 3.0
    angle = np.mod(np.arctan2(grid.y[:, None], grid.x), 2.0 * np.pi) * n / (2.0 * np.pi) + 3.0
    found, _ = interpolated(whole, radius.ravel(), angle.ravel())
    return found.reshape(polar.shape[0], *grid.shape)


def solve_polar(
    stack: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float
) -> FloatArray:
    """Return instrument, part and the sum that is not separable, order by order."""
    return np.asarray(parts_on_circles(stack[None], angles, grid, largest_gain, least=6)[0])


def parts_on_circles(
    trials: FloatArray, angles: FloatArray, grid: MapGrid, largest_gain: float, *, least: int = 0
) -> FloatArray:
    """Return the parts of many sets of readings, shape (T, S, n_y, n_x), from their whole circles."""
    t, s = trials.shape[:2]
    polar = to_polar(trials.reshape(t * s, *grid.shape), grid)
    whole, n = np.isfinite(polar).all(axis=(0, 2)), polar.shape[2]
    if whole.sum() < least:
        raise DataError(
            "no six circles about the centre were measured completely in all maps, which angles "
            "that are not multiples of one step need: state centre=, or use equal steps"
        )
    weights, _ = order_weights(tuple(np.asarray(angles).tolist()), n // 2, largest_gain)
    series = np.fft.rfft(polar[:, whole].reshape(t, s, -1, n), axis=3)
    found = np.einsum("mps,tsrm->tprm", weights, series, optimize=True)
    out = np.full((t, 3, whole.size, n), np.nan)
    out[:, :, whole] = np.fft.irfft(found, n=n, axis=3)
    return from_polar(out.reshape(t * 3, -1, n), grid).reshape(t, 3, *grid.shape)


@lru_cache(maxsize=16)
def order_weights(
    angles: tuple[float, ...], highest: int, largest_gain: float
) -> tuple[ComplexArray, tuple[int, ...]]:
    """Return what each reading counts in instrument, part and inseparable sum, order by order."""
    weights = np.zeros((highest + 1, 3, len(angles)), dtype=np.complex128)
    hidden = []
    for m in range(highest + 1):
        turn = np.exp(-1j * m * np.array(angles))
        solved = solve_order(np.stack([np.ones_like(turn), turn], axis=1))
        if solved.seen.all() and solved.gain.max() <= largest_gain:
            weights[m, :2] = solved.weights
        else:
            weights[m, 2] = 1.0 / len(angles)
            hidden.append(m)
    weights.setflags(write=False)
    return weights, tuple(hidden)
