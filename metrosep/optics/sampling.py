"""Points of an aperture with heights and slopes: of an ideal form, or of a measured map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, position
from metrosep.core.errors import DataError, Example, InvalidSamplesError, TooFewSamplesError
from metrosep.core.numbers import choice, count, positive, quantity
from metrosep.core.regions import measured_middle
from metrosep.core.surface import Surface
from metrosep.forms.base import Form

_Mask = NDArray[np.bool_]

Grid = Literal["polar", "square"]
GRIDS = ("polar", "square")

POLAR = (300, 720)
"""Radii and azimuths of the polar grid."""

SQUARE = 256
"""Points along each side of the square grid."""

_CLEAR = 3.0
"""Standard errors of the mean height about the axis beyond which the height is not only their scatter."""

_MOST_HEIGHT = 1e30
"""m: beyond it stand the numbers with which files fill what was not measured."""

_LITTLE = 0.5
"""Share of the disc: a map that covers less of it is worth a word."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Points of an aperture."""

    x: FloatArray  # m: positions from the optical axis
    y: FloatArray
    z: FloatArray  # m: heights; NaN where not known or outside
    slope_x: FloatArray  # slopes; NaN where not known
    slope_y: FloatArray
    weights: FloatArray  # area that belongs to each point, relative
    radius: float  # m: of the aperture
    steps: tuple[float, float] | None  # of (float, float) or None, m: of a rectangular grid
    messages: tuple[str, ...] = ()  # what a reader should know
    # of (ndarray, ndarray) or None: what slopes from a single neighbour may be off by, in x and in
    # y; 0 for all others, NaN where that cannot be said. Of a map only
    slope_errors: tuple[FloatArray, FloatArray] | None = None
    # of (float, float) or None, m: optical axis in the coordinates of the map
    centre: tuple[float, float] | None = None
    # m: height of a map where the axis meets it, about: 0 where it is lost in scatter, NaN where
    # nothing was measured there. 0 for a form, which says what it means
    on_axis: float = 0.0


def form_points(
    form: Form,
    radius: float | None,
    inner_radius: float,
    grid: str,
    samples: int | tuple[int, int] | None,
) -> Sampled:
    """Return the points of a form on an aperture around its vertex."""
    if radius is None:
        raise DataError("the wavefront of an ideal form needs the radius of its aperture, in m")
    radius, inner_radius = _radii(radius, inner_radius)
    choice(grid, "grid", GRIDS)
    made = _polar if grid == "polar" else _square
    x, y, weights, steps = made(radius, inner_radius, samples)
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
    return Sampled(x, y, z, p, q, weights, radius, steps)


def map_points(
    surface: Surface,
    radius: float | None,
    inner_radius: float,
    centre: tuple[float, float] | None,
    form: Form | None,
    vertex_height: float = 0.0,
) -> Sampled:
    """Return the pixels of a measured map, with slopes from their neighbours."""
    across, up, axis, notes = _about_the_axis(surface, centre, any_axis=radius is not None)
    dx, dy = surface.dx, surface.dy
    assert dx is not None and dy is not None  # noqa: S101, PT018  # refused just now
    _refuse_fill_values(surface.z)
    z = surface.z - quantity(vertex_height, "vertex_height", "length")
    rest = z if form is None else z - _of_form(form, across, up)
    (p, error_x), (q, error_y) = slopes_of(rest, dx, 1), slopes_of(rest, dy, 0)
    if form is not None:
        exact = form.gradient(across, up)
        p, q = p + exact[0], q + exact[1]
    known = ~(np.isnan(rest) | np.isnan(p) | np.isnan(q))
    rho = np.hypot(across, up)
    radius, hole, aperture = _aperture(known, rho, radius, inner_radius)
    inside = known & aperture
    notes += _left_out(aperture & ~known, z, rest)
    notes += _coverage(int(inside.sum()) * dx * dy, radius, hole)
    start = np.nan if form is None else float(np.asarray(form(0.0, 0.0)).item())
    reach, on_axis = float(np.hypot(dx, dy)), rest + start
    if np.isnan(start):  # a parabola continues to the axis
        on_axis = z - 0.5 * (across * p + up * q)
    else:
        reach += float(rho[inside].min())
    return Sampled(
        across,
        up,
        np.where(inside, z, np.nan),
        p,
        q,
        inside.astype(np.float64),
        radius,
        (dx, dy),
        notes,
        (np.where(inside, error_x, 0.0), np.where(inside, error_y, 0.0)),
        axis,
        _height_on_axis(np.where(inside, on_axis, np.nan), rho, reach),
    )


def _refuse_fill_values(z: FloatArray) -> None:
    beyond = np.abs(z) > _MOST_HEIGHT
    if beyond.any():
        row, column = (int(i) for i in np.argwhere(beyond)[0])
        raise InvalidSamplesError(
            f"z is {z[row, column]:.3g} m at row {row}, column {column}, a fill value rather than a "
            "height: write NaN where nothing was measured"
        )


def _aperture(
    known: _Mask, rho: FloatArray, radius: float | None, inner_radius: float
) -> tuple[float, float, _Mask]:
    """Return both radii and what lies between them; refuse an aperture that holds next to nothing."""
    hole = quantity(inner_radius, "inner_radius", "length")
    if radius is not None or known.any():
        farthest = float(rho[known].max(initial=0.0))
        radius, hole = _radii(farthest if radius is None else radius, hole)
    limit = 0.0 if radius is None else radius * (1.0 + 1e-12)
    aperture: _Mask = (rho <= limit) & (rho >= hole)
    n_inside = int((known & aperture).sum())
    if n_inside < 3 or radius is None:
        raise TooFewSamplesError(
            f"{n_inside} pixels with slopes lie in the aperture; a wavefront needs at least 3: check "
            "the radius and the centre"
        )
    return radius, hole, aperture


def _about_the_axis(
    surface: Surface, centre: tuple[float, float] | None, *, any_axis: bool
) -> tuple[FloatArray, FloatArray, tuple[float, float], tuple[str, ...]]:
    """Return positions from the optical axis, the axis in the map, and how it was found."""
    if surface.dx is None or surface.dy is None:
        raise DataError(
            "the surface has no lateral calibration, and slopes need one: read "
            "the file with lateral_step=..."
        ).hinting(lateral_step=Example("3 um"))
    rows, columns = surface.shape
    x = surface.origin[0] + surface.dx * np.arange(columns, dtype=np.float64)
    y = surface.origin[1] + surface.dy * np.arange(rows, dtype=np.float64)
    notes: tuple[str, ...] = ()
    if centre is not None:
        axis = position(centre, "centre")
    elif surface.origin == (0.0, 0.0):
        axis = measured_middle(surface.z, x, y)
        note = (
            "the map declares no origin (it is 0, 0), so the optical axis is taken in the middle of "
            "what was measured, x "
            f"= {1e3 * axis[0]:.6g} mm, y = {1e3 * axis[1]:.6g} mm; pass centre=(0, 0) if its corner "
            "lies on the axis"
        )
        notes = (note,)
    else:
        axis = (0.0, 0.0)
    beside = (
        max(x[0] - axis[0], axis[0] - x[-1]) > 0.5 * surface.dx
        or max(y[0] - axis[1], axis[1] - y[-1]) > 0.5 * surface.dy
    )
    if beside and not any_axis:
        raise DataError(
            f"the optical axis, x = {1e3 * axis[0]:.6g} mm, y = {1e3 * axis[1]:.6g} mm, lies beside "
            f"the map, which spans x = {1e3 * x[0]:.6g} to {1e3 * x[-1]:.6g} mm and y = "
            f"{1e3 * y[0]:.6g} to {1e3 * y[-1]:.6g} mm: give centre in m, or the radius of the "
            "aperture if the part is off its axis"
        )
    across, up = np.meshgrid(x - axis[0], y - axis[1])
    return across, up, axis, notes


def _of_form(form: Form, x: FloatArray, y: FloatArray) -> FloatArray:
    if not isinstance(form, Form):
        raise DataError(f"form must be an ideal form of metrosep.forms, got {type(form).__name__}")
    return np.asarray(form(x, y), dtype=np.float64)


def _left_out(gone: _Mask, z: FloatArray, rest: FloatArray) -> tuple[str, ...]:
    """Return what to say about measured pixels of the aperture that have no path difference."""
    undefined = int((gone & ~np.isnan(z) & np.isnan(rest)).sum())
    alone = int((gone & ~np.isnan(rest)).sum())
    notes = []
    if alone:
        notes.append(f"{alone} pixels have no measured neighbour in x or y and are omitted")
    if undefined:
        notes.append(f"{undefined} measured pixels lie where the form is not defined: omitted")
    return tuple(notes)


def _coverage(area: float, radius: float, inner: float) -> tuple[str, ...]:
    """Return what to say where the measured part is little of the disc."""
    share = area / (np.pi * (radius**2 - inner**2))
    if share >= _LITTLE:
        return ()
    note = (
        f"the measured pixels cover {100.0 * share:.2g} % of the aperture of radius "
        f"{1e3 * radius:.6g} mm: Zernike terms are strongly correlated there; check radius and centre"
    )
    return (note,)


def _height_on_axis(heights: FloatArray, rho: FloatArray, reach: float) -> float:
    """Return the mean height close to the axis, 0 where it is lost in scatter, NaN where unknown."""
    near = heights[~np.isnan(heights) & (rho <= reach)]
    if not near.size:
        return float("nan")
    mean = float(near.mean())
    return mean if abs(mean) > _CLEAR * float(near.std()) / near.size**0.5 else 0.0


def _radii(radius: float, inner_radius: float) -> tuple[float, float]:
    outer = positive(radius, "radius", dimension="length")
    inner = quantity(inner_radius, "inner_radius", "length")
    if not 0.0 <= inner < outer:
        raise DataError(
            f"inner_radius must lie between 0 and the radius {1e3 * outer:.6g} mm, got {inner} m"
        )
    return outer, inner


def _polar(
    radius: float, inner: float, samples: int | tuple[int, int] | None
) -> tuple[FloatArray, FloatArray, FloatArray, None]:
    counts: object = POLAR if samples is None else samples
    if not (isinstance(counts, tuple | list) and len(counts) == 2):
        raise DataError(
            f"samples of a polar grid are (radii, azimuths), each 3 or more, got {samples!r}"
        )
    n_rho = count(counts[0], "samples (radii) of a polar grid", least=3)
    n_theta = count(counts[1], "samples (azimuths) of a polar grid", least=3)
    rho = inner + (np.arange(n_rho) + 0.5) / n_rho * (radius - inner)
    theta = 2.0 * np.pi * (np.arange(n_theta) + 0.5) / n_theta
    weights = np.repeat(rho[:, None] / (rho.sum() * n_theta), n_theta, axis=1)
    return rho[:, None] * np.cos(theta), rho[:, None] * np.sin(theta), weights, None


def _square(
    radius: float, inner: float, samples: int | tuple[int, int] | None
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    n = count(SQUARE if samples is None else samples, "samples of a square grid", least=8)
    step = 2.0 * radius / n
    axis = step * (np.arange(n) - 0.5 * (n - 1))
    x, y = np.meshgrid(axis, axis)
    rho = np.hypot(x, y)
    weights = ((rho <= radius) & (rho >= inner)).astype(np.float64)
    return x, y, weights, (step, step)


# ---- slopes of a measured map from neighbouring pixels, along one axis at a time ---------------


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
    error = np.where(alone, 0.5 * float(np.median(known)) if known.size else np.nan, 0.0)
    return (
        np.moveaxis(np.where(alone, single, rise) / step, 0, axis),
        np.moveaxis(error / step, 0, axis),
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
