"""Feeds for the next runs: a plan from the disturbance that a separation found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from metrosep.core.errors import NotSeparableError
from metrosep.core.methods import Method
from metrosep.core.options import Option
from metrosep.core.quantity import Quantity
from metrosep.recipe.describe.charts import plain
from metrosep.recipe.describe.description import Description, quantity

if TYPE_CHECKING:
    from metrosep.core.methods import RoleColumns
    from metrosep.separation.runs.base import ErrorEstimate

PLAN = {
    "op": Option("text", required=True),
    "v_min": Option(
        "speed", required=True, help="slowest feedrate of the machine that may be planned"
    ),
    "v_max": Option(
        "speed", required=True, help="fastest feedrate of the machine that may be planned"
    ),
    "n_runs": Option(
        "integer", required=True, help="number of runs to plan, beside those already done"
    ),
    "wavelengths": Option(
        "range", required=True, help="shortest and longest wavelength that must become well known"
    ),
    "length": Option("size", help="travel of each run; that of the separated runs if omitted"),
    "settle_distance": Option(
        "uncertainty",
        help="part of the travel that is lost while the axis settles",
        default="0 mm",
    ),
    "max_time": Option(
        "time", help="most time that all new runs together may take; no limit if omitted"
    ),
    "min_ratio": Option(
        "number", help="two feedrates are equal or at least this ratio apart", default=1.1
    ),
    "fixed": Option(
        "speeds",
        help="feedrates of runs that were already done, separated by commas; none if omitted",
    ),
}


def plan_after(estimate: ErrorEstimate, options: Mapping[str, Any]) -> Any:
    """Return the plan for further runs of an axis whose runs were separated."""
    table = estimate.residual_psd
    if not len(table) or "psd_nm2_per_hz" not in table:
        raise NotSeparableError(
            "this separation gives no density of the disturbance over time; separate with "
            'method = "joint", from runs with times'
        )
    low, high = estimate.fit_range
    rest = {"length": high - low, **{k: v for k, v in options.items() if k != "op"}}
    return _planned(_larger(table), rest)


def _larger(table: Any) -> tuple[Any, Any]:
    """Return frequencies and density; of several directions the larger density."""
    if "direction" not in table:
        parts = [table]
    else:
        parts = [t for _, t in table.groupby("direction", sort=False)]
    first = parts[0]["frequency_hz"].to_numpy(dtype=np.float64)
    curves = [
        np.interp(first, p["frequency_hz"].to_numpy(), p["psd_nm2_per_hz"].to_numpy())
        for p in parts
    ]
    return first, np.max(curves, axis=0) * 1e-18


def _planned(density: Any, options: Mapping[str, Any]) -> Any:
    rest = dict(options)
    waves = rest.pop("wavelengths")
    if isinstance(waves, Mapping):
        waves = (waves["shortest"], waves["longest"])
    else:
        waves = np.array(waves)
    required = [rest.pop(k) for k in ("v_min", "v_max", "n_runs")]
    from metrosep.separation import plan_feedrates

    return plan_feedrates(density, waves, *required, **rest)


def feed_plan_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `FeedPlan`."""
    sd = produced.columns["sd_nm"]
    known = sd[np.isfinite(sd)]
    found: dict[str, Quantity] = {}
    if known.size:
        text = "largest predicted standard deviation of an amplitude coefficient in the plan"
        found["worst_sd"] = quantity(known.max() * 1e-9, "m", text, symbol="sd")
    found["time"] = quantity(produced.audit["time_s"], "s", "travel time of the planned runs")
    if "efficiency" in produced.audit:
        text = "smallest information over the bound that no plan can exceed"
        found["efficiency"] = quantity(produced.audit["efficiency"], "1", text)
    feeds, counts = np.unique(produced.feeds, return_counts=True)
    chart = {
        "kind": "plan",
        "title": "Plan of feedrates",
        "caption": "Predicted standard deviation of an amplitude coefficient over wavelength: of "
        "this plan, of as many runs all at the middle feedrate, and in geometric progression.",
        "columns": {k: plain(v) for k, v in produced.columns.items()},
        "feeds": plain(produced.feeds),
        "fixed": plain(produced.fixed),
        "one_feed_mm_per_min": produced.audit["one_feed_mm_per_min"],
    }
    return Description(
        found,
        (chart,) if known.size else (),
        {"": produced.columns},
        document={
            "feeds_mm_per_min": plain(produced.feeds * 6e4),
            "runs": [
                [float(f"{v * 6e4:.6g}"), int(n)] for v, n in zip(feeds, counts, strict=True)
            ],
            "sd": {k: plain(v) for k, v in produced.columns.items()},
        },
        audit=produced.audit,
    )


def plan_document(plan: Any) -> dict[str, Any]:
    """Return a plan as plain values for the result document and for JSON."""
    described = feed_plan_of(plan)
    return {
        **described.document,
        "quantities": {k: q.to_dict() for k, q in described.quantities.items()},
        "audit": dict(described.audit),
        "messages": list(plan.messages),
        "charts": list(described.charts),
    }


class PlanFromDensity(Method):
    """`plan_feedrates` from a table, by a name of its own."""

    name: ClassVar[str] = "plan_from_density"
    what: ClassVar[str] = "feedrates of a set of runs from a density over time in nm^2/Hz"
    reads: ClassVar = "table"
    roles: ClassVar[Mapping[str, str]] = {"frequency": "frequency", "psd": "any"}
    arguments: ClassVar[Mapping[str, Option]] = {k: v for k, v in PLAN.items() if k != "op"}

    @classmethod
    def from_inputs(cls, data: RoleColumns, options: Mapping[str, Any]) -> Any:
        """Return the plan for the density of a table."""
        values = data.values
        table = {"frequency_hz": values["frequency"], "psd_nm2_per_hz": values["psd"]}
        return _planned(table, options)
