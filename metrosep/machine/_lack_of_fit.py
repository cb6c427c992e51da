"""Private: what no curve of a calibration follows, by the scatter of readings that were taken twice.

Classical lack of fit: readings of one place differ by noise and drift alone (pure error), so what the
means of the places miss beyond it is a shape of the machine. White noise and drift are learnt from the
repeats only, by restricted likelihood with a free mean at each place; a fit alone cannot tell a shape
from drift. Over all drifts by their likelihood (as `Gls.spread`), the whole and the best jump, corner, bump
and wave are F-tested, a fifth of the chance each, with the number of independent shapes of a family after
Li and Ji, Heredity 95 (2005) 221. A set that passes its places once is judged under the noise of the fit.

Second, the curve beyond the orders that a calibration fits, and its part of u.

Beyond the orders that were fitted each motion g may go on: its further orders are random, their variance
falls with the order n as ``lambda n^-2s`` (s = 0 has no shape, 1 is a curve with jumps, 2 one with corners).
How large it is (lambda), s, and the drift beside it are not known: all are taken by their restricted
likelihood. With b the coefficients and D what a curve shifts them by (``b = b0 - D g``), the estimate is the
mean of ``(b0 - D g, g)`` over all of them, and u^2 their variance about it. Motions of several sizes may each
explain the same residual: their sizes are drawn together (Gibbs sampling), with g eliminated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.units import format_engineering
from metrosep.machine._bases import Basis, first_harmonic, further_orders
from metrosep.machine._drift_noise import Fit, Gls, inverse_times
from metrosep.machine._reading_problem import Problem, System, axis_of_term, places_of
from metrosep.machine.instruments import Instrument

_CHANCE = 0.02
"""Of a message without a shape, over all sets, and over all parts."""
_FREE, _FEWEST, _MOST = 10, 12, 300
"""Repeats, and places, below which nothing is judged; places that are looked at, at most."""
_DRIFTS = [
    (a, t) for a in (0.3, 1.0, 3.0, 10.0, 30.0) for t in (2.0, 8.0, 30.0, 120.0, 500.0, 2000.0)
]
_WIDTHS, _WINDOWS = (1, 2, 4, 8), 6
"""Places that a bump takes, and how many times as many its way must hold."""
_NOTHING = 1e-12  # m or rad: what is less is rounding and second order
_LEFT = 1e-8
"""Share of the square of a shape below which the curves follow it."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Columns of a family over the places; of a wave two that belong together."""

    kind: str
    columns: FloatArray  # (places, shapes, 1 or 2)
    at: list[tuple[float, float]]  # where each begins and ends, or its length


def families(x: FloatArray, is_turn: bool) -> list[Shapes]:
    """Return jumps, corners, bumps and waves over sorted places."""
    n, span = x.size, float(np.ptp(x))
    edges = range(1, n - 2)
    found = [
        Shapes(
            "jumps",
            np.stack([x > x[k] for k in edges], axis=1)[..., None].astype(np.float64),
            [(float(x[k]), float(x[k + 1])) for k in edges],
        ),
        Shapes(
            "corner",
            np.maximum(x[:, None] - x[2:-2], 0.0)[..., None],
            [(float(v), float(v)) for v in x[2:-2]],
        ),
    ]
    bumps, at = [], []
    for width in _WIDTHS:
        if n >= _WINDOWS * width:
            for k in range(n - width + 1):
                bumps.append((np.arange(n) >= k) & (np.arange(n) < k + width))
                at.append((float(x[k]), float(x[k + width - 1])))
    found.append(Shapes("bump", np.stack(bumps, axis=1)[..., None].astype(np.float64), at))
    if is_turn:
        twice, span = 2 * np.arange(3, n // 2 + 1), 2.0 * math.pi
    else:
        twice = np.arange(6, n)
    turns = math.pi * twice / span * (x[:, None] - (0.0 if is_turn else x[0]))
    waves = np.stack([np.cos(turns), np.sin(turns)], axis=2)
    found.append(Shapes("waves", waves, [(2.0 * span / m,) * 2 for m in twice.tolist()]))
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The means of readings at their places, under each drift that repeats allow, the likeliest first."""

    cases: list[tuple[float, FloatArray, FloatArray, FloatArray]]
    """Weight, whitening of the places, whitened columns of the model (orthonormal), what these leave."""
    free: int  # repeats
    degrees: int = 0

    @classmethod
    def of(
        cls,
        y: FloatArray,
        index: FloatArray,
        which: NDArray[np.intp],
        model: FloatArray,
        step: float,
    ) -> Places:
        """Return the places of one series of readings."""
        count = int(which.max()) + 1
        S = (which[:, None] == np.arange(count)).astype(np.float64)
        free = y.size - count
        floor = free * max(step**2 / 12.0, _NOTHING**2)
        first = np.unique(which, return_index=True)[1]
        U, singular, _ = np.linalg.svd(model[first], full_matrices=False)
        known = U[:, singular > 1e-9 * singular.max(initial=0.0)]
        degrees = count - known.shape[1]
        cases, value, prior = [], [], []
        for a, tau in [(0.0, 10.0), *_DRIFTS]:
            solved, logdet = inverse_times(np.column_stack([S, y]), index, a, tau)
            M = S.T @ solved[:, :-1]
            L = np.linalg.cholesky(0.5 * (M + M.T))
            b = S.T @ solved[:, -1]
            mean = np.linalg.solve(M, b)
            square = max(float(y @ solved[:, -1]) - float(b @ mean), floor)
            cases.append((L, mean, square / free))
            logs = logdet + 2.0 * float(np.log(np.diag(L)).sum())
            value.append(logs + free * math.log(square))
            prior.append(0.5 if a == 0.0 else 0.5 / len(_DRIFTS))
        weights = np.array(prior) * np.exp(-0.5 * (np.array(value) - min(value)))
        weights /= weights.sum()
        found = []
        for w, (L, mean, s2) in zip(weights, cases, strict=True):
            if w < 1e-3:
                continue
            # of the covariance of the means s2 / M + step^2/12 (one digit is one error at a place)
            inverse = np.linalg.inv(L)
            C = s2 * inverse.T @ inverse + np.eye(count) * step**2 / 12.0
            W = np.linalg.inv(np.linalg.cholesky(C))
            Q = np.linalg.qr(W @ known)[0]
            r = W @ mean
            found.append((float(w), W, Q, r - Q @ (Q.T @ r)))
        found.sort(key=lambda case: -case[0])
        total = sum(case[0] for case in found)
        return cls([(w / total, *rest) for w, *rest in found], free, degrees)

    def whole(self) -> tuple[float, float]:
        """Return chance and F of the lack of fit."""
        from scipy.stats import f

        values = [float(r @ r) / self.degrees for _, _, _, r in self.cases]
        chance = sum(
            case[0] * float(f.sf(v, self.degrees, self.free))
            for case, v in zip(self.cases, values, strict=True)
        )
        return chance, values[0]

    def best(self, shapes: Shapes, least: float) -> tuple[float, int, float]:
        """Return chance, number and size of the best of a family; its size is above the least."""
        from scipy.stats import f

        chance, chosen, size, trials = 0.0, 0, 0.0, 1.0
        n, m, d = shapes.columns.shape
        for k, (w, W, Q, r) in enumerate(self.cases):
            C = (W @ shapes.columns.reshape(n, -1)).reshape(W.shape[0], m, d)
            raw = np.sum(C**2, axis=0)
            C = C - np.tensordot(Q, np.tensordot(Q, C, (0, 0)), (1, 0))
            good = np.all(np.sum(C**2, axis=0) > _LEFT * raw, axis=1)
            N = np.einsum("nma,nmb->mab", C, C)
            if d == 2:
                good &= np.linalg.det(N) > 1e-3 * N[:, 0, 0] * N[:, 1, 1]
            N[~good] = np.eye(d)
            b = np.einsum("nma,n->ma", C, r)
            found = np.linalg.solve(N, b[..., None])[..., 0]
            height = np.linalg.norm(found, axis=1) * np.max(np.abs(shapes.columns), axis=(0, 2))
            stat = np.where(good & (height > least), np.sum(found * b, axis=1), 0.0)
            i = int(np.argmax(stat))
            if k == 0:
                chosen, size = i, float(found[i, 0] if d == 1 else np.linalg.norm(found[i]))
                trials = _independent(C[:, good].reshape(W.shape[0], -1)) / d
            chance += w * float(f.sf(stat[i] / d, d, self.free))
        return min(chance * trials, 1.0), chosen, size


def _independent(columns: FloatArray) -> float:
    """Return how many independent shapes columns are (Li and Ji)."""
    if not columns.size:
        return 1.0
    values = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False) ** 2
    return float(np.sum((values >= 1.0) + values - np.floor(values)))


def sentence(
    label: str,
    kind: str,
    axis: str,
    unit: str,
    read: str,
    at: tuple[float, float],
    size: float,
    or_term: str = "",
    u: str = "u of the curves contains it",
    follow: str = "",
) -> str:
    """Return what the curves of a set leave, where, of which size, and what to do."""
    places = " to ".join(dict.fromkeys(format_engineering(v, unit) for v in at))
    height = format_engineering(size, read)
    follow = follow or f"give a degree of {axis} that follows it"
    each = f"calibrate the travel on each side by itself, or {follow}"
    if kind == "waves":
        length = (
            f"{math.degrees(at[0]):.3g} deg" if unit == "rad" else format_engineering(at[0], unit)
        )
        what = f"repeats every {length} of {axis}, amplitude {height}"
        why, remedy = "no order that was fitted follows it", follow
        remedy += or_term
    elif kind == "jumps":
        what = f"jumps by {height} between {axis} = {places.replace(' to ', ' and ')}"
        why = "no order follows a jump"
        remedy = (
            "look for a joint, a grid error of the scale or a loose guide there, and calibrate the travel on "
            "each side by itself"
        )
    elif kind == "corner":
        what = f"bends near {axis} = {places}, by {height} at the end of its way"
        why, remedy = (
            "no order follows a corner",
            f"look for a joint or a bend of the guide there; {each}",
        )
    else:
        what = f"has a bump of {height} at {axis} = {places}"
        why, remedy = (
            "no order follows it",
            f"look for dirt or damage of the guide or the scale there; {each}",
        )
    return f"{label}: what the curves leave {what}; {why}, {u}: {remedy}"


def rings_left(
    label: str, x: FloatArray, white: FloatArray, model: FloatArray, rest: FloatArray, parts: int
) -> list[str]:
    """Return a sentence where what is left of a map has a step or a ridge round its axis.

    x are the radii of its rings, `white` their whitened columns, `model` the orthonormal ones, `rest` what
    these leave: whitened by the noise that was found, so of variance 1.
    """
    found = Places([(1.0, white, model, rest)], rest.size - model.shape[1])
    best: tuple[float, str, tuple[float, float], float] = (
        _CHANCE / 2.0 / parts,
        "",
        (0.0, 0.0),
        0.0,
    )
    for shapes in families(x, False):
        if shapes.kind in ("jumps", "bump"):
            one, i, size = found.best(shapes, _NOTHING)
            if one < best[0]:
                best = (one, shapes.kind, shapes.at[i], size)
    if not best[1]:
        return []
    return [
        sentence(
            label,
            best[1],
            "rho",
            "m",
            "m",
            best[2],
            best[3],
            u="and u does not contain it",
            follow="give the curves more orders",
        )  # rho: a radius in a message is a key of the command
    ]


def lack_of_fit(
    problem: Problem, current: Sequence[Instrument], good: Sequence[NDArray[np.bool_]]
) -> tuple[list[str], set[int]]:
    """Return sentences, and the sets that were judged by their repeats."""
    tests = []
    for k, reading in enumerate(problem.sets):
        block, left = problem.block(k, current[k])
        n = left.shape[0]
        q = {a: np.broadcast_to(np.ravel(np.asarray(v)), (n,)) for a, v in reading.q.items()}
        moved = [a for a, v in q.items() if float(np.ptp(v)) > 1e-9]
        if not moved:
            continue
        places = np.unique(
            np.round(np.stack([q[a] for a in moved], axis=1), 9), axis=0, return_inverse=True
        )[1].ravel()
        # a reading that was refused counts where no other of its place stands against it
        for c in range(left.shape[1]):
            stands = np.bincount(places[good[k][:, c]], minlength=int(places.max()) + 1)
            use = np.isfinite(left[:, c]) & (good[k][:, c] | (stands[places] == 0))
            rows = np.flatnonzero(use)
            kept, which = np.unique(places[rows], return_inverse=True)
            if kept.size > _MOST:  # every so many of them
                every = -(-kept.size // _MOST)
                rows = rows[which % every == 0]
                kept, which = np.unique(places[rows], return_inverse=True)
            design = block[rows, c]
            design = design[:, np.any(design != 0.0, axis=0)]
            design = design / np.linalg.norm(design, axis=0)
            if rows.size - kept.size < _FREE or kept.size < max(_FEWEST, design.shape[1] + 2):
                continue
            found = Places.of(
                left[rows, c], rows.astype(np.float64), which, design, problem.steps[k]
            )
            if found.degrees > 1:
                x = q[moved[0]][rows][np.unique(which, return_index=True)[1]]
                tests.append((k, moved, x, found))
    said: list[str] = []
    chance = _CHANCE / 5.0 / max(len(tests), 1)
    for k, moved, x, found in tests:
        reading, least = problem.sets[k], max(float(problem.steps[k]), _NOTHING)
        read = "rad" if reading.instrument.is_angle else "m"
        p, F = found.whole()
        best: tuple[float, str, tuple[float, float], float] = (p, "", (0.0, 0.0), 0.0)
        unit = "rad" if problem.chain.dimensions.get(moved[0]) == "angle" else "m"
        if len(moved) == 1:
            is_turn = unit == "rad" and float(np.ptp(x)) > 1.9 * math.pi
            for shapes in families(x, is_turn):
                one, i, size = found.best(shapes, least)
                if shapes.kind == "corner":
                    size *= float(x[-1]) - shapes.at[i][0]
                if one < chance and (one < best[0] or not best[1]):
                    best = (one, shapes.kind, shapes.at[i], size)
        if best[0] >= chance:
            continue
        if best[1]:
            said.append(
                sentence(problem.labels[k], best[1], moved[0], unit, read, best[2], best[3])
            )
        else:
            said.append(
                f"{problem.labels[k]}: its places differ from the curves by more than repeats of a place "
                f"differ (F = {F:.3g}); u of the curves contains it: give a higher degree of "
                f"{' or '.join(moved)}, ask for more terms, or check its tool point"
            )
    return said, {k for k, *_ in tests}


# ---- the curve beyond the orders ----------------------------------------------------------------

_BESIDE = [(a, tau) for a in (0.5, 2.0, 8.0, 32.0) for tau in (3.0, 20.0, 150.0, 1000.0)]
_FALLS = (0, 1, 2)
_LEVELS = np.geomspace(0.1, 1e6, 15)
"""Of lambda, where 1 is a variance that the readings show as large as their noise."""
_EDGES = np.append(_LEVELS / math.sqrt(_LEVELS[1] / _LEVELS[0]), math.inf)
_CHOICES = 1 + len(_FALLS) * _LEVELS.size  # none, or a fall and a level
_SMALLER = 1.0 / np.sqrt(1.0 + 1.0 / _EDGES)
"""How likely a curve is smaller than that before: root of level / (1 + level), the share that it has in the root
mean square, may be anything from 0 to 1 alike. A machine ends at no order, so it has no point of its own.
Of the mean square alike, small curves are too rare before and u too large (Gelman, Bayesian Analysis 1 (2006) 515)."""
_ALIKE, _SCORES = (np.arange(5) + 0.5) / 5.0, np.linspace(-4.0, 4.0, 33)
"""Correlation of the normal scores of the shares of two motions, anything from 0 to 1 alike before: how far one
goes on says of the others what all of them together say. And the nodes of the score that all have in common."""
_FARTHEST = 4
"""Times the first further harmonic, at least: few places of a turn fold what is beyond onto what was fitted. Of the
square of a curve with corners (s = 2) 1 / 4^3 is left out then, at the 7 harmonics of 8 places it was a fifth."""
_COLUMNS = 300
"""Further orders of all terms together, at most: the cost rises with their square."""
_SHOWN = 1e-4
"""Share of all further orders that must show beside the coefficients, else nothing is known of them."""
_LEAST_WEIGHT = 1e-4
_NEVER, _RARE, _STANDS = 1e-6, 1e-3, 0.05
"""Chance of a drift, in the mean of a quarter and of all draws that settle, below which it is not looked at any
more; and in one draw, below which it is taken so often as to stand for this chance: its mean stays what it is."""
_EXCHANGED, _TOGETHER = 4, 3
"""Motions among which two are exchanged: of more the decomposition costs more than it is worth; and sweeps of
which one draws the drift and the size of a motion together: it costs half as much as the rest of the sweep."""
_SEED, _SETTLING, _DRAWS = 27, 20, 100
"""Of the draws of all sizes together: u of independent draws is known to 7 %."""


@dataclass(frozen=True, slots=True, eq=False)
class Beyond:
    """Shapes with the orders that were not fitted, what the readings say of them, and how well."""

    bases: Mapping[str, Basis]
    at: Mapping[str, NDArray[np.intp]]
    """By term its coefficients, then its further ones, in `mean` and `cov`."""
    mean: FloatArray
    """By what the fit is off, over all coefficients and unknowns of the problem (unscaled), and the further orders."""
    cov: FloatArray
    columns: FloatArray
    """Of the further orders, (n, k) over the readings of the fit."""


def beyond_orders(
    problem: Problem,
    current: Sequence[Instrument],
    good: Sequence[NDArray[np.bool_]],
    system: System,
    fit: Fit,
) -> Beyond:
    """Return what the orders that were not fitted add to the fit and to u."""
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
    begin, places = 0, {}
    for name, basis in further.items():
        places[name] = np.arange(begin, begin + len(basis.labels))
        begin += places[name].size
        bases[name] = _joined(bases[name], basis)
        at[name] = np.append(at[name], P + places[name])
    alike = _alike(problem, further)
    sizes = [_sizes([further[n] for n in names]) for names in alike]
    groups = [np.concatenate([places[n] for n in names]) for names in alike]
    T = np.zeros((P + H.shape[1], to_all.shape[1] + H.shape[1]))
    T[:P, : to_all.shape[1]], T[P:, to_all.shape[1] :] = to_all, np.eye(H.shape[1])
    one, part = _Curves(cases, sizes, groups).moments()
    mean, cov = T @ one, T @ part @ T.T
    pairs = zip(used.rows, system.rows, strict=True)
    return Beyond(bases, at, mean, cov, H[np.concatenate([np.isin(a, b) for a, b in pairs])])


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


def _alike(problem: Problem, further: Mapping[str, Basis]) -> list[list[str]]:
    """Return the terms whose further orders have one size: radial motion in two directions, and tilt about two."""
    found: dict[tuple[str, str], list[str]] = {}
    for name in further:
        element = next(
            e for e in problem.chain.elements if e.name == axis_of_term(problem.chain, name)
        )
        is_radial = element.kind == "rotary" and first_harmonic(element, name) == 2
        kind = ("shift" if name[1] in "XYZ" else "tilt") if is_radial else name
        found.setdefault((element.name, kind), []).append(name)
    return [*found.values()]


def _joined(first: Basis, more: Basis) -> Basis:
    off = None if first.off is None or more.off is None else np.vstack([first.off, more.off])
    orders = (*first.orders, *more.orders)
    return replace(first, orders=orders, off=off, fitted=len(first.labels))


def _further(problem: Problem) -> dict[str, Basis]:
    """Return by term the orders beyond those fitted: enough to follow a jump between two places, and as many as matter."""
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
        if basis.kind == "fourier":
            n = max(n / 2.0, _FARTHEST * (max(basis.orders) + 1))
        wanted[name] = n
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
    shown: bool  # whether a series is long enough to tell its drift from a constant
    cov: FloatArray  # of the coefficients, over the scale squared

    def left(self, taken: FloatArray) -> FloatArray:
        """Return the square that is left when a curve takes a part of it."""
        return np.maximum(self.square - taken, max(self.least, 1e-9 * self.square))

    def at(self, square: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the scale of the noise squared, and its part of -2 log likelihood."""
        if self.stated:
            return np.ones_like(square), square
        return square / self.free, self.free * np.log(square)


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
        variance = max(float(fit.scales[stream.group]) ** 2, digit)
        scales.append(variance)
        least += stream.rows.size * digit / variance
    stated = any(s.u is not None for s in problem.sets)
    drifts = [(0.0, 10.0, 1.0)]
    longest = max(stream.rows.size for stream in system.streams)
    if not fit.white:
        gls = Gls(Z, y, system.streams, problem.stated)
        drifts += gls.likely(fit.a, fit.tau, _BESIDE)
    elif fit.judged:
        drifts += [(*d, 1.0 / len(_BESIDE)) for d in _BESIDE]
    found = []
    for a, tau, share in drifts:
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
        free = y.size - r
        base = logdet - 2.0 * math.log(
            0.5 * share
        )  # white noise and drift are alike likely before
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
                (a, tau) not in _BESIDE or tau <= longest,
                cho_solve(factor, np.eye(r)),
            )
        )
    return found


def _sizes(bases: Sequence[Basis]) -> FloatArray:
    """Return the standard deviations of further orders of one size, a row for each fall."""
    per = 2 if bases[0].kind == "fourier" else 1
    n = np.concatenate([np.repeat(np.array(b.orders, dtype=np.float64), per) for b in bases])
    size = 1.0 if per == 2 else np.sqrt(2.0 * n + 1.0)
    return np.stack([size * (n / n.min()) ** -fall for fall in _FALLS])


_Chosen = tuple[int, ...]
"""Of each group 0 where it is too small to matter, else which fall and which level it has."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """What the readings say of some further orders, where the others have their sizes and are eliminated."""

    case: _Case
    S: FloatArray
    s: FloatArray
    base: float  # -2 log likelihood that the others bring
    taken: float  # of the square, by the others

    def at(self, taken: FloatArray, logs: FloatArray) -> FloatArray:
        """Return -2 log likelihood where these take a part of the square, with their log determinant."""
        return self.base + logs + self.case.at(self.case.left(self.taken + taken))[1]

    def value(self, d: FloatArray) -> float:
        """Return -2 log likelihood at standard deviations of these; infinite where they are."""
        if not np.isfinite(d).all():
            return math.inf
        if not d.any():
            return float(self.at(np.zeros(()), np.zeros(())))
        z, logs, _ = _solved(self.S, d, self.s)
        return float(self.at(z @ z, logs))

    def without(self, d: FloatArray, out: slice, kept: slice) -> _Part:
        """Return the orders that are kept, those that are out eliminated at their standard deviations."""
        across = np.column_stack([self.S[out, kept], self.s[out]])
        Z, logs, _ = _solved(self.S[out, out], d, across)
        Z, z = Z[:, :-1], Z[:, -1]
        return _Part(
            self.case,
            self.S[kept, kept] - Z.T @ Z,
            self.s[kept] - Z.T @ z,
            float(self.base + logs),
            self.taken + float(z @ z),
        )


def _solved(
    S: FloatArray, d: FloatArray, right: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``L^-1 d right``, the log determinant of ``I + d S d = L L^T``, and L."""
    from scipy.linalg.lapack import dpotrf, dtrtrs

    A = S * np.outer(d, d)
    A.reshape(-1)[:: d.size + 1] += 1.0
    L = dpotrf(A.T, lower=1, clean=0, overwrite_a=1)[0]  # A.T lies in the memory as it is wanted
    logs = np.asarray(2.0 * np.log(np.diag(L)).sum())
    return dtrtrs(L, (d * right.T).T, lower=1)[0], logs, L


class _Curves:
    """Further orders in groups of one size, under every drift: how likely each choice of all sizes is."""

    def __init__(
        self,
        cases: Sequence[_Case],
        sizes: Sequence[FloatArray],
        groups: Sequence[NDArray[np.intp]],
    ) -> None:
        self.cases, self.sizes, self.groups = cases, sizes, groups
        self.shown = np.array([c.shown for c in cases])
        self.alike, self.common = _alike_sizes()
        self.tops = np.array(
            [[[self._top(case, own, R) for R in listed] for own, listed in zip(groups, sizes, strict=True)]
             for case in cases]
        ).reshape(len(cases), len(groups), len(_FALLS))  # fmt: skip
        self._scales = [
            [self._choices(*each) for each in zip(of, sizes, strict=True)] for of in self.tops
        ]
        # of others nothing shows any order
        self.seen = np.flatnonzero(self.tops.any(axis=(0, 2))).tolist()

    def _before(self, g: int, chosen: Sequence[int]) -> FloatArray:
        """Return -2 log of the chance before of the choices of one group, given those of the others."""
        others = np.array([chosen[i] for i in self.seen if i != g], dtype=np.intp) - 1
        levels = np.where(others < 0, 0, others % _LEVELS.size + 1)
        falls = 1.0 + np.bincount(others[others >= 0] // _LEVELS.size, minlength=len(_FALLS))
        likely = self.common * np.prod(self.alike[:, levels], axis=1)
        size = likely @ self.alike / likely.sum()
        found = np.append(size[0], np.multiply.outer(falls / falls.sum(), size[1:]))
        return np.asarray(-2.0 * np.log(found))

    @staticmethod
    def _top(case: _Case, own: NDArray[np.intp], R: FloatArray) -> float:
        """Return how well readings show the shape that they show best; 0 where hardly any shows."""
        top = float(np.linalg.eigvalsh(case.S[np.ix_(own, own)] * np.outer(R, R))[-1])
        return top if top > _SHOWN * float(case.plain[own] @ R**2) else 0.0

    @staticmethod
    def _choices(tops: FloatArray, sizes: FloatArray) -> FloatArray:
        """Return the standard deviations over the noise for each choice; infinite where nothing shows the orders."""
        with np.errstate(divide="ignore"):
            found = np.sqrt(_LEVELS[:, None] / tops[:, None, None]) * sizes[:, None]
        return np.vstack([np.zeros(sizes.shape[1]), found.reshape(-1, sizes.shape[1])])

    def _scale(self, k: int, order: Sequence[int], chosen: Sequence[int]) -> FloatArray:
        """Return standard deviations over the noise of the orders of groups, one group after the other."""
        return np.concatenate([self._scales[k][g][chosen[g]] for g in order])

    def scale(self, k: int, chosen: _Chosen) -> FloatArray:
        """Return `_scale` of all groups, at their places."""
        found = np.empty(self.cases[k].s.size)
        for own, listed, choice in zip(self.groups, self._scales[k], chosen, strict=True):
            found[own] = listed[choice]
        return found

    def value(self, k: int, chosen: _Chosen) -> float:
        """Return -2 log of the likelihood."""
        case, d = self.cases[k], self.scale(k, chosen)
        return _Part(case, case.S, case.s, case.base, 0.0).value(d)

    def _whole(self, k: int, order: Sequence[int]) -> _Part:
        """Return all groups, one after the other, none eliminated."""
        case, own = self.cases[k], np.concatenate([self.groups[g] for g in order])
        return _Part(case, case.S[np.ix_(own, own)], case.s[own], case.base, 0.0)

    def _beside(self, k: int, order: Sequence[int], chosen: Sequence[int]) -> FloatArray:
        """Return `value` for all choices of the first group of an order, the others as they are chosen."""
        d, m = self._scale(k, order[1:], chosen), self.groups[order[0]].size
        if not np.isfinite(d).all():
            return np.full(_CHOICES, math.inf)
        part = self._whole(k, order).without(d, slice(m, None), slice(m))
        return self.of_group(k, order[0], part, self._before(order[0], chosen))

    def of_group(self, k: int, g: int, part: _Part, before: FloatArray) -> FloatArray:
        """Return `value` and -2 log of the chance before for all choices of a group, the others eliminated."""
        found = np.full(_CHOICES, math.inf)
        found[0] = part.at(np.zeros(()), np.zeros(()))
        shown = self.tops[k, g] > 0.0
        if shown.any():
            R = self.sizes[g][shown]
            e, U = np.linalg.eigh(part.S * R[:, :, None] * R[:, None])
            size = _LEVELS[:, None] / self.tops[k, g, shown][:, None, None]
            grown = 1.0 + size * np.maximum(e, 0.0)[:, None]
            p = ((R * part.s)[:, None] @ U)[:, 0, :, None]
            taken = ((size / grown) @ p**2)[..., 0]
            values = part.at(taken, np.log(grown).sum(axis=-1))
            found[1:].reshape(len(_FALLS), -1)[shown] = values
        return np.asarray(found + before)

    def all_choices(self) -> dict[tuple[int, _Chosen], float]:
        """Return how likely each choice is, of one group, or of none that shows."""
        found: dict[tuple[int, _Chosen], float] = {}
        for k in range(len(self.cases)):
            if len(self.groups) == 1:
                listed = self.of_group(k, 0, self._whole(k, [0]), self._before(0, (0,))).tolist()
                found |= {(k, (i,)): value for i, value in enumerate(listed)}
            else:
                none = (0,) * len(self.groups)
                found[k, none] = self.value(k, none)
        return dict(zip(found, _chances([*found.values()]).tolist(), strict=True))

    def drawn(self) -> dict[tuple[int, _Chosen], float]:
        """Return choices of several groups with their weights: Gibbs sampling, and two groups exchanged.

        Two groups that explain the same residual are seldom both large, so that one would hardly ever give
        way to the other without the exchange.
        """
        rng = np.random.default_rng(_SEED)
        n, k = len(self.groups), 0
        chosen = [0] * n
        drawn = self.seen if len(self.seen) > 1 else [*range(n)]
        likely, seen = np.arange(len(self.cases)), np.zeros(len(self.cases))
        found: dict[tuple[int, _Chosen], float] = {}
        for sweep in range(-_SETTLING, _DRAWS):
            order = rng.permutation(drawn).tolist()
            self._draw(k, order, self._whole(k, order), chosen, rng)
            if sweep % _TOGETHER:
                w = _chances([self.value(i, tuple(chosen)) for i in likely.tolist()])
                picked = [tuple(chosen)] * w.size
            else:  # a curve that is large where the noise is white may be small beside a drift
                listed = _chances(
                    np.stack([self._beside(i, order, chosen) for i in likely.tolist()])
                )
                w, g = listed.sum(axis=1), order[0]
                rows = listed / np.maximum(w, 1e-300)[:, None]
                picked = [(*chosen[:g], _picked(v, rng), *chosen[g + 1 :]) for v in rows]
            at = _picked(w, rng)
            k, chosen = int(likely[at]), list(picked[at])
            seen[likely] += w
            pairs = [*zip(likely.tolist(), picked, strict=True)]
            past = sweep + 1 + _SETTLING
            if least := {_SETTLING // 4: _NEVER, _SETTLING: _RARE}.get(past):
                keep = seen > least * past
                keep[[k, int(np.argmax(np.where(self.shown, seen, -1.0)))]] = True
                likely = np.flatnonzero(keep)
            if sweep >= 0:
                stands = np.maximum(w, _STANDS) * (w > _STANDS * rng.random(w.size))
                for key, share in zip(pairs, (stands / _DRAWS).tolist(), strict=True):
                    found[key] = found.get(key, 0.0) + share
        return found

    def _draw(
        self, k: int, order: list[int], part: _Part, chosen: list[int], rng: np.random.Generator
    ) -> None:
        """Draw the choices of groups whose orders are those of a part, each given all others.

        Either half is eliminated at its sizes before the other is drawn: all draws of a sweep together cost
        less than three decompositions of the whole.
        """
        if len(order) == 1:
            w = _chances(self.of_group(k, order[0], part, self._before(order[0], chosen)))
            chosen[order[0]] = _picked(w, rng)
            return
        half = len(order) // 2
        if len(order) <= _EXCHANGED:
            i, j = (o[int(rng.integers(len(o)))] for o in (order[:half], order[half:]))
            other = list(chosen)
            other[i], other[j] = chosen[j], chosen[i]
            pair = [part.value(self._scale(k, order, c)) for c in (chosen, other)]
            if rng.random() < _chances(pair)[1]:
                chosen[:] = other
        m = sum(self.groups[g].size for g in order[:half])
        first, second = (order[:half], slice(m)), (order[half:], slice(m, None))
        for (mine, kept), (rest, out) in ((first, second), (second, first)):
            d = self._scale(k, rest, chosen)
            self._draw(k, mine, part.without(d, out, kept), chosen, rng)

    def _given(self, k: int, chosen: _Chosen) -> tuple[float, FloatArray, FloatArray]:
        """Return the variance of the noise, mean and upper half of the covariance of all further orders."""
        from scipy.linalg.lapack import dpotri, dtrtrs

        case, d = self.cases[k], self.scale(k, chosen)
        if not d.any():
            return float(case.at(case.left(np.zeros(())))[0]), d, np.zeros((d.size,) * 2)
        z, _, L = _solved(case.S, d, case.s)
        variance = float(case.at(case.left(z @ z))[0])
        g = d * dtrtrs(L, z, lower=1, trans=1)[0]
        B = dpotri(L, lower=1, overwrite_c=1)[0].T
        B *= d
        B *= (variance * d)[:, None]
        return variance, g, B

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Return mean and covariance of what the coefficients (reduced) are off by, then of the further orders."""
        several = len(self.groups) > 1 and self.tops.any()
        weights = self.drawn() if several else self.all_choices()
        shown = self.shown
        best = max((c for c in weights if shown[c[0]]), key=lambda c: weights[c])
        weights = {c: max(w, 1e-300) for c, w in weights.items() if w > _LEAST_WEIGHT or c == best}
        total = sum(weights.values())
        r, n = self.cases[0].D.shape
        of_curves, square = np.zeros((len(self.cases), r + n)), np.zeros((r + n,) * 2)
        of_case, variances = np.zeros(len(self.cases)), np.zeros(len(self.cases))
        for k, case in enumerate(self.cases):
            means, two = [np.zeros((0, n))], np.zeros((n, n))
            mine = {chosen: w / total for (i, chosen), w in weights.items() if i == k}
            for chosen, w in mine.items():
                variance, g, B = self._given(k, chosen)
                of_case[k] += w
                variances[k] += w * variance
                means.append(g[None])
                B *= w
                two += B
            G, w_of = np.concatenate(means), np.array([*mine.values()])
            one = w_of @ G
            two = np.triu(two) + np.triu(two, 1).T + (w_of * G.T) @ G
            T = np.vstack([-case.D, np.eye(n)])
            of_curves[k] = T @ one
            square += T @ two @ T.T
        mean = of_curves.sum(axis=0)
        cov = square - np.outer(mean, mean)
        # what they are off by noise, over drifts that are no constant
        share = float(of_case[shown].sum())
        of_case, variances = of_case * shown / share, variances * shown / share
        shifts = np.stack([c.shift for c in self.cases])
        mean[:r] += of_case @ shifts
        off = shifts - of_case @ shifts
        cov[:r, :r] += (of_case[:, None] * off).T @ off
        across = (off * shown[:, None] / share).T @ of_curves
        cov[:r] += across
        cov[:, :r] += across.T
        for variance, case in zip(variances, self.cases, strict=True):
            cov[:r, :r] += variance * case.cov
        return mean, cov


def _alike_sizes() -> tuple[FloatArray, FloatArray]:
    """Return chances of no curve and each level, by correlation and common score of all motions; and of these."""
    from scipy.special import ndtr, ndtri

    rho, m = (v.ravel()[:, None] for v in np.meshgrid(_ALIKE, _SCORES))
    below = ndtr((ndtri(_SMALLER) - np.sqrt(rho) * m) / np.sqrt(1.0 - rho))
    w = np.exp(-0.5 * m[:, 0] ** 2)
    return np.diff(below, axis=1, prepend=0.0), w / w.sum()


def _picked(w: FloatArray, rng: np.random.Generator) -> int:
    """Return a choice by its chance."""
    return min(int(np.searchsorted(np.cumsum(w), rng.random())), w.size - 1)


def _chances(values: Sequence[float] | FloatArray) -> FloatArray:
    """Return how likely choices are by -2 log of their likelihood."""
    w = np.exp(-0.5 * (np.asarray(values) - np.min(values)))
    return np.asarray(w / w.sum())
