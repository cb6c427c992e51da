"""Triangles of STL files, binary and ASCII, as exported by CAD programs.

An STL file holds corners of triangles and nothing else that counts: no unit, which the caller must
say, and no topology. Normals are recomputed by whoever needs them; attribute bytes carry colours of
some programs. Binary files store single precision: on a part of 100 mm a coordinate is rounded to
up to 4 nm.
"""

from __future__ import annotations

import re
from os import PathLike
from pathlib import Path

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.atomic import require_plain
from metrosep.core.errors import CorruptFileError, FileMissingError, ReadError
from metrosep.core.units import parse_unit

_HEADER = 80
_FACET = np.dtype(
    [("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("attributes", "<u2")], align=False
)
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_SOLID = re.compile(rb"\s*solid\b", re.IGNORECASE)


def read_stl(path: str | PathLike[str], *, unit: str) -> FloatArray:
    """Return the corners of all triangles of an STL file."""
    try:
        require_plain(Path(path))
        data = Path(path).read_bytes()
    except FileNotFoundError:
        raise FileMissingError(f"{path}: no such file; check the name and the folder") from None
    except OSError as error:
        raise ReadError(f"{path}: {error.strerror or error}; check the name") from None
    return parse_stl(data, unit=unit, name=str(path))


def parse_stl(data: bytes, *, unit: str, name: str = "STL data") -> FloatArray:
    r"""Return the corners of all triangles of an STL file.

    Notes
    -----
    A file whose size is exactly that of its binary count is binary, even when it begins with
    "solid" as those of some programs do. Several solids in one ASCII file are joined.

    References
    ----------
    .. [1] 3D Systems, StereoLithography Interface Specification, 1988.

    Examples
    --------
    >>> text = b"solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 1\nvertex 2 0 1\n"
    >>> text += b"vertex 0 2 1\nendloop\nendfacet\nendsolid\n"
    >>> parse_stl(text, unit="mm")[0, 1].tolist()
    [0.002, 0.0, 0.001]
    """
    factor = parse_unit(unit, dimension="length").factor
    data = bytes(data)
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    binary_size = _HEADER + 4 + count * _FACET.itemsize
    if len(data) >= _HEADER + 4 and len(data) == binary_size:
        corners = _binary(data, count, name)
    elif _SOLID.match(data) and b"\0" not in data:
        corners = _ascii(data, name)
    elif len(data) < _HEADER + 4:
        raise CorruptFileError(
            name,
            "neither binary nor ASCII STL: too short for a binary header, and no 'solid'",
            offset=len(data),
            expected=f"at least {_HEADER + 4} bytes",
            found=f"{len(data)}",
        )
    else:
        raise CorruptFileError(
            name,
            "the size does not fit the number of facets",
            offset=_HEADER,
            field="number of facets",
            expected=f"{binary_size} bytes for {count} facets",
            found=f"{len(data)}",
        )
    if corners.shape[0] == 0:
        raise CorruptFileError(name, "holds no facet")
    return corners * factor


def _binary(data: bytes, count: int, name: str) -> FloatArray:
    facets = np.frombuffer(data, dtype=_FACET, count=count, offset=_HEADER + 4)
    corners = facets["corners"]
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if bad.size:
        raise CorruptFileError(
            name,
            "a coordinate is not finite",
            offset=_HEADER + 4 + int(bad[0]) * _FACET.itemsize,
            field=f"facet {int(bad[0])}",
        )
    return corners.astype(np.float64)


def _ascii(data: bytes, name: str) -> FloatArray:
    numbers: list[float] = []
    expected = "solid"
    n_corners = 0
    lines = data.splitlines()
    for i, raw in enumerate(lines, start=1):
        words = raw.split()
        if not words:
            continue
        word = words[0].lower()
        if expected == "facet or endsolid" and word == b"endsolid":
            expected = "solid"
            continue
        if word.decode("latin-1") not in expected.split(" or "):
            raise _odd(name, i, expected, raw)
        if word == b"solid":
            expected = "facet or endsolid"
        elif word == b"facet":
            _words(name, i, raw, words, (b"facet", b"normal"), 5)
            expected = "outer"
        elif word == b"outer":
            _words(name, i, raw, words, (b"outer", b"loop"), 2)
            expected, n_corners = "vertex", 0
        elif word == b"vertex":
            _words(name, i, raw, words, (b"vertex",), 4)
            numbers += _numbers(name, i, raw, words[1:])
            n_corners += 1
            expected = "endloop" if n_corners == 3 else "vertex"
        elif word == b"endloop":
            _words(name, i, raw, words, (b"endloop",), 1)
            expected = "endfacet"
        else:
            _words(name, i, raw, words, (b"endfacet",), 1)
            expected = "facet or endsolid"
    if expected != "solid":
        raise CorruptFileError(
            name, "ends too early", field=f"after line {len(lines)}", expected=expected
        )
    return np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)


def _words(
    name: str, line: int, raw: bytes, words: list[bytes], first: tuple[bytes, ...], count: int
) -> None:
    if len(words) != count or tuple(w.lower() for w in words[: len(first)]) != first:
        rest = count - len(first)
        text = b" ".join(first).decode("ascii") + (f" and {rest} numbers" if rest else "")
        raise _odd(name, line, text, raw)


def _numbers(name: str, line: int, raw: bytes, words: list[bytes]) -> list[float]:
    values = [float(w) if _NUMBER.fullmatch(w) else np.nan for w in words]
    if not np.isfinite(values).all():
        raise _odd(name, line, "three finite numbers with decimal points", raw)
    return values


def _odd(name: str, line: int, expected: str, raw: bytes) -> CorruptFileError:
    return CorruptFileError(
        name,
        "an ASCII line is not what must stand there",
        field=f"line {line}",
        expected=expected,
        found=repr(raw[:40].decode("latin-1")),
    )
