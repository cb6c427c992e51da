"""Private helper: the many shapes in which spindle readings come, as one table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.provenance import Step
from metrosep.core.recording import Recording
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation.resampling import AngleSynchronous, resample_by_encoder

__all__ = ["Readings", "readings_of"]


_TURN = 2.0 * math.pi
_UNEVEN = 1e-3
"""Largest relative departure of time or angle steps from their mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Channels (c, m, n) at the same angles of each revolution, without NaN."""

    table: FloatArray
    angle: FloatArray
    start: int
    rotation: int
    revolutions: NDArray[np.intp]
    noise_gain: float
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    history: tuple[Step, ...] = ()


def readings_of(
    signals: Any,
    angle: Any,
    *,
    names: Sequence[str],
    channels: Sequence[str] | str | None,
    n: int | None,
) -> Readings:
    """Return the readings of the channels that a direction needs, in the order of `names`."""
    history: tuple[Step, ...] = ()
    units: Mapping[str, str] = {}
    if isinstance(signals, Recording):
        steps = np.diff(signals.t)
        if steps.size and np.ptp(steps) > _UNEVEN * float(steps.mean()):
            raise NotUniformError(
                "the recording is not sampled uniformly in time: resample it, or give arrays at "
                "fixed angles"
            )
        history = signals.history
        units = signals.units
        signals = signals.channels
    if isinstance(signals, Mapping):
        if isinstance(angle, str):
            name = angle
            _check_unit(units, name, "rad")
            angle = _channel(signals, name)
            signals = {k: v for k, v in signals.items() if k != name}
        signals = _named(signals, names, channels, units)
    elif isinstance(angle, str):
        raise DataError("angle= names a channel only where the signals have names")
    elif channels is not None:
        raise DataError("channels= names signals of a mapping or Recording: leave it out")
    readings = _arranged(signals, angle, len(names), names, n)
    return _complete(readings, history)


def _check_unit(units: Mapping[str, str], name: str, expected: str) -> None:
    unit = units.get(name, expected)
    if unit != expected:
        raise UnitError(f"channel {name!r} is in {unit}, not in {expected}: convert it")


def _channel(signals: Mapping[str, Any], name: str) -> Any:
    if name not in signals:
        raise DataError(f"no channel {name!r} among {', '.join(signals)}")
    return signals[name]


def _named(
    signals: Mapping[str, Any],
    names: Sequence[str],
    channels: Sequence[str] | str | None,
    units: Mapping[str, str],
) -> FloatArray:
    if channels is None:
        chosen = list(names)
        if len(names) == 1 and names[0] not in signals and len(signals) == 1:
            chosen = list(signals)
    else:
        chosen = [channels] if isinstance(channels, str) else list(channels)
    if len(chosen) != len(names):
        raise DataError(f"channels= must name {len(names)} signals ({', '.join(names)})")
    missing = [c for c in chosen if c not in signals]
    if missing:
        raise DataError(
            f"no channel {', '.join(missing)} among {', '.join(signals)}: name the signals for "
            f"{', '.join(names)} with channels="
        )
    for name in chosen:
        _check_unit(units, name, "m")
    arrays = [real_numbers(signals[c], f"channel {c!r}") for c in chosen]
    if len({a.shape for a in arrays}) > 1:
        text = ", ".join(f"{c} {a.shape}" for c, a in zip(chosen, arrays, strict=True))
        raise InvalidSamplesError(f"channels must have one shape: {text}")
    return arrays[0] if len(arrays) == 1 else np.stack(arrays)


def _arranged(
    signals: Any, angle: Any, count: int, names: Sequence[str], n: int | None
) -> Readings:
    if isinstance(signals, AngleSynchronous):
        if angle is not None:
            raise DataError("resampled signals carry their angle: leave angle out")
        _no_grid(n)
        return _resampled(signals, count, names)
    values = real_numbers(signals, "the signals")
    if angle is None:
        _no_grid(n)
        return _synchronous(values, None, count, names)
    theta = np.asarray(real_numbers(angle, "the angle"), dtype=np.float64)
    if theta.ndim == values.ndim > 1 and theta.shape == values.shape and count == 1:
        values, theta = values.ravel(), theta.ravel()
    grids = 2 if count == 1 else 3
    if theta.ndim == 1 and values.ndim == grids and theta.size == values.shape[-1]:
        _no_grid(n)
        return _synchronous(values, theta, count, names)
    if values.ndim != (1 if count == 1 else 2) or (count > 1 and values.shape[0] != count):
        raise InvalidSamplesError(_shape_text(values.shape, count, names))
    return _resampled(resample_by_encoder(values, theta, n=n), count, names)


def _no_grid(n: int | None) -> None:
    if n is not None:
        raise DataError("n= resamples a record; these signals have their angles: leave it out")


def _shape_text(shape: tuple[int, ...], count: int, names: Sequence[str]) -> str:
    lead = "" if count == 1 else f"{count}, "
    return (
        f"signals of shape {shape} do not fit: need ({lead}n_samples) with angle=, or "
        f"({lead}revolutions, angles) without, for {', '.join(names)}"
    )


def _resampled(source: AngleSynchronous, count: int, names: Sequence[str]) -> Readings:
    table = source.table if source.table.ndim == 3 else source.table[None]
    if table.shape[0] != count:
        raise InvalidSamplesError(_shape_text(source.table.shape, count, names))
    return Readings(
        table=table,
        angle=source.angle,
        start=source.start,
        rotation=source.rotation,
        revolutions=source.revolutions,
        noise_gain=source.noise_gain,
        audit=source.audit,
        messages=source.messages,
    )


def _synchronous(
    values: NDArray[Any], theta: FloatArray | None, count: int, names: Sequence[str]
) -> Readings:
    if values.ndim == 1:
        raise DataError(
            "one row of samples needs angle= (rad at each sample); or give (revolutions, angles)"
        )
    if values.ndim != (2 if count == 1 else 3) or (count > 1 and values.shape[0] != count):
        raise InvalidSamplesError(_shape_text(values.shape, count, names))
    table = frozen_float(values if count > 1 else values[None], name="the signals", ndim=3)
    size = table.shape[2]
    grid = _TURN * np.arange(size) / size
    rotation = 1
    if theta is not None:
        grid = _one_turn(theta)
        rotation = 1 if grid[1] > grid[0] else -1
        if rotation < 0:
            grid, table = grid[::-1], table[..., ::-1]
    return Readings(
        table=table,
        angle=grid,
        start=0 if rotation > 0 else size - 1,
        rotation=rotation,
        revolutions=np.arange(table.shape[1]),
        noise_gain=1.0,
        audit={
            "source": "angle-synchronous",
            "n_revolutions": int(table.shape[1]),
            "n_angles": size,
            "interpolation": "none",
            "rotation": rotation,
        },
        messages=(),
    )


def _one_turn(theta: FloatArray) -> FloatArray:
    """Return a grid over one turn; refuse any other."""
    at = frozen_float(theta, name="the angle", ndim=1, min_size=2)
    step = _TURN / at.size
    found = np.diff(np.unwrap(at))
    if np.isnan(found).any() or not (
        np.abs(found - step).max() < _UNEVEN * step or np.abs(found + step).max() < _UNEVEN * step
    ):
        raise NotUniformError(
            f"the angle of {at.size} columns must be one turn in equal steps of 2 pi / {at.size} = "
            f"{step:.4g} rad, without its end twice; got {float(found[0]):.4g} first: give rad, or "
            "one row of samples with an accumulated angle"
        )
    return np.asarray(np.unwrap(at))


def _complete(readings: Readings, history: tuple[Step, ...]) -> Readings:
    """Leave out revolutions with NaN, and say so."""
    table = readings.table
    whole = ~np.isnan(table).any(axis=(0, 2))
    messages = list(readings.messages)
    dropped = readings.revolutions[~whole].tolist()
    if dropped:
        named = ", ".join(str(d) for d in dropped[:10]) + (" ..." if len(dropped) > 10 else "")
        messages = [m for m in messages if "not measured" not in m]
        messages.append(
            f"left out {len(dropped)} revolution(s) with samples that were not measured: {named}"
        )
        table = table[:, whole]
    if table.shape[1] < 2:
        raise TooFewSamplesError(
            f"{table.shape[1]} whole revolution(s): need 2 to tell what repeats, and 20 by the "
            "standard"
        )
    if table.shape[2] < 8:
        raise TooFewSamplesError(f"{table.shape[2]} angles per revolution, need 8")
    return Readings(
        table=table,
        angle=readings.angle,
        start=readings.start,
        rotation=readings.rotation,
        revolutions=readings.revolutions[whole],
        noise_gain=readings.noise_gain,
        audit={**readings.audit, "revolutions_with_nan": dropped},
        messages=tuple(messages),
        history=history,
    )
