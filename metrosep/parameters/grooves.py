"""Step height and groove depth after ISO 5436-1, types A1 (flat bottom) and A2 (round bottom).

A groove of width W has its middle at 0. Of A1 the line a x + b of the upper faces (W/2 + W/3 to 3W/2
from the middle) and the bottom (|x| <= W/6), h lower, are fitted together by least squares; what lies
between is not used, as edges are round. Of A2 the line goes through the outer ranges and a parabola
through the inner one; the depth is that of its vertex, its u that of line and parabola together.
Recalled from ISO 5436-1:2000, not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import choice, positive, real
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms._correlated import estimated
from metrosep.forms.points import points_of
from metrosep.spectral.dft import instance_of

__all__ = ["StepHeight", "step_height"]

EDITION = "ISO 5436-1:2000 (recalled)"
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
        Standard uncertainty from the correlation of the residual.
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

    def to_quantity(self, *, signed: bool = False) -> Quantity:
        """Return the depth as a quantity.

        Parameters
        ----------
        signed : bool, optional
            The height with its sign, symbol h, instead of the depth d.

        Returns
        -------
        Quantity
            With u and its degrees of freedom where they are known.
        """
        known = bool(np.isfinite(self.u) and np.isfinite(self.dof))
        what = "depth of a groove" if self.height < 0.0 else "height of a ridge"
        if signed:
            what = "height of the middle over the faces beside it, negative for a groove"
        text = f"{what}, {EDITION}, type {self.kind}, {self.n_used} samples"
        return Quantity(
            self.height if signed else self.depth, "m", text,
            u=self.u if known else None, symbol="h" if signed else "d",
            dof=self.dof if known else None, u_source="fit residual",
        )  # fmt: skip


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
    A1: ``z = a x + b + h delta`` with delta 1 for ``|x| <= W/6`` and 0 for ``5W/6 <= |x| <= 3W/2``, one
    least-squares fit. That is the d of the standard, ``2 |h'|`` with delta' = +-1.

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
            along = (points.x if across else points.y) + points.centre[0 if across else 1]
            raise TooFewSamplesError(
                f"the {name} of the groove holds {int((part & valid).sum())} valid samples, {_LEAST} "
                f"are needed: the data reach from {format_length(float(along.min()))} to "
                f"{format_length(float(along.max()))}, the middle is at {format_length(centre)} and "
                f"width is {format_length(W)}; give the middle=... of the groove, or measure 3 widths"
            )
    used = (inner | outer) & valid
    level = float(np.median(points.z[used]))
    columns = _flat_bottom if kind == "A1" else _round_bottom
    basis = columns(t[used], inner[used].astype(np.float64))
    coefficients = np.asarray(
        np.linalg.lstsq(basis.T, points.z[used] - level, rcond=None)[0], dtype=np.float64
    )
    residual = np.full(points.z.shape, np.nan)
    residual[used] = points.z[used] - level - coefficients @ basis
    height, slopes = _height_of(coefficients)

    def linearise(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        s = (x if across else y) / W
        return np.vstack([columns(s, (np.abs(s) <= _INNER).astype(np.float64)), z])

    found = estimated(points, linearise, residual, coefficients.size)
    u = float(np.sqrt(slopes @ found.cov @ slopes))
    rms = float(np.sqrt(np.mean(np.square(residual[used]))))
    slope = float(coefficients[1]) / W
    return StepHeight(height, u, found.dof, slope, int(used.sum()), rms, kind)


def _flat_bottom(s: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the columns of a line and of a step in the middle."""
    return np.stack([np.ones_like(s), s, inside])


def _round_bottom(s: FloatArray, inside: FloatArray) -> FloatArray:
    """Return the columns of a line and of a parabola in the middle, which takes all that is there.

    So the line is that of the outer ranges alone.
    """
    return np.stack([np.ones_like(s), s, inside, inside * s, inside * s * s])


def _height_of(coefficients: FloatArray) -> tuple[float, FloatArray]:
    """Return the height of the middle over the line, and its derivatives with the coefficients."""
    slopes = np.zeros(coefficients.size)
    slopes[2] = 1.0
    if coefficients.size == 3:
        return float(coefficients[2]), slopes
    c0, c1, c2 = coefficients[2:]
    if c2 == 0.0:
        raise DataError("the bottom is straight: a groove of type A2 has a round one, take A1")
    slopes[3:] = -c1 / (2.0 * c2), c1 * c1 / (4.0 * c2 * c2)
    return float(c0 - c1 * c1 / (4.0 * c2)), slopes  # height of the vertex
