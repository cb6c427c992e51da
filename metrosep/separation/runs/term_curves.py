"""Private to separation: the extra terms of a joint fit as curves over position and as a report."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import UnitError
from metrosep.core.runset import RunSet, feed_groups
from metrosep.separation.runs.base import LINE_POINTS, FeedTerm, SampledCurve
from metrosep.separation.runs.design import PreparedRun
from metrosep.separation.runs.lines import Gain
from metrosep.separation.runs.options import JointOptions
from metrosep.separation.runs.solver import Solution
from metrosep.spectral.dft import fourier_basis

_POINTS_PER_WAVE = 32
"""Of the sampled curve of the feed-dependent part: straight lines between them miss 0.5 %."""


def check_lines(options: JointOptions, prepared: Sequence[PreparedRun]) -> None:
    """Refuse lines that these runs cannot hold."""
    if isinstance(options.lines, str):
        return
    low = 1.5 / min(float(np.ptp(r.t)) for r in prepared)
    high = 0.5 / max(r.time_step for r in prepared)
    for frequency in options.lines:
        if not low <= frequency <= high:
            raise UnitError(
                f"a line of {frequency:.6g} Hz cannot be fitted to these runs: they hold "
                f"{low:.3g} ... {high:.4g} Hz (1.5 periods in the shortest run, half the sampling "
                "rate after averaging); is it in Hz?"
            )


def report_terms(
    solution: Solution, prepared: Sequence[PreparedRun], runs: RunSet, options: JointOptions
) -> tuple[dict[str, Any], list[str]]:
    """Return what the extra terms came out as, and the sentences about it."""
    terms: dict[str, Any] = {}
    sentences: list[str] = []
    several = len({r.probe for r in prepared}) > 1
    reports: dict[str, tuple[bool, Callable[[], Report]]] = {
        "drift": (options.drift > 0, lambda: report_drift(solution, prepared)),
        "lines": (options.lines != (), lambda: report_lines(solution, prepared, runs)),
        "robust": (options.robust, lambda: report_robust(solution, prepared)),
        "following": (
            options.following != "off",
            lambda: report_following(
                solution, prepared, kind=options.following, n_feeds=len(runs.feeds)
            ),
        ),
        "probes": (several, lambda: report_probes(solution, prepared)),
    }
    for name, (wanted, report) in reports.items():
        if wanted:
            terms[name], told = report()
            sentences += told
    return terms, sentences


def feed_curves(
    solution: Solution,
    options: JointOptions,
    evaluation: tuple[float, float],
    travel: tuple[float, float],
) -> FeedTerm | None:
    """Return how the curve changes with the feedrate, line removed."""
    if options.following not in ("scale", "waves"):
        return None
    k, reference = solution.n_harmonics, solution.terms.reference
    highest = max(k / solution.period, float(solution.terms.wavenumbers.max(initial=0.0)))
    n_grid = int(np.clip((travel[1] - travel[0]) * highest * _POINTS_PER_WAVE, 200, 8000)) + 1
    grid = np.linspace(travel[0], travel[1], n_grid)
    inner = np.linspace(evaluation[0], evaluation[1], LINE_POINTS)
    mid, half = float(np.mean(evaluation)), (evaluation[1] - evaluation[0]) / 2.0
    line = np.column_stack([np.ones(inner.size), (inner - mid) / half])
    grid_line = np.column_stack([np.ones(n_grid), (grid - mid) / half])

    def projected(columns: FloatArray, at_inner: FloatArray) -> FloatArray:
        to_line = np.linalg.lstsq(line, at_inner, rcond=None)[0]
        return np.asarray(columns - grid_line @ to_line)

    error = projected(_error_columns(solution, grid), _error_columns(solution, inner))
    change = projected(
        _change_columns(solution, options, grid), _change_columns(solution, options, inner)
    )
    change = change / reference
    covariance = solution.joint_covariance
    if options.following == "waves":
        coefficients = np.zeros(covariance.shape[0])
        first = solution.coefficients.size
        coefficients[first : first + solution.extra.size] = solution.extra
        value = change @ coefficients
    else:
        value = _gain(solution).value * (error[:, 1 : 1 + 2 * k] @ solution.coefficients[1:])
        value = value / reference
    return FeedTerm(
        reference,
        SampledCurve(grid, value),
        SampledCurve(grid, np.einsum("ij,jk,ik->i", error, covariance, change)),
        SampledCurve(grid, np.maximum(np.einsum("ij,jk,ik->i", change, covariance, change), 0.0)),
    )


def _gain(solution: Solution) -> Gain:
    return next(u for u in solution.unknowns if isinstance(u, Gain) and u.name == "following")


def _error_columns(solution: Solution, x: FloatArray) -> FloatArray:
    """Return the derivative of the curve at the reference feed with all that is in the covariance."""
    out = np.zeros((x.size, solution.joint_covariance.shape[0]))
    k = solution.n_harmonics
    out[:, 0] = x - solution.centre
    out[:, 1 : 1 + 2 * k] = fourier_basis(
        x, origin=solution.origin, period=solution.period, n_harmonics=k
    )
    return out


def _change_columns(solution: Solution, options: JointOptions, x: FloatArray) -> FloatArray:
    """Return the derivative of the change for a relative speed of 1."""
    out = np.zeros((x.size, solution.joint_covariance.shape[0]))
    first, n_extra = solution.coefficients.size, solution.extra.size
    if options.following == "waves":
        n = solution.terms.wavenumbers.size
        phase = 2.0 * np.pi * np.outer(x - solution.origin, solution.terms.wavenumbers)
        stop = first + n_extra
        out[:, stop - 2 * n : stop] = np.hstack([np.cos(phase), np.sin(phase)])
        return out
    gain = _gain(solution)
    k = solution.n_harmonics
    basis = fourier_basis(x, origin=solution.origin, period=solution.period, n_harmonics=k)
    out[:, 1 : 1 + 2 * k] = gain.value * basis
    place = first + n_extra + next(i for i, u in enumerate(solution.unknowns) if u is gain)
    out[:, place] = basis @ solution.coefficients[1:]
    return out


# ---- what depends on the feedrate, and what differs between probes: tables, curves and sentences ----

_NM, _MM = 1e-9, 1e-3
_MM_PER_MIN = 6e4
_M_PER_MIN = 60.0
"""m/min in one m/s."""

_DOUBT = 0.01
"""The model is called wrong where its test has a smaller p-value."""


def report_following(
    solution: Solution, prepared: Sequence[PreparedRun], *, kind: str, n_feeds: int
) -> Report:
    """Return the part of the error that grows with the feedrate."""
    reference = solution.terms.reference
    result: dict[str, Any] = {
        "kind": kind,
        "reference_feed_mm_min": reference * _MM_PER_MIN,
    }
    if kind == "offset":
        result |= _offset_growth(solution, prepared)
        sentence = (
            f"the readings shift by {result['growth_nm_per_m_per_min']:.3g} nm for each m/min "
            f"(u {result['u_growth_nm_per_m_per_min']:.2g} nm)"
        )
    elif kind == "scale":
        gain = next(u for u in solution.unknowns if isinstance(u, Gain) and u.name == "following")
        per = 1.0 / (reference * _M_PER_MIN)
        result |= {
            "growth_percent_per_m_per_min": 100.0 * gain.value * per,
            "u_growth_percent_per_m_per_min": 100.0 * gain.sd * per,
        }
        sentence = (
            f"the error grows by {100 * gain.value * per:.3g} % for each m/min "
            f"(u {100 * gain.sd * per:.2g} %)"
        )
    else:
        result["waves"] = _wave_growth(solution)
        strongest = int(np.argmax(result["waves"]["growth_nm_per_m_per_min"]))
        wave = {k: v[strongest] for k, v in result["waves"].items()}
        sentence = (
            f"the {wave['wavelength_mm']:.3g} mm wave changes by {wave['growth_nm_per_m_per_min']:.3g} nm "
            f"for each m/min (u {wave['u_growth_nm_per_m_per_min']:.2g} nm)"
        )
    if kind != "offset":
        sentence += (
            f"; the estimate stands for {result['reference_feed_mm_min']:.0f} mm/min, "
            "evaluate_at(x, feed=...) gives others"
        )
    sentences = [sentence]
    sentences += _linearity(result, solution, n_feeds)
    return result, sentences


def _linearity(result: dict[str, Any], solution: Solution, n_feeds: int) -> list[str]:
    """Add the test of proportionality; say where there is none, or where it fails."""
    if n_feeds < 3:
        return [
            "two feedrates cannot show whether it is proportional to the feedrate; add a third"
        ]
    if solution.feed_test is not None:
        from scipy.stats import chi2

        statistic, freedom = solution.feed_test
        result["p_proportional"] = float(chi2.sf(statistic, freedom))
    if result.get("p_proportional", 1.0) < _DOUBT:
        p = result["p_proportional"]
        told = (
            f"it is not proportional to the feedrate (p = {p:.1g}): the estimate holds only near "
            "the feedrates of the runs"
        )
        return [told]
    return []


def _offset_growth(solution: Solution, prepared: Sequence[PreparedRun]) -> dict[str, Any]:
    """Regress the offsets of the runs, each probe with its own level, on the speed."""
    speed = np.array([abs(r.velocity) for r in prepared])
    names = list(dict.fromkeys(r.probe for r in prepared))
    design = np.column_stack(
        [speed * 1.0, *(np.array([float(r.probe == n) for r in prepared]) for n in names)]
    )
    y = solution.offsets
    scale = float(np.abs(y - y.mean()).max()) or 1.0
    fit = np.linalg.lstsq(design, y / scale, rcond=None)[0] * scale
    left = len(prepared) - design.shape[1]
    rest = y - design @ fit
    u = math.nan
    if left > 0:
        inverse = np.linalg.inv(design.T @ design)
        u = math.sqrt(float(rest @ rest) / left * float(inverse[0, 0]))
    result = {
        "growth_nm_per_m_per_min": float(fit[0]) / _NM / _M_PER_MIN,
        "u_growth_nm_per_m_per_min": u / _NM / _M_PER_MIN,
    }
    return result | _lack_of_fit(speed, rest, design.shape[1])


def _lack_of_fit(speed: FloatArray, rest: FloatArray, n_parameters: int) -> dict[str, float]:
    """Test the means of the feedrates against the straight line (F, pure error within a feed)."""
    from scipy.stats import f as f_distribution

    groups = feed_groups(speed.tolist())
    pure = sum(float(((rest[g] - rest[g].mean()) ** 2).sum()) for g in groups)
    between = sum(len(g) * float(rest[g].mean()) ** 2 for g in groups)
    top, bottom = len(groups) - n_parameters, rest.size - len(groups)
    if top < 1 or bottom < 1 or pure <= 0.0:
        return {}
    return {
        "p_proportional": float(f_distribution.sf(between / top / (pure / bottom), top, bottom))
    }


def _wave_growth(solution: Solution) -> dict[str, list[float]]:
    n = solution.terms.wavenumbers.size
    first = solution.coefficients.size + solution.extra.size - 2 * n
    a, b = np.split(solution.extra[-2 * n :], 2)
    covariance = solution.joint_covariance[first : first + 2 * n, first : first + 2 * n]
    per = 1.0 / (solution.terms.reference * _M_PER_MIN) / _NM
    rows: dict[str, list[float]] = {}
    for i, wavenumber in enumerate(solution.terms.wavenumbers):
        pair = np.array([a[i], b[i]])
        part = covariance[np.ix_([i, n + i], [i, n + i])]
        amplitude = float(np.hypot(*pair))
        along = pair / max(amplitude, 1e-300)
        chi2 = float(pair @ np.linalg.solve(part, pair))
        row = {
            "wavelength_mm": 1.0 / float(wavenumber) / _MM,
            "growth_nm_per_m_per_min": amplitude * per,
            "u_growth_nm_per_m_per_min": math.sqrt(float(along @ part @ along)) * per,
            "phase_rad": -math.atan2(b[i], a[i]),
            "p": math.exp(-0.5 * min(chi2, 1400.0)),
        }
        for key, value in row.items():
            rows.setdefault(key, []).append(value)
    return rows


def report_probes(solution: Solution, prepared: Sequence[PreparedRun]) -> Report:
    """Return offset, sensitivity and noise of each probe."""
    names = list(dict.fromkeys(r.probe for r in prepared))
    gains = {u.name: u for u in solution.unknowns if isinstance(u, Gain)}
    first = _level(solution, prepared, names[0])
    columns: dict[str, Any] = {}
    for name in names:
        own = [i for i, r in enumerate(prepared) if r.probe == name]
        level, u = _level(solution, prepared, name)
        gain = gains.get(name)
        rest = np.concatenate([solution.kept_residuals[i] for i in own])
        is_first = name == names[0]
        row = {
            "probe": name,
            "n_runs": len(own),
            "offset_nm": 0.0 if is_first else (level - first[0]) / _NM,
            "u_offset_nm": 0.0 if is_first else math.hypot(u, first[1]) / _NM,
            "gain": 1.0 if gain is None else 1.0 + gain.value,
            "u_gain": (0.0 if is_first else math.nan) if gain is None else gain.sd,
            "residual_rms_nm": float(np.sqrt(np.nanmean(rest**2))) / _NM,
        }
        for key, value in row.items():
            columns.setdefault(key, []).append(value)
    factor, rho, n_shared = solution.sharing
    columns["shared_passes"], columns["noise_correlation"] = n_shared, rho
    sentences = [
        f"probe {n!r} reads {(g - 1) * 100:+.2g} % against {names[0]!r} (u {u * 100:.2g} %)"
        for n, g, u in zip(columns["probe"], columns["gain"], columns["u_gain"], strict=True)
        if n in gains
    ]
    if factor > 1.0:
        sentences.append(
            f"the probes read the same passes and their noise is correlated ({rho:.2f}): they share "
            f"the vibration of the machine, so together they count as {len(names) / factor:.2g} of {len(names)} probes"
        )
    return columns, sentences


def _level(solution: Solution, prepared: Sequence[PreparedRun], name: str) -> tuple[float, float]:
    """Return the mean offset of the runs of a probe, and its uncertainty from their scatter."""
    own = solution.offsets[[i for i, r in enumerate(prepared) if r.probe == name]]
    if own.size < 2:
        return float(own.mean()), math.nan
    return float(own.mean()), float(own.std(ddof=1)) / math.sqrt(own.size)


# ---- what the extra terms of the joint model came out as: plain tables and sentences -----------
# Each function returns a mapping of plain values with unit suffixes and the sentences that belong
# to it. Nothing here changes a result.

Report = tuple[dict[str, Any], list[str]]

_BAD_RUN = 0.2
"""Share of samples of a run beyond which it is named."""

_STANDS_OUT = 1e-3
"""Chance of noise as great as a stated line, above which it is said that none is there."""

_SAME_AMPLITUDE = 0.01
"""Chance of the amplitudes of the runs being equal below which a line is doubted."""


def extra_covariance(solution: Solution) -> FloatArray:
    """Return the covariance of the extra terms."""
    first = solution.coefficients.size
    part = slice(first, first + solution.extra.size)
    return solution.joint_covariance[part, part]


def report_drift(solution: Solution, prepared: Sequence[PreparedRun]) -> Report:
    """Return the drift of each run with its standard uncertainty."""
    terms, covariance = solution.terms, extra_covariance(solution)
    n = len(prepared)
    columns: dict[str, Any] = {"degree": terms.drift, "run": [r.run_id for r in prepared]}
    spans = np.array([float(np.ptp(r.t)) for r in prepared])
    share = (spans / 2.0 / terms.half_time) ** 2
    for degree, name, scale in (
        (1, "rate_nm_per_s", np.full(n, 1.0 / terms.half_time / _NM)),
        (2, "bow_nm", share / _NM),
    ):
        if degree > terms.drift:
            continue
        first = (degree - 1) * n
        mix = np.zeros((n, solution.extra.size))
        mix[np.arange(n), first + np.arange(n)] = 1.0
        if terms.common_drift and degree == 1:
            mix[:, terms.drift * n] = 1.0
        values = (mix @ solution.extra) * scale
        sd = np.sqrt(np.einsum("ij,jk,ik->i", mix, covariance, mix)) * scale
        columns[name] = values.tolist()
        columns[f"u_{name}"] = sd.tolist()
    largest = max(abs(v) * s for v, s in zip(columns["rate_nm_per_s"], spans, strict=True))
    sentences = [f"drift of degree {terms.drift} removed from each run: up to {largest:.3g} nm"]
    if not terms.common_drift:
        columns["common_drift_observable"] = False
        what = "alignment slope" if terms.drift == 1 else "alignment slope and parabola"
        sentences.append(
            "one direction at one feedrate: a drift that is the same in every run cannot be distinguished "
            f"from the {what} of the axis; it is counted as geometry, only the differences between "
            "the runs are drift; add runs at another feedrate"
        )
    else:
        columns["common_drift_observable"] = True
        if terms.drift == 2:
            sentences.append(
                "a bow in time that is the same in every run counts as geometry; the uncertainty "
                "allows for bows that differ between the runs"
            )
    return columns, sentences


def report_lines(solution: Solution, prepared: Sequence[PreparedRun], runs: RunSet) -> Report:
    """Return frequency, amplitude and phase of each line, and the wavelengths it falls onto."""
    terms, covariance = solution.terms, extra_covariance(solution)
    summary: dict[str, list[Any]] = {}
    table: dict[str, list[Any]] = {}
    sentences = []
    sds = {u.line: u.sd for u in solution.unknowns if hasattr(u, "line")}
    for i, frequency in enumerate(terms.frequencies):
        rows = [_line_row(solution, covariance, i, j, r) for j, r in enumerate(prepared)]
        for row, run in zip(rows, prepared, strict=True):
            row["wavelength_mm"] = abs(run.velocity) / frequency / _MM
            for key, value in {"line": i, "run": run.run_id, **row}.items():
                table.setdefault(key, []).append(value)
        own = rows[:1] if terms.locked else rows
        amplitude = math.sqrt(float(np.mean([r["amplitude_nm"] ** 2 for r in own])))
        u = float(np.mean([r["u_amplitude_nm"] for r in own])) / math.sqrt(len(own))
        alike = abs(np.mean([np.exp(1j * r["phase_rad"]) for r in rows]))
        p = next((f.p for f in solution.found[i : i + 1]), math.nan)
        p_equal = math.nan if terms.locked else _p_equal_amplitudes(rows)
        entry = {
            "frequency_hz": frequency,
            "u_frequency_hz": sds.get(i, math.nan),
            "amplitude_nm": amplitude,
            "u_amplitude_nm": u,
            "phase_agreement": float(alike),
            "p_false_alarm": p,
            "p_equal_amplitudes": p_equal,
            "wavelengths_mm": [v / frequency / _MM for v in runs.feeds],
        }
        for key, value in entry.items():
            summary.setdefault(key, []).append(value)
        chance = _p_nothing(own)
        if i >= len(solution.found) and chance > _STANDS_OUT:
            sentences.append(
                f"no line stands out of the noise at {frequency:.2f} Hz, where one was stated (p = "
                f"{chance:.2g}): what was removed there, {amplitude:.2g} nm, is noise; leave out lines="
            )
            continue
        doubt = "" if terms.locked else _mode_doubt(rows, p_equal, prepared)
        sentences.append(_line_sentence(entry, runs.feeds, locked=terms.locked) + doubt)
    if not terms.frequencies:
        sentences.append("no deterministic line stands out of the noise beyond chance")
    elif len(runs.feeds) == 1:
        sentences.append(
            "one feedrate only: geometry at the wavelength of a line cannot be distinguished from the line "
            "and is not estimated; add runs at another feedrate"
        )
    phase = "locked" if terms.locked else "free"
    return {"phase": phase, "lines": summary, "runs": table}, sentences


def _line_row(
    solution: Solution, covariance: FloatArray, line: int, index: int, run: PreparedRun
) -> dict[str, float]:
    """Amplitude and phase of a line in one run, from the start of the run."""
    terms = solution.terms
    first = terms.line_start(line) + (0 if terms.locked else 2 * index)
    a, b = solution.extra[first : first + 2]
    part = covariance[first : first + 2, first : first + 2]
    amplitude = math.hypot(a, b)
    along = np.array([a, b]) / max(amplitude, 1e-300)
    across = np.array([-along[1], along[0]])
    start = float(run.t[0]) - 0.5 * (run.block - 1) * run.time_step / run.block
    ahead = 0.0 if terms.locked else 0.5 * float(run.t[0] + run.t[-1]) - start
    phase = -math.atan2(b, a) - 2.0 * math.pi * terms.frequencies[line] * ahead
    return {
        "amplitude_nm": amplitude / _NM,
        "u_amplitude_nm": math.sqrt(max(float(along @ part @ along), 0.0)) / _NM,
        "phase_rad": math.remainder(phase, 2.0 * math.pi),
        "u_phase_rad": math.sqrt(max(float(across @ part @ across), 0.0)) / max(amplitude, 1e-300),
    }


def _p_equal_amplitudes(rows: Sequence[dict[str, float]]) -> float:
    """Return the chance of such different amplitudes if they were the same in every run."""
    from scipy.special import gammaincc

    if len(rows) < 2:
        return math.nan
    values = np.array([r["amplitude_nm"] for r in rows])
    weight = 1.0 / np.maximum(np.array([r["u_amplitude_nm"] for r in rows]), 1e-300) ** 2
    mean = float(values @ weight / weight.sum())
    chi2 = float(weight @ (values - mean) ** 2)
    return float(gammaincc((values.size - 1) / 2.0, chi2 / 2.0))


def _p_nothing(rows: Sequence[dict[str, float]]) -> float:
    """Return the chance of so great amplitudes of noise: two normal parts in each row."""
    from scipy.special import gammaincc

    chi2 = sum((r["amplitude_nm"] / max(r["u_amplitude_nm"], 1e-300)) ** 2 for r in rows)
    return float(gammaincc(len(rows), 0.5 * chi2))


def _mode_doubt(
    rows: Sequence[dict[str, float]], p_equal: float, prepared: Sequence[PreparedRun]
) -> str:
    """Say whether it may be a mode: a line has one amplitude, a mode another in every run."""
    width = 1.0 / max(float(np.ptp(r.t)) for r in prepared)
    mode = f"it may be a lightly damped mode, narrower than {width:.2g} Hz (one over the run)"
    if math.isnan(p_equal):
        return f"; one run cannot tell: {mode}"
    if p_equal >= _SAME_AMPLITUDE:
        return ""
    least, most = (f([r["amplitude_nm"] for r in rows]) for f in (min, max))
    return f"; its amplitude differs from run to run, {least:.3g} to {most:.3g} nm: {mode}"


def _line_sentence(entry: dict[str, Any], feeds: Sequence[float], *, locked: bool) -> str:
    falls = ", ".join(
        f"{w:.3g} mm at {v * _MM_PER_MIN:.0f} mm/min"
        for w, v in zip(entry["wavelengths_mm"], feeds, strict=True)
    )
    same = " with the same phase in every run" if locked else ""
    return (
        f"line at {entry['frequency_hz']:.2f} Hz (u {entry['u_frequency_hz']:.2g} Hz), amplitude "
        f"{entry['amplitude_nm']:.3g} nm (u {entry['u_amplitude_nm']:.2g} nm){same}, removed; it falls "
        f"onto {falls}"
    )


def report_robust(solution: Solution, prepared: Sequence[PreparedRun]) -> Report:
    """Return the share of the samples that lost their weight."""
    weights = solution.weights
    if weights is None:
        return {}, []
    marked = [float(m.mean()) for m in weights.marked]
    low = [float((w < 1.0).mean()) if w.size else 0.0 for w in weights.weight]
    sizes = np.array([r.x.size for r in prepared], dtype=np.float64)
    share = float(np.average(marked, weights=sizes))
    soft = float(np.average(low, weights=sizes))
    apart = _largest_rejected(solution, prepared)
    result = {
        "n_rejected": sum(int(m.sum()) for m in weights.marked),
        **apart,
        "share_rejected": share,
        "share_down_weighted": soft,
        "run": [r.run_id for r in prepared],
        "rejected": marked,
        "down_weighted": low,
    }
    told = (
        f"robust weights: {share * 100:.2g} % of the samples rejected, {soft * 100:.2g} % of the "
        "innovations down-weighted (4.6 % would be in Gaussian noise)"
    )
    if apart:
        told += (
            f"; the largest is {apart['largest_nm']:.4g} nm off, in run {apart['largest_run']!r} at "
            f"{apart['largest_at_mm']:.4g} mm"
        )
    sentences = [told]
    sentences += [
        f"{part * 100:.0f} % of run {run.run_id!r} were rejected: look at it, or leave it out"
        for run, part in zip(prepared, marked, strict=True)
        if part > _BAD_RUN
    ]
    return result, sentences


def _largest_rejected(solution: Solution, prepared: Sequence[PreparedRun]) -> dict[str, Any]:
    """Return size, run and position of the rejected reading farthest from the estimate."""
    assert solution.weights is not None  # noqa: S101  (of a robust fit)
    best: dict[str, Any] = {}
    for run, residual, marked in zip(
        prepared, solution.residuals, solution.weights.marked, strict=True
    ):
        size = np.where(marked & ~np.isnan(residual), np.abs(residual), 0.0)
        i = int(np.argmax(size))
        if size[i] > 0.0 and size[i] / _NM > abs(best.get("largest_nm", 0.0)):
            best = {
                "largest_nm": float(residual[i]) / _NM,
                "largest_run": run.run_id,
                "largest_at_mm": float(run.x[i]) * 1e3,
            }
    return best
