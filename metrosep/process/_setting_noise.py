"""Private: covariance of a tool setting when the noise of neighbouring points is not independent.

The correlation of the residual at every lag along x and y is taken where it stands out of its own
scatter around lag zero. With C the matrix of these correlations and J the derivatives, the covariance
is ``s^2 G^-1 (J^T C J) G^-1``, ``G = J^T J``: that of the estimate actually made, white or not. For
derivatives that change slowly it is the plain one times the sum of the correlations over all lags.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.process._setting_equations import FREEDOMS, modelled, solve
from metrosep.process._setting_steps import Settled, Task

_TILE = 1024
"""Pixels a side that are transformed at once."""
_FARTHEST = 3
"""Lags beyond this part of the map hold too few pairs."""
_SURE = 3.0
"""Standard errors by which a correlation must stand out of its scatter."""
_LEAST = 1e-15
"""m: a residual below this is rounding."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """How the residuals of points near one another correlate."""

    # shape (2 n_y + 1, 2 n_x + 1): correlation by lag, 1 in the middle, 0 where it does not stand
    # out
    kernel: FloatArray
    along_x: float = 0.0  # of next neighbours; 0 where there are none
    along_y: float = 0.0

    @property
    def is_white(self) -> bool:
        """Whether no neighbours correlate."""
        return self.kernel.size == 1

    @property
    def alike(self) -> float:
        """Points that say the same together: the sum over all lags."""
        return float(self.kernel.sum())


WHITE = Correlation(np.ones((1, 1)))


def correlation(task: Task, residual: FloatArray) -> Correlation:
    """Return the correlation of the residuals on a map or profile; white for scattered points."""
    if task.points.is_scattered:
        return WHITE
    z = np.atleast_2d(residual)
    lags = tuple(min(n // _FARTHEST, _TILE // _FARTHEST) for n in z.shape)
    products, pairs = _lagged(z, (lags[0], lags[1]))
    middle = lags[0], lags[1]
    if pairs[middle] < 10 or products[middle] <= _LEAST**2 * pairs[middle]:
        return WHITE
    with np.errstate(divide="ignore", invalid="ignore"):
        r = products / pairs * (pairs[middle] / products[middle])
    r[pairs < 0.5] = np.nan
    kernel = np.nan_to_num(np.where(_standing_out(r, pairs), r, 0.0))
    rows, columns = np.flatnonzero(kernel.any(axis=1)), np.flatnonzero(kernel.any(axis=0))
    r = np.nan_to_num(r)
    along_x = float(r[lags[0], lags[1] + 1]) if lags[1] else 0.0
    along_y = float(r[lags[0] + 1, lags[1]]) if lags[0] else 0.0
    cropped = kernel[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return Correlation(cropped, along_x, along_y)


def covariance(
    task: Task, settled: Settled, square: float, found: Correlation
) -> tuple[FloatArray, float]:
    """Return the covariance of the used freedoms, and the variance of one height.

    The variance is `square`, if stated (> 0), or from the residual, less what the fit takes up of
    correlated noise.
    """
    sums, choice = settled.sums, settled.choice
    _, inverse = solve(sums, choice)
    if found.is_white:
        variance = square or sums.square / (sums.n - len(choice.used))
        return variance * inverse, variance
    rows = choice.rows
    norms = np.sqrt(np.diag(sums.gram)[rows])
    gram = sums.gram[np.ix_(rows, rows)] / np.outer(norms, norms)
    lagged = _lagged_gram(task, settled, found.kernel)[np.ix_(rows, rows)] / np.outer(norms, norms)
    size, turn = np.linalg.eigh(gram)
    root = turn / np.sqrt(size)
    raised, axes = np.linalg.eigh(root.T @ lagged @ root)
    raised = np.maximum(raised, 1.0)
    taken = min(float(raised.sum()), 0.5 * sums.n)
    variance = square or sums.square / (sums.n - taken)
    half = root @ axes * np.sqrt(raised) / norms[:, None]
    return variance * (half @ half.T), variance


def _lagged(z: FloatArray, lags: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return sums of products and numbers of pairs by lag, both (2 n_y + 1, 2 n_x + 1)."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    shape = (2 * lags[0] + 1, 2 * lags[1] + 1)
    products, pairs = np.zeros(shape), np.zeros(shape)
    for i in range(0, z.shape[0], _TILE):
        for j in range(0, z.shape[1], _TILE):
            tile = z[i : i + _TILE, j : j + _TILE]
            known = ~np.isnan(tile)
            size = [
                next_fast_len(max(n, lag + 1) + lag, real=True)
                for n, lag in zip(tile.shape, lags, strict=True)
            ]
            for values, sums in ((np.where(known, tile, 0.0), products), (known * 1.0, pairs)):
                power = np.abs(rfft2(values, s=size)) ** 2
                around = np.fft.fftshift(irfft2(power, s=size))
                y, x = size[0] // 2, size[1] // 2
                sums[...] += around[y - lags[0] : y + lags[0] + 1, x - lags[1] : x + lags[1] + 1]
    return products, pairs


def _standing_out(r: FloatArray, pairs: FloatArray) -> NDArray[np.bool_]:
    """Return where the correlation around lag zero stands out of its scatter, as one region."""
    from scipy.ndimage import label

    middle = r.shape[0] // 2, r.shape[1] // 2
    region = np.zeros(r.shape, dtype=bool)
    region[middle] = True
    for _ in range(2):
        # Bartlett: the scatter of far lags grows with the sum of squares of the near ones
        scatter = np.sqrt(float(np.nansum(r[region] ** 2)) / np.maximum(pairs, 1.0))
        # lags without a pair join what lies on both sides of them, and add nothing
        marks = np.asarray(
            label(np.isnan(r) | (r > _SURE * scatter), structure=np.ones((3, 3)))[0]
        )
        region = marks == marks[middle]
    return region


def _lagged_gram(task: Task, settled: Settled, kernel: FloatArray) -> FloatArray:
    """Return ``J^T C J`` over the used points: one derivative against the correlated others."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    points, reach = task.points, (kernel.shape[0] // 2, kernel.shape[1] // 2)
    total = np.zeros((len(FREEDOMS), len(FREEDOMS)))
    core = max(64, _TILE // 4)
    n_y, n_x = points.z.shape
    with one_blas_thread():
        for i in range(0, n_y, core):
            for j in range(0, n_x, core):
                top, left = max(i - reach[0], 0), max(j - reach[1], 0)
                rows = slice(top, min(i + core + reach[0], n_y))
                columns = slice(left, min(j + core + reach[1], n_x))
                wide = _derivatives(task, settled, rows, columns)
                size = [
                    next_fast_len(n + 2 * lag, real=True)
                    for n, lag in zip(wide.shape[1:], reach, strict=True)
                ]
                spread = rfft2(kernel, s=size)
                inside = (
                    slice(i - top, min(i + core, n_y) - top),
                    slice(j - left, min(j + core, n_x) - left),
                )
                near = np.stack(
                    [
                        irfft2(rfft2(column, s=size) * spread, s=size)[
                            reach[0] : reach[0] + wide.shape[1],
                            reach[1] : reach[1] + wide.shape[2],
                        ][inside]
                        for column in wide
                    ]
                )
                own = wide[:, inside[0], inside[1]]
                total += own.reshape(len(own), -1) @ near.reshape(len(near), -1).T
    return 0.5 * (total + total.T)


def _derivatives(task: Task, settled: Settled, rows: slice, columns: slice) -> FloatArray:
    """Return the derivatives on part of the map, 0 at points that are not used."""
    z = task.points.z[rows, columns]
    x = np.broadcast_to(task.points.x[columns], z.shape)
    y = np.broadcast_to(task.points.y[rows, None], z.shape)
    model, found = modelled(task.form, x.ravel(), y.ravel(), settled.values)
    used = ~np.isnan(z.ravel()) & ~np.isnan(model) & np.isfinite(found).all(axis=0)
    used &= settled.region.holds(x.ravel(), y.ravel())
    return np.where(used, found, 0.0).reshape(len(found), *z.shape)


def neighbours_of_scattered(x: FloatArray, y: FloatArray, z: FloatArray) -> float:
    """Return the correlation of residuals with that of the nearest other point."""
    from scipy.spatial import cKDTree

    known = ~np.isnan(z)
    if np.count_nonzero(known) < 10:
        return 0.0
    places, values = np.column_stack([x[known], y[known]]), z[known]
    nearest = np.asarray(cKDTree(places).query(places, k=2)[1])
    first, second = values, values[nearest[:, 1]]
    first, second = first - first.mean(), second - second.mean()
    size = float(first @ first) * float(second @ second)
    return float(first @ second) / math.sqrt(size) if size > 0.0 else 0.0
