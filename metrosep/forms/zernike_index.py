"""Numbers of Zernike terms: ANSI, Noll and Fringe, against radial order n and azimuthal order m.

A term is ``R_n^|m|(rho) cos(m theta)`` for m >= 0 and ``R_n^|m|(rho) sin(|m| theta)`` for m < 0,
theta counted from +x towards +y. ANSI counts from 0, Noll and Fringe from 1.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from math import isqrt
from typing import Literal

from metrosep.core.errors import DataError

__all__ = [
    "ZernikeOrder",
    "ansi_to_nm",
    "fringe_to_nm",
    "nm_to_ansi",
    "nm_to_fringe",
    "nm_to_noll",
    "noll_to_nm",
    "term_indices",
    "term_name",
    "to_nm",
]

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
    j = _whole(j, "ansi", 0)
    n = (isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def nm_to_ansi(n: int, m: int) -> int:
    """Return the ANSI number of a term.

    Parameters
    ----------
    n, m : int
        Radial order, azimuthal order.

    Returns
    -------
    int
        From 0.

    Raises
    ------
    DataError
        If there is no such term.
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
    j = _whole(j, "noll", 1)
    n = (isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1
    m = place + 1 - (n + place + 1) % 2 if n % 2 else 2 * ((place + 1) // 2)
    return n, m if j % 2 == 0 else -m


def nm_to_noll(n: int, m: int) -> int:
    """Return the Noll number of a term.

    Parameters
    ----------
    n, m : int
        Radial order, azimuthal order.

    Returns
    -------
    int
        From 1.

    Raises
    ------
    DataError
        If there is no such term.
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
    j = _whole(j, "fringe", 1)
    half = isqrt(j - 1)  # (n + |m|) / 2
    place = j - 1 - half * half
    m = half - place // 2
    return 2 * half - m, m if place % 2 == 0 else -m


def nm_to_fringe(n: int, m: int) -> int:
    """Return the Fringe number of a term.

    Parameters
    ----------
    n, m : int
        Radial order, azimuthal order.

    Returns
    -------
    int
        From 1.

    Raises
    ------
    DataError
        If there is no such term.
    """
    n, m = _orders(n, m)
    half = (n + abs(m)) // 2
    return half * half + 2 * (half - abs(m)) + (1 if m >= 0 else 2)


def to_nm(index: int, order: ZernikeOrder) -> tuple[int, int]:
    """Return (n, m) of a term in any of the three orders."""
    return _to_nm(order)(index)


def _number_of(number: object) -> int:
    if isinstance(number, bool):
        raise TypeError("a truth value is no number")
    return operator.index(number)  # type: ignore[arg-type]


def term_indices(terms: int | Sequence[int], order: ZernikeOrder) -> tuple[int, ...]:
    """Return the numbers of the first terms of an order, or the given ones, checked.

    Examples
    --------
    >>> term_indices(3, "noll")
    (1, 2, 3)
    """
    check = _to_nm(order)
    first = 0 if order == "ansi" else 1
    if isinstance(terms, int) and not isinstance(terms, bool):
        indices = tuple(range(first, first + terms))
    else:
        try:
            indices = tuple(_number_of(i) for i in terms)  # type: ignore[union-attr]
        except TypeError:
            raise DataError(
                f"terms is a number of terms or a list of them, got {terms!r}"
            ) from None
    if not indices:
        raise DataError(f"terms must name at least one Zernike term, got {terms}")
    for index in indices:
        check(index)
    indices = tuple(int(i) for i in indices)
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
    if order not in table:
        raise DataError(f"order must be one of {', '.join(table)}, got {order!r}")
    return table[order]


def _whole(j: int, order: str, first: int) -> int:
    if isinstance(j, bool) or int(j) != j or j < first:
        raise DataError(f"{order} terms are whole numbers from {first}, got {j}")
    return int(j)


def _orders(n: int, m: int) -> tuple[int, int]:
    if int(n) != n or int(m) != m or n < 0 or abs(m) > n or (n - m) % 2:
        raise DataError(f"there is no Zernike term n = {n}, m = {m}: n - |m| must be even, >= 0")
    return int(n), int(m)
