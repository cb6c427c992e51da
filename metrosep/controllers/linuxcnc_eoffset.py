"""LinuxCNC: a map over two axes as an external offset of a third, such as Z over X and Y.

The file is a program for HAL, a component that looks the map up at the commanded positions and sends
the correction to ``axis.z.eoffset-counts``; LinuxCNC ramps the offset within the share of velocity
and acceleration that OFFSET_AV_RATIO leaves it. Confirmed by running the controller
(tests/acceptance/linuxcnc).
"""

from __future__ import annotations

import itertools
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import bilinear
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers._eoffset_component import LETTERS, Grid, grid_of, printed
from metrosep.controllers._lookups import one_way
from metrosep.controllers.base import Dialect, DialectInfo, Encoded, Simulator, load_sidecar
from metrosep.controllers.options import Option
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, DataError, LimitError, TableError

__all__ = ["LinuxCNCEoffset"]


_MM = 1e-3
_DECIMALS = 10
"""Decimals of a position in mm: 0.1 pm."""
_MAX_COUNTS = 2**31 - 1
"""eoffset-counts is a signed integer of 32 bits."""
_MAX_NODES = 100_000
"""More have never been tried; the program is read by Python at every start."""


class LinuxCNCEoffset(Dialect):
    """Writer and reader of HAL components with a map; see the module."""

    info = DialectInfo(
        id="linuxcnc-eoffset",
        title="LinuxCNC map over two axes, external offset through a HAL component",
        entry="correction added to the axis, in counts: -e / count",
        units="whole counts of eoffset-scale; positions in mm (machine units of the configuration)",
        max_points=_MAX_NODES,
        outside="that of the nearest edge",
        sign_status="confirmed by running LinuxCNC 2.9",
        activation=(
            "copy the file beside the INI file, readable by the user who runs LinuxCNC",
            "set OFFSET_AV_RATIO in [AXIS_n] of the corrected axis as the head of the file says",
            "copy the lines in the head of the file into a HAL file that is read after motmod is loaded",
            "connect comp-map.fault to what stops the machine: LinuxCNC did not take what was sent",
            "restart LinuxCNC, home: the offset appears only when the machine is on and homed",
            "move and read axis.<letter>.eoffset: the correction in mm",
        ),
        sign="confirmed",
        carries="map",
        directions="one",
        resolution="0.1 nm as written by default, and LinuxCNC stops 0.001 a T^2 before the target",
        reference_rule="zero at the machine zero of both axes; nothing acts before homing",
        proof="LinuxCNC 2.9 itself, headless",
        suffix=".py",
        page="linuxcnc",
    )

    options = (
        Option(
            "count",
            "length of a count, written to eoffset-scale; at most 1 nm",
            "length",
            default=1e-10,
            positive=True,
            lowest=1e-13,
            highest=1.000001e-9,
        ),
        Option(
            "av_ratio",
            "share of velocity and acceleration that the offset takes from the axis",
            "number",
            default=0.1,
            lowest=0.001,
            highest=0.9,
        ),
        Option(
            "period",
            "time between two look-ups, not below the servo period",
            "time",
            default=2e-3,
            positive=True,
            lowest=1e-4,
            highest=0.1,
        ),
    )

    def encode(
        self,
        table: CompensationMap,
        *,
        count: float = 1e-10,
        av_ratio: float = 0.1,
        period: float = 2e-3,
        **options: Any,
    ) -> Encoded:
        """Return the program with the map in it."""
        letters = [*table.axes, table.compensates]
        wrong = [a for a in letters if a not in tuple(LETTERS)]
        if wrong:
            raise TableError(
                f"{wrong[0]!r} is no linear axis of LinuxCNC ({', '.join(LETTERS)}); a map over a "
                "rotary axis can go along in the tool path"
            )
        if table.values.size > _MAX_NODES:
            raise LimitError(
                f"{table.values.size} nodes, at most {_MAX_NODES}: use a coarser grid"
            )
        step = printed(count / _MM, 16)
        unit = float(step) * _MM
        counts = [[round(v / unit) for v in row] for row in table.values.tolist()]
        _check_counts(table, counts, unit)
        grid = Grid(
            axes=(letters[0], letters[1], letters[2]),
            count=step,
            period=printed(period, 6),
            ratio=printed(av_ratio, 6),
            x=_positions(table.x, letters[0]),
            y=_positions(table.y, letters[1]),
            counts=tuple(tuple(row) for row in counts),
        )
        back = np.array(counts, dtype=np.float64) * unit
        return Encoded(
            data=grid.text().encode("ascii"),
            # what is between the nodes is rounded to whole counts once more
            quantisation=float(np.abs(back - table.values).max()) + 0.5 * unit,
            step=unit,
            notes={"hal": grid.hal_lines(), "ini": grid.ini_lines()},
        )

    def decode(self, data: bytes, path: Path, **options: Any) -> CompensationMap:
        """Return the map, refusing a program that is not the one that was proven."""
        grid = _checked(data, path, options)
        unit = float(grid.count) * _MM
        x, y = (np.array([float(v) * _MM for v in p]) for p in (grid.x, grid.y))
        return CompensationMap(
            x=x,
            y=y,
            values=np.array(grid.counts, dtype=np.float64) * unit,
            axes=grid.axes[:2],
            compensates=grid.axes[2],
            is_exact_inverse=True,
            **_identity(path, (float(x[0]), float(x[-1])), (float(y[0]), float(y[-1]))),
        )

    def lookup(self, data: bytes, path: Path, **options: Any) -> Simulator:
        """Return what the component sends: bilinear between the nodes, in whole counts."""
        grid = _checked(data, path, options)
        unit = float(grid.count) * _MM
        x, y = (np.array([float(v) for v in p]) for p in (grid.x, grid.y))
        counts = np.array(grid.counts, dtype=np.float64)

        def over(px: FloatArray, py: FloatArray) -> FloatArray:
            found = bilinear(x, y, counts, px / _MM, py / _MM).reshape(px.shape)
            return np.asarray(np.rint(found) * unit)

        return one_way(over, 2)


def _positions(values: FloatArray, axis: str) -> tuple[Decimal, ...]:
    found = tuple(printed(v / _MM, _DECIMALS) for v in values.tolist())
    if any(b <= a for a, b in itertools.pairwise(found)):
        raise TableError(f"positions of {axis} closer than 1e-{_DECIMALS} mm cannot be written")
    return found


def _check_counts(table: CompensationMap, counts: list[list[int]], unit: float) -> None:
    for j, row in enumerate(counts):
        for i, value in enumerate(row):
            if abs(value) > _MAX_COUNTS:
                raise LimitError(
                    f"the correction {table.values[j, i] * 1e3:.6g} mm at {table.axes[0]} = "
                    f"{table.x[i] * 1e3:.6g} mm, {table.axes[1]} = {table.y[j] * 1e3:.6g} mm is "
                    f"{value} counts, LinuxCNC takes 32 bits: at most {_MAX_COUNTS * unit * 1e3:.6g} "
                    "mm; use a larger count=, or check the units of the error"
                )


def _checked(data: bytes, path: Path, options: dict[str, Any]) -> Grid:
    """Return the grid of a file, checked against options that were given."""
    grid = grid_of(data, path)
    if max(abs(v) for row in grid.counts for v in row) > _MAX_COUNTS:
        raise LimitError(f"{path}: an entry exceeds 32 bits; write the map with a larger count=")
    said = {
        "count": float(grid.count) * _MM,
        "av_ratio": float(grid.ratio),
        "period": float(grid.period),
    }
    for name, found in said.items():
        value = options.get(name)
        if value is not None and abs(value - found) > 1e-3 * found:
            raise DataError(f"{path}: {name} is {found:.6g} in the file, not {value:.6g} (SI)")
    return grid


def _identity(path: Path, x: tuple[float, float], y: tuple[float, float]) -> dict[str, Any]:
    """Return what the program does not hold: reference, what is not in the map, its border."""
    known = load_sidecar(path).get("table", {})
    default = [0.0 if low <= 0.0 <= high else low for low, high in (x, y)]
    reference = known.get("reference_si", default) if isinstance(known, dict) else None
    if not (
        isinstance(reference, list)
        and len(reference) == 2
        and all(isinstance(v, int | float) and not isinstance(v, bool) for v in reference)
    ):
        raise CorruptFileError(
            path, "its sidecar is not that of a map", field="reference_si", found=reference
        )
    return {
        "reference": (float(reference[0]), float(reference[1])),
        "removed": "plane" if known.get("not_in_map") == "plane" else "offset",
        "border": "zero" if known.get("border") == "zero" else None,
    }
