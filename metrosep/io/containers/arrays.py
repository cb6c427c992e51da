"""One array of NumPy's ``.npy`` format, checked before it is believed; never a pickle."""

from __future__ import annotations

import ast
import struct
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import UnsupportedFeatureError
from metrosep.io.declared import need_bytes
from metrosep.io.source import MAX_PIXELS, RawFile

_VERSIONS = {1: ("<H", 10), 2: ("<I", 12), 3: ("<I", 12)}
_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 4096


def array_of(
    file: RawFile,
    max_pixels: int | None = None,
    *,
    kinds: str = "iuf",
    dimensions: Collection[int] = (1, 2),
) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the array of a file and what its header says; only numbers unless other kinds are allowed."""
    known = file.data.startswith(_MAGIC) and file.size > len(_MAGIC)
    if not known or file.data[len(_MAGIC)] not in _VERSIONS:
        raise file.corrupt("is not an array of NumPy", offset=0, found=repr(file.data[:8]))
    code, start = _VERSIONS[file.data[6]]
    need_bytes(file, 8, start - 8, "the header")
    (length,) = struct.unpack_from(code, file.data, 8)
    need_bytes(file, start, length, "the header", name="header length")
    head = file.data[start : start + min(length, _LONGEST_HEADER)]
    fields = _fields(file, head, kinds, dimensions)
    dtype, shape = fields["descr"], fields["shape"]
    size = 1
    for n in shape:
        size *= n
    if size == 0:
        raise UnsupportedFeatureError(f"{file.path}: the array holds no values")
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


def _fields(file: RawFile, text: bytes, kinds: str, dimensions: Collection[int]) -> dict[str, Any]:
    """Return the checked fields of the header, which is a Python literal."""
    try:
        found = ast.literal_eval(text.decode("latin-1").strip())
        if isinstance(found["descr"], list):
            raise UnsupportedFeatureError(
                f"{file.path}: holds records; write each of their fields as an array of its own"
            )
        dtype = np.dtype(str(found["descr"]))
        shape = tuple(int(n) for n in found["shape"])
        fortran = bool(found["fortran_order"])
    except (ValueError, SyntaxError, TypeError, KeyError, MemoryError, RecursionError) as exc:
        raise file.corrupt(
            "the header is not a description of an array", offset=10, found=str(exc)[:60]
        ) from None
    if dtype.kind not in kinds or dtype.itemsize < 1 or dtype.hasobject:
        raise UnsupportedFeatureError(
            f"{file.path}: holds {dtype} values; only real numbers are read (objects never, since that "
            "would run code)"
        )
    if len(shape) not in dimensions or min(shape, default=0) < 0:
        raise UnsupportedFeatureError(
            f"{file.path}: the array has shape {shape}; one or two dimensions are read"
        )
    return {"descr": dtype, "shape": shape, "fortran_order": fortran}
