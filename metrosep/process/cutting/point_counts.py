"""The fewest points of a program for a tolerance on the cut surface, not on the path.

The part that a path with n points leaves is compared, place by place, with the part that the exact path
of the tip leaves: the cusps of the feed are in both. Where points of neighbouring turns do not lie side
by side, a turn cuts what its neighbour left, and fewer points do than on the path.
specs/cutting-path.md, sections 6 and 6.2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process.cutting.programs import TurningProgram
from metrosep.process.cutting.virtual_part import heights_cut
from metrosep.process.nose import RoundNose
from metrosep.process.path_points import PointPlan, SpiralPath, fewest_between, plan_of
from metrosep.process.tips import Edge, TipSurface, tips

__all__ = ["fewest_on_the_cut"]

_SPREAD, _EXTREME, _SEED = 6_000, 1_500, 2028
"""Places at random over the part, and contacts where the path is furthest off, half on either side."""
_DENSER = {"linear": 1, "spline": 3, "pvt": 3}
"""Points of the spline that stands for the exact path, over those of a plan that holds on the path."""
_TURN, _MARGIN = 2.0 * math.pi, 0.02
"""rad; turns, for what the lean of the edge and rounding move the deciding moment."""
_SHRINK = 0.85
_RESOLUTION = 5e-3
_BESIDE = (-0.01, -0.03), (0.02,)
"""Relative, of the count: how finely it is sought, and where it is checked for luck, below and above."""


def fewest_on_the_cut(
    found: PointPlan,
    program_of: Callable[[SpiralPath], TurningProgram],
    form: Form,
    nose: RoundNose,
    *,
    fewest: int,
    annulus: tuple[float | None, float | None] | None,
) -> PointPlan:
    """Return the plan of the fewest points whose part holds the tolerance of a plan judged on the path."""
    dense = SpiralPath.with_points(
        found.path.radius,
        found.path.feed,
        _DENSER[found.path.interpolation] * found.n_points,
        **_options(found.path) | {"interpolation": "spline", "knots": "interpolate"},
    )
    exact = program_of(dense)
    spread = _spread(found.path, form, annulus)
    wanted, sure = _judged(exact, nose, spread)

    tried: dict[int, float] = {}

    def error(n: int) -> float:
        if n not in tried:
            path = path_of(n)
            far, alone = _furthest(path, form, nose, annulus)
            beside = _judged(exact, nose, far)
            z = heights_cut(program_of(path), nose, *np.concatenate([spread, far], axis=1))[0]
            off = z - np.append(wanted, beside[0])
            known = np.isfinite(off)
            # at the ends another turn than that of the exact path may decide, and have no neighbour
            lost = ~known & np.append(sure, beside[1])
            all_ = np.append(off[known], alone)
            tried[n] = math.inf if lost.any() or not all_.size else float(np.ptp(all_))
        return tried[n]

    def path_of(n: int) -> SpiralPath:
        return SpiralPath.with_points(
            found.path.radius, found.path.feed, n, **_options(found.path)
        )

    tolerance, high = found.tolerance, found.n_points
    on_path = found.peak_to_valley
    if error(high) > tolerance:
        said = (
            f"the part cut along it is off by {format_length(error(high))}, more than the path: {high} points "
            "hold the tolerance on the path only"
        )
        return replace(found, messages=(*found.messages, said))
    low = high
    while low > fewest and error(low) <= tolerance:
        high, low = low, max(fewest, math.floor(_SHRINK * low))
    if error(low) <= tolerance:
        high = low
    best = fewest_between(error, tried, tolerance, low, high, fewest, _RESOLUTION, beside=_BESIDE)
    plan = plan_of(path_of(best), tolerance, tried)
    said = (
        f"counted on the cut surface, at some {_SPREAD + _EXTREME} places of the part: {best} points leave "
        f"{format_length(tried[best])} P-V beside the part of the exact path, {found.n_points} would hold "
        f"the tolerance on the path ({format_length(on_path)}). Of the first and the last turn, which have no "
        "neighbour on one side, the path counts"
    )
    return replace(plan, messages=(*plan.messages, said))


def _options(path: SpiralPath) -> dict[str, Any]:
    """Return what a path of another count keeps."""
    names = (
        "distribution", "interpolation", "lead_in", "core", "sense", "knots", "end", "start",
    )  # fmt: skip
    return {n: getattr(path, n) for n in names if hasattr(path, n)}


def _judged(
    exact: TurningProgram, nose: RoundNose, places: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return heights of the exact path, NaN where the first or last turn decides, and which are sure."""
    z, turn = heights_cut(exact, nose, *places)
    end = np.minimum(turn, exact.turns - turn)
    return np.where(end > 1.0 + _MARGIN, z, math.nan), end > 2.0 + _MARGIN


def _within(
    rho: FloatArray, annulus: tuple[float | None, float | None] | None
) -> NDArray[np.bool_]:
    """Return which radii count."""
    low, high = annulus or (None, None)
    return (rho >= (0.0 if low is None else low)) & (rho <= (math.inf if high is None else high))


def _spread(
    path: SpiralPath, form: Form, annulus: tuple[float | None, float | None] | None
) -> FloatArray:
    """Return x and y of places at random over the area, as two rows."""
    rng = np.random.default_rng(_SEED)
    rho = np.sqrt(rng.uniform(path.core**2, path.radius**2, _SPREAD))
    theta = rng.uniform(-math.pi, math.pi, _SPREAD)
    places = np.stack([rho * np.cos(theta), rho * np.sin(theta)])
    return np.asarray(places[:, np.isfinite(form(*places)) & _within(rho, annulus)])


def _furthest(
    path: SpiralPath,
    form: Form,
    nose: RoundNose,
    annulus: tuple[float | None, float | None] | None,
) -> tuple[FloatArray, FloatArray]:
    """Return contacts where a path is furthest off, half on either side; errors of its first and last turn."""
    edge = Edge.of(nose, path.sense)
    errors = path.error_map(TipSurface(form, edge), 2)  # the middle of each block
    whole, turn = errors.theta, _TURN * (1.0 + _MARGIN)
    between = (whole > whole.min() + turn) & (whole < whole.max() - turn)
    inner, alone = np.flatnonzero(between), errors.z[~between & _within(errors.rho, annulus)]
    order = inner[np.argsort(errors.z[inner])]
    chosen = np.unique(np.append(order[: _EXTREME // 2], order[-_EXTREME // 2 :]))
    if not chosen.size:  # two turns: all that there is lies in the first and the last
        return np.empty((2, 0)), alone
    azimuth = path.azimuth_of(errors.theta[chosen])
    made = tips(form, errors.rho[chosen], azimuth, edge, strict=False)
    on = _within(made.rho, annulus)  # False for NaN
    places = np.stack([made.rho * np.cos(made.theta), made.rho * np.sin(made.theta)])
    return places[:, on], alone
