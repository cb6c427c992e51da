"""Points of an aperture with heights and slopes: of an ideal form, or of a measured map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.surface import Surface
from metrosep.forms.base import Form

__all__ = ["Grid", "Sampled", "form_points", "map_points"]

Grid = Literal["polar", "square"]

POLAR = (300, 720)
"""Radii and azimuths of the polar grid."""

SQUARE = 256
"""Points along each side of the square grid."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Points of an aperture.

    Parameters
    ----------
    x, y : ndarray, m
        Positions from the optical axis.
    z : ndarray, m
        Heights; NaN where not known or outside.
    slope_x, slope_y : ndarray
        Slopes; NaN where not known.
    weights : ndarray
        Area that belongs to each point, relative.
    radius : float, m
        Of the aperture.
    steps : tuple of (float, float) or None, m
        Of a rectangular grid.
    messages : tuple of str
        What a reader should know.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    weights: FloatArray
    radius: float
    steps: tuple[float, float] | None
    messages: tuple[str, ...] = ()


def form_points(
    form: Form,
    radius: float | None,
    inner_radius: float,
    grid: str,
    samples: int | tuple[int, int] | None,
) -> Sampled:
    """Return the points of a form on an aperture around its vertex.

    Parameters
    ----------
    form : Form
        Ideal surface.
    radius : float or None, m
        Of the aperture; needed.
    inner_radius : float, m
        Of a central hole.
    grid : {"polar", "square"}
        Rings of equal width with the points in the middle, or squares.
    samples : int or tuple of int, optional
        Radii and azimuths of a polar grid; points along a side of a square one.

    Returns
    -------
    Sampled
        With exact slopes.

    Raises
    ------
    DataError
        If an argument is not one that can be used, or the form is not defined somewhere.
    """
    if radius is None:
        raise DataError("the wavefront of an ideal form needs the radius of its aperture, in m")
    _check_radii(radius, inner_radius)
    if grid == "polar":
        x, y, weights, steps = _polar(radius, inner_radius, samples)
    elif grid == "square":
        x, y, weights, steps = _square(radius, inner_radius, samples)
    else:
        raise DataError(f'grid must be "polar" or "square", got {grid!r}')
    z = form(x, y)
    p, q = form.gradient(x, y)
    wanted = weights > 0.0
    missing = wanted & ~(np.isfinite(z) & np.isfinite(p) & np.isfinite(q))
    if missing.any():
        place = np.unravel_index(int(missing.argmax()), missing.shape)
        raise DataError(
            f"the {form.name} is not defined at x = {x[place] * 1e3:.6g} mm, y = "
            f"{y[place] * 1e3:.6g} mm, inside the aperture of radius {radius * 1e3:.6g} mm; make "
            "the aperture smaller"
        )
    z = np.where(wanted, z, np.nan)
    return Sampled(x, y, z, p, q, weights, float(radius), steps)


def map_points(
    surface: Surface,
    radius: float | None,
    inner_radius: float,
    centre: tuple[float, float] | None,
    form: Form | None,
) -> Sampled:
    """Return the pixels of a measured map, with slopes from their neighbours.

    Parameters
    ----------
    surface : Surface
        With lateral calibration; NaN where not measured.
    radius : float or None, m
        Of the aperture; None: all that was measured.
    inner_radius : float, m
        Of a central hole.
    centre : tuple of (float, float) or None, m
        Optical axis in the coordinates of the map; None: its middle if no origin was declared,
        else (0, 0).
    form : Form or None
        Ideal surface about that axis: its slopes are exact, and only the rest is differenced.

    Returns
    -------
    Sampled
        A pixel without any measured neighbour along a direction has no slope and is left out.

    Raises
    ------
    DataError
        If the map has no lateral calibration, or an argument is not one that can be used.
    TooFewSamplesError
        If fewer than 3 pixels with slopes lie in the aperture.
    """
    if surface.dx is None or surface.dy is None:
        raise DataError(
            "the surface has no lateral calibration (dx or dy is None), and slopes need one: read "
            "the file with lateral_step=..."
        )
    rows, columns = surface.shape
    x = surface.origin[0] + surface.dx * np.arange(columns, dtype=np.float64)
    y = surface.origin[1] + surface.dy * np.arange(rows, dtype=np.float64)
    if centre is None:
        undeclared = surface.origin == (0.0, 0.0)
        centre = (float(x.mean()), float(y.mean())) if undeclared else (0.0, 0.0)
    across, up = np.meshgrid(x - float(centre[0]), y - float(centre[1]))
    rest = surface.z if form is None else surface.z - form(across, up)
    p, q = _differences(rest, surface.dx, 1), _differences(rest, surface.dy, 0)
    if form is not None:
        exact = form.gradient(across, up)
        p, q = p + exact[0], q + exact[1]
    known = ~(np.isnan(surface.z) | np.isnan(p) | np.isnan(q))
    alone = int((~np.isnan(rest) & (np.isnan(p) | np.isnan(q))).sum())
    rho = np.hypot(across, up)
    if radius is None:
        radius = float(rho[known].max()) if known.any() else 0.0
    if known.any():
        _check_radii(radius, inner_radius)
    inside = known & (rho <= radius * (1.0 + 1e-12)) & (rho >= inner_radius)
    if int(inside.sum()) < 3:
        raise TooFewSamplesError(
            f"{int(inside.sum())} pixels with slopes lie in the aperture; a wavefront needs at "
            "least 3: check the radius and the centre"
        )
    notes = (
        (f"{alone} pixels have no measured neighbour in x or y and are left out",) if alone else ()
    )
    z = np.where(inside, surface.z, np.nan)
    steps = (surface.dx, surface.dy)
    weights = inside.astype(np.float64)
    return Sampled(across, up, z, p, q, weights, float(radius), steps, notes)


def _check_radii(radius: float, inner_radius: float) -> None:
    if not (np.isfinite(radius) and radius > 0.0):
        raise DataError(f"radius must be positive, in m, got {radius}")
    if not 0.0 <= inner_radius < radius:
        raise DataError(
            f"inner_radius must lie between 0 and the radius {radius} m, got {inner_radius}"
        )


def _polar(
    radius: float, inner: float, samples: int | tuple[int, int] | None
) -> tuple[FloatArray, FloatArray, FloatArray, None]:
    counts: object = POLAR if samples is None else samples
    if not (isinstance(counts, tuple) and len(counts) == 2 and min(counts) >= 3):
        raise DataError(
            f"samples of a polar grid are (radii, azimuths), each 3 or more, got {samples}"
        )
    n_rho, n_theta = (int(v) for v in counts)
    rho = inner + (np.arange(n_rho) + 0.5) / n_rho * (radius - inner)
    theta = 2.0 * np.pi * (np.arange(n_theta) + 0.5) / n_theta
    weights = np.repeat(rho[:, None] / (rho.sum() * n_theta), n_theta, axis=1)
    return rho[:, None] * np.cos(theta), rho[:, None] * np.sin(theta), weights, None


def _square(
    radius: float, inner: float, samples: int | tuple[int, int] | None
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    n = SQUARE if samples is None else samples
    if not isinstance(n, int) or n < 8:
        raise DataError(f"samples of a square grid is one number, 8 or more, got {samples}")
    step = 2.0 * radius / n
    axis = step * (np.arange(n) - 0.5 * (n - 1))
    x, y = np.meshgrid(axis, axis)
    rho = np.hypot(x, y)
    weights = ((rho <= radius) & (rho >= inner)).astype(np.float64)
    return x, y, weights, (step, step)


def _differences(z: FloatArray, step: float, axis: int) -> FloatArray:
    """Return slopes: the mean of those to both neighbours, or the one there is; NaN without."""
    turned = np.moveaxis(z, axis, 0)
    out = np.full(turned.shape, np.nan)
    if turned.shape[0] > 1:
        steps = np.diff(turned, axis=0) / step
        ahead, behind = out.copy(), out.copy()
        ahead[:-1], behind[1:] = steps, steps
        out = 0.5 * (ahead + behind)
        out = np.where(np.isnan(out), np.where(np.isnan(ahead), behind, ahead), out)
    return np.moveaxis(np.where(np.isnan(turned), np.nan, out), 0, axis)
