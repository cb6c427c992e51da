"""The surface that a wrongly set round nose cuts: exact, as the paper's sum, and its derivatives.

Frame of the workpiece, z out of the material. A commanded cut point is ``(r, theta_c, S)`` with
``S`` the nominal height there. The tip stands ``dx`` further out along the machine's x, ``dy``
towards growing workpiece azimuth, and the nose radius is ``dR`` larger than programmed while the
tip height is right. The edge lies in the plane of the spindle axis and x, so its normal is
``n = (-sin phi, cos phi)`` with ``tan phi = dS/dr`` at constant azimuth, the tool centre is
``P + R n``, and the envelope of the larger circle is ``P + dR (e_z - n)``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, NotConvergedError
from metrosep.core.units import format_length
from metrosep.forms.base import Form

Factor = Literal["dx", "dy", "dR"]

FACTORS: tuple[Factor, ...] = ("dx", "dy", "dR")

_BLOCK = 1 << 16
_MOST_STEPS = 60
_SHALLOWEST = 1e-3
_CLOSE = 1e-15
"""m: a radius found to this leaves less than 1e-6 nm of height on any cuttable slope."""


@dataclass(frozen=True, slots=True)
class Cut:
    """What was cut at some points of the workpiece."""

    # shape (n,), m: actual height; NaN in the core and where the surface is not defined
    height: FloatArray
    rho: FloatArray  # shape (n,): where on the workpiece, m and rad
    theta: FloatArray
    # shape (n,): derivatives of the actual height by rho (1) and by theta (m/rad)
    along_rho: FloatArray
    along_theta: FloatArray
    # shape (n,): derivatives of the actual height by the settings, dimensionless
    by_dx: FloatArray
    by_dy: FloatArray
    by_dR: FloatArray


def known_form(form: object) -> Form:
    """Return a form without unknown parameters; anything else is refused."""
    if not isinstance(form, Form):
        raise DataError(
            f"the nominal surface must be a form of metrosep.forms, got {type(form).__name__}"
        )
    if np.iscomplexobj(form.height(np.zeros(1), np.zeros(1))):
        raise DataError(
            f"the heights of {form.name} are complex numbers: give a form with real ones"
        )
    unknown = [k for k, v in form.parameters.items() if v is None]
    if unknown:
        raise DataError(
            f"{form.name} has no value for {', '.join(unknown)} yet: give one, or fit it first"
        )
    return form


def polar_slopes(
    form: Form, r: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return height, dz/dr and (dz/dtheta)/r of a form; negative r is the other side."""
    cosine, sine = np.cos(theta), np.sin(theta)
    height, slopes, _ = form.expansion(r * cosine, r * sine, [], slopes=True)
    if slopes is None:  # pragma: no cover - slopes=True promises them
        raise DataError(f"{form.name} gives no slopes")
    along_x, along_y = slopes
    return height, cosine * along_x + sine * along_y, cosine * along_y - sine * along_x


def exact_cut(
    form: Form, rho: FloatArray, theta: FloatArray, dx: float, dy: float, dR: float
) -> Cut:
    """Return what is cut at workpiece points, and how it changes with the setting.

    The derivatives follow from the envelope: at fixed tool position the height changes with the
    slope at the contact, whatever dR.
    """
    core = rho < abs(dy)
    at = np.where(core, np.nan, rho)
    in_plane = np.sqrt((at - dy) * (at + dy))
    turned = np.arctan2(dy, in_plane)
    theta_c = theta - turned
    x = in_plane - dx
    r = x
    if dR != 0.0:
        cause = f"dR = {format_length(dR)}"
        r = commanded_radius(form, x, theta_c, lambda t: dR * t / np.sqrt(1.0 + t * t), cause)
    height, slope, tangential = polar_slopes(form, r, theta_c)
    secant = np.sqrt(1.0 + slope * slope)
    missed = x - dR * slope / secant - r
    z = height + dR * (1.0 - 1.0 / secant) + slope * missed
    along_angle = r * tangential
    with np.errstate(divide="ignore", invalid="ignore"):
        along_rho = (slope * at + along_angle * dy / at) / in_plane
        by_dy = -(slope * dy + along_angle) / in_plane
    if dy == 0.0:
        on_axis = rho == 0.0
        along_rho = np.where(on_axis, slope, along_rho)
        by_dy = np.where(on_axis, -tangential, by_dy)
    return Cut(z, rho, theta, along_rho, along_angle, -slope, by_dy, 1.0 - secant)


def commanded_radius(
    form: Form,
    x: FloatArray,
    theta: FloatArray,
    shift: Callable[[FloatArray], FloatArray],
    cause: str,
) -> FloatArray:
    """Return r with ``r + shift(dS/dr(r, theta)) = x``, the cut point that left its mark at x."""
    cosine, sine = np.cos(theta), np.sin(theta)

    def moved(at: FloatArray) -> FloatArray:
        along_x, along_y = form.slopes(at * cosine, at * sine)
        return shift(cosine * along_x + sine * along_y)

    missed = moved(x)
    r, other = x - missed, x
    close = _CLOSE + 4e-16 * float(np.fmax.reduce(np.abs(x), axis=None, initial=0.0))
    worst = 0.0
    for _ in range(_MOST_STEPS):
        now = r + moved(r) - x
        difference = now - missed
        steepness = np.where(difference == 0.0, 1.0, difference) / np.where(
            r == other, 1.0, r - other
        )
        steepness = np.where((r == other) | (difference == 0.0), 1.0, steepness)
        step = now / np.maximum(steepness, _SHALLOWEST)
        other, missed, r = r, now, r - step
        worst = float(np.fmax.reduce(np.abs(step), axis=None, initial=0.0))
        if worst <= close:
            break
    near = 1e-9 + 1e-6 * np.abs(r)
    folds = ((moved(at + near) - moved(at)) / near <= -1.0 for at in (r, x))
    if worst > close or any(bool(f.any()) for f in folds):
        raise NotConvergedError(
            f"{cause} is larger than a radius of curvature of the {form.name} "
            "along rho, so that points of the path leave no single mark: a nose that wrong "
            "gouges; check dR, and the nose with gouge_check"
        )
    return r


def paper_errors(
    form: Form, rho: FloatArray, theta: FloatArray, dx: float, dy: float, dR: float
) -> dict[Factor, FloatArray]:
    """Return the error of each factor as the paper writes it, eq 12, 17 and 20, NaN in the core."""
    height, slope, _ = polar_slopes(form, rho, theta)
    core = rho < abs(dy)
    drho = np.hypot(rho, dy) - rho
    turned = np.arctan2(dy, rho)
    moved, _, _ = polar_slopes(form, rho - drho, theta - turned)
    found: dict[Factor, FloatArray] = {
        "dx": -dx * slope,
        "dy": moved - height if dy != 0.0 else 0.0 * height,
        "dR": -dR * (np.sqrt(1.0 + slope * slope) - 1.0),
    }
    return {k: np.where(core, np.nan, v) for k, v in found.items()}


def height_errors(
    form: Form,
    x: FloatArray,
    y: FloatArray,
    setting: tuple[float, float, float],
    *,
    exact: bool,
) -> FloatArray:
    """Return actual - nominal at flat arrays of points; NaN in the core and off the form."""
    found = np.empty(x.size)
    for first in range(0, x.size, _BLOCK):
        part = slice(first, first + _BLOCK)
        rho, theta = np.hypot(x[part], y[part]), np.arctan2(y[part], x[part])
        if exact:
            cut = exact_cut(form, rho, theta, *setting).height
            found[part] = cut - form.height(x[part], y[part])
        else:
            parts = paper_errors(form, rho, theta, *setting)
            found[part] = parts["dx"] + parts["dy"] + parts["dR"]
    return found
