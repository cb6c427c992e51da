"""A document as JSON text: the bytes of `json.dumps`, but long lists of numbers in a third of the time.

Most of a result are maps for the pictures, rounded to four digits. There are few such numbers, so
their texts are kept in tables, one for each decade.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["document_text"]

_SHORTEST = 256
"""Numbers of a list from which the tables pay."""

_DIGITS = 4
_FULL = 10**_DIGITS
_DECIMALS = 22
"""10 to this power is a float without error, and so is a whole number of four digits: their quotient is
the float nearest to the decimal number, which is what its text reads back to."""

_POWERS = np.array([float(f"1e{k}") for k in range(_DECIMALS + 1)])
_MARK = "\0numbers {}\0"
_FOUND = re.compile(r'"\\u0000numbers (\d+)\\u0000"')
_PLAIN = ({float}, {float, type(None)})


def document_text(document: Mapping[str, Any]) -> str:
    """Return a document as JSON with sorted keys, without spaces: half the size, several times as fast.

    Examples
    --------
    >>> document_text({"b": [1.5, None], "a": 2})
    '{"a":2,"b":[1.5,null]}'
    """
    lists: list[str] = []
    swapped = _swapped(document, lists)
    text = _dumps(swapped)
    if not lists:
        return text
    parts = _FOUND.split(text)
    marks = [int(k) for k in parts[1::2]]
    if sorted(marks) != list(range(len(lists))):  # a text of the document looks like a mark
        return _dumps(document)
    parts[1::2] = [lists[k] for k in marks]
    return "".join(parts)


def _dumps(value: Any) -> str:
    return json.dumps(value, sort_keys=True, allow_nan=False, separators=(",", ":"))


def _swapped(value: Any, lists: list[str]) -> Any:
    """Return a value with marks in place of long lists of numbers, whose texts go to `lists`."""
    if isinstance(value, dict | Mapping):
        return {k: _swapped(v, lists) for k, v in value.items()}
    if not isinstance(value, list | tuple):
        return value
    if len(value) >= _SHORTEST and set(map(type, value)) in _PLAIN:
        lists.append(_joined(_texts(value)))
    elif _is_table(value):
        n = len(value[0])
        texts = _texts(list(chain.from_iterable(value)))
        lists.append(_joined(_joined(texts[i : i + n]) for i in range(0, len(texts), n)))
    else:
        return [_swapped(v, lists) for v in value]
    return _MARK.format(len(lists) - 1)


def _is_table(value: list[Any] | tuple[Any, ...]) -> bool:
    """Return whether a value is rows of equal length with numbers and None only, and many of them."""
    if not value or set(map(type, value)) != {list}:
        return False
    n = len(value[0])
    if n * len(value) < _SHORTEST or set(map(len, value)) != {n}:
        return False
    return set(map(type, chain.from_iterable(value))) in _PLAIN


def _joined(texts: Iterable[str]) -> str:
    return f"[{','.join(texts)}]"


def _texts(values: list[float | None] | tuple[float | None, ...]) -> list[str]:
    """Return the JSON text of each number: from a table where it has four digits."""
    array = np.array(values, dtype=np.float64)  # None becomes NaN
    size = np.abs(array)
    with np.errstate(divide="ignore", invalid="ignore"):
        decimals = _DIGITS - 1 - np.floor(np.log10(size))
        usual = (decimals >= 0) & (decimals <= _DECIMALS)
        power = _POWERS[np.where(usual, decimals, 0).astype(np.intp)]
        digits = np.rint(size * power)
        usual &= (digits < _FULL) & (digits / power == size)
    digits += np.where(array < 0, _FULL, 0)
    texts = np.empty(array.size, dtype=object)
    left = np.ones(array.size, dtype=np.bool_)
    whole = np.where(usual, decimals, -1).astype(np.int8)
    for k in np.flatnonzero(np.bincount(whole + 1, minlength=1)[1:] >= _FULL // 10):
        these = np.flatnonzero(whole == k)
        texts[these] = _table(int(k))[digits[these].astype(np.intp)]
        left[these] = False
    for i in np.flatnonzero(left).tolist():
        texts[i] = _text(values[i])
    return texts.tolist()


def _text(value: float | None) -> str:
    if value is None:
        return "null"
    if value - value != 0.0:
        raise ValueError(f"Out of range float values are not JSON compliant: {value!r}")
    return float.__repr__(value)


@lru_cache(maxsize=16)
def _table(decimals: int) -> NDArray[np.object_]:
    """Return the texts of four digits at so many decimals; the negative ones follow."""
    known = [float.__repr__(v) for v in (np.arange(_FULL) / _POWERS[decimals]).tolist()]
    return np.array(known + [f"-{text}" for text in known], dtype=object)
