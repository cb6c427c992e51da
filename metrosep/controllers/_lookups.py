"""What every simulated look-up starts with: places and directions of one shape, checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError

__all__ = ["Simulator", "looked_up", "one_way"]

Simulator = Callable[..., FloatArray]


def looked_up(
    places: tuple[ArrayLike, ...], direction: ArrayLike
) -> tuple[tuple[FloatArray, ...], NDArray[Any]]:
    """Return places and directions, broadcast."""
    arrays = np.broadcast_arrays(
        *(np.asarray(p, dtype=np.float64) for p in places), np.asarray(direction)
    )
    if not np.isin(arrays[-1], (-1, 1)).all():
        raise DataError("direction is +1 or -1")
    return tuple(arrays[:-1]), arrays[-1]


def one_way(function: Any, n_places: int = 1) -> Simulator:
    """Return a lookup that is the same in both directions of motion."""

    def along(position: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return np.asarray(function(*looked_up((position,), direction)[0]))

    def over(x: ArrayLike, y: ArrayLike, direction: ArrayLike = 1) -> FloatArray:
        return np.asarray(function(*looked_up((x, y), direction)[0]))

    return along if n_places == 1 else over
