"""Speed sweeps: known laws recovered, intervals that cover, resonances named (S23)."""

import copy
import json
import pickle

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.circles.speed_sweep import fit_speed_sweep
from metrosep.separation.circles.spindle import iso230_7

NM = 1e-9
SPEEDS = np.arange(10.0, 101.0, 10.0)
ROUNDING = 1e-20


def law(n):
    return 20 * NM + 3e-12 * n**2


def test_noise_free_law_is_exact_in_any_order_of_speeds():
    order = np.random.default_rng(0).permutation(SPEEDS.size)
    fit = fit_speed_sweep(SPEEDS[order], {"synchronous": law(SPEEDS[order])})["synchronous"]

    assert abs(fit.coefficients[0] - 20 * NM) < ROUNDING
    assert abs(fit.coefficients[1] - 3e-12) < ROUNDING
    assert np.abs(fit.evaluate(55.0) - law(55.0)) < ROUNDING
    assert fit.peaks == ()
    assert fit.coefficient(2).unit == "m s^2"


def test_straight_line_against_textbook_sums():
    rng = np.random.default_rng(3)
    y = 5 * NM + 1e-10 * SPEEDS + rng.normal(0, NM, SPEEDS.size)
    n, mean = SPEEDS.size, SPEEDS.mean()
    sxx = ((SPEEDS - mean) ** 2).sum()
    slope = ((SPEEDS - mean) * y).sum() / sxx
    rest = y - y.mean() - slope * (SPEEDS - mean)
    s = np.sqrt((rest**2).sum() / (n - 2))

    fit = fit_speed_sweep(SPEEDS, {"a": y}, powers=(0, 1))["a"]

    assert abs(fit.coefficients[1] - slope) < 1e-20
    assert abs(fit.coefficient(1).u - s / np.sqrt(sxx)) < 1e-20
    half = 2.306004 * s * np.sqrt(1 / n + (40 - mean) ** 2 / sxx)  # t of 8 degrees, 97.5 %
    assert abs(fit.half_width(40.0) - half) < 1e-15


@pytest.mark.parametrize("known", [True, False])
def test_interval_covers(known):
    """95 % at 3 speeds over 400 sweeps; 400 Bernoulli trials: sd 1.1 %."""
    rng = np.random.default_rng(5)
    u = np.linspace(1, 3, SPEEDS.size) * NM if known else np.full(SPEEDS.size, 2 * NM)
    at = np.array([12.0, 50.0, 95.0])
    hits = []
    for _ in range(400):
        y = law(SPEEDS) + rng.normal(0, u)
        fit = fit_speed_sweep(SPEEDS, {"s": y}, u={"s": u} if known else None)["s"]
        hits.append(np.abs(fit.evaluate(at) - law(at)) <= fit.half_width(at))
    share = np.mean(hits, axis=0)
    # known u is never narrowed by chance, so it covers a little more
    assert np.all((share > 0.915) & (share < (0.995 if known else 0.985)))


def test_weights_follow_the_uncertainty():
    y, u = law(SPEEDS), np.full(SPEEDS.size, NM)
    y[3] += 50 * NM
    u[3] = 1e4 * NM
    fit = fit_speed_sweep(SPEEDS, {"s": y}, u={"s": u})["s"]
    assert abs(fit.coefficients[0] - 20 * NM) < 1e-3 * NM


def test_resonance_is_named_with_its_order():
    """A spindle mode at 180 Hz, met by k = 3 at 60 rev/s."""
    rng = np.random.default_rng(6)
    y = law(SPEEDS) + 60 * NM / (1 + ((SPEEDS - 60) / 2) ** 2) + rng.normal(0, NM, SPEEDS.size)
    u = np.full(SPEEDS.size, NM)

    sweep = fit_speed_sweep(SPEEDS, {"s": y}, u={"s": u}, natural_frequency=180.0)

    assert sweep["s"].peaks == (60.0,)
    assert sweep["s"].p_fit < 1e-6
    assert sweep.critical[3] == 60.0
    said = " | ".join(sweep.messages)
    assert "stands out at 60 rev/s" in said
    assert "at 60 rev/s the natural frequency is met by k=3" in said
    assert "does not describe" in said


def test_no_peak_in_noise():
    rng = np.random.default_rng(7)
    found = sum(
        bool(fit_speed_sweep(SPEEDS, {"s": law(SPEEDS) + rng.normal(0, NM, 10)})["s"].peaks)
        for _ in range(200)
    )
    # t of 7 degrees beyond 4: 0.26 % of 10 speeds each
    assert found <= 14


def test_from_spindle_results():
    t = np.arange(360) * 2 * np.pi / 360
    rng = np.random.default_rng(8)
    results = [
        iso230_7(0.5 * law(n) * np.cos(2 * t) + rng.normal(0, 0.3 * NM, (30, 360)), kmax=8)
        for n in SPEEDS
    ]

    sweep = fit_speed_sweep(SPEEDS, results)

    fit = sweep["synchronous"]
    assert abs(fit.coefficients[1] / 3e-12 - 1) < 0.02
    assert abs(fit.coefficients[1] - 3e-12) < 4 * fit.coefficient(2).u
    assert np.all(fit.u > 0)
    sd = sweep["asynchronous_sd"]
    assert abs(sd.coefficients[1]) < 4 * sd.coefficient(2).u


def test_repeats_at_one_speed_are_taken():
    n = np.repeat([10.0, 50.0], 3)
    y = law(n) + np.array([1, -1, 0, 2, -2, 0]) * NM
    fit = fit_speed_sweep(n, {"s": y})["s"]
    assert fit.degrees == 4
    assert abs(fit.coefficients[1] - 3e-12) < ROUNDING


@pytest.mark.parametrize(
    ("speed", "results", "options", "error", "match"),
    [
        (SPEEDS[:2], {"s": law(SPEEDS[:2])}, {}, TooFewSamplesError, "at least 3"),
        ([10.0, 10.0, 10.0], {"s": [1.0, 2.0, 3.0]}, {}, DegenerateFitError, "different speeds"),
        (SPEEDS, {"s": law(SPEEDS)[1:]}, {}, InvalidSamplesError, "10 speeds"),
        (SPEEDS, {"s": np.r_[np.nan, law(SPEEDS)[1:]]}, {}, InvalidSamplesError, "NaN"),
        (SPEEDS, {"s": -law(SPEEDS)}, {}, InvalidSamplesError, "negative"),
        (-SPEEDS, {"s": law(SPEEDS)}, {}, InvalidSamplesError, "not negative"),
        (SPEEDS * 1e4, {"s": law(SPEEDS)}, {}, UnitError, "60"),
        (SPEEDS, {"s": law(SPEEDS)}, {"powers": ()}, DataError, "powers"),
        (SPEEDS, {"s": law(SPEEDS)}, {"powers": (0, 0)}, DataError, "twice"),
        (SPEEDS, {"s": law(SPEEDS)}, {"powers": (0.5,)}, DataError, "whole"),
        (SPEEDS, {"s": law(SPEEDS)}, {"u": {"t": SPEEDS}}, DataError, "no values"),
        (SPEEDS, {"s": law(SPEEDS)}, {"natural_frequency": 0.0}, DataError, "positive"),
        (SPEEDS, {"s": law(SPEEDS)}, {"orders": (0,)}, DataError, "from 1"),
        (SPEEDS, [], {}, InvalidSamplesError, "0 values"),
        ([], {"s": []}, {}, TooFewSamplesError, "at least 1"),
    ],
)
def test_refusals(speed, results, options, error, match):
    with pytest.raises(error, match=match):
        fit_speed_sweep(speed, results, **options)


def test_mixed_directions_and_stray_u_are_refused():
    x = np.random.default_rng(0).normal(size=(20, 64)) * NM
    mixed = [iso230_7(x), iso230_7(x), iso230_7(x, direction="axial")]
    with pytest.raises(DataError, match="different directions"):
        fit_speed_sweep([1.0, 2.0, 3.0], mixed)
    with pytest.raises(DataError, match="carry theirs"):
        fit_speed_sweep([1.0, 2.0, 3.0], mixed[:2] * 2, u={"synchronous": [1, 1, 1]})


def test_bad_confidence_and_power():
    fit = fit_speed_sweep(SPEEDS, {"s": law(SPEEDS)})["s"]
    with pytest.raises(DataError, match="confidence"):
        fit.half_width(3.0, confidence=95)
    with pytest.raises(DataError, match="not among"):
        fit.coefficient(1)


# -- hostile review ------------------------------------------------------------------------------

FIVE = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
VALUES = {"synchronous": 20e-9 + 1e-11 * FIVE**2}


@pytest.mark.parametrize(
    ("results", "options", "error", "match"),
    [
        (np.ones(5), {}, DataError, "SpindleMotion"),
        ([1.0] * 5, {}, DataError, "SpindleMotion"),
        ("synchronous", {}, DataError, "SpindleMotion"),
        (VALUES, {"u": [1e-9] * 5}, DataError, "mapping such as {'synchronous'"),
        (VALUES, {"powers": 2}, DataError, "sequence of whole numbers"),
        (VALUES, {"powers": (0, np.nan)}, DataError, "whole number"),
        (VALUES, {"powers": ()}, DataError, "empty"),
        (VALUES, {"orders": 3}, DataError, "sequence of whole numbers"),
        (VALUES, {"natural_frequency": "a"}, DataError, "natural frequency.*Hz"),
        ({"synchronous": np.ones(5) + 1j}, {}, InvalidSamplesError, "real"),
        ({"synchronous": [[1.0], [1.0, 2.0]]}, {}, InvalidSamplesError, "real numbers"),
    ],
)
def test_what_is_no_sweep_is_refused(results, options, error, match):
    with pytest.raises(error, match=match):
        fit_speed_sweep(FIVE, results, **options)


def test_speeds_in_revolutions_per_minute_are_told():
    with pytest.raises(UnitError, match="divide rev/min by 60"):
        fit_speed_sweep([1200.0, 1800.0, 2400.0, 3000.0, 3600.0], VALUES)


@pytest.mark.parametrize("u", [None, {"synchronous": np.full(5, 1e-9)}])
def test_result_is_short_plain_and_copied(u):
    sweep = fit_speed_sweep(FIVE, VALUES, u=u, natural_frequency=120.0)
    assert repr(sweep).startswith("SpeedSweep(5 recordings, 10 to 50 rev/s; synchronous: 20")
    assert len(repr(sweep)) < 200
    assert "20" in sweep._repr_html_()
    document = json.loads(json.dumps(sweep.to_dict(), allow_nan=False))
    assert document["fits"]["synchronous"]["powers"] == [0, 2]
    for again in (copy.copy(sweep), copy.deepcopy(sweep), pickle.loads(pickle.dumps(sweep))):  # noqa: S301
        assert again.to_dict() == sweep.to_dict()
        assert repr(again) == repr(sweep)
