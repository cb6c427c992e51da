"""Registration of maps: shift and turn of one map against another, from fiducials or from heights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.methods import RoleColumns
from metrosep.core.numbers import not_negative, real
from metrosep.core.options import Option
from metrosep.core.surface import Surface
from metrosep.separation.contract import U_READING, NamedMethod, StoredResult
from metrosep.separation.maps._map_input import (
    MapGrid,
    checked_u,
    coarse,
    map_stack,
    require_overlap,
    turned,
    without_plane,
)

_ITERATIONS = 30
_COARSE = 96
_FLATTEST = 1e-4
_MIRRORED = "; one map looks mirrored: with x reversed they fit much better"
_UNLIKE = (
    "register_maps: the maps do not resemble each other well enough for a registration; give "
    "start=(shift_x, shift_y, angle) near the truth, or use fiducials"
)
_REST, _REST_OF_U, _NEAR_REST = 1e-5, 0.05, 6.0
_FREE_MASK = 8
_NOISY_SLOPES, _SMOOTHEST = 0.03, 4.0
_LEAST_OVERLAP, _FOREIGN = 0.6, 0.9
_NAMES = ("shift along x", "shift along y", "turn")


def register_maps(
    fixed: ArrayLike | Surface,
    moved: ArrayLike | Surface,
    *,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: bool = True,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    u_reading: float | None = None,
) -> Registration:
    """Return how far a map is shifted and turned against another, from its heights.

    Parameters
    ----------
    fixed, moved : Surface or array_like, shape (n_y, n_x), m
        Two maps of one surface, by one instrument whose own error is small or removed.
    start : tuple of (float, float, float), m, m, rad, optional
        Shift and angle to start from; give the nominal angle of a turned part.
    dx, dy : float, m, optional
        Steps of plain arrays; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Centre of turn from pixel [0, 0]; the middle of the map if omitted.
    u_reading : float, m, optional
        Standard uncertainty of one pixel; from what is left of the difference if omitted.

    Returns
    -------
    Registration
        Shift, angle and covariance; piston and tilt of the difference are free.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If the maps do not fit each other, or do not overlap.
    DegenerateFitError
        If the map does not show the shift or the turn: a plane, a cylinder, a round dish.
    NotConvergedError
        If the maps do not resemble each other.

    Notes
    -----
    The coarse shift is the peak of the cross-correlation; then Gauss-Newton on
    ``moved(p) - fixed(R(-angle)(p - shift)) = plane - g . d``, g the gradient: least squares of the
    gradients. ``u = s sqrt(inv(G' G))`` with white noise s of the difference. A static error of
    the instrument pulls the estimate towards zero: remove it first. Shift error along a direction
    without slope cannot be seen; a turn shows only on orders other than 0.

    References
    ----------
    B. D. Lucas, T. Kanade, Proc. IJCAI (1981) 674-679.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 64)
    >>> z = lambda x, y: 50e-9 * np.sin(5 * x + y) * np.cos(4 * y - x**2)
    >>> fixed, moved = z(x, x[:, None]), z(x - 0.02, x[:, None] + 0.01)
    >>> found = register_maps(fixed, moved, dx=x[1] - x[0])
    >>> round(found.shift_x, 5), round(found.shift_y, 5)
    (0.02, -0.01)
    """
    stack, grid, _ = map_stack(
        [fixed, moved], what="register_maps", names=("fixed", "moved"), dx=dx, dy=dy, centre=centre
    )
    u_reading = checked_u(u_reading, "u_reading")
    try:
        kinds = ("length", "length", "angle")
        numbers = [real(v, "start", dimension=d) for v, d in zip(start, kinds, strict=True)]
    except (TypeError, ValueError, InvalidSamplesError, UnitError):
        raise DataError(
            f"register_maps: start holds shift_x, shift_y, angle, got {start!r}"
        ) from None
    if abs(numbers[2]) > 2.0 * np.pi + 1e-9:
        raise DataError(
            f"register_maps: the start angle {numbers[2]} rad is more than a turn; it looks like "
            "degrees"
        )
    stack = without_plane(stack, grid)
    first = np.array(numbers, dtype=np.float64)
    p = _coarse_shift(stack, first, grid)
    free = np.array([True, True, rotation])
    end = _gauss_newton(stack, p, grid, free)
    rms, form = _left(stack, end, grid, free)
    size = math.sqrt(min(float(np.nanmean(z**2)) for z in stack))
    overlap = [_linearised(stack, q, grid, free).mask.sum() for q in (end.p, first)]
    if not end.reached or form > _FOREIGN * size or overlap[0] < _LEAST_OVERLAP * overlap[1]:
        mirrored = _mirrored_left(stack, p, grid, free) < 0.5 * rms
        raise NotConvergedError(_UNLIKE + (_MIRRORED if mirrored else ""))
    at = _linearised(stack, end.p, grid, free, smoothing=end.smoothing)
    design = at.design
    left = at.rest - design @ _solved(at, free)
    if u_reading is None:
        # interpolation took the short waves from the noise of one map; slopes see the long ones
        freedom = max(left.size - design.shape[1], 1)
        noise = math.sqrt(float((left**2).sum()) / freedom * 2.0 / (1.0 + at.share))
    else:
        noise = u_reading * math.sqrt(2.0)
    n = int(free.sum())
    cov = np.zeros((3, 3))
    cov[np.ix_(free, free)] = noise**2 * _inverse(design)[:n, :n]
    audit = {
        "iterations": end.passes,
        "n_pixels": int(left.size),
        "rms_nm": rms * 1e9,
        "smoothing_of_slopes_pixels": end.smoothing,
    }
    messages = _warnings(stack, rms, form, p, grid, free)
    x, y, angle = (float(v) for v in end.p)
    return Registration(x, y, angle, cov, rms, grid.centre, messages, audit)


class MapsRegistered(NamedMethod):
    """`register_maps` by its name."""

    name = "register_maps"
    what = "shift and turn of a second map against a first one of the same surface"
    reads = "maps"
    readings = ("fixed", "moved")
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "shift_x": Option("length", help="where the search begins along x"),
        "shift_y": Option("length", help="where the search begins along y"),
        "angle": Option("angle", help="where the search begins"),
        "rotation": Option(
            "flag", help="whether the angle is found too; false: the maps are shifted only"
        ),
    }

    @classmethod
    def from_inputs(cls, data: Sequence[Any], options: Mapping[str, Any]) -> Registration:
        """Return shift and turn of two maps."""
        rest = dict(options)
        x, y, angle = (rest.pop(key, 0.0) for key in ("shift_x", "shift_y", "angle"))
        return register_maps(*data, start=(x, y, angle), **rest)


class PointsRegistered(NamedMethod):
    """`register_points` by its name; a row holds one point in both maps."""

    name = "register_points"
    what = "shift and turn of one map against another from points that are marked in both"
    reads = "table"
    roles: ClassVar[Mapping[str, str]] = {
        "x_fixed": "length", "y_fixed": "length", "x_moved": "length", "y_moved": "length",
    }  # fmt: skip

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Registration:
        """Return shift and turn of marked points."""
        pairs = [
            np.column_stack([data.values[f"x_{which}"], data.values[f"y_{which}"]])
            for which in ("fixed", "moved")
        ]
        seen = np.isfinite(pairs[0]).all(axis=1) & np.isfinite(pairs[1]).all(axis=1)
        if not seen.all():
            row = int(np.flatnonzero(~seen)[0]) + 1
            raise InvalidSamplesError(
                f"point {row} of {seen.size} lacks a coordinate in one of the maps; drop the row"
            )
        if seen.size < 2:
            raise TooFewSamplesError(f"two points or more are needed, got {seen.size}")
        return register_points(*pairs, **options)


def registration_uncertainty(
    z: ArrayLike | Surface,
    *,
    u_shift: float | tuple[float, float] = 0.0,
    u_angle: float = 0.0,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
) -> FloatArray:
    """Return the standard uncertainty of a map from its registration: gradient times shift.

    Parameters
    ----------
    z : Surface or array_like, shape (n_y, n_x), m
        Map.
    u_shift : float or tuple of (float, float), m, optional
        Standard uncertainty along x and y, or of each.
    u_angle : float, rad, optional
        Standard uncertainty of the turn about the centre.
    dx, dy : float, m, optional
        Steps of a plain array; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Centre of turn from pixel [0, 0].

    Returns
    -------
    ndarray, shape (n_y, n_x), m
        ``sqrt((g_x u_x)**2 + (g_y u_y)**2 + ((x g_y - y g_x) u_angle)**2)``.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If the map cannot be used or an uncertainty is negative.

    Examples
    --------
    >>> import numpy as np
    >>> tilt = 1e-9 * np.arange(16.0) * np.ones((16, 1))
    >>> u = registration_uncertainty(tilt, u_shift=(0.5, 0.0))
    >>> bool(abs(u - 0.5e-9).max() < 1e-20)
    True
    """
    stack, grid, _ = map_stack([z], what="registration_uncertainty", dx=dx, dy=dy, centre=centre)
    try:
        both = np.broadcast_to(np.asarray(u_shift, dtype=np.float64), (2,))
    except (TypeError, ValueError):
        raise DataError(f"u_shift must be one number or two, in m, got {u_shift!r}") from None
    for value in both:
        not_negative(value, "u_shift", dimension="length")
    u_angle = not_negative(u_angle, "u_angle", dimension="angle")
    gx, gy = map_gradient(stack[0], grid)
    turn = grid.x * gy - grid.y[:, None] * gx
    square = (gx * both[0]) ** 2 + (gy * both[1]) ** 2 + (turn * u_angle) ** 2
    return np.asarray(np.sqrt(square))


def _coarse_shift(stack: FloatArray, start: FloatArray, grid: MapGrid) -> FloatArray:
    """Return the start, its shift improved by the cross-correlation of coarse maps."""
    small, small_grid = coarse(stack, grid, _COARSE)
    first = turned(small[:1], float(start[2]), small_grid)[0][0]
    first = turned(first[None], 0.0, small_grid, shift=(float(start[0]), float(start[1])))[0][0]
    if not (np.isfinite(first) & np.isfinite(small[1])).any():
        return start
    shape = (2 * first.shape[0], 2 * first.shape[1])
    spectra, masks = [], []
    for z in (first, small[1]):
        valid = np.isfinite(z)
        spectra.append(np.fft.rfft2(np.where(valid, z - np.mean(z[valid]), 0.0), shape))
        masks.append(np.fft.rfft2(valid.astype(np.float64), shape))
    correlation = np.fft.irfft2(np.conj(spectra[0]) * spectra[1], shape)
    overlap = np.fft.irfft2(np.conj(masks[0]) * masks[1], shape)
    correlation = np.where(
        overlap > 0.5 * overlap.max(), correlation / np.maximum(overlap, 1.0), -np.inf
    )
    if not correlation.max() > 1.02 * correlation[0, 0]:
        return start
    row, column = np.unravel_index(int(np.argmax(correlation)), shape)
    rows = int(row) - shape[0] if row > shape[0] // 2 else int(row)
    columns = int(column) - shape[1] if column > shape[1] // 2 else int(column)
    more = np.array([columns * small_grid.dx, rows * small_grid.dy, 0.0])
    return np.asarray(start + more)


@dataclass(frozen=True, slots=True)
class _Linearised:
    """Difference of two maps and its derivatives at the pixels whose neighbours are measured."""

    design: FloatArray
    rest: FloatArray
    seen: FloatArray
    share: float
    mask: NDArray[np.bool_]


def _linearised(
    stack: FloatArray,
    p: FloatArray,
    grid: MapGrid,
    free: NDArray[np.bool_],
    *,
    mask: NDArray[np.bool_] | None = None,
    smoothing: float = 1.0,
) -> _Linearised:
    """Return gradients, plane and difference of the maps at parameters p, on a mask if given."""
    from scipy import ndimage

    shift = (float(p[0]), float(p[1]))
    moved, share = turned(stack[:1], float(p[2]), grid, shift=shift)
    here = moved[0]
    common = require_overlap(np.stack([here, stack[1]]), "register_maps")
    inner = ndimage.binary_erosion(common, np.ones((3, 3), dtype=bool), iterations=3)
    common = inner if inner.sum() >= 30 else common
    common = common if mask is None else common & mask
    gx, gy = map_gradient(here, grid, smoothing=smoothing)
    x, y = np.broadcast_arrays(grid.x - p[0], (grid.y - p[1])[:, None])
    slope, reach = np.hypot(gx, gy), np.hypot(x, y)
    columns = [c for c, used in zip((-gx, -gy, y * gx - x * gy), free, strict=True) if used]
    most = [c for c, used in zip((slope, slope, slope * reach), free, strict=True) if used]
    half = max(float(np.abs(grid.x).max()), float(np.abs(grid.y).max()))
    design = np.stack(
        [c[common] for c in (*columns, np.ones(grid.shape), x / half, y / half)], axis=1
    )
    norm = np.array([float(np.sqrt((m[common] ** 2).sum())) for m in most])
    size = np.sqrt((design[:, : norm.size] ** 2).sum(axis=0))
    seen = np.where(norm > 0.0, size / np.where(norm > 0.0, norm, 1.0), 0.0)
    return _Linearised(design, (stack[1] - here)[common], seen, share, common)


class _Rest(NamedTuple):
    """Where the passes ended: parameters, number of passes, smoothing, whether they came to rest."""

    p: FloatArray
    passes: int
    smoothing: float
    reached: bool


def _gauss_newton(
    stack: FloatArray, p: FloatArray, grid: MapGrid, free: NDArray[np.bool_]
) -> _Rest:
    """Return parameters whose next step is short against their uncertainty.

    Noise that is interpolated anew, and a rim that comes and goes, keep a step from zero. So
    the last passes hold the pixels, slopes are smoothed until noise has little part in them, and
    the shortest step is taken.
    """
    scale = np.array([grid.dx, grid.dy, 1.0 / max(grid.shape)])
    n, mask, smoothing = int(free.sum()), None, 1.0
    best, shortest, damping, before = p, math.inf, 1.0, np.zeros(3)
    for count in range(1, _ITERATIONS + 1):
        at = _linearised(stack, p, grid, free, mask=mask, smoothing=smoothing)
        found = _solved(at, free)
        noise = _white(at, found)
        step, rest = np.zeros(3), _REST * scale
        step[free] = found[:n]
        spread = np.diag(_inverse(at.design))[:n]
        rest[free] = np.maximum(rest[free], _REST_OF_U * noise * np.sqrt(np.maximum(spread, 0.0)))
        longest = float(np.max(np.abs(step / scale)))
        if mask is not None:  # to and fro: interpolated noise has kinks
            back = float((step / scale) @ (before / scale)) < 0.0
            damping = max(0.5 * damping, 0.1) if back else min(1.5 * damping, 1.0)
        before = step
        p = p + step * min(damping, 3.0 / max(longest, 1e-300))
        # slopes of white noise have the variance noise**2 / (8 pi smoothing**4) for each pixel
        slopes = np.mean((at.design[:, :2] * scale[:2]) ** 2)
        noisy = noise**2 / (8.0 * math.pi * smoothing**4) > 2.0 * _NOISY_SLOPES * slopes
        if noisy and smoothing < _SMOOTHEST:
            smoothing = min(1.5 * smoothing, _SMOOTHEST)
            continue
        ratio = float(np.max(np.abs(step / rest)))
        if ratio < 1.0:
            return _Rest(p, count, smoothing, True)
        if ratio < shortest:
            best, shortest = p, ratio
        if count >= _FREE_MASK and mask is None and longest < 1.0:
            mask = at.mask
    return _Rest(best, _ITERATIONS, smoothing, shortest < _NEAR_REST)


def _inverse(design: FloatArray) -> FloatArray:
    """Return the inverse of the normal matrix, columns scaled first."""
    size = np.sqrt((design**2).sum(axis=0))
    scaled = design / size
    return np.asarray(np.linalg.inv(scaled.T @ scaled) / np.outer(size, size))


def _white(at: _Linearised, found: FloatArray) -> float:
    """Return the white noise of the difference, from neighbours along x."""
    left = np.full(at.mask.shape, np.nan)
    left[at.mask] = at.rest - at.design @ found
    steps = np.diff(left, axis=1)
    steps = steps[np.isfinite(steps)]
    return math.sqrt(float(np.mean(steps**2)) / 2.0) if steps.size else 0.0


def _solved(at: _Linearised, free: NDArray[np.bool_]) -> FloatArray:
    """Return least squares by the scaled normal equations, or say what does not show."""
    design = at.design
    names = [k for k, used in zip(_NAMES, free, strict=True) if used]
    worst = names[int(np.argmin(at.seen))]
    if at.seen.min() > _FLATTEST:
        size = np.sqrt((design**2).sum(axis=0))
        normal = (design.T @ design) / np.outer(size, size)
        values, vectors = np.linalg.eigh(normal)
        if values[0] > _FLATTEST**2:
            return np.asarray(np.linalg.solve(normal, (design.T @ at.rest) / size) / size)
        worst = names[int(np.argmax(np.abs(vectors[: len(names), 0])))]
    raise DegenerateFitError(
        f"register_maps: the heights do not show the {worst} (a plane, a cylinder or a round "
        "dish looks the same after it); use fiducials, or rotation=False"
    )


def _left(
    stack: FloatArray, end: _Rest, grid: MapGrid, free: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the RMS of what parameters leave of the difference, and of its share that is not noise."""
    at = _linearised(stack, end.p, grid, free, smoothing=end.smoothing)
    found = _solved(at, free)
    square = float(np.mean((at.rest - at.design @ found) ** 2))
    return math.sqrt(square), math.sqrt(max(square - _white(at, found) ** 2, 0.0))


def _mirrored_left(
    stack: FloatArray, p: FloatArray, grid: MapGrid, free: NDArray[np.bool_]
) -> float:
    """Return the RMS that is left when x of the fixed map is reversed, on coarse maps."""
    small, small_grid = coarse(stack, grid, _COARSE)
    small = np.stack([small[0, :, ::-1], small[1]])
    try:
        end = _gauss_newton(small, _coarse_shift(small, p, small_grid), small_grid, free)
        return _left(small, end, small_grid, free)[0] if end.reached else math.inf
    except (DataError, DegenerateFitError):
        return math.inf


def _warnings(
    stack: FloatArray,
    rms: float,
    form: float,
    p: FloatArray,
    grid: MapGrid,
    free: NDArray[np.bool_],
) -> tuple[str, ...]:
    """Say that much is left that is not noise, and whether a mirrored map would fit much better."""
    size = math.sqrt(float(np.nanmean(stack[0] ** 2)))
    if form < 0.3 * size:
        return ()
    text = f"{rms * 1e9:.3g} nm of {size * 1e9:.3g} nm RMS are left after registration"
    if _mirrored_left(stack, p, grid, free) < 0.5 * rms:
        return (text + _MIRRORED,)
    return (f"{text}: the maps may be of different surfaces, or start= is far from the truth",)


# ---- registration by fiducials: shift and turn of one map against another from marked points ----


@dataclass(frozen=True, slots=True)
class Registration(StoredResult):
    """Where a map lies against another one: turned about the centre, then shifted.

    ``moved(p) = fixed(R(-angle) (p - shift))`` with p from the centre: a feature at q in the fixed
    map is at ``R(angle) q + shift`` in the moved one.

    Parameters
    ----------
    shift_x, shift_y : float, m
        Shift along x and y.
    angle : float, rad
        Turn, counter-clockwise (from +x towards +y).
    cov : ndarray, shape (3, 3)
        Covariance of shift_x, shift_y, angle; NaN where it is not known.
    rms : float, m
        Of what is left of the difference (of the distance of points).
    centre : tuple of (float, float), m
        Centre of turn, from pixel [0, 0].
    messages : tuple of str, optional
        What the user should know.
    audit : mapping, optional
        Plain values.
    """

    shift_x: float
    shift_y: float
    angle: float
    cov: FloatArray
    rms: float
    centre: tuple[float, float]
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def u_shift(self) -> tuple[float, float]:
        """Standard uncertainty of the shift along x and y, in m."""
        return math.sqrt(self.cov[0, 0]), math.sqrt(self.cov[1, 1])

    @property
    def u_angle(self) -> float:
        """Standard uncertainty of the angle, in rad."""
        return math.sqrt(self.cov[2, 2])


def register_points(fixed: ArrayLike, moved: ArrayLike) -> Registration:
    """Return shift and turn that bring fiducials of one map onto those of another.

    Parameters
    ----------
    fixed, moved : array_like, shape (n, 2), m
        Positions (x, y) of the same fiducials from the same centre, in the same order; n >= 2.

    Returns
    -------
    Registration
        Least squares of the distances; covariance from the residual, NaN for two points.

    Raises
    ------
    DataError
        If the positions are not finite, or not as many.
    TooFewSamplesError
        If there are fewer than two.
    DegenerateFitError
        If all fiducials are one point.

    Notes
    -----
    ``angle = atan2(sum (p x q), sum (p . q))`` about the means; ``u(angle) = s / sqrt(sum r**2)``
    with the scatter s of one coordinate and the distances r from the mean. A mirrored map is found
    by its determinant, and said.

    References
    ----------
    P. H. Schoenemann, Psychometrika 31 (1966) 1-10.

    Examples
    --------
    >>> found = register_points([[0, 0], [1, 0], [0, 2]], [[1, 0], [1, 1], [-1, 0]])
    >>> round(found.angle, 6), found.shift_x
    (1.570796, 1.0)
    """
    p, q = (_points(v, name) for v, name in ((fixed, "fixed"), (moved, "moved")))
    if p.shape != q.shape:
        raise DataError(f"register_points: {len(p)} fixed points and {len(q)} moved points")
    if len(p) < 2:
        raise TooFewSamplesError("register_points needs at least two fiducials")
    mean_p, mean_q = p.mean(axis=0), q.mean(axis=0)
    a, b = p - mean_p, q - mean_q
    spread = float((a**2).sum())
    if spread == 0.0 or float((b**2).sum()) == 0.0:
        raise DegenerateFitError("register_points: all fiducials are at one point; no angle shows")
    angle, rest = _turned_onto(a, b)
    shift = mean_q - _rotation(angle) @ mean_p
    freedom = 2 * len(p) - 3
    variance = float((rest**2).sum()) / freedom if freedom > 1 else math.nan
    lever = _rotation(angle + np.pi / 2) @ mean_p  # of the shift against the angle
    design = np.array([[1.0, 0.0, -lever[0]], [0.0, 1.0, -lever[1]], [0.0, 0.0, 1.0]])
    own = np.diag([1.0 / len(p), 1.0 / len(p), 1.0 / spread])
    messages = []
    if math.isnan(variance):
        messages.append("two fiducials leave no redundancy, so no uncertainty; give three or more")
    if len(p) > 2 and np.linalg.det(a.T @ b) < 0.0:
        mirrored = _turned_onto(a * np.array([-1.0, 1.0]), b)[1]
        if (mirrored**2).sum() < 0.25 * (rest**2).sum():
            messages.append(
                "the moved fiducials look mirrored: with x reversed they fit much better"
            )
    rms = math.sqrt(float((rest**2).sum()) / len(p))
    audit = {"n_fiducials": len(p), "rms_um": rms * 1e6}
    cov = design @ own @ design.T * variance
    return Registration(
        float(shift[0]), float(shift[1]), angle, cov, rms, (0.0, 0.0), tuple(messages), audit
    )


def _turned_onto(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray]:
    """Return the angle that turns points onto others about the origin, and what it leaves."""
    cross = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    angle = math.atan2(cross, float((a * b).sum()))
    return angle, b - a @ _rotation(angle).T


def _rotation(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def _points(values: ArrayLike, name: str) -> FloatArray:
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        raise DataError(f"register_points: {name} holds no numbers ({exc})") from None
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise DataError(
            f"register_points: {name} must be finite positions (x, y), shape (n, 2), got "
            f"{points.shape}"
        )
    return points


# ---- uncertainty of maps from registration: gradient times shift, through the same linear operation ----

_SMOOTHING = 1.0
_REACH = 4


def map_gradient(
    z: FloatArray, grid: MapGrid, *, smoothing: float = _SMOOTHING
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of a map by x and y: slopes of local planes over a few pixels."""
    valid = np.isfinite(z)
    if not valid.any():
        return np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    mask = valid.astype(np.float64)
    filled = np.where(valid, z - np.mean(z[valid]), 0.0)
    m00, m10, m01 = (_moment(mask, i, j, smoothing) for i, j in ((0, 0), (1, 0), (0, 1)))
    m20, m11, m02 = (_moment(mask, i, j, smoothing) for i, j in ((2, 0), (1, 1), (0, 2)))
    z00, z10, z01 = (_moment(filled, i, j, smoothing) for i, j in ((0, 0), (1, 0), (0, 1)))
    with np.errstate(invalid="ignore", divide="ignore"):
        a, b, c = m20 - m10**2 / m00, m11 - m10 * m01 / m00, m02 - m01**2 / m00
        p, q = z10 - m10 * z00 / m00, z01 - m01 * z00 / m00
        determinant = a * c - b**2
        shown = valid & (determinant > 1e-3 * smoothing**4 * m00**2)
        gx = np.where(shown, (c * p - b * q) / determinant / grid.dx, 0.0)
        gy = np.where(shown, (a * q - b * p) / determinant / grid.dy, 0.0)
    return np.where(valid, gx, np.nan), np.where(valid, gy, np.nan)


def _moment(values: FloatArray, power_x: int, power_y: int, smoothing: float) -> FloatArray:
    """Return Gaussian-weighted sums of values times powers of the distance in pixels."""
    from scipy import ndimage

    reach = math.ceil(_REACH * smoothing)
    t = np.arange(-reach, reach + 1.0)
    weight = np.exp(-0.5 * (t / smoothing) ** 2)
    out = ndimage.correlate1d(values, weight * t**power_x, axis=1, mode="constant")
    return np.asarray(
        ndimage.correlate1d(out, weight * t**power_y, axis=0, mode="constant"), dtype=np.float64
    )


def extended(field: FloatArray) -> FloatArray:
    """Return a map whose missing pixels have the value of the nearest one."""
    from scipy import ndimage

    missing = np.isnan(field)
    if not missing.any() or missing.all():
        return field
    nearest = ndimage.distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(field[tuple(nearest)])


def registration_spread(
    linear: Callable[[FloatArray], FloatArray],
    n_readings: int,
    effects: Iterable[tuple[int, FloatArray]],
) -> FloatArray | float:
    """Return the standard uncertainty of what a linear operation makes of n readings.

    Each effect is the change of one reading for one standard uncertainty of its position.
    """
    total: FloatArray | float = 0.0
    for i, change in effects:
        stack = np.zeros((n_readings, *change.shape))
        stack[i] = change
        total = total + linear(stack) ** 2
    return np.sqrt(total)
