"""Neutral map: CSV in long form with declared units, and the JSON sidecar.

Columns ``x_mm,y_mm,correction_um``, one line a node, x fastest; an axis that turns has ``_rad``, a
corrected one that turns ``correction_urad``. The entry is the correction c = -e that is added to the command. Decimals are full: the very numbers of
the map read back.
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
from metrosep.controllers._plain_text import scaled
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, load_sidecar, sidecar_path
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError

__all__ = ["NUMBER", "NeutralMap", "map_fields", "require_last_end"]


_ENTRIES = {False: "correction_um", True: "correction_urad"}
"""By whether the corrected axis turns."""
_CORRECTED = {False: "Z", True: "C"}
"""Its name, where no sidecar tells it."""
_UNITS = {"mm": 3, "rad": 0}
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
            [scaled(v, _UNITS[u]) for v in p]
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
        rows = _rows(data, path)
        turns, scales, angle = _header(rows, path)
        require_last_end(data, path)
        values = np.array([_numbers(row, line, scales, path) for line, row in rows[1:]])
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


def _rows(data: bytes, path: Path) -> list[tuple[int, list[str]]]:
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
    if not good or header[2] not in _ENTRIES.values() or any(u not in _UNITS for u in units):
        raise CorruptFileError(
            path,
            "not a neutral map",
            field="header",
            expected=f"x_mm,y_mm,{_ENTRIES[False]}",
            found=",".join(header)[:80],
        )
    if len(rows) < 5:
        raise CorruptFileError(path, "a map needs at least 4 nodes", found=len(rows) - 1)
    scales = (*(-_UNITS[u] for u in units), -_UM)
    return (units[0] == "rad", units[1] == "rad"), scales, header[2] == _ENTRIES[True]


def _numbers(row: list[str], line: int, scales: tuple[int, ...], path: Path) -> list[float]:
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
