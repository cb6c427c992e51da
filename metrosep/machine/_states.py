"""Private helper: where the frames of a chain stand at given positions, seen from the workpiece.

Of each frame only two things are needed: the directions of its axes in workpiece coordinates, and
the lever, the tool point in the frame itself. Either is gathered from its own end of the chain, so
that a lever that is zero by construction is a plain 0 and costs nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine import _poses as ps
from metrosep.machine._numbers import positions_array
from metrosep.machine.elements import Element

Frame = tuple[str, str]  # element, "before" or "after" its motion


class States:
    """Frames and levers of a chain at the states asked for."""

    def __init__(
        self, elements: Sequence[Element], positions: Mapping[str, FloatArray], tool: FloatArray
    ) -> None:
        inputs = {**positions, **{f"tool {'xyz'[k]}": tool[..., k] for k in range(3)}}
        self.shape = _shape(inputs)
        self._with_nan = [values for values in inputs.values() if np.isnan(np.sum(values))]
        self.active = set(positions) | {e.name for e in elements if e.kind == "fixed"}
        self.moves = {
            e.name: motion(e, ps.as_part(positions.get(e.name, np.zeros(())))) for e in elements
        }
        tools = [e for e in elements if e.branch == "tool"]
        works = [e for e in elements if e.branch == "workpiece"]
        self.levers: dict[Frame, ps.Vector] = {}
        self.turned: dict[Frame, ps.Matrix] = {}
        self.tool: ps.Vector = (_part(tool, 0), _part(tool, 1), _part(tool, 2))
        point = self._levers_of_tool(tools, self.tool)
        self.point = self._levers_of_workpiece(works, point)
        bed = self._turns_of_workpiece(works)
        self.tool_turn = self._turns_of_tool(tools, bed)

    def _levers_of_tool(self, elements: Sequence[Element], point: ps.Vector) -> ps.Vector:
        """Go from the tool to the bed; return the tool point in the bed."""
        for e in reversed(elements):
            self.levers[e.name, "after"] = point
            point = ps.apply(self.moves[e.name], point)
            self.levers[e.name, "before"] = point
            point = ps.add(point, triple(e.location))
        return point

    def _levers_of_workpiece(self, elements: Sequence[Element], point: ps.Vector) -> ps.Vector:
        """Go from the bed to the workpiece; return the tool point in the workpiece."""
        for e in elements:
            point = ps.subtract(point, triple(e.location))
            self.levers[e.name, "before"] = point
            point = ps.apply(ps.inverse(self.moves[e.name]), point)
            self.levers[e.name, "after"] = point
        return point

    def _turns_of_workpiece(self, elements: Sequence[Element]) -> ps.Matrix:
        """Go from the workpiece to the bed; return the directions of the bed."""
        turned = ps.UNIT
        for e in reversed(elements):
            self.turned[e.name, "after"] = turned
            turned = ps.matmul(turned, ps.transpose(self.moves[e.name].r))
            self.turned[e.name, "before"] = turned
        return turned

    def _turns_of_tool(self, elements: Sequence[Element], turned: ps.Matrix) -> ps.Matrix:
        """Go from the bed to the tool; return the directions of the tool."""
        for e in elements:
            self.turned[e.name, "before"] = turned
            turned = ps.matmul(turned, self.moves[e.name].r)
            self.turned[e.name, "after"] = turned
        return turned

    def read_lever(self, element: Element) -> ps.Vector:
        """Return the tool point from where the error motions of an element were read."""
        return ps.subtract(self.levers[element.name, element.frame], triple(element.measured_at))

    def six(self, element: Element, frame: str, lever: ps.Vector) -> list[ps.Vector]:
        """Return ``sign W^-1 A hat(e_j) A^-1 p`` for the six directions of one frame A."""
        turned = self.turned[element.name, frame]
        sign = 1.0 if element.branch == "tool" else -1.0
        turns = [ps.turn(turned, ps.cross(axis, lever)) for axis in ps.UNIT]
        return [ps.scale(column, sign) for column in (*ps.transpose(turned), *turns)]

    def poison(self, out: FloatArray) -> None:
        """Write NaN in every state in which a position or the tool point is NaN."""
        if self._with_nan:
            bad = np.zeros(self.shape, dtype=bool)
            for values in self._with_nan:
                bad |= np.isnan(values)
            out[..., bad] = np.nan


def motion(element: Element, position: ps.Part) -> ps.Pose:
    """Return the nominal motion M of an element at its position."""
    if element.kind == "linear":
        return ps.Pose(t=ps.scale(triple(element.direction), position))
    angle = element.angle if element.kind == "fixed" else position
    if isinstance(angle, float) and angle == 0.0:
        return ps.Pose()
    return ps.Pose(r=ps.rotation(element.direction, angle))


def positions_of(
    elements: Sequence[Element], q: Mapping[str, ArrayLike], chain: str
) -> dict[str, FloatArray]:
    """Return the positions as arrays; a parked axis that is missing stays missing."""
    if not isinstance(q, Mapping):
        raise DataError(f"positions are a mapping of axis names, got {type(q).__name__}")
    moving = [e for e in elements if e.kind != "fixed"]
    for name in q:
        if name not in [e.name for e in moving]:
            known = ", ".join(e.name for e in moving)
            raise DataError(f"chain {chain!r} has no axis {name!r}; its axes are {known}")
    positions = {}
    for e in moving:
        if e.name in q:
            positions[e.name] = positions_array(q[e.name], f"position of axis {e.name!r}")
        elif not e.parked:
            raise DataError(
                f"the position of axis {e.name!r} of chain {chain!r} is missing; "
                f"q holds {', '.join(q) or 'nothing'}"
            )
    return positions


def tool_point(tool: ArrayLike) -> FloatArray:
    """Return the tool point as an array (..., 3)."""
    point = positions_array(tool, "tool point")
    if point.ndim == 0 or point.shape[-1] != 3:
        raise InvalidSamplesError(f"a tool point has 3 coordinates in m, got shape {point.shape}")
    return point


def triple(values: Sequence[float]) -> ps.Vector:
    """Return three numbers as a vector."""
    return values[0], values[1], values[2]


def _part(tool: FloatArray, k: int) -> ps.Part:
    return ps.as_part(np.asarray(tool[..., k]))


def _shape(arrays: Mapping[str, FloatArray]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(np.shape(a) for a in arrays.values()))
    except ValueError:
        shapes = ", ".join(f"{n} {np.shape(a)}" for n, a in arrays.items())
        raise InvalidSamplesError(f"positions and tool do not broadcast: {shapes}") from None
