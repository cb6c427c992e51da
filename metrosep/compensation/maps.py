"""`CompensationMap`: corrections of one axis over the positions of two, such as Z over X and Y.

Sign: the values are the correction c = -e that is ADDED to the command (e = actual - nominal).
Rows are y and columns x, ``values[y, x]``. Between the nodes the correction is bilinear, outside
that of the nearest edge, as controllers do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation.area_errors import (
    AreaSource,
    ErrorMap,
    bilinear,
    format_position,
    format_range,
    is_rotary,
    rising,
)
from metrosep.compensation.limits import (
    Corrections,
    Finding,
    Limits,
    coarse_finding,
    slope_finding,
    stroke_finding,
)
from metrosep.compensation.map_verify import MapRemoved, MapVerification, judged_map
from metrosep.compensation.measured import source_hashes
from metrosep.compensation.sampling import inverse_along, sample_area
from metrosep.core._arrays import FloatArray, frozen_float
from metrosep.core.errors import DataError, TableError
from metrosep.core.profile import html_table
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.public import PublicObject, shortened
from metrosep.core.units import format_length


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CompensationMap(Corrections, PublicObject):
    """Corrections over two axes; frozen, SI.

    Parameters
    ----------
    x : array_like, shape (n,), m or rad
        Commanded positions of the first axis (columns), finite, strictly rising, n >= 2.
    y : array_like, shape (m,), m or rad
        Commanded positions of the second axis (rows), likewise.
    values : array_like, shape (m, n), m
        Correction to add to the command of `compensates`, in both directions of motion.
    axes : tuple of (str, str)
        Axes whose positions are looked up: that of the columns, that of the rows. A, B and C turn.
    compensates : str
        Axis that is corrected.
    reference : tuple of (float, float), m or rad
        Where the correction is zero; `limits` warns where it is not a node and the controller's
        interpolation leaves an amount there.
    u : array_like or None, shape (m, n), m
        Standard uncertainty of the values; NaN in a ring of zeros, where nothing was measured.
    interpolation_error : float or None, m
        Largest deviation of the bilinear interpolation from the error it was made of.
    removed : {"offset", "plane"}
        What the error behind the map has no opinion on, and a dry-run removes.
    is_exact_inverse : bool
        Whether ``c(p) = -e(p + c(p))`` was solved along the corrected axis.
    border : {None, "zero"}
        Whether the outermost nodes are a ring of zeros around what was measured.
    offset_removed : float, m
        Error at the reference, which was subtracted.
    source_sha256 : tuple of str
        Hashes of the files behind it.
    history : tuple of Step
        From the files on.
    source : ErrorMap or None
        The error it was made of, between the nodes too, for a dry-run where no measurement is at
        hand.
    notes : tuple of str
        What a user should know about how it was made; `limits` warns of it.

    Raises
    ------
    TableError
        If positions do not rise, shapes do not fit, a value is not finite, an axis has no printable
        name or both have the same, or `removed` or `border` is unknown.

    Notes
    -----
    NaN is refused: a controller has no word for "not measured".

    Examples
    --------
    >>> bed = CompensationMap([0.0, 0.1], [0.0, 0.2], [[0.0, -1e-6], [0.0, -3e-6]])
    >>> bed.correction(0.05, 0.1).tolist()
    [-1e-06]
    """

    x: FloatArray
    y: FloatArray
    values: FloatArray
    axes: tuple[str, str] = ("X", "Y")
    compensates: str = "Z"
    reference: tuple[float, float] = (0.0, 0.0)
    u: FloatArray | None = None
    interpolation_error: float | None = None
    removed: MapRemoved = "offset"
    is_exact_inverse: bool = False
    border: Literal["zero"] | None = None
    offset_removed: float = 0.0
    source_sha256: tuple[str, ...] = ()
    history: tuple[Step, ...] = ()
    source: ErrorMap | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        axes = _checked_axes(self.axes)
        name = str(self.compensates)
        if not name.strip() or not name.isprintable():
            raise TableError(f"compensates must name an axis, such as 'Z'; got {name[:40]!r}")
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "x", rising(self.x, axes[0]))
        object.__setattr__(self, "y", rising(self.y, axes[1]))
        _check_choices(self.removed, self.border)
        object.__setattr__(self, "reference", _checked_place(self.reference))
        self._set_grid("values")
        if self.u is not None:
            self._set_grid("u")

    def _set_grid(self, name: str) -> None:
        grid = frozen_float(getattr(self, name), name=name, ndim=2)
        wanted = (self.y.size, self.x.size)
        if grid.shape != wanted:
            turned = "; rows and columns are exchanged" if grid.shape == wanted[::-1] else ""
            raise TableError(
                f"{name} has shape {grid.shape}, but there are {wanted[0]} rows ({self.axes[1]}) and "
                f"{wanted[1]} columns ({self.axes[0]}){turned}"
            )
        bad = np.argwhere(np.isnan(grid))
        if name == "values" and bad.size:
            row, column = (int(i) for i in bad[0])
            raise TableError(
                f"the correction at {format_position(self.axes[0], float(self.x[column]))}, "
                f"{format_position(self.axes[1], float(self.y[row]))} is NaN ({len(bad)} of "
                f"{grid.size}): a map must be finite everywhere; narrow it to what was measured"
            )
        if name == "u" and bool((grid < 0.0).any()):
            raise TableError(
                f"u holds {np.nanmin(grid):.3g} m: a standard uncertainty is not negative"
            )
        object.__setattr__(self, name, grid)

    @property
    def is_on_axis(self) -> bool:
        """Whether the corrected axis is one of those whose positions are looked up."""
        return self.compensates in self.axes

    @property
    def span(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """First and last position of either axis, m or rad."""
        return (float(self.x[0]), float(self.x[-1])), (float(self.y[0]), float(self.y[-1]))

    @property
    def inner_span(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The same without a ring of zeros: what was measured."""
        k = 0 if self.border is None else 1
        x, y = self.x[k : self.x.size - k], self.y[k : self.y.size - k]
        return (float(x[0]), float(x[-1])), (float(y[0]), float(y[-1]))

    @property
    def headline(self) -> str:
        """What is looked up and what is corrected, in one line."""
        spans = " x ".join(
            format_range(a, low, high) for a, (low, high) in zip(self.axes, self.span, strict=True)
        )
        plane = "plane kept" if self.removed == "offset" else "the plane is omitted (alignment)"
        own = " (its own positioning)" if self.is_on_axis else ""
        return (
            f"{self.axes[0]}, {self.axes[1]} -> {self.compensates}{own}, {spans}, {self.x.size} x "
            f"{self.y.size} entries, {plane}, zero at {self._reference_text()}"
        )

    @property
    def stroke(self) -> float:
        """Largest correction, absolute, m."""
        return float(np.abs(self.values).max())

    @classmethod
    def from_error(
        cls,
        error: AreaSource | ArrayLike,
        *,
        x: ArrayLike | str | int | None = None,
        y: ArrayLike | str | int | None = None,
        axes: tuple[str, str] = ("X", "Y"),
        compensates: str = "Z",
        reference: tuple[float, float] | None = None,
        border: Literal["zero"] | None = None,
        removed: MapRemoved = "offset",
        u: ArrayLike | None = None,
        exact: bool = True,
        source_sha256: tuple[str, ...] = (),
    ) -> CompensationMap:
        """Return the map that cancels an error over two axes.

        Parameters
        ----------
        error : Surface, ErrorMap, callable e(x, y) or array_like of shape (m, n), m
            Error e = actual - nominal of the axis `compensates`.
        x, y : array_like, str or int, optional
            Positions of columns and rows in m or rad; or the spacing as text, ``"5 mm"`` or
            ``"10 deg"``; or their number; those of the measured grid if omitted. A function needs
            positions.
        axes : tuple of (str, str), optional
            Axes whose positions are looked up.
        compensates : str, optional
            Axis that is corrected.
        reference : tuple of (float, float), m or rad, optional
            Place of zero correction; of each axis 0 if it is in range, else its first position.
        border : {None, "zero"}, optional
            "zero" surrounds the map by one ring of zeros, a spacing away, so that the axis enters
            and leaves it without a step.
        removed : {"offset", "plane"}, optional
            What the error has no opinion on: "plane" where it was levelled before.
        u : float or array_like, shape (m, n), m, optional
            Standard uncertainty of the error at the nodes.
        exact : bool, optional
            Solve ``c(p) = -e(p + c(p))`` where the map corrects one of its own axes.
        source_sha256 : tuple of str, optional
            Hashes of the source files; taken from the history of the error if omitted.

        Returns
        -------
        CompensationMap
            With its interpolation error, and the amount that was subtracted at the reference.

        Raises
        ------
        TableError
            If positions leave the measured range, the error is not known somewhere in the map, or it
            is too steep to invert.
        DataError
            If the error is something else or not calibrated laterally.
        UnitError
            If a spacing has no unit or one of the wrong kind.
        InvalidSamplesError
            If `u` or an array holds an infinite value.
        NotConvergedError
            If the exact inverse does not settle.

        Notes
        -----
        The mean is never removed: a uniform error becomes zero by the reference alone, and
        ``offset_removed`` says by how much. Nothing is filled: a NaN of the error inside the map is
        refused with its place.

        Examples
        --------
        >>> CompensationMap.from_error(lambda x, y: 1e-5 * x * y, x=[0, 0.1], y=[0, 0.2])
        CompensationMap(X, Y -> Z, 2 columns x 2 rows, stroke 200 nm, zero at X = 0 mm, Y = 0 mm)
        """
        _check_choices(removed, border)
        axes = _checked_axes(axes)
        sampled = sample_area(error, x, y, axes=axes, reference=reference)
        invert = exact and compensates in axes
        values = 0.0 - sampled.values
        if invert:
            values = inverse_along(sampled.error, sampled.x, sampled.y, axes.index(compensates))
            values[
                np.ix_(sampled.y == sampled.reference[1], sampled.x == sampled.reference[0])
            ] = 0.0
        sd = None if u is None else _spread(u, values.shape)
        columns, rows = sampled.x, sampled.y
        if border == "zero":
            columns, rows = _with_ends(columns), _with_ends(rows)
            values = np.pad(values, 1)
            sd = None if sd is None else np.pad(sd, 1, constant_values=np.nan)
        given = {"axes": list(axes), "compensates": compensates, "border": border}
        return cls(
            x=columns,
            y=rows,
            values=values,
            axes=axes,
            compensates=compensates,
            reference=sampled.reference,
            u=sd,
            interpolation_error=sampled.interpolation_error,
            removed=removed,
            is_exact_inverse=invert,
            border=border,
            offset_removed=sampled.offset,
            source_sha256=source_sha256 or source_hashes(sampled.source.history),
            history=(
                *sampled.source.history,
                Step("map", {**given, "reference_si": list(sampled.reference)}),
            ),
            source=sampled.source,
            notes=(sampled.missed,) if sampled.missed else (),
        )

    def correction(self, x: ArrayLike, y: ArrayLike, direction: int = 1) -> FloatArray:
        """Return the correction as a controller would interpolate it.

        Parameters
        ----------
        x, y : array_like, m or rad
            Commanded positions of the two axes; they broadcast.
        direction : {1, -1}, optional
            Direction of motion; a map is the same in both.

        Returns
        -------
        ndarray, m
            Bilinear between nodes, that of the nearest edge outside; NaN where a position is NaN.

        Raises
        ------
        DataError
            If `direction` is neither 1 nor -1, or the positions do not broadcast.
        """
        if direction not in (1, -1):
            raise DataError(f"direction is +1 or -1, got {direction!r}")
        return bilinear(self.x, self.y, self.values, x, y)

    def exact_inverse(self) -> CompensationMap:
        if self.is_exact_inverse or not self.is_on_axis:
            return self

        def error(px: FloatArray, py: FloatArray) -> FloatArray:
            return -self.correction(px, py)

        return replace(
            self,
            values=inverse_along(error, self.x, self.y, self.axes.index(self.compensates)),
            is_exact_inverse=True,
            history=(*self.history, Step("exact_inverse", {})),
        )

    def limits(
        self,
        limits: Limits | None = None,
        *,
        feeds: Mapping[str, float] | None = None,
        **values: float,
    ) -> tuple[Finding, ...]:
        """Return what is wrong or uncertain about the map for a machine.

        Parameters
        ----------
        limits : Limits, optional
            Of machine and controller; or give its fields as keywords.
        feeds : mapping of str to float, m/s or rad/s, optional
            Largest feed of each of the two axes, where it is not that of the limits.
        **values
            Fields of `Limits`.

        Returns
        -------
        tuple of Finding
            Level, problem and fix; empty if nothing is wrong.

        Raises
        ------
        DataError
            If feeds name another axis.
        """
        chosen = limits or Limits(**cast("dict[str, Any]", values))
        findings = check_map_limits(
            self.x,
            self.y,
            self.values,
            chosen,
            axes=self.axes,
            compensates=self.compensates,
            feeds=feeds,
        )
        if all(a <= r <= b for r, (a, b) in zip(self.reference, self.span, strict=True)):
            there = float(self.correction(*self.reference)[0])
            findings += reference_finding(there, self._reference_text())
        findings += tuple(Finding.warning(note, "", "coverage") for note in self.notes)
        return (*findings, *coarse_finding(self.interpolation_error, self.values, "map"))

    def verify(
        self, against: AreaSource | None = None, *, free_zero: bool = False
    ) -> MapVerification:
        """Return the dry-run against a measured error, and refuse what makes the machine worse.

        Parameters
        ----------
        against : Surface, ErrorMap or callable e(x, y), optional
            Measured error e = actual - nominal in m; that of `source` if omitted.
        free_zero : bool, optional
            Whether what the map adds at its reference is not counted.

        Returns
        -------
        MapVerification
            Grade and gain; P-V and RMS before, after and with the sign reversed.

        Raises
        ------
        SignCheckFailedError
            If the grade is "refused"; the other grades are returned.
        TableError
            If map and measurement do not overlap, or there is nothing to verify against.
        DataError
            If nothing was measured inside the map, or `against` is something else.

        Notes
        -----
        Against `source` only sign, orientation and interpolation are proven, not the measurement. A
        ring of zeros is not compared.
        """
        chosen = self.source if against is None else against
        if chosen is None:
            raise TableError("this map has no source of its own: give the measured error")
        result = judged_map(self, chosen, free_zero=free_zero)
        result.require(
            f"map {self.axes[0]}, {self.axes[1]} -> {self.compensates}", only_refused=True
        )
        return result

    def negated(self) -> CompensationMap:
        return replace(self, values=0.0 - self.values)

    def to_dict(self) -> dict[str, Any]:
        return {
            "axes": list(self.axes),
            "axis_units": ["rad" if is_rotary(a) else "m" for a in self.axes],
            "compensates": self.compensates,
            "headline": self.headline,
            "sign": "correction c = -e is added to the command; e = actual - nominal",
            "n_points": int(self.values.size),
            "x_si": self.x.tolist(),
            "y_si": self.y.tolist(),
            "layout": "rows are the second axis (y), columns the first (x)",
            "values_m": self.values.tolist(),
            "u_m": None if self.u is None else _listed(self.u),
            "reference_si": list(self.reference),
            "offset_removed_m": self.offset_removed,
            "stroke_m": self.stroke,
            "span_si": [list(s) for s in self.span],
            "border": self.border,
            "interpolation": "bilinear, constant outside",
            "interpolation_error_m": self.interpolation_error,
            "exact_inverse": self.is_exact_inverse,
            "not_in_map": self.removed,
            **({"notes": list(self.notes)} if self.notes else {}),
            "source_sha256": list(self.source_sha256),
            "history": history_as_dicts(self.history),
        }

    def __repr__(self) -> str:
        return shortened(
            f"CompensationMap({self.axes[0]}, {self.axes[1]} -> {self.compensates}, {self.x.size} "
            f"columns x {self.y.size} rows, stroke {format_length(self.stroke)}, zero at "
            f"{self._reference_text()})"
        )

    def _reference_text(self) -> str:
        places = zip(self.axes, self.reference, strict=True)
        return ", ".join(format_position(a, r) for a, r in places)

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        ends = [
            f"{format_position(a, low)} … {format_position(a, high)}"
            for a, (low, high) in zip(self.axes, self.span, strict=True)
        ]
        return html_table(
            "CompensationMap",
            {
                "axes → corrected axis": f"{self.axes[0]}, {self.axes[1]} → {self.compensates}",
                "columns × rows": f"{self.x.size} × {self.y.size}",
                "span": "; ".join(ends),
                "entries": "correction c = −e, added to the command",
                "stroke": format_length(self.stroke),
                "interpolation error": format_length(self.interpolation_error),
            },
        )


def _checked_axes(axes: Any) -> tuple[str, str]:
    listed = axes if isinstance(axes, tuple | list) else ()
    names = tuple(str(a).strip() for a in listed)
    fine = len(names) == 2 and all(names) and all(n.isprintable() for n in names)
    if not fine or names[0] == names[1]:
        raise TableError(f"axes are the names of two axes, such as ('X', 'Y'); got {axes!r}")
    return names[0], names[1]


def _checked_place(reference: Any) -> tuple[float, float]:
    place = np.asarray(reference)
    if place.shape != (2,) or place.dtype.kind not in "fiu" or not np.isfinite(place).all():
        raise TableError(f"reference is one position of each axis, got {reference!r}")
    return float(place[0]), float(place[1])


def _spread(u: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    sd = np.asarray(u, dtype=np.float64)
    if sd.ndim and sd.shape != shape:
        raise TableError(
            f"u has shape {sd.shape}; a number or shape {shape} (rows y, columns x) is needed"
        )
    return np.broadcast_to(sd, shape)


def _check_choices(removed: str, border: str | None) -> None:
    if removed not in ("offset", "plane"):
        raise TableError(f"removed={removed!r}; use 'offset' or 'plane'")
    if border not in (None, "zero"):
        raise TableError(f"border={border!r}; use None or 'zero'")


def _with_ends(positions: FloatArray) -> FloatArray:
    """Return positions with one more at either end, as far away as their neighbours are apart."""
    first, last = 2.0 * positions[0] - positions[1], 2.0 * positions[-1] - positions[-2]
    return np.concatenate([[first], positions, [last]])


def _listed(grid: FloatArray) -> list[list[float | None]]:
    return [[None if np.isnan(v) else float(v) for v in row] for row in grid]


# ---- whether a map of corrections stays inside what a machine or a controller allows -----------
# The slopes of a map add up: while both axes move at their feeds, the corrected axis moves with
# ``|dc/dx| vx + |dc/dy| vy`` at most (controllers notes, section 8, checks 5 to 9).

_SAME = 1e-12
"""Below a picometre the correction at the reference counts as zero."""


def check_map_limits(
    x: FloatArray,
    y: FloatArray,
    values: FloatArray,
    limits: Limits,
    *,
    axes: tuple[str, str],
    compensates: str,
    feeds: Mapping[str, float] | None = None,
) -> tuple[Finding, ...]:
    """Return what is wrong or uncertain about the corrections of a map.

    Parameters
    ----------
    x, y : ndarray, shapes (n,) and (m,), m or rad
        Positions of columns and rows.
    values : ndarray, shape (m, n), m
        Corrections.
    limits : Limits
        What is allowed; its feed is that of both axes, if they do not turn.
    axes : tuple of (str, str)
        Names of the axes of columns and rows.
    compensates : str
        Axis that is corrected.
    feeds : mapping of str to float, m/s or rad/s, optional
        Feed of each axis, where it is not that of the limits.

    Returns
    -------
    tuple of Finding
        Empty if nothing is wrong.

    Raises
    ------
    DataError
        If feeds name another axis.

    Examples
    --------
    >>> import numpy as np
    >>> grid = np.linspace(0, 0.1, 11)
    >>> bad = check_map_limits(grid, grid, np.eye(11) * 2e-5, Limits(stroke=1e-5),
    ...                        axes=("X", "Y"), compensates="Z")
    >>> [f.level for f in bad]
    ['error', 'warning', 'warning']
    """
    findings: list[Finding] = []
    if limits.max_points is not None and values.size > limits.max_points:
        text = f"{y.size} rows of {x.size} make {values.size} points, the controller takes "
        findings.append(
            Finding.error(f"{text}{limits.max_points}", "use a coarser spacing", "points")
        )
    findings += stroke_finding(float(np.abs(values).max()), limits)
    slopes = (np.diff(values, axis=1) / np.diff(x), np.diff(values, axis=0) / np.diff(y)[:, None])
    for slope, axis in zip(slopes, axes, strict=True):
        steepest = 0.0 if is_rotary(axis) else float(np.abs(slope).max())
        fall = -float(slope.min()) if axis == compensates else 0.0
        findings += slope_finding(steepest, fall, f"along {axis} ")
    return (*findings, *_motion(x, y, slopes, limits, axes, feeds or {}))


def _motion(
    x: FloatArray,
    y: FloatArray,
    slopes: tuple[FloatArray, FloatArray],
    limits: Limits,
    axes: tuple[str, str],
    feeds: Mapping[str, float],
) -> list[Finding]:
    unknown = [name for name in feeds if name not in axes]
    if unknown:
        raise DataError(f"feeds name {unknown[0]!r}; the map is over {axes[0]} and {axes[1]}")
    if limits.velocity_share is None and limits.acceleration_share is None:
        return []
    speeds, found = [], []
    for axis in axes:
        feed = feeds.get(axis, None if is_rotary(axis) else limits.feed)
        speeds.append(0.0 if feed is None else abs(feed))
        if feed is None:
            unit = "rad/s" if is_rotary(axis) else "m/s"
            found.append(
                Finding.warning(
                    f"speed and acceleration along {axis} were not checked: its feed is not known",
                    f"give feeds={{{axis!r}: ...}} in {unit}",
                    "feed",
                )
            )
    along_x, along_y = (np.abs(s) * v for s, v in zip(slopes, speeds, strict=True))
    cells = np.maximum(along_x[:-1], along_x[1:]) + np.maximum(along_y[:, :-1], along_y[:, 1:])
    speed = float(cells.max())
    if limits.velocity_share is not None and speed > limits.velocity_share:
        found.append(
            Finding.error(
                f"with {axes[0]} and {axes[1]} at their feeds the correction moves with "
                f"{speed * 6e4:.4g} mm/min ({axes[0]} alone {along_x.max() * 6e4:.4g}, {axes[1]} alone "
                f"{along_y.max() * 6e4:.4g}), allowed are {limits.velocity_share * 6e4:.4g}",
                "drive slower or smooth the error",
                "velocity",
            )
        )
    if limits.acceleration_share is not None:
        found += _acceleration((x, y), slopes, speeds, limits.acceleration_share, axes)
    return found


def _acceleration(
    positions: tuple[FloatArray, FloatArray],
    slopes: tuple[FloatArray, FloatArray],
    speeds: list[float],
    allowed: float,
    axes: tuple[str, str],
) -> list[Finding]:
    """Return the bound of ``c_xx vx^2 + c_yy vy^2 + 2 c_xy vx vy``, each at its largest."""
    parts = [
        _bend(p, s) * v**2
        for p, s, v in zip(positions, (slopes[0], slopes[1].T), speeds, strict=True)
    ]
    twist = np.diff(slopes[0], axis=0) / np.diff(positions[1])[:, None]
    parts.append(2.0 * float(np.abs(twist).max()) * speeds[0] * speeds[1])
    total = sum(parts)
    if total <= allowed:
        return []
    return [
        Finding.error(
            f"the correction accelerates with up to {total:.3g} m/s2 ({axes[0]} {parts[0]:.3g}, "
            f"{axes[1]} {parts[1]:.3g}, both at once {parts[2]:.3g}), allowed are {allowed:.3g}",
            "drive slower or smooth the error",
            "acceleration",
        )
    ]


def _bend(position: FloatArray, slope: FloatArray) -> float:
    if position.size < 3:
        return 0.0
    middle = 0.5 * (position[2:] - position[:-2])
    return float(np.abs(np.diff(slope, axis=1) / middle).max())


def reference_finding(there: float, reference: str) -> tuple[Finding, ...]:
    """Return a warning where the correction looked up at the reference is not zero.

    Examples
    --------
    >>> reference_finding(2e-9, "X = 5 mm")[0].problem
    'the correction at the reference X = 5 mm is 2 nm, not zero: the zero of the machine moves by it'
    """
    if not abs(there) > _SAME:
        return ()
    return (
        Finding.warning(
            f"the correction at the reference {reference} is {format_length(there, digits=3)}, not "
            "zero: the zero of the machine moves by it",
            "make the reference a node: put it among the positions of both axes",
            "reference",
        ),
    )
