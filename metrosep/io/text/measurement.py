"""A table of numbers becomes a profile, a recording or a surface, with units somebody declared.

Shared by plain column text and by the text formats that a ``format.toml`` describes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FormatMismatchError, ReadError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import Unit, likely_meaning, parse_quantity, parse_unit
from metrosep.io._roles import role_of, runs_in
from metrosep.io.objects import make_surface, scaled
from metrosep.io.own_notes import header_notes
from metrosep.io.source import RawFile, lateral_steps, refuse_options
from metrosep.io.text.delimited_maps import (
    declared_units,
    is_matrix,
    looks_like_points,
    matrix,
    shown_columns,
    to_grid,
)
from metrosep.io.text.dialect import header_unit
from metrosep.io.text.table import (
    Column,
    ColumnSpec,
    Table,
    interruption,
    pick,
    sensitivity,
    to_si,
)

__all__ = [
    "SI_NAMES",
    "columns_as_object",
    "map_as_surface",
    "measurement",
    "unit_label",
    "unit_of",
]

SI_NAMES = {
    "length": "m",
    "angle": "rad",
    "time": "s",
    "frequency": "Hz",
    "speed": "m/s",
    "acceleration": "m/s^2",
    "voltage": "V",
    "torque": "N m",
    "number": "1",
}
"""SI unit of each dimension that a channel can have."""

_FEW = 8
"""Columns without names that may still be channels as well as a map."""


def measurement(
    file: RawFile,
    table: Table,
    format_id: str,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    y: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
) -> Profile | Recording | Surface:
    """Return the object that a table holds; see `metrosep.io.text.delimited.read`."""
    table, channel, labels = _rows_of(file, table, channel)
    unit = declared_units(unit)
    bare = is_matrix(table)
    undeclared = all(c.unit is None for c in table.numbers)
    table = _with_units(file, table, unit)
    facts = {"labels": labels} if labels else {}
    timed = _time_column(file, table, time)
    try:
        points = _point_columns(
            file,
            table,
            x,
            y,
            z,
            bare=bare and _each(unit),
            one_unit=undeclared and not _each(unit),
        )
        if points is not None and timed is None and sampling_rate is None:
            refuse_options(
                file, "a list of points with their positions", lateral_step=lateral_step
            )
            return _surface(file, table, format_id, points, sensitivity(scale), facts)
        if (timed is not None or sampling_rate is not None) and x is None and z is None:
            if lateral_step is not None or scale is not None:
                raise ReadError(f"{file.path}: a recording takes no lateral_step or scale")
            return _recording(file, table, format_id, timed, sampling_rate, channel, facts)
        steps = lateral_steps(lateral_step)
        if (
            bare
            and x is None
            and z is None
            and channel is None
            and (
                len(table.columns) > _FEW
                or unit is not None
                or steps is not None
                or looks_like_points(file, table)
            )
        ):
            return matrix(file, table, format_id, steps=steps, scale=sensitivity(scale))
        return _profile(file, table, format_id, x, z, lateral_step, sensitivity(scale), facts)
    except UnitError:
        raise
    except DataError as exc:
        found = runs_in(table)
        if found is not None:
            why = f"{file.path}: {found}; {found.advice(file.path)}"
            raise FormatMismatchError(why) from None
        raise FormatMismatchError(f"{file.path}: {exc}") from None


def _rows_of(
    file: RawFile, table: Table, channel: str | None
) -> tuple[Table, str | None, dict[str, str]]:
    """Return the rows of one label, and the labels that all its rows share."""
    stacked = [c for c in table.columns if c.labels is not None and len(set(c.labels)) > 1]
    for column in stacked:
        if channel is not None and channel in (column.labels or ()):
            keep = np.array([label == channel for label in column.labels or ()])
            table, channel = _take(table, keep), None
            break
    shared: dict[str, str] = {}
    for column in table.columns:
        if column.labels is None:
            continue
        different = tuple(dict.fromkeys(column.labels))
        if len(different) == 1:
            shared[column.name] = different[0]
        elif len(table.numbers) == 2:
            raise FormatMismatchError(
                f"{file.path}: column {column.name!r} stacks {len(different)} data sets "
                f"({', '.join(different[:4])}); choose one with channel={different[0]!r}"
            )
    return table, channel, shared


def _take(table: Table, keep: Any) -> Table:
    columns = tuple(
        Column(
            c.name,
            c.unit,
            None if c.values is None else c.values[keep],
            None
            if c.labels is None
            else tuple(label for label, k in zip(c.labels, keep, strict=True) if k),
        )
        for c in table.columns
    )
    return replace(table, columns=columns, lines=table.lines[keep])


def _with_units(file: RawFile, table: Table, unit: Any) -> Table:
    """Return the table with the units that the caller declares; contradictions are refused."""
    if unit is None:
        return table
    names = [c.name for c in table.numbers]
    if isinstance(unit, str):
        shared = parse_unit(unit)
        declared: dict[str, Unit] = {
            c.name: shared
            for c in table.numbers
            if c.unit is None and likely_meaning(c.name) is None
        }
        odd = [why for c in table.numbers if c.unit is None and (why := likely_meaning(c.name))]
        if not declared and odd:
            raise UnitError(
                f"{file.path}: the unit of a column is not known: {odd[0]}; correct the header"
            )
        if not declared and not any(c.unit == shared for c in table.numbers):
            own = ", ".join(f"{c.name!r} in {c.unit.name}" for c in table.numbers if c.unit)
            raise FormatMismatchError(
                f"{file.path}: every column declares its own unit ({own}); leave unit= out"
            )
    elif isinstance(unit, dict):
        specs = ((str(n), str(u)) for n, u in unit.items())
        declared = {c.name: u for c, u in (pick(file, table, s, role="unit") for s in specs) if u}
    else:
        units = tuple(unit)
        if len(units) != len(names):
            raise FormatMismatchError(
                f"{file.path}: unit has {len(units)} entries for {len(names)} columns of numbers "
                f"({', '.join(names)}); give one for each"
            )
        pairs = zip(names, units, strict=True)
        declared = {
            c.name: u
            for c, u in (pick(file, table, (n, str(t)), role="unit") for n, t in pairs)
            if u
        }
    columns = tuple(
        Column(c.name, declared.get(c.name, c.unit), c.values, c.labels) for c in table.columns
    )
    return replace(table, columns=columns)


def _time_column(file: RawFile, table: Table, time: ColumnSpec | None) -> Column | None:
    if time is not None:
        column, unit = pick(file, table, time, role="time")
        return Column(column.name, unit, column.values, column.labels)
    for column in table.numbers:
        if column.unit is not None and column.unit.dimension == "time":
            return column
    for column in table.numbers:
        if column.unit is None and role_of(column.name) == "time":
            return column
    return None


def _each(unit: Any) -> bool:
    """Whether the caller gave a unit for each column, not one for all."""
    return unit is not None and not isinstance(unit, str)


def _point_columns(
    file: RawFile,
    table: Table,
    x: ColumnSpec | None,
    y: ColumnSpec | None,
    z: ColumnSpec | None,
    *,
    bare: bool,
    one_unit: bool,
) -> tuple[ColumnSpec, ColumnSpec, ColumnSpec] | None:
    """Return the columns of a list of points, or None when the table is none."""
    if y is not None:
        if x is None or z is None:
            raise FormatMismatchError(
                f"{file.path}: a surface needs x=, y= and z=; give all three"
            )
        return x, y, z
    if x is not None or z is not None or len(table.numbers) != 3:
        return None
    if bare:
        first, second, third = table.names
        return first, second, third
    lengths = [c for c in table.numbers if c.unit is not None and c.unit.dimension == "length"]
    named = {header_unit(c.name)[0].casefold(): c.name for c in lengths}
    if set(named) == {"x", "y", "z"} and one_unit:
        raise UnitError(
            f"{file.path}: columns x, y and z declare no unit, and one was given for the three; give "
            "one for each, such as unit='um,um,nm'"
        )
    if set(named) != {"x", "y", "z"}:
        return None
    return named["x"], named["y"], named["z"]


def _surface(
    file: RawFile,
    table: Table,
    format_id: str,
    points: tuple[ColumnSpec, ColumnSpec, ColumnSpec],
    scale: float | None,
    facts: dict[str, Any],
) -> Surface:
    values = []
    used: dict[str, Any] = {}
    for role, spec in zip(("x", "y", "z"), points, strict=True):
        column, unit = pick(file, table, spec, role=role)
        factor = scale if role == "z" else None
        values.append(to_si(file, column, unit, dimension="length", role=role, scale=factor))
        used[role] = column.name
    if np.isnan(values[2]).all():
        raise FormatMismatchError(f"{file.path}: the heights hold no number; nothing was measured")
    heights, (dx, dy), origin = to_grid(file, *values)
    order = {"row_order_in_file": "a list of points with their positions"}
    described = _described(file, table, format_id, {**order, **facts}, used)
    return Surface(heights, dx, dy, origin=origin, **described)


def _described(
    file: RawFile,
    table: Table,
    format_id: str,
    facts: dict[str, Any],
    used: dict[str, Any],
    *,
    is_profile: bool = False,
) -> dict[str, Any]:
    """Return metadata and history, which go on from those that metrosep wrote above the table."""
    notes = header_notes(file, table.header.get("comments", ()))
    units = {c.name: c.unit.name for c in table.columns if c.unit is not None}
    own = notes.facts if is_profile else {}
    warnings = (*table.warnings, *notes.warnings)
    return {
        "metadata": file.metadata(
            format_id,
            table.header,
            warnings=warnings,
            units=units,
            lines=table.ledger,
            **facts,
            **own,
        ),
        "history": (*notes.history, *file.history(format_id, used)),
    }


def _recording(
    file: RawFile,
    table: Table,
    format_id: str,
    timed: Column | None,
    sampling_rate: float | str | None,
    channel: str | None,
    facts: dict[str, Any],
) -> Recording:
    t: FloatArray
    if timed is not None and sampling_rate is not None:
        raise FormatMismatchError(
            f"{file.path}: has a column of time ({timed.name!r}), and sampling_rate was given too; leave "
            "sampling_rate out"
        )
    if timed is not None:
        t = to_si(file, timed, timed.unit, dimension="time", role="time")
    else:
        rate = parse_quantity(sampling_rate or 0.0, dimension="frequency", name="sampling_rate")
        if rate <= 0.0:
            raise ReadError(f"{file.path}: sampling_rate is {rate} Hz; it must be positive")
        t = np.arange(len(table), dtype=np.float64) / rate
        table = replace(table, warnings=(*table.warnings, *interruption(table)))
    chosen = [c for c in table.numbers if timed is None or c.name != timed.name]
    if channel is not None:
        column, _ = pick(file, table, channel, role="channel")
        chosen = [c for c in chosen if c.name == column.name]
    values = {
        c.name: c.values * (c.unit.factor if c.unit else 1.0)
        for c in chosen
        if c.values is not None
    }
    if not any(np.isfinite(v).any() for v in values.values()):
        raise FormatMismatchError(
            f"{file.path}: no channel holds a number beside the time; nothing was measured"
        )
    return Recording(
        t,
        values,
        units={c.name: SI_NAMES.get(c.unit.dimension, "") for c in chosen if c.unit is not None},
        **_described(file, table, format_id, facts, {"channels": tuple(values)}),
    )


def _profile(
    file: RawFile,
    table: Table,
    format_id: str,
    x: ColumnSpec | None,
    z: ColumnSpec | None,
    lateral_step: Any,
    scale: float | None,
    facts: dict[str, Any],
) -> Profile:
    numbers = [c.name for c in table.numbers]
    steps = lateral_steps(lateral_step)
    if x is None and z is None:
        if len(numbers) == 1 and steps is not None:
            z = numbers[0]
        elif len(numbers) == 2:
            x, z, assumed = position_and_height(file, table)
            table = replace(table, warnings=(*table.warnings, *assumed))
        else:
            raise _cannot_tell(file, table)
    if z is None or (x is None and steps is None):
        raise FormatMismatchError(
            f"{file.path}: a profile needs x= and z=, or z= and lateral_step=; the columns are "
            f"{shown_columns(table.names)}"
        )
    if x is not None and steps is not None:
        raise FormatMismatchError(
            f"{file.path}: the file holds positions, so lateral_step cannot replace them; leave it out"
        )
    z_column, z_unit = pick(file, table, z, role="z")
    heights = to_si(file, z_column, z_unit, dimension="length", role="z", scale=scale)
    used: dict[str, Any] = {"z": z_column.name, "scale_m_per_v": scale}
    if x is None:
        step = steps[0] if steps is not None else 0.0
        positions: FloatArray = step * np.arange(heights.size, dtype=np.float64)
        used["lateral_step_m"] = step
    else:
        x_column, x_unit = pick(file, table, x, role="x")
        positions = to_si(file, x_column, x_unit, dimension="length", role="x")
        used["x"] = x_column.name
        empty = np.flatnonzero(np.isnan(positions))
        if empty.size:
            line = int(table.lines[empty[0]])
            every = ",".join(str(table.lines[i]) for i in empty)
            raise FormatMismatchError(
                f"{file.path}: line {line}: position x is NaN in {empty.size} row(s), and a height without "
                f"a position cannot be used; leave it out with skip_lines='{every}'"
            )
    if np.isnan(heights).all():
        raise FormatMismatchError(
            f"{file.path}: column {z_column.name!r} holds no number; nothing was measured"
        )
    return Profile(
        positions,
        heights,
        **_described(file, table, format_id, facts, used, is_profile=True),
    )


def position_and_height(file: RawFile, table: Table) -> tuple[str, str, tuple[str, ...]]:
    """Return which of two columns is the position, which the height, and what was assumed.

    Names decide, then units (a voltage is a reading), then which of the columns is monotonic. A
    name that the numbers contradict is refused, and so is what stays ambiguous.
    """
    first, second = table.numbers
    roles = [_profile_role(c) for c in (first, second)]
    rises = [_is_monotonic(c) for c in (first, second)]
    calls = [f"x={a.name!r}, z={b.name!r}" for a, b in ((first, second), (second, first))]
    named = [r == "position" for r in roles], [r == "height" for r in roles]
    if named[0].count(True) == 1 or named[1].count(True) == 1:
        swapped = named[0] == [False, True] or named[1] == [True, False]
        x, z = (second, first) if swapped else (first, second)
        if _profile_role(z) != "height":
            _refuse_two_positions(file, x, z)
        if _is_monotonic(x, strictly=False) or not rises[not swapped]:
            return x.name, z.name, ()
        raise FormatMismatchError(
            f"{file.path}: column {x.name!r} is the position by its name, but it does not rise and "
            f"{z.name!r} does; give {calls[0]} or {calls[1]}"
        )
    if rises == [False, True]:
        return (
            second.name,
            first.name,
            (
                (
                    f"column {second.name!r} was taken as the position, since it alone is monotonic; give "
                    f"{calls[0]} if that is wrong"
                ),
            ),
        )
    if rises == [True, True] and table.header.get("named", True):
        _refuse_two_positions(file, first, second)
        return (
            first.name,
            second.name,
            (
                (
                    f"nothing says which column is the position; the first, {first.name!r}, was taken; give "
                    f"{calls[1]} if that is wrong"
                ),
            ),
        )
    return first.name, second.name, ()


def _profile_role(column: Column) -> str | None:
    """Return position or height, or None where neither name nor unit tells it."""
    role = role_of(column.name)
    if role is None and column.unit is not None and column.unit.dimension == "voltage":
        return "height"
    return role


def _refuse_two_positions(file: RawFile, x: Column, z: Column) -> None:
    """Refuse a height that differs from the position by less than a tenth of the travel."""
    if x.values is None or z.values is None or z.unit is None or z.unit.dimension != "length":
        return
    factor = 1.0 if x.unit is None else z.unit.factor / x.unit.factor
    if np.ptp(z.values * factor - x.values) < 0.1 * np.ptp(x.values):
        raise FormatMismatchError(
            f"{file.path}: column {z.name!r} follows the position {x.name!r} itself, so that it looks "
            "like the actual position, not a height; subtract one from the other for the error, or "
            f"give x={x.name!r}, z={z.name!r} if it is a height"
        )


def _is_monotonic(column: Column, *, strictly: bool = True) -> bool:
    values = column.values if column.values is not None else np.empty(0)
    if strictly:
        steps = np.diff(values)
        return bool(steps.size) and bool((steps > 0.0).all() or (steps < 0.0).all())
    steps = np.diff(values[~np.isnan(values)])
    return bool((steps >= 0.0).all() or (steps <= 0.0).all())


def _cannot_tell(file: RawFile, table: Table) -> FormatMismatchError:
    n = len(table.numbers)
    found = runs_in(table)
    if found is not None:
        return FormatMismatchError(f"{file.path}: {found}; {found.advice(file.path)}")
    if n == 3 and {c.name.casefold() for c in table.numbers} == {"x", "y", "z"}:
        return FormatMismatchError(
            f"{file.path}: columns x, y and z declare no unit; for a map give one for each, such as "
            "unit='um,um,nm'"
        )
    if n == 1:
        advice = "give the step of the positions with lateral_step='... um', or sampling_rate="
    else:
        advice = (
            "name two with x= and z=, give sampling_rate= for a recording without a column of time, or "
            "read repeated runs with read_runs(x=, z=, run=, feed=)"
        )
        if is_matrix(table):
            advice += "; for a map of heights give unit='nm' and lateral_step='3 um'"
    return FormatMismatchError(
        f"{file.path}: has {n} column(s) of numbers ({shown_columns(table.names)}) and none is a time; "
        f"{advice}"
    )


# ---- arrays without a meaning of their own (HDF5, NumPy, MATLAB): what the caller declares makes them one ----
# A two-dimensional array is a map whose first row has the smallest y; nothing in it says so, and
# nothing says its unit: the caller does, or an attribute ``unit`` beside it.

_UNIT_KEYS = ("units", "unit", "Units", "Unit")


def unit_of(attributes: Mapping[str, Any]) -> Unit | None:
    """Return the unit that the attributes of an array declare."""
    try:
        return parse_unit(unit_label(attributes))
    except UnitError:
        return None


def unit_label(attributes: Mapping[str, Any]) -> str:
    """Return the text that the attributes of an array give as its unit."""
    return next((str(attributes[k]) for k in _UNIT_KEYS if attributes.get(k)), "")


def map_as_surface(
    file: RawFile,
    format_id: str,
    values: NDArray[Any],
    *,
    name: str,
    own_unit: Unit | None,
    unit: Any,
    lateral_step: Any,
    scale: float | str | None = None,
    header: Mapping[str, Any],
) -> Surface:
    """Return a two-dimensional array as a surface."""
    declared = parse_unit(str(unit)) if unit is not None else None
    if declared is not None and own_unit is not None and declared != own_unit:
        raise FormatMismatchError(
            f"{file.path}: {name!r} is in {own_unit.name} by the file, but {declared.name} was given; leave "
            "unit= out"
        )
    found = declared or own_unit
    if found is None:
        raise UnitError(f"{file.path}: {name!r} declares no unit; declare it, such as unit='nm'")
    factor = found.factor
    gain = sensitivity(scale)
    if found.dimension == "voltage" and gain is not None:
        factor *= gain
    elif found.dimension != "length":
        raise UnitError(
            f"{file.path}: {name!r} is in {found.name} ({found.dimension}); a surface needs a length, or "
            "scale='2.5 um/V' for a sensor in volts"
        )
    return make_surface(
        file,
        format_id,
        scaled(values, factor),
        (None, None),
        row_order="smallest y first",
        header=header,
        override=lateral_steps(lateral_step),
        channel=name,
        unit_in_file=None if own_unit is None else own_unit.name,
        unit_declared=None if declared is None else declared.name,
        warnings=(
            "the array does not say which row is on top: row 0 was taken as the smallest y",
        ),
    )


def columns_as_object(
    file: RawFile,
    format_id: str,
    columns: Mapping[str, tuple[FloatArray, Unit | None]],
    header: Mapping[str, Any],
    **options: Any,
) -> Profile | Recording | Surface:
    """Return arrays of one length as the columns of a table would be."""
    made = tuple(
        Column(name, unit, np.asarray(v, dtype=np.float64)) for name, (v, unit) in columns.items()
    )
    n = made[0].values.size if made and made[0].values is not None else 0
    table = Table(made, np.arange(1, n + 1, dtype=np.int64), {"columns": tuple(columns), **header})
    return measurement(file, table, format_id, **options)
