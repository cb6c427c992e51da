"""Sizes of motions that go on: what is drawn together is what dense algebra and a sum over all sizes give."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from metrosep.machine import _lack_of_fit
from metrosep.machine._lack_of_fit import _Case, _Curves, _Part

N, FITTED, EACH = 30, 3, 4
LEVELS = _lack_of_fit._LEVELS.size
CHOICES = 1 + 3 * LEVELS


def chances_of_two():
    """Chances before of the choices of two motions, by cumulative bivariate normal distributions.

    The share of each is anything from 0 to 1 alike, so is the correlation of their normal scores; of three
    falls whose shares are anything, two motions have the same one at 1/2 (Laplace's rule), else one of six.
    """
    up = norm.ppf(np.append(_lack_of_fit._SMALLER[:-1], 1.0 - 1e-15))
    rho = (np.arange(5) + 0.5) / 5.0
    whole = np.zeros((up.size + 1,) * 2)
    grid = np.stack(np.meshgrid(up, up, indexing="ij"), axis=-1)
    for r in rho:
        both = multivariate_normal(cov=[[1.0, r], [r, 1.0]])
        whole[1:, 1:] += both.cdf(grid) / rho.size
    level = np.diff(np.diff(whole, axis=0), axis=1)
    fall = np.full((3, 3), 1.0 / 12.0) + np.eye(3) / 12.0
    found = np.zeros((CHOICES,) * 2)
    found[0, 0] = level[0, 0]
    found[0, 1:] = np.tile(level[0, 1:] / 3.0, 3)
    found[1:, 0] = found[0, 1:]
    found[1:, 1:] = np.kron(fall, level[1:, 1:])
    return found


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
        for chosen in rng.integers(0, CHOICES, (3, 2)).tolist():
            case = found.cases[k]
            part = _Part(case, case.S, case.s, case.base, 0.0)
            before = found._before(0, chosen)
            d = found._scale(k, [1], chosen)
            left = part.without(d, slice(EACH, None), slice(EACH))
            got = found.of_group(k, 0, left, before)
            for i in (0, 1, chosen[0], CHOICES - 1):
                want = dense(Z, H, y, V, found.scale(k, (i, chosen[1]))[None], stated)[0][0]
                # of some hundred: rounding
                assert got[i] == pytest.approx(want + before[i], abs=1e-8)
                assert found.value(k, (i, chosen[1])) == pytest.approx(want, abs=1e-8)


@pytest.mark.parametrize("stated", [True, False])
def test_drawn_sizes_give_the_mean_and_u_of_all_sizes(stated, monkeypatch):
    """All 46 times 46 sizes under both drifts, weighed by dense likelihoods, against 800 draws."""
    monkeypatch.setattr(_lack_of_fit, "_DRAWS", 800)
    Z, H, y, covariances = readings(2)
    found, fit = curves(Z, H, y, covariances, stated)
    mean, cov = found.moments()
    every = [*product(range(CHOICES), repeat=2)]
    before = -2.0 * np.log(chances_of_two().ravel())
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


def test_what_one_motion_shows_is_likely_of_the_other():
    """Chances given the other motion are those of both; the common score is a sum over nodes."""
    Z, H, y, covariances = readings(1)
    found, _ = curves(Z, H, y, covariances, False)
    both = chances_of_two()
    for i in (0, 1, 4, 9, LEVELS + 5, 2 * LEVELS + 2):
        got = np.exp(-0.5 * found._before(0, (0, i)))
        want = both[:, i] / both[:, i].sum()
        assert got.sum() == pytest.approx(1.0, abs=1e-12)
        assert got == pytest.approx(want, abs=1e-3)  # cut at 4 deviations
    # a motion that hardly goes on makes the other small, one that does makes it large
    small, large = (np.exp(-0.5 * found._before(0, (0, i))) for i in (0, 6))
    assert small[0] > 0.4 > 0.1 > large[0]


def test_motions_that_show_nothing_say_nothing_of_others():
    """One motion alone has the share that is anything from 0 to 1 alike."""
    Z, H, y, covariances = readings(1)
    H = np.hstack([H[:, :EACH], np.tile(Z, 2)[:, :EACH]])
    found, _ = curves(Z, H, y, covariances, False)
    got = np.exp(-0.5 * found._before(0, (0, 0)))
    want = np.diff(_lack_of_fit._SMALLER, prepend=0.0)
    nodes = 1e-3  # cut at 4 deviations
    assert np.append(got[0], got[1:].reshape(3, -1).sum(axis=0)) == pytest.approx(want, abs=nodes)


def test_curves_drawn_from_the_law_are_within_2_u_as_often_as_2_u_says():
    """One motion at 41 places there and back: wide where it ends at its orders, narrow where it hardly shows.

    On average over the law that is assumed 2 u hold what they say; a machine that ends is its narrow corner.
    """
    first, top, places = 5, 66, np.linspace(-1.0, 1.0, 41)
    x = np.append(places, places[::-1])
    n = np.arange(first, top + 1.0)
    sizes = np.stack([np.sqrt(2 * n + 1) * (n / n[0]) ** -fall for fall in (0, 1, 2)])
    A = np.polynomial.legendre.legvander(x, top)
    Z, H = A[:, :first], A[:, first:]
    at = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, 101), top)
    at = at - np.polynomial.legendre.legvander([-0.6], top)  # home
    V, own = np.eye(x.size), [np.arange(n.size)]
    W = np.diag(np.ones(x.size)) - Z @ np.linalg.pinv(Z)
    S, C = H.T @ W @ H, np.linalg.inv(Z.T @ Z)
    base = np.linalg.slogdet(V)[1] - np.linalg.slogdet(C)[1]

    def found_of(y):
        case = _Case(
            base, float(y @ W @ y), x.size - first, S, H.T @ W @ y, np.diag(H.T @ H),
            C @ Z.T @ H, np.zeros(first), 1e-9, False, True, C,
        )  # fmt: skip
        return _Curves([case], [sizes], own)

    law = found_of(np.ones(x.size))
    before = np.exp(-0.5 * law._before(0, (0,)))
    rng = np.random.default_rng(5)
    held, square, ends = [], [], []
    for _ in range(300):
        chosen = int(rng.choice(CHOICES, p=before / before.sum()))
        g = law.scale(0, (chosen,)) * rng.normal(size=n.size)
        y = H @ g + rng.normal(size=x.size)
        mean, cov = found_of(y).moments()
        off = at @ np.append(C @ Z.T @ y + mean[:first], mean[first:] - g)
        u = np.sqrt(np.einsum("ij,jk,ik->i", at, cov, at))
        held.append(np.mean(np.abs(off) <= 2.0 * u))
        square.append((np.mean(off**2), np.mean(u**2)))
        ends.append(chosen == 0)
    held, ends, (off2, u2) = np.array(held), np.array(ends), np.array(square).T
    print(
        f"{held.mean():.3f}; ends: {held[ends].mean():.3f}, {np.sqrt(u2[ends].mean() / off2[ends].mean()):.2f}"
    )
    doubt = held.std() / np.sqrt(held.size)  # what one machine says of its places is alike
    assert held.mean() == pytest.approx(0.954, abs=3.0 * doubt)
    assert held[ends].mean() > held[~ends].mean()
