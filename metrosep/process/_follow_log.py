"""Private: what a log of an axis holds: time, positions, error, and the place on the part."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.core.recording import Recording


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
    if sign not in ("actual-command", "command-actual"):
        raise DataError(f"error_sign={sign!r}; state 'actual-command' or 'command-actual'")
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
