"""What stitching cannot see of a reference map, from the rank of the actual design."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.separation._overlaps import Overlap
from metrosep.separation._stitch_grid import Layout
from metrosep.separation._stitch_solve import (
    Inverse,
    Problem,
    freedom_terms,
    half_size,
)
from metrosep.separation._stitch_terms import PolynomialTerms, n_of

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
    weight: FloatArray,
) -> Problem:
    """Return the design of the freedoms with a shared polynomial of the instrument."""
    own = freedom_terms(layout, freedoms, line=line)
    powers = exponents(degree, line=line)
    scale = half_size(layout.placed[0])

    def make(k: int, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.concatenate([own.make(k, x, y), polynomial(x / scale, y / scale, powers)])

    terms = PolynomialTerms(layout, make, max(degree, own.degree))
    n, each = len(layout.placed), n_of(own)
    shared = n * each + np.arange(len(powers))
    columns = [np.concatenate([k * each + np.arange(each), shared]) for k in range(n)]
    return Problem(layout, overlaps, terms, columns, n * each + len(powers), weight)


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
