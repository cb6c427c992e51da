"""The characteristics of a result: values with uncertainty, limits and a three-state verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from metrosep.compensation import Verification
from metrosep.core.quantity import Quantity
from metrosep.parameters.decision import decide, worst
from metrosep.recipe.steps import METRICS
from metrosep.separation.runs.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["DECISION_RULE", "characteristics"]

DECISION_RULE = (
    "accept if the value lies inside its limits by the guard band g = guard factor x U, reject if "
    "outside by g, else inconclusive (ISO 14253-1)"
)

_NAMES = {
    "slope": "Alignment slope over the evaluation range",
    "lost_motion": "Lost motion, reverse minus forward",
    "before_pv": "P-V of the mean run before the table (dry-run)",
}


def characteristics(
    recipe: Recipe, estimate: ErrorEstimate, verifications: Sequence[Verification]
) -> dict[str, Any]:
    """Return what was measured, judged where the recipe holds a check."""
    values = _metrics(estimate, verifications)
    entries = [
        {"name": METRICS.get(k) or _NAMES[k], **q.to_dict(), "metric": k}
        for k, q in values.items()
    ]
    for entry in entries:
        entry.update(lower=None, upper=None, U=None, guard_factor=None, verdict=None)
    verdicts = []
    for i, check in enumerate(recipe.checks):
        metric = check["metric"]
        quantity = values[metric]
        expanded = check.get("U", None if quantity.u is None else 2.0 * quantity.u)
        if expanded is None:
            raise recipe.place("[[check]]", i).error(
                f'the uncertainty of {metric} is not known from these runs; state it: U = "10 nm"',
                "metric",
            )
        guard = check.get("guard_factor", 1.0)
        verdict = decide(
            quantity.value,
            lower=check.get("lower"),
            upper=check.get("upper"),
            U=expanded,
            guard_factor=guard,
        )
        verdicts.append(verdict)
        entries.append(
            {
                **quantity.to_dict(),
                "metric": metric,
                "name": check.get("name", METRICS[metric]),
                "lower": check.get("lower"),
                "upper": check.get("upper"),
                "U": expanded,
                "guard_factor": guard,
                "verdict": verdict,
            }
        )
    checked = {c["metric"] for c in recipe.checks}
    kept = [e for e in entries if e["verdict"] is not None or e["metric"] not in checked]
    return {"characteristics": kept, "verdict": worst(verdicts)}


def _metrics(
    estimate: ErrorEstimate, verifications: Sequence[Verification]
) -> dict[str, Quantity]:
    values = {
        "pv": estimate.peak_to_valley(),
        "residual_rms": Quantity(
            estimate.residual_rms,
            "m",
            "RMS of all readings about the separated error: vibration and noise, which no table removes",
            symbol="RMS",
        ),
        "slope": Quantity(
            estimate.slope.value, "rad", estimate.slope.definition, estimate.slope.u, "slope"
        ),
    }
    if estimate.lost_motion is not None:
        lost = estimate.lost_motion
        values["lost_motion"] = Quantity(lost.value, lost.unit, lost.definition, lost.u, "B")
    if verifications:
        largest = max((r for v in verifications for r in v.residuals), key=lambda r: r.after_rms)
        values["before_pv"] = Quantity(
            max(v.before_pv for v in verifications),
            "m",
            "P-V of the mean run before the table",
            symbol="PV before",
        )
        values["after_pv"] = Quantity(
            max(v.after_pv for v in verifications),
            "m",
            "P-V of the mean run after the table, vibration that did not average out included",
            symbol="PV after",
        )
        values["after_rms"] = Quantity(
            max(v.after_rms for v in verifications),
            "m",
            "RMS of the mean run after the table, vibration that did not average out included",
            u=largest.u_after_rms,
            symbol="RMS after",
        )
    return values
