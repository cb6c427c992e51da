"""The parts behind readings of probes in a row, and their uncertainty for unit noise."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DegenerateFitError, NotSeparableError, TooFewSamplesError
from metrosep.core.units import format_length
from metrosep.separation.lines._line_problem import (
    Problem,
    Row,
    Rows,
    Stations,
    grid_of,
    interpolation,
    kinds_of,
    longest_run,
    needed_travel,
    probe_places,
    read_samples,
    rows_without_carriage,
)


class Found(NamedTuple):
    """Values with their standard uncertainty for a reading of unit noise."""

    # of (ndarray, ndarray): value, and uncertainty for unit noise of one reading; NaN where not
    # determined
    artefact: tuple[FloatArray, FloatArray]
    straightness: tuple[FloatArray, FloatArray]
    pitch: tuple[FloatArray, FloatArray]
    # shape (n_sensors,): zeros of the sensors that go with an artefact without hidden share
    zeros: FloatArray
    zeros_cov: FloatArray  # shape (n_sensors, n_sensors): their covariance for unit noise
    zeros_hidden: FloatArray  # shape (n_sensors, k): what hidden artefacts would add to them
    rest: float  # sum of squared residuals of the rows
    rest_least: float  # the same of plain least squares
    freedom: int  # degrees of freedom of `rest_least`
    used: slice  # slice: carriage positions that the result rests on
    n_unread: int  # samples within that no probe read
    # shape (n, n_rows): what the straightness takes of white rows; their share of its covariance
    through: FloatArray


def solve(problem: Problem, *, method: str, smoothing: float, degree: int) -> Found:
    """Return the parts; where gaps cut the chain, of its longest piece."""
    found = _solve_piece(problem, slice(0, problem.x.size), method, smoothing, degree)
    if found is not None:
        return found
    piece = _longest_piece(problem)
    found = _solve_piece(problem, piece, method, smoothing, degree)
    if found is None:
        raise NotSeparableError(
            f"what was measured does not hang together: {piece.stop - piece.start} positions in a "
            "row are too few for these probe distances; measure the gaps again"
        )
    return found


def _longest_piece(problem: Problem) -> slice:
    """Return the longest run of positions at which every probe was measured."""
    piece = longest_run(problem.stations.whole(problem.n_probes, problem.x.size))
    if piece.stop == piece.start:
        raise NotSeparableError(
            "at no position were all probes measured: nothing can be separated"
        )
    return piece


def _solve_piece(
    problem: Problem, piece: slice, method: str, smoothing: float, degree: int
) -> Found | None:
    """Return the parts from some positions; None where they do not hang together."""
    row, stations, x = problem.row, problem.stations.within(piece), problem.x[piece]
    n, grid = x.size, grid_of(row, x)
    if n < 2 or grid.size <= degree + 2:
        raise TooFewSamplesError(
            f"{n} positions in a row are too few for these probe distances and steps"
        )
    if x[-1] - x[0] < needed_travel(row):
        return None
    whole = bool(stations.whole(problem.n_probes, n).all())
    sequential = method == "sequential"
    if sequential and not whole:
        return None
    full = np.flatnonzero(stations.valid[: problem.n_probes].all(axis=0))  # one for each position
    if sequential:
        rows = _chain_rows(row, stations, full)
    else:
        rows = rows_without_carriage(stations.valid, problem.nuisance, stations.sd)
    places = probe_places(row, x, grid)
    read = read_samples(rows, places, stations.at, grid, row.step)
    if int(read.sum()) <= degree + 2:
        return None
    stack = _stacked([interpolation(grid, at) for at in places], stations)
    # what each sensor at each station sees of the unknown zeros
    columns = problem.zeros[:, None, :] / stations.sd[:, :, None]
    columns = columns.reshape(stations.sd.size, problem.zeros.shape[1])
    y = rows.of(stations.values)
    estimate: Estimator | None
    if sequential:
        estimate = chain_estimator(row, stations.sd[0, full], degree=degree)
    else:
        expected = _expected_hidden(row, degree, read)
        estimate = None
        if int(read.sum()) - y.size <= expected:
            estimate = estimator(
                rows.weights @ stack,
                rows.weights @ columns,
                y,
                method=method,
                smoothing=smoothing,
                degree=degree,
                guess=_guess(row, grid.size, degree),
                read=read,
            )
        if estimate is None or estimate.hidden.shape[1] > expected:
            if not whole:
                return None
            raise NotSeparableError(
                f"{n} positions {format_length(float(np.mean(np.diff(x))))} apart do not determine "
                f"{grid.size} samples of the artefact at a step of {format_length(row.step)}: the "
                "samples are not read by probes that hang together; give a step not finer than the "
                "positions, or more positions"
            )
    return _parts(problem, piece, stations, rows, y, stack, columns, estimate, grid, read)


def _guess(row: Row, m: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of what whole readings of this row should not see."""
    order = 2 if row.pitch else 1
    return hidden_of_chains(m, max(row.grid_period, 1), order, degree)


def _expected_hidden(row: Row, degree: int, read: NDArray[np.bool_]) -> int:
    """Return the dimension of what whole readings leave unseen of the samples that were read."""
    order = 2 if row.pitch else 1
    chains = np.unique(np.flatnonzero(read) % max(row.grid_period, 1)).size
    least = order * chains
    if len(row.offsets) == order + 1:
        least = max(least, row.span - int((~read).sum()))
    return least + max(degree + 1 - order, 0)


def _chain_rows(row: Row, stations: Stations, used: NDArray[np.intp]) -> Rows:
    from scipy.sparse import csr_array

    w = row.weights / np.linalg.norm(row.weights)
    index = np.tile(np.arange(used.size), w.size)
    columns = np.concatenate([s * stations.at.size + used for s in range(w.size)])
    shape = (used.size, w.size * stations.at.size)
    return Rows(csr_array((np.repeat(w, used.size), (index, columns)), shape=shape), stations.sd)


def _stacked(at_probe: list[Any], stations: Stations) -> Any:
    """Return what each sensor at each station sees of the artefact, in units of its deviation."""
    from scipy.sparse import csr_array, diags_array, vstack

    blocks = [
        diags_array(1.0 / sd) @ csr_array(p)[stations.at]
        for p, sd in zip(at_probe, stations.sd, strict=False)
    ]
    empty = csr_array((stations.at.size, at_probe[0].shape[1]))
    return csr_array(vstack(blocks + [empty] * (stations.sd.shape[0] - len(blocks))))


def _parts(
    problem: Problem,
    piece: slice,
    stations: Stations,
    rows: Rows,
    y: FloatArray,
    stack: Any,
    columns: FloatArray,
    estimate: Estimator,
    grid: FloatArray,
    read: NDArray[np.bool_],
) -> Found:
    seen, n = stack[:, np.flatnonzero(read)], piece.stop - piece.start
    f, amplitudes = estimate.artefact @ y, estimate.zeros @ y
    rest = np.where(stations.valid, stations.values / stations.sd, 0.0).ravel() - seen @ f
    left = y - rows.weights @ (seen @ f)
    if amplitudes.size:
        rest = rest - columns @ amplitudes
        zero_rows = rows.weights @ columns
        left = left - zero_rows @ (np.linalg.pinv(zero_rows) @ left)
    values, u = np.full((2, problem.x.size), np.nan), np.full((2, problem.x.size), np.nan)
    shared = np.zeros((problem.x.size, y.size))
    for c, matrix in enumerate(_carriage_of(problem.nuisance, stations, n)):
        known = np.flatnonzero(np.diff(matrix.indptr))
        through = (matrix @ seen) @ estimate.artefact
        if amplitudes.size:
            through = through + (matrix @ columns) @ estimate.zeros
        if c == 0:
            shared[piece] = through
        own = np.asarray(matrix.multiply(matrix).sum(axis=1)).ravel()
        spread = np.sqrt(own + np.einsum("ij,ij->i", through, through))
        values[c, piece.start + known] = (matrix @ rest)[known]
        u[c, piece.start + known] = spread[known]
    artefact, u_artefact = np.full((2, problem.grid.size), np.nan)
    step = problem.grid[1] - problem.grid[0]
    index = np.round((grid[read] - problem.grid[0]) / step).astype(np.intp)
    artefact[index] = f
    u_artefact[index] = np.sqrt(np.einsum("ij,ij->i", estimate.artefact, estimate.artefact))
    to_zeros = (
        problem.zeros @ estimate.zeros if amplitudes.size else np.zeros((problem.n_sensors, 1))
    )
    return Found(
        (artefact, u_artefact),
        (values[0], u[0]),
        (values[1], u[1]),
        problem.zeros @ amplitudes if amplitudes.size else np.zeros(problem.n_sensors),
        to_zeros @ to_zeros.T,
        problem.zeros @ estimate.zeros_hidden if amplitudes.size else to_zeros,
        float(left @ left),
        estimate.rest,
        estimate.freedom,
        slice(piece.start, piece.start + n),
        int((~read).sum()),
        shared,
    )


def _carriage_of(nuisance: FloatArray, stations: Stations, n: int) -> list[Any]:
    """Return the matrices that take what the artefact leaves to straightness, and pitch.

    A position has the mean over its passes. The share of readings along the carriage is independent
    of the rows, so the variances of both add.
    """
    from scipy.sparse import csr_array

    size = stations.at.size
    kind, group = kinds_of(stations.valid, stations.sd)
    inverse: dict[int, FloatArray] = {}
    for g, i in enumerate(kind):
        used = stations.valid[:, i]
        scaled = nuisance[used] / stations.sd[used, i][:, None]
        if used.any() and np.linalg.matrix_rank(scaled) == nuisance.shape[1]:
            inverse[g] = np.linalg.pinv(scaled)
    counts = np.where(np.isin(group, list(inverse)), stations.count, 0)
    share = counts / np.maximum(np.bincount(stations.at, counts, minlength=n)[stations.at], 1.0)
    found = []
    for c in range(nuisance.shape[1]):
        at, columns, data = [np.empty(0, int)], [np.empty(0, int)], [np.empty(0)]
        for g, gain in inverse.items():
            here = np.flatnonzero(group == g)
            for k, s in enumerate(np.flatnonzero(stations.valid[:, kind[g]])):
                at.append(stations.at[here])
                columns.append(s * size + here)
                data.append(gain[c, k] * share[here])
        place = (np.concatenate(at), np.concatenate(columns))
        shape = (n, stations.sd.shape[0] * size)
        found.append(csr_array((np.concatenate(data), place), shape=shape))
    return found


# ---- linear estimators of an artefact from rows in which the carriage has cancelled ------------
# Each is one matrix F with ``f = F y``; rows y are white, so the covariance is ``s^2 F F'`` exactly.
# What no row sees is removed by least squares, never filled.

RANK_RTOL = 1e-10
"""Singular values below this share of the largest count as zero: three probes one step apart on
4000 positions have 4e-7, rounding gives 1e-14."""

LARGE = 600
"""Up to this many samples the null space is found by singular values, above it is verified."""


class Estimator(NamedTuple):
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
