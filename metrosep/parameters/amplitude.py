"""Amplitude parameters of a row of heights: a, q, sk, ku, p, v.

Heights count from the mean line of the filter, z = 0, out of the material; nothing is centred
here. NaN = not measured and does not count. Kurtosis is 3 for a Gaussian distribution, not the
excess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError

__all__ = ["Amplitudes", "amplitudes"]


@dataclass(frozen=True, slots=True)
class Amplitudes:
    """Height statistics about z = 0."""

    a: float  # m: arithmetic mean and root mean square height
    q: float
    sk: float | None  # skewness and kurtosis; None where all heights are equal (zero height)
    ku: float | None
    p: float  # m: highest peak above and deepest valley below z = 0 (positive downwards)
    v: float

    @property
    def z(self) -> float:
        """Peak height plus valley depth in m."""
        return self.p + self.v


def amplitudes(heights: ArrayLike) -> Amplitudes:
    """Return the amplitude parameters of heights.

    Notes
    -----
    ``a = mean|z|``, ``q = sqrt(mean z^2)``, ``sk = mean (z/q)^3``, ``ku = mean (z/q)^4``,
    ``p = max z``, ``v = -min z``. No division by n - 1.

    References
    ----------
    .. [1] ISO 4287:1997, 4.1.1, 4.1.2, 4.2.1 to 4.2.4 (recalled).

    Examples
    --------
    >>> found = amplitudes([1e-6, -1e-6, 1e-6, -1e-6])
    >>> found.a, found.sk, found.ku
    (1e-06, 0.0, 1.0)
    """
    z = np.asarray(heights, dtype=np.float64)
    z = z[~np.isnan(z)]
    if z.size == 0:
        raise TooFewSamplesError("no height was measured, so there are no amplitude parameters")
    p, v = float(z.max()), -float(z.min())
    if not (np.isfinite(p) and np.isfinite(v)):
        raise InvalidSamplesError("a height is infinite; mark samples out of range as NaN")
    scale = max(abs(p), abs(v))
    if scale == 0.0 or p + v == 0.0:
        return Amplitudes(a=scale, q=scale, sk=None, ku=None, p=p, v=v)
    unit = z / scale
    square = unit * unit
    mean_square = float(square.mean())
    return Amplitudes(
        a=scale * float(np.abs(unit).mean()),
        q=scale * mean_square**0.5,
        sk=float((square * unit).mean()) / mean_square**1.5,
        ku=float((square * square).mean()) / mean_square**2,
        p=p,
        v=v,
    )
