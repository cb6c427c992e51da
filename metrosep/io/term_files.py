"""Error terms as files: a table of the terms of one axis, and a list of constants.

x_mm,EXX_um,EBX_urad        one column: the axis and its unit; the others: terms of that axis
0,0.00,1.2

C0Y = "12 urad"             TOML: a value with its unit for each constant
u_C0Y = "0.5 urad"          its standard uncertainty, and u_EXX_um beside EXX_um in a table
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import column_unit
from metrosep.io._roles import pick, to_si
from metrosep.io.source import open_file
from metrosep.io.text.table import read_table
from metrosep.machine.elements import axis_of
from metrosep.machine.terms import ConstantTerm, ErrorTerm, TableTerm, closes, is_angle

_ROUNDING = 1e-9
"""Of a turn, by which a table over 360 deg may miss it."""


_STRAIGHT, _MOST_PLACES = 1e-10, 6000
"""m or rad by which a line between two places may miss a term, and when places are enough."""

_U = "u_"
"""Before the name of a term: its standard uncertainty."""


def read_term_table(
    file: str | os.PathLike[str], kinds: Mapping[str, str], notes: list[str] | None = None
) -> dict[str, tuple[TableTerm, tuple[float, float]]]:
    """Return the terms of one axis from a text file, whose columns state names and units."""
    held = open_file(file)
    table = read_table(held)
    if len(table) < 2:
        raise DataError(
            f"{file}: holds no table of errors: a line of names and two rows are needed"
        )
    if notes is not None:
        notes += [f"{file}: {text}" for text in table.warnings]
    axes = {a.lower(): a for a in kinds}
    columns: dict[str, FloatArray] = {}
    axis = ""
    names = [column_unit(re.sub(r" \(\d+\)$", "", c.name))[0] for c in table.columns]
    at = [k for k, name in enumerate(names) if name.lower() in axes]
    if len(at) != 1:
        raise DataError(
            f"{file}: has the columns {', '.join(c.name for c in table.columns)}; one of them holds the positions of "
            f"an axis of the machine, with its unit, such as {next(iter(axes))}_mm"
        )
    first = at[0]
    for k in (first, *(k for k in range(len(names)) if k != first)):
        column, name = table.columns[k], names[k]
        spread = name.startswith(_U) and k != first
        name = name.removeprefix(_U) if spread else name
        own = axes[name.lower()] if k == first else name
        if k != first and axis_of(own) != axis:
            raise DataError(
                f"{file}: {column.name!r} is not an error of {axis}, whose positions the file has"
            )
        axis = own if k == first else axis
        key = _U + own if spread else own
        if key in columns:
            raise DataError(f"{file}: {column.name} is there twice; leave one of its columns")
        angle = kinds[own] == "angle" if k == first else is_angle(own)
        found, unit = pick(held, table, column.name, role="position" if k == first else "error")
        values = to_si(held, found, unit, dimension="angle" if angle else "length", role=own)
        if not np.isfinite(values).all():
            line = table.lines[np.flatnonzero(~np.isfinite(values))[0]]
            raise DataError(
                f"{file}: line {line}, {column.name} was not measured; take that line out, or complete it"
            )
        columns[key] = values
    if alone := [n for n in columns if n.startswith(_U) and n.removeprefix(_U) not in columns]:
        raise DataError(f"{file}: {alone[0]} is the uncertainty of a term that is not there")
    place = columns.pop(axis)
    way = -1 if place[-1] < place[0] else 1
    if (back := np.flatnonzero(way * np.diff(place) <= 0.0)).size:
        raise DataError(
            f"{file}: line {table.lines[back[0] + 1]}: the positions neither rise nor fall all the way; each "
            "place has one line"
        )
    at_places = place[::way].tolist()
    rising = {n: c[::way].tolist() for n, c in columns.items()}
    span = (at_places[0], at_places[-1])
    turn = 2.0 * math.pi
    whole = kinds[axis] == "angle" and abs(span[1] - span[0] - turn) <= _ROUNDING * turn
    terms = {}
    for n, c in rising.items():
        if not n.startswith(_U):
            period = turn if whole and closes(c) else None
            terms[n] = (TableTerm(at_places, c, rising.get(_U + n, 0.0), period), span)
    return terms


def term_file(name: str, *, is_constant: bool) -> str:
    """Return the name of the file that holds a term among others: of constants, or of an axis."""
    return "constants.toml" if is_constant else f"{axis_of(name)}.csv"


def term_texts(
    terms: Mapping[str, ErrorTerm],
    ranges: Mapping[str, tuple[float, float]],
    rotary: Collection[str],
) -> dict[str, str]:
    """Return the files that hold terms, as `read_term_table` and lists of constants are read."""
    texts: dict[str, str] = {}
    constants = []
    for name, term in terms.items():
        if isinstance(term, ConstantTerm):
            unit = "urad" if is_angle(name) else "um"
            constants.append(f'{name} = "{term.value * 1e6:.6f} {unit}"')
            if 0.0 < term.u < np.inf:
                constants.append(f'{_U}{name} = "{term.u * 1e6:.6f} {unit}"')
    if constants:
        texts[term_file("", is_constant=True)] = "\n".join(constants) + "\n"
    by_axis: dict[str, list[str]] = {}
    for name, term in terms.items():
        axis = axis_of(name)
        if axis is not None and not isinstance(term, ConstantTerm):
            by_axis.setdefault(axis, []).append(name)
    for axis, names in by_axis.items():
        low = max(ranges[n][0] for n in names)
        high = min(ranges[n][1] for n in names)
        turns = axis in rotary
        x = _places([terms[n] for n in names], low, high, 361 if turns else 101)
        columns = [np.degrees(x) if turns else x * 1e3]
        head = [f"{axis.lower()}_{'deg' if turns else 'mm'}"]
        values = {n: np.asarray(terms[n].evaluate(x)) for n in names}
        spreads = {_U + n: np.asarray(terms[n].sd(x)) for n in names}
        known = {n: v for n, v in spreads.items() if np.isfinite(v).all() and v.any()}
        for name, column in {**values, **known}.items():
            head.append(f"{name}_{'urad' if is_angle(name.removeprefix(_U)) else 'um'}")
            columns.append(column * 1e6)
        rows = [",".join(f"{v:.9f}" for v in row) for row in np.column_stack(columns)]
        texts[term_file(names[0], is_constant=False)] = "\n".join([",".join(head), *rows]) + "\n"
    return texts


def _places(terms: Sequence[ErrorTerm], low: float, high: float, n: int) -> FloatArray:
    """Return places so dense that straight lines between them follow the terms; corners are places."""
    corners = [p for t in terms if isinstance(t, TableTerm) for p in t.positions if low < p < high]
    while True:
        x = np.unique(np.concatenate([np.linspace(low, high, n), corners]))
        ends, middles = (
            np.array([t.evaluate(at) for t in terms]) for at in (x, 0.5 * (x[1:] + x[:-1]))
        )
        off = np.abs(middles - 0.5 * (ends[:, 1:] + ends[:, :-1])).max()
        if not off > _STRAIGHT or n > _MOST_PLACES:
            return np.asarray(x)
        n = 2 * n - 1


def table_texts(terms: Mapping[str, ErrorTerm]) -> dict[str, str]:
    """Return the files that hold constants and tables, which know themselves how far they reach."""
    ranges = {
        n: (t.positions[0], t.positions[-1]) for n, t in terms.items() if isinstance(t, TableTerm)
    }
    turning = {a for a in map(axis_of, terms) if a is not None and a[0] in "ABC"}
    return term_texts(terms, ranges, turning)
