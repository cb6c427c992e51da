"""Drive table: the paper's polynomial, every limit with its value, the sign."""

from __future__ import annotations

import json

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.recording import Recording
from metrosep.process.drive import drive_table, stage_displacement
from metrosep.process.flexure import flexure_calibration

UM, NM, MM = 1e-6, 1e-9, 1e-3
SENSITIVITY = 1.66 * UM
X = np.linspace(0.0, 40.0, 4001) * MM


def y(x, s1=1, s2=-1):
    """Eq. 1 of the dual-servo paper in m, its lost signs as arguments."""
    mm = x / MM
    return (0.3389 + s1 * 0.48246 * mm + s2 * 0.00605 * mm**2) * UM


@pytest.fixture(scope="module")
def calibration():
    v = np.concatenate([np.linspace(0, 10, 21), np.linspace(10, 0, 21)])
    return flexure_calibration(
        Recording(np.arange(42), {"voltage": v, "displacement": SENSITIVITY * v})
    )


class TestRow27:
    """papers.md section 5, row 27 and the table of section 2."""

    def test_plus_minus_fits(self, calibration):
        for c in (SENSITIVITY, calibration):
            table = drive_table(X, y(X), quantity="compensation", calibration=c)
            assert table.is_ok
            assert table.audit["voltage_min_V"] == pytest.approx(0.2042, abs=1e-3)
            assert table.audit["voltage_max_V"] == pytest.approx(5.998, abs=1e-3)
            assert table.audit["stroke_um"] == pytest.approx(9.6185, abs=1e-3)

    def test_minus_plus_is_flagged(self):
        table = drive_table(
            X, y(X, -1, 1), quantity="compensation", calibration=SENSITIVITY, strict=False
        )
        assert not table.is_ok
        assert table.audit["voltage_min_V"] == pytest.approx(-5.59, abs=5e-3)
        assert "negative voltage -5.5" in table.violations[0]
        with pytest.raises(LimitError, match="negative voltage"):
            drive_table(X, y(X, -1, 1), quantity="compensation", calibration=SENSITIVITY)

    def test_minus_plus_with_its_offset(self):
        table = drive_table(
            X, y(X, -1, 1), quantity="compensation", calibration=SENSITIVITY, offset=9.28 * UM
        )
        assert table.is_ok

    def test_both_plus_is_excluded(self):
        with pytest.raises(LimitError, match=r"17\.6"):
            drive_table(X, y(X, 1, 1), quantity="compensation", calibration=SENSITIVITY)


class TestRow35:
    """papers.md section 5, row 35: d_off = 2 um, travel 5 um: -3 ... 2 um admissible."""

    def test_admissible(self):
        d = stage_displacement(
            [-3 * UM, 0, 2 * UM], quantity="error", offset=2 * UM, travel=5 * UM
        )
        assert d == pytest.approx([5 * UM, 2 * UM, 0.0], abs=1e-18)

    @pytest.mark.parametrize("e", [2.1, -3.1])
    def test_refused(self, e):
        with pytest.raises(LimitError, match=rf"error {e} um.*-3 \.\.\. 2 um is admissible"):
            stage_displacement([0, e * UM], quantity="error", offset=2 * UM, travel=5 * UM)


def test_sign_is_stated():
    """An error of +1 um (material left high) moves the stage back; the sum is then zero."""
    e = np.array([0.0, 1 * UM, -2 * UM])
    as_error = stage_displacement(e, quantity="error", offset=3 * UM)
    as_compensation = stage_displacement(-e, quantity="compensation", offset=3 * UM)
    assert (as_error == as_compensation).all()
    assert as_error - 3 * UM + e == pytest.approx(0.0, abs=1e-20)
    wrong = stage_displacement(e, quantity="compensation", offset=3 * UM)
    assert np.abs(wrong - 3 * UM + e).max() == pytest.approx(4 * UM, abs=1e-18)
    with pytest.raises(DataError, match="the sign follows"):
        stage_displacement(e, quantity="auto")


class TestSlewAndDac:
    def test_slew(self):
        """0.48246 um/mm at 1 mm/s over 1.66 um/V: 0.29058 V/s at the start."""
        table = drive_table(
            X, y(X), quantity="compensation", calibration=SENSITIVITY, speed=1 * MM, slew=0.3
        )
        assert table.audit["largest_slew_V_per_s"] == pytest.approx(0.29058, abs=1e-4)
        with pytest.raises(LimitError, match=r"0\.29.* V/s at x = 0"):
            drive_table(
                X, y(X), quantity="compensation", calibration=SENSITIVITY, speed=1 * MM, slew=0.2
            )

    @pytest.mark.parametrize("bits", [12, 16])
    def test_quantisation(self, calibration, bits):
        step = 10.0 / (2**bits - 1)
        table = drive_table(X, y(X), quantity="compensation", calibration=calibration, bits=bits)
        n = table.voltage / step
        assert np.abs(n - np.rint(n)).max() < 1e-6
        assert np.abs(table.residual).max() <= 0.5 * step * SENSITIVITY * (1 + 1e-6)
        rms = np.sqrt(np.mean(table.residual**2))
        assert rms == pytest.approx(step * SENSITIVITY / np.sqrt(12), abs=0.1 * rms)

    def test_the_steps_of_the_dac_keep_the_slew_rate_too(self):
        """1 um in 1 ms over 1.66 um/V: 602.4 V/s wanted; 4 bits send one step of 0.667 V: 667."""
        given = {"quantity": "compensation", "calibration": SENSITIVITY, "bits": 4, "slew": 603.0}
        with pytest.raises(LimitError, match=r"steps of the DAC.* 666\.667 V/s"):
            drive_table([0, 1e-3], [0, 1 * UM], **given)
        table = drive_table([0, 1e-3], [0, 1 * UM], strict=False, **given)
        assert not table.is_ok
        assert table.audit["largest_slew_V_per_s"] == pytest.approx(602.41, abs=0.01)
        assert table.audit["largest_slew_of_dac_V_per_s"] == pytest.approx(666.67, abs=0.01)
        assert drive_table([0, 1e-3], [0, 1 * UM], **{**given, "slew": 667.0}).is_ok

    @pytest.mark.parametrize("bits", [16.5, 16.0, True, "16", 0, 33])
    def test_bits_are_whole(self, bits):
        with pytest.raises(DataError, match="whole number"):
            drive_table([0, 1], [0, 0], quantity="error", calibration=SENSITIVITY, bits=bits)

    def test_bits_of_numpy_are_taken(self):
        table = drive_table(
            [0, 1], [0, UM], quantity="compensation", calibration=SENSITIVITY, bits=np.int64(12)
        )
        assert json.loads(json.dumps(table.to_dict(), allow_nan=False))["audit"]["bits"] == 12


class TestWords:
    """A value just beyond a limit prints like the limit: the excess is said."""

    def test_stroke(self):
        with pytest.raises(LimitError, match=r"1e-06 um beyond the stroke 0 \.\.\. 16\.6 um"):
            stage_displacement([16.6 * UM + 1e-12], quantity="compensation", travel=16.6 * UM)

    def test_no_minus_zero_and_the_right_article(self):
        with pytest.raises(LimitError, match=r"um a compensation of 0 \.\.\. 5 um is"):
            stage_displacement([6 * UM], quantity="compensation", travel=5 * UM)
        with pytest.raises(LimitError, match=r"um an error of -5 \.\.\. 0 um is"):
            stage_displacement([6 * UM], quantity="error", travel=5 * UM)

    def test_calibrated_range_and_voltage(self, calibration):
        given = {"quantity": "compensation", "calibration": calibration}
        with pytest.raises(LimitError, match=r"calibrated 0 \.\.\. 16\.6 um, by 1e-06 um"):
            drive_table([0.0], [16.6 * UM + 1e-12], **given)
        with pytest.raises(LimitError, match=r"outside 0 \.\.\. 5 V by 6\.02e-07 V"):
            drive_table([0.0], [8.3 * UM + 1e-12], limits=(0, 5), **given)
        with pytest.raises(LimitError, match=r"by 1e-06 V"):
            calibration.evaluate(10.000001)


class TestNegativeSensitivity:
    """A positive voltage draws the stage back: it travels from 0 to minus its travel."""

    @pytest.mark.parametrize("kind", ["number", "curve"])
    def test_travel_lies_below_zero(self, kind):
        v = np.concatenate([np.linspace(0, 10, 21), np.linspace(10, 0, 21)])
        log = Recording(np.arange(42), {"voltage": v, "displacement": -SENSITIVITY * v})
        stage = -SENSITIVITY if kind == "number" else flexure_calibration(log)
        given = {
            "quantity": "error", "calibration": stage, "offset": -5 * UM, "travel": 16.6 * UM
        }  # fmt: skip
        table = drive_table([0, 1], [-2 * UM, 3 * UM], **given)
        assert table.displacement == pytest.approx([-3 * UM, -8 * UM], abs=1e-18)
        assert table.voltage == pytest.approx([3 / 1.66, 8 / 1.66], abs=1e-9)
        with pytest.raises(
            LimitError, match=r"beyond the stroke -16\.6 \.\.\. 0 um.*-5 \.\.\. 11\.6 um"
        ):
            drive_table([0, 1], [0, -6 * UM], **given)

    def test_a_curve_that_falls_above_zero_keeps_its_side(self):
        v = np.linspace(0, 10, 21)
        log = Recording(np.arange(21), {"voltage": v, "displacement": 20 * UM - SENSITIVITY * v})
        table = drive_table(
            [0, 1], [0, 3 * UM], quantity="error", offset=10 * UM, travel=25 * UM,
            calibration=flexure_calibration(log),
        )  # fmt: skip
        assert table.voltage == pytest.approx([10 / 1.66, 13 / 1.66], abs=1e-9)


def test_a_table_is_plain_and_holds_no_nan(calibration):
    table = drive_table(
        [0.0], [17 * UM], quantity="compensation", calibration=calibration, strict=False
    )
    given = json.loads(json.dumps(table.to_dict(), allow_nan=False))
    assert given["voltage_V"] == [None]
    assert given["is_ok"] is False
    assert given["audit"]["dac_step_mV"] is None
    json.dumps(dict(table.audit), allow_nan=False)


class TestBadInput:
    def test_gap(self):
        with pytest.raises(InvalidSamplesError, match="x = 1 mm"):
            drive_table([0, 1 * MM], [0, np.nan], quantity="error", calibration=SENSITIVITY)

    def test_beyond_the_calibration(self, calibration):
        with pytest.raises(
            LimitError, match=r"17 um lies outside the calibrated 0 \.\.\. 16\.6 um"
        ):
            drive_table([0, 1], [0, 17 * UM], quantity="compensation", calibration=calibration)
        table = drive_table(
            [0, 1], [0, 17 * UM], quantity="compensation", calibration=calibration, strict=False
        )
        assert np.isnan(table.voltage[1])

    def test_stroke(self):
        with pytest.raises(LimitError, match="stroke"):
            drive_table(
                [0, 1],
                [0, 6 * UM],
                quantity="compensation",
                calibration=SENSITIVITY,
                travel=5 * UM,
            )

    def test_text(self):
        with pytest.raises(InvalidSamplesError, match="real numbers"):
            drive_table([0], ["a"], quantity="error", calibration=SENSITIVITY)

    def test_lengths_and_order(self):
        with pytest.raises(InvalidSamplesError, match="has 1"):
            drive_table([0, 1], [0.0], quantity="error", calibration=SENSITIVITY)
        with pytest.raises(InvalidSamplesError, match="increasing"):
            drive_table([1, 0], [0.0, 0.0], quantity="error", calibration=SENSITIVITY)

    @pytest.mark.parametrize(
        "bad",
        [
            {"calibration": 0.0},
            {"calibration": np.nan},
            {"limits": (10.0, 0.0)},
            {"bits": 0},
            {"slew": 0.0},
            {"travel": -1.0},
            {"speed": 0.0},
            {"offset": np.inf},
            {"quantity": "e"},
        ],
    )
    def test_options(self, bad):
        with pytest.raises(DataError):
            drive_table(
                [0, 1],
                [0.0, 0.0],
                **{"quantity": "compensation", "calibration": SENSITIVITY, **bad},
            )
