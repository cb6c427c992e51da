"""Private: what the points could not tell about a tool setting, in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.points import PointSet
from metrosep.process._setting_equations import FREEDOMS, alike
from metrosep.process._setting_model import FACTORS
from metrosep.process._setting_noise import Correlation, neighbours_of_scattered
from metrosep.process._setting_steps import Settled, Task

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


def doubts(
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
    if level > _LEAST:
        said += _linked(residual, linked, raised)
    return tuple(said)


def _held(settled: Settled) -> list[str]:
    """Return which freedoms are not determined, where they are held and what holds their effect."""
    said = []
    for name, partners in settled.choice.given_up.items():
        at = _with_unit(settled.values[name], FREEDOMS[name])
        if partners:
            said.append(
                f"{name} cannot be told from {', '.join(partners)} on these points and is held at "
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
            said.append(f"{first} and {second} are told apart badly (r = {r:.3f})")
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


def _with_unit(value: float, unit: str) -> str:
    if value == 0.0:
        return "0"
    return format_length(value) if unit == "m" else f"{value:.4g} {unit}"
