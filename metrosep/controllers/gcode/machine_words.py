"""Words of a program as positions of the axes of a machine, and what is added to them.

A word is the command of an axis, machine position = word + `zero`; of X its double where the program
has diameters. Under tool-centre-point control (G43.4, TRAORI) X, Y and Z are the place of the tool on
the part, in coordinates that turn with it and agree with the words of the axes where the words of the
axes of rotation are 0: with the pose there, place t and directions M of the linear axes in the
workpiece, the tool stands at ``t + M w``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.machine.elements import axis_of
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.inverse import AT_ONCE, Course, inverse_kinematics, reach_of
from metrosep.machine.terms import FourierTerm, SumTerm, TableTerm

if TYPE_CHECKING:
    from metrosep.machine.chains import Chain, Errors

_LOOK_LENGTH, _LOOK_TURN = 1e-3, math.radians(1.0)
"""m, rad: a move is looked at this often between its ends, and in each of its parts this often."""
_PER_STEP = 4.0
"""Looks in each step of a table of errors, and in a quarter of the shortest wave of a series."""


class MachineWords:
    """The machine, for places in units of the file and degrees; `part` says which are on the part."""

    def __init__(
        self,
        chain: Chain,
        errors: Errors,
        tool: ArrayLike,
        tool_axis: ArrayLike,
        max_step: float | None,
        axes: tuple[str, ...],
        unit: float,
        offset: Mapping[str, float],
        *,
        diameter: bool,
        on_part: bool,
    ) -> None:
        self.chain, self.errors, self.tool = chain, errors, tool
        self.tool_axis, self.axes = tool_axis, axes
        kinds = chain.dimensions
        self.turns = np.array([kinds[a] == "angle" for a in axes])
        lengths = np.array([0.5 * unit if diameter and a == "X" else unit for a in axes])
        self.scale = np.where(self.turns, math.pi / 180.0, lengths)
        self.offset = np.array([offset[a] for a in axes])
        default = np.where(self.turns, _LOOK_TURN, _LOOK_LENGTH)
        fine = dict.fromkeys(axes, math.inf)
        for name, term in (errors.terms if isinstance(errors, ErrorSet) else errors).items():
            axis = axis_of(name)
            if axis in fine:
                fine[axis] = min(fine[axis], _step_of(term) / _PER_STEP)
        self.look = np.minimum(default, [fine[a] for a in axes])
        self.course = Course(chain, errors, axes, tool, tool_axis, max_step)
        if on_part:
            self._place_on_part()

    def _place_on_part(self) -> None:
        """Find where words of the part are: the pose at which they are those of the axes."""
        linear = [a for a, turns in zip(self.axes, self.turns, strict=True) if not turns]
        if linear != ["X", "Y", "Z"]:
            raise DataError(
                f"tool-centre-point control needs the linear axes X, Y, Z; the machine has {', '.join(linear)}"
            )
        at = {a: np.asarray(v) for a, v in zip(self.axes, self.offset, strict=True)}
        self._begin = self._tip(at)
        self._ways = np.stack(
            [self._tip({**at, a: at[a] + 1.0}) - self._begin for a in linear], axis=-1
        )

    def _tip(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Return where the tool stands on the part, (..., 3)."""
        return np.asarray(self.chain.transform(q, tool=self.tool)[..., :3, 3])

    def si(self, places: FloatArray, part: NDArray[np.bool_]) -> dict[str, FloatArray]:
        """Return positions by axis, m and rad."""
        q = {a: places[:, i] * self.scale[i] + self.offset[i] for i, a in enumerate(self.axes)}
        if part.any():
            words = places[part][:, ~self.turns] * self.scale[~self.turns]
            turned = {
                a: q[a][part] for a, turns in zip(self.axes, self.turns, strict=True) if turns
            }
            found = inverse_kinematics(
                self.chain, self._begin + words @ self._ways.T, tool=self.tool, **turned
            )
            for a in "XYZ":
                q[a][part] = found[a]
        return q

    def at(self, places: FloatArray, part: NDArray[np.bool_]) -> FloatArray:
        """Return what is added to the words at places."""
        q = self.si(places, part)
        course = Course(self.chain, self.errors, self.axes, self.tool, self.tool_axis, None)
        moved = [
            course.corrected({a: v[i : i + AT_ONCE] for a, v in q.items()}).moved
            for i in range(0, len(places), AT_ONCE)
        ]
        commands = {a: np.concatenate([m[a] for m in moved]) for a in self.axes}
        return self._added(places, part, commands, q)

    def along(
        self, places: FloatArray, part: NDArray[np.bool_]
    ) -> tuple[FloatArray, dict[str, FloatArray]]:
        """Return what is added to the words of the next poses of the path, and to the axes in m and rad."""
        q = self.si(places, part)
        moved = self.course.corrected(q).moved
        return self._added(places, part, moved, q), {a: moved[a] - q[a] for a in self.axes}

    def _added(
        self,
        places: FloatArray,
        part: NDArray[np.bool_],
        moved: Mapping[str, FloatArray],
        q: Mapping[str, FloatArray],
    ) -> FloatArray:
        added = np.stack([moved[a] - q[a] for a in self.axes], axis=-1) / self.scale
        if part.any():
            tip = self._tip({a: v[part] for a, v in moved.items()})
            words = np.linalg.solve(self._ways, (tip - self._begin).T).T / self.scale[~self.turns]
            added[np.ix_(part, ~self.turns)] = words - places[part][:, ~self.turns]
        return added

    def missed(
        self, nominal: FloatArray, commands: FloatArray, part: NDArray[np.bool_]
    ) -> FloatArray:
        """Return by how much the tool point misses its nominal place, m, where linear axes can help."""
        q = self.si(nominal, part)
        commanded = self.si(commands, part)
        actual = self.chain.transform(commanded, self.errors, tool=self.tool, exact=True)
        off = actual[..., :3, 3] - self._tip(q)
        reach = reach_of(self.chain, q)
        if reach is not None:
            off = (reach @ off[..., None])[..., 0]
        return np.asarray(np.linalg.norm(off, axis=-1))


def _step_of(term: object) -> float:
    """Return the length over which an error may bend, m or rad; infinite where it does not say."""
    if isinstance(term, SumTerm):
        return min(map(_step_of, term.parts))
    if isinstance(term, FourierTerm):
        return min(term.wavelengths) / 4.0
    if isinstance(term, TableTerm) and len(term.positions) > 2:
        x = np.asarray(term.positions)
        return float((x[2:] - x[:-2]).min()) / 2.0  # two: a corner beside a node is no wave
    return math.inf
