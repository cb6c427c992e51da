"""Private: Gaussian of a profile with gaps, open (local regression) and closed (circular).

Open: with weights p = s(x_j - x) over the valid samples j, S_k = sum p u^k and T_k = sum p u^k z,
u = x_j - x, the line through the neighbourhood has at x the height
``(S_2 T_0 - S_1 T_1) / (S_2 S_0 - S_1^2)`` (moment criterion of order 1, ISO 16610-28);
order 0 gives ``T_0 / S_0``. All sums are convolutions by padded real transforms.

Closed: each harmonic k of the turn is multiplied by ``2^-(k / k_c)^2`` (ISO 16610-21).

A line (order 0 and closed: a constant) is taken out first and put back, so that tilt and offset
cost no digits.
"""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.filters._kernel import COMPLETE, SINGULAR, half_width, lattice_sum

_MIN_BLOCK = 8192
"""Shortest transform of a long profile, in samples."""

_BATCH = 65536
"""Samples that are transformed together."""

_TINY = 1e-30
"""Smallest weight that is divided by; such samples are reported as without support."""


def profile_gaussian(
    z: FloatArray, sd: float, *, order: int, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean line of an open profile; `sd` in samples.

    NaN where the support share is below `min_support` and, without `fill`, where `z` is.
    """
    line = _reference_line(z, order)
    valid = ~np.isnan(z)
    t = np.where(valid, z - line, 0.0)
    reach = half_width(sd)
    if valid.all() and z.size > 4 * reach:
        low = _correlate(t, sd, (0,))[0]
        for end in (slice(0, 2 * reach), slice(z.size - 2 * reach, z.size)):
            piece, share = _regression(np.ones(2 * reach), t[end], sd, order)
            inner = slice(0, reach) if end.start == 0 else slice(reach, 2 * reach)
            low[end][inner] = np.where(share >= min_support, piece, np.nan)[inner]
        return np.asarray(low + line)
    low, share = _regression(valid.astype(np.float64), t, sd, order)
    low += line
    low[share < min_support] = np.nan
    if not fill:
        low[~valid] = np.nan
    return low


def profile_support(z: FloatArray, sd: float) -> FloatArray:
    """Return the share of the weight that lies on valid samples, 0 to 1."""
    share = _correlate((~np.isnan(z)).astype(np.float64), sd, (0,))[0]
    return np.asarray(np.clip(share, 0.0, 1.0))


def closed_gaussian(
    z: FloatArray, harmonic: float, *, min_support: float, fill: bool
) -> FloatArray:
    """Return the mean line of a closed profile; half of harmonic number `harmonic` passes."""
    valid = ~np.isnan(z)
    offset = float(z[valid][0])
    low = _circular(np.where(valid, z - offset, 0.0), harmonic)
    if not valid.all():
        share = _circular(valid.astype(np.float64), harmonic)
        low /= np.maximum(share, _TINY)
        low[share < min_support] = np.nan
        if not fill:
            low[~valid] = np.nan
    return np.asarray(low + offset)


def closed_support(z: FloatArray, harmonic: float) -> FloatArray:
    """Return the share of the weight that lies on valid samples of a closed profile."""
    share = _circular((~np.isnan(z)).astype(np.float64), harmonic)
    return np.asarray(np.clip(share, 0.0, 1.0))


def _reference_line(z: FloatArray, order: int) -> FloatArray:
    index = np.flatnonzero(~np.isnan(z))
    level = float(z[index[0]])
    if order == 0:
        return np.full(z.size, level)
    u = index - index.mean()
    heights = z[index] - level
    spread = float(u @ u)
    slope = float(u @ heights) / spread if spread > 0.0 else 0.0
    middle = level + float(heights.mean())
    return np.asarray(middle + slope * (np.arange(z.size) - index.mean()))


def _regression(
    w: FloatArray, t: FloatArray, sd: float, order: int
) -> tuple[FloatArray, FloatArray]:
    """Return the local regression of t under the validity w, and the support share."""
    if order == 0:
        share = _correlate(w, sd, (0,))[0]
        return _correlate(t, sd, (0,))[0] / np.maximum(share, _TINY), share
    s0, s1, s2 = _correlate(w, sd, (0, 1, 2))
    t0, t1 = _correlate(t, sd, (0, 1))
    determinant = s2 * s0 - s1 * s1
    top = s2 * t0 - s1 * t1
    whole = s0 > COMPLETE
    plain = whole | (determinant <= SINGULAR * s0 * s0)
    np.copyto(top, t0, where=plain)
    np.copyto(determinant, np.maximum(s0, _TINY), where=plain)
    return top / determinant, s0


def _correlate(values: FloatArray, sd: float, moments: tuple[int, ...]) -> list[FloatArray]:
    """Return the sums of s(u) v^k values(x + u) over u, for each k, with v = u / sd.

    Overlapping blocks are transformed, a few at a time, so that they stay in the cache.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    n = values.size
    reach = min(half_width(sd), n - 1)
    length = int(next_fast_len(min(n + 2 * reach, max(_MIN_BLOCK, 8 * reach)), real=True))
    step = length - 2 * reach
    n_blocks = -(-n // step)
    padded = np.zeros(n_blocks * step + 2 * reach)
    padded[reach : reach + n] = values
    blocks = np.lib.stride_tricks.sliding_window_view(padded, length)[::step]
    kernels = [rfft(k) for k in _kernels(sd, reach, length, moments)]
    sums = [np.empty((n_blocks, step)) for _ in moments]
    batch = max(1, _BATCH // length)
    for start in range(0, n_blocks, batch):
        spectra = rfft(blocks[start : start + batch], axis=1)
        for total, kernel in zip(sums, kernels, strict=True):
            part = irfft(spectra * kernel, length, axis=1)
            total[start : start + batch] = part[:, reach : reach + step]
    return [total.ravel()[:n] for total in sums]


def _kernels(sd: float, reach: int, length: int, moments: tuple[int, ...]) -> list[FloatArray]:
    u = np.arange(-reach, reach + 1)
    v = u / sd
    weights = np.exp(-0.5 * v * v) / lattice_sum(sd)
    kernels = []
    for k in moments:
        kernel = np.zeros(length)
        kernel[-u] = weights * v**k  # a correlation is the convolution with the mirrored kernel
        kernels.append(kernel)
    return kernels


def _circular(values: FloatArray, harmonic: float) -> FloatArray:
    from scipy.fft import irfft, rfft

    order = np.arange(values.size // 2 + 1) / harmonic
    return np.asarray(irfft(rfft(values) * np.exp2(-order * order), values.size))
