"""Points of a surface with their areas: a polar mesh, or the pixels of a map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.core.regions import assumed_axis
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.stl import GridForm

N_RHO, N_AZIMUTH = 300, 720

_FEWEST = 16
"""Points: fewer do not show the shape of a map."""

_AT_EDGE = 1e-9
"""Of the radius: a part this near to the edge of its form, where the slope is infinite, is on it."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Points of the nominal surface where it is defined, measured from the axis of the part."""

    x: FloatArray  # shape (n,): position in m, and slopes
    y: FloatArray
    z: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    weights: FloatArray  # shape (n,): area of each point seen along z, sum 1
    index: NDArray[np.intp]  # shape (n,): place of each point in the whole mesh
    shape: tuple[int, int]  # of the whole mesh: radii and azimuths
    rho: FloatArray
    azimuth: FloatArray
    form: Any  # ``form(x, y)`` and ``form.gradient(x, y)`` from the axis of the part

    @property
    def n_missing(self) -> int:
        """Points of the mesh at which the surface is not defined."""
        return self.shape[0] * self.shape[1] - self.index.size

    def whole(self, values: FloatArray) -> FloatArray:
        """Return values of the points on the whole mesh, NaN where there is no surface."""
        out = np.full((self.shape[0] * self.shape[1], *values.shape[1:]), np.nan)
        out[self.index] = values
        return out.reshape((*self.shape, *values.shape[1:]))


@dataclass(frozen=True, slots=True)
class _Moved:
    """A form seen from another centre."""

    form: Any
    centre: tuple[float, float]

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(self.form(x + self.centre[0], y + self.centre[1]), dtype=np.float64)

    def gradient(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy."""
        along_x, along_y = self.form.gradient(x + self.centre[0], y + self.centre[1])
        return np.asarray(along_x, dtype=np.float64), np.asarray(along_y, dtype=np.float64)


def centred_form(surface: Any, centre: tuple[float, float] | None) -> Any:
    """Return height and gradient of a form or map, measured from the axis of the part.

    Without a centre a form counts from its own origin, and a map from the middle of what was
    measured if its origin was not declared (it is 0, 0), else from its coordinates' zero.
    """
    form = surface
    if isinstance(surface, Surface):
        form = GridForm(surface)
        centre = assumed_axis(surface).position if centre is None else centre
    if not callable(form) or not callable(getattr(form, "gradient", None)):
        raise DataError(
            "the nominal surface must be a form of metrosep.forms (with a gradient) or a Surface, "
            f"got {type(surface).__name__}"
        )
    return _Moved(form, checked_centre(centre))


def checked_centre(centre: tuple[float, float] | None) -> tuple[float, float]:
    """Return a centre as two finite numbers; zero if None."""
    try:
        x, y = (0.0, 0.0) if centre is None else centre
    except (TypeError, ValueError):
        raise DataError(f"centre is a pair of positions (x, y) in m, got {centre!r}") from None
    return numbers.quantity(x, "x of the centre", "length"), numbers.quantity(
        y, "y of the centre", "length"
    )


def checked_place(tool: Any) -> tuple[float, float, float]:
    """Return a tool point as three numbers in m."""
    try:
        x, y, z = tool
    except (TypeError, ValueError):
        raise DataError(f"tool is a point (x, y, z) in m, got {tool!r}") from None
    x, y, z = (numbers.quantity(v, "a coordinate of the tool", "length") for v in (x, y, z))
    return x, y, z


def polar_mesh(
    surface: Any,
    *,
    radius: float,
    inner_radius: float = 0.0,
    n_rho: int = N_RHO,
    n_azimuth: int = N_AZIMUTH,
    centre: tuple[float, float] | None = None,
) -> SurfaceMesh:
    """Return midpoint radii and azimuths from 0 with their areas; points without surface omitted.

    Azimuths begin at 0, so that a symmetric surface is met symmetrically.
    """
    outer, inner = checked_radii(radius, inner_radius)
    n_rho, n_azimuth = (
        numbers.count(n_rho, "n_rho", least=2),
        numbers.count(n_azimuth, "n_azimuth", least=4),
    )
    if n_rho * n_azimuth < _FEWEST:
        raise TooFewSamplesError(
            f"a mesh of {n_rho} x {n_azimuth} points is too coarse to rank on"
        )
    form = centred_form(surface, centre)
    rho = inner + (np.arange(n_rho) + 0.5) / n_rho * (outer - inner)
    azimuth = 2.0 * np.pi * np.arange(n_azimuth) / n_azimuth
    x = (rho[:, None] * np.cos(azimuth)).ravel()
    y = (rho[:, None] * np.sin(azimuth)).ravel()
    z = form(x, y)
    slope_x, slope_y = form.gradient(x, y)
    found = np.isfinite(z) & np.isfinite(slope_x) & np.isfinite(slope_y)
    index = np.flatnonzero(found)
    if index.size < _FEWEST:
        raise TooFewSamplesError(
            f"the surface is defined at {index.size} of {x.size} points between the radii {inner} "
            f"and {outer} m; give the radius of the part in m, and a surface that covers it"
        )
    if not isinstance(surface, Surface):
        _refuse_beyond(form, surface, outer, azimuth)
    area = np.repeat(rho, n_azimuth)[index]
    x, y, z, slope_x, slope_y = (
        np.ascontiguousarray(v[index]) for v in (x, y, z, slope_x, slope_y)
    )
    weights = area / area.sum()
    for array in (x, y, z, slope_x, slope_y, weights, index, rho, azimuth):
        array.setflags(write=False)
    shape = (n_rho, n_azimuth)
    return SurfaceMesh(x, y, z, slope_x, slope_y, weights, index, shape, rho, azimuth, form)


def _refuse_beyond(form: Any, given: Any, outer: float, azimuth: FloatArray) -> None:
    """Refuse a part that reaches to or beyond the edge of its form."""

    def lost(rho: FloatArray) -> NDArray[np.bool_]:
        x, y = rho * np.cos(azimuth), rho * np.sin(azimuth)
        with np.errstate(all="ignore"):
            return np.asarray(~np.isfinite([form(x, y), *form.gradient(x, y)]).all(axis=0))

    far = np.full(azimuth.shape, outer * (1.0 + _AT_EDGE))
    beyond = lost(far)
    if not beyond.any():
        return
    near = np.full(azimuth.shape, _AT_EDGE * outer)
    while np.max(far - near) > _AT_EDGE * outer:
        middle = 0.5 * (near + far)
        off = lost(middle)
        near, far = np.where(off, near, middle), np.where(off, middle, far)
    edge = format_length(float(near[beyond].min()))
    raise DataError(
        f"the form {given!r} ends at a radius of {edge} from the axis of the part, and the part "
        f"has {format_length(outer)}: give a smaller radius, or the form of the part"
    )


def checked_radii(radius: Any, inner_radius: Any) -> tuple[float, float]:
    """Return outer and inner radius of a part in m, 0 <= inner < outer."""
    outer = numbers.quantity(radius, "radius", "length")
    inner = numbers.quantity(inner_radius, "inner_radius", "length")
    if not 0.0 <= inner < outer:
        raise InvalidSamplesError(
            f"the part lies between inner_radius = {inner} m and radius = {outer} m; "
            "0 <= inner_radius < radius is needed"
        )
    return outer, inner


# ---- where the axes stand when the tool cuts a point of the part -------------------------------
# Known for two kinds of chain: a lathe (one spindle about Z under the part, X and one axis along Z
# that carry the tool) and a machine of three linear axes. At (rho, azimuth) a lathe has its tool at
# the radius rho and its spindle at **minus** the azimuth. Any other chain needs `positions`: where its
# axes of rotation are locked, or a callable. Axes that are parked are left out.

Positions = (
    Callable[[FloatArray, FloatArray, FloatArray], Mapping[str, ArrayLike]] | Mapping[str, float]
)
"""``positions(x, y, z)`` returns the position of each axis, by name, at points of the part; a mapping
states where axes are locked while the part is cut."""

_PARALLEL = 1e-9
_ALL = 3  # directions that linear axes must reach
_ROUNDING = 1e-13
"""Of the size of the part: a place this near to zero is zero."""


def axis_positions(
    chain: Any,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    *,
    positions: Positions | None = None,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> dict[str, FloatArray]:
    """Return axis positions by name at points of the part, arrays of the shape of x."""
    if isinstance(positions, Mapping):
        return _locked(chain, x, y, z, positions, tool)
    if positions is not None:
        if not callable(positions):
            raise DataError(
                "positions is a function of x, y and z that returns the position of each axis by "
                f"name, or a mapping of axes to where they are locked, got {type(positions).__name__}"
            )
        found = positions(x, y, z)
        if not isinstance(found, Mapping):
            raise DataError(
                f"positions must return a mapping of axis names, got {type(found).__name__}"
            )
        return {name: _filled(value, x.shape, name) for name, value in found.items()}
    elements = [e for e in chain.elements if not e.parked]
    spindles = [e for e in elements if e.kind == "rotary"]
    slides = [e for e in elements if e.kind == "linear"]
    origin = np.array(tool, dtype=np.float64)
    for e in chain.elements:
        origin = origin + np.array(e.location) * (1.0 if e.branch == "tool" else -1.0)
    turned = any(e.kind == "fixed" and e.angle != 0.0 for e in elements)
    if not turned and not spindles and len(slides) == 3:
        return _three_slides(slides, origin, np.stack((x, y, z)))
    if not turned and len(spindles) == 1 and len(slides) == 2:
        found_lathe = _lathe(spindles[0], slides, origin, x, y, z)
        if found_lathe is not None:
            return found_lathe
    raise DataError(
        f"how chain {chain.name!r} reaches a point of the part is not known (it is neither a lathe "
        f"with X and Z nor three linear axes). {_how_to_lock(spindles)}In Python you can also give "
        "positions as a function of x, y, z that returns the position of each axis by name"
    )


def _how_to_lock(spindles: list[Any]) -> str:
    """Return the sentence that says what to state of a machine with axes of rotation."""
    if not spindles:
        return ""
    pairs = ", ".join(f'{e.name} = "0 deg"' for e in spindles)
    return (
        f"State where the axes of rotation are locked while the part is cut: at = {{ {pairs} }}; the one "
        "with the part on it that is not named turns it, as a spindle does. "
    )


def _locked(
    chain: Any,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    at: Mapping[str, Any],
    tool: tuple[float, float, float],
) -> dict[str, FloatArray]:
    """Return positions with axes locked where they are stated; one that is not may turn the part."""
    from metrosep.machine.inverse import inverse_kinematics

    kinds = {e.name: e.kind for e in chain.elements if e.kind != "fixed"}
    unknown = [a for a in at if a not in kinds]
    if unknown:
        raise DataError(
            f"no axis {unknown[0]!r} can be locked: the machine has {', '.join(kinds)}"
        )
    linear = [e.name for e in chain.elements if e.kind == "linear" and not e.parked]
    if len(linear) < _ALL:
        raise DataError(
            f"axes can be locked where three linear ones reach the part; the machine has {', '.join(linear)}: a "
            "lathe is ranked without it"
        )
    found_by_form = [a for a in at if kinds[a] == "linear"]
    if len(linear) - len(found_by_form) < _ALL and found_by_form:
        raise DataError(
            f"{found_by_form[0]} is a linear axis, and where it stands follows from the form; state only where "
            "axes of rotation are locked"
        )
    locked: dict[str, ArrayLike] = {
        a: numbers.quantity(v, f"{a} is locked at", "angle" if kinds[a] == "rotary" else "length")
        for a, v in at.items()
    }
    free = [e for e in chain.elements if e.kind == "rotary" and not e.parked and e.name not in at]
    if len(free) > 1 or any(e.branch != "workpiece" for e in free):
        names = ", ".join(e.name for e in free)
        raise DataError(
            f"where {names} stand while the part is cut is not stated; only one axis of rotation, which "
            f"carries the part, need not be named. {_how_to_lock(free)}".rstrip()
        )
    if free:
        locked[free[0].name] = _turned(chain, free[0], locked, x, y)
    found = inverse_kinematics(chain, np.stack((x, y, z), axis=-1), tool=tool, **locked)
    # what an axis of rotation leaves of its sine is no place of a linear one
    least = _ROUNDING * max(float(np.abs(v).max(initial=0.0)) for v in (x, y, z))
    return {
        a: v if kinds[a] == "rotary" else np.where(np.abs(v) < least, 0.0, v)
        for a, v in found.items()
    }


def _turned(
    chain: Any, spindle: Any, locked: Mapping[str, ArrayLike], x: FloatArray, y: FloatArray
) -> FloatArray:
    """Return the turn that brings each azimuth of the part under the tool on the side of +X."""
    last = [e for e in chain.elements if e.branch == "workpiece"][-1]
    if last is not spindle:
        raise DataError(
            f"{spindle.name} cannot turn the part as a spindle: {last.name} stands between them; state where "
            f"{spindle.name} is locked"
        )
    turn = float(spindle.direction[2])
    if abs(abs(turn) - 1.0) > _PARALLEL:
        raise DataError(
            f"{spindle.name} does not turn the part about its z and is not a spindle; state where it is locked"
        )
    return np.asarray(-np.sign(turn) * np.arctan2(y, x))


def _three_slides(
    slides: list[Any], origin: FloatArray, points: FloatArray
) -> dict[str, FloatArray]:
    signs = [1.0 if e.branch == "tool" else -1.0 for e in slides]
    travel = np.column_stack(
        [s * np.array(e.direction) for e, s in zip(slides, signs, strict=True)]
    )
    if abs(np.linalg.det(travel)) < _PARALLEL:
        raise DataError("the three linear axes do not reach every point: two of them are parallel")
    q = np.linalg.solve(travel, (points.reshape(3, -1) - origin[:, None]))
    return {e.name: v.reshape(points.shape[1:]) for e, v in zip(slides, q, strict=True)}


def _lathe(
    spindle: Any,
    slides: list[Any],
    origin: FloatArray,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
) -> dict[str, FloatArray] | None:
    """Return the positions of a lathe; None if the chain is not a lathe."""
    across, along = (
        [e for e in slides if abs(abs(e.direction[k]) - 1.0) < _PARALLEL] for k in (0, 2)
    )
    turn = float(spindle.direction[2])
    is_lathe = spindle.branch == "workpiece" and abs(abs(turn) - 1.0) < _PARALLEL
    if not is_lathe or len(across) != 1 or len(along) != 1:
        return None
    if abs(origin[1]) > 0.0:
        raise DataError(
            f"the tool stands {origin[1]:.3g} m beside the spindle axis and never cuts the centre; "
            "rank its offset as an error, or give positions"
        )
    signed = {
        e.name: (1.0 if e.branch == "tool" else -1.0) * float(e.direction[k])
        for e, k in ((across[0], 0), (along[0], 2))
    }
    return {
        across[0].name: (np.hypot(x, y) - origin[0]) / signed[across[0].name],
        along[0].name: (z - origin[2]) / signed[along[0].name],
        spindle.name: -np.sign(turn) * np.arctan2(y, x),
    }


def _filled(value: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    try:
        return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), shape))
    except (TypeError, ValueError):
        raise InvalidSamplesError(
            f"positions of axis {name!r} must be numbers, one per point {shape}, got shape "
            f"{np.shape(value)}"
        ) from None
