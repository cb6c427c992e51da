"""MATLAB ``.mat``, version 5 (to -v7) and 7.3 (HDF5): maps, vectors, and captures of dSPACE.

A matrix becomes a surface, vectors become a profile or a recording, as the caller declares; nothing
in the file says a unit. A struct with fields X and Y, as dSPACE writes, is a recording of its own.
Layout and sources are in ``data_formats/matlab/SPEC.md``.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import (
    CorruptFileError,
    FormatMismatchError,
    ReadNameError,
    UnsupportedFeatureError,
)
from metrosep.core.profile import Profile
from metrosep.core.recording import Recording
from metrosep.core.surface import Surface
from metrosep.core.units import Unit
from metrosep.io._roles import ColumnSpec
from metrosep.io.containers.hdf5_file import Hdf5File, open_hdf5
from metrosep.io.registry import mismatch, sniffer
from metrosep.io.source import HDF5_MAGIC, MAX_PIXELS, RawFile, refuse_options
from metrosep.io.text.dialect import header_unit
from metrosep.io.text.logger import Channels
from metrosep.io.text.measurement import columns_as_object, map_as_surface

FORMAT = "matlab"

_TIMES = ("t", "time")


sniff = sniffer(FORMAT)


def channels(file: RawFile) -> tuple[str, ...]:
    """Return the channels of a capture, and the names of matrices and vectors."""
    values = load(file)
    captures = trace_names(values)
    traces = tuple(name for named in captures.values() for name in named)
    inside = tuple(f"{capture}." for capture in captures)
    arrays = {*_maps(values), *_lines(values)}
    rest = (n for n in values.numbers if n in arrays and not n.startswith(inside))
    return tuple(dict.fromkeys((*traces, *rest)))


def read(
    file: RawFile,
    *,
    channel: str | None = None,
    lateral_step: Any = None,
    unit: Any = None,
    x: ColumnSpec | None = None,
    z: ColumnSpec | None = None,
    time: ColumnSpec | None = None,
    sampling_rate: float | str | None = None,
    scale: float | str | None = None,
    max_pixels: int | None = None,
    row_order: str | None = None,
) -> Surface | Profile | Recording:
    """Return a matrix, vectors of one length, or a capture."""
    values = load(file, max_pixels)
    columns: dict[str, ColumnSpec | None] = {"x": x, "z": z, "time": time}
    asked = [spec for spec in columns.values() if spec is not None]
    declared = bool(asked) or sampling_rate is not None
    capture = None if declared else find_capture(file, values, channel)
    if capture is not None:
        options = {"lateral_step": lateral_step, "scale": scale}
        refuse_options(file, "a dSPACE capture with its own times", **options)
        return recording_of(file, FORMAT, values, *capture, unit=unit)
    maps = _maps(values)
    if not declared and (channel in maps or (channel is None and len(maps) == 1)):
        name = channel or maps[0]
        return map_as_surface(
            file,
            FORMAT,
            values.numbers[name],
            name=name,
            own_unit=None,
            unit=unit,
            lateral_step=lateral_step,
            scale=scale,
            row_order=row_order,
            header=values.header,
        )
    vectors = _vectors(file, values, channel, asked, split=declared)
    kept = (
        channel if channel in vectors and (time is not None or sampling_rate is not None) else None
    )
    return columns_as_object(
        file,
        FORMAT,
        vectors,
        values.header,
        channel=kept,
        lateral_step=lateral_step,
        unit=unit,
        sampling_rate=sampling_rate,
        scale=scale,
        **columns,
    )


def _maps(values: Values) -> list[str]:
    return [n for n, v in values.numbers.items() if v.ndim == 2 and min(v.shape) > 1]


def _lines(values: Values) -> list[str]:
    """Return the names of rows and columns with more than one number."""
    return [n for n, v in values.numbers.items() if v.size > 1 and max(v.shape) == v.size]


def _vectors(
    file: RawFile, values: Values, channel: str | None, asked: list[ColumnSpec], *, split: bool
) -> dict[str, tuple[Any, Unit | None]]:
    """Return the vectors that are as long as the one that is named, or as the longest one."""
    found = {n: values.numbers[n].ravel() for n in _lines(values)}
    if split:
        for name in _maps(values):
            matrix = values.numbers[name]
            found |= {f"{name}(:,{k + 1})": matrix[:, k] for k in range(matrix.shape[1])}
            if channel == name:
                found = {n: v for n, v in found.items() if n.startswith(f"{name}(")}
    named = [n for n in (channel, *(n for s in asked for n in _names(s))) if n in found]
    if channel is not None and channel not in found and not (split and channel in _maps(values)):
        raise _missing(file, values, channel)
    if not found:
        raise _unclear(file, values)
    length = found[named[0]].size if named else max(v.size for v in found.values())
    alike: dict[str, tuple[Any, Unit | None]] = {
        n: (v, _own_unit(n)) for n, v in found.items() if v.size == length
    }
    if split or channel is None:
        return alike
    return {n: v for n, v in alike.items() if n == channel or n.lower() in _TIMES}


def _own_unit(name: str) -> Unit | None:
    """Return the unit in which the name of a variable ends, such as z_um; x_in is an input."""
    return None if name.endswith("_in") else header_unit(name)[1]


def _names(spec: ColumnSpec) -> tuple[str, ...]:
    """Return the names that a specification can mean; ``z(:,1):um`` has a colon of its own."""
    return (spec, spec.rsplit(":", 1)[0]) if isinstance(spec, str) else (str(spec[0]),)


def _missing(file: RawFile, values: Values, channel: str) -> FormatMismatchError:
    if channel in values.left_out:
        return FormatMismatchError(
            f"{file.path}: {channel!r} is complex, sparse, an object or a function; in MATLAB save "
            "real and full numbers, such as full(real(...))"
        )
    return ReadNameError(
        f"{file.path}: has no matrix or vector {channel!r}; there is {_listed(file)}"
    )


def _unclear(file: RawFile, values: Values) -> FormatMismatchError | UnsupportedFeatureError:
    maps = _maps(values)
    if maps:
        return FormatMismatchError(
            f"{file.path}: holds {len(maps)} matrices ({_listed(file)}); choose one with "
            f"channel={maps[0]!r}"
        )
    left = f" (omitted: {', '.join(values.left_out[:8])})" if values.left_out else ""
    return UnsupportedFeatureError(
        f"{file.path}: holds no matrix and no vector of real numbers{left}; save some as variables"
    )


def _listed(file: RawFile) -> str:
    names = channels(file)
    return ", ".join(map(repr, names[:12])) + (" ..." if len(names) > 12 else "") or "none"


# ---- captures of dSPACE in a MATLAB file: a struct with times X and channels Y, each with a Name ----
# ``X(1).Data`` are the times in s, ``Y(i).Data`` the samples, ``Capture.SamplingPeriod`` the step.

_CAPTURE = re.compile(r"(.+)\.Y(?:\((\d+)\))?\.Data")


def _captures(values: Values) -> dict[str, list[str]]:
    """Return each capture with the prefixes of its channels, such as ``capture.Y(2)``."""
    found: dict[str, list[str]] = {}
    for name in values.numbers:
        match = _CAPTURE.fullmatch(name)
        if match is None:
            continue
        prefix = name.removesuffix(".Data")
        if f"{prefix}.Name" in values.texts and _clock(values, match[1]) is not None:
            found.setdefault(match[1], []).append(prefix)
    return found


def trace_names(values: Values) -> dict[str, dict[str, str]]:
    """Return the channels of every capture."""
    return {name: _traces(values, parts) for name, parts in _captures(values).items()}


def _traces(values: Values, prefixes: list[str]) -> dict[str, str]:
    """Return the names of channels with their prefixes; a name that is taken gets a number."""
    named: dict[str, str] = {}
    for prefix in prefixes:
        name = text = values.texts[f"{prefix}.Name"] or prefix
        count = 1
        while name in named:
            count += 1
            name = f"{text} ({count})"
        named[name] = prefix
    return named


def _clock(values: Values, capture: str) -> str | None:
    """Return the name of the times or of the sampling period of a capture."""
    names = (f"{capture}.X.Data", f"{capture}.X(1).Data", f"{capture}.Capture.SamplingPeriod")
    return next((n for n in names if n in values.numbers), None)


def find_capture(
    file: RawFile, values: Values, channel: str | None
) -> tuple[str, dict[str, str]] | None:
    """Return the capture that is meant, and its channels."""
    captures = trace_names(values)
    if channel is None:
        if len(captures) > 1:
            raise FormatMismatchError(
                f"{file.path}: holds {len(captures)} captures ({', '.join(captures)}); choose one with "
                f"channel={next(iter(captures))!r}"
            )
        return next(iter(captures.items()), None)
    for name, traces in captures.items():
        if channel == name:
            return name, traces
        if channel in traces:
            return name, {channel: traces[channel]}
    return None


def recording_of(
    file: RawFile,
    format_id: str,
    values: Values,
    capture: str,
    traces: dict[str, str],
    *,
    unit: Any,
) -> Recording:
    """Return the channels of a capture over its times."""
    if f"{capture}.X(2).Data" in values.numbers:
        raise UnsupportedFeatureError(
            f"{file.path}: capture {capture!r} has several axes of time (X), and which channel has which is "
            "not known; export the channels of one raster"
        )
    clock = _clock(values, capture) or ""
    period = values.numbers.get(f"{capture}.Capture.SamplingPeriod")
    period_s = None if period is None else float(period.ravel()[0])
    data = Channels(file)
    for name, prefix in traces.items():
        samples = np.asarray(values.numbers[f"{prefix}.Data"].ravel(), dtype=np.float64)
        if clock.endswith("Data"):
            t = np.asarray(values.numbers[clock].ravel(), dtype=np.float64)
        elif period_s is not None and 0.0 < period_s < np.inf:
            t = period_s * np.arange(samples.size, dtype=np.float64)
        else:
            raise file.corrupt("the sampling period is not positive", field=clock, found=period_s)
        if t.size != samples.size:
            raise file.corrupt(
                "a channel and its times differ in length",
                field=prefix,
                expected=f"{t.size} samples",
                found=f"{samples.size}",
            )
        data.add(name, t, samples, values.texts.get(f"{prefix}.Unit", ""))
    return data.recording(
        format_id,
        values.header,
        unit=unit,
        capture=capture,
        sampling_period_s=period_s,
    )


# ---- values of a MATLAB file as flat names: ``z``, ``capture.Y(2).Name``, ``cells{1}`` ---------
# Version 5 is decoded by `metrosep.io.containers.matlab`; version 7.3 is HDF5 with a block of text before it,
# and stores arrays transposed.

V5, V73 = "5.0", "7.3"

_MARKS = {V5: b"MATLAB 5.0 MAT-file", V73: b"MATLAB 7."}
_HDF5_START = 512
_LONGEST_TEXT = 1000


@dataclass
class Values:
    """What the variables of a file hold, by flat name."""

    # to ndarray: arrays that are not empty, in the shape of MATLAB
    numbers: dict[str, NDArray[Any]] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)  # to str: texts, one line per row
    # names of what is not read: objects, functions, sparse and complex arrays
    left_out: list[str] = field(default_factory=list)
    # what the metadata of the file are to say
    header: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, value: Any) -> None:
        """Add a value, and what is inside it."""
        if isinstance(value, Structs):
            alone = len(value.items) == 1
            for i, item in enumerate(value.items, start=1):
                for key, part in item.items():
                    self.add(f"{name}.{key}" if alone else f"{name}({i}).{key}", part)
        elif isinstance(value, list):
            for i, part in enumerate(value, start=1):
                self.add(f"{name}{{{i}}}", part)
        elif isinstance(value, str):
            self.texts[name] = value[:_LONGEST_TEXT]
        elif value is None:
            self.left_out.append(name)
        elif value.size:
            self.numbers[name] = value


def version_of(head: bytes) -> str | None:
    """Return the version of a MATLAB file."""
    if head.startswith(_MARKS[V5]) and head[126:128] in (b"IM", b"MI"):
        return V5
    if head.startswith(_MARKS[V73]) and head.startswith(HDF5_MAGIC, _HDF5_START):
        return V73
    return None


def load(file: RawFile, max_pixels: int | None = None) -> Values:
    """Return the values of all variables."""
    version = version_of(file.head)
    if version is None:
        raise mismatch(file, FORMAT)
    text = file.head[: HEADER_BYTES - 12].split(b"\0")[0].decode("latin-1").strip()
    values = Values(header={"text": text, "version": version})
    if version == V5:
        _load_v5(file, values, max_pixels or MAX_PIXELS)
    else:
        with open_hdf5(file) as handle:
            _load_v73(handle, values, max_pixels)
    shapes = {n: " x ".join(map(str, v.shape)) for n, v in values.numbers.items() if v.size > 1}
    single = {n: _plain(v) for n, v in values.numbers.items() if v.size == 1}
    values.header |= {"shapes": shapes, "scalars": single, "texts": dict(values.texts)}
    values.header["left_out"] = list(values.left_out)
    return values


def _plain(value: NDArray[Any]) -> int | float:
    number = value.ravel()[0].item()
    return number if isinstance(number, float) else int(number)


def _load_v5(file: RawFile, values: Values, max_pixels: int) -> None:
    values.header["byte_order"] = "little" if byte_order(file) == "<" else "big"
    for name, value in variables(file, max_bytes=8 * max_pixels):
        if name:  # the one without a name belongs to MATLAB itself
            values.add(name, value)


def _load_v73(handle: Hdf5File, values: Values, max_pixels: int | None) -> None:
    for path in handle.datasets:
        name = path.strip("/").replace("/", ".")
        own = handle.attributes(path)
        kind = str(own.get("MATLAB_class", ""))
        if name.startswith("#") or own.get("MATLAB_empty"):
            continue
        if not handle.is_numeric(path) or 0 in handle.shape(path):
            values.left_out.append(name)
            continue
        array = handle.read(path, max_pixels=max_pixels).T
        if kind == "char":
            values.texts[name] = _letters(array)
        else:
            values.numbers[name] = array


def _letters(array: NDArray[Any]) -> str:
    """Return the text of an array of UTF-16 codes, one line per row."""
    codes = np.atleast_2d(array)[:, :_LONGEST_TEXT].astype("<u2")
    rows = (row.tobytes().decode("utf-16-le", "replace").rstrip() for row in codes)
    return "\n".join(rows)[:_LONGEST_TEXT]


# ---- MATLAB files of version 5 to 7: a header of 128 bytes, then variables, plain or packed by zlib ----

HEADER_BYTES = 128

_PACKED = 15
_MAX_RATIO = 1032
"""Largest ratio that deflate can reach."""


def byte_order(file: RawFile) -> str:
    """Return the byte order of a v5 file for `struct`."""
    mark = file.head[126:128]
    if mark not in (b"IM", b"MI"):
        raise file.corrupt(
            "the mark of the byte order is damaged",
            field="endian indicator",
            offset=126,
            expected="IM or MI",
            found=repr(mark),
        )
    return "<" if mark == b"IM" else ">"


def variables(file: RawFile, *, max_bytes: int) -> Iterator[tuple[str, Any]]:
    """Return the variables of a v5 file, one after another."""
    order, data = byte_order(file), file.data
    position, budget = HEADER_BYTES, max_bytes
    if position >= len(data):
        raise file.corrupt("holds no variable", offset=HEADER_BYTES)
    while position < len(data):
        if len(data) - position < 8:
            left = f"{len(data) - position} bytes"
            raise misfit(file, "a tag", position, "8 bytes", left)
        kind, size = struct.unpack_from(order + "II", data, position)
        start, end = position + 8, position + 8 + size
        if kind not in (MATRIX, _PACKED) or end > len(data):
            expected = f"a matrix in {len(data) - start} bytes"
            raise misfit(file, "a variable", position, expected, f"type {kind} in {size} bytes")
        if kind == _PACKED:
            element = _inflated(file, data[start:end], order, position, budget)
        else:
            element = data[position:end]
        budget -= len(element)
        if budget < 0:
            raise _too_large(file, max_bytes)
        yield variable(file, element, order, position)
        position = end


def _inflated(file: RawFile, packed: bytes, order: str, where: int, budget: int) -> bytes:
    """Return the element inside a packed one, inflated up to the bytes that its tag claims."""
    inflater = zlib.decompressobj()
    what = "a packed variable"
    try:
        tag = inflater.decompress(packed, 8)
        kind, size = struct.unpack(order + "II", tag)
        if kind != MATRIX or size > _MAX_RATIO * len(packed):
            raise misfit(file, what, where, "a matrix", f"type {kind} in {size} bytes")
        if size + 8 > budget:
            raise _too_large(file, budget)
        body = inflater.decompress(inflater.unconsumed_tail, size) if size else b""
        surplus = inflater.decompress(inflater.unconsumed_tail, 1)
    except (zlib.error, struct.error) as exc:
        raise file.corrupt(f"{what} cannot be inflated ({exc})", offset=where) from None
    if len(body) != size or surplus or not inflater.eof:
        found = f"{len(body) + len(surplus)} bytes or more"
        raise misfit(file, what, where, f"{size} bytes and the end", found)
    return tag + body


def _too_large(file: RawFile, limit: int) -> UnsupportedFeatureError:
    return UnsupportedFeatureError(
        f"{file.path}: its variables take more than the {limit} bytes allowed; save fewer, or pass "
        "max_pixels= if that is true"
    )


# ---- one variable of a MATLAB v5 file: its elements are checked against what encloses them, and decoded ----
# An element is a tag (type, bytes) and its data, padded to 8 bytes; up to 4 bytes may stand inside
# the tag itself. SciPy is not used: it crashes the process on some damaged files.

MATRIX = 14
"""Type of the element that holds a variable."""

_INT8, _UINT16, _INT32, _UINT32, _UTF8, _UTF16, _UTF32 = 1, 4, 5, 6, 16, 17, 18
_DTYPES = {
    _INT8: "i1",
    2: "u1",
    3: "i2",
    _UINT16: "u2",
    _INT32: "i4",
    _UINT32: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    _UTF8: "u1",
    _UTF16: "u2",
    _UTF32: "u4",
}
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_NUMERIC = range(6, 16)
_NOT_READ = (_OBJECT, _SPARSE, _FUNCTION)
_COMPLEX = 0x0800

_MAX_DEPTH = 16
_MAX_ELEMENTS = 200_000
_MAX_NAME = 255
_MAX_DIMENSIONS = 32


class Structs(NamedTuple):
    """An array of structs."""

    items: list[dict[str, Any]]  # of dict: field to value, for each struct


class _Element(NamedTuple):
    """Type of an element, where its data begin and end, and where the next one begins."""

    type: int
    start: int
    end: int
    next: int


def variable(file: RawFile, data: bytes, order: str, where: int) -> tuple[str, Any]:
    """Return the name and the value of a variable."""
    decoder = _Decoder(file, data, order, where)
    return decoder.matrix(decoder.tag(0, len(data)), 0)


def misfit(
    file: RawFile, what: str, offset: int, expected: object, found: object
) -> CorruptFileError:
    """Return the error for something whose size or type does not fit."""
    return file.corrupt(f"{what} does not fit", offset=offset, expected=expected, found=found)


@dataclass
class _Decoder:
    """Bytes of one variable, and how many of its elements were seen."""

    file: RawFile
    data: bytes
    order: str
    where: int
    n_elements: int = 0

    def tag(self, position: int, end: int) -> _Element:
        """Return the element at a position; it must end before `end`."""
        self.n_elements += 1
        if self.n_elements > _MAX_ELEMENTS:
            raise UnsupportedFeatureError(
                f"{self.file.path}: a variable has more than {_MAX_ELEMENTS} elements; save the "
                "numbers as plain arrays"
            )
        if end - position < 8:
            raise self.misfit("a tag", position, "8 bytes", f"{max(end - position, 0)} bytes")
        first, size = struct.unpack_from(self.order + "II", self.data, position)
        if first >> 16:
            size, start, after = first >> 16, position + 4, position + 8
            kind = first & 0xFFFF
            if size > 4:
                raise self.misfit("a small element", position, "1 to 4 bytes", f"{size} bytes")
        else:
            kind, start = first, position + 8
            after = start + size if kind == MATRIX else start + size + -size % 8
        if start + size > end or (kind != MATRIX and kind not in _DTYPES):
            found = f"type {kind} in {size} bytes"
            raise self.misfit("an element", position, f"data in {end - start} bytes", found)
        if kind != MATRIX and size % np.dtype(_DTYPES[kind]).itemsize:
            raise self.misfit("an element", position, "whole values", f"{size} bytes")
        return _Element(kind, start, start + size, min(after, end))

    def matrix(self, element: _Element, depth: int) -> tuple[str, Any]:
        """Return the name and the value of a matrix, and check all inside it."""
        if element.type != MATRIX or depth > _MAX_DEPTH:
            found = f"type {element.type} at depth {depth}"
            raise self.misfit("a variable", element.start, "a matrix", found)
        if element.start == element.end:  # how an empty cell or field is written
            return "", np.empty(0)
        flags = self.part(element.start, element.end, (_UINT32,), 2)
        word = int(self.array(flags)[0])
        kind = word & 0xFF
        if kind == _OPAQUE:  # an object of a class: its name stands where others have dimensions
            return self.text(self.part(flags.next, element.end, (_INT8, _UTF8))), None
        if kind not in (_CELL, _STRUCT, _CHAR, *_NUMERIC, *_NOT_READ):
            raise self.misfit("a variable", flags.start, "a known class", f"class {kind}")
        sizes = self.part(flags.next, element.end, (_INT32, _UINT32))
        shape = tuple(self.array(sizes).tolist())
        if not 2 <= len(shape) <= _MAX_DIMENSIONS or min(shape) < 0:
            raise self.misfit("the dimensions", sizes.start, "2 or more", shape[:4])
        name = self.part(sizes.next, element.end, (_INT8, _UTF8))
        if name.end - name.start > _MAX_NAME:
            size = f"{name.end - name.start} bytes"
            raise self.misfit("a name", name.start, f"up to {_MAX_NAME} bytes", size)
        is_complex = bool(word & _COMPLEX)
        return self.text(name), self.content(
            kind, shape, name.next, element.end, depth, is_complex
        )

    def content(
        self,
        kind: int,
        shape: tuple[int, ...],
        position: int,
        end: int,
        depth: int,
        is_complex: bool,
    ) -> Any:
        """Return what follows the name of a matrix."""
        value: Any = None
        if kind in _NOT_READ:
            return None
        if kind in _NUMERIC:
            value, position = self.numbers(shape, position, end)
            if is_complex:
                _, position = self.numbers(shape, position, end)
                value = None
        elif kind == _CHAR:
            value, position = self.letters(shape, position, end)
        else:
            fields = None
            if kind == _STRUCT:
                fields, position = self.fields(position, end)
            value, position = self.items(fields, _product(shape), position, end, depth)
        if end - position >= 8:
            raise self.misfit("a variable", position, "its end", f"{end - position} more bytes")
        return value

    def numbers(self, shape: tuple[int, ...], position: int, end: int) -> tuple[NDArray[Any], int]:
        """Return the real or imaginary part of an array, and where the next part begins."""
        part = self.tag(position, end)
        if part.type == MATRIX:
            raise self.misfit("an array", part.start, "numbers", f"type {part.type}")
        values = self.array(part)
        if values.size != _product(shape):
            found = f"{values.size} values of type {part.type}"
            raise self.misfit("an array", part.start, f"{_product(shape)} values", found)
        return values.reshape(shape, order="F"), part.next

    def letters(self, shape: tuple[int, ...], position: int, end: int) -> tuple[str, int]:
        """Return a text, one line per row; it may be shorter than its dimensions, or absent."""
        if position == end:
            return "", position
        part = self.tag(position, end)
        if part.type == MATRIX:
            raise self.misfit("a text", part.start, "letters", f"type {part.type}")
        raw = self.data[part.start : part.end]
        suffix = "le" if self.order == "<" else "be"
        if part.type in (_UINT16, _UTF16):
            text = raw.decode(f"utf-16-{suffix}", "replace")
        elif part.type == _UTF32:
            text = raw.decode(f"utf-32-{suffix}", "replace")
        else:
            text = raw.decode("utf-8", "replace")
        if len(text) > _product(shape):
            found = f"{len(text)} letters"
            raise self.misfit("a text", part.start, f"{_product(shape)} letters", found)
        n_rows = min(shape[0], len(text))
        return "\n".join(text[row::n_rows].rstrip() for row in range(n_rows)), part.next

    def fields(self, position: int, end: int) -> tuple[list[str], int]:
        """Return the names of the fields of a struct, and where their values begin."""
        length = self.part(position, end, (_INT32, _UINT32), 1)
        width = int(self.array(length)[0])
        names = self.part(length.next, end, (_INT8,))
        size = names.end - names.start
        if width < 1 or size % width:
            expected = f"{width} bytes each"
            raise self.misfit("names of fields", names.start, expected, f"{size} bytes")
        raw = (self.data[i : i + width] for i in range(names.start, names.end, width))
        return [name.split(b"\0")[0].decode("utf-8", "replace") for name in raw], names.next

    def items(
        self, fields: list[str] | None, count: int, position: int, end: int, depth: int
    ) -> tuple[list[Any] | Structs, int]:
        """Return the cells, or the structs with these fields, and where they end."""
        per_item = 1 if fields is None else len(fields)
        left = (end - position) // 8
        if count * per_item > left or count > _MAX_ELEMENTS:
            raise self.misfit("a list", position, f"{left} elements", f"{count} x {per_item}")
        values: list[Any] = []
        for _ in range(count * per_item):
            part = self.tag(position, end)
            values.append(self.matrix(part, depth + 1)[1])
            position = part.next
        if fields is None:
            return values, position
        rows = (values[i * per_item : (i + 1) * per_item] for i in range(count))
        return Structs([dict(zip(fields, row, strict=True)) for row in rows]), position

    def part(
        self, position: int, end: int, types: tuple[int, ...], count: int | None = None
    ) -> _Element:
        """Return the element at a position, which must be of a type and hold so many values."""
        element = self.tag(position, end)
        size = element.end - element.start
        if element.type not in types or count not in (None, self.array(element).size):
            expected = f"type {types[0]}" + (f" with {count} values" if count else "")
            found = f"type {element.type} in {size} bytes"
            raise self.misfit("an element", element.start, expected, found)
        return element

    def array(self, element: _Element) -> NDArray[Any]:
        """Return the numbers of an element, without a copy."""
        dtype = np.dtype(_DTYPES[element.type]).newbyteorder("<" if self.order == "<" else ">")
        count = (element.end - element.start) // dtype.itemsize
        return np.frombuffer(self.data, dtype=dtype, count=count, offset=element.start)

    def text(self, element: _Element) -> str:
        """Return the text of a name."""
        return self.data[element.start : element.end].split(b"\0")[0].decode("utf-8", "replace")

    def misfit(self, what: str, offset: int, expected: object, found: object) -> CorruptFileError:
        """Return the error; the offset is that of the variable in the file."""
        inside = f"{what} (byte {offset} of the variable)"
        return misfit(self.file, inside, self.where, expected, found)


def _product(shape: tuple[int, ...]) -> int:
    count = 1
    for n in shape:
        count *= n
    return count
