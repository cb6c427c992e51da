"""Numbers that stand in text with white space between them: millions of them, quickly and strictly.

Shared by the readers of maps written as text. A field that is no number is named by its offset.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from fractions import Fraction
from functools import cache

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError
from metrosep.io.source import RawFile

__all__ = ["one_number", "parse_numbers"]

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
    raise CorruptFileError(
        file.path,
        f"{what} is no number",
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
        raise CorruptFileError(
            file.path,
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
    caller has another. A field that is no number gives None as well.
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
