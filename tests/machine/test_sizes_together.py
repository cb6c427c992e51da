"""Sizes of motions that go on: what is drawn together is what dense algebra and a sum over all sizes give."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from metrosep.machine import _lack_of_fit
from metrosep.machine._lack_of_fit import _Case, _Curves, _Part

N, FITTED, EACH = 30, 3, 4


def readings(seed, correlated=0.8):
    """Two curves that read nearly alike, the first of them with a wave, beside three coefficients."""
    rng = np.random.default_rng([seed, 71])
    x = np.linspace(-1.0, 1.0, N)
    Z = np.polynomial.legendre.legvander(x, FITTED - 1)
    H = np.polynomial.legendre.legvander(x, FITTED + EACH - 1)[:, FITTED:]
    other = correlated * H + (1.0 - correlated**2) ** 0.5 * rng.normal(size=H.shape)
    y = Z @ [5.0, -3.0, 1.0] + H @ [2.0, 0.0, -1.0, 0.5] + rng.normal(size=N)
    i = np.arange(N)
    drift = 2.0**2 * np.exp(-np.abs(i[:, None] - i) / 6.0)
    return Z, np.hstack([H, other]), y, [np.eye(N), np.eye(N) + drift]


def restricted(Z, H, y, V, fit, stated):
    """What the class wants of one drift, by dense algebra."""
    W = np.linalg.inv(V)
    C = np.linalg.inv(Z.T @ W @ Z)
    P = W - W @ Z @ C @ Z.T @ W
    base = np.linalg.slogdet(V)[1] - np.linalg.slogdet(C)[1]
    return _Case(
        base, float(y @ P @ y), N - FITTED, H.T @ P @ H, H.T @ P @ y, np.diag(H.T @ W @ H),
        C @ Z.T @ W @ H, C @ Z.T @ W @ y - fit, 1e-9, stated, True, C,
    )  # fmt: skip


def curves(Z, H, y, covariances, stated):
    """The class over all drifts; coefficients are off against those of white noise."""
    fit = np.linalg.lstsq(Z, y)[0]
    n = np.arange(FITTED, FITTED + EACH, dtype=float)
    sizes = np.stack([np.sqrt(2 * n + 1) * (n / n[0]) ** -fall for fall in (0, 1, 2)])
    groups = [np.arange(EACH), np.arange(EACH, 2 * EACH)]
    cases = [restricted(Z, H, y, V, fit, stated) for V in covariances]
    return _Curves(cases, [sizes, sizes], groups), fit


def dense(Z, H, y, V, d, stated):
    """-2 log restricted likelihood with the curve as noise, of each row of d; mean and covariance of all unknowns."""
    M = V + (H * d[:, None] ** 2) @ H.T
    W = np.linalg.inv(M)
    A = Z.T @ W @ Z
    r = y - np.linalg.solve(A, Z.T @ W @ y[:, None])[..., 0] @ Z.T
    square, free = np.einsum("ki,kij,kj->k", r, W, r), N - FITTED
    value = np.linalg.slogdet(M)[1] + np.linalg.slogdet(A)[1]
    value += square if stated else free * np.log(square)
    # the coefficients may be anything before, the curves have the standard deviations d
    scale = np.hstack([np.ones((len(d), FITTED)), d])
    G = np.hstack([Z, H])
    B = (G.T @ np.linalg.solve(V, G)) * scale[:, None] * scale[..., None]
    B = np.linalg.inv(B + np.diag(np.r_[np.zeros(FITTED), np.ones(d.shape[1])]))
    B *= scale[:, None] * scale[..., None]
    noise = np.ones(len(d)) if stated else square / free
    return value, B @ (G.T @ np.linalg.solve(V, y)), noise[:, None, None] * B


@pytest.mark.parametrize("stated", [True, False])
def test_the_likelihood_of_sizes_is_that_of_the_readings(stated):
    """Every level of one motion beside a drawn one of the other, which is eliminated first."""
    Z, H, y, covariances = readings(1)
    found, _ = curves(Z, H, y, covariances, stated)
    rng = np.random.default_rng(3)
    for k, V in enumerate(covariances):
        for chosen in rng.integers(0, found.before.size, (3, 2)).tolist():
            case = found.cases[k]
            part = _Part(case, case.S, case.s, case.base, 0.0)
            of_other = float(found.before[chosen[1]])
            d = found._scale(k, [1], chosen)
            left = part.without(d, slice(EACH, None), slice(EACH), of_other)
            got = found.of_group(k, 0, left)
            for i in (0, 1, chosen[0], found.before.size - 1):
                want = dense(Z, H, y, V, found.scale(k, (i, chosen[1]))[None], stated)[0][0]
                want += found.before[i] + of_other
                assert got[i] == pytest.approx(want, abs=1e-8)  # of some hundred: rounding
                assert found.value(k, (i, chosen[1])) == pytest.approx(want, abs=1e-8)


@pytest.mark.parametrize("stated", [True, False])
def test_drawn_sizes_give_the_mean_and_u_of_all_sizes(stated, monkeypatch):
    """All 46 times 46 sizes under both drifts, weighed by dense likelihoods, against 800 draws."""
    monkeypatch.setattr(_lack_of_fit, "_DRAWS", 800)
    Z, H, y, covariances = readings(2)
    found, fit = curves(Z, H, y, covariances, stated)
    mean, cov = found.moments()
    every = [*product(range(found.before.size), repeat=2)]
    before = np.array([found.before[list(c)].sum() for c in every])
    of = [
        dense(Z, H, y, V, np.stack([found.scale(k, c) for c in every]), stated)
        for k, V in enumerate(covariances)
    ]
    values, means, spreads = (np.concatenate(v) for v in zip(*of, strict=True))
    values += np.tile(before, len(covariances))
    w = np.exp(-0.5 * (values - values.min()))
    w /= w.sum()
    want = w @ means
    spread = np.tensordot(w, spreads, 1) + (w * (means - want).T) @ (means - want)
    u = np.sqrt(np.diag(spread))
    want[:FITTED] -= fit
    assert np.abs(mean - want) / u == pytest.approx(np.zeros(u.size), abs=0.15)
    # where the drift is in doubt too, u of 800 draws scatters by 0.075 over seeds of the draws, else by 0.03
    assert np.sqrt(np.diag(cov)) / u == pytest.approx(np.ones(u.size), abs=0.25 if stated else 0.1)
    # no diagonal alone: what the two motions have together is known far better than each
    both = np.r_[np.zeros(FITTED), np.full(EACH, 1.0), np.full(EACH, 0.8)]
    assert both @ cov @ both == pytest.approx(
        both @ spread @ both, abs=0.15 * (both @ spread @ both)
    )


def test_orders_that_nothing_shows_take_no_draws_and_no_u():
    """Their columns are those of the coefficients, so the drifts alone are weighed: exactly."""
    Z, H, y, covariances = readings(4)
    found, _ = curves(Z, np.tile(Z, 3)[:, : 2 * EACH], y, covariances, False)
    mean, cov = found.moments()
    of = [dense(Z, H, y, V, np.zeros((1, 2 * EACH)), False) for V in covariances]
    values, means, spreads = (np.concatenate(v) for v in zip(*of, strict=True))
    w = np.exp(-0.5 * (values - values.min()))
    w /= w.sum()
    want = np.tensordot(w, spreads, 1) + (w * (means - w @ means).T) @ (means - w @ means)
    rounding = 1e-9
    assert cov == pytest.approx(want, abs=rounding)
    assert mean[FITTED:] == pytest.approx(np.zeros(2 * EACH), abs=rounding)
