"""Numbers that stand in text with white space between them: millions of them, quickly and strictly.

Shared by the readers of maps written as text. A field that is no number is named by its offset.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError
from metrosep.io._exact_decimals import parse_decimals
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
