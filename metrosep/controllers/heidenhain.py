"""HEIDENHAIN value table (.COM) of iTNC 530, TNC 6xx and MANUALplus: nonlinear axis errors.

Entry: the error +e in mm, by analogy with MP720 (positive if the travel is too long); for .COM
itself the sign is not documented. BACKLASH holds the values measured in the negative direction.
Positions refer to the machine datum and are equally spaced; no comment is possible in the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.limits import Finding
from metrosep.compensation.rounding import round_entries
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, settled
from metrosep.controllers._grammar import (
    AXIS,
    Line,
    Word,
    ascii_lines,
    damaged,
    fixed,
    joined,
    mm_value,
)
from metrosep.controllers._grids import (
    Resampling,
    carry,
    require_linear,
    require_names,
    require_sizes,
    uniform_positions,
)
from metrosep.controllers.base import DialectInfo, Encoded, identity, load_sidecar
from metrosep.controllers.options import INTERVAL, Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = ["Heidenhain"]


_TITLE = "HEIDENHAIN compensation value table (.COM)"
_CAPACITY = 256
_STEEPEST = 1.0 / 64.0
"""Largest difference of neighbours over their spacing in the 64-point form of older controls."""
_DIGIT = 1e-7
"""Positions have four decimals of a mm at least, m."""
_FARTHEST, _LARGEST = 1e3, 9.0
"""Largest position and entry that fit their columns, m."""

_COLUMNS = (6, 16, 16, 16)
"""Width of the columns NR, AXISPOS, BACKLASH and that of the dependent axis."""
_BEGIN = Line("BEGIN {name}.COM MM", name=Word(r"\w{1,16}"))
_NAME = Line("{axis}_{target}", axis=AXIS, target=AXIS)
_TITLES = ("NR", "AXISPOS", "BACKLASH")
_VALUE = re.compile(r"[+-]?\d{1,6}\.\d{1,9}")


class Heidenhain(Resampling):
    """Writer and reader of .COM tables; see the module."""

    info = DialectInfo(
        id="heidenhain",
        title=_TITLE,
        entry="error +e of the dependent axis",
        units="mm",
        max_points=_CAPACITY,
        outside="not documented; taken as constant beyond both ends: cover the whole travel",
        sign_status="+e by analogy with MP720 (error positive if the travel is too long); for .COM "
        "not documented: dry-run first",
        activation=(
            "copy the .COM file to the control, beside its .CMA file",
            "enter its name in the .CMA file (config.cma) in the column of the axis that is looked up",
            "mark that line as active (column ACTIVE, soft key, or PLC module 9095)",
            (
                "one table for each axis that is looked up is active: X -> X and X -> Z in two files "
                "exclude each other; put them as two columns into one file on the control"
            ),
            (
                "iTNC 530: set the bit of the axis in MP730 to nonlinear; MP4070 limits the change of a "
                "cycle; newer controls: the table is active with its line"
            ),
            "traverse the axis with a laser or gauge: the error must shrink, else entry_sign=-1",
            "take MP750 / MP_backLash out where BACKLASH holds the reverse values",
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
        Option(
            "resolution",
            "last digit of an entry, a power of ten of mm",
            "length",
            default=1e-7,
            lowest=1e-12,
            highest=1e-6,
        ),
        Option("entry_sign", "k in entry = k e", "choice", default=1, choices=(-1, 1)),
        Option(
            "looked_up_axis", "axis that is looked up, to read tables that do not name it", "text"
        ),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        require_linear((table.axis, table.compensates), _TITLE)
        _require_axes(table, options["looked_up_axis"])
        require_sizes(table, _TITLE, farthest=_FARTHEST, largest=_LARGEST)
        unit = options["resolution"]
        decimals = _decimals(unit)
        digit = min(unit, _DIGIT)
        positions = uniform_positions(
            table, interval=options["interval"], quantum=digit, max_points=_CAPACITY, title=_TITLE
        )
        positions = np.rint(positions / digit) * digit
        carried = carry(table, positions)
        made = carried.table
        k = -options["entry_sign"]
        forward = round_entries(k * made.forward, unit)
        reverse = None if made.reverse is None else round_entries(k * made.reverse, unit)
        rounded = [forward] if reverse is None else [forward, reverse]
        texts = [[fixed(float(v) * 1e3, decimals) for v in r.values] for r in rounded]
        places = [fixed(float(p) * 1e3, max(decimals, 4)) for p in positions]
        _require_width([*places, *(t for c in texts for t in c)])
        backlash = [""] * len(places) if reverse is None else texts[1]
        lines = [
            _BEGIN.write(name=_NAME.write(axis=table.axis, target=table.compensates)),
            _line(*_TITLES, table.compensates),
            *(
                _line(str(i), p, b, v)
                for i, (p, b, v) in enumerate(zip(places, backlash, texts[0], strict=True))
            ),
            "[END]",
        ]
        return Encoded(
            joined(lines, "\r\n"),
            max(r.error for r in rounded),
            step=unit,
            carried=made,
            resampling_error=carried.error,
            findings=(*_steep(made), *_alone(table)),
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
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
        needed = ("entry_sign",)
        sign = settled(self.options, options, path, needed=needed, partial=True)["entry_sign"]
        target = _target(lines[1], path)
        rows = [_row(line, i, path) for i, line in enumerate(lines[2:-1])]
        if len(rows) > _CAPACITY:
            raise LimitError(f"{path}: {len(rows)} lines, the control takes {_CAPACITY}")
        p = np.array([r[0] for r in rows])
        _require_even(p, path)
        forward = -sign * np.array([r[2] for r in rows]) + 0.0
        filled = [r[1] is not None for r in rows]
        if any(filled) and not all(filled):
            raise CorruptFileError(
                path,
                f"line {filled.index(False)}: BACKLASH is empty here and filled elsewhere",
                hint="fill the whole column or none of it",
            )
        reverse = -sign * np.array([r[1] for r in rows]) + 0.0 if all(filled) else None
        fields = {**identity(path, first=float(p[0])), "compensates": target}
        fields["axis"] = _looked_up(begin["name"], target, options, path, both=reverse is not None)
        made = CompensationTable(
            positions=p, forward=forward, reverse=reverse, is_exact_inverse=True, **fields
        )
        _require_sign(made, path)
        return made


def _looked_up(
    name: str, target: str, options: Mapping[str, Any], path: Path, *, both: bool
) -> str:
    """Return the axis that is looked up: of the name of the table, the sidecar, BACKLASH or user."""
    named = _NAME.read(name) or {"axis": None, "target": target}
    if named["target"] != target:
        raise damaged(
            path, "name and column say another axis", expected=named["target"], found=target
        )
    beside: Any = load_sidecar(path).get("table")
    beside = beside if isinstance(beside, dict) else {}
    stated = {
        "the file": named["axis"],
        "its sidecar": beside.get("axis"),
        "its column BACKLASH": target if both else None,
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
    stored: Any = load_sidecar(path).get("table")
    if not isinstance(stored, dict):
        return
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


def _require_width(texts: list[str]) -> None:
    longest = max(texts, key=len)
    if len(longest) >= _COLUMNS[1]:
        raise LimitError(
            f"{longest} leaves no gap in a column of {_COLUMNS[1]} characters; use a coarser "
            "resolution, or check the units"
        )


def _alone(table: CompensationTable) -> tuple[Finding, ...]:
    if table.is_on_axis:
        return ()
    return (
        Finding(
            "warning",
            f"one table over {table.axis} is active at a time: this one, {table.axis} -> "
            f"{table.compensates}, switches off a table {table.axis} -> {table.axis}",
            "if there is one, put both as two columns into one file on the control",
            "active",
        ),
    )


def _require_axes(table: CompensationTable, said: str | None) -> None:
    if said not in (None, table.axis):
        raise TableError(f"looked_up_axis={said!r}, but the table is looked up over {table.axis}")
    require_names(table, "HEIDENHAIN")
    if not table.is_on_axis and table.reverse is not None:
        raise TableError(
            f"BACKLASH belongs to {table.axis} itself, this table is {table.axis} -> "
            f"{table.compensates}; make it with direction='both'"
        )


def _decimals(unit: float) -> int:
    decimals = round(-math.log10(unit / 1e-3))
    if abs(unit * 10.0**decimals / 1e-3 - 1.0) > 1e-9:
        raise DataError(
            f"resolution={unit!r} m is not a power of ten of a millimetre; use such as '100 nm' or '10 nm'"
        )
    return decimals


def _steep(table: CompensationTable) -> tuple[Finding, ...]:
    columns = [table.forward] if table.reverse is None else [table.forward, table.reverse]
    step = float(np.diff(table.positions)[0])
    worst = max(float(np.abs(np.diff(c)).max()) for c in columns)
    if worst <= _STEEPEST * step:
        return ()
    return (
        Finding(
            "warning",
            f"neighbours differ by {format_length(worst)}, more than 1/64 of their spacing "
            f"{format_length(step)}: older controls (TNC 407) refuse that",
            "check the units of the table",
            "coarse",
        ),
    )


def _line(*cells: str) -> str:
    return "".join(c.ljust(w) for c, w in zip(cells, _COLUMNS, strict=True)).rstrip()


def _cells(line: str) -> list[str]:
    cells, start = [], 0
    for width in _COLUMNS:
        cells.append(line[start : start + width].strip())
        start += width
    return [*cells, line[start:].strip()]


def _target(line: str, path: Path) -> str:
    cells = _cells(line)
    if cells[:3] != [*_TITLES] or cells[4] or not re.fullmatch(AXIS.pattern, cells[3], re.ASCII):
        raise CorruptFileError(
            path,
            f"the columns are not NR, AXISPOS, BACKLASH and one axis but {line[:60]!r}",
            hint="tables with several dependent axes are not read: keep one of their columns (on the "
            "control all stay in one file, only one table over an axis is active)",
        )
    return cells[3]


def _row(line: str, number: int, path: Path) -> tuple[float, float | None, float]:
    cells = _cells(line)
    good = cells[0] == str(number) and not cells[4]
    good = good and all(_VALUE.fullmatch(c) for c in (cells[1], cells[3]))
    if not good or not (cells[2] == "" or _VALUE.fullmatch(cells[2])):
        raise CorruptFileError(
            path,
            f"line {number} of the table cannot be read: {line[:70]!r}",
            hint="number, position, reverse value or nothing, value: write the table again",
        )
    reverse = None if cells[2] == "" else mm_value(cells[2])
    return mm_value(cells[1]), reverse, mm_value(cells[3])


def _require_even(p: FloatArray, path: Path) -> None:
    if p.size < 2:
        raise CorruptFileError(path, "a table needs at least 2 lines", found=p.size)
    even = np.linspace(p[0], p[-1], p.size)
    off = np.abs(p - even)
    if (np.diff(p) <= 0).any() or off.max() > 1e-10:
        raise CorruptFileError(
            path,
            f"line {int(off.argmax())}: the positions are not equally spaced and rising",
            found=f"{p[int(off.argmax())] * 1e3:.9g} mm",
            hint="the control needs equal steps",
        )
