"""The correction that cancels an error exactly: lookup at the command, error at the actual place.

A controller looks the correction up at the uncorrected position p, while the error acts where the
axis then is, p + c. With c = -e(p) a rest of about e e' is left; the exact inverse solves
c(p) = -e(p + c(p)) (controllers notes, section 0).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotConvergedError, TableError

__all__ = ["exact_correction"]


_TOLERANCE = 1e-13
"""Convergence of the fixed point in m: a tenth of a picometre."""

_MAX_STEPS = 60


def exact_correction(
    error: Callable[[FloatArray], FloatArray], positions: FloatArray
) -> FloatArray:
    """Return c with ``c(p) = -e(p + c(p))``.

    Parameters
    ----------
    error : callable
        Error e in m at positions in m.
    positions : ndarray, shape (n,), m
        Commanded positions p.

    Returns
    -------
    ndarray, shape (n,), m
        Correction to add to the command.

    Raises
    ------
    TableError
        If the error is so steep that the axis would turn back, ``|de/dx| >= 1``, or not finite
        where it is looked up.
    NotConvergedError
        If the fixed point does not settle to 0.1 pm.

    Examples
    --------
    >>> import numpy as np
    >>> bool(abs(exact_correction(lambda x: 0.01 * x, np.array([1.0]))[0] + 0.01 / 1.01) < 1e-13)
    True
    """
    correction = -_finite(error, positions)
    for _ in range(_MAX_STEPS):
        update = -_finite(error, positions + correction)
        change = float(np.abs(update - correction).max(initial=0.0))
        correction = update
        if change < _TOLERANCE:
            return correction
        if change > 1e3:
            break
    steep = (
        float(np.abs(np.diff(error(positions)) / np.diff(positions)).max())
        if positions.size > 1
        else float("nan")
    )
    if steep >= 1.0:
        raise TableError(
            f"the error changes by {steep:.3g} m per m: the corrected axis would turn back; check "
            "the units of position and error (mm against um?)"
        )
    raise NotConvergedError(
        f"the exact inverse did not settle to 0.1 pm (largest slope {steep:.3g}); smooth the error "
        "or use exact=False"
    )


def _finite(error: Callable[[FloatArray], FloatArray], places: FloatArray) -> FloatArray:
    values = np.asarray(error(places), dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise TableError(
            f"the error is not finite at {places[int(bad[0])] * 1e3:.9g} mm ({bad.size} of "
            f"{places.size} places): narrow the positions to what was measured"
        )
    return values
