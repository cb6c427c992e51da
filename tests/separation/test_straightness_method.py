"""Straightness from a reference line under the contract."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.lines.iso230_straightness import ReferenceLine, straightness_iso230_1

N = 41
X = np.linspace(0.02, 0.42, N) + np.resize([0.0, 1e-3], N)

SAME = 1e-18
"""m; one sum more or less."""


class TestLeastSquares(SeparationContract):
    takes_repeats = False
    has_redundancy = True
    line = "LS"
    n_runs = 4

    def method(self):
        return ReferenceLine(tuple(X.tolist()), self.line)

    def freed(self, z):
        if self.line == "EP":
            return z - (z[0] + (z[-1] - z[0]) * (X - X[0]) / (X[-1] - X[0]))
        return z - np.polyval(np.polyfit(X - X.mean(), z, 1), X - X.mean())

    def truth(self, rng):
        return {}

    def errors(self, rng):
        return {"straightness": self.freed(1e-7 * np.cumsum(rng.standard_normal(N)))}

    def readings(self, truth, errors):
        """``line`` (runs, 2): offset and slope of the reference in each run."""
        lines = np.broadcast_to(truth.get("line", np.zeros((1, 2))), (self.n_runs, 2))
        out = np.zeros((self.n_runs, N))
        for run in range(self.n_runs):
            for i in range(N):
                out[run, i] = lines[run, 0] + lines[run, 1] * X[i]
                out[run, i] += errors.get("straightness", np.zeros(N))[i]
                out[run, i] += truth.get("reference", np.zeros(N))[i]
        return out

    def invisible(self, rng):
        a, b = 1e-6 * rng.standard_normal(2)
        yield {"line": np.array([[-a, -b]])}, {"straightness": a + b * X}
        bent = self.freed(1e-7 * rng.standard_normal(N))
        yield {"reference": bent}, {"straightness": -bent}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """The method gives one run."""
        rng, _, errors, _ = self.draw(seed)
        truth = {"reference": 1e-8 * rng.standard_normal(N)}
        np.testing.assert_allclose(
            self.method().simulate(truth, errors),
            self.readings(truth, errors)[:1],
            rtol=0.0,
            atol=1e-20,
        )

    @pytest.mark.parametrize("bad", ["empty", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        """One run alone may be used."""
        super().test_useless_readings_are_refused_in_words(bad)

    def test_each_run_may_lie_otherwise_and_keeps_its_line(self):
        rng, _, errors, _ = self.draw(20)
        truth = {"line": 1e-5 * rng.standard_normal((self.n_runs, 2))}
        readings = self.readings(truth, errors)
        found = self.method().separate(readings)
        np.testing.assert_allclose(found.straightness, errors["straightness"], rtol=0, atol=1e-18)
        left = self.method().correct(readings)
        np.testing.assert_allclose(left, self.readings(truth, {}), rtol=0.0, atol=1e-18)
        assert np.isnan(found.reference).all()
        if self.has_redundancy:
            assert found.noise.value < 1e-18


class TestEndPoints(TestLeastSquares):
    line = "EP"


class TestOneRun(TestLeastSquares):
    has_redundancy = False
    n_runs = 1


class TestOneRunFromEndPoints(TestOneRun):
    line = "EP"


@pytest.mark.parametrize("line", ["LS", "EP"])
def test_values_are_those_of_the_standard_with_gaps(line):
    rng = np.random.default_rng(6)
    runs = 1e-6 * rng.standard_normal((3, N)) + 1e-4 * X
    runs[:, [0, 17]] = np.nan
    found = ReferenceLine(tuple(X.tolist()), line).separate(runs, u_reading=1e-9)
    assert np.isnan(found.straightness[[0, 17]]).all()
    mean = runs.mean(axis=0)
    plain = straightness_iso230_1(X, mean, reference=line)
    np.testing.assert_allclose(found.straightness, plain.residual, rtol=0.0, atol=SAME)
    for key in ("MZ", "LS", "EP"):
        assert found.audit[f"STR_{key}_um"] == pytest.approx(
            plain.values[key].value * 1e6, abs=1e-9
        )
    if line == "EP":
        assert found.u["straightness"][[1, -1]].tolist() == [0.0, 0.0]


def test_uncertainty_from_end_points_is_that_of_three_readings():
    found = ReferenceLine((0.0, 0.1, 0.2, 0.3, 0.4), "EP").separate(
        np.zeros((1, 5)), u_reading=1e-9
    )
    expected = [0.0, np.sqrt(1 + 1 / 16 + 9 / 16), np.sqrt(1.5), np.sqrt(1 + 1 / 16 + 9 / 16), 0.0]
    np.testing.assert_allclose(found.u["straightness"], np.array(expected) * 1e-9, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ReferenceLine((0.0, 0.2, 0.1, 0.3)), "rising"),
        (lambda: ReferenceLine((0.0, 0.2, 0.3)), "4"),
        (lambda: ReferenceLine(tuple(X.tolist()), "MZ"), "line"),
        (lambda: ReferenceLine(tuple(X.tolist())).separate(np.zeros((2, 5))), "41 positions"),
        (lambda: ReferenceLine(tuple(X.tolist())).simulate({}, {"straightness": [0.0]}), "shape"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
