"""Straightness of a profile: minimum zone, least squares, end points.

The reference is a line through the valid samples; the deviation is positive out of the material.
By default it is measured along z, as machines and straightedges do; ``normal=True`` measures it at
right angles to the line, as ISO 12780 words it. Both differ by the square of half the slope.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.numbers import flag
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.parameters.form_result import FormDeviation, Reference, Support, form_table

_FREEDOMS = 2
"""Slope and intercept."""

_UNEVEN = 1e-3
"""Spread of the steps, relative, from which least squares over samples is worth a note."""


def straightness_deviation(
    profile: Profile, *, reference: Reference = "MZ", normal: bool = False
) -> FormDeviation:
    """Return the straightness deviation STRt of a profile.

    The minimum zone is exact: it touches two points on one side and, between them, one on the
    other. Least squares weights every sample equally. NaN is excluded and counted. No filter is
    applied. O(n).

    References
    ----------
    .. [1] ISO 12780-1:2011 (parameters), ISO 1101:2017 (default reference).
    .. [2] ISO 230-1:2012 (end-point line).

    Examples
    --------
    >>> profile = Profile([0.0, 0.1, 0.2, 0.3], [0.0, 2e-6, 1e-6, 0.0])
    >>> zone = straightness_deviation(profile)
    >>> round(zone.value * 1e6, 6), zone.support.indices.tolist(), zone.is_optimal
    (2.0, [0, 3, 1], True)
    """
    normal = flag(normal, "normal")
    valid = np.flatnonzero(~np.isnan(profile.z))
    if valid.size <= _FREEDOMS:
        raise TooFewSamplesError(
            f"straightness needs 3 valid samples, got {valid.size} of {len(profile)}: two points "
            "always lie on a line; measure more points"
        )
    x, z = profile.x[valid], profile.z[valid]
    width = math.nan
    held = None
    if reference == "MZ":
        zone = minimum_zone_line(x, z, normal=normal)
        slope, height, centre, width = zone.slope, zone.height, zone.centre, zone.width
        held = (zone.indices, zone.sides, zone.weights)
    elif reference == "LS":
        slope, height, centre = least_squares_line(x, z)
        if normal:
            slope, height, centre = _total_least_squares(x, z)
    elif reference == "EP":
        slope, height, centre = float(z[-1] - z[0]) / float(x[-1] - x[0]), float(z[0]), float(x[0])
    else:
        raise DataError(f"straightness has the references MZ, LS and EP, not {reference!r}")
    tilt = 1.0 / math.sqrt(1.0 + slope * slope) if normal else 1.0
    local = tilt * (z - (height + slope * (x - centre)))
    if reference == "EP":
        local[0] = local[-1] = 0.0
    if held is None:
        ends = np.array([local.argmax(), local.argmin()])
        held = (ends, np.array([1, -1]), np.array([1.0, 1.0]))
    at, sides, weights = held
    return FormDeviation(
        kind="straightness",
        reference=reference,
        table=form_table(
            "straightness",
            reference,
            local,
            n_total=len(profile),
            history=profile.history,
            settings={"width": "normal" if normal else "vertical"},
            notes=_notes(profile, x, slope, reference, normal),
        ),
        reference_parameters={
            "slope": Quantity(slope, "1", f"slope dz/dx of the {reference} line"),
            "intercept": Quantity(
                height - slope * centre, "m", f"height of the {reference} line at x = 0"
            ),
        },
        residual=_residual(profile, valid, local, reference, normal),
        support=Support(valid[at], x[at], z[at], sides, weights),
        objective=float(np.ptp(local)) if reference == "MZ" else math.nan,
        bound=width,
    )


def _total_least_squares(
    x: NDArray[np.float64], z: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Return slope, height and position of the middle of the line of least normal deviations."""
    centre, height = float(x.mean()), float(z.mean())
    scale = float(x[-1] - x[0])
    u, w = (x - centre) / scale, (z - height) / scale
    difference, both = float(u @ u - w @ w), 2.0 * float(u @ w)
    length = math.hypot(difference, both)
    # tan of half the angle, from the side that loses no digits
    slope = both / (difference + length) if difference > 0.0 else (length - difference) / both
    return slope, height, centre


def _residual(
    profile: Profile, valid: NDArray[np.intp], local: FloatArray, reference: str, normal: bool
) -> Profile:
    z = np.full(len(profile), np.nan)
    z[valid] = local
    step = Step(
        "straightness", {"reference": reference, "width": "normal" if normal else "vertical"}
    )
    return Profile(profile.x, z, metadata=profile.metadata, history=(*profile.history, step))


def _notes(
    profile: Profile, x: FloatArray, slope: float, reference: str, normal: bool
) -> list[str]:
    notes = []
    if reference == "EP" and (x[0] != profile.x[0] or x[-1] != profile.x[-1]):
        notes.append("the profile does not end where it was measured: first and last valid sample")
    if normal:
        notes.append("deviations at right angles to the line")
    else:
        notes.append(
            f"deviations along z; at right angles to the line they are {_relative(slope):.2g} "
            "smaller, relative"
        )
    steps = np.diff(x)
    mean = float(x[-1] - x[0]) / steps.size
    if reference != "EP" and float(np.abs(steps - mean).max()) > _UNEVEN * mean:
        which = "the line and STRq weight" if reference == "LS" else "STRq weights"
        notes.append(f"positions are not uniform: {which} every sample equally")
    return notes


def _relative(slope: float) -> float:
    """Return 1 - cos(atan(slope)) without cancellation."""
    root = math.sqrt(1.0 + slope * slope)
    return slope * slope / (root * (1.0 + root))


# ---- narrowest zone between two parallel lines: convex hull over a working set, exact ----------
# The zone of least width touches the points along one edge of their convex hull and at one vertex of
# the opposite side. The hull is not made of all points: it is made of a few of them, the
# best zone of these is laid over all, the points that stick out are added, and so on. The width over
# the working set never exceeds the width over all points, so when nothing sticks out the zone is
# proven: its width is its own lower bound. This holds for vertical and for orthogonal widths, though
# the latter is not a convex problem.

_MAX_EXCHANGES = 1000
"""Hulls at most; five to ten are usual."""

_EPS = float(np.finfo(float).eps)

_TIE = 1e-12
"""Relative difference of widths of equally good zones."""


@dataclass(frozen=True, slots=True)
class LineZone:
    """Middle line of the narrowest zone and the three points that hold it."""

    slope: float  # slope of the zone
    height: float  # m: height of the middle line at `centre`
    centre: float  # m: middle of the range of x
    # m: width over the working set, vertical or orthogonal: a lower bound for all points
    width: float
    # shape (3,): supporting points, +1 or -1, and weights that sum to 1 on each side and have the
    # same centre of gravity along the line on both
    indices: IntArray
    sides: IntArray
    weights: FloatArray


def least_squares_line(x: FloatArray, z: FloatArray) -> tuple[float, float, float]:
    """Return slope, height at the middle of x, and the middle of x, of the least-squares line."""
    centre = 0.5 * (float(x[0]) + float(x[-1]))
    half = 0.5 * float(x[-1] - x[0])
    t = (x - centre) / half
    mean_t, mean_z = float(t.mean()), float(z.mean())
    t -= mean_t
    gradient = float(np.dot(t, z - mean_z) / np.dot(t, t))
    return gradient / half, mean_z - gradient * mean_t, centre


def minimum_zone_line(x: FloatArray, z: FloatArray, *, normal: bool = False) -> LineZone:
    """Return the narrowest zone between two parallel lines that holds all points.

    O(n) for each exchange; 1e6 points take less than 0.1 s.

    Examples
    --------
    >>> zone = minimum_zone_line(np.array([0.0, 1.0, 2.0]), np.array([0.0, 2e-9, 0.0]))
    >>> zone.slope, round(zone.width * 1e9, 6), zone.sides.tolist()
    (0.0, 2.0, [-1, -1, 1])
    """
    slope, height, centre = least_squares_line(x, z)
    half = 0.5 * float(x[-1] - x[0])
    t = (x - centre) / half
    residual = z - (height + slope * half * t)
    scale = float(max(residual.max(), -residual.min())) or 1.0
    residual /= scale
    working = np.unique(np.concatenate([[0, x.size - 1], chunk_extremes(residual)]))
    left = np.empty_like(residual)
    for _ in range(_MAX_EXCHANGES):
        zones = _zones(t[working], residual[working])
        slopes = slope + zones.slope * (scale / half)
        widths = zones.width / np.sqrt(1.0 + slopes**2) if normal else zones.width
        support = working[zones.support]
        # The weights of both sides balance along the line: along x for a vertical zone.
        along = t[support]
        if normal:
            heights = (slope * half * along + scale * residual[support]) / half
            along = along + slopes[:, None] * heights
        # where the foot of the vertex lies on its edge, 0 at the first end and 1 at the last
        share = (along[:, 2] - along[:, 0]) / (along[:, 1] - along[:, 0])
        best = _best(widths, share)
        np.multiply(t, -zones.slope[best], out=left)
        left += residual
        found = np.unique(chunk_extremes(left))
        top, bottom = float(left[working].max()), float(left[working].min())
        rounding = 4.0 * _EPS * (1.0 + abs(float(zones.slope[best])))
        out = (left[found] > top + rounding) | (left[found] < bottom - rounding)
        new = np.setdiff1d(found[out], working)
        if not new.size:
            break
        working = np.union1d(working, new)
    else:
        raise NotConvergedError(
            f"the minimum zone was not found in {_MAX_EXCHANGES} exchanges; report these data"
        )
    part = min(max(float(share[best]), 0.0), 1.0)
    return LineZone(
        slope=float(slopes[best]),
        height=height + scale * 0.5 * (top + bottom),
        centre=centre,
        width=float(widths[best]) * scale,
        indices=support[best],
        sides=np.array([1, 1, -1], dtype=np.intp) * zones.side[best],
        weights=np.array([1.0 - part, part, 1.0]),
    )


@dataclass(frozen=True, slots=True)
class _Zones:
    """Every edge of a hull with the vertex opposite to it."""

    slope: FloatArray
    width: FloatArray
    support: IntArray
    side: IntArray


def _zones(t: FloatArray, r: FloatArray) -> _Zones:
    """Return the zones along the edges of the hull of points with ascending t."""
    upper = _hull(t, r, 1.0)
    lower = _hull(t, r, -1.0)
    parts = [_side_zones(t, r, upper, lower, 1), _side_zones(t, r, lower, upper, -1)]
    return _Zones(
        slope=np.concatenate([p.slope for p in parts]),
        width=np.concatenate([p.width for p in parts]),
        support=np.concatenate([p.support for p in parts]),
        side=np.concatenate([p.side for p in parts]),
    )


def _side_zones(
    t: FloatArray, r: FloatArray, hull: IntArray, other: IntArray, side: int
) -> _Zones:
    """Return the zones along the edges of one side of the hull (+1 is the upper)."""
    slopes = np.diff(r[hull]) / np.diff(t[hull])
    rising = side * np.diff(r[other]) / np.diff(t[other])
    # Parallel edges on both sides: both ends of the opposite edge are tried.
    ends = [np.searchsorted(rising, side * slopes, side=end) for end in ("left", "right")]
    vertex = other[np.concatenate(ends)]
    first, second = np.tile(hull[:-1], 2), np.tile(hull[1:], 2)
    slope = np.tile(slopes, 2)
    width = side * (r[first] - r[vertex] - slope * (t[first] - t[vertex]))
    support = np.column_stack([first, second, vertex])
    return _Zones(slope, width, support, np.full(slope.size, side, dtype=np.intp))


def _hull(t: FloatArray, r: FloatArray, side: float) -> IntArray:
    """Return the indices of the upper (+1) or lower (-1) hull of points with ascending t."""
    ts, rs = t.tolist(), (side * r).tolist()
    hull: list[int] = []
    for k, (a, b) in enumerate(zip(ts, rs, strict=True)):
        while len(hull) > 1:
            i, j = hull[-2], hull[-1]
            if (ts[j] - ts[i]) * (b - rs[i]) < (a - ts[i]) * (rs[j] - rs[i]):
                break
            hull.pop()
        hull.append(k)
    return np.array(hull, dtype=np.intp)


def _best(widths: FloatArray, share: FloatArray) -> int:
    """Return the narrowest zone; among equals the one whose vertex stands over its edge."""
    least = float(widths.min())
    outside = np.maximum(np.maximum(-share, share - 1.0), 0.0)
    tied = widths <= least + _TIE * max(least, _EPS)
    return int(np.flatnonzero(tied)[outside[tied].argmin()])


# ---- narrowest zone or tightest reference over many points: an exact linear program by exchange ----
# A reference that is linear in its coefficients, ``f_i = A_i c`` with ``A_i[0] = 1`` (line, plane,
# limacon), lies in the middle of the narrowest zone when it solves
#
#     minimise e  subject to  -e <= z_i - A_i c <= e          ("zone")
#
# The tightest reference from outside minimises c[0] subject to ``A_i c >= z_i`` ("outer"), the one
# from inside maximises c[0] subject to ``A_i c <= z_i`` ("inner"). Only a few points matter, so a
# small program over a working set is solved (HiGHS), the points it violates most are added, and so
# on until none is violated; from one vertex to the next it is a pivot or two of the dual simplex. The
# solution is then found again from its supporting points by a linear system, to rounding. The
# multipliers of these points give a bound that nobody can beat: where the bound equals what was
# achieved, the support is a proof of the optimum.

Mode = Literal["zone", "outer", "inner"]

_ZONE_MAX_EXCHANGES = 200
"""Programs at most; five to ten are usual."""

_PIVOTS = 30
"""Pivots at most from one vertex to the next, before the solver is asked; one or two are usual."""

_FEASIBLE = 4e-15
"""Violation that counts as rounding, relative to the largest deviation."""

_ACTIVE = 1e-9
"""Multiplier above which a point supports the solution; they sum to about 1."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """Solution of a zone or a one-sided reference."""

    coefficients: FloatArray  # shape (k,): of the basis, in the unit of z
    objective: float  # full width of the zone, or c[0] of a one-sided reference, unit of z
    # what no reference can beat, from `weights` alone: lower for "zone" and "outer", upper for
    # "inner"
    bound: float
    indices: IntArray  # shape (m,): supporting points and +1 (upper side) or -1 (lower side)
    sides: IntArray
    # shape (m,): multipliers, positive. They sum to 1 on each side, and ``sum(side weight A) = 0``
    # (zone) or ``sum(weight A) = (1, 0, ...)`` (one side)
    weights: FloatArray


def chunk_extremes(residual: FloatArray, n_chunks: int = 32) -> IntArray:
    """Return where a residual is largest and smallest in each of some equal parts."""
    n = residual.size
    n_chunks = min(n_chunks, n)
    length = n // n_chunks
    whole = residual[: length * n_chunks].reshape(n_chunks, length)
    start = np.arange(n_chunks) * length
    found = [whole.argmax(axis=1) + start, whole.argmin(axis=1) + start]
    rest = residual[length * n_chunks :]
    if rest.size:
        found.append(np.array([rest.argmax(), rest.argmin()]) + length * n_chunks)
    return np.concatenate(found)


def optimum(
    rows: Callable[[IntArray], tuple[FloatArray, FloatArray]],
    extremes: Callable[[FloatArray], IntArray],
    seed: Sequence[int] | IntArray,
    *,
    mode: Mode,
    start: FloatArray,
    scale: float,
) -> Optimum:
    """Return the narrowest zone or the tightest one-sided reference over all points."""
    working = np.unique(np.asarray(seed, dtype=np.intp))
    shift = np.zeros_like(start)
    # owners and sides of the rows that hold the last one
    held: tuple[IntArray, IntArray] | None = None
    for _ in range(_ZONE_MAX_EXCHANGES):
        matrix, heights = rows(working)
        residual = (heights - matrix @ start) / scale
        cost, g, h, owner, side = _program(matrix, residual, mode)
        found = None
        if held is not None:  # points are added behind the others, so owners stay
            below = (held[1] < 0) & (mode == "zone")
            found = _pivoted(cost, g, h, held[0] + below * working.size)
        u, active, y = found or _solve(cost, g, h)
        held = owner[active], side[active]
        shift = u[: start.size]
        candidates = np.unique(extremes(start + scale * shift))
        new = np.setdiff1d(candidates, working)
        if new.size:
            matrix_new, heights_new = rows(new)
            left = (heights_new - matrix_new @ start) / scale - matrix_new @ shift
            e = u[-1] if mode == "zone" else 0.0
            excess = {"zone": np.abs(left) - e, "outer": left, "inner": -left}[mode]
            rounding = _FEASIBLE * (1.0 + float(np.abs(heights_new).max()) / scale)
            new = new[excess > rounding]
        if not new.size:
            break
        working = np.concatenate([working, new])
    else:
        raise NotConvergedError(
            f"the minimum zone was not found in {_ZONE_MAX_EXCHANGES} exchanges; report these data"
        )
    factor = {"zone": 2.0, "outer": 1.0, "inner": -1.0}[mode]
    base = 0.0 if mode == "zone" else float(start[0])
    weights = y * (2.0 if mode == "zone" else 1.0)
    return Optimum(
        coefficients=start + scale * shift,
        objective=base + scale * float(factor * (cost @ u)),
        bound=base + scale * float(factor * (y @ h[active])),
        indices=working[owner[active]],
        sides=side[active],
        weights=weights,
    )


def _program(
    matrix: FloatArray, residual: FloatArray, mode: Mode
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray]:
    """Minimise cost u subject to g u >= h; owner and side of each row."""
    n, k = matrix.shape
    index = np.arange(n)
    plus, minus = np.ones(n, dtype=np.intp), -np.ones(n, dtype=np.intp)
    if mode == "outer":
        return np.eye(k)[0], matrix, residual, index, plus
    if mode == "inner":
        return -np.eye(k)[0], -matrix, -residual, index, minus
    one = np.ones((n, 1))
    g = np.vstack([np.hstack([matrix, one]), np.hstack([-matrix, one])])
    h = np.concatenate([residual, -residual])
    return np.eye(k + 1)[k], g, h, np.tile(index, 2), np.concatenate([plus, minus])


def _solve(
    cost: FloatArray, g: FloatArray, h: FloatArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the vertex, its active rows and their multipliers, refined to rounding."""
    from scipy.optimize import linprog

    u = np.zeros(cost.size)
    zoom = 1.0
    active = np.zeros(0, dtype=np.intp)
    y = np.zeros(0)
    for _ in range(4):
        solved = linprog(cost, -g, -(h - g @ u) * zoom, bounds=(None, None), method="highs-ds")
        if solved.status != 0 or solved.x is None:
            raise DegenerateFitError(
                f"the points do not bound the reference ({solved.message.strip()}); measure "
                "more points, spread over the whole feature"
            )
        u = u + solved.x / zoom
        multipliers = -np.asarray(solved.ineqlin.marginals)
        active = np.flatnonzero(multipliers > _ACTIVE)
        y = _multipliers(g[active], cost, multipliers[active])
        # The active rows hold with equality: this removes the tolerance of the solver.
        vertex = u + np.linalg.lstsq(g[active], h[active] - g[active] @ u, rcond=None)[0]
        violated = float((h - g @ vertex).max())
        if violated <= 10.0 * _FEASIBLE:
            return vertex, active, y
        zoom *= min(1e6, 1.0 / violated)
    return u, active, y


def _pivoted(
    cost: FloatArray, g: FloatArray, h: FloatArray, active: IntArray
) -> tuple[FloatArray, IntArray, FloatArray] | None:
    """Return the vertex, its rows and multipliers from the vertex of fewer rows (dual simplex), or None."""
    if active.size != cost.size:
        return None
    active = active.copy()
    for _ in range(_PIVOTS):
        try:
            inverse = np.linalg.inv(g[active])
        except np.linalg.LinAlgError:
            return None
        u = inverse @ h[active]
        u = u + inverse @ (h[active] - g[active] @ u)
        y = _multipliers(g[active], cost, cost @ inverse)
        if y.min() <= _ACTIVE:  # more rows than unknowns hold it: for the solver
            return None
        violated = h - g @ u
        worst = int(np.argmax(violated))
        if violated[worst] <= 10.0 * _FEASIBLE:
            return u, active, y
        step = g[worst] @ inverse
        with np.errstate(divide="ignore"):
            ratio = np.where(step > 0.0, y / step, np.inf)
        leaving = int(np.argmin(ratio))
        if not np.isfinite(ratio[leaving]):
            return None
        active[leaving] = worst
    return None


def _multipliers(g: FloatArray, cost: FloatArray, near: FloatArray) -> FloatArray:
    """Return multipliers with g^T y = cost to rounding, close to those of the solver."""
    y = near + np.linalg.lstsq(g.T, cost - g.T @ near, rcond=None)[0]
    return y if (y >= 0.0).all() else near
