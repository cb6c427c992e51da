"""Private to separation: rows of a design filtered by an autoregressive model."""

from __future__ import annotations

import numpy as np

from metrosep.core._arrays import FloatArray

__all__ = ["whitened"]


_BLOCK = 128


def whitened(
    design: FloatArray, values: FloatArray, coefficients: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Filter rows by blocks of a banded Toeplitz matrix; rows that touch a NaN are dropped."""
    p = coefficients.size
    invalid = np.isnan(values)
    table = np.hstack([design, np.where(invalid, 0.0, values)[:, None]])
    n_out = values.size - p
    if p:
        taps = np.concatenate([-coefficients[::-1], [1.0]])
        band = np.zeros((_BLOCK, _BLOCK + p))
        for row in range(_BLOCK):
            band[row, row : row + p + 1] = taps
        out = np.empty((n_out, table.shape[1]))
        for first in range(0, n_out, _BLOCK):
            size = min(_BLOCK, n_out - first)
            np.matmul(
                band[:size, : size + p],
                table[first : first + size + p],
                out=out[first : first + size],
            )
    else:
        out = table
    if invalid.any():
        touched = np.convolve(invalid.astype(np.float64), np.ones(p + 1))[p : p + n_out] > 0.5
        out = out[~touched]
    return out[:, :-1], out[:, -1]
