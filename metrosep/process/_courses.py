"""Private: what the controller makes of a spiral program, and the samples along it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.process.arc_lengths import newton_angle
from metrosep.process.interpolation import evaluate, fitted_heights, knot_slopes
from metrosep.process.spirals import Height, SpiralPath

_TURN = 2.0 * math.pi
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
    ends = (0.0, 0.0)
    if path.end == "clamped":
        ends = (_true_slope(path, form, u[0]), _true_slope(path, form, u[-1]))
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


def _true_slope(path: SpiralPath, form: Height, u: float) -> float:
    """Return dz/ds of the form along the spiral, s growing from the rim."""
    gradient = getattr(form, "gradient", None)
    if gradient is None:
        raise DataError(
            "clamped ends take the slope of the form, and this form has no gradient(x, y); use "
            "not-a-knot or natural ends"
        )
    a = path.feed / _TURN
    azimuth = float(path.azimuth_of(_TURN * path.turns - u))
    turn = 1.0 if path.sense == "counterclockwise" else -1.0
    rho, c, s = a * u, math.cos(azimuth), math.sin(azimuth)
    gx, gy = (float(np.ravel(g)[0]) for g in gradient(rho * c, rho * s))
    along = -a * (gx * c + gy * s) + turn * rho * (gy * c - gx * s)
    return along / (a * math.hypot(u, 1.0))


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


def last_point(path: SpiralPath) -> tuple[FloatArray, FloatArray]:
    """Return radius and azimuth of the last point, as arrays of one."""
    u = np.array([path.last_angle])
    return u * (path.feed / _TURN), path.azimuth_of(_TURN * path.turns - u)
