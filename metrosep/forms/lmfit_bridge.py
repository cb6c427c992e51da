"""A fit as lmfit would do it, for its confidence intervals and as a second opinion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.errors import DataError
from metrosep.forms.freedoms import RIGID
from metrosep.forms.placement import Placement
from metrosep.forms.points import points_of

if TYPE_CHECKING:
    from metrosep.forms.result import FitResult

__all__ = ["refit"]


def refit(result: FitResult) -> Any:
    """Return lmfit's least squares with the freedoms of a result, started at it."""
    import lmfit

    if result.source is None:
        raise DataError("this result does not hold the measurement it was fitted to; fit it again")
    points = points_of(result.source, centre=result.centre, middle=False)
    x, y, z = points.sample(points.z.size)
    parameters = lmfit.Parameters()
    held = {k: v for k, v in result.params.items() if k in RIGID}
    start = {**held, **result.form.parameters}
    for name, value in start.items():
        parameters.add(name, value=value, vary=name in result.names)
    unit = result.rms if result.rms > 0.0 else 1.0

    def residual(values: Any) -> Any:
        given = {k: float(values[k].value) for k in start}
        rigid = {k: v for k, v in given.items() if k in RIGID}
        shape = {k: v for k, v in given.items() if k not in RIGID}
        placed = Placement(
            result.form.with_parameters(**shape),
            rigid,
            result.placement.tilt,
            result.placement.direction,
        )
        deviation = placed.deviation(x, y, z)
        return deviation[~np.isnan(deviation)] / unit

    return lmfit.minimize(residual, parameters, method="leastsq")
