"""Each limit against numbers worked out by hand; dead zone of LinuxCNC as measured."""

import numpy as np
import pytest

from metrosep.compensation import Limits, check_limits, dead_zone

P = np.array([0.0, 1e-3, 2e-3, 3e-3])


def findings(forward, reverse=None, *, on_axis=False, positions=P, **limits):
    return check_limits(
        positions,
        np.asarray(forward, float),
        None if reverse is None else np.asarray(reverse, float),
        Limits(**limits),
        on_axis=on_axis,
    )


def levels(*args, **kwargs):
    return [f.level for f in findings(*args, **kwargs)]


def test_nothing_stated_nothing_found():
    assert findings([0, 1e-7, -1e-7, 0], [1e-7, 0, 0, 0]) == ()


@pytest.mark.parametrize(("allowed", "found"), [(4, []), (3, ["error"])])
def test_number_of_points(allowed, found):
    assert levels([0, 0, 0, 0], max_points=allowed) == found


@pytest.mark.parametrize(("stroke", "found"), [(2.0e-7, []), (1.9e-7, ["error"])])
def test_stroke_is_the_largest_of_both_columns(stroke, found):
    assert levels([0, 1e-7, 0, 0], [0, 0, -2e-7, 0], stroke=stroke) == found


@pytest.mark.parametrize(("share", "found"), [(2.01e-5, []), (1.99e-5, ["error"])])
def test_velocity_is_slope_times_feed(share, found):
    """0.2 um in 1 mm at 0.1 m/s: 2e-4 x 0.1 = 2e-5 m/s."""
    assert levels([0, 0, -2e-7, -2e-7], feed=0.1, velocity_share=share) == found


@pytest.mark.parametrize(("share", "found"), [(2.01e-3, []), (1.99e-3, ["error"])])
def test_acceleration_is_curvature_times_feed_squared(share, found):
    """k x^2 / 2 with k = 0.2 per m at 0.1 m/s: 2e-3 m/s2."""
    assert levels(0.5 * 0.2 * P**2, feed=0.1, acceleration_share=share) == found


def test_acceleration_on_uneven_positions():
    p = np.array([0.0, 1e-3, 4e-3, 4.5e-3])

    assert levels(0.1 * p**2, positions=p, feed=0.1, acceleration_share=2.01e-3) == []
    assert levels(0.1 * p**2, positions=p, feed=0.1, acceleration_share=1.99e-3) == ["error"]


@pytest.mark.parametrize(("allowed", "found"), [(3.01e-7, []), (2.99e-7, ["error"])])
def test_jump_at_reversal(allowed, found):
    assert levels([0, 1e-7, 0, 0], [0, -2e-7, 0, 0], reversal_jump=allowed) == found


@pytest.mark.parametrize(("slope", "found"), [(0.9e-3, []), (1.1e-3, ["warning"])])
def test_steep_correction_is_doubtful(slope, found):
    assert levels(slope * P) == found


@pytest.mark.parametrize(
    ("slope", "on_axis", "found"),
    [
        (-1.1, True, ["error"]),
        (-0.9, True, ["warning"]),
        (1.1, True, ["warning"]),
        (-1.1, False, ["warning"]),
    ],
)
def test_command_may_not_turn_back(slope, on_axis, found):
    assert levels(slope * P, on_axis=on_axis) == found


def test_fall_is_named_not_the_steeper_rise():
    (found,) = findings([0, 5e-3, 3.5e-3, 3.5e-3], on_axis=True)

    assert "falls by 1.5 m per m" in found.problem


def test_dead_zone_of_the_spec():
    low, high = dead_zone(1.0, 1e-3)

    assert low == pytest.approx(0.25e-6, abs=1e-18)
    assert high == pytest.approx(0.5e-6, abs=1e-18)


@pytest.mark.parametrize(
    ("acceleration", "step", "stuck"),
    [
        (1.0, 0.2e-6, False),
        (1.0, 0.4e-6, True),
        (1.0, 0.5e-6, True),
        (1.0, 0.6e-6, False),
        (0.1, 20e-9, False),
        (0.1, 40e-9, True),
        (0.1, 60e-9, False),
    ],
)
def test_dead_zone_as_measured_on_the_controller(acceleration, step, stuck):
    """Controllers notes, section 1: which steps were applied and which stuck, T = 1 ms."""
    found = levels([0, 0, 0, 0], [0, step, 0, 0], acceleration=acceleration, servo_period=1e-3)

    assert found == (["warning"] if stuck else [])


def test_every_finding_says_what_to_do():
    all_found = findings(
        [0, 2e-6, 0, 0],
        [0, 1.6e-6, 0, 0],
        max_points=3,
        stroke=1e-6,
        feed=1.0,
        velocity_share=1e-6,
        acceleration_share=1e-6,
        reversal_jump=1e-7,
        acceleration=1.0,
        servo_period=1e-3,
    )

    assert len(all_found) == 7
    assert all(f.problem and f.fix for f in all_found)
    assert any("60000 mm/min" in f.problem for f in all_found)


def test_a_table_too_coarse_for_its_error_is_flagged():
    """A 10 mm wave at 4 mm spacing: the straight pieces miss a large part of it."""
    import numpy as np

    from metrosep.compensation import CompensationTable

    def wave(x):
        return 1e-6 * np.sin(2 * np.pi * x / 10e-3)

    coarse = CompensationTable.from_error(
        wave, positions=np.arange(0, 41e-3, 4e-3), axis="X", compensates="Z"
    )
    fine = CompensationTable.from_error(
        wave, positions=np.arange(0, 41e-3, 0.5e-3), axis="X", compensates="Z"
    )

    assert any("use a finer spacing" in f.fix and f.level == "warning" for f in coarse.limits())
    assert fine.limits() == ()


def test_a_spacing_in_the_wrong_unit_is_refused_at_once():
    import numpy as np
    import pytest

    from metrosep import Profile
    from metrosep.compensation import CompensationTable
    from metrosep.errors import TableError

    with pytest.raises(TableError, match="check the unit"):
        CompensationTable.from_error(
            Profile(np.linspace(0, 1, 11), np.zeros(11)), positions="1 nm", axis="X"
        )


def test_a_step_at_the_very_edge_of_the_dead_zone_warns():
    """1.0 to 1.5 um reads back from a file as 5.000000000024e-7; float32 decides in the machine."""
    x = np.array([-50e-3, 50e-3])
    limits = Limits(acceleration=1.0, servo_period=1e-3)

    found = check_limits(
        x, np.full(2, 1.0e-6), np.full(2, 1.0e-6 + 5.000000000024e-7), limits, on_axis=True
    )

    assert [f.check for f in found] == ["dead-zone"]
