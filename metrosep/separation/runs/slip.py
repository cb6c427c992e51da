r"""Private to separation: what repeats at the wavelength of a wave that slips.

Run r shows the pair :math:`q_r = c + p_r + e_r` of cosine and sine: c repeats, p_r has another phase
in each run, e_r is noise. What slips has a size of its own, from run to run more or less the same:

.. math::  p_r = \rho (\cos\varphi_r, \sin\varphi_r) + N(0, \tau^2), \qquad
           2 \tau^2 + \rho^2 = 2 \Lambda, \quad \tau = \kappa \sqrt\Lambda

so the pairs lie on a circle whose centre repeats, the sharper the smaller :math:`\kappa` is, and about
a point for :math:`\kappa = 1` (normal numbers). Given c the distance of a pair from it is Rice's.

Runs that lie apart along the axis look alike: they turn what repeats, so the pairs lie on a circle
about nothing, the phases within :math:`2 \pi \sigma_d / \lambda` of that of the mean place (von Mises).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from metrosep.core._arrays import FloatArray

_REPEATS = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
"""Amplitudes that repeat, over that which slips: as likely before."""

_FINE = 0.05
"""Variance within a cell over that of what a run shows, below which a cell is not halved."""

_LEAST_CHANCE = 10.0
"""ln of how much likelier the best cell of a grid is than one that is not looked at more closely."""

_STARTS = 8
"""Cells of the first grid along each direction; each grid halves them."""


@dataclass(frozen=True, slots=True, eq=False)
class Repeating:
    """Mean and covariance of what repeats, its part in the spectrum first, then what is beside it."""

    mean: FloatArray  # shape (4,)
    covariance: FloatArray  # shape (4, 4)
    evidence: float  # ln, but for a constant


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """What a model says of cells of a grid over z and a third number, each with m possibilities."""

    logs: FloatArray  # shape (n, m): ln chance, but for 2 pi of each pair and 5 of z
    beside: FloatArray  # shape (n, m): variance of what repeats beside the spectrum
    blurred: FloatArray  # shape (n,): variance within the cell, and that of what slips
    scatter: FloatArray


def what_repeats(
    pairs: FloatArray, noise: FloatArray, own: float, turns: tuple[FloatArray, FloatArray]
) -> Repeating:
    """Return what repeats in pairs, shape (R, 2), of some noise, (R,), beside a spectrum that has `own`.

    Of the sum z that repeats the spectrum holds the share own / (own + what repeats beside it). Turns
    are angles by which the places of the runs scatter, in even steps of the logarithm after 0, with
    the chance of each: that they explain all is as likely before as that something slips.
    """
    shows = float(np.median(noise))
    weights = 1.0 / (shows + noise)  # some run may show next to nothing
    weights /= weights.sum()
    middle = weights @ pairs
    away = float(weights @ np.sum((pairs - middle) ** 2, axis=1))
    size = max(0.5 * away * len(pairs) / (len(pairs) - 1.0), shows)
    # ln Lambda, of 2 (R - 1) numbers, is known to 1/sqrt(R - 1); z lies within a circle about the pairs
    half = np.array([math.sqrt(18.0 * size)] * 2 + [1.0 + 3.0 / math.sqrt(len(pairs) - 1.0)])
    # Before, kappa is 1 with the chance 1/2; else as likely any half of half of 1 that the noise shows.
    halves = 1 + math.ceil(0.5 * math.log2(size / shows))
    chances, parts = [], []
    for kappa2 in (0.25**i for i in range(1 + halves)):
        slips = partial(_slipping, pairs, noise, own, kappa2)
        chances.append(0.5 if kappa2 == 1.0 else 0.5 / halves)
        parts.append(
            _explored(slips, np.append(middle, math.log(size)), half, own, shows, len(pairs))
        )
        if kappa2 < 1.0 and turns[0].size > 1:
            ends = np.log(turns[0][[1, -1]])
            turned = partial(_turned, pairs, noise, kappa2, turns)
            about = np.append(middle, ends.mean())
            room = np.append(half[:2], 0.5 * (ends[1] - ends[0]) + _edge(turns[0]))
            chances.append(1.0 / halves)
            parts.append(_explored(turned, about, room, own, shows, len(pairs)))
    logs = np.array([p.evidence for p in parts]) + np.log(chances)
    likely = np.exp(logs - logs.max())
    evidence = float(logs.max()) + math.log(likely.sum())
    likely /= likely.sum()
    mean = likely @ np.array([p.mean for p in parts])
    covariance = sum(
        c * (p.covariance + np.outer(p.mean - mean, p.mean - mean))
        for c, p in zip(likely, parts, strict=True)
    )
    return Repeating(mean, np.asarray(covariance), evidence)


def _explored(
    model: Callable[[FloatArray, FloatArray, float], _Cells],
    about: FloatArray,
    half: FloatArray,
    own: float,
    shows: float,
    n: int,
) -> Repeating:
    """Return what repeats under one model, on a grid that follows the chance."""
    step, at = 2.0 * half / _STARTS, (2.0 * np.arange(_STARTS) + 1.0) / _STARTS - 1.0
    cells = np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1).reshape(-1, 3) * half
    cells += about
    corners = 0.5 * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
    while True:
        # A cell is off in all runs alike: as much as it is off by, times their number, it is blurred.
        coarse = model(cells, step, 0.5 * n)
        most = coarse.logs.max(axis=1)
        kept = most > most.max() - _LEAST_CHANCE
        fine = 0.5 * n * _FINE * (coarse.scatter + shows)
        if np.all(coarse.blurred[kept] < fine[kept]):
            break
        step = 0.5 * step
        cells = (cells[kept][:, None] + corners * step).reshape(-1, 3)
    cells = cells[kept]
    found = model(cells, step, 1.0)
    top = float(found.logs.max())
    chances = np.exp(found.logs - top)
    total = float(chances.sum())
    chances /= total
    before = own + found.beside
    share, narrow = own / before, step[0] ** 2 / 8.0 / (before + step[0] ** 2 / 8.0)
    z = [part[..., None] * cells[:, None, :2] for part in (share, 1.0 - share)]
    flat = (np.concatenate(z, axis=2) * (1.0 - narrow)[..., None]).reshape(-1, 4)
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


def _slipping(
    pairs: FloatArray,
    noise: FloatArray,
    own: float,
    kappa2: float,
    cells: FloatArray,
    step: FloatArray,
    blur: float,
) -> _Cells:
    """Return the chances of z and ln Lambda where something slips, for each amplitude that repeats."""
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
    return _Cells(rice.sum(axis=1)[:, None] + repeats, beside, blurred, scatter)


def _turned(
    pairs: FloatArray,
    noise: FloatArray,
    kappa2: float,
    turns: tuple[FloatArray, FloatArray],
    cells: FloatArray,
    step: FloatArray,
    blur: float,
) -> _Cells:
    """Return the chances of z and ln of the angle where the places of the runs turn all that repeats."""
    from scipy.special import i0e

    blurred = blur / 12.0 * step[0] ** 2
    square = np.sum(cells[:, :2] ** 2, axis=1) + step[0] ** 2 / 8.0  # of z: 2 Lambda
    scatter = 0.5 * kappa2 * square
    variance = (scatter + blurred)[:, None] + noise
    phases = 1.0 / (np.exp(2.0 * cells[:, 2]) + blurred / square)[:, None]
    along = (cells[:, :2] @ pairs.T) / variance
    own = np.sum(pairs**2, axis=1)
    reach = np.sqrt(
        np.maximum(phases**2 + square[:, None] * own / variance**2 + 2.0 * phases * along, 0.0)
    )
    logs = np.log(i0e(reach) / (i0e(phases) * variance)) + (reach - phases)
    logs -= 0.5 * (own + square[:, None]) / variance
    # of Lambda and the phase, both even, over z; and of the angles within a cell
    edges = np.log(turns[0][1:]) - _edge(turns[0])
    edges = np.append(edges, edges[-1] + 2.0 * _edge(turns[0]))
    up_to = np.append(0.0, np.cumsum(turns[1][1:]))
    ends = cells[:, 2, None] + 0.5 * step[2] * np.array([-1.0, 1.0])
    share = np.diff(np.interp(ends, edges, up_to), axis=1)[:, 0] / step[2]
    before = np.log(len(_REPEATS) / square * 2.0 * np.maximum(share, 1e-300))
    return _Cells(
        (logs.sum(axis=1) + before)[:, None],
        0.5 * square[:, None],
        np.full(len(cells), blurred),
        scatter,
    )


def _edge(angles: FloatArray) -> float:
    """Return half of the step of the logarithm of angles after the first, which is 0."""
    return 0.5 * math.log(angles[-1] / angles[1]) / (angles.size - 2.0)
