"""Feeds for the next runs: a plan from the disturbance that a separation found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep.core.errors import NotSeparableError
from metrosep.core.quantity import Quantity
from metrosep.recipe.charts import plain
from metrosep.recipe.description import Description, quantity
from metrosep.recipe.method import OP, Method, toolbox
from metrosep.recipe.schema import Field

if TYPE_CHECKING:
    from metrosep.core.inputs import RoleColumns
    from metrosep.separation.runs.base import ErrorEstimate

__all__ = ["PLAN", "PLANS", "feed_plan_of", "plan_after", "plan_document"]

PLAN = {
    **OP,
    "v_min": Field("speed", required=True),
    "v_max": Field("speed", required=True),
    "n_runs": Field("integer", required=True),
    "wavelengths": Field("range", required=True),
    "length": Field("size"),
    "settle_distance": Field("uncertainty"),
    "max_time": Field("time"),
    "min_ratio": Field("number"),
    "fixed": Field("speeds"),
}


def plan_after(estimate: ErrorEstimate, options: Mapping[str, Any]) -> Any:
    """Return the plan for further runs of an axis whose runs were separated."""
    table = estimate.residual_psd
    if not len(table) or "psd_nm2_per_hz" not in table:
        raise NotSeparableError(
            "this separation tells no density of the disturbance over time; separate with "
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
    return toolbox("plan_feedrates")(density, waves, *required, **rest)


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
        "this plan, of as many runs all at the middle feedrate, and evenly spread.",
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


def _from_density(data: RoleColumns, options: Mapping[str, Any]) -> Any:
    values = data.values
    table = {"frequency_hz": values["frequency"], "psd_nm2_per_hz": values["psd"]}
    return _planned(table, options)


PLANS: Mapping[str, Method] = {
    "plan_from_density": Method(
        "feedrates of a set of runs from a density over time in nm^2/Hz",
        "table",
        (),
        PLAN,
        _from_density,
        roles={"frequency": "frequency", "psd": "any"},
    ),
}
