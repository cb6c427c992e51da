"""Mean deviations of positioning runs under the contract."""

import numpy as np
import pytest
from contracts.separation import SeparationContract

from metrosep.core.errors import MetrosepError
from metrosep.separation.positions.positioning import PositioningSheet, iso230_2

N, M = 11, 5
TARGETS = np.linspace(0.0, 0.5, N) + np.resize([0.0, 1e-3, -2e-3], N)

UM = 1e-6
SAME = 1e-15
"""m; positions of half a metre in double precision."""


class TestBothDirections(SeparationContract):
    has_redundancy = True
    takes_repeats = False
    directions = ("forward", "backward")

    def method(self):
        return PositioningSheet(tuple(TARGETS.tolist()), self.directions)

    def truth(self, rng):
        return {}

    def errors(self, rng):
        return {way: 3 * UM * rng.standard_normal(N) for way in self.directions}

    def readings(self, truth, errors):
        """Runs up and down in turn, as at the machine; the instrument adds its own error."""
        out = np.zeros((len(self.directions), M, N))
        for run in range(M):
            for k, way in enumerate(self.directions):
                for i in range(N):
                    deviation = errors.get(way, np.zeros(N))[i]
                    out[k, run, i] = deviation + truth.get("reference", np.zeros(N))[i]
        return out

    def invisible(self, rng):
        wrong = 2 * UM * rng.standard_normal(N)
        yield {"reference": wrong}, dict.fromkeys(self.directions, -wrong)

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        """One run of each direction; every run is that."""
        _, truth, errors, readings = self.draw(seed)
        truth = {"reference": 1e-7 * np.arange(N)}
        simulated = self.method().simulate(truth, errors)
        np.testing.assert_allclose(
            simulated[:, None] - self.readings(truth, errors), 0.0, rtol=0.0, atol=1e-20
        )
        assert simulated.shape == readings[:, 0].shape

    def test_the_reference_is_not_invented(self):
        *_, readings = self.draw(20)
        result = self.method().separate(readings)
        assert np.isnan(result.reference).all()
        assert any(item.part == "reference" for item in result.null_space)

    def test_runs_are_corrected_one_by_one(self):
        rng, _, errors, readings = self.draw(22)
        own = UM * rng.standard_normal(readings.shape)
        own = own - own.mean(axis=1, keepdims=True)
        left = self.method().correct(readings + own)
        np.testing.assert_allclose(left, own, rtol=0.0, atol=1e-18)
        assert errors


class TestOneDirection(TestBothDirections):
    directions = ("backward",)

    @pytest.mark.parametrize("bad", ["empty", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        """One direction is all there is."""
        super().test_useless_readings_are_refused_in_words(bad)


def test_means_and_values_are_those_of_the_sheet_with_gaps():
    rng = np.random.default_rng(3)
    deviations = 2 * UM * rng.standard_normal((2, M, N))
    deviations[0, :4, 3] = np.nan
    deviations[1, 0, 6] = np.nan
    found = PositioningSheet(tuple(TARGETS.tolist())).separate(deviations)
    up, down = ((TARGETS + d).T for d in deviations)
    sheet = iso230_2(TARGETS, up, down)
    np.testing.assert_allclose(found.forward, sheet.mean_forward, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(found.backward, sheet.mean_backward, rtol=0.0, atol=SAME)
    assert np.isnan(found.forward[3])
    for key in ("A", "E", "R", "B", "M"):
        assert found.audit[f"{key}_um"] == pytest.approx(sheet[key].value * 1e6, abs=1e-9)
    np.testing.assert_allclose(
        found.u["backward"][1], sheet.sd_backward[1] / np.sqrt(M), rtol=0.0, atol=SAME
    )
    assert found.u["backward"][6] == pytest.approx(sheet.sd_backward[6] / 2, abs=SAME)


def test_a_stated_uncertainty_replaces_the_scatter():
    method = PositioningSheet((0.0, 0.1, 0.2), ("forward",))
    found = method.separate(np.zeros((1, 4, 3)), u_reading=0.5 * UM)
    np.testing.assert_allclose(found.u["forward"], 0.25 * UM, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: PositioningSheet((0.1, 0.0)), "rising"),
        (lambda: PositioningSheet((0.0,)), "targets"),
        (lambda: PositioningSheet((0.0, 0.1), ("forward", "forward")), "each once"),
        (lambda: PositioningSheet((0.0, 0.1), unit="mm"), "unit"),
        (lambda: PositioningSheet((0.0, 0.1)).separate(np.zeros((2, 3, 4))), "2 targets"),
        (lambda: PositioningSheet((0.0, 0.1)).separate(np.zeros((2, 2))), "one run"),
        (
            lambda: PositioningSheet((0.0, 0.1), ("forward",)).simulate(
                {}, {"backward": np.zeros(2)}
            ),
            "not measured",
        ),
        (
            lambda: PositioningSheet((0.0, 0.1)).separate(np.zeros((2, 3, 2)), u_reading="a"),
            "u_reading",
        ),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()
