"""Heights from slopes under the contract: a sledge on two feet, and a beam on a cubic."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.lines.slope_integration import SlopeIntegration, integrate_slopes

N, STEP = 30, 20e-3
X = 0.05 + STEP * np.arange(N)
SAME = 1e-20
"""m; the class and the function do the same sums."""


class TestFeet(SeparationContract):
    takes_repeats = False
    rule, zero_known, n_passes = "feet", False, 1
    at = 0.05 + STEP * np.arange(N + 1)

    def method(self):
        return SlopeIntegration(tuple(X.tolist()), self.rule, self.zero_known)

    def free(self, z):
        degree = 0 if self.zero_known else 1
        middle = self.at - self.at.mean()
        return z - np.polyval(np.polyfit(middle, z, degree), middle)

    def truth(self, rng):
        return {"height": self.free(1e-6 * np.cumsum(rng.standard_normal(N + 1)))}

    def errors(self, rng):
        return {}

    def slope(self, height, i):
        return (height[i + 1] - height[i]) / STEP

    def readings(self, truth, errors):
        height = truth.get("height", np.zeros(self.at.size))
        zeros = np.broadcast_to(errors.get("zero", 0.0), self.n_passes)
        return np.array([[self.slope(height, i) + z for i in range(N)] for z in zeros])

    def invisible(self, rng):
        a, b = 1e-6 * rng.standard_normal(2)
        yield {"height": np.full(self.at.size, a)}, {}
        if not self.zero_known:
            yield {"height": b * self.at}, {"zero": -b}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """The method gives one pass; the zero is part of it."""
        _, truth, _, _ = self.draw(seed)
        simulated = self.method().simulate(truth, {"zero": 3e-6})
        expected = self.readings(truth, {"zero": 3e-6})[:1]
        np.testing.assert_allclose(simulated, expected, rtol=0.0, atol=1e-12 * np.ptp(expected))

    @pytest.mark.parametrize("bad", ["empty", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        """One pass alone may be used."""
        super().test_useless_readings_are_refused_in_words(bad)

    def test_the_zero_is_not_invented_and_corrected_slopes_keep_it(self):
        _, truth, _, _ = self.draw(20)
        readings = self.readings(truth, {"zero": 5e-6})
        assert np.isnan(self.method().separate(readings).zero)
        np.testing.assert_array_equal(self.method().correct(readings), readings)


class TestFeetWithKnownZero(TestFeet):
    zero_known = True


class TestFeetInPasses(TestFeet):
    has_redundancy = True
    n_passes = 4


class TestSpline(TestFeet):
    """Of a cubic the spline is exact, and so is the integral of its slope, a parabola."""

    rule = "spline"
    at = X

    def truth(self, rng):
        u = (X - X.mean()) / np.ptp(X)
        self.c = 1e-5 * rng.standard_normal(2)
        return {"height": self.free(self.c[0] * u**2 + self.c[1] * u**3)}

    def slope(self, height, i):
        """Differentiate the cubic through four of the heights (Lagrange)."""
        j = min(max(i - 1, 0), N - 4)
        return np.polyval(np.polyder(np.polyfit(X[j : j + 4] - X[i], height[j : j + 4], 3)), 0.0)


class TestSplineKnownZero(TestSpline):
    zero_known = True


def test_the_class_gives_what_the_function_gives_with_gaps():
    rng = np.random.default_rng(3)
    slopes = 1e-6 * rng.standard_normal((3, N))
    slopes[1, 8] = np.nan
    for rule in ("trapezoid", "spline", "feet", "simpson", "fourier"):
        found = SlopeIntegration(tuple(X.tolist()), rule).separate(slopes)
        same = integrate_slopes(slopes, X, method=rule)
        np.testing.assert_allclose(found.height, same.height, rtol=0.0, atol=SAME)
        np.testing.assert_allclose(found.u["height"], same.u["height"], rtol=0.0, atol=SAME)
        assert [i for i in found.null_space if i.kind == "samples"] == [
            i for i in same.null_space if i.kind == "samples"
        ]


@pytest.mark.parametrize(("known", "degrees"), [(False, (0, 1)), (True, (0,))])
def test_the_line_is_unseen_unless_the_zero_is_known(known, degrees):
    method = SlopeIntegration(tuple(X.tolist()), zero_known=known)
    (item,) = (i for i in method.null_space() if i.part == "height")
    assert item.indices == degrees
    found = method.separate(np.full((1, N), 1e-6))
    expected = 1e-6 * (X - X.mean()) if known else np.zeros(N)
    np.testing.assert_allclose(found.height, expected, rtol=0.0, atol=1e-18)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: SlopeIntegration((0.0, 0.2, 0.1, 0.3)), "rising"),
        (lambda: SlopeIntegration((0.0, 0.1, 0.2)), "4"),
        (lambda: SlopeIntegration(tuple(X.tolist()), "rectangle"), "rectangle"),
        (lambda: SlopeIntegration(tuple(X.tolist())).separate(np.zeros((2, 5))), "30 positions"),
        (lambda: SlopeIntegration(tuple(X.tolist())).separate(np.ones((2, N))), "rad"),
        (lambda: SlopeIntegration(tuple(X.tolist())).simulate({"height": [0.0]}, {}), "30 finite"),
        (lambda: SlopeIntegration(tuple(X.tolist())).simulate({}, {"zero": [0.0]}), "one number"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
