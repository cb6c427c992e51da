"""Step height and groove depth after ISO 5436-1, types A1 (flat bottom) and A2 (round bottom), and steps.

A groove of width W has its middle at 0. Of A1 the line a x + b of the upper faces (W/2 + W/3 to 3W/2
from the middle) and the bottom (|x| <= W/6), h lower, are fitted together by least squares; what lies
between is not used, as edges are round. Of A2 the line goes through the outer ranges and a parabola
through the inner one; the depth is that of its vertex, its u that of line and parabola together.
Recalled from ISO 5436-1:2000, not read.

A step between two faces is not in that standard: of a band across its edge the outer thirds are fitted
together, one plane for both and the height of the second over the first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray, position
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.numbers import choice, positive, real
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms._correlated import estimated
from metrosep.forms.points import Points, points_of
from metrosep.spectral.dft import instance_of

__all__ = ["StepHeight", "step_between", "step_height"]

EDITION = "ISO 5436-1:2000 (recalled)"
_LEAST = 3
"""Samples in a range."""
_ROUNDING = 1e-9
"""Of a width: a sample on the end of a range belongs to it."""
_INNER = 1.0 / 6.0 + _ROUNDING
_LENGTHS = {"A1": 3.0, "A2": 3.0, "step": 1.0}
"""Of the band over the distance of its two points: a groove needs its own width on both sides."""

Kind = Literal["A1", "A2", "step"]


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
    kind : {"A1", "A2", "step"}
        Of the groove; "step" for the height of one face over another.
    n_missing : int, optional
        Samples of the ranges that were not measured.
    """

    height: float
    u: float
    dof: float
    slope: float
    n_used: int
    rms: float
    kind: Kind
    n_missing: int = 0

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
        how = f"{EDITION}, type {self.kind}"
        if self.kind == "step":
            what = "height of the second face over the first" if signed else "height of a step"
            how = "one plane for both faces"
        text = f"{what}, {how}, {self.n_used} samples"
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
    return _fitted(points, inner, outer, lambda x, y: ((x if across else y) / W, None), kind, W)


def step_between(
    surface: Surface,
    a: tuple[float | str, float | str],
    b: tuple[float | str, float | str],
    *,
    width: float | str,
    kind: Kind = "step",
) -> StepHeight:
    """Return the height of a step, or of a groove or ridge, across a band in any direction of a map.

    Parameters
    ----------
    surface : Surface
        Not filtered, with both lateral steps; NaN is left out.
    a, b : tuple of 2 floats (m) or str with unit
        Of a step: one on each of its faces, so that the edge lies in the middle third between them. Of
        a groove or ridge: its edges.
    width : float (m) or str with unit
        Of the band, along the edge.
    kind : {"step", "A1", "A2"}, optional
        A step; a groove with flat, or with round bottom.

    Returns
    -------
    StepHeight
        Height of b over a, or of the middle over the faces beside it, with u.

    Raises
    ------
    DataError
        If an option is unknown, a and b are the same point, or the map has no lateral step.
    TooFewSamplesError
        If a range holds fewer than 3 valid pixels.

    Notes
    -----
    With t along the line from a to b and s across it, from their middle: one least-squares fit of
    ``z = p + q t + r s + h delta`` to the pixels whose centre lies in the band. Of a step of length L
    delta is 0 for ``-L/2 <= t <= -L/6`` and 1 for ``L/6 <= t <= L/2``. A groove has the ranges of
    `step_height`, with W the distance of a and b.

    Examples
    --------
    >>> z = np.where(np.arange(80) >= 40, 25e-9, 0.0) + np.zeros((60, 1))
    >>> step_between(Surface(z, 1e-6, 1e-6), (9.5e-6, 3e-5), (69.5e-6, 3e-5), width="40 um").height
    2.5e-08
    """
    instance_of(surface, Surface, "a step height")
    choice(kind, "kind", tuple(_LENGTHS))
    if surface.dx is None or surface.dy is None:
        raise DataError("the surface has no lateral step in both axes: give Surface(z, dx, dy)")
    across = positive(width, "width", dimension="length")
    (ax, ay), (bx, by) = position(a, "a"), position(b, "b")
    L = float(np.hypot(bx - ax, by - ay))
    if not L > 0.0:
        raise DataError("a and b are the same point: a step has a face on either side")
    c, s = (bx - ax) / L, (by - ay) / L
    middle = ((ax + bx) / 2.0, (ay + by) / 2.0)
    points = points_of(
        _cut(surface, middle, _LENGTHS[kind] * L, across, (abs(c), abs(s))),
        centre=middle,
        middle=False,
    )

    def place(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (c * x + s * y) / L, (c * y - s * x) / L

    t, v = place(points.x[None, :], points.y[:, None])
    band = np.abs(v) <= 0.5 * across / L * (1.0 + _ROUNDING)
    if kind == "step":
        inner = band & (t >= 1.0 / 6.0 - _ROUNDING) & (t <= 0.5 + _ROUNDING)
        outer = band & (t <= -1.0 / 6.0 + _ROUNDING) & (t >= -0.5 - _ROUNDING)
        parts = [(outer, "face at a"), (inner, "face at b")]
    else:
        inner = band & (np.abs(t) <= _INNER)
        outer = band & (np.abs(t) >= 5.0 / 6.0 - _ROUNDING) & (np.abs(t) <= 1.5 + _ROUNDING)
        parts = [
            (outer & (t < 0), "face beside a"),
            (inner, "bottom"),
            (outer & (t > 0), "face beside b"),
        ]
    for part, name in parts:
        n = int((part & ~np.isnan(points.z)).sum())
        if n < _LEAST:
            raise TooFewSamplesError(
                f"the {name} holds {n} measured pixels, {_LEAST} are needed: the band of "
                f"{format_length(_LENGTHS[kind] * L)} by {format_length(across)} must lie on what was "
                "measured; move it, or make it wider"
            )
    return _fitted(points, inner, outer, place, kind, L)


def _cut(
    surface: Surface,
    middle: tuple[float, float],
    along: float,
    across: float,
    turn: tuple[float, float],
) -> Surface:
    """Return the part of a map around a band that is turned (cosine, sine), two pixels larger."""
    half = (turn[0] * along + turn[1] * across) / 2.0, (turn[1] * along + turn[0] * across) / 2.0
    slices, origin = [], []
    for k, step in enumerate((surface.dx, surface.dy)):
        assert step is not None  # noqa: S101
        n = surface.z.shape[1 - k]
        ends = [(middle[k] + sign * half[k] - surface.origin[k]) / step for sign in (-1, 1)]
        first = int(np.clip(np.floor(ends[0]) - 2, 0, n - 1))
        last = int(np.clip(np.ceil(ends[1]) + 3, first + 1, n))
        slices.append(slice(first, last))
        origin.append(surface.origin[k] + first * step)
    part = surface.z[slices[1], slices[0]]
    if np.isnan(part).all():
        raise TooFewSamplesError(
            "the band lies wholly outside of what was measured; move it onto the map"
        )
    return Surface(part, surface.dx, surface.dy, origin=(origin[0], origin[1]))


_Place = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray | None]]


def _fitted(
    points: Points, inner: BoolArray, outer: BoolArray, place: _Place, kind: Kind, W: float
) -> StepHeight:
    """Return the fit over the ranges; `place` gives t, and s where the faces may slope across too."""
    valid = ~np.isnan(points.z)
    used = (inner | outer) & valid
    level = float(np.median(points.z[used]))

    def columns(x: FloatArray, y: FloatArray) -> FloatArray:
        t, s = place(x, y)
        inside = ((t > 0.0) if kind == "step" else (np.abs(t) <= _INNER)).astype(np.float64)
        rows = [np.ones_like(t), t, inside]
        if (
            kind == "A2"
        ):  # a parabola that takes all that is there: the line is that of the outer ranges
            rows += [inside * t, inside * t * t]
        return np.stack(rows if s is None or not has_depth else [*rows, s])

    x, y = (
        np.broadcast_to(v, points.z.shape)[used] for v in (points.x[None, :], points.y[:, None])
    )
    s = place(x, y)[1]
    has_depth = s is not None and float(np.ptp(s)) > _ROUNDING
    basis = columns(x, y)
    coefficients = np.asarray(
        np.linalg.lstsq(basis.T, points.z[used] - level, rcond=None)[0], dtype=np.float64
    )
    residual = np.full(points.z.shape, np.nan)
    residual[used] = points.z[used] - level - coefficients @ basis
    height, slopes = _height_of(coefficients, kind)

    def linearise(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        return np.vstack([columns(x, y), z])

    found = estimated(points, linearise, residual, coefficients.size)
    u = float(np.sqrt(slopes @ found.cov @ slopes))
    rms = float(np.sqrt(np.mean(np.square(residual[used]))))
    slope = float(coefficients[1]) / W
    n, missing = int(used.sum()), int(((inner | outer) & ~valid).sum())
    return StepHeight(height, u, found.dof, slope, n, rms, kind, missing)


def _height_of(coefficients: FloatArray, kind: Kind) -> tuple[float, FloatArray]:
    """Return the height of the middle over the line, and its derivatives with the coefficients."""
    slopes = np.zeros(coefficients.size)
    slopes[2] = 1.0
    if kind != "A2":
        return float(coefficients[2]), slopes
    c0, c1, c2 = coefficients[2:5]
    if c2 == 0.0:
        raise DataError("the bottom is straight: a groove of type A2 has a round one, take A1")
    slopes[3:5] = -c1 / (2.0 * c2), c1 * c1 / (4.0 * c2 * c2)
    return float(c0 - c1 * c1 / (4.0 * c2)), slopes  # height of the vertex
