"""Private to separation: waves tied to the position that have another phase in each run.

Balls that slip in a nut shake the table at fixed wavelengths, but differently in every run: that
is neither geometry nor noise in time. A harmonic is taken for such a wave where the runs differ at
every feedrate; its variance Lambda is learnt. Equation numbers: separation-2.
"""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray, IntArray, benjamini_hochberg
from metrosep.separation.runs.geometry import filtered
from metrosep.separation.runs.posterior import Model

__all__ = ["find_slip", "learn_slip"]

FALSE_DISCOVERY = 0.01
"""Accepted share of harmonics called slipping that are not."""


def find_slip(model: Model) -> bool:
    """Give harmonics on which the runs differ at every feedrate a variance; tell whether any."""
    feeds = sorted({r.feed for r in model.seen})
    if len(model.seen) < 3 or len(feeds) < 2:
        return False
    k = np.flatnonzero(model.harmonics())
    p, spread = p_values(model, k, feeds)
    found = benjamini_hochberg(p, rate=FALSE_DISCOVERY)
    if not found.any():
        return False
    model.slip[k[found]] = np.maximum(spread[found], 1e-8)
    model.apply()
    learn_slip(model, 8)
    return True


def p_values(model: Model, k: IntArray, feeds: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return for each harmonic the largest p value with one feedrate left out, and the variance.

    S = sum |q_r|^2, q_r = (h_r - G_r m)_k, over its expectation E = sum tr(G_r - G_r C G_r)_kk is
    chi-square over its degrees of freedom f = 2 (R - R_f)(R - 1)/R.
    """
    from scipy.stats import chi2

    assert model.post is not None  # noqa: S101  (after a solution)
    i, j = 1 + k, 1 + model.extension.n + k
    theta, n = model.post.theta, len(model.seen)
    root = model.post.full_root
    squares, expected, spread = np.zeros((n, k.size)), np.zeros((n, k.size)), np.zeros(k.size)
    for row, mean, run in zip(squares, expected, model.seen, strict=True):
        rest = run.right - run.gram @ theta
        aa, bb, ab = run.gram[i, i], run.gram[j, j], run.gram[i, j]
        row[:] = rest[i] ** 2 + rest[j] ** 2
        held = run.gram[np.concatenate([i, j])] @ root
        known = np.einsum("ij,ij->i", held, held)
        mean[:] = np.maximum(aa + bb - known[: k.size] - known[k.size :], 1e-12 * (aa + bb))
        det = np.maximum(aa * bb - ab**2, 1e-12 * aa * bb + 1e-300)
        a, b = (bb * rest[i] - ab * rest[j]) / det, (aa * rest[j] - ab * rest[i]) / det
        spread += 0.5 * (a**2 + b**2 - (aa + bb) / det) / n
    of = np.array([r.feed for r in model.seen])
    p = []
    for feed in feeds:
        kept = of != feed
        freedom = 2.0 * kept.sum() * (n - 1.0) / n
        ratio = squares[kept].sum(axis=0) / expected[kept].sum(axis=0)
        p.append(chi2.sf(freedom * ratio, freedom))
    return np.max(p, axis=0), spread


def learn_slip(model: Model, rounds: int) -> None:
    """Learn the variances among the runs and the spectrum in turn (expectation-maximisation)."""
    for _ in range(rounds):
        model.learn(2)
        assert model.post is not None  # noqa: S101  (after a solution)
        at = model.slipping()
        if not at.size:
            return
        k = np.flatnonzero(model.slip > 0.0)
        prior = np.diag(1.0 / np.tile(model.slip[k], 2))
        covariance = model.post.full_root
        total = np.zeros(at.size)
        for run in model.runs:
            h = model.sensor.response(model.extension.wavenumbers, run.velocity)
            seen = filtered(model.post.theta, h)
            inverse = np.linalg.inv(run.gram[np.ix_(at, at)] + prior)
            d = inverse @ (run.right[at] - run.gram[at] @ seen)
            doubt = inverse @ (run.gram[at] @ covariance)
            total += d**2 + np.diag(inverse) + np.sum(doubt**2, axis=1)
        own = total / len(model.runs)
        model.slip[k] = np.maximum(0.5 * (own[: k.size] + own[k.size :]), 1e-10)
        model.apply()
    model.solve()
