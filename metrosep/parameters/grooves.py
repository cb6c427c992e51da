"""Step height and groove depth after ISO 5436-1, types A1 (flat bottom) and A2 (round bottom).

A groove of width W has its middle at 0. Of A1 the line a x + b of the upper faces (W/2 + W/3 to 3W/2
from the middle) and the bottom (|x| <= W/6), h lower, are fitted together by least squares; what lies
between is not used, as edges are round. Of A2 the line goes through the outer ranges and a parabola
through the inner one; the depth is that of its vertex. Recalled from ISO 5436-1:2000, not read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import choice, positive, real
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.forms._correlated import estimated
from metrosep.forms.points import points_of
from metrosep.spectral.dft import instance_of

__all__ = ["StepHeight", "step_height"]

_LEAST = 3
"""Samples in a range."""
_ROUNDING = 1e-9
"""Of a width: a sample on the end of a range belongs to it."""
_INNER = 1.0 / 6.0 + _ROUNDING


@dataclass(frozen=True, slots=True, eq=False)
class StepHeight:
    """Depth of a groove, or height of a ridge.

    Parameters
    ----------
    height : float, m
        Of the middle over the faces beside it: negative for a groove.
    u : float, m
        Standard uncertainty from the correlation of the residual; NaN of A2.
    dof : float
        Its degrees of freedom.
    slope : float
        Of the faces.
    n_used : int
        Samples in the ranges.
    rms : float, m
        What the fit leaves in them.
    kind : {"A1", "A2"}
        Of the groove.
    """

    height: float
    u: float
    dof: float
    slope: float
    n_used: int
    rms: float
    kind: Literal["A1", "A2"]

    @property
    def depth(self) -> float:
        """Depth of the groove or height of the ridge, positive, m."""
        return abs(self.height)

    def to_quantity(self) -> Quantity:
        """Return the depth as a quantity.

        Returns
        -------
        Quantity
            Symbol d, with u where it is known.
        """
        u = None if np.isnan(self.u) else self.u
        text = f"depth after ISO 5436-1, type {self.kind} (recalled), {self.n_used} samples"
        return Quantity(self.depth, "m", text, u=u, symbol="d")


def step_height(
    obj: Profile | Surface,
    *,
    width: float | str,
    middle: float | str = 0.0,
    kind: Literal["A1", "A2"] = "A1",
    axis: Literal["x", "y"] = "x",
) -> StepHeight:
    """Return the depth of a groove, or the height of a ridge.

    Parameters
    ----------
    obj : Profile or Surface
        Not filtered; NaN is left out. Of a map the groove runs along the other axis.
    width : float (m) or str with unit
        W, of the groove.
    middle : float (m) or str with unit, optional
        Position of its middle.
    kind : {"A1", "A2"}, optional
        Flat or round bottom.
    axis : {"x", "y"}, optional
        Of a map: across the groove.

    Returns
    -------
    StepHeight
        Signed height, u, and what the fit rests on.

    Raises
    ------
    DataError
        If an option is unknown, `width` is not positive, or a map has no lateral step.
    TooFewSamplesError
        If a range holds fewer than 3 valid samples.

    Notes
    -----
    A1: ``z = a x + b + h delta`` with delta 1 for |x| <= W/6 and 0 for 5W/6 <= |x| <= 3W/2, one
    least-squares fit. That is the d of the standard, 2 |h'| with delta' = +-1.

    References
    ----------
    .. [1] ISO 5436-1:2000, 7.2 and 7.3 (recalled).

    Examples
    --------
    >>> x = np.arange(-150, 150.5, 0.5) * 1e-6
    >>> found = step_height(Profile(x, np.where(abs(x) < 45e-6, -1e-6, 0.0)), width="100 um")
    >>> f"{found.height * 1e6:.3f} um"
    '-1.000 um'
    """
    instance_of(obj, (Profile, Surface), "a step height")
    choice(kind, "kind", ("A1", "A2"))
    choice(axis, "axis", ("x", "y"))
    W = positive(width, "width", dimension="length")
    centre = real(middle, "middle", dimension="length")
    if isinstance(obj, Surface) and (obj.dx is None or obj.dy is None):
        raise DataError("the surface has no lateral step in both axes: give Surface(z, dx, dy)")
    across = axis == "x" or isinstance(obj, Profile)
    points = points_of(obj, centre=(centre, 0.0) if across else (0.0, centre), middle=False)
    t = points.x[None, :] if across else points.y[:, None]
    t = np.broadcast_to(t, points.z.shape) / W
    inner = np.abs(t) <= _INNER
    outer = (np.abs(t) >= 5.0 / 6.0 - _ROUNDING) & (np.abs(t) <= 1.5 + _ROUNDING)
    valid = ~np.isnan(points.z)
    for part, name in (
        (inner, "bottom"),
        (outer & (t < 0), "left face"),
        (outer & (t > 0), "right face"),
    ):
        if int((part & valid).sum()) < _LEAST:
            raise TooFewSamplesError(
                f"the {name} of the groove holds {int((part & valid).sum())} valid samples, "
                f"{_LEAST} are needed; check width and middle, or measure 3 widths"
            )
    used = (inner | outer) & valid
    level = float(np.median(points.z[used]))
    fit = _flat_bottom if kind == "A1" else _round_bottom
    columns, height = fit(t, inner, outer & valid, used, points.z - level)
    basis = columns(t[used], inner[used].astype(np.float64))
    coefficients = np.linalg.lstsq(basis.T, points.z[used] - level, rcond=None)[0]
    residual = np.full(points.z.shape, np.nan)
    residual[used] = points.z[used] - level - coefficients @ basis
    u, dof = np.nan, np.nan
    if kind == "A1":
        height = float(coefficients[2])

        def linearise(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
            s = (x if across else y) / W
            return np.vstack([columns(s, (np.abs(s) <= _INNER).astype(np.float64)), z])

        found = estimated(points, linearise, residual, 3)
        u, dof = float(np.sqrt(found.cov[2, 2])), found.dof
    rms = float(np.sqrt(np.mean(np.square(residual[used]))))
    slope = float(coefficients[1]) / W
    return StepHeight(height, u, dof, slope, int(used.sum()), rms, kind)


Columns = Callable[[FloatArray, FloatArray], FloatArray]


def _flat_bottom(*_: object) -> tuple[Columns, float]:
    """Return the columns of line and step; the height is the third coefficient."""
    return lambda s, inside: np.stack([np.ones_like(s), s, inside]), np.nan


def _round_bottom(
    t: FloatArray, inner: BoolArray, outer: BoolArray, used: BoolArray, z: FloatArray
) -> tuple[Columns, float]:
    """Return the columns of line and parabola, and the height of the vertex over the line."""
    line = np.polynomial.polynomial.polyfit(t[outer], z[outer], 1)
    bottom = inner & used
    c0, c1, c2 = np.polynomial.polynomial.polyfit(
        t[bottom], z[bottom] - line[0] - line[1] * t[bottom], 2
    )
    if c2 == 0.0:
        raise DataError("the bottom is straight: a groove of type A2 has a round one, take A1")
    columns: Columns = lambda s, inside: np.stack(  # noqa: E731
        [np.ones_like(s), s, inside, inside * s, inside * s * s]
    )
    return columns, float(c0 - c1 * c1 / (4.0 * c2))
