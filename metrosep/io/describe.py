"""`describe`: what is in a file, as plain values for ``metrosep info`` and its JSON.

Unlike `read` it also answers for a table of repeated runs or of unnamed columns, by listing the
columns instead of making an object of them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core.errors import FormatMismatchError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.text_options import TEXT_OPTIONS
from metrosep.io.read import read, recognise
from metrosep.io.registry import principal
from metrosep.io.source import RawFile, open_file
from metrosep.io.table import Table, read_table

__all__ = ["describe"]


def describe(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002
    **options: Any,
) -> dict[str, Any]:
    """Return what a file holds as plain values that JSON can carry."""
    file = open_file(path)
    if format is None:
        file = principal(file)
    description = recognise(file, format, options)
    try:
        if description.id == "metrosep-h5" and not options:
            own = description.load_reader().read(file)
            if isinstance(own, RunSet):
                return _of_runs(file, own)
        obj = read(file.path, format=description.id, **options)
    except FormatMismatchError:
        if description.id != "delimited" or any(k in options for k in ("x", "y", "z", "time")):
            raise
        table = read_table(file, **{k: v for k, v in options.items() if k in TEXT_OPTIONS})
        return _of_table(file, table)
    heights = None if isinstance(obj, Recording) else obj.z
    dx, dy = _steps(obj)
    return {
        **_of_recording(obj),
        "format": description.id,
        "kind": type(obj).__name__.lower(),
        "shape": _shape(obj),
        "dx_m": dx,
        "dy_m": dy,
        "n_invalid": _invalid(obj),
        "pv_nm": None if isinstance(obj, Recording) else _nm(obj.peak_to_valley()),
        "sq_nm": None if isinstance(obj, Recording) else _nm(obj.rms()),
        "mean_nm": None if heights is None else _nm(float(np.nanmean(heights))),
        "sha256": file.sha256,
        "metadata": _plain(obj.metadata),
    }


def _of_runs(file: RawFile, runs: RunSet) -> dict[str, Any]:
    readings = np.concatenate([run.z for run in runs])
    return {
        "format": "metrosep-h5",
        "kind": "runs",
        "shape": [len(runs), int(readings.size)],
        "dx_m": None,
        "dy_m": None,
        "n_invalid": int(np.isnan(readings).sum()),
        "pv_nm": _nm(float(np.nanmax(readings) - np.nanmin(readings))),
        "sq_nm": _nm(float(np.nanstd(readings))),
        "mean_nm": _nm(float(np.nanmean(readings))),
        "sha256": file.sha256,
        "metadata": _plain({**runs.metadata, "feeds_m_s": runs.feeds}),
    }


def _of_recording(obj: Surface | Profile | Recording) -> dict[str, Any]:
    if not isinstance(obj, Recording):
        return {}
    step = float(np.median(np.diff(obj.t))) if len(obj) > 1 else 0.0
    return {
        "channels": {name: obj.units.get(name, "") for name in obj.channels},
        "duration_s": obj.duration,
        "time_step_s": step,
    }


def _of_table(file: RawFile, table: Table) -> dict[str, Any]:
    columns = [
        {
            "name": c.name,
            "unit": None if c.unit is None else c.unit.name,
            "type": "label" if c.values is None else "number",
        }
        for c in table.columns
    ]
    header = {k: v for k, v in table.header.items() if k != "columns"}
    metadata = {
        "columns": columns,
        "warnings": table.warnings,
        "header": header,
        "lines": table.ledger,
    }
    return {
        "format": "delimited",
        "kind": "table",
        "shape": [len(table), len(table.columns)],
        "dx_m": None,
        "dy_m": None,
        "n_invalid": sum(
            int(np.isnan(c.values).sum()) for c in table.columns if c.values is not None
        ),
        "pv_nm": None,
        "sq_nm": None,
        "mean_nm": None,
        "sha256": file.sha256,
        "metadata": _plain(metadata),
    }


def _steps(obj: Surface | Profile | Recording) -> tuple[float | None, float | None]:
    if isinstance(obj, Surface):
        return obj.dx, obj.dy
    if isinstance(obj, Profile) and obj.is_uniform:
        return obj.dx, None
    return None, None


def _shape(obj: Surface | Profile | Recording) -> list[int]:
    if isinstance(obj, Surface):
        return list(obj.shape)
    return [len(obj)] if isinstance(obj, Profile) else [len(obj), len(obj.channels)]


def _invalid(obj: Surface | Profile | Recording) -> int:
    if isinstance(obj, Recording):
        return sum(int(np.isnan(c).sum()) for c in obj.channels.values())
    return obj.n_invalid


def _nm(value: float) -> float | None:
    return value * 1e9 if math.isfinite(value) else None


def _plain(value: Any) -> Any:
    """Return a value that strict JSON can carry: no NaN, no tuples, no numpy."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)
