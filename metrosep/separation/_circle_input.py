"""Readings round a circle as callers give them: arrays, profiles, a recording with its angle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.separation._inputs import curves, first_angle, require_turn
from metrosep.separation.contract import Separation

__all__ = ["CircleReadings", "circle_readings", "with_messages"]


_REPEATED = 0.01
"""Share of the power off the multiples of M below which a curve is one of M equal revolutions."""

_MOST_TURNS = 64
"""Revolutions of a recording without its angle that are looked for."""


@dataclass(frozen=True, slots=True)
class CircleReadings:
    """Readings over whole revolutions."""

    # shape (n, N) or (n, M, N): as a method takes them; not yet checked where the caller gave an
    # array
    values: Any
    start_angle: float = 0.0  # rad: angle of the first sample
    history: tuple[Step, ...] = ()  # what happened to them before
    messages: tuple[str, ...] = ()  # doubts


def circle_readings(m: Any, *, what: str, angle: ArrayLike | None = None) -> CircleReadings:
    """Return readings with the angle at which they begin."""
    if isinstance(m, Recording):
        if angle is not None:
            raise DataError(f"{what}: give the angle as a channel of the recording, not beside it")
        return _of_recording(m, what)
    if isinstance(m, Profile | Mapping):
        raise InvalidSamplesError(
            f"{what} needs several readings in a row, got one {type(m).__name__}"
        )
    if isinstance(m, Sequence) and any(isinstance(item, Profile) for item in m):
        values, positions, history = curves(m, what=what, axis="angle")
        start = first_angle(positions, angle, len(values[0]), what)
        return CircleReadings(np.stack(values), start, history)
    if angle is None:
        return CircleReadings(m)
    try:
        n = np.shape(m)[-1]
    except (ValueError, IndexError):
        raise DataError(f"{what}: angle needs readings of equal length") from None
    return CircleReadings(m, first_angle(None, angle, n, what))


def _of_recording(m: Recording, what: str) -> CircleReadings:
    """Return the channels of a recording, cut into revolutions where it holds its angle."""
    names = [k for k in m.channels if m.units.get(k) == "rad" or k.lower().startswith("angle")]
    if len(names) > 1:
        raise DataError(f"{what}: the recording has several angles: {', '.join(names)}; keep one")
    rows = [v for k, v in m.channels.items() if k not in names]
    if not rows:
        raise DataError(f"{what}: the recording holds no readings beside {names}")
    values = np.stack(rows)
    if not names:
        return CircleReadings(values, 0.0, m.history, _repeats(values, what))
    angle = m.channels[names[0]]
    if np.isnan(angle).any() or angle.size < 3:
        raise InvalidSamplesError(
            f"{what}: channel {names[0]!r} must hold an angle at each sample"
        )
    angle = np.unwrap(angle)
    turns = abs(float(angle[-1] - angle[0])) / (2.0 * np.pi) * angle.size / (angle.size - 1)
    whole = max(1, round(turns))
    if angle.size % whole:
        raise InvalidSamplesError(
            f"{what}: channel {names[0]!r} runs over {turns:.4g} revolutions, {angle.size} samples; "
            "crop to whole revolutions of equal steps, or resample by angle"
        )
    n = angle.size // whole
    for i, one in enumerate(angle.reshape(whole, n)):
        require_turn(one)
        if abs(float(one[0] - angle[0]) - 2.0 * np.pi * i) > 1e-6 * 2.0 * np.pi / n:
            raise InvalidSamplesError(
                f"{what}: revolution {i} of channel {names[0]!r} does not begin where the first "
                "does; resample by angle"
            )
    shape = (values.shape[0], n) if whole == 1 else (values.shape[0], whole, n)
    return CircleReadings(values.reshape(shape), float(angle[0]), m.history)


def _repeats(values: FloatArray, what: str) -> tuple[str, ...]:
    """Say so where a recording without its angle looks like several revolutions."""
    n = values.shape[1]
    if n < 6 or not np.isfinite(values).all():
        return ()
    power = np.sum(np.abs(np.fft.rfft(values - values.mean(axis=1, keepdims=True))) ** 2, axis=0)
    total = float(power.sum())
    for turns in range(min(_MOST_TURNS, n // 3), 1, -1):
        if n % turns == 0 and float(power[::turns].sum()) > (1.0 - _REPEATED) * total > 0.0:
            text = (
                f"{what}: the recording is taken as one revolution, but its readings repeat "
                f"{turns} times: if it holds {turns} revolutions, add the channel 'angle' in rad "
                f"or give an array ({values.shape[0]}, {turns}, {n // turns})"
            )
            return (text,)
    return ()


def with_messages(found: Separation, messages: tuple[str, ...]) -> Separation:
    """Return the result with the doubts about its readings."""
    return replace(found, messages=(*found.messages, *messages)) if messages else found
