"""How far a program is off between its points: the height of the tip minus the lowest that cuts nothing.

At moments between the points of every block, X, azimuth and Z are what the control makes of them, and

    d = Z(t) - max over psi of [ S(P(psi)) - z(psi) ]

at that X and azimuth: what X and C do wrong together with Z is in it. The part is at no contact lower
than d, and nowhere higher than the largest d and a cusp. Errors are actual minus nominal along z.
specs/cutting-path.md, equations (4) and (22).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.forms.base import Form
from metrosep.process._plain import frozen
from metrosep.process.cutting.edge_errors import Servo
from metrosep.process.cutting.programs import AxisCourse, TurningProgram
from metrosep.process.cutting.servos import contact_path
from metrosep.process.path_errors import PathErrorMap
from metrosep.process.tips import Edge, TipPath, tips, tips_along

_PIECE = 1 << 15
"""Moments that are worked on at once."""
_PASSES = 5
"""For the lean of an edge over a place: each pass leaves 1e-3 of the last."""
_HOPELESS = 4.0
"""Times a tolerance: a path that is off by more is not looked at with its neighbours."""
_SHARES = (0.85, 0.7, 0.55, 0.4, 0.2, 0.0)
"""Of the P-V, from where on upwards the neighbours of a sample are looked at, until no other can be higher."""
_TURNS_BESIDE = 12
"""Turns on either side: the edge of the tenth stands a hundred times as high as that of the first."""
_WORST = 400
"""Lowest and highest moments whose contacts are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class CoursePiece:
    """Moments along some blocks of a program, block by block, in order of time."""

    block: NDArray[np.intp]  # number of the block, shape (n,)
    error: FloatArray  # m: d; NaN where the edge touches nothing
    rho: FloatArray  # m: of the contact; below 0 beyond the axis
    theta: FloatArray  # rad: of the contact
    along_x: FloatArray  # slopes there along machine x and y
    along_y: FloatArray
    by_azimuth: FloatArray  # m/rad: dZ/dphi of the tip
    X: FloatArray  # m: of the tip


def course_pieces(
    program: TurningProgram,
    form: Form,
    edge: Edge,
    shares: FloatArray,
    *,
    first: int = 0,
    last: int | None = None,
    strict: bool = False,
) -> Iterator[CoursePiece]:
    """Yield pieces of a program from block `first` to before block `last`, at shares of the time of each block."""
    parts, last = shares, len(program) - 1 if last is None else last
    per = max(1, _PIECE // parts.size)
    for begin in range(first, last, per):
        end = min(begin + per, last)
        course = AxisCourse.of(program, slice(begin, end + 1))
        i = np.repeat(np.arange(end - begin), parts.size)
        X, azimuth, Z = (course.value(a, i, np.tile(parts, end - begin)) for a in range(3))
        made = tips_along(form, X, azimuth, edge, strict=strict)
        yield CoursePiece(
            begin + i, Z - made.z, made.rho, made.theta, made.along_x, made.along_y,
            edge.by_azimuth(X, made.psi, made.along_x, made.along_y), X,
        )  # fmt: skip


def course_error(
    program: TurningProgram, form: Form, edge: Edge, parts: int, *, first: int = 0
) -> FloatArray:
    """Return d at the points and `parts` - 1 moments between two, from block `first` to the last point."""
    shares = np.arange(parts) / parts
    pieces = course_pieces(program, form, edge, shares, first=first, strict=True)
    made = [p.error for p in pieces]
    end = tips(form, program.X[-1:], program.azimuth[-1:], edge, strict=True)
    return np.concatenate([*made, program.Z[-1:] - end.z])


def lead_in_dip(
    program: TurningProgram, form: Form, edge: Edge, parts: int, region: tuple[float, float]
) -> float:
    """Return how deep the blocks before the rim cut within radii, the least error; inf if none does.

    Where they touch outside, the edge still passes over the rim: d and how high it is there.
    """
    if not program.lead_in:
        return math.inf
    least = math.inf
    for piece in course_pieces(
        program, form, edge, np.arange(parts) / parts, last=program.lead_in
    ):
        on = np.isfinite(piece.error) & (piece.rho >= region[0]) & (piece.rho <= region[1])
        least = min(least, float(piece.error[on].min(initial=math.inf)))
        out = np.flatnonzero((piece.error < 0.0) & (piece.rho > region[1]))
        if out.size:
            rim = np.full(out.size, region[1])
            rise = rise_beside(form, edge, piece.X[out], rim, piece.theta[out])
            least = min(least, float((piece.error[out] + rise).min()))
    return least


def rise_beside(
    form: Form,
    edge: Edge,
    X: FloatArray,
    rho: FloatArray,
    theta: FloatArray,
    *,
    finds: Callable[..., TipPath] = tips_along,
) -> FloatArray:
    """Return how high above places of the form the edge passes with its tip at X, touching beside; inf if never.

    Places that do not follow one another closely need `finds=tips`.
    """
    y = np.full(rho.shape, edge.dy)
    psi, along = np.zeros(rho.shape), rho
    with np.errstate(invalid="ignore"):
        for _ in range(_PASSES):
            along = np.sqrt((rho - y) * (rho + y))
            psi = edge.angle_at(along - X)
            y = edge.point(psi)[1]
    rise = np.full(rho.shape, np.inf)
    on = np.flatnonzero((psi >= edge.low) & (psi <= edge.high) & (X >= 0.0))
    phi = theta[on] - np.arctan2(y[on], along[on])
    tip = finds(form, X[on], phi, edge, strict=False).z
    place = form.height(rho[on] * np.cos(theta[on]), rho[on] * np.sin(theta[on]))
    rise[on] = tip + edge.point(psi[on])[2] - place
    return np.where(np.isnan(rise), np.inf, rise)


def on_the_cut(
    error: PathErrorMap, form: Form, edge: Edge, servo: Servo, tolerance: float
) -> PathErrorMap:
    """Return the map with what the turns on either side cut away of what stands highest."""
    z, size = error.z, float(np.ptp(error.z))
    if size > _HOPELESS * tolerance:
        return error  # no candidate, whatever its turns cut of one another
    left, seen = z.copy(), np.zeros(z.size, dtype=bool)
    for share in _SHARES:
        high = np.flatnonzero((z >= z.min() + share * size) & ~seen)
        left[high], seen[high] = _beside(error, high, form, edge, servo), True
        if left[seen].max(initial=-math.inf) >= z.min() + share * size:
            break  # what was not looked at stands lower
    return replace(error, z=frozen(left))


def _beside(
    error: PathErrorMap, at: NDArray[np.intp], form: Form, edge: Edge, servo: Servo
) -> FloatArray:
    """Return what is left at samples of a path where the edge cuts there in other turns, too."""
    path = error.path
    turned = (path.radius - error.rho) * (2.0 * math.pi / path.feed)
    rho, theta, left = error.rho[at], error.theta[at], error.z[at]
    if servo == "Z":
        made = tips_along(form, rho, theta, edge, strict=False)
        places = made.rho, made.theta
    else:
        places = rho, theta
    for way in (-1.0, 1.0):
        which = np.arange(at.size)
        for k in range(1, _TURNS_BESIDE):
            off = np.interp(
                turned[at[which]] + 2.0 * math.pi * way * k, turned, error.z, math.inf, math.inf
            )
            # it stands above the place as high as it is off, or more
            near = (off < left[which]) & (rho[which] - way * k * path.feed > 0.0)
            which, off = which[near], off[near]
            if not which.size:
                break
            X = rho[which] - way * k * path.feed
            if servo == "XZ":
                X = contact_path(form, X, theta[which], edge)[0]
            rise = rise_beside(form, edge, X, *(v[which] for v in places))
            lower = off + rise < left[which]
            left[which[lower]] = (off + rise)[lower]
            which = which[rise < left[which] - error.z.min()]
    return left


@dataclass(frozen=True, slots=True, eq=False)
class WorstContacts:
    """The moments of a program that are furthest off, within radii of their contacts."""

    rho: FloatArray  # m
    theta: FloatArray  # rad
    ends: tuple[float, float] = (np.nan, np.nan)  # m: the least and the largest error
    blocks: tuple[int, int] = (0, 0)  # the blocks of these two


def worst_contacts(pieces: Iterator[CoursePiece], region: tuple[float, float]) -> WorstContacts:
    """Return the contacts of the lowest and highest moments within radii, and the extremes of d."""
    kept: FloatArray = np.empty((4, 0))
    for piece in pieces:
        on = np.isfinite(piece.error) & (piece.rho >= region[0]) & (piece.rho <= region[1])
        block_of = piece.block.astype(np.float64)
        rows = np.stack([v[on] for v in (piece.error, piece.rho, piece.theta, block_of)])
        rows = np.concatenate([kept, rows], axis=1)
        if rows.shape[1] > 2 * _WORST:
            order = np.argpartition(rows[0], (_WORST, rows.shape[1] - _WORST))
            rows = rows[:, np.concatenate([order[:_WORST], order[-_WORST:]])]
        kept = rows
    error, rho, theta, block = kept
    if not error.size:
        return WorstContacts(rho, theta)
    low, high = int(np.argmin(error)), int(np.argmax(error))
    return WorstContacts(
        rho, theta, (float(error[low]), float(error[high])), (int(block[low]), int(block[high]))
    )
