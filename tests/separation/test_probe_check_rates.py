"""How often noise is taken for a fault, and how often a wrong angle of 1 degree is found.

The simulator is that of the example: ball of four lobes, run-out, motion, wander, 2 nm of noise.
"""

import math

import numpy as np
import pytest

from metrosep.separation.circles.probe_check import check_probes

NM = 1e-9
PHI = np.deg2rad([0.0, 20.6, 47.8, 326.5])
N, K, NOISE = 180, 30, 2.0
AT = 2 * math.pi * np.arange(N) / N


def ball(at):
    lobes = [(2, 18, 0.5), (3, 9, -1.2), (7, 4, 2.0), (15, 2, -0.3)]
    return sum(a * np.cos(k * at + p) for k, a, p in lobes)


def readings(rng, phi=PHI, *, noise=NOISE, part=1.0, revolutions=6):
    x = 12 * np.cos(2 * AT - 0.4) + 3 * np.cos(6 * AT)
    y = 7 * np.sin(3 * AT + 0.9) + 2 * np.cos(11 * AT)
    a, b = 6 * rng.standard_normal((2, revolutions, 1))
    x, y = x + a * np.cos(1.5 * AT), y + b * np.sin(1.5 * AT)
    m = []
    for p in phi:
        seen = part * ball(AT + p) + 400 * np.cos(AT + p - 1.0)
        seen = seen + x * math.cos(p) + y * math.sin(p)
        m.append(seen + noise * rng.standard_normal((revolutions, N)))
    return np.array(m) * NM


def checks(count, start=0, u_reading=NOISE, **options):
    for seed in range(start, start + count):
        m = readings(np.random.default_rng(seed), **options)
        yield check_probes(m, PHI, K, u_reading=u_reading * NM)


def off(probe, degrees):
    phi = PHI.copy()
    phi[probe] += math.radians(degrees)
    return phi


@pytest.mark.slow
def test_few_false_alarms():
    """Stated 0.2 %: more than 4 of 300 has a chance of 4e-4; nothing is named of them."""
    found = list(checks(300))

    assert sum(not f.agrees for f in found) <= 4
    # 300 sets of 58 degrees of freedom: sqrt(2 / 17400) = 1.07 %
    assert np.mean([f.chi2 / f.freedom for f in found]) == pytest.approx(1.0, abs=0.035)
    # Bonferroni makes p larger than uniform, never smaller: 0.1 below 0.1, sd 1.7 %
    assert np.mean([f.p < 0.1 for f in found]) < 0.152


@pytest.mark.slow
def test_a_round_part_raises_no_false_alarms():
    """The angle is then seen by the motion alone, and hardly: no free search through the noise."""
    assert sum(not f.agrees for f in checks(200, part=0.0)) <= 3


@pytest.mark.parametrize(("probe", "least"), [(0, 0.95), (1, 0.95), (2, 0.8), (3, 0.45)])
def test_one_degree_is_found_as_far_as_the_noise_allows(probe, least):
    """Power of a normal test of 2 n = 8 faults at 0.001 in all: z = 3.84; 60 trials."""
    found = list(checks(60, 500, phi=off(probe, 1.0)))

    u = found[0].suspects[0].u
    expected = 0.5 * math.erfc((3.84 - math.radians(1.0) / u) / math.sqrt(2.0))
    rate = np.mean([not f.agrees for f in found])
    assert rate > least
    assert rate > expected - 0.2  # 3 sd of 60 trials
    named = [f.named for f in found if f.named]
    assert len(named) > 0.75 * rate * 60
    assert all((s.probe, s.fault) == (probe, "angle") for s in named)


def test_twelve_revolutions_find_one_degree_of_the_worst_probe():
    found = list(checks(60, 600, phi=off(3, -1.0), revolutions=12))

    assert np.mean([not f.agrees for f in found]) > 0.88
    named = [f.named for f in found if f.named]
    assert all((s.probe, s.fault) == (3, "angle") for s in named)


@pytest.mark.slow
def test_u_of_the_angle_is_its_scatter():
    found = [f.named for f in checks(100, 700, phi=off(1, 1.2)) if f.named]

    sizes = np.degrees([s.size for s in found])
    # 100 trials: sd to 7 %, mean to a tenth of it
    assert len(found) > 95
    assert np.mean(sizes) == pytest.approx(1.2, abs=0.05)
    assert np.std(sizes) == pytest.approx(np.degrees(found[0].u), rel=0.25, abs=0.0)


@pytest.mark.slow
def test_u_of_the_sensitivity_is_its_scatter():
    found = []
    for seed in range(60):
        m = readings(np.random.default_rng(800 + seed))
        m[1] *= 1.05
        checked = check_probes(m, PHI, K, u_reading=NOISE * NM)
        found += [s for s in checked.suspects if (s.probe, s.fault) == (1, "sensitivity")]

    sizes = [s.size for s in found]
    assert np.mean(sizes) == pytest.approx(0.05, abs=0.003)
    assert np.std(sizes) == pytest.approx(found[0].u, rel=0.3, abs=0.0)  # 3 sd of 60 trials


def test_more_noise_than_stated_is_no_fault_of_a_probe():
    for f in checks(30, 900, noise=2 * NOISE):
        assert not f.agrees
        assert f.named is None
        assert "noise" in f.message


def test_less_noise_than_stated_is_told():
    found = next(checks(1, 950, noise=0.5 * NOISE))

    assert found.agrees
    assert f"{math.sqrt(found.chi2 / found.freedom):.2g} u_reading only" in found.message
    assert found.chi2 / found.freedom == pytest.approx(0.25, abs=0.15)  # 3 sd: 0.14


def test_an_angle_of_the_example_stated_1_2_degrees_wrong_is_named(repository):
    table = np.loadtxt(
        repository / "examples" / "multiprobe" / "readings.csv", delimiter=",", skiprows=1
    )
    m = table[:, 2:].T.reshape(4, 6, 180) * NM

    right = check_probes(m, PHI, K, u_reading=NOISE * NM)
    wrong = check_probes(m, PHI + np.deg2rad([0, 0, 1.2, 0]), K, u_reading=NOISE * NM)

    assert right.agrees
    assert (wrong.named.probe, wrong.named.fault) == (2, "angle")
    assert wrong.named.size == pytest.approx(-math.radians(1.2), abs=3 * wrong.named.u)
