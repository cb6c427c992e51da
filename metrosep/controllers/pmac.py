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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import resampling_error
from metrosep.controllers._grids import RollingGrid, enclosing_nodes, rolled_values, rolling_grid
from metrosep.controllers._plain_text import (
    agreed,
    ascii_lines,
    facts_of,
    printable,
    resolved,
    scaled,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    Simulator,
    identity,
    load_sidecar,
    one_way,
)
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "ACTIVATION",
    "AGAIN",
    "LARGEST",
    "MOTORS",
    "PMAC",
    "SCALE",
    "Program",
    "entry_lines",
    "length_facts",
    "motor_facts",
    "motor_range",
    "motors_of",
    "named_axes",
    "read_program",
    "refuse_turning",
    "require_short_span",
    "rounded_entries",
    "signed",
]


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
    "read the table back: PMAC takes whatever follows DEFINE as entries, and says nothing",
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

_DELETE = re.compile(
    r"DELETE\s+GATHER|#(?P<motor>\d{1,2})\s*DELETE\s+(?P<kind>(?:BL)?COMP)", re.IGNORECASE
)
_DEFINED = re.compile(r"#(?P<motor>\d{1,2})\s*DEFINE\s+(?P<kind>(?:BL)?COMP)", re.IGNORECASE)
AGAIN = "it was cut short, edited or mixed up: write the table again"

_SET = re.compile(r"I(\d{1,4})\s*=\s*(\d{1,12})", re.IGNORECASE)

_INTEGER = re.compile(r"[+-]?\d{1,12}")


@dataclass(frozen=True, slots=True)
class Program:
    """A PMAC file, read."""

    define: re.Match[str]  # the DEFINE line
    entries: NDArray[np.int64]  # the numbers that follow it
    settings: Mapping[int, int]  # to int: I-variables that the file sets
    facts: Mapping[str, str]  # to str: of its comments


def read_program(
    data: bytes,
    path: Path,
    define: re.Pattern[str],
    count_entries: Callable[[re.Match[str]], int],
    sets: Sequence[int] = (51,),
) -> Program:
    """Return what a PMAC file holds; strict."""
    lines = ascii_lines(data, path, "Turbo PMAC table")
    comments = [line.partition(";")[2] for line in lines if ";" in line]
    code = [(i, line.partition(";")[0].strip()) for i, line in enumerate(lines, start=1)]
    code = [(i, text) for i, text in code if text]
    head = 0
    while head < len(code) and _DELETE.fullmatch(code[head][1]):
        head += 1
    match = define.fullmatch(code[head][1]) if head < len(code) else None
    if match is None:
        found = f"line {code[head][0]}: {code[head][1][:60]!r}" if head < len(code) else "the end"
        raise CorruptFileError(
            path,
            "not a table of Turbo PMAC",
            field="DEFINE line",
            found=found,
            hint="the file holds DELETE lines, one DEFINE line, its entries and I51=1",
        )
    for number in re.findall(r"#(\d+)", match[0]):
        if not 1 <= int(number) <= MOTORS:
            raise CorruptFileError(
                path,
                f"there is no motor #{number}",
                field="DEFINE line",
                expected=f"#1 ... #{MOTORS}",
                found=match[0][:60],
                hint=AGAIN,
            )
    _require_own_deletes(code[:head], match[0], path)
    wanted = count_entries(match)
    entries, rest = _entries(code[head + 1 :], wanted, path)
    return Program(match, entries, _settings(rest, path, sets), facts_of(comments, path))


def _require_own_deletes(code: Sequence[tuple[int, str]], define: str, path: Path) -> None:
    """Refuse a file that deletes another table than the one it defines."""
    own = _DEFINED.match(define)
    for number, text in code:
        found = _DELETE.fullmatch(text)
        if found is None or own is None or found["motor"] is None:
            continue
        if (int(found["motor"]), found["kind"].upper()) != (
            int(own["motor"]),
            own["kind"].upper(),
        ):
            raise CorruptFileError(
                path,
                f"line {number} deletes another table than the file defines",
                field="DELETE line",
                expected=f"#{int(own['motor'])} DELETE {own['kind'].upper()}",
                found=text[:60],
                hint=AGAIN,
            )


def _entries(
    code: Sequence[tuple[int, str]], wanted: int, path: Path
) -> tuple[NDArray[np.int64], Sequence[tuple[int, str]]]:
    found: list[int] = []
    for used, (number, text) in enumerate(code):
        if len(found) == wanted:
            return np.array(found, dtype=np.int64), code[used:]
        words = text.split()
        if not all(map(_INTEGER.fullmatch, words)) or len(found) + len(words) > wanted:
            raise CorruptFileError(
                path,
                f"line {number}: {len(found)} of {wanted} entries stand before {text[:40]!r}; PMAC "
                "takes exactly as many whole numbers as the DEFINE line says, whatever follows",
                hint="write the table again",
            )
        numbers = [int(w) for w in words]
        found.extend(numbers)
        too_large = [v for v in numbers if abs(v) > LARGEST]
        if too_large:
            raise CorruptFileError(
                path,
                f"line {number}: the entry {too_large[0]} is not one of 24 bits",
                hint="write the table again",
            )
    if len(found) != wanted:
        raise CorruptFileError(
            path,
            f"the file ends after {len(found)} of {wanted} entries; PMAC would take the next "
            "commands it gets for entries",
            hint="the file was cut short: write it again",
        )
    return np.array(found, dtype=np.int64), ()


def _settings(code: Sequence[tuple[int, str]], path: Path, sets: Sequence[int]) -> dict[int, int]:
    values: dict[int, int] = {}
    for position, (number, text) in enumerate(code):
        match = _SET.fullmatch(text)
        last = position == len(code) - 1
        if match is not None and int(match[1]) in sets and int(match[1]) not in values:
            values[int(match[1])] = int(match[2])
        elif not (last and text.upper() == "SAVE"):
            raise CorruptFileError(
                path,
                f"line {number}: {text[:60]!r} does not belong behind the entries",
                expected=", ".join(f"I{i}=" for i in sets) + "; SAVE may be last",
                hint=AGAIN,
            )
    if values.get(51) != 1:
        raise CorruptFileError(
            path,
            "I51 is not set to 1: PMAC would not use the table",
            field="I51",
            expected="I51=1 behind the entries",
            found=values.get(51, "nothing"),
            hint=AGAIN,
        )
    return values


def entry_lines(entries: Sequence[int]) -> list[str]:
    """Return entries as lines of at most ten."""
    words = [str(int(v)) for v in entries]
    return [
        " ".join(words[i : i + _ENTRIES_A_LINE]) for i in range(0, len(words), _ENTRIES_A_LINE)
    ]


def rounded_entries(
    values: FloatArray, count: float, place: Callable[[int], str]
) -> NDArray[np.int64]:
    """Return corrections in 1/16 count."""
    scaled_values = np.rint(SCALE * values / count)
    worst = int(np.abs(scaled_values).argmax())
    if abs(scaled_values[worst]) > LARGEST:
        raise LimitError(
            f"the correction {format_length(float(values[worst]))} at {place(worst)} is "
            f"{scaled_values[worst]:.0f} sixteenths of a count of {format_length(count)}; 24 bits "
            f"hold {LARGEST}: check the units of the error and of count="
        )
    return np.asarray(scaled_values, dtype=np.int64)


def signed(name: str, whose: str) -> Option:
    """Return the option for the direction of a motor."""
    return Option(
        name,
        f"-1 if the counts of {whose} motor fall where its axis rises (#1->-1000X)",
        "choice",
        default=1,
        choices=(1, -1),
    )


def length_facts(**lengths: float | None) -> list[str]:
    """Return comment lines that state lengths."""
    return [
        f"; {name} = {scaled(v, 9)} nm"
        if "count" in name
        else f"; {name} = {scaled(round(v, _FEMTOMETRE), 3)} mm"
        for name, v in lengths.items()
        if v is not None
    ]


def motor_facts(given: Mapping[str, Any], *names: str) -> list[str]:
    """Return comment lines that state motors."""
    return [f"; {name} = {given[name]}" for name in names]


def motors_of(stated: Mapping[str, int], known: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return options with the motors that the DEFINE line names, and refuse contradictions."""
    checked = {
        name: agreed(
            name, {"the DEFINE line": n, "its comment, user or sidecar": known.get(name)}, path
        )
        for name, n in stated.items()
    }
    return {**known, **checked}


def refuse_turning(*axes: str) -> None:
    """Refuse axes that turn."""
    for axis in axes:
        if is_rotary(axis):
            raise TableError(
                f"the axis {axis} turns; tables of PMAC are written for linear axes here, because counts "
                "and spans are lengths: take another controller, or play the turn as a wave (pi-gcs, "
                "nv200, voltage with motion='turn')"
            )


def named_axes(
    path: Path, facts: Mapping[str, str], first: float, *, same_motor: bool
) -> dict[str, Any]:
    """Return what a table's file cannot hold: of the sidecar, else of the comments."""
    found = identity(path, first=first)
    pair = found["axis"], found["compensates"]
    if ("axis" in facts) != ("compensates" in facts):
        raise CorruptFileError(
            path,
            "one of the comments that name the axes is missing",
            expected="axis and compensates",
            found="axis" if "axis" in facts else "compensates",
            hint=AGAIN,
        )
    told = (facts["axis"], facts["compensates"]) if "axis" in facts else None
    if not load_sidecar(path):
        pair = told or (pair[0], pair[0] if same_motor else "Z")
        found["reference"] = 0.0
    if (told is not None and pair != told) or (pair[0] == pair[1]) != same_motor:
        raise CorruptFileError(
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
            hint=AGAIN,
        )
    return {**found, "axis": pair[0], "compensates": pair[1]}


def require_short_span(counts: int, long_span: bool, axis: str) -> None:
    """Refuse a span that no document is known to allow."""
    if counts > LARGEST and not long_span:
        raise LimitError(
            f"{axis}: the span is {counts} counts; more than {LARGEST} (24 bits) is not documented: "
            "define such a table on the controller, list it back, then say long_span=True"
        )


# ------------------------------------------------------------------------------------------------

_TOLD = ("source_sign", "motor_zero")
"""Options that are never guessed when a file is read."""

_DEFINE = re.compile(
    r"#(?P<owner>\d{1,2})\s*DEFINE\s+COMP\s+(?P<entries>\d{1,6})\s*,\s*"
    r"(?:#(?P<source>\d{1,2})(?P<desired>D?)\s*,\s*)?(?:#(?P<target>\d{1,2})\s*,\s*)?(?P<span>\d{1,15})",
    re.IGNORECASE,
)


def require_one_way(table: CompensationTable) -> None:
    """Refuse a table with two directions."""
    if table.reverse is not None and float(np.abs(table.reverse - table.forward).max()) >= 1e-12:
        raise TableError(
            "DEFINE COMP holds one correction for both directions, this table has two; make it with "
            "direction='forward' and write the one with both as controller='pmac-backlash' besides, "
            "or with direction='both'"
        )


def motor_range(options: Mapping[str, Any], n: int, step: float, path: Path) -> tuple[int, int]:
    """Return the first and last node that a file speaks of, negative below the zero of the motor."""
    first, last = options["first"], options["last"]
    if first is None or last is None:
        return 0, n
    ends = sorted(options["source_sign"] * (p - options["motor_zero"]) for p in (first, last))
    if max(ends[1], 0.0) - min(ends[0], 0.0) > (n + 0.5) * step:
        raise CorruptFileError(
            path,
            "the positions it is made for do not fit its span",
            field="first, last",
            expected=f"at most {format_length(n * step)} with the zero of the motor",
            found=f"{format_length(first)} ... {format_length(last)}",
            hint=AGAIN,
        )
    nodes = enclosing_nodes(step, ends[0], ends[1])
    return int(nodes[0]), int(nodes[-1])


class PMAC(Dialect):
    """Writer and reader of tables over one motor; see the module."""

    info = DialectInfo(
        id="pmac",
        title="Turbo PMAC position compensation (DEFINE COMP)",
        entry="correction added to the target motor in 1/16 count: round(-16 e / count)",
        units="1/16 count of the target motor; span in counts of the source motor",
        max_points=None,
        outside="rolls over: the position is taken modulo the span",
        sign_status="documented: added to the target's desired position (Software Reference)",
        activation=ACTIVATION,
        sign="documented",
        spacing="uniform",
        directions="one",
        resolution="1/16 count of the target motor",
        reference_rule="zero at the zero of the source motor, by definition",
        suffix=".pmc",
        example={"count": "10 nm", "source_motor": 1, "target_motor": 1},
        page="pmac",
    )

    options = (
        Option(
            "count",
            "length of one count of the target motor",
            "length",
            required=True,
            positive=True,
        ),
        Option(
            "source_count",
            "length of one count of the source motor; as count if omitted",
            "length",
            positive=True,
        ),
        Option(
            "source_motor",
            "number of the motor whose position is looked up; 1 if omitted",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "target_motor",
            "number of the motor that is corrected; the source if omitted and "
            "the table corrects its own axis",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "owner",
            "motor the table belongs to; the target if omitted",
            "integer",
            lowest=1,
            highest=MOTORS,
        ),
        Option(
            "desired", "look up the desired position (D), not the actual one", "flag", default=True
        ),
        signed("source_sign", "the source"),
        Option(
            "target_sign",
            "-1 if the counts of the target motor fall where its axis rises; as "
            "source_sign on one axis",
            "choice",
            choices=(1, -1),
        ),
        Option(
            "motor_zero",
            "position of the axis where the source motor reads zero",
            "length",
            default=0.0,
        ),
        Option(
            "span",
            "length after which positions roll over; chosen with a margin if omitted",
            "length",
            positive=True,
        ),
        Option(
            "spacing",
            "distance of the entries; that of the table if omitted",
            "length",
            positive=True,
        ),
        Option(
            "long_span",
            "you listed a table of more than 8388607 counts back from the controller",
            "flag",
            default=False,
        ),
        Option(
            "first",
            "for reading a file that does not say: lowest position of its travel",
            "length",
        ),
        Option(
            "last",
            "for reading a file that does not say: highest position of its travel",
            "length",
        ),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return DELETE lines, the DEFINE line, entries and I51=1; SAVE comes after the trial."""
        refuse_turning(table.axis, table.compensates)
        require_one_way(table)
        given = _checked_motors(table, options)
        count, s, t = given["count"], given["source_sign"], given["target_sign"]
        x = s * (table.positions - given["motor_zero"])
        y = t * table.forward
        x, y = (x, y) if s > 0 else (x[::-1], y[::-1])
        grid = rolling_grid(
            x,
            span=given["span"],
            spacing=given["spacing"],
            count=given["source_count"],
            axis=table.axis,
        )
        require_short_span(grid.counts, given["long_span"], table.axis)
        values = rolled_values(grid, x, y, 0.5 * count / SCALE)
        at = given["motor_zero"] + s * grid.positions
        entries = rounded_entries(values, count, lambda k: format_length(float(at[k])))
        nodes = enclosing_nodes(grid.step, float(x[0]), float(x[-1]))
        carried = replace(
            table,
            **_in_axis(nodes * grid.step, values[nodes % grid.n], given),
            reverse=None,
            u=None,
        )
        text = self._text(table, given, grid, np.roll(entries, -1))
        return Encoded(
            data=text.encode("ascii"),
            quantisation=float(np.abs(entries * count / SCALE - values).max()),
            step=count / SCALE,
            carried=carried,
            resampling_error=resampling_error(table, carried),
            findings=_doubts(options, given),
            notes={"span_counts": grid.counts, "entries": grid.n, "spacing_m": grid.step},
        )

    def _text(
        self,
        table: CompensationTable,
        given: Mapping[str, Any],
        grid: RollingGrid,
        entries: NDArray[np.int64],
    ) -> str:
        source, target, owner = given["source_motor"], given["target_motor"], given["owner"]
        axis, other = printable(table.axis, "axis"), printable(table.compensates, "axis")
        low, high = table.span
        lines = [
            (
                f"; metrosep: {axis} (#{source}) corrects {other} (#{target}); entries are added to "
                f"#{target}, -16 error / count"
            ),
            f"; axis = {axis}",
            f"; compensates = {other}",
            *length_facts(
                count=given["count"],
                source_count=given["source_count"],
                motor_zero=given["motor_zero"],
                first=low,
                last=high,
            ),
            f"; source_sign = {given['source_sign']}",
            f"; target_sign = {given['target_sign']}",
            *motor_facts(given, "source_motor", "target_motor", "owner"),
            "DELETE GATHER",
            f"#{owner} DELETE COMP",
            (
                f"#{owner} DEFINE COMP {grid.n},#{source}{'D' if given['desired'] else ''},#{target},"
                f"{grid.counts}"
            ),
            *entry_lines(entries.tolist()),
            "I51=1",
        ]
        return "\n".join(lines) + "\n"

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table over the travel it was made for."""
        nodes, step, known, program = self._read(data, path, options)
        n = nodes.size - 1
        low, high = motor_range(known, n, step, path)
        j = np.arange(low, high + 1)
        columns = _in_axis(j * step, nodes[j % n], known)
        return CompensationTable(
            **columns,
            reverse=None,
            is_exact_inverse=True,
            **named_axes(
                path,
                program.facts,
                float(columns["positions"][0]),
                same_motor=known["source_motor"] == known["target_motor"],
            ),
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

    def facts(self, data: bytes, path: Path, **options: Any) -> dict[str, Any]:
        """Return what a file says of its machine."""
        _, _, known, program = self._read(data, path, options)
        same = known["source_motor"] == known["target_motor"]
        return {**known, **named_axes(path, program.facts, 0.0, same_motor=same)}

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[FloatArray, float, dict[str, Any], Program]:
        """Return corrections of the motor at nodes 0 ... n in m, the spacing, options, the file."""
        program = read_program(data, path, _DEFINE, lambda m: int(m["entries"]))
        define, owner = program.define, int(program.define["owner"])
        motors = {k: int(define[k] or owner) for k in ("source", "target")}
        same = motors["source"] == motors["target"]
        told = _TOLD if same else (*_TOLD, "source_count", "target_sign")
        known = motors_of(
            {**{f"{k}_motor": v for k, v in motors.items()}, "owner": owner},
            resolved(options, program.facts, path, self.options, told),
            path,
        )
        if same:
            for name, own in (("source_count", "count"), ("target_sign", "source_sign")):
                known[name] = agreed(
                    name,
                    {f"{own} of the one motor": known[own], "the file or user": known[name]},
                    path,
                )
        n, counts = program.entries.size, int(program.define["span"])
        if n == 0 or counts < n:
            raise CorruptFileError(
                path,
                f"{n} entries over {counts} counts are no table",
                field="DEFINE COMP",
                hint=AGAIN,
            )
        if program.entries[-1] != 0:
            raise CorruptFileError(
                path,
                "the last entry stands at the roll-over, where the correction is zero by definition: "
                "the axis would jump there",
                field="last entry",
                expected=0,
                found=int(program.entries[-1]),
                hint=AGAIN,
            )
        nodes = np.concatenate([[0.0], program.entries * known["count"] / SCALE])
        return nodes, counts * known["source_count"] / n, known, program


def _in_axis(
    motor: NDArray[Any], values: NDArray[Any], known: Mapping[str, Any]
) -> dict[str, Any]:
    """Return positions and corrections of the axes, from those of the motors."""
    positions = known["motor_zero"] + known["source_sign"] * motor
    forward = known["target_sign"] * values + 0.0
    if known["source_sign"] < 0:
        positions, forward = positions[::-1], forward[::-1]
    return {"positions": positions, "forward": forward}


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
    low, high = table.span
    for name, end in (("first", low), ("last", high)):
        if given[name] is not None and given[name] != end:
            raise TableError(
                f"{name}= is for reading; the table itself ends at {format_length(end)}"
            )
    return given


def _doubts(options: Mapping[str, Any], given: Mapping[str, Any]) -> tuple[Finding, ...]:
    found = []
    if options["source_motor"] is None:
        found.append(
            Finding("warning", "motor #1 was taken as the source", "say source_motor=", "motors")
        )
    if given["source_motor"] == given["target_motor"] and not given["desired"]:
        found.append(
            Finding(
                "warning",
                "a motor that is corrected over its own actual position follows its own noise",
                "look up the desired position (desired=True)",
                "desired",
            )
        )
    return tuple(found)
