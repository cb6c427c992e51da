"""The quick way through a block of rows: quotes and marks of thousands taken off, then a compiled parser.

Each step proves from the bytes that it changes no number, or gives up, and the block is read line by
line. Nothing here knows the ledger: the caller has counted lines and separators.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

__all__ = [
    "columns_of",
    "may_hold_comments",
    "n_in",
    "single_blanks",
    "without_groups",
    "without_quotes",
]

_LONG: Final = 2**18
"""Characters from which pandas is faster, also when it must be loaded first."""
_WIDE: Final = 2**14
"""Characters of a line from which pandas, which makes each column by itself, is slower again."""


def n_in(text: str, *marks: str) -> list[int]:
    """Return how often each of some characters stands in a text, faster than `str.count`."""
    octets = np.frombuffer(text.encode("utf-8", "surrogatepass"), dtype=np.uint8)
    return [
        int(np.count_nonzero(octets == ord(m))) if m.isascii() else text.count(m) for m in marks
    ]


def may_hold_comments(text: str, mark: str) -> bool:
    """Return whether a line may be a comment, or end in a remark: such lines are looked at one by one.

    Where the semicolon separates, a comment that begins with one has an empty first field.
    """
    if any(begin in text for begin in "#%!") or ("/" in text and "//" in text):
        return True
    return mark != ";" and ";" in text


def single_blanks(text: str) -> str:
    """Return lines with one blank between their fields, and none at their ends."""
    if "\t" in text or "  " in text:
        text = re.sub(r"[^\S\n]+", " ", text)
    return text.replace("\n ", "\n").replace(" \n", "\n").strip(" ")


def without_quotes(text: str, mark: str, n_lines: int) -> tuple[str, str] | None:
    """Return lines without the quotes round their fields, and what separates these; None where one is odd.

    A quote opens behind a separator or a line end and closes before one; none may stand elsewhere.
    """
    whole = text if text.endswith("\n") else f"{text}\n"
    between, ends = whole.count(f'"{mark}"'), whole.count('"\n"')
    if whole[:1] == '"' and whole[-2:-1] == '"' and whole.count('"') == 2 * (between + ends + 1):
        plain = whole[1:-2].replace(f'"{mark}"', mark).replace('"\n"', "\n")
        if '"' not in plain and plain.count(mark) == between and ends == n_lines - 1:
            return f"{plain}\n", mark
    if "\t" in text and mark != "\t":
        return None
    octets = np.frombuffer(f"\n{text}\n".encode(), dtype=np.uint8)
    is_quote, is_end = octets == ord('"'), octets == ord("\n")
    is_mark = octets == ord(mark)
    at = np.flatnonzero(is_quote)
    is_inside = np.cumsum(is_quote) % 2 == 1
    bounds = is_mark | is_end
    if (
        at.size % 2
        or not bounds[at[::2] - 1].all()
        or not bounds[at[1::2] + 1].all()
        or (is_inside & is_end).any()
    ):
        return None
    plain_octets = np.where(is_mark & ~is_inside, ord("\t"), octets)[~is_quote]
    return bytes(plain_octets.astype(np.uint8)).decode()[1:-1], "\t"


def without_groups(
    text: str, mark: str, separator: str, decimal: str
) -> tuple[str, int, tuple[int, str], bool] | None:
    """Return a text without marks between groups of three digits; None where one is anything else.

    Beside it how many fields have one, the line, from 0, and the text of the first, and whether the mark
    is sure in all of these: a decimal mark or another group follows.
    """
    if not text.isascii() or any(e in text for e in "eEdD"):
        return None
    octets = np.frombuffer(f"\n\n\n\n{text}\n\n\n\n\n".encode(), dtype=np.uint8)
    at = np.flatnonzero(octets == ord(mark))
    is_digit = octets - np.uint8(ord("0")) < np.uint8(10)
    is_mark, is_decimal = octets == ord(mark), octets == ord(decimal)
    is_bound = (octets == ord(separator)) | (octets == ord("\n")) | (octets == ord(" "))
    is_sign = (octets == ord("+")) | (octets == ord("-"))
    three = is_digit[at + 1] & is_digit[at + 2] & is_digit[at + 3]
    behind = is_bound[at + 4] | is_mark[at + 4] | is_decimal[at + 4]
    if not (three & behind & is_digit[at - 1]).all():
        return None
    # how many digits stand before the mark: 1 to 3, of which the first of a number is not 0
    two, most = is_digit[at - 2], is_digit[at - 2] & is_digit[at - 3]
    n = 1 + two.astype(np.int64) + most
    before = at - n - 1
    begins = is_bound[before] | (is_sign[before] & is_bound[before - 1])
    goes_on = is_mark[before] & (n == 3)
    if not (goes_on | (begins & (octets[before + 1] != ord("0")))).all():
        return None
    sure = is_decimal[at + 4] | is_mark[at + 4] | goes_on
    # digits behind a decimal mark that follows are digits to the end of the field
    ends = at[is_decimal[at + 4]] + 5
    rest = np.flatnonzero(~is_digit)
    if not is_bound[rest[np.searchsorted(rest, ends)]].all():
        return None
    starts = before[begins] + 1
    begin = int(starts[0]) - bool(is_sign[starts[0] - 1])
    field = octets[begin : begin + int(np.argmax(is_bound[begin:]))].tobytes().decode()
    line = int(np.count_nonzero(octets[4:begin] == ord("\n")))
    return text.replace(mark, ""), starts.size, (line, field), bool(sure.all())


def columns_of(
    text: str,
    mark: str,
    labels: Sequence[bool],
    missing: frozenset[str] | set[str],
    n_lines: int,
    decimal: str = ".",
) -> list[FloatArray | list[str]]:
    """Return the columns of lines of which the separators were counted; ValueError where one is odd.

    NumPy reads short texts, since pandas takes long to load; both give the nearest float. Without words
    for "not measured" a column that holds one is odd.
    """
    if len(text) < _LONG or len(text) > _WIDE * n_lines:
        if any(labels):
            raise ValueError
        numbers = np.loadtxt(
            io.StringIO(text), delimiter=None if mark == " " else mark, comments=None, ndmin=2
        )
        return [numbers[:, k] for k in range(numbers.shape[1])]
    import pandas as pd

    # from 3.1 on the usual way is exact, and naming it is deprecated
    before = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)
    kinds: dict[Any, Any] = {k: object if label else np.float64 for k, label in enumerate(labels)}
    words = sorted(
        {w for m in missing for w in (m, m.upper(), m.title(), m.replace("nan", "NaN"))}
    )
    unmeasured: Any = {k: words for k, label in enumerate(labels) if not label} if words else None
    stamps = _stamps(text, mark, labels, n_lines) if any(labels) else None
    plain = [k for k, label in enumerate(labels) if not label]
    frame = pd.read_csv(
        io.BytesIO(text.encode()),
        header=None,
        sep=r"\s+" if mark == " " else mark,
        usecols=None if stamps is None else plain,
        decimal=decimal,
        dtype=kinds if any(labels) else np.float64,
        keep_default_na=False,
        na_values=unmeasured,
        na_filter=bool(words),
        quoting=csv.QUOTE_NONE,
        low_memory=False,
        float_precision="round_trip" if before else None,
    )
    has_blanks = any(labels) and any(b in text for b in _BLANKS)
    if stamps is not None:
        stamps |= {k: frame[k].to_numpy(dtype=np.float64) for k in plain}
        return [stamps[k] for k in range(len(labels))]
    return [
        _texts(frame[k].to_numpy(), has_blanks=has_blanks)
        if label
        else frame[k].to_numpy(dtype=np.float64)
        for k, label in zip(frame.columns, labels, strict=True)
    ]


def _stamps(
    text: str, mark: str, labels: Sequence[bool], n_lines: int
) -> dict[int, FloatArray | list[str]] | None:
    """Return the columns of words by their place where each is of one width and differs from row to row, as stamps do.

    Such words are no sooner found by a parser, which looks for those that repeat; None for other columns.
    """
    if not text.isascii() or any(b in text for b in _BLANKS.replace(" ", "")) or all(labels):
        return None
    octets = np.frombuffer(text.encode(), dtype=np.uint8)
    at = np.flatnonzero((octets == ord(mark)) | (octets == ord("\n")))
    if at.size != n_lines * len(labels) or n_lines < len(labels) + _FEW:
        return None
    ends = at.reshape(n_lines, len(labels))
    starts = np.concatenate([[0], at[:-1] + 1]).reshape(ends.shape)
    found: dict[int, FloatArray | list[str]] = {}
    for k in np.flatnonzero(labels).tolist():
        width = int(ends[0, k] - starts[0, k])
        if width < _FEW or (ends[:, k] - starts[:, k] != width).any():
            return None
        fields = sliding_window_view(octets, width)[starts[:, k]]
        if not (fields[1:_MANY] != fields[: _MANY - 1]).any(axis=1).all() or np.any(
            (fields[:, 0] == ord(" ")) | (fields[:, -1] == ord(" "))
        ):
            return None
        joined = fields.tobytes().decode()
        found[k] = [joined[i : i + width] for i in range(0, len(joined), width)]
    return found


_FEW: Final = 8
"""Characters of the shortest stamp."""
_MANY: Final = 100
"""Rows of which each has another stamp than the one above."""


_BLANKS = " \t\v\f\u00a0\u2003\u3000"


def _texts(values: NDArray[Any], *, has_blanks: bool) -> list[str]:
    texts: list[str] = values.tolist()
    return list(map(str.strip, texts)) if has_blanks else texts
