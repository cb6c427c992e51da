"""Where a turned program begins, so that the part is cut up to its rim, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process.cutting.course_errors import rise_beside
from metrosep.process.cutting.edge_errors import Servo
from metrosep.process.cutting.servos import tips_at
from metrosep.process.interpolation import arc_length
from metrosep.process.nose import RoundNose, Sense
from metrosep.process.nose_checks import NoseCheck, gouge_check
from metrosep.process.path_points import SpiralPath
from metrosep.process.tips import Edge, tips

_AZIMUTHS = 720
"""Of the rim at which a job looks how far out the tip must begin."""
_FREE_END = 3
"""Points that keep the free end of a spline off the part."""
_ROUNDING = 1e-9
"""Of the radius: a place that much inside the rim is on it."""
_HALVINGS = 14
_LOOKED_AT, _TRIED, _LEVELS = 8, 33, 6
"""Azimuths where most may stay at the rim; places of the tip that are tried for each, again and again closer."""
_IS_LEFT = 1e-11
"""m: less that stays is that of the place of the contact."""


def outside_the_rim(form: Form, radius: float, feed: float, edge: Edge, servo: Servo) -> float:
    """Return how far outside the rim the tip of an edge must begin, in m."""
    turns = 1.5 * feed
    turn = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    if servo == "XZ":  # the contacts are on the spiral
        out = radius + turns
        z = form.height(out * np.cos(turn), out * np.sin(turn))
        _require_heights(form, radius, np.isnan(z), out, turn)
        return turns
    starts, _, z = _at_rim(form, radius, turn, edge)
    _require_heights(form, radius, np.isnan(z), radius, turn)
    # on a bowl the contact lies outside the tip already
    return max(0.0, float(starts.max()) - radius + turns)


def _at_rim(
    form: Form, radius: float, turn: FloatArray, edge: Edge, inwards: float = 1.0
) -> FloatArray:
    """Return rows X, azimuth and Z of tips that touch at the rim, or nearly where rounding leaves no height there.

    Of the core what is nearer lies outwards, -1.
    """
    rows = np.stack(tips_at(form, np.full(turn.size, radius), turn, edge))
    lost = np.flatnonzero(~np.isfinite(rows[2]) | ~np.isfinite(rows[0]))
    if lost.size:
        near = np.full(lost.size, radius * (1.0 - inwards * _ROUNDING))
        rows[:, lost] = np.stack(tips_at(form, near, turn[lost], edge))
    return rows


def led_in(spiral: SpiralPath, out: float, form: Form, edge: Edge | None) -> SpiralPath:
    """Return the path with points from a distance outside its rim on, and those that the end of a spline needs.

    The tip of an edge begins where the edge still touches the form at every azimuth, if that is nearer.
    """
    points = points_before(spiral, out)
    count = _FREE_END + math.ceil(points)
    if edge is not None:
        angle = spiral.step if spiral.distribution == "CA" else spiral.step / spiral.radius
        far = out + (count - points) * angle * spiral.feed / (2.0 * math.pi)
        touches = _touches_outside(form, spiral.radius, far, edge)
        if touches < far:
            count = math.floor(points_before(spiral, touches))
    return spiral.with_options(lead_in=count)


def _touches_outside(form: Form, radius: float, far: float, edge: Edge) -> float:
    """Return how far outside the rim an edge still touches all round, up to a distance; it where it never does."""
    turn = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)

    def leaves(out: float) -> bool:
        made = tips(form, np.full(turn.size, radius + out), turn, edge, strict=False)
        return bool(np.isnan(made.z).any())

    if not leaves(far) or leaves(0.0):
        return far  # nothing to shorten, or nothing that shorter would help
    near, beyond = 0.0, far
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + beyond)
        near, beyond = (near, middle) if leaves(middle) else (middle, beyond)
    return near


@lru_cache(maxsize=4)  # a job asks for its plan, its program and its budget
def fits_in_ring(
    form: Form, nose: RoundNose, sense: Sense | None, core: float, radius: float
) -> NoseCheck:
    """Return whether a nose fits between core and rim, and whether what stands beyond lets it reach both.

    Of all places of the part the rim is nearest to what stands outside, and the core to what stands in it: a
    nose that reaches them reaches the rest, because the slope of the edge grows outwards.
    """
    found = gouge_check(form, nose, region=(core, radius))
    if not found.ok:
        return found
    edge = replace(Edge.of(nose, sense), profile=None)
    stands = _kept_off(form, edge, radius, 1.0, ("outside the rim", "rim", "smaller radius"))
    if stands is None and core > 0.0:
        stands = _kept_off(
            form, edge, core, -1.0, ("in the core", "edge of the core", "larger core")
        )
    if stands is None:
        return found
    left, said = stands
    return replace(found, ok=False, left=left, messages=(said, *found.messages))


def _kept_off(
    form: Form, edge: Edge, radius: float, side: float, words: tuple[str, str, str]
) -> tuple[float, str] | None:
    """Return what stays at a ring where the nose stands on what lies outside (1) or inside it, and the sentence."""
    turn = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    X, azimuth, z = _at_rim(form, radius, turn, edge, side)
    known = np.flatnonzero(np.isfinite(z) & (X >= 0.0))
    made = tips(form, X[known], azimuth[known], edge, strict=False)
    off = np.where(side * (made.rho - radius) > 0.0, made.z - z[known], 0.0)
    worst = np.argsort(-np.nan_to_num(off))[:_LOOKED_AT]
    if not off.size or not off[worst[0]] > _IS_LEFT:
        return None
    left = float(_left_at(form, edge, X[known][worst], radius, turn[known][worst]).max())
    rho, theta = float(made.rho[worst[0]]), math.degrees(float(made.theta[worst[0]])) % 360.0
    where, at, cure = words
    return left, (
        f"the nose stands on the {form.name} {where}, at rho = {format_length(rho)}, azimuth {theta:.4g} degrees, "
        f"and leaves up to {format_length(left)} at the {at} of the part; take a {cure} of the part, or a smaller nose"
    )


def points_before(spiral: SpiralPath, out: float) -> float:
    """Return how many steps of a path lie between its rim and a distance outside it."""
    turns = out / spiral.feed
    if spiral.distribution == "CA":
        return turns * 2.0 * math.pi / spiral.step
    ends = [2.0 * math.pi * (spiral.turns + k) for k in (turns, 0.0)]
    far, rim = (float(arc_length(u, spiral.feed)) for u in ends)
    return (far - rim) / spiral.step


def _left_at(
    form: Form, edge: Edge, X: FloatArray, radius: float, theta: FloatArray
) -> FloatArray:
    """Return how high above places of the rim the edge passes at least that cuts nothing, from near some tips on."""
    low, high = X - edge.radius, X + edge.radius
    row, least = np.arange(X.size), np.full(X.size, np.inf)
    for _ in range(_LEVELS):
        tried = low[:, None] + np.outer(high - low, np.linspace(0.0, 1.0, _TRIED))
        places = np.repeat(theta, _TRIED)
        at = np.full(places.size, radius)
        rise = rise_beside(form, edge, tried.ravel(), at, places, finds=tips)
        rise = rise.reshape(tried.shape)
        k = np.argmin(rise, axis=1)
        least = np.minimum(least, rise[row, k])
        low, high = tried[row, np.maximum(k - 1, 0)], tried[row, np.minimum(k + 1, _TRIED - 1)]
    return least


def rim_said(
    spiral: SpiralPath, X: FloatArray, contacts: FloatArray, lead_in: Callable[[], int]
) -> list[str]:
    """Return what is to be said of a beginning whose contacts at tips are known, a turn or more of them."""
    radius = spiral.radius
    first = spiral.feed + 1e-9 * radius
    starts = float(np.nanmin(contacts[X[0] - X <= first]))
    said = []
    if starts < radius - 0.5 * first:  # more stays than between two turns
        try:
            needed = lead_in()
            cure = (
                f"give lead_in = {needed}"
                if needed > spiral.lead_in
                else "further out the edge touches no form at some azimuth: take a smaller radius, or a nose whose "
                "window reaches there"
            )
        except InvalidSamplesError:
            cure = "take a smaller radius, for the form ends at the rim"
        said.append(
            f"the first turn touches the part up to rho = {format_length(starts)} only: outside it, up to the "
            f"rim at {format_length(radius)}, the flank of the nose alone cuts and leaves more than between "
            f"turns; {cure}"
        )
    elif X[0] > radius + first:
        outer = float(np.nanmax(contacts[X[0] - X <= first]))
        less = (
            "" if outer > X[0] else " (with a smaller lead_in the outermost ring stays too high)"
        )
        said.append(
            f"the tip begins {format_length(float(X[0]) - radius)} outside the rim and touches up to rho = "
            f"{format_length(outer)}: the machine must reach there{less}"
        )
    return said


def _require_heights(
    form: Form, radius: float, missing: NDArray[np.bool_], rho: float, turn: FloatArray
) -> None:
    """Raise InvalidSamplesError for a form that ends before the radius at which contacts are to lie."""
    if missing.any():
        raise InvalidSamplesError(
            f"the {form.name} has no height at {100.0 * missing.mean():.3g} % of the circle of "
            f"{format_length(rho)} about the spindle axis, the first at azimuth "
            f"{math.degrees(float(turn[np.argmax(missing)])):.4g} degrees, and the part is to be cut up to its "
            f"rim at {format_length(radius)}: take a smaller radius, give a form that reaches there, or give "
            "lead_in = 3 where the part ends there in truth and air is right"
        )
