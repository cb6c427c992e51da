"""Kono's Fourier separation, to the letter of the paper, its ambiguities as options.

Steps of the paper motion-error-fourier (Kono et al. 2008, section 2.3): average the runs of one
feedrate; remove mean and line (eq. 4 has no k = 0, eq. 1 puts the slope into alignment); weight
by eq. 5; Fourier transform at exactly l_x/k; mean P and standard deviation sigma of the spectra
over the feedrates; the shortest wavelength with sigma < sigma_t and P > P_t; m = l_x/lambda;
reconstruct eq. 4 with k = 1 ... m.

The coefficients describe the weighted data, so the model decays to zero in the tapered ends: it
may be used in the flat part only, and l_x must be at least L/0.8 for a taper of 10 %.

The estimate is that of the paper. Its uncertainty, of which the paper says nothing, is the scatter
of the averaged runs and what the model leaves out: discarded coefficients that repeat over all
runs, and the decay in the ends. What repeats unseen below the scatter is not in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.quantity import Quantity
from metrosep.core.runset import SAME_FEED, RunSet
from metrosep.core.units import format_ends, format_length
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import (
    LINE_POINTS,
    DirectionEstimate,
    ErrorEstimate,
    FourierCurve,
    SampledCurve,
)
from metrosep.separation.runs.design import evaluation_range
from metrosep.separation.runs.spectra import (
    Averaging,
    FeedSpectra,
    Norm,
    Taper,
    feed_spectra,
    feed_spectra_columns,
    least_squares_coefficients,
    n_wavelengths,
)
from metrosep.spectral.dft import fourier_basis

_MM, _NM = 1e-3, 1e-9


class _Weighting(TypedDict):
    taper_fraction: float
    taper: Taper


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
    averaging: Averaging = "coherent",
    ddof: int = 1,
    relative: bool = False,
    min_coherence: float = 0.0,
    coefficients: Literal["tapered", "least_squares"] = "tapered",
) -> ErrorEstimate:
    """Return the repeatable error by Kono's Fourier method, with eq. 4 as its curve.

    sd: the scatter of the runs that were averaged, the RMS of discarded waves that are seen to
    repeat, and the decay of the model in the tapered ends.
    """
    _check_choices(
        norm=norm,
        rule=rule,
        taper=taper,
        values=values,
        averaging=averaging,
        coefficients=coefficients,
    )
    chosen = SelectionRule(sigma_t, p_t, norm, rule, averaging, ddof, relative, min_coherence)
    limits = chosen.thresholds()
    origin, l_x, first, last, messages = _lengths(
        runs, start, length, modelling_length, taper_fraction
    )
    n = n_wavelengths(runs, l_x)
    weighting: _Weighting = {"taper_fraction": taper_fraction, "taper": taper}
    spectra = feed_spectra(runs, origin=origin, length=l_x, n_harmonics=n, **weighting)
    selection = select_wavelengths(spectra, l_x, chosen, shortest=shortest)
    mean, members, used = _values(spectra, values=values, feed=feed)
    if coefficients == "least_squares":
        some = _used_runs(runs, spectra, values=values, feed=feed)
        members = least_squares_coefficients(
            some, selection.kept, origin=origin, length=l_x, **weighting
        )
        mean = members.mean(axis=0)
    kept = np.where(selection.kept, mean, 0.0)[: selection.m]
    curve, slope_fourier = _kono_curve(kept, origin, l_x, first, last)
    cut, longest_cut = _cut_off(spectra, selection.kept)
    uncertainty, modes = _kono_sd(members * selection.kept, origin, l_x, (first, last))
    scatter = float(np.sqrt(np.mean(uncertainty.z**2)))
    decay = taper_fraction if coefficients == "tapered" else 0.0
    uncertainty = _with_bias(uncertainty, curve, cut, decay, (first, last))
    if cut > 0.0 and not cut < _SMALL * scatter:
        message = (
            f"waves that repeat but are not in the model, such as {format_length(longest_cut)}, have "
            f"{format_length(cut, digits=2)} RMS together: this is in the uncertainty"
        )
        messages += (message,)
    audit = {
        "n_runs": len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in runs.feeds],
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
        "sigma_t_unit": limits[2],
        "p_t_unit": limits[3],
        "averaging": averaging,
        "ddof": ddof,
        "relative": relative,
        "min_coherence": min_coherence,
        "coefficients": coefficients,
        "cut_off_rms_nm": cut / _NM,
        "uncertainty_holds": "scatter of the averaged runs, discarded waves seen to repeat (p < "
        f"{_SEEN}), decay in the tapered ends; not what repeats below the scatter",
        "rule": rule,
        "taper": taper,
        "taper_fraction": taper_fraction,
        "mean_removed_before_taper": True,
        "line_removed": "least squares over l_x before the taper, and over the evaluation range",
    }
    if members.shape[0] < 2:
        single = (
            "the values come from one run: there is no scatter to tell an uncertainty from; "
            "repeat the run, or use values='all'"
        )
        messages += (single,)
    residual = _residual(runs, curve)
    slopes = np.array(spectra.slopes)
    return ErrorEstimate(
        method="kono",
        start=first,
        stop=last,
        fit_range=(origin, origin + l_x),
        directions_data={0: DirectionEstimate(curve, uncertainty, modes=modes)},
        slope=Quantity(
            float(slopes.mean() + slope_fourier),
            "rad",
            "slope of the line removed from the runs plus that of the model over the evaluation "
            "range (alignment, eq. 1)",
            u=float(slopes.std(ddof=1) / math.sqrt(slopes.size)) if slopes.size > 1 else None,
        ),
        spectrum_data=_kono_spectrum(spectra, selection, mean, members, (first, origin, l_x)),
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
        "averaging": ("coherent", "power"),
        "coefficients": ("tapered", "least_squares"),
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
    if modelling_length is not None and not (
        math.isfinite(modelling_length) and modelling_length > 0.0
    ):
        raise DataError(f"modelling_length must be positive, in m, got {modelling_length}")
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
            f"the evaluation range {format_ends(first, last)} leaves the flat "
            f"part of the window ({format_ends(flat_low, flat_high)}): the "
            f"model decays to zero in the ends; the length of the modelling must be at least "
            f"{format_length((last - first) / flat)} around the range, it is {format_length(l_x)}"
        )
        return origin, l_x, first, last, (message,)
    return origin, l_x, first, last, ()


def _values(
    spectra: FeedSpectra, *, values: str, feed: float | None
) -> tuple[ComplexArray, ComplexArray, str]:
    if values == "all":
        members = np.concatenate(spectra.per_run)
        return members.mean(axis=0), members, f"mean of all {members.shape[0]} runs"
    index = _feed_index(spectra, feed)
    members = spectra.per_run[index]
    known = math.isfinite(spectra.feeds[index])
    where = f"at {spectra.feeds[index] * 6e4:.6g} mm/min" if known else "of unknown feed"
    text = f"mean of {members.shape[0]} run(s) {where}"
    return spectra.coefficients[index], members, text


def _feed_index(spectra: FeedSpectra, feed: float | None) -> int:
    feeds = np.array(spectra.feeds)
    if feed is not None and not (math.isfinite(feed) and feed > 0.0):
        raise DataError(f"feed must be positive and finite, in m/s, got {feed}")
    if feed is None:
        return int(feeds.size - 1) // 2
    index = int(np.argmin(np.abs(feeds - feed)))
    if abs(feeds[index] / feed - 1.0) > SAME_FEED:
        have = ", ".join(f"{f * 6e4:.6g}" for f in feeds)
        raise DataError(
            f"no runs at feed {feed * 6e4:.6g} mm/min; the set has {have} mm/min (feed is in m/s here)"
        )
    return index


def _used_runs(runs: RunSet, spectra: FeedSpectra, *, values: str, feed: float | None) -> RunSet:
    if values == "all" or not runs.feeds:
        return runs
    return runs.select(feed=spectra.feeds[_feed_index(spectra, feed)])


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
) -> tuple[SampledCurve, CovarianceModes | None]:
    n, k = members.shape
    grid = np.linspace(origin, origin + l_x, 1001)
    if n < 2:
        return SampledCurve(grid, np.full(grid.size, np.nan)), None
    basis = fourier_basis(grid, origin=origin, period=l_x, n_harmonics=k)
    curves = np.hstack([members.real, members.imag]) @ basis.T
    inner = (grid >= evaluation[0]) & (grid <= evaluation[1])
    line = np.column_stack([np.ones(grid.size), (grid - origin) / l_x])
    curves = curves - (line @ np.linalg.lstsq(line[inner], curves[:, inner].T, rcond=None)[0]).T
    apart = (curves - curves.mean(axis=0)) / math.sqrt(n * (n - 1.0))
    sd = SampledCurve(grid, np.sqrt((apart**2).sum(axis=0)))
    return sd, CovarianceModes.of(grid, apart.T)


_SEEN = 0.01
"""Chance by which the scatter of the runs would repeat as much as a wave, over all discarded ones."""

_SMALL = 0.2
"""RMS of the discarded waves over the scatter of the estimate below which they are not mentioned."""

_QUIET, _SURE = 4.0, 3.0
"""Times the median noise up to which discarded waves are looked at together; and beyond how many
standard deviations of their sum they count."""


def _cut_off(spectra: FeedSpectra, kept: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the RMS of discarded waves that repeat over all runs, and the strongest wavelength."""
    rows = np.concatenate(spectra.per_run)
    n, left = rows.shape[0], ~kept[: rows.shape[1]]
    if n < 2 or not left.any():
        return 0.0, math.nan
    mean = rows.mean(axis=0)
    noise = (
        (np.abs(rows - mean) ** 2).sum(axis=0) / (n - 1) / n
    )  # expectation of |mean|^2 in noise
    power = np.abs(mean) ** 2
    # n |mean|^2 / variance follows F(2, 2 (n - 1)): p = (1 + F / (n - 1))^-(n - 1)
    floor = np.finfo(float).tiny
    p = (1.0 + power / np.maximum(noise, floor) / (n - 1)) ** (1.0 - n)
    seen = left & (p < _SEEN / left.sum())
    total = float((power - noise)[seen].sum())
    # Many waves, none of which is seen by itself; a vibration of few runs would pass for some.
    rest = left & ~seen & (noise < _QUIET * float(np.median(noise[left])))
    together = float((power - noise)[rest].sum())
    if together > _SURE * math.sqrt(n / (n - 1.0) * float((noise[rest] ** 2).sum())):
        total += together
    if total <= (1e-6 * spectra.mean_weight) ** 2 * float(power.sum()):
        return 0.0, math.nan
    strongest = float(spectra.wavelength[int(np.argmax(np.where(left, power - noise, -1.0)))])
    return math.sqrt(0.5 * total / spectra.mean_square_weight), strongest  # Parseval


def _with_bias(
    sd: SampledCurve,
    curve: FourierCurve,
    cut: float,
    taper_fraction: float,
    evaluation: tuple[float, float],
) -> SampledCurve:
    """Return sd with the waves that were cut off and the decay (1 - f) of the model in the ends."""
    x = np.linspace(*evaluation, LINE_POINTS)
    size = float(np.sqrt(np.mean(curve(x) ** 2)))
    place = (sd.x - sd.x[0]) / (sd.x[-1] - sd.x[0])
    ramp = (
        np.minimum(place, 1.0 - place) / taper_fraction if taper_fraction else np.ones(sd.x.size)
    )
    lost = 0.5 * (1.0 + np.cos(np.pi * np.clip(ramp, 0.0, 1.0)))  # 1 - f
    return SampledCurve(sd.x, np.sqrt(sd.z**2 + cut**2 + (lost * size) ** 2))


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
    selection: WavelengthSelection,
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


# ---- kono's rule: which wavelengths repeat over the feedrates ----------------------------------
# The shortest wavelength with sigma < sigma_t and mean P > p_t; the paper states neither unit nor
# normalisation of P, so both are options, and so is what else the rule leaves open.
#
# Source: Kono et al. 2008, section 2.3.

Rule = Literal["shortest", "contiguous", "mask"]

_UM, _SELECTION_MM = 1e-6, 1e-3
_THRESHOLDS = {
    "amplitude": (0.05 * _UM, 0.01 * _UM, "m"),
    "power": (0.05 * _UM**2, 0.01 * _UM**2, "m2"),
    "psd": (0.05 * _UM**2 * _SELECTION_MM, 0.01 * _UM**2 * _SELECTION_MM, "m3"),
}
"""The paper's 0.05 and 0.01, read in um, um^2 or um^2 mm: sigma_t, p_t, SI unit."""


@dataclass(frozen=True, slots=True)
class SelectionRule:
    """Thresholds and choices of the rule."""

    sigma_t: float | None = None  # thresholds in SI; the paper's if None
    p_t: float | None = None
    norm: Norm = "amplitude"  # {"amplitude", "power", "psd"}: normalisation of P
    rule: Rule = "shortest"  # {"shortest", "contiguous", "mask"}: what is kept
    # {"coherent", "power"}: order of averaging over the runs of one feedrate
    averaging: Averaging = "coherent"
    ddof: int = 1  # {1, 0}: sample or population standard deviation over feedrates
    relative: bool = False  # whether sigma is divided by the mean (sigma_t is then a number)
    # least coherence over feedrates, 0 to 1; 0 ignores phase as the paper does
    min_coherence: float = 0.0

    def __post_init__(self) -> None:
        if self.ddof not in (0, 1):
            raise DataError(f"ddof must be 1 (sample) or 0 (population), got {self.ddof}")
        if not 0.0 <= self.min_coherence <= 1.0:
            raise DataError(f"min_coherence must be in [0, 1], got {self.min_coherence}")

    def thresholds(self) -> tuple[float, float, str, str]:
        """Return sigma_t, p_t and the units of both."""
        default_sigma, default_p, unit = _THRESHOLDS[self.norm]
        sigma_unit = "1" if self.relative else unit
        default_sigma = 0.05 if self.relative else default_sigma
        for name, value, default, unit_name in (
            ("sigma_t", self.sigma_t, default_sigma, sigma_unit),
            ("p_t", self.p_t, default_p, unit),
        ):
            if value is not None and not 0.0 <= value < 1e3 * default:
                raise UnitError(
                    f"{name} is {value} {unit_name}; it is in SI here, so the paper's default is "
                    f"{default:.3g} {unit_name}"
                )
        sigma = default_sigma if self.sigma_t is None else float(self.sigma_t)
        return sigma, default_p if self.p_t is None else float(self.p_t), sigma_unit, unit


@dataclass(frozen=True, slots=True, eq=False)
class WavelengthSelection:
    """Harmonics that are kept, and why."""

    kept: NDArray[np.bool_]  # shape (K,): in the model; through the thresholds
    passed: NDArray[np.bool_]
    mean: FloatArray  # shape (K,): mean and standard deviation of P over feedrates
    sigma: FloatArray
    m: int  # highest harmonic of the model
    reasons: list[str]  # one for each wavelength


def select_wavelengths(
    spectra: FeedSpectra, length: float, rule: SelectionRule, *, shortest: float | None = None
) -> WavelengthSelection:
    """Return the harmonics that the rule keeps."""
    power = spectra.power(rule.norm, length, averaging=rule.averaging)
    sigma_t, p_t, sigma_unit, unit = rule.thresholds()
    mean = power.mean(axis=0)
    n, several = mean.size, power.shape[0] > 1
    sigma = power.std(axis=0, ddof=rule.ddof) if several else np.full(n, np.nan)
    if rule.relative:
        sigma = np.divide(sigma, mean, out=np.full(n, np.inf), where=mean > 0.0)
    coherent = spectra.coherence >= rule.min_coherence
    passed = (sigma < sigma_t) & (mean > p_t) & coherent
    if shortest is not None:
        usable = math.isfinite(shortest) and shortest > 0.0
        m = math.floor(length / shortest * (1.0 + 1e-9)) if usable else 0
        if not 1 <= m <= n:
            raise UnitError(
                f"shortest is {format_length(shortest)}; it must lie between "
                f"{format_length(length / n)} and {format_length(length)}; it is in metres: 4 mm is 4e-3"
            )
        kept = np.arange(n) < m
        reasons = ["set by hand" if k else "shorter than the one set by hand" for k in kept]
        return WavelengthSelection(kept, passed, mean, sigma, m, reasons)
    if not several:
        raise NotSeparableError(
            "the rule of repeatability over feedrates needs runs at >= 2 feedrates, got "
            f"{power.shape[0]}; add runs at another feedrate or set the shortest wavelength by hand"
        )
    if not passed.any():
        raise NotSeparableError(
            f"no wavelength has sigma < {sigma_t:.3g} {sigma_unit} and mean P > {p_t:.3g} {unit} (norm "
            f"{rule.norm!r}; largest mean P is {mean.max():.3g} {unit}); relax sigma_t or p_t, or set "
            "the shortest wavelength by hand"
        )
    kept, m = _kept(passed, rule.rule)
    reasons = [
        ("passes" if passed[k] else "longer than the selected one")
        if kept[k]
        else _why_not(sigma[k] < sigma_t, mean[k] > p_t, coherent[k])
        for k in range(n)
    ]
    return WavelengthSelection(kept, passed, mean, sigma, m, reasons)


def _kept(passed: NDArray[np.bool_], rule: Rule) -> tuple[NDArray[np.bool_], int]:
    n = passed.size
    if rule == "contiguous":
        m = n if passed.all() else int(np.argmin(passed))
        if m == 0:
            raise (
                NotSeparableError(
                    "the longest wavelength already fails the thresholds, so the contiguous band is "
                    "empty; use rule='mask' or rule='shortest'"
                )
                .hinting(rule="mask")
                .hinting(rule="shortest")
            )
        return np.arange(n) < m, m
    m = int(np.flatnonzero(passed)[-1]) + 1
    return (passed if rule == "mask" else np.arange(n) < m), m


def _why_not(steady: bool, strong: bool, coherent: bool) -> str:
    parts = [
        text
        for text, fine in (
            ("sigma too large", steady),
            ("P too small", strong),
            ("phase does not repeat", coherent),
        )
        if not fine
    ]
    return " and ".join(parts) or "shorter than the band"
