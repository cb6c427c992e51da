"""Gauge studies and series of parts in a result document."""

from __future__ import annotations

from typing import Any

from metrosep.recipe.bar_charts import bar_chart
from metrosep.recipe.charts import plain
from metrosep.recipe.description import Description, quantity

__all__ = ["gauge_of", "series_of"]

_PARTS = ("repeatability", "reproducibility", "interaction", "gauge", "parts", "total")


def gauge_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `GaugeStudy`."""
    found = {name: getattr(produced, name) for name in _PARTS}
    shares = produced.shares()
    for name, share in shares.items():
        found[f"{name}.share"] = quantity(
            share, "1", f"{name} over the total standard deviation", symbol=f"{name} share"
        )
    found["distinct_categories"] = quantity(
        produced.distinct_categories,
        "1",
        "groups of parts that the gauge tells apart, whole part of sqrt(2) parts / gauge",
        symbol="ndc",
    )
    if produced.tolerance is not None:
        found["share_of_tolerance"] = quantity(
            produced.share_of_tolerance,
            "1",
            "six standard deviations of the gauge over the width of the tolerance",
            symbol="6 GRR / T",
        )
    known = ["repeatability", "reproducibility", "gauge", "parts", "total"]
    chart = bar_chart(
        "Gauge study",
        known,
        {"standard deviation": [getattr(produced, n).value for n in known]},
        u={"standard deviation": [getattr(produced, n).u or 0.0 for n in known]},
        unit=produced.total.unit,
        quantity="standard deviation",
        caption="Gauge: repeatability and reproducibility together. Squares add up, lengths do not. "
        "Whiskers: one standard uncertainty.",
    )
    rows = produced.to_dict()["rows"]
    unit = produced.total.unit
    columns = {
        "source": [r["source"] for r in rows],
        f"sum_of_squares_{unit}2": [r["squares"] for r in rows],
        "dof": [r["dof"] for r in rows],
        f"mean_square_{unit}2": [r["mean_square"] for r in rows],
        "f": [r["f"] for r in rows],
        "p": [r["p"] for r in rows],
    }
    audit = {
        "n_parts": produced.n_parts,
        "n_conditions": produced.n_conditions,
        "n_trials": produced.n_trials,
        "pooled": produced.pooled,
        "coverage": produced.coverage,
    }
    document = {
        "anova": {k: v if k == "source" else plain(v, digits=12) for k, v in columns.items()},
        f"interval_{unit}": {k: list(v) for k, v in produced.interval.items()},
    }
    return Description(found, (chart,), {"anova": columns}, document=document, audit=audit)


def series_of(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a `PartSeries`."""
    found = {
        f"drift.{t.name}": quantity(
            t.drift,
            t.unit,
            f"drift of {t.name} from the first to the last part"
            + (", beyond chance" if t.drifts else ", not beyond chance")
            + (": the same in all parts to within rounding" if t.constant else ""),
            u=t.u_drift,
            symbol=f"drift {t.name}",
        )
        for t in produced.terms
    }
    found["drifting"] = quantity(
        len(produced.drifting), "1", "terms whose drift is beyond chance", symbol="drifting terms"
    )
    found["correlated"] = quantity(
        len(produced.correlated), "1", "pairs of terms beyond chance", symbol="correlated pairs"
    )
    terms = produced.terms
    columns: dict[str, Any] = {
        "term": [t.name for t in terms],
        "unit": [t.unit for t in terms],
        "mean": [t.mean for t in terms],
        "lower_control_limit": [t.lower for t in terms],
        "upper_control_limit": [t.upper for t in terms],
        "drift": [t.drift for t in terms],
        "u_drift": [t.u_drift for t in terms],
        "p": [t.p for t in terms],
        "drifts": [t.drifts for t in terms],
        "n_beyond": [len(t.beyond) for t in terms],
    }
    chart = {
        "kind": "part_series",
        "title": "Series of parts",
        "caption": "Drift of each term in its standard uncertainties, values of the surest with "
        "control limits, and the correlation of the terms without their drifts.",
        **produced.to_dict(),
    }
    return Description(
        found,
        (chart,),
        {"": columns},
        document={
            "correlated": [list(c) for c in produced.correlated],
            "same": [list(s) for s in produced.same],
        },
        audit={"n_parts": produced.n_parts, "false_discovery_rate": produced.rate},
    )
