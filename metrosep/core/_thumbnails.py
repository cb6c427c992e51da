"""Small pictures of maps and profiles for notebooks: PNG by numpy and zlib alone.

They are for the eye: no number is read from them.
"""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np

from metrosep.core._arrays import ByteArray, FloatArray

_SIDE = 192
"""Longest side of a map in pixels: a byte each and 1 kB of colours stay below 40 kB."""

_LEAST_SIDE = 12
_WIDE, _HIGH = 320, 96
"""Pixels of the picture of a profile."""

_GREY = (138, 138, 138)
"""Not measured, as in the workbench."""

_LINE = (42, 120, 190)
"""Of a profile: seen on light and on dark pages."""

_SHARE = 0.002
"""Share of the cells beyond each end of the colours."""

_COLOURS = np.frombuffer(
    bytes.fromhex(
        "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d2f6b8e2c728e297a8e26828e"
        "23898e21918c1f978b1f9f8821a68527ad8131b57b3dbc744cc26c5cc8636ece5881d34d95d840aadc32c0df25"
        "d5e21aeae51afde725"
    ),
    dtype=np.uint8,
).reshape(-1, 3)
"""Every eighth colour of viridis (matplotlib, CC0); between them straight lines, to 2 of 255."""


def map_thumbnail(
    z: FloatArray, dx: float | None, dy: float | None
) -> tuple[bytes, tuple[float, float] | None]:
    """Return a PNG of a map, y up and not measured in grey, and what heights its colours span.

    Cells are means of their valid pixels, not measured where less than half of them is valid.
    Pixels are square in m; where a step is not known, each sample is as wide as high.
    """
    ny, nx = z.shape
    width, height = (nx * dx, ny * dy) if dx is not None and dy is not None else (nx, ny)
    unit = _SIDE / max(width, height)
    columns, rows = (max(_LEAST_SIDE, round(side * unit)) for side in (width, height))
    valid = ~np.isnan(z)
    total, count = np.where(valid, z, 0.0), valid.astype(np.float64)
    pixels = np.ones(z.shape[:1]), np.ones(z.shape[1:])
    for axis, n in ((0, rows), (1, columns)):
        total, count = _folded(total, n, axis), _folded(count, n, axis)
    of_cell = np.multiply.outer(_folded(pixels[0], rows, 0), _folded(pixels[1], columns, 0))
    seen = (count > 0) & (count >= 0.5 * of_cell)
    heights = total[seen] / count[seen]
    index = np.zeros((rows, columns), dtype=np.uint8)
    if heights.size == 0:
        return _png(index, np.array([_GREY], dtype=np.uint8)), None
    low, high = (float(v) for v in np.quantile(heights, (_SHARE, 1.0 - _SHARE)))
    index[seen] = _numbers_of(heights, low, high)
    return _png(index[::-1], _table()), (low, high)


def colour_png(z: FloatArray, low: float, high: float) -> bytes:
    """Return a PNG with one pixel for each height, y up, not measured in grey."""
    seen = ~np.isnan(z)
    index = np.zeros(z.shape, dtype=np.uint8)
    index[seen] = _numbers_of(z[seen], low, high)
    return _png(index[::-1], _table())


def _numbers_of(heights: FloatArray, low: float, high: float) -> FloatArray:
    part = np.clip((heights - low) / (high - low), 0.0, 1.0) if high > low else 0.5
    return np.asarray(np.rint(1.0 + 254.0 * part))


def _table() -> ByteArray:
    at = np.linspace(0.0, len(_COLOURS) - 1.0, 255)
    table = [np.interp(at, np.arange(len(_COLOURS)), _COLOURS[:, k]) for k in range(3)]
    return np.vstack([[_GREY], np.rint(np.column_stack(table))]).astype(np.uint8)


def _folded(values: FloatArray, n: int, axis: int) -> FloatArray:
    """Return sums over n pieces of an axis; where it has fewer samples, each one repeated."""
    size = values.shape[axis]
    if n >= size:
        return np.asarray(values.take((np.arange(n) * size) // n, axis=axis))
    return np.asarray(np.add.reduceat(values, (np.arange(n) * size) // n, axis=axis))


def profile_thumbnail(x: FloatArray, z: FloatArray) -> bytes:
    """Return a PNG of a profile: least and greatest height of each column, gaps in grey."""
    width = min(_WIDE, max(_LEAST_SIDE, 40 * x.size))
    edges = np.linspace(x[0], x[-1], width + 1)
    line = _between(edges, x, z)
    low, high = np.fmin(line[:-1], line[1:]), np.fmax(line[:-1], line[1:])
    column = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, width - 1)
    np.fmin.at(low, column, z)
    np.fmax.at(high, column, z)
    index = np.full((_HIGH, width), 1, dtype=np.uint8)
    seen = ~np.isnan(low)
    if seen.any():
        bottom, top = float(low[seen].min()), float(high[seen].max())
        scale = (_HIGH - 9.0) / (top - bottom) if top > bottom else 0.0
        level = [np.rint(_HIGH - 5.0 - (v[seen] - bottom) * scale) for v in (high, low)]
        row = np.arange(_HIGH)[:, np.newaxis]
        index[:, seen] = np.where((row >= level[0] - 1) & (row <= level[1] + 1), 2, 0)
    table = np.array([(255, 255, 255), _GREY, _LINE], dtype=np.uint8)
    return _png(index, table, clear=0)


def _between(at: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    """Return heights on the lines between samples; NaN unless both neighbours are valid."""
    if x.size == 1:
        return np.full(at.size, z[0])
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, x.size - 2)
    part = (at - x[i]) / (x[i + 1] - x[i])
    return np.asarray(z[i] * (1.0 - part) + z[i + 1] * part)


def _png(index: ByteArray, colours: ByteArray, *, clear: int | None = None) -> bytes:
    """Return an indexed PNG; `clear` is the number of a transparent colour."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)

    rows, columns = index.shape
    lines = np.zeros((rows, columns + 1), dtype=np.uint8)  # the first byte: no filter
    lines[:, 1:] = index
    through = b"" if clear is None else chunk(b"tRNS", b"\xff" * clear + b"\x00")
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0))
        + chunk(b"PLTE", colours.tobytes())
        + through
        + chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + chunk(b"IEND", b"")
    )


def png_image(png: bytes, words: str) -> str:
    """Return a PNG as an HTML image that holds its own data; `words` are escaped."""
    from html import escape

    data = base64.b64encode(png).decode("ascii")
    return f"<img alt='{escape(words, quote=True)}' src='data:image/png;base64,{data}'>"
