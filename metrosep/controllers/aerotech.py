"""Aerotech 2-D calibration files (``.cal``) of the A3200 and Automation1.

Rows run along one axis, columns along another; a grid point holds one value for each output axis.
The value is added to the corrected axis as its ENCODER counts, so the entry for an error e is
``-s e`` with s = +1 where the encoder counts up in the axis's + direction, else -1; sample distances
carry the encoder's sign too. Those signs are facts of the machine and have no default. What a file of
an axis that turns looks like was not seen: such a table is written only if the user states that the
unit of that axis is the degree, as PRIMARY, the unit of the axis.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import agreed, note, read_notes, read_table, settled
from metrosep.controllers._grammar import (
    LARGEST,
    REAL,
    Line,
    Word,
    code_rows,
    decoded,
    fixed,
    is_real,
    short,
)
from metrosep.controllers._grids import even_map, even_table, require_one_direction
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    map_identity,
)
from metrosep.controllers.options import (
    AlongOption,
    Option,
    axes_of,
    chosen,
    flag,
    in_axes,
    pick,
    whole,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    Example,
    TableError,
    UnsupportedFeatureError,
)

_SIGN = "direction in which the encoder of the {} counts, moving the axis in +: 1 or -1"

_OPTIONS = (
    whole("row_axis", "number of the axis along the rows, the first is 1", 1),
    whole("column_axis", "number of the axis along the columns", 1),
    whole("corrected_axis", "number of the corrected axis", 1),
    pick("row_sign", _SIGN.format("row axis"), (1, -1)),
    pick("column_sign", _SIGN.format("column axis"), (1, -1)),
    pick("corrected_sign", _SIGN.format("corrected axis"), (1, -1)),
)
_REQUIRED = tuple(replace(o, required=True) for o in _OPTIONS)
_COMMON = (
    pick(
        "offset_follows",
        "whether OFFSETROW and OFFSETCOL are along the encoder or along the axis",
        ("encoder", "axis"),
        default="encoder",
    ),
    Option(
        "primary_unit", "length of a primary unit, to read PRIMARY files", "length", positive=True
    ),
    pick(
        "position_unit",
        "unit of the axes that turn, which no document states: say deg if theirs is the degree; positions "
        "are then PRIMARY, entries of a corrected axis that turns PRIMARY/1000",
        ("deg",),
    ),
    whole(
        "decimals",
        "of an entry in um, or in 0.001 deg of a corrected axis that turns",
        0,
        9,
        default=4,
    ),
    Option(
        "names",
        "names of the looked-up axes and the corrected one, 'X, Y, Z' (of a line 'X, Z'), to read "
        "files that do not state them",
        "text",
    ),
)

_ACTIVATION = (
    "compare the axis numbers of the file with the controller's configuration: they count from 1",
    "load it: Automation1 by Configure > Calibration or CalibrationLoad(), A3200 as its manual says",
    "home the axes: the table is in machine positions",
    "at the largest entry read the position with and without calibration: the entry, by the encoder",
)


class Aerotech(Dialect):
    """Writer and reader of 2-D files for corrections over two axes; see the module."""

    info = DialectInfo(
        id="aerotech",
        title="Aerotech A3200 / Automation1 2-D calibration (.cal)",
        entry="-s*e, added to the corrected axis; s = 1 where its encoder counts with the axis, else -1",
        units="mm for positions, um for entries (POSUNIT=METRIC CORUNIT=METRIC/1000); with "
        "position_unit=deg degrees and 0.001 deg (PRIMARY, PRIMARY/1000) of axes that turn",
        outside="value of the nearest edge",
        sign_status="documented to follow the encoder, whose direction you state; not run",
        activation=_ACTIVATION,
        sign="stated",
        carries="map",
        spacing="uniform",
        directions="one",
        resolution="0.1 nm with 4 decimals",
        reference_rule="none; subtract_corner makes the first entry zero, zero_ring the outermost",
        proof="own strict parser and simulated lookup; layout also read from files of mecode",
        suffix=".cal",
        example={
            "row_axis": 2,
            "column_axis": 1,
            "corrected_axis": 4,
            "row_sign": 1,
            "column_sign": 1,
            "corrected_sign": 1,
        },
        page="aerotech",
    )

    options = (
        *_REQUIRED,
        *_COMMON,
        flag("zero_ring", "surround the map by one ring of zeros"),
        flag("subtract_corner", "make the entry of the first corner zero"),
        AlongOption(
            "row_spacing", "spacing along the rows' axis, to resample", positive=True, of="y"
        ),
        AlongOption("column_spacing", "spacing along the columns' axis", positive=True, of="x"),
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        axes = {"x": table.axes[0], "y": table.axes[1], "compensates": table.compensates}
        o = in_axes(self.options, self.filled(options), axes)
        units = _units(table.axes, table.compensates, o)
        _check_numbers(o)
        _check_names(o, (*table.axes, table.compensates))
        _check_axes(o, table)
        carried, error = _prepared(table, o)
        grid = _grid(carried.x, carried.y, carried.values, o)
        made = _encoded(grid, o, (*carried.axes, carried.compensates), units)
        return replace(
            made, carried=carried, resampling_error=error, options=chosen(self.options, o)
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        grid, known = read_grid(data, path, self.options, options)
        _require_offset_rule(grid, known, path, ("column", "row"))
        values = known["corrected_sign"] * grid.values
        x, y = _positions(grid, known, path)
        usual = ("A", "C", "") if known.get("position_unit") == "deg" else ("X", "Y", "")
        names = _stated_names(known, path, 3) or usual
        own = {grid.column_axis: names[0], grid.row_axis: names[1]}
        fields = map_identity(
            path,
            axes=(names[0], names[1]),
            compensates=names[2] or own.get(grid.output, "Z"),
            first=(float(x[0]), float(y[0])),
        )
        own = dict(zip(own, fields["axes"], strict=True))
        _require_output(grid, own, fields["compensates"], path)
        fields["border"] = "zero" if _ring_of_zeros(values) else None
        return CompensationMap(x, y, values, is_exact_inverse=True, **fields)


class AerotechLine(Dialect):
    """Writer and reader for corrections over one axis, as a 2-D table of two equal rows."""

    info = replace(
        Aerotech.info,
        id="aerotech-line",
        title="Aerotech A3200 / Automation1 calibration of one axis, as a 2-D table of two equal rows",
        outside="value of the nearest end",
        reference_rule="none",
        example={"row_axis": 2, "column_axis": 1, "corrected_axis": 1}
        | {"column_sign": 1, "corrected_sign": 1},
        carries="table",
        proof="own strict parser and simulated lookup",
    )

    options = (
        replace(
            _OPTIONS[0], help="number of any other axis, for the two equal rows", required=True
        ),
        *(replace(o, required=True) for o in (_OPTIONS[1], _OPTIONS[2], _OPTIONS[4], _OPTIONS[5])),
        *_COMMON,
        AlongOption("spacing", "spacing of the entries, to resample", positive=True),
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        table = require_one_direction(
            table, "an Aerotech calibration", "into the backlash parameter"
        )
        o = {**self.filled(options), "row_sign": 1}
        o = in_axes(self.options, o, axes_of(table))
        units = _units((table.axis,), table.compensates, o)
        if o["row_axis"] == o["corrected_axis"]:
            o["row_sign"] = o["corrected_sign"]
        _check_names(o, (table.axis, table.compensates))
        if table.is_on_axis != (o["corrected_axis"] == o["column_axis"]):
            raise DataError(
                f"the table is {table.axis} -> {table.compensates}, but column_axis="
                f"{o['column_axis']} and corrected_axis={o['corrected_axis']}"
            )
        _check_numbers(o)
        carried, error = even_table(table, o["spacing"])
        p = carried.positions
        rows = np.array([0.0, p[-1] - p[0]])
        grid = _grid(p, rows, np.vstack([carried.forward] * 2), o)
        made = _encoded(grid, o, (table.axis, "any", table.compensates), units)
        return replace(
            made, carried=carried, resampling_error=error, options=chosen(self.options, o)
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        grid, known = read_grid(data, path, self.options, options)
        if (grid.values != grid.values[0]).any():
            raise CorruptFileError(
                path,
                "its rows differ: this table depends on two axes",
                hint="read it as 'aerotech'",
            )
        _require_offset_rule(grid, known, path, ("column",))
        x, _ = _positions(grid, known, path)
        fields = identity(path)
        if not load_sidecar(path):
            names = _stated_names(known, path, 2)
            if names is None and grid.output != grid.column_axis:
                raise DataError(
                    f"{path}: axis {grid.output} is corrected over axis {grid.column_axis}, and nothing "
                    "states which axes these are; give names='X, Z', the looked-up one first"
                ).hinting(names=Example("X, Z"))
            usual = "C" if known.get("position_unit") == "deg" else "X"
            fields["axis"], fields["compensates"] = names or (usual, usual)
        _require_output(grid, {grid.column_axis: fields["axis"]}, fields["compensates"], path)
        forward = known["corrected_sign"] * grid.values[0]
        return read_table(x, forward, **fields)


def _encoded(
    grid: Grid, o: dict[str, Any], names: tuple[str, ...], units: tuple[float, float]
) -> Encoded:
    """Return the bytes of a table with what rounding costs."""
    text, printed = write_grid(grid, o, names, units)
    return Encoded(
        data=text.encode("utf-8"),
        quantisation=float(np.abs(printed - grid.values).max()),
        notes={"encoder_sign": o["corrected_sign"]},
        step=10.0 ** -o["decimals"] * units[1],
        findings=_offset_findings(grid),
    )


def _units(axes: tuple[str, ...], corrected: str, o: dict[str, Any]) -> tuple[float, float]:
    """Return what 1 is of a position and of an entry in the file, in m or rad; angles only if stated."""
    turning = [a for a in (*axes, corrected) if is_rotary(a)]
    if not turning and o["position_unit"] is not None:
        raise DataError(
            f"position_unit=deg is for axes that turn; {', '.join(axes)} and {corrected} do not: leave it out"
        )
    if turning and o["position_unit"] is None:
        raise TableError(
            f"axis {turning[0]} turns, and no document that was found states the unit of such an axis in a "
            "calibration file; if its unit on your controller is the degree, say position_unit=deg (it is "
            "kept in the sidecar), or write controller='csv'"
        ).hinting(position_unit=Example("deg"))
    if len({is_rotary(a) for a in axes}) > 1:
        raise TableError(
            f"one of {' and '.join(axes)} turns and the other does not, but a file has one unit for both "
            "positions; write controller='csv'"
        )
    return _DEG if is_rotary(axes[0]) else _MM, (_DEG if is_rotary(corrected) else _MM) / 1000


def _check_numbers(o: dict[str, Any]) -> None:
    if o["row_axis"] == o["column_axis"]:
        raise DataError(f"row_axis and column_axis are both {o['row_axis']}; give two axes")
    for name in ("row", "column"):
        same = o[f"{name}_axis"] == o["corrected_axis"]
        if same and o[f"{name}_sign"] != o["corrected_sign"]:
            raise DataError(
                f"corrected_axis is {name}_axis ({o['corrected_axis']}), but corrected_sign="
                f"{o['corrected_sign']} and {name}_sign={o[f'{name}_sign']}: one axis has one encoder"
            )


def _check_axes(o: dict[str, Any], table: CompensationMap) -> None:
    """Refuse a number of the corrected axis that is not that of the axis the map corrects."""
    own = dict(zip(table.axes, ("column_axis", "row_axis"), strict=True))
    for axis, name in own.items():
        if (axis == table.compensates) != (o[name] == o["corrected_axis"]):
            wanted = own.get(table.compensates)
            third = "a third axis" if wanted is None else f"its own axis {table.compensates}"
            number = "another number than both" if wanted is None else f"the number of {wanted}"
            raise DataError(
                f"the map {table.axes[0]}, {table.axes[1]} -> {table.compensates} corrects {third}, so "
                f"corrected_axis must be {number}, but column_axis={o['column_axis']}, row_axis="
                f"{o['row_axis']} and corrected_axis={o['corrected_axis']}"
            )


def _check_names(o: dict[str, Any], wanted: tuple[str, ...]) -> None:
    if o["names"] is not None and _split(o["names"]) != wanted:
        raise DataError(f"names={o['names']!r}, but the axes are {', '.join(wanted)}")


def _split(names: str) -> tuple[str, ...]:
    return tuple(n.strip() for n in names.split(","))


def _stated_names(known: dict[str, Any], path: Path, n: int) -> tuple[str, ...] | None:
    """Return the names of the looked-up axes and the corrected one, from comment or user."""
    noted: tuple[str, ...] = ()
    if "axes" in known and "corrects" in known:
        noted = (*_split(known["axes"])[: n - 1], known["corrects"])
        if len(noted) != n or not all(noted):
            raise CorruptFileError(path, "its comment does not name the axes", found=str(noted))
    given = _split(known["names"]) if "names" in known else ()
    if given and (len(given) != n or not all(given)):
        raise DataError(f"names={known['names']!r}: {n} names with commas between them are needed")
    if noted and given and noted != given:
        raise DataError(f"{path}: you say names={known['names']!r}, it says {', '.join(noted)}")
    return given or noted or None


def _require_output(grid: Grid, own: dict[int, str], compensates: str, path: Path) -> None:
    """Refuse a file whose entries act on another axis than the one that is said to be corrected."""
    wanted = own.get(grid.output)
    if wanted != compensates if wanted is not None else compensates in own.values():
        raise CorruptFileError(
            path,
            f"its sidecar states that it corrects {compensates}, but its entries act on axis {grid.output}, which is "
            f"{'another one' if wanted is None else wanted}",
            hint="write the table again, with the corrected_axis that belongs to it",
        )


def _require_offset_rule(
    grid: Grid, known: dict[str, Any], path: Path, which: tuple[str, ...]
) -> None:
    for name in which:
        step, offset = getattr(grid, f"{name}_step"), getattr(grid, f"{name}_offset")
        if step < 0 and offset != 0 and "offset_follows" not in known:
            raise DataError(
                f"{path}: the {name} distance is negative and the offset is not zero: writers of this "
                "format disagree whether its sign follows; say offset_follows='encoder' or 'axis' (a "
                "wrong one mirrors the table about zero)"
            ).hinting(offset_follows=Example("encoder"))


def _prepared(table: CompensationMap, o: dict[str, Any]) -> tuple[CompensationMap, float]:
    """Return the map as the file carries it, and how far resampling took it off."""
    carried, error = even_map(table, o, ("column_spacing", "row_spacing"))
    if o["subtract_corner"]:
        corner = float(carried.values[0, 0])
        offset = carried.offset_removed - corner
        carried = replace(carried, values=carried.values - corner, offset_removed=offset)
    if o["zero_ring"] and not _ring_of_zeros(carried.values):
        x, y = (np.r_[2 * p[0] - p[1], p, 2 * p[-1] - p[-2]] for p in (carried.x, carried.y))
        values = np.pad(carried.values, 1)
        carried = replace(carried, x=x, y=y, values=values, u=None, border="zero")
    return carried, error


def _ring_of_zeros(values: FloatArray) -> bool:
    inner = values[1:-1, 1:-1]
    return bool(inner.size and inner.any() and not (np.abs(values).sum() - np.abs(inner).sum()))


def _grid(x: FloatArray, y: FloatArray, values: FloatArray, o: dict[str, Any]) -> Grid:
    """Return the table along the encoders."""
    column, row = o["column_sign"], o["row_sign"]
    along = o["offset_follows"] == "encoder"
    return Grid(
        row_axis=o["row_axis"],
        column_axis=o["column_axis"],
        output=o["corrected_axis"],
        row_step=row * float(y[-1] - y[0]) / (y.size - 1),
        column_step=column * float(x[-1] - x[0]) / (x.size - 1),
        row_offset=-(row if along else 1) * float(y[0]),
        column_offset=-(column if along else 1) * float(x[0]),
        values=o["corrected_sign"] * values,
    )


def _positions(grid: Grid, known: dict[str, Any], path: Path) -> tuple[FloatArray, FloatArray]:
    """Return where columns and rows lie along the axes."""
    along = known.get("offset_follows", "encoder") == "encoder"
    found: list[FloatArray] = []
    for step, offset, n in (
        (grid.column_step, grid.column_offset, grid.values.shape[1]),
        (grid.row_step, grid.row_offset, grid.values.shape[0]),
    ):
        first = -offset * (math.copysign(1.0, step) if along else 1.0)
        positions = np.asarray(first + abs(step) * np.arange(n), dtype=np.float64)
        if (np.diff(positions) <= 0).any():
            raise CorruptFileError(
                path, f"its positions do not rise: the distance is {step:.3g} m"
            )
        found.append(positions)
    return found[0], found[1]


def _offset_findings(grid: Grid) -> tuple[Finding, ...]:
    shifted = [
        name
        for name, step, offset in (
            ("OFFSETROW", grid.row_step, grid.row_offset),
            ("OFFSETCOL", grid.column_step, grid.column_offset),
        )
        if step < 0 and offset != 0
    ]
    if not shifted:
        return ()
    return (
        Finding.warning(
            f"{' and '.join(shifted)} belongs to an encoder that counts against its axis: public "
            "writers of this format disagree whether its sign follows",
            "try a map with one bump first; if it appears mirrored about zero, say offset_follows='axis'",
            "offset",
        ),
    )


# ---- the text of an Aerotech 2-D table: written and read strictly, lengths along the encoders ----

_MM, _DEG = 1e-3, math.radians(1.0)


def _plain(value: float) -> str:
    """Return a number with three decimals or as many as it takes."""
    return short(value + 0.0, 12, at_least=3)


_REAL = replace(REAL, write=_plain)
_AXIS = Word(r"0{0,8}[1-9]\d{0,8}", int, "{:<3}".format)
_START = ":START2D"
_HEAD = Line(
    f"{_START} {{row}} {{column}} {{out1}} {{out2}} {{row_step}} {{column_step}} {{columns}}",
    row=_AXIS, column=_AXIS, out1=replace(_AXIS, write="{:<4}".format), out2=_AXIS, row_step=_REAL,
    column_step=_REAL,
)  # fmt: skip
_UNIT = Word(r"(?:METRIC|PRIMARY)(?:/\d{1,9})?")
_KEYS = {
    "OUTAXIS3": Word(_AXIS.pattern, int, str), "POSUNIT": Word(r"\S+"), "CORUNIT": Word(r"\S+"),
    "OFFSETROW": _REAL, "OFFSETCOL": _REAL,
}  # fmt: skip
"""Words of the second line, in any order; the first may be missing."""
_WORD = re.compile(r"([A-Z][A-Z0-9]*)\s*=\s*(\S+)")


@dataclass(frozen=True, slots=True)
class Grid:
    """A 2-D table as it stands in the file."""

    row_axis: int  # numbers of the axes along rows and columns and of the corrected one, from 1
    column_axis: int
    output: int
    row_step: float  # m: sample distances; negative where the encoder counts against its axis
    column_step: float
    row_offset: float  # m: as the file holds them: minus the first position
    column_offset: float
    values: FloatArray  # shape (rows, columns), m: entries along the encoder of the corrected axis


def write_grid(
    grid: Grid, o: dict[str, Any], names: tuple[str, ...], units: tuple[float, float]
) -> tuple[str, FloatArray]:
    """Return the file, and its entries as printed, in m or rad; units of positions and of entries."""
    along, across = units
    first = grid.output == grid.column_axis
    third = grid.output not in (grid.row_axis, grid.column_axis)
    # in um the product with 1e6 is exact where the quotient is not
    numbers = np.degrees(grid.values) * 1e3 if across != _MM / 1000 else grid.values * 1e6
    words = [[fixed(v, o["decimals"]) for v in row] for row in numbers]
    cell = "0 0 {}" if third else ("{} 0" if first else "0 {}")
    width = max(
        len(cell) - 2 + o["decimals"] + 3, *(len(cell.format(w)) for r in words for w in r)
    )
    facts: dict[str, Any] = {
        "corrected_sign": o["corrected_sign"],
        "offset_follows": o["offset_follows"],
        "corrected_axis": grid.output,
        "rows": len(words),
    }
    if o["position_unit"] is not None:
        facts["position_unit"] = o["position_unit"]
    if all(n.isascii() and n.isalnum() for n in names):
        facts |= {"axes": f"{names[0]},{names[1]}", "corrects": names[2]}
    head = {
        "row": grid.row_axis, "column": grid.column_axis, "out1": grid.column_axis,
        "out2": grid.row_axis, "row_step": grid.row_step / along,
        "column_step": grid.column_step / along, "columns": numbers.shape[1],
    }  # fmt: skip
    keys = {
        **({"OUTAXIS3": grid.output} if third else {}),
        "POSUNIT": "METRIC" if along == _MM else "PRIMARY",
        "CORUNIT": "METRIC/1000" if across == _MM / 1000 else "PRIMARY/1000",
        "OFFSETROW": grid.row_offset / along, "OFFSETCOL": grid.column_offset / along,
    }  # fmt: skip
    lines = [
        _HEAD.write(**head),
        " ".join([_START, *(f"{k}={_KEYS[k].write(v)}" for k, v in keys.items())]),
        *("   ".join(cell.format(w).ljust(width) for w in row).rstrip() for row in words),
        ":END",
    ]
    lines[:0] = [f"; {note(facts, lines)}", ";       row col out1 out2 dRow  dCol  nCols"]
    back = np.array(words, dtype=np.float64)
    return "\n".join(lines) + "\n", back * (1e-6 if across == _MM / 1000 else across)


def read_grid(
    data: bytes, path: Path, known: tuple[Option, ...], given: dict[str, Any]
) -> tuple[Grid, dict[str, Any]]:
    """Return the table of a file, and the facts about the machine that are known."""
    text = decoded(data, path, "2-D calibration of Aerotech", encoding="utf-8-sig")
    lines, comments = code_rows(text.splitlines(), ";")
    noted = read_notes(comments, [code for _, code in lines], path)
    facts: dict[str, Any] = {
        **{k: v for k, v in noted.items() if k in ("axes", "corrects")},
        **settled(known, given, path, file=noted, needed=("corrected_sign",), partial=True),
    }
    grid = _parsed(lines, path, facts)
    for name, found in (
        ("row_sign", math.copysign(1, grid.row_step)),
        ("column_sign", math.copysign(1, grid.column_step)),
        ("row_axis", grid.row_axis),
        ("column_axis", grid.column_axis),
        ("corrected_axis", grid.output),
    ):
        agreed(path, name, {"the file": found, "you": facts.get(name)})
    return grid, facts


def _parsed(lines: list[tuple[int, str]], path: Path, facts: dict[str, Any]) -> Grid:
    starts = [i for i, (_, code) in enumerate(lines) if code.startswith(_START)]
    ends = [i for i, (_, code) in enumerate(lines) if code == ":END"]
    if len(starts) > 2 or len(ends) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it holds several tables, which the controller adds up; read one table a file"
        )
    if starts != [0, 1] or ends != [len(lines) - 1]:
        raise CorruptFileError(
            path,
            "a table is two lines :START2D, rows of numbers and :END, and nothing else",
            found=f"{len(starts)} :START2D and {len(ends)} :END in {len(lines)} lines",
            hint="it was cut short, or is not a 2-D calibration of Aerotech",
        )
    head, words = _header(lines[0], path), _keys(lines[1], path)
    columns = head["columns"]
    outputs = [head["out1"], head["out2"], *([words["OUTAXIS3"]] if "OUTAXIS3" in words else [])]
    turns = facts.get("position_unit") == "deg"
    unit = _unit(words["POSUNIT"], lines[1][0], path, facts, turns=turns)
    # of a linear axis that is corrected over one that turns, PRIMARY is a length
    corrected = facts.get("corrects") or _split(facts.get("names") or "C")[-1]
    cell = _unit(words["CORUNIT"], lines[1][0], path, facts, turns=turns and is_rotary(corrected))
    rows = [_row(line, columns * len(outputs), path) for line in lines[2:-1]]
    if len(rows) < 2:
        raise CorruptFileError(path, "a table needs at least 2 rows", found=len(rows))
    values = np.array(rows).reshape(len(rows), columns, len(outputs)) * cell
    which = _output(values, outputs, path, facts)
    return Grid(
        row_axis=head["row"],
        column_axis=head["column"],
        output=outputs[which],
        row_step=head["row_step"] * unit,
        column_step=head["column_step"] * unit,
        row_offset=words["OFFSETROW"] * unit,
        column_offset=words["OFFSETCOL"] * unit,
        values=values[:, :, which],
    )


def _output(values: FloatArray, outputs: list[int], path: Path, facts: dict[str, Any]) -> int:
    used = [i for i in range(len(outputs)) if values[:, :, i].any()]
    if len(used) > 1:
        raise UnsupportedFeatureError(
            f"{path}: it corrects {len(used)} axes at once; metrosep reads corrections of one axis"
        )
    if used:
        return used[0]
    wanted = facts.get("corrected_axis")
    return outputs.index(wanted) if wanted in outputs else len(outputs) - 1


def _header(line: tuple[int, str], path: Path) -> dict[str, Any]:
    number, code = line
    found = _HEAD.read(" ".join(code.split()))
    if (
        found is None
        or not all(0.0 < abs(found[k]) <= LARGEST for k in ("row_step", "column_step"))
        or found["columns"] < 2
        or found["row"] == found["column"]
    ):
        raise CorruptFileError(
            path,
            f"line {number} is not a table's first line but {code[:60]!r}",
            expected=":START2D row, column, output 1, output 2 (whole numbers from 1), row distance, "
            "column distance, columns (2 or more)",
        )
    return found


def _keys(line: tuple[int, str], path: Path) -> dict[str, Any]:
    number, code = line
    rest = code.removeprefix(_START)
    found = _WORD.findall(rest)
    words = dict(found)
    problem = ""
    if _WORD.sub("", rest).strip() or len(words) != len(found):
        problem = "is not a list of KEY=VALUE"
    elif unknown := [k for k in words if k not in _KEYS]:
        problem = f"holds the unknown key {unknown[0]}"
    elif missing := [k for k in list(_KEYS)[1:] if k not in words]:
        problem = f"lacks {missing[0]}"
    elif not all(is_real(words[k]) for k in ("OFFSETROW", "OFFSETCOL")):
        problem = "holds an offset that is not a number"
    elif not re.fullmatch(_AXIS.pattern, words.get("OUTAXIS3", "1"), re.ASCII):
        problem = "holds an OUTAXIS3 that is not the number of an axis"
    if problem:
        raise CorruptFileError(path, f"line {number} {problem}: {code[:60]!r}")
    return {k: _KEYS[k].read(v) for k, v in words.items()}


def _unit(text: str, number: int, path: Path, facts: dict[str, Any], *, turns: bool) -> float:
    kind, _, parts = text.partition("/")
    if not re.fullmatch(_UNIT.pattern, text, re.ASCII) or (parts and not int(parts)):
        raise UnsupportedFeatureError(
            f"{path}: line {number}: unit {text[:40]!r}; metrosep reads METRIC and PRIMARY, also divided "
            "as in METRIC/1000"
        )
    whole = _MM if kind == "METRIC" else (_DEG if turns else facts.get("primary_unit"))
    if whole is None:
        raise (
            DataError(
                f"{path}: line {number}: the unit is PRIMARY, that of the axis; say how long it is, "
                "primary_unit='1 mm', or position_unit=deg where it turns and its unit is the degree"
            )
            .hinting(primary_unit=Example("1 mm"))
            .hinting(position_unit=Example("deg"))
        )
    return float(whole) / int(parts or 1)


def _row(line: tuple[int, str], count: int, path: Path) -> list[float]:
    number, code = line
    words = code.split()
    if len(words) != count or not all(map(is_real, words)):
        raise CorruptFileError(
            path,
            f"line {number} is not a row of {count} numbers but {code[:60]!r}",
            found=f"{len(words)} words",
        )
    return [float(w) for w in words]
