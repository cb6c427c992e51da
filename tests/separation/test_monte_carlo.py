"""Twenty seeds for every column that is required, and two hundred sets of pure noise."""

import numpy as np
import pytest

from metrosep.separation import separate

# Two hundred sets take minutes, and more on a machine that does other work beside it.
pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

SEEDS = range(500, 520)

COLUMNS = [
    # case, waves, joint <= nm, joint <= factor x Kono with the mean of 9
    ("modal", "STANDARD", 9.0, 0.65),
    ("modal", "LONG_ONLY", 9.0, 1.05),
    ("sine", "STANDARD", 3.5, 0.45),
    ("sine", "LONG_ONLY", 3.5, 0.45),
    ("locked", "STANDARD", 3.5, 0.45),
    ("locked", "LONG_ONLY", 3.5, 0.45),
    ("floor", "STANDARD", 16.0, 0.65),
    ("floor", "LONG_ONLY", 16.0, 0.65),
    ("modal", "WITH_SHORT", 10.0, 0.65),
]


@pytest.mark.parametrize(("case", "waves", "limit", "factor"), COLUMNS)
def test_goals_s3_to_s7(contract_machine, as_runset, measured, case, waves, limit, factor):
    joint, kono, coverage = [], [], []
    for seed in SEEDS:
        machine = contract_machine.Machine(seed, case=case, waves=getattr(contract_machine, waves))
        runs = as_runset(machine)
        estimate = separate(runs, start=0.0, length=45e-3)
        rival = separate(runs, method="kono", start=0.0, length=45e-3, shortest=4e-3, values="all")
        joint.append(machine.rms_nm(estimate))
        kono.append(machine.rms_nm(rival))
        coverage.append(machine.coverage(estimate))
    measured(
        f"{case:7s} {waves:10s} joint {np.mean(joint):5.2f} nm (worst {np.max(joint):.1f}), "
        f"Kono mean of 9 {np.mean(kono):5.2f} nm, +-2 sd coverage {np.mean(coverage):.3f}"
    )

    assert np.mean(joint) <= limit
    assert np.mean(joint) <= factor * np.mean(kono)
    assert 0.90 <= np.mean(coverage) <= 0.99


@pytest.mark.parametrize("lag", [1e-3, 2e-3])
def test_goal_s8_lag(contract_machine, as_runset, measured, lag):
    scores, errors = [], []
    for seed in SEEDS:
        machine = contract_machine.Machine(seed, waves=contract_machine.WITH_SHORT, lag=lag)
        estimate = separate(as_runset(machine), start=0.0, length=45e-3, lag="fit")
        scores.append(machine.rms_nm(estimate))
        errors.append((estimate.lag - lag) / estimate.lag_sd)
        assert abs(estimate.lag - lag) < 0.4e-3
    measured(f"lag {lag * 1e3:.0f} ms: {np.mean(scores):.2f} nm, pull mean {np.mean(errors):+.2f}")

    assert np.mean(scores) <= 10.0
    assert np.sqrt(np.mean(np.square(errors))) < 1.6


def test_goal_s9_pure_noise(contract_machine, as_runset, measured):
    sets_with_false, n_false, n_all, scores = 0, 0, 0, []
    for seed in range(200):
        machine = contract_machine.Machine(seed, waves={}, length=30.0)
        estimate = separate(as_runset(machine), start=0.0, length=30e-3)
        selected = estimate.spectrum["selected"].to_numpy()
        sets_with_false += bool(selected.any())
        n_false += int(selected.sum())
        n_all += selected.size
        scores.append(machine.rms_nm(estimate))
    measured(
        f"pure noise: {n_false} of {n_all} wavelengths, {sets_with_false} of 200 sets, "
        f"RMS {np.mean(scores):.2f} nm"
    )

    assert n_false <= 0.05 * n_all
    assert sets_with_false <= 0.07 * 200
    assert np.mean(scores) <= 7.0
