"""Outliers of a map or profile: heights that stand far from their neighbours."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FitError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.recipe.pipeline_mask import Flags, Measured, without_points

__all__ = ["SMOOTH", "WINDOWS", "neighbour_deviation", "without_outliers"]


WINDOWS = {"map": 5, "profile": 11}
"""Samples across the neighbourhood where none is given."""

_TO_SIGMA = 1.482602218505602
"""Standard deviation over median absolute deviation of normal numbers."""
_ROUNDING = 64.0 * np.finfo(np.float64).eps
_FLICKER = 0.05
"""Where the robust sigma is zero: share of heights off their neighbours that makes a step of the
instrument, and no outliers."""
SMOOTH = "smooth"
"""What is taken off for judging where no form is named."""
_DEGREE = 8
_ENOUGH = 300
"""Heights from which the polynomial of 45 terms is fitted."""
_FEWEST = 2
"""Pairs of opposite neighbours that judge a height."""
_BLOCK = 1 << 17
"""Heights of a block whose neighbours are sorted together."""


def without_outliers(
    obj: Measured, *, threshold: float = 6.0, window: int | None = None, form: str = SMOOTH
) -> tuple[Measured, dict[str, Any]]:
    """Return an object without heights that stand far from their neighbours.

    Notes
    -----
    A height is compared with the median of the means of opposite neighbours: a slope cancels, a
    curvature does not (`form`). The robust standard deviation is 1.4826 times
    the median absolute deviation about the median. What stands out is then compared once more
    without the others that do, so that the neighbours of an outlier are not taken for one. A
    feature wider than about half of the window is no outlier. Positions count as equally spaced.
    """
    across = (
        WINDOWS["profile" if isinstance(obj, Profile) else "map"] if window is None else window
    )
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise DataError(f"threshold must be more than zero robust sigma, got {threshold}")
    if across < 3 or across % 2 == 0:
        raise DataError(f"window is an odd number of samples from 3, such as 5, got {across}")
    level = _level(obj, form)
    deviation = neighbour_deviation(level, across)
    judged = ~np.isnan(deviation)
    out: Flags = np.zeros(obj.z.shape, dtype=bool)
    sigma = 0.0
    if judged.any():
        usual = float(np.median(deviation[judged]))
        sigma = _sigma(np.abs(deviation[judged] - usual), float(np.nanmax(np.abs(obj.z))))
        out[judged] = np.abs(deviation[judged] - usual) > threshold * sigma
        alone = level[out] - neighbour_deviation(np.where(out, np.nan, level), across, out) - usual
        out[out] = ~(np.abs(alone) <= threshold * sigma)  # not judged then: stays out
    measured = obj.z.size - obj.n_invalid
    taken = int(np.count_nonzero(out))
    facts = {"threshold": float(threshold), "window": across, "form": form}
    facts |= {"sigma_m": sigma, "taken_out": taken}
    audit = {
        "taken_out": taken,
        "left": measured - taken,
        "not_judged": measured - int(np.count_nonzero(judged)),
        "sigma_m": sigma,
    }
    return without_points(obj, out, Step("outliers", facts)), audit


def _level(obj: Measured, form: str) -> FloatArray:
    if form.strip().lower() == SMOOTH:
        return _flattened(obj.z)
    from metrosep.forms.catalogue import form_from_text
    from metrosep.forms.fit import fit

    return fit(obj, form_from_text(form), robust="tukey").residual.z


def _flattened(z: FloatArray) -> FloatArray:
    """Return heights without a polynomial over their index; as they are where they are few."""
    valid = ~np.isnan(z)
    steps = np.diff(z, axis=-1)
    known = steps[~np.isnan(steps)]
    if np.count_nonzero(valid) < _ENOUGH or np.count_nonzero(known) < 0.5 * known.size:
        return z  # few, or so exact that most are the same: a polynomial would hide that
    if z.ndim == 2:
        from metrosep.forms.moments import remove_grid

        try:
            return remove_grid(z, _DEGREE, refine=False)[0]
        except FitError:  # all valid in a few rows or columns
            return z
    u = np.linspace(-1.0, 1.0, z.size)
    fitted = np.polynomial.Legendre.fit(u[valid], z[valid], _DEGREE, domain=[-1.0, 1.0])
    return np.asarray(z - fitted(u))


def neighbour_deviation(z: FloatArray, window: int, at: Flags | None = None) -> FloatArray:
    """Return how far heights lie from the median of the means of opposite neighbours."""
    values = np.atleast_2d(z)
    half = window // 2
    rows, columns = values.shape
    tall = half if z.ndim == 2 else 0
    padded = np.full((rows + 2 * tall, columns + 2 * half), np.nan)
    padded[tall : tall + rows, half : half + columns] = values
    pairs = [(i, j) for i in range(tall + 1) for j in range(-half, half + 1) if (i, j) > (0, 0)]
    if at is not None:
        y, x = np.nonzero(np.atleast_2d(at))
        y, x = y + tall, x + half
        means = [0.5 * (padded[y + i, x + j] + padded[y - i, x - j]) for i, j in pairs]
        return _median(np.stack(means, axis=-1), 1)
    result = np.empty(values.shape)
    step = max(1, _BLOCK // columns)
    for first in range(0, rows, step):
        n = min(step, rows - first)
        block = padded[first : first + n + 2 * tall]

        def moved(i: int, j: int, block: FloatArray = block, n: int = n) -> FloatArray:
            return block[tall + i : tall + i + n, half + j : half + j + columns]

        around = np.empty((n, columns, len(pairs)))
        for k, (i, j) in enumerate(pairs):
            np.add(moved(i, j), moved(-i, -j), out=around[..., k])
        around *= 0.5
        result[first : first + n] = moved(0, 0) - _median(around, _FEWEST)
    return result.reshape(z.shape)


def _median(values: FloatArray, fewest: int) -> FloatArray:
    """Return the median over the last axis without NaN; NaN where fewer than some are known."""
    values.sort(axis=-1)  # NaN last
    n = np.count_nonzero(~np.isnan(values), axis=-1)
    low, high = np.maximum(n - 1, 0) // 2, np.minimum(n // 2, values.shape[-1] - 1)
    found = 0.5 * (
        np.take_along_axis(values, low[..., None], axis=-1)[..., 0]
        + np.take_along_axis(values, high[..., None], axis=-1)[..., 0]
    )
    return np.where(n >= fewest, found, np.nan)


def _sigma(sizes: FloatArray, largest: float) -> float:
    """Return the robust standard deviation of deviations from their absolute values."""
    found = _TO_SIGMA * float(np.median(sizes))
    rounding = _ROUNDING * largest
    if found > rounding:
        return found
    off = sizes[sizes > rounding]
    if off.size > _FLICKER * sizes.size:
        return _TO_SIGMA * float(np.median(off))
    return float(rounding)
