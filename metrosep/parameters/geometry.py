"""Form, orientation, location and run-out of features in one frame (ISO 1101), from their points.

Each feature is an array of points, shape (n, 3), m, in one frame: of a coordinate measuring machine, or
of maps that were put together. A result says how the feature and its datum were associated and which
points hold it. Datum of a plane: the minimax plane that touches the material from outside (default of
ISO 5459, recalled), or least squares by name. Definitions recalled from ISO 1101:2017 and ISO 12180-1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, IntArray
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.numbers import choice
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.forms.base import Form, Placement
from metrosep.parameters.interferometric import smallest_circle
from metrosep.parameters.straightness import optimum

_SETTLED = 1e-12
"""Of the radius: a step of the axis below this ends the iteration; of a zone: what may be left of it."""
_SHORTEST, _FALL = 1e-9, 0.1
"""Share of a step that is still tried; of the promised narrowing: what a step must reach."""
_EVEN = 16.0 * float(np.finfo(float).eps)
"""Of the heights: a range below is rounding."""
_NEAR, _ROUNDING = 1e-4, 1e-15
"""Of a zone, and in m: a zone that may be wider by more than this did not settle."""
_ROUND = 0.2
"""Of the radius: distances from the axis that differ by more are not those of a cylinder."""
_LONG = 0.01
"""Of the radius: a shorter cylinder does not show the direction of its axis."""
_STEP = 0.1
"""Of the radius: largest step of the axis in one linear program."""
_NO_AXIS = (
    "the points do not determine the axis of a cylinder along the direction that was given; check "
    "direction and element, or measure more sections"
)
_MOST = 50
_FELT = 1e-4
"""Of the largest: motions that change the distances less leave the form as it is."""


@dataclass(frozen=True, slots=True, eq=False)
class GeometricDeviation:
    """One deviation.

    Parameters
    ----------
    value : float, m
        Width or diameter of the zone.
    symbol, definition : str
        What it is.
    association : str
        How the feature was associated: MZ, LS, or by its datum.
    datum : str
        What it refers to; empty without datum.
    support : ndarray of int
        Points that hold the value, by their number among those that were given.
    edition : str
        Whose definition it is.
    """

    value: float
    symbol: str
    definition: str
    association: str
    datum: str
    support: IntArray
    edition: str = "ISO 1101:2017 (recalled)"

    def to_quantity(self, *, u: float | None = None, u_source: str = "") -> Quantity:
        """Return the value with its definition.

        Parameters
        ----------
        u : float, m, optional
            Standard uncertainty, where it is known.
        u_source : str, optional
            What it rests on.

        Returns
        -------
        Quantity
            In m.
        """
        about = f", datum: {self.datum}" if self.datum else ""
        text = f"{self.definition}, {self.association}{about}; {self.edition}"
        return Quantity(
            self.value, "m", text, u=u, symbol=self.symbol, u_source=u_source if u else ""
        )


@dataclass(frozen=True, slots=True, eq=False)
class DatumPlane:
    """A plane that other features refer to.

    Parameters
    ----------
    normal : ndarray, shape (3,)
        Unit vector out of the material.
    offset : float, m
        Distance from the origin along the normal.
    association : str
        How it was found.
    """

    normal: FloatArray
    offset: float
    association: str

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes dz/dx and dz/dy of the plane."""
        n = self.normal
        return float(-n[0] / n[2]), float(-n[1] / n[2])


@dataclass(frozen=True, slots=True, eq=False)
class DatumAxis:
    """A straight line that other features refer to.

    Parameters
    ----------
    point : ndarray, shape (3,), m
        On the line.
    direction : ndarray, shape (3,)
        Unit vector along it.
    association : str
        How it was found.
    """

    point: FloatArray
    direction: FloatArray
    association: str

    def distances(self, points: ArrayLike) -> FloatArray:
        """Return the distances of points from the axis.

        Parameters
        ----------
        points : array_like, shape (n, 3), m
            In the frame of the axis.

        Returns
        -------
        ndarray, shape (n,), m
            Not negative.
        """
        d = _points(points) - self.point
        return np.asarray(np.linalg.norm(d - np.outer(d @ self.direction, self.direction), axis=1))


def _points(points: ArrayLike, least: int = 1) -> FloatArray:
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] != 3:
        raise InvalidSamplesError(f"points have the shape (n, 3), got {p.shape}")
    p = p[~np.isnan(p).any(axis=1)]
    if not np.isfinite(p).all():
        raise InvalidSamplesError("a coordinate is infinite; leave the point out")
    if p.shape[0] < least:
        raise TooFewSamplesError(f"{least} measured points are needed here, got {p.shape[0]}")
    return p


def _given(points: ArrayLike, held: IntArray) -> IntArray:
    """Return the numbers, among the points as given, of those that `_points` left."""
    measured = ~np.isnan(np.asarray(points, dtype=np.float64)).any(axis=1)
    return np.flatnonzero(measured)[held]


def _unit(v: ArrayLike, name: str) -> FloatArray:
    d = np.asarray(v, dtype=np.float64)
    size = float(np.linalg.norm(d)) if d.shape == (3,) else 0.0
    if not (size > 0.0 and np.isfinite(size)):
        raise DataError(f"{name} is a direction of three numbers, not all zero, got {v!r}")
    return np.asarray(d / size)


def _beside(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors that make a right-handed frame with a direction."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    u = np.cross(helper, direction)
    u /= np.linalg.norm(u)
    return u, np.asarray(np.cross(direction, u))


def _zone(
    matrix: FloatArray, heights: FloatArray, start: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the coefficients of the smallest largest residual, and the points that hold it."""
    rest = heights - matrix @ start
    if float(np.ptp(rest)) <= _EVEN * float(np.abs(heights).max()):  # as even as numbers can be
        return start, np.unique([np.argmax(rest), np.argmin(rest)])
    found = optimum(
        lambda i: (matrix[i], heights[i]),
        lambda c: np.array([np.argmax(heights - matrix @ c), np.argmin(heights - matrix @ c)]),
        np.unique(np.concatenate([np.argsort(rest)[:4], np.argsort(rest)[-4:]])),
        mode="zone",
        start=start,
        scale=max(float(np.ptp(rest)), np.finfo(float).tiny),
    )
    return found.coefficients, np.unique(found.indices)


State = TypeVar("State")


def _narrowed(
    state: State,
    propose: Callable[[State], tuple[FloatArray, float, IntArray]],
    move: Callable[[State, FloatArray], State],
    width: Callable[[State], float],
) -> tuple[State, IntArray]:
    """Return the state of the narrowest zone, and the points that hold it, by linear programs.

    `propose` gives a step, the width that the linear distances promise after it, and its support. A
    whole step may overshoot where two sets of points hold nearly the same zone, so it is halved
    until the zone is narrower. What the program promises is how far the zone is from the narrowest.
    """
    now, gap, held = width(state), np.inf, np.empty(0, dtype=np.intp)
    for _ in range(_MOST):
        step, promised, held = propose(state)
        gap = now - promised
        if gap <= _SETTLED * now:
            return state, held
        share = 1.0
        trial = move(state, step)
        while width(trial) >= now - _FALL * share * gap and share > _SHORTEST:
            share *= 0.5
            trial = move(state, share * step)
        if share <= _SHORTEST:  # nothing narrower within rounding
            break
        state, now = trial, width(trial)
    if not gap <= _NEAR * now + _ROUNDING:
        raise NotConvergedError(
            f"the minimum zone did not settle: {now:.4g} m, perhaps {gap:.2g} m too wide; the points do "
            "not determine where it lies"
        )
    return state, held


def _width(residual: FloatArray) -> float:
    return 2.0 * float(np.abs(residual).max())


# ---- datums ---------------------------------------------------------------------------------------


def datum_plane(
    points: ArrayLike,
    *,
    outward: ArrayLike,
    association: Literal["tangent", "LS"] = "tangent",
) -> DatumPlane:
    """Return the datum plane of a face.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the face; NaN is omitted.
    outward : array_like, shape (3,)
        Roughly the direction out of the material.
    association : {"tangent", "LS"}, optional
        The plane outside the material whose largest distance is smallest, or least squares.

    Returns
    -------
    DatumPlane
        Normal, offset and association.

    Raises
    ------
    DataError
        If an option is unknown or the direction is none.
    InvalidSamplesError
        If the shape is wrong or a coordinate infinite.
    TooFewSamplesError
        If there are fewer than 4 points.

    Examples
    --------
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0.5, 0.5, 1e-6]]
    >>> datum_plane(corners, outward=[0, 0, 1]).offset
    1e-06
    """
    choice(association, "association", ("tangent", "LS"))
    p, out = _points(points, 4), _unit(outward, "outward")
    u, v = _beside(out)
    middle = p.mean(axis=0)
    q = p - middle
    basis = np.stack([np.ones(len(q)), q @ u, q @ v], axis=1)
    heights = q @ out
    c = np.linalg.lstsq(basis, heights, rcond=None)[0]
    if association == "tangent":
        c, _ = _zone(basis, heights, c)
    normal = _unit(out - c[1] * u - c[2] * v, "the normal")
    along = p @ normal
    offset = float(along.max()) if association == "tangent" else float(along.mean())
    return DatumPlane(
        normal, offset, "tangent from outside, minimax" if association == "tangent" else "LS"
    )


def datum_axis(points: ArrayLike, *, direction: ArrayLike) -> DatumAxis:
    """Return the axis of the least-squares cylinder.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the cylinder; NaN is omitted.
    direction : array_like, shape (3,)
        Roughly along the axis.

    Returns
    -------
    DatumAxis
        Point and direction.

    Raises
    ------
    DataError
        If the direction is none.
    InvalidSamplesError
        If the shape is wrong or a coordinate infinite.
    TooFewSamplesError
        If there are fewer than 6 points.
    NotConvergedError
        If the points do not determine an axis.
    """
    return _cylinder(_points(points, 6), _unit(direction, "direction"))[0]


def _cylinder(p: FloatArray, d: FloatArray) -> tuple[DatumAxis, float]:
    """Return axis and radius of the least-squares cylinder, by Gauss-Newton steps of the axis."""
    axis = DatumAxis(_circle_centre(p, d), d, "LS")
    long, radius = float(np.ptp(p @ d)), float(axis.distances(p).mean())
    if not long > _LONG * radius:
        raise NotConvergedError(
            f"the points lie within {format_length(long)} along the axis, at a radius of "
            f"{format_length(radius)}: the axis of a cylinder needs sections at several heights; check the "
            "unit of the heights, or take the roundness of one section"
        )
    for _ in range(_MOST):
        r, J = _radii(p, axis)
        step = np.linalg.lstsq(J, r, rcond=None)[0]
        axis = _moved(axis, np.asarray(step), p)
        if np.linalg.norm(step[:4]) <= _SETTLED * float(r.mean()):
            r = axis.distances(p)
            if float(np.ptp(r)) > _ROUND * float(r.mean()):
                break
            return axis, float(r.mean())
    raise NotConvergedError(_NO_AXIS)


def _circle_centre(p: FloatArray, d: FloatArray) -> FloatArray:
    """Return the point on the axis of the algebraic circle through points seen along d."""
    u, v = _beside(d)
    middle = p.mean(axis=0)
    a, b = (p - middle) @ u, (p - middle) @ v
    basis = np.stack([a, b, np.ones_like(a)], axis=1)
    c = np.linalg.lstsq(basis, a * a + b * b, rcond=None)[0]
    return np.asarray(middle + 0.5 * c[0] * u + 0.5 * c[1] * v)


def _radii(p: FloatArray, axis: DatumAxis) -> tuple[FloatArray, FloatArray]:
    """Return distances from the axis, and how they fall with shifts, tilts (in lengths) and radius."""
    u, v = _beside(axis.direction)
    q = p - axis.point
    along = q @ axis.direction
    a, b = q @ u, q @ v
    r = np.hypot(a, b)
    if not r.min() > 0.0:  # a point on the axis
        raise NotConvergedError(_NO_AXIS)
    reach = max(float(np.abs(along).max()), np.finfo(float).tiny)
    ca, cb, h = a / r, b / r, along / reach
    return r, np.stack([ca, cb, ca * h, cb * h, np.ones_like(r)], axis=1)


def _moved(axis: DatumAxis, step: FloatArray, p: FloatArray) -> DatumAxis:
    u, v = _beside(axis.direction)
    reach = max(float(np.abs((p - axis.point) @ axis.direction).max()), np.finfo(float).tiny)
    point = axis.point + step[0] * u + step[1] * v
    direction = _unit(axis.direction + (step[2] * u + step[3] * v) / reach, "direction")
    return DatumAxis(point, direction, axis.association)


# ---- form -----------------------------------------------------------------------------------------


def cylindricity(
    points: ArrayLike, *, direction: ArrayLike, reference: Literal["MZ", "LS"] = "MZ"
) -> GeometricDeviation:
    """Return the cylindricity CYLt, the range of the distances from the axis.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the cylinder; NaN is omitted.
    direction : array_like, shape (3,)
        Roughly along the axis.
    reference : {"MZ", "LS"}, optional
        Minimum zone of two coaxial cylinders, or the axis of the least-squares one.

    Returns
    -------
    GeometricDeviation
        CYLt and its support.

    Raises
    ------
    DataError
        If an option is unknown or the direction is none.
    TooFewSamplesError
        If there are fewer than 6 points.
    NotConvergedError
        If the points do not determine an axis.

    Notes
    -----
    MZ: linear programs on the linearised distances, from the least-squares axis; a step moves the
    axis by at most a tenth of the radius. The result is a local minimum near that axis.

    References
    ----------
    .. [1] ISO 12180-1:2011 (recalled).
    """
    choice(reference, "reference", ("MZ", "LS"))
    p = _points(points, 6)
    axis, radius = _cylinder(p, _unit(direction, "direction"))
    held: IntArray = np.empty(0, dtype=np.intp)
    if reference == "MZ":

        def propose(at: DatumAxis) -> tuple[FloatArray, float, IntArray]:
            r, J = _radii(p, at)
            step, holding = _zone(J, r, np.array([0.0, 0.0, 0.0, 0.0, 0.5 * (r.max() + r.min())]))
            size = float(np.linalg.norm(step[:4]))
            return (
                step * min(1.0, _STEP * radius / max(size, 1e-300)),
                _width(r - J @ step),
                holding,
            )

        axis, held = _narrowed(
            axis,
            propose,
            lambda at, step: _moved(at, step, p),
            lambda at: float(np.ptp(at.distances(p))),
        )
    r = axis.distances(p)
    if reference == "LS":
        held = np.array([np.argmax(r), np.argmin(r)])
    how = {
        "MZ": "minimum zone (MZ) of coaxial cylinders",
        "LS": "least-squares axis (LS)",
    }
    return GeometricDeviation(
        float(np.ptp(r)), "CYLt", "cylindricity", how[reference], "", _given(points, held),
        "ISO 12180-1:2011 (recalled)",
    )  # fmt: skip


def surface_profile(
    points: ArrayLike,
    form: Form,
    *,
    datum: bool = True,
    what: Literal["line", "surface"] = "surface",
) -> GeometricDeviation:
    """Return the profile deviation t, twice the largest normal distance from the nominal.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        In the frame of the nominal form; of a line all with one y.
    form : Form
        Nominal, all of its parameters given.
    datum : bool, optional
        True: as the points lie in their frame. False: after the minimax fit of six freedoms; of a
        line three, those in its plane.
    what : {"surface", "line"}, optional
        A line has all its points in one plane y = const and does not leave it.

    Returns
    -------
    GeometricDeviation
        t and the points that hold it.

    Raises
    ------
    DataError
        If a parameter of the form is not given, or a point lies outside its domain.
    TooFewSamplesError
        If there is no point, without datum fewer than 7.
    NotConvergedError
        If the minimax fit does not settle.

    References
    ----------
    .. [1] ISO 1101:2017, 17.6 to 17.9 (recalled).
    """
    choice(what, "what", ("line", "surface"))
    p = _points(points, 1 if datum else 7)
    missing = [n for n, v in form.parameters.items() if v is None]
    if missing:
        raise DataError(f"a nominal form has all parameters; {', '.join(missing)} is not given")
    if not datum:
        # A line stays in its plane: beside the vertex of a sphere it would be one of smaller radius.
        may_move = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0]) if what == "line" else np.ones(6)

        def propose(at: FloatArray) -> tuple[FloatArray, float, IntArray]:
            J, d = _rigid_columns(form, at) * may_move, _normal_distances(form, at)
            _, size, directions = np.linalg.svd(J, full_matrices=False)
            felt = directions[size > _FELT * size[0]].T  # a sphere feels no turn
            step, holding = _zone(J @ felt, d, np.zeros(felt.shape[1]))
            return felt @ step, _width(d - J @ felt @ step), holding

        p, _ = _narrowed(
            p, propose, _placed, lambda at: 2.0 * float(np.abs(_normal_distances(form, at)).max())
        )
    d = _normal_distances(form, p)
    largest = float(np.abs(d).max())
    held = _given(points, np.flatnonzero(np.abs(d) >= largest * (1.0 - 1e-9)))
    freedoms = "three freedoms in its plane" if what == "line" else "six freedoms"
    how = "as the datum has it" if datum else f"minimax fit of {freedoms}"
    return GeometricDeviation(
        2.0 * largest,
        "t",
        f"profile of a {what}",
        how,
        "frame of the points" if datum else "",
        held,
    )


def _normal_distances(form: Form, p: FloatArray) -> FloatArray:
    placed = Placement(form, {}, "plane", "normal")
    d = placed.deviation(p[:, 0], p[:, 1], p[:, 2])
    if np.isnan(d).any():
        raise DataError(
            f"{int(np.isnan(d).sum())} of {d.size} points lie outside the domain of the nominal form"
        )
    return d


def _rigid_columns(form: Form, p: FloatArray) -> FloatArray:
    """Return minus the change of the normal distance with three shifts and three turns (lengths)."""
    zx, zy = form.slopes(p[:, 0], p[:, 1])
    n = np.stack([-zx, -zy, np.ones_like(zx)], axis=1)
    n /= np.linalg.norm(n, axis=1)[:, None]
    q = p - p.mean(axis=0)
    return np.asarray(-np.hstack([n, np.cross(q, n) / _size(p)]))


def _size(p: FloatArray) -> float:
    return max(float(np.linalg.norm(p - p.mean(axis=0), axis=1).max()), np.finfo(float).tiny)


def _placed(p: FloatArray, step: FloatArray) -> FloatArray:
    """Return the points after a shift and a turn about their middle; a body is not stretched (Rodrigues)."""
    middle = p.mean(axis=0)
    q, turn = p - middle, step[3:] / _size(p)
    angle = float(np.linalg.norm(turn))
    if angle > 0.0:
        n = turn / angle
        across = np.cross(n, q)
        q = q + np.sin(angle) * across + 2.0 * np.sin(0.5 * angle) ** 2 * np.cross(n, across)
    return np.asarray(middle + q + step[:3])


# ---- orientation, location and run-out ---------------------------------------------------------------


def parallelism(points: ArrayLike, datum: DatumPlane) -> GeometricDeviation:
    """Return the parallelism of a face to a datum plane.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the face; NaN is omitted.
    datum : DatumPlane
        Of another face, in the same frame.

    Returns
    -------
    GeometricDeviation
        Width of the zone parallel to the datum: the range of the points along its normal.

    Raises
    ------
    InvalidSamplesError
        If the shape is wrong or a coordinate infinite.
    TooFewSamplesError
        If there is no point.

    References
    ----------
    .. [1] ISO 1101:2017, 17.10 (recalled).
    """
    along = _points(points) @ datum.normal
    held = _given(points, np.array([np.argmax(along), np.argmin(along)]))
    about = f"plane, {datum.association}"
    return GeometricDeviation(
        float(np.ptp(along)),
        "PAR",
        "parallelism of a plane",
        "zone parallel to the datum",
        about,
        held,
    )


def perpendicularity(
    points: ArrayLike, datum: DatumPlane, *, normal: ArrayLike
) -> GeometricDeviation:
    """Return the perpendicularity of a face to a datum plane.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the face; NaN is omitted.
    datum : DatumPlane
        Of another face, in the same frame.
    normal : array_like, shape (3,)
        Roughly the normal of the face.

    Returns
    -------
    GeometricDeviation
        Width of the narrowest zone at right angles to the datum; it may turn about the datum's
        normal.

    Raises
    ------
    DataError
        If the normal is none, or lies along that of the datum.
    TooFewSamplesError
        If there are fewer than 3 points.

    References
    ----------
    .. [1] ISO 1101:2017, 17.11 (recalled).
    """
    p, out = _points(points, 3), _unit(normal, "normal")
    across = out - (out @ datum.normal) * datum.normal
    if np.linalg.norm(across) < 0.1:
        raise DataError(
            "the face is nearly parallel to its datum; perpendicularity means the other"
        )
    across /= np.linalg.norm(across)
    held: IntArray = np.empty(0, dtype=np.intp)
    for _ in range(
        _MOST
    ):  # the zone is measured along its own normal, so turn until it has no slope
        along = np.cross(datum.normal, across)
        t, h = p @ along - np.mean(p @ along), p @ across - np.mean(p @ across)
        if not np.ptp(t) > 0.0:
            raise DataError(
                "all points lie on one line along the datum's normal: the zone may turn freely"
            )
        c, held = _zone(np.stack([np.ones_like(t), t], axis=1), h, np.zeros(2))
        across = _unit(across - c[1] * along, "the normal")
        if abs(c[1]) <= _SETTLED:
            break
    return GeometricDeviation(
        float(np.ptp(p @ across)), "PER", "perpendicularity of a plane",
        "narrowest zone at right angles to the datum", f"plane, {datum.association}", _given(points, held),
    )  # fmt: skip


def axis_zone(
    centres: ArrayLike, direction: ArrayLike, *, symbol: str = "PAR"
) -> GeometricDeviation:
    """Return the diameter of the smallest cylinder of a given direction around section centres.

    Parameters
    ----------
    centres : array_like, shape (n, 3), m
        Centres of the sections of the axis.
    direction : array_like, shape (3,)
        Of a datum axis for parallelism, of the normal of a datum plane for perpendicularity.
    symbol : str, optional
        For the result.

    Returns
    -------
    GeometricDeviation
        Diameter of the zone.

    Raises
    ------
    DataError
        If the direction is none.
    TooFewSamplesError
        If there are fewer than 2 centres.

    References
    ----------
    .. [1] ISO 1101:2017, 17.10 and 17.11 (recalled).
    """
    p, d = _points(centres, 2), _unit(direction, "direction")
    u, v = _beside(d)
    q = p - p.mean(axis=0)
    flat = np.stack([q @ u, q @ v], axis=1)
    x, y, radius = smallest_circle(flat) if float(np.ptp(flat)) > 0.0 else (0.0, 0.0, 0.0)
    distance = np.hypot(flat[:, 0] - x, flat[:, 1] - y)
    held = _given(centres, np.flatnonzero(distance >= radius * (1.0 - 1e-9)))
    return GeometricDeviation(
        2.0 * radius,
        symbol,
        "orientation of an axis",
        "smallest cylinder along the datum",
        "direction",
        held,
    )


def section_centres(points: ArrayLike, sections: ArrayLike, direction: ArrayLike) -> FloatArray:
    """Return the centres of the least-squares circles of sections, shape (n, 3), m."""
    p, labels, d = _with_labels(points, sections, direction)
    u, v = _beside(d)
    centres = []
    for label in np.unique(labels):
        q = p[labels == label]
        middle = q.mean(axis=0)
        a, b = (q - middle) @ u, (q - middle) @ v
        if q.shape[0] < 3:
            raise TooFewSamplesError(f"section {label} holds {q.shape[0]} points, 3 are needed")
        centre = np.zeros(2)
        for _ in range(_MOST):
            r = np.hypot(a - centre[0], b - centre[1])
            J = np.stack([(a - centre[0]) / r, (b - centre[1]) / r, np.ones_like(r)], axis=1)
            step = np.linalg.lstsq(J, r, rcond=None)[0]
            centre = centre + step[:2]
            if np.abs(step[:2]).max() <= _SETTLED * r.mean():
                break
        centres.append(middle + centre[0] * u + centre[1] * v)
    return np.array(centres)


def _with_labels(
    points: ArrayLike, sections: ArrayLike, direction: ArrayLike
) -> tuple[FloatArray, NDArray[Any], FloatArray]:
    p = np.asarray(points, dtype=np.float64)
    labels = np.asarray(sections)
    if p.ndim != 2 or labels.shape != p.shape[:1]:
        raise InvalidSamplesError(
            f"sections name the section of each point: {p.shape[0]} labels, got {labels.shape}"
        )
    good = ~np.isnan(p).any(axis=1)
    return _points(p), labels[good], _unit(direction, "direction")


def coaxiality(points: ArrayLike, sections: ArrayLike, datum: DatumAxis) -> GeometricDeviation:
    """Return the coaxiality, twice the largest distance of section centres from a datum axis.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the cylinder; NaN is omitted.
    sections : array_like, shape (n,)
        Which section each point belongs to: a number or a text.
    datum : DatumAxis
        In the same frame.

    Returns
    -------
    GeometricDeviation
        Diameter of the zone; its support are sections.

    Raises
    ------
    InvalidSamplesError
        If the shapes differ.
    TooFewSamplesError
        If a section holds fewer than 3 points.

    References
    ----------
    .. [1] ISO 1101:2017, 17.14 (recalled); centres of least-squares circles.
    """
    centres = section_centres(points, sections, datum.direction)
    distance = datum.distances(centres)
    about = f"axis, {datum.association}"
    return GeometricDeviation(
        2.0 * float(distance.max()), "COX", "coaxiality", "centres of least-squares circles", about,
        np.array([int(np.argmax(distance))]),
    )  # fmt: skip


def run_out(
    points: ArrayLike,
    datum: DatumAxis,
    *,
    sections: ArrayLike | None = None,
    measured: Literal["radial", "axial"] = "radial",
) -> GeometricDeviation:
    """Return the run-out about a datum axis: circular with sections, else total.

    Parameters
    ----------
    points : array_like, shape (n, 3), m
        Of the surface; NaN is omitted.
    datum : DatumAxis
        In the same frame.
    sections : array_like, shape (n,), optional
        Which section each point belongs to; without it the range over all is the total run-out.
    measured : {"radial", "axial"}, optional
        Distances from the axis, or positions along it, of a face; its sections are then circles.

    Returns
    -------
    GeometricDeviation
        Range of the distances, of circular run-out that of the worst section.

    Raises
    ------
    DataError
        If `measured` is unknown.
    InvalidSamplesError
        If the shapes differ.
    TooFewSamplesError
        If there is no point.

    References
    ----------
    .. [1] ISO 1101:2017, 17.15 and 17.16 (recalled).
    """
    choice(measured, "measured", ("radial", "axial"))
    about = f"axis, {datum.association}"
    named = np.zeros(len(np.asarray(points))) if sections is None else sections
    p, labels, _ = _with_labels(points, named, datum.direction)
    r = datum.distances(p) if measured == "radial" else p @ datum.direction
    ranges = {label: float(np.ptp(r[labels == label])) for label in np.unique(labels)}
    worst = max(ranges, key=lambda k: ranges[k])
    inside = np.flatnonzero(labels == worst)
    held = _given(points, inside[[np.argmax(r[inside]), np.argmin(r[inside])]])
    if sections is None:
        return GeometricDeviation(
            ranges[worst], "TRO", f"total {measured} run-out", "all points", about, held
        )
    return GeometricDeviation(
        ranges[worst], "CRO", f"circular {measured} run-out", f"worst section {worst}", about, held
    )
