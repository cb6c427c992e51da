"""Time of a pass: the spindle or the blocks, whichever is slower."""

import math

import pytest

from metrosep.core.errors import DataError
from metrosep.process.machining_times import machining_time

SPEED = 20.0 / 60.0
ROUNDING = 1e-9


def test_times_of_the_paper():
    made = machining_time(45_000, 250.0, spindle_speed=SPEED)

    assert made.seconds == pytest.approx(750.0, abs=ROUNDING)
    assert made.limited_by == "spindle"
    block = made.seconds / 45_000
    assert block == pytest.approx(16.67e-3, abs=0.005e-3)  # printed digits
    more = (45_000 - 13_090) * block / 60.0
    assert more == pytest.approx(8.86, abs=0.005)  # printed digits; the paper says ten minutes


def test_blocks_limit_above_the_free_count():
    at = machining_time(45_000, 250.0, spindle_speed=SPEED, block_time=1.0 / 60.0)
    above = machining_time(90_000, 250.0, spindle_speed=SPEED, block_time=1.0 / 60.0)

    assert at.free_points == 45_000
    assert at.limited_by == "spindle"
    assert above.limited_by == "blocks"
    assert above.seconds == pytest.approx(1500.0, abs=ROUNDING)
    assert above.reached_speed == pytest.approx(SPEED / 2.0, abs=ROUNDING)
    assert "10 rpm" in above.messages[0]
    assert "45000 blocks" in above.messages[0]


def test_blocks_without_time_never_limit():
    made = machining_time(10**9, 250.0, spindle_speed=SPEED)

    assert made.free_points is None
    assert made.seconds == pytest.approx(750.0, abs=ROUNDING)
    assert made.messages == ()
    assert made.audit["time_min"] == pytest.approx(12.5, abs=ROUNDING)
    assert made.quantity().unit == "s"


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"n_points": 0}, "n_points"),
        ({"n_points": 1.5}, "whole"),
        ({"turns": -1.0}, "turns"),
        ({"turns": math.nan}, "turns"),
        ({"spindle_speed": 0.0}, "spindle_speed"),
        ({"spindle_speed": "fast"}, "spindle_speed"),
        ({"block_time": -1e-3}, "block_time"),
        ({"block_time": math.inf}, "block_time"),
        ({"block_time": None}, "block_time must be a number"),
        ({"turns": "5"}, "turns must be a number"),
        ({"n_points": True}, "n_points must be a whole number"),
    ],
)
def test_refuses(change, match):
    given = {"n_points": 10, "turns": 5.0, "spindle_speed": 1.0, "block_time": 0.0} | change
    with pytest.raises(DataError, match=match):
        machining_time(**given)
