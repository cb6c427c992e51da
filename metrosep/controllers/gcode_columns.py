"""Moves of a program as columns, a piece of the file at a time.

Most blocks of a long path differ in their digits only. A block whose shape (`shape_of`) was seen
before is matched by one regular expression made for that shape; everything else is cut into tokens
and goes through `ModalState`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import BinaryIO

import numpy as np

from metrosep.controllers.gcode_state import ModalState
from metrosep.controllers.gcode_words import (
    Token,
    decimals_of,
    refuse_block,
    shape_of,
    tokenize,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import CorruptFileError, ReadError

__all__ = ["Columns", "Mover", "carried", "open_program", "pieces", "read_columns"]


_BYTES = 1 << 21
"""Bytes that are looked at together: some 60 000 blocks."""

_LONGEST = 4096
"""Characters of the longest block; controllers take far fewer."""

_MARKS = (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_PLAIN = frozenset("NGXCZF")
_MODES = {"0": 0, "00": 0, "1": 1, "01": 1}
_MAX_SHAPES = 10_000
_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Mover:
    """How blocks of a shape are read: their expression and its groups, -1 where there is none.

    The first group is the block up to the number of Z or, without Z, up to the end of the last
    axis word.
    """

    match: re.Pattern[str]  # re.Pattern: finds every block of the shape
    g: int  # groups of the numbers of G, X, C, Z and F
    x: int
    c: int
    z: int
    f: int
    moves: bool  # whether there is an axis word


@dataclass(slots=True)
class Columns:
    """Moves of a piece of a program, one entry for each."""

    line: int  # number of the first line of the piece, from 1
    row: list[int] = field(default_factory=list)  # line within the piece
    # words in units of the file and degrees, NaN where the block has none
    x: list[float] = field(default_factory=list)
    c: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    f: list[float] = field(default_factory=list)  # feed words, NaN where there is none
    motion: list[int] = field(default_factory=list)  # 0 for rapid, 1 for feed
    # where the number of the Z word begins and ends in the block; both are the end of the last
    # axis word, where Z is inserted, if there is none
    start: list[int] = field(default_factory=list)
    end: list[int] = field(default_factory=list)
    # digits after the point of the Z word, 0 where there is none
    digits: list[int] = field(default_factory=list)
    feed_mode: list[str] = field(default_factory=list)  # in force
    # of (int, str): moves before which the place of some axes is no longer known, and which axes
    lost: list[tuple[int, str]] = field(default_factory=list)

    def lost_at(self, letter: str) -> list[int]:
        """Return the moves before which the place of an axis is no longer known."""
        return [at for at, axes in self.lost if letter in axes]

    def line_of(self, index: int) -> int:
        """Return the number of the line of a move."""
        return self.line + self.row[index]


def open_program(path: Path) -> BinaryIO:
    """Open a program."""
    try:
        if path.is_dir():
            raise ReadError(f"{path}: is a folder, a program is needed")
        return path.open("rb")
    except OSError as exc:
        raise ReadError(
            f"{path}: cannot be read ({exc.strerror or exc}); check the name and the permissions"
        ) from None


def pieces(stream: BinaryIO, path: Path, *, mark: bool = False) -> Iterator[list[str]]:
    """Give the lines of a program, with their ends, some ten thousand at a time."""
    rest, line = b"", 1
    while True:
        try:
            new = stream.read(_BYTES)
        except OSError as exc:
            raise ReadError(f"{path}: cannot be read ({exc.strerror or exc})") from None
        data = rest + new
        if line == 1 and data.startswith(_MARKS[mark:]):
            raise CorruptFileError(
                path,
                "line 1: a byte order mark (BOM) stands before the first character",
                hint="save the text as ASCII, or as UTF-8 without BOM",
            )
        cut = len(data) if not new else max(data.rfind(b"\n"), data.rfind(b"\r", 0, -1)) + 1
        if b"\x00" in new:
            raise CorruptFileError(path, "this is no text of a program", hint="check the name")
        rest = data[cut:]
        lines = (
            data[:cut].decode("latin-1").splitlines(True)
            if _simple(data)
            else [part.decode("latin-1") for part in data[:cut].splitlines(True)]
        )
        _check_lengths([*map(len, lines), len(rest)], line, path)
        line += len(lines)
        if lines:
            yield lines
        if not new:
            return


def _check_lengths(lengths: list[int], line: int, path: Path) -> None:
    if max(lengths) > _LONGEST:
        at = next(i for i, length in enumerate(lengths) if length > _LONGEST)
        raise CorruptFileError(
            path,
            f"line {line + at}: the block is longer than {_LONGEST} characters",
            hint="is this a program? cut the block in two",
        )


def _simple(data: bytes) -> bool:
    """Return whether text has line ends of ASCII only, so that str.splitlines cuts as bytes do."""
    return data.isascii() and not any(
        c in data for c in (b"\x0b", b"\x0c", b"\x1c", b"\x1d", b"\x1e")
    )


def read_columns(
    lines: list[str], state: ModalState, shapes: dict[str, Mover | None], line: int
) -> Columns:
    """Return the moves of a piece of a program."""
    out = Columns(line)
    row = 0
    for shape, run in groupby(_shapes(lines)):
        blocks = lines[row : row + len(list(run))]
        mover = shapes.get(shape)
        if mover is None and shape not in shapes:
            mover = shapes[shape] = _mover(shape) if len(shapes) < _MAX_SHAPES else None
        if mover is None or state.ended or not _by_shape(blocks, row, mover, state, out):
            for index, block in enumerate(blocks, row):
                _by_token(block, index, state, out)
        row += len(blocks)
    return out


def _shapes(lines: list[str]) -> list[str]:
    """Return `shape_of` of each line; all together in bytes, which is ten times as fast."""
    data = "".join(lines).encode("latin-1").translate(None, b"0123456789.+-")
    found = [part.decode("latin-1") for part in data.splitlines(keepends=True)]
    return found if len(found) == len(lines) else [shape_of(line) for line in lines]


def _by_shape(blocks: list[str], row: int, mover: Mover, state: ModalState, out: Columns) -> bool:
    """Take blocks of one shape together; False if one of them needs a closer look."""
    found = mover.match.findall("".join(blocks))
    if len(found) != len(blocks):
        return False
    groups: list[tuple[str, ...]] = list(zip(*found, strict=True))
    modes = [state.motion] * len(blocks)
    if mover.g >= 0:
        if not set(groups[mover.g]) <= _MODES.keys():
            return False
        modes = [_MODES[g] for g in groups[mover.g]]
    if not mover.moves:
        state.motion = modes[-1]
        if mover.f >= 0:
            state.feed = float(groups[mover.f][-1])
        return True
    if modes[0] is None or not state.cut or state.away:
        return False
    for group in (mover.x, mover.z):
        if group >= 0:
            _whole_numbers(groups[group], state, out.line + row)
    state.motion = modes[-1]
    missing = [_NAN] * len(blocks)
    starts = list(map(len, groups[0]))
    out.row.extend(range(row, row + len(blocks)))
    for column, group in ((out.x, mover.x), (out.c, mover.c), (out.z, mover.z), (out.f, mover.f)):
        column.extend(map(float, groups[group]) if group >= 0 else missing)
    _take_feed(out, len(blocks), state)
    out.start.extend(starts)
    if mover.z >= 0:
        texts = groups[mover.z]
        out.end.extend([a + len(t) for a, t in zip(starts, texts, strict=True)])
        out.digits.extend([len(t) - t.find(".") - 1 if "." in t else 0 for t in texts])
        state.z_known = True
    else:
        out.end.extend(starts)
        out.digits.extend([0] * len(blocks))
    out.motion.extend(modes)  # type: ignore[arg-type]
    out.feed_mode.extend([state.feed_mode] * len(blocks))
    return True


def _by_token(block: str, row: int, state: ModalState, out: Columns) -> None:
    line = out.line + row
    if state.ended:
        return
    tokens = tokenize(block, line)
    moves = state.apply(tokens, line)
    if state.lost:
        out.lost.append((len(out.row), state.lost))
        state.lost = ""
    if not moves:
        return
    words: dict[str, Token] = {}
    anchor = 0
    for token in tokens:
        if token.kind != "word" or token.letter not in "XCZF":
            continue
        if token.letter in words:
            why = "the letter stands twice in one block"
            raise refuse_block(line, token.text, why, "write it once")
        words[token.letter] = token
        anchor = anchor if token.letter == "F" else token.end
    _whole_numbers((words[a].number for a in "XZ" if a in words), state, line)
    out.row.append(row)
    out.x.append(words["X"].value if "X" in words else _NAN)
    out.c.append(words["C"].value if "C" in words else _NAN)
    out.z.append(words["Z"].value if "Z" in words else _NAN)
    out.f.append(words["F"].value if "F" in words else _NAN)
    _take_feed(out, 1, state)
    out.motion.append(state.motion or 0)
    z = words.get("Z")
    out.start.append(anchor if z is None else z.end - len(z.number))
    out.end.append(anchor if z is None else z.end)
    out.digits.append(decimals_of(words["Z"].number) if "Z" in words else 0)
    out.feed_mode.append(state.feed_mode)


def _take_feed(out: Columns, count: int, state: ModalState) -> None:
    """Give the F of a block without a move to the first of the moves that were just added."""
    if state.feed == state.feed:
        if out.f[-count] != out.f[-count]:
            out.f[-count] = state.feed
        state.feed = _NAN


def _whole_numbers(texts: Iterable[str], state: ModalState, line: int) -> None:
    """Note the first X or Z without a point: a least increment on some controllers."""
    for text in texts:
        if "." not in text and text.strip("+-0"):
            state.note(
                f"{text} has no decimal point and is taken as a whole number of units, but some "
                "controllers take it as a number of least increments",
                line,
            )
            return


def _mover(shape: str) -> Mover | None:
    """Return how blocks of a shape are read, None where they need a closer look."""
    letters = [c for c in shape.upper() if not c.isspace()]
    if not set(letters) <= _PLAIN or len(set(letters)) < len(letters) or shape[-1:] != "\n":
        return None
    axes = [a for a in letters if a in "XCZ"]
    last = "Z" if "Z" in axes else axes[-1] if axes else ""
    group: dict[str, int] = {}
    pattern = "(?m)^" + "(" * bool(axes)
    for char in shape:
        letter = char.upper()
        if char.isspace():
            pattern += re.escape(char)
        elif letter == last == "Z":
            pattern += char + ")(" + _NUMBER + ")"
        elif letter == last:
            pattern += char + "(" + _NUMBER + "))"
        else:
            pattern += char + ("(" + _NUMBER + ")" if letter != "N" else _NUMBER)
        if letter in "GXCZF" and not char.isspace():
            group[letter] = len(group) + bool(axes)
    pattern += "()"  # with one group alone findall gives texts, not tuples of texts
    g, x, c, z, f = (group.get(a, -1) for a in "GXCZF")
    return Mover(re.compile(pattern), g, x, c, z, f, moves=bool(axes))


def carried(values: FloatArray, before: float, lost: Sequence[int] = ()) -> FloatArray:
    """Return a column with each missing word as the one before it: words are modal."""
    full = np.concatenate([[before], values])
    last = np.where(np.isnan(full), 0, np.arange(full.size))
    for at in lost:
        if at < values.size:
            last[at + 1] = at + 1
    np.maximum.accumulate(last, out=last)
    return full[last][1:]
