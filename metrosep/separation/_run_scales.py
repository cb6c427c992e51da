"""Private to separation: the height scale of a set of runs, and which runs share a noise model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.separation.design import PreparedRun
from metrosep.separation.weights import MAD

__all__ = ["mad_about_medians", "rms_about_line", "time_step_groups"]


def rms_about_line(runs: Sequence[PreparedRun]) -> float:
    """Return the RMS of the readings about one slope and an offset for each run."""
    pairs = [
        (r.x[v] - r.x[v].mean(), r.z[v] - r.z[v].mean()) for r in runs for v in [~np.isnan(r.z)]
    ]
    x, z = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(np.sqrt(np.mean((z - (x @ z) / (x @ x) * x) ** 2)))


def mad_about_medians(runs: Sequence[PreparedRun]) -> float:
    """Return a robust spread of the readings about the median slope and an offset for each run."""
    steps = [np.nanmedian(np.diff(r.z[:: max(1, r.x.size // 20)])) for r in runs]
    pitches = [float(np.median(np.diff(r.x[:: max(1, r.x.size // 20)]))) for r in runs]
    slope = float(np.median(np.array(steps) / np.array(pitches)))
    flat = [r.z - slope * r.x for r in runs]
    pooled = np.abs(np.concatenate([f - np.nanmedian(f) for f in flat]))
    return MAD * float(np.nanmedian(pooled))


def time_step_groups(runs: Sequence[PreparedRun]) -> list[list[int]]:
    """Group the runs that share a noise model: sampling interval and probe."""
    groups: list[list[int]] = []
    for i in sorted(range(len(runs)), key=lambda j: -runs[j].time_step):
        for group in reversed(groups):
            first = runs[group[0]]
            if runs[i].time_step > 0.99 * first.time_step and runs[i].probe == first.probe:
                group.append(i)
                break
        else:
            groups.append([i])
    return groups
