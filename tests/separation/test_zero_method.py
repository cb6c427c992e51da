"""Zero difference of three probes under the contract; carriage and probes written out."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.lines.zero_adjustment import ZeroAdjustment, zero_calibration

N = 25
SAME = 1e-20
"""m; the class and the function do the same sums."""


class TestReversal(SeparationContract):
    has_redundancy = True
    trials = 500
    distance, weights = 10e-3, (1.0, -2.0, 1.0)
    flat = False

    def method(self):
        return ZeroAdjustment(self.distance, self.flat)

    def truth(self, rng):
        return {"bend": 50e-9 * rng.standard_normal(N)}

    def errors(self, rng):
        return {"zero": 1e-6 * rng.standard_normal()}

    def readings(self, truth, errors):
        """``zero_again`` is the zero in the second set-up, where it differs."""
        bend, zero = truth.get("bend", np.zeros(N)), errors.get("zero", 0.0)
        again = errors.get("zero_again", zero)
        squares = sum(w**2 for w in self.weights)
        rows = [[w * (b + zero) / squares for b in bend] for w in self.weights]
        if not self.flat:
            rows += [[w * (again - b) / squares for b in bend] for w in self.weights]
        return np.array(rows)

    def invisible(self, rng):
        change = 1e-6 * rng.standard_normal()
        yield {"bend": np.full(N, -change)}, {"zero": change, "zero_again": -change}

    def test_the_carriage_drops_out_and_stays_in_corrected_readings(self):
        rng, truth, errors, readings = self.draw(20)
        d1 = self.distance if np.isscalar(self.distance) else self.distance[0]
        d2 = self.distance if np.isscalar(self.distance) else self.distance[1]
        moved = []
        for _ in range(len(readings) // 3):
            straight, pitch = 1e-6 * rng.standard_normal(N), 1e-5 * rng.standard_normal(N)
            moved += [straight, straight + pitch * d1, straight + pitch * (d1 + d2)]
        found = self.method().separate(readings + np.array(moved))
        assert float(found.zero) == pytest.approx(float(errors["zero"]), abs=1e-18)
        left = self.method().correct(readings + np.array(moved))
        expected = self.readings(truth, {}) + np.array(moved)
        np.testing.assert_allclose(left, expected, rtol=0.0, atol=1e-18)


class TestUnequalDistances(TestReversal):
    distance, weights = (10e-3, 20e-3), (1.0, -1.5, 0.5)


class TestFlat(TestReversal):
    flat = True

    def truth(self, rng):
        return {}

    def invisible(self, rng):
        c = 1e-6 * rng.standard_normal()
        yield {"bend": np.full(N, -c)}, {"zero": c}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """The flat need not be flat to be simulated."""
        rng, _, errors, _ = self.draw(seed)
        truth = {"bend": 1e-8 * rng.standard_normal(N)}
        simulated = self.method().simulate(truth, errors)
        np.testing.assert_allclose(simulated, self.readings(truth, errors), rtol=0, atol=1e-20)


def test_real_forms_under_three_probes_give_zero_and_bend():
    """An artefact of a known function, carriage and zeros of each probe planted."""
    rng = np.random.default_rng(8)
    x, d = 0.1 + 5e-3 * np.arange(N), 10e-3
    zeros = np.array([3e-7, -1e-7, 8e-7])[:, None]

    def form(at):
        return 1e-6 * np.sin(40 * at) + 2e-6 * at**2

    under = np.stack([form(x), form(x + d), form(x + 2 * d)])
    carriage = [
        rng.standard_normal(N) * 1e-6 + 1e-6 * rng.standard_normal(N) * np.arange(3)[:, None]
        for _ in range(2)
    ]
    readings = np.concatenate([under + zeros + carriage[0], -under + zeros + carriage[1]])
    found = ZeroAdjustment(d).separate(readings)
    assert float(found.zero) == pytest.approx(3e-7 + 2e-7 + 8e-7, abs=1e-18)
    np.testing.assert_allclose(found.bend, under[0] - 2 * under[1] + under[2], rtol=0, atol=1e-18)


@pytest.mark.parametrize("flat", [False, True])
def test_the_class_gives_what_the_function_gives_with_gaps(flat):
    rng = np.random.default_rng(9)
    readings = 1e-8 * rng.standard_normal((3 if flat else 6, 4, N))
    readings[1, 2, 5] = np.nan
    readings[0, :, 7] = np.nan
    found = ZeroAdjustment(10e-3, flat, 3e-9 if flat else 0.0).separate(readings)
    given = {"flat": 0.0, "u_flat": 3e-9} if flat else {"reversed_m": readings[3:]}
    same = zero_calibration(readings[:3], 10e-3, **given)
    assert float(found.zero) == pytest.approx(same.zero, abs=SAME)
    assert float(found.u["zero"]) == pytest.approx(same.u, abs=SAME)
    assert np.isnan(found.bend[7])
    assert np.isfinite(found.bend[5])
    assert found.u["bend"][5] > found.u["bend"][4]
    assert found.noise.value == pytest.approx(1e-8, rel=0.25, abs=0.0)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ZeroAdjustment(0.0), "distance"),
        (lambda: ZeroAdjustment(1e-2, True, -1e-9), "u_flat"),
        (lambda: ZeroAdjustment(1e-2).separate(np.zeros((3, 5))), "reversed"),
        (lambda: ZeroAdjustment(1e-2).separate(np.zeros((6, 1))), "one position"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
