"""NumPy ``.npy`` and ``.npz``: arrays of numbers; never a pickle, and no claim larger than the file."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import AmbiguousFormatError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import column_unit
from metrosep.io._roles import ColumnSpec
from metrosep.io.containers.arrays import array_of
from metrosep.io.containers.sheets import matrix_of
from metrosep.io.objects import only_channels
from metrosep.io.registry import BuiltIn, demand, sniffer
from metrosep.io.source import RawFile
from metrosep.io.text import delimited
from metrosep.io.text.matrices import declared_units
from metrosep.io.text.measurement import FEW_COLUMNS, columns_as_object, map_as_surface

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
    time: ColumnSpec | None = None,
    scale: float | str | None = None,
    max_pixels: int | None = None,
    row_order: str | None = None,
) -> Surface | Profile | Recording:
    """Return the array as what the caller declares; columns have numbers from 1, as in a text without names."""
    only_channels(file, "NumPy", channel, ("array",))
    demand(file, "npy")
    values, header = array_of(file, max_pixels)
    if not np.isfinite(values).any():
        raise file.corrupt("the array holds no number")
    unit = declared_units(unit)
    declared = any(v is not None for v in (sampling_rate, x, z, time)) or _is_of_columns(unit)
    if values.ndim == 2 and not declared:
        _refuse_columns(file, "array", values, lateral_step)
        return map_as_surface(
            file,
            FORMAT,
            values,
            name="array",
            own_unit=None,
            unit=unit,
            lateral_step=lateral_step,
            scale=scale,
            row_order=row_order,
            header=header,
        )
    table = values[:, None] if values.ndim == 1 else values
    columns = {f"column{i + 1}": (table[:, i], None) for i in range(table.shape[1])}
    header["named"] = False
    options = {"lateral_step": lateral_step, "unit": unit, "x": x, "z": z, "time": time}
    options |= {"scale": scale, "sampling_rate": sampling_rate, "row_order": row_order}
    return columns_as_object(file, FORMAT, columns, header, **options)


def _is_of_columns(unit: Any) -> bool:
    """Return whether units are declared for each column, not one for a map."""
    return unit is not None and not isinstance(unit, str)


def _refuse_columns(file: RawFile, name: str, values: NDArray[Any], lateral_step: Any) -> None:
    """Refuse to take few columns of many rows for a map without a step: nothing says that they are one."""
    rows, columns = values.shape
    if lateral_step is None and columns <= FEW_COLUMNS < rows:
        each = ",".join(["mm", *["um"] * (columns - 1)])
        raise AmbiguousFormatError(
            f"{file.path}: {name!r} holds {rows} x {columns} numbers, which may be columns or a map: for columns "
            f"give unit={each!r} (yours), x='1:mm' and z='2:um', or sampling_rate=; for a map give unit= and "
            "lateral_step="
        )


# ---- ``.npz``: a matrix alone is a map, arrays of one length are the columns of a table ----------------

_NPZ = "npz"


@functools.wraps(delimited.read)
def _npz_read(
    file: RawFile, *, lateral_step: Any = None, unit: Any = None, **options: Any
) -> Surface | Profile | Recording | RunSet:
    """Return the map of one matrix, or what arrays of one length hold as the columns of a table."""
    demand(file, _NPZ)
    unit = declared_units(unit)
    sheet, scale = options.get("sheet"), options.get("scale")
    given = {k for k, v in options.items() if v is not None} - {"sheet", "scale", "row_order"}
    found = None if given or _is_of_columns(unit) else matrix_of(file, sheet)
    if found is None:
        return delimited.read(file, lateral_step=lateral_step, unit=unit, **options)
    name, values = found
    if column_unit(name)[1] is None:
        _refuse_columns(file, name, values, lateral_step)
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
        row_order=options.get("row_order"),
        header={"array": name, "shape": list(values.shape)},
    )


npz = BuiltIn(sniffer(_NPZ), delimited.channels, _npz_read)
