"""Lines, numbers and channels of text: what the readers of text share.

A number is checked field by field, so that damage is named by its line; millions of numbers between
white space are read at once, as strictly. A unit is what the file or the caller declares, and channels
are joined on one axis of time.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    ReadError,
    ReadNameError,
    UnitError,
)
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.core.units import Unit, parse_unit
from metrosep.io.objects import SI_NAMES
from metrosep.io.source import RawFile, open_file
from metrosep.io.text.dialect import holds_counts, is_number
from metrosep.io.text.encoding import MISSING, decode

_LONGEST_TOP = 2**24
"""Bytes that a recogniser looks at: no header of text is longer."""


def first_lines(file: RawFile, encoding: str | None = None) -> Iterator[str]:
    """Yield whole lines from the top, as `text_lines` gives them, no further than they are asked for."""
    shown, content = 0, file.head_lines
    while True:
        try:
            lines = decode(content, file.path, encoding)[0].split("\n")
        except ReadError:
            return
        is_whole = len(content) >= file.size
        yield from lines[shown : len(lines) - (not is_whole)]
        if is_whole or len(content) >= _LONGEST_TOP:
            return
        shown = max(shown, len(lines) - 1)
        with file.stream() as handle:
            content = handle.read(_LONGEST_TOP)


def text_lines(file: RawFile) -> list[str]:
    """Return the lines of a text file; the last is empty when the file ends with a line end."""
    return decode(file.data, file.path)[0].split("\n")


def to_number(file: RawFile, text: str, *, line: int, name: str, decimal: str = ".") -> float:
    """Return the number in a field."""
    field = text.strip()
    if field.lower() in MISSING:
        return float("nan")
    if is_number(field, decimal):
        value = float(field.replace(",", ".").replace("d", "e").replace("D", "e"))
        if np.isfinite(value):
            return value
    raise file.corrupt(
        f"{name} is not a number",
        field=f"line {line}",
        expected=f"a number with decimal mark {decimal!r}",
        found=repr(field[:40]),
    )


def plain_block(
    rows: Sequence[str],
    columns: Iterable[int],
    *,
    separator: str | None = None,
    decimal: str = ".",
    counts: Iterable[int] = (),
) -> FloatArray | None:
    """Return the numbers of rows by the C parser of NumPy, or ``None`` where one is not plain.

    Rows with a gap, a word or another count of fields are for `to_number`, which names the line.
    """
    if separator and {row.count(separator) + 1 for row in rows} - set(counts):
        return None
    if decimal == ",":
        if any("." in row for row in rows):
            return None
        rows = [row.replace(",", ".") for row in rows]
    where = list(columns)
    try:
        block = np.loadtxt(rows, delimiter=separator, comments=None, usecols=where, ndmin=2)
    except ValueError:
        return None
    return block if block.shape[0] == len(rows) and np.isfinite(block).all() else None


def with_units(file: RawFile, labels: Mapping[str, str], unit: Any) -> dict[str, Unit | None]:
    """Return the unit of each channel."""
    known = {name: _unit_or_none(label) for name, label in labels.items()}
    if unit is None:
        return known
    if isinstance(unit, str):
        shared = parse_unit(unit)
        bare = [name for name, label in labels.items() if not _bare(label)]
        if not bare:
            shown = ", ".join(
                f"{n!r} in {_bare(label)!r}" for n, label in list(labels.items())[:8]
            )
            raise FormatMismatchError(
                f"{file.path}: every channel states a unit of its own ({shown}), so one for all cannot be "
                "given; declare those that metrosep does not know by name, unit={'channel': 'um'}"
            )
        taken = {name for name in bare if not holds_counts(name)}
        if not taken:
            raise UnitError(
                f"{file.path}: {', '.join(map(repr, bare))}: counts, which are not in {shared.name}; state by name "
                f"what one count is, if that is 1 {shared.name}: unit={{{bare[0]!r}: {shared.name!r}}}"
            )
        return {name: shared if name in taken else own for name, own in known.items()}
    if not isinstance(unit, Mapping):
        raise FormatMismatchError(
            f"{file.path}: unit= must be one unit, or a mapping of channel to unit"
        )
    for name, text in unit.items():
        if name not in known:
            raise ReadNameError(
                f"{file.path}: has no channel {name!r}; the channels are {', '.join(known)}"
            )
        declared, own = parse_unit(str(text)), known[name]
        if own is not None and own != declared:
            raise FormatMismatchError(
                f"{file.path}: channel {name!r} is in {own.name} by the file, but {declared.name} was "
                "given; leave it out"
            )
        known[name] = declared
    return known


def _bare(label: str) -> str:
    return label.strip().strip("[]()").strip()


def _unit_or_none(label: str) -> Unit | None:
    try:
        return parse_unit(_bare(label))
    except UnitError:
        return None


class Channels:
    """Samples of each channel with its own times, made into one recording."""

    def __init__(self, file: RawFile) -> None:
        self._file = file
        self._t: dict[str, FloatArray] = {}
        self._values: dict[str, FloatArray] = {}
        self._labels: dict[str, str] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the file."""
        return tuple(self._values)

    def add(self, name: str, t: FloatArray, values: FloatArray, label: str = "") -> None:
        """Add a channel; a name that is taken gets a number."""
        unique, count = name or "channel", 1
        while unique in self._values:
            count += 1
            unique = f"{name} ({count})"
        self._t[unique], self._values[unique], self._labels[unique] = t, values, label

    def recording(
        self,
        format_id: str,
        header: Mapping[str, Any],
        *,
        channel: str | None = None,
        unit: Any = None,
        union: bool = False,
        warnings: tuple[str, ...] = (),
        steps: Sequence[Step] = (),
        **facts: Any,
    ) -> Recording:
        """Return the channels on one axis of time, in SI where the unit is known."""
        units = with_units(self._file, self._labels, unit)
        names = self._chosen(channel)
        t = self._time(names, union=union)
        columns: dict[str, FloatArray] = {}
        for name in names:
            column = np.full(t.size, np.nan)
            where = np.searchsorted(t, self._t[name]) if union else slice(0, self._t[name].size)
            own = units[name]
            column[where] = self._values[name] * (own.factor if own is not None else 1.0)
            columns[name] = column
        if not any(np.isfinite(c).any() for c in columns.values()):
            raise self._file.corrupt("no channel holds a number")
        metadata = self._file.metadata(
            format_id,
            header,
            warnings=warnings,
            units_in_file={n: self._labels[n] for n in names},
            **facts,
        )
        try:
            return Recording(
                t,
                columns,
                units={n: SI_NAMES.get(u.dimension, "") for n in names if (u := units[n])},
                metadata=metadata,
                history=(*self._file.history(format_id, {"channels": tuple(columns)}), *steps),
            )
        except DataError as exc:
            raise self._file.corrupt(f"the samples do not fit: {exc}") from None

    def _chosen(self, channel: str | None) -> tuple[str, ...]:
        if not self._values:
            raise self._file.corrupt("holds no channel")
        if channel is None:
            return self.names
        if channel not in self._values:
            raise ReadNameError(
                f"{self._file.path}: has no channel {channel!r}; the channels are "
                f"{', '.join(self.names[:20])}"
            )
        return (channel,)

    def _time(self, names: tuple[str, ...], *, union: bool) -> FloatArray:
        if union:
            return np.unique(np.concatenate([self._t[n] for n in names]))
        longest = max(names, key=lambda n: self._t[n].size)
        t = self._t[longest]
        for name in names:
            own = self._t[name]
            if not np.array_equal(own, t[: own.size]):
                raise FormatMismatchError(
                    f"{self._file.path}: channels {longest!r} and {name!r} have different times; read "
                    f"one at a time with channel={name!r}"
                )
        return t


# ---- measurements that take several files: the one that belongs to another, found by its stem only ----


def also_read(data: RawFile, **parameters: Any) -> Step:
    """Return the step of a history that says which file was read beside the one of that name."""
    facts = {"file": data.name, "sha256": data.sha256, "size": data.size}
    return Step("read_columns", {**facts, **parameters})


def beside(file: RawFile, suffixes: Sequence[str]) -> RawFile:
    """Return the file of the same stem in the same folder; content never names it."""
    for suffix in suffixes:
        path = file.path.with_suffix(suffix)
        if path.name != file.name and path.is_file():
            return open_file(path)
    raise ReadError(
        f"{file.path}: describes {file.path.with_suffix(suffixes[0]).name}, which does not lie beside "
        "it; put both into one folder"
    )


# ---- columns of numbers without any header, over time: the caller declares names, interval and scale ----
# Shared by the formats that nothing in the file describes (LinuxCNC halsampler, PMAC gather).

_OTHER_FILE = {"hint": "check how many lines stand above the rows, or copy both files again"}


def number_block(
    file: RawFile,
    rows: Sequence[tuple[int, str]],
    *,
    names: Sequence[str] = (),
    separator: str | None = None,
    decimal: str = ".",
    where: str = "",
) -> FloatArray:
    """Return the numbers of rows (line, text): a column for each name, or as many as the first row."""
    if not rows:
        raise file.corrupt(f"holds no row of numbers{where}", field="the end")
    split = [text.split(separator) for _, text in rows]
    n = len(names) or len(split[0])
    for (line, text), fields in zip(rows, split, strict=True):
        if len(fields) != n:
            raise file.corrupt(
                f"a row has another number of fields than the others{where}",
                field=f"line {line}",
                expected=f"{n} numbers",
                found=f"{len(fields)} in {text.strip()[:40]!r}",
                **_OTHER_FILE if where else {},
            )
    texts = [text for _, text in rows]
    block = plain_block(texts, range(n), separator=separator, decimal=decimal, counts=(n,))
    if block is not None:
        return block
    shown = [name[:40] for name in names] or [f"column {j}{where}" for j in range(n)]
    return np.array(
        [
            [
                to_number(file, field, line=line, name=name, decimal=decimal)
                for field, name in zip(fields, shown, strict=True)
            ]
            for (line, _), fields in zip(rows, split, strict=True)
        ]
    )


def numbered_rows(lines: Iterable[str], first: int = 1) -> list[tuple[int, str]]:
    """Return the lines that are not blank, each with its number."""
    return [(n, line) for n, line in enumerate(lines, start=first) if line.strip()]


# ---- numbers that stand in text with white space between them: millions of them, quickly and strictly ----
# Shared by the readers of maps written as text. A field that is not a number is named by its offset.

_NUMBER = rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?nan"
_ODD = re.compile(rb"(?<!\S)(?!(?:" + _NUMBER + rb")(?!\S))\S+", re.IGNORECASE)
_LONG = 20_000
"""Bytes from which numbers are taken all at once."""
_ONE = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")


def parse_numbers(
    file: RawFile,
    text: bytes,
    *,
    offset: int = 0,
    missing: Sequence[bytes] = (),
    what: str = "a height",
) -> FloatArray:
    """Return the numbers in a text, in its order."""
    plain = text
    for word in missing:
        if word in text:
            plain = plain.replace(word, b"nan")
    found = parse_decimals(plain) if len(plain) > _LONG else None
    if found is not None:
        return found
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy before 2.3 only warns
            return np.fromstring(plain, dtype=np.float64, sep=" ") if plain.strip() else _NONE
    except (ValueError, DeprecationWarning):
        pass
    odd = _first_odd(text, missing)
    raise file.corrupt(
        f"{what} is not a number",
        offset=offset + (odd.start() if odd else 0),
        expected="numbers separated by white space",
        found=repr(odd.group()[:20].decode("latin-1")) if odd else None,
    ) from None


_NONE: FloatArray = np.empty(0, dtype=np.float64)


def _first_odd(text: bytes, missing: Sequence[bytes]) -> re.Match[bytes] | None:
    """Return the first field that is neither a number nor a word for "not measured"."""
    for word in missing:  # same length, so that offsets stay true
        text = text.replace(word, b"0" * len(word))
    return _ODD.search(text)


def one_number(
    file: RawFile, text: str, *, line: int, name: str, low: float, high: float
) -> float:
    """Return a number of a header within its range."""
    value = float(text) if _ONE.fullmatch(text.strip()) else float("nan")
    if not low <= value <= high:  # also catches NaN
        raise file.corrupt(
            f"{name} is not usable",
            field=f"line {line}",
            expected=f"a number from {low:g} to {high:g}",
            found=repr(text.strip()[:40]),
        )
    return value


# ---- private: decimal numbers of the shape ``1.234e-08`` to floats, all at once and correctly rounded ----
# A number is ``d.fff...e+xx`` with up to 17 digits: what programs write that keep every bit. Its
# digits come out of the text eight at a time, as bytes of one word. With the digits a whole number m
# below 10^17, the value is m 10^k; the power is known as the sum of two floats to 2^-105, and the
# product is formed so (Dekker 1971), with an error below 2^-98 of it. The rounded sum is the float
# that is wanted unless the rest lies that near to half a unit in the last place; such numbers, and
# those of any other shape, are left to Python's own `float`.

Words = NDArray[np.uint64]
Indices = NDArray[np.intp]

_DIGITS = 17
_LARGEST = 40
"""Largest decimal exponent in size that is taken: no product comes near overflow or subnormals."""

_SURE = 2.0**-90
"""Distance from half a unit, as a share of the value, from which the rounding is certain: far above
the error of the product, 2^-98."""

_CHUNK = 1 << 18
"""Bytes at a time: what belongs to them stays in the cache, and no fresh memory is asked for."""

_PAD = b"0" * 32
_BLANK = re.compile(rb"[\t-\r ]")
_SPLIT = 134217729.0  # 2**27 + 1
_STRICT = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?nan", re.IGNORECASE)

_ZEROS = np.uint64(0x3030303030303030)
_KEEP = np.array([(~0 << 8 * (8 - n)) & (2**64 - 1) for n in range(9)], dtype=np.uint64)
"""Of a word, the last n bytes."""
_TENS = np.array([10**n for n in range(_DIGITS)], dtype=np.uint64)


def parse_decimals(text: bytes) -> FloatArray | None:
    """Return the numbers of a text of white space and decimal numbers.

    None where too many of them have another shape, so that this is not the way to read them; the
    caller has another. A field that is not a number gives None as well.
    """
    parts: list[FloatArray] = []
    start = 0
    while start < len(text):
        blank = _BLANK.search(text, start + _CHUNK)
        stop = blank.start() if blank else len(text)
        part = _chunk(text[start:stop])
        if part is None:
            return None
        parts.append(part)
        start = stop
    return np.concatenate(parts) if parts else np.empty(0)


def _chunk(text: bytes) -> FloatArray | None:
    padded = np.frombuffer(_PAD + text + b" " + _PAD, dtype=np.uint8)
    inside = padded[len(_PAD) : len(padded) - len(_PAD)]
    blank = (inside == 32) | ((inside - np.uint8(9)) <= 4)  # wraps below 9
    edges = np.flatnonzero(blank[1:] != blank[:-1]) + 1
    if not blank[0]:
        edges = np.concatenate([[0], edges])
    if not edges.size:
        return np.empty(0)
    starts, ends = (edges.reshape(-1, 2) + len(_PAD)).T
    powers = np.flatnonzero((padded | 32) == ord("e"))
    if powers.size != starts.size:  # where there is none: the end, which no shape has
        found, powers = powers, ends.copy()
        powers[np.searchsorted(starts, found, side="right") - 1] = found
    words = np.ndarray((padded.size - 7,), dtype="<u8", buffer=padded, strides=(1,))
    out, known = _values(padded, words, starts, powers, ends)
    odd = np.flatnonzero(~known)
    odd = odd[~_is_nan(padded, starts[odd], ends[odd])]
    if odd.size > starts.size // 8:
        return None
    shift = len(_PAD)
    out[~known] = np.nan
    try:
        for i in odd.tolist():
            out[i] = _strict(text[starts[i] - shift : ends[i] - shift])
    except ValueError:
        return None
    return out


def _is_nan(padded: NDArray[np.uint8], starts: Indices, ends: Indices) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = ends - starts == 3
    for i, letter in enumerate(b"nan"):
        found &= (padded[starts + i] | 32) == letter
    return found


def _strict(field: bytes) -> float:
    if _STRICT.fullmatch(field) is None:
        raise ValueError
    return float(field)


def _values(
    padded: NDArray[np.uint8], words: Words, starts: Indices, powers: Indices, ends: Indices
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the values of some numbers, and which of them are certain."""
    first = padded[starts]
    negative = first == ord("-")
    starts = starts + (negative | (first == ord("+")))
    lead = padded[starts] - np.uint8(ord("0"))
    known = (lead <= 9) & (padded[starts + 1] == ord(".")) & (ends - powers == 4)
    n = powers - starts - 2
    known &= (n >= 1) & (n < _DIGITS)
    n = np.where(known, n, 1)
    low, low_good = _eight(words[powers - 8] & _KEEP[np.minimum(n, 8)], np.minimum(n, 8))
    high, high_good = _eight(words[powers - 16], np.maximum(n - 8, 0))
    mantissa = lead * _TENS[n] + high * np.uint64(10**8) + low
    sign, tens, ones = (padded[powers + i] for i in (1, 2, 3))
    tens, ones = tens - np.uint8(ord("0")), ones - np.uint8(ord("0"))
    down = sign == ord("-")
    known &= low_good & high_good & (tens <= 9) & (ones <= 9) & (down | (sign == ord("+")))
    exponent = 10 * tens.astype(np.intp) + ones
    known &= exponent <= _LARGEST
    exponent = np.where(known, np.where(down, -exponent, exponent) - n, 0)
    mantissa = np.where(known, mantissa, np.uint64(0))
    values, certain = _scaled(mantissa, exponent)
    return np.where(negative, -values, values), known & certain


def _eight(word: Words, n: Indices) -> tuple[Words, NDArray[np.bool_]]:
    """Return the number that the last n bytes of words spell, and whether all are digits."""
    digits = (word ^ _ZEROS) & _KEEP[n]
    bad = ((digits + np.uint64(0x7676767676767676)) | digits) & np.uint64(0x8080808080808080)
    pairs = digits * np.uint64(10) + (digits >> np.uint64(8))
    even = (pairs & np.uint64(0x000000FF000000FF)) * np.uint64(0x000F424000000064)
    odd = ((pairs >> np.uint64(16)) & np.uint64(0x000000FF000000FF)) * np.uint64(
        0x0000271000000001
    )
    return (even + odd) >> np.uint64(32), bad == 0


def _scaled(mantissa: Words, exponent: Indices) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return m 10^k rounded, and where the rounding is certain."""
    power, power_rest = _powers()
    p, p_rest = power[exponent + _OFFSET], power_rest[exponent + _OFFSET]
    m = mantissa.astype(np.float64)
    m_rest = (mantissa.astype(np.int64) - m.astype(np.int64)).astype(np.float64)
    product = m * p
    rest = _product_error(m, p, product) + (m * p_rest + m_rest * p)
    value = product + rest
    rest += product - value
    doubt = value * _SURE  # what lies between two numbers that round alike rounds alike
    certain = (value + (rest + doubt) == value) & (value + (rest - doubt) == value)
    return value, certain


def _product_error(a: FloatArray, b: FloatArray, product: FloatArray) -> FloatArray:
    """Return a b - fl(a b) without error (Dekker)."""
    a_high, b_high = (v * _SPLIT - (v * _SPLIT - v) for v in (a, b))
    a_low, b_low = a - a_high, b - b_high
    return a_low * b_low - (((product - a_high * b_high) - a_low * b_high) - a_high * b_low)


_OFFSET = _LARGEST + _DIGITS


@cache
def _powers() -> tuple[FloatArray, FloatArray]:
    """Return the powers of ten as sums of two floats."""
    exact = [Fraction(10) ** k for k in range(-_OFFSET, _LARGEST + 1)]
    high = [float(v) for v in exact]
    low = [float(v - Fraction(h)) for v, h in zip(exact, high, strict=True)]
    return np.array(high), np.array(low)
