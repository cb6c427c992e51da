"""Even positions for formats that hold a first position and a step, and a map's sidecar."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.uniform import is_uniform, resample_uniform, resampling_error
from metrosep.controllers._along import format_span
from metrosep.controllers.base import load_sidecar, sidecar_path
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, LimitError, TableError
from metrosep.core.units import format_length

__all__ = [
    "even_map",
    "even_positions",
    "even_table",
    "map_identity",
]


_WHOLE = 1e-9
"""A span is a whole number of spacings, but for rounding."""

_MAX_POINTS = 1_000_000
"""Not a limit of a controller: beyond it a spacing has the wrong unit."""

_FARTHEST = 1e6
"""No axis is as long, in m or rad."""


def even_positions(
    positions: FloatArray, spacing: float | None, name: str, axis: str
) -> FloatArray:
    """Return the positions themselves, or even ones from first to last."""
    if spacing is None:
        if is_uniform(positions):
            return positions
        steps = np.diff(positions)
        raise TableError(
            f"the file needs uniform positions of {axis}, these lie "
            f"{format_span(axis, float(steps.min()), digits=9)} to "
            f"{format_span(axis, float(steps.max()), digits=9)} apart ({_between(axis, steps)} between "
            f"them); give {name}='...' to resample them"
        )
    span = float(positions[-1] - positions[0])
    if not span / spacing < _MAX_POINTS:
        raise LimitError(f"{name} gives {span / spacing:.3g} positions of {axis}; check its unit")
    count = max(math.ceil(span / spacing - _WHOLE), 1)
    return np.linspace(positions[0], positions[-1], count + 1)


def _between(axis: str, steps: FloatArray) -> str:
    difference = float(np.ptp(steps))
    if is_rotary(axis):
        return format_span(axis, difference, digits=3)
    return format_length(difference, digits=3)


def even_table(
    table: CompensationTable, spacing: float | None, name: str = "spacing"
) -> tuple[CompensationTable, float]:
    """Return a table at even positions, and how far that takes it off."""
    p = even_positions(table.positions, spacing, name, table.axis)
    step = float(p[-1] - p[0]) / (p.size - 1)
    carried = resample_uniform(table, start=float(p[0]), step=step, n=p.size)
    return carried, resampling_error(table, carried)


def even_map(
    table: CompensationMap, spacings: tuple[float | None, float | None], names: tuple[str, str]
) -> tuple[CompensationMap, float]:
    """Return a map at even positions, and how far that takes it off."""
    x = even_positions(table.x, spacings[0], names[0], table.axes[0])
    y = even_positions(table.y, spacings[1], names[1], table.axes[1])
    if x is table.x and y is table.y:
        return table, 0.0
    carried = replace(table, x=x, y=y, values=table.correction(x, y[:, None]), u=None)
    px, py = np.union1d(x, table.x), np.union1d(y, table.y)[:, None]
    return carried, float(np.abs(carried.correction(px, py) - table.correction(px, py)).max())


def map_identity(
    path: Path, *, axes: tuple[str, str], compensates: str, first: tuple[float, float]
) -> dict[str, Any]:
    """Return what a map's file cannot hold: axes, reference, what is not in it."""
    told = load_sidecar(path).get("table")
    if told is None:
        return {"axes": axes, "compensates": compensates, "reference": first}
    names = told.get("axes") if isinstance(told, dict) else None
    place = told.get("reference_si") if isinstance(told, dict) else None
    fits = (
        isinstance(names, list)
        and isinstance(place, list)
        and len(names) == len(place) == 2
        and all(isinstance(v, int | float) and abs(v) < _FARTHEST for v in place)
    )
    if names is None or place is None or not fits:
        raise CorruptFileError(
            sidecar_path(path),
            "this is not the sidecar of a map",
            field="table",
            expected="axes and reference_si of two axes",
            found=repr(told)[:40],
            hint="move it away or write the map again",
        )
    return {
        "axes": (str(names[0]), str(names[1])),
        "compensates": str(told.get("compensates", compensates)),
        "reference": (float(place[0]), float(place[1])),
        "removed": "plane" if told.get("not_in_map") == "plane" else "offset",
    }
