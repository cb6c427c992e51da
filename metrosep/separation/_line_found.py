"""The parts behind readings of probes in a row, and their uncertainty for unit noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core.errors import NotSeparableError, TooFewSamplesError
from metrosep.separation._line_estimators import (
    Estimator,
    chain_estimator,
    estimator,
    hidden_of_chains,
)
from metrosep.separation._line_probes import (
    GRID_RTOL,
    Row,
    Rows,
    grid_of,
    interpolation,
    rows_without_carriage,
)
from metrosep.separation._line_problem import Problem

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Values with their standard uncertainty for a reading of unit noise.

    Parameters
    ----------
    artefact, straightness, pitch : tuple of (ndarray, ndarray)
        Value, and uncertainty for unit noise of one reading; NaN where not determined.
    zeros : ndarray, shape (n_sensors,)
        Zeros of the sensors that go with an artefact without hidden share.
    zeros_cov : ndarray, shape (n_sensors, n_sensors)
        Their covariance for unit noise.
    zeros_hidden : ndarray, shape (n_sensors, k)
        What hidden artefacts would add to them.
    rest : float
        Sum of squared residuals of the rows.
    freedom : int
        Degrees of freedom of `rest`.
    used : slice
        Carriage positions that the result rests on.
    """

    artefact: tuple[FloatArray, FloatArray]
    straightness: tuple[FloatArray, FloatArray]
    pitch: tuple[FloatArray, FloatArray]
    zeros: FloatArray
    zeros_cov: FloatArray
    zeros_hidden: FloatArray
    rest: float
    freedom: int
    used: slice


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
    whole = ~np.isnan(problem.mean[: problem.n_probes]).any(axis=0)
    edges = np.diff(np.concatenate([[0], whole.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if first.size == 0:
        raise NotSeparableError(
            "at no position were all probes measured: nothing can be separated"
        )
    best = int(np.argmax(last - first))
    return slice(int(first[best]), int(last[best]))


def _solve_piece(
    problem: Problem, piece: slice, method: str, smoothing: float, degree: int
) -> Found | None:
    """Return the parts from some positions; None where they do not hang together."""
    row, m = problem.row, problem.mean[:, piece]
    x = problem.x[piece]
    n, n_sensors = x.size, m.shape[0]
    grid = grid_of(row, x)
    if n < 2 or grid.size <= degree + 2:
        raise TooFewSamplesError(
            f"{n} positions in a row are too few for these probe distances and steps"
        )
    valid = ~np.isnan(m)
    if method == "sequential":
        if not valid.all():
            return None
        rows = _chain_rows(row, n, problem.sd)
    else:
        rows = rows_without_carriage(valid, problem.nuisance, problem.sd)
    at_probe = [interpolation(grid, at) for at in _probe_places(row, x, grid)]
    stack = _stacked(at_probe, n_sensors, n, grid.size, problem.sd)
    zero_columns = rows.weights @ np.kron(problem.zeros / problem.sd[:, None], np.ones((n, 1)))
    if method == "sequential":
        estimate = chain_estimator(row, n, degree=degree)
    else:
        estimate = estimator(
            rows.weights @ stack,
            zero_columns,
            method=method,
            smoothing=smoothing,
            degree=degree,
            guess=_guess(row, grid.size, degree),
        )
        if estimate.hidden.shape[1] > _expected_hidden(row, degree) and not valid.all():
            return None
    return _parts(problem, piece, rows, stack, estimate, grid)


def _probe_places(row: Row, x: FloatArray, grid: FloatArray) -> list[FloatArray]:
    """Return where each probe reads: on the grid itself where steps are equal and offsets whole."""
    even = np.abs(np.diff(x) - row.step).max() <= 2.0 * GRID_RTOL * row.step
    if row.shifts is not None and even:
        return [grid[k : k + x.size] for k in row.shifts]
    return [x + o for o in row.offsets]


def _guess(row: Row, m: int, degree: int) -> FloatArray:
    """Return an orthonormal basis of what whole readings of this row should not see."""
    order = 2 if row.pitch else 1
    return hidden_of_chains(m, max(row.grid_period, 1), order, degree)


def _expected_hidden(row: Row, degree: int) -> int:
    """Return the dimension of what whole readings leave unseen."""
    order = 2 if row.pitch else 1
    least = order * max(row.grid_period, 1)
    if len(row.offsets) == order + 1:
        least = max(least, row.span)
    return least + max(degree + 1 - order, 0)


def _chain_rows(row: Row, n: int, sd: FloatArray) -> Rows:
    from scipy.sparse import csr_array, eye_array, kron

    w = row.weights / np.linalg.norm(row.weights)
    return Rows(csr_array(kron(w[None, :], eye_array(n))), sd)


def _stacked(at_probe: list[Any], n_sensors: int, n: int, m: int, sd: FloatArray) -> Any:
    from scipy.sparse import csr_array, vstack

    blocks = [p / s for p, s in zip(at_probe, sd, strict=False)]
    blocks += [csr_array((n, m)) for _ in range(n_sensors - len(blocks))]
    return csr_array(vstack(blocks))


def _parts(
    problem: Problem,
    piece: slice,
    rows: Rows,
    stack: Any,
    estimate: Estimator,
    grid: FloatArray,
) -> Found:
    m = problem.mean[:, piece]
    y = rows.of(m)
    f = estimate.artefact @ y
    amplitudes = estimate.zeros @ y
    n_sensors, n = m.shape
    scaled = np.where(np.isnan(m), np.nan, m) / problem.sd[:, None]
    seen_zero = problem.zeros if amplitudes.size else None
    rest = scaled - (stack @ f).reshape(n_sensors, n)
    if seen_zero is not None:
        rest = rest - (seen_zero @ amplitudes / problem.sd)[:, None]
    carriage, u_carriage = _carriage(problem, rest, stack, estimate, seen_zero)
    u_f = np.sqrt(np.einsum("ij,ij->i", estimate.artefact, estimate.artefact))
    zeros, cov, hidden = (
        np.zeros(n_sensors),
        np.zeros((n_sensors, n_sensors)),
        np.zeros((n_sensors, 1)),
    )
    if seen_zero is not None:
        zeros, hidden = seen_zero @ amplitudes, seen_zero @ estimate.zeros_hidden
        cov = (seen_zero @ estimate.zeros) @ (seen_zero @ estimate.zeros).T
    design_f = rows.weights @ (stack @ f)
    left = y - design_f
    if estimate.zeros.shape[0]:
        columns = rows.weights @ np.kron(problem.zeros / problem.sd[:, None], np.ones((n, 1)))
        left = left - columns @ (np.linalg.pinv(columns) @ left)
    whole = slice(piece.start, piece.start + n)
    return Found(
        _placed(f, u_f, grid, problem.grid),
        _inserted(carriage[:, 0], u_carriage[:, 0], whole, problem.x.size),
        _inserted(carriage[:, 1], u_carriage[:, 1], whole, problem.x.size),
        zeros,
        cov,
        hidden,
        float(left @ left),
        estimate.freedom,
        whole,
    )


def _carriage(
    problem: Problem,
    rest: FloatArray,
    stack: Any,
    estimate: Estimator,
    seen_zero: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:
    """Return straightness and pitch at each position, and their uncertainty for unit noise.

    The share of the readings along the carriage is independent of the rows, so two variances add.
    """
    from scipy.sparse import csr_array

    n_sensors, n = rest.shape
    p = problem.nuisance.shape[1]
    valid = ~np.isnan(rest)
    values, u = np.full((n, 2), np.nan), np.full((n, 2), np.nan)
    code = (valid.T @ (1 << np.arange(n_sensors))).astype(np.int64)
    for pattern in np.unique(code):
        used = [s for s in range(n_sensors) if pattern >> s & 1]
        scaled = problem.nuisance[used] / problem.sd[used, None]
        if not used or np.linalg.matrix_rank(scaled) < p:
            continue
        inverse = np.linalg.pinv(scaled)
        at = np.flatnonzero(code == pattern)
        values[at, :p] = (inverse @ rest[used][:, at]).T
        for c in range(p):
            columns = np.concatenate([s * n + at for s in used])
            data = np.repeat(inverse[c], at.size)
            pick = csr_array(
                (data, (np.tile(np.arange(at.size), len(used)), columns)),
                shape=(at.size, n_sensors * n),
            )
            through = csr_array(pick @ stack) @ estimate.artefact
            if seen_zero is not None:
                gain = inverse[c] @ (seen_zero / problem.sd[:, None])[used]
                through = through + (gain @ estimate.zeros)[None, :]
            own = float(inverse[c] @ inverse[c])
            u[at, c] = np.sqrt(own + np.einsum("ij,ij->i", through, through))
    return values, u


def _placed(
    f: FloatArray, u: FloatArray, grid: FloatArray, whole: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a piece of the artefact on the grid of all of it."""
    values, uncertainty = np.full(whole.size, np.nan), np.full(whole.size, np.nan)
    if grid.size == whole.size:
        return f, u
    first = round(float((grid[0] - whole[0]) / (whole[1] - whole[0])))
    values[first : first + f.size], uncertainty[first : first + f.size] = f, u
    return values, uncertainty


def _inserted(
    values: FloatArray, u: FloatArray, piece: slice, n: int
) -> tuple[FloatArray, FloatArray]:
    out, uncertainty = np.full(n, np.nan), np.full(n, np.nan)
    out[piece], uncertainty[piece] = values, u
    return out, uncertainty
