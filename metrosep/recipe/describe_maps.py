"""Maps of planes in a result document: quantities, files and charts."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.recipe.charts import curve, curve_chart, map_chart, panel
from metrosep.recipe.description import Description, extremes, quantity

__all__ = ["plane_map_of", "registration_of", "surfaces_of"]


def plane_map_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PlaneMap`."""
    surface, u = produced.surface, produced.u
    found = extremes("plane", surface.z, u.z, "m")
    found |= {"alpha": produced.alpha, "beta": produced.beta}
    charts = [_chart("Error of the plane", {"error": surface.z}, surface)]
    if np.isfinite(u.z).any():
        charts.append(_chart("Standard uncertainty of the plane", {"u": u.z}, surface))
    return Description(found, tuple(charts), maps={"error": surface, "u": u}, audit=produced.audit)


def _chart(title: str, maps: dict[str, Any], like: Any) -> dict[str, Any]:
    words = "Error = actual − nominal; the correction is its negative. Rows grow with y."
    return map_chart(
        title, maps, dx=like.dx, dy=like.dy, unit="m", caption=words, origin=like.origin
    )


def surfaces_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PlaneFit`."""
    found: dict[str, Quantity] = {}
    panels, tables = [], {}
    for name in ("x", "y"):
        line, u = getattr(produced, f"along_{name}"), getattr(produced, f"u_{name}")
        found |= extremes(f"along_{name}", line.z, u.z, "m")
        panels.append(panel(f"error along {name} ± 2 u", "m", [curve("", line.x, line.z, u=u.z)]))
        key = "" if name == "x" else name
        tables[key] = {f"{name}_m": line.x, "error_m": line.z, "u_error_m": u.z}
    test = produced.interaction
    found |= {"alpha": produced.alpha, "beta": produced.beta}
    found["coupling"] = quantity(test.rms, "m", "RMS of what is neither f(x) nor g(y), noise off")
    found["coupling_p"] = quantity(test.p, "1", "probability of more coupling from noise alone")
    maps = {"model": produced.model, "residual": produced.residual}
    charts = (
        curve_chart("Errors of the two axes", ("position", "m"), panels),
        _chart("Sum model and what it leaves", {k: m.z for k, m in maps.items()}, produced.model),
    )
    return Description(found, charts, tables, maps, audit=produced.audit)


def registration_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `Registration`."""
    u = np.sqrt(np.maximum(np.diag(produced.cov), 0.0))
    words = "of the second map against the first, about the centre"
    found = {
        "shift_x": quantity(produced.shift_x, "m", f"shift along x {words}", u=u[0]),
        "shift_y": quantity(produced.shift_y, "m", f"shift along y {words}", u=u[1]),
        "angle": quantity(produced.angle, "rad", f"turn {words}, counter-clockwise", u=u[2]),
        "rms": quantity(produced.rms, "m", "RMS of what is left of the difference"),
    }
    return Description(found, audit=produced.audit)
