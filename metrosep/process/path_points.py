"""The points of a block program, and how few of them hold a tolerance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, LimitError, UnitError
from metrosep.process.arc_lengths import checked_count, checked_finite, checked_positive
from metrosep.process.interpolation import Interpolation
from metrosep.process.spirals import (
    Distribution,
    Height,
    SpiralPath,
    checked_core,
    checked_options,
)

__all__ = ["CountCurve", "PathPoints", "PointPlan", "errors_by_count", "points_for_tolerance"]


_GROWTH = 1.25
_IN_A_ROW = 3
"""So many counts in a row that hold are not luck."""
_BELOW = (-0.002, -0.005, -0.01, -0.02, -0.04)
_ABOVE = (0.003, 0.01, 0.03)
"""Where the answer is checked for luck, as fractions of it."""
_LOOSEST = 1e-3
"""m: a tolerance above is one in um or nm."""


@dataclass(frozen=True, slots=True, eq=False)
class PathPoints:
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

    @property
    def x(self) -> FloatArray:
        """Position on the part along x, m."""
        return np.asarray(self.rho * np.cos(self.azimuth), dtype=np.float64)

    @property
    def y(self) -> FloatArray:
        """Position on the part along y, m."""
        return np.asarray(self.rho * np.sin(self.azimuth), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PointPlan:
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
        If a number or an option cannot be used, or as of `SpiralPath` and the region.
    UnitError
        If the tolerance is above 1 mm, or as of `SpiralPath`.
    InvalidSamplesError
        If the form has no height at a point.

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
    tolerance = checked_positive(tolerance, "tolerance")
    if tolerance > _LOOSEST:
        raise UnitError(f"a tolerance of {tolerance:.6g} m is none; the tolerance is in m")
    resolution = checked_finite(resolution, "resolution")
    if not 0.0 <= resolution < 0.1:
        raise DataError(f"resolution must lie from 0 to below 0.1, got {resolution}")
    most = checked_count(max_points, "max_points", least=1)
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
    low, high = _bracket(error, tolerance, fewest, most)
    while True:
        best = _bisected(error, tolerance, low, high, resolution)
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
class CountCurve:
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
    form : callable
        ``form(x, y)``, m.
    radius, feed : float, m
        Of the spiral.
    counts : sequence of int
        Intervals, each path ending in the centre (or on the core).
    annulus : tuple of (float or None, float or None), m, optional
        Inner and outer radius of the region that counts; the whole map if omitted.
    sub_points : int, optional
        Samples an interval.
    **options : object
        Of `SpiralPath`, such as ``lead_in=3``.

    Returns
    -------
    tuple of CountCurve
        CA linear, CA spline, CAL linear, CAL spline.

    Raises
    ------
    DataError
        If no count is given or one is no whole number, or as of `SpiralPath` and the region.
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
        whole = sorted(checked_count(n, "a count of points", least=1) for n in counts)
    except TypeError:
        raise DataError(f"counts must be a sequence of whole numbers, got {counts!r}") from None
    if not whole:
        raise DataError("no count of points is given; name at least one")
    numbers = np.array(whole, dtype=np.int64)
    numbers.setflags(write=False)
    curves = []
    for distribution in get_args(Distribution):
        for interpolation in get_args(Interpolation):
            found = [
                SpiralPath.with_points(
                    radius,
                    feed,
                    n,
                    distribution=distribution,
                    interpolation=interpolation,
                    **options,
                )
                .error_map(form, sub_points)
                .peak_to_valley(annulus=annulus)
                for n in numbers.tolist()
            ]
            values = frozen_float(found, name="peak to valley", ndim=1)
            curves.append(CountCurve(distribution, interpolation, numbers, values))
    return tuple(curves)


def _fewest(radius: float, feed: float, distribution: str, core: object) -> int:
    """Return the smallest count that a path may have: eight points on the outer turn."""
    radius, feed = checked_positive(radius, "radius"), checked_positive(feed, "feed")
    if distribution not in get_args(Distribution):
        raise DataError(f"distribution must be CA or CAL, got {distribution!r}")
    turns, share = radius / feed, checked_core(core, radius) / radius
    if distribution == "CA":
        return math.ceil(8.0 * turns * (1.0 - share)) + 8
    return math.ceil(4.0 * turns * (1.0 - share * share)) + 8


def _bracket(
    error: Callable[[int], float], tolerance: float, fewest: int, most: int
) -> tuple[int, int]:
    """Return a count that fails and a larger one that holds, as do the next ones tried."""
    n, failed, held = fewest, 0, 0
    first = 0
    while n <= most or held:
        if error(n) <= tolerance:
            first = first if held else n
            held += 1
            if held == _IN_A_ROW or n >= most:
                return failed or first, first
        else:
            failed, held = n, 0
        n = math.ceil(n * _GROWTH)
    raise LimitError(
        f"no count of points up to {most} holds {tolerance:.6g} m P-V; {failed} points leave "
        f"{error(failed):.6g} m: allow more points or a larger tolerance, leave out the centre "
        "with annulus=(inner radius, None) where CAL is coarse, or use CA"
    )


def _bisected(
    error: Callable[[int], float], tolerance: float, low: int, high: int, resolution: float
) -> int:
    while high - low > max(1.0, resolution * high):
        middle = (low + high) // 2
        low, high = (low, middle) if error(middle) <= tolerance else (middle, high)
    return high


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
    counts.setflags(write=False)
    return PointPlan(
        n_points=n,
        path=path,
        peak_to_valley=found,
        tolerance=tolerance,
        tried=counts,
        tried_peak_to_valley=frozen_float(errors, name="peak to valley", ndim=1),
        is_monotone=not above.size and not ((counts < n) & (errors <= tolerance)).any(),
        messages=tuple(messages),
    )
