"""The text of SINUMERIK sag compensation tables, ``$AN_CEC``: several in one file, by index."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import is_rotary
from metrosep.controllers._sinumerik_file import Assignment, Grid, grid_of, number_text
from metrosep.core.errors import CorruptFileError, DataError, LimitError
from metrosep.core.units import format_length

__all__ = [
    "CecTable",
    "check_count",
    "check_turns",
    "check_values",
    "read_tables",
    "table_lines",
]

FloatArray = NDArray[np.float64]

_NAME = "$AN_CEC"
_AXES = ("INPUT_AXIS", "OUTPUT_AXIS")
_FACTS = ("STEP", "MIN", "MAX", "IS_MODULO")
_WHOLE = ("DIRECTION", "MULT_BY_TABLE")
_POSITION_DECIMALS = 12


@dataclass(frozen=True, slots=True)
class CecTable:
    """One table of a file.

    Parameters
    ----------
    index : int
        Its index.
    grid : Grid
        Entries, in units of the file.
    input_axis, output_axis : str
        Machine axes that are looked up and corrected.
    direction : int
        0 for both directions of motion, 1 or -1 for one.
    multiplied_by : int
        Number (index + 1) of the table it is multiplied by, or 0.
    """

    index: int
    grid: Grid
    input_axis: str
    output_axis: str
    direction: int
    multiplied_by: int


def table_lines(
    index: int,
    words: Sequence[str],
    span: Sequence[float],
    axes: tuple[str, str],
    facts: Mapping[str, int],
) -> list[str]:
    """Return the lines of one table.

    Parameters
    ----------
    index : int
        Its index.
    words : sequence of str
        Entries as printed.
    span : sequence of float
        First and last position, in units of the file.
    axes : tuple of str
        Input and output axis.
    facts : mapping
        DIRECTION, MULT_BY_TABLE and IS_MODULO.

    Returns
    -------
    list of str
        Without line ends.
    """
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
    """Return the tables of a file by index.

    Parameters
    ----------
    assignments : list of Assignment
        Of the file.
    path : Path
        For messages.

    Returns
    -------
    dict
        CecTable by index, rising.

    Raises
    ------
    CorruptFileError
        If there is none, or one lacks or contradicts something.
    """
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
    if not multiplied.isdigit():
        raise CorruptFileError(
            path,
            f"line {facts['MULT_BY_TABLE'].line}: MULT_BY_TABLE is the number of a table or 0",
            found=multiplied[:20],
        )
    grid = grid_of(values, facts, path, what)
    return CecTable(index, grid, axes[0], axes[1], int(direction), int(multiplied))


def check_turns(axis: str, key: str, turns: bool) -> None:
    """Refuse an axis whose name contradicts what is said about it.

    Parameters
    ----------
    axis, key : str
        Axis of the table, name of the option.
    turns : bool
        What the option says.

    Raises
    ------
    DataError
        If they contradict each other.
    """
    if is_rotary(axis) != turns:
        raise DataError(f"the axis is {axis}, but {key}={turns}: a turning axis is in degrees")


def check_count(positions: FloatArray, o: Mapping[str, Any], axis: str) -> None:
    """Refuse more entries than a table holds.

    Parameters
    ----------
    positions : ndarray, m
        Of the entries.
    o : mapping
        Options.
    axis : str
        For the message.

    Raises
    ------
    LimitError
        If there are more than `points_limit`.
    """
    most = o["points_limit"]
    if most is not None and positions.size > most:
        needed = float(positions[-1] - positions[0]) / (most - 1)
        raise LimitError(
            f"{positions.size} entries over {axis}, a table holds {most}; use a spacing of at least "
            f"{needed * 1e3:.4g} mm (an option of this dialect), or raise MD18342"
        )


def check_values(
    values: FloatArray, positions: FloatArray, o: Mapping[str, Any], axis: str
) -> None:
    """Refuse corrections above the limit of the control.

    Parameters
    ----------
    values, positions : ndarray, m
        Corrections and where they stand.
    o : mapping
        Options.
    axis : str
        For the message.

    Raises
    ------
    LimitError
        If one is above `value_limit`.
    """
    largest = int(np.abs(values).argmax())
    if o["value_limit"] is not None and abs(values[largest]) > o["value_limit"]:
        raise LimitError(
            f"the correction at {axis} = {positions[largest] * 1e3:.6g} mm is "
            f"{format_length(abs(float(values[largest])), digits=3)}, the control adds at most "
            f"{format_length(o['value_limit'])} (MD32720); raise the limit or remove the line from the "
            "table"
        )
