"""Drift, differences and dependences in a result document: quantities, tables, charts."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.recipe.charts import curve, curve_chart, panel
from metrosep.recipe.description import Description, extremes, named, quantity

__all__ = ["dependence_of", "difference_of", "drift_test_of", "joint_drift_of"]


def drift_test_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `DriftTest`."""
    several = len(produced.windows) > 1
    found: dict[str, Quantity] = {}
    for i in range(len(produced.windows)):
        tail = f".{i + 1}" if several else ""
        for name, ranges in produced.ranges.items():
            found[f"{name}.range{tail}"] = ranges[i]
        found[f"combined{tail}"] = produced.combined[i]
    found |= {f"{name}.worst": q for name, q in produced.worst.items()}
    found = named(found)
    frame = produced.to_frame()
    chart = curve_chart(
        "Drift over time",
        ("time", "s"),
        [
            panel(name, found_unit, [curve("", produced.t, values - _first(values))])
            for name, values in produced.channels.items()
            for found_unit in (produced.ranges[name][0].unit,)
        ],
        caption="Each channel from its first reading. Filter: none.",
    )
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _first(values: Any) -> float:
    known = values[np.isfinite(values)]
    return float(known[0]) if known.size else 0.0


def difference_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `DriftFreeDifference`."""
    value, u = np.asarray(produced.difference), np.asarray(produced.u)
    text = "A minus B, free of offset and linear drift; mean over the sequences"
    if value.ndim == 0:
        found = {
            "difference": quantity(value, "m", text, u=u, symbol="A − B"),
            "drift_rate": _rate(produced),
        }
        each = np.atleast_1d(produced.each)
        number = np.arange(1.0, each.size + 1.0)
        rows = [curve("", number, each, points=True)]
        chart = curve_chart(
            "A minus B", ("sequence", "1"), [panel("A − B of each sequence", "m", rows)]
        )
        return Description(
            found, (chart,), {"": {"sequence": number, "difference_m": each}}, audit=produced.audit
        )
    x, name, unit = _abscissa(inputs, value.shape[-1])
    found = extremes("difference", value, u, "m")
    chart = curve_chart(
        "A minus B", (name, unit), [panel("A − B, ± 2 u", "m", [curve("", x, value, u=u)])]
    )
    suffix = "" if unit == "1" else f"_{unit}"
    columns = {f"{name}{suffix}": x, "difference_m": value, "u_difference_m": u}
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _rate(produced: Any) -> Quantity:
    """Return the drift per second, or per step where no times were given."""
    timed = produced.audit.get("times") == "given"
    text = "linear drift within the sequences, mean over them"
    return quantity(produced.drift_rate, "m/s" if timed else "m/step", text)


def _abscissa(inputs: Any, n: int) -> tuple[Any, str, str]:
    """Return positions of curves with name and unit; sample numbers where none are known."""
    position = getattr(inputs, "position", None)
    if position is None or position.size != n:
        return np.arange(float(n)), "sample", "1"
    unit = getattr(inputs, "position_unit", "m")
    return position, "angle" if unit == "rad" else "position", unit


def joint_drift_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `JointDrift`."""
    found: dict[str, Quantity] = {}
    labels = produced.labels
    pairs = {(b, labels[0]): produced.difference(b, labels[0]) for b in labels[1:]}
    single = produced.values.ndim == 1
    for i, label in enumerate(labels):
        value, u = produced.values[i], produced.u[i]
        text = f"{label} as it would have been read at the reference time"
        found |= (
            {str(label): quantity(value, "m", text, u=u, symbol=str(label))}
            if single
            else extremes(str(label), value, u, "m")
        )
    for (b, a), (value, u) in pairs.items():
        name = f"{b}-{a}"
        text = f"{b} minus {a}, free of drift"
        found |= (
            {name: quantity(value, "m", text, u=u, symbol=f"{b} − {a}")}
            if single
            else extremes(name, value, np.broadcast_to(u, value.shape), "m")
        )
    if single:
        rows = [curve("", produced.t, produced.drift, u=produced.u_drift)]
        chart = curve_chart(
            "Drift between the readings",
            ("time", "s"),
            [
                panel("drift ± 2 u, zero at the reference time", "m", rows),
                panel(
                    "readings minus fit",
                    "m",
                    [curve("", produced.t, produced.residual, points=True)],
                ),
            ],
        )
        columns = {
            "t_s": produced.t,
            "drift_m": produced.drift,
            "u_drift_m": produced.u_drift,
            "residual_m": produced.residual,
        }
    else:
        chart, columns = _drift_curves(produced, inputs)
    return Description(found, (chart,), {"": columns}, audit=produced.audit)


def _drift_curves(produced: Any, inputs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    x, name, unit = _abscissa(inputs, produced.values.shape[-1])
    suffix = "" if unit == "1" else f"_{unit}"
    columns: dict[str, Any] = {f"{name}{suffix}": x}
    panels = []
    for label, value, u in zip(produced.labels, produced.values, produced.u, strict=True):
        panels.append(panel(f"{label} ± 2 u", "m", [curve("", x, value, u=u)]))
        columns |= {f"{label}_m": value, f"u_{label}_m": u}
    return curve_chart("Quantities free of drift", (name, unit), panels), columns


def dependence_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `Dependence`."""
    v = produced.variable
    order = np.argsort(v)
    line = np.linspace(float(np.nanmin(v)), float(np.nanmax(v)), 101)
    name = str(produced.audit.get("variable", "variable"))
    curves = [
        curve(
            f"fit, {100.0 * produced.confidence:g} %",
            line,
            produced.evaluate(line),
            u=produced.half_width(line) / 2.0,
        ),
        curve("readings", v[order], produced.values[order], points=True),
    ]
    chart = curve_chart("Readings and fit", (name, "1"), [panel("", "m", curves)])
    columns = {
        name.replace(" ", "_"): v,
        "value_m": produced.values,
        "residual_m": produced.residual,
    }
    return Description(
        dict(produced.coefficients),
        (chart,),
        {"": columns},
        document={"intervals": {k: list(i) for k, i in produced.intervals.items()}},
        audit=produced.audit,
    )
