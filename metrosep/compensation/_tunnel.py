"""Private: polylines with the fewest links inside a tunnel around a curve; best values at knots.

Lines are points (value, slope) of a plane; each sample of the tunnel cuts the polygon of the lines
that still pass by two half-planes. Where nothing is left, the line that got farthest is a link,
and the next one starts anywhere on the rest of that link (a window).
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotConvergedError

Point = tuple[float, float]
Polygon = list[Point]

_FAR = 100.0
"""Start of the search: values and slopes so many times the height and the steepest tunnel."""

_ON_BOUND = 1e-11
"""Distance from a bound, over the height of the tunnel, that counts as contact."""


def fewest_links(
    x: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return knots of a polyline with free values between two bounds, fewest links.

    The bounds are linear between the samples. Units: x and values of order 1.
    """
    lines: list[tuple[float, float, float]] = []  # x0, value there, slope
    start_high = start_low = reached = 0
    extra: tuple[float, float, bool] | None = None  # place, bound, is it the lower one
    while True:
        line, failed, up = _longest(x, low, high, start_low, start_high, extra)
        if failed is not None and failed <= reached:
            raise NotConvergedError(
                "the tunnel is narrower than the rounding of the curve: use a larger tolerance"
            )
        reached = failed or reached
        lines.append(line)
        if failed is None:
            return _corners(x, lines)
        x0, v0, s0 = line
        bound, other = (low, high) if up else (high, low)
        gap = bound - (v0 + s0 * (x - x0))
        # between the samples before and at the failure the link leaves the tunnel
        share = gap[failed - 1] / (gap[failed - 1] - gap[failed])
        leave = x[failed - 1] + min(max(float(share), 0.0), 1.0) * (x[failed] - x[failed - 1])
        contact = _contact(x, other, line, start_high if up else start_low, failed)
        extra = (float(leave), v0 + s0 * (float(leave) - x0), up)
        start_low, start_high = (failed, contact) if up else (contact, failed)


def _contact(
    x: FloatArray, bound: FloatArray, line: tuple[float, float, float], first: int, failed: int
) -> int:
    """Return the last sample before the failure at which a link touches the other bound."""
    x0, v0, s0 = line
    if first >= failed:
        return failed - 1
    room = np.abs(bound[first:failed] - (v0 + s0 * (x[first:failed] - x0)))
    near = np.flatnonzero(room <= room.min() + _ON_BOUND)
    return first + int(near[-1])


def _longest(
    x: FloatArray,
    low: FloatArray,
    high: FloatArray,
    start_low: int,
    start_high: int,
    extra: tuple[float, float, bool] | None,
) -> tuple[tuple[float, float, float], int | None, bool]:
    """Return the line that gets farthest, the sample at which it fails, and whether it was too low."""
    first = min(start_low, start_high)
    x0 = float(x[first])
    polygon = _everything(x, low, high, x0)
    if extra is not None:
        place, value, is_low = extra
        polygon = _cut(polygon, place - x0, value, 1.0 if is_low else -1.0)
    away = (x[first:] - x0).tolist()
    lows, highs = low[first:].tolist(), high[first:].tolist()
    for k, (d, lowest, highest) in enumerate(zip(away, lows, highs, strict=True), start=first):
        reach = [v + s * d for v, s in polygon]
        most, least = max(reach), min(reach)
        if k >= start_low and most < lowest:
            v, s = polygon[reach.index(most)]
            return (x0, v, s), k, True
        if k >= start_high and least > highest:
            v, s = polygon[reach.index(least)]
            return (x0, v, s), k, False
        if k >= start_low and least < lowest:
            polygon = _cut(polygon, d, lowest, 1.0)
        if k >= start_high and most > highest:
            polygon = _cut(polygon, d, highest, -1.0)
    v = sum(p[0] for p in polygon) / len(polygon)
    s = sum(p[1] for p in polygon) / len(polygon)
    return (x0, v, s), None, False


def _everything(x: FloatArray, low: FloatArray, high: FloatArray, x0: float) -> Polygon:
    height = float(np.ptp(np.r_[low, high]))
    middle = float(np.mean(low))
    steep = _FAR * max(height / float(np.diff(x).min()), 1e-300)
    tall = _FAR * height + steep * float(x[-1] - x0)
    return [
        (middle - tall, -steep),
        (middle + tall, -steep),
        (middle + tall, steep),
        (middle - tall, steep),
    ]


def _cut(polygon: Polygon, d: float, bound: float, sign: float) -> Polygon:
    """Return the part of a convex polygon where ``sign (v + s d - bound) >= 0``."""
    distance = [sign * (v + s * d - bound) for v, s in polygon]
    if max(distance) < 0.0:  # by rounding: the two bounds meet in the last vertex
        return [polygon[distance.index(max(distance))]]
    kept: Polygon = []
    for i, point in enumerate(polygon):
        here, before = distance[i], distance[i - 1]
        if (here >= 0.0) != (before >= 0.0):
            t = before / (before - here)
            old = polygon[i - 1]
            kept.append((old[0] + t * (point[0] - old[0]), old[1] + t * (point[1] - old[1])))
        if here >= 0.0:
            kept.append(point)
    return kept


def _corners(
    x: FloatArray, lines: list[tuple[float, float, float]]
) -> tuple[FloatArray, FloatArray]:
    places, values = [float(x[0])], []
    x0, v0, s0 = lines[0]
    values.append(v0 + s0 * (float(x[0]) - x0))
    for (xa, va, sa), (xb, vb, sb) in itertools.pairwise(lines):
        at = (vb - va + sa * xa - sb * xb) / (sa - sb)
        places.append(at)
        values.append(va + sa * (at - xa))
    x0, v0, s0 = lines[-1]
    places.append(float(x[-1]))
    values.append(v0 + s0 * (float(x[-1]) - x0))
    return np.array(places), np.array(values)


def fewest_chords(
    x: FloatArray, c: FloatArray, tolerance: float, nodes: NDArray[np.intp]
) -> FloatArray:
    """Return the positions of the fewest knots on the curve whose chords stay within a tolerance.

    `nodes` are the samples at which a knot may lie, first and last sample among them.
    """
    far = nodes.size
    links = np.full(far, far, dtype=np.intp)
    came = np.zeros(far, dtype=np.intp)
    links[0] = 0
    for i in range(far - 1):
        if links[i] == far:
            continue
        d = x[nodes[i] + 1 :] - x[nodes[i]]
        rise = c[nodes[i] + 1 :] - c[nodes[i]]
        upper = np.minimum.accumulate((rise + tolerance) / d)
        lower = np.maximum.accumulate((rise - tolerance) / d)
        ends = nodes[i + 1 :] - nodes[i] - 1
        slope = rise[ends] / d[ends]
        passes = (slope <= upper[ends]) & (slope >= lower[ends])
        better = i + 1 + np.flatnonzero(passes & (links[i + 1 :] > links[i] + 1))
        links[better], came[better] = links[i] + 1, i
    path = [far - 1]
    while path[-1] > 0:
        path.append(int(came[path[-1]]))
    if x.size and links[-1] == far:
        raise NotConvergedError(
            f"no chain of chords on the allowed knots stays within {tolerance:.3g} m; add knots to "
            "the grid"
        )
    return np.asarray(x[nodes[path[::-1]]])


def minimax_values(
    x: FloatArray, c: FloatArray, knots: FloatArray, zero: float | None
) -> FloatArray:
    """Return values at knots with the smallest largest deviation; values of order 1, x rising."""
    from scipy.optimize import linprog
    from scipy.sparse import coo_matrix, hstack, vstack

    # at knots between samples the deviation can be largest too
    places = np.union1d(x, knots)
    wanted = np.interp(places, x, c)
    hats = _hats(places, knots)
    ones = coo_matrix(np.ones((places.size, 1)))
    matrix = vstack([hstack([hats, -ones]), hstack([-hats, -ones])]).tocsr()
    equal, right = None, None
    if zero is not None:
        row = _hats(np.array([zero]), knots)
        equal, right = hstack([row, coo_matrix((1, 1))]).tocsr(), np.zeros(1)
    result = linprog(
        np.r_[np.zeros(knots.size), 1.0],
        A_ub=matrix,
        b_ub=np.r_[wanted, -wanted],
        A_eq=equal,
        b_eq=right,
        bounds=[(None, None)] * knots.size + [(0.0, None)],
        method="highs",
    )
    if not result.success or result.x is None:
        raise NotConvergedError(f"the linear program for the values failed: {result.message}")
    return np.asarray(result.x[:-1], dtype=np.float64)


def _hats(places: FloatArray, knots: FloatArray):  # type: ignore[no-untyped-def]
    """Return the matrix of the linear interpolation between knots, sparse."""
    from scipy.sparse import coo_matrix

    left = np.clip(np.searchsorted(knots, places, side="right") - 1, 0, knots.size - 2)
    share = (places - knots[left]) / (knots[left + 1] - knots[left])
    rows = np.arange(places.size)
    return coo_matrix(
        (np.r_[1.0 - share, share], (np.r_[rows, rows], np.r_[left, left + 1])),
        shape=(places.size, knots.size),
    )
