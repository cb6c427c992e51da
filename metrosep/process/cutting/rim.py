"""Where a turned program begins, so that the part is cut up to its rim, and what is said of it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import InvalidSamplesError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process.cutting.edge_errors import Servo
from metrosep.process.cutting.servos import tips_at
from metrosep.process.interpolation import arc_length
from metrosep.process.path_points import SpiralPath
from metrosep.process.tips import Edge

__all__ = ["outside_the_rim", "points_before", "rim_said"]

_AZIMUTHS = 720
"""Of the rim at which a job looks how far out the tip must begin."""


def outside_the_rim(form: Form, radius: float, feed: float, edge: Edge, servo: Servo) -> float:
    """Return how far outside the rim the tip of an edge must begin, in m."""
    turns = 1.5 * feed
    turn = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
    if servo == "XZ":  # the contacts are on the spiral
        out = radius + turns
        z = form.height(out * np.cos(turn), out * np.sin(turn))
        _require_heights(form, radius, np.isnan(z), out, turn)
        return turns
    starts, _, z = tips_at(form, np.full(turn.size, radius), turn, edge)
    _require_heights(form, radius, np.isnan(z), radius, turn)
    # on a bowl the contact lies outside the tip already
    return max(0.0, float(starts.max()) - radius + turns)


def points_before(spiral: SpiralPath, out: float) -> float:
    """Return how many steps of a path lie between its rim and a distance outside it."""
    turns = out / spiral.feed
    if spiral.distribution == "CA":
        return turns * 2.0 * math.pi / spiral.step
    ends = [2.0 * math.pi * (spiral.turns + k) for k in (turns, 0.0)]
    far, rim = (float(arc_length(u, spiral.feed)) for u in ends)
    return (far - rim) / spiral.step


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
            cure = f"give lead_in = {lead_in()}"
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
