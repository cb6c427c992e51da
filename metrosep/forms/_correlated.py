"""Uncertainty of a fit whose deviations hang together from pixel to pixel.

With N points, J the derivatives at the solution, J = Q R, and C the covariance of the deviations::

    cov(a) = R^-1 (Q' C Q) R^-T                                                          (1)

White deviations give the textbook's s^2 (J'J)^-1, which is right for nothing that is machined. Two
estimates of C are made from the residual. Part A is its autocovariance, corrected for the low
frequencies that the fit took out. Part B asks the polynomials next to the model which spectra are
likely, and what each does to the parameters, since real surfaces have more power there than a short
correlation can hold. On maps B counts, and the larger of two noisy numbers would only be wider: A gives
the area that hangs together. On a line, which has few polynomials, where the model holds what is not a
polynomial, and where the deviations have a lay, the larger expanded uncertainty counts. An error that has the shape of a
parameter (a wrong reference sphere) is in neither. Sources: metrology-2, chapter 1; sandwich covariance after Newey
and West (1987), window after Sokal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import BoolArray, FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.limits import COVERAGE
from metrosep.forms._orthogonal import values
from metrosep.forms._waves import (
    NARROW,
    angle_across,
    likely_spectra,
    narrowness,
    under_waves,
    with_short_ones,
)
from metrosep.forms.points import Points

Linearise = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""From x, y, z of points to derivatives and deviations, shape (p + 1, n)."""

_SIDE, _SIDE_B, _LINE = 400, 48, 4000
"""Pixels along a map (part B: its polynomials are smooth) and along a profile; more are averaged in
blocks. u changes by less than 1.5 % (metrology-2, 1.4)."""
_FEW = 8
"""Blocks across a map are left at least, or as many as it has rows: a tilt across needs them."""
_VALUES = 4_000_000
"""Of all columns together: with many parameters the blocks are larger."""
_PAIRS = 0.02
"""Lags with a smaller share of pairs do not count."""
_LEAST_LEFT = 0.05
"""Of the sum (4): below it the fit took nearly all of what the lags hold."""
_LOWEST, _MORE, _MOST = 7, 5, 25
"""Degrees of the polynomials next to the model; from the model's, at most."""
_BEYOND, _EACH = (2, 4, 7, 10, 13), 6
"""Degrees above these of which some polynomials say where a spectrum that is flat begins to fall."""
_TIED = 1e-13
"""Of a column: what is left of it beside the columns before it is rounding below this."""
_SETTLED = 1e-7
"""A half width is found where Newton's step changes it by less than this share: its square is rounding."""
_ROUNDING = 16.0 * float(np.finfo(float).eps)
"""Of the largest height: a smaller residual is rounding."""
_NOTHING = 0.02
"""Of a polynomial: if less is left of it beside the model, it is the rounding of a block's edge."""
_NOISE = np.concatenate([np.geomspace(1e-13, 1e-8, 11)[:-1], np.geomspace(1e-8, 10.0, 19)])
"""White noise below a spectrum, over the mean power that this has along the polynomials. Smooth deviations
have less than 1e-8 of it in the last degrees: with no quieter noise their scale came out half as large."""
_NOISE_ODDS = np.repeat([0.1 / 20.0, 1.0 / 20.0], [10, 19])
"""The ten quietest, which few instruments have, share the odds of one of the others."""
_LAY = 1.0 / 8.0
"""Odds of a lay: its angle is taken from the residual, and eight can be distinguished on the lowest ring."""
_HELD = 2
"""Order of the parameters that are bounded by energy: piston, tilts, curvatures."""
PROVEN = 0.95
"""Probability with which a verdict holds (ISO 14253-1): the rest is the share of false accepts."""
_RARE = 1e-4
"""Of all odds: spectra that have no more together change no digit of u."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """What the residual says about the parameters: covariance (p, p), NaN where it says nothing."""

    cov: FloatArray
    dof: float
    n_effective: float
    length: float
    bounded: bool = False  # u of some parameters is a bound by the energy of the residual
    lay: float = 1.0  # of a narrow map: slopes across it over those along it
    guard: FloatArray | float = 1.0  # what a verdict needs over t_0.95 u, (p,)


def student(dof: float, share: float) -> float:
    """Return the quantile of Student's distribution, NaN without degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(dof, share)) if dof > 0.0 else float("nan")


def expanding_factor(dof: float) -> float:
    """Return k of every expanded uncertainty, t((1 + p)/2; dof): 2 for a normal one; NaN without freedom."""
    return student(dof, 0.5 + 0.5 * COVERAGE)


def estimated(points: Points, linearise: Linearise, residual: FloatArray, p: int) -> Estimate:
    """Return the covariance of p parameters from what a fit left, m, shape of the points' z."""
    if (
        np.ptp(points.x) == 0.0 and np.ptp(points.y) > 0.0
    ):  # a line along y is a line: the rest looks for one along x
        turn = not points.is_scattered
        points = Points(
            points.y,
            points.x,
            points.z.T if turn else points.z,
            points.centre,
            points.is_scattered,
        )
        residual = residual.T if turn else residual
        return estimated(points, lambda x, y, z: linearise(y, x, z), residual, p)
    with one_blas_thread(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if points.is_scattered:
            return _scattered(points, linearise, residual, p)
        is_line = points.z.shape[0] == 1
        limit = _LINE if is_line else min(_SIDE, max(int(np.sqrt(_VALUES / p)), 64))
        b_y, b_x = _sides(points.z.shape, -(-max(points.z.shape) // limit))
        x, y, J, r = _means(points, linearise, residual, p, b_y, b_x)
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
        here = whole = good
        b = -(-max(r.shape) // _SIDE_B)
        lay = 1.0
        guard: FloatArray | float = 1.0
        if not is_line and narrowness(x[good], y[good]) < NARROW:  # as many blocks as a square has
            b = min(b, int(np.ceil(np.sqrt(N) / _SIDE_B)))
            lay = _across_over_along(points, residual)
        if not is_line and b > 1:
            few = _blocks(x, y, J, r, b, b)
            within = ~np.isnan(few[3])
            if _is_of_full_rank(few[2][:, within]):  # a narrow groove may be lost in the blocks
                whole = _total(good, b, b) == _total(np.ones(r.shape), b, b)
                (x, y, J, r), here = few, within
        found = _next_to_the_model(
            x[here], y[here], J[:, here], r[here], whole[here], is_line=is_line
        )
        dof_b = max(1.0, float(found.n))
        if found.is_known and not is_line:
            _, area, dof_a = _lags(rest, good, found.Q, here, is_line=False)
            cov, dof, guard = found.cov, dof_b, found.guard
            if found.is_bounded:  # by one sum of squares of deviations that are long
                dof = min(dof_b, max(dof_a, 1.0))
        else:
            M, area, dof_a = _lags(rest, good, Q, good, is_line=is_line)
            if found.is_bounded:
                dof_b = min(dof_b, max(dof_a, 1.0))
            inverse = np.linalg.inv(R)
            cov, dof = _larger(
                inverse @ M @ inverse.T, dof_a, found.cov, dof_b, inverse @ inverse.T
            )
        n_effective = N / area
        if n_effective < 2 * p:
            return _unknown(p, n_effective)
        length = 0.5 * b_x * area if is_line else np.sqrt(b_y * b_x * area / np.pi)
        return Estimate(
            cov * level**2, dof, n_effective, float(length), found.is_bounded, lay, guard
        )


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
    N = r.size
    if p >= N:
        return _unknown(p, N)
    J = linearise(x, y, points.z[0][good])[:p]
    if _LINE < N:
        x, y, J, r = _cells(x, y, J, r)
        if p >= r.size:
            return _unknown(p, N)
    found = _next_to_the_model(x, y, J, r, np.ones(r.size, bool), is_line=float(np.ptp(y)) == 0.0)
    dof = max(1.0, float(found.n))
    return Estimate(found.cov, dof, float(N), np.nan, found.is_bounded, guard=found.guard)


def _cells(
    x: FloatArray, y: FloatArray, J: FloatArray, r: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return means over the cells of a grid: a long list is thinned as a map is."""
    n = _SIDE_B if np.ptp(y) else _LINE
    i, j = (
        np.minimum((n * (v - v.min()) / (np.ptp(v) or 1.0)).astype(np.intp), n - 1) for v in (x, y)
    )
    _, cell, number = np.unique(i * n + j, return_inverse=True, return_counts=True)

    def mean(v: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, v) / number)

    return mean(x), mean(y), np.stack([mean(column) for column in J]), mean(r)


def _larger(
    by_a: FloatArray, dof_a: float, by_b: FloatArray, dof_b: float, white: FloatArray
) -> tuple[FloatArray, float]:
    """Return the larger of two expanded uncertainties as a covariance, and its degrees of freedom.

    The correlations are those of part A; of white noise if that has none. The freedom is that of part B
    where it is the larger for some parameter: with fewer, a guard band t_0.95 u would be a smaller part
    of the same expanded uncertainty.
    """
    dof_a, dof_b = max(1.0, dof_a), max(1.0, dof_b)
    a, b = (np.sqrt(np.maximum(np.diag(v), 0.0)) for v in (by_a, by_b))
    k_a, k_b = (expanding_factor(v) for v in (dof_a, dof_b))
    dof = dof_b if (k_b * b >= k_a * a).any() else dof_a
    own = by_a if (a > 0.0).all() else white
    size = np.sqrt(np.diag(own))
    u = np.fmax(k_a * a, k_b * b) / expanding_factor(dof)
    return np.asarray(own / np.outer(size, size) * np.outer(u, u)), dof


def _factors(J: FloatArray, r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Q (n, p) and R of the derivatives (p, n), and what Q leaves of the residual."""
    length = np.sqrt(np.einsum("ij,ij->i", J, J))
    length = np.where(length > 0.0, length, 1.0)
    Q, R = np.linalg.qr((J / length[:, None]).T)
    return Q, R * length, r - Q @ (Q.T @ r)


def _is_of_full_rank(J: FloatArray) -> bool:
    """Return whether the derivatives (p, n) can be distinguished at these points."""
    if J.shape[0] >= J.shape[1]:
        return False
    R = _factors(J, np.zeros(J.shape[1]))[1]
    return bool((np.abs(np.diag(R)) > _TIED * np.linalg.norm(R, axis=0)).all())


def _means(
    points: Points, linearise: Linearise, residual: FloatArray, p: int, b_y: int, b_x: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return x, y, derivatives (p, ., .) and residual as means over b_y x b_x points.

    NaN in the residual where less than half of a block is valid. The mean of the derivatives is that
    of Gauss' two points along each side, exact for what is cubic in a block, at a cost of 4 / (b_y b_x).
    """
    n_y, n_x = points.z.shape
    rows, columns = _two_of_each(n_y, b_y), _two_of_each(n_x, b_x)
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
    x, y, J, r = _blocks(x, y, J, r, min(b_y, 2), min(b_x, 2), least=0.25)
    if max(b_y, b_x) > 2:
        r = np.where(np.isnan(r), np.nan, _mean_heights(residual, b_y, b_x))
    return x, y, J, r


def _sides(shape: tuple[int, ...], b: int) -> tuple[int, int]:
    """Return rows and columns of a block: squares of b, less across a map that has only a few rows."""
    rows, columns = (min(b, max(1, n // _FEW)) for n in shape)
    return rows, columns


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


def _across_over_along(points: Points, residual: FloatArray) -> float:
    """Return the RMS slope across a narrow map over that along it, of neighbours on its grid; 1 without any."""
    steps = [
        np.diff(v)[None, :] if k else np.diff(v)[:, None]
        for k, v in enumerate((points.y, points.x))
    ]
    slopes = [np.diff(residual, axis=k) / step for k, step in enumerate(steps)]
    squares = [float(np.nanmean(s * s)) if np.isfinite(s).any() else 0.0 for s in slopes]
    rows, columns = np.nonzero(~np.isnan(residual))
    if np.ptp(points.y[rows]) > np.ptp(points.x[columns]):
        squares.reverse()
    return float(np.sqrt(squares[0] / squares[1])) if min(squares) > 0.0 else 1.0


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
    r: FloatArray, good: BoolArray, Q: FloatArray, here: BoolArray, *, is_line: bool
) -> tuple[FloatArray, float, float]:
    """Return Q' C Q from the autocovariance, the correlated area in pixels, degrees of freedom.

    With c(h) and g(h) the lagged products of the residual and of the columns of Q, over the number
    of pairs n(h): the fit lowers c by S g, so that the sum over |h| <= L is
    S = sum c / (1 - sum g) (4), the area A = S / (c(0) + S g(0)) (5), and L the smallest with
    L >= 4 sqrt(A / pi) (6), on a profile L >= 2 A. Q may be that of the blocks `here` of the map: its
    columns are smooth, and the sum of g over a disc is that over as many lags. Q' C Q is then empty.
    """
    c, pairs, far, _ = _lagged(r[:, None], good, is_line=is_line)
    counts = pairs >= max(_PAIRS * r.size, 1.0)
    at = far[counts]
    number = np.bincount(at)
    there = np.nonzero(number)[0]
    there = there[there >= 1]
    if there.size == 0:
        there = np.zeros(1, dtype=np.intp)
    g, pairs_g, far_g, spectra = _lagged(Q, here, is_line=is_line)
    counts_g = pairs_g >= max(_PAIRS * Q.shape[0], 1.0)
    at_g = far_g[counts_g]
    share = here.size / good.size
    lags = np.concatenate([[0.0], np.cumsum(np.bincount(at_g))])
    of_g = np.concatenate([[0.0], np.cumsum(np.bincount(at_g, g[counts_g]))])
    held = np.interp(share * np.cumsum(number)[there], lags, of_g)
    L = there.astype(np.float64) if is_line else np.sqrt(there)
    S = np.cumsum(np.bincount(at, c[counts]))[there] / np.maximum(1.0 - held, _LEAST_LEFT)
    variance = c[0, 0] + S * Q.shape[1] / r.size
    A = np.where((S > 0.0) & (variance > 0.0), np.maximum(1.0, S / variance), 1.0)
    settled = np.nonzero((2.0 * A if is_line else 4.0 * np.sqrt(A / np.pi)) <= L)[0]
    if settled.size:
        k = int(settled[0])
    else:
        side = max(good.shape) if is_line else min(good.shape)
        k = int(np.argmax(np.where(max(side / 4.0, 1.0) >= L, S, -np.inf)))
    reach = max(float(L[k]), 1.0)
    dof = r.size / reach if is_line else 2.0 * r.size / (np.pi * reach**2)
    M = np.empty((0, 0))
    if here is good:
        C = np.where(counts & (far <= there[k]), c + S[k] * g, 0.0)
        M = _under(C, spectra)
    return M, float(A[k]), float(dof)


def _lagged(
    columns: FloatArray, good: BoolArray, *, is_line: bool
) -> tuple[FloatArray, FloatArray, NDArray[np.intp], FloatArray]:
    """Return lagged products of columns (n, p), summed, over the pairs; these, lags, spectra.

    The lags of a line are in steps, those of a map squared: whole numbers, of which few are missing.
    """
    from scipy import fft

    shape = tuple(fft.next_fast_len(2 * n - 1, real=True) for n in good.shape)

    def image(v: FloatArray | float) -> FloatArray:
        full = np.zeros(good.shape)
        full[good] = v
        return np.asarray(fft.rfft2(full, shape))

    n_f = shape[0] * (shape[1] // 2 + 1)
    spectra = np.empty((columns.shape[1], 2 * n_f))  # real and imaginary parts side by side
    for row, q in zip(spectra, columns.T, strict=True):
        row[:] = image(q).reshape(-1).view(np.float64)
    pairs = np.rint(fft.irfft2(np.square(np.abs(image(1.0))), shape))
    energy = np.einsum("ij,ij->j", spectra, spectra).reshape(shape[0], -1, 2).sum(axis=2)
    i, j = (np.rint(fft.fftfreq(n) * n).astype(np.intp) for n in shape)
    products = np.asarray(fft.irfft2(energy, shape)) / np.maximum(pairs, 1.0)
    far = np.abs(j)[None, :] if is_line else i[:, None] ** 2 + j[None, :] ** 2
    return products, pairs, far, spectra


def _under(C: FloatArray, spectra: FloatArray) -> FloatArray:
    """Return Q' C Q from a covariance against lag and the spectra of the columns of Q."""
    from scipy import fft

    weight = np.asarray(fft.rfft2(C)).real  # C(h) = C(-h): its spectrum is real
    weight[:, 1 : (C.shape[1] + 1) // 2] *= 2.0  # the half that a real transform leaves out
    M = (spectra * np.repeat(weight.reshape(-1), 2)) @ spectra.T / C.size
    M = 0.5 * (M + M.T)
    low = np.diag(M) < 0.0
    M[low] = M[:, low] = 0.0
    return np.asarray(M)


# ---- part B --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """What the polynomials beside the model say: covariance (p, p), their number, Q of the model (., p)."""

    cov: FloatArray
    n: int
    Q: FloatArray
    is_known: bool  # by enough: the model is of polynomials on a map, and no lay is likely
    guard: FloatArray | float = 1.0  # as in `Estimate`
    is_bounded: bool = False  # a bound by energy is at work


def _next_to_the_model(
    x: FloatArray, y: FloatArray, J: FloatArray, r: FloatArray, whole: BoolArray, *, is_line: bool
) -> _Beside:
    """Return the covariance that the polynomials beside the model ask for.

    t = F' r is the residual along orthonormal polynomials F of which nothing lies in the model. No fit
    changes them, so that they are normal with the covariance F' C F (restricted likelihood). F is 0 where
    a block is not `whole`: its mean departs from the height at its middle, by little, but by more than
    smooth deviations have in the last degrees. C is white as far as the residual reaches, a short
    correlation, one of a length on the map or a spectrum that rises beyond it (`likely_spectra`), the last
    three with white noise below them, alike in all directions, all with equal odds; or a lay (`_LAY`). With the scale of each integrated out, the residual gives every
    C a weight and every parameter a Student distribution. u is such that the mixture of these holds
    COVERAGE within t(n) u. No parameter gets more than a bound by energy (`_bound`).

    Whether a spectrum rises beyond the map or levels off on it, a map hardly says, and what holds of both
    together holds too little of the one and too much of the other; how far one rises, it does not say at all.
    A verdict has to be true of each: its guard band is that of the spectra that rise furthest, unless the
    rising ones have smaller odds than a false accept may have.
    """
    Q, R, r = _factors(J, r)
    N, p = Q.shape
    inverse = np.asarray(np.linalg.inv(R), dtype=np.float64)
    white = inverse @ inverse.T
    size = float(np.sqrt(r @ r / N))
    r = r / (size or 1.0)
    if 2 * whole.sum() < N or not _is_of_full_rank(J[:, whole]):
        whole = np.ones(N, bool)
    own = _kept_surroundings(x.tobytes(), y.tobytes(), Q.tobytes(), whole.tobytes(), p, is_line)
    order, F, n = own.order, own.F, own.F.shape[1]
    t = F.T @ r
    if n == 0 or not float(t @ t) > _ROUNDING**2 * N:  # it says nothing
        return _Beside(white * (size**2 * float(r @ r) / (N - p)), n, Q, False)
    rest = r if whole.all() else _factors(J[:, whole], r[whole])[2]
    found = _white(t, float(rest @ rest), rest.size - p, white)
    if not is_line:  # short correlations have spectra
        found = found[-1:]
    coloured, kinds = _coloured(own.grams, t, inverse, own.odds)
    found += coloured
    alike = len(found)
    beyond = np.zeros(alike)
    beyond[alike - len(kinds) :] = own.beyond[kinds]
    if not is_line:
        across = angle_across(x, y, r, own.last)
        f, G = under_waves(x, y, np.column_stack([Q, F]), own.last, angle=across)
        S, odds, _ = likely_spectra(f, n_smooth=16)
        found += _coloured(_under_spectra(S, G, p), t, inverse, _LAY / odds.sum() * odds)[0]
    logs = np.array([v for v, _, _ in found])
    kept, weights = _likely(logs)
    covs = np.stack([found[k][2] for k in kept])
    mean = np.tensordot(weights, covs, 1)
    freedom = np.array([found[k][1] for k in kept])
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    u = _half_width(weights, sd, freedom, COVERAGE) / expanding_factor(n)
    s2 = float(r @ r) / (N - p)
    u = np.maximum(u, np.sqrt(s2 * np.diag(white)))  # a lay may leave a parameter nothing
    wider = np.max(u * u / np.diag(mean))  # the tails of the mixture
    most = _bound(np.diag(R @ mean @ R.T) * wider, order, s2, float(r @ r))
    limit = np.sqrt(np.square(inverse) @ most)
    held = np.minimum(u, limit)
    guard = np.ones(p)
    reach = np.append(beyond, np.zeros(len(logs) - alike))[kept]
    if weights[reach > 0.0].sum() > 1.0 - PROVEN:
        far = reach == reach.max()
        own_weights = weights[far] / weights[far].sum()
        band = _half_width(own_weights, sd[far], freedom[far], 2.0 * PROVEN - 1.0)
        guard = np.maximum(1.0, np.minimum(band / student(n, PROVEN), limit) / held)
    scale = size * held / np.sqrt(np.diag(mean))
    # a lay is seldom as straight and as long as its spectrum has it
    is_known = not is_line and not np.isnan(order).any()
    is_known = is_known and bool(weights[kept < alike].sum() > 0.5)
    bounded = bool((held < u)[1:].any())
    return _Beside(mean * np.outer(scale, scale), n, Q, is_known, guard, bounded)


@dataclass(frozen=True, slots=True, eq=False)
class _Surroundings:
    """What part B asks of the places and the model, whatever the residual is."""

    order: FloatArray  # of each column of the model, NaN if it is not a polynomial
    last: int  # degree of the polynomials beside it
    F: FloatArray  # these, (., n)
    grams: tuple[FloatArray, FloatArray]  # under each spectrum that is alike in all directions
    odds: FloatArray  # of each
    beyond: FloatArray  # widths beyond the map up to which each rises


@lru_cache(maxsize=2)
def _kept_surroundings(
    x: bytes, y: bytes, Q: bytes, whole: bytes, p: int, is_line: bool
) -> _Surroundings:
    """Return the surroundings of a model; the maps of a batch mostly have the same places and model."""
    at_x, at_y = np.frombuffer(x), np.frombuffer(y)
    columns = np.frombuffer(Q).reshape(-1, p)
    order, top = _orders(columns, at_x, at_y, is_line=is_line)
    there = np.frombuffer(whole, dtype=bool)
    beside = _beside(
        _factors(columns[there].T, at_x[there])[0], at_x[there], at_y[there], top, is_line=is_line
    )
    F = np.zeros((at_x.size, beside.shape[1]))
    F[there] = beside
    if F.shape[1] == 0:
        return _Surroundings(order, top, F, (F, F), order, order)
    last = top if is_line else top + _BEYOND[-1]
    B = np.column_stack([columns, F])
    f, G = under_waves(at_x, at_y, B, last, angle=0.0 if is_line else None)
    S, odds, beyond = likely_spectra(f) if is_line else with_short_ones(f)
    return _Surroundings(order, last, F, _under_spectra(S, G, p), odds, beyond)


def _white(
    t: FloatArray, energy: float, freedom: int, white: FloatArray
) -> list[tuple[float, float, FloatArray]]:
    """Return log odds, degrees of freedom and covariance of two kinds of white deviations.

    Those that are white as far as the residual reaches have one level along the polynomials, a = t' t,
    and in the m other directions, b. Those that are flat along the polynomials only (a short correlation)
    have two, and the second may lie anywhere within nine decades, as under every spectrum. With
    the levels integrated out the first has the odds
    G((n + m)/2) (a + b)^-((n + m)/2) : G(n/2) a^(-n/2) G(m/2) b^(-m/2) / log range.
    """
    from scipy.special import gammaln

    n, a = t.size, float(t @ t)
    m, b = freedom - n, max(energy - a, 0.0)
    found = [(-0.5 * n * np.log(a), float(n), white * (a / n))]
    if m > 0 and b > 0.0:
        log = gammaln(0.5 * (n + m)) - gammaln(0.5 * n) - gammaln(0.5 * m)
        log += 0.5 * m * np.log(b) - 0.5 * (n + m) * np.log(a + b)
        log += np.log(9.0 * np.log(10.0))
        found.append((float(log), float(n + m), white * ((a + b) / (n + m))))
    return found


def _likely(logs: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the places of those that hold all odds but `_RARE`, and their weights, which sum to 1."""
    weights = np.exp(logs - logs.max())
    rank = np.argsort(weights)
    held = np.cumsum(weights[rank])
    kept = rank[held > _RARE * held[-1]]
    return kept, weights[kept] / weights[kept].sum()


def _under_spectra(S: FloatArray, G: FloatArray, p: int) -> tuple[FloatArray, FloatArray]:
    """Return Q' C Q (., p, p) and F' C F (., n, n) of spectra, of which the second has mean power 1."""
    n = G.shape[1] - p
    own, beside = (
        (S @ part.reshape(S.shape[1], -1)).reshape(-1, m, m)
        for part, m in ((G[:, :p, :p], p), (G[:, p:, p:], n))
    )
    power = np.trace(beside, axis1=1, axis2=2)[:, None, None] / n
    return own / power, beside / power


def _coloured(
    grams: tuple[FloatArray, FloatArray], t: FloatArray, inverse: FloatArray, odds: FloatArray
) -> tuple[list[tuple[float, float, FloatArray]], NDArray[np.intp]]:
    """Return log odds, degrees of freedom and covariance under likely spectra and levels of noise, and which."""
    own, beside = grams
    n = t.size
    volume, left = _over_noise(beside, t)
    logs = -0.5 * volume - 0.5 * n * np.log(left)
    logs += np.log(odds)[:, None] + np.log(_NOISE_ODDS)
    white = inverse @ inverse.T
    c, k = np.unravel_index(_likely(logs.ravel())[0], logs.shape)
    used, at = np.unique(c, return_inverse=True)
    shapes = inverse @ own[used] @ inverse.T
    covs = (shapes[at] + _NOISE[k, None, None] * white) * (left[c, k] / n)[:, None, None]
    return [(float(log), float(n), cov) for log, cov in zip(logs[c, k], covs, strict=True)], c


def _over_noise(C: FloatArray, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log det(C + v) and t' (C + v)^-1 t for each matrix of C, (m, n, n), and v of `_NOISE`.

    Householder's reflections turn C, with t as another row before it, into a tridiagonal matrix on the
    first axis of which t lies: of C + v the corner of the inverse and the determinant are then n steps
    of a continued fraction. A fifth of the work of all eigenvectors.
    """
    from scipy.linalg import lapack

    n = t.size
    size = float(np.linalg.norm(t))
    d, square = np.empty((C.shape[0], n)), np.empty((C.shape[0], n))
    bordered = np.zeros((n + 1, n + 1), order="F")
    bordered[1:, 0] = t / size
    for k, matrix in enumerate(C):
        bordered[1:, 1:] = matrix
        _, diagonal, beside, _, _ = lapack.dsytrd(bordered, lower=1)
        d[k], square[k] = diagonal[1:], beside**2
    step = d[:, -1, None] + _NOISE
    volume = np.log(step)
    for i in range(n - 1, 0, -1):
        step = d[:, i - 1, None] + _NOISE - square[:, i, None] / step
        volume += np.log(step)
    return volume, size**2 / step


def _bound(law: FloatArray, order: FloatArray, s2: float, left: float) -> FloatArray:
    """Return the most that each column may hold: all that a fit without it would have left.

    Of a wave of little more than a period no spectrum is the right one, and a steep one would give a
    tilt of a waviness of 1 um an uncertainty of 40 um. A fit without the columns of an order and of lower
    ones would have left the sum of squares `left`, and what the columns of higher order took. Beyond
    `_HELD` there is no bound: of deviations that are smooth each order holds many times what all above it
    do, and so do those that a wave gives to the last orders of a model that nearly follows it.
    """
    most = np.maximum(law, left)  # of a column that is not a polynomial: no bound
    for o in np.unique(order[~np.isnan(order)])[::-1]:
        here = order == o
        most[here] = max(left, s2)
        if o > _HELD:
            most[here] = np.maximum(most[here], law[here])
        left += float(np.clip(law[here], s2, most[here]).sum())
    return most


def _half_width(
    weights: FloatArray, sd: FloatArray, freedom: FloatArray, share: float
) -> FloatArray:
    """Return what holds a share of a mixture of Student distributions with these deviations (k, p).

    What an interval holds rises with its half width and bends down: Newton's steps never pass the answer
    from below, come back below it from above, and double its digits at the end.
    """
    from scipy.special import gammaln, stdtr

    nu, most = freedom[:, None], sd.max(axis=0)
    sd = np.maximum(sd, np.maximum(1e-100 * most, np.finfo(np.float64).tiny))
    peak = np.exp(gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu)) / np.sqrt(np.pi * nu)
    half = student(float(freedom.max()), 0.5 + 0.5 * share) * np.sqrt(weights @ np.square(sd))
    for _ in range(50):
        t = half / sd
        held = weights @ (2.0 * stdtr(nu, t) - 1.0)
        rise = weights @ (2.0 * peak * (1.0 + t * t / nu) ** (-0.5 * (nu + 1.0)) / sd)
        step = np.maximum((share - held) / rise, -half)
        half = half + step
        if np.all(np.abs(step) <= _SETTLED * half):
            break
    return np.where(most > 0.0, half, 0.0)


def _beside(Q: FloatArray, x: FloatArray, y: FloatArray, top: int, *, is_line: bool) -> FloatArray:
    """Return orthonormal polynomials of which nothing lies in the model, shape (n, number).

    All up to a degree, and a few of some degrees beyond.
    """
    beyond = () if is_line else tuple(top + d for d in _BEYOND)
    last = beyond[-1] if beyond else top
    Pu, Pv = values(_unit(x), last), None if is_line else values(_unit(y), last)
    basis = Q
    for d in (*range(1, top + 1), *beyond):
        block = _degree(Pu, Pv, d)
        if d > top:
            block = block[:, np.unique(np.linspace(0, block.shape[1] - 1, _EACH).astype(np.intp))]
        size = np.sqrt(np.einsum("ij,ij->j", block, block))
        block = block / np.where(size > 0.0, size, 1.0)
        for _ in range(2):  # twice, or the digits go
            block = block - basis @ (basis.T @ block)
        new, found, _ = np.linalg.svd(block, full_matrices=False)
        new = new[:, found > _NOTHING]
        if basis.shape[1] + new.shape[1] > Q.shape[0]:
            break
        basis = np.hstack([basis, new])
    return np.asarray(basis[:, Q.shape[1] :])


def _orders(
    Q: FloatArray, x: FloatArray, y: FloatArray, *, is_line: bool
) -> tuple[FloatArray, int]:
    """Return the degree of each column, at which polynomials hold half of it, and the last degree.

    NaN for a column that is not a low polynomial, such as a wave.
    """
    top = _LOWEST if not is_line else _LOWEST + 3
    while True:
        Pu, Pv = values(_unit(x), top), None if is_line else values(_unit(y), top)
        held = np.zeros((top + 1, Q.shape[1]))
        basis = np.empty((Q.shape[0], 0))
        for d in range(top + 1):
            block = _degree(Pu, Pv, d)
            size = np.sqrt(np.einsum("ij,ij->j", block, block))
            block = block / np.where(size > 0.0, size, 1.0)  # of one row P1 and the like are 0
            for _ in range(2):
                block = block - basis @ (basis.T @ block)
            new, left, _ = np.linalg.svd(block, full_matrices=False)
            new = new[:, left > _NOTHING]
            held[d] = np.square(new.T @ Q).sum(axis=0)
            basis = np.hstack([basis, new])
        reached = np.cumsum(held, axis=0) >= 0.5
        order = np.where(reached.any(axis=0), np.argmax(reached, axis=0), np.nan)
        least = np.nanmax(order, initial=0.0) + (8 if is_line else _MORE)
        wanted = max(top, int(least)) if not np.isnan(order).any() else top + _MORE
        if min(wanted, _MOST) <= top or basis.shape[1] >= Q.shape[0]:
            return order, top
        top = min(wanted, _MOST)


def _unit(x: FloatArray) -> FloatArray:
    low, high = float(x.min()), float(x.max())
    return (x - 0.5 * (low + high)) / (0.5 * (high - low) or 1.0)


def _degree(Pu: FloatArray, Pv: FloatArray | None, d: int) -> FloatArray:
    """Return the Legendre products of a total degree, shape (n, number)."""
    if Pv is None:
        return np.asarray(Pu[d][:, None])
    return np.stack([Pu[i] * Pv[d - i] for i in range(d + 1)], axis=1)
