"""Sub-aperture stitching: one surface from overlapping measurements, with a shared reference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, NotConvergedError
from metrosep.core.numbers import choice, count
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers, known_parts, part_of
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    SeparationMethod,
    Unobservable,
)
from metrosep.separation.maps._map_input import checked_u
from metrosep.separation.maps._stitch_grid import (
    Layout,
    Pieces,
    layout_of,
    overlaps_of,
    pieces_of,
    require_connection,
)
from metrosep.separation.maps._stitch_models import Settings
from metrosep.separation.maps._stitch_run import run
from metrosep.separation.maps._stitch_solve import (
    Box,
    Problem,
    Terms,
    fitted_to,
    freedom_terms,
    inverse_of,
    noise_of,
    normal_matrix,
)

__all__ = ["Stitching", "stitch"]

_FREEDOMS = ("piston", "tilt", "power")


def stitch(
    maps: Sequence[ArrayLike | Surface | Profile],
    positions: ArrayLike | None = None,
    *,
    dx: float | None = None,
    dy: float | None = None,
    rotations: ArrayLike | None = None,
    freedoms: Sequence[str] = ("piston", "tilt"),
    reference: Literal["none", "fit"] | ArrayLike | Surface | Profile = "none",
    reference_degree: int | None = None,
    ambiguous: Literal["remove", "surface"] = "remove",
    registration: Literal["trust", "fit"] = "trust",
    u_reading: float | None = None,
    draws: int = 16,
) -> Separation:
    """Return one surface from overlapping sub-apertures.

    Parameters
    ----------
    maps : sequence of Surface, Profile or array_like, m
        Sub-apertures; NaN = not measured. Surfaces bring their ``origin``, profiles their ``x``.
    positions : array_like, shape (n, 2) or (n,), m, optional
        x and y of the first pixel of each map, x of the first sample of each profile; needed for
        arrays, and instead of the origins where given.
    dx, dy : float, m, optional
        Steps of arrays; pixels if omitted.
    rotations : array_like, shape (n,), rad, optional
        By which the frame of each map lies turned on the part, counter-clockwise about its centre.
    freedoms : sequence of {"piston", "tilt", "power"}, optional
        What differs from one sub-aperture to the next.
    reference : {"none", "fit"} or array_like or Surface or Profile, m, optional
        Error of the instrument in its own pixels, common to all: none, unknown, or known (it is
        subtracted).
    u_reading : float, m, optional
        Standard uncertainty of one reading; from the overlaps if omitted.

    Returns
    -------
    Separation
        ``.surface`` on the pixels of the first map, extended; ``.reference`` where fitted, in the
        instrument's pixels. ``coordinates`` hold x and y. The audit has the freedoms of each
        sub-aperture in nm at the edge of its longer half side, and the mismatch of each overlap.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError, NotUniformError
        If the sub-apertures or settings cannot be used, or one is mirrored.
    NotSeparableError
        If they fall into groups without overlap, or one step size leaves the reference open.
    DegenerateFitError
        If an overlap is too thin for the freedoms.
    NotConvergedError
        If the map of the reference or the registration does not settle.

    Notes
    -----
    Least squares of ``m_i(x) - s(x) - p_i(x) - r(x - x_i)`` over all pixels of all sub-apertures
    with one unknown s for each pixel: the sum over overlaps of the squared differences, each
    weighted by one over the number of sub-apertures at the pixel. The surface is their mean, the
    best one for equal noise; there is no feathering. Positions between pixels are interpolated by
    cubic convolution; a pixel is NaN where one of its 4 x 4 neighbours was not measured.

    Null space: the freedoms of the whole; with a fitted reference all parabolas, as
    ``r(x - x_i) - r(x)`` is then a plane. A reference error of curvature c gives the stitched
    length L a false sag ``c L^2 / 8``: with ``delta = c d^2`` that is ``delta (L/d)^2 / 8``.

    References
    ----------
    J. Fleig, P. Dumas, P. E. Murphy, G. W. Forbes, An automated subaperture stitching
    interferometer workstation for spherical and aspherical surfaces, Proc. SPIE 5188 (2003).

    Examples
    --------
    >>> import numpy as np
    >>> part = 50e-9 * np.sin(np.arange(60) / 7.0)[None, :] * np.cos(np.arange(20) / 5.0)[:, None]
    >>> pieces = [part[:, :30], part[:, 15:45] + 1e-6, part[:, 30:] - 2e-6]
    >>> result = stitch(pieces, [(0.0, 0.0), (15e-3, 0.0), (30e-3, 0.0)], dx=1e-3)
    >>> result.surface.shape
    (20, 60)
    """
    kinds = checked_freedoms(freedoms)
    choice(ambiguous, "stitch: ambiguous", ("remove", "surface"))
    choice(registration, "stitch: registration", ("trust", "fit"))
    degree = reference_degree
    if degree is not None:
        degree = count(degree, "stitch: reference_degree", least=2, most=12)
    fit = isinstance(reference, str) and reference == "fit"
    if isinstance(reference, str) and reference not in ("none", "fit"):
        raise DataError(f"stitch: reference is {reference!r}; give none, fit or a map")
    if degree is not None and not fit:
        raise DataError('stitch: reference_degree needs reference="fit"')
    n_draws = count(draws, "stitch: draws", least=0)
    u_reading = checked_u(u_reading, "u_reading")
    settings = Settings(kinds, fit, degree, ambiguous, n_draws, u_reading)
    pieces = pieces_of(maps, positions, rotations, dx, dy)
    extra: dict[str, object] = {"reference": "fitted" if fit else "none"}
    if not isinstance(reference, str):
        pieces = _without_known(pieces, reference)
        extra["reference"] = "known, subtracted"
    if registration == "fit":
        pieces, found = registered(pieces, kinds)
        extra.update(found)
    if not pieces.calibrated:
        extra["messages"] = ("no lateral step is known: positions are in pixels",)
    return run(pieces, settings, extra)


@dataclass(frozen=True, slots=True)
class Stitching(SeparationMethod):
    """Sub-apertures of one shape at known positions.

    Readings (n, n_y, n_x) in m, one map for each position; NaN = not measured. Parts: ``surface`` on
    the stitched grid and, where it is fitted, ``reference`` in the instrument's pixels, NaN where it is
    not determined. Simulated sub-apertures lie on whole pixels, without noise and with freedoms of zero;
    `correct` takes off the fitted reference. Positions that do not connect raise NotSeparableError.

    Parameters
    ----------
    positions : tuple of tuple of (float, float), m
        x and y of the first pixel of each sub-aperture.
    shape : tuple of int
        Rows and columns of each.
    dx, dy : float, m, optional
        Lateral steps; `dx` for both if `dy` is omitted.
    freedoms : tuple of str, optional
        As for `stitch`.
    fit_reference : bool, optional
        Whether the instrument's reference is unknown.
    reference_degree : int or None, optional
        Its polynomial; a map of pixels if None.
    draws : int, optional
        As for `stitch`.
    """

    positions: tuple[tuple[float, float], ...]
    shape: tuple[int, int]
    dx: float = 1.0
    dy: float | None = None
    freedoms: tuple[str, ...] = option(
        ("piston", "tilt"), kind="texts", help="of each map: piston,tilt, power, shift_x, shift_y"
    )
    fit_reference: bool = False
    reference_degree: int | None = option(
        None,
        kind="integer",
        help="fit the reference as a polynomial of this total degree, 2 to 12; a map of pixels if "
        "omitted, which needs two step sizes",
    )
    draws: int = option(
        16,
        kind="integer",
        help="simulated measurements behind the uncertainty of a fitted map of pixels; 0 for none",
    )

    name = "stitch"
    what = "one surface or profile from overlapping sub-apertures, with or without the reference"
    reads = "maps"
    accepts = ("Surface", "Profile")
    arguments: ClassVar[Mapping[str, Option]] = {
        **U_READING,
        "positions": Option("places", help="of the maps; those of the files if left out"),
        "rotations": Option("angles", help="of the maps"),
        "reference": Option(
            "text",
            choices=("none", "fit", "first"),
            help="fit: the reference surface is found too; first: the first file holds it",
        ),
        "ambiguous": Option(
            "text",
            choices=("remove", "surface"),
            help="what reference and surface can exchange unseen (power, ...): removed from both, or "
            "given to the surface as if the reference were free of it",
        ),
        "registration": Option(
            "text",
            choices=("trust", "fit"),
            help="fit: lateral offsets of the maps are found by least squares of gradients; trust: the"
            " positions are taken as they are",
        ),
    }
    truth_parts = ("surface",)
    error_parts = ("reference",)

    @classmethod
    def from_inputs(cls, data: Sequence[Any], options: Mapping[str, Any]) -> Separation:
        """Return the surface; the first file is the known reference where reference is "first"."""
        rest, maps = dict(options), list(data)
        if rest.get("reference") == "first":
            rest["reference"] = maps.pop(0)
        return stitch(maps, **rest)

    def simulate(self, truth: Parts, errors: Parts) -> FloatArray:
        parts = known_parts(self, truth, errors)
        empty = list(np.zeros((len(self.positions), *self.shape)))
        layout = layout_of(pieces_of(empty, self.positions, None, self.dx, self.dy))
        surface = part_of(parts, "surface", layout.shape, self.name)
        reference = part_of(parts, "reference", self.shape, self.name)
        if any(p.valid.shape != self.shape for p in layout.placed):
            raise DataError("stitch simulates sub-apertures that lie on whole pixels only")
        return np.stack([surface[p.rows, p.columns] + reference for p in layout.placed])

    def null_space(self) -> tuple[Unobservable, ...]:
        readings = np.zeros((len(self.positions), *self.shape))
        return replace(self, draws=0).separate(readings, u_reading=0.0).null_space

    def separate(self, readings: ArrayLike, *, u_reading: float | None = None) -> Separation:
        maps = _numbers(readings)
        if maps.ndim != 3 or maps.shape != (len(self.positions), *self.shape):
            raise DataError(
                f"stitch needs readings of the shape {(len(self.positions), *self.shape)}, got "
                f"{maps.shape}"
            )
        return stitch(
            list(maps),
            self.positions,
            dx=self.dx,
            dy=self.dy,
            freedoms=self.freedoms,
            reference="fit" if self.fit_reference else "none",
            reference_degree=self.reference_degree,
            u_reading=u_reading,
            draws=self.draws,
        )

    def correct(self, readings: ArrayLike) -> FloatArray:
        maps = _numbers(readings)
        return np.asarray(maps - self.separate(maps).reference) if self.fit_reference else maps


def checked_freedoms(freedoms: Sequence[str]) -> tuple[str, ...]:
    """Return the freedoms in their order, or refuse them."""
    try:
        names = (freedoms,) if isinstance(freedoms, str) else tuple(freedoms)
    except TypeError:
        raise DataError(
            f"stitch: freedoms are {freedoms!r}; give names out of {', '.join(_FREEDOMS)}"
        ) from None
    unknown = [n for n in names if n not in _FREEDOMS]
    if unknown or "piston" not in names:
        raise DataError(
            f"stitch: freedoms are {list(names)}; possible are piston (always), tilt, power"
        )
    return tuple(n for n in _FREEDOMS if n in names)


def _numbers(readings: ArrayLike) -> FloatArray:
    return as_numbers(readings, "stitch: the readings must be numbers in m")


def _without_known(pieces: Pieces, reference: ArrayLike | Surface | Profile) -> Pieces:
    z = reference.z if isinstance(reference, Surface | Profile) else reference
    known = np.atleast_2d(
        as_numbers(z, "stitch: reference must be none, fit or a map of heights in m")
    )
    for k, v in enumerate(pieces.values):
        if v.shape != known.shape:
            raise DataError(
                f"stitch: the reference has the shape {known.shape}, sub-aperture {k + 1} "
                f"{v.shape}; it is given in the pixels of the instrument"
            )
    if not math.isfinite(float(np.nansum(known))) or np.isnan(known).all():
        raise DataError("stitch: the reference holds no usable heights")
    return replace(pieces, values=tuple(v - known for v in pieces.values), known=known)


# ---- lateral offsets of sub-apertures: least squares of gradients, together with the freedoms ----

_MOST_PASSES = 30
_SETTLED = 1e-3
"""Change of a position, in steps, at which the passes end."""

_ENOUGH = 0.1
"""Share of the standard uncertainty below which a change does not matter."""

_SMOOTHING = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0

_LARGEST_STEP = 1.5
"""In pixels and pass: gradients say nothing about more."""

_LARGEST_U = 0.5
"""Standard uncertainty of an offset, in pixels, beyond which it is not a result."""


def registered(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[Pieces, dict[str, Any]]:
    """Return sub-apertures at fitted positions; the first stays where it is."""
    start, n_axes = pieces.corners.copy(), 1 if pieces.line else 2
    steps = np.array([pieces.dx, pieces.dy])[:n_axes]
    largest, damping, noise = math.inf, 1.0, math.nan
    for n_passes in range(1, _MOST_PASSES + 1):
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
                "registration_passes": n_passes,
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
    n, n_own = len(pieces), own.count
    require_connection(overlaps, n, least=n_own + n_axes + 1)
    plain = Problem(layout, overlaps, own)
    values = [p.values for p in layout.placed]
    mean = fitted_to(plain, inverse_of(normal_matrix(plain)), values)[2]
    slopes = _slopes(mean, layout, n_axes)
    layout = _where_known(layout, ~np.isnan(slopes.sum(axis=0)))
    overlaps, slopes = overlaps_of(layout), np.nan_to_num(slopes)
    require_connection(overlaps, n, least=n_own + n_axes + 1)

    def features(k: int, box: Box) -> FloatArray:
        p = layout.placed[k]
        return np.concatenate(
            [own.values(k, box), slopes[:, p.rows, p.columns][(slice(None), *box)]]
        )

    each = n_own + n_axes
    full = Problem(layout, overlaps, Terms(features))
    inverse = inverse_of(normal_matrix(full))
    if inverse.null.shape[1] > n_own + n_axes:
        raise DegenerateFitError(
            "stitch: the overlaps show no structure that fixes the lateral offsets (a plane or a "
            'parabola shifted looks tilted); use registration="trust"'
        )
    theta, fitted, mean = fitted_to(full, inverse, values)
    spread, _ = noise_of(full, fitted, mean, inverse.rank)
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
