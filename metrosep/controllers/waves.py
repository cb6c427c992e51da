"""Waves of piezo stages: corrections that a wave generator plays over time and that know no position.

A table of corrections is sampled where the moving axis is at each output of the generator: along a pass
at constant speed, or over one turn of a spindle. `PiGcs`: commands of PI's General Command Set (GCS 2),
``WAV table X PNT 1 n v1 v2 ..`` writes points, ``&`` appends; then WSL connects table and generator, WTR
sets servo periods per point and interpolation, WOS the offset, WGC the cycles, WGO starts. A point is
the correction c = -e of the axis, in the direction in which the piezo counts, in axis units; the
generator adds the offset. The layout is that of PI's own PIPython 2.11, which sends the commands to a
fake controller in tests/acceptance/pi. `NV200`: see there.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, is_described, read_table, settled
from metrosep.controllers._grammar import (
    NUMBER,
    Line,
    Text,
    Word,
    choice,
    decimal,
    decoded,
    joined,
    row_of,
)
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, Simulator, identity, one_way
from metrosep.controllers.options import Option, pick, whole
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.core.units import format_length

_TURN = 2.0 * math.pi
_NODE = 1e-9
"""A point counts as reached this part of a step early: positions are not exact in binary."""
_MOST = 5_000_000
"""More points than any wave table holds: speed or rate has the wrong unit."""
_WHOLE = 1e-6
"""Fraction of a point within which a turn must be a whole number of points."""

PLAYBACK_OPTIONS = (
    pick(
        "polarity",
        "1 if the piezo and the corrected axis count up the same way, -1 if they are opposed",
        (1, -1),
        required=True,
    ),
    Option("travel", "of the piezo stage, from 0", "length", required=True, positive=True),
    Option(
        "offset",
        "where the piezo rests (d_off), so that it can move both ways; half the travel if omitted",
        "length",
    ),
    pick(
        "motion",
        "what runs while the wave is played: one pass at constant speed, or turn after turn",
        ("pass", "turn"),
        default="pass",
    ),
    Option("speed", "constant speed of the pass", "speed", positive=True),
    Option(
        "start",
        "position at which the generator starts, in a pass: an end of the table, to use all of it",
        "length",
    ),
    pick("direction", "of motion while the wave plays", (1, -1), default=1),
    Option("start_angle", "angle at which the generator starts, in a turn", "angle", default=0.0),
    whole("points", "of one turn", 2, 1_000_000),
    Option("rotation", "speed of the spindle, turns per second", "frequency", positive=True),
    whole("rate", "servo periods that each point lasts", 1, default=1),
    Option(
        "closing",
        "largest jump of the table from the end of a turn to its beginning",
        "length",
        default=1e-9,
        lowest=0.0,
    ),
    whole("decimals", "of a value in um", 1, 9, default=6),
)
"""What every wave needs to know of the machine."""

STATED = {
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
    is_turn = options["motion"] == "turn"
    if is_turn:
        wanted = _turn_points(options, rate * period)
        if n not in (None, wanted):
            raise DataError(
                f"the file holds {n} points, a turn was stated to have {wanted} (points=, rotation=): the "
                "file was cut, or is another one"
            )
        n, start = wanted, options["start_angle"]
        step = options["direction"] * _TURN / n
    else:
        if options.get("speed") is None:
            raise DataError(
                "a pass needs speed= (constant speed of the axis, such as '60 mm/min')"
            )
        start = begin if options.get("start") is None else options["start"]
        if start is None:
            raise DataError(
                "a pass needs start=, the position of the axis where the wave begins: that of the "
                "file's first point"
            )
        start = float(start)
        step = options["direction"] * options["speed"] * rate * period
        if n is None:
            last = start if end is None else float(end)
            _require_possible((last - start) / step)
            n = math.ceil((last - start) / step - _NODE) + 1
            if n < 2:
                raise TableError(
                    f"a pass from start={format_length(start)} does not reach the end of the table at "
                    f"{format_length(last)}; state where it starts (start=) and its direction"
                )
    return Playback(start, step, n, rate, period, is_turn, interpolates)


def _turn_points(options: dict[str, Any], dwell: float) -> int:
    """Return the points of a turn: as stated, or as the speed of the spindle asks for."""
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
            "each pass, one with direction='forward' and one with direction='reverse'"
        )
    turns = options["motion"] == "turn"
    if is_rotary(table.axis) and not turns:
        raise TableError(
            f"{table.axis} turns, and speed= of a pass is a length over time; play it turn after turn "
            "(motion='turn' with points= or rotation=)"
        )
    if turns and not is_rotary(table.axis):
        raise TableError(
            f"motion='turn' is for an axis that turns, {table.axis} does not: positions would be "
            "angles; play it as a pass"
        )
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


def dropped(play: Playback, table: CompensationTable) -> tuple[Finding, ...]:
    """Return what part of a table a wave does not play."""
    begin = table.span[0 if play.direction > 0 else 1]
    if play.is_cyclic or play.direction * (play.start - begin) <= 0.5 * abs(play.step):
        return ()
    return (
        Finding.error(
            f"the wave starts at {format_length(play.start)}, the table begins at {format_length(begin)} "
            "in this direction: the part before it is not played, the first point is held there",
            f"say start='{begin * 1e3:.9g} mm', or cut the table",
            "coverage",
        ),
    )


def _require_closed(table: CompensationTable, closing: float) -> None:
    """Refuse a table that is not a whole turn, or that jumps at its end."""
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


def encoded(
    data: bytes,
    play: Playback,
    values: FloatArray,
    table: CompensationTable,
    options: Mapping[str, Any],
    *,
    findings: Iterable[Finding] = (),
    **more: Any,
) -> Encoded:
    """Return the bytes of a wave with what it carries of a table, and where a pass starts."""
    follows = play.is_cyclic or options.get("start") is not None
    return Encoded(
        data=data,
        carried=rebuilt(play, values, table),
        resampling_error=resampling_error(play, values, table),
        options={} if follows else {"start": play.start},
        findings=(*dropped(play, table), *findings),
        **more,
    )


def read_wave(play: Playback, values: FloatArray, path: Path) -> CompensationTable:
    """Return the table that a file plays, with the axes of its sidecar."""
    ends = play.positions()[[0, -1]]
    names = identity(path, first=float(ends.min()))
    if not ends.min() <= names["reference"] <= ends.max():
        names["reference"] = float(ends.min())
    blank = read_table(np.array([0.0, 1.0]), np.zeros(2), **names)
    return rebuilt(play, values, blank)


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


def rest_position(options: Mapping[str, Any]) -> float:
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


# ---- what both generators have in common --------------------------------------------------------

_UM = 1e-6
_POSITIVE = Word(r"[1-9]\d{0,8}", int)


class _Wave(Dialect):
    """A generator whose commands set points in um; `adds_offset` if it adds the rest position itself."""

    adds_offset: ClassVar[bool]
    needed: ClassVar[tuple[str, ...]] = ("travel",)
    commands: ClassVar[tuple[tuple[str, str], ...]]
    endless: ClassVar[str]

    @abstractmethod
    def _clock(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the servo period, and whether the generator draws lines between points."""

    @abstractmethod
    def _lines(self, points: list[str], play: Playback, options: Mapping[str, Any]) -> list[str]:
        """Return the commands of a wave whose points are printed."""

    @abstractmethod
    def _parsed(self, data: bytes, path: Path) -> tuple[list[float], dict[str, Any]]:
        """Return the points in um and what the commands state."""

    def _room(self, options: Mapping[str, Any]) -> tuple[int | None, str]:
        """Return how many points the generator holds, and its name."""
        return options["memory"], "wave table"

    def _findings(
        self, play: Playback, stage: FloatArray, options: Mapping[str, Any]
    ) -> Iterable[Finding]:
        """Return what is doubtful about a wave."""
        return ()

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        play, values = sampled(table, options, **self._clock(options))
        room, what = self._room(options)
        if room is not None and play.n > room:
            least = -(-play.n * play.rate // room)
            raise LimitError(
                f"{play.n} points, the {what} holds {room}; use rate={least} or more (a point then "
                f"lasts {least * play.period * 1e3:.6g} ms), or a shorter pass"
            ).hinting(rate=least)
        stage = require_travel(play, values, options)
        polarity, places, rest = options["polarity"], options["decimals"], rest_position(options)
        offset = float(decimal(round(rest / _UM, places))) if self.adds_offset else rest / _UM
        points = polarity * values if self.adds_offset else stage
        printed = [decimal(round(v / _UM, places)) for v in points]
        back = np.array([float(v) for v in printed]) * _UM - (0.0 if self.adds_offset else rest)
        return encoded(
            joined(self._lines(printed, play, options)), play, values, table, options,
            quantisation=float(np.abs(polarity * back - values).max()),
            notes={"playback": {**facts(play, stage), "offset_um": offset}},
            step=10.0**-places * _UM,
            findings=self._findings(play, stage, options),
        )  # fmt: skip

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the corrections that the commands carry."""
        return read_wave(*self._read(data, path, options), path)

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the generator puts out while the axis moves as stated."""
        play, values = self._read(data, path, options)
        return play.lookup(values)

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[Playback, FloatArray]:
        points, stated = self._parsed(data, path)
        offset = stated.pop("offset_um", None)
        cycles = stated.pop("cycles")
        for name, command in self.commands:
            agreed(path, name, {command: stated[name], "you": options.get(name)})
        motion = "pass" if cycles else "turn"
        has_defaults = is_described(path)
        known = settled(
            self.options, {**options, **stated}, path, file=stated,
            needed=() if has_defaults else (*self.needed, *STATED[motion]),
        )  # fmt: skip
        if known["motion"] != motion:
            raise CorruptFileError(
                path,
                f"{self.endless} does not fit the motion: 0 cycles are endless, for a turn; 1 is for a "
                "pass",
                field=self.endless,
                found=cycles,
                expected=0 if known["motion"] == "turn" else 1,
            )
        play = plan(known, **self._clock(known), n=len(points))
        slack, rest = 10.0 ** -known["decimals"], rest_position(known) / _UM
        is_stated = offset is not None and (known["offset"] is not None or has_defaults)
        if is_stated and abs(offset - rest) > slack:
            raise CorruptFileError(
                path, "WOS is not the offset that is stated", field="WOS", expected=f"{rest:.9g} um",
                found=f"{offset:.9g} um", hint="leave offset= away, or look for the right file",
            )  # fmt: skip
        stage, travel = np.array(points) + (offset or 0.0), known["travel"] / _UM
        worst = int(np.argmax(np.maximum(-stage, stage - travel)))
        if not -2 * slack <= stage[worst] <= travel + 2 * slack:
            raise CorruptFileError(
                path, f"point {worst + self.adds_offset} is beyond the travel of the stage",
                field="WAV, WOS" if self.adds_offset else "gparb",
                expected=f"0 ... {travel:.9g} um", found=f"{stage[worst]:.9g} um",
                hint="the file was edited, or travel= is that of another stage",
            )  # fmt: skip
        moved = np.array(points) * _UM - (0.0 if self.adds_offset else rest_position(known))
        return play, np.asarray(known["polarity"] * moved)


# ---- PI -----------------------------------------------------------------------------------------

_WAVE = Line(
    "WAV {wave_table} {mode} PNT {first} {count} {points}",
    mode=Word("[X&]"),
    points=row_of(NUMBER),
)
_COMMANDS = (
    Line("WSL {generator} {wave_table}", generator=_POSITIVE),
    Line("WTR {generator} {rate} {interpolation}", rate=_POSITIVE, interpolation=choice(0, 1)),
    Line("WOS {generator} {offset_um}", offset_um=NUMBER),
    Line("WGC {generator} {cycles}", cycles=choice(0, 1)),
    Line("WGO {generator} {start_mode}", start_mode=choice(1, 2)),
)


class PiGcs(_Wave):
    """Writer and reader of PI wave tables; see the module."""

    info = DialectInfo(
        id="pi-gcs",
        title="PI wave generator, GCS commands WAV PNT",
        entry="polarity x correction: polarity x (-e); the generator adds the offset (WOS)",
        units="axis units, um",
        outside="the wave's first and last point are held before and after a pass; a turn repeats",
        sign_status="an axis moves to the value sent; which way the piezo moves the tool is yours to "
        "state (polarity)",
        activation=(
            "close the servo loop of the stage (SVO), check its range; the wave table is overwritten",
            "move the stage (MOV) to 'stand_before_start_um' of the sidecar, or it jumps at the start",
            "send all lines but the last, and read the points back with GWD?",
            "send the last line (WGO) as the axis passes the start at its speed, or start_mode=2: a trigger",
            "try it once with the tool off the part: the stage must move against the error",
        ),
        sign="stated",
        spacing="uniform",
        directions="one",
        resolution="1 pm as printed; the stage's own resolution is coarser",
        reference_rule="none: the offset may stand anywhere in the travel",
        proof="command strings of PIPython 2.11 on a fake controller; own strict parser",
        suffix=".gcs",
        example={"polarity": 1, "travel": "15 um", "speed": "60 mm/min", "rate": 200},
        page="pi",
    )
    options = (
        *PLAYBACK_OPTIONS,
        whole("generator", "number of the wave generator (of the axis)", 1, default=1),
        whole("wave_table", "number of the wave table", 1, default=1),
        pick("interpolation", "0 holds each point, 1 draws lines between points at every servo period", (0, 1), default=1),
        Option("servo_time", "servo period of the controller", "time", default=50e-6, positive=True),
        whole("memory", "points that the wave table holds, where you know it", 2),
        whole("bunch", "points in one command", 1, 1000, default=10),
        pick("start_mode", "of WGO: 1 at once, 2 by the trigger input", (1, 2), default=1),
    )  # fmt: skip
    adds_offset = True
    endless = "WGC"
    commands = (
        ("generator", "WSL"),
        ("wave_table", "WAV"),
        ("rate", "WTR"),
        ("interpolation", "WTR"),
        ("start_mode", "WGO"),
    )

    def _clock(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the servo period, and whether lines are drawn."""
        return {"period": options["servo_time"], "interpolates": options["interpolation"] == 1}

    def _lines(self, points: list[str], play: Playback, options: Mapping[str, Any]) -> list[str]:
        """Return the points in bunches, then the settings."""
        stated = {
            **options, "rate": play.rate, "cycles": 0 if play.is_cyclic else 1,
            "offset_um": decimal(round(rest_position(options) / _UM, options["decimals"])),
        }  # fmt: skip
        bunches = [
            (i, points[i : i + options["bunch"]]) for i in range(0, len(points), options["bunch"])
        ]
        return [
            *(
                _WAVE.write(
                    wave_table=options["wave_table"],
                    mode="&" if i else "X",
                    first=i + 1,
                    count=len(b),
                    points=b,
                )
                for i, b in bunches
            ),
            *(command.write(**stated) for command in _COMMANDS),
        ]

    def _parsed(self, data: bytes, path: Path) -> tuple[list[float], dict[str, Any]]:
        """Return the points in um and what the commands state."""
        lines = decoded(data, path, "file of GCS commands").splitlines()
        text = Text(path, list(enumerate(lines, start=1)), "file of GCS commands")
        points: list[float] = []
        table: dict[str, int] = {}
        while not points or (text and text.rows[text.at][1].startswith("WAV ")):
            bunch = text.take(_WAVE, mode="&" if points else "X", first=len(points) + 1, **table)
            table = {"wave_table": bunch["wave_table"]}
            points += bunch["points"]
            if bunch["count"] != len(bunch["points"]):
                raise text.wrong(f"{bunch['count']} points as WAV says", ahead=-1)
        if len(points) < 2:
            raise CorruptFileError(path, "a wave needs at least 2 points", found=len(points))
        stated = text.take(_COMMANDS[0], **table)
        for command in _COMMANDS[1:]:
            stated |= text.take(command, generator=stated["generator"])
        text.end()
        return points, stated

    def _findings(
        self, play: Playback, stage: FloatArray, options: Mapping[str, Any]
    ) -> Iterable[Finding]:
        """Return what is doubtful about a wave."""
        if options["memory"] is None:
            text = f"{play.n} points: how many the controller holds was not checked"
            yield Finding.warning(text, "state memory=", "memory")
        rest = rest_position(options)
        start = abs(float(stage[0]) - rest)
        if start > 1e-9:
            text = (
                f"the wave begins {start * 1e9:.4g} nm from the rest position {rest / _UM:.6g} um: "
                "started from there the stage jumps by it"
            )
            yield Finding.warning(text, f"move it to {stage[0] / _UM:.6f} um before", "start")


# ---- piezosystem jena ---------------------------------------------------------------------------

MAX_POINTS = 1024
"""Points of the buffer of an NV200."""
_MAX_RATE = 65535
_POINT = Line("gparb,{index},{um}", um=NUMBER)
_SETTINGS = tuple(
    Line(f"{name},{{{name}}}") for name in ("gsarb", "gearb", "goarb", "gcarb", "gtarb", "grun")
)


class NV200(_Wave):
    """Writer and reader of arbitrary waveforms for the piezosystem jena NV200 amplifier.

    ``gparb,index,value`` sets one of 1024 points, in um of the stage in closed loop; ``gsarb`` and
    ``gearb`` first and last index, ``goarb`` the one it starts at, ``gcarb`` cycles (0 endless), ``gtarb``
    multiples of 50 us that a point lasts, ``grun`` starts. The generator has no offset of its own: a point
    is the displacement d_off + polarity x c, with c = -e.
    """

    info = replace(
        PiGcs.info,
        id="nv200",
        title="piezosystem jena NV200 arbitrary waveform",
        entry="displacement of the stage: offset + polarity x correction = d_off + polarity x (-e)",
        units="um, closed loop",
        max_points=MAX_POINTS,
        outside="first and last point are held before and after a pass; a turn repeats",
        sign_status="the stage moves to the value sent; which way it moves the tool is yours to "
        "state (polarity)",
        activation=(
            "close the loop (cl,1) and check posmin and posmax of the stage against its travel",
            "move the stage to 'stand_before_start_um' of the sidecar, or it jumps at the start",
            "choose the generator as setpoint source (modsrc,3), then send all lines but the last",
            "send grun,1 as the axis passes the start at its speed",
            "try it once with the tool off the part: the stage must move against the error",
        ),
        resolution="1 pm as printed; the amplifier's is coarser",
        proof="own strict parser and simulated staircase",
        suffix=".txt",
        example={"polarity": 1, "travel": "15 um", "speed": "60 mm/min", "rate": 1000},
    )  # fmt: skip
    options = PLAYBACK_OPTIONS
    adds_offset = False
    needed = ("travel", "offset")
    endless = "gcarb"
    commands = (("rate", "gtarb"),)

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of the machine; points are counted in `encode`, of the wave."""
        return super().limits(**{"max_points": None, **machine})

    def _clock(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the period of the amplifier; it holds each point."""
        if options["rate"] > _MAX_RATE:
            raise LimitError(f"rate={options['rate']}; gtarb takes 1 to {_MAX_RATE}")
        return {"period": 50e-6, "interpolates": False}

    def _room(self, options: Mapping[str, Any]) -> tuple[int | None, str]:
        """Return how many points the generator holds, and its name."""
        return MAX_POINTS, "NV200"

    def _lines(self, points: list[str], play: Playback, options: Mapping[str, Any]) -> list[str]:
        """Return the points, then the settings."""
        values = _settings(play.n, gcarb=0 if play.is_cyclic else 1, gtarb=play.rate)
        return [
            *(_POINT.write(index=i, um=v) for i, v in enumerate(points)),
            *(setting.write(**values) for setting in _SETTINGS),
        ]

    def _parsed(self, data: bytes, path: Path) -> tuple[list[float], dict[str, Any]]:
        """Return points in um and the settings."""
        lines = decoded(data, path, "file of NV200 commands").splitlines()
        text = Text(path, list(enumerate(lines, start=1)), "file of NV200 commands")
        points: list[float] = []
        while text and text.rows[text.at][1].startswith("gparb"):
            points.append(text.take(_POINT, index=len(points))["um"])
        if not 2 <= len(points) <= MAX_POINTS:
            raise CorruptFileError(path, f"a wave has 2 to {MAX_POINTS} points", found=len(points))
        stated: dict[str, int] = {}
        for setting, (name, value) in zip(_SETTINGS, _settings(len(points)).items(), strict=True):
            stated |= text.take(setting, **({} if value is None else {name: value}))
        text.end()
        if stated["gcarb"] > 1 or not 1 <= stated["gtarb"] <= _MAX_RATE:
            text.at -= 3
            raise text.wrong(f"0 or 1 cycles, gtarb from 1 to {_MAX_RATE}")
        return points, {"cycles": stated["gcarb"], "rate": stated["gtarb"]}


def _settings(n: int, gcarb: int | None = None, gtarb: int | None = None) -> dict[str, int | None]:
    """Return the settings of a wave of n points; None where they are free."""
    return {"gsarb": 0, "gearb": n - 1, "goarb": 0, "gcarb": gcarb, "gtarb": gtarb, "grun": 1}
