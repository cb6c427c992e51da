"""Resampling to equal steps: exact between nodes, honest error, no extrapolation."""

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.compensation.uniform import (
    is_uniform,
    resample_uniform,
    resampling_error,
    uniform_spacing,
)
from metrosep.core.errors import DataError, NotUniformError, TableError

ROUNDING = 1e-18  # m; corrections are of the order of 1 um


def ragged(reverse=False):
    """A lopsided table with free spacing and its zero at 10 mm, 3 nm more on the way back."""
    p = np.array([0.0, 4.0, 10.0, 11.0, 17.0, 30.0]) * 1e-3
    c = np.array([0.5, -0.2, 0.0, 1.3, 0.9, -0.7]) * 1e-6
    back = c + 3e-9 if reverse else None
    return CompensationTable(p, c, back, "X", "Z", 10e-3, u=np.full(6, 2e-9))


def parabola(h):
    """c = a x^2 / 2 with a = 2e-3 1/m at steps of h, 0 to 40 mm."""
    p = np.arange(0, round(40e-3 / h) + 1) * h
    return CompensationTable(p, 1e-3 * p**2, None, "X", "X", 0.0)


def test_values_between_nodes_are_linear():
    new = resample_uniform(ragged(), start=0.0, step=2e-3, n=16)
    x, c = ragged().positions, ragged().forward
    assert new.forward == pytest.approx(np.interp(np.arange(16) * 2e-3, x, c), abs=ROUNDING)
    assert new.forward[5] == 0.0
    assert new.u == pytest.approx(np.full(16, 2e-9), abs=ROUNDING)


def test_error_is_the_largest_deviation_of_two_polylines():
    new = resample_uniform(ragged(), start=0.0, step=2e-3, n=16)
    dense = np.linspace(0, 30e-3, 30_001)
    old = np.interp(dense, ragged().positions, ragged().forward)
    seen = np.abs(old - np.interp(dense, new.positions, new.forward)).max()
    # the node at 11 mm is missed: half of the way from 0 to (1.3 -> 1.2333) um
    expected = 1.3e-6 - 0.5 * (1.3e-6 + (0.9e-6 - 1.3e-6) / 6)
    assert new.interpolation_error == pytest.approx(expected, abs=ROUNDING)
    assert seen == pytest.approx(expected, abs=ROUNDING)
    assert resampling_error(ragged(), new) == pytest.approx(expected, abs=ROUNDING)


def test_parabola_a_h2_over_8():
    """From steps of 0.1 mm to 2 mm: a (H^2 - h^2) / 8 with a = 2e-3 1/m, both polylines above."""
    new = resample_uniform(parabola(0.1e-3), start=0.0, step=2e-3, span=40e-3)
    expected = 2e-3 * (2e-3**2) / 8
    assert new.interpolation_error == pytest.approx(expected, abs=2e-3 * 0.1e-3**2 / 8 + ROUNDING)


def test_old_interpolation_error_is_added():
    table = CompensationTable.from_error(
        lambda x: 1e-6 * np.sin(x / 3e-3), positions=np.linspace(0, 30e-3, 31), axis="X"
    )
    new = resample_uniform(table, start=0.0, step=2e-3, n=16)
    assert new.interpolation_error == pytest.approx(
        table.interpolation_error + resampling_error(table, new), abs=ROUNDING
    )
    assert new.source is table.source
    assert new.history[-1].parameters["n"] == 16


def test_uniform_already_is_the_same_object():
    table = parabola(2e-3)
    assert resample_uniform(table, start=0.0, step=2e-3, n=21) is table
    wobbled = CompensationTable(table.positions * (1 + 1e-13), table.forward, None, "X", "X", 0.0)
    assert resample_uniform(wobbled, start=0.0, step=2e-3, span=40e-3) is wobbled


def test_both_directions_and_zero_off_the_grid():
    new = resample_uniform(ragged(reverse=True), start=0.0, step=3e-3, n=11)
    # the zero at 10 mm lies between 9 and 12 mm: its interpolated value is taken away
    assert float(new.correction(10e-3, 1)[0]) == pytest.approx(0.0, abs=ROUNDING)
    assert new.reverse - new.forward == pytest.approx(np.full(11, 3e-9), abs=ROUNDING)
    raw = np.interp(np.arange(11) * 3e-3, ragged().positions, ragged().forward)
    assert new.offset_removed == pytest.approx(
        np.interp(10e-3, np.arange(11) * 3e-3, raw), abs=ROUNDING
    )


def test_extrapolation_is_refused_unless_chosen():
    with pytest.raises(TableError, match="not extrapolated"):
        resample_uniform(ragged(), start=0.0, step=2e-3, n=21)
    held = resample_uniform(ragged(), start=-10e-3, step=2e-3, n=26, outside="hold")
    assert held.forward[0] == pytest.approx(0.5e-6, abs=ROUNDING)
    assert held.forward[-1] == pytest.approx(-0.7e-6, abs=ROUNDING)
    zero = resample_uniform(ragged(), start=-10e-3, step=2e-3, n=26, outside="zero")
    assert (zero.forward[:5] == 0.0).all()
    assert zero.forward[5] == pytest.approx(0.5e-6, abs=ROUNDING)
    assert (zero.forward[21:] == 0.0).all()


def test_taper_falls_along_a_line():
    new = resample_uniform(
        ragged(), start=0.0, step=2e-3, n=26, outside="taper", taper=10e-3, slope_max=1e-4
    )
    x = np.arange(26) * 2e-3
    expected = -0.7e-6 * np.clip(1 - (x - 30e-3) / 10e-3, 0, 1)
    assert new.forward[15:] == pytest.approx(expected[15:], abs=ROUNDING)
    assert np.abs(np.diff(new.forward[15:])).max() <= 0.7e-4 * 2e-3 * (1 + 1e-9)


def test_taper_shorter_than_the_slope_allows_is_refused():
    with pytest.raises(TableError, match="at least 7 mm"):
        resample_uniform(
            ragged(), start=0.0, step=2e-3, n=26, outside="taper", taper=5e-3, slope_max=1e-4
        )
    with pytest.raises(TableError, match="slope"):
        resample_uniform(ragged(), start=0.0, step=2e-3, n=26, outside="zero", slope_max=1e-4)
    with pytest.raises(TableError, match="taper="):
        resample_uniform(ragged(), start=0.0, step=2e-3, n=26, outside="taper")


def test_uniform_within_1e_9_of_the_step():
    p = np.arange(11) * 0.1
    assert is_uniform(p)
    assert is_uniform(p + 0.9e-10 * np.array([0] * 5 + [1] + [0] * 5))
    assert not is_uniform(p + 2e-10 * np.array([0] * 5 + [1] + [0] * 5))
    assert not is_uniform(p[::-1])
    assert not is_uniform([0.0])
    assert not is_uniform([0.0, np.nan, 1.0])
    assert uniform_spacing(p) == pytest.approx((0.0, 0.1), abs=1e-15)
    with pytest.raises(NotUniformError, match="from 17 mm is 13 mm, most are 6 mm"):
        uniform_spacing(ragged().positions)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"step": 0.0, "n": 3}, "positive"),
        ({"step": -1e-3, "n": 3}, "positive"),
        ({"step": float("nan"), "n": 3}, "finite"),
        ({"step": 1e-3}, "one of them"),
        ({"step": 1e-3, "n": 3, "span": 2e-3}, "one of them"),
        ({"step": 1e-3, "n": 1}, "2 to"),
        ({"step": 1e-3, "n": 4.5}, "2 to"),
        ({"step": 1e-3, "span": 2.5e-3}, "multiple"),
        ({"step": 1e-12, "span": 1e-3}, "check step"),
        ({"step": 1e-3, "n": 3, "outside": "guess"}, "outside is one of refuse"),
    ],
)
def test_bad_input_is_refused(wrong, message):
    with pytest.raises(DataError, match=message):
        resample_uniform(ragged(), start=0.0, **wrong)


def test_tables_apart_have_no_error():
    far = CompensationTable([1.0, 2.0], [0.0, 0.0], None, "X", "Z", 1.0)
    with pytest.raises(TableError, match="overlap"):
        resampling_error(ragged(), far)
