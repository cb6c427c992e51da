"""The data sets of the corpus, scored against the truth beside them."""

import numpy as np
import pandas as pd
import pytest

from metrosep import read_runs
from metrosep.separation import separate

JOINT = {
    "kono45_seed101_modal": 7.5,
    "kono45_seed102_floor": 13.0,
    "kono70_seed103_short_lag1ms": 9.0,
}
KONO = {
    "kono45_seed101_modal": 17.4,
    "kono45_seed102_floor": 27.1,
    "kono70_seed103_short_lag1ms": 64.0,
}
KONO_TOLERANCE = 2.0


def load(corpus, name):
    folder = corpus / "separation"
    runs = read_runs(
        folder / f"{name}_runs.csv",
        x=("x_mm", "mm"),
        z=("z_um", "um"),
        feed=("feed_mm_min", "mm/min"),
        run="run",
        sampling_rate=1000.0,
    )
    truth = pd.read_csv(folder / f"{name}_truth.csv")
    return runs, truth["x_mm"].to_numpy() * 1e-3, truth["e_true_um"].to_numpy() * 1e-6


def score_nm(estimate, x, truth):
    difference = estimate.evaluate(x) - truth
    difference -= np.polyval(np.polyfit(x, difference, 1), x)
    return np.sqrt(np.mean(difference**2)) * 1e9


@pytest.mark.parametrize("name", JOINT)
def test_joint(corpus, name):
    runs, x, truth = load(corpus, name)

    estimate = separate(runs, start=0.0, length=float(x[-1]), lag="fit" if "lag" in name else 0.0)

    assert score_nm(estimate, x, truth) <= JOINT[name]


@pytest.mark.parametrize("name", KONO)
def test_kono_with_the_mean_of_three(corpus, name):
    runs, x, truth = load(corpus, name)

    estimate = separate(runs, method="kono", start=0.0, length=float(x[-1]), shortest=4e-3)

    assert score_nm(estimate, x, truth) == pytest.approx(KONO[name], abs=KONO_TOLERANCE)


def test_flipped_estimate_is_far_worse_than_none(corpus):
    runs, x, truth = load(corpus, "kono45_seed101_modal")
    estimate = separate(runs, start=0.0, length=45e-3)
    line = np.polyval(np.polyfit(x, truth, 1), x)
    before = np.sqrt(np.mean((truth - line) ** 2)) * 1e9

    after = score_nm(estimate, x, truth)
    flipped = np.sqrt(np.mean((-estimate.evaluate(x) - (truth - line)) ** 2)) * 1e9

    assert after < 0.03 * before
    assert flipped > 1.9 * before
