"""Points of an X3P file that carry their positions become a map, if they lie on a regular grid."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import FormatMismatchError, UnsupportedFeatureError
from metrosep.io.grid import to_grid
from metrosep.io.source import RawFile
from metrosep.io.x3p_points import Axis

__all__ = ["on_grid"]

_MAX_GAPS = 64.0
"""Pixels of a grid per point of a list; with more the points are taken for scattered."""

_SAME = 1e-12
"""Positions closer than this, relative to the span, are one position."""


def on_grid(
    file: RawFile,
    axes: tuple[Axis, ...],
    shape: tuple[int, int],
    values: dict[str, FloatArray],
    warnings: list[str],
) -> tuple[FloatArray, tuple[float, float], tuple[float, float]]:
    """Return points that carry their positions as a map, if they lie on a regular grid."""
    row, column = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    x, y = (
        values[a.name] if a.is_absolute else a.metres(np.asarray(index, dtype=np.float64))
        for a, index in zip(axes, (column, row), strict=False)
    )
    known = ~(np.isnan(x) | np.isnan(y))
    if not known.all():
        warnings.append(f"{int((~known).sum())} points without a position were left out")
    x, y, z = x[known], y[known], values["CZ"][known]
    reason = "there are too few of them for a grid"
    if z.size and _n_steps(x) * _n_steps(y) <= _MAX_GAPS * z.size:
        try:
            return to_grid(file, x, y, z)
        except FormatMismatchError as exc:
            reason = str(exc).removeprefix(f"{file.path}: ")
    raise UnsupportedFeatureError(
        f"{file.path}: the points of the X3P file are scattered, not on a regular grid ({reason}); "
        "resample them to a grid and save it as a surface (SUR)"
    )


def _n_steps(values: FloatArray) -> float:
    """Return how many of the smallest steps the positions span."""
    levels = np.unique(values)
    steps = np.diff(levels)
    steps = steps[steps > _SAME * (levels[-1] - levels[0])]
    return float((levels[-1] - levels[0]) / steps.min()) + 1.0 if steps.size else 1.0
