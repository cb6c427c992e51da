"""How an error is looked at to make a table of it: as functions, over positions, from a zero.

An error is never extrapolated, and never invented in a gap that was not measured.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, SupportsIndex

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.area_errors import (
    AreaFunction,
    ErrorMap,
    area_error,
    bilinear,
    column,
    ends_along,
    format_position,
    format_range,
    is_rotary,
    rising,
)
from metrosep.compensation.measured import at_reference, estimate_slope
from metrosep.compensation.polynomial import exact_correction
from metrosep.core._arrays import FloatArray, is_turn_apart
from metrosep.core.errors import DataError, TableError
from metrosep.core.profile import Profile
from metrosep.core.units import parse_quantity
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import PitchErrors
from metrosep.separation.runs.base import ErrorEstimate

Covariance = Callable[[FloatArray], FloatArray]
"""Covariance in m^2, shape (n, n), of what a table adds at positions in m, shape (n,)."""

_BLOCK = 256
"""Positions of which the covariance is looked at together: 30 000 entries have no square of their number."""


def variance(covariance: Covariance, p: FloatArray) -> FloatArray:
    """Return the variance at positions, shape (n,), m^2."""
    blocks = [p[i : i + _BLOCK] for i in range(0, p.size, _BLOCK)]
    found = [np.diag(covariance(block)) for block in blocks]
    return np.asarray(np.maximum(np.concatenate([np.empty(0), *found]), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class EntryCovariance:
    """Covariance of a table that was made of an estimate."""

    positions: FloatArray  # shape (n,), m: of the entries, rising
    of_error: Covariance  # of the error minus that at the reference

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, the ends held as the table holds them, (k, k), m^2."""
        nodes, weights = _looked_up(self.positions, p)
        return np.asarray(weights @ self.of_error(self.positions[nodes]) @ weights.T)


@dataclass(frozen=True, slots=True, eq=False)
class RestOfOld:
    """Covariance of what a new table, measured on top of an old one, leaves of the old one's errors."""

    old: Covariance
    entries: FloatArray  # shape (n,), m: positions of the new one

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, shape (k, k), m^2; exactly 0 at the entries."""
        nodes, weights = _looked_up(self.entries, p)
        rest = np.hstack([np.eye(p.size), -weights])
        out = rest @ self.old(np.concatenate([p, self.entries[nodes]])) @ rest.T
        at = np.isin(p, self.entries)
        out[at], out[:, at] = 0.0, 0.0
        return np.asarray(out)


@dataclass(frozen=True, slots=True, eq=False)
class JoinedCovariance:
    """Covariance of a new table on top of an old one, which were measured independently."""

    rest: RestOfOld
    new: Covariance

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, shape (n, n), m^2."""
        return np.asarray(self.new(p) + self.rest(p))


def _looked_up(positions: FloatArray, p: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return which entries a lookup at p takes, (m,), and their weights, (k, m); the ends are held."""
    at = np.clip(p, positions[0], positions[-1])
    right = np.clip(np.searchsorted(positions, at), 1, positions.size - 1)
    share = (at - positions[right - 1]) / (positions[right] - positions[right - 1])
    nodes, back = np.unique(np.concatenate([right - 1, right]), return_inverse=True)
    weights: FloatArray = np.zeros((at.size, nodes.size))
    rows = np.arange(at.size)
    weights[rows, back[: at.size]] = 1.0 - share
    weights[rows, back[at.size :]] += share
    return nodes, weights


ErrorFunction = Callable[[FloatArray], FloatArray]
ErrorSource = ErrorEstimate | PitchErrors | Profile | ErrorFunction
Direction = Literal["auto", "both", "split", "forward", "reverse"]

_DENSE = 20
"""Positions between two entries at which the interpolation error is looked for."""

_SHORT = 0.05
"""Share of an error that may be missed without a word."""

_MAX_ENTRIES = 100_000
"""More entries than any controller takes: the spacing was typed in the wrong unit."""

USUAL_ENTRIES = 100
"""About as many has a table whose spacing is suggested."""

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
    # shape (n,), m: standard uncertainty of the error at the entries minus that at the reference,
    # of the less certain direction
    u: FloatArray | None
    interpolation_error: float  # m: largest deviation of the linear interpolation between entries
    covariances: Mapping[
        int, Covariance
    ]  # of the table by direction, 1 and -1; empty where not known


def sample_error(
    error: ErrorSource,
    reverse: ErrorSource | None,
    *,
    direction: str,
    positions: ArrayLike | str | int | None,
    reference: float | None,
    axis: str = "X",
    on_axis: bool = False,
    reference_direction: str = "forward",
    heat: Expansion | None = None,
) -> SampledError:
    """Return an error as functions of position with its zero, checked for coverage."""
    forward, backward = _functions(error, reverse, direction, on_axis=on_axis)
    if heat is not None:
        forward = _cooled(forward, heat.slope)
        backward = None if backward is None else _cooled(backward, heat.slope)
    p = _positions(positions, error, axis, reference)
    for source in (error, reverse):
        if source is not None:
            _check_coverage(p, source, axis)
    if p.size == 0:
        raise TableError("a table needs at least 2 positions, got 0")
    zero = _zero(p, reference, axis)
    columns = {1: forward, -1: forward if backward is None else backward}
    offset = at_reference(lambda x, d: columns[d](x), zero, reference_direction)
    ahead = _held(_minus(forward, offset), p, error)
    back = None
    if backward is not None:
        back = _held(_minus(backward, offset), p, error if reverse is None else reverse)
    u, covariances = _uncertainty(error, reverse, direction, p, zero, on_axis=on_axis, heat=heat)
    return SampledError(
        positions=p,
        forward=ahead,
        reverse=back,
        reference=zero,
        offset=offset,
        u=u,
        interpolation_error=_interpolation_error([ahead, back], p),
        covariances=covariances,
    )


def _function(
    error: ErrorSource, direction: int | None, *, on_axis: bool = False
) -> ErrorFunction:
    if isinstance(error, ErrorEstimate):
        # e(x) = evaluate(x) + slope (x - x_m), x_m the middle of the evaluation range
        slope = estimate_slope(error, direction) if on_axis else 0.0
        middle = 0.5 * (error.start + error.stop)
        return lambda x: error.evaluate(x, direction=direction) + slope * (x - middle)
    if isinstance(error, Profile):
        error.require_metres()
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
    if isinstance(error, PitchErrors):
        return _columns(error, direction)
    if direction == "split" and not has_both:
        raise DataError(
            "direction='split' needs runs in both directions; this error has one direction: use "
            "direction='both'"
        ).hinting(direction="both")
    if isinstance(error, ErrorEstimate) and _is_split(error, direction):
        return function(error, 1), _minus(function(error, -1), -significant_lost_motion(error))
    sign = {"forward": 1, "reverse": -1}.get(direction)
    if sign is not None and isinstance(error, ErrorEstimate) and sign not in error.directions:
        raise DataError(
            f"direction={direction!r}, but the estimate has no {direction} runs; use direction='both'"
        ).hinting(direction="both")
    return function(error, sign), None


def _columns(error: PitchErrors, direction: str) -> tuple[ErrorFunction, ErrorFunction | None]:
    """Return the errors of a list of targets: two columns where the lost motion is significant."""
    both = error.forward is not None and error.reverse is not None
    if direction == "split" or (direction == "auto" and both and error.has_lost_motion):
        return error.curve(1), error.curve(-1)
    only = 0 if both else 1 if error.forward is not None else -1
    return error.curve({"forward": 1, "reverse": -1}.get(direction, only)), None


def significant_lost_motion(error: ErrorSource) -> float:
    """Return the lost motion that goes into a split table."""
    if isinstance(error, PitchErrors):
        return error.lost_motion if error.lost_motion and error.has_lost_motion else 0.0
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


def _cooled(error: ErrorFunction, slope: float) -> ErrorFunction:
    """Return an error without the slope that thermal expansion explains; its zero is taken off later."""
    return lambda x: error(x) - slope * np.asarray(x)


def _minus(error: ErrorFunction, offset: float) -> ErrorFunction:
    return lambda x: error(x) - offset


def _held(error: ErrorFunction, p: FloatArray, source: ErrorSource) -> ErrorFunction:
    """Hold the end values where the lookup p + c leaves what is known; a closed turn goes on."""
    if isinstance(source, PitchErrors) and source.is_closed:
        return error
    known = _known(source)
    low, high = known or (float(p[0]), float(p[-1]))
    return lambda x: error(np.clip(x, min(low, p[0]), max(high, p[-1])))


def _range(error: ErrorSource) -> tuple[float, float] | None:
    if isinstance(error, ErrorEstimate):
        return error.start, error.stop
    return _known(error)


def _known(error: ErrorSource) -> tuple[float, float] | None:
    if isinstance(error, ErrorEstimate):
        return error.fit_range
    if isinstance(error, PitchErrors):
        return float(error.positions[0]), float(error.positions[-1])
    if isinstance(error, Profile):
        error.require_metres()
        valid = error.x[~np.isnan(error.z)]
        return float(valid[0]), float(valid[-1])
    return None


def _positions(
    positions: ArrayLike | str | int | None, error: ErrorSource, axis: str, zero: float | None
) -> FloatArray:
    if positions is None:
        if isinstance(error, PitchErrors):
            return error.positions
        raise TableError("state the positions of the entries, or their spacing such as '1 mm'")
    if isinstance(positions, str):
        return _multiples(positions, _require_range(error), axis, zero)
    if isinstance(positions, SupportsIndex) and np.ndim(positions) == 0:
        return np.linspace(*_require_range(error), max(operator.index(positions), 0))
    return column(positions, "positions")


def _require_range(error: ErrorSource) -> tuple[float, float]:
    span = _range(error)
    if span is None:
        raise TableError("for a function state the positions themselves: its range is not known")
    return span


def _multiples(
    text: str, span: tuple[float, float], axis: str, zero: float | None = None
) -> FloatArray:
    """Return the multiples of a spacing in a range, counted from a place of zero correction within it.

    One turn stays one turn: its ends are one place, which a control rolls over.
    """
    if is_rotary(axis) and is_turn_apart(*span):
        zero = None
    zero = 0.0 if zero is None or not span[0] <= zero <= span[1] else zero
    low, high = span[0] - zero, span[1] - zero
    kind = "angle" if is_rotary(axis) else "length"
    spacing = parse_quantity(text, dimension=kind, name=f"spacing of {axis}")
    covered = f"{format_position(axis, span[0])} ... {format_position(axis, span[1])}"
    if not 0.0 < spacing <= high - low:
        raise TableError(
            f"spacing {text!r} must be positive and at most the measured range {covered}"
        ).hinting(spacing=rounded_spacing((high - low) / USUAL_ENTRIES, axis))
    first, last = math.ceil(low / spacing - _SAME), math.floor(high / spacing + _SAME)
    if last - first > _MAX_ENTRIES:
        raise TableError(
            f"spacing {text!r} gives {last - first + 1} entries over {covered}; at most {_MAX_ENTRIES} "
            "make sense: check the unit"
        ).hinting(spacing=rounded_spacing((high - low) / USUAL_ENTRIES, axis))
    if last - first < 1:
        raise TableError(
            f"no two multiples of {text!r} lie in {covered}; use a finer spacing"
        ).hinting(spacing=rounded_spacing((high - low) / USUAL_ENTRIES, axis))
    return np.clip(zero + np.arange(first, last + 1) * spacing, *span)


def spaced_with_zero(error: ErrorSource, text: str, axis: str, zero: float) -> FloatArray:
    """Return the multiples of a spacing in the range of an error, and a place of zero correction among them."""
    span = _require_range(error)
    found = _multiples(text, span, axis)
    near = _SAME * (span[1] - span[0])
    if not span[0] <= zero <= span[1]:
        return found
    return np.sort(np.append(found[np.abs(found - zero) > near], zero))


def beyond_entries(error: ErrorSource, sampled: SampledError, axis: str) -> str:
    """Return how much of a known error the entries do not reach, where it is a twentieth of it or more."""
    span, p = _range(error), sampled.positions
    if span is None or not p.size:
        return ""
    left = [np.linspace(span[0], p[0], 65), np.linspace(p[-1], span[1], 65)]
    columns = [f for f in (sampled.forward, sampled.reverse) if f is not None]
    missed = max(
        float(np.abs(f(x) - f(x[[at]])).max())
        for f in columns
        for x, at in zip(left, (-1, 0), strict=True)
    )
    whole = max(float(np.ptp(f(np.linspace(*span, 257)))) for f in columns)
    spans = (ends_along(axis, *ends) for ends in (p[[0, -1]].tolist(), span))
    return _short_of(missed, whole, *spans)


def _short_of(missed: float, whole: float, reached: str, known: str) -> str:
    """Return what stays of an error beyond the entries, as a sentence; nothing where it is little."""
    if not missed >= _SHORT * whole or missed == 0.0:
        return ""
    return (
        f"the entries reach over {reached}, the error is known over {known}: beyond the entries up to "
        f"{missed / whole:.0%} of it stays; use a finer spacing"
    )


def _beyond_nodes(error: AreaFunction, sampled: SampledArea, axes: tuple[str, str]) -> str:
    """Return the same of a map: what its nodes do not reach of an error that was measured."""
    if not isinstance(error, ErrorMap):
        return ""
    nodes = (sampled.x, sampled.y)
    held_x, held_y = (
        np.clip(k, p[0], p[-1]) for k, p in zip((error.x, error.y), nodes, strict=True)
    )
    row, column_ = np.nonzero((held_x != error.x) | (held_y != error.y)[:, None])
    left = error.values[row, column_] - error(held_x[column_], held_y[row])
    left = np.abs(left[np.isfinite(left)])
    if not left.size:
        return ""
    spans = (
        " and ".join(
            format_range(a, *p[[0, -1]].tolist()) for a, p in zip(axes, grid, strict=True)
        )
        for grid in (nodes, (error.x, error.y))
    )
    return _short_of(
        float(left.max()), float(np.ptp(error.values[np.isfinite(error.values)])), *spans
    )


def rounded_spacing(size: float, axis: str = "X", *, up: bool = False) -> str:
    """Return 1, 2 or 5 with zeros, not above a spacing (with `up` not below), as text.

    Examples
    --------
    >>> rounded_spacing(0.45e-3), rounded_spacing(1.7e-5), rounded_spacing(0.45e-3, up=True)
    ('0.2 mm', '10 um', '0.5 mm')
    >>> rounded_spacing(0.02, "C")
    '1 deg'
    """
    micro = (math.degrees(size) if is_rotary(axis) else size) * 1e6
    round_ones = [digit * 10.0**power for power in range(-3, 9) for digit in (1, 2, 5)]
    fits = [
        r for r in round_ones if (r >= micro * (1 - _SAME) if up else r <= micro * (1 + _SAME))
    ]
    found = (fits or round_ones)[0 if up else -1]
    if is_rotary(axis):
        return f"{found / 1e6:g} deg"
    return f"{found / 1000:g} mm" if found >= 100 else f"{found:g} um"


def _inside(positions: FloatArray, known: tuple[float, float], axis: str) -> FloatArray:
    """Return positions, refused where they leave what was measured."""
    low, high = known
    margin = _SAME * (high - low)
    if positions[0] < low - margin or positions[-1] > high + margin:
        raise TableError(
            f"the positions {format_position(axis, float(positions[0]))} ... "
            f"{format_position(axis, float(positions[-1]))} leave the measured range "
            f"{format_position(axis, low)} ... {format_position(axis, high)}: an error is not "
            "extrapolated; narrow the positions or measure further"
        )
    return positions


def _zero(positions: FloatArray, wanted: float | None, axis: str) -> float:
    """Return the place of zero correction: as stated, or 0 where it is in range, else the first one."""
    low, high = float(positions[0]), float(positions[-1])
    if wanted is None:
        wanted = 0.0 if low <= 0.0 <= high else low
    if not math.isfinite(wanted):
        raise TableError(f"the reference of {axis} is {wanted}; give a position")
    nearest = float(positions[np.argmin(np.abs(positions - wanted))])
    if abs(nearest - wanted) <= _SAME * (high - low):
        return nearest
    if not low <= wanted <= high:
        raise TableError(
            f"the reference {format_position(axis, wanted)} lies outside "
            f"{format_position(axis, low)} ... {format_position(axis, high)}"
        )
    return float(wanted)


def _check_coverage(p: FloatArray, error: ErrorSource, axis: str) -> None:
    known = _known(error)
    if known is None or p.size == 0:
        return
    _inside(p, known, axis)
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


def _uncertainty(
    error: ErrorSource,
    reverse: ErrorSource | None,
    direction: str,
    p: FloatArray,
    zero: float,
    *,
    on_axis: bool,
    heat: Expansion | None,
) -> tuple[FloatArray | None, dict[int, Covariance]]:
    """Return u of the entries, of the less certain direction, and the covariance of each column, as known."""
    if isinstance(error, PitchErrors):
        return _u_of_list(error, direction, p), {}
    sources = [
        (e, d) for e, d in _sources(error, reverse, direction) if isinstance(e, ErrorEstimate)
    ]
    if len(sources) < 1 + (reverse is not None):
        return None, {}
    known, bands = sources[0][0].has_covariance, []
    found: dict[int, Covariance] = {}
    for way, (e, d) in zip((1, -1), sources, strict=False):
        # The zero is that of the first direction, whose errors are independent of the other's.
        other = None if way == 1 else sources[0]
        slope = _u_slope(e, d, heat) if on_axis else 0.0
        bands.append(np.hypot(_u_from_zero(e, d, p, zero, other), (p - zero) * slope))
        known &= e.has_covariance and math.isfinite(slope)
        found[way] = EntryCovariance(p, _FromZero(e, d, zero, slope, other))
    band = np.max(bands, axis=0)
    return band if np.isfinite(band).all() else None, found if known else {}


def _sources(
    error: ErrorSource, reverse: ErrorSource | None, direction: str
) -> list[tuple[ErrorSource, int | None]]:
    """Return what each column of a table is made of: an error and its direction."""
    if reverse is not None:
        return [(error, 1), (reverse, -1)]
    if _is_split(error, direction):
        return [(error, 1), (error, -1)]
    return [(error, {"forward": 1, "reverse": -1}.get(direction))]


@dataclass(frozen=True, slots=True, eq=False)
class _FromZero:
    """Covariance of ``e(p) - e(zero)``; see `_u_from_zero`. A table that holds it can be saved."""

    estimate: ErrorEstimate
    direction: int | None
    zero: float  # m
    u_slope: float
    other: tuple[ErrorEstimate, int | None] | None

    def __call__(self, p: FloatArray) -> FloatArray:
        """Return the covariance at positions, shape (n, n), m^2."""
        line = self.u_slope**2 * np.outer(p - self.zero, p - self.zero)
        if self.other is not None:
            of_zero = float(self.other[0].sd([self.zero], direction=self.other[1])[0])
            return self.estimate.covariance(p, direction=self.direction) + of_zero**2 + line
        whole = self.estimate.covariance(np.append(p, self.zero), direction=self.direction)
        out = whole[:-1, :-1] - whole[:-1, -1:] - whole[-1:, :-1] + whole[-1, -1] + line
        at = p == self.zero  # exactly zero there, where rounding leaves 1e-33
        out[at], out[:, at] = 0.0, 0.0
        return np.asarray(out)


def _u_from_zero(
    estimate: ErrorEstimate,
    direction: int | None,
    p: FloatArray,
    zero: float,
    other: tuple[ErrorEstimate, int | None] | None,
) -> FloatArray:
    """Return the uncertainty of ``e(p) - e(zero)``, the zero taken from another source if there is one."""
    if not estimate.has_covariance:
        return estimate.sd(p, direction=direction)
    if other is not None:
        of_zero = float(other[0].sd([zero], direction=other[1])[0])
        return np.hypot(estimate.sd(p, direction=direction), of_zero)
    return estimate.u_of_difference(p, zero, direction=direction)


def _u_slope(estimate: ErrorEstimate, direction: int | None, heat: Expansion | None) -> float:
    """Return the standard uncertainty of the slope: scatter of the runs, and the temperature of all."""
    u = estimate.slope_of(direction).u
    if u is None:
        return math.nan
    return math.hypot(u, 0.0 if heat is None else heat.u_slope or 0.0)


def _u_of_list(error: PitchErrors, direction: str, p: FloatArray) -> FloatArray | None:
    """Return the standard uncertainty of a list's errors, of the less certain direction."""
    way = {"forward": 1, "reverse": -1}.get(direction, 0)
    u = error.u(way)
    return None if u is None or not np.isfinite(u).all() else np.interp(p, error.positions, u)


def _interpolation_error(errors: list[ErrorFunction | None], p: FloatArray) -> float:
    worst = 0.0
    fraction = np.linspace(0.0, 1.0, _DENSE + 1)
    dense = np.unique((p[:-1, None] + np.diff(p)[:, None] * fraction).ravel())
    for error in errors:
        if error is not None and dense.size:
            rest = error(dense) - np.interp(dense, p, error(p))
            worst = max(worst, float(np.abs(rest).max()))
    return worst


# ---- an error over two axes: on a grid, from a zero, with no gap ----------------------------------
# Rows are the second axis and columns the first, ``values[y, x]``, as in `metrosep.core.surface.Surface`.

_MAP_DENSE = 8
"""Steps between two positions of a function at which the interpolation error is looked for."""

_MAX_DENSE = 250_000
"""Places at which a function is looked at for it, at most; at least the middles are."""


@dataclass(frozen=True, slots=True, eq=False)
class SampledArea:
    """An error over two axes made ready for a map."""

    x: FloatArray  # shapes (n,) and (m,), m or rad: positions of columns and rows
    y: FloatArray
    values: FloatArray  # shape (m, n), m: error at the nodes, zero at the reference
    error: AreaFunction  # the same between the nodes, held constant outside of where it is known
    reference: tuple[float, float]  # of (float, float), m or rad: place of zero correction
    offset: float  # m: what was subtracted to make it zero
    # m: largest deviation of the bilinear interpolation between the nodes from the error
    interpolation_error: float
    source: ErrorMap  # the error at and between the nodes, offset included
    missed: str = (
        ""  # how much of the error lies beyond nodes whose spacing was given, as a sentence
    )


def grid_positions(
    wanted: ArrayLike | str | int | None,
    error: AreaFunction,
    which: int,
    axis: str,
    zero: float | None = None,
) -> FloatArray:
    """Return the positions of a map along one axis, which is zero at a place."""
    known = (error.x, error.y)[which] if isinstance(error, ErrorMap) else None
    if wanted is not None and not isinstance(wanted, str) and np.ndim(wanted) > 0:
        positions = rising(wanted, axis)
        return (
            positions
            if known is None
            else _inside(positions, (float(known[0]), float(known[-1])), axis)
        )
    if known is None:
        raise TableError(
            f"for an error function state the positions of {axis} themselves: its range is not known"
        )
    if wanted is None:
        return known
    if isinstance(wanted, str):
        return rising(_multiples(wanted, (float(known[0]), float(known[-1])), axis, zero), axis)
    if isinstance(wanted, SupportsIndex):
        count = operator.index(wanted)
        if not 2 <= count <= _MAX_ENTRIES:
            raise TableError(f"{count} positions of {axis}: a map needs 2 to {_MAX_ENTRIES}")
        return rising(np.linspace(known[0], known[-1], count), axis)
    raise TableError(
        f"positions of {axis} are {wanted!r}; give an array in m, a spacing such as '5 mm', or a count"
    )


def sample_area(
    error: Any,
    x: ArrayLike | str | int | None,
    y: ArrayLike | str | int | None,
    *,
    axes: tuple[str, str],
    reference: tuple[float, float] | None,
) -> SampledArea:
    """Return an error at the nodes of a map with its zero, checked for coverage and gaps."""
    first, second = _pair(reference)
    function = area_error(error, x, y)
    given = (x, y)
    if isinstance(error, np.ndarray | list | tuple):
        given = (None, None)
    columns = grid_positions(given[0], function, 0, axes[0], first)
    rows = grid_positions(given[1], function, 1, axes[1], second)
    zero = (_zero(columns, first, axes[0]), _zero(rows, second, axes[1]))
    dense_x, dense_y = _dense(columns, rows, function)
    looked = np.asarray(function(*np.meshgrid(dense_x, dense_y)), dtype=np.float64)
    _refuse_gaps(looked, dense_x, dense_y, axes)
    at_x, at_y = np.searchsorted(dense_x, columns), np.searchsorted(dense_y, rows)
    nodes = looked[np.ix_(at_y, at_x)]
    between = bilinear(columns, rows, nodes, dense_x, dense_y[:, None])
    offset = float(bilinear(columns, rows, nodes, *zero)[0])

    def held(px: FloatArray, py: FloatArray) -> FloatArray:
        inside_x = np.clip(px, *_limits(columns, function, 0))
        inside_y = np.clip(py, *_limits(rows, function, 1))
        return function(inside_x, inside_y) - offset

    made = SampledArea(
        x=columns,
        y=rows,
        values=nodes - offset,
        error=held,
        reference=zero,
        offset=offset,
        interpolation_error=float(np.abs(looked - between).max()),
        source=ErrorMap(dense_x, dense_y, looked, tuple(getattr(error, "history", ()))),
    )
    if not any(isinstance(p, str) for p in given):
        return made
    return replace(made, missed=_beyond_nodes(function, made, axes))


def inverse_along(error: AreaFunction, x: FloatArray, y: FloatArray, along: int) -> FloatArray:
    """Return c with ``c(p) = -e(p + c(p))`` along one axis of a map.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.array([0.0, 1.0])
    >>> inverse_along(lambda x, y: 0.25 * x + 0 * y, grid, grid, 0).round(12).tolist()
    [[0.0, -0.2], [0.0, -0.2]]
    """
    first, second = (x, y) if along == 0 else (y, x)
    lines = [exact_correction(partial(_line, error, along, float(at)), first) for at in second]
    grid = np.array(lines) + 0.0  # no -0.0
    return grid if along == 0 else grid.T.copy()


def _line(error: AreaFunction, along: int, at: float, p: FloatArray) -> FloatArray:
    """Return the error along one axis while the other stands."""
    other = np.full(p.shape, at)
    return error(p, other) if along == 0 else error(other, p)


def _limits(positions: FloatArray, error: AreaFunction, which: int) -> tuple[float, float]:
    """Return where the error is known, at least over the map: beyond it is held, not invented."""
    low, high = float(positions[0]), float(positions[-1])
    if not isinstance(error, ErrorMap):
        return low, high
    known = (error.x, error.y)[which]
    return min(low, float(known[0])), max(high, float(known[-1]))


def _dense(x: FloatArray, y: FloatArray, error: AreaFunction) -> tuple[FloatArray, FloatArray]:
    """Return positions at and between the nodes at which the interpolation error shows.

    The difference of two bilinear maps is largest at a node of one of them, so of a measured error
    its own positions suffice and the result is exact.
    """
    if isinstance(error, ErrorMap):
        return _merged(x, error.x), _merged(y, error.y)
    steps = math.isqrt(_MAX_DENSE // (x.size * y.size))
    return _divided(x, min(max(steps, 2), _MAP_DENSE)), _divided(y, min(max(steps, 2), _MAP_DENSE))


def _merged(positions: FloatArray, known: FloatArray) -> FloatArray:
    inside = known[(known > positions[0]) & (known < positions[-1])]
    return np.asarray(np.union1d(positions, inside), dtype=np.float64)


def _divided(positions: FloatArray, steps: int) -> FloatArray:
    fraction = np.arange(steps) / steps
    inner = positions[:-1, None] + np.diff(positions)[:, None] * fraction
    return np.append(inner.ravel(), positions[-1])


def _refuse_gaps(values: FloatArray, x: FloatArray, y: FloatArray, axes: tuple[str, str]) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column_ = (int(i) for i in bad[0])
        raise TableError(
            f"the error is not known at {format_position(axes[0], float(x[column_]))}, "
            f"{format_position(axes[1], float(y[row]))} ({len(bad)} of {values.size} places looked "
            "at): an error is not invented; narrow the map to what was measured, or measure there"
        )


def _pair(reference: Any) -> tuple[float | None, float | None]:
    if reference is None:
        return None, None
    try:
        first, second = (float(r) for r in reference)
    except (TypeError, ValueError):
        raise TableError(
            f"the reference is a position of each axis, such as (0.0, 0.0); got {reference!r}"
        ) from None
    return first, second
