"""Turning programs, understood by LinuxCNC's own RS274 interpreter: places, sense of C, time of blocks.

The interpreter (`interpret.py`, the system's Python) says where X, C and Z go and at which feed. Which
place of the part lies under the tool then is worked out here, by turning a complex number.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from acceptance.linuxcnc.test_rs274 import interpret, pytestmark

from metrosep.controllers.gcode.lathe import LatheAxes
from metrosep.controllers.gcode.turning import write_program
from metrosep.controllers.gcode.turning_reader import read_program
from metrosep.forms import Expression
from metrosep.process import RoundNose, TurningJob

__all__ = ["pytestmark"]

PM = 1e-12
# inches in double precision, of words of some mm
BINARY = 1e-16
ANGLE = 1e-11  # rad: ten thousand degrees in double precision
TIME = 1e-8  # relative: F words have nine digits
NOSE = RoundNose(0.6e-3)
# no symmetry: a mirrored or turned path is another part
PART = Expression("0.4*x**2-0.25*y**2+0.15*x*y+2e-4*x+3e-7*sin(2*pi*y/9e-4)")
SENSES = ["clockwise", "counterclockwise"]


def program(sense="clockwise", feed=10e-6, per_turn=120, rpm=60.0):
    job = TurningJob(PART, 1.2e-3, feed, rpm=rpm, core=1.2e-3 - 4 * feed, sense=sense, nose=NOSE)
    return job.program(job.path(step=2 * math.pi / per_turn, interpolation="linear"))


def written(folder, axes, planned, *, before=""):
    """Write, and return the result, the moves of the interpreter and what our reader makes of the file."""
    place = folder / "part.ngc"
    result = write_program(planned, place, axes, nose=NOSE, form=PART)
    seen = folder / "seen.ngc"
    seen.write_text(before + place.read_text())
    return result, interpret(seen), read_program(place, axes)


def under_the_tool(moves, *, workpiece_turns, zero):
    """Place of the part under the tool in m: the part turns by C, or the tool about it."""
    tool = moves[:, 2] * 1e-3 + 0j
    return tool * np.exp(1j * ((-1 if workpiece_turns else 1) * np.radians(moves[:, 7]) + zero))


def seconds(moves):
    """How long the interpreter lets each block last, but for the first."""
    way = np.hypot(*(np.diff(moves[:, k]) for k in (2, 4)))
    return 60.0 * way / moves[1:, 8]


@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("c_positive", ["workpiece ccw", "tool ccw"])
@pytest.mark.parametrize("side", ["+X", "-X"])
@pytest.mark.parametrize("x_words", ["radius", "diameter"])
@pytest.mark.parametrize("unit", ["mm", "inch"])
def test_the_part_under_the_tool_is_the_planned_one(
    tmp_path, sense, c_positive, side, x_words, unit
):
    axes = LatheAxes(
        c_positive, side, 0.3, x_words, unit, "G94", x_decimals=8, z_decimals=9, c_decimals=7
    )
    planned = program(sense)

    _, moves, back = written(
        tmp_path, axes, planned, before="G7\n" if x_words == "diameter" else ""
    )

    assert moves.shape[0] == len(planned) == len(back)
    assert (moves[:, 2] > 0).all() == (side == "+X")
    place = under_the_tool(moves, workpiece_turns=c_positive == "workpiece ccw", zero=0.3)
    half = 0.5e-8 * axes.z_scale + 1.2e-3 * math.radians(0.5e-7) + PM
    assert np.abs(place - planned.X * np.exp(1j * planned.azimuth)).max() <= half
    assert np.abs(moves[:, 4] * 1e-3 - planned.Z).max() <= 0.5e-9 * axes.z_scale + BINARY
    # our strict reader and the interpreter agree to the last binary digits
    assert np.abs(back.X * np.exp(1j * back.azimuth) - place).max() <= 1.2e-3 * ANGLE
    assert np.abs(back.Z - moves[:, 4] * 1e-3).max() <= BINARY
    assert np.abs(seconds(moves) / np.diff(back.t) - 1).max() <= TIME


def test_the_other_sense_of_c_is_another_part(tmp_path):
    planned = program()
    _, moves, _ = written(tmp_path, LatheAxes("tool ccw", inverse_time="1/min"), planned)

    mirrored = under_the_tool(moves, workpiece_turns=True, zero=0.0)

    x, y = mirrored.real, mirrored.imag
    wrong = PART(x, y) - PART(*(planned.X * f(planned.azimuth) for f in (np.cos, np.sin)))
    assert np.ptp(wrong) > 100e-9


@pytest.mark.parametrize("sense", SENSES)
def test_inverse_time_is_the_time_of_the_block(tmp_path, sense):
    axes = LatheAxes("workpiece ccw", inverse_time="1/min")
    planned = program(sense)

    result, moves, back = written(tmp_path, axes, planned)

    # in G93 the interpreter makes the feed of the way and F: 1/120 s a block at 60 rpm
    assert np.abs(seconds(moves) * 120.0 - 1.0).max() <= TIME
    assert np.abs(np.diff(back.t) * 120.0 - 1.0).max() <= TIME
    assert not [m for m in result.messages if "LinuxCNC" in m]


@pytest.mark.parametrize("unit", ["mm", "inch"])
def test_blocks_that_linuxcnc_hurries_are_named(tmp_path, unit):
    """Its interpreter runs no block of G93 slower than 0.1 units a minute: C turns too fast."""
    planned = program(feed=1e-6)
    words = {"unit": unit, "x_decimals": 8, "z_decimals": 9}
    axes = LatheAxes("workpiece ccw", inverse_time="1/min", **words)
    result, moves, _ = written(tmp_path, axes, planned)
    hurried = (1.0 / 120.0) / seconds(moves)

    (message,) = [m for m in result.messages if "LinuxCNC" in m]

    n, most = int((hurried > 1.0 + TIME).sum()), hurried.max()
    assert most > 1.5
    assert message.startswith(f"{n} of {hurried.size} blocks")
    assert f"up to {most:.3g} times too fast" in message

    (tmp_path / "g94").mkdir()
    slow = LatheAxes("workpiece ccw", feed="G94", **words)
    result, moves, _ = written(tmp_path / "g94", slow, planned)
    assert np.abs(seconds(moves) * 120.0 - 1.0).max() <= 1e-6  # F in steps of 1e-9 of some 0.1
    assert not [m for m in result.messages if "LinuxCNC" in m]


def test_turns_are_not_folded(tmp_path):
    """C runs on over turns; a controller that folded it would turn back once a turn."""
    planned = program(per_turn=36)
    _, moves, _ = written(tmp_path, LatheAxes("tool ccw", feed="G94", z_decimals=8), planned)

    assert all(b < a for a, b in pairwise(moves[:, 7]))
    assert abs(moves[0, 7] - moves[-1, 7]) > 4 * 360
