"""Linear estimators of an artefact from rows in which the carriage has cancelled.

Each is one matrix F with ``f = F y``; rows y are white, so the covariance is ``s^2 F F'`` exactly.
What no row sees is removed by least squares, never filled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError
from metrosep.separation._line_probes import Row

RANK_RTOL = 1e-10
"""Singular values below this share of the largest count as zero: three probes one step apart on
4000 positions have 4e-7, rounding gives 1e-14."""

LARGE = 600
"""Up to this many samples the null space is found by singular values, above it is verified."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimator:
    """How the artefact and the zeros follow from rows."""

    artefact: FloatArray  # shape (m, n_rows): matrix F
    zeros: FloatArray  # shape (q, n_rows): the same for the amplitudes of the zero columns
    # shape (m, k): orthonormal artefacts that no row sees, whatever the zeros are
    hidden: FloatArray
    freedom: int  # rows in excess of what they determine
    # shape (q, k): how much of the zero amplitudes goes along with each hidden artefact
    zeros_hidden: FloatArray
    rest: float = 0.0  # sum of squared residuals that plain least squares leaves of the rows


def estimator(
    design: Any,
    zero_columns: FloatArray,
    y: FloatArray,
    *,
    method: str,
    smoothing: float,
    degree: int,
    guess: FloatArray,
    read: NDArray[np.bool_],
) -> Estimator:
    """Return the estimator of a method by singular values of its actual design."""
    with one_blas_thread():
        full = np.asarray(design.todense() if hasattr(design, "todense") else design)
        basis, z_inverse = _zero_basis(zero_columns)
        a = full if read.all() else full[:, read]
        seen = a - basis @ (basis.T @ a)
        least, hidden, rank = _pseudo_inverse(seen, guess if read.all() else guess[:0, :0])
        free = y - basis @ (basis.T @ y)
        residual = free - seen @ (least @ free)
        f = least
        if method != "least_squares":
            smooth = _smoothed(full - basis @ (basis.T @ full), smoothing, degree)[read]
            f = smooth if method == "generalised" else least + hidden @ (hidden.T @ smooth)
        f = without_polynomial(f, degree, np.flatnonzero(read))
        f = f - (f @ basis) @ basis.T
        zeros = z_inverse - z_inverse @ (a @ f)
        leak = z_inverse @ (a @ hidden)
    freedom = a.shape[0] - rank - basis.shape[1]
    return Estimator(f, zeros, hidden, freedom, leak, float(residual @ residual))


def chain_estimator(row: Row, sd: FloatArray, *, degree: int) -> Estimator:
    """Return the sequential estimator of equidistant positions.

    Notes
    -----
    Two probes: ``f(x + d) = f(x) + D``; three: ``f(x + 2d) = 2 f(x + d) - f(x) + D``, two sums in
    succession. Then the line (two probes: the offset) of each chain is removed, and a polynomial
    common to all.
    """
    shifts = row.shifts
    assert shifts is not None  # noqa: S101  (checked by the caller)
    s, order = shifts[1], len(shifts) - 1
    n = sd.size
    m = n + order * s
    f = np.zeros((m, n))
    f[np.arange(n) + order * s, np.arange(n)] = float(np.linalg.norm(row.weights)) * sd
    for _ in range(order):
        for k in range(s, m):
            f[k] += f[k - s]
    hidden = hidden_of_chains(m, s, order, degree)
    with one_blas_thread():
        f -= hidden @ (hidden.T @ f)
    return Estimator(f, np.empty((0, n)), hidden, 0, np.empty((0, hidden.shape[1])))


def hidden_of_chains(m: int, s: int, order: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of what sums along s chains cannot see."""
    at = np.arange(m)
    t = (at - (m - 1) / 2.0) / m
    columns = [np.where(at % s == r, t**p, 0.0) for r in range(min(s, m)) for p in range(order)]
    columns += [t**p for p in range(order, degree + 1)]
    return np.asarray(np.linalg.qr(np.column_stack(columns))[0])


def without_polynomial(
    values: FloatArray, degree: int, at: NDArray[np.intp] | None = None
) -> FloatArray:
    """Return columns without their least-squares polynomial over equal steps, or over samples."""
    m = values.shape[0]
    if degree < 0:
        return values
    t = np.linspace(-1.0, 1.0, m) if at is None else 2.0 * (at - at[0]) / (at[-1] - at[0]) - 1.0
    q = np.linalg.qr(np.polynomial.legendre.legvander(t, min(degree, m - 1)))[0]
    return np.asarray(values - q @ (q.T @ values))


def _zero_basis(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis of the zero columns and their pseudo-inverse."""
    if columns.shape[1] == 0:
        return np.empty((columns.shape[0], 0)), np.empty((0, columns.shape[0]))
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    keep = size > 1e-12 * max(float(size.max(initial=0.0)), 1e-300)
    basis = left[:, keep]
    return basis, (right[keep].T / size[keep]) @ basis.T


def _pseudo_inverse(a: FloatArray, guess: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return the pseudo-inverse, the null space and the rank."""
    from scipy.linalg import qr, svd

    if a.shape[1] > LARGE and np.abs(a @ guess).max(initial=0.0) < 1e-9 * np.abs(a).max():
        bordered = _bordered_inverse(a, guess)
        if bordered is not None:
            return bordered, guess, a.shape[1] - guess.shape[1]
    q, r = qr(a, mode="economic") if a.shape[0] > a.shape[1] else (None, a)
    left, size, right = svd(r, full_matrices=True)
    largest = float(size.max(initial=0.0))
    if largest == 0.0:
        raise DegenerateFitError(
            "no combination of these readings sees the artefact: at no position were enough probes "
            "measured"
        )
    rank = int((size > RANK_RTOL * largest).sum())
    inverse = (right[:rank].T / size[:rank]) @ left[:, :rank].T
    return (inverse if q is None else inverse @ q.T), right[rank:].T, rank


def _bordered_inverse(a: FloatArray, hidden: FloatArray) -> FloatArray | None:
    """Return the pseudo-inverse of a matrix of known null space; None if there is more of it.

    Rows that ask for nothing of the null space make the columns independent and change nothing
    else; the condition number of R then shows whether the null space was all.
    """
    from scipy.linalg import qr, solve_triangular
    from scipy.linalg.lapack import dtrcon

    bordered = np.vstack([a, hidden.T])
    if bordered.shape[0] < bordered.shape[1]:
        return None
    q, r = qr(bordered, mode="economic", check_finite=False)
    rcond, _ = dtrcon(r, norm="1", uplo="U", diag="N")
    if rcond < RANK_RTOL / 100.0:
        return None
    return np.asarray(solve_triangular(r, q[: a.shape[0]].T, check_finite=False))


def _smoothed(a: FloatArray, smoothing: float, degree: int) -> FloatArray:
    """Return the estimator with a penalty on third differences: parabolas cost nothing."""
    m = a.shape[1]
    bend = np.sqrt(smoothing) * np.diff(np.eye(m), n=3, axis=0)
    line = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, m), degree))[0]
    inverse = _bordered_inverse(np.vstack([a - (a @ line) @ line.T, bend]), line)
    if inverse is None:
        inverse, _, _ = _pseudo_inverse(np.vstack([a, bend]), line)
    return inverse[:, : a.shape[0]]
