"""Points of a surface with their areas: a polar mesh, or the pixels of a map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray, as_float, frozen_float
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.middle import assumed_axis
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.stl import GridForm

__all__ = [
    "N_AZIMUTH",
    "N_RHO",
    "Positions",
    "SurfaceMesh",
    "TrialAmounts",
    "axis_positions",
    "centred_form",
    "check_amount",
    "finite_number",
    "finite_vector",
    "is_angle",
    "is_real",
    "polar_mesh",
    "positions_array",
    "real_array",
    "standard_uncertainty",
]

N_RHO, N_AZIMUTH = 300, 720

_FEWEST = 16
"""Points: fewer do not show the shape of a map."""

_AT_EDGE = 1e-9
"""Of the radius: a part this near to the edge of its form, where the slope is infinite, is on it."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMesh:
    """Points of the nominal surface, measured from the axis of the part.

    Parameters
    ----------
    x, y, z, slope_x, slope_y : ndarray, shape (n,)
        Position in m and slopes; only points at which the surface is defined.
    weights : ndarray, shape (n,)
        Area of each point seen along z, sum 1.
    index : ndarray of int, shape (n,)
        Place of each point in the whole mesh.
    shape : tuple of (int, int)
        Of the whole mesh: radii and azimuths.
    rho, azimuth : ndarray
        Radii and azimuths of the whole mesh.
    form : callable
        ``form(x, y)`` and ``form.gradient(x, y)`` from the axis of the part.
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    slope_x: FloatArray
    slope_y: FloatArray
    weights: FloatArray
    index: NDArray[np.intp]
    shape: tuple[int, int]
    rho: FloatArray
    azimuth: FloatArray
    form: Any

    @property
    def n_missing(self) -> int:
        """Points of the mesh at which the surface is not defined."""
        return self.shape[0] * self.shape[1] - self.index.size

    def whole(self, values: FloatArray) -> FloatArray:
        """Return values of the points on the whole mesh, NaN where there is no surface."""
        out = np.full((self.shape[0] * self.shape[1], *values.shape[1:]), np.nan)
        out[self.index] = values
        return out.reshape((*self.shape, *values.shape[1:]))


class _Moved:
    """A form seen from another centre."""

    def __init__(self, form: Any, centre: tuple[float, float]) -> None:
        self._form, self._centre = form, centre

    def __call__(self, x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(self._form(x + self._centre[0], y + self._centre[1]), dtype=np.float64)

    def gradient(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy."""
        along_x, along_y = self._form.gradient(x + self._centre[0], y + self._centre[1])
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
        x, y = (0.0, 0.0) if centre is None else (float(v) for v in centre)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise DataError(f"centre is a pair of finite positions (x, y) in m, got {centre!r}")
    return x, y


def polar_mesh(
    surface: Any,
    *,
    radius: float,
    inner_radius: float = 0.0,
    n_rho: int = N_RHO,
    n_azimuth: int = N_AZIMUTH,
    centre: tuple[float, float] | None = None,
) -> SurfaceMesh:
    """Return midpoint radii and azimuths from 0 with their areas; points without surface left out.

    Azimuths begin at 0, so that a symmetric surface is met symmetrically.
    """
    outer, inner = _radii(radius, inner_radius)
    n_rho, n_azimuth = _count(n_rho, "n_rho", 2), _count(n_azimuth, "n_azimuth", 4)
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
    at = [np.ascontiguousarray(v[index]) for v in (x, y, z, slope_x, slope_y)]
    mesh = SurfaceMesh(
        x=at[0],
        y=at[1],
        z=at[2],
        slope_x=at[3],
        slope_y=at[4],
        weights=area / area.sum(),
        index=index,
        shape=(n_rho, n_azimuth),
        rho=rho,
        azimuth=azimuth,
        form=form,
    )
    for name in ("x", "y", "z", "slope_x", "slope_y", "weights", "index", "rho", "azimuth"):
        getattr(mesh, name).setflags(write=False)
    return mesh


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


def _radii(radius: Any, inner_radius: Any) -> tuple[float, float]:
    is_text = isinstance(radius, str) or isinstance(inner_radius, str)
    try:
        outer, inner = (float(v) for v in ("text" if is_text else radius, inner_radius))
    except (TypeError, ValueError):
        raise DataError(f"radii are numbers in m, got {radius!r} and {inner_radius!r}") from None
    if not (math.isfinite(outer) and math.isfinite(inner) and 0.0 <= inner < outer):
        raise InvalidSamplesError(
            f"the part lies between inner_radius = {inner} m and radius = {outer} m; "
            "0 <= inner_radius < radius is needed"
        )
    return outer, inner


def _count(value: int, name: str, least: int) -> int:
    if isinstance(value, bool) or int(value) != value or value < least:
        raise TooFewSamplesError(f"{name} is a whole number of at least {least}, got {value!r}")
    return int(value)


# ---- where the axes stand when the tool cuts a point of the part -------------------------------
# Known for two kinds of chain: a lathe (one spindle about Z under the part, X and one axis along Z
# that carry the tool) and a machine of three linear axes. At (rho, azimuth) a lathe has its tool at
# the radius rho and its spindle at **minus** the azimuth. Any other chain needs a `positions`
# callable. Axes that are parked are left out; rotary axes of a five-axis machine need the callable.

Positions = Callable[[FloatArray, FloatArray, FloatArray], Mapping[str, ArrayLike]]
"""``positions(x, y, z)`` returns the position of each axis, by name, at points of the part."""

_PARALLEL = 1e-9


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
    if positions is not None:
        if not callable(positions):
            raise DataError(
                "positions is a function of x, y and z that returns the position of each axis by "
                f"name, got {type(positions).__name__}"
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
        "with X and Z nor three linear axes); give positions, a function of x, y, z that returns "
        "the position of each axis by name"
    )


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
    """Return the positions of a lathe; None if the chain is no lathe."""
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


# ---- private helpers: rigid poses as components, each a number or an array of states -----------
# A pose maps a point of its own frame into its parent: ``p_parent = R p + t``. `R` is kept as nine and
# `t` as three components; a component is a float where it is the same in every state, otherwise an
# array that broadcasts. Products with 0 and 1 are skipped, so that the 25 columns of a lathe cost a
# few passes over the states and no matrix per state.

Part = float | FloatArray
Vector = tuple[Part, Part, Part]
Matrix = tuple[Vector, Vector, Vector]

UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """Rotation and translation of one frame in another."""

    r: Matrix = UNIT
    t: Vector = ORIGIN


def as_part(value: FloatArray) -> Part:
    """Return a number where the array holds but one, so that zeros can be skipped."""
    return float(value) if value.ndim == 0 else value


def times(a: Part, b: Part) -> Part:
    """Return a*b; a plain 0 or 1 costs nothing."""
    if isinstance(a, float):
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if isinstance(b, float):
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
    return a * b


def plus(a: Part, b: Part) -> Part:
    """Return a+b; a plain 0 costs nothing."""
    if isinstance(a, float) and a == 0.0:
        return b
    if isinstance(b, float) and b == 0.0:
        return a
    return a + b


def minus(a: Part, b: Part) -> Part:
    """Return a-b; a plain 0 costs nothing."""
    if isinstance(b, float) and b == 0.0:
        return a
    if isinstance(a, float) and a == 0.0:
        return -b
    return a - b


def is_zero(a: Vector) -> bool:
    """Return whether all three components are plain zeros."""
    return all(isinstance(part, float) and part == 0.0 for part in a)


def dot(a: Vector, b: Vector) -> Part:
    """Return the scalar product."""
    return plus(plus(times(a[0], b[0]), times(a[1], b[1])), times(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product a x b."""
    return (
        minus(times(a[1], b[2]), times(a[2], b[1])),
        minus(times(a[2], b[0]), times(a[0], b[2])),
        minus(times(a[0], b[1]), times(a[1], b[0])),
    )


def add(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return plus(a[0], b[0]), plus(a[1], b[1]), plus(a[2], b[2])


def subtract(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return minus(a[0], b[0]), minus(a[1], b[1]), minus(a[2], b[2])


def scale(a: Vector, factor: Part) -> Vector:
    """Return factor * a."""
    return times(a[0], factor), times(a[1], factor), times(a[2], factor)


def turn(r: Matrix, v: Vector) -> Vector:
    """Return R v."""
    return dot(r[0], v), dot(r[1], v), dot(r[2], v)


def transpose(r: Matrix) -> Matrix:
    """Return the transpose, which is the inverse of a rotation."""
    if r is UNIT:
        return UNIT
    return (
        (r[0][0], r[1][0], r[2][0]),
        (r[0][1], r[1][1], r[2][1]),
        (r[0][2], r[1][2], r[2][2]),
    )


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices; that with the unit matrix costs nothing."""
    if a is UNIT or b is UNIT:
        return b if a is UNIT else a
    columns = transpose(b)
    return (
        (dot(a[0], columns[0]), dot(a[0], columns[1]), dot(a[0], columns[2])),
        (dot(a[1], columns[0]), dot(a[1], columns[1]), dot(a[1], columns[2])),
        (dot(a[2], columns[0]), dot(a[2], columns[1]), dot(a[2], columns[2])),
    )


def compose(a: Pose, b: Pose) -> Pose:
    """Return the pose ``a b``: first b, then a."""
    return Pose(matmul(a.r, b.r), add(a.t, turn(a.r, b.t)))


def apply(a: Pose, point: Vector) -> Vector:
    """Return the point in the parent's frame."""
    return add(a.t, turn(a.r, point))


def inverse(a: Pose) -> Pose:
    """Return the inverse of a rigid pose (orthonormal rotation)."""
    r = transpose(a.r)
    return Pose(r, scale(turn(r, a.t), -1.0))


def hat(w: Vector) -> Matrix:
    """Return the skew matrix with ``hat(w) v = w x v``."""
    x, y, z = w
    return (0.0, minus(0.0, z), y), (z, 0.0, minus(0.0, x)), (minus(0.0, y), x, 0.0)


def rotation(axis: Sequence[float], angle: Part) -> Matrix:
    """Return the right-handed rotation by `angle` about a unit axis (Rodrigues)."""
    x, y, z = (float(c) for c in axis)
    c: Part = math.cos(angle) if isinstance(angle, float) else np.cos(angle)
    s: Part = math.sin(angle) if isinstance(angle, float) else np.sin(angle)
    v = minus(1.0, c)

    def own(n: float) -> Part:
        return 1.0 if n * n == 1.0 else plus(c, times(n * n, v))

    def mixed(ab: float, n: float) -> Part:
        return plus(times(ab, v), times(n, s))

    return (
        (own(x), mixed(x * y, -z), mixed(x * z, y)),
        (mixed(x * y, z), own(y), mixed(y * z, -x)),
        (mixed(x * z, -y), mixed(y * z, x), own(z)),
    )


# ---- private helper: numbers that a person typed or measured; texts, truth values and dates are none ----
# numpy takes True for 1, "0.01" for 0.01 and None for NaN. Of a position or an error of a machine
# each of these is a slip that no result would show.

LARGEST = {"m": 1.0, "rad": 1.0}
"""Amounts of error terms above these are other units: um as m, degrees as rad. Units themselves pass."""

_HINTS = {
    "m": "lengths are in m, 5 um are 5e-6",
    "rad": "angles are in rad, 0.5 degrees are 0.00873 and 1 arc second 4.85e-6",
}


class TrialAmounts(dict[str, float]):
    """Amounts that a fit tries, by term: on its way they may be larger than those of a machine."""


def is_real(value: object) -> bool:
    """Return whether a value is one real number: not a truth value, a text, a date, an array."""
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf" and not np.ma.is_masked(value)
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(
        value, bool
    )


def finite_number(value: Any, name: str) -> float:
    """Return a finite real number as a float."""
    if np.iscomplexobj(value):
        raise InvalidSamplesError(f"{name} must be real, got {value!r}")
    if not is_real(value):
        raise InvalidSamplesError(
            f"{name} must be a number in SI, got {value!r} of type {type(value).__name__}"
        )
    number = float(value)
    if not math.isfinite(number):
        raise InvalidSamplesError(f"{name} is {number}; leave out a term that was not measured")
    return number


def standard_uncertainty(value: Any) -> float:
    """Return a standard uncertainty as a float, refusing negative ones."""
    number = finite_number(value, "standard uncertainty of a term")
    if number < 0.0:
        raise InvalidSamplesError(f"standard uncertainty of a term is {number}; it must be >= 0")
    return number


def real_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN and infinities kept."""
    _refuse_no_numbers(values, name)
    try:
        array = as_float(values)
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    return array


def positions_array(values: Any, name: str) -> FloatArray:
    """Return real numbers as a new float64 array, NaN kept; infinities are refused."""
    array = real_array(values, name)
    if np.isinf(array).any():
        first = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        where = f" at index {first}" if first else ""
        raise InvalidSamplesError(f"{name} is infinite{where}")
    return array


def finite_vector(values: Sequence[float], name: str) -> tuple[float, ...]:
    """Return finite real numbers of one dimension as a tuple."""
    _refuse_no_numbers(values, name)
    array = frozen_float(values, name=name, ndim=1)
    if np.isnan(array).any():
        raise InvalidSamplesError(
            f"{name} hold NaN at index {int(np.argmax(np.isnan(array)))}; leave out what was not "
            "measured"
        )
    return tuple(array.tolist())


def is_angle(term: str) -> bool:
    """Return whether the ISO 230-1 name is that of an angle: EAX, ECC, B0Z."""
    return term.removeprefix("E")[:1] in ("A", "B", "C")


def check_amount(term: str, values: FloatArray, what: str) -> None:
    """Refuse amounts of a term that only another unit explains."""
    unit = "rad" if is_angle(term) else "m"
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST[unit]:
        raise UnitError(
            f"{what} is {largest:.6g} {unit}; above {LARGEST[unit]:g} {unit} it is no error of a "
            f"machine: {_HINTS[unit]}"
        )


def _refuse_no_numbers(values: Any, name: str) -> None:
    """Refuse what numpy would take for numbers; complex ones are left to `as_float`."""
    try:
        kind = np.asarray(values).dtype.kind
    except ValueError as exc:
        raise InvalidSamplesError(f"{name} must be real numbers in SI: {exc}") from None
    mixed = isinstance(values, list | tuple) and any(
        isinstance(v, bool | np.bool_) for v in values
    )
    if kind not in "iufc" or mixed:
        raise InvalidSamplesError(
            f"{name} must be real numbers in SI, got {str(values)[:40]!r} of type "
            f"{type(values).__name__}; write NaN where nothing was measured"
        )
