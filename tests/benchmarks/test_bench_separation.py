"""Cost of the separators against a plain dense least squares of the same size, in one run.

Run with ``make bench``; ratios are printed, nothing is asserted about time.
"""

import time

import numpy as np
import pytest

from metrosep import Run, RunSet
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


def test_promise_of_a_plan_against_the_scatter_of_separations():
    """Amplitude of 10 mm at the planned feeds: promised sd and scatter over simulated sets, printed.

    The promise knows the noise and all other waves; the estimator learns both, and shrinks.
    """
    from metrosep.separation import plan_feedrates

    def density(f):  # 20 nm at 1 kHz and a mode at 12 Hz, 3 % damping, 60 nm
        return 8e-19 + (60e-9) ** 2 / np.pi * 0.36 / ((f - 12.0) ** 2 + 0.36**2)

    plan = plan_feedrates(density, [10e-3, 5e-3], 0.05, 0.2, 9, length=56e-3)
    found = []
    for seed in range(16):
        rng = np.random.default_rng([seed, 5])
        runs = []
        for v in plan.feeds:
            n = int(56e-3 / v * 1000)
            t, size = np.arange(n) / 1000, 16384
            f = np.fft.rfftfreq(size, 1e-3)
            lines = np.sqrt(density(f) * size * 1000 / 2) * np.exp(2j * np.pi * rng.random(f.size))
            lines *= np.sqrt(rng.exponential(size=f.size))
            noise = np.fft.irfft(lines, size)[:n]
            x = v * t
            wave = 2e-7 * np.cos(2 * np.pi * x / 10e-3) + 8e-8 * np.sin(2 * np.pi * x / 5e-3)
            runs.append(Run(x, wave + noise, t=t, feed=v))
        x = np.linspace(0.0, 50e-3, 2000, endpoint=False)
        z = separate(RunSet(runs)).evaluate(x)
        found.append(2 * np.mean(z * np.exp(2j * np.pi * x / 10e-3)))
    parts = np.array(found)
    scatter = np.sqrt(0.5 * (parts.real.var(ddof=1) + parts.imag.var(ddof=1))) * 1e9
    promised = float(plan.sd["sd_nm"][0])
    print(
        f"\n10 mm at {plan!r}: promised sd {promised:.2f} nm, scatter of 16 sets {scatter:.2f} nm"
    )
