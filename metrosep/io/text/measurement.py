"""A table of numbers becomes a profile, a recording or a surface, with units somebody declared.

Shared by plain column text and by the text formats that a ``format.toml`` describes.
"""

from __future__ import annotations

import itertools
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, way
from metrosep.core.errors import (
    AmbiguousFormatError,
    DataError,
    FormatMismatchError,
    ReadError,
    UnitError,
)
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import Unit, likely_meaning, parse_unit
from metrosep.io._roles import (
    ColumnSpec,
    is_read_too,
    no_unit,
    pick,
    refuse_marker,
    role_of,
    runs_in,
    sensitivity,
    since_first_row,
    targets_in,
    to_si,
    without_counter,
)
from metrosep.io.objects import SI_NAMES, make_surface, rows_of_matrix, scaled, to_grid
from metrosep.io.own_notes import header_notes
from metrosep.io.several_runs import BLOCKS, FoundRuns, SeveralRunsError, table_advice
from metrosep.io.source import RawFile, declared_steps, rate_of, refuse_options
from metrosep.io.text._compiled import different
from metrosep.io.text.dialect import header_unit, holds_counts, is_other_unit
from metrosep.io.text.matrices import (
    declared_units,
    is_matrix,
    looks_like_points,
    matrix,
    shown_columns,
)
from metrosep.io.text.quality import is_truth, where_it_turns
from metrosep.io.text.table import (
    AS_THEY_FOLLOW,
    Column,
    SinceFirst,
    Table,
    interruption,
    refuse_row_gap,
    without_empty_rows,
)
from metrosep.io.text.times import counted_moments, is_long_count, written_moments

FEW_COLUMNS = 8
"""Columns without names that may still be channels as well as a map."""


def measurement(
    file: RawFile,
    table: Table,
    format_id: str,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    y: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    row_order: str | None = None,
) -> Profile | Recording | Surface:
    """Return the object that a table holds; see `metrosep.io.text.delimited.read`."""
    if not any((channel, x, y, z, time)):  # else what is not asked for may hold what it wants
        _refuse_markers(file, table, table.numbers)
    table, channel, labels = _rows_of(file, table, channel)
    table = without_counter(table, given=(channel, x, y, z, time))
    unit = declared_units(unit)
    bare = is_matrix(table)
    each = unit is not None and not isinstance(unit, str)  # one for each column, not one for all
    undeclared = all(c.unit is None for c in table.numbers)
    table = _with_units(file, table, unit)
    counted = any(given is not None for given in (sampling_rate, x, z, channel))
    if not counted and time is None:
        table = _with_counted_time(table)
    timed = _time_column(file, table, time, counted=counted)
    n_columns = len(table.columns)
    made = _Made(file, table, format_id, sensitivity(scale), {"labels": labels} if labels else {})
    del table  # what was read is given up as soon as an object holds it
    try:
        if y is not None and (x is None or z is None):
            raise made.mismatch("a surface needs x=, y= and z=; give all three")
        points = (x, y, z) if x is not None and y is not None and z is not None else None
        if x is None and z is None:
            points = made.point_columns(bare=bare and each, one_unit=undeclared and not each)
        if points is not None and timed is None and sampling_rate is None:
            refuse_options(
                file, "a list of points with their positions", lateral_step=lateral_step
            )
            return made.surface(points)
        if (timed is not None or sampling_rate is not None) and x is None and z is None:
            if lateral_step is not None or scale is not None:
                raise ReadError(f"{file.path}: a recording takes no lateral_step or scale")
            if time is None and channel is None and (found := _numbered_runs(made.table)):
                raise SeveralRunsError(file.path, found)
            return made.recording(timed, sampling_rate, channel)
        steps = declared_steps(lateral_step)
        said = unit is not None or steps is not None or n_columns > FEW_COLUMNS
        unnamed = bare and x is None and z is None and channel is None
        if unnamed and (said or looks_like_points(file, made.table)):
            return matrix(
                file,
                made.table,
                format_id,
                steps=steps,
                scale=sensitivity(scale),
                row_order=row_order,
            )
        return made.profile(x, z, steps)
    except UnitError:
        raise
    except DataError as exc:
        found = runs_in(made.table)
        if found is not None:
            raise SeveralRunsError(file.path, found) from None
        why = str(exc).removeprefix(f"{file.path}: ")
        raise FormatMismatchError(f"{file.path}: {why}") from None


def _refuse_markers(file: RawFile, table: Table, columns: Iterable[Column]) -> None:
    """Refuse columns that hold a value for "not measured"; one that counts the rows may hold any."""
    for column in columns:
        if role_of(column.name) != "index":
            refuse_marker(file, table, column.name)


def _with_counted_time(table: Table) -> Table:
    """Return the table with a clock that counts from an epoch in s from its first row, and a warning."""
    for column in table.numbers if table.header.get("named", True) else ():
        is_clock = role_of(column.name) == "time" or column.name.strip().casefold() == "filetime"
        found = (
            counted_moments(column.name, column.values, table.since_first(column)[0])
            if is_clock and column.unit is None and column.values is not None
            else None
        )
        if found is None and is_clock and column.unit is None and column.values is not None:
            written = written_moments(column.values)
            what = "dates written as numbers (yyyymmddhhmmss)"
            found = None if written is None else (written, what)
        if found is not None:
            made = replace(column, unit=parse_unit("s"), values=found[0])
            columns = tuple(made if c is column else c for c in table.columns)
            said = (
                f"column {column.name!r} has no unit, and its numbers were read as {found[1]}; give time= with "
                "another unit if that is wrong"
            )
            exact = {k: v for k, v in table.exact.items() if k != column.name}
            warnings = (*table.warnings, said)
            return replace(table, columns=columns, warnings=warnings, exact=exact)
    return table


def _numbered_runs(table: Table) -> FoundRuns | None:
    """Return the runs beside a clock where names tell run, position and reading."""
    if all(role_of(c.name) != "run" for c in table.columns):
        return None
    found = runs_in(table)
    return found if found is not None and found.run != BLOCKS and found.is_known() else None


def _rows_of(
    file: RawFile, table: Table, channel: str | None
) -> tuple[Table, str | None, dict[str, str]]:
    """Return the rows of one label, and the labels that all its rows share."""
    labelled = [c for c in table.columns if c.labels is not None] if channel is not None else []
    for column in labelled:
        if channel in (column.labels or ()) and len(different(column.labels or ())) > 1:
            keep = np.array([label == channel for label in column.labels or ()])
            table, channel = _take(table, keep), None
            break
    shared: dict[str, str] = {}
    for column in table.columns:
        if column.labels is None:
            continue
        texts = different(column.labels)
        if len(texts) == 1:
            shared[column.name] = texts[0]
        elif len(table.numbers) == 2 and _is_stacked(column.labels, texts):
            found = runs_in(table)
            if found is not None and found.run == column.name:
                raise SeveralRunsError(file.path, found)
            raise FormatMismatchError(
                f"{file.path}: column {column.name!r} stacks {len(texts)} data sets "
                f"({', '.join(texts[:4])}); choose one with channel={texts[0]!r}"
            )
    return table, channel, shared


def _omitted(table: Table) -> Iterator[str]:
    """Yield a warning for each column of a recording whose numbers bear a unit that is not known."""
    for c in table.columns:
        texts = (
            []
            if c.name in table.header.get("undecided", ())
            else sorted(filter(None, different(c.labels or ())))
        )
        numbers = [t for t in texts if _NUMBER_AND_UNIT.fullmatch(t)]
        if 2 * len(numbers) > len(texts) and numbers[0] != numbers[-1]:
            yield (
                f"column {c.name!r} holds texts such as {numbers[0]!r}, not numbers, and is not a channel; write "
                "the unit into its name to keep it"
            )


_NUMBER_AND_UNIT = re.compile(r"[+\-\u2212]?[\d.,]+(?:[eE][+-]?\d+)?\s*[^\W\d]\D*")


def _is_stacked(labels: Sequence[str], different: tuple[str, ...]) -> bool:
    """Whether labels name one part of the rows after the other: a status that comes and goes does not.

    Neither does a name for every row, nor one beside empty cells.
    """
    named = sum(map(bool, different))
    parts = itertools.islice(itertools.groupby(labels), len(different), None)
    return named > 1 and 2 * len(different) <= len(labels) and next(parts, None) is None


def _take(table: Table, keep: Any) -> Table:
    columns = tuple(
        Column(
            c.name,
            c.unit,
            None if c.values is None else c.values[keep],
            None
            if c.labels is None
            else tuple(label for label, k in zip(c.labels, keep, strict=True) if k),
        )
        for c in table.columns
    )
    return replace(table, columns=columns, lines=table.lines[keep])


def _with_units(file: RawFile, table: Table, unit: Any) -> Table:
    """Return the table with the units that the caller declares; contradictions are refused."""
    if unit is None:
        return table
    names = [c.name for c in table.numbers]
    if isinstance(unit, str):
        shared = parse_unit(unit)
        declared: dict[str, Unit] = {
            c.name: shared
            for c in table.numbers
            if c.unit is None and likely_meaning(c.name) is None and not holds_counts(c.name)
        }
        is_used = bool(declared) or any(c.unit == shared for c in table.numbers)
        for c in table.numbers:
            if not is_used and c.unit is None and holds_counts(c.name):  # refused by that
                to_si(file, c, None, dimension=shared.dimension, role="unit")
        odd = [why for c in table.numbers if c.unit is None and (why := likely_meaning(c.name))]
        if not declared and odd:
            raise UnitError(
                f"{file.path}: the unit of a column is not known: {odd[0]}; correct the header"
            )
        if not is_used:
            own = ", ".join(f"{c.name!r} in {c.unit.name}" for c in table.numbers if c.unit)
            raise FormatMismatchError(
                f"{file.path}: every column declares its own unit ({own}); leave unit= out"
            )
    elif isinstance(unit, dict):
        specs = ((str(n), str(u)) for n, u in unit.items())
        declared = {c.name: u for c, u in (pick(file, table, s, role="unit") for s in specs) if u}
    else:
        units = tuple(unit)
        if len(units) != len(names):
            raise FormatMismatchError(
                f"{file.path}: unit has {len(units)} entries for {len(names)} columns of numbers "
                f"({', '.join(names)}); give one for each"
            )
        pairs = zip(names, units, strict=True)
        declared = {
            c.name: u
            for c, u in (pick(file, table, (n, str(t)), role="unit") for n, t in pairs)
            if u
        }
    columns = tuple(
        Column(c.name, declared.get(c.name, c.unit), c.values, c.labels) for c in table.columns
    )
    return replace(table, columns=columns)


def _time_column(
    file: RawFile, table: Table, time: ColumnSpec | None, *, counted: bool
) -> Column | None:
    """Return the column of time; one that can be read in two ways matters unless the rows are counted."""
    undecided: Mapping[str, str] = table.header.get("undecided", {})
    if time is not None:
        column, unit = pick(file, table, time, role="time")
        if column.name in undecided:
            raise AmbiguousFormatError(undecided[column.name])
        return replace(column, unit=unit)
    clocks = table.header.get("clocks", ())
    for column in sorted(table.numbers, key=lambda c: c.name in clocks):
        if column.unit is not None and column.unit.dimension == "time":
            return column
    named = table.header.get("named", True)
    for column in table.numbers if named else ():
        if column.unit is None and role_of(column.name) == "time":
            return column
        if (
            column.unit is not None
            and column.unit.dimension == "length"
            and role_of(column.name) == "time"
        ):
            raise UnitError(
                f"{file.path}: column {column.name!r} is a time by its name and a length by its unit "
                f"{column.unit.name}; correct the header (minutes are min), or name the columns with x= and z="
            )
    if undecided and not counted:
        raise AmbiguousFormatError(next(iter(undecided.values())))
    return None


@dataclass
class _Made:
    """A table with units on its way to an object: the columns that were used, and their facts."""

    file: RawFile
    table: Table
    format_id: str
    scale: float | None  # sensitivity of the readings in m/V
    facts: dict[str, Any]
    used: dict[str, Any] = field(default_factory=dict)

    def mismatch(self, reason: str) -> FormatMismatchError:
        """Return the error about columns that do not make the object."""
        return FormatMismatchError(f"{self.file.path}: {reason}")

    def lengths(self, role: str, spec: ColumnSpec) -> FloatArray:
        """Return a column of positions or heights in m."""
        column, unit = pick(self.file, self.table, spec, role=role)
        self.used[role] = column.name
        factor = self.scale if role == "z" else None
        values = to_si(self.file, column, unit, dimension="length", role=role, scale=factor)
        values.setflags(write=False)  # made here, so that the object need not copy them
        return values

    def described(self, *, is_profile: bool = False) -> dict[str, Any]:
        """Return metadata and history, which go on from those that metrosep wrote above the table."""
        table = self.table
        notes = header_notes(self.file, table.header.get("comments", ()))
        metadata = self.file.metadata(
            self.format_id,
            table.header,
            warnings=(*table.warnings, *notes.warnings),
            units={c.name: c.unit.name for c in table.columns if c.unit is not None},
            lines=table.ledger,
            **self.facts,
            **(notes.facts if is_profile else {}),
        )
        history = (*notes.history, *self.file.history(self.format_id, self.used))
        return {"metadata": metadata, "history": history}

    def point_columns(
        self, *, bare: bool, one_unit: bool
    ) -> tuple[ColumnSpec, ColumnSpec, ColumnSpec] | None:
        """Return the columns of a list of points, or None when the table is none."""
        table = self.table
        if len(table.numbers) != 3:
            return None
        if bare:
            first, second, third = table.names
            return first, second, third
        lengths = [c for c in table.numbers if c.unit is not None and c.unit.dimension == "length"]
        named = {header_unit(c.name)[0].casefold(): c.name for c in lengths}
        heights = [k for k, name in named.items() if k != "z" and role_of(name) == "height"]
        if len(heights) == 1 and "z" not in named:  # X, Y, Höhe
            named["z"] = named.pop(heights[0])
        if set(named) != {"x", "y", "z"}:
            return None
        if one_unit:
            raise UnitError(
                f"{self.file.path}: columns x, y and z declare no unit, and one was given for the "
                "three; give one for each, such as unit='um,um,nm'"
            )
        return named["x"], named["y"], named["z"]

    def surface(self, points: tuple[ColumnSpec, ColumnSpec, ColumnSpec]) -> Surface:
        """Return points on a grid."""
        values = [self.lengths(role, spec) for role, spec in zip("xyz", points, strict=True)]
        if np.isnan(values[2]).all():
            raise self.mismatch("the heights hold no number; nothing was measured")
        names = [s if isinstance(s, str) else ":".join(s) for s in points]
        for values_of, other, same in ((values[0], 1, "x"), (values[1], 0, "y")):
            if np.unique(values_of[np.isfinite(values_of)]).size == 1:
                raise self.mismatch(
                    f"all points have the same {same}, so they are a line and not a map; read the profile with "
                    f"x={names[other]!r} and z={names[2]!r}"
                )
        heights, (dx, dy), origin = to_grid(self.file, *values)
        order = {
            "row_order_in_file": "a list of points with their positions",
            "orientation_evidence": "coordinates",
        }
        self.facts = {**order, **self.facts}
        return Surface(heights, dx, dy, origin=origin, **self.described())

    def recording(
        self, timed: Column | None, sampling_rate: float | str | None, channel: str | None
    ) -> Recording:
        """Return channels over the column of time, or over rows of one rate."""
        table = self.table
        t = np.empty(0) if timed is None or timed.values is None else timed.values
        if timed is not None and timed.name in table.exact:
            t, _ = table.since_first(timed)
        rises = bool((t[1:] > t[:-1]).all())
        repeats = np.flatnonzero(t[1:] == t[:-1]) if not rises else np.empty(0, dtype=np.intp)
        if repeats.size and sampling_rate is not None:
            self.table = table = replace(
                table, columns=tuple(c for c in table.columns if timed and c.name != timed.name)
            )
            timed = None
        elif repeats.size and timed is not None:
            line = int(table.lines[repeats[0] + 1])
            raise self.mismatch(
                f"line {line} has the same time in column {timed.name!r} as the row above ({repeats.size} such "
                "row(s)): the clock is coarser than the samples; give sampling_rate= and the rows are "
                "counted, or correct the column"
            )
        if timed is not None and sampling_rate is not None:
            raise self.mismatch(
                f"has a column of time ({timed.name!r}), and sampling_rate was given too; leave "
                "sampling_rate out"
            )
        if timed is not None:
            if "separator" in table.header:
                self.table = table = without_empty_rows(table)
                timed = replace(table[timed.name], unit=timed.unit)
            t = to_si(self.file, timed, timed.unit, dimension="time", role="time")
            dated = since_first_row(table, timed, timed.unit)
            if dated is not None and timed.unit is not None:
                t = dated[0] * timed.unit.factor
                self.table = table = replace(table, warnings=(*table.warnings, dated[1]))
            unknown = np.flatnonzero(~np.isfinite(t))
            if unknown.size and "separator" in table.header:
                line = int(table.lines[unknown[0]])
                raise self.mismatch(
                    f"line {line} has no time ({unknown.size} such row(s)); correct it, or leave out what has none "
                    f"with {self.file.without_lines(*table.lines[unknown].tolist())}"
                )
            falls = np.empty(0, dtype=np.intp) if rises else np.flatnonzero(np.diff(t) < 0.0)
            summer = falls.size == 1 and 3000.0 < t[falls[0]] - t[falls[0] + 1] <= 3600.0
            if (
                falls.size
                and timed.name in table.header.get("clocks", ())
                and (summer or runs_in(table) is None)
            ):
                line, by = int(table.lines[falls[0] + 1]), float(t[falls[0]] - t[falls[0] + 1])
                why = "; summer time seems to end there" if 3000.0 < by <= 3600.0 else ""
                raise self.mismatch(
                    f"line {line}: the clock in column {timed.name!r} falls back by {by:g} s{why}; split the file "
                    "there, or give the columns of a profile with x= and z="
                )
            if falls.size and "separator" in table.header and runs_in(table) is None:
                line = int(table.lines[falls[0] + 1])
                raise self.mismatch(
                    f"line {line}: the time in column {timed.name!r} falls from {t[falls[0]]:g} s to "
                    f"{t[falls[0] + 1]:g} s; correct it, or leave the line out with {self.file.without_lines(line)}"
                )
        else:
            if channel is None:
                said = f"channel={table.numbers[0].name!r} {AS_THEY_FOLLOW}"
                refuse_row_gap(self.file, table.header.get("row_gap"), said)
            t = np.arange(len(table), dtype=np.float64) / rate_of(sampling_rate or 0.0)
            self.table = replace(table, warnings=(*table.warnings, *interruption(table)))
        chosen = [c for c in table.numbers if timed is None or c.name != timed.name]
        if channel is not None:
            column, _ = pick(self.file, table, channel, role="channel")
            chosen = [c for c in chosen if c.name == column.name]
        _refuse_markers(self.file, table, chosen)
        values = {
            c.name: c.values * (c.unit.factor if c.unit else 1.0)
            for c in chosen
            if c.values is not None
        }
        for own in (t, *values.values()):  # made here, so that the recording need not copy them
            own.setflags(write=False)
        if not any(np.isfinite(v).any() for v in values.values()):
            raise self.mismatch("no channel holds a number beside the time; nothing was measured")
        units = {c.name: SI_NAMES.get(c.unit.dimension, "") for c in chosen if c.unit is not None}
        self.used["channels"] = tuple(values)
        if channel is None:
            self.table = replace(self.table, warnings=(*self.table.warnings, *_omitted(table)))
        described = self.described()
        if rises:  # else the runs in the table may be what is meant
            self.table = replace(self.table, columns=(), lines=table.lines[:0].copy())
            del table, timed, chosen
        return Recording(t, values, units=units, **described)

    def other(self, spec: ColumnSpec, role: str) -> str:
        """Return the name of the column of numbers beside the one that was named."""
        named = pick(self.file, self.table, spec, role=role)[0].name
        return next((c.name for c in self.table.numbers if c.name != named), named)

    def profile(
        self, x: ColumnSpec | None, z: ColumnSpec | None, steps: tuple[float, float] | None
    ) -> Profile:
        """Return a height over a position, or over rows of one step."""
        file, table, is_named = self.file, self.table, z is not None
        if x is None and z is None and len(table.numbers) > 2:
            blank = {c.name for c in table.numbers if _is_empty(c)}
            if blank and len(table.numbers) - len(blank) > 1:
                kept = tuple(c for c in table.columns if c.name not in blank)
                named = ", ".join(map(repr, sorted(blank)))
                said = f"column {named} holds no number and was omitted"
                self.table = table = replace(table, columns=kept, warnings=(*table.warnings, said))
        if x is None and z is None and steps is None and len(self.table.numbers) > 2:
            self.table = table = _without_surroundings(table)
        numbers = [c.name for c in table.numbers]
        if x is None and z is None:
            if len(numbers) == 1 and steps is not None:
                z = numbers[0]
            elif len(numbers) == 2:
                x, z, assumed = position_and_height(file, table)
                self.table = replace(table, warnings=(*table.warnings, *assumed))
            else:
                raise _cannot_tell(file, table)
        if len(numbers) == 2 and steps is None:
            x = self.other(z, "z") if x is None and z is not None else x
            z = self.other(x, "x") if z is None and x is not None else z
        if z is None or (x is None and steps is None):
            raise self.mismatch(
                "a profile needs x= and z=, or z= and lateral_step=; the columns are "
                f"{shown_columns(table.names)}"
            )
        if x is not None and steps is not None:
            column, own = pick(file, table, x, role="x")
            if own is None and role_of(column.name) == "index":
                raise self.mismatch(
                    f"column {column.name!r} seems to number the rows, but not one by one, so that lateral_step does "
                    f"not tell where they lie; give z={z!r} {AS_THEY_FOLLOW}, or correct that column"
                )
            raise self.mismatch(
                "the file holds positions, so lateral_step cannot replace them; leave it out"
            )
        if x is not None:
            bare = {
                role: column.name
                for role, spec in (("x", x), ("z", z))
                for column, unit in (pick(file, table, spec, role=role),)
                if unit is None and column.values is not None
            }
            if len(bare) > 1 and self.scale is None:
                raise no_unit(file, bare, "length")
            self.table = table = without_empty_rows(self.table)
        heights = self.lengths("z", z)
        self.used["scale_m_per_v"] = self.scale
        if x is None:
            if not is_named:
                refuse_row_gap(file, table.header.get("row_gap"), f"z={z!r} {AS_THEY_FOLLOW}")
            self.used["lateral_step_m"] = step = steps[0] if steps is not None else 0.0
            positions: FloatArray = step * np.arange(heights.size, dtype=np.float64)
        else:
            positions = self.lengths("x", x)
            empty = np.flatnonzero(np.isnan(positions))
            if empty.size:
                raise self.mismatch(
                    f"line {int(table.lines[empty[0]])}: position x is NaN in {empty.size} row(s), "
                    "and a height without a position cannot be used; leave it out with "
                    f"{file.without_lines(*table.lines[empty].tolist())}"
                )
        if np.isnan(heights).all():
            raise self.mismatch(f"column {self.used['z']!r} holds no number; nothing was measured")
        described = self.described(is_profile=True)
        if _is_monotonic(positions):  # else the runs in the table may be what is meant
            self.table = table = replace(table, columns=(), lines=table.lines[:0])
        try:
            return Profile(positions, heights, **described)
        except DataError as exc:
            raise type(exc)(f"{exc}{where_it_turns(file, positions, table.lines)}") from None


def _without_surroundings(table: Table) -> Table:
    """Return the table without columns that cannot be a height, where names tell position and height.

    Percent, temperatures and other quantities with their unit, 0 and 1 under ``ok`` or ``outlier``; a further length stays, and is asked for.
    """
    roles = [role_of(c.name) for c in table.numbers]
    two = [
        c
        for c, role in zip(table.numbers, roles, strict=True)
        if role in ("position", "height") and c.unit is not None and c.unit.dimension == "length"
    ]
    other = [c for c in table.numbers if c not in two]
    aside = [
        c
        for c in other
        if role_of(c.name) in ("temperature", "index")
        or (c.unit is not None and c.unit.dimension in ("number", "temperature"))
        or is_other_unit(re.split(r"[\[({<]", c.name)[-1].rstrip(" )]}>"))
        or (len(end := c.name.rpartition("_")[2]) > 1 and is_other_unit(end))  # T_degC, not x_1
        or is_truth(c.name, c.values)
    ]
    if (
        len(two) != 2
        or roles.count("position") != 1
        or roles.count("height") != 1
        or aside != other
    ):
        return table
    named = ", ".join(repr(c.name) for c in other)
    said = f"column {named} is neither a position nor a height and was omitted"
    kept = tuple(c for c in table.columns if c not in other)
    return replace(table, columns=kept, warnings=(*table.warnings, said))


def position_and_height(file: RawFile, table: Table) -> tuple[str, str, tuple[str, ...]]:
    """Return which of two columns is the position, which the height, and what was assumed.

    Names decide, then units (a voltage is a reading), then which of the columns is monotonic. A
    name that the numbers contradict is refused, and so is what stays ambiguous.
    """
    first, second = table.numbers
    roles = [_profile_role(c) for c in (first, second)]
    either = [is_read_too(c.name) for c in (first, second)]
    if roles == ["position", "position"] and either.count(True) == 1:
        roles = ["height" if e else "position" for e in either]
    rises = [_is_monotonic(c.values) for c in (first, second)]
    calls = [f"x={a.name!r}, z={b.name!r}" for a, b in ((first, second), (second, first))]
    named = [r == "position" for r in roles], [r == "height" for r in roles]
    if named[0].count(True) == 1 or named[1].count(True) == 1:
        swapped = named[0] == [False, True] or named[1] == [True, False]
        x, z = (second, first) if swapped else (first, second)
        if _profile_role(z) != "height":
            _refuse_two_positions(file, x, z)
        if _is_monotonic(x.values, strictly=False) or not rises[not swapped]:
            return x.name, z.name, ()
        raise FormatMismatchError(
            f"{file.path}: column {x.name!r} is the position by its name, but it does not rise and "
            f"{z.name!r} does; give {calls[0]} or {calls[1]}"
        )
    if rises == [False, True]:
        return (
            second.name,
            first.name,
            (
                (
                    f"column {second.name!r} was taken as the position, since it alone is monotonic; give "
                    f"{calls[0]} if that is wrong"
                ),
            ),
        )
    if rises == [True, True] and table.header.get("named", True):
        _refuse_two_positions(file, first, second)
        return (
            first.name,
            second.name,
            (
                (
                    f"nothing says which column is the position; the first, {first.name!r}, was taken; give "
                    f"{calls[1]} if that is wrong"
                ),
            ),
        )
    ways = [_main_way(c.values) for c in (first, second)]
    if table.header.get("named", True) and roles == [None, None] and max(ways) < _MOSTLY:
        raise FormatMismatchError(
            f"{file.path}: neither {first.name!r} nor {second.name!r} rises or falls throughout, so that none of "
            f"them is a position; give sampling_rate= if they are channels over time, else {calls[0]}"
        )
    return first.name, second.name, ()


_MOSTLY = 0.8
"""Share of the steps of one sign from which a column may be a position with a slip."""


def _main_way(values: FloatArray | None) -> float:
    """Return the share of the steps that go the way most of them go."""
    steps = np.diff(values) if values is not None else np.empty(0)
    steps = steps[np.isfinite(steps)]
    half = steps.size // 2
    ways = [
        max(np.mean(s > 0.0), np.mean(s < 0.0))
        for s in (steps, steps[:half], steps[half:])
        if s.size
    ]
    return float(max(ways, default=0.0))


def _is_empty(column: Column) -> bool:
    return column.values is not None and bool(np.isnan(column.values).all())


def _profile_role(column: Column) -> str | None:
    """Return position or height, or None where neither name nor unit tells it."""
    role = role_of(column.name)
    if role is None and column.unit is not None and column.unit.dimension == "voltage":
        return "height"
    return role


def _refuse_two_positions(file: RawFile, x: Column, z: Column) -> None:
    """Refuse a height that differs from the position by less than a tenth of the travel."""
    if x.values is None or z.values is None or z.unit is None or z.unit.dimension != "length":
        return
    factor = 1.0 if x.unit is None else z.unit.factor / x.unit.factor
    if np.ptp(z.values * factor - x.values) < 0.1 * np.ptp(x.values):
        raise FormatMismatchError(
            f"{file.path}: column {z.name!r} follows the position {x.name!r} itself, so that it looks "
            "like the actual position, not a height; subtract one from the other for the error, or "
            f"give x={x.name!r}, z={z.name!r} if it is a height"
        )


def _is_monotonic(values: FloatArray | None, *, strictly: bool = True) -> bool:
    values = np.empty(0) if values is None else values
    rises = way(values) != 0
    if rises or strictly:
        return rises
    steps = np.diff(values[~np.isnan(values)])
    return bool((steps >= 0.0).all() or (steps <= 0.0).all())


_BEGIN = frozenset("0123456789+-.,(\u2212")


def _cannot_tell(file: RawFile, table: Table) -> FormatMismatchError:
    numbers = tuple(c.name for c in table.numbers)
    n = len(numbers)
    found = runs_in(table)
    if found is not None:
        return SeveralRunsError(file.path, found)
    if targets := targets_in(table):
        return FormatMismatchError(
            f"{file.path}: holds a list of targets; {table_advice(file.path, targets)}"
        )
    if n == 3 and {c.name.casefold() for c in table.numbers} == {"x", "y", "z"}:
        return FormatMismatchError(
            f"{file.path}: columns x, y and z declare no unit; for a map give one for each, such as "
            "unit='um,um,nm'"
        )
    odd = [
        c
        for c in table.columns
        if c.labels and 2 * sum(t[:1] in _BEGIN for t in c.labels if t) > len(c.labels)
    ]
    if n == 1 and odd and role_of(odd[0].name) in (None, "height", "position"):
        shown = next(t for t in odd[0].labels or () if t[:1] in _BEGIN)
        return FormatMismatchError(
            f"{file.path}: column {odd[0].name!r} holds texts such as {shown!r}, which are not numbers that a "
            "table may hold; export it as decimal numbers"
        )
    if n == 1:
        advice = "give the step of the positions with lateral_step='... um', or sampling_rate="
    else:
        runs = (c.name for c in table.columns if role_of(c.name) == "run" and c.unit is None)
        run = next(runs, "COLUMN")
        call = shlex.join(["--x", "COLUMN", "--z", "COLUMN", "--run", run])
        advice = (
            "name two with x= and z=, give sampling_rate= for a recording without a column of time, or "
            f"read repeated runs with metrosep.read_runs(x=, z=, run=) or metrosep separate FILE {call}"
        )
        if is_matrix(table):
            advice += "; for a map of heights give unit='nm' and lateral_step='3 um'"
    return FormatMismatchError(
        f"{file.path}: has {n} column(s) of numbers ({shown_columns(numbers)}) and none is a time; "
        f"{advice}"
    )


# ---- arrays without a meaning of their own (HDF5, NumPy, MATLAB): what the caller declares makes them one ----
# A two-dimensional array is a map. Nothing in it says which row is on top: the caller does with
# ``row_order``, else the first row is taken as the smallest y with a warning. Nothing says its unit: the
# caller does, or an attribute ``unit`` beside it.

_UNIT_KEYS = ("units", "unit", "Units", "Unit")


def unit_of(attributes: Mapping[str, Any]) -> Unit | None:
    """Return the unit that the attributes of an array declare."""
    try:
        return parse_unit(unit_label(attributes))
    except UnitError:
        return None


def unit_label(attributes: Mapping[str, Any]) -> str:
    """Return the text that the attributes of an array give as its unit."""
    return next((str(attributes[k]) for k in _UNIT_KEYS if attributes.get(k)), "")


def map_as_surface(
    file: RawFile,
    format_id: str,
    values: NDArray[Any],
    *,
    name: str,
    own_unit: Unit | None,
    unit: Any,
    lateral_step: Any,
    scale: float | str | None = None,
    row_order: str | None = None,
    header: Mapping[str, Any],
) -> Surface:
    """Return a two-dimensional array as a surface."""
    declared = parse_unit(str(unit)) if unit is not None else None
    if declared is not None and own_unit is not None and declared != own_unit:
        raise FormatMismatchError(
            f"{file.path}: {name!r} is in {own_unit.name} by the file, but {declared.name} was given; leave "
            "unit= out"
        )
    found = declared or own_unit
    if found is None:
        raise UnitError(f"{file.path}: {name!r} declares no unit; declare it, such as unit='nm'")
    factor = found.factor
    gain = sensitivity(scale)
    if found.dimension == "voltage" and gain is not None:
        factor *= gain
    elif found.dimension != "length":
        raise UnitError(
            f"{file.path}: {name!r} is in {found.name} ({found.dimension}); a surface needs a length, or "
            "scale='2.5 um/V' for a sensor with voltage output"
        )
    rows, said = rows_of_matrix(file, row_order)
    return make_surface(
        file,
        format_id,
        scaled(values, factor),
        (None, None),
        **rows,
        header=header,
        override=declared_steps(lateral_step),
        channel=name,
        unit_in_file=None if own_unit is None else own_unit.name,
        unit_declared=None if declared is None else declared.name,
        warnings=said,
    )


def columns_as_object(
    file: RawFile,
    format_id: str,
    columns: Mapping[str, tuple[NDArray[Any], Unit | None]],
    header: Mapping[str, Any],
    **options: Any,
) -> Profile | Recording | Surface:
    """Return arrays of one length as the columns of a table would be."""
    made = tuple(
        Column(name, unit, np.asarray(v, dtype=np.float64)) for name, (v, unit) in columns.items()
    )
    n = made[0].values.size if made and made[0].values is not None else 0
    lines = np.arange(1, n + 1, dtype=np.int64)
    exact = {
        name: SinceFirst(str(v[0]), lines, (v - v[0]).astype(np.float64))
        for name, (v, _) in columns.items()
        if v.dtype.kind in "iu" and is_long_count(name, v)
    }
    table = Table(made, lines, {"columns": tuple(columns), **header}, exact=exact)
    return measurement(file, table, format_id, **options)
