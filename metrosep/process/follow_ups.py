"""Follow-up error from the log of an axis: what it is, what it depends on, where it is on the part.

Error is actual minus commanded position, positive out of the material like every error here.
Only a log says how large it is: no set of gains does (see `metrosep.process.servo`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.process._follow_log import quick_turns, read_log, read_places, read_positions
from metrosep.process._follow_result import FollowUp, FollowUpMap, TermShare
from metrosep.process._follow_terms import TERMS, checked_terms, fit_terms, hints, shares
from metrosep.process._motion import (
    Derivatives,
    best_delay,
    delay_uncertainty,
    derivatives,
    shifted,
    uniform,
)
from metrosep.process._regression import Regression

__all__ = ["FollowUp", "FollowUpMap", "TermShare", "follow_up"]


_MIN_SAMPLES = 16

_ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Of the largest position: an error that varies by less does not vary."""

_SENSES = {"counterclockwise": 1.0, "clockwise": -1.0}


def follow_up(
    recording: Recording | Mapping[str, ArrayLike],
    *,
    command: str = "command",
    actual: str = "actual",
    error: str | None = None,
    error_sign: str = "actual-command",
    time: str | None = None,
    terms: Sequence[str] = ("velocity", "acceleration", "jerk"),
    delay: float | str = 0.0,
    window: int | None = None,
    rho: str = "rho",
    theta: str = "theta",
    spiral: tuple[float, float, float] | None = None,
    spiral_sense: str = "counterclockwise",
    spiral_start: float = 0.0,
) -> FollowUp:
    """Return the follow-up error of a logged axis and what it depends on.

    Parameters
    ----------
    recording : Recording or mapping of str to array_like
        Log with positions in m. A mapping needs `time`.
    command, actual : str, optional
        Channels of commanded and actual position. With `error` one of them is enough.
    error : str, optional
        Channel of the error; ``"error"`` is taken if `command` or `actual` is missing.
    error_sign : {"actual-command", "command-actual"}, optional
        What that channel holds. Controllers often log commanded minus actual.
    time : str, optional
        Channel of time in s, for a mapping.
    terms : sequence of str, optional
        Of ``velocity acceleration jerk position friction`` (sign of velocity).
    delay : float or {"estimate"}, s, optional
        Known lag of the actual channel behind the command *in the logger*, taken out first.
        ``"estimate"`` takes out the best one: nothing is then left for velocity.
    window : int, odd, >= 7, optional
        Samples of the local polynomials; chosen from the noise of the command if omitted.
    rho, theta : str, optional
        Channels of radius in m and azimuth in rad; used where both exist. An azimuth that stays
        within one turn is taken as given modulo a turn.
    spiral : tuple of (float, float, float), m, m/rev, rad/s, optional
        Start radius, feed per revolution towards the centre and spindle speed; time 0 is the
        first sample. A negative feed runs outwards.
    spiral_sense : {"counterclockwise", "clockwise"}, optional
        Way in which the tool goes round the part, seen from outside (from +z). On a lathe the part
        turns, and the tool goes round it the other way.
    spiral_start : float, rad, optional
        Azimuth of the first sample.

    Returns
    -------
    FollowUp
        Error, motion, coefficients with uncertainty, shares, map, hints.

    Raises
    ------
    TooFewSamplesError
        If there are fewer than 16 samples, or too few with error and motion.
    InvalidSamplesError
        If time is missing, not strictly increasing, or a channel is missing.
    NotUniformError
        If resampling would need more than twenty times the samples of the log.
    UnitError
        If a channel states a unit other than m, or an azimuth one other than rad.
    DataError
        If an option is not one of its choices, or the axis does not move.
    DegenerateFitError
        If the motion cannot tell the terms apart, or the delay leaves no overlap.

    Notes
    -----
    ``fe = c0 + cv v + ca a + cj j``, motion of the command by local polynomials of degree 5.
    Time that jitters by more than 0.1 % of a step is resampled by a cubic spline; gaps stay NaN.
    A delay d of the actual channel and cv = -d are the same thing to first order. The delay is
    therefore reported, but taken out only where it is known. Residuals of a servo are not
    independent: the covariance comes from autoregressive models of the residual and of its means
    over 4, 16 and 64 samples, the largest variance counts, never below that of independent
    samples; ``bandwidth_samples`` in the audit is the sum of the autocorrelation. Samples that are
    NaN, and half a window beside them and at the ends, take no part; their number is in the audit.

    References
    ----------
    .. [1] Slow-tool-servo paper, Fig. 13 (error beside acceleration), eq. 21 (PID).
    .. [2] Burg, Proc. 37th Meeting SEG (1967); Akaike, IEEE Trans. AC 19 (1974) 716.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(4000) * 1e-3
    >>> z = 50e-9 * (np.sin(13.0 * t) + 0.3 * np.sin(39.0 * t))
    >>> log = Recording(t, {"command": z, "actual": z - 2e-3 * np.gradient(z, t)})
    >>> result = follow_up(log)
    >>> round(result.cv * 1e3, 3), round(result.delay.value * 1e3, 2)
    (-2.0, 2.0)
    """
    wanted = checked_terms(terms)
    log = read_log(recording, time)
    if len(log) < _MIN_SAMPLES:
        raise TooFewSamplesError(
            f"a follow-up error needs at least {_MIN_SAMPLES} samples, the log has {len(log)}"
        )
    columns, source = read_positions(log, command, actual, error, error_sign)
    places = read_places(log, rho, theta)
    t, even, step, jitter = uniform(log.t, {**columns, **places})
    messages = []
    if t is not log.t:
        messages.append(f"time jitters by {100.0 * jitter:.2g} % of a step: resampled by a spline")
        if "theta" in places and (doubt := quick_turns(places["theta"])):
            messages.append(doubt)
    ordered, got = even["command"], even["actual"]
    motion = derivatives(ordered, step, window)
    lag = _delay(ordered, got, motion, step, messages)
    taken = _taken_delay(delay, lag, step * t.size)
    if taken != 0.0:
        got = shifted(got, step, -taken)
    fe = got - ordered
    state = _state(ordered, motion)
    fit, kept, valid, lost = fit_terms(fe, state, wanted, _noise(motion))
    least = _ROUNDING * float(max(np.nanmax(np.abs(c)) for c in (ordered, got)))
    found = shares(fe[valid], {n: state[n][valid] for n in kept}, kept, fit, least=least)
    y = fe[valid] - fe[valid].mean()
    power = float(y @ y)
    if power > y.size * least**2:
        messages += lost + hints(found, fit, kept) + _noise_message(motion, kept)
        r2 = 1.0 - float(fit.residual @ fit.residual) / power
    else:
        messages += [*lost, _nothing(float(fe[valid].mean()), least, taken)]
        r2 = 0.0
    residual = np.full(fe.size, np.nan)
    residual[valid] = fit.residual
    history = (*log.history, Step("follow_up", {"terms": list(kept), "delay_s": taken}))
    return FollowUp(
        t=_locked(t),
        error=_locked(fe),
        command=_locked(ordered),
        velocity=_locked(motion.velocity),
        acceleration=_locked(motion.acceleration),
        jerk=_locked(motion.jerk),
        coefficients=freeze_mapping(_coefficients(fit, kept)),
        cov=_locked(fit.cov, 2),
        shares=freeze_mapping(found),
        r2=r2,
        residual=_locked(residual),
        delay=lag,
        quantities=freeze_mapping(_quantities(fe, fit, motion)),
        map=_map(fe, t - t[0], even, spiral, (spiral_sense, spiral_start), history),
        audit=freeze_mapping(
            {
                "error_from": source,
                "step_s": step,
                "jitter": jitter,
                "resampled": t is not log.t,
                "window_samples": motion.window,
                "delay_removed_s": taken,
                "samples": int(t.size),
                "samples_in_regression": int(valid.sum()),
                "samples_not_measured": int(np.isnan(fe).sum()),
                "terms": kept,
                "bandwidth_samples": fit.bandwidth,
                "u_over_u_of_independent": fit.inflation,
            }
        ),
        messages=tuple(messages),
        history=history,
    )


def _nothing(level: float, least: float, taken: float) -> str:
    size = "zero throughout" if abs(level) <= least else f"{level * 1e9:.4g} nm throughout"
    if taken != 0.0:
        return f"with the delay of {taken * 1e3:.4g} ms taken out the error is {size}"
    return (
        f"the error is {size}: nothing to explain, all shares are 0; is the actual channel that of "
        "the encoder, not a copy of the command?"
    )


def _state(command: FloatArray, motion: Derivatives) -> dict[str, FloatArray]:
    v = motion.velocity
    # nothing is said about the direction of a velocity that is only noise
    sign = np.where(np.abs(v) > 3.0 * motion.sd[0], np.sign(v), 0.0)
    return {
        "velocity": v,
        "acceleration": motion.acceleration,
        "jerk": motion.jerk,
        "position": command,
        "friction": np.where(np.isnan(v), np.nan, sign),
    }


def _noise(motion: Derivatives) -> dict[str, float]:
    return dict(zip(("velocity", "acceleration", "jerk"), motion.sd, strict=True))


def _delay(
    command: FloatArray, actual: FloatArray, motion: Derivatives, step: float, messages: list[str]
) -> Quantity:
    from metrosep.core.errors import MetrosepError

    what = "by how much actual lags the command, from the log itself"
    try:
        lag, _ = best_delay(command, actual, motion.velocity, step)
        u = delay_uncertainty(command, actual, motion.velocity, step, lag)
    except MetrosepError as exc:
        messages.append(f"no delay was estimated: {exc}")
        return Quantity(math.nan, "s", what)
    return Quantity(lag, "s", what, u, "delay")


def _taken_delay(delay: float | str, lag: Quantity, duration: float) -> float:
    if isinstance(delay, str):
        if delay != "estimate":
            raise DataError(f"delay={delay!r}; state it in s, or 'estimate'")
        if math.isnan(lag.value):
            raise DataError("no delay can be estimated from this log; state it in s")
        return lag.value
    if not math.isfinite(delay) or abs(delay) >= 0.5 * duration:
        raise DataError(f"delay={delay} s does not fit a log of {duration:.4g} s")
    return float(delay)


def _noise_message(motion: Derivatives, kept: tuple[str, ...]) -> list[str]:
    columns = {
        "velocity": (motion.velocity, motion.sd[0]),
        "acceleration": (motion.acceleration, motion.sd[1]),
        "jerk": (motion.jerk, motion.sd[2]),
    }
    messages = []
    for name in kept:
        if name not in columns:
            continue
        column, sd = columns[name]
        share = sd**2 / max(float(np.nanvar(column)), 1e-300)
        if share > 0.01:
            messages.append(
                f"{100.0 * share:.2g} % of the variance of {name} is noise of the command: its "
                "coefficient reads too small by about that; log the command with more digits"
            )
    return messages


def _coefficients(fit: Regression, kept: tuple[str, ...]) -> dict[str, Quantity]:
    u = np.sqrt(np.maximum(np.diag(fit.cov), 0.0))
    found = {"c0": Quantity(float(fit.coefficients[0]), "m", "error at rest", float(u[0]), "c0")}
    for i, name in enumerate(kept, start=1):
        symbol, unit = TERMS[name]
        found[symbol] = Quantity(
            float(fit.coefficients[i]), unit, f"error over {name}", float(u[i]), symbol
        )
    return found


def _quantities(fe: FloatArray, fit: Regression, motion: Derivatives) -> dict[str, Quantity]:
    valid = fe[~np.isnan(fe)]
    low, high = np.percentile(valid, [2.5, 97.5])
    of = "of the follow-up error, whole log, nothing removed or filtered"
    return {
        "PV": Quantity(float(np.ptp(valid)), "m", f"peak-to-valley {of}", symbol="PV"),
        "PV95": Quantity(float(high - low), "m", f"2.5 % to 97.5 % {of}", symbol="PV95"),
        "RMS": Quantity(float(valid.std()), "m", "root mean square about the mean", symbol="RMS"),
        "residual": Quantity(float(fit.residual.std()), "m", "RMS left by the regression"),
        "noise": Quantity(motion.noise, "m", "noise of the commanded position"),
    }


def _map(
    fe: FloatArray,
    t: FloatArray,
    even: Mapping[str, FloatArray],
    spiral: tuple[float, float, float] | None,
    turn: tuple[str, float],
    history: tuple[Step, ...],
) -> FollowUpMap | None:
    if spiral is None:
        if "rho" not in even:
            return None
        return FollowUpMap(even["rho"], even["theta"], fe, history)
    radius, feed, speed = (float(v) for v in spiral)
    if not (
        radius > 0.0 and math.isfinite(feed) and speed > 0.0 and math.isfinite(radius + speed)
    ):
        raise DataError(
            f"spiral={spiral}; give start radius in m, feed per revolution in m and spindle speed "
            "in rad/s"
        )
    sense, start = turn
    if sense not in _SENSES or not math.isfinite(start):
        raise DataError(
            f"spiral_sense={sense!r}, spiral_start={start}; the sense is 'counterclockwise' or "
            "'clockwise', the start an azimuth in rad"
        )
    angle = speed * t
    reached = radius - feed * angle / (2.0 * math.pi)
    if (reached < 0.0).any():
        at = float(t[np.argmax(reached < 0.0)])
        raise DataError(f"the spiral reaches the centre after {at:.4g} s, before the log ends")
    return FollowUpMap(reached, start + _SENSES[sense] * angle, fe, history)


def _locked(values: FloatArray, ndim: int = 1) -> FloatArray:
    return frozen_float(values, name="result", ndim=ndim)
