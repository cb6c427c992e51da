"""Cost of the separators against a plain dense least squares and the best Gaussian low-pass, in one run.

Run with ``make bench``; ratios are printed, nothing is asserted about time.
"""

import subprocess
import sys
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


def test_gaussian_low_pass_of_the_mean(benchmark, runs):
    """The rival of the acceptance table, by scipy alone: 24 cut-offs, the truth chooses."""
    from acceptance.coverage.judge import CUTS_MM, gaussian, mean_of_runs
    from acceptance.coverage.machine import Reading

    rows = [Reading(r.run_id, r.x * 1e3, r.z * 1e9, r.t, r.feed * 1e3, r.direction) for r in runs]

    def rival():
        x, z = mean_of_runs(rows)
        return [gaussian(x, z, cut) for cut in CUTS_MM]

    benchmark.pedantic(rival, rounds=5, iterations=1)


@pytest.mark.parametrize("row", ["base", "lag 1 ms", "slip 8 mm", "2 kHz"])
def test_separate_rows_of_the_acceptance_table(benchmark, row):
    """9 x 700 (1400 at 2 kHz) as the acceptance table has them; goal 2 s, 3 s with lag and slip."""
    from acceptance.coverage.judge import metrosep_joint
    from acceptance.coverage.machine import simulate
    from acceptance.coverage.rows import ROWS

    runs = simulate(ROWS[row].machine, 440_000).runs
    metrosep_joint(runs, 45.0)
    benchmark.pedantic(lambda: metrosep_joint(runs, 45.0), rounds=3, iterations=1)


MILLION = """
import resource, sys, time
sys.path.insert(0, "tests")
from dataclasses import replace
from acceptance.coverage.judge import metrosep_joint
from acceptance.coverage.machine import simulate
from acceptance.coverage.rows import BASE
metrosep_joint(simulate(BASE, 1).runs, 45.0)  # imports
runs = simulate(replace(BASE, rate_hz={rate}), 440_001).runs
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
began = time.perf_counter()
metrosep_joint(runs, 45.0)
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(sum(r.z_nm.size for r in runs), time.perf_counter() - began, before / 1024, after / 1024)
"""
"""In a process of its own: greatest memory is that of this task."""


def test_a_million_samples():
    """Goal 30 s, 300 MB above the imports, one core; and how it grows from a tenth of them; printed."""
    cost = []
    for rate in (19_500.0, 195_000.0):
        done = subprocess.run(
            [sys.executable, "-c", MILLION.format(rate=rate)],
            check=True,
            capture_output=True,
            text=True,
        )
        n, seconds, before, after = map(float, done.stdout.split())
        cost.append((n, seconds))
        print(
            f"\n{n:.0f} samples: {seconds:.1f} s, {after:.0f} MB at most, "
            f"{after - before:.0f} MB above what the data and the imports took"
        )
    slope = np.diff(np.log([c[1] for c in cost])) / np.diff(np.log([c[0] for c in cost]))
    print(f"slope of cost against samples: {slope[0]:.2f}")
