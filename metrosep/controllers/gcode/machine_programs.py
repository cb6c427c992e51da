"""Programs in words of all axes, corrected for the errors of the machine: position and orientation.

Words are commands of the axes, machine position = word + `zero`; a block is a pose, as a row of a list
is (`metrosep.controllers.gcode.poses`). Between two poses a controller moves all axes in proportion:
where the corrected way would miss the nominal one by more than a tolerance, the block is split. What
was written is read back by the same grammar and put through the machine before it is kept.
"""

from __future__ import annotations

import math
import os
import re
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.controllers.base import sidecar_path
from metrosep.controllers.gcode.columns import (
    check_files,
    mark_text,
    marked,
    open_program,
    pieces,
    require_uncorrected,
    require_unmarked,
)
from metrosep.controllers.gcode.corrections import MAX_PARTS
from metrosep.controllers.gcode.lists import write_list
from metrosep.controllers.gcode.machine_words import MachineWords
from metrosep.controllers.gcode.paths import named_error
from metrosep.controllers.gcode.poses import (
    STEP_ANGLE,
    PosesResult,
    audit_of,
    judged,
    offsets_of,
    refuse_large,
    rewrite_poses,
)
from metrosep.controllers.gcode.rewrite import byte_lines, edited, format_feed, require_plain
from metrosep.controllers.gcode.state import (
    MM,
    ModalState,
    Token,
    decimals_of,
    format_number,
    refuse_block,
    scale_of_unit,
    tokenize,
)
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, LimitError, MetrosepError, TableError, UnitError
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors

__all__ = ["is_program", "rewrite_machine_program"]

_SHORTEST_TURN = 1e-3 / 60.0
"""In min: no control plans a block of less than a millisecond or so at the feed that it states."""
_SAME_TIME = 0.1
"""Share by which a correction may change how long a turn takes, as an override does, before F must be known."""
_FEWEST, _MOST_LOOKS = 16, 1 << 20
_AT_ONCE = 20_000
_BLOCK = re.compile(r"/?\s*(?:[NGMOT]\s*\d|[A-Z]\s*=)", re.IGNORECASE)


@dataclass(slots=True)
class _Moves:
    """Moves of a program: where the axes stand after each, in units of the file and degrees."""

    axes: tuple[str, ...]
    line: list[int] = field(default_factory=list)  # from 0
    feed: list[bool] = field(default_factory=list)
    inverse: list[bool] = field(default_factory=list)  # G93 in force
    # of all axes, one move after another, NaN where not known: numbers, a list of lists is 5 times as large
    place: array[float] = field(default_factory=lambda: array("d"))
    broken: list[bool] = field(default_factory=list)  # the place before the move is not known
    part: list[bool] = field(default_factory=list)  # words are places on the part
    # F of G94 as it is written; empty where none is in force
    rate: list[str] = field(default_factory=list)
    decimals: list[bytes] = field(default_factory=list)  # that the words of each axis have

    @property
    def places(self) -> FloatArray:
        return np.array(self.place).reshape(-1, len(self.axes))


def is_program(path: str | os.PathLike[str]) -> bool:
    """Return whether the first line that is no comment is a block of G-code, not a row of a list."""
    with open_program(Path(path)) as stream:
        for lines in pieces(stream, Path(path), mark=True):
            for line in lines:
                text = line.strip()
                if not text or text[0] in "#%;(":
                    continue
                try:
                    tokenize(text)
                except MetrosepError:  # a block that cannot be read is none of a list
                    return _BLOCK.match(text) is not None
                return True
    return False


@described_by(rewrite_poses, errors=False)
def rewrite_machine_program(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    chain: Chain,
    errors: Errors,
    *,
    tool: ArrayLike = (0.0, 0.0, 0.0),
    tool_axis: ArrayLike = (0.0, 0.0, 1.0),
    zero: Mapping[str, float] | None = None,
    unit: str | None = None,
    diameter: bool | None = None,
    rotary_feed: str | None = None,
    tolerance: float | None = None,
    resolution: float = 1e-9,
    max_step: float | None = None,
    stroke: float = 100e-6,
    harmless_m: Iterable[int] = (),
    again: bool = False,
    overwrite: bool = False,
) -> PosesResult:
    r"""Write a program whose words are commands of the axes with the errors of the machine taken off.

    Parameters
    ----------
    source, target : str or path
        The program and the corrected one; a sidecar ``<target>.json`` appears beside it.
    zero : mapping of str to float, m or rad, optional
        Machine position at which the word of an axis is zero: the work offset, of Z with the length of
        the tool that G43 takes; 0 if omitted.
    unit : str, optional
        "mm" or "inch", for a program without G20 or G21.
    diameter : bool, optional
        Whether X words are diameters; where the program has no G7 or G8 and the machine no Y (a lathe) it
        must be given.
    rotary_feed : str, optional
        What F is under G94 where axes of rotation move: ``"linear"``, the feed along the linear axes while
        one of them moves, else deg/min (LinuxCNC; Sinumerik as delivered); ``"all"``, along the way of
        all axes, a degree counted as a mm or inch (Fanuc). Needed where the two differ.
    tolerance : float, m, optional
        Blocks are split until the tool point misses the nominal way between poses by less.
    harmless_m : iterable of int, optional
        M codes of this machine that neither move an axis nor change coordinates.

    Returns
    -------
    PosesResult
        Errors before and after, amounts, messages.

    Raises
    ------
    UnsupportedFeatureError
        The text does not tell where the axes stand (arcs, incremental words, tilted planes), or a block that must be split holds what must not happen before its end.
    DataError
        An axis of the machine has more than one letter, the program has no pose, or holds a correction
        already.
    LimitError
        A correction exceeds `stroke`, or 10 mrad of an axis of rotation; or 4096 parts do not meet the
        tolerance.
    SignCheckFailedError
        By the bytes that would be written the error does not shrink.
    WriteError
        The target exists, is the source, or cannot be written.

    Notes
    -----
    The way is judged as it is written, after rounding, at one place somewhere in each mm, degree and
    quarter of a step of a table of errors (of a quarter wave of a series), 16 in a part or more. With
    ``rotary_feed="linear"`` a feed move that turns axes is written in inverse time (G93) where the correction
    would change by more than 10 % how long it takes; it takes as long as F of G94 says.

    Under tool-centre-point control (G43.4 to G49, TRAORI to TRAFOOF) X, Y, Z are places on the part, in
    coordinates that turn with it and agree with the words of the axes where those of the axes of rotation
    are 0; the control is taken to know the nominal machine and the length to `tool`. D1 to D9... of
    Sinumerik name the edge whose lengths are in `tool` and `zero`: one edge in a path, D0 after it.

    Rapid moves are corrected at their ends and not split. A move before all axes are known is left as it
    is; the first move with known axes takes up every axis.

    Examples
    --------
    >>> import tempfile
    >>> from metrosep.machine import presets
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "a.nc"
    ...     _ = path.write_text("G21 G90 G0 X0 Y0 Z0\nG1 X100 F500\n")
    ...     found = rewrite_machine_program(
    ...         path, path.with_name("b.nc"), presets("mill_xyz"),
    ...         {"EXX": lambda x: 1e-5 * x, "EYX": lambda x: 2e-5 * x})
    ...     print(found.target.read_text().splitlines()[-1])
    G1 X99.999000 Y-0.002000 F500
    """
    resolution = numbers.positive(resolution, "resolution", dimension="length")
    limit = numbers.positive(stroke, "stroke", dimension="length")
    if tolerance is not None:
        tolerance = numbers.positive(tolerance, "tolerance", dimension="length")
    moving = (e.name for e in chain.elements if e.kind != "fixed" and not e.parked)
    kinds = sorted(moving, key=lambda a: ("XYZABCUVW".find(a), a))
    for axis in kinds:
        if len(axis) != 1:
            raise DataError(
                f"axis {axis} of the machine has no letter of its own in a program; correct a list of "
                "positions with a column for each axis"
            )
    start, end = Path(source), Path(target)
    check_files(start, end, overwrite=overwrite)
    if not again:
        require_uncorrected(start)
    with open_program(start) as stream:
        lines = [line for piece in pieces(stream, start) for line in piece]
    if not again:
        require_unmarked(lines, start)
    offset = offsets_of(zero or {}, kinds, chain)
    if rotary_feed is not None:
        rotary_feed = numbers.choice(rotary_feed, "rotary_feed", ("linear", "all"))
    codes = frozenset(int(m) for m in harmless_m)
    scale = scale_of_unit(unit)
    try:
        program = _Program(lines, tuple(kinds), scale, codes, diameter)
        machine = MachineWords(
            chain, errors, tool, tool_axis, max_step, tuple(kinds), program.unit, offset,
            diameter=program.diameter, on_part=any(program.moves.part),
        )  # fmt: skip
        program.rotary_feed = rotary_feed
        changed = program.rewritten(machine, tolerance, resolution, limit)
        actual = _Program(program.lines, tuple(kinds), scale, codes, diameter)
    except MetrosepError as error:
        if str(error).startswith("line "):
            raise named_error(error, start) from None
        raise
    written = actual.moves.places[program.written_at]
    if (
        written.shape != program.meant.shape
        or (np.abs(written - program.meant) > 0.5000001 * 10.0**-program.meant_digits).any()
    ):
        raise TableError("the program does not read back as meant; this is a bug in metrosep")
    sizes = judged(
        chain, errors, machine.si(program.nominal, program.on_part),
        machine.si(written, program.on_part), tool, tool_axis,
        changed=changed, name=str(end),
    )  # fmt: skip
    audit = audit_of(chain, errors, tool, offset)
    mark = mark_text(tuple(kinds), audit)
    final = marked(program.lines, mark) if changed else program.lines
    messages = [*chain.messages, *program.messages(tolerance), *machine.messages]
    if not changed:
        messages.append("no block changed: less than half of the last digit")
    ranges = {a: (float(c.min()), float(c.max())) for a, c in machine.correction.items()}
    sidecar = {
        "correction": audit,
        "sign": "the actual pose of the machine with its errors is the nominal one; c = -e",
        "mark": mark if changed else None,
        "n_blocks": len(lines),
        "n_points": int(program.nominal.shape[0]),
        "n_changed": changed,
        "n_added": program.added,
        "n_inverse_time": len(program.timed),
        "n_not_placed": program.unplaced,
        "tolerance_m": tolerance,
        "chord_error_m": program.chord,
        "correction_si": {a: list(v) for a, v in ranges.items()},
        **sizes,
        "messages": messages,
    }
    return PosesResult(
        target=end,
        sidecar=sidecar_path(end),
        n_points=int(program.nominal.shape[0]),
        n_changed=changed,
        before=sizes["before_rms_m"],
        after=sizes["after_rms_m"],
        turn_before=sizes["turn_before_rms_rad"],
        turn_after=sizes["turn_after_rms_rad"],
        correction=ranges,
        messages=tuple(messages),
        audit=write_list(start, end, lines, final, sidecar, overwrite=overwrite, schema="path"),
    )


def _shares(size: int) -> FloatArray:
    """Return places from 0 to 1, one somewhere in each of equal intervals: in step with no wave."""
    within = np.random.default_rng(size).random(size)
    return np.asarray((np.arange(size) + within) / size)


def _rounded(places: FloatArray, digits: Any) -> FloatArray:
    """Return places as they are written."""
    unit = 10.0**digits
    return np.asarray(np.rint(places * unit) / unit)


class _Program:
    """A program read block by block, and rewritten."""

    def __init__(
        self,
        lines: Sequence[str],
        axes: tuple[str, ...],
        scale: float | None,
        codes: frozenset[int],
        diameter: bool | None,
    ) -> None:
        self.lines = list(lines)
        self.state = ModalState(
            scale=scale, diameter=diameter, stated_diameter=diameter is not None, harmless_m=codes,
            g_system="mill", axes="".join(axes), spindle_axis="", part=False,
        )  # fmt: skip
        self.moves = _Moves(axes)
        self.added = self.unplaced = self.first_unplaced = 0
        self.chord = 0.0
        self.rotary_feed: str | None = None
        self.timed: dict[int, str] = {}  # rows that go over to G93, with F of G94
        self._read()

    @property
    def unit(self) -> float:
        """Length of one unit of the file, m."""
        return self.state.unit if self.moves.line else MM

    @property
    def diameter(self) -> bool:
        """Whether X words are diameters; on a lathe somebody must have said so."""
        if self.state.diameter is None and "Y" not in self.moves.axes and "X" in self.moves.axes:
            raise UnitError(
                "whether X words are diameters is not stated; give diameter=True or diameter=False, or put G7 "
                "or G8 into the program"
            )
        return bool(self.state.diameter)

    def _read(self) -> None:
        held = dict.fromkeys(self.moves.axes, math.nan)
        broken, rate, mode = True, "", ""
        for row, block in enumerate(self.lines):
            if self.state.ended:
                return
            tokens = tokenize(block, row + 1)
            moves = self.state.apply(tokens, row + 1)
            if self.state.feed_mode != mode:
                rate, mode = "", self.state.feed_mode
            if mode == "G94":
                rate = next((t.number for t in tokens if t.letter == "F"), rate)
            if self.state.lost:
                held = {a: math.nan if a in self.state.lost else v for a, v in held.items()}
                self.state.lost, broken = "", True
            if not moves:
                continue
            if self.state.dropped:
                held, broken = dict.fromkeys(held, math.nan), True
                if self.state.motion == 1:
                    why = "G49 or D0 took the length of the tool away, so where the tool stands is not known"
                    way = "keep G43.4, G43 or the edge to the end of the path"
                    raise refuse_block(row + 1, "a feed move", why, way)
            words: dict[str, Token] = {}
            for token in tokens:
                if token.kind == "word" and (token.letter in held or token.letter == "F"):
                    if token.letter in words:
                        why = "the letter is there twice in one block"
                        raise refuse_block(row + 1, token.text, why, "write it once")
                    words[token.letter] = token
            if self.state.motion == 1 and self.state.feed_mode == "G93" and "F" not in words:
                why = "in inverse time (G93) every feed move needs an F word"
                raise refuse_block(row + 1, "a feed move", why, "add F")
            if not self.state.dropped:
                held |= {a: t.value for a, t in words.items() if a in held}
            place = [held[a] for a in self.moves.axes]
            known = all(v == v for v in place)
            if self.state.motion == 1 and not known:
                missing = next(a for a, v in held.items() if v != v)
                raise refuse_block(
                    row + 1,
                    "a feed move",
                    f"no {missing} word was given so far, or none since the last home move, tool change "
                    "or change of tool-centre-point control, so the position is not known",
                    f"begin with a rapid move to a stated {missing}",
                )
            self.moves.line.append(row)
            self.moves.feed.append(self.state.motion == 1)
            self.moves.inverse.append(self.state.feed_mode == "G93")
            self.moves.place.extend(place)
            self.moves.broken.append(broken)
            self.moves.part.append(bool(self.state.part))
            self.moves.rate.append(rate)
            self.moves.decimals.append(
                bytes(min(decimals_of(words[a].number), 99) if a in words else 0 for a in held)
            )
            broken = not known

    def rewritten(
        self, machine: MachineWords, tolerance: float | None, resolution: float, limit: float
    ) -> int:
        """Rewrite the blocks, and return how many changed."""
        whole = self.moves.places
        known = np.isfinite(whole).all(axis=1)
        self.unplaced = int(np.count_nonzero(~known))
        if not known.any():
            raise DataError(
                f"the program holds no move (G0 or G1) after which {', '.join(self.moves.axes)} are all "
                "known; the correction of a machine depends on every axis"
            )
        self.first_unplaced = self.moves.line[int(np.argmin(known))] + 1
        rows = np.flatnonzero(known)
        places, part = whole[rows], np.array(self.moves.part)[rows]
        dq = machine.at(places, part, whole=True)
        self._refuse_large(machine, rows, limit)
        step = np.where(machine.turns, STEP_ANGLE, resolution) / machine.scale
        least = np.maximum(1, np.ceil(-np.log10(step) - 1e-9)).astype(int)
        own = np.array([list(self.moves.decimals[r]) for r in rows])
        digits = np.maximum(least, own)
        written = _rounded(places + dq, digits) - places
        if tolerance is not None:
            self._refuse_coarse(machine, rows, places, dq, written, part, tolerance)
        extra = self._split(machine, rows, places, written, digits, tolerance)
        return self._write(machine, rows, places, written, extra, digits)

    def _refuse_coarse(
        self,
        machine: MachineWords,
        rows: Any,
        places: FloatArray,
        dq: FloatArray,
        written: FloatArray,
        part: NDArray[np.bool_],
        tolerance: float,
    ) -> None:
        """Refuse a tolerance that the digits that are written cannot keep."""
        off = machine.missed(places, places + written, part)
        bad = (off > tolerance) & (machine.missed(places, places + dq, part) <= tolerance)
        if bad.any():
            i = int(np.argmax(np.where(bad, off, 0.0)))
            raise LimitError(
                f"line {self.moves.line[rows[i]] + 1}: by the digits that are written the tool point misses its "
                f"place by {format_length(float(off[i]))}, the tolerance is {format_length(tolerance)}; give "
                "a finer resolution, or a wider tolerance"
            )

    def _refuse_large(self, machine: MachineWords, rows: Any, limit: float) -> None:
        for i, axis in enumerate(self.moves.axes):
            most = limit if not machine.turns[i] else None
            refuse_large(
                axis, machine.correction[axis], most, [self.moves.line[r] for r in rows], ""
            )

    def _split(
        self,
        machine: MachineWords,
        rows: Any,
        places: FloatArray,
        dq: FloatArray,
        digits: Any,
        tolerance: float | None,
    ) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Return nominal and added places within the moves that are split."""
        n = rows.size
        extra: dict[int, tuple[FloatArray, FloatArray]] = {}
        feed, broken = np.array(self.moves.feed)[rows], np.array(self.moves.broken)[rows]
        begins = np.flatnonzero(feed & ~broken & (np.arange(n) > 0))
        if not begins.size:
            return extra
        way = places[begins] - places[begins - 1]  # of one kind of words: a change of it breaks
        looks = (np.abs(way * machine.scale) / machine.look).max(axis=1)
        if looks.max() > _MOST_LOOKS:
            line = self.moves.line[rows[begins[int(np.argmax(looks))]]] + 1
            raise LimitError(
                f"line {line}: the errors are so fine that the move must be looked at in {looks.max():.3g} "
                f"places, more than {_MOST_LOOKS}; write it as shorter moves"
            )
        moving = looks > 0.0
        begins, way, looks = begins[moving], way[moving], looks[moving]
        sizes = 2 ** np.ceil(np.log2(np.maximum(looks, _FEWEST))).astype(np.int64)
        for size in np.unique(sizes).tolist():
            chosen = np.flatnonzero(sizes == size)
            for some in np.array_split(chosen, 1 + chosen.size * size // _AT_ONCE):
                self._look(machine, rows, begins[some], places, dq, digits, size, tolerance, extra)
        turned = np.abs(way[:, machine.turns]).max(axis=1, initial=0.0)
        for i in np.flatnonzero(turned > 180.0).tolist():
            if int(begins[i]) not in extra:
                continue
            raise refuse_block(
                self.moves.line[rows[begins[i]]] + 1,
                f"a block to be split that turns an axis by {turned[i]:.6g} deg",
                "on some controllers it takes the shortest way over its roll-over, on others it goes along "
                "its numbers",
                "write it as moves of 180 deg or less",
            )
        return extra

    def _look(
        self,
        machine: MachineWords,
        rows: Any,
        ends: Any,
        places: FloatArray,
        dq: FloatArray,
        digits: Any,
        size: int,
        tolerance: float | None,
        extra: dict[int, tuple[FloatArray, FloatArray]],
    ) -> None:
        """Find the parts of moves that are looked at equally often."""
        share = _shares(size)
        part_of = np.array(self.moves.part)[rows]
        count, open_ = 1, ends
        while open_.size:
            a, b = places[open_ - 1][:, None], places[open_][:, None]
            inner = np.arange(count + 1)[:, None] / count
            nodes = a + (b - a) * inner
            added = np.empty((open_.size, count + 1, nodes.shape[-1]))
            added[:, 0], added[:, -1] = dq[open_ - 1], dq[open_]
            if count > 1:
                within = nodes[:, 1:-1]
                added[:, 1:-1] = machine.at(
                    within.reshape(-1, within.shape[-1]), np.repeat(part_of[open_], count - 1)
                ).reshape(within.shape)
                added[:, 1:-1] = _rounded(within + added[:, 1:-1], digits[open_][:, None]) - within
            part = np.minimum((share * count).astype(int), count - 1)
            rest = (share * count - part)[None, :, None]
            command = a + (b - a) * share[:, None]
            command_added = added[:, part] * (1.0 - rest) + added[:, part + 1] * rest
            flat = command.reshape(-1, command.shape[-1])
            off = machine.missed(
                flat, flat + command_added.reshape(flat.shape), np.repeat(part_of[open_], size)
            )
            worst = off.reshape(open_.size, size).max(axis=1)
            left = worst > (math.inf if tolerance is None else tolerance)
            self.chord = max(self.chord, float(worst[~left].max(initial=0.0)))
            for i in np.flatnonzero(~left).tolist():
                if count > 1:
                    extra[int(open_[i])] = (nodes[i, 1:-1], added[i, 1:-1])
            if left.any() and count >= MAX_PARTS:
                i = int(np.flatnonzero(left)[0])
                raise LimitError(
                    f"line {self.moves.line[rows[open_[i]]] + 1}: in {MAX_PARTS} parts the tool point still "
                    f"misses its way by {format_length(float(worst[i]))}, the tolerance is "
                    f"{format_length(float(tolerance or 0.0))}; the resolution is too coarse for "
                    "it, or the errors have a step or bend too fast"
                )
            open_ = open_[left]
            count *= 2
            if _FEWEST * count > size:
                size = _FEWEST * count
                share = _shares(size)

    def _write(
        self,
        machine: MachineWords,
        rows: Any,
        places: FloatArray,
        dq: FloatArray,
        extra: dict[int, tuple[FloatArray, FloatArray]],
        digits_at: Any,
    ) -> int:
        """Put the numbers into the blocks; what was meant is kept beside."""
        nominal, meant, digits_of_all, at = array("d"), array("d"), array("d"), array("q")
        held = [math.nan] * len(self.moves.axes)  # what the machine holds, as written
        changed, move, added = 0, 0, 0
        by_move = {int(r): i for i, r in enumerate(rows.tolist())}
        for k, row in enumerate(self.moves.line):
            tokens = tokenize(self.lines[row], row + 1)  # not kept: 5 kB a block
            own = {t.letter: t for t in tokens if t.kind == "word"}
            i = by_move.get(k)
            if i is None:
                for j, axis in enumerate(self.moves.axes):
                    held[j] = own[axis].value if axis in own else held[j]
                move += 1
                continue
            if self.moves.broken[k]:  # an axis not yet named may stand anywhere
                held = [math.nan] * len(held)
            digits = digits_at[i].tolist()
            before = list(held)
            within = extra.get(i, (np.empty((0, len(held))), np.empty((0, len(held)))))
            steps = [*zip(*within, strict=True), (places[i], dq[i])]
            texts, now = [], [before]
            for number, (place, more) in enumerate(steps, 1):
                words = {}
                for j, axis in enumerate(self.moves.axes):
                    text = format_number(float(place[j] + more[j]), digits[j])
                    kept = number == len(steps) and axis in own and (
                        abs(float(text) - own[axis].value) < 0.5 * 10.0 ** -digits[j]
                    )  # fmt: skip
                    value = own[axis].value if kept else float(text)
                    if value != held[j] or axis in own:
                        words[axis] = own[axis].number if kept else text
                    held[j] = value
                texts.append(words)
                now.append(list(held))
                nominal.extend(place)
                meant.extend(held)
                digits_of_all.extend(digits)
                at.append(move)
                move += 1
            feeds = self._inverse_feeds(machine, k, places[i - 1 : i + 1], now)
            new = self._blocks(row, tokens, own, texts, self.moves.inverse[k], feeds)
            if new != self.lines[row]:
                changed += 1
                added += len(steps) - 1
                self.lines[row] = new
        self.added = added
        self._change_feed_modes()
        if added or self.timed:
            self.lines = byte_lines(self.lines)
        width = len(self.moves.axes)
        self.nominal, self.meant, self.meant_digits = (
            np.array(v).reshape(-1, width) for v in (nominal, meant, digits_of_all)
        )
        self.on_part = np.array(self.moves.part)[rows].repeat(
            [1 + len(extra.get(i, ((), ()))[0]) for i in range(rows.size)]
        )
        self.written_at = np.array(at)
        return changed

    def _inverse_feeds(
        self, machine: MachineWords, k: int, ends: FloatArray, written: list[list[float]]
    ) -> str:
        """Return F in G93 of each part of a turn that under G94 would take another time; empty elsewhere."""
        if (
            not self.moves.feed[k]
            or self.moves.inverse[k]
            or self.moves.broken[k]
            or len(ends) < 2
        ):
            return ""
        scale = machine.scale[~machine.turns] / self.unit
        straight = float(np.linalg.norm((ends[1] - ends[0])[~machine.turns] * scale))
        turned = float(np.linalg.norm((ends[1] - ends[0])[machine.turns]))
        parts = len(written) - 1
        written_way = np.diff(np.array(written), axis=0)[:, ~machine.turns] * scale
        straight_now = float(np.linalg.norm(written_way, axis=1).sum())
        same = abs(straight_now - straight) <= _SAME_TIME * straight
        part, line = self.moves.part[k], self.moves.line[k] + 1
        if turned == 0.0 or same or (self.rotary_feed == "all" and not part):
            return ""
        what = (
            "a feed move of axes of rotation with hardly any way of linear axes"
            if straight
            else "a feed move of axes of rotation alone"
        )
        why = (
            "the correction moves linear axes as well, and the meaning of F changes: where it is the feed "
            "along the way of the linear axes the turn would be as fast as the machine can"
        )
        if self.rotary_feed is None:
            way = (
                "give rotary_feed='linear' if it is so (LinuxCNC, Sinumerik, tool-centre-point control), and "
                "the block is written in inverse time (G93); 'all' if F is along the way of all axes (Fanuc)"
            )
            raise refuse_block(line, what, why, way)
        if not self.moves.rate[k] or float(self.moves.rate[k]) <= 0.0:
            way = "state G94 and an F in units per minute before it, or write it in inverse time (G93)"
            raise refuse_block(line, what, "no F of G94 tells how long it takes", way)
        self._require_unit_of_feed(what, line)
        self.timed[self.moves.line[k]] = self.moves.rate[k]
        minutes = (straight or turned) / float(self.moves.rate[k])
        if minutes < _SHORTEST_TURN:
            raise refuse_block(
                line,
                what,
                f"F along the way of the linear axes lets the turn take {minutes * 6e4:.2g} ms, as fast as the "
                "machine can",
                "give the block a feed of its own in inverse time (G93), or move the linear axes in another one",
            )
        return format_feed(parts / minutes)

    def _require_unit_of_feed(self, what: str, line: int) -> None:
        """Refuse a time from an F whose unit G71 leaves open; name the unit that the caller stated."""
        if self.state.open_feed:
            why = "its time follows from F, and G71 leaves the unit of F to the control"
            way = "write G710, or say that F is in mm/min with unit='mm' (--path-unit mm)"
            raise refuse_block(line, what, why, way)
        if self.state.geometry_line:
            said = (
                "G71 holds for positions: F is taken to be in mm/min, as the unit that was stated"
            )
            self.state.note(said, self.state.geometry_line)

    def _change_feed_modes(self) -> None:
        """Put G93 before the blocks that are timed, and G94 with its F behind them."""
        for row, rate in self.timed.items():
            first, *others = self.lines[row].splitlines(keepends=True)
            tokens = tokenize(first, row + 1)
            if any(t.letter == "M" and t.value in (2.0, 30.0) for t in tokens):
                raise refuse_block(
                    row + 1,
                    "a feed move of axes of rotation that ends the program",
                    "G94 would stand behind the end, and the control would stay in inverse time",
                    "put M2 or M30 on a line of its own",
                )
            lower = next(t for t in tokens if t.letter in self.moves.axes).text[0].islower()
            stated = [t for t in tokens if t.letter == "G" and t.value == 94.0]
            if stated:
                first = (
                    first[: stated[0].start] + stated[0].text[0] + "93" + first[stated[0].end :]
                )
            elif row - 1 not in self.timed:
                at = next(t.start for t in tokens if t.kind == "word" and t.letter != "N")
                first = first[:at] + ("g93 " if lower else "G93 ") + first[at:]
            block = "".join([first, *others])
            if row + 1 not in self.timed:
                body = block.rstrip("\r\n")
                eol = block[len(body) :] or "\n"
                back = f"G94 F{rate}"
                block = body + eol + (back.lower() if lower else back) + block[len(body) :]
            self.lines[row] = block

    def _blocks(
        self,
        row: int,
        tokens: tuple[Token, ...],
        own: Mapping[str, Token],
        texts: list[dict[str, str]],
        inverse: bool,
        timed: str,
    ) -> str:
        """Return the blocks that replace one; `timed` is F of each part where it goes over to G93."""
        block = self.lines[row]
        lower = next(t for t in tokens if t.letter in self.moves.axes).text[0].islower()
        split = len(texts) > 1
        feed = timed or (format_feed(own["F"].value * len(texts)) if inverse and split else "")
        numbers_of = {
            letter: ("+" if number[0] not in "+-" and _has_plus(own.get(letter)) else "") + number
            for letter, number in (texts[0] | ({"F": feed} if feed else {})).items()
        }
        first = edited(tokens, numbers_of, (*self.moves.axes, *("F" if timed else "")))
        if not split:
            return first
        require_plain(tokens, row + 1, self.moves.axes)
        body = block.rstrip("\r\n")
        eol = block[len(body) :]
        blocks = [first.rstrip("\r\n")]
        for words in texts[1:]:
            text = " ".join(
                f"{a}{v}" for a, v in [*words.items(), *([("F", feed)] if feed else [])]
            )
            blocks.append(text.lower() if lower else text)
        return (eol or "\n").join(blocks) + eol

    def messages(self, tolerance: float | None) -> list[str]:
        """Return what the user should know of the program."""
        found = [f"line {line}: {text}" for text, line in self.state.messages.items()]
        if not self.state.stated_absolute:
            found.append("G90 is not stated; words are taken as absolute")
        if not self.state.stated_scale:
            found.append("the program states no unit; it is the one that was given")
        if self.timed:
            found.append(
                f"{len(self.timed)} feed moves that turn axes are written in inverse time (G93); they take as "
                "long as by F in G94"
            )
        if any(self.moves.part):
            found.append(
                "under tool-centre-point control X, Y, Z are taken as places on the part that turn with it and agree "
                "with the words of the axes where those of the axes of rotation are 0"
            )
        if self.unplaced:
            left = (
                "a move at line"
                if self.unplaced == 1
                else f"{self.unplaced} moves, the first at line"
            )
            found.append(
                f"{left} {self.first_unplaced}: not all axes were known there (before their first words, "
                "or where a tool length or a control of the tool point ended), left as written"
            )
        found.append(
            f"between poses the tool point misses its nominal way by up to "
            f"{format_length(self.chord, digits=2)}"
            + ("; give a tolerance to split the blocks there" if tolerance is None else "")
        )
        return found


def _has_plus(token: Token | None) -> bool:
    return token is not None and token.number[0] == "+"
