"""Readings of an instrument on a machine from text: set-up in comment lines of TOML, then columns.

    # instrument = "nest"
    # ball = "70 mm, -30 mm, 45 mm"
    # unknown = ["ball"]
    X_mm,Y_mm,Z_mm,A_deg,C_deg,reading_x_um,reading_y_um,reading_z_um
    45.62,-60.98,125,0,30,-12.1,-15.5,6.9

Rows stand in the order of time. A position column is an axis and its unit; an axis that stands still
may be a key instead (``at = { Y = "0 mm" }``).
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    MetrosepError,
    OptionError,
    UnitError,
)
from metrosep.core.numbers import choice, is_real, quantity
from metrosep.core.readable import nearest
from metrosep.io._roles import pick, to_si
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.encoding import decode
from metrosep.io.text.table import Table, read_table
from metrosep.machine import Chain, ReadingSet
from metrosep.machine.instruments import (
    Angle,
    Ballbar,
    Displacement,
    Instrument,
    Length,
    Nest,
)

_KINDS: Mapping[str, Callable[..., Instrument]] = {
    "displacement": Displacement,
    "angle": Angle,
    "ballbar": Ballbar,
    "nest": Nest,
    "length": Length,
}
_POINTS = ("ball", "station", "point")
_COMMON = (
    "instrument",
    "name",
    "tool",
    "unknown",
    "u",
    "total",
    "resolution",
    "at",
    "end",
    "artefact",
)
_OWN = {
    "displacement": ("direction", "frame", "point"),
    "angle": ("direction", "frame"),
    "ballbar": ("ball",),
    "nest": ("ball", "senses", "frame"),
    "length": ("station", "dead_path"),
}
_USUAL = {
    "laser": "displacement (linear or straightness optics), angle (angular optics) or length (from a station)",
    "interferometer": "displacement (linear or straightness optics), angle (angular optics) or length",
    "straightness": "displacement, with the direction that is sensed", "squareness": "displacement, twice",
    "dial": "displacement, with the direction of its plunger",
    "indicator": "displacement, with the direction of its plunger",
    "dial indicator": "displacement, with the direction of its plunger",
    "probe": "displacement, with the direction that is sensed", "capacitive probe": "displacement",
    "level": "angle, with the axis about which it tilts", "spirit level": "angle, with the axis about which it tilts",
    "autocollimator": "angle, with the axis about which it tilts",
    "double ballbar": "ballbar", "double ball bar": "ballbar", "ball bar": "ballbar", "dbb": "ballbar",
    "r-test": "nest", "sensor nest": "nest", "tracker": "length", "laser tracker": "length",
}  # fmt: skip
"""What an instrument is called in the shop, and what it is here by what it reads."""
_AXES = {f"{s}{a}": (0.0,) * i + ((-1.0 if s == "-" else 1.0),) + (0.0,) * (2 - i)
         for i, a in enumerate("XYZ") for s in ("", "+", "-")}  # fmt: skip


def read_reading_set(
    path: str | os.PathLike[str], chain: Chain, *, needs_readings: bool = True
) -> ReadingSet:
    """Return the readings of a file, as `metrosep.machine.calibrate` takes them."""
    file = open_file(path)
    setup = _setup(file)
    table = read_table(file)
    try:
        kind = _kind(setup.get("instrument"))
        known = (*_COMMON, *_OWN[kind])
        for key in setup:
            choice(key, f"key of a {kind}", known)
        q = _positions(file, table, chain, setup.get("at", {}))
        own = {k: _value(k, setup[k]) for k in (*_OWN[kind], "end") if k in setup}
        instrument = _KINDS[kind](**own)
        is_angle = instrument.is_angle
        values = _readings(file, table, instrument, needed=needs_readings)
        kind_of = "angle" if is_angle else "length"
        numbers = {
            k: quantity(setup[k], k, kind_of)
            for k in ("u", "resolution")
            if setup.get(k) is not None
        }
        return ReadingSet(
            instrument,
            q,
            values,
            tool=_point(setup["tool"], "tool") if "tool" in setup else (0.0, 0.0, 0.0),
            unknown=tuple(setup.get("unknown", ())),
            name=str(setup.get("name", file.name)),
            total=bool(setup.get("total", False)),
            artefact=str(setup.get("artefact", "")),
            **numbers,
        )
    except FormatMismatchError:
        raise
    except MetrosepError as error:
        said = str(error)
        raise type(error)(
            said if said.startswith((f"{file.path}:", f"{file.name}:")) else f"{file.path}: {said}"
        ) from None


def _kind(named: Any) -> str:
    """Return the kind of instrument of a set-up; the name of the shop is answered with ours."""
    if named not in _KINDS and isinstance(named, str):
        usual = " ".join(named.lower().replace("_", " ").replace("-", " ").split())
        said = {k.replace("-", " "): v for k, v in _USUAL.items()}.get(usual)
        near = said or nearest(usual, _KINDS)
        if near:
            raise OptionError(
                f"instrument is one of {', '.join(_KINDS)}, got {named!r}; did you mean {near}?"
            )
    return choice(named, "instrument", _KINDS)


def _setup(file: RawFile) -> dict[str, Any]:
    """Return the keys in the comment lines above the columns."""
    lines = []
    for line in decode(file.data, file.path)[0].splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("#").strip())
    try:
        found = tomllib.loads("\n".join(lines))
    except tomllib.TOMLDecodeError as error:
        raise FormatMismatchError(
            f"{file.path}: the comment lines above the columns are not TOML ({error}); they hold the "
            'set-up, such as # instrument = "nest"'
        ) from None
    if "instrument" not in found:
        raise FormatMismatchError(
            f"{file.path}: no instrument is named; put the set-up into comment lines above the columns: "
            f'# instrument = "nest" (or {", ".join(k for k in _KINDS if k != "nest")})'
        )
    return found


def _point(value: Any, name: str) -> tuple[float, ...]:
    """Return three lengths from a list or a text."""
    parts = value.split(",") if isinstance(value, str) else value
    if not isinstance(parts, list) or len(parts) != 3:
        raise DataError(f'{name} is three lengths, such as "70 mm, -30 mm, 45 mm", got {value!r}')
    return tuple(quantity(p.strip() if isinstance(p, str) else p, name, "length") for p in parts)


def _value(key: str, value: Any) -> Any:
    if key in _POINTS:
        return _point(value, key)
    if key == "direction" and isinstance(value, list) and all(is_real(v) for v in value):
        size = float(np.linalg.norm(value))  # a diagonal is typed by the travels of its axes
        return tuple(float(v) / size for v in value) if size > 0.0 else tuple(value)
    if key == "direction" and isinstance(value, str):
        return _AXES[choice(value, "direction", _AXES)]
    return value


def _positions(
    file: RawFile, table: Table, chain: Chain, at: Mapping[str, Any]
) -> dict[str, FloatArray]:
    """Return the positions of all axes, from columns and from places that stay."""
    if not isinstance(at, Mapping):
        raise DataError(f'at is a table of axes, such as {{ Y = "0 mm" }}, got {at!r}')
    kinds = chain.dimensions
    for axis in at:
        choice(axis, "axis in at", chain.axes)
    for name in table.names:
        axis, _, ending = name.partition("_")
        if ending and re.fullmatch(r"[A-CU-Z]", axis) and axis not in chain.axes:
            raise FormatMismatchError(
                f"{file.path}: column {name}: the machine {chain.name} has no axis {axis}; its axes are "
                f"{', '.join(chain.axes)}"
            )
    parked = {e.name for e in chain.elements if e.parked}
    found, lacking = {}, []
    for axis in chain.axes:
        named = [n for n in table.names if n == axis or n.startswith((f"{axis}_", f"{axis} "))]
        if len(named) > 1:
            raise FormatMismatchError(
                f"{file.path}: axis {axis} has two columns, {', '.join(named)}"
            )
        if named:
            usual = "deg" if kinds[axis] == "angle" else "mm"
            found[axis] = _in_si(
                file, table, named[0], kinds[axis], f"axis {axis}", f"{axis}_{usual}"
            )
        elif axis in at:
            found[axis] = np.asarray(quantity(at[axis], f"place of {axis}", kinds[axis]))
        elif axis not in parked:
            lacking.append(axis)
    if lacking:
        places = [f'{a} = "0 {"deg" if kinds[a] == "angle" else "mm"}"' for a in lacking]
        raise FormatMismatchError(
            f"{file.path}: axis {', '.join(lacking)} has no column and no place, and each needs one. The file "
            f"has {', '.join(table.names)}; an axis that moves is a column such as {lacking[0]}_mm or "
            f"C_deg, and those that stay are in the line # at = {{ {', '.join(places)} }}"
        )
    return found


def _readings(file: RawFile, table: Table, instrument: Instrument, *, needed: bool) -> FloatArray:
    dimension = "angle" if instrument.is_angle else "length"
    if instrument.n_readings == 1:
        wanted = ["reading"]
    else:
        wanted = [f"reading_{d}" for d in "xyz"]
    columns = []
    for name in wanted:
        named = [n for n in table.names if n == name or n.startswith((f"{name}_", f"{name} "))]
        if len(named) != 1:
            if not named and not needed:
                columns.append(np.zeros(len(table)))
                continue
            raise FormatMismatchError(
                f"{file.path}: a column {name}_um (or {name}_urad) is needed, found "
                f"{', '.join(named) or 'none'} in {', '.join(table.names)}"
            )
        usual = f"{name}_{'urad' if instrument.is_angle else 'um'}"
        columns.append(_in_si(file, table, named[0], dimension, "readings", usual))
    return columns[0] if len(columns) == 1 else np.column_stack(columns)


def _in_si(
    file: RawFile, table: Table, name: str, dimension: str, role: str, usual: str
) -> FloatArray:
    """Return a column in SI; its unit stands in the header, nowhere else."""
    column, unit = pick(file, table, name, role=role)
    if unit is None:
        raise UnitError(
            f"{file.path}: column {name!r} ({role}) declares no unit that is known; name it with its "
            f"unit, such as {usual}"
        )
    return to_si(file, column, unit, dimension=dimension, role=role)
