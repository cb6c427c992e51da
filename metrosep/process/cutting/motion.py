"""What the axes of a program must do: velocity, acceleration and jerk of X, C and Z, and the speed they allow.

Between blocks the axes run as the program says (lines, spline, PVT). A spline and PVT are cubics in
time: the acceleration of a block is largest at an end, its jerk is constant. Lines have corners: the
velocity jumps, and the acceleration has no bound. Scaling the speed of the entire program by q scales
velocity by q, acceleration by q^2 and jerk by q^3. specs/cutting-path.md, section 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, LimitError
from metrosep.core.units import format_length
from metrosep.process._plain import Frozen
from metrosep.process.cutting.programs import AxisCourse, TurningProgram

AXES = {"X": 0, "C": 1, "Z": 2}
_POWERS = {"velocity": 1, "acceleration": 2, "jerk": 3}
_BLOCK = 1 << 18
_KEPT = 1e-9
"""Relative: a value on a limit keeps it."""


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """What an axis can do; infinite where it is not limited.

    Parameters
    ----------
    velocity : float, m/s (C: rad/s), optional
        Largest.
    acceleration : float, m/s^2 (C: rad/s^2), optional
        Largest.
    jerk : float, m/s^3 (C: rad/s^3), optional
        Largest.

    Raises
    ------
    InvalidSamplesError
        If a limit is not above zero.
    """

    velocity: float = math.inf
    acceleration: float = math.inf
    jerk: float = math.inf

    def __post_init__(self) -> None:
        for own in fields(self):
            value = getattr(self, own.name)
            if value != math.inf:
                object.__setattr__(self, own.name, numbers.positive(value, own.name))


@dataclass(frozen=True, slots=True)
class AxisMotion(Frozen):
    """Largest values of the axes along a program.

    Parameters
    ----------
    largest : mapping of str to mapping
        Of X, Z (m) and C (rad): ``velocity``, ``acceleration``, ``jerk``, each per s, s^2, s^3, and
        ``jump``: of the velocity with lines, of the acceleration otherwise, from block to block.
    block : mapping of str to mapping
        Number of the block in which each occurs.
    rpm : float, 1/min
        Mean spindle speed of the program.
    rpm_max : float, 1/min
        At which all limits hold; infinite without limits.
    binding : str
        The limit that allows the least, such as "jerk of Z"; empty without limits.
    exceeded : tuple of str
        Every limit that is not kept, with value, place and the speed that would keep it.
    messages : tuple of str
        What to know.
    """

    largest: Mapping[str, Mapping[str, float]]
    block: Mapping[str, Mapping[str, int]]
    rpm: float
    rpm_max: float
    binding: str
    exceeded: tuple[str, ...]
    messages: tuple[str, ...] = ()

    @property
    def is_ok(self) -> bool:
        """Whether all limits are kept."""
        return not self.exceeded

    def require(self) -> None:
        """Raise what is exceeded as an error.

        Raises
        ------
        LimitError
            If a limit is not kept.
        """
        if self.exceeded:
            raise LimitError("; ".join(self.exceeded))


def axis_motion(
    program: TurningProgram,
    limits: Mapping[str, AxisLimits] | None = None,
    *,
    block_time: float = 0.0,
) -> AxisMotion:
    """Return what the axes must do along a program, and the spindle speed that their limits allow.

    Parameters
    ----------
    program : TurningProgram
        With times.
    limits : mapping of str to AxisLimits, optional
        For any of X, C and Z.
    block_time : float, s, optional
        Shortest time of a block in the control.

    Returns
    -------
    AxisMotion
        Largest values, where they occur, and the speed.

    Raises
    ------
    DataError
        If the program is none, an axis is not one of X, C and Z, or acceleration or jerk is limited and
        the points are joined by lines, which have corners.

    Examples
    --------
    >>> turn = np.linspace(0.0, 4.0 * np.pi, 721)
    >>> program = TurningProgram(2e-3 + 0 * turn, turn, 1e-6 * np.cos(2 * turn), turn / (2 * np.pi), "tip")
    >>> found = axis_motion(program, {"Z": AxisLimits(acceleration=1e-3)})
    >>> round(found.largest["Z"]["acceleration"] * 1e6), round(found.rpm_max), found.binding
    (158, 151, 'acceleration of Z')
    """
    if not isinstance(program, TurningProgram):
        raise DataError(f"the program must be a TurningProgram, got {type(program).__name__}")
    given = dict(limits or {})
    for axis, own in given.items():
        numbers.choice(axis, "an axis of the limits", tuple(AXES))
        if not isinstance(own, AxisLimits):
            raise DataError(f"the limits of {axis} must be AxisLimits, got {type(own).__name__}")
    least = numbers.not_negative(block_time, "block_time", dimension="time")
    found: dict[str, dict[str, float]] = {a: {} for a in AXES}
    where: dict[str, dict[str, int]] = {a: {} for a in AXES}
    for first in range(0, len(program) - 1, _BLOCK):
        course = AxisCourse.of(program, slice(first, min(first + _BLOCK, len(program) - 1) + 1))
        for axis, number in AXES.items():
            for name, values in _values(course, number).items():
                at = int(np.argmax(values))
                if values[at] >= found[axis].get(name, 0.0):
                    found[axis][name], where[axis][name] = float(values[at]), first + at
    rpm, allowed, binding, exceeded = program.rpm, math.inf, "", []
    for axis, own in given.items():
        unit = "rad" if axis == "C" else "m"
        for name, power in _POWERS.items():
            limit = getattr(own, name)
            if limit == math.inf:
                continue
            if name not in found[axis]:
                raise DataError(
                    f"a limit of the {name} of {axis} cannot be judged: lines meet in corners, where the "
                    f"{name} is what the control makes of it; give limits of the velocity only, or judge a "
                    "program of PVT or of a spline"
                )
            value = found[axis][name]
            own_rpm = math.inf if value == 0.0 else rpm * (limit / value) ** (1.0 / power)
            if own_rpm < allowed or not binding:
                allowed, binding = own_rpm, f"{name} of {axis}"
            if value > limit * (1.0 + _KEPT):
                at = where[axis][name]
                per = "/s" if power == 1 else f"/s^{power}"
                exceeded.append(
                    f"{name} of {axis} is {value:.4g} {unit}{per} in block {at} at X = "
                    f"{format_length(float(program.X[at]))}, azimuth "
                    f"{math.degrees(float(program.azimuth[at])) % 360.0:.4g} degrees; the limit is {limit:.4g}: "
                    f"{own_rpm:.4g} rpm instead of {rpm:.4g} would keep it"
                )
    shortest = float(np.diff(program.t).min())
    if least and rpm * shortest / least < allowed:
        allowed, binding = rpm * shortest / least, "time of a block"
    if least and shortest < least * (1.0 - _KEPT):
        exceeded.append(
            f"a block lasts {1e3 * shortest:.4g} ms, the control needs {1e3 * least:.4g} ms: "
            f"{rpm * shortest / least:.4g} rpm instead of {rpm:.4g} would keep it"
        )
    said = []
    if program.interpolation == "linear":
        said.append(
            "lines meet in corners: the velocity jumps there, by up to "
            f"{1e3 * found['Z'].get('jump', 0.0):.3g} mm/s of Z, and the acceleration is what the control "
            "makes of it"
        )
    elif program.interpolation == "pvt":
        said.append(
            "PVT keeps position and velocity; the acceleration jumps between blocks, by up to "
            f"{found['Z'].get('jump', 0.0):.3g} m/s^2 of Z"
        )
    return AxisMotion(found, where, rpm, allowed, binding, tuple(exceeded), tuple(said))


def _values(course: AxisCourse, axis: int) -> dict[str, FloatArray]:
    """Return the largest velocity, acceleration and jerk of each block, and the jumps between them."""
    p, T = course.values[axis], np.diff(course.t)
    D = np.diff(p)
    if course.slopes is None:
        return {"velocity": np.abs(D / T), "jump": np.abs(np.diff(D / T, append=(D / T)[-1:]))}
    v = course.slopes[axis]
    v0, v1 = v[:-1], v[1:]
    # equation (21): acceleration at both ends, jerk inside
    a0 = (6.0 * D - 4.0 * T * v0 - 2.0 * T * v1) / T**2
    a1 = (-6.0 * D + 2.0 * T * v0 + 4.0 * T * v1) / T**2
    jerk = (-12.0 * D + 6.0 * T * (v0 + v1)) / T**3
    # the velocity is a parabola: its vertex counts where it lies inside the block
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(a0 * a1 < 0.0, a0 / (a0 - a1), 0.0)
    inner = v0 + a0 * share * T + 0.5 * jerk * (share * T) ** 2
    speed = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), np.abs(inner))
    jump = np.abs(np.append(a0[1:] - a1[:-1], 0.0))
    return {
        "velocity": speed,
        "acceleration": np.maximum(np.abs(a0), np.abs(a1)),
        "jerk": np.abs(jerk),
        "jump": jump,
    }
