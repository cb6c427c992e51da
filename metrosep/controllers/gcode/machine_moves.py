"""Moves of a program in words of all axes: read block by block, and what holds for the whole of it."""

from __future__ import annotations

import hashlib
import math
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from metrosep.controllers.gcode.columns import comments_of, pieces, require_unmarked
from metrosep.controllers.gcode.state import (
    MM,
    ModalState,
    Token,
    decimals_of,
    refuse_block,
    tokenize,
)
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, ReadError, UnitError


@dataclass(slots=True)
class Moves:
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


class Reader:
    """A program read block by block; its moves are those since somebody took them."""

    def __init__(
        self,
        axes: tuple[str, ...],
        scale: float | None,
        codes: frozenset[int],
        diameter: bool | None,
    ) -> None:
        self.state = ModalState(
            scale=scale, diameter=diameter, stated_diameter=diameter is not None, harmless_m=codes,
            g_system="mill", axes="".join(axes), spindle_axis="", part=False,
        )  # fmt: skip
        self.moves = Moves(axes)
        self.row, self.known = 0, 0  # lines, and moves after which all axes are known, so far
        self._held = dict.fromkeys(axes, math.nan)
        self._broken, self._rate, self._mode = True, "", ""

    def taken(self) -> Moves:
        """Return the moves, and begin anew."""
        found, self.moves = self.moves, Moves(self.moves.axes)
        return found

    def read(self, block: str) -> None:
        """Read the next block."""
        self.row += 1
        line = self.row
        if self.state.ended:
            self.state.refuse_behind(block, line)
            return
        tokens = tokenize(block, line)
        moves = self.state.apply(tokens, line)
        if self.state.feed_mode != self._mode:
            self._rate, self._mode = "", self.state.feed_mode
        if self._mode == "G94":
            self._rate = next((t.number for t in tokens if t.letter == "F"), self._rate)
        held = self._held
        if self.state.lost:
            held |= dict.fromkeys((a for a in held if a in self.state.lost), math.nan)
            self.state.lost, self._broken = "", True
        if not moves:
            return
        if self.state.dropped:
            held |= dict.fromkeys(held, math.nan)
            self._broken = True
            if self.state.motion == 1:
                why = "G49 or D0 took the length of the tool away, so where the tool stands is not known"
                way = "keep G43.4, G43 or the edge to the end of the path"
                raise refuse_block(line, "a feed move", why, way)
        words: dict[str, Token] = {}
        for token in tokens:
            if token.kind == "word" and (token.letter in held or token.letter == "F"):
                if token.letter in words:
                    why = "the letter is there twice in one block"
                    raise refuse_block(line, token.text, why, "write it once")
                words[token.letter] = token
        if self.state.motion == 1 and self.state.feed_mode == "G93" and "F" not in words:
            why = "in inverse time (G93) every feed move needs an F word"
            raise refuse_block(line, "a feed move", why, "add F")
        if not self.state.dropped:
            held |= {a: t.value for a, t in words.items() if a in held}
        place = [held[a] for a in self.moves.axes]
        known = all(v == v for v in place)
        if self.state.motion == 1 and not known:
            missing = next(a for a, v in held.items() if v != v)
            raise refuse_block(
                line,
                "a feed move",
                f"no {missing} word was given so far, or none since the last home move, tool change "
                "or change of tool-centre-point control, so the position is not known",
                f"begin with a rapid move to a stated {missing}",
            )
        self.moves.line.append(line - 1)
        self.moves.feed.append(self.state.motion == 1)
        self.moves.inverse.append(self.state.feed_mode == "G93")
        self.moves.place.extend(place)
        self.moves.broken.append(self._broken)
        self.moves.part.append(bool(self.state.part))
        self.moves.rate.append(self._rate)
        self.moves.decimals.append(
            bytes(min(decimals_of(words[a].number), 99) if a in words else 0 for a in held)
        )
        self._broken = not known
        self.known += known


class Survey:
    """What holds for a whole program: units, what is known, how its comments begin."""

    def __init__(self, reader: Reader, stream: Any, path: Path, *, again: bool) -> None:
        if not stream.seekable():
            raise ReadError(f"{path}: is read twice, so it must be a file; store it in one")
        digest = hashlib.sha256()
        moves, axes = 0, reader.moves.axes
        self.unplaced = self.first_unplaced = 0
        self.on_part, self.comments = False, ""
        for lines in pieces(stream, path):
            digest.update("".join(lines).encode("latin-1"))
            if not again:
                require_unmarked(lines, path)
            if self.comments != "(":
                self.comments = comments_of("".join(lines)) or self.comments
            for block in lines:
                reader.read(block)
            some = reader.taken()
            unknown = np.flatnonzero(~np.isfinite(some.places).all(axis=1))
            if unknown.size and not self.unplaced:
                self.first_unplaced = some.line[unknown[0]] + 1
            self.unplaced += unknown.size
            moves += len(some.line)
            self.on_part |= any(some.part)
        self.state, self.blocks, self.hash = reader.state, reader.row, digest.hexdigest()
        self.unit = self.state.unit if moves else MM
        if self.state.diameter is None and "Y" not in axes and "X" in axes:
            raise UnitError(
                "whether X words are diameters is not stated; give diameter=True or diameter=False, or put G7 "
                "or G8 into the program"
            )
        self.diameter = bool(self.state.diameter)
        if not reader.known:
            raise DataError(
                f"the program holds no move (G0 or G1) after which {', '.join(axes)} are all "
                "known; the correction of a machine depends on every axis"
            )
