"""Three flats by iterated Zernike terms: own masks, brute force over all pixels, null space, u."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DegenerateFitError, MetrosepError
from metrosep.separation.maps import flats as _flat_iteration
from metrosep.separation.maps.flats import three_flat

EXACT = 1e-17
"""Least squares of 20 nm without noise: rounding only."""

SAME = 1e-9
"""Iteration to 1e-13 of the start against dense least squares, times their condition."""

N = 41
G = np.linspace(-1.0, 1.0, N)
GX, GY = np.meshgrid(G, G)
R, T = np.hypot(GX, GY), np.arctan2(GY, GX)
ROUND = R <= 1.0
TERMS = [(n, m) for n in range(5) for m in range(-n, n + 1, 2)]
PLANE = ((0, 0), (1, 1), (1, -1))


def term(n, m, x, y):
    """Radial polynomial by its sum of factorials times cos or sin; Noll's normalisation."""
    f, r, t, k = math.factorial, np.hypot(x, y), np.arctan2(y, x), abs(m)
    radial = sum(
        (-1) ** i
        * f(n - i)
        / (f(i) * f((n + k) // 2 - i) * f((n - k) // 2 - i))
        * r ** (n - 2 * i)
        for i in range((n - k) // 2 + 1)
    )
    return radial * (np.cos(m * t) if m >= 0 else np.sin(k * t))


def placed(angle=0.0, flip=None):
    x, y = (
        math.cos(angle) * GX + math.sin(angle) * GY,
        -math.sin(angle) * GX + math.cos(angle) * GY,
    )
    return (-x if flip == "x" else x), (-y if flip == "y" else y)


def columns(setups, flip):
    """Every term of A, B, C in every reading, shape (S, N, N, 3 p)."""
    out = np.zeros((len(setups), N, N, 3, len(TERMS)))
    for s, (pair, first, second) in enumerate(setups):
        for flat, where in ((pair[0], placed(first)), (pair[1], placed(second, flip))):
            for i, (n, m) in enumerate(TERMS):
                out[s, :, :, "ABC".index(flat), i] += term(n, m, *where)
    return out.reshape(len(setups), N, N, -1)


def setups_of(angles, pair="AB"):
    return [("AB", 0.0, 0.0), ("AC", 0.0, 0.0), ("BC", 0.0, 0.0)] + [
        (pair, a, 0.0) for a in angles
    ]


def flats(seed):
    return 20e-9 * np.random.default_rng(seed).standard_normal(3 * len(TERMS))


def masked(maps, masks):
    return [np.where(mask, z, np.nan) for z, mask in zip(maps, masks, strict=True)]


def sectors(n):
    """Each reading lacks another sector; together they lack nearly the whole disc."""
    width = 2.0 * np.pi / n
    return [
        ROUND & (np.abs(np.angle(np.exp(1j * (T - 0.3 - k * width)))) > 0.45 * width)
        for k in range(n)
    ]


def test_readings_with_gaps_that_have_few_pixels_in_common():
    angles = np.radians([90.0, 37.3])
    setups, c = setups_of(angles), flats(1)
    data = masked(columns(setups, "x") @ c, sectors(5))
    common = np.isfinite(data).all(axis=0)
    assert common.sum() < 0.2 * ROUND.sum()
    result = three_flat(*data[:3], data[3:], angles, method="iterative", terms=15)

    for k, flat in enumerate("ABC"):
        shape = c.reshape(3, -1)[k].copy()
        shape[:3] = 0.0
        truth = sum(a * term(n, m, GX, GY) for a, (n, m) in zip(shape, TERMS, strict=True))
        error = result.parts[flat] - truth
        assert np.isfinite(error).sum() > 0.95 * ROUND.sum()
        assert np.nanmax(np.abs(error)) < EXACT
    assert result.audit["n_pixels_of_all_readings"] == sum(int(np.isfinite(z).sum()) for z in data)
    assert result.audit["iterations"] > 3
    assert not result.messages[:-1]


def test_a_place_that_no_reading_of_a_flat_has_stays_empty():
    c, setups = flats(2), setups_of([np.pi / 2])
    hole = np.hypot(GX - 0.4, GY + 0.3) > 0.15
    masks = [ROUND & hole, ROUND & hole, ROUND, ROUND]  # A is seen in 1, 2 only, besides turned
    data = masked(columns(setups, "x") @ c, masks)
    result = three_flat(*data[:3], data[3:], np.pi / 2, method="iterative", terms=15)

    assert np.isnan(result.A[ROUND & ~hole]).all()
    assert np.isfinite(result.A[ROUND & hole]).all()
    assert np.isfinite(result.C[ROUND]).all()
    assert np.isnan(result.u["A"][ROUND & ~hole]).all()


@pytest.mark.parametrize("flip", ["x", "y"])
def test_same_as_dense_least_squares_over_all_pixels(flip):
    """Coefficients and their u against the pseudo-inverse of the whole matrix, planes and all."""
    angles, sd = np.radians([72.0]), 1e-9
    setups, c = setups_of(angles, "AC"), flats(3)
    rng = np.random.default_rng(4)
    matrix, masks = columns(setups, flip), sectors(4)
    read = matrix @ c + sd * rng.standard_normal((4, N, N))
    free = [i for i in range(matrix.shape[-1]) if TERMS[i % len(TERMS)] not in PLANE]
    planes = np.zeros((4, N, N, 12))
    for s in range(4):
        planes[s, :, :, 3 * s : 3 * s + 3] = np.stack([np.ones_like(GX), GX, GY], axis=2)
    ok = np.stack(masks)
    dense = np.concatenate([matrix[..., free], planes], axis=-1)[ok]
    inverse = np.linalg.pinv(dense, rcond=1e-10)
    truth = np.full(matrix.shape[-1], np.nan)
    truth[free] = (inverse @ read[ok])[: len(free)]
    u = np.full(matrix.shape[-1], np.nan)
    u[free] = sd * np.sqrt((inverse**2).sum(axis=1))[: len(free)]
    result = three_flat(
        *masked(read, masks)[:3], masked(read, masks)[3:], angles, pairs="AC", flip=flip,
        method="iterative", terms=15, dx=G[1] - G[0], radius=1.0, u_reading=sd,
    )  # fmt: skip

    nm = list(zip(result.coordinates["zernike_n"], result.coordinates["zernike_m"], strict=True))
    hidden = 0
    for k, flat in enumerate("ABC"):
        for i, (n, m) in enumerate(TERMS):
            j, place = nm.index((n, m)), k * len(TERMS) + i
            found, spread = result.parts[f"zernike_{flat}"][j], result.u[f"zernike_{flat}"][j]
            if math.isnan(found):
                hidden += 1
                continue
            assert found == pytest.approx(truth[place], rel=0.0, abs=SAME * 20e-9)
            assert spread == pytest.approx(u[place], rel=SAME, abs=0.0)
    assert hidden == 9  # the planes alone: 72 deg hides orders 5, 10 ...


@pytest.mark.parametrize(("degrees", "orders"), [(180.0, {2, 4}), (90.0, {4}), (120.0, {3})])
def test_terms_that_a_turn_does_not_change_are_nan_and_named(degrees, orders):
    """m times angle = 2 pi k: odd share (sin m t for even m, cos m t for odd m with flip x)."""
    angle = math.radians(degrees)
    c = flats(5)
    data = masked(columns(setups_of([angle]), "x") @ c, [ROUND] * 4)
    result = three_flat(*data[:3], data[3], angle, method="iterative", terms=15)
    listed = [i for i in result.null_space if i.part == "A" and "mirror" in i.reason]
    names = " ".join(text for i in listed for text in i.indices)

    for (n, m), found in zip(
        zip(*(result.coordinates[k].astype(int) for k in ("zernike_n", "zernike_m")), strict=True),
        result.zernike_A,
        strict=True,
    ):
        odd = m < 0 if m % 2 == 0 else m > 0
        lost = abs(m) in orders and odd
        assert (f"Z({n}, {m})" in names) == lost
        assert math.isnan(found) == (lost or n <= 1)


def test_same_masks_give_the_direct_solution():
    c, angles = flats(6), np.radians([90.0, 180.0])
    rng = np.random.default_rng(7)
    data = masked(columns(setups_of(angles), "x") @ c, [ROUND] * 5)
    data = [z + 1e-9 * rng.standard_normal(z.shape) for z in data]
    one, two = (
        three_flat(*data[:3], data[3:], angles, method=m, terms=15)
        for m in ("zernike", "iterative")
    )

    for flat in "ABC":
        np.testing.assert_allclose(two.parts[flat], one.parts[flat], rtol=0.0, atol=SAME * 20e-9)
        np.testing.assert_allclose(two.u[flat], one.u[flat], rtol=0.01, atol=0.0)
    assert two.noise.value == pytest.approx(one.noise.value, rel=0.01, abs=0.0)


@pytest.mark.slow
def test_u_with_gaps_against_the_scatter_of_trials():
    angles, sd, c = np.radians([90.0]), 1e-9, flats(8)
    exact, masks = columns(setups_of(angles), "x") @ c, sectors(4)
    rng = np.random.default_rng(9)
    found = []
    for _ in range(200):
        data = masked(exact + sd * rng.standard_normal(exact.shape), masks)
        result = three_flat(*data[:3], data[3:], angles, method="iterative", terms=15)
        found.append(result.A)
    scatter = np.std(found, axis=0, ddof=1)
    ratio = result.u["A"] / scatter
    ratio = ratio[np.isfinite(ratio)]

    assert abs(math.sqrt(np.mean(ratio**2)) - 1.0) < 0.05
    assert np.percentile(ratio, [1, 99]) == pytest.approx([1.0, 1.0], rel=0.0, abs=0.2)


class TestBadInput:
    def test_a_stop_before_it_settles_is_said(self, monkeypatch):
        monkeypatch.setattr(_flat_iteration, "MOST_STEPS", 2)
        data = masked(columns(setups_of([1.2]), "x") @ flats(10), [ROUND] * 4)
        result = three_flat(*data[:3], data[3], 1.2, method="iterative", terms=15)
        assert any("stopped after 2 steps" in m for m in result.messages)

    def test_gaps_that_hide_a_term_are_refused(self):
        small = R < 0.2
        data = masked(columns(setups_of([1.2]), "x") @ flats(11), [ROUND, ROUND, small, small])
        with pytest.raises(DegenerateFitError, match=r"terms of three flats|not determined"):
            three_flat(*data[:3], data[3], 1.2, method="iterative", terms=66)

    def test_no_common_pixel(self):
        masks = [ROUND & (GX > 0), ROUND & (GX < 0), ROUND, ROUND]
        data = masked(columns(setups_of([1.2]), "x") @ flats(12), masks)
        with pytest.raises(MetrosepError):
            three_flat(*data[:3], data[3], 1.2, method="iterative", terms=15)

    def test_zero_maps(self):
        result = three_flat(*[np.where(ROUND, 0.0, np.nan)] * 3, np.where(ROUND, 0.0, np.nan), 1.0,
                            method="iterative", terms=15)  # fmt: skip
        assert np.nanmax(np.abs(result.A)) == 0.0
