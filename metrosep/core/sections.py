"""Sections of a map: straight, averaged across a band, round; and distances between its points.

The section is read from the map itself, never from its means: a line costs a millisecond even on
4096 x 4096 pixels, so what follows a pointer is already the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray, lateral, place, position
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import not_negative, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.regions import in_pixels, needs_scale, within_region
from metrosep.core.units import PIXEL, Pixels, format_length

if TYPE_CHECKING:
    from metrosep.core.surface import Surface

Reading = Literal["lanczos", "bilinear", "nearest"]

_ON_PIXEL = 1e-8
"""Part of a pixel below which a point lies on the pixel's centre line."""

_REACH = np.arange(-3, 5)
"""Neighbours on each axis of a point between pixel 0 and pixel 1: eight."""

_AT_ONCE = 20_000
"""Samples whose neighbours are held at a time: 10 MB."""

_MISSING_AT_ONCE = 500
"""Missing pixels that are predicted at a time: 10 MB."""

_KNOWN = 2.0 / 3.0
"""Of the 8 and of the 48 pixels around a missing one that must be measured, as where hills are found."""

_NOISE, _OF_PLANE = 1e-3, 1e3
"""Variances over that of the waves: of noise, so that a prediction holds no more of it than a pixel does,
and of a plane, which is unknown."""

_MOST_SAMPLES = 10_000_000
"""Largest number of samples of a section; a line that needs more is a slip of the unit."""

_MOST_LINES = 10_000
"""Lines on each side of the middle of a band."""


def section_profile(
    surface: Surface,
    a: Sequence[float | str],
    b: Sequence[float | str],
    *,
    width: float | str | None = None,
    method: Reading = "lanczos",
) -> Profile:
    """Return the heights of a map along the line from a to b, or their mean across a band.

    Notes
    -----
    On a slanting line ``"lanczos"`` (a plane with twist through the 64 pixels, and what it leaves by
    a windowed sinc) keeps the RMS of waves from 3 pixels on within 1 %. It departs from the bilinear
    height by no more than the pixels on either side of the cell depart from the straight line between
    their neighbours, along x and y together: beside a step between straight faces that is nothing, so it
    does not overshoot; only a ridge or groove of four pixels and less is taken for a wave.
    ``"bilinear"`` averages, and keeps 84 % at 4.3 pixels, two thirds of noise. ``"nearest"`` keeps the
    RMS, and repeats pixels. None fills a gap. Along pixel centres each gives the pixels themselves. The
    history says which share was read bilinearly.

    A band of width w is the mean of n = 2 floor(w / 2s) + 1 parallel lines, s the smaller step. Where
    a line has a gap, its mirror image about the middle is omitted too, so that a plane stays a plane;
    where less than half of them remain the profile has a gap. A wave of length L across is damped by
    ``|sin(pi n s / L) / (n sin(pi s / L))|`` where all are valid; ``lines_share`` in the history is
    the share of lines in the mean.

    Examples
    --------
    >>> from metrosep import Surface
    >>> plane = Surface([[0.0, 1.0], [2.0, 3.0]], dx=1.0, dy=1.0)
    >>> section_profile(plane, (0, 0), (0.6, 0.8)).z.round(12).tolist()
    [0.0, 2.2]
    """
    seen, (one, other, across) = _seen(surface, a=a, b=b, width=width)
    unit = "m" if is_calibrated(seen) else PIXEL
    x, z, _, share = read_line(seen, one, other, method)
    ends = {f"from_{unit}": list(map(float, one)), f"to_{unit}": list(map(float, other))}
    step = {**ends, "reading": method, "bilinear_share": share}
    if across is not None:
        z, n, used = _mean_of_band(seen, one, other, not_negative(across, "width"), method)
        step |= {f"width_{unit}": float(across), "lines": n, "lines_share": used}
    if seen is not surface and is_calibrated(surface):  # as far apart as its pixels are
        _, (dx, dy) = grid_of(surface)
        x = x * (math.hypot((other[0] - one[0]) * dx, (other[1] - one[1]) * dy) / x[-1])
    history = (*surface.history, Step("section", step))
    return Profile(x, z, metadata=_along(surface), history=history)


def _along(surface: Surface) -> dict[str, Any]:
    """Return the metadata of a section, which name the unit of x where it is not m."""
    unit = {} if is_calibrated(surface) else {"lateral_unit": PIXEL}
    return {**surface.metadata, **unit}


def _mean_of_band(
    surface: Surface, a: Sequence[float], b: Sequence[float], width: float, method: str
) -> tuple[FloatArray, int, float]:
    """Return the mean of parallel lines, their number, and the share of them in the mean.

    Lines k and -k count together or not at all: the mean of one side would lie beside the line, a step
    of slope times distance at every gap. Less than half of the lines is a gap.
    """
    step = min(grid_of(surface)[1])
    half = math.floor(width / (2.0 * step) * (1.0 + 1e-9))
    if half > _MOST_LINES:
        raise DataError(f"width = {_said(surface, width)} holds more than {2 * _MOST_LINES} lines")
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    normal = (-(b[1] - a[1]) / length * step, (b[0] - a[0]) / length * step)

    def line(k: int) -> FloatArray:
        one, two = ((p[0] + k * normal[0], p[1] + k * normal[1]) for p in (a, b))
        return read_line(surface, one, two, method)[1]

    total: FloatArray | float = 0.0
    known: FloatArray | float = 0.0
    for k in range(half + 1):
        z, lines = (line(k) + line(-k), 2.0) if k else (line(0), 1.0)
        valid = ~np.isnan(z)
        total, known = total + np.where(valid, z, 0.0), known + lines * valid
    n = 2 * half + 1
    enough = 2.0 * np.asarray(known) >= n
    share = float(np.mean(known, where=enough)) / n if enough.any() else 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(enough, total / known, np.nan)), n, share


def circle_section(
    surface: Surface,
    centre: Sequence[float | str],
    radius: float | str,
    *,
    method: Reading = "lanczos",
) -> Profile:
    """Return the heights of a map along a circle, from +x to +y, without the first point again.

    Notes
    -----
    N = ceil(2 pi r / min(dx, dy)) samples at equal angles; x of the profile is the length of the arc.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Surface
    >>> plane = Surface(np.arange(21.0) + np.zeros((21, 1)), dx=1.0, dy=1.0)
    >>> ring = circle_section(plane, (10.0, 10.0), 5.0)
    >>> len(ring), round(float(ring.z[0]), 9), harmonics(ring, [1, 2])[0].round(9).tolist()
    (32, 15.0, [5.0, 0.0])
    """
    seen, ((x, y), r) = _seen(surface, centre=centre, radius=radius)
    positive(r, "radius")
    unit = "m" if is_calibrated(seen) else PIXEL
    (x0, y0), (dx, dy) = grid_of(seen)
    if not 2.0 * math.pi * r < _MOST_SAMPLES * min(dx, dy):
        raise DataError(
            f"the circle of radius {_said(seen, r)} has more than {_MOST_SAMPLES} samples"
        )
    n = max(4, math.ceil(2.0 * math.pi * r / min(dx, dy) * (1.0 - 1e-9)))
    angle = 2.0 * np.pi * np.arange(n) / n
    column = (x + r * np.cos(angle) - x0) / dx
    row = (y + r * np.sin(angle) - y0) / dy
    z, share = heights_at(seen, row, column, method)
    step = {f"centre_{unit}": [float(x), float(y)], f"radius_{unit}": float(r), "reading": method}
    history = (*surface.history, Step("circle section", {**step, "bilinear_share": share}))
    arc = r * angle
    if seen is not surface and is_calibrated(surface):  # chord by chord: it may be an ellipse
        _, (dx, dy) = grid_of(surface)
        chords = np.hypot(dx * np.diff(r * np.cos(angle)), dy * np.diff(r * np.sin(angle)))
        turn = (math.pi / n) / math.sin(math.pi / n)  # an arc over its chord
        arc = turn * np.concatenate([[0.0], np.cumsum(chords)])
    return Profile(arc, z, metadata=_along(surface), history=history)


def harmonics(ring: Profile, orders: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return amplitude (m) and phase (rad) of harmonics of a closed profile: A cos(n theta + phase)."""
    if np.isnan(ring.z).any():
        raise TooFewSamplesError(
            "the circle has gaps: harmonics need all of it; take another radius"
        )
    highest = ring.z.size // 2
    if not all(1 <= n < highest for n in orders):
        raise DataError(f"harmonics of {ring.z.size} samples are 1 to {highest - 1}")
    # c_n = 2/N sum z exp(-i n theta): amplitude |c_n|, phase arg c_n
    found = 2.0 / ring.z.size * np.fft.rfft(ring.z - ring.z.mean())[list(orders)]
    return np.abs(found), np.angle(found)


def height_at(
    surface: Surface, point: Sequence[float | str], *, method: Reading = "lanczos"
) -> float:
    """Return the height of a map at a point; NaN where it was not measured (m)."""
    seen, ((x, y),) = _seen(surface, point=point)
    (x0, y0), (dx, dy) = grid_of(seen)
    z, _ = heights_at(seen, np.array([(y - y0) / dy]), np.array([(x - x0) / dx]), method)
    return float(z[0])


@dataclass(frozen=True, slots=True)
class Distance:
    """How far one point is from another; NaN where a height was not measured."""

    lateral: float  # m: in the plane of the map
    distance: float  # m: in space
    height: float  # m: of b over a
    azimuth: float  # rad: of b seen from a, from +x to +y, above -pi up to pi
    slope: float  # rad: positive where b lies higher


def distance(a: Sequence[float], b: Sequence[float]) -> Distance:
    """Return the distance of two points x, y, z (m).

    Examples
    --------
    >>> found = distance((1.2e-3, -0.4e-3, 3.1e-6), (2.05e-3, 0.37e-3, -0.8e-6))
    >>> f"{found.distance * 1e3:.8f} mm, {math.degrees(found.azimuth):.7f} deg"
    '1.14691552 mm, 42.1728754 deg'
    """
    dx, dy, dz = (float(q) - float(p) for p, q in zip(a, b, strict=True))
    lateral = math.hypot(dx, dy)
    if not lateral > 0.0:
        raise DataError("the two points lie on one another: they have no distance")
    return Distance(
        lateral, math.hypot(lateral, dz), dz, math.atan2(dy, dx), math.atan2(dz, lateral)
    )


def angle_at(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    """Return the angle at b between the directions to a and c, in the plane, 0 to pi (rad)."""
    (ux, uy), (vx, vy) = ((float(p[0]) - float(b[0]), float(p[1]) - float(b[1])) for p in (a, c))
    if not (math.hypot(ux, uy) > 0.0 and math.hypot(vx, vy) > 0.0):
        raise DataError("an angle needs three points, the middle one apart from the others")
    return math.atan2(abs(ux * vy - uy * vx), ux * vx + uy * vy)


class CircleExtremes(NamedTuple):
    """The highest and the lowest pixel in a circle: x and y in m, or in px, and height in m."""

    peak: tuple[float, float, float]
    valley: tuple[float, float, float]
    is_whole: bool  # whether all of the circle lies on the map and was measured


def extremes_in(
    surface: Surface, centre: tuple[float, float], radius: float
) -> CircleExtremes | None:
    """Return the extreme pixels whose centre lies in a circle, None where nothing was measured there."""
    surface, ((cx, cy), r) = _seen(surface, centre=centre, radius=radius)
    (x0, y0), (dx, dy) = grid_of(surface)
    x: FloatArray = x0 + dx * np.arange(surface.shape[1], dtype=np.float64)
    y: FloatArray = y0 + dy * np.arange(surface.shape[0], dtype=np.float64)
    columns, rows = (
        np.flatnonzero(np.abs(x - cx) <= 1.01 * r),
        np.flatnonzero(np.abs(y - cy) <= 1.01 * r),
    )
    reach = r * (1 - 1e-9)
    inside = all(v[0] <= c - reach and v[-1] >= c + reach for v, c in ((x, cx), (y, cy)))
    z = surface.z[np.ix_(rows, columns)]
    circle = {"shape": "circle", "diameter": 2.0 * r}
    within = within_region(circle, x[columns], y[rows], (cx, cy))
    z = np.where(within, z, np.nan)
    lost = int(np.count_nonzero(within & np.isnan(z)))
    if lost == np.count_nonzero(within):
        return None
    found = []
    for at in (np.nanargmax(z), np.nanargmin(z)):
        i, j = np.unravel_index(int(at), z.shape)
        found.append((float(x[columns[j]]), float(y[rows[i]]), float(z[i, j])))
    return CircleExtremes(found[0], found[1], inside and not lost)


def circle_through(
    a: Sequence[float], b: Sequence[float], c: Sequence[float]
) -> tuple[tuple[float, float], float]:
    """Return centre and diameter of the circle through three points (m)."""
    (ux, uy), (vx, vy) = ((float(p[0]) - float(b[0]), float(p[1]) - float(b[1])) for p in (a, c))
    u, v = ux * ux + uy * uy, vx * vx + vy * vy
    cross = 2.0 * (ux * vy - uy * vx)
    if abs(cross) <= 1e-9 * math.sqrt(u * v):  # less than a nanoradian off a line
        raise DataError("the three points lie on one line: no circle goes through them")
    x, y = (vy * u - uy * v) / cross, (ux * v - vx * u) / cross
    return (float(b[0]) + x, float(b[1]) + y), 2.0 * math.hypot(x, y)


# ---- heights between the pixels -----------------------------------------------------------------


def read_line(
    surface: Surface, a: Sequence[float], b: Sequence[float], method: str
) -> tuple[FloatArray, FloatArray, float, float]:
    """Return distances, heights, length, and the share of heights that were read bilinearly."""
    (ax, ay), (bx, by) = position(a, "a"), position(b, "b")
    (x0, y0), (dx, dy) = grid_of(surface)
    length = math.hypot(bx - ax, by - ay)
    if not 0.0 < length < _MOST_SAMPLES * min(dx, dy):
        places = [", ".join(_said(surface, v) for v in p) for p in ((ax, ay), (bx, by))]
        raise DataError(
            f"the section runs from ({places[0]}) to ({places[1]}): its ends must differ, by less than "
            f"{_MOST_SAMPLES} pixels; check their unit"
        )
    # a step that divides the length up to rounding must not be cut in two
    n = max(2, math.ceil(length / min(dx, dy) * (1.0 - 1e-9)) + 1)
    part = np.linspace(0.0, 1.0, n)
    # ends that lie on pixels stay there: the parts are taken of differences
    column = (ax - x0) / dx + part * ((bx - ax) / dx)
    row = (ay - y0) / dy + part * ((by - ay) / dy)
    z, share = heights_at(surface, row, column, method)
    return part * length, z, length, share


def _seen(surface: Surface, **given: Any) -> tuple[Surface, list[Any]]:
    """Return a map in the unit of what is given, m or its pixels, and that as numbers.

    Numbers without a unit are m, or pixels of a map without lateral calibration.
    """
    known = is_calibrated(surface)

    def number(value: Any, name: str) -> float:
        found = lateral(value, name)
        if known or isinstance(found, Pixels):
            return found
        if isinstance(value, str):
            raise needs_scale(name, '"120 px"')
        return Pixels(found)

    found: list[Any] = []
    for name, value in given.items():
        if name in _SIZES:
            found.append(None if value is None else number(value, name))
        else:
            place(value, name)  # refuses what is not a pair
            found.append(
                tuple(number(v, f"{k} of {name}") for k, v in zip("xy", value, strict=True))
            )
    pixels = in_pixels("the section", *found)
    return of_pixels(surface) if pixels and known else surface, found


_SIZES = ("width", "radius")


def require_units(surface: Surface, *given: Any) -> None:
    """Refuse bare numbers, which are m, on a map whose pixels have no known size."""
    flat = [v for one in given for v in (one if isinstance(one, list | tuple) else [one])]
    if not is_calibrated(surface) and any(v is not None and not isinstance(v, str) for v in flat):
        raise needs_scale("the section", '("120 px", "30 px")')


def of_pixels(surface: Surface) -> Surface:
    """Return a map whose places count its pixels, heights and history kept."""
    if not is_calibrated(surface):
        return surface
    return type(surface)(surface.z, metadata=surface.metadata, history=surface.history)


def _said(surface: Surface, value: float) -> str:
    """Return a place or size with its unit."""
    return format_length(value if is_calibrated(surface) else Pixels(value))


def grid_of(surface: Surface) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return origin and steps, of a map without lateral calibration in its pixels."""
    dx, dy = (surface.dx, surface.dy) if is_calibrated(surface) else (None, None)
    if dx is None or dy is None:
        return (0.0, 0.0), (1.0, 1.0)
    return surface.origin, (dx, dy)


def heights_at(
    surface: Surface, row: FloatArray, column: FloatArray, method: str
) -> tuple[FloatArray, float]:
    """Return heights at fractional indices, and the share that was read bilinearly."""
    if method == "nearest":
        return _nearest(surface.z, row, column), 0.0
    if method not in ("lanczos", "bilinear"):
        raise DataError(f'method must be "lanczos", "bilinear" or "nearest", got {method!r}')
    z = _bilinear(surface.z, row, column)
    return z, 1.0 if method == "bilinear" else _refined(surface.z, row, column, z)


def is_calibrated(surface: Surface) -> bool:
    """Return whether both lateral steps of a map are known."""
    if not hasattr(surface, "dy"):  # what a profile has not
        raise DataError(f"a section is cut through a Surface, got {type(surface).__name__}")
    return surface.dx is not None and surface.dy is not None


def _bilinear(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    """Return heights at fractional indices; a neighbour without weight need not be valid."""
    (i, v), (j, u) = _split(row), _split(column)
    total = np.zeros(row.size)
    for di, wi in ((0, 1.0 - v), (1, v)):
        for dj, wj in ((0, 1.0 - u), (1, u)):
            weight = wi * wj
            carries = weight > 0.0
            height = _at(z, i[carries] + di, j[carries] + dj)
            total[carries] += weight[carries] * height
    return total


def _refined(z: FloatArray, row: FloatArray, column: FloatArray, heights: FloatArray) -> float:
    """Put better heights in place of bilinear ones; return the share that had no 64 neighbours."""
    (i, v), (j, u) = _split(row), _split(column)
    between = ~np.isnan(heights) & ((u > 0.0) | (v > 0.0))
    low, high = _REACH[0], _REACH[-1]
    inside = (i + low >= 0) & (i + high < z.shape[0]) & (j + low >= 0) & (j + high < z.shape[1])
    which = np.flatnonzero(between & inside)
    done = 0
    for k in np.array_split(which, max(1, -(-which.size // _AT_ONCE))):
        rows, columns = np.broadcast_arrays(
            i[k, None, None] + _REACH[:, None], j[k, None, None] + _REACH
        )
        patch = z[rows, columns]
        lost = np.isnan(patch)
        if lost.any():
            patch[lost] = _instead(z, rows[lost], columns[lost])
        whole = ~np.isnan(patch).any(axis=(1, 2))
        some, patch = k[whole], patch[whole]
        better = _lanczos(patch, v[some], u[some]) - heights[some]
        most = _bend(patch, v[some], u[some])
        heights[some] += np.clip(better, -most, most)
        done += some.size
    n = int(np.count_nonzero(between))
    return (n - done) / n if n else 0.0


def _instead(z: FloatArray, row: NDArray[np.intp], column: NDArray[np.intp]) -> FloatArray:
    """Return what the pixels around say of missing ones, NaN where fewer than two thirds were measured.

    The best linear prediction of waves of 3 pixels and more, all alike, of an unknown plane below them.
    """
    offsets, near, C, c = _prediction()
    pixel, at = np.unique(row * z.shape[1] + column, return_inverse=True)
    found = np.full(pixel.size, np.nan)
    for part in np.array_split(np.arange(pixel.size), -(-pixel.size // _MISSING_AT_ONCE)):
        i, j = np.divmod(pixel[part], z.shape[1])
        around = _at(z, *((v[:, None] + o).ravel() for v, o in zip((i, j), offsets, strict=True)))
        around = around.reshape(part.size, -1)
        seen = ~np.isnan(around)
        known = (seen.mean(axis=1) >= _KNOWN) & (seen[:, near].mean(axis=1) >= _KNOWN)
        seen, heights = seen[known], np.where(seen, around, 0.0)[known]
        both = seen[:, :, None] & seen[:, None, :]
        weights = np.linalg.solve(np.where(both, C, np.eye(c.size)), (seen * c)[:, :, None])[
            ..., 0
        ]
        found[part[known]] = np.einsum("ij,ij->i", weights, heights)
    return found[at]


@lru_cache(maxsize=1)
def _prediction() -> tuple[NDArray[np.intp], BoolArray, FloatArray, FloatArray]:
    """Return rows and columns around a pixel, which touch it, and their covariances with each other and it."""
    y, x = (v.ravel() for v in np.mgrid[-4:5, -4:5])
    squares = x * x + y * y
    here = (squares <= 16) & (squares > 0)
    y, x, squares = y[here], x[here], squares[here]
    f = np.linspace(-1.0, 1.0, 81) / 3.0
    fy, fx = (v[np.add.outer(f * f, f * f) <= 1.0 / 9.0] for v in np.meshgrid(f, f))

    def covariance(dy: FloatArray, dx: FloatArray, plane: FloatArray) -> FloatArray:
        waves = np.cos(2.0 * np.pi * (dy[..., None] * fy + dx[..., None] * fx)).mean(axis=-1)
        return np.asarray(waves + _OF_PLANE * plane)

    level = 1.0 + np.multiply.outer(y, y) + np.multiply.outer(x, x)
    C = covariance(np.subtract.outer(y, y), np.subtract.outer(x, x), level)
    C += _NOISE * np.eye(x.size)
    return np.stack([y, x]), squares <= 2, C, covariance(y, x, np.ones(x.size))


def _lanczos(patch: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
    """Return heights within 8 x 8 pixels: of their fitted plane, and by Lanczos-4 of what it leaves."""
    # p = m + r y + c x + s x y about the middle; weights a, b with sum 1 of rows and columns:
    # z(v, u) = sum a b (z - p) + p(v, u), and m drops out
    t = _REACH.astype(np.float64) - 0.5
    y, x = v - 0.5, u - 0.5
    a, b = (w / w.sum(axis=1, keepdims=True) for w in (_sinc4(y, t), _sinc4(x, t)))
    squares = float(t @ t)
    r = np.einsum("nij,i->n", patch, t) / (t.size * squares)
    c = np.einsum("nij,j->n", patch, t) / (t.size * squares)
    s = np.einsum("nij,i,j->n", patch, t, t) / squares**2
    weighted = np.einsum("nij,ni,nj->n", patch, a, b)
    ya, xb = a @ t, b @ t
    return np.asarray(weighted + r * (y - ya) + c * (x - xb) + s * (y * x - ya * xb))


def _bend(patch: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
    """Return how far a height may lie off the bilinear one: as far as the pixels of both sides bend.

    A pixel bends by |z_k - (z_k-1 + z_k+1) / 2|; of the two pixels on each side of the cell the larger,
    of the sides the smaller. No wave of three pixels and more is held back, at any phase; a step is,
    as one side of it is straight.
    """
    middle = -_REACH[0]
    total = np.zeros(v.size)
    for along, beside, lines in ((u, v, patch), (v, u, patch.transpose(0, 2, 1))):
        bent = np.abs(np.diff(lines[:, middle : middle + 2], 2, axis=2)) / 2.0
        sides = np.minimum(bent[..., :2].max(axis=2), bent[..., -2:].max(axis=2))
        held = np.where(beside > 0.0, sides.max(axis=1), sides[:, 0])
        total += np.where(along > 0.0, held, 0.0)
    return total


def _sinc4(place: FloatArray, t: FloatArray) -> FloatArray:
    d = place[:, None] - t
    return np.asarray(np.sinc(d) * np.sinc(d / 4.0))


def _split(index: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return whole and fractional part; what lies on a pixel within rounding lies on it."""
    whole = np.floor(index + _ON_PIXEL)
    part = index - whole
    return whole.astype(np.intp), np.where(part > _ON_PIXEL, part, 0.0)


def _nearest(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    near = [np.floor(v + 0.5 + _ON_PIXEL).astype(np.intp) for v in (row, column)]
    for k, (v, n) in enumerate(zip((row, column), z.shape, strict=True)):
        at_rim = np.abs(v - (n - 0.5)) <= _ON_PIXEL  # the far rim belongs to the last pixel
        near[k] = np.where(at_rim, n - 1, near[k])
    return _at(z, near[0], near[1])


def _at(z: FloatArray, row: NDArray[np.intp], column: NDArray[np.intp]) -> FloatArray:
    """Return heights at whole indices, NaN outside the map."""
    ny, nx = z.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    height = np.full(row.size, np.nan)
    height[inside] = z[row[inside], column[inside]]
    return height
