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
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, cast

import numpy as np

from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.false_discovery import benjamini_hochberg
from metrosep.core.quantity import Quantity
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length
from metrosep.separation._checked_numbers import checked_count, checked_number
from metrosep.separation._joint_curves import joint_curves
from metrosep.separation._joint_evidence import contradictions, evidence_of
from metrosep.separation._joint_tables import joint_audit, residual_psd_columns, spectrum_columns
from metrosep.separation.base import DirectionEstimate, ErrorEstimate
from metrosep.separation.design import PreparedRun, evaluation_range, prepare_runs
from metrosep.separation.explain import (
    explain_band,
    explain_disturbances,
    explain_lag,
    explain_resolution,
)
from metrosep.separation.options import Following, JointOptions, metres
from metrosep.separation.run_probes import probe_names
from metrosep.separation.solver import Solution, solve_joint
from metrosep.separation.spectra import feed_spectra_columns
from metrosep.separation.term_curves import check_lines, feed_curves, report_terms
from metrosep.separation.term_hints import hint_options

__all__ = ["benjamini_hochberg", "separate_joint"]


_PERIOD_SHARE = 1.25
"""Longest wavelength of the basis over the travel: the error need not close on itself."""

_SAMPLES_PER_WAVE = 2.5
"""Shortest wavelength that is considered, in pitches of the coarsest run."""

_MAX_HARMONICS = 250
_NM = 1e-9

_SLOPE_WITH_DRIFT = (
    "; it holds the drift that is common to all runs, which one feedrate cannot tell from it, so it "
    "has no uncertainty"
)


def separate_joint(
    runs: RunSet,
    *,
    length: float | None = None,
    start: float | None = None,
    shortest: float | None = None,
    lag: float | Literal["auto", "fit"] = "auto",
    min_feeds: int = 2,
    false_discovery_rate: float = 0.05,
    drift: int = 0,
    lines: Literal["auto"] | Sequence[float] = (),
    line_phase: Literal["free", "locked"] = "free",
    false_alarm: float = 0.001,
    robust: bool = False,
    following: Following = "off",
    following_waves: int | Sequence[float] = 3,
    probes: Sequence[str] | None = None,
    probe_gain: Literal["equal", "fit"] = "equal",
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
    lag : float, "auto" or "fit", s, optional
        Delay of the reading against the position, positive when the reading is late. It is tested
        for in every fit of two feedrates: "auto" corrects it as far as the readings show one, a
        number is kept and what is found beside it is said, "fit" fits it in any case.
    min_feeds : int, optional
        Feedrates that must be there; 1 accepts that random vibration is only averaged.
    false_discovery_rate : float, optional
        For the column ``selected`` of the spectrum.
    drift : {0, 1, 2}, optional
        Degree of a polynomial in time that each run has for itself.
    lines : "auto" or sequence of float, Hz, optional
        Deterministic lines to remove; "auto" looks for them.
    line_phase : {"free", "locked"}, optional
        Whether each run has its own amplitude and phase, or all share them from their start.
    false_alarm : float, optional
        Chance that "auto" finds a line where there is none.
    robust : bool, optional
        Whether spikes, dropouts and bad stretches lose their weight.
    following : {"off", "offset", "scale", "waves"}, optional
        What grows with the feedrate: the offset, the whole error, or single waves of it.
    following_waves : int or sequence of float, m, optional
        How many of the strongest wavelengths grow with the feedrate, or which.
    probes : sequence of str, optional
        Name of the probe of each run; ``metadata["probe"]`` of the runs if omitted.
    probe_gain : {"equal", "fit"}, optional
        Whether the probes have the sensitivity of the first, or their own.

    Returns
    -------
    ErrorEstimate
        With a Fourier curve.

    Raises
    ------
    DataError
        If a number is text, `false_discovery_rate` or an option is out of range, or the names of the probes do not
        fit the runs.
    NotSeparableError
        If there are fewer feedrates than `min_feeds`, or lag, feed-dependent part or sensitivity
        cannot be told apart with these runs.
    UnitError
        If `shortest`, `lag`, a line or a wavelength cannot be meant in SI.
    InvalidSamplesError, NotUniformError, TooFewSamplesError
        If the runs have no usable time, cover different travels or are too short.
    """
    share = "a share between 0 and 1, such as 0.05 for 5 %"
    if not 0.0 < checked_number(false_discovery_rate, "false_discovery_rate", share) < 1.0:
        raise DataError(
            f"false_discovery_rate must be in (0, 1), got {false_discovery_rate}; 5 % is 0.05"
        )
    options = JointOptions(
        drift=drift,
        lines=cast("Any", lines),
        line_phase=line_phase,
        false_alarm=false_alarm,
        robust=robust,
        following=following,
        following_waves=cast("Any", following_waves),
        probe_gain=probe_gain,
    )
    start, length, shortest = (
        metres(value, name)
        for value, name in ((start, "start"), (length, "length"), (shortest, "shortest"))
    )
    min_feeds = checked_count(min_feeds, "min_feeds")
    _check_feeds(runs, min_feeds=min_feeds, fit_lag=lag == "fit")
    names = probe_names(runs, probes)
    n_feeds, n_probes = len(runs.feeds), len(set(names))
    way = " and ".join("forward" if d > 0 else "reverse" for d in runs.directions)
    options.check_runs(n_feeds, n_probes, fit_lag=lag == "fit", way=way)
    first, last = evaluation_range(runs, start=start, length=length)
    prepared = prepare_runs(runs, probes=names)
    check_lines(options, prepared)
    low, high = runs.full_travel
    period = _PERIOD_SHARE * (high - low)
    options.check_waves(period)
    n_harmonics, limit = _n_harmonics(prepared, period=period, shortest=shortest)
    start_lag = 0.0 if lag in ("auto", "fit") else _checked_lag(lag)
    mode: Literal["stated", "auto", "fit"] = "stated"
    if isinstance(lag, str):
        mode = "fit" if lag == "fit" else "auto"
    solution = solve_joint(
        prepared,
        origin=first,
        period=period,
        n_harmonics=n_harmonics,
        choose_shortest=shortest is None,
        lag=start_lag,
        lag_mode=mode,
        options=options,
        several_feeds=n_feeds > 1,
    )
    terms, sentences = report_terms(solution, prepared, runs, options)
    curve, uncertainty, slope, level = joint_curves(solution, (first, last), (low, high))
    if options.drift and n_feeds < 2:
        slope = Quantity(slope.value, slope.unit, slope.definition + _SLOPE_WITH_DRIFT)
    spectrum = spectrum_columns(solution, runs, rate=false_discovery_rate)
    messages = (
        *explain_resolution(
            solution,
            limit=limit,
            travel=high - low,
            runs=runs,
            n_selected=sum(spectrum["selected"]),
        ),
        *explain_lag(solution, mode=mode, n_selected=sum(spectrum["selected"])),
        *explain_disturbances(solution, runs, spectrum),
        *sentences,
        *hint_options(solution, prepared, options),
    )
    audit = joint_audit(runs, prepared, solution, shortest, false_discovery_rate)
    if options != JointOptions() or n_probes > 1:
        audit["options"] = options.as_dict()
        audit["run_levels_nm"] = ((solution.offsets + level) / _NM).tolist()
    evidence, audit["evidence"], unsteady = evidence_of(
        runs, names, start=first, stop=last, rate=false_discovery_rate
    )
    known = uncertainty.z[~np.isnan(uncertainty.z)]
    band = float(np.sqrt(np.mean(known**2)))
    messages = (
        *messages,
        *unsteady,
        *(
            []
            if unsteady
            else contradictions(spectrum, evidence, curve, span=(first, last), noise_nm=band / _NM)
        ),
        *explain_band(
            solution, band=band, plain=_plain_band(solution, (first, last), (low, high))
        ),
    )
    feed_term = feed_curves(solution, options, (first, last), (low, high))
    residual = np.concatenate(solution.kept_residuals)
    return ErrorEstimate(
        method="joint",
        start=first,
        stop=last,
        fit_range=(low, high),
        directions_data={0: DirectionEstimate(curve, uncertainty, feed_term)},
        slope=slope,
        spectrum_data=spectrum,
        feed_spectra_data=feed_spectra_columns(runs),
        residual_psd_data=residual_psd_columns(prepared, solution),
        residual_rms=float(np.sqrt(np.nanmean(residual**2))),
        lag=solution.lag,
        lag_sd=solution.lag_sd,
        audit=audit,
        messages=messages,
        history=runs.history,
        terms=terms,
        evidence_data=evidence,
    )


def _plain_band(
    solution: Solution, evaluation: tuple[float, float], travel: tuple[float, float]
) -> float:
    """Return the RMS uncertainty without what the uncertain prior adds."""
    plain = replace(solution, covariance=solution.plain_covariance)
    u = joint_curves(plain, evaluation, travel)[1].z
    return float(np.sqrt(np.nanmean(u**2)))


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


def _checked_lag(lag: Any) -> float:
    if isinstance(lag, bool) or not isinstance(lag, int | float | np.number):
        raise DataError(f"lag is a number in seconds, 'auto' or 'fit', got {lag!r}; 1 ms is 1e-3")
    value = float(lag)
    if not math.isfinite(value) or abs(value) > 1.0:
        raise UnitError(f"lag is {value} s; it must be finite and below 1 s: 1 ms is 1e-3")
    return value


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
