"""Follow-up error from the log of an axis: what it is, what it depends on, where it is on the part.

Error is actual minus commanded position, positive out of the material like every error here.
Only a log says how large it is: no set of gains does (see `metrosep.process.servo`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.process._motion import (
    Derivatives,
    FollowUp,
    FollowUpMap,
    Regression,
    TermShare,
    best_delay,
    delay_uncertainty,
    derivatives,
    regress,
    shifted,
    uniform,
)

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
    delay : float, str or {"estimate"}, s, optional
        Known lag of the actual channel behind the command *in the logger*, removed first.
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
    therefore reported, but removed only where it is known. Residuals of a servo are not
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
        if "theta" in places and (warning := quick_turns(places["theta"])):
            messages.append(warning)
    ordered, got = even["command"], even["actual"]
    motion = derivatives(ordered, step, window)
    lag = _delay(ordered, got, motion, step, messages)
    taken = _taken_delay(delay, lag, step * t.size)
    if taken != 0.0:
        got = shifted(got, step, -taken)
    fe = got - ordered
    state = _state(ordered, motion)
    noise = dict(zip(("velocity", "acceleration", "jerk"), motion.sd, strict=True))
    fit, kept, valid, lost = fit_terms(fe, state, wanted, noise)
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
    audit = {
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
    return FollowUp(
        t=t,
        error=fe,
        command=ordered,
        velocity=motion.velocity,
        acceleration=motion.acceleration,
        jerk=motion.jerk,
        coefficients=_coefficients(fit, kept),
        cov=fit.cov,
        shares=found,
        r2=r2,
        residual=residual,
        delay=lag,
        quantities=_quantities(fe, fit, motion),
        map=_map(fe, t - t[0], even, spiral, (spiral_sense, spiral_start), history),
        audit=audit,
        messages=tuple(messages),
        history=history,
    )


def _nothing(level: float, least: float, taken: float) -> str:
    size = "zero throughout" if abs(level) <= least else f"{level * 1e9:.4g} nm throughout"
    if taken != 0.0:
        return f"with the delay of {taken * 1e3:.4g} ms removed the error is {size}"
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
    if isinstance(delay, str) and delay == "estimate":
        if math.isnan(lag.value):
            raise DataError("no delay can be estimated from this log; state it in s")
        return lag.value
    known = numbers.quantity(delay, "delay", "time")
    if abs(known) >= 0.5 * duration:
        raise DataError(f"delay={known} s does not fit a log of {duration:.4g} s")
    return known


def _noise_message(motion: Derivatives, kept: tuple[str, ...]) -> list[str]:
    noisy = dict(zip(("velocity", "acceleration", "jerk"), motion.sd, strict=True))
    messages = []
    for name in (n for n in kept if n in noisy):
        column, sd = getattr(motion, name), noisy[name]
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
    try:
        first, advance, turning = spiral
    except (TypeError, ValueError):
        raise DataError(
            f"spiral={spiral}; give start radius in m, feed per revolution in m and spindle speed "
            "in rad/s"
        ) from None
    radius = numbers.positive(first, "the start radius of the spiral", dimension="length")
    feed = numbers.quantity(advance, "the feed of the spiral", "length")
    speed = numbers.positive(turning, "the spindle speed of the spiral in rad/s")
    sense = numbers.choice(turn[0], "spiral_sense", _SENSES)
    start = numbers.quantity(turn[1], "spiral_start", "angle")
    angle = speed * t
    reached = radius - feed * angle / (2.0 * math.pi)
    if (reached < 0.0).any():
        at = float(t[np.argmax(reached < 0.0)])
        raise DataError(f"the spiral reaches the centre after {at:.4g} s, before the log ends")
    return FollowUpMap(reached, start + _SENSES[sense] * angle, fe, history)


# ---- private: what a log of an axis holds: time, positions, error, and the place on the part ----


def read_log(recording: Recording | Mapping[str, ArrayLike], time: str | None) -> Recording:
    """Return a recording of what was passed."""
    if isinstance(recording, Recording):
        return recording
    if not isinstance(recording, Mapping):
        raise DataError(
            f"pass a Recording or a mapping of channels, got {type(recording).__name__}"
        )
    if time is None or time not in recording:
        raise InvalidSamplesError(
            f"the log has no time (channels {', '.join(recording) or 'none'}); name its channel "
            "with time=, in s: velocity and acceleration need it"
        )
    return Recording(recording[time], {k: v for k, v in recording.items() if k != time})


def read_positions(
    log: Recording, command: str, actual: str, error: str | None, sign: str
) -> tuple[dict[str, FloatArray], str]:
    """Return commanded and actual position, and where the error comes from."""
    numbers.choice(sign, "error_sign", ("actual-command", "command-actual"))
    has = {n: n in log.channels for n in (command, actual)}
    if error is None and not all(has.values()) and "error" in log.channels:
        error = "error"
    for name in (command, actual, error):
        if name is not None and name in log.units and log.units[name] != "m":
            raise UnitError(
                f"channel {name!r} is in {log.units[name]!r}, a follow-up error needs m; convert it"
            )
    if error is None:
        return {"command": log[command], "actual": log[actual]}, f"{actual} - {command}"
    fe = log[error] if sign == "actual-command" else -log[error]
    if has[command]:
        return {"command": log[command], "actual": log[command] + fe}, f"{error} ({sign})"
    if has[actual]:
        return {"command": log[actual] - fe, "actual": log[actual]}, f"{error} ({sign})"
    raise InvalidSamplesError(
        f"the log has the error but neither {command!r} nor {actual!r}; velocity and acceleration "
        f"need a position (channels {', '.join(log.channels)})"
    )


def read_places(log: Recording, rho: str, theta: str) -> dict[str, FloatArray]:
    """Return radius and azimuth where both are in the log, in m and rad."""
    if not (rho in log.channels and theta in log.channels):
        return {}
    for name, unit in ((rho, "m"), (theta, "rad")):
        if log.units.get(name, unit) != unit:
            raise UnitError(
                f"channel {name!r} is in {log.units[name]!r}, the place on the part needs it in "
                f"{unit}; convert it"
            )
    return {"rho": log[rho], "theta": _unwrapped(log[theta])}


def _unwrapped(theta: FloatArray) -> FloatArray:
    """Return an azimuth that was given modulo one turn as one that goes on; others as they are."""
    valid = ~np.isnan(theta)
    known = theta[valid]
    if known.size < 2 or float(np.ptp(known)) > 2.0 * np.pi * (1.0 + 1e-9):
        return theta
    result = np.array(theta)
    result[valid] = np.unwrap(known)
    return result


def quick_turns(theta: FloatArray) -> str | None:
    """Return a message where an azimuth turns too far between samples to know its places."""
    steps = np.abs(np.diff(theta[~np.isnan(theta)]))
    if not steps.size or float(np.median(steps)) <= 0.5 * np.pi:
        return None
    return (
        f"the azimuth turns by {float(np.median(steps)):.3g} rad from sample to sample: where the "
        "time is resampled, places between the samples are not known; log faster"
    )


# ---- private: the terms of a follow-up regression, their shares, and what they hint at ---------

TERMS: Mapping[str, tuple[str, str]] = {
    "velocity": ("cv", "s"),
    "acceleration": ("ca", "s^2"),
    "jerk": ("cj", "s^3"),
    "position": ("cx", "1"),
    "friction": ("cf", "m"),
}
"""Term: symbol and unit of its coefficient."""

_ALIKE = 0.999
"""Correlation of two terms from which a log cannot distinguish them."""

_MOTION = 2.0
"""RMS of a term over that of its noise, below which it is not there."""

_SIGNIFICANT = 3.0
_OPPOSED = 0.05
_LARGE = 0.10
"""Share of the variance from which a term is worth a hint."""


def checked_terms(terms: Sequence[str]) -> tuple[str, ...]:
    """Return the terms in their order, refused where unknown or twice."""
    if isinstance(terms, str):
        terms = (terms,)
    for name in terms:
        numbers.choice(name, "a term", TERMS)
    if not terms or len(set(terms)) < len(terms):
        raise DataError(f"terms={list(terms)}: name at least one term, and each once")
    return tuple(terms)


def fit_terms(
    error: FloatArray,
    motion: Mapping[str, FloatArray],
    terms: tuple[str, ...],
    noise: Mapping[str, float],
) -> tuple[Regression, tuple[str, ...], NDArray[np.bool_], list[str]]:
    """Return the regression, the terms that were kept, which samples took part, and messages."""
    valid = ~np.isnan(error)
    for name in terms:
        valid &= ~np.isnan(motion[name])
    if valid.sum() < 2 * len(terms) + 6:
        raise TooFewSamplesError(
            f"a regression on {len(terms)} terms needs {2 * len(terms) + 6} samples with error and "
            f"motion, got {int(valid.sum())} of {error.size}; log for longer"
        )
    kept, messages = _told_apart({n: motion[n][valid] for n in terms}, noise)
    at = np.flatnonzero(valid)
    segments = np.cumsum(np.concatenate([[0], np.diff(at) > 1]))
    columns = [motion[n][valid] - motion[n][valid].mean() for n in kept]
    basis = np.column_stack([np.ones(at.size), *columns])
    fit = regress(basis, error[valid], segments, at=at)
    # back to c0 at zero motion
    shift = np.eye(len(kept) + 1)
    shift[0, 1:] = [-float(motion[n][valid].mean()) for n in kept]
    moved, cov = shift @ fit.coefficients, shift @ fit.cov @ shift.T
    fit = replace(fit, coefficients=moved, cov=cov)
    return fit, kept, valid, messages


def _told_apart(
    columns: dict[str, FloatArray], noise: Mapping[str, float]
) -> tuple[tuple[str, ...], list[str]]:
    """Return the terms without those that follow an earlier one, and a message for each lost."""
    kept: list[str] = []
    messages = []
    for name, column in columns.items():
        own = column - column.mean()
        size = float(np.linalg.norm(own))
        if size <= _MOTION * noise.get(name, 0.0) * math.sqrt(column.size) or size == 0.0:
            messages.append(
                f"the log holds no {name} that changes beyond its noise: its share is not known"
            )
            continue
        like = None
        for other in kept:
            rival = columns[other] - columns[other].mean()
            r = float(own @ rival) / (size * float(np.linalg.norm(rival)))
            if abs(r) > _ALIKE:
                like = (other, r)
        if like is None:
            kept.append(name)
        else:
            messages.append(
                f"{name} and {like[0]} cannot be distinguished in this motion (r = {like[1]:.4f}, one "
                f"frequency only): what {name} explains is counted as {like[0]}"
            )
    if not kept:
        raise DataError(
            "the commanded position does not move, or evenly, or by less than its own noise: there "
            "is nothing to regress on; log a motion that accelerates"
        )
    return tuple(kept), messages


def shares(
    error: FloatArray,
    motion: Mapping[str, FloatArray],
    kept: tuple[str, ...],
    fit: Regression,
    *,
    least: float = 0.0,
) -> dict[str, TermShare]:
    """Return P-V, RMS and share of each term; arrays hold the samples of the regression only.

    An error whose RMS is not above `least` does not vary: no term has a share in it.
    """
    y = error - error.mean()
    power = float(y @ y)
    varies = power > error.size * least**2
    found = {}
    for i, name in enumerate(kept, start=1):
        c, u = float(fit.coefficients[i]), math.sqrt(max(float(fit.cov[i, i]), 0.0))
        part = motion[name] - motion[name].mean()
        pv, rms = float(np.ptp(part)), float(part.std())
        found[name] = TermShare(
            name,
            Quantity(abs(c) * pv, "m", f"P-V of the {name} share of the error", u * pv, "PV"),
            Quantity(abs(c) * rms, "m", f"RMS of the {name} share of the error", u * rms, "RMS"),
            c * float(part @ y) / power if varies else 0.0,
            (abs(c) / u if u > 0.0 else math.inf if c else 0.0) if varies else 0.0,
        )
    return found


def hints(found: Mapping[str, TermShare], fit: Regression, kept: tuple[str, ...]) -> list[str]:
    """Return what the leading terms suggest, in plain words."""
    messages = []
    for name, share in sorted(found.items(), key=lambda item: -item[1].share):
        if share.significance < _SIGNIFICANT or not share.share > _LARGE:
            continue
        c = float(fit.coefficients[1 + kept.index(name)])
        cause = _CAUSES[name][0 if c < 0.0 else -1].format(ms=abs(c) * 1e3)
        messages.append(f"{cause} ({100.0 * share.share:.0f} % of the variance)")
    if any(not -_OPPOSED < share.share < 1.0 + _OPPOSED for share in found.values()):
        messages.append(
            "terms of this motion work against each other: their shares belong together, not one by "
            "one; log a motion of more frequencies"
        )
    if not messages:
        messages.append(
            "no term of the motion explains a tenth of the error: look for noise, cutting force, "
            "quantisation or vibration"
        )
    return messages


_CAUSES = {
    "velocity": (
        (
            "the error follows velocity: actual lags by {ms:.3g} ms; velocity feedforward, or a delay "
            "between the two channels of the log (the log cannot tell which)"
        ),
        (
            "the error follows velocity: actual leads by {ms:.3g} ms; velocity feedforward is too large, or "
            "there is a delay between the two channels of the log, or the channels are swapped (the log "
            "cannot tell which)"
        ),
    ),
    "acceleration": (
        "the error follows acceleration: missing acceleration feedforward",
        (
            "the error follows acceleration with actual ahead: acceleration feedforward is too large, or the "
            "channel holds commanded minus actual (or the channels are swapped) and it is missing "
            "acceleration feedforward"
        ),
    ),
    "jerk": (
        (
            "the error follows jerk: the integral part carries the acceleration (M/Ki); raise Ki or add "
            "acceleration feedforward"
        ),
    ),
    "position": ("the error follows position: scale of the encoder, or a force like a spring",),
    "friction": (
        "the error follows the sign of velocity: friction or lost motion at the reversals",
    ),
}
"""What an error that follows a term hints at, for a negative coefficient and for a positive one."""


# ---- private: peak to valley of a map whose modes are drawn, exactly, without looking at every point ----
# A draw d is ``base + xi_d @ modes``. Its largest point is sought among those that can be largest for
# some draw near d: with j the largest point at the centre c of a box of draws of half widths h, no
# draw of the box prefers a point i with ``v_i - v_j + h @ |modes_i - modes_j| < 0``, v the values at
# c. The box is halved and the points that are left are handed down. Nothing is approximated.

_FEW_DRAWS = 6
"""So many draws are looked at in full: halving on costs more."""
_FEW_POINTS = 256
_BLOCK = 1 << 20
"""Values of draws times points worked on at once."""


def drawn_pv(base: FloatArray, modes: FloatArray, xi: FloatArray) -> FloatArray:
    """Return the P-V of ``base + xi @ modes`` for each draw."""
    if not modes.shape[0]:
        return np.full(xi.shape[0], float(np.ptp(base)))
    maps = np.concatenate([base[None, :], modes])
    maps -= maps.mean(axis=1, keepdims=True)
    sizes = np.abs(maps).max(axis=1)
    used = sizes > 0.0
    factors = np.column_stack([np.ones(xi.shape[0]), xi])[:, used] * sizes[used]
    maps = maps[used] / sizes[used, None]
    length = np.sqrt(np.square(factors).sum(axis=1))
    length[length == 0.0] = 1.0
    factors /= length[:, None]  # which point is largest depends on the direction only
    high, low = np.zeros(xi.shape[0]), np.zeros(xi.shape[0])
    everything = np.arange(xi.shape[0])
    if maps.shape[0]:
        with one_blas_thread():
            _largest(maps, factors, everything, high)
            _largest(-maps, factors, everything, low)
    out: FloatArray = (high + low) * length
    return out


def _largest(
    maps: FloatArray, factors: FloatArray, draws: NDArray[np.intp], out: FloatArray
) -> None:
    """Fill in the largest point of some draws; only points that can be it are handed down."""
    if draws.size <= _FEW_DRAWS or maps.shape[1] <= _FEW_POINTS:
        rows = max(1, _BLOCK // maps.shape[1])
        for first in range(0, draws.size, rows):
            some = draws[first : first + rows]
            out[some] = (factors[some] @ maps).max(axis=1)
        return
    low, high = factors[draws].min(axis=0), factors[draws].max(axis=0)
    centre, half = 0.5 * (low + high), 0.5 * (high - low)
    bound = centre @ maps
    best = int(np.argmax(bound))
    bound -= bound[best]
    for k, width in enumerate(half.tolist()):
        bound += width * np.abs(maps[k] - maps[k, best])
    maps = maps[:, bound >= 0.0]
    order = draws[np.argsort(factors[draws, int(np.argmax(half))], kind="stable")]
    middle = order.size // 2
    _largest(maps, factors, order[:middle], out)
    _largest(maps, factors, order[middle:], out)


def square_root(cov: FloatArray) -> FloatArray:
    """Return L with ``L L^T = cov`` for a covariance that may be singular."""
    size = np.sqrt(np.diag(cov))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    kept = values > 1e-12 * max(float(values.max()), 0.0)
    out: FloatArray = (scale[:, None] * vectors[:, kept]) * np.sqrt(values[kept])
    return out
