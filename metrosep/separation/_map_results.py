"""What separations of maps share: noise from redundancy, terms that alignment decides."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.quantity import Quantity
from metrosep.separation.contract import Unobservable

REMOVABLE = {"piston": ("piston",), "tilt": ("tilt x", "tilt y"), "power": ("defocus",)}
"""What may be removed from each reading, and the terms that this is."""

_FEWEST_FREEDOMS = 10.0


def noise_of(residual: FloatArray, freedom: float, u_reading: float | None) -> Quantity:
    """Return the noise of one pixel, stated or pooled from the residual."""
    if u_reading is not None:
        text = "standard uncertainty of one pixel of one reading, as stated"
        return Quantity(float(u_reading), "m", text, symbol="s")
    if freedom < _FEWEST_FREEDOMS:
        return Quantity(math.nan, "m", "standard deviation of one pixel; not known", symbol="s")
    known = np.isfinite(residual).all(axis=0)
    value = math.sqrt(float((residual[:, known] ** 2).sum()) / freedom)
    text = "standard deviation of one pixel of one reading, from what the model leaves (type A)"
    return Quantity(value, "m", text, u=value / math.sqrt(2.0 * freedom), symbol="s")


def rigid_terms(parts: Sequence[str], removed: Sequence[str]) -> tuple[Unobservable, ...]:
    """Return piston, tilt and what else alignment decides, for each part."""
    terms = tuple(term for item in removed for term in REMOVABLE[item])
    if not terms:
        return ()
    reason = "each set-up is aligned anew, so these terms are removed by least squares"
    return tuple(Unobservable(part, "term", terms, reason) for part in parts)
