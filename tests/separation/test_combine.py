"""Reversal and multi-probe results as one, per harmonic; simulated by direct trigonometry."""

import json
import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.separation.circles.probes import multiprobe
from metrosep.separation.circles.roundness_reversal import combine_harmonics, donaldson
from metrosep.separation.circles.steps import multistep

N, KMAX, S = 180, 26, 1e-9
THETA = 2 * math.pi * np.arange(N) / N
PHI = np.deg2rad([0, 45, 135])


def waves(rng):
    return [(k, 3e-8 / k, rng.uniform(0, 2 * math.pi)) for k in range(2, KMAX + 1)]


def height(w, angle):
    return sum(a * np.cos(k * angle + p) for k, a, p in w)


def both(seed, noise=S):
    """A three-probe set-up that loses k = 7, 9, 15 ... and a reversal that loses nothing."""
    rng = np.random.default_rng(seed)
    r, x = waves(rng), waves(rng)
    probes = np.array([height(r, THETA + p) + height(x, THETA) * math.cos(p) for p in PHI])
    pair = np.array([height(r, THETA) + height(x, THETA), height(r, THETA) - height(x, THETA)])
    probes += noise * rng.standard_normal(probes.shape)
    pair += 3 * noise * rng.standard_normal(pair.shape)
    first = multiprobe(probes, PHI, KMAX, u_reading=noise)
    second = donaldson(pair[0], pair[1], u_reading=3 * noise)
    return r, first, second


def test_suppressed_harmonics_come_from_the_reversal_the_rest_from_both():
    _, probes, reversal = both(0)

    found = combine_harmonics(probes, reversal, kmax=KMAX)

    assert found.suppressed == []
    assert 7 in probes.suppressed
    c = found.harmonics["artefact"]
    assert c[7] == reversal.harmonics["artefact"][7]
    for k in (2, 10):
        u1, u2 = (s.harmonics_u["artefact"][k] for s in (probes, reversal))
        c1, c2 = (s.harmonics["artefact"][k] for s in (probes, reversal))
        expected = (c1 * u2**2 + c2 * u1**2) / (u1**2 + u2**2)
        assert abs(c[k] - expected) < 1e-20
        assert found.harmonics_u["artefact"][k] == pytest.approx(
            u1 * u2 / math.hypot(u1, u2), rel=1e-9, abs=0
        )
    weights = np.array(found.audit["weights"]["artefact"])
    assert weights[:, 7].tolist() == [0.0, 1.0]
    np.testing.assert_allclose(weights[:, 2:].sum(axis=0), 1.0, rtol=0, atol=1e-12)


def test_combined_error_is_smaller_and_is_the_one_stated():
    errors, alone, stated = [], [], []
    for seed in range(60):
        r, probes, reversal = both(seed)
        truth = height(r, THETA)
        found = combine_harmonics(probes, reversal, kmax=KMAX)
        errors.append(np.mean((found.artefact - truth) ** 2))
        alone.append(np.mean((reversal.artefact - truth) ** 2))
        stated.append(np.mean(found.u["artefact"] ** 2))
    # 60 sets of 50 numbers of unequal weight: about 4 %
    assert np.mean(stated) == pytest.approx(np.mean(errors), rel=0.12, abs=0)
    assert np.mean(errors) < 0.5 * np.mean(alone)


def test_agreement_is_chi_square_and_a_turned_artefact_is_said():
    ratios = []
    for seed in range(30):
        _, probes, reversal = both(seed)
        found = combine_harmonics(probes, reversal, kmax=KMAX)
        ratios.append(found.audit["chi2_ratio"]["artefact"])
        assert not any("differ" in m for m in found.messages)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)

    _, probes, _ = both(0)
    r, _, _ = both(0)
    other = donaldson(height(r, THETA + 0.3), height(r, THETA + 0.3), u_reading=S)
    assert any("zero mark" in m for m in combine_harmonics(probes, other, kmax=KMAX).messages)


def test_what_nobody_sees_stays_unseen():
    _, probes, _ = both(1)

    found = combine_harmonics(probes, probes)

    assert found.suppressed == probes.suppressed
    assert np.isnan(found.harmonics["artefact"][7])
    assert any("every" in m for m in found.messages)


def test_inputs_without_weight_or_part_are_refused():
    _, probes, reversal = both(2)
    m = np.random.default_rng(0).standard_normal((3, N))
    unknown = multiprobe(m, PHI, KMAX)
    with pytest.raises(TooFewSamplesError, match=">= 2"):
        combine_harmonics(probes)
    with pytest.raises(DataError, match="u_reading"):
        combine_harmonics(probes, unknown)
    with pytest.raises(DataError, match="'x'"):
        combine_harmonics(probes, reversal, parts=("x",))
    with pytest.raises(DataError, match="kmax"):
        combine_harmonics(probes, reversal, kmax=5000)


def test_type_b_of_the_user_lowers_the_weight():
    _, probes, reversal = both(3)
    heavier = reversal.with_type_b({"form of the artefact": 1e-7}, part="artefact")

    weights = [
        np.array(combine_harmonics(probes, item, kmax=KMAX).audit["weights"]["artefact"])
        for item in (reversal, heavier)
    ]

    u = probes.harmonics_u["artefact"][2], heavier.harmonics_u["artefact"][2]
    assert u[1] > 0.9e-7
    assert weights[1][1, 2] == pytest.approx(u[0] ** 2 / (u[0] ** 2 + u[1] ** 2), rel=1e-9, abs=0)
    assert weights[1][1, 2] < 0.01 * weights[0][1, 2]


def gappy_reversal():
    rng = np.random.default_rng(8)
    w = waves(rng)
    m = height(w, THETA) + 1e-9 * rng.standard_normal((2, N))
    m[:, 20:30] = np.nan
    return donaldson(m[0], m[1], u_reading=S)


def test_gaps_are_not_called_suppressed():
    """Review B3: a curve with gaps has no harmonics; nothing was suppressed by the method."""
    _, probes, _ = both(4)

    found = combine_harmonics(probes, gappy_reversal(), kmax=KMAX)

    assert any("separation 1" in t and "gaps" in t for t in found.messages)
    assert not any("every separation" in t for t in found.messages)
    reasons = [item.reason for item in found.null_space if item.kind == "harmonic"]
    assert len(reasons) == 1
    assert "gaps" in reasons[0]
    with pytest.raises(DataError, match="gaps"):
        combine_harmonics(gappy_reversal(), gappy_reversal())


def test_eccentricity_that_one_knows_is_known():
    """Multi-step separates k = 1 where the artefact keeps its place; a reversal does not."""
    rng = np.random.default_rng(9)
    _, _, reversal = both(4)
    steps = multistep(1e-8 * rng.standard_normal((7, N)), 7, kmax=KMAX)

    found = combine_harmonics(steps, reversal, kmax=KMAX)

    assert found.harmonics["artefact"][1] == steps.harmonics["artefact"][1]
    terms = [item.indices for item in found.null_space if item.kind == "term"]
    assert terms == [("offset",)]


def test_what_is_no_separation_is_refused():
    _, probes, _ = both(4)
    with pytest.raises(DataError, match="input 1"):
        combine_harmonics(probes, probes.artefact)
    for kmax in (math.nan, math.inf, "20", 2.5):
        with pytest.raises(DataError, match="kmax"):
            combine_harmonics(probes, probes, kmax=kmax)


def test_result_is_json():
    for seed in range(2):
        _, probes, reversal = both(seed)
        found = combine_harmonics(probes, reversal)
        json.dumps(found.to_dict(), allow_nan=False)
        json.dumps(dict(found.audit), allow_nan=False)
