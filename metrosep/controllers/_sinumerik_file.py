"""The text of SINUMERIK compensation files: a header, assignments of system variables, ``M17``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import (
    format_amount,
    format_position,
    format_span,
    is_rotary,
)
from metrosep.controllers._facts import note, read_notes, settled
from metrosep.controllers._grammar import (
    REAL,
    WHOLE,
    Word,
    choice,
    code_rows,
    damaged,
    decoded,
    is_real,
    joined,
    short,
)
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    Example,
    LimitError,
    TableError,
    UnsupportedFeatureError,
)

_MM = 1e-3
_DEGREE = float(np.pi) / 180.0
_NAME = re.compile(r"[A-Za-z]\w*", re.ASCII)
_HEADER = re.compile(r"%_N_\w+_INI", re.ASCII)
_LETTER = re.compile(r"([A-CU-Z])\d*", re.ASCII)
_LINE = re.compile(r"(\$[A-Z][A-Z_]*) *\[ *([^\[\]]*?) *\] *= *(.*\S)", re.ASCII)
_WHOLE = 1e-6
"""MAX - MIN over STEP is a whole number, but for rounding of the decimals in the file."""

_DECIMALS = 12
"""Decimals of a position."""

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
        raise DataError(f"{what}={name!r} is not a name of a machine axis such as 'X1'")
    return name


def write_program(
    name: str,
    channel: int,
    comments: Sequence[str],
    lines: Sequence[str],
    facts: Mapping[str, object],
) -> bytes:
    """Return a file."""
    head = [f"%_N_{name}", f"CHANDATA({channel})"]
    stated = [*comments, note(facts, [*head, *lines, "M17"])]
    body = [*head, *(f"; {c}" for c in stated), *lines, "M17"]
    return joined(body)


def read_assignments(data: bytes, path: Path) -> tuple[list[Assignment], dict[str, str]]:
    """Return the assignments of a file, and the facts of metrosep's own comment."""
    lines = decoded(data, path, "compensation file of SINUMERIK").splitlines()
    code, comments = code_rows(lines, ";")
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


_REAL = replace(REAL, write=lambda v: short(v, _DECIMALS, at_least=1))
_AXIS = Word(r"\( *[A-Za-z_]\w* *\)", lambda text: text.strip("() "), "({})".format)
_SAID = {
    "IS_MODULO": "0 or 1",
    "DIRECTION": "0, 1 or -1",
    "MULT_BY_TABLE": "the number of a table or 0",
    **dict.fromkeys(("INPUT_AXIS", "OUTPUT_AXIS"), "a machine axis in parentheses"),
}
_GRID = {"STEP": _REAL, "MIN": _REAL, "MAX": _REAL}


@dataclass(slots=True)
class Table:
    """One table of a file: its assignments by index and by fact."""

    key: tuple[Any, ...]
    values: dict[int, Assignment] = field(default_factory=dict)
    facts: dict[str, Assignment] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Variables:
    """System variables of a kind of table: ``name[k,i,...]`` its entries, ``name_FACT[k,...]`` its facts."""

    name: str
    key: tuple[Word, ...]  # indices of a table; that of an entry stands behind the first
    facts: Mapping[str, Word]

    def lines(
        self, key: Sequence[object], words: Sequence[str], span: Sequence[float], **facts: object
    ) -> list[str]:
        """Return the lines of one table, over positions from low to high."""
        first, *others = map(str, key)
        low, high = span
        known = {"STEP": (high - low) / (len(words) - 1), "MIN": low, "MAX": high, **facts}
        return [
            *(
                f"{self.name}[{','.join([first, str(i), *others])}]={w}"
                for i, w in enumerate(words)
            ),
            *(
                f"{self.name}_{name}[{','.join([first, *others])}]={word.write(known[name])}"
                for name, word in self.facts.items()
            ),
        ]

    def tables(
        self, assignments: Sequence[Assignment], path: Path
    ) -> dict[tuple[Any, ...], Table]:
        """Return the tables of a file by their indices."""
        found: dict[tuple[Any, ...], Table] = {}
        for a in assignments:
            kind = a.name.removeprefix(f"{self.name}_")
            own = a.indices[:1] + a.indices[2:] if a.name == self.name else a.indices
            fits = len(own) == len(self.key) and all(
                re.fullmatch(w.pattern, k, re.ASCII) for w, k in zip(self.key, own, strict=True)
            )
            is_entry = a.name == self.name and len(a.indices) == len(self.key) + 1
            if not fits or not (a.indices[1].isdigit() if is_entry else kind in self.facts):
                raise CorruptFileError(
                    path,
                    f"line {a.line}: {a.name}[{','.join(a.indices)}] is not part of such a table",
                )
            key = tuple(w.read(k) for w, k in zip(self.key, own, strict=True))
            table = found.setdefault(key, Table(key))
            place: dict[Any, Assignment] = table.values if is_entry else table.facts
            before = place.setdefault(int(a.indices[1]) if is_entry else kind, a)
            if before is not a:
                raise CorruptFileError(
                    path, f"line {a.line} sets what line {before.line} sets: {a.name} at one index"
                )
        return found

    def grid(self, table: Table, what: str, path: Path) -> tuple[Grid, dict[str, Any]]:
        """Return the entries of a table, checked against its own first, last and step, and its facts."""
        missing = [k for k in self.facts if k not in table.facts]
        if missing:
            raise CorruptFileError(path, f"{what} has no {missing[0]}", field=missing[0])
        known = {k: _value(table.facts[k], w, k, path) for k, w in self.facts.items()}
        step, low, high = (known[k] for k in _GRID)
        if not step > 0.0 or not high > low:
            raise CorruptFileError(
                path,
                f"{what}: the step must be positive and MAX above MIN",
                found=f"STEP {step:g}, MIN {low:g}, MAX {high:g}",
            )
        values, count = table.values, (high - low) / step
        if not count < _MOST:
            raise CorruptFileError(
                path,
                f"{what}: MIN, MAX and STEP ask for {count:.3g} entries",
                found=f"{len(values)} entries",
            )
        if abs(count - round(count)) > _WHOLE * max(count, 1.0):
            raise CorruptFileError(
                path,
                f"{what}: MAX - MIN is not a multiple of STEP",
                found=f"{count:.6g} steps",
                hint="correct MIN, MAX or STEP, or read the table out of the control again",
            )
        if len(values) != round(count) + 1 or max(values) != round(count):
            raise damaged(
                path,
                f"{what}: MIN, MAX and STEP ask for the entries 0 ... {round(count)}",
                found=f"{len(values)} entries, the last {max(values, default=-1)}",
            )
        entries = np.array([_value(values[i], _REAL, "", path) for i in range(len(values))])
        if known["IS_MODULO"] and entries[0] != entries[-1]:
            raise CorruptFileError(
                path,
                f"{what} repeats, but its first entry {entries[0]:g} is not its last {entries[-1]:g}",
            )
        return Grid(low, high, step, entries, bool(known["IS_MODULO"])), known


def _value(assignment: Assignment, word: Word, fact: str, path: Path) -> Any:
    text = assignment.value
    if not (is_real(text) if word is _REAL else re.fullmatch(word.pattern, text, re.ASCII)):
        if fact in _SAID:
            raise CorruptFileError(
                path, f"line {assignment.line}: {fact} is {_SAID[fact]}", found=text[:40]
            )
        raise CorruptFileError(path, f"line {assignment.line} holds no number but {text[:40]!r}")
    return word.read(text)


ENC = Variables("$AA_ENC_COMP", (Word(".*"), Word(".*")), {**_GRID, "IS_MODULO": choice(0, 1)})
"""Tables of an axis over itself, by encoder and machine axis."""

CEC = Variables(
    "$AN_CEC",
    (WHOLE,),
    {
        "INPUT_AXIS": _AXIS, "OUTPUT_AXIS": _AXIS, **_GRID, "DIRECTION": choice(0, 1, -1),
        "MULT_BY_TABLE": WHOLE, "IS_MODULO": choice(0, 1),
    },
)  # fmt: skip
"""Tables of one axis over another, by number."""


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


def turning(machine_axis: str, stated: bool | None, key: str, path: Path) -> bool:
    """Return whether a machine axis turns, and refuse where nothing states."""
    if stated is not None:
        return stated
    match = _LETTER.fullmatch(machine_axis)
    if match is None:
        asked = f"{key}=True or {key}=False" if key.endswith("turns") else f"{key}=..."
        raise (
            DataError(
                f"{path}: nothing states whether {machine_axis[:40]} is in mm or in degrees; give {asked}"
            )
            .hinting(**{key: Example("True")})
            .hinting(**{key: Example("False")})
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


@dataclass(frozen=True, slots=True)
class CecTable:
    """One table of a file."""

    index: int  # its index
    grid: Grid  # entries, in units of the file
    input_axis: str  # Machine axes that are looked up and corrected
    output_axis: str
    direction: int  # 0 for both directions of motion, 1 or -1 for one
    multiplied_by: int  # number (index + 1) of the table it is multiplied by, or 0


def read_tables(assignments: list[Assignment], path: Path) -> dict[int, CecTable]:
    """Return the tables of a file by index."""
    found = CEC.tables(assignments, path)
    if not found:
        raise CorruptFileError(path, "it holds no table")
    tables = {}
    for (index,), table in sorted(found.items()):
        grid, facts = CEC.grid(table, f"table {index}", path)
        axes = facts["INPUT_AXIS"], facts["OUTPUT_AXIS"]
        tables[index] = CecTable(index, grid, *axes, facts["DIRECTION"], facts["MULT_BY_TABLE"])
    return tables


def check_turns(axis: str, key: str, turns: bool) -> None:
    """Refuse an axis whose name contradicts what is said about it."""
    if is_rotary(axis) != turns:
        raise DataError(
            f"the table has axis {axis}, which {'does not turn' if turns else 'turns'}: say "
            f"{key}={not turns} (a file has degrees for an axis that turns, else mm)"
        ).hinting(**{key: not turns})


def check_count(
    positions: FloatArray, o: Mapping[str, Any], axis: str, datum: str = "MD18342"
) -> None:
    """Refuse more entries than a table holds."""
    most = o["points_limit"]
    if most is not None and positions.size > most:
        needed = float(positions[-1] - positions[0]) / (most - 1)
        raise LimitError(
            f"{positions.size} entries over {axis}, a table holds {most}; use a spacing of at least "
            f"{format_span(axis, needed)} (an option of this dialect), or raise {datum}"
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
    data: bytes, path: Path, known: tuple[Option, ...], options: Mapping[str, Any]
) -> tuple[dict[int, CecTable], dict[str, Any], dict[str, str]]:
    """Return the tables of a file by index, and what is known about them."""
    assignments, noted = read_assignments(data, path)
    o = settled(known, options, path, file=noted, needed=("entry_sign",), partial=True)
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
    stated = tuple(noted["axes"].split(",")) if "axes" in noted else ()
    if len(stated) == len(machine) and all(stated):
        return stated
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
            f"its sidecar states that it corrects {named[-1]} over {', '.join(named[:-1])}, but its tables correct "
            f"{machine[-1]} over {', '.join(machine[:-1])}",
            hint="write the table again, or use the sidecar that fits",
        )
