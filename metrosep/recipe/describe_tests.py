"""Results of standard tests in a result document: quantities, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.recipe.charts import curve, curve_chart, harmonic_chart, panel, plain, thin
from metrosep.recipe.description import Description, named

__all__ = [
    "diagonals_of",
    "positions_of",
    "spindle_of",
    "straightness_of",
    "zero_of",
]

_MOST_REVOLUTIONS = 60
_MOST_ANGLES = 720
_HARMONICS = 60


def positions_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PositioningTest`."""
    frame = produced.targets_frame()
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    return Description(
        dict(produced.table),
        (_positions_chart(produced),),
        {"": columns},
        document={"by_target": {k: plain(v, digits=12) for k, v in columns.items()}},
        audit=_with_unit(produced.audit, ("travel",), *_TRAVEL[produced.audit.get("unit", "m")]),
    )


_TRAVEL = {"m": ("_mm", 1e3), "rad": ("_deg", 180.0 / math.pi)}
_ERRORS = {"m": ("_nm", 1e9), "rad": ("_urad", 1e6)}
_SPINDLE_SI = (
    "centre_cos", "centre_sin", "drift_per_revolution", "level", "u_drift_per_revolution"
)  # fmt: skip
"""Entries of the audit of a spindle test that are in SI; what people read has a unit suffix."""


def _with_unit(
    audit: Mapping[str, Any], keys: Sequence[str], suffix: str, factor: float
) -> dict[str, Any]:
    """Return an audit with the entries that are in SI in another unit, named by a suffix."""
    return {
        f"{k}{suffix}" if k in keys else k: v * factor if k in keys and v is not None else v
        for k, v in audit.items()
    }


def _positions_chart(produced: Any) -> dict[str, Any]:
    low, high = produced.R_interval
    columns = ("forward", "backward", "mean_forward", "mean_backward", "sd_forward", "sd_backward")
    return {
        "kind": "positions",
        "title": "Positioning test",
        "caption": "Error (reached − target) over target. Circles, full line: mean forward; "
        "squares, dashed: mean backward; bands: two standard deviations; points: single readings.",
        "unit": produced.audit.get("unit", "m"),
        "targets": plain(produced.targets, digits=12),
        **{
            k: None if getattr(produced, k) is None else plain(getattr(produced, k))
            for k in columns
        },
        "values": {k: [q.value, q.u] for k, q in produced.table.items()},
        "interval": [low, high],
        "unbiased": produced.R_unbiased,
        "confidence": produced.confidence,
    }


def spindle_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `SpindleMotion`."""
    unit = produced.unit
    columns = {
        "angle_rad": produced.angle,
        f"synchronous_{unit}": produced.synchronous_motion,
        f"asynchronous_range_{unit}": produced.asynchronous_range,
        f"asynchronous_sd_{unit}": produced.asynchronous_sd,
    }
    harmonics = produced.harmonics
    last = min(harmonics.k.size, _HARMONICS)
    bars = harmonic_chart(
        "Harmonics of the synchronous motion",
        harmonics.k[:last],
        harmonics.amplitude[:last],
        u=harmonics.u[:last],
        suppressed=harmonics.removed,
        unit=unit,
        caption="Amplitude of each undulation per revolution with ± 2 standard uncertainties, from "
        "the scatter between revolutions; hatched: removed."
        + (f" Drawn up to {_HARMONICS}." if harmonics.k.size > last else ""),
    )
    return Description(
        dict(produced.table),
        (_polar_chart(produced), bars),
        {"": columns},
        document={
            "direction": produced.direction,
            "sensitive": produced.sensitive,
            "center": produced.center,
            "centre": list(produced.centre),
        },
        audit=_with_unit(produced.audit, _SPINDLE_SI, *_ERRORS[unit]),
    )


def _polar_chart(produced: Any) -> dict[str, Any]:
    """Return some revolutions, before them the envelope of all: no extreme is hidden."""
    low, high = produced.motion.min(axis=0), produced.motion.max(axis=0)
    curves = np.stack([produced.synchronous_motion, low, high, produced.asynchronous_range])
    index = thin(produced.angle, curves, most=_MOST_ANGLES)
    step = -(-len(produced.motion) // _MOST_REVOLUTIONS)
    rows = np.vstack([low, high, produced.motion[::step]])[:, index]
    words = "Dashed: the two circles of the synchronous value. Shaded: all revolutions."
    if step > 1:
        words += f" Every revolution in {step} is drawn as a line."
    return {
        "kind": "polar",
        "title": "Polar chart",
        "caption": words,
        "unit": produced.unit,
        "angle": plain(produced.angle[index]),
        "synchronous": plain(produced.synchronous_motion[index]),
        "asynchronous_range": plain(produced.asynchronous_range[index]),
        "motion": plain(rows, digits=4),
        "n_revolutions": len(produced.motion),
        "values": {k: produced[k].value for k in ("synchronous", "asynchronous", "total")},
        **{k: getattr(produced, k) for k in ("direction", "sensitive", "center")},
    }


def straightness_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `MotionStraightness`."""
    found = {"straightness": produced.quantity, **produced.values}
    found |= {f"slope_{k}": replace(q, unit="rad") for k, q in produced.slopes.items()}
    found = named(found)
    x, rest = produced.x, produced.residual
    chart = curve_chart(
        "Straightness of the motion",
        ("position", "m"),
        [panel("deviation from the reference line", "m", [curve(produced.reference, x, rest)])],
        caption=f"Removed: the line of the reference {produced.reference}. Filter: none. "
        "The width of the band along the ordinate is the straightness.",
    )
    columns = {"x_m": x, "deviation_m": rest}
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def diagonals_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `DiagonalTest`."""
    found: dict[str, Quantity] = {"E": produced.systematic}
    if produced.reversal is not None:
        found["B"] = produced.reversal
    for name, q in produced.length_errors.items():
        found[f"{name}.length_error"] = q
    for name, test in produced.tests.items():
        found |= {f"{name}.{k}": test[k] for k in ("E", "B", "R", "A") if k in test}
    if produced.squareness is not None:
        known = {f"a_{k}": q for k, q in produced.squareness.angles.items()}
        known |= {f"scale_{k}": q for k, q in produced.squareness.scales.items()}
        found |= {k: q for k, q in known.items() if math.isfinite(q.value)}
    found = named(found)
    panels = [_diagonal(name, test) for name, test in produced.tests.items()]
    chart = curve_chart(
        "Deviations along the diagonals",
        ("distance", "m"),
        panels,
        caption="Mean error (reached − target) over the distance along each diagonal.",
    )
    frame = produced.to_frame().reset_index()
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    audit: Mapping[str, Any] = produced.audit
    return Description(found, (chart,), {"": columns}, audit=audit)


def _diagonal(name: str, test: Any) -> dict[str, Any]:
    ways = (("forward", test.mean_forward), ("backward", test.mean_backward))
    curves = [curve(way, test.targets, m) for way, m in ways if np.isfinite(m).any()]
    return panel(name, "m", curves)


def zero_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `ZeroCalibration`."""
    return Description({"zero": produced.quantity}, audit=produced.audit)
