"""What a machine or a controller allows, and whether a table stays inside it.

Each check returns findings (level, problem, fix); the caller decides whether to refuse. Source:
controllers notes, section 8, checks 5 to 9, and the dead zone of LinuxCNC in section 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from decimal import ROUND_DOWN, Context
from typing import TYPE_CHECKING, Any, Literal, Self, cast

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError
from metrosep.core.provenance import Step
from metrosep.core.public import same
from metrosep.core.units import format_length

_EDGE = 1e-6
"""Share of a limit of the dead zone: the controller keeps its entries as float32."""

_COARSE = 0.1
"""Interpolation error over the span of the corrections beyond which a table or map is too coarse."""

_STEEP = 1e-3
"""Slope of a correction beyond which it is no longer metrology."""


class Stated:
    """What states itself as plain values."""

    __slots__ = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain values with units in the keys.

        Returns
        -------
        dict
            For sidecars and reports; None where a number is not known.
        """
        raise NotImplementedError


class Corrections(Stated):
    """A table or a map of corrections."""

    __slots__ = ()

    def __neg__(self) -> Self:
        """Return the corrections with the other sign."""
        made: Any = replace(cast(Any, self), **{k: -v for k, v in self._entries().items()})
        return cast(Self, made)

    def __add__(self, other: Any) -> Self:
        """Return the sum of the entries of two of the same axes and positions, u added in squares.

        What a new table does on top of an active one is another thing: `combine_tables`.
        """
        if type(other) is not type(self):
            return NotImplemented
        same_key = (
            "positions", "x", "y", "axis", "axes", "compensates", "reference", "heat", "border",
            "reference_direction", "removed",
        )  # fmt: skip
        for key in (k for k in same_key if hasattr(self, k)):
            if not same(getattr(self, key), getattr(other, key)):
                raise DataError(
                    f"{key} of the two differ; only tables of the same axes and positions add with + "
                    "(combine_tables joins others)"
                )
        mine, theirs = self._entries(), other._entries()
        total = {
            k: (mine[k] if k in mine else mine["forward"])
            + (theirs[k] if k in theirs else theirs["forward"])
            for k in {**mine, **theirs}
        }
        one, two = getattr(self, "u", None), getattr(other, "u", None)
        spread = None if one is None or two is None else np.hypot(one, two)
        known: dict[str, Any] = {
            "u": spread, "covariances": {}, "source": None, "is_exact_inverse": False,
            "history": (*getattr(self, "history", ()), Step("add", {"entries": "of two tables"})),
        }  # fmt: skip
        held = {k: v for k, v in known.items() if hasattr(self, k)}
        made: Any = replace(cast(Any, self), **total, **held)
        return cast(Self, made)

    def _entries(self) -> dict[str, FloatArray]:
        """Return the columns of corrections."""
        found = {k: getattr(self, k, None) for k in ("forward", "reverse", "values")}
        return {k: v for k, v in found.items() if v is not None}

    def exact_inverse(self) -> Self:
        """Return the corrections with c(p) = -e(p + c(p)), taking the present ones as -e.

        Returns
        -------
        CompensationTable or CompensationMap
            Itself, if it is exact already or corrects an axis that is not looked up.

        Raises
        ------
        TableError
            If the corrections are too steep to invert.
        NotConvergedError
            If the exact inverse does not settle.
        """
        raise NotImplementedError

    if TYPE_CHECKING:  # what each knows of its own axes

        def limits(self, limits: Limits | None = None, **more: Any) -> tuple[Finding, ...]: ...

    def require_limits(self, limits: Limits, **more: Any) -> tuple[Finding, ...]:
        """Return the warnings, and refuse on an error.

        Parameters
        ----------
        limits : Limits
            Of machine and controller.
        **more
            Of a map ``feeds``, as for its `limits`.

        Returns
        -------
        tuple of Finding
            The findings that are not errors.

        Raises
        ------
        LimitError
            If a limit is exceeded.
        """
        return require_findings(self.limits(limits, **more))

    def negated(self) -> Self:
        """Return the corrections with the sign reversed, for tests of sign checks.

        Returns
        -------
        CompensationTable or CompensationMap
            It doubles the error.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong or uncertain.

    Parameters
    ----------
    level : {"error", "warning"}
        Errors refuse a table, warnings are recorded.
    problem : str
        What, with numbers.
    fix : str
        What to do.
    check : str, optional
        Name of the check, by which it can be waived.
    hint : mapping, optional
        What mends it where a value is known: keys of the table, or facts of the controller.
    """

    level: Literal["error", "warning"]
    problem: str
    fix: str
    check: str = ""
    hint: Mapping[str, Any] | None = field(default=None, compare=False)

    @classmethod
    def error(cls, problem: str, fix: str, check: str = "") -> Finding:
        """Return what refuses a table.

        Parameters
        ----------
        problem, fix, check : str
            As of the class.

        Returns
        -------
        Finding
            Of the level "error".
        """
        return cls("error", problem, fix, check)

    @classmethod
    def warning(cls, problem: str, fix: str, check: str = "") -> Finding:
        """Return what is recorded.

        Parameters
        ----------
        problem, fix, check : str
            As of the class.

        Returns
        -------
        Finding
            Of the level "warning".
        """
        return cls("warning", problem, fix, check)


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a machine and its controller, SI; None means not checked.

    Parameters
    ----------
    max_points : int, optional
        Entries the controller takes.
    stroke : float, m, optional
        Largest correction the actuator or controller allows, absolute.
    feed : float, m/s, optional
        Largest feed of the looked-up axis.
    velocity_share : float, m/s, optional
        Speed of the corrected axis that the correction may use.
    acceleration_share : float, m/s^2, optional
        Acceleration that the correction may use.
    reversal_jump : float, m, optional
        Largest step of the correction at a reversal (following-error limit).
    acceleration : float, m/s^2, optional
        LinuxCNC's MAX_ACCELERATION of the joint, for its dead zone.
    servo_period : float, s, optional
        LinuxCNC's servo period, for its dead zone.
    travel_low, travel_high : float, m, optional
        Commanded travel of the looked-up axis that the table must cover.
    soft_low, soft_high : float, m, optional
        Software limits of the corrected axis: the travel keeps the stroke as a margin to them.
    """

    max_points: int | None = None
    stroke: float | None = None
    feed: float | None = None
    velocity_share: float | None = None
    acceleration_share: float | None = None
    reversal_jump: float | None = None
    acceleration: float | None = None
    servo_period: float | None = None
    travel_low: float | None = None
    travel_high: float | None = None
    soft_low: float | None = None
    soft_high: float | None = None


def coarse_finding(error: float | None, corrections: FloatArray, what: str) -> tuple[Finding, ...]:
    """Return a warning where the interpolation error is more than a tenth of the corrections' span."""
    span = float(np.ptp(corrections))
    if error is None or error <= _COARSE * span:
        return ()
    nodes = "entries" if what == "table" else "nodes"
    text = (
        f"between the {nodes} the {what} misses the error by up to {format_length(error, digits=2)}, "
        f"its corrections span {format_length(span, digits=3)}"
    )
    return (Finding.warning(text, "use a finer spacing", "coarse"),)


def dead_zone(acceleration: float, servo_period: float) -> tuple[float, float]:
    """Return the steps of a correction that LinuxCNC never executes from rest.

    Parameters
    ----------
    acceleration : float, m/s^2
        MAX_ACCELERATION of the joint.
    servo_period : float, s
        Servo period T.

    Returns
    -------
    tuple of (float, float), m
        A step s with ``0.25 a T^2 < s <= 0.5 a T^2`` stays where it is.

    Notes
    -----
    The correction is ramped with half the acceleration of the joint; a step in this window puts
    the ramp into its constant-velocity branch at velocity zero. Seen on LinuxCNC 2.9: a = 1 m/s^2,
    T = 1 ms: 0.2 um applied, 0.4 and 0.5 um stuck, 0.6 um applied.

    Examples
    --------
    >>> [round(v * 1e6, 6) for v in dead_zone(1.0, 1e-3)]
    [0.25, 0.5]
    """
    a = numbers.real(acceleration, "acceleration", dimension="acceleration")
    product = a * numbers.quantity(servo_period, "servo_period", "time") ** 2
    return 0.25 * product, 0.5 * product


def check_limits(
    positions: FloatArray,
    forward: FloatArray,
    reverse: FloatArray | None,
    limits: Limits,
    *,
    on_axis: bool,
) -> tuple[Finding, ...]:
    """Return what is wrong or uncertain about corrections.

    Parameters
    ----------
    positions, forward : ndarray, shape (n,), m
        Entries.
    reverse : ndarray or None, shape (n,), m
        Entries of the reverse direction.
    limits : Limits
        What is allowed.
    on_axis : bool
        Whether the corrected axis is the looked-up one.

    Returns
    -------
    tuple of Finding
        Empty if nothing is wrong.
    """
    columns = [forward] if reverse is None else [forward, reverse]
    findings: list[Finding] = []
    if limits.max_points is not None and positions.size > limits.max_points:
        findings.append(
            Finding.error(
                f"{positions.size} points, the controller takes {limits.max_points}",
                "use a coarser spacing",
                "points",
            )
        )
    findings += stroke_finding(max(float(np.abs(c).max()) for c in columns), limits)
    findings += _slopes(positions, columns, limits, on_axis=on_axis)
    if reverse is not None:
        findings += _reversal(forward, reverse, limits)
    return tuple(findings)


def stroke_finding(largest: float, limits: Limits) -> list[Finding]:
    """Return an error where the largest correction is above the stroke."""
    if limits.stroke is None or largest <= limits.stroke:
        return []
    text = (
        f"the largest correction is {format_length(largest)}, the stroke "
        f"{format_length(limits.stroke)}"
    )
    fix = "remove alignment from the error or use an axis with more stroke"
    return [Finding.error(text, fix, "stroke")]


def slope_finding(steepest: float, fall: float, along: str = "") -> list[Finding]:
    """Return an error where the command turns back (`fall`, of an axis along itself), or that it is steep."""
    if fall >= 1.0:
        text = (
            f"{along}the correction falls by {fall:.3g} m per m: the corrected command turns back"
        )
        return [Finding.error(text, "check the units of position and error", "turning-back")]
    if steepest <= _STEEP:
        return []
    text = f"{along}the correction changes by {steepest:.3g} m per m"
    fix = "check the units; a geometric error is rarely steeper than 1e-3"
    return [Finding.warning(text, fix, "steepness")]


def _slopes(
    positions: FloatArray, columns: list[FloatArray], limits: Limits, *, on_axis: bool
) -> Iterator[Finding]:
    steps = np.diff(positions)
    slopes = [np.diff(c) / steps for c in columns]
    slope = max(float(np.abs(s).max()) for s in slopes)
    yield from slope_finding(slope, -min(float(s.min()) for s in slopes) if on_axis else 0.0)
    if limits.feed is None:
        return
    allowed, found = limits.feed, []
    fix = "drive slower or drop the shortest wavelengths (shortest=)"
    at = f"at {limits.feed * 6e4:.6g} mm/min the correction"
    if limits.velocity_share is not None:
        speed = slope * limits.feed
        if speed > limits.velocity_share:
            allowed = limits.velocity_share / slope
            text = f"moves with {speed * 6e4:.4g} mm/min, allowed are {limits.velocity_share * 6e4:.4g}"
            found.append(Finding.error(f"{at} {text}", fix, "velocity"))
    if limits.acceleration_share is not None and steps.size > 1:
        middle = 0.5 * (steps[1:] + steps[:-1])
        curvature = max(float(np.abs(np.diff(s) / middle).max()) for s in slopes)
        acceleration = curvature * limits.feed**2
        if acceleration > limits.acceleration_share:
            allowed = min(allowed, math.sqrt(limits.acceleration_share / curvature))
            text = f"accelerates with {acceleration:.3g} m/s2, allowed are {limits.acceleration_share:.3g}"
            found.append(Finding.error(f"{at} {text}", fix, "acceleration"))
    yield from (replace(f, hint=_slower(allowed)) for f in found)


def _slower(feed: float) -> dict[str, str] | None:
    """Return the largest feed of three digits below one in m/s."""
    rounded = Context(prec=3, rounding=ROUND_DOWN).create_decimal(feed * 6e4 * (1.0 - 1e-12))
    return {"feed": f"{float(rounded):.6g} mm/min"} if rounded > 0 else None


def _reversal(forward: FloatArray, reverse: FloatArray, limits: Limits) -> Iterator[Finding]:
    jumps = np.abs(forward - reverse)
    if limits.reversal_jump is not None and float(jumps.max()) > limits.reversal_jump:
        jump = format_length(float(jumps.max()))
        found = Finding.error(
            f"the correction jumps by {jump} at a reversal, allowed are {format_length(limits.reversal_jump)}",
            "write one column for both directions, and put the lost motion into the controller's "
            "backlash parameter",
            "reversal",
        )
        yield replace(found, hint={"direction": "both"})
    if limits.acceleration is not None and limits.servo_period is not None:
        low, high = dead_zone(limits.acceleration, limits.servo_period)
        stuck = int(((jumps > low * (1 - _EDGE)) & (jumps <= high * (1 + _EDGE))).sum())
        if stuck:
            yield Finding.warning(
                f"at {stuck} of {jumps.size} positions the step at reversal lies between "
                f"{format_length(low)} and {format_length(high)}, which LinuxCNC never executes from rest",
                "raise MAX_ACCELERATION of the joint, which moves the window",
                "dead-zone",
            )


def require_findings(findings: tuple[Finding, ...], *, waive: bool = False) -> tuple[Finding, ...]:
    """Return findings, and refuse errors unless they are waived.

    Examples
    --------
    >>> require_findings(())
    ()
    """
    errors = [f for f in findings if f.level == "error"]
    if errors and not waive:
        raise LimitError("; ".join(f"{f.problem}: {f.fix}" for f in errors))
    return findings
