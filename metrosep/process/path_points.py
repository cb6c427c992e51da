"""The points of a block program, and how few of them hold a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import pairwise, product
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, LimitError, TooFewSamplesError, UnitError
from metrosep.core.public import PublicObject, shortened
from metrosep.core.units import format_length
from metrosep.process._plain import Frozen, OnPart, frozen, length
from metrosep.process.interpolation import (
    EndCondition,
    Height,
    Interpolation,
    angle_at_length,
    arc_length,
)
from metrosep.process.path_errors import PathErrorMap, course_of, errors_along

_GROWTH = 1.25
_IN_A_ROW = 3
"""So many counts in a row that hold are not luck."""
_BELOW = (-0.002, -0.005, -0.01, -0.02, -0.04)
_ABOVE = (0.003, 0.01, 0.03)
"""Where the answer is checked for luck, as fractions of it."""
_JOINED: tuple[Interpolation, ...] = ("linear", "spline")
_LOOSEST = 1e-3
"""m: a tolerance above is one in um or nm."""
_FAR = 1.5
"""Times the most points: where that many would be needed the search is given up early."""


@dataclass(frozen=True, slots=True, eq=False)
class PathPoints(Frozen, OnPart):
    """Points of a block program, in the order of cutting; read-only arrays of equal length.

    Parameters
    ----------
    rho : ndarray, shape (n,), m
        Radius.
    theta : ndarray, shape (n,), rad
        Angle travelled since the rim, negative before it.
    azimuth : ndarray, shape (n,), rad
        Polar angle on the part, not wrapped.
    s : ndarray, shape (n,), m
        Arc length travelled since the rim, negative before it.
    z : ndarray, shape (n,), m
        Height of the form at the point, out of the material: a cut point. The tip of a nose stands
        elsewhere, see `tip_path`.
    lead_in : int
        How many points lie before the rim.
    """

    rho: FloatArray
    theta: FloatArray
    azimuth: FloatArray
    s: FloatArray
    z: FloatArray
    lead_in: int

    def __len__(self) -> int:
        return int(self.z.size)


@dataclass(frozen=True, slots=True, eq=False)
class PointPlan(Frozen):
    """The smallest count of points found that holds a tolerance.

    Parameters
    ----------
    n_points : int
        Intervals (blocks) on the part.
    path : SpiralPath
        The path with that count.
    peak_to_valley : float, m
        Of its error in the region.
    tolerance : float, m
        What was to be held.
    tried : ndarray, shape (n,)
        All counts tried, growing.
    tried_peak_to_valley : ndarray, shape (n,), m
        P-V of each.
    is_monotone : bool
        Whether no count tried above `n_points` fails, and none below holds.
    messages : tuple of str
        What to know, in plain words.
    """

    n_points: int
    path: SpiralPath
    peak_to_valley: float
    tolerance: float
    tried: NDArray[np.int64]
    tried_peak_to_valley: FloatArray
    is_monotone: bool
    messages: tuple[str, ...]

    def __int__(self) -> int:
        return self.n_points

    @property
    def audit(self) -> Mapping[str, Any]:
        """What the count rests on, plain values with units in the keys."""
        return {
            "n_points": self.n_points,
            "pv_nm": self.peak_to_valley * 1e9,
            "tolerance_nm": self.tolerance * 1e9,
            "n_tried": int(self.tried.size),
            "is_monotone": self.is_monotone,
            "distribution": self.path.distribution,
            "interpolation": self.path.interpolation,
            "lead_in": self.path.lead_in,
        }


def points_for_tolerance(
    form: Height,
    radius: float,
    feed: float,
    tolerance: float,
    *,
    distribution: Distribution = "CA",
    interpolation: Interpolation = "spline",
    annulus: tuple[float | None, float | None] | None = None,
    azimuth: float | None = None,
    sub_points: int = 10,
    max_points: int = 1_000_000,
    resolution: float = 1e-3,
    **options: Any,
) -> PointPlan:
    """Return the smallest count of points whose path error stays within a tolerance.

    Parameters
    ----------
    form : callable
        ``form(x, y)``, m.
    radius, feed : float, m
        Of the spiral.
    tolerance : float, m
        Largest P-V of path minus ideal, > 0.
    distribution : {"CA", "CAL"}, optional
        Constant angle or constant arc length.
    interpolation : {"linear", "spline"}, optional
        What the controller does.
    annulus : tuple of (float or None, float or None), m, optional
        Inner and outer radius of the region that counts; the whole map if omitted.
    azimuth : float, rad, optional
        Only a line counts; see the warning of `PathErrorMap.peak_to_valley`.
    sub_points : int, optional
        Samples an interval.
    max_points : int, optional
        Where the search ends.
    resolution : float, optional
        The count is found to this fraction; 0 to the last point.
    **options : object
        Of `SpiralPath`, such as ``lead_in=3``.

    Returns
    -------
    PointPlan
        Count, path, P-V and all that was tried.

    Raises
    ------
    LimitError
        If no count up to `max_points` holds the tolerance, or eight points a turn are more, or a
        path is too large to work on.
    DataError
        If a number or an option cannot be used, the form has no height at a point, or as of
        `SpiralPath` and the region.

    Notes
    -----
    P-V need not fall with every point more. The search grows the count by a quarter until three in
    a row hold, bisects, and then tries counts a little below and above; a smaller count that holds
    is taken, a larger one that fails is reported (`is_monotone`). Every path tried ends in the
    centre (or on the core). The answer is exact for the counts tried, not a proof for all others.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> plan = points_for_tolerance(grid, 200e-6, 4e-6, 5e-9, lead_in=3)
    >>> plan.peak_to_valley <= 5e-9
    True
    """
    tolerance = length(tolerance, "tolerance", _LOOSEST)
    radius, feed = length(radius, "radius"), length(feed, "feed")
    resolution = numbers.between(resolution, "resolution", 0.0, 0.1)
    most = numbers.count(max_points, "max_points")
    checked_options(options, taken={"step": "step follows from the count; leave it out"})
    fewest = _fewest(radius, feed, distribution, options.get("core", 0.0))
    if most < fewest:
        raise LimitError(
            f"max_points of {most} is below the {fewest} blocks that eight points a turn need: "
            "allow more, or check radius and feed"
        )
    common = {"distribution": distribution, "interpolation": interpolation, **options}

    def path_of(n: int) -> SpiralPath:
        return SpiralPath.with_points(radius, feed, n, **common)

    @cache
    def error(n: int) -> float:
        tried[n] = made = (
            path_of(n).error_map(form, sub_points).peak_to_valley(annulus=annulus, azimuth=azimuth)
        )
        return made

    tried: dict[int, float] = {}
    order = 2.0 if interpolation == "linear" else 4.0
    low, high = _bracket(error, tolerance, fewest, most, order)
    while True:
        while high - low > max(1.0, resolution * high):
            middle = (low + high) // 2
            low, high = (low, middle) if error(middle) <= tolerance else (middle, high)
        best = high
        below = _beside(best, _BELOW, low=fewest)
        lucky = [n for n in below if error(n) <= tolerance]
        if not lucky:
            break
        high = min(lucky)
        low = max((n for n, e in tried.items() if n < high and e > tolerance), default=high)
    for n in _beside(best, _ABOVE, low=1):
        error(n)
    counts = np.array(sorted(tried), dtype=np.int64)
    return _plan(path_of(best), tolerance, counts, np.array([tried[n] for n in counts.tolist()]))


@dataclass(frozen=True, slots=True, eq=False)
class CountCurve(Frozen):
    """P-V of the path error against the count of points, for one way to set and join them.

    Parameters
    ----------
    distribution : {"CA", "CAL"}
        Constant angle or constant arc length.
    interpolation : {"linear", "spline"}
        What the controller does.
    n_points : ndarray, shape (n,)
        Intervals; read-only.
    peak_to_valley : ndarray, shape (n,), m
        P-V of each; read-only.
    """

    distribution: Distribution
    interpolation: Interpolation
    n_points: NDArray[np.int64]
    peak_to_valley: FloatArray


@described_by(points_for_tolerance, errors=False)
def errors_by_count(
    form: Height,
    radius: float,
    feed: float,
    counts: Sequence[int],
    *,
    annulus: tuple[float | None, float | None] | None = None,
    sub_points: int = 10,
    **options: Any,
) -> tuple[CountCurve, ...]:
    """Return the P-V of the path error at some counts, for CA and CAL, lines and spline.

    Parameters
    ----------
    counts : sequence of int
        Intervals, each path ending in the centre (or on the core).

    Returns
    -------
    tuple of CountCurve
        CA linear, CA spline, CAL linear, CAL spline.

    Raises
    ------
    DataError
        If no count is given or one is not a whole number, or as of `SpiralPath` and the region.
    InvalidSamplesError
        If the form has no height at a point.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, Fig. 11.

    Examples
    --------
    >>> curves = errors_by_count(lambda x, y: 1e-3 * x, 1e-3, 1e-4, [400, 800])
    >>> [(c.distribution, c.interpolation) for c in curves][:2]
    [('CA', 'linear'), ('CA', 'spline')]
    """
    try:
        given = list(counts)
    except TypeError:
        raise DataError(f"counts must be a sequence of whole numbers, got {counts!r}") from None
    if not given:
        raise DataError("no count of points is given; name at least one")
    whole = np.array(sorted(numbers.count(n, "a count of points") for n in given), dtype=np.int64)
    curves = []
    for distribution, interpolation in product(get_args(Distribution), _JOINED):
        words = {"distribution": distribution, "interpolation": interpolation}
        paths = (
            SpiralPath.with_points(radius, feed, n, **words, **options) for n in whole.tolist()
        )
        found = [p.error_map(form, sub_points).peak_to_valley(annulus=annulus) for p in paths]
        curves.append(CountCurve(distribution, interpolation, whole, np.array(found)))
    return tuple(curves)


def _fewest(radius: float, feed: float, distribution: str, core: object) -> int:
    """Return the smallest count that a path may have: eight points on the outer turn."""
    numbers.choice(distribution, "distribution", get_args(Distribution))
    turns, share = radius / feed, checked_core(core, radius) / radius
    if distribution == "CA":
        return math.ceil(8.0 * turns * (1.0 - share)) + 8
    return math.ceil(4.0 * turns * (1.0 - share * share)) + 8


def _bracket(
    error: Callable[[int], float], tolerance: float, fewest: int, most: int, order: float
) -> tuple[int, int]:
    """Return a count that fails and a larger one that holds, as do the next ones tried."""
    n, failed, held = fewest, 0, 0
    first = 0
    last = [0.0] * _IN_A_ROW
    while n <= most or held:
        if error(n) <= tolerance:
            first = first if held else n
            held += 1
            if held == _IN_A_ROW or n >= most:
                return failed or first, first
        else:
            failed, held = n, 0
            last = [*last[1:], error(n)]
            # a resolved path: errors fall with their order at most, and no count in reach will do
            least, most_of = (_GROWTH ** (k * order) for k in (0.5, 1.5))
            falls = all(0.0 < b * least <= a <= b * most_of for a, b in pairwise(last))
            needed = n * (last[-1] / tolerance) ** (1.0 / order)
            if falls and needed > _FAR * most:
                raise LimitError(
                    f"{tolerance:.6g} m P-V would take about {needed:.2g} points, and at most {most} are "
                    f"allowed: {n} points leave {last[-1]:.6g} m; take a larger tolerance"
                    + (", or interpolation = spline" if order < 4.0 else "")
                )
        n = math.ceil(n * _GROWTH)
    raise LimitError(
        f"no count of points up to {most} holds {tolerance:.6g} m P-V; {failed} points leave "
        f"{error(failed):.6g} m: allow more points or a larger tolerance, leave out the centre "
        "with annulus=(inner radius, None) where CAL is coarse, or use CA"
    )


def _beside(n: int, fractions: tuple[float, ...], *, low: int) -> list[int]:
    return sorted({m for f in fractions if (m := round(n * (1.0 + f))) >= low and m != n})


def _plan(
    path: SpiralPath, tolerance: float, counts: NDArray[np.int64], errors: FloatArray
) -> PointPlan:
    n = path.n_points
    found = float(errors[counts == n][0])
    above = counts[(counts > n) & (errors > tolerance)]
    messages = list(path.messages)
    if above.size:
        messages.append(
            f"More points are not always better here: {n} hold the tolerance, {int(above[0])} do "
            "not. Check the error of the count that is programmed."
        )
    return PointPlan(
        n_points=n,
        path=path,
        peak_to_valley=found,
        tolerance=tolerance,
        tried=counts,
        tried_peak_to_valley=errors,
        is_monotone=not above.size and not ((counts < n) & (errors <= tolerance)).any(),
        messages=tuple(messages),
    )


# ---- the spiral of a turned freeform: where its points lie, and the error of the path through them ----
# The tool starts at the rim and ends at the centre. ``u`` is the angle left to the centre,
# ``rho = feed u / (2 pi)`` the radius, ``theta`` the angle travelled since the rim and S the arc
# length from the centre. ``azimuth`` is the polar angle of a point on the part, ``x = rho
# cos(azimuth)``, ``y = rho sin(azimuth)``, counter-clockwise seen from above (from +z, out of the
# material): ``azimuth = start + theta`` with the sense "counterclockwise", ``start - theta`` with
# "clockwise". Errors are path minus ideal: positive where material is left.

Distribution = Literal["CA", "CAL"]
Sense = Literal["counterclockwise", "clockwise"]
Knots = Literal["interpolate", "least-squares"]

_TURN = 2.0 * math.pi
_WHOLE = 1e-9
"""A count this close to a whole number, relative, is that number: 2 degrees divide a turn."""
_WIDEST_STEP = _TURN / 8.0
"""Fewer than eight points a turn follow nothing; an angle above is one in degrees."""
_LARGEST = 5.0
"""m: no part is turned that large; a radius above is one in mm or um."""
_MOST_SAMPLES = 50_000_000
"""Of a map: 0.4 GB, and 0.8 GB more for where they lie."""
_MOST_POINTS = 10_000_000
"""Of a program that is worked on at once: about 1 GB."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SpiralPath(PublicObject):
    """Points of a block program on a spiral from the rim to the centre, and what joins them.

    Parameters
    ----------
    radius : float, m
        Of the workpiece, where the spiral starts.
    feed : float, m
        Advance per revolution, > 0 and at most `radius`.
    distribution : {"CA", "CAL"}, optional
        Points at a constant angle or at a constant arc length.
    step : float, rad or m
        Angle between points for "CA", at most 2 pi / 8; arc length for "CAL".
    interpolation : {"linear", "spline", "pvt"}, optional
        What the controller does between points; the spline is C2 and cubic. PVT is the cubic Hermite
        polynomial through heights and true slopes, of a form that has a gradient.
    lead_in : int, optional
        Points on the extrapolated spiral before the rim. They take the free end of the spline off
        the part; three and more are enough. The form must be defined there.
    end : {"not-a-knot", "natural", "clamped"}, optional
        End condition of the spline at its first and last point, lead-in included. "clamped" takes
        the slope of the form, which must have a gradient.
    knots : {"interpolate", "least-squares"}, optional
        Heights of the points: on the form, or such that the interpolation is nearest to it. The
        second with the spline implies not-a-knot ends.
    core : float, m, optional
        Radius at which the path ends, 0 <= core < radius.
    sense : {"counterclockwise", "clockwise"}, optional
        How the point of the tool goes round the part, seen from above (from +z).
    start : float, rad, optional
        Azimuth on the part of the first point at the rim.

    Attributes
    ----------
    n_points : int
        Intervals (blocks) on the part: ``floor`` of what there is to go over `step`. There is one
        point more, and the lead-in is not counted.

    Raises
    ------
    DataError
        If a length is not positive and finite, the feed is above the radius, a word is not known, or
        the end condition and the knots contradict each other; also if the step is too wide to be in
        rad or m, the radius above 5 m or the start beyond a turn (UnitError), and if no interval fits
        or there are fewer points than the spline needs (TooFewSamplesError).

    Notes
    -----
    Points are worked out when they are asked for, up to 10 million (LimitError above); what needs
    none, such as `core_radius` and `messages`, is in closed form.

    CA: ``u_i = U - i step``; CAL: ``S_i = L - i step``, Eqs. (3)-(6) of [1]_. Where the step does
    not divide the path, a core around the centre stays uncut: `core_radius`, and `messages` says
    so. `with_points` chooses the step that divides. The published reference numbers hold for
    ``lead_in=0``, the default here; for cutting use 3.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning, section
       "Program-related error factors".

    Examples
    --------
    >>> path = SpiralPath(500e-6, 2e-6, distribution="CAL", step=30e-6)
    >>> path.n_points, round(path.turns, 9), round(path.length, 9)
    (13090, 250.0, 0.392700443)
    """

    radius: float
    feed: float
    distribution: Distribution = "CA"
    step: float = math.nan
    interpolation: Interpolation = "spline"
    lead_in: int = 0
    end: EndCondition = "not-a-knot"
    knots: Knots = "interpolate"
    core: float = 0.0
    sense: Sense = "counterclockwise"
    start: float = 0.0
    n_points: int = field(init=False)

    def __post_init__(self) -> None:
        self._check_choices()
        object.__setattr__(self, "radius", checked_radius(self.radius))
        object.__setattr__(self, "feed", length(self.feed, "feed"))
        if self.feed > self.radius:
            raise DataError(
                f"the feed of {self.feed:.6g} m per revolution is above the radius of "
                f"{self.radius:.6g} m: there is not one turn; check the units, both are in m"
            )
        object.__setattr__(self, "core", checked_core(self.core, self.radius))
        object.__setattr__(self, "start", numbers.quantity(self.start, "start", "angle"))
        if abs(self.start) > _TURN:
            raise UnitError(
                f"a start of {self.start:.6g} is beyond a turn; the start is in rad, "
                f"{self.start:.6g} degrees are {math.radians(self.start):.6g} rad"
            )
        object.__setattr__(self, "lead_in", numbers.count(self.lead_in, "lead_in", least=0))
        object.__setattr__(self, "step", _checked_step(self))
        count = (self._total - self._uncut) / self.step
        n = (
            round(count)
            if abs(count - round(count)) <= _WHOLE * max(count, 1.0)
            else math.floor(count)
        )
        fewest = 3 if self.interpolation == "spline" else 1
        if n < 1 or n + self.lead_in < fewest:
            raise TooFewSamplesError(
                f"a step of {self.step:.6g} {self._step_unit} gives {n} interval(s) on the path; "
                f"the {self.interpolation} interpolation needs {fewest}: make the step smaller"
            )
        object.__setattr__(self, "n_points", n)

    def _check_choices(self) -> None:
        kinds: dict[str, Any] = {"distribution": Distribution, "interpolation": Interpolation}
        kinds |= {"end": EndCondition, "knots": Knots, "sense": Sense}
        for name, kind in kinds.items():
            numbers.choice(getattr(self, name), name, get_args(kind))
        if self.knots == "least-squares" and self.interpolation == "pvt":
            raise DataError("PVT passes through its points: knots must be interpolate")
        if self.knots == "least-squares" and self.end != "not-a-knot":
            raise DataError(
                f"least-squares knots have not-a-knot ends, got end={self.end!r}; leave end out"
            )

    def __repr__(self) -> str:
        return shortened(
            f"SpiralPath(radius {format_length(self.radius)}, feed {format_length(self.feed)}, "
            f"{self.n_points} points, {self.distribution}, {self.interpolation}, {self.sense})"
        )

    @classmethod
    def with_points(
        cls,
        radius: float,
        feed: float,
        n_points: int,
        *,
        distribution: Distribution = "CA",
        **options: Any,
    ) -> SpiralPath:
        """Return the path of so many intervals whose step divides it.

        Parameters
        ----------
        radius, feed : float, m
            As of the class.
        n_points : int
            Intervals, >= 1.
        distribution : {"CA", "CAL"}, optional
            Constant angle or constant arc length.
        **options : object
            As of the class, without `step`.

        Returns
        -------
        SpiralPath
            Its last point is the centre, or lies on the core.

        Raises
        ------
        DataError
            If `n_points` is not a whole number of 1 or more, an option is not known, or as of the class.
        """
        checked_options(options, taken={"step": "step follows from n_points; leave it out"})
        count = numbers.count(n_points, "n_points")
        feed, radius = length(feed, "feed"), length(radius, "radius")
        core = checked_core(options.get("core", 0.0), radius)
        ends = [_TURN * r / feed for r in (radius, core)]
        if distribution == "CAL":
            ends = [float(arc_length(u, feed)) for u in ends]
        step = (ends[0] - ends[1]) / count
        return cls(radius, feed, distribution=distribution, step=step, **options)

    @property
    def turns(self) -> float:
        """Revolutions from the rim to the centre, Eq. (6)."""
        return self.radius / self.feed

    @property
    def length(self) -> float:
        """Arc length of the whole spiral from the rim to the centre, m."""
        return float(arc_length(_TURN * self.turns, self.feed))

    @property
    def u(self) -> FloatArray:
        """Angle left to the centre of each point, rad, shape (n_points + 1,), from the rim."""
        return frozen(self.stations()[0][self.lead_in :])

    @property
    def rho(self) -> FloatArray:
        """Radius of each point, m, shape (n_points + 1,), from the rim."""
        return frozen(self.u * (self.feed / _TURN))

    @property
    def theta(self) -> FloatArray:
        """Angle travelled since the rim, rad, growing; the azimuth is `azimuth_of` it."""
        return frozen(_TURN * self.turns - self.u)

    @property
    def azimuth(self) -> FloatArray:
        """Polar angle on the part of each point, rad, not wrapped."""
        return frozen(self.azimuth_of(self.theta))

    @property
    def core_radius(self) -> float:
        """Radius of the last point, m: within it nothing is cut."""
        return self.last_angle * self.feed / _TURN

    @property
    def last_angle(self) -> float:
        """Angle left to the centre at the last point, rad; 0 where the path ends there."""
        left = self._total - self.n_points * self.step
        if left < 2.0 * _WHOLE * self._total:
            return 0.0
        return left if self.distribution == "CA" else float(angle_at_length(left, self.feed))

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know about the path, in plain words."""
        found = []
        if self.core_radius > 0.0:
            found.append(
                f"The path ends {self.core_radius:.3g} m from the centre; within that radius "
                "nothing is cut."
            )
        if self.interpolation == "spline":
            found.append(f"Spline with {self.end} ends and {self.lead_in} lead-in point(s).")
            if self.lead_in < 3:
                found.append(
                    "The free end of the spline lies on the part: lead_in=3 takes it before the "
                    "rim, where the form must be defined."
                )
        return tuple(found)

    def azimuth_of(self, theta: ArrayLike) -> FloatArray:
        """Return the polar angle on the part after an angle travelled.

        Parameters
        ----------
        theta : array_like, rad
            Since the rim.

        Returns
        -------
        ndarray, rad
            Counter-clockwise from +x, seen from +z; not wrapped.
        """
        return self.start + self.way * np.asarray(theta, dtype=np.float64)

    @property
    def way(self) -> float:
        """Sign of the azimuth as the tool travels: 1 counter-clockwise, -1 clockwise."""
        return 1.0 if self.sense == "counterclockwise" else -1.0

    def travelled_to(self, azimuth: ArrayLike) -> FloatArray:
        """Return the angle travelled to a polar angle on the part, the inverse of `azimuth_of`.

        Parameters
        ----------
        azimuth : array_like, rad
            Counter-clockwise from +x, seen from +z.

        Returns
        -------
        ndarray, rad
            Since the rim, but for whole turns.
        """
        return self.way * (np.asarray(azimuth, dtype=np.float64) - self.start)

    def with_options(self, **options: Any) -> SpiralPath:
        """Return the path with other values of some of its parameters.

        Parameters
        ----------
        **options : object
            Parameters of the class by name.

        Returns
        -------
        SpiralPath
            Another one.

        Raises
        ------
        DataError
            If an option is not known, or as of the class.
        """
        checked_options(options, taken={"n_points": "n_points follows from the step"})
        return replace(self, **options)

    def points(self, form: Height) -> PathPoints:
        """Return the points of the block program on a form.

        Parameters
        ----------
        form : callable
            ``form(x, y)``, m, such as a form of `metrosep.forms`.

        Returns
        -------
        PathPoints
            From the first lead-in point to the last one.

        Raises
        ------
        InvalidSamplesError
            If the form has no height at a point.
        DataError
            If the form cannot be called, or the ends are clamped and it has no gradient.
        LimitError
            If there are more than 10 million points.
        """
        course = course_of(self, form)
        u, _ = self.stations()
        theta = _TURN * self.turns - u
        rho, azimuth = u * (self.feed / _TURN), self.azimuth_of(theta)
        return PathPoints(rho, theta, azimuth, course.s, course.z, self.lead_in)

    @described_by(points)
    def error_map(self, form: Height, sub_points: int = 10) -> PathErrorMap:
        """Return the error of the interpolated path, path minus ideal, along the whole spiral.

        Parameters
        ----------
        sub_points : int, optional
            Parts of equal arc length into which each interval is divided, >= 2. An even number
            holds the middle, where the error of a line is largest.

        Returns
        -------
        PathErrorMap
            ``n_points * sub_points + 1`` samples from the rim to the last point.

        Raises
        ------
        DataError
            As of `points`, or `sub_points` is below 2.
        LimitError
            As of `points`, or there are more than 50 million samples.
        """
        parts = numbers.count(sub_points, "sub_points", least=2)
        if self.n_points * parts >= _MOST_SAMPLES:
            raise LimitError(
                f"{self.n_points:,} blocks with {parts} samples each are "
                f"{self.n_points * parts + 1:,} samples; a map holds at most {_MOST_SAMPLES:,}: "
                "make the step larger (check its unit), or sub_points smaller"
            )
        course = course_of(self, form)
        return PathErrorMap(
            frozen(errors_along(self, form, parts, course)), self, form, parts, course
        )

    @property
    def _total(self) -> float:
        """Angle or length to go, in the unit of the step."""
        return _TURN * self.turns if self.distribution == "CA" else self.length

    @property
    def _uncut(self) -> float:
        u = _TURN * self.core / self.feed
        return u if self.distribution == "CA" else float(arc_length(u, self.feed))

    @property
    def _step_unit(self) -> str:
        return "rad" if self.distribution == "CA" else "m"

    def stations(self) -> tuple[FloatArray, FloatArray]:
        """Return the angle left and the arc length from the centre of all points, lead-in first.

        Returns
        -------
        tuple of ndarray, shape (lead_in + n_points + 1,), rad and m
            u and S.

        Raises
        ------
        LimitError
            If there are more than 10 million points.
        """
        left = self._left()
        if self.distribution == "CA":
            return left, arc_length(left, self.feed)
        return angle_at_length(left, self.feed), left

    def angles(self) -> FloatArray:
        """Return the angle left to the centre of all points, lead-in first.

        Returns
        -------
        ndarray, shape (lead_in + n_points + 1,), rad
            As the first of `stations`, without the memory of the other.

        Raises
        ------
        LimitError
            If there are more than 10 million points.
        """
        left = self._left()
        return left if self.distribution == "CA" else angle_at_length(left, self.feed)

    def _left(self) -> FloatArray:
        """Return the angle or length left of all points, in the unit of the step."""
        count = self.n_points + self.lead_in + 1
        if count > _MOST_POINTS:
            raise LimitError(
                f"the path has {count - 1:,} blocks of {self.step:.6g} {self._step_unit}; at most "
                f"{_MOST_POINTS:,} are worked on at once: make the step larger (check its unit), "
                "or take a smaller radius or a core"
            )
        number = np.arange(-self.lead_in, self.n_points + 1, dtype=np.float64)
        left = self._total - number * self.step
        if left[-1] < 2.0 * _WHOLE * self._total:
            left[-1] = 0.0
        return left


def checked_radius(radius: object) -> float:
    """Return the radius of a workpiece, m."""
    return length(radius, "radius", _LARGEST)


def checked_core(core: object, radius: float) -> float:
    """Return the radius at which a path ends, or raise DataError."""
    number = numbers.quantity(core, "core", "length")
    if not 0.0 <= number < radius:
        raise DataError(
            f"core must lie from 0 to below the radius {radius:.6g} m, got {number:.6g} m"
        )
    return number


def checked_options(options: Mapping[str, Any], *, taken: Mapping[str, str]) -> None:
    """Raise DataError for an option that no path has, or that is given elsewhere."""
    known = [f.name for f in fields(SpiralPath) if f.init]
    for name in options:
        if name in taken:
            raise DataError(taken[name])
        if name not in known:
            raise DataError(f"a path has no option {name!r}; it has {', '.join(known)}")


def _checked_step(path: SpiralPath) -> float:
    if path.step != path.step:  # NaN, the default
        raise DataError("step is missing: an angle in rad for CA, an arc length in m for CAL")
    dimension = "angle" if path.distribution == "CA" else "length"
    step = numbers.positive(path.step, "step", dimension=dimension)
    if path.distribution == "CA" and step > _WIDEST_STEP * (1.0 + _WHOLE):
        raise UnitError(
            f"a step of {step:.6g} rad leaves fewer than 8 points a turn; the step is in rad, "
            f"{step:.6g} degrees are {math.radians(step):.6g} rad"
        )
    if path.distribution == "CAL" and step > _TURN * path.radius / 8.0:
        raise UnitError(
            f"a step of {step:.6g} m leaves fewer than 8 points on the outer turn; the step is in m"
        )
    return step
