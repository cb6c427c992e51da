"""Results of standard tests in a result document: quantities, tables, charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray, is_turn
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.describe.charts import (
    bar_chart,
    curve,
    curve_chart,
    harmonic_chart,
    map_chart,
    panel,
    plain,
    thin,
)
from metrosep.recipe.describe.description import Description, extremes, named, quantity
from metrosep.separation.contract import (
    Separation,
    about_what_is_seen,
    suppressed_harmonics,
)

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


def turned_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `TurnedError`."""
    errors, unit = produced.errors, produced.cycles.metadata.get("z_unit", "m")
    found: dict[str, Quantity] = {}
    columns: dict[str, Any] = {"position_deg": np.degrees(errors.positions)}
    curves = []
    for name in ("forward", "reverse"):
        values, u = getattr(errors, name), getattr(errors, f"u_{name}")
        if values is not None:
            u = np.full(values.shape, np.nan) if u is None else u
            found |= extremes(name, values, u, unit)
            columns |= {f"{name}_{unit}": values, f"u_{name}_{unit}": u}
            curves.append(curve(name, errors.positions, values, u=u))
    if errors.lost_motion is not None:
        text = "mean of forward minus reverse over the positions"
        found["lost_motion"] = quantity(
            errors.lost_motion, unit, text, u=errors.u_lost_motion, symbol="B"
        )
    chart = curve_chart(
        "Mean error over the angle",
        ("angle", "rad"),
        [panel("error ± 2 u", unit, curves)],
        caption="Error = actual − nominal, zero at the reference; the correction is its negative.",
    )
    return Description(found, (chart,), {"": columns})


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


# ---- A `Separation` in a result document: all of it where it is short, charts where it is long ----

_MOST_VALUES = 20_000
"""Of all parts: beyond, the document keeps charts, and the parts are in their files."""


def separation_of(produced: Separation, inputs: Any = None) -> Description:
    """Return what a document holds of a separation."""
    found: dict[str, Quantity] = {}
    for name, values in produced.parts.items():
        unit, u = produced.units[name], produced.u[name]
        if values.ndim == 0:
            text = f"separated {name.replace('_', ' ')}"
            found[name] = quantity(values, unit, text, u=u, symbol=name)
        else:
            about, u, whole = about_what_is_seen(produced, name)
            if whole is None and name in produced.modes:
                whole = produced.covariance(name)
            found |= extremes(name, about, u, unit, whole)
    maps = _maps(produced)
    document = produced.to_dict()
    size = sum(v.size for v in produced.parts.values())
    short = size <= _MOST_VALUES
    if not short:
        document |= {"parts": {}, "u": {}, "coordinates": {}, "units": dict(produced.units)}
        document["not_stored"] = (
            f"{size} values of the parts are in the files of kind parts, not in this document"
        )
    return Description(
        found,
        (
            *([] if short and len(produced.coordinates) == 1 else curves_of(produced)),
            *_map_charts(produced),
            *_harmonics(produced),
        ),
        _tables(produced),
        maps,
        document,
        produced.audit,
    )


_OF_LASER = {
    "wavelength": "correction for the wavelength in the air that was",
    "dead_path": "correction for the change of the air in the dead path",
    "cosine": "correction for the angle between beam and motion",
    "pitch": "correction for the Abbe offset times pitch",
    "yaw": "correction for the Abbe offset times yaw",
    "expansion": "correction of the length to 20 degC",
    "total": "sum of the corrections, added to the reading; u that of the corrected reading",
}


def laser_quantities(air: Any, made: Any = None) -> dict[str, Quantity]:
    """Return corrections at the largest reading with their sum, or the wavelength; the index of air."""
    i = 0 if made is None else made.farthest
    n, u = (float(np.ravel(v)[i if np.ndim(v) else 0]) for v in (air.n, air.u))
    text = f"refractive index of air ({air.equation}) for {air.wavelength * 1e9:.7g} nm in vacuum"
    index = {"n": quantity(n, "1", text, u=u, symbol="n")}
    if made is None:
        length, spread = air.wavelength / n, air.wavelength * u / n**2
        return index | {"wavelength": quantity(length, "m", "wavelength in this air", u=spread)}
    each = {k: (v[i], made.u_of(k)[i]) for k, v in made.corrections.items()}
    each["total"] = (made.total[i], made.u[i])
    at = f"at the reading {format_length(float(made.reading[i]))}"
    found = {
        f"correction.{k}": quantity(
            v, "m", f"{_OF_LASER[k]}, {at}", u=spread, symbol=k.replace("_", " ")
        )
        for k, (v, spread) in each.items()
    }
    return found | index


def laser_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `LaserReadings`: corrections, their u and its budget."""
    found = laser_quantities(produced.air, produced.made)
    if produced.made is None:
        return Description(found, tables={"": {k: [q.value] for k, q in found.items()}})
    budget = produced.made.budget()
    columns = {"source": list(budget), "u_m": list(budget.values())}
    chart = bar_chart(
        "Uncertainty budget at the largest reading",
        list(budget),
        {"standard uncertainty": list(budget.values())},
        unit="m",
        quantity="standard uncertainty",
        caption="Each source with all corrections that it acts on; squares add up (JCGM 100).",
    )
    if produced.separation is None:
        return Description(found, (chart,), {"": columns})
    base = separation_of(produced.separation)
    return replace(
        base,
        quantities={**found, **base.quantities},
        charts=(*base.charts, chart),
        tables={**base.tables, "corrected": produced.table, "budget": columns},
    )


def _over(produced: Separation) -> dict[str, dict[str, FloatArray]]:
    """Return the parts that are curves, by the coordinate that they lie over."""
    groups: dict[str, dict[str, FloatArray]] = {}
    for part, values in produced.parts.items():
        for name in sorted(produced.coordinates, key=lambda c: _unlikely(part, c)):
            if values.shape == produced.coordinates[name].shape and values.ndim == 1:
                groups.setdefault(name, {})[part] = values
                break
    return groups


def _unlikely(part: str, coordinate: str) -> bool:
    """Whether a part would rather lie over another coordinate of the same length."""
    if part.startswith("diameter"):
        return coordinate != "y"
    return part.split("_", maxsplit=1)[0] != coordinate.split("_", maxsplit=1)[0]


def curves_of(produced: Separation) -> list[dict[str, Any]]:
    """Charts of curves; of one coordinate, where all is stored, the report draws the parts themselves."""
    charts = []
    for name, parts in _over(produced).items():
        if _unit(name) == "1":
            continue  # numbers of terms: a table says more
        x = produced.coordinates[name]
        panels = [
            panel(
                part.replace("_", " ") + _band(produced.u[part]),
                produced.units[part],
                [curve("", x, values, u=produced.u[part])],
            )
            for part, values in parts.items()
        ]
        where = _WORDS.get(name, name.replace("_", " "))
        chart = curve_chart(
            f"Parts over {where}",
            (where, _unit(name)),
            panels,
            caption="Each part with ± 2 standard uncertainties where they are known. What the "
            "method cannot see is listed above. Gaps were not measured.",
        )
        turned = {"closed": True, "each": True} if _unit(name) == "rad" and is_turn(x) else {}
        charts.append(chart | turned)
    return charts


_WORDS = {"x": "position", "y": "position along y", "carriage_x": "carriage position"}


def _band(u: FloatArray) -> str:
    return " ± 2 u" if np.isfinite(u).any() else " (u not known)"


def _unit(coordinate: str) -> str:
    if "angle" in coordinate:
        return "rad"
    return "m" if coordinate.rsplit("_", 1)[-1] in ("x", "y", "z") else "1"


def _is_map(produced: Separation, values: FloatArray) -> bool:
    if not {"x", "y"} <= set(produced.coordinates):
        return False
    return values.ndim == 2 or (values.ndim == 3 and values.shape[-1] == 2)


def _layers(name: str, values: FloatArray) -> dict[str, FloatArray]:
    if values.ndim == 2:
        return {name: values}
    return {f"{name}_{axis}": values[..., i] for i, axis in enumerate("xy")}


def _steps(produced: Separation) -> tuple[float, float]:
    x, y = produced.coordinates["x"], produced.coordinates["y"]
    dx = float(x[1] - x[0]) if x.size > 1 else 1.0
    return dx, float(y[1] - y[0]) if y.size > 1 else dx


def _maps(produced: Separation) -> dict[str, Surface]:
    """Return the parts that are maps, as surfaces."""
    found = {}
    for part, values in produced.parts.items():
        if not _is_map(produced, values):
            continue
        dx, dy = _steps(produced)
        x, y = produced.coordinates["x"], produced.coordinates["y"]
        own = values.shape[:2] == (y.size, x.size)  # else in pixels of the instrument
        corner = (float(x[0]), float(y[0])) if own else (0.0, 0.0)
        for name, layer in _layers(part, values).items():
            found[name] = Surface(
                layer,
                dx,
                dy,
                origin=corner,
                metadata={"part": name},
                history=produced.history,
            )
    return found


def _map_charts(produced: Separation) -> list[dict[str, Any]]:
    by_unit: dict[str, dict[str, FloatArray]] = {}
    corner = (0.0, 0.0)
    for part, values in produced.parts.items():
        if _is_map(produced, values):
            x, y = produced.coordinates["x"], produced.coordinates["y"]
            if values.shape[:2] == (y.size, x.size):
                corner = (float(x[0]), float(y[0]))
            layers = _layers(part.replace("_", " "), values)
            by_unit.setdefault(produced.units[part], {}).update(layers)
    return [
        map_chart(
            "Maps of the parts",
            maps,
            dx=_steps(produced)[0],
            dy=_steps(produced)[1],
            unit=unit,
            origin=corner,
            caption="All maps on one scale about zero; grey was not measured or not determined. "
            "Rows grow with y.",
        )
        for unit, maps in by_unit.items()
    ]


def _harmonics(produced: Separation) -> list[dict[str, Any]]:
    turning = "angle" in produced.coordinates
    counted = "undulations per revolution k" if turning else "harmonic k"
    each = "undulation per revolution" if turning else "harmonic"
    charts = []
    for name, values in produced.harmonics.items():
        u = produced.harmonics_u.get(name)
        last = min(values.size, _HARMONICS + 1)
        hidden = set(suppressed_harmonics(produced.null_space, name)) | {
            int(k) for k in np.flatnonzero(~np.isfinite(values[:last]))
        }
        charts.append(
            harmonic_chart(
                f"Harmonics, {name.replace('_', ' ')}",
                np.arange(1, last),
                np.abs(values[1:last]),
                u=None if u is None else u[1:last],
                suppressed=sorted(hidden),
                unit=produced.units.get(name, "m"),
                caption=f"Amplitude of each {each} with ± 2 standard uncertainties; hatched: not "
                "seen, or removed."
                + (f" Drawn up to {_HARMONICS}." if values.size > last else ""),
                k_name=counted,
            )
        )
    return charts


def _tables(produced: Separation) -> dict[str, dict[str, Any]]:
    tables = {}
    for i, (name, parts) in enumerate(_over(produced).items()):
        unit = {"1": "", "m": "_m", "rad": "_rad"}[_unit(name)]
        columns: dict[str, Any] = {f"{name}{unit}": produced.coordinates[name]}
        if unit == "":  # numbers of terms: all that name them
            alike = (c for c in produced.coordinates if c.split("_")[0] == name.split("_")[0])
            columns = {c: produced.coordinates[c].astype(np.int64) for c in alike}
        for part, values in parts.items():
            columns[f"{part}_{produced.units[part]}"] = values
            columns[f"u_{part}_{produced.units[part]}"] = produced.u[part]
        tables["" if i == 0 else name] = columns
    return tables
