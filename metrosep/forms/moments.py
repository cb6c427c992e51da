"""Polynomials on a rectangular grid by one-dimensional Legendre moments; no design matrix.

With ``W`` the weights (0 where nothing was measured), ``P_x`` and ``P_y`` the Legendre values at
the columns and rows, the sums of least squares are two small matrices, gathered in blocks of rows::

    M = P_y W P_x^T        to degree 2 d: every sum of a product of two basis functions
    B = P_y (W z) P_x^T    to degree d: every sum of a basis function and a height

The normal matrix follows from M, because a product of two Legendre polynomials is a short sum of
others. The domain is the bounding box of the valid pixels, scaled to [-1, 1], heights are counted
from one in their midst, and a second pass over the residual takes back what rounding lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.docs import documented
from metrosep.core.errors import (
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.core.numbers import choice, count
from metrosep.forms._orthogonal import linearisation, values, values_on_axis

Kind = Literal["total", "tensor"]

MAX_DEGREE = 40
"""Far above what a surface needs; the normal matrix has up to 1681 rows there."""


DOCS = {
    "map": """
        z : array_like, shape (n_y, n_x), m
            Heights; NaN where not measured.
        """,
    "degree": """
        degree : int
            Highest degree, 0 to 40.
        kind : {"total", "tensor"}, optional
            Terms with ``i + j <= degree``, or with each of i and j ``<= degree``.
        """,
    "raises": """
        DataError
            If the degree or the kind is not one of those above.
        InvalidSamplesError
            If z is not two-dimensional or infinite, or weights do not fit.
        DegenerateFitError
            If the valid pixels do not determine the terms.
        """,
}
"""Parts of the docstrings of polynomial fits."""


class LeastSquares:
    """What every linear fit says of its scatter: `inverse`, `residual_sum` and `n_valid` are its fields."""

    __slots__ = ()
    inverse: FloatArray
    residual_sum: float
    n_valid: int

    @property
    def residual_sd(self) -> float:
        """Standard deviation of the residual in m, with the parameters taken off the freedoms.

        Raises
        ------
        TooFewSamplesError
            If there are no more points than parameters.
        """
        p = self.inverse.shape[0]
        if self.n_valid <= p:
            raise TooFewSamplesError(
                f"{self.n_valid} valid points and {p} parameters leave nothing to estimate the "
                "scatter from; use fewer parameters or a lower degree"
            )
        return float(np.sqrt(max(self.residual_sum, 0.0) / (self.n_valid - p)))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters in SI, in the order of `inverse`.

        Valid for independent noise of one size in every point of weight 1.

        Raises
        ------
        TooFewSamplesError
            If there are no more points than parameters.
        """
        return self.inverse * self.residual_sd**2


@dataclass(frozen=True, slots=True, eq=False)
class GridPolynomial(LeastSquares):
    """A Legendre polynomial on the pixels of a grid.

    Parameters
    ----------
    coefficients : ndarray, shape (degree + 1, degree + 1), m
        ``[i, j]`` belongs to ``P_i(u) P_j(v)``, u along x (columns), v along y (rows); 0 for terms
        that were not fitted.
    terms : tuple of (int, int)
        The fitted (i, j), in the order of `inverse`.
    centre, half_width : tuple of (float, float), pixels
        ``u = (column - centre[0]) / half_width[0]``, ``v = (row - centre[1]) / half_width[1]``.
    shape : tuple of int
        Rows and columns of the grid.
    n_valid : int
        Pixels with a height and a weight above 0.
    residual_sum : float, m^2
        Weighted sum of squared residuals.
    inverse : ndarray, shape (n_terms, n_terms)
        Inverse of the normal matrix.
    """

    coefficients: FloatArray
    terms: tuple[tuple[int, int], ...]
    centre: tuple[float, float]
    half_width: tuple[float, float]
    shape: tuple[int, int]
    n_valid: int
    residual_sum: float
    inverse: FloatArray

    @property
    def degree(self) -> int:
        """Highest degree in x or y."""
        return int(self.coefficients.shape[0]) - 1


@documented(**DOCS)
def fit_grid_polynomial(
    z: ArrayLike,
    degree: int,
    *,
    kind: Kind = "total",
    weights: ArrayLike | None = None,
    refine: bool = True,
) -> GridPolynomial:
    """Return the least-squares polynomial through the valid pixels of a grid.

    Parameters
    ----------
    $map
    $degree
    weights : array_like, shape (n_y, n_x), optional
        Weight of each pixel, 0 to 1; 0 excludes it.
    refine : bool, optional
        Fit the residual again where rounding needs it. Without it `residual_sum` is good to a
        millionth only where the residual is above 1e-5 of the form.

    Returns
    -------
    GridPolynomial
        Coefficients in the scaled domain of the valid pixels, with their covariance.

    Raises
    ------
    $raises

    Notes
    -----
    NaN pixels have no part in any sum. Rows and columns without a valid pixel do not change the
    result: NaN rows are the same as cropped rows. Cost: two passes over the map.
    """
    heights, given = _checked(z, weights)
    span = _span(degree, kind)
    with one_blas_thread():
        fit, _ = _fit(heights, given, span, refine=refine, remove=False)
    return fit


@documented(**DOCS)
def remove_grid(
    z: ArrayLike,
    degree: int,
    *,
    kind: Kind = "total",
    weights: ArrayLike | None = None,
    refine: bool = True,
) -> tuple[FloatArray, GridPolynomial]:
    """Return the heights without their least-squares polynomial, and that polynomial.

    Parameters
    ----------
    $map
    $degree
    weights : array_like, shape (n_y, n_x), optional
        Weight of each pixel, 0 to 1. The polynomial is removed from every valid pixel.
    refine : bool, optional
        Fit the residual again where rounding needs it.

    Returns
    -------
    residual : ndarray, shape (n_y, n_x), m
        A new array; NaN stays NaN.
    fit : GridPolynomial
        What was removed.

    Raises
    ------
    $raises
    """
    heights, given = _checked(z, weights)
    span = _span(degree, kind)
    with one_blas_thread():
        fit, residual = _fit(heights, given, span, refine=refine, remove=True)
    return cast("FloatArray", residual), fit


def evaluate_grid(fit: GridPolynomial, shape: tuple[int, int] | None = None) -> FloatArray:
    """Return the heights of a fitted polynomial at every pixel, also where nothing was measured.

    Parameters
    ----------
    fit : GridPolynomial
        What was fitted.
    shape : tuple of int, optional
        Rows and columns; those of the fitted grid by default.

    Returns
    -------
    ndarray, shape (n_y, n_x), m
        Heights; outside the bounding box of the valid pixels they are extrapolated.
    """
    rows, columns = fit.shape if shape is None else shape
    px = values((np.arange(columns, dtype=float) - fit.centre[0]) / fit.half_width[0], fit.degree)
    py = values((np.arange(rows, dtype=float) - fit.centre[1]) / fit.half_width[1], fit.degree)
    with one_blas_thread():
        return grid_values(fit.coefficients, px, py)


def polynomial_terms(degree: int, kind: Kind) -> tuple[tuple[int, int], ...]:
    """Return the powers (i along x, j along y) of a polynomial, lowest total degree first.

    Examples
    --------
    >>> polynomial_terms(1, "tensor")
    ((0, 0), (1, 0), (0, 1), (1, 1))
    """
    top = degree if kind == "total" else 2 * degree
    return tuple(
        (t - j, j) for t in range(top + 1) for j in range(t + 1) if max(t - j, j) <= degree
    )


def _checked(z: ArrayLike, weights: ArrayLike | None) -> tuple[FloatArray, FloatArray | None]:
    heights = np.asarray(z, dtype=np.float64)
    if heights.ndim != 2:
        raise InvalidSamplesError(f"z must have 2 dimensions, got shape {heights.shape}")
    if weights is None:
        return heights, None
    return heights, checked_weights(weights, heights.shape)


def checked_weights(weights: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return the weights of the pixels of a map, 0 to 1."""
    given = np.asarray(weights, dtype=np.float64)
    if given.shape != shape:
        raise InvalidSamplesError(f"weights must have the shape of z, {shape}, got {given.shape}")
    if not (given.min(initial=0.0) >= 0.0 and given.max(initial=0.0) <= 1.0):
        raise InvalidSamplesError("weights must lie between 0 and 1, and none may be NaN")
    return given


def _span(degree: int, kind: Kind) -> Span:
    choice(kind, "kind", ("total", "tensor"))
    return _legendre(count(degree, "degree", least=0, most=MAX_DEGREE), kind)


@lru_cache(maxsize=16)
def _legendre(degree: int, kind: Kind) -> Span:
    return Span(degree, polynomial_terms(degree, kind))


def _fit(
    z: FloatArray,
    weights: FloatArray | None,
    span: Span,
    *,
    refine: bool,
    remove: bool,
) -> tuple[GridPolynomial, FloatArray | None]:
    degree, terms = span.degree, span.terms
    rows, columns = bounding_box(z, weights)
    px, cx, hx = _axis(z.shape[1], columns, degree)
    py, cy, hy = _axis(z.shape[0], rows, degree)
    inside = None if weights is None else weights[rows, columns]
    grid = Grid(z[rows, columns], inside, px[:, columns], py[:, rows])
    what = f"the {len(terms)} terms of a polynomial of degree {degree}"
    _, c, inverse, squares, n_valid = solve_grid(
        grid, span, refine=refine, what=what, enough=_enough
    )
    c.setflags(write=False)
    fit = GridPolynomial(c, terms, (cx, cy), (hx, hy), z.shape, n_valid, squares, inverse)
    return fit, grid_values(c, px, py, minus_from=z) if remove else None


def _enough(n: int, needed: int) -> None:
    if n < needed:
        raise DegenerateFitError(
            f"{n} valid pixels cannot determine {needed} terms; lower the degree or measure more "
            "of the part"
        )


def _axis(n: int, used: slice, degree: int) -> tuple[FloatArray, float, float]:
    """Return Legendre values at all pixels of an axis, scaled to the used part of it."""
    centre = 0.5 * (used.start + used.stop - 1)
    half_width = 0.5 * (used.stop - 1 - used.start) or 1.0
    u = (np.arange(n, dtype=np.float64) - centre) / half_width
    return values_on_axis(u, 2 * degree), centre, half_width


# ---- private helpers: the least squares of Legendre terms, or of sums of them, over a map ------

Terms = tuple[tuple[int, int], ...]

_SAMPLE = 4096
"""Pixels of the coarse map that gives a first polynomial, or 64 for each term of it."""

_CLOSE = 1e-6
"""Share of the sum of squares that must remain for one pass to be enough."""

_SMALL = 1e-24
"""Of the form's sum of squares: a change that small is rounding."""

_OF_RESIDUAL = 1e-16
"""Of the sum of squares left: what may still be missing from the fit."""

_MOST_PASSES = 5
"""Of refinement; one is the rule only where there was no start from a coarse map."""


class Span:
    """What is fitted to a map: Legendre terms, or sums of them."""

    def __init__(self, degree: int, terms: Terms, functions: FloatArray | None = None) -> None:
        self.degree, self.terms, self.functions = degree, terms, functions
        self._i, self._j = np.array(terms).T
        self.n = len(terms) if functions is None else len(functions)
        self.constant = _constant(functions, self.n)
        self.constant.setflags(write=False)

    def normal(self, sums: Sums) -> FloatArray:
        """Return the normal matrix, shape (n, n)."""
        i, j = self._i, self._j
        normal: FloatArray = normal_matrix(sums.weights, self.degree)[i, j][:, i, j]
        return normal if self.functions is None else self.functions @ normal @ self.functions.T

    def right(self, sums: Sums) -> FloatArray:
        """Return the right-hand side of the normal equations, shape (n,)."""
        heights: FloatArray = sums.heights[self._i, self._j]
        return heights if self.functions is None else self.functions @ heights

    def table(self, a: FloatArray) -> FloatArray:
        """Return coefficients as those of Legendre terms, shape (degree + 1, degree + 1)."""
        c = np.zeros((self.degree + 1, self.degree + 1))
        c[self._i, self._j] = a if self.functions is None else a @ self.functions
        return c


def _constant(functions: FloatArray | None, n: int) -> FloatArray:
    """Return what makes a height of 1; zeros where what is fitted holds no constant."""
    out = np.zeros(n)
    if functions is None:
        out[0] = 1.0
        return out
    alone = (functions[:, 0] != 0.0) & (np.count_nonzero(functions, axis=1) == 1)
    out[alone] = 1.0 / functions[alone, 0]
    return out


class GridSolution(NamedTuple):
    """What `solve_grid` finds: coefficients of what is fitted, the same in Legendre terms, ..."""

    coefficients: FloatArray
    legendre: FloatArray
    inverse: FloatArray
    residual_sum: float
    n_valid: int


def solve_grid(
    grid: Grid,
    span: Span,
    *,
    refine: bool = True,
    what: str = "the terms",
    enough: Callable[[int, int], None] | None = None,
) -> GridSolution:
    """Return the least squares of Legendre terms, or of sums of them, over a map."""

    def improved(
        a: FloatArray, sums: Sums, inverse: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the fit plus the fit to the residual it left, and the squares left then."""
        right = span.right(sums)
        change = inverse @ right
        return a + change, span.table(a + change), sums.squares - float(change @ right)

    few = grid.every(max(int(np.sqrt(grid.z.size / max(_SAMPLE, 64 * span.n))), 1))
    heights = few.z[few.valid()]
    a = span.constant * _middle(heights)
    c = span.table(a)
    if refine and few.z.size < grid.z.size and heights.size >= 10 * len(span.terms):
        sums = residual_sums(few, c, span.degree)
        with suppress(DegenerateFitError):
            a, c, _ = improved(a, sums, inverse_of(span.normal(sums), what)[0])
    sums = residual_sums(grid, c, span.degree)
    if enough is not None:
        enough(sums.n_valid, span.n)
    normal = span.normal(sums)
    inverse, condition = inverse_of(normal, what)
    a, c, squares = improved(a, sums, inverse)
    for _ in range(_MOST_PASSES if refine else 0):
        gain, form = sums.squares - squares, float(a @ normal @ a)
        missing = gain * (condition * np.finfo(float).eps) ** 2
        is_exact = missing <= max(_SMALL * form, _OF_RESIDUAL * squares)
        if is_exact and (squares > _CLOSE * sums.squares or gain <= _SMALL * form):
            break
        sums = residual_sums(grid, c, span.degree, with_weights=False)
        a, c, squares = improved(a, sums, inverse)
    return GridSolution(a, c, inverse, squares, sums.n_valid)


def _middle(heights: FloatArray) -> float:
    """Return the median of nine heights: a start that one outlier does not carry off."""
    few = sorted(heights[heights.size // 18 :: heights.size // 9 + 1].tolist())
    middle = few[len(few) // 2] if few else 0.0
    return middle if math.isfinite(middle) else 0.0


# ---- private helpers: one pass over a map gathers all sums of a least-squares fit, in row blocks ----

UnsignedArray = NDArray[np.unsignedinteger[Any]]

_BLOCK = 65536
"""Pixels of a block: residuals and weights together stay in the second-level cache."""

_SMALL_PRODUCT = 1_000_000
"""Multiplications up to which OpenBLAS spares itself the packing of a matrix; measured: half the
time of a product that is a tenth larger."""

_BUFFER = 512
"""Elements of numpy's buffer. Rows shorter than it, of which a part is taken, are copied to fill it
first, which doubles the time of a difference and triples that of a comparison."""

_SMALLEST_EIGENVALUE = 1e-13
"""Of the normal matrix with ones on its diagonal: below it, rounding decides the answer."""

_PLAIN = 1e4
"""Condition up to which a plain inverse is as good as one by eigenvalues, which costs more."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """A map with its Legendre values, degree along the rows of `px` (columns) and `py` (rows).

    `reach` holds, for each row, the first column that counts and the first one after them, as
    unsigned numbers; without it all columns do. NaN and pixels of weight 0 never count.
    """

    z: FloatArray
    weights: FloatArray | None
    px: FloatArray
    py: FloatArray
    reach: tuple[UnsignedArray, UnsignedArray] | None = None

    def every(self, skip: int) -> Grid:
        """Return every n-th row and column."""
        some = slice(None, None, skip)
        reach = None
        if self.reach is not None:
            first, after = ((end[some] + (skip - 1)) // skip for end in self.reach)
            reach = (first, after)
        return Grid(
            np.ascontiguousarray(self.z[some, some]),
            None if self.weights is None else self.weights[some, some],
            np.ascontiguousarray(self.px[:, some]),
            np.ascontiguousarray(self.py[:, some]),
            reach,
        )

    def valid(self) -> NDArray[np.bool_]:
        """Return which pixels count."""
        out: NDArray[np.bool_] = ~np.isnan(self.z)
        if self.weights is not None:
            out &= self.weights > 0.0
        if self.reach is not None:
            first, after = self.reach
            place = np.arange(self.z.shape[1])
            out &= (place >= first[:, None]) & (place < after[:, None])
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Sums over a map; first index along x, second along y."""

    weights: FloatArray
    heights: FloatArray
    squares: float
    n_valid: int


class _Block(NamedTuple):
    """Rows, the columns that count in any of them, and those that count in all: from, to."""

    rows: slice
    columns: slice
    all_from: int
    all_to: int


def bounding_box(z: FloatArray, weights: FloatArray | None) -> tuple[slice, slice]:
    """Return rows and columns that hold every valid pixel; empty if there is none."""
    if weights is not None:
        z = np.where(weights == 0.0, np.nan, z)
    rows = _used(z)
    return rows, _used(z[rows].T)


def _used(z: FloatArray) -> slice:
    """Return the rows from the first to the last with a valid pixel: a look at the edges."""
    first = _unused(z)
    return slice(first, z.shape[0] - _unused(z[::-1])) if first < z.shape[0] else slice(0, 0)


def _used_columns(z: FloatArray) -> slice:
    """Return the columns from the first to the last with a valid pixel, of rows that are few."""
    if z.size and z[0, 0] == z[0, 0] and z[0, -1] == z[0, -1]:  # no NaN: quick to see
        return slice(0, z.shape[1])
    used = np.flatnonzero(~np.isnan(z).all(axis=0))
    return slice(int(used[0]), int(used[-1]) + 1) if used.size else slice(0, 0)


def _unused(z: FloatArray) -> int:
    """Return how many rows come before the first with a valid pixel."""
    n_lines = int(z.shape[0])
    if z.size and z[0, 0] == z[0, 0]:  # no NaN: mostly so, and quick to see
        return 0
    start, n_rows = 0, 16
    while start < n_lines:
        valid = ~np.isnan(z[start : start + n_rows]).all(axis=1)
        if valid.any():
            return start + int(valid.argmax())
        start, n_rows = start + n_rows, 2 * n_rows
    return n_lines


def residual_sums(grid: Grid, c: FloatArray, degree: int, *, with_weights: bool = True) -> Sums:
    """Return the sums over a map less the polynomial c.

    Sums of weights go to degree 2 d, and are zero unless asked for; sums of heights to degree d.
    """
    rows, n_columns = grid.z.shape
    n, m = degree + 1, 2 * degree + 1
    right = np.ascontiguousarray(grid.px[:m].T)
    low = np.ascontiguousarray(right[:, :n])
    left, across = c.T @ grid.px[: c.shape[0]], np.ascontiguousarray(grid.py[: c.shape[1]].T)
    row_weights, row_heights = np.zeros((rows, m)), np.zeros((rows, n))
    squares, n_valid = 0.0, 0
    height = max(1, min(_BLOCK, _SMALL_PRODUCT // m) // max(n_columns, 1))
    room = np.empty((2, height * n_columns))
    marks = np.empty(height * n_columns, dtype=np.bool_)
    with np.errstate(invalid="ignore", over="ignore"):
        np.setbufsize(_BUFFER)  # until the end of errstate
        for block in _blocks(grid, height):
            part, columns = block.rows, block.columns
            shape = (part.stop - part.start, columns.stop - columns.start)
            n_block = shape[0] * shape[1]
            if n_block == 0:
                continue
            r, w = room[0, :n_block].reshape(shape), room[1, :n_block].reshape(shape)
            valid = marks[:n_block].reshape(shape)
            n_here, energy = _fill(grid, block, across[part], left[:, columns], r, w, valid)
            n_valid += n_here
            if grid.weights is not None:
                w *= grid.weights[part, columns]
                energy = float(np.vdot(r * w, r))
                r *= w
            squares += energy
            if with_weights:
                these = right[columns]
                whole = n_here == n_block and grid.weights is None
                row_weights[part] = these.sum(axis=0) if whole else w @ these
            np.matmul(r, low[columns], out=row_heights[part])
        sums = row_heights.T @ grid.py[:n].T
    if not np.isfinite(sums).all() or not np.isfinite(squares):
        raise InvalidSamplesError(
            "z is infinite somewhere, or too large to be squared; write NaN where nothing was "
            "measured"
        )
    return Sums(row_weights.T @ grid.py[:m].T, sums, squares, n_valid)


def _blocks(grid: Grid, height: int) -> Iterator[_Block]:
    """Yield the blocks of a map, without the columns at either side that do not count."""
    rows, n_columns = grid.z.shape
    starts = np.arange(0, rows, height)
    if grid.reach is None or not rows:
        for start in starts.tolist():
            part = slice(start, min(start + height, rows))
            yield _Block(part, _used_columns(grid.z[part]), 0, n_columns)
        return
    edges = [
        extreme.reduceat(end, starts).tolist()
        for end in grid.reach
        for extreme in (np.minimum, np.maximum)
    ]
    for start, first, from_here, to_here, after in zip(starts.tolist(), *edges, strict=True):
        part = slice(start, min(start + height, rows))
        yield _Block(part, slice(first, max(first, after)), from_here, to_here)


def _fill(
    grid: Grid,
    block: _Block,
    across: FloatArray,
    left: FloatArray,
    r: FloatArray,
    w: FloatArray,
    valid: NDArray[np.bool_],
) -> tuple[int, float]:
    """Fill r with z less the product, w with 1, both 0 in gaps; return the pixels and squares of r.

    In gaps r is NaN at first. The lesser of r and w, NaN giving way, is 0 there and r elsewhere,
    unless r exceeds 1: then its squares do too, and gaps become zeros by their bits.
    """
    z = grid.z[block.rows, block.columns]
    np.subtract(z, np.matmul(across, left, out=r), out=r)
    np.equal(r, r, out=valid)
    _leave_out(grid, block, r, valid)
    n_valid = int(np.count_nonzero(valid))
    if n_valid == r.size:
        if grid.weights is not None:
            w.fill(1.0)
        return n_valid, float(np.vdot(r, r))
    np.copyto(w, valid.view(np.int8))  # whole numbers are converted faster than booleans
    np.fmin(r, w, out=r)
    energy = float(np.vdot(r, r))
    if energy < 1.0:
        return n_valid, energy
    np.subtract(z, np.matmul(across, left, out=r), out=r)
    bits = r.view(np.int64)
    bits &= np.negative(valid.view(np.int8)).astype(np.int64)
    return n_valid, float(np.vdot(r, r))


def _leave_out(grid: Grid, block: _Block, r: FloatArray, valid: NDArray[np.bool_]) -> None:
    """Take measured pixels that do not count out of `valid`, and write NaN into r there."""
    if grid.weights is not None:
        _take_out(grid.weights[block.rows, block.columns] == 0.0, r, valid)
    if grid.reach is None:
        return
    first, after = (end[block.rows, None] for end in grid.reach)
    start, stop = block.columns.start, block.columns.stop
    if block.all_from > start:
        place = np.arange(start, block.all_from, dtype=first.dtype)
        _take_out(place < first, r[:, : place.size], valid[:, : place.size])
    if block.all_to < stop:
        place = np.arange(max(block.all_to, start), stop, dtype=after.dtype)
        _take_out(place >= after, r[:, -place.size :], valid[:, -place.size :])


def _take_out(beyond: NDArray[np.bool_], r: FloatArray, valid: NDArray[np.bool_]) -> None:
    beyond &= valid
    if beyond.any():  # most maps hold nothing outside their aperture
        valid ^= beyond
        np.copyto(r, np.nan, where=beyond)


def grid_values(
    c: FloatArray, px: FloatArray, py: FloatArray, *, minus_from: FloatArray | None = None
) -> FloatArray:
    """Return the polynomial at every pixel, or a map minus it.

    From the last row up: what the pass before this one read last is still in the cache.
    """
    n = c.shape[0]
    left, across = c.T @ px[:n], np.ascontiguousarray(py[:n].T)
    out = np.empty((py.shape[1], px.shape[1]))
    height = max(1, _BLOCK // max(out.shape[1], 1))
    for start in reversed(range(0, out.shape[0], height)):
        part = slice(start, start + height)
        block = np.matmul(across[part], left, out=out[part])
        if minus_from is not None:
            np.subtract(minus_from[part], block, out=block)
    return out


def normal_matrix(sums: FloatArray, degree: int) -> FloatArray:
    """Return the weighted sums of ``P_i P_j P_k P_l`` at [i, j, k, l]; i, k along x, j, l along y.

    The product of two Legendre polynomials is a sum of others, so sums to degree 2 d suffice.
    """
    n, m = degree + 1, 2 * degree + 1
    product = linearisation(degree).reshape(n * n, m)
    both = (product @ sums @ product.T).reshape(n, n, n, n)
    return np.ascontiguousarray(both.transpose(0, 2, 1, 3))


def inverse_of(normal: FloatArray, what: str) -> tuple[FloatArray, float]:
    """Return the inverse of a normal matrix and a bound of its condition, or refuse to.

    With ones on its diagonal; the bound is the product of the largest column sums.
    """
    diagonal = np.sqrt(np.maximum(np.diag(normal), 0.0))
    if diagonal[0] > 0.0 and (diagonal > 1e-12 * diagonal[0]).all():
        scale = np.outer(diagonal, diagonal)
        scaled = normal / scale
        with suppress(np.linalg.LinAlgError):
            plain = np.linalg.inv(scaled)
            condition = float(np.abs(scaled).sum(axis=0).max() * np.abs(plain).sum(axis=0).max())
            if condition <= _PLAIN:
                return _fixed((plain + plain.T) / (2.0 * scale)), condition
        eigenvalues, vectors = np.linalg.eigh(scaled)
        if eigenvalues[0] > _SMALLEST_EIGENVALUE * eigenvalues[-1]:
            vectors /= diagonal[:, None]
            condition = float(eigenvalues[-1] / eigenvalues[0])
            return _fixed((vectors / eigenvalues) @ vectors.T), condition
    raise DegenerateFitError(
        f"the valid pixels do not determine {what}: they lie on too few rows, columns or curves, "
        "or on too small a part of the domain; use fewer terms or measure more of the part"
    )


def _fixed(inverse: FloatArray) -> FloatArray:
    inverse.setflags(write=False)
    return inverse
