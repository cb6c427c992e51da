"""What a reader should know of the wavefront of a measured map: slopes at gaps, and its height."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.optics.rays import Mode, Side, path_difference, path_sensitivity
from metrosep.optics.sampling import Sampled

_WORTH = 1e-9
"""m of path: an error below it is not worth a word."""

_MISPLACED = 1e-6
"""m: a height that nobody would notice, to say what it would do where no height is known."""


def map_doubts(
    points: Sampled,
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> tuple[str, ...]:
    """Return messages; rays are heights and both slopes, NaN where nothing is used."""
    notes = (
        "" if points.doubt is None else _single_neighbours(points.doubt, rays, mode, n, side),
        _misplaced_height(points.on_axis, rays, mode, n, side),
    )
    return tuple(note for note in notes if note)


def _single_neighbours(
    doubt: tuple[FloatArray, FloatArray],
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> str:
    there = (doubt[0] != 0.0) | (doubt[1] != 0.0)  # NaN counts
    count = int(there.sum())
    if not count:
        return ""
    _, by_x, by_y = path_sensitivity(*(v[there] for v in rays), mode=mode, n=n, side=side)
    size = float((np.abs(by_x) * doubt[0][there] + np.abs(by_y) * doubt[1][there]).max())
    amount = (
        "by an amount that this map cannot tell"
        if np.isnan(size)
        else f"by half a step times the curvature, about {1e9 * size:.2g} nm of path at most"
    )
    return (
        f"{count} pixels have a single measured neighbour in x or y: their slope is one-sided and "
        f"may be off {amount}; give form=, whose slopes are exact, or a smaller radius"
    )


def _misplaced_height(
    height: float,
    rays: tuple[FloatArray, ...],
    mode: Mode,
    n: float | None,
    side: Side,
) -> str:
    known = not np.isnan(height)
    at = np.full_like(rays[0], height if known else _MISPLACED)
    flat = np.zeros_like(at)
    extra = path_difference(at, rays[1], rays[2], mode=mode, n=n, side=side) - path_difference(
        at, flat, flat, mode=mode, n=n, side=side
    )
    size = float(np.nanmax(np.abs(extra)))
    if size <= _WORTH:
        return ""
    if known:
        return (
            f"on its axis the map stands about {1e6 * abs(height):.4g} um "
            f"{'above' if height > 0.0 else 'below'} the vertex plane z = 0, which is "
            f"no mere piston: by the slopes up to {1e9 * size:.4g} nm of path come from it, mostly "
            f"defocus; if the vertex lies there, pass vertex_height={height:.4g} (in m)"
        )
    return (
        "nothing was measured on the axis, so heights count from z = 0 as given: were the vertex "
        f"1 um off it, up to {1e9 * size:.4g} nm of path would come from the slopes; see "
        "vertex_height"
    )
