"""Forms that are a weighted sum of fixed functions, and their least squares over points.

``z = sum_k c_k f_k(x, y)``: the derivative by a parameter is the function itself, and a fit needs
no starting value. The solver works in blocks of points with an orthogonal factorisation, never with
normal equations, so that it keeps the digits that the functions allow.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import (
    DegenerateFitError,
    InvalidSamplesError,
    NotConvergedError,
)
from metrosep.core.numbers import choice
from metrosep.forms.base import Form, Freedoms, Placement
from metrosep.forms.moments import LeastSquares
from metrosep.forms.points import Points

_BLOCK = 16384
"""Points of a block."""

_SMALLEST_SINGULAR_VALUE = 1e-13
"""Of the functions scaled to one size: below it, rounding decides the answer."""


class LinearForm(Form):
    """A form that is linear in all its parameters, its coefficients.

    Attributes
    ----------
    is_linear : bool
        True.
    names : tuple of str
        Of the parameters; of a polynomial the lowest total degree first.
    """

    is_linear = True
    names: tuple[str, ...]
    _values: tuple[float | None, ...]

    @property
    def parameters(self) -> dict[str, float | None]:
        return dict(zip(self.names, self._values, strict=True))

    @abstractmethod
    def basis(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the functions at points of equal shape, in the order of the parameters.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        ndarray, shape ``(n_parameters, *x.shape)``
            NaN outside the domain.
        """

    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        place = {name: i for i, name in enumerate(self.parameters)}
        functions = self.basis(x, y)
        return [functions[place[name]] for name in names]

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> LinearForm:
        if None not in self._values and self._has_domain:
            return self
        fitted = self.fit_points(x, y, z).form
        given = {k: v for k, v in self.parameters.items() if v is not None}
        return fitted.with_parameters(**given)  # type: ignore[return-value]

    @property
    def _has_domain(self) -> bool:
        """Whether known coefficients say all."""
        return True

    @abstractmethod
    def fit_points(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        """Return the least-squares form through scattered points in its domain.

        Parameters
        ----------
        x, y : array_like, shape (n,), m
            Positions in the form's frame.
        z : array_like, shape (n,), m
            Heights; NaN where not measured.
        weights : array_like, shape (n,), optional
            Weight of each point, >= 0.

        Returns
        -------
        LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.

        Raises
        ------
        InvalidSamplesError
            If lengths differ, or something is infinite.
        DegenerateFitError
            If the valid points in the domain do not determine the coefficients.
        """

    @abstractmethod
    def fit_grid(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        """Return the least-squares form through a map, without a design matrix.

        Parameters
        ----------
        x : array_like, shape (n_x,), m
            Positions of the columns in the form's frame, uniform and growing.
        y : array_like, shape (n_y,), m
            Positions of the rows in the form's frame, uniform and growing.
        z : array_like, shape (n_y, n_x), m
            Heights; NaN where not measured.
        weights : array_like, shape (n_y, n_x), optional
            Weight of each pixel, 0 to 1.

        Returns
        -------
        LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.

        Raises
        ------
        DataError
            If the form has one variable.
        InvalidSamplesError
            If shapes differ, something is infinite, or an axis of a disc falls.
        NotUniformError
            If x or y is not uniform.
        DegenerateFitError
            If the valid pixels in the domain do not determine the coefficients.

        Notes
        -----
        The covariance is that of the terms fitted together over the valid pixels. Zernike terms are
        orthogonal, and a coefficient independent of the other terms in the fit, only over a full
        disc.
        """

    @abstractmethod
    def fit_map(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through a map, and the map without it.

        Parameters
        ----------
        x, y, z, weights : array_like
            As of `fit_grid`.

        Returns
        -------
        fit : LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.
        residual : ndarray, shape (n_y, n_x), m
            What is left; NaN outside the domain too.

        Raises
        ------
        DataError
            If the form has one variable, the samples are invalid or not uniform, or do not
            determine the coefficients: as `fit_grid`.
        """

    @abstractmethod
    def fit_list(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through points, and what it leaves.

        Parameters
        ----------
        x, y, z, weights : array_like, shape (n,)
            As of `fit_points`.

        Returns
        -------
        fit : LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.
        residual : ndarray, shape (n,), m
            What is left; NaN outside the domain too.

        Raises
        ------
        DataError
            If the samples are invalid or do not determine the coefficients: as `fit_points`.
        """


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit(LeastSquares):
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


def solve_blocks(
    functions: Callable[[slice], FloatArray],
    z: FloatArray,
    *,
    weights: FloatArray | None = None,
    what: str = "the form",
) -> tuple[FloatArray, FloatArray, float]:
    """Return the least-squares coefficients, the inverse normal matrix, the sum of squares left.

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


# ---- the part of `fit` that needs no iteration: forms that are linear in all that is free ------
# A polynomial or Zernike form with unknown coefficients is solved by its own engine (moments of the
# map, orthogonal factors of a list).


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a fit found."""

    form: Form  # with its parameters
    rigid: dict[str, float]  # to float: rigid-body freedoms
    cov: FloatArray  # shape (p, p): covariance in the order of the freedoms
    residual: FloatArray  # shape of the points' z, m: what is left; NaN outside the domain
    n: int  # points inside the domain
    squares: float  # m^2: sum of the squared residuals


def solve_linear(
    points: Points, form: Form, freedoms: Freedoms, robust: Robust | None
) -> Answer | None:
    """Return the answer of a form whose coefficients are all that is free, else None."""
    if not isinstance(form, LinearForm) or freedoms.shape != tuple(form.parameters):
        return None
    if freedoms.rigid or freedoms.held:
        return None
    if robust is not None:
        return _robust(points, form, robust)
    fit, residual = _once(points, form, None)
    n, squares = fit.n_valid, max(fit.residual_sum, 0.0)
    return Answer(fit.form, {}, covariance_of(fit), residual, n, squares)


def sum_of_squares(residual: FloatArray) -> tuple[int, float]:
    """Return the number of points that are not NaN, and the sum of their squares."""
    squares, n = 0.0, 0
    for part in np.array_split(residual.ravel(), max(1, residual.size >> 16)):
        good = part[~np.isnan(part)]
        squares += float(good @ good)
        n += int(good.size)
    return n, squares


def _once(
    points: Points, form: LinearForm, weights: FloatArray | None
) -> tuple[LinearFit, FloatArray]:
    if points.z.shape[0] > 1 and not points.is_scattered:
        return form.fit_map(points.x, points.y, points.z, weights=weights)
    y = points.y if points.is_scattered else np.broadcast_to(points.y, points.x.shape)
    flat = None if weights is None else weights[0]
    fit, residual = form.fit_list(points.x, y, points.z[0], weights=flat)
    return fit, residual[None, :]


def _robust(points: Points, form: LinearForm, rule: Robust) -> Answer:
    """Return the MM-estimate: trimmed start of a sample, then weights of all points."""
    least, residual = _once(points, form, None)
    form = least.form  # its domain stays, whatever the weights
    x, y, z = points.sample()
    left = z - form.height(x, y)
    inside = ~np.isnan(left)
    change = trimmed_start(form.basis(x, y)[:, inside], left[inside])
    values = {
        k: float(v or 0.0) + float(d)
        for (k, v), d in zip(form.parameters.items(), change, strict=True)
    }
    trimmed = Placement(form.with_parameters(**values), {})
    residual = np.where(np.isnan(residual), np.nan, points.over_blocks(trimmed.deviation))

    def refit(
        last: tuple[LinearFit, FloatArray], weigh: Weigh
    ) -> tuple[tuple[LinearFit, FloatArray], float]:
        fit, fresh = _once(points, form, weigh(last[1]))
        n, squares = sum_of_squares(fresh - last[1])
        return (fit, fresh), float(np.sqrt(squares / n))

    (fit, residual), scale = robust_fit(
        (least, residual),
        lambda found: spread(found[1]),
        refit,
        rule,
        largest=points.largest,
        name=form.name,
    )
    flat = residual[~np.isnan(residual)]
    cov = robust_variance(flat, scale, rule, len(form.parameters)) * least.inverse
    n, squares = sum_of_squares(residual)
    return Answer(fit.form, {}, cov, residual, n, squares)


def covariance_of(fit: LinearFit) -> FloatArray:
    """Return the covariance; NaN where there are no degrees of freedom."""
    if fit.n_valid <= fit.inverse.shape[0]:
        return np.full(fit.inverse.shape, np.nan)
    return fit.covariance


# ---- what keeps outliers from pulling a fit: a trimmed start, then Tukey's or Huber's weights ----
# An MM-estimate: least trimmed squares of a sample (up to half of the points may be wrong) gives the
# place and the spread of the good points; with that spread held, weighted least squares is repeated
# until it settles. Sources: Rousseeuw and Van Driessen 2006 (FAST-LTS); Yohai 1987; Huber 1981, 7.6.

Robust = Literal["tukey", "huber"]
Weigh = Callable[[FloatArray], FloatArray]
"""From the deviation of each point to its weight; 0 where the deviation is NaN."""
Fitted = TypeVar("Fitted")

_TUNING = {"tukey": 4.685, "huber": 1.345}
"""95 % efficiency for Gaussian noise (Holland and Welsch 1977)."""

_TRIM_POINTS, _TRIM_STARTS = 1000, 300
"""Of the sample; 300 subsets of 7 points hold one without outlier even where 40 % are wrong."""

_ROUNDS = 300
"""Of weights: they settle linearly."""

_SETTLED = 1e-6
"""Of the spread: a round that moves the heights by less changes nothing that matters."""

_EXACT = 1e-15
"""Of the largest height: a spread below it is rounding, and the good points fit exactly."""

_NORMAL_MAD = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""


def spread(deviation: FloatArray) -> float:
    """Return the standard deviation that Gaussian noise of this median magnitude has."""
    valid = np.abs(deviation[~np.isnan(deviation)])
    return _NORMAL_MAD * float(np.median(valid)) if valid.size else 0.0


def robust_weights(deviation: FloatArray, scale: float, rule: Robust) -> FloatArray:
    """Return the weight of each point, 0 to 1."""
    choice(rule, "robust", _TUNING)
    limit = _TUNING[rule] * scale
    magnitude = np.abs(deviation)
    if limit == 0.0:
        return np.where(np.isnan(deviation), np.nan, (magnitude == 0.0).astype(np.float64))
    if rule == "tukey":
        inside = 1.0 - np.minimum(magnitude / limit, 1.0) ** 2
        return inside * inside
    return np.minimum(1.0, limit / np.maximum(magnitude, limit))


def robust_variance(deviation: FloatArray, scale: float, rule: Robust, p: int) -> float:
    """Return the factor of ``(J'J)^-1`` in the covariance of a robust fit.

    Source: Huber 1981, Robust Statistics, Eq. (6.5).
    """
    r = deviation[~np.isnan(deviation)]
    if r.size <= p:
        return float("nan")
    limit = _TUNING[rule] * scale
    if limit == 0.0:
        return 0.0
    psi, mean_slope = _psi(r, limit, rule)
    return float(psi @ psi) / (r.size - p) / mean_slope**2 if mean_slope > 0.0 else float("nan")


def winsorised(deviation: FloatArray, rule: Robust) -> FloatArray:
    """Return the deviations that the covariance of a robust fit is made of."""
    good = ~np.isnan(deviation)
    limit = _TUNING[rule] * spread(deviation)
    if limit == 0.0:
        return np.where(good, 0.0, np.nan)
    psi, slope = _psi(deviation[good], limit, rule)
    out = np.full(deviation.shape, np.nan)
    out[good] = psi / slope if slope > 0.0 else np.nan
    return out


def _psi(r: FloatArray, limit: float, rule: Robust) -> tuple[FloatArray, float]:
    """Return psi(r) = w r, and the mean of its slope."""
    psi = robust_weights(r, limit / _TUNING[rule], rule) * r
    inside = np.abs(r) < limit
    if rule == "tukey":
        square = np.where(inside, (r / limit) ** 2, 1.0)
        return psi, float(((1.0 - square) * (1.0 - 5.0 * square)).mean())
    return psi, float(inside.mean())


def robust_fit(
    start: Fitted,
    spread_of: Callable[[Fitted], float],
    refit: Callable[[Fitted, Weigh], tuple[Fitted, float]],
    rule: Robust,
    *,
    largest: float,
    name: str,
) -> tuple[Fitted, float]:
    """Return the fit at which the weights have settled: the spread held, twice."""
    fitted, scale = start, 0.0
    for _ in range(2):
        scale = spread_of(fitted)
        if scale <= _EXACT * largest:
            scale = 0.0
        fitted = _with_scale(fitted, scale, refit, rule, name)
        if scale == 0.0:
            break
    return fitted, scale


def _with_scale(
    fitted: Fitted,
    scale: float,
    refit: Callable[[Fitted, Weigh], tuple[Fitted, float]],
    rule: Robust,
    name: str,
) -> Fitted:
    def weigh(deviation: FloatArray) -> FloatArray:
        return np.nan_to_num(robust_weights(deviation, scale, rule))

    for _ in range(_ROUNDS):
        fitted, moved = refit(fitted, weigh)
        if scale == 0.0 or moved <= _SETTLED * scale:
            return fitted
    raise NotConvergedError(
        f"the robust weights of the {name} did not settle in {_ROUNDS} rounds: there is no clear "
        "majority of good points; mask the bad ones, or fit without robust="
    )


def trimmed_start(jacobian: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return the change of the parameters that the better half of the points asks for."""
    p, n = jacobian.shape
    thin = max(1, n // _TRIM_POINTS)
    J, r = jacobian[:, ::thin], deviation[::thin]
    n = r.size
    length = np.sqrt((J * J).sum(axis=1) / max(n, 1))
    if p == 0 or n < 3 * p + 3 or not (length > 0.0).all():
        return np.zeros(p)
    J = J / length[:, None]
    half = (n + p + 1) // 2
    rng = np.random.default_rng(19840101)
    starts = [np.zeros(p)]
    for _ in range(_TRIM_STARTS):
        some = rng.choice(n, size=p, replace=False)
        with suppress(np.linalg.LinAlgError):
            starts.append(np.linalg.solve(J[:, some].T, r[some]))
    tried = sorted((_concentrate(J, r, a, half, 2) for a in starts), key=lambda t: t[0])
    best = min((_concentrate(J, r, a, half, 30) for _, a in tried[:5]), key=lambda t: t[0])
    return np.asarray(best[1] / length)


def _concentrate(
    J: FloatArray, r: FloatArray, a: FloatArray, half: int, steps: int
) -> tuple[float, FloatArray]:
    """Return the sum of the smaller squares, and the parameters, after steps that lower it."""
    left = np.square(r - a @ J)
    squares = float(np.partition(left, half - 1)[:half].sum())
    for _ in range(steps):
        near = np.argpartition(left, half - 1)[:half]
        part = J[:, near]
        try:
            solved = np.linalg.solve(part @ part.T, part @ r[near])
        except np.linalg.LinAlgError:
            break
        trial = np.asarray(solved, dtype=np.float64)
        fresh = np.square(r - trial @ J)
        total = float(np.partition(fresh, half - 1)[:half].sum())
        if not total < squares:
            break
        a, left, squares = trial, fresh, total
    return squares, a
