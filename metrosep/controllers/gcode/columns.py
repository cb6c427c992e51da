"""Moves of a program as columns, a piece of the file at a time.

Most blocks of a long path differ in their digits only. A block whose shape (`shape_of`) was seen
before is matched by one regular expression made for that shape; everything else is cut into tokens
and goes through `ModalState`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep._version import __version__
from metrosep.controllers.base import (
    load_bytes,
    load_sidecar,
    paired_stream,
    refuse_existing,
    sidecar_path,
)
from metrosep.controllers.gcode.corrections import MAX_LOOKS, MAX_PARTS
from metrosep.controllers.gcode.state import (
    ModalState,
    Token,
    decimals_of,
    refuse_block,
    shape_of,
    tokenize,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    CorruptFileError,
    DataError,
    InvalidSamplesError,
    LimitError,
    ReadError,
    WriteError,
)

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
        if path.exists() and not path.is_file():  # opening a pipe would wait for its writer
            raise ReadError(f"{path}: is a device or a pipe; copy the program into a file first")
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
            raise CorruptFileError(
                path, "this is not the text of a program", hint="check the name"
            )
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
        state.refuse_behind(block, line)
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
            why = "the letter is there twice in one block"
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


# ---- how a path is rewritten, and what is refused in its numbers and between its points --------

IntArray = NDArray[np.int64]
Outside = Literal["refuse", "zero", "hold"]

_MOST_DIGITS = 12
_LARGEST = 1e9
"""Millimetres, inches or degrees: beyond it double precision has no digit for a nanometre."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How a path is rewritten; see `metrosep.controllers.gcode.paths.rewrite_path`."""

    axes: tuple[str, ...]  # words that may change
    decimals: int | None  # digits after the point
    resolution: float  # m: finest step, without `decimals`
    tolerance: float | None  # m: largest deviation from chords
    outside: Outside  # {"refuse", "zero", "hold"}: beyond the map
    stroke: float  # m: largest correction
    blocks_per_s: float | None  # 1/s: most blocks per second
    # whether C takes the shortest way (True) or goes along its numbers (False); None while nobody
    # says
    c_rollover: bool | None = None


def check_size(values: FloatArray, letter: str, columns: Columns) -> None:
    """Refuse positions where no machine goes."""
    large = np.abs(values) > _LARGEST
    if large.any():
        i = int(np.flatnonzero(large)[0])
        raise DataError(
            f"line {columns.line_of(i)}: {letter} is {values[i]:.6g}, beyond the travel of any machine; check the number and its unit"
        )


def check_digits(digits: FloatArray, letter: str, columns: Columns) -> None:
    """Refuse words with more digits than double precision holds."""
    if digits.max() > _MOST_DIGITS:
        i = int(digits.argmax())
        raise DataError(
            f"line {columns.line_of(i)}: {letter} has {int(digits[i])} digits after the point, more than "
            f"{_MOST_DIGITS} mean nothing; round it"
        )


def check_way(
    columns: Columns, where: IntArray, left: FloatArray, tolerance: float | None
) -> tuple[str, int] | None:
    """Refuse what lies between two points: gaps, the border of the map, too steep a bend."""
    gap = np.flatnonzero(np.isnan(left))
    if gap.size:
        raise InvalidSamplesError(
            f"line {columns.line_of(int(where[gap[0]]))}: between its ends the move crosses what was "
            "not measured (NaN), or leaves the map; measure it there, fit a form that covers it, "
            "shorten the path, or say outside='zero' or outside='hold' for what is beyond the map"
        )
    long = np.flatnonzero(np.isinf(left))
    if long.size:
        line = columns.line_of(int(where[long[0]]))
        if tolerance is None:
            return "the move is too long to be looked at between its ends", line
        raise LimitError(
            f"line {line}: the move is too long to be looked at between its ends (more than {MAX_LOOKS} "
            "places); split it in the program"
        )
    if tolerance is not None and (left > tolerance).any():
        i = int(np.argmax(left))
        raise LimitError(
            f"line {columns.line_of(int(where[i]))}: in {MAX_PARTS} parts the correction is still "
            f"{left[i] * 1e9:.4g} nm off its chords, the tolerance is {tolerance * 1e9:.4g} nm; the "
            "correction has a step or bends too fast: smooth it, or raise the tolerance"
        )
    return None


def check_turns(columns: Columns, turn: FloatArray, parts: IntArray) -> None:
    """Refuse to split a block that may go over the roll-over of C."""
    unsure = np.flatnonzero((parts > 1) & (np.abs(turn) > 180.0))
    if unsure.size:
        i = int(unsure[0])
        raise refuse_block(
            columns.line_of(i),
            f"a block to be split that moves C by {abs(turn[i]):.6g} deg",
            "on some controllers C takes the shortest way over its roll-over, on others it goes "
            "along its numbers",
            "say c_rollover=True (shortest way) or c_rollover=False (along the numbers)",
        )


# ---- corrected programs and lists on the disk: never twice corrected, never without their own sidecar ----

SCHEMAS = ("metrosep.path/1", "metrosep.points/1")
"""Of the sidecars of corrected programs and lists."""

_MARK = re.compile(r"METROSEP\s+CORRECTED[^()\r\n]*", re.IGNORECASE)
_HEAD = re.compile(r"\s*(?:%.*|(?:[O:]\d+).*)?\s*", re.IGNORECASE)
"""Of lines before the mark: blank, the % of a tape, the number of the program."""
_CALLED = re.compile(
    r"\b(?:CYCLE832|COMPCAD|COMPCURV|COMPON|COMPOF|COMPSURF|SOFT|BRISK)\b\s*(?:\([^()]*\))?",
    re.IGNORECASE,
)
"""What only controls have whose comments begin with a semicolon."""
_OF_LISTS = "#%;"
_LARGEST_SIDECAR = 10**6


def check_files(start: Path, end: Path, *, overwrite: bool) -> None:
    """Refuse a target that is the source, or in the way and not made of this source."""
    try:
        same = end.exists() and start.exists() and end.samefile(start)
    except OSError as exc:
        raise WriteError(
            f"{end}: cannot be written ({exc.strerror or exc}); choose another name or folder", exc
        ) from None
    if same or start.resolve() == end.resolve() or start.resolve() == sidecar_path(end).resolve():
        raise WriteError(
            f"{end}: is the source itself; a correction must not be added twice, so give another name"
        )
    if not overwrite and not _is_of(start, end):
        refuse_existing(end)


def _is_of(start: Path, end: Path) -> bool:
    """Return whether a file was made of a source by this version, so that it may be the same bytes."""
    try:
        said = load_sidecar(end) if end.is_file() and start.is_file() else {}
        known = [said.get("source_sha256"), said.get("file_sha256"), said.get("metrosep")]
        return known == [*map(_sha256, (start, end)), __version__]
    except (CorruptFileError, OSError):
        return False


def _sha256(path: Path) -> str:
    """Return the hash of a file of any size."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def mark_text(axes: Sequence[str], audit: Mapping[str, Any]) -> str:
    """Return the text by which a corrected file is known, whatever its name."""
    content = json.dumps([*axes, dict(audit)], sort_keys=True, default=str)
    digest = hashlib.sha256(content.encode("utf-8")).hexdigest()[:12]
    return f"METROSEP CORRECTED {' '.join(axes)} {digest}"


def comments_of(text: str) -> str:
    """Return how comments of a program begin, by what a part of it shows: "(", ";" or "" for either."""
    if "(" in _CALLED.sub("", text):
        return "("
    return ";" if ";" in text or _CALLED.search(text) else ""


def marked(
    lines: Sequence[str], text: str, *, is_list: bool = False, semicolon: bool | None = None
) -> list[str]:
    """Return the first lines of a file with the mark as a comment of its own form.

    In a program it follows the number of the program, and `semicolon` says how comments begin where
    these lines do not show it. A list without comments stays as it is: not every reader of lists takes them.
    """
    if not lines:
        return []
    end = re.search(r"[\r\n]*$", lines[0])[0] or "\n"  # type: ignore[index]
    if is_list:
        first = next((i for i, v in enumerate(lines) if v.lstrip()[:1] in (*_OF_LISTS,)), None)
        if first is None:
            return list(lines)
        made = f"{lines[first].lstrip()[0]} {text}{end}"
        return [*lines[: first + 1], made, *lines[first + 1 :]]
    at = next((i for i, v in enumerate(lines) if not _HEAD.fullmatch(v)), len(lines))
    whole = "".join(lines)
    semicolon = comments_of(whole) == ";" if semicolon is None else semicolon
    made = (f";{text}" if semicolon else f"({text})") + end
    before = list(lines[:at])
    if before and not before[-1].endswith(("\r", "\n")):
        before[-1] += end
    return [*before, made, *lines[at:]]


def require_unmarked(lines: Sequence[str], path: Path) -> None:
    """Refuse lines of a program or list that bear the mark of a correction."""
    found = _MARK.search("".join(lines))
    if found is not None:
        raise DataError(
            f"{path}: holds a correction already, as its comment {found[0].strip()!r} says; a second one "
            "would be added to it: take the original, or say again if what was measured is a part cut "
            "with it"
        )


def require_uncorrected(path: Path) -> None:
    """Refuse a program or list that has a correction in it already, by the sidecars of its folder."""
    beside = sidecar_path(path)
    found = _said(beside)
    if found is not None:
        with contextlib.suppress(OSError):
            own = _sha256(path) == found.get("file_sha256")
            why = "" if own else " (changed since, or of a run that was cut off)"
            raise _corrected(path, beside, found, why)
    others = sorted(path.parent.glob("*.json")) if path.is_file() else []
    if others:
        digest = _sha256(path)
        for other in others:
            said = _said(other) or {}
            if said.get("file_sha256") == digest != said.get("source_sha256"):
                raise _corrected(path, other, said, " (the same bytes under another name)")


def _corrected(path: Path, beside: Path, found: Mapping[str, Any], why: str) -> DataError:
    return DataError(
        f"{path}: holds a correction already{why}, as {beside.name} beside it says; a second one would be "
        f"added to it: take the original ({found.get('source', 'unknown')}), or say again if what was "
        "measured is a part cut with it"
    )


def _said(beside: Path) -> dict[str, Any] | None:
    """Return what a sidecar of a corrected file says; None if it is none."""
    try:
        if not beside.is_file() or beside.stat().st_size > _LARGEST_SIDECAR:
            return None
        found = json.loads(load_bytes(beside))
    except (ValueError, RecursionError, OSError, ReadError):
        return None
    return found if isinstance(found, dict) and found.get("schema") in SCHEMAS else None


def require_hash(path: Path, wanted: str) -> None:
    """Refuse a file that the disk does not hold as it was written."""
    if _sha256(path) != wanted:
        raise WriteError(f"{path}: the disk does not hold what was written; nothing was kept")


def sidecar_of(
    schema: str, start: Path, digests: Sequence[str], audit: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the sidecar of a corrected file: hashes of source and file, then how it was corrected."""
    return {
        "schema": f"metrosep.{schema}/1",
        "metrosep": __version__,
        "source": start.name,
        "source_sha256": digests[0],
        "file_sha256": digests[1],
        **audit,
    }


def sidecar_text(sidecar: Mapping[str, Any]) -> str:
    """Return a sidecar as it is written."""
    return json.dumps(sidecar, indent=1, sort_keys=True, allow_nan=False) + "\n"


def write_stream(
    stream: BinaryIO,
    start: Path,
    end: Path,
    rewritten: Callable[[list[str]], list[str]],
    finish: Callable[[], tuple[list[str], bool]],
    said: Callable[[list[str]], Mapping[str, Any]],
    *,
    mark: str,
    semicolon: bool | None = None,
    again: bool,
    overwrite: bool,
) -> None:
    """Rewrite a program piece by piece; the sidecar is written when the program lies whole on the disk.

    `finish` gives the last lines, and whether anything changed; `said` the sidecar by the hashes.
    """
    hashes = [hashlib.sha256(), hashlib.sha256()]
    unmarked = True

    def text(written: Path) -> str:
        digests = [h.hexdigest() for h in hashes]
        require_hash(written, digests[1])
        return sidecar_text(said(digests))

    with paired_stream(end, text, overwrite=overwrite) as out:

        def put(lines: list[str]) -> None:
            nonlocal unmarked
            if lines and unmarked:
                lines, unmarked = marked(lines, mark, semicolon=semicolon), False
            data = "".join(lines).encode("latin-1")
            hashes[1].update(data)
            out.write(data)

        for lines in pieces(stream, start):
            hashes[0].update("".join(lines).encode("latin-1"))
            if not again:
                require_unmarked(lines, start)
            put(rewritten(lines))
        rest, changed = finish()
        put(rest)
        if not changed and stream.seekable():  # nothing to mark: the program as it was
            for file in (out, stream):
                file.seek(0)
            out.truncate()
            shutil.copyfileobj(stream, out)
            hashes[1] = hashes[0]
