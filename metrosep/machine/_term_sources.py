"""Private helper: what other parts of metrosep return, read as an error: sign, direction, unit.

All by what an object has, not by its class: separation and machine do not import one another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, UnitError
from metrosep.machine._mesh import is_angle, real_array

__all__ = [
    "SourceTerm",
    "check_direction",
    "direction_message",
    "error_of",
    "refuse_length",
    "refuse_no_term",
    "series_of",
]

DIRECTIONS = {"mean": None, "forward": 1, "backward": -1, "reverse": -1}
_COLUMN = {1: "forward", -1: "reverse"}
_POINTS = 501  # at which a series and its estimate are compared
_NM, _MM = 1e-9, 1e-3


@dataclass(frozen=True, slots=True)
class SourceTerm:
    """Error of an object that itself gives a compensation, or one curve for each direction."""

    source: Any
    method: str = "evaluate"
    sign: float = 1.0
    direction: int | None = None
    offset: float = 0.0
    u_offset: float = 0.0

    def evaluate(self, x: ArrayLike) -> FloatArray:
        """Return the error at positions."""
        return self.sign * self._of(self.method, x) + self.offset

    def sd(self, x: ArrayLike) -> FloatArray:
        """Return its standard uncertainty at positions."""
        sd = self._of("sd", x)
        return sd if self.u_offset == 0.0 else np.hypot(sd, self.u_offset)

    def _of(self, method: str, x: ArrayLike) -> FloatArray:
        asked = real_array(x, "position of an error term")
        options = {} if self.direction is None else {"direction": self.direction}
        values = getattr(self.source, method)(np.atleast_1d(asked).ravel(), **options)
        return np.array(values, dtype=np.float64).reshape(asked.shape)


def error_of(value: Any, direction: str) -> Any:
    """Return an object with evaluate and sd as an error of one direction; itself where it is one."""
    way = check_direction(direction)
    quantity = getattr(value, "quantity", "error")
    if quantity == "compensation":
        if callable(getattr(value, "error", None)):
            return SourceTerm(value, method="error")
        return SourceTerm(value, sign=-1.0)
    if quantity != "error":
        raise DataError(
            f"{type(value).__name__} gives quantity = {quantity!r}; a term is an 'error' "
            "(actual - nominal), a 'compensation' is turned round"
        )
    there = _directions(value)
    if way is None or not there:
        return value
    if way not in there:
        raise DataError(
            f"direction = {direction!r}, but {type(value).__name__} comes from "
            f"{'backward' if way > 0 else 'forward'} runs only"
        )
    lost = _lost_motion(value) if way < 0 else None
    offset, u_offset = (0.0, 0.0) if lost is None else lost
    return SourceTerm(value, direction=way, offset=offset, u_offset=u_offset)


def check_direction(direction: Any) -> int | None:
    """Return 1, -1 or None for the mean."""
    if not isinstance(direction, str) or direction not in DIRECTIONS:
        raise DataError(f"direction is one of mean, forward, backward, got {direction!r}")
    return DIRECTIONS[direction]


def direction_message(name: str, value: Any, direction: str) -> str | None:
    """Return what to tell of a term that was estimated in two directions, None if nothing."""
    way = check_direction(direction)
    if set(_directions(value)) != {-1, 1}:
        return None
    lost = _lost_motion(value)
    if way is None:
        size = "not known" if lost is None else f"{lost[0] * 1e6:.4g} um"
        return (
            f"{name} is the mean of the forward and the backward runs; what differs between them "
            f"is not in it (lost motion {size}): direction = 'forward' or 'backward' takes one"
        )
    if way < 0 and lost is None:
        return (
            f"{name} is that of the backward runs about their own level: their lost motion is not "
            "known"
        )
    return None


def refuse_length(name: str, value: Any) -> None:
    """Refuse a curve in m as an angular term."""
    if not is_angle(name):
        return
    unit = None
    if callable(getattr(value, "peak_to_valley", None)):
        unit = getattr(value.peak_to_valley(), "unit", None)
    elif hasattr(value, "domain") and hasattr(value, "quantity"):
        unit = "m"  # polynomials of metrosep give a length over a length
    if unit == "m":
        raise UnitError(
            f"{type(value).__name__} is in m, and error term {name!r} is an angle in rad; if its "
            "readings were angles, give its method evaluate as a function"
        )


def refuse_no_term(value: Any) -> None:
    """Refuse what can be called, but gives no error over the position of one axis."""
    from metrosep.forms.base import Form

    if isinstance(value, type):
        raise DataError(
            f"an error term is an object, got the class {value.__name__}; write "
            f"{value.__name__}(...) with its values"
        )
    owner = getattr(value, "__self__", None)
    if getattr(owner, "quantity", "error") == "compensation" and value != getattr(
        owner, "error", None
    ):
        raise DataError(
            f"{value.__name__} of a {type(owner).__name__} gives the compensation, the negative of "
            "the error; give the object itself as the term"
        )
    if isinstance(value, Form):
        raise DataError(
            f"{type(value).__name__} is the form of a surface z(x, y), no error over the position "
            "of one axis; write a PolynomialTerm or a function of the position"
        )


def series_of(estimate: Any, direction: str, u: float | None) -> dict[str, Any]:
    """Return what a Fourier term needs from the spectrum of an estimate."""
    try:
        spectrum = estimate.spectrum
        start, stop = float(estimate.start), float(estimate.stop)
        columns = list(spectrum)
        chosen = np.array(spectrum["selected"], dtype=bool)
        table = {
            "amplitudes": np.array(spectrum["amplitude_nm"], dtype=np.float64) * _NM,
            "wavelengths": np.array(spectrum["wavelength_mm"], dtype=np.float64) * _MM,
            "phases": np.array(spectrum["phase_rad"], dtype=np.float64),
        }
    except (AttributeError, KeyError, TypeError) as exc:
        raise DataError(
            "a Fourier term is made of an estimate with spectrum, start and stop, as `separate` "
            f"returns it; got {type(estimate).__name__} ({exc})"
        ) from None
    way = check_direction(direction)
    term = error_of(estimate, direction)
    if "direction" in columns:
        names = np.array(spectrum["direction"], dtype=str)
        if way is None:
            table["amplitudes"] = table["amplitudes"] / np.unique(names).size
        else:
            chosen &= names == _COLUMN[way]
    if not chosen.any():
        raise DataError(
            "the estimate has no selected wavelength; take the estimate itself as the term "
            "(method 'mean' has no spectrum)"
        )
    parts = {name: tuple(values[chosen].tolist()) for name, values in table.items()}
    x = np.linspace(start, stop, _POINTS)
    turns = 2.0 * np.pi * np.divide.outer(x - start, parts["wavelengths"]) + parts["phases"]
    rest = np.asarray(term.evaluate(x)) - np.cos(turns) @ np.array(parts["amplitudes"])
    known = ~np.isnan(rest)
    mean = float(rest[known].mean()) if known.any() else 0.0
    if u is None:
        u = _left_out(x[known], rest[known], np.asarray(term.sd(x))[known])
    return {**parts, "mean": mean, "u": u, "origin": start}


def _left_out(x: FloatArray, rest: FloatArray, sd: FloatArray) -> float:
    """Return the RMS of the estimate's uncertainty and of what the series lacks beside a line."""
    sd = sd[~np.isnan(sd)]
    if not sd.size or x.size < 3:
        raise DataError("the estimate has no standard uncertainty; give u")
    along = np.linspace(-1.0, 1.0, x.size)
    rest = rest - np.polyval(np.polyfit(along, rest, 1), along)
    return float(np.sqrt(np.mean(sd**2) + np.mean(rest**2)))


def _directions(value: Any) -> tuple[int, ...]:
    """Return the directions of the runs, -1 and 1; empty where they were not told apart."""
    there = getattr(value, "directions", ())
    return tuple(d for d in there if d in (-1, 1)) if isinstance(there, tuple) else ()


def _lost_motion(value: Any) -> tuple[float, float] | None:
    """Return the offset of the backward runs against the forward ones, and its u.

    None where its uncertainty is not known (one run in a direction): that of single runs may as
    well be drift of the sensor. Compensation tables leave it out by the same rule.
    """
    lost = getattr(value, "lost_motion", None)
    if lost is None or lost.u is None or not math.isfinite(lost.value):
        return None
    return float(lost.value), float(lost.u)
