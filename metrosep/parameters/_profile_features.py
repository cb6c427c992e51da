"""Spatial, hybrid and feature parameters of a profile: al, sw, dl, pd, mpc, 5p, zJIS, 3z and their kin.

All work on bare heights at a uniform step, NaN = not measured; nothing is filled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.parameters.watershed import Peaks, significant_peaks

__all__ = [
    "Points",
    "autocorrelation_length",
    "developed_length",
    "mean_of_highest",
    "significant_points",
]

_THRESHOLD = 0.2
"""Of the autocorrelation (default of ISO 21920-3 and ISO 25178-3)."""
_LEAST_PAIRS = 0.1
"""Fewest pairs at a lag as a share of the valid samples."""
_FIVE = 5
_REACH = 3
"""Samples on each side of the 7-point derivatives."""
_SECOND = np.array([2.0, -27.0, 270.0, -490.0, 270.0, -27.0, 2.0]) / 180.0
_FIRST = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0


def autocorrelation_length(z: FloatArray, dx: float) -> float:
    """Return al, the shortest lag at which the autocorrelation has fallen to 0.2, m.

    Products are counted over their pairs, about the mean; linear between lags (ISO 21920-2:2021,
    4.3, recalled).
    """
    from scipy import fft

    good = ~np.isnan(z)
    n = int(good.sum())
    d = np.where(good, z - np.nanmean(z), 0.0)
    scale = float(np.abs(d).max())
    if scale == 0.0:
        raise DataError("zero height: all samples are equal")
    size = fft.next_fast_len(2 * z.size, real=True)
    sums, pairs = (
        fft.irfft(np.square(np.abs(fft.rfft(v, size))), size)[: z.size // 2 + 1]
        for v in (d / scale, good.astype(np.float64))
    )
    enough = pairs > _LEAST_PAIRS * n
    acf = np.where(enough, sums / np.maximum(pairs, 1.0), np.nan)
    acf = acf / acf[0]
    below = np.flatnonzero(acf <= _THRESHOLD)
    if below.size == 0:
        raise DataError(
            "the autocorrelation is still above 0.2 at half the profile: the profile is too short "
            "for its texture, or form or waviness was not removed"
        )
    k = int(below[0])
    return float((k - (_THRESHOLD - acf[k]) / (acf[k - 1] - acf[k])) * dx)


def developed_length(z: FloatArray, dx: float) -> tuple[float, float]:
    """Return dl, the sum of sqrt(dx^2 + dz^2) over neighbours that were both measured, and dr."""
    step = np.diff(z)
    step = step[~np.isnan(step)] / dx
    if step.size == 0:
        raise TooFewSamplesError("no two neighbouring samples were measured")
    # sqrt(1 + s^2) - 1 without cancellation for slopes of 1e-9
    excess = float(np.mean(step * step / (1.0 + np.sqrt(1.0 + step * step))))
    return step.size * dx * (1.0 + excess), excess


# ---- peaks and pits after watershed and Wolf pruning, over the evaluation length ------------------


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Significant peaks, or pits of a profile turned over."""

    z: FloatArray  # heights as evaluated, peaks upwards
    found: Peaks
    dx: float

    def __len__(self) -> int:
        return len(self.found)

    @property
    def density(self) -> float:
        """Number over the evaluation length, 1/m."""
        return len(self) / (self.z.size * self.dx)

    @property
    def five(self) -> float:
        """Mean height of the five highest, or of all where there are fewer, m."""
        if len(self) == 0:
            raise TooFewSamplesError("no significant peak or pit inside the evaluation length")
        return float(np.mean(self.found.heights[:_FIVE]))

    @property
    def curvature(self) -> float:
        """Mean curvature, positive, 1/m: 7-point z'' / (1 + z'^2)^1.5 with the sign turned."""
        at = self.found.columns
        at = at[(at >= _REACH) & (at < self.z.size - _REACH)]
        around = self.z[at[:, None] + np.arange(-_REACH, _REACH + 1)]
        around = around[~np.isnan(around).any(axis=1)]
        if around.size == 0:
            raise TooFewSamplesError(
                "no significant peak or pit has three measured samples on both sides"
            )
        slope, bend = around @ _FIRST / self.dx, around @ _SECOND / self.dx**2
        return float(np.mean(-bend / (1.0 + slope**2) ** 1.5))


def significant_points(z: FloatArray, dx: float, threshold: float) -> Points:
    """Return the peaks that stand at least a threshold above the higher of their two saddles."""
    found = significant_peaks(z[None, :], largest_hole=0, threshold=threshold)
    return Points(z, found, dx)


# ---- RzJIS and R3z: highest portions of each section ----------------------------------------------


def mean_of_highest(z: FloatArray, ranks: slice, least: float) -> float:
    """Return the mean of the hills of these ranks plus that of the dales, between crossings of 0.

    Hills and dales lower than `least` do not count. Ranks from 0, the highest first.
    """
    sides = []
    for side, name in ((z, "hills"), (-z, "dales")):
        heights = _portions(side)
        heights = np.sort(heights[heights >= least])[::-1]
        if heights.size < ranks.stop:
            raise TooFewSamplesError(
                f"a section holds {heights.size} {name}, {ranks.stop} are needed; use longer sections"
            )
        sides.append(float(np.mean(heights[ranks])))
    return sides[0] + sides[1]


def _portions(z: FloatArray) -> FloatArray:
    """Return the extreme of each run of samples above zero."""
    up = np.concatenate([[False], np.nan_to_num(z, nan=-1.0) > 0.0, [False]])
    edges = np.flatnonzero(np.diff(up.astype(np.int8))).reshape(-1, 2)
    return np.array([z[a:b].max() for a, b in edges])
