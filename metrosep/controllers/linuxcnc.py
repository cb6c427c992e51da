"""LinuxCNC screw compensation, ``COMP_FILE_TYPE = 0``.

Each line is ``nominal forward reverse``: the position that is commanded and the positions that
the axis really reaches moving in + and - direction. The entry for an error e is therefore
``p + e``, and LinuxCNC adds ``nominal - entry`` = -e to the motor command. Confirmed by running the
controller (tests/acceptance/linuxcnc). The file holds bare triples and nothing else: LinuxCNC
stops at the first other line without a word.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.compensation.limits import Limits
from metrosep.compensation.table import CompensationTable
from metrosep.controllers.base import DialectInfo, Encoded, load_sidecar
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError

__all__ = ["MAX_POINTS", "LinuxCNC"]

FloatArray = NDArray[np.float64]

MAX_POINTS = 256
"""Entries per joint (motion.h of LinuxCNC 2.9); the 257th is ignored with an error."""

_MM = 1e-3
_DECIMALS = 8
"""Decimals of a position in mm: 10 fm, below the float32 in which the trim is kept."""


class LinuxCNC:
    """Writer and reader of type-0 files; see the module."""

    info = DialectInfo(
        id="linuxcnc",
        title="LinuxCNC screw compensation, type 0",
        entry="position actually reached: p + e, so that nominal - entry = -e is added",
        units="mm (machine units of the configuration)",
        max_points=MAX_POINTS,
        outside="constant beyond both ends",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "copy the file beside the INI file",
            "in [JOINT_n] of the axis set COMP_FILE_TYPE = 0 and COMP_FILE = <name of the file>",
            "BACKLASH of that joint is ignored from now on: the reverse column holds lost motion",
            "restart LinuxCNC, home, and read joint.n.motor-pos-cmd minus joint.n.pos-cmd",
        ),
    )

    def limits(self, **machine: Any) -> Limits:
        """Return the limits; see `metrosep.compensation.limits.Limits` for the keywords.

        Parameters
        ----------
        **machine
            Fields of `Limits`.

        Returns
        -------
        Limits
            With the controller's number of points.

        Raises
        ------
        DataError
            If a keyword is unknown.
        """
        try:
            return Limits(**{"max_points": MAX_POINTS, **machine})
        except TypeError as exc:
            raise DataError(f"unknown machine limit: {exc}") from None

    def encode(self, table: CompensationTable, **machine: Any) -> Encoded:
        """Return bare triples.

        Parameters
        ----------
        table : CompensationTable
            With axis and compensated axis the same.
        **machine
            Not used by the format.

        Returns
        -------
        Encoded
            ASCII, LF, eight decimals of a millimetre.

        Raises
        ------
        TableError
            If the table corrects another axis than the one it looks up.
        LimitError
            If there are more than 256 points.
        """
        if not table.is_on_axis:
            raise TableError(
                f"a LinuxCNC compensation file corrects its own joint, this table is {table.axis} -> "
                f"{table.compensates}; mount the correction on {table.compensates} by another carrier "
                "or write controller='csv'"
            )
        n = table.positions.size
        if n > MAX_POINTS:
            raise LimitError(
                f"{n} points, LinuxCNC takes {MAX_POINTS} per joint; use a spacing of at least "
                f"{(table.span[1] - table.span[0]) / (MAX_POINTS - 1) * 1e3:.4g} mm"
            )
        reverse = table.forward if table.reverse is None else table.reverse
        columns = np.column_stack(
            [table.positions, table.positions - table.forward, table.positions - reverse]
        )
        printed = [[f"{v / _MM:.{_DECIMALS}f}" for v in row] for row in columns]
        back = np.array([[float(v) for v in row] for row in printed]) * _MM
        if (np.diff(back[:, 0]) <= 0).any():
            raise TableError(f"positions closer than 1e-{_DECIMALS} mm cannot be written")
        trims = back[:, :1] - back[:, 1:]
        wanted = np.column_stack([table.forward, reverse])
        text = "".join(" ".join(row) + "\n" for row in printed)
        return Encoded(
            data=text.encode("ascii"),
            quantisation=float(np.abs(trims - wanted).max()),
            notes={"ini": ["COMP_FILE_TYPE = 0", "COMP_FILE = <this file>"]},
        )

    def decode(self, data: bytes, path: Path) -> CompensationTable:
        """Return the table, refusing whatever LinuxCNC would silently drop.

        Parameters
        ----------
        data : bytes
            Content of the file.
        path : Path
            Its name, for messages and the sidecar.

        Returns
        -------
        CompensationTable
            Corrections ``nominal - entry``.

        Raises
        ------
        CorruptFileError
            If a line is not three finite numbers or positions do not rise.
        LimitError
            If there are more than 256 lines.
        """
        rows = [
            _triple(line, number, path)
            for number, line in enumerate(_text(data, path).splitlines(), start=1)
        ]
        table = np.array(rows)
        falling = np.flatnonzero(np.diff(table[:, 0]) <= 0)
        if falling.size:
            raise CorruptFileError(
                path,
                f"line {int(falling[0]) + 2}: the nominal position does not rise; LinuxCNC would drop "
                "this line and use the rest",
                hint="sort the lines",
            )
        if len(rows) > MAX_POINTS:
            raise LimitError(
                f"{path}: {len(rows)} lines, LinuxCNC uses the first {MAX_POINTS} and ignores the rest"
            )
        if len(rows) < 2:
            raise CorruptFileError(path, "a table needs at least 2 lines", found=len(rows))
        forward, reverse = (table[:, 0] - table[:, 1]) * _MM, (table[:, 0] - table[:, 2]) * _MM
        beside = load_sidecar(path).get("table", {})
        axis = str(beside.get("axis", "X"))
        return CompensationTable(
            positions=table[:, 0] * _MM,
            forward=forward,
            reverse=None if np.array_equal(forward, reverse) else reverse,
            axis=axis,
            compensates=axis,
            reference=float(beside.get("reference_m", table[0, 0] * _MM)),
            removed="line" if beside.get("not_in_table") == "line" else "offset",
            is_exact_inverse=True,
        )


def _text(data: bytes, path: Path) -> str:
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not ASCII text", offset=exc.start, hint="this is no LinuxCNC compensation file"
        ) from None


def _triple(line: str, number: int, path: Path) -> tuple[float, float, float]:
    words = line.split()
    try:
        values = tuple(float(w) for w in words)
    except ValueError:
        values = ()
    if len(values) != 3 or not np.isfinite(values).all():
        raise CorruptFileError(
            path,
            f"line {number} is not three numbers but {line[:60]!r}; LinuxCNC would stop reading here "
            "without a word",
            hint="write nothing but 'nominal forward reverse' lines: no header, comma or blank line",
        )
    return values
