"""Forms that are a weighted sum of fixed functions, and their least squares over points.

``z = sum_k c_k f_k(x, y)``: the derivative by a parameter is the function itself, and a fit needs
no starting value. The solver works in blocks of points with an orthogonal factorisation, never with
normal equations, so that it keeps the digits that the functions allow.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError, InvalidSamplesError, TooFewSamplesError
from metrosep.forms.base import Form

__all__ = ["LinearFit", "LinearForm", "solve_blocks"]

_BLOCK = 16384
"""Points of a block."""

_SMALLEST_SINGULAR_VALUE = 1e-13
"""Of the functions scaled to one size: below it, rounding decides the answer."""


class LinearForm(Form):
    """A form that is linear in all its parameters.

    Attributes
    ----------
    is_linear : bool
        True.
    """

    is_linear = True

    @abstractmethod
    def basis(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the functions at points of equal shape, shape ``(n_parameters, *x.shape)``.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.
        """

    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        """Return dz/dp for each named parameter: its function.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.

        Returns
        -------
        list of ndarray
            In the order of the names.
        """
        place = {name: i for i, name in enumerate(self.parameters)}
        functions = self.basis(x, y)
        return [functions[place[name]] for name in names]

    @abstractmethod
    def fit_map(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through a map, and the map without it.

        Parameters
        ----------
        x : array_like, shape (n_x,), m
            Positions of the columns, uniform and growing.
        y : array_like, shape (n_y,), m
            Positions of the rows, uniform and growing.
        z : array_like, shape (n_y, n_x), m
            Heights; NaN where not measured.
        weights : array_like, shape (n_y, n_x), optional
            Weight of each pixel, 0 to 1.
        """

    @abstractmethod
    def fit_list(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through points, and what it leaves.

        Parameters
        ----------
        x, y : array_like, shape (n,), m
            Positions.
        z : array_like, shape (n,), m
            Heights; NaN where not measured.
        weights : array_like, shape (n,), optional
            Weight of each point, >= 0.
        """


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """A fitted linear form.

    Parameters
    ----------
    form : LinearForm
        With its parameters.
    inverse : ndarray, shape (n, n)
        Inverse of the normal matrix, in the order of ``form.parameters``.
    residual_sum : float, m^2
        Weighted sum of squared residuals.
    n_valid : int
        Points that had a part in the fit.
    """

    form: LinearForm
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
        freedoms = self.n_valid - self.inverse.shape[0]
        if freedoms < 1:
            raise TooFewSamplesError(
                f"{self.n_valid} points and {self.inverse.shape[0]} parameters leave nothing to "
                "estimate the scatter from; use fewer parameters"
            )
        return float(np.sqrt(max(self.residual_sum, 0.0) / freedoms))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters in SI, in the order of ``form.parameters``.

        Valid for independent noise of one size in every point of weight 1.

        Raises
        ------
        TooFewSamplesError
            If there are no more points than parameters.
        """
        return self.inverse * self.residual_sd**2


def solve_blocks(
    functions: Callable[[slice], FloatArray],
    z: FloatArray,
    *,
    weights: FloatArray | None = None,
    what: str = "the form",
) -> tuple[FloatArray, FloatArray, float]:
    """Return the least-squares coefficients, the inverse normal matrix, the sum of squares left.

    Notes
    -----
    Each block is reduced to its triangle R by Householder reflections, and stacked triangles are
    reduced again. The mean height, if the functions can hold it, should be removed before.
    """
    if not np.isfinite(z).all():
        raise InvalidSamplesError("a height is infinite; write NaN where nothing was measured")
    r: FloatArray | None = None
    with one_blas_thread():
        for start in range(0, z.size, _BLOCK):
            part = slice(start, min(start + _BLOCK, z.size))
            rows = np.vstack([functions(part), z[None, part]]).T
            if weights is not None:
                rows = rows * np.sqrt(weights[part])[:, None]
            stacked = rows if r is None else np.vstack([r, rows])
            r = np.asarray(np.linalg.qr(stacked, mode="r"))
    n = 0 if r is None else r.shape[1] - 1
    if r is None or r.shape[0] < n:
        raise DegenerateFitError(_degenerate(z.size, what))
    triangle = r[:n, :n]
    size = np.sqrt((triangle * triangle).sum(axis=0))
    if not (size > 0.0).all():
        raise DegenerateFitError(_degenerate(z.size, what))
    left, singular, right = np.linalg.svd(triangle / size)
    if not singular[-1] > _SMALLEST_SINGULAR_VALUE * singular[0]:
        raise DegenerateFitError(_degenerate(z.size, what))
    root = (right.T / singular) / size[:, None]
    coefficients = root @ (left.T @ r[:n, n])
    residual_sum = float(r[n, n] ** 2) if r.shape[0] > n else 0.0
    return coefficients, root @ root.T, residual_sum


def _degenerate(n: int, what: str) -> str:
    return (
        f"the {n} valid points do not determine {what}; lower the number of terms or measure more "
        "of the part"
    )
