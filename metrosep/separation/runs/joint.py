"""The joint separator: all runs at all feedrates in one generalised least-squares estimate.

Geometry repeats in position, vibration repeats in frequency; runs at several feedrates tell them
apart. The model is solved in `metrosep.separation.runs.solver`; this module states the question
and words the answer.

What it cannot see: anything common to all feeds and tied to position is geometry to it (the
artefact's own form, pitch of the screw's balls synchronous with position, a temperature that
follows position); the offset of each run; the alignment slope is reported apart.

Source: specified in the project's notes (separation-2); baseline motion-error-fourier (Kono 2008).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, benjamini_hochberg
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.numbers import real
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.core.units import format_ends, format_length
from metrosep.separation._readings import checked_count
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import (
    LINE_POINTS,
    DirectionEstimate,
    ErrorEstimate,
    FourierCurve,
    SampledCurve,
)
from metrosep.separation.runs.design import (
    PreparedRun,
    evaluation_range,
    in_parts,
    measured_pitch,
    prepare_runs,
    probe_names,
    require_tied,
    thin_parts,
)
from metrosep.separation.runs.evidence import (
    evidence_table,
    explain_band,
    explain_displacement,
    explain_disturbances,
    explain_lag,
    explain_resolution,
    explain_slip,
)
from metrosep.separation.runs.geometry import HELD_SHARE, PERIOD_SHARE
from metrosep.separation.runs.leave_out import suspicion
from metrosep.separation.runs.lines import (
    PositionOffsets,
    check_reference,
    explain_positions,
    fitted_positions,
    position_columns,
)
from metrosep.separation.runs.noise import MOST
from metrosep.separation.runs.options import Following, JointOptions, metres
from metrosep.separation.runs.solver import CONSTANTS, Solution, solve_joint
from metrosep.separation.runs.spectra import feed_spectra, feed_spectra_columns
from metrosep.separation.runs.term_curves import check_lines, feed_curves, report_terms
from metrosep.spectral.density import pooled_periodogram
from metrosep.spectral.dft import fourier_basis

_SAMPLES_PER_WAVE = 2.5
"""Shortest wavelength that is considered, in pitches of the coarsest run."""

_MAX_HARMONICS = 220
_NM = 1e-9

_SEEN = 5.0
"""Standard uncertainties from which the curve is not called nothing, whatever its single waves are."""

_PARTS = (
    "no run covers the evaluation range: it was measured part by part, so each run has a line of its "
    "own (drift=1)"
)

_SLOPE_OF_PARTS = (
    "; each part was set up with a slope of its own and no reading tells which is the axis's, so it "
    "has no uncertainty"
)

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
    waves: Sequence[float] = (),
    slip: Literal["geometry", "sparse"] = "geometry",
    position_offsets: bool = False,
    position_reference: str = "",
    named: Sequence[int] = (),
) -> ErrorEstimate:
    """Return the repeatable error of one direction by joint least squares; options: `RUN_OPTIONS`.

    `named` are the runs in which a check has found a fault.
    """
    share = "a share between 0 and 1, such as 0.05 for 5 %"
    if not 0.0 < real(false_discovery_rate, "false_discovery_rate", what=share) < 1.0:
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
        waves=cast("Any", waves),
        slip=slip,
        position_offsets=position_offsets,
        position_reference=position_reference,
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
    first, last = evaluation_range(runs, start=start, length=length, method="joint")
    lines_of_parts = False
    parts = in_parts(runs, first, last)
    if parts:
        require_tied(runs)
        # Parts are set up anew, each with its slope; with one for all the error bends at each joint.
        lines_of_parts = not options.drift
        options = replace(options, drift=options.drift or 1)
    prepared = prepare_runs(runs, probes=names)
    if options.position_offsets:
        check_reference([r.run_id for r in prepared], options.position_reference, way)
    check_lines(options, prepared)
    low, high = runs.full_travel
    period = PERIOD_SHARE * (high - low)
    n_harmonics, limit = _n_harmonics(prepared, period=period, shortest=shortest)
    options.check_waves(period)
    start_lag = 0.0 if lag in ("auto", "fit") else _checked_lag(lag)
    mode: Literal["stated", "auto", "fit"] = "stated"
    if isinstance(lag, str):
        mode = "fit" if lag == "fit" else "auto"
    evidence, how, unsteady = evidence_of(
        runs, names, over=(first, last), rate=false_discovery_rate
    )
    solve = partial(
        solve_joint,
        travel=(low, high),
        origin=first,
        n_harmonics=n_harmonics,
        lag=start_lag,
        lag_mode="stated" if options.position_offsets else mode,
        options=options,
        several_feeds=n_feeds > 1 and not options.position_offsets,
        set_up_anew=parts,
        named=named,
    )
    solution, prepared, offsets = _at_their_places(prepared, solve, options)
    terms, sentences = report_terms(solution, prepared, runs, options)
    part, slope, level, plain = joint_curves(solution, (first, last), (low, high))
    curve, uncertainty = part.error, part.uncertainty
    if parts:
        slope = Quantity(slope.value, slope.unit, slope.definition + _SLOPE_OF_PARTS)
    elif options.drift and n_feeds < 2:
        slope = Quantity(slope.value, slope.unit, slope.definition + _SLOPE_WITH_DRIFT)
    spectrum = spectrum_columns(solution, runs, rate=false_discovery_rate)
    # A curve of few long waves may stand far out of its band where no single one does.
    inside = (uncertainty.x >= first) & (uncertainty.x <= last)
    beyond = np.abs(curve(uncertainty.x[inside])) > _SEEN * uncertainty.z[inside]
    n_selected = sum(spectrum["selected"]) or int(beyond.any())
    messages = (
        *explain_resolution(
            solution,
            limit=limit,
            travel=high - low,
            runs=runs,
            n_selected=n_selected,
        ),
        *explain_lag(solution, mode=mode, n_selected=n_selected),
        *explain_disturbances(
            solution, runs, spectrum, _by_noise(prepared, solution, solution.bridged)
        ),
        *explain_slip(solution, sparse=slip == "sparse", placed=options.position_offsets),
        *explain_displacement(solution),
        *explain_positions(
            [r.run_id for r in prepared],
            offsets,
            options.position_reference,
            delay=n_feeds > 1,
            nothing=n_selected == 0,
        ),
        *([_PARTS] if lines_of_parts else []),
        *_thin(runs, first, last),
        *options.unheld_waves(
            (period / n_harmonics / HELD_SHARE, high - low),
            [measured_pitch(r) for r in prepared],
            sampled=limit in ("sampling", "data"),
        ),
        *sentences,
        *hint_options(solution, prepared, options),
    )
    audit = joint_audit(runs, prepared, solution, shortest, false_discovery_rate)
    if not options.position_offsets:
        audit["displacement_of_runs"] = {
            "sd_mm": solution.displaced.sd / _MM,
            "probability": solution.displaced.probability,
        }
    if options != JointOptions() or n_probes > 1:
        audit["options"] = options.as_dict()
        audit["run_levels_nm"] = ((solution.offsets + level) / _NM).tolist()
    audit["evidence"] = how
    if solution.slip:  # the model holds it, and its own sentence says so
        unsteady = ()
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
        *explain_band(solution, band=band, plain=plain),
    )
    if solution.scores:
        terms = {**terms, "leave_one_out": left_out_columns(solution, prepared, (low, high))}
    feed_term = feed_curves(solution, options, (first, last), (low, high))
    residual = np.concatenate(solution.kept_residuals)
    return ErrorEstimate(
        method="joint",
        start=first,
        stop=last,
        fit_range=(low, high),
        directions_data={0: replace(part, feed_term=feed_term)},
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
        runs_data=scores_columns(solution) | position_columns(offsets),
    )


_NEAR = 20e-6
"""m; what was learnt about noise and waves before the runs were moved by less than this stays."""

_PLACINGS = 4
"""Solutions with moved runs, at most; displacements of a tenth of a wave need two."""


def _at_their_places(
    prepared: list[PreparedRun], solve: Callable[..., Solution], options: JointOptions
) -> tuple[Solution, list[PreparedRun], PositionOffsets]:
    """Return the solution, with the runs moved to where their position offsets put them."""
    if not options.position_offsets:
        return solve(prepared), prepared, None
    total: FloatArray = np.zeros(len(prepared))
    placed, n_left = prepared, _PLACINGS
    while True:
        solution = solve(placed)
        step, u = fitted_positions(solution.unknowns, solution.joint_covariance, len(prepared))
        total = total + step
        placed = [replace(r, x=r.x - d) for r, d in zip(prepared, total, strict=True)]
        n_left -= 1
        if n_left == 0 or float(np.abs(step).max()) < _NEAR:
            if not options.position_reference:  # the mean of the runs is displaced as well
                scatter = max(float(np.var(total, ddof=1)) - float(np.mean(u**2)), 0.0)
                solution = solution.displaced_by(scatter / len(total))
            return solution, placed, (total, u)


def _check_feeds(runs: RunSet, *, min_feeds: int, fit_lag: bool) -> None:
    feeds = runs.feeds
    have = ", ".join(f"{f * 6e4:.6g} mm/min" for f in feeds) or "no feedrate"
    way = " and ".join("forward" if d > 0 else "reverse" for d in runs.directions)
    if not feeds and min_feeds > 0:
        raise NotSeparableError(
            f"the {way} runs have no feedrate and no time; the joint method needs time to tell "
            "vibration from geometry: give a time column, the sampling rate or the feed of each "
            "run (or use method='mean')"
        ).hinting(method="mean")
    if len(feeds) < min_feeds:
        raise (
            NotSeparableError(
                f"the {way} runs have {len(feeds)} feedrate{'' if len(feeds) == 1 else 's'} ({have}), the separation needs {min_feeds}: a "
                "vibration and a geometric error of the same wavelength look alike at one feedrate; "
                "add runs at another feedrate, or accept averaging with method='mean' or min_feeds=1"
            )
            .hinting(method="mean")
            .hinting(min_feeds=1)
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
    pitch = max(measured_pitch(r) for r in runs)
    rows = sum(int((~np.isnan(r.z)).sum()) for r in runs)
    by_data = max(
        (rows - len(runs)) // 2, 4
    )  # as many unknowns as readings; the prior does the rest
    floor = _SAMPLES_PER_WAVE * pitch
    if shortest is not None:
        if not floor <= shortest <= period:
            raise UnitError(
                f"shortest is {format_length(shortest)}; it must lie between "
                f"{format_length(floor)} (2.5 sample pitches) and {format_length(period)}; it is in "
                "metres: 1.2 mm is 1.2e-3"
            )
        # A wave is held by harmonics on both of its sides.
        wanted = math.ceil(period / shortest / HELD_SHARE * (1.0 - 1e-12))
        return min(wanted, by_data), "stated" if wanted <= by_data else "data"
    by_pitch = int(period / floor)
    return min(by_pitch, by_data, _MAX_HARMONICS), (
        "cost" if by_pitch > _MAX_HARMONICS else "sampling"
    )


# ---- private to separation: the joint solution as a curve with its uncertainty, line removed ----


def joint_curves(
    solution: Solution, evaluation: tuple[float, float], travel: tuple[float, float]
) -> tuple[DirectionEstimate, Quantity, float, float]:
    """Return curve with covariance, slope, level, and the RMS u without what the prior leaves open.

    The line over the evaluation range is removed.
    """
    k = solution.n_harmonics
    grid, projected, to_line = _projected(solution, evaluation, travel)
    mid, half = float(np.mean(evaluation)), (evaluation[1] - evaluation[0]) / 2.0
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
    part = DirectionEstimate(
        curve,
        SampledCurve(grid, np.sqrt(_variance(projected, solution.covariance))),
        modes=CovarianceModes.of(grid, projected, solution.covariance),
    )
    plain = math.sqrt(float(np.mean(_variance(projected, solution.plain_covariance))))
    return part, alignment, float(offset), plain


def _projected(
    solution: Solution, evaluation: tuple[float, float], travel: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a grid, the model's functions on it without their lines, and how those lines follow."""
    k = solution.n_harmonics
    step = solution.period / max(k, 8) / 8.0
    n_grid = int(np.clip(np.ceil((travel[1] - travel[0]) / step), 200, 4000)) + 1
    grid = np.linspace(travel[0], travel[1], n_grid)
    inner = np.linspace(evaluation[0], evaluation[1], LINE_POINTS)

    def functions(x: FloatArray) -> FloatArray:
        waves = fourier_basis(x, origin=solution.origin, period=solution.period, n_harmonics=k)
        return np.column_stack([x - solution.centre, waves])

    mid, half = np.mean(evaluation), (evaluation[1] - evaluation[0]) / 2.0
    along = (inner - mid) / half  # of mean zero: level and slope are found apart
    to_line = np.vstack([np.full(inner.size, 1.0 / inner.size), along / (along @ along)])
    to_line = to_line @ functions(inner)
    levels = np.column_stack([np.ones(n_grid), (grid - mid) / half]) @ to_line
    return grid, np.asarray(functions(grid) - levels), np.asarray(to_line)


def _variance(functions: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the variance at each position, of coefficients with that covariance."""
    return np.asarray(np.maximum(((functions @ covariance) * functions).sum(axis=1), 0.0))


# ---- private to separation: what repeatability alone says, beside the joint estimate -----------
# The joint method tests a wavelength against its model of the noise; the table of evidence asks only
# whether the runs of different feedrates agree. Where the feedrates move a vibration by less than
# the resolution, the second question has no answer.

_AGREES, _DISAGREES = 1e-4, 0.5
"""p-values between which estimate and evidence may differ by chance."""

_STRONG = 8.0
"""A wave of the estimate is held against the evidence beyond so many of its uncertainties."""

_TIMES = 4.0
"""The evidence is held against the estimate where its wave is so many times as strong."""

_POINTS_OF_A_WAVE = 16
"""Of the estimate, where its spectrum is taken as that of the runs."""

_LEAST_RUNS = 2
"""Runs of each feedrate: fewer leave hardly any degrees of freedom."""


def _thin(runs: RunSet, first: float, last: float) -> list[str]:
    """Say where not all runs reach, and where a single feedrate does."""
    parts = thin_parts(runs, first, last)
    if not parts:
        return []
    fewest = min(parts, key=lambda part: part[2])
    where = format_ends(fewest[0], fewest[1])
    text = (
        f"not all runs reach {format_ends(parts[0][0], parts[-1][1])}"
        if len(parts) == 1
        else "not all runs reach the whole evaluation range"
    )
    text += (
        f": {where} is covered by {fewest[2]} of {len(runs)}; the band holds what that leaves open"
    )
    if fewest[3] < 2 <= len(runs.feeds):
        text += (
            ", and one feedrate alone cannot tell a vibration that starts in phase with the run "
            "from geometry"
        )
    return [text]


def evidence_of(
    runs: RunSet, probes: Sequence[str], *, over: tuple[float, float], rate: float
) -> tuple[dict[str, list[Any]], Mapping[str, Any], tuple[str, ...]]:
    """Return the columns of the evidence and what was done, or why none; and what slips, in words."""
    used = RunSet([r for r, name in zip(runs, probes, strict=True) if name == probes[0]])
    groups = used.by_feed()
    if len(groups) < 2 or any(r.feed is None for r in used):
        return {}, {"not_taken": "fewer than 2 feedrates"}, ()
    if min(len(members) for _, members in groups) < _LEAST_RUNS:
        return {}, {"not_taken": f"fewer than {_LEAST_RUNS} runs at a feedrate"}, ()
    try:
        shared = runs.common_travel
        start, stop = max(over[0], shared[0]), min(over[1], shared[1])
        table = evidence_table(used, start=start, length=stop - start, false_discovery_rate=rate)
    except (InvalidSamplesError, TooFewSamplesError, NotSeparableError) as exc:
        return {}, {"not_taken": str(exc)}, ()
    return dict(table.columns), table.audit, table.unsteady


def contradictions(
    spectrum: Mapping[str, list[Any]],
    evidence: Mapping[str, list[Any]],
    curve: Callable[[FloatArray], FloatArray],
    *,
    span: tuple[float, float],
    noise_nm: float,
) -> list[str]:
    """Name the wave in which estimate and evidence of one result contradict each other most.

    The estimate knows the noise, the evidence only asks whether the runs agree; where both are
    right they find the same strong waves. Amplitudes are compared over neighbouring wavelengths,
    since the two tables have different ones; and with the estimate under the window of the
    evidence, where a strong wave off the grid of the travel leaks into its neighbours.
    """
    if not evidence:
        return []
    own_wave, own = (np.array(spectrum[k], dtype=float) for k in ("wavelength_mm", "amplitude_nm"))
    sd = np.array(spectrum["sd_nm"], dtype=float)
    wave, found = (np.array(evidence[k], dtype=float) for k in ("wavelength_mm", "amplitude_nm"))
    p = np.array(evidence["p"], dtype=float)
    sentences = []
    alone = np.zeros(own.size)
    for k in np.flatnonzero(np.array(spectrum["selected"]) & (own > _STRONG * sd)):
        near = np.abs(wave[0] / wave - wave[0] / own_wave[k]) < 1.6
        # The greatest wave of its surroundings only: the flanks of a strong one are not waves.
        around = own[max(k - 3, 0) : k + 4]
        if own[k] >= around.max() and near.any() and not np.isnan(p[near]).any():
            alone[k] = own[k] if p[near].min() > _DISAGREES else 0.0
    if alone.any():
        top = int(np.argmax(alone))
        sentences.append(
            f"the estimate holds a wave of {own_wave[top]:.3g} mm, {own[top]:.3g} nm, but the runs do not "
            "agree on one there (evidence): it is not certain, and the uncertainty does not hold it; "
            "add runs at another feedrate"
        )
    left = np.zeros(found.size)
    x = np.linspace(*span, _POINTS_OF_A_WAVE * found.size + 1)
    own_spectra = feed_spectra(
        RunSet([Run(x, curve(x))]),
        origin=span[0],
        length=span[1] - span[0],
        n_harmonics=found.size,
        taper="tukey",
    )
    leaked = np.abs(own_spectra.coefficients[0]) / own_spectra.mean_weight * 1e9
    for k in np.flatnonzero(p < _AGREES):
        near = np.abs(wave[0] / own_wave - wave[0] / wave[k]) < 1.6
        around = found[max(k - 3, 0) : k + 4]
        held = max(own[near].max(initial=0.0), leaked[max(k - 1, 0) : k + 2].max())
        if found[k] >= around.max() and near.any() and found[k] > _TIMES * held:
            left[k] = found[k] if found[k] > noise_nm else 0.0
    if left.any():
        top = int(np.argmax(left))
        sentences.append(
            f"the runs repeat a wave of {wave[top]:.3g} mm, {found[top]:.3g} nm (evidence), that the estimate "
            "does not hold: ask for shorter wavelengths with shortest="
        )
    return sentences


# ---- private to separation: spectrum, residual and audit of the joint solution as plain columns ----

_TABLES_NM, _MM = 1e-9, 1e-3

_SHORTEST_SEGMENT = 16
"""Samples without a gap from which a spectrum of the residual is taken."""

_BLIND = "beyond the noise model, but not separable by repeatability"

_LINE_CELLS = 1.0
"""A line falls onto a wavelength within so many resolution cells of the travel."""


def spectrum_columns(solution: Solution, runs: RunSet, *, rate: float) -> dict[str, list[Any]]:
    """Return amplitude, evidence and reason of each wave: the free ones and the broad part."""
    k = np.arange(1, solution.n_harmonics + 1)
    rows = solution.rows
    wavelength = np.concatenate([[w.wavelength for w in solution.waves], solution.period / k])
    order = np.argsort(-wavelength, kind="stable")
    wavelength, rows = wavelength[order], rows[order]
    amplitude, phase, sd, chi2 = rows.T
    p_values = np.exp(-0.5 * chi2)
    selected = benjamini_hochberg(p_values, rate=rate)
    taken = _under_a_line(solution, runs, wavelength)
    selected[list(taken)] = False
    blind = _not_separable(runs, wavelength)
    reasons = [
        taken.get(i) or _reason(chosen=bool(selected[i]), blind=bool(blind[i]))
        for i in range(wavelength.size)
    ]
    return {
        "wavelength_mm": (wavelength / _MM).tolist(),
        "amplitude_nm": (amplitude / _TABLES_NM).tolist(),
        "phase_rad": phase.tolist(),
        "sd_nm": (sd / _TABLES_NM).tolist(),
        "snr": (amplitude / sd).tolist(),
        "p": p_values.tolist(),
        "selected": [bool(s) for s in selected],
        "reason": reasons,
    }


def _reason(*, chosen: bool, blind: bool) -> str:
    if not chosen:
        return "within the noise"
    return _BLIND if blind else "repeats at all feedrates"


def _not_separable(runs: RunSet, wavelength: FloatArray) -> NDArray[np.bool_]:
    """Where the feedrates move a vibration by no more than the resolution of the fastest run."""
    feeds = runs.feeds
    if len(feeds) < 2:
        return np.full(wavelength.size, True)
    low, high = runs.full_travel
    return np.asarray((feeds[-1] - feeds[0]) / wavelength <= feeds[-1] / (high - low))


def _under_a_line(solution: Solution, runs: RunSet, wavelength: FloatArray) -> dict[int, str]:
    """Rows onto which a removed line falls at the only feedrate, with the reason."""
    if len(runs.feeds) != 1:
        return {}
    low, high = runs.full_travel
    taken = {}
    for frequency in solution.terms.frequencies:
        cells = np.abs(frequency / runs.feeds[0] - 1.0 / wavelength) * (high - low)
        for i in np.flatnonzero(cells < _LINE_CELLS):
            taken[int(i)] = (
                f"the line at {frequency:.4g} Hz falls here: not separable at one feedrate"
            )
    return taken


def _by_noise(
    runs: Sequence[PreparedRun], solution: Solution, records: Sequence[FloatArray]
) -> list[list[FloatArray]]:
    """Return the records of the runs of each noise model."""
    out: list[list[FloatArray]] = [[] for _ in solution.noise]
    steps = np.array([m.time_step for m in solution.noise])
    for run, record in zip(runs, records, strict=True):
        out[int(np.argmin(np.abs(steps - run.time_step)))].append(record)
    return out


def residual_psd_columns(runs: list[PreparedRun], solution: Solution) -> dict[str, list[Any]]:
    """Return the spectrum of the noise at the sampling interval that most samples have.

    Of draws, since the geometry takes its share of the residual: of R runs 1/R of the noise.
    """
    groups = _by_noise(runs, solution, solution.noise_draws)
    group = int(np.argmax([sum(r.size for r in own) for own in groups]))
    model = solution.noise[group]
    records = [record for draws in groups[group] for record in draws.T]
    size = _unbroken_segment(records)
    if size < _SHORTEST_SEGMENT:  # an estimate must not fail for want of a picture
        return {"frequency_hz": [], "psd_nm2_per_hz": [], "model_nm2_per_hz": []}
    frequency, density = pooled_periodogram(records, time_step=model.time_step, n_fft=size)
    return {
        "frequency_hz": frequency.tolist(),
        "psd_nm2_per_hz": (density / _TABLES_NM**2).tolist(),
        "model_nm2_per_hz": (model.psd(frequency) / _TABLES_NM**2).tolist(),
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


def joint_audit(
    runs: RunSet,
    prepared: list[PreparedRun],
    solution: Solution,
    shortest: float | None,
    rate: float,
) -> dict[str, Any]:
    """Return what was done, as plain values."""
    return {
        "n_runs": len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in runs.feeds],
        "n_samples": sum(len(r) for r in runs),
        "n_not_measured": sum(r.n_invalid for r in runs),
        "averaged_samples": max(r.block for r in prepared),
        "basis_period_mm": solution.period / _MM,
        "shortest_wavelength_mm": solution.period / solution.n_harmonics / _MM,
        "shortest_wavelength_chosen_by": "user" if shortest is not None else "sampling",
        "spectral_slope": solution.slope_of_spectrum,
        "waves": [
            {
                "wavelength_mm": w.wavelength / _MM,
                "u_wavelength_mm": w.u_wavelength / _MM,
                "amplitude_nm": math.hypot(w.cosine, w.sine) / _TABLES_NM,
                "u_amplitude_nm": w.u_amplitude / _TABLES_NM,
                "p_repeats": None if math.isnan(w.p_repeats) else w.p_repeats,
            }
            for w in solution.waves
        ],
        "slip": [
            {"wavelength_mm": s.wavelength / _MM, "sd_nm": s.sd / _TABLES_NM}
            for s in solution.slip
        ],
        "constants": CONSTANTS,
        "noise_model": [
            {
                "time_step_ms": m.time_step * 1e3,
                "order": m.order,
                "innovation_nm": math.sqrt(m.variance) / _TABLES_NM,
            }
            for m in solution.noise
        ],
        "noise_order": f"the highest that the runs feed: a fifth of the shortest, at most {MOST}",
        "effective_parameters": solution.freedom,
        "false_discovery_rate": rate,
        "lag_test": _lag_audit(solution),
        "line_removed": "least squares over the evaluation range",
        "run_offsets_nm": (solution.offsets / _TABLES_NM).tolist(),
    }


def scores_columns(solution: Solution) -> dict[str, list[Any]]:
    """Return what each run is beside what the others predict of it; nothing below 3 runs."""
    if not solution.scores:
        return {}
    odd, n = suspicion(solution.scores), len(solution.scores)
    return {
        "against_others": [odd[1] if odd and odd[0] == i else "" for i in range(n)],
        "misfit": [s.chi2 for s in solution.scores],
        "predicted_gain": [s.gain for s in solution.scores],
        "u_predicted_gain": [s.u_gain for s in solution.scores],
        "predicted_shift_mm": [s.shift / _MM for s in solution.scores],
        "u_predicted_shift_mm": [s.u_shift / _MM for s in solution.scores],
    }


_PLACES = 60
"""Positions at which a run is shown against what the others predict of it."""


def left_out_columns(
    solution: Solution, prepared: Sequence[PreparedRun], travel: tuple[float, float]
) -> dict[str, Any]:
    """Return each run minus what the others predict of it, averaged over stretches of the travel."""
    edges = np.linspace(*travel, _PLACES + 1)
    rows = []
    for run, rest in zip(prepared, solution.unpredicted, strict=True):
        known = ~np.isnan(rest)
        at = np.clip(np.searchsorted(edges, run.x[known], side="right") - 1, 0, _PLACES - 1)
        count = np.bincount(at, minlength=_PLACES)
        total = np.bincount(at, weights=rest[known], minlength=_PLACES)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
        rows.append((mean / _TABLES_NM).tolist())
    return {
        "x_mm": (0.5 * (edges[1:] + edges[:-1]) / _MM).tolist(),
        "run": [run.run_id for run in prepared],
        "rest_nm": rows,
    }


def _lag_audit(solution: Solution) -> dict[str, Any] | None:
    """Return what the test of a lag beside the stated one found."""
    test = solution.lag_test
    if test is None:
        return None
    return {
        "lag_ms": test.lag * 1e3,
        "u_ms": test.u * 1e3,
        "probability": test.probability,
        "chi2": test.chi2,
        "spread_ms2": test.spread * 1e6,
        "fitted": test.fitted,
    }


# ---- private to separation: sentences that say which option would help, where the readings show it ----
# Slopes in time: the residual of each run is written in orthogonal polynomials of time. Noise that
# is smooth over frequency gives each low degree the same variance, so the first degree is compared
# with the next ones by an F test; a drift of the runs raises the first alone.

_DEGREES = 7
"""Highest degree in time; those above the first show what noise alone does."""

_RARE = 1e-3
"""A drift is named where chance alone would show as much less often than this."""

_SURE = 4.5
"""A gain is named beyond so many uncertainties: these scatter by up to 1.3 times what the noise
model says, since the noise model is itself an estimate."""


DRIFT_SAID, GAIN_SAID = "the residuals rise or fall in time", "the readings of probe"
"""How the sentences about a drift and about the gain of a probe begin: `separate` looks for them."""


def hint_options(
    solution: Solution, prepared: Sequence[PreparedRun], options: JointOptions
) -> list[str]:
    """Name the options that these readings ask for."""
    sentences = [] if options.drift else _drift_hint(solution, prepared)
    if options.probe_gain == "equal":
        sentences += _gain_hint(solution)
    return sentences


def _drift_hint(solution: Solution, prepared: Sequence[PreparedRun]) -> list[str]:
    from scipy.stats import f as f_distribution

    marked = None if solution.weights is None else solution.weights.marked
    powers = []
    for i, (run, residual) in enumerate(zip(prepared, solution.residuals, strict=True)):
        z = residual if marked is None else np.where(marked[i], np.nan, residual)
        powers.append(_power_by_degree(run.t, z))
    power = np.array(powers)
    n_free = (len(prepared) - 1.0) / solution.sharing[0]  # what all share is slope of the axis
    noise = float(power[:, 1:].mean())
    if n_free < 1.0 or noise <= 0.0:
        return []
    ratio = float(power[:, 0].mean()) / noise
    p = float(f_distribution.sf(ratio, n_free, n_free * (_DEGREES - 1)))
    if p >= _RARE:
        return []
    slopes = np.array([_rise(r.t, z) for r, z in zip(prepared, solution.residuals, strict=True)])
    sentence = (
        f"{DRIFT_SAID}, by up to {np.abs(slopes).max() / _NM:.3g} nm in a run, "
        f"{math.sqrt(ratio):.2g} times what their noise explains (p = {max(p, 1e-99):.0e}): the sensor "
        "or the temperature drifts and the uncertainty is too small; drift=1 takes it out"
    )
    return [sentence]


def _power_by_degree(t: FloatArray, z: FloatArray) -> FloatArray:
    """Return the squares of the coefficients of degree 1 and higher, polynomials of unit power."""
    valid = ~np.isnan(z)
    u = (t - 0.5 * (t[0] + t[-1])) / (0.5 * float(np.ptp(t)))
    columns = np.polynomial.legendre.legvander(u[valid], _DEGREES)
    q = np.linalg.qr(columns)[0]
    return np.asarray((q.T @ z[valid])[1:] ** 2)


def _rise(t: FloatArray, z: FloatArray) -> float:
    """Return the change of the fitted line over one run."""
    valid = ~np.isnan(z)
    u = t[valid] - float(t[valid].mean())
    return float(u @ z[valid] / (u @ u)) * float(np.ptp(t))


def _gain_hint(solution: Solution) -> list[str]:
    return [
        f"{GAIN_SAID} {d.probe!r} differ by {100 * d.gain:+.2g} % (u {100 * d.sd:.1g} %) "
        f"from those of {d.first!r}; probe_gain='fit' gives each probe its own sensitivity"
        for d in solution.probe_differences
        if abs(d.gain) > _SURE * d.sd
    ]
