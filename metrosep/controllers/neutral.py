"""Neutral table: CSV with declared units, and the JSON sidecar, for controllers without a dialect.

Columns ``position_mm, correction_forward_um[, correction_reverse_um]``, of axes that turn
``position_rad`` and ``_urad``; the entry is the correction c = -e that is added to the command.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._facts import read_table
from metrosep.controllers._grammar import (
    damaged,
    decoded,
    joined,
    require_last_end,
    scaled,
    unscaled,
)
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    map_identity,
    nearest_zero,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError

_PLACES = {"mm": 3, "rad": 0, "um": 6, "urad": 6}
"""Power of ten of a column over SI, by its unit."""
_AXES = {
    (False, False): ("X", "X"),
    (True, True): ("C", "C"),
    (True, False): ("C", "Z"),
    (False, True): ("X", "C"),
}
"""Looked up and corrected axis by whether they turn, where no sidecar names them."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
"""A decimal as other programs write it, too; Python would also take 1_0 and nan."""


def _rows(
    data: bytes, path: Path, what: str, columns: str, fewest: tuple[int, str], expected: str = ""
) -> tuple[list[str], list[int], FloatArray]:
    """Return header, numbers of lines and values in SI of a CSV, by the units in its column names."""
    try:
        reader = csv.reader(
            io.StringIO(decoded(data, path, f"CSV of a {what}", encoding="utf-8-sig"))
        )
        rows = [(reader.line_num, [v.strip() for v in row]) for row in reader if row]
    except csv.Error as exc:
        raise CorruptFileError(path, f"not CSV text ({exc})") from None
    header = rows[0][1] if rows else []
    if not re.fullmatch(columns, ",".join(header)):
        raise CorruptFileError(
            path,
            f"not a neutral {what}",
            field="header",
            expected=expected or re.sub(r"\((\w*)[^)]*\)|[\\?]", r"\1", columns),
            found=",".join(header)[:80],
        )
    require_last_end(data.decode("utf-8-sig"), path)
    if len(rows) <= fewest[0]:
        raise CorruptFileError(
            path, f"a {what} needs at least {fewest[0]} {fewest[1]}", found=len(rows) - 1
        )
    places = [_PLACES[name.rpartition("_")[2]] for name in header]
    values = []
    for line, row in rows[1:]:
        fits = len(row) == len(header) and all(map(_NUMBER.fullmatch, row))
        values.append([unscaled(v, p) for v, p in zip(row, places, strict=True)] if fits else [])
        if not fits or not np.isfinite(values[-1]).all():
            raise CorruptFileError(
                path,
                f"line {line} does not hold {len(header)} finite numbers but {','.join(row)[:60]!r}",
            )
    return header, [line for line, _ in rows[1:]], np.array(values)


class Neutral(Dialect):
    """Writer and reader of neutral tables; see the module."""

    info = DialectInfo(
        id="csv",
        title="Neutral CSV with JSON sidecar",
        entry="correction c = -e that is added to the command",
        units="position in mm, correction in um; rad and urad of axes that turn; by the column names",
        outside="constant beyond both ends",
        sign_status="by definition",
        activation=(
            "import it into the controller's own tool and dry-run the sign on the machine",
        ),
        sign="confirmed",
        resolution="full precision",
        proof="by definition",
        suffix=".csv",
        page="neutral",
    )

    def encode(self, table: CompensationTable, **options: Any) -> Encoded:
        """Return the CSV, full precision."""
        place = "rad" if is_rotary(table.axis) else "mm"
        unit = "urad" if is_rotary(table.compensates) else "um"
        columns = {
            f"position_{place}": table.positions,
            f"correction_forward_{unit}": table.forward,
        }
        if table.reverse is not None:
            columns[f"correction_reverse_{unit}"] = table.reverse
        places = (_PLACES[place], _PLACES[unit], _PLACES[unit])
        rows = (
            ",".join(_shifted(float(v), p) for v, p in zip(row, places, strict=False))
            for row in zip(*columns.values(), strict=True)
        )
        return Encoded(joined([",".join(columns), *rows]), 0.0)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        columns = "position_(mm|rad),correction_forward_(um|urad)(,correction_reverse_\\2)?"
        header, lines, values = _rows(data, path, "table", columns, (2, "lines"))
        turns = (header[0].endswith("rad"), header[1].endswith("urad"))
        falling = np.flatnonzero(np.diff(values[:, 0]) <= 0)
        if falling.size:
            raise CorruptFileError(
                path,
                f"line {lines[int(falling[0]) + 1]}: {header[0]} does not rise",
                hint="sort the lines",
            )
        return read_table(
            values[:, 0],
            values[:, 1],
            values[:, 2] if len(header) == 3 else None,
            **_fields(path, turns),
        )


def _fields(path: Path, turns: tuple[bool, bool]) -> dict[str, Any]:
    """Return axes and reference; files of old have mm and um for axes that turn, too."""
    fields = identity(path)
    table = load_sidecar(path).get("table")
    if not isinstance(table, dict) or "axis" not in table:
        return {**fields, **dict(zip(("axis", "compensates"), _AXES[turns], strict=True))}
    for name, angle in zip(("axis", "compensates"), turns, strict=True):
        if angle and not is_rotary(fields[name]):
            raise damaged(
                path,
                f"its columns are in rad, its sidecar says {name} {fields[name]}, which does not turn",
            )
    return fields


def _shifted(value: float, places: int) -> str:
    """Return the shortest decimal of a value times 10^places: exact, unlike a multiplication."""
    return format(Decimal(repr(value)).scaleb(places), "f")


# ---- neutral map: CSV in long form with declared units, and the JSON sidecar -------------------
# Columns ``x_mm,y_mm,correction_um`` after the two axes, one line a node, the first fastest; an axis that turns
# has ``_rad`` (``a_rad,c_rad``), a corrected one that turns ``correction_urad``. The entry is the correction c = -e that is added to the command. Decimals are full: the very numbers of
# the map read back.

_NAMES = {(False, False): ("X", "Y"), (True, False): ("C", "Y"), (False, True): ("X", "C")}
"""Axes by whether they turn, where neither columns nor a sidecar name them: files of old say x and y of any axis."""
_PLAIN = ("x", "y")
_COLUMN = re.compile(r"[a-z][a-z0-9]*", re.ASCII)


class NeutralMap(Dialect):
    """Writer and reader of neutral maps; see the module."""

    info = replace(
        Neutral.info,
        id="csv-map",
        title="Neutral CSV of a map with JSON sidecar",
        units="positions in mm, correction in um; rad and urad of axes that turn; by the column names",
        outside="that of the nearest edge",
        carries="map",
        directions="one",
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the CSV, full precision."""
        units = ["rad" if is_rotary(a) else "mm" for a in table.axes]
        columns, rows = (
            [scaled(v, _PLACES[u]) for v in p]
            for p, u in zip((table.x, table.y), units, strict=True)
        )
        corrected = "urad" if is_rotary(table.compensates) else "um"
        names = tuple(a.lower() for a in table.axes)
        if not all(map(_COLUMN.fullmatch, names)):  # such axes are in the sidecar alone
            names = _PLAIN
        lines = [f"{names[0]}_{units[0]},{names[1]}_{units[1]},correction_{corrected}"]
        lines += [
            f"{x},{y},{scaled(c, _PLACES[corrected])}"
            for y, values in zip(rows, table.values, strict=True)
            for x, c in zip(columns, values, strict=True)
        ]
        return Encoded(joined(lines), 0.0)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        columns = r"[a-z][a-z0-9]*_(mm|rad),[a-z][a-z0-9]*_(mm|rad),correction_(um|urad)"
        header, lines, values = _rows(
            data, path, "map", columns, (4, "nodes"), "x_mm,y_mm,correction_um"
        )
        names = tuple(name.rpartition("_")[0] for name in header[:2])
        turns = (header[0].endswith("rad"), header[1].endswith("rad"))
        angle = header[2].endswith("urad")
        x, y = _grid(values, lines, path)
        stated = (names[0].upper(), names[1].upper())
        if names == _PLAIN:
            stated = _NAMES.get(turns, ("B", "C"))
        elif tuple(map(is_rotary, stated)) != turns:
            raise damaged(
                path, f"{header[0]},{header[1]}: an axis that turns is in rad, others are in mm"
            )
        fields = map_identity(
            path,
            axes=stated,
            compensates="C" if angle else "Z",
            first=nearest_zero(x, y),
            turns=turns,
        )
        known = tuple(a.lower() for a in fields["axes"])
        if names not in (_PLAIN, known):
            raise damaged(
                path,
                f"its columns are of {' and '.join(stated)}, its sidecar says {' and '.join(fields['axes'])}",
            )
        if angle and not is_rotary(fields["compensates"]):
            raise damaged(
                path,
                f"its corrections are in urad, its sidecar says {fields['compensates']}, which does not "
                "turn",
            )
        corrections = values[:, 2].reshape(y.size, x.size)
        return CompensationMap(x, y, corrections, is_exact_inverse=True, **fields)


def _grid(values: FloatArray, lines: list[int], path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the positions of columns and rows; every node stands where it belongs."""
    changes = np.flatnonzero(np.diff(values[:, 1]) != 0.0)
    n = int(changes[0]) + 1 if changes.size else len(values)
    x, y = values[:n, 0], values[::n, 1]
    wanted = np.stack([np.tile(x, y.size), np.repeat(y, n)], axis=1)[: len(values)]
    wrong = np.flatnonzero((values[:, :2] != wanted).any(axis=1))
    if wrong.size:
        raise CorruptFileError(
            path,
            f"line {lines[int(wrong[0])]} is not the next node of a grid",
            hint="x is the fastest, every row holds the same x; no node may be missing or twice",
        )
    if len(values) % n or y.size < 2 or n < 2:
        raise damaged(path, f"{len(values)} nodes are not a grid of rows of {n}")
    for name, p in (("x", x), ("y", y)):
        if (np.diff(p) <= 0).any():
            raise CorruptFileError(path, f"{name} does not rise", hint="sort the lines")
    return x, y
