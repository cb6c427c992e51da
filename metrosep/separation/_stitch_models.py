"""Models of a stitching: no reference, a polynomial, or a map of pixels that all share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.separation._overlaps import (
    Overlap,
)
from metrosep.separation._stitch_grid import Layout
from metrosep.separation._stitch_input import Pieces
from metrosep.separation._stitch_iteration import ReferenceSystem
from metrosep.separation._stitch_null import (
    NullModes,
    exponents,
    independent,
    instrument_grid,
    null_modes,
    polynomial,
    with_polynomials,
)
from metrosep.separation._stitch_reference import (
    links_of,
    resolved,
    scatter,
    without_modes,
)
from metrosep.separation._stitch_solve import (
    Inverse,
    Problem,
    fitted_pieces,
    freedom_terms,
    half_size,
    inverse_of,
    mean_of,
    noise_of,
    normal_matrix,
    right_side,
    variance_map,
)
from metrosep.separation._stitch_terms import n_of
from metrosep.separation.null_space import Unobservable

_ANALYSED_DEGREE = 4

_LARGEST_GAIN = 5.0
"""Scatter of a weakly tied pixel, for that of a reading, beyond which it is not given."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How to stitch."""

    freedoms: tuple[str, ...]  # of each sub-aperture
    fit_reference: bool  # whether a reference map is unknown
    degree: int | None  # of its polynomial; a map of pixels if None
    # {"remove", "surface"}: what happens to what reference and surface can exchange
    ambiguous: str
    draws: int  # simulated measurements for the uncertainty of a pixel map
    u_reading: float | None  # m: stated noise


@dataclass(frozen=True, slots=True)
class Solution:
    """What a model of the readings gives: parts, their u, windows without freedoms, words."""

    surface: FloatArray
    u_surface: FloatArray
    fitted: list[FloatArray]
    theta: FloatArray
    rank: int
    reference: FloatArray | None = None
    u_reference: FloatArray | None = None
    unobservable: tuple[Unobservable, ...] = ()
    audit: dict[str, Any] | None = None
    messages: tuple[str, ...] = ()
    noise: tuple[float, float] = (math.nan, 0.0)


def plain_problem(
    layout: Layout, overlaps: tuple[Overlap, ...], freedoms: tuple[str, ...], *, line: bool
) -> Problem:
    """Return the design with the freedoms only."""
    terms = freedom_terms(layout, freedoms, line=line)
    each = n_of(terms)
    n = len(layout.placed)
    columns = [k * each + np.arange(each) for k in range(n)]
    return Problem(layout, overlaps, terms, columns, n * each, layout.weights())


def rigid_basis(layout: Layout, freedoms: tuple[str, ...], *, line: bool) -> FloatArray:
    """Return what the freedoms of all sub-apertures together leave open, on the stitched grid."""
    x, y = layout.x - layout.x.mean(), layout.y - layout.y.mean()
    scale = max(float(np.abs(x).max()), float(np.abs(y).max()), np.finfo(float).tiny)
    u, v = np.meshgrid(x / scale, y / scale)
    out = []
    if "piston" in freedoms:
        out.append(np.ones_like(u))
    if "tilt" in freedoms:
        out += [u] if line else [u, v]
    if "power" in freedoms:
        out.append(u**2 if line else u**2 + v**2)
    return np.array(out)


def n_rigid(freedoms: tuple[str, ...], *, line: bool) -> int:
    """Return how many combinations the freedoms of all leave open."""
    return sum({"piston": 1, "tilt": 1 if line else 2, "power": 1}[f] for f in freedoms)


def _spread(problem: Problem, noise: tuple[float, float], settings: Settings) -> float:
    return noise[0] if settings.u_reading is None else settings.u_reading


def without_reference(
    problem: Problem,
    inverse: Inverse,
    values: list[FloatArray],
    pieces: Pieces,
    settings: Settings,
) -> Solution:
    """Return the stitching without a reference."""
    theta = inverse.matrix @ right_side(problem, values, mean_of(problem, values))
    fitted = fitted_pieces(problem, values, theta)
    mean = mean_of(problem, fitted)
    basis = rigid_basis(problem.layout, settings.freedoms, line=pieces.line)
    labels = np.where(problem.weight > 0.0, 0, -1)
    noise = noise_of(problem, fitted, mean, inverse.rank)
    u = _spread(problem, noise, settings) * np.sqrt(variance_map(problem, inverse.matrix, basis))
    surface = _cleaned(mean, labels, basis)
    return Solution(surface, u, fitted, theta, inverse.rank, noise=noise)


def _cleaned(values: FloatArray, labels: NDArray[np.int64], basis: FloatArray) -> FloatArray:
    """Remove a basis; the constant only where it is in the basis."""
    inside = labels >= 0
    b = basis[:, inside].T
    out = np.full(values.shape, np.nan)
    out[inside] = values[inside] - b @ np.linalg.lstsq(b, values[inside], rcond=1e-10)[0]
    return out


def _one_shape(pieces: Pieces) -> tuple[int, int]:
    shapes = {v.shape for v in pieces.values}
    if len(shapes) > 1:
        raise DataError(
            f"stitch: a shared reference needs {pieces.kind}s of one shape, got {sorted(shapes)}"
        )
    shape = shapes.pop()
    return (int(shape[0]), int(shape[1]))


def with_polynomial(
    problem: Problem, values: list[FloatArray], pieces: Pieces, settings: Settings
) -> Solution:
    """Return the stitching with a polynomial that all sub-apertures share."""
    degree = settings.degree or 0
    shape, layout = _one_shape(pieces), problem.layout
    full = with_polynomials(
        layout,
        problem.overlaps,
        settings.freedoms,
        degree,
        line=pieces.line,
        weight=problem.weight,
    )
    inverse = inverse_of(normal_matrix(full))
    theta = inverse.matrix @ right_side(full, values, mean_of(full, values))
    fitted = fitted_pieces(full, values, theta)
    mean = mean_of(full, fitted)
    noise = noise_of(full, fitted, mean, inverse.rank)
    modes = null_modes(full, inverse, degree, shape, line=pieces.line)
    u, v = instrument_grid(layout, shape)
    scale = half_size(layout.placed[0])
    powers = exponents(degree, line=pieces.line)
    maps = polynomial(u / scale, v / scale, powers)
    n_shared = len(powers)
    everywhere = np.zeros(shape, dtype=np.int64)
    plane = modes.reference
    reference = _cleaned(np.tensordot(theta[-n_shared:], maps, axes=1), everywhere, plane)
    flat, flat_plane = maps.reshape(n_shared, -1), plane.reshape(plane.shape[0], -1)
    flat = flat - (flat @ flat_plane.T) @ flat_plane
    block = inverse.matrix[-n_shared:, -n_shared:]
    variance = np.einsum("ip,ij,jp->p", flat, block, flat, optimize=True).reshape(shape)
    spread = _spread(problem, noise, settings)
    basis = _removed_basis(problem, modes, pieces, settings)
    labels = np.where(problem.weight > 0.0, 0, -1)
    if settings.ambiguous == "surface":
        rest = [z - p.forward(reference) for p, z in zip(layout.placed, values, strict=True)]
        simple = inverse_of(normal_matrix(problem)).matrix
        mean = mean_of(
            problem,
            fitted_pieces(
                problem, rest, simple @ right_side(problem, rest, mean_of(problem, rest))
            ),
        )
        basis_out = rigid_basis(layout, settings.freedoms, line=pieces.line)
    else:
        basis_out = basis
    return Solution(
        _cleaned(mean, labels, basis_out),
        spread * np.sqrt(variance_map(full, inverse.matrix, basis)),
        fitted,
        theta,
        inverse.rank,
        reference,
        spread * np.sqrt(np.maximum(variance, 0.0)),
        _ambiguities(modes, settings, 1),
        {"reference_model": f"polynomial of degree {degree}"},
        _ambiguity_messages(modes, settings),
        noise,
    )


def with_pixels(
    problem: Problem,
    inverse: Inverse,
    values: list[FloatArray],
    pieces: Pieces,
    settings: Settings,
) -> Solution:
    """Return the stitching with a map of pixels that all sub-apertures share."""
    shape = _one_shape(pieces)
    layout = problem.layout
    links = links_of(problem, shape, pieces.kind)
    full = with_polynomials(
        layout,
        problem.overlaps,
        settings.freedoms,
        _ANALYSED_DEGREE,
        line=pieces.line,
        weight=problem.weight,
    )
    modes = null_modes(
        full, inverse_of(normal_matrix(full)), _ANALYSED_DEGREE, shape, line=pieces.line
    )
    system = ReferenceSystem(problem, inverse, shape)
    raw = system.solve(system.left(values))
    steps = system.steps
    basis = _removed_basis(problem, modes, pieces, settings)
    links = resolved(problem, inverse, system, links, (modes.reference, basis))
    su_r, su_s = scatter(problem, inverse, system, links, (modes.reference, basis), settings.draws)
    wild = system.weak & (np.nan_to_num(su_r) > _LARGEST_GAIN)
    links = replace(links, instrument=np.where(wild, -1, links.instrument))
    reference = without_modes(raw, links.instrument, modes.reference)
    used = _continued(raw, reference, modes.reference)
    rest = [z - p.forward(used) for p, z in zip(layout.placed, values, strict=True)]
    theta = inverse.matrix @ right_side(problem, rest, mean_of(problem, rest))
    fitted = fitted_pieces(problem, rest, theta)
    labels = links.surface
    mean = mean_of(problem, fitted)
    if settings.ambiguous == "surface":
        rigid = rigid_basis(layout, settings.freedoms, line=pieces.line)
        surface = _cleaned(mean, np.where(labels >= 0, 0, -1), rigid)
    else:
        surface = without_modes(mean, labels, basis)
    n_modes = modes.reference.shape[0]
    n_pixels = int((links.instrument >= 0).sum())
    rank = inverse.rank + n_pixels - links.n_groups - max(n_modes - 1, 0)
    noise = noise_of(problem, fitted, mean, rank)
    spread = _spread(problem, noise, settings)
    lost = int((links.instrument < 0).sum())
    messages = list(_ambiguity_messages(modes, settings))
    if lost:
        messages.append(
            f"{lost} of {links.instrument.size} pixels of the reference are compared with no other "
            "(no overlap reaches them, one step size only, or interpolation with small weights): they "
            "are NaN, and so is the surface that only pixels without any comparison have seen"
        )
    if links.n_groups > 1:
        messages.append(
            f"the overlaps link the reference's pixels in {links.n_groups} groups; the mean of each "
            "group is not observable: steps without a common divisor, in x and in y, link them all"
        )
    return Solution(
        surface,
        spread * su_s,
        fitted,
        theta,
        rank,
        reference,
        spread * su_r,
        _ambiguities(modes, settings, links.n_groups, lost),
        {
            "reference_model": "one value a pixel",
            "reference_groups": links.n_groups,
            "reference_not_determined": lost,
            "reference_steps": steps,
            "uncertainty_draws": settings.draws,
        },
        tuple(messages),
        noise,
    )


def _continued(raw: FloatArray, reference: FloatArray, modes: FloatArray) -> FloatArray:
    """Return the reference with its undetermined pixels as the iteration left them, in its gauge."""
    lost = np.isnan(reference)
    if not lost.any():
        return reference
    b = modes[:, ~lost].T
    found = np.linalg.lstsq(b, (raw - reference)[~lost], rcond=1e-10)[0]
    return np.where(lost, raw - np.tensordot(found, modes, axes=1), reference)


def _removed_basis(
    problem: Problem, modes: NullModes, pieces: Pieces, settings: Settings
) -> FloatArray:
    rigid = rigid_basis(problem.layout, settings.freedoms, line=pieces.line)
    rigid = rigid * (problem.weight > 0.0)
    rigid /= np.sqrt((rigid**2).sum(axis=(1, 2), keepdims=True))
    return independent(np.concatenate([rigid, modes.surface]) if modes.surface.size else rigid)


def _ambiguities(
    modes: NullModes, settings: Settings, n_groups: int, lost: int = 0
) -> tuple[Unobservable, ...]:
    out = []
    where = "removed from both" if settings.ambiguous == "remove" else "given to the surface"
    if modes.terms:
        reason = (
            "a sub-aperture's freedoms absorb the difference that a shift makes of it, so reference "
            f"and surface can exchange it unseen: {where}; measure it once by other means (a known "
            "radius, a three-flat test, a turned sub-aperture for astigmatism)"
        )
        out += [
            Unobservable(part, "term", modes.terms, reason) for part in ("surface", "reference")
        ]
    if n_groups > 1:
        reason = f"no overlap compares pixels of different groups: {where}"
        name = f"mean of each of {n_groups} groups of pixels"
        out += [Unobservable(part, "term", (name,), reason) for part in ("surface", "reference")]
    out.append(Unobservable("reference", "polynomial", (0, 1), "piston and tilt are freedoms"))
    if lost:
        out.append(
            Unobservable("reference", "samples", (lost,), "no overlap compares them with others")
        )
    return tuple(out)


def _ambiguity_messages(modes: NullModes, settings: Settings) -> tuple[str, ...]:
    if not modes.terms:
        return ()
    where = (
        "removed from both"
        if settings.ambiguous == "remove"
        else "given to the surface, as if the reference were free of it; u does not cover it"
    )
    text = (
        f"ambiguous between surface and reference, {where}: {', '.join(modes.terms)}. A reference "
        "error of curvature c bends the stitched length L by c L^2/8"
    )
    return (text,)
