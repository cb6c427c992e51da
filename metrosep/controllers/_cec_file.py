"""The text of SINUMERIK sag compensation tables, ``$AN_CEC``: several in one file, by index."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_position, is_rotary
from metrosep.controllers._along import format_amount, format_span
from metrosep.controllers._notes import agreed
from metrosep.controllers._sinumerik_file import (
    Assignment,
    Grid,
    axis_letter,
    grid_of,
    number_text,
    read_assignments,
)
from metrosep.controllers.base import sidecar_options
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    UnsupportedFeatureError,
)

__all__ = [
    "CecTable",
    "axis_names",
    "check_count",
    "check_turns",
    "check_values",
    "factors",
    "opened",
    "pair",
    "read_tables",
    "require_same_axes",
    "table_lines",
]


_NAME = "$AN_CEC"
_AXES = ("INPUT_AXIS", "OUTPUT_AXIS")
_FACTS = ("STEP", "MIN", "MAX", "IS_MODULO")
_WHOLE = ("DIRECTION", "MULT_BY_TABLE")
_POSITION_DECIMALS = 12


@dataclass(frozen=True, slots=True)
class CecTable:
    """One table of a file."""

    index: int  # its index
    grid: Grid  # entries, in units of the file
    input_axis: str  # Machine axes that are looked up and corrected
    output_axis: str
    direction: int  # 0 for both directions of motion, 1 or -1 for one
    multiplied_by: int  # number (index + 1) of the table it is multiplied by, or 0


def table_lines(
    index: int,
    words: Sequence[str],
    span: Sequence[float],
    axes: tuple[str, str],
    facts: Mapping[str, int],
) -> list[str]:
    """Return the lines of one table."""
    low, high = span
    places = {"STEP": (high - low) / (len(words) - 1), "MIN": low, "MAX": high}
    return [
        *(f"{_NAME}[{index},{i}]={w}" for i, w in enumerate(words)),
        *(f"{_NAME}_{k}[{index}]=({a})" for k, a in zip(_AXES, axes, strict=True)),
        *(
            f"{_NAME}_{k}[{index}]={number_text(v, decimals=_POSITION_DECIMALS, at_least=1)}"
            for k, v in places.items()
        ),
        *(f"{_NAME}_{k}[{index}]={v}" for k, v in facts.items()),
    ]


def read_tables(assignments: list[Assignment], path: Path) -> dict[int, CecTable]:
    """Return the tables of a file by index."""
    values: dict[int, dict[int, Assignment]] = {}
    facts: dict[int, dict[str, Assignment]] = {}
    for a in assignments:
        kind = a.name.removeprefix(f"{_NAME}_")
        numbers = [int(i) for i in a.indices if i.isdigit()]
        if a.name == _NAME and len(numbers) == len(a.indices) == 2:
            values.setdefault(numbers[0], {})[numbers[1]] = a
        elif (
            a.name != _NAME
            and kind in (*_FACTS, *_AXES, *_WHOLE)
            and len(numbers) == len(a.indices) == 1
        ):
            facts.setdefault(numbers[0], {})[kind] = a
        else:
            raise CorruptFileError(
                path, f"line {a.line}: {a.name}[{','.join(a.indices)}] is no part of such a table"
            )
    if not values and not facts:
        raise CorruptFileError(path, "it holds no table")
    return {
        index: _one(index, values.get(index, {}), facts.get(index, {}), path)
        for index in sorted({*values, *facts})
    }


def _one(
    index: int, values: dict[int, Assignment], facts: dict[str, Assignment], path: Path
) -> CecTable:
    what = f"table {index}"
    missing = [k for k in (*_AXES, *_WHOLE) if k not in facts]
    if missing:
        raise CorruptFileError(path, f"{what} has no {missing[0]}", field=missing[0])
    axes = []
    for key in _AXES:
        value = facts[key].value
        inside = value.removeprefix("(").removesuffix(")").strip()
        if f"({inside})" != value.replace(" ", "") or not inside.isidentifier():
            raise CorruptFileError(
                path,
                f"line {facts[key].line}: {key} is a machine axis in parentheses",
                found=value[:40],
            )
        axes.append(inside)
    direction, multiplied = (facts[k].value for k in _WHOLE)
    if direction not in ("0", "1", "-1"):
        raise CorruptFileError(
            path, f"line {facts['DIRECTION'].line}: DIRECTION is 0, 1 or -1", found=direction[:20]
        )
    if not multiplied.isdigit() or len(multiplied) > 9:
        raise CorruptFileError(
            path,
            f"line {facts['MULT_BY_TABLE'].line}: MULT_BY_TABLE is the number of a table or 0",
            found=multiplied[:20],
        )
    grid = grid_of(values, facts, path, what)
    return CecTable(index, grid, axes[0], axes[1], int(direction), int(multiplied))


def check_turns(axis: str, key: str, turns: bool) -> None:
    """Refuse an axis whose name contradicts what is said about it."""
    if is_rotary(axis) != turns:
        raise DataError(f"the axis is {axis}, but {key}={turns}: a turning axis is in degrees")


def check_count(positions: FloatArray, o: Mapping[str, Any], axis: str) -> None:
    """Refuse more entries than a table holds."""
    most = o["points_limit"]
    if most is not None and positions.size > most:
        needed = float(positions[-1] - positions[0]) / (most - 1)
        raise LimitError(
            f"{positions.size} entries over {axis}, a table holds {most}; use a spacing of at least "
            f"{format_span(axis, needed)} (an option of this dialect), or raise MD18342"
        )


def check_values(
    values: FloatArray, positions: FloatArray, limit: float | None, axis: str, corrected: str
) -> None:
    """Refuse corrections above the limit of the control."""
    largest = int(np.abs(values).argmax())
    if limit is not None and abs(values[largest]) > limit:
        raise LimitError(
            f"the correction at {format_position(axis, float(positions[largest]))} is "
            f"{format_amount(corrected, abs(float(values[largest])), digits=3)}, the control adds at "
            f"most {format_amount(corrected, limit)} (MD32720); raise the limit or remove the line "
            "from the table"
        )


def pair(
    tables: Mapping[int, CecTable], path: Path, options: Mapping[str, Any]
) -> tuple[CecTable, CecTable | None]:
    """Return the chosen table, and that of the other direction."""
    if any(t.multiplied_by for t in tables.values()):
        raise UnsupportedFeatureError(
            f"{path}: tables multiply (MULT_BY_TABLE): read it as 'sinumerik-cec-product'"
        )
    index = options.get("table_index", min(tables))
    if index not in tables:
        raise DataError(f"{path}: no table {index}; there are {', '.join(map(str, tables))}")
    first = tables[index]
    others = [
        t
        for t in tables.values()
        if t.index != index
        and (t.input_axis, t.output_axis) == (first.input_axis, first.output_axis)
        and (t.direction == -first.direction or not t.direction or not first.direction)
    ]
    if len(tables) > 1 + len(others) and "table_index" not in options:
        raise UnsupportedFeatureError(
            f"{path}: it holds the tables {', '.join(map(str, tables))}; choose with table_index="
        )
    more = [
        t.index
        for t in tables.values()
        if t.output_axis == first.output_axis and t.index != index and t not in others
    ]
    if more:
        raise UnsupportedFeatureError(
            f"{path}: the tables {first.index} and {more[0]} add up on {first.output_axis}: metrosep "
            "reads one table of an axis, or one for each direction"
        )
    if not others:
        return first, None
    same = len(others) == 1 and first.direction and others[0].direction
    if not same or not np.array_equal(others[0].grid.positions, first.grid.positions):
        raise UnsupportedFeatureError(
            f"{path}: the tables {first.index} and {others[0].index} act on the same axes and add up, "
            "or stand at other positions: metrosep reads one for each direction"
        )
    if others[0].grid.modulo != first.grid.modulo:
        raise UnsupportedFeatureError(f"{path}: only one of two directions repeats")
    return first, others[0]


def factors(tables: Mapping[int, CecTable], path: Path) -> tuple[CecTable, CecTable]:
    """Return the table that is multiplied, and the one it is multiplied by."""
    linked = [t for t in tables.values() if t.multiplied_by]
    if len(linked) != 1 or len(tables) != 2:
        raise UnsupportedFeatureError(
            f"{path}: it holds {len(tables)} tables of which {len(linked)} multiply; metrosep reads two "
            "tables, one multiplied by the other"
        )
    first = linked[0]
    other = first.multiplied_by - 1
    if other not in tables or other == first.index:
        raise CorruptFileError(
            path,
            f"table {first.index} is multiplied by table index {other}, which is not in the file",
            field="MULT_BY_TABLE",
        )
    second = tables[other]
    plain = not (first.direction or second.direction or first.grid.modulo or second.grid.modulo)
    if not plain or second.output_axis != first.output_axis:
        raise UnsupportedFeatureError(
            f"{path}: tables that multiply and repeat, depend on the direction or differ in the "
            "output axis are not read"
        )
    return first, second


def opened(
    data: bytes,
    path: Path,
    known: tuple[Option, ...],
    options: Mapping[str, Any],
    controller: str,
) -> tuple[dict[int, CecTable], dict[str, Any], dict[str, str]]:
    """Return the tables of a file by index, and what is known about them."""
    assignments, noted = read_assignments(data, path)
    o = agreed(noted, known, {**sidecar_options(path, known), **options}, path)
    if "entry_sign" not in o:
        raise DataError(
            f"{path}: neither the file nor a sidecar tells the sign of its entries; give entry_sign=1 "
            f"(entry = +e) or -1 to read it as {controller}"
        )
    return read_tables(assignments, path), o, noted


def axis_names(
    noted: Mapping[str, str],
    machine: Sequence[str],
    turns: Sequence[bool],
    otherwise: Sequence[str],
) -> tuple[str, ...]:
    """Return names for machine axes: of the comment, else by their letters, else usual ones.

    Examples
    --------
    >>> axis_names({}, ("AX1", "AX1"), (False, False), ("X", "Z"))
    ('X', 'X')
    """
    told = tuple(noted["axes"].split(",")) if "axes" in noted else ()
    if len(told) == len(machine) and all(told):
        return told
    found: dict[str, str] = {}
    for name, turned, usual in zip(machine, turns, otherwise, strict=True):
        letter = axis_letter(name, turns=turned, otherwise=usual)
        free = [letter, *("CBA" if turned else "XYZUVW")]
        found.setdefault(name, next(k for k in free if k not in found.values()))
    return tuple(found[name] for name in machine)


def require_same_axes(named: Sequence[str], machine: Sequence[str], path: Path) -> None:
    """Refuse names that say something else about the corrected axis than the machine axes do."""
    if [n == named[-1] for n in named[:-1]] != [m == machine[-1] for m in machine[:-1]]:
        raise CorruptFileError(
            path,
            f"it is said to correct {named[-1]} over {', '.join(named[:-1])}, but its tables correct "
            f"{machine[-1]} over {', '.join(machine[:-1])}",
            hint="write the table again, or use the sidecar that fits",
        )
