"""Bytes of a surface data file (ISO 25178-71, version 1.0); the same surface gives the same bytes.

Heights are written as double precision numbers in metres with Zscale 1, so that reading them back
gives the same numbers; not measured is the word BAD in text and NaN in binary data. The first
profile has the smallest y. The format has no origin: it is lost, and stated in the trailer.
"""

from __future__ import annotations

import struct

import numpy as np

from metrosep.core.errors import WriteError
from metrosep.core.surface import Surface

__all__ = ["sdf_bytes"]

_MAX_SIZE = 65535
_NO_DATE = "010119700000"
"""The format demands DDMMYYYYHHMM; a clock would make the same surface give other bytes."""

_DOUBLE = 7


def sdf_bytes(surface: Surface, *, binary: bool = False) -> bytes:
    """Return a surface as the content of an SDF file, version 1.0.

    Parameters
    ----------
    surface : Surface
        With both lateral steps, at most 65535 points a side.
    binary : bool, optional
        Write ``bISO-1.0`` instead of the text ``aISO-1.0``.

    Returns
    -------
    bytes
        Header, heights and trailer.

    Raises
    ------
    WriteError
        If a step is missing, nothing was measured, or the surface is too large.
    """
    if np.isnan(surface.z).all():
        raise WriteError("nothing was measured, so there is nothing to write as SDF")
    if surface.dx is None or surface.dy is None:
        raise WriteError(
            "the surface is laterally not calibrated and SDF needs both steps; give them on reading "
            "with lateral_step=(dx, dy)"
        )
    rows, columns = surface.shape
    if max(rows, columns) > _MAX_SIZE:
        raise WriteError(
            f"SDF version 1.0 holds at most {_MAX_SIZE} points a side, got {columns} x {rows}; write X3P"
        )
    x, y = surface.origin
    trailer = f"<Origin> {x!r} {y!r} </Origin>\n"
    if binary:
        return _header(surface) + surface.z.astype("<f8").tobytes() + trailer.encode("ascii")
    fields = {
        "ManufacID": "metrosep",
        "CreateDate": _NO_DATE,
        "ModDate": _NO_DATE,
        "NumPoints": columns,
        "NumProfiles": rows,
        "Xscale": repr(surface.dx),
        "Yscale": repr(surface.dy),
        "Zscale": "1.0",
        "Zresolution": "-1.0",
        "Compression": 0,
        "DataType": _DOUBLE,
        "CheckType": 0,
    }
    lines = ["aISO-1.0", *(f"{k:<12}= {v}" for k, v in fields.items()), "*"]
    lines += [" ".join("BAD" if v != v else repr(v) for v in row) for row in surface.z.tolist()]
    return ("\n".join(lines) + f"\n*\n{trailer}*\n").encode("ascii")


def _header(surface: Surface) -> bytes:
    rows, columns = surface.shape
    return struct.pack(
        "<8s10s12s12sHHddddBBB",
        b"bISO-1.0",
        b"metrosep".ljust(10),
        _NO_DATE.encode("ascii"),
        _NO_DATE.encode("ascii"),
        columns,
        rows,
        surface.dx,
        surface.dy,
        1.0,
        -1.0,
        0,
        _DOUBLE,
        0,
    )
