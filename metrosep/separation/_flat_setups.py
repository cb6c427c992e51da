"""Set-ups of a three-flat test: which flats face each other, how they are turned and mirrored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._map_input import MapGrid
from metrosep.separation._map_orders import mirror
from metrosep.separation.map_turning import turned

FLATS = ("A", "B", "C")


@dataclass(frozen=True, slots=True)
class FlatSetup:
    """One reading: ``R(turn_first) first + R(turn_second) F second``, F the mirror.

    Parameters
    ----------
    first, second : {"A", "B", "C"}
        The second one faces the first and is seen mirrored.
    turn_first, turn_second : float, rad
        Counter-clockwise in the map.
    """

    first: str
    second: str
    turn_first: float = 0.0
    turn_second: float = 0.0

    @property
    def moved_first(self) -> bool:
        """Whether it is the first flat that was placed anew for this reading."""
        return self.turn_first != 0.0 or (self.turn_second == 0.0 and self.first == "B")


def flat_setups(
    angles: Sequence[float], pairs: Sequence[str], turned_flat: str
) -> tuple[FlatSetup, ...]:
    """Return AB, AC, BC and the turned readings."""
    basic = [FlatSetup("A", "B"), FlatSetup("A", "C"), FlatSetup("B", "C")]
    for angle, pair in zip(angles, pairs, strict=True):
        turns = (angle, 0.0) if turned_flat == "first" else (0.0, angle)
        basic.append(FlatSetup(pair[0], pair[1], *turns))
    return tuple(basic)


def order_design(setups: Sequence[FlatSetup], order: int, mirror_sign: FloatArray) -> FloatArray:
    """Return the design of one angular order (or class of orders)."""
    out = np.zeros((2 * len(setups), 6))
    for s, item in enumerate(setups):
        rows = slice(2 * s, 2 * s + 2)
        a, b = 2 * FLATS.index(item.first), 2 * FLATS.index(item.second)
        out[rows, a : a + 2] += _turn(order * item.turn_first)
        out[rows, b : b + 2] += _turn(order * item.turn_second) * mirror_sign
    return out


def facing(
    maps: FloatArray, item: FlatSetup, grid: MapGrid, flip: str
) -> tuple[FloatArray, FloatArray]:
    """Return what the first and the second flat contribute to a reading."""
    first = maps[FLATS.index(item.first)][None]
    second = mirror(maps[FLATS.index(item.second)], flip)[None]
    return (
        turned(first, item.turn_first, grid)[0][0],
        turned(second, item.turn_second, grid)[0][0],
    )


def _turn(angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
