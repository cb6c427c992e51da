"""Reversals: exact algebra, planted signs, noise law, index error, gaps."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, NotSeparableError
from metrosep.separation.circles.roundness_reversal import (
    DonaldsonReversal,
    FaceReversal,
    donaldson,
    face_reversal,
)
from metrosep.separation.lines.reversals import StraightedgeReversal, straightedge_reversal

EXACT = 1e-12
"""S11: relative error without noise; sums of two doubles."""

MC_RTOL = 0.05
"""S11: 400 trials of 180 samples: the scatter itself is known to 0.3 %."""

N = 180
ANGLE = 2 * np.pi * np.arange(N) / N


def round_shape(rng, *, highest=40, size=50e-9):
    """Undulations from 2 on, falling with 1/k, with random phases."""
    k = np.arange(2, highest + 1)
    c = rng.standard_normal(k.size) / k + 1j * rng.standard_normal(k.size) / k
    return size * np.real(np.exp(1j * np.outer(ANGLE, k)) @ c)


X = np.linspace(0.0, 0.3, 61)


def straight(rng, size=50e-9):
    """Random curve without mean and slope over X."""
    z = size * np.cumsum(rng.standard_normal(X.size))
    return z - np.polyval(np.polyfit(X, z, 1), X)


class TestDonaldson(SeparationContract):
    def method(self):
        return DonaldsonReversal()

    def truth(self, rng):
        return {"artefact": round_shape(rng)}

    def errors(self, rng):
        return {"spindle": round_shape(rng, size=20e-9)}

    def readings(self, truth, errors):
        p, s = truth.get("artefact", 0.0), errors.get("spindle", 0.0)
        return np.array([p + s, p - s])

    def test_eccentricity_of_both_setups_is_removed(self):
        rng = np.random.default_rng(1)
        p, s = round_shape(rng), round_shape(rng)
        m1 = p + s + 3e-6 * np.cos(ANGLE - 0.4) + 1e-6
        m2 = p - s + 5e-6 * np.sin(ANGLE + 1.0) - 2e-6

        result = donaldson(m1, m2)

        np.testing.assert_allclose(result.artefact, p, rtol=0.0, atol=EXACT * 5e-6)
        np.testing.assert_allclose(result.spindle, s, rtol=0.0, atol=EXACT * 5e-6)
        assert result.suppressed == []
        assert result.null_space[0].indices == ("offset", "eccentricity")

    def test_harmonics_have_the_planted_phase_and_nan_below_two(self):
        p = 30e-9 * np.cos(3 * ANGLE - 0.7)

        c = donaldson(p, p).harmonics["artefact"]

        assert np.isnan(c[:2]).all()
        assert abs(c[3] - 30e-9 * np.exp(-0.7j)) < EXACT * 30e-9
        assert np.abs(c[4:]).max() < EXACT * 30e-9

    def test_noise_falls_with_the_root_of_twice_the_revolutions(self):
        rng = np.random.default_rng(2)
        p, s, sd, m = round_shape(rng), round_shape(rng), 3e-9, 5
        found = []
        for _ in range(400):
            noise = sd * rng.standard_normal((2, m, N))
            result = donaldson(p + s + noise[0], p - s + noise[1])
            found.append((result.artefact, result.noise.value, result.u["artefact"].mean()))
        scatter = np.std([f[0] for f in found], axis=0, ddof=1)

        law = sd / math.sqrt(2 * m) * math.sqrt(1 - 3 / N)  # three coefficients are removed
        assert np.sqrt(np.mean(scatter**2)) == pytest.approx(law, rel=MC_RTOL, abs=0.0)
        assert np.mean([f[1] for f in found]) == pytest.approx(sd, rel=0.01, abs=0.0)
        assert np.mean([f[2] for f in found]) == pytest.approx(law, rel=0.01, abs=0.0)

    def test_index_error_costs_half_of_the_derivative(self):
        """S11: the half turn is wrong by d; RMS of the error is d/2 RMS(P')."""
        rng = np.random.default_rng(3)
        k = np.arange(2, 31)
        c = (rng.standard_normal(k.size) + 1j * rng.standard_normal(k.size)) / k
        d = math.radians(0.1)

        def shape(angle):
            return 50e-9 * np.real(np.exp(1j * np.outer(angle, k)) @ c)

        s = round_shape(rng)
        result = donaldson(shape(ANGLE) + s, shape(ANGLE + d) - s, u_reading=0.0, u_index=d)
        error = result.artefact - shape(ANGLE)

        slope = 50e-9 * np.real(np.exp(1j * np.outer(ANGLE, k)) @ (1j * k * c))
        rms = np.sqrt(np.mean(error**2))
        assert rms == pytest.approx(d / 2 * np.sqrt(np.mean(slope**2)), rel=MC_RTOL, abs=0.0)
        # u is that of the estimate's slope, and belongs to the machine as well
        assert np.sqrt(np.mean(result.u["artefact"] ** 2)) == pytest.approx(
            rms, rel=MC_RTOL, abs=0.0
        )
        np.testing.assert_array_equal(result.u["artefact"], result.u["spindle"])
        # sign: m2 late by d moves half of P' into the artefact and minus half into the spindle
        assert np.corrcoef(error, slope)[0, 1] > 0.99
        assert np.corrcoef(result.spindle - s, slope)[0, 1] < -0.99

    def test_noise_does_not_inflate_the_index_term(self):
        rng = np.random.default_rng(4)
        p = 50e-9 * np.cos(2 * ANGLE)
        noise = 1e-9 * rng.standard_normal((2, 20, N))
        d = 1e-3

        with_index = donaldson(p + noise[0], p + noise[1], u_index=d)
        without = donaldson(p + noise[0], p + noise[1])

        added = with_index.u["artefact"] ** 2 - without.u["artefact"] ** 2
        expected = d / 2 * 100e-9 / math.sqrt(2)
        assert math.sqrt(added.mean()) == pytest.approx(expected, rel=0.05, abs=0.0)

    def test_gaps_stay_gaps_in_both_parts(self):
        rng = np.random.default_rng(5)
        p, s = round_shape(rng), round_shape(rng)
        m1, m2 = p + s, p - s
        m1[10], m2[40:43] = np.nan, np.nan

        result = donaldson(m1, m2)

        gone = np.isin(np.arange(N), [10, 40, 41, 42])
        for values, true in ((result.artefact, p), (result.spindle, s)):
            np.testing.assert_array_equal(np.isnan(values), gone)
            rest = (values - true)[~gone]  # only mean and eccentricity may differ
            basis = np.column_stack([np.ones(N), np.cos(ANGLE), np.sin(ANGLE)])[~gone]
            left = rest - basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
            assert np.abs(left).max() < 1e-20
        assert np.isnan(result.harmonics["artefact"]).all()

    def test_missing_half_turn_is_doubted(self):
        rng = np.random.default_rng(6)
        p, s = round_shape(rng), round_shape(rng, size=1e-9)

        result = donaldson(p + s, np.roll(p - s, N // 2))

        assert any("half turn" in m for m in result.messages)
        assert not any("half turn" in m for m in donaldson(p + s, p - s).messages)

    def test_profiles_over_different_angles_are_refused(self):
        p = round_shape(np.random.default_rng(7))
        first, second = ms.Profile(ANGLE, p), ms.Profile(ANGLE + np.pi, p)

        with pytest.raises(DataError, match="half a revolution"):
            donaldson(first, second)
        with pytest.raises(InvalidSamplesError, match="look like degrees"):
            donaldson(ms.Profile(np.degrees(ANGLE), p), ms.Profile(np.degrees(ANGLE), p))
        np.testing.assert_array_equal(donaldson(first, first).artefact, donaldson(p, p).artefact)

    def test_unequal_lengths_and_wrong_u_are_refused(self):
        p = round_shape(np.random.default_rng(8))
        with pytest.raises(DataError, match="equal length"):
            donaldson(p, p[:-1])
        for bad in (-1e-9, math.nan, math.inf):
            with pytest.raises(DataError, match="u_reading"):
                donaldson(p, p, u_reading=bad)
            with pytest.raises(DataError, match="u_index"):
                donaldson(p, p, u_index=bad)

    def test_unequal_numbers_of_revolutions_weigh_by_their_counts(self):
        rng = np.random.default_rng(9)
        p = round_shape(rng)
        m1 = p + 1e-9 * rng.standard_normal((8, N))
        result = donaldson(m1, p + 1e-9 * rng.standard_normal((2, N)), u_reading=1e-9)

        law = 1e-9 / 2 * math.sqrt(1 / 8 + 1 / 2) * math.sqrt(1 - 3 / N)
        np.testing.assert_allclose(result.u["spindle"], law, rtol=1e-12)

    def test_level_of_each_revolution_does_not_leak_at_a_gap(self):
        """One sample is missing in one of three revolutions that drift by 0.5 um each."""
        rng = np.random.default_rng(31)
        p, s = round_shape(rng), round_shape(rng)
        drift = 0.5e-6 * np.arange(3)[:, None] + 1e-6 * np.arange(3)[:, None] * np.cos(ANGLE)
        m1, m2 = p + s + drift, p - s - 2 * drift
        m1[1, 20], m2[2, 40:60] = np.nan, np.nan

        result = donaldson(m1, m2)

        np.testing.assert_allclose(result.artefact, p, rtol=0.0, atol=1e-19)
        np.testing.assert_allclose(result.spindle, s, rtol=0.0, atol=1e-19)
        assert result.noise.value < 1e-19

    def test_start_angle_is_carried(self):
        p = 30e-9 * np.cos(3 * ANGLE - 0.7)
        start = np.radians(30.0)
        angle = ANGLE + start
        shifted = 30e-9 * np.cos(3 * angle - 0.7)

        for result in (
            donaldson(ms.Profile(angle, shifted), ms.Profile(angle, shifted)),
            donaldson(shifted, shifted, angle=angle),
        ):
            assert result.coordinates["angle"][0] == pytest.approx(start, abs=1e-12)
            c = result.harmonics["artefact"][3]
            assert abs(c - donaldson(p, p).harmonics["artefact"][3]) < 1e-12 * 30e-9
        with pytest.raises(DataError, match="10 angles for"):
            donaldson(p, p, angle=angle[:10])
        with pytest.raises(InvalidSamplesError, match="they fall"):
            donaldson(p, p, angle=angle[::-1])

    def test_harmonics_have_the_scatter_of_motion_that_does_not_repeat(self):
        """Asynchronous motion at k = 2.3 is not white: its harmonics scatter more than s sqrt(2/n)."""
        rng = np.random.default_rng(32)
        m, trials = 10, 150
        found, stated = [], []
        for _ in range(trials):
            phase = rng.uniform(0, 2 * np.pi, (2, m, 1))
            wander = 20e-9 * np.cos(2.3 * ANGLE + phase)
            result = donaldson(*(wander + 1e-9 * rng.standard_normal((2, m, N))))
            found.append(result.harmonics["spindle"][2:6])
            stated.append(result.harmonics_u["spindle"][2:6])
        c = np.array(found)
        scatter = np.sqrt((np.var(c.real, axis=0) + np.var(c.imag, axis=0)) / 2)
        ratio = np.sqrt(np.mean(np.square(stated), axis=0)) / scatter
        np.testing.assert_allclose(ratio, 1.0, atol=0.15)  # 150 trials: 6 % each

    def test_white_noise_of_few_samples_reaches_harmonics_undiminished(self):
        rng = np.random.default_rng(33)
        n, trials = 12, 800
        c = [
            donaldson(*(1e-9 * rng.standard_normal((2, n))), u_reading=1e-9) for _ in range(trials)
        ]
        spread = np.std([r.harmonics["artefact"][3].real for r in c])
        # 800 trials know the spread to 2.5 %; without the correction it would be 16 % too small
        assert c[0].harmonics_u["artefact"][3] == pytest.approx(spread, rel=0.08, abs=0.0)

    def test_index_error_is_in_the_harmonics(self):
        p = 500e-9 * np.cos(20 * ANGLE)
        d = np.radians(0.5)
        result = donaldson(p, p, u_reading=0.0, u_index=d)
        # |error of c_k| = k |c| d / 2, shared by real and imaginary part
        expected = 20 * 500e-9 * d / 2 / np.sqrt(2)
        assert result.harmonics_u["spindle"][20] == pytest.approx(expected, rel=1e-6, abs=0.0)

    def test_type_b_terms_reach_the_harmonics(self):
        p = 500e-9 * np.cos(20 * ANGLE)
        more = donaldson(p, p, u_reading=1e-9).with_type_b({"form": 5e-9})
        assert more.harmonics_u["artefact"][20] > 5e-9

    def test_gaps_that_do_not_overlap_are_refused(self):
        p = round_shape(np.random.default_rng(34))
        m1, m2 = p.copy(), p.copy()
        m1[: N // 2], m2[N // 2 :] = np.nan, np.nan
        with pytest.raises(NotSeparableError, match="0 of 180"):
            donaldson(m1, m2)

    def test_gap_says_that_harmonics_are_not_determined(self):
        p = round_shape(np.random.default_rng(35))
        m1 = p.copy()
        m1[3] = np.nan
        assert any("harmonics" in m for m in donaldson(m1, p).messages)

    def test_doubts_about_the_second_set_up(self):
        rng = np.random.default_rng(36)
        p, s = round_shape(rng), round_shape(rng, size=1e-9)
        assert any("same" in m for m in donaldson(p + s, p + s).messages)
        mirrored = np.roll((p - s)[::-1], 1)
        assert any("other way" in m for m in donaldson(p + s, mirrored).messages)
        assert any("5 um is 5e-6" in m for m in donaldson(p * 1e9, p * 1e9 + s).messages)

    def test_masks_complex_numbers_and_texts(self):
        p = round_shape(np.random.default_rng(37))
        masked = np.ma.masked_array(p, mask=np.arange(N) == 5)
        assert np.isnan(donaldson(masked, p).artefact[5])
        pair = np.ma.masked_array([p, p], mask=[np.arange(N) == 5] * 2)
        assert np.isnan(DonaldsonReversal().correct(pair)[:, 5]).all()
        with pytest.raises(InvalidSamplesError, match="complex"):
            donaldson(p + 0j, p)
        with pytest.raises(InvalidSamplesError, match="no array"):
            donaldson([[1, 2], [3]], p)
        for words in ({"u_reading": "5 nm"}, {"u_index": "1 deg"}, {"u_index": 2.0}):
            with pytest.raises(DataError, match=next(iter(words))):
                donaldson(p, p, **words)


class TestStraightedge(SeparationContract):
    def method(self):
        return StraightedgeReversal(x=tuple(X))

    def truth(self, rng):
        return {"artefact": straight(rng)}

    def errors(self, rng):
        return {"machine": straight(rng)}

    def readings(self, truth, errors):
        t, s = truth.get("artefact", 0.0), errors.get("machine", 0.0)
        return np.array([t + s, t - s])

    def test_lines_of_each_setup_are_removed(self):
        rng = np.random.default_rng(11)
        t, s = straight(rng), straight(rng)

        result = straightedge_reversal(t + s + 4e-6 + 1e-4 * X, t - s - 1e-6 - 3e-5 * X, x=X)

        np.testing.assert_allclose(result.artefact, t, rtol=0.0, atol=EXACT * 4e-5)
        np.testing.assert_allclose(result.machine, s, rtol=0.0, atol=EXACT * 4e-5)

    def test_a_bump_of_the_edge_is_on_the_edge_with_its_sign(self):
        bump = np.where(np.abs(X - 0.1) < 0.01, 80e-9, 0.0)
        result = straightedge_reversal(bump, bump, x=X)

        assert result.artefact[X.searchsorted(0.1)] > 60e-9
        assert np.abs(result.machine).max() < 1e-22

    def test_registration_error_costs_half_of_the_slope(self):
        d = 1e-3

        def edge(x):
            return 1e-6 * np.sin(2 * np.pi * x / 0.1)

        result = straightedge_reversal(edge(X), edge(X + d), x=X, u_reading=0.0, u_registration=d)
        line = np.polyfit(X, edge(X), 1)
        error = result.artefact - (edge(X) - np.polyval(line, X))

        slope = 2 * np.pi / 0.1 * 1e-6
        assert np.abs(result.machine).max() == pytest.approx(d / 2 * slope, rel=0.05, abs=0.0)
        assert np.sqrt(np.mean(error**2)) == pytest.approx(
            np.sqrt(np.mean(result.u["artefact"] ** 2)), rel=0.05, abs=0.0
        )

    def test_line_of_each_pass_does_not_leak_at_a_gap(self):
        still = np.zeros((2, 2, X.size))
        still[0, 1] += 10e-6 * X / 0.3
        still[0, 0, 10] = np.nan

        result = straightedge_reversal(*still, x=X)

        assert np.abs(result.artefact).max() < 1e-19

    def test_passes_are_corrected_one_by_one(self):
        rng = np.random.default_rng(41)
        t, s = straight(rng), straight(rng)
        passes = np.stack([np.tile(t + s, (2, 1)), np.tile(t - s, (2, 1))])
        for m in (passes, np.repeat(passes, 2, axis=1)[:, :3]):
            corrected = StraightedgeReversal(x=tuple(X)).correct(m)
            np.testing.assert_allclose(corrected, np.broadcast_to(t, m.shape), atol=1e-19)

    def test_falling_positions_and_profiles(self):
        rng = np.random.default_rng(12)
        t, s = straight(rng), straight(rng)
        up = straightedge_reversal(t + s, t - s, x=X)
        down = straightedge_reversal((t + s)[::-1], (t - s)[::-1], x=X[::-1])
        profiles = straightedge_reversal(ms.Profile(X, t + s), ms.Profile(X, t - s))

        np.testing.assert_allclose(down.machine[::-1], up.machine, rtol=0.0, atol=1e-20)
        np.testing.assert_array_equal(profiles.machine, up.machine)
        np.testing.assert_array_equal(profiles.coordinates["x"], X)
        assert profiles.history[-1].name == "straightedge_reversal"

    def test_registration_needs_positions(self):
        z = straight(np.random.default_rng(13))
        with pytest.raises(DataError, match="needs the positions"):
            straightedge_reversal(z, z, u_registration=1e-6)
        with pytest.raises(InvalidSamplesError, match="strictly"):
            straightedge_reversal(z, z, x=np.zeros(z.size))
        with pytest.raises(DataError, match="5 positions"):
            straightedge_reversal(z, z, x=X[:5])


class TestFace(SeparationContract):
    radius = 25e-3

    def method(self):
        return FaceReversal(self.radius)

    def truth(self, rng):
        return {"artefact": round_shape(rng)}

    def errors(self, rng):
        once = 40e-9 * np.cos(ANGLE + 0.3)  # fundamental axial motion is real
        return {
            "axial": round_shape(rng, size=10e-9) + once,
            "tilt": round_shape(rng, size=50e-9) / self.radius,
        }

    def readings(self, truth, errors):
        p = truth.get("artefact", np.zeros(N))
        a, t = errors.get("axial", np.zeros(N)), errors.get("tilt", np.zeros(N))
        return np.array([a + self.radius * t + p, a - self.radius * t + p, a + 0.0])

    def test_plate_out_of_square_is_in_neither(self):
        rng = np.random.default_rng(21)
        truth, errors = self.truth(rng), self.errors(rng)
        f1, f2, a = self.readings(truth, errors)

        result = face_reversal(
            f1 + 2e-6 * np.cos(ANGLE), f2 + 3e-6 * np.sin(ANGLE), a + 1e-6, self.radius
        )

        for name, values in {**truth, **errors}.items():
            size = 3e-6 / self.radius if name == "tilt" else 3e-6
            np.testing.assert_allclose(
                result.parts[name], values, rtol=0.0, atol=EXACT * size, err_msg=name
            )
        assert abs(result.harmonics["axial"][1] - 40e-9 * np.exp(0.3j)) < 1e-18

    def test_uncertainties_follow_the_published_law(self):
        *_, readings = self.draw(22)
        u = FaceReversal(self.radius).separate(readings, u_reading=1e-9).u
        left = math.sqrt(1 - 3 / N)

        np.testing.assert_allclose(u["tilt"], 1e-9 / self.radius / math.sqrt(2) * left, rtol=1e-9)
        np.testing.assert_allclose(u["artefact"], 1e-9 * math.sqrt(1.5) * left, rtol=1e-9)
        np.testing.assert_allclose(u["axial"], 1e-9 * math.sqrt(1 - 1 / N), rtol=1e-9)

    def test_second_axial_reading_takes_out_motion_that_differs(self):
        rng = np.random.default_rng(23)
        truth, errors = self.truth(rng), self.errors(rng)
        f1, f2, a = self.readings(truth, errors)
        other = 30e-9 * np.cos(5 * ANGLE)  # axial motion of set-up 2 alone

        with_two = face_reversal(f1, f2 + other, a, self.radius, axial2=a + other)
        with_one = face_reversal(f1, f2 + other, a, self.radius)

        np.testing.assert_allclose(with_two.artefact, truth["artefact"], rtol=0.0, atol=1e-20)
        np.testing.assert_allclose(
            with_two.tilt, errors["tilt"], rtol=0.0, atol=1e-18 / self.radius
        )
        assert np.abs(with_one.artefact - truth["artefact"]).max() > 10e-9

    def test_fourth_reading_is_corrected_too(self):
        rng = np.random.default_rng(42)
        truth, errors = self.truth(rng), self.errors(rng)
        three = self.readings(truth, errors)
        four = np.concatenate([three, three[2:]])
        expected = self.readings(truth, {})
        for m in (four, np.repeat(four[:, None], 3, axis=1)):
            corrected = FaceReversal(self.radius).correct(m)
            first = corrected[:, 0] if m.ndim == 3 else corrected
            np.testing.assert_allclose(first[:3], expected, atol=1e-19)
            np.testing.assert_allclose(first[3], 0.0, atol=1e-19)

    @pytest.mark.parametrize("radius", [0.0, -0.025, math.nan, 25.0, "25 m"])
    def test_impossible_radius_is_refused(self, radius):
        with pytest.raises(DataError, match="25 mm is 25e-3"):
            FaceReversal(radius)

    def test_a_radius_may_be_a_text_with_its_unit(self):
        assert FaceReversal("25 mm") == FaceReversal(25e-3)
        with pytest.raises(DataError, match="radius"):
            FaceReversal("large")


def test_angles_rounded_in_a_text_are_taken_and_several_turns_named():
    p = round_shape(np.random.default_rng(51))
    assert donaldson(p, p, angle=np.radians(np.round(np.degrees(ANGLE), 2))).artefact.size == N
    many = np.concatenate([ANGLE + 2 * np.pi * k for k in range(5)])
    with pytest.raises(InvalidSamplesError, match="5 revolutions"):
        donaldson(np.tile(p, 5), np.tile(p, 5), angle=many)
    with pytest.raises(InvalidSamplesError, match="look like degrees"):
        donaldson(p, p, angle=np.degrees(ANGLE))
