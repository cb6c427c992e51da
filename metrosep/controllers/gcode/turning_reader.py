"""The strict reader of turning programs: it knows the machine, and nothing of what was meant.

A word that is not understood is refused with its line. G1 and rapid moves are lines whatever a head says.
specs/cutting-path.md, section 9.
"""

from __future__ import annotations

import math
import os
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from metrosep.controllers.gcode.lathe import LatheAxes
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, ReadError
from metrosep.process._plain import frozen
from metrosep.process.cutting.programs import Quantity, TurningProgram

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_PLAIN = re.compile(
    rf"(?:N[0-9]+ ?)?X({_NUMBER}) ?C({_NUMBER}) ?Z({_NUMBER})(?: ?F({_NUMBER}))?\s*"
)
_PVT = re.compile(
    rf"X({_NUMBER}):({_NUMBER}) C({_NUMBER}):({_NUMBER}) Z({_NUMBER}):({_NUMBER})\s*"
)
_TOKEN = re.compile(rf"\s*(?:([A-Z]+)({_NUMBER})?|(%))")
_SPLINES = {"CSPLINE": "spline"}
_SAID = re.compile(r"[(#/ ]*(?:quantity (tip|cut points)|interpolation (linear|spline))\b")
_ENDS = {"M30", "M2", "M99", "M17", "RET", "%"}
"""Of a program, or of one that another calls."""
_QUIET = {"BAUTO", "EAUTO", "G61", "G40", "G49", "G17", "G18", "M3", "M4", "M5", *_ENDS}
MARK = "METROSEP TURNING PROGRAM"
"""In the head of a file that `write_program` closes with M30."""


def read_program(
    path: str | os.PathLike[str],
    axes: LatheAxes,
    *,
    quantity: Quantity | None = None,
    interpolation: Literal["linear", "spline"] | None = None,
    velocity_time: float | None = None,
) -> TurningProgram:
    """Return the program of a file as a machine would run it.

    Parameters
    ----------
    path : path
        G-code with X, C and Z words, PVT blocks of a PMAC, or a CSV of points.
    axes : LatheAxes
        What the words of the machine mean: sign and zero of C, radius or diameter, units.
    quantity : {"tip", "cut points"}, optional
        What the points are; by default what the head of the file says.
    interpolation : {"linear", "spline"}, optional
        What the control makes of a list of points, where the file does not say; G1 is always a line.
    velocity_time : float, s, optional
        Unit of time of a PMAC's velocities (Ix90).

    Returns
    -------
    TurningProgram
        With times from the F words, PVT times or the list.

    Raises
    ------
    DataError
        If a word or unit is not known, F is missing under G93, C turns back, or nothing says what the
        points are; with the line.
    CorruptFileError
        If a block is damaged, or the file was cut short: a file of `write_program` without its M30, a last
        line that may have lost words or digits.
    ReadError
        If the file cannot be read.

    Notes
    -----
    Strict: a word that is not understood is refused. G1 and rapid moves are lines, whatever a head says;
    ``CSPLINE`` of SINUMERIK is read as the C2 spline over the time of the blocks with free ends (BAUTO,
    EAUTO): over what a control really runs its spline parameter is its own affair. A program of others may
    end with M30, M2, M99, M17, RET or %, or with a whole block, of which `messages` then tell: lines that
    are missing behind it cannot be seen.
    """
    place = Path(path)
    if not isinstance(axes, LatheAxes):
        raise DataError(f"axes must be LatheAxes, got {type(axes).__name__}")
    if quantity is not None:
        numbers.choice(quantity, "quantity", get_args(Quantity))
    text = _Lines(place)
    if text.first.startswith("t_s,"):
        columns = _read_points(text, axes)
        joined = interpolation or text.joined
        if columns.velocities is None and joined is None:
            raise DataError(
                f"{place}: a list of points does not say how the control joins them: give "
                'interpolation="linear" or "spline"'
            )
        columns.interpolation = "pvt" if columns.velocities is not None else str(joined)
    elif text.first in ("ABS", "abs") or text.first.startswith("PVT"):
        columns = _read_pmac(text, axes, velocity_time)
    else:
        if interpolation == "spline":
            raise DataError(
                f"{place}: G1 is a line; a spline needs the word of the control in the file, such as CSPLINE"
            )
        columns = _read_gcode(text, axes)
    found = quantity or text.quantity
    if found is None:
        raise DataError(
            f"{place}: nothing says whether these are places of the tip or points of the surface: give "
            'quantity="tip" or quantity="cut points"'
        )
    return TurningProgram(
        columns.X, columns.azimuth, columns.Z, columns.t, found, columns.interpolation,  # type: ignore[arg-type]  # checked there
        columns.velocities, messages=columns.messages,
    )  # fmt: skip


class _Lines:
    """The numbered lines of a file, one at a time, and what its comments say."""

    def __init__(self, place: Path) -> None:
        self.place = place
        self.quantity: Any = None
        self.joined: str | None = None
        self.is_own = False
        self.has_end = True  # of the last line that was read
        head: list[tuple[int, str]] = []
        self._rest = self._read()
        self.first = ""
        for number, line in self._rest:
            head.append((number, line))
            bare = line.strip()
            if bare and bare[0] not in "#(/;%":
                self.first = bare
                break
        self._rest = chain(head, self._rest)

    def __iter__(self) -> Iterator[tuple[int, str]]:
        return self._rest

    def _read(self) -> Iterator[tuple[int, str]]:
        try:
            with self.place.open(encoding="ascii") as file:
                for number, line in enumerate(file, 1):
                    self.has_end = line[-1] == "\n"
                    self.is_own = self.is_own or (number == 1 and MARK in line)
                    if line[0] in "(#/" and (said := _SAID.match(line)):
                        if said[1]:
                            self.quantity = self.quantity or said[1]
                        else:
                            self.joined = self.joined or said[2]
                    yield number, line.rstrip("\n")
        except UnicodeDecodeError:
            raise CorruptFileError(
                self.place,
                f"byte {_first_odd_byte(self.place)} is not ASCII",
                hint="is this a program?",
            ) from None
        except OSError as exc:
            raise ReadError(f"{self.place}: cannot be read ({exc.strerror or exc})") from None

    def refused(self, line: int, what: str) -> DataError:
        """Return the error of a line."""
        return DataError(f"{self.place}, line {line}: {what}")


def _first_odd_byte(place: Path) -> int:
    at = 0
    with place.open("rb") as file:
        while data := file.read(1 << 20):
            odd = np.flatnonzero(np.frombuffer(data, np.uint8) > 127)
            if odd.size:
                return at + int(odd[0])
            at += len(data)
    return at


@dataclass(slots=True)
class _Columns:
    """What a file says of the axes, in SI."""

    X: FloatArray
    azimuth: FloatArray
    Z: FloatArray
    t: FloatArray
    interpolation: str
    velocities: FloatArray | None = None
    messages: tuple[str, ...] = ()


def _values(column: array[float]) -> FloatArray:
    """Return the numbers of a column, in its own memory."""
    return np.frombuffer(column) if column else np.empty(0)


def _read_gcode(text: _Lines, axes: LatheAxes) -> _Columns:
    columns = {letter: array("d") for letter in "XCZF"}
    place, joined = text.place, set[bool]()
    mode, unit, splined, started, ended = "", "", False, False, False
    last: dict[str, str] = {}
    before: dict[str, str] = {}
    block: dict[str, str] = {}
    number = 0
    for number, line in text:
        plain = _PLAIN.fullmatch(line) if started and not ended else None
        if plain is not None:
            words = dict(zip("XCZF", plain.groups(), strict=True))
        else:
            bare = re.sub(r"\([^()]*\)|;.*", " ", line).strip()
            if not bare:
                continue
            if ended:
                raise text.refused(number, "words after the end of the program (M30)")
            words = {}
            pos = 0
            while pos < len(bare):
                token = _TOKEN.match(bare, pos)
                if token is None or token.end() == pos:
                    raise CorruptFileError(
                        place, f"line {number}: {bare[pos:]!r} is not a word of a program"
                    )
                pos = token.end()
                letters, value = token[1], token[2]
                if letters == "N":
                    continue
                if token[3]:
                    ended = ended or bool(columns["X"])  # one before the blocks opens the file
                    continue
                code = (
                    f"{letters}{float(value):g}"
                    if value and letters in "GM"
                    else letters + (value or "")
                )
                if letters in ("X", "C", "Z", "F") and value is not None:
                    if letters in words:
                        raise text.refused(number, f"{letters} is there twice")
                    words[letters] = value
                elif code in ("G93", "G94"):
                    if columns["X"] and mode not in ("", code):
                        raise text.refused(
                            number,
                            f"{code} after blocks under {mode}; a path has one way to tell time",
                        )
                    mode = code
                elif code in ("G20", "G21"):
                    unit = "inch" if code == "G20" else "mm"
                elif code in ("G0", "G1", "G90"):
                    started = started or code != "G90"
                    splined = splined and code == "G90"
                elif code in _SPLINES:
                    splined = True
                elif code not in _QUIET:
                    raise text.refused(
                        number, f"{code} is not understood; a strict reader stops here"
                    )
                ended = ended or code in _ENDS
            if not words:
                continue
            if not started:
                raise text.refused(number, "axis words before G1: nothing says how to move")
        if unit and unit != axes.unit:
            raise text.refused(number, f"the program is in {unit}, the machine in {axes.unit}")
        if mode == "G93" and words.get("F") is None:
            raise text.refused(number, "a block under G93 has no F word; each needs its own")
        if not mode:
            raise text.refused(
                number, "neither G93 nor G94 is in force: nothing says how long it lasts"
            )
        words = {k: v for k, v in words.items() if v is not None}
        before, block = block, words
        last |= words
        if missing := [k for k in "XCZF" if k not in last]:
            raise text.refused(number, f"{', '.join(missing)} is not known yet")
        if columns["X"]:
            joined.add(splined)
        for letter, column in columns.items():
            column.append(float(last[letter]))
    if (count := len(columns["X"])) < 2:
        raise DataError(f"{place}: holds {count} blocks that move; a path needs more")
    said: tuple[str, ...] = ()
    if not ended:
        _require_whole(text, number, before, block)
        ended_so = (
            f"the program ends at line {number} without M30, M2, M99 or %, at X {last['X']} Z {last['Z']}: its "
            "last block is whole and it was read as a whole program; if it should go on from there, it was cut "
            "short"
        )
        said = (ended_so,)
    if len(joined) > 1:
        raise DataError(
            f"{place}: lines and splines follow one another; one path has one interpolation"
        )
    # a column is dropped as soon as it is turned into SI: a file of ten million blocks is 80 MB each
    X, azimuth, Z = _places(axes, *(_values(columns.pop(n)) for n in "XCZ"))
    t = np.zeros(X.size)
    np.cumsum(_times(place, axes, mode, _values(columns.pop("F")), X, Z, azimuth), out=t[1:])
    return _Columns(
        X, azimuth, Z, frozen(t), "spline" if True in joined else "linear", messages=said
    )


def _require_whole(
    text: _Lines, number: int, before: dict[str, str], block: dict[str, str]
) -> None:
    """Refuse a program without an end that shows that it was cut short, or might have lost digits."""
    why = ""
    if text.is_own:
        why = "without the M30 that metrosep wrote at its end"
    elif not text.has_end:
        lost = [k for k in before if k not in block]
        letter, number_text = list(block.items())[-1]
        if lost:
            why = f"without M30 and in a line without an end, and without the {', '.join(lost)} of the block before"
        elif (
            before.get(letter) != number_text
        ):  # as many digits as before show nothing: zeros are cut
            why = (
                "without M30 and in a line without an end, whose last number may have lost digits"
            )
    if why:
        raise CorruptFileError(
            text.place,
            f"the program ends at line {number} {why}: it was cut short (X, C and Z are then not where it "
            "should end); copy it again, or close it with a line end or M30 if it is whole",
        )


def _places(
    axes: LatheAxes, x: FloatArray, c: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return radius, azimuth on the part and height of words."""
    if axes.c_wraps:
        c = np.unwrap(c, period=360.0)
    return (
        frozen(x * axes.x_scale),
        frozen(axes.azimuth_of(np.radians(c))),
        frozen(z * axes.z_scale),
    )


def _times(
    place: Path,
    axes: LatheAxes,
    mode: str,
    f: FloatArray,
    X: FloatArray,
    Z: FloatArray,
    azimuth: FloatArray,
) -> FloatArray:
    """Return how long each block after the first lasts, s."""
    feed = f[1:]
    if not (feed > 0.0).all():
        at = int(np.argmax(~(feed > 0.0))) + 1
        raise DataError(f"{place}: F of block {at} is {f[at]:g}; it must be above zero")
    if mode == "G93":
        unit = axes.require_inverse_time()
        return np.asarray({"1/min": 60.0 / feed, "s": feed, "1/s": 1.0 / feed}[unit])
    if axes.feed == "G94 deg":
        return np.asarray(np.degrees(np.abs(np.diff(azimuth))) / feed * 60.0)
    way = np.hypot(np.diff(X), np.diff(Z)) / axes.z_scale
    if (way == 0.0).any():
        at = int(np.argmax(way == 0.0)) + 1
        raise DataError(
            f"{place}: block {at} moves neither X nor Z: under G94 nothing here says how long it lasts"
        )
    return np.asarray(way / feed * 60.0)


def _read_pmac(text: _Lines, axes: LatheAxes, velocity_time: float | None) -> _Columns:
    place = text.place
    if velocity_time is None:
        raise DataError(
            f"{place}: velocities of a PMAC are per Ix90: give velocity_time, 1.0 (s) for Ix90 = 1000"
        )
    per = numbers.positive(velocity_time, "velocity_time", dimension="time")
    rows, times, ms = array("d"), array("d"), math.nan
    for number, line in text:
        found = _PVT.fullmatch(line)
        if found is not None:
            rows.extend(map(float, found.groups()))
            times.append(ms)
            continue
        bare = re.sub(r"(//|;).*", "", line).strip()
        if not bare or bare == "ABS":
            continue
        mode = re.fullmatch(rf"PVT({_NUMBER})", bare)
        if mode is None:
            raise text.refused(number, f"{bare!r} is not understood; a strict reader stops here")
        ms = float(mode[1])
    if len(times) < 2:
        raise DataError(f"{place}: holds {len(times)} PVT blocks; a path needs more")
    lasted = _values(times)
    if np.isnan(lasted).any():
        raise DataError(f"{place}: a block stands before PVT states its time")
    x, vx, c, vc, z, vz = _values(rows).reshape(-1, 6).T
    X, azimuth, Z = _places(axes, x, c, z)
    velocities = _rates(axes, vx, vc, vz) / per
    t = np.zeros(X.size)
    np.cumsum(lasted[1:] * 1e-3, out=t[1:])
    return _Columns(X, azimuth, Z, frozen(t), "pvt", frozen(velocities))


def _rates(axes: LatheAxes, vx: FloatArray, vc: FloatArray, vz: FloatArray) -> FloatArray:
    """Return velocities of X, azimuth and Z of those of words."""
    return np.stack([vx * axes.x_scale, axes.way * np.radians(vc), vz * axes.z_scale])


def _read_points(text: _Lines, axes: LatheAxes) -> _Columns:
    u, place = axes.unit, text.place
    plain = ["t_s", f"X_{u}", "C_deg", f"Z_{u}"]
    fast = ["t_s", f"X_{u}", f"VX_{u}_s", "C_deg", "VC_deg_s", f"Z_{u}", f"VZ_{u}_s"]
    names: list[str] = []
    rows = array("d")
    for number, line in text:
        bare = line.strip()
        if not bare or bare[0] == "#":
            continue
        fields = bare.split(",")
        if not names:
            names = fields
            if names not in (plain, fast):
                raise text.refused(
                    number,
                    f"columns {','.join(names)}; known are {','.join(plain)} and {','.join(fast)}",
                )
            continue
        try:
            row = [float(v) for v in fields]
        except ValueError:
            raise CorruptFileError(
                place, f"line {number}: {bare!r} holds a field that is not a number"
            ) from None
        if len(row) != len(names) or not all(map(math.isfinite, row)):
            raise CorruptFileError(
                place, f"line {number}: {len(names)} numbers are needed, got {bare!r}"
            )
        rows.extend(row)
    table = _values(rows).reshape(-1, len(names)).T
    if table.shape[1] < 2:
        raise DataError(f"{place}: holds {table.shape[1]} points; a path needs more")
    velocities = None
    if names == fast:
        t, x, vx, c, vc, z, vz = table
        velocities = frozen(_rates(axes, vx, vc, vz))
    else:
        t, x, c, z = table
    X, azimuth, Z = _places(axes, x, c, z)
    return _Columns(X, azimuth, Z, frozen(t.copy()), "", velocities)
