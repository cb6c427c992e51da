"""Wave tables of piezo stages: commands of PI's General Command Set (GCS 2).

``WAV table X PNT 1 n v1 v2 ..`` writes points, ``&`` appends; then WSL connects table and generator,
WTR sets servo periods per point and interpolation, WOS the offset, WGC the cycles, WGO starts.
A point is the correction c = -e of the axis, in the direction in which the piezo counts, in axis
units; the generator adds the offset. The layout of the commands is that of PI's own PIPython 2.11,
which sends them to a fake controller in tests/acceptance/pi.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.limits import Finding, Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._plain_text import ascii_lines, decimal, is_described, known_options
from metrosep.controllers._playback import (
    PLAYBACK_OPTIONS,
    TOLD,
    Playback,
    chosen,
    dropped,
    facts,
    plan,
    rebuilt,
    require_travel,
    resampling_error,
    rest_position,
    sampled,
)
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, Simulator, identity
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError

__all__ = ["PiGcs"]

_UM = 1e-6
_NUMBER = re.compile(r"-?\d+(\.\d+)?")
"""A value as we and the controller write it; an exponent is legal there but never written."""
_FROM_FILE = {
    "generator": "WSL",
    "wave_table": "WAV",
    "rate": "WTR",
    "interpolation": "WTR",
    "start_mode": "WGO",
}
"""Options that the commands state themselves."""


class PiGcs(Dialect):
    """Writer and reader of PI wave tables; see the module."""

    info = DialectInfo(
        id="pi-gcs",
        title="PI wave generator, GCS commands WAV PNT",
        entry="polarity x correction: polarity x (-e); the generator adds the offset (WOS)",
        units="axis units, um",
        max_points=None,
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
        example={
            "polarity": 1,
            "travel": "15 um",
            "speed": "60 mm/min",
            "rate": 200,
        },
        page="pi",
    )
    options = (
        *PLAYBACK_OPTIONS,
        Option("generator", "number of the wave generator (of the axis)", "integer", default=1, lowest=1),
        Option("wave_table", "number of the wave table", "integer", default=1, lowest=1),
        Option(
            "interpolation",
            "0 holds each point, 1 draws lines between points at every servo period",
            "choice",
            default=1,
            choices=(0, 1),
        ),
        Option("servo_time", "servo period of the controller", "time", default=50e-6, positive=True),
        Option("memory", "points that the wave table holds, where you know it", "integer", lowest=2),
        Option("bunch", "points in one command", "integer", default=10, lowest=1, highest=1000),
        Option(
            "start_mode", "of WGO: 1 at once, 2 by the trigger input", "choice", default=1, choices=(1, 2)
        ),
    )  # fmt: skip

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the commands."""
        play, values = sampled(
            table,
            options,
            period=options["servo_time"],
            interpolates=options["interpolation"] == 1,
        )
        _require_memory(play, options["memory"])
        stage = require_travel(play, values, options)
        polarity, places = options["polarity"], options["decimals"]
        printed = [decimal(round(v / _UM, places)) for v in polarity * values]
        offset = decimal(round(rest_position(options) / _UM, places))
        back = polarity * np.array([float(v) for v in printed]) * _UM
        lines = _points(printed, options["wave_table"], options["bunch"])
        g = options["generator"]
        lines += [
            f"WSL {g} {options['wave_table']}",
            f"WTR {g} {play.rate} {options['interpolation']}",
            f"WOS {g} {offset}",
            f"WGC {g} {0 if play.is_cyclic else 1}",
            f"WGO {g} {options['start_mode']}",
        ]
        return Encoded(
            data=("\n".join(lines) + "\n").encode("ascii"),
            quantisation=float(np.abs(back - values).max()),
            notes={"playback": {**facts(play, stage), "offset_um": float(offset)}},
            step=10.0**-places * _UM,
            carried=rebuilt(play, values, table),
            resampling_error=resampling_error(play, values, table),
            options=chosen(play, options),
            findings=(*dropped(play, table), *_findings(play, stage, options)),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the corrections that the commands carry."""
        play, values = self._read(data, path, options)
        first = min(play.positions()[[0, -1]])
        names = identity(path, first=float(first))
        places = play.positions()
        blank = CompensationTable(
            np.array([0.0, 1.0]), np.zeros(2), None, names["axis"], names["compensates"],
            names["reference"] if places.min() <= names["reference"] <= places.max() else float(first),
            removed=names["removed"], is_exact_inverse=True,
        )  # fmt: skip
        return rebuilt(play, values, blank)

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the generator puts out while the axis moves as stated."""
        play, values = self._read(data, path, options)
        return play.lookup(values)

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[Playback, FloatArray]:
        points, stated = _parsed(data, path)
        motion = "pass" if stated["cycles"] else "turn"
        known = known_options(options, path, self.options, ("travel", *TOLD[motion]))
        for name, command in _FROM_FILE.items():
            if options.get(name) is not None and options[name] != stated[name]:
                raise DataError(
                    f"{path}: {command} says {name}={stated[name]}, not {options[name]}; leave "
                    f"{name}= away, or look for the right file"
                )
        known.update(stated)
        if (known["motion"] == "turn") != (stated["cycles"] == 0):
            raise CorruptFileError(
                path,
                "WGC does not fit the motion: 0 cycles are endless, for a turn; 1 is for a pass",
                field="WGC",
                found=stated["cycles"],
                expected=0 if known["motion"] == "turn" else 1,
            )
        play = plan(
            known,
            period=known["servo_time"],
            interpolates=stated["interpolation"] == 1,
            n=len(points),
        )
        _require_reachable(points, stated["offset_um"], known, path)
        return play, known["polarity"] * np.array(points) * _UM


def _require_reachable(
    points: list[float], offset_um: float, known: dict[str, Any], path: Path
) -> None:
    """Refuse an offset that is not the one stated, and points beyond the travel."""
    travel, slack = known["travel"] / _UM, 10.0 ** -known["decimals"]
    if known["offset"] is not None or is_described(path):
        rest = rest_position(known) / _UM
        if abs(offset_um - rest) > slack:
            raise CorruptFileError(
                path, "WOS is not the offset that is stated", field="WOS", expected=f"{rest:.9g} um",
                found=f"{offset_um:.9g} um", hint="leave offset= away, or look for the right file",
            )  # fmt: skip
    stage = offset_um + np.array(points)
    worst = int(np.argmax(np.maximum(-stage, stage - travel)))
    if not -2 * slack <= stage[worst] <= travel + 2 * slack:
        raise CorruptFileError(
            path, f"point {worst + 1} is beyond the travel of the stage", field="WAV, WOS",
            expected=f"0 ... {travel:.9g} um", found=f"{stage[worst]:.9g} um",
            hint="the file was edited, or travel= is that of another stage",
        )  # fmt: skip


def _points(printed: list[str], table: int, bunch: int) -> list[str]:
    lines = []
    for first in range(0, len(printed), bunch):
        part = printed[first : first + bunch]
        mode = "&" if first else "X"
        lines.append(f"WAV {table} {mode} PNT {first + 1} {len(part)} {' '.join(part)}")
    return lines


def _require_memory(play: Playback, memory: int | None) -> None:
    if memory is not None and play.n > memory:
        least = -(-play.n * play.rate // memory)
        raise LimitError(
            f"{play.n} points, the wave table holds {memory}; use rate={least} or more "
            f"(a point then lasts {least * play.period * 1e3:.6g} ms), or a shorter pass"
        )


def _findings(play: Playback, stage: FloatArray, options: dict[str, Any]) -> tuple[Finding, ...]:
    found = []
    if options["memory"] is None:
        found.append(
            Finding(
                "warning",
                f"{play.n} points: how many the controller holds was not checked",
                "state memory=",
                "memory",
            )
        )
    rest = rest_position(options)
    start = abs(float(stage[0]) - rest)
    if start > 1e-9:
        found.append(
            Finding(
                "warning",
                f"the wave begins {start * 1e9:.4g} nm from the rest position {rest / _UM:.6g} um: "
                "started from there the stage jumps by it",
                f"move it to {stage[0] / _UM:.6f} um before",
                "start",
            )
        )
    return tuple(found)


def _parsed(data: bytes, path: Path) -> tuple[list[float], dict[str, Any]]:
    """Return points in file units and what the commands state."""
    lines = ascii_lines(data, path, "file of GCS commands")
    rows = [(i, line.split(" ")) for i, line in enumerate(lines, start=1)]
    waves = [r for r in rows if r[1][0] == "WAV"]
    points: list[float] = []
    table = 0
    for number, words in rows[: len(waves)]:
        table, values = _bunch(words, number, path, len(points), table)
        points += values
    if len(points) < 2:
        raise CorruptFileError(path, "a wave needs at least 2 points", found=len(points))
    tail = rows[len(waves) :]
    wanted = (("WSL", 2), ("WTR", 3), ("WOS", 2), ("WGC", 2), ("WGO", 2))
    numbers = [
        _command(tail[i] if i < len(tail) else (len(rows), ["nothing"]), name, count, path)
        for i, (name, count) in enumerate(wanted)
    ]
    if len(tail) > len(wanted):
        extra = tail[len(wanted)]
        raise _wrong(path, extra[0], "the end of the file after WGO", extra[1])
    return points, _stated(numbers, table, tail, path)


def _stated(
    numbers: list[list[float]], table: int, tail: list[tuple[int, list[str]]], path: Path
) -> dict[str, Any]:
    select, rate, offset, cycles, start = numbers
    for row, found in zip(tail, numbers, strict=False):
        if found[0] != select[0]:
            raise _wrong(path, row[0], f"generator {select[0]:.0f} as in WSL", row[1])
    whole = [*select, *rate, cycles[1], start[1]]
    if any(v != int(v) or v < 0 for v in whole) or min(select[0], rate[1]) < 1:
        raise _wrong(
            path, tail[0][0], "whole numbers of generator, table, rate, cycles", tail[0][1]
        )
    if select[1] != table:
        raise _wrong(path, tail[0][0], f"wave table {table} as in WAV", tail[0][1])
    if rate[2] not in (0, 1):
        raise _wrong(path, tail[1][0], "interpolation 0 or 1", tail[1][1])
    if cycles[1] not in (0, 1):
        raise _wrong(path, tail[3][0], "0 cycles (endless) or 1", tail[3][1])
    if start[1] not in (1, 2):
        raise _wrong(path, tail[4][0], "start mode 1 or 2", tail[4][1])
    return {
        "generator": int(select[0]),
        "wave_table": table,
        "rate": int(rate[1]),
        "interpolation": int(rate[2]),
        "offset_um": offset[1],
        "cycles": int(cycles[1]),
        "start_mode": int(start[1]),
    }


def _bunch(
    words: list[str], number: int, path: Path, before: int, table: int
) -> tuple[int, list[float]]:
    """Return wave table and points of one WAV command that follows `before` points."""
    head = words[:6]
    mode = "&" if before else "X"
    right = (
        len(head) == 6
        and head[0] == "WAV"
        and head[1].isdecimal()
        and (not before or int(head[1]) == table)
        and head[2] == mode
        and head[3] == "PNT"
        and head[4] == str(before + 1)
        and head[5].isdecimal()
        and int(head[5]) == len(words) - 6 > 0
        and all(map(_NUMBER.fullmatch, words[6:]))
    )
    if not right:
        raise _wrong(
            path, number, f"WAV table {mode} PNT {before + 1} and as many values as it says", words
        )
    return int(head[1]), [float(w) for w in words[6:]]


def _command(row: tuple[int, list[str]], name: str, count: int, path: Path) -> list[float]:
    number, words = row
    if words[0] != name or len(words) != count + 1 or not all(map(_NUMBER.fullmatch, words[1:])):
        raise _wrong(path, number, f"{name} with {count} numbers", words)
    return [float(w) for w in words[1:]]


def _wrong(path: Path, line: int, expected: str, words: list[str]) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {line} is not the GCS command that belongs there",
        expected=expected,
        found=" ".join(words)[:60],
        hint="the file was cut or edited: write it again",
    )


# ---- arbitrary waveform of the piezosystem jena NV200 amplifier: commands ``gparb``, ``gtarb`` ----
# ``gparb,index,value`` sets one of 1024 points, in um of the stage in closed loop; ``gsarb`` and
# ``gearb`` first and last index, ``goarb`` the one it starts at, ``gcarb`` cycles (0 endless),
# ``gtarb`` multiples of 50 us that a point lasts, ``grun`` starts. The generator has no offset of its
# own: a point is the displacement d_off + polarity x c, with c = -e.

MAX_POINTS = 1024
"""Points of the buffer."""
_MAX_RATE = 65535
_PERIOD = 50e-6
_POINT = re.compile(r"gparb,(\d+),(-?\d+(?:\.\d+)?)")
_TAIL = ("gsarb", "gearb", "goarb", "gcarb", "gtarb", "grun")


class NV200(Dialect):
    """Writer and reader of waveforms for the NV200; see the module."""

    info = DialectInfo(
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
        sign="stated",
        spacing="uniform",
        directions="one",
        resolution="1 pm as printed; the amplifier's is coarser",
        reference_rule="none: the offset may stand anywhere in the travel",
        proof="own strict parser and simulated staircase",
        suffix=".txt",
        example={"polarity": 1, "travel": "15 um", "speed": "60 mm/min", "rate": 1000},
        page="pi",
    )  # fmt: skip
    options = PLAYBACK_OPTIONS

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the commands."""
        if options["rate"] > _MAX_RATE:
            raise LimitError(f"rate={options['rate']}; gtarb takes 1 to {_MAX_RATE}")
        play, values = sampled(table, options, period=_PERIOD, interpolates=False)
        if play.n > MAX_POINTS:
            least = -(-play.n * play.rate // MAX_POINTS)
            raise LimitError(
                f"{play.n} points, the NV200 holds {MAX_POINTS}; use rate={least} or more (a point "
                f"then lasts {least * _PERIOD * 1e3:.6g} ms), or a shorter pass"
            )
        stage = require_travel(play, values, options)
        places = options["decimals"]
        printed = [decimal(round(v / _UM, places)) for v in stage]
        back = np.array([float(v) for v in printed]) * _UM - rest_position(options)
        lines = [f"gparb,{i},{v}" for i, v in enumerate(printed)]
        settings = (0, play.n - 1, 0, 0 if play.is_cyclic else 1, play.rate, 1)
        lines += [f"{name},{value}" for name, value in zip(_TAIL, settings, strict=True)]
        return Encoded(
            data=("\n".join(lines) + "\n").encode("ascii"),
            quantisation=float(np.abs(options["polarity"] * back - values).max()),
            notes={"playback": {**facts(play, stage), "offset_um": rest_position(options) / _UM}},
            step=10.0**-places * _UM,
            carried=rebuilt(play, values, table),
            resampling_error=resampling_error(play, values, table),
            options=chosen(play, options),
            findings=dropped(play, table),
        )

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of the machine; points are counted in `encode`, of the wave."""
        return super().limits(**{"max_points": None, **machine})

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the corrections that the commands carry."""
        play, values = self._read(data, path, options)
        places = play.positions()
        first = float(places.min())
        names = identity(path, first=first)
        inside = places.min() <= names["reference"] <= places.max()
        blank = CompensationTable(
            positions=np.array([0.0, 1.0]),
            forward=np.zeros(2),
            reverse=None,
            is_exact_inverse=True,
            **{**names, "reference": names["reference"] if inside else first},
        )
        return rebuilt(play, values, blank)

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the generator puts out while the axis moves as stated."""
        play, values = self._read(data, path, options)
        return play.lookup(values)

    def _read(
        self, data: bytes, path: Path, options: dict[str, Any]
    ) -> tuple[Playback, FloatArray]:
        points, stated = _nv200_parsed(data, path)
        motion = "pass" if stated["gcarb"] else "turn"
        known = known_options(options, path, self.options, ("travel", "offset", *TOLD[motion]))
        if options.get("rate") is not None and options["rate"] != stated["gtarb"]:
            raise DataError(
                f"{path}: gtarb says rate={stated['gtarb']}, not {options['rate']}; leave rate= away"
            )
        endless = known["motion"] == "turn"
        if stated["gcarb"] != (0 if endless else 1):
            raise CorruptFileError(
                path,
                f"gcarb does not fit motion={known['motion']!r}",
                expected=0 if endless else 1,
                found=stated["gcarb"],
            )
        known["rate"] = stated["gtarb"]
        play = plan(known, period=_PERIOD, interpolates=False, n=len(points))
        stage = np.array(points) * _UM
        slack = 2.0 * 10.0 ** -known["decimals"] * _UM
        worst = int(np.argmax(np.maximum(-stage, stage - known["travel"])))
        if not -slack <= stage[worst] <= known["travel"] + slack:
            raise CorruptFileError(
                path, f"point {worst} is beyond the travel of the stage", field="gparb",
                expected=f"0 ... {known['travel'] / _UM:.9g} um", found=f"{points[worst]:.9g} um",
                hint="the file was edited, or travel= is that of another stage",
            )  # fmt: skip
        return play, np.asarray(known["polarity"] * (stage - rest_position(known)))


def _nv200_parsed(data: bytes, path: Path) -> tuple[list[float], dict[str, int]]:
    """Return points in um and the settings."""
    lines = ascii_lines(data, path, "file of NV200 commands")
    n = sum(line.startswith("gparb") for line in lines)
    points = []
    for i, line in enumerate(lines[:n]):
        found = _POINT.fullmatch(line)
        if found is None or found[1] != str(i):
            raise _nv200_wrong(path, i + 1, f"gparb,{i},value", line)
        points.append(float(found[2]))
    if not 2 <= n <= MAX_POINTS:
        raise CorruptFileError(path, f"a wave has 2 to {MAX_POINTS} points", found=n)
    if len(lines) > n + len(_TAIL):
        raise _nv200_wrong(path, n + len(_TAIL) + 1, "the end after grun,1", lines[n + len(_TAIL)])
    stated = {}
    fixed = {"gsarb": 0, "gearb": n - 1, "goarb": 0, "grun": 1}
    for i, name in enumerate(_TAIL, start=n):
        line = lines[i] if i < len(lines) else ""
        word, _, value = line.partition(",")
        wanted = fixed.get(name)
        right = word == name and value.isdecimal() and (wanted is None or value == str(wanted))
        if not right or (name == "gtarb" and not 1 <= int(value) <= _MAX_RATE):
            raise _nv200_wrong(path, i + 1, f"{name},{'n' if wanted is None else wanted}", line)
        stated[name] = int(value)
    return points, stated


def _nv200_wrong(path: Path, line: int, expected: str, found: str) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {line} is not the NV200 command that belongs there",
        expected=expected,
        found=found[:60] or "nothing",
        hint="the file was cut or edited: write it again",
    )
