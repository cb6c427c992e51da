"""The plain mean over runs: the baseline that every other method must beat.

All runs are interpolated linearly onto one grid and averaged. Vibration that is not in phase with
the start of the runs falls as one over the square root of their number; nothing else is removed.
With ``robust`` readings that stand out of the other runs at their place are left out.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import flag
from metrosep.core.quantity import Quantity
from metrosep.core.runset import Run, RunSet
from metrosep.separation.covariance import CovarianceModes
from metrosep.separation.runs.base import (
    LINE_POINTS,
    DirectionEstimate,
    ErrorEstimate,
    SampledCurve,
)
from metrosep.separation.runs.design import (
    evaluation_range,
    lines_of_runs,
    on_common_grid,
    travel_of,
)
from metrosep.separation.runs.run_comparison import RunTable, spikes
from metrosep.separation.runs.spectra import feed_spectra_columns


def separate_mean(
    runs: RunSet,
    *,
    length: float | None = None,
    start: float | None = None,
    feed: float | None = None,
    robust: bool = False,
) -> ErrorEstimate:
    """Return the mean of the runs, line over the evaluation range removed.

    sd: the standard deviation over the runs by the root of their number, NaN for a single run.
    """
    used = runs if feed is None else runs.select(feed=feed)
    left_out: dict[str, Any] = {}
    sentences: list[str] = []
    if flag(robust, "robust"):
        used, left_out, sentences = _without_spikes(used)
    first, last = evaluation_range(used, start=start, length=length, method="mean")
    low, high = travel_of(used)
    low, high = min(low, first), max(high, last)
    grid, table, pitch = on_common_grid(used, low, high)
    inner = (grid >= first - pitch) & (grid <= last + pitch)
    line = np.column_stack([np.ones(grid.size), (grid - low) / (high - low)])
    shares, joined = lines_of_runs(used, table, line, inner)
    flat = table - shares @ line.T
    n_valid = (~np.isnan(flat)).sum(axis=0)
    if not (n_valid[inner] > 0).any():
        raise DataError("no position in the evaluation range was measured in any run")
    mean = np.full(grid.size, np.nan)
    some = n_valid > 0
    mean[some] = np.nansum(flat[:, some], axis=0) / n_valid[some]
    sd = np.full(grid.size, np.nan)
    many = n_valid > 1
    # sd^2 = sum_r d_r^2 / (n (n - 1)): the deviations themselves are the modes of the covariance.
    apart = np.nan_to_num(flat - mean) / np.sqrt(np.maximum(n_valid * (n_valid - 1.0), 1.0))
    parts = (apart * many).T
    if joined is not None:
        parts = np.hstack([parts, _of_the_joints(flat - mean, line, inner, joined)])
    sd[many] = np.sqrt((parts[many] ** 2).sum(axis=1))
    modes = CovarianceModes.of(grid, parts) if many.any() else None
    residual_rms = float(np.sqrt(np.nanmean((flat - mean) ** 2)))
    mean, rest = _level(grid, mean, first, last)
    scale = high - low
    n = len(used)
    slopes = shares[:, 1]
    slope = float(slopes.mean() / scale) + rest
    audit = _audit(used, pitch)
    if joined is not None:
        audit["line_removed"] = (
            "least squares over the evaluation range, of all runs and the mean together"
        )
        alone = float((n_valid[inner] == 1).mean())
        sentences.append(_JOINED + (_ALONE.format(100.0 * alone) if alone else ""))
    if robust:  # lost motion is taken from these, not from readings that were left out
        audit["run_levels_nm"] = _levels(used, SampledCurve(grid, mean), slope, (first, last))
    return ErrorEstimate(
        method="mean",
        start=first,
        stop=last,
        fit_range=(low, high),
        directions_data={
            0: DirectionEstimate(SampledCurve(grid, mean), SampledCurve(grid, sd), modes=modes)
        },
        slope=Quantity(
            slope,
            "rad",
            "mean slope of the least-squares lines over the evaluation range (alignment)",
            u=float(slopes.std(ddof=1) / math.sqrt(n) / scale) if n > 1 else None,
        ),
        spectrum_data={name: [] for name in _SPECTRUM},
        feed_spectra_data=feed_spectra_columns(used),
        residual_psd_data={"frequency_hz": [], "psd_nm2_per_hz": [], "model_nm2_per_hz": []},
        residual_rms=residual_rms,
        audit=audit,
        messages=(*_messages(used), *sentences),
        history=used.history,
        terms={"robust": left_out} if left_out else {},
    )


_SPECTRUM = (
    "wavelength_mm",
    "amplitude_nm",
    "phase_rad",
    "sd_nm",
    "snr",
    "p",
    "selected",
    "reason",
)


_JOINED = (
    "the runs have holes in different places: their offsets and slopes are fitted together over the "
    "positions they share, and what these leave open is in the uncertainty"
)
_ALONE = "; over {:.2g} % of the evaluation range one run alone was measured: no uncertainty is known there"


def _of_the_joints(
    apart: FloatArray, line: FloatArray, inner: NDArray[np.bool_], normal: FloatArray
) -> FloatArray:
    """Return modes of the mean, shape (n_grid, 2 R), of what is open in lines that were fitted together.

    cov c = s^2 tau N^+; tau is the sum of the autocorrelations of the deviations up to the first
    that is not positive: so many neighbours count as one reading.
    """
    valid = ~np.isnan(apart)
    counts = valid.sum(axis=0)
    shared = valid & inner & (counts > 1)
    d = np.where(shared, apart, 0.0)
    free = (counts[shared.any(axis=0)] - 1.0).sum() - line.shape[1] * (len(apart) - 1.0)
    s2 = float((d**2).sum()) / max(float(free), 1.0)
    size = 2 * apart.shape[1]
    power, pairs = ((np.abs(np.fft.rfft(a, size)) ** 2).sum(axis=0) for a in (d, 1.0 * shared))
    products, numbers = (np.fft.irfft(p, size)[: size // 2] for p in (power, pairs))
    rho = products / np.maximum(numbers, 1.0) * (float(shared.sum()) / (float(products[0]) or 1.0))
    end = int(np.argmax(rho <= 0.0)) if (rho <= 0.0).any() else rho.size
    tau = 1.0 + 2.0 * float(rho[1:end].sum())
    values, vectors = np.linalg.eigh(normal)
    good = values > 1e-12 * values[-1]
    root = vectors[:, good] * np.sqrt(s2 * tau / values[good])
    share = valid / np.maximum(counts, 1)  # d mean / d c_r = -line(x) valid_r(x) / n(x)
    columns = (share.T[:, :, None] * line[:, None, :]).reshape(line.shape[0], -1) @ root
    used = inner & (counts > 0)
    return np.asarray(columns - line @ np.linalg.lstsq(line[used], columns[used], rcond=None)[0])


def _level(
    grid: FloatArray, mean: FloatArray, first: float, last: float
) -> tuple[FloatArray, float]:
    """Return the mean without what is left of its line over the evaluation range."""
    x = np.linspace(first, last, LINE_POINTS)
    z = SampledCurve(grid, mean)(x)
    valid = ~np.isnan(z)
    slope, level = np.polyfit(x[valid] - first, z[valid], 1)
    return mean - level - slope * (grid - first), float(slope)


def _levels(
    runs: RunSet, mean: SampledCurve, slope: float, span: tuple[float, float]
) -> list[float]:
    """Return the mean of each run less the estimate, in the middle of the evaluation range, nm."""
    out = []
    for run in runs:
        inner = (run.x >= span[0]) & (run.x <= span[1])
        x = run.x[inner]
        rest = run.z[inner] - mean(x) - slope * (x - 0.5 * (span[0] + span[1]))
        out.append(1e9 * level_in_the_middle(x, rest, span))
    return out


def level_in_the_middle(x: FloatArray, rest: FloatArray, span: tuple[float, float]) -> float:
    """Return the value in the middle of a range of the line through what was measured, NaN of nothing.

    The mean would be that only where the run has no holes, or no slope of its own.
    """
    valid = np.isfinite(rest)
    if valid.sum() < 3:
        return float(np.mean(rest[valid])) if valid.any() else math.nan
    middle, half = 0.5 * (span[0] + span[1]), 0.5 * (span[1] - span[0])
    return float(np.polynomial.polynomial.polyfit((x[valid] - middle) / half, rest[valid], 1)[0])


def _audit(runs: RunSet, pitch: float) -> dict[str, Any]:
    return {
        "n_runs": len(runs),
        "feeds_mm_per_min": [f * 6e4 for f in runs.feeds],
        "grid_step_mm": pitch * 1e3,
        "line_removed": "least squares over the evaluation range, run by run",
    }


def _messages(runs: RunSet) -> tuple[str, ...]:
    sentences = []
    if len(runs) == 1:
        sentences.append("one run only: there is no scatter to tell an uncertainty from")
    if len(runs.feeds) < 2:
        sentences.append(
            "one feedrate only: a vibration that starts in phase with the run cannot be distinguished from "
            "geometry; add runs at another feedrate"
        )
    return tuple(sentences)


def _without_spikes(runs: RunSet) -> tuple[RunSet, dict[str, Any], list[str]]:
    """Return the runs without the readings that stand out, which these are, and what to say."""
    table = RunTable.of(runs, range(len(runs)))
    if len(runs) < 3 or table is None:
        raise TooFewSamplesError(
            f"robust compares each reading with the median of the other runs: it needs 3 runs of 24 "
            f"common positions, got {len(runs)} run(s); measure further or leave robust out"
        )
    kept: list[Run] = []
    share: list[float] = []
    largest: dict[str, Any] = {"largest_nm": 0.0}
    for run, far, away in spikes(runs, table):
        z = run.z.copy()
        z[far] = np.nan
        kept.append(
            Run(run.x, z, t=run.t, feed=run.feed, run_id=run.run_id, metadata=run.metadata)
        )
        share.append(far.size / len(run))
        i = int(far[np.argmax(np.abs(away[far]))]) if far.size else -1
        if i >= 0 and abs(away[i]) * 1e9 > abs(largest["largest_nm"]):
            largest = {
                "largest_nm": float(away[i]) * 1e9,
                "largest_run": run.run_id,
                "largest_at_mm": float(run.x[i]) * 1e3,
            }
    n = sum(r.n_invalid for r in kept) - sum(r.n_invalid for r in runs)
    left_out = n / sum(len(r) for r in runs)
    result = {
        "n_rejected": n,
        **(largest if n else {}),
        "share_rejected": left_out,
        "run": [r.run_id for r in runs],
        "rejected": share,
    }
    said = f"robust mean: {100 * left_out:.2g} % of the readings were omitted"
    if n:
        said += (
            f" ({n}); the largest is {largest['largest_nm']:.4g} nm off, in run "
            f"{largest['largest_run']!r} at {largest['largest_at_mm']:.4g} mm"
        )
    return RunSet(kept, metadata=runs.metadata, history=runs.history), result, [said]
