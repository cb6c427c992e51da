"""Private helpers: the causes of form error at the samples of a spiral."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.forms.base import Form
from metrosep.process._follow_result import FollowUp, FollowUpMap
from metrosep.process.budget import Contribution
from metrosep.process.spirals import SpiralPath
from metrosep.process.tool_settings import ToolSetting

__all__ = ["cause_of", "checked_removed", "frozen", "on_spiral", "u_of_setting"]

_TURN = 2.0 * np.pi
_ASTRAY = 0.5
"""rad: a log whose azimuth leaves the programmed spiral by more belongs to another program."""
_MOST_POINTS = 20_000
"""Of the path at which the u of a P-V is worked out."""


def u_of_setting(form: Form, tool: ToolSetting, x: FloatArray, y: FloatArray) -> float | None:
    """Return the u of the P-V of the setting's error, first order in each factor; None if unknown."""
    cov = tool.covariance
    if cov is None or not np.isfinite(cov).all():
        return None
    core = abs(tool.dy) + math.sqrt(float(cov[1, 1]))  # the core of the setting one u off
    cut = np.hypot(x, y) > core * (1.0 + 1e-9) + 1e-12
    thin = slice(None, None, max(1, x.size // _MOST_POINTS))
    x, y = x[cut][thin], y[cut][thin]

    def pv(values: FloatArray) -> float:
        dx, dy, dR = (float(v) for v in values)
        setting = ToolSetting(dx, dy, dR)
        return float(np.ptp(setting.error(form, x, y)))

    slopes = np.zeros(3)
    variances: list[float] = np.diag(cov).tolist()
    for i, variance in enumerate(variances):
        if variance > 0.0:
            step = np.zeros(3)
            step[i] = math.sqrt(variance)
            ahead, behind = pv(tool.values + step), pv(tool.values - step)
            slopes[i] = 0.5 * (ahead - behind) / step[i]
    return math.sqrt(max(float(slopes @ cov @ slopes), 0.0))


def cause_of(
    name: str,
    z: FloatArray,
    rho: FloatArray,
    azimuth: FloatArray,
    weights: FloatArray,
    removed: tuple[str, ...],
) -> Contribution:
    """Return a contribution without the removed freedoms."""
    if not removed:
        return Contribution(name, map=z)
    columns = [np.ones_like(rho)] if "piston" in removed else []
    if "tilt" in removed:
        scale = float(rho.max())
        columns += [rho * np.cos(azimuth) / scale, rho * np.sin(azimuth) / scale]
    basis = np.stack(columns)
    good = ~np.isnan(z)
    w = weights[good]
    normal = (basis[:, good] * w) @ basis[:, good].T
    found = np.linalg.solve(normal, (basis[:, good] * w) @ z[good])
    return Contribution(name, map=z - found @ basis)


def on_spiral(
    log: FollowUp | FollowUpMap, spiral: SpiralPath, rho: FloatArray, messages: list[str]
) -> FloatArray:
    """Return a logged error at radii of the spiral; NaN where the log does not reach."""
    places = log.map if isinstance(log, FollowUp) else log
    if places is None:
        raise DataError(
            "the log has no places on the part: it needs channels of radius and azimuth, or "
            "follow_up(..., spiral=(start radius, feed, spindle speed))"
        )
    good = ~(np.isnan(places.z) | np.isnan(places.rho) | np.isnan(places.theta))
    good &= (places.rho <= spiral.radius * (1.0 + 1e-9)) & (places.rho >= 0.0)
    if int(good.sum()) < 2:
        raise TooFewSamplesError("the log has no samples with a place on the part")
    u = _TURN * places.rho[good] / spiral.feed
    expected = np.asarray(spiral.azimuth_of(_TURN * spiral.turns - u), dtype=np.float64)
    off = np.angle(np.exp(1j * (places.theta[good] - expected)))
    worst = float(np.abs(off).max())
    if worst > _ASTRAY:
        raise DataError(
            f"the log leaves the programmed spiral by up to {np.degrees(worst):.1f} deg of azimuth; "
            "check its start radius, feed, speed and the sense of rotation"
        )
    order = np.argsort(u)
    at = _TURN * rho / spiral.feed
    z = np.interp(at, u[order], places.z[good][order], left=np.nan, right=np.nan)
    step = float(np.median(np.diff(u[order])))
    if step > 0.1:
        messages.append(
            f"the log has a sample every {np.degrees(step):.1f} deg only; between them its error is "
            "taken on straight lines"
        )
    covered = float(np.mean(~np.isnan(z)))
    if covered < 0.999:
        messages.append(f"the log covers {100.0 * covered:.1f} % of the path")
    out: FloatArray = z
    return out


def checked_removed(removed: Sequence[str]) -> tuple[str, ...]:
    names = (removed,) if isinstance(removed, str) else tuple(removed)
    unknown = [n for n in names if n not in ("piston", "tilt")]
    if unknown:
        raise DataError(f'removed must be of "piston" and "tilt", got {unknown[0]!r}')
    return names


def frozen(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
