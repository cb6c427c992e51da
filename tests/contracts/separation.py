"""The suite that every separation method inherits.

A test class derives from `SeparationContract` and says how its set-up is built and how parts make
readings: in its own words, without library code. The suite then asks what any separation owes:
truth comes back, the null space is named and never filled, the uncertainty is that of the scatter.

    class TestDonaldson(SeparationContract):
        def method(self): return Donaldson()
        def truth(self, rng): return {"artefact": ...}      # inside what the method can see
        def errors(self, rng): return {"spindle": ...}
        def readings(self, truth, errors): return np.stack([...])
        def invisible(self, rng): yield ("artefact", {...truth...}, {...errors...})
"""

import math

import numpy as np
import pytest

from metrosep.core.errors import MetrosepError
from metrosep.separation.contract import Separation

EXACT = 1e-9
"""Relative error of a noise-free separation: rounding times the condition of the methods."""

U_RTOL = 0.1
"""RMS of u against the scatter of TRIALS trials over many samples: 1/sqrt(2 * 100 * 10) is 2.2 %."""

TRIALS = 100

MAP_TRIALS = 50
"""Maps have hundreds of pixels and more, whose scatters are averaged: 50 trials know it to 1 %."""


class SeparationContract:
    """What is asked of every method; derived classes give the set-up and an independent simulator."""

    sd = 2e-9
    """Standard deviation of one reading in the trials."""

    has_redundancy = False
    """Whether the method finds the noise of a reading from its own readings."""

    takes_repeats = True
    """Whether readings may be (n_readings, n_repeats, n_samples)."""

    exact = EXACT

    trials = None
    """How many; methods whose parts are single numbers need 500 (their scatter is known to 3 %)."""

    def method(self):
        raise NotImplementedError

    def truth(self, rng):
        """Return parts of the artefact that the method can see."""
        raise NotImplementedError

    def errors(self, rng):
        """Return parts of the machine that the method can see."""
        raise NotImplementedError

    def readings(self, truth, errors):
        """Return readings, written without library code; parts that are missing are zero."""
        raise NotImplementedError

    def invisible(self, rng):
        """Yield changes of (truth, errors) that leave all readings as they are."""
        return iter(())

    # --- what follows holds for every method ---

    def draw(self, seed):
        rng = np.random.default_rng(seed)
        truth, errors = self.truth(rng), self.errors(rng)
        return rng, truth, errors, self.readings(truth, errors)

    @pytest.mark.parametrize("seed", [0, 1, 2])
    def test_truth_comes_back(self, seed):
        _, truth, errors, readings = self.draw(seed)

        result = self.method().separate(readings)

        for name, expected in {**truth, **errors}.items():
            found = result.parts[name]
            assert found.shape == np.shape(expected), name
            known = np.isfinite(found)
            assert known.mean() > 0.5, name
            scale = np.max(np.abs(expected))
            np.testing.assert_allclose(
                found[known], np.asarray(expected)[known], rtol=0.0, atol=self.exact * scale
            )

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        _, truth, errors, readings = self.draw(seed)

        simulated = self.method().simulate(truth, errors)

        both = np.isfinite(simulated) & np.isfinite(readings)
        assert both.mean() > 0.5
        np.testing.assert_allclose(
            simulated[both], readings[both], rtol=0.0, atol=EXACT * np.nanmax(np.abs(readings))
        )

    def test_corrected_readings_are_those_of_a_perfect_machine(self):
        _, truth, _, readings = self.draw(5)

        corrected = self.method().correct(readings)

        expected = self.readings(truth, {})
        both = np.isfinite(corrected) & np.isfinite(expected)
        assert both.mean() > 0.5
        np.testing.assert_allclose(
            corrected[both],
            expected[both],
            rtol=0.0,
            atol=3 * self.exact * np.nanmax(np.abs(readings)),
        )

    def test_repeats_are_corrected_one_by_one(self):
        """As many repeats as readings, and another number: an axis that is mixed up shows."""
        _, truth, _, readings = self.draw(5)
        if readings.ndim != 2 or not self.takes_repeats:
            pytest.skip("the readings are maps, or the method takes no repeats")
        expected = self.readings(truth, {})[:, None]
        for n_repeats in (len(readings), len(readings) + 1):
            corrected = self.method().correct(np.repeat(readings[:, None], n_repeats, axis=1))
            assert corrected.shape == (len(readings), n_repeats, readings.shape[1])
            known = np.isfinite(corrected)
            np.testing.assert_allclose(
                corrected[known],
                np.broadcast_to(expected, corrected.shape)[known],
                rtol=0.0,
                atol=3 * self.exact * np.nanmax(np.abs(readings)),
            )

    def test_every_sign_turns_with_its_part(self):
        _, truth, errors, readings = self.draw(6)

        plus, minus = self.method().separate(readings), self.method().separate(-readings)

        for name in (*truth, *errors):
            np.testing.assert_allclose(
                plus.parts[name],
                -minus.parts[name],
                rtol=0.0,
                atol=self.exact * np.nanmax(np.abs(readings)),
            )

    def test_readings_are_linear_in_metres(self):
        """A unit slip would show: micrometres and metres give the same picture."""
        _, truth, errors, readings = self.draw(7)

        big, small = (self.method().separate(scale * readings) for scale in (1.0, 1e-6))

        for name in (*truth, *errors):
            np.testing.assert_allclose(
                small.parts[name] * 1e6,
                big.parts[name],
                rtol=1e-7,
                atol=self.exact * np.nanmax(np.abs(readings)),
            )

    def test_null_space_changes_no_part_that_is_given(self):
        rng, _, _, readings = self.draw(8)
        plain = self.method().separate(readings)
        for extra_truth, extra_errors in self.invisible(rng):
            hidden = self.readings(extra_truth, extra_errors)
            size = max(np.max(np.abs(v)) for v in (*extra_truth.values(), *extra_errors.values()))
            np.testing.assert_allclose(
                hidden, 0.0, rtol=0.0, atol=1e-9 * size, err_msg="not invisible"
            )

            seen = self.method().separate(readings + hidden)

            for name, values in plain.parts.items():
                np.testing.assert_allclose(
                    seen.parts[name], values, rtol=0.0, atol=1e-6 * np.nanmax(np.abs(readings))
                )
            parts = {*extra_truth, *extra_errors}
            assert any(item.part in parts for item in plain.null_space), parts

    def test_null_space_is_said_with_its_reason(self):
        *_, readings = self.draw(9)
        result = self.method().separate(readings)

        assert tuple(self.method().null_space()) == tuple(result.null_space)
        for item in result.null_space:
            assert len(item.reason) > 10
            assert item.indices
            assert item.part in (*self.method().truth_parts, *self.method().error_parts)

    def test_stated_noise_becomes_the_scatter(self):
        if self.has_redundancy:
            pytest.skip("the noise is found from the readings")
        self.check_scatter(lambda r: self.method().separate(r, u_reading=self.sd))

    @pytest.mark.slow
    def test_noise_is_found_from_redundancy(self):
        if not self.has_redundancy:
            pytest.skip("the method has no redundancy")
        found = self.check_scatter(lambda r: self.method().separate(r))
        assert found == pytest.approx(self.sd, rel=U_RTOL, abs=0.0)

    def check_scatter(self, separate):
        rng, truth, errors, readings = self.draw(10)
        trials = self.trials or (TRIALS if readings.ndim == 2 else MAP_TRIALS)
        results = [
            separate(readings + self.sd * rng.standard_normal(readings.shape))
            for _ in range(trials)
        ]
        for name in (*truth, *errors):
            scatter = np.nanstd([r.parts[name] for r in results], axis=0, ddof=1)
            stated = np.sqrt(np.mean([r.u[name] ** 2 for r in results], axis=0))
            known = np.isfinite(scatter) & np.isfinite(stated)
            assert known.any(), name
            ratio = math.sqrt(float(np.mean(stated[known] ** 2) / np.mean(scatter[known] ** 2)))
            assert ratio == pytest.approx(1.0, abs=U_RTOL), name
        return math.sqrt(float(np.mean([r.noise.value**2 for r in results])))

    def test_unknown_noise_is_said_not_zero(self):
        if self.has_redundancy:
            pytest.skip("the noise is found from the readings")
        _, truth, _, readings = self.draw(11)
        result = self.method().separate(readings)

        assert math.isnan(result.noise.value)
        for name in truth:
            assert np.isnan(result.u[name]).all()
        assert any("u_reading" in m or "repeat" in m for m in result.messages)

    def test_result_survives_json_and_copies(self):
        import copy
        import json

        *_, readings = self.draw(12)
        result = self.method().separate(readings, u_reading=self.sd)

        for again in (
            Separation.from_dict(json.loads(json.dumps(result.to_dict(), allow_nan=False))),
            copy.deepcopy(result),
        ):
            for name, values in result.parts.items():
                np.testing.assert_array_equal(again.parts[name], values)
                np.testing.assert_array_equal(again.u[name], result.u[name])
            assert again.null_space == result.null_space
            assert again.audit == result.audit
        assert result.method in repr(result)
        assert "<table" in result._repr_html_()

    def test_readings_are_not_changed(self):
        *_, readings = self.draw(13)
        before = readings.copy()

        self.method().separate(readings)
        self.method().correct(readings)

        np.testing.assert_array_equal(readings, before)

    @pytest.mark.parametrize("bad", ["empty", "one", "flat", "inf", "text", "nothing measured"])
    def test_useless_readings_are_refused_in_words(self, bad):
        *_, readings = self.draw(14)
        given = {
            "empty": np.empty((readings.shape[0], 0)),
            "one": readings[:1],
            "flat": readings.ravel(),
            "inf": np.where(
                np.arange(readings.size).reshape(readings.shape) == 3, np.inf, readings
            ),
            "text": [["a", "b"], ["c", "d"]],
            "nothing measured": np.full(readings.shape, np.nan),
        }[bad]

        with pytest.raises(MetrosepError) as caught:
            self.method().separate(given)

        assert 20 < len(str(caught.value)) < 400

    def test_unknown_parts_are_refused(self):
        _, truth, errors, _ = self.draw(15)

        with pytest.raises(MetrosepError, match="no_such_part"):
            self.method().simulate({**truth, "no_such_part": [1.0]}, errors)
        with pytest.raises(MetrosepError):
            self.method().simulate({}, {})
