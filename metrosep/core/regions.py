"""Regions of a map (circle, ring, rectangle, polygon, brush), and the middle of what was measured.

The centre of a pixel decides whether it is inside.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, Example
from metrosep.core.units import Pixels, format_length

if TYPE_CHECKING:
    from metrosep.core.surface import Surface

Flags = NDArray[np.bool_]
Points = Sequence[tuple[float, float]]

SHAPES: Mapping[str, tuple[str, ...]] = {
    "circle": ("diameter",),
    "ring": ("diameter", "inner_diameter"),
    "rectangle": ("width", "height"),
    "polygon": ("points",),
    "brush": ("radius", "points"),
}
"""Shapes, and the keys that each needs."""

LENGTHS = ("diameter", "inner_diameter", "width", "height", "radius")
_KEYS = (*LENGTHS, "angle", "points")
_FEWEST = {"polygon": 3, "brush": 1}
"""Points of a shape that is drawn."""
_ROUNDING = 1e-9
"""Relative: a point on the rim of a circle, a rectangle or a brush is inside."""
_SQUARE = 1e-6
"""Relative difference of both steps below which pixels are square; files round steps to fewer digits."""
_FLAT = 1e-12
"""Of the extent of a polygon: corners so close to one line enclose nothing."""


def in_pixels(what: str, *given: Any) -> bool:
    """Return whether all places and sizes of a shape count pixels; refuse one that counts some of them only."""
    kinds = {isinstance(v, Pixels) for v in _each(given)}
    if len(kinds) > 1:
        raise DataError(
            f"{what} has some of its places and sizes in px and others in a unit of length: write all of "
            "them in px, as a map without scale needs, or none"
        )
    return True in kinds


def counts_pixels(given: Any) -> bool:
    """Return whether a step or section of a recipe has a place or size in px."""
    return any(isinstance(v, Pixels) for v in _each([given]))


def _each(given: Any) -> Iterator[float]:
    """Yield the numbers in nested sequences and tables."""
    for value in given:
        if isinstance(value, list | tuple):
            yield from _each(value)
        elif isinstance(value, Mapping):
            yield from _each(value.values())
        elif value is not None and not isinstance(value, str):
            yield value


def needs_scale(what: str, example: str) -> DataError:
    """Return the error of a length on a map whose pixels have no known size, with both ways out."""
    return DataError(
        f"{what} is given in a unit of length, and the file does not say how large a pixel of the map is: "
        f'write it in pixels, such as {example}, or give lateral_step = "3 um" where the file is read'
    ).hinting(lateral_step=Example("3 um"))


def not_round(surface: Surface, what: str) -> str:
    """Return why what is drawn in px is distorted on a map, or may be; nothing where its pixels are square."""
    dx, dy = surface.dx, surface.dy
    if dx is None or dy is None:
        return (
            f"{what} counts pixels, and the file does not say whether they are square: where they are not, "
            "lengths along x and y differ and a circle is an ellipse"
        )
    if abs(dx - dy) <= _SQUARE * dx:
        return ""
    return (
        f"{what} counts pixels, which are {format_length(dx)} by {format_length(dy)} on this map: lengths along "
        "x and y differ and a circle is an ellipse; give it in mm if that is not meant"
    )


def within_region(
    region: Mapping[str, Any], x: FloatArray, y: FloatArray, centre: tuple[float, float]
) -> Flags:
    """Return which points of a grid lie in a region, shape (n_y, n_x); x and y rise (m)."""
    shape = region["shape"]
    if shape == "polygon":
        return _in_polygon(region["points"], x, y)
    if shape == "brush":
        return _under_brush(region["points"], region["radius"], x, y)
    u, v = x[None, :] - centre[0], y[:, None] - centre[1]
    if shape == "rectangle":
        angle = region.get("angle", 0.0)
        if angle:  # from +x to +y: the axes of the rectangle
            c, s = np.cos(angle), np.sin(angle)
            u, v = u * c + v * s, v * c - u * s
        within = np.abs(u) <= 0.5 * region["width"] * (1.0 + _ROUNDING)
        if "height" in region:
            within = within & (np.abs(v) <= 0.5 * region["height"] * (1.0 + _ROUNDING))
        return np.asarray(within & np.ones((y.size, 1), dtype=bool))
    squared = u**2 + v**2
    within = squared <= (0.5 * region["diameter"] * (1.0 + _ROUNDING)) ** 2
    if shape == "ring":
        within &= squared >= (0.5 * region["inner_diameter"] * (1.0 - _ROUNDING)) ** 2
    return np.asarray(within)


def _in_polygon(points: Points, x: FloatArray, y: FloatArray) -> Flags:
    """Return what lies inside by the even-odd rule; neighbouring polygons share no point."""
    # an edge counts for rows y1 <= y < y2 and for columns left of where it crosses the row. It is
    # taken from its lower end, so that both neighbours compute the same crossing.
    flips = np.zeros((y.size, x.size + 1), dtype=bool)
    for one, other in pairwise([*points, points[0]]):
        (x1, y1), (x2, y2) = sorted((one, other), key=lambda p: (p[1], p[0]))
        first, last = np.searchsorted(y, (y1, y2), side="left")
        rows = np.arange(first, last)
        crossing = x1 + (y[rows] - y1) * ((x2 - x1) / (y2 - y1)) if rows.size else y[rows]
        flips[rows, np.searchsorted(x, crossing, side="left")] ^= True
    # a row has an even number of crossings: those behind a column are odd where those up to it are
    return np.asarray(np.logical_xor.accumulate(flips, axis=1)[:, : x.size])


def _under_brush(points: Points, radius: float, x: FloatArray, y: FloatArray) -> Flags:
    """Return what lies within a radius of a line through points."""
    limit = radius * (1.0 + _ROUNDING)
    found = np.zeros((y.size, x.size), dtype=bool)
    for (ax, ay), (bx, by) in pairwise(points) if len(points) > 1 else [(points[0], points[0])]:
        rows, columns = _near(y, ay, by, limit), _near(x, ax, bx, limit)
        u, v = x[None, columns] - ax, y[rows, None] - ay
        along, across = bx - ax, by - ay
        squared = along**2 + across**2
        t = np.clip((u * along + v * across) / squared, 0.0, 1.0) if squared > 0.0 else 0.0
        found[rows, columns] |= (u - t * along) ** 2 + (v - t * across) ** 2 <= limit**2
    return found


def _near(at: FloatArray, a: float, b: float, limit: float) -> slice:
    """Return the rows or columns from a to b, and so far beyond both."""
    first = np.searchsorted(at, min(a, b) - limit, side="left")
    return slice(int(first), int(np.searchsorted(at, max(a, b) + limit, side="right")))


def check_region(shape: str, region: Mapping[str, Any], *, is_profile: bool) -> None:
    """Refuse a region without its sizes, with another's, or that encloses nothing."""
    if shape not in SHAPES:
        raise DataError(f"shape = {shape!r} is not one of {', '.join(SHAPES)}")
    needed = [k for k in SHAPES[shape] if not (is_profile and k == "height")]
    missing = [k for k in needed if region.get(k) is None]
    if missing:
        example = '["1 mm, 1 mm", "2 mm, 1 mm"]' if missing[0] == "points" else '"10 mm"'
        raise DataError(f"a {shape} needs {', '.join(missing)}, such as {missing[0]} = {example}")
    known = [*needed, *(["angle"] if shape == "rectangle" and not is_profile else [])]
    known += [] if "points" in needed else ["centre"]
    stray = [k for k in region if k in (*_KEYS, "centre") and k not in known]
    if stray:
        kind = f"a {shape} on a profile" if is_profile else f"a {shape}"
        raise DataError(f"{kind} has no {', '.join(stray)}; it has {', '.join(known)}")
    for key in (k for k in needed if k != "points"):
        if not (np.isfinite(region[key]) and region[key] > 0.0):
            raise DataError(
                f"{key} of the aperture must be more than zero, got {format_length(region[key])}"
            )
    in_pixels(f"the {shape}", *(region.get(k) for k in (*LENGTHS, "points", "centre")))
    if shape == "ring" and not region["inner_diameter"] < region["diameter"]:
        raise DataError(
            f"inner_diameter = {format_length(region['inner_diameter'])} of the ring must be "
            f"smaller than diameter = {format_length(region['diameter'])}"
        )
    if "points" in needed:
        _check_points(shape, region["points"])


def _check_points(shape: str, points: Any) -> None:
    try:
        found = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.ndim != 2 or found.shape[1] != 2 or not np.isfinite(found).all():
        raise DataError(f'points of a {shape} have x and y: points = ["1 mm, 1 mm", ...]')
    if len(found) < _FEWEST[shape]:
        raise DataError(f"a {shape} has {_FEWEST[shape]} points or more, got {len(found)}")
    if shape == "polygon":
        away = found - found.mean(axis=0)
        spread = np.linalg.svd(away, compute_uv=False)
        if spread[1] <= _FLAT * np.abs(found).max():
            raise DataError("the corners of the polygon lie on one line: it encloses nothing")


def crosses_itself(points: Points) -> bool:
    """Return whether two edges of a polygon cross, other than at a corner that they share."""
    p = np.array(points, dtype=np.float64)
    q = np.roll(p, -1, axis=0)
    return any(_crossed(p[k], q[k], p[k + 1 :], q[k + 1 :]).any() for k in range(len(p)))


def _crossed(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> Flags:
    """Return which of the edges from c to d cross the edge from a to b, between its ends."""

    def side(o: FloatArray, p: FloatArray, q: FloatArray) -> FloatArray:
        u, v = p - o, q - o
        return np.asarray(np.sign(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]))

    apart = side(a, b, c) * side(a, b, d) < 0.0
    return np.asarray(apart & (side(c, d, a) * side(c, d, b) < 0.0))


def region_words(region: Mapping[str, Any], centre: tuple[float, float] | None) -> str:
    """Return a region in a few words."""
    shape = str(region.get("shape", "circle"))
    if centre is not None:
        return f"{shape} about ({format_length(centre[0])}, {format_length(centre[1])})"
    n = len(region["points"])
    return f"{shape} of {n} point{'s' if n > 1 else ''}"


# ---- where the axis of a part is taken if a map declares no origin ----------------------------------

Positions = NDArray[np.floating[Any]]

_CENTRED = 1e-3
"""Of the extent of a map: a middle of the measured part so close to that of the map is the same."""


def measured_middle(z: FloatArray, x: Positions, y: Positions) -> tuple[float, float]:
    """Return the middle of the measured part of a map.

    All chords of a disc, a ring or a rectangle have their middle on its axis. The median forgives
    stray points, dropouts and a rim that is cut off on one side over less than half of the rows.
    A margin that was not measured changes nothing.

    Examples
    --------
    >>> z = np.full((3, 5), np.nan)
    >>> z[:, 3:] = 0.0
    >>> measured_middle(z, np.arange(5.0), np.arange(3.0))
    (3.5, 1.0)
    """
    valid = ~np.isnan(z)
    if valid.all() or not valid.any():
        return 0.5 * float(x[0] + x[-1]), 0.5 * float(y[0] + y[-1])
    return _of_chords(valid, x), _of_chords(valid.T, y)


class Axis(NamedTuple):
    """Where the axis of a part is taken."""

    position: tuple[float, float]  # of (float, float), m: in the coordinates of the map
    # what the caller should be told: where it was taken, if nothing but the data says so
    notes: tuple[str, ...] = ()


def assumed_axis(surface: Surface) -> Axis:
    """Return the axis of a part whose centre was not given."""
    if surface.origin != (0.0, 0.0):
        return Axis((0.0, 0.0))
    rows, columns = surface.shape
    x, y = (surface.dx or 0.0) * np.arange(columns), (surface.dy or 0.0) * np.arange(rows)
    middle = measured_middle(surface.z, x, y)
    off = max(
        abs(m - 0.5 * float(p[-1])) / float(p[-1] or 1.0)
        for m, p in zip(middle, (x, y), strict=True)
    )
    if off < _CENTRED:
        return Axis(middle)
    x0, y0 = (format_length(m) for m in middle)
    note = (
        "the map declares no origin, so its axis is taken in the middle of what was measured, "
        f"x = {x0}, y = {y0}; give centre= if it lies elsewhere"
    )
    return Axis(middle, (note,))


def _of_chords(valid: NDArray[np.bool_], at: Positions) -> float:
    rows = valid[valid.any(axis=1)]
    first = np.argmax(rows, axis=1)
    last = rows.shape[1] - 1 - np.argmax(rows[:, ::-1], axis=1)
    return float(np.median(0.5 * (at[first] + at[last])))
