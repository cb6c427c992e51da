"""Error motions as curves from maps of turned parts: EZX over x, EZC over the spindle's turn.

A map is averaged over polar bins, and so are the columns of the model, so that nothing is lost by
the bins but noise. Each part has its own alignment and setting of the tool. The noise of a map is
white in its pixels and alike over a length; both are learnt from the residuals by restricted
likelihood (machines.md, eq. 17) and the estimate is that of generalised least squares.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.core.provenance import freeze_mapping
from metrosep.core.units import format_engineering, format_length
from metrosep.forms.conic import Plane
from metrosep.machine._bases import Basis, UnseenTerm, first_harmonic, null_sentences
from metrosep.machine._curve_orders import chosen_orders, covered, fold_of, taken_for
from metrosep.machine._lack_of_fit import rings_left
from metrosep.machine._measured import Measured, measured_points
from metrosep.machine._mesh import Positions, axis_positions
from metrosep.machine._reading_problem import NULL, ROUNDS, axis_of_term, columns_of
from metrosep.machine._responses import vertical_maps
from metrosep.machine.alignment import freedom_maps, removed_freedoms
from metrosep.machine.calibration import LARGEST_ERROR, Calibration, hardly_known, terms_found
from metrosep.machine.chains import Chain
from metrosep.machine.elements import element_terms, term_unit

N_RHO, N_AZIMUTH = 16, 36
"""Bins: harmonics to 12 and orders to 10 are seen well, and a covariance of all bins is quick."""

AUTO = "auto"
"""In place of a number of orders: choose it by cross-validation."""

_FEWEST = 1
"""Pixels of a bin, on average: bins of a coarse map are its pixels, so that more rings are left than orders."""
_SECTORS = 16
"""Below which rings are given up too."""

_BLOCK = 16384

_TAKEN = 1e-6
"""Of a column: what alignment and setting leave of it is rounding; the order is theirs."""

_RATIOS = (1.0, 4.0, 16.0)
_LENGTHS = tuple(2.1**k / 18.0 for k in range(4))  # of the radius of the part
_KERNELS = {
    "bell": ((1.0, 1.0),),
    # exp(-d) as bells of (weight, width): non-negative least squares over d = 0 to 6, RMS 0.003
    "exponential": ((0.115, 0.08), (0.118, 0.2), (0.334, 0.5), (0.374, 1.2), (0.059, 2.6)),
}
_LIMITS = ((0.05, 200.0), (0.02, 1.0))  # of the ratio, and of the length over the radius
_WORTH = 3.0
"""By how much twice the log likelihood must rise before a noise is taken for alike over a length."""

_ROUNDING = 1e-13
"""m: a smaller noise of a pixel is rounding, no instrument has it."""

_REFUSED, _GROSS = 4.0, 8.0
_OWN = 1e-3
"""Share of the length of a column that must be its own before anything is asked of it."""
_CHANCE = 1e-4
_LARGEST = 0.01
"""Of the radius of the part (for an angle: rad): no machine that still turns parts errs by so much."""
_RINGS = 6
"""Rings below which no step is looked for."""
_ALIKE = 0.9
_FURTHER = {"linear": 4, "rotary": 3}
"""Orders and harmonics that a term which was not asked for is tried with."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One map in bins: rows of the problem, with columns of curves, then of its own set-up."""

    label: str
    measured: Measured
    columns: FloatArray  # (n of pixels, p + k): of curves and of its own, before they are averaged
    y: FloatArray  # (n,), m
    X: FloatArray  # (n, p)
    own: FloatArray  # (n, k): alignment and setting
    own_names: tuple[str, ...]
    further: FloatArray  # (n, m): of curves that were not asked for
    counts: FloatArray  # (n,): pixels of each bin
    apart: FloatArray  # (2, n, n): distances along x and y, of the radius of the part
    width: (
        FloatArray  # (3, n, n): sums of the second moments xx, xy, yy of two bins, of its square
    )
    radius: float
    fold: NDArray[np.intp]  # (n,): which sixth of the map a bin is left out with
    ring: NDArray[np.intp]  # (n,): number of its ring
    radii: FloatArray  # m, the middle of each ring

    def likeness(self, kind: str, length: float, used: NDArray[np.bool_]) -> FloatArray:
        """Return the correlation of the means of used bins, of a kernel over a length.

        The mean of a bell over two bins, each taken for a Gaussian blob of its second moments:
        ``L^2 / sqrt(det M) exp(-d' M^-1 d / 2)`` with ``M = L^2 I + S_i + S_j``.
        """
        at = np.ix_(used, used)
        dx, dy = (d[at] for d in self.apart)
        xx, xy, yy = (w[at] for w in self.width)
        total = np.zeros_like(dx)
        for weight, scale in _KERNELS[kind]:
            square = (scale * length) ** 2
            a, b = square + xx, square + yy
            det = a * b - xy**2
            power = (b * dx**2 - 2.0 * xy * dx * dy + a * dy**2) / det
            total += weight * square / np.sqrt(det) * np.exp(-0.5 * power)
        return np.asarray(total)


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """Covariance of the bins of a part: ``scale^2 (1 / counts + ratio^2 mean(1 / counts) K)``."""

    kind: str
    ratio: float
    length: float  # of the radius of the part; 0 where the noise is white
    scale: float  # of one pixel, m

    def shape(self, part: _Part, used: NDArray[np.bool_]) -> FloatArray:
        """Return the covariance of used bins over the square of the scale."""
        own = 1.0 / part.counts[used]
        V = np.diag(own)
        if self.ratio > 0.0:
            near = part.likeness(self.kind, self.length, used)
            V += self.ratio**2 * float(own.mean()) * near
        return V

    def alike(self, part: _Part) -> float:
        """Return the standard deviation of what is alike over a length, m."""
        return self.ratio * self.scale * math.sqrt(float((1.0 / part.counts).mean()))


def curves_of_parts(
    chain: Chain,
    maps: Sequence[Any],
    form: Any,
    curves: Mapping[str, int | str] | None,
    *,
    terms: Iterable[str],
    removed: str | Iterable[str],
    tool: tuple[float, float, float],
    positions: Positions | None,
    **points: Any,
) -> Calibration:
    """Return the curves that explain maps of parts; `metrosep.machine.identify` says what is given."""
    if curves is None:
        raise DataError(
            f"{len(maps)} maps are explained together by curves only: give curves, such as "
            '{"EZX": 6, "EZC": 3}'
        )
    forms = list(form) if isinstance(form, list | tuple) else [form] * len(maps)
    if len(forms) != len(maps):
        raise DataError(f"{len(forms)} forms for {len(maps)} maps: give one, or one for each")
    given = [
        measured_points(m, Plane() if f is None else f, **points)
        for m, f in zip(maps, forms, strict=True)
    ]
    freedoms = removed_freedoms(removed)
    q = [
        axis_positions(chain, m.mesh.x, m.mesh.y, m.mesh.z, positions=positions, tool=tool)
        for m in given
    ]
    wanted = _checked_curves(chain, curves)
    free = [name for name in wanted if curves[name] == AUTO]
    notes: list[str] = []

    def problem(orders: Mapping[str, int], wider: Mapping[str, int]) -> Any:
        bases = _bases(chain, q, orders, terms)
        further = _bases(chain, q, wider, ())
        parts = [
            _binned(chain, m, at, bases, further, freedoms, tool, f"part {k + 1}")
            for k, (m, at) in enumerate(zip(given, q, strict=True))
        ]
        return further, *_without_gauge(bases, parts)

    with one_blas_thread():
        if free:
            _, bases, parts, _, _ = problem(wanted, {})
            chosen, tried = _chosen(bases, parts, free)
            wanted |= chosen
            if chosen:
                listed = ", ".join(f"{n} {order}" for n, order in chosen.items())
                notes.append(
                    f"orders by cross-validation, {tried} models compared: {listed}; u does not contain the choice"
                )
        further, bases, parts, gauge, dead = problem(wanted, _not_asked(chain, q, wanted))
        if not bases:
            raise DataError(
                f"the maps show nothing of {', '.join(curves)}: these parts do not depend on them, "
                "or the alignment takes all"
            )
        return _found(chain, parts, bases, further, gauge, dead, notes)


def _chosen(
    bases: Mapping[str, Basis], parts: Sequence[_Part], free: Sequence[str]
) -> tuple[dict[str, int], int]:
    """Return the orders of the free curves by cross-validation over all parts, and the models compared."""
    width = [part.own.shape[1] for part in parts]
    whole = []
    for k, part in enumerate(parts):
        used = _without_gross(part)
        noise = _noise_of(part, used)
        own = [np.zeros((int(used.sum()), n)) for n in width]
        own[k] = part.own[used]
        rows = np.column_stack([part.X[used], *own, part.y[used]])
        whole.append((covered(noise.shape(part, used), noise.scale), rows, part.fold[used]))
    return chosen_orders(bases, free, whole, sum(width))


def _checked_curves(chain: Chain, curves: Any) -> dict[str, int]:
    if not isinstance(curves, Mapping) or not curves:
        raise DataError(
            f'curves gives each term its orders or "auto", {{"EZX": 6, "EZC": "auto"}}, got {curves!r}'
        )
    chain.known_terms(tuple(curves))
    found = {}
    for name, order in curves.items():
        element = next(e for e in chain.elements if name in element_terms(e))
        if name in element.location_errors:
            raise DataError(
                f"{name} is a location error, one number: give it among terms, not among curves"
            )
        most = N_AZIMUTH // 3 if element.kind == "rotary" else 2 * N_RHO // 3
        if order == AUTO:
            found[name] = most
            continue
        found[name] = numbers.count(order, f'the orders of {name}, if not "auto",', least=1)
        if element.kind == "rotary" and found[name] < first_harmonic(element, name):
            raise DataError(
                f"{name}: harmonic 1 of a radial or tilt motion is where the part sits, not an error "
                "of the spindle; ask for 2 or more"
            )
        if found[name] > most:
            raise DataError(f"{name}: at most {most} orders can be seen in the bins of a map")
    return found


def _bases(
    chain: Chain,
    q: Sequence[Mapping[str, FloatArray]],
    curves: Mapping[str, int],
    terms: Iterable[str],
) -> dict[str, Basis]:
    """Return the shapes of curves and constants, in the order of the chain."""
    constant = chain.known_terms(tuple(terms))
    found = {}
    for element in chain.elements:
        for name in element_terms(element):
            if name in curves and element.name in q[0]:
                places = np.concatenate([np.ravel(at[element.name]) for at in q])
                if element.kind == "rotary":
                    first = first_harmonic(element, name)
                    if curves[name] >= first:
                        found[name] = Basis("fourier", tuple(range(first, curves[name] + 1)))
                    continue
                orders = tuple(range(1, curves[name] + 1))
                low, high = float(places.min()), float(places.max())
                if high - low > 1e-9:
                    found[name] = Basis("legendre", orders, low, high, None)
                    continue
                if name in curves:
                    continue  # an axis that stood still shows nothing
            elif name in constant and name not in curves:
                found[name] = Basis("constant", (0,))
    return found


def _not_asked(
    chain: Chain, q: Sequence[Mapping[str, FloatArray]], curves: Mapping[str, int]
) -> dict[str, int]:
    """Return curves beyond those that are fitted, as orders of each term."""
    return {
        name: max(_FURTHER[e.kind], curves.get(name, 0) + 2)
        for e in chain.elements
        if e.kind in _FURTHER and e.name in q[0]
        for name in element_terms(e)
        if name not in e.location_errors
    }


def _binned(
    chain: Chain,
    measured: Measured,
    q: Mapping[str, FloatArray],
    bases: Mapping[str, Basis],
    further: Mapping[str, Basis],
    freedoms: Sequence[str],
    tool: tuple[float, float, float],
    label: str,
) -> _Part:
    """Return the means of heights and columns over polar bins."""
    m = measured.mesh
    rho, azimuth = np.hypot(m.x, m.y), np.arctan2(m.y, m.x)
    inner, outer = float(rho.min()), float(rho.max())
    n_rho, n_azimuth = N_RHO, N_AZIMUTH
    while n_rho * n_azimuth * _FEWEST > rho.size and n_rho > 6:
        if n_azimuth > _SECTORS:
            n_azimuth -= 4
        else:
            n_rho -= 2
    ring = np.minimum((n_rho * (rho - inner) / (outer - inner)).astype(int), n_rho - 1)
    sector = np.minimum((n_azimuth * (azimuth / (2.0 * np.pi) + 0.5)).astype(int), n_azimuth - 1)
    whole = ring * n_azimuth + sector
    kept, index = np.unique(whole, return_inverse=True)
    counts = np.bincount(index).astype(np.float64)

    def mean(values: FloatArray) -> FloatArray:
        columns = values.reshape(values.shape[0], -1)
        sums = [np.bincount(index, c, minlength=kept.size) for c in columns.T]
        return np.stack(sums, axis=-1) / counts[:, None] if sums else np.zeros((kept.size, 0))

    settings = [n for n, b in bases.items() if b.kind == "legendre"]
    moved = {n: Basis("constant", (0,)) for n in settings}
    X, setting, more = (_columns(chain, set_, q, tool, m) for set_ in (bases, moved, further))
    slopes = {"slope_x": m.slope_x, "slope_y": m.slope_y}
    align = freedom_maps(freedoms, x=m.x, y=m.y, z=m.z, reach=float(m.rho[-1]), **slopes)
    own = np.hstack([align, setting])
    names = [*freedoms, *(f"setting {n}" for n in settings)]
    mean_own = mean(own)
    kept_own = _independent(mean_own)
    x, y = m.x / outer, m.y / outer
    place = mean(np.column_stack([x, y]))
    x, y = x - place[index, 0], y - place[index, 1]
    moments = mean(np.column_stack([x * x, x * y, y * y]))
    return _Part(
        label,
        measured,
        np.hstack([X, own[:, kept_own]]),
        mean((measured.z - m.z)[:, None])[:, 0],
        mean(X),
        mean_own[:, kept_own],
        tuple(names[i] for i in kept_own),
        mean(more),
        counts,
        np.stack([np.subtract.outer(v, v) for v in place.T]),
        np.stack([np.add.outer(v, v) for v in moments.T]),
        outer,
        fold_of(kept // n_azimuth, kept % n_azimuth, n_rho, n_azimuth),
        kept // n_azimuth,
        inner + (np.arange(n_rho) + 0.5) / n_rho * (outer - inner),
    )


def _columns(
    chain: Chain,
    bases: Mapping[str, Basis],
    q: Mapping[str, FloatArray],
    tool: tuple[float, float, float],
    mesh: Any,
) -> FloatArray:
    """Return the vertical deviation by each coefficient at the pixels, shape (n, p)."""
    n = mesh.x.size
    if not bases:
        return np.zeros((n, 0))
    blocks = []
    for i in range(0, n, _BLOCK):
        rows = slice(i, i + _BLOCK)
        at = {a: v[rows] for a, v in q.items()}
        E = columns_of(chain, bases, at, tool)
        blocks.append(vertical_maps(E, mesh.slope_x[rows], mesh.slope_y[rows]))
    return np.concatenate(blocks)


def _independent(columns: FloatArray) -> list[int]:
    """Return which columns move the part in a way of their own, earlier ones first."""
    kept: list[int] = []
    Q = np.zeros((columns.shape[0], 0))
    largest = float(np.linalg.norm(columns, axis=0).max(initial=0.0))
    for i, column in enumerate(columns.T):
        size = float(np.linalg.norm(column))
        if size <= 1e-12 * largest:
            continue
        left = column - Q @ (Q.T @ column)
        left -= Q @ (Q.T @ left)
        if np.linalg.norm(left) > _TAKEN * size:
            kept.append(i)
            Q = np.column_stack([Q, left / np.linalg.norm(left)])
    return kept


def _without_gauge(
    bases: dict[str, Basis], parts: list[_Part]
) -> tuple[dict[str, Basis], list[_Part], list[str], list[str]]:
    """Return the problem without orders that the alignment of every part takes, and their names."""
    sizes, left = 0.0, 0.0
    for part in parts:
        Q = np.linalg.qr(part.own)[0]
        free = part.X - Q @ (Q.T @ part.X)
        sizes = sizes + np.sum(part.X**2, axis=0)
        left = left + np.sum(free**2, axis=0)
    largest = float(np.max(sizes))
    seen = np.sqrt(left) > _TAKEN * np.sqrt(np.maximum(sizes, 1e-24 * largest))
    kept: dict[str, Basis] = {}
    columns: list[int] = []
    gauge, dead, at = [], [], 0
    for name, basis in bases.items():
        per = len(basis.labels) // len(basis.orders)
        orders = []
        for k, order in enumerate(basis.orders):
            mine = list(range(at + per * k, at + per * (k + 1)))
            if seen[mine].any():
                orders.append(order)
                columns += mine
            elif np.asarray(sizes)[mine].max() > 1e-24 * largest:
                gauge.append(f"{name}{basis.labels[per * k].replace('cos', '')}")
        at += len(basis.labels)
        if orders:
            kept[name] = replace(basis, orders=tuple(orders))
        else:
            dead.append(name)
    n = parts[0].X.shape[1]
    fewer = [
        replace(p, X=p.X[:, columns], columns=np.hstack([p.columns[:, columns], p.columns[:, n:]]))
        for p in parts
    ]
    return kept, fewer, gauge, dead


# ---- noise of each part, estimate of all -----------------------------------------------------------


def _noise_of(part: _Part, used: NDArray[np.bool_]) -> _Noise:
    """Return the noise that makes the residuals of a part, by all that could be fitted to it, likely."""
    whole = np.hstack([part.X, part.own])[used]
    size = np.linalg.norm(whole, axis=0)
    U, singular, _ = np.linalg.svd(whole / np.where(size > 0.0, size, 1.0), full_matrices=False)
    Z = U[:, singular > NULL * singular[0]]
    y = part.y[used]

    def value(noise: _Noise) -> tuple[float, float]:
        return _likelihood(noise.shape(part, used), Z, y)

    white = _Noise("bell", 0.0, 0.0, 1.0)
    at_white, scale = value(white)
    if scale <= _ROUNDING:
        return replace(white, scale=scale)
    grid = [_Noise(k, a, x, 1.0) for k in _KERNELS for a in _RATIOS for x in _LENGTHS]
    best = min(grid, key=lambda n: value(n)[0])
    from scipy.optimize import minimize

    def at(logs: FloatArray) -> _Noise:
        a, x = (float(np.clip(math.exp(v), *b)) for v, b in zip(logs, _LIMITS, strict=True))
        return _Noise(best.kind, a, x, 1.0)

    def cost(logs: FloatArray) -> float:
        return value(at(logs))[0]

    polished = minimize(
        cost,
        np.log([best.ratio, best.length]),
        method="Nelder-Mead",
        options={"maxfev": 40, "xatol": 0.05, "fatol": 0.02},
    )
    if polished.fun > at_white - _WORTH:
        return replace(white, scale=scale)
    found = at(polished.x)
    return replace(found, scale=value(found)[1])


def _likelihood(V: FloatArray, Z: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return -2 log restricted likelihood but for a constant, and the scale (machines.md, eq. 17)."""
    from scipy.linalg import LinAlgError, cholesky, solve_triangular

    try:
        L = cholesky(V, lower=True, check_finite=False)
    except LinAlgError:
        return math.inf, math.inf
    white = solve_triangular(L, np.column_stack([Z, y]), lower=True, check_finite=False)
    Q, R = np.linalg.qr(white[:, :-1])
    rest = white[:, -1] - Q @ (Q.T @ white[:, -1])
    free = y.size - Z.shape[1]
    square = max(float(rest @ rest), np.finfo(np.float64).tiny)
    value = 2.0 * float(np.log(np.diag(L)).sum()) + 2.0 * float(np.log(np.abs(np.diag(R))).sum())
    return value + free * math.log(square), math.sqrt(square / free)


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """Coefficients of all columns (curves, then each part's own), scaled, with what is not seen."""

    beta: FloatArray
    cov: FloatArray
    blind: FloatArray
    singular: FloatArray
    V: FloatArray
    sizes: FloatArray


def _estimate(
    parts: Sequence[_Part], noises: Sequence[_Noise], used: Sequence[NDArray[np.bool_]]
) -> tuple[_Estimate, list[tuple[FloatArray, FloatArray]]]:
    """Return the estimate of generalised least squares, and each part's factor and whitened rows."""
    from scipy.linalg import cholesky, solve_triangular

    p = parts[0].X.shape[1]
    width = p + sum(part.own.shape[1] for part in parts)
    plain, whitened, begin = [], [], p
    for part, noise, good in zip(parts, noises, used, strict=True):
        rows = np.zeros((int(good.sum()), width + 1))
        rows[:, :p] = part.X[good]
        end = begin + part.own.shape[1]
        rows[:, begin:end] = part.own[good]
        rows[:, -1] = part.y[good]
        begin = end
        L = noise.scale * cholesky(noise.shape(part, good), lower=True)
        plain.append(rows)
        whitened.append((L, solve_triangular(L, rows, lower=True)))
    X = np.concatenate(plain)[:, :-1]
    sizes = np.linalg.norm(X, axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    _, singular, directions = np.linalg.svd(np.linalg.qr(X / sizes, mode="r"))
    known = singular > NULL * singular[0]
    if X.shape[0] < 2 * int(known.sum()):
        raise TooFewSamplesError(
            f"{X.shape[0]} bins for {int(known.sum())} unknowns; measure more of the part, or ask "
            "for fewer orders"
        )
    V, blind = directions[known].T, directions[~known].T
    rows = np.concatenate([w for _, w in whitened])
    Z = (rows[:, :-1] / sizes) @ V
    Q, R = np.linalg.qr(Z)
    inner = np.linalg.inv(R)
    found = inner @ (Q.T @ rows[:, -1])
    beta, cov = V @ found / sizes, V @ (inner @ inner.T) @ V.T / np.outer(sizes, sizes)
    return _Estimate(beta, cov, blind, singular, V, sizes), whitened


def _settled(
    parts: list[_Part],
) -> tuple[
    _Estimate,
    list[_Noise],
    list[NDArray[np.bool_]],
    list[tuple[FloatArray, FloatArray]],
    _Contradiction | None,
]:
    """Return the estimate when no further bin is refused, and how parts contradict each other."""
    used = [_without_gross(p) for p in parts]
    noises = [_noise_of(p, u) for p, u in zip(parts, used, strict=True)]
    estimate, whitened = _estimate(parts, noises, used)
    against = _contradiction(parts, estimate, whitened)
    # bins that differ because their parts do are not wrong
    for _ in range(0 if against else ROUNDS):
        changed = False
        for k, (L, rows) in enumerate(whitened):
            bad = _contradicting(L, rows, estimate)
            if bad.any():
                used[k][np.flatnonzero(used[k])[bad]] = False
                noises[k] = _noise_of(parts[k], used[k])
                changed = True
        if not changed:
            break
        estimate, whitened = _estimate(parts, noises, used)
    if against:
        added = np.zeros(estimate.beta.size)
        added[: against.added.size] = against.added
        estimate = replace(estimate, cov=estimate.cov + np.diag(added))
    return estimate, noises, used, whitened, against


@dataclass(frozen=True, slots=True, eq=False)
class _Contradiction:
    """What parts say of common coefficients beyond their noise."""

    added: FloatArray  # (p,): to the variance of each coefficient
    ratio: float  # root of chi-square over its degrees
    which: int  # the coefficient that takes most
    parts: list[int]  # without each of which the others agree


def _contradiction(
    parts: Sequence[_Part],
    estimate: _Estimate,
    whitened: Sequence[tuple[FloatArray, FloatArray]],
) -> _Contradiction | None:
    """Return how parts contradict each other; None where they agree (chi-square, 1e-4 by chance).

    What coefficients of each part's own take of the square is chi-square of as many degrees as they add. What one
    coefficient alone so takes is the scatter of it over the parts, and that over their number the variance of its
    mean (by Student's t of its degrees): it is added, and to another coefficient that looks alike as well.
    """
    from scipy.stats import chi2, t as student

    if len(parts) < 2:
        return None
    p = parts[0].X.shape[1]
    listed = [rows for _, rows in whitened]
    square, degrees = _disagreement(listed, p)
    if not degrees or chi2.sf(square, degrees) >= _CHANCE:
        return None
    without = [_disagreement(listed[:k] + listed[k + 1 :], p) for k in range(len(listed))]
    rows = np.concatenate(listed)
    Z = np.linalg.qr((rows[:, :-1] / estimate.sizes) @ estimate.V)[0]
    rest = rows[:, -1] - Z @ (Z.T @ rows[:, -1])
    where = np.repeat(np.arange(len(listed)), [r.shape[0] for r in listed])
    added, taken = np.zeros(p), np.zeros(p)
    for c in range(p):
        own = rows[:, c, None] * (where[:, None] == np.arange(len(listed)))
        size = np.linalg.norm(own, axis=0)
        left, size = (own - Z @ (Z.T @ own))[:, size > 0.0], size[size > 0.0]
        U, singular, _ = np.linalg.svd(left / size, full_matrices=False)
        U = U[:, singular > _OWN]
        if U.shape[1]:
            taken[c] = float(np.sum((U.T @ rest) ** 2))
            twice = student.isf(0.5 * math.erfc(math.sqrt(2.0)), U.shape[1])  # what 2 u hold
            added[c] = taken[c] / float(np.sum(left**2)) / size.size * float(twice / 2.0) ** 2
    ratio, which = math.sqrt(square / degrees), int(np.argmax(taken))
    agree = [k for k, (left, n) in enumerate(without) if n and chi2.sf(left, n) >= _CHANCE]
    return _Contradiction(added, ratio, which, agree)


def _disagreement(listed: Sequence[FloatArray], p: int) -> tuple[float, int]:
    """Return by how much more one curve for all parts leaves than a curve for each, and the degrees of it."""
    alone = [_square_left(rows) for rows in listed]
    own = [np.any(rows[:, p:-1] != 0.0, axis=0) for rows in listed]
    used = np.concatenate([np.ones(p, dtype=bool), np.any(own, axis=0), [True]])
    square, rank = _square_left(np.concatenate(listed)[:, used])
    return square - sum(s for s, _ in alone), sum(r for _, r in alone) - rank


def _square_left(rows: FloatArray) -> tuple[float, int]:
    """Return the square that columns leave of the last one, and how many they are."""
    size = np.linalg.norm(rows[:, :-1], axis=0)
    U, singular, _ = np.linalg.svd(
        rows[:, :-1][:, size > 0.0] / size[size > 0.0], full_matrices=False
    )
    U = U[:, singular > NULL * singular[0]]
    rest = rows[:, -1] - U @ (U.T @ rows[:, -1])
    return float(rest @ rest), U.shape[1]


def _without_gross(part: _Part) -> NDArray[np.bool_]:
    """Return the bins without those far off a plain fit: they would pass for noise alike over a length."""
    whole = np.hstack([part.X, part.own]) * np.sqrt(part.counts)[:, None]
    whole = whole / np.maximum(np.linalg.norm(whole, axis=0), np.finfo(np.float64).tiny)
    y = part.y * np.sqrt(part.counts)
    used = np.ones(y.size, dtype=bool)
    for _ in range(ROUNDS):
        found = np.linalg.lstsq(whole[used], y[used], rcond=NULL)[0]
        rest = np.abs(y - whole @ found)
        far = rest > _GROSS * 1.4826 * float(np.median(rest[used]))
        if not (far & used).any() or float(np.median(rest)) < _ROUNDING:
            break
        # the worst half of them at a time: one bad bin pulls its neighbours
        used &= rest < max(0.5 * float(rest[used].max()), float(rest[~far].max()))
    return used


def _contradicting(L: FloatArray, rows: FloatArray, estimate: _Estimate) -> NDArray[np.bool_]:
    """Return which bins lie far from what all others, with what is alike, say of them."""
    from scipy.linalg import solve_triangular

    # deleted residuals: V^-1 r over the root of the diagonal of what the fit leaves of V^-1
    rest = rows[:, -1] - rows[:, :-1] @ estimate.beta
    back = solve_triangular(L, np.eye(L.shape[0]), lower=True)
    solved, model = back.T @ rest, back.T @ rows[:, :-1]
    whole = np.sum(back**2, axis=0)
    left = whole - np.sum((model @ estimate.cov) * model, axis=1)
    t = solved / np.sqrt(np.maximum(left, 1e-12 * whole))
    # robust: one bad bin must not hide another behind a scale of its making
    scale = 1.4826 * float(np.median(np.abs(t)))
    return np.asarray(np.abs(t) > _REFUSED * max(scale, 1.0))


def _not_explained(
    chain: Chain,
    further: Mapping[str, Basis],
    parts: Sequence[_Part],
    used: Sequence[NDArray[np.bool_]],
    estimate: _Estimate,
    whitened: Sequence[tuple[FloatArray, FloatArray]],
    bases: Mapping[str, Basis],
) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Return terms of which the residuals hold a curve beyond chance, the likeliest first (score test).

    And those that would be taken for what was asked for, with what they shift.
    """
    from scipy.linalg import solve_triangular
    from scipy.stats import chi2

    more = np.concatenate(
        [
            solve_triangular(L, p.further[u], lower=True)
            for (L, _), p, u in zip(whitened, parts, used, strict=True)
        ]
    )
    rows = np.concatenate([w for _, w in whitened])
    Z, R = np.linalg.qr((rows[:, :-1] / estimate.sizes) @ estimate.V)
    rest = rows[:, -1] - Z @ (Z.T @ rows[:, -1])
    left = more - Z @ (Z.T @ more)
    found, at = {}, 0
    for name, basis in further.items():
        mine = slice(at, at + len(basis.labels))
        at = mine.stop
        size = np.linalg.norm(more[:, mine], axis=0)
        own = left[:, mine] / np.where(size > 0.0, size, 1.0)
        U, singular, _ = np.linalg.svd(own, full_matrices=False)
        good = singular > _OWN
        if good.any():
            gain = float(np.sum((U[:, good].T @ rest) ** 2))
            if chi2.sf(gain, int(good.sum())) * len(further) < _CHANCE:
                found[name] = gain
    best = max(found.values(), default=0.0)
    strong = [n for n, gain in found.items() if gain >= _ALIKE * best]
    names = [f"{n}{label}" for n, b in bases.items() for label in b.labels]
    p = len(names)
    shifts = (estimate.V @ np.linalg.solve(R, Z.T @ more) / estimate.sizes[:, None])[:p]
    alike = taken_for(
        further, tuple(n for n, b in bases.items() if b.kind != "constant"), more, left, shifts,
        np.sqrt(np.maximum(np.diag(estimate.cov)[:p], 0.0)), names,
        {n: LARGEST_ERROR[term_unit(chain, n)] for n in further},
    )  # fmt: skip
    return tuple(sorted(strong, key=lambda n: -found[n])), alike


def _found(
    chain: Chain,
    parts: list[_Part],
    bases: Mapping[str, Basis],
    further: Mapping[str, Basis],
    gauge: Sequence[str],
    dead: Sequence[str],
    notes: Sequence[str] = (),
) -> Calibration:
    estimate, noises, used, whitened, against = _settled(parts)
    names = [f"{n}{label}" for n, b in bases.items() for label in b.labels]
    p = len(names)
    units = [term_unit(chain, n) for n, b in bases.items() for _ in b.labels]
    all_names = [*names, *(f"{n} of {part.label}" for part in parts for n in part.own_names)]
    null, members = null_sentences(estimate.blind, all_names)
    null = (*null, *hardly_known(names, units, estimate.cov[:p, :p]))
    unseen = {n.split(" ")[0] for group in members for n in group if n in names}
    reach = {"m": _LARGEST * max(part.radius for part in parts), "rad": _LARGEST}
    cov = estimate.cov[:p, :p]
    errors, fitted = terms_found(chain, bases, estimate.beta[:p], cov, unseen, {}, reach)
    for name in dead:
        errors[name] = UnseenTerm()
    u = np.sqrt(np.maximum(np.diag(estimate.cov), 0.0))
    unknowns, residuals, refused, noise = {}, {}, {}, {}
    messages = [*_about_parts(parts, bases, against)]
    messages += [*notes, *(note for part in parts for note in part.measured.notes)]
    begin, at = p, 0
    span = np.linalg.qr(
        np.concatenate([w for _, w in whitened])[:, :-1] / estimate.sizes @ estimate.V
    )[0]
    for part, good, its, (L, rows) in zip(parts, used, noises, whitened, strict=True):
        mine = np.arange(begin, begin + len(part.own_names))
        begin += mine.size
        unknowns[part.label] = freeze_mapping(
            {n: (estimate.beta[[i]], u[[i]]) for n, i in zip(part.own_names, mine, strict=True)}
        )
        model = part.columns @ estimate.beta[np.append(np.arange(p), mine)]
        m = part.measured
        residuals[part.label] = m.on_map(m.z - m.mesh.z - model)
        refused[part.label] = int(np.count_nonzero(~good))
        noise[part.label] = its.scale
        messages += _about_noise(part, its, refused[part.label])
        mine = np.arange(at, at + rows.shape[0])
        at += rows.shape[0]
        messages += _rings(part, good, L, rows[:, -1], span[mine], len(parts))
    messages += _about(chain, bases, gauge, dead)
    missing, alike = _not_explained(chain, further, parts, used, estimate, whitened, bases)
    if missing:
        like = f" ({', '.join(missing[1:])} would look alike)" if len(missing) > 1 else ""
        messages.append(
            f"the residual holds more of {missing[0]} over its travel than was asked for{like}: give "
            "it more orders among curves; u does not contain what is missing"
        )
    if alike:
        listed = ", ".join(f"{n} (for {' and '.join(of)})" for n, of in alike.items())
        messages.append(
            f"curves that were not asked for may be taken for those that were, by more than 3 u, before the residual "
            f"shows them: {listed}; where such a motion is possible ask for it too, or measure another form"
        )
    known = estimate.singular[estimate.singular > NULL * estimate.singular[0]]
    return Calibration(
        chain=chain,
        errors=freeze_mapping(errors),
        fitted=freeze_mapping(fitted),
        names=tuple(names),
        coefficients=estimate.beta[:p],
        covariance=estimate.cov[:p, :p],
        null=null,
        condition=float(known[0] / known[-1]),
        unknowns=freeze_mapping(unknowns),
        residuals=freeze_mapping(residuals),
        refused=freeze_mapping(refused),
        noise=freeze_mapping(noise),
        bases=freeze_mapping(dict(bases)),
        blind=estimate.blind[:p] / estimate.sizes[:p, None],
        sets=freeze_mapping({}),
        messages=(*chain.messages, *messages),
        audit=freeze_mapping(
            {
                "parts": len(parts),
                "bins": int(sum(part.y.size for part in parts)),
                "unknowns": len(all_names),
                "rank": int(known.size),
                "noise_length_mm": tuple(
                    1e3 * n.length * part.radius for n, part in zip(noises, parts, strict=True)
                ),
                "curves": {n: len(b.orders) for n, b in bases.items() if b.kind != "constant"},
            }
        ),
    )


def _rings(
    part: _Part,
    used: NDArray[np.bool_],
    L: FloatArray,
    y: FloatArray,
    model: FloatArray,
    parts: int,
) -> list[str]:
    """Return a sentence where what is left of a part has a step or a ridge round its axis."""
    from scipy.linalg import solve_triangular

    kept, which = np.unique(part.ring[used], return_inverse=True)
    if kept.size < _RINGS:
        return []
    white = solve_triangular(L, (which[:, None] == np.arange(kept.size)).astype(float), lower=True)
    # beside the model of this part alone: other parts only hold it tighter
    U, singular, _ = np.linalg.svd(model, full_matrices=False)
    Q = U[:, singular > NULL * singular.max(initial=0.0)]
    return rings_left(part.label, part.radii[kept], white, Q, y - Q @ (Q.T @ y), parts)


def _about_noise(part: _Part, noise: _Noise, refused: int) -> Iterator[str]:
    """Yield what was found of the noise of a part, and of its bins."""
    yield (
        f"{part.label}: noise {format_length(noise.scale, digits=2)} for each pixel"
        + (
            f" and {format_length(noise.alike(part), digits=2)} alike over "
            f"{format_length(noise.length * part.radius, digits=2)} ({noise.kind})"
            if noise.ratio > 0.0
            else ", no likeness over a length was found"
        )
    )
    if refused:
        yield (
            f"{part.label}: {refused} of {part.y.size} bins contradict the others and were refused"
        )


def _about_parts(
    parts: Sequence[_Part], bases: Mapping[str, Basis], against: _Contradiction | None
) -> Iterator[str]:
    """Yield which part contradicts the others, and which is another one again."""
    for k, part in enumerate(parts):
        same = [p.label for p in parts[:k] if np.array_equal(p.measured.z, part.measured.z)]
        if same:
            yield f"{part.label} is {same[0]} again, height for height: u takes its noise for new; leave one out"
    if against is None:
        return
    name = [n for n, b in bases.items() for _ in b.labels][against.which]
    who = f"{' or '.join(parts[k].label for k in against.parts)} contradicts the others"
    if not against.parts:
        who = f"{', '.join(p.label for p in parts)} contradict each other"
    yield (
        f"{who}: what they say of the curves differs by {against.ratio:.3g} times their noise, most of {name}; u of each "
        "coefficient holds the scatter of the parts. Check its azimuth (mirrored or turned), sign, unit, "
        "lateral step, centre and form, or whether the machine changed between the parts"
    )


def _about(
    chain: Chain, bases: Mapping[str, Basis], gauge: Sequence[str], dead: Sequence[str]
) -> list[str]:
    """Return what is convention, and what these parts do not show."""
    said = []
    if gauge:
        said.append(
            f"{', '.join(gauge)}: the alignment of the part takes them; taken as zero by convention"
        )
    if dead:
        said.append(f"{', '.join(dead)}: not visible on these parts")
    for name, basis in bases.items():
        if basis.kind == "legendre":
            ends = " to ".join(format_engineering(v, "m") for v in (basis.low, basis.high))
            said.append(
                f"{name}: over {axis_of_term(chain, name)} = {ends}, zero in the mean; its constant is the "
                "setting of the tool or the height of the part"
            )
    return said
