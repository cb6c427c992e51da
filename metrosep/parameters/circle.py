"""Least-squares, minimum-zone, circumscribed and inscribed circle of a round trace.

The limacon ``R + a cos x + b sin x`` stands for a circle whose centre is at (a, b):
right for small eccentricity, linear, and solved exactly by linear programming. ``exact=True`` takes
true circles in the plane: from the centre found, angles and radii are taken anew and the program is
solved again, until the centre rests.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import NotConvergedError
from metrosep.parameters.straightness import Mode, Optimum, chunk_extremes, optimum

_MAX_CENTRES = 100
"""Centres tried; three or four are usual."""

_ALL_POINTS = 64
"""Up to this many points the program starts with all of them."""

_JUMP = 0.9 * math.pi
"""Largest angle between neighbours of the starting points, where the trace has no larger gap."""

_OPPOSITE = 1e-9
"""Lever of a point below which a move across a diameter does not reach it."""

_MODES: dict[str, Mode] = {"MZ": "zone", "MC": "outer", "MI": "inner"}


@dataclass(frozen=True, slots=True, eq=False)
class CirclePoints:
    """Points of a trace around a full or partial turn."""

    angle: FloatArray  # shape (n,), rad: ascending, within one turn, no gap of half a turn
    deviation: FloatArray  # shape (n,), m: radius minus `radius`
    weight: FloatArray  # shape (n,): of each sample in least squares
    # m: radius that the deviation is counted from; needed for exact circles
    radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CircleSolution:
    """Reference circle and local deviations."""

    centre: tuple[float, float]  # of (float, float), m: along angle 0 and along pi/2
    deviation: float  # m: radius of the circle minus the radius of the points
    local: FloatArray  # shape (n,), m: deviations from the circle, positive outwards
    found: Optimum | None  # support and bound; None for least squares


def best_circle(points: CirclePoints, reference: str, *, exact: bool = False) -> CircleSolution:
    """Return the least-squares, minimum-zone, circumscribed or inscribed circle of a trace."""
    view = _View(points, (0.0, 0.0))
    coefficients, found = _solve(view, points, reference)
    if not exact:
        if found is not None and found.indices.size == 2 and reference in ("MC", "MI"):
            usual, _ = _least_squares(view, points.weight)
            coefficients = _between(view, coefficients, found, usual, reference)
        centre = (float(coefficients[1]), float(coefficients[2]))
        local = view.deviation - centre[0] * view.cosine - centre[1] * view.sine
    elif reference == "LS":
        view = _rest(points, view, coefficients)
        centre, local = view.centre, view.deviation.copy()
    else:
        view, found = _descend(points, view, coefficients, found, reference)
        centre, local = view.centre, view.deviation.copy()
    radius = _radius(local, points, reference)
    return CircleSolution(centre, radius, local - radius, found)


def _between(
    view: _View, coefficients: FloatArray, found: Optimum, usual: FloatArray, reference: str
) -> FloatArray:
    """Return the centre where two opposite points leave the limacon free to move across.

    True circles are not free: the radius through both points grows with the square of the offset
    across. The circumscribed circle takes the smallest offset, the inscribed one the largest. The
    offset counts from the least-squares centre, so that centring of the part does not matter.
    """
    i = int(found.indices[0])
    across = np.array([-view.sine[i], view.cosine[i]])
    side = 1.0 if reference == "MC" else -1.0
    slack = coefficients[0] + coefficients[1] * view.cosine + coefficients[2] * view.sine
    slack = np.maximum(side * (slack - view.deviation), 0.0)
    lever = side * (across[0] * view.cosine + across[1] * view.sine)
    slack[found.indices] = np.inf
    up, down = lever < -_OPPOSITE, lever > _OPPOSITE
    high = float((slack[up] / -lever[up]).min(initial=np.inf))
    low = -float((slack[down] / lever[down]).min(initial=np.inf))
    offset = float(across @ (coefficients[1:] - usual[1:]))
    if reference == "MC":
        move = min(max(-offset, low), high)
    else:
        move = max((low, high), key=lambda t: abs(offset + t))
    moved = coefficients.copy()
    moved[1:] += move * across
    return moved


class _View:
    """Directions and deviations of the points, seen from a centre."""

    def __init__(self, points: CirclePoints, centre: tuple[float, float]) -> None:
        self.centre = centre
        cosine, sine = np.cos(points.angle), np.sin(points.angle)
        a, b = centre
        if points.radius is None or (a == 0.0 and b == 0.0):
            self.cosine, self.sine, self.deviation = cosine, sine, points.deviation
            return
        r = points.radius + points.deviation
        x, y = r * cosine - a, r * sine - b
        rho = np.hypot(x, y)
        self.cosine, self.sine = x / rho, y / rho
        # rho - r = (rho^2 - r^2) / (rho + r): no difference of two large radii.
        shift = (a * a + b * b - 2.0 * r * (a * cosine + b * sine)) / (rho + r)
        self.deviation = points.deviation + shift

    def basis(self, indices: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the rows (1, cos, sin) and the deviations of some points."""
        c, s = self.cosine[indices], self.sine[indices]
        return np.column_stack([np.ones(indices.size), c, s]), self.deviation[indices]

    def extremes(self, coefficients: FloatArray) -> IntArray:
        """Return where the deviation from a limacon is largest and smallest."""
        left = self.deviation - coefficients[0] - coefficients[1] * self.cosine
        left -= coefficients[2] * self.sine
        return chunk_extremes(left)


def _solve(view: _View, points: CirclePoints, reference: str) -> tuple[FloatArray, Optimum | None]:
    """Return (R, a, b) of the limacon, and for extreme references the support."""
    start, left = _least_squares(view, points.weight)
    if reference == "LS":
        return start, None
    scale = float(max(left.max(), -left.min()))
    if scale == 0.0:
        scale = max(float(np.abs(view.deviation).max()), np.finfo(float).tiny * 1e20)
    seed = np.concatenate([view.extremes(start), _around(points.angle)])
    found = optimum(
        view.basis, view.extremes, seed, mode=_MODES[reference], start=start, scale=scale
    )
    return found.coefficients, found


def _least_squares(view: _View, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (R, a, b) and the residual; normal equations, solved twice against rounding."""
    basis = np.column_stack([np.ones(weight.size), view.cosine, view.sine])
    weighted = basis * weight[:, None]
    gram = weighted.T @ basis
    mean = float(view.deviation.mean())
    coefficients = np.array([mean, 0.0, 0.0])
    left = view.deviation - mean
    for _ in range(2):
        change: FloatArray = np.linalg.solve(gram, weighted.T @ left)
        coefficients += change
        left = left - basis @ change
    return coefficients, left


def _around(angle: FloatArray) -> IntArray:
    """Return some points around the whole turn, so that a circle over them is bounded."""
    n = angle.size
    if n <= _ALL_POINTS:
        return np.arange(n)
    chosen = [0]
    while chosen[-1] < n - 1:
        at = chosen[-1]
        reach = int(np.searchsorted(angle, angle[at] + _JUMP, side="right")) - 1
        chosen.append(max(reach, at + 1))
    return np.array(chosen, dtype=np.intp)


def _radius(local: FloatArray, points: CirclePoints, reference: str) -> float:
    """Return the radius of the reference circle, given deviations from its centre."""
    if reference == "MZ":
        return 0.5 * (float(local.max()) + float(local.min()))
    if reference == "MC":
        return float(local.max())
    if reference == "MI":
        return float(local.min())
    return float(np.dot(points.weight, local) / points.weight.sum())


def _objective(view: _View, reference: str) -> float:
    """Return what the centre of an extreme reference makes small."""
    d = view.deviation
    if reference == "MZ":
        return float(d.max()) - float(d.min())
    return float(d.max()) if reference == "MC" else -float(d.min())


def _moved(points: CirclePoints, view: _View, step: FloatArray) -> _View:
    return _View(points, (view.centre[0] + float(step[0]), view.centre[1] + float(step[1])))


def _rest(points: CirclePoints, view: _View, coefficients: FloatArray) -> _View:
    """Return the view from the centre of the least-squares circle (Gauss-Newton)."""
    size = float(np.abs(points.deviation).max())
    for _ in range(_MAX_CENTRES):
        view = _moved(points, view, coefficients[1:])
        coefficients, _ = _solve(view, points, "LS")
        if math.hypot(coefficients[1], coefficients[2]) <= 1e-13 * size:
            return view
    raise NotConvergedError(
        "the centre of the least-squares circle does not come to rest: the deviations are too "
        "large for their radius; check radius= and the unit of z"
    )


def _descend(
    points: CirclePoints,
    view: _View,
    coefficients: FloatArray,
    found: Optimum | None,
    reference: str,
) -> tuple[_View, Optimum | None]:
    """Return the view from the best centre, and the support there."""
    least = _objective(view, reference)
    eps = float(np.finfo(float).eps)
    for _ in range(_MAX_CENTRES):
        size = float(np.abs(view.deviation).max()) + math.hypot(*view.centre)
        better = None
        for trial in _trials(points, view, coefficients[1:], found, reference):
            value = _objective(trial, reference)
            if value < least - 8.0 * eps * size:
                better, least = trial, value
                break
        if better is None:
            return view, found
        view = better
        coefficients, found = _solve(view, points, reference)
    raise NotConvergedError(
        "the centre of the exact circle does not come to rest: the deviations are too large for "
        "their radius; check radius= and the unit of z, or use the limacon (exact=False)"
    )


def _trials(
    points: CirclePoints,
    view: _View,
    step: FloatArray,
    found: Optimum | None,
    reference: str,
) -> Iterator[_View]:
    """Give centres to try: the whole step, between two opposite points, parts of the step."""
    yield _moved(points, view, step)
    if reference == "MC" and found is not None and found.indices.size > 1:
        # Two opposite points leave the centre free along the other direction in the linear
        # program; the true circle has it between them.
        pair = found.indices[np.argsort(found.weights)[-2:]]
        r = (points.radius or 0.0) + points.deviation[pair]
        x, y = r * np.cos(points.angle[pair]), r * np.sin(points.angle[pair])
        yield _View(points, (0.5 * float(x.sum()), 0.5 * float(y.sum())))
    for k in range(1, 12):
        yield _moved(points, view, step * 0.5**k)
