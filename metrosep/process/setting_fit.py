"""Which tool setting explains a measured map: linear start, exact finish, uncertainty, doubts.

The heights of the part as cut are compared with what the exact model of `ToolSetting` cuts, moved
by what the microscope does not know: piston, tilts, lateral shift and, if wanted, rotation.
error = actual - nominal; dx, dy and dR of the result are those of the tool, to be compensated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.provenance import freeze_mapping
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import Points, PointSet, points_of
from metrosep.process._setting_doubts import correlated_pairs, doubts
from metrosep.process._setting_equations import (
    FREEDOMS,
    Choice,
    Equations,
    choose,
    equations,
    modelled,
    solve,
)
from metrosep.process._setting_model import FACTORS, known_form
from metrosep.process.setting_maps import checked_region
from metrosep.process.tool_settings import ToolSetting

__all__ = ["SettingFit", "identify_setting"]

_MOST_STEPS = 60
_MOST_HALVINGS = 12
_SETTLED = 1e-4
"""Of the residual's RMS: a step that moves the model less than this is the last one."""
_ROUNDING = 1e-16
"""m: steps below this are rounding of the heights."""
_AROUND_CENTRE = 3.0
"""Radii below this many times hypot(dx, dy) are left out: the centre is cut twice or not at all."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SettingFit:
    """A tool setting found on a measured map, and how far to trust it.

    Parameters
    ----------
    setting : ToolSetting
        dx, dy, dR with their covariance; a factor that was not determined is 0 with infinite u.
    values, u : mapping of str to float
        All fitted freedoms and their standard uncertainties, SI.
    cov : ndarray, shape (n, n)
        Covariance of the freedoms, in the order of `values`.
    residual : Surface, Profile or PointSet
        Measured - modelled height; NaN where not used.
    rms : float, m
        Of the residual: what would remain were the setting compensated.
    n_used : int
        Points used.
    groups : tuple of (str, str, float)
        Pairs of fitted freedoms that are told apart badly (|r| > 0.9), with their correlation.
    held : mapping of str to tuple of str
        Freedoms that were wanted and are not determined, and what holds their effect.
    messages : tuple of str
        In plain words.
    audit : mapping
        Numbers with units in the keys.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Surface
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> x, y = np.meshgrid(*[4e-6 * np.arange(-50, 51)] * 2)
    >>> fit = identify_setting(Surface(grid(x, y), 4e-6, 4e-6), grid)
    >>> abs(fit.setting.dx) < 1e-15
    True
    """

    setting: ToolSetting
    values: Mapping[str, float]
    u: Mapping[str, float]
    cov: FloatArray
    residual: Surface | Profile | PointSet
    rms: float
    n_used: int
    groups: tuple[tuple[str, str, float], ...] = ()
    held: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Every fitted freedom with unit, definition and standard uncertainty."""
        return {
            name: Quantity(
                value, FREEDOMS[name], f"{_MEANING[name]}, fitted to a map", self.u[name], name
            )
            for name, value in self.values.items()
        }

    def report(self) -> str:
        """Return the result as text, one line for each freedom and message.

        Returns
        -------
        str
            For people.
        """
        lines = [f"{name:9s} {quantity}" for name, quantity in self.quantities.items()]
        lines.append(f"residual RMS {format_length(self.rms)} on {self.n_used} points")
        return "\n".join([*lines, *self.messages])

    def __repr__(self) -> str:
        return (
            f"SettingFit({self.setting!r}, residual RMS {format_length(self.rms)}, "
            f"{self.n_used} points)"
        )


_MEANING = {
    "piston": "height of the map",
    "tilt_x": "slope of the map along x",
    "tilt_y": "slope of the map along y",
    "dx": "tool further from the spindle axis than programmed",
    "dy": "tool off the spindle axis towards growing azimuth",
    "dR": "nose radius larger than programmed",
    "shift_x": "part further along x than the centre says",
    "shift_y": "part further along y than the centre says",
    "rotation": "part turned counter-clockwise",
}


def identify_setting(
    surface: Surface | Profile | PointSet,
    form: Form,
    *,
    free: Sequence[str] | None = None,
    nose_radius: float | None = None,
    centre: tuple[float, float] | None = None,
    region: tuple[float, float] | None = None,
    start: ToolSetting | None = None,
    noise: float | None = None,
) -> SettingFit:
    """Return the tool setting that explains measured heights, with all that was fitted.

    Parameters
    ----------
    surface : Surface, Profile or PointSet
        Heights of the part as cut, form included; NaN = not measured. A profile is the line y = 0.
    form : Form
        The nominal surface, all parameters known, with the spindle axis at its origin.
    free : sequence of str, optional
        Of ``dx dy dR piston tilt_x tilt_y shift_x shift_y rotation``. If omitted all but the
        rotation; on a profile without tilt_y and the shifts.
    nose_radius : float, m, optional
        Programmed nose radius, > 0; a dR that would leave no nose is then refused.
    centre : tuple of (float, float), m, optional
        Spindle axis in the coordinates of the map. If omitted (0, 0), or the middle of a map whose
        origin was not declared.
    region : tuple of (float, float), m, optional
        Inner and outer radius of what is used.
    start : ToolSetting, optional
        Where to start; zero, and so the linear solution, if omitted.
    noise : float, m, optional
        Standard deviation of one height, > 0; from the residual if omitted.

    Returns
    -------
    SettingFit
        Setting, residual, covariance, groups and messages.

    Raises
    ------
    DataError
        If the form, a freedom, the centre, the region, the nose radius or the noise is not usable.
    TooFewSamplesError
        If fewer points than freedoms remain.
    DegenerateFitError
        If neither dx, dy nor dR leaves a trace, or dR would leave no nose.
    NotConvergedError
        If the iteration does not settle.

    Notes
    -----
    Least squares over the valid points, Gauss-Newton with analytic derivatives and halved steps;
    the first step from zero is the linear solution. Points within 3 hypot(dx, dy) of the axis are
    left out. The uncertainty takes the noise of different points as independent; a message says so
    where the residual is not. A freedom that the points do not determine is given up, shifts and
    rotation first: on a one-sided profile a shift looks exactly like dx. NaN is left out.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
       Eq. (12)-(20), inverted here.

    Examples
    --------
    >>> import numpy as np
    >>> from metrosep import Profile
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> x = np.arange(20e-6, 300e-6, 1e-6)
    >>> z = grid(x) + ToolSetting(dx=-2e-6).error(grid, x)
    >>> fit = identify_setting(Profile(x, z), grid)
    >>> round(fit.setting.dx * 1e6, 6), "shift_x" in " ".join(fit.messages)
    (-2.0, True)
    """
    form = known_form(form)
    points = points_of(surface, centre=centre, middle=True)
    names = _checked_free(free, is_line=isinstance(surface, Profile))
    wanted = (0.0, math.inf) if region is None else checked_region(region)
    noise = _positive(noise, "noise")
    nose_radius = _positive(nose_radius, "nose_radius")
    extent = _extent(points)
    values = dict.fromkeys(FREEDOMS, 0.0)
    if start is not None:
        values |= {"dx": start.dx, "dy": start.dy, "dR": start.dR}
    used = _outside(wanted, values)
    sums, choice = _chosen(points, form, values, used, names, noise, extent)
    values, steps = _settle(points, form, values, used, choice, sums, n_settle=1)
    for _ in range(4):
        used = _outside(wanted, values)
        sums, choice = _chosen(points, form, values, used, names, noise, extent)
        values, more = _settle(points, form, values, used, choice, sums, n_settle=_MOST_STEPS)
        steps += more
        if _outside(wanted, values)[0] <= used[0] * (1.0 + 1e-3):
            break
    sums = equations(points, form, values, used)
    return _result(
        surface, points, form, values, used, sums, choice, names, noise, steps, nose_radius
    )


def _chosen(
    points: Points,
    form: Form,
    values: Mapping[str, float],
    region: tuple[float, float],
    names: Sequence[str],
    noise: float | None,
    extent: float,
) -> tuple[Equations, Choice]:
    """Return the sums and the freedoms they determine; refuse what determines no setting."""
    sums = equations(points, form, values, region)
    if sums.n <= len(names):
        raise TooFewSamplesError(
            f"{sums.n} measured points lie within rho = {format_length(region[0])} ... "
            f"{format_length(region[1]) if math.isfinite(region[1]) else 'the rim'} and on the "
            f"{form.name}, and {len(names)} freedoms need more; check centre and region"
        )
    level = noise or _linear_rest(sums, choose(sums, names, noise=0.0, extent=extent))
    choice = choose(sums, names, noise=level, extent=extent)
    wanted = [n for n in FACTORS if n in names]
    if wanted and not any(n in choice.used for n in wanted):
        raise DegenerateFitError(
            f"{', '.join(wanted)} leave no trace of their own on this {form.name} over the "
            "measured points: no tool setting can be found; measure a larger or steeper "
            "part, and check the unit of the heights"
        )
    return sums, choice


def _linear_rest(sums: Equations, choice: Choice) -> float:
    """Return the RMS that a linear solution would leave, m."""
    step, _ = solve(sums, choice)
    left = sums.square - float(step @ sums.right[choice.rows])
    return math.sqrt(max(left, 0.0) / sums.n)


def _settle(
    points: Points,
    form: Form,
    values: dict[str, float],
    region: tuple[float, float],
    choice: Choice,
    sums: Equations,
    *,
    n_settle: int,
) -> tuple[dict[str, float], int]:
    """Return the values after at most `n_settle` damped steps, and their number."""
    rows = choice.rows
    for count in range(1, n_settle + 1):
        step, _ = solve(sums, choice)
        moved = math.sqrt(max(float(step @ sums.gram[np.ix_(rows, rows)] @ step), 0.0) / sums.n)
        enough = moved <= _SETTLED * math.sqrt(sums.mean_square) * 1e-3 + _ROUNDING
        share = 1.0
        for _ in range(_MOST_HALVINGS):
            tried = dict(values)
            for name, change in zip(choice.used, share * step, strict=True):
                tried[name] += float(change)
            try:
                new = equations(points, form, tried, region)
            except NotConvergedError:
                share *= 0.5
                continue
            if new.n > len(rows) and new.mean_square <= sums.mean_square * (1.0 + 1e-12):
                break
            if enough:
                return values, count
            share *= 0.5
        else:
            if moved <= _SETTLED * math.sqrt(sums.mean_square):
                return values, count
            raise NotConvergedError(
                f"no step of the setting makes the residual of {format_length(math.sqrt(sums.mean_square))} "
                f"RMS smaller, at dx = {format_length(values['dx'])}, dy = "
                f"{format_length(values['dy'])}, dR = {format_length(values['dR'])}: the map may be "
                "of another surface or mirrored; check form and centre, or give start="
            )
        values, sums = tried, new
        if enough:
            return values, count
    if n_settle == 1:
        return values, 1
    raise NotConvergedError(
        f"the setting still moves after {n_settle} steps (now dx = {format_length(values['dx'])}, "
        f"dy = {format_length(values['dy'])}, dR = {format_length(values['dR'])}): check form and "
        "centre, free less, or give start="
    )


def _outside(wanted: tuple[float, float], values: Mapping[str, float]) -> tuple[float, float]:
    return max(wanted[0], _AROUND_CENTRE * math.hypot(values["dx"], values["dy"])), wanted[1]


def _result(
    surface: Surface | Profile | PointSet,
    points: Points,
    form: Form,
    values: Mapping[str, float],
    region: tuple[float, float],
    sums: Equations,
    choice: Choice,
    names: Sequence[str],
    noise: float | None,
    steps: int,
    nose_radius: float | None,
) -> SettingFit:
    spare = sums.n - len(choice.used)
    level = noise or math.sqrt(sums.square / spare)
    _, inverse = solve(sums, choice)
    cov = level**2 * inverse
    fitted = {n: values[n] for n in choice.used}
    u = dict(zip(choice.used, np.sqrt(np.diag(cov)).tolist(), strict=True))
    if nose_radius is not None and fitted.get("dR", 0.0) <= -nose_radius:
        raise DegenerateFitError(
            f"dR = {format_length(fitted['dR'])} (u {format_length(u['dR'])}) would leave no nose of "
            f"the programmed {format_length(nose_radius)}: the map does not show the nose radius; "
            "hold dR with free=, or check the form"
        )
    residual = _residual(surface, points, form, values, region)
    groups = correlated_pairs(choice.used, cov)
    audit = {
        "n_used": sums.n,
        "n_measured": points.n_valid,
        "inner_um": region[0] * 1e6,
        "residual_rms_nm": math.sqrt(sums.mean_square) * 1e9,
        "noise_nm": level * 1e9,
        "noise_from": "residual" if noise is None else "stated",
        "steps": steps,
        "centre_um": tuple(c * 1e6 for c in points.centre),
        "free": tuple(names),
        "form": repr(form),
    }
    shift = (values["shift_x"], values["shift_y"])
    said = doubts(
        points, sums, choice, names, groups, residual, level, noise, region, form.period, shift
    )
    found: dict[str, Any] = {
        "setting": None,
        "values": freeze_mapping(fitted),
        "u": freeze_mapping(u),
        "cov": _frozen(cov),
        "residual": residual,
        "rms": math.sqrt(sums.mean_square),
        "n_used": sums.n,
        "groups": groups,
        "held": freeze_mapping(dict(choice.given_up)),
        "messages": said,
        "audit": freeze_mapping(audit),
    }
    where = {n: i for i, n in enumerate(choice.used)}
    joint = np.zeros((3, 3))
    for i, first in enumerate(FACTORS):
        for j, second in enumerate(FACTORS):
            if first in where and second in where:
                joint[i, j] = cov[where[first], where[second]]
        if first in names and first not in where:
            joint[i, i] = math.inf
    dx, dy, dR = (fitted.get(n, values[n]) for n in FACTORS)
    alone = SettingFit(**{**found, "setting": ToolSetting(dx, dy, dR, cov=joint)})
    return SettingFit(**{**found, "setting": ToolSetting(dx, dy, dR, cov=joint, fit=alone)})


def _residual(
    surface: Surface | Profile | PointSet,
    points: Points,
    form: Form,
    values: Mapping[str, float],
    region: tuple[float, float],
) -> Surface | Profile | PointSet:
    """Return measured - modelled as an object of the same kind; NaN where not used."""

    def off(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        model, _ = modelled(form, x.ravel(), y.ravel(), values)
        rho = np.hypot(x - values["shift_x"], y - values["shift_y"])
        inside = (rho >= region[0]) & (rho <= region[1])
        return np.where(inside, z - model.reshape(z.shape), np.nan)

    z = points.over_blocks(off)
    if isinstance(surface, Surface):
        return Surface(z, surface.dx, surface.dy, origin=surface.origin)
    if isinstance(surface, Profile):
        return Profile(surface.x, z[0])
    return PointSet(surface.x, surface.y, z[0])


def _frozen(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values


def _extent(points: Points) -> float:
    return float(np.hypot(np.abs(points.x).max(), np.abs(points.y).max()))


def _checked_free(free: Sequence[str] | None, *, is_line: bool) -> list[str]:
    if free is None:
        gone = {"rotation"} | ({"tilt_y", "shift_x", "shift_y"} if is_line else set())
        return [n for n in FREEDOMS if n not in gone]
    asked = [free] if isinstance(free, str) else list(free)
    for name in asked:
        if name not in FREEDOMS:
            raise DataError(f"unknown freedom {name!r}; one of {', '.join(FREEDOMS)}")
    if not any(n in FACTORS for n in asked):
        raise DataError("free names neither dx, dy nor dR: there is no setting to find")
    return [n for n in FREEDOMS if n in asked]


def _positive(value: float | None, name: str) -> float | None:
    if value is None:
        return None
    number = float(value)
    if not (math.isfinite(number) and number > 0.0):
        raise DataError(f"{name} must be positive and finite, in m, got {value}")
    return number
