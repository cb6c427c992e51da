"""The sphere."""

from __future__ import annotations

from dataclasses import dataclass

from metrosep.forms.conic import _Revolution

__all__ = ["Sphere"]


@dataclass(frozen=True, repr=False)
class Sphere(_Revolution):
    """A sphere that touches the plane z = 0 at the origin.

    Parameters
    ----------
    R : float or None, m
        Radius, not zero and finite; > 0 for a concave part (it opens towards +z), < 0 for a
        convex one. None: not known, a fit finds it.

    Raises
    ------
    DataError
        If R is zero or not finite.

    Notes
    -----
    ``z = (r^2/R) / (1 + sqrt(1 - (r/R)^2))``, which keeps all digits of a nearly flat part. NaN
    beyond ``r = |R|``; slopes and the derivative also on it, where they are infinite.

    Examples
    --------
    Points of the circle with the sides 3, 4, 5:

    >>> round(Sphere(R=5e-3)(3e-3).item(), 15)
    0.001
    """

    R: float | None = None

    name = "sphere"
    k = 0.0
    units = {"R": "m"}  # noqa: RUF012

