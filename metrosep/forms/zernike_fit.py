"""Least squares of Zernike terms over maps and points.

On a map, terms of low order are sums of products of Legendre polynomials on the square around the
disc, exactly, so that the moments of `metrosep.forms.moments` serve them too. For higher orders
those sums cancel; there the terms are evaluated in blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import ComplexArray, FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError, InvalidSamplesError
from metrosep.core.numbers import positive
from metrosep.forms._orthogonal import values, values_on_axis
from metrosep.forms.linear import solve_blocks
from metrosep.forms.moments import (
    Grid,
    Span,
    Terms,
    UnsignedArray,
    checked_weights,
    grid_values,
    inverse_of,
    polynomial_terms,
    solve_grid,
)
from metrosep.forms.polynomial_fit import uniform_axis

ZernikeFit = tuple[FloatArray, FloatArray, float, int, float]
"""Coefficients (1 at the rim), inverse normal matrix, sum of squares, points, radius."""

RIM = 1e-9
"""Of the radius: a point this far outside still counts as on the rim."""

_SEPARABLE = 12
"""Largest order whose sums of Legendre products lose no more than three digits (105 terms: 13)."""

_BLOCK = 16384
_SAMPLE = 20000


def fit_zernike_grid(
    z: ArrayLike,
    x: ArrayLike,
    y: ArrayLike,
    nm: Terms,
    *,
    radius: float | None = None,
    weights: ArrayLike | None = None,
) -> ZernikeFit:
    """Return the least-squares Zernike coefficients of a map on a disc around the origin.

    Cost: one pass over the map for orders up to 12.
    """
    heights = np.asarray(z, dtype=np.float64)
    xs, ys = _axis(x, "x"), _axis(y, "y")
    if heights.shape != (ys.size, xs.size):
        raise InvalidSamplesError(
            f"z must have shape (n_y, n_x) = {(ys.size, xs.size)}, got {heights.shape}"
        )
    given = None if weights is None else checked_weights(weights, heights.shape)
    size = (
        _farthest(xs, ys, heights, given)
        if radius is None
        else positive(radius, "radius", dimension="length")
    )
    u, v = xs / size, ys / size
    rows, columns = (slice(*np.searchsorted(p, (-1 - RIM, 1 + RIM))) for p in (v, u))
    u, v = u[columns], v[rows]
    inside = heights[rows, columns]
    part = None if given is None else given[rows, columns]
    _enough(inside.size, len(nm))
    degree = max(n for n, _ in nm)
    separable = degree <= _SEPARABLE
    px, py = (values_on_axis(p, 2 * degree if separable else 0) for p in (u, v))
    grid = Grid(inside, part, px, py, _reach(u.tobytes(), v.tobytes()))
    with one_blas_thread():
        if separable:
            return (*_separable(grid, nm), size)
        return (*_in_blocks(grid, u, v, nm), size)


def fit_zernike_points(
    x: ArrayLike,
    y: ArrayLike,
    z: ArrayLike,
    nm: Terms,
    *,
    radius: float | None = None,
    weights: ArrayLike | None = None,
) -> ZernikeFit:
    """Return the least-squares Zernike coefficients of points on a disc around the origin."""
    xs, ys, zs = (np.asarray(a, dtype=np.float64).ravel() for a in (x, y, z))
    if not xs.size == ys.size == zs.size:
        raise InvalidSamplesError(f"arrays must be equally long: {xs.size}, {ys.size}, {zs.size}")
    if not (np.isfinite(xs).all() and np.isfinite(ys).all()):
        raise InvalidSamplesError("a position is not finite; drop the point")
    w = None if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if w is not None and not (w.size == zs.size and np.isfinite(w).all() and w.min() >= 0.0):
        raise InvalidSamplesError("weights must be as long as z, finite and not negative")
    keep = ~np.isnan(zs) if w is None else ~np.isnan(zs) & (w > 0.0)
    _enough(int(keep.sum()), len(nm))
    rho = np.hypot(xs, ys)
    size = (
        _positive(float(rho[keep].max()))
        if radius is None
        else positive(radius, "radius", dimension="length")
    )
    keep &= rho <= size * (1.0 + RIM)
    _enough(int(keep.sum()), len(nm))
    u, v, inside = xs[keep] / size, ys[keep] / size, zs[keep]
    a, inverse, squares = solve_blocks(
        lambda part: zernike_values(u[part], v[part], nm),
        inside,
        weights=None if w is None else w[keep],
        what=f"{len(nm)} Zernike terms",
    )
    return a, inverse, squares, int(inside.size), size


def zernike_map(
    x: ArrayLike, y: ArrayLike, nm: Terms, coefficients: FloatArray, *, radius: float
) -> FloatArray:
    """Return a sum of Zernike terms on a grid, NaN beyond the radius."""
    u, v = _axis(x, "x") / radius, _axis(y, "y") / radius
    outside = np.greater(u * u, ((1.0 + RIM) ** 2 - v * v)[:, None])
    degree = max(n for n, _ in nm)
    if degree > _SEPARABLE:
        out = np.full(outside.shape, np.nan)
        for row in range(v.size):
            some = ~outside[row]
            line = np.full(int(some.sum()), v[row])
            out[row, some] = coefficients @ zernike_values(u[some], line, nm)
        return out
    table = _in_legendre(nm).table(coefficients)
    inside = np.clip(u, -1.0 - RIM, 1.0 + RIM), np.clip(v, -1.0 - RIM, 1.0 + RIM)
    with one_blas_thread():
        out = grid_values(table, *(values(p, degree) for p in inside))
    out[outside] = np.nan
    return out


@lru_cache(maxsize=4)
def _reach(columns: bytes, rows: bytes) -> tuple[UnsignedArray, UnsignedArray]:
    """Return, for each row, the first column on the disc and the first one after it.

    Positions by their bytes, and read-only: maps of a batch mostly have the same axes.
    """
    u, v = np.frombuffer(columns), np.frombuffer(rows)
    half = np.sqrt(np.maximum((1.0 + RIM) ** 2 - v * v, 0.0))
    number = np.uint16 if u.size < 32768 else np.uint64  # small whole numbers compare quickly
    first, after = np.searchsorted(u, -half, side="left"), np.searchsorted(u, half, side="right")
    from_here: UnsignedArray = first.astype(number)
    to_here: UnsignedArray = after.astype(number)
    from_here.setflags(write=False)
    to_here.setflags(write=False)
    return from_here, to_here


def _axis(values_: ArrayLike, name: str) -> FloatArray:
    first, step, n = uniform_axis(values_, name)
    if step < 0.0:
        raise InvalidSamplesError(f"positions {name} must grow; turn the map round")
    return np.asarray(values_, dtype=np.float64) if n > 1 else np.array([first])


def _farthest(
    x: FloatArray, y: FloatArray, heights: FloatArray, weights: FloatArray | None
) -> float:
    """Return the distance of the farthest valid pixel: of each row, only the ends matter."""
    valid = ~np.isnan(heights)
    if weights is not None:
        valid &= weights > 0.0
    rows = np.flatnonzero(valid.any(axis=1))
    if not rows.size:
        raise DegenerateFitError("no pixel of the map is valid")
    first = valid[rows].argmax(axis=1)
    last = x.size - 1 - valid[rows, ::-1].argmax(axis=1)
    reach = np.maximum(np.abs(x[first]), np.abs(x[last]))
    return _positive(float(np.hypot(reach, y[rows]).max()))


def _positive(radius: float) -> float:
    if not radius > 0.0:
        raise DegenerateFitError("all valid points are at the centre; a disc needs a radius")
    return radius


def _enough(n: int, needed: int) -> None:
    if n < needed:
        raise DegenerateFitError(
            f"{n} valid points inside the disc cannot determine {needed} Zernike terms; use fewer "
            "terms or a larger radius"
        )


@lru_cache(maxsize=16)
def _in_legendre(nm: Terms) -> Span:
    """Return Zernike terms, each as a sum of Legendre products by exact quadrature."""
    degree = max(n for n, _ in nm)
    nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
    p = values(nodes, degree) * weights * (np.arange(degree + 1)[:, None] + 0.5)
    x, y = np.meshgrid(nodes, nodes, indexing="ij")
    table = np.einsum("kxy,ix,jy->kij", zernike_values(x, y, nm), p, p, optimize=True)
    terms = polynomial_terms(degree, "total")
    i, j = np.array(terms).T
    out = table[:, i, j]
    # parity: a term holds only products that are even or odd as it is itself
    for row, (n, m) in zip(out, nm, strict=True):
        odd_y = m < 0
        row[((i + j - n) % 2 != 0) | ((j % 2 == 1) != odd_y)] = 0.0
    out.setflags(write=False)
    return Span(degree, terms, out)


def _separable(grid: Grid, nm: Terms) -> tuple[FloatArray, FloatArray, float, int]:
    what = f"{len(nm)} Zernike terms"
    found = solve_grid(grid, _in_legendre(nm), what=what, enough=_enough)
    return found.coefficients, found.inverse, found.residual_sum, found.n_valid


def _in_blocks(
    grid: Grid, u: FloatArray, v: FloatArray, nm: Terms
) -> tuple[FloatArray, FloatArray, float, int]:
    """Start from a sample, then add the normal equations of what that leaves, block by block."""
    valid = grid.valid()
    places = np.flatnonzero(valid)
    _enough(places.size, len(nm))
    heights = grid.z[valid]
    if not np.isfinite(heights).all():
        raise InvalidSamplesError("z is infinite somewhere; write NaN where nothing was measured")
    w = None if grid.weights is None else grid.weights[valid]

    def functions(part: slice) -> FloatArray:
        row, column = np.divmod(places[part], valid.shape[1])
        return zernike_values(u[column], v[row], nm)

    few = slice(None, None, max(1, places.size // _SAMPLE))
    what = f"{len(nm)} Zernike terms"
    if few.step == 1:
        return (*solve_blocks(functions, heights, weights=w, what=what), places.size)
    a = _from_sample(functions, heights, w, few.step, len(nm))
    gram, right, squares = np.zeros((len(nm), len(nm))), np.zeros(len(nm)), 0.0
    for start in range(0, places.size, _BLOCK):
        part = slice(start, min(start + _BLOCK, places.size))
        f = functions(part)
        r = heights[part] - a @ f
        weighted = f if w is None else f * w[part]
        gram += weighted @ f.T
        right += weighted @ r
        squares += float(r @ r if w is None else (w[part] * r) @ r)
    inverse, _ = inverse_of(gram, what)
    change = inverse @ right
    return a + change, inverse, squares - float(change @ right), places.size


def _from_sample(
    functions: Callable[[slice], FloatArray],
    z: FloatArray,
    weights: FloatArray | None,
    step: int,
    n: int,
) -> FloatArray:
    some = slice(None, None, step)
    f = functions(some)
    root = np.ones(f.shape[1]) if weights is None else np.sqrt(weights[some])
    found, *_ = np.linalg.lstsq((f * root).T, z[some] * root, rcond=1e-6)
    return np.asarray(found, dtype=np.float64).reshape(n)


# ---- values and gradients of Zernike circle polynomials, by recurrences in Cartesian coordinates ----
# With ``w = x + i y`` on the unit disc and ``V_n^m = R_n^|m|(|w|) e^(i m theta)``::
#
#     V_n^m       = w V_{n-1}^{m-1} + conj(w) V_{n-1}^{m+1} - V_{n-2}^m
#     dV_n^m/dw   = n V_{n-1}^{m-1} + dV_{n-2}^m/dw
#     dV_n^m/dw*  = n V_{n-1}^{m+1} + dV_{n-2}^m/dw*
#
# There is no division by the radius, so values and slopes are finite at the centre, and no factorial,
# so they are exact to rounding at order 100. References: Shakibaei & Paramesran, Opt. Lett. 38 (2013)
# 2487; Andersen, Opt. Express 26 (2018) 18878.


class _Table:
    """V and its derivatives at points, each computed once; m >= 0 is kept, the rest is conjugate."""

    def __init__(self, x: FloatArray, y: FloatArray) -> None:
        self.w: ComplexArray = x + 1j * y
        self.kept: dict[tuple[int, int], ComplexArray] = {(0, 0): np.ones_like(self.w)}
        self.slopes: dict[tuple[int, int], tuple[Any, Any]] = {}

    def value(self, n: int, m: int) -> Any:
        if abs(m) > n or n < 0:
            return 0.0
        if m < 0:
            return np.conj(self.value(n, -m))
        if (n, m) not in self.kept:
            if m == 0:
                inner = 2.0 * (np.conj(self.w) * self.value(n - 1, 1)).real + 0j
            else:
                inner = self.w * self.value(n - 1, m - 1)
                if m < n:
                    inner += np.conj(self.w) * self.value(n - 1, m + 1)
            self.kept[n, m] = inner - self.value(n - 2, m)
        return self.kept[n, m]

    def slope(self, n: int, m: int) -> tuple[Any, Any]:
        """Return the derivatives by w and by its conjugate, m >= 0."""
        if m > n or n <= 0:
            return 0.0, 0.0
        if (n, m) not in self.slopes:
            by_w, by_conjugate = self.slope(n - 2, m)
            self.slopes[n, m] = (
                n * self.value(n - 1, m - 1) + by_w,
                n * self.value(n - 1, m + 1) + by_conjugate,
            )
        return self.slopes[n, m]


def zernike_values(x: FloatArray, y: FloatArray, nm: Sequence[tuple[int, int]]) -> FloatArray:
    """Return Zernike polynomials that are 1 at the rim of the unit disc."""
    table = _Table(x, y)
    _climb(table, nm)
    out = np.empty((len(nm), *x.shape))
    for k, (n, m) in enumerate(nm):
        v = table.value(n, abs(m))
        out[k] = v.real if m >= 0 else v.imag
    return out


def zernike_gradients(
    x: FloatArray, y: FloatArray, nm: Sequence[tuple[int, int]]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of `zernike_values` by x and by y."""
    table = _Table(x, y)
    _climb(table, nm)
    dx, dy = np.empty((len(nm), *x.shape)), np.empty((len(nm), *x.shape))
    for k, (n, m) in enumerate(nm):
        by_w, by_conjugate = table.slope(n, abs(m))
        along = by_w + by_conjugate
        across = 1j * (by_w - by_conjugate)
        dx[k] = np.real(along) if m >= 0 else np.imag(along)
        dy[k] = np.real(across) if m >= 0 else np.imag(across)
    return dx, dy


def _climb(table: _Table, nm: Sequence[tuple[int, int]]) -> None:
    """Fill the table from low orders up, so that no call goes deeper than one order."""
    top = {(n, abs(m)) for n, m in nm}
    needed = set(top)
    while top:
        top = {
            (a, b)
            for n, m in top
            for a, b in ((n - 1, abs(m - 1)), (n - 1, m + 1), (n - 2, m))
            if 0 <= b <= a
        } - needed
        needed |= top
    for n, m in sorted(needed):
        table.value(n, m)
