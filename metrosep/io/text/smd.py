"""ISO 5436-2 ``.smd``: a profile as text in four records, each closed by the control character ETX.

Record 1 names the axes: type (I incremental, A absolute), number of points, unit, scale factor and
data type, for an incremental x axis the step. Record 2 is about the measurement, record 3 holds
one height per line, record 4 the sum of all bytes before it. Texts end with a zero byte. Height is
``value * scale * unit``. See ``data_formats/smd/SPEC.md``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    UnitError,
    UnsupportedFeatureError,
    WriteError,
)
from metrosep.core.profile import Profile
from metrosep.core.units import parse_unit
from metrosep.io.objects import (
    Request,
    check_area,
    check_scale,
    height_only,
    map_reader,
    rows_to_write,
)
from metrosep.io.registry import demand, sniffer
from metrosep.io.source import RawFile
from metrosep.io.text.logger import one_number, parse_numbers

channels = height_only

FORMAT = "smd"
_ETX = b"\x03"
_SUMS = (65536, 65535)
"""Moduli of the checksum that writers use."""

_MAX_STEP = 1.0
"""Largest step in m that is taken for one."""


class _Axis(NamedTuple):
    """One axis: its line and fields, and metres per stored value."""

    line: int
    is_absolute: bool
    n: int
    scale: float
    unit: float
    increment: str


sniff = sniffer(FORMAT)


@map_reader(FORMAT, "ISO 5436-2", "an ISO 5436-2 profile with its own units")
def read(asked: Request) -> Profile:
    """Return the profile of an ISO 5436-2 file."""
    file = asked.file
    records = _records(file)
    lines = [_plain(t) for t in records[0].split(b"\n")]
    x_axis, z_axis = (_axis(file, lines, name) for name in ("CX", "CZ"))
    for axis, name in ((x_axis, "CX"), (z_axis, "CZ")):
        check_area(file, axis.n, 1, max_pixels=asked.max_pixels, names=(f"{name} points", "rows"))
    warnings = _check_sum(records)
    start = len(records[0]) + len(records[1]) + 2
    values = parse_numbers(file, records[2], offset=start)
    x, z = _points(file, x_axis, z_axis, values)
    x = x + _own_start(_header(records, lines))
    scale = check_scale(file, "CZ scale", z_axis.scale, low=1e-18, high=1e18) * z_axis.unit
    return asked.profile(
        x,
        z * scale,
        header=_header(records, lines),
        warnings=warnings,
        height_per_unit_m=scale,
    )


def _own_start(header: Mapping[str, Any]) -> float:
    """Return the first position that metrosep states in a comment, 0 in files of others: incremental x has none."""
    said = _START.search("\n".join(header["information"]))
    return 0.0 if said is None or header["file_identifier"] != "metrosep" else float(said[1])


_START = re.compile(r"/\* first point at (-?\d+(?:\.\d+)?(?:e[+-]?\d\d?)?) m \*/")


def _plain(line: bytes) -> str:
    return line.decode("latin-1").replace("\0", " ").strip()


def _records(file: RawFile) -> list[bytes]:
    """Return the four records without the characters that close them; the last may be missing."""
    demand(file, FORMAT)
    if not file.head.split(b"\n", 1)[1].startswith(b"PRF"):
        raise UnsupportedFeatureError(
            f"{file.path}: the ISO 5436-2 file holds a surface, only profiles (PRF) are read; save it "
            "as SDF or X3P"
        )
    parts = file.data.split(_ETX, 4)
    if len(parts) < 4:
        raise file.corrupt(
            "a record is not closed",
            offset=file.size,
            expected="three records that end with ETX (byte 3), and a checksum",
            found=f"{len(parts) - 1} such bytes",
        )
    return parts[:4]


def _axis(file: RawFile, lines: list[str], name: str) -> _Axis:
    found = [(k, t) for k, t in enumerate(lines, start=1) if t.split()[:1] == [name]]
    if len(found) != 1:
        raise file.corrupt(
            "an axis is missing or given twice", field=name, expected=1, found=len(found)
        )
    number, line = found[0]
    kind, n, unit, scale, code, increment = (*line.split()[1:7], *[""] * 6)[:6]
    if kind not in ("I", "A") or code not in ("I", "L", "F", "D"):
        raise file.corrupt(
            "an axis is of unknown type",
            field=f"line {number}",
            expected=f"{name} I|A points unit scale I|L|F|D",
            found=repr(line[:60]),
        )
    try:
        factor = parse_unit(unit, dimension="length").factor
    except UnitError as exc:
        raise UnitError(f"{file.path}: line {number}: {exc}") from None
    n_points = one_number(file, n, line=number, name="points", low=0, high=1e15)
    value = one_number(file, scale, line=number, name="scale", low=-1e18, high=1e18)
    return _Axis(number, kind == "A", int(n_points), value, factor, increment)


def _points(
    file: RawFile, x_axis: _Axis, z_axis: _Axis, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return positions in m, and heights as stored."""
    if not z_axis.is_absolute:
        raise file.corrupt(
            "the z axis must be absolute", field=f"line {z_axis.line}", expected="A"
        )
    if x_axis.is_absolute or x_axis.scale != 1.0:
        raise UnsupportedFeatureError(
            f"{file.path}: its x axis has positions of its own or a scale factor, whose order in such "
            "files is not certain; save it with an incremental x axis of scale 1"
        )
    if not x_axis.n == z_axis.n == values.size:
        raise file.corrupt(
            "the heights do not fill the profile",
            field=f"line {z_axis.line}",
            expected=f"{x_axis.n} and {z_axis.n} points, as the axes say",
            found=values.size,
        )
    step = x_axis.unit * one_number(
        file,
        x_axis.increment,
        line=x_axis.line,
        name="the step",
        low=1e-15 / x_axis.unit,
        high=_MAX_STEP / x_axis.unit,
    )
    return step * np.arange(x_axis.n, dtype=np.float64), values


def _check_sum(records: list[bytes]) -> list[str]:
    """Return a warning when the sum of the bytes of the first three records is another."""
    words = _plain(records[3]).split()
    closed = b"".join(r + _ETX for r in records[:3])
    after = records[3][: len(records[3]) - len(records[3].lstrip(b"\r\n"))]
    total = int(np.frombuffer(closed + after, dtype=np.uint8).sum(dtype=np.int64))
    if words and words[0].isascii() and words[0].isdecimal():
        if len(words[0]) < 12 and int(words[0]) in {total % m for m in _SUMS}:
            return []
        return [f"the checksum {words[0][:12]} is wrong: the file was changed after writing"]
    return ["the checksum is missing"]


def _header(records: list[bytes], lines: list[str]) -> dict[str, Any]:
    first = records[0].split(b"\n")[0].split(b"\0")
    info = [_plain(t) for t in records[1].split(b"\n")]
    return {
        "revision": first[0].decode("latin-1").strip(),
        "file_identifier": b" ".join(first[1:]).decode("latin-1").strip(),
        "feature": lines[1],
        "axes": [t for t in lines[2:] if t],
        "information": [t for t in info if t],
        "checksum": _plain(records[3])[:40],
    }


# ---- bytes of an ISO 5436-2 profile: metres, incremental x, a sum of the bytes modulo 65536 ---------


def smd_bytes(profile: Profile) -> bytes:
    """Return a profile as an ISO 5436-2 file; the same profile gives the same bytes."""
    z, dx, _, (start, _) = rows_to_write(profile, "SMD")
    missing = int(np.isnan(z).sum())
    if missing:
        raise WriteError(
            f"{missing} points of the profile were not measured and SMD has no mark for them; fill them, or "
            "write X3P"
        )
    n = z.size
    records = (
        ("ISO 5436 - 2000\0metrosep\0", "PRF\0 1 metrosep\0", f"CX\0 I\0 {n} m\0 1.0e0 D\0 {dx!r}",
         f"CZ\0 A\0 {n} m\0 1.0e0 D\0"),
        ("CREATED_BY metrosep\0", f"COMMENT /* first point at {start!r} m */\0"),
        tuple(map(repr, z[0].tolist())),
    )  # fmt: skip
    body = "".join("\r\n".join((*lines, "\x03\r\n")) for lines in records).encode("ascii")
    return body + f"{sum(body) % _SUMS[0]}\r\n\x03\r\n\x1a".encode("ascii")
