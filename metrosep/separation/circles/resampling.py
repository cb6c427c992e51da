"""Angle-synchronous resampling: from samples in time to samples per revolution at fixed angles.

The angle comes from an encoder channel, or from one index pulse per revolution with the speed
interpolated between pulses. Only samples at the same angles in each revolution can be averaged
without leakage between harmonics. Between samples the signal is taken as band limited (a windowed
sinc in time), which keeps the scatter of broadband noise; a cubic spline does not.

Angle in rad, counter-clockwise seen from +Z; with `rotation` = -1 it falls with time, and the rows
of the table still run over rising angle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, IntArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.numbers import between, choice, count, not_negative, positive, real
from metrosep.separation._readings import real_numbers
from metrosep.separation.circles._circle import check_sign
from metrosep.separation.contract import StoredResult

Method = Literal["band-limited", "cubic"]
Speed = Literal["constant", "linear", "spline"]

_TURN = 2.0 * math.pi

_LEAST = 8
"""Fewest angles per revolution worth a table."""

_ON_SAMPLE = 1e-6
"""Distance from a sample, in samples, below which the sample itself is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class AngleSynchronous(StoredResult):
    """Signals at the same angles in each revolution; frozen.

    Parameters
    ----------
    table : ndarray, shape (m, n) or (c, m, n), SI
        Row i is a revolution, column j the angle ``angle[j]``; NaN = not measured.
    angle : ndarray, shape (n,), rad
        ``2 pi j / n``.
    start : int
        Column at which the revolutions begin in time (end, where the rotation is negative).
    revolutions : ndarray of int, shape (m,)
        Number of each revolution in the record, from 0; dropped ones are missing.
    speed : ndarray, shape (m,)
        Mean speed of each revolution in rev/s, or in rev/sample where no sampling rate is known.
    speed_unit : {"rev/s", "rev/sample"}
        Unit of `speed`.
    rotation : {1, -1}
        Whether the angle rises or falls with time.
    noise_gain : float
        Factor on the standard deviation of white noise by interpolation; 1 where samples are taken
        as they are, NaN for cubic splines.
    audit : mapping
        Settings and counts, plain values.
    messages : tuple of str
        What a reader must know.
    """

    table: FloatArray
    angle: FloatArray
    start: int
    revolutions: NDArray[np.intp]
    speed: FloatArray
    speed_unit: str
    rotation: int
    noise_gain: float
    audit: Mapping[str, Any]
    messages: tuple[str, ...]

    _stored: ClassVar[tuple[str, ...]] = (
        "angle", "start", "revolutions", "speed", "speed_unit", "rotation", "noise_gain", "audit",
        "messages",
    )  # fmt: skip

    @property
    def n_revolutions(self) -> int:
        """Revolutions in the table."""
        return int(self.table.shape[-2])

    def __repr__(self) -> str:
        shape = " x ".join(str(s) for s in self.table.shape)
        return f"AngleSynchronous({shape}, {float(self.speed.mean()):.6g} {self.speed_unit})"


def cubic_interpolation_error(samples_per_wave: float) -> float:
    """Return the bound of the error of a cubic spline through a sine, relative to its amplitude.

    Parameters
    ----------
    samples_per_wave : float, > 2
        Samples per wavelength of the sine.

    Returns
    -------
    float
        Largest error over amplitude.

    Raises
    ------
    DataError
        If there are 2 samples per wave or fewer: the wave is not determined.

    Notes
    -----
    5/384 h^4 max|f''''| with h = 1 sample [1]_; about 2 % at 6, 0.2 % at 10 samples per wave.

    References
    ----------
    .. [1] C. A. Hall and W. W. Meyer, Optimal error bounds for cubic spline interpolation,
       J. Approx. Theory 16 (1976) 105-122.

    Examples
    --------
    >>> round(cubic_interpolation_error(10.0), 5)
    0.00203
    """
    if not samples_per_wave > 2.0:
        raise DataError(f"a wave needs more than 2 samples, got {samples_per_wave}")
    return 5.0 / 384.0 * (_TURN / samples_per_wave) ** 4


def resample_by_encoder(
    signal: ArrayLike,
    angle: ArrayLike,
    /,
    *,
    n: int | None = None,
    method: Method = "band-limited",
    sampling_rate: float | None = None,
) -> AngleSynchronous:
    """Return a signal at fixed angles per revolution, from the angle at each sample.

    Parameters
    ----------
    signal : array_like, shape (n_samples,) or (c, n_samples), SI
        Sampled uniformly in time; several channels share the angle.
    angle : array_like, shape (n_samples,), rad
        Spindle angle, accumulated over revolutions or wrapped to one turn.
    n : int, optional
        Angles per revolution; by default the samples per revolution.
    method : {"band-limited", "cubic"}, optional
        Interpolation between samples.
    sampling_rate : float, Hz, optional
        So that `speed` is in rev/s.

    Returns
    -------
    AngleSynchronous
        All whole revolutions, counted from the first sample, whatever its angle.

    Raises
    ------
    TooFewSamplesError
        If there is not one whole revolution, or fewer than 8 samples per revolution.
    InvalidSamplesError
        If lengths differ, the signal is not real, or the angle is NaN, stands still or turns back.
    UnitError
        If the angle looks like degrees or turns.
    DataError
        If n, method or sampling rate is not usable.

    Notes
    -----
    The sample number as a function of angle is a cubic spline; an encoder that repeats counts
    is read at its edges, with straight lines between. Where samples already lie on the
    grid they are taken as they are. NaN in the signal makes all values NaN that draw on it (32
    samples on each side; `method="cubic"`: one).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(1000) * 0.1
    >>> result = resample_by_encoder(np.cos(3 * t), t, n=32)
    >>> result.table.shape, bool(np.ptp(result.table, axis=0).max() < 1e-3)
    ((15, 32), True)
    """
    signals, single = _signals(signal)
    steps = EncoderMap(*accumulated_angle(angle, signals.shape[1]))
    return _resample(signals, single, steps, n, method, sampling_rate, source="encoder")


@described_by(resample_by_encoder)
def resample_by_index(
    signal: ArrayLike,
    pulses: ArrayLike,
    /,
    *,
    n: int | None = None,
    speed: Speed = "spline",
    rotation: Literal[1, -1] = 1,
    faults: Literal["refuse", "drop"] = "refuse",
    tolerance: float = 0.3,
    method: Method = "band-limited",
    sampling_rate: float | None = None,
) -> AngleSynchronous:
    """Return a signal at fixed angles per revolution, from one index pulse per revolution.

    Parameters
    ----------
    pulses : array_like, shape (n_pulses,), sample numbers
        Where the index passed, with fractions: see `index_pulses`. The angle is 0 there.
    n : int, optional
        Angles per revolution; by default the median of the samples per revolution.
    speed : {"constant", "linear", "spline"}, optional
        Between pulses: constant speed in each revolution; time as a parabola of angle, curvature
        from the neighbours; or a cubic spline through the pulses.
    rotation : {1, -1}, optional
        -1 where the spindle turns clockwise seen from +Z.
    faults : {"refuse", "drop"}, optional
        What happens on missing or double pulses: an error that names the revolution, or the
        revolutions concerned are omitted and named in the messages.
    tolerance : float, 0 to 0.45, optional
        Relative departure of a revolution from the median of its neighbours that is a fault.

    Returns
    -------
    AngleSynchronous
        Revolutions between the first and the last pulse.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 2 pulses, no sound revolution, or fewer than 8 samples in one.
    InvalidSamplesError
        If the signal is not real, or pulses are NaN, not rising or outside the record, or
        (``faults="refuse"``) missing or double.
    UnitError
        If the pulses lie closer than samples: they are times.
    DataError
        If an option is not usable.

    Notes
    -----
    Speed changes within a revolution that repeat each revolution are invisible to one pulse: they
    shift a motion s(t) by s' times the angle error. An edge placed with standard uncertainty u_e
    in samples turns a revolution of p samples by 2 pi u_e / p rad.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(1000) * 0.1
    >>> pulses = np.arange(0, 15) * 2 * np.pi / 0.1
    >>> result = resample_by_index(np.cos(3 * t), pulses, n=32, sampling_rate=100.0)
    >>> result.table.shape, round(float(result.speed[0]), 4)
    ((14, 32), 1.5915)
    """
    signals, single = _signals(signal)
    check_sign(rotation, "rotation")
    at, good, messages = _sound_pulses(pulses, signals.shape[1], faults, tolerance)
    choice(speed, "speed", ("constant", "linear", "spline"))
    steps = IndexMap(at, good, speed, rotation, messages)
    return _resample(signals, single, steps, n, method, sampling_rate, source="index")


def _signals(signal: ArrayLike) -> tuple[FloatArray, bool]:
    values = real_numbers(signal, "the signal")
    single = values.ndim == 1
    table = frozen_float(values[None] if single else values, name="the signal", ndim=2)
    return table, single


def _resample(
    signals: FloatArray,
    single: bool,
    steps: EncoderMap | IndexMap,
    n: int | None,
    method: Method,
    sampling_rate: float | None,
    *,
    source: str,
) -> AngleSynchronous:
    choice(method, "method", ("band-limited", "cubic"))
    if sampling_rate is not None:
        sampling_rate = positive(sampling_rate, "the sampling rate", dimension="frequency")
    per_turn = steps.samples_per_turn
    if per_turn < _LEAST:
        raise TooFewSamplesError(
            f"{per_turn:.3g} samples per revolution, need {_LEAST}: sample faster, or "
            + (
                "give the angle in rad (np.deg2rad of degrees)"
                if source == "encoder"
                else "give the index pulses in sample numbers, not times"
            )
        )
    columns = count(round(per_turn) if n is None else n, "n", least=_LEAST)
    positions, start, revolutions, durations = steps.positions(columns)
    nearest = np.rint(positions)
    positions = np.where(np.abs(positions - nearest) < _ON_SAMPLE, nearest, positions)
    take = band_limited if method == "band-limited" else cubic
    flat = positions.ravel()
    table = np.stack([take(row, flat).reshape(positions.shape) for row in signals])
    on_samples = bool((positions == nearest).all())
    gain = 1.0 if on_samples else (white_gain(flat) if method == "band-limited" else math.nan)
    speed = (1.0 if sampling_rate is None else sampling_rate) / durations
    messages = [*steps.messages, *_sampling_messages(columns, per_turn)]
    lost = int(np.isnan(table).any(axis=(0, 2)).sum())
    if lost:
        messages.append(f"{lost} revolutions hold samples that were not measured: left NaN")
    table = table[0] if single else table
    angle = _TURN * np.arange(columns) / columns
    for array in (table, angle, revolutions, speed):
        array.setflags(write=False)
    return AngleSynchronous(
        table=table,
        angle=angle,
        start=start,
        revolutions=revolutions,
        speed=speed,
        speed_unit="rev/sample" if sampling_rate is None else "rev/s",
        rotation=steps.rotation,
        noise_gain=gain,
        audit={
            "source": source,
            "n_revolutions": int(positions.shape[0]),
            "n_angles": columns,
            "samples_per_revolution": per_turn,
            "interpolation": "none" if on_samples else method,
            "noise_gain": gain,
            **steps.audit,
        },
        messages=tuple(messages),
    )


def _sampling_messages(columns: int, per_turn: float) -> list[str]:
    if columns < 0.99 * per_turn:
        text = (
            f"{columns} angles of {per_turn:.6g} samples per revolution: harmonics above "
            f"{columns // 2} fold onto lower ones; take more angles or filter before"
        )
        return [text]
    return []


# ---- private helper: values between uniform samples by a windowed sinc, locally, NaN kept ------

HALF = 32
"""Samples on each side that one value draws on."""

_BETA = 8.0
"""Of the Kaiser window: errors below 2e-4 up to 0.9 of the Nyquist frequency (test)."""

_FRACTIONS = 2048
"""Steps of the tap table; between them the taps are interpolated linearly, to 3e-7."""

_BLOCK = 2048

_END = 128
"""Samples at each end of the record from which the cubic spline of the ends is made."""


@cache
def _taps() -> FloatArray:
    """Return taps for the fractions 0, 1/F, .. 1: each row sums to one."""
    fraction = np.arange(_FRACTIONS + 1)[:, None] / _FRACTIONS
    distance = fraction - np.arange(1 - HALF, HALF + 1)
    window = np.i0(_BETA * np.sqrt(np.maximum(1.0 - (distance / HALF) ** 2, 0.0)))
    taps = np.sinc(distance) * window
    taps /= taps.sum(axis=1, keepdims=True)
    taps.setflags(write=False)
    return taps


def band_limited(signal: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the signal at fractional sample numbers.

    Values whose 2 HALF neighbours hold a NaN are NaN. Within HALF of an end, where the sinc has
    no neighbours, the cubic spline of the end takes over. Positions must lie in [0, n - 1].
    """
    values = np.empty(positions.shape)
    whole = np.floor(positions)
    fraction = positions - whole
    index = whole.astype(np.intp)
    exact = fraction == 0.0
    inner = (index >= HALF - 1) & (index < signal.size - HALF) & ~exact
    values[exact] = signal[index[exact]]
    if inner.any():
        values[inner] = _inner(signal, index[inner], fraction[inner])
    ends = ~inner & ~exact
    if ends.any():
        values[ends] = _ends(signal, positions[ends])
    return values


def _inner(signal: FloatArray, index: NDArray[np.intp], fraction: FloatArray) -> FloatArray:
    table = _taps()
    windows = np.lib.stride_tricks.sliding_window_view(signal, 2 * HALF)
    values = np.empty(index.size)
    for start in range(0, index.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        place = fraction[part] * _FRACTIONS
        row = place.astype(np.intp)
        share = place - row
        near = windows[index[part] - (HALF - 1)]
        low = np.einsum("ij,ij->i", near, table[row])
        high = np.einsum("ij,ij->i", near, table[row + 1])
        values[part] = low + share * (high - low)
    return values


def _ends(signal: FloatArray, positions: FloatArray) -> FloatArray:
    values = np.empty(positions.size)
    first = positions < 0.5 * signal.size
    head = min(_END, signal.size)
    if first.any():
        values[first] = cubic(signal[:head], positions[first])
    if not first.all():
        offset = signal.size - head
        values[~first] = cubic(signal[offset:], positions[~first] - offset)
    return values


def cubic(signal: FloatArray, positions: FloatArray) -> FloatArray:
    """Return the not-a-knot cubic spline at fractional sample numbers; NaN beside a NaN."""
    from scipy.interpolate import CubicSpline

    valid = ~np.isnan(signal)
    if valid.sum() < 2:
        return np.full(positions.shape, np.nan)
    at = np.flatnonzero(valid)
    values: FloatArray = CubicSpline(at, signal[at])(positions)
    low = np.floor(positions).astype(np.intp)
    high = np.minimum(low + 1, signal.size - 1)
    values[~(valid[low] & (valid[high] | (positions == low)))] = np.nan
    return values


def white_gain(positions: FloatArray) -> float:
    """Return the factor on the standard deviation of white noise, from these positions."""
    table = _taps()
    power = np.sum(table**2, axis=1)
    place = np.rint((positions - np.floor(positions)) * _FRACTIONS).astype(np.intp)
    return float(np.sqrt(power[place].mean()))


# ---- private helpers: sample number as a function of spindle angle, from an encoder or index pulses ----

_SLACK = 1e-9
"""Part of a grid step by which a grid angle may lie outside the record."""

_APART = 2.0
"""Samples between pulses below which they cannot be sample numbers: an edge needs two."""

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
    if (steps > 0.0).any() and (steps < 0.0).any():
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

    messages: tuple[str, ...] = ()

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


def _sound_pulses(
    pulses: ArrayLike, n_samples: int, faults: str, tolerance: float
) -> tuple[FloatArray, NDArray[np.bool_], tuple[str, ...]]:
    """Return checked pulses, which revolutions between them are sound, and what was left out."""
    choice(faults, "faults", ("refuse", "drop"))
    tolerance = positive(tolerance, "tolerance")
    between(tolerance, "tolerance", 0.0, 0.45)
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
    said = tuple(f"omitted: {text}" for text in found.values())
    return at, good, said


@dataclass(frozen=True, slots=True, eq=False)
class IndexMap:
    """Sample number from index pulses; revolution i lies between pulses i and i + 1."""

    pulses: FloatArray
    good: NDArray[np.bool_]
    speed: str
    rotation: int
    messages: tuple[str, ...]

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


# ---- index pulses in an analogue or TTL channel: threshold, hysteresis, edges between samples ----

_DEFAULT_HYSTERESIS = 0.2
"""Part of the range of the channel."""


def index_pulses(
    channel: ArrayLike,
    /,
    *,
    threshold: float | None = None,
    hysteresis: float | None = None,
    edge: Literal["rising", "falling"] = "rising",
) -> FloatArray:
    """Return where a once-per-revolution channel crosses its threshold, in sample numbers.

    Parameters
    ----------
    channel : array_like, shape (n_samples,), any unit
        Voltage of the index: TTL, proximity sensor, optical mark.
    threshold : float, unit of the channel, optional
        Level of the edge; the middle of the range by default.
    hysteresis : float, unit of the channel, optional
        The channel must pass the threshold by half of it on both sides; 20 % of the range by
        default, so that noise on a slow edge counts once.
    edge : {"rising", "falling"}, optional
        Which edge marks angle 0. The two are a pulse width apart: use one throughout.

    Returns
    -------
    ndarray, shape (n_pulses,), sample numbers with fractions
        Crossing of the line through the samples on both sides of the threshold.

    Raises
    ------
    InvalidSamplesError
        If the channel is not real, holds NaN, is constant, or never crosses.
    DataError
        If an option is not usable.

    Notes
    -----
    An edge that rises within one sample is placed in the middle of it: rectangular
    distribution, standard uncertainty 0.29 samples, or 2 pi 0.29 / (samples per revolution) rad.

    Examples
    --------
    >>> index_pulses([0, 0, 5, 5, 0, 0, 0, 5, 5]).tolist()
    [1.5, 6.5]
    """
    values = frozen_float(
        real_numbers(channel, "the index channel"), name="the index channel", ndim=1, min_size=2
    )
    choice(edge, "edge", ("rising", "falling"))
    if np.isnan(values).any():
        first = int(np.flatnonzero(np.isnan(values))[0])
        raise InvalidSamplesError(f"the index channel is NaN at sample {first}")
    low, high = float(values.min()), float(values.max())
    if low == high:
        raise InvalidSamplesError(f"the index channel is {low:g} throughout: no pulse")
    level = 0.5 * (low + high) if threshold is None else real(threshold, "threshold")
    gap = _DEFAULT_HYSTERESIS * (high - low)
    if hysteresis is not None:
        gap = not_negative(hysteresis, "hysteresis")
    if not (low <= level - 0.5 * gap and level + 0.5 * gap <= high):
        raise InvalidSamplesError(
            f"the index channel runs from {low:g} to {high:g} and never crosses {level:g} with a "
            f"hysteresis of {gap:g}: set threshold="
        )
    sign = 1.0 if edge == "rising" else -1.0
    return _crossings(sign * (values - level), 0.5 * gap)


def _crossings(v: FloatArray, half: float) -> FloatArray:
    """Return upward crossings of zero that go from -half to +half."""
    state = np.where(v >= half, 1, np.where(v <= -half, -1, 0)) if half else np.where(v > 0, 1, -1)
    last = np.maximum.accumulate(np.where(state != 0, np.arange(v.size), 0))
    settled = state[last]
    tops = np.flatnonzero((settled[1:] == 1) & (settled[:-1] == -1)) + 1
    below = np.maximum.accumulate(np.where(v <= 0.0, np.arange(v.size), 0))
    before = below[tops]
    rise = v[before + 1] - v[before]
    return np.asarray(before - v[before] / rise, dtype=np.float64)
