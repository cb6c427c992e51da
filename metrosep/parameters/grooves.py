"""Step height and groove depth after ISO 5436-1, types A1 (flat bottom) and A2 (round bottom), and steps.

A groove of width W has its middle at 0. Of A1 the line a x + b of the upper faces (W/2 + W/3 to 3W/2
from the middle) and the bottom (|x| <= W/6), h lower, are fitted together by least squares; what lies
between is not used, as edges are round. Of A2 the line goes through the outer ranges and a parabola
through the inner one; the depth is that of its vertex, its u that of line and parabola together.
A bow k x^2 of the faces shifts the depth of A1 by 25/18 k W^2; with ``degree=2`` it is fitted as well.
Between two regions of a map z = a + b x + c y + d is fitted together, d in the upper region only: the plane is
that of both. Of a band across an edge the outer thirds are such regions. A1 and A2 are recalled from
ISO 5436-1:2000, not read; steps between regions are not in that standard.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from metrosep.core._arrays import BoolArray, FloatArray, lateral, place
from metrosep.core.errors import DataError, OptionError, TooFewSamplesError
from metrosep.core.numbers import choice, positive, real, without_rounding
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.regions import check_region, in_pixels, needs_scale, within_region
from metrosep.core.surface import Surface
from metrosep.core.units import Pixels, format_length
from metrosep.forms._correlated import estimated
from metrosep.forms.points import Points, points_of
from metrosep.spectral.dft import instance_of

EDITION = "ISO 5436-1:2000 (recalled)"
_LEAST, _LEAST_OF_REGION = 3, 10
"""Samples in a range of a groove, and in a region of a map."""
_BOWED = 0.01
"""Of a height: a bow of the faces that shifts it by more is reported."""
_ROUNDING = 1e-9
"""Of a width: a sample on the end of a range belongs to it."""
_MOST_ROWS = 1_000_000
"""Of a band beyond the map whose pixels are counted one by one; of a larger one its area is taken."""
_INNER = 1.0 / 6.0 + _ROUNDING
_LENGTHS = {"A1": 3.0, "A2": 3.0, "step": 1.0}
"""Of the band over the distance of its two points: a groove needs its own width on both sides."""

Columns = Callable[[FloatArray, FloatArray, bool], FloatArray]
"""Columns of a fit at some positions, with or without a bow of the faces; the third is that of the step."""


@dataclass(frozen=True, slots=True, eq=False)
class StepHeight:
    """Depth of a groove, or height of a ridge.

    Parameters
    ----------
    height : float, m
        Of the middle over the faces beside it, or of the upper region over the lower one: negative for
        a groove.
    u : float, m
        Standard uncertainty from the correlation of the residual.
    dof : float
        Its degrees of freedom.
    slope : float
        Of the faces, in the middle of a groove; of two regions the largest slope of their plane.
    n_used : int
        Samples in the ranges.
    rms : float, m
        What the fit leaves in them.
    kind : {"A1", "A2", "step", "regions"}
        Of the groove; "step" across an edge, or between two regions.
    bow : float, m
        By how much a bow of the faces moves the height of a straight fit; 0 where ``degree=2`` fitted it, or
        where the samples cannot tell it.
    n_missing : int, optional
        Samples of the ranges that were not measured; of `step_between` also those that lie beyond the map.
    """

    height: float
    u: float
    dof: float
    slope: float
    n_used: int
    rms: float
    kind: Literal["A1", "A2", "step", "regions"]
    bow: float = 0.0
    n_missing: int = 0

    @property
    def messages(self) -> tuple[str, ...]:
        """What a reader has to know: a bow of the faces that shifts the height by more than 1 %."""
        if abs(self.bow) <= max(_BOWED * abs(self.height), self.u if np.isfinite(self.u) else 0.0):
            return ()
        return (
            f"the faces are bowed, which moves the height by {format_length(self.bow)}: take degree = 2",
        )

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
        if self.kind in ("step", "regions"):
            faces = {"step": ("second face", "first"), "regions": ("upper region", "lower one")}
            what = "height of the {} over the {}".format(*faces[self.kind])
            what, how = what + ("" if signed else ", absolute"), "one plane for both"
        return Quantity(
            self.height if signed else self.depth, "m", f"{what}, {how}",
            u=self.u if known else None, symbol="h" if signed else "d",
            dof=self.dof if known else None, u_source="fit residual",
        )  # fmt: skip


def step_height(
    obj: Profile | Surface,
    *,
    width: float | str | None = None,
    middle: float | str = 0.0,
    kind: Literal["A1", "A2"] = "A1",
    axis: Literal["x", "y"] = "x",
    degree: int = 1,
    upper: Mapping[str, Any] | BoolArray | None = None,
    lower: Mapping[str, Any] | BoolArray | None = None,
) -> StepHeight:
    """Return the depth of a groove, the height of a ridge, or of one region of a map over another.

    Parameters
    ----------
    obj : Profile or Surface
        Not filtered; NaN is omitted. Of a map the groove runs along the other axis.
    width : float (m) or str with unit, optional
        W, of the groove; needed without `upper` and `lower`. Of a map also in its pixels, "40 px".
    middle : float (m) or str with unit, optional
        Position of its middle; in pixels where `width` is.
    kind : {"A1", "A2"}, optional
        Flat or round bottom.
    axis : {"x", "y"}, optional
        Of a map: across the groove.
    degree : {1, 2}, optional
        Faces that are straight, or bowed.
    upper, lower : mapping or array_like of bool, shape of the map, optional
        Regions whose difference is wanted, upper minus lower: as an aperture,
        ``{"shape": "rectangle", "width": "2 mm", "height": "1 mm", "centre": ("5 mm", "3 mm")}``, in
        lengths or in px, or the pixels themselves.

    Returns
    -------
    StepHeight
        Signed height, u, and what the fit rests on.

    Raises
    ------
    DataError
        If an option is unknown, `width` is not positive, a region is wrong or both overlap, or a map without
        lateral step is given lengths.
    OptionError
        If neither `width` nor both regions are given, or both are.
    TooFewSamplesError
        If a range holds fewer than 3 valid samples, or a region fewer than 10.

    Notes
    -----
    A1: ``z = a x + b + h delta`` with delta 1 for ``|x| <= W/6`` and 0 for ``5W/6 <= |x| <= 3W/2``, one
    least-squares fit. That is the d of the standard, ``2 |h'|`` with delta' = +-1. Two regions:
    ``z = a + b x + c y + d delta`` with delta 1 in the upper one. ``degree=2`` adds x^2, and x y and y^2
    of a plane.

    References
    ----------
    .. [1] ISO 5436-1:2000, 7.2 and 7.3 (recalled).

    Examples
    --------
    >>> x = np.arange(-150, 150.5, 0.5) * 1e-6
    >>> found = step_height(Profile(x, np.where(abs(x) < 45e-6, -1e-6, 0.0)), width="100 um")
    >>> f"{found.height * 1e6:.3f} um"
    '-1.000 um'
    >>> tilted = Surface(np.add.outer(np.zeros(9), np.arange(20) * 1e-9), "1 um", "1 um")
    >>> half = np.arange(20) >= 10
    >>> upper, lower = np.tile(half, (9, 1)), np.tile(~half, (9, 1))
    >>> abs(step_height(tilted, upper=upper, lower=lower).height) < 1e-20
    True
    """
    instance_of(obj, (Profile, Surface), "a step height")
    choice(kind, "kind", ("A1", "A2"))
    choice(axis, "axis", ("x", "y"))
    _check_degree(degree)
    regions = [r for r in (upper, lower) if r is not None]
    if (width is None) == (not regions) or len(regions) == 1:
        raise OptionError(
            "a step height needs the width of a groove, or two regions: upper and lower"
        )
    if width is None:
        if not isinstance(obj, Surface):
            raise DataError("upper and lower are regions of a map; of a profile give width")
        return _between_regions(obj, upper, lower, degree)
    W = lateral(width, "width")
    at = Pixels(0.0) if isinstance(W, Pixels) and middle == 0.0 else lateral(middle, "middle")
    positive(W, "width")
    if isinstance(obj, Surface):
        obj = _seen(obj, "the groove", 'width = "120 px", middle = "300 px"', W, at)
    elif in_pixels("the groove", W, at):
        raise DataError('px are pixels of a map, and this is a profile: give a length, "100 um"')
    return _groove(obj, W, at, kind, axis, degree)


def _seen(surface: Surface, what: str, example: str, *given: Any) -> Surface:
    """Return a map in the unit of what lies on it: with steps of 1, its pixels, where that is px."""
    if in_pixels(what, *given):
        return Surface(surface.z, 1.0, 1.0, metadata=surface.metadata, history=surface.history)
    if surface.dx is None or surface.dy is None:
        raise needs_scale(what, example)
    return surface


def step_between(
    surface: Surface,
    a: tuple[float | str, float | str],
    b: tuple[float | str, float | str],
    *,
    width: float | str,
    kind: Literal["step", "A1", "A2"] = "step",
    degree: int = 1,
) -> StepHeight:
    """Return the height of a step, or of a groove or ridge, across a band in any direction of a map.

    Parameters
    ----------
    surface : Surface
        Not filtered; NaN is omitted.
    a, b : tuple of 2 floats (m) or str with unit
        In m or, with `width`, in px. Of a step: one on each of its faces, so that the edge lies in the middle third between them. Of
        a groove or ridge: its edges.
    width : float (m) or str with unit
        Of the band, along the edge.
    kind : {"step", "A1", "A2"}, optional
        A step; a groove with flat, or with round bottom.
    degree : {1, 2}, optional
        Faces that are straight, or bowed along the line from a to b.

    Returns
    -------
    StepHeight
        Height of b over a, or of the middle over the faces beside it, with u.

    Raises
    ------
    DataError
        If an option is unknown, a and b are the same point, or a map without lateral step is given lengths.
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
    >>> found = step_between(Surface(z, 1e-6, 1e-6), (9.5e-6, 3e-5), (69.5e-6, 3e-5), width="40 um")
    >>> f"{found.height * 1e9:.3f} nm"
    '25.000 nm'
    """
    instance_of(surface, Surface, "a step height")
    choice(kind, "kind", tuple(_LENGTHS))
    _check_degree(degree)
    across = lateral(width, "width")
    positive(across, "width")
    (ax, ay), (bx, by) = place(a, "a"), place(b, "b")
    surface = _seen(surface, "the band", 'width = "40 px"', across, ax, ay, bx, by)
    said = Pixels if isinstance(across, Pixels) else float
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

    def along(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        return (c * x + s * y) / L, (c * y - s * x) / L

    t, v = along(points.x[None, :], points.y[:, None])
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
                f"{format_length(said(_LENGTHS[kind] * L))} by {format_length(across)} must lie on what was "
                "measured; move it, or make it wider"
            )
    within = inner | outer
    deep = float(np.ptp(v[within & ~np.isnan(points.z)])) > _ROUNDING

    def columns(x: FloatArray, y: FloatArray, bowed: bool) -> FloatArray:
        t, v = along(x, y)
        inside = ((t > 0.0) if kind == "step" else (np.abs(t) <= _INNER)).astype(np.float64)
        middle = [inside, inside * t, inside * t * t] if kind == "A2" else [inside]
        more = [*([v] if deep else []), *([t * t] if bowed else [])]
        return np.stack([np.ones_like(t), t, *middle, *more])

    found, slopes = _fitted(points, within, columns, kind, degree)
    ranges = [(-0.5, -1.0 / 6.0), (1.0 / 6.0, 0.5)]
    if kind != "step":
        ranges = [(-1.5, -5.0 / 6.0), (-1.0 / 6.0, 1.0 / 6.0), (5.0 / 6.0, 1.5)]
    beyond = sum(
        _beyond(surface, middle, (c, s), (first * L, last * L), 0.5 * across)
        for first, last in ranges
    )
    return replace(found, slope=float(slopes[1]) / L, n_missing=found.n_missing + beyond)


def _beyond(
    surface: Surface,
    middle: tuple[float, float],
    turn: tuple[float, float],
    ends: tuple[float, float],
    half: float,
) -> int:
    """Return how many pixels of a turned rectangle the map would have beyond its rim, were it larger."""
    (c, s), (ny, nx) = turn, surface.shape
    dx, dy = surface.dx or 1.0, surface.dy or 1.0
    slack = _ROUNDING * max(*np.abs(ends), half)
    bands = ((c, s, ends[0] - slack, ends[1] + slack), (-s, c, -half - slack, half + slack))
    y = [s * t + sign * abs(c) * half for t in ends for sign in (-1, 1)]
    low, high = (
        round_((v + middle[1] - surface.origin[1]) / dy)
        for round_, v in ((np.floor, min(y)), (np.ceil, max(y)))
    )
    if high - low > _MOST_ROWS:  # far larger than any map
        return max(1, round((ends[1] - ends[0]) * 2.0 * half / (dx * dy)))
    row = np.arange(low, high + 1.0)
    v = surface.origin[1] + row * dy - middle[1]
    left, right = np.full(v.shape, -np.inf), np.full(v.shape, np.inf)
    for along, across, least, most in bands:  # least <= along x + across y <= most
        if abs(along) < _ROUNDING:
            left[(across * v < least) | (across * v > most)] = np.inf
            continue
        sides = np.sort([(least - across * v) / along, (most - across * v) / along], axis=0)
        left, right = np.maximum(left, sides[0]), np.minimum(right, sides[1])
    offset = middle[0] - surface.origin[0]
    first, last = np.ceil((left + offset) / dx), np.floor((right + offset) / dx)
    there = last >= first
    first, last, row = first[there], last[there], row[there]
    inside = np.minimum(last, nx - 1) - np.maximum(first, 0) + 1.0
    inside[(row < 0) | (row >= ny)] = 0.0
    return int((last - first + 1.0 - np.maximum(inside, 0.0)).sum())


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


def _check_degree(degree: int) -> None:
    if isinstance(degree, bool) or degree not in (1, 2):
        raise DataError(f"degree of the faces is 1 or 2, got {degree!r}")


def _groove(
    obj: Profile | Surface, W: float, centre: float, kind: Any, axis: str, degree: int
) -> StepHeight:
    """Return the height of the middle range over the outer two."""
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
            ends = [type(W)(v) for v in (along.min(), along.max())]
            raise TooFewSamplesError(
                f"the {name} of the groove holds {int((part & valid).sum())} valid samples, {_LEAST} "
                f"are needed: the data reach from {format_length(ends[0])} to "
                f"{format_length(ends[1])}, the middle is at {format_length(centre)} and "
                f"width is {format_length(W)}; give the middle=... of the groove, or measure 3 widths"
            )

    def columns(x: FloatArray, y: FloatArray, bowed: bool) -> FloatArray:
        s = (x if across else y) / W
        inside = (np.abs(s) <= _INNER).astype(np.float64)
        # of A2 the parabola in the middle takes all that is there: the line is that of the outer ranges
        middle = [inside] if kind == "A1" else [inside, inside * s, inside * s * s]
        return np.stack([np.ones_like(s), s, *middle, *([s * s] if bowed else [])])

    found, slopes = _fitted(points, inner | outer, columns, kind, degree)
    return replace(found, slope=float(slopes[1]) / W)


def _between_regions(surface: Surface, upper: Any, lower: Any, degree: int) -> StepHeight:
    """Return the height of one region over another."""
    inside = {name: _pixels(surface, r, name) for name, r in (("upper", upper), ("lower", lower))}
    if surface.dx is None or surface.dy is None:  # both count pixels
        surface = Surface(surface.z, 1.0, 1.0)
    if (inside["upper"] & inside["lower"]).any():
        raise DataError("the regions upper and lower overlap; a pixel belongs to one of them")
    valid = ~np.isnan(surface.z)
    for name, part in inside.items():
        if int((part & valid).sum()) < _LEAST_OF_REGION:
            raise TooFewSamplesError(
                f"the region {name} holds {int((part & valid).sum())} valid pixels, {_LEAST_OF_REGION} "
                "are needed; make it larger, or move it to where the map was measured"
            )
    within = inside["upper"] | inside["lower"]
    assert surface.dx is not None  # noqa: S101  # as the caller made sure
    assert surface.dy is not None  # noqa: S101
    dx, dy = surface.dx, surface.dy
    rows, columns_ = np.nonzero(within & valid)
    x0, y0 = (
        o + float(i.mean()) * d
        for o, i, d in zip(surface.origin, (columns_, rows), (dx, dy), strict=True)
    )
    points = points_of(surface, centre=(x0, y0), middle=False)
    L = max(float(np.ptp(columns_)) * dx, float(np.ptp(rows)) * dy)
    mark = inside["upper"].astype(np.float64)

    def columns(x: FloatArray, y: FloatArray, bowed: bool) -> FloatArray:
        at = [
            np.clip(np.rint((v + c - o) / d).astype(np.intp), 0, n - 1)
            for v, c, o, d, n in zip(
                (y, x), (y0, x0), surface.origin[::-1], (dy, dx), surface.shape, strict=True
            )
        ]
        u, v = x / L, y / L
        bow = [u * u, u * v, v * v] if bowed else []
        return np.stack([np.ones_like(u), u, mark[at[0], at[1]], v, *bow])

    found, slopes = _fitted(points, within, columns, "regions", degree)
    return replace(found, slope=float(np.hypot(slopes[1], slopes[3])) / L)


def _pixels(surface: Surface, region: Any, name: str) -> BoolArray:
    """Return which pixels lie in a region."""
    if not isinstance(region, Mapping):
        flags = np.asarray(region)
        if flags.dtype != np.bool_ or flags.shape != surface.shape:
            raise DataError(
                f"{name} is a region such as {{'shape': 'circle', 'diameter': '1 mm', 'centre': ...}}, or "
                f"flags of shape {surface.shape}; got {flags.dtype} of shape {flags.shape}"
            )
        return flags
    known = {**region}
    shape = str(known.pop("shape", "circle"))

    def at(pair: Any, what: str) -> tuple[float, float]:
        return place(pair.split(",") if isinstance(pair, str) else pair, f"{what} of {name}")

    made: dict[str, Any] = {}
    for key, value in known.items():
        if key == "points":
            made[key] = [at(v, "a point") for v in value]
        elif key == "centre":
            made[key] = at(value, "the centre")
        else:
            of = f"{key} of {name}"
            is_angle = key == "angle"
            made[key] = real(value, of, dimension="angle") if is_angle else lateral(value, of)
    check_region(shape, made, is_profile=False)
    if "points" not in made and "centre" not in made:
        raise DataError(f'{name}: a {shape} needs its centre = ["5 mm", "3 mm"]')
    (x0, y0), (dx, dy) = (0.0, 0.0), (1.0, 1.0)
    if not in_pixels(name, *(v for k, v in made.items() if k != "angle")):
        if surface.dx is None or surface.dy is None:
            raise needs_scale(f"the region {name}", 'diameter = "120 px"')
        (x0, y0), (dx, dy) = surface.origin, (surface.dx, surface.dy)
    x = x0 + dx * np.arange(surface.shape[1], dtype=np.float64)
    y = y0 + dy * np.arange(surface.shape[0], dtype=np.float64)
    return within_region({"shape": shape, **made}, x, y, made.get("centre", (0.0, 0.0)))


def _fitted(
    points: Points, within: BoolArray, columns: Columns, kind: Any, degree: int
) -> tuple[StepHeight, FloatArray]:
    """Return the step of one least-squares fit, and its coefficients; the third is that of the step."""
    used = within & ~np.isnan(points.z)
    x, y = np.broadcast_arrays(points.x[None, :], points.y[:, None])
    x, y, level = x[used], y[used], float(np.median(points.z[used]))
    heights = points.z[used] - level

    def solved(bowed: bool) -> tuple[FloatArray, FloatArray, bool]:
        basis = columns(x, y, bowed)
        found, _, rank, _ = np.linalg.lstsq(basis.T, heights, rcond=None)
        return np.asarray(found, dtype=np.float64), basis, bool(rank == len(basis))

    coefficients, basis, known = solved(degree == 2)
    if not known:
        raise DataError(
            "the faces cannot be separated from the step: take larger regions, or degree = 1"
        ).hinting(degree=1)
    residual = np.full(points.z.shape, np.nan)
    residual[used] = heights - coefficients @ basis
    height, slopes = _height_of(coefficients, kind)

    def linearise(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        return np.vstack([columns(x, y, degree == 2), z])

    found = estimated(points, linearise, residual, coefficients.size)
    bow = 0.0
    if degree == 1:
        other, _, known = solved(bowed=True)
        bow = height - _height_of(other, kind)[0] if known else 0.0
    u = float(np.sqrt(slopes @ found.cov @ slopes))
    size = float(np.abs(points.z[used]).max())
    rms = without_rounding(float(np.sqrt(np.mean(np.square(residual[used])))), size)
    if rms == 0.0:  # what the fit leaves are the last bits of the heights, and tells nothing
        u = 0.0
    n, missing = int(used.sum()), int((within & ~used).sum())
    step = StepHeight(height, u, found.dof, 0.0, n, rms, kind, bow, missing)
    return step, coefficients


def _height_of(coefficients: FloatArray, kind: str) -> tuple[float, FloatArray]:
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
