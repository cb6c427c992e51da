r"""Private to separation: what repeats at the wavelength of a wave that slips.

Run r shows the pair :math:`q_r = c + p_r + e_r` of cosine and sine: c repeats, p_r has another phase
in each run, e_r is noise. What slips has a size of its own, from run to run more or less the same:

.. math::  p_r = \rho (\cos\varphi_r, \sin\varphi_r) + N(0, \tau^2), \qquad
           2 \tau^2 + \rho^2 = 2 \Lambda, \quad \tau = \kappa \sqrt\Lambda

so the pairs lie on a circle whose centre repeats, the sharper the smaller :math:`\kappa` is, and about
a point for :math:`\kappa = 1` (normal numbers). Given c the distance of a pair from it is Rice's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray

_REPEATS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Amplitudes that repeat, over that which slips: as likely before."""

_LEAST_CHANCE = 10.0
"""ln of how much likelier the best cell of a grid is than one that is not looked at more closely."""

_FINE = 0.05
"""Variance within a cell over that of what a run shows, below which a cell is not halved."""

_STARTS = 8
"""Cells of the first grid along each direction; each grid halves them."""


@dataclass(frozen=True, slots=True, eq=False)
class Repeating:
    """Mean and covariance of what repeats, its part in the spectrum first, then what is beside it."""

    mean: FloatArray  # shape (4,)
    covariance: FloatArray  # shape (4, 4)
    evidence: float  # ln, but for a constant


def what_repeats(pairs: FloatArray, noise: FloatArray, own: float) -> Repeating:
    """Return what repeats in pairs, shape (R, 2), of some noise, (R,), beside a spectrum that has `own`.

    Of the sum z that repeats the spectrum holds the share own / (own + what repeats beside it).
    """
    shows = float(np.median(noise))
    weights = 1.0 / (shows + noise)  # some run may show next to nothing
    weights /= weights.sum()
    middle = weights @ pairs
    away = float(weights @ np.sum((pairs - middle) ** 2, axis=1))
    size = max(0.5 * away * len(pairs) / (len(pairs) - 1.0), shows)
    # Before, kappa is 1 with the chance 1/2; else as likely any half of half of 1 that the noise shows.
    halves = 1 + math.ceil(0.5 * math.log2(size / shows))
    scatters = [1.0, *(0.25**i for i in range(1, 1 + halves))]
    parts = [
        _of_scatter(pairs, noise, own, kappa2, np.append(middle, math.log(size)))
        for kappa2 in scatters
    ]
    logs = np.array([p.evidence for p in parts])
    logs[1:] -= math.log(halves)
    chances = np.exp(logs - logs.max())
    evidence = float(logs.max()) + math.log(chances.sum())
    chances /= chances.sum()
    mean = chances @ np.array([p.mean for p in parts])
    covariance = sum(
        c * (p.covariance + np.outer(p.mean - mean, p.mean - mean))
        for c, p in zip(chances, parts, strict=True)
    )
    return Repeating(mean, np.asarray(covariance), evidence)


def _of_scatter(
    pairs: FloatArray, noise: FloatArray, own: float, kappa2: float, about: FloatArray
) -> Repeating:
    """Return what repeats where kappa^2 is given, on a grid over z and ln Lambda that follows the chance."""
    n = len(pairs)
    # ln Lambda, of 2 (R - 1) numbers, is known to 1/sqrt(R - 1); z lies within a circle about the pairs
    half = np.array(
        [3.0 * math.exp(0.5 * about[2]) * math.sqrt(2.0)] * 2 + [1.0 + 3.0 / math.sqrt(n - 1.0)]
    )
    shows = float(np.median(noise))
    step, at = 2.0 * half / _STARTS, (2.0 * np.arange(_STARTS) + 1.0) / _STARTS - 1.0
    cells = np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1).reshape(-1, 3) * half
    cells += about
    corners = 0.5 * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
    while True:
        # A cell is off in all runs alike: as much as it is off by, times their number, it is blurred.
        coarse, _, blurred = _chances(pairs, noise, own, kappa2, cells, step, 0.5 * n)
        most = coarse.max(axis=1)
        kept = most > most.max() - _LEAST_CHANCE
        fine = 0.5 * n * _FINE * (kappa2 * np.exp(cells[:, 2]) + shows)
        if np.all(blurred[kept] < fine[kept]):
            break
        step = 0.5 * step
        cells = (cells[kept][:, None] + corners * step).reshape(-1, 3)
    cells = cells[kept]
    logs, beside, _ = _chances(pairs, noise, own, kappa2, cells, step, 1.0)
    top = float(logs.max())
    chances = np.exp(logs - top)
    total = float(chances.sum())
    chances /= total
    before = own + beside
    share, narrow = own / before, step[0] ** 2 / 8.0 / (before + step[0] ** 2 / 8.0)
    z = [part[..., None] * cells[:, None, :2] for part in (share, 1.0 - share)]
    z = np.concatenate(z, axis=2) * (1.0 - narrow)[..., None]
    flat = z.reshape(-1, 4)
    mean = chances.ravel() @ flat
    away = (flat - mean) * np.sqrt(chances).reshape(-1, 1)
    covariance = away.T @ away
    # what is narrower than a cell: its own variance; and the split of a sum that is given
    hidden = chances * before * narrow**2
    whole, one, split = (
        float(np.sum(v))
        for v in (hidden * share**2, hidden * share, chances * own * (1.0 - share))
    )
    rest = float(hidden.sum()) - 2.0 * one + whole
    covariance += np.kron(
        [[whole + split, one - whole - split], [one - whole - split, rest + split]], np.eye(2)
    )
    return Repeating(mean, covariance, top + math.log(total) + float(np.log(step).sum()))


def _chances(
    pairs: FloatArray,
    noise: FloatArray,
    own: float,
    kappa2: float,
    cells: FloatArray,
    step: FloatArray,
    blur: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ln chance of cells and amplitudes, the variance that repeats, and that within a cell."""
    from scipy.special import i0e

    size = np.exp(cells[:, 2])
    circle = 2.0 * size * (1.0 - kappa2)
    scatter = kappa2 * size
    # over a cell z and the radius differ evenly
    blurred = blur / 12.0 * (step[0] ** 2 + 0.25 * circle * step[2] ** 2)
    variance = (scatter + blurred)[:, None] + noise
    away = np.sum((pairs - cells[:, None, :2]) ** 2, axis=2)
    reach = np.sqrt(away * circle[:, None])
    rice = np.log(i0e(reach / variance) / variance)
    rice -= 0.5 * (away + circle[:, None] - 2.0 * reach) / variance
    beside = _REPEATS**2 * size[:, None]
    before = own + beside + step[0] ** 2 / 8.0
    repeats = -0.5 * np.sum(cells[:, :2] ** 2, axis=1)[:, None] / before - np.log(before)
    # ln(2 pi) of each pair and of z is left out
    return rice.sum(axis=1)[:, None] + repeats, beside, blurred
