"""The small picture of a result for the index of a batch: ``thumb.png``, 96 pixels wide, at most 8 kB."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core._thumbnails import colour_png, profile_thumbnail
from metrosep.recipe.describe.charts import decimated, display_limits

__all__ = ["THUMB", "thumbnail"]

THUMB = "thumb.png"
_SIDES, _MOST_BYTES = (96, 80, 64, 48), 8192


def thumbnail(document: Mapping[str, Any]) -> bytes | None:
    """Return the picture of what was judged: the last map, else the first curve; None where there is neither.

    A pixel that stands out keeps its value, as in the pictures of a report.
    """
    charts = (document.get("separation") or {}).get("charts") or []
    maps = [c for c in charts if c.get("kind") == "maps" and c.get("parts")]
    if maps:
        rows = next(iter(maps[-1]["parts"].values()))
        z = _numbers(rows)
        if z.ndim == 2 and np.isfinite(z).any():
            return _of_map(z, maps[-1].get("limits"))
    for chart in charts:
        for panel in chart.get("panels") or []:
            for curve in panel.get("curves") or []:
                x, y = _numbers(curve["x"]), _numbers(curve["y"])
                if x.size > 1 and np.isfinite(y).any():
                    return profile_thumbnail(x, y)
    plots = document.get("plots") or {}
    if plots.get("x_mm"):
        return profile_thumbnail(_numbers(plots["x_mm"]), _numbers(plots["estimate_nm"]))
    return None


def _of_map(z: FloatArray, limits: Any) -> bytes:
    low, high = limits or display_limits(z)[:2]
    made = b""
    for side in _SIDES:
        made = colour_png(decimated(z, max(1, -(-max(z.shape) // side))), float(low), float(high))
        if len(made) <= _MOST_BYTES:
            break
    return made


def _numbers(values: Any) -> FloatArray:
    """Return numbers of a document, None as NaN."""
    return np.array(values, dtype=np.float64)
