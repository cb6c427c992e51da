"""The quick way through a block of rows: quotes and marks of thousands taken off, then a compiled parser.

Each step proves from the bytes that it changes no number, or gives up, and the block is read line by
line. Nothing here knows the ledger: the caller has counted lines and separators.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain
from typing import Any, Final, overload

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

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


def words_in(text: str, words: Iterable[str]) -> set[str]:
    """Return those of some words, in lower case, that may be fields of a text: a parser compares each field with all.

    A word that is missing here would be refused as a number, so nothing is lost.
    """
    octets = np.frombuffer(text.lower().encode("utf-8", "surrogatepass"), dtype=np.uint8)
    letters = set(octets.tobytes().translate(None, _OF_NUMBERS))
    behind = set(octets[1:][octets[:-1] == ord("-")].tobytes().translate(None, b"0123456789.,"))
    # the parser passes over a word at once whose first character begins no field: only - begins numbers
    return {
        w
        for w in words
        if letters.issuperset(w.encode().translate(None, _OF_NUMBERS))
        and (w[:1] != "-" or (behind if len(w) == 1 else w.encode()[1] in behind))
    }


def may_hold_words(text: str, mark: str) -> bool:
    """Return whether fields of a text may be empty, or hold anything but digits and marks."""
    if (
        f"{mark}\n" in text
        or mark * 2 in text
        or text.encode().translate(None, b"eE" + _OF_NUMBERS)
    ):
        return mark != " "
    return False


_OF_NUMBERS: Final = b"0123456789.,;+-\t \n"


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
    pad = "\n" * _AROUND
    octets = np.frombuffer(f"{pad}{text}{pad}".encode(), dtype=np.uint8)
    n, at, is_sure = 0, -1, True
    for start in range(0, len(text), _PIECE):  # small arrays stay in the cache
        piece = octets[start : start + _PIECE + 2 * _AROUND]
        first, own_is_sure = _groups_in(piece, mark, separator, decimal)
        if first is None:
            return None
        n_own = int(np.count_nonzero(first))
        at = start + int(np.argmax(first)) if n_own and not n else at
        n, is_sure = n + n_own, is_sure and own_is_sure
    start = max(text.rfind(bound, 0, at) for bound in (separator, "\n", " ")) + 1
    field = re.split(rf"[{re.escape(separator)}\n ]", text[start : at + _SHOWN], maxsplit=1)[0]
    plain = text.encode().translate(None, mark.encode()).decode()
    return plain, n, (text.count("\n", 0, at), field), is_sure


_AROUND: Final = 5
"""Characters round a mark of thousands that tell whether it is one."""
_PIECE: Final = 2**15
"""Characters that are looked at at once."""
_SHOWN: Final = 60
"""Characters of the longest number that is shown."""


def _groups_in(
    octets: NDArray[np.uint8], mark: str, separator: str, decimal: str
) -> tuple[NDArray[np.bool_] | None, bool]:
    """Return where the first marks of numbers stand, None where one is no mark of thousands, and whether all are sure.

    `_AROUND` characters before and behind those that are looked at stand in `octets` too.
    """
    digit = octets - np.uint8(ord("0")) < np.uint8(10)
    bound = (octets == ord(separator)) | (octets == ord("\n")) | (octets == ord(" "))
    group, point = octets == ord(mark), octets == ord(decimal)

    def at(which: NDArray[np.bool_], k: int) -> NDArray[np.bool_]:
        """Return whether the character k places behind each is one of these."""
        return which[_AROUND + k : which.size - _AROUND + k]

    marks = at(group, 0)
    three = at(digit, 1) & at(digit, 2) & at(digit, 3) & at(digit, -1)
    # a number begins behind a bound, or a sign behind one, and not with 0
    begin = bound.copy()
    begin[1:] |= ((octets[1:] == ord("+")) | (octets[1:] == ord("-"))) & bound[:-1]
    begin[:-1] &= octets[1:] != ord("0")
    # one to three digits stand before the mark
    two = at(digit, -2)
    most = two & at(digit, -3)
    goes_on = most & at(group, -4)
    first = at(begin, -2) | (two & at(begin, -3)) | (most & at(begin, -4))
    behind = at(group, 4) | at(point, 4)
    if (marks & ~(three & (first | goes_on) & (behind | at(bound, 4)))).any():
        return None, False
    return first & marks, not (marks & ~(goes_on | behind)).any()


def columns_of(
    text: str,
    mark: str,
    labels: Sequence[bool],
    missing: frozenset[str] | set[str],
    n_lines: int,
    decimal: str = ".",
) -> list[FloatArray | Sequence[str]]:
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
    kinds: dict[Any, Any] = dict.fromkeys(range(len(labels)), np.float64)
    few = _repeat(text, mark, labels)
    kinds |= {k: "category" if k in few else object for k, label in enumerate(labels) if label}
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
        _texts(frame[k], has_blanks=has_blanks) if label else frame[k].to_numpy(dtype=np.float64)
        for k, label in zip(frame.columns, labels, strict=True)
    ]


class Stamps(Sequence[str]):
    """Texts of one width, such as dates: kept as bytes, since most readers want their digits only."""

    def __init__(self, codes: NDArray[np.uint8]) -> None:
        self.codes = codes  # shape (n, width): ASCII

    def __len__(self) -> int:
        return len(self.codes)

    @overload
    def __getitem__(self, i: int) -> str: ...
    @overload
    def __getitem__(self, i: slice) -> Stamps: ...
    def __getitem__(self, i: int | slice) -> str | Stamps:
        if isinstance(i, slice):
            return Stamps(self.codes[i])
        return str(self.codes[i].tobytes(), "ascii")

    def __iter__(self) -> Iterator[str]:
        joined, width = self.codes.tobytes().decode(), self.codes.shape[1]
        return (joined[i : i + width] for i in range(0, len(joined), width))

    def begin_with_digits(self) -> bool:
        """Whether no text is a word."""
        return bool((self.codes[:, 0] - np.uint8(ord("0")) < np.uint8(10)).all())


class Words(Sequence[str]):
    """Texts of which there are few different ones, such as a status: most readers ask which these are."""

    def __init__(self, different: Sequence[str], codes: NDArray[np.integer[Any]]) -> None:
        self.known = np.array([*different, ""], dtype=object)[:-1]  # shape (m,); a row has one
        self.codes = codes  # shape (n,): place of the text of each row among these

    def __len__(self) -> int:
        return len(self.codes)

    @overload
    def __getitem__(self, i: int) -> str: ...
    @overload
    def __getitem__(self, i: slice) -> Words: ...
    def __getitem__(self, i: int | slice) -> str | Words:
        if isinstance(i, slice):
            return Words(self.known.tolist(), self.codes[i])
        return str(self.known[self.codes[i]])

    def __iter__(self) -> Iterator[str]:
        return iter(self.known[self.codes].tolist())

    def __contains__(self, text: object) -> bool:
        return text in self.different

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        texts: NDArray[Any] = self.known.astype(dtype or np.str_)[self.codes]
        return texts

    @cached_property
    def different(self) -> tuple[str, ...]:
        """The texts in the order in which they first stand."""
        n = len(self.codes)
        first = np.full(len(self.known), n)
        first[self.codes[::-1]] = np.arange(n)[::-1]  # the last of several writes remains
        return tuple(str(self.known[k]) for k in np.argsort(first) if first[k] < n)

    @classmethod
    def below(cls, parts: Sequence[Words]) -> Words:
        """Return columns one below the other."""
        place = {t: k for k, t in enumerate(dict.fromkeys(t for p in parts for t in p.known))}
        codes = [np.array([place[t] for t in p.known], dtype=np.int32)[p.codes] for p in parts]
        return cls(list(place), np.concatenate(codes))


def different(texts: Iterable[str]) -> tuple[str, ...]:
    """Return the texts that differ from each other, in the order in which they first stand."""
    return texts.different if isinstance(texts, Words) else tuple(dict.fromkeys(texts))


def stacked(parts: Sequence[Sequence[str]]) -> Sequence[str]:
    """Return columns of texts one below the other: stamps where all are of one width, words where all have few, else a list."""
    codes = [p.codes for p in parts if isinstance(p, Stamps)]
    if parts and len(codes) == len(parts) and len({c.shape[1] for c in codes}) == 1:
        return Stamps(np.concatenate(codes))
    words = [p for p in parts if isinstance(p, Words)]
    if parts and len(words) == len(parts):
        return Words.below(words)
    return list(chain.from_iterable(parts))


def _stamps(
    text: str, mark: str, labels: Sequence[bool], n_lines: int
) -> dict[int, FloatArray | Sequence[str]] | None:
    """Return the columns of words by their place where each is of one width and differs from row to row, as stamps do.

    Such words are no sooner found by a parser, which looks for those that repeat; None for other columns.
    """
    if not text.isascii() or any(b in text for b in _BLANKS.replace(" ", "")) or all(labels):
        return None
    first, second, _ = f"{text[:_FIRST]}\n\n".split("\n", 2)
    places = [k for k, label in enumerate(labels) if label]
    tops = [row.split(mark) for row in (first, second) if row.count(mark) == len(labels) - 1]
    if len(tops) < 2 or any(
        len(tops[0][k]) < _FEW or len(tops[0][k]) != len(tops[1][k]) for k in places
    ):
        return None  # no need to look at all of them
    octets = np.frombuffer(text.encode(), dtype=np.uint8)
    at = np.flatnonzero((octets == ord(mark)) | (octets == ord("\n")))
    if at.size != n_lines * len(labels) or n_lines < len(labels) + _FEW:
        return None
    ends = at.reshape(n_lines, len(labels))
    found: dict[int, FloatArray | Sequence[str]] = {}
    for k in np.flatnonzero(labels).tolist():
        starts = ends[:, k - 1] + 1 if k else np.concatenate([[0], ends[:-1, -1] + 1])
        widths = ends[:, k] - starts
        width = int(widths[0])
        if width < _FEW or (widths != width).any():
            return None
        fields = sliding_window_view(octets, width)[starts]
        if not (fields[1:_MANY] != fields[: _MANY - 1]).any(axis=1).all() or np.any(
            (fields[:, 0] == ord(" ")) | (fields[:, -1] == ord(" "))
        ):
            return None
        found[k] = Stamps(fields)
    return found


_FEW: Final = 8
"""Characters of the shortest stamp."""
_MANY: Final = 100
"""Rows of which each has another stamp than the one above."""


_BLANKS = " \t\v\f\u00a0\u2003\u3000"


def _repeat(text: str, mark: str, labels: Sequence[bool]) -> list[int]:
    """Return the columns of words of which the first rows hold few: a parser compares words, and need not make each."""
    rows = [line.split(mark) for line in text[:_FIRST].split("\n")[:-1]]
    words = {k: [row[k] for row in rows if k < len(row)] for k, own in enumerate(labels) if own}
    return [k for k, own in words.items() if 2 * len(set(own)) < len(own)]


_FIRST: Final = 2**13
"""Characters of the rows that show whether words repeat."""


def _texts(values: Any, *, has_blanks: bool) -> Sequence[str]:
    """Return a column of words; ValueError where a parser took one for an empty field."""
    is_few = hasattr(values, "cat")
    words: list[str] = (
        (values.cat.categories if is_few else values).to_numpy(dtype=object).tolist()
    )
    if has_blanks:
        words = list(map(str.strip, words))
    if not is_few:
        return words
    codes = values.cat.codes.to_numpy()
    if codes.size and codes.min() < 0:
        raise ValueError
    return Words(words, codes)
