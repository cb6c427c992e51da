"""Straightness: closed forms, an independent linear program, enumeration, invariances."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.parameters.straightness import straightness_deviation

RTOL = 1e-8
"""Acceptance rows Z01 and Z02 of the specification."""

LP_RTOL = 1e-6
"""Feasibility tolerance of HiGHS is 1e-7 in its own scaling."""

ROUNDING = 1e-12
"""Relative: a few dozen operations in double precision."""

G7 = np.array([468, 988, 117, 498, 927, 45, 741, 122, 410, 261, 52, 659], dtype=float)


def vertical_lp(x, z):
    """Least vertical width by linear programming over all points."""
    from scipy.optimize import linprog

    one = np.ones_like(x)
    a = np.vstack([np.column_stack([-one, -x, -one]), np.column_stack([one, x, -one])])
    found = linprog([0, 0, 2], a, np.concatenate([-z, z]), bounds=(None, None), method="highs")
    return float(found.fun)


def enumerated(x, z, normal):
    """Least width over all directions through two points."""
    best = math.inf
    for i, j in combinations(range(x.size), 2):
        slope = (z[j] - z[i]) / (x[j] - x[i])
        width = float(np.ptp(z - slope * x))
        best = min(best, width / math.hypot(1.0, slope) if normal else width)
    return best


def lcg(seed, n):
    values, s = [], seed
    for _ in range(n):
        s = (1103515245 * s + 12345) % 2**31
        values.append((s // 65536) % 1000)
    return np.array(values, dtype=float)


def test_generator_is_that_of_the_specification():
    assert lcg(12345, 12).tolist() == G7.tolist()


# ---------------------------------------------------------------- published numbers


@pytest.mark.parametrize(
    ("reference", "expected"), [("MZ", 858.0), ("LS", 862.265734), ("EP", 1092.272727)]
)
def test_z02_random_integers(reference, expected):
    result = straightness_deviation(Profile(np.arange(12.0), G7), reference=reference)
    # The specification prints six decimals: half a unit of the last is 6e-10 relative.
    assert result.value == pytest.approx(expected, rel=RTOL, abs=0.0)


def test_z02_slope_and_support_of_the_minimum_zone():
    result = straightness_deviation(Profile(np.arange(12.0), G7))
    assert result.reference_parameters["slope"].value == pytest.approx(
        -24.0, rel=ROUNDING, abs=0.0
    )
    # Lower line through points 2 and 5, upper through 4: 927 - (117 - 24 * 2) = 858.
    assert sorted(result.support.lower.tolist()) == [2, 5]
    assert result.support.upper.tolist() == [4]
    assert result.is_optimal
    assert result.bound == pytest.approx(858.0, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(
    ("reference", "expected"), [("MZ", 2.0), ("LS", 3.1952016), ("EP", 3.079199736)]
)
def test_z01_chebyshev_cubic(reference, expected):
    x = np.linspace(-1.0, 1.0, 2001)
    result = straightness_deviation(Profile(x, 4 * x**3 - 3 * x), reference=reference)
    assert result.value == pytest.approx(expected, rel=RTOL, abs=0.0)


def test_least_squares_agrees_with_polyfit():
    rng = np.random.default_rng(3)
    x, z = np.sort(rng.uniform(5.0, 6.0, 60)), rng.normal(size=60)
    result = straightness_deviation(Profile(x, z), reference="LS")
    residual = z - np.polyval(np.polyfit(x - 5.5, z, 1), x - 5.5)
    assert result.table["STRt"].value == pytest.approx(np.ptp(residual), rel=1e-11, abs=0.0)
    assert result.table["STRp"].value == pytest.approx(residual.max(), rel=1e-11, abs=0.0)
    assert result.table["STRv"].value == pytest.approx(-residual.min(), rel=1e-11, abs=0.0)
    assert result.table["STRq"].value == pytest.approx(residual.std(), rel=1e-11, abs=0.0)


# ------------------------------------------------------- independent ways, random sets


@pytest.mark.parametrize("seed", range(12))
def test_minimum_zone_equals_linear_program_and_enumeration(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 40))
    x = np.sort(rng.uniform(-2.0, 3.0, n))
    z = rng.normal(size=n) if seed % 2 else np.round(rng.normal(size=n), 0)  # ties too
    result = straightness_deviation(Profile(x, z))
    assert result.value == pytest.approx(enumerated(x, z, False), rel=1e-10, abs=1e-13)
    assert result.value == pytest.approx(vertical_lp(x, z), rel=LP_RTOL, abs=1e-9)
    assert result.is_optimal


@pytest.mark.parametrize("seed", range(8))
def test_orthogonal_zone_equals_enumeration(seed):
    rng = np.random.default_rng(100 + seed)
    x = np.sort(rng.uniform(-1.0, 1.0, 25))
    z = rng.normal(size=25) * 0.3 + 1.5 * x
    result = straightness_deviation(Profile(x, z), normal=True)
    assert result.value == pytest.approx(enumerated(x, z, True), rel=1e-10, abs=0.0)
    assert result.value < straightness_deviation(Profile(x, z)).value
    assert result.bound == pytest.approx(result.value, rel=1e-10, abs=0.0)


def test_orthogonal_width_of_a_turned_part_is_that_of_the_part():
    angle = 0.3
    s = np.linspace(-1.0, 1.0, 201)
    d = 1e-3 * (4 * s**3 - 3 * s)
    x, z = s * math.cos(angle) - d * math.sin(angle), s * math.sin(angle) + d * math.cos(angle)
    flat = straightness_deviation(Profile(s, d), normal=True).value
    turned = straightness_deviation(Profile(x, z), normal=True)
    assert turned.value == pytest.approx(flat, rel=1e-10, abs=0.0)
    assert turned.reference_parameters["slope"].value == pytest.approx(
        math.tan(angle), rel=1e-10, abs=0.0
    )
    assert straightness_deviation(Profile(x, z)).value > 1.04 * flat  # 1/cos 0.3 = 1.0468


# ------------------------------------------------------------------------- the support


@pytest.mark.parametrize("seed", range(6))
def test_support_alternates_and_its_weights_give_the_width(seed):
    rng = np.random.default_rng(seed)
    profile = Profile(np.sort(rng.uniform(0, 1, 100)), 1e-6 * rng.normal(size=100))
    result = straightness_deviation(profile)
    held = result.support
    order = np.argsort(held.positions)
    assert held.sides[order].tolist() in ([1, -1, 1], [-1, 1, -1])
    signed = held.weights * held.sides
    assert abs(signed.sum()) < ROUNDING
    assert abs((signed * held.positions).sum()) < ROUNDING
    # No line can bring this sum below itself: it is the certificate.
    assert (signed * held.heights).sum() == pytest.approx(result.value, rel=1e-10, abs=0.0)


def test_residual_and_line_add_up_to_the_profile():
    x = np.linspace(10.0, 11.0, 50)
    z = 1e-6 * np.sin(9 * x) + 2e-4 * x
    for reference in ("MZ", "LS", "EP"):
        result = straightness_deviation(Profile(x, z), reference=reference)
        p = result.reference_parameters
        again = result.residual.z + p["intercept"].value + p["slope"].value * x
        assert float(np.abs(again - z).max()) < 1e-17
        assert float(np.ptp(result.residual.z)) == pytest.approx(
            result.value, rel=ROUNDING, abs=0.0
        )
        assert result.residual.history[-1].name == "straightness"


def test_end_point_residual_is_zero_at_both_ends():
    result = straightness_deviation(Profile([0, 1, 3], [5e-6, 9e-6, 2e-6]), reference="EP")
    assert result.residual.z[[0, -1]].tolist() == [0.0, 0.0]
    # 9 - (5 - 1) = 5 um above the line, nothing below it.
    assert result.table["STRp"].value == pytest.approx(5e-6, rel=ROUNDING, abs=0.0)
    assert result.table["STRv"].value == 0.0
    assert result.support.upper.tolist() == [1]


def test_peak_keeps_its_sign():
    z = np.zeros(11)
    z[5] = 1e-6
    up = straightness_deviation(Profile(np.arange(11.0), z), reference="LS")
    down = straightness_deviation(Profile(np.arange(11.0), -z), reference="LS")
    assert up.table["STRp"].value > 5 * up.table["STRv"].value
    assert down.table["STRv"].value == pytest.approx(up.table["STRp"].value, rel=ROUNDING, abs=0.0)


# ------------------------------------------------------------------------- invariances


@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e-3, 1.0, 1e3])
@pytest.mark.parametrize("reference", ["MZ", "LS", "EP"])
def test_units_do_not_matter(unit, reference):
    x = np.arange(12.0)
    one = straightness_deviation(Profile(x, G7), reference=reference)
    for xs in (x, x * unit):
        result = straightness_deviation(Profile(xs, G7 * unit), reference=reference)
        assert result.value / unit == pytest.approx(one.value, rel=ROUNDING, abs=0.0)
        assert result.support.indices.tolist() == one.support.indices.tolist()


def test_flip_shift_tilt_and_reverse():
    rng = np.random.default_rng(8)
    x, z = np.linspace(0, 0.4, 300), 1e-7 * rng.normal(size=300).cumsum()
    for reference in ("MZ", "LS", "EP"):
        value = straightness_deviation(Profile(x, z), reference=reference).value
        for other in (
            Profile(x, -z),
            Profile(x + 3.0, z + 1e-3),
            Profile(x, z + 1e-3 * x),
            Profile(x[::-1], z),
        ):
            again = straightness_deviation(other, reference=reference).value
            assert again == pytest.approx(value, rel=1e-9, abs=0.0)  # 1e-3 m added to 1e-6 m


def test_nan_equals_missing_samples():
    rng = np.random.default_rng(4)
    x, z = np.linspace(0, 1, 80), rng.normal(size=80)
    holes = z.copy()
    holes[[0, 7, 40, 41]] = np.nan
    kept = ~np.isnan(holes)
    for reference in ("MZ", "LS", "EP"):
        with_holes = straightness_deviation(Profile(x, holes), reference=reference)
        without = straightness_deviation(Profile(x[kept], z[kept]), reference=reference)
        assert with_holes.value == without.value
        assert with_holes.table.context.n_valid == 76
        assert with_holes.table.context.n_total == 80
        assert any("4 of 80" in note for note in with_holes.notes)
        assert np.isnan(with_holes.residual.z).tolist() == np.isnan(holes).tolist()
        at = with_holes.support.indices
        assert with_holes.support.heights.tolist() == z[at].tolist()


def test_input_is_not_changed():
    profile = Profile(np.arange(12.0), G7)
    straightness_deviation(profile)
    assert profile.z.tolist() == G7.tolist()


# ----------------------------------------------------------------------- special inputs


@pytest.mark.parametrize("z", [np.zeros(9), np.full(9, 7.5e-3), 3e-3 + 2e-3 * np.arange(9.0)])
@pytest.mark.parametrize("reference", ["MZ", "LS", "EP"])
def test_points_on_a_line_have_no_deviation(z, reference):
    result = straightness_deviation(Profile(np.arange(9.0), z), reference=reference)
    assert result.value <= 1e-15 * (1e-3 + float(np.abs(z).max()))
    assert result.is_optimal == (reference == "MZ")


def test_integers_are_accepted():
    assert straightness_deviation(Profile([0, 1, 2], [0, 2, 0])).value == pytest.approx(
        2.0, rel=1e-9, abs=0.0
    )


@pytest.mark.parametrize("z", [[np.nan] * 5, [1, np.nan, np.nan, np.nan, 2], [1] + [np.nan] * 4])
def test_too_few_valid_samples(z):
    with pytest.raises(TooFewSamplesError, match="3 valid samples"):
        straightness_deviation(Profile(np.arange(5.0), z))


@pytest.mark.parametrize("reference", ["MC", "MI", "ls", ""])
def test_unknown_reference(reference):
    with pytest.raises(DataError, match="MZ, LS and EP"):
        straightness_deviation(Profile([0, 1, 2], [0, 1, 0]), reference=reference)


def test_uneven_positions_are_noted():
    even = straightness_deviation(Profile([0, 1, 2, 3], [0, 1, 0, 1]), reference="LS")
    uneven = straightness_deviation(Profile([0, 1, 2, 4], [0, 1, 0, 1]), reference="LS")
    assert not any("not uniform" in n for n in even.notes)
    assert any("not uniform" in n for n in uneven.notes)


@pytest.mark.parametrize("shape", ["noise", "walk", "parabola", "sine", "cubic"])
def test_a_million_points_take_few_steps(shape, calls):
    rng = np.random.default_rng(0)
    x = np.linspace(-1.0, 1.0, 1_000_000)
    z = {
        "noise": rng.normal(size=x.size),
        "walk": rng.normal(size=x.size).cumsum(),
        "parabola": -(x**2),
        "sine": np.sin(20 * x),
        "cubic": 4 * x**3 - 3 * x,
    }[shape]
    profile = Profile(x, z)
    steps, result = calls(lambda: straightness_deviation(profile))
    assert steps < x.size / 50
    assert result.is_optimal
    if shape == "parabola":
        assert result.value == pytest.approx(1.0, rel=1e-11, abs=0.0)
    if shape == "cubic":
        assert result.value == pytest.approx(2.0, rel=1e-11, abs=0.0)


@pytest.mark.parametrize("slope", [0.0, 1e-4, 0.8, -3.0])
def test_normal_least_squares_line_is_that_of_the_singular_values(slope):
    rng = np.random.default_rng(8)
    x = np.sort(rng.uniform(0, 1e-3, 30))
    z = slope * x + 1e-5 * rng.standard_normal(30)
    points = np.stack([x - x.mean(), z - z.mean()])
    along = np.linalg.svd(points)[0][:, 0]
    off = along[0] * points[1] - along[1] * points[0]

    found = straightness_deviation(Profile(x, z), reference="LS", normal=True)

    assert found.value == pytest.approx(np.ptp(off), rel=1e-9, abs=0.0)
