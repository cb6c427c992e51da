"""Curves for a separation from the columns of files: set-ups, sensors, repeats.

A separation needs several readings over the same positions. They stand in several columns of one
file, or in one column of several files; repeats (passes, revolutions) follow each other, told
apart by a column that numbers them.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, InvalidSamplesError
from metrosep.core.methods import Readings
from metrosep.core.provenance import Step
from metrosep.io._roles import ColumnSpec, pick, sensitivity, to_si
from metrosep.io.role_columns import Role, role_values
from metrosep.io.runs import columns_of
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.table import Table

Dimension = Literal["length", "angle"]

_SAME_POSITION = 1e-3
"""Positions of repeats and readings may differ by this share of the mean step: rounding of text."""


def read_readings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    readings: ColumnSpec | Sequence[ColumnSpec],
    x: ColumnSpec | None = None,
    angle: ColumnSpec | None = None,
    repeat: str | None = None,
    dimension: Dimension = "length",
    scale: float | str | None = None,
    extra: Mapping[str, Role] | None = None,
    **layout: Any,
) -> Readings:
    """Read curves of several set-ups or sensors from text or from recordings.

    Parameters
    ----------
    paths : path or iterable of paths
        Files; each holds all the columns named.
    readings : column or sequence of columns
        A name whose header carries the unit (``"m1_um"``), ``"name:unit"`` or ``("name", "unit")``.
        The order of the readings is: all columns of the first file, then of the second.
    x, angle : column, optional
        Position in a length, or in an angle; one of them.
    repeat : str, optional
        Column that numbers passes or revolutions; a change of it begins the next one.
    dimension : {"length", "angle"}, optional
        What the readings are.
    scale : float (m/V) or str, optional
        Sensitivity where the readings are voltages, such as ``"-2.5 um/V"``.
    extra : mapping of str to Role, optional
        Further columns that belong to all readings, such as time or the pitch of a carriage; for
        a single file.
    **layout
        How the text is written: `metrosep.core.text_options.TEXT_OPTIONS`.

    Returns
    -------
    Readings
        All readings over the same positions.

    Raises
    ------
    ReadError
        If a file cannot be read or a column is missing.
    UnitError
        If a unit is missing or of the wrong dimension.
    InvalidSamplesError
        If readings or repeats have different lengths or positions.
    """
    files = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not files:
        raise FormatMismatchError("no file to read readings from; name at least one")
    if x is not None and angle is not None:
        raise FormatMismatchError("name the column of the position with x or with angle, not both")
    columns = _column_list(readings)
    values: list[list[FloatArray]] = []
    names: list[str] = []
    first: tuple[FloatArray | None, str] | None = None
    more: dict[str, NDArray[Any]] = {}
    if extra and len(files) > 1:
        raise FormatMismatchError(
            f"{', '.join(extra)} belong to the readings of one file, {len(files)} were given; put "
            "all readings into one file"
        )
    history: list[Step] = []
    warnings: list[str] = []
    factor = sensitivity(scale)
    for path in files:
        given = {k: v for k, v in layout.items() if v is not None}
        file, table, format_id = columns_of(open_file(path), given)
        rows = _repeats(file, table, repeat)
        position = _position(file, table, rows, x, angle)
        first = _same_positions(first, position, file, len(rows[0]))
        for name, role in (extra or {}).items():
            whole = role_values(file, table, role, name=name)
            more[name] = np.stack([whole[r] for r in rows])
        for spec in columns:
            column, unit = pick(file, table, spec, role="readings")
            whole = to_si(file, column, unit, dimension=dimension, role="readings", scale=factor)
            values.append([whole[r] for r in rows])
            names.append(column.name if len(files) == 1 else f"{file.name}: {column.name}")
        warnings += [f"{file.name}: {w}" for w in table.warnings]
        facts = {"readings": ", ".join(str(c) for c in columns)}
        facts |= {name: str(role.column) for name, role in (extra or {}).items()}
        facts |= {} if scale is None else {"scale": str(scale)}
        history += file.history(format_id, facts)
    return Readings(
        _stack(values, names),
        tuple(names),
        None if first is None else first[0],
        tuple(history),
        tuple(warnings),
        more,
        "m" if angle is None else "rad",
    )


def _column_list(readings: ColumnSpec | Sequence[ColumnSpec]) -> list[ColumnSpec]:
    if isinstance(readings, str):
        return [readings]
    items = list(readings)
    if not items:
        raise FormatMismatchError('readings is empty; name the columns, such as "m1_um"')
    return items


def _repeats(file: RawFile, table: Table, repeat: str | None) -> list[NDArray[np.intp]]:
    """Return the rows of each repeat, in the order of the file."""
    everything = np.arange(len(table))
    if repeat is None:
        return [everything]
    column, _ = pick(file, table, repeat, role="repeat")
    marks = np.array(column.labels) if column.labels is not None else column.values
    if marks is None or (marks.dtype.kind == "f" and np.isnan(marks).any()):
        raise FormatMismatchError(
            f"{file.path}: the column {column.name!r} does not number every row; every sample needs "
            "the number of its repeat"
        )
    parts = np.split(everything, np.flatnonzero(marks[1:] != marks[:-1]) + 1)
    sizes = sorted({p.size for p in parts})
    if len(sizes) != 1:
        raise InvalidSamplesError(
            f"{file.path}: the repeats hold {sizes[0]} to {sizes[-1]} samples; all need the same "
            "positions: resample them, or leave out the one that was cut short"
        )
    return parts


def _position(
    file: RawFile,
    table: Table,
    rows: list[NDArray[np.intp]],
    x: ColumnSpec | None,
    angle: ColumnSpec | None,
) -> FloatArray | None:
    spec, dimension, role = (x, "length", "x") if x is not None else (angle, "angle", "angle")
    if spec is None:
        return None
    column, unit = pick(file, table, spec, role=role)
    whole = to_si(file, column, unit, dimension=dimension, role=role)
    if np.isnan(whole).any():
        line = int(table.lines[int(np.flatnonzero(np.isnan(whole))[0])])
        raise InvalidSamplesError(f"{file.path}: line {line} has no position; drop that row")
    first = whole[rows[0]]
    for number, part in enumerate(rows[1:], start=2):
        turn = 2.0 * np.pi * round((whole[part][0] - first[0]) / (2.0 * np.pi))
        own = whole[part] - (turn if dimension == "angle" else 0.0)
        _require_same(own, first, f"{file.path}: repeat {number}", dimension)
    return first


def _same_positions(
    first: tuple[FloatArray | None, str] | None,
    position: FloatArray | None,
    file: RawFile,
    n: int,
) -> tuple[FloatArray | None, str]:
    if first is None:
        return position, file.name
    if position is not None and first[0] is not None:
        if position.size != first[0].size:
            raise InvalidSamplesError(
                f"{file.path}: {n} samples, but {first[1]} holds {first[0].size}; resample both onto "
                "the same positions"
            )
        _require_same(position, first[0], f"{file.path}", "position")
    return first


def _require_same(own: FloatArray, first: FloatArray, where: str, dimension: str) -> None:
    step = float(np.ptp(first)) / max(first.size - 1, 1)
    apart = float(np.max(np.abs(own - first)))
    if apart > _SAME_POSITION * step:
        raise InvalidSamplesError(
            f"{where} lies at other positions than the first, by up to {apart:.6g} "
            f"{'rad' if dimension == 'angle' else 'm'}; all must lie at the same positions of the "
            "artefact: resample them"
        )


def _stack(values: list[list[FloatArray]], names: list[str]) -> FloatArray:
    sizes = {v[0].size for v in values}
    if len(sizes) != 1:
        text = ", ".join(f"{n} {v[0].size}" for n, v in zip(names, values, strict=True))
        raise InvalidSamplesError(
            f"the readings have different numbers of samples ({text}); resample them onto the same "
            "positions"
        )
    most = max(len(v) for v in values)
    out = np.full((len(values), most, sizes.pop()), np.nan)
    for i, repeats in enumerate(values):
        for j, repeat in enumerate(repeats):
            out[i, j] = repeat
    return out
