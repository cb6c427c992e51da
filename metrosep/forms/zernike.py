"""Zernike circle polynomials as a form on a disc.

``z = sum_j a_j N_j Z_j(x / radius, y / radius)``. The coefficient of a term normalised to "rms" is
the rms height of that term over the disc; of one normalised to "peak" it is its height at the rim.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from functools import lru_cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.forms.base import checked
from metrosep.forms.linear import LinearFit, LinearForm
from metrosep.forms.zernike_fit import (
    RIM,
    ZernikeFit,
    fit_zernike_grid,
    fit_zernike_points,
    zernike_map,
)
from metrosep.forms.zernike_index import ZernikeOrder, term_indices, term_name, to_nm
from metrosep.forms.zernike_terms import zernike_gradients, zernike_values

__all__ = ["Zernike"]

Normalisation = Literal["rms", "peak"]

_Counted = tuple[tuple[int, ...], tuple[tuple[int, int], ...], tuple[str, ...]]

_BLOCK = 16384
"""Points that are evaluated at once."""


def _counted(terms: int | Sequence[int], order: ZernikeOrder) -> _Counted:
    """Return numbers, orders and names of terms."""
    indices = term_indices(terms, order)
    return indices, tuple(to_nm(j, order) for j in indices), tuple(f"Z{j}" for j in indices)


_numbered = lru_cache(maxsize=16)(_counted)


class Zernike(LinearForm):
    """A sum of Zernike terms on a disc around the origin; NaN outside.

    Parameters
    ----------
    terms : int or sequence of int, optional
        How many first terms, or the numbers of the terms.
    order : {"ansi", "noll", "fringe"}, optional
        How terms are counted: ANSI from 0, Noll and Fringe from 1.
    coefficients : array_like or mapping, optional, m
        In the order of the terms, or by parameter name. None: not known yet.
    radius : float, m, optional
        Of the disc. Default: a fit takes the farthest valid point.
    normalisation : {"rms", "peak"}, optional
        Default: "rms" for ANSI and Noll, "peak" for Fringe.

    Raises
    ------
    DataError
        If a term does not exist, coefficients are not as many as terms or not finite, the radius
        is not positive, or a word is not one of those above.

    Notes
    -----
    "rms" multiplies by ``sqrt(n + 1)`` for m = 0 and ``sqrt(2 (n + 1))`` otherwise, which makes the
    terms orthonormal in the mean over the disc. Parameters are ``Z0, Z1, ...`` by number, in m.

    Examples
    --------
    >>> bowl = Zernike([4], coefficients=[1e-6], radius=5e-3)
    >>> round(bowl(5e-3, 0.0).item() * 1e6, 6)  # sqrt(3) at the rim
    1.732051
    """

    name = "Zernike"
    has_centre = True

    def __init__(
        self,
        terms: int | Sequence[int] = 36,
        order: ZernikeOrder = "ansi",
        *,
        coefficients: ArrayLike | Mapping[str, float | None] | None = None,
        radius: float | None = None,
        normalisation: Normalisation | None = None,
    ) -> None:
        known = _numbered(terms, order) if type(terms) is int else _counted(terms, order)
        self.indices, self.nm, self.names = known
        self.order = order
        if normalisation not in (None, "rms", "peak"):
            raise DataError(f'normalisation must be "rms" or "peak", got {normalisation!r}')
        self.normalisation: Normalisation = normalisation or (
            "peak" if order == "fringe" else "rms"
        )
        self.radius = checked(radius, "radius", zero=False, dimension="length")
        if self.radius is not None and self.radius < 0.0:
            raise DataError(f"radius must be positive, got {radius}")
        self._values = self._given(coefficients)
        self._norms: FloatArray = np.array(
            [
                1.0 if self.normalisation == "peak" else math.sqrt((n + 1) * (2 if m else 1))
                for n, m in self.nm
            ]
        )

    def _given(self, given: Any) -> tuple[float | None, ...]:
        if given is None:
            return (None,) * len(self.names)
        if isinstance(given, Mapping):
            stray = [k for k in given if k not in self.names]
            if stray:
                raise DataError(
                    f"this Zernike form has no parameter {stray[0]!r}; it has {self.names[0]} to "
                    f"{self.names[-1]}, {len(self.names)} in all, counted after {self.order}"
                )
            return tuple(checked(given.get(k), k) for k in self.names)
        c = np.asarray(given, dtype=np.float64)
        if c.shape != (len(self.names),):
            raise DataError(f"{len(self.names)} terms need as many coefficients, got {c.shape}")
        return tuple(checked(float(v), k) for k, v in zip(self.names, c, strict=True))

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """SI unit of each parameter."""
        return dict.fromkeys(self.names, "m")

    @property
    def labels(self) -> dict[str, str]:
        """What opticians call each term, by parameter name."""
        return {k: term_name(n, m) for k, (n, m) in zip(self.names, self.nm, strict=True)}

    @property
    def spanned(self) -> frozenset[str]:
        """Rigid-body freedoms that the terms already hold."""
        held = {(0, 0): "piston", (1, 1): "tilt_x", (1, -1): "tilt_y"}
        return frozenset(word for nm, word in held.items() if nm in self.nm)

    @property
    def parameters(self) -> dict[str, float | None]:
        """Coefficients by name, m; None where not known yet."""
        return dict(zip(self.names, self._values, strict=True))

    def with_parameters(self, **values: float) -> Zernike:
        """Return the form with other values of some coefficients.

        Parameters
        ----------
        **values : float
            By name, m.

        Returns
        -------
        Zernike
            On the same disc.

        Raises
        ------
        DataError
            If a name is not one of the parameters.
        """
        return self._copy(self._given({**self.parameters, **values}), self.radius)

    def _copy(self, values: tuple[float | None, ...], radius: float | None) -> Zernike:
        form = copy(self)
        form.radius, form._values = radius, values  # noqa: SLF001  # of this class
        return form

    def _on_disc(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.radius is None:
            raise DataError("the disc of this Zernike form has no radius yet: give one, or fit it")
        u, v = x / self.radius, y / self.radius
        outside = u * u + v * v > (1.0 + RIM) ** 2
        return np.where(outside, np.nan, u), np.where(outside, np.nan, v)

    def _weights(self) -> FloatArray:
        known: FloatArray = np.array(self._values, dtype=np.float64)
        return known * self._norms

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return z at points of equal shape; NaN outside the disc.

        Parameters
        ----------
        x, y : ndarray, m
            Positions from the centre of the disc.

        Returns
        -------
        ndarray, m
            Heights.
        """
        u, v = (p.ravel() for p in self._on_disc(x, y))
        out, weights = np.empty(u.size), self._weights()
        for start in range(0, u.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            out[part] = weights @ zernike_values(u[part], v[part], self.nm)
        out[np.isnan(u)] = np.nan  # piston is 1 even there
        return out.reshape(x.shape)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points of equal shape; NaN outside the disc.

        Parameters
        ----------
        x, y : ndarray, m
            Positions from the centre of the disc.

        Returns
        -------
        tuple of ndarray
            Slopes, dimensionless; finite at the centre.
        """
        u, v = (p.ravel() for p in self._on_disc(x, y))
        weights = self._weights() / (self.radius or 1.0)
        out = np.empty((2, u.size))
        for start in range(0, u.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            for line, slope in zip(out, zernike_gradients(u[part], v[part], self.nm), strict=True):
                line[part] = weights @ slope
        inside = np.where(np.isnan(u), np.nan, 1.0)  # the slope of piston is 0 even there
        dx, dy = out * inside
        return dx.reshape(x.shape), dy.reshape(x.shape)

    def basis(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the normalised terms at points of equal shape, NaN outside the disc.

        Parameters
        ----------
        x, y : ndarray, m
            Positions from the centre of the disc.

        Returns
        -------
        ndarray, shape ``(n_terms, *x.shape)``
            In the order of `names`.
        """
        u, v = self._on_disc(x, y)
        terms = zernike_values(u, v, self.nm) * self._norms.reshape(-1, *(1,) * u.ndim)
        return np.where(np.isnan(u), np.nan, terms)

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Zernike:
        """Return the least-squares form through points.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points, x and y from the centre of the disc.

        Returns
        -------
        Zernike
            With all coefficients; the form itself if all are known.

        Raises
        ------
        DegenerateFitError
            If the points do not determine the coefficients.
        """
        if all(v is not None for v in self._values) and self.radius is not None:
            return self
        fitted = self.fit_points(x, y, z).form
        given = {k: v for k, v in self.parameters.items() if v is not None}
        return fitted.with_parameters(**given)  # type: ignore[return-value]

    def fit_grid(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        """Return the least-squares form through a map; points beyond the radius have no part.

        Parameters
        ----------
        x : array_like, shape (n_x,), m
            Positions of the columns from the centre of the disc, uniform and growing.
        y : array_like, shape (n_y,), m
            Positions of the rows from the centre of the disc, uniform and growing.
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
        InvalidSamplesError
            If shapes differ, something is infinite, or an axis falls.
        NotUniformError
            If x or y is not uniform.
        DegenerateFitError
            If the valid pixels inside the disc do not determine the terms.

        Notes
        -----
        The covariance is that of the terms fitted together over the valid pixels. Only over a full
        disc are they orthogonal, and a coefficient independent of the other terms in the fit.
        """
        return self._fitted(
            fit_zernike_grid(z, x, y, self.nm, radius=self.radius, weights=weights)
        )

    def fit_list(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through points, and what it leaves.

        Parameters
        ----------
        x, y : array_like, shape (n,), m
            Positions from the centre of the disc.
        z : array_like, shape (n,), m
            Heights; NaN where not measured.
        weights : array_like, shape (n,), optional
            Weight of each point, >= 0.

        Returns
        -------
        fit : LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.
        residual : ndarray, shape (n,), m
            NaN beyond the radius too.

        Raises
        ------
        InvalidSamplesError
            If lengths differ, or something is infinite.
        DegenerateFitError
            If the valid points do not determine the coefficients.
        """
        xs, ys, zs = (np.asarray(v, dtype=np.float64) for v in (x, y, z))
        fit = self.fit_points(xs, ys, zs, weights=weights)
        return fit, zs - fit.form.height(xs, ys)

    def fit_map(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        """Return the least-squares form through a map, and the map without it.

        Parameters
        ----------
        x : array_like, shape (n_x,), m
            Positions of the columns from the centre of the disc, uniform and growing.
        y : array_like, shape (n_y,), m
            Positions of the rows, uniform and growing.
        z : array_like, shape (n_y, n_x), m
            Heights; NaN where not measured.
        weights : array_like, shape (n_y, n_x), optional
            Weight of each pixel, 0 to 1.

        Returns
        -------
        fit : LinearFit
            ``.form``, ``.covariance``, ``.residual_sd``.
        residual : ndarray, shape (n_y, n_x), m
            What is left; NaN beyond the radius too.

        Raises
        ------
        InvalidSamplesError
            If shapes differ, something is infinite, or an axis falls.
        NotUniformError
            If x or y is not uniform.
        DegenerateFitError
            If the valid pixels inside the disc do not determine the terms.
        """
        fit = self.fit_grid(x, y, z, weights=weights)
        form = cast("Zernike", fit.form)
        weights_of_terms = form._weights()  # noqa: SLF001  # another instance of this class
        ideal = zernike_map(x, y, self.nm, weights_of_terms, radius=form.radius or 1.0)
        np.subtract(np.asarray(z, dtype=np.float64), ideal, out=ideal)
        return fit, ideal

    def fit_points(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        """Return the least-squares form through points; those beyond the radius have no part.

        Parameters
        ----------
        x, y : array_like, shape (n,), m
            Positions from the centre of the disc.
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
            If the valid points inside the disc do not determine the terms.
        """
        return self._fitted(
            fit_zernike_points(x, y, z, self.nm, radius=self.radius, weights=weights)
        )

    def _fitted(self, fit: ZernikeFit) -> LinearFit:
        a, inverse, squares, n, radius = fit
        form = self._copy(tuple((a / self._norms).tolist()), radius)
        return LinearFit(form, inverse / np.outer(self._norms, self._norms), squares, n)

    def __repr__(self) -> str:
        known = "" if all(v is not None for v in self._values) else ", not fitted"
        return (
            f"Zernike({len(self.indices)} terms {self.names[0]} ... {self.names[-1]}, "
            f"{self.order}, {self.normalisation}, radius {self.radius} m{known})"
        )
