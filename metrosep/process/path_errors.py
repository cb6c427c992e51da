"""Error of an interpolated tool path on the whole surface: path minus ideal.

The dense samples divide every interval of the block program into equal arc lengths, Eqs. (7)-(11)
of "Deterministic error compensation for slow tool servo-driven diamond turning" with the opposite
sign: positive where material is left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.process._plain import frozen, length
from metrosep.process.interpolation import (
    Height,
    Interpolation,
    arc_length,
    dense_rows,
    evaluate,
    fitted_heights,
    knot_slopes,
    newton_angle,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from metrosep.process.path_points import SpiralPath

_TURN = 2.0 * math.pi
_MOST_PIXELS = 5000
"""Along a side of a surface: about 2 GB while it is made."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PathErrorMap:
    """Error of a path along its whole spiral: dense samples, path minus ideal.

    Parameters
    ----------
    z : ndarray, shape (n,), m
        Height of the path minus that of the form: positive where material is left; read-only.
    path : SpiralPath
        Points and interpolation.
    form : callable
        ``form(x, y)``, m.
    sub_points : int
        Samples for each interval.
    course : object
        Knots of the interpolation.

    Notes
    -----
    Half of the distance between samples is what the P-V may miss: with 10 samples in an interval
    1 % of the error of a line at most, and nothing in its middle. Samples are dense where points
    are, with CA towards the centre: `area` weighs them, and the RMS is one over the part.
    """

    z: FloatArray
    path: SpiralPath
    form: Height
    sub_points: int
    course: Course
    _positions: dict[str, FloatArray] = field(default_factory=dict, init=False, repr=False)

    def __len__(self) -> int:
        return int(self.z.size)

    def __repr__(self) -> str:
        return (
            f"PathErrorMap({self.z.size} samples, {self.path.distribution}, "
            f"{self.path.n_points} intervals, {self.path.interpolation}, "
            f"P-V {format_length(float(np.ptp(self.z)))})"
        )

    @property
    def rho(self) -> FloatArray:
        """Radius of each sample, m, shape (n,), falling from the rim; read-only."""
        return self._position("rho")

    @property
    def theta(self) -> FloatArray:
        """Azimuth on the part, rad, shape (n,), not wrapped: ``x = rho cos(theta)``."""
        return self._position("theta")

    @property
    def area(self) -> FloatArray:
        """Area that each sample stands for, relative, shape (n,): rho for CA, 1 for CAL."""
        return self.rho if self.path.distribution == "CA" else frozen(np.ones(self.z.size))

    @property
    def core_radius(self) -> float:
        """Radius within which nothing is cut, m."""
        return self.path.core_radius

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know about the numbers, in plain words."""
        return self.path.messages

    def peak_to_valley(
        self,
        *,
        annulus: tuple[float | None, float | None] | None = None,
        azimuth: float | None = None,
    ) -> float:
        """Return the largest minus the smallest error in a region, nothing removed.

        Parameters
        ----------
        annulus : tuple of (float or None, float or None), m, optional
            Inner and outer radius; None as far as the path goes.
        azimuth : float, rad, optional
            Only the half line from the centre in this direction, where the turns cross it.

        Returns
        -------
        float
            P-V, m.

        Raises
        ------
        DataError
            If the annulus is not a pair, empty, lies outside of the path or within its uncut core, or holds
            fewer than two samples.

        Notes
        -----
        A line is blind: with CA and a whole number of points a turn, the turns cross the line
        through the start in the points themselves, where the error is zero. Take the whole map,
        or a line half a step beside.
        """
        low, high = self._limits(annulus)
        if azimuth is not None:
            line = self.line(azimuth)
            inside = line.z[(line.x >= low) & (line.x <= high)]
        else:
            inside = self.z
            if annulus is not None:
                inside = self.z[(self.rho >= low) & (self.rho <= high)]
        if inside.size < 2:
            raise DataError(
                f"{inside.size} sample(s) lie from {low:.6g} to {high:.6g} m"
                f"{'' if azimuth is None else f' at the azimuth {azimuth:.6g} rad'}, too few for a "
                f"P-V; the turns are {self.path.feed:.6g} m apart: make the region wider"
            )
        return float(np.ptp(inside))

    def line(self, azimuth: float) -> Profile:
        """Return the error where the turns cross a half line from the centre.

        Parameters
        ----------
        azimuth : float, rad
            Direction of the line on the part.

        Returns
        -------
        Profile
            Radius and error, one sample a turn, from the centre out.

        Raises
        ------
        DataError
            If the azimuth is not finite, or the line crosses no turn.
        """
        azimuth = numbers.quantity(azimuth, "azimuth", "angle")
        path = self.path
        whole = _TURN * path.turns
        first = float(path.travelled_to(azimuth)) % _TURN
        first = 0.0 if _TURN - first < 1e-12 * whole else first
        last = path.last_angle
        theta = first + _TURN * np.arange(math.floor((whole - last - first) / _TURN) + 1)
        if not theta.size:
            raise DataError(f"the path crosses no line at the azimuth {azimuth:.6g} rad")
        rho, z = self._error_at(np.asarray(whole - theta, dtype=np.float64))
        return Profile(rho[::-1], z[::-1], metadata={"azimuth_rad": float(azimuth)})

    def to_surface(self, n_pixels: int = 401) -> Surface:
        """Return the error on a square grid around the centre, between the turns as well.

        Parameters
        ----------
        n_pixels : int, optional
            Rows and columns, >= 3; an odd number has a pixel in the centre.

        Returns
        -------
        Surface
            From -radius to radius along x and y. Each pixel lies between two turns: the errors of
            both at its azimuth, weighted linearly. NaN outside of the first turn, and within the
            last turn or the core.

        Raises
        ------
        DataError
            If there are fewer than 3 pixels.
        LimitError
            If there are more than 5000 along a side.

        Notes
        -----
        The errors come from the interpolation itself, not from the dense samples. A real tool
        with its nose covers the space between two turns; that is another error.
        """
        n_pixels = numbers.count(n_pixels, "n_pixels", least=3)
        if n_pixels > _MOST_PIXELS:
            raise LimitError(
                f"a surface of {n_pixels} x {n_pixels} pixels is too large; give at most "
                f"{_MOST_PIXELS} along a side"
            )
        path = self.path
        axis = np.linspace(-path.radius, path.radius, n_pixels)
        x, y = np.meshgrid(axis, axis)
        u = np.hypot(x, y) * (_TURN / path.feed)
        # the angle left on the next turn outside of each pixel, and the share of the inner one
        whole, turned = _TURN * path.turns, path.travelled_to(np.arctan2(y, x))
        outer = whole - turned - _TURN * np.floor((whole - u - turned) / _TURN)
        weight = (outer - u) / _TURN
        covered = (outer <= _TURN * path.turns) & (outer - _TURN >= path.last_angle)
        z = np.full(x.shape, np.nan)
        ends = [self._error_at(v)[1] for v in (outer[covered], outer[covered] - _TURN)]
        z[covered] = ends[0] + weight[covered] * (ends[1] - ends[0])
        step = float(axis[1] - axis[0])
        corner = (-path.radius, -path.radius)
        return Surface(
            z, step, step, origin=corner, history=(Step("path_error_map", dict(self.audit)),)
        )

    def summary(self) -> tuple[Quantity, ...]:
        """Return P-V and RMS of the whole map.

        Returns
        -------
        tuple of Quantity
            In m, nothing removed; the uncertainty is not known, the model is exact.
        """
        p = self.path
        what = (
            f"of path minus ideal, {p.distribution}, {p.n_points} intervals, {p.interpolation}"
            f"{'' if p.interpolation == 'linear' else f' with {p.end} ends'}, {p.lead_in} lead-in "
            f"points, {self.sub_points} samples an interval, rho from {p.core_radius:.6g} to "
            f"{p.radius:.6g} m, nothing removed"
        )
        if p.distribution == "CA":  # samples of equal angle stand for areas that grow with rho
            rms = math.sqrt(float(np.square(self.z) @ self.rho) / float(self.rho.sum()))
        else:
            rms = math.sqrt(float(np.mean(np.square(self.z))))
        return (
            Quantity(self.peak_to_valley(), "m", f"peak to valley {what}", symbol="PV"),
            Quantity(rms, "m", f"root mean square over the area {what}", symbol="RMS"),
        )

    @property
    def audit(self) -> Mapping[str, Any]:
        """What the numbers rest on, plain values with units in the keys."""
        p = self.path
        is_angle = p.distribution == "CA"
        largest = int(np.argmax(np.abs(self.z)))
        return {
            "radius_mm": p.radius * 1e3,
            "feed_um": p.feed * 1e6,
            "distribution": p.distribution,
            **({"step_deg": math.degrees(p.step)} if is_angle else {"step_um": p.step * 1e6}),
            "n_points": p.n_points,
            "length_mm": p.length * 1e3,
            "interpolation": p.interpolation,
            "end": p.end if p.interpolation == "spline" else "none",
            "lead_in": p.lead_in,
            "knots": p.knots,
            "sense": p.sense,
            "core_radius_um": p.core_radius * 1e6,
            "sub_points": self.sub_points,
            "pv_nm": float(np.ptp(self.z)) * 1e9,
            "largest_error_nm": float(self.z[largest]) * 1e9,
            "largest_error_at_rho_um": float(self.rho[largest]) * 1e6,
        }

    def _position(self, name: str) -> FloatArray:
        """Return radius or azimuth, worked out when they are first asked for."""
        if not self._positions:
            rho, theta = np.empty(self.z.size), np.empty(self.z.size)
            filled = 0
            for samples in dense_samples(self.path, self.sub_points, first=self.path.lead_in):
                out = slice(filled, filled + samples.rho.size)
                rho[out], theta[out] = samples.rho, samples.azimuth
                filled = out.stop
            rho[-1:], theta[-1:] = last_point(self.path)
            self._positions.update(rho=frozen(rho), theta=frozen(theta))
        return self._positions[name]

    def _error_at(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return radius and error at any angles left, within the path."""
        path, s = self.path, self.course.s
        rho, azimuth = u * (path.feed / _TURN), path.azimuth_of(_TURN * path.turns - u)
        at = np.clip(path.length - arc_length(u, path.feed), s[0], s[-1])
        return rho, self.course.at(at) - heights_of(self.form, rho, azimuth)

    def _limits(self, annulus: tuple[float | None, float | None] | None) -> tuple[float, float]:
        inner, outer = self.path.core_radius, self.path.radius
        try:
            low, high = annulus if annulus is not None else (None, None)
        except (TypeError, ValueError):
            raise DataError(
                f"annulus must be (inner, outer) radius in m, None for an end, got {annulus!r}"
            ) from None
        low = inner if low is None else numbers.quantity(low, "an end of the annulus", "length")
        high = outer if high is None else numbers.quantity(high, "an end of the annulus", "length")
        slack = 1e-9 * outer
        if not (0.0 <= low < high):
            raise DataError(
                f"the annulus from {low:.6g} to {high:.6g} m is empty; give the inner and the "
                "outer radius in m"
            )
        if low < inner - slack:
            raise DataError(
                f"the annulus starts at {low:.6g} m, inside the uncut core of {inner:.6g} m; "
                "start it there, or with None"
            )
        if high > outer + slack:
            raise DataError(
                f"the annulus ends at {high:.6g} m, outside the path that starts at {outer:.6g} m; "
                "end it there, or with None"
            )
        return low, high


# ---- private: what the controller makes of a spiral program, and the samples along it ----------

_BLOCK = 1 << 14
"""Samples worked on at once: what they need stays in the cache."""
_FIT_SAMPLES = 10
"""Samples an interval for least-squares knots."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Knots of the interpolation: arc length travelled since the rim, height, slope (spline)."""

    s: FloatArray
    z: FloatArray
    slopes: FloatArray | None

    def at(self, s: FloatArray) -> FloatArray:
        """Return interpolated heights."""
        return evaluate(self.s, self.z, self.slopes, s)


def heights_of(form: Height, rho: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return the height of the form at points of the spiral; NaN is an error."""
    x, y = rho * np.cos(azimuth), rho * np.sin(azimuth)
    found = form(x, y)
    if np.iscomplexobj(found):
        raise InvalidSamplesError("the form returned complex heights; it must return real ones, m")
    try:
        z = np.asarray(found, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"the form returned {type(found).__name__}; it must return one height for each point, m"
        ) from None
    if z.shape != x.shape:
        if z.ndim:
            raise InvalidSamplesError(
                f"the form returned the shape {z.shape} for {x.shape} points; it must return one "
                "height for each point"
            )
        z = np.full(x.shape, float(z))
    if not math.isfinite(float(z.sum())):
        wrong = np.flatnonzero(~np.isfinite(z))
        if wrong.size:
            i = int(wrong[0])
            raise InvalidSamplesError(
                f"the form has the height {z[i]} at x = {x[i]:.9g} m, y = {y[i]:.9g} m "
                f"(rho = {rho[i]:.9g} m, azimuth = {azimuth[i]:.9g} rad), and a path leads through "
                "every point: use a smaller radius, a core, fewer lead-in points (they lie "
                "outside of the rim) or a form that is defined there"
            )
    return z


def course_of(path: SpiralPath, form: Height) -> Course:
    """Return what the controller makes of the program: knots, heights and slopes."""
    if not callable(form):
        raise DataError(
            "the form must be a function z(x, y) in m, such as SineGrid(...) or a GridForm of a "
            f"map, got {type(form).__name__}"
        )
    u, length = path.stations()
    z = heights_of(form, u * (path.feed / _TURN), path.azimuth_of(_TURN * path.turns - u))
    s = path.length - length
    if path.knots == "least-squares":
        z = _fitted(path, form, s)
    if path.interpolation == "linear":
        return Course(s, z, None)
    if path.interpolation == "pvt":
        return Course(s, z, _true_slopes(path, form, u))
    ends = (0.0, 0.0)
    if path.end == "clamped":
        first, last = _true_slopes(path, form, u[[0, -1]])
        ends = (float(first), float(last))
    return Course(s, z, knot_slopes(s, z, end=path.end, end_slopes=ends))


def _fitted(path: SpiralPath, form: Height, s: FloatArray) -> FloatArray:
    """Return heights of the points whose interpolation is nearest to the form."""
    at, wanted = [], []
    for samples in dense_samples(path, _FIT_SAMPLES, first=0):
        at.append(path.length - samples.length)
        wanted.append(heights_of(form, samples.rho, samples.azimuth))
    at.append(s[-1:])
    wanted.append(heights_of(form, *last_point(path)))
    return fitted_heights(
        s, np.concatenate(at), np.concatenate(wanted), interpolation=path.interpolation
    )


def _true_slopes(path: SpiralPath, form: Height, u: FloatArray) -> FloatArray:
    """Return dz/ds of the form along the spiral, s growing from the rim."""
    gradient = getattr(form, "gradient", None)
    if gradient is None:
        raise DataError(
            "clamped ends and PVT take the slope of the form, and this form has no gradient(x, y); use "
            "a spline with not-a-knot or natural ends"
        )
    a = path.feed / _TURN
    azimuth = path.azimuth_of(_TURN * path.turns - u)
    rho, c, s = a * u, np.cos(azimuth), np.sin(azimuth)
    gx, gy = (np.asarray(g, dtype=np.float64) for g in gradient(rho * c, rho * s))
    along = -a * (gx * c + gy * s) + path.way * rho * (gy * c - gx * s)
    return np.asarray(along / (a * np.hypot(u, 1.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Dense samples of some intervals, in order: arc length from the centre, radius, azimuth."""

    intervals: slice
    length: FloatArray
    rho: FloatArray
    azimuth: FloatArray


def dense_samples(path: SpiralPath, parts: int, *, first: int) -> Iterator[Samples]:
    """Yield blocks of the samples from interval `first` on, without the very last point."""
    a = path.feed / _TURN
    whole = _TURN * path.turns
    angle, length = path.stations()
    steps = np.diff(length)
    # d(u^2) = (2 / a) u / sqrt(u^2 + 1) dS is nearly constant within an interval.
    square = angle * angle
    bend = (2.0 / a) * angle[:-1] / np.sqrt(square[:-1] + 1.0) * steps
    fractions = np.arange(parts) / parts
    per_block = max(_BLOCK // parts, 1)
    for begin in range(first, steps.size, per_block):
        chosen = slice(begin, min(begin + per_block, steps.size))
        rows = length[:-1][chosen, None] + steps[chosen, None] * fractions
        flat = rows.ravel()
        guess = square[:-1][chosen, None] + bend[chosen, None] * fractions
        guess = np.sqrt(np.maximum(guess, 0.0)).ravel()
        u = newton_angle(flat * (2.0 / a), guess)
        yield Samples(chosen, flat, a * u, path.azimuth_of(whole - u))


def errors_along(path: SpiralPath, form: Height, parts: int, course: Course) -> FloatArray:
    """Return path minus form at the dense samples, from the rim to the last point."""
    fractions = np.arange(parts) / parts
    z = np.empty(path.n_points * parts + 1)
    steps = np.diff(course.s)
    filled = 0
    with one_blas_thread():
        for samples in dense_samples(path, parts, first=path.lead_in):
            chosen = samples.intervals
            knots = slice(chosen.start, chosen.stop + 1)
            slopes = None if course.slopes is None else course.slopes[knots]
            made = dense_rows(course.z[knots], steps[chosen], slopes, fractions).ravel()
            made -= heights_of(form, samples.rho, samples.azimuth)
            z[filled : filled + made.size] = made
            filled += made.size
    z[-1:] = course.z[-1:] - heights_of(form, *last_point(path))
    return z


def last_point(path: SpiralPath) -> tuple[FloatArray, FloatArray]:
    """Return radius and azimuth of the last point, as arrays of one."""
    u = np.array([path.last_angle])
    return u * (path.feed / _TURN), path.azimuth_of(_TURN * path.turns - u)


# ---- closed forms for planning: what interpolation makes of a sine along the path --------------
# The error of lines or of a C2 cubic spline through equidistant points of a sine is itself known in
# closed form, far from the ends. It plans a count of points before anything is simulated.


def sine_path_error(
    amplitude: float, wavelength: float, step: float, *, interpolation: Interpolation
) -> float:
    """Return the peak-to-valley error of an interpolated sine far from the ends.

    Parameters
    ----------
    amplitude : float, m
        Half the height of the sine, > 0.
    wavelength : float, m
        Along the path, > 0.
    step : float, m
        Between points, > 0 and at most half a wavelength.
    interpolation : {"linear", "spline", "pvt"}
        What the controller does.

    Returns
    -------
    float
        P-V, m: as much above as below, over all phases.

    Raises
    ------
    DataError
        If a number is not positive, the step above half a wavelength, or the word not known.

    Notes
    -----
    With ``w = 2 pi step / wavelength`` the error in the middle of an interval is ``A (1 - cos
    (w/2))`` for lines and ``A (1 - (23 cos(w/2) + cos(3w/2)) / (8 (2 + cos w)))`` for the cardinal
    spline; for small w ``A w^2 / 8`` and ``A w^4 / 384``. PVT with true velocities is off by ``A (1 -
    cos(w/2) - w/4 sin(w/2))``, ``A w^4 / 384`` too. Errors of both signs occur: twice that.
    A grid of two sines of equal amplitude has the same bound in every direction of the path: the
    curvature along the tangent t is ``A k^2 (t_x^2 sin + t_y^2 cos)``, at most ``A k^2``.

    Examples
    --------
    >>> round(1e9 * sine_path_error(50e-9, 100e-6, 17.45e-6, interpolation="linear"), 2)
    14.65
    """
    A, L, h = (
        length(amplitude, "amplitude"),
        length(wavelength, "wavelength"),
        length(step, "step"),
    )
    numbers.choice(interpolation, "interpolation", get_args(Interpolation))
    if h > 0.5 * L:
        raise DataError(
            f"a step of {h:.6g} m is above half the wavelength of {L:.6g} m: the points do not "
            "show the sine; make the step smaller"
        )
    half = math.pi * h / L
    if interpolation == "linear":
        return 4.0 * A * math.sin(0.5 * half) ** 2
    if interpolation == "pvt":
        # 1 - cos h - (h / 2) sin h: sines of halves keep its digits
        return 2.0 * A * abs(2.0 * math.sin(0.5 * half) ** 2 - 0.5 * half * math.sin(half))
    # With c = cos(w/2) the spline's error is A (1 - c)^2 (2 - c) / (2 (1 + 2 c^2)).
    rest = 2.0 * math.sin(0.5 * half) ** 2
    c = 1.0 - rest
    return A * rest * rest * (2.0 - c) / (1.0 + 2.0 * c * c)


@described_by(sine_path_error)
def sine_path_step(
    amplitude: float, wavelength: float, tolerance: float, *, interpolation: Interpolation
) -> float:
    """Return the step at which the error of an interpolated sine is the tolerance.

    Parameters
    ----------
    tolerance : float, m
        P-V, > 0.

    Returns
    -------
    float
        Arc step, m, at most half a wavelength.

    Examples
    --------
    >>> step = sine_path_step(50e-9, 100e-6, 1e-9, interpolation="linear")
    >>> round(step * 1e6, 2)
    4.51
    """
    tolerance = length(tolerance, "tolerance")
    high = 0.5 * length(wavelength, "wavelength")
    if sine_path_error(amplitude, wavelength, high, interpolation=interpolation) <= tolerance:
        return high
    low = 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        error = sine_path_error(amplitude, wavelength, middle, interpolation=interpolation)
        low, high = (middle, high) if error <= tolerance else (low, middle)
    return low


@described_by(sine_path_step)
def estimated_points(
    amplitude: float,
    wavelength: float,
    radius: float,
    feed: float,
    tolerance: float,
    *,
    distribution: str = "CA",
    interpolation: Interpolation = "spline",
) -> int:
    """Return the count of points that a sine or a grid of two needs, without a simulation.

    Parameters
    ----------
    radius, feed : float, m
        Of the spiral.
    distribution : {"CA", "CAL"}, optional
        With CA the step at the rim counts, with CAL the one step.

    Returns
    -------
    int
        Intervals.

    Raises
    ------
    DataError
        If a number is not positive or a word not known.

    Notes
    -----
    Left out: the free end of a spline, and with CAL the turns near the centre, where points are
    too few whatever the count: their error rules the whole map. `points_for_tolerance` has both.

    Examples
    --------
    >>> estimated_points(50e-9, 100e-6, 500e-6, 2e-6, 1e-9, interpolation="linear")
    174327
    """
    step = sine_path_step(amplitude, wavelength, tolerance, interpolation=interpolation)
    radius, feed = length(radius, "radius"), length(feed, "feed")
    whole = _TURN * radius / feed
    numbers.choice(distribution, "distribution", ("CA", "CAL"))
    to_go = whole * radius if distribution == "CA" else float(arc_length(whole, feed))
    return math.ceil(to_go / step)
