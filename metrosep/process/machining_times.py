"""How long a spiral program takes: the spindle or the blocks of the controller, whichever is slower."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from metrosep.core import numbers
from metrosep.core.docs import described_by
from metrosep.core.quantity import Quantity

_RPM = 60.0


@dataclass(frozen=True, slots=True)
class MachiningTime:
    """Time of one pass over the spiral, and what sets it.

    Parameters
    ----------
    turns : float
        Revolutions from the rim to the centre, radius over feed.
    n_points : int
        Blocks, >= 1.
    spindle_speed : float, 1/s
        Programmed revolutions per second; 20 rpm are 20 / 60.
    block_time : float, s
        Shortest time of one block in the controller; 0 where it does not limit.

    Raises
    ------
    DataError
        If a number is not positive and finite (the block time: negative).
    """

    turns: float
    n_points: int
    spindle_speed: float
    block_time: float

    def __post_init__(self) -> None:
        kept = {
            "turns": numbers.positive(self.turns, "turns"),
            "n_points": numbers.count(self.n_points, "n_points"),
            "spindle_speed": numbers.positive(
                self.spindle_speed, "spindle_speed", dimension="frequency"
            ),
            "block_time": numbers.not_negative(self.block_time, "block_time", dimension="time"),
        }
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    @property
    def spindle_time(self) -> float:
        """Time of the revolutions at the programmed speed, s."""
        return self.turns / self.spindle_speed

    @property
    def blocks_time(self) -> float:
        """Shortest time of all blocks in the controller, s."""
        return self.n_points * self.block_time

    @property
    def seconds(self) -> float:
        """Time of the pass, s: the longer of the two."""
        return max(self.spindle_time, self.blocks_time)

    @property
    def limited_by(self) -> str:
        """The one that sets the time: "spindle" or "blocks"."""
        return "blocks" if self.blocks_time > self.spindle_time else "spindle"

    @property
    def reached_speed(self) -> float:
        """Mean revolutions per second that the blocks allow, at most the programmed ones."""
        return self.turns / self.seconds

    @property
    def free_points(self) -> int | None:
        """Blocks that fit into the time of the spindle; None where blocks take no time."""
        if self.block_time == 0.0:
            return None
        count = self.spindle_time / self.block_time
        return math.floor(count * (1.0 + 1e-12))

    @property
    def messages(self) -> tuple[str, ...]:
        """What to know, in plain words."""
        if self.limited_by == "spindle":
            return ()
        message = (
            f"The controller cannot feed the blocks: {self.spindle_speed * _RPM:.6g} rpm fall to "
            f"{self.reached_speed * _RPM:.6g} rpm. {self.free_points} blocks would keep the speed."
        )
        return (message,)

    @property
    def audit(self) -> Mapping[str, Any]:
        """What the time rests on, plain values with units in the keys."""
        return {
            "turns": self.turns,
            "n_points": self.n_points,
            "spindle_rpm": self.spindle_speed * _RPM,
            "block_time_ms": self.block_time * 1e3,
            "time_min": self.seconds / 60.0,
            "limited_by": self.limited_by,
            "reached_rpm": self.reached_speed * _RPM,
        }

    def quantity(self) -> Quantity:
        """Return the time with unit and definition.

        Returns
        -------
        Quantity
            In s; its uncertainty is not known.
        """
        return Quantity(
            self.seconds,
            "s",
            f"time of one pass, {self.turns:.6g} turns and {self.n_points} blocks, limited by "
            f"the {self.limited_by}; ramps and retracts not counted",
            symbol="T",
        )


@described_by(MachiningTime)
def machining_time(
    n_points: int, turns: float, *, spindle_speed: float, block_time: float = 0.0
) -> MachiningTime:
    """Return the time of one pass over a spiral.

    Returns
    -------
    MachiningTime
        ``T = max(turns / spindle_speed, n_points block_time)``.

    Notes
    -----
    The paper gives times without a model: 45,000 blocks of constant angle at 20 rpm take 12.5 min,
    which is 16.7 ms a block, and 31,910 blocks more then cost 8.9 min ("about 10 min" there). Only
    a limit per block makes points cost time: the revolutions are the same.

    Examples
    --------
    >>> round(machining_time(45_000, 250.0, spindle_speed=20 / 60).seconds / 60, 6)
    12.5
    """
    return MachiningTime(turns, n_points, spindle_speed, block_time)
