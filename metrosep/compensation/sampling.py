"""How an error is looked at to make a table of it: as functions, over positions, from a zero.

An error is never extrapolated, and never invented in a gap that was not measured.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.measured import estimate_slope
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.profile import Profile
from metrosep.core.units import format_length, parse_quantity
from metrosep.separation.runs.base import ErrorEstimate

__all__ = [
    "Direction",
    "ErrorFunction",
    "ErrorSource",
    "SampledError",
    "column",
    "sample_error",
    "significant_lost_motion",
]

ErrorFunction = Callable[[FloatArray], FloatArray]
ErrorSource = ErrorEstimate | Profile | ErrorFunction
Direction = Literal["auto", "both", "split", "forward", "reverse"]

_DENSE = 20
"""Positions between two entries at which the interpolation error is looked for."""

_MAX_ENTRIES = 100_000
"""More entries than any controller takes: the spacing was typed in the wrong unit."""

_SAME = 1e-9
"""Positions closer than this, relative to the span, are one (0.1 mm times 3 in binary)."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledError:
    """An error made ready for a table."""

    positions: FloatArray  # shape (n,), m: of the entries
    # error in m, zero at the reference, held constant outside of where it is known
    forward: ErrorFunction
    reverse: ErrorFunction | None  # the same of the other direction; None if there is one for both
    reference: float  # m: position of zero correction
    offset: float  # m: what was subtracted to make it zero
    # shape (n,), m: standard uncertainty of the error at the entries, of the less certain
    # direction
    u: FloatArray | None
    interpolation_error: float  # m: largest deviation of the linear interpolation between entries


def sample_error(
    error: ErrorSource,
    reverse: ErrorSource | None,
    *,
    direction: str,
    positions: ArrayLike | str | int,
    reference: float | None,
    on_axis: bool = False,
) -> SampledError:
    """Return an error as functions of position with its zero, checked for coverage."""
    forward, backward = _functions(error, reverse, direction, on_axis=on_axis)
    p = _positions(positions, error)
    for source in (error, reverse):
        if source is not None:
            _check_coverage(p, source)
    zero = _reference(p, reference)
    offset = float(forward(np.array([zero]))[0])
    ahead = _held(_minus(forward, offset), p, _known(error))
    back = None
    if backward is not None:
        back = _held(_minus(backward, offset), p, _known(error if reverse is None else reverse))
    return SampledError(
        positions=p,
        forward=ahead,
        reverse=back,
        reference=zero,
        offset=offset,
        u=_uncertainty(error, reverse, direction, p, zero, on_axis=on_axis),
        interpolation_error=_interpolation_error([ahead, back], p),
    )


def column(values: ArrayLike, name: str) -> FloatArray:
    """Return a read-only copy of a column of a table."""
    copied = np.array(values, dtype=np.float64)
    if copied.ndim != 1:
        raise TableError(f"{name} must be one-dimensional, got shape {copied.shape}")
    if not np.isfinite(copied).all():
        i = int(np.flatnonzero(~np.isfinite(copied))[0])
        raise TableError(
            f"{name}[{i}] is {copied[i]}: a table must be finite everywhere; narrow the positions to "
            "what was measured"
        )
    copied.setflags(write=False)
    return copied


def _function(
    error: ErrorSource, direction: int | None, *, on_axis: bool = False
) -> ErrorFunction:
    if isinstance(error, ErrorEstimate):
        # e(x) = evaluate(x) + slope (x - x_m), x_m the middle of the evaluation range
        slope = estimate_slope(error) if on_axis else 0.0
        middle = 0.5 * (error.start + error.stop)
        return lambda x: error.evaluate(x, direction=direction) + slope * (x - middle)
    if isinstance(error, Profile):
        valid = ~np.isnan(error.z)
        if not valid.any():
            raise DataError("the profile holds no valid sample: nothing to make a table of")
        return lambda x: np.interp(x, error.x[valid], error.z[valid])
    if callable(error):
        return lambda x: np.broadcast_to(np.asarray(error(x), dtype=np.float64), np.shape(x))
    raise DataError(
        f"the error is a {type(error).__name__}; pass an ErrorEstimate, a Profile or a function"
    )


def _functions(
    error: ErrorSource, reverse: ErrorSource | None, direction: str, *, on_axis: bool
) -> tuple[ErrorFunction, ErrorFunction | None]:

    def function(source: ErrorSource, which: int | None) -> ErrorFunction:
        return _function(source, which, on_axis=on_axis)

    if direction not in ("auto", "both", "split", "forward", "reverse"):
        raise DataError(f"direction={direction!r}; use auto, both, split, forward or reverse")
    if reverse is not None:
        if direction not in ("auto", "split"):
            raise DataError(f"direction={direction!r} contradicts reverse=; leave one of them out")
        return function(error, 1), function(reverse, -1)
    has_both = _is_split(error, "split")
    if direction == "split" and not has_both:
        raise DataError(
            "direction='split' needs runs in both directions (or reverse=); this error has one "
            "direction: use direction='both'"
        )
    if isinstance(error, ErrorEstimate) and _is_split(error, direction):
        return function(error, 1), _minus(function(error, -1), -significant_lost_motion(error))
    sign = {"forward": 1, "reverse": -1}.get(direction)
    if sign is not None and isinstance(error, ErrorEstimate) and sign not in error.directions:
        raise DataError(
            f"direction={direction!r}, but the estimate has no {direction} runs; use direction='both'"
        )
    return function(error, sign), None


def significant_lost_motion(error: ErrorSource) -> float:
    """Return the lost motion that goes into a split table."""
    lost = error.lost_motion if isinstance(error, ErrorEstimate) else None
    if lost is None or lost.u is None or abs(lost.value) <= 2.0 * lost.u:
        return 0.0
    return lost.value


def _is_split(error: ErrorSource, direction: str) -> bool:
    return (
        isinstance(error, ErrorEstimate)
        and error.directions == (-1, 1)
        and direction in ("auto", "split")
    )


def _minus(error: ErrorFunction, offset: float) -> ErrorFunction:
    return lambda x: error(x) - offset


def _held(error: ErrorFunction, p: FloatArray, known: tuple[float, float] | None) -> ErrorFunction:
    """Hold the end values where the lookup p + c leaves what is known."""
    low, high = known or (float(p[0]), float(p[-1]))
    return lambda x: error(np.clip(x, min(low, p[0]), max(high, p[-1])))


def _range(error: ErrorSource) -> tuple[float, float] | None:
    if isinstance(error, ErrorEstimate):
        return error.start, error.stop
    return _known(error)


def _known(error: ErrorSource) -> tuple[float, float] | None:
    if isinstance(error, ErrorEstimate):
        return error.fit_range
    if isinstance(error, Profile):
        valid = error.x[~np.isnan(error.z)]
        return float(valid[0]), float(valid[-1])
    return None


def _positions(positions: ArrayLike | str | int, error: ErrorSource) -> FloatArray:
    if isinstance(positions, str):
        return _multiples(positions, _require_range(error))
    if isinstance(positions, SupportsIndex) and np.ndim(positions) == 0:
        return np.linspace(*_require_range(error), max(operator.index(positions), 0))
    return column(positions, "positions")


def _require_range(error: ErrorSource) -> tuple[float, float]:
    span = _range(error)
    if span is None:
        raise TableError("for a function state the positions themselves: its range is not known")
    return span


def _multiples(text: str, span: tuple[float, float]) -> FloatArray:
    low, high = span
    spacing = parse_quantity(text, dimension="length", name="spacing")
    if not 0.0 < spacing <= high - low:
        raise TableError(
            f"spacing {text!r} must be positive and at most the range {format_length(high - low)}"
        )
    first, last = math.ceil(low / spacing - _SAME), math.floor(high / spacing + _SAME)
    if last - first > _MAX_ENTRIES:
        raise TableError(
            f"spacing {text!r} gives {last - first + 1} entries over {format_length(high - low)}; at most "
            f"{_MAX_ENTRIES} make sense: check the unit"
        )
    if last - first < 1:
        raise TableError(
            f"no two multiples of {text!r} lie in {format_length(low)} ... {format_length(high)}; "
            "use a finer spacing"
        )
    return np.clip(np.arange(first, last + 1) * spacing, low, high)


def _check_coverage(p: FloatArray, error: ErrorSource) -> None:
    known = _known(error)
    if known is None or p.size == 0:
        return
    low, high = known
    margin = _SAME * (high - low)
    if p[0] < low - margin or p[-1] > high + margin:
        raise TableError(
            f"the positions {format_length(float(p[0]))} ... {format_length(float(p[-1]))} leave the "
            f"measured range {format_length(low)} ... {format_length(high)}: an error is not "
            "extrapolated; narrow the positions or measure further"
        )
    if isinstance(error, Profile) and p.size > 1:
        _check_gaps(p, error)


def _check_gaps(p: FloatArray, profile: Profile) -> None:
    """Refuse a gap of samples that were not measured, wider than the entries are apart."""
    valid = np.flatnonzero(~np.isnan(profile.z))
    holes = np.flatnonzero(np.diff(valid) > 1)
    left, right = profile.x[valid[holes]], profile.x[valid[holes + 1]]
    wide = (right - left > np.diff(p).min()) & (right > p[0]) & (left < p[-1])
    if wide.any():
        i = int(np.flatnonzero(wide)[0])
        raise TableError(
            f"the profile was not measured between {left[i] * 1e3:.9g} and {right[i] * 1e3:.9g} mm, "
            "wider than the entries are apart: an error is not invented; narrow the positions, take "
            "a coarser spacing or measure there"
        )


def _reference(p: FloatArray, reference: float | None) -> float:
    if p.size == 0:
        raise TableError("a table needs at least 2 positions, got 0")
    wanted = reference
    if wanted is None:
        wanted = 0.0 if p[0] <= 0.0 <= p[-1] else float(p[0])
    nearest = float(p[np.argmin(np.abs(p - wanted))])
    if abs(nearest - wanted) <= _SAME * float(p[-1] - p[0]):
        return nearest
    if not p[0] <= wanted <= p[-1]:
        raise TableError(
            f"the reference {format_length(wanted)} lies outside the table "
            f"{format_length(float(p[0]))} ... {format_length(float(p[-1]))}"
        )
    return float(wanted)


def _uncertainty(
    error: ErrorSource,
    reverse: ErrorSource | None,
    direction: str,
    p: FloatArray,
    zero: float,
    *,
    on_axis: bool,
) -> FloatArray | None:
    sources: list[tuple[ErrorSource, int | None]]
    if reverse is not None:
        sources = [(error, 1), (reverse, -1)]
    elif _is_split(error, direction):
        sources = [(error, 1), (error, -1)]
    else:
        sources = [(error, {"forward": 1, "reverse": -1}.get(direction))]
    bands = [
        np.hypot(e.sd(p, direction=d), (p - zero) * (_u_slope(e) if on_axis else 0.0))
        for e, d in sources
        if isinstance(e, ErrorEstimate)
    ]
    if len(bands) < len(sources):
        return None
    band = np.max(bands, axis=0)
    return band if np.isfinite(band).all() else None


def _u_slope(estimate: ErrorEstimate) -> float:
    return math.nan if estimate.slope.u is None else estimate.slope.u


def _interpolation_error(errors: list[ErrorFunction | None], p: FloatArray) -> float:
    worst = 0.0
    fraction = np.linspace(0.0, 1.0, _DENSE + 1)
    dense = np.unique((p[:-1, None] + np.diff(p)[:, None] * fraction).ravel())
    for error in errors:
        if error is not None and dense.size:
            rest = error(dense) - np.interp(dense, p, error(p))
            worst = max(worst, float(np.abs(rest).max()))
    return worst
