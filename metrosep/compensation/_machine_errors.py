"""Private helper: the volumetric error of a chain, or a measured one, in commands of its axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.compensation.area_errors import ErrorMap, area_error, format_position, rising
from metrosep.compensation.sampling import sample_area
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError, TableError
from metrosep.core.surface import Surface
from metrosep.machine.chains import Chain
from metrosep.machine.elements import axis_of
from metrosep.machine.error_sets import ErrorSet, as_error_set

Vectors = Callable[[Mapping[str, Any]], FloatArray]

_SINGULAR = 1e-6
"""Two axes nearer to one direction than this, in rad, cannot be stated apart."""

_IDLE = 1e-9
"""An axis or a direction whose part is smaller is not there (directions are typed to 1e-9)."""

_UNIT = 1e-6
"""m or rad: a term of which only what it moves is asked."""


@dataclass(frozen=True, slots=True, eq=False)
class VolumetricError:
    """Error of the tool point as a function of the commands, and what the axes can do about it."""

    chain: Chain
    names: tuple[str, ...]
    axes: tuple[str, ...]
    grid: tuple[FloatArray, ...]
    at: Mapping[str, float]
    tool: ArrayLike
    vectors: Vectors
    known: NDArray[np.bool_]
    errors: ErrorSet | None
    messages: tuple[str, ...]
    facts: Mapping[str, Any]

    def moved(self, q: Mapping[str, Any], c: Mapping[str, FloatArray]) -> FloatArray:
        """Return E where the axes are once the corrections are added.

        Where a correction leads out of what was measured, the error is held at the end: first of
        the looked-up axes, then of the others.
        """
        shifted = {a: np.asarray(p, dtype=np.float64) for a, p in q.items()}
        for axis, amount in c.items():
            shifted[axis] = shifted[axis] + amount
        held = dict(shifted)
        for axis, positions in zip(self.axes, self.grid, strict=True):
            low, high = np.minimum(q[axis], positions[0]), np.maximum(q[axis], positions[-1])
            held[axis] = np.clip(shifted[axis], low, high)
        for places in (shifted, held):
            try:
                return self.vectors(places)
            except (DataError, LimitError):
                continue
        return self.vectors({a: held[a] if a in self.axes else p for a, p in q.items()})

    def derivative(self, q: Mapping[str, Any]) -> FloatArray:
        """Return J, shape (..., 3, k): the nominal point is straight in a linear axis, so exactly."""
        point = self.chain.transform(q, tool=self.tool)[..., :3, 3]
        columns = [
            self.chain.transform({**q, a: np.asarray(q[a]) + 1.0}, tool=self.tool)[..., :3, 3]
            - point
            for a in self.names
        ]
        return np.stack(np.broadcast_arrays(*columns), axis=-1)

    def inverse(self, q: Mapping[str, Any]) -> FloatArray:
        """Return ``J^+`` of the measured directions; it does not change with the corrections."""
        return np.asarray(np.linalg.pinv(self.derivative(q)[..., self.known, :]))

    def in_axes(
        self,
        q: Mapping[str, Any],
        c: Mapping[str, FloatArray] | None = None,
        inverse: FloatArray | None = None,
    ) -> dict[str, FloatArray]:
        """Return ``J^+ E`` by axis: by how much the commands seem to be wrong."""
        inverse = self.inverse(q) if inverse is None else inverse
        error = self.moved(q, c or {})[..., self.known]
        parts = np.einsum("...ki,...i->...k", inverse, error)
        return {a: np.array(parts[..., k]) for k, a in enumerate(self.names)}

    def remaining(
        self, q: Mapping[str, Any], c: Mapping[str, FloatArray], full: Mapping[str, ArrayLike]
    ) -> FloatArray:
        """Return ``E(q + c) + J full``: the error with corrections c, moved to another zero."""
        error = self.moved(q, c)
        shifts = np.stack(
            np.broadcast_arrays(*(np.asarray(full[a], dtype=np.float64) for a in self.names)),
            axis=-1,
        )
        moves = np.einsum("...ik,...k->...i", self.derivative(q), shifts)
        return np.asarray(error + moves)

    def sd_in_axes(self, q: Mapping[str, Any]) -> dict[str, FloatArray] | None:
        """Return the standard uncertainty of ``J^+ E`` by axis, None where it is not known."""
        if self.errors is None:
            return None
        inverse = np.linalg.pinv(self.derivative(q))
        with one_blas_thread():
            covariance = self.chain.volumetric_covariance(q, self.errors, tool=self.tool)
            variance = np.einsum("...ki,...ij,...kj->...k", inverse, covariance, inverse)
        if not variance.any():
            return None
        shape = np.broadcast_shapes(*(np.shape(p) for p in q.values()))
        sd = np.broadcast_to(np.sqrt(np.maximum(variance, 0.0)), (*shape, len(self.names)))
        return {a: np.array(sd[..., k]) for k, a in enumerate(self.names)}

    def correctable(self, q: Mapping[str, Any]) -> tuple[bool, ...]:
        """Return for each workpiece direction whether the axes can move the tool along it."""
        j = self.derivative(q)
        rest = np.eye(3) - j @ np.linalg.pinv(j)
        sizes = np.abs(rest).reshape(-1, 3, 3).max(axis=(0, 2))
        return tuple(bool(s < _IDLE) for s in sizes)


def rms_of_vectors(vectors: FloatArray) -> float:
    """Return the RMS length of error vectors, of the components that were measured."""
    valid = ~np.isnan(vectors).all(axis=tuple(range(vectors.ndim - 1)))
    return float(np.sqrt(np.mean(np.sum(vectors[..., valid] ** 2, axis=-1))))


def at_nodes(
    axes: tuple[str, ...], grid: tuple[FloatArray, ...], stand: Mapping[str, float]
) -> dict[str, Any]:
    """Return the commands at every node, of three axes (n3, n2, n1)."""
    mesh = np.meshgrid(*grid[::-1], indexing="ij")
    return {**stand, **dict(zip(axes, mesh[::-1], strict=True))}


def positions_to_axes(
    axes: tuple[str, ...], positions: Any, chain: Chain
) -> tuple[FloatArray, ...]:
    """Return the positions of each looked-up axis, checked."""
    if not 1 <= len(axes) <= 2 or len(set(axes)) < len(axes):
        raise DataError(
            f"over names one axis, or two different ones; got {', '.join(axes) or 'none'}"
        )
    for axis in axes:
        if axis not in chain.axes:
            raise DataError(
                f"chain {chain.name!r} has no axis {axis!r}; its axes are {', '.join(chain.axes)}"
            )
    return tuple(rising(p, a) for a, p in positions_by_axis(axes, positions).items())


def positions_by_axis(axes: tuple[str, ...], positions: Any) -> dict[str, Any]:
    """Return what was given for each axis: by its name, or one after the other."""
    if isinstance(positions, Mapping):
        if set(positions) != set(axes):
            raise DataError(
                f"positions are of {', '.join(positions)}, over names {', '.join(axes)}"
            )
        return {a: positions[a] for a in axes}
    several = len(axes) > 1 and isinstance(positions, tuple | list | np.ndarray)
    listed = list(positions) if several else [positions]
    if len(listed) != len(axes):
        raise DataError(f"positions hold {len(listed)} arrays for {len(axes)} axes")
    return dict(zip(axes, listed, strict=True))


def axes_moved(
    chain: Chain,
    names: Sequence[str],
    corrects: Sequence[str],
    *,
    over: Sequence[str],
    at: Mapping[str, float],
    tool: ArrayLike,
) -> set[str]:
    """Return the axes whose command errors of these terms can change along the looked-up axes.

    A term of a looked-up axis may have any shape along it, any other term is one number there.
    """
    linear = {e.name: e.kind == "linear" for e in chain.elements}
    travel = {e.name: e.travel for e in chain.elements if e.travel is not None}

    def place(axis: str, share: float) -> float:
        low, high = travel.get(axis, (-0.5, 0.5) if linear[axis] else (-1.0, 1.0))
        return float(low + share * (high - low))

    stand = {a: at.get(a, place(a, 0.37)) for a in chain.axes if a not in over}
    found: set[str] = set()
    for name in names:
        parts = []
        for share in (0.13, 0.41, 0.83):  # at no special place
            q = {**stand, **{a: place(a, share) for a in over}}
            source = volumetric_source(
                chain,
                {name: _UNIT},
                axes=(),
                grid=(),
                at=q,
                corrects=corrects,
                tool=tool,
                exact=False,
            )
            parts.append(source.in_axes(q))
        for axis in parts[0].keys() - found:
            values = np.array([p[axis] for p in parts])
            size = np.abs(values).max() if axis_of(name) in over else np.ptp(values)
            if size > _IDLE * _UNIT:
                found.add(axis)
    return found


def volumetric_source(
    chain: Chain,
    errors: Any,
    *,
    axes: tuple[str, ...],
    grid: tuple[FloatArray, ...],
    at: Mapping[str, float],
    corrects: Sequence[str] | None,
    tool: ArrayLike,
    exact: bool | str,
) -> VolumetricError:
    """Return the error as a function of the commands, with the axes that can correct it."""
    names = _corrected(chain, corrects, (*axes, *at))
    terms: ErrorSet | None = None
    known = np.ones(3, dtype=bool)
    if isinstance(errors, ErrorSet | Mapping):
        chosen = as_error_set(errors)
        terms = chosen if isinstance(errors, ErrorSet) else None
        messages = [*chain.messages, *chosen.messages]
        facts: dict[str, Any] = {"errors": list(chosen.names), "exact": exact}

        def of_chain(q: Mapping[str, Any]) -> FloatArray:
            return chain.volumetric_error(q, chosen, tool=tool, exact=exact)

        vectors: Vectors = of_chain
    else:
        vectors, known = _measured(errors, axes, grid)
        messages, facts = [], {"errors": "measured"}
    made = VolumetricError(
        chain, names, axes, grid, at, tool, vectors, known, terms, tuple(messages), facts
    )
    return _able(made)


def _corrected(
    chain: Chain, corrects: Sequence[str] | None, placed: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the names of the axes to correct: linear, and joints at these positions."""
    linear = [e.name for e in chain.elements if e.kind == "linear"]
    if corrects is None:
        return tuple(a for a in linear if a in placed)
    names = (corrects,) if isinstance(corrects, str) else tuple(corrects)
    if not names or len(set(names)) < len(names):
        raise DataError(f"corrects names each axis once; got {', '.join(names) or 'none'}")
    for name in names:
        if name not in linear:
            turns = " turns and" if name in chain.axes else ""
            raise DataError(
                f"{name!r}{turns} is not a linear axis of chain {chain.name!r}; it has {', '.join(linear)}"
            )
        if name not in placed:
            raise DataError(
                f"{name!r} is corrected, but nothing says where it stands: give at={{{name!r}: ...}}"
            )
    return names


def _able(source: VolumetricError) -> VolumetricError:
    """Drop axes that move nothing that is known; refuse axes that do the same."""
    corners = np.meshgrid(*source.grid)
    q = {**source.at, **dict(zip(source.axes, corners, strict=True))}
    if not source.names:
        raise DataError(f"chain {source.chain.name!r} has no linear axis to correct here")
    j = source.derivative(q)[..., source.known, :]
    sizes = np.abs(j).max(axis=tuple(range(j.ndim - 1)))
    idle = [a for a, s in zip(source.names, sizes, strict=True) if s < _IDLE]
    names = tuple(a for a in source.names if a not in idle)
    if not names:
        raise DataError(
            f"{', '.join(source.names)} cannot move the tool where the error was measured: name another axis"
        )
    values = np.linalg.svd(j[..., [a not in idle for a in source.names]], compute_uv=False)
    if values.shape[-1] < len(names) or float(values.min()) < _SINGULAR:
        raise DataError(
            f"of {', '.join(names)} some move the tool along the same direction (a fast tool on a "
            "slide?), or in one that was not measured: say in corrects= which is to be corrected"
        )
    said = [
        f"{a} gets no table: it does not move the tool where the error was measured" for a in idle
    ]
    return replace(source, names=names, messages=(*source.messages, *said))


def _measured(
    errors: Any, axes: tuple[str, ...], grid: tuple[FloatArray, ...]
) -> tuple[Vectors, NDArray[np.bool_]]:
    if isinstance(errors, Surface | ErrorMap):
        if len(axes) != 2:
            raise DataError("a measured map needs two axes in over, such as over=('X', 'Y')")
        measured = area_error(errors)
        sample_area(measured, *grid, axes=(axes[0], axes[1]), reference=(grid[0][0], grid[1][0]))

        def heights(q: Mapping[str, Any]) -> FloatArray:
            z = measured(q[axes[0]], q[axes[1]])
            return np.stack([np.full(z.shape, np.nan), np.full(z.shape, np.nan), z], axis=-1)

        return _shaped(heights, axes), np.array([False, False, True])
    try:
        values = np.array(errors, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(
            f"errors are a {type(errors).__name__}; give an ErrorSet, a mapping of terms, a Surface, "
            "an ErrorMap, or an array of error vectors"
        ) from None
    wanted = (*(p.size for p in grid[::-1]), 3)
    if values.shape != wanted:
        raise TableError(
            f"measured error vectors have shape {values.shape}; {wanted} is needed: the positions "
            "(rows are the second axis), then workpiece X, Y, Z"
        )
    if np.isinf(values).any():
        raise InvalidSamplesError("a measured error is infinite; write NaN in a whole component")
    missing = np.isnan(values)
    known = np.asarray(~missing.all(axis=tuple(range(values.ndim - 1))))
    gaps = np.argwhere(missing[..., known].any(axis=-1))
    if not known.any() or gaps.size:
        place = ", ".join(
            format_position(a, float(p[i]))
            for a, p, i in zip(axes, grid, (gaps[0][::-1] if gaps.size else [0, 0]), strict=False)
        )
        raise DataError(
            f"the error is not known at {place} ({len(gaps) or values[..., 0].size} places): it is "
            "not invented; narrow the positions, or set the component to NaN everywhere"
        )
    return _shaped(_interpolated(values, axes, grid), axes), known


def _interpolated(
    values: FloatArray, axes: tuple[str, ...], grid: tuple[FloatArray, ...]
) -> Vectors:
    def at(q: Mapping[str, Any]) -> FloatArray:
        if len(axes) == 1:
            parts = [np.interp(q[axes[0]], grid[0], values[:, k]) for k in range(3)]
        else:
            maps = [ErrorMap(grid[0], grid[1], values[..., k]) for k in range(3)]
            parts = [m(q[axes[0]], q[axes[1]]) for m in maps]
        return np.stack(parts, axis=-1)

    return at


def _shaped(vectors: Vectors, axes: tuple[str, ...]) -> Vectors:
    """Return vectors in the shape of the positions, a single number included."""

    def at(q: Mapping[str, Any]) -> FloatArray:
        shape = np.broadcast_shapes(*(np.shape(q[a]) for a in axes))
        return vectors(q).reshape(*shape, 3)

    return at
