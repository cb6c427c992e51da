"""Uncertainty of a fit whose deviations hang together from pixel to pixel.

With N points, J the derivatives at the solution, J = Q R, and C the covariance of the deviations::

    cov(a) = R^-1 (Q' C Q) R^-T                                                          (1)

White deviations give the textbook's s^2 (J'J)^-1, which is right for nothing that is machined. Two
estimates of C are made from the residual, and the larger standard uncertainty counts. Part A is its
autocovariance, corrected for the low frequencies that the fit took out. Part B looks at the
polynomials next to the model and goes on to the model's own frequencies, since real surfaces have
more power there than a short correlation can hold. An error that has the shape of a parameter (a
wrong reference sphere) is in neither. Sources: metrology-2, chapter 1; sandwich covariance after
Newey and West (1987), window after Sokal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.forms._orthogonal import values
from metrosep.forms.points import Points

Linearise = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""From x, y, z of points to derivatives and deviations, shape (p + 1, n)."""

_SIDE, _SIDE_B, _LINE = 400, 128, 4000
"""Pixels along a map (part B: its polynomials are smooth) and along a profile; more are averaged in
blocks. u changes by less than 1.5 % (metrology-2, 1.4)."""
_VALUES = 4_000_000
"""Of all columns together: with many parameters the blocks are larger."""
_PAIRS = 0.02
"""Lags with a smaller share of pairs do not count."""
_LEAST_LEFT = 0.05
"""Of the sum (4): below it the fit took nearly all of what the lags hold."""
_LOWEST, _MORE, _MOST = 7, 5, 25
"""Degrees of the polynomials next to the model; from the model's, at most."""
_TIED = 1e-13
"""Of a column: what is left of it beside the columns before it is rounding below this."""
_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Of the largest height: a smaller residual is rounding."""
_NOTHING = 1e-6
"""Of a polynomial: what is left of it beside the model counts as rounding below this."""
_LEAST_ORDER = 0.7
"""A piston stands below the lowest frequency of the map."""
_STEEPEST = 4.0
"""Exponent of the steepest power law that surfaces have (f^-4: metrology-2, 7.2)."""
_BY_CHANCE = 1.645
"""Standard deviations: 5 % on one side."""
_PSI = 0.5772156649
"""Minus the mean of the logarithm of a mean of two squares of noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the residual says about the parameters: covariance (p, p), NaN where it says nothing."""

    cov: FloatArray
    dof: float
    n_effective: float
    length: float
    # whether the form may have taken up more of the deviations than it left, so that the u of some
    # parameters is a bound by energy
    bounded: bool = False


def estimated(points: Points, linearise: Linearise, residual: FloatArray, p: int) -> Estimate:
    """Return the covariance of p parameters from what a fit left, m, shape of the points' z."""
    with one_blas_thread(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if points.is_scattered:
            return _scattered(points, linearise, residual, p)
        is_line = points.z.shape[0] == 1
        limit = _LINE if is_line else min(_SIDE, max(int(np.sqrt(_VALUES / p)), 64))
        b = -(-max(points.z.shape) // limit)
        x, y, J, r = _means(points, linearise, residual, p, b)
        good = ~np.isnan(r)
        N = int(good.sum())
        if p >= N:
            return _unknown(p, N)
        level = float(np.sqrt(np.mean(np.square(r[good]))))
        floor = max(_ROUNDING * points.largest, 1e-60)  # m: squares of less would underflow
        r /= max(level, floor)
        Q, R, rest = _factors(J[:, good], r[good])
        size = np.linalg.norm(R, axis=0)
        if not (np.abs(np.diag(R)) > _TIED * size).all():
            return _unknown(p, N)
        if level <= floor:  # rounding of the heights, which hangs together with nothing
            inverse = np.linalg.inv(R) * floor
            return Estimate(inverse @ inverse.T, float(N - p), float(N), 0.0)
        M, area, dof = _lags(Q, rest, good, is_line=is_line)
        inverse = np.linalg.inv(R)
        by_a = inverse @ M @ inverse.T
        if not is_line and max(r.shape) > _SIDE_B:
            coarser = -(-max(r.shape) // _SIDE_B)
            x, y, J, r = _blocks(x, y, J, r, coarser, coarser)
            good = ~np.isnan(r)
        by_b, n_functions, bounded = _next_to_the_model(
            x[good], y[good], J[:, good], r[good], is_line=is_line
        )
        cov = _larger(by_a, by_b, inverse @ inverse.T) * level**2
        n_effective = N / area
        if n_effective < 2 * p:
            return _unknown(p, n_effective)
        length = b * (0.5 * area if is_line else np.sqrt(area / np.pi))
        return Estimate(cov, max(1.0, min(dof, n_functions)), n_effective, float(length), bounded)


class NoiseModel(Protocol):
    """What a fit asks of a noise model: its covariance against lag, on a torus, m^2."""

    def autocovariance(self, target: Any) -> FloatArray: ...


def from_model(
    points: Points, linearise: Linearise, covariance: FloatArray, valid: BoolArray, p: int
) -> Estimate:
    """Return the covariance (1) of p parameters under a noise of known covariance against lag."""
    from scipy import fft

    with one_blas_thread():
        rows, columns = np.nonzero(valid)
        J = linearise(points.x[columns], points.y[rows], points.z[valid])[:p]
        N = rows.size
        if p >= N:
            return _unknown(p, N)
        length = np.linalg.norm(J, axis=1)
        length = np.where(length > 0.0, length, 1.0)
        Q, R = np.linalg.qr((J / length[:, None]).T)
        spectrum = np.asarray(fft.rfft2(np.atleast_2d(covariance)))
        torus = np.atleast_2d(covariance).shape
        image = np.zeros(valid.shape)
        pushed = np.empty((p, N))
        for k in range(p):
            image[valid] = Q[:, k]
            field = fft.irfft2(fft.rfft2(image, torus) * spectrum, torus)
            pushed[k] = field[: valid.shape[0], : valid.shape[1]][valid]
        M = pushed @ Q
        inverse = np.linalg.inv(R * length)
        cov = inverse @ (0.5 * (M + M.T)) @ inverse.T
        return Estimate(cov, np.inf, float(N), np.nan)


def _unknown(p: int, n_effective: float) -> Estimate:
    return Estimate(np.full((p, p), np.nan), np.nan, float(n_effective), np.nan)


def _scattered(points: Points, linearise: Linearise, residual: FloatArray, p: int) -> Estimate:
    """Return part B alone, which needs no lags: points of a list have no neighbours."""
    good = ~np.isnan(residual[0])
    x, y, r = points.x[good], points.y[good], residual[0][good]
    if r.size <= p:
        return _unknown(p, r.size)
    J = linearise(x, y, points.z[0][good])[:p]
    cov, n_functions, bounded = _next_to_the_model(x, y, J, r, is_line=float(np.ptp(y)) == 0.0)
    return Estimate(cov, max(1.0, float(n_functions)), float(r.size), np.nan, bounded)


def _larger(by_a: FloatArray, by_b: FloatArray, white: FloatArray) -> FloatArray:
    """Return the larger variances with the correlations of part A; of white noise if that has none."""
    a, b = (np.sqrt(np.maximum(np.diag(v), 0.0)) for v in (by_a, by_b))
    own = by_a if (a > 0.0).all() else white
    size = np.sqrt(np.diag(own))
    u = np.fmax(a, b)
    return np.asarray(own / np.outer(size, size) * np.outer(u, u))


def _factors(J: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Q (n, p) and R of the derivatives (p, n), and what Q leaves of the residual."""
    length = np.sqrt(np.einsum("ij,ij->i", J, J))
    length = np.where(length > 0.0, length, 1.0)
    Q, R = np.linalg.qr((J / length[:, None]).T)
    return Q, R * length, r - Q @ (Q.T @ r)


def _means(
    points: Points, linearise: Linearise, residual: FloatArray, p: int, b: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return x, y, derivatives (p, ., .) and residual as means over b x b points.

    NaN in the residual where less than half of a block is valid. The mean of the derivatives is that
    of Gauss' two points along each side, exact for what is cubic in a block, at a cost of 4 / b^2.
    """
    n_y, n_x = points.z.shape
    across = 1 if n_y == 1 else b
    rows, columns = _two_of_each(n_y, across), _two_of_each(n_x, b)
    J = np.empty((p, rows.size, columns.size))
    strip = max(1, 16384 // columns.size)
    for start in range(0, rows.size, strip):
        part = slice(start, start + strip)
        z = points.z[np.ix_(rows[part], columns)]
        x = np.broadcast_to(points.x[columns], z.shape)
        y = np.broadcast_to(points.y[rows[part], None], z.shape)
        J[:, part] = linearise(x.ravel(), y.ravel(), z.ravel())[:p].reshape(p, *z.shape)
    r = residual[np.ix_(rows, columns)]
    x = np.broadcast_to(points.x[columns], r.shape)
    y = np.broadcast_to(points.y[rows, None], r.shape)
    x, y, J, r = _blocks(x, y, J, r, min(across, 2), min(b, 2), least=0.25)
    if b > 2:
        r = np.where(np.isnan(r), np.nan, _mean_heights(residual, across, b))
    return x, y, J, r


def _two_of_each(n: int, b: int) -> NDArray[np.intp]:
    """Return the two places of n that are nearest to Gauss' points in each block of b; all if b < 3."""
    if b < 3:
        return np.arange(n)
    first = np.arange(0, n, b)
    wide = np.minimum(b, n - first)
    middle, half = first + 0.5 * (wide - 1), wide / np.sqrt(12.0)
    return np.asarray(
        np.rint(np.column_stack([middle - half, middle + half])).astype(np.intp).ravel()
    )


def _blocks(
    x: FloatArray,
    y: FloatArray,
    J: FloatArray,
    r: FloatArray,
    b_y: int,
    b_x: int,
    least: float = 0.5,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return means over the valid points of each block; NaN in r where they are a lesser share."""
    good = ~np.isnan(r) & ~np.isnan(J).any(axis=0)
    if b_y == b_x == 1:
        return np.array(x), np.array(y), np.where(good, J, 0.0), np.where(good, r, np.nan)
    n = _total(good, b_y, b_x)
    enough = n >= least * _total(np.ones(r.shape), b_y, b_x)
    n = np.where(enough, n, 1.0)
    x, y, r = (_total(np.where(good, v, 0.0), b_y, b_x) / n for v in (x, y, r))
    means = np.stack([_total(np.where(good, column, 0.0), b_y, b_x) / n for column in J])
    return x, y, np.where(enough, means, 0.0), np.where(enough, r, np.nan)


def _mean_heights(r: FloatArray, b_y: int, b_x: int) -> FloatArray:
    good = ~np.isnan(r)
    n = _total(good, b_y, b_x)
    full = n if good.all() else _total(np.ones(r.shape), b_y, b_x)
    total = _total(np.where(good, r, 0.0), b_y, b_x)
    return np.where(n >= 0.5 * full, total / np.maximum(n, 1.0), np.nan)


def _total(v: NDArray[Any], b_y: int, b_x: int) -> FloatArray:
    """Return the sums over blocks; those at the end may be smaller."""
    rows = np.zeros((-(-v.shape[0] // b_y), v.shape[1]))
    for k in range(b_y):
        part = v[k::b_y]
        rows[: part.shape[0]] += part
    total = np.zeros((rows.shape[0], -(-rows.shape[1] // b_x)))
    for k in range(b_x):
        part = rows[:, k::b_x]
        total[:, : part.shape[1]] += part
    return total


# ---- part A --------------------------------------------------------------------------------------


def _lags(
    Q: FloatArray, r: FloatArray, good: BoolArray, *, is_line: bool
) -> tuple[FloatArray, float, float]:
    """Return Q' C Q from the autocovariance, the correlated area in pixels, degrees of freedom.

    With c(h) and g(h) the lagged products of the residual and of the columns of Q, over the number
    of pairs n(h): the fit lowers c by S g, so that the sum over |h| <= L is
    S = sum c / (1 - sum g) (4), the area A = S / (c(0) + S g(0)) (5), and L the smallest with
    L >= 4 sqrt(A / pi) (6), on a profile L >= 2 A.
    """
    from scipy import fft

    N, p = Q.shape
    shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in good.shape)

    def image(v: FloatArray) -> FloatArray:
        full = np.zeros(good.shape)
        full[good] = v
        return np.asarray(fft.rfft2(full, shape))

    def lagged(spectrum: FloatArray) -> FloatArray:
        return np.asarray(fft.irfft2(spectrum, shape))

    n_f = shape[0] * (shape[1] // 2 + 1)
    spectra = np.empty((p, 2 * n_f))  # real and imaginary parts side by side
    for row, q in zip(spectra, Q.T, strict=True):
        row[:] = image(q).reshape(-1).view(np.float64)
    pairs = np.rint(lagged(np.square(np.abs(image(np.ones(N))))))
    counts = pairs >= max(_PAIRS * N, 1.0)
    pairs = np.maximum(pairs, 1.0)
    c = lagged(np.square(np.abs(image(r)))) / pairs
    energy = np.einsum("ij,ij->j", spectra, spectra).reshape(shape[0], -1, 2).sum(axis=2)
    g = lagged(energy) / pairs
    i, j = (np.rint(fft.fftfreq(n) * n).astype(np.intp) for n in shape)
    square = i[:, None] ** 2 + j[None, :] ** 2
    at = square[counts]
    summed = [np.cumsum(np.bincount(at, v[counts])) for v in (c, g)]
    there = np.nonzero(np.bincount(at))[0]
    there = there[there >= 1]
    if there.size == 0:
        there = np.zeros(1, dtype=np.intp)
    L = np.sqrt(there.astype(np.float64))
    S = summed[0][there] / np.maximum(1.0 - summed[1][there], _LEAST_LEFT)
    variance = c[0, 0] + S * g[0, 0]
    A = np.where((S > 0.0) & (variance > 0.0), np.maximum(1.0, S / variance), 1.0)
    settled = np.nonzero((2.0 * A if is_line else 4.0 * np.sqrt(A / np.pi)) <= L)[0]
    if settled.size:
        k = int(settled[0])
    else:
        side = max(good.shape) if is_line else min(good.shape)
        k = int(np.argmax(np.where(max(side / 4.0, 1.0) >= L, S, -np.inf)))
    C = np.where(counts & (square <= there[k]), c + S[k] * g, 0.0)
    weight = np.asarray(fft.rfft2(C)).real  # C(h) = C(-h): its spectrum is real
    weight[:, 1 : (shape[1] + 1) // 2] *= 2.0  # the half that a real transform leaves out
    M = (spectra * np.repeat(weight.reshape(-1), 2)) @ spectra.T / (shape[0] * shape[1])
    M = 0.5 * (M + M.T)
    low = np.diag(M) < 0.0
    M[low] = M[:, low] = 0.0
    reach = max(float(L[k]), 1.0)
    dof = N / reach if is_line else 2.0 * N / (np.pi * reach**2)
    return M, float(A[k]), float(dof)


# ---- part B --------------------------------------------------------------------------------------


def _next_to_the_model(
    x: FloatArray, y: FloatArray, J: FloatArray, r: FloatArray, *, is_line: bool
) -> tuple[FloatArray, int, bool]:
    """Return the covariance that the polynomials beside the model ask for, their number, and a flag.

    m_d is the mean square of the residual along the orthonormal polynomials of degree d, of which
    nothing lies in the model, continued to the degree o of each column of Q (8; `_continued`), from s^2
    to a bound by energy (`_held`); then cov = R^-1 diag(v) R^-T (9). The flag says that the bound was at work.
    """
    Q, R, r = _factors(J, r)
    N, p = Q.shape
    inverse = np.linalg.inv(R)
    s2 = float(r @ r) / (N - p)
    order, top = _orders(Q, x, y, is_line=is_line)
    u, v = _unit(x), _unit(y)
    Pu, Pv = values(u, top), None if is_line else values(v, top)
    basis = Q
    degrees: list[float] = []
    powers: list[float] = []
    numbers: list[int] = []
    for d in range(1, top + 1):
        block = _degree(Pu, Pv, d)
        size = _sizes(block)
        for _ in range(2):  # twice, or the digits go
            block = block - basis @ (basis.T @ block)
        new, found, _ = np.linalg.svd(block / size, full_matrices=False)
        new = new[:, found > _NOTHING]
        if new.shape[1] == 0 or basis.shape[1] + new.shape[1] > N:
            continue
        basis = np.hstack([basis, new])
        degrees.append(d)
        numbers.append(new.shape[1])
        powers.append(float(np.mean(np.square(new.T @ r))))
    level, bounded = np.full(p, s2), False
    n_functions = int(sum(numbers))
    if is_line:  # neighbouring pairs, of which the logarithm has a known mean
        degrees, powers, numbers = degrees[:8], powers[:8], numbers[:8]
        n_functions = len(degrees)
        few = len(degrees) // 2 * 2
        degrees = np.sqrt(np.multiply(degrees[:few:2], degrees[1:few:2])).tolist()
        powers = (0.5 * np.exp(_PSI) * np.add(powers[:few:2], powers[1:few:2])).tolist()
        numbers = [1] * len(degrees)
    usable = [i for i, m in enumerate(powers) if m > 0.0]
    if usable:
        logs = np.log([powers[i] for i in usable])
        w = np.array([numbers[i] for i in usable], dtype=np.float64)
        at = np.array([degrees[i] for i in usable])
        known = ~np.isnan(order)
        law = np.exp(np.minimum(_continued(at, logs, w, order[known], is_line=is_line), 300.0))
        level[known], bounded = _held(law, order[known], s2, float(r @ r))
    return np.asarray((inverse * level) @ inverse.T), n_functions, bounded


def _continued(
    degrees: FloatArray, logs: FloatArray, weights: FloatArray, order: FloatArray, *, is_line: bool
) -> FloatArray:
    """Return the logarithm of the power at the orders of a model, from that at the degrees beside it.

    A surface of spectrum f^-B has log m = a - B log d. Of deviations that are smooth over a part of the
    map no power law is true: what is analytic falls as the d-th power of a number (Bernstein), so
    log m = a - c d. That law is taken where a power law would be steeper than any surface's, by more
    than chance makes of so few functions.
    """

    def line(x: FloatArray) -> tuple[float, float, float, float]:
        middle, mean = np.average(x, weights=weights), np.average(logs, weights=weights)
        spread = float(weights @ np.square(x - middle))
        fall = (
            max(-float(weights @ ((x - middle) * (logs - mean))) / spread, 0.0) if spread else 0.0
        )
        return float(middle), float(mean), fall, spread

    middle, mean, fall, spread = line(np.log(degrees))
    # The logarithm of a mean of n squares has the variance 2 / n, of a mean of two pi^2 / 6.
    variance = np.pi**2 / 6.0 if is_line else 2.0
    if spread and fall - _BY_CHANCE * np.sqrt(variance / spread) > _STEEPEST:
        middle, mean, fall, _ = line(degrees)
        return np.asarray(mean - fall * (order - middle))
    return np.asarray(mean - fall * (np.log(np.maximum(order, _LEAST_ORDER)) - middle))


def _held(law: FloatArray, order: FloatArray, s2: float, left: float) -> tuple[FloatArray, bool]:
    """Return the variances of columns after a law of their order, bounded by energy; whether it was.

    A long smooth wave falls faster than any power law, which would give a tilt of a waviness of 1 um
    an uncertainty of 40 um. So no column holds more than all that a fit without the columns of its
    own and of lower order would have left: the sum of squares `left`, and what the columns of higher
    order took. With few columns that is about `left`; with many it grows towards low orders, where a
    smooth deviation has its energy.
    """
    held, bounded = np.empty(law.size), False
    for o in np.unique(order)[::-1]:
        here = order == o
        bounded = bounded or bool(o > 0.0 and (law[here] > left).any())
        held[here] = np.clip(law[here], s2, left)
        left += float(held[here].sum())
    return held, bounded


def _orders(
    Q: FloatArray, x: FloatArray, y: FloatArray, *, is_line: bool
) -> tuple[FloatArray, int]:
    """Return the degree of each column, at which polynomials hold half of it, and the last degree.

    NaN for a column that is not a low polynomial, such as a wave: part A is all it gets.
    """
    top = _LOWEST if not is_line else _LOWEST + 3
    while True:
        Pu, Pv = values(_unit(x), top), None if is_line else values(_unit(y), top)
        held = np.zeros((top + 1, Q.shape[1]))
        basis = np.empty((Q.shape[0], 0))
        for d in range(top + 1):
            block = _degree(Pu, Pv, d)
            block = block / _sizes(block)
            for _ in range(2):
                block = block - basis @ (basis.T @ block)
            new, size, _ = np.linalg.svd(block, full_matrices=False)
            new = new[:, size > _NOTHING]
            held[d] = np.square(new.T @ Q).sum(axis=0)
            basis = np.hstack([basis, new])
        reached = np.cumsum(held, axis=0) >= 0.5
        order = np.where(reached.any(axis=0), np.argmax(reached, axis=0), np.nan)
        least = np.nanmax(order, initial=0.0) + (8 if is_line else _MORE)
        wanted = max(top, int(least)) if not np.isnan(order).any() else top + _MORE
        if min(wanted, _MOST) <= top or basis.shape[1] >= Q.shape[0]:
            return order, top
        top = min(wanted, _MOST)


def _sizes(block: FloatArray) -> FloatArray:
    """Return the norm of each column; 1 of one that is zero, as on a map that is one block high."""
    size = np.sqrt(np.einsum("ij,ij->j", block, block))
    return np.where(size > 0.0, size, 1.0)


def _unit(x: FloatArray) -> FloatArray:
    low, high = float(x.min()), float(x.max())
    return (x - 0.5 * (low + high)) / (0.5 * (high - low) or 1.0)


def _degree(Pu: FloatArray, Pv: FloatArray | None, d: int) -> FloatArray:
    """Return the Legendre products of a total degree, shape (n, number)."""
    if Pv is None:
        return np.asarray(Pu[d][:, None])
    return np.stack([Pu[i] * Pv[d - i] for i in range(d + 1)], axis=1)
