"""Private: weighted local polynomial regression with Gaussian weights, from moments by FFT.

At each grid point p the polynomial that minimises ``sum_j v_j g(q_j - p) (z_j - poly(q_j - p))^2``
is found from the moments ``S_e = sum_j v_j g s^e`` and ``T_e = sum_j v_j z_j g s^e``, where s are
offsets in standard deviations of the kernel and e exponents per axis. The constant stands last
among the unknowns, so elimination ends with the value at p and needs no back-substitution.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

Exponents = tuple[int, ...]

_HALF_WIDTH = 3.0
"""Window in units of a * cut-off: the kernel has fallen to exp(-9 pi) = 5e-13."""

_SUPPORT = 1e-6
"""Least weight of a value, 1 = a full window: without it nothing near the point was accepted."""

_PIVOT = 1e-5
"""Least pivot relative to its diagonal: below, the samples do not determine the slopes."""

_MEMORY = 4e8
"""Bytes that the moments of one strip of rows may take."""


@dataclass(frozen=True, slots=True)
class Kernel:
    """Gaussian weights on a grid.

    `scales` are steps in standard deviations, `order` the degree of the polynomial.
    """

    scales: tuple[float, ...]
    order: int

    @classmethod
    def of(
        cls, steps: tuple[float, ...], wavelengths: tuple[float, ...], a: float, order: int
    ) -> Kernel:
        """Return the kernel ``exp(-pi (x / (a Lc))^2)`` per axis."""
        ratio = np.sqrt(2.0 * np.pi) / a
        pairs = zip(steps, wavelengths, strict=True)
        return cls(tuple(float(ratio * s / w) for s, w in pairs), order)

    @property
    def half_widths(self) -> tuple[int, ...]:
        """Samples on each side of the centre, per axis."""
        return tuple(int(np.ceil(_HALF_WIDTH * np.sqrt(2.0 * np.pi) / s)) for s in self.scales)

    def unknowns(self) -> list[Exponents]:
        """Return the monomials of the polynomial, the constant last."""
        powers = itertools.product(range(self.order + 1), repeat=len(self.scales))
        return sorted((e for e in powers if sum(e) <= self.order), key=lambda e: (-sum(e), e))


def local_regression(z: FloatArray, weights: FloatArray, kernel: Kernel) -> FloatArray:
    """Return the regression value at each grid point; NaN where the samples do not determine it."""
    result = np.empty_like(z)
    halo = min(kernel.half_widths[0], z.shape[0])
    for rows in _strips(z.shape, halo, kernel):
        seen = slice(max(rows.start - halo, 0), min(rows.stop + halo, z.shape[0]))
        part = _regression(z[seen], weights[seen], kernel)
        result[rows] = part[rows.start - seen.start : rows.stop - seen.start]
    return result


def _strips(shape: tuple[int, ...], halo: int, kernel: Kernel) -> Iterator[slice]:
    terms = len(kernel.unknowns())
    per_row = 8.0 * (terms * (terms + 3) / 2 + 4) * np.prod(shape[1:])
    height = max(int(_MEMORY / per_row) - 2 * halo, 2 * halo, 64)
    for start in range(0, shape[0], height):
        yield slice(start, min(start + height, shape[0]))


def _regression(z: FloatArray, weights: FloatArray, kernel: Kernel) -> FloatArray:
    unknowns = kernel.unknowns()
    pairs = itertools.combinations_with_replacement(unknowns, 2)
    needed = {_add(a, b) for a, b in pairs}
    s = _moments(weights, sorted(needed), kernel)
    t = _moments(weights * z, unknowns, kernel)
    n = len(unknowns)
    matrix = {
        (i, j): s[_add(unknowns[i], unknowns[j])].copy() for i in range(n) for j in range(i, n)
    }
    right = [t[e] for e in unknowns]
    supported = np.ones(z.shape, dtype=bool)
    for k in range(n):
        floor = _SUPPORT if k == n - 1 else _PIVOT * s[_add(unknowns[k], unknowns[k])]
        supported &= matrix[k, k] > np.maximum(floor, 1e-15)
        matrix[k, k][~supported] = 1.0
        for i in range(k + 1, n):
            factor = matrix[k, i] / matrix[k, k]
            for j in range(i, n):
                matrix[i, j] -= factor * matrix[k, j]
            right[i] -= factor * right[k]
    value = right[-1] / matrix[n - 1, n - 1]
    value[~supported] = np.nan
    return value


def _moments(
    values: FloatArray, exponents: list[Exponents], kernel: Kernel
) -> dict[Exponents, FloatArray]:
    """Return ``sum_j values_j g s^e`` at each grid point for each e."""
    from scipy import fft

    halves = [min(h, n) for h, n in zip(kernel.half_widths, values.shape, strict=True)]
    lengths = [
        fft.next_fast_len(n + h, real=True) for n, h in zip(values.shape, halves, strict=True)
    ]
    spectrum = fft.rfftn(values, lengths)
    highest = max(max(e) for e in exponents)
    transfers = [
        [
            _transfer(length, half, scale, power, last=axis == values.ndim - 1)
            for power in range(highest + 1)
        ]
        for axis, (length, half, scale) in enumerate(
            zip(lengths, halves, kernel.scales, strict=True)
        )
    ]
    inside = tuple(slice(0, n) for n in values.shape)
    result = {}
    for e in exponents:
        product = spectrum * transfers[-1][e[-1]]
        if values.ndim == 2:
            product *= transfers[0][e[0]][:, np.newaxis]
        result[e] = np.ascontiguousarray(fft.irfftn(product, lengths, overwrite_x=True)[inside])
    return result


def _transfer(
    length: int, half: int, scale: float, power: int, *, last: bool
) -> NDArray[np.complex128]:
    """Return the DFT of the kernel ``g (-s)^power`` on a circle of `length`, sum of g = 1."""
    from scipy import fft

    offset = np.arange(-half, half + 1)
    s = scale * offset
    g = np.exp(-0.5 * s**2)
    g *= (-s) ** power / g.sum()
    circle = np.zeros(length)
    np.add.at(circle, offset % length, g)
    return np.asarray(fft.rfft(circle) if last else fft.fft(circle))


def _add(a: Exponents, b: Exponents) -> Exponents:
    return tuple(i + j for i, j in zip(a, b, strict=True))
