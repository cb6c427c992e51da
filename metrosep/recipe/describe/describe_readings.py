"""Calibrations of machines, circular tests and thermal fits in a result document."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from metrosep.core._arrays import FloatArray
from metrosep.core.quantity import Quantity
from metrosep.io.term_files import table_texts, term_texts
from metrosep.machine._bases import UnseenTerm
from metrosep.machine.elements import axis_of, term_unit
from metrosep.machine.terms import ConstantTerm, is_angle
from metrosep.recipe.describe.charts import bar_chart, curve, curve_chart, map_chart, panel
from metrosep.recipe.describe.description import Description, quantity

_POINTS = 181
_SIDE = 41
"""Of the picture of the volumetric error."""
_NAMES = {"m": "displacements", "rad": "angles"}


def machine_calibration_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `MachineCalibration`."""
    found = produced.found
    rotary = _rotary(found)
    seen = {n: t for n, t in found.errors.items() if not isinstance(t, UnseenTerm)}
    quantities = _motions(found, seen)
    for label, noise in found.noise.items():
        rest = np.asarray(found.residuals[label])
        unit = _unit_of(found, label)
        key = re.sub(r"[^\w.-]+", "_", label)
        text = f"root mean square of what the model leaves of {label}"
        quantities[f"residual.{key}"] = quantity(
            float(np.sqrt(np.nanmean(rest**2))), unit, text, symbol=f"residual {label}"
        )
        quantities[f"noise.{key}"] = quantity(
            noise, unit, f"white noise of one reading of {label}", symbol=f"noise {label}"
        )
    n_null = len(found.null)
    quantities["not_determined"] = quantity(
        n_null, "1", "directions that the readings do not determine"
    )
    charts = [
        *_term_charts(found, seen, rotary),
        *_circle_charts(found),
        *_residual_charts(produced),
    ]
    picture, volumetric = _picture(found, seen, rotary)
    if picture is not None:
        charts.append(picture)
        quantities |= volumetric
    return _calibration(
        found,
        found.fitted if produced.smallest else found.errors,
        quantities,
        charts,
        tables={"residuals": _residual_rows(found)},
    )


def part_curves_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of `PartCurves`."""
    found = produced.found
    rotary = _rotary(found)
    seen = {n: t for n, t in found.errors.items() if not isinstance(t, UnseenTerm)}
    quantities = _motions(found, seen)
    charts = _term_charts(found, seen, rotary)
    for label, left in produced.residuals.items():
        key = label.replace(" ", "_")
        quantities[f"residual.{key}"] = quantity(
            float(np.sqrt(np.nanmean(left.z**2))),
            "m",
            f"Sq of what the curves leave of {label}",
            symbol=f"residual {label}",
        )
        quantities[f"noise.{key}"] = quantity(
            found.noise[label], "m", f"white noise of a pixel of {label}", symbol=f"noise {label}"
        )
        charts.append(
            map_chart(
                f"What the curves leave of {label}",
                {"residual": left.z},
                dx=left.dx,
                dy=left.dy,
                unit="m",
                origin=left.origin,
                caption="Measured minus form, alignment, tool setting and curves.",
            )
        )
    maps = {f"residual-{k.replace(' ', '-')}": v for k, v in produced.residuals.items()}
    return _calibration(found, found.errors, quantities, charts, maps=maps)


def _calibration(
    found: Any, terms: Mapping[str, Any], quantities: Any, charts: Sequence[Any], **parts: Any
) -> Description:
    """Return the description of a `Calibration` with those of these terms that are determined as files."""
    known = {n: t for n, t in terms.items() if not isinstance(t, UnseenTerm)}
    ranges = {n: _range(found, n) for n in known if not isinstance(known[n], ConstantTerm)}
    document = found.to_dict()
    return Description(
        quantities,
        tuple(charts),
        **parts,
        document={"calibration": document},
        audit=dict(found.audit),
        files={
            **term_texts(known, ranges, _rotary(found)),
            "calibration.json": _json_text(document),
        },
    )


def _json_text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n"


def _rotary(found: Any) -> set[str]:
    return {e.name for e in found.chain.elements if e.kind == "rotary"}


def _motions(found: Any, seen: dict[str, Any]) -> dict[str, Quantity]:
    """Return the amount of each location error, and the P-V of each motion."""
    quantities: dict[str, Quantity] = {}
    for name, term in seen.items():
        unit = term_unit(found.chain, name)
        if isinstance(term, ConstantTerm):
            text = f"location error {name}, actual minus nominal"
            quantities[name] = quantity(term.value, unit, text, u=term.u, symbol=name)
            continue
        x = _places(found, name)
        value = term.evaluate(x)
        # the extremes hang together by the coefficients
        ends = term.basis.at(x[[int(np.argmax(value)), int(np.argmin(value))]])
        apart = ends[0] - ends[1]
        u = math.sqrt(max(float(apart @ term.cov @ apart), 0.0))
        text = (
            f"P-V of {name} over the places that were read; u with the covariance of the extremes"
        )
        quantities[f"{name}.pv"] = quantity(np.ptp(value), unit, text, u=u, symbol=f"PV {name}")
    return quantities


def _unit_of(found: Any, label: str) -> str:
    return "rad" if found.sets[label].instrument.is_angle else "m"


def _spans(found: Any) -> dict[str, tuple[float, float]]:
    """Return from where to where each axis was read."""
    places: dict[str, list[FloatArray]] = {}
    for reading in found.sets.values():
        for axis, values in reading.q.items():
            places.setdefault(axis, []).append(np.ravel(values))
    joined = {a: np.concatenate(v) for a, v in places.items()}
    return {a: (float(v.min()), float(v.max())) for a, v in joined.items()}


def _range(found: Any, name: str) -> tuple[float, float]:
    basis = found.bases[name]
    return (0.0, 2.0 * math.pi) if basis.kind == "fourier" else (basis.low, basis.high)


def _places(found: Any, name: str) -> FloatArray:
    low, high = _range(found, name)
    return np.linspace(low, high, _POINTS)


def _term_charts(found: Any, seen: dict[str, Any], rotary: set[str]) -> list[dict[str, Any]]:
    """Return the motions of each axis over its position, and the location errors as bars."""
    charts = []
    for axis in found.chain.axes:
        names = [
            n for n, t in seen.items() if axis_of(n) == axis and not isinstance(t, ConstantTerm)
        ]
        panels = []
        for unit, title in _NAMES.items():
            own = [n for n in names if term_unit(found.chain, n) == unit]
            curves = [
                curve(n, _places(found, n), seen[n].evaluate(_places(found, n)),
                      u=seen[n].sd(_places(found, n)))
                for n in own
            ]  # fmt: skip
            if curves:
                panels.append(panel(title, unit, curves))
        if panels:
            about = (f"position of {axis}", "rad" if axis in rotary else "m")
            charts.append(curve_chart(f"Error motions of {axis}", about, panels))
    for unit, title in _NAMES.items():
        own = [
            n for n, t in seen.items() if isinstance(t, ConstantTerm) and term_unit(found.chain, n) == unit
        ]  # fmt: skip
        if own:
            charts.append(
                bar_chart(
                    f"Location errors: {title}",
                    own,
                    {"value": [seen[n].value for n in own]},
                    unit=unit,
                    quantity="actual minus nominal",
                    u={"value": [seen[n].u for n in own]},
                )
            )
    return charts


def _residual_charts(produced: Any) -> list[dict[str, Any]]:
    """Return what the model leaves of each set, in the order of time."""
    by_unit: dict[str, list[dict[str, Any]]] = {}
    for label, values in produced.found.residuals.items():
        rows = np.asarray(values).reshape(len(values), -1)
        names = [""] if rows.shape[1] == 1 else list("xyz")
        number = np.arange(1.0, rows.shape[0] + 1.0)
        curves = [curve(n, number, rows[:, i], points=True) for i, n in enumerate(names)]
        unit = _unit_of(produced.found, label)
        by_unit.setdefault(unit, []).append(panel(label, unit, curves))
    return [
        curve_chart("Residuals in the order of time", ("number of the reading", "1"), panels)
        for panels in by_unit.values()
    ]


_PLANES = (("X", "Y"), ("Y", "Z"), ("Z", "X"))
"""The angle of a circle counts from the first axis to the second."""


def _circle_charts(found: Any) -> list[dict[str, Any]]:
    """Return the readings of a ballbar about their circle, with what the model leaves of them."""
    from metrosep.machine.instruments import Ballbar

    panels = []
    for label, one in found.sets.items():
        moved = {a for a, v in one.q.items() if np.ptp(v) > 0.0}
        plane = next((p for p in _PLANES if set(p) == moved), None)
        if not isinstance(one.instrument, Ballbar) or plane is None:
            continue
        a, b = (np.ravel(one.q[axis]) for axis in plane)
        # the centre from a**2 + b**2 = 2 a a0 + 2 b b0 + c: whatever the offset of the tool
        design = np.stack([2.0 * a, 2.0 * b, np.ones(a.size)], axis=1)
        (a0, b0, _), _, rank, _ = np.linalg.lstsq(design, a**2 + b**2)
        if rank < design.shape[1]:
            continue  # along a line
        angle = np.mod(np.arctan2(b - b0, a - a0), 2.0 * np.pi)
        order = np.argsort(angle, kind="stable")
        reading = np.ravel(one.values)
        rest = np.ravel(found.residuals[label])
        rows = [
            curve("reading, from its mean", angle[order], (reading - np.nanmean(reading))[order]),
            curve("what the model leaves", angle[order], rest[order]),
        ]
        panels.append(panel(f"{label}: angle from +{plane[0]} to +{plane[1]}", "m", rows))
    if not panels:
        return []
    chart = curve_chart("Ballbar about its ball", ("angle of the place", "rad"), panels)
    return [chart | {"closed": True, "each": True}]


def _residual_rows(found: Any) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {"set": [], "reading": [], "component": [], "residual_si": []}
    for label, values in found.residuals.items():
        rows = np.asarray(values).reshape(len(values), -1)
        for i, row in enumerate(rows, 1):
            for k, value in enumerate(row):
                columns["set"].append(label)
                columns["reading"].append(i)
                columns["component"].append("" if rows.shape[1] == 1 else "xyz"[k])
                columns["residual_si"].append(float(value))
    return columns


def _picture(
    found: Any, seen: dict[str, Any], rotary: set[str]
) -> tuple[dict[str, Any] | None, dict[str, Quantity]]:
    """Return the size of the error of the tool point over two axes, the others in their middle."""
    from metrosep.machine import Nest

    spans = _spans(found)
    tool = np.asarray(next(iter(found.sets.values())).tool, dtype=np.float64).reshape(-1, 3)[0]
    moved = [a for a in found.chain.axes if a in spans and np.ptp(spans[a]) > 0.0]
    straight = sorted(a for a in moved if a not in rotary)
    if len(straight) < 2:
        return None, {}
    one, two = straight[:2]
    q: dict[str, Any] = {a: float(np.mean(spans[a])) for a in spans}
    first, second = (np.linspace(*spans[a], _SIDE) for a in (one, two))
    q[one], q[two] = (v.ravel() for v in np.meshgrid(first, second))
    for axis in found.chain.axes:
        q.setdefault(axis, 0.0)
    E = found.read(Nest(), q, tool=tool)
    size = np.linalg.norm(E, axis=-1).reshape(_SIDE, _SIDE)
    others = [a for a in spans if a not in (one, two)]
    where = ", ".join(
        f"{a} {math.degrees(float(q[a])):.4g} deg"
        if a in rotary
        else f"{a} {float(q[a]) * 1e3:.4g} mm"
        for a in others
    )
    words = f"Length of the error of the tool point over {one} and {two}"
    words += f", at {where}." if where else "."
    if len(seen) < len(found.errors):
        words += " Terms that the readings do not determine take part with the smallest values that explain them."
    at = ", ".join(f"{v * 1e3:g}" for v in tool)
    chart = map_chart(
        "Volumetric error",
        {f"{one} to the right, {two} upwards": size},
        dx=float(np.ptp(first)) / (_SIDE - 1),
        dy=float(np.ptp(second)) / (_SIDE - 1),
        unit="m",
        caption=f"{words} Tool point {at} mm.",
        origin=(float(first[0]), float(second[0])),
        magnitude=True,
    )
    about = f"length of the error of the tool point over {one} and {two}"
    return chart, {
        "volumetric.rms": quantity(
            float(np.sqrt(np.mean(size**2))), "m", f"root mean square of the {about}"
        ),
        "volumetric.max": quantity(float(size.max()), "m", f"largest {about}"),
    }


def circle_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `CircleRun`."""
    test = produced.test
    angle = test.angle
    order = np.argsort(np.mod(angle, 2.0 * np.pi), kind="stable")
    place = np.mod(angle, 2.0 * np.pi)[order]
    read = [curve(s, place, np.asarray(r)[order]) for s, r in test.measured.items()]
    rest = [curve(s, place, np.asarray(r)[order]) for s, r in test.residual.items()]
    chart = curve_chart(
        f"Circular test in {test.plane}",
        ("angle of the place", "rad"),
        [
            panel("deviation of the radius about the common centre", "m", read),
            panel("what the model leaves", "m", rest),
        ],
        caption="Readings within 1 degree of a reversal are not in the fit.",
    ) | {"closed": True}
    columns: dict[str, Any] = {"angle_deg": np.degrees(place)}
    for sense in test.measured:
        columns[f"{sense}_um"] = np.asarray(test.measured[sense])[order] * 1e6
        columns[f"residual_{sense}_um"] = np.asarray(test.residual[sense])[order] * 1e6
    known = {n: q for n, q in test.quantities.items() if math.isfinite(q.value)}
    return Description(
        known,
        (chart,),
        {"": columns},
        document={"circle": test.to_dict()},
        audit=dict(test.audit),
    )


def thermal_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `ThermalResult`."""
    fit = produced.fit
    quantities: dict[str, Quantity] = {}
    panels: dict[str, list[dict[str, Any]]] = {}
    hours = fit.t / 3600.0
    columns: dict[str, Any] = {"t_s": fit.t}
    for name, term in fit.terms.items():
        u = np.sqrt(np.diag(term.covariance))
        at = len(term.sensors)
        for i, (sensor, lag) in enumerate(zip(term.sensors, term.lags, strict=True)):
            text = f"change of {name} per kelvin of {sensor}"
            quantities[f"{name}.{sensor}"] = quantity(
                float(term.gains[i]), f"{term.unit}/K", text, u=float(u[i])
            )
            if lag > 0.0:
                text = f"time constant of {name} behind {sensor}"
                spread = lag * float(u[at])
                quantities[f"{name}.{sensor}.lag"] = quantity(lag, "s", text, u=spread)
                at += 1
        predicted = fit.predicted[name]
        quantities[f"{name}.predicted"] = quantity(
            predicted,
            term.unit,
            f"RMS that is left of blocks of {name} foretold from the others",
        )
        quantities[f"{name}.drift"] = quantity(
            fit.drift[name], term.unit, f"RMS of the same blocks of {name} without temperatures"
        )
        values, rest = fit.readings[name], fit.residuals[name]
        told = values - rest
        panels.setdefault(name, []).append(
            panel(
                name,
                term.unit,
                [
                    curve("reading", hours, values, points=True),
                    curve("by temperatures", hours, told),
                ],
            )
        )
        panels[name].append(panel(f"{name}: left", term.unit, [curve("", hours, rest)]))
        suffix = term.unit
        columns |= {f"{name}_{suffix}": values, f"left_{name}_{suffix}": rest}
    charts = [
        curve_chart(f"{name} and what temperatures say", ("time / h", "1"), own)
        for name, own in panels.items()
    ]
    document: dict[str, Any] = {"thermal": fit.to_dict()}
    files = {"thermal.json": _json_text(document["thermal"])}
    if produced.errors is not None:
        terms = produced.errors.terms
        files |= table_texts(terms)
        document["at_K"] = dict(produced.stated)
        for n, t in terms.items():
            if isinstance(t, ConstantTerm):
                unit = "rad" if is_angle(n) else "m"
                quantities[n] = quantity(
                    t.value, unit, f"{n} at the stated temperatures, from the reference", u=t.u
                )
    return Description(
        quantities,
        tuple(charts),
        {"": columns},
        document=document,
        audit=dict(fit.audit),
        files=files,
    )
