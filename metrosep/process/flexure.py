"""Calibration of a piezo-driven flexure: voltage up and down against displacement.

Displacement is positive in the direction in which the sensor reads it; which way that moves the
tool is for the drive table to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
)
from metrosep.core.provenance import Step, freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.recording import Recording
from metrosep.process._plain import known
from metrosep.process._sweeps import (
    branches,
    dwells,
    levels,
    on_common_voltages,
    require_span,
    samples,
    sweeps,
)

__all__ = ["FlexureCalibration", "flexure_calibration"]

Direction = Literal["mean", "up", "down"]

_NEARLY = 0.99
"""Of the range of the log: curves that cover less are reported."""


@dataclass(frozen=True, slots=True, eq=False)
class FlexureCalibration:
    """Displacement of a flexure over voltage.

    Parameters
    ----------
    voltage : ndarray, shape (n,), V
        Rising.
    up, down, mean : ndarray, shape (n,), m
        Mean displacement of the rising and of the falling sweeps, and of both; NaN for a
        direction that was not run.
    scatter : ndarray, shape (n,), m
        Standard deviation between sweeps of one direction; NaN with one sweep of each.
    quantities : mapping of str to Quantity
        ``sensitivity`` m/V, ``intercept`` m, ``full_scale`` m, and ``nonlinearity``,
        ``hysteresis``, ``repeatability`` as shares of full scale.
    line : {"end-point", "least-squares"}
        What sensitivity and nonlinearity refer to.
    audit : mapping
        Counts and settings, shares in percent of full scale; None where not known.
    messages : tuple of str
        In plain words.
    history : tuple of Step
        From the log on.
    """

    voltage: FloatArray
    up: FloatArray
    down: FloatArray
    mean: FloatArray
    scatter: FloatArray
    quantities: Mapping[str, Quantity]
    line: str
    audit: Mapping[str, Any]
    messages: tuple[str, ...]
    history: tuple[Step, ...] = ()

    @property
    def sensitivity(self) -> float:
        """Slope of the line in m/V."""
        return self.quantities["sensitivity"].value

    @property
    def intercept(self) -> float:
        """Displacement of the line at 0 V in m."""
        return self.quantities["intercept"].value

    @property
    def full_scale(self) -> float:
        """Range of the mean curve in m."""
        return self.quantities["full_scale"].value

    @property
    def nonlinearity(self) -> float:
        """Largest distance of the mean curve from the line over full scale."""
        return self.quantities["nonlinearity"].value

    @property
    def hysteresis(self) -> float:
        """Largest distance of the two directions over full scale."""
        return self.quantities["hysteresis"].value

    @property
    def repeatability(self) -> float:
        """Largest standard deviation between sweeps over full scale."""
        return self.quantities["repeatability"].value

    def evaluate(self, voltage: ArrayLike, *, direction: Direction = "mean") -> FloatArray:
        """Return displacements at voltages.

        Parameters
        ----------
        voltage : array_like, shape (n,), V
            Within the calibrated range.
        direction : {"mean", "up", "down"}, optional
            Curve to use.

        Returns
        -------
        ndarray, shape (n,), m
            By a monotone cubic through the curve; NaN stays NaN.

        Raises
        ------
        LimitError
            If a voltage was not calibrated.
        DataError
            If the direction is unknown or was not run.
        """
        v = frozen_float(np.atleast_1d(np.asarray(voltage)), name="voltage", ndim=1)
        return _through(self.voltage, self._curve(direction), v, "voltage", "V")

    def voltage_for(self, displacement: ArrayLike, *, direction: Direction = "mean") -> FloatArray:
        """Return the voltages that give displacements: the monotone inverse.

        Parameters
        ----------
        displacement : array_like, shape (n,), m
            Within the calibrated range.
        direction : {"mean", "up", "down"}, optional
            Curve to use.

        Returns
        -------
        ndarray, shape (n,), V
            `evaluate` of them gives the displacements back to 1e-12 of full scale; NaN stays NaN.

        Raises
        ------
        LimitError
            If a displacement is beyond the calibrated stroke.
        InvalidSamplesError
            If the curve is not monotone.
        DataError
            If the direction is unknown or was not run.
        """
        d = frozen_float(np.atleast_1d(np.asarray(displacement)), name="displacement", ndim=1)
        curve = self._curve(direction)
        _require_monotone(self.voltage, curve, direction)
        return _inverse(self.voltage, curve, d)

    def u_displacement(self, *, direction: Direction = "mean") -> float:
        """Return the standard uncertainty of a displacement that is set by voltage alone.

        Parameters
        ----------
        direction : {"mean", "up", "down"}, optional
            Curve that is used; the mean one carries half of the hysteresis as a limit.

        Returns
        -------
        float, m
            Scatter between sweeps, sensor and hysteresis; NaN if nothing tells it.
        """
        parts = [self.audit["resolution_nm"] * 1e-9 / math.sqrt(12.0)]
        if not math.isnan(self.repeatability):
            parts.append(self.repeatability * self.full_scale)
        if direction == "mean" and not math.isnan(self.hysteresis):
            parts.append(0.5 * self.hysteresis * self.full_scale / math.sqrt(3.0))
        known = [p for p in parts if p > 0.0]
        return math.sqrt(sum(p * p for p in known)) if known else math.nan

    def _curve(self, direction: str) -> FloatArray:
        if direction not in ("mean", "up", "down"):
            raise DataError(f"direction={direction!r}; use 'mean', 'up' or 'down'")
        curve: FloatArray = getattr(self, direction)
        if np.isnan(curve).any():
            raise DataError(f"the calibration holds no sweep {direction}; use direction='mean'")
        return curve


def flexure_calibration(
    recording: Recording,
    *,
    voltage: str = "voltage",
    displacement: str = "displacement",
    line: Literal["end-point", "least-squares"] = "end-point",
    resolution: float = 0.0,
) -> FlexureCalibration:
    """Return the calibration of a flexure from sweeps of its voltage.

    Parameters
    ----------
    recording : Recording
        Log of voltage in V and displacement in m, in order of time: up, down, as often as wanted.
    voltage, displacement : str, optional
        Names of the channels; the channel in V and the one in m if these do not exist.
    line : {"end-point", "least-squares"}, optional
        What sensitivity and nonlinearity refer to.
    resolution : float, m, optional
        Of the sensor, for the uncertainty.

    Returns
    -------
    FlexureCalibration
        Curves, sensitivity, nonlinearity, hysteresis, repeatability, inverse.

    Raises
    ------
    InvalidSamplesError
        If the mean curve is not monotone (the voltage is named) or a channel is missing.
    TooFewSamplesError
        If a sweep has fewer than 3 voltages.
    UnitError
        If a channel states another unit.
    DegenerateFitError
        If the voltage does not change, or the sweeps do not overlap.
    DataError
        If an option is not one of its choices.

    Notes
    -----
    Samples where either channel is NaN are left out and counted. Dwells on one voltage are
    averaged, also of a noisy voltage that jumps between levels; samples on the way are counted. Sweeps are cut at the turning points. Whole sweeps count (95 % of the range); parts of
    one are left out and named. Where a direction has no whole sweep, the first and the last part
    of a log that started inside the stroke are joined; failing that, parts of more than half stand
    in and the range is cut to what all sweeps share. They are compared on common voltages: the levels of
    the log where all sweeps share them, else 101 voltages by linear interpolation.
    Nonlinearity: largest distance of the mean curve from the line; hysteresis: largest
    distance of up and down; repeatability: largest standard deviation between sweeps of one
    direction; each over full scale, the range of the mean curve. Creep and rate are not separated:
    sweep at the speed of use.

    References
    ----------
    .. [1] Dual-servo paper, section 4.1: 16.6 um at 10 V, sensor 5 nm.

    Examples
    --------
    >>> v = np.concatenate([np.arange(11.0), np.arange(10.0)[::-1]])
    >>> log = Recording(np.arange(21.0), {"voltage": v, "displacement": 1.66e-6 * v})
    >>> result = flexure_calibration(log)
    >>> round(result.sensitivity * 1e6, 9), round(result.nonlinearity, 9)
    (1.66, 0.0)
    """
    if line not in ("end-point", "least-squares"):
        raise DataError(f"line={line!r}; use 'end-point' or 'least-squares'")
    if not (math.isfinite(resolution) and resolution >= 0.0):
        raise DataError(f"resolution={resolution} m; it cannot be negative")
    v, d, lost = samples(recording, voltage, displacement)
    require_span(v)
    v, d, between = levels(v, d)
    v, d = dwells(v, d)
    cut = sweeps(v, d)
    runs = cut.runs
    grid, curves = on_common_voltages(runs)
    rising = np.array([s[0][-1] > s[0][0] for s in runs])
    up, down, mean, scatter = branches(curves, rising)
    _require_monotone(grid, mean, "mean")
    slope, height = _line(grid, mean, line)
    scale = abs(float(mean[-1] - mean[0]))
    quantities = {
        "sensitivity": Quantity(
            slope, "m/V", f"{line} slope of displacement over voltage",
            _u_slope(grid, curves, rising, resolution, line), "S",
        ),
        "intercept": Quantity(height, "m", f"displacement of the {line} line at 0 V"),
        "full_scale": Quantity(scale, "m", "range of the mean displacement"),
        "nonlinearity": Quantity(
            float(np.abs(mean - slope * grid - height).max()) / scale, "1",
            f"largest distance from the {line} line over full scale",
        ),
        "hysteresis": Quantity(
            float(np.abs(up - down).max()) / scale, "1", "largest distance of up and down over full scale"
        ),
        "repeatability": Quantity(
            float(np.nanmax(scatter)) / scale if not np.isnan(scatter).all() else math.nan, "1",
            "largest standard deviation between sweeps over full scale",
        ),
    }  # fmt: skip
    percent = {
        f"{n}_percent_fs": known(100.0 * quantities[n].value)
        for n in ("nonlinearity", "hysteresis", "repeatability")
    }
    return FlexureCalibration(
        voltage=_locked(grid),
        up=_locked(up),
        down=_locked(down),
        mean=_locked(mean),
        scatter=_locked(scatter),
        quantities=freeze_mapping(quantities),
        line=line,
        audit=freeze_mapping(
            {
                "sweeps_up": int(rising.sum()),
                "sweeps_down": int((~rising).sum()),
                "sweeps_left_out": cut.left_out,
                "join_jump_nm": tuple(1e9 * j for j in cut.jumps),
                "samples_not_measured": lost,
                "samples_between_levels": between,
                "voltages": int(grid.size),
                "range_V": (float(grid[0]), float(grid[-1])),
                "resolution_nm": resolution * 1e9,
                **percent,
            }
        ),
        messages=(
            *cut.messages,
            *_range_message(v, grid),
            *_messages(rising, scale, quantities, resolution),
        ),
        history=(*recording.history, Step("flexure_calibration", {"line": line})),
    )


def _line(v: FloatArray, d: FloatArray, line: str) -> tuple[float, float]:
    if line == "end-point":
        slope = float(d[-1] - d[0]) / float(v[-1] - v[0])
        return slope, float(d[0]) - slope * float(v[0])
    centre, level = float(v.mean()), float(d.mean())
    slope = float((v - centre) @ (d - level)) / float((v - centre) @ (v - centre))
    return slope, level - slope * centre


def _u_slope(
    grid: FloatArray, curves: FloatArray, rising: NDArray[np.bool_], resolution: float, line: str
) -> float | None:
    slopes = np.array([_line(grid, c, line)[0] for c in curves])
    squares, freedom = 0.0, 0
    for own in (slopes[rising], slopes[~rising]):
        if own.size > 1:
            squares += float(((own - own.mean()) ** 2).sum())
            freedom += own.size - 1
    sensor = math.sqrt(2.0 / 12.0) * resolution / float(grid[-1] - grid[0])
    if freedom:
        return math.hypot(math.sqrt(squares / freedom / slopes.size), sensor)
    return sensor if resolution > 0.0 else None


def _require_monotone(v: FloatArray, d: FloatArray, which: str) -> None:
    steps = np.diff(d)
    sign = math.copysign(1.0, float(d[-1] - d[0]))
    wrong = np.flatnonzero(sign * steps <= 0.0)
    if wrong.size:
        i = int(wrong[0])
        raise InvalidSamplesError(
            f"the {which} curve is not monotone at {v[i + 1]:.6g} V: displacement goes from "
            f"{d[i]:.6g} m at {v[i]:.6g} V to {d[i + 1]:.6g} m; it has no inverse there: look for "
            "saturation or noise, or sweep fewer voltages"
        )


def _through(x: FloatArray, y: FloatArray, at: FloatArray, name: str, unit: str) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    low, high = float(x[0]), float(x[-1])
    slack = 1e-9 * (high - low)
    outside = (at < low - slack) | (at > high + slack)
    if outside.any():
        worst = float(at[int(np.argmax(np.where(outside, np.abs(at - 0.5 * (low + high)), 0.0)))])
        raise LimitError(
            f"{name} {worst:.6g} {unit} lies outside the calibrated {low:.6g} ... {high:.6g} {unit} "
            f"by {max(low - worst, worst - high):.3g} {unit}; reduce it or calibrate further"
        )
    result = np.full(at.size, np.nan)
    valid = ~np.isnan(at)
    result[valid] = PchipInterpolator(x, y)(np.clip(at[valid], low, high))
    return _locked(result)


def _inverse(v: FloatArray, d: FloatArray, at: FloatArray) -> FloatArray:
    """Return the voltages by bracketed Newton steps on the monotone cubic."""
    from scipy.interpolate import PchipInterpolator

    turned = d[-1] < d[0]
    x, y = (v[::-1], d[::-1]) if turned else (v, d)
    guess = np.array(_through(y, x, at, "displacement", "m"))
    valid = ~np.isnan(guess)
    curve = PchipInterpolator(v, d)
    slope = curve.derivative()
    target, point = at[valid], guess[valid]
    cell = np.clip(np.searchsorted(y, target, side="right") - 1, 0, y.size - 2)
    low, high = np.minimum(x[cell], x[cell + 1]), np.maximum(x[cell], x[cell + 1])
    rise = -1.0 if turned else 1.0
    for _ in range(60):
        rest = rise * (curve(point) - target)
        low, high = np.where(rest <= 0.0, point, low), np.where(rest > 0.0, point, high)
        steep = rise * slope(point)
        with np.errstate(divide="ignore", invalid="ignore"):
            following = point - rest / steep
        inside = (following > low) & (following < high) & (steep > 0.0)
        following = np.where(
            inside | (rest == 0.0), np.where(rest == 0.0, point, following), 0.5 * (low + high)
        )
        if float(np.abs(following - point).max(initial=0.0)) <= 1e-15 * float(np.abs(v).max()):
            break
        point = following
    guess[valid] = np.clip(point, v[0], v[-1])
    return _locked(guess)


def _range_message(v: FloatArray, grid: FloatArray) -> list[str]:
    if float(np.ptp(grid)) >= _NEARLY * float(np.ptp(v)):
        return []
    return [
        (
            f"the curves cover {grid[0]:.4g} ... {grid[-1]:.4g} V of the {v.min():.4g} ... "
            f"{v.max():.4g} V of the log, what all sweeps share: full scale is of that part; sweep "
            "from one end to the other and back"
        )
    ]


def _messages(
    rising: NDArray[np.bool_], scale: float, quantities: Mapping[str, Quantity], resolution: float
) -> tuple[str, ...]:
    messages = []
    if rising.all() or not rising.any():
        which = "up" if rising.all() else "down"
        messages.append(
            f"one direction only (sweeps {which}): hysteresis is not known; sweep up and down"
        )
    if math.isnan(quantities["repeatability"].value):
        messages.append(
            "one sweep of each direction: repeatability is not known; repeat the sweeps"
        )
    if quantities["hysteresis"].value > 0.05:
        messages.append(
            f"hysteresis is {100 * quantities['hysteresis'].value:.1f} % of full scale: drive the "
            "stage closed loop, or use the curve of the direction"
        )
    if resolution > 0.01 * scale:
        messages.append(f"the sensor resolves {100 * resolution / scale:.1f} % of full scale only")
    return tuple(messages)


def _locked(values: FloatArray) -> FloatArray:
    return frozen_float(values, name="result", ndim=1)
