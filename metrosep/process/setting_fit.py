"""Which tool setting explains a measured map: linear start, exact finish, uncertainty, doubts.

The heights of the part as cut are compared with what the exact model of `ToolSetting` cuts, moved
by what the microscope does not know: piston, tilts, lateral shift and, if wanted, rotation.
error = actual - nominal; dx, dy and dR of the result are those of the tool, to be compensated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.blas import one_blas_thread
from metrosep.core.errors import DataError, DegenerateFitError
from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.forms.points import PointSet, points_of
from metrosep.process._plain import Frozen, frozen, optional_length
from metrosep.process._setting_equations import (
    FACTORS,
    FREEDOMS,
    alike,
    known_form,
    modelled,
    solve,
)
from metrosep.process._setting_steps import (
    Correlation,
    Settled,
    Task,
    correlation,
    covariance,
    neighbours_of_scattered,
    settle_in_period,
)
from metrosep.process.setting_maps import LARGEST_NOSE, checked_region
from metrosep.process.tool_settings import ToolSetting

__all__ = ["SettingFit", "identify_setting"]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SettingFit(Frozen):
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
        Pairs of fitted freedoms that are told apart badly (``|r| > 0.9``), with their correlation.
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
        Spindle axis in the coordinates of the map. If omitted (0, 0), or the middle of what was
        measured on a map whose origin was not declared.
    region : tuple of (float, float), m, optional
        Inner and outer radius of what is used.
    start : ToolSetting, optional
        Where to start; zero, and so the linear solution, if omitted. What is not fitted stays
        there; its u_dy then goes into the uncertainty of dx.
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
    UnitError
        If the nose radius, the noise or the region cannot be in metres.

    Notes
    -----
    Least squares over the valid points, Gauss-Newton with analytic derivatives, damped where the
    valley is curved, until no freedom moves by more than 1e-3 of its uncertainty; the first step
    from zero is the linear solution. Points within 3 hypot(dx, dy) of the axis are left out. The correlation of the residual along x and y raises the uncertainty; on scattered
    points it is only said. A freedom that the points do not determine is given up, shifts and
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
    noise = optional_length(noise, "noise", 1e-3)
    nose_radius = optional_length(nose_radius, "nose_radius", LARGEST_NOSE)
    if start is not None and not isinstance(start, ToolSetting):
        raise DataError(f"start must be a ToolSetting, got {type(start).__name__}")
    extent = float(np.hypot(np.abs(points.x).max(), np.abs(points.y).max()))
    task = Task(points, form, names, wanted, noise, extent)
    values = dict.fromkeys(FREEDOMS, 0.0)
    if start is not None:
        values |= {"dx": start.dx, "dy": start.dy, "dR": start.dR}
    found, said = settle_in_period(task, values)
    u_dy = None if start is None else start.u_dy
    return _result(surface, task, found, (*points.notes, *said), nose_radius, u_dy)


def _result(
    surface: Surface | Profile | PointSet,
    task: Task,
    settled: Settled,
    said: tuple[str, ...],
    nose_radius: float | None,
    u_dy: float | None,
) -> SettingFit:
    sums, choice, values = settled.sums, settled.choice, settled.values
    residual = _residual(surface, task, settled)
    linked = correlation(task, residual.z)
    cov, variance = covariance(task, settled, (task.noise or 0.0) ** 2, linked)
    level = math.sqrt(variance)
    raised = _raised(settled, cov, level)
    cov = with_held_dy(task, settled, cov, u_dy)
    fitted = {n: values[n] for n in choice.used}
    u = dict(zip(choice.used, np.sqrt(np.diag(cov)).tolist(), strict=True))
    _check_nose(fitted, u, nose_radius)
    groups = correlated_pairs(choice.used, cov)
    effect = effect_of_dy(task, settled)
    audit = {
        "n_used": sums.n,
        "n_measured": task.points.n_valid,
        "inner_um": settled.region.inner * 1e6,
        "residual_rms_nm": math.sqrt(sums.mean_square) * 1e9,
        "noise_from": "residual" if task.noise is None else "stated",
        "steps": settled.steps,
        "centre_um": tuple(c * 1e6 for c in task.points.centre),
        "free": tuple(task.names),
        "form": repr(task.form),
        "noise_nm": level * 1e9,
        "u_raised": max(raised.values(), default=1.0),
        "points_alike": linked.alike,
    }
    if effect is not None:
        audit["dx_by_1um_of_dy_nm"] = effect[0] * 1e9
    said += said_of_dy(settled, effect, u, u_dy)
    said += _warnings(task, settled, groups, residual, level, linked, raised)
    dx, dy, dR = (values[n] for n in FACTORS)
    tool = ToolSetting(dx, dy, dR, cov=_of_setting(task, settled, cov, u_dy))
    rms, held = math.sqrt(sums.mean_square), dict(choice.given_up)
    alone = SettingFit(
        tool, fitted, u, frozen(cov), residual, rms, sums.n, groups, held, said, audit
    )
    return replace(alone, setting=replace(tool, fit=alone))


def _of_setting(task: Task, settled: Settled, cov: FloatArray, u_dy: float | None) -> FloatArray:
    """Return the covariance of (dx, dy, dR); infinite where not determined, 0 where not asked."""
    where = {n: i for i, n in enumerate(settled.choice.used)}
    joint = np.zeros((3, 3))
    for i, first in enumerate(FACTORS):
        if first in where:
            for j, second in enumerate(FACTORS):
                if second in where:
                    joint[i, j] = cov[where[first], where[second]]
        elif first == "dy" and u_dy is not None:
            joint[i, i] = u_dy**2
        elif first in task.names:
            joint[i, i] = math.inf
    return joint


def _raised(settled: Settled, cov: FloatArray, level: float) -> dict[str, float]:
    """Return by how much correlated noise raises the uncertainty of each factor."""
    _, inverse = solve(settled.sums, settled.choice)
    if level == 0.0:
        return {}
    ratios = np.sqrt(np.diag(cov) / np.diag(inverse)) / level
    found = dict(zip(settled.choice.used, ratios.tolist(), strict=True))
    return {n: max(found[n], 1.0) for n in FACTORS if n in found}


def _check_nose(
    fitted: Mapping[str, float], u: Mapping[str, float], nose_radius: float | None
) -> None:
    if nose_radius is not None and fitted.get("dR", 0.0) <= -nose_radius:
        raise DegenerateFitError(
            f"dR = {format_length(fitted['dR'])} (u {format_length(u['dR'])}) would leave no nose of "
            f"the programmed {format_length(nose_radius)}: the map does not show the nose radius; "
            "hold dR with free=, or check the form"
        )


def _residual(
    surface: Surface | Profile | PointSet, task: Task, settled: Settled
) -> Surface | Profile | PointSet:
    """Return measured - modelled as an object of the same kind; NaN where not used."""
    values, region = settled.values, settled.region

    def off(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        model, _ = modelled(task.form, x.ravel(), y.ravel(), values)
        return np.where(region.holds(x, y), z - model.reshape(z.shape), np.nan)

    z = task.points.over_blocks(off)
    if isinstance(surface, Surface):
        return Surface(z, surface.dx, surface.dy, origin=surface.origin)
    if isinstance(surface, Profile):
        return Profile(surface.x, z[0])
    return PointSet(surface.x, surface.y, z[0])


def _checked_free(free: Sequence[str] | None, *, is_line: bool) -> list[str]:
    if free is None:
        gone = {"rotation"} | ({"tilt_y", "shift_x", "shift_y"} if is_line else set())
        return [n for n in FREEDOMS if n not in gone]
    try:
        asked = [free] if isinstance(free, str) else list(free)
    except TypeError:
        raise DataError(f"free must name freedoms, got {free!r}") from None
    for name in asked:
        numbers.choice(name, "a freedom", FREEDOMS)
    if not any(n in FACTORS for n in asked):
        raise DataError("free names neither dx, dy nor dR: there is no setting to find")
    return [n for n in FREEDOMS if n in asked]


# ---- private: what the points could not tell about a tool setting, in plain words --------------

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


def _warnings(
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
