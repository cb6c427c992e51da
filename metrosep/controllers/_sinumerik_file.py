"""The text of SINUMERIK compensation files: a header, assignments of system variables, ``M17``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import format_position, is_rotary
from metrosep.controllers._grids import format_amount, format_span
from metrosep.controllers._notes import agreed, note, read_notes
from metrosep.controllers.base import Simulator, sidecar_options
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)

__all__ = [
    "Assignment",
    "Grid",
    "axis_letter",
    "axis_names",
    "check_count",
    "check_turns",
    "check_values",
    "checked_modulo",
    "checked_name",
    "factors",
    "folded",
    "grid_of",
    "number_text",
    "opened",
    "pair",
    "read_assignments",
    "require_same_axes",
    "table_lines",
    "turning",
    "units",
    "write_program",
]

_MM = 1e-3
_DEGREE = float(np.pi) / 180.0
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)")
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_HEADER = re.compile(r"%_N_\w+_INI", re.ASCII)
_LETTER = re.compile(r"([A-CU-Z])\d*", re.ASCII)
_LINE = re.compile(r"(\$[A-Z][A-Z_]*) *\[ *([^\[\]]*?) *\] *= *(.*\S)", re.ASCII)
_WHOLE = 1e-6
"""MAX - MIN over STEP is a whole number, but for rounding of the decimals in the file."""

_LARGEST = 1e12
"""No position or entry of a file is as large, in mm or degrees."""

_MOST = 1e9
"""Entries of a table, at most; far above any control."""

_SAME = 1e-12
"""Ends of a table that repeats are equal, but for rounding, in m or rad."""


@dataclass(frozen=True, slots=True)
class Assignment:
    """One line of the file."""

    line: int  # its number
    name: str  # system variable
    indices: tuple[str, ...]  # in the brackets
    value: str  # after the equals sign


@dataclass(frozen=True, slots=True)
class Grid:
    """Entries of one table."""

    low: float  # first position, last position and spacing, in units of the file
    high: float
    step: float
    entries: FloatArray  # shape (n,): in units of the file
    modulo: bool  # whether it repeats

    @property
    def positions(self) -> FloatArray:
        """Where the entries stand, in units of the file."""
        return np.asarray(self.low + self.step * np.arange(self.entries.size), dtype=np.float64)


def checked_name(name: str, what: str) -> str:
    """Return the name of a machine axis, and refuse what is none."""
    if not _NAME.fullmatch(name):
        raise DataError(f"{what}={name!r} is no name of a machine axis such as 'X1'")
    return name


def number_text(value: float, *, decimals: int, at_least: int = 0) -> str:
    """Return a number without exponent and without needless zeros.

    Examples
    --------
    >>> number_text(0.003, decimals=9), number_text(5.0, decimals=9, at_least=1)
    ('0.003', '5.0')
    """
    whole, _, rest = f"{value:.{decimals}f}".partition(".")
    rest = rest.rstrip("0").ljust(at_least, "0")
    text = f"{whole}.{rest}" if rest else whole
    return text.removeprefix("-") if not float(text) else text


def write_program(
    name: str,
    channel: int,
    comments: Sequence[str],
    lines: Sequence[str],
    facts: Mapping[str, object],
) -> bytes:
    """Return a file."""
    head = [f"%_N_{name}", f"CHANDATA({channel})"]
    told = [*comments, note(facts, [*head, *lines, "M17"])]
    body = [*head, *(f"; {c}" for c in told), *lines, "M17"]
    return ("\n".join(body) + "\n").encode("ascii")


def read_assignments(data: bytes, path: Path) -> tuple[list[Assignment], dict[str, str]]:
    """Return the assignments of a file, and the facts of metrosep's own comment."""
    try:
        text = data.decode("ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(path, "not ASCII text", offset=exc.start) from None
    comments: list[str] = []
    code: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words, mark, comment = line.partition(";")
        if mark:
            comments.append(comment.strip())
        if words.strip():
            code.append((number, words.strip()))
    head = [c for _, c in code[:2]]
    if (
        len(head) < 2
        or not _HEADER.fullmatch(head[0])
        or not re.fullmatch(r"CHANDATA\(\d+\)", head[1])
    ):
        raise CorruptFileError(
            path,
            "not a compensation file of SINUMERIK",
            expected="%_N_..._INI and CHANDATA(...)",
            found=repr(" ".join(head))[:60],
        )
    if code[-1][1] != "M17":
        raise CorruptFileError(
            path, "it does not end with M17: it was cut short", found=repr(code[-1][1])[:60]
        )
    found = _assignments(code[2:-1], path)
    return found, read_notes(comments, [c for _, c in code], path)


def _assignments(code: list[tuple[int, str]], path: Path) -> list[Assignment]:
    found: dict[tuple[str, tuple[str, ...]], Assignment] = {}
    for number, line in code:
        match = _LINE.fullmatch(line)
        if match is None:
            raise CorruptFileError(
                path, f"line {number} is not $NAME[index]=value but {line[:60]!r}"
            )
        indices = tuple(i.strip() for i in match[2].split(","))
        if not all(re.fullmatch(r"\d{1,9}|[A-Za-z]\w{0,40}", i, re.ASCII) for i in indices):
            raise CorruptFileError(
                path,
                f"line {number}: the indices {match[2][:40]!r} are not numbers and axes with commas "
                "between them",
            )
        key = (match[1], indices)
        if key in found:
            raise CorruptFileError(
                path,
                f"line {number} sets {line.partition('=')[0]} again, after line {found[key].line}",
            )
        found[key] = Assignment(number, match[1], indices, match[3])
    return list(found.values())


def grid_of(
    values: dict[int, Assignment], facts: dict[str, Assignment], path: Path, what: str
) -> Grid:
    """Return the entries of a table, checked against its own first, last and step."""
    missing = [k for k in ("STEP", "MIN", "MAX", "IS_MODULO") if k not in facts]
    if missing:
        raise CorruptFileError(path, f"{what} has no {missing[0]}", field=missing[0])
    step, low, high = (_number(facts[k], path) for k in ("STEP", "MIN", "MAX"))
    if facts["IS_MODULO"].value not in ("0", "1"):
        raise CorruptFileError(
            path,
            f"line {facts['IS_MODULO'].line}: IS_MODULO is 0 or 1",
            found=facts["IS_MODULO"].value[:20],
        )
    if not step > 0.0 or not high > low:
        raise CorruptFileError(
            path,
            f"{what}: the step must be positive and MAX above MIN",
            found=f"STEP {step:g}, MIN {low:g}, MAX {high:g}",
        )
    count = (high - low) / step
    if not count < _MOST:
        raise CorruptFileError(
            path,
            f"{what}: MIN, MAX and STEP ask for {count:.3g} entries",
            found=f"{len(values)} entries",
        )
    if abs(count - round(count)) > _WHOLE * max(count, 1.0):
        raise CorruptFileError(path, f"{what}: MAX - MIN is not a multiple of STEP", found=count)
    if len(values) != round(count) + 1 or max(values) != round(count):
        raise CorruptFileError(
            path,
            f"{what}: MIN, MAX and STEP ask for the entries 0 ... {round(count)}",
            found=f"{len(values)} entries, the last {max(values, default=-1)}",
            hint="lines are missing or too many: write the file again",
        )
    entries = np.array([_number(values[i], path) for i in range(len(values))])
    modulo = facts["IS_MODULO"].value == "1"
    if modulo and entries[0] != entries[-1]:
        raise CorruptFileError(
            path,
            f"{what} repeats, but its first entry {entries[0]:g} is not its last {entries[-1]:g}",
        )
    return Grid(low, high, step, entries, modulo)


def _number(assignment: Assignment, path: Path) -> float:
    if not _NUMBER.fullmatch(assignment.value) or not abs(float(assignment.value)) < _LARGEST:
        raise CorruptFileError(
            path, f"line {assignment.line} holds no number but {assignment.value[:40]!r}"
        )
    return float(assignment.value)


def folded(lookup: Simulator, low: float, high: float) -> Simulator:
    """Return a lookup that repeats after its range."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        p = np.asarray(position, dtype=np.float64)
        return lookup(low + np.mod(p - low, high - low), direction)

    return along


def units(*, turns: bool) -> float:
    """Return the unit of an axis in the file: degrees if it turns, else mm."""
    return _DEGREE if turns else _MM


def axis_letter(machine_axis: str, *, turns: bool, otherwise: str) -> str:
    """Return the name of an axis of a table for a machine axis that nothing else names.

    Examples
    --------
    >>> axis_letter("Y1", turns=False, otherwise="X"), axis_letter("AX4", turns=True, otherwise="X")
    ('Y', 'C')
    """
    match = _LETTER.fullmatch(machine_axis)
    if match and is_rotary(match[1]) == turns:
        return match[1]
    return otherwise if is_rotary(otherwise) == turns else "C"


def turning(machine_axis: str, told: bool | None, option: str, path: Path) -> bool:
    """Return whether a machine axis turns, and refuse where nothing tells."""
    if told is not None:
        return told
    match = _LETTER.fullmatch(machine_axis)
    if match is None:
        raise DataError(
            f"{path}: nothing tells whether {machine_axis[:40]} is in mm or in degrees; give {option}"
        )
    return is_rotary(match[1])


def checked_modulo(
    words: list[str], values: FloatArray, span: tuple[float, float], axis: str
) -> None:
    """Make both ends of a table that repeats equal as printed, and refuse one that cannot repeat."""
    first, last = float(values[0]), float(values[-1])
    if abs(first - last) > _SAME:
        raise TableError(
            "the table repeats with modulo=True, but its corrections at both ends differ by "
            f"{abs(first - last):.3g}: the axis would step there; make the error equal at both ends"
        )
    period = span[1] - span[0]
    times = 2.0 * math.pi / period
    if is_rotary(axis) and abs(times - round(times)) > _WHOLE * times:
        raise TableError(
            f"the table repeats with modulo=True after {format_span(axis, period, digits=7)}, a turn of "
            f"{axis} is 360 deg: the second turn would be corrected at the wrong place; append the "
            "position 360 deg after the first one, with the first one's correction"
        )
    words[-1] = words[0]


# ---- the text of SINUMERIK sag compensation tables, ``$AN_CEC``: several in one file, by index ----

_FILE_NAME = "$AN_CEC"
_AXES = ("INPUT_AXIS", "OUTPUT_AXIS")
_FACTS = ("STEP", "MIN", "MAX", "IS_MODULO")
_FILE_WHOLE = ("DIRECTION", "MULT_BY_TABLE")
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
        *(f"{_FILE_NAME}[{index},{i}]={w}" for i, w in enumerate(words)),
        *(f"{_FILE_NAME}_{k}[{index}]=({a})" for k, a in zip(_AXES, axes, strict=True)),
        *(
            f"{_FILE_NAME}_{k}[{index}]={number_text(v, decimals=_POSITION_DECIMALS, at_least=1)}"
            for k, v in places.items()
        ),
        *(f"{_FILE_NAME}_{k}[{index}]={v}" for k, v in facts.items()),
    ]


def read_tables(assignments: list[Assignment], path: Path) -> dict[int, CecTable]:
    """Return the tables of a file by index."""
    values: dict[int, dict[int, Assignment]] = {}
    facts: dict[int, dict[str, Assignment]] = {}
    for a in assignments:
        kind = a.name.removeprefix(f"{_FILE_NAME}_")
        numbers = [int(i) for i in a.indices if i.isdigit()]
        if a.name == _FILE_NAME and len(numbers) == len(a.indices) == 2:
            values.setdefault(numbers[0], {})[numbers[1]] = a
        elif (
            a.name != _FILE_NAME
            and kind in (*_FACTS, *_AXES, *_FILE_WHOLE)
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
    missing = [k for k in (*_AXES, *_FILE_WHOLE) if k not in facts]
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
    direction, multiplied = (facts[k].value for k in _FILE_WHOLE)
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
