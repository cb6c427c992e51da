"""Private: refuse heights whose powers leave double precision."""

from __future__ import annotations

import math

from metrosep.core.errors import DataError, InvalidSamplesError

LEAST, LARGEST = 1e-60, 1e60
"""Limits in m; the fourth power of 1e-77 is 0 and that of 1e77 infinite, and heights vary."""


def check_range(low: float, high: float) -> None:
    """Refuse infinite heights, too large ones, and a range that is tiny but not zero."""
    if math.isinf(low) or math.isinf(high):
        raise InvalidSamplesError("z is infinite somewhere; write NaN where nothing was measured")
    largest = max(abs(low), abs(high))
    if largest > LARGEST:
        raise DataError(
            f"the heights reach {largest:.3g} m, beyond {LARGEST:g} m, where their powers are no "
            "numbers any more; is the unit m, and is a code for missing samples among them?"
        )
    if 0.0 < high - low < LEAST:
        raise DataError(
            f"the range of the heights is {high - low:.3g} m, below {LEAST:g} m, where their "
            "powers vanish; is the unit m?"
        )
