"""The strict reader of turning programs: it knows the machine, and nothing of what was meant.

A word that is not understood is refused with its line. G1 and rapid moves are lines whatever a head says.
specs/cutting-path.md, section 9.
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from metrosep.controllers.gcode.lathe import LatheAxes
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, ReadError
from metrosep.process._plain import frozen
from metrosep.process.cutting.programs import Quantity, TurningProgram

__all__ = ["read_program"]

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_PLAIN = re.compile(
    rf"(?:N[0-9]+ ?)?X({_NUMBER}) ?C({_NUMBER}) ?Z({_NUMBER})(?: ?F({_NUMBER}))?\s*"
)
_PVT = re.compile(
    rf"X({_NUMBER}):({_NUMBER}) C({_NUMBER}):({_NUMBER}) Z({_NUMBER}):({_NUMBER})\s*"
)
_TOKEN = re.compile(rf"\s*(?:([A-Z]+)({_NUMBER})?|(%))")
_SPLINES = {"CSPLINE": "spline"}
_QUIET = {"BAUTO", "EAUTO", "G61", "G40", "G49", "G17", "G18", "M3", "M4", "M5", "M30", "M2"}


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
        If a block is damaged.
    ReadError
        If the file cannot be read.

    Notes
    -----
    Strict: a word that is not understood is refused. G1 and rapid moves are lines, whatever a head says;
    ``CSPLINE`` of SINUMERIK is read as the C2 spline over the time of the blocks with free ends (BAUTO,
    EAUTO): over what a control really runs its spline parameter is its own affair.
    """
    place = Path(path)
    try:
        text = place.read_text(encoding="ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            place, f"byte {exc.start} is not ASCII", hint="is this a program?"
        ) from None
    except OSError as exc:
        raise ReadError(f"{place}: cannot be read ({exc.strerror or exc})") from None
    if not isinstance(axes, LatheAxes):
        raise DataError(f"axes must be LatheAxes, got {type(axes).__name__}")
    said = re.search(r"^[(#/ ]*quantity (tip|cut points)\b", text, re.MULTILINE)
    found = quantity or (said[1] if said else None)
    if found is None:
        raise DataError(
            f"{place}: nothing says whether these are places of the tip or points of the surface: give "
            'quantity="tip" or quantity="cut points"'
        )
    numbers.choice(found, "quantity", get_args(Quantity))
    lines = text.splitlines()
    first = next((s for s in (line.strip() for line in lines) if s and s[0] not in "#(/;%"), "")
    if first.startswith("t_s,"):
        return _read_points(place, lines, axes, found, interpolation)
    if first in ("ABS", "abs") or first.startswith("PVT"):
        return _read_pmac(place, lines, axes, found, velocity_time)
    if interpolation == "spline":
        raise DataError(
            f"{place}: G1 is a line; a spline needs the word of the control in the file, such as CSPLINE"
        )
    return _read_gcode(place, lines, axes, found)


def _refused(place: Path, line: int, what: str) -> DataError:
    return DataError(f"{place}, line {line}: {what}")


def _read_gcode(place: Path, lines: list[str], axes: LatheAxes, quantity: Any) -> TurningProgram:
    columns: dict[str, list[float]] = {"X": [], "C": [], "Z": [], "F": []}
    at: list[bool] = []
    mode, unit, splined, started, ended = "", "", False, False, False
    last: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        plain = _PLAIN.fullmatch(line) if started and not ended else None
        if plain is not None:
            words = dict(zip("XCZF", plain.groups(), strict=True))
        else:
            bare = re.sub(r"\([^()]*\)|;.*", " ", line).strip()
            if not bare:
                continue
            if ended:
                raise _refused(place, number, "words after the end of the program (M30)")
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
                if token[3] or letters == "N":
                    continue
                code = (
                    f"{letters}{float(value):g}"
                    if value and letters in "GM"
                    else letters + (value or "")
                )
                if letters in ("X", "C", "Z", "F") and value is not None:
                    if letters in words:
                        raise _refused(place, number, f"{letters} is there twice")
                    words[letters] = value
                elif code in ("G93", "G94"):
                    if at and mode not in ("", code):
                        raise _refused(
                            place,
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
                    raise _refused(
                        place, number, f"{code} is not understood; a strict reader stops here"
                    )
                ended = ended or code in ("M30", "M2")
            if not words:
                continue
            if not started:
                raise _refused(place, number, "axis words before G1: nothing says how to move")
        if unit and unit != axes.unit:
            raise _refused(place, number, f"the program is in {unit}, the machine in {axes.unit}")
        if mode == "G93" and words.get("F") is None:
            raise _refused(place, number, "a block under G93 has no F word; each needs its own")
        if not mode:
            raise _refused(
                place, number, "neither G93 nor G94 is in force: nothing says how long it lasts"
            )
        words = {k: v for k, v in words.items() if v is not None}
        last |= words
        if missing := [k for k in "XCZF" if k not in last]:
            raise _refused(place, number, f"{', '.join(missing)} is not known yet")
        for letter, column in columns.items():
            column.append(float(last[letter]))
        at.append(splined)
    x, c, z, f = (np.array(v) for v in columns.values())
    if x.size < 2:
        raise DataError(f"{place}: holds {x.size} blocks that move; a path needs more")
    joined = set(at[1:])
    if len(joined) > 1:
        raise DataError(
            f"{place}: lines and splines follow one another; one path has one interpolation"
        )
    X, azimuth, Z = _places(axes, x, c, z)
    times = _times(place, axes, mode, f, X, Z, azimuth)
    return TurningProgram(
        X, azimuth, Z, frozen(np.concatenate([[0.0], np.cumsum(times)])), quantity,
        "spline" if True in joined else "linear",
    )  # fmt: skip


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


def _read_pmac(
    place: Path, lines: list[str], axes: LatheAxes, quantity: Any, velocity_time: float | None
) -> TurningProgram:
    if velocity_time is None:
        raise DataError(
            f"{place}: velocities of a PMAC are per Ix90: give velocity_time, 1.0 (s) for Ix90 = 1000"
        )
    per = numbers.positive(velocity_time, "velocity_time", dimension="time")
    rows, times, ms = [], [], math.nan
    for number, line in enumerate(lines, 1):
        found = _PVT.fullmatch(line)
        if found is not None:
            rows.append([float(v) for v in found.groups()])
            times.append(ms)
            continue
        bare = re.sub(r"(//|;).*", "", line).strip()
        if not bare or bare == "ABS":
            continue
        mode = re.fullmatch(rf"PVT({_NUMBER})", bare)
        if mode is None:
            raise _refused(
                place, number, f"{bare!r} is not understood; a strict reader stops here"
            )
        ms = float(mode[1])
    if len(rows) < 2:
        raise DataError(f"{place}: holds {len(rows)} PVT blocks; a path needs more")
    if np.isnan(times).any():
        raise DataError(f"{place}: a block stands before PVT states its time")
    x, vx, c, vc, z, vz = np.array(rows).T
    X, azimuth, Z = _places(axes, x, c, z)
    velocities = np.stack([vx * axes.x_scale, axes.way * np.radians(vc), vz * axes.z_scale]) / per
    t = np.concatenate([[0.0], np.cumsum(np.array(times[1:]) * 1e-3)])
    return TurningProgram(X, azimuth, Z, frozen(t), quantity, "pvt", frozen(velocities))


def _read_points(
    place: Path, lines: list[str], axes: LatheAxes, quantity: Any, interpolation: str | None
) -> TurningProgram:
    body = [(n, s.strip()) for n, s in enumerate(lines, 1) if s.strip() and s.strip()[0] != "#"]
    names = body[0][1].split(",")
    u = axes.unit
    plain = ["t_s", f"X_{u}", "C_deg", f"Z_{u}"]
    fast = ["t_s", f"X_{u}", f"VX_{u}_s", "C_deg", "VC_deg_s", f"Z_{u}", f"VZ_{u}_s"]
    if names not in (plain, fast):
        raise _refused(
            place,
            body[0][0],
            f"columns {','.join(names)}; known are {','.join(plain)} and {','.join(fast)}",
        )
    rows = []
    for number, line in body[1:]:
        fields = line.split(",")
        try:
            row = [float(v) for v in fields]
        except ValueError:
            raise CorruptFileError(
                place, f"line {number}: {line!r} holds a field that is not a number"
            ) from None
        if len(row) != len(names) or not np.isfinite(row).all():
            raise CorruptFileError(
                place, f"line {number}: {len(names)} numbers are needed, got {line!r}"
            )
        rows.append(row)
    if len(rows) < 2:
        raise DataError(f"{place}: holds {len(rows)} points; a path needs more")
    table = np.array(rows).T
    if names == fast:
        t, x, vx, c, vc, z, vz = table
        velocities = np.stack([vx * axes.x_scale, axes.way * np.radians(vc), vz * axes.z_scale])
        X, azimuth, Z = _places(axes, x, c, z)
        return TurningProgram(X, azimuth, Z, frozen(t), quantity, "pvt", frozen(velocities))
    t, x, c, z = table
    head = re.search(r"^# interpolation (linear|spline)\b", "\n".join(lines), re.MULTILINE)
    joined = interpolation or (head[1] if head else None)
    if joined is None:
        raise DataError(
            f"{place}: a list of points does not say how the control joins them: give "
            'interpolation="linear" or "spline"'
        )
    X, azimuth, Z = _places(axes, x, c, z)
    return TurningProgram(X, azimuth, Z, frozen(t), quantity, joined)  # type: ignore[arg-type]  # checked there
