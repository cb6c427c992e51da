"""Arrays without a meaning of their own (HDF5, NumPy, MATLAB): what the caller declares makes them one.

A two-dimensional array is a map whose first row has the smallest y; nothing in it says so, and
nothing says its unit: the caller does, or an attribute ``unit`` beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnitError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import Unit, parse_unit
from metrosep.io.maps import make_surface, scaled
from metrosep.io.measurement import measurement
from metrosep.io.select import sensitivity
from metrosep.io.source import RawFile, lateral_steps
from metrosep.io.table import Column, Table

__all__ = ["columns_as_object", "map_as_surface", "unit_label", "unit_of"]

_UNIT_KEYS = ("units", "unit", "Units", "Unit")


def unit_of(attributes: Mapping[str, Any]) -> Unit | None:
    """Return the unit that the attributes of an array declare."""
    try:
        return parse_unit(unit_label(attributes))
    except UnitError:
        return None


def unit_label(attributes: Mapping[str, Any]) -> str:
    """Return the text that the attributes of an array give as its unit."""
    return next((str(attributes[k]) for k in _UNIT_KEYS if attributes.get(k)), "")


def map_as_surface(
    file: RawFile,
    format_id: str,
    values: NDArray[Any],
    *,
    name: str,
    own_unit: Unit | None,
    unit: Any,
    lateral_step: Any,
    scale: float | str | None = None,
    header: Mapping[str, Any],
) -> Surface:
    """Return a two-dimensional array as a surface."""
    declared = parse_unit(str(unit)) if unit is not None else None
    if declared is not None and own_unit is not None and declared != own_unit:
        raise FormatMismatchError(
            f"{file.path}: {name!r} is in {own_unit.name} by the file, but {declared.name} was given; leave "
            "unit= out"
        )
    found = declared or own_unit
    if found is None:
        raise UnitError(f"{file.path}: {name!r} declares no unit; declare it, such as unit='nm'")
    factor = found.factor
    gain = sensitivity(scale)
    if found.dimension == "voltage" and gain is not None:
        factor *= gain
    elif found.dimension != "length":
        raise UnitError(
            f"{file.path}: {name!r} is in {found.name} ({found.dimension}); a surface needs a length, or "
            "scale='2.5 um/V' for a sensor in volts"
        )
    return make_surface(
        file,
        format_id,
        scaled(values, factor),
        (None, None),
        row_order="smallest y first",
        header=header,
        override=lateral_steps(lateral_step),
        channel=name,
        unit_in_file=None if own_unit is None else own_unit.name,
        unit_declared=None if declared is None else declared.name,
        warnings=(
            "the array does not say which row is on top: row 0 was taken as the smallest y",
        ),
    )


def columns_as_object(
    file: RawFile,
    format_id: str,
    columns: Mapping[str, tuple[FloatArray, Unit | None]],
    header: Mapping[str, Any],
    **options: Any,
) -> Profile | Recording | Surface:
    """Return arrays of one length as the columns of a table would be."""
    made = tuple(
        Column(name, unit, np.asarray(v, dtype=np.float64)) for name, (v, unit) in columns.items()
    )
    n = made[0].values.size if made and made[0].values is not None else 0
    table = Table(made, np.arange(1, n + 1, dtype=np.int64), {"columns": tuple(columns), **header})
    return measurement(file, table, format_id, **options)
