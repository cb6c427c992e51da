"""Zero difference of three probes: each calibration recovers a planted one, with its scatter."""

import math

import numpy as np
import pytest

from metrosep.core.errors import MetrosepError
from metrosep.separation import ZeroCalibration, zero_calibration
from metrosep.separation.lines.three_points import three_point

STEP = 10e-3
ZERO = 7e-9
N = 25

MC_RTOL = 0.1
"""Standard deviation of 400 trials scatters by 3.5 %."""


def read(form, sign=1.0, rng=None, ratio=1.0):
    """A carriage with its own errors each time; the zero sits in the leading probe."""
    rng = np.random.default_rng(0) if rng is None else rng
    slide, pitch = 1e-6 * rng.standard_normal(N), 1e-5 * rng.standard_normal(N)
    m = np.stack([sign * form[k : k + N] + slide + k * STEP * pitch for k in range(3)])
    m[2] += ZERO / ratio
    return m


@pytest.fixture
def form(rng):
    return 1e-7 * rng.standard_normal(N + 2)


def test_reversal_is_exact_and_its_sign_is_that_of_three_point(form, rng):
    forward = read(form, rng=rng)
    found = zero_calibration(forward, STEP, reversed_m=read(form, -1.0, rng=rng), u_reading=1e-9)

    assert found.zero == pytest.approx(ZERO, rel=1e-6, abs=0.0)
    assert found.u == pytest.approx(1e-9 * math.sqrt(6 / (2 * N)), rel=1e-12, abs=0.0)
    result = three_point(forward, STEP, step=STEP, zero_cal=found)
    t = np.arange(N + 2)
    expected = form - np.polyval(np.polyfit(t, form, 1), t)
    np.testing.assert_allclose(result.artefact, expected, rtol=0, atol=1e-16)
    assert float(result.u["zero"]) == found.u


def test_a_reversal_without_turning_the_edge_would_be_wrong(form):
    """Asymmetry: the same readings twice leave the curvature of the edge in the zero."""
    bent = form + 1e-7 * np.arange(N + 2.0) ** 2
    found = zero_calibration(read(bent), STEP, reversed_m=read(bent))
    assert abs(found.zero - ZERO) > 1e-7


@pytest.mark.parametrize("flat", [0.0, "profile", "three"])
def test_known_flat(form, flat, rng):
    known = {
        "profile": np.stack([form[k : k + N] for k in range(3)]),
        "three": np.array([1e-9, -5e-9, 2e-9]),
    }.get(flat, 0.0)
    m = read(np.zeros(N + 2) if flat != "profile" else form, rng=rng)
    if flat == "three":
        m = m + known[:, None]

    found = zero_calibration(m, STEP, flat=known, u_flat=2e-9)

    assert found.zero == pytest.approx(ZERO, rel=1e-6, abs=0.0)
    assert found.u == pytest.approx(2e-9, rel=1e-3, abs=0.0)
    assert found.source == "flat"


def test_uncertainty_is_the_scatter():
    rng = np.random.default_rng(3)
    found = [
        zero_calibration(1e-9 * rng.standard_normal((3, N)), STEP, flat=0.0) for _ in range(400)
    ]
    scatter = np.std([f.zero for f in found], ddof=1)
    assert scatter == pytest.approx(1e-9 * math.sqrt(6 / N), rel=MC_RTOL, abs=0.0)
    stated = math.sqrt(np.mean([f.u**2 for f in found]))
    assert stated == pytest.approx(scatter, rel=MC_RTOL, abs=0.0)


def test_perfect_flat_is_said():
    found = zero_calibration(read(np.zeros(N + 2)), STEP, flat=0.0)
    assert any("perfect" in text for text in found.messages)


def test_angle_sensor(form, rng):
    slide, pitch = 1e-6 * rng.standard_normal(N), 5e-6 * np.sin(np.arange(N) / 2.0)
    m = np.stack([form[k : k + N] + slide + k * STEP * pitch for k in range(3)])
    m[2] += ZERO

    found = zero_calibration(m, STEP, pitch=pitch + 1e-5, u_pitch=1e-7, step=STEP, u_reading=1e-9)

    assert found.zero == pytest.approx(ZERO, rel=1e-5, abs=0.0)
    assert 0.0 < found.u < 1e-9


def test_weights_follow_the_distances(form, rng):
    """Distances 10 and 20 mm: delta = e1 - 1.5 e2 + 0.5 e3."""
    m = np.zeros((3, N))
    m[2] += 4e-9
    assert zero_calibration(m, (STEP, 2 * STEP), flat=0.0).zero == pytest.approx(
        2e-9, rel=1e-12, abs=0.0
    )


def test_positions_not_measured_are_left_out(form):
    m = read(form)
    reversed_m = read(form, -1.0)
    m[1, 3] = np.nan
    reversed_m[0, 7] = np.nan
    found = zero_calibration(m, STEP, reversed_m=reversed_m, u_reading=1e-9)
    assert found.zero == pytest.approx(ZERO, rel=1e-6, abs=0.0)
    assert found.audit["n_positions"] == N - 2


def test_quantity_carries_unit_and_uncertainty():
    found = ZeroCalibration(1e-9, 2e-10, (STEP, STEP), "flat")
    assert (found.quantity.value, found.quantity.u, found.quantity.unit) == (1e-9, 2e-10, "m")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, "exactly one"),
        ({"flat": 0.0, "reversed_m": np.zeros((3, 5))}, "exactly one"),
        ({"reversed_m": np.zeros((3, 4))}, "same positions"),
        ({"flat": np.zeros(4)}, "flat"),
        ({"flat": "plane"}, "flat"),
        ({"flat": 0.0, "u_flat": -1.0}, "u_flat"),
        ({"flat": 0.0, "u_reading": np.nan}, "u_reading"),
        ({"flat": 0.0, "distance": 0.0}, "distance must be positive"),
        ({"flat": 0.0, "distance": "far"}, "distance"),
        ({"flat": 0.0, "m": np.zeros((3, 1))}, "scatter"),
        ({"flat": 0.0, "m": np.zeros((2, 5))}, "3 readings"),
        (
            {
                "pitch": np.zeros(5),
                "u_pitch": 1e-6,
                "u_reading": 1e-9,
                "distance": (STEP, 2 * STEP),
            },
            "step",
        ),
    ],
)
def test_bad_input_is_refused_in_words(change, words):
    given = {"m": np.zeros((3, 5)), "distance": STEP, **change}
    m, distance = given.pop("m"), given.pop("distance")
    with pytest.raises(MetrosepError, match=words):
        zero_calibration(m, distance, **given)


def test_nothing_measured_together_is_refused():
    m = np.zeros((3, 4))
    m[0, :2] = np.nan
    m[1, 2:] = np.nan
    with pytest.raises(MetrosepError, match="all probes"):
        zero_calibration(m, STEP, flat=0.0, u_reading=1e-9)


def test_a_height_is_no_flatness():
    """One number has no second difference: it would be without effect, whatever was meant."""
    with pytest.raises(MetrosepError, match="u_flat"):
        zero_calibration(np.zeros((3, 9)), STEP, flat=5e-6, u_reading=1e-9)


@pytest.mark.parametrize("kind", ["flat", "reversal"])
def test_passes_are_counted(kind):
    """Type A and stated: u is the scatter where the passes are of different length."""
    rng = np.random.default_rng(11)
    values, stated, found = [], [], []
    for _ in range(400):
        m, turned = 1e-9 * rng.standard_normal((2, 3, 4, N))
        m[:, 1:, 8:] = np.nan
        other = {"flat": 0.0} if kind == "flat" else {"reversed_m": turned}
        result = zero_calibration(m, STEP, u_reading=1e-9, **other)
        values.append(result.zero)
        stated.append(result.u)
        found.append(zero_calibration(m, STEP, **other).u)
    scatter = np.std(values, ddof=1)
    assert stated[0] == pytest.approx(scatter, rel=MC_RTOL, abs=0.0)
    assert math.sqrt(np.mean(np.square(found))) == pytest.approx(scatter, rel=MC_RTOL, abs=0.0)


def test_masked_readings_are_not_measured(form):
    m = read(form)
    m[1, 3] = 1.0
    found = zero_calibration(
        np.ma.masked_greater(m, 0.5), STEP, reversed_m=read(form, -1.0), u_reading=1e-9
    )
    assert found.zero == pytest.approx(ZERO, rel=1e-6, abs=0.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"flat": 0.0, "u_flat": None}, "u_flat"),
        ({"flat": 0.0, "u_reading": "1"}, "u_reading"),
        ({"flat": [0.0, np.nan, 0.0]}, "flat"),
    ],
)
def test_wrong_types_are_refused_in_words(change, words):
    with pytest.raises(MetrosepError, match=words):
        zero_calibration(np.zeros((3, 5)), STEP, **change)
