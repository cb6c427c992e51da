"""Setting, synchronous and asynchronous motion under the contract."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.circles.spindle import SpindleSplit, iso230_7

M, N, START = 8, 90, 0.3
ANGLE = START + 2 * np.pi * np.arange(N) / N

SAME = 1e-18
"""m; micrometres of eccentricity in double precision."""


def waves(rng, orders, size):
    """A curve of stated harmonics, summed one by one."""
    return size * sum(
        a * np.cos(k * ANGLE) + b * np.sin(k * ANGLE)
        for k, (a, b) in zip(orders, rng.standard_normal((len(orders), 2)), strict=True)
    )


class TestRadial(SeparationContract):
    takes_repeats = False
    has_redundancy = True
    direction = "radial"
    setting_orders, motion_orders = (0, 1), (2, 3, 5, 11)

    def method(self):
        return SpindleSplit(self.direction, START)

    def truth(self, rng):
        return {"setting": waves(rng, self.setting_orders, 3e-6)}

    def errors(self, rng):
        return {"synchronous": waves(rng, self.motion_orders, 50e-9)}

    def readings(self, truth, errors):
        out = np.array(errors.get("asynchronous", np.zeros((M, N))))
        for i in range(len(out)):
            out[i] += truth.get("setting", np.zeros(N))
            out[i] += errors.get("synchronous", np.zeros(N))
        return out

    def invisible(self, rng):
        set_again = waves(rng, self.setting_orders, 1e-6)
        yield {"setting": set_again}, {"synchronous": -set_again}
        shared = waves(rng, (2, 4), 1e-6)
        yield {}, {"synchronous": shared, "asynchronous": np.tile(-shared, (M, 1))}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """Without asynchronous motion the number of revolutions is not known: it is given here."""
        rng, truth, errors, _ = self.draw(seed)
        errors["asynchronous"] = 1e-8 * rng.standard_normal((M, N))
        np.testing.assert_allclose(
            self.method().simulate(truth, errors), self.readings(truth, errors), rtol=0, atol=SAME
        )
        assert self.method().simulate(truth, {}).shape == (2, N)

    def test_asynchronous_motion_comes_back_with_its_sign_and_leaves_the_corrected_readings(self):
        rng, truth, errors, _ = self.draw(21)
        own = 1e-8 * rng.standard_normal((M, N))
        errors["asynchronous"] = own - own.mean(axis=0)
        readings = self.readings(truth, errors)
        found = self.method().separate(readings)
        np.testing.assert_allclose(
            found.asynchronous, errors["asynchronous"], rtol=0.0, atol=1e3 * SAME
        )
        np.testing.assert_allclose(
            self.method().correct(readings), self.readings(truth, {}), rtol=0.0, atol=1e3 * SAME
        )

    @pytest.mark.slow
    def test_noise_is_found_from_redundancy(self):
        super().test_noise_is_found_from_redundancy()


class TestAxial(TestRadial):
    """Once per revolution is real and kept."""

    direction = "axial"
    setting_orders, motion_orders = (0,), (1, 2, 7)


def test_uncertainties_are_the_scatter_of_many_trials_of_a_few_angles():
    rng, m, n, sd = np.random.default_rng(2), 4, 12, 2e-9
    draws = [SpindleSplit().separate(sd * rng.standard_normal((m, n)), u_reading=sd)
             for _ in range(60)]  # fmt: skip
    for name in ("setting", "synchronous", "asynchronous"):
        scatter = np.sqrt(np.mean([d.parts[name] ** 2 for d in draws]))
        assert scatter == pytest.approx(np.sqrt(np.mean(draws[0].u[name] ** 2)), rel=0.1, abs=0.0)


def test_harmonics_of_the_synchronous_motion_refer_to_angle_zero():
    curve = 30e-9 * np.cos(4 * ANGLE - 0.7)
    found = SpindleSplit("radial", START).separate(np.tile(curve, (3, 1)))
    c = found.harmonics["synchronous"]
    assert np.isnan(c[:2]).all()
    assert abs(c[4] - 30e-9 * np.exp(-0.7j)) < 1e-20
    assert found.suppressed == [0, 1]


def test_the_class_gives_what_the_function_gives_and_names_revolutions_left_out():
    rng = np.random.default_rng(7)
    readings = 3e-6 * np.cos(ANGLE) + 2e-8 * rng.standard_normal((M, N))
    readings[3, 10] = np.nan
    found = SpindleSplit("radial", START).separate(readings)
    same = iso230_7(readings, ANGLE)
    np.testing.assert_array_equal(found.synchronous, same.synchronous_motion)
    assert np.isnan(found.asynchronous[3]).all()
    assert np.isfinite(np.delete(found.asynchronous, 3, axis=0)).all()
    assert found.audit["revolutions_used"] == M - 1
    assert found.audit["synchronous_nm"] == pytest.approx(1e9 * same.synchronous.value, abs=1e-9)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SpindleSplit("tilt"), "direction"),
        (lambda: SpindleSplit(start=np.nan), "start"),
        (lambda: SpindleSplit().separate(np.zeros((2, 3, 16))), "revolutions"),
        (lambda: SpindleSplit().separate(np.zeros((4, 16)), u_reading=-1e-9), "u_reading"),
        (lambda: SpindleSplit().simulate({}, {"asynchronous": np.zeros(16)}), "shape"),
        (
            lambda: SpindleSplit().simulate(
                {"setting": np.zeros(15)}, {"asynchronous": np.zeros((2, 16))}
            ),
            "setting",
        ),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
