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

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.forms._moment_solve import Span, solve_grid
from metrosep.forms._moment_sums import Grid, bounding_box, grid_values
from metrosep.forms._orthogonal import values, values_on_axis

__all__ = [
    "GridPolynomial",
    "evaluate_grid",
    "fit_grid_polynomial",
    "polynomial_terms",
    "remove_grid",
]

Kind = Literal["total", "tensor"]

MAX_DEGREE = 40
"""Far above what a surface needs; the normal matrix has up to 1681 rows there."""


@dataclass(frozen=True, slots=True, eq=False)
class GridPolynomial:
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

    @property
    def residual_sd(self) -> float:
        """Standard deviation of the residual in m, with the terms taken off the freedoms.

        Raises
        ------
        TooFewSamplesError
            If there are no more pixels than terms.
        """
        freedoms = self.n_valid - len(self.terms)
        if freedoms < 1:
            raise TooFewSamplesError(
                f"{self.n_valid} valid pixels and {len(self.terms)} terms leave nothing to "
                "estimate the scatter from; lower the degree"
            )
        return float(np.sqrt(max(self.residual_sum, 0.0) / freedoms))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the fitted coefficients in m^2, in the order of `terms`.

        Valid for independent noise of one size in every pixel of weight 1.

        Raises
        ------
        TooFewSamplesError
            If there are no more pixels than terms.
        """
        return self.inverse * self.residual_sd**2


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
    z : array_like, shape (n_y, n_x), m
        Heights; NaN where not measured.
    degree : int
        Highest degree, 0 to 40.
    kind : {"total", "tensor"}, optional
        Terms with ``i + j <= degree``, or with each of i and j ``<= degree``.
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
    DataError
        If the degree or the kind is not one of those above.
    InvalidSamplesError
        If z is not two-dimensional or infinite, or weights do not fit.
    DegenerateFitError
        If the valid pixels do not determine the terms.

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
    z : array_like, shape (n_y, n_x), m
        Heights; NaN where not measured.
    degree : int
        Highest degree, 0 to 40.
    kind : {"total", "tensor"}, optional
        Terms with ``i + j <= degree``, or with each of i and j ``<= degree``.
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
    DataError
        If the degree or the kind is not one of those above.
    InvalidSamplesError
        If z is not two-dimensional or infinite, or weights do not fit.
    DegenerateFitError
        If the valid pixels do not determine the terms.
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
    given = np.asarray(weights, dtype=np.float64)
    if given.shape != heights.shape:
        raise InvalidSamplesError(
            f"weights must have the shape of z, {heights.shape}, got {given.shape}"
        )
    if not (given.min(initial=0.0) >= 0.0 and given.max(initial=0.0) <= 1.0):
        raise InvalidSamplesError("weights must lie between 0 and 1, and none may be NaN")
    return heights, given


def _span(degree: int, kind: Kind) -> Span:
    if int(degree) != degree or not 0 <= degree <= MAX_DEGREE:
        raise DataError(f"degree must be a whole number from 0 to {MAX_DEGREE}, got {degree}")
    if kind not in ("total", "tensor"):
        raise DataError(f'kind must be "total" or "tensor", got {kind!r}')
    return _legendre(int(degree), kind)


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
