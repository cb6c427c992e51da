"""Values of spindle tests against speed, under the contract."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.circles.speed_sweep import SpeedGrowth, fit_speed_sweep

NM = 1e-9
N = 12
"""Values (columns) that are fitted."""

SAME = 1e-20
"""m; the class and the function do the same sums."""

SPEEDS = (50.0, 10.0, 20.0, 35.0, 20.0, 65.0, 80.0, 5.0, 95.0)
"""Out of order, with a repeat."""


class TestConstantAndUnbalance(SeparationContract):
    has_redundancy = True
    takes_repeats = False
    powers = (0, 2)

    def method(self):
        return SpeedGrowth(SPEEDS, self.powers)

    def truth(self, rng):
        return {"at_rest": 20 * NM + 10 * NM * rng.standard_normal(N)}

    def errors(self, rng):
        out = np.zeros((len(SPEEDS), N))
        for power in self.powers:
            if power > 0:
                c = 30 * NM * rng.standard_normal(N)
                for i, n in enumerate(SPEEDS):
                    out[i] += c * (n / 100.0) ** power
        return {"growth": out}

    def readings(self, truth, errors):
        out = np.zeros((len(SPEEDS), N))
        for i in range(len(SPEEDS)):
            for k in range(N):
                out[i, k] = truth.get("at_rest", np.zeros(N))[k]
                out[i, k] += errors.get("growth", np.zeros((len(SPEEDS), N)))[i][k]
        return out

    def invisible(self, rng):
        level = 5 * NM * rng.standard_normal(N)
        yield {"at_rest": -level}, {"growth": np.tile(level, (len(SPEEDS), 1))}


class TestThreePowers(TestConstantAndUnbalance):
    powers = (2, 0, 1)


class TestNothingAtRest(TestConstantAndUnbalance):
    """Without the power 0 what stays at rest is not looked for: NaN, not zero."""

    powers = (1, 2)

    def truth(self, rng):
        return {}

    def invisible(self, rng):
        return iter(())

    def test_what_stays_at_rest_is_not_invented(self):
        *_, readings = self.draw(20)
        found = self.method().separate(readings)
        assert np.isnan(found.at_rest).all()
        assert np.isnan(found.u["at_rest"]).all()
        assert any(i.part == "at_rest" and "all of it" in i.indices for i in found.null_space)


def test_fit_is_that_of_the_function_and_of_the_textbook():
    """Two speeds twice: the line through the two means; u by hand."""
    readings = np.array([[11.0], [9.0], [32.0], [28.0]]) * NM
    found = SpeedGrowth((10.0, 10.0, 20.0, 20.0), (0, 1)).separate(readings)
    assert float(found.at_rest[0]) == pytest.approx(-10 * NM, abs=SAME)
    assert found.growth[:, 0] == pytest.approx([20 * NM, 20 * NM, 40 * NM, 40 * NM], abs=SAME)
    s = np.sqrt((1 + 1 + 4 + 4) / 2) * NM
    assert found.noise.value == pytest.approx(s, abs=SAME)
    # sxx = 4 * 25; slope u = s / 10; at zero s * sqrt(1/4 + 15^2 / 100)
    assert found.u["growth"][0, 0] == pytest.approx(10 * s / 10, abs=SAME)
    assert found.u["at_rest"][0] == pytest.approx(s * np.sqrt(0.25 + 2.25), abs=SAME)
    same = fit_speed_sweep((10.0, 10.0, 20.0, 20.0), {"s": readings[:, 0]}, powers=(0, 1))["s"]
    assert found.audit["c1_m_s1"][0] == pytest.approx(same.coefficients[1], abs=SAME)


def test_gaps_are_neither_filled_nor_used():
    rng = np.random.default_rng(3)
    readings = 20 * NM + NM * rng.standard_normal((len(SPEEDS), 3))
    readings[5, 1] = np.nan
    readings[2:, 2] = np.nan
    found = SpeedGrowth(SPEEDS).separate(readings)
    less = SpeedGrowth(SPEEDS[:5] + SPEEDS[6:]).separate(np.delete(readings, 5, axis=0)[:, :2])
    np.testing.assert_allclose(found.at_rest[1], less.at_rest[1], rtol=0.0, atol=SAME)
    assert np.isnan(found.growth[5, 1])
    assert np.isnan(found.u["growth"][5, 1])
    assert np.isnan(found.at_rest[2])
    assert np.isnan(found.growth[:, 2]).all()
    assert any("value 2" in m and "NaN" in m for m in found.messages)


def test_stated_uncertainty_is_widened_never_narrowed():
    law = np.array([[20 * NM + 3e-12 * n**2] for n in SPEEDS])
    method = SpeedGrowth(SPEEDS)
    squares = np.array(SPEEDS) ** 2
    sxx = ((squares - squares.mean()) ** 2).sum()
    quiet = method.separate(law, u_reading=2 * NM)
    assert quiet.u["growth"][0, 0] == pytest.approx(
        2 * NM * SPEEDS[0] ** 2 / np.sqrt(sxx), abs=1e-18
    )
    law[6] += 100 * NM
    loud = method.separate(law, u_reading=2 * NM)
    assert loud.u["growth"][0, 0] > 3 * quiet.u["growth"][0, 0]
    assert any("does not describe value 0" in m for m in loud.messages)
    assert any("stands out at 80 rev/s" in m for m in loud.messages)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SpeedGrowth((10.0, 20.0)), "at least 3"),
        (lambda: SpeedGrowth((1200.0, 2400.0, 3600.0)), "divide rev/min by 60"),
        (lambda: SpeedGrowth((10.0, 10.0, 10.0)), "different speeds"),
        (lambda: SpeedGrowth((10.0, np.nan, 20.0)), "finite"),
        (lambda: SpeedGrowth(SPEEDS, (0, 0)), "twice"),
        (lambda: SpeedGrowth(SPEEDS, unit="nm"), "unit"),
        (lambda: SpeedGrowth(SPEEDS).separate(np.zeros((4, 2))), "9 speeds"),
        (lambda: SpeedGrowth(SPEEDS).separate(np.zeros((9, 2)), u_reading=-1.0), "u_reading"),
        (
            lambda: SpeedGrowth(SPEEDS).simulate({"at_rest": [1.0]}, {"growth": np.zeros((9, 2))}),
            "must have the shape",
        ),
        (lambda: SpeedGrowth(SPEEDS).simulate({}, {"growth": 1.0}), r"shape \(9,\)"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
