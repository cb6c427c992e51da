"""Private: what a fitted tool setting could not tell, in plain words, and what a held dy does to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.points import PointSet
from metrosep.process._setting_equations import FACTORS, FREEDOMS, alike, modelled, solve
from metrosep.process._setting_steps import Correlation, Settled, Task, neighbours_of_scattered

_Reading = Callable[[FloatArray, FloatArray], FloatArray]
_READINGS: Mapping[str, tuple[_Reading, _Reading]] = {
    "its rows in the other order": (lambda x, y: x, lambda x, y: -y),
    "its columns in the other order": (lambda x, y: -x, lambda x, y: y),
    "rows and columns exchanged (transposed)": (lambda x, y: y, lambda x, y: x),
    "rows and columns exchanged and both reversed": (lambda x, y: -y, lambda x, y: -x),
}
"""Ways to misread a map that mirror it."""
_SAMPLE = 2000
"""Points that show whether a form is its own mirror image."""
_CLOSE = 0.9
_CORRELATED = 0.3
_LEAST = 1e-15
"""m: a residual below this is rounding."""
_TOO_MUCH = 1.3
_FAR = 0.2
_SINGLE = 8.0


def correlated_pairs(names: Sequence[str], cov: FloatArray) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of freedoms whose estimates correlate by more than 0.9, closest first."""
    u = np.sqrt(np.diag(cov))
    found = [
        (names[i], names[j], float(cov[i, j] / (u[i] * u[j])))
        for i in range(len(names))
        for j in range(i)
        if abs(cov[i, j]) > _CLOSE * u[i] * u[j] > 0.0
    ]
    return tuple(sorted(found, key=lambda pair: -abs(pair[2])))


def warnings_of_fit(
    task: Task,
    settled: Settled,
    groups: Sequence[tuple[str, str, float]],
    residual: Surface | Profile | PointSet,
    level: float,
    linked: Correlation,
    raised: Mapping[str, float],
) -> tuple[str, ...]:
    """Return the messages of a fit."""
    said = [*_held(settled), *_confounded(settled, groups), *_mirrors(task, settled, level)]
    said += [*_shifted(task, settled), *_points(task, settled, residual, level)]
    return (*said, *(_linked(residual, linked, raised) if level > _LEAST else ()))


def _held(settled: Settled) -> list[str]:
    """Return which freedoms are not determined, where they are held and what holds their effect."""
    said = []
    for name, partners in settled.choice.given_up.items():
        value, unit = settled.values[name], FREEDOMS[name]
        at = format_length(value) if unit == "m" else f"{value:.4g} {unit}"
        at = at if value else "0"
        if partners:
            said.append(
                f"{name} cannot be distinguished from {', '.join(partners)} on these points and is held at "
                f"{at}: what it would be is in {partners[-1]}"
            )
        else:
            said.append(
                f"{name} leaves no trace of the first order on these points and is held at {at}, "
                "undetermined"
            )
    return said


def _confounded(settled: Settled, groups: Sequence[tuple[str, str, float]]) -> list[str]:
    """Return which freedoms, fitted or not, pass for one another."""
    said = []
    held = [n for n in ("shift_x", "shift_y", "rotation") if n not in settled.choice.used]
    for name, (setting, r) in alike(settled.sums, settled.choice, held).items():
        remedy = (
            "the azimuth of the map is known better than that; align it by a mark, or free rotation"
            if name == "rotation"
            else "the centre of the map is known better than that; measure both sides of the "
            "centre, or a map"
        )
        said.append(
            f"{name} and {setting} are confounded on these points (r = {r:.3f}): the uncertainty "
            f"of {setting} holds only if {remedy}"
        )
    for first, second, r in groups:
        if {first, second} & {*FACTORS}:
            said.append(f"{first} and {second} are hardly distinguished (r = {r:.3f})")
    return said


def _shifted(task: Task, settled: Settled) -> list[str]:
    """Return which shifts of a periodic form are so large that the map may be misread."""
    said = []
    shift = (settled.values["shift_x"], settled.values["shift_y"])
    for axis, length, moved in zip("xy", task.form.period or (), shift, strict=False):
        if abs(moved) > _FAR * length:
            said.append(
                f"the part had to be shifted by {format_length(moved)} along {axis}, more than a "
                f"fifth of its period {format_length(length)}: a mirrored or transposed map looks like "
                "that too and gives dy the wrong sign; check the centre and the orientation of the map"
            )
    return said


def _points(
    task: Task, settled: Settled, residual: Surface | Profile | PointSet, level: float
) -> list[str]:
    """Return what is odd about the points: left out, worse than stated, or outliers."""
    sums, region, noise = settled.sums, settled.region, task.noise
    said = []
    left_out = task.points.n_valid - sums.n
    if left_out:
        said.append(
            f"{left_out} measured points are not used: nearer to the axis than "
            f"{format_length(region.inner)}, beyond the region, or where nothing is defined"
        )
    if noise is not None and math.sqrt(sums.mean_square) > _TOO_MUCH * noise:
        said.append(
            f"the residual of {format_length(math.sqrt(sums.mean_square))} RMS is more than the "
            f"stated noise of {format_length(noise)}: the setting does not explain all of the map, "
            "and its uncertainty is too small"
        )
    largest = float(np.nanmax(np.abs(residual.z)))
    if largest > _SINGLE * level > 1e-15:
        said.append(
            f"a single residual reaches {format_length(largest)}, {largest / level:.0f} times the "
            "noise: outliers pull the setting; remove them (NaN) and fit again"
        )
    return said


def _linked(
    residual: Surface | Profile | PointSet, linked: Correlation, raised: Mapping[str, float]
) -> list[str]:
    """Return that residuals of neighbours correlate, and what was done about it."""
    if isinstance(residual, PointSet):
        r = neighbours_of_scattered(residual.x, residual.y, residual.z)
        if r < max(_CORRELATED, 3.0 / math.sqrt(residual.z.size)):
            return []
        message = (
            f"residuals of neighbouring points correlate (r = {r:.2f}): they are not noise of single "
            "points, and the uncertainties are too small; on a map or a profile they would be raised"
        )
        return [message]
    if linked.is_white:
        return []
    along = f"r = {linked.along_x:.2f} along x"
    if isinstance(residual, Surface):
        along += f", {linked.along_y:.2f} along y"
    factors = ", ".join(f"{n} {v:.2g} times" for n, v in raised.items())
    message = (
        f"residuals of neighbouring points correlate ({along}): {linked.alike:.3g} points say what "
        f"one would, and the uncertainties are raised for it ({factors}); that holds for noise, not "
        "for form that the model does not hold"
    )
    return [message]


def _mirrors(task: Task, settled: Settled, level: float) -> list[str]:
    """Return that dy has no sign of its own where the form is its own mirror image.

    Reading rows, columns or both in the wrong order then gives the same heights as the tool on the
    other side of the axis, to the last digit.
    """
    if "dy" not in settled.choice.used:
        return []
    x, y, _ = task.points.sample(_SAMPLE)
    height = task.form.height(x, y)
    known = ~np.isnan(height)
    x, y, height = x[known], y[known], height[known]
    alike_to = max(level, 1e-9 * float(np.std(height)))
    same = []
    for what, (px, py) in _READINGS.items():
        off = task.form.height(px(x, y), py(x, y)) - height
        off = off[~np.isnan(off)]
        if off.size and float(np.std(off)) <= alike_to:
            same.append(what)
    if not same:
        return []
    message = (
        f"the sign of dy rests on the orientation of the map: this {task.form.name} is its own "
        f"mirror image, so a map with {' or '.join(same)} fits as well and gives -dy; make sure of "
        "the orientation by a mark on the part"
    )
    return [message]


# ---- private: what a dy that is not fitted does to the setting that is -------------------------
# On a sphere or a profile dy leaves no trace of the first order, but the radius at which the tool cuts
# is ``sqrt(rho^2 - dy^2)``: the part looks like one cut ``dy^2 / (2 rho)`` nearer to the axis, and dx
# takes that up.

_STEP = 1e-6
"""m of dy for which the effect is stated."""
_HELD_FAR = 10e-6
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
    if abs(size) * (_HELD_FAR / _STEP) ** (2 if is_square else 1) <= 0.5 * u["dx"]:
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
