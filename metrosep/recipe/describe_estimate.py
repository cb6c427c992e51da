"""The arrays of a separation of repeated runs, as tables that an output of kind "parts" writes."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.recipe.description import Description
from metrosep.separation.base import ErrorEstimate

__all__ = ["POINTS", "arrays_of"]

POINTS = 2001
"""Positions of the curve, evenly over the evaluation range: the estimate is a function of x."""


def arrays_of(estimate: ErrorEstimate) -> Description:
    """Return the tables of an estimate."""
    x = np.linspace(estimate.start, estimate.stop, POINTS)
    curve: dict[str, Any] = {"x_m": x}
    wanted: list[tuple[int | None, str]] = [(None, "error")]
    if len(estimate.directions) > 1:
        wanted += [(1, "error_forward"), (-1, "error_reverse")]
    for direction, name in wanted:
        curve[f"{name}_m"] = estimate.evaluate(x, direction=direction)
        curve[f"u_{name}_m"] = estimate.sd(x, direction=direction)
    frames = {n: getattr(estimate, n) for n in ("spectrum", "feed_spectra", "residual_psd")}
    frames["evidence"] = estimate.evidence
    tables = {n: {k: f[k].tolist() for k in f.columns} for n, f in frames.items() if len(f)}
    return Description(tables={"": curve, **tables})
