"""What a fit should tell its user: freedoms that hang together, periods, a tilt that is no plane."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.units import format_length
from metrosep.forms.placement import Placement
from metrosep.forms.points import Points

__all__ = ["fit_warnings"]


_STRONG = 0.99
"""Correlation above which two parameters are hardly told apart."""
_LEAST_TILT = 1e-12
"""m, of the difference between a plane and a turned form: no instrument measures less."""

_TILT_SHARE = 0.1
"""Of the residual: a tilt whose kind matters more than this is named."""


def fit_warnings(
    points: Points, placed: Placement, names: Sequence[str], cov: FloatArray, rms: float
) -> tuple[str, ...]:
    """Return the warnings of a fit, one sentence each."""
    found = [*_tied(names, cov), *_periods(placed, names), *_kind_of_tilt(points, placed, rms)]
    return tuple(found)


def _tied(names: Sequence[str], cov: FloatArray) -> list[str]:
    sd = np.sqrt(np.diag(cov))
    if not sd.size or not np.isfinite(sd).all() or not (sd > 0.0).all():
        return []
    r = cov / np.outer(sd, sd)
    pairs = [
        (abs(r[i, j]), f"{names[i]} and {names[j]} hang together (correlation {r[i, j]:+.4f})")
        for i in range(len(names))
        for j in range(i)
        if abs(r[i, j]) > _STRONG
    ]
    pairs.sort(key=lambda pair: -pair[0])
    return [
        f"{text}: the data hardly tell one from the other; hold one if it is known"
        for _, text in pairs[:5]
    ]


def _periods(placed: Placement, names: Sequence[str]) -> list[str]:
    period = placed.form.period
    if period is None:
        return []
    return [
        f"{name} is known only up to whole periods of {format_length(period[axis])}"
        for axis, name in enumerate(("shift_x", "shift_y"))
        if name in names
    ]


def _kind_of_tilt(points: Points, placed: Placement, rms: float) -> list[str]:
    """Warn where turning the form and adding a plane differ by more than the residual tells."""
    tx, ty = placed.get("tilt_x"), placed.get("tilt_y")
    if placed.tilt == "rotation" or not (tx or ty):
        return []
    x, y, _ = points.sample(1000)
    sx, sy = x - placed.get("shift_x"), y - placed.get("shift_y")
    height = placed.form.height(sx, sy)
    gx, gy = placed.form.slopes(sx, sy)
    difference = (tx * gx + ty * gy) * height
    difference = difference[~np.isnan(difference)]
    if difference.size == 0:
        return []
    largest = float(np.ptp(difference))
    if largest <= max(_TILT_SHARE * rms, _LEAST_TILT):
        return []
    return [
        (
            f"a tilt of {np.hypot(tx, ty) * 1e3:.3g} mrad was taken as a plane; a part that is really "
            f"tilted differs from that by up to {format_length(largest)} (looks like coma): "
            "use tilt='rotation' for it"
        )
    ]
