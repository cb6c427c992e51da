"""Flatness: closed forms, an independent linear program, enumeration, invariances."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from metrosep.core.errors import DataError, DegenerateFitError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.parameters.deviation import flatness_deviation

ROUNDING = 1e-12
"""Relative: a few dozen operations in double precision."""

LP_RTOL = 1e-6
"""Feasibility tolerance of HiGHS is 1e-7 in its own scaling."""


def positions(surface):
    j, i = np.indices(surface.shape)
    ok = ~np.isnan(surface.z)
    x = surface.origin[0] + (surface.dx or 1.0) * i[ok]
    y = surface.origin[1] + (surface.dy or 1.0) * j[ok]
    return x, y, surface.z[ok]


def vertical_lp(x, y, z):
    """Least vertical width by linear programming over all points."""
    from scipy.optimize import linprog

    one = np.ones_like(x)
    a = np.vstack([np.column_stack([-one, -x, -y, -one]), np.column_stack([one, x, y, -one])])
    found = linprog([0, 0, 0, 2], a, np.concatenate([-z, z]), bounds=(None, None), method="highs")
    return float(found.fun)


def enumerated(x, y, z):
    """Least width over all planes with two slopes fixed by 4 points that hold a zone."""
    best = math.inf
    for four in combinations(range(x.size), 4):
        k = list(four)
        for signs in ((1, 1, 1, -1), (1, 1, -1, 1), (1, -1, 1, 1), (-1, 1, 1, 1),
                      (1, 1, -1, -1), (1, -1, 1, -1), (1, -1, -1, 1)):  # fmt: skip
            a = np.column_stack([np.ones(4), x[k], y[k], signs])
            if abs(np.linalg.det(a)) < 1e-9:
                continue
            c = np.linalg.solve(a, z[k])
            best = min(best, float(np.ptp(z - c[1] * x - c[2] * y)))
    return best


# ------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("n", [2, 3, 51])
def test_saddle_rests_on_its_corners(n):
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    result = flatness_deviation(Surface(x * y, dx=1e-3, dy=1e-3))
    # 2 + 2: the diagonals cross in the middle, 1 above and 1 below.
    assert result.value == pytest.approx(2.0, rel=ROUNDING, abs=0.0)
    assert sorted(map(tuple, result.support.upper.tolist())) == [(0, 0), (n - 1, n - 1)]
    assert sorted(map(tuple, result.support.lower.tolist())) == [(0, n - 1), (n - 1, 0)]
    assert result.is_optimal


def test_bump_on_a_plane_is_held_by_three_and_one():
    z = 1e-3 * np.add.outer(np.arange(9.0), 2 * np.arange(11.0))
    z[3, 4] += 5e-6
    result = flatness_deviation(Surface(z, dx=1e-3, dy=1e-3))
    assert result.value == pytest.approx(5e-6, rel=1e-9, abs=0.0)  # 5 um on 28 mm of tilt
    assert result.support.upper.tolist() == [[3, 4]]
    assert result.reference_parameters["slope_x"].value == pytest.approx(2.0, rel=1e-9, abs=0.0)
    assert result.reference_parameters["slope_y"].value == pytest.approx(1.0, rel=1e-9, abs=0.0)


def test_product_of_chebyshev_polynomials():
    # T3(x) T2(y) reaches +1 and -1 on a checkerboard of 4 x 3 points: no plane separates these.
    y, x = np.cos(np.pi * np.mgrid[0:1:13j, 0:1:13j])
    result = flatness_deviation(Surface((4 * x**3 - 3 * x) * (2 * y**2 - 1)))
    assert result.value == pytest.approx(2.0, rel=ROUNDING, abs=0.0)
    assert result.is_optimal


def test_least_squares_against_lstsq():
    rng = np.random.default_rng(2)
    z = rng.normal(size=(13, 17))
    z[rng.random(z.shape) < 0.2] = np.nan
    surface = Surface(z, dx=2e-3, dy=5e-3, origin=(0.7, -0.2))
    result = flatness_deviation(surface, reference="LS")
    x, y, heights = positions(surface)
    a = np.column_stack([np.ones_like(x), x, y])
    c = np.linalg.lstsq(a, heights, rcond=None)[0]
    left = heights - a @ c
    assert result.value == pytest.approx(np.ptp(left), rel=1e-10, abs=0.0)
    assert result.table["FLTp"].value == pytest.approx(left.max(), rel=1e-10, abs=0.0)
    assert result.table["FLTv"].value == pytest.approx(-left.min(), rel=1e-10, abs=0.0)
    assert result.table["FLTq"].value == pytest.approx(
        math.sqrt(np.mean(left**2)), rel=1e-10, abs=0.0
    )
    p = result.reference_parameters
    assert [p[k].value for k in ("intercept", "slope_x", "slope_y")] == pytest.approx(
        c, rel=1e-9, abs=0.0
    )


# ------------------------------------------------------- independent ways, random sets


@pytest.mark.parametrize("seed", range(8))
def test_minimum_zone_equals_linear_program(seed):
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(int(rng.integers(2, 12)), int(rng.integers(2, 12))))
    if seed % 2:
        z = np.round(z)  # ties
    if z.size > 30:
        z[rng.random(z.shape) < 0.1] = np.nan
    surface = Surface(z, dx=0.3, dy=0.7, origin=(5.0, -3.0))
    result = flatness_deviation(surface)
    assert result.value == pytest.approx(vertical_lp(*positions(surface)), rel=LP_RTOL, abs=1e-9)
    assert result.is_optimal


@pytest.mark.parametrize("seed", range(4))
def test_minimum_zone_equals_enumeration(seed):
    rng = np.random.default_rng(50 + seed)
    z = rng.normal(size=(3, 3))
    surface = Surface(z, dx=1.0, dy=1.0)
    assert flatness_deviation(surface).value == pytest.approx(
        enumerated(*positions(surface)), rel=1e-10, abs=0.0
    )


@pytest.mark.parametrize("seed", range(6))
def test_support_is_a_proof(seed):
    rng = np.random.default_rng(seed)
    surface = Surface(1e-6 * rng.normal(size=(40, 30)), dx=1e-3, dy=2e-3)
    result = flatness_deviation(surface)
    held = result.support
    assert len(held) <= 4
    assert set(held.sides.tolist()) == {1, -1}
    assert (held.weights > 0).all()
    signed = held.weights * held.sides
    # Both sides have one centre of gravity, so every plane has the same signed sum there ...
    assert abs(signed.sum()) < ROUNDING
    assert float(np.abs(signed @ held.positions).max()) < ROUNDING
    # ... and no plane makes the two closer than this.
    assert held.weights[held.sides > 0].sum() == pytest.approx(1.0, rel=ROUNDING, abs=0.0)
    assert float(signed @ held.heights) == pytest.approx(result.value, rel=1e-10, abs=0.0)
    assert result.bound == pytest.approx(result.value, rel=1e-10, abs=0.0)
    j, i = held.indices.T
    assert held.heights.tolist() == surface.z[j, i].tolist()
    on_the_side = result.residual.z[j, i] * held.sides
    assert float(np.abs(on_the_side - 0.5 * result.value).max()) < 1e-17


# ------------------------------------------------------------------------- invariances


@pytest.fixture(scope="module")
def rough():
    rng = np.random.default_rng(11)
    z = 1e-6 * rng.normal(size=(20, 31)).cumsum(axis=0)
    z[4:7, 5:9] = np.nan
    return Surface(z, dx=1e-4, dy=3e-4)


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e-3, 1e3])
@pytest.mark.parametrize("reference", ["MZ", "LS"])
def test_units_do_not_matter(rough, unit, reference):
    one = flatness_deviation(rough, reference=reference)
    for dx, dy in ((rough.dx, rough.dy), (rough.dx * unit, rough.dy * unit)):
        result = flatness_deviation(Surface(rough.z * unit, dx, dy), reference=reference)
        assert result.value / unit == pytest.approx(one.value, rel=1e-10, abs=0.0)


@pytest.mark.parametrize("reference", ["MZ", "LS"])
def test_flip_tilt_mirror_and_transpose(rough, reference):
    value = flatness_deviation(rough, reference=reference).value
    j, i = np.indices(rough.shape)
    for other in (
        Surface(-rough.z, rough.dx, rough.dy),
        Surface(rough.z + 1e-5 * i - 2e-5 * j + 1e-3, rough.dx, rough.dy),
        Surface(rough.z[::-1], rough.dx, rough.dy),
        Surface(rough.z[:, ::-1], rough.dx, rough.dy),
        Surface(rough.z.T, rough.dy, rough.dx),
        Surface(rough.z, rough.dx, rough.dy, origin=(3.0, -8.0)),
        Surface(rough.z),
        Surface(rough.z, rough.dx),
    ):
        again = flatness_deviation(other, reference=reference).value
        assert again == pytest.approx(value, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("reference", ["MZ", "LS"])
def test_nan_rows_equal_cropped_rows(rough, reference):
    z = rough.z.copy()
    z[:3] = np.nan
    z[-1] = np.nan
    with_nan = flatness_deviation(Surface(z, rough.dx, rough.dy), reference=reference)
    cropped = flatness_deviation(Surface(z[3:-1], rough.dx, rough.dy), reference=reference)
    assert with_nan.value == pytest.approx(cropped.value, rel=ROUNDING, abs=0.0)
    assert with_nan.table.context.n_valid == 16 * 31 - 12
    assert np.isnan(with_nan.residual.z).tolist() == np.isnan(z).tolist()


def test_plane_and_residual_add_up(rough):
    shifted = Surface(rough.z, rough.dx, rough.dy, origin=(0.1, 0.2))
    x, y, z = positions(shifted)
    for reference in ("MZ", "LS"):
        result = flatness_deviation(shifted, reference=reference)
        p = {k: q.value for k, q in result.reference_parameters.items()}
        plane = p["intercept"] + p["slope_x"] * x + p["slope_y"] * y
        left = result.residual.z[~np.isnan(rough.z)]
        assert float(np.abs(left + plane - z).max()) < 1e-17
        assert result.residual.origin == (0.1, 0.2)
        assert result.residual.history[-1].name == "flatness"


# ----------------------------------------------------------------------- special inputs


def test_uncalibrated_slopes_are_per_pixel():
    z = 3e-6 * np.arange(5.0) + np.zeros((4, 1))
    result = flatness_deviation(Surface(z))
    slope = result.reference_parameters["slope_x"]
    assert (slope.value, slope.unit) == (pytest.approx(3e-6, rel=1e-9, abs=0.0), "m")
    assert any("not calibrated" in note for note in result.notes)


@pytest.mark.parametrize("slope", [0.0, 1e-3, 2.0])
@pytest.mark.parametrize("reference", ["MZ", "LS"])
def test_a_plane_has_no_deviation(slope, reference):
    z = 4e-3 + slope * np.add.outer(np.arange(6.0), -0.3 * np.arange(7.0))
    result = flatness_deviation(Surface(z, dx=1.0, dy=1.0), reference=reference)
    assert result.value <= 1e-15 * (1e-3 + float(np.abs(z).max()))
    assert result.is_optimal == (reference == "MZ")


def test_pixels_on_one_line_are_refused():
    z = np.full((5, 5), np.nan)
    np.fill_diagonal(z, [0, 1, 0, 1, 0])
    for bad in (z, np.zeros((1, 9)), np.zeros((9, 1))):
        for reference in ("MZ", "LS"):
            with pytest.raises(DegenerateFitError, match="on one line"):
                flatness_deviation(Surface(bad, dx=1.0, dy=1.0), reference=reference)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_pixels(n):
    z = np.full((4, 4), np.nan)
    z.flat[[0, 5, 6][:n]] = 1.0
    with pytest.raises(TooFewSamplesError, match="4 valid pixels"):
        flatness_deviation(Surface(z, dx=1.0, dy=1.0))


@pytest.mark.parametrize("reference", ["EP", "MC", "mz"])
def test_unknown_reference(reference):
    with pytest.raises(DataError, match="one of MZ, LS"):
        flatness_deviation(Surface(np.eye(3), dx=1.0, dy=1.0), reference=reference)


def test_integers_are_accepted():
    assert flatness_deviation(Surface([[1, 0], [0, 1]])).value == pytest.approx(
        1.0, rel=ROUNDING, abs=0.0
    )


@pytest.mark.parametrize("gaps", [False, True])
def test_a_million_pixels_take_few_steps(gaps, calls):
    rng = np.random.default_rng(1)
    y, x = np.mgrid[-1:1:1000j, -1:1:1000j]
    z = 1e-6 * (x * x + 0.3 * y**3 + np.sin(3 * x + y)) + 1e-9 * rng.normal(size=x.shape)
    if gaps:
        z[rng.random(z.shape) < 0.05] = np.nan
    surface = Surface(z, dx=1e-5, dy=1e-5)
    steps, result = calls(lambda: flatness_deviation(surface))
    assert steps < z.size / 50
    assert result.is_optimal
