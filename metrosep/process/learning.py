"""Iterative learning from dry runs: the next command from what the axis made of the last one.

``command += gain * Q(desired - actual)``, Q a low-pass without phase. A step is refused where the
log shows that it would make the error grow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import ComplexArray, FloatArray, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, NotConvergedError
from metrosep.core.quantity import Quantity
from metrosep.process._plain import Frozen, complete, frozen, uniform_time

_MIN_SAMPLES = 16
_ABOVE_NOISE = 10.0
"""Amplitude of the command over noise of the error, from which a frequency tells the axis."""

_ABOVE_LEAKAGE = 1e-4
"""The same over the strongest line: below it, the window's leakage."""

_PASSED = 0.05
"""Transmission of the low-pass from which a frequency is learnt at all."""

_SLOW = 0.9
_GROWTH = 1.02
"""RMS over that of the run before, from which the iteration is called divergent."""


@dataclass(frozen=True, slots=True, eq=False)
class LearningStep(Frozen):
    """The next command, and what it should leave.

    Parameters
    ----------
    t : ndarray, shape (n,), s
        Time.
    command : ndarray, shape (n,), m
        For the next run.
    change : ndarray, shape (n,), m
        What was added to the last command.
    error : ndarray, shape (n,), m
        Mean actual minus desired position of the runs.
    predicted : ndarray, shape (n,), m
        Error expected of the next run.
    rms, predicted_rms : Quantity, m
        Of both, about zero; `u` of the prediction is what does not repeat between runs.
    contraction : float
        Largest factor by which the error of a frequency changes, over what the log excites.
    audit : mapping
        Settings, frequencies and counts.
    messages : tuple of str
        In plain words.
    """

    t: FloatArray
    command: FloatArray
    change: FloatArray
    error: FloatArray
    predicted: FloatArray
    rms: Quantity
    predicted_rms: Quantity
    contraction: float
    audit: Mapping[str, Any]
    messages: tuple[str, ...]


def learn_step(
    t: ArrayLike,
    *,
    desired: ArrayLike,
    command: ArrayLike,
    actual: ArrayLike,
    cutoff: float,
    gain: float = 0.5,
    transfer: Callable[[FloatArray], ComplexArray] | None = None,
    previous: LearningStep | None = None,
) -> LearningStep:
    """Return the next command of an iterative learning control.

    Parameters
    ----------
    t : array_like, shape (n,), s
        Uniform time.
    desired : array_like, shape (n,), m
        Where the axis should be.
    command : array_like, shape (n,), m
        What was commanded in the last run; equal to `desired` in the first.
    actual : array_like, shape (n,) or (runs, n), m
        Where it was, in one or several runs of that command.
    cutoff : float, Hz
        Frequency at which the low-pass transmits half, up to the Nyquist frequency.
    gain : float, 0 < gain <= 1, optional
        Share of the error that is learnt.
    transfer : callable, optional
        Actual over command as a complex number at frequencies in Hz; from the log if omitted.
    previous : LearningStep, optional
        The step before, of which `command` is the outcome.

    Returns
    -------
    LearningStep
        Command, prediction and the check of convergence.

    Raises
    ------
    NotConvergedError
        If a frequency of the log would grow, or the error has grown since the last run.
    DataError
        If the gain is not above 0 and at most 1, or the cutoff is out of range.
    InvalidSamplesError
        If a sample is missing, the lengths differ (a command cannot have gaps), or `transfer`
        gives no number.
    NotUniformError
        If time is not uniform.
    TooFewSamplesError
        If there are fewer than 16 samples.

    Notes
    -----
    The error of the next run is ``(1 - gain Q T) e`` at each frequency, T being actual over
    command. In the first run T is read from the log, and a disturbance that repeats is in it;
    later it is the ratio of what changed since `previous`, in which that disturbance cancels. It
    is known where the command (its change) has ten times the amplitude of the noise; the
    prediction interpolates between, and the audit names the highest known frequency.
    What does not repeat is learnt too: with one run its size is not known. More runs, a lower
    gain or a lower cutoff keep it out.

    References
    ----------
    .. [1] Slow-tool-servo paper, Fig. 14 (feedforward of the follow-up error).

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(2000) * 1e-3
    >>> path = 1e-6 * np.sin(2 * np.pi * 2.0 * t)
    >>> step = learn_step(t, desired=path, command=path, actual=0.9 * path, cutoff=50.0, gain=1.0)
    >>> round(step.contraction, 2)
    0.1
    """
    times = frozen_float(t, name="t", ndim=1)
    step = uniform_time(times, _MIN_SAMPLES, "learning")
    want, last = _checked(desired, "desired", times, 1), _checked(command, "command", times, 1)
    runs = _checked(np.atleast_2d(np.asarray(actual)), "actual", times, 2)
    gain = numbers.positive(numbers.between(gain, "gain", 0.0, 1.0), "gain")
    cutoff = numbers.positive(cutoff, "cutoff", dimension="frequency")
    if cutoff > 0.5 / step * (1.0 + 1e-9):
        raise DataError(
            f"cutoff={cutoff} Hz; it must be at most half the sampling rate, {0.5 / step:.6g} Hz"
        )
    error = runs.mean(axis=0) - want
    scatter = float(runs.std(axis=0, ddof=1).mean()) if len(runs) > 1 else None
    rms = float(np.sqrt(np.mean(error**2)))
    history = [rms]
    if previous is not None:
        if previous.t.size != times.size:
            raise InvalidSamplesError(
                f"the step before has {previous.t.size} samples, this run has {times.size}"
            )
        history = [*(v * 1e-9 for v in previous.audit["rms_history_nm"]), rms]
    if len(history) > 1 and rms > _GROWTH * history[-2]:
        raise NotConvergedError(
            f"the error has grown from {history[-2]:.4g} m to {rms:.4g} m RMS since the last run; "
            "go back to the command before, lower the gain or the cutoff"
        )
    change = -gain * low_pass(error, step, cutoff)
    excited, answer = _excitation(want, last, error, previous)
    frequency, axis, known = _axis(excited, answer, step, scatter)
    if transfer is not None:
        axis, known = np.asarray(transfer(frequency), dtype=np.complex128), frequency > 0.0
        if axis.shape != frequency.shape or not np.isfinite(axis[known]).all():
            raise InvalidSamplesError("transfer must give one finite number for each frequency")
    factor = np.abs(1.0 - gain * _transmission(frequency, cutoff) * axis)
    contraction, at = _worst(factor, frequency, known, cutoff)
    messages = _messages(frequency, known, cutoff, len(runs), contraction)
    predicted = error + _through(change, step, frequency[known], axis[known])
    left = float(np.sqrt(np.mean(predicted**2)))
    u = None if scatter is None else scatter * math.sqrt(1.0 + (1.0 + gain**2) / len(runs))
    audit = {
        "gain": gain,
        "cutoff_Hz": cutoff,
        "runs": len(runs),
        "worst_frequency_Hz": None if math.isnan(at) else at,
        "highest_known_Hz": float(frequency[known].max()) if known.any() else None,
        "scatter_nm": None if scatter is None else scatter * 1e9,
        "rms_history_nm": [v * 1e9 for v in history],
    }
    now = Quantity(rms, "m", "RMS of actual minus desired, about zero", symbol="RMS")
    after = Quantity(left, "m", "RMS expected after the step, about zero", u, "RMS")
    return LearningStep(
        times, last + change, change, error, predicted, now, after, contraction, audit, messages
    )


def low_pass(values: ArrayLike, step: float, cutoff: float) -> FloatArray:
    """Return a signal after a Gaussian low-pass without phase.

    Parameters
    ----------
    values : array_like, shape (n,)
        Uniform samples.
    step : float, s
        Between two samples.
    cutoff : float, Hz
        Where half is transmitted.

    Returns
    -------
    ndarray, shape (n,)
        Filtered; a straight line passes unchanged.

    Raises
    ------
    DataError
        If step or cutoff is not positive.
    InvalidSamplesError
        If a sample is NaN.

    Notes
    -----
    Transmission ``exp(-ln 2 (f/cutoff)^2)``, that of ISO 16610-21. The ends are continued by
    reflection through their last point.
    """
    z = complete(values, "values", "a low-pass needs every sample")
    step = numbers.positive(step, "step", dimension="time")
    cutoff = numbers.positive(cutoff, "cutoff", dimension="frequency")
    return frozen(_extended(z, lambda f: _transmission(f, cutoff), step))


def _extended(
    z: FloatArray, weight: Callable[[FloatArray], FloatArray | ComplexArray], step: float
) -> FloatArray:
    """Return a signal times a weight over frequency, its ends reflected through themselves."""
    n = z.size
    if n == 1:
        return z.copy()
    line = np.linspace(z[0], z[-1], n)
    rest = z - line
    # odd about both ends: one period of 2 (n - 1) samples
    both = np.concatenate([rest, -rest[-2:0:-1]])
    lines = np.fft.rfft(both) * weight(
        np.asarray(np.fft.rfftfreq(both.size, step), dtype=np.float64)
    )
    return np.asarray(np.fft.irfft(lines, both.size)[:n] + line)


def _transmission(frequency: FloatArray, cutoff: float) -> FloatArray:
    return np.asarray(np.exp(-math.log(2.0) * (frequency / cutoff) ** 2))


def _through(
    change: FloatArray, step: float, frequency: FloatArray, axis: ComplexArray
) -> FloatArray:
    """Return what the axis makes of a change; between known frequencies it is interpolated."""
    if not frequency.size:
        return change

    def weight(f: FloatArray) -> ComplexArray:
        real = np.interp(f, frequency, axis.real)
        imaginary = np.interp(f, frequency, axis.imag)
        return np.asarray(real + 1j * np.where(f < frequency[0], 0.0, imaginary))

    return _extended(change, weight, step)


def _excitation(
    want: FloatArray, last: FloatArray, error: FloatArray, previous: LearningStep | None
) -> tuple[FloatArray, FloatArray]:
    """Return what moved the axis and what the axis made of it, disturbances left out."""
    if previous is not None:
        return last - (previous.command - previous.change), error - previous.error
    if float(np.abs(last - want).max()) <= 1e-6 * float(np.ptp(want)):
        return last, error + want
    # a command that was learnt holds the disturbance itself: actual over command tells nothing
    return np.zeros_like(last), np.zeros_like(last)


def _axis(
    command: FloatArray, actual: FloatArray, step: float, scatter: float | None
) -> tuple[FloatArray, ComplexArray, NDArray[np.bool_]]:
    """Return frequencies, actual over command, and where the log tells it (Hann window)."""
    n = command.size
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(n) + 0.5) / n)
    u = np.fft.rfft(window * (command - command.mean()))
    y = np.fft.rfft(window * (actual - actual.mean()))
    frequency = np.asarray(np.fft.rfftfreq(n, step), dtype=np.float64)
    size = np.abs(u)
    # the upper half of the band holds noise only; its median is that of a Rayleigh distribution
    rest = np.abs(y - u)[u.size // 2 :]
    floor = float(np.median(rest)) / math.sqrt(math.log(2.0))
    if scatter is not None:
        floor = max(floor, scatter * float(np.linalg.norm(window)))
    known = (size > _ABOVE_NOISE * floor) & (size > _ABOVE_LEAKAGE * float(size.max()))
    known &= size > 0.0
    known[0] = False
    axis = np.ones(u.size, dtype=np.complex128)
    axis[known] = y[known] / u[known]
    return frequency, axis, known


def _worst(
    factor: FloatArray, frequency: FloatArray, known: NDArray[np.bool_], cutoff: float
) -> tuple[float, float]:
    """Return the largest factor and its frequency; refuse a step that makes an error grow."""
    learnt = known & (_transmission(frequency, cutoff) > _PASSED)
    if not learnt.any():
        return math.nan, math.nan
    at = int(np.flatnonzero(learnt)[np.argmax(factor[learnt])])
    if factor[at] >= 1.0:
        raise NotConvergedError(
            f"the error at {frequency[at]:.4g} Hz would grow by {factor[at]:.3g} with every run; "
            "lower the gain or the cutoff, and check the sign of the axis"
        )
    return float(factor[at]), float(frequency[at])


def _messages(
    frequency: FloatArray, known: NDArray[np.bool_], cutoff: float, runs: int, contraction: float
) -> tuple[str, ...]:
    messages = []
    if math.isnan(contraction):
        messages.append(
            "the log tells nothing of the axis below the cutoff: convergence was not checked; pass "
            "the step before as previous="
        )
    elif frequency[known].max() < cutoff:
        messages.append(
            f"the log tells the axis up to {frequency[known].max():.4g} Hz only, the cutoff is "
            f"{cutoff:.4g} Hz: above, noise is learnt and convergence is not checked"
        )
    if runs == 1:
        messages.append("one run: what does not repeat is not known and is learnt as well")
    if contraction > _SLOW:
        messages.append(f"slow: the worst frequency keeps {100 * contraction:.0f} % of its error")
    return tuple(messages)


def _checked(values: ArrayLike, name: str, t: FloatArray, ndim: int) -> FloatArray:
    """Return samples, as many as times and none missing."""
    array = frozen_float(values, name=name, ndim=ndim)
    if array.shape[-1] != t.size:
        raise InvalidSamplesError(f"{name} has {array.shape[-1]} samples, time has {t.size}")
    if np.isnan(array).any():
        at = int(np.argwhere(np.isnan(array))[0][-1])
        raise InvalidSamplesError(
            f"{name} is NaN at {t[at]:.6g} s; a command cannot have gaps: repeat the dry run"
        )
    return array
