"""Coefficients of temperature and speed: closed forms, coverage, refusals."""

import copy
import json
import math
import pickle

import numpy as np
import pytest

from metrosep.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.separation.drift.dependence import drift_against_temperature, speed_dependence

NM = 1e-9


def test_line_has_the_textbook_coefficients_and_intervals():
    """Five points worked by hand: slope 0.8, s^2 = 2.4 / 3, u = sqrt(0.8 / 10), t(3) = 3.1824."""
    t = np.array([1.0, 2, 3, 4, 5])
    y = np.array([1.0, 3, 2, 5, 4])  # slope 8 / 10; residuals -0.4 0.8 -1 1.2 -0.6

    fit = drift_against_temperature(t, y)

    s2 = (0.16 + 0.64 + 1.0 + 1.44 + 0.36) / 3
    u = math.sqrt(s2 / 10)
    assert fit.coefficients["c1"].value == pytest.approx(0.8, abs=1e-12)
    assert fit.coefficients["c0"].value == pytest.approx(0.6, abs=1e-12)
    assert fit.coefficients["c1"].u == pytest.approx(u, abs=1e-12)
    assert fit.coefficients["c0"].u == pytest.approx(math.sqrt(s2 * (1 / 5 + 9 / 10)), abs=1e-12)
    assert fit.intervals["c1"] == pytest.approx(
        (0.8 - 3.1824463 * u, 0.8 + 3.1824463 * u), abs=1e-6
    )
    assert fit.coefficients["c1"].unit == "m/(K)"


def test_speed_interval_covers():
    """Goal S23: amplitude 20 nm + c2 v^2 with 1 nm noise; 95 % interval of c2 and of the curve."""
    rng = np.random.default_rng(0)
    v = np.linspace(5, 60, 9)
    c2 = 4e-12
    inside = curve = 0
    for _ in range(1000):
        fit = speed_dependence(v, 20 * NM + c2 * v**2 + NM * rng.normal(size=9))
        low, high = fit.intervals["c2"]
        inside += low <= c2 <= high
        curve += abs(fit.evaluate([30.0])[0] - 20 * NM - c2 * 900) <= fit.half_width([30.0])[0]

    assert 0.93 <= inside / 1000 <= 0.97
    assert 0.93 <= curve / 1000 <= 0.97


def test_given_uncertainties_weigh_and_stand():
    v = np.array([0.0, 10.0, 20.0, 30.0])
    u = np.array([1.0, 1.0, 1.0, 1e6]) * NM
    y = 5 * NM + 1e-11 * v**2
    y[3] += 1e-6

    fit = speed_dependence(v, y, u=u)

    assert fit.coefficients["c2"].value == pytest.approx(1e-11, abs=1e-15)
    basis = np.column_stack([np.ones(4), v**2]) / u[:, None]
    wanted = np.sqrt(np.diag(np.linalg.inv(basis.T @ basis)))
    assert fit.coefficients["c2"].u == pytest.approx(wanted[1], abs=1e-6 * wanted[1])
    assert math.isinf(fit.freedom)


def test_correlated_residuals_widen_the_interval():
    """Drift noise with correlation 0.8 of neighbours: coverage of c1 without it 50 %."""
    rng = np.random.default_rng(1)
    time = np.arange(400.0)
    inside = 0
    for _ in range(300):
        temperature = 20 + np.sin(2 * np.pi * time / 400)
        noise = np.zeros(400)
        shocks = rng.normal(size=400)
        for i in range(1, 400):
            noise[i] = 0.8 * noise[i - 1] + shocks[i]
        fit = drift_against_temperature(temperature, 2e-6 * temperature + 1e-7 * noise)
        low, high = fit.intervals["c1"]
        inside += low <= 2e-6 <= high

    assert 0.90 <= inside / 300 <= 0.99
    assert any("neighbouring residuals" in m for m in fit.messages)


def test_white_residuals_keep_their_interval():
    rng = np.random.default_rng(2)
    t = rng.uniform(19, 21, size=100)
    inside = sum(
        low <= 1.0 <= high
        for low, high in (
            drift_against_temperature(t, t + rng.normal(size=100)).intervals["c1"]
            for _ in range(400)
        )
    )

    assert 0.92 <= inside / 400 <= 0.98


def test_gaps_and_no_extrapolation():
    v = np.array([10.0, 20.0, 30.0, 40.0, 50.0])
    y = np.array([1.0, 2.0, np.nan, 4.0, 5.0])

    fit = speed_dependence(v, y, powers=(0, 1))

    assert np.isnan(fit.residual[2])
    assert np.isnan(fit.evaluate([5.0, 60.0])).all()
    assert fit.evaluate([30.0])[0] == pytest.approx(3.0, abs=1e-12)
    assert np.isnan(fit.half_width([60.0]))[0]
    assert any("1 of 5" in m for m in fit.messages)
    assert "c1" in repr(fit)


@pytest.mark.parametrize(
    ("arguments", "options", "error", "match"),
    [
        (([1, 2], [1, 2]), {}, TooFewSamplesError, "need 3"),
        (([1, 1, 1], [1, 2, 3]), {}, DegenerateFitError, "spread them"),
        (([1, 2, -3], [1, 2, 3]), {}, InvalidSamplesError, "magnitude"),
        (([1, 2, np.nan], [1, 2, 3]), {}, InvalidSamplesError, "NaN"),
        (([1, 2, 3], [1, 2]), {}, InvalidSamplesError, "equally long"),
        (([1, 2, 3], [1, 2, 3]), {"u": 0.0}, InvalidSamplesError, "positive"),
        (([1, 2, 3], [1, 2, 3]), {"u": [1.0, 2.0]}, InvalidSamplesError, "u has 2"),
        (([1, 2, 3], [1, 2, 3]), {"powers": (1, 1)}, DataError, "different"),
        (([1, 2, 3], [1, 2, 3]), {"powers": ()}, DataError, "different"),
        (([1, 2, 3], [1, 2, 3]), {"confidence": 95}, DataError, "confidence"),
        (([1, 2, 3], [1, 2, 3]), {"confidence": "high"}, DataError, "confidence must be"),
        (([1, 2, 3], [1, 2, 3]), {"powers": 2}, DataError, r"powers must be .* such as \(0, 2\)"),
        (([1, 2, 3], [1, 2, 3]), {"powers": "02"}, DataError, "powers must be"),
        (([1, 2, 3], [1, 2, 3]), {"powers": (0, 1.5)}, DataError, "powers must be"),
        (([1, 2, 3], [1, 2, 3]), {"u": "1 nm"}, InvalidSamplesError, "u must be"),
        (([1, 2, 3], ["a", "b", "c"]), {}, InvalidSamplesError, "real numbers"),
    ],
)
def test_bad_input_is_refused(arguments, options, error, match):
    with pytest.raises(error, match=match):
        speed_dependence(*arguments, **options)


def test_masked_readings_are_not_measured():
    y = np.ma.masked_greater(np.array([1.0, 2.0, 900.0, 4.0, 5.0]), 100.0)
    v = np.array([1.0, 2.0, 3.0, 4.0, 5.0])

    fit = speed_dependence(v, y, powers=(0, 1))

    assert fit.coefficients["c1"].value == pytest.approx(1.0, abs=1e-12)
    assert np.isnan(fit.residual[2])


def through_pickle(result):
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - bytes of its own


@pytest.mark.parametrize("how", [copy.deepcopy, through_pickle])
def test_result_survives_copies_and_gives_json(how):
    fit = speed_dependence([1, 2, 3, 4], [1.0, np.nan, 2.0, 4.0], powers=(0, 1), u=0.1)

    again = how(fit)
    text = json.dumps(fit.to_dict(), allow_nan=False)

    assert json.dumps(again.to_dict(), allow_nan=False) == text
    assert again.evaluate([1.5]) == pytest.approx(fit.evaluate([1.5]), abs=0.0)
    assert fit.to_dict()["values"][1] is None
    assert fit.to_dict()["freedom"] is None  # infinite: u was given
