"""Least squares of polynomials over profiles, points and maps, in Legendre polynomials.

Each fit returns coefficients on the domain of its data, ``[i, j]`` along x and y, the inverse of
the normal matrix of its terms, the sum of squares left, the number of points, and the domain.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, same_length
from metrosep.core.errors import DegenerateFitError, InvalidSamplesError, NotUniformError
from metrosep.forms._orthogonal import Basis, values
from metrosep.forms.linear import solve_blocks
from metrosep.forms.moments import GridPolynomial, Kind, fit_grid_polynomial, remove_grid

Domain = list[tuple[float, float]]
"""Centre and half width of each variable, m."""

_EXTENDED = 16384
"""Points up to which the residual is fitted once more, in extended precision where there is one."""

RawFit = tuple[NDArray[Any], FloatArray, float, int, Domain]

_UNIFORM = 1e-6
"""Largest deviation of a position from the uniform grid, in steps."""


def fit_profile(
    x: ArrayLike, z: ArrayLike, degree: int, *, weights: ArrayLike | None = None
) -> RawFit:
    """Return the least-squares polynomial z(x), in Legendre polynomials on the span of the data.

    Orthogonal factorisation in blocks: a million points need no more memory than a block.
    """
    xs, zs, w = _valid(x, z, weights)
    terms = tuple((i, 0) for i in range(degree + 1))
    c, inverse, squares, n, domain = _fit(xs, None, zs, terms, w)
    return c[:, :1], inverse, squares, n, domain[:1]


def fit_points(
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    terms: tuple[tuple[int, int], ...],
    *,
    weights: ArrayLike | None = None,
) -> RawFit:
    """Return the least-squares polynomial through scattered points, in Legendre polynomials."""
    ys = np.asarray(y, dtype=np.float64).ravel()
    xs, zs, w, keep = _checked(x, z, weights)
    same_length(x=xs, y=ys)
    if not np.isfinite(ys).all():
        raise InvalidSamplesError("a position y is not finite; drop the point")
    return _fit(xs[keep], ys[keep], zs[keep], terms, w)


def _checked(
    x: ArrayLike, z: ArrayLike, weights: ArrayLike | None
) -> tuple[FloatArray, FloatArray, FloatArray | None, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    xs = np.asarray(x, dtype=np.float64).ravel()
    zs = np.asarray(z, dtype=np.float64).ravel()
    same_length(x=xs, z=zs)
    if not np.isfinite(xs).all():
        raise InvalidSamplesError("a position x is not finite; drop the point")
    keep = ~np.isnan(zs)
    if weights is None:
        return xs, zs, None, keep
    w = np.asarray(weights, dtype=np.float64).ravel()
    same_length(z=zs, weights=w)
    if not (np.isfinite(w).all() and w.min(initial=0.0) >= 0.0):
        raise InvalidSamplesError("weights must be finite and not negative")
    keep &= w > 0.0
    return xs, zs, w[keep], keep


def _valid(
    x: ArrayLike, z: ArrayLike, weights: ArrayLike | None
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    xs, zs, w, keep = _checked(x, z, weights)
    return xs[keep], zs[keep], w


def _fit(
    x: FloatArray,
    y: FloatArray | None,
    z: FloatArray,
    terms: tuple[tuple[int, int], ...],
    weights: FloatArray | None,
) -> RawFit:
    degree = max(max(t) for t in terms)
    if z.size < len(terms):
        raise DegenerateFitError(
            f"{z.size} valid points cannot determine {len(terms)} coefficients; lower the degree "
            "or measure more of the part"
        )
    domain = [_span(x), _span(x if y is None else y)]
    i, j = np.array(terms).T

    def functions(part: slice, number: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
        along = [
            values((p[part].astype(number) - centre) / width, degree)
            for p, (centre, width) in zip((x,) if y is None else (x, y), domain, strict=False)
        ]
        out: NDArray[Any] = along[0][i]
        return out if y is None else out * along[1][j]

    offset = float(np.median(z[:: z.size // 4096 + 1]))
    heights = z - (offset if np.isfinite(offset) else 0.0)
    what = f"{len(terms)} coefficients"
    found, inverse, squares = solve_blocks(functions, heights, weights=weights, what=what)
    c = np.zeros((degree + 1, degree + 1), dtype=np.longdouble)
    c[i, j] = found
    if z.size <= _EXTENDED:
        rest = heights - found.astype(np.longdouble) @ functions(slice(None), np.longdouble)
        more, _, squares = solve_blocks(
            functions, rest.astype(np.float64), weights=weights, what=what
        )
        c[i, j] += more
    c[0, 0] += offset
    return c, inverse, squares, z.size, domain


def _span(x: FloatArray) -> tuple[float, float]:
    low, high = float(x.min()), float(x.max())
    return 0.5 * (low + high), 0.5 * (high - low) or 1.0


def fit_grid(
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    degree: int,
    kind: Kind,
    *,
    weights: ArrayLike | None = None,
) -> RawFit:
    """Return the least-squares polynomial through a map, in Legendre polynomials."""
    axes = _axes(x, y, z)
    return _from_grid(fit_grid_polynomial(z, degree, kind=kind, weights=weights), axes)


def remove_map(
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    degree: int,
    kind: Kind,
    *,
    weights: ArrayLike | None = None,
) -> tuple[RawFit, FloatArray]:
    """Return the least-squares polynomial through a map, and the map without it."""
    axes = _axes(x, y, z)
    residual, fit = remove_grid(z, degree, kind=kind, weights=weights)
    return _from_grid(fit, axes), residual


Axis = tuple[float, float, int]


def _axes(x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Axis, Axis]:
    axes = (uniform_axis(x, "x"), uniform_axis(y, "y"))
    if np.shape(z) != (axes[1][2], axes[0][2]):
        raise InvalidSamplesError(
            f"z must have shape (n_y, n_x) = {(axes[1][2], axes[0][2])}, got {np.shape(z)}"
        )
    return axes


def _from_grid(fit: GridPolynomial, axes: tuple[Axis, Axis]) -> RawFit:
    """Return the fit in metres: Legendre coefficients and the domain of the valid pixels."""
    domain = [
        (first + step * centre, abs(step) * width)
        for (first, step, _), centre, width in zip(axes, fit.centre, fit.half_width, strict=True)
    ]
    falling = [(-1.0) ** np.arange(fit.degree + 1) if step < 0 else 1.0 for _, step, _ in axes]
    signs = np.ones_like(fit.coefficients) * np.reshape(falling[0], (-1, 1)) * falling[1]
    i, j = np.array(fit.terms).T
    s = signs[i, j]
    inverse = fit.inverse * np.outer(s, s)
    return fit.coefficients * signs, inverse, fit.residual_sum, fit.n_valid, domain


def uniform_axis(x: ArrayLike, name: str) -> tuple[float, float, int]:
    """Return first position, step and number of uniform positions."""
    xs = np.asarray(x, dtype=np.float64)
    if xs.ndim != 1 or xs.size == 0:
        raise InvalidSamplesError(f"{name} must be a list of positions, got shape {xs.shape}")
    if xs.size == 1:
        return float(xs[0]), 1.0, 1
    step = float(xs[-1] - xs[0]) / (xs.size - 1)
    off = np.abs(xs - (xs[0] + step * np.arange(xs.size))).max()
    if not (step != 0.0 and off <= _UNIFORM * abs(step)):
        raise NotUniformError(
            f"positions {name} of a map must be uniform; resample, or fit its points with "
            "fit_points"
        )
    return float(xs[0]), step, int(xs.size)


def in_basis(
    c: NDArray[Any],
    inverse: FloatArray,
    terms: tuple[tuple[int, int], ...],
    basis: Basis,
    source: Domain,
    target: Domain,
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and inverse normal matrix in another basis on another domain."""
    n = c.shape[0] - 1
    flat = c[:, 0] if len(source) == 1 else c
    new = converted(flat, basis, source, target).reshape(c.shape)
    matrices = [
        conversion_matrix(n, basis, old, to) for old, to in zip(source, target, strict=True)
    ]
    i, j = np.array(terms).T
    jacobian = matrices[0][np.ix_(i, i)]
    if len(matrices) == 2:
        jacobian = jacobian * matrices[1][np.ix_(j, j)]
    return new, jacobian @ inverse @ jacobian.T


# ---- private helpers: a Legendre series on one domain as a series of another kind on another domain ----
# In powers of x the coefficients of degree ten are differences of numbers that are many decades
# larger. The conversion is therefore done in fractions of whole numbers (low degrees: in extended
# precision from exact matrices), and rounded once at the end.

Row = list[Fraction]

_LOW = 6
"""Up to this degree extended precision (64 bits) loses nothing that a float64 could hold."""


@lru_cache(maxsize=64)
def _exact(
    degree: int, basis: Basis, centre: float, half_width: float, to_centre: float, to_half: float
) -> tuple[tuple[Fraction, ...], ...]:
    """Return row k: P_k((x - centre) / half_width) in the functions of (x - to_centre) / to_half."""
    scale = Fraction(to_half) / Fraction(half_width)
    shift = (Fraction(to_centre) - Fraction(centre)) / Fraction(half_width)
    rows: list[Row] = [[Fraction(1)]]
    for k in range(degree):
        # (k + 1) P_{k+1} = (2 k + 1) s P_k - k P_{k-1}, s = scale u + shift
        stepped = _times_u(rows[k], basis)
        row = [Fraction(2 * k + 1, k + 1) * scale * value for value in stepped]
        for i, value in enumerate(rows[k]):
            row[i] += Fraction(2 * k + 1, k + 1) * shift * value
        if k:
            for i, value in enumerate(rows[k - 1]):
                row[i] -= Fraction(k, k + 1) * value
        rows.append(row)
    return tuple(tuple(row + [Fraction(0)] * (degree + 1 - len(row))) for row in rows)


@lru_cache(maxsize=64)
def _extended(
    degree: int, basis: Basis, centre: float, half_width: float, to_centre: float, to_half: float
) -> NDArray[np.longdouble]:
    """Return the rows of `_exact` in extended precision."""
    rows = _exact(degree, basis, centre, half_width, to_centre, to_half)
    high = np.array([[float(v) for v in row] for row in rows])
    rest = [
        [float(v - Fraction(h)) for v, h in zip(*p, strict=True)]
        for p in zip(rows, high.tolist(), strict=True)
    ]
    out: NDArray[np.longdouble] = high.astype(np.longdouble) + np.array(rest)
    return out


def _times_u(row: Row, basis: Basis) -> Row:
    """Return the coefficients of u times a series."""
    out = [Fraction(0)] * (len(row) + 1)
    for i, value in enumerate(row):
        if basis == "power" or (basis == "chebyshev" and i == 0):
            out[i + 1] += value
        elif basis == "chebyshev":
            out[i + 1] += value / 2
            out[i - 1] += value / 2
        else:
            out[i + 1] += value * Fraction(i + 1, 2 * i + 1)
            if i:
                out[i - 1] += value * Fraction(i, 2 * i + 1)
    return out


def conversion_matrix(
    degree: int, basis: Basis, source: tuple[float, float], target: tuple[float, float]
) -> FloatArray:
    """Return A with ``new = A @ old`` in double precision; domains are (centre, half width)."""
    return np.array(_exact(degree, basis, *source, *target), dtype=np.float64).T


def converted(
    c: NDArray[Any],
    basis: Basis,
    source: list[tuple[float, float]],
    target: list[tuple[float, float]],
) -> FloatArray:
    """Return the coefficients of a Legendre series along each of its axes, rounded once.

    The coefficients may be of extended precision.
    """
    if basis == "legendre" and source == target:
        return np.asarray(c, dtype=np.float64)
    if max(c.shape) <= _LOW + 1:
        extended = np.asarray(c, dtype=np.longdouble)
        for axis, (old, new) in enumerate(zip(source, target, strict=True)):
            rows = _extended(c.shape[axis] - 1, basis, *old, *new)
            extended = np.moveaxis(np.tensordot(rows, extended, axes=([0], [axis])), 0, axis)
        return np.asarray(extended, dtype=np.float64)
    ratios = [Fraction(*v.as_integer_ratio()) for v in c.ravel()]
    exact = np.array(ratios, dtype=object).reshape(c.shape)
    for axis, (old, new) in enumerate(zip(source, target, strict=True)):
        rows = np.array(_exact(c.shape[axis] - 1, basis, *old, *new), dtype=object)
        exact = np.moveaxis(np.tensordot(rows, exact, axes=([0], [axis])), 0, axis)
    return np.array([float(v) for v in exact.ravel()]).reshape(c.shape)
