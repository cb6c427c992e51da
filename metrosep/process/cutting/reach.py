"""What a job can reach: the travel of X and Z of its machine, and a map without holes."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.units import format_ends, format_length
from metrosep.forms.base import Form
from metrosep.forms.stl import GridForm, MeshForm
from metrosep.process.cutting.programs import AxisCourse, TurningProgram

Travel = tuple[float, float]
"""m: the least and the largest place."""
_BLOCK = 1 << 18
_ROUNDED = 1e-6
"""STL holds floats of four bytes: a mesh that ends at the rim ends this near to it."""
_KEPT = 1e-12
"""m: a place that far beyond an end is on it."""


def checked_travel(given: object, name: str) -> Travel | None:
    """Return the least and the largest place of an axis, None where it has no ends."""
    if given is None:
        return None
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise DataError(f"{name} is two lengths, the least and the largest place, got {given!r}")
    low, high = (numbers.quantity(v, name, "length") for v in given)
    if not low < high:
        raise DataError(
            f"{name} goes from {format_length(low)} to {format_length(high)}: give the least place first"
        )
    return low, high


def require_no_hole(form: Form, core: float, radius: float) -> None:
    """Refuse a map or mesh with a hole in the ring that is to be cut: what lies there is not known, and not air."""
    if isinstance(form, MeshForm):
        x, y = form.border
        rho = np.hypot(x, y)
        inside = np.flatnonzero(
            (rho < radius * (1.0 - _ROUNDED)) & (rho > core * (1.0 + _ROUNDED))
        )
        if inside.size:
            at = inside[np.argmin(rho[inside])]
            raise InvalidSamplesError(
                f"the mesh ends, or has a hole, at rho = {format_length(float(rho[at]))}, azimuth "
                f"{math.degrees(math.atan2(y[at], x[at])) % 360.0:.4g} degrees, within the part, and what it does not "
                "hold is not air: the tool would plunge there. Close the mesh, or end the path before it (core, radius)"
            )
    for x, y in form.holes() if isinstance(form, GridForm) else ():
        # a missing pixel takes the cells around it along
        step = math.hypot(form.surface.dx or 0.0, form.surface.dy or 0.0)  # type: ignore[attr-defined]
        rho = np.hypot(x, y)
        in_ring = (rho < radius + step) & (rho > core - step)
        if in_ring.any():
            at = int(np.argmax(in_ring))
            wide = format_length(float(max(np.ptp(x), np.ptp(y))) + step)
            raise InvalidSamplesError(
                f"the map has a hole of {x.size} pixels ({wide} wide) at rho = {format_length(float(rho[at]))}, "
                f"azimuth {math.degrees(math.atan2(y[at], x[at])) % 360.0:.4g} degrees, within the part, and a "
                "hole in a measurement is not air: the tool would plunge into it. Fill it with what "
                "belongs there, or end the path before it (core, radius)"
            )


def require_travel(program: TurningProgram, x: Travel | None, z: Travel | None) -> None:
    """Refuse a program whose tip leaves the travel of X or Z, at its points or between two."""
    said = []
    for name, axis, ends in (("X", 0, x), ("Z", 2, z)):
        for side, word in ((-1.0, "below"), (1.0, "above")) if ends else ():
            end = ends[0] if side < 0.0 else ends[1]  # type: ignore[index]  # there are ends
            far, block = max(
                (float(v.max()), first + int(np.argmax(v)))
                for first, places in _furthest(program, axis, side)
                for v in (side * (places - end),)
            )
            if far > _KEPT:
                said.append(
                    f"{name} goes {format_length(far)} {word} its travel ({format_ends(*ends, between=' to ')}) in "  # type: ignore[misc]
                    f"block {block}, at X = {format_length(float(program.X[block]))}, azimuth "
                    f"{math.degrees(float(program.azimuth[block])) % 360.0:.4g} degrees"
                )
    if said:
        raise LimitError(
            f"{'; '.join(said)}: the machine cannot run this program; set the part elsewhere, or make the path "
            "shorter (radius, core, lead_in)"
        )


def _furthest(program: TurningProgram, axis: int, side: float) -> Iterator[tuple[int, FloatArray]]:
    """Yield the first block of pieces, and the place of each block that is furthest to a side."""
    for first in range(0, len(program) - 1, _BLOCK):
        course = AxisCourse.of(program, slice(first, min(first + _BLOCK, len(program) - 1) + 1))
        p = course.values[axis]
        found = side * np.maximum(side * p[:-1], side * p[1:])
        if course.slopes is not None:
            T, D, v = np.diff(course.t), np.diff(p), course.slopes[axis]
            a, b = T * v[:-1] - D, D - T * v[1:]
            # dp/ds = D + a (1 - s)(1 - 3 s) + b s (2 - 3 s): where a cubic turns inside its block
            square, linear, whole = 3.0 * (a - b), 2.0 * b - 4.0 * a, D + a
            block = np.arange(D.size)
            with np.errstate(divide="ignore", invalid="ignore"):
                q = -0.5 * (
                    linear + np.copysign(np.sqrt(linear**2 - 4.0 * square * whole), linear)
                )
                roots = q / square, whole / q
            for s in roots:
                turned = course.value(axis, block, np.where((s > 0.0) & (s < 1.0), s, 0.0))
                found = side * np.maximum(side * found, side * turned)
        yield first, found
