"""Displacement of a piezo stage over its drive voltage, both branches, and what a DAC makes of it.

A calibration is a `FlexureCalibration`, its stored form (a mapping of voltages and displacements,
as the sidecar holds it, also as JSON text), or a sensitivity such as ``"1.66 um/V"`` of a stage that is at 0 at 0 V.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, LimitError
from metrosep.core.units import format_length, parse_sensitivity
from metrosep.process.flexure import FlexureCalibration

__all__ = ["StageCurves", "quantised", "rising_parts"]


_CURVES = ("mean", "up", "down")
_UM = 1e-6
_LEAD = 1e-3
"""Of the stroke: noise of two sweeps without hysteresis; more is a loop that is run backwards."""
_SLACK = 1e-9
"""Of a range: closer than this to its end is inside."""


@dataclass(frozen=True, slots=True, eq=False)
class StageCurves:
    """What converts displacements and voltages of a stage."""

    calibration: FlexureCalibration | float  # or float: curves, or sensitivity in m/V
    # {"mean", "up", "down", "sweep"}: curve to use; "sweep" takes "up" where the voltage rises and
    # "down" where it falls
    branch: str
    low: float  # V: range of the amplifier's input
    high: float

    @property
    def voltages(self) -> tuple[float, float]:
        """Voltages that are both calibrated and within the amplifier's range, V."""
        if isinstance(self.calibration, float):
            return self.low, self.high
        known = self.calibration.voltage
        low, high = max(self.low, float(known[0])), min(self.high, float(known[-1]))
        if not high > low:
            raise DataError(
                f"the calibration covers {known[0]:.6g} ... {known[-1]:.6g} V, the amplifier "
                f"{self.low:.6g} ... {self.high:.6g} V: they do not overlap"
            )
        return low, high

    @property
    def stroke(self) -> tuple[float, float]:
        """Displacements that the mean curve reaches within `voltages`, m, rising."""
        ends = self.displacement(np.array(self.voltages), None)
        return float(ends.min()), float(ends.max())

    @property
    def steepest(self) -> float:
        """Largest slope of displacement over voltage, absolute, m/V."""
        if isinstance(self.calibration, float):
            return abs(self.calibration)
        v = np.linspace(*self.voltages, 2001)
        return float(np.abs(np.diff(self.displacement(v, None)) / np.diff(v)).max())

    def displacement(self, voltage: FloatArray, rising: BoolArray | None) -> FloatArray:
        """Return where the stage stands at voltages."""
        if isinstance(self.calibration, float):
            return np.asarray(voltage * self.calibration)
        known = self.calibration.voltage
        inside = np.clip(voltage, known[0], known[-1])
        chosen = "mean" if rising is None else self.branch
        if chosen != "sweep":
            curve = cast("Literal['mean', 'up', 'down']", chosen)
            return np.asarray(self.calibration.evaluate(inside, direction=curve))
        up = self.calibration.evaluate(inside, direction="up")
        down = self.calibration.evaluate(inside, direction="down")
        return np.asarray(np.where(cast("BoolArray", rising), up, down))

    def voltage_for(self, displacement: FloatArray, rising: BoolArray) -> FloatArray:
        """Return the voltages that give displacements."""
        if isinstance(self.calibration, float):
            return np.asarray(displacement / self.calibration)
        if self.branch != "sweep":
            curve = cast("Literal['mean', 'up', 'down']", self.branch)
            return np.asarray(self.calibration.voltage_for(displacement, direction=curve))
        result = np.empty_like(displacement)
        for part, curve in ((rising, "up"), (~rising, "down")):
            if part.any():
                result[part] = self.calibration.voltage_for(displacement[part], direction=curve)
        return result

    def stored(self) -> dict[str, Any] | float:
        """Return the calibration as plain values."""
        if isinstance(self.calibration, float):
            return self.calibration
        curves = {
            f"{name}_um": [None if math.isnan(v) else float(v) / _UM for v in values]
            for name, values in ((n, getattr(self.calibration, n)) for n in _CURVES)
        }
        return {"voltage_V": self.calibration.voltage.tolist(), **curves}

    @staticmethod
    def of(value: Any, branch: str, low: float, high: float) -> StageCurves:
        """Return the curves of a calibration in any of its forms."""
        if not high > low:
            raise DataError(f"v_min={low} V, v_max={high} V; the upper voltage must be larger")
        if isinstance(value, str) and value.lstrip().startswith("{"):
            value = _from_json(value)
        if isinstance(value, str):
            value = parse_sensitivity(value)
        if isinstance(value, int | float) and not isinstance(value, bool):
            if not math.isfinite(value) or value == 0.0:
                raise DataError(f"calibration={value}: a sensitivity is in m/V, and not zero")
            if branch != "mean":
                raise DataError(
                    f"branch={branch!r} needs a calibration with sweeps up and down, "
                    "not a sensitivity"
                )
            return StageCurves(float(value), branch, low, high)
        if isinstance(value, Mapping):
            value = _from_stored(value)
        if not isinstance(value, FlexureCalibration):
            raise DataError(
                f"calibration is a {type(value).__name__}; give a FlexureCalibration "
                "(metrosep.process.flexure_calibration), its stored form, or '1.66 um/V'"
            )
        if branch == "sweep":
            _require_lag(value)
        return StageCurves(value, branch, low, high)


def _require_lag(known: FlexureCalibration) -> None:
    """Refuse branches that lead: a piezo lags, so that the falling one lies ahead of the rising one."""
    sense = math.copysign(1.0, float(known.mean[-1] - known.mean[0]))
    lag = sense * (known.down - known.up)
    lag = lag[np.isfinite(lag)]
    stroke = float(np.ptp(known.mean))
    if lag.size and float(lag.mean()) < -_LEAD * stroke:
        raise DataError(
            f"the branches of the calibration are exchanged: while the voltage falls the stage must stand "
            f"ahead of where it stands while it rises, here it stands {format_length(-float(lag.mean()))} "
            "behind in the mean; name the sweeps the other way round, or use branch='mean'"
        )


def _from_json(text: str) -> dict[str, Any]:
    try:
        stored = json.loads(text)
    except (ValueError, RecursionError) as exc:
        raise DataError(
            f"calibration={text[:40]!r} is no JSON of a stored calibration: {exc}"
        ) from None
    return cast("dict[str, Any]", stored)


def _from_stored(stored: Mapping[Any, Any]) -> FlexureCalibration:
    try:
        v = np.array([float(x) for x in stored["voltage_V"]])
        mean = _curve(stored["mean_um"])
        up, down = (
            _curve(stored[f"{n}_um"]) if f"{n}_um" in stored else np.full(v.size, math.nan)
            for n in ("up", "down")
        )
    except (KeyError, TypeError, ValueError) as exc:
        raise DataError(
            f"a stored calibration holds lists voltage_V and mean_um (up_um, down_um): {exc!r}"
        ) from None
    same = v.size == mean.size == up.size == down.size
    if not same or v.size < 2 or not np.isfinite(v).all() or (np.diff(v) <= 0).any():
        raise DataError(
            "a stored calibration holds lists of equal length, at least 2, voltage_V rising"
        )
    if np.isnan(mean).any():
        raise DataError("mean_um of a stored calibration has gaps")
    for name, values in (("mean_um", mean), ("up_um", up), ("down_um", down)):
        if np.isinf(values).any():
            i = int(np.flatnonzero(np.isinf(values))[0])
            raise DataError(f"{name} of a stored calibration is infinite at {v[i]:g} V")
    for values in (v, mean, up, down):
        values.setflags(write=False)
    blank = np.full(v.size, math.nan)
    return FlexureCalibration(v, up, down, mean, blank, {}, "end-point", {}, ())


def _curve(values: Any) -> FloatArray:
    return np.array([math.nan if x is None else float(x) for x in values]) * _UM


def rising_parts(values: FloatArray, *, sign: float = 1.0) -> BoolArray:
    """Return at which samples a signal came from below."""
    steps = np.sign(np.diff(values)) * math.copysign(1.0, sign)
    moving = np.flatnonzero(steps)
    if moving.size == 0:
        return np.ones(values.size, dtype=np.bool_)
    last = np.searchsorted(moving, np.arange(steps.size), side="right") - 1
    signs = steps[moving[np.maximum(last, 0)]]
    return np.concatenate([signs[:1], signs]) > 0


def quantised(
    displacement: FloatArray,
    curves: StageCurves,
    bits: int,
    places: FloatArray,
) -> FloatArray:
    """Return the voltages that a DAC sets for displacements, in the order they are passed."""
    low, high = curves.stroke
    beyond = np.maximum(low - displacement, displacement - high)
    i = int(np.argmax(beyond))
    if beyond[i] > _SLACK * (high - low):
        raise LimitError(
            f"entry {i} at {places[i]:.9g} (m or rad) needs a displacement of "
            f"{format_length(float(displacement[i]))}, the stage reaches {format_length(low)} ... "
            f"{format_length(high)} between {curves.voltages[0]:.6g} and {curves.voltages[1]:.6g} V; "
            "set offset=, remove offset and line from the error, or take a stage of more stroke"
        )
    inside = np.clip(displacement, low, high)
    falls = curves.displacement(np.array(curves.voltages), None)
    rising = rising_parts(inside, sign=float(falls[1] - falls[0]))
    try:
        wanted = curves.voltage_for(inside, rising)
    except LimitError as exc:
        raise LimitError(f"{exc}; or use branch='mean'") from None
    step = (curves.high - curves.low) / (2**bits - 1)
    v = curves.low + step * np.rint((wanted - curves.low) / step)
    outside = np.maximum(curves.low - wanted, wanted - curves.high)
    worst = int(np.argmax(outside))
    if outside[worst] > _SLACK * (curves.high - curves.low):
        raise LimitError(
            f"entry {worst} at {places[worst]:.9g} (m or rad) needs {wanted[worst]:.6g} V on this "
            f"branch, the amplifier takes {curves.low:.6g} ... {curves.high:.6g} V; set offset="
        )
    return np.asarray(np.clip(v, curves.low, curves.high))
