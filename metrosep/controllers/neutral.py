"""Neutral table: CSV with declared units, and the JSON sidecar, for controllers without a dialect.

Columns ``position_mm, correction_forward_um[, correction_reverse_um]``; the entry is the correction
c = -e that is added to the command.
"""

from __future__ import annotations

import csv
import io
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, identity
from metrosep.core.errors import CorruptFileError

__all__ = ["Neutral"]

FloatArray = NDArray[np.float64]

_COLUMNS = ("position_mm", "correction_forward_um", "correction_reverse_um")
_EXPONENTS = (-3, -6, -6)
"""Power of ten of each column's unit in m."""


class Neutral(Dialect):
    """Writer and reader of neutral tables; see the module."""

    info = DialectInfo(
        id="csv",
        title="Neutral CSV with JSON sidecar",
        entry="correction c = -e that is added to the command",
        units="position in mm, correction in um, by the column names",
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
        """Return the CSV, full precision.

        Parameters
        ----------
        table : CompensationTable
            Any.
        **options
            None.

        Returns
        -------
        Encoded
            UTF-8, LF.
        """
        columns = [table.positions, table.forward]
        if table.reverse is not None:
            columns.append(table.reverse)
        lines = [",".join(_COLUMNS[: len(columns)])]
        lines += [
            ",".join(_shifted(float(v), -e) for v, e in zip(row, _EXPONENTS, strict=False))
            for row in zip(*columns, strict=True)
        ]
        return Encoded(("\n".join(lines) + "\n").encode("utf-8"), 0.0)

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationTable:
        """Return the table.

        Parameters
        ----------
        data : bytes
            Content of the file.
        path : Path
            Its name, for messages and the sidecar.
        **options
            None.

        Returns
        -------
        CompensationTable
            With axis and reference from the sidecar where there is one.

        Raises
        ------
        CorruptFileError
            If header or numbers are not those of the format.
        """
        rows = _rows(data, path)
        header = tuple(h.strip() for h in rows[0][1]) if rows else ()
        if header not in (_COLUMNS, _COLUMNS[:2]):
            raise CorruptFileError(
                path,
                "not a neutral table",
                field="header",
                expected=",".join(_COLUMNS),
                found=",".join(header)[:80],
            )
        if len(rows) < 3:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows) - 1)
        values = np.array([_numbers(r, i, len(header), path) for i, r in rows[1:]])
        falling = np.flatnonzero(np.diff(values[:, 0]) <= 0)
        if falling.size:
            raise CorruptFileError(
                path,
                f"line {rows[int(falling[0]) + 2][0]}: position_mm does not rise",
                hint="sort the lines",
            )
        return CompensationTable(
            positions=values[:, 0],
            forward=values[:, 1],
            reverse=values[:, 2] if len(header) == 3 else None,
            is_exact_inverse=True,
            **identity(path, first=float(values[0, 0])),
        )


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


def _numbers(row: list[str], line: int, n: int, path: Path) -> list[float]:
    try:
        values = [
            float(Decimal(v.strip()).scaleb(e)) for v, e in zip(row, _EXPONENTS, strict=False)
        ]
    except (ArithmeticError, ValueError):
        values = []
    if len(row) != n or len(values) != n or "_" in "".join(row) or not np.isfinite(values).all():
        raise CorruptFileError(
            path, f"line {line} does not hold {n} finite numbers but {','.join(row)[:60]!r}"
        )
    return values
