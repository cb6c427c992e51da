"""Error map of a plane from lines along x and lines along y, joined at their crossings.

Each line is read with an offset and (unless stated) a slope of its own, because the probe or the
straightedge is set anew: ``line_j(x) = e(x, y_j) + a_j + b_j x`` and ``line_i(y) = e(x_i, y) + c_i +
d_i y``. Least squares over all readings gives the map; nothing couples x and y in advance, so the
map may hold what a sum of two axis errors cannot. Rows grow with y, columns with x.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, NotSeparableError, TooFewSamplesError
from metrosep.core.provenance import Step
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.separation._plane_input import plane_steps
from metrosep.separation._real_numbers import real_numbers
from metrosep.separation.contract import Separation
from metrosep.separation.null_space import Unobservable
from metrosep.separation.planner_checks import positive

__all__ = ["coupled_grid"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Slopes = Literal["free", "common", "none"]

_RANK = 1e-9
"""Eigenvalues below this share of the largest one belong to the null space."""

TERMS = {
    "free": ("piston", "tilt x", "tilt y", "twist xy"),
    "common": ("piston", "tilt x", "tilt y"),
    "none": ("piston",),
}


def coupled_grid(
    x_lines: Surface | ArrayLike,
    y_lines: Surface | ArrayLike,
    *,
    dx: float | None = None,
    dy: float | None = None,
    slopes: Slopes = "free",
    u_reading: float | None = None,
) -> Separation:
    """Return the error map that lines in both directions agree on.

    Parameters
    ----------
    x_lines : Surface or array_like, shape (n_y, n_x) or (n_repeats, n_y, n_x), m
        Readings of lines along x, one a row; rows without a line are NaN.
    y_lines : Surface or array_like, same shape, m
        Readings of lines along y, one a column; columns without a line are NaN.
    dx, dy : float, m, optional
        Steps of the grid, for plain arrays.
    slopes : {"free", "common", "none"}, optional
        Whether each line has a slope of its own, the lines of a direction share one, or the
        lines keep a common reference (a level, a flat that stays).
    u_reading : float, m, optional
        Standard uncertainty of one reading, where redundancy is missing.

    Returns
    -------
    Separation
        Part ``error`` (n_y, n_x) with ``u``; the null space is removed by least squares.

    Raises
    ------
    DataError
        If shapes differ, steps or `u_reading` are not usable, or `slopes` is unknown.
    InvalidSamplesError
        If readings are not real numbers.
    NotSeparableError
        If one direction has no lines, or the crossings do not join them.
    TooFewSamplesError
        If a direction has fewer than two lines.

    Notes
    -----
    Null space: what every x line and every y line can take as its own offset and slope. With free
    slopes ``1, x, y, xy``: the twist of the plane is lost, although both directions are measured.
    With a common slope ``1, x, y``; with a fixed reference ``1``. Points on a line that crosses
    others less than twice are NaN. u is that of the map without these terms.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> e = 1e-9 * rng.standard_normal((5, 6))
    >>> rows = e + 1e-6 * rng.standard_normal((5, 1))
    >>> columns = e + 1e-6 * rng.standard_normal((1, 6))
    >>> found = coupled_grid(rows, columns, dx=1e-3, dy=1e-3, slopes="none")
    >>> bool(abs(found.error - (e - e.mean())).max() < 1e-18)
    True
    """
    if slopes not in TERMS:
        raise DataError(f"slopes is 'free', 'common' or 'none', got {slopes!r}")
    if u_reading is not None:
        u_reading = positive(u_reading, "u_reading", "m", zero=True)
    sets, x, y, history = _sets(x_lines, y_lines, dx, dy)
    counts = np.stack([(~np.isnan(s)).sum(axis=0) for s in sets])
    n_lines = (int(counts[0].any(axis=1).sum()), int(counts[1].any(axis=0).sum()))
    for n, axis, other in ((n_lines[0], "x", "y"), (n_lines[1], "y", "x")):
        if n == 0:
            raise NotSeparableError(
                f"there is no line along {axis}: lines along {other} alone leave their offsets and "
                f"slopes against each other open; add at least two lines along {axis}"
            )
        if n < 2:
            raise TooFewSamplesError(
                f"there is one line along {axis}; two or more are needed to join the others"
            )
    with one_blas_thread():
        solved = _Joined(sets, counts, x, y, slopes)
    noise, sigma = _noise(solved, u_reading)
    shape = counts.shape[1:]
    error, u = np.full(shape, np.nan), np.full(shape, np.nan)
    error[solved.used] = solved.error
    u[solved.used] = sigma * np.sqrt(solved.variance)
    lost = int((counts.any(axis=0) & ~solved.used).sum())
    null = [unseen_terms(slopes)]
    messages = [f"removed from the map because no line can see it: {', '.join(TERMS[slopes])}"]
    if lost:
        null.append(
            Unobservable("error", "samples", (lost,), "on lines that cross too few others: NaN")
        )
        messages.append(f"{lost} points lie on lines that cross too few others: NaN")
    if math.isnan(sigma):
        messages.append("no redundancy and no u_reading: the uncertainty is not known (NaN)")
    return Separation(
        "coupled_grid",
        {"error": error},
        {"error": u},
        {"error": "m"},
        {"x": x, "y": y},
        tuple(null),
        noise,
        audit={
            "n_lines_along_x": n_lines[0],
            "n_lines_along_y": n_lines[1],
            "n_readings": int(counts.sum()),
            "n_crossings": int((counts.min(axis=0) > 0).sum()),
            "slopes": slopes,
            "degrees_of_freedom": solved.dof,
            "residual_rms_nm": solved.residual_rms * 1e9,
            "removed": list(TERMS[slopes]),
        },
        messages=tuple(messages),
        history=history,
    )


def unseen_terms(slopes: Slopes) -> Unobservable:
    """Return what every line can take as its own offset and slope.

    Parameters
    ----------
    slopes : {"free", "common", "none"}
        As for `coupled_grid`.

    Returns
    -------
    Unobservable
        Terms of the error map.
    """
    reason = (
        "each line has an offset and a slope of its own"
        if slopes == "free"
        else "the reference of the lines is not known"
    )
    return Unobservable("error", "term", TERMS[slopes], reason)


class _Joined:
    """Least-squares map over the points that the crossings determine."""

    def __init__(
        self,
        sets: list[FloatArray],
        counts: NDArray[np.int64],
        x: FloatArray,
        y: FloatArray,
        slopes: str,
    ) -> None:
        used: BoolArray = np.asarray(counts.any(axis=0))
        for _ in range(counts.shape[1] + counts.shape[2]):
            joined = (counts.min(axis=0) > 0) & used
            if joined.any(axis=1).sum() < 2 or joined.any(axis=0).sum() < 2:
                break
            lost = self._solve(sets, counts, used, x, y, slopes)
            if not lost.any():
                return
            used = np.asarray(used & ~lost)
        raise NotSeparableError(
            "the crossings do not join the lines: at least two lines along x must cross the same "
            "two lines along y; measure longer lines or more of them"
        )

    def _solve(
        self,
        sets: list[FloatArray],
        counts: NDArray[np.int64],
        used: BoolArray,
        x: FloatArray,
        y: FloatArray,
        slopes: str,
    ) -> BoolArray:
        rows, columns = np.nonzero(used)
        u, v = _unit(x)[columns], _unit(y)[rows]
        basis = [_line_basis(rows, u, y.size, slopes), _line_basis(columns, v, x.size, slopes)]
        zero = [np.zeros_like(b) for b in basis]
        design = [np.hstack([basis[0], zero[1]]), np.hstack([zero[0], basis[1]])]
        weights = [counts[s][used].astype(np.float64) for s in range(2)]
        means = [
            np.divide(np.nansum(sets[s], axis=0)[used], w, out=np.zeros(w.size), where=w > 0)
            for s, w in enumerate(weights)
        ]
        total = weights[0] + weights[1]
        coupling = sum(d * w[:, np.newaxis] for d, w in zip(design, weights, strict=True))
        coupling = np.asarray(coupling) / total[:, np.newaxis]  # D^-1 B
        pair = (weights[0] * weights[1] / total)[:, np.newaxis]
        difference = design[0] - design[1]
        schur = difference.T @ (pair * difference)
        right = difference.T @ (pair[:, 0] * (means[0] - means[1]))
        values, vectors = np.linalg.eigh(schur)
        null = values < _RANK * values[-1]
        inverse = (vectors[:, ~null] / values[~null]) @ vectors[:, ~null].T
        lines = inverse @ right
        mean = (weights[0] * means[0] + weights[1] * means[1]) / total
        error = mean - coupling @ lines
        regular = np.column_stack(
            [np.ones(u.size), u, v, u * v][: {"free": 4, "common": 3, "none": 1}[slopes]]
        )
        orthonormal = np.linalg.qr(regular)[0]
        shapes = coupling @ vectors[:, null]
        extra = shapes - orthonormal @ (orthonormal.T @ shapes)
        lost = np.zeros(used.shape, dtype=bool)
        lost[rows, columns] = np.abs(extra).max(axis=1, initial=0.0) > 1e-6
        if lost.any():
            return _whole_or_loose(lost, used, counts)
        self.used = used
        self.error = error - orthonormal @ (orthonormal.T @ error)
        self.variance = _variance(total, coupling, inverse, orthonormal)
        self._score(sets, used, error, design, lines, int((~null).sum()))
        return lost

    def _score(
        self,
        sets: list[FloatArray],
        used: BoolArray,
        error: FloatArray,
        design: list[FloatArray],
        lines: FloatArray,
        rank: int,
    ) -> None:
        left = [s[:, used] - (error + d @ lines) for s, d in zip(sets, design, strict=True)]
        squares = sum(float(np.nansum(r**2)) for r in left)
        n = sum(int((~np.isnan(r)).sum()) for r in left)
        self.dof = n - error.size - rank
        self.squares = squares
        self.residual_rms = math.sqrt(squares / n)


def _whole_or_loose(lost: BoolArray, used: BoolArray, counts: NDArray[np.int64]) -> BoolArray:
    """Drop first what only one set of lines sees; where nothing is left of that, drop all of it."""
    single = lost & (counts.min(axis=0) == 0)
    return single if single.any() else lost & used


def _variance(
    total: FloatArray, coupling: FloatArray, inverse: FloatArray, q: FloatArray
) -> FloatArray:
    """Diagonal of P (D^-1 + W S^-1 W') P' for unit noise, P without the null space."""
    own = 1.0 / total
    inner = q.T @ (own[:, np.newaxis] * q)
    direct = own - 2.0 * own * (q**2).sum(axis=1) + np.einsum("ij,jk,ik->i", q, inner, q)
    rest = coupling - q @ (q.T @ coupling)
    total_variance = direct + np.einsum("ij,jk,ik->i", rest, inverse, rest, optimize=True)
    return np.asarray(np.maximum(total_variance, 0.0), dtype=np.float64)


def _line_basis(line: NDArray[np.intp], along: FloatArray, n: int, slopes: str) -> FloatArray:
    offsets = np.zeros((line.size, n))
    offsets[np.arange(line.size), line] = 1.0
    if slopes == "none":
        return offsets
    if slopes == "common":
        return np.hstack([offsets, along[:, np.newaxis]])
    return np.hstack([offsets, offsets * along[:, np.newaxis]])


def _unit(positions: FloatArray) -> FloatArray:
    middle = 0.5 * (positions[0] + positions[-1])
    scaled: FloatArray = (positions - middle) / max(positions[-1] - middle, 1e-300)
    return scaled


def _noise(solved: _Joined, u_reading: float | None) -> tuple[Quantity, float]:
    text = "standard deviation of one reading"
    if solved.dof > 0:
        s = math.sqrt(solved.squares / solved.dof)
        u = s / math.sqrt(2.0 * solved.dof)
        return Quantity(s, "m", f"{text}, from the crossings", u=u, symbol="s"), s
    if u_reading is None:
        return Quantity(math.nan, "m", f"{text}; not known", symbol="s"), math.nan
    return Quantity(u_reading, "m", f"{text}, as stated", symbol="s"), u_reading


def _sets(
    x_lines: Surface | ArrayLike, y_lines: Surface | ArrayLike, dx: float | None, dy: float | None
) -> tuple[list[FloatArray], FloatArray, FloatArray, tuple[Step, ...]]:
    origin = (0.0, 0.0)
    history: tuple[Step, ...] = ()
    arrays = []
    surfaces = [s for s in (x_lines, y_lines) if isinstance(s, Surface)]
    if len(surfaces) == 1 or (surfaces and (dx is not None or dy is not None)):
        raise DataError("give both sets of lines as surfaces without dx and dy, or both as arrays")
    if surfaces:
        first, second = surfaces
        if (first.dx, first.dy, first.origin) != (second.dx, second.dy, second.origin):
            raise DataError("the two sets of lines lie on different grids; resample one of them")
        dx, dy, origin = first.dx, first.dy, first.origin
        history = (*first.history, *second.history)
    for item, axis in ((x_lines, "x"), (y_lines, "y")):
        numbers = item.z if isinstance(item, Surface) else real_numbers(item, f"{axis}_lines")
        values = np.array(numbers, dtype=np.float64)
        values = values[np.newaxis] if values.ndim == 2 else values
        if values.ndim != 3 or min(values.shape[1:]) < 2 or np.isinf(values).any():
            raise DataError(
                f"{axis}_lines must have the shape (n_y, n_x) or (repeats, n_y, n_x), at least "
                f"2 x 2 and finite or NaN; got {values.shape}"
            )
        arrays.append(values)
    if arrays[0].shape[1:] != arrays[1].shape[1:]:
        raise DataError(
            f"x_lines and y_lines must lie on one grid, got {arrays[0].shape[1:]} and "
            f"{arrays[1].shape[1:]}; write NaN where a line was not run"
        )
    step_x, step_y = plane_steps(dx, dy)
    n_y, n_x = arrays[0].shape[1:]
    x = np.asarray(origin[0] + step_x * np.arange(n_x), dtype=np.float64)
    y = np.asarray(origin[1] + step_y * np.arange(n_y), dtype=np.float64)
    return arrays, x, y, history
