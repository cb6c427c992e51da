"""The error of an edge that is not the programmed one, and the cusps of the feed.

A path made for the nominal edge is cut by the real one, turns infinitely close:

    z(rho, theta) = min over psi of [ Z(X, phi) + z(psi) ],
    X = sqrt(rho^2 - y^2) - x(psi),  phi = theta - atan2(y(psi), X + x(psi)),

with the point (x, y, z) of the real edge and the nominal tip path Z. Error = actual - nominal along
z: positive is material left. specs/cutting-path.md, equations (10) and (18).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from metrosep.core import numbers
from metrosep.core._arrays import FloatArray
from metrosep.core.docs import described_by
from metrosep.core.errors import LimitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process._plain import length
from metrosep.process._setting_equations import bent, known_form, polar_gradient
from metrosep.process.nose import EdgeProfile, RoundNose, Sense, rake_error
from metrosep.process.setting_maps import positions
from metrosep.process.tips import Edge, tips
from metrosep.process.tool_settings import ToolSetting

Servo = Literal["Z", "XZ"]
_CLOSE = 1e-10
"""rad: of the angle that cuts; the height is then right to R psi^2, 1e-23 m."""
_FIRST_STEP, _WIDER, _MOST_STEPS = 0.01, 4.0, 60
_NODES = 5
"""Of the polynomial along the edge that ranks the crests of a wavy one."""
_PER_STEP = 4
"""Angles tried within a step of the table of a wavy edge."""


@described_by(rake_error, errors=False)
def edge_error(
    form: Form,
    x: ArrayLike,
    y: ArrayLike = 0.0,
    *,
    nose: RoundNose,
    actual: RoundNose | None = None,
    setting: ToolSetting | None = None,
    sense: Sense | None = None,
) -> FloatArray:
    """Return the error of a path that was made for one edge and is cut with another.

    Parameters
    ----------
    nose : RoundNose
        What the path was made for.
    actual : RoundNose, optional
        What cuts. If omitted it is `nose`, and the path was made without its measured waviness.
    setting : ToolSetting, optional
        How far the cutting tool stands off, and how much larger its radius is.
    sense : {"counterclockwise", "clockwise"}, optional
        How the tool goes round the part, seen from above; needed with rake, yaw or dy.

    Returns
    -------
    ndarray, m
        Actual - nominal along z; NaN within dy of the spindle axis, where nothing is cut.

    Raises
    ------
    DataError
        If the form or a nose is none, or the sense is needed.
    InvalidSamplesError
        If a position is not a finite number, or a tip stands where the form has no height.
    LimitError
        If the edge would cut beyond its window.
    UnitError
        If a position cannot be in metres.

    Notes
    -----
    A disc about the axis, as wide as a raked edge leaves the plane there, is not cut by one place of
    the edge; it has the value at ten times its radius.

    References
    ----------
    .. [1] specs/cutting-path.md, equation (10).

    Examples
    --------
    >>> from metrosep.forms import Toric
    >>> torus, place = Toric(Rb=110e-3, Rd=70e-3), (9e-3 * np.cos(0.5), 9e-3 * np.sin(0.5))
    >>> off = edge_error(torus, *place, nose=RoundNose(0.6e-3), setting=ToolSetting(dx=1e-6))
    >>> round(off.item() * 1e9, 3)
    -92.932
    """
    form = known_form(form)
    made = Edge.of(nose if actual is not None else replace(nose, edge=None), sense)
    cuts = Edge.of(nose if actual is None else actual, sense, setting)
    xs, ys = positions(x, y)
    rho, theta = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()
    along, across = polar_gradient(form, rho, theta)
    start = np.arctan2(along, cuts.up + cuts.lean * across)
    core = np.abs(cuts.point(start)[1] - cuts.dy)
    rho = np.fmax(rho, 10.0 * core)
    found = np.full(rho.shape, np.nan)
    cut = rho > abs(cuts.dy) * (1.0 + 1e-9)
    if cut.any():
        found[cut] = _cut(form, rho[cut], theta[cut], made, cuts, start[cut])
    error = found - form.height(rho * np.cos(theta), rho * np.sin(theta))
    return np.asarray(error.reshape(xs.shape))


def _cut(
    form: Form, rho: FloatArray, theta: FloatArray, made: Edge, cuts: Edge, start: FloatArray
) -> FloatArray:
    """Return the heights that are cut at flat arrays of places."""

    def tried(psi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return Z + z and its derivative by psi."""
        ex, ey, ez = cuts.point(psi)
        tx, ty, tz = cuts.tangent(psi)
        along = np.sqrt((rho - ey) * (rho + ey))
        stands, turned = along - ex, theta - np.arctan2(ey, along)
        tip = tips(form, stands, turned, made, strict=True)
        by_angle = made.by_azimuth(stands, tip.psi, tip.along_x, tip.along_y)
        rate = tip.along_x * (-ey * ty / along - tx) - by_angle * ty / along + tz
        return tip.z + ez, rate / cuts.radius

    low, high = np.full(rho.size, cuts.low), np.full(rho.size, cuts.high)
    psi = np.clip(start, low, high)
    if cuts.profile is not None:
        psi, low, high = _crest(tried, psi, cuts, cuts.profile)
    height, rate = tried(psi)
    # F falls towards the contact and rises beyond it: bracket where its derivative changes sign
    up = rate < 0.0
    near, far, d_near = psi.copy(), psi.copy(), np.abs(rate)
    d_far, step = np.full(rho.size, np.nan), np.full(rho.size, _FIRST_STEP)
    open_ = d_near > 0.0
    for _ in range(_MOST_STEPS):
        if not open_.any():
            break
        far = np.where(open_, np.clip(far + np.where(up, step, -step), low, high), far)
        rate = np.where(up, -1.0, 1.0) * tried(far)[1]
        stuck = open_ & (rate > 0.0) & ((far <= low) | (far >= high))
        if stuck.any():
            i = int(np.flatnonzero(stuck)[0])
            raise LimitError(
                f"the edge would cut beyond its window at rho = {format_length(float(rho[i]))}, "
                f"azimuth {math.degrees(float(theta[i])):.4g} degrees: it ends at "
                f"{math.degrees(float(far[i])):.4g} degrees from the tip"
            )
        still = open_ & (rate > 0.0)
        near, d_near = np.where(still, far, near), np.where(still, rate, d_near)
        d_far = np.where(open_ & ~still, -rate, d_far)
        open_, step = still, step * _WIDER
    for count in range(_MOST_STEPS):
        if not ((np.abs(far - near) > _CLOSE) & (d_near > 0.0)).any():
            break
        share = d_near / (d_near + d_far)
        share = np.where(np.isnan(share) | (count % 3 == 2), 0.5, share)
        psi = near + share * (far - near)
        height, rate = tried(psi)
        rate = np.where(up, -rate, rate)
        ahead = rate > 0.0
        near, d_near = np.where(ahead, psi, near), np.where(ahead, rate, d_near)
        far, d_far = np.where(ahead, far, psi), np.where(ahead, d_far, -rate)
        if float(np.abs(rate).max()) < 1e-13:
            break
    return height


def _crest(
    tried: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    start: FloatArray,
    cuts: Edge,
    profile: EdgeProfile,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the angle of a wavy edge that cuts deepest, and how far it is the only crest."""
    size = float(np.ptp(profile.deviation))
    # the circle rises by R psi^2 / 2 beside the contact: no crest further away reaches below it
    half = 2.0 * math.sqrt(2.0 * size / (cuts.radius * cuts.up)) + 1e-6
    fine = float(np.diff(profile.angle).min()) / _PER_STEP
    n = 2 * max(8, math.ceil(half / fine)) + 1
    angle = np.clip(start + np.linspace(-half, half, n)[:, None], cuts.low, cuts.high)
    nodes = np.cos(math.pi * (np.arange(_NODES) + 0.5) / _NODES)
    ranked = cuts.point(angle)[2]
    at = np.clip(start + half * nodes[:, None], cuts.low, cuts.high)
    tip = np.stack([tried(a)[0] - cuts.point(a)[2] for a in at])
    # Z along the edge is smooth: a polynomial through some angles will do to rank the crests
    scaled = np.linspace(-1.0, 1.0, n)
    basis = np.stack(
        [np.prod([(scaled - m) / (k - m) for m in nodes if m != k], axis=0) for k in nodes]
    )
    ranked = ranked + basis.T @ tip
    best = np.argmin(ranked, axis=0)
    each = np.arange(start.size)
    low, high = angle[np.maximum(best - 1, 0), each], angle[np.minimum(best + 1, n - 1), each]
    return angle[best, each], low, high


@described_by(edge_error)
def cusp_heights(
    form: Form,
    x: ArrayLike,
    y: ArrayLike = 0.0,
    *,
    nose: RoundNose,
    feed: float,
    servo: Servo = "Z",
    sense: Sense | None = None,
) -> FloatArray:
    """Return how high the cusps between two turns stand above the surface wanted.

    Parameters
    ----------
    nose : RoundNose
        Of the tool; its waviness is omitted.
    feed : float, m
        Advance per turn.
    servo : {"Z", "XZ"}, optional
        Whether tips or contacts lie on the spiral.

    Returns
    -------
    ndarray, m
        Peak to valley; the mean height is a third of it. NaN where the nose does not fit.

    Raises
    ------
    DataError
        If the servo mode is not known, or the sense is needed.

    Notes
    -----
    ``f^2 e''^2 / (8 (e'' - g''))`` with tips, ``f^2 (e'' - g'') / 8`` with contacts f apart: ``e'' =
    (c^2 + sX^2)^(3/2) / (R c^2)`` of the edge, ``g''`` of the section. On a flat both are
    ``f^2 / (8 R)``.

    Examples
    --------
    >>> from metrosep.forms import Sphere
    >>> at, nose = 0.705e-3, RoundNose(0.6e-3)
    >>> round(cusp_heights(Sphere(R=2e-3), at, nose=nose, feed=5e-6).item() * 1e9, 1)
    9.1
    """
    form = known_form(form)
    numbers.choice(servo, "servo", get_args(Servo))
    feed = length(feed, "feed")
    edge = Edge.of(replace(nose, edge=None), sense)
    xs, ys = positions(x, y)
    rho, theta = np.hypot(xs, ys).ravel(), np.arctan2(ys, xs).ravel()
    along, across = polar_gradient(form, rho, theta)
    own = edge.own_curvature(along, across)
    spare = own - bent(form, rho, theta, 1e-3 * nose.radius)
    spare = np.where(spare > 0.0, spare, np.nan)
    high = feed**2 * (spare if servo == "XZ" else own**2 / spare) / 8.0
    return np.asarray(high.reshape(xs.shape))
