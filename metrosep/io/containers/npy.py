"""NumPy ``.npy`` and ``.npz``: arrays of numbers; never a pickle, and no claim larger than the file."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import column_unit
from metrosep.io.containers.arrays import array_of
from metrosep.io.containers.sheets import matrix_of
from metrosep.io.objects import only_channels
from metrosep.io.registry import BuiltIn, demand, sniffer
from metrosep.io.source import RawFile
from metrosep.io.text import delimited
from metrosep.io.text.measurement import columns_as_object, map_as_surface
from metrosep.io.text.table import ColumnSpec

__all__ = ["channels", "npz", "read", "sniff"]

FORMAT = "npy"


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the name of the one array."""
    return ("array",)


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    sampling_rate: float | str | None = None,
    x: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    scale: float | str | None = None,
    max_pixels: int | None = None,
) -> Surface | Profile | Recording:
    """Return the array as what the caller declares."""
    only_channels(file, "NumPy", channel, ("array",))
    demand(file, "npy")
    values, header = array_of(file, max_pixels)
    if not np.isfinite(values).any():
        raise file.corrupt("the array holds no number")
    if values.ndim == 2 and sampling_rate is None and x is None and z is None:
        return map_as_surface(
            file,
            FORMAT,
            values,
            name="array",
            own_unit=None,
            unit=unit,
            lateral_step=lateral_step,
            scale=scale,
            header=header,
        )
    table = values[:, None] if values.ndim == 1 else values
    columns = {f"column{i + 1}": (table[:, i], None) for i in range(table.shape[1])}
    options = {"lateral_step": lateral_step, "unit": unit, "x": x, "z": z, "scale": scale}
    return columns_as_object(file, FORMAT, columns, header, sampling_rate=sampling_rate, **options)


# ---- ``.npz``: a matrix alone is a map, arrays of one length are the columns of a table ----------------

_NPZ = "npz"


@functools.wraps(delimited.read)
def _npz_read(
    file: RawFile, *, lateral_step: Any = None, unit: Any = None, **options: Any
) -> Surface | Profile | Recording | RunSet:
    """Return the map of one matrix, or what arrays of one length hold as the columns of a table."""
    demand(file, _NPZ)
    sheet, scale = options.get("sheet"), options.get("scale")
    given = {k for k, v in options.items() if v is not None} - {"sheet", "scale"}
    found = None if given else matrix_of(file, sheet)
    if found is None:
        return delimited.read(file, lateral_step=lateral_step, unit=unit, **options)
    name, values = found
    if not np.isfinite(values).any():
        raise file.corrupt(f"array {name!r} holds no number")
    return map_as_surface(
        file,
        _NPZ,
        values,
        name=name,
        own_unit=column_unit(name)[1],
        unit=unit,
        lateral_step=lateral_step,
        scale=scale,
        header={"array": name, "shape": list(values.shape)},
    )


npz = BuiltIn(sniffer(_NPZ), delimited.channels, _npz_read)
