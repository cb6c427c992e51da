"""Cost of the separators against a plain dense least squares of the same size, in one run.

Run with ``make bench``; ratios are printed, nothing is asserted about time.
"""

import time

import numpy as np
import pytest

from metrosep.separation import machine_axis, separate

pytest.importorskip("pytest_benchmark", reason="installed by make bench")


@pytest.fixture(scope="module")
def runs():
    """Nine runs of 437 to 875 samples: the size of the goal (9 x 700)."""
    return machine_axis(seed=1, length=56e-3).runs


@pytest.mark.parametrize("method", ["joint", "kono", "mean"])
def test_separate(benchmark, runs, method):
    options = {"shortest": 4e-3} if method == "kono" else {}
    separate(runs, method=method, **options)

    benchmark.pedantic(lambda: separate(runs, method=method, **options), rounds=5, iterations=1)
    benchmark.extra_info["n_samples"] = sum(len(r) for r in runs)


def test_dense_least_squares(benchmark, runs):
    """What the joint method costs at least: one dense solution with as many columns."""
    x = np.concatenate([r.x for r in runs])
    z = np.concatenate([r.z for r in runs])
    k = np.arange(1, 176)
    phase = 2 * np.pi * np.outer(x, k) / 88e-3
    design = np.hstack([np.cos(phase), np.sin(phase)])

    benchmark.pedantic(lambda: np.linalg.lstsq(design, z, rcond=None), rounds=5, iterations=1)


def test_cost_grows_with_the_samples_and_not_faster():
    """Slope of log cost against log samples, printed."""
    cost = []
    for n in (1, 4):
        runs = machine_axis(seed=1, n_repeats=3 * n).runs
        started = time.perf_counter()
        separate(runs)
        cost.append(time.perf_counter() - started)
    print(f"\nslope of cost against samples: {np.log(cost[1] / cost[0]) / np.log(4):.2f}")
