"""Feedforward: the path that a wrongly set tool, or a machine with known errors, must be given.

`corrected_path` inverts the setting model exactly: ``z_cmd(rho_cmd, theta_cmd)`` is the target at
the position really cut. `corrected_points` inverts a volumetric error onto points of a path.
error = actual - nominal; the correction is its negative at the right place. z out of the material.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray, as_float, frozen_float, same_length
from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import Frozen, finite_positions, length, real_array
from metrosep.process._setting_equations import FACTORS, known_form
from metrosep.process.setting_maps import plausible_places
from metrosep.process.tool_settings import ToolSetting

Volumetric = Callable[[FloatArray, FloatArray, FloatArray], tuple[ArrayLike, ArrayLike, ArrayLike]]

_MOST_STEPS = 60
_CLOSE = 1e-15
_SHALLOWEST = 1e-3


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CorrectedPath(Frozen):
    """Heights to command so that the part comes out right with the tool as it stands.

    Parameters
    ----------
    rho, theta : array_like, shape (n,)
        Commanded cut points, m and rad, as given.
    z : array_like, shape (n,), m
        Height to command there.
    cut_rho, cut_theta : array_like, shape (n,)
        Where the tool then really cuts, m and rad.
    target : array_like, shape (n,), m
        Nominal height there: what the part gets.
    change : array_like, shape (n,), m
        Height to command minus the uncorrected one; NaN where the surface has no height.
    u : array_like, shape (n,), m, optional
        Standard uncertainty of the cut height from that of the setting.
    residual_pv : mapping of str to float
        Predicted P-V over these points, m, one standard uncertainty off: of each factor alone, and
        ``"sum"`` and ``"rss"``. Empty where the uncertainties are not known.
    messages : tuple of str, optional
        In plain words.
    audit : mapping, optional
        Setting and size.

    Raises
    ------
    DataError
        If lengths differ, a value is infinite or there is no point.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> path = corrected_path(grid, ToolSetting(dx=1e-6), [100e-6], [0.0])
    >>> round(path.cut_rho.item() * 1e6, 9)
    101.0
    """

    rho: FloatArray
    theta: FloatArray
    z: FloatArray
    cut_rho: FloatArray
    cut_theta: FloatArray
    target: FloatArray
    change: FloatArray
    u: FloatArray | None = None
    residual_pv: Mapping[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    audit: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        Frozen.__post_init__(self)
        names = ("rho", "theta", "z", "cut_rho", "cut_theta", "target", "change", "u")
        given = {n: getattr(self, n) for n in names if getattr(self, n) is not None}
        same_length(**{n: frozen_float(v, name=n, ndim=1) for n, v in given.items()})

    def __repr__(self) -> str:
        rest = self.residual_pv.get("rss")
        shown = "" if rest is None else f", residual P-V {format_length(rest)} for one u (RSS)"
        return f"CorrectedPath({self.rho.size} points{shown})"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CorrectedPoints:
    """Points to command so that a machine with known errors reaches the wanted ones.

    Parameters
    ----------
    command : array_like, shape (n, 3), m
        Points to command.
    target : array_like, shape (n, 3), m
        Points wanted.
    residual : array_like, shape (n, 3), m
        Reached - wanted with the error as given: rounding of the iteration.
    steps : int
        Of the iteration.
    contraction : float
        By how much the last steps shrank; 0 where one step was enough.
    messages : tuple of str, optional
        In plain words.

    Raises
    ------
    DataError
        If an array is not two-dimensional, is infinite or has no point.

    Examples
    --------
    >>> error = lambda x, y, z: (1e-6 + 0 * x, 0 * x, 1e-3 * x)
    >>> found = corrected_points(error, [[1e-3, 0.0, 0.0]])
    >>> [round(v * 1e6, 6) for v in found.command[0].tolist()]
    [999.0, 0.0, -0.999]
    """

    command: FloatArray
    target: FloatArray
    residual: FloatArray
    steps: int
    contraction: float
    messages: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("command", "target", "residual"):
            object.__setattr__(self, name, frozen_float(getattr(self, name), name=name, ndim=2))

    def __repr__(self) -> str:
        moved = float(np.abs(self.command - self.target).max())
        return f"CorrectedPoints({len(self.target)} points, moved by up to {format_length(moved)})"


def corrected_path(
    form: Form, setting: ToolSetting, rho: ArrayLike, theta: ArrayLike
) -> CorrectedPath:
    """Return the heights to command so that a wrongly set tool cuts the nominal surface.

    Parameters
    ----------
    form : Form
        The surface wanted, with the spindle axis at its origin.
    setting : ToolSetting
        What the tool's errors are, not their negatives.
    rho : array_like, shape (n,), m
        Commanded radius of each cut point; negative beyond the centre.
    theta : array_like, shape (n,), rad
        Commanded workpiece azimuth.

    Returns
    -------
    CorrectedPath
        With the uncertainty and the predicted residual where those of the setting are known, and
        with what its identification could not tell.

    Raises
    ------
    DataError
        If the form is none or has unknown parameters, or the surface is not defined where a point
        is cut.
    InvalidSamplesError
        If a position is not a finite number, or the lengths differ.
    TooFewSamplesError
        If there is no point.
    UnitError
        If a radius cannot be in metres.
    NotConvergedError
        If dR exceeds what the curvature of the surface allows.

    Notes
    -----
    In the plane of the edge the target is a section ``g(X)`` with slope ``tan(phi)``, X from the
    spindle axis. A commanded cut point lands at ``X = rho + dx + dR sin(phi)``, ``y = dy``, which is
    ``hypot(X, dy)`` and ``theta + atan2(dy, X)`` on the workpiece; the envelope ``P + dR (e_z - n)``
    of `ToolSetting` asks for ``z_cmd = g(X) - dR (1 - cos phi)`` there. Exact: applied to the path, the setting leaves nothing. With a
    setting known to u, a sine of amplitude A and wave number k keeps ``2 A k u`` P-V per factor.

    The nose is that of the programme: commanded cut points are offset for R as before.

    References
    ----------
    .. [1] Deterministic error compensation for slow tool servo-driven diamond turning,
       Eq. (12)-(20), inverted here.

    Examples
    --------
    >>> from metrosep.forms import SineGrid
    >>> grid = SineGrid(amplitude=50e-9, wavelength=100e-6)
    >>> path = corrected_path(grid, ToolSetting(dx=1e-6, u_dx=0.05e-6), [100e-6], [0.0])
    >>> bool(abs(path.z[0] - grid(101e-6)) < 1e-20)
    True
    """
    form = known_form(form)
    if not isinstance(setting, ToolSetting):
        raise DataError(f"the setting must be a ToolSetting, got {type(setting).__name__}")
    r = np.atleast_1d(finite_positions(rho, "rho"))
    plausible_places(r, "rho")
    azimuth = np.atleast_1d(finite_positions(theta, "theta"))
    if r.ndim != 1 or r.shape != azimuth.shape:
        raise InvalidSamplesError(
            f"rho and theta must be equally long, got shapes {r.shape} and {azimuth.shape}"
        )
    if not r.size:
        raise TooFewSamplesError("the path has no point: give at least one rho and theta")
    x = _landed(form, r, azimuth, setting)
    height, slope, tangential, cut_rho, cut_theta = _section(form, x, azimuth, setting.dy)
    bad = np.flatnonzero(np.isnan(height))
    if bad.size:
        raise DataError(
            f"the {form.name} is not defined where point {int(bad[0])} is cut, rho = "
            f"{format_length(float(cut_rho[bad[0]]))}, azimuth "
            f"{math.degrees(float(cut_theta[bad[0]])):.4g} degrees: end the path before, or give a "
            "form that goes on"
        )
    secant = np.sqrt(1.0 + slope * slope)
    z = height - setting.dR * (1.0 - 1.0 / secant)
    plain = form.height(r * np.cos(azimuth), r * np.sin(azimuth))
    u, rest, said = left_over(setting, np.stack([-slope, -tangential, 1.0 - secant]), cut_rho)
    core = abs(setting.dy)
    if core > 0.0:
        said.append(
            f"nothing within rho = {format_length(core)} = |dy| of the spindle axis is cut, whatever "
            "is commanded: set the tool height"
        )
    said += [m for m in setting.messages if m not in said]
    sizes = {f"{n}_um": getattr(setting, n) * 1e6 for n in FACTORS}
    audit = {"form": repr(form), **sizes, "n_points": int(r.size)}
    return CorrectedPath(
        r, azimuth, z, cut_rho, cut_theta, height, z - plain, u, rest, tuple(said), audit
    )


def corrected_points(
    error: Volumetric, points: ArrayLike, *, tolerance: float = 1e-12, most_steps: int = 50
) -> CorrectedPoints:
    """Return the points to command so that a machine with a volumetric error reaches the wanted.

    Parameters
    ----------
    error : callable
        From arrays x, y, z (n,) in m to (Ex, Ey, Ez) in m, actual - nominal at the *commanded*
        position; a number stands for all points.
    points : array_like, shape (n, 3), m
        Wanted positions.
    tolerance : float, m, optional
        Largest residual, > 0.
    most_steps : int, optional
        Of the iteration, >= 1.

    Returns
    -------
    CorrectedPoints
        Commands, residual, steps and contraction.

    Raises
    ------
    DataError
        If the points have another shape, or tolerance or steps are out of range.
    InvalidSamplesError
        If a point or an error is not a finite number, or the errors have another shape.
    UnitError
        If the tolerance cannot be in metres.
    NotConvergedError
        If the residual does not shrink, or not enough within the steps.

    Notes
    -----
    Solves ``p + E(p) = target`` by ``p <- target - E(p)``, which converges where E changes by less
    than its argument: any machine whose errors grow by less than 1 m per m. The first step is the
    usual compensation ``-E(target)``; what the others add is the error of reading it at the wrong
    place.

    Examples
    --------
    >>> found = corrected_points(lambda x, y, z: (0.0, 0.0, 1e-6), [[0.0, 0.0, 2e-3]])
    >>> round(found.command[0, 2].item() * 1e6, 9), found.steps
    (1999.0, 1)
    """
    target = real_array(points, "points")
    if not callable(error):
        raise DataError(f"the error must be a function of x, y and z, got {type(error).__name__}")
    if target.ndim != 2 or target.shape[1] != 3 or not target.size:
        raise DataError(f"points must have the shape (n, 3) in m, got {target.shape}")
    if not np.isfinite(target).all():
        n = int(np.flatnonzero(~np.isfinite(target).all(axis=1))[0])
        raise InvalidSamplesError(f"point {n} is {target[n].tolist()}: leave it out")
    tolerance = length(tolerance, "tolerance", 1e-2)
    numbers.count(most_steps, "most_steps")
    command = target - _errors_at(error, target)
    before, contraction = math.inf, 0.0
    for step in range(1, most_steps + 1):
        residual = command + _errors_at(error, command) - target
        worst = float(np.abs(residual).max())
        contraction = 0.0 if step == 1 else worst / before
        if worst <= tolerance:
            said = (
                f"the iteration shrinks by {contraction:.2g} a step only: the error changes by that much "
                "of its position, which no sound machine does; check its units"
            )
            shown = (said,) if contraction > 0.1 else ()
            return CorrectedPoints(command, target, residual, step, contraction, shown)
        if worst >= before:
            at = int(np.abs(residual).max(axis=1).argmax())
            raise NotConvergedError(
                f"the residual no longer shrinks: {format_length(worst)} after {step} steps at "
                f"point {at}, {[float(v) for v in target[at]]} m; the error changes there by as "
                "much as its position (or the tolerance is below its rounding): check its units"
            )
        before = worst
        command = command - residual
    raise NotConvergedError(
        f"the residual is still {format_length(before)} after {most_steps} steps, more than "
        f"{format_length(tolerance)}; allow more steps, or check the units of the error"
    )


def _section(
    form: Form, x: FloatArray, azimuth: FloatArray, dy: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return height, slopes along machine x and y, rho and theta of the target at a tool place."""
    cosine, sine = np.cos(azimuth), np.sin(azimuth)
    px, py = x * cosine - dy * sine, x * sine + dy * cosine
    height, slopes, _ = form.expansion(px, py, [], slopes=True)
    if slopes is None:  # pragma: no cover - slopes=True promises them
        raise DataError(f"{form.name} gives no slopes")
    along = cosine * slopes[0] + sine * slopes[1]
    across = cosine * slopes[1] - sine * slopes[0]
    rho = np.hypot(x, dy)
    return height, along, across, rho, azimuth + np.arctan2(dy, x)


def _landed(form: Form, r: FloatArray, azimuth: FloatArray, setting: ToolSetting) -> FloatArray:
    """Return the machine x that is really cut: ``x = r + dx + dR sin(phi(x))``."""
    start = r + setting.dx
    if setting.dR == 0.0:
        return start
    x = start

    def missed(at: FloatArray) -> FloatArray:
        _, slope, _, _, _ = _section(form, at, azimuth, setting.dy)
        return at - start - setting.dR * slope / np.sqrt(1.0 + slope * slope)

    h = 1e-9 + 1e-6 * np.abs(start)
    close = _CLOSE + 4e-16 * float(np.abs(start).max())
    worst, folds = math.inf, False
    for _ in range(_MOST_STEPS):
        now = missed(x)
        steepness = (missed(x + h) - now) / h
        folds = folds or bool((steepness <= 0.0).any())
        step = now / np.where(steepness > _SHALLOWEST, steepness, 1.0)
        x = x - step
        worst = float(np.fmax.reduce(np.abs(step)))
        if worst <= close or folds:
            break
    if worst > close or folds:
        raise NotConvergedError(
            f"dR = {format_length(setting.dR)} is larger than a concave radius of curvature of the "
            f"{form.name}: a nose that large cannot cut it, and no path corrects that; take a "
            "smaller nose"
        )
    return x


def left_over(
    setting: ToolSetting, effect: FloatArray, rho: FloatArray
) -> tuple[FloatArray | None, dict[str, float], list[str]]:
    """Return u of the cut height, P-V per factor for one u, and what is not known."""
    cov = setting.covariance
    if cov is None:
        return (
            None,
            {},
            ["the residual is not predicted: the uncertainty of the setting is not known"],
        )
    shown = np.abs(effect).max(axis=1)
    free = np.isinf(np.diag(cov))
    if (free & (shown > 0.0)).any():
        names = ", ".join(n for n, f in zip(FACTORS, free, strict=True) if f)
        return None, {}, [f"the residual is not predicted: {names} is not determined"]
    cov = np.where(np.isfinite(cov), cov, 0.0)
    u = np.sqrt(np.maximum(np.einsum("in,ij,jn->n", effect, cov, effect), 0.0))
    each = np.ptp(effect, axis=1) * np.sqrt(np.diag(cov))
    found: dict[str, float] = dict(zip(FACTORS, each.tolist(), strict=True))
    found |= {"sum": float(each.sum()), "rss": math.sqrt(float((each**2).sum()))}
    return u, found, []


def _errors_at(error: Volumetric, points: FloatArray) -> FloatArray:
    x, y, z = (points[:, i].copy() for i in range(3))
    found = error(x, y, z)
    try:
        parts = [np.broadcast_to(as_float(part), x.shape) for part in found]
    except (TypeError, ValueError) as exc:
        raise InvalidSamplesError(
            f"the error must return (Ex, Ey, Ez) for {x.size} points: {exc}"
        ) from None
    if len(parts) != 3:
        raise InvalidSamplesError(f"the error must return (Ex, Ey, Ez), got {len(parts)} parts")
    values = np.stack(parts, axis=1)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise InvalidSamplesError(
            f"the error is {values[bad[0]].tolist()} at {points[bad[0]].tolist()} m: it is not known "
            "there; keep the path inside the measured volume"
        )
    return values
