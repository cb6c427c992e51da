"""The XY plane as a sum of two straightness errors and two alignments (Kono 2008, eq. 1 to 3).

``e(x, y) = e_z(x) + e_z(y) + alpha (y - y0) + beta (x - x0)``. Error = actual - nominal along +z;
rows of a map grow with y and columns with x. The sum has no term in which x and y act together;
`fit_plane_model` measures how much of a map is such coupling.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError, UnitError
from metrosep.core.methods import Results
from metrosep.core.numbers import real
from metrosep.core.options import Option
from metrosep.core.profile import Profile, html_table
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation._readings import real_numbers
from metrosep.separation.contract import NamedMethod, StoredResult
from metrosep.separation.planes.plane_fit import described, plane_origin, plane_steps
from metrosep.separation.runs.base import ErrorEstimate


class AxesCombined(NamedMethod):
    """`plane_map` by its name, from the stored results of two axes."""

    name = "plane_map"
    what = "error of an XY plane from the results of its two axes (result.json of X, of Y)"
    reads = "results"
    readings = ("of the axis along x", "of that along y")
    accepts = ("ErrorEstimate",)
    arguments: ClassVar[Mapping[str, Option]] = {
        "dx": Option("size", required=True, help="step of the map along x"),
        "dy": Option("size", required=True, help="step of the map along y"),
        "alpha": Option("angle", help="alignment of the axis along y"),
        "beta": Option("angle", help="alignment of the axis along x"),
        "u_alpha": Option("angle", help="standard uncertainty of alpha"),
        "u_beta": Option("angle", help="standard uncertainty of beta"),
        "origin": Option("lengths", help="x and y where both alignments are zero"),
        "reference": Option(
            "lengths",
            help="x and y where the map is zero, so that error and uncertainty are those of the difference from there",
        ),
    }

    @classmethod
    def from_inputs(cls, data: Results, options: Mapping[str, Any]) -> Any:
        """Return the sum of the errors of two axes."""
        rest = dict(options)
        for name in ("alpha", "beta"):
            u = rest.pop(f"u_{name}", None)
            if u is not None:
                value = rest.get(name, 0.0)
                rest[name] = Quantity(value, "rad", f"{name}, as stated", u=u, symbol=name)
        for name in ("origin", "reference"):
            if name in rest and len(rest[name]) != 2:
                raise DataError(f'{name} is x and y: {name} = ["0 mm", "0 mm"]')
        return super().from_inputs(data, rest)


_LARGEST_SLOPE = 0.02
"""rad; alignments of axes are below a degree, larger ones are degrees or arc seconds."""

_MOST_PIXELS = 10_000_000


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlaneMap(StoredResult):
    """Error of an XY plane with its standard uncertainty.

    Parameters
    ----------
    surface : Surface, m
        ``e(x, y) = actual - nominal``; the correction is its negative.
    u : Surface, m
        Standard uncertainty; NaN where that of an axis is not known.
    alpha, beta : Quantity, rad
        Alignment along y and along x, as used.
    audit : mapping
        What was added and what is not in the map.
    messages : tuple of str
        What the user should know.
    pv : Quantity, m, optional
        P-V of the map; its u is that of the difference of the two extremes.
    """

    surface: Surface
    u: Surface
    alpha: Quantity
    beta: Quantity
    audit: Mapping[str, Any] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    pv: Quantity | None = None

    def __repr__(self) -> str:
        n_y, n_x = self.surface.shape
        return f"PlaneMap({n_y} x {n_x} points, {described(self.surface.z, self.u.z)})"

    def _repr_html_(self) -> str:
        """Return a small table for notebooks."""
        rows = {
            "error": described(self.surface.z, self.u.z),
            "alpha": str(self.alpha),
            "beta": str(self.beta),
        }
        rows.update({f"message {i + 1}": m for i, m in enumerate(self.messages)})
        return html_table("Error of a plane", rows)

    @property
    def x(self) -> FloatArray:
        """Positions of the columns, m."""
        return _axis(self.surface.origin[0], self.surface.dx, self.surface.shape[1])

    @property
    def y(self) -> FloatArray:
        """Positions of the rows, m."""
        return _axis(self.surface.origin[1], self.surface.dy, self.surface.shape[0])


def plane_map(
    along_x: ErrorEstimate | Profile,
    along_y: ErrorEstimate | Profile,
    *,
    dx: float,
    dy: float,
    alpha: float | Quantity = 0.0,
    beta: float | Quantity = 0.0,
    origin: tuple[float, float] | None = None,
    u_x: ArrayLike | Profile | None = None,
    u_y: ArrayLike | Profile | None = None,
    reference: tuple[float, float] | None = None,
) -> PlaneMap:
    """Return the error of an XY plane as the sum of the errors of its two axes.

    Parameters
    ----------
    along_x : ErrorEstimate or Profile, m
        Error in z over the travel in x.
    along_y : ErrorEstimate or Profile, m
        Error in z over the travel in y.
    dx, dy : float, m
        Steps of the map; its last point is the last one inside the range.
    alpha, beta : float or Quantity, rad, optional
        Alignment ``alpha_yz`` along y and ``beta_zx`` along x: positive lifts z towards larger y
        or x. A Quantity brings its standard uncertainty.
    origin : tuple of (float, float), m, optional
        Where alpha and beta add nothing (start of machining); the corner of smallest x and y.
    u_x, u_y : float, array_like or Profile, m, optional
        Standard uncertainty of the axes where they are profiles; one value, one for each sample,
        or a profile over position.
    reference : tuple of (float, float), m, optional
        Where the map is zero, a point of its grid: error and u are then those of the difference from
        there, as in a compensation map of this reference.

    Returns
    -------
    PlaneMap
        Map, uncertainty map and P-V.

    Raises
    ------
    DataError
        If an axis is neither an estimate nor a profile, a step is not positive or gives fewer
        than two points, an alignment or the origin is not a finite number, or the reference is not
        a measured point of the grid.
    InvalidSamplesError
        If an uncertainty is not real, negative or of another length.
    UnitError
        If an alignment is above 0.02 rad.

    Notes
    -----
    Eq. 3 with the uncertainties combined as independent:
    ``u^2 = u_x(x)^2 + u_y(y)^2 + (y - y0)^2 u_alpha^2 + (x - x0)^2 u_beta^2``. Of the difference of
    two points u_x^2 becomes ``var(x) + var(x') - 2 cov(x, x')`` with the covariance of an estimate
    (profiles have none: their samples count as independent), (x - x0) becomes (x - x'), and so for y.
    Null space: piston;
    alignment, unless given (the slope of an estimate is that of axis and artefact together); and
    all coupling of x and y. Outside the measured range, and at NaN of a profile, the map is NaN.
    Profiles are interpolated linearly, and not across a gap.

    References
    ----------
    .. [1] A. Kono et al., Int. J. Mach. Tools Manuf. 48 (2008), eq. 1 to 3.

    Examples
    --------
    >>> x = Profile([0.0, 1e-3, 2e-3], [0.0, 3e-9, 0.0])
    >>> y = Profile([0.0, 1e-3], [0.0, 5e-9])
    >>> plane = plane_map(x, y, dx=1e-3, dy=1e-3, alpha=1e-6)
    >>> (plane.surface.z * 1e9).round(6).tolist()
    [[0.0, 3.0, 0.0], [6.0, 9.0, 6.0]]
    """
    dx, dy = plane_steps(dx, dy)
    xs, e_x, s_x = _sampled(along_x, dx, u_x, "x")
    ys, e_y, s_y = _sampled(along_y, dy, u_y, "y")
    if xs.size * ys.size > _MOST_PIXELS:
        raise DataError(
            f"a map of {ys.size} x {xs.size} points is too large; dx and dy are in m, choose "
            "larger steps"
        )
    x0, y0 = (float(xs[0]), float(ys[0])) if origin is None else plane_origin(origin)
    alpha_q, beta_q = _alignment(alpha, "alpha"), _alignment(beta, "beta")
    z = (e_x + beta_q.value * (xs - x0))[np.newaxis, :] + (e_y + alpha_q.value * (ys - y0))[
        :, np.newaxis
    ]
    u_tilt_x = (xs - x0) * (beta_q.u or 0.0)
    u_tilt_y = (ys - y0) * (alpha_q.u or 0.0)
    u = np.sqrt((s_x**2 + u_tilt_x**2)[np.newaxis, :] + (s_y**2 + u_tilt_y**2)[:, np.newaxis])
    axes = (
        _Axis(along_x, xs, s_x, beta_q.u or 0.0),
        _Axis(along_y, ys, s_y, alpha_q.u or 0.0),
    )
    if reference is not None:
        at = tuple(
            _node(a.grid, p, name)
            for a, p, name in zip(axes, plane_origin(reference), "xy", strict=True)
        )
        if np.isnan(z[at[1], at[0]]):
            raise DataError("the reference lies in a gap of an axis; name a measured point")
        z = z - z[at[1], at[0]]
        away = [a.square_from(i) for a, i in zip(axes, at, strict=True)]
        u = np.sqrt(away[0][np.newaxis, :] + away[1][:, np.newaxis])
    u[np.isnan(z)] = np.nan
    history = (
        *along_x.history,
        *along_y.history,
        Step("plane_map", {"alpha_rad": alpha_q.value, "beta_rad": beta_q.value}),
    )
    corner = (float(xs[0]), float(ys[0]))
    audit = {
        "model": "e(x) + e(y) + alpha (y - y0) + beta (x - x0)",
        "alpha_urad": alpha_q.value * 1e6,
        "beta_urad": beta_q.value * 1e6,
        "origin_mm": [x0 * 1e3, y0 * 1e3],
        "reference_mm": None if reference is None else [v * 1e3 for v in plane_origin(reference)],
        "not_in_the_model": ["piston", "coupling of x and y"],
    }
    return PlaneMap(
        Surface(z, dx, dy, origin=corner, history=history),
        Surface(u, dx, dy, origin=corner, history=history),
        alpha_q,
        beta_q,
        audit,
        _messages(along_x, along_y, alpha_q, beta_q, s_x, s_y, z),
        _peak_to_valley(z, *axes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """One axis on the grid of the map."""

    item: ErrorEstimate | Profile
    grid: FloatArray  # shape (n,), m
    sd: FloatArray  # shape (n,), m
    u_slope: float  # rad: of its alignment

    def square_from(self, at: int) -> FloatArray:
        """Return the variance of the difference from one place of the grid, shape (n,), m^2."""
        place = float(self.grid[at])
        tilt = ((self.grid - place) * self.u_slope) ** 2
        if isinstance(self.item, ErrorEstimate) and self.item.has_covariance:
            return np.asarray(self.item.u_of_difference(self.grid, place) ** 2 + tilt)
        square = self.sd**2 + self.sd[at] ** 2 + tilt
        square[at] = 0.0 * self.sd[at]
        return np.asarray(square)


def _node(grid: FloatArray, place: float, axis: str) -> int:
    """Return which point of a grid a place is; refused between them."""
    at = int(np.argmin(np.abs(grid - place)))
    if abs(float(grid[at]) - place) > 1e-6 * (grid[1] - grid[0]):
        raise DataError(
            f"the reference {axis} = {place * 1e3:.9g} mm is not on the grid of the map "
            f"({grid[0] * 1e3:.6g} ... {grid[-1] * 1e3:.6g} mm in steps of "
            f"{(grid[1] - grid[0]) * 1e3:.6g} mm); take {grid[at] * 1e3:.9g} mm"
        )
    return at


def _peak_to_valley(z: FloatArray, along_x: _Axis, along_y: _Axis) -> Quantity | None:
    """Return the P-V of the map with the uncertainty of that difference; None where all is NaN."""
    if not np.isfinite(z).any():
        return None
    (top, right), (low, left) = (
        np.unravel_index(int(i), z.shape) for i in (np.nanargmax(z), np.nanargmin(z))
    )
    axes = (along_x, along_y)
    square = float(along_x.square_from(int(left))[right] + along_y.square_from(int(low))[top])
    known = all(isinstance(a.item, ErrorEstimate) and a.item.has_covariance for a in axes)
    how = "with the covariance of the two extremes" if known else "samples taken as independent"
    return Quantity(
        float(z[top, right] - z[low, left]),
        "m",
        f"P-V of the error of the plane; u {how}",
        u=math.sqrt(square) if math.isfinite(square) else None,
        symbol="PV plane",
    )


def _messages(
    along_x: ErrorEstimate | Profile,
    along_y: ErrorEstimate | Profile,
    alpha: Quantity,
    beta: Quantity,
    s_x: FloatArray,
    s_y: FloatArray,
    z: FloatArray,
) -> tuple[str, ...]:
    out = ["coupling of x and y is not in this map; check it with fit_plane_model on a cut plane"]
    for axis, item, used, name in (("x", along_x, beta, "beta"), ("y", along_y, alpha, "alpha")):
        if isinstance(item, ErrorEstimate) and used.value == 0.0:
            out.append(
                f"the line of the estimate along {axis} ({item.slope.value * 1e6:.3g} urad) is that "
                f"of axis and artefact together and is omitted; give {name} if it is known apart"
            )
    for axis, s in (("x", s_x), ("y", s_y)):
        if np.isnan(s).all():
            out.append(f"the uncertainty along {axis} is not known (give u_{axis}): u is NaN")
    if np.isnan(z).any():
        share = 100.0 * float(np.mean(np.isnan(z)))
        out.append(f"{share:.3g} % of the map lies in gaps of an axis and is NaN")
    return tuple(out)


def _sampled(
    item: ErrorEstimate | Profile, step: float, u: ArrayLike | Profile | None, axis: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, error and standard uncertainty of an axis on the grid of the map."""
    if isinstance(item, ErrorEstimate):
        if u is not None:
            raise DataError(
                f"u_{axis} is for a profile; the estimate along {axis} has its own: leave u_{axis} out"
            )
        grid = _grid(item.start, item.stop, step, axis)
        return grid, item.evaluate(grid), item.sd(grid)
    if not isinstance(item, Profile):
        raise DataError(
            f"along_{axis} must be an ErrorEstimate or a Profile, got {type(item).__name__}"
        )
    item.require_metres()
    if len(item) < 2:
        raise TooFewSamplesError(f"along_{axis} has {len(item)} sample; an axis needs two")
    grid = _grid(float(item.x[0]), float(item.x[-1]), step, axis)
    return grid, _between(grid, item.x, item.z), _uncertainty(u, item, grid, axis)


def _uncertainty(
    u: ArrayLike | Profile | None, item: Profile, grid: FloatArray, axis: str
) -> FloatArray:
    if u is None:
        return np.full(grid.shape, np.nan)
    if isinstance(u, Profile):
        positions, values = u.x, u.z
    else:
        values = np.asarray(real_numbers(u, f"u_{axis}"), dtype=np.float64)
        if values.ndim == 0:
            values = np.full(len(item), float(values))
        positions = item.x
    if values.shape != positions.shape or (values < 0.0).any():
        raise InvalidSamplesError(
            f"u_{axis} must hold one standard uncertainty >= 0 for each of the {len(item)} "
            f"samples, got shape {values.shape}"
        )
    return _between(grid, positions, values)


def _between(grid: FloatArray, x: FloatArray, z: FloatArray) -> FloatArray:
    """Linear between measured neighbours; NaN in a gap and outside."""
    at = np.clip(np.searchsorted(x, grid, side="right") - 1, 0, x.size - 2)
    part = (grid - x[at]) / (x[at + 1] - x[at])
    near = 1e-9
    part = np.where(np.abs(part) < near, 0.0, np.where(np.abs(part - 1.0) < near, 1.0, part))
    left = np.where(part < 1.0, z[at], 0.0)
    right = np.where(part > 0.0, z[at + 1], 0.0)
    out: FloatArray = (1.0 - part) * left + part * right
    out[(grid < x[0] - near) | (grid > x[-1] + near)] = np.nan
    return out


def _grid(start: float, stop: float, step: float, axis: str) -> FloatArray:
    n = int((stop - start) / step * (1.0 + 1e-12) + 1e-9) + 1
    if n < 2:
        raise DataError(
            f"d{axis} = {step:.6g} m is longer than the travel of {stop - start:.6g} m; steps are "
            "in m (1 mm is 0.001)"
        )
    if n > _MOST_PIXELS:
        raise DataError(f"d{axis} = {step:.3g} m gives {n} points; choose a larger step")
    return np.asarray(start + step * np.arange(n), dtype=np.float64)


def _alignment(value: float | Quantity, name: str) -> Quantity:
    if isinstance(value, Quantity):
        if value.unit != "rad":
            raise UnitError(f"{name} is in {value.unit}; an alignment is in rad")
        quantity = value
    else:
        number = real(value, name, dimension="angle")
        quantity = Quantity(number, "rad", "alignment, as stated", symbol=name)
    if not math.isfinite(quantity.value):
        raise DataError(f"{name} is {quantity.value}; give a finite alignment in rad, or 0")
    if abs(quantity.value) > _LARGEST_SLOPE:
        raise UnitError(
            f"{name} is {quantity.value:.4g} rad, more than a degree; alignments are in rad "
            "(1 arc second is 4.85e-6 rad)"
        )
    return quantity


def _axis(start: float, step: float | None, n: int) -> FloatArray:
    if step is None:
        raise DataError("the map has no lateral step")
    return np.asarray(start + step * np.arange(n), dtype=np.float64)
