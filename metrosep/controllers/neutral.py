"""Neutral table: CSV with declared units, and the JSON sidecar, for controllers without a dialect.

Columns ``position_mm, correction_forward_um[, correction_reverse_um]``; the entry is the correction
c = -e that is added to the command.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.limits import Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import DialectInfo, Encoded, load_sidecar
from metrosep.core.errors import CorruptFileError, DataError

__all__ = ["Neutral"]

FloatArray = NDArray[np.float64]

_MM, _UM = 1e-3, 1e-6
_COLUMNS = ("position_mm", "correction_forward_um", "correction_reverse_um")


class Neutral:
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
    )

    def limits(self, **machine: Any) -> Limits:
        """Return the limits of the machine.

        Parameters
        ----------
        **machine
            Fields of `Limits`.

        Returns
        -------
        Limits
            As given.

        Raises
        ------
        DataError
            If a keyword is unknown.
        """
        try:
            return Limits(**machine)
        except TypeError as exc:
            raise DataError(f"unknown machine limit: {exc}") from None

    def encode(self, table: CompensationTable, **machine: Any) -> Encoded:
        """Return the CSV, full precision.

        Parameters
        ----------
        table : CompensationTable
            Any.
        **machine
            Not used by the format.

        Returns
        -------
        Encoded
            UTF-8, LF.
        """
        columns = [table.positions / _MM, table.forward / _UM]
        if table.reverse is not None:
            columns.append(table.reverse / _UM)
        lines = [",".join(_COLUMNS[: len(columns)])]
        lines += [",".join(repr(float(v)) for v in row) for row in zip(*columns, strict=True)]
        worst = float(np.abs(np.array(columns[1]) * _UM - table.forward).max())
        return Encoded(("\n".join(lines) + "\n").encode("utf-8"), worst)

    def decode(self, data: bytes, path: Path) -> CompensationTable:
        """Return the table.

        Parameters
        ----------
        data : bytes
            Content of the file.
        path : Path
            Its name, for messages and the sidecar.

        Returns
        -------
        CompensationTable
            With axis and reference from the sidecar where there is one.

        Raises
        ------
        CorruptFileError
            If header or numbers are not those of the format.
        """
        try:
            rows = list(csv.reader(io.StringIO(data.decode("utf-8-sig"))))
        except (UnicodeDecodeError, csv.Error) as exc:
            raise CorruptFileError(path, f"not CSV text ({exc})") from None
        header = tuple(h.strip() for h in rows[0])
        if header not in (_COLUMNS, _COLUMNS[:2]):
            raise CorruptFileError(
                path,
                "not a neutral table",
                field="header",
                expected=",".join(_COLUMNS),
                found=",".join(header)[:80],
            )
        values = np.array(
            [_numbers(r, i, len(header), path) for i, r in enumerate(rows[1:], 2) if r]
        )
        if values.shape[0] < 2:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=values.shape[0])
        if (np.diff(values[:, 0]) <= 0).any():
            i = int(np.flatnonzero(np.diff(values[:, 0]) <= 0)[0])
            raise CorruptFileError(
                path, f"line {i + 3}: position_mm does not rise", hint="sort the lines"
            )
        beside = load_sidecar(path).get("table", {})
        axis = str(beside.get("axis", "X"))
        return CompensationTable(
            positions=values[:, 0] * _MM,
            forward=values[:, 1] * _UM,
            reverse=values[:, 2] * _UM if len(header) == 3 else None,
            axis=axis,
            compensates=str(beside.get("compensates", axis)),
            reference=float(beside.get("reference_m", values[0, 0] * _MM)),
            removed="line" if beside.get("not_in_table") == "line" else "offset",
            is_exact_inverse=True,
        )


def _numbers(row: list[str], line: int, n: int, path: Path) -> list[float]:
    try:
        values = [float(v) for v in row]
    except ValueError:
        values = []
    if len(values) != n or not np.isfinite(values).all():
        raise CorruptFileError(
            path, f"line {line} does not hold {n} finite numbers but {','.join(row)[:60]!r}"
        )
    return values
