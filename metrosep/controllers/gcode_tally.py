"""What is counted while a path is rewritten: changes, corrections, rates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.controllers.gcode_columns import Columns
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import LimitError

__all__ = ["Tally"]


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
