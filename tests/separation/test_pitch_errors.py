"""Errors of an axis along itself for a pitch table: the published values of the specification, and what is refused."""

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.core.errors import DataError
from metrosep.separation import Expansion, pitch_errors

UM = 1e-6
DIGITS = 0.6e-12
"""The reference values are printed to 1e-6 um."""

PRINTED = 6e-12
"""Half of the last digit printed, 0.01 nm, and a little of the grid."""
HELD = 2e-9
"""A list is held beyond its last target: 5 um of the last command times the slope 4e-4 of the sine."""

TARGETS = np.array([0, 61, 118, 183, 241, 299, 362]) * 1e-3
UP = UM * np.array(
    [(0.1, -0.2, 0.0), (2.9, 2.7, 3.1), (4.2, 4.4, 4.0), (7.3, 7.1, 7.5), (8.0, 8.3, 8.2),
     (11.4, 11.0, 11.2), (12.3, 12.6, 12.0)]
)  # fmt: skip
DOWN = UM * np.array(
    [(-1.1, -1.3, -0.9), (1.6, 1.4, 1.8), (2.7, 3.1, 2.9), (5.7, 5.9, 5.8), (6.4, 6.8, 6.9),
     (9.6, 9.7, 9.8), (10.7, 11.0, 10.7)]
)  # fmt: skip
WARM = {
    "reference": 0.118, "expansion": "11.5 ppm/K", "temperature": "22.4 degC",
    "u_expansion": "1 ppm/K", "u_temperature": 0.2,
}  # fmt: skip
E_UP = [-0.976533, 0.273200, 0, 1.306000, 0.571867, 2.004400, 1.365600]
E_DOWN = [-2.043200, -1.026800, -1.300000, -0.194000, -0.894800, 0.504400, -0.134400]
C_UP = [0.976513, -0.273194, 0, -1.305974, -0.571874, -2.004350, -1.365614]
C_DOWN = [2.043166, 1.026805, 1.299978, 0.194002, 0.894778, -0.504388, 0.134400]
C_AT_25 = [7.760928, 3.004142, 0, -5.043109, -7.644024, -12.410880, -15.394871]


def found(**more):
    return pitch_errors(TARGETS, UP, DOWN, **{"values": "deviation", **WARM, **more})


def assert_um(values, wanted):
    assert np.abs(np.asarray(values) - UM * np.asarray(wanted)).max() < DIGITS


def table(errors):
    return CompensationTable.from_error(
        errors.curve(1),
        reverse=errors.curve(-1),
        positions=TARGETS,
        axis="X",
        reference=errors.reference,
    )


def test_errors_at_20_degrees_are_those_of_the_specification():
    errors = found()

    assert_um(errors.forward, E_UP)
    assert_um(errors.reverse, E_DOWN)
    assert abs(errors.expansion_removed - 27.6e-6) < DIGITS
    assert abs(errors.zero_removed - 4.2 * UM) < DIGITS
    assert abs(errors.u_slope - 3.324154e-6) < DIGITS
    assert abs(errors.u_slope * (TARGETS[-1] - 0.118) - 0.811094e-6) < DIGITS
    cycles = UP[-1] - UP[2]  # the end less the zero of the same cycle
    assert errors.u()[-1] == pytest.approx(
        np.hypot(cycles.std(ddof=1) / np.sqrt(3), 0.811094e-6), rel=1e-6, abs=0
    )
    assert abs(errors.slope - 6.016721e-6) < DIGITS
    both = np.concatenate([errors.forward, errors.reverse])
    assert abs(np.ptp(both) - 4.047600e-6) < DIGITS
    assert errors.has_lost_motion
    assert errors.lost_motion > 0  # forward lies above reverse: B of the standard


def test_table_is_the_exact_inverse_of_the_specification():
    made = table(found())

    assert_um(made.forward, C_UP)
    assert_um(made.reverse, C_DOWN)
    warm = found(temperature_use="25 degC", workpiece_expansion=0.0)
    assert_um(table(warm).forward, C_AT_25)


def test_use_at_another_temperature_with_a_part_that_stretches_alike_changes_nothing():
    alike = found(temperature_use="25 degC", workpiece_expansion="11.5 ppm/K")

    assert np.abs(alike.forward - found().forward).max() < 1e-18


def test_untidy_lists_give_the_same_errors():
    order = [3, 0, 6, 2, 5, 1, 4]
    reached = pitch_errors(
        TARGETS[order], (TARGETS[:, None] + UP)[order], (TARGETS[:, None] + DOWN)[order], **WARM
    )
    turned = pitch_errors(
        TARGETS, -UP, -DOWN, values="deviation", deviation="target-minus-reached", **WARM
    )

    for other in (reached, turned):
        assert np.abs(other.forward - found().forward).max() < 1e-16  # doubles near 0.4 m
        assert np.abs(other.reverse - found().reverse).max() < 1e-16


def test_zero_stands_where_the_axis_is_homed():
    backwards = found(reference_direction="reverse")
    between = found(reference_direction="middle")

    assert abs(backwards.curve(-1)(0.118)) < 1e-18
    assert abs(backwards.curve(1)(0.118) - 1.3 * UM) < DIGITS  # keeps its distance
    assert abs(between.curve(0)(0.118)) < 1e-18
    assert abs(found(reference=0.09).curve(1)(0.09)) < 1e-18  # no target, in range


def test_without_a_temperature_nothing_is_taken_off_and_it_is_said():
    plain = pitch_errors(TARGETS, UP, DOWN, values="deviation")

    assert plain.expansion_removed == 0.0
    assert plain.u_slope is None
    assert "11.5 um/m" in plain.messages[0]
    assert "assumed" in found(u_expansion=None).messages[1]


def test_one_direction_and_one_cycle_say_what_is_not_known():
    one = pitch_errors(TARGETS, UP, values="deviation", **WARM)
    single = pitch_errors(TARGETS, UP[:, :1], DOWN[:, :1], values="deviation", **WARM)

    assert one.reverse is None
    with pytest.raises(DataError, match=r"direction -1 was not measured"):
        one.curve(-1)
    assert not single.has_lost_motion
    assert "one cycle" in single.messages[-1]


def test_lost_motion_below_its_scatter_is_not_split():
    noisy = DOWN + UM * np.array([3.5, -3.5, 0.0])

    assert not pitch_errors(TARGETS, UP, noisy, values="deviation", **WARM).has_lost_motion


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reference": 0.5}, "lies outside the targets"),
        ({"temperature": 22.4}, "outside 0 ... 50 degC.*unit"),
        ({"temperature": None}, "expansion and temperature are needed together"),
        ({"expansion": 11.5}, "outside -1e-6"),
        ({"already_corrected": True}, "again"),
        ({"temperature_use": "25 degC"}, "workpiece_expansion"),
        ({"unit": "rad"}, "no expansion"),
        ({"reference_direction": "left"}, "reference_direction"),
        ({"values": "reached"}, "they are deviations"),
        ({"deviation": "?"}, "deviation"),
    ],
)
def test_what_cannot_be_meant_is_refused(change, message):
    with pytest.raises(DataError, match=message):
        found(**change)


def test_untidy_readings_are_refused_by_place():
    hole, twice = UP.copy(), TARGETS.copy()
    hole[3] = np.nan
    twice[4] = twice[3]
    with pytest.raises(DataError, match=r"183 mm has no forward reading"):
        pitch_errors(TARGETS, hole, DOWN, values="deviation")
    with pytest.raises(DataError, match=r"183 mm occurs more than once"):
        pitch_errors(twice, UP, DOWN, values="deviation")
    with pytest.raises(DataError, match="at least 3 finite positions"):
        pitch_errors(TARGETS[:2], UP[:2], values="deviation")
    with pytest.raises(DataError, match="row for each of the 7 targets"):
        pitch_errors(TARGETS, UP[:5], values="deviation")


def rest_of(table_, error):
    """Return what a machine of its own still errs: it looks up the command and reaches c + e(p + c)."""
    p = np.linspace(0.0, 0.25, 5001)
    c = np.interp(p, table_.positions, table_.forward)
    return p, c + error(p + c)


def test_iteration_on_an_active_table_closes_and_on_a_wrong_signed_one_too():
    from metrosep.compensation import combine_tables

    def error(p):
        return 21e-6 * p + 1.3e-6 * np.sin(2 * np.pi * p / 0.02)

    entries = np.linspace(0.0, 0.25, 126)

    def made(readings):
        errors = pitch_errors(entries, readings(entries), values="deviation")
        return CompensationTable.from_error(
            errors.curve(1), positions=entries, axis="X", reference=0.0
        )

    first = made(error)
    assert (
        abs(np.ptp(error(np.linspace(0, 0.25, 5001))) - 7433.25e-9) < 0.3e-9
    )  # by the grid of the comparison
    stated = CompensationTable.from_error(error, positions=entries, axis="X", reference=0.0)
    assert abs(np.ptp(rest_of(stated, error)[1]) - 127.25e-9) < PRINTED
    assert np.ptp(rest_of(first, error)[1]) < 127.25e-9 + HELD
    wrong = CompensationTable(
        entries, 0.5 * error(entries), None, "X", "X", 0.0, is_exact_inverse=True
    )
    assert (
        abs(np.ptp(rest_of(wrong, error)[1]) - 11089.05e-9) < 5 * PRINTED
    )  # by the grid of the comparison

    def measured(p):
        c = np.interp(p, entries, wrong.forward)
        return c + error(p + c)

    combined = combine_tables(wrong, made(measured))
    assert np.ptp(rest_of(combined, error)[1]) < 127.25e-9 + HELD


def test_the_u_of_the_slope_is_that_of_its_derivatives():
    """(23) and (24) differentiated by hand: used as warm as it was measured, a_m does not matter."""
    stated = {"expansion": 11.5e-6, "u_expansion": 1e-6, "temperature": 293.15 + 2.4}
    stated |= {"u_temperature": 0.2, "workpiece_expansion": 0.0}
    for use in (2.4, 15.0):
        found = Expansion(**stated, temperature_use=293.15 + use).u_slope
        by_hand = np.hypot(11.5e-6 * 0.2, (2.4 - use) * 1e-6)
        assert found == pytest.approx(by_hand, rel=1e-9, abs=0)
    part = Expansion(**{**stated, "workpiece_expansion": 23e-6}, temperature_use=303.15).u_slope
    by_hand = np.sqrt((11.5e-6 * 0.2) ** 2 + (7.6e-6) ** 2 + (10e-6) ** 2)
    assert part == pytest.approx(by_hand, rel=1e-9, abs=0)
