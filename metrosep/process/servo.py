"""Servo of one axis: mass with damping and delay, PID (eq. 21) and acceleration feedforward.

A model of gains tells whether an axis is stable and by what ratio two settings differ. It never
tells how large a follow-up error is: friction, cutting force, quantisation and what a controller
does besides are not in it. Errors here are therefore relative, and lengths come from a log only
(`retuned_error`). Error is actual minus command.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import ComplexArray, FloatArray, frozen_float, same_length
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError
from metrosep.process._plain import complete, frozen, uniform_time

_WHY = "a servo model needs every sample"


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of eq. 21 and of the acceleration feedforward, in the controller's own unit of force.

    Parameters
    ----------
    kp : float, force/m, > 0
        Proportional gain.
    ki : float, force/(m s), >= 0
        Integral gain.
    kd : float, force s/m, >= 0
        Differential gain.
    feedforward : float, force s^2/m, optional
        Times the commanded acceleration; equal to the mass it is complete.

    Raises
    ------
    DataError
        If a gain is not finite, kp is not positive, or ki or kd is negative.
    """

    kp: float
    ki: float
    kd: float
    feedforward: float = 0.0

    def __post_init__(self) -> None:
        numbers.positive(self.kp, "gain kp")
        for name in ("ki", "kd"):
            numbers.not_negative(getattr(self, name), f"gain {name}")
        numbers.real(self.feedforward, "gain feedforward")


@dataclass(frozen=True, slots=True)
class ServoModel:
    """An axis ``exp(-s tau) / (M s^2 + c s)``.

    Parameters
    ----------
    mass : float, force s^2/m, > 0
        M, in the unit of force of the gains.
    damping : float, force s/m, >= 0, optional
        Viscous damping c.
    delay : float, s, >= 0, optional
        Delay tau between the controller and the force.

    Raises
    ------
    DataError
        If a value is not finite or below its limit.

    Examples
    --------
    >>> axis = ServoModel(mass=0.009)
    >>> [axis.is_stable(Gains(kp, 1e4, 1.5)) for kp in (59, 61)]
    [False, True]
    """

    mass: float
    damping: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        numbers.positive(self.mass, "mass")
        numbers.not_negative(self.damping, "damping")
        delay = numbers.not_negative(self.delay, "delay", dimension="time")
        object.__setattr__(self, "delay", delay)

    def routh_holds(self, gains: Gains) -> bool:
        """Return whether Routh's criterion holds for the axis without its delay.

        Parameters
        ----------
        gains : Gains
            To judge.

        Returns
        -------
        bool
            ``kp (kd + c) > M ki``: necessary, and sufficient where there is no delay.
        """
        return gains.kp * (gains.kd + self.damping) > self.mass * gains.ki

    def roots(self, gains: Gains, *, order: int = 6) -> ComplexArray:
        """Return the poles of the closed loop, the delay as a Pade fraction.

        Parameters
        ----------
        gains : Gains
            In the loop.
        order : int, 1 to 12, optional
            Of the fraction; without effect where there is no delay.

        Returns
        -------
        ndarray of complex, 1/s
            Rightmost first.

        Raises
        ------
        DataError
            If the order is out of range.

        Notes
        -----
        Time is scaled by the delay, so that the coefficients stay of one size. The pole at zero
        of a loop without integral part is taken off.
        """
        numbers.count(order, "order", most=12)
        scale = self.delay or self.mass / max(gains.kd + self.damping, 1e-300)
        scale = min(scale, math.sqrt(self.mass / gains.kp)) if not self.delay else scale
        above, below = _pade(order) if self.delay else (np.ones(1), np.ones(1))
        plant = np.array([self.mass / scale**2, self.damping / scale, 0.0])
        control = np.array([gains.kd / scale, gains.kp, gains.ki * scale])
        if gains.ki == 0.0:
            control = control[:2]
        else:
            plant = np.append(plant, 0.0)
        poles = np.roots(np.polyadd(np.polymul(plant, below), np.polymul(control, above)))
        poles = poles[np.argsort(-poles.real, kind="stable")] / scale
        return np.asarray(poles, dtype=np.complex128)

    def is_stable(self, gains: Gains, *, order: int = 6) -> bool:
        """Return whether all poles lie left of the imaginary axis.

        Parameters
        ----------
        gains : Gains
            In the loop.
        order : int, 1 to 12, optional
            Of the Pade fraction.

        Returns
        -------
        bool
            Stable by the roots.
        """
        return bool(self.roots(gains, order=order)[0].real < 0.0)

    def response(self, gains: Gains, frequency: ArrayLike) -> ComplexArray:
        """Return error over command at frequencies, the delay exact.

        Parameters
        ----------
        gains : Gains
            In the loop.
        frequency : array_like, shape (n,), Hz
            Not negative.

        Returns
        -------
        ndarray of complex, shape (n,)
            ``-(1 - F P)/(1 + C P)`` of actual minus command; 0 at rest.

        Raises
        ------
        InvalidSamplesError
            If a frequency is NaN or infinite.
        """
        f = frozen_float(frequency, name="frequency", ndim=1)
        s = np.asarray(2j * np.pi * f, dtype=np.complex128)
        below, above, forward = _loop(self, gains, s)
        return np.asarray(-(below - forward) / (below + above))

    def simulate(self, gains: Gains, t: ArrayLike, command: ArrayLike) -> FloatArray:
        """Return the error over time relative to the P-V of the command, from rest.

        Parameters
        ----------
        gains : Gains
            In the loop.
        t : array_like, shape (n,), s
            Uniform.
        command : array_like, shape (n,), m
            Commanded position; it rests at its first value before.

        Returns
        -------
        ndarray, shape (n,)
            (actual - command)/P-V(command), a pure number; infinite once it has diverged.

        Raises
        ------
        NotUniformError
            If time is not uniform.
        InvalidSamplesError
            If command or time is NaN, or they differ in length.
        TooFewSamplesError
            If there are fewer than 4 samples.
        DataError
            If the command does not move.

        Notes
        -----
        Force runs linearly between steps of at most a fortieth of the delay and of the fastest
        time of the loop; for such a force the motion of the mass is exact.
        """
        times, z, step = _uniform_motion(t, command)
        span = _span(z)
        fastest = float(np.abs(self.roots(gains, order=3)).max())
        limit = min(0.05 / fastest, self.delay / 40.0 if self.delay else math.inf)
        fine = max(math.ceil(step / limit), 1)
        return frozen(march(self, gains, times, (z - z[0]) / span, step, fine))


def error_ratio(
    model: ServoModel, before: Gains, after: Gains, *, t: ArrayLike, command: ArrayLike
) -> float:
    """Return by what factor the RMS error of a periodic command falls between two settings.

    Parameters
    ----------
    model : ServoModel
        The axis.
    before, after : Gains
        Both stable.
    t : array_like, shape (n,), s
        Uniform, whole periods without the repeated last sample.
    command : array_like, shape (n,), m
        Commanded position.

    Returns
    -------
    float
        RMS before over RMS after; above 1 the second setting is better. The size of either is
        not known from gains.

    Raises
    ------
    DataError
        If a setting is unstable, or as of `ServoModel.simulate`.

    Notes
    -----
    Steady state by the exact response at each harmonic. At low frequency it tends to
    ``(ki_after/ki_before)``, as the error of a PID without damping is ``-(M/ki) jerk``.
    """
    _, z, step = _uniform_motion(t, command)
    _span(z)
    power = []
    lines = np.fft.rfft(z - z.mean())
    frequency = np.fft.rfftfreq(z.size, step)
    weight = np.full(lines.size, 2.0)
    weight[0] = 0.0
    if z.size % 2 == 0:
        weight[-1] = 1.0
    for name, gains in (("before", before), ("after", after)):
        _require_stable(model, gains, name)
        power.append(float(weight @ np.abs(lines * model.response(gains, frequency)) ** 2))
    return math.sqrt(power[0] / power[1]) if power[1] > 0.0 else math.inf


@described_by(error_ratio)
def retuned_error(
    model: ServoModel,
    before: Gains,
    after: Gains,
    *,
    t: ArrayLike,
    command: ArrayLike,
    error: ArrayLike,
) -> FloatArray:
    """Return what a logged error would become with other gains.

    Parameters
    ----------
    before, after : Gains
        Gains during the log, and to try; both stable.
    t : array_like, shape (n,), s
        Uniform.
    command, error : array_like, shape (n,), m
        As logged; error = actual - command.

    Returns
    -------
    ndarray, shape (n,), m
        Predicted error. What disturbed the axis in the log is taken to disturb it again.

    Raises
    ------
    DataError
        As of `error_ratio`, or the command does not end where it began.

    Notes
    -----
    ``(1 + C' P) e' = (1 + C P) e + (F' - F) P c`` at each frequency. The log is taken as one
    period: cut it to whole revolutions. The mean of the error is kept as it is.
    """
    times, z, step = _uniform_motion(t, command)
    fe = complete(error, "error", _WHY)
    same_length(t=times, error=fe)
    jump = abs(float(z[0] - z[-1]))
    if jump > 2.0 * float(np.abs(np.diff(z)).max()):
        raise DataError(
            f"the command ends {jump:.3g} m from where it began; cut the log to whole periods"
        )
    for name, gains in (("before", before), ("after", after)):
        _require_stable(model, gains, name)
    s = np.asarray(2j * np.pi * np.fft.rfftfreq(z.size, step), dtype=np.complex128)
    below, old, forward_old = _loop(model, before, s)
    below_new, new, forward_new = _loop(model, after, s)
    factor = np.ones(s.size, dtype=np.complex128)
    command_part = np.zeros(s.size, dtype=np.complex128)
    # each loop carries a power of s of its own (with or without integral part)
    plant = np.where(s == 0.0, 1.0, below)
    plant_new = np.where(s == 0.0, 1.0, below_new)
    closed = 1.0 + new / plant_new
    factor[1:] = ((1.0 + old / plant) / closed)[1:]
    command_part[1:] = ((forward_new / plant_new - forward_old / plant) / closed)[1:]
    lines = np.fft.rfft(fe) * factor + np.fft.rfft(z) * command_part
    result = np.fft.irfft(lines, z.size)
    return frozen_float(result, name="error", ndim=1)


def _loop(
    model: ServoModel, gains: Gains, s: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return (plant's denominator, controller, feedforward) times s and the delay."""
    late = np.exp(-model.delay * s)
    plant = s * (model.mass * s**2 + model.damping * s)
    if gains.ki == 0.0:
        plant = model.mass * s**2 + model.damping * s
        control = (gains.kp + gains.kd * s) * late
        return plant, control, gains.feedforward * s**2 * late
    control = (gains.kd * s**2 + gains.kp * s + gains.ki) * late
    return plant, control, gains.feedforward * s**3 * late


def _require_stable(model: ServoModel, gains: Gains, name: str) -> None:
    worst = model.roots(gains)[0]
    if worst.real >= 0.0:
        raise DataError(
            f"the setting {name} is unstable: a pole at {worst.real:.4g} 1/s, "
            f"{abs(worst.imag) / (2 * math.pi):.4g} Hz; no error exists in a steady state"
        )


def _pade(order: int) -> tuple[FloatArray, FloatArray]:
    """Return numerator and denominator of exp(-s), highest power first."""
    k = np.arange(order + 1)
    f = math.factorial
    plus = np.array(
        [f(2 * order - j) * f(order) / (f(2 * order) * f(j) * f(order - j)) for j in k.tolist()]
    )
    return (plus * (-1.0) ** k)[::-1], plus[::-1]


def _span(z: FloatArray) -> float:
    """Return the P-V of a command that moves."""
    span = float(np.ptp(z))
    if not span > 0.0:
        raise DataError("the command does not move: no error follows from it")
    return span


def _uniform_motion(t: ArrayLike, command: ArrayLike) -> tuple[FloatArray, FloatArray, float]:
    times, z = complete(t, "t", _WHY), complete(command, "command", _WHY)
    same_length(t=times, command=z)
    return times, z, uniform_time(times, 4, "a servo model")


# ---- private: the motion of a servo over time, the delay exact ---------------------------------

_OVERFLOW = 1e12
"""A response that has grown this much has diverged; the rest is not computed."""


def march(
    model: ServoModel, gains: Gains, t: FloatArray, z: FloatArray, step: float, fine: int
) -> FloatArray:
    """Return actual minus command on the samples of the command."""
    from scipy.interpolate import CubicSpline

    h = step / fine
    spline = CubicSpline(t, z, bc_type="natural")
    times = t[0] + h * np.arange((z.size - 1) * fine + 1)
    motion = np.column_stack([np.asarray(spline(times, k)) for k in (0, 1, 2)])
    if model.delay > 0.0:
        return _march_late(model, gains, motion, h, fine)
    return _march_at_once(model, gains, motion, h, fine)


def _march_at_once(
    model: ServoModel, gains: Gains, motion: FloatArray, h: float, fine: int
) -> FloatArray:
    """Return the error without delay: state (x, v, integral), command linear between steps."""
    m, k = model.mass, gains
    state = np.array(
        [[0.0, 1.0, 0.0], [-k.kp / m, -(k.kd + model.damping) / m, k.ki / m], [-1.0, 0.0, 0.0]]
    )
    drive = np.array([[0.0, 0.0, 0.0], [k.kp / m, k.kd / m, k.feedforward / m], [1.0, 0.0, 0.0]])
    across, now, following = _first_order_hold(state, drive, h)
    pushes = motion[:-1] @ now.T + motion[1:] @ following.T
    (xx, xv, xi), (vx, vv, vi), (ix, iv, ii) = across.tolist()
    # plain numbers: three times three is too small for arrays
    x = v = w = 0.0
    path = [0.0]
    for px, pv, pw in pushes.tolist():
        x, v, w = (
            xx * x + xv * v + xi * w + px,
            vx * x + vv * v + vi * w + pv,
            ix * x + iv * v + ii * w + pw,
        )
        if abs(x) > _OVERFLOW:
            break
        path.append(x)
    error = np.full(motion.shape[0], np.inf)
    error[: len(path)] = np.array(path) - motion[: len(path), 0]
    return error[::fine].copy()


def _march_late(
    model: ServoModel, gains: Gains, motion: FloatArray, h: float, fine: int
) -> FloatArray:
    """Return the error with delay: the forces of a step lie in the past and are known."""
    state = np.array([[0.0, 1.0], [0.0, -model.damping / model.mass]])
    drive = np.array([[0.0], [1.0 / model.mass]])
    across, now, following = _first_order_hold(state, drive, h)
    (_, xv), (_, vv) = across.tolist()
    (xa,), (va,) = now.tolist()
    (xb,), (vb,) = following.tolist()
    whole = math.floor(model.delay / h * (1.0 + 1e-12))
    part = max(model.delay / h - whole, 0.0)
    forces = [0.0] * (whole + 1)  # at rest before the start; forces[i] acts at step i
    x = v = integral = before = 0.0
    error = np.full(motion.shape[0], np.inf)
    forward = gains.kd * motion[:, 1] + gains.feedforward * motion[:, 2]
    for i, (c, lead) in enumerate(zip(motion[:, 0].tolist(), forward.tolist(), strict=True)):
        e = c - x
        integral += 0.5 * h * (e + before) if i else 0.0
        before = e
        error[i] = -e
        if abs(e) > _OVERFLOW:
            break
        forces.append(gains.kp * e + gains.ki * integral - gains.kd * v + lead)
        # forces[j] was decided at step j - whole - 1
        last = i + whole + 1
        at = forces[last - whole] * (1.0 - part) + forces[last - whole - 1] * part
        then = forces[last - whole + 1] * (1.0 - part) + forces[last - whole] * part
        x, v = x + xv * v + xa * at + xb * then, vv * v + va * at + vb * then
    return error[::fine].copy()


def _first_order_hold(
    state: FloatArray, drive: FloatArray, h: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what carries state, input now and input at the end of a step to that end, exactly."""
    from scipy.linalg import expm

    n, k = drive.shape
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k] = state, drive
    block[n : n + k, n + k :] = np.eye(k) / h
    full = expm(block * h)
    following = full[:n, n + k :]
    return full[:n, :n], full[:n, n : n + k] - following, following
