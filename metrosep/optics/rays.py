"""Optical path of a plane wave that meets a surface along its axis, by ray tracing.

A ray along the axis meets the surface at (x, y, z); its path is counted to the plane z = 0 that
touches the vertex, along the ray as it really leaves. The path difference W is positive where the
material is high: a mirror sends the wave ahead there, and a wave that leaves a denser material
(n > 1) lags there, by ``(n - 1) z`` at small slopes. To keep one sign for both, W is the lead of a
reflected and the lag of a refracted wave.

Source: Micromachines 11 (2020) 331, sections 3.2 and 3.3, which name the method and no formula.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray, as_float, is_frozen
from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.core.numbers import between, choice, real

Mode = Literal["reflect", "refract"]
Side = Literal["inside", "outside"]

_STEEPEST = 1e70
"""Slopes are cut there, so that the fill values of a file are refused as too steep, not overflow."""

_MOST_INDEX = 10.0
"""A refractive index beyond this is a mistake of units or of columns."""


def path_difference(
    z: ArrayLike,
    slope_x: ArrayLike,
    slope_y: ArrayLike,
    *,
    mode: Mode = "reflect",
    n: float | None = None,
    side: Side = "inside",
) -> FloatArray:
    """Return the optical path difference of each ray against a flat at z = 0.

    Parameters
    ----------
    z : array_like, m
        Heights from the vertex plane, out of the material; NaN where not known.
    slope_x, slope_y : array_like
        dz/dx and dz/dy there, of the shape of z.
    mode : {"reflect", "refract"}, optional
        Whether the surface is a mirror or a boundary of glass.
    n : float, optional
        Refractive index of the material; needed to refract, and only then.
    side : {"inside", "outside"}, optional
        Where the light comes from when refracted: out of the material, or into it.

    Returns
    -------
    ndarray, m, shape of z
        Positive where the material is high (see the module); NaN where an input is.

    Raises
    ------
    DataError
        If the mode, the side or the index is not one that can be used.
    InvalidSamplesError
        If shapes differ, an input does not hold finite real numbers (NaN is allowed), or a slope is
        so steep that the ray never comes back to the plane.

    Notes
    -----
    With ``g = (dz/dx)^2 + (dz/dy)^2``: reflected ``W = 2 z / (1 - g)``. Refracted from inside
    ``W = (n - 1 / t) z`` with ``t = n s^2 + c sqrt(1 - n^2 s^2)``, ``s^2 = g / (1 + g)`` and
    ``c^2 = 1 - s^2``: the cosine of the leaving ray to the axis. From outside n becomes 1 / n and the
    result is scaled by -n. The path is that of the ray at its own point of the surface. A height
    that does not count from the vertex plane is not a mere piston: an offset c changes W by
    ``2 c / (1 - g)``, whose part ``2 c g`` looks like defocus.

    Examples
    --------
    >>> path_difference(1e-6, 0.0, 0.0).item()
    2e-06
    >>> round(path_difference(1e-6, 0.0, 0.0, mode="refract", n=1.5).item() * 1e6, 9)
    0.5
    """
    heights, square = _checked(z, slope_x, slope_y)
    index = check_mode(mode, n, side)
    if index is None:
        out: FloatArray = 2.0 * heights / _room(1.0 - square, square, "reflected back")
        return out
    factor, m = (1.0, index) if side == "inside" else (-index, 1.0 / index)
    cosine, _ = _leaving(square, m)
    out = factor * (m - 1.0 / cosine) * heights
    return out


def path_sensitivity(
    z: ArrayLike,
    slope_x: ArrayLike,
    slope_y: ArrayLike,
    *,
    mode: Mode = "reflect",
    n: float | None = None,
    side: Side = "inside",
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of the path difference by height and by both slopes.

    Parameters
    ----------
    z : array_like, m
        Heights.
    slope_x, slope_y : array_like
        Slopes, of the shape of z.
    mode, n, side : optional
        As of `path_difference`.

    Returns
    -------
    by_height : ndarray, m/m
        dW/dz.
    by_slope_x, by_slope_y : ndarray, m
        dW per unit of slope.

    Raises
    ------
    DataError
        If the mode, the side or the index is not one that can be used.
    InvalidSamplesError
        If shapes differ, an input does not hold finite real numbers (NaN is allowed), or a slope is
        too steep.

    Notes
    -----
    A small change d(x, y) of the form changes the wave by ``W_z d + W_p dd/dx + W_q dd/dy``: the
    rays tilt with the surface, which ``2 d`` alone would miss. NaN where an input is.

    Examples
    --------
    >>> by_height, by_slope_x, _ = path_sensitivity(1e-3, 0.1, 0.0)
    >>> round(by_height.item(), 6), round(by_slope_x.item() * 1e3, 6)  # mm per unit of slope
    (2.020202, 0.408122)
    """
    heights, square = _checked(z, slope_x, slope_y)
    index = check_mode(mode, n, side)
    p, q = real_array(slope_x, "slope_x", "m/m"), real_array(slope_y, "slope_y", "m/m")
    if index is None:
        room = _room(1.0 - square, square, "reflected back")
        by_height, by_square = 2.0 / room, 2.0 * heights / room**2
    else:
        factor, m = (1.0, index) if side == "inside" else (-index, 1.0 / index)
        cosine, change = _leaving(square, m)
        by_height = factor * (m - 1.0 / cosine)
        by_square = factor * heights * change / cosine**2
    return by_height, 2.0 * p * by_square, 2.0 * q * by_square


def check_mode(mode: str, n: float | None, side: str = "inside") -> float | None:
    """Return the refractive index, None for a mirror, or refuse the arguments."""
    choice(mode, "mode", ("reflect", "refract"))
    choice(side, "side", ("inside", "outside"))
    if mode == "reflect":
        if n is not None:
            raise DataError(f'a mirror has no refractive index; drop n={n} or say mode="refract"')
        return None
    if n is None:
        raise DataError(
            'mode="refract" needs the refractive index n of the material, such as 1.49'
        )
    index = real(n, "the refractive index n", finite=False)
    if not 1.0 < index <= _MOST_INDEX:
        raise DataError(
            f"the refractive index n must be a number above 1 and up to {_MOST_INDEX:g}, got {n!r}"
        )
    return index


def _checked(
    z: ArrayLike, slope_x: ArrayLike, slope_y: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return heights and squared slopes."""
    heights = real_array(z, "z")
    p, q = real_array(slope_x, "slope_x", "m/m"), real_array(slope_y, "slope_y", "m/m")
    if not heights.shape == p.shape == q.shape:
        raise InvalidSamplesError(
            f"z, slope_x and slope_y must have one shape, got {heights.shape}, {p.shape} and "
            f"{q.shape}"
        )
    square: FloatArray = np.minimum(np.hypot(p, q), _STEEPEST) ** 2
    return heights, square


def _leaving(square: FloatArray, m: float) -> tuple[FloatArray, FloatArray]:
    """Return the cosine of the refracted ray to the axis, and its derivative by squared slope."""
    s2 = square / (1.0 + square)
    inner = _room(1.0 - m * m * s2, square, "refracted: it is totally reflected")
    c, ct = 1.0 / np.sqrt(1.0 + square), np.sqrt(inner)
    cosine = m * s2 + c * ct
    per = 1.0 / (1.0 + square) ** 2
    change = m * per - 0.5 * c * m * m * per / ct - 0.5 * ct * c**3
    return _room(cosine, square, "refracted towards the plane"), change


def _room(value: FloatArray, square: FloatArray, what: str) -> FloatArray:
    """Return the value where it is positive or NaN; refuse a ray that never arrives."""
    bad = value <= 0.0
    if bad.any():
        steepest = float(np.degrees(np.arctan(np.sqrt(np.nanmax(square)))))
        raise InvalidSamplesError(
            f"{int(bad.sum())} of {bad.size} rays are not {what}; the surface is up to "
            f"{steepest:.1f} deg steep: crop it to a smaller aperture, or check that heights "
            "and steps are in metres"
        )
    return value


# ---- private checks on what a caller gives: numbers, pairs and arrays of real numbers ----------

WAVELENGTHS = (1e-8, 1e-2)
"""m: from the extreme ultraviolet to microwaves; beyond lie nanometres or micrometres taken as m."""


def wavelength_of(value: object) -> float:
    """Return a wavelength of light in m."""
    why = "633 nm is 633e-9"
    return between(value, "wavelength", *WAVELENGTHS, dimension="length", why=why)


def real_array(values: Any, name: str, unit: str = "m") -> FloatArray:
    """Return a float64 copy; NaN and masked are kept as NaN, anything but real numbers is refused."""
    try:
        kind = np.asanyarray(values).dtype
        array = as_float(values) if kind.kind in "iuf" else None
    except (TypeError, ValueError):  # rows of unequal length
        kind, array = np.dtype(object), None
    if array is None:
        raise InvalidSamplesError(
            f"{name} must hold real numbers in {unit}, NaN where nothing is known; got "
            f"{type(values).__name__} of {kind}"
        )
    if np.isinf(array).any():
        raise InvalidSamplesError(
            f"{name} is infinite at index {tuple(int(i) for i in np.argwhere(np.isinf(array))[0])}; "
            "write NaN where nothing is known"
        )
    return array


def freeze_fields(obj: object, *names: str) -> None:
    """Make fields arrays that cannot be written to; one that nobody can write to is taken as it is."""
    for name in names:
        values = getattr(obj, name)
        if not (is_frozen(values) and type(values) is np.ndarray) or np.isinf(values).any():
            values = np.ascontiguousarray(real_array(values, name))
            values.setflags(write=False)
        object.__setattr__(obj, name, values)
