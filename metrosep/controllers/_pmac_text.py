"""Text of Turbo PMAC tables: statements, entries in 1/16 count, facts in comments, limits.

Shared by the tables over one motor, over two, and of lost motion. What follows a DEFINE line is
taken for entries whatever it is, so that nothing but whole numbers may stand there.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.area_errors import is_rotary
from metrosep.controllers._plain_text import agreed, ascii_lines, facts_of, scaled
from metrosep.controllers.base import identity, load_sidecar
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "ACTIVATION",
    "AGAIN",
    "LARGEST",
    "MOTORS",
    "SCALE",
    "Program",
    "entry_lines",
    "length_facts",
    "motor_facts",
    "motors_of",
    "named_axes",
    "read_program",
    "refuse_turning",
    "require_short_span",
    "rounded_entries",
    "signed",
]


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
