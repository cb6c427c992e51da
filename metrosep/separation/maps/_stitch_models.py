"""Models of a stitching: no reference, a polynomial, or a map of pixels that all share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotSeparableError
from metrosep.separation.contract import Unobservable
from metrosep.separation.maps._stitch_grid import (
    Layout,
    Overlap,
    Pieces,
    layout_of,
    overlaps_of,
    require_connection,
)
from metrosep.separation.maps._stitch_solve import (
    Inverse,
    PolynomialTerms,
    Problem,
    ReferenceSystem,
    fitted_to,
    freedom_maps,
    freedom_terms,
    half_size,
    inverse_of,
    noise_of,
    normal_matrix,
    require_rank,
    variance_map,
)

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


def connected(
    pieces: Pieces, freedoms: tuple[str, ...]
) -> tuple[Problem, Inverse, list[FloatArray]]:
    """Return the design with the freedoms only, its inverse and the windows, or refuse gaps."""
    layout = layout_of(pieces)
    overlaps = overlaps_of(layout)
    problem = plain_problem(layout, overlaps, freedoms, line=pieces.line)
    require_connection(overlaps, len(pieces), least=problem.terms.count + 1)
    inverse = inverse_of(normal_matrix(problem))
    # all freedoms together leave open as many combinations as one sub-aperture has
    require_rank(inverse, problem, problem.terms.count)
    return problem, inverse, [p.values for p in layout.placed]


def plain_problem(
    layout: Layout, overlaps: tuple[Overlap, ...], freedoms: tuple[str, ...], *, line: bool
) -> Problem:
    """Return the design with the freedoms only."""
    return Problem(layout, overlaps, freedom_terms(layout, freedoms, line=line))


def rigid_basis(layout: Layout, freedoms: tuple[str, ...], *, line: bool) -> FloatArray:
    """Return what the freedoms of all sub-apertures together leave open, on the stitched grid."""
    x, y = layout.x - layout.x.mean(), layout.y - layout.y.mean()
    scale = max(float(np.abs(x).max()), float(np.abs(y).max()), np.finfo(float).tiny)
    return freedom_maps(*np.meshgrid(x / scale, y / scale), freedoms, line=line)


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
    theta, fitted, mean = fitted_to(problem, inverse, values)
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
    full = with_polynomials(layout, problem.overlaps, settings.freedoms, degree, line=pieces.line)
    inverse = inverse_of(normal_matrix(full))
    theta, fitted, mean = fitted_to(full, inverse, values)
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
        mean = _with_reference(problem, inverse_of(normal_matrix(problem)), values, reference)[2]
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
    links = links_of(problem, shape, pieces.kind)
    full = with_polynomials(
        problem.layout, problem.overlaps, settings.freedoms, _ANALYSED_DEGREE, line=pieces.line
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
    theta, fitted, mean = _with_reference(problem, inverse, values, used)
    labels = links.surface
    if settings.ambiguous == "surface":
        rigid = rigid_basis(problem.layout, settings.freedoms, line=pieces.line)
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


# ---- what stitching cannot see of a reference map, from the rank of the actual design ----------

_IN_NULL = 1e-3
"""Share of a named term outside the null space below which the term counts as lying in it."""


@dataclass(frozen=True, slots=True)
class NullModes:
    """Polynomial changes of reference and surface that no reading shows."""

    terms: tuple[str, ...]  # named ones beyond piston and tilt
    # shape (n_r, n_y, n_x): basis on the instrument's pixels, piston and tilt included
    reference: FloatArray
    surface: FloatArray  # shape (n_s, grid): basis on the stitched grid


def exponents(degree: int, *, line: bool) -> list[tuple[int, int]]:
    """Return the exponents (a, b) of x and y of all polynomials up to a total degree."""
    if line:
        return [(a, 0) for a in range(degree + 1)]
    return [(n - b, b) for n in range(degree + 1) for b in range(n + 1)]


def polynomial(u: FloatArray, v: FloatArray, powers: list[tuple[int, int]]) -> FloatArray:
    """Return products of Legendre polynomials at scaled positions, one map for each exponent."""
    from numpy.polynomial.legendre import legvander

    shape: tuple[int, ...] = np.broadcast_shapes(u.shape, v.shape)
    top = max(max(p) for p in powers)
    in_u, in_v = legvander(u, top), legvander(v, top)
    return np.stack([np.broadcast_to(in_u[..., a] * in_v[..., b], shape) for a, b in powers])


def with_polynomials(
    layout: Layout,
    overlaps: tuple[Overlap, ...],
    freedoms: tuple[str, ...],
    degree: int,
    *,
    line: bool,
) -> Problem:
    """Return the design of the freedoms with a shared polynomial of the instrument."""
    own = freedom_terms(layout, freedoms, line=line)
    powers = exponents(degree, line=line)
    scale = half_size(layout.placed[0])

    def make(k: int, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.concatenate([own.make(k, x, y), polynomial(x / scale, y / scale, powers)])

    terms = PolynomialTerms(layout, make, max(degree, own.degree))
    return Problem(layout, overlaps, terms, len(powers))


def null_modes(
    problem: Problem, inverse: Inverse, degree: int, shape: tuple[int, int], *, line: bool
) -> NullModes:
    """Return the polynomials that a design with a shared polynomial leaves open."""
    powers = exponents(degree, line=line)
    piece = problem.layout.placed[0]
    scale = half_size(piece)
    u, v = instrument_grid(problem.layout, shape)
    maps = polynomial(u / scale, v / scale, powers)
    shared = inverse.null[-len(powers) :]
    reference = independent(np.tensordot(shared.T, maps, axes=1))
    surface = _means_of_modes(problem, inverse.null)
    terms = _named_terms(reference, u / scale, v / scale, line=line)
    return NullModes(terms, reference, independent(surface))


def _means_of_modes(problem: Problem, vectors: FloatArray) -> FloatArray:
    out = np.zeros((vectors.shape[1], *problem.weight.shape))
    for k, p in enumerate(problem.layout.placed):
        mode = problem.terms.combine(k, vectors[problem.columns[k]].T)
        out[:, p.rows, p.columns] += problem.share(k) * mode
    return out


def instrument_grid(layout: Layout, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return x (1, n_x) and y (n_y, 1) of the instrument's pixels from its centre, m."""
    n_y, n_x = shape
    dx = layout.x[1] - layout.x[0] if layout.x.size > 1 else 1.0
    dy = layout.y[1] - layout.y[0] if layout.y.size > 1 else 1.0
    u = ((np.arange(n_x) - (n_x - 1) / 2) * dx)[None, :]
    v = ((np.arange(n_y) - (n_y - 1) / 2) * dy)[:, None]
    return u, v


def independent(maps: FloatArray) -> FloatArray:
    """Return an orthonormal basis of what maps span; directions below 1e-5 are rounding."""
    flat = maps.reshape(maps.shape[0], -1)
    gram = flat @ flat.T
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-10 * max(float(values[-1]), np.finfo(float).tiny)
    basis = (vectors[:, good] / np.sqrt(values[good])).T @ flat
    return np.asarray(basis.reshape((-1, *maps.shape[1:])))


def _named_terms(
    reference: FloatArray, u: FloatArray, v: FloatArray, *, line: bool
) -> tuple[str, ...]:
    one = np.ones(np.broadcast_shapes(u.shape, v.shape))
    candidates = {"power": (u**2 + (0 if line else v**2)) * one}
    if not line:
        candidates["astigmatism 0"] = (u**2 - v**2) * one
        candidates["astigmatism 45"] = u * v * one
    candidates["cubic in x"] = u**3 * one
    if not line:
        candidates["cubic in y"] = v**3 * one
        candidates["coma x"] = (u**2 + v**2) * u * one
        candidates["coma y"] = (u**2 + v**2) * v * one
    plane = [one, u * one] if line else [one, u * one, v * one]
    flat = reference.reshape(reference.shape[0], -1)
    base = np.array([p.ravel() for p in plane]).T
    found = []
    for name, term in candidates.items():
        t = term.ravel()
        t = t - base @ np.linalg.lstsq(base, t, rcond=None)[0]
        rest = t - flat.T @ (flat @ t)
        if np.linalg.norm(rest) < _IN_NULL * np.linalg.norm(t):
            found.append(name)
    return tuple(found)


# ---- the reference map that all sub-apertures share, pixel by pixel: what links, solution, scatter ----

LabelArray = NDArray[np.int64]

_LEAST_GROUP = 8
"""Pixels that a group of linked pixels must hold to be kept."""

_NO_MODE = 1e-5
"""Share of a mode left by the means of the groups, below which it was only a sum of them."""

_RESOLVED = 0.02
"""Error of a random reference, for its size, beyond which a pixel is not determined."""

_OF_DRAWS = 1e-4
"""The same for simulated noise: u changes by less than 1 % against 1e-6."""


@dataclass(frozen=True, slots=True)
class Links:
    """Groups of the instrument's pixels that overlaps link; between groups nothing is compared."""

    # shape (n_y, n_x): group of each pixel of the instrument; -1 where it is in none
    instrument: LabelArray
    surface: LabelArray  # shape (grid): group of each pixel of the stitched grid
    n_groups: int  # how many


def links_of(problem: Problem, shape: tuple[int, int], kind: str) -> Links:
    """Return which pixels of the instrument the overlaps link."""
    from scipy import sparse
    from scipy.sparse.csgraph import connected_components

    n_inst, n_all = shape[0] * shape[1], problem.weight.size
    instrument, grid = [], []
    index = np.arange(n_all).reshape(problem.weight.shape)
    rows, columns = np.divmod(np.arange(n_inst, dtype=np.float64).reshape(shape), shape[1])
    for p in problem.layout.placed:
        r, c = np.rint(p.forward(rows)).astype(int), np.rint(p.forward(columns)).astype(int)
        instrument.append((r * shape[1] + c)[p.valid])
        grid.append(index[p.rows, p.columns][p.valid])
    a, b = np.concatenate(instrument), np.concatenate(grid) + n_inst
    graph = sparse.coo_matrix(
        (np.ones(a.size, dtype=np.int8), (a, b)), shape=(n_inst + n_all,) * 2
    )
    _, labels = connected_components(graph, directed=False)
    size = np.bincount(labels[:n_inst], minlength=labels.max() + 1)
    measured = np.zeros(n_inst, dtype=bool)
    measured[a] = True
    big = size >= _LEAST_GROUP
    new = np.where(big, np.cumsum(big) - 1, -1)
    n_groups = int(big.sum())
    if n_groups == 0:
        raise NotSeparableError(
            f"stitch: no pixel of the reference is compared with enough others: the {kind}s were "
            "shifted by one step size only, so any error that repeats with it looks like the part. "
            "Measure with a second step size (no multiple of the first), or a turned sub-aperture, "
            'or fit a polynomial: reference_degree=4, or take reference="none"'
        )
    of_inst = np.where(measured, new[labels[:n_inst]], -1).reshape(shape)
    of_all = new[labels[n_inst:]].reshape(problem.weight.shape)
    of_all = np.where(problem.weight > 0.0, of_all, -1)
    return Links(of_inst.astype(np.int64), of_all.astype(np.int64), n_groups)


def without_modes(values: FloatArray, labels: LabelArray, modes: FloatArray) -> FloatArray:
    """Return values without the mean of each group and without smooth modes, least squares."""
    inside = (labels >= 0) & np.isfinite(values)
    out = np.full(values.shape, np.nan)
    if not inside.any():
        return out
    group = labels[inside]
    y = _group_centred(values[inside], group)
    whole = np.stack([m[inside] for m in modes], axis=1)
    b = np.stack([_group_centred(m, group) for m in whole.T], axis=1)
    directions, size, _ = np.linalg.svd(b, full_matrices=False)
    kept = directions[:, size > _NO_MODE * np.linalg.norm(whole, axis=0).max()]
    out[inside] = y - kept @ (kept.T @ y)
    return out


def resolved(
    problem: Problem,
    inverse: Inverse,
    system: ReferenceSystem,
    links: Links,
    modes: tuple[FloatArray, FloatArray],
) -> Links:
    """Return the groups without pixels at which random references do not come back."""
    instrument, surface = links.instrument, links.surface
    for readings, truth, found in system.probes():
        instrument = _agreeing(found - truth, instrument, modes[0])
        error = _with_reference(problem, inverse, readings, found)[2]
        surface = _agreeing(np.nan_to_num(error), surface, modes[1])
    return Links(instrument, surface, links.n_groups)


def _agreeing(error: FloatArray, labels: LabelArray, modes: FloatArray) -> LabelArray:
    """Return labels without errors; they pull at the removed modes, so the worst go first."""
    while (labels >= 0).any():
        rest = np.abs(without_modes(error, labels, modes))
        wrong = rest > max(_RESOLVED, 4.0 * float(np.nanmedian(rest)))
        if not wrong.any():
            break
        labels = np.where(wrong, -1, labels)
    return labels


def scatter(
    problem: Problem,
    inverse: Inverse,
    system: ReferenceSystem,
    links: Links,
    modes: tuple[FloatArray, FloatArray],
    draws: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviation of reference and surface for noise of one, by simulation."""
    rng = np.random.default_rng(0)
    of_r, of_s = np.zeros(system.shape), np.zeros(problem.weight.shape)
    for _ in range(draws):
        noise = [p.forward(rng.standard_normal(system.shape)) for p in problem.layout.placed]
        r = system.solve(system.left(noise), _OF_DRAWS)
        s = _with_reference(problem, inverse, noise, r)[2]
        of_r += np.nan_to_num(without_modes(r, links.instrument, modes[0])) ** 2
        of_s += np.nan_to_num(without_modes(s, links.surface, modes[1])) ** 2
    smooth = _smooth_root(of_r, links.instrument >= 0, draws)
    if draws > 0:
        alone = system.weak & ~np.isnan(smooth)
        smooth[alone] = np.sqrt(of_r[alone] / draws)
    return smooth, _smooth_root(of_s, links.surface >= 0, draws)


def _with_reference(
    problem: Problem, inverse: Inverse, values: list[FloatArray], reference: FloatArray
) -> tuple[FloatArray, list[FloatArray], FloatArray]:
    """Return what `fitted_to` finds of the readings without a reference."""
    rest = [v - p.forward(reference) for p, v in zip(problem.layout.placed, values, strict=True)]
    return fitted_to(problem, inverse, rest)


def _group_centred(values: FloatArray, group: LabelArray) -> FloatArray:
    count = np.bincount(group)
    total = np.bincount(group, weights=values)
    mean = np.divide(total, count, out=np.zeros(total.shape), where=count > 0)
    return np.asarray(values - mean[group])


def _smooth_root(squares: FloatArray, inside: NDArray[np.bool_], draws: int) -> FloatArray:
    from scipy.ndimage import uniform_filter

    if draws == 0:
        return np.full(squares.shape, np.nan)
    size = tuple(min(5, n) for n in squares.shape)
    share = uniform_filter(inside.astype(np.float64), size, mode="constant")
    mean = uniform_filter(np.where(inside, squares / draws, 0.0), size, mode="constant")
    out = np.full(squares.shape, np.nan)
    out[inside] = np.sqrt(np.maximum(mean[inside] / np.maximum(share[inside], 1e-12), 0.0))
    return out
