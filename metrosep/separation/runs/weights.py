r"""Private to separation: weights by which spikes and bad stretches do not move the estimate.

A wrong sample spoils all the innovations that it enters, one more than the order of the noise
model. So samples whose own error :math:`\hat\delta_i = \sum_j h_j \epsilon_{i+j} / \sum_j h_j^2`
(h the whitening filter) is beyond chance are marked and each becomes an unknown, which costs one
degree of freedom; the innovations that are left get Huber's weights.

Sources: Huber 1964; Chen and Liu 1993 (additive outliers in time series).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.separation.runs.noise import MAD, MissingSamples, NoiseModel, exact_rows, stretches

_MARK = 4.5
"""A sample is marked where its own error exceeds so many standard deviations: 7 in a million."""

_HUBER = 2.0
"""Innovations beyond so many standard deviations lose weight; 99 % efficiency for Gaussian noise."""

_PASSES = 40
"""Most passes in which samples are marked."""

_LEVEL = 2.0
"""The level of a bad stretch is at least so many standard deviations of one sample."""

_CLIP = 3.0
"""Residuals are cut at so many standard deviations before their level is taken."""

_FEW_RUNS = 3
"""Fewer runs at a place have no median that tells a bad stretch from geometry."""

_NEIGHBOURS = 7
"""Samples on each side whose median a gross outlier is compared with before the first fit."""

_WINDOWS = (1, 8, 32)
"""Samples over which the level of the residual is looked at."""

_MAX_SHARE = 0.3
"""No more than this share of a run is marked: beyond it the run is bad, not the samples."""


@dataclass(slots=True, eq=False)
class RowWeights:
    """Marked samples and weights of the innovations of all runs."""

    positions: list[FloatArray]  # of ndarray, shape (n_r,), m: of the samples
    marked: list[BoolArray]  # of ndarray of bool, shape (n_r,): samples that are unknowns
    # of ndarray, shape (m_r,): of the whitened rows; empty before the first `update`
    weight: list[FloatArray] = field(default_factory=list)
    # information of a weighted row over that of a row of the noise model's variance
    efficiency: list[float] = field(default_factory=list)

    @classmethod
    def gross(cls, readings: Sequence[FloatArray], positions: Sequence[FloatArray]) -> RowWeights:
        """Return marks of the samples that stand out of the readings themselves, weights of 1."""
        marked = []
        for z in readings:
            smooth = _running_median(z)
            rest = z - smooth
            scale = MAD * float(np.nanmedian(np.abs(rest)))
            away = np.abs(z - np.nanmedian(z))
            far = np.nan_to_num(np.abs(rest) > 2.0 * _MARK * scale, nan=0.0).astype(bool)
            far |= away > 4.0 * _MARK * MAD * float(np.nanmedian(away))
            marked.append(far & ~np.isnan(z) if far.mean() < _MAX_SHARE else np.zeros_like(far))
        return cls(list(positions), marked)

    def information(self, index: int) -> float:
        """Return the information of a weighted row over that of an unweighted one."""
        return self.efficiency[index] if self.efficiency else 1.0

    def clean(
        self,
        residuals: Sequence[FloatArray],
        groups: Sequence[Sequence[int]],
        noise: Sequence[NoiseModel],
    ) -> list[FloatArray]:
        """Mark anew, and take what is marked out of the residuals."""
        cleaned = [r.copy() for r in residuals]
        apart = _without_common(residuals, self.positions)
        for group, model in zip(groups, noise, strict=True):
            own = [apart[i] for i in group]
            scale = _robust_scale(own, model)
            for i, stretch in zip(group, _stretches(own), strict=True):
                self.marked[i] = _mark(apart[i], model, scale, stretch)
                if self.marked[i].any():
                    cleaned[i] = _replaced(residuals[i], self.marked[i], model)
        return cleaned

    def bridged(
        self,
        residuals: Sequence[FloatArray],
        groups: Sequence[Sequence[int]],
        noise: Sequence[NoiseModel],
    ) -> list[FloatArray]:
        """Return the residuals, marked samples replaced by what the noise model expects there."""
        out = [r.copy() for r in residuals]
        for group, model in zip(groups, noise, strict=True):
            for i in group:
                if self.marked[i].any():
                    out[i] = _replaced(residuals[i], self.marked[i], model)
        return out

    def weigh(
        self,
        cleaned: Sequence[FloatArray],
        groups: Sequence[Sequence[int]],
        noise: Sequence[NoiseModel],
    ) -> None:
        """Give every innovation its weight."""
        self.weight = [np.empty(0)] * len(cleaned)
        self.efficiency = [1.0] * len(cleaned)
        for group, model in zip(groups, noise, strict=True):
            own = {i: _innovations(cleaned[i], model) for i in group}
            pooled = np.concatenate([e[~np.isnan(e)] for e in own.values()])
            scale = max(MAD * float(np.median(np.abs(pooled))), 1e-15)
            efficiency = _efficiency(pooled, scale)
            for i, innovation in own.items():
                known = ~np.isnan(innovation)
                self.weight[i] = np.ones(known.size)
                self.weight[i][known] = _huber(innovation[known], scale)
                self.efficiency[i] = efficiency


def _running_median(z: FloatArray) -> FloatArray:
    """Return the median of each sample and its neighbours, NaN left out."""
    padded = np.pad(z, _NEIGHBOURS, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1)
    missing = np.asarray(np.isnan(windows).all(axis=1))
    filled = np.where(missing[:, None], 0.0, windows)
    return np.asarray(np.nanmedian(filled, axis=1))


def _innovations(residual: FloatArray, model: NoiseModel) -> FloatArray:
    """Return the whitened residual from its first sample on, NaN where not measured."""
    parts = stretches(residual)
    out = np.full(residual.size, np.nan)
    rows = exact_rows([residual[:, None]], model, parts)[:, 0]
    for part in parts:
        out[part], rows = np.split(rows, [part.stop - part.start])
    return out


def _robust_scale(residuals: Sequence[FloatArray], model: NoiseModel) -> float:
    pooled = np.concatenate([_innovations(r, model) for r in residuals])
    return max(MAD * float(np.nanmedian(np.abs(pooled))), 1e-15)


def _without_common(
    residuals: Sequence[FloatArray], positions: Sequence[FloatArray]
) -> list[FloatArray]:
    """Take out what most runs show at the same place: an error not yet fitted, no bad stretch."""
    low = min(float(x.min()) for x in positions)
    high = max(float(x.max()) for x in positions)
    grid = np.linspace(low, high, max(x.size for x in positions))
    table = np.full((len(residuals), grid.size), np.nan)
    for row, residual, x in zip(table, residuals, positions, strict=True):
        valid = ~np.isnan(residual)
        order = np.argsort(x[valid])
        row[:] = np.interp(
            grid, x[valid][order], residual[valid][order], left=np.nan, right=np.nan
        )
    known = (~np.isnan(table)).sum(axis=0) >= _FEW_RUNS
    common = np.zeros(grid.size)
    if known.any():
        common[known] = np.nanmedian(table[:, known], axis=0)
    return [r - np.interp(x, grid, common) for r, x in zip(residuals, positions, strict=True)]


def _stretches(residuals: Sequence[FloatArray]) -> list[BoolArray]:
    """Mark where the mean over a window leaves the spread of all such means of these runs.

    A noise model that has seen a bad stretch takes it for noise; its level gives it away.
    """
    marked = [np.zeros(r.size, dtype=bool) for r in residuals]
    single = MAD * float(np.nanmedian(np.abs(np.concatenate(residuals))))
    for width in _WINDOWS:
        top = _CLIP * single if width > 1 else np.inf  # one spike must not spoil a window
        means = [_moving_mean(np.clip(r, -top, top), width) for r in residuals]
        pooled = np.concatenate(means)
        scale = MAD * float(np.nanmedian(np.abs(pooled)))
        for mask, residual, mean in zip(marked, residuals, means, strict=True):
            limit = max(_MARK * scale, _LEVEL * single)
            far = np.nan_to_num(np.abs(mean), nan=0.0) > limit
            if width > 1:
                far = np.convolve(far, np.ones(width // 2 + 1), mode="same") > 0.5
            np.logical_or(mask, far & ~np.isnan(residual), out=mask)
    return [m if m.mean() < _MAX_SHARE else np.zeros_like(m) for m in marked]


def _moving_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean of the measured samples around each; NaN where half of them are missing."""
    valid = ~np.isnan(values)
    ones = np.ones(width)
    count = np.convolve(valid.astype(np.float64), ones, mode="same")
    total = np.convolve(np.where(valid, values, 0.0), ones, mode="same")
    return np.where(count > 0.5 * width, total / np.maximum(count, 1.0), np.nan)


def _mark(residual: FloatArray, model: NoiseModel, scale: float, stretch: BoolArray) -> BoolArray:
    """Mark bad stretches, then the strongest samples; take them out, look again."""
    marked = stretch.copy()
    allowed = int(_MAX_SHARE * residual.size)
    for _ in range(_PASSES):
        cleaned = _replaced(residual, marked, model) if marked.any() else residual
        own, norm = _own_errors(_innovations(cleaned, model), model, stretches(residual))
        statistic = np.abs(own) / (np.sqrt(np.maximum(norm, 1e-30)) * scale)
        statistic[marked | np.isnan(residual)] = 0.0
        left = np.concatenate([[0.0], statistic[:-1]])
        right = np.concatenate([statistic[1:], [0.0]])
        new = (statistic > _MARK) & (statistic >= left) & (statistic >= right)
        new &= statistic > 0.5 * statistic.max()
        if not new.any() or marked.sum() + new.sum() > allowed:
            break
        marked |= new
    return marked


def _own_errors(
    innovation: FloatArray, model: NoiseModel, parts: Sequence[slice]
) -> tuple[FloatArray, FloatArray]:
    """Return W'e and the diagonal of W'W, W the whitening: the error of each sample is their ratio."""
    own, norm = np.zeros(innovation.size), np.zeros(innovation.size)
    full, p = model.filters[-1] / np.sqrt(model.variance), model.order
    for part in parts:
        e = innovation[part]
        late = np.arange(e.size) >= p
        rows = np.pad(np.where(late, e, 0.0), (0, p))
        own[part] = np.correlate(rows, full, mode="valid")
        norm[part] = np.correlate(np.pad(late.astype(np.float64), (0, p)), full**2, mode="valid")
        for i in range(min(p, e.size)):  # the first rows have filters of lower order
            first = model.filters[i][::-1] / np.sqrt(model.variances[i])
            own[part][: i + 1] += first * e[i]
            norm[part][: i + 1] += first**2
    return own, norm


def _replaced(residual: FloatArray, marked: BoolArray, model: NoiseModel) -> FloatArray:
    """Replace the marked samples by the values of least squared innovations.

    The innovations are exact from the first sample on: rows of the full order alone hold the first
    sample with its last coefficient only, and a mark there would be replaced by anything.
    """
    parts, out = stretches(residual), residual.copy()
    missing = MissingSamples(marked, model, parts)
    out[marked] = 0.0
    out[marked] = missing.expected(exact_rows([out[:, None]], model, parts))[:, 0]
    return out


def _huber(innovation: FloatArray, scale: float) -> FloatArray:
    size = np.abs(innovation)
    return np.asarray(np.minimum(1.0, _HUBER * scale / np.maximum(size, 1e-300)))


def _efficiency(innovation: FloatArray, scale: float) -> float:
    """Return (E psi')^2 / (E psi^2 E w) in units of the inverse mean square."""
    inside = np.abs(innovation) < _HUBER * scale
    weight = _huber(innovation, scale)
    psi2 = float(np.mean((weight * innovation) ** 2))
    square = float(np.mean(innovation**2))
    if psi2 <= 0.0:
        return 1.0
    return float(np.mean(inside)) ** 2 * square / (psi2 * float(np.mean(weight)))
