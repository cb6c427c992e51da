"""The joint separator: all runs at all feedrates in one generalised least-squares estimate.

Geometry repeats in position, vibration repeats in frequency; runs at several feedrates tell them
apart. The solver is in `metrosep.separation.solver`, the learnt prior in
`metrosep.separation.shrinkage`; this module states the question and words the answer.

What it cannot see: anything common to all feeds and tied to position is geometry to it (the
artefact's own form, pitch of the screw's balls synchronous with position, a temperature that
follows position); the offset of each run; the alignment slope is reported apart.

Source: specified in the project's separation notes; baseline motion-error-fourier (Kono 2008).
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.quantity import Quantity
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length
from metrosep.separation.base import DirectionEstimate, ErrorEstimate
from metrosep.separation.curves import LINE_POINTS, FourierCurve, SampledCurve
from metrosep.separation.design import PreparedRun, evaluation_range, prepare_runs
from metrosep.separation.explain import explain_disturbances, explain_lag, explain_resolution
from metrosep.separation.solver import Solution, solve_joint
from metrosep.separation.spectra import feed_spectra_columns
from metrosep.spectral.dft import fourier_basis
from metrosep.spectral.psd import pooled_periodogram

__all__ = ["benjamini_hochberg", "separate_joint"]

FloatArray = NDArray[np.float64]

_PERIOD_SHARE = 1.25
"""Longest wavelength of the basis over the travel: the error need not close on itself."""

_SAMPLES_PER_WAVE = 2.5
"""Shortest wavelength that is considered, in pitches of the coarsest run."""

_MAX_HARMONICS = 250

_SHORTEST_SEGMENT = 16
"""Samples without a gap from which a spectrum of the residual is taken."""


_NM = 1e-9
_MM = 1e-3


def benjamini_hochberg(p_values: FloatArray, *, rate: float) -> NDArray[np.bool_]:
    """Return which hypotheses are rejected at a false discovery rate.

    Parameters
    ----------
    p_values : ndarray, shape (n,)
        One for each hypothesis.
    rate : float
        Expected share of false ones among the rejected, 0 < rate < 1.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where rejected.

    References
    ----------
    .. [1] Benjamini and Hochberg 1995.

    Examples
    --------
    >>> import numpy as np
    >>> benjamini_hochberg(np.array([0.001, 0.2, 0.03, 0.9]), rate=0.05).tolist()
    [True, False, False, False]
    """
    order = np.argsort(p_values)
    n = p_values.size
    passed = np.flatnonzero(p_values[order] <= rate * np.arange(1, n + 1) / n)
    rejected = np.zeros(n, dtype=bool)
    if passed.size:
        rejected[order[: passed[-1] + 1]] = True
    return rejected


def separate_joint(
    runs: RunSet,
    *,
    length: float | None = None,
    start: float | None = None,
    shortest: float | None = None,
    lag: float | Literal["fit"] = 0.0,
    min_feeds: int = 2,
    false_discovery_rate: float = 0.05,
) -> ErrorEstimate:
    """Return the repeatable error of one direction of travel by joint least squares.

    Parameters
    ----------
    runs : RunSet
        Runs of one direction, with time.
    length, start : float, m, optional
        Evaluation range; the common travel if omitted.
    shortest : float, m, optional
        Shortest wavelength of the model; chosen by evidence if omitted.
    lag : float or "fit", s, optional
        Delay of the reading against the position, positive when the reading is late.
    min_feeds : int, optional
        Feedrates that must be there; 1 accepts that random vibration is only averaged.
    false_discovery_rate : float, optional
        For the column ``selected`` of the spectrum.

    Returns
    -------
    ErrorEstimate
        With a Fourier curve.

    Raises
    ------
    DataError
        If `false_discovery_rate` is out of range.
    NotSeparableError
        If there are fewer feedrates than `min_feeds`, or the lag is to be fitted from one.
    UnitError
        If `shortest` or `lag` cannot be meant in SI.
    InvalidSamplesError, NotUniformError, TooFewSamplesError
        If the runs have no usable time, cover different travels or are too short.
    """
    if not 0.0 < false_discovery_rate < 1.0:
        raise DataError(
            f"false_discovery_rate must be in (0, 1), got {false_discovery_rate}; 5 % is 0.05"
        )
    _check_feeds(runs, min_feeds=min_feeds, fit_lag=lag == "fit")
    first, last = evaluation_range(runs, start=start, length=length)
    prepared = prepare_runs(runs)
    low, high = runs.full_travel
    period = _PERIOD_SHARE * (high - low)
    n_harmonics, limit = _n_harmonics(prepared, period=period, shortest=shortest)
    start_lag = 0.0 if lag == "fit" else _checked_lag(float(lag))
    solution = solve_joint(
        prepared,
        origin=first,
        period=period,
        n_harmonics=n_harmonics,
        choose_shortest=shortest is None,
        lag=start_lag,
        fit_lag=lag == "fit",
    )
    curve, uncertainty, slope = _curves(solution, (first, last), (low, high))
    spectrum = _spectrum_columns(solution, rate=false_discovery_rate)
    messages = (
        *explain_resolution(
            solution,
            limit=limit,
            travel=high - low,
            runs=runs,
            n_selected=sum(spectrum["selected"]),
        ),
        *explain_lag(solution, fitted=lag == "fit", n_selected=sum(spectrum["selected"])),
        *explain_disturbances(solution, runs, spectrum),
    )
    residual = np.concatenate(solution.residuals)
    return ErrorEstimate(
        method="joint",
        start=first,
        stop=last,
        fit_range=(low, high),
        directions_data={0: DirectionEstimate(curve, uncertainty)},
        slope=slope,
        spectrum_data=spectrum,
        feed_spectra_data=feed_spectra_columns(runs),
        residual_psd_data=_residual_psd_columns(prepared, solution),
        residual_rms=float(np.sqrt(np.nanmean(residual**2))),
        lag=solution.lag,
        lag_sd=solution.lag_sd,
        audit=_audit(runs, prepared, solution, shortest, false_discovery_rate),
        messages=messages,
        history=runs.history,
    )


def _check_feeds(runs: RunSet, *, min_feeds: int, fit_lag: bool) -> None:
    feeds = runs.feeds
    have = ", ".join(f"{f * 6e4:.6g} mm/min" for f in feeds) or "no feedrate"
    way = " and ".join("forward" if d > 0 else "reverse" for d in runs.directions)
    if not feeds and min_feeds > 0:
        raise NotSeparableError(
            f"the {way} runs have no feedrate and no time; the joint method needs time to tell "
            "vibration from geometry: give a time column, the sampling rate or the feed of each "
            "run (or use method='mean')"
        )
    if len(feeds) < min_feeds:
        raise NotSeparableError(
            f"the {way} runs have {len(feeds)} feedrate(s) ({have}), the separation needs {min_feeds}: a "
            "vibration and a geometric error of the same wavelength look alike at one feedrate; "
            "add runs at another feedrate, or accept averaging with method='mean' or min_feeds=1"
        )
    if fit_lag and len(feeds) < 2:
        raise NotSeparableError(
            f"the lag cannot be fitted from one feedrate ({have}): it only shifts the error along "
            "the axis; add runs at another feedrate or state the lag"
        )


def _checked_lag(lag: float) -> float:
    if not math.isfinite(lag) or abs(lag) > 1.0:
        raise UnitError(f"lag is {lag} s; it must be finite and below 1 s: 1 ms is 1e-3")
    return lag


def _n_harmonics(
    runs: list[PreparedRun], *, period: float, shortest: float | None
) -> tuple[int, str]:
    pitch = max(float(np.ptp(r.x)) / max(r.x.size - 1, 1) for r in runs)
    rows = sum(int((~np.isnan(r.z)).sum()) for r in runs)
    by_data = max(int(rows / 6 - len(runs)) // 2, 4)
    floor = _SAMPLES_PER_WAVE * pitch
    if shortest is not None:
        if not floor <= shortest <= period:
            raise UnitError(
                f"shortest is {format_length(shortest)}; it must lie between "
                f"{format_length(floor)} (2.5 sample pitches) and {format_length(period)}; it is in "
                "metres: 1.2 mm is 1.2e-3"
            )
        wanted = int(period / shortest * (1.0 + 1e-12))
        return min(wanted, by_data), "stated" if wanted <= by_data else "data"
    by_pitch = int(period / floor)
    return min(by_pitch, by_data, _MAX_HARMONICS), (
        "cost" if by_pitch > _MAX_HARMONICS else "sampling"
    )


def _curves(
    solution: Solution, evaluation: tuple[float, float], travel: tuple[float, float]
) -> tuple[FourierCurve, SampledCurve, Quantity]:
    """Take the line over the evaluation range out of curve, covariance and slope."""
    k = solution.n_harmonics
    step = solution.period / max(k, 8) / 8.0
    n_grid = int(np.clip(np.ceil((travel[1] - travel[0]) / step), 200, 4000)) + 1
    grid = np.linspace(travel[0], travel[1], n_grid)
    inner = np.linspace(evaluation[0], evaluation[1], LINE_POINTS)

    def functions(x: FloatArray) -> FloatArray:
        waves = fourier_basis(x, origin=solution.origin, period=solution.period, n_harmonics=k)
        return np.column_stack([x - solution.centre, waves])

    mid, half = np.mean(evaluation), (evaluation[1] - evaluation[0]) / 2.0
    line = np.column_stack([np.ones(inner.size), (inner - mid) / half])
    to_line = np.linalg.lstsq(line, functions(inner), rcond=None)[0]
    projected = functions(grid) - np.column_stack([np.ones(n_grid), (grid - mid) / half]) @ to_line
    variance = np.einsum("ij,jk,ik->i", projected, solution.covariance, projected)
    offset, slope_half = to_line @ solution.coefficients
    slope_variance = float(to_line[1] @ solution.covariance @ to_line[1]) / half**2
    slope = float(slope_half / half)
    rest = solution.coefficients[0] - slope
    curve = FourierCurve(
        origin=solution.origin,
        period=solution.period,
        cosine=solution.coefficients[1 : k + 1].copy(),
        sine=solution.coefficients[k + 1 :].copy(),
        offset=float(
            rest * (solution.origin - solution.centre) - offset + slope * (mid - solution.centre)
        ),
        slope=float(rest),
        travel=travel,
    )
    alignment = Quantity(
        slope,
        "rad",
        "slope of the least-squares line over the evaluation range (alignment of artefact and "
        "axis, or squareness); removed from the estimate",
        u=math.sqrt(max(slope_variance, 0.0)),
    )
    return curve, SampledCurve(grid, np.sqrt(np.maximum(variance, 0.0))), alignment


def _spectrum_columns(solution: Solution, *, rate: float) -> dict[str, list[Any]]:
    n_all, kept = solution.amplitude.size, solution.n_harmonics
    k = np.arange(1, n_all + 1)
    cosine, sine = np.zeros(n_all), np.zeros(n_all)
    cosine[:kept] = solution.coefficients[1 : kept + 1]
    sine[:kept] = solution.coefficients[kept + 1 :]
    p_values = np.exp(-solution.chi2 / 2.0)
    selected = benjamini_hochberg(p_values, rate=rate)
    selected[kept:] = False
    reasons = [
        "repeats at all feedrates"
        if chosen
        else ("no evidence at this wavelength or shorter" if i >= kept else "within the noise")
        for i, chosen in enumerate(selected)
    ]
    amplitude = np.hypot(cosine, sine)
    amplitude[kept:] = 0.0
    return {
        "wavelength_mm": (solution.period / k / _MM).tolist(),
        "amplitude_nm": (amplitude / _NM).tolist(),
        "phase_rad": (-np.arctan2(sine, cosine)).tolist(),
        "sd_nm": (solution.amplitude_sd / _NM).tolist(),
        "snr": (solution.amplitude / solution.amplitude_sd).tolist(),
        "p": p_values.tolist(),
        "selected": [bool(s) for s in selected],
        "reason": reasons,
    }


def _residual_psd_columns(runs: list[PreparedRun], solution: Solution) -> dict[str, list[Any]]:
    """Take the sampling interval that most samples have; other intervals are in the audit."""
    steps = [m.time_step for m in solution.noise]
    owner = [int(np.argmin([abs(r.time_step - s) for s in steps])) for r in runs]
    sizes = [
        sum(r.x.size for r, o in zip(runs, owner, strict=True) if o == g)
        for g in range(len(steps))
    ]
    group = int(np.argmax(sizes))
    model = solution.noise[group]
    records = [r for r, o in zip(solution.residuals, owner, strict=True) if o == group]
    size = _unbroken_segment(records)
    if size < _SHORTEST_SEGMENT:  # an estimate must not fail for want of a picture
        return {"frequency_hz": [], "psd_nm2_per_hz": [], "model_nm2_per_hz": []}
    frequency, density = pooled_periodogram(records, time_step=model.time_step, n_fft=size)
    return {
        "frequency_hz": frequency.tolist(),
        "psd_nm2_per_hz": (density / _NM**2).tolist(),
        "model_nm2_per_hz": (model.psd(frequency) / _NM**2).tolist(),
    }


def _unbroken_segment(records: list[FloatArray]) -> int:
    """Return the usual length of a segment, or the longest run of samples without a NaN."""
    longest = 0
    for record in records:
        gaps = np.flatnonzero(np.isnan(np.concatenate([[np.nan], record, [np.nan]])))
        longest = max(longest, int(np.diff(gaps).max()) - 1)
    usual = min(*(r.size for r in records), 1024)
    # Segments start at multiples of half their length: 2/3 of a stretch always holds a whole one.
    return usual if all(not np.isnan(r).any() for r in records) else min(usual, 2 * longest // 3)


def _audit(
    runs: RunSet,
    prepared: list[PreparedRun],
    solution: Solution,
    shortest: float | None,
    rate: float,
) -> dict[str, Any]:
    return {
        "n_runs": len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in runs.feeds],
        "n_samples": sum(len(r) for r in runs),
        "n_not_measured": sum(r.n_invalid for r in runs),
        "averaged_samples": max(r.block for r in prepared),
        "basis_period_mm": solution.period / _MM,
        "shortest_wavelength_mm": solution.period / solution.n_harmonics / _MM,
        "shortest_wavelength_chosen_by": "user" if shortest is not None else "evidence",
        "shortest_wavelength_considered_mm": solution.period / solution.amplitude.size / _MM,
        "noise_model": [
            {
                "time_step_ms": m.time_step * 1e3,
                "order": m.order,
                "innovation_nm": math.sqrt(m.variance) / _NM,
            }
            for m in solution.noise
        ],
        "noise_order_chosen_by": "AICc",
        "effective_parameters": solution.freedom,
        "false_discovery_rate": rate,
        "line_removed": "least squares over the evaluation range",
        "run_offsets_nm": (solution.offsets / _NM).tolist(),
    }
