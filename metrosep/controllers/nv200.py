"""Arbitrary waveform of the piezosystem jena NV200 amplifier: commands ``gparb``, ``gtarb``.

``gparb,index,value`` sets one of 1024 points, in um of the stage in closed loop; ``gsarb`` and
``gearb`` first and last index, ``goarb`` the one it starts at, ``gcarb`` cycles (0 endless),
``gtarb`` multiples of 50 us that a point lasts, ``grun`` starts. The generator has no offset of its
own: a point is the displacement d_off + polarity x c, with c = -e.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.limits import Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._plain_text import ascii_lines, decimal, known_options
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
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError

__all__ = ["MAX_POINTS", "NV200"]


MAX_POINTS = 1024
"""Points of the buffer."""
_MAX_RATE = 65535
_PERIOD = 50e-6
_UM = 1e-6
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
        points, stated = _parsed(data, path)
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


def _parsed(data: bytes, path: Path) -> tuple[list[float], dict[str, int]]:
    """Return points in um and the settings."""
    lines = ascii_lines(data, path, "file of NV200 commands")
    n = sum(line.startswith("gparb") for line in lines)
    points = []
    for i, line in enumerate(lines[:n]):
        found = _POINT.fullmatch(line)
        if found is None or found[1] != str(i):
            raise _wrong(path, i + 1, f"gparb,{i},value", line)
        points.append(float(found[2]))
    if not 2 <= n <= MAX_POINTS:
        raise CorruptFileError(path, f"a wave has 2 to {MAX_POINTS} points", found=n)
    if len(lines) > n + len(_TAIL):
        raise _wrong(path, n + len(_TAIL) + 1, "the end after grun,1", lines[n + len(_TAIL)])
    stated = {}
    fixed = {"gsarb": 0, "gearb": n - 1, "goarb": 0, "grun": 1}
    for i, name in enumerate(_TAIL, start=n):
        line = lines[i] if i < len(lines) else ""
        word, _, value = line.partition(",")
        wanted = fixed.get(name)
        right = word == name and value.isdecimal() and (wanted is None or value == str(wanted))
        if not right or (name == "gtarb" and not 1 <= int(value) <= _MAX_RATE):
            raise _wrong(path, i + 1, f"{name},{'n' if wanted is None else wanted}", line)
        stated[name] = int(value)
    return points, stated


def _wrong(path: Path, line: int, expected: str, found: str) -> CorruptFileError:
    return CorruptFileError(
        path,
        f"line {line} is not the NV200 command that belongs there",
        expected=expected,
        found=found[:60] or "nothing",
        hint="the file was cut or edited: write it again",
    )
