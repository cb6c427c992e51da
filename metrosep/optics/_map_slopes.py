"""Slopes of a measured map from neighbouring pixels, along one axis at a time."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray


def slopes_of(z: FloatArray, step: float, axis: int) -> tuple[FloatArray, FloatArray]:
    """Return slopes along an axis, and what a slope from a single neighbour may be off by.

    With both neighbours the mean of the two slopes; at a rim the three-point rule
    ``(-3 z0 + 4 z1 - z2) / 2 h`` of the two next pixels on the measured side; with one pixel there
    the slope to it; with none NaN. All but the third are exact on a parabola. The third is off by
    half a step times the curvature, taken as the median over the map; NaN where no three pixels in a
    row show one; 0 for the others.
    """
    turned = np.moveaxis(z, axis, 0)
    ahead, behind = (_shifted(turned, k) - turned for k in (1, -1))
    farther, beyond = (_shifted(turned, k) - turned for k in (2, -2))
    centred = 0.5 * (ahead - behind)
    right, left = 2.0 * ahead - 0.5 * farther, -2.0 * behind + 0.5 * beyond
    rise = _first_known(centred, right, left)
    single = _first_known(ahead, -behind)
    alone = np.isnan(rise) & ~np.isnan(single)
    bend = np.abs(ahead + behind)
    known = bend[~np.isnan(bend)]
    doubt = np.where(alone, 0.5 * float(np.median(known)) if known.size else np.nan, 0.0)
    return (
        np.moveaxis(np.where(alone, single, rise) / step, 0, axis),
        np.moveaxis(doubt / step, 0, axis),
    )


def _shifted(z: FloatArray, by: int) -> FloatArray:
    """Return the heights `by` rows ahead, NaN beyond the end."""
    out = np.full(z.shape, np.nan)
    if by > 0:
        out[:-by] = z[by:]
    else:
        out[-by:] = z[:by]
    return out


def _first_known(*choices: FloatArray) -> FloatArray:
    """Return, point by point, the first choice that is not NaN."""
    out = choices[0]
    for other in choices[1:]:
        out = np.where(np.isnan(out), other, out)
    return out
