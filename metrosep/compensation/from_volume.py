"""From the errors of a machine to corrections over three axes: on a grid, and as tables of one axis each.

No controller here holds a map over three axes. Where it adds several tables up, each looked-up axis
a has one for each corrected axis k, made with the other axes at the reference:

    c_k(x, y, z) = sum over a of c_k^a(q_a).

What depends on two axes at once (the lever of an angle) is left; the RMS over the volume says how much.
On a grid of (x, y, z) the corrections are exact at the nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.compensation._machine_errors import VolumetricError, volumetric_source
from metrosep.compensation.area_errors import rising
from metrosep.compensation.from_machine import (
    references,
    rms_of_vectors,
    solved,
    standing,
    tables_from_machine,
)
from metrosep.compensation.table import CompensationTable
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_length
from metrosep.machine.chains import Chain

__all__ = ["MachineVolume", "volume_from_machine"]

_AXES = 3


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class MachineVolume:
    """Corrections of a machine over three axes.

    Parameters
    ----------
    over : tuple of str
        The three axes whose positions are looked up.
    positions : tuple of ndarray, m or rad
        Nodes of each.
    corrections : mapping of str to ndarray, shape (n3, n2, n1), m
        What is added to the command of each corrected axis at the nodes, zero at the reference.
    parts : mapping of (str, str) to CompensationTable
        By looked-up and corrected axis: one table of one axis each, to be added up.
    error : ndarray, shape (n3, n2, n1, 3), m
        Error at the nodes in workpiece X, Y, Z, about the reference.
    left : ndarray, shape of error, m
        The same with `corrections` at the nodes.
    messages : tuple of str
        What no axis corrects, and other things to know.
    source : VolumetricError
        The error as a function of the commands.
    offset : mapping of str to float, m
        Error of each corrected axis at the reference, which the corrections leave.
    """

    over: tuple[str, ...]
    positions: tuple[FloatArray, ...]
    corrections: Mapping[str, FloatArray]
    parts: Mapping[tuple[str, str], CompensationTable]
    error: FloatArray
    left: FloatArray
    messages: tuple[str, ...]
    source: VolumetricError = field(repr=False)
    offset: Mapping[str, float] = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"MachineVolume({', '.join(self.over)} -> {', '.join(self.corrections)}, error "
            f"{format_length(rms_of_vectors(self.error))} RMS, left "
            f"{format_length(rms_of_vectors(self.left))})"
        )

    def residual(
        self, lookups: Mapping[tuple[str, str], Callable[..., FloatArray]] | None = None
    ) -> FloatArray:
        """Return the error at the nodes with the sum of tables active.

        Parameters
        ----------
        lookups : mapping of (str, str) to callable, optional
            What a controller adds, by looked-up and corrected axis; that of `parts` if omitted.

        Returns
        -------
        ndarray, shape (n3, n2, n1, 3), m
            In workpiece X, Y, Z, about the reference.

        Raises
        ------
        DataError
            A term is not known there.
        """
        read = {k: t.correction for k, t in self.parts.items()} if lookups is None else lookups
        q = _volume(self.over, self.positions, self.source.at)
        c = {axis: np.zeros(self.error.shape[:-1]) for axis in self.corrections}
        for (looked, axis), lookup in read.items():
            place = self.positions[self.over.index(looked)]
            shape = [1, 1, 1]
            shape[2 - self.over.index(looked)] = place.size
            c[axis] = c[axis] + np.asarray(lookup(place)).reshape(shape)
        return self.source.remaining(q, c, {a: v - self.offset[a] for a, v in c.items()})


def volume_from_machine(
    chain: Chain,
    errors: Any,
    *,
    over: Sequence[str],
    positions: Mapping[str, ArrayLike],
    corrects: Sequence[str] | None = None,
    at: Mapping[str, float] | None = None,
    reference: Sequence[float] | None = None,
    tool: ArrayLike = (0.0, 0.0, 0.0),
) -> MachineVolume:
    """Return corrections of a machine over three axes, on a grid and as tables to be added up.

    Parameters
    ----------
    chain : Chain
        The machine.
    errors : ErrorSet or mapping of str to term
        Error terms by name.
    over : sequence of str
        Three axes.
    positions : mapping of str to array_like, m or rad
        Nodes of each.
    corrects, at, tool : optional
        As for `tables_from_machine`.
    reference : three floats, m or rad, optional
        Place of zero correction; of each axis 0 if it is in range, else its first position.

    Returns
    -------
    MachineVolume
        Corrections, tables and what is left.

    Raises
    ------
    DataError
        Not three axes, or as of `tables_from_machine`.
    TableError
        Positions do not rise, a reference lies outside, or an axis would turn back.
    NotConvergedError
        The errors are so steep that the corrections do not settle.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep.machine.chains import presets
    >>> grid = {a: np.linspace(0.0, 0.1, 3) for a in "XYZ"}
    >>> volume_from_machine(presets("mill_xyz"), {"EZX": lambda x: 1e-5 * x}, over="XYZ", positions=grid)
    MachineVolume(X, Y, Z -> X, Y, Z, error 645.5 nm RMS, left 0 m)
    """
    axes = tuple(over)
    if len(axes) != _AXES or len(set(axes)) != _AXES:
        raise DataError(f"over names three different axes here; got {', '.join(axes) or 'none'}")
    missing = [a for a in axes if a not in positions or a not in chain.axes]
    if missing:
        raise DataError(
            f"{missing[0]!r} has no positions, or is not an axis of chain {chain.name!r}; its axes are "
            f"{', '.join(chain.axes)}"
        )
    grid = tuple(rising(positions[a], a) for a in axes)
    stand = standing(at, axes)
    source = volumetric_source(
        chain, errors, axes=axes, grid=grid, at=stand, corrects=corrects, tool=tool, exact=False
    )
    zero = references(axes, grid, reference)
    place = {**stand, **dict(zip(axes, zero, strict=True))}
    offset = source.in_axes(place)
    q = _volume(axes, grid, stand)
    found = solved(source, q, offset)
    c = {a: found[a] for a in (*(a for a in axes if a in found), *(set(found) - set(axes)))}
    left = source.remaining(q, c, {a: v - offset[a] for a, v in c.items()})
    error = source.remaining(q, {}, {a: -offset[a] + np.zeros(()) for a in c})
    parts: dict[tuple[str, str], CompensationTable] = {}
    for axis, nodes, here in zip(axes, grid, zero, strict=True):
        others = {a: v for a, v in place.items() if a != axis}
        made = tables_from_machine(
            chain, errors, over=axis, positions=nodes, corrects=source.names, at=others,
            reference=here, tool=tool,
        )  # fmt: skip
        for name, table in made.items():
            if isinstance(table, CompensationTable):
                parts[axis, name] = table
    return MachineVolume(
        over=axes,
        positions=grid,
        corrections=freeze_mapping(c),
        parts=MappingProxyType(parts),
        error=error,
        left=left,
        messages=source.messages,
        source=source,
        offset=freeze_mapping({a: float(v) for a, v in offset.items()}),
    )


def _volume(
    axes: tuple[str, ...], grid: tuple[FloatArray, ...], stand: Mapping[str, float]
) -> dict[str, Any]:
    """Return the commands at every node, (n3, n2, n1)."""
    mesh = np.meshgrid(*grid[::-1], indexing="ij")
    return {**stand, **dict(zip(axes, mesh[::-1], strict=True))}
