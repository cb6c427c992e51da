"""The part that a machine with errors cuts, exactly, and as an instrument sees it.

A point that should lie at P lies at ``P + E(P)``. At a given (x, y) the height is that of the point
that came there: ``u + E_xy(u) = (x, y)``, ``z = f(u) + E_z(u)``, solved by iteration. An instrument
sees the part shifted, turned about z, tilted and raised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.errors import NotConvergedError
from metrosep.machine._numbers import TrialAmounts
from metrosep.machine._positions import Positions, axis_positions
from metrosep.machine.alignment import freedom_maps

__all__ = ["CutModel"]


_STEPS = 30

_ROUNDING = 1e-15
"""Of the largest radius: positions are not known better."""

_EXACT = ("shift_x", "shift_y", "rotation_z")


@dataclass(frozen=True, slots=True, eq=False)
class CutModel:
    """Heights of a cut part at measured positions."""

    chain: Any
    form: Any
    tool: tuple[float, float, float]
    positions: Positions | None
    exact: bool

    def error(self, x: FloatArray, y: FloatArray, errors: dict[str, float]) -> FloatArray:
        """Return E at nominal points of the part, shape (n, 3)."""
        z = self.form(x, y)
        q = axis_positions(self.chain, x, y, z, positions=self.positions, tool=self.tool)
        return np.asarray(
            self.chain.volumetric_error(q, TrialAmounts(errors), tool=self.tool, exact=self.exact),
            dtype=np.float64,
        )

    def part(self, x: FloatArray, y: FloatArray, errors: dict[str, float]) -> FloatArray:
        """Return the height of the cut part at (x, y); NaN where the form has none."""
        ux, uy = x, y
        reach = float(np.max(np.hypot(x, y), initial=0.0))
        found = self.error(ux, uy, errors)
        limit = 1e-9 * float(np.nanmax(np.abs(found), initial=0.0)) + _ROUNDING * reach
        for _ in range(_STEPS):
            vx, vy = x - found[:, 0], y - found[:, 1]
            moved = float(np.nanmax(np.hypot(vx - ux, vy - uy), initial=0.0))
            ux, uy = vx, vy
            found = self.error(ux, uy, errors)
            if moved <= limit:
                return np.asarray(self.form(ux, uy) + found[:, 2])
        raise NotConvergedError(
            f"errors of up to {np.nanmax(np.abs(found)):.3g} m move points of the part across each "
            "other (near its centre): leave the centre out, or fit fewer terms"
        )

    def seen(
        self, x: FloatArray, y: FloatArray, errors: dict[str, float], freedoms: dict[str, float]
    ) -> FloatArray:
        """Return the height that an instrument sees; turns about x and y to first order."""
        turn = freedoms.get("rotation_z", 0.0)
        sx, sy = x - freedoms.get("shift_x", 0.0), y - freedoms.get("shift_y", 0.0)
        px = np.cos(turn) * sx + np.sin(turn) * sy
        py = np.cos(turn) * sy - np.sin(turn) * sx
        height = self.part(px, py, errors)
        names = [n for n in freedoms if n not in _EXACT]
        if not names:
            return height
        slope = self.form.gradient(x, y)
        maps = freedom_maps(names, x=x, y=y, z=height, slope_x=slope[0], slope_y=slope[1])
        return np.asarray(height + maps @ np.array([freedoms[n] for n in names]))
