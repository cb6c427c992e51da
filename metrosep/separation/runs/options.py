"""Options of the joint separation, checked once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from metrosep.core.errors import DataError, NotSeparableError, UnitError
from metrosep.core.numbers import flag, real
from metrosep.core.units import format_length

__all__ = ["Following", "JointOptions", "metres"]

Following = Literal["off", "offset", "scale", "waves"]

_MAX_WAVES = 8
"""Waves of the feed-dependent error; more would compete with the geometry itself."""


@dataclass(frozen=True, slots=True)
class JointOptions:
    """What the joint model holds beside geometry, offsets and noise; all off by default."""

    drift: int = 0  # {0, 1, 2}: degree of the polynomial in time of each run
    # "auto" or tuple of float, Hz: deterministic lines; "auto" looks for them
    lines: Literal["auto"] | tuple[float, ...] = ()
    # {"free", "locked"}: whether each run has its own phase and amplitude, or all share them from
    # their start
    line_phase: Literal["free", "locked"] = "free"
    false_alarm: float = 0.001  # chance that "auto" finds a line where there is none
    robust: bool = False  # whether spikes and bad stretches lose their weight
    # {"off", "offset", "scale", "waves"}: what depends on the feedrate
    following: Following = "off"
    # or tuple of float, m: how many of the strongest wavelengths depend on it, or which
    following_waves: int | tuple[float, ...] = 3
    # {"equal", "fit"}: whether the probes have the same sensitivity
    probe_gain: Literal["equal", "fit"] = "equal"

    def __post_init__(self) -> None:
        object.__setattr__(self, "drift", _checked_drift(self.drift))
        for name, allowed in (
            ("line_phase", ("free", "locked")),
            ("following", ("off", "offset", "scale", "waves")),
            ("probe_gain", ("equal", "fit")),
        ):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in allowed:
                raise DataError(f"{name} is one of {', '.join(allowed)}, got {value!r}")
        flag(self.robust, "robust")
        chance = "a probability between 0 and 1"
        if not 0.0 < real(self.false_alarm, "false_alarm", what=chance) < 1.0:
            raise DataError(f"false_alarm is {chance}, got {self.false_alarm}")
        object.__setattr__(self, "lines", _checked_lines(self.lines))
        object.__setattr__(self, "following_waves", _checked_waves(self.following_waves))

    def as_dict(self) -> dict[str, Any]:
        """Return the options as plain values, with unit suffixes."""
        waves = self.following_waves
        return {
            "drift": self.drift,
            "lines_hz": self.lines if isinstance(self.lines, str) else list(self.lines),
            "line_phase": self.line_phase,
            "false_alarm": self.false_alarm,
            "robust": bool(self.robust),
            "following": self.following,
            "following_waves_mm": waves if isinstance(waves, int) else [w * 1e3 for w in waves],
            "probe_gain": self.probe_gain,
        }

    def check_waves(self, period: float) -> None:
        """Refuse stated wavelengths that the model cannot hold."""
        if self.following != "waves" or isinstance(self.following_waves, int):
            return
        for wave in self.following_waves:
            if wave > period * (1.0 + 1e-9):
                raise UnitError(
                    f"a wavelength of following_waves is {format_length(wave)}, longer than the "
                    f"longest of the model, {format_length(period)}; it is in metres: 8 mm is "
                    "8e-3 (a number of waves is a whole number, such as 3)"
                )

    def check_runs(self, n_feeds: int, n_probes: int, *, fit_lag: bool, way: str) -> None:
        """Refuse what the feedrates and probes at hand cannot show."""
        if self.following != "off" and n_feeds < 2:
            raise NotSeparableError(
                f"following={self.following!r} needs runs at >= 2 feedrates (>= 3 to test it), the "
                f"{way} runs have {n_feeds}: at one feedrate a part that grows with the feed is part "
                "of the geometry; add runs at another feedrate"
            )
        if self.following == "waves" and fit_lag:
            raise NotSeparableError(
                "lag='fit' and following='waves' cannot be told apart: a lag is a wave in "
                "quadrature that grows with the feed; fit the one or the other"
            )
        if self.probe_gain == "fit" and n_probes < 2:
            raise NotSeparableError(
                f"probe_gain='fit' compares probes, the {way} runs have {n_probes}; name the probe of "
                "each run (probes=[...] or metadata['probe'])"
            )


def metres(value: Any, name: str) -> float | None:
    """Return a length as a plain number: text such as "20 mm" is not one."""
    if value is None:
        return None
    single = isinstance(value, int | float | np.number) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
    )
    if not single or isinstance(value, bool | np.complexfloating):
        raise DataError(f"{name} is a number in metres (1.2 mm is 1.2e-3), got {value!r}")
    return float(value)


def _checked_drift(drift: Any) -> int:
    """Return the degree as int; 1.0, as a file may hold it, is 1."""
    number = isinstance(drift, int | float | np.number) and not isinstance(drift, bool)
    if not number or drift not in (0, 1, 2):
        raise DataError(f"drift is the degree of a polynomial in time: 0, 1 or 2, got {drift!r}")
    return int(drift)


def _checked_lines(lines: Any) -> Literal["auto"] | tuple[float, ...]:
    if isinstance(lines, str):
        if lines != "auto":
            raise DataError(f"lines is 'auto' or a list of frequencies in Hz, got {lines!r}")
        return "auto"
    values = _numbers(() if lines is None else lines, "lines", "frequencies in Hz")
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise UnitError(f"a line has {value} Hz; its frequency must be positive and finite")
    if len(set(values)) < len(values):
        raise DataError(f"lines names a frequency twice: {list(values)}")
    return values


def _checked_waves(waves: Any) -> int | tuple[float, ...]:
    if isinstance(waves, int | np.integer) and not isinstance(waves, bool):
        if not 1 <= waves <= _MAX_WAVES:
            raise DataError(f"following_waves is 1 to {_MAX_WAVES} wavelengths, got {waves}")
        return int(waves)
    values = _numbers(waves, "following_waves", "wavelengths in m, or their number")
    if not 1 <= len(values) <= _MAX_WAVES:
        raise DataError(f"following_waves is 1 to {_MAX_WAVES} wavelengths, got {len(values)}")
    for value in values:
        if not (math.isfinite(value) and value > 0.0):
            raise UnitError(f"a wavelength of following_waves is {value} m; it must be positive")
    return values


def _numbers(values: Any, name: str, what: str) -> tuple[float, ...]:
    if isinstance(values, bool | np.bool_):
        raise DataError(f"{name} is a list of {what}, got {values!r}")
    items = [values] if isinstance(values, int | float | np.number) else values
    if isinstance(items, str | bytes):
        raise DataError(f"{name} is a list of {what}, got {values!r}")
    try:
        return tuple(float(v) for v in cast("Sequence[float]", items))
    except (TypeError, ValueError) as exc:
        raise DataError(f"{name} is a list of {what}, got {values!r}") from exc
