"""Private: what the points could not tell about a tool setting, in plain words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.points import Points, PointSet
from metrosep.process._setting_equations import Choice, Equations, alike
from metrosep.process._setting_model import FACTORS

_CLOSE = 0.9
_CORRELATED = 0.3
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
    points: Points,
    sums: Equations,
    choice: Choice,
    names: Sequence[str],
    groups: Sequence[tuple[str, str, float]],
    residual: Surface | Profile | PointSet,
    level: float,
    noise: float | None,
    region: tuple[float, float],
    period: tuple[float, float] | None,
    shift: tuple[float, float],
) -> tuple[str, ...]:
    """Return the messages of a fit."""
    said = []
    for name, partners in choice.given_up.items():
        if partners:
            said.append(
                f"{name} cannot be told from {', '.join(partners)} on these points and is held at "
                f"0: what it would be is in {partners[-1]}"
            )
        else:
            said.append(f"{name} leaves no trace on these points and is held at 0, undetermined")
    held = [n for n in ("shift_x", "shift_y", "rotation") if n not in choice.used]
    for name, (setting, r) in alike(sums, choice, held).items():
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
    for axis, length, moved in zip("xy", period or (), shift, strict=False):
        if abs(moved) > _FAR * length:
            said.append(
                f"the part had to be shifted by {format_length(moved)} along {axis}, more than a "
                f"fifth of its period {format_length(length)}: another period may fit as well, and a "
                "mirrored or transposed map looks like that too and gives dy the wrong sign; check "
                "the centre and the orientation of the map"
            )
    left_out = points.n_valid - sums.n
    if region[0] > 0.0 or sums.n_undefined:
        said.append(
            f"{left_out} measured points are not used: nearer to the axis than "
            f"{format_length(region[0])}, beyond the region, or where nothing is defined"
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
    r = _neighbours(residual)
    if r > _CORRELATED and level > 1e-15:
        said.append(
            f"residuals of neighbouring points correlate (r = {r:.2f}): they are not noise of "
            "single points, and the uncertainties are too small"
        )
    return tuple(said)


def _neighbours(residual: Surface | Profile | PointSet) -> float:
    """Return the correlation of neighbours along x; 0 for scattered points."""
    if isinstance(residual, PointSet):
        return 0.0
    z = np.atleast_2d(residual.z)
    first, second = z[:, :-1].ravel(), z[:, 1:].ravel()
    both = ~(np.isnan(first) | np.isnan(second))
    first, second = first[both], second[both]
    if first.size < 10:
        return 0.0
    first, second = first - first.mean(), second - second.mean()
    size = float(first @ first) * float(second @ second)
    return float(first @ second) / math.sqrt(size) if size > 0.0 else 0.0
