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
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.controllers.base import sidecar_path
from metrosep.controllers.gcode.columns import (
    check_files,
    mark_text,
    open_program,
    pieces,
    require_uncorrected,
    sidecar_of,
    write_stream,
)
from metrosep.controllers.gcode.corrections import MAX_PARTS
from metrosep.controllers.gcode.machine_moves import Moves, Reader, Survey
from metrosep.controllers.gcode.machine_words import MachineWords
from metrosep.controllers.gcode.paths import named_error
from metrosep.controllers.gcode.poses import (
    STEP_ANGLE,
    Judge,
    PosesResult,
    audit_of,
    offsets_of,
    refuse_large,
    rewrite_poses,
)
from metrosep.controllers.gcode.rewrite import byte_lines, edited, format_feed, require_plain
from metrosep.controllers.gcode.state import (
    Token,
    format_number,
    refuse_block,
    scale_of_unit,
    tokenize,
)
from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import (
    DataError,
    LimitError,
    MetrosepError,
    ReadError,
    TableError,
)
from metrosep.core.units import format_length
from metrosep.machine.inverse import AT_ONCE

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors

_SHORTEST_TURN = 1e-3 / 60.0
"""In min: no control plans a block of less than a millisecond or so at the feed that it states."""
_SAME_TIME = 0.1
"""Share by which a correction may change how long a turn takes, as an override does, before F must be known."""
_FEWEST, _MOST_LOOKS = 16, 1 << 20
_AT_ONCE = 20_000
_LINES_A_POSE = 2
"""Of a part, at most: comments between the poses are no reason to hold more of a program in memory."""
_NOT_READ_BACK = "the program does not read back as meant; this is a bug in metrosep"
_BLOCK = re.compile(r"/?\s*(?:[NGMOT]\s*\d|[A-Z]\s*=)", re.IGNORECASE)


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
    offset = offsets_of(zero or {}, kinds, chain)
    if rotary_feed is not None:
        rotary_feed = numbers.choice(rotary_feed, "rotary_feed", ("linear", "all"))
    axes, codes = tuple(kinds), frozenset(int(m) for m in harmless_m)
    found: list[PosesResult] = []
    audit = audit_of(chain, errors, tool, offset)
    mark = mark_text(axes, audit)

    def reader() -> Reader:
        return Reader(axes, scale_of_unit(unit), codes, diameter)

    try:
        with open_program(start) as stream:
            survey = Survey(reader(), stream, start, again=again)
            machine = MachineWords(
                chain, errors, tool, tool_axis, max_step, axes, survey.unit, offset,
                diameter=survey.diameter, on_part=survey.on_part,
            )  # fmt: skip
            judge = Judge(chain, errors, tool, tool_axis)
            program = _Program(
                survey, machine, judge, (reader(), reader()), tolerance, resolution, limit,
                rotary_feed,
            )  # fmt: skip
            sizes: dict[str, float] = {}

            def finish() -> tuple[list[str], bool]:
                rest = program.finish()
                sizes.update(judge.sizes(program.changed, str(end)))
                return rest, bool(program.changed)

            def said(hashes: list[str]) -> Mapping[str, Any]:
                if hashes[0] != survey.hash:
                    raise ReadError(f"{start}: was changed while it was read; nothing was written")
                messages = [*chain.messages, *program.messages(), *machine.course.messages()]
                if not program.changed:
                    messages.append("no block changed: less than half of the last digit")
                sidecar = {
                    "correction": audit,
                    "sign": "the actual pose of the machine with its errors is the nominal one; c = -e",
                    "mark": mark if program.changed else None,
                    "n_blocks": survey.blocks,
                    "n_points": judge.n,
                    "n_changed": program.changed,
                    "n_added": program.added,
                    "n_inverse_time": program.timed,
                    "n_not_placed": survey.unplaced,
                    "tolerance_m": tolerance,
                    "chord_error_m": program.chord,
                    "correction_si": {a: list(v) for a, v in program.ranges.items()},
                    **sizes,
                    "messages": messages,
                }
                found.append(
                    PosesResult(
                        target=end,
                        sidecar=sidecar_path(end),
                        n_points=judge.n,
                        n_changed=program.changed,
                        before=sizes["before_rms_m"],
                        after=sizes["after_rms_m"],
                        turn_before=sizes["turn_before_rms_rad"],
                        turn_after=sizes["turn_after_rms_rad"],
                        correction=program.ranges,
                        messages=tuple(messages),
                        audit=sidecar_of("path", start, hashes, sidecar),
                    )
                )
                return found[0].audit

            stream.seek(0)
            write_stream(
                stream, start, end, program.rewritten, finish, said,
                mark=mark, semicolon=survey.comments == ";", again=again, overwrite=overwrite,
            )  # fmt: skip
    except MetrosepError as error:
        if str(error).startswith("line "):
            raise named_error(error, start) from None
        raise
    return found[0]


def _shares(size: int) -> FloatArray:
    """Return places from 0 to 1, one somewhere in each of equal intervals: in step with no wave."""
    within = np.random.default_rng(size).random(size)
    return np.asarray((np.arange(size) + within) / size)


def _rounded(places: FloatArray, digits: Any) -> FloatArray:
    """Return places as they are written."""
    unit = 10.0**digits
    return np.asarray(np.rint(places * unit) / unit)


@dataclass(frozen=True, slots=True, eq=False)
class _Poses:
    """Moves after which all axes are known, some at a time; the last one before stands first, if there is one."""

    line: NDArray[np.int64]  # from 0
    feed: NDArray[np.bool_]
    broken: NDArray[np.bool_]
    part: NDArray[np.bool_]
    places: FloatArray  # (n, axes)
    added: FloatArray  # as it is written
    digits: NDArray[np.int64]

    def after(self, before: _Poses | None) -> _Poses:
        """Return these with the last of those before in front."""
        if before is None:
            return self
        return _Poses(
            *(
                np.concatenate([getattr(before, n)[-1:], getattr(self, n)])
                for n in self.__dataclass_fields__
            )
        )


class _Program:
    """A program that is rewritten some poses at a time, and read back."""

    def __init__(
        self,
        survey: Survey,
        machine: MachineWords,
        judge: Judge,
        readers: tuple[Reader, Reader],
        tolerance: float | None,
        resolution: float,
        limit: float,
        rotary_feed: str | None,
    ) -> None:
        self.survey, self.machine, self.judge = survey, machine, judge
        self.reader, self.actual = readers
        self.tolerance, self.limit, self.rotary_feed = tolerance, limit, rotary_feed
        step = np.where(machine.turns, STEP_ANGLE, resolution) / machine.scale
        self.least = np.maximum(1, np.ceil(-np.log10(step) - 1e-9)).astype(int)
        self.changed = self.added = self.timed = 0
        self.chord = 0.0
        self.ranges: dict[str, tuple[float, float]] = {}
        self._lines: list[str] = []  # read, and not yet rewritten
        self._held = [math.nan] * len(machine.axes)  # what the machine holds, as written
        self._before: _Poses | None = None
        self._back: tuple[str, str] | None = None  # G94 that is due, and how its line ends

    def rewritten(self, lines: list[str]) -> list[str]:
        """Return the blocks of as many of the lines so far as make a part, rewritten."""
        found = []
        for block in lines:
            self._lines.append(block)
            self.reader.read(block)
            if self.reader.known == AT_ONCE or len(self._lines) == _LINES_A_POSE * AT_ONCE:
                found += self._part()
        return found

    def finish(self) -> list[str]:
        """Return the last blocks."""
        found = self._part()
        if self._back is not None:
            back, eol = self._back
            found += [back + eol] if eol else ["\n", back]
            self._read_back(found[-1:])
        return found

    def _part(self) -> list[str]:
        """Rewrite the lines that were read."""
        moves, lines, self._lines = self.reader.taken(), self._lines, []
        self.reader.known = 0
        first = self.reader.row - len(lines)
        whole = moves.places
        rows = np.flatnonzero(np.isfinite(whole).all(axis=1))
        if not rows.size:
            return self._written(first, lines, moves, rows, None, {})
        machine, places = self.machine, whole[rows]
        line, feed, broken, part = (
            np.array(getattr(moves, n))[rows] for n in ("line", "feed", "broken", "part")
        )
        dq, correction = machine.along(places, part)
        for i, (axis, amounts) in enumerate(correction.items()):
            most = None if machine.turns[i] else self.limit
            refuse_large(axis, amounts, most, line.tolist(), "")
            low, high = self.ranges.get(axis, (math.inf, -math.inf))
            self.ranges[axis] = min(low, float(amounts.min())), max(high, float(amounts.max()))
        digits = np.maximum(self.least, [list(moves.decimals[r]) for r in rows])
        added = _rounded(places + dq, digits) - places
        if self.tolerance is not None:
            self._refuse_coarse(line, places, dq, added, part, self.tolerance)
        poses = _Poses(line, feed, broken, part, places, added, digits)
        both = poses.after(self._before)
        extra = self._split(both)
        self._before = poses
        return self._written(first, lines, moves, rows, both, extra)

    def _refuse_coarse(
        self,
        line: NDArray[np.int64],
        places: FloatArray,
        dq: FloatArray,
        written: FloatArray,
        part: NDArray[np.bool_],
        tolerance: float,
    ) -> None:
        """Refuse a tolerance that the digits that are written cannot keep."""
        off = self.machine.missed(places, places + written, part)
        bad = (off > tolerance) & (self.machine.missed(places, places + dq, part) <= tolerance)
        if bad.any():
            i = int(np.argmax(np.where(bad, off, 0.0)))
            raise LimitError(
                f"line {line[i] + 1}: by the digits that are written the tool point misses its "
                f"place by {format_length(float(off[i]))}, the tolerance is {format_length(tolerance)}; give "
                "a finer resolution, or a wider tolerance"
            )

    def _split(self, poses: _Poses) -> dict[int, tuple[FloatArray, FloatArray]]:
        """Return nominal and added places within the moves that are split."""
        machine, places = self.machine, poses.places
        extra: dict[int, tuple[FloatArray, FloatArray]] = {}
        begins = np.flatnonzero(poses.feed[1:] & ~poses.broken[1:]) + 1
        if not begins.size:
            return extra
        way = places[begins] - places[begins - 1]  # of one kind of words: a change of it breaks
        looks = (np.abs(way * machine.scale) / machine.look).max(axis=1)
        if looks.max() > _MOST_LOOKS:
            line = int(poses.line[begins[int(np.argmax(looks))]]) + 1
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
                self._look(poses, begins[some], size, extra)
        turned = np.abs(way[:, machine.turns]).max(axis=1, initial=0.0)
        for i in np.flatnonzero(turned > 180.0).tolist():
            if int(begins[i]) not in extra:
                continue
            raise refuse_block(
                int(poses.line[begins[i]]) + 1,
                f"a block to be split that turns an axis by {turned[i]:.6g} deg",
                "on some controllers it takes the shortest way over its roll-over, on others it goes along "
                "its numbers",
                "write it as moves of 180 deg or less",
            )
        return extra

    def _look(
        self,
        poses: _Poses,
        ends: Any,
        size: int,
        extra: dict[int, tuple[FloatArray, FloatArray]],
    ) -> None:
        """Find the parts of moves that are looked at equally often."""
        machine, places, dq, tolerance = self.machine, poses.places, poses.added, self.tolerance
        share = _shares(size)
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
                    within.reshape(-1, within.shape[-1]), np.repeat(poses.part[open_], count - 1)
                ).reshape(within.shape)
                added[:, 1:-1] = (
                    _rounded(within + added[:, 1:-1], poses.digits[open_][:, None]) - within
                )
            part = np.minimum((share * count).astype(int), count - 1)
            rest = (share * count - part)[None, :, None]
            command = a + (b - a) * share[:, None]
            command_added = added[:, part] * (1.0 - rest) + added[:, part + 1] * rest
            flat = command.reshape(-1, command.shape[-1])
            off = machine.missed(
                flat, flat + command_added.reshape(flat.shape), np.repeat(poses.part[open_], size)
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
                    f"line {poses.line[open_[i]] + 1}: in {MAX_PARTS} parts the tool point still "
                    f"misses its way by {format_length(float(worst[i]))}, the tolerance is "
                    f"{format_length(float(tolerance or 0.0))}; the resolution is too coarse for "
                    "it, or the errors have a step or bend too fast"
                )
            open_ = open_[left]
            count *= 2
            if _FEWEST * count > size:
                size = _FEWEST * count
                share = _shares(size)

    def _written(
        self,
        first: int,
        lines: list[str],
        moves: Moves,
        rows: Any,
        poses: _Poses | None,
        extra: dict[int, tuple[FloatArray, FloatArray]],
    ) -> list[str]:
        """Put the numbers into the blocks, and return them as single lines that read back as meant."""
        axes, held = self.machine.axes, self._held
        nominal, meant, digits_of_all, at, part = (
            array("d"),
            array("d"),
            array("d"),
            array("q"),
            [],
        )
        move, timed = 0, {}  # rows that go over to G93, with F of G94
        by_move: dict[int, int] = {}
        if poses is not None:
            begin = poses.line.size - rows.size
            by_move = {int(r): i for i, r in enumerate(rows.tolist(), begin)}
        for k, line in enumerate(moves.line):
            row = line - first
            tokens = tokenize(lines[row], line + 1)  # not kept: 5 kB a block
            own = {t.letter: t for t in tokens if t.kind == "word"}
            i = by_move.get(k)
            if poses is None or i is None:
                for j, axis in enumerate(axes):
                    held[j] = own[axis].value if axis in own else held[j]
                move += 1
                continue
            if moves.broken[k]:  # an axis not yet named may stand anywhere
                held[:] = [math.nan] * len(held)
            digits = poses.digits[i].tolist()
            before = list(held)
            within = extra.get(i, (np.empty((0, len(held))), np.empty((0, len(held)))))
            steps = [*zip(*within, strict=True), (poses.places[i], poses.added[i])]
            texts, now = [], [before]
            for number, (place, more) in enumerate(steps, 1):
                words = {}
                for j, axis in enumerate(axes):
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
                part.append(moves.part[k])
                move += 1
            feeds = self._inverse_feeds(moves, k, poses.places[max(i - 1, 0) : i + 1], now)
            if feeds:
                timed[row] = moves.rate[k]
            new = self._blocks(lines[row], line, tokens, own, texts, moves.inverse[k], feeds)
            if new != lines[row]:
                self.changed += 1
                self.added += len(steps) - 1
                lines[row] = new
        found = byte_lines(self._with_feed_modes(first, lines, timed))
        self.timed += len(timed)
        actual = self._read_back(found)
        if at:
            wanted, fine = (np.array(v).reshape(-1, len(axes)) for v in (meant, digits_of_all))
            written = actual.places[np.array(at)]
            if (np.abs(written - wanted) > 0.5000001 * 10.0**-fine).any():
                raise TableError(_NOT_READ_BACK)
            on_part = np.array(part)
            self.judge.take(
                self.machine.si(np.array(nominal).reshape(-1, len(axes)), on_part),
                self.machine.si(written, on_part),
            )
        if len(actual.line) != move:
            raise TableError(_NOT_READ_BACK)
        return found

    def _read_back(self, lines: list[str]) -> Moves:
        for line in lines:
            self.actual.read(line)
        return self.actual.taken()

    def _inverse_feeds(
        self, moves: Moves, k: int, ends: FloatArray, written: list[list[float]]
    ) -> str:
        """Return F in G93 of each part of a turn that under G94 would take another time; empty elsewhere."""
        if not moves.feed[k] or moves.inverse[k] or moves.broken[k] or len(ends) < 2:
            return ""
        machine = self.machine
        scale = machine.scale[~machine.turns] / self.survey.unit
        straight = float(np.linalg.norm((ends[1] - ends[0])[~machine.turns] * scale))
        turned = float(np.linalg.norm((ends[1] - ends[0])[machine.turns]))
        parts = len(written) - 1
        written_way = np.diff(np.array(written), axis=0)[:, ~machine.turns] * scale
        straight_now = float(np.linalg.norm(written_way, axis=1).sum())
        same = abs(straight_now - straight) <= _SAME_TIME * straight
        part, line, rate = moves.part[k], moves.line[k] + 1, moves.rate[k]
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
        if not rate or float(rate) <= 0.0:
            way = "state G94 and an F in units per minute before it, or write it in inverse time (G93)"
            raise refuse_block(line, what, "no F of G94 tells how long it takes", way)
        self._require_unit_of_feed(what, line)
        minutes = (straight or turned) / float(rate)
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
        if self.survey.state.open_feed:
            why = "its time follows from F, and G71 leaves the unit of F to the control"
            way = "write G710, or say that F is in mm/min with unit='mm' (--path-unit mm)"
            raise refuse_block(line, what, why, way)
        if self.survey.state.geometry_line:
            said = (
                "G71 holds for positions: F is taken to be in mm/min, as the unit that was stated"
            )
            self.survey.state.note(said, self.survey.state.geometry_line)

    def _with_feed_modes(
        self, first: int, lines: list[str], timed: Mapping[int, str]
    ) -> Iterator[str]:
        """Put G93 before the blocks that are timed, and G94 with its F behind them."""
        for row, block in enumerate(lines):
            rate = timed.get(row)
            if rate is None:
                if self._back is not None:
                    yield "".join(self._back)
                    self._back = None
                yield block
                continue
            head, *others = block.splitlines(keepends=True)
            tokens = tokenize(head, first + row + 1)
            if any(t.letter == "M" and t.value in (2.0, 30.0) for t in tokens):
                raise refuse_block(
                    first + row + 1,
                    "a feed move of axes of rotation that ends the program",
                    "G94 would stand behind the end, and the control would stay in inverse time",
                    "put M2 or M30 on a line of its own",
                )
            lower = next(t for t in tokens if t.letter in self.machine.axes).text[0].islower()
            stated = [t for t in tokens if t.letter == "G" and t.value == 94.0]
            if stated:
                head = head[: stated[0].start] + stated[0].text[0] + "93" + head[stated[0].end :]
            elif self._back is None:
                at = next(t.start for t in tokens if t.kind == "word" and t.letter != "N")
                head = head[:at] + ("g93 " if lower else "G93 ") + head[at:]
            whole = "".join([head, *others])
            yield whole
            back = f"G94 F{rate}"
            self._back = (back.lower() if lower else back), whole[len(whole.rstrip("\r\n")) :]

    def _blocks(
        self,
        block: str,
        line: int,
        tokens: tuple[Token, ...],
        own: Mapping[str, Token],
        texts: list[dict[str, str]],
        inverse: bool,
        timed: str,
    ) -> str:
        """Return the blocks that replace one; `timed` is F of each part where it goes over to G93."""
        axes = self.machine.axes
        lower = next(t for t in tokens if t.letter in axes).text[0].islower()
        split = len(texts) > 1
        feed = timed or (format_feed(own["F"].value * len(texts)) if inverse and split else "")
        numbers_of = {
            letter: ("+" if number[0] not in "+-" and _has_plus(own.get(letter)) else "") + number
            for letter, number in (texts[0] | ({"F": feed} if feed else {})).items()
        }
        first = edited(tokens, numbers_of, (*axes, *("F" if timed else "")))
        if not split:
            return first
        require_plain(tokens, line + 1, axes)
        body = block.rstrip("\r\n")
        eol = block[len(body) :]
        blocks = [first.rstrip("\r\n")]
        for words in texts[1:]:
            text = " ".join(
                f"{a}{v}" for a, v in [*words.items(), *([("F", feed)] if feed else [])]
            )
            blocks.append(text.lower() if lower else text)
        return (eol or "\n").join(blocks) + eol

    def messages(self) -> list[str]:
        """Return what the user should know of the program."""
        found = [f"line {line}: {text}" for text, line in self.survey.state.messages.items()]
        if not self.survey.state.stated_absolute:
            found.append("G90 is not stated; words are taken as absolute")
        if not self.survey.state.stated_scale:
            found.append("the program states no unit; it is the one that was given")
        if self.timed:
            found.append(
                f"{self.timed} feed moves that turn axes are written in inverse time (G93); they take as "
                "long as by F in G94"
            )
        if self.survey.on_part:
            found.append(
                "under tool-centre-point control X, Y, Z are taken as places on the part that turn with it and agree "
                "with the words of the axes where those of the axes of rotation are 0"
            )
        if self.survey.unplaced:
            left = (
                "a move at line"
                if self.survey.unplaced == 1
                else f"{self.survey.unplaced} moves, the first at line"
            )
            found.append(
                f"{left} {self.survey.first_unplaced}: not all axes were known there (before their first words, "
                "or where a tool length or a control of the tool point ended), left as written"
            )
        found.append(
            f"between poses the tool point misses its nominal way by up to "
            f"{format_length(self.chord, digits=2)}"
            + ("; give a tolerance to split the blocks there" if self.tolerance is None else "")
        )
        return found


def _has_plus(token: Token | None) -> bool:
    return token is not None and token.number[0] == "+"
