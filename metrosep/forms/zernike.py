"""Zernike circle polynomials as a form on a disc.

``z = sum_j a_j N_j Z_j(x / radius, y / radius)``. The coefficient of a term normalised to "rms" is
the rms height of that term over the disc; of one normalised to "peak" it is its height at the rim.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import lru_cache
from math import isqrt
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.docs import documented
from metrosep.core.errors import DataError
from metrosep.core.numbers import choice, count, positive
from metrosep.forms.base import checked
from metrosep.forms.linear import LinearFit, LinearForm
from metrosep.forms.zernike_fit import (
    RIM,
    ZernikeFit,
    fit_zernike_grid,
    fit_zernike_points,
    zernike_gradients,
    zernike_map,
    zernike_values,
)

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
        choice(order, "order", ("ansi", "noll", "fringe"))
        known = _numbered(terms, order) if type(terms) is int else _counted(terms, order)
        self.indices, self.nm, self.names = known
        self.order = order
        usual: Normalisation = "peak" if order == "fringe" else "rms"
        self.normalisation: Normalisation = usual if normalisation is None else normalisation
        choice(self.normalisation, "normalisation", ("rms", "peak"))
        self.radius = None if radius is None else positive(radius, "radius", dimension="length")
        self.units = dict.fromkeys(self.names, "m")
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
    def labels(self) -> dict[str, str]:
        """What opticians call each term, by parameter name."""
        return {k: term_name(n, m) for k, (n, m) in zip(self.names, self.nm, strict=True)}

    @property
    def spanned(self) -> frozenset[str]:
        held = {(0, 0): "piston", (1, 1): "tilt_x", (1, -1): "tilt_y"}
        return frozenset(word for nm, word in held.items() if nm in self.nm)

    def with_parameters(self, **values: float) -> Zernike:
        return self._copy(self._given({**self.parameters, **values}), self.radius)

    def _copy(self, values: tuple[float | None, ...], radius: float | None) -> Zernike:
        form = copy(self)
        form.radius, form._values = radius, values  # noqa: SLF001  # of this class
        return form

    @property
    def _has_domain(self) -> bool:
        return self.radius is not None

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
        u, v = (p.ravel() for p in self._on_disc(x, y))
        out, weights = np.empty(u.size), self._weights()
        for start in range(0, u.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            out[part] = weights @ zernike_values(u[part], v[part], self.nm)
        out[np.isnan(u)] = np.nan  # piston is 1 even there
        return out.reshape(x.shape)

    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
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
        u, v = self._on_disc(x, y)
        terms = zernike_values(u, v, self.nm) * self._norms.reshape(-1, *(1,) * u.ndim)
        return np.where(np.isnan(u), np.nan, terms)

    def fit_grid(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
        return self._fitted(
            fit_zernike_grid(z, x, y, self.nm, radius=self.radius, weights=weights)
        )

    def fit_list(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        xs, ys, zs = (np.asarray(v, dtype=np.float64) for v in (x, y, z))
        fit = self.fit_points(xs, ys, zs, weights=weights)
        return fit, zs - fit.form.height(xs, ys)

    def fit_map(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> tuple[LinearFit, FloatArray]:
        fit = self.fit_grid(x, y, z, weights=weights)
        form = cast("Zernike", fit.form)
        weights_of_terms = form._weights()  # noqa: SLF001  # another instance of this class
        ideal = zernike_map(x, y, self.nm, weights_of_terms, radius=form.radius or 1.0)
        np.subtract(np.asarray(z, dtype=np.float64), ideal, out=ideal)
        return fit, ideal

    def fit_points(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, *, weights: ArrayLike | None = None
    ) -> LinearFit:
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


# ---- numbers of Zernike terms: ANSI, Noll and Fringe, against radial order n and azimuthal order m ----
# A term is ``R_n^|m|(rho) cos(m theta)`` for m >= 0 and ``R_n^|m|(rho) sin(|m| theta)`` for m < 0,
# theta counted from +x towards +y. ANSI counts from 0, Noll and Fringe from 1.

ZernikeOrder = Literal["ansi", "noll", "fringe"]

_NAMES = {
    (0, 0): "piston",
    (1, 1): "tilt x",
    (1, -1): "tilt y",
    (2, 0): "defocus",
    (2, 2): "astigmatism 0 deg",
    (2, -2): "astigmatism 45 deg",
    (3, 1): "coma x",
    (3, -1): "coma y",
    (3, 3): "trefoil 0 deg",
    (3, -3): "trefoil 30 deg",
}

_FOILS = {2: "astigmatism", 3: "trefoil", 4: "tetrafoil", 5: "pentafoil", 6: "hexafoil"}

_RANKS = {1: "primary", 2: "secondary", 3: "tertiary", 4: "quaternary"}


_NUMBER_OF_TERM = """
    Parameters
    ----------
    n, m : int
        Radial order, azimuthal order.

    Returns
    -------
    int
        ANSI counts from 0, Noll and Fringe from 1.

    Raises
    ------
    DataError
        If there is no such term.
    """


def ansi_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of ANSI Z80.28 / ISO 24157 term j = 0, 1, 2, ...

    Parameters
    ----------
    j : int
        ``j = (n (n + 2) + m) / 2``, >= 0.

    Returns
    -------
    tuple of int
        Radial order n, azimuthal order m.

    Raises
    ------
    DataError
        If j is not a whole number >= 0.

    Examples
    --------
    >>> ansi_to_nm(12), ansi_to_nm(8), ansi_to_nm(3)
    ((4, 0), (3, 1), (2, -2))
    """
    j = count(j, "the number of an ANSI term", least=0)
    n = (isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


@documented(number_of_term=_NUMBER_OF_TERM)
def nm_to_ansi(n: int, m: int) -> int:
    """Return the ANSI number of a term.

    $number_of_term
    """
    n, m = _orders(n, m)
    return (n * (n + 2) + m) // 2


def noll_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of Noll term j = 1, 2, 3, ...

    Parameters
    ----------
    j : int
        Even for cosines, odd for sines, within an order by growing abs(m); >= 1.

    Returns
    -------
    tuple of int
        Radial order n, azimuthal order m.

    Raises
    ------
    DataError
        If j is not a whole number >= 1.

    References
    ----------
    .. [1] Noll, J. Opt. Soc. Am. 66 (1976) 207, Table I.

    Examples
    --------
    >>> noll_to_nm(11), noll_to_nm(8), noll_to_nm(5)
    ((4, 0), (3, 1), (2, -2))
    """
    j = count(j, "the number of a Noll term")
    n = (isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1
    m = place + 1 - (n + place + 1) % 2 if n % 2 else 2 * ((place + 1) // 2)
    return n, m if j % 2 == 0 else -m


@documented(number_of_term=_NUMBER_OF_TERM)
def nm_to_noll(n: int, m: int) -> int:
    """Return the Noll number of a term.

    $number_of_term
    """
    n, m = _orders(n, m)
    first = n * (n + 1) // 2 + 1
    return next(j for j in range(first, first + n + 1) if noll_to_nm(j) == (n, m))


def fringe_to_nm(j: int) -> tuple[int, int]:
    """Return (n, m) of Fringe (University of Arizona) term j = 1, 2, 3, ...

    Parameters
    ----------
    j : int
        By growing ``n + abs(m)``, then falling abs(m), cosine before sine; >= 1.

    Returns
    -------
    tuple of int
        Radial order n, azimuthal order m.

    Raises
    ------
    DataError
        If j is not a whole number >= 1.

    Notes
    -----
    The set of 37 of some programs is the terms 1 to 36 and, as 37, the spherical term (12, 0),
    which is 49 here.

    Examples
    --------
    >>> fringe_to_nm(9), fringe_to_nm(7), fringe_to_nm(6)
    ((4, 0), (3, 1), (2, -2))
    """
    j = count(j, "the number of a Fringe term")
    half = isqrt(j - 1)  # (n + |m|) / 2
    place = j - 1 - half * half
    m = half - place // 2
    return 2 * half - m, m if place % 2 == 0 else -m


@documented(number_of_term=_NUMBER_OF_TERM)
def nm_to_fringe(n: int, m: int) -> int:
    """Return the Fringe number of a term.

    $number_of_term
    """
    n, m = _orders(n, m)
    half = (n + abs(m)) // 2
    return half * half + 2 * (half - abs(m)) + (1 if m >= 0 else 2)


def to_nm(index: int, order: ZernikeOrder) -> tuple[int, int]:
    """Return (n, m) of a term in any of the three orders."""
    return _to_nm(order)(index)


def term_indices(terms: int | Sequence[int], order: ZernikeOrder) -> tuple[int, ...]:
    """Return the numbers of the first terms of an order, or the given ones, checked.

    Examples
    --------
    >>> term_indices(3, "noll")
    (1, 2, 3)
    """
    check = _to_nm(order)
    first = 0 if order == "ansi" else 1
    if isinstance(terms, int | np.integer) and not isinstance(terms, bool):
        indices = tuple(range(first, first + terms))
    else:
        try:
            indices = tuple(count(i, "a term", least=-sys.maxsize) for i in terms)  # type: ignore[union-attr]
        except TypeError:
            raise DataError(
                f"terms is a number of terms or a list of them, got {terms!r}"
            ) from None
    if not indices:
        raise DataError(f"terms must name at least one Zernike term, got {terms}")
    for index in indices:
        check(index)
    if len(set(indices)) != len(indices):
        raise DataError(f"a Zernike term occurs twice in {list(indices)}")
    return indices


def term_name(n: int, m: int) -> str:
    """Return what opticians call a term.

    Parameters
    ----------
    n, m : int
        Radial order, azimuthal order.

    Returns
    -------
    str
        Such as ``"coma x"``; ``"Z(7, 5)"`` where there is no common name.

    Raises
    ------
    DataError
        If there is no such term.

    Examples
    --------
    >>> term_name(4, 0), term_name(3, -1), term_name(6, 0)
    ('primary spherical', 'coma y', 'secondary spherical')
    """
    n, m = _orders(n, m)
    if (n, m) in _NAMES:
        return _NAMES[n, m]
    if m == 0 and n // 2 - 1 in _RANKS:
        return f"{_RANKS[n // 2 - 1]} spherical"
    rank = _RANKS.get((n - abs(m)) // 2 + (0 if abs(m) == 1 else 1))
    if abs(m) == 1 and rank is not None:
        return f"{rank} coma {'x' if m > 0 else 'y'}"
    base = _FOILS.get(abs(m))
    if base is None or rank is None:
        return f"Z({n}, {m})"
    angle = 0.0 if m > 0 else 90.0 / abs(m)
    prefix = "" if rank == "primary" else f"{rank} "
    return f"{prefix}{base} {angle:.4g} deg"


def _to_nm(order: str) -> Callable[[int], tuple[int, int]]:
    table = {"ansi": ansi_to_nm, "noll": noll_to_nm, "fringe": fringe_to_nm}
    return table[choice(order, "order", table)]


def _orders(n: int, m: int) -> tuple[int, int]:
    if int(n) != n or int(m) != m or n < 0 or abs(m) > n or (n - m) % 2:
        raise DataError(f"there is no Zernike term n = {n}, m = {m}: n - |m| must be even, >= 0")
    return int(n), int(m)
