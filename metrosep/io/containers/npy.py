"""NumPy ``.npy``: one array of numbers; never a pickle, and no claim larger than the file."""

from __future__ import annotations

import ast
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.io.declared import need_bytes
from metrosep.io.objects import only_channels
from metrosep.io.registry import demand, sniffer
from metrosep.io.source import MAX_PIXELS, RawFile
from metrosep.io.text.measurement import columns_as_object, map_as_surface
from metrosep.io.text.table import ColumnSpec

__all__ = ["channels", "read", "sniff"]

FORMAT = "npy"
_VERSIONS = {1: ("<H", 10), 2: ("<I", 12), 3: ("<I", 12)}
_LONGEST_HEADER = 4096


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
    values, header = _array(file, max_pixels)
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


def _array(file: RawFile, max_pixels: int | None) -> tuple[NDArray[Any], dict[str, Any]]:
    demand(file, FORMAT)
    code, start = _VERSIONS[file.data[6]]
    need_bytes(file, 8, start - 8, "the header")
    (length,) = struct.unpack_from(code, file.data, 8)
    need_bytes(file, start, length, "the header", name="header length")
    fields = _fields(file, file.data[start : start + min(length, _LONGEST_HEADER)])
    dtype, shape = fields["descr"], fields["shape"]
    size = 1
    for n in shape:
        size *= n
    if size > (max_pixels or MAX_PIXELS):
        raise UnsupportedFeatureError(
            f"{file.path}: claims {size} values, more than {max_pixels or MAX_PIXELS}; pass max_pixels= if "
            "that is true"
        )
    offset = start + length
    if size < 1 or file.size - offset != size * dtype.itemsize:
        raise file.corrupt(
            "header and size of the file do not agree",
            field="shape",
            offset=offset,
            expected=f"{size * dtype.itemsize} bytes",
            found=f"{file.size - offset} bytes",
        )
    flat = np.frombuffer(file.data, dtype=dtype, count=size, offset=offset)
    header = {"descr": dtype.str, "shape": list(shape), "fortran_order": fields["fortran_order"]}
    values = flat.reshape(shape[::-1]).T if fields["fortran_order"] else flat.reshape(shape)
    return values, header


def _fields(file: RawFile, text: bytes) -> dict[str, Any]:
    """Return the checked fields of the header, which is a Python literal."""
    try:
        found = ast.literal_eval(text.decode("latin-1").strip())
        dtype = np.dtype(str(found["descr"]))
        shape = tuple(int(n) for n in found["shape"])
        fortran = bool(found["fortran_order"])
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError) as exc:
        raise file.corrupt(
            "the header is not a description of an array", offset=10, found=str(exc)[:60]
        ) from None
    if dtype.kind not in "iuf" or dtype.itemsize < 1 or dtype.hasobject:
        raise UnsupportedFeatureError(
            f"{file.path}: holds {dtype} values; only real numbers are read (objects never, since that "
            "would run code)"
        )
    if len(shape) not in (1, 2) or min(shape) < 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the array has shape {shape}; one or two dimensions are read"
        )
    return {"descr": dtype, "shape": shape, "fortran_order": fortran}
