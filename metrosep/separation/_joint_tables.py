"""Private to separation: spectrum, residual and audit of the joint solution as plain columns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.false_discovery import benjamini_hochberg
from metrosep.core.runset import RunSet
from metrosep.separation.design import PreparedRun
from metrosep.separation.solver import Solution
from metrosep.spectral.psd import pooled_periodogram

__all__ = ["joint_audit", "residual_psd_columns", "spectrum_columns"]


_NM, _MM = 1e-9, 1e-3

_SHORTEST_SEGMENT = 16
"""Samples without a gap from which a spectrum of the residual is taken."""

_BLIND = "beyond the noise model, but not separable by repeatability"

_LINE_CELLS = 1.0
"""A line falls onto a wavelength within so many resolution cells of the travel."""


def spectrum_columns(solution: Solution, runs: RunSet, *, rate: float) -> dict[str, list[Any]]:
    """Return amplitude, evidence and reason of each wavelength of the basis."""
    n_all, kept = solution.amplitude.size, solution.n_harmonics
    k = np.arange(1, n_all + 1)
    wavelength = solution.period / k
    cosine, sine = np.zeros(n_all), np.zeros(n_all)
    cosine[:kept] = solution.coefficients[1 : kept + 1]
    sine[:kept] = solution.coefficients[kept + 1 :]
    p_values = np.exp(-solution.chi2 / 2.0)
    selected = benjamini_hochberg(p_values, rate=rate)
    selected[kept:] = False
    taken = _under_a_line(solution, runs, wavelength)
    selected[list(taken)] = False
    blind = _not_separable(runs, wavelength)
    reasons = [
        taken.get(i) or _reason(chosen=bool(selected[i]), kept=i < kept, blind=bool(blind[i]))
        for i in range(n_all)
    ]
    amplitude = np.hypot(cosine, sine)
    amplitude[kept:] = 0.0
    return {
        "wavelength_mm": (wavelength / _MM).tolist(),
        "amplitude_nm": (amplitude / _NM).tolist(),
        "phase_rad": (-np.arctan2(sine, cosine)).tolist(),
        "sd_nm": (solution.amplitude_sd / _NM).tolist(),
        "snr": (solution.amplitude / solution.amplitude_sd).tolist(),
        "p": p_values.tolist(),
        "selected": [bool(s) for s in selected],
        "reason": reasons,
    }


def _reason(*, chosen: bool, kept: bool, blind: bool) -> str:
    if not kept:
        return "no evidence at this wavelength or shorter"
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


def residual_psd_columns(runs: list[PreparedRun], solution: Solution) -> dict[str, list[Any]]:
    """Return the spectrum of the residual at the sampling interval that most samples have."""
    steps = [m.time_step for m in solution.noise]
    owner = [int(np.argmin([abs(r.time_step - s) for s in steps])) for r in runs]
    sizes = [
        sum(r.x.size for r, o in zip(runs, owner, strict=True) if o == g)
        for g in range(len(steps))
    ]
    group = int(np.argmax(sizes))
    model = solution.noise[group]
    records = [r for r, o in zip(solution.bridged, owner, strict=True) if o == group]
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
        "lag_test": _lag_audit(solution),
        "line_removed": "least squares over the evaluation range",
        "run_offsets_nm": (solution.offsets / _NM).tolist(),
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
        "fitted": test.fitted,
    }
