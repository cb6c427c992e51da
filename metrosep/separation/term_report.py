"""What the extra terms of the joint model came out as: plain tables and sentences.

Each function returns a mapping of plain values with unit suffixes and the sentences that belong
to it. Nothing here changes a result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.runset import RunSet
from metrosep.separation.design import PreparedRun
from metrosep.separation.solver import Solution

__all__ = ["Report", "report_drift", "report_lines", "report_robust"]

Report = tuple[dict[str, Any], list[str]]

_NM, _MM = 1e-9, 1e-3
_MM_PER_MIN = 6e4
_BAD_RUN = 0.2
"""Share of samples of a run beyond which it is named."""

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
            "one direction at one feedrate: a drift that is the same in every run cannot be told "
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
        doubt = "" if terms.locked else _mode_doubt(rows, p_equal, prepared)
        sentences.append(_line_sentence(entry, runs.feeds, locked=terms.locked) + doubt)
    if not terms.frequencies:
        sentences.append("no deterministic line stands out of the noise beyond chance")
    elif len(runs.feeds) == 1:
        sentences.append(
            "one feedrate only: geometry at the wavelength of a line cannot be told from the line "
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
