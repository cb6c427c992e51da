"""Tips whose contacts lie on a spiral: X and Z both follow the surface.

The contact at (rho, theta) fixes the tip: ``X = sqrt(rho^2 - y^2) - x``, ``azimuth = theta - atan2(y,
X + x)``, ``Z = S - z`` with the point (x, y, z) of the edge that touches there, in the machine frame of
the tip. With a measured waviness the contacts of the round edge are taken, and Z is the height at which
the edge as it is just touches: the contact leaves the spiral by what the waves move it.
specs/cutting-path.md, section 3, servo "XZ".
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import DataError, InvalidSamplesError, LimitError
from metrosep.core.units import format_length
from metrosep.forms.base import Form
from metrosep.process.path_points import SpiralPath
from metrosep.process.tips import Edge, tip_heights

_BLOCK, _STEPS = 1 << 16, 6
"""Contacts at once; steps for the azimuth of the tip, each 1e-3 of the last."""
_GOUGES = 1e-11
"""m: a tip that stands that much too low cuts the surface somewhere else."""


def contact_path(
    form: Form, rho: FloatArray, theta: FloatArray, edge: Edge
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[str, ...]]:
    """Return X, azimuth and Z of tips with their contacts at flat arrays of places, and messages."""
    circle = replace(edge, profile=None)
    X, azimuth, Z = np.empty(rho.size), np.empty(rho.size), np.empty(rho.size)
    for first in range(0, rho.size, _BLOCK):
        part = slice(first, first + _BLOCK)
        X[part], azimuth[part], Z[part] = tips_at(form, rho[part], theta[part], circle)
    bare = np.flatnonzero(np.isnan(Z))
    if bare.size:
        raise InvalidSamplesError(
            f"the {form.name} has no height at {bare.size} contacts of servo XZ, the first at rho = "
            f"{format_length(float(rho[bare[0]]))}, azimuth {math.degrees(float(theta[bare[0]])) % 360.0:.4g} degrees: give "
            'a form that goes on there, end the path before, or take servo="Z", which needs no height under the tip'
        )
    behind = np.flatnonzero(~(X >= 0.0))
    if behind.size:
        at = float(rho[behind].max())
        raise LimitError(
            f"with servo XZ the tip would pass beyond the spindle axis for contacts within "
            f"{format_length(at)} of it, where the edge runs backwards: end the path on a core of that "
            'radius, or take servo="Z"'
        )
    lowest, _, said = tip_heights(form, X, azimuth, edge)
    swing = f"X leaves the spiral by {format_length(float(np.ptp(X - rho)))} P-V"
    if edge.profile is not None:
        return X, azimuth, lowest, (swing, *said)
    low = lowest - Z
    worst = int(np.nanargmax(low))
    if low[worst] > _GOUGES:
        raise LimitError(
            f"with servo XZ the nose cuts {format_length(float(low[worst]))} into the {form.name} beside "
            f"the contact at rho = {format_length(float(rho[worst]))}, azimuth "
            f"{math.degrees(float(theta[worst])) % 360.0:.4g} degrees: take a smaller nose"
        )
    return X, azimuth, Z, (swing, *said)


def tips_at(
    form: Form, rho: FloatArray, theta: FloatArray, edge: Edge
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return X, azimuth and Z of tips of a round edge that touch at flat arrays of places."""
    px, py = rho * np.cos(theta), rho * np.sin(theta)
    height, slopes, _ = form.expansion(px, py, [], slopes=True)
    if slopes is None:  # pragma: no cover - slopes=True promises them
        raise DataError(f"{form.name} gives no slopes")
    cy, sy = math.cos(edge.yaw), math.sin(edge.yaw)
    azimuth, along, x, z = theta, rho, np.zeros(rho.size), np.zeros(rho.size)
    for _ in range(_STEPS):
        c, s = np.cos(azimuth), np.sin(azimuth)
        sx, sy_ = c * slopes[0] + s * slopes[1], c * slopes[1] - s * slopes[0]
        # slopes in the frame of the rake face, turned by the yaw: tan psi = sX / (kz + sigma sY ky)
        psi = np.arctan2(cy * sx + sy * sy_, edge.up + edge.lean * (cy * sy_ - sy * sx))
        x, y, z = edge.point(psi)
        with np.errstate(invalid="ignore"):
            along = np.sqrt((rho - y) * (rho + y))
        azimuth = theta - np.arctan2(y, along)
    return along - x, azimuth, height - z


def refuse_fitted(spiral: SpiralPath) -> None:
    """Refuse a path with heights fitted between its points of Z, for X follows too."""
    if spiral.knots == "least-squares":
        raise DataError(
            'knots="least-squares" are heights fitted between the points of Z alone: with servo "XZ" leave '
            "knots out"
        )
