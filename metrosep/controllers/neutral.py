"""Neutral table: CSV with declared units, and the JSON sidecar, for controllers without a dialect.

Columns ``position_mm, correction_forward_um[, correction_reverse_um]``, of axes that turn
``position_rad`` and ``_urad``; the entry is the correction c = -e that is added to the command.
"""

from __future__ import annotations

import csv
import io
import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.controllers._plain_text import scaled
from metrosep.controllers.base import (
    Dialect,
    DialectInfo,
    Encoded,
    identity,
    load_sidecar,
    sidecar_path,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError

__all__ = ["Neutral", "map_fields", "require_last_end"]

_POSITIONS = {"position_mm": -3, "position_rad": 0}
_UNITS = ("um", "urad")
_EXPONENT = -6
"""Power of ten of a correction's unit in m or rad."""
_AXES = {
    (False, False): ("X", "X"),
    (True, True): ("C", "C"),
    (True, False): ("C", "Z"),
    (False, True): ("X", "C"),
}
"""Looked up and corrected axis by whether they turn, where no sidecar names them."""


class Neutral(Dialect):
    """Writer and reader of neutral tables; see the module."""

    info = DialectInfo(
        id="csv",
        title="Neutral CSV with JSON sidecar",
        entry="correction c = -e that is added to the command",
        units="position in mm, correction in um; rad and urad of axes that turn; by the column names",
        max_points=None,
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
        columns = [table.positions, table.forward]
        if table.reverse is not None:
            columns.append(table.reverse)
        place = "position_rad" if is_rotary(table.axis) else "position_mm"
        names = [place, *_corrections("urad" if is_rotary(table.compensates) else "um")]
        exponents = (_POSITIONS[place], _EXPONENT, _EXPONENT)
        lines = [",".join(names[: len(columns)])]
        lines += [
            ",".join(_shifted(float(v), -e) for v, e in zip(row, exponents, strict=False))
            for row in zip(*columns, strict=True)
        ]
        return Encoded(("\n".join(lines) + "\n").encode("utf-8"), 0.0)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table."""
        rows = _rows(data, path)
        header = tuple(h.strip() for h in rows[0][1]) if rows else ()
        unit = next(
            (u for u in _UNITS if header[1:] in (_corrections(u), _corrections(u)[:1])), ""
        )
        if not unit or header[0] not in _POSITIONS:
            raise CorruptFileError(
                path,
                "not a neutral table",
                field="header",
                expected=",".join(("position_mm", *_corrections("um"))),
                found=",".join(header)[:80],
            )
        require_last_end(data, path)
        exponents = (_POSITIONS[header[0]], _EXPONENT, _EXPONENT)
        if len(rows) < 3:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows) - 1)
        values = np.array([_numbers(r, i, exponents[: len(header)], path) for i, r in rows[1:]])
        falling = np.flatnonzero(np.diff(values[:, 0]) <= 0)
        if falling.size:
            raise CorruptFileError(
                path,
                f"line {rows[int(falling[0]) + 2][0]}: {header[0]} does not rise",
                hint="sort the lines",
            )
        return CompensationTable(
            positions=values[:, 0],
            forward=values[:, 1],
            reverse=values[:, 2] if len(header) == 3 else None,
            is_exact_inverse=True,
            **_fields(path, float(values[0, 0]), (header[0] == "position_rad", unit == "urad")),
        )


def _corrections(unit: str) -> tuple[str, str]:
    return f"correction_forward_{unit}", f"correction_reverse_{unit}"


def _fields(path: Path, first: float, turns: tuple[bool, bool]) -> dict[str, Any]:
    """Return axes and reference; files of old have mm and um for axes that turn, too."""
    fields = identity(path, first=first)
    table = load_sidecar(path).get("table")
    if not isinstance(table, dict) or "axis" not in table:
        return {**fields, **dict(zip(("axis", "compensates"), _AXES[turns], strict=True))}
    for name, angle in zip(("axis", "compensates"), turns, strict=True):
        if angle and not is_rotary(fields[name]):
            raise CorruptFileError(
                path,
                f"its columns are in rad, its sidecar says {name} {fields[name]}, which does not turn",
                hint="write the table again",
            )
    return fields


def _rows(data: bytes, path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows that are not blank, each with the number of its line."""
    try:
        reader = csv.reader(io.StringIO(data.decode("utf-8-sig")))
        return [(reader.line_num, row) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as exc:
        raise CorruptFileError(path, f"not CSV text ({exc})") from None


def _shifted(value: float, places: int) -> str:
    """Return the shortest decimal of a value times 10^places: exact, unlike a multiplication."""
    return format(Decimal(repr(value)).scaleb(places), "f")


def _numbers(row: list[str], line: int, exponents: tuple[int, ...], path: Path) -> list[float]:
    n = len(exponents)
    words = [v.strip() for v in row]
    values: list[float] = []
    if all(map(NUMBER.fullmatch, words)):
        values = [float(Decimal(v).scaleb(e)) for v, e in zip(words, exponents, strict=False)]
    if len(row) != n or len(values) != n or not np.isfinite(values).all():
        raise CorruptFileError(
            path, f"line {line} does not hold {n} finite numbers but {','.join(row)[:60]!r}"
        )
    return values


# ---- neutral map: CSV in long form with declared units, and the JSON sidecar -------------------
# Columns ``x_mm,y_mm,correction_um``, one line a node, x fastest; an axis that turns has ``_rad``, a
# corrected one that turns ``correction_urad``. The entry is the correction c = -e that is added to the command. Decimals are full: the very numbers of
# the map read back.

_ENTRIES = {False: "correction_um", True: "correction_urad"}
"""By whether the corrected axis turns."""
_CORRECTED = {False: "Z", True: "C"}
"""Its name, where no sidecar tells it."""
_MAP_UNITS = {"mm": 3, "rad": 0}
"""Power of ten of a column over SI."""
_UM = 6
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
"""A decimal as other programs write it, too; Python would also take 1_0 and nan."""
_NAMES = {(False, False): ("X", "Y"), (True, False): ("C", "Y"), (False, True): ("X", "C")}
"""Axes by whether they turn, where no sidecar names them."""


class NeutralMap(Dialect):
    """Writer and reader of neutral maps; see the module."""

    info = DialectInfo(
        id="csv-map",
        title="Neutral CSV of a map with JSON sidecar",
        entry="correction c = -e that is added to the command",
        units="positions in mm, correction in um; rad and urad of axes that turn; by the column names",
        max_points=None,
        outside="that of the nearest edge",
        sign_status="by definition",
        activation=(
            "import it into the controller's own tool and dry-run the sign on the machine",
        ),
        sign="confirmed",
        carries="map",
        directions="one",
        resolution="full precision",
        proof="by definition",
        suffix=".csv",
        page="neutral",
    )

    def encode(self, table: CompensationMap, **options: Any) -> Encoded:
        """Return the CSV, full precision."""
        units = ["rad" if is_rotary(a) else "mm" for a in table.axes]
        columns, rows = (
            [scaled(v, _MAP_UNITS[u]) for v in p]
            for p, u in zip((table.x, table.y), units, strict=True)
        )
        lines = [f"x_{units[0]},y_{units[1]},{_ENTRIES[is_rotary(table.compensates)]}"]
        lines += [
            f"{x},{y},{scaled(c, _UM)}"
            for y, values in zip(rows, table.values, strict=True)
            for x, c in zip(columns, values, strict=True)
        ]
        return Encoded(("\n".join(lines) + "\n").encode("ascii"), 0.0)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map."""
        rows = _map_rows(data, path)
        turns, scales, angle = _header(rows, path)
        require_last_end(data, path)
        values = np.array([_map_numbers(row, line, scales, path) for line, row in rows[1:]])
        x, y = _grid(values, rows, path)
        return CompensationMap(
            x=x,
            y=y,
            values=values[:, 2].reshape(y.size, x.size),
            is_exact_inverse=True,
            **_all_fields(path, x, y, turns, angle=angle),
        )


def _all_fields(
    path: Path, x: FloatArray, y: FloatArray, turns: tuple[bool, bool], *, angle: bool
) -> dict[str, Any]:
    fields = map_fields(path, x, y, turns)
    if "compensates" not in (load_sidecar(path).get("table") or {}):
        return {**fields, "compensates": _CORRECTED[angle]}
    if angle and not is_rotary(fields["compensates"]):
        raise CorruptFileError(
            path,
            f"its corrections are in urad, its sidecar says {fields['compensates']}, which does not turn",
            hint="write the map again",
        )
    return fields


def require_last_end(data: bytes, path: Path) -> None:
    """Refuse a text whose last line has no end: it may have been cut within a number."""
    if not data.endswith((b"\n", b"\r")):
        raise CorruptFileError(
            path,
            "the last line has no end: the file was cut short",
            hint="write it again; if you typed it yourself, end the last line",
        )


def map_fields(
    path: Path, x: FloatArray, y: FloatArray, turns: tuple[bool, bool] = (False, False)
) -> dict[str, Any]:
    """Return what a map's file cannot hold: axes, reference, what is not in it."""
    known = load_sidecar(path).get("table", {})
    zero = [0.0 if p[0] <= 0.0 <= p[-1] else float(p[0]) for p in (x, y)]
    found = known if isinstance(known, dict) else {"axes": known}
    axes: Any = found.get("axes", list(_NAMES.get(turns, ("B", "C"))))
    place: Any = found.get("reference_si", zero)
    right = (
        isinstance(axes, list)
        and len(axes) == 2
        and all(isinstance(a, str) and a.strip() for a in axes)
        and axes[0] != axes[1]
        and tuple(map(is_rotary, axes)) == turns
        and isinstance(place, list)
        and len(place) == 2
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in place)
    )
    if not right:
        raise CorruptFileError(
            sidecar_path(path),
            "this is not the sidecar of the map",
            field="axes, reference_si",
            found=f"{axes!r}, {place!r}"[:60],
            hint="move it away or write the map again",
        )
    return {
        "axes": (axes[0], axes[1]),
        "compensates": str(found.get("compensates", "Z")),
        "reference": (float(place[0]), float(place[1])),
        "removed": "plane" if found.get("not_in_map") == "plane" else "offset",
        "border": "zero" if found.get("border") == "zero" else None,
    }


def _map_rows(data: bytes, path: Path) -> list[tuple[int, list[str]]]:
    """Return the rows that are not blank, each with the number of its line."""
    try:
        reader = csv.reader(io.StringIO(data.decode("utf-8-sig")))
        return [(reader.line_num, [v.strip() for v in row]) for row in reader if row]
    except (UnicodeDecodeError, csv.Error) as exc:
        raise CorruptFileError(path, f"not CSV text ({exc})") from None


def _header(
    rows: list[tuple[int, list[str]]], path: Path
) -> tuple[tuple[bool, bool], tuple[int, ...], bool]:
    """Return which axes turn, the powers of ten of the columns, and whether corrections are angles."""
    header = rows[0][1] if rows else []
    units = [h[2:] for h in header[:2] if h[:2] in ("x_", "y_")]
    good = len(header) == 3 and [h[:2] for h in header[:2]] == ["x_", "y_"]
    if not good or header[2] not in _ENTRIES.values() or any(u not in _MAP_UNITS for u in units):
        raise CorruptFileError(
            path,
            "not a neutral map",
            field="header",
            expected=f"x_mm,y_mm,{_ENTRIES[False]}",
            found=",".join(header)[:80],
        )
    if len(rows) < 5:
        raise CorruptFileError(path, "a map needs at least 4 nodes", found=len(rows) - 1)
    scales = (*(-_MAP_UNITS[u] for u in units), -_UM)
    return (units[0] == "rad", units[1] == "rad"), scales, header[2] == _ENTRIES[True]


def _map_numbers(row: list[str], line: int, scales: tuple[int, ...], path: Path) -> list[float]:
    if len(row) != 3 or not all(map(NUMBER.fullmatch, row)):
        raise CorruptFileError(
            path, f"line {line} does not hold 3 finite numbers but {','.join(row)[:60]!r}"
        )
    values = [float(Decimal(v).scaleb(e)) for v, e in zip(row, scales, strict=True)]
    if not np.isfinite(values).all():
        raise CorruptFileError(path, f"line {line} holds a number that is too large")
    return values


def _grid(
    values: FloatArray, rows: list[tuple[int, list[str]]], path: Path
) -> tuple[FloatArray, FloatArray]:
    """Return the positions of columns and rows; every node stands where it belongs."""
    changes = np.flatnonzero(np.diff(values[:, 1]) != 0.0)
    n = int(changes[0]) + 1 if changes.size else len(values)
    x, y = values[:n, 0], values[::n, 1]
    wanted = np.stack([np.tile(x, y.size), np.repeat(y, n)], axis=1)[: len(values)]
    wrong = np.flatnonzero((values[:, :2] != wanted).any(axis=1))
    if wrong.size:
        raise CorruptFileError(
            path,
            f"line {rows[int(wrong[0]) + 1][0]} is not the next node of a grid",
            hint="x is the fastest, every row holds the same x; no node may be missing or twice",
        )
    if len(values) % n or y.size < 2 or n < 2:
        raise CorruptFileError(
            path,
            f"{len(values)} nodes are no grid of rows of {n}",
            hint="lines are missing at the end: write it again",
        )
    for name, p in (("x", x), ("y", y)):
        if (np.diff(p) <= 0).any():
            raise CorruptFileError(path, f"{name} does not rise", hint="sort the lines")
    return x, y
