"""Height maps and line profiles of instruments: what all their readers promise, in one place.

Row 0 has the smallest y, column 0 the smallest x, heights are in metres and grow out of the
material, NaN is not measured, a step that is not calibrated is ``None``. A file's own order and
its own steps stay in the metadata.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import CheckedArray, FloatArray
from metrosep.core.errors import CorruptFileError, DataError, UnsupportedFeatureError
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.io.source import MAX_PIXELS, RawFile, refuse_options

__all__ = [
    "ROW_ORDERS",
    "check_area",
    "check_scale",
    "height_only",
    "lateral_or_none",
    "make_profile",
    "make_surface",
    "need_bytes",
    "only_channels",
    "scaled",
    "scaled_file",
    "unpack_fields",
]

ROW_ORDERS = ("smallest y first", "top row first")
"""Order of the rows in a file; the second is turned on reading."""

_BLOCK_VALUES = 2**17
"""Values that are scaled at once: they stay in the cache."""

_MAX_LATERAL = 1.0
"""Largest lateral step in m that is taken for a calibration."""


def height_only(file: RawFile) -> tuple[str, ...]:
    """Return the data sets of a format that holds one map: ``channels`` of its reader."""
    return ("height",)


def only_channels(
    file: RawFile, title: str, channel: str | None, names: Sequence[str] = ("height",)
) -> str:
    """Return the channel to read, the first if none was named."""
    if channel is None:
        return names[0]
    if channel in names:
        return channel
    raise UnsupportedFeatureError(
        f"{file.path}: has no {title} channel {channel!r}; there is "
        f"{', '.join(repr(n) for n in names[:20])}"
    )


def lateral_or_none(
    file: RawFile,
    name: str,
    value: float,
    warnings: list[str],
    *,
    offset: int | None = None,
    factor: float = 1.0,
) -> float | None:
    """Return a lateral step in m, or ``None`` where the file is not calibrated."""
    if value == 0.0:
        return None
    if math.isnan(value):
        warnings.append(f"{name} is NaN: taken as not calibrated")
        return None
    step = float(value) * factor
    if not 0.0 < step <= _MAX_LATERAL:
        raise CorruptFileError(
            file.path,
            "the lateral step is not usable",
            field=name,
            offset=offset,
            expected=f"0 (not calibrated) or up to {_MAX_LATERAL / factor:g}",
            found=value,
        )
    return step


def scaled(
    raw: NDArray[Any],
    scale: float,
    invalid: NDArray[np.bool_] | Callable[[NDArray[Any]], NDArray[np.bool_]] | None = None,
    offset: float = 0.0,
    *,
    turned: bool = False,
) -> FloatArray:
    """Return heights in m of raw values, NaN where not measured."""
    z: FloatArray = np.empty(raw.shape, dtype=np.float64)
    target = z[::-1] if turned else z
    native = raw.dtype.newbyteorder("=")
    step = max(1, _BLOCK_VALUES // max(1, raw[:1].size))
    for start in range(0, raw.shape[0], step):
        rows = slice(start, start + step)
        block = raw[rows].astype(native, copy=False)
        with np.errstate(invalid="ignore"):  # a signalling NaN of a damaged file
            np.multiply(block, scale, out=target[rows], dtype=np.float64)
        if offset != 0.0:
            target[rows] += offset
        mask = invalid(block) if callable(invalid) else None if invalid is None else invalid[rows]
        if mask is not None and mask.any():
            target[rows][mask] = np.nan
    return z


def scaled_file(
    file: RawFile,
    offset: int,
    shape: tuple[int, int],
    dtype: str,
    scale: float,
    invalid: Callable[[NDArray[Any]], NDArray[np.bool_]],
    *,
    turned: bool = False,
) -> FloatArray:
    """Return the heights of a map that lies in a file, without loading the file beside them."""
    z: FloatArray = np.empty(shape, dtype=np.float64)
    target = z[::-1] if turned else z
    step = max(1, _BLOCK_VALUES // shape[1])
    buffer: NDArray[Any] = np.empty((min(step, shape[0]), shape[1]), dtype=dtype)
    with file.stream() as stream:
        stream.seek(offset)
        for start in range(0, shape[0], step):
            block = buffer[: min(step, shape[0] - start)]
            n_bytes = stream.readinto(block.reshape(-1).view(np.uint8).data)
            if n_bytes != block.nbytes:
                raise CorruptFileError(
                    file.path,
                    "the map ends early",
                    offset=offset + start * shape[1] * buffer.itemsize + n_bytes,
                    expected=f"{shape[0]} rows",
                    found=f"{start} and a part",
                )
            target[start : start + step] = scaled(block, scale, invalid)
    return z


def make_surface(
    file: RawFile,
    format_id: str,
    z: FloatArray,
    own_steps: tuple[float | None, float | None],
    *,
    row_order: str,
    header: Mapping[str, Any],
    override: tuple[float, float] | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
    warnings: Sequence[str] = (),
    turned: bool = False,
    **facts: Any,
) -> Surface:
    """Return a surface that meets the contract of all readers."""
    z, notes = _measured(file, z)
    if row_order == ROW_ORDERS[1] and not turned:
        z = z[::-1]
    dx, dy = override or own_steps
    metadata = file.metadata(
        format_id,
        header,
        warnings=(*warnings, *notes),
        row_order_in_file=row_order,
        lateral_step_in_file_m=own_steps,
        lateral_step_override_m=override,
        **facts,
    )
    history = file.history(format_id, {"lateral_step_m": override})
    try:
        return Surface(
            z.view(CheckedArray), dx, dy, origin=origin, metadata=metadata, history=history
        )
    except DataError as exc:
        raise CorruptFileError(file.path, f"the map does not fit: {exc}") from None


def make_profile(
    file: RawFile,
    format_id: str,
    x: FloatArray,
    z: FloatArray,
    *,
    header: Mapping[str, Any],
    override: float | None = None,
    warnings: Sequence[str] = (),
    **facts: Any,
) -> Profile:
    """Return a profile that meets the contract of all readers; falling positions are turned."""
    z, notes = _measured(file, z)
    order = "smallest x first"
    if x.size > 1 and x[0] > x[-1]:
        x, z, order = x[::-1], z[::-1], "largest x first"
    try:
        own = Profile(x, z)
        step = own.dx if own.is_uniform else None
        if override is not None:
            if step is None:
                refuse_options(file, "a profile with its own positions", lateral_step=override)
            x = x[0] + override * np.arange(x.size)
        metadata = file.metadata(
            format_id,
            header,
            warnings=(*warnings, *notes),
            point_order_in_file=order,
            lateral_step_in_file_m=step,
            lateral_step_override_m=override,
            **facts,
        )
        history = file.history(format_id, {"lateral_step_m": override})
        return Profile(x, z, metadata=metadata, history=history)
    except DataError as exc:
        raise CorruptFileError(file.path, f"the profile does not fit: {exc}") from None


def _measured(file: RawFile, z: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return heights without infinities, and sentences on what was odd; refuse an empty map."""
    notes: tuple[str, ...] = ()
    low, high = float(np.fmin.reduce(z, axis=None)), float(np.fmax.reduce(z, axis=None))
    if math.isinf(low) or math.isinf(high):
        infinite = np.isinf(z)
        z = np.where(infinite, np.nan, z)
        notes = (f"{int(infinite.sum())} infinite heights were taken as not measured",)
        low, high = float(np.fmin.reduce(z, axis=None)), float(np.fmax.reduce(z, axis=None))
    if math.isnan(low):
        raise CorruptFileError(
            file.path,
            "no point was measured",
            expected="at least one valid height",
            found=f"{z.size} invalid ones",
            hint="measure again with more light or a larger mask",
        )
    if low == high:
        notes += (f"every valid height is the same, {low:g} m: no relief was stored",)
    return z, notes


# ---- binary headers as data: read the fields of a layout, and refuse sizes before they are allocated ----
# A layout is a tuple of (offset, `struct` code, name), as in the description of the format. Every
# reader of binary maps uses the same checks, so that a damaged header gives the same sentence.

Layout: TypeAlias = Sequence[tuple[int, str, str]]
"""Offset in bytes, `struct` code without byte order, and name of each field."""


def unpack_fields(
    file: RawFile, layout: Layout, *, order: str, start: int = 0, what: str = "the header"
) -> dict[str, Any]:
    """Return the fields of a header; text is cut at its first zero byte and stripped."""
    end = max(offset + struct.calcsize(order + code) for offset, code, _ in layout)
    need_bytes(file, start, end, what)
    data = file.head if start + end <= len(file.head) else file.data
    fields: dict[str, Any] = {}
    for offset, code, name in layout:
        values = struct.unpack_from(order + code, data, start + offset)
        value = values[0] if len(values) == 1 else values
        if isinstance(value, bytes):
            value = value.split(b"\0")[0].decode("latin-1").strip()
        fields[name] = value
    return fields


def need_bytes(file: RawFile, offset: int, count: int, what: str, *, name: str = "size") -> None:
    """Refuse a file that ends before something that its header promises."""
    if count < 0 or offset < 0 or offset + count > file.size:
        raise CorruptFileError(
            file.path,
            f"{what} does not fit into the file",
            field=name,
            offset=max(min(offset, file.size), 0),
            expected=f"{count} bytes",
            found=f"{max(file.size - offset, 0)} bytes",
        )


def check_area(
    file: RawFile,
    columns: int,
    rows: int,
    *,
    max_pixels: int | None = None,
    names: tuple[str, str] = ("columns", "rows"),
    offsets: tuple[int | None, int | None] = (None, None),
) -> None:
    """Refuse a map without size, or with more pixels than may be allocated."""
    for value, name, offset in zip((columns, rows), names, offsets, strict=True):
        if value < 1:
            raise CorruptFileError(
                file.path,
                "the map has no size",
                field=name,
                offset=offset,
                expected="at least 1",
                found=value,
            )
    limit = max_pixels or MAX_PIXELS
    if columns * rows > limit:
        raise UnsupportedFeatureError(
            f"{file.path}: claims {columns} x {rows} pixels ({names[0]} x {names[1]}), more than "
            f"{limit}; pass max_pixels= if that is true"
        )


def check_scale(
    file: RawFile,
    name: str,
    value: float,
    *,
    offset: int | None = None,
    low: float = 1e-3,
    high: float = 1e3,
) -> float:
    """Return a scale of the heights, or refuse it."""
    if not low <= value <= high:  # also catches NaN
        raise CorruptFileError(
            file.path,
            "a scale of the heights is not usable",
            field=name,
            offset=offset,
            expected=f"{low:g} to {high:g}",
            found=value,
        )
    return float(value)
