"""Lateral offsets of sub-apertures: least squares of gradients, together with the freedoms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DegenerateFitError, NotConvergedError
from metrosep.separation._overlaps import overlaps_of, require_connection
from metrosep.separation._stitch_grid import Layout, layout_of
from metrosep.separation._stitch_input import Pieces
from metrosep.separation._stitch_solve import (
    Problem,
    fitted_pieces,
    freedom_terms,
    inverse_of,
    mean_of,
    noise_of,
    normal_matrix,
    right_side,
)
from metrosep.separation._stitch_terms import Box, WindowTerms, n_of

_MOST_PASSES = 30
_SETTLED = 1e-3
"""Change of a position, in steps, at which the passes end."""

_ENOUGH = 0.1
"""Share of the standard uncertainty below which a change does not matter."""

_SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0

_LARGEST_STEP = 1.5
"""In pixels and pass: gradients say nothing about more."""

_LARGEST_U = 0.5
"""Standard uncertainty of an offset, in pixels, beyond which it is no result."""


def registered(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[Pieces, dict[str, Any]]:
    """Return sub-apertures at fitted positions; the first stays where it is."""
    start, n_axes = pieces.corners.copy(), 1 if pieces.line else 2
    steps = np.array([pieces.dx, pieces.dy])[:n_axes]
    largest, damping, noise = math.inf, 1.0, math.nan
    for count in range(1, _MOST_PASSES + 1):
        before = largest
        shift, u = _one_pass(pieces, freedoms, n_axes)
        in_pixels, noise = shift / steps, float((u / steps).max())
        if float(u.max()) > _LARGEST_U * float(steps.min()):
            raise DegenerateFitError(
                f"stitch: the overlaps fix an offset only to {float(u.max()):.3g} m, more than half "
                'a pixel: the surface is too smooth for the noise; use registration="trust"'
            )
        largest = float(np.abs(in_pixels).max())
        if 0.7 * before < largest < 2.0 * noise:  # to and fro within the noise, not onwards
            damping *= 0.6
        limited = shift * damping * min(1.0, _LARGEST_STEP / max(largest, 1e-300))
        corners = pieces.corners.copy()
        corners[:, :n_axes] += limited
        pieces = replace(pieces, corners=corners)
        if damping * largest < max(_SETTLED, _ENOUGH * noise):
            moved = pieces.corners[:, :n_axes] - start[:, :n_axes]
            u = np.hypot(u, shift)  # where it stops is as uncertain as its last change
            return pieces, {
                "registration": "fitted, relative to the first",
                "registration_passes": count,
                "registration_last_change_pixels": largest,
                "shifts_um": (1e6 * moved).tolist(),
                "u_shifts_um": (1e6 * u).tolist(),
            }
    raise NotConvergedError(
        f"stitch: the positions did not settle in {_MOST_PASSES} passes (last change {largest:.3g} "
        f"pixels, their standard uncertainty {noise:.3g}); "
        + (
            "the change is of the size of the noise: the surface has too little structure in the "
            'overlaps, use registration="trust"'
            if largest < 2.0 * noise
            else "the start is too far off for gradients: give positions to a few pixels"
        )
    )


def _one_pass(
    pieces: Pieces, freedoms: tuple[str, ...], n_axes: int
) -> tuple[FloatArray, FloatArray]:
    layout = layout_of(pieces)
    overlaps = overlaps_of(layout)
    own = freedom_terms(layout, freedoms, line=pieces.line)
    n_own = n_of(own)
    n, weight = len(pieces), layout.weights()
    columns = [k * n_own + np.arange(n_own) for k in range(n)]
    plain = Problem(layout, overlaps, own, columns, n * n_own, weight)
    require_connection(overlaps, n, least=n_own + n_axes + 1)
    values = [p.values for p in layout.placed]
    theta = inverse_of(normal_matrix(plain)).matrix @ right_side(
        plain, values, mean_of(plain, values)
    )
    slopes = _slopes(mean_of(plain, fitted_pieces(plain, values, theta)), layout, n_axes)
    layout = _where_known(layout, ~np.isnan(slopes.sum(axis=0)))
    overlaps, weight, slopes = overlaps_of(layout), layout.weights(), np.nan_to_num(slopes)
    require_connection(overlaps, n, least=n_own + n_axes + 1)

    def features(k: int, box: Box) -> FloatArray:
        p = layout.placed[k]
        return np.concatenate(
            [own.values(k, box), slopes[:, p.rows, p.columns][(slice(None), *box)]]
        )

    each = n_own + n_axes
    columns = [k * each + np.arange(each) for k in range(n)]
    full = Problem(layout, overlaps, WindowTerms(features), columns, n * each, weight)
    inverse = inverse_of(normal_matrix(full))
    if inverse.null.shape[1] > n_own + n_axes:
        raise DegenerateFitError(
            "stitch: the overlaps show no structure that fixes the lateral offsets (a plane or a "
            'parabola shifted looks tilted); use registration="trust"'
        )
    theta = inverse.matrix @ right_side(full, values, mean_of(full, values))
    fitted = fitted_pieces(full, values, theta)
    spread, _ = noise_of(full, fitted, mean_of(full, fitted), inverse.rank)
    shift = theta.reshape(n, each)[:, n_own:]
    return shift - shift[0], _uncertainty(inverse.matrix, n, each, n_own, n_axes, spread)


def _uncertainty(
    matrix: FloatArray, n: int, each: int, n_own: int, n_axes: int, spread: float
) -> FloatArray:
    out = np.zeros((n, n_axes))
    for axis in range(n_axes):
        at = np.arange(n) * each + n_own + axis
        block = matrix[np.ix_(at, at)]
        variance = np.diag(block) - 2.0 * block[0] + block[0, 0]
        out[:, axis] = np.sqrt(np.maximum(variance, 0.0))
    return out * (0.0 if math.isnan(spread) else spread)


def _slopes(surface: FloatArray, layout: Layout, n_axes: int) -> FloatArray:
    """Return dz/dx (and dz/dy) of the smoothed surface; NaN where a neighbour is missing.

    Noise in the slopes would pull weakly tied offsets to where the noise fits. Smoothing takes
    most of it; what it takes from the surface changes the way to the solution, not the solution.
    """
    raw, smooth = surface, _smoothed(surface, n_axes)
    out = []
    for axis, x in ((1, layout.x), (0, layout.y))[:n_axes]:
        missing = np.isnan(np.gradient(raw, axis=axis))
        out.append(np.where(missing, np.nan, np.gradient(smooth, x[1] - x[0], axis=axis)))
    return np.array(out)


def _smoothed(surface: FloatArray, n_axes: int) -> FloatArray:
    """Return weighted means over 5 (x 5) pixels, a plane apart; what is missing takes no part."""
    from scipy.ndimage import convolve1d

    known = np.isfinite(surface)
    axes = [np.linspace(-1.0, 1.0, n) for n in surface.shape]
    basis = np.array(np.broadcast_arrays(1.0, axes[1][None, :], axes[0][:, None])[: n_axes + 1])
    found = np.linalg.lstsq(basis[:, known].T, surface[known], rcond=1e-12)[0]
    plane = np.tensordot(found, basis, axes=1)
    total, weight = np.where(known, surface - plane, 0.0), known.astype(np.float64)
    for axis in (1, 0)[:n_axes]:
        total, weight = (
            convolve1d(v, _SMOOTHING, axis=axis, mode="constant") for v in (total, weight)
        )
    return np.asarray(plane + total / np.maximum(weight, 1e-12))


def _where_known(layout: Layout, known: NDArray[np.bool_]) -> Layout:
    """Return the sub-apertures without the pixels that have no gradient; 0 there would be a bias."""
    placed = tuple(replace(p, valid=p.valid & known[p.rows, p.columns]) for p in layout.placed)
    return replace(layout, placed=placed)
