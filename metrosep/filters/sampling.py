"""Heights between the pixels of a map: along lines and circles, and on another grid.

A height is read from the map itself, by `method`. ``"lanczos"`` (a plane with twist through the 64 pixels
around, and what it leaves by a windowed sinc) keeps the RMS of waves from 3 pixels on within 1 %; where
one of the 64 was not measured it is bilinear. ``"bilinear"`` averages, and keeps 84 % at 4.3 pixels, two
thirds of noise: prefer it on steps, where the other overshoots by a tenth of their height. ``"nearest"``
keeps the RMS, and repeats pixels. None fills a gap; at pixel centres each gives the pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray, position
from metrosep.core.errors import DataError, OptionError, TooFewSamplesError, UnitError
from metrosep.core.numbers import choice, not_negative, positive
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step
from metrosep.core.surface import Surface

__all__ = ["Reading", "circle_profile", "read_line", "resample", "section_profile"]

Reading = Literal["lanczos", "bilinear", "nearest"]
Point = Sequence[float | str]

_METHODS = ("lanczos", "bilinear", "nearest")

_ON_PIXEL = 1e-8
"""Part of a pixel below which a point lies on the pixel's centre line."""

_REACH = np.arange(-3, 5)
"""Neighbours on each axis of a point between pixel 0 and pixel 1: eight."""

_AT_ONCE = 20_000
"""Samples whose neighbours are held at a time: 10 MB."""

_MOST_SAMPLES = 10_000_000
"""Largest number of samples of a section; a line that needs more is a slip of the unit."""


def section_profile(
    surface: Surface,
    a: Point,
    b: Point,
    *,
    width: float | str | None = None,
    method: Reading = "lanczos",
) -> Profile:
    """Return the heights of a map along the line from a to b.

    Parameters
    ----------
    surface : Surface
        Map; without lateral steps positions are in pixels.
    a, b : pair of float (m) or str with unit
        Ends (x, y).
    width : float (m) or str with unit, optional
        Width of a band about the line over which parallel lines, a pixel apart, are averaged.
    method : {"lanczos", "bilinear", "nearest"}, optional
        How heights between pixels are read.

    Returns
    -------
    Profile
        Over the distance from a, in steps of a pixel; NaN outside the map and beside gaps. The
        history says which share was read bilinearly.

    Raises
    ------
    DataError
        If the ends are the same or farther apart than 10 million pixels, or an option is wrong.
    UnitError
        If a position has a unit, and the map no lateral steps.

    Notes
    -----
    A band has n = 2 floor(w / 2s) + 1 lines, s the smaller step; a sample is the mean of those that
    are valid, at least half of them. A wave of length L across the band is damped by
    sin(pi n s / L) / (n sin(pi s / L)).

    Examples
    --------
    >>> plane = Surface([[0.0, 1.0], [2.0, 3.0]], dx=1.0, dy=1.0)
    >>> section_profile(plane, (0, 0), (0.6, 0.8)).z.round(12).tolist()
    [0.0, 2.2]
    """
    distance, z, length, share = read_line(surface, a, b, method)
    unit = _unit(surface)
    ends = [_place(surface, p, name) for p, name in ((a, "a"), (b, "b"))]
    facts: dict[str, Any] = {
        f"from_{unit}": [*ends[0]],
        f"to_{unit}": [*ends[1]],
        "reading": method,
    }
    if width is not None:
        wide = not_negative(width, "width", dimension="length")
        s = min(_steps(surface))
        half = math.floor(wide / (2.0 * s) * (1.0 + 1e-9))
        (ax, ay), (bx, by) = ends
        # across the line, to its left: (-sin, cos) of its direction
        across = np.array([ay - by, bx - ax]) / length * s
        lines = []
        for i in range(-half, half + 1):
            moved = [(x + i * across[0], y + i * across[1]) for x, y in ends]
            _, beside, _, other = read_line(surface, moved[0], moved[1], method)
            lines.append(beside)
            share = max(share, other)
        z = _mean_of_half(np.stack(lines))
        facts |= {f"width_{unit}": wide, "lines": len(lines)}
    step = Step("section", {**facts, "bilinear_share": share})
    return Profile(distance, z, metadata=surface.metadata, history=(*surface.history, step))


def circle_profile(
    surface: Surface, centre: Point, radius: float | str, *, method: Reading = "lanczos"
) -> Profile:
    """Return the heights of a map round a circle.

    Parameters
    ----------
    surface : Surface
        Map; without lateral steps positions are in pixels.
    centre : pair of float (m) or str with unit
        Middle (x, y).
    radius : float (m) or str with unit
        Of the circle.
    method : {"lanczos", "bilinear", "nearest"}, optional
        How heights between pixels are read.

    Returns
    -------
    Profile
        Over the arc from +x towards +y; closed, so that the first point does not occur again at its
        end. NaN outside the map and beside gaps.

    Raises
    ------
    DataError
        If the radius is not positive, holds more than 10 million pixels, or an option is wrong.
    UnitError
        If a length has a unit, and the map no lateral steps.

    Examples
    --------
    >>> plane = Surface(np.tile(np.arange(9.0), (9, 1)), dx=1.0, dy=1.0)
    >>> around = circle_profile(plane, (4, 4), 3)
    >>> len(around), float(around.z[0])
    (19, 7.0)
    """
    _required(surface)
    x, y = _place(surface, centre, "centre")
    if isinstance(radius, str) and not _is_calibrated(surface):
        raise _in_pixels("radius")
    r = positive(radius, "radius", dimension="length")
    s = min(_steps(surface))
    if not 2.0 * math.pi * r < _MOST_SAMPLES * s:
        raise DataError(
            f"the circle of radius {r:.9g} has more than {_MOST_SAMPLES} pixels; is the radius in m?"
        )
    n = max(3, math.ceil(2.0 * math.pi * r / s * (1.0 - 1e-9)))
    angle = 2.0 * math.pi * np.arange(n) / n
    z, share = _heights(surface, x + r * np.cos(angle), y + r * np.sin(angle), method)
    unit = _unit(surface)
    facts = {f"centre_{unit}": [x, y], f"radius_{unit}": r, "reading": method, "closed": True}
    step = Step("circle_section", {**facts, "bilinear_share": share})
    return Profile(r * angle, z, metadata=surface.metadata, history=(*surface.history, step))


def resample(
    obj: Surface | Profile,
    onto: Surface | Profile | None = None,
    *,
    step: float | str | None = None,
    method: Reading = "lanczos",
) -> Surface | Profile:
    """Return the heights of a map or profile on another grid.

    Parameters
    ----------
    obj : Surface or Profile
        A map needs lateral steps.
    onto : Surface or Profile, optional
        Whose grid is wanted, of the same kind; its heights do not matter.
    step : float (m) or str with unit, optional
        In place of `onto`: one step along every axis, from the first sample on.
    method : {"lanczos", "bilinear", "nearest"}, optional
        How heights of a map are read; a profile is always interpolated along a straight line.

    Returns
    -------
    Surface or Profile
        NaN outside what was measured and beside gaps. Nothing is filtered: waves shorter than two of
        the new steps must be removed before.

    Raises
    ------
    OptionError
        If neither or both of `onto` and `step` are given, or the kinds differ.
    DataError
        If a map has no lateral steps, or the step is longer than what was measured.

    Examples
    --------
    >>> line = Profile([0.0, 1.0, 2.0], [0.0, 2.0, 0.0])
    >>> resample(line, step=0.5).z.tolist()
    [0.0, 1.0, 2.0, 1.0, 0.0]
    """
    if (onto is None) == (step is None):
        raise OptionError("resample needs either the grid of another object (onto=) or a step=")
    given: Any = obj
    if not isinstance(given, Surface | Profile):
        raise OptionError(f"resample takes a Surface or a Profile, got {type(given).__name__}")
    kind = Surface if isinstance(obj, Surface) else Profile
    if onto is not None and not isinstance(onto, kind):
        raise OptionError(f"a {kind.__name__} cannot be resampled onto a {type(onto).__name__}")
    choice(method, "method", _METHODS)
    pitch = None if step is None else positive(step, "step", dimension="length")
    if isinstance(obj, Profile):
        x = onto.x if isinstance(onto, Profile) else _grid(obj.x[0], obj.x[-1], pitch)
        z = np.interp(x, obj.x, obj.z, left=np.nan, right=np.nan)
        note = Step("resample", {"samples": int(x.size), "reading": "linear"})
        return Profile(x, z, metadata=obj.metadata, history=(*obj.history, note))
    if not _is_calibrated(obj):
        raise DataError(
            "a map without lateral steps cannot be resampled; give it Surface(z, dx, dy)"
        )
    if isinstance(onto, Surface):
        if not _is_calibrated(onto):
            raise DataError("the map that gives the grid has no lateral steps")
        dx, dy, origin, shape = onto.dx, onto.dy, onto.origin, onto.shape
        xs, ys = (origin[k] + (dx, dy)[k] * np.arange(shape[1 - k]) for k in (0, 1))  # type: ignore[operator]
    else:
        dx = dy = pitch
        origin = obj.origin
        ends = [
            o + d * (n - 1) for o, d, n in zip(origin, _steps(obj), obj.shape[::-1], strict=True)
        ]
        xs, ys = (_grid(o, e, pitch) for o, e in zip(origin, ends, strict=True))
    columns, rows = np.meshgrid(xs, ys)
    heights, share = _heights(obj, columns.ravel(), rows.ravel(), method)
    note = Step("resample", {"dx_m": dx, "dy_m": dy, "reading": method, "bilinear_share": share})
    return Surface(
        heights.reshape(rows.shape), dx, dy, origin=origin, metadata=obj.metadata,
        history=(*obj.history, note),
    )  # fmt: skip


def _grid(start: float, stop: float, step: float | None) -> FloatArray:
    """Return positions from the first sample on, none beyond the last one."""
    pitch = float(step or 0.0)
    n = math.floor((stop - start) / pitch * (1.0 + 1e-12) + 1e-9) + 1
    if n < 2:
        raise TooFewSamplesError(
            f"step = {pitch:.6g} m is longer than what was measured, {stop - start:.6g} m"
        )
    if n > _MOST_SAMPLES:
        raise DataError(f"step = {pitch:.6g} m gives {n} samples; is it in m?")
    return np.asarray(start + pitch * np.arange(n))


def read_line(
    surface: Surface, a: Point, b: Point, method: str
) -> tuple[FloatArray, FloatArray, float, float]:
    """Return distances, heights, length, and the share of heights that were read bilinearly."""
    _required(surface)
    (ax, ay), (bx, by) = _place(surface, a, "a"), _place(surface, b, "b")
    length = math.hypot(bx - ax, by - ay)
    least = min(_steps(surface))
    if not 0.0 < length < _MOST_SAMPLES * least:
        raise DataError(
            f"the section runs from ({ax:.9g}, {ay:.9g}) to ({bx:.9g}, {by:.9g}): its ends must "
            f"differ, by less than {_MOST_SAMPLES} pixels; are they in m?"
        )
    # a step that divides the length up to rounding must not be cut in two
    n = max(2, math.ceil(length / least * (1.0 - 1e-9)) + 1)
    part = np.linspace(0.0, 1.0, n)
    z, share = _heights(surface, ax + part * (bx - ax), ay + part * (by - ay), method)
    return part * length, z, length, share


def _heights(
    surface: Surface, x: FloatArray, y: FloatArray, method: str
) -> tuple[FloatArray, float]:
    """Return heights at places, and the share that was read bilinearly."""
    choice(method, "method", _METHODS)
    dx, dy = _steps(surface)
    x0, y0 = surface.origin if _is_calibrated(surface) else (0.0, 0.0)
    row, column = (y - y0) / dy, (x - x0) / dx
    if method == "nearest":
        return _nearest(surface.z, row, column), 0.0
    z = _bilinear(surface.z, row, column)
    return z, _refined(surface.z, row, column, z) if method == "lanczos" else 1.0


def _mean_of_half(lines: FloatArray) -> FloatArray:
    """Return the mean of the valid lines at each sample, NaN where fewer than half are valid."""
    valid = np.count_nonzero(~np.isnan(lines), axis=0)
    enough = 2 * valid >= lines.shape[0]
    total = np.nansum(lines, axis=0)
    return np.where(enough, total / np.maximum(valid, 1), np.nan)


def _required(surface: Surface) -> None:
    if not isinstance(surface, Surface):
        raise DataError(f"a section is cut through a Surface, got {type(surface).__name__}")


def _place(surface: Surface, point: Point, name: str) -> tuple[float, float]:
    texts = () if isinstance(point, str) or not hasattr(point, "__len__") else tuple(point)
    if any(isinstance(v, str) for v in texts) and not _is_calibrated(surface):
        raise _in_pixels(name)
    try:
        return position(point, name)
    except UnitError:
        raise
    except DataError:
        raise DataError(
            f"{name} must be two finite numbers (x, y) in m, or texts with units, got {point!r}"
        ) from None


def _in_pixels(name: str) -> UnitError:
    return UnitError(
        f"{name} has a unit, but the map has no lateral steps: give pixels, or its steps"
    )


def _steps(surface: Surface) -> tuple[float, float]:
    """Return the lateral steps, of a pixel where they are not known."""
    if surface.dx is None or surface.dy is None:
        return 1.0, 1.0
    return surface.dx, surface.dy


def _unit(surface: Surface) -> str:
    return "m" if _is_calibrated(surface) else "px"


def _is_calibrated(surface: Surface) -> bool:
    return surface.dx is not None and surface.dy is not None


def _bilinear(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    """Return heights at fractional indices; a neighbour without weight need not be valid."""
    (i, v), (j, u) = _split(row), _split(column)
    total = np.zeros(row.size)
    for di, wi in ((0, 1.0 - v), (1, v)):
        for dj, wj in ((0, 1.0 - u), (1, u)):
            weight = wi * wj
            carries = weight > 0.0
            height = _at(z, i[carries] + di, j[carries] + dj)
            total[carries] += weight[carries] * height
    return total


def _refined(z: FloatArray, row: FloatArray, column: FloatArray, heights: FloatArray) -> float:
    """Put better heights in place of bilinear ones; return the share that had no 64 neighbours."""
    (i, v), (j, u) = _split(row), _split(column)
    between = ~np.isnan(heights) & ((u > 0.0) | (v > 0.0))
    low, high = _REACH[0], _REACH[-1]
    inside = (i + low >= 0) & (i + high < z.shape[0]) & (j + low >= 0) & (j + high < z.shape[1])
    which = np.flatnonzero(between & inside)
    done = 0
    for k in np.array_split(which, max(1, -(-which.size // _AT_ONCE))):
        patch = z[i[k, None, None] + _REACH[:, None], j[k, None, None] + _REACH]
        whole = ~np.isnan(patch).any(axis=(1, 2))
        some, patch = k[whole], patch[whole]
        heights[some] = _lanczos(patch, v[some], u[some])
        done += some.size
    n = int(np.count_nonzero(between))
    return (n - done) / n if n else 0.0


def _lanczos(patch: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
    """Return heights within 8 x 8 pixels: of their fitted plane, and by Lanczos-4 of what it leaves."""
    # p = m + r y + c x + s x y about the middle; weights a, b with sum 1 of rows and columns:
    # z(v, u) = sum a b (z - p) + p(v, u), and m drops out
    t = _REACH.astype(np.float64) - 0.5
    y, x = v - 0.5, u - 0.5
    a, b = (w / w.sum(axis=1, keepdims=True) for w in (_sinc4(y, t), _sinc4(x, t)))
    squares = float(t @ t)
    r = np.einsum("nij,i->n", patch, t) / (t.size * squares)
    c = np.einsum("nij,j->n", patch, t) / (t.size * squares)
    s = np.einsum("nij,i,j->n", patch, t, t) / squares**2
    weighted = np.einsum("nij,ni,nj->n", patch, a, b)
    ya, xb = a @ t, b @ t
    return np.asarray(weighted + r * (y - ya) + c * (x - xb) + s * (y * x - ya * xb))


def _sinc4(place: FloatArray, t: FloatArray) -> FloatArray:
    d = place[:, None] - t
    return np.asarray(np.sinc(d) * np.sinc(d / 4.0))


def _split(index: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return whole and fractional part; what lies on a pixel within rounding lies on it."""
    whole = np.floor(index + _ON_PIXEL)
    part = index - whole
    return whole.astype(np.intp), np.where(part > _ON_PIXEL, part, 0.0)


def _nearest(z: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    near = [np.floor(v + 0.5 + _ON_PIXEL).astype(np.intp) for v in (row, column)]
    for k, (v, n) in enumerate(zip((row, column), z.shape, strict=True)):
        at_rim = np.abs(v - (n - 0.5)) <= _ON_PIXEL  # the far rim belongs to the last pixel
        near[k] = np.where(at_rim, n - 1, near[k])
    return _at(z, near[0], near[1])


def _at(z: FloatArray, row: NDArray[np.intp], column: NDArray[np.intp]) -> FloatArray:
    """Return heights at whole indices, NaN outside the map."""
    ny, nx = z.shape
    inside = (row >= 0) & (row < ny) & (column >= 0) & (column < nx)
    height = np.full(row.size, np.nan)
    height[inside] = z[row[inside], column[inside]]
    return height
