"""Which gains are stable: a sweep judged by roots and by simulation, and the limits of one gain.

A sweep shows where an axis diverges and by what ratio settings differ; it gives no length.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import frozen_float
from metrosep.core.errors import DataError
from metrosep.core.provenance import freeze_mapping
from metrosep.process.servo import Gains, ServoModel, error_ratio

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["GainSweep", "stability_limits", "sweep_gains"]


_GAINS = ("kp", "ki", "kd", "feedforward")
_MOST = 20_000
_MARGINAL = 0.5
"""Rightmost pole times the time that is simulated, below which growth is too slow to be seen."""

_SIMULATED = 400
"""Times of the fastest pole that a simulation lasts at least."""


@dataclass(frozen=True, slots=True)
class GainSweep:
    """What each setting of a sweep does.

    Parameters
    ----------
    rows : tuple of mapping
        ``kp ki kd feedforward``, ``stable`` (roots), ``routh``, ``decay_per_s`` (minus the real
        part of the rightmost pole), ``damping_ratio`` (least of all poles), ``simulation``
        ("stable", "diverges", "marginal" or "not run") and ``improvement`` (RMS error of the
        reference over that of this setting; NaN if unstable or without a command).
    best : Gains or None
        Stable setting of the largest improvement, else of the fastest decay.
    reference : Gains or None
        What the improvement is counted from.
    audit : mapping
        Settings and counts.
    messages : tuple of str
        In plain words.
    """

    rows: tuple[Mapping[str, Any], ...]
    best: Gains | None
    reference: Gains | None
    audit: Mapping[str, Any]
    messages: tuple[str, ...]

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether each setting is stable by its roots, shape (n,)."""
        return np.array([row["stable"] for row in self.rows], dtype=np.bool_)

    def to_frame(self) -> pd.DataFrame:
        """Return the rows as a table.

        Returns
        -------
        pandas.DataFrame
            One row per setting.
        """
        import pandas as pd

        return pd.DataFrame([dict(row) for row in self.rows])


def sweep_gains(
    model: ServoModel,
    *,
    kp: ArrayLike,
    ki: ArrayLike,
    kd: ArrayLike,
    feedforward: ArrayLike = 0.0,
    t: ArrayLike | None = None,
    command: ArrayLike | None = None,
    reference: Gains | None = None,
    simulate: bool = True,
    order: int = 6,
) -> GainSweep:
    """Return stability and relative error of every combination of gains.

    Parameters
    ----------
    model : ServoModel
        The axis.
    kp, ki, kd, feedforward : array_like, scalar or shape (n,)
        Gains to combine, units as in `Gains`.
    t, command : array_like, shape (n,), s and m, optional
        Whole periods of a commanded motion, for the improvement.
    reference : Gains, optional
        What the improvement is counted from; the first stable setting if omitted.
    simulate : bool, optional
        Whether each setting is simulated as well.
    order : int, 1 to 12, optional
        Of the Pade fraction of the delay.

    Returns
    -------
    GainSweep
        One row per setting.

    Raises
    ------
    DataError
        If a gain is out of range, there are more than 20000 settings, only one of `t` and
        `command` is given, or the reference is unstable.
    InvalidSamplesError
        If a gain is not a real number, or `t` or `command` holds NaN.
    NotUniformError
        If time is not uniform.
    TooFewSamplesError
        If there are fewer than 4 samples.

    Notes
    -----
    The simulation answers a smooth step for 400 times of the fastest pole and compares the swing
    of its last third with that of the middle one. Where the rightmost pole is too slow for that
    to show, it says "marginal". The lower bounds of Ki and Kd in the paper are bounds of the
    error, not of stability.

    Examples
    --------
    >>> sweep = sweep_gains(ServoModel(0.009), kp=[59, 61], ki=1e4, kd=1.5)
    >>> sweep.stable.tolist()
    [False, True]
    """
    if (t is None) != (command is None):
        raise DataError("give t and command together: an improvement needs a motion")
    axes = [_values(v, n) for v, n in zip((kp, ki, kd, feedforward), _GAINS, strict=True)]
    count = math.prod(len(a) for a in axes)
    if count > _MOST:
        raise DataError(f"{count} settings are more than {_MOST}; sweep fewer gains at a time")
    settings = [Gains(*values) for values in itertools.product(*axes)]
    rows = [_row(model, gains, simulate, order) for gains in settings]
    stable = [g for g, row in zip(settings, rows, strict=True) if row["stable"]]
    if reference is None and stable:
        reference = stable[0]
    if t is not None and command is not None and reference is not None:
        for gains, row in zip(settings, rows, strict=True):
            if row["stable"]:
                row["improvement"] = error_ratio(model, reference, gains, t=t, command=command)
    best = _best(settings, rows)
    return GainSweep(
        tuple(freeze_mapping(row) for row in rows),
        best,
        reference,
        freeze_mapping(
            {
                "settings": count,
                "stable": len(stable),
                "pade_order": order,
                "delay_ms": model.delay * 1e3,
                "mass": model.mass,
                "damping": model.damping,
            }
        ),
        _messages(rows, best),
    )


def stability_limits(
    model: ServoModel, gains: Gains, vary: str, *, low: float, high: float, order: int = 8
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of one gain in which the loop is stable.

    Parameters
    ----------
    model : ServoModel
        The axis.
    gains : Gains
        The other gains.
    vary : {"kp", "ki", "kd"}
        Gain to vary.
    low, high : float
        Range to search, ``0 <= low < high``.
    order : int, 1 to 12, optional
        Of the Pade fraction of the delay.

    Returns
    -------
    tuple of (float, float)
        Each interval; an end at `low` or `high` is no limit of stability.

    Raises
    ------
    DataError
        If the gain is unknown or the range is empty.

    Notes
    -----
    201 values are judged by their roots; each change is bisected to 1e-12 of the range. Intervals
    narrower than half a percent of the range may be missed.
    """
    if vary not in ("kp", "ki", "kd"):
        raise DataError(f"vary={vary!r}; use 'kp', 'ki' or 'kd'")
    if not (math.isfinite(low) and math.isfinite(high) and 0.0 <= low < high):
        raise DataError(f"the range {low} ... {high} is empty or not finite")
    low = max(low, 1e-12 * high) if vary == "kp" else low

    def stable(value: float) -> bool:
        return model.is_stable(dataclasses.replace(gains, **{vary: value}), order=order)

    grid = np.linspace(low, high, 201).tolist()
    states = [stable(v) for v in grid]
    ends = [low] if states[0] else []
    for (a, b), (sa, sb) in zip(itertools.pairwise(grid), itertools.pairwise(states), strict=True):
        if sa != sb:
            ends.append(_bisect(stable, a, b, sa, 1e-12 * (high - low)))
    if states[-1]:
        ends.append(high)
    return tuple(zip(ends[::2], ends[1::2], strict=True))


def _bisect(stable: Any, a: float, b: float, state: bool, width: float) -> float:
    while b - a > width:
        middle = 0.5 * (a + b)
        if middle in (a, b):
            break
        a, b = (middle, b) if stable(middle) == state else (a, middle)
    return 0.5 * (a + b)


def _values(values: ArrayLike, name: str) -> list[float]:
    array = frozen_float(np.atleast_1d(np.asarray(values)), name=name, ndim=1)
    return [float(v) for v in array]


def _row(model: ServoModel, gains: Gains, simulate: bool, order: int) -> dict[str, Any]:
    poles = model.roots(gains, order=order)
    size = np.maximum(np.abs(poles), 1e-300)
    return {
        **{n: getattr(gains, n) for n in _GAINS},
        "stable": bool(poles[0].real < 0.0),
        "routh": model.routh_holds(gains),
        "decay_per_s": -float(poles[0].real),
        "damping_ratio": float((-poles.real / size).min()),
        "simulation": _simulated(model, gains, poles) if simulate else "not run",
        "improvement": math.nan,
    }


def _simulated(model: ServoModel, gains: Gains, poles: NDArray[np.complex128]) -> str:
    """Return what the answer to a smooth step does, in a word."""
    own = model.roots(gains, order=1) if model.delay else poles
    period = 1.0 / float(np.abs(own).max())
    duration = _SIMULATED * max(period, model.delay / 10.0)
    t = np.linspace(0.0, duration, 1201)
    rise = np.clip(t / (0.02 * duration), 0.0, 1.0)
    error = model.simulate(gains, t, rise**3 * (10.0 - 15.0 * rise + 6.0 * rise**2))
    if np.isinf(error).any():
        return "diverges"
    middle, last = np.ptp(error[400:800]), np.ptp(error[800:])
    if abs(float(poles[0].real)) * duration / 3.0 < _MARGINAL:
        return "marginal"
    return "stable" if last < middle or last < 1e-9 else "diverges"


def _best(settings: Sequence[Gains], rows: Sequence[Mapping[str, Any]]) -> Gains | None:
    stable = [(row, g) for row, g in zip(rows, settings, strict=True) if row["stable"]]
    if not stable:
        return None
    key = "decay_per_s" if math.isnan(stable[0][0]["improvement"]) else "improvement"
    return max(stable, key=lambda pair: float(pair[0][key]))[1]


def _messages(rows: Sequence[Mapping[str, Any]], best: Gains | None) -> tuple[str, ...]:
    messages = [
        "gains tell ratios and stability, not the size of a follow-up error: measure a log"
    ]
    if best is None:
        messages.append("no setting of the sweep is stable")
    elif (row := next(r for r in rows if all(r[n] == getattr(best, n) for n in _GAINS)))[
        "damping_ratio"
    ] < 0.1:
        messages.append(
            f"the best setting is damped by {row['damping_ratio']:.2g} only: it rings, and a "
            "little more mass or delay makes it unstable"
        )
    against = [r for r in rows if r["simulation"] == ("diverges" if r["stable"] else "stable")]
    if against:
        first = against[0]
        messages.append(
            f"{len(against)} settings are judged differently by roots and simulation, the first "
            f"at kp={first['kp']:g}, ki={first['ki']:g}, kd={first['kd']:g}: raise the order"
        )
    return tuple(messages)
