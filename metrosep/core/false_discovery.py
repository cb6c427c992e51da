"""Which of many p-values are beyond chance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray

__all__ = ["benjamini_hochberg"]


def benjamini_hochberg(p_values: FloatArray, *, rate: float) -> NDArray[np.bool_]:
    """Return which hypotheses are rejected at a false discovery rate.

    References
    ----------
    .. [1] Benjamini and Hochberg 1995.

    Examples
    --------
    >>> import numpy as np
    >>> benjamini_hochberg(np.array([0.001, 0.2, 0.03, 0.9]), rate=0.05).tolist()
    [True, False, False, False]
    """
    order = np.argsort(p_values)
    n = p_values.size
    passed = np.flatnonzero(p_values[order] <= rate * np.arange(1, n + 1) / n)
    rejected = np.zeros(n, dtype=bool)
    if passed.size:
        rejected[order[: passed[-1] + 1]] = True
    return rejected
