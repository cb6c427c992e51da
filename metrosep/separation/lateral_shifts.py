"""Shift-rotation test: part and instrument from lateral shifts and turns, jointly in Zernike terms."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from metrosep.core.surface import Surface
from metrosep.separation._map_input import (
    checked_angles,
    map_stack,
)
from metrosep.separation.contract import Separation
from metrosep.separation.shift_setup import ShiftRotation

__all__ = ["ShiftRotation", "shift_rotation"]


def shift_rotation(
    surfaces: Sequence[ArrayLike | Surface],
    angles: ArrayLike,
    shifts: ArrayLike,
    *,
    terms: int = 28,
    dx: float | None = None,
    dy: float | None = None,
    centre: tuple[float, float] | None = None,
    power: tuple[float, float] | None = None,
    u_reading: float | None = None,
) -> Separation:
    """Return part and instrument from maps of the part shifted and turned.

    Parameters
    ----------
    surfaces : sequence of Surface or array_like, shape (n_y, n_x), m
        One map for each position.
    angles : array_like, shape (n,), rad
        Turn of the part, counter-clockwise in the map.
    shifts : array_like, shape (n, 2), m
        Shift of the part along x and y, after the turn.
    terms : int, optional
        ANSI Zernike terms of each part; 28 hold all up to the radial order 6.
    dx, dy : float, m, optional
        Steps of plain arrays; pixels if omitted.
    centre : tuple of (float, float), m, optional
        Axis of rotation from pixel [0, 0].
    power : tuple of (float, float), m, optional
        Known power of the part (coefficient of ``2 r**2 - 1``) and its standard uncertainty.
    u_reading : float, m, optional
        Standard uncertainty of one pixel; from redundancy if omitted.

    Returns
    -------
    Separation
        ``.part``, ``.instrument`` over the common pixels without the terms of the null space, and
        ``.zernike_part``, ``.zernike_instrument`` with NaN for those.

    Raises
    ------
    DataError, InvalidSamplesError, TooFewSamplesError
        If maps, angles or shifts cannot be used.
    NotSeparableError
        If the part was neither turned nor shifted.
    DegenerateFitError
        If the pixels do not determine the Zernike terms.

    Notes
    -----
    All terms of part and instrument and a plane for each reading are fitted at once. Tilt is free in
    each reading, so all second-order terms of a merely shifted part are seen by nothing but planes:
    power and astigmatism are lost with shifts alone; turns bring back the astigmatism (unless all
    are by 180 degrees), power never: state it. Noise grows as radius/shift for third order, and its
    square for higher ones that turns do not show; ``audit["condition"]`` and `u` show it.

    References
    ----------
    D. Su, E. Miyashiro, R. E. Parks, Opt. Eng. 51 (2012) 013604 (shift-rotation absolute testing).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 41)
    >>> P, I = (lambda x, y: 9e-9 * x**3), (lambda x, y: 5e-9 * x * y**2)
    >>> y = x[:, None]
    >>> maps = [I(x, y) + P(x, y), I(x, y) + P(x - 0.2, y), I(x, y) + P(y, -x)]
    >>> result = shift_rotation(maps, [0, 0, np.pi / 2], [[0, 0], [0.2, 0], [0, 0]], dx=0.05)
    >>> [i.indices for i in result.null_space if "defocus" in i.indices]
    [('defocus',), ('defocus',)]
    """
    stack, grid, history = map_stack(
        surfaces, what="shift_rotation", least=2, one_frame=True, dx=dx, dy=dy, centre=centre
    )
    method = ShiftRotation(
        tuple(checked_angles(angles, stack.shape[0], "shift_rotation").tolist()),
        shifts,  # type: ignore[arg-type]
        terms,
        grid.dx if grid.calibrated else None,
        grid.dy if grid.calibrated else None,
        centre,
        power,
    )
    return method.separate(stack, u_reading=u_reading, history=history)
