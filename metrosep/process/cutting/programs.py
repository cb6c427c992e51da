"""A program of a turned freeform: places of the tip in time, and what the control makes between them.

All axes are functions of the same time. Between two blocks they run along lines, along a C2 cubic
spline through the points (not-a-knot ends), or along PVT: the cubic Hermite polynomial of positions,
velocities and times,

    p(s) = p0 + s D + s (1 - s) [ (T v0 - D) (1 - s) + (D - T v1) s ],  D = p1 - p0, s = (t - t0) / T.

X is the radius at which the programmed tip stands, the azimuth is the tip's on the part, counter-
clockwise seen from +z, and Z points out of the material. specs/cutting-path.md, equation (20).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, same_length
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.units import format_ends
from metrosep.process._plain import Frozen, finite_positions
from metrosep.process.interpolation import FEWEST_KNOTS, Interpolation, knot_slopes
from metrosep.process.nose import Sense

if TYPE_CHECKING:
    import pandas as pd

Quantity = Literal["cut points", "tip"]
AXES = ("X", "azimuth", "Z")
_TURN = 2.0 * math.pi
_MARGIN = 60
"""Points beyond a piece of a spline: what lies further off acts by 0.27 to this power, 1e-34."""
_PIECE = 1 << 17
"""Points that are worked on at once."""
_SOLVED = 4
"""Newton steps for the place within a block; a spline of azimuths is nearly a line."""
_TINY_SHARE = 1e-9
"""Of a block: after a step of Newton's as short the next one is lost in rounding."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class TurningProgram(Frozen):
    """Points of a program in time; read-only arrays of equal length.

    Parameters
    ----------
    X, azimuth, Z : ndarray, shape (n,), m, rad and m
        Radius, azimuth on the part (not wrapped) and height of the commanded points, lead-in first.
    t : ndarray, shape (n,), s
        When each point is reached, growing.
    quantity : {"cut points", "tip"}
        What the points are. Cut points are points of the surface, which a tool with a nose must not
        be sent to as they are; "tip" are places of the tip, the point psi = 0 of the nominal edge.
    interpolation : {"linear", "spline", "pvt"}, optional
        What the control does between the points.
    velocities : ndarray, shape (3, n), m/s, rad/s and m/s, optional
        Of X, azimuth and Z at the points, for "pvt".
    nominal : ndarray, shape (n,), m, optional
        Height without the correction of known errors.
    lead_in : int, optional
        Points before the rim.
    residual_pv : mapping of str to float, m, optional
        P-V of what an uncertainty of the tool setting of one u leaves, by factor.
    messages : tuple of str, optional
        What to know.
    audit : mapping, optional
        Settings, units in the keys.

    Raises
    ------
    DataError
        If lengths differ, a word is not known, the azimuth turns back, or velocities are missing.
    InvalidSamplesError
        If a value is NaN, or times do not grow.
    TooFewSamplesError
        If there are fewer than two points, or fewer than four for a spline.

    Examples
    --------
    >>> turn = np.linspace(0.0, 4.0 * np.pi, 49)
    >>> program = TurningProgram(1e-3 - 1e-6 * turn, turn, 0.0 * turn, turn / 6.0, "tip")
    >>> program.sense, round(program.turns, 9), round(program.rpm, 3)
    ('counterclockwise', 2.0, 57.296)
    """

    X: FloatArray
    azimuth: FloatArray
    Z: FloatArray
    t: FloatArray
    quantity: Quantity
    interpolation: Interpolation = "spline"
    velocities: FloatArray | None = None
    nominal: FloatArray | None = None
    lead_in: int = 0
    residual_pv: Mapping[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        Frozen.__post_init__(self)
        numbers.choice(self.quantity, "quantity", get_args(Quantity))
        numbers.choice(self.interpolation, "interpolation", get_args(Interpolation))
        columns = {n: getattr(self, n) for n in ("X", "azimuth", "Z", "t")}
        same_length(**columns, **({} if self.nominal is None else {"nominal": self.nominal}))
        fewest = FEWEST_KNOTS if self.interpolation == "spline" else 2
        if self.X.size < fewest:
            raise TooFewSamplesError(
                f"a program joined by {self.interpolation} needs {fewest} points, got {self.X.size}"
            )
        for name, values in columns.items():
            if not math.isfinite(float(values.sum())):
                at = int(np.flatnonzero(~np.isfinite(values))[0])
                raise InvalidSamplesError(f"{name} of block {at} is {values[at]}: give it a value")
        at = _first_stop(self.t, 1.0)
        if at >= 0:
            raise InvalidSamplesError(
                f"block {at + 1} is reached at {self.t[at + 1]:.9g} s, not after block {at} at "
                f"{self.t[at]:.9g} s: times must grow"
            )
        at = _first_stop(self.azimuth, 1.0 if self.azimuth[-1] > self.azimuth[0] else -1.0)
        if at >= 0:
            raise DataError(
                f"C turns back or stands still at block {at + 1}: azimuth "
                f"{math.degrees(self.azimuth[at]):.6g} to {math.degrees(self.azimuth[at + 1]):.6g} degrees "
                "on the part; a turned path goes round one way"
            )
        if self.interpolation == "pvt" and self.velocities is None:
            raise DataError("a PVT program needs the velocities of its axes at the points")
        if self.velocities is not None:
            if self.velocities.shape != (3, self.X.size):
                raise DataError(
                    f"velocities have the shape {self.velocities.shape}; they must be "
                    f"(3, {self.X.size}): of X, azimuth and Z"
                )
            if not np.isfinite(self.velocities).all():
                raise InvalidSamplesError("a velocity is NaN: a PVT block needs both of its ends")

    def __len__(self) -> int:
        return int(self.X.size)

    def __repr__(self) -> str:
        return (
            f"TurningProgram({len(self)} points of {self.quantity}, {self.interpolation}, X "
            f"{format_ends(float(self.X[0]), float(self.X[-1]), between=' to ')}, {self.sense})"
        )

    @property
    def sense(self) -> Sense:
        """How the tool goes round the part, seen from +z."""
        return "counterclockwise" if self.azimuth[-1] > self.azimuth[0] else "clockwise"

    @property
    def turns(self) -> float:
        """Turns of the part, from the first point to the last."""
        return abs(float(self.azimuth[-1] - self.azimuth[0])) / _TURN

    @property
    def feed(self) -> float:
        """Mean advance of X in a turn, m: from the first whole turn to the last one.

        Not from its first place to its last: where X follows the surface (servo XZ) it swings within a turn
        by much more than it advances. A program of less than two turns has its ends only.
        """
        turns = self.turns
        if turns < 2.0:
            return abs(float(self.X[0] - self.X[-1])) / turns
        way = 1.0 if self.sense == "counterclockwise" else -1.0
        head = self._x_over_turn(float(self.azimuth[0]), way)
        tail = self._x_over_turn(float(self.azimuth[-1]) - way * _TURN, way)
        return abs(head - tail) / (turns - 1.0)

    def _x_over_turn(self, start: float, way: float) -> float:
        """Return the mean of X over the azimuths of the turn after one, straight between its points."""
        course = AxisCourse.lines(self)
        ends = start + way * _TURN * np.array([0.0, 1.0])
        i, s = course.at_azimuth(ends)
        inner = slice(int(i[0]) + 1, int(i[1]) + 1)
        x, azimuth = course.value(0, i, s), self.azimuth[inner]
        xs, at = np.array([x[0], *self.X[inner], x[1]]), np.array([ends[0], *azimuth, ends[1]])
        return float(np.trapezoid(xs, at)) / (way * _TURN)

    def advance_at(self, azimuth: ArrayLike) -> FloatArray:
        """Return how far X is from that of the turns before and after, m: the larger of the two.

        Parameters
        ----------
        azimuth : array_like, rad
            On the part, not wrapped.

        Returns
        -------
        ndarray, m
            NaN where the program has neither turn.

        Examples
        --------
        >>> turn = np.linspace(0.0, 6.0 * np.pi, 73)
        >>> program = TurningProgram(1e-3 - 1e-6 * turn, turn, 0.0 * turn, turn, "tip")
        >>> [round(float(v) * 1e6, 6) for v in program.advance_at([7.0])]
        [6.283185]
        """
        course, at = AxisCourse.lines(self), np.atleast_1d(np.asarray(azimuth, dtype=np.float64))
        low, high = np.sort(self.azimuth[[0, -1]])
        found = np.full((3, *at.shape), np.nan)
        for row, turns in zip(found, (-1.0, 0.0, 1.0), strict=True):
            where = at + _TURN * turns
            on = (where >= low) & (where <= high)
            row[on] = course.value(0, *course.at_azimuth(where[on]))
        before, after = np.abs(np.diff(found, axis=0))
        return np.asarray(np.fmax(before, after))

    @property
    def duration(self) -> float:
        """Time from the first point to the last, s."""
        return float(self.t[-1] - self.t[0])

    @property
    def rpm(self) -> float:
        """Mean spindle speed, 1/min."""
        return 60.0 * self.turns / self.duration

    @property
    def change(self) -> FloatArray:
        """What was added to the nominal height, m: the negative of the known errors."""
        return np.asarray(self.Z - (self.Z if self.nominal is None else self.nominal))

    def at(self, t: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return X, azimuth and Z at times, as the control interpolates.

        Parameters
        ----------
        t : array_like, s
            From the first point to the last.

        Returns
        -------
        tuple of ndarray, m, rad and m
            NaN before the first point and after the last.

        Raises
        ------
        InvalidSamplesError
            If a time is not a finite number.

        Examples
        --------
        >>> program = TurningProgram([2e-3, 1e-3], [0.0, 1.0], [0.0, 2e-6], [0.0, 1.0], "tip", "linear")
        >>> [round(float(v[0]), 9) for v in program.at([0.5])]
        [0.0015, 0.5, 1e-06]
        """
        at = np.atleast_1d(finite_positions(t, "t"))
        course = AxisCourse.of(self, slice(0, len(self)))
        i = np.clip(np.searchsorted(course.t, at, side="right") - 1, 0, len(self) - 2)
        s = (at - course.t[i]) / (course.t[i + 1] - course.t[i])
        s = np.where((at < course.t[0]) | (at > course.t[-1]), np.nan, s)
        x, azimuth, z = (course.value(axis, i, s) for axis in range(3))
        return x, azimuth, z

    def to_frame(self) -> pd.DataFrame:
        """Return the program as a table.

        Returns
        -------
        DataFrame
            Columns rho_um, azimuth_deg, z_nominal_nm, z_command_nm, the names of lengths with what
            they belong to in front: cut_point_rho_um, tip_z_command_nm.
        """
        import pandas as pd

        of = self.quantity.removesuffix("s").replace(" ", "_")
        nominal = self.Z if self.nominal is None else self.nominal
        return pd.DataFrame(
            {
                f"{of}_rho_um": 1e6 * self.X,
                "azimuth_deg": np.degrees(self.azimuth),
                f"{of}_z_nominal_nm": 1e9 * nominal,
                f"{of}_z_command_nm": 1e9 * self.Z,
            }
        )


def _spline_slopes(t: FloatArray, values: FloatArray, start: int, stop: int) -> FloatArray:
    """Return slopes of the spline through all values at some of its points, a piece at a time."""
    slopes = np.empty(stop - start)
    for first in range(start, stop, _PIECE):
        last = min(first + _PIECE, stop)
        wide = slice(max(0, first - _MARGIN), min(t.size, last + _MARGIN))
        own = knot_slopes(t[wide], values[wide])
        slopes[first - start : last - start] = own[first - wide.start : last - wide.start]
    return slopes


def _first_stop(values: FloatArray, way: float) -> int:
    """Return the first index after which values do not go on one way, -1 where they always do."""
    for first in range(0, values.size - 1, _PIECE):
        steps = np.diff(values[first : first + _PIECE + 1])
        stops = way * steps <= 0.0
        if stops.any():
            return first + int(np.argmax(stops))
    return -1


@dataclass(frozen=True, slots=True, eq=False)
class AxisCourse:
    """A piece of a program with what joins its points; the axes by number in the order of `AXES`."""

    t: FloatArray  # s, shape (n,)
    values: tuple[FloatArray, FloatArray, FloatArray]  # X, azimuth, Z
    slopes: tuple[FloatArray, FloatArray, FloatArray] | None  # by time; None joins by lines
    first: int  # index of its first point in the program

    @classmethod
    def of(cls, program: TurningProgram, part: slice) -> AxisCourse:
        """Return the course of a piece, as the control makes it of the entire program."""
        all_ = (program.X, program.azimuth, program.Z)
        x, azimuth, z = (v[part] for v in all_)
        start = part.start or 0
        if program.interpolation == "linear":
            return cls(program.t[part], (x, azimuth, z), None, start)
        if program.velocities is not None and program.interpolation == "pvt":
            vx, va, vz = (v[part] for v in program.velocities)
            return cls(program.t[part], (x, azimuth, z), (vx, va, vz), start)
        found = [_spline_slopes(program.t, v, start, start + x.size) for v in all_]
        return cls(program.t[part], (x, azimuth, z), (found[0], found[1], found[2]), start)

    @classmethod
    def lines(cls, program: TurningProgram) -> AxisCourse:
        """Return all points joined by lines, whatever the control does: for what is needed roughly."""
        return cls(program.t, (program.X, program.azimuth, program.Z), None, 0)

    def value(self, axis: int, i: NDArray[np.intp], s: FloatArray) -> FloatArray:
        """Return an axis at a share of blocks."""
        values = self.values[axis]
        p0 = values[i]
        D = values[i + 1] - p0
        if self.slopes is None:
            return np.asarray(p0 + s * D)
        T, slopes = self.t[i + 1] - self.t[i], self.slopes[axis]
        r = 1.0 - s
        return np.asarray(
            p0 + s * (D + r * ((T * slopes[i] - D) * r + (D - T * slopes[i + 1]) * s))
        )

    def rate(self, axis: int, i: NDArray[np.intp], s: FloatArray) -> FloatArray:
        """Return the derivative of an axis by the share of a block."""
        values = self.values[axis]
        D = values[i + 1] - values[i]
        if self.slopes is None:
            return np.asarray(D + 0.0 * s)
        T, slopes = self.t[i + 1] - self.t[i], self.slopes[axis]
        a, b = T * slopes[i] - D, D - T * slopes[i + 1]
        # d/ds of s (1 - s) [a (1 - s) + b s]
        return np.asarray(D + a * (1.0 - s) * (1.0 - 3.0 * s) + b * s * (2.0 - 3.0 * s))

    def at_azimuth(self, azimuth: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return block and share of it at azimuths of the part; clipped to the piece, NaN stays."""
        values = self.values[1]
        way = 1.0 if values[-1] > values[0] else -1.0
        n = values.size
        wanted = np.where(np.isnan(azimuth), values[0], azimuth)
        # knots of a file are rounded, steps may differ: start at the mean rate, then step
        i = ((wanted - values[0]) * ((n - 1) / (values[-1] - values[0]))).astype(np.intp)
        i = np.clip(i, 0, n - 2)
        for _ in range(3):
            ahead, behind = way * (wanted - values[i + 1]) > 0.0, way * (wanted - values[i]) < 0.0
            moved = np.clip(i + ahead.astype(np.intp) - behind.astype(np.intp), 0, n - 2)
            if np.array_equal(moved, i):
                break
            i = moved
        else:
            i = np.clip(np.searchsorted(way * values, way * wanted, side="right") - 1, 0, n - 2)
        s = (azimuth - values[i]) / (values[i + 1] - values[i])
        if self.slopes is not None:
            for _ in range(_SOLVED):
                step = (self.value(1, i, s) - azimuth) / self.rate(1, i, s)
                s = s - step
                if not (np.abs(step) > _TINY_SHARE).any():
                    break
        return i, s
