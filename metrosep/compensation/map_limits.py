"""Whether a map of corrections stays inside what a machine or a controller allows.

The slopes of a map add up: while both axes move at their feeds, the corrected axis moves with
``|dc/dx| vx + |dc/dy| vy`` at most (controllers notes, section 8, checks 5 to 9).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.limits import Finding, Limits
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.units import format_length

__all__ = ["check_map_limits", "reference_finding"]


_STEEP = 1e-3
"""Slope of a correction beyond which it is no longer metrology."""

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
    """Return what is wrong or doubtful about the corrections of a map.

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
        findings.append(_error(f"{text}{limits.max_points}", "use a coarser spacing", "points"))
    stroke = float(np.abs(values).max())
    if limits.stroke is not None and stroke > limits.stroke:
        findings.append(
            _error(
                f"the largest correction is {format_length(stroke)}, the stroke "
                f"{format_length(limits.stroke)}",
                "remove alignment from the error or use an axis with more stroke",
                "stroke",
            )
        )
    slopes = (np.diff(values, axis=1) / np.diff(x), np.diff(values, axis=0) / np.diff(y)[:, None])
    for slope, axis in zip(slopes, axes, strict=True):
        findings += _slope(slope, axis, on_axis=axis == compensates)
    return (*findings, *_motion(x, y, slopes, limits, axes, feeds or {}))


def _slope(slope: FloatArray, axis: str, *, on_axis: bool) -> list[Finding]:
    if on_axis and -float(slope.min()) >= 1.0:
        return [
            _error(
                f"along {axis} the correction falls by {-slope.min():.3g} m per m: the corrected "
                "command turns back",
                "check the units of position and error",
                "turning-back",
            )
        ]
    steepest = float(np.abs(slope).max())
    if is_rotary(axis) or steepest <= _STEEP:
        return []
    return [
        Finding(
            "warning",
            f"along {axis} the correction changes by {steepest:.3g} m per m",
            "check the units; a geometric error is rarely steeper than 1e-3",
            "steepness",
        )
    ]


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
                Finding(
                    "warning",
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
            _error(
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
        _error(
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


def _error(problem: str, fix: str, check: str) -> Finding:
    return Finding("error", problem, fix, check)


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
        Finding(
            "warning",
            f"the correction at the reference {reference} is {format_length(there, digits=3)}, not "
            "zero: the zero of the machine moves by it",
            "make the reference a node: put it among the positions of both axes",
            "reference",
        ),
    )
