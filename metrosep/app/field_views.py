"""Pictures of all heights: their distribution with the material ratio, and the waves in all directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.app.map_views import lateral_unit
from metrosep.app.wire import Arrays
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.profile import Profile
from metrosep.core.readable import said_value
from metrosep.core.sections import extremes_in, grid_of
from metrosep.core.surface import Surface
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.parameters.material_ratio import AbbottCurve

_CURVE = 513
"""Heights at which the material ratio is drawn."""
_SIDE, _SHOWN = 1024, 512
"""Pixels along the longer side of the map that is transformed, and of the picture of its spectrum."""
_DECADES = 6.0
_STEPS = 254
_HOLES = 1.0 / 16.0
"""Of the longer side: the neighbourhood whose mean stands in a gap."""
_HANN = 3.0
"""sqrt(9): a wave A that divides the map has A^2 Lx Ly / 9 under two Hann windows (C-7: 4/9 of A^2 / 4)."""


@dataclass(frozen=True, slots=True, eq=False)
class Distribution:
    """All heights, sorted once."""

    curve: AbbottCurve  # about the mean
    mean: float  # m
    edges: FloatArray  # shape (n + 1,), m: of the classes, about the mean
    shares: FloatArray  # shape (n,): of the heights in each


def distribution(obj: Surface | Profile) -> Distribution:
    """Return the distribution of the heights about their mean."""
    from metrosep.parameters.material_ratio import abbott_curve
    from metrosep.recipe.describe.describe_measure import height_classes

    known = obj.z[~np.isnan(obj.z)]
    if known.size < 2 or not np.ptp(known) > 0.0:
        raise TooFewSamplesError(
            "fewer than two different heights were measured: there is nothing to share out"
        )
    mean = float(known.mean())
    heights = known - mean
    edges = height_classes(heights)
    return Distribution(
        abbott_curve(heights), mean, edges, np.histogram(heights, bins=edges)[0] / known.size
    )


def heights_view(found: Distribution, at: Any) -> tuple[dict[str, Any], Arrays]:
    """Return classes and material ratio curve, and the exact ratios of two heights about the mean (m)."""
    if at is not None and (not isinstance(at, list) or len(at) != 2):
        raise DataError(f"at is two heights about the mean in m, got {said_value(at)}")
    given = at or [found.curve.height(p) for p in (0.1, 0.8)]
    levels = [float(v) for v in given]
    if not all(map(math.isfinite, levels)):
        raise DataError(f"at is two heights about the mean in m, got {said_value(at)}")
    n = found.curve.heights.size
    heights = np.linspace(found.edges[0], found.edges[-1], _CURVE)
    rising = found.curve.heights[::-1]
    ratios = 1.0 - np.searchsorted(rising, heights, side="left") / n
    header = {
        "mean": found.mean,
        "at": levels,
        "ratios": [found.curve.ratio(c) for c in levels],
        "n": n,
        "below": int(np.searchsorted(rising, found.edges[0], side="left")) / n,
        "above": (n - int(np.searchsorted(rising, found.edges[-1], side="right"))) / n,
    }
    arrays = {"edges": found.edges, "shares": found.shares, "heights": heights, "curve": ratios}
    return header, arrays


def waves_view(surface: Surface) -> tuple[Mapping[str, Any], Arrays]:
    """Return the two-sided density over fx and fy as a picture, six decades, row 0 the largest fy.

    Lengths of a map without lateral calibration are px.
    """
    from metrosep.spectral.density import areal_psd

    unit = lateral_unit(surface)
    dx, dy = (1.0, 1.0) if unit == "px" else (surface.dx or 1.0, surface.dy or 1.0)
    z, share = _filled(_outline(surface.z))
    k = max(1, -(-max(z.shape) // _SIDE))
    ny, nx = (n // k for n in z.shape)
    z = z[: ny * k, : nx * k].reshape(ny, k, nx, k).mean(axis=(1, 3))
    coarse = Surface(z, k * dx, k * dy)
    psd = areal_psd(coarse, window="hann", detrend="plane")
    density = psd.density.copy()
    cy, cx = psd.frequency_y.size // 2, psd.frequency_x.size // 2
    density[cy, cx] = 0.0  # what the window leaves of the mean
    area = coarse.shape[0] * coarse.shape[1] * k * k * dx * dy
    top = float(density.max())
    j, i = np.unravel_index(int(density.argmax()), density.shape)
    fx, fy = float(psd.frequency_x[i]), float(psd.frequency_y[j])
    notes = ["Hann window, plane removed"]
    if share:
        notes.append(
            f"{100.0 * share:.3g} % not measured: the mean around stands there, for this picture only"
        )
    if k > 1:
        shortest = 2 * k * max(dx, dy)
        words = f"{shortest:g} px" if unit == "px" else format_length(shortest)
        notes.append(f"means of {k} × {k} pixels; waves from {words} on")
    if not top > 0.0:
        raise TooFewSamplesError("the map is flat: there are no waves in it")
    b = max(1, -(-max(density.shape) // _SHOWN))
    shown = _largest(density, b)
    with np.errstate(divide="ignore"):
        part = 1.0 + np.log10(shown / top) / _DECADES
    index = np.where(part > 0.0, np.rint(1.0 + _STEPS * np.clip(part, 0.0, 1.0)), 1.0)
    step_x, step_y = (float(f[1] - f[0]) for f in (psd.frequency_x, psd.frequency_y))
    edge = (float(psd.frequency_x[0]) - 0.5 * step_x, float(psd.frequency_y[0]) - 0.5 * step_y)
    header = {
        "unit": unit,
        "window": [
            *edge,
            edge[0] + b * step_x * shown.shape[1],
            edge[1] + b * step_y * shown.shape[0],
        ],
        "top": top,
        "decades": _DECADES,
        "amplitude": _HANN * math.sqrt(top / area),  # m: of a wave that reaches the top
        "peak": {
            "wavelength": 1.0 / math.hypot(fx, fy),
            "direction": math.atan2(fy, fx) % math.pi,
        },
        "notes": notes,
    }
    return header, {"index": index.astype(np.uint8)[::-1]}


def _outline(z: FloatArray) -> FloatArray:
    """Return the part of a map within the first and last rows and columns that were measured."""
    valid = ~np.isnan(z)
    rows, columns = np.flatnonzero(valid.any(axis=1)), np.flatnonzero(valid.any(axis=0))
    if rows.size < 8 or columns.size < 8:
        raise TooFewSamplesError("waves in all directions need 8 × 8 measured pixels")
    return z[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _filled(z: FloatArray) -> tuple[FloatArray, float]:
    """Return a map whose gaps hold the mean of what was measured around them, and their share."""
    from scipy import ndimage

    gap = np.isnan(z)
    share = float(gap.mean())
    if not share:
        return z, 0.0
    side = max(3, round(_HOLES * max(z.shape)))
    mean = float(np.nanmean(z))
    total = ndimage.uniform_filter(np.where(gap, 0.0, z - mean), side, mode="constant")
    weight = ndimage.uniform_filter((~gap).astype(np.float64), side, mode="constant")
    around = np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), 0.0)
    return np.where(gap, around + mean, z), share


def _largest(values: FloatArray, b: int) -> FloatArray:
    """Return the largest of each block of b x b; the last ones may be smaller."""
    rows, columns = (np.arange(0, n, b) for n in values.shape)
    return np.asarray(
        np.maximum.reduceat(np.maximum.reduceat(values, rows, axis=0), columns, axis=1)
    )


def extremes_near(
    surface: Surface, at: Any, radius: Any
) -> tuple[list[float] | None, list[float] | None]:
    """Return the highest and lowest pixel whose centre lies in a circle, [x, y] in m or px; None in a gap."""
    (cx, cy), r = (float(v) for v in at), float(radius)
    if not r > 0.0:
        raise DataError("peaks near a point need a radius above zero")
    found = extremes_in(surface, (cx, cy), r)
    return (None, None) if found is None else ([*found.peak[:2]], [*found.valley[:2]])


def aperture_of(surface: Surface) -> tuple[tuple[float, float], float]:
    """Return middle and radius of the largest circle inside the outer rows and columns that were measured, m or px."""
    from metrosep.core.regions import measured_middle

    valid = ~np.isnan(surface.z)
    if not valid.any():
        raise TooFewSamplesError("nothing was measured: there is no aperture")
    spans = [np.flatnonzero(valid.any(axis=a)) for a in (0, 1)]
    (x0, y0), (dx, dy) = grid_of(surface)
    half = min(s * float(np.ptp(v)) / 2.0 for v, s in zip(spans, (dx, dy), strict=True))
    x = x0 + dx * np.arange(surface.shape[1])
    y = y0 + dy * np.arange(surface.shape[0])
    return measured_middle(surface.z, x, y), half
