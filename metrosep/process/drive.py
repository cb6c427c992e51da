"""Drive of a piezo stage: displacements, voltages, and every limit they must keep.

A compensation is ``-error``; the stage stands at an offset so that it can move both ways. What the
sign of a column is (error or compensation) is stated by the caller and never inferred.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.docs import described_by
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.process._plain import Frozen, frozen, plain
from metrosep.process.flexure import FlexureCalibration
from metrosep.process.hysteresis import PrandtlIshlinskii
from metrosep.process.servo import Gains, ServoModel, error_ratio

if TYPE_CHECKING:
    import pandas as pd

Stage = FlexureCalibration | tuple[PrandtlIshlinskii, ArrayLike] | float
"""A curve, a model with the voltages it has seen, or a sensitivity in m/V."""

_SLACK = 1e-9
"""Relative to a range; a value on the limit keeps it."""


@dataclass(frozen=True, slots=True, eq=False)
class DriveTable(Frozen):
    """Voltages of a stage over position or time.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Position in m, or time in s.
    displacement : ndarray, shape (n,), m
        Of the stage, the offset included.
    voltage : ndarray, shape (n,), V
        As the DAC can set it; equal to the wanted one without `bits`.
    residual : ndarray, shape (n,), m
        What the DAC sets minus what was wanted.
    violations : tuple of str
        Every limit that is not kept, with the offending value.
    audit : mapping
        Ranges and settings.
    """

    x: FloatArray
    displacement: FloatArray
    voltage: FloatArray
    residual: FloatArray
    violations: tuple[str, ...]
    audit: Mapping[str, Any]

    @property
    def is_ok(self) -> bool:
        """Whether all limits are kept."""
        return not self.violations

    def to_dict(self) -> dict[str, Any]:
        """Return the table as plain values; None where nothing is known.

        Returns
        -------
        dict
            Keys ``x``, ``displacement_m``, ``voltage_V``, ``residual_m``, ``is_ok``,
            ``violations``, ``audit``.
        """
        columns = {"x": self.x, "displacement_m": self.displacement, "voltage_V": self.voltage}
        columns["residual_m"] = self.residual
        table: dict[str, Any] = plain(
            {**columns, "is_ok": self.is_ok, "violations": self.violations, "audit": self.audit}
        )
        return table


def stage_displacement(
    values: ArrayLike,
    *,
    quantity: Literal["error", "compensation"],
    offset: float = 0.0,
    travel: float = math.inf,
) -> FloatArray:
    """Return where a stage must stand: ``offset - error`` or ``offset + compensation``.

    Parameters
    ----------
    values : array_like, shape (n,), m
        Error or compensation; NaN stays NaN.
    quantity : {"error", "compensation"}
        Which of them; the sign follows.
    offset : float, m, optional
        Where the stage rests.
    travel : float, m, optional
        Of the stage, from 0.

    Returns
    -------
    ndarray, shape (n,), m
        Displacement from the end of the travel.

    Raises
    ------
    LimitError
        If the stage would leave its travel; the offending value is named.
    DataError
        If `quantity` is not one of its choices, or offset or travel is not a length.

    References
    ----------
    .. [1] Kono 2008, section on the drive: reference = d_off - e, d_off = 2 um in 5 um travel.

    Examples
    --------
    >>> um = 1e-6
    >>> d = stage_displacement([-3 * um, 2 * um], quantity="error", offset=2 * um, travel=5 * um)
    >>> (d / um).round(9).tolist()
    [5.0, 0.0]
    """
    v, offset = _checked_values(values, quantity, offset)
    d = offset - v if quantity == "error" else offset + v
    beyond = _beyond_stroke(d, v, quantity, offset, (0.0, _limit(travel, "travel", "length")))
    if beyond:
        raise LimitError(beyond[0])
    return frozen(d)


@described_by(stage_displacement)
def drive_table(
    x: ArrayLike,
    values: ArrayLike,
    *,
    quantity: Literal["error", "compensation"],
    calibration: FlexureCalibration | PrandtlIshlinskii | float,
    history: ArrayLike | None = None,
    tolerance: float = math.inf,
    offset: float = 0.0,
    limits: tuple[float, float] = (0.0, 10.0),
    travel: float = math.inf,
    speed: float | None = None,
    slew: float = math.inf,
    bits: int | None = None,
    strict: bool = True,
) -> DriveTable:
    """Return the voltages that compensate an error, checked against every limit.

    Parameters
    ----------
    x : array_like, shape (n,)
        Positions in m with `speed`, else times in s; strictly increasing.
    calibration : FlexureCalibration, PrandtlIshlinskii or float
        Monotone curve, a model with hysteresis, or the sensitivity in m/V of a stage that stands at 0
        at 0 V.
    history : array_like, shape (m,), V, optional
        What the stage has seen before the table, such as a conditioning cycle; needed with a model with
        hysteresis, whose inverse holds from one state only.
    tolerance : float, m, optional
        Largest residual, a violation above.
    offset : float, m, optional
        Displacement at which the stage rests.
    limits : tuple of (float, float), V, optional
        Of the amplifier.
    travel : float, m, optional
        Of the stage, from 0 to the side on which the calibration lies: a negative sensitivity
        moves it to negative displacements.
    speed : float, m/s, optional
        Feed; makes times of positions.
    slew : float, V/s, optional
        Fastest change that the amplifier makes; the steps of the DAC must keep it too.
    bits : int, optional
        Of the DAC over the limits; voltages become its steps.
    strict : bool, optional
        Whether a violated limit is an error, or only listed.

    Returns
    -------
    DriveTable
        Voltages, residual of the DAC, violations.

    Raises
    ------
    LimitError
        With `strict`, if any limit is not kept; every one is named with its value.
    InvalidSamplesError
        If a value or a position is NaN, or positions do not increase.
    DataError
        If an option is not one of its choices.

    Notes
    -----
    A table cannot have gaps: a voltage that is not known is refused, not filled. ``2^bits`` levels
    span the limits, their ends included; the residual is at most half a step.

    References
    ----------
    .. [1] Dual-servo paper, eq. 1 and section 4.1.

    Examples
    --------
    >>> table = drive_table([0.0, 1.0], [0.0, 8.3e-6], quantity="compensation", calibration=1.66e-6)
    >>> table.voltage.round(9).tolist(), table.is_ok
    ([0.0, 5.0], True)
    """
    positions, times = _positions(x, speed)
    low, high = _checked_limits(limits)
    travel, slew = _limit(travel, "travel", "length"), _limit(slew, "slew", None)
    size = None if bits is None else numbers.count(bits, "bits", most=32)
    given, offset = _checked_values(values, quantity, offset)
    d = offset - given if quantity == "error" else offset + given
    if d.size != positions.size:
        raise InvalidSamplesError(f"values has {d.size} samples, x has {positions.size}")
    if np.isnan(d).any():
        i = int(np.flatnonzero(np.isnan(d))[0])
        raise InvalidSamplesError(
            f"values is NaN at x = {format_length(float(positions[i]))}; a drive table cannot have gaps"
        )
    stage: Stage
    if isinstance(calibration, PrandtlIshlinskii):
        if history is None:
            raise DataError(
                "a stage with hysteresis stands where its past has left it: give history=, the voltages of "
                "its conditioning cycle such as (0, 10, 0)"
            )
        stage, curve = (calibration, history), calibration.weights
    elif isinstance(calibration, FlexureCalibration):
        stage, curve = calibration, calibration.mean
    else:
        stage = numbers.real(calibration, "calibration")
        curve = np.array([stage])
        if stage == 0.0:
            raise DataError("a sensitivity of 0 m/V is of no use")
    stroke = (-travel, 0.0) if float(curve.min() + curve.max()) < 0.0 else (0.0, travel)
    finite = math.isfinite(travel)
    violations = _beyond_stroke(d, given, quantity, offset, stroke) if finite else []
    wanted, beyond = _voltages(d, stage)
    violations += [*beyond, *_beyond_range(wanted, positions, low, high)]
    too_fast = _too_fast(wanted, positions, times, slew)
    violations += too_fast
    voltage, residual = _quantised(wanted, d, stage, low, high, size)
    most = _limit(tolerance, "tolerance", "length")
    worst = float(np.fmax.reduce(np.abs(residual), initial=0.0))
    if worst > most:
        violations.append(
            f"the stage misses the displacement by up to {format_length(worst)}, the tolerance is "
            f"{format_length(most)}: use more bits"
        )
    if size is not None and not too_fast:
        violations += [
            f"in steps of the DAC {message}, use more bits or fewer positions"
            for message in _too_fast(voltage, positions, times, slew)
        ]
    if strict and violations:
        raise LimitError("; ".join(violations))
    some = not np.isnan(wanted).all()
    audit = {
        "quantity": quantity,
        "offset_um": offset * 1e6,
        "voltage_min_V": float(np.nanmin(wanted)) if some else None,
        "voltage_max_V": float(np.nanmax(wanted)) if some else None,
        "stroke_um": float(np.ptp(d)) * 1e6,
        "limits_V": (low, high),
        "largest_slew_V_per_s": _largest_slew(wanted, times),
        "largest_slew_of_dac_V_per_s": None if size is None else _largest_slew(voltage, times),
        "bits": size,
        "dac_step_mV": None if size is None else 1e3 * (high - low) / (2**size - 1),
        "residual_rms_nm": float(np.sqrt(np.nanmean(residual**2))) * 1e9 if some else None,
    }
    return DriveTable(positions, d, voltage, residual, tuple(violations), audit)


def _checked_values(values: ArrayLike, quantity: str, offset: Any) -> tuple[FloatArray, float]:
    if quantity not in ("error", "compensation"):
        raise DataError(
            f"quantity={quantity!r}; state 'error' or 'compensation': the sign follows"
        )
    v = frozen_float(np.atleast_1d(np.asarray(values)), name="values", ndim=1)
    return v, numbers.quantity(offset, "offset", "length")


def _limit(value: Any, name: str, dimension: str | None) -> float:
    """Return a limit above zero; infinite where there is none."""
    number = numbers.real(value, name, dimension=dimension, finite=False)
    return number if number == math.inf else numbers.positive(number, name, dimension=dimension)


def _outside(d: FloatArray, low: float, high: float) -> int | None:
    """Return the index of the value furthest outside, None if all are inside."""
    span = high - low if math.isfinite(high - low) else float(np.nanmax(np.abs(d), initial=0.0))
    beyond = np.fmax(low - d, d - high)
    if not (beyond > _SLACK * span).any():
        return None
    return int(np.nanargmax(beyond))


def _beyond_stroke(
    d: FloatArray, values: FloatArray, quantity: str, offset: float, stroke: tuple[float, float]
) -> list[str]:
    """Return what leaves the travel of the stage the furthest, and what it admits."""
    below, above = stroke
    i = _outside(d, below, above)
    if i is None:
        return []
    sign = "negative " if d[i] < 0.0 <= below else ""
    low, high = below - offset, above - offset
    if quantity == "error":
        low, high = -high, -low
    beyond = max(below - d[i], d[i] - above)
    article = "an" if quantity == "error" else "a"
    message = (
        f"{quantity} {values[i] * 1e6:.6g} um needs a {sign}displacement of {d[i] * 1e6:.6g} um, "
        f"{beyond * 1e6:.3g} um beyond the stroke {_span(below, above, 1e6)} um; with an offset of "
        f"{offset * 1e6:.6g} um {article} {quantity} of {_span(low, high, 1e6)} um is admissible"
    )
    return [message]


def _span(low: float, high: float, factor: float = 1.0) -> str:
    # minus zero is zero
    return f"{low * factor + 0.0:.6g} ... {high * factor + 0.0:.6g}"


def _voltages(d: FloatArray, calibration: Stage) -> tuple[FloatArray, list[str]]:
    if isinstance(calibration, tuple):
        model, history = calibration
        return model.voltage_for(d, history=history), []
    if not isinstance(calibration, FlexureCalibration):
        return np.asarray(d / float(calibration)), []
    low = float(calibration.mean.min())
    high = float(calibration.mean.max())
    i = _outside(d, low, high)
    if i is None:
        return calibration.voltage_for(np.clip(d, low, high)), []
    inside = np.where((d >= low) & (d <= high), d, np.nan)
    beyond = max(low - d[i], d[i] - high)
    words = (
        f"displacement {d[i] * 1e6:.6g} um lies outside the calibrated {_span(low, high, 1e6)} um, "
        f"by {beyond * 1e6:.3g} um"
    )
    return calibration.voltage_for(inside), [words]


def _beyond_range(v: FloatArray, x: FloatArray, low: float, high: float) -> list[str]:
    i = None if np.isnan(v).all() else _outside(v, low, high)
    if i is None:
        return []
    negative = "negative " if v[i] < 0.0 <= low else ""
    message = (
        f"{negative}voltage {v[i]:.6g} V at x = {format_length(float(x[i]))} lies outside "
        f"{_span(low, high)} V by {max(low - v[i], v[i] - high):.3g} V (the table needs "
        f"{np.nanmin(v):.6g} ... {np.nanmax(v):.6g} V); change the offset"
    )
    return [message]


def _too_fast(v: FloatArray, x: FloatArray, times: FloatArray | None, slew: float) -> list[str]:
    if not math.isfinite(slew):
        return []
    if times is None or v.size < 2:
        raise DataError("a slew rate needs at least two times: pass speed= with positions")
    rate = np.abs(np.diff(v)) / np.diff(times)
    i = 0 if np.isnan(rate).all() else int(np.nanargmax(rate))
    if not rate[i] > slew * (1.0 + _SLACK):
        return []
    message = (
        f"the voltage changes by {rate[i]:.6g} V/s at x = {format_length(float(x[i]))}, the amplifier "
        f"makes {slew:.6g} V/s, {100.0 * (rate[i] / slew - 1.0):.2g} % less; lower the feed"
    )
    return [message]


def _largest_slew(v: FloatArray, times: FloatArray | None) -> float | None:
    rate = np.empty(0) if times is None else np.abs(np.diff(v)) / np.diff(times)
    return None if np.isnan(rate).all() else float(np.nanmax(rate))


def _quantised(
    wanted: FloatArray,
    d: FloatArray,
    calibration: Stage,
    low: float,
    high: float,
    bits: int | None,
) -> tuple[FloatArray, FloatArray]:
    if bits is None:
        return wanted, np.where(np.isnan(wanted), np.nan, 0.0)
    step = (high - low) / (2**bits - 1)
    set_to = low + step * np.rint((np.clip(wanted, low, high) - low) / step)
    if isinstance(calibration, tuple):
        model, history = calibration
        got = model.displacement(set_to, history=history)
    elif isinstance(calibration, FlexureCalibration):
        ends = calibration.voltage
        got = calibration.evaluate(np.clip(set_to, ends[0], ends[-1]))
    else:
        got = set_to * float(calibration)
    return set_to, np.asarray(got - d)


def _positions(x: ArrayLike, speed: float | None) -> tuple[FloatArray, FloatArray | None]:
    positions = frozen_float(x, name="x", ndim=1)
    if np.isnan(positions).any() or (np.diff(positions) <= 0.0).any():
        raise InvalidSamplesError("x must be without NaN and strictly increasing")
    if speed is None:
        return positions, positions
    return positions, positions / numbers.positive(speed, "speed", dimension="speed")


def _checked_limits(limits: Any) -> tuple[float, float]:
    try:
        low, high = (numbers.quantity(v, "a limit of the amplifier", "voltage") for v in limits)
    except ValueError as exc:
        raise DataError(
            f"limits={limits} V; give the lower and the upper voltage ({exc})"
        ) from None
    if not low < high:
        raise DataError(f"limits={limits} V; give the lower and the upper voltage")
    return low, high


# ---- which gains are stable: a sweep judged by roots and by simulation, and the limits of one gain ----
# A sweep shows where an axis diverges and by what ratio settings differ; it gives no length.

_GAINS = ("kp", "ki", "kd", "feedforward")
_MOST = 20_000
_MARGINAL = 0.5
"""Rightmost pole times the time that is simulated, below which growth is too slow to be seen."""

_SIMULATED = 400
"""Times of the fastest pole that a simulation lasts at least."""


@dataclass(frozen=True, slots=True)
class GainSweep(Frozen):
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
        If a gain is out of range, there are more than 20000 settings, only one of `t` and `command`
        is given, the reference is unstable, or as of `ServoModel.simulate`.

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
    given = zip(_GAINS, (kp, ki, kd, feedforward), strict=True)
    axes = [frozen_float(np.atleast_1d(np.asarray(v)), name=n, ndim=1).tolist() for n, v in given]
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
    audit = {
        "settings": count,
        "stable": len(stable),
        "pade_order": order,
        "delay_ms": model.delay * 1e3,
        "mass": model.mass,
        "damping": model.damping,
    }
    kept = tuple(freeze_mapping(row) for row in rows)
    return GainSweep(kept, best, reference, audit, _messages(rows, best))


@described_by(sweep_gains, errors=False)
def stability_limits(
    model: ServoModel, gains: Gains, vary: str, *, low: float, high: float, order: int = 8
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of one gain in which the loop is stable.

    Parameters
    ----------
    gains : Gains
        The other gains.
    vary : {"kp", "ki", "kd"}
        Gain to vary.
    low, high : float
        Range to search, ``0 <= low < high``.

    Returns
    -------
    tuple of (float, float)
        Each interval; an end at `low` or `high` is not a limit of stability.

    Raises
    ------
    DataError
        If the gain is unknown or the range is empty.

    Notes
    -----
    201 values are judged by their roots; each change is bisected to 1e-12 of the range. Intervals
    narrower than half a percent of the range may be missed.
    """
    numbers.choice(vary, "vary", ("kp", "ki", "kd"))
    low, high = numbers.real(low, "low"), numbers.real(high, "high")
    if not 0.0 <= low < high:
        raise DataError(f"the range {low} ... {high} of a gain is empty")
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
