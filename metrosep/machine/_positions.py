"""Where the axes stand when the tool cuts a point of the part.

Known for two kinds of chain: a lathe (one spindle about Z under the part, X and one axis along Z
that carry the tool) and a machine of three linear axes. At (rho, azimuth) a lathe has its tool at
the radius rho and its spindle at **minus** the azimuth. Any other chain needs a `positions`
callable. Axes that are parked are left out; rotary axes of a five-axis machine need the callable.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError

__all__ = ["Positions", "axis_positions"]


Positions = Callable[[FloatArray, FloatArray, FloatArray], Mapping[str, ArrayLike]]
"""``positions(x, y, z)`` returns the position of each axis, by name, at points of the part."""

_PARALLEL = 1e-9


def axis_positions(
    chain: Any,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    positions: Positions | None = None,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> dict[str, FloatArray]:
    """Return axis positions by name at points of the part, arrays of the shape of x."""
    if positions is not None:
        if not callable(positions):
            raise DataError(
                "positions is a function of x, y and z that returns the position of each axis by "
                f"name, got {type(positions).__name__}"
            )
        found = positions(x, y, z)
        if not isinstance(found, Mapping):
            raise DataError(
                f"positions must return a mapping of axis names, got {type(found).__name__}"
            )
        return {name: _filled(value, x.shape, name) for name, value in found.items()}
    elements = [e for e in chain.elements if not e.parked]
    spindles = [e for e in elements if e.kind == "rotary"]
    slides = [e for e in elements if e.kind == "linear"]
    origin = np.array(tool, dtype=np.float64)
    for e in chain.elements:
        origin = origin + np.array(e.location) * (1.0 if e.branch == "tool" else -1.0)
    turned = any(e.kind == "fixed" and e.angle != 0.0 for e in elements)
    if not turned and not spindles and len(slides) == 3:
        return _three_slides(slides, origin, np.stack((x, y, z)))
    if not turned and len(spindles) == 1 and len(slides) == 2:
        found_lathe = _lathe(spindles[0], slides, origin, x, y, z)
        if found_lathe is not None:
            return found_lathe
    raise DataError(
        f"how chain {chain.name!r} reaches a point of the part is not known (it is neither a lathe "
        "with X and Z nor three linear axes); give positions, a function of x, y, z that returns "
        "the position of each axis by name"
    )


def _three_slides(
    slides: list[Any], origin: FloatArray, points: FloatArray
) -> dict[str, FloatArray]:
    signs = [1.0 if e.branch == "tool" else -1.0 for e in slides]
    travel = np.column_stack(
        [s * np.array(e.direction) for e, s in zip(slides, signs, strict=True)]
    )
    if abs(np.linalg.det(travel)) < _PARALLEL:
        raise DataError("the three linear axes do not reach every point: two of them are parallel")
    q = np.linalg.solve(travel, (points.reshape(3, -1) - origin[:, None]))
    return {e.name: v.reshape(points.shape[1:]) for e, v in zip(slides, q, strict=True)}


def _lathe(
    spindle: Any,
    slides: list[Any],
    origin: FloatArray,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
) -> dict[str, FloatArray] | None:
    """Return the positions of a lathe; None if the chain is no lathe."""
    across, along = (
        [e for e in slides if abs(abs(e.direction[k]) - 1.0) < _PARALLEL] for k in (0, 2)
    )
    turn = float(spindle.direction[2])
    is_lathe = spindle.branch == "workpiece" and abs(abs(turn) - 1.0) < _PARALLEL
    if not is_lathe or len(across) != 1 or len(along) != 1:
        return None
    if abs(origin[1]) > 0.0:
        raise DataError(
            f"the tool stands {origin[1]:.3g} m beside the spindle axis and never cuts the centre; "
            "rank its offset as an error, or give positions"
        )
    signed = {
        e.name: (1.0 if e.branch == "tool" else -1.0) * float(e.direction[k])
        for e, k in ((across[0], 0), (along[0], 2))
    }
    return {
        across[0].name: (np.hypot(x, y) - origin[0]) / signed[across[0].name],
        along[0].name: (z - origin[2]) / signed[along[0].name],
        spindle.name: -np.sign(turn) * np.arctan2(y, x),
    }


def _filled(value: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    try:
        return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape))
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"positions of axis {name!r} must be numbers, one per point {shape}, got shape "
            f"{np.shape(value)}"
        ) from None
