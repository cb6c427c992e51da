"""HEIDENHAIN value table (.COM) of iTNC 530, TNC 6xx and MANUALplus: nonlinear axis errors.

Entry: the error +e in mm, of an axis that turns in degrees, by analogy with MP720 (positive if the
travel is too long); for .COM itself the sign is not documented. BACKLASH holds the values measured in
the negative direction. Positions refer to the machine datum and are equally spaced, those of an axis
that turns lie from 0 to 360; no comment is possible in the file. Several dependent axes are columns of
one file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import format_along, format_amount, format_span, is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.rounding import round_entries
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, read_table, settled
from metrosep.controllers._grammar import (
    AXIS,
    Line,
    Word,
    ascii_lines,
    damaged,
    deg_value,
    fixed,
    joined,
    mm_value,
)
from metrosep.controllers._grids import (
    Repeating,
    Resampling,
    carry,
    require_names,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers.base import ALONE, DialectInfo, Encoded, identity, stored_table
from metrosep.controllers.options import (
    INTERVAL,
    TURN,
    AlongOption,
    Option,
    axes_of,
    chosen,
    closed,
    in_axes,
    is_one_turn,
    pick,
    require_whole_turn,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    NameNotFoundError,
    TableError,
)

_TITLE = "HEIDENHAIN compensation value table (.COM)"
_CAPACITY = 256
_STEEPEST = 1.0 / 64.0
"""Largest difference of neighbours over their spacing in the 64-point form of older controls."""
_FEWEST, _MOST = 3, 9
"""Decimals of an entry; positions have four at least."""
_USUAL = 4
_LARGEST = 9.0
"""Largest entry that fits its column, m or rad."""

_COLUMNS = (6, 16, 16, 16)
"""Width of the columns NR, AXISPOS, BACKLASH and that of each dependent axis, where we write them."""
_BEGIN = Line("BEGIN {name}.COM MM", name=Word(r"\w{1,16}"))
_NAME = Line("{axis}_{targets}", axis=AXIS, targets=Word(r"[A-Z]\d?(?:_[A-Z]\d?)*"))
_LONGEST = 16
"""Characters of the name of a table."""
_ASSIGNMENT = (
    "in the .CMA file of the control (config.cma), which metrosep never writes: the name of this .COM "
    "in the column {}, and * in ACTIVE of that line; only one line is active"
)
_TITLES = ("NR", "AXISPOS", "BACKLASH")
_VALUE = re.compile(r"[+-]?\d{1,6}\.\d{1,9}")


class Heidenhain(Repeating, Resampling):
    """Writer and reader of .COM tables; see the module."""

    info = DialectInfo(
        id="heidenhain",
        title=_TITLE,
        entry="error +e of the dependent axis",
        units="mm; of an axis that turns degrees, positions from 0 to 360",
        max_points=_CAPACITY,
        outside="not documented; taken as constant beyond both ends: cover the whole travel; 0 to 360 deg "
        "is taken to repeat",
        sign_status="+e by analogy with MP720 (error positive if the travel is too long); for .COM "
        "not documented: dry-run first",
        activation=(
            "copy the .COM file to the control, beside its .CMA file",
            "enter its name in the .CMA file (config.cma) in the column of the axis that is looked up",
            "mark that line as active (column ACTIVE, soft key, or PLC module 9095)",
            (
                "one table for each axis that is looked up is active: X -> X and X -> Z in two files "
                "exclude each other; write them as columns of one file (beside=)"
            ),
            (
                "iTNC 530: set the bit of the axis in MP730 to nonlinear; MP4070 limits the change of a "
                "cycle; newer controls: the table is active with its line"
            ),
            "traverse the axis with a laser or gauge: the error must shrink, else entry_sign=-1",
            "take MP750 / MP_backLash out where BACKLASH holds the reverse values",
            "of an axis that turns the linear compensation (MP720) is off: this table is all there is",
        ),
        sign="unconfirmed",
        spacing="uniform",
        resolution="0.1 um, finer where the control takes the digits",
        reference_rule="positions refer to the machine datum (MP960 / MP_refPosition)",
        suffix=".com",
        example={},
        page="heidenhain",
    )

    options = (
        INTERVAL,
        AlongOption(
            "resolution",
            "last digit of an entry, a power of ten of mm or deg, from 0.001 to 1e-9; 0.0001 if omitted",
            positive=True,
            of="compensates",
        ),
        pick("entry_sign", "k in entry = k e", (-1, 1), default=1),
        Option(
            "looked_up_axis", "axis that is looked up, to read tables that do not name it", "text"
        ),
        Option("column", "dependent axis, to read one of several columns", "text"),
        Option(
            "beside",
            "file whose columns, of other dependent axes, go into the new file too",
            "text",
        ),
    )

    def require_target(self, path: Path) -> None:
        """Refuse to write over the file that assigns the tables to axes."""
        if path.suffix.lower() == ".cma":
            raise TableError(
                f"{path}: a .CMA assigns tables to axes and is the control's own; write a .COM, and enter "
                "its name there by hand"
            )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        _require_axes(table, options)
        o = in_axes(self.options, options, axes_of(table))
        along, across = _unit(table.axis), _unit(table.compensates)
        decimals = _decimals(o["resolution"], across)
        unit = across / 10.0**decimals
        if is_rotary(table.axis):
            table = _turned(table, o, unit)
        require_sizes(table, _TITLE, largest=_LARGEST)
        digits = max(decimals, _USUAL)
        digit = along / 10.0**digits
        positions = uniform_positions(
            table, interval=o["interval"], quantum=digit, max_points=_CAPACITY, title=_TITLE
        )
        positions = np.rint(positions / digit) * digit
        carried = carry(table, positions)
        made = carried.table
        k = -options["entry_sign"]
        forward = round_entries(k * made.forward, unit)
        reverse = None if made.reverse is None else round_entries(k * made.reverse, unit)
        rounded = [forward] if reverse is None else [forward, reverse]
        texts = [[fixed(float(v) / across, decimals) for v in r.values] for r in rounded]
        places = [fixed(float(p) / along, digits) for p in positions]
        longest = max([*places, *(t for c in texts for t in c)], key=len)
        if len(longest) >= _COLUMNS[1]:
            raise LimitError(
                f"{longest} leaves no gap in a column of {_COLUMNS[1]} characters; use a coarser "
                "resolution, or check the units"
            )
        backlash = [""] * len(places) if reverse is None else texts[1]
        name = _NAME.write(axis=table.axis, targets=table.compensates)
        return Encoded(
            _file(name, [table.compensates], zip(places, backlash, texts[0], strict=True)),
            max(r.error for r in rounded),
            notes={"cma": _ASSIGNMENT.format(table.axis)},
            step=unit,
            carried=made,
            resampling_error=carried.error,
            findings=(*_steep(made), *_alone(table)),
            options=chosen(self.options, o),
        )

    def in_columns(self, parts: list[bytes]) -> bytes:
        """Return tables over one axis as columns of one file; the positions are the same digits."""
        read = [_opened(data, Path(f"table {i}")) for i, data in enumerate(parts, start=1)]
        axes = {(_NAME.read(t.name) or {})["axis"] for t in read}
        targets = [t.targets[0] for t in read]
        if len(axes) > 1:
            raise TableError(
                f"the tables are looked up over {', '.join(sorted(axes))}: one file is of one such axis"
            )
        twice = sorted({t for t in targets if targets.count(t) > 1})
        if twice:
            raise TableError(
                f"two tables correct {twice[0]}: a file has one column for each dependent axis; add them up "
                "first (metrosep.compensation.combine_tables)"
            )
        for other, target in zip(read[1:], targets[1:], strict=True):
            if [r[0] for r in other.rows] != [r[0] for r in read[0].rows]:
                raise TableError(
                    f"the positions for {targets[0]} and {target} are not the same: all columns of a file "
                    "stand at one list of positions; make the tables with the same positions="
                )
        name = _NAME.write(axis=axes.pop(), targets="_".join(targets))
        if len(name) > _LONGEST:
            raise LimitError(
                f"{len(targets)} columns make a name of more than {_LONGEST} characters"
            )
        backlash = [
            next(filter(None, (t.rows[i][1] for t in read)), "") for i in range(len(read[0].rows))
        ]
        rows = [
            (read[0].rows[i][0], b, *(t.rows[i][2] for t in read)) for i, b in enumerate(backlash)
        ]
        return _file(name, targets, rows)

    def columns_of(self, data: bytes, path: Path) -> dict[str, bytes]:
        """Return each column as a file of its own; BACKLASH goes with the axis that is looked up."""
        file = _opened(data, path)
        axis = _looked_up(file, file.targets[0], {}, path, both=any(r[1] for r in file.rows))
        parts = {}
        for k, target in enumerate(file.targets, start=2):
            rows = ((r[0], r[1] if target == axis else "", r[k]) for r in file.rows)
            parts[target] = _file(_NAME.write(axis=axis, targets=target), [target], rows)
        return parts

    def _read(
        self, data: bytes, path: Path, options: Mapping[str, Any]
    ) -> tuple[CompensationTable, bool]:
        """Return one column of a table, and whether it repeats."""
        file = _opened(data, path)
        target = _chosen(file, options.get("column"), path)
        filled = [r[1] != "" for r in file.rows]
        if any(filled) and not all(filled):
            raise CorruptFileError(
                path,
                f"line {filled.index(False)}: BACKLASH is empty here and filled elsewhere",
                hint="fill the whole column or none of it",
            )
        axis = _looked_up(file, target, options, path, both=all(filled))
        known = settled(
            self.options, options, path, needed=("entry_sign",), partial=True,
            axes={"axis": axis, "compensates": target},
        )  # fmt: skip
        place, value = (deg_value if is_rotary(a) else mm_value for a in (axis, target))
        p = np.array([place(r[0]) for r in file.rows])
        _require_even(p, path, axis)
        k, column = -known["entry_sign"], 2 + file.targets.index(target)
        forward = k * np.array([value(r[column]) for r in file.rows]) + 0.0
        reverse = None
        if all(filled) and target == axis:
            reverse = k * np.array([value(r[1]) for r in file.rows]) + 0.0
        fields = {**identity(path, column=target), "compensates": target}
        made = read_table(p, forward, reverse, **{**fields, "axis": axis})
        _require_sign(made, path)
        repeats = is_one_turn(made)
        if repeats and any(c is not None and c[0] != c[-1] for c in (forward, reverse)):
            raise CorruptFileError(
                path,
                "the values at 0 and 360 deg differ: the axis would jump there",
                hint="enter the value of 0 again at 360",
            )
        return made, repeats


@dataclass(frozen=True, slots=True)
class _File:
    """A table, read: texts of AXISPOS, BACKLASH (may be empty) and of each dependent axis."""

    name: str
    targets: list[str]
    rows: list[tuple[str, ...]]


def _opened(data: bytes, path: Path) -> _File:
    """Return the cells of a table."""
    lines = ascii_lines(data, path, "HEIDENHAIN table")
    if len(lines) < 3 or lines[-1] != "[END]":
        raise damaged(path, "the table does not end with [END]: it was cut short")
    begin = _BEGIN.read(lines[0])
    if begin is None:
        raise CorruptFileError(
            path,
            f"the first line is not 'BEGIN name.COM MM' but {lines[0][:60]!r}",
            hint="only tables in mm are read",
        )
    targets, starts = _columns(lines[1], path)
    rows = [_row(line, i, starts, path) for i, line in enumerate(lines[2:-1])]
    if len(rows) > _CAPACITY:
        raise LimitError(f"{path}: {len(rows)} lines, the control takes {_CAPACITY}")
    return _File(begin["name"], targets, rows)


def _file(name: str, targets: list[str], rows: Iterable[tuple[str, ...]]) -> bytes:
    """Return a table of rows: position, reverse value or nothing, a value for each dependent axis."""
    lines = [
        _BEGIN.write(name=name),
        _line(*_TITLES, *targets),
        *(_line(str(i), *row) for i, row in enumerate(rows)),
        "[END]",
    ]
    return joined(lines, "\r\n")


def _unit(axis: str) -> float:
    """Return the unit of an axis in the file, m or rad."""
    return math.radians(1.0) if is_rotary(axis) else 1e-3


def _turned(table: CompensationTable, o: Mapping[str, Any], step: float) -> CompensationTable:
    """Return a table of an axis that turns, closed over one turn, and refuse positions beyond 0 to 360."""
    low, high = table.span
    if low < -1e-9 or high > TURN + 1e-9:
        raise TableError(
            f"{_TITLE}: positions of an axis that turns lie from 0 to 360 deg, this table covers "
            f"{math.degrees(low):.9g} ... {math.degrees(high):.9g} deg; make it with positions in that range"
        )
    if not is_one_turn(table):
        return table
    require_whole_turn(o["interval"], _TITLE)
    return closed(table, step)


def _chosen(file: _File, wanted: str | None, path: Path) -> str:
    """Return the dependent axis whose column is read."""
    if wanted in file.targets or (wanted is None and len(file.targets) == 1):
        return wanted or file.targets[0]
    names = ", ".join(file.targets)
    if wanted is None:
        raise DataError(f"{path}: it has a column for each of {names}; choose one with column=")
    raise NameNotFoundError(f"{path}: it has no column {wanted!r}; there are {names}")


def _looked_up(
    file: _File, target: str, options: Mapping[str, Any], path: Path, *, both: bool
) -> str:
    """Return the axis that is looked up: of the name of the table, the sidecar, BACKLASH or user."""
    columns = "_".join(file.targets)
    named = _NAME.read(file.name) or {"axis": None, "targets": columns}
    if named["targets"] != columns:
        raise damaged(
            path, "name and column say another axis", expected=named["targets"], found=columns
        )
    name, beside = file.name, stored_table(path, target)
    stated = {
        "the file": named["axis"],
        "its sidecar": beside.get("axis"),
        "its column BACKLASH": target if both and len(file.targets) == 1 else None,
        "you": options.get("looked_up_axis"),
    }
    axis = agreed(path, "the axis that is looked up", stated)
    sources = {"the file": target, "its sidecar": beside.get("compensates")}
    agreed(path, "the corrected axis", sources)
    if axis is None:
        raise DataError(
            f"{path}: the table corrects {target}, but its name {name} does not state over which axis; "
            f"give looked_up_axis= ({target} if the axis corrects itself)"
        )
    return str(axis)


def _require_sign(made: CompensationTable, path: Path) -> None:
    """Refuse a sidecar whose sign contradicts the corrections that it holds itself."""
    stored = stored_table(path, made.compensates)
    both = made.reverse is not None and stored.get("reverse_m") is not None
    columns = [("forward_m", made.forward), ("reverse_m", made.reverse)][: 2 if both else 1]
    agreement = 0.0
    for key, found in columns:
        p, c = stored.get("positions_m"), stored.get(key)
        if not isinstance(p, list) or not isinstance(c, list) or len(p) != len(c) or len(p) < 2:
            return
        try:
            wanted = np.interp(made.positions, np.array(p, float), np.array(c, float))
        except (TypeError, ValueError):
            return
        agreement += float(wanted @ np.asarray(found))
    if agreement < 0.0:
        raise CorruptFileError(
            path,
            "the sign of entries in its sidecar contradicts the corrections in its sidecar",
            field="entry_sign",
            hint="the sidecar was changed: write the table again",
        )


def _alone(table: CompensationTable) -> tuple[Finding, ...]:
    if table.is_on_axis:
        return ()
    return (
        Finding.warning(
            f"one table over {table.axis} is active at a time: this one, {table.axis} -> "
            f"{table.compensates}, switches off a table {table.axis} -> {table.axis}",
            "if there is one, write both as columns of one file: name it with beside=",
            ALONE,
        ),
    )


def _require_axes(table: CompensationTable, options: Mapping[str, Any]) -> None:
    for name, axis in (("looked_up_axis", table.axis), ("column", table.compensates)):
        if options[name] not in (None, axis):
            raise TableError(
                f"{name}={options[name]!r}, but the table is {table.axis} -> {table.compensates}"
            )
    require_names(table, "HEIDENHAIN")
    if not table.is_on_axis and table.reverse is not None:
        raise TableError(
            f"BACKLASH belongs to {table.axis} itself, this table is {table.axis} -> "
            f"{table.compensates}; make it with direction='both'"
        ).hinting(direction="both")


def _decimals(resolution: float | None, unit: float) -> int:
    """Return the decimals of an entry in its unit, mm or deg."""
    if resolution is None:
        return _USUAL
    decimals = round(-math.log10(resolution / unit))
    if abs(resolution * 10.0**decimals / unit - 1.0) > 1e-9:
        raise DataError(
            f"resolution={resolution!r} (SI units) is not a power of ten of a millimetre, or of a degree "
            "where the corrected axis turns; use such as '100 nm', '10 nm' or '0.0001 deg'"
        )
    if not _FEWEST <= decimals <= _MOST:
        raise DataError(
            f"resolution= gives {decimals} decimals, the file has {_FEWEST} to {_MOST}"
        )
    return decimals


def _steep(table: CompensationTable) -> tuple[Finding, ...]:
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    step = float(np.diff(table.positions)[0])
    worst = max(float(np.abs(np.diff(c)).max()) for c in columns)
    turns = [is_rotary(a) for a in (table.axis, table.compensates)]
    if worst <= _STEEPEST * step or turns[0] != turns[1]:
        return ()
    return (
        Finding.warning(
            f"neighbours differ by {format_amount(table.compensates, worst)}, more than 1/64 of their "
            f"spacing {format_along(table.axis, step)}: older controls (TNC 407) refuse that",
            "check the units of the table",
            "coarse",
        ),
    )


def _line(*cells: str) -> str:
    widths = (*_COLUMNS, *(_COLUMNS[-1:] * (len(cells) - len(_COLUMNS))))
    return "".join(c.ljust(w) for c, w in zip(cells, widths, strict=True)).rstrip()


def _cells(line: str, starts: list[int]) -> list[str]:
    """Return the cells of a line: one for each title, else those below the start of their title."""
    if len(words := line.split()) == len(starts):
        return words
    ends = [*starts[1:], len(line)]
    cells = [line[a:b] for a, b in zip(starts, ends, strict=True)]
    for k, start in enumerate(starts[1:]):
        if start < len(line) and not line[start - 1].isspace():  # it is of no single column
            cells[k] = cells[k + 1] = line[starts[k] : ends[k + 1]]
    return [line[: starts[0]] + cells[0], *cells[1:]]


def _columns(line: str, path: Path) -> tuple[list[str], list[int]]:
    """Return the dependent axes of the line of titles, and where its columns start: widths are the control's."""
    titles = [(m[0], m.start()) for m in re.finditer(r"\S+", line)]
    names, starts = [t for t, _ in titles], [at for _, at in titles]
    targets = names[3:]
    good = targets and all(re.fullmatch(AXIS.pattern, t, re.ASCII) for t in targets)
    if names[:3] != [*_TITLES] or not good:
        raise CorruptFileError(
            path,
            f"the columns are not NR, AXISPOS, BACKLASH and one for each dependent axis but {line[:60]!r}",
            hint="names of axes are a capital and perhaps a digit; write the table again",
        )
    if len({*targets}) < len(targets):
        raise CorruptFileError(
            path,
            f"two columns have the same name: {', '.join(targets)}",
            hint="a dependent axis has one column: write the table again",
        )
    return targets, starts


def _row(line: str, number: int, starts: list[int], path: Path) -> tuple[str, ...]:
    """Return the texts of a line: position, reverse value or nothing, values."""
    cells = [c.strip() for c in _cells(line, starts)]
    good = cells[0] == str(number) and all(_VALUE.fullmatch(c) for c in (cells[1], *cells[3:]))
    if not good or not (cells[2] == "" or _VALUE.fullmatch(cells[2])):
        raise CorruptFileError(
            path,
            f"line {number} of the table cannot be read: {line[:70]!r}",
            hint="number, position, reverse value or nothing, value, each below its title: write the "
            "table again",
        )
    return tuple(cells[1:])


def _require_even(p: FloatArray, path: Path, axis: str) -> None:
    if p.size < 2:
        raise CorruptFileError(path, "a table needs at least 2 lines", found=p.size)
    even = np.linspace(p[0], p[-1], p.size)
    off = np.abs(p - even)
    if (np.diff(p) <= 0).any() or off.max() > 1e-10:
        raise CorruptFileError(
            path,
            f"line {int(off.argmax())}: the positions are not equally spaced and rising",
            found=format_span(axis, float(p[int(off.argmax())]), digits=9),
            hint="the control needs equal steps",
        )
    if is_rotary(axis) and (p[0] < -1e-9 or p[-1] > TURN + 1e-9):
        raise CorruptFileError(
            path,
            "positions of an axis that turns lie from 0 to 360",
            found=f"{format_span(axis, float(p[0]), digits=9)} ... {format_span(axis, float(p[-1]), digits=9)}",
            hint="write the table again",
        )
