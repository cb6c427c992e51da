"""Taking points out of a map or profile: outside an aperture, and outliers. Nothing is filled."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, FitError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.regions import (
    LENGTHS,
    check_region,
    in_pixels,
    measured_middle,
    needs_scale,
    not_round,
    region_words,
    within_region,
)
from metrosep.core.surface import Surface
from metrosep.core.units import PIXEL, Pixels, format_ends

Flags = NDArray[np.bool_]
Measured = Surface | Profile


def masked(
    obj: Measured, aperture: Mapping[str, Any], *, outside: bool = True
) -> tuple[Measured, dict[str, Any]]:
    """Return an object without what lies outside (or inside) an aperture."""
    shape = str(aperture.get("shape", "circle"))
    check_region(shape, aperture, is_profile=isinstance(obj, Profile))
    sizes = {k: aperture[k] for k in LENGTHS if k in aperture}
    pixels = in_pixels(f"the {shape}", *sizes.values(), aperture.get("points"))
    key, number = (PIXEL, Pixels) if pixels else ("m", float)
    x, y = _positions(obj, aperture, pixels=pixels)
    drawn = "points" in aperture
    centre = None if drawn else _centre(obj, aperture.get("centre", "fit"), pixels=pixels)
    if drawn and isinstance(obj, Profile):
        raise DataError(f"a {shape} is drawn on a map; of a profile take a rectangle with width")
    inside = within_region({"shape": shape, **aperture}, x, y, centre or (0.0, 0.0))
    if isinstance(obj, Profile):
        inside = inside[0]
    out = ~inside if outside else inside
    taken = int(np.count_nonzero(out & ~np.isnan(obj.z)))
    place: dict[str, Any] = {} if centre is None else {f"centre_{key}": [*map(float, centre)]}
    if drawn:
        place = {f"points_{key}": [[*map(float, p)] for p in aperture["points"]]}
    facts: dict[str, Any] = {
        "shape": shape,
        **{f"{k}_{key}": float(v) for k, v in sizes.items()},
        **({"angle_rad": float(aperture["angle"])} if "angle" in aperture else {}),
        **place,
        "outside": outside,
        "taken_out": taken,
    }
    result = without_points(obj, out, Step("mask", facts))
    left = obj.z.size - result.n_invalid
    words = region_words({"shape": shape, **aperture}, centre)
    if left == 0:
        spans = [
            format_ends(number(v.min()), number(v.max()), between=" to ")
            for v in ((x,) if isinstance(obj, Profile) else (x, y))
        ]
        raise TooFewSamplesError(
            f"the {words} leaves nothing of what was measured; the data span {spans[0]} in x"
            + "".join(f", {span} in y" for span in spans[1:])
        )
    facts = {"taken_out": taken, "left": left, "region": words, **place}
    if pixels and isinstance(obj, Surface) and (shape in _ROUND or aperture.get("angle")):
        facts["pixels"] = not_round(obj, f"the {shape}")
    return result, facts


_ROUND = ("circle", "ring", "brush")


def _centre(obj: Measured, asked: Any, *, pixels: bool) -> tuple[float, float]:
    if not isinstance(asked, str):
        return _given(asked, obj)
    x, y = middle_of(obj, pixels=pixels)
    return (Pixels(x), Pixels(y)) if pixels else (x, y)


def without_points(obj: Measured, out: Flags, step: Step) -> Measured:
    """Return an object with NaN where a mask says so."""
    z = np.where(out, np.nan, obj.z)
    history = (*obj.history, step)
    if isinstance(obj, Profile):
        return Profile(obj.x, z, metadata=obj.metadata, history=history)
    return Surface(z, obj.dx, obj.dy, origin=obj.origin, metadata=obj.metadata, history=history)


def middle_of(obj: Measured, *, pixels: bool = False) -> tuple[float, float]:
    """Return the middle of what was measured, in m or in pixels.

    Notes
    -----
    All chords of a disc, a ring or a rectangle have their middle on its axis. The median forgives
    stray points, dropouts and a rim that is cut off on one side over less than half of the rows.
    """
    x, y = _positions(obj, {}, pixels=pixels)
    if obj.n_invalid == obj.z.size:
        raise TooFewSamplesError("no sample was measured (all are NaN): there is no middle")
    return measured_middle(np.atleast_2d(obj.z), x, y)


def _positions(
    obj: Measured, aperture: Mapping[str, Any], *, pixels: bool
) -> tuple[FloatArray, FloatArray]:
    """Return x of the columns and y of the rows."""
    if isinstance(obj, Profile):
        if pixels:
            raise DataError('px are pixels of a map, and this is a profile: give a length, "5 mm"')
        obj.require_metres()
        return obj.x, np.zeros(1)
    (x0, y0), (dx, dy) = (0.0, 0.0), (1.0, 1.0)
    if not pixels:
        if obj.dx is None or obj.dy is None:
            key = next((k for k in LENGTHS if k in aperture), "diameter")
            raise needs_scale(f"{key} of the aperture", f'{key} = "120 px"')
        (x0, y0), (dx, dy) = obj.origin, (obj.dx, obj.dy)
    rows, columns = obj.shape
    x: FloatArray = x0 + dx * np.arange(columns, dtype=np.float64)
    y: FloatArray = y0 + dy * np.arange(rows, dtype=np.float64)
    return x, y


def _given(centre: Any, obj: Measured) -> tuple[float, float]:
    values = tuple(centre)
    if isinstance(obj, Profile):
        if len(values) > 2 or any(v != 0.0 for v in values[1:]):
            raise DataError('the centre on a profile is one position: centre = ["5 mm"]')
        return values[0], 0.0
    if len(values) != 2:
        raise DataError(
            'the centre on a map has x and y: centre = ["5 mm", "5 mm"], or "fit"'
        ).hinting(centre="fit")
    return values[0], values[1]


# ---- outliers of a map or profile: heights that stand far from their neighbours ----------------

WINDOWS = {"map": 5, "profile": 11}
"""Samples across the neighbourhood where none is given."""

_TO_SIGMA = 1.482602218505602
"""Standard deviation over median absolute deviation of normal numbers."""
_OUTLIERS_ROUNDING = 64.0 * np.finfo(np.float64).eps
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
    feature wider than about half of the window is not an outlier. Positions count as equally spaced.
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
    rounding = _OUTLIERS_ROUNDING * largest
    if found > rounding:
        return found
    off = sizes[sizes > rounding]
    if off.size > _FLICKER * sizes.size:
        return _TO_SIGMA * float(np.median(off))
    return float(rounding)
