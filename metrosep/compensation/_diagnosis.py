"""Private: what is probably wrong with a table that is refused or pointless; it changes no grade.

Each likely mistake is undone on paper, to first order and on the mean of the runs, and the first one
is named whose undoing leaves less than half of the RMS, and less than half of what the table leaves:

    D' = -2 <a c'~> - <c'~^2> - c'_0^2,   q' = sqrt(max(E - D', 0) / E) < min(q / 2, 1 / 2)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from metrosep.compensation._acceptance import Judgement, Stack
from metrosep.compensation.area_errors import format_amount
from metrosep.core._arrays import FloatArray, IntArray

__all__ = ["REVERSED", "diagnosis", "half_of"]

_HALF = 0.5
_FACTORS = (
    (1000.0, "a unit: mm and um, or um and nm"),
    (25.4, "inch and mm"),
    (2.0, "diameter and radius"),
    (180.0 / math.pi, "degree and radian"),
)
_NEAR = 0.1
"""Share by which the gain may miss a factor."""

_SOME = 0.2
"""Gain above which the readings confirm a part of a table that fits in no other way."""

_SHIFTS, _FARTHEST = 200, 0.9
"""Shifts that are tried to each side, up to this share of the travel."""

_AT_ONCE = 1_000_000
"""Corrections that are looked up at a time, 8 MB."""

REVERSED = "the reversed sign would shrink it: the sign of the readings or of the table is wrong"


def half_of(rest: float, other: float) -> bool:
    """Return whether a rest is less than half of the RMS and of another rest."""
    return rest < _HALF * other and rest < _HALF


@dataclass(frozen=True, slots=True, eq=False)
class _Paper:
    """Mean run and mean correction, shape (K,), m, with what repeats and what the table adds at zero."""

    stack: Stack
    energy: float
    a: FloatArray
    c: FloatArray

    def rest(self, c: FloatArray, zero: float) -> float:
        """Return q' of another correction."""
        return float(self.rests(c[None], zero)[0])

    def rests(self, c: FloatArray, zero: float) -> FloatArray:
        """Return q' of corrections, shape (n, K)."""
        level = c - c.mean(axis=1, keepdims=True)
        left = self.energy + 2.0 * (level @ self.a) / self.a.size + (level**2).mean(axis=1)
        return np.asarray(np.sqrt(np.maximum(left + zero**2, 0.0) / self.energy))

    def ways(self) -> list[IntArray]:
        """Return the indices of each direction, positions rising."""
        x, way = self.stack.x, self.stack.way
        found = (np.flatnonzero(way == d) for d in (1.0, -1.0))
        return [i[np.argsort(x[i])] for i in found if i.size]

    def moved(self, place: FloatArray) -> FloatArray:
        """Return corrections looked up elsewhere, `place` of shape (n, K)."""
        c = np.empty(place.shape)
        for i in self.ways():
            c[:, i] = np.interp(place[:, i], self.stack.x[i], self.c[i])
        return c


def diagnosis(stack: Stack, result: Judgement, *, is_reversed: bool) -> str:
    """Return what is probably wrong with a table, one sentence."""
    if result.energy == 0.0 or not stack.applied.any():
        return ""
    paper = _Paper(stack, result.energy, stack.known.mean(axis=0), stack.applied.mean(axis=0))

    def fits(c: FloatArray, zero: float = 0.0) -> bool:
        return half_of(paper.rest(c, zero), result.rest)

    if stack.zero != 0.0 and fits(paper.c):
        return f"it would fit but for its zero, which moves the machine by {format_amount(stack.units.corrected, stack.zero)}"
    text = _factor(paper, result)
    if text:
        return text
    if is_reversed:
        return REVERSED
    ways = paper.ways()
    if len(ways) == 2 and ways[0].size == ways[1].size:
        exchanged = np.empty_like(paper.c)
        exchanged[ways[0]], exchanged[ways[1]] = paper.c[ways[1]], paper.c[ways[0]]
        if fits(exchanged):
            return "it would fit with its forward and reverse columns exchanged"
    x = stack.x
    if fits(paper.moved((x.min() + x.max() - x)[None])[0]):
        return "it would fit mirrored: its positions run the other way"
    shift = _shift(paper)
    if shift != 0.0 and fits(paper.moved((x + shift)[None])[0]):
        return f"it would fit if it were moved by {stack.units.place(-shift)}: check the origin of the positions"
    away = x - x.mean()
    has, needs = (float((v * away).mean() / (away**2).mean()) for v in (paper.c, -paper.a))
    if fits(paper.c + (needs - has) * away, 0.0):
        return (
            f"its shape fits and its slope does not: the table has {stack.units.slope(has)}, the readings "
            f"ask for {stack.units.slope(needs)}"
        )
    return _foreign(stack, result)


def _factor(paper: _Paper, result: Judgement) -> str:
    """Return by which factor of units a table is too large or too small."""
    for size, why in _FACTORS:
        for factor, word in ((size, "small"), (1.0 / size, "large")):
            near = abs(result.gain / factor - 1.0) <= _NEAR  # g times the table would fit
            if near and half_of(
                paper.rest(factor * paper.c, factor * paper.stack.zero), result.rest
            ):
                return f"it is {size:.4g} times too {word} ({why})"
    return ""


def _shift(paper: _Paper) -> float:
    """Return how far from each position the table holds what fits there, m."""
    x = paper.stack.x
    most = _FARTHEST * float(np.ptp(x))

    def best(tried: FloatArray) -> float:
        parts = np.array_split(tried, 1 + tried.size * x.size // _AT_ONCE)
        rests = [paper.rests(paper.moved(x + part[:, None]), 0.0) for part in parts]
        return float(tried[int(np.argmin(np.concatenate(rests)))])

    coarse = best(np.linspace(-most, most, 2 * _SHIFTS + 1))
    return best(coarse + np.linspace(-1.0, 1.0, 21) * most / _SHIFTS)


def _foreign(stack: Stack, result: Judgement) -> str:
    """Return what is left where no single mistake explains a table."""
    gain = result.gain
    other = (
        "it belongs to another axis, place or state, or was active while the readings were taken"
    )
    if gain > _HALF:
        return "its shape helps, its zero or a part of it does not"
    if gain > _SOME:
        return f"the readings confirm {gain:.2g} of it: {other}"
    if gain < -_SOME:
        return f"the readings run against it (gain {gain:.2g}): {other}"
    return f"neither sign shrinks it: {other}"
