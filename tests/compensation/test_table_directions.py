"""Forward and reverse columns, lost motion, and what is refused."""

import json
import math

import numpy as np
import pytest

from metrosep import Profile
from metrosep.compensation import CompensationTable, exact_correction
from metrosep.errors import DataError, TableError, UnitError

PM = 1e-12
NM = 1e-9
LOST = 0.4e-6
"""Planted in the fixture: reverse readings minus forward readings."""

P = np.linspace(0.0, 50e-3, 26)


def made(error, **options):
    return CompensationTable.from_error(error, **{"positions": P, "axis": "X"} | options)


def profile(error, low=0.0, high=50e-3, n=501):
    x = np.linspace(low, high, n)
    return Profile(x, error(x))


def test_estimate_of_both_directions_is_split(both_ways_estimate):
    table = made(both_ways_estimate, positions="1 mm")

    assert table.reverse is not None
    # the axis reaches further in + when it comes back, so less is added
    assert np.mean(table.reverse - table.forward) == pytest.approx(-LOST, abs=4 * NM)


def test_each_column_is_minus_the_truth(both_ways, both_ways_estimate):
    table = made(both_ways_estimate, positions="1 mm", exact=False)

    for entries in (table.forward, table.reverse):
        rest = entries + both_ways.truth(table.positions)
        rest -= np.polyval(np.polyfit(table.positions, rest, 1), table.positions)
        assert np.abs(rest).max() < 5 * NM


def test_both_is_one_column_of_the_mean(both_ways_estimate):
    split = made(both_ways_estimate, positions="1 mm", exact=False)
    both = made(both_ways_estimate, positions="1 mm", exact=False, direction="both")

    mean = 0.5 * (split.forward + split.reverse)
    assert both.reverse is None
    np.testing.assert_allclose(both.forward, mean - mean[0], atol=PM, rtol=0)


@pytest.mark.parametrize(("direction", "sign"), [("forward", 1), ("reverse", -1)])
def test_one_direction_for_both(both_ways_estimate, direction, sign):
    table = made(both_ways_estimate, positions="1 mm", exact=False, direction=direction)

    line = both_ways_estimate.slope_of(sign).value * table.positions
    e = both_ways_estimate.evaluate(table.positions, direction=sign) + line
    np.testing.assert_allclose(table.forward, e[0] - e, atol=PM, rtol=0)
    assert table.reverse is None


def test_uncertainty_of_a_split_table_is_that_of_one_direction(both_ways_estimate):
    """The mean of two directions is better known than either of them."""
    split = made(both_ways_estimate, positions="1 mm")

    p = split.positions
    whole = both_ways_estimate.covariance(p, direction=1)
    forward = np.sqrt(np.diag(whole) + whole[0, 0] - 2.0 * whole[0])
    # The zero of both columns is that of the forward direction.
    reverse = np.hypot(both_ways_estimate.sd(p, direction=-1), np.sqrt(whole[0, 0]))
    up, down = (p * both_ways_estimate.slope_of(d).u for d in (1, -1))
    wanted = np.maximum(np.hypot(forward, up), np.hypot(reverse, down))
    np.testing.assert_allclose(split.u, wanted, rtol=1e-9)


def test_reverse_from_elsewhere_keeps_its_own_shape(lopsided):
    table = made(lopsided, reverse=lambda x: 2 * lopsided(x) + 1e-6, exact=False)

    zero = float(lopsided(0.0))
    np.testing.assert_allclose(table.reverse, zero - 2 * lopsided(P) - 1e-6, atol=PM, rtol=0)
    assert table.forward[0] == 0.0


def test_exact_inverse_is_taken_past_the_last_entry_where_the_error_is_known(lopsided):
    table = made(profile(lopsided, -1e-3, 51e-3, 5201), positions=P[:8], reference=0.0)
    x = np.linspace(-1e-3, 51e-3, 5201)

    def error(p):
        return np.interp(p, x, lopsided(x)) - lopsided(0.0)

    np.testing.assert_allclose(table.forward, exact_correction(error, P[:8]), atol=PM, rtol=0)


def test_positions_outside_the_profile_are_refused(lopsided):
    with pytest.raises(
        TableError, match=r"X = 0 mm \.\.\. X = 50 mm leave the measured range .* X = 40 mm"
    ):
        made(profile(lopsided, 0.0, 40e-3))


def test_positions_outside_the_reverse_profile_are_refused(lopsided):
    with pytest.raises(TableError, match="not extrapolated"):
        made(profile(lopsided), reverse=profile(lopsided, 0.0, 40e-3))


def test_positions_outside_the_estimate_are_refused(one_way_estimate):
    with pytest.raises(TableError, match="not extrapolated"):
        made(one_way_estimate, positions=[0.0, 60e-3])


def test_gap_wider_than_the_entries_is_refused(lopsided):
    z = lopsided(np.linspace(0.0, 50e-3, 501))
    z[200:240] = np.nan

    with pytest.raises(TableError, match=r"not measured between 19\.9 and 24 mm"):
        made(Profile(np.linspace(0.0, 50e-3, 501), z))


def test_single_missing_samples_are_bridged(lopsided):
    x = np.linspace(0.0, 50e-3, 501)
    z = np.where(np.arange(501) % 50 == 7, np.nan, lopsided(x))

    table = made(Profile(x, z), exact=False)

    np.testing.assert_allclose(table.forward, lopsided(0.0) - lopsided(P), atol=3 * NM, rtol=0)


def test_missing_ends_of_a_profile_are_not_covered(lopsided):
    z = lopsided(np.linspace(0.0, 50e-3, 501))
    z[:20] = np.nan

    with pytest.raises(TableError, match="leave the measured range X = 2 mm"):
        made(Profile(np.linspace(0.0, 50e-3, 501), z))


def test_profile_without_a_sample_is_refused():
    with pytest.raises(DataError, match="no valid sample"):
        made(Profile(P, np.full(P.size, np.nan)))


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ([0.0, math.nan, 1e-3], r"positions\[1\] is nan"),
        ([0.0, math.inf], r"positions\[1\] is inf"),
        ([0.0, 2e-3, 2e-3], r"entry 1 is 2 mm, entry 2 is 2 mm"),
        ([0.0, 2e-3, 1e-3], r"rise strictly"),
        ([1e-3], "at least 2 positions, got 1"),
        ([], "at least 2 positions, got 0"),
        ([[0.0, 1e-3]], "one-dimensional"),
        (7, "state the positions"),
        ("1 mm", "state the positions"),
    ],
)
def test_useless_positions_are_refused(lopsided, positions, message):
    with pytest.raises(TableError, match=message):
        made(lopsided, positions=positions)


@pytest.mark.parametrize("positions", ["1", "1 V", "abc"])
def test_spacing_without_a_unit_of_length_is_refused(one_way_estimate, positions):
    with pytest.raises(UnitError):
        made(one_way_estimate, positions=positions)


@pytest.mark.parametrize("positions", ["0 mm", "-1 mm", "1 m"])
def test_spacing_that_does_not_fit_is_refused(one_way_estimate, positions):
    with pytest.raises(TableError, match="spacing"):
        made(one_way_estimate, positions=positions)


@pytest.mark.parametrize("number", [0, 1, -3])
def test_too_few_positions_by_number_are_refused(one_way_estimate, number):
    with pytest.raises(TableError, match="at least 2 positions"):
        made(one_way_estimate, positions=number)


def test_numpy_integer_is_a_number_of_positions(one_way_estimate):
    assert made(one_way_estimate, positions=np.int64(5)).positions.size == 5


def test_error_that_is_not_finite_is_refused():
    with pytest.raises(TableError, match="not finite at 40 mm"):
        made(lambda x: np.where(x > 39e-3, np.nan, 0.0), positions=[0.0, 20e-3, 40e-3, 50e-3])


@pytest.mark.parametrize("columns", [{"forward": [0.0, np.nan]}, {"reverse": [0.0, np.inf]}])
def test_entries_that_are_not_finite_are_refused(columns):
    values = {"forward": [0.0, 1e-9], "reverse": None} | columns

    with pytest.raises(TableError, match=r"\[1\] is"):
        CompensationTable([0.0, 1e-3], **values, axis="X", compensates="X", reference=0.0)


def test_columns_of_different_length_are_refused():
    with pytest.raises(TableError, match="forward has 3 entries, there are 2 positions"):
        CompensationTable([0.0, 1e-3], [0, 0, 0], None, "X", "X", 0.0)


def test_nameless_axis_is_refused():
    with pytest.raises(TableError, match="name an axis"):
        CompensationTable([0.0, 1e-3], [0, 0], None, " ", "X", 0.0)


def test_split_needs_two_directions(one_way_estimate, lopsided):
    for error in (one_way_estimate, lopsided, profile(lopsided)):
        with pytest.raises(DataError, match="both directions"):
            made(error, positions=[0.0, 1e-2], direction="split")


def test_direction_that_was_not_run_is_refused(one_way_estimate):
    with pytest.raises(DataError, match="no reverse runs"):
        made(one_way_estimate, positions="1 mm", direction="reverse")


def test_unknown_direction_is_refused(lopsided):
    with pytest.raises(DataError, match="direction='back'"):
        made(lopsided, direction="back")


@pytest.mark.parametrize("direction", ["both", "forward", "reverse"])
def test_reverse_error_and_one_column_contradict(lopsided, direction):
    with pytest.raises(DataError, match="contradicts"):
        made(lopsided, reverse=lopsided, direction=direction)


def test_something_else_is_refused():
    with pytest.raises(DataError, match="is a float"):
        made(3.0)


def test_plain_values_are_json_with_sign_and_units(both_ways_estimate):
    table = made(both_ways_estimate, positions="5 mm")

    text = json.dumps(table.to_dict(), allow_nan=False)

    back = json.loads(text)
    assert "c = -e" in back["sign"]
    np.testing.assert_array_equal(back["forward_m"], table.forward)
    np.testing.assert_array_equal(back["reverse_m"], table.reverse)
    assert back["reference_m"] == 0.0
    assert back["stroke_m"] == max(np.abs(table.forward).max(), np.abs(table.reverse).max())
