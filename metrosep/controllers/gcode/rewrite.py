"""One piece of a program after another: look the correction up, change words, read back.

Positions are modal, so a block that moves X or C and has no Z word may need one: it is inserted
after the last axis word. Where the rounded Z is what the machine holds already, nothing changes.
Every piece that was written is parsed again, by the same grammar with a modal state of its own, and
compared with what was meant, before it counts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.controllers.gcode.columns import (
    Columns,
    Mover,
    Settings,
    carried,
    check_digits,
    check_size,
    check_turns,
    check_way,
    read_columns,
)
from metrosep.controllers.gcode.contact import Lookup, PathPlaces
from metrosep.controllers.gcode.corrections import (
    PathCorrection,
    chord_errors,
    part_counts,
)
from metrosep.controllers.gcode.state import (
    ModalState,
    Token,
    decimals_of,
    format_number,
    refuse_block,
    tokenize,
)
from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, TableError

_ROUNDING = 1e-6
"""Share of half a digit that binary numbers add to a rounding."""


@dataclass(slots=True)
class _Carry:
    """What is in force at the end of a piece, in units of the file and degrees."""

    x: float = math.nan
    c: float = math.nan
    z: float = math.nan
    f: float = math.nan
    z_out: float = math.nan
    x_out: float = math.nan
    digits: float = 0.0
    x_digits: float = 0.0


@dataclass(slots=True)
class _Piece:
    """Moves of a piece with everything that follows from them."""

    columns: Columns
    x: FloatArray
    c: FloatArray
    z: FloatArray
    before: FloatArray
    known: BoolArray
    dz: FloatArray
    dx: FloatArray


class Rewriter:
    """Rewrite pieces of one program in order."""

    def __init__(self, correction: PathCorrection, settings: Settings, state: ModalState) -> None:
        if settings.outside == "hold" and correction.held is None:
            raise DataError("this correction has no edge to hold; use outside='zero' or 'refuse'")
        if "X" in settings.axes and correction.x is None:
            raise DataError(
                "the correction holds nothing for X; give one with a slope and move_x=True, or axes=('Z',)"
            )
        if "X" not in settings.axes and correction.x is not None:
            raise DataError(
                "the correction moves X and Z together, along the normal, so Z alone would fall short; "
                "say axes=('Z', 'X'), or make it without move_x for Z alone"
            )
        self.correction, self.settings = correction, settings
        self.state = state
        self.tally = Tally()
        self._readers: tuple[dict[str, Mover | None], dict[str, Mover | None]] = ({}, {})
        self._again = ModalState(
            scale=state.scale,
            diameter=state.diameter,
            harmless_m=state.harmless_m,
            g_system=state.g_system,
        )
        self.places = None if correction.nose is None else PathPlaces()
        self._turned = False
        self._edge = (0.0, False, math.nan, math.nan)
        self._carry, self._seen = _Carry(), _Carry()
        self._line = 1
        self._line_out = 1

    def rewrite(self, lines: list[str]) -> list[str]:
        """Return the lines of a piece, corrected and read back."""
        columns = read_columns(lines, self.state, self._readers[0], self._line)
        self._line += len(lines)
        self.tally.blocks += len(lines)
        if not columns.row:
            self._lose(columns)
            self._read_back(lines, [], [], [], [], [])
            return lines
        piece = self._looked_up(columns)
        return self._changed(lines, piece)

    @property
    def half_x(self) -> float:
        """Metres of radius for one unit of an X word."""
        return self.state.unit * (0.5 if self.state.diameter else 1.0)

    def decimals(self) -> int:
        """Return the digits after the point that the resolution needs."""
        if self.settings.decimals is not None:
            return self.settings.decimals
        return max(1, math.ceil(-math.log10(self.settings.resolution / self.state.unit) - 1e-9))

    def _lose(self, columns: Columns) -> None:
        """Forget places in a piece that has no move."""
        for name in ("x", "c", "z"):
            if columns.lost_at(name.upper()):
                setattr(self._carry, name, math.nan)
                if name != "c":
                    setattr(self._carry, f"{name}_out", math.nan)

    def finish(self) -> None:
        """Check what only the whole program can tell."""
        if self.correction.needs_c and self.state.spun and not self._turned:
            raise refuse_block(
                self.state.spun,
                "M3 or M4",
                "the spindle turns and no block moves C, so the angle of the part is not in the text",
                "use a correction over X alone, or a program that moves C",
            )

    def _places(self, columns: Columns) -> tuple[list[FloatArray], FloatArray]:
        """Return X, C, Z after each move, and before it, NaN where they are not known."""
        carry, after, before = self._carry, [], []
        for name in ("x", "c", "z"):
            lost = columns.lost_at(name.upper())
            read = np.array(getattr(columns, name))
            check_size(read, name.upper(), columns)
            found = carried(read, getattr(carry, name), lost)
            start = np.r_[getattr(carry, name), found[:-1]]
            start[[i for i in lost if i < found.size]] = np.nan
            setattr(carry, name, np.nan if found.size in lost else float(found[-1]))
            after.append(found)
            before.append(start)
        return after, np.array(before)

    def _along_c(self, columns: Columns, before: FloatArray, c: FloatArray) -> None:
        """Put the beginning of a move over the roll-over of C where the shortest way begins."""
        way = c - before[1]
        with np.errstate(invalid="ignore"):
            self._turned |= bool((np.abs(way) > 0.0).any())
            long = np.flatnonzero((np.abs(way) > 180.0) & (np.array(columns.motion) == 1))
        if not long.size or not self.correction.needs_c:
            return
        if self.settings.c_rollover:
            before[1, long] = c[long] - (way[long] - 360.0 * np.rint(way[long] / 360.0))
        elif self.settings.c_rollover is None:
            self.state.note(
                "C moves by more than half a turn in one block; the way between is taken along its "
                "numbers, but some controllers take the shortest way: say c_rollover",
                columns.line_of(int(long[0])),
            )

    def _looked_up(self, columns: Columns) -> _Piece:
        (x, c, z), before = self._places(columns)
        self._along_c(columns, before, c)
        known = np.isfinite(x)
        if self.correction.needs_c:
            known &= np.isfinite(c)
        motion = np.array(columns.motion)
        lost = ~(known & np.isfinite(z)) & (motion == 1)
        if lost.any():
            raise self._unknown(columns, x, c, int(np.flatnonzero(lost)[0]))
        if self.places is not None:
            with np.errstate(invalid="ignore"):
                goes = (np.abs(x - before[0]) > 0.0) | (np.abs(c - before[1]) > 0.0)
            cuts = goes & known & np.isfinite(z) & (motion == 1)
            angle = np.deg2rad(np.nan_to_num(c))
            self.places.add(x * self.half_x, angle, z * self.state.unit, cuts)
        places = x[known] * self.half_x, np.deg2rad(np.nan_to_num(c[known]))
        dz, dx = np.zeros(x.size), np.zeros(x.size)
        dz[known] = self._valued(self.correction.z, places, columns, known)
        if "X" in self.settings.axes and self.correction.x is not None:
            dx[known] = self._valued(self.correction.x, places, columns, known)
        self.tally.look(columns, dz, known, self.settings.stroke)
        self._border(columns, dz, known, x * self.half_x, np.deg2rad(np.nan_to_num(c)))
        return _Piece(columns, x, c, z, before, known, dz, dx)

    def _border(
        self, columns: Columns, dz: FloatArray, known: BoolArray, x: FloatArray, c: FloatArray
    ) -> None:
        """Keep the largest step at the border of the map where nothing is corrected beyond it."""
        if self.settings.outside != "zero" or not known.any():
            return
        beyond = np.isinf(np.asarray(self.correction.z(x[known], c[known]), dtype=np.float64))
        u, v = (x * np.cos(c))[known], (x * np.sin(c))[known]
        rows = np.flatnonzero(known)
        dz_0, beyond_0, u_0, v_0 = self._edge
        step = np.abs(np.diff(np.r_[dz_0, dz[known]]))
        crossed = np.diff(np.r_[beyond_0, beyond].astype(int)) != 0
        crossed[0] &= not math.isnan(u_0)
        way = np.hypot(np.diff(np.r_[u_0, u]), np.diff(np.r_[v_0, v]))
        self._edge = (float(dz[known][-1]), bool(beyond[-1]), float(u[-1]), float(v[-1]))
        if crossed.any():
            i = int(np.argmax(np.where(crossed, step, -1.0)))
            if step[i] > self.tally.border:
                self.tally.border = float(step[i])
                self.tally.border_way = float(way[i])
                self.tally.border_line = columns.line_of(int(rows[i]))

    def _lookup(self, x: FloatArray, c: FloatArray) -> FloatArray:
        """Return the correction with the wanted behaviour outside; NaN where there is none."""
        c = np.nan_to_num(c)
        found = np.array(self.correction.z(x, c), dtype=np.float64)
        outside = np.isinf(found)
        if outside.any():
            if self.settings.outside == "hold" and self.correction.held is not None:
                found[outside] = self.correction.held(x[outside], c[outside])
            else:
                found[outside] = 0.0 if self.settings.outside == "zero" else np.nan
        return found

    def _valued(
        self,
        lookup: Lookup,
        places: tuple[FloatArray, FloatArray],
        columns: Columns,
        known: BoolArray,
    ) -> FloatArray:
        found = np.array(lookup(*places), dtype=np.float64)
        if found.shape != places[0].shape:
            raise DataError(
                f"the correction returned shape {found.shape} for {places[0].shape} positions; it must "
                "return one value for each"
            )
        outside = np.isinf(found)
        if outside.any():
            self._outside(found, outside, places, columns, known, is_z=lookup is self.correction.z)
        gap = np.isnan(found)
        if gap.any():
            i = int(np.flatnonzero(gap)[0])
            raise InvalidSamplesError(
                f"line {self._line_of(columns, known, i)}: at {_place(places, i)} the map was not "
                "measured (NaN); measure it there, fit a form that covers it, or shorten the path"
            )
        return found

    def _outside(
        self,
        found: FloatArray,
        outside: BoolArray,
        places: tuple[FloatArray, FloatArray],
        columns: Columns,
        known: BoolArray,
        *,
        is_z: bool,
    ) -> None:
        i = int(np.flatnonzero(outside)[0])
        line = self._line_of(columns, known, i)
        if self.settings.outside == "refuse":
            halved = (
                self.state.diameter is None
                and "X words are taken as radii: if they are diameters, say diameter=True; else "
            )
            raise InvalidSamplesError(
                f"line {line}: {_place(places, i)} is beyond the map{self._reach()}; {halved or ''}measure a larger "
                "area, or say outside='zero' (no correction there) or outside='hold' (the value at the edge)"
            )
        self.tally.outside += int(outside.sum()) if is_z else 0
        if self.settings.outside == "hold" and is_z and self.correction.held is not None:
            found[outside] = self.correction.held(places[0][outside], places[1][outside])
        else:
            found[outside] = 0.0

    def _reach(self) -> str:
        return f" ({self.correction.reach})" if self.correction.reach else ""

    @staticmethod
    def _line_of(columns: Columns, known: BoolArray, i: int) -> int:
        return columns.line_of(int(np.flatnonzero(known)[i]))

    def _unknown(self, columns: Columns, x: FloatArray, c: FloatArray, i: int) -> Exception:
        letter = "X" if math.isnan(x[i]) else "Z"
        if self.correction.needs_c and letter == "Z" and math.isnan(c[i]):
            letter = "C"
        return refuse_block(
            columns.line_of(i),
            "a feed move",
            f"no {letter} word was given so far, or none since the last home move, tool change or start of "
            "the spindle, so the position is not known",
            f"begin with a rapid move to a stated {letter}"
            + (", or use a correction over X alone" if letter == "C" else ""),
        )

    def _changed(self, lines: list[str], piece: _Piece) -> list[str]:
        columns = piece.columns
        unit = self.state.unit
        digits = self._digits(columns)
        power = 10.0**digits
        target = piece.z + piece.dz / unit
        rounded = np.rint(target * power) / power
        has_z = np.array(columns.end) > np.array(columns.start)
        keep = has_z & (np.abs(piece.dz / unit) * power <= 0.5)
        z_out = np.where(keep | ~piece.known, piece.z, rounded)
        same = self._in_force(columns, "Z", self._carry.z_out, z_out) == z_out
        insert = ~has_z & piece.known & np.isfinite(piece.z) & ~same
        edit = (has_z & piece.known & ~keep) | insert
        self._carry.z_out = _last(columns, "Z", z_out)
        out = list(lines)
        rows, starts, ends = columns.row, columns.start, columns.end
        values, places = z_out.tolist(), digits.astype(int).tolist()
        for i in np.flatnonzero(edit).tolist():
            block = lines[rows[i]]
            text = format_number(values[i], places[i])
            a = starts[i]
            if a == ends[i]:
                text = _inserted("Z", text, block, a)
            elif block[a] == "+" and text[0] != "-":
                text = "+" + text
            out[rows[i]] = block[:a] + text + block[ends[i] :]
        away = (z_out - target)[piece.known & np.isfinite(piece.z)] * unit
        self.tally.count(columns, edit, insert, away, unit / float(power.min()))
        x_want, x_digits = piece.x, digits
        if "X" in self.settings.axes:
            x_want, x_digits = self._moved(out, lines, piece, digits, edit)
        feeds = carried(np.array(columns.f), self._carry.f)
        self._carry.f = float(feeds[-1])
        wanted = [target, x_want, piece.c, digits, x_digits]
        return self._finished(out, lines, piece, wanted, feeds)

    @staticmethod
    def _in_force(columns: Columns, letter: str, before: float, values: FloatArray) -> FloatArray:
        """Return what the machine holds before each move, NaN where that is not known."""
        found = np.concatenate([[before], values[:-1]])
        found[[i for i in columns.lost_at(letter) if i < values.size]] = np.nan
        return found

    def _digits(self, columns: Columns) -> FloatArray:
        """Return the digits after the point of each Z; never fewer than the path has."""
        own = np.array(columns.digits, dtype=np.float64)
        wanted = self.decimals()
        if self.settings.decimals is not None and own.max() > wanted:
            i = int(own.argmax())
            raise DataError(
                f"line {columns.line_of(i)}: Z has {int(own[i])} digits after the point, decimals="
                f"{wanted} would cut them; ask for {int(own[i])} or more"
            )
        check_digits(own, "Z", columns)
        digits = np.maximum.accumulate(np.r_[self._carry.digits, np.maximum(own, wanted)])[1:]
        self._carry.digits = float(digits[-1])
        return digits

    def _moved(
        self, out: list[str], lines: list[str], piece: _Piece, digits: FloatArray, edit: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Change X words too; returns the wanted X in units of the file and its digits."""
        columns = piece.columns
        want = piece.x + piece.dx / self.half_x
        has_x = ~np.isnan(np.array(columns.x))
        digits = self._x_digits(lines, columns, digits, has_x)
        power = 10.0**digits
        rounded = np.rint(want * power) / power
        keep = has_x & (np.abs(piece.dx / self.half_x) * power <= 0.5)
        x_out = np.where(keep | ~piece.known, piece.x, rounded)
        same = self._in_force(columns, "X", self._carry.x_out, x_out) == x_out
        self._carry.x_out = _last(columns, "X", x_out)
        change = piece.known & ~np.where(has_x, keep, same)
        for i in np.flatnonzero(change).tolist():
            row = columns.row[i]
            block, text = out[row], format_number(x_out[i], int(digits[i]))
            word = _word_x(block, columns.line_of(i))
            if word is None:
                at = columns.end[i] + len(block) - len(lines[row])
                out[row] = block[:at] + _inserted("X", text, block, at) + block[at:]
                self.tally.inserted += 1
            else:
                out[row] = block[: word.end - len(word.number)] + text + block[word.end :]
        self.tally.changed += int(np.count_nonzero(change & ~edit))
        return np.where(piece.known, want, piece.x), digits

    def _x_digits(
        self, lines: list[str], columns: Columns, digits: FloatArray, has_x: BoolArray
    ) -> FloatArray:
        """Return the digits after the point of each X; never fewer than the path has."""
        own = np.array(digits)
        for i in np.flatnonzero(has_x).tolist():
            word = _word_x(lines[columns.row[i]], columns.line_of(i))
            own[i] = max(own[i], 0 if word is None else decimals_of(word.number))
        check_digits(own, "X", columns)
        found = np.maximum.accumulate(np.r_[self._carry.x_digits, own])[1:]
        self._carry.x_digits = float(found[-1])
        return np.asarray(found)

    def _finished(
        self,
        out: list[str],
        lines: list[str],
        piece: _Piece,
        wanted: list[FloatArray],
        feeds: FloatArray,
    ) -> list[str]:
        """Split blocks where the correction bends, check the rate, read back."""
        columns = piece.columns
        parts = self._parts(piece)
        radius = 0.5 if self.state.diameter else 1.0
        turn = np.array([[radius], [1.0], [1.0]])
        points = piece.before * turn, np.array([piece.x, piece.c, piece.z]) * turn
        limit = self.settings.blocks_per_s
        self.tally.rate(columns, points, piece.dz / self.state.unit, feeds, parts, limit)
        for i in np.flatnonzero(parts > 1)[::-1].tolist():
            text, more = split_block(
                lines[columns.row[i]],
                out[columns.row[i]],
                start=piece.before[:, i],
                end=np.array([piece.x[i], piece.c[i], piece.z[i]]),
                parts=int(parts[i]),
                digits=int(wanted[3][i]),
                inverse_time=columns.feed_mode[i] == "G93",
                correct=lambda x, c: (
                    self._lookup(x * self.half_x, np.deg2rad(c)) / self.state.unit
                ),
                line=columns.line_of(i),
                rollover=bool(self.settings.c_rollover),
            )
            out[columns.row[i]] = text
            for k, extra in enumerate((*more, more[3])):
                wanted[k] = np.insert(wanted[k], i, extra)
            self.tally.added += int(parts[i]) - 1
        self._read_back(out, *wanted)
        return out

    def _parts(self, piece: _Piece) -> NDArray[np.int64]:
        parts = np.ones(piece.x.size, dtype=np.int64)
        starts = np.isfinite(piece.before).all(axis=0) | (
            ~np.array(self.correction.needs_c) & np.isfinite(piece.before[[0, 2]]).all(axis=0)
        )
        moving = starts & piece.known & (np.array(piece.columns.motion) == 1)
        moving &= (piece.before[0] != piece.x) | (
            (piece.before[1] != piece.c) & np.array(self.correction.needs_c)
        )
        where = np.flatnonzero(moving)
        if not where.size:
            return parts
        ends = np.array([piece.before[0], piece.before[1], piece.x, piece.c])[:, where]
        ends[[0, 2]] *= self.half_x
        ends[[1, 3]] = np.deg2rad(ends[[1, 3]]) if self.correction.needs_c else 0.0
        pitch, tolerance = self.correction.pitch, self.settings.tolerance
        if tolerance is None:
            left = chord_errors(self._lookup, ends, pitch)
        else:
            parts[where], left = part_counts(self._lookup, ends, tolerance, pitch)
        note = check_way(piece.columns, where, left, tolerance)
        if note is not None:
            self.state.note(*note)
        if self.settings.c_rollover is None and self.correction.needs_c:
            check_turns(piece.columns, piece.c - piece.before[1], parts)
        self.tally.chord = max(self.tally.chord, float(left[np.isfinite(left)].max(initial=0.0)))
        return parts

    def _read_back(
        self, out: list[str], z: object, x: object, c: object, digits: object, x_digits: object
    ) -> None:
        """Parse what was written and compare it with what was meant."""
        lines = byte_lines(out) if self.tally.added else out
        columns = read_columns(lines, self._again, self._readers[1], self._line_out)
        self._line_out += len(lines)
        seen = self._seen
        if not columns.row:
            for name in "zxc":
                if columns.lost_at(name.upper()):
                    setattr(seen, name, math.nan)
            return
        found = []
        for name in "zxc":
            lost = columns.lost_at(name.upper())
            found.append(carried(np.array(getattr(columns, name)), getattr(seen, name), lost))
            setattr(seen, name, _last(columns, name.upper(), found[-1]))
        wanted = [np.asarray(v, dtype=np.float64) for v in (z, x, c)]
        if any(f.shape != w.shape for f, w in zip(found, wanted, strict=True)):
            raise _bug("the number of moves changed")
        half, half_x = (0.5 * 10.0 ** -np.asarray(d, dtype=np.float64) for d in (digits, x_digits))
        away = [np.nan_to_num(np.abs(f - w)) for f, w in zip(found, wanted, strict=True)]
        limits = [half * (1 + _ROUNDING) + 1e-12]
        limits.append(
            half_x * (1 + _ROUNDING) + 1e-12 if "X" in self.settings.axes else np.zeros(half.size)
        )
        limits.append(np.zeros(half.size))
        for letter, a, limit, f, w in zip("ZXC", away, limits, found, wanted, strict=True):
            if (a > limit).any() or (np.isnan(f) != np.isnan(w)).any():
                raise _bug(f"{letter} is not what was meant")
        self.tally.read_back = max(self.tally.read_back, float(away[0].max()) * self.state.unit)


def _last(columns: Columns, letter: str, values: FloatArray) -> float:
    """Return what is in force after the last move, NaN if it was lost since."""
    return math.nan if values.size in columns.lost_at(letter) else float(values[-1])


def _word_x(block: str, line: int) -> Token | None:
    return next((t for t in tokenize(block, line) if t.letter == "X"), None)


def byte_lines(texts: Iterable[str]) -> list[str]:
    """Return single lines, cut at line ends only (str.splitlines cuts at more)."""
    data = "".join(texts).encode("latin-1")
    return [part.decode("latin-1") for part in data.splitlines(keepends=True)]


def _bug(what: str) -> TableError:
    return TableError(
        f"what was written does not read back as meant ({what}); this is a bug in metrosep, nothing was "
        "written"
    )


def _inserted(letter: str, number: str, block: str, at: int) -> str:
    """Return a word in the manner of its block: lower case, a space before it."""
    words = re.findall(r"[XCZxcz]", block[:at])
    letter = letter.lower() if words and words[-1].islower() else letter
    before = max(block.rfind(w, 0, at) for w in set(words)) if words else 0
    gap = " " if before == 0 or block[before - 1] in " \t" else ""
    return gap + letter + number


def _place(places: tuple[FloatArray, FloatArray], i: int) -> str:
    return f"X = {places[0][i] * 1e3:.6g} mm, C = {math.degrees(places[1][i]):.6g} deg"


# ---- split one linear move into equal parts along the same line, each with its own correction ----
# The first part keeps every other word of the block (number, mode, comment); the parts that follow
# hold axis words only, the last of them the X and C of the original, digit for digit. In inverse time
# (G93) every part carries F times the number of parts, so that the whole takes as long as before.

_DEGREE_DIGITS = 7
_FEED_DIGITS = 6
_MODES = frozenset({"0", "00", "1", "01", "93", "94", "95", "90", "21", "20"})


def split_block(
    original: str,
    corrected: str,
    *,
    start: FloatArray,
    end: FloatArray,
    parts: int,
    digits: int,
    inverse_time: bool,
    correct: Callable[[FloatArray, FloatArray], FloatArray],
    line: int,
    rollover: bool = False,
) -> tuple[str, tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
    """Return the blocks that replace one, and the points that were added."""
    tokens = tokenize(original, line)
    require_plain(tokens, line)
    words = {t.letter: t for t in tokens if t.kind == "word"}
    if inverse_time and "F" not in words:
        why = "in inverse time (G93) every block needs an F word"
        raise refuse_block(line, "a block to be split", why, "add F")
    share = np.arange(1, parts) / parts
    x, c, z = (start[:, None] + (end - start)[:, None] * share).tolist()
    x_digits = max(digits, decimals_of(words["X"].number) if "X" in words else 0)
    c_digits = max(_DEGREE_DIGITS, decimals_of(words["C"].number) if "C" in words else 0)
    x_text = [format_number(v, x_digits) for v in x]
    c = [v % 360.0 for v in c] if rollover else c
    c_text = [format_number(v, c_digits) for v in c] if "C" in words else []
    x = np.array([float(t) for t in x_text]) if "X" in words else np.full(parts - 1, end[0])
    c = np.array([float(t) for t in c_text]) if "C" in words else np.full(parts - 1, end[1])
    z = np.array(z) + correct(x, c)
    if not np.isfinite(z).all():
        raise InvalidSamplesError(
            f"line {line}: between its ends the move crosses what was not measured (NaN), or leaves the "
            "map; measure it there or shorten the path"
        )
    z_text = [format_number(v, digits) for v in z]
    feed = format_feed(words["F"].value * parts) if inverse_time else ""
    eol = original[len(original.rstrip("\r\n")) :] or "\n"
    last = {t.letter: t.number for t in tokenize(corrected, line) if t.kind == "word"}
    lower = words["X" if "X" in words else "C" if "C" in words else "Z"].text[0].islower()
    all_of = {"X": x_text[0], "C": c_text[0] if c_text else "", "Z": z_text[0], "F": feed}
    first = {k: v for k, v in all_of.items() if v and (k in words or k == "Z")}
    blocks = [edited(tokens, first, "XCZ").rstrip("\r\n")]
    blocks += [
        _more(
            {"X": x_text[i], "C": c_text[i] if c_text else "", "Z": z_text[i], "F": feed},
            words,
            lower,
        )
        for i in range(1, parts - 1)
    ]
    final = {k: last.get(k, "") for k in "XC"} | {"Z": last.get("Z", ""), "F": feed}
    if not final["Z"]:  # the end needs no Z of its own, but the points before it have changed Z
        final["Z"] = format_number(float(end[2] + correct(end[:1], end[1:2])[0]), digits)
    blocks.append(_more(final, words, lower))
    text = eol.join(blocks) + original[len(original.rstrip("\r\n")) :]
    return text, (z, x, c, np.full(parts - 1, float(digits)))


def require_plain(tokens: tuple[Token, ...], line: int, axes: Collection[str] = "XCZ") -> None:
    """Refuse a block to be split that holds what must not happen before its end."""
    for token in tokens:
        if token.kind in ("space", "comment"):
            continue
        plain = (token.letter in axes or token.letter in "NFS") or (
            token.letter == "G" and token.number in _MODES
        )
        if token.kind != "word" or not plain:
            raise refuse_block(
                line,
                token.text,
                "the block has to be split, and this must not happen before its end",
                "put it into a block of its own, or raise the tolerance",
            )


def format_feed(value: float) -> str:
    """Return the number of an F word."""
    return format_number(value, _FEED_DIGITS)


def edited(tokens: Sequence[Token], numbers: Mapping[str, str], axes: Collection[str]) -> str:
    """Return a block with other numbers; axis words that it lacks follow its last one, in its case."""
    last = max(i for i, t in enumerate(tokens) if t.kind == "word" and t.letter in axes)
    there = {t.letter for t in tokens if t.kind == "word"}
    new = [letter + n for letter, n in numbers.items() if letter in axes and letter not in there]
    pieces = []
    for i, token in enumerate(tokens):
        text = token.text
        if token.kind == "word" and token.letter in numbers:
            text = text[: len(text) - len(token.number)] + numbers[token.letter]
        pieces.append(text)
        if i == last and new:
            gap = " " if last == 0 or tokens[last - 1].kind == "space" else ""
            more = "".join(gap + w for w in new)
            pieces.append(more.lower() if text[0].islower() else more)
    return "".join(pieces)


def _more(numbers: dict[str, str], words: dict[str, Token], lower: bool) -> str:
    found = [
        letter + numbers[letter]
        for letter in "XCZF"
        if numbers[letter] and (letter in words or letter == "Z")
    ]
    text = " ".join(found)
    return text.lower() if lower else text


# ---- what is counted while a path is rewritten: changes, corrections, rates --------------------


@dataclass(slots=True)
class Tally:
    """Running counts and extremes of a path; lengths in m, times in s."""

    # lines; moves; blocks changed; words inserted; blocks added; moves before the position was
    # known; moves beyond the map
    blocks: int = 0
    moves: int = 0
    changed: int = 0
    inserted: int = 0
    added: int = 0
    unplaced: int = 0
    outside: int = 0
    low: float = math.inf  # smallest and largest correction, sum and sum of squares
    high: float = -math.inf
    total: float = 0.0
    squares: float = 0.0
    after_low: float = math.inf  # smallest and largest of what rounding leaves
    after_high: float = -math.inf
    step: float = 0.0  # one unit of the last digit
    chord: float = 0.0  # largest deviations between points, and of the file from what was meant
    read_back: float = 0.0
    first: int = 0  # lines of the first and last change
    last: int = 0
    shortest: float = math.inf  # time of the fastest block
    shortest_line: int = 0  # lines of that block and of the largest change of feed
    feed_change: float = 0.0  # relative change of the time of a block in G94 with C moving
    feed_line: int = 0
    per_turn: bool = False  # whether there is feed per turn
    # largest step of the correction from a move within the map to one beyond it, and the length of
    # that move on the part
    border: float = 0.0
    border_way: float = 0.0
    border_line: int = 0  # its line

    def look(
        self, columns: Columns, dz: FloatArray, known: NDArray[np.bool_], stroke: float
    ) -> None:
        """Take the corrections of a piece into account."""
        self.moves += dz.size
        self.unplaced += int(np.count_nonzero(~known))
        values = dz[known]
        if not values.size:
            return
        large = np.abs(dz) > stroke
        if large.any():
            i = int(np.flatnonzero(large)[0])
            raise LimitError(
                f"line {columns.line_of(i)}: the correction is {dz[i] * 1e6:.6g} um, the limit is "
                f"{stroke * 1e6:.6g} um; is the map in another unit, or is its form still in it? give "
                "stroke= for larger ones"
            )
        self.low, self.high = min(self.low, values.min()), max(self.high, values.max())
        self.total += float(values.sum())
        self.squares += float(values @ values)

    def count(
        self,
        columns: Columns,
        edit: NDArray[np.bool_],
        insert: NDArray[np.bool_],
        away: FloatArray,
        step: float,
    ) -> None:
        """Count the blocks of a piece that change."""
        self.step = max(self.step, step)
        if away.size:
            self.after_low = min(self.after_low, float(away.min()))
            self.after_high = max(self.after_high, float(away.max()))
        where = np.flatnonzero(edit)
        if where.size:
            self.first = self.first or columns.line_of(int(where[0]))
            self.last = columns.line_of(int(where[-1]))
        self.changed += int(where.size)
        self.inserted += int(np.count_nonzero(insert))

    def rate(
        self,
        columns: Columns,
        points: tuple[FloatArray, FloatArray],
        dz: FloatArray,
        feeds: FloatArray,
        parts: NDArray[np.int64],
        limit: float | None,
    ) -> None:
        """Find the block that takes the shortest time."""
        modes = np.array(columns.feed_mode)
        feed = np.array(columns.motion) == 1
        before, after = points
        way = np.nan_to_num(after - before)
        length = np.hypot(way[0], way[2])
        only_c = length == 0.0
        per_minute = feed & np.isin(modes, ("G94", "G98", ""))
        self.per_turn |= bool(np.any(feed & np.isin(modes, ("G95", "G99"))))
        with np.errstate(divide="ignore", invalid="ignore"):
            time = np.where(modes == "G93", 60.0 / feeds, np.nan)
            travel = np.where(only_c, np.abs(way[1]), length)
            time = np.where(per_minute, 60.0 * travel / feeds, time) / parts
        time = np.where(feed & (time > 0.0), time, np.inf)
        if not time.size:
            return
        i = int(np.argmin(time))
        if time[i] < self.shortest:
            self.shortest, self.shortest_line = float(time[i]), columns.line_of(i)
        if limit is not None and time[i] * limit < 1.0 - 1e-9:
            raise LimitError(
                f"line {columns.line_of(i)}: the block takes {time[i] * 1e3:.4g} ms, the controller "
                f"takes {limit:.6g} blocks per second; lower feed or spindle speed, use fewer points per "
                "turn or a larger tolerance"
            )
        self._feed(columns, way, length, dz, per_minute)

    def _feed(
        self,
        columns: Columns,
        way: FloatArray,
        length: FloatArray,
        dz: FloatArray,
        per_minute: NDArray[np.bool_],
    ) -> None:
        """Find how much the length, and with it the time, of a block in G94 changes with C moving."""
        rise = np.diff(np.r_[dz[:1], dz])
        new = np.hypot(way[0], way[2] + rise)
        turning = per_minute & (way[1] != 0.0) & (length > 0.0)
        if turning.any():
            change = np.where(turning, np.abs(new / np.where(turning, length, 1.0) - 1.0), 0.0)
            i = int(np.argmax(change))
            if change[i] > self.feed_change:
                self.feed_change, self.feed_line = float(change[i]), columns.line_of(i)
