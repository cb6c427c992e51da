"""Corrections played over time by a wave generator that knows no position.

A table of corrections is sampled where the moving axis is at each output of the generator: along
a pass at constant speed, or over one turn of a spindle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import Simulator, one_way
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "PLAYBACK_OPTIONS",
    "TOLD",
    "Playback",
    "chosen",
    "dropped",
    "facts",
    "plan",
    "rebuilt",
    "require_travel",
    "resampling_error",
    "rest_position",
    "sampled",
]


_TURN = 2.0 * math.pi
_NODE = 1e-9
"""A point counts as reached this part of a step early: positions are not exact in binary."""
_MOST = 5_000_000
"""More points than any wave table holds: speed or rate has the wrong unit."""
_WHOLE = 1e-6
"""Fraction of a point within which a turn must be a whole number of points."""

PLAYBACK_OPTIONS = (
    Option(
        "polarity",
        "1 if the piezo and the corrected axis count up the same way, -1 if they are opposed",
        "choice",
        required=True,
        choices=(1, -1),
    ),
    Option("travel", "of the piezo stage, from 0", "length", required=True, positive=True),
    Option(
        "offset",
        "where the piezo rests (d_off), so that it can move both ways; half the travel if omitted",
        "length",
    ),
    Option(
        "motion",
        "what runs while the wave is played: one pass at constant speed, or turn after turn",
        "choice",
        default="pass",
        choices=("pass", "turn"),
    ),
    Option("speed", "constant speed of the pass", "speed", positive=True),
    Option(
        "start",
        "position at which the generator starts, in a pass: an end of the table, to use all of it",
        "length",
    ),
    Option("direction", "of motion while the wave plays", "choice", default=1, choices=(1, -1)),
    Option("start_angle", "angle at which the generator starts, in a turn", "angle", default=0.0),
    Option("points", "of one turn", "integer", lowest=2, highest=1_000_000),
    Option("rotation", "speed of the spindle, turns per second", "frequency", positive=True),
    Option("rate", "servo periods that each point lasts", "integer", default=1, lowest=1),
    Option(
        "closing",
        "largest jump of the table from the end of a turn to its beginning",
        "length",
        default=1e-9,
        lowest=0.0,
    ),
    Option("decimals", "of a value in um", "integer", default=6, lowest=1, highest=9),
)
"""What every wave needs to know of the machine."""

TOLD = {
    "pass": ("polarity", "start", "direction", "speed"),
    "turn": ("polarity", "start_angle", "direction"),
}
"""Options, by motion, that are never guessed when a file is read."""


@dataclass(frozen=True, slots=True)
class Playback:
    """Where the moving axis is when the generator puts out each point."""

    start: float  # m or rad: position at point 0
    step: float  # m or rad: from point to point, negative for a pass in - direction
    n: int  # points of the wave
    rate: int  # servo periods that each point lasts
    period: float  # s: servo period
    is_cyclic: bool  # whether point 0 follows the last one, turn after turn
    # whether the generator moves on in a line at every servo period, or holds each point
    interpolates: bool

    @property
    def duration(self) -> float:
        """Time of one cycle in s."""
        return self.n * self.rate * self.period

    @property
    def direction(self) -> int:
        """Direction of motion, 1 or -1."""
        return 1 if self.step > 0 else -1

    def positions(self) -> FloatArray:
        """Return where the axis is at each point, and at the end of the turn."""
        return np.asarray(
            self.start + self.step * np.arange(self.n + self.is_cyclic, dtype=np.float64)
        )

    def played(self, values: FloatArray, position: ArrayLike) -> FloatArray:
        """Return what the generator puts out when the axis is at a position."""
        u = (np.asarray(position, dtype=np.float64) - self.start) / self.step
        u = np.mod(u + _NODE, self.n) if self.is_cyclic else np.clip(u + _NODE, 0.0, self.n - 1)
        k = np.floor(u).astype(np.int64)
        if not self.interpolates:
            return np.asarray(values[k], dtype=np.float64)
        ticks = np.floor((u - k) * self.rate) / self.rate
        after = (k + 1) % self.n if self.is_cyclic else np.minimum(k + 1, self.n - 1)
        return np.asarray(values[k] + (values[after] - values[k]) * ticks, dtype=np.float64)

    def lookup(self, values: FloatArray) -> Simulator:
        """Return the lookup of the wave."""
        return one_way(lambda position: self.played(values, position))


def plan(
    options: dict[str, Any],
    *,
    period: float,
    interpolates: bool,
    n: int | None = None,
    begin: float | None = None,
    end: float | None = None,
) -> Playback:
    """Return the playback of a pass or a turn."""
    rate = int(options["rate"])
    if options["motion"] == "turn":
        told = _turn_points(options, rate * period)
        if n not in (None, told):
            raise DataError(
                f"the file holds {n} points, a turn is said to have {told} (points=, rotation=): the file "
                "was cut, or is another one"
            )
        n = told
        step, start = options["direction"] * _TURN / n, options["start_angle"]
    else:
        if options.get("speed") is None:
            raise DataError(
                "a pass needs speed= (constant speed of the axis, such as '60 mm/min')"
            )
        start = options.get("start")
        if start is None and begin is None:
            raise DataError(
                "a pass needs start=, the position of the axis where the wave begins: that of the "
                "file's first point"
            )
        start = float(cast("float", begin if start is None else start))
        step = options["direction"] * options["speed"] * rate * period
        if n is None:
            n = _pass_points(start, float(end if end is not None else start), step)
    return Playback(
        start=start,
        step=step,
        n=n,
        rate=rate,
        period=period,
        is_cyclic=options["motion"] == "turn",
        interpolates=interpolates,
    )


def chosen(play: Playback, options: dict[str, Any]) -> dict[str, Any]:
    """Return the options that were not given and follow from the table: where a pass starts."""
    if play.is_cyclic or options.get("start") is not None:
        return {}
    return {"start": play.start}


def _turn_points(options: dict[str, Any], dwell: float) -> int:
    points, rotation = options.get("points"), options.get("rotation")
    if rotation is None:
        if points is None:
            raise DataError("a turn needs points= (of one turn) or rotation= (such as '1 Hz')")
        return int(points)
    wanted = 1.0 / (rotation * dwell)
    _require_possible(wanted)
    n: int = round(wanted)
    if n < 2 or abs(wanted - n) > _WHOLE or (points is not None and points != n):
        near = max(n, 2) if points is None else int(points)
        raise DataError(
            f"at {rotation:.9g} turns per second a turn lasts {wanted:.6f} points, so the wave would "
            f"run away from the spindle; turn at {1.0 / (near * dwell):.12g} 1/s for {near} points, "
            "or change rate="
        )
    return n


def _pass_points(start: float, end: float, step: float) -> int:
    _require_possible((end - start) / step)
    n = math.ceil((end - start) / step - _NODE) + 1
    if n < 2:
        raise TableError(
            f"a pass from start={format_length(start)} does not reach the end of the table at "
            f"{format_length(end)}; state where it starts (start=) and its direction"
        )
    return n


def _require_possible(points: float) -> None:
    if points > _MOST:
        raise LimitError(
            f"the wave would have {points:.3g} points; use a larger rate= (or sample_time=), and check "
            "the unit of the speed"
        )


def sampled(
    table: CompensationTable, options: dict[str, Any], *, period: float, interpolates: bool
) -> tuple[Playback, FloatArray]:
    """Return a table's corrections at the points of a wave."""
    if table.reverse is not None:
        raise TableError(
            "a wave is played in one direction of motion, this table has two columns; make one for "
            "each pass (CompensationTable.from_error(direction='forward') and 'reverse')"
        )
    _require_motion(table.axis, options["motion"])
    begin, end = table.span[:: options["direction"]]
    low, high = table.span
    play = plan(options, period=period, interpolates=interpolates, begin=begin, end=end)
    places = play.positions()
    if play.is_cyclic:
        _require_closed(table, options["closing"])
    elif play.direction * (places[0] - (low if play.direction > 0 else high)) < -1e-9 * (
        high - low
    ):
        raise TableError(
            f"the wave starts at {places[0]:.9g}, the table covers {low:.9g} ... {high:.9g} (m or "
            "rad); start inside the table"
        )
    return play, _wanted(table, play, places[: play.n])


def _require_motion(axis: str, motion: str) -> None:
    if is_rotary(axis) and motion != "turn":
        raise TableError(
            f"{axis} turns, and speed= of a pass is a length over time; play it turn after turn "
            "(motion='turn' with points= or rotation=)"
        )
    if motion == "turn" and not is_rotary(axis):
        raise TableError(
            f"motion='turn' is for an axis that turns, {axis} does not: positions would be angles; "
            "play it as a pass"
        )


def dropped(play: Playback, table: CompensationTable) -> tuple[Finding, ...]:
    """Return what part of a table a wave does not play."""
    begin = table.span[0 if play.direction > 0 else 1]
    if play.is_cyclic or play.direction * (play.start - begin) <= 0.5 * abs(play.step):
        return ()
    return (
        Finding(
            "error",
            f"the wave starts at {format_length(play.start)}, the table begins at {format_length(begin)} "
            "in this direction: the part before it is not played, the first point is held there",
            f"say start='{begin * 1e3:.9g} mm', or cut the table",
            "coverage",
        ),
    )


def _require_closed(table: CompensationTable, closing: float) -> None:
    low, high = table.span
    if high - low < _TURN - _NODE:
        raise TableError(
            f"a turn needs 360 deg, the table covers {math.degrees(low):.9g} ... "
            f"{math.degrees(high):.9g} deg; measure the whole turn"
        )
    first, last = (float(v) for v in table.correction([low, low + _TURN]))
    if abs(last - first) > closing:
        raise TableError(
            f"the correction is {format_length(first)} at the beginning of the turn and "
            f"{format_length(last)} at its end: the stage would jump by "
            f"{format_length(abs(last - first))} every turn; take the drift out of the error "
            "(only what repeats can be played), or accept the jump with closing="
        )


def _wanted(table: CompensationTable, play: Playback, places: FloatArray) -> FloatArray:
    """Return the table's corrections, of a turn wherever it starts."""
    low = table.span[0]
    wrapped = low + np.mod(places - low, _TURN) if play.is_cyclic else places
    return np.asarray(table.correction(wrapped))


def rebuilt(play: Playback, values: FloatArray, table: CompensationTable) -> CompensationTable:
    """Return the table that a wave carries."""
    places = play.positions()
    column = np.append(values, values[0]) if play.is_cyclic else values
    order = slice(None, None, play.direction)
    return replace(
        table, positions=places[order], forward=column[order], reverse=None, u=None, source=None
    )


def resampling_error(play: Playback, values: FloatArray, table: CompensationTable) -> float:
    """Return how far the played wave is from the table at most."""
    index = np.arange(play.n - (not play.is_cyclic))[:, None] + np.array([0.0, 0.5, 1.0 - 1e-6])
    places = np.concatenate([play.start + play.step * index.ravel(), table.positions])
    ends = play.positions()[[0, -1]]
    places = places[(places >= ends.min()) & (places <= ends.max())]
    return float(np.abs(play.played(values, places) - _wanted(table, play, places)).max())


def rest_position(options: dict[str, Any]) -> float:
    """Return where the stage rests (d_off): as stated, else half its travel."""
    offset = options.get("offset")
    return float(options["travel"] / 2.0 if offset is None else offset)


def require_travel(play: Playback, values: FloatArray, options: dict[str, Any]) -> FloatArray:
    """Return where the stage must stand at each point, and refuse what is beyond its travel."""
    rest, travel = rest_position(options), float(options["travel"])
    stage = rest + options["polarity"] * values
    beyond = np.maximum(-stage, stage - travel)
    i = int(np.argmax(beyond))
    if beyond[i] > 1e-15:
        raise LimitError(
            f"point {i} at {play.positions()[i]:.9g} (m or rad): a correction of "
            f"{format_length(float(values[i]))} from the rest position {format_length(rest)} needs a "
            f"displacement of {format_length(float(stage[i]))}, the stage moves 0 ... "
            f"{format_length(travel)}; set offset=, or remove offset and line from the error"
        )
    return np.asarray(stage)


def facts(play: Playback, stage: FloatArray) -> dict[str, Any]:
    """Return what the operator must know of a wave."""
    dwell = play.rate * play.period
    jumps = np.diff(np.append(stage, stage[0])) if play.is_cyclic else np.diff(stage)
    places = play.positions()
    known: dict[str, Any] = {
        "points": play.n,
        "direction": play.direction,
        "duration_of_a_cycle_s": play.duration,
        "starts_at": float(places[0]),
        "ends_at": float(places[-1]),
        "stand_before_start_um": float(stage[0]) * 1e6,
        "largest_step_of_a_point_nm": float(np.abs(jumps).max()) * 1e9,
        "largest_stage_speed_um_per_s": float(np.abs(jumps).max()) / dwell * 1e6,
    }
    if play.is_cyclic:
        known["turns_per_minute"] = 60.0 / play.duration
    return known
