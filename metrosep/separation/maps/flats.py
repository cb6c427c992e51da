"""Three-flat tests: absolute flatness of three flats from their sums, two by two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import DataError
from metrosep.core.surface import Surface
from metrosep.forms.zernike import ZernikeOrder
from metrosep.separation._methods import described_by
from metrosep.separation.contract import Separation
from metrosep.separation.maps.flat_setup import FlatMethod, ThreeFlat

__all__ = ["ThreeFlat", "three_flat"]


@described_by(ThreeFlat, ThreeFlat.separate)
def three_flat(
    ab: ArrayLike | Surface,
    ac: ArrayLike | Surface,
    bc: ArrayLike | Surface,
    rotated: Sequence[ArrayLike | Surface] | ArrayLike | Surface = (),
    angles: ArrayLike = (),
    *,
    pairs: str | Sequence[str] = "AB",
    turned: Literal["first", "second"] = "first",
    flip: Literal["x", "y"] = "x",
    method: FlatMethod = "auto",
    terms: int | Sequence[int] = 66,
    order: ZernikeOrder = "ansi",
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    radius: float | None = None,
    removed: tuple[str, ...] = ("piston", "tilt"),
    u_reading: float | None = None,
    u_registration: ArrayLike = 0.0,
) -> Separation:
    """Return three flats from their sums two by two, and from readings with one flat turned.

    Parameters
    ----------
    ab, ac, bc : Surface or array_like, shape (n_y, n_x), m
        Sum of two flats; the second one is seen mirrored. NaN = not measured.
    rotated : Surface or array_like, or sequence of them, optional
        Further readings with a flat turned.
    method : {"auto", "pixel", "zernike", "iterative"}, optional
        By pixels (even and odd shares) or by Zernike terms, at once on the pixels that all readings
        have, or iterated on the pixels of each; see Notes.
    u_registration : float or array_like, shape (3 + n,) or (3 + n, 2), m, optional
        Standard uncertainty of the position of the flats to each other, for each reading, along x
        and y; it adds gradient times shift to `u`.

    Returns
    -------
    Separation
        ``.A``, ``.B``, ``.C``: maps as seen from the front of each flat, without what the null
        space lists. Nothing turned: NaN beside the diameter, with ``.diameter_A`` (n_y,) and the
        mirror-even shares ``.even_A``. By Zernike terms: ``.zernike_A`` with NaN for terms that
        are not determined, over ``coordinates["zernike_n"]`` and ``["zernike_m"]``.

    Notes
    -----
    The mirror-even shares e follow from three sums at every pixel, ``A_e = (AB + AC - BC)_e / 2``.
    Of the odd shares only differences show in AB, AC, BC: a common one is invisible, and A, B, C
    are known where it vanishes, on the diameter (x = 0), with ``u = s sqrt(3)/2``. A reading with A
    turned by t adds ``A_m (exp(-j m t) - 1)``: all angular orders but those with m t = 2 pi k.
    Of these only the odd share (sin m theta for even m, flip x) stays unknown; it is in the null
    space. Turns by 180 deg leave 2, 4, 6 ..., 90 deg 4, 8 ..., 54 deg 20, 40 ...

    Pixels: classes q = m mod N of orders are projected by turns of 2 pi/N and solved by least
    squares, which contains the even/odd method (180, 90, 45 deg) and N positions. A result pixel
    needs its turned and mirrored counterparts; turns other than 90 deg interpolate and lose about
    three pixels at the rim. Zernike: coefficients by least squares on the common pixels, all angles,
    one system for each order m. Iterative: readings are simulated from the terms, compared with the
    measured ones on the pixels of each, and the difference shared among the flats, until it is
    1e-13 of the start (conjugate gradients; the paper's fixed steps take hundreds). It needs no
    pixel in every reading beyond the 30 that align them; with one mask for all it is ``"zernike"``.

    References
    ----------
    Fritz, Opt. Eng. 23 (1984) 379-383. Ai and Wyant, Appl. Opt. 32 (1993) 4698-4705.
    Evans and Kestner, Appl. Opt. 35 (1996) 1015-1021. M. Vannoni, G. Molesini, Opt.
    Express 16 (2008) 340-354. U. Griesmann, Appl. Opt. 45 (2006) 5856-5865.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 65)
    >>> A, B, C = 9e-9 * x**3 * x[:, None], 5e-9 * (x**2 + x[:, None]), 7e-9 * x[:, None]**2 * x
    >>> F = np.fliplr
    >>> turned = np.rot90(A, -1) + F(B)
    >>> result = three_flat(A + F(B), A + F(C), B + F(C), turned, np.pi / 2)
    >>> result.null_space[0].indices[:3]
    (4, 8, 12)
    """
    turned_maps = _as_list(rotated)
    if not turned_maps and np.size(angles):
        raise DataError("three_flat: angles are given without rotated maps")
    setup = ThreeFlat(
        angles,  # type: ignore[arg-type]
        pairs,
        turned,
        flip,
        method,
        terms,  # type: ignore[arg-type]
        order,
        dx,
        dy,
        centre,
        radius,
        tuple(removed),
        u_registration,
    )
    maps: list[Any] = [ab, ac, bc, *turned_maps]
    return setup.separate(maps, u_reading=u_reading)


def _as_list(
    rotated: Sequence[ArrayLike | Surface] | ArrayLike | Surface,
) -> list[ArrayLike | Surface]:
    if isinstance(rotated, Surface) or (isinstance(rotated, np.ndarray) and rotated.ndim == 2):
        return [rotated]
    try:
        return list(rotated)  # type: ignore[arg-type]
    except TypeError:
        raise DataError(
            f"three_flat: rotated must be a map or a list of maps, got {type(rotated).__name__}"
        ) from None
