"""Kono's Fourier separation, to the letter of the paper, its ambiguities as options.

Steps of the paper motion-error-fourier (Kono et al. 2008, section 2.3): average the runs of one
feedrate; remove mean and line (eq. 4 has no k = 0, eq. 1 puts the slope into alignment); weight
by eq. 5; Fourier transform at exactly l_x/k; mean P and standard deviation sigma of the spectra
over the feedrates; the shortest wavelength with sigma < sigma_t and P > P_t; m = l_x/lambda;
reconstruct eq. 4 with k = 1 ... m.

The coefficients describe the weighted data, so the model decays to zero in the tapered ends: it
may be used in the flat part only, and l_x must be at least L/0.8 for a taper of 10 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError, UnitError
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_length
from metrosep.separation.base import DirectionEstimate, ErrorEstimate
from metrosep.separation.curves import LINE_POINTS, FourierCurve, SampledCurve
from metrosep.separation.design import evaluation_range
from metrosep.spectral.dft import fourier_basis, fourier_coefficients
from metrosep.spectral.window import kono_weights, tukey_weights

__all__ = ["FeedSpectra", "feed_spectra", "feed_spectra_columns", "separate_kono"]

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Norm = Literal["amplitude", "power", "psd"]
Rule = Literal["shortest", "contiguous", "mask"]
Taper = Literal["kono", "tukey"]

_UM, _MM, _NM = 1e-6, 1e-3, 1e-9
_SPACE_SHARE = 2.5
_THRESHOLDS = {
    "amplitude": (0.05 * _UM, 0.01 * _UM, "m"),
    "power": (0.05 * _UM**2, 0.01 * _UM**2, "m2"),
    "psd": (0.05 * _UM**2 * _MM, 0.01 * _UM**2 * _MM, "m3"),
}
"""The paper's 0.05 and 0.01, read in um, um^2 or um^2 mm: sigma_t, p_t, SI unit."""


@dataclass(frozen=True, slots=True, eq=False)
class FeedSpectra:
    """Spectra of the mean run of each feedrate at the wavelengths l_x/k.

    Parameters
    ----------
    feeds : tuple of float, m/s
        Feedrates, slowest first.
    wavelength : ndarray, shape (K,), m
        ``l_x/k``, k = 1 ... K.
    coefficients : ndarray of complex, shape (n_feeds, K), m
        ``a_k + i b_k`` of the weighted mean run, weight not divided out.
    per_run : list of ndarray of complex, shape (n_runs_of_feed, K)
        The same of each run.
    mean_weight, mean_square_weight : float
        Mean of the weights and of their squares.
    slopes : list of float, rad
        Slope of the line removed from each run.
    """

    feeds: tuple[float, ...]
    wavelength: FloatArray
    coefficients: ComplexArray
    per_run: list[ComplexArray]
    mean_weight: float
    mean_square_weight: float
    slopes: list[float]

    def power(self, norm: Norm, length: float) -> FloatArray:
        """Return P(lambda) of each feedrate in one of three normalisations.

        Parameters
        ----------
        norm : {"amplitude", "power", "psd"}
            Amplitude ``|c|/mean(f)`` in m, its square in m^2, or one-sided density in m^3.
        length : float, m
            Length of the modelling l_x.

        Returns
        -------
        ndarray, shape (n_feeds, K)
            Spectrum of each feedrate.
        """
        size = np.abs(self.coefficients)
        if norm == "amplitude":
            return np.asarray(size / self.mean_weight)
        if norm == "power":
            return np.asarray((size / self.mean_weight) ** 2)
        return np.asarray(0.5 * size**2 * length / self.mean_square_weight)


def feed_spectra(
    runs: RunSet,
    *,
    origin: float,
    length: float,
    n_harmonics: int,
    taper_fraction: float = 0.1,
    taper: Taper = "kono",
) -> FeedSpectra:
    """Return the spectrum of the coherent mean of the runs at each feedrate.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction that cover ``origin ... origin + length``.
    origin, length : float, m
        x_st and l_x of eq. 4.
    n_harmonics : int
        Number of wavelengths.
    taper_fraction : float, optional
        N over the number of sampling points, 0 < fraction <= 0.5; 0.1 in the paper.
    taper : {"kono", "tukey"}, optional
        Eq. 5 to the letter, or its symmetric relative.

    Returns
    -------
    FeedSpectra
        Complex coefficients of every feedrate and run.

    Raises
    ------
    DataError
        If `taper_fraction` is out of range.
    TooFewSamplesError
        If a run has too few valid samples in the range.
    """
    if not 0.0 < taper_fraction <= 0.5:
        raise DataError(f"taper_fraction must be in (0, 0.5], got {taper_fraction}")
    groups = runs.by_feed() or [(math.nan, runs.runs)]
    per_run: list[ComplexArray] = []
    slopes: list[float] = []
    weights: list[FloatArray] = []
    for _, members in groups:
        rows = []
        for run in members:
            x, z = _inside(run, origin, length)
            slope, level = np.polyfit(x - origin, z, 1)
            slopes.append(float(slope))
            n_taper = max(1, round(taper_fraction * x.size))
            window = kono_weights if taper == "kono" else tukey_weights
            weight = window(x.size, n_taper)
            weights.append(weight)
            rows.append(
                fourier_coefficients(
                    x,
                    z - (slope * (x - origin) + level),
                    origin=origin,
                    period=length,
                    n_harmonics=n_harmonics,
                    weights=weight,
                )
            )
        per_run.append(np.array(rows))
    joined = np.concatenate(weights)
    return FeedSpectra(
        feeds=tuple(feed for feed, _ in groups),
        wavelength=length / np.arange(1, n_harmonics + 1),
        coefficients=np.array([rows.mean(axis=0) for rows in per_run]),
        per_run=per_run,
        mean_weight=float(joined.mean()),
        mean_square_weight=float((joined**2).mean()),
        slopes=slopes,
    )


def _inside(run: Run, origin: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Return rising positions and valid heights within half a pitch of the modelled length."""
    order = slice(None) if run.direction > 0 else slice(None, None, -1)
    x, z = run.x[order], run.z[order]
    margin = 0.5 * abs(float(x[-1] - x[0])) / (x.size - 1)
    keep = (x >= origin - margin) & (x <= origin + length + margin) & ~np.isnan(z)
    if keep.sum() < 16:
        raise TooFewSamplesError(
            f"run {run.run_id!r} has {int(keep.sum())} valid samples between {format_length(origin)} "
            f"and {format_length(origin + length)}; 16 are needed"
        )
    return np.asarray(x[keep]), np.asarray(z[keep])


def feed_spectra_columns(runs: RunSet) -> dict[str, list[Any]]:
    """Return amplitude against wavelength for each feedrate over the common travel.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction.

    Returns
    -------
    dict of str to list
        Columns ``feed_mm_min``, ``wavelength_mm``, ``amplitude_nm``.
    """
    low, high = runs.common_travel
    n = _n_wavelengths(runs, high - low)
    spectra = feed_spectra(runs, origin=low, length=high - low, n_harmonics=n)
    amplitude = spectra.power("amplitude", high - low)
    return {
        "feed_mm_min": np.repeat(np.array(spectra.feeds) * 6e4, n).tolist(),
        "wavelength_mm": np.tile(spectra.wavelength / _MM, len(spectra.feeds)).tolist(),
        "amplitude_nm": (amplitude / _NM).ravel().tolist(),
    }


def _n_wavelengths(runs: RunSet, length: float) -> int:
    pitch = max(abs(float(r.x[-1] - r.x[0])) / (len(r) - 1) for r in runs)
    return int(np.clip(length / (_SPACE_SHARE * pitch), 1, 1000))


def separate_kono(
    runs: RunSet,
    *,
    length: float | None = None,
    start: float | None = None,
    shortest: float | None = None,
    sigma_t: float | None = None,
    p_t: float | None = None,
    norm: Norm = "amplitude",
    taper_fraction: float = 0.1,
    taper: Taper = "kono",
    rule: Rule = "shortest",
    modelling_length: float | None = None,
    values: Literal["one_feed", "all"] = "one_feed",
    feed: float | None = None,
) -> ErrorEstimate:
    """Return the repeatable error by Kono's Fourier method.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction.
    length, start : float, m, optional
        Required range L; the flat part of the window over the common travel if omitted.
    shortest : float, m, optional
        Sets lambda* by hand; the thresholds are then not used.
    sigma_t, p_t : float, SI, optional
        Thresholds of standard deviation and mean over feedrates, in m, m^2 or m^3 according to
        `norm`; the paper's 0.05 and 0.01 read in um, um^2, um^2 mm if omitted.
    norm : {"amplitude", "power", "psd"}, optional
        Normalisation of P, which the paper does not state.
    taper_fraction : float, optional
        N over the number of sampling points.
    taper : {"kono", "tukey"}, optional
        Eq. 5 to the letter or the symmetric cosine taper.
    rule : {"shortest", "contiguous", "mask"}, optional
        Keep all k up to the shortest wavelength that passes (the paper); up to the first that
        fails from the long side; or only those that pass.
    modelling_length : float, m, optional
        l_x; the required length over ``1 - 2 taper_fraction``, as far as the travel allows.
    values : {"one_feed", "all"}, optional
        Coefficients from the mean run of one feedrate (the paper) or of all.
    feed : float, m/s, optional
        That feedrate; the middle one if omitted.

    Returns
    -------
    ErrorEstimate
        With eq. 4 as its curve; sd from the scatter of the runs that were averaged.

    Raises
    ------
    NotSeparableError
        If thresholds are to select from fewer than two feedrates, or nothing passes.
    UnitError
        If a threshold or `shortest` cannot be meant in SI.
    DataError
        If an option is not one of its choices.
    InvalidSamplesError, TooFewSamplesError
        If the range is not covered.
    """
    _check_choices(norm=norm, rule=rule, taper=taper, values=values)
    origin, l_x, first, last, messages = _lengths(
        runs, start, length, modelling_length, taper_fraction
    )
    n = _n_wavelengths(runs, l_x)
    spectra = feed_spectra(
        runs, origin=origin, length=l_x, n_harmonics=n, taper_fraction=taper_fraction, taper=taper
    )
    limits = _thresholds(norm, sigma_t, p_t)
    selection = _select(spectra, l_x, norm=norm, limits=limits, rule=rule, shortest=shortest)
    coefficients, members, used = _values(spectra, values=values, feed=feed)
    kept = np.where(selection.kept, coefficients, 0.0)[: selection.m]
    curve, slope_fourier = _kono_curve(kept, origin, l_x, first, last)
    uncertainty = _kono_sd(members * selection.kept, origin, l_x, (first, last))
    audit = {
        "n_runs": len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in spectra.feeds],
        "values_from": used,
        "modelling_length_mm": l_x / _MM,
        "flat_part_mm": [
            (origin + taper_fraction * l_x) / _MM,
            (origin + (1.0 - taper_fraction) * l_x) / _MM,
        ],
        "m": selection.m,
        "selected_wavelength_mm": l_x / selection.m / _MM,
        "wavelength_chosen_by": "user" if shortest is not None else f"thresholds, rule {rule!r}",
        "norm": norm,
        "sigma_t_si": limits[0],
        "p_t_si": limits[1],
        "threshold_unit": limits[2],
        "rule": rule,
        "taper": taper,
        "taper_fraction": taper_fraction,
        "mean_removed_before_taper": True,
        "line_removed": "least squares over l_x before the taper, and over the evaluation range",
    }
    residual = _residual(runs, curve)
    slopes = np.array(spectra.slopes)
    return ErrorEstimate(
        method="kono",
        start=first,
        stop=last,
        fit_range=(origin, origin + l_x),
        directions_data={0: DirectionEstimate(curve, uncertainty)},
        slope=Quantity(
            float(slopes.mean() + slope_fourier),
            "rad",
            "slope of the line removed from the runs plus that of the model over the evaluation "
            "range (alignment, eq. 1)",
            u=float(slopes.std(ddof=1) / math.sqrt(slopes.size)) if slopes.size > 1 else None,
        ),
        spectrum_data=_kono_spectrum(
            spectra, selection, coefficients, members, (first, origin, l_x)
        ),
        feed_spectra_data=feed_spectra_columns(runs),
        residual_psd_data={"frequency_hz": [], "psd_nm2_per_hz": [], "model_nm2_per_hz": []},
        residual_rms=residual,
        audit=audit,
        messages=messages,
        history=runs.history,
    )


def _check_choices(**options: str) -> None:
    choices = {
        "norm": ("amplitude", "power", "psd"),
        "rule": ("shortest", "contiguous", "mask"),
        "taper": ("kono", "tukey"),
        "values": ("one_feed", "all"),
    }
    for name, value in options.items():
        if value not in choices[name]:
            raise DataError(
                f"{name}={value!r} is not one of {', '.join(map(repr, choices[name]))}"
            )


def _lengths(
    runs: RunSet,
    start: float | None,
    length: float | None,
    modelling_length: float | None,
    taper_fraction: float,
) -> tuple[float, float, float, float, tuple[str, ...]]:
    """Return x_st, l_x, evaluation start and stop, and warnings."""
    if not 0.0 < taper_fraction < 0.5:
        raise DataError(f"taper_fraction must be in (0, 0.5), got {taper_fraction}")
    low, high = runs.common_travel
    flat = 1.0 - 2.0 * taper_fraction
    if length is None and start is None:
        evaluation_range(runs, start=None, length=None)
        l_x = modelling_length or high - low
        origin = low + (high - low - l_x) / 2.0
        first, last = origin + taper_fraction * l_x, origin + (1.0 - taper_fraction) * l_x
    else:
        first, last = evaluation_range(runs, start=start, length=length)
        l_x = modelling_length or min((last - first) / flat, high - low)
        origin = (
            float(np.clip((first + last - l_x) / 2.0, low, high - l_x))
            if l_x < high - low
            else low
        )
    if l_x > (high - low) * (1.0 + 1e-6):
        raise DataError(
            f"modelling_length is {format_length(l_x)}, the runs share only "
            f"{format_length(high - low)} of travel"
        )
    margin = 2e-3 * l_x
    flat_low, flat_high = origin + taper_fraction * l_x, origin + (1.0 - taper_fraction) * l_x
    if first < flat_low - margin or last > flat_high + margin:
        message = (
            f"the evaluation range {format_length(first)} ... {format_length(last)} leaves the flat "
            f"part of the window ({format_length(flat_low)} ... {format_length(flat_high)}): the "
            f"model decays to zero in the ends; the length of the modelling must be at least "
            f"{format_length((last - first) / flat)} around the range, it is {format_length(l_x)}"
        )
        return origin, l_x, first, last, (message,)
    return origin, l_x, first, last, ()


def _thresholds(norm: Norm, sigma_t: float | None, p_t: float | None) -> tuple[float, float, str]:
    default_sigma, default_p, unit = _THRESHOLDS[norm]
    limits = []
    for name, value, default in (("sigma_t", sigma_t, default_sigma), ("p_t", p_t, default_p)):
        number = default if value is None else float(value)
        if not 0.0 <= number < 1e3 * default_sigma:
            raise UnitError(
                f"{name} is {number} {unit}; it is in SI here, so the paper's default is "
                f"{default:.3g} {unit}"
            )
        limits.append(number)
    return limits[0], limits[1], unit


@dataclass(frozen=True, slots=True, eq=False)
class _Selection:
    kept: NDArray[np.bool_]
    passed: NDArray[np.bool_]
    mean: FloatArray
    sigma: FloatArray
    m: int
    reasons: list[str]


def _select(
    spectra: FeedSpectra,
    length: float,
    *,
    norm: Norm,
    limits: tuple[float, float, str],
    rule: Rule,
    shortest: float | None,
) -> _Selection:
    power = spectra.power(norm, length)
    mean = power.mean(axis=0)
    n = mean.size
    several = power.shape[0] > 1
    sigma = power.std(axis=0, ddof=1) if several else np.full(n, np.nan)
    passed = (sigma < limits[0]) & (mean > limits[1])
    if shortest is not None:
        m = math.floor(length / shortest * (1.0 + 1e-9))
        if not 1 <= m <= n:
            raise UnitError(
                f"shortest is {format_length(shortest)}; it must lie between "
                f"{format_length(length / n)} and {format_length(length)}; it is in metres: 4 mm is 4e-3"
            )
        kept = np.arange(n) < m
        return _Selection(kept, passed, mean, sigma, m, ["set by hand" if k else "" for k in kept])
    if not several:
        raise NotSeparableError(
            "the rule of repeatability over feedrates needs runs at >= 2 feedrates, got "
            f"{power.shape[0]}; add runs at another feedrate or set the shortest wavelength by hand"
        )
    if not passed.any():
        raise NotSeparableError(
            f"no wavelength has sigma < {limits[0]:.3g} {limits[2]} and mean P > {limits[1]:.3g} "
            f"{limits[2]} (norm {norm!r}; largest mean P is {mean.max():.3g} {limits[2]}); relax "
            "sigma_t or p_t, or set the shortest wavelength by hand"
        )
    if rule == "contiguous":
        m = int(np.argmin(passed)) if not passed.all() else n
        if m == 0:
            raise NotSeparableError(
                "the longest wavelength already fails the thresholds, so the contiguous band is "
                "empty; use rule='mask' or rule='shortest'"
            )
        kept = np.arange(n) < m
    else:
        m = int(np.flatnonzero(passed)[-1]) + 1
        kept = passed if rule == "mask" else np.arange(n) < m
    reasons = [
        ("passes" if p else "longer than the selected one") if k else _why_not(s, q, limits)
        for p, k, s, q in zip(passed, kept, sigma, mean, strict=True)
    ]
    return _Selection(kept, passed, mean, sigma, m, reasons)


def _why_not(sigma: float, mean: float, limits: tuple[float, float, str]) -> str:
    parts = []
    if not sigma < limits[0]:
        parts.append("sigma too large")
    if not mean > limits[1]:
        parts.append("P too small")
    return " and ".join(parts) or "shorter than the band"


def _values(
    spectra: FeedSpectra, *, values: str, feed: float | None
) -> tuple[ComplexArray, ComplexArray, str]:
    if values == "all":
        members = np.concatenate(spectra.per_run)
        return members.mean(axis=0), members, f"mean of all {members.shape[0]} runs"
    feeds = np.array(spectra.feeds)
    index = (feeds.size - 1) // 2 if feed is None else int(np.argmin(np.abs(feeds - feed)))
    if feed is not None and abs(feeds[index] / feed - 1.0) > 0.02:
        have = ", ".join(f"{f * 6e4:.6g}" for f in feeds)
        raise DataError(
            f"no runs at feed {feed * 6e4:.6g} mm/min; the set has {have} mm/min (feed is in m/s here)"
        )
    members = spectra.per_run[index]
    text = f"mean of {members.shape[0]} run(s) at {feeds[index] * 6e4:.6g} mm/min"
    return spectra.coefficients[index], members, text


def _kono_curve(
    kept: ComplexArray, origin: float, l_x: float, first: float, last: float
) -> tuple[FourierCurve, float]:
    """Return eq. 4 less its line over the evaluation range, and the slope of that line."""
    raw = FourierCurve(
        origin, l_x, kept.real.copy(), kept.imag.copy(), 0.0, 0.0, (origin, origin + l_x)
    )
    x = np.linspace(first, last, LINE_POINTS)
    slope, level = np.polyfit(x - origin, raw(x), 1)
    curve = FourierCurve(
        origin, l_x, raw.cosine, raw.sine, -float(level), -float(slope), raw.travel
    )
    return curve, float(slope)


def _kono_sd(
    members: ComplexArray, origin: float, l_x: float, evaluation: tuple[float, float]
) -> SampledCurve:
    n, k = members.shape
    grid = np.linspace(origin, origin + l_x, 1001)
    if n < 2:
        return SampledCurve(grid, np.full(grid.size, np.nan))
    basis = fourier_basis(grid, origin=origin, period=l_x, n_harmonics=k)
    curves = np.hstack([members.real, members.imag]) @ basis.T
    inner = (grid >= evaluation[0]) & (grid <= evaluation[1])
    line = np.column_stack([np.ones(grid.size), (grid - origin) / l_x])
    curves = curves - (line @ np.linalg.lstsq(line[inner], curves[:, inner].T, rcond=None)[0]).T
    return SampledCurve(grid, curves.std(axis=0, ddof=1) / math.sqrt(n))


def _residual(runs: RunSet, curve: FourierCurve) -> float:
    squares = []
    for run in runs:
        rest = run.z - curve(run.x)
        valid = ~np.isnan(rest)
        fit = np.polyfit(run.x[valid], rest[valid], 1)
        squares.append((rest[valid] - np.polyval(fit, run.x[valid])) ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def _kono_spectrum(
    spectra: FeedSpectra,
    selection: _Selection,
    coefficients: ComplexArray,
    members: ComplexArray,
    place: tuple[float, float, float],
) -> dict[str, list[Any]]:
    first, origin, l_x = place
    k = np.arange(1, coefficients.size + 1)
    amplitude = np.abs(coefficients) / spectra.mean_weight
    n = members.shape[0]
    sd = np.full(k.size, np.nan)
    if n > 1:
        parts = np.stack([members.real, members.imag]).std(axis=1, ddof=1)
        sd = np.sqrt((parts**2).mean(axis=0) / n) / spectra.mean_weight
    phase = 2.0 * np.pi * k * (first - origin) / l_x - np.angle(coefficients)
    with np.errstate(divide="ignore", invalid="ignore"):
        snr = amplitude / sd
    return {
        "wavelength_mm": (spectra.wavelength / _MM).tolist(),
        "amplitude_nm": (amplitude / _NM).tolist(),
        "phase_rad": ((phase + np.pi) % (2.0 * np.pi) - np.pi).tolist(),
        "sd_nm": (sd / _NM).tolist(),
        "snr": np.where(np.isfinite(snr), snr, np.nan).tolist(),
        "p": [math.nan] * k.size,
        "mean_power_si": selection.mean.tolist(),
        "sigma_si": selection.sigma.tolist(),
        "selected": [bool(v) for v in selection.kept],
        "reason": selection.reasons,
    }
