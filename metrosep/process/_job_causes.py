"""The causes of form error of a job at the samples of a spiral: what is removed, and what a setting does."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, MetrosepError
from metrosep.forms.base import Form
from metrosep.process._motion import FollowUp, FollowUpMap
from metrosep.process._setting_equations import FACTORS, height_errors
from metrosep.process.predictions import Contribution
from metrosep.process.tool_settings import ToolSetting

_NAME = "tool setting"
_STEP = {"dx": 1e-8, "dy": 1e-8, "dR": 1e-6}
"""m: at which the effect of a factor that is not determined is looked for."""
_NO_EFFECT = 1e-9
"""Of height for a factor, m/m: rounding of a form that does not show it."""
_BENT, _TINY = 0.5, 1e-11
"""What is not linear within one u, as a share of what is and in m, above which a message says so."""


def setting_cause(
    form: Form,
    tool: ToolSetting,
    rho: FloatArray,
    azimuth: FloatArray,
    weights: FloatArray,
    removed: tuple[str, ...],
    messages: list[str],
) -> Contribution:
    """Return the error of the setting with what its uncertainty can do; NaN in the uncut core."""
    messages += [f"{_NAME}: {m}" for m in tool.messages]
    cut = rho > abs(tool.dy) * (1.0 + 1e-9) + 1e-12
    x, y = rho[cut] * np.cos(azimuth[cut]), rho[cut] * np.sin(azimuth[cut])
    z = np.full(rho.shape, np.nan)
    z[cut] = tool.error(form, x, y)
    if tool.dy and not cut.all():
        messages.append(
            f"{int((~cut).sum())} samples within |dy| of the spindle axis are not cut and have "
            "no error"
        )
    elif not cut.all():
        messages.append(
            f"the {_NAME} has no error on the spindle axis: no azimuth is defined there"
        )
    maps, cov = _modes(form, tool, (x, y), z[cut], messages)
    modes = np.full((len(maps), rho.size), np.nan)
    for mode, values in zip(modes, maps, strict=True):
        mode[cut] = values
    if removed:
        basis = _basis(rho, azimuth, removed)
        z = _without(z, basis, weights)
        for mode in modes:
            mode[:] = _without(mode, basis, weights)
    if cov is None or not cov.size:
        return Contribution(_NAME, map=z, u=None if cov is None else 0.0)
    return Contribution(_NAME, map=z, modes=modes, cov=cov)


def _modes(
    form: Form,
    tool: ToolSetting,
    at: tuple[FloatArray, FloatArray],
    z: FloatArray,
    messages: list[str],
) -> tuple[list[FloatArray], FloatArray | None]:
    """Return the change of the error with each uncertain factor, and their covariance."""
    cov = tool.covariance
    if cov is None:
        unknown = [n for n in FACTORS if getattr(tool, n) and getattr(tool, f"u_{n}") is None]
        messages.append(
            f"the uncertainty of {', '.join(unknown) or 'the setting'} is not known: the P-V of "
            f"the {_NAME} has no u"
        )
        return [], None
    maps: list[FloatArray] = []
    used: list[int] = []
    bent = linear = 0.0
    for i, name in enumerate(FACTORS):
        u = math.sqrt(float(cov[i, i]))
        if u == 0.0:
            continue
        step = u if math.isfinite(u) else _STEP[name]
        try:
            ahead, behind = (
                height_errors(form, *at, _off_by(tool, i, way * step), exact=True)
                for way in (1.0, -1.0)
            )
        except MetrosepError as error:
            messages.append(f"the P-V of the {_NAME} has no u: with {name} one u off, {error}")
            return [], None
        half = 0.5 * (ahead - behind)
        if np.isnan(half).all():
            messages.append(
                f"the P-V of the {_NAME} has no u: with {name} one u off nothing is cut"
            )
            return [], None
        if math.isinf(u):
            if float(np.nanmax(np.abs(half))) > _NO_EFFECT * step:
                messages.append(
                    f"{name} is not determined (its u is infinite): the P-V of the {_NAME} has no u"
                )
                return [], None
            messages.append(
                f"{name} is not determined, and of no effect on this form to first order: it is "
                "not counted"
            )
            continue
        bent += _extent(0.5 * (ahead + behind) - z)
        linear += _extent(half)
        maps.append(half / step)
        used.append(i)
    if bent > max(_BENT * linear, _TINY):
        messages.append(
            f"the error of the {_NAME} is not linear within its uncertainty: u and expected P-V, "
            "of first order, are too small"
        )
    if not used:
        return [], None if np.isinf(np.diag(cov)).any() else np.empty((0, 0))
    square = cov[np.ix_(used, used)]
    return maps, np.where(np.isfinite(square), square, 0.0)


def _off_by(tool: ToolSetting, factor: int, change: float) -> tuple[float, float, float]:
    """Return a setting with one factor changed."""
    dx, dy, dR = (v + (change if k == factor else 0.0) for k, v in enumerate(tool.values.tolist()))
    return dx, dy, dR


def _extent(values: FloatArray) -> float:
    return float(np.nanmax(values) - np.nanmin(values))


def cause_of(
    name: str,
    z: FloatArray,
    rho: FloatArray,
    azimuth: FloatArray,
    weights: FloatArray,
    removed: tuple[str, ...],
) -> Contribution:
    """Return a contribution without the removed freedoms."""
    if removed:
        z = _without(z, _basis(rho, azimuth, removed), weights)
    return Contribution(name, map=z)


def _basis(rho: FloatArray, azimuth: FloatArray, removed: tuple[str, ...]) -> FloatArray:
    columns = [np.ones_like(rho)] if "piston" in removed else []
    if "tilt" in removed:
        scale = float(rho.max())
        columns += [rho * np.cos(azimuth) / scale, rho * np.sin(azimuth) / scale]
    return np.stack(columns)


def _without(z: FloatArray, basis: FloatArray, weights: FloatArray) -> FloatArray:
    """Return a map without what a basis explains of it, by least squares over the area."""
    good = ~np.isnan(z)
    weighted = basis[:, good] * weights[good]
    normal = weighted @ basis[:, good].T
    found, *_ = np.linalg.lstsq(normal, weighted @ z[good], rcond=None)
    return np.asarray(z - found @ basis, dtype=np.float64)


def checked_removed(removed: Sequence[str]) -> tuple[str, ...]:
    """Return the names of what is removed."""
    if not isinstance(removed, str | list | tuple | set | frozenset):
        raise DataError(f'removed must be of "piston" and "tilt", got {removed!r}')
    names = (removed,) if isinstance(removed, str) else tuple(removed)
    return tuple(numbers.choice(n, "removed", ("piston", "tilt")) for n in names)


def check_causes(tool: object, follow_up: object, *, float_too: bool) -> None:
    """Raise DataError for a cause of another kind."""
    if tool is not None and not isinstance(tool, ToolSetting):
        raise DataError(
            f"tool must be a ToolSetting such as ToolSetting(dx=1e-6), got {type(tool).__name__}"
        )
    if follow_up is None or isinstance(follow_up, FollowUp | FollowUpMap):
        return
    if not float_too:
        raise DataError(
            "follow_up must be a log placed on the part, from follow_up(...): a "
            f"{type(follow_up).__name__} has no shape that could be made up for"
        )
    if not isinstance(follow_up, str) and not numbers.is_real(follow_up):
        raise DataError(
            "follow_up must be a log placed on the part, from follow_up(...), or a P-V in m, got "
            f"{type(follow_up).__name__}"
        )
