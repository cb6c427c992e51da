"""How far a program is off between its points: the height of the tip minus the lowest that cuts nothing.

At moments between the points of every block, X, azimuth and Z are what the control makes of them, and

    d = Z(t) - max over psi of [ S(P(psi)) - z(psi) ]

at that X and azimuth: what X and C do wrong together with Z is in it. The part is at no contact lower
than d, and nowhere higher than the largest d and a cusp. Errors are actual minus nominal along z.
specs/cutting-path.md, equations (4) and (22).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.forms.base import Form
from metrosep.process.cutting.programs import AxisCourse, TurningProgram
from metrosep.process.tips import Edge, tips, tips_along

__all__ = ["CoursePiece", "WorstContacts", "course_error", "course_pieces", "worst_contacts"]

_PIECE = 1 << 15
"""Moments that are worked on at once."""
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


def course_pieces(
    program: TurningProgram,
    form: Form,
    edge: Edge,
    shares: FloatArray,
    *,
    first: int = 0,
    strict: bool = False,
) -> Iterator[CoursePiece]:
    """Yield pieces of a program from block `first` on, at shares of the time of each block."""
    parts, last = shares, len(program) - 1
    per = max(1, _PIECE // parts.size)
    for begin in range(first, last, per):
        end = min(begin + per, last)
        course = AxisCourse.of(program, slice(begin, end + 1))
        i = np.repeat(np.arange(end - begin), parts.size)
        X, azimuth, Z = (course.value(a, i, np.tile(parts, end - begin)) for a in range(3))
        made = tips_along(form, X, azimuth, edge, strict=strict)
        yield CoursePiece(
            begin + i, Z - made.z, made.rho, made.theta, made.along_x, made.along_y,
            edge.by_azimuth(X, made.psi, made.along_x, made.along_y),
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


@dataclass(frozen=True, slots=True, eq=False)
class WorstContacts:
    """The moments of a program that are furthest off, within radii of their contacts."""

    rho: FloatArray  # m
    theta: FloatArray  # rad
    ends: tuple[float, float] = (np.nan, np.nan)  # m: the least and the largest error
    blocks: tuple[int, int] = (0, 0)  # the blocks of these two


def worst_contacts(pieces: Iterator[CoursePiece], region: tuple[float, float]) -> WorstContacts:
    """Return the contacts of the lowest and highest moments within radii, and the extremes of d."""
    kept = np.empty((4, 0))
    for piece in pieces:
        on = np.isfinite(piece.error) & (piece.rho >= region[0]) & (piece.rho <= region[1])
        rows = np.stack([v[on] for v in (piece.error, piece.rho, piece.theta, piece.block)])
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
