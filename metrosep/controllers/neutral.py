"""Neutral table: CSV with declared units, and the JSON sidecar, for controllers without a dialect.

Columns ``position_mm, correction_forward_um[, correction_reverse_um]``, of axes that turn
``position_rad`` and ``_urad``; the entry is the correction c = -e that is added to the command.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, identity, load_sidecar
from metrosep.controllers.neutral_map import NUMBER, require_last_end
from metrosep.core.errors import CorruptFileError

__all__ = ["Neutral"]


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
