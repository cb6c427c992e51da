"""Three-state decisions on conformity after ISO 14253-1.

With a guard band g = guard_factor * U inside each limit: accept if the value keeps clear of both
limits by g or more, reject if it passes a limit by g or more, else inconclusive. With g = 0 a value on
its limit is accepted.
"""

from __future__ import annotations

import math
import sys
from typing import Literal

from metrosep.core.errors import DataError
from metrosep.spectral._checks import real_number

__all__ = ["Verdict", "decide", "limits_error", "ordered_limits", "worst"]

_ROUNDING = 4.0 * sys.float_info.epsilon
"""Of each of the numbers, their difference and their product: 9.4 is 10 - 2 * 0.3."""

Verdict = Literal["accept", "reject", "inconclusive"]


def decide(
    value: float,
    *,
    lower: float | None = None,
    upper: float | None = None,
    U: float,
    guard_factor: float = 1.0,
) -> Verdict:
    """Return whether a value conforms to its limits.

    Parameters
    ----------
    value : float
        Measured value; NaN is inconclusive.
    lower, upper : float, optional
        Limits, same unit.
    U : float
        Expanded uncertainty, same unit, >= 0.
    guard_factor : float, optional
        Guard band over U, >= 0; 0 is simple acceptance.

    Returns
    -------
    {"accept", "reject", "inconclusive"}
        Verdict.

    Raises
    ------
    DataError
        If there is no limit, the limits cross, U or the factor is negative or not finite, or one
        of them is no number.

    Notes
    -----
    Accept: lower + g <= value <= upper - g. Reject: value <= lower - g or value >= upper + g. Both
    edges are kept to within the rounding of floats, 4 epsilon of the largest of the three numbers.
    Where both hold, g being zero, the value is accepted.

    References
    ----------
    .. [1] ISO 14253-1:2017.

    Examples
    --------
    >>> decide(90e-9, upper=100e-9, U=5e-9), decide(98e-9, upper=100e-9, U=5e-9)
    ('accept', 'inconclusive')
    """
    low, high = ordered_limits(lower, upper)
    value = real_number(value, "value")
    for name, number in (("U", U), ("guard_factor", guard_factor)):
        if not (math.isfinite(real_number(number, name)) and number >= 0.0):
            raise DataError(f"{name} must be finite and not negative, got {_text(number)}")
    guard = guard_factor * U
    below, above = (_allowance(value, limit, guard) for limit in (low, high))
    if low + guard - below <= value <= high - guard + above:
        return "accept"
    if value <= low - guard + below or value >= high + guard - above:
        return "reject"
    return "inconclusive"


def ordered_limits(lower: float | None, upper: float | None) -> tuple[float, float]:
    """Return both limits of a decision, infinite where there is none."""
    if lower is None and upper is None:
        raise DataError("a decision needs a lower or an upper limit")
    low = -math.inf if lower is None else real_number(lower, "lower")
    high = math.inf if upper is None else real_number(upper, "upper")
    if math.isnan(low) or math.isnan(high) or low > high:
        raise limits_error(lower, upper)
    return low, high


def limits_error(lower: float | None, upper: float | None) -> DataError:
    """Return the error that two limits are not in order."""
    return DataError(f"the limits {_text(lower)} ... {_text(upper)} are not in order")


def _text(number: float | None) -> str:
    """Return a number for a message: a limit of a recipe tells itself with its unit."""
    own = getattr(number, "text", None)
    return own if isinstance(own, str) else "none" if number is None else f"{number:.10g}"


def _allowance(value: float, limit: float, guard: float) -> float:
    """Return the rounding of a limit with its guard band, zero where one of them is infinite."""
    largest = max(abs(value), abs(limit), guard)
    return _ROUNDING * largest if math.isfinite(largest) else 0.0


def worst(verdicts: list[Verdict]) -> Verdict | None:
    """Return the verdict of several characteristics together."""
    for verdict in ("reject", "inconclusive", "accept"):
        if verdict in verdicts:
            return verdict
    return None
