"""Private helpers: sample number as a function of spindle angle, from an encoder or index pulses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, IntArray, frozen_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)

__all__ = ["EncoderMap", "IndexMap", "accumulated_angle", "faulty_revolutions"]


_TURN = 2.0 * math.pi
_SLACK = 1e-9
"""Part of a grid step by which a grid angle may lie outside the record."""

_APART = 2.0
"""Samples between pulses below which they are no sample numbers: an edge needs two."""

_NEIGHBOURS = 3
"""Revolutions on each side whose median duration a revolution is compared with."""


def accumulated_angle(angle: ArrayLike, n_samples: int) -> tuple[FloatArray, int]:
    """Return the angle without wraps and rising with time, and the sense of rotation."""
    theta = frozen_float(angle, name="the angle", ndim=1, min_size=2)
    if theta.size != n_samples:
        raise InvalidSamplesError(
            f"the angle has {theta.size} samples, the signal {n_samples}: they must be sampled "
            "together"
        )
    if np.isnan(theta).any():
        first = int(np.flatnonzero(np.isnan(theta))[0])
        raise InvalidSamplesError(
            f"the angle is NaN at sample {first}: cut the record there, or interpolate the angle"
        )
    steps = np.diff(theta)
    if (steps >= 0.0).any() and (steps <= 0.0).any() and not _one_way(steps):
        theta = _unwrapped(theta, steps)
        steps = np.diff(theta)
    rotation = 1 if theta[-1] >= theta[0] else -1
    backward = np.flatnonzero(rotation * steps < 0.0)
    if backward.size:
        i = int(backward[0])
        raise InvalidSamplesError(
            f"the spindle turns back at sample {i} (by {abs(float(steps[i])):.3g} rad, "
            f"{backward.size} such steps): cut the record to one sense of rotation, or smooth a "
            "noisy angle first"
        )
    if theta[-1] == theta[0]:
        raise TooFewSamplesError("the angle does not change: the spindle stands still")
    _refuse_degrees(theta)
    return rotation * theta, rotation


def _one_way(steps: FloatArray) -> bool:
    return bool((steps >= 0.0).all() or (steps <= 0.0).all())


def _unwrapped(theta: FloatArray, steps: FloatArray) -> FloatArray:
    span = float(np.ptp(theta))
    largest = float(np.abs(steps).max())
    for turn, unit, cure in ((360.0, "degrees", "np.deg2rad"), (1.0, "turns", "2 pi times")):
        if 0.9 * turn < largest <= span <= 1.001 * turn:
            raise UnitError(
                f"the angle jumps by {largest:.4g} and spans {span:.4g}: wrapped {unit}; give "
                f"radians ({cure} of it)"
            )
    if largest > math.pi and span > 1.001 * _TURN:
        i = int(np.argmax(np.abs(steps)))
        raise InvalidSamplesError(
            f"the angle jumps by {float(steps[i]):.4g} rad at sample {i} and spans {span:.4g} "
            "rad: neither wrapped to one turn nor accumulated"
        )
    return np.asarray(np.unwrap(theta))


def _refuse_degrees(theta: FloatArray) -> None:
    """Whole turns of 360 to a small part of a sample, by chance once in many thousand records."""
    span = abs(float(theta[-1] - theta[0]))
    step = span / (theta.size - 1)
    for whole in (span, span + step):
        turns = round(whole / 360.0)
        if turns >= 1 and abs(whole - 360.0 * turns) < 1e-3 * step:
            raise UnitError(
                f"the angle spans {whole:.6g}, exactly {turns} turns of 360: degrees; give radians "
                "(np.deg2rad of it)"
            )


def _columns(rows: FloatArray, first: int, rotation: int) -> tuple[FloatArray, int]:
    """Order columns by physical angle, given the grid number of the first column in time."""
    n = rows.shape[1]
    number = rotation * (first + np.arange(n)) % n
    ordered = np.empty_like(rows)
    ordered[:, number] = rows
    return ordered, int(number[0])


@dataclass(frozen=True, slots=True, eq=False)
class EncoderMap:
    """Sample number from an angle that rises with time.

    ``theta`` is `rotation` times the physical angle.
    """

    theta: FloatArray
    rotation: int

    @property
    def samples_per_turn(self) -> float:
        """Mean over the record."""
        return float((self.theta.size - 1) * _TURN / (self.theta[-1] - self.theta[0]))

    @property
    def messages(self) -> tuple[str, ...]:
        """Nothing to say."""
        return ()

    @property
    def audit(self) -> Mapping[str, Any]:
        """What was found."""
        turns = float(self.theta[-1] - self.theta[0]) / _TURN
        return {"turns_in_record": turns, "rotation": self.rotation}

    def positions(self, n: int) -> tuple[FloatArray, int, IntArray, FloatArray]:
        """Return sample numbers (m, n), first column, revolution numbers, samples per turn (m,)."""
        step = _TURN / n
        first = math.ceil(self.theta[0] / step - _SLACK)
        last = math.floor(self.theta[-1] / step + _SLACK)
        m = (last - first + 1) // n
        if m < 1:
            turns = float(self.theta[-1] - self.theta[0]) / _TURN
            raise TooFewSamplesError(
                f"the record holds {turns:.3g} revolutions, no whole one at {n} angles: measure "
                "longer, or check that the angle is in rad"
            )
        flat = self._sample_at(step * (first + np.arange(m * n)))
        rows = np.clip(flat, 0.0, self.theta.size - 1.0).reshape(m, n)
        begins = np.append(rows[:, 0], 2.0 * rows[-1, -1] - rows[-1, -2])
        ordered, start = _columns(rows, first, self.rotation)
        return ordered, start, np.arange(m), np.diff(begins)

    def _sample_at(self, theta: FloatArray) -> FloatArray:
        steps = np.diff(self.theta)
        mean = float(self.theta[-1] - self.theta[0]) / steps.size
        if np.abs(steps - mean).max() < 1e-6 * mean:
            at: FloatArray = (theta - self.theta[0]) / mean
            return at
        rising = np.concatenate(([True], steps > 0.0))
        number = np.flatnonzero(rising).astype(np.float64)
        if not rising.all():
            return np.interp(theta, self.theta[rising], number)
        from scipy.interpolate import CubicSpline

        spline: FloatArray = CubicSpline(self.theta, number)(theta)
        return np.asarray(np.maximum.accumulate(spline))


def faulty_revolutions(durations: FloatArray, tolerance: float) -> dict[int, str]:
    """Return the revolutions that hold a missing or a double pulse, with the reason."""
    faults: dict[int, str] = {}
    size = durations.size
    for i in range(size):
        near = durations[max(0, i - _NEIGHBOURS) : i + _NEIGHBOURS + 1]
        usual = float(np.median(near))
        ratio = float(durations[i]) / usual
        if ratio > 1.0 + tolerance:
            faults[i] = (
                f"revolution {i} lasts {ratio:.3g} times its neighbours: a pulse is missing"
            )
        elif ratio < 1.0 - tolerance and i not in faults:
            faults[i] = f"revolution {i} lasts {ratio:.3g} of its neighbours: a pulse is double"
            beside = [k for k in (i - 1, i + 1) if 0 <= k < size]
            other = min(beside, key=lambda k: abs(durations[i] + durations[k] - usual))
            total = float(durations[i] + durations[other]) / usual
            if abs(total - 1.0) <= tolerance and other not in faults:
                first, second = sorted((i, other))
                faults[first] = (
                    f"a pulse is double: revolutions {first} and {second} together last one "
                    f"revolution, index pulse {second} (counted from 0) is between them"
                )
                faults[second] = f"revolution {second} is the second part of revolution {first}"
    return dict(sorted(faults.items()))


@dataclass(frozen=True, slots=True, eq=False)
class IndexMap:
    """Sample number from index pulses; revolution i lies between pulses i and i + 1."""

    pulses: FloatArray
    good: NDArray[np.bool_]
    speed: str
    rotation: int
    messages: tuple[str, ...]

    @classmethod
    def from_pulses(
        cls,
        pulses: ArrayLike,
        n_samples: int,
        *,
        speed: str,
        rotation: int,
        faults: str,
        tolerance: float,
    ) -> IndexMap:
        """Check the pulses and say which revolutions are sound."""
        if speed not in ("constant", "linear", "spline"):
            raise DataError(f"speed is 'constant', 'linear' or 'spline', got {speed!r}")
        if faults not in ("refuse", "drop"):
            raise DataError(f"faults is 'refuse' or 'drop', got {faults!r}")
        if not 0.0 < tolerance <= 0.45:
            raise DataError(f"tolerance must lie in (0, 0.45], got {tolerance}")
        if np.size(pulses) < 2:
            raise TooFewSamplesError(
                f"{np.size(pulses)} index pulse(s): a revolution needs 2; check threshold and channel"
            )
        at = frozen_float(pulses, name="the index pulses", ndim=1)
        if np.isnan(at).any() or (np.diff(at) <= 0.0).any():
            raise InvalidSamplesError("index pulses must be finite sample numbers that rise")
        if at[0] < 0.0 or at[-1] > n_samples - 1:
            raise InvalidSamplesError(
                f"index pulses run from {at[0]:.6g} to {at[-1]:.6g}, the record from 0 to "
                f"{n_samples - 1}: give sample numbers, not times"
            )
        apart = float(np.median(np.diff(at)))
        if apart < _APART:
            raise UnitError(
                f"the index pulses are {apart:.3g} samples apart: give sample numbers, not times "
                "(times in s multiplied by the sampling rate in Hz)"
            )
        found = faulty_revolutions(np.diff(at), tolerance)
        if found and faults == "refuse":
            more = f"; {len(found)} revolutions are concerned" if len(found) > 1 else ""
            raise InvalidSamplesError(
                f"{next(iter(found.values()))}{more}; repair the index, or leave them out with "
                "faults='drop'"
            )
        good = np.ones(at.size - 1, dtype=bool)
        good[list(found)] = False
        if not good.any():
            raise TooFewSamplesError("no revolution between sound index pulses is left")
        said = tuple(f"left out: {text}" for text in found.values())
        return cls(at, good, speed, rotation, said)

    @property
    def samples_per_turn(self) -> float:
        """Median over sound revolutions."""
        return float(np.median(np.diff(self.pulses)[self.good]))

    @property
    def audit(self) -> Mapping[str, Any]:
        """What was found."""
        return {
            "speed_model": self.speed,
            "rotation": self.rotation,
            "n_pulses": int(self.pulses.size),
            "dropped_revolutions": np.flatnonzero(~self.good).tolist(),
        }

    def positions(self, n: int) -> tuple[FloatArray, int, IntArray, FloatArray]:
        """Return sample numbers (m, n), first column, revolution numbers, samples per turn (m,)."""
        share = np.arange(n) / n
        edges = np.flatnonzero(np.diff(np.concatenate(([0], self.good.astype(int), [0]))))
        rows = [
            self._segment(self.pulses[a : b + 1], share)
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
        ordered, start = _columns(np.concatenate(rows), 0, self.rotation)
        return ordered, start, np.flatnonzero(self.good), np.diff(self.pulses)[self.good]

    def _segment(self, at: FloatArray, share: FloatArray) -> FloatArray:
        durations = np.diff(at)[:, None]
        if self.speed == "spline":
            from scipy.interpolate import CubicSpline

            number = np.arange(at.size)
            spline: FloatArray = CubicSpline(number, at)(number[:-1, None] + share)
            return spline
        rows: FloatArray = at[:-1, None] + durations * share
        if self.speed == "linear" and durations.size > 1:
            bend = np.gradient(durations[:, 0])[:, None]
            rows = rows + 0.5 * bend * share * (share - 1.0)
        return rows
