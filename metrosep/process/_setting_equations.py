"""Private: normal equations of a tool setting on the points of a map, and which freedoms show.

The matrix is never built whole: its products are added up block by block. A freedom that no point
shows, or that others on the same points can hold as well, is found and named before anything is
solved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotConvergedError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import Points

FREEDOMS: Mapping[str, str] = {
    "piston": "m",
    "tilt_x": "1",
    "tilt_y": "1",
    "dx": "m",
    "dR": "m",
    "dy": "m",
    "shift_x": "m",
    "shift_y": "m",
    "rotation": "rad",
}
"""Unit of each; when two hold the same, the one that stands later is given up."""

PLACES = {name: i for i, name in enumerate(FREEDOMS)}
LINEAR = ("piston", "tilt_x", "tilt_y")
_LARGEST = {"dx": 1e-3, "dy": 1e-3, "dR": 10e-3, "rotation": 1.0}
_LARGEST_SHARE = 0.05
"""Of the size of the part: a lateral freedom that is not known better is not determined."""
_SAME = 1e-9
"""Share of its square norm that a column must keep beside the others."""
_NO_TRACE = 1e-9
_CLOSE = 0.9


@dataclass(frozen=True, slots=True)
class Equations:
    """Sums over the points at some values of the freedoms, in the order of `FREEDOMS`."""

    gram: FloatArray  # shape (9, 9): products of the derivatives
    right: FloatArray  # shape (9,): products of the derivatives with the residual
    square: float  # m^2: sum of squared residuals
    n: int  # points used

    @property
    def mean_square(self) -> float:
        """Mean of the squared residuals, m^2."""
        return self.square / self.n if self.n else math.inf


def modelled(
    form: Form, x: FloatArray, y: FloatArray, values: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return heights (n,) and their derivatives (9, n) at points, NaN where nothing is defined."""
    px, py = x - values["shift_x"], y - values["shift_y"]
    rho, theta = np.hypot(px, py), np.arctan2(py, px) - values["rotation"]
    cut = exact_cut(form, rho, theta, values["dx"], values["dy"], values["dR"])
    with np.errstate(divide="ignore", invalid="ignore"):
        around = np.where(rho > 0.0, cut.along_theta / rho, 0.0)
    turned = theta + values["rotation"]
    cosine, sine = np.cos(turned), np.sin(turned)
    columns = np.empty((len(FREEDOMS), x.size))
    columns[0] = 1.0
    columns[1], columns[2] = x, y
    columns[3], columns[4], columns[5] = cut.by_dx, cut.by_dR, cut.by_dy
    columns[6] = sine * around - cosine * cut.along_rho
    columns[7] = -cosine * around - sine * cut.along_rho
    columns[8] = -cut.along_theta
    z = cut.height + values["piston"] + values["tilt_x"] * x + values["tilt_y"] * y
    return z, columns


@dataclass(frozen=True, slots=True)
class Region:
    """Which points are used: a ring about where the spindle axis was taken to be.

    It stays where it is while the shift is fitted, so that the points stay the same.
    """

    inner: float  # m: radii
    outer: float
    x: float = 0.0  # m: centre, in the coordinates of the points
    y: float = 0.0

    def holds(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        """Return which points lie within."""
        rho = np.hypot(x - self.x, y - self.y)
        return (rho >= self.inner) & (rho <= self.outer)


def equations(
    points: Points, form: Form, values: Mapping[str, float], region: Region
) -> Equations:
    """Return the sums over the measured points within a region about the spindle axis."""
    size = len(FREEDOMS)
    gram, right = np.zeros((size, size)), np.zeros(size)
    square, n = 0.0, 0
    with one_blas_thread():
        for all_x, all_y, all_z in points.valid_blocks():
            inside = region.holds(all_x, all_y)
            x, y, z = all_x[inside], all_y[inside], all_z[inside]
            model, columns = modelled(form, x, y, values)
            off = z - model
            good = ~np.isnan(off) & np.isfinite(columns).all(axis=0)
            if not good.all():
                off, columns = off[good], columns[:, good]
            gram += columns @ columns.T
            right += columns @ off
            square += float(off @ off)
            n += off.size
    return Equations(gram, right, square, n)


@dataclass(frozen=True, slots=True)
class Choice:
    """Which freedoms are solved for, and why the others are not."""

    used: tuple[str, ...]  # in the order of `FREEDOMS`
    # mapping of str to tuple of str: freedom to those that hold its effect; empty where it leaves
    # no trace
    given_up: Mapping[str, tuple[str, ...]]

    @property
    def rows(self) -> list[int]:
        """Places of the used freedoms in `FREEDOMS`."""
        return [PLACES[n] for n in self.used]


def choose(sums: Equations, free: Sequence[str], *, noise: float, extent: float) -> Choice:
    """Return the freedoms that the points determine, in order of preference.

    A freedom is given up where it leaves no trace, where others hold its effect to rounding, or
    where its uncertainty exceeds a twentieth of the size of the part (dx, dy and shifts; 1 mm of dx
    and dy at most), 10 mm (dR) or 1 rad.
    """
    names = list(FREEDOMS)
    slopes = [PLACES[n] for n in ("dx", "dy", "shift_x", "shift_y")]
    strongest = math.sqrt(float(sums.gram[slopes, slopes].max()))
    used: list[int] = []
    given_up: dict[str, tuple[str, ...]] = {}
    for i, name in enumerate(names):
        if name not in free:
            continue
        norm = math.sqrt(float(sums.gram[i, i]))
        scale = strongest * (extent if name == "rotation" else 1.0)
        is_setting = name in ("dx", "dy", "shift_x", "shift_y", "rotation")
        if norm == 0.0 or (is_setting and norm <= _NO_TRACE * scale):
            given_up[name] = ()
            continue
        left, partners = _beside(sums.gram, i, used)
        limit = _LARGEST.get(name, math.inf)
        if i in slopes:
            limit = min(limit, _LARGEST_SHARE * extent)
        if left <= _SAME or noise > limit * norm * math.sqrt(left):
            given_up[name] = tuple(names[k] for k in partners)
            continue
        used.append(i)
    return Choice(tuple(names[k] for k in used), given_up)


def _beside(gram: FloatArray, i: int, used: Sequence[int]) -> tuple[float, list[int]]:
    """Return the share of a column that others do not hold, and which hold most of the rest."""
    if not used:
        return 1.0, []
    norms, among = unit_gram(gram, used)
    onto = gram[list(used), i] / (norms * math.sqrt(float(gram[i, i])))
    weights = np.linalg.lstsq(among, onto, rcond=1e-13)[0]
    left = max(0.0, 1.0 - float(weights @ onto))
    shares = np.abs(weights)
    return left, [k for k, w in zip(used, shares, strict=True) if w > 0.3 * shares.max()]


def unit_gram(gram: FloatArray, rows: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """Return the lengths of some columns, and their products with each of length one."""
    norms = np.sqrt(np.diag(gram)[list(rows)])
    return norms, gram[np.ix_(rows, rows)] / np.outer(norms, norms)


def solve(
    sums: Equations, choice: Choice, *, damping: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the step of the used freedoms, and the inverse of their products.

    Damping shortens the step along what the points show least; columns are of length one.
    """
    rows = choice.rows
    norms, unit = unit_gram(sums.gram, rows)
    inverse = np.linalg.inv(unit + damping * np.eye(len(rows)))
    inverse = 0.5 * (inverse + inverse.T)
    return inverse @ (sums.right[rows] / norms) / norms, inverse / np.outer(norms, norms)


def levelled(sums: Equations, choice: Choice) -> tuple[Equations, dict[str, float]]:
    """Return the sums after piston and tilts took what they can, and by how much they change.

    Exact without another look at the points, because the heights are linear in these three.
    """
    names = [name for name in choice.used if name in LINEAR]
    rows = [PLACES[name] for name in names]
    if not rows:
        return sums, {}
    norms, unit = unit_gram(sums.gram, rows)
    change = np.linalg.solve(unit, sums.right[rows] / norms) / norms
    square = max(sums.square - float(change @ sums.right[rows]), 0.0)
    right = sums.right - sums.gram[:, rows] @ change
    return replace(sums, right=right, square=square), dict(
        zip(names, change.tolist(), strict=True)
    )


def alike(sums: Equations, choice: Choice, held: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return held freedoms that would pass for a used setting: its name and the correlation.

    Correlations are those of what piston and tilts leave of both.
    """
    plane = [PLACES[n] for n in LINEAR if n in choice.used]
    found: dict[str, tuple[str, float]] = {}
    for name in held:
        for setting in (n for n in ("dx", "dy") if n in choice.used):
            r = _partial(sums.gram, PLACES[name], PLACES[setting], plane)
            if abs(r) > _CLOSE and abs(r) > abs(found.get(name, ("", 0.0))[1]):
                found[name] = (setting, r)
    return found


def _partial(gram: FloatArray, i: int, j: int, over: list[int]) -> float:
    pair = [i, j]
    left = gram[np.ix_(pair, pair)].copy()
    if over:
        norms, among = unit_gram(gram, over)
        onto = gram[np.ix_(over, pair)] / norms[:, None]
        left -= onto.T @ np.linalg.lstsq(among, onto, rcond=1e-13)[0]
    size = float(left[0, 0] * left[1, 1])
    whole = float(gram[i, i] * gram[j, j])
    return float(left[0, 1]) / math.sqrt(size) if size > 1e-18 * whole else 0.0


# ---- the surface that a wrongly set round nose cuts: exact, as the paper's sum, and its derivatives ----
# Frame of the workpiece, z out of the material. A commanded cut point is ``(r, theta_c, S)`` with
# ``S`` the nominal height there. The tip stands ``dx`` further out along the machine's x, ``dy``
# towards growing workpiece azimuth, and the nose radius is ``dR`` larger than programmed while the
# tip height is right. The edge lies in the plane of the spindle axis and x, so its normal is
# ``n = (-sin phi, cos phi)`` with ``tan phi = dS/dr`` at constant azimuth, the tool centre is
# ``P + R n``, and the envelope of the larger circle is ``P + dR (e_z - n)``.

Factor = Literal["dx", "dy", "dR"]

FACTORS: tuple[Factor, ...] = ("dx", "dy", "dR")

_BLOCK = 1 << 16
_MOST_STEPS = 60
_SHALLOWEST = 1e-3
_MODEL_CLOSE = 1e-15
"""m: a radius found to this leaves less than 1e-6 nm of height on any cuttable slope."""


@dataclass(frozen=True, slots=True)
class Cut:
    """What was cut at some points of the workpiece."""

    # shape (n,), m: actual height; NaN in the core and where the surface is not defined
    height: FloatArray
    rho: FloatArray  # shape (n,): where on the workpiece, m and rad
    theta: FloatArray
    # shape (n,): derivatives of the actual height by rho (1) and by theta (m/rad)
    along_rho: FloatArray
    along_theta: FloatArray
    # shape (n,): derivatives of the actual height by the settings, dimensionless
    by_dx: FloatArray
    by_dy: FloatArray
    by_dR: FloatArray


def known_form(form: object) -> Form:
    """Return a form without unknown parameters; anything else is refused."""
    if not isinstance(form, Form):
        raise DataError(
            f"the nominal surface must be a form of metrosep.forms, got {type(form).__name__}"
        )
    if np.iscomplexobj(form.height(np.zeros(1), np.zeros(1))):
        raise DataError(
            f"the heights of {form.name} are complex numbers: give a form with real ones"
        )
    unknown = [k for k, v in form.parameters.items() if v is None]
    if unknown:
        raise DataError(
            f"{form.name} has no value for {', '.join(unknown)} yet: give one, or fit it first"
        )
    return form


def polar_slopes(
    form: Form, r: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return height, dz/dr and (dz/dtheta)/r of a form; negative r is the other side."""
    cosine, sine = np.cos(theta), np.sin(theta)
    height, slopes, _ = form.expansion(r * cosine, r * sine, [], slopes=True)
    if slopes is None:  # pragma: no cover - slopes=True promises them
        raise DataError(f"{form.name} gives no slopes")
    along_x, along_y = slopes
    return height, cosine * along_x + sine * along_y, cosine * along_y - sine * along_x


def polar_gradient(form: Form, r: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return dz/dr and (dz/dtheta)/r of a form; negative r is the other side."""
    cosine, sine = np.cos(theta), np.sin(theta)
    along_x, along_y = form.slopes(r * cosine, r * sine)
    return cosine * along_x + sine * along_y, cosine * along_y - sine * along_x


def bent(form: Form, rho: FloatArray, theta: FloatArray, width: float) -> FloatArray:
    """Return the mean of z_rr over a width along rho."""
    after, before = (polar_gradient(form, rho + s * width, theta)[0] for s in (0.5, -0.5))
    return np.asarray((after - before) / width)


def exact_cut(
    form: Form, rho: FloatArray, theta: FloatArray, dx: float, dy: float, dR: float
) -> Cut:
    """Return what is cut at workpiece points, and how it changes with the setting.

    The derivatives follow from the envelope: at fixed tool position the height changes with the
    slope at the contact, whatever dR.
    """
    core = rho < abs(dy)
    at = np.where(core, np.nan, rho)
    in_plane = np.sqrt((at - dy) * (at + dy))
    turned = np.arctan2(dy, in_plane)
    theta_c = theta - turned
    x = in_plane - dx
    r = x
    if dR != 0.0:
        cause = f"dR = {format_length(dR)}"
        r = commanded_radius(form, x, theta_c, lambda t: dR * t / np.sqrt(1.0 + t * t), cause)
    height, slope, tangential = polar_slopes(form, r, theta_c)
    secant = np.sqrt(1.0 + slope * slope)
    missed = x - dR * slope / secant - r
    z = height + dR * (1.0 - 1.0 / secant) + slope * missed
    along_angle = r * tangential
    with np.errstate(divide="ignore", invalid="ignore"):
        along_rho = (slope * at + along_angle * dy / at) / in_plane
        by_dy = -(slope * dy + along_angle) / in_plane
    if dy == 0.0:
        on_axis = rho == 0.0
        along_rho = np.where(on_axis, slope, along_rho)
        by_dy = np.where(on_axis, -tangential, by_dy)
    return Cut(z, rho, theta, along_rho, along_angle, -slope, by_dy, 1.0 - secant)


def commanded_radius(
    form: Form,
    x: FloatArray,
    theta: FloatArray,
    shift: Callable[[FloatArray], FloatArray],
    cause: str,
) -> FloatArray:
    """Return r with ``r + shift(dS/dr(r, theta)) = x``, the cut point that left its mark at x."""
    cosine, sine = np.cos(theta), np.sin(theta)

    def moved(at: FloatArray) -> FloatArray:
        along_x, along_y = form.slopes(at * cosine, at * sine)
        return shift(cosine * along_x + sine * along_y)

    missed = moved(x)
    r, other = x - missed, x
    close = _MODEL_CLOSE + 4e-16 * float(np.fmax.reduce(np.abs(x), axis=None, initial=0.0))
    worst = 0.0
    for _ in range(_MOST_STEPS):
        now = r + moved(r) - x
        difference = now - missed
        steepness = np.where(difference == 0.0, 1.0, difference) / np.where(
            r == other, 1.0, r - other
        )
        steepness = np.where((r == other) | (difference == 0.0), 1.0, steepness)
        step = now / np.maximum(steepness, _SHALLOWEST)
        other, missed, r = r, now, r - step
        worst = float(np.fmax.reduce(np.abs(step), axis=None, initial=0.0))
        if worst <= close:
            break
    near = 1e-9 + 1e-6 * np.abs(r)
    folds = ((moved(at + near) - moved(at)) / near <= -1.0 for at in (r, x))
    if worst > close or any(bool(f.any()) for f in folds):
        raise NotConvergedError(
            f"{cause} is larger than a radius of curvature of the {form.name} "
            "along rho, so that points of the path leave no single mark: a nose that wrong "
            "gouges; check dR, and the nose with gouge_check"
        )
    return r


def paper_errors(
    form: Form, rho: FloatArray, theta: FloatArray, dx: float, dy: float, dR: float
) -> dict[Factor, FloatArray]:
    """Return the error of each factor as the paper writes it, eq 12, 17 and 20, NaN in the core."""
    height, slope, _ = polar_slopes(form, rho, theta)
    core = rho < abs(dy)
    drho = np.hypot(rho, dy) - rho
    turned = np.arctan2(dy, rho)
    moved, _, _ = polar_slopes(form, rho - drho, theta - turned)
    found: dict[Factor, FloatArray] = {
        "dx": -dx * slope,
        "dy": moved - height if dy != 0.0 else 0.0 * height,
        "dR": -dR * (np.sqrt(1.0 + slope * slope) - 1.0),
    }
    return {k: np.where(core, np.nan, v) for k, v in found.items()}


def height_errors(
    form: Form, x: FloatArray, y: FloatArray, setting: tuple[float, float, float], *, exact: bool
) -> FloatArray:
    """Return actual - nominal at flat arrays of points; NaN in the core and off the form."""
    found = np.empty(x.size)
    for first in range(0, x.size, _BLOCK):
        part = slice(first, first + _BLOCK)
        rho, theta = np.hypot(x[part], y[part]), np.arctan2(y[part], x[part])
        if exact:
            cut = exact_cut(form, rho, theta, *setting).height
            found[part] = cut - form.height(x[part], y[part])
        else:
            parts = paper_errors(form, rho, theta, *setting)
            found[part] = parts["dx"] + parts["dy"] + parts["dR"]
    return found
