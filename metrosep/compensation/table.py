"""`CompensationTable`: corrections at positions of an axis, with sign, reference and source.

Sign: the entries are the correction c = -e that is ADDED to the command (e = actual - nominal).
What a controller's file holds instead is the business of its dialect in `metrosep.controllers`.
Between entries the correction is linear, outside constant, as controllers do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.inverse import exact_correction
from metrosep.compensation.limits import Finding, Limits, check_limits
from metrosep.compensation.verify import Against, Removed, Verification, dry_run
from metrosep.core.errors import DataError, LimitError, TableError
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.units import format_length, parse_quantity
from metrosep.separation.base import ErrorEstimate

__all__ = ["CompensationTable"]

FloatArray = NDArray[np.float64]
ErrorFunction = Callable[[FloatArray], FloatArray]
Direction = Literal["auto", "both", "split", "forward", "reverse"]

_DENSE = 20
"""Positions between two entries at which the interpolation error is looked for."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CompensationTable:
    """Corrections along an axis; frozen, SI.

    Parameters
    ----------
    positions : array_like, shape (n,), m
        Commanded positions, finite, strictly rising, n >= 2.
    forward : array_like, shape (n,), m
        Correction to add when moving in + direction.
    reverse : array_like or None, shape (n,), m
        The same in - direction; None if it is the same.
    axis : str
        Axis whose position is looked up, such as ``"X"``.
    compensates : str
        Axis that is corrected; the same for positioning, another for straightness.
    reference : float, m
        Position at which the forward correction is zero.
    u : array_like or None, shape (n,), m
        Standard uncertainty of the entries.
    interpolation_error : float or None, m
        Largest deviation of the linear interpolation from the error it was made of.
    removed : {"offset", "line"}
        What the estimate behind the table has no opinion on.
    is_exact_inverse : bool
        Whether c(p) = -e(p + c(p)) was solved; for a cross-axis table the two are the same.
    offset_removed : float, m
        Amount subtracted to make the reference zero.
    source_sha256 : tuple of str
        Hashes of the files behind it.
    history : tuple of Step
        From the files on.

    Raises
    ------
    TableError
        If positions do not rise, lengths differ, or a value is not finite.
    """

    positions: FloatArray
    forward: FloatArray
    reverse: FloatArray | None
    axis: str
    compensates: str
    reference: float
    u: FloatArray | None = None
    interpolation_error: float | None = None
    removed: Removed = "offset"
    is_exact_inverse: bool = False
    offset_removed: float = 0.0
    source_sha256: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()

    def __post_init__(self) -> None:
        positions = _column(self.positions, "positions")
        if positions.size < 2:
            raise TableError(f"a table needs at least 2 positions, got {positions.size}")
        bad = np.flatnonzero(np.diff(positions) <= 0)
        if bad.size:
            i = int(bad[0])
            raise TableError(
                f"positions must rise strictly: entry {i} is {positions[i] * 1e3:.9g} mm, entry "
                f"{i + 1} is {positions[i + 1] * 1e3:.9g} mm; sort them and remove duplicates"
            )
        object.__setattr__(self, "positions", positions)
        for name in ("forward", "reverse", "u"):
            values = getattr(self, name)
            if values is not None:
                column = _column(values, name)
                if column.size != positions.size:
                    raise TableError(
                        f"{name} has {column.size} entries, there are {positions.size} positions"
                    )
                object.__setattr__(self, name, column)
        for name in ("axis", "compensates"):
            if not str(getattr(self, name)).strip():
                raise TableError(f"{name} must name an axis, such as 'X'")

    @property
    def is_on_axis(self) -> bool:
        """Whether the corrected axis is the one whose position is looked up."""
        return self.axis == self.compensates

    @property
    def span(self) -> tuple[float, float]:
        """First and last position in m."""
        return float(self.positions[0]), float(self.positions[-1])

    @property
    def stroke(self) -> float:
        """Largest correction, absolute, m."""
        both = self.forward if self.reverse is None else np.r_[self.forward, self.reverse]
        return float(np.abs(both).max())

    @classmethod
    def from_error(
        cls,
        error: ErrorEstimate | Profile | ErrorFunction,
        *,
        positions: ArrayLike | str | int,
        axis: str,
        compensates: str | None = None,
        direction: Direction = "auto",
        reference: float | None = None,
        reverse: ErrorEstimate | Profile | ErrorFunction | None = None,
        exact: bool = True,
        source_sha256: tuple[str, ...] = (),
    ) -> CompensationTable:
        """Return the table that cancels an error.

        Parameters
        ----------
        error : ErrorEstimate, Profile or callable
            Error e = actual - nominal in m over position in m.
        positions : array_like, str or int
            Positions in m; or the spacing as text, ``"1 mm"``; or their number. For the last two
            the range is that of the estimate or profile.
        axis : str
            Axis whose position is looked up.
        compensates : str, optional
            Axis that is corrected; `axis` itself if omitted.
        direction : {"auto", "both", "split", "forward", "reverse"}, optional
            One column for both directions, or one for each. "auto" splits where the estimate
            has both; "forward" and "reverse" use that direction's estimate for both.
        reference : float, m, optional
            Position of zero correction; 0 if it is in range, else the first position.
        reverse : ErrorEstimate, Profile or callable, optional
            Error of the reverse direction where it comes from elsewhere.
        exact : bool, optional
            Solve ``c(p) = -e(p + c(p))`` for an on-axis table.
        source_sha256 : tuple of str, optional
            Hashes of the source files; taken from the history of an estimate if omitted.

        Returns
        -------
        CompensationTable
            With interpolation error and uncertainty where they are known.

        Raises
        ------
        TableError
            If the positions leave the measured range or the error is too steep to invert.
        DataError
            If `direction` is unknown or asks for what the error does not have.
        """
        forward_error, reverse_error = _error_functions(error, reverse, direction)
        p = _positions(positions, error)
        _check_coverage(p, error)
        zero = _reference(p, reference)
        target = compensates or axis
        invert = exact and target == axis
        offset = float(forward_error(np.array([zero]))[0])
        shifted = _minus(forward_error, offset)
        make = exact_correction if invert else (lambda e, x: -e(x))
        shifted_reverse = None if reverse_error is None else _minus(reverse_error, offset)
        return cls(
            positions=p,
            forward=_zeroed(make(_clipped(shifted, p), p), p, zero),
            reverse=None if shifted_reverse is None else make(_clipped(shifted_reverse, p), p),
            axis=axis,
            compensates=target,
            reference=zero,
            u=_uncertainty(error, p),
            interpolation_error=_interpolation_error([shifted, shifted_reverse], p),
            removed="line" if isinstance(error, ErrorEstimate) else "offset",
            is_exact_inverse=invert,
            offset_removed=offset,
            source_sha256=source_sha256 or _hashes(error),
            history=(
                *getattr(error, "history", ()),
                Step("table", {"axis": axis, "compensates": target, "reference_m": zero}),
            ),
        )

    def correction(self, position: ArrayLike, direction: int = 1) -> FloatArray:
        """Return the correction as a controller would interpolate it.

        Parameters
        ----------
        position : array_like, m
            Commanded positions.
        direction : {1, -1}, optional
            Direction of motion.

        Returns
        -------
        ndarray, m
            Linear between entries, constant outside.

        Raises
        ------
        DataError
            If `direction` is neither 1 nor -1.
        """
        if direction not in (1, -1):
            raise DataError(f"direction is +1 or -1, got {direction!r}")
        values = self.forward if direction > 0 or self.reverse is None else self.reverse
        p = np.atleast_1d(np.asarray(position, dtype=np.float64))
        return np.asarray(np.interp(p, self.positions, values))

    def exact_inverse(self) -> CompensationTable:
        """Return the table with c(p) = -e(p + c(p)), taking the present entries as -e.

        Returns
        -------
        CompensationTable
            Itself, if it is exact already or corrects another axis.

        Raises
        ------
        TableError
            If the entries are too steep to invert.
        """
        if self.is_exact_inverse or not self.is_on_axis:
            return self
        step = Step("exact_inverse", {})

        def invert(direction: int) -> FloatArray:
            return exact_correction(lambda x: -self.correction(x, direction), self.positions)

        return replace(
            self,
            forward=invert(1),
            reverse=None if self.reverse is None else invert(-1),
            is_exact_inverse=True,
            history=(*self.history, step),
        )

    def limits(self, limits: Limits | None = None, **values: float) -> tuple[Finding, ...]:
        """Return what is wrong or doubtful about the table for a machine.

        Parameters
        ----------
        limits : Limits, optional
            Of machine and controller; or give its fields as keywords.
        **values
            Fields of `Limits`.

        Returns
        -------
        tuple of Finding
            Level, problem and fix; empty if nothing is wrong.
        """
        chosen = limits or Limits(**cast("dict[str, Any]", values))
        return check_limits(
            self.positions, self.forward, self.reverse, chosen, on_axis=self.is_on_axis
        )

    def require_limits(self, limits: Limits) -> tuple[Finding, ...]:
        """Return the warnings, and refuse on an error.

        Parameters
        ----------
        limits : Limits
            Of machine and controller.

        Returns
        -------
        tuple of Finding
            The findings that are not errors.

        Raises
        ------
        LimitError
            If a limit is exceeded.
        """
        findings = self.limits(limits)
        errors = [f for f in findings if f.level == "error"]
        if errors:
            raise LimitError("; ".join(f"{f.problem}: {f.fix}" for f in errors))
        return findings

    def verify(self, against: Against) -> Verification:
        """Return the dry-run against a measured error, and refuse if it does not shrink.

        Parameters
        ----------
        against : RunSet, Profile or ErrorEstimate
            Measured error over position.

        Returns
        -------
        Verification
            P-V and RMS before, after and with the sign reversed.

        Raises
        ------
        SignCheckFailedError
            If the error does not shrink in some direction.
        TableError
            If table and measurement do not overlap.
        """
        result = dry_run(
            self.correction, against, span=self.span, on_axis=self.is_on_axis, removed=self.removed
        )
        result.require(f"table {self.axis} -> {self.compensates}")
        return result

    def negated(self) -> CompensationTable:
        """Return the table with the sign reversed, for tests of sign checks.

        Returns
        -------
        CompensationTable
            It doubles the error.
        """
        return replace(
            self, forward=-self.forward, reverse=None if self.reverse is None else -self.reverse
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For sidecars and reports.
        """
        return {
            "axis": self.axis,
            "compensates": self.compensates,
            "sign": "correction c = -e is added to the command; e = actual - nominal",
            "n_points": int(self.positions.size),
            "positions_m": self.positions.tolist(),
            "forward_m": self.forward.tolist(),
            "reverse_m": None if self.reverse is None else self.reverse.tolist(),
            "u_m": None if self.u is None else self.u.tolist(),
            "reference_m": self.reference,
            "offset_removed_m": self.offset_removed,
            "stroke_m": self.stroke,
            "span_m": list(self.span),
            "interpolation": "linear, constant outside",
            "interpolation_error_m": self.interpolation_error,
            "exact_inverse": self.is_exact_inverse,
            "not_in_table": self.removed,
            "source_sha256": list(self.source_sha256),
            "history": history_as_dicts(self.history),
        }

    def __repr__(self) -> str:
        ways = "both directions alike" if self.reverse is None else "forward and reverse"
        return (
            f"CompensationTable({self.axis} -> {self.compensates}, {self.positions.size} points, "
            f"{format_length(self.span[0])} ... {format_length(self.span[1])}, {ways}, stroke "
            f"{format_length(self.stroke)}, zero at {format_length(self.reference)})"
        )

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        return html_table(
            "CompensationTable",
            {
                "axis → corrected axis": f"{self.axis} → {self.compensates}",
                "points": str(self.positions.size),
                "span": f"{format_length(self.span[0])} … {format_length(self.span[1])}",
                "entries": "correction c = −e, added to the command",
                "stroke": format_length(self.stroke),
                "zero at": format_length(self.reference),
                "interpolation error": format_length(self.interpolation_error),
            },
        )


def _column(values: ArrayLike, name: str) -> FloatArray:
    column = np.array(values, dtype=np.float64)
    if column.ndim != 1:
        raise TableError(f"{name} must be one-dimensional, got shape {column.shape}")
    if not np.isfinite(column).all():
        i = int(np.flatnonzero(~np.isfinite(column))[0])
        raise TableError(
            f"{name}[{i}] is {column[i]}: a table must be finite everywhere; narrow the positions to "
            "what was measured"
        )
    column.setflags(write=False)
    return column


def _function(
    error: ErrorEstimate | Profile | ErrorFunction, direction: int | None
) -> ErrorFunction:
    if isinstance(error, ErrorEstimate):
        return lambda x: error.evaluate(x, direction=direction)
    if isinstance(error, Profile):
        valid = ~np.isnan(error.z)
        return lambda x: np.interp(x, error.x[valid], error.z[valid])
    if callable(error):
        return lambda x: np.asarray(error(x), dtype=np.float64)
    raise DataError(
        f"the error is a {type(error).__name__}; pass an ErrorEstimate, a Profile or a function"
    )


def _error_functions(
    error: ErrorEstimate | Profile | ErrorFunction,
    reverse: ErrorEstimate | Profile | ErrorFunction | None,
    direction: str,
) -> tuple[ErrorFunction, ErrorFunction | None]:
    if direction not in ("auto", "both", "split", "forward", "reverse"):
        raise DataError(f"direction={direction!r}; use auto, both, split, forward or reverse")
    if reverse is not None:
        return _function(error, 1), _function(reverse, -1)
    has_both = isinstance(error, ErrorEstimate) and error.directions == (-1, 1)
    if direction == "split" and not has_both:
        raise DataError(
            "direction='split' needs runs in both directions (or reverse=); this error has one "
            "direction: use direction='both'"
        )
    if has_both and direction in ("auto", "split"):
        assert isinstance(error, ErrorEstimate)  # noqa: S101  (has_both says so)
        lost = 0.0 if error.lost_motion is None else error.lost_motion.value
        u = 0.0 if error.lost_motion is None else (error.lost_motion.u or 0.0)
        significant = lost if abs(lost) > 2.0 * u else 0.0
        return _function(error, 1), _minus(_function(error, -1), -significant)
    return _function(error, {"forward": 1, "reverse": -1}.get(direction)), None


def _minus(error: ErrorFunction, offset: float) -> ErrorFunction:
    return lambda x: error(x) - offset


def _clipped(error: ErrorFunction, p: FloatArray) -> ErrorFunction:
    """Hold the end values for the lookup p + c just outside the table."""
    return lambda x: error(np.clip(x, p[0], p[-1]))


def _zeroed(values: FloatArray, p: FloatArray, zero: float) -> FloatArray:
    """Write an exact zero at the reference where it is an entry (rounding left 1e-23)."""
    return np.where(p == zero, 0.0, values)


def _range(error: ErrorEstimate | Profile | ErrorFunction) -> tuple[float, float] | None:
    if isinstance(error, ErrorEstimate):
        return error.start, error.stop
    if isinstance(error, Profile):
        valid = error.x[~np.isnan(error.z)]
        return float(valid[0]), float(valid[-1])
    return None


def _positions(
    positions: ArrayLike | str | int, error: ErrorEstimate | Profile | ErrorFunction
) -> FloatArray:
    if not isinstance(positions, str | int):
        return _column(positions, "positions")
    span = _range(error)
    if span is None:
        raise TableError("for a function state the positions themselves: its range is not known")
    low, high = span
    if isinstance(positions, str):
        spacing = parse_quantity(positions, dimension="length", name="spacing")
        if not 0.0 < spacing <= high - low:
            raise TableError(
                f"spacing {positions!r} must be positive and at most the range {format_length(high - low)}"
            )
        first = math.ceil(low / spacing - 1e-9)
        last = math.floor(high / spacing + 1e-9)
        if last - first < 1:
            raise TableError(
                f"no two multiples of {positions!r} lie in {format_length(low)} ... "
                f"{format_length(high)}; use a finer spacing"
            )
        return np.clip(np.arange(first, last + 1) * spacing, low, high)
    return np.linspace(low, high, max(int(positions), 0))


def _check_coverage(p: FloatArray, error: ErrorEstimate | Profile | ErrorFunction) -> None:
    span = _range(error)
    if span is None or p.size == 0:
        return
    low, high = error.fit_range if isinstance(error, ErrorEstimate) else span
    margin = 1e-9 * (high - low)
    if p[0] < low - margin or p[-1] > high + margin:
        raise TableError(
            f"the positions {format_length(float(p[0]))} ... {format_length(float(p[-1]))} leave the "
            f"measured range {format_length(low)} ... {format_length(high)}: an error is not "
            "extrapolated; narrow the positions or measure further"
        )


def _reference(p: FloatArray, reference: float | None) -> float:
    if p.size == 0:
        raise TableError("a table needs at least 2 positions, got 0")
    if reference is None:
        return 0.0 if p[0] <= 0.0 <= p[-1] else float(p[0])
    if not p[0] <= reference <= p[-1]:
        raise TableError(
            f"the reference {format_length(reference)} lies outside the table "
            f"{format_length(float(p[0]))} ... {format_length(float(p[-1]))}"
        )
    return float(reference)


def _uncertainty(
    error: ErrorEstimate | Profile | ErrorFunction, p: FloatArray
) -> FloatArray | None:
    if not isinstance(error, ErrorEstimate):
        return None
    sd = error.sd(p)
    return sd if np.isfinite(sd).all() else None


def _interpolation_error(errors: list[ErrorFunction | None], p: FloatArray) -> float:
    worst = 0.0
    fraction = np.linspace(0.0, 1.0, _DENSE + 1)
    dense = np.unique((p[:-1, None] + np.diff(p)[:, None] * fraction).ravel())
    dense = np.clip(dense, p[0], p[-1])
    for error in errors:
        if error is not None:
            rest = error(dense) - np.interp(dense, p, error(p))
            worst = max(worst, float(np.nanmax(np.abs(rest))))
    return worst


def _hashes(error: object) -> tuple[str, ...]:
    found = []
    for step in getattr(error, "history", ()):
        value = step.parameters.get("sha256")
        if isinstance(value, str):
            found.append(value)
        elif isinstance(value, list | tuple):
            found.extend(str(v) for v in value)
    return tuple(found)
