"""Bytes of a Digital Surf surface (``.sur``, 32 bit, not compressed); the same surface, the same bytes.

Heights are rounded to steps of about P-V / 2^31, counted from zmin = 0, so that programs which
subtract zmin and programs which do not agree. Spacings and offsets are single precision by the
format: the spacing of the heights is chosen as a single-precision number before the counts are
made and adds no error of scale; lateral steps are rounded to 6e-8 of themselves. All units are mm.
"""

from __future__ import annotations

import math
import struct

import numpy as np

from metrosep.core.errors import WriteError
from metrosep.core.surface import Surface

__all__ = ["sur_bytes"]

_MM = 1e-3
_MAX_COUNT = 2**31 - 1
_NOT_MEASURED = -2
_SURFACE, _BITS = 2, 32
_FINEST = 1e-21
"""Smallest step of the heights in mm; finer than any height means something."""

_LARGEST = 1e9
"""Largest height, offset or step in mm that is written."""


def sur_bytes(surface: Surface) -> bytes:
    """Return a surface as the content of a Digital Surf file."""
    valid = ~np.isnan(surface.z)
    if not valid.any():
        raise WriteError("nothing was measured, so there is nothing to write as SUR")
    if surface.dx is None or surface.dy is None:
        raise WriteError(
            "the surface is laterally not calibrated and SUR needs both steps; give them on reading "
            "with lateral_step=(dx, dy)"
        )
    low, high = (float(f(surface.z)) / _MM for f in (np.nanmin, np.nanmax))
    values = (low, high, surface.dx / _MM, surface.dy / _MM, *(o / _MM for o in surface.origin))
    if max(abs(v) for v in values) > _LARGEST:
        raise WriteError(f"SUR is written up to {_LARGEST * _MM:g} m, got {max(values) * _MM:g} m")
    offset, step = _grid_of_heights(low, high)
    counts = np.full(surface.shape, _NOT_MEASURED, dtype="<i4")
    heights = surface.z[valid] / _MM
    counts[valid] = np.rint((heights - offset) / step).clip(0, _MAX_COUNT).astype("<i4")
    comment = f"metrosep: heights rounded to steps of {step!r} mm\r\n".encode("latin-1")
    top = int(counts.max())
    header = _header(surface, top=top, offset=offset, step=step, n_comment=len(comment))
    return header + comment + counts[::-1].tobytes()


def _grid_of_heights(low: float, high: float) -> tuple[float, float]:
    """Return height of count 0 and height of a count in mm, both exact in single precision."""
    offset = np.float32(low)
    if float(offset) > low:
        offset = np.nextafter(offset, np.float32(-math.inf))
    step = np.float32(max((high - float(offset)) / _MAX_COUNT, _FINEST))
    if float(step) * _MAX_COUNT < high - float(offset):
        step = np.nextafter(step, np.float32(math.inf))
    return float(offset), float(step)


def _header(surface: Surface, *, top: int, offset: float, step: float, n_comment: int) -> bytes:
    """Return the 512 bytes of the header; date and time are left at zero."""
    rows, columns = surface.shape
    x, y = surface.origin
    has_holes = int(np.isnan(surface.z).any())
    parts = [
        b"DIGITAL SURF",
        struct.pack("<hHhh", 0, 1, 1, _SURFACE),
        b"".ljust(30) + b"metrosep".ljust(30),
        struct.pack("<hhhhhfI", 0, 0, 0, has_holes, 1, 0.0, 0),
        struct.pack("<hiiiii", _BITS, 0, top, columns, rows, columns * rows),
        struct.pack("<fff", (surface.dx or 0.0) / _MM, (surface.dy or 0.0) / _MM, step),
        b"".join(name.ljust(16) for name in (b"X", b"Y", b"Z")),
        b"mm".ljust(16) * 6,
        struct.pack("<fff", 1.0, 1.0, 1.0),
        struct.pack("<hhh", 0, 0, 0) + bytes(12),
        struct.pack("<7hf", 0, 0, 0, 0, 0, 0, 0, 0.0),
        struct.pack("<I", 0) + bytes(6),
        struct.pack("<HH", n_comment, 0) + bytes(128),
        struct.pack("<fff", x / _MM, y / _MM, offset),
        struct.pack("<ff", 0.0, 0.0) + b"T".ljust(13) + b"s".ljust(13),
    ]
    return b"".join(parts)
