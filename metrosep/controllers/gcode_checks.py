"""How a path is rewritten, and what is refused in its numbers and between its points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.controllers.gcode_columns import Columns
from metrosep.controllers.gcode_corrections import MAX_LOOKS, MAX_PARTS
from metrosep.controllers.gcode_words import refuse_block
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError

__all__ = ["Outside", "Settings", "check_digits", "check_size", "check_turns", "check_way"]

IntArray = NDArray[np.int64]
Outside = Literal["refuse", "zero", "hold"]

_MOST_DIGITS = 12
_LARGEST = 1e9
"""Millimetres, inches or degrees: beyond it double precision has no digit for a nanometre."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How a path is rewritten; see `metrosep.controllers.gcode_paths.rewrite_path`."""

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
            f"line {columns.line_of(i)}: {letter} is {values[i]:.6g}; no machine goes there"
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
