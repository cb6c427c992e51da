"""What every form can do: height, gradient, and the derivative by each of its parameters.

A form is an ideal surface ``z = f(x, y)``, z up out of the material, SI, with its own origin at
its vertex or centre. It is frozen: `with_parameters` returns another one. A parameter given as
None is not known yet, and a fit determines it. Outside the domain of a form (beyond the equator of
a sphere) heights and derivatives are NaN. A profile is the line ``y = 0``.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError
from metrosep.core.numbers import real


class Form(ABC):
    """An ideal surface.

    Attributes
    ----------
    name : str
        Word for messages and history, such as ``"conic"``.
    units : mapping of str to str
        SI unit of each parameter, in their order.
    has_centre : bool
        Whether the form has a vertex or centre, which a fit puts in the middle of what was
        measured, on a map that declares no origin; periodic forms and polynomials have none.
    is_everywhere : bool
        Whether the form has a height at every point, so that no valid point is omitted.
    is_linear : bool
        Whether the heights are linear in all parameters.
    radii : tuple of str
        Parameters that are radii of curvature. A fit looks for 1/R, which is zero for a flat and
        has no pole there.
    weak : tuple of str
        Parameters that move no height of a flat part. A fit holds one that is not known to 1 (a
        conic constant) or to 1 rad.
    """

    name: str = "form"
    units: Mapping[str, str] = {}
    has_centre: bool = True
    is_everywhere: bool = False
    is_linear: bool = False
    radii: tuple[str, ...] = ()
    weak: tuple[str, ...] = ()

    @property
    @abstractmethod
    def parameters(self) -> dict[str, float | None]:
        """Shape parameters by name, SI; None where not known yet."""

    @property
    def spanned(self) -> frozenset[str]:
        """Rigid-body freedoms that the parameters already hold."""
        return frozenset()

    @property
    def period(self) -> tuple[float, float] | None:
        """Period along x and y, m; None for a form that does not repeat."""
        return None

    @abstractmethod
    def with_parameters(self, **values: float) -> Form:
        """Return the form with other values of some parameters.

        Parameters
        ----------
        **values : float
            By name, SI.

        Returns
        -------
        Form
            Another one of the same kind and domain; this one stays as it is.

        Raises
        ------
        DataError
            If a name is unknown or a value is not allowed.
        """

    @abstractmethod
    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return z at points of equal shape, float64; NaN outside the domain.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        ndarray, m
            Heights. A polynomial has them outside its domain too, where it soon goes astray.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """

    @abstractmethod
    def slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points of equal shape; NaN where there is none.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame.

        Returns
        -------
        tuple of ndarray
            Slopes, dimensionless.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """

    @abstractmethod
    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        """Return dz/dp for each named parameter; NaN where there is none.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.

        Returns
        -------
        list of ndarray
            In the order of the names, m per unit of the parameter.

        Raises
        ------
        DataError
            If a name is unknown or a parameter is not known yet.
        """

    def expansion(
        self, x: FloatArray, y: FloatArray, names: Sequence[str], *, slopes: bool
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray] | None, list[FloatArray]]:
        """Return heights, slopes and derivatives at once; a form may share work between them.

        Parameters
        ----------
        x, y : ndarray, m
            Positions in the form's frame, of equal shape.
        names : sequence of str
            Of parameters.
        slopes : bool
            Whether slopes are wanted.

        Returns
        -------
        height : ndarray, m
            As `height`.
        slopes : tuple of ndarray or None
            As `slopes`.
        derivatives : list of ndarray
            As `derivatives`.

        Raises
        ------
        DataError
            If a name is unknown or a parameter is not known yet.
        """
        return (
            self.height(x, y),
            self.slopes(x, y) if slopes else None,
            self.derivatives(x, y, names) if names else [],
        )

    def units_of(self) -> dict[str, str]:
        """Return the unit of each parameter; those of the class unless they depend on the form."""
        units = self.units
        return {k: units[k] for k in self.parameters}

    def start(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Form:
        """Return the form with values for its unknown parameters, good enough to start a fit.

        Parameters
        ----------
        x, y, z : ndarray, shape (n,), m
            Valid points, x and y from the assumed centre; no NaN.

        Returns
        -------
        Form
            Without unknown parameters.

        Raises
        ------
        DataError
            If a parameter is unknown and the form has no rule to guess it.
        TooFewSamplesError
            If there are too few points to guess, 4 for a curved form.
        DegenerateFitError
            If the points show no guess: all at the centre, on too few positions along an axis whose
            radius is not known, or not enough for the coefficients.
        """
        unknown = [k for k, v in self.parameters.items() if v is None]
        if unknown:
            raise DataError(
                f"{self.name} has no value for {', '.join(unknown)} and no rule to guess one; "
                "give a starting value"
            )
        return self

    def __call__(self, x: ArrayLike, y: ArrayLike = 0.0) -> FloatArray:
        """Return z at points that broadcast; NaN outside the domain."""
        xs, ys, shape = self._points(x, y)
        return self.height(xs, ys).reshape(shape)

    def gradient(self, x: ArrayLike, y: ArrayLike = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return dz/dx and dz/dy at points that broadcast; NaN outside the domain.

        Parameters
        ----------
        x, y : array_like, m
            Positions in the form's frame.

        Returns
        -------
        tuple of ndarray
            Slopes, dimensionless.

        Raises
        ------
        DataError
            If a parameter is not known yet.
        """
        xs, ys, shape = self._points(x, y)
        along_x, along_y = self.slopes(xs, ys)
        return along_x.reshape(shape), along_y.reshape(shape)

    def _known(self, *names: str) -> list[float]:
        """Return the values of parameters; one that is not known yet is an error."""
        values = [self.parameters[n] for n in names]
        unknown = [n for n, v in zip(names, values, strict=True) if v is None]
        if unknown:
            raise DataError(
                f"{self.name} has no value for {', '.join(unknown)} yet: give one, or fit it"
            )
        return [float(v) for v in values if v is not None]

    def _points(
        self, x: ArrayLike, y: ArrayLike
    ) -> tuple[FloatArray, FloatArray, tuple[int, ...]]:
        self._known(*self.parameters)
        xs, ys = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        )
        return np.atleast_1d(xs.copy()), np.atleast_1d(ys.copy()), xs.shape

    def __repr__(self) -> str:
        inside = ", ".join(
            f"{k}={'?' if v is None else format(v, '.6g')}" for k, v in self.parameters.items()
        )
        return f"{type(self).__name__}({inside})"


def checked(
    value: float | str | None, name: str, *, zero: bool = True, dimension: str | None = None
) -> float | None:
    """Return a parameter as a finite float, or None where it is not known yet."""
    if value is None:
        return None
    number = real(value, name, dimension=dimension, finite=False)
    if not math.isfinite(number) or (number == 0.0 and not zero):
        raise DataError(f"{name} must be finite{'' if zero else ' and not zero'}, got {value}")
    return number


# ---- what shapes with a few named parameters share: frozen fields, names checked, curvature guessed ----
# A subclass is a frozen dataclass whose parameters are fields named as in `units`, which says their
# dimension too. It writes `_derivatives`; this class checks the names before.


class Shape(Form):
    """A form whose parameters are fields of a frozen dataclass."""

    @property
    def parameters(self) -> dict[str, float | None]:
        """Shape parameters by name, SI; None where not known yet."""
        return {name: getattr(self, name) for name in self.units}

    def with_parameters(self, **values: float) -> Self:
        self._check_names(values)
        return cast(Self, dataclasses.replace(cast(Any, self), **values))

    def derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        self._check_names(names)
        return self._derivatives(x, y, names)

    def __post_init__(self) -> None:
        for name, unit in self.units.items():
            dimension = {"m": "length", "rad": "angle"}.get(unit)
            zero = name not in self.radii
            value = checked(getattr(self, name), name, zero=zero, dimension=dimension)
            self._set(**{name: value})

    @abstractmethod
    def _derivatives(self, x: FloatArray, y: FloatArray, names: Sequence[str]) -> list[FloatArray]:
        """Return dz/dp for parameters that exist."""

    def _check_names(self, names: Any) -> None:
        strange = [n for n in names if n not in self.parameters]
        if strange:
            have = ", ".join(self.parameters) or "none"
            raise DataError(
                f"{self.name} has no parameter {', '.join(map(str, strange))}; there are: {have}"
            )

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)


def root(square: FloatArray) -> FloatArray:
    """Return the square root in place, NaN where negative, without a warning."""
    outside = square < 0.0
    if outside.any():
        square[outside] = np.nan
    return np.sqrt(square, out=square)


def positive_root(square: FloatArray) -> FloatArray:
    """Return the square root in place, NaN where not positive: what a derivative divides by."""
    outside = square <= 0.0
    if outside.any():
        square[outside] = np.nan
    return np.sqrt(square, out=square)


# ---- where a form sits: deviations of points from a placed form, and their derivatives ---------
# ``tilt="plane"`` adds a plane, ``z = f(x - s) + p + t (x, y)``, as interferometer software does.
# ``tilt="rotation"`` turns the form as a rigid body; then tilt_x and tilt_y are the slopes of its
# base plane, which agree with the former to first order. The difference is ``t . grad(f) f``: for a
# lens it is not a plane, and looks like coma.

Tilt = Literal["plane", "rotation"]
Direction = Literal["vertical", "normal"]

_FOOT_STEPS, _FOOT_SHARE = 50, 1e-15
"""The foot of a normal has settled when it moves by less than this share of the coordinates."""

_STEP = 1e-30
"""Complex step: the derivative of a 3 x 3 matrix is exact to the last digit."""


def rotation_matrix(tilt_x: Any, tilt_y: Any, rotation_z: Any) -> NDArray[Any]:
    """Return the matrix that takes coordinates of the form to those of the measurement."""
    length = (1.0 + tilt_x * tilt_x + tilt_y * tilt_y) ** 0.5
    nx, ny, nz = -tilt_x / length, -tilt_y / length, 1.0 / length
    k = 1.0 / (1.0 + nz)
    lean = np.array(
        [
            [1.0 - k * nx * nx, -k * nx * ny, nx],
            [-k * nx * ny, 1.0 - k * ny * ny, ny],
            [-nx, -ny, nz],
        ]
    )
    c, s = np.cos(rotation_z), np.sin(rotation_z)
    zero, one = 0.0 * c, 1.0 + 0.0 * c
    turn = np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]])
    return np.asarray(lean @ turn)


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A form at a place; `is_line` looks for the nearest point along a profile only."""

    form: Form
    rigid: Mapping[str, float]
    tilt: Tilt = "plane"
    direction: Direction = "vertical"
    is_line: bool = False

    def get(self, name: str) -> float:
        """Return the value of a rigid-body freedom."""
        return float(self.rigid.get(name, 0.0))

    def deviation(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Return measured minus ideal; NaN outside the domain of the form."""
        if self.direction == "normal":
            return self._foot(x, y, z)[1]
        xf, yf, zf = self._to_form(x, y, z)
        return np.asarray(zf - self.form.height(xf, yf))

    def linearised(
        self,
        x: FloatArray,
        y: FloatArray,
        z: FloatArray,
        rigid: Sequence[str],
        shape: Sequence[str],
    ) -> FloatArray:
        """Return derivatives of the ideal height by what is free (rows), and the deviations (last row).

        The derivative by a radius of curvature is that by 1/R, which has no pole. By the envelope
        theorem the derivative of the distance is that of the height at the foot of the normal, over
        ``sqrt(1 + |slope|^2)``: no second derivative of the form is needed.
        """
        if self.direction == "normal":
            on_form, distance, secant = self._foot(x, y, z)
            block = replace(self, direction="vertical").linearised(*on_form, rigid, shape)
            block /= secant
            block[-1] = distance
            return block
        xf, yf, zf = self._to_form(x, y, z)
        block = np.empty((len(rigid) + len(shape) + 1, x.size))
        is_level = set(rigid) <= {"piston", "tilt_x", "tilt_y"} and self.tilt == "plane"
        wanted = bool(rigid and not is_level)
        height, slopes, derived = self.form.expansion(xf, yf, shape, slopes=wanted)
        np.subtract(zf, height, out=block[-1])
        gx, gy = slopes if slopes is not None else (height, height)
        add = self._plane_columns if self.tilt == "plane" else self._rotation_columns
        add(block, rigid, (x, y, z), (xf, yf), (gx, gy))
        for row, (name, column) in enumerate(zip(shape, derived, strict=True), start=len(rigid)):
            block[row] = column
            if name in self.form.radii:  # dz/dc = -R^2 dz/dR with c = 1/R
                block[row] *= -(float(self.form.parameters[name] or 0.0) ** 2)
        return block

    def _foot(
        self, x: FloatArray, y: FloatArray, z: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], FloatArray, FloatArray]:
        """Return the nearest points of the form, the signed distances, and ``sqrt(1 + slope^2)``.

        Each step goes to the foot on the tangent plane; it shrinks the error by the deviation over
        the radius of curvature.
        """
        turned = self.tilt == "rotation"
        if turned:
            x, y, z = self._to_form(x, y, z)
        u, v = x.copy(), y.copy()
        reach = float(np.nanmax(np.abs(z), initial=0.0)) + float(np.abs(x).max(initial=0.0))
        h, mu, mv = self._surface(u, v)
        for _ in range(_FOOT_STEPS):
            dw = z - h
            a, b = x - u + mu * dw, y - v + mv * dw
            k = (mu * a + mv * b) / (1.0 + mu * mu + mv * mv)
            a -= mu * k
            b -= mv * k
            u += a
            if not self.is_line:
                v += b
            h, mu, mv = self._surface(u, v)
            moved = np.abs(a) if self.is_line else np.maximum(np.abs(a), np.abs(b))
            if not float(np.fmax.reduce(moved, axis=None, initial=0.0)) > _FOOT_SHARE * reach:
                break
        secant = np.sqrt(1.0 + mu * mu + mv * mv)
        distance = ((z - h) - mu * (x - u) - mv * (y - v)) / secant
        if turned:
            R = rotation_matrix(*(self.get(n) for n in ("tilt_x", "tilt_y", "rotation_z")))
            shift = [self.get(n) for n in ("shift_x", "shift_y", "piston")]
            u, v, h = (R[i, 0] * u + R[i, 1] * v + R[i, 2] * h + shift[i] for i in range(3))
        return (u, v, h), distance, secant

    def _surface(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return height and slopes in the frame where `_foot` works."""
        if self.tilt == "rotation":
            gx, gy = self.form.slopes(x, y)
            return self.form.height(x, y), gx, np.zeros_like(gy) if self.is_line else gy
        xf, yf, minus = self._to_form(x, y, np.zeros_like(x))
        gx, gy = self.form.slopes(xf, yf)
        c, s = np.cos(self.get("rotation_z")), np.sin(self.get("rotation_z"))
        mu = c * gx - s * gy + self.get("tilt_x")
        mv = np.zeros_like(mu) if self.is_line else s * gx + c * gy + self.get("tilt_y")
        return self.form.height(xf, yf) - minus, mu, mv

    def _to_form(
        self, x: FloatArray, y: FloatArray, z: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        sx, sy, turn = self.get("shift_x"), self.get("shift_y"), self.get("rotation_z")
        tx, ty = self.get("tilt_x"), self.get("tilt_y")
        if self.tilt == "plane":
            zf = z - (self.get("piston") + tx * x + ty * y) if tx or ty else z - self.get("piston")
            xs, ys = (x - sx if sx else x), (y - sy if sy else y)
            if turn:
                c, s = np.cos(turn), np.sin(turn)
                xs, ys = c * xs + s * ys, c * ys - s * xs
            return np.ascontiguousarray(xs), np.ascontiguousarray(ys), zf
        R = rotation_matrix(tx, ty, turn)
        p = (x - sx, y - sy, z - self.get("piston"))
        xf, yf, zf = (R[0, i] * p[0] + R[1, i] * p[1] + R[2, i] * p[2] for i in range(3))
        return xf, yf, zf

    def _plane_columns(
        self,
        jacobian: FloatArray,
        rigid: Sequence[str],
        points: tuple[FloatArray, FloatArray, FloatArray],
        placed: tuple[FloatArray, FloatArray],
        slopes: tuple[FloatArray, FloatArray],
    ) -> None:
        x, y, _ = points
        turn = self.get("rotation_z")
        c, s = np.cos(turn), np.sin(turn)
        for row, name in enumerate(rigid):
            if name == "piston":
                jacobian[row] = 1.0
            elif name == "tilt_x":
                jacobian[row] = x
            elif name == "tilt_y":
                jacobian[row] = y
            elif name == "shift_x":
                jacobian[row] = s * slopes[1] - c * slopes[0]
            elif name == "shift_y":
                jacobian[row] = -s * slopes[0] - c * slopes[1]
            else:
                jacobian[row] = slopes[0] * placed[1] - slopes[1] * placed[0]

    def _rotation_columns(
        self,
        jacobian: FloatArray,
        rigid: Sequence[str],
        points: tuple[FloatArray, FloatArray, FloatArray],
        placed: tuple[FloatArray, FloatArray],
        slopes: tuple[FloatArray, FloatArray],
    ) -> None:
        del placed
        angles = [self.get(n) for n in ("tilt_x", "tilt_y", "rotation_z")]
        R = rotation_matrix(*angles)
        x = points[0] - self.get("shift_x")
        y = points[1] - self.get("shift_y")
        z = points[2] - self.get("piston")
        gx, gy = slopes
        for row, name in enumerate(rigid):
            if name in ("piston", "shift_x", "shift_y"):
                axis = ("shift_x", "shift_y", "piston").index(name)
                jacobian[row] = R[axis, 2] - gx * R[axis, 0] - gy * R[axis, 1]
                continue
            which = ("tilt_x", "tilt_y", "rotation_z").index(name)
            moved: list[complex] = list(angles)
            moved[which] = angles[which] + 1j * _STEP
            D = rotation_matrix(*moved).imag / _STEP
            dx, dy, dz = (D[0, i] * x + D[1, i] * y + D[2, i] * z for i in range(3))
            jacobian[row] = gx * dx + gy * dy - dz


# ---- names of the rigid-body freedoms, and which parameters a fit may move ---------------------
# ``piston`` moves the form along z, ``shift_x`` and ``shift_y`` across it, ``tilt_x`` and ``tilt_y``
# are the slopes dz/dx and dz/dy of its base plane, ``rotation_z`` turns it about its own axis
# (counter-clockwise seen from +z).

RIGID = {
    "piston": "m",
    "tilt_x": "rad",
    "tilt_y": "rad",
    "shift_x": "m",
    "shift_y": "m",
    "rotation_z": "rad",
}
"""Rigid-body freedoms and their units."""

DEFAULT = ("piston", "tilt_x", "tilt_y")

_ALIASES = {
    "dz": "piston",
    "z0": "piston",
    "tx": "tilt_x",
    "ty": "tilt_y",
    "dx": "shift_x",
    "x0": "shift_x",
    "decentre_x": "shift_x",
    "decenter_x": "shift_x",
    "dy": "shift_y",
    "y0": "shift_y",
    "decentre_y": "shift_y",
    "decenter_y": "shift_y",
    "rz": "rotation_z",
    "clocking": "rotation_z",
}


@dataclass(frozen=True, slots=True)
class Freedoms:
    """What a fit moves and what it holds."""

    rigid: tuple[str, ...]  # free rigid-body freedoms, in the order of `RIGID`
    shape: tuple[str, ...]  # free parameters of the form, in its order
    # mapping of str to float: rigid-body freedoms held at a value other than zero
    held: Mapping[str, float]
    notes: tuple[str, ...] = ()  # what the caller should know
    # what was asked for and is held, since the points do not determine it
    warnings: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All free parameters, rigid ones first."""
        return (*self.rigid, *self.shape)


def choose_freedoms(
    form: Form, free: Sequence[str] | None, fixed: Mapping[str, float], *, same: str
) -> tuple[Form, Freedoms]:
    """Return the form with its fixed values, and what is free where the coordinates `same` are constant."""
    held = known_values(fixed, form, "fixed")
    unknown = [k for k, v in form.parameters.items() if v is None and k not in held]
    is_open = form.is_linear and bool(unknown)
    asked = _asked(form, free, default=() if is_open and form.spanned else DEFAULT)
    for along in same:
        across = [n for n in asked if n in (f"tilt_{along}", f"shift_{along}", "rotation_z")]
        if free is not None and across:
            raise DataError(
                f"all points have the same {along}, so there is no {', '.join(across)}; leave it out "
                "of free"
            )
        asked = [n for n in asked if n not in across]
    if free is None:  # what is held gives way for nothing that was not asked for
        asked = [n for n in asked if n not in held]
    both = [n for n in asked if n in held]
    if both:
        raise DataError(f"{', '.join(both)} is free and fixed at once; name it once")
    values = {k: v for k, v in held.items() if k in form.parameters}
    shape = tuple(k for k in form.parameters if k in asked or k in unknown)
    spanned = form.spanned if is_open else frozenset()
    rigid = tuple(n for n in RIGID if n in asked and n not in spanned)
    dropped = [n for n in asked if n in spanned]
    notes = (
        (f"{', '.join(dropped)} is part of {form.name}: its coefficients hold it",)
        if dropped
        else ()
    )
    rest = {k: v for k, v in held.items() if k in RIGID}
    return (form.with_parameters(**values) if values else form), Freedoms(
        rigid, shape, rest, notes
    )


def known_values(values: Mapping[str, float], form: Form, option: str) -> dict[str, float]:
    """Return values by the proper name of each freedom."""
    if not isinstance(values, Mapping):
        raise DataError(
            f"{option} maps names to values in SI, such as {{'R': 0.05}}; got {values!r}"
        )
    found: dict[str, float] = {}
    units = {**RIGID, **form.units_of()}
    for name, value in values.items():
        key = _known(name, form)
        if key in found:
            raise DataError(f"{option} holds {key} twice, by two of its names")
        dimension = {"m": "length", "rad": "angle"}.get(units.get(key, ""))
        found[key] = real(value, f"{option}[{name!r}]", dimension=dimension, what="a number in SI")
    return found


def _asked(form: Form, free: Sequence[str] | None, default: tuple[str, ...]) -> list[str]:
    if free is None:
        return list(default)
    if not isinstance(free, str | Iterable):
        raise DataError(f"free is a list of names, got {free!r}")
    names = [_known(n, form) for n in ((free,) if isinstance(free, str) else free)]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(f"{', '.join(twice)} is given twice in free")
    return names


def _known(name: str, form: Form) -> str:
    if not isinstance(name, str):
        raise DataError(f"a freedom is named by a text, got {name!r}")
    if name in form.parameters or name in RIGID:
        return name
    if name in _ALIASES:
        return _ALIASES[name]
    names = ", ".join((*RIGID, *form.parameters))
    raise DataError(f"{form.name} has no freedom {name!r}; there are: {names}")
