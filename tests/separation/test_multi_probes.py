"""Any probes at any offsets: redundancy, free positions, angle sensors, gaps."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError, UnitError
from metrosep.separation.lines.three_points import MultiProbe, multi_probe_straightness

STEP = 2e-3
SHIFTS = (0, 2, 5, 9)
N = 30


def level(values, degree=1):
    t = np.linspace(-1.0, 1.0, values.size)
    return values - np.polyval(np.polyfit(t, values, degree), t)


def read(form, slide, pitch, shifts=SHIFTS):
    n = slide.size
    return np.stack([form[k : k + n] + slide + k * STEP * pitch for k in shifts])


class TestFourProbes(SeparationContract):
    has_redundancy = True
    exact = 1e-8

    def method(self):
        return MultiProbe(tuple(STEP * k for k in SHIFTS), STEP, zeros_known=True)

    def truth(self, rng):
        return {"artefact": level(1e-7 * rng.standard_normal(N + 9))}

    def errors(self, rng):
        slide = 1e-6 * rng.standard_normal(N)
        return {"straightness": slide, "pitch": 1e-5 * rng.standard_normal(N)}

    def readings(self, truth, errors):
        form = np.asarray(truth.get("artefact", np.zeros(N + 9)))
        slide = np.asarray(errors.get("straightness", np.zeros(N)))
        return read(form, slide, np.asarray(errors.get("pitch", np.zeros(N))))

    def invisible(self, rng):
        line = 1e-6 * np.arange(N + 9)
        yield {"artefact": line}, {"straightness": -line[:N], "pitch": -1e-6 / STEP * np.ones(N)}


class TestFiveProbesUnknownZeros(TestFourProbes):
    def method(self):
        return MultiProbe(tuple(STEP * k for k in (0, 1, 3, 7, 9)), STEP)

    def truth(self, rng):
        return {"artefact": level(1e-7 * rng.standard_normal(N + 9), 2)}

    def readings(self, truth, errors):
        form = np.asarray(truth.get("artefact", np.zeros(N + 9)))
        slide = np.asarray(errors.get("straightness", np.zeros(N)))
        pitch = np.asarray(errors.get("pitch", np.zeros(N)))
        return read(form, slide, pitch, (0, 1, 3, 7, 9))

    def test_zeros_of_the_probes_change_nothing(self):
        _, truth, _, readings = self.draw(21)
        zeros = np.array([3e-9, -8e-9, 1e-9, 4e-9, 6e-9])[:, None]

        found = self.method().separate(readings + zeros).artefact

        np.testing.assert_allclose(found, truth["artefact"], rtol=0, atol=1e-15)


def test_positions_of_any_step():
    """Positions off the grid, offsets of no multiple: a smooth form comes back to 0.01 %."""
    rng = np.random.default_rng(3)
    x = np.cumsum(rng.uniform(0.5, 1.5, 80))
    offsets = np.array([0.0, 3.3, 8.9, 13.1])
    slide, pitch = rng.standard_normal(80), rng.standard_normal(80)

    def form(s):
        return np.sin(2 * np.pi * s / 23.0) + 0.3 * np.cos(2 * np.pi * s / 11.0)

    m = form(x + offsets[:, None]) + slide + offsets[:, None] * pitch

    result = multi_probe_straightness(m, offsets, x=x, step=1.0, zeros_known=True)

    at = result.coordinates["x"]
    inside = slice(5, -5)
    rest = (result.artefact - form(at))[inside]
    assert np.std(level(rest)) < 1e-4


def test_offsets_refer_to_the_carriage():
    """Probes at -d, 0, d: straightness is that of the middle probe."""
    rng = np.random.default_rng(4)
    form = level(rng.standard_normal(42), 2)
    slide, pitch = rng.standard_normal(40), rng.standard_normal(40)
    m = np.stack([form[k : k + 40] + slide + (k - 1) * pitch for k in range(3)])

    result = multi_probe_straightness(m, [-1.0, 0.0, 1.0], step=1.0)

    np.testing.assert_allclose(result.straightness, slide, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.coordinates["x"][:2], [-1.0, 0.0], rtol=0, atol=1e-12)


def test_two_probes_and_an_angle_sensor_are_three_point():
    rng = np.random.default_rng(5)
    form = level(1e-7 * rng.standard_normal(31))
    slide, pitch = 1e-6 * rng.standard_normal(30), 1e-5 * rng.standard_normal(30)
    m = np.stack([form[:30] + slide, form[1:] + slide + STEP * pitch])

    result = multi_probe_straightness(
        m, [0.0, STEP], step=STEP, pitch=pitch + 1e-4, u_pitch=1e-8, u_reading=1e-9
    )

    np.testing.assert_allclose(result.artefact, form, rtol=0, atol=1e-16)
    # the zero of the sensor is not the pitch: that refers to the artefact without its line
    np.testing.assert_allclose(result.pitch, pitch, rtol=0, atol=1e-11)
    np.testing.assert_allclose(result.straightness, slide, rtol=0, atol=1e-14)


def test_a_redundant_probe_bridges_a_gap():
    form = level(np.sin(np.arange(39.0)), 1)
    m = read(form, np.zeros(30), np.zeros(30))
    m[1, 10:13] = np.nan

    result = multi_probe_straightness(m, STEP * np.array(SHIFTS), step=STEP, zeros_known=True)

    np.testing.assert_allclose(result.artefact, form, rtol=0, atol=1e-9)


def test_a_drifting_probe_is_noticed():
    rng = np.random.default_rng(6)
    m = 1e-9 * rng.standard_normal((4, N))
    m[1] += 20e-9 * np.linspace(0, 1, N) ** 2

    result = multi_probe_straightness(m, STEP * np.array(SHIFTS), step=STEP, u_reading=1e-9)

    assert any("drifts" in text for text in result.messages)


def test_spare_probe_lowers_the_noise_and_covariance_is_exact():
    """u against the definition: pseudo-inverse of the design written out here."""
    shifts = (0, 1, 3, 4)
    n, m = 12, 16
    result = multi_probe_straightness(
        np.zeros((4, n)), STEP * np.array(shifts), step=STEP, zeros_known=True, u_reading=1e-9
    )
    design = np.zeros((4 * n, m + 2 * n))
    for j, k in enumerate(shifts):
        for i in range(n):
            design[j * n + i, k + i] = 1.0
            design[j * n + i, m + i] = 1.0
            design[j * n + i, m + n + i] = k
    covariance = np.linalg.pinv(design.T @ design, rcond=1e-10)[:m, :m]
    t = np.vander(np.arange(m) - m / 2, 2)
    p = np.eye(m) - t @ np.linalg.pinv(t)
    expected = 1e-9 * np.sqrt(np.diag(p @ covariance @ p))
    np.testing.assert_allclose(result.u["artefact"], expected, rtol=1e-6, atol=0)


def test_transfer_falls_to_zero_only_where_all_probes_agree():
    method = MultiProbe((0.0, 6.0, 12.0), 1.0)
    np.testing.assert_allclose(method.transfer([6.0, 3.0, 2.0]), 0.0, rtol=0, atol=1e-9)
    assert MultiProbe((0.0, 5.0, 12.0), 1.0).transfer(np.linspace(2.0, 12.0, 500)).min() > 0.05
    # equal distances: |H|/sqrt(6) of the three-point method
    expected = np.abs(np.exp(2j * np.pi * 6 / 17.0) - 1) ** 2 / math.sqrt(6)
    assert method.transfer([17.0])[0] == pytest.approx(expected, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"offsets": [0.0, 2.0, 1.0]}, "rising"),
        ({"offsets": [0.0]}, "rising"),
        ({"offsets": [0.0, np.nan, 1.0]}, "rising"),
        ({"offsets": [0.0, 1.0]}, "2 readings"),
        ({"method": "sequential"}, "no method"),
        ({"x": np.arange(12.0) ** 2, "step": None}, "steps"),
        ({"x": np.full(12, np.nan)}, "finite"),
    ],
)
def test_bad_input_is_refused_in_words(change, words):
    given = {"offsets": [0.0, 1.0, 3.0], "step": 1.0, **change}
    with pytest.raises(MetrosepError, match=words):
        multi_probe_straightness(np.zeros((3, 12)), **given)


def test_too_many_positions_are_refused_before_memory_is_full():
    with pytest.raises(MetrosepError, match="positions"):
        multi_probe_straightness(np.zeros((3, 5000)), [0.0, 1.0, 2.0], step=1.0)


def test_offsets_in_millimetres_are_refused():
    """390 mm of travel, probes 10 m apart: no place is read twice."""
    m = 1e-6 * np.random.default_rng(1).standard_normal((3, 40))
    with pytest.raises(UnitError, match=r"390 mm.*10 m"):
        multi_probe_straightness(m, [0, 10, 20], step=0.01)


def test_a_far_probe_leaves_its_samples_between_as_not_measured():
    """Four probes, the last beyond the travel: what lies between was never read."""
    rng = np.random.default_rng(7)
    shifts = (0, 1, 2, 20)
    form = level(1e-7 * rng.standard_normal(34))
    m = read(form, 1e-6 * rng.standard_normal(14), 1e-6 * rng.standard_normal(14), shifts)

    result = multi_probe_straightness(
        m, STEP * np.array(shifts), step=STEP, zeros_known=True, u_reading=1e-9
    )

    unread = list(range(16, 20))
    assert np.flatnonzero(np.isnan(result.artefact)).tolist() == unread
    seen = ~np.isnan(result.artefact)
    t = np.arange(34.0)
    expected = form - np.polyval(np.polyfit(t[seen], form[seen], 1), t)
    np.testing.assert_allclose(result.artefact[seen], expected[seen], rtol=0, atol=1e-15)


def test_positions_that_leave_shapes_open_are_refused():
    """Positions two samples apart, probes three apart: each sample is read once at most."""
    m = 1e-6 * np.random.default_rng(2).standard_normal((2, 30))
    for method in ("least_squares", "generalised"):
        with pytest.raises(MetrosepError, match="step"):
            multi_probe_straightness(m, [0.0, 3.0], x=2.0 * np.arange(30), step=1.0, method=method)


@pytest.mark.parametrize("method", ["least_squares", "generalised"])
def test_the_noise_is_found_from_redundancy_by_every_method(method):
    rng = np.random.default_rng(8)
    found = [
        multi_probe_straightness(
            2e-9 * rng.standard_normal((4, N)), STEP * np.array(SHIFTS), step=STEP, method=method
        )
        for _ in range(40)
    ]
    noise = math.sqrt(np.mean([r.noise.value**2 for r in found]))
    assert noise == pytest.approx(2e-9, rel=0.1, abs=0.0)
    assert np.isfinite(found[0].u["artefact"]).all()


def test_a_probe_missing_in_one_pass_leaves_the_others_of_that_pass():
    """Five probes: the pass is still free of its own carriage at that position."""
    rng = np.random.default_rng(9)
    shifts = (0, 1, 3, 7, 9)
    form = level(1e-7 * rng.standard_normal(N + 9))
    slide, pitch = 1e-5 * rng.standard_normal((3, N)), 1e-4 * rng.standard_normal((3, N))
    m = np.stack([form[k : k + N] + slide + k * STEP * pitch for k in shifts])
    m[2, 1, 11] = m[4, 0, 3] = m[0, 2, 3] = np.nan

    result = multi_probe_straightness(m, STEP * np.array(shifts), step=STEP, zeros_known=True)

    np.testing.assert_allclose(result.artefact, form, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        level(result.straightness - slide.mean(axis=0)), 0.0, rtol=0, atol=1e-13
    )


def test_an_angle_belongs_to_whole_passes_only():
    """The sensor gives the mean pitch of all passes: where one misses a probe it says nothing."""
    rng = np.random.default_rng(10)
    form = level(1e-7 * rng.standard_normal(N + 2))
    slide, pitch = 1e-6 * rng.standard_normal((3, N)), 1e-5 * rng.standard_normal((3, N))
    m = np.stack([form[k : k + N] + slide + k * STEP * pitch for k in range(3)])
    m[1, 0, 8] = np.nan

    result = multi_probe_straightness(
        m,
        STEP * np.arange(3),
        step=STEP,
        pitch=pitch.mean(axis=0),
        u_pitch=1e-8,
        u_reading=1e-9,
    )

    np.testing.assert_allclose(result.artefact, form, rtol=0, atol=1e-12)
    assert any("angle" in text for text in result.messages)
