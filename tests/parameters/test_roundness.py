"""Roundness: published numbers, closed forms, independent programs, invariances."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.parameters.deviation import roundness_deviation

RTOL = 1e-6
"""Acceptance row Z04 of the specification."""

ROUNDING = 1e-11
"""Relative: a few dozen operations in double precision, and the shift of a centre."""

LP_RTOL = 1e-6
"""Feasibility tolerance of HiGHS is 1e-7 in its own scaling."""

REFERENCES = ["LS", "MZ", "MC", "MI"]
R = 25e-3


def lcg(seed, n):
    values, s = [], seed
    for _ in range(n):
        s = (1103515245 * s + 12345) % 2**31
        values.append((s // 65536) % 1000)
    return np.array(values, dtype=float)


def turn(n):
    return 2.0 * np.pi * np.arange(n) / n


@pytest.fixture(scope="module")
def g9():
    z = lcg(7, 16) * 1e-9
    assert np.round(z[:4] * 1e9).tolist() == [564, 806, 868, 674]
    return Profile(turn(16), z)


def limacon_lp(angle, z, reference):
    """Width of the zone, or the radius of the circle, by linear programming over all points."""
    from scipy.optimize import linprog

    size = float(np.abs(z).max())
    h = z / size
    basis = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    one = np.ones((angle.size, 1))
    free = (None, None)
    if reference == "MZ":
        a = np.vstack([np.hstack([-basis, -one]), np.hstack([basis, -one])])
        cost, b = [0, 0, 0, 2], np.concatenate([-h, h])
    elif reference == "MC":
        a, b, cost = -basis, -h, [1, 0, 0]
    else:
        a, b, cost = basis, h, [-1, 0, 0]
    found = linprog(cost, a, b, bounds=free, method="highs").fun * size
    return -found if reference == "MI" else found


# ---------------------------------------------------------------------- published numbers


@pytest.mark.parametrize(("reference", "nm"), [("LS", 946.6346214), ("MZ", 856.7817459)])
def test_z04_limacon(g9, reference, nm):
    result = roundness_deviation(g9, reference=reference)
    assert result.value * 1e9 == pytest.approx(nm, rel=1e-9, abs=0.0)


def test_z04_exact_circles(g9):
    result = roundness_deviation(g9, exact=True, radius=R)
    # The specification prints five decimals of nm.
    assert result.value * 1e9 == pytest.approx(856.78186, abs=5e-6)
    full = Profile(g9.x, R + g9.z)
    again = roundness_deviation(full, exact=True)
    # 25 mm in double precision has steps of 3.5e-18 m.
    assert again.value == pytest.approx(result.value, abs=2e-17)
    assert again.reference_parameters["radius"].value == pytest.approx(
        result.reference_parameters["radius"].value, rel=1e-15, abs=0.0
    )


# -------------------------------------------------------------------------- closed forms


@pytest.mark.parametrize("lobes", [2, 3, 5, 8])
@pytest.mark.parametrize("reference", REFERENCES)
def test_lobes_have_twice_their_amplitude(lobes, reference):
    angle = turn(240)
    z = 3e-6 * np.cos(lobes * angle) + 8e-6 * np.cos(angle) - 5e-6 * np.sin(angle) + 1e-4
    result = roundness_deviation(Profile(angle, z), reference=reference)
    free = lobes == 2 and reference == "MI"  # between two opposite points the circle can move
    assert result.value == pytest.approx(6e-6, rel=0.03 if free else 1e-9, abs=0.0)
    expected = {"LS": 1e-4, "MZ": 1e-4, "MC": 1.03e-4, "MI": 0.97e-4}[reference]
    p = {k: q.value for k, q in result.reference_parameters.items()}
    assert p["radius"] == pytest.approx(expected, rel=1e-9, abs=0.0)
    assert p["b"] == pytest.approx(-5e-6, rel=1e-9, abs=0.0)
    if not free:  # an oval lying along angle 0 lets it move along angle 0
        assert p["a"] == pytest.approx(8e-6, rel=1e-9, abs=0.0)
    if reference == "LS":
        assert result.table["RONq"].value == pytest.approx(3e-6 / math.sqrt(2), rel=1e-9, abs=0.0)


def test_eccentric_circle_is_round_when_exact():
    e, angle = 1e-3, turn(500)
    radius = e * np.cos(angle - 0.7) + np.sqrt(R**2 - (e * np.sin(angle - 0.7)) ** 2)
    for reference in REFERENCES:
        exact = roundness_deviation(Profile(angle, radius), reference=reference, exact=True)
        assert exact.value < 3e-17  # a few steps of 25 mm in double precision
        p = {k: q.value for k, q in exact.reference_parameters.items()}
        assert p["a"] == pytest.approx(e * math.cos(0.7), rel=1e-9, abs=0.0)
        assert p["b"] == pytest.approx(e * math.sin(0.7), rel=1e-9, abs=0.0)
        assert p["radius"] == pytest.approx(R, rel=1e-12, abs=0.0)
    limacon = roundness_deviation(Profile(angle, radius), reference="MZ", radius=None)
    # The limacon misses a second harmonic: e^2 / (2 R) peak to valley = 20 um.
    assert limacon.value == pytest.approx(e**2 / (2 * R), rel=1e-3, abs=0.0)


def test_two_opposite_peaks_hold_the_circumscribed_circle():
    z = np.zeros(16)
    z[[0, 8]] = 1e-6
    z[[3, 13]] = 0.2e-6
    profile = Profile(turn(16), z)
    limacon = roundness_deviation(profile, reference="MC")
    assert sorted(limacon.support.indices.tolist()) == [0, 8]
    # The circle stands on the diameter, centre 0: the lowest point is 1 um inside.
    assert limacon.reference_parameters["b"].value == pytest.approx(0.0, abs=1e-18)
    assert limacon.value == pytest.approx(1e-6, rel=ROUNDING, abs=0.0)
    assert any("two opposite points" in note for note in limacon.notes)
    z[13] = 0.0  # one side only: the true circle stays on the diameter
    exact = roundness_deviation(Profile(turn(16), z), reference="MC", exact=True, radius=R)
    assert exact.value == pytest.approx(1e-6, rel=1e-9, abs=0.0)
    assert exact.reference_parameters["b"].value == pytest.approx(0.0, abs=1e-15)
    assert exact.is_optimal


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("reference", ["MC", "MI"])
def test_centring_does_not_matter_where_two_points_hold(seed, reference):
    rng = np.random.default_rng(seed)
    z = rng.uniform(-0.3, 0.3, 24)
    z[[5, 17]] = 1.0 if reference == "MC" else -1.0
    off = z + 7.0 * np.cos(turn(24)) - 4.0 * np.sin(turn(24))
    one = roundness_deviation(Profile(turn(24), z), reference=reference)
    other = roundness_deviation(Profile(turn(24), off), reference=reference)
    assert len(one.support) == 2
    assert other.value == pytest.approx(one.value, rel=ROUNDING, abs=0.0)
    if reference == "MC":  # a centred part: the true circle of a large radius agrees
        usual = roundness_deviation(Profile(turn(24), z), reference="LS").reference_parameters
        z = z - usual["a"].value * np.cos(turn(24)) - usual["b"].value * np.sin(turn(24))
        true = roundness_deviation(Profile(turn(24), z), reference="MC", exact=True, radius=1e6)
        assert true.value == pytest.approx(one.value, rel=1e-5, abs=0.0)


# --------------------------------------------------------- independent ways, random sets


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("reference", ["MZ", "MC", "MI"])
def test_limacon_equals_linear_program(seed, reference):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 120))
    angle = turn(n) + rng.uniform(0, 0.5 / n, n)
    z = 1e-6 * (rng.normal(size=n) if seed % 2 else np.round(rng.normal(size=n)))
    result = roundness_deviation(Profile(angle, z), reference=reference)
    expected = limacon_lp(angle, z, reference)
    if reference == "MZ":
        assert result.value == pytest.approx(expected, rel=LP_RTOL, abs=1e-15)
    radius = result.reference_parameters["radius"].value
    got = result.value if reference == "MZ" else radius
    assert got == pytest.approx(expected, rel=LP_RTOL, abs=1e-13)
    assert result.is_optimal


def smallest_circle(x, y):
    """Radius and centre of the smallest circle around points, over all pairs and triples."""
    best = (math.inf, 0.0, 0.0)
    for k in (2, 3):
        for chosen in combinations(range(x.size), k):
            i = list(chosen)
            if k == 2:
                a, b = x[i].mean(), y[i].mean()
            else:
                m = 2 * np.column_stack([x[i][1:] - x[i][0], y[i][1:] - y[i][0]])
                if abs(np.linalg.det(m)) < 1e-12:
                    continue
                q = x[i] ** 2 + y[i] ** 2
                a, b = np.linalg.solve(m, q[1:] - q[0])
            distance = np.hypot(x - a, y - b)
            if distance.max() <= distance[i].max() * (1 + 1e-12):
                best = min(best, (float(distance.max()), float(a), float(b)))
    return best


@pytest.mark.parametrize("seed", range(6))
def test_exact_circumscribed_circle_equals_enumeration(seed):
    rng = np.random.default_rng(seed)
    angle = turn(14)
    radius = 1.0 + 0.05 * rng.normal(size=14)  # strongly out of round: no limacon
    result = roundness_deviation(Profile(angle, radius), reference="MC", exact=True)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    expected, a, b = smallest_circle(x, y)
    p = result.reference_parameters
    assert p["radius"].value == pytest.approx(expected, rel=1e-10, abs=0.0)
    inside = expected - np.hypot(x - a, y - b)
    assert result.value == pytest.approx(inside.max(), rel=1e-6, abs=0.0)
    assert result.is_optimal


@pytest.mark.parametrize("seed", range(4))
def test_exact_minimum_zone_is_least_on_a_net_of_centres(seed):
    rng = np.random.default_rng(20 + seed)
    angle = turn(20)
    radius = 1.0 + 0.01 * rng.normal(size=20)
    result = roundness_deviation(Profile(angle, radius), exact=True)
    a, b = (result.reference_parameters[k].value for k in "ab")
    x, y = radius * np.cos(angle), radius * np.sin(angle)

    def width(a, b):
        return float(np.ptp(np.hypot(x - a, y - b)))

    assert width(a, b) == pytest.approx(result.value, rel=1e-10, abs=0.0)
    net = np.linspace(-0.03, 0.03, 61)
    assert min(width(p, q) for p in net for q in net) >= result.value
    near = a + 1e-5 * np.array([-1, 0, 1, 0]), b + 1e-5 * np.array([0, -1, 0, 1])
    assert all(width(p, q) > result.value for p, q in zip(*near, strict=True))


def test_exact_least_squares_is_stationary():
    rng = np.random.default_rng(1)
    angle = turn(30)
    radius = 1.0 + 0.05 * rng.normal(size=30)
    result = roundness_deviation(Profile(angle, radius), reference="LS", exact=True)
    a, b = (result.reference_parameters[k].value for k in "ab")
    x, y = radius * np.cos(angle), radius * np.sin(angle)

    def spread(a, b):
        return float(np.var(np.hypot(x - a, y - b)))

    assert spread(a, b) == pytest.approx(result.table["RONq"].value ** 2, rel=1e-9, abs=0.0)
    for da, db in ((1e-4, 0), (-1e-4, 0), (0, 1e-4), (0, -1e-4)):
        assert spread(a + da, b + db) > spread(a, b)


# ---------------------------------------------------------------------------- the support


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("exact", [False, True])
def test_minimum_zone_alternates(seed, exact):
    rng = np.random.default_rng(seed)
    profile = Profile(turn(90), 1e-6 * rng.normal(size=90))
    result = roundness_deviation(profile, exact=exact, radius=R if exact else None)
    order = np.argsort(result.support.positions)
    assert result.support.sides[order].tolist() in ([1, -1, 1, -1], [-1, 1, -1, 1])
    at = result.support.indices
    touching = result.residual.z[at] * result.support.sides
    assert float(np.abs(touching - 0.5 * result.value).max()) < 1e-17


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("reference", "side"), [("MC", 1), ("MI", -1)])
def test_one_sided_circles_are_held_all_around(seed, reference, side):
    rng = np.random.default_rng(seed)
    profile = Profile(turn(91), 1e-6 * rng.normal(size=91))
    result = roundness_deviation(profile, reference=reference)
    held = result.support
    assert held.sides.tolist() == [side] * 3
    around = np.sort(held.positions)
    assert np.diff([*around, around[0] + 2 * np.pi]).max() < np.pi
    # The weighted directions cancel, so the weighted height is the radius of every limacon.
    assert held.weights.sum() == pytest.approx(1.0, rel=ROUNDING, abs=0.0)
    assert abs(held.weights @ np.cos(held.positions)) < 1e-12
    assert abs(held.weights @ np.sin(held.positions)) < 1e-12
    radius = result.reference_parameters["radius"].value
    assert held.weights @ held.heights == pytest.approx(radius, rel=1e-9, abs=0.0)
    prefix = {"MC": "RONp", "MI": "RONv"}[reference]
    assert result.table[prefix].value < 1e-20


def test_a_peak_outside_is_positive():
    z = np.zeros(36)
    z[9] = 2e-6
    result = roundness_deviation(Profile(turn(36), z), reference="LS")
    assert result.table["RONp"].value > 5 * result.table["RONv"].value
    assert result.reference_parameters["b"].value > 0  # towards the peak at pi/2
    assert result.support.upper.tolist() == [9]


# ---------------------------------------------------------------------------- invariances


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("exact", [False, True])
def test_units_do_not_matter(g9, unit, reference, exact):
    def value(factor):
        radius = R * factor if exact else None
        p = Profile(g9.x, g9.z * factor)
        return roundness_deviation(p, reference=reference, exact=exact, radius=radius).value

    assert value(unit) / unit == pytest.approx(value(1.0), rel=1e-10, abs=0.0)


@pytest.mark.parametrize("reference", REFERENCES)
def test_turn_mirror_flip_and_shift(g9, reference):
    one = roundness_deviation(g9, reference=reference).value
    other = {"MC": "MI", "MI": "MC"}.get(reference, reference)
    tilted = g9.z + 1e-6 * np.cos(g9.x) - 2e-6 * np.sin(g9.x) + 1e-3
    assert roundness_deviation(Profile(g9.x, np.roll(g9.z, 5)), reference=reference).value == (
        pytest.approx(one, rel=ROUNDING, abs=0.0)
    )
    for profile, ref in (
        (Profile(g9.x + 2.0, g9.z), reference),
        (Profile(g9.x, g9.z[::-1]), reference),
        (Profile(g9.x, -g9.z), other),
        (Profile(g9.x, tilted), reference),
    ):
        assert roundness_deviation(profile, reference=ref).value == pytest.approx(
            one, rel=1e-9, abs=0.0
        )


@pytest.mark.parametrize("reference", REFERENCES)
def test_nan_equals_missing_samples(g9, reference):
    z = g9.z.copy()
    z[[0, 7]] = np.nan
    kept = ~np.isnan(z)
    holes = roundness_deviation(Profile(g9.x, z), reference=reference)
    without = roundness_deviation(Profile(g9.x[kept], z[kept]), reference=reference)
    assert holes.value == without.value
    assert holes.table.context.n_valid == 14
    assert np.isnan(holes.residual.z).tolist() == np.isnan(z).tolist()
    assert holes.support.heights.tolist() == z[holes.support.indices].tolist()


@pytest.mark.parametrize("reference", REFERENCES)
def test_a_repeated_end_does_not_count_twice(g9, reference):
    closed = Profile([*g9.x, 2 * np.pi], [*g9.z, g9.z[0]])
    result = roundness_deviation(closed, reference=reference)
    assert result.value == pytest.approx(
        roundness_deviation(g9, reference=reference).value, rel=ROUNDING, abs=0.0
    )
    open_rms = roundness_deviation(g9, reference=reference).table["RONq"].value
    assert result.table["RONq"].value == pytest.approx(open_rms, rel=1e-10, abs=0.0)
    assert any("one turn after" in note for note in result.notes)


def test_a_filter_takes_the_mean_of_a_place_that_was_read_twice():
    """A trace that does not close, through a filter of our own: what its first or its last reading holds counts alike."""
    n, upr, error = 720, 50.0, 4e-6
    angle = 2.0 * np.pi * np.arange(n + 1) / n
    wave = 1e-6 * np.cos(3.0 * angle)
    found = []
    for at in (0, n):
        z = wave.copy()
        z[at] += error
        found.append(roundness_deviation(Profile(angle, z), reference="LS", upr=upr).value)

    z = wave[:n] + np.where(np.arange(n) == 0, error / 2.0, 0.0)
    order = np.arange(n // 2 + 1)
    kept = np.fft.rfft(z) * 2.0 ** -((order / upr) ** 2)
    kept[:2] = 0.0  # centre and radius
    expected = np.ptp(np.fft.irfft(kept, n))
    assert found[0] == pytest.approx(found[1], abs=1e-6 * error)
    assert found[1] == pytest.approx(expected, abs=1e-3 * error)  # LS circle of the filtered ends


def test_a_step_at_the_seam_is_not_hidden():
    z = np.zeros(37)
    z[-1] = 1e-6
    profile = Profile(np.linspace(0, 2 * np.pi, 37), z)
    assert roundness_deviation(profile).value == pytest.approx(1e-6, rel=ROUNDING, abs=0.0)


# ------------------------------------------------------------------------- special inputs


@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("level", [0.0, 25e-3])
def test_constant_radius_has_no_deviation(reference, level):
    result = roundness_deviation(Profile(turn(24), np.full(24, level)), reference=reference)
    assert result.value <= 1e-17
    assert result.reference_parameters["radius"].value == pytest.approx(level, abs=1e-17)
    assert result.is_optimal == (reference != "LS")


def test_partial_trace_is_noted_and_half_a_turn_refused():
    angle = np.linspace(0, 1.5 * np.pi, 60)
    z = 1e-6 * np.cos(3 * angle)
    for reference in REFERENCES:
        result = roundness_deviation(Profile(angle, z), reference=reference)
        assert any("270 degrees" in note for note in result.notes)
        assert reference == "LS" or result.is_optimal
        for arc in (1.0, 0.5):
            with pytest.raises(DegenerateFitError, match="half a turn"):
                roundness_deviation(
                    Profile(np.linspace(0, arc * np.pi, 60), z), reference=reference
                )


def test_a_gap_of_nan_is_a_gap():
    z = np.zeros(36)
    z[4:25] = np.nan
    with pytest.raises(DegenerateFitError, match="220 degrees"):
        roundness_deviation(Profile(turn(36), z))


def test_degrees_and_several_turns_are_refused():
    for angle in (np.arange(360.0), np.linspace(0, 4 * np.pi, 200)):
        with pytest.raises(InvalidSamplesError, match="one turn"):
            roundness_deviation(Profile(angle, np.zeros(angle.size)))


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_samples(n):
    z = np.full(12, np.nan)
    z[[0, 4, 8][:n]] = 1e-6
    with pytest.raises(TooFewSamplesError, match="4 valid samples"):
        roundness_deviation(Profile(turn(12), z))


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, math.inf])
def test_radius_must_be_positive(g9, radius):
    with pytest.raises(DataError, match="positive"):
        roundness_deviation(g9, exact=True, radius=radius)


def test_radius_missing_or_given_twice(g9):
    with pytest.raises(DataError, match="needs radius"):
        roundness_deviation(g9, exact=True)
    with pytest.raises(DataError, match="leave radius= out"):
        roundness_deviation(Profile(g9.x, g9.z + R), radius=R)


def test_wild_trace_ends_with_a_named_error_or_an_answer():
    angle = turn(12)
    radius = 1.0 + 0.2 * np.cos(4 * angle)
    for reference in REFERENCES:
        try:
            result = roundness_deviation(Profile(angle, radius), reference=reference, exact=True)
        except NotConvergedError:
            continue
        assert np.isfinite(result.value)


@pytest.mark.parametrize("reference", REFERENCES)
def test_a_hundred_thousand_points_take_few_steps(reference, calls):
    rng = np.random.default_rng(0)
    angle = turn(100_000)
    profile = Profile(angle, 1e-6 * np.cos(2 * angle) + 1e-8 * rng.normal(size=angle.size))
    steps, result = calls(lambda: roundness_deviation(profile, reference=reference))
    assert steps < angle.size / 25  # a step a point would be 100,000
    assert reference == "LS" or result.is_optimal
