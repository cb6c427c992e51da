"""Least squares of circle closure: faces, table errors and zeros of the set-ups at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import InvalidSamplesError, UnitError
from metrosep.core.quantity import Quantity
from metrosep.separation._circle import numbers

__all__ = ["ClosureSolution", "checked_angles", "noise_of_residuals", "solve_closure"]


_LARGEST = 0.1
"""Readings in rad further from their mean are degrees or seconds of arc by mistake."""

_SINGULAR = 1e-9
"""Eigenvalues below this share of the largest are zero: the normal matrix counts readings."""


@dataclass(frozen=True, slots=True)
class ClosureSolution:
    """What the normal equations give."""

    # shape (2, N), rad: artefact and machine, without their means and without hidden harmonics
    parts: FloatArray
    unit_u: FloatArray  # shape (2, N): their standard uncertainty for readings of unit noise
    residual: FloatArray  # shape (P, N), rad: reading minus model; NaN where not measured
    rank: int  # of the normal matrix
    surplus: int  # dimension of the null space beyond means and hidden harmonics


def solve_closure(
    array: FloatArray, positions: tuple[int, ...], sign: int, hidden: list[int]
) -> ClosureSolution:
    """Return the least-squares solution; the unknowns are N faces, N table errors, P zeros."""
    p, n = array.shape
    taken = np.isfinite(array).astype(np.float64)
    value = np.where(taken > 0.0, array, 0.0)
    face = (np.arange(n) + np.array(positions)[:, np.newaxis]) % n
    size = 2 * n + p
    normal, right = np.zeros((size, size)), np.zeros(size)
    table = np.broadcast_to(n + np.arange(n), (p, n))
    setup = np.broadcast_to(2 * n + np.arange(p)[:, np.newaxis], (p, n))
    columns = ((face, 1.0), (table, float(sign)), (setup, 1.0))
    for i, first in columns:
        np.add.at(right, i, first * value)
        for j, second in columns:
            np.add.at(normal, (i, j), first * second * taken)
    keep = _kept(n, hidden)
    with one_blas_thread():
        values, vectors = np.linalg.eigh(normal)
        known = values > _SINGULAR * values[-1]
        root = vectors[:, known] / np.sqrt(values[known])
        found = root @ (root.T @ right)
        spread = np.stack([keep @ root[:n], keep @ root[n : 2 * n]])
    model = found[face] + sign * found[table] + found[setup]
    expected = 2 + sum(1 if 2 * k == n else 2 for k in hidden)
    rank = int(known.sum())
    return ClosureSolution(
        np.stack([keep @ found[:n], keep @ found[n : 2 * n]]),
        np.sqrt(np.sum(spread**2, axis=2)),
        array - model,
        rank,
        size - rank - expected,
    )


def _kept(n: int, hidden: list[int]) -> FloatArray:
    """Return the projector (n, n) that takes off the mean and the hidden harmonics."""
    steps = np.subtract.outer(np.arange(n), np.arange(n))
    keep: FloatArray = np.eye(n) - 1.0 / n
    for k in hidden:
        keep -= (1.0 if 2 * k == n else 2.0) / n * np.cos(2.0 * np.pi * k * steps / n)
    return keep


def checked_angles(readings: ArrayLike, p: int, n: int) -> FloatArray:
    """Return readings (p, n) in rad, refused if infinite, of another shape or unit."""
    array = numbers(readings, "the readings must be a regular array of numbers in rad")
    if array.shape != (p, n):
        raise InvalidSamplesError(
            f"readings of {p} set-ups with {n} divisions need the shape ({p}, {n}), got "
            f"{array.shape}"
        )
    if np.isinf(array).any():
        i, j = (int(v) for v in np.argwhere(np.isinf(array))[0])
        raise InvalidSamplesError(f"reading {j} of set-up {i} is infinite; mark it NaN")
    if np.isnan(array).all():
        raise InvalidSamplesError("nothing was measured: all readings are NaN")
    spread = (
        array
        - np.where(
            np.isnan(array).all(axis=1),
            0.0,
            np.nansum(array, axis=1) / np.maximum(np.isfinite(array).sum(axis=1), 1),
        )[:, np.newaxis]
    )
    largest = float(np.nanmax(np.abs(spread)))
    if largest > _LARGEST:
        raise UnitError(
            f"readings differ by up to {largest:.4g} from their mean; they must be in rad: degrees "
            "or seconds of arc? give numpy.deg2rad(m), or that of m / 3600"
        )
    return array


def noise_of_residuals(stated: float | None, rest: FloatArray, freedom: int) -> Quantity:
    """Return the noise of one reading: as stated, else from the residuals."""
    text = "standard deviation of one reading; "
    if stated is not None:
        return Quantity(stated, "rad", text + "as stated", None, "s")
    if freedom < 1:
        return Quantity(math.nan, "rad", text + "not known", None, "s")
    value = math.sqrt(float(np.nansum(rest**2)) / freedom)
    text += f"type A from residuals, {freedom} degrees of freedom"
    return Quantity(value, "rad", text, value / math.sqrt(2.0 * freedom), "s")
