"""Budgets on the cut surface, motions of the axes and hysteresis of a stage in a result document."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from metrosep.core.quantity import Quantity
from metrosep.recipe.describe.charts import bar_chart, curve, curve_chart, map_chart, panel
from metrosep.recipe.describe.description import Description, quantity


def cut_budget_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `CutBudgetFound`."""
    budget = produced.budget
    maps = {c.name: np.asarray(c.map) for c in budget.budget.contributions}
    us = {c.name: c.u for c in budget.budget.contributions}
    maps |= {"sum": budget.total, "full cut": budget.mean}
    found: dict[str, Quantity] = {}
    for name, z in maps.items():
        known = z[np.isfinite(z)]
        words = {
            "sum": "sum of the causes, without cusps",
            "full cut": "part with everything in it, on the mean over a feed",
        }.get(name, f"error that {name} leaves on the part")
        found[f"{name}.pv"] = quantity(
            np.ptp(known), "m", f"P-V: {words}", u=us.get(name), symbol=f"PV {name}"
        )
        found[f"{name}.rms"] = quantity(known.std(), "m", f"RMS: {words}", symbol=f"RMS {name}")
    found["cusp"] = quantity(budget.cusp, "m", "P-V of the cusps of the feed, no form error")
    found["disagreement"] = quantity(
        budget.disagreement, "m", "largest difference of the full cut from the sum of the causes"
    )
    fit = produced.shown
    if fit is not None:
        for name, amount in fit.amounts.items():
            if math.isfinite(amount):
                found[f"shown.{name}"] = quantity(
                    amount, "1", f"how much of {name} the measured part shows; 1 is all of it",
                    u=fit.u[name], symbol=f"{name} shown",
                )  # fmt: skip
        found["explained"] = quantity(
            fit.explained, "1", "share of the variance of the part that the causes explain"
        )
        found["left"] = quantity(
            fit.residual, "m", "RMS of the part that they do not explain, cusps and noise included"
        )
    columns = {"x_m": produced.x, "y_m": produced.y}
    columns |= {f"{n.replace(' ', '_')}_m": z for n, z in maps.items()}
    causes = list(maps)
    charts = [
        bar_chart(
            "Error on the cut surface: causes, sum, full cut",
            causes,
            {"": [found[f"{n}.pv"].value for n in causes]},
            unit="m",
            quantity="P-V",
            caption="The full cut has everything in it at once; where it differs from the sum, trust the cut.",
        )
    ]
    if produced.pixel:
        charts.append(_maps(produced, maps))
    return Description(found, tuple(charts), {"": columns})


def _maps(produced: Any, maps: dict[str, Any]) -> dict[str, Any]:
    """Return the maps of the causes as pixels."""
    pixel, reach = produced.pixel, float(np.hypot(produced.x, produced.y).max())
    n = 2 * math.ceil(reach / pixel) + 1
    i, j = (np.rint(v / pixel).astype(int) + n // 2 for v in (produced.y, produced.x))
    shown = {}
    for name, z in maps.items():
        shown[name] = np.full((n, n), np.nan)
        shown[name][i, j] = z
    return map_chart(
        "Error on the cut surface",
        shown,
        dx=pixel,
        dy=pixel,
        unit="m",
        origin=(-(n // 2) * pixel, -(n // 2) * pixel),
        caption="Actual minus nominal along z, without cusps.",
    )


_PER = {"velocity": "{}/s", "acceleration": "{}/s2", "jerk": "{}/s3"}


def axis_motion_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of an `AxisMotion`."""
    found: dict[str, Quantity] = {}
    rows: dict[str, list[Any]] = {"axis": [], "what": [], "largest": [], "unit": [], "block": []}
    for axis, values in produced.largest.items():
        unit = "rad" if axis == "C" else "m"
        for name, value in values.items():
            if name == "jump":
                of = "acceleration" if "acceleration" in values else "velocity"
                words, per = f"largest jump of the {of} of {axis} between blocks", _PER[of]
            else:
                words, per = f"largest {name} of {axis}", _PER[name]
            found[f"{axis}.{name}"] = quantity(
                value, per.format(unit), words, symbol=f"{axis} {name}"
            )
            block = produced.block[axis][name]
            for key, item in zip(rows, (axis, name, value, per.format(unit), block), strict=True):
                rows[key].append(item)
    found["rpm"] = quantity(produced.rpm, "1/min", "mean spindle speed of the program")
    said: tuple[str, ...] = ()
    checks: tuple[dict[str, Any], ...] = ()
    if produced.binding:
        share = produced.rpm / produced.rpm_max
        found["rpm_share"] = quantity(
            min(share, 1.0) if produced.is_ok else share,
            "1",
            "spindle speed over the one that all limits allow; above 1 a limit is exceeded",
        )
        # the values follow from the program alone: nothing of them is measured
        checks = ({"metric": "rpm_share", "upper": 1.0, "U": 0.0, "name": "limits of the axes"},)
    if math.isfinite(produced.rpm_max):
        found["rpm_max"] = quantity(
            produced.rpm_max, "1/min", f"spindle speed that all limits allow: {produced.binding}"
        )
        if produced.is_ok:
            said = (f"all limits are kept; {produced.binding} would be the first to be reached",)
    return Description(found, (), {"": rows}, messages=(*produced.exceeded, *said), checks=checks)


def hysteresis_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `HysteresisFound`."""
    fit = produced.fit
    model = fit.model
    found = {
        "rms": quantity(fit.rms, "m", "RMS of what the model leaves of its loops"),
        "n_plays": quantity(int(model.weights.size), "1", "plays with a weight"),
        "gain": quantity(
            float(model.weights.sum()), "m/V", "slope of a full stroke, far from its turn"
        ),
    }
    if math.isfinite(fit.worst_left_out):
        found["left_out"] = quantity(
            fit.worst_left_out,
            "m",
            "largest residual on the minor loop that was not used in the fit",
        )
    tables: dict[str, Any] = {
        "": {
            "threshold_V": model.thresholds,
            "weight_m_per_V": model.weights,
            "u_weight_m_per_V": fit.u_weights,
        }
    }
    if model.front is not None:
        tables["front"] = {"voltage_V": model.front[0], "plays_get_V": model.front[1]}
    if model.behind is not None:
        tables["behind"] = {"sum_of_plays_m": model.behind[0], "displacement_m": model.behind[1]}
    charts: tuple[dict[str, Any], ...] = ()
    drives = produced.drives
    if drives is not None:
        ways = list(drives.voltage)
        columns: dict[str, Any] = {"displacement_m": produced.wanted}
        for way in ways:
            key = way.replace(" ", "_").replace("-", "_")
            found[f"{key}.left"] = quantity(
                drives.largest(way), "m", f"largest error on the course with voltages of: {way}"
            )
            columns[f"{key}_V"] = drives.voltage[way]
            columns[f"{key}_left_m"] = drives.residual[way]
        tables["course"] = columns
        at = np.arange(float(np.size(produced.wanted)))
        charts = (
            curve_chart(
                "What each way to choose the voltages leaves",
                ("sample of the course", "1"),
                [
                    panel(
                        "reached minus wanted",
                        "m",
                        [curve(w, at, drives.residual[w]) for w in ways],
                    )
                ],
                caption="By the model of the loops; between samples the course must be monotone.",
            ),
        )
    return Description(found, charts, tables)
