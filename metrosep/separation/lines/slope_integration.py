"""Heights from slopes: autocollimator, level, long trace profiler, deflectometer.

``z(x) = integral of s dx``; a positive slope rises towards larger x. Every rule here is linear, so
its uncertainty is exact for white noise of the slopes: a random walk along the artefact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.methods import Readings
from metrosep.core.numbers import flag, not_negative, positive
from metrosep.core.options import Option, option
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.units import format_length
from metrosep.separation._readings import as_numbers, known_parts, line_basis
from metrosep.separation.contract import (
    History,
    Parts,
    RecordedMethod,
    Separation,
    Unobservable,
    as_stated,
    not_known,
    over_line,
    settle,
    type_a,
)
from metrosep.separation.lines._line_problem import longest_run, method_named

RULES = ("trapezoid", "simpson", "spline", "fourier", "feet")

_MAX_SLOPE = 0.5
"""Slopes above 0.5 rad are not slopes of a straight artefact; they were given in another unit."""

_UNIFORM_RTOL = 1e-3
"""Largest deviation of a step from the mean one, relative, for the rules that need equal steps."""

_GOOD = 0.01
"""Amplitude error up to which a wavelength counts as integrated well."""


_HEIGHT = "slopes do not tell the height"
_LINE = "; the zero of the angle sensor is a line: calibrate it, then say zero_known=True"
_ZERO = "the zero of the sensor and the line of the artefact read alike"
_KNOWN = "the zero is taken as known: what is wrong with it tilts the heights"


@dataclass(frozen=True, slots=True)
class SlopeIntegration(RecordedMethod):
    """An angle sensor that is moved along an artefact.

    ``slope_r(x) = dz/dx + zero_r``; for a sledge on two feet ``(z(x + step) - z(x)) / step +
    zero_r``. Readings (M, n) in rad: slopes of M passes, positive where the surface rises with x.
    Parts: ``height`` in m at the positions, for "feet" also one step beyond the last; ``zero`` of
    the sensor in rad, one number, NaN: it is not seen, and adds nothing. But for "feet" simulated
    slopes are those of the cubic spline through the heights: exact for cubics, good for waves above
    some ten steps.

    Parameters
    ----------
    x : tuple of float, m
        At least 4 positions of the slopes, rising; for "feet" of the rear foot.
    method : {"spline", "trapezoid", "simpson", "fourier", "feet"}, optional
        "spline" integrates the cubic spline through the slopes; "fourier" a cosine series about a
        cubic. "feet" is for a sledge whose feet are one step apart: it reads
        ``(z(x + step) - z(x)) / step``, and heights are sums, exact at n + 1 places. "simpson",
        "fourier" and "feet" need equal steps.
    zero_known : bool, optional
        Whether the zero of the angle sensor is known. If not, the line is omitted.

    Raises
    ------
    DataError
        If the rule is unknown.
    InvalidSamplesError
        If the positions are not finite and rising.
    TooFewSamplesError
        If there are fewer than 4.

    Examples
    --------
    >>> method = SlopeIntegration((0.0, 0.1, 0.2, 0.3), "feet", zero_known=True)
    >>> slopes = method.simulate({"height": [2e-6, 1e-6, -4e-6, 3e-6, -2e-6]}, {})
    >>> (method.separate(slopes).height * 1e6).round(6).tolist()
    [2.0, 1.0, -4.0, 3.0, -2.0]
    """

    x: tuple[float, ...]
    method: str = option(
        "spline",
        kind="text",
        choices=("spline", "trapezoid", "simpson", "fourier", "feet"),
        help="how the slopes are integrated",
    )
    zero_known: bool = option(
        False, kind="flag", help="true: the zero of the slope is known, and so is the line"
    )

    name = "integrate_slopes"
    what = "heights of a surface from slopes; each column a pass"
    over = "x"
    dimension = "angle"
    arguments: ClassVar[Mapping[str, Option]] = {
        "u_slope": Option(
            "angle", help="standard uncertainty of one slope; the scatter of the passes if omitted"
        )
    }
    truth_parts = ("height",)
    error_parts = ("zero",)

    @classmethod
    def from_inputs(cls, data: Readings, options: Mapping[str, Any]) -> Any:
        """Return the heights; columns and their repeats are passes."""
        passes = data.values.reshape(-1, data.values.shape[-1])
        slopes = passes[0] if len(passes) == 1 else passes
        return integrate_slopes(slopes, over_line(data), **options)

    def __post_init__(self) -> None:
        method = method_named(self.method, RULES, self.name)
        settle(self, method=method, zero_known=flag(self.zero_known, "zero_known"))
        x = frozen_float(self.x, name="x", ndim=1, min_size=4)
        if not (np.isfinite(x).all() and (np.diff(x) > 0.0).all()):
            raise InvalidSamplesError(f"{self.name}: positions must be finite and rising, in m")

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        x = np.array(self.x)
        zero = parts.get("zero", np.zeros(()))
        if zero.ndim:
            raise DataError(f"{self.name}: the zero of the sensor is one number, got {zero.shape}")
        slopes = np.full(x.size, float(np.nan_to_num(zero, nan=0.0)))
        if "height" in parts:
            at = heights_at(x, self.method)
            height = parts["height"]
            if height.shape != at.shape or not np.isfinite(height).all():
                raise DataError(
                    f"{self.name}: the height must hold {at.size} finite values, got the shape "
                    f"{height.shape}"
                )
            if self.method == "feet":
                slopes += np.diff(height) / np.diff(at)
            else:
                from scipy.interpolate import CubicSpline

                slopes += CubicSpline(at, height)(at, 1)
        return slopes[np.newaxis]

    def null_space(self) -> tuple[Unobservable, ...]:
        degrees, more = ((0,), "") if self.zero_known else ((0, 1), _LINE)
        return (
            Unobservable("height", "polynomial", degrees, _HEIGHT + more),
            Unobservable("zero", "term", ("all of it",), _KNOWN if self.zero_known else _ZERO),
        )

    def _solved(self, readings: ArrayLike, stated: float | None, history: History) -> Separation:
        array = as_numbers(readings, f"{self.name} needs slopes (M, n) as numbers")
        if array.ndim != 2 or array.shape[1] != len(self.x):
            raise InvalidSamplesError(
                f"{self.name} needs slopes at the {len(self.x)} positions, shape (M, {len(self.x)}), "
                f"got {array.shape}"
            )
        found = integrate_slopes(
            array, self.x, method=self.method, u_slope=stated, zero_known=self.zero_known
        )
        unknown = np.array(np.nan)
        cut = tuple(item for item in found.null_space if item.kind == "samples")
        return replace(
            found,
            parts={**found.parts, "zero": unknown},
            u={**found.u, "zero": unknown},
            units={**found.units, "zero": "rad"},
            null_space=(*self.null_space(), *cut),
            messages=tuple(m.replace("u_slope", "u_reading") for m in found.messages),
            history=(*history, *found.history),
        )


@described_by(SlopeIntegration)
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
        If slopes or positions are not numbers, of different lengths, infinite, or do not rise.
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
    step = positive(step, "step", dimension="length")
    aperture = not_negative(aperture, "aperture", dimension="length")
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
    piece = longest_run(np.asarray(~np.isnan(passes).any(axis=0)))
    if piece.stop - piece.start < 4:
        raise TooFewSamplesError(
            "integrate_slopes needs 4 slopes in a row, measured in every pass; got "
            f"{piece.stop - piece.start}"
        )
    return piece


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
        u_slope = not_negative(u_slope, "u_slope", dimension="angle")
        return as_stated(u_slope, "rad", "slope"), u_slope / math.sqrt(repeats)
    if repeats < 2:
        return not_known("rad", "slope"), math.nan
    rest = values - values.mean(axis=0)
    rest = rest - rest.mean(axis=1, keepdims=True)
    freedom = (repeats - 1) * (n - 1)
    value = math.sqrt(float((rest**2).sum()) / freedom)
    text = f"standard deviation of one slope, pooled from {repeats} repeats (type A)"
    return type_a(value, "rad", text, freedom), value / math.sqrt(repeats)


def _unseen(height: FloatArray, degree: int) -> tuple[tuple[Unobservable, ...], list[str]]:
    reason = _HEIGHT + (_LINE if degree else "")
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


# ---- rules that integrate slopes, all linear, and what they make of white noise ----------------

LONG = 1500
"""More slopes than this have the uncertainty of trapezoids: the rules differ by 1/n of it on
equal steps, by some percent on uneven ones."""

_BLOCK = 256
"""Unit slopes that are integrated at a time for the uncertainty."""


def heights_at(x: FloatArray, method: str) -> FloatArray:
    """Return where the heights are: at the slopes, for feet also under the last front foot."""
    if method != "feet":
        return x
    return np.asarray(np.append(x, x[-1] + (x[-1] - x[0]) / (x.size - 1)))


def integral(s: FloatArray, x: FloatArray, method: str) -> FloatArray:
    """Return heights of slopes, shape (k, n), the first one 0."""
    zero = np.zeros((s.shape[0], 1))
    if method == "feet":
        step = (x[-1] - x[0]) / (x.size - 1)
        return np.concatenate([zero, step * np.cumsum(s, axis=1)], axis=1)
    if method == "fourier":
        return _cosine_integral(s, x)
    if method == "simpson":
        from scipy.integrate import cumulative_simpson

        return np.asarray(cumulative_simpson(s, x=x, axis=1, initial=0.0))
    if method == "spline":
        from scipy.interpolate import make_interp_spline

        centre, scale = x[0], x[-1] - x[0]
        spline = make_interp_spline((x - centre) / scale, s.T, k=3).antiderivative()
        return np.asarray(spline((x - centre) / scale).T * scale)
    steps = 0.5 * (s[:, 1:] + s[:, :-1]) * np.diff(x)
    return np.concatenate([zero, np.cumsum(steps, axis=1)], axis=1)


def _cosine_integral(s: FloatArray, x: FloatArray) -> FloatArray:
    """Integrate a cubic exactly and what is left as a cosine series over the record."""
    from scipy.fft import dct, dst

    n = x.size
    t = np.linspace(-1.0, 1.0, n)
    half = (x[-1] - x[0]) / 2.0
    basis = np.polynomial.legendre.legvander(t, 3)
    found = np.linalg.lstsq(basis, s.T, rcond=None)[0]
    smooth = np.polynomial.legendre.legint(found, lbnd=-1.0)
    out = np.polynomial.legendre.legval(t, smooth) * half
    a = dct(s - (basis @ found).T, type=1, axis=1) / (n - 1)
    waves = np.zeros_like(out)
    k = np.arange(1, n - 1)
    waves[:, 1:-1] = dst(a[:, 1:-1] * (2.0 * half / (np.pi * k)), type=1, axis=1) / 2.0
    return np.asarray(out + waves + 0.5 * a[:, :1] * half * (t + 1.0))


def levelled(height: FloatArray, grid: FloatArray, degree: int) -> FloatArray:
    """Return heights without their polynomial of a degree."""
    basis = line_basis(grid)[:, : degree + 1]
    q = np.linalg.qr(basis)[0]
    return np.asarray(height - (height @ q) @ q.T)


def unit_uncertainty(x: FloatArray, method: str, grid: FloatArray, degree: int) -> FloatArray:
    """Return the uncertainty of heights for unit white noise.

    Sums and trapezoids in closed form; the other rules by trying every slope alone, and as
    trapezoids, from which they differ at the ends only, where the record is long.
    """
    if method in ("feet", "trapezoid") or x.size > LONG:
        return _walk_uncertainty(x, method, grid, degree)
    n = x.size
    total = np.zeros(grid.size)
    for start in range(0, n, _BLOCK):
        rows = np.eye(min(_BLOCK, n - start), n, k=start)
        total += (levelled(integral(rows, x, method), grid, degree) ** 2).sum(axis=0)
    return np.sqrt(total)


def _walk_uncertainty(x: FloatArray, method: str, grid: FloatArray, degree: int) -> FloatArray:
    """Return the root of the diagonal of P T T' P: T sums, P removes the line."""
    rule = "feet" if method == "feet" else "trapezoid"
    n, step = x.size, np.diff(grid)
    weight = step if rule == "feet" else np.concatenate([[0.0], step]) / 2.0
    if rule == "feet":
        own = np.concatenate([[0.0], np.cumsum(weight**2)])
    else:
        inner = weight + np.append(weight[1:], 0.0)
        own = np.concatenate([[0.0], np.cumsum(inner**2)[:-1]]) + weight**2
        own[0] = 0.0
    q = np.linalg.qr(line_basis(grid)[:, : degree + 1])[0]
    above = np.cumsum(q[::-1], axis=0)[::-1][1:] * step[:, None]
    if rule == "feet":
        back = above
    else:
        back = np.zeros((n, q.shape[1]))
        back[:-1] += above / 2.0
        back[1:] += above / 2.0
    spread = integral(back.T, x, rule).T
    core = q.T @ spread
    variance = own - 2.0 * np.sum(spread * q, axis=1) + np.sum((q @ core) * q, axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
