"""Spindle analysis: known synchronous motion, known scatter, all directions, all refusals (S19)."""

import copy
import json
import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.circles.resampling import resample_by_encoder
from metrosep.separation.circles.spindle import iso230_7

TURN = 2 * np.pi
NM = 1e-9
ROUNDING = 1e-20  # m: of motions of some um


def grid(n):
    return np.arange(n) * TURN / n


def curve(seed, n, *, orders=range(2, 51), size=20 * NM):
    """Motion of known harmonics with 1/k amplitudes, and their complex amplitudes."""
    rng = np.random.default_rng(seed)
    c = {k: size / k * rng.normal() * np.exp(1j * rng.uniform(0, TURN)) for k in orders}
    t = grid(n)
    return sum((c[k] * np.exp(1j * k * t)).real for k in orders), c


def eccentric(n, size=3e-6, at=0.7):
    return size * np.cos(grid(n) - at)


# -- S19: values --------------------------------------------------------------------------------


def test_noise_free_radial_motion_is_exact():
    s, c = curve(1, 720)
    result = iso230_7(np.tile(s + eccentric(720) + 4e-6, (20, 1)))

    assert abs(result.synchronous.value - np.ptp(s)) < ROUNDING
    assert result.asynchronous.value < ROUNDING
    assert abs(result.total.value - np.ptp(s)) < ROUNDING
    assert abs(result["eccentricity"].value - 3e-6) < ROUNDING
    np.testing.assert_allclose(
        result.centre, (3e-6 * np.cos(0.7), 3e-6 * np.sin(0.7)), rtol=0, atol=ROUNDING
    )
    for k in (2, 7, 50):
        i = k - 1
        assert abs(result.harmonics.amplitude[i] - abs(c[k])) < ROUNDING
        phase = np.exp(1j * result.harmonics.phase[i])
        assert abs(phase - np.exp(-1j * np.angle(c[k]))) < 1e-9
    assert result.harmonics.removed == (1,)
    assert result.unit == "m"


@pytest.mark.parametrize("seed", range(4))
def test_known_motion_in_noise(seed):
    """S19: synchronous value to 1 %, standard deviation to 3 %."""
    n, m = 1024, 100
    s, _ = curve(seed, n)
    sigma = 0.05 * np.ptp(s)
    rng = np.random.default_rng(100 + seed)
    x = s + eccentric(n) + rng.normal(0, sigma, (m, n))

    literal = iso230_7(x)
    limited = iso230_7(x, kmax=50)

    assert abs(limited.synchronous.value / np.ptp(s) - 1) < 0.01
    assert abs(literal["synchronous_corrected"].value / np.ptp(s) - 1) < 0.01
    assert abs(literal["asynchronous_sd"].value / sigma - 1) < 0.03
    assert literal["asynchronous_4s"].value == pytest.approx(
        4 * literal["asynchronous_sd"].value, abs=ROUNDING
    )


def test_values_are_those_of_the_definitions():
    """Every number from its words, by loops."""
    s, _ = curve(3, 90, orders=range(2, 9))
    rng = np.random.default_rng(8)
    x = s + rng.normal(0, 5 * NM, (6, 90))
    t = grid(90)
    mean = [np.mean([x[i, j] for i in range(6)]) for j in range(90)]
    basis = np.stack([np.ones(90), np.cos(t), np.sin(t)], axis=1)
    circle = basis @ np.linalg.lstsq(basis, np.array(mean), rcond=None)[0]

    result = iso230_7(x)

    assert abs(result.synchronous.value - np.ptp(mean - circle)) < ROUNDING
    ranges = [max(x[:, j]) - min(x[:, j]) for j in range(90)]
    assert abs(result.asynchronous.value - max(ranges)) < ROUNDING
    assert abs(result.total.value - np.ptp(x - circle)) < ROUNDING
    np.testing.assert_allclose(result.asynchronous_range, ranges, rtol=0, atol=ROUNDING)
    sd = [np.std(x[:, j], ddof=1) for j in range(90)]
    np.testing.assert_allclose(result.asynchronous_sd, sd, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(result.motion, x - circle, rtol=0, atol=ROUNDING)


@pytest.mark.slow
def test_bias_constants_of_the_specification():
    """Range 6.25, 6.80, 7.20 sd at 20, 50, 100 turns; noise alone gives 1.32, 0.59 sd."""
    rng = np.random.default_rng(2)
    found = {}
    for m in (20, 50, 100):
        runs = [iso230_7(rng.normal(size=(m, 360)) * NM, seed=i) for i in range(150)]
        found[m] = [np.mean([r.asynchronous.value for r in runs]) / NM]
        found[m] += [np.mean([r.synchronous.value for r in runs]) / NM]
        found[m] += [np.mean([r["noise_floor"].value for r in runs]) / NM]
    # 150 runs: sd of the mean of a range 0.03, of a synchronous value 0.01
    assert [found[m][0] for m in (20, 50, 100)] == pytest.approx([6.25, 6.8, 7.2], abs=0.12)
    assert found[20][1] == pytest.approx(1.32, abs=0.04)
    assert found[100][1] == pytest.approx(0.59, abs=0.02)
    assert found[20][2] == pytest.approx(1.32, abs=0.04)
    assert found[100][2] == pytest.approx(0.59, abs=0.02)


def test_noise_alone_is_called_noise():
    rng = np.random.default_rng(4)
    result = iso230_7(rng.normal(size=(30, 360)) * NM)

    assert not result.harmonics.significant.any()
    assert any("no harmonic repeats" in m for m in result.messages)
    assert result["synchronous_corrected"].value < 0.25 * result.synchronous.value


# -- directions --------------------------------------------------------------------------------


def test_axial_keeps_the_fundamental():
    s, _ = curve(5, 360, orders=range(2, 12))
    once = 40 * NM * np.sin(grid(360) + 0.3)
    x = np.tile(s + once, (20, 1))

    axial, radial = iso230_7(x, direction="axial"), iso230_7(x)

    assert abs(axial.synchronous.value - np.ptp(s + once)) < ROUNDING
    assert abs(axial["fundamental"].value - 80 * NM) < ROUNDING
    assert abs(axial["residual_synchronous"].value - np.ptp(s)) < ROUNDING
    assert axial.harmonics.removed == ()
    assert axial.center == "PC"
    assert abs(radial.synchronous.value - np.ptp(s)) < ROUNDING


def test_face_keeps_the_fundamental_and_says_what_is_in_it():
    s, _ = curve(5, 360, orders=range(2, 12))
    x = np.tile(s + 40 * NM * np.sin(grid(360)), (20, 1))

    result = iso230_7(x, direction="face")

    assert abs(result["residual_synchronous"].value - np.ptp(s)) < ROUNDING
    assert any("squareness of the plate" in m for m in result.messages)


def test_tilt_is_upper_minus_lower_over_the_distance():
    s, _ = curve(6, 360, orders=range(2, 12))
    n = 360
    pivot = np.random.default_rng(1).normal(0, 3 * NM, (20, n))
    lower = 0.4 * s + pivot + eccentric(n, 1e-6)
    upper = lower + s + eccentric(n, 2e-6, 0.2)

    result = iso230_7(np.stack([upper, lower]), direction="tilt", distance=0.05)
    swapped = iso230_7({"lower": upper, "upper": lower}, direction="tilt", distance=0.05)

    assert result.unit == "rad"
    assert abs(result.synchronous.value - np.ptp(s) / 0.05) < 1e-15
    assert abs(result["artefact_tilt"].value - 2e-6 / 0.05) < 1e-15
    assert result.asynchronous.value < 1e-15  # both sensors see the pivot
    np.testing.assert_allclose(
        swapped.synchronous_motion, -result.synchronous_motion, rtol=0, atol=1e-15
    )


def orbit(n, terms):
    """X + iY = sum of c exp(i m t)."""
    t = grid(n)
    z = sum(c * np.exp(1j * m * t) for m, c in terms.items())
    return np.stack([z.real, z.imag])[:, None, :].repeat(20, axis=1)


@pytest.mark.parametrize(
    ("m", "k"),
    [(-3, 4), (-2, 3), (-1, 2), (3, 2), (4, 3), (6, 5), (1, None), (0, None), (2, None)],
)
def test_rotating_direction_moves_each_circle_by_one(m, k):
    """Circle m of X + iY is harmonic |m - 1|; m = 1 vanishes; m = 0 and 2 are k = 1, removed."""
    result = iso230_7(orbit(360, {m: 7 * NM * np.exp(0.4j)}), sensitive="rotating")

    if k is None:
        assert result.synchronous.value < ROUNDING
    else:
        assert abs(result.harmonics.amplitude[k - 1] - 7 * NM) < ROUNDING
        between = 14 * NM * (1 - np.cos(np.pi * k / 360))  # the crest may lie between two angles
        assert -between <= result.synchronous.value - 14 * NM < ROUNDING


def test_rotating_direction_reports_what_vanishes():
    terms = {0: 1e-6, 1: 3e-6 * 1j, 2: 5 * NM, -1: 4 * NM}
    result = iso230_7(orbit(360, terms), sensitive="rotating")

    assert abs(result["eccentricity"].value - 3e-6) < ROUNDING
    assert abs(result.audit["sensor_offset"] - 1e-6) < ROUNDING
    assert abs(result.audit["forward_twice"] - 5 * NM) < ROUNDING
    assert any("twice per revolution by 5 nm" in m for m in result.messages)
    assert abs(result.synchronous.value - 8 * NM) < 0.001 * NM


def test_ellipse_is_seen_rotating_and_not_fixed():
    """X = a cos t, Y = b sin t: fixed X calls it eccentricity, the boring tool cuts (a-b)/2 cos 2t."""
    t = grid(360)
    both = np.stack([10 * NM * np.cos(t), 4 * NM * np.sin(t)])[:, None].repeat(20, axis=1)

    fixed = iso230_7(both[0])
    rotating = iso230_7(both, sensitive="rotating")

    assert fixed.synchronous.value < ROUNDING
    assert abs(rotating.synchronous.value - 6 * NM) < ROUNDING


def test_rotating_tilt_takes_four_sensors():
    lower = orbit(360, {1: 2e-6, -2: 3 * NM})
    upper = lower + orbit(360, {-1: 5 * NM, 1: 1e-6})

    result = iso230_7(
        np.concatenate([upper, lower]), direction="tilt", sensitive="rotating", distance=0.1
    )

    assert abs(result.synchronous.value - 10 * NM / 0.1) < 1e-15
    assert abs(result["artefact_tilt"].value - 1e-6 / 0.1) < 1e-15


# -- centres -----------------------------------------------------------------------------------


def widths(s):
    x = np.tile(s + eccentric(s.size), (20, 1))
    return {c: iso230_7(x, center=c).synchronous.value for c in ("LSC", "MZC", "MIC", "MCC")}


def test_centres_of_a_three_lobed_motion_agree():
    """cos 3t: the best centre is 0 for all four."""
    for value in widths(5 * NM * np.cos(3 * grid(360))).values():
        assert abs(value - 10 * NM) < 1e-14


def test_centres_by_brute_force():
    """A bump on one side: the least of each over a fine grid of centres."""
    t = grid(180)
    s = 10 * NM * np.exp(-(((t - 1.0) / 0.3) ** 2)) - 6 * NM * np.exp(-(((t - 3.5) / 0.2) ** 2))
    found = widths(s)
    x = np.tile(s, (20, 1))

    # the finest grid is 0.6 pm; opposite supports leave the width, not the size, of MIC and MCC free
    for center, cost in (
        ("MZC", lambda rest: rest.max(axis=-1) - rest.min(axis=-1)),
        ("MCC", lambda rest: rest.max(axis=-1)),
        ("MIC", lambda rest: -rest.min(axis=-1)),
    ):
        at, half = np.zeros(2), 8 * NM
        for _ in range(9):
            line = np.linspace(-half, half, 41)
            a, b = np.meshgrid(at[0] + line, at[1] + line)
            costs = cost(s - a[..., None] * np.cos(t) - b[..., None] * np.sin(t))
            best = np.argmin(costs)
            at, half = np.array([a.flat[best], b.flat[best]]), 0.35 * half
        c = iso230_7(x, center=center).centre
        assert abs(cost(s - c[0] * np.cos(t) - c[1] * np.sin(t)) - costs.flat[best]) < 0.01 * NM
    assert found["MZC"] <= min(found.values()) + 1e-15
    assert found["MZC"] < found["LSC"] - 0.5 * NM


@pytest.mark.parametrize(
    ("center", "reference"), [("LSC", "LS"), ("MZC", "MZ"), ("MIC", "MI"), ("MCC", "MC")]
)
@pytest.mark.parametrize("base", [1e-3, 20e-3])
def test_value_does_not_depend_on_the_base_radius(center, reference, base):
    """True circles on a chart of radius `base`; motion^2 / base = 1e-13 m is the difference."""
    s, _ = curve(11, 360, orders=range(2, 12))
    width = widths(s)[center]

    true = ms.parameters.form_deviation(
        ms.Profile(grid(360), s), kind="roundness", reference=reference, exact=True, radius=base
    )

    assert abs(true.value - width) < 1e-13


def test_other_name_of_the_minimum_zone():
    s, _ = curve(11, 360, orders=range(2, 12))
    x = np.tile(s, (20, 1))
    assert iso230_7(x, center="MRS").synchronous == iso230_7(x, center="MZC").synchronous


# -- uncertainty -------------------------------------------------------------------------------


@pytest.mark.parametrize("m", [20, pytest.param(60, marks=pytest.mark.slow)])
def test_uncertainties_are_those_of_repeats(m):
    """Against the scatter of 150 repeated tests with noise correlated over angle."""
    s, _ = curve(2, 256, orders=range(2, 8))
    rng = np.random.default_rng(9)
    names = ("synchronous", "asynchronous", "total", "asynchronous_sd", "eccentricity")
    found, stated = [], []
    for i in range(150):
        noise = rng.normal(size=(m, 256))
        noise = 3 * NM * (noise + np.roll(noise, 1, axis=1) + np.roll(noise, 2, axis=1))
        result = iso230_7(s + eccentric(256) + noise, seed=i)
        found.append([result[q].value for q in names])
        stated.append([result[q].u for q in names])
    ratio = np.mean(stated, axis=0) / np.std(found, axis=0, ddof=1)

    # standard deviation of 150: 6 %; the extreme-value forms are good to 15 %
    assert np.all(np.abs(ratio - 1) < [0.2, 0.25, 0.35, 0.2, 0.2])


@pytest.mark.slow
def test_harmonic_uncertainty_is_that_of_repeats():
    s, c = curve(2, 128, orders=range(2, 8))
    rng = np.random.default_rng(1)
    z = []
    for _ in range(200):
        h = iso230_7(s + rng.normal(0, 3 * NM, (20, 128))).harmonics
        z.append((h.amplitude[2] - abs(c[3])) / h.u[2])
    assert abs(np.std(z) - 1) < 0.2
    assert abs(np.mean(z)) < 0.25


def test_nrr_is_the_scatter_of_one_harmonic():
    """Amplitude of k = 5 that differs from turn to turn; all else repeats."""
    rng = np.random.default_rng(6)
    a = rng.normal(0, 2 * NM, 50)
    t = grid(100)
    x = a[:, None] * np.cos(5 * t) + 8 * NM * np.cos(3 * t)

    h = iso230_7(x).harmonics

    assert abs(h.nrr[4] - np.std(a, ddof=1)) < ROUNDING
    assert np.delete(h.nrr, 4).max() < ROUNDING
    assert h.significant[2]


# -- angle and shapes --------------------------------------------------------------------------


def record(m=30, per_turn=400.37, sense=1, sigma=0.5 * NM):
    i = np.arange(int((m + 0.5) * per_turn))
    angle = 0.9 + TURN / per_turn * (i + 10 * np.sin(i / 900))
    rng = np.random.default_rng(12)

    def at(t):
        return 20 * NM * np.cos(2 * t + 0.3) + 9 * NM * np.sin(5 * t)

    noise = rng.normal(0, sigma, i.size)
    return at(sense * angle) + 3e-6 * np.cos(sense * angle) + noise, sense * angle, at


@pytest.mark.parametrize("sense", [1, -1])
def test_encoder_record(sense):
    x, angle, at = record(sense=sense)

    result = iso230_7(x, np.mod(angle, TURN))

    truth = at(result.angle)
    assert abs(result.synchronous.value / np.ptp(truth) - 1) < 0.02
    assert abs(result["asynchronous_sd"].value / (0.5 * NM) - 1) < 0.03
    assert np.abs(result.synchronous_motion - truth).max() < 0.5 * NM
    assert result.n_revolutions == 30


def test_same_result_from_every_shape():
    x, angle, _ = record()
    resampled = resample_by_encoder(x, angle)
    t = np.arange(x.size) * 1e-4
    recording = ms.Recording(t, {"gap": x, "angle": angle}, units={"gap": "m", "angle": "rad"})

    values = [
        iso230_7(x, angle),
        iso230_7(resampled),
        iso230_7(resampled.table),
        iso230_7({"gap": x}, angle),
        iso230_7({"gap": x, "other": 0 * x}, angle, channels="gap"),
        iso230_7(recording, "angle"),
        iso230_7(resampled.table, resampled.angle),
        iso230_7(resampled.table.tolist()),
    ]

    assert len({r.synchronous.value for r in values}) == 1
    assert len({r.asynchronous.value for r in values}) == 1


def test_grid_that_starts_elsewhere_or_falls():
    t = grid(90)
    s = 20 * NM * np.cos(2 * t + 0.3) + 9 * NM * np.sin(5 * t) + 3e-6 * np.cos(t)
    plain = iso230_7(np.tile(s, (20, 1)))
    rolled = iso230_7(np.tile(np.roll(s, -17), (20, 1)), t + 17 * TURN / 90)
    falling = iso230_7(np.tile(s[::-1], (20, 1)), t[::-1])

    for other in (rolled, falling):
        assert abs(other.synchronous.value - plain.synchronous.value) < ROUNDING
        np.testing.assert_allclose(
            np.exp(1j * other.harmonics.phase[[1, 4]]),
            np.exp(1j * plain.harmonics.phase[[1, 4]]),
            rtol=0,
            atol=1e-9,
        )
        np.testing.assert_allclose(other.centre, plain.centre, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("sense", [1, -1])
def test_drift_is_named_and_a_line_removed(sense):
    x, angle, at = record(sense=sense, sigma=0.1 * NM)
    x = x + 200 * NM * np.arange(x.size) / x.size

    kept, free = iso230_7(x, angle), iso230_7(x, angle, drift="linear")

    assert any("drift by" in m for m in kept.messages)
    assert any("deviate alike" in m for m in kept.messages)
    assert kept.asynchronous.value > 150 * NM
    assert free.asynchronous.value < 1.5 * NM
    assert np.abs(free.synchronous_motion - at(free.angle)).max() < 0.3 * NM
    assert abs(kept.audit["drift_per_revolution"] - 200 * NM / 30.5) < 0.1 * NM


def test_revolution_with_a_gap_is_left_out_and_named():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(25, 64)) * NM
    x[7, 3] = np.nan
    before = x.copy()

    result = iso230_7(x)

    np.testing.assert_array_equal(x, before)
    assert result.n_revolutions == 24
    assert 7 not in result.revolutions
    assert any("omitted 1 revolution" in m and "7" in m for m in result.messages)
    whole = iso230_7(np.delete(x, 7, axis=0))
    assert whole.synchronous.value == result.synchronous.value


# -- warnings and refusals ---------------------------------------------------------------------


def test_few_revolutions_warn_and_one_is_refused():
    x = np.random.default_rng(0).normal(size=(20, 64)) * NM

    assert not any("asks for 20" in m for m in iso230_7(x).messages)
    assert any("asks for 20" in m for m in iso230_7(x[:19]).messages)
    assert iso230_7(x[:2]).n_revolutions == 2
    with pytest.raises(TooFewSamplesError, match="need 2"):
        iso230_7(x[:1])
    assert any("grows with their number" in m for m in iso230_7(x).messages)


def test_strong_noise_in_the_synchronous_value_is_told():
    s, _ = curve(1, 1024)
    x = s + np.random.default_rng(0).normal(0, 10 * NM, (20, 1024))
    assert any("noise adds about" in m for m in iso230_7(x).messages)


def test_harmonics_beyond_kmax_that_repeat_are_named():
    x = np.tile(9 * NM * np.cos(2 * grid(90)) + 2 * NM * np.cos(12 * grid(90)), (20, 1))
    x = x + np.random.default_rng(0).normal(0, 0.1 * NM, x.shape)
    result = iso230_7(x, kmax=10)
    assert any("k=12" in m for m in result.messages)
    assert abs(result.synchronous.value - 18 * NM) < 0.2 * NM


def test_false_ellipse_of_an_eccentric_ball_is_told():
    """A ball of 5 mm, 10 um off: e^2 / 4R = 5 nm of k = 2, exact geometry."""
    t, e, radius = grid(720), 10e-6, 5e-3
    reading = e * np.cos(t) + np.sqrt(radius**2 - (e * np.sin(t)) ** 2) - radius
    x = np.tile(reading + 20 * NM * np.cos(5 * t), (20, 1))

    result = iso230_7(x, artefact_radius=radius)

    assert any("false k=2 of 5 nm" in m for m in result.messages)
    assert abs(result.harmonics.amplitude[1] - 5 * NM) < 1e-3 * NM


def test_micrometres_are_doubted():
    x = np.tile(0.3 * np.cos(2 * grid(90)), (20, 1))
    assert any("must be in metres" in m for m in iso230_7(x).messages)


@pytest.mark.parametrize(
    ("signals", "angle", "options", "error", "match"),
    [
        (np.zeros(100), None, {}, DataError, "needs angle="),
        (np.zeros((2, 100)), np.arange(100) * 0.5, {}, NotUniformError, "one turn"),
        (np.zeros((2, 100)), np.arange(99) * 0.5, {}, InvalidSamplesError, "do not fit"),
        (np.zeros((3, 20, 90)), None, {"sensitive": "rotating"}, InvalidSamplesError, "x, y"),
        (np.zeros((20, 90)), None, {"sensitive": "rotating"}, InvalidSamplesError, "do not fit"),
        (np.zeros((20, 90)), "angle", {}, DataError, "names a channel"),
        (np.zeros((20, 90)), np.rad2deg(grid(90)), {}, NotUniformError, "give rad"),
        (np.zeros((20, 90)), np.linspace(0, TURN, 90), {}, NotUniformError, "end twice"),
        (np.zeros((20, 90)), None, {"direction": "yaw"}, DataError, "radial, axial"),
        (np.zeros((20, 90)), None, {"sensitive": "both"}, DataError, "fixed"),
        (np.zeros((20, 90)), None, {"direction": "axial", "sensitive": "rotating"}, DataError, "along"),
        (np.zeros((20, 90)), None, {"center": "LS"}, DataError, "center"),
        (np.zeros((20, 90)), None, {"distance": 0.1}, DataError, "belongs to tilt"),
        (np.zeros((2, 20, 90)), None, {"direction": "tilt"}, DataError, "needs distance"),
        (np.zeros((2, 20, 90)), None, {"direction": "tilt", "distance": 0.0}, DataError, "positive"),
        (np.zeros((20, 90)), None, {"kmax": 1}, DataError, "kmax"),
        (np.zeros((20, 90)), None, {"kmax": 46}, DataError, "at most 45"),
        (np.zeros((20, 90)), None, {"kmax": float("nan")}, DataError, "kmax"),
        (np.zeros((20, 90)), None, {"seed": -1}, DataError, "seed"),
        (np.zeros((20, 90)), None, {"n": 33}, DataError, "resamples"),
        (np.zeros((20, 90)) + 1j, None, {}, InvalidSamplesError, "complex"),
        (np.zeros((20, 90)), None, {"drift": "cubic"}, DataError, "drift"),
        (np.zeros((20, 90)), None, {"channels": "a"}, DataError, "channels"),
        (np.zeros((20, 4)), None, {}, TooFewSamplesError, "need 8"),
        (np.full((20, 90), np.nan), None, {}, TooFewSamplesError, "need 2"),
        ({"a": np.zeros(9), "b": np.zeros(9)}, None, {}, DataError, "name the signals"),
        ({"x": np.zeros(9), "y": np.zeros(8)}, None, {"sensitive": "rotating"}, InvalidSamplesError, "one shape"),
        (np.full((20, 90), np.inf), None, {}, InvalidSamplesError, "infinite"),
    ],
)  # fmt: skip
def test_refusals(signals, angle, options, error, match):
    with pytest.raises(error, match=match):
        iso230_7(signals, angle, **options)


def test_recordings_are_checked():
    t = np.arange(400) * 1e-3
    x, angle = np.zeros(400), np.arange(400) * 0.1
    with pytest.raises(UnitError, match="not in m"):
        iso230_7(ms.Recording(t, {"gap": x}, units={"gap": "V"}), angle)
    with pytest.raises(UnitError, match="not in rad"):
        iso230_7(ms.Recording(t, {"gap": x, "a": angle}, units={"a": "deg"}), "a")
    with pytest.raises(NotUniformError, match="uniformly in time"):
        iso230_7(ms.Recording(t**2 + t, {"gap": x}), angle)
    with pytest.raises(DataError, match="no channel 'b'"):
        iso230_7(ms.Recording(t, {"gap": x}), "b")


def test_no_motion_at_all():
    result = iso230_7(np.zeros((20, 90), dtype=int), center="MIC")
    assert result.synchronous.value == 0.0
    assert result.asynchronous.u == 0.0


def test_centre_that_changes_nothing_is_told():
    result = iso230_7(np.zeros((20, 90)), direction="axial", center="MZC")
    assert any("changes nothing" in m for m in result.messages)


def test_result_as_plain_values():
    result = iso230_7(np.random.default_rng(0).normal(size=(20, 64)) * NM)
    document = result.to_dict()

    assert document["parameters"]["synchronous"]["unit"] == "m"
    assert document["audit"]["n_revolutions"] == 20
    assert list(result.harmonics.to_frame().columns)[:2] == ["amplitude", "phase_rad"]
    assert "20 revolutions" in repr(result)
    with pytest.raises(ValueError, match="read-only"):
        result.motion[0, 0] = 1.0


@pytest.mark.slow
def test_revolutions_are_not_analysed_one_sample_at_a_time(calls):
    def effort(n):
        x = np.random.default_rng(0).normal(size=(20, n)) * NM
        return calls(lambda: iso230_7(x))[0]

    assert effort(4096) < 1.1 * effort(1024)


# -- hostile review ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "m", "offset"),
    [
        pytest.param(360, 20, 0.0, marks=pytest.mark.slow),
        (36, 20, 0.0),
        pytest.param(257, 31, 0.0, marks=pytest.mark.slow),
        pytest.param(90, 20, 1.0, marks=pytest.mark.slow),
    ],
)
def test_total_scatters_as_stated(n, m, offset):
    """sd of 200 repeated tests over the mean stated u; the sd itself is known to 5 %."""
    rng = np.random.default_rng(7)
    motion = 20 * NM * np.cos(2 * grid(n))
    value, u = np.empty(200), np.empty(200)
    for i in range(200):
        noise = rng.normal(0, 2.5 * NM, (m, n)) + offset * rng.normal(0, 2.5 * NM, (m, 1))
        total = iso230_7(motion + noise, seed=i).total
        value[i], u[i] = total.value, total.u
    assert abs(np.std(value, ddof=1) / np.mean(u) - 1) < 0.12


@pytest.mark.slow
def test_total_of_white_noise_is_that_of_order_statistics():
    """Range of 20 x 36 independent values: sd by its closed form, from the two extremes."""
    from metrosep.separation.circles.spindle_result import spectrum_of, u_of_total

    rng = np.random.default_rng(5)
    flat = rng.normal(size=(4000, 720))
    sd = np.std(np.ptp(flat, axis=1))
    rows = [flat[i].reshape(20, 36) for i in range(100)]
    found = np.mean([u_of_total(r - r.mean(), spectrum_of(r, 0.0)) for r in rows])
    assert abs(found / sd - 1) < 0.06  # sd of 4000: 1 %; curve and power from the data


@pytest.mark.parametrize("level", [0.0, 1e-4])
def test_rounding_is_no_finding(level):
    t = grid(360)
    clean = level + 5e-6 * np.cos(t) + 20 * NM * np.cos(2 * t) + 3 * NM * np.sin(11 * t)
    record = np.tile(clean, (20, 1)) * (1 + 1e-16 * np.arange(20)[:, None])
    said = " ".join(iso230_7(record).messages)
    assert "deviate alike" not in said
    assert "drift by" not in said

    slow = clean + 1 * NM * np.arange(20)[:, None]
    said = " ".join(iso230_7(slow).messages)
    assert "deviate alike" in said
    assert "drift by" in said


def test_direction_may_be_positional():
    x = np.tile(20 * NM * np.cos(2 * grid(90)), (20, 1))
    assert iso230_7(x, grid(90), "axial").direction == "axial"


@pytest.mark.parametrize(
    ("signals", "match"),
    [
        ([[1, 2], [3]], "equal length"),
        ([["a", "b"], ["c", "d"]], "real numbers"),
        ({"radial": np.ones((2, 9)) * 1j}, "complex"),
        ({"radial": [[1, 2], [3]]}, "'radial' must be real numbers"),
    ],
)
def test_what_is_no_table_of_numbers_is_refused(signals, match):
    with pytest.raises(InvalidSamplesError, match=match):
        iso230_7(signals)


def test_complex_angle_is_refused():
    with pytest.raises(InvalidSamplesError, match="angle must be real"):
        iso230_7(np.zeros((20, 9)), grid(9) + 0j)


@pytest.mark.parametrize(
    "again",
    [copy.copy, copy.deepcopy, lambda r: pickle.loads(pickle.dumps(r))],  # noqa: S301
)
def test_result_is_copied_whole(again):
    t = np.arange(4000) * 1e-3
    recording = ms.Recording(
        t, {"gap": 1e-8 * np.sin(20 * t), "angle": 10 * t}, units={"angle": "rad"}
    )
    for result in (iso230_7(recording, "angle"), resample_by_encoder(np.sin(20 * t), 10 * t)):
        other = again(result)
        assert repr(other) == repr(result)
        assert other.audit == result.audit
        assert type(other.audit) is type(result.audit)
        array = other.table if hasattr(result, "start") else other.motion
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0
    whole = iso230_7(recording, "angle")
    assert again(whole).to_dict() == whole.to_dict()


def test_plain_values_survive_strict_json():
    t = np.arange(4000) * 1e-3
    for result in (
        iso230_7(resample_by_encoder(np.sin(20 * t), 10 * t, method="cubic", n=33)),
        iso230_7(resample_by_encoder(np.sin(20 * t), 10 * t)).harmonics,
        resample_by_encoder(np.sin(20 * t), 10 * t, method="cubic", n=33),
    ):
        json.dumps(result.to_dict(), allow_nan=False)
    assert "<table" in iso230_7(np.zeros((20, 90)))._repr_html_()
