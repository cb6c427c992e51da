"""The dry-run of a map: what its corrections make of a measured error over two axes.

The corrections are applied as the controller applies them: looked up at the command, bilinear,
added to the command. A measured map has no absolute zero, so its mean is taken off the MEASUREMENT;
its plane, too, where its alignment is not known. Off the map of corrections nothing is taken but its
mean, and what it adds at its reference counts as error: a map may not move the zero of the machine.
What was not measured is not compared, and counted. The statistic is that of tables: the map that made
the corrections is a stated error, with u = 0; a second one is one run over an area.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from metrosep.compensation._acceptance import (
    ROUNDING,
    Judged,
    Judgement,
    Reason,
    Stack,
    graded,
    judge,
    pv_with_zero,
)
from metrosep.compensation.area_errors import (
    AreaFunction,
    ErrorMap,
    area_error,
    format_position,
    format_range,
)
from metrosep.compensation.limits import Finding
from metrosep.compensation.measured import source_hashes
from metrosep.compensation.verification import judgement_dict, numbers_text
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TableError
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.separation.runs.design import COVERED

MapCorrection = Callable[[FloatArray, FloatArray], FloatArray]
MapRemoved = Literal["offset", "plane"]
MapKind = Literal["stated", "made", "map"]
Span = tuple[float, float]

_GRID_POINTS = 201
"""Places along each axis at which an error function is compared."""

_PLANE_POINTS = 4
"""A plane takes three; with no more than that nothing of the error is left."""

_UNCHANGED = 1e-9
"""Change of the RMS, over it, that is rounding."""

_UNKNOWN = {"offset": "one constant", "plane": "one constant and the plane (alignment)"}
_AGAINST = {
    "stated": "judged against the stated error",
    "made": "judged against the map that made it",
    "map": "judged against a second map",
}
_ONLY = {
    "stated": Finding.warning(
        "stated, not measured: the bytes are right if the error that was stated is",
        "verify against a measured map",
        "single",
    ),
    "made": Finding.warning(
        "one map: what repeats is not known",
        "verify against a second map",
        "single",
    ),
}


@dataclass(frozen=True, slots=True)
class MapVerification(Judged):
    """Result of the dry-run of a map.

    Parameters
    ----------
    before_pv, after_pv, wrong_sign_pv : float, m
        P-V without, with, and with the negated corrections.
    before_rms, after_rms, wrong_sign_rms : float, m
        The same as RMS about the mean, or about the plane.
    removed : {"offset", "plane"}
        What the measurement cannot know and was taken off it.
    axes : tuple of (str, str)
        Axes whose positions are looked up.
    span : tuple of two tuples of float, m or rad
        Ranges of the two axes that were compared.
    n_compared, n_not_measured : int
        Places with and without an error.
    coverage : float, dimensionless, 0 to 1
        Area that was compared over the area of the map; places without an error lower it.
    judgement : Judgement
        Improvement, gain, rest and P-V.
    zero : float, m
        Correction at the reference.
    kind : {"stated", "made", "map"}
        What it was judged against: an error that somebody states, the map that made it, or a second
        map.
    spacing : float, dimensionless, 0 to 1
        Share of the area that a row or column of what was measured has, their mean; less than that
        without an error gives no warning.
    is_reversed : bool
        Whether the sign is wrong: the negated map would be accepted, with at most half of the RMS left.
    """

    before_pv: float
    after_pv: float
    wrong_sign_pv: float
    before_rms: float
    after_rms: float
    wrong_sign_rms: float
    removed: MapRemoved
    axes: tuple[str, str]
    span: tuple[Span, Span]
    n_compared: int
    n_not_measured: int
    coverage: float
    judgement: Judgement
    zero: float = 0.0
    kind: MapKind = "map"
    spacing: float = 0.0
    is_reversed: bool = False

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why the map is not accepted; empty if it is."""
        return (*self.judgement.reasons, *_uncovered(self.coverage))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What one map cannot show, and what it did not measure."""
        found = [_ONLY[self.kind]] if self.kind in _ONLY else []
        if COVERED <= self.coverage < 1.0 - self.spacing * (1.0 + 1e-9):
            share = (
                f"{100.0 * (1.0 - self.coverage):.3g} % of the area of the map was not measured"
            )
            found.append(
                Finding.warning(f"{share}: the rest is not proven", "measure it", "coverage")
            )
        return tuple(found)

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person should read: what was judged on what, the numbers, the grade and why."""
        where = ", ".join(
            format_range(a, low, high) for a, (low, high) in zip(self.axes, self.span, strict=True)
        )
        return (
            f"{_AGAINST[self.kind]}, {where}; off the readings: {_UNKNOWN[self.removed]}",
            numbers_text(self.judgement),
            self._graded_text(),
        )

    def to_dict(self) -> dict[str, Any]:
        return {
            **self._verdict(),
            "sentences": list(self.sentences),
            **judgement_dict(self.judgement),
            "zero_m": self.zero,
            "removed": self.removed,
            "against_kind": self.kind,
            "axes": list(self.axes),
            "span_si": [list(s) for s in self.span],
            "definition": (
                "error plus correction, as the controller would apply the map (bilinear between "
                "entries, constant outside); the mean, or the plane, is taken off the measurement only"
            ),
            "before_pv_m": self.before_pv,
            "after_pv_m": self.after_pv,
            "wrong_sign_pv_m": self.wrong_sign_pv,
            "before_rms_m": self.before_rms,
            "after_rms_m": self.after_rms,
            "wrong_sign_rms_m": self.wrong_sign_rms,
            "n_compared": self.n_compared,
            "n_not_measured": self.n_not_measured,
            "coverage": self.coverage,
        }

    def _refusal(self, grade: str, left: list[Reason]) -> str:
        if grade == "refused" and all(r.check != "dry-run" for r in left):
            text, checks = "; ".join(r.text for r in left), ", ".join(r.check for r in left)
            return (
                f"refused: {text}; nothing was written (to write it all the same, say "
                f"waive={checks!r})"
            )
        text = "; ".join(r.text for r in left if r.grade == grade)
        if grade == "inconclusive":
            return (
                f"inconclusive: {text}; nothing was written (to write it all the same, say "
                "waive='inconclusive')"
            )
        if self.is_reversed:
            hint = "the reversed sign would shrink it: the sign of the measurement or of the map is wrong"
        elif self.after_rms < self.before_rms:
            hint = (
                "the RMS shrinks and the P-V does not: somewhere the map adds what is not there; "
                "look for an outlier or a spacing that is too coarse"
            )
        elif max(abs(v - self.before_rms) for v in (self.after_rms, self.wrong_sign_rms)) <= (
            _UNCHANGED * self.before_rms
        ):
            hint = "the map changes nothing there: all its corrections are zero or equal"
        elif self.zero != 0.0 and abs(self.zero) > self.before_rms:
            hint = f"it moves the zero of the machine by {format_length(self.zero)}"
        else:
            hint = (
                "neither sign shrinks it: rows and columns are exchanged or mirrored, or the map "
                "belongs to another place or state"
            )
        waive = "" if grade == "refused" else " (to write it all the same, say waive='pointless')"
        return (
            f"{grade} by the dry-run, it does not shrink the error: {text}; P-V {format_length(self.before_pv)} -> "
            f"{format_length(self.after_pv)}, RMS {format_length(self.before_rms)} -> "
            f"{format_length(self.after_rms)}, with the reversed sign P-V "
            f"{format_length(self.wrong_sign_pv)}, RMS {format_length(self.wrong_sign_rms)}; {hint}; "
            f"nothing was written{waive}"
        )


def dry_run_map(
    correction: MapCorrection,
    against: Any,
    *,
    span: tuple[Span, Span],
    axes: tuple[str, str],
    compensates: str,
    removed: MapRemoved = "offset",
    reference: tuple[float, float] | None = None,
    kind: MapKind | None = None,
) -> MapVerification:
    """Apply the corrections of a map to a measured error as a controller would.

    Parameters
    ----------
    correction : callable
        ``(x, y) -> correction`` in m, the controller's lookup.
    against : Surface, ErrorMap or callable e(x, y), m
        Measured error e = actual - nominal; a function is known over `span`.
    span : tuple of two tuples of float, m or rad
        Ranges of the map; narrowed to what was measured.
    axes : tuple of (str, str)
        Axes whose positions are looked up.
    compensates : str
        Axis that is corrected. If it is one of `axes`, the error is taken where the axis then is.
    removed : {"offset", "plane"}, optional
        What the measurement cannot know, and is taken off it.
    reference : tuple of (float, float), m or rad, optional
        Where the correction must be zero; not judged if omitted.
    kind : {"stated", "made", "map"}, optional
        A function is a stated error, a measured one a second map, if omitted; "made" is the map that
        made the corrections.

    Returns
    -------
    MapVerification
        Grade and gain; before, after and with the sign reversed.

    Raises
    ------
    TableError
        If map and measurement do not overlap.
    DataError
        If nothing was measured there, or `against` is something else.

    Notes
    -----
    A measured error is compared at its own places, a function at 201 x 201. NaN is compared
    nowhere; places with NaN are counted. The uncertainty of one map comes from what correlates in it
    beside the corrections, over a quarter of its rows and columns.

    Examples
    --------
    >>> import numpy as np
    >>> result = dry_run_map(lambda x, y: -x * y, lambda x, y: 2 * x * y, span=((0, 1), (0, 1)),
    ...                      axes=("X", "Y"), compensates="Z")
    >>> round(result.after_rms / result.before_rms, 6), result.passed
    (0.5, True)
    """
    error = area_error(against)
    first, last = _overlap(span, error, axes)
    px, py = _places(error, first, last)
    x, y = np.meshgrid(px, py)
    c = np.asarray(correction(x, y), dtype=np.float64)
    held = _held(error, first, last)
    e, shifted, flipped = (_at(held, x, y, sign * c, axes, compensates) for sign in (0, 1, -1))
    valid = np.isfinite(e) & np.isfinite(shifted) & np.isfinite(flipped)
    n = int(valid.sum())
    if n < _PLANE_POINTS:
        raise DataError(
            f"the error was measured at {n} of {e.size} places inside the map: nothing to dry-run it "
            "against"
        )
    grid = (x[valid], y[valid])
    off = _unknown(e[valid], grid, removed)
    applied = c[valid] - c[valid].mean()
    zero = 0.0
    if reference is not None:
        zero = float(np.asarray(correction(*(np.array([[p]]) for p in reference))).item())
        zero = 0.0 if abs(zero) < ROUNDING else zero
    before = e[valid] - off
    after, wrong = shifted[valid] - off + applied, flipped[valid] - off - applied
    how = kind or ("map" if isinstance(error, ErrorMap) else "stated")
    stack = Stack(
        grid[0], np.ones(n), before[None], after[None], wrong[None], applied[None], zero,
        np.zeros(1), ("map",),
        has_slope=False,
        is_stated=how != "map",
        nodes=valid,
        level=lambda values: values - _unknown(values, grid, removed),
    )  # fmt: skip
    result = judge(stack)
    whole = [high - low for low, high in span]
    reach = (first[1] - first[0]) * (last[1] - last[0]) / (whole[0] * whole[1])
    coverage = n / e.size * reach
    is_reversed = False
    if result.is_reversed:
        other = judge(stack.negated())
        both = (*other.reasons, *_uncovered(coverage))
        is_reversed = graded(both) == "accepted" and other.rest <= 0.5
    return MapVerification(
        before_pv=float(np.ptp(before)),
        after_pv=pv_with_zero(after, zero),
        wrong_sign_pv=pv_with_zero(wrong, -zero),
        before_rms=float(np.sqrt(np.mean(before**2))),
        after_rms=float(np.sqrt(np.mean(after**2) + zero**2)),
        wrong_sign_rms=float(np.sqrt(np.mean(wrong**2) + zero**2)),
        removed=removed,
        axes=axes,
        span=(first, last),
        n_compared=n,
        n_not_measured=int(e.size - n),
        coverage=coverage,
        judgement=result,
        zero=zero,
        kind=how,
        spacing=0.5 / px.size + 0.5 / py.size,
        is_reversed=is_reversed,
    )


def judged_map(
    carried: Any, against: Any, *, applied: MapCorrection | None = None, free_zero: bool = False
) -> MapVerification:
    """Return the dry-run of a map, by what its file adds if `applied`: the one way of every call."""
    kind: MapKind | None = None
    if against is carried.source:
        kind = "made"
    elif isinstance(against, Surface | ErrorMap):
        hashes = set(source_hashes(against.history))
        kind = "made" if hashes and hashes <= set(carried.source_sha256) else "map"
    return dry_run_map(
        applied or carried.correction,
        against,
        span=carried.inner_span,
        axes=carried.axes,
        compensates=carried.compensates,
        removed=carried.removed,
        reference=None if free_zero else carried.reference,
        kind=kind,
    )


def _uncovered(coverage: float) -> list[Reason]:
    """Return 1.9 by area: a map that was measured in part."""
    if coverage >= COVERED:
        return []
    text = (
        f"the measurement covers {100.0 * coverage:.3g} % of the area of the map: measure the whole "
        "map, or make it smaller"
    )
    return [Reason("refused", "coverage", text)]


def _overlap(
    span: tuple[Span, Span], error: AreaFunction, axes: tuple[str, str]
) -> tuple[Span, Span]:
    """Return the ranges of the two axes that the map and the measurement share."""
    if not isinstance(error, ErrorMap):
        return span
    common: list[Span] = []
    for (low, high), known, axis in zip(span, (error.x, error.y), axes, strict=True):
        start, stop = max(low, float(known[0])), min(high, float(known[-1]))
        if not stop > start:
            raise TableError(
                f"the map covers {format_position(axis, low)} ... {format_position(axis, high)}, the "
                f"measurement {format_position(axis, float(known[0]))} ... "
                f"{format_position(axis, float(known[-1]))}: they do not overlap; check the units "
                "and the origin of the positions"
            )
        common.append((start, stop))
    return common[0], common[1]


def _places(error: AreaFunction, first: Span, last: Span) -> tuple[FloatArray, FloatArray]:
    if not isinstance(error, ErrorMap):
        return np.linspace(*first, _GRID_POINTS), np.linspace(*last, _GRID_POINTS)
    x = error.x[(error.x >= first[0]) & (error.x <= first[1])]
    y = error.y[(error.y >= last[0]) & (error.y <= last[1])]
    return x, y


def _held(error: AreaFunction, first: Span, last: Span) -> AreaFunction:
    """Hold the values at the ends of a function, which is not known beyond them."""
    if isinstance(error, ErrorMap):
        return error
    return lambda x, y: error(np.clip(x, *first), np.clip(y, *last))


def _at(
    error: AreaFunction,
    x: FloatArray,
    y: FloatArray,
    moved: FloatArray,
    axes: tuple[str, str],
    compensates: str,
) -> FloatArray:
    """Return the error where the axes are once the corrected one has moved."""
    px = x + moved if compensates == axes[0] else x
    py = y + moved if compensates == axes[1] else y
    return np.asarray(error(px, py), dtype=np.float64)


def _unknown(
    values: FloatArray, grid: tuple[FloatArray, FloatArray], removed: MapRemoved
) -> FloatArray:
    """Return P_N of a measured error: its mean, or its plane."""
    mean = np.full_like(values, values.mean())
    if removed == "offset":
        return mean
    columns = [p - p.mean() for p in grid]
    matrix = np.stack([p / (np.ptp(p) or 1.0) for p in columns], axis=-1)
    tilt, *_ = np.linalg.lstsq(matrix, values - mean, rcond=None)
    return np.asarray(mean + matrix @ tilt)
