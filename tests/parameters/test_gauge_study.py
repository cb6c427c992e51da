"""Gauge study: the published example, closed forms, coverage of the intervals, null space."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters import gauge_study

# AIAG, Measurement Systems Analysis: ten parts, three appraisers, three trials
AIAG = np.array(
    [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ]
).transpose(2, 0, 1)

PRINTED = 5e-7
"""Half a unit of the last of six printed digits."""
BOOK = 3e-6
"""The book's GRR and parts carry the rounding of its intermediate results: 0.302373, not 0.302371."""
SQUARES = 6e-5
"""Of sums of squares that are printed with four to five decimals."""
EXACT = 1e-12
"""Rounding of a few sums of numbers of order one."""


def test_published_example():
    study = gauge_study(AIAG)
    rows = {row.source: row for row in study.rows}
    assert abs(rows["conditions"].squares - 3.1673) <= SQUARES
    assert abs(rows["parts"].squares - 88.3619) <= SQUARES
    assert abs(rows["interaction"].squares - 0.3590) <= SQUARES
    assert abs(rows["total"].squares - 94.6471) <= SQUARES
    assert study.pooled
    assert abs(study.repeatability.value - 0.199933) <= PRINTED
    assert abs(study.reproducibility.value - 0.226838) <= PRINTED
    assert abs(study.gauge.value - 0.302373) <= BOOK
    assert abs(study.parts.value - 1.042327) <= BOOK
    assert study.distinct_categories == 4
    shares = study.shares()
    assert abs(100 * shares["gauge"] - 27.86) <= 0.005
    assert abs(100 * shares["parts"] - 96.04) <= 0.005


def test_closed_form_of_the_smallest_study():
    # two parts, two conditions, two trials: sums by hand
    a = np.array([[[1.0, 2.0], [4.0, 5.0]], [[10.0, 12.0], [11.0, 17.0]]])
    rows = {row.source: row for row in gauge_study(a, pool=1.0).rows}
    assert abs(rows["parts"].squares - (50.0 - 12.0) ** 2 / 8) <= EXACT * 100
    assert abs(rows["conditions"].squares - (37.0 - 25.0) ** 2 / 8) <= EXACT * 100
    assert abs(rows["repeatability"].squares - (0.5 + 0.5 + 2.0 + 18.0)) <= EXACT * 100
    cells = np.array([[1.5, 4.5], [11.0, 14.0]])
    inter = cells - cells.mean(1)[:, None] - cells.mean(0)[None] + cells.mean()
    assert abs(rows["interaction"].squares - 2 * (inter**2).sum()) <= EXACT * 100


def simulated(rng, p, k, r, sd_part, sd_condition, sd_interaction, sd_repeat):
    return (
        sd_part * rng.standard_normal((p, 1, 1))
        + sd_condition * rng.standard_normal((1, k, 1))
        + sd_interaction * rng.standard_normal((p, k, 1))
        + sd_repeat * rng.standard_normal((p, k, r))
    )


def test_variances_are_unbiased():
    rng = np.random.default_rng(11)
    planted = (3.0, 2.0, 1.5, 1.0)
    found = []
    for _ in range(800):
        study = gauge_study(simulated(rng, 8, 6, 3, *planted), pool=1.0)
        parts = ("parts", "interaction", "repeatability", "gauge")
        found.append([getattr(study, name).value ** 2 for name in parts])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0) / math.sqrt(len(found))
    truth = np.array([9.0, 2.25, 1.0, 4.0 + 2.25 + 1.0])
    assert (np.abs(mean - truth) <= 4.0 * error).all()


@pytest.mark.slow
def test_intervals_cover_as_often_as_they_say():
    rng = np.random.default_rng(12)
    inside = {"repeatability": 0, "gauge": 0}
    truth = {"repeatability": 1.0, "gauge": math.sqrt(1.0 + 0.49 + 0.64)}
    n = 2000
    for _ in range(n):
        study = gauge_study(simulated(rng, 10, 5, 3, 3.0, 0.7, 0.8, 1.0), pool=1.0)
        for name, (low, high) in study.interval.items():
            inside[name] += low <= truth[name] <= high
    assert (
        abs(inside["repeatability"] / n - 0.95) <= 0.02
    )  # four standard deviations of 2000 draws
    assert 0.93 <= inside["gauge"] / n <= 0.985  # the method errs on the wide side


def test_null_space_offset_and_scale():
    study, moved = gauge_study(AIAG), gauge_study(5.0 - 3.0 * AIAG)
    for name in ("repeatability", "reproducibility", "parts", "total"):
        a, b = getattr(study, name), getattr(moved, name)
        assert abs(b.value - 3.0 * a.value) <= EXACT * 10
        assert abs((b.u or 0.0) - 3.0 * (a.u or 0.0)) <= EXACT * 100
    assert moved.distinct_categories == study.distinct_categories


def test_order_of_parts_conditions_and_trials_does_not_matter():
    rng = np.random.default_rng(3)
    mixed = AIAG[rng.permutation(10)][:, rng.permutation(3)][:, :, rng.permutation(3)]
    assert abs(gauge_study(mixed).gauge.value - gauge_study(AIAG).gauge.value) <= EXACT


def test_parts_and_conditions_are_not_exchanged():
    # the spread lies between conditions only: the gauge has it, the parts have none
    a = np.zeros((6, 3, 2)) + np.array([0.0, 1.0, 5.0])[None, :, None]
    a += 1e-3 * np.random.default_rng(0).standard_normal(a.shape)
    study = gauge_study(a)
    assert study.reproducibility.value > 2.0
    assert study.parts.value < 1e-2


def test_one_condition_has_no_reproducibility():
    study = gauge_study(AIAG[:, :1])
    assert math.isnan(study.reproducibility.value)
    assert study.gauge.value == study.repeatability.value
    assert any("one condition" in m for m in study.messages)


def test_constant_readings():
    study = gauge_study(np.full((4, 2, 2), 7.0))
    assert study.total.value == 0.0
    assert study.distinct_categories == 0
    assert math.isnan(study.shares()["gauge"])


def test_share_of_the_tolerance():
    study = gauge_study(AIAG, tolerance=8.0)
    assert abs(study.share_of_tolerance - 6.0 * 0.302373 / 8.0) <= BOOK
    assert math.isnan(gauge_study(AIAG).share_of_tolerance)


@pytest.mark.parametrize(
    ("readings", "error", "words"),
    [
        (np.where(AIAG > 2.2, np.nan, AIAG), InvalidSamplesError, "part 9, condition 1, trial 1"),
        (AIAG[:1], TooFewSamplesError, "1 parts"),
        (AIAG[:, :, :1], TooFewSamplesError, "1 trials"),
        (AIAG[0], InvalidSamplesError, "shape"),
        ([[[1.0, 2.0]], [[1.0]]], InvalidSamplesError, "same number"),
    ],
)
def test_bad_readings(readings, error, words):
    with pytest.raises(error, match=words):
        gauge_study(readings)


@pytest.mark.parametrize("option", [{"tolerance": 0.0}, {"pool": 2.0}, {"coverage": 1.0}])
def test_bad_options(option):
    with pytest.raises(DataError):
        gauge_study(AIAG, **option)
