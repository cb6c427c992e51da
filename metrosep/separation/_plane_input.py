"""Private helper: maps of a plane in any form as one stack of arrays with steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface
from metrosep.core.units import format_engineering
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation.planner_checks import positive

__all__ = ["described", "plane_origin", "plane_stack", "plane_steps"]


def plane_stack(
    maps: Surface | ArrayLike,
    dx: float | None,
    dy: float | None,
    origin: tuple[float, float],
) -> tuple[FloatArray, float, float, tuple[float, float], tuple[Step, ...]]:
    history: tuple[Step, ...] = ()
    items: list[Surface] = (
        [maps]
        if isinstance(maps, Surface)
        else list(maps)
        if isinstance(maps, (list, tuple)) and any(isinstance(m, Surface) for m in maps)
        else []
    )
    if items:
        if not all(isinstance(m, Surface) for m in items):
            raise DataError("give all maps as surfaces or all as arrays, not mixed")
        if len({(m.shape, m.dx, m.dy, m.origin) for m in items}) > 1:
            raise DataError(
                "the maps differ in shape, steps or origin; resample them onto one grid"
            )
        if dx is not None or dy is not None:
            raise DataError("surfaces bring their own steps; leave dx and dy out")
        dx, dy, origin = items[0].dx, items[0].dy, items[0].origin
        history = tuple(s for m in items for s in m.history)
        values = np.stack([m.z for m in items])
    else:
        values = np.array(real_numbers(maps, "maps"), dtype=np.float64)
    if values.ndim == 2:
        values = values[np.newaxis]
    if values.ndim != 3:
        raise DataError(
            f"maps must have the shape (n_y, n_x) or (repeats, n_y, n_x), got {values.shape}"
        )
    if np.isinf(values).any():
        raise DataError("a map is infinite somewhere; write NaN where nothing was measured")
    step_x, step_y = plane_steps(dx, dy)
    return values, step_x, step_y, plane_origin(origin), history


def plane_steps(dx: float | None, dy: float | None) -> tuple[float, float]:
    """Return positive steps; say which is missing or no number."""
    if dx is None or dy is None:
        raise DataError("the grid needs positive steps dx and dy in m")
    return positive(dx, "dx", "m"), positive(dy, "dy", "m")


def plane_origin(origin: tuple[float, float]) -> tuple[float, float]:
    """Return the position (x, y) as two finite numbers."""
    try:
        x, y = (float(v) for v in origin)
    except (TypeError, ValueError):
        x = y = float("nan")
    if not np.isfinite([x, y]).all():
        raise DataError(f"origin must be two finite numbers (x, y) in m, got {origin!r}")
    return x, y


def described(values: FloatArray, u: FloatArray) -> str:
    """Return peak to valley and typical standard uncertainty in words."""
    known = values[np.isfinite(values)]
    if not known.size:
        return "not determined"
    text = f"P-V {format_engineering(float(np.ptp(known)), 'm')}"
    sure = u[np.isfinite(u)]
    if not sure.size:
        return f"{text}, u not known"
    return f"{text}, u {format_engineering(float(np.sqrt(np.mean(sure**2))), 'm', digits=2)}"
