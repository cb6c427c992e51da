"""Capability of a process from single values, and control limits of a chart of individuals.

Cp = (upper - lower) / (6 s), Cpk = min(upper - mean, mean - lower) / (3 s) with the standard deviation s of
all values about their mean. Where the chart shows no stable process these are the indices of
performance Pp and Ppk of ISO 22514-2. s holds the scatter of the measurement too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.parameters.decision import limits_error
from metrosep.parameters.rounding_floor import RELATIVE_FLOOR

__all__ = ["LEAST_VALUES", "Capability", "ControlLimits", "capability_of", "control_limits"]

LEAST_VALUES = 20
"""With fewer values the interval of Cpk is wider than a third of it: no index is given."""

_LEVEL = 0.95
_INDIVIDUALS, _RANGES = 2.66, 3.267
"""3 / d2 and D4 for ranges of two values (d2 = 1.128)."""


@dataclass(frozen=True, slots=True)
class Capability:
    """Indices of a process with 95 % confidence intervals.

    Parameters
    ----------
    n : int
        Number of values.
    mean, sd : float
        Mean, and standard deviation with n - 1.
    cp, cp_low, cp_high : float or None
        Cp with its interval; ``None`` with one limit only.
    cpk, cpk_low, cpk_high : float
        Cpk with its interval.
    """

    n: int
    mean: float
    sd: float
    cp: float | None
    cp_low: float | None
    cp_high: float | None
    cpk: float
    cpk_low: float
    cpk_high: float


@dataclass(frozen=True, slots=True)
class ControlLimits:
    """Limits of a chart of individuals and of its moving ranges.

    Parameters
    ----------
    mean, lower, upper : float
        Centre line and limits of the values.
    mean_range, upper_range : float
        Centre line and upper limit of the moving ranges; the lower one is 0.
    """

    mean: float
    lower: float
    upper: float
    mean_range: float
    upper_range: float


def capability_of(
    values: Sequence[float | None], *, lower: float | None = None, upper: float | None = None
) -> Capability | None:
    """Return the capability of a process.

    Parameters
    ----------
    values : sequence of (float or None)
        One of each part; ``None`` and NaN were not measured and do not count.
    lower, upper : float, optional
        Limits in the same unit.

    Returns
    -------
    Capability or None
        ``None`` with fewer than 20 values, without a limit, or without any scatter: at most 1e-12 of
        the mean or a limit is rounding.

    Raises
    ------
    DataError
        If the limits are not in order or not finite.

    Notes
    -----
    The interval of Cp is exact for normal values: Cp sqrt(chi2(0.025, n-1) / (n-1)) to
    Cp sqrt(chi2(0.975, n-1) / (n-1)) [1]_. That of Cpk is the approximation of Bissell [2]_:
    Cpk (1 ± 1.96 sqrt(1 / (9 n Cpk^2) + 1 / (2 (n - 1)))), which is written here so that Cpk = 0 has
    one too.

    References
    ----------
    .. [1] D. C. Montgomery, Introduction to Statistical Quality Control, section on confidence
       intervals of process capability ratios.
    .. [2] A. F. Bissell, How reliable is your capability index?, Applied Statistics 39 (1990) 331.

    Examples
    --------
    >>> found = capability_of([1.0, 3.0] * 10, lower=-4.0, upper=8.0)
    >>> f"{found.cp:.3f} {found.cpk:.3f}"
    '1.949 1.949'
    """
    limits = [v for v in (lower, upper) if v is not None]
    if any(not math.isfinite(v) for v in limits) or (len(limits) == 2 and limits[0] >= limits[1]):
        raise limits_error(lower, upper)
    known = _known(values)
    if len(known) < LEAST_VALUES or not limits:
        return None
    mean, sd = float(np.mean(known)), float(np.std(known, ddof=1))
    if not sd > RELATIVE_FLOOR * max(abs(mean), *(abs(v) for v in limits)):  # rounding only
        return None
    n = len(known)
    below = math.inf if lower is None else mean - lower
    above = math.inf if upper is None else upper - mean
    cpk = min(below, above) / (3.0 * sd)
    cp = (limits[1] - limits[0]) / (6.0 * sd) if len(limits) == 2 else None
    half = 1.959963984540054 * math.sqrt(1.0 / (9.0 * n) + cpk**2 / (2.0 * (n - 1)))
    low, high = _cp_factors(n)
    return Capability(
        n, mean, sd, cp,
        None if cp is None else cp * low,
        None if cp is None else cp * high,
        cpk, cpk - half, cpk + half,
    )  # fmt: skip


def control_limits(values: Sequence[float | None] | FloatArray) -> ControlLimits | None:
    """Return the control limits of a chart of individuals.

    Parameters
    ----------
    values : sequence of (float or None), or ndarray, shape (n,)
        In their order; ``None`` and NaN were not measured.

    Returns
    -------
    ControlLimits or None
        ``None`` where no two neighbours are known.

    Notes
    -----
    Limits are mean ± 2.66 times the mean moving range of two neighbours, the upper limit of the
    ranges 3.267 times it [1]_. A gap has no range to either side.

    References
    ----------
    .. [1] ISO 7870-2:2023 and D. C. Montgomery, Introduction to Statistical Quality Control, chart
       of individuals.

    Examples
    --------
    >>> control_limits([1.0, 3.0, 2.0]).mean_range
    1.5
    """
    numbers = np.array([math.nan if v is None else v for v in values], dtype=np.float64)
    numbers[~np.isfinite(numbers)] = math.nan
    ranges = np.abs(np.diff(numbers))
    ranges = ranges[~np.isnan(ranges)]
    if ranges.size == 0:
        return None
    mean, spread = float(np.nanmean(numbers)), float(np.mean(ranges))
    reach = _INDIVIDUALS * spread
    return ControlLimits(mean, mean - reach, mean + reach, spread, _RANGES * spread)


def _known(values: Sequence[float | None]) -> list[float]:
    return [v for v in values if v is not None and math.isfinite(v)]


def _cp_factors(n: int) -> tuple[float, float]:
    from scipy.special import gammaincinv  # chi2(q, k) = 2 gammaincinv(k / 2, q)

    tail, k = 0.5 * (1.0 - _LEVEL), n - 1
    low, high = (math.sqrt(2.0 * float(gammaincinv(0.5 * k, q)) / k) for q in (tail, 1.0 - tail))
    return low, high
