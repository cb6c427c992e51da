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
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TooFewSamplesError,
)
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
    n_undefined: int  # points left out because nothing is cut or defined there

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
    square, n, undefined = 0.0, 0, 0
    with one_blas_thread():
        for all_x, all_y, all_z in points.valid_blocks():
            inside = region.holds(all_x, all_y)
            x, y, z = all_x[inside], all_y[inside], all_z[inside]
            model, columns = modelled(form, x, y, values)
            off = z - model
            good = ~np.isnan(off) & np.isfinite(columns).all(axis=0)
            if not good.all():
                undefined += int(np.count_nonzero(~good))
                off, columns = off[good], columns[:, good]
            gram += columns @ columns.T
            right += columns @ off
            square += float(off @ off)
            n += off.size
    return Equations(gram, right, square, n, undefined)


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
        names = list(FREEDOMS)
        return [names.index(n) for n in self.used]


def choose(sums: Equations, free: Sequence[str], *, noise: float, extent: float) -> Choice:
    """Return the freedoms that the points determine, in order of preference.

    A freedom is given up where it leaves no trace, where others hold its effect to rounding, or
    where its uncertainty exceeds a twentieth of the size of the part (dx, dy and shifts; 1 mm of dx
    and dy at most), 10 mm (dR) or 1 rad.
    """
    names = list(FREEDOMS)
    slopes = [names.index(n) for n in ("dx", "dy", "shift_x", "shift_y")]
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
    norms = np.sqrt(np.diag(gram)[list(used)])
    own = math.sqrt(float(gram[i, i]))
    among = gram[np.ix_(used, used)] / np.outer(norms, norms)
    onto = gram[list(used), i] / (norms * own)
    weights = np.linalg.lstsq(among, onto, rcond=1e-13)[0]
    left = max(0.0, 1.0 - float(weights @ onto))
    shares = np.abs(weights)
    return left, [k for k, w in zip(used, shares, strict=True) if w > 0.3 * shares.max()]


def solve(
    sums: Equations, choice: Choice, *, damping: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the step of the used freedoms, and the inverse of their products.

    Damping shortens the step along what the points show least; columns are of length one.
    """
    rows = choice.rows
    norms = np.sqrt(np.diag(sums.gram)[rows])
    unit = sums.gram[np.ix_(rows, rows)] / np.outer(norms, norms)
    inverse = np.linalg.inv(unit + damping * np.eye(len(rows)))
    inverse = 0.5 * (inverse + inverse.T)
    return inverse @ (sums.right[rows] / norms) / norms, inverse / np.outer(norms, norms)


def levelled(sums: Equations, choice: Choice) -> tuple[Equations, dict[str, float]]:
    """Return the sums after piston and tilts took what they can, and by how much they change.

    Exact without another look at the points, because the heights are linear in these three.
    """
    rows = [i for i, name in zip(choice.rows, choice.used, strict=True) if name in LINEAR]
    if not rows:
        return sums, {}
    norms = np.sqrt(np.diag(sums.gram)[rows])
    unit = sums.gram[np.ix_(rows, rows)] / np.outer(norms, norms)
    change = np.linalg.solve(unit, sums.right[rows] / norms) / norms
    square = max(sums.square - float(change @ sums.right[rows]), 0.0)
    right = sums.right - sums.gram[:, rows] @ change
    names = [list(FREEDOMS)[i] for i in rows]
    left = Equations(sums.gram, right, square, sums.n, sums.n_undefined)
    return left, dict(zip(names, change.tolist(), strict=True))


def alike(sums: Equations, choice: Choice, held: Sequence[str]) -> dict[str, tuple[str, float]]:
    """Return held freedoms that would pass for a used setting: its name and the correlation.

    Correlations are those of what piston and tilts leave of both.
    """
    names = list(FREEDOMS)
    plane = [names.index(n) for n in LINEAR if n in choice.used]
    found: dict[str, tuple[str, float]] = {}
    for name in held:
        i = names.index(name)
        for setting in ("dx", "dy"):
            if setting not in choice.used:
                continue
            j = names.index(setting)
            r = _partial(sums.gram, i, j, plane)
            if abs(r) > _CLOSE and abs(r) > abs(found.get(name, ("", 0.0))[1]):
                found[name] = (setting, r)
    return found


def _partial(gram: FloatArray, i: int, j: int, over: list[int]) -> float:
    pair = [i, j]
    left = gram[np.ix_(pair, pair)].copy()
    if over:
        norms = np.sqrt(np.diag(gram)[list(over)])
        among = gram[np.ix_(over, over)] / np.outer(norms, norms)
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
    form: Form,
    x: FloatArray,
    y: FloatArray,
    setting: tuple[float, float, float],
    *,
    exact: bool,
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


# ---- private: covariance of a tool setting when the noise of neighbouring points is not independent ----
# The correlation of the residual at every lag along x and y is taken where it stands out of its own
# scatter around lag zero. With C the matrix of these correlations and J the derivatives, the covariance
# is ``s^2 G^-1 (J^T C J) G^-1``, ``G = J^T J``: that of the estimate actually made, white or not. For
# derivatives that change slowly it is the plain one times the sum of the correlations over all lags.

_TILE = 1024
"""Pixels a side that are transformed at once."""
_FARTHEST = 3
"""Lags beyond this part of the map hold too few pairs."""
_SURE = 3.0
"""Standard errors by which a correlation must stand out of its scatter."""
_LEAST = 1e-15
"""m: a residual below this is rounding."""


@dataclass(frozen=True, slots=True)
class Correlation:
    """How the residuals of points near one another correlate."""

    # shape (2 n_y + 1, 2 n_x + 1): correlation by lag, 1 in the middle, 0 where it does not stand
    # out
    kernel: FloatArray
    along_x: float = 0.0  # of next neighbours; 0 where there are none
    along_y: float = 0.0

    @property
    def is_white(self) -> bool:
        """Whether no neighbours correlate."""
        return self.kernel.size == 1

    @property
    def alike(self) -> float:
        """Points that say the same together: the sum over all lags."""
        return float(self.kernel.sum())


WHITE = Correlation(np.ones((1, 1)))


def correlation(task: Task, residual: FloatArray) -> Correlation:
    """Return the correlation of the residuals on a map or profile; white for scattered points."""
    if task.points.is_scattered:
        return WHITE
    z = np.atleast_2d(residual)
    lags = tuple(min(n // _FARTHEST, _TILE // _FARTHEST) for n in z.shape)
    products, pairs = _lagged(z, (lags[0], lags[1]))
    middle = lags[0], lags[1]
    if pairs[middle] < 10 or products[middle] <= _LEAST**2 * pairs[middle]:
        return WHITE
    with np.errstate(divide="ignore", invalid="ignore"):
        r = products / pairs * (pairs[middle] / products[middle])
    r[pairs < 0.5] = np.nan
    kernel = np.nan_to_num(np.where(_standing_out(r, pairs), r, 0.0))
    rows, columns = np.flatnonzero(kernel.any(axis=1)), np.flatnonzero(kernel.any(axis=0))
    r = np.nan_to_num(r)
    along_x = float(r[lags[0], lags[1] + 1]) if lags[1] else 0.0
    along_y = float(r[lags[0] + 1, lags[1]]) if lags[0] else 0.0
    cropped = kernel[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return Correlation(cropped, along_x, along_y)


def covariance(
    task: Task, settled: Settled, square: float, found: Correlation
) -> tuple[FloatArray, float]:
    """Return the covariance of the used freedoms, and the variance of one height.

    The variance is `square`, if stated (> 0), or from the residual, less what the fit takes up of
    correlated noise.
    """
    sums, choice = settled.sums, settled.choice
    _, inverse = solve(sums, choice)
    if found.is_white:
        variance = square or sums.square / (sums.n - len(choice.used))
        return variance * inverse, variance
    rows = choice.rows
    norms = np.sqrt(np.diag(sums.gram)[rows])
    gram = sums.gram[np.ix_(rows, rows)] / np.outer(norms, norms)
    lagged = _lagged_gram(task, settled, found.kernel)[np.ix_(rows, rows)] / np.outer(norms, norms)
    size, turn = np.linalg.eigh(gram)
    root = turn / np.sqrt(size)
    raised, axes = np.linalg.eigh(root.T @ lagged @ root)
    raised = np.maximum(raised, 1.0)
    taken = min(float(raised.sum()), 0.5 * sums.n)
    variance = square or sums.square / (sums.n - taken)
    half = root @ axes * np.sqrt(raised) / norms[:, None]
    return variance * (half @ half.T), variance


def _lagged(z: FloatArray, lags: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return sums of products and numbers of pairs by lag, both (2 n_y + 1, 2 n_x + 1)."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    shape = (2 * lags[0] + 1, 2 * lags[1] + 1)
    products, pairs = np.zeros(shape), np.zeros(shape)
    for i in range(0, z.shape[0], _TILE):
        for j in range(0, z.shape[1], _TILE):
            tile = z[i : i + _TILE, j : j + _TILE]
            known = ~np.isnan(tile)
            size = [
                next_fast_len(max(n, lag + 1) + lag, real=True)
                for n, lag in zip(tile.shape, lags, strict=True)
            ]
            for values, sums in ((np.where(known, tile, 0.0), products), (known * 1.0, pairs)):
                power = np.abs(rfft2(values, s=size)) ** 2
                around = np.fft.fftshift(irfft2(power, s=size))
                y, x = size[0] // 2, size[1] // 2
                sums[...] += around[y - lags[0] : y + lags[0] + 1, x - lags[1] : x + lags[1] + 1]
    return products, pairs


def _standing_out(r: FloatArray, pairs: FloatArray) -> NDArray[np.bool_]:
    """Return where the correlation around lag zero stands out of its scatter, as one region."""
    from scipy.ndimage import label

    middle = r.shape[0] // 2, r.shape[1] // 2
    region = np.zeros(r.shape, dtype=bool)
    region[middle] = True
    for _ in range(2):
        # Bartlett: the scatter of far lags grows with the sum of squares of the near ones
        scatter = np.sqrt(float(np.nansum(r[region] ** 2)) / np.maximum(pairs, 1.0))
        # lags without a pair join what lies on both sides of them, and add nothing
        marks = np.asarray(
            label(np.isnan(r) | (r > _SURE * scatter), structure=np.ones((3, 3)))[0]
        )
        region = marks == marks[middle]
    return region


def _lagged_gram(task: Task, settled: Settled, kernel: FloatArray) -> FloatArray:
    """Return ``J^T C J`` over the used points: one derivative against the correlated others."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    points, reach = task.points, (kernel.shape[0] // 2, kernel.shape[1] // 2)
    total = np.zeros((len(FREEDOMS), len(FREEDOMS)))
    core = max(64, _TILE // 4)
    n_y, n_x = points.z.shape
    with one_blas_thread():
        for i in range(0, n_y, core):
            for j in range(0, n_x, core):
                top, left = max(i - reach[0], 0), max(j - reach[1], 0)
                rows = slice(top, min(i + core + reach[0], n_y))
                columns = slice(left, min(j + core + reach[1], n_x))
                wide = _derivatives(task, settled, rows, columns)
                size = [
                    next_fast_len(n + 2 * lag, real=True)
                    for n, lag in zip(wide.shape[1:], reach, strict=True)
                ]
                spread = rfft2(kernel, s=size)
                inside = (
                    slice(i - top, min(i + core, n_y) - top),
                    slice(j - left, min(j + core, n_x) - left),
                )
                near = np.stack(
                    [
                        irfft2(rfft2(column, s=size) * spread, s=size)[
                            reach[0] : reach[0] + wide.shape[1],
                            reach[1] : reach[1] + wide.shape[2],
                        ][inside]
                        for column in wide
                    ]
                )
                own = wide[:, inside[0], inside[1]]
                total += own.reshape(len(own), -1) @ near.reshape(len(near), -1).T
    return 0.5 * (total + total.T)


def _derivatives(task: Task, settled: Settled, rows: slice, columns: slice) -> FloatArray:
    """Return the derivatives on part of the map, 0 at points that are not used."""
    z = task.points.z[rows, columns]
    x = np.broadcast_to(task.points.x[columns], z.shape)
    y = np.broadcast_to(task.points.y[rows, None], z.shape)
    model, found = modelled(task.form, x.ravel(), y.ravel(), settled.values)
    used = ~np.isnan(z.ravel()) & ~np.isnan(model) & np.isfinite(found).all(axis=0)
    used &= settled.region.holds(x.ravel(), y.ravel())
    return np.where(used, found, 0.0).reshape(len(found), *z.shape)


def neighbours_of_scattered(x: FloatArray, y: FloatArray, z: FloatArray) -> float:
    """Return the correlation of residuals with that of the nearest other point."""
    from scipy.spatial import cKDTree

    known = ~np.isnan(z)
    if np.count_nonzero(known) < 10:
        return 0.0
    places, values = np.column_stack([x[known], y[known]]), z[known]
    nearest = np.asarray(cKDTree(places).query(places, k=2)[1])
    first, second = values, values[nearest[:, 1]]
    first, second = first - first.mean(), second - second.mean()
    size = float(first @ first) * float(second @ second)
    return float(first @ second) / math.sqrt(size) if size > 0.0 else 0.0


# ---- private: from a start to the tool setting of the smallest residual, in damped steps -------
# The sums of `_setting_equations` are solved again and again. A step that does not make the residual
# smaller is shortened along what the points show least (Levenberg and Marquardt), because there the
# valley is curved: a shift of a smooth part is a tilt to the first order.

_MOST_DAMPINGS = 11
_SETTLED = ((15, 1e-3), (30, 1e-2), (60, 0.1))
"""Steps, and the share of its standard uncertainty that no freedom may still move by then.

A pixel that crosses the apex at the axis makes the valley rough, far below the uncertainty."""
_ROUNDING = 1e-16
"""m: steps below this are rounding of the heights."""
_FEW = 2e-3
_SINGLE = 4.0
"""Residual of a single point, in units of the RMS."""
_TILTED = {"shift_x": "tilt_x", "shift_y": "tilt_y"}
"""What a shift of a smooth part is to the first order."""
_CANCELLED = 1e-6
"""Share of a sum of squares below which its rounding shows: it is summed anew."""
_MOST_CHOICES = 5
_AROUND_CENTRE = 3.0
"""Radii below this many times hypot(dx, dy) are left out: the centre is cut twice or not at all."""


@dataclass(frozen=True, slots=True)
class Task:
    """What is fitted to what."""

    points: Points  # measured heights
    form: Form  # the nominal surface
    names: Sequence[str]  # freedoms wanted
    wanted: tuple[float, float]  # of (float, float), m: inner and outer radius that may be used
    noise: float | None  # m: stated standard deviation of one height
    extent: float  # m: largest distance from the axis


@dataclass(frozen=True, slots=True)
class Settled:
    """Where the steps ended."""

    values: Mapping[str, float]  # mapping of str to float: of all freedoms
    region: Region  # which points were used
    sums: Equations  # at the values
    choice: Choice  # freedoms that were solved for
    steps: int  # that it took


def settle(task: Task, start: Mapping[str, float]) -> Settled:
    """Return the least-squares values from a start; what the points do not determine stays there.

    Where the steps do not settle and a shift is less well known than the centre that is left out
    around the apex, that shift is held too.
    """
    found, said = _settled(task, start)
    if said is None:
        return found
    _, inverse = solve(found.sums, found.choice)
    u = dict(
        zip(found.choice.used, np.sqrt(np.diag(inverse) * found.sums.mean_square), strict=True)
    )
    apex = _AROUND_CENTRE * math.hypot(found.values["dx"], found.values["dy"])
    loose = [n for n in _TILTED if n in u and u[n] > apex]
    if not loose:
        raise NotConvergedError(said)
    names = [n for n in task.names if n not in loose]
    found, said = _settled(replace(task, names=names), start)
    if said is not None:
        raise NotConvergedError(said)
    held = {**found.choice.given_up, **{n: (_TILTED[n],) for n in loose}}
    return replace(found, choice=Choice(found.choice.used, held))


def _settled(task: Task, start: Mapping[str, float]) -> tuple[Settled, str | None]:
    """Return where the steps end, and what failed.

    What is determined depends on the values (an apex at the centre shows a shift), so the choice is
    made anew at each solution until it stays.
    """
    values = dict(start)
    region = outside(task.wanted, values)
    sums, choice = chosen(task, values, region)
    values, sums, steps, _ = _settle(task, values, region, choice, sums, n_settle=1)
    said: str | None = None
    failed = 0
    for _ in range(_MOST_CHOICES):
        region = outside(task.wanted, values)
        sums, choice = chosen(task, values, region)
        if any(values[n] != start[n] for n in choice.given_up):
            values |= {n: start[n] for n in choice.given_up}
            sums = equations(task.points, task.form, values, region)
        values, sums, more, said = _settle(
            task, values, region, choice, sums, n_settle=_MOST_STEPS
        )
        steps += more
        failed += said is not None
        if failed > 1:
            break
        again = choose(sums, task.names, noise=_level(task, sums, choice), extent=task.extent)
        grown = outside(task.wanted, values).inner > region.inner * (1.0 + 1e-3)
        if said is None and not grown and again.used == choice.used:
            break
    return Settled(values, region, sums, choice, steps), said


def chosen(task: Task, values: Mapping[str, float], region: Region) -> tuple[Equations, Choice]:
    """Return the sums and the freedoms they determine; refuse what determines no setting."""
    sums = equations(task.points, task.form, values, region)
    names, form = task.names, task.form
    if sums.n <= len(names) and region.inner > task.wanted[0]:
        raise NotConvergedError(
            f"the setting runs away to {_shown(values)}, where {sums.n} points of the map are left "
            "outside the centre that such a tool spoils: the map may be of another surface or "
            "mirrored; check form and centre, free less, or give start="
        )
    if sums.n <= len(names):
        raise TooFewSamplesError(
            f"{sums.n} measured points lie within rho = {format_length(region.inner)} ... "
            f"{format_length(region.outer) if math.isfinite(region.outer) else 'the rim'} and on the "
            f"{form.name}, and {len(names)} freedoms need more; check centre and region"
        )
    level = _level(task, sums, choose(sums, names, noise=0.0, extent=task.extent))
    choice = choose(sums, names, noise=level, extent=task.extent)
    wanted = [n for n in FACTORS if n in names]
    if wanted and not any(n in choice.used for n in wanted):
        raise DegenerateFitError(
            f"{', '.join(wanted)} leave no trace of their own on this {form.name} over the "
            "measured points: no tool setting can be found; measure a larger or steeper "
            "part, and check the unit of the heights"
        )
    return sums, choice


def outside(wanted: tuple[float, float], values: Mapping[str, float]) -> Region:
    """Return the region without the centre that is cut twice or not at all."""
    inner = _AROUND_CENTRE * math.hypot(values["dx"], values["dy"])
    return Region(max(wanted[0], inner), wanted[1], values["shift_x"], values["shift_y"])


def _level(task: Task, sums: Equations, choice: Choice) -> float:
    """Return the stated noise, or the RMS that a linear solution would leave, m."""
    if task.noise is not None:
        return task.noise
    step, _ = solve(sums, choice)
    left = sums.square - float(step @ sums.right[choice.rows])
    return math.sqrt(max(left, 0.0) / sums.n)


def _settle(
    task: Task,
    start: Mapping[str, float],
    region: Region,
    choice: Choice,
    sums: Equations,
    *,
    n_settle: int,
) -> tuple[dict[str, float], Equations, int, str | None]:
    """Return values and sums after at most `n_settle` damped steps, their number, and what failed."""
    values, damping = dict(start), 0.0
    for count in range(1, n_settle + 1):
        left = _left(sums, choice)
        last = left <= next(share for most, share in _SETTLED if count <= most)
        for _ in range(_MOST_DAMPINGS):
            step, _ = solve(sums, choice, damping=damping)
            tried = dict(values)
            for name, change in zip(choice.used, step.tolist(), strict=True):
                tried[name] += change
            tried, new = _tried(task, tried, region, choice)
            if new.n > len(choice.used) and new.mean_square <= _allowed(sums, new):
                break
            if last:
                return values, sums, count, None
            damping = max(10.0 * damping, 1e-8)
        else:
            if left <= _SETTLED[-1][1]:
                return values, sums, count, None
            return (
                values,
                sums,
                count,
                (
                    f"no step of the setting makes the residual of {format_length(math.sqrt(sums.mean_square))} "
                    f"RMS smaller, at {_shown(values)}: the map may be of another surface or mirrored; "
                    "check form and centre, or give start="
                ),
            )
        values, sums = tried, new
        damping = 0.1 * damping if damping > 1e-9 else 0.0
        if last:
            return values, sums, count, None
    return (
        values,
        sums,
        n_settle,
        (
            f"the setting still moves after {n_settle} steps (now {_shown(values)}): the map may be of "
            "another surface or mirrored; check form and centre, free less, or give start="
        ),
    )


def _allowed(sums: Equations, new: Equations) -> float:
    """Return the mean square that a step may leave, m^2.

    No more than before; where a few points came in from the uncut core or went there, no more than
    they can make of it, because nothing else compares sums over different points.
    """
    changed = abs(new.n - sums.n)
    few = changed if changed <= _FEW * sums.n else 0
    return sums.mean_square * (1.0 + 1e-12 + _SINGLE**2 * few / sums.n)


def _left(sums: Equations, choice: Choice) -> float:
    """Return how far the full step goes in standard uncertainties; 0 where it is rounding."""
    step, _ = solve(sums, choice)
    moved = math.sqrt(max(float(step @ sums.right[choice.rows]), 0.0))
    if moved <= _ROUNDING * math.sqrt(sums.n):
        return 0.0
    return moved / math.sqrt(sums.mean_square) if sums.mean_square > 0.0 else math.inf


def _tried(
    task: Task, values: dict[str, float], region: Region, choice: Choice
) -> tuple[dict[str, float], Equations]:
    """Return the values with the best piston and tilts, and the sums; none where no part is cut so.

    Levelling straightens the valley: a shift changes the piston by its square.
    """
    try:
        sums = equations(task.points, task.form, values, region)
        if sums.n <= len(choice.used):
            return values, sums
        left, change = levelled(sums, choice)
        values = {n: v + change.get(n, 0.0) for n, v in values.items()}
        if left.square < _CANCELLED * sums.square:
            left = equations(task.points, task.form, values, region)
    except NotConvergedError:
        size = len(FREEDOMS)
        return values, Equations(np.zeros((size, size)), np.zeros(size), math.inf, 0, 0)
    return values, left


def _shown(values: Mapping[str, float]) -> str:
    return ", ".join(f"{n} = {format_length(values[n])}" for n in ("dx", "dy", "dR"))
