"""What a column is, by its name (position, height, time, feed, run ...), and its numbers in SI.

The words are those of exports in English, German, French, Italian, Spanish, Chinese and Japanese.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import AmbiguousFormatError, FormatMismatchError, UnitError
from metrosep.core.runset import FORWARD, REVERSE
from metrosep.core.units import Unit, likely_meaning, parse_sensitivity, parse_unit
from metrosep.io.own_notes import is_marked
from metrosep.io.several_runs import BLOCKS, COLUMNS, FoundRuns
from metrosep.io.source import RawFile
from metrosep.io.text.dialect import encoding_hint, find_column, header_unit, holds_counts
from metrosep.io.text.encoding import ROLE_WORDS, Role
from metrosep.io.text.table import Column, Table
from metrosep.io.text.times import LONG_AGO_S, written_moments


def _plain(name: str) -> str:
    """Return a name without case, blanks, marks and a number at its end."""
    folded = unicodedata.normalize("NFKC", name).casefold()
    return re.sub(r"\d+$", "", re.sub(r"[\s_.\-]", "", folded))


_ROLES: Final = {
    _plain(word): role for role, words in ROLE_WORDS.items() for word in words.split()
}


def role_of(name: str) -> Role | None:
    """Return the role that the name of a column tells: the whole name, or one of its words.

    ``x_mm`` is a position, ``probe reading`` a height; ``z_norm`` is neither, since one letter is a
    name only where it stands alone.
    """
    bare, unit = header_unit(name)
    whole = _ROLES.get(_plain(bare))
    if whole is not None:
        return whole
    if _ROLES.get(re.sub(r"\d+|第", "", _plain(bare))) == "run":
        return "run"  # 1回, 第1次
    words = [w for w in re.split(r"[\s_.\-]+", bare) if len(_plain(w)) > 1]
    found = {role for w in words if (role := _ROLES.get(_plain(w))) is not None}
    if found == {"run", "index"}:
        return "run"  # Run No., Messung Nr.
    if "index" in found and len(found) == 2 and unit is None:
        # Pos.-Nr., Reading no.; an encoder counter is read
        return None if _COUNTED.intersection(map(_plain, words)) else "index"
    return found.pop() if len(found) == 1 else None


_COUNTED: Final = frozenset(
    map(_plain, ["count", "counts", "counter", "zähler", "compteur", "contatore", "contador"])
)
"""Words of an index that beside another word name what an encoder or a detector gives."""

_SENSED: Final = (
    "displacement distance travel déplacement spostamento distanza desplazamiento distancia "
    "位移 距离 変位量 距離 移動量"
)
_READ_TOO: Final = frozenset(map(_plain, _SENSED.split()))
"""Words of a position that a sensor of displacement gives its reading too."""


def is_read_too(name: str) -> bool:
    """Return whether the name of a position is one that a reading may have beside a plainer one."""
    bare = header_unit(name)[0]
    return any(_plain(w) in _READ_TOO for w in (bare, *re.split(r"[\s_.\-]+", bare)))


_JUMP = 10.0
"""Median steps by which a position or a clock falls back where a new run begins."""


def jumps_back(values: FloatArray, lines: NDArray[np.int64]) -> list[int]:
    """Return the rows at which a position or a clock jumps back towards its first value.

    Behind a line that is not a row, such as a comment or names again, more than one step is a jump.
    """
    steps = np.diff(values)
    known = steps[np.isfinite(steps)]
    usual = float(np.median(known)) if known.size else 0.0
    if usual == 0.0:
        return []
    back = steps * np.sign(usual) < -abs(usual) * np.where(np.diff(lines) > 1, 1.0, _JUMP)
    return [int(i) + 1 for i in np.flatnonzero(back)]


def _rises_between(values: FloatArray | None, starts: list[int]) -> bool:
    """Whether a position or a clock goes one way in each block, and each block has a few rows."""
    blocks = np.split(np.diff(values if values is not None else np.empty(0)), np.array(starts) - 1)
    steps = [blocks[0], *(b[1:] for b in blocks[1:])]
    return all(s.size >= _FEWEST and (np.all(s >= 0.0) or np.all(s <= 0.0)) for s in steps)


_FEWEST = 2
"""Steps of the shortest block that is a run."""


def runs_in(table: Table, *, fewest: int = 2) -> FoundRuns | None:
    """Return the runs that a table holds by its column of runs, from `fewest` on, or by a position that jumps back."""
    by_role: dict[str, list[Column]] = {}
    for column in table.columns:
        by_role.setdefault(role_of(column.name) or "", []).append(column)
    bare = {header_unit(c.name)[0].casefold() for c in table.columns}
    if {"x", "y"} <= bare:
        return None  # points of a map
    single = {
        key: by_role[role][0]
        for key, role in (("x", "position"), ("z", "height"), ("feed", "feed"), ("time", "time"))
        if len(by_role.get(role, ())) == 1 and by_role[role][0].values is not None
    }
    columns = {k: c.name for k, c in single.items() if k in ("x", "z") or _is_a(c, _OF_ROLE[k])}
    other = [
        c.name
        for c in by_role.get("", ())
        if c.values is not None
        and c.unit is not None
        and c.unit.dimension in ("length", "voltage")
    ]
    missing = [key for key in ("x", "z") if key not in columns]
    if missing == ["x"] and not other:  # no length is left: the axis may turn
        turning = [*by_role.get("", ()), *by_role.get("angle", ())]
        other = [c.name for c in turning if c.unit and c.unit.dimension == "angle"]
    assumed = frozenset(missing if len(missing) == len(other) == 1 else ())
    columns |= dict.fromkeys(assumed, other[0]) if assumed else {}
    for column in by_role.get("direction", ()):
        if len(by_role["direction"]) == 1 and tells_direction(column):
            columns["direction"] = column.name
    units = {k: u.name for k, n in columns.items() if (u := table[n].unit) is not None}
    undeclared = tuple(n for k, n in columns.items() if k not in units and k != "direction")
    z = columns.get("z")
    in_volts = z is not None and (u := table[z].unit) is not None and u.dimension == "voltage"
    series = {_series(c.name): c for c in by_role.get("run", ()) if _may_be_one_of_several(c)}
    if len(series) == 1 and "x" in single and not by_role.get("time") and not targets_in(table):
        alike = runs_beside(table, next(iter(series.values())).name, single["x"].name)
        if len(alike) > 1 and all(map(_may_be_one_of_several, alike)):
            return _found_beside(alike, single["x"])
    facts: dict[str, Any] = {
        "columns": columns,
        "units": units,
        "undeclared": undeclared,
        "in_volts": in_volts,
        "assumed": assumed,
        "targets": targets_in(table),
    }
    for column in by_role.get("run", ()):
        if _reads_length(column):
            continue
        marks = np.array(column.labels) if column.labels is not None else column.values
        if marks is None or marks.size < 2 or (marks.dtype.kind == "f" and np.isnan(marks).any()):
            continue
        begins = np.sort(np.unique(marks, return_index=True)[1])
        if fewest <= begins.size <= marks.size // 2:
            lines = tuple(int(n) for n in table.lines[begins])
            return FoundRuns(begins.size, column.name, lines, **facts)
    for role in ("position", "time"):
        for column in by_role.get(role, ()):
            starts = jumps_back(column.values, table.lines) if column.values is not None else []
            if starts and _rises_between(column.values, starts):
                lines = tuple(int(table.lines[i]) for i in (0, *starts))
                return FoundRuns(len(lines), BLOCKS, lines, **facts)
    return None


def _reads_length(column: Column) -> bool:
    """Whether a column called after a run holds its readings: Lauf 1 [um]."""
    return (
        column.values is not None
        and column.unit is not None
        and column.unit.dimension in ("length", "voltage")
    )


def _may_be_one_of_several(column: Column) -> bool:
    """Whether a column may hold the readings of a run beside others: also Lauf 1, of which nobody declares a unit."""
    numbered = re.search(r"\d", header_unit(column.name)[0]) is not None
    return _reads_length(column) or (
        numbered and column.unit is None and column.values is not None
    )


def runs_beside(table: Table, name: str, place: str) -> list[Column]:
    """Return the columns that are called alike but for a number, in whatever unit; that of the places is none."""
    return [c for c in table.columns if _series(c.name) == _series(name) and c.name != place]


def _series(name: str) -> str:
    """Return the name of a column without its unit and without numbers: the same for Lauf 1 and Lauf 2."""
    return re.sub(
        r"\d+|[\[(<{].*", "", _plain(header_unit(name)[0])
    )  # also a unit that is not known


def _found_beside(alike: Sequence[Column], place: Column) -> FoundRuns:
    """Return the runs that lie beside each other over one column of places."""
    columns = {"x": place.name, "z": alike[0].name}
    units = {"x": place.unit, "z": alike[0].unit}
    return FoundRuns(
        len(alike),
        COLUMNS,
        (),
        columns,
        {k: u.name for k, u in units.items() if u is not None},
        tuple(columns[k] for k, u in units.items() if u is None),
        in_volts=units["z"] is not None and units["z"].dimension == "voltage",
    )


_MOST_TARGETS = 1000


def targets_in(table: Table) -> dict[str, str]:
    """Return the options of `table` for a list of targets, each reached in both directions; else none.

    A column of places, a column of directions and readings in lengths, without feedrate or time.
    """
    roles = {c.name: role_of(c.name) for c in table.columns}
    ways = [c for c in table.columns if c.labels is not None and tells_direction(c)]
    if len(ways) != 1 or {"feed", "time"} & set(roles.values()):
        return {}
    is_forward = np.array([w.strip().casefold() in FORWARD for w in ways[0].labels or ()])

    def holds_targets(column: Column) -> bool:
        if roles[column.name] != "position" or column.values is None:
            return False
        there, back = (np.unique(column.values[m]) for m in (is_forward, ~is_forward))
        return 2 <= there.size <= _MOST_TARGETS and np.array_equal(there, back)

    targets = [c.name for c in table.columns if holds_targets(c)]
    readings = [
        c.name
        for c in table.columns
        if c.values is not None and c.name not in targets
        if c.unit is not None and c.unit.dimension == "length"
    ]
    if len(targets) != 1 or not readings:
        return {}
    found = {"target": targets[0], "direction": ways[0].name, "readings": ",".join(readings)}
    cycles = [n for n, role in roles.items() if role == "run" and table[n].unit is None]
    return found | ({"cycle": cycles[0]} if len(cycles) == 1 else {})


def tells_direction(column: Column) -> bool:
    """Whether every entry of a column is a word or a number for one of the two directions."""
    values = () if column.values is None else np.unique(column.values).tolist()
    words = set(column.labels or map(str, values))
    return bool(words) and {w.strip().casefold() for w in words} <= FORWARD | REVERSE


_OF_ROLE: Final = {"feed": ("speed", None), "time": ("time",)}
"""Dimensions of the columns that are of use; None for one without a unit."""


def time_told(table: Table) -> str | None:
    """Return the column of time of a table, where just one has that name and that unit."""
    named = [c for c in table.numbers if role_of(c.name) == "time"]
    return named[0].name if len(named) == 1 and _is_a(named[0], _OF_ROLE["time"]) else None


def _is_a(column: Column, dimensions: Collection[str | None]) -> bool:
    """Whether a column is of one of some dimensions: the speed of a spindle is no feed."""
    return (None if column.unit is None else column.unit.dimension) in dimensions


def without_counter(table: Table, *, given: Sequence[ColumnSpec | None]) -> Table:
    """Return the table without a column that numbers its rows, unless the caller or metrosep itself names it."""
    counters = [c for c in numbering(table, given=given) if _counts_rows(c.values)]
    if not counters or len(table.numbers) == len(counters):
        return table
    said = [s for c in counters if (s := gap_in(c.name, c.values, table.lines))]
    kept = tuple(c for c in table.columns if c not in counters)
    header = {**table.header, "row_gap": said[0]} if said else table.header
    return replace(table, columns=kept, header=header, warnings=(*table.warnings, *said))


def numbering(table: Table, *, given: Sequence[ColumnSpec | None]) -> list[Column]:
    """Return the columns that number the rows by their name, of which the caller names none."""
    unnamed, named = table.header.get("unnamed", ()), table.header.get("named", True)
    named = named and not any(map(is_marked, table.header.get("comments", ())))
    texts = [g if isinstance(g, str) else g[0] for g in given if g]
    asked = {header_unit(t)[0].casefold() for g in texts for t in (g, g.rpartition(":")[0])}
    return [
        c
        for c in table.numbers
        if (c.name in unnamed or (named and role_of(c.name) == "index"))
        and header_unit(c.name)[0].casefold() not in asked
        and c.unit is None
    ]


def gap_in(name: str, values: FloatArray | None, lines: NDArray[np.int64]) -> str:
    """Return where numbers that rise by whole steps leave some out; empty where they do not, or fall."""
    steps = np.diff(np.empty(0) if values is None else values)
    if values is None or not steps.size or not np.all((steps >= 1.0) & (steps % 1.0 == 0.0)):
        return ""
    jumps = np.flatnonzero(steps > steps.min())
    if not jumps.size:
        return ""
    i = int(jumps[0])
    return (
        f"line {int(lines[i + 1])}: column {name!r}, which numbers the rows, goes from "
        f"{values[i]:.0f} to {values[i + 1]:.0f} ({jumps.size} such place(s)); rows may be missing there"
    )


def _counts_rows(values: FloatArray | None) -> bool:
    """Whether numbers rise by one from row to row, but for a few rows that were left out."""
    steps = np.diff(values if values is not None else np.empty(0))
    return steps.size > 0 and bool(
        np.all(steps >= 1.0) and np.all(steps % 1.0 == 0.0) and np.mean(steps == 1.0) > _MOSTLY
    )


_MOSTLY = 0.9
"""Share of the steps of a count of rows that are one."""


# ---- columns of a table picked by name and brought to SI, with a unit that somebody declared ----

ColumnSpec: TypeAlias = str | tuple[str, str]
"""A column: its name, ``"name:unit"`` or ``("name", "unit")``."""


def pick(
    file: RawFile, table: Table, spec: ColumnSpec, *, role: str
) -> tuple[Column, Unit | None]:
    """Return the column that a specification names, and its unit."""
    declared: str | None = None
    if isinstance(spec, str):
        name = spec
        if spec not in table.names and ":" in spec:
            name, declared = spec.rsplit(":", 1)
    else:
        if len(spec) != 2:
            raise FormatMismatchError(
                f"{role} column {spec!r} must be a name or a pair of name and unit"
            )
        name, declared = spec
    if name.strip().isdecimal() and not table.header.get("named", True):
        number = int(name)
        name = table.names[number - 1] if 1 <= number <= len(table.names) else name
    column = table[find_column(name, table.names, file.path, role=role)]
    refuse_marker(file, table, column.name)
    if not declared:
        return column, column.unit
    unit = parse_unit(declared)
    if column.unit is not None and column.unit != unit:
        raise FormatMismatchError(
            f"{file.path}: {role} column {column.name!r} is in {column.unit.name} by its header, but "
            f"{unit.name} was given; leave the unit out or correct the header"
        )
    return column, unit


def refuse_marker(file: RawFile, table: Table, name: str) -> None:
    """Refuse a column that is used where a value surely means "not measured", or where words are among its numbers."""
    if (message := table.header.get("markers", {}).get(name)) is not None:
        raise AmbiguousFormatError(f"{file.path}: {message}")


def to_si(
    file: RawFile,
    column: Column,
    unit: Unit | None,
    *,
    dimension: str,
    role: str,
    scale: float | None = None,
) -> FloatArray:
    """Return the numbers of a column in SI."""
    if column.values is None:
        first = column.labels[0] if column.labels else ""
        raise FormatMismatchError(
            f"{file.path}: {role} column {column.name!r} holds text ({first!r}), not numbers; name "
            "another column"
        )
    if unit is None:
        raise no_unit(file, {role: column.name}, dimension)
    if scale is not None:
        if unit.dimension != "voltage":
            raise UnitError(
                f"{file.path}: column {column.name!r} ({role}) is in {unit.name}, not in volts; leave "
                "scale= out"
            )
        return np.asarray(column.values * (unit.factor * scale))
    if unit.dimension == "voltage" and dimension == "length":
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) is in {unit.name}; give the sensitivity of "
            "the sensor, such as scale='2.5 um/V'"
        )
    if unit.dimension != dimension:
        raise UnitError(
            f"{file.path}: column {column.name!r} ({role}) is in {unit.name} ({unit.dimension}); "
            f"{'an' if dimension[:1] in 'aeiou' else 'a'} {dimension} is needed; name another column"
        )
    return np.asarray(column.values * unit.factor)


def no_unit(file: RawFile, columns: Mapping[str, str], dimension: str) -> UnitError:
    """Return the error about columns, by their role, of which nobody has declared a unit: all of them at once."""
    usual = _usual(dimension)
    for role, name in columns.items():
        where = f"{file.path}: the unit of column {name!r} ({role}) is not known"
        bracketed = re.search(r"[\[(<]\s*([^\])>]+?)\s*[\])>]\s*$", name)
        if (odd := likely_meaning(name)) is not None:
            return UnitError(
                f"{where}: {odd}; correct the header, or give {role}=({name!r}, {usual!r})"
            )
        if pages := _pages_with_unit(name):
            return UnitError(
                f"{where}: read as {' or '.join(pages)} it has one; give encoding={pages[0]!r} if the other names of "
                "the columns are right then"
            )
        if odd := encoding_hint([name]):
            return UnitError(f"{where}: {odd}")
        if holds_counts(name):
            return UnitError(
                f"{file.path}: column {name!r} ({role}) holds counts, which are not a {dimension}; multiply them by "
                f"what one count is, and write the column in {usual}"
            )
        if bracketed:
            return UnitError(
                f"{file.path}: column {name!r} ({role}) has {bracketed[1]!r} for its unit, which is not known "
                f"as one of a {dimension}; correct the header, or give {role}=({name!r}, 'UNIT')"
            )
    each = " and ".join(f"{role}=({name!r}, {usual!r})" for role, name in columns.items())
    if len(columns) == 1:
        ((role, name),) = columns.items()
        scales = (
            ", with min, h, ms, us or ns for s if it counts these" if dimension == "time" else ""
        )
        return UnitError(
            f"{file.path}: column {name!r} ({role}) declares no unit; rename it like '{name}_{usual}', or give "
            f"{each} or unit={scales}"
        )
    named = " and ".join(f"{name!r} ({role})" for role, name in columns.items())
    return UnitError(
        f"{file.path}: columns {named} declare no unit; give unit={usual!r} if all are in it, or one for each: "
        f"{each}"
    )


_PAGES = (
    "cp850",
    "koi8_r",
    "cp1251",
    "cp932",
    "euc_jp",
    "iso2022_jp",
    "gb18030",
    "big5",
    "euc_kr",
)
"""Encodings in which instruments write names; those whose words are known are found without being named."""


def _pages_with_unit(name: str) -> list[str]:
    """Return the encodings in which the name of a column, read as Latin-1, names a unit."""
    found = []
    for page in _PAGES:
        for own in ("cp1252", "latin-1"):
            try:
                text = name.encode(own).decode(page)
            except UnicodeError:
                continue
            if text != name and header_unit(text)[1] is not None:
                found.append(page)
                break
    return found


def since_first_row(
    table: Table, column: Column, unit: Unit | None
) -> tuple[FloatArray, str, Decimal] | None:
    """Return a time that counts from a date as counts from its first row, the sentence that says so, and that row's count in s.

    A float of seconds since 1970 holds 0.24 us.
    """
    if unit is None or unit.dimension != "time" or column.values is None:
        return None
    least = np.fmin.reduce(np.abs(column.values), initial=np.inf)
    if not LONG_AGO_S < least * unit.factor < np.inf:
        return None
    if written_moments(column.values) is not None:
        raise UnitError(
            f"column {column.name!r} holds dates written as numbers such as {column.values[0]:.0f}, not counts in "
            f"{unit.name}; leave its unit out, or write them as yyyy-mm-dd hh:mm:ss"
        )
    since, first = table.since_first(column)
    said = (
        f"column {column.name!r} counts from a date; its time is given from the first row, which is at {first} "
        f"{unit.name}"
    )
    return since, said, Decimal(first) * Decimal(repr(unit.factor))


def sensitivity(scale: float | str | None) -> float | None:
    """Return the sensitivity of a sensor in m/V."""
    if isinstance(scale, str):
        return parse_sensitivity(scale)
    return None if scale is None else float(scale)


def _usual(dimension: str) -> str:
    return {
        "length": "um",
        "time": "s",
        "speed": "mm/min",
        "angle": "deg",
        "voltage": "V",
        "frequency": "Hz",
    }.get(dimension, "um")
