"""Polynomials by the name of their basis: Legendre, Chebyshev, XY."""

from __future__ import annotations

from typing import Any

from metrosep.forms.moments import Kind
from metrosep.forms.polynomial import Polynomial

__all__ = ["XY", "Chebyshev", "Legendre"]


def Legendre(  # noqa: N802  # a form, though made by a function
    degree: int, *, kind: Kind = "total", **options: Any
) -> Polynomial:
    """Return a polynomial in Legendre polynomials on a scaled domain.

    Parameters
    ----------
    degree : int
        Highest degree, 0 to 40.
    kind : {"total", "tensor"}, optional
        Terms with ``i + j <= degree``, or with each of i and j ``<= degree``.
    **options : object
        Of `Polynomial`.

    Returns
    -------
    Polynomial
        With parameters ``L_i_j``.
    """
    return Polynomial(degree, kind=kind, basis="legendre", **options)


def Chebyshev(  # noqa: N802  # a form, though made by a function
    degree: int, *, kind: Kind = "total", **options: Any
) -> Polynomial:
    """Return a polynomial in Chebyshev polynomials of the first kind on a scaled domain.

    Parameters
    ----------
    degree : int
        Highest degree, 0 to 40.
    kind : {"total", "tensor"}, optional
        Terms with ``i + j <= degree``, or with each of i and j ``<= degree``.
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
