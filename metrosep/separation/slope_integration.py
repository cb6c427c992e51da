"""Heights from slopes: autocollimator, level, long trace profiler, deflectometer.

``z(x) = integral of s dx``; a positive slope rises towards larger x. Every rule here is linear, so
its uncertainty is exact for white noise of the slopes: a random walk along the artefact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._line_request import method_named, number
from metrosep.separation._slope_rules import (
    LONG,
    heights_at,
    integral,
    levelled,
    unit_uncertainty,
)
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable

__all__ = ["integrate_slopes", "slope_transfer"]


RULES = ("trapezoid", "simpson", "spline", "fourier", "feet")

_MAX_SLOPE = 0.5
"""Slopes above 0.5 rad are no slopes of a straight artefact; they were given in another unit."""

_UNIFORM_RTOL = 1e-3
"""Largest deviation of a step from the mean one, relative, for the rules that need equal steps."""

_GOOD = 0.01
"""Amplitude error up to which a wavelength counts as integrated well."""


def integrate_slopes(
    slope: ArrayLike,
    x: ArrayLike,
    *,
    method: str = "spline",
    u_slope: float | None = None,
    zero_known: bool = False,
) -> Separation:
    """Return heights of slopes over positions, with their uncertainty.

    Parameters
    ----------
    slope : array_like, shape (n,) or (R, n), rad
        Positive where the surface rises with x; or R passes. NaN = not measured.
    x : array_like, shape (n,), m
        Positions, rising. For "feet": of the rear foot.
    method : {"spline", "trapezoid", "simpson", "fourier", "feet"}, optional
        "spline" integrates the cubic spline through the slopes; "fourier" a cosine series about a
        cubic. "feet" is for a sledge whose feet are one step apart: it reads
        ``(z(x + step) - z(x)) / step``, and heights are sums, exact at n + 1 places. "simpson",
        "fourier" and "feet" need equal steps.
    u_slope : float, rad, optional
        Standard uncertainty of one slope; the scatter of the passes if omitted.
    zero_known : bool, optional
        Whether the zero of the angle sensor is known. If not, the line is left out.

    Returns
    -------
    Separation
        Part ``height`` over ``coordinates["x"]``: mean removed, with an unknown zero the
        least-squares line.

    Raises
    ------
    DataError
        If the rule is unknown or `u_slope` is negative.
    InvalidSamplesError
        If slopes or positions are no numbers, of different lengths, infinite, or do not rise.
    NotUniformError
        If the rule needs equal steps.
    TooFewSamplesError
        If fewer than 4 slopes in a row were measured.
    UnitError
        If the slopes are beyond 0.5 rad.

    Notes
    -----
    Null space: the height, and with an unknown zero of the sensor the line. Where a slope was not
    measured the pieces are not connected: the longest is returned, the rest is NaN. White noise s of
    the slopes at step h: the sums of n steps have the standard uncertainty ``s h sqrt(n)``, and
    without line the RMS ``s h sqrt((N^2 - 4)/(15 N))`` at N heights ("feet"; the other rules differ
    at the ends). Slow drift of the sensor is not white and not covered.

    References
    ----------
    ISO 230-1:2012, straightness by angle measurement ("feet"); the transfer functions of the
    rules are derived in docs/explanation/separation-slopes.md.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(0, 0.4, 201)
    >>> result = integrate_slopes(2e-6 * np.cos(50 * x), x, u_slope=5e-8)
    >>> level = 4e-8 * np.sin(50 * x)
    >>> level = level - np.polyval(np.polyfit(x, level, 1), x)
    >>> bool(abs(result.height - level).max() < 1e-12)
    True
    """
    method = method_named(method, RULES, "integrate_slopes")
    passes, at = _checked(slope, x)
    piece = _longest_piece(passes)
    if method in ("simpson", "fourier", "feet"):
        _check_uniform(at, method)
    here, values = at[piece], passes[:, piece]
    noise, u_mean = _noise(values, u_slope)
    mean = values.mean(axis=0)
    degree = 0 if zero_known else 1
    grid = heights_at(here, method)
    height = levelled(integral(mean[None, :], here, method), grid, degree)[0]
    u = unit_uncertainty(here, method, grid, degree) * u_mean
    whole = heights_at(at, method)
    inside = slice(piece.start, piece.start + grid.size)
    parts, spread = np.full(whole.size, np.nan), np.full(whole.size, np.nan)
    parts[inside], spread[inside] = height, u
    null_space, messages = _unseen(parts, degree)
    step = float(np.ptp(here)) / (here.size - 1)
    good = _shortest_good(step, method)
    if math.isnan(noise.value):
        messages.append(
            "the noise of a slope is not known, so no uncertainty is stated: give repeats, or u_slope"
        )
    audit = {
        "method": method,
        "step_mm": step * 1e3,
        "n_slopes": int(at.size),
        "n_repeats": int(passes.shape[0]),
        "shortest_wavelength_with_1_percent_error_mm": None if good is None else good * 1e3,
        "removed": "least squares: offset" + ("" if zero_known else ", line"),
        "u_from_rule": "trapezoid" if here.size > LONG and method != "feet" else method,
    }
    return Separation(
        "integrate_slopes",
        {"height": parts},
        {"height": spread},
        {"height": "m"},
        {"x": whole},
        null_space,
        noise=noise,
        audit=audit,
        messages=tuple(messages),
        history=(Step("integrate_slopes", {"method": method, "zero_known": zero_known}),),
    )


def slope_transfer(
    wavelengths: ArrayLike,
    step: float,
    *,
    method: str = "spline",
    aperture: float = 0.0,
) -> FloatArray:
    """Return height found over true height of a wave, for slopes sampled at equal steps.

    Parameters
    ----------
    wavelengths : array_like, shape (k,), m
        Above two steps.
    step : float, m
        Between the slopes.
    method : {"spline", "trapezoid", "simpson", "fourier", "feet"}, optional
        As in `integrate_slopes`.
    aperture : float, m, optional
        Length over which the sensor averages the slope (beam, mirror).

    Returns
    -------
    ndarray, shape (k,)
        1 where the rule is right, inside a long record; with w = 2 pi step / wavelength:
        trapezoid ``(w/2) / tan(w/2)``, spline ``(w/2)/tan(w/2) (5 + cos w)/(4 + 2 cos w)``, fourier
        and feet 1, simpson ``(w/6) sin w (2 + cos w)/(1 - cos w) + (w/4) sin w``, the mean of its
        even and odd nodes; times ``sinc(aperture / wavelength)``.

    Raises
    ------
    DataError
        If the rule is unknown, a length is not above zero, or a wavelength is below two steps.

    Examples
    --------
    >>> [round(float(v), 4) for v in slope_transfer([20e-3], 1e-3, method="trapezoid")]
    [0.9918]
    """
    method = method_named(method, RULES, "slope_transfer")
    lengths = np.asarray(wavelengths, dtype=np.float64)
    step, aperture = number(step, "step"), number(aperture, "aperture")
    if not (math.isfinite(step) and step > 0.0 and math.isfinite(aperture) and aperture >= 0.0):
        raise DataError(f"step {step} must be above zero, aperture {aperture} not below, in m")
    if not (lengths > 2.0 * step * (1.0 - 1e-12)).all():
        raise DataError(
            f"waves below two steps ({format_length(2.0 * step)}) are not sampled; leave them out"
        )
    w = 2.0 * np.pi * step / lengths
    gain = np.ones_like(w)
    if method in ("trapezoid", "spline"):
        gain = (w / 2.0) / np.tan(w / 2.0)
    if method == "spline":
        gain = gain * (5.0 + np.cos(w)) / (4.0 + 2.0 * np.cos(w))
    if method == "simpson":
        even = (w / 3.0) * (2.0 + np.cos(w)) * np.sin(w) / (1.0 - np.cos(w))
        gain = even / 2.0 + w * np.sin(w) / 4.0
    return np.asarray(gain * np.sinc(aperture / lengths))


def _checked(slope: ArrayLike, x: ArrayLike) -> tuple[FloatArray, FloatArray]:
    try:
        slopes = as_float(slope)
        passes = np.atleast_2d(slopes)
        at = as_float(x)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"integrate_slopes: slopes and positions must be arrays of numbers ({exc})"
        ) from None
    if passes.ndim != 2 or at.ndim != 1 or passes.shape[1] != at.size or passes.shape[0] < 1:
        raise InvalidSamplesError(
            f"integrate_slopes: slopes have the shape {np.shape(slope)}, positions {at.shape}; give one "
            "slope (or one in each pass) for each position"
        )
    if not np.isfinite(at).all() or (np.diff(at) <= 0.0).any():
        raise InvalidSamplesError(
            "integrate_slopes: positions must be finite and rise; for a run in -x turn round both "
            "arrays (the slope keeps its sign: it is dz/dx)"
        )
    if np.isinf(passes).any():
        raise InvalidSamplesError("integrate_slopes: a slope is infinite; mark it as NaN")
    steepest = float(np.nanmax(np.abs(passes), initial=0.0))
    if steepest > _MAX_SLOPE:
        raise UnitError(
            f"integrate_slopes: slopes reach {steepest:.4g} rad; they are given in rad, not in urad, arc "
            "seconds or mm/m"
        )
    return passes, at


def _longest_piece(passes: FloatArray) -> slice:
    whole = ~np.isnan(passes).any(axis=0)
    edges = np.diff(np.concatenate([[0], whole.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int((last - first).max(initial=0))
    if longest < 4:
        raise TooFewSamplesError(
            f"integrate_slopes needs 4 slopes in a row, measured in every pass; got {longest}"
        )
    best = int(np.argmax(last - first))
    return slice(int(first[best]), int(last[best]))


def _check_uniform(x: FloatArray, method: str) -> None:
    if x.size < 2:
        raise TooFewSamplesError("integrate_slopes needs 4 slopes in a row, got one")
    step = float(x[-1] - x[0]) / (x.size - 1)
    worst = float(np.abs(np.diff(x) - step).max())
    if worst > _UNIFORM_RTOL * step:
        raise NotUniformError(
            f"integrate_slopes: {method!r} needs equal steps, they differ by up to "
            f"{format_length(worst)}; use method='spline' or 'trapezoid'"
        )


def _noise(values: FloatArray, u_slope: float | None) -> tuple[Quantity, float]:
    """Return the noise of one slope and the uncertainty of the mean of the passes."""
    repeats, n = values.shape
    if u_slope is not None:
        u_slope = number(u_slope, "u_slope", "rad")
        if not (math.isfinite(u_slope) and u_slope >= 0.0):
            raise DataError(f"u_slope is {u_slope}; it must be a standard uncertainty >= 0 in rad")
        text = "standard uncertainty of one slope, as stated"
        return Quantity(float(u_slope), "rad", text, symbol="s"), u_slope / math.sqrt(repeats)
    if repeats < 2:
        text = "standard deviation of one slope; not known"
        return Quantity(math.nan, "rad", text, symbol="s"), math.nan
    rest = values - values.mean(axis=0)
    rest = rest - rest.mean(axis=1, keepdims=True)
    freedom = (repeats - 1) * (n - 1)
    value = math.sqrt(float((rest**2).sum()) / freedom)
    text = f"standard deviation of one slope, pooled from {repeats} repeats (type A)"
    noise = Quantity(value, "rad", text, u=value / math.sqrt(2.0 * freedom), symbol="s")
    return noise, value / math.sqrt(repeats)


def _unseen(height: FloatArray, degree: int) -> tuple[tuple[Unobservable, ...], list[str]]:
    reason = "slopes do not tell the height" + (
        "; the zero of the angle sensor is a line: calibrate it, then say zero_known=True"
        if degree
        else ""
    )
    items = [Unobservable("height", "polynomial", tuple(range(degree + 1)), reason)]
    lost = np.flatnonzero(np.isnan(height))
    if lost.size == 0:
        return tuple(items), []
    text = "slopes that were not measured cut the record; the longest piece is returned"
    items.append(Unobservable("height", "samples", tuple(int(i) for i in lost), text))
    return tuple(items), [f"{lost.size} heights are not connected with the rest and left NaN"]


def _shortest_good(step: float, method: str) -> float | None:
    """Return the shortest wavelength from which on the rule errs by at most 1 %."""
    if method in ("fourier", "feet"):
        return None
    lengths = step * np.geomspace(2.01, 200.0, 4000)
    bad = np.abs(slope_transfer(lengths, step, method=method) - 1.0) > _GOOD
    return float(lengths[min(int(np.flatnonzero(bad)[-1]) + 1, lengths.size - 1)])
