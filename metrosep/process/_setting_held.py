"""Private: what a dy that is not fitted does to the setting that is.

On a sphere or a profile dy leaves no trace of the first order, but the radius at which the tool cuts
is ``sqrt(rho^2 - dy^2)``: the part looks like one cut ``dy^2 / (2 rho)`` nearer to the axis, and dx
takes that up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.units import format_length
from metrosep.process._setting_equations import FREEDOMS, modelled, solve
from metrosep.process._setting_steps import Settled, Task

_STEP = 1e-6
"""m of dy for which the effect is stated."""
_FAR = 10e-6
"""m: a dy as large as this must change dx by less than half its uncertainty to be kept silent."""


def moved_by(task: Task, settled: Settled, dy: float) -> FloatArray:
    """Return by how much the fitted freedoms are wrong if dy is another one than was held, m."""
    other = {**settled.values, "dy": settled.values["dy"] + dy}
    right = np.zeros(len(FREEDOMS))
    with one_blas_thread():
        for all_x, all_y, _ in task.points.valid_blocks():
            inside = settled.region.holds(all_x, all_y)
            x, y = all_x[inside], all_y[inside]
            model, columns = modelled(task.form, x, y, settled.values)
            off = modelled(task.form, x, y, other)[0] - model
            good = ~np.isnan(off) & np.isfinite(columns).all(axis=0)
            right += columns[:, good] @ off[good]
    _, inverse = solve(settled.sums, settled.choice)
    moved: FloatArray = inverse @ right[settled.choice.rows]
    return moved


def with_held_dy(task: Task, settled: Settled, cov: FloatArray, u_dy: float | None) -> FloatArray:
    """Return the covariance with what a known uncertainty of a held dy adds.

    Three points of the Gauss-Hermite rule, exact for what grows with dy and with its square.
    """
    if not u_dy or not math.isfinite(u_dy) or "dy" in settled.choice.used:
        return cov
    added = cov.copy()
    for side in (1.0, -1.0):
        moved = moved_by(task, settled, side * math.sqrt(3.0) * u_dy)
        added += np.outer(moved, moved) / 6.0
    return added


def effect_of_dy(task: Task, settled: Settled) -> tuple[float, bool] | None:
    """Return by how much 1 um of a dy that is not fitted changes dx, m, and whether by its square.

    None where dy is fitted.
    """
    used = settled.choice.used
    if "dy" in used or "dx" not in used:
        return None
    up, down = (float(moved_by(task, settled, s * _STEP)[used.index("dx")]) for s in (1.0, -1.0))
    is_square = abs(up + down) > abs(up - down)
    return (0.5 * (up + down) if is_square else 0.5 * (up - down)), is_square


def said_of_dy(
    settled: Settled, effect: tuple[float, bool] | None, u: Mapping[str, float], u_dy: float | None
) -> tuple[str, ...]:
    """Return the message on a dy that is not fitted, where it may matter."""
    if effect is None:
        return ()
    size, is_square = effect
    if abs(size) * (_FAR / _STEP) ** (2 if is_square else 1) <= 0.5 * u["dx"]:
        return ()
    remedy = (
        "that is in the uncertainty, with the stated u of dy"
        if u_dy is not None and math.isfinite(u_dy)
        else "set the tool height first, or tell it with start=ToolSetting(dy=..., u_dy=...)"
    )
    at = settled.values["dy"]
    held = "" if at == 0.0 else f" from the {format_length(at)} it is held at"
    growth = "the square of dy" if is_square else "dy"
    message = (
        f"dy is not fitted but changes dx: 1 um of it{held} makes {format_length(size, digits=2)} "
        f"of dx, and it grows with {growth}; {remedy}"
    )
    return (message,)
