"""Private: normal equations of a tool setting on the points of a map, and which freedoms show.

The matrix is never built whole: its products are added up block by block. A freedom that no point
shows, or that others on the same points can hold as well, is found and named before anything is
solved.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.forms.base import Form
from metrosep.forms.points import Points
from metrosep.process._setting_model import exact_cut

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
