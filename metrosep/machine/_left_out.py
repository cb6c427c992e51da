"""Private: the curve that a calibration leaves out, and what it adds to u.

Beyond the orders that were fitted each motion g may go on: its further orders are random, their variance
falls with the order n as ``lambda n^-2s`` (s = 0 has no shape, 1 is a curve with jumps, 2 one with corners).
How large it is (lambda), s, and the drift beside it are not known: all are taken by their restricted
likelihood. With b the coefficients and D what a curve shifts
them by (``b = b0 - D g``), the mean square of what the fit misses is that of ``(-D g, g)``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.machine._bases import Basis, further_orders
from metrosep.machine._drift_noise import Fit, inverse_times
from metrosep.machine._reading_problem import Problem, System, axis_of_term, places_of
from metrosep.machine.instruments import Instrument

_DRIFTS = [(a, tau) for a in (0.5, 2.0, 8.0) for tau in (3.0, 20.0, 150.0, 1000.0)]
_FALLS = (0, 1, 2)
_LEVELS = np.geomspace(0.1, 1e6, 15)
"""Of lambda, where 1 is a variance that the readings show as large as their noise."""
_COLUMNS = 300
"""Further orders of all terms together, at most: the cost rises with their square."""
_SHOWN = 1e-4
"""Share of all further orders that must show beside the coefficients, else nothing is known of them."""
_NONE = 0.2
"""How likely it is before that no curve is left out: machines end at no order."""
_LEAST_WEIGHT = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Shapes with the orders that were not fitted, and the mean square of what the fit misses."""

    bases: Mapping[str, Basis]
    at: Mapping[str, NDArray[np.intp]]
    """By term its coefficients, then its further ones, in `moment`."""
    moment: FloatArray
    """Over all coefficients and unknowns of the problem (unscaled), then the further orders."""


def left_out(
    problem: Problem,
    current: Sequence[Instrument],
    good: Sequence[NDArray[np.bool_]],
    system: System,
    fit: Fit,
) -> LeftOut:
    """Return what the orders that were not fitted add to u."""
    further = _further(problem)
    P, at, bases, begin = len(problem.names), {}, dict(problem.bases), 0
    for name, basis in problem.bases.items():
        at[name] = np.arange(begin, begin + len(basis.labels))
        begin += at[name].size
    used = problem.assembled(list(current), _with_refused_places(problem, good))
    H = np.zeros((used.y.size, 0))
    if further:
        wider = Problem(problem.chain, further, problem.sets)
        n = wider.n_terms
        H = np.concatenate(
            [
                wider.block(k, instrument)[0][..., :n].reshape(-1, n)[rows]
                for k, (instrument, rows) in enumerate(zip(current, used.rows, strict=True))
            ]
        )
    to_all = system.V / system.sizes[:, None]
    cases = _cases(problem, used, used.X @ to_all, fit, H)
    moment = np.zeros((P + H.shape[1],) * 2)
    moment[:P, :P] = to_all @ fit.cov @ to_all.T
    begin = 0
    for name, basis in further.items():
        mine = np.arange(begin, begin + len(basis.labels))
        begin += mine.size
        whole, part = np.append(np.arange(P), P + mine), _moment_of(cases, mine, basis)
        T = np.zeros((whole.size, part.shape[0]))
        T[:P, : -mine.size], T[P:, -mine.size :] = to_all, np.eye(mine.size)
        moment[np.ix_(whole, whole)] += T @ part @ T.T
        bases[name] = _joined(bases[name], basis)
        at[name] = np.append(at[name], P + mine)
    return LeftOut(bases, at, moment)


def _with_refused_places(
    problem: Problem, good: Sequence[NDArray[np.bool_]]
) -> list[NDArray[np.bool_]]:
    """Return the readings that are used, and those of places where all of two or more were refused."""
    found = []
    for reading, mine in zip(problem.sets, good, strict=True):
        values = np.asarray(reading.values)
        n = values.shape[0]
        moved = [np.broadcast_to(np.ravel(v), (n,)) for v in reading.q.values()]
        rows = np.round(np.column_stack(moved or [np.zeros(n)]), 9)
        which = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
        finite = np.isfinite(values)
        count = np.stack([np.bincount(which, weights=c) for c in finite.T], axis=1)
        stands = np.stack([np.bincount(which, weights=c) for c in mine.T], axis=1)
        found.append(mine | (finite & ((count > 1) & (stands == 0))[which]))
    return found


def _joined(first: Basis, more: Basis) -> Basis:
    off = None if first.off is None or more.off is None else np.vstack([first.off, more.off])
    return replace(first, orders=(*first.orders, *more.orders), off=off)


def _further(problem: Problem) -> dict[str, Basis]:
    """Return by term the orders beyond those fitted: enough to follow a jump between two of its places."""
    wanted = {}
    for name, basis in problem.bases.items():
        if basis.kind == "constant":
            continue
        axis = axis_of_term(problem.chain, name)
        element = next(e for e in problem.chain.elements if e.name == axis)
        places = places_of(element, problem.sets)
        if places is None:
            continue
        # Legendre polynomials are coarser in the middle by pi/2; harmonics come in pairs
        n = 1.6 * np.unique(np.round(places, 9)).size
        wanted[name] = n / 2.0 if basis.kind == "fourier" else n
    total = sum(2.0 * n if problem.bases[t].kind == "fourier" else n for t, n in wanted.items())
    share = min(1.0, _COLUMNS / total) if total else 1.0
    found = {}
    for name, n in wanted.items():
        basis = problem.bases[name]
        top = max(math.ceil(share * n), max(basis.orders) + 1)
        more = further_orders(basis, top)
        if more is not None:
            found[name] = more
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """The readings under one drift, with the coefficients eliminated."""

    base: float  # -2 log restricted likelihood without a curve, but for that of the scale
    square: float  # of what is left
    free: int
    S: FloatArray
    s: FloatArray
    plain: FloatArray  # diagonal of S before they are
    D: FloatArray  # by what a curve shifts the coefficients
    shift: FloatArray  # of the coefficients against the fit
    least: float
    stated: bool  # whether the noise of a set is stated

    def at(self, square: float) -> tuple[float, float]:
        """Return the scale of the noise squared, and its part of -2 log likelihood."""
        if self.stated:
            return 1.0, square
        return square / self.free, self.free * math.log(square)


def _cases(
    problem: Problem, system: System, Z: FloatArray, fit: Fit, H: FloatArray
) -> list[_Case]:
    from scipy.linalg import cho_factor, cho_solve

    y = system.y
    data = np.column_stack([Z, H, y])
    r = Z.shape[1]
    scales, least = [], 0.0
    for stream, group in zip(system.streams, problem.alike(system), strict=True):
        # digits of a display that are alike are one error
        digit = float(problem.steps[stream.which]) ** 2 / 12.0
        digit *= stream.rows.size / max(np.unique(group).size, 1)
        variance = max(float(fit.scales[stream.which]) ** 2, digit)
        scales.append(variance)
        least += stream.rows.size * digit / variance
    stated = any(s.u is not None for s in problem.sets)
    drifts = [(0.0, 10.0), *(_DRIFTS if fit.judged else [])]
    if not fit.white:
        drifts.append((fit.a, fit.tau))
    found = []
    for a, tau in drifts:
        N, logdet = np.zeros((data.shape[1],) * 2), 0.0
        for stream, variance in zip(system.streams, scales, strict=True):
            part = data[stream.rows]
            solved, one = inverse_times(part, stream.index, a, tau)
            N += part.T @ (solved / variance)
            logdet += one
        factor = cho_factor(N[:r, :r])
        solved = cho_solve(factor, N[:r, r:])
        left = N[r:, r:] - N[r:, :r] @ solved
        logdet += 2.0 * float(np.log(np.diag(factor[0])).sum())
        prior = 0.5 if a == 0.0 else 0.5 / (len(drifts) - 1)
        free = y.size - r
        base = logdet - 2.0 * math.log(prior)
        square = max(float(left[-1, -1]), least, 1e-14 * float(N[-1, -1]), 1e-300)
        found.append(
            _Case(
                base,
                square,
                free,
                left[:-1, :-1],
                left[:-1, -1],
                np.diag(N)[r:-1],
                solved[:, :-1],
                solved[:, -1] - fit.beta,
                least,
                stated,
            )
        )
    return found


def _moment_of(cases: Sequence[_Case], mine: NDArray[np.intp], basis: Basis) -> FloatArray:
    """Return the mean square of coefficients (reduced) and further orders of one term."""
    per = 2 if basis.kind == "fourier" else 1
    n = np.repeat(np.array(basis.orders, dtype=np.float64), per)
    size = 1.0 if per == 2 else np.sqrt(2.0 * n + 1.0)
    logs, parts = [], []
    none = [c.base + c.at(c.square)[1] - 2.0 * math.log(_NONE) for c in cases]
    for case in cases:
        S, s = case.S[np.ix_(mine, mine)], case.s[mine]
        for fall in _FALLS:
            R = size * (n / n[0]) ** -fall
            e, U = np.linalg.eigh(S * np.outer(R, R))
            e = np.maximum(e, 0.0)
            if e[-1] <= _SHOWN * float(case.plain[mine] @ R**2):
                continue
            p = U.T @ (R * s)
            for level in _LEVELS / e[-1]:
                gain = level / (1.0 + level * e)
                square = max(case.square - float(gain @ p**2), case.least, 1e-9 * case.square)
                value = case.base + float(np.log1p(level * e).sum())
                variance, part = case.at(square)
                value += part
                logs.append(value - 2.0 * math.log((1.0 - _NONE) / (_LEVELS.size * len(_FALLS))))
                parts.append((case, R, U, gain, p, variance))
    best = min(*none, *logs) if logs else 0.0
    weight = np.exp(-0.5 * (np.array(logs) - best))
    total = float(weight.sum()) + float(np.exp(-0.5 * (np.array(none) - best)).sum())
    weight /= total
    r = cases[0].D.shape[0]
    found = np.zeros((r + mine.size,) * 2)
    for w, (case, R, U, gain, p, variance) in zip(weight, parts, strict=True):
        if w < _LEAST_WEIGHT:
            continue
        T = np.vstack([-case.D[:, mine], np.eye(mine.size)])
        mean = T @ (R * (U @ (gain * p)))
        mean[:r] += case.shift
        B = T @ (R[:, None] * U * np.sqrt(gain * variance))
        found += w * (np.outer(mean, mean) + B @ B.T)
    return found
