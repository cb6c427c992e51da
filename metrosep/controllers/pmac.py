"""Turbo PMAC position compensation, ``DEFINE COMP`` over one motor.

The correction is added to the target motor's desired position, in 1/16 count of that motor; the
entry for an error e is therefore ``round(-16 e / count)``. The first entry stands one spacing from
the zero of the source motor, where the correction is zero by definition; the last one stands at
the span, which rolls over onto that zero. A negative position is read at the top of the table.

References: Delta Tau, Turbo PMAC Software Reference, DEFINE COMP (one-dimensional), I51; PMAC User
Manual, leadscrew compensation (range, roll-over). Grammar and numbers only.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import format_along, format_amount, is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import resampling_error
from metrosep.controllers._facts import agreed, facts_of, printable, read_table, settled
from metrosep.controllers._grammar import (
    Line,
    Word,
    code_rows,
    damaged,
    decoded,
    deg_text,
    joined,
    scaled,
)
from metrosep.controllers._grids import RollingGrid, enclosing_nodes, rolled_values, rolling_grid
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    load_sidecar,
    one_way,
)
from metrosep.controllers.options import (
    TURN,
    AlongOption,
    Option,
    axes_of,
    chosen,
    closed,
    flag,
    in_axes,
    is_angle,
    is_one_turn,
    pick,
    whole,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, Example, LimitError, TableError

# ---- text of Turbo PMAC tables: statements, entries in 1/16 count, facts in comments, limits ----
# Shared by the tables over one motor, over two, and of lost motion. What follows a DEFINE line is
# taken for entries whatever it is, so that nothing but whole numbers may stand there.

SCALE = 16
"""Entries per count of the target motor."""

MOTORS = 32
"""Motors of a Turbo PMAC; PMAC has 8."""

LARGEST = 2**23 - 1
"""Largest entry and span in counts that a 24-bit word holds; more is not documented."""

_ENTRIES_A_LINE = 10

_FEMTOMETRE = 15
"""Decimals of a position in m."""

ACTIVATION = (
    "save what is in the controller; home the motors: the tables count from their zero",
    (
        "delete every GATHER, ROTARY, LOOKAHEAD, TCOMP and BLCOMP buffer; COMP tables of other motors "
        "are deleted from low to high motor and defined from high to low, else PMAC answers ERR003"
    ),
    "send the file with a program that strips comments (everything behind a semicolon)",
    "read the table back: PMAC takes whatever follows DEFINE as entries, without a message",
    (
        "move over the travel with small steps and read the correction that is applied (the motor's "
        "compensation register); its sign must be opposite to the measured error"
    ),
    (
        "type SAVE only after this trial: the file does not, so that a reset drops a wrong table; I51=0 "
        "switches all tables off"
    ),
)
"""Steps to load a table, for all of the family."""

_MOTOR = Word(r"\d{1,2}", int)
_KIND = Word("(?:BL)?COMP", str.upper)
_SPAN = Word(r"\d{1,15}", int)
_GATHER = Line("DELETE GATHER", loose=True)
_DELETE = Line("#{motor}~DELETE {kind}", loose=True, motor=_MOTOR, kind=_KIND)
_SET = Line(
    "I{number}={value}", loose=True, number=Word(r"\d{1,4}", int), value=Word(r"\d{1,12}", int)
)
_INTEGER = re.compile(r"[+-]?\d{1,12}")


def define_line(template: str) -> Line:
    """Return the DEFINE line of a kind of table, of motors, counts of entries, spans and D."""
    sizes = dict.fromkeys(("entries", "rows", "columns"), Word(r"\d{1,6}", int))
    spans = dict.fromkeys(("span", "row_span", "column_span"), _SPAN)
    motors = dict.fromkeys(("owner", "source", "target", "x", "y"), _MOTOR)
    desired = dict.fromkeys(("d", "e"), Word("D?"))
    return Line(template, loose=True, **sizes, **spans, **motors, **desired)


@dataclass(frozen=True, slots=True)
class Program:
    """A PMAC file, read."""

    define: Mapping[str, Any]  # words of the DEFINE line
    entries: NDArray[np.int64]  # the numbers that follow it
    settings: Mapping[int, int]  # to int: I-variables that the file sets
    facts: Mapping[str, str]  # to str: of its comments


def read_program(
    data: bytes,
    path: Path,
    define: Line,
    count_entries: Callable[[Mapping[str, Any]], int],
    sets: Callable[[int], Sequence[int]] = lambda _: (51,),
) -> Program:
    """Return what a PMAC file holds; strict."""
    lines = decoded(data, path, "Turbo PMAC table").splitlines()
    code, comments = code_rows(lines, ";")
    head = 0
    while head < len(code) and (_GATHER.read(code[head][1]), _DELETE.read(code[head][1])) != (
        None,
        None,
    ):
        head += 1
    found = define.read(code[head][1]) if head < len(code) else None
    if found is None:
        raise CorruptFileError(
            path,
            "not a table of Turbo PMAC",
            field="DEFINE line",
            found=f"line {code[head][0]}: {code[head][1][:60]!r}"
            if head < len(code)
            else "the end",
            hint="the file holds DELETE lines, one DEFINE line, its entries and I51=1",
        )
    for number in (v for n, v in found.items() if define.words[n] is _MOTOR and v is not None):
        if not 1 <= number <= MOTORS:
            raise damaged(
                path,
                f"there is no motor #{number}",
                field="DEFINE line",
                expected=f"#1 ... #{MOTORS}",
                found=code[head][1][:60],
            )
    own = _DELETE.write(motor=found["owner"], kind="BLCOMP" if "BL" in define.template else "COMP")
    for number, text in code[:head]:
        deleted = _DELETE.read(text)
        if deleted is not None and _DELETE.write(**deleted) != own:
            raise damaged(
                path,
                f"line {number} deletes another table than the file defines",
                field="DELETE line",
                expected=own,
                found=text[:60],
            )
    entries, rest = _entries(code[head + 1 :], count_entries(found), path)
    settings = _settings(rest, path, sets(found["owner"]))
    return Program(found, entries, settings, facts_of(comments, path))


def _entries(
    code: Sequence[tuple[int, str]], wanted: int, path: Path
) -> tuple[NDArray[np.int64], Sequence[tuple[int, str]]]:
    found: list[int] = []
    for used, (number, text) in enumerate(code):
        if len(found) == wanted:
            return np.array(found, dtype=np.int64), code[used:]
        words = text.split()
        if not all(map(_INTEGER.fullmatch, words)) or len(found) + len(words) > wanted:
            raise damaged(
                path,
                f"line {number}: {len(found)} of {wanted} entries stand before {text[:40]!r}; PMAC "
                "takes exactly as many whole numbers as the DEFINE line says, whatever follows",
            )
        numbers = [int(w) for w in words]
        found.extend(numbers)
        too_large = [v for v in numbers if abs(v) > LARGEST]
        if too_large:
            raise damaged(path, f"line {number}: the entry {too_large[0]} is not one of 24 bits")
    if len(found) != wanted:
        raise damaged(
            path,
            f"the file ends after {len(found)} of {wanted} entries; PMAC would take the next "
            "commands it gets for entries",
        )
    return np.array(found, dtype=np.int64), ()


def _settings(code: Sequence[tuple[int, str]], path: Path, sets: Sequence[int]) -> dict[int, int]:
    values: dict[int, int] = {}
    for position, (number, text) in enumerate(code):
        found = _SET.read(text)
        last = position == len(code) - 1
        if found is not None and found["number"] in sets and found["number"] not in values:
            values[found["number"]] = found["value"]
        elif not (last and text.upper() == "SAVE"):
            raise damaged(
                path,
                f"line {number}: {text[:60]!r} does not belong behind the entries",
                expected=", ".join(f"I{i}=" for i in sets) + "; SAVE may be last",
            )
    if values.get(51) != 1:
        raise damaged(
            path,
            "I51 is not set to 1: PMAC would not use the table",
            field="I51",
            expected="I51=1 behind the entries",
            found=values.get(51, "nothing"),
        )
    return values


def rolled_size(program: Program, path: Path) -> tuple[int, int]:
    """Return entries and counts of a table over one motor, and refuse one that jumps at the roll-over."""
    n, counts = program.entries.size, program.define["span"]
    if n == 0 or counts < n:
        raise damaged(
            path, f"{n} entries over {counts} counts are not a table", field="DEFINE line"
        )
    if program.entries[-1] != 0:
        raise damaged(
            path,
            "the last entry stands at the roll-over, where the table is zero by definition: the axis "
            "would jump there",
            field="last entry",
            expected=0,
            found=int(program.entries[-1]),
        )
    return n, counts


def refuse_ends(given: Mapping[str, Any], span: Mapping[str, float], axis: str) -> None:
    """Refuse options for reading that contradict the ends of what is written."""
    for name, end in span.items():
        if given[name] not in (None, end):
            raise TableError(
                f"{name}= is for reading; what is written ends at {format_along(axis, end)}"
            )


def entry_lines(entries: Iterable[int]) -> list[str]:
    """Return entries as lines of at most ten."""
    words = [str(int(v)) for v in entries]
    return [
        " ".join(words[i : i + _ENTRIES_A_LINE]) for i in range(0, len(words), _ENTRIES_A_LINE)
    ]


def rounded_entries(
    values: FloatArray, count: float, place: Callable[[int], str], axis: str
) -> NDArray[np.int64]:
    """Return corrections in 1/16 count."""
    scaled_values = np.rint(SCALE * values / count)
    worst = int(np.abs(scaled_values).argmax())
    if abs(scaled_values[worst]) > LARGEST:
        raise LimitError(
            f"the correction {format_amount(axis, float(values[worst]))} at {place(worst)} is "
            f"{scaled_values[worst]:.0f} sixteenths of a count of {format_amount(axis, count)}; 24 bits "
            f"hold {LARGEST}: check the units of the error and of count="
        )
    return np.asarray(scaled_values, dtype=np.int64)


def motor(name: str, which: str) -> Option:
    """Return the option for the number of a motor."""
    return whole(name, which, 1, MOTORS)


def signed(name: str, whose: str) -> Option:
    """Return the option for the direction of a motor."""
    return pick(
        name,
        f"-1 if the counts of {whose} motor fall where its axis rises (#1->-1000X)",
        (1, -1),
        default=1,
    )


LONG_SPAN = flag(
    "long_span", "you listed a table of more than 8388607 counts back from the controller"
)
_READING = "for reading a file that does not say: {} position of its travel"
GRID = (
    AlongOption(
        "span",
        "length after which positions roll over; chosen with a margin if omitted, one turn of an axis "
        "that turns",
        positive=True,
    ),
    AlongOption("spacing", "distance of the entries; that of the table if omitted", positive=True),
    LONG_SPAN,
    AlongOption("first", _READING.format("lowest")),
    AlongOption("last", _READING.format("highest")),
)
"""Options of a table over one motor."""


def program_text(
    title: str,
    names: Mapping[str, str],
    facts: Mapping[str, Any],
    define: Line,
    words: Mapping[str, Any],
    rows: Iterable[Iterable[int]],
    *,
    turning: Iterable[str] = (),
    sets: Mapping[int, int | None] | None = None,
) -> bytes:
    """Return a file: its facts as comments, DELETE lines, the DEFINE line, entries and settings.

    `turning` names the facts that are angles.
    """
    angles = {*turning}
    kind = "BLCOMP" if "BL" in define.template else "COMP"
    return joined(
        [
            f"; metrosep: {title}",
            *(f"; {n} = {axis}" for n, axis in names.items()),
            *(
                f"; {n} = {_fact(n, v, turns=n in angles)}"
                for n, v in facts.items()
                if v is not None
            ),
            _GATHER.write(),
            _DELETE.write(motor=words["owner"], kind=kind),
            define.write(**words),
            *(line for row in rows for line in entry_lines(row)),
            *(_SET.write(number=n, value=v) for n, v in (sets or {}).items() if v is not None),
            "I51=1",
        ]
    )


def _fact(name: str, value: Any, *, turns: bool) -> str:
    """Return a motor or a sign as it is, an angle in deg, a length in mm or, of a count, in nm."""
    if not isinstance(value, float):
        return str(value)
    if turns:
        return f"{deg_text(value)} deg"
    if "count" in name:
        return f"{scaled(value, 9)} nm"
    return f"{scaled(round(value, _FEMTOMETRE), 3)} mm"


def motors_of(stated: Mapping[str, int], known: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return options with the motors that the DEFINE line names, and refuse contradictions."""
    checked = {
        name: agreed(
            path, name, {"the DEFINE line": n, "its comment, user or sidecar": known.get(name)}
        )
        for name, n in stated.items()
    }
    return {**known, **checked}


def turning_names(known: Iterable[Option], axes: Mapping[str, str]) -> list[str]:
    """Return the options that are angles for a table of these axes."""
    return [o.name for o in known if isinstance(o, AlongOption) and is_rotary(axes[o.of])]


def axes_in_file(
    path: Path, facts: Mapping[str, str], options: Mapping[str, Any], *, same: bool
) -> dict[str, str]:
    """Return the axes of comments or sidecar, else letters that turn where an option is an angle.

    `same` says that one motor is source and target.
    """
    if "axis" in facts and "compensates" in facts:
        return {"axis": facts["axis"], "compensates": facts["compensates"]}
    if load_sidecar(path).get("table"):
        known = identity(path, first=0.0)
        return {"axis": known["axis"], "compensates": known["compensates"]}
    axis = "C" if any(is_angle(v) for n, v in options.items() if same or n != "count") else "X"
    corrected = "C" if is_angle(options.get("count")) else "Z"
    return {"axis": axis, "compensates": axis if same else corrected}


def turn_of(axis: str, span: float | None, travel: float, count: float) -> float | None:
    """Return the span of a table: that of the user, else one turn where the axis turns."""
    if span is not None or not is_rotary(axis) or travel > TURN * (1.0 + 1e-9):
        return span
    counts = TURN / count
    if abs(counts - round(counts)) > 1e-9 * counts + 1e-6:
        raise TableError(
            f"one turn of {axis} is {counts:.9g} counts; a table that repeats with the turn needs a "
            "whole number: check count=, or state span="
        )
    return TURN


def rolls_over(axes: Iterable[tuple[str, int]]) -> tuple[Finding, ...]:
    """Return what the motors of axes that turn must agree with."""
    return tuple(
        Finding.warning(
            f"the table over {axis} rolls over after {counts} counts",
            "Ixx27 of its motor, if it is set, must be that number",
            "coverage",
        )
        for axis, counts in axes
        if is_rotary(axis)
    )


def named_axes(
    path: Path, program: Program, first: float, letters: Mapping[str, str]
) -> dict[str, Any]:
    """Return what a table's file cannot hold: of the sidecar, else of the comments, else these letters."""
    facts, owner = program.facts, program.define["owner"]
    source, target = (program.define.get(k) or owner for k in ("source", "target"))
    same_motor = source == target
    found = identity(path, first=first)
    pair = found["axis"], found["compensates"]
    if ("axis" in facts) != ("compensates" in facts):
        raise damaged(
            path,
            "one of the comments that name the axes is missing",
            expected="axis and compensates",
            found="axis" if "axis" in facts else "compensates",
        )
    told = (facts["axis"], facts["compensates"]) if "axis" in facts else None
    if not load_sidecar(path):
        pair = told or (letters["axis"], letters["axis" if same_motor else "compensates"])
        found["reference"] = 0.0
    if (told is not None and pair != told) or (pair[0] == pair[1]) != same_motor:
        raise damaged(
            path,
            "axes and motors contradict each other",
            field="axes",
            expected=f"{pair[0]} corrects {pair[1]}"
            + (
                f" (sidecar), {told[0]} corrects {told[1]} (comments)"
                if told and told != pair
                else ""
            ),
            found=f"{'one motor' if same_motor else 'two motors'} in the DEFINE line",
        )
    return {**found, "axis": pair[0], "compensates": pair[1]}


def require_short_span(counts: int, long_span: bool, axis: str) -> None:
    """Refuse a span that no document is known to allow."""
    if counts > LARGEST and not long_span:
        raise LimitError(
            f"{axis}: the span is {counts} counts; more than {LARGEST} (24 bits) is not documented: "
            "define such a table on the controller, list it back, then say long_span=True"
        ).hinting(long_span=Example("True"))


# ------------------------------------------------------------------------------------------------

_TOLD = ("source_sign", "motor_zero")
"""Options that are never guessed when a file is read."""

_FACTS = (
    "count", "source_count", "motor_zero", "first", "last", "source_sign", "target_sign",
    "source_motor", "target_motor", "owner",
)  # fmt: skip
"""What a file says of its machine."""

_DEFINE = define_line("#{owner}~DEFINE COMP {entries},[#{source}{d},][#{target},]{span}")


def require_one_way(table: CompensationTable) -> None:
    """Refuse a table with two directions."""
    if table.reverse is not None and float(np.abs(table.reverse - table.forward).max()) >= 1e-12:
        raise TableError(
            "DEFINE COMP holds one correction for both directions, this table has two; make it with "
            "direction='forward' and write the one with both as controller='pmac-backlash' besides, "
            "or with direction='both'"
        ).hinting(direction="both")


def motor_range(
    options: Mapping[str, Any], n: int, step: float, path: Path, axis: str
) -> tuple[int, int]:
    """Return the first and last node that a file speaks of, negative below the zero of the motor."""
    first, last = options["first"], options["last"]
    if first is None or last is None:
        return 0, n
    ends = sorted(options["source_sign"] * (p - options["motor_zero"]) for p in (first, last))
    if max(ends[1], 0.0) - min(ends[0], 0.0) > (n + 0.5) * step:
        raise damaged(
            path,
            "the positions it is made for do not fit its span",
            field="first, last",
            expected=f"at most {format_along(axis, n * step)} with the zero of the motor",
            found=f"{format_along(axis, first)} ... {format_along(axis, last)}",
        )
    nodes = enclosing_nodes(step, ends[0], ends[1])
    return int(nodes[0]), int(nodes[-1])


@dataclass(frozen=True, slots=True)
class Filled:
    """Values of a broken line at the entries of a table over one motor."""

    grid: RollingGrid
    entries: list[int]  # from the first spacing on to the roll-over, in 1/16 count
    rounding: float  # m: largest
    motor: NDArray[Any]  # m: nodes over the travel, and the values there
    values: FloatArray


def filled(
    table: CompensationTable, y: FloatArray, given: Mapping[str, Any], *, tolerance: float
) -> Filled:
    """Return the entries of values at a table's positions, zero at the motor's zero but for a part of one."""
    s, count, zero = given["source_sign"], given["count"], given["motor_zero"]
    x = (s * (table.positions - zero))[::s]
    own = given.get("source_count", count)
    travel = max(float(x[-1]), 0.0) - min(float(x[0]), 0.0)
    span = turn_of(table.axis, given["span"], travel, own)
    grid = rolling_grid(x, span=span, spacing=given["spacing"], count=own, axis=table.axis)
    require_short_span(grid.counts, given["long_span"], table.axis)
    axes = table.axis, table.compensates
    values = rolled_values(grid, x, y[::s], tolerance * count / SCALE, axes)
    at = zero + s * grid.positions
    entries = rounded_entries(
        values, count, lambda k: format_along(table.axis, float(at[k])), table.compensates
    )
    j = enclosing_nodes(grid.step, float(x[0]), float(x[-1]))
    rounding = float(np.abs(entries * count / SCALE - values).max())
    return Filled(grid, np.roll(entries, -1).tolist(), rounding, j * grid.step, values[j % grid.n])


class OneMotor(Dialect):
    """A table over one motor, read; what its nodes say of the axis is for each kind to state."""

    @abstractmethod
    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, float, dict[str, Any], Program]:
        """Return values at nodes 0 ... n in m of the motor, the spacing, options, the file."""

    @abstractmethod
    def _in_axis(
        self, motor: NDArray[Any], values: FloatArray, known: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return positions and columns of the axis, from positions of the motor."""

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table over the travel it was made for."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        low, high = motor_range(known, n, step, path, known["axes"]["axis"])
        j = np.arange(low, high + 1)
        columns = self._in_axis(j * step, nodes[j % n], known)
        axes = named_axes(path, program, float(columns["positions"][0]), known["axes"])
        return read_table(**columns, **axes)

    def facts(self, data: bytes, path: Path, **options: Any) -> dict[str, Any]:
        """Return what a file says of its machine."""
        _, _, known, program = self._read(data, path, options)
        return {**known, **named_axes(path, program, 0.0, known["axes"])}


class PMAC(OneMotor):
    """Writer and reader of tables over one motor; see the module."""

    info = DialectInfo(
        id="pmac",
        title="Turbo PMAC position compensation (DEFINE COMP)",
        entry="correction added to the target motor in 1/16 count: round(-16 e / count)",
        units="1/16 count of the target motor; span in counts of the source motor",
        outside="rolls over: the position is taken modulo the span",
        sign_status="documented: added to the target's desired position (Software Reference)",
        activation=ACTIVATION,
        spacing="uniform",
        directions="one",
        resolution="1/16 count of the target motor",
        reference_rule="zero at the zero of the source motor, by definition",
        suffix=".pmc",
        example={"count": "10 nm", "source_motor": 1, "target_motor": 1},
        page="pmac",
    )

    options = (
        AlongOption(
            "count",
            "length of one count of the target motor, or its angle",
            required=True,
            positive=True,
            of="compensates",
        ),
        AlongOption(
            "source_count",
            "length of one count of the source motor, or its angle; as count if omitted",
            positive=True,
        ),
        motor("source_motor", "number of the motor whose position is looked up; 1 if omitted"),
        motor(
            "target_motor",
            "number of the motor that is corrected; the source if omitted and "
            "the table corrects its own axis",
        ),
        motor("owner", "motor the table belongs to; the target if omitted"),
        flag("desired", "look up the desired position (D), not the actual one", default=True),
        signed("source_sign", "the source"),
        pick(
            "target_sign",
            "-1 if the counts of the target motor fall where its axis rises; as "
            "source_sign on one axis",
            (1, -1),
        ),
        AlongOption(
            "motor_zero", "position of the axis where the source motor reads zero", default=0.0
        ),
        *GRID,
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, entries and I51=1; SAVE comes after the trial."""
        require_one_way(table)
        axes = axes_of(table)
        given = _checked_motors(table, in_axes(self.options, options, axes))
        if is_one_turn(table):
            table = closed(table, given["count"] / SCALE)
        made = filled(table, given["target_sign"] * table.forward, given, tolerance=0.5)
        columns = self._in_axis(made.motor, made.values, given)
        carried = replace(table, **columns, u=None)
        names = {n: printable(getattr(table, n), "axis") for n in ("axis", "compensates")}
        source, target = given["source_motor"], given["target_motor"]
        data = program_text(
            f"{names['axis']} (#{source}) corrects {names['compensates']} (#{target}); entries are added "
            f"to #{target}, -16 error / count",
            names,
            {**{n: given[n] for n in _FACTS}, **dict(zip(("first", "last"), table.span, strict=True))},
            _DEFINE,
            {
                "owner": given["owner"], "source": source, "target": target,
                "d": "D" if given["desired"] else "", "entries": made.grid.n,
                "span": made.grid.counts,
            },
            [made.entries],
            turning=turning_names(self.options, axes),
        )  # fmt: skip
        return Encoded(
            data=data,
            quantisation=made.rounding,
            step=given["count"] / SCALE,
            carried=carried,
            resampling_error=resampling_error(table, carried),
            findings=(*_warnings(options, given), *rolls_over([(table.axis, made.grid.counts)])),
            options=chosen(self.options, given),
            notes={
                "span_counts": made.grid.counts,
                "entries": made.grid.n,
                "spacing_m": made.grid.step,
            },
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what PMAC adds: linear between the entries, rolled over, one value both ways."""
        nodes, step, known, _ = self._read(data, path, options)
        n = nodes.size - 1

        def at(position: FloatArray) -> FloatArray:
            motor = known["source_sign"] * (position - known["motor_zero"])
            u = np.mod(motor / step, n)
            return np.asarray(known["target_sign"] * np.interp(u, np.arange(n + 1), nodes))

        return one_way(at)

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, float, dict[str, Any], Program]:
        """Return corrections of the motor at nodes 0 ... n in m, the spacing, options, the file."""
        program = read_program(data, path, _DEFINE, lambda words: int(words["entries"]))
        define, owner = program.define, program.define["owner"]
        motors = {k: define[k] or owner for k in ("source", "target")}
        same = motors["source"] == motors["target"]
        told = _TOLD if same else (*_TOLD, "source_count", "target_sign")
        axes = axes_in_file(path, program.facts, options, same=same)
        known = motors_of(
            {**{f"{k}_motor": v for k, v in motors.items()}, "owner": owner},
            settled(self.options, options, path, file=program.facts, needed=told, axes=axes),
            path,
        )
        known["axes"] = axes
        if same:
            for name, own in (("source_count", "count"), ("target_sign", "source_sign")):
                sources = {f"{own} of the one motor": known[own], "the file or user": known[name]}
                known[name] = agreed(path, name, sources)
        n, counts = rolled_size(program, path)
        nodes = np.concatenate([[0.0], program.entries * known["count"] / SCALE])
        return nodes, counts * known["source_count"] / n, known, program

    def _in_axis(
        self, motor: NDArray[Any], values: FloatArray, known: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return positions and corrections of the axes, from those of the motors."""
        s = known["source_sign"]
        return {
            "positions": (known["motor_zero"] + s * motor)[::s],
            "forward": (known["target_sign"] * values + 0.0)[::s],
            "reverse": None,
        }


def _checked_motors(table: CompensationTable, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options with what follows from others filled in; refuse contradictions."""
    given = dict(options)
    given["source_motor"] = given["source_motor"] or 1
    if given["target_motor"] is None:
        if not table.is_on_axis:
            raise TableError(
                f"this table corrects {table.compensates} over {table.axis}: say which motor is "
                f"{table.compensates} (target_motor=)"
            )
        given["target_motor"] = given["source_motor"]
    given["owner"] = given["owner"] or given["target_motor"]
    same = given["source_motor"] == given["target_motor"]
    if same != table.is_on_axis:
        raise TableError(
            f"this table corrects {table.compensates} over {table.axis}, but the source is motor "
            f"#{given['source_motor']} and the target #{given['target_motor']}; a motor moves one axis"
        )
    if given["source_count"] is None and is_rotary(table.axis) != is_rotary(table.compensates):
        raise TableError(
            f"one of {table.axis} and {table.compensates} turns and the other does not: state "
            f"source_count= too, the {'angle' if is_rotary(table.axis) else 'length'} of one count of the "
            f"motor of {table.axis}"
        )
    given["source_count"] = given["source_count"] or given["count"]
    if given["target_sign"] is None:
        given["target_sign"] = given["source_sign"] if same else 1
    if same and (
        given["source_count"] != given["count"] or given["target_sign"] != given["source_sign"]
    ):
        raise TableError(
            f"source and target are both motor #{given['source_motor']}: its count and its sign are "
            "one; leave source_count and target_sign away"
        )
    refuse_ends(given, dict(zip(("first", "last"), table.span, strict=True)), table.axis)
    return given


def _warnings(options: Mapping[str, Any], given: Mapping[str, Any]) -> Iterator[Finding]:
    if options["source_motor"] is None:
        yield Finding.warning("motor #1 was taken as the source", "say source_motor=", "motors")
    if given["source_motor"] == given["target_motor"] and not given["desired"]:
        yield Finding.warning(
            "a motor that is corrected over its own actual position follows its own noise",
            "look up the desired position (desired=True)",
            "desired",
        )
