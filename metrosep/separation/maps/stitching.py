"""Sub-aperture stitching: one surface from overlapping measurements, with a shared reference."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, DegenerateFitError, MetrosepError, NotConvergedError
from metrosep.core.numbers import choice, count
from metrosep.core.options import Option, option
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation._readings import as_numbers, known_parts, part_of
from metrosep.separation.contract import (
    U_READING,
    Parts,
    Separation,
    SeparationMethod,
    Unobservable,
    as_stated,
)
from metrosep.separation.maps._map_input import checked_u
from metrosep.separation.maps._stitch_grid import (
    Layout,
    Pieces,
    layout_of,
    mirrored_piece,
    outlying_pairs,
    overlaps_of,
    pair_residuals,
    pieces_of,
    require_connection,
    without_own_plane,
)
from metrosep.separation.maps._stitch_models import (
    Settings,
    Solution,
    connected,
    with_pixels,
    with_polynomial,
    without_reference,
)
from metrosep.separation.maps._stitch_solve import (
    Box,
    Problem,
    Terms,
    fitted_to,
    freedom_terms,
    inverse_of,
    noise_of,
    normal_matrix,
    own_residuals,
)

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
        "positions": Option("places", help="of the maps; those of the files if omitted"),
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


# ---- one stitching from checked sub-apertures to a `Separation` ------------------------------

_RIGID = "how the whole lies in space is arbitrary; it was removed by least squares"


def run(pieces: Pieces, settings: Settings, extra: dict[str, Any]) -> Separation:
    """Return the stitched surface."""
    problem, inverse, values = connected(pieces, settings.freedoms)
    if not settings.fit_reference:
        solution = without_reference(problem, inverse, values, pieces, settings)
    elif settings.degree is None:
        solution = with_pixels(problem, inverse, values, pieces, settings)
    else:
        solution = with_polynomial(problem, values, pieces, settings)
    return _result(problem, solution, pieces, settings, extra)


def _result(
    problem: Problem,
    s: Solution,
    pieces: Pieces,
    settings: Settings,
    extra: dict[str, Any],
) -> Separation:
    layout, line = problem.layout, pieces.line
    residuals = pair_residuals(layout, problem.overlaps, s.fitted)
    size = max(float(np.nanmax(np.abs(v))) for v in pieces.values)
    own = own_residuals(problem, s.fitted)
    floor = 1e-9 * size
    bad, shown = outlying_pairs(own, floor, settings.u_reading), own
    if not bad:
        bad, shown = outlying_pairs(residuals, floor, settings.u_reading), residuals
    _refuse_mirrored(pieces, problem, residuals, bad)
    messages = [*pieces.warnings, *extra.pop("messages", ()), *s.messages]
    messages += _outlier_messages(problem, shown, bad)
    stated = settings.u_reading
    messages += setup_warnings(
        pieces,
        problem,
        s.fitted,
        settings.freedoms,
        beyond_stated=stated is not None and s.noise[0] > 1.5 * stated > 0.0,
        named=bool(bad),
    )
    if settings.u_reading is None and math.isnan(s.noise[0]):
        messages.append("the overlaps are too small to show the noise: give u_reading")
    if settings.u_reading is not None and s.noise[0] > 1.5 * settings.u_reading > 0.0:
        messages.append(
            f"the overlaps scatter by {1e9 * s.noise[0]:.3g} nm, the stated noise is "
            f"{1e9 * settings.u_reading:.3g} nm: positions, drift or the instrument's reference "
            "do not fit, and u is too small"
        )
    if settings.fit_reference and settings.degree is None and settings.draws == 0:
        messages.append("no uncertainty was simulated (draws=0)")
    n_each = problem.columns[0].size
    parts = {"surface": s.surface}
    u = {"surface": np.where(np.isnan(s.surface), np.nan, s.u_surface)}
    if s.reference is not None and s.u_reference is not None:
        parts["reference"] = s.reference
        u["reference"] = np.where(np.isnan(s.reference), np.nan, s.u_reference)
    coordinates = {"x": layout.x} if line else {"x": layout.x, "y": layout.y}
    if line:
        parts, u = ({k: v[0] for k, v in d.items()} for d in (parts, u))
    audit = {
        "n_sub_apertures": len(pieces),
        "freedoms": list(settings.freedoms),
        "freedoms_nm": (1e9 * s.theta[: n_each * len(pieces)].reshape(-1, n_each))
        .round(6)
        .tolist(),
        "positions_mm": (1e3 * pieces.corners[:, : 1 if line else 2]).tolist(),
        "shapes": [list(v.shape) for v in pieces.values],
        "step_mm": [1e3 * pieces.dx, 1e3 * pieces.dy],
        "rotations_rad": pieces.turns.tolist(),
        "overlaps": [
            {
                "pair": [o.i + 1, o.j + 1],
                "n": o.n,
                "residual_nm": float(1e9 * r),
                "own_residual_nm": float(1e9 * q),
            }
            for o, r, q in zip(problem.overlaps, residuals, own, strict=True)
        ],
        "outlying_pairs": [[problem.overlaps[k].i + 1, problem.overlaps[k].j + 1] for k in bad],
        "noise_from_overlaps_nm": None if math.isnan(s.noise[0]) else 1e9 * s.noise[0],
        "degrees_of_freedom": s.noise[1],
        "weights": "plain mean of all sub-apertures at a pixel (inverse variance), no feathering",
        "removed": "least squares: piston" + ", tilt" * ("tilt" in settings.freedoms),
        "n_not_measured": int(np.isnan(s.surface).sum()),
        **(s.audit or {}),
        **extra,
    }
    names = {"piston": 0, "tilt": 1, "power": 2}
    rigid = Unobservable(
        "surface", "polynomial", tuple(names[f] for f in settings.freedoms), _RIGID
    )
    step = Step(
        "stitch",
        {
            "n": len(pieces),
            "freedoms": list(settings.freedoms),
            "reference": settings.fit_reference,
        },
    )
    return Separation(
        "stitch",
        parts,
        u,
        dict.fromkeys(parts, "m"),
        coordinates,
        (rigid, *s.unobservable),
        noise=_noise(s.noise, settings),
        audit=audit,
        messages=tuple(messages),
        history=(*pieces.history, step),
    )


def _noise(noise: tuple[float, float], settings: Settings) -> Quantity:
    if settings.u_reading is not None:
        return as_stated(settings.u_reading, "m")
    text = f"standard deviation of one reading, from the overlaps (type A, {noise[1]:.0f} d.o.f.)"
    u = noise[0] / math.sqrt(2.0 * noise[1]) if noise[1] >= 1.0 else None
    return Quantity(noise[0], "m", text, u=u, symbol="s")


def _refuse_mirrored(
    pieces: Pieces, problem: Problem, residuals: FloatArray, bad: list[int]
) -> None:
    suspects = {i for k in bad for i in (problem.overlaps[k].i, problem.overlaps[k].j)}
    if not suspects:
        rough = math.sqrt(sum(float(np.nanvar(v)) for v in pieces.values) / len(pieces))
        if float(residuals.max()) <= 0.3 * rough:
            return
        suspects = set(range(len(pieces)))
    found = mirrored_piece(pieces, problem.layout, problem.overlaps, suspects)
    if found is not None:
        raise DataError(
            f"stitch: {pieces.kind} {found[0] + 1} fits its neighbours only when {found[1]}; turn it "
            "round, or correct its position, before stitching"
        )


def _outlier_messages(problem: Problem, residuals: FloatArray, bad: list[int]) -> list[str]:
    if not bad:
        return []
    median = float(np.median(residuals))
    messages = [
        f"overlap of {problem.overlaps[k].i + 1} and {problem.overlaps[k].j + 1}: mismatch "
        f"{residuals[k] * 1e9:.3g} nm, the median of all is {median * 1e9:.3g} nm"
        for k in bad[:6]
    ]
    if len(bad) > 6:
        messages.append(f"{len(bad) - 6} further overlaps do not fit")
    counts: dict[int, int] = {}
    for k in bad:
        for i in (problem.overlaps[k].i, problem.overlaps[k].j):
            counts[i] = counts.get(i, 0) + 1
    worst = max(counts, key=lambda i: counts[i])
    if counts[worst] > 1:
        messages.append(
            f"sub-aperture {worst + 1} is in {counts[worst]} of these: its position, its measurement "
            'or the part changed; registration="fit" finds a lateral shift'
        )
    return messages


# ---- overlaps that disagree by more than noise: is it shown, and which other set-up would fit ----

_ALIKE = 0.6
"""Correlation of neighbouring mismatches; white noise has 0, interpolated noise up to 0.4."""

_ALIKE_ON_PIXELS = 0.3
"""The same where nothing was interpolated; instruments that smooth have up to about this."""

_LEAST_OF_ONE = 200
"""Pairs of neighbours for which a single overlap is judged: 0.6 is then 8 standard deviations."""

_CHANCE = 4.0
"""Standard deviations of the correlation of white noise that are not evidence."""

_LEAST_SHARE = 0.02
"""Of the structure in the overlaps: what interpolation of a rough part leaves is less."""

_LEAST_SAMPLES = 30
_BETTER = 0.5
_COARSE = 48
"""Pixels along the longer side on which other set-ups are tried."""

_TURNS = {
    "with the sign of x of the positions reversed": ((-1, 0), (0, 1)),
    "with the sign of y of the positions reversed (or the rows of each map in the other order)": (
        (1, 0),
        (0, -1),
    ),
    "with the signs of x and y of the positions reversed": ((-1, 0), (0, -1)),
    "with x and y of the positions exchanged": ((0, 1), (1, 0)),
    "with x and y of the positions exchanged and the sign of the new y reversed": (
        (0, 1),
        (-1, 0),
    ),
    "with x and y of the positions exchanged and the sign of the new x reversed": (
        (0, -1),
        (1, 0),
    ),
    "with x and y of the positions exchanged and both signs reversed": ((0, -1), (-1, 0)),
}


def setup_warnings(
    pieces: Pieces,
    problem: Problem,
    fitted: list[FloatArray],
    freedoms: tuple[str, ...],
    *,
    beyond_stated: bool,
    named: bool,
) -> list[str]:
    """Return what is to be said where the overlaps disagree by more than noise."""
    alike, share = likeness(problem, fitted)
    structured = alike > _ALIKE and share > _LEAST_SHARE
    if not (beyond_stated or structured):
        return []
    found = better_setup(pieces, freedoms)
    if found is not None:
        how, ratio = found
        times = f"{1 / ratio:.2g}" if ratio > 0.01 else "over 100"
        text = (
            f"the overlaps disagree by more than noise, and fit {times} times better {how}: the "
            "set-up is likely wrong, and u does not cover it"
        )
        return [text]
    if named or not structured:
        return []
    text = (
        "the overlaps disagree by more than noise (neighbouring mismatches are alike): positions, "
        "signs, rotations, drift or the instrument's reference do not fit, and u does not cover it"
    )
    return [text]


def likeness(problem: Problem, fitted: list[FloatArray]) -> tuple[float, float]:
    """Return the correlation of neighbouring mismatches, and their RMS over that of the surface.

    The correlation is that of all overlaps, or of the worst one; on pixels, where noise has none,
    it is scaled so that one limit serves.
    """
    product, size, squares, structure, n, worst = 0.0, 0.0, 0.0, 0.0, 0, 0.0
    for o in problem.overlaps:
        a, b = problem.layout.placed[o.i], problem.layout.placed[o.j]
        both = a.valid[o.in_i] & b.valid[o.in_j]
        z = np.where(both, fitted[o.i][o.in_i], 0.0)
        d = np.where(both, z - fitted[o.j][o.in_j], 0.0)
        squares, structure = squares + float(np.vdot(d, d)), structure + _rough(z, both)
        own_product, own_size, own_n = 0.0, 0.0, 0
        d2 = d * d
        for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            own_product += float(np.vdot(d[first], d[second]))  # zero where not both measured
            own_size += 0.5 * float(
                (d2[first] * both[second]).sum() + (d2[second] * both[first]).sum()
            )
            own_n += int(np.count_nonzero(both[first] & both[second]))
        product, size, n = product + own_product, size + own_size, n + own_n
        if own_n >= _LEAST_OF_ONE and own_size > 0.0:
            worst = max(worst, own_product / own_size)
    if n < _LEAST_SAMPLES or size <= 0.0 or structure <= 0.0:
        return 0.0, 0.0
    alike = max(product / size - _CHANCE / math.sqrt(n), 0.0)
    if not any(p.operator for p in problem.layout.placed):
        alike = min(alike * _ALIKE / _ALIKE_ON_PIXELS, 1.0)
    return max(alike, worst), math.sqrt(squares / structure)


def _rough(z: FloatArray, both: NDArray[np.bool_]) -> float:
    """Return the sum of squares about a plane: the whole may lie in space as it likes."""
    rest = without_own_plane(z, both)
    return float(np.vdot(rest, rest))


def better_setup(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[str, float] | None:
    """Return the other set-up that fits best, if it fits at least twice as well."""
    coarse = _coarse(pieces)
    given = _mismatch(coarse, freedoms)
    if given is None or given[0] <= 0.0:
        return None
    best: tuple[str, float] | None = None
    for how, other in _others(coarse):
        found = _mismatch(other, freedoms)
        if found is None or found[1] < 0.3 * given[1]:
            continue
        ratio = max(found[0] / given[0], 1e-9)
        if ratio < _BETTER and (best is None or ratio < best[1]):
            best = (how, ratio)
    return best


def _others(pieces: Pieces) -> Iterator[tuple[str, Pieces]]:
    origin = pieces.corners[0]
    for how, turn in _TURNS.items():
        if pieces.line and "sign of x of" not in how:
            continue
        corners = origin + (pieces.corners - origin) @ np.array(turn, dtype=np.float64).T
        if not np.array_equal(corners, pieces.corners):
            yield how, replace(pieces, corners=corners)
    if np.any(pieces.turns != 0.0):
        yield "with the sign of the rotations reversed", replace(pieces, turns=-pieces.turns)
    if pieces.known is not None:
        values = tuple(v + 2.0 * pieces.known for v in pieces.values)
        yield "with the sign of the known reference reversed", replace(pieces, values=values)


def _coarse(pieces: Pieces) -> Pieces:
    """Return every q-th pixel, q odd, of windows about the same centres."""
    longest = max(max(v.shape) for v in pieces.values)
    shortest = longest if pieces.line else min(min(v.shape) for v in pieces.values)
    q = 2 * (min(longest // _COARSE, shortest // 8) // 2) + 1
    if q == 1:
        return pieces
    values, corners = [], pieces.corners.copy()
    known = pieces.known
    for k, v in enumerate(pieces.values):
        rows = np.s_[0:1] if pieces.line else _every(v.shape[0], q)
        columns = _every(v.shape[1], q)
        values.append(v[rows, columns])
        corners[k] += [columns.start * pieces.dx, rows.start * pieces.dy]
        if k == 0 and known is not None:
            known = known[rows, columns]
    dy = pieces.dy if pieces.line else q * pieces.dy
    return replace(
        pieces, values=tuple(values), corners=corners, dx=q * pieces.dx, dy=dy, known=known
    )


def _every(n: int, q: int) -> slice:
    cut = next(j for j in range(q) if (n - 1 - 2 * j) % q == 0)
    return slice(cut, n - cut, q)


def _mismatch(pieces: Pieces, freedoms: tuple[str, ...]) -> tuple[float, float] | None:
    """Return the noise that the overlaps show, and its degrees of freedom."""
    try:
        problem, inverse, values = connected(pieces, freedoms)
    except MetrosepError:
        return None
    _, fitted, mean = fitted_to(problem, inverse, values)
    noise, freedom = noise_of(problem, fitted, mean, inverse.rank)
    return (noise, freedom) if freedom >= _LEAST_SAMPLES else None
