"""Planted faults are named, in size and sign; no fault is found where there is none."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.separation.circles.probe_check import check_probes

N, K, S = 256, 20, 1e-10
PHI = np.deg2rad([0.0, 20.5, 270.5, 297.0])


def readings(phi, seed=0, turn=1):
    rng = np.random.default_rng(seed)
    theta = 2 * math.pi * np.arange(N) / N
    phases = rng.uniform(0, 2 * math.pi, (3, K + 1))
    m = []
    for p in phi:
        row = S * rng.standard_normal(N)
        for k in range(1, K + 1):
            row += 3e-8 / k * np.cos(k * (theta + turn * p) + phases[0, k])
            row += 1e-8 / k * np.cos(k * theta + phases[1, k]) * math.cos(p)
            row += 1e-8 / k * np.cos(k * theta + phases[2, k]) * math.sin(p)
        m.append(row)
    return np.array(m)


def test_agreement_is_chi_square():
    ratios = []
    for seed in range(40):
        found = check_probes(readings(PHI, seed), PHI, K, u_reading=S)
        assert found.named is None
        assert found.agrees
        ratios.append(found.chi2 / found.freedom)
    assert found.freedom == 2 * (K - 1)
    # 40 sets of 38 degrees of freedom: sqrt(2/1520) = 3.6 %
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("probe", range(4))
@pytest.mark.parametrize("miss", [-1.5, 0.2])
def test_wrong_angle_is_named_with_its_sign(probe, miss):
    true = PHI.copy()
    true[probe] += math.radians(miss)

    found = check_probes(readings(true, probe), PHI, K, u_reading=S)

    assert not found.agrees
    assert (found.named.probe, found.named.fault) == (probe, "angle")
    assert math.degrees(found.named.size) == pytest.approx(miss, abs=0.05)
    assert f"{miss:+.2g}"[:3] in found.message


@pytest.mark.parametrize("probe", range(4))
def test_wrong_sensitivity_is_named_with_its_sign(probe):
    m = readings(PHI, probe)
    m[probe] *= 1.05

    found = check_probes(m, PHI, K, u_reading=S)

    assert (found.named.probe, found.named.fault) == (probe, "sensitivity")
    assert found.named.size == pytest.approx(0.05, abs=0.003)


def test_wrong_turn_is_named():
    found = check_probes(readings(PHI, turn=-1), PHI, K, u_reading=S)

    assert found.named.fault == "turn"
    assert "other way" in found.message


def test_two_faults_at_once_are_not_blamed_on_one_probe():
    true = PHI + np.deg2rad([0.0, 1.0, 0.0, -1.0])
    m = readings(true)
    m[2] *= 1.1

    found = check_probes(m, PHI, K, u_reading=S)

    assert not found.agrees
    assert found.named is None or "not all" in found.message
    assert np.isnan(found.chi2_per_k[:2]).all()
    assert np.nanmax(found.chi2_per_k) > 10
    assert "chi2" in repr(found)
    assert "<table" in found._repr_html_()


def test_three_probes_and_no_noise_are_refused():
    with pytest.raises(TooFewSamplesError, match=">= 4"):
        check_probes(readings(PHI[:3]), PHI[:3], K, u_reading=S)
    with pytest.raises(DataError, match="u_reading"):
        check_probes(readings(PHI), PHI, K, u_reading=0.0)


def test_the_angle_of_the_samples_may_stand_beside_them():
    m = readings(PHI)
    theta = 0.7 + 2 * math.pi * np.arange(N) / N

    plain = check_probes(m, PHI, K, u_reading=S)
    assert check_probes(m, PHI, K, u_reading=S, angle=theta).chi2 == plain.chi2
    with pytest.raises(InvalidSamplesError):
        check_probes(m, PHI, K, u_reading=S, angle=theta**2)
