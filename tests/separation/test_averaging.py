"""Random balls and three positions: signs, square-root law, overlap of patches, redundancy."""

import math

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.separation.maps.averaging import ThreePositions, ball_average, three_positions

N = 25
Y, X = np.mgrid[-12:13, -12:13] / 12.0
BASIS = np.stack([np.ones_like(X), X, Y, X**2 + Y**2]).reshape(4, -1)


def rigid_off(z):
    """Map without piston, tilt and power."""
    found = np.linalg.lstsq(BASIS.T, z.ravel(), rcond=None)[0]
    return z - (found @ BASIS).reshape(z.shape)


class TestThreePositions(SeparationContract):
    has_redundancy = True
    sd = 1e-9

    def method(self):
        return ThreePositions()

    def truth(self, rng):
        return {"part": rigid_off(20e-9 * rng.standard_normal((N, N)))}

    def errors(self, rng):
        odd = rigid_off(6e-9 * rng.standard_normal((N, N)))
        return {
            "instrument": rigid_off(10e-9 * rng.standard_normal((N, N))),
            "diverger_odd": (odd - odd[::-1, ::-1]) / 2,
        }

    def readings(self, truth, errors):
        s, i, d = (
            np.asarray(g.get(k, np.zeros((N, N))))
            for g, k in ((truth, "part"), (errors, "instrument"), (errors, "diverger_odd"))
        )
        return np.stack([i + s, i + np.rot90(s, 2), i - d])

    def test_alignment_reaches_no_part(self):
        *_, readings = self.draw(8)
        plain = self.method().separate(readings)
        rng = np.random.default_rng(9)
        planes = (1e-7 * rng.standard_normal((3, 4)) @ BASIS).reshape(3, N, N)
        seen = self.method().separate(readings + planes)
        for name, values in plain.parts.items():
            np.testing.assert_allclose(seen.parts[name], values, rtol=0.0, atol=1e-20)
        named = {i.part for i in plain.null_space if "defocus" in i.indices}
        assert named == {"part", "instrument", "diverger_odd"}

    def test_published_formula_and_arms(self):
        """Reference arm R and diverger D apart: W0 = R + D + S, Wc = R + (D + bar D)/2."""
        rng = np.random.default_rng(1)
        r, d, s = (rigid_off(1e-8 * rng.standard_normal((N, N))) for _ in range(3))
        bar = np.rot90
        w0, w180, wc = r + d + s, r + d + bar(s, 2), r + (d + bar(d, 2)) / 2
        result = three_positions(w0, w180, wc)

        np.testing.assert_allclose(
            result.part, (w0 + bar(w180, 2) - wc - bar(wc, 2)) / 2, rtol=0.0, atol=1e-21
        )
        np.testing.assert_allclose(result.part, s, rtol=0.0, atol=1e-21)
        np.testing.assert_allclose(result.instrument, r + d, rtol=0.0, atol=1e-21)
        np.testing.assert_allclose(result.diverger_odd, (d - bar(d, 2)) / 2, rtol=0.0, atol=1e-21)

    def test_one_file_twice(self):
        rng = np.random.default_rng(2)
        w0, w180, wc = self.readings(self.truth(rng), self.errors(rng))
        assert not any("twice" in m for m in three_positions(w0, w180, wc).messages)
        assert any("one file twice" in m for m in three_positions(w0, w0, wc).messages)

    def test_aperture_beside_the_middle(self):
        z = np.where(X > 0.3, 1e-9 * X * Y, np.nan)
        with pytest.raises(DataError, match="centre the aperture"):
            three_positions(z, z, z)

    def test_gaps_stay_gaps(self):
        rng = np.random.default_rng(3)
        readings = self.readings(self.truth(rng), self.errors(rng))
        readings[1, 3, 4] = np.nan
        found = self.method().separate(readings).part
        gone = np.zeros((N, N), dtype=bool)
        gone[3, 4] = gone[-4, -5] = True
        np.testing.assert_array_equal(np.isnan(found), gone)


def patches(rng, n, *, sd=5e-9, memory=0.0):
    """Independent smooth patches, or a sequence in which each remembers the one before."""
    out, last = [], np.zeros((N, N))
    for i in range(n):
        new = rigid_off(sd * rng.standard_normal((N, N)))
        last = new if i == 0 else memory * last + math.sqrt(1 - memory**2) * new
        out.append(last)
    return out


INSTRUMENT = rigid_off(20e-9 * (X**3 - 0.5 * Y**2 * X + X * Y))


class TestBall:
    def test_mean_is_the_instrument_with_its_sign(self):
        rng = np.random.default_rng(4)
        result = ball_average([INSTRUMENT + p + 1e-6 * X for p in patches(rng, 60)], dx=1e-4)
        error = result.instrument - INSTRUMENT

        assert np.corrcoef(result.instrument.ravel(), INSTRUMENT.ravel())[0, 1] > 0.99
        assert np.sqrt(np.mean(error**2)) == pytest.approx(5e-9 / math.sqrt(60), rel=0.1, abs=0.0)
        assert np.sqrt(np.mean(result.u["instrument"] ** 2)) == pytest.approx(
            5e-9 / math.sqrt(60), rel=0.05, abs=0.0
        )
        assert result.audit["n_effective"] == pytest.approx(60, rel=0.05, abs=0.0)
        assert not result.messages

    @pytest.mark.slow
    @pytest.mark.parametrize("memory", [0.5, 0.8])
    def test_patches_that_overlap_count_for_fewer(self, memory):
        """First-order memory a: N_eff tends to N (1 - a)/(1 + a)."""
        rng = np.random.default_rng(5)
        n, errors, stated, effective = 100, [], [], []
        for _ in range(30):
            result = ball_average([INSTRUMENT + p for p in patches(rng, n, memory=memory)])
            errors.append(np.mean((result.instrument - INSTRUMENT) ** 2))
            stated.append(np.mean(result.u["instrument"] ** 2))
            effective.append(result.audit["n_effective"])
        scatter = math.sqrt(np.mean(errors))

        assert math.sqrt(np.mean(stated)) == pytest.approx(scatter, rel=0.1, abs=0.0)
        law = n * (1 - memory) / (1 + memory)
        assert np.mean(effective) == pytest.approx(law, rel=0.15, abs=0.0)
        assert any("independent ones" in m for m in result.messages)

    def test_what_all_patches_share_is_named(self):
        result = ball_average(patches(np.random.default_rng(6), 10))
        reasons = " ".join(str(i) for i in result.null_space)
        assert "share" in reasons
        assert "defocus" in reasons

    def test_too_few_and_equal_patches(self):
        rng = np.random.default_rng(7)
        with pytest.raises(TooFewSamplesError, match="at least 5 maps"):
            ball_average(patches(rng, 4))
        slow = [np.cos(np.pi * i / 50) * INSTRUMENT.T for i in range(50)]
        with pytest.raises(DataError, match="turn the ball further"):
            ball_average(slow)
        with pytest.raises(DataError, match="removed may hold"):
            ball_average(patches(rng, 6), removed=("focus",))

    def test_masks_that_do_not_overlap(self):
        maps = patches(np.random.default_rng(8), 6)
        left = [np.where(X < -0.1, m, np.nan) for m in maps[:3]]
        right = [np.where(X > 0.1, m, np.nan) for m in maps[3:]]
        with pytest.raises(DataError, match="do not overlap"):
            ball_average(left + right)
