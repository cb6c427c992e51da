"""Polynomials as forms: powers of x and y, Legendre or Chebyshev polynomials on a scaled domain.

Every fit is made in Legendre polynomials on the domain of the data, and converted at the end. A
power basis is for printing and for programs that want it; it is never fitted in.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError, DegenerateFitError
from metrosep.core.numbers import choice, count
from metrosep.forms._orthogonal import Basis, values, values_and_slopes
from metrosep.forms.base import Freedoms, Placement, checked
from metrosep.forms.linear import Answer, LinearFit, LinearForm, Robust, covariance_of
from metrosep.forms.moments import DOCS, MAX_DEGREE, Kind, polynomial_terms
from metrosep.forms.points import Points
from metrosep.forms.polynomial_fit import (
    Domain,
    fit_grid,
    fit_points,
    fit_profile,
    in_basis,
    remove_map,
)

_LETTERS = {"power": "c", "legendre": "L", "chebyshev": "T"}

_BLOCK = 65536
"""Points that are evaluated at once."""


@documented(**DOCS)
class Polynomial(LinearForm):
    """A polynomial in x, or in x and y.

    Parameters
    ----------
    $degree
    basis : {"power", "legendre", "chebyshev"}, optional
        Functions of each variable.
    variables : {1, 2}, optional
        1 for a profile, z(x). Default: as `coefficients` say, else 2.
    coefficients : array_like or mapping, optional
        ``c[i]`` or ``c[i, j]`` (i along x) or values by parameter name, SI. None: not known yet.
    centre : float or tuple of float, m, optional
        Where each variable is zero. Default: the origin for powers, the middle of the fitted data
        for the others.
    half_width : float or tuple of float, m, optional
        Length that the variables are divided by; powers are of metres and have none. Default: that
        of the fitted data.

    Raises
    ------
    DataError
        If an argument is not one of those above, or the coefficients do not fit the degree.

    Notes
    -----
    Parameters are ``c0, c1, ...`` of x, or ``c_i_j`` of ``x^i y^j`` in ``m^(1-i-j)``; with letter L
    or T, in m, of ``P_i(u) P_j(v)`` or ``T_i(u) T_j(v)``, ``u = (x - centre) / half_width``.

    Examples
    --------
    >>> line = Polynomial(1, coefficients=[1e-6, 2e-3])
    >>> float(line(0.5e-3))
    2e-06
    """

    name = "polynomial"
    has_centre = False
    is_everywhere = True
    _is_of_y = False

    def __init__(
        self,
        degree: int,
        *,
        kind: Kind = "total",
        basis: Basis = "power",
        variables: Literal[1, 2] | None = None,
        coefficients: ArrayLike | Mapping[str, float | None] | None = None,
        centre: float | Sequence[float] | None = None,
        half_width: float | Sequence[float] | None = None,
    ) -> None:
        choice(basis, "basis", _LETTERS)
        choice(kind, "kind", ("total", "tensor"))
        self.degree = count(degree, "degree", least=0, most=MAX_DEGREE)
        self.kind, self.basis_name = kind, basis
        self.variables = _variables(variables, coefficients)
        self.terms = (
            polynomial_terms(self.degree, kind)
            if self.variables == 2
            else tuple((i, 0) for i in range(self.degree + 1))
        )
        letter = _LETTERS[basis]
        if self.variables == 1:
            self.names = tuple(f"{letter}{'' if letter == 'c' else '_'}{i}" for i, _ in self.terms)
        else:
            self.names = tuple(f"{letter}_{i}_{j}" for i, j in self.terms)
        self._values = self._given(coefficients)
        self.centre, self.half_width = self._domain(centre, half_width)

    def _domain(
        self, centre: float | Sequence[float] | None, half_width: float | Sequence[float] | None
    ) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        if self.basis_name == "power":
            if half_width is not None:
                raise DataError("powers are of metres; half_width goes with legendre or chebyshev")
            return _each(0.0 if centre is None else centre, self.variables, "centre"), (
                1.0,
            ) * self.variables
        if (centre is None) != (half_width is None):
            raise DataError("give both centre and half_width, or neither")
        known = all(v is not None for v in self._values)
        if centre is None or half_width is None:
            if known:
                raise DataError(
                    f"{self.basis_name} coefficients mean nothing without their domain; give "
                    "centre and half_width"
                )
            return None, None
        widths = _each(half_width, self.variables, "half_width")
        if not min(widths) > 0.0:
            raise DataError(f"half_width must be positive, got {half_width}")
        return _each(centre, self.variables, "centre"), widths

    def _given(self, given: Any) -> tuple[float | None, ...]:
        names = self.names
        if given is None:
            return (None,) * len(names)
        if isinstance(given, Mapping):
            stray = [k for k in given if k not in names]
            if stray:
                there = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
                raise DataError(f"{self.name} has no parameter {stray[0]!r}; there are: {there}")
            return tuple(checked(given.get(k), k) for k in names)
        c = np.asarray(given, dtype=np.float64)
        n = self.degree + 1
        if c.shape != (n,) * self.variables:
            raise DataError(
                f"degree {self.degree} needs coefficients of shape {(n,) * self.variables}, got "
                f"{c.shape}"
            )
        if not np.isfinite(c).all():
            raise DataError("coefficients must be finite")
        table = c.reshape(n, -1)
        if np.count_nonzero(table) != np.count_nonzero([table[t] for t in self.terms]):
            raise DataError(
                f'a coefficient above total degree {self.degree} is not zero; use kind="tensor"'
            )
        return tuple(float(table[t]) for t in self.terms)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        if self.basis_name != "power":
            return dict.fromkeys(self.names, "m")
        powers = {0: "m", 1: "1"}
        units = (powers.get(i + j, f"m^{1 - i - j}") for i, j in self.terms)
        return dict(zip(self.names, units, strict=True))

    @property
    def spanned(self) -> frozenset[str]:
        flat = {"piston"} if self.degree == 0 else {"piston", "tilt_x", "tilt_y"}
        return frozenset(flat | {"shift_x", "shift_y"} if self.basis_name == "power" else flat)

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients as an array, shape (degree + 1,) or (degree + 1, degree + 1), i along x.

        Raises
        ------
        DataError
            If one is not known yet.
        """
        c = np.zeros((self.degree + 1, self.degree + 1 if self.variables == 2 else 1))
        for term, name, value in zip(self.terms, self.names, self._values, strict=True):
            if value is None:
                raise DataError(f"{name} of the {self.name} is not known yet: give one, or fit it")
            c[term] = value
        return c if self.variables == 2 else c[:, 0]

    def with_parameters(self, **values: float) -> Polynomial:
        return self._copy({**self.parameters, **values}, self.centre, self.half_width)

    def for_profile(self) -> Polynomial:
        """Return the polynomial of one variable of the same degree, its coefficients not known.

        Returns
        -------
        Polynomial
            The form itself if it has one variable.
        """
        if self.variables == 1:
            return self
        power = self.basis_name == "power"
        centre = None if self.centre is None else self.centre[:1]
        width = None if self.half_width is None or power else self.half_width[:1]
        return Polynomial(
            self.degree, basis=self.basis_name, variables=1, centre=centre, half_width=width
        )

    def for_column(self) -> Polynomial:
        """Return the terms in y alone, for a map of one column, their coefficients not known.

        Returns
        -------
        Polynomial
            The form itself if it has one variable, or a coefficient is known.
        """
        if self.variables == 1 or any(v is not None for v in self._values):
            return self
        return self._copy(None, self.centre, self.half_width, of_y=True)

    def _of_y(self) -> None:
        """Leave out what holds x, in place."""
        kept = [k for k, (i, _) in enumerate(self.terms) if i == 0]
        for name in ("terms", "names", "_values"):
            every = getattr(self, name)
            setattr(self, name, tuple(every[k] for k in kept))
        self._is_of_y = True

    def _copy(
        self, values: Any, centre: Any, half_width: Any, *, of_y: bool = False
    ) -> Polynomial:
        copy = Polynomial(
            self.degree,
            kind=self.kind,
            basis=self.basis_name,
            variables=self.variables,
            coefficients=values,
            centre=centre,
            half_width=None if self.basis_name == "power" else half_width,
        )
        if of_y or self._is_of_y:
            copy._of_y()
        return copy

    def _scaled(self, x: FloatArray, y: FloatArray) -> list[FloatArray]:
        if self.centre is None or self.half_width is None:
            raise DataError(f"the {self.name} has no domain yet: give centre and half_width")
        points = (x, y)[: self.variables]
        return [(p - c) / h for p, c, h in zip(points, self.centre, self.half_width, strict=True)]

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return self._sums(x, y, ((0, 0),))[0]

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.variables == 1:
            return self._sums(x, y, ((1, 0),))[0], np.zeros_like(x)
        dx, dy = self._sums(x, y, ((1, 0), (0, 1)))
        return dx, dy

    def _sums(
        self, x: FloatArray, y: FloatArray, orders: tuple[tuple[int, int], ...]
    ) -> list[FloatArray]:
        c = self.coefficients.reshape(self.degree + 1, -1)
        flat = [u.ravel() for u in self._scaled(x, y)]
        widths = self.half_width or ()
        out = [np.empty(x.size) for _ in orders]
        for start in range(0, x.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            tables = [values_and_slopes(u[part], self.degree, basis=self.basis_name) for u in flat]
            for target, order in zip(out, orders, strict=True):
                along = tables[0][order[0]]
                if self.variables == 1:
                    target[part] = c[:, 0] @ along
                else:
                    target[part] = np.einsum("in,in->n", along, c @ tables[1][order[1]])
                for width, o in zip(widths, order, strict=False):
                    target[part] /= width**o
        return [o.reshape(x.shape) for o in out]

    def basis(self, x: FloatArray, y: FloatArray) -> FloatArray:
        tables = [values(u, self.degree, basis=self.basis_name) for u in self._scaled(x, y)]
        i, j = np.array(self.terms).T
        out: FloatArray = tables[0][i]
        return out if self.variables == 1 else out * tables[1][j]

    def fit_profile(
        self, x: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        """Return the least-squares polynomial of one variable through a profile.

        Parameters
        ----------
        x : array_like, shape (n,), m
            Positions, in any order and with any spacing.
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
            If the valid points do not determine the coefficients.
        """
        if self.variables == 2:
            return self.for_profile().fit_profile(x, z, weights=weights)
        return self._fitted(*fit_profile(x, z, self.degree, weights=weights))

    def fit_points(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        if self.variables == 1:
            return self.fit_profile(x, z, weights=weights)
        return self._fitted(*fit_points(x, y, z, self.terms, weights=weights))

    def fit_grid(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        if self.variables == 1:
            raise DataError("a map needs a polynomial of two variables; this one has one")
        if self._is_of_y:
            return self.fit_map(x, y, z, weights=weights)[0]
        return self._fitted(*fit_grid(x, y, z, self.degree, self.kind, weights=weights))

    def fit_list(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        # The residual is evaluated on the scaled domain, so that powers far from their origin cost no
        # digits.
        xs, ys, zs = (np.asarray(v, dtype=np.float64) for v in (x, y, z))
        if self.variables == 1:
            raw = fit_profile(xs, zs, self.degree, weights=weights)
        else:
            raw = fit_points(xs, ys, zs, self.terms, weights=weights)
        twin = Polynomial(self.degree, kind=self.kind, basis="legendre", variables=self.variables)
        if self._is_of_y:
            twin._of_y()
        scaled = twin._fitted(*raw).form  # another instance of this class
        return self._fitted(*raw), zs - scaled.height(xs, ys)

    def fit_map(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        if self.variables == 1:
            raise DataError("a map needs a polynomial of two variables; this one has one")
        if self._is_of_y:
            v, u = np.meshgrid(y, x, indexing="ij")
            flat = None if weights is None else np.ravel(weights)
            fit, left = self.fit_list(u.ravel(), v.ravel(), np.ravel(z), weights=flat)
            return fit, left.reshape(u.shape)
        raw, residual = remove_map(x, y, z, self.degree, self.kind, weights=weights)
        return self._fitted(*raw), residual

    def _fitted(
        self,
        c: NDArray[Any],
        inverse: FloatArray,
        squares: float,
        n: int,
        domain: Domain,
        /,
    ) -> LinearFit:
        target = (
            domain
            if self.centre is None or self.half_width is None
            else list(zip(self.centre, self.half_width, strict=True))
        )
        new, inverse = in_basis(c, inverse, self.terms, self.basis_name, domain, target)
        centre, width = ([d[k] for d in target] for k in (0, 1))
        named = dict(zip(self.names, (float(new[t]) for t in self.terms), strict=True))
        return LinearFit(self._copy(named, centre, width), inverse, squares, n)

    def __repr__(self) -> str:
        if any(v is None for v in self._values):
            return f"Polynomial({self.degree}, {self.basis_name}, {self.kind}, not fitted)"
        return super().__repr__()


def _variables(given: int | None, coefficients: Any) -> Literal[1, 2]:
    implied: int | None = None
    if isinstance(coefficients, Mapping):
        if coefficients:
            implied = 1 if all(re.fullmatch(r"c\d+|[LT]_\d+", k) for k in coefficients) else 2
    elif coefficients is not None:
        implied = int(np.ndim(coefficients))
    number = given if given is not None else (implied or 2)
    if number not in (1, 2):
        raise DataError(f"a polynomial has 1 or 2 variables, got {number}")
    return 1 if number == 1 else 2


def _each(value: float | Sequence[float], n: int, name: str) -> tuple[float, ...]:
    numbers = tuple(float(v) for v in np.atleast_1d(np.asarray(value, dtype=np.float64)))
    if len(numbers) == 1:
        numbers *= n
    if len(numbers) != n or not np.isfinite(numbers).all():
        raise DataError(f"{name} must be {n} finite value(s) in m, got {value}")
    return numbers


# ---- polynomials by the name of their basis: Legendre, Chebyshev, XY ---------------------------


@documented(**DOCS)
def Legendre(  # noqa: N802  # a form, though made by a function
    degree: int, *, kind: Kind = "total", **options: Any
) -> Polynomial:
    """Return a polynomial in Legendre polynomials on a scaled domain.

    Parameters
    ----------
    $degree
    **options : object
        Of `Polynomial`.

    Returns
    -------
    Polynomial
        With parameters ``L_i_j``.
    """
    return Polynomial(degree, kind=kind, basis="legendre", **options)


@documented(**DOCS)
def Chebyshev(  # noqa: N802  # a form, though made by a function
    degree: int, *, kind: Kind = "total", **options: Any
) -> Polynomial:
    """Return a polynomial in Chebyshev polynomials of the first kind on a scaled domain.

    Parameters
    ----------
    $degree
    **options : object
        Of `Polynomial`.

    Returns
    -------
    Polynomial
        With parameters ``T_i_j``.
    """
    return Polynomial(degree, kind=kind, basis="chebyshev", **options)


def XY(  # noqa: N802  # a form, though made by a function
    degree: int, **options: Any
) -> Polynomial:
    """Return a polynomial in powers of x and y to a total degree.

    Parameters
    ----------
    degree : int
        Highest i + j, 0 to 40.
    **options : object
        Of `Polynomial`.

    Returns
    -------
    Polynomial
        With parameters ``c_i_j`` of ``x^i y^j``.
    """
    return Polynomial(degree, kind="total", basis="power", variables=2, **options)


# ---- a known form with piston and both tilts free on a map: the polynomial of degree 1 of what it leaves ----

_LEVELS = ("piston", "tilt_x", "tilt_y")


def solve_level(
    points: Points, placed: Placement, freedoms: Freedoms, robust: Robust | None
) -> Answer | None:
    """Return piston and tilt of a known form on a map where nothing else is free, else None."""
    if points.z.shape[0] < 2 or freedoms.names != _LEVELS or robust is not None:
        return None
    if (placed.tilt, placed.direction) != ("plane", "vertical") or not points.is_uniform:
        return None
    try:
        return _levelled(points, placed)
    except DegenerateFitError:  # the general solver names the freedoms that are not determined
        return None


def _levelled(points: Points, placed: Placement) -> Answer:
    """Return piston and tilt of a known form on a map."""
    bare = Placement(
        placed.form, {k: v for k, v in placed.rigid.items() if k not in _LEVELS}, placed.tilt
    )
    left = points.z
    if placed.form.parameters:  # a plane holds nothing that is not fitted
        left = points.over_blocks(bare.deviation)
    fit, residual = Polynomial(1).fit_map(points.x, points.y, left)
    c = fit.form.parameters
    rigid = dict(
        zip(_LEVELS, (float(c[k] or 0.0) for k in ("c_0_0", "c_1_0", "c_0_1")), strict=True)
    )
    n, squares = fit.n_valid, max(fit.residual_sum, 0.0)
    return Answer(placed.form, {**bare.rigid, **rigid}, covariance_of(fit), residual, n, squares)
