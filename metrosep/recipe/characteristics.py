"""The characteristics of a result: values with uncertainty, limits and a three-state verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from metrosep.core.errors import DataError
from metrosep.core.limits import FROM_FIT, limit_example, limit_problem
from metrosep.core.quantity import Quantity
from metrosep.parameters.decision import Verdict, decide, worst
from metrosep.recipe.steps import METRICS

if TYPE_CHECKING:
    from metrosep.compensation import Verification
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.schema import Place
    from metrosep.separation.runs.base import ErrorEstimate

_OF_FIT = "fit residual"
_WIDER = 1.005
"""A guard band over t_0.95 u beyond this is said: less is not seen in two decimals."""

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
        k, source = _origin(check, quantity)
        expanded = check.get("U", None if quantity.u is None else k * quantity.u)
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
                "k": k,
                "u_source": source,
                **({"p": check["p"]} if "p" in check else {}),
            }
        )
    checked = {c["metric"] for c in recipe.checks}
    kept = [e for e in entries if e["verdict"] is not None or e["metric"] not in checked]
    return {"characteristics": kept, "verdict": worst(verdicts)}


def _origin(check: Mapping[str, Any], quantity: Quantity) -> tuple[float, str]:
    """Return the coverage factor of U of a check, and where U comes from."""
    if check.get("U", FROM_FIT) != FROM_FIT:
        return check.get("k", 2.0), str(check.get("U_from", "stated"))
    from metrosep.forms._correlated import expanding_factor

    dof = quantity.dof
    k = 2.0 if dof is None else expanding_factor(dof)
    return k, quantity.u_source or "of the method"


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


# ---- named methods and steps that measure: by metric, also with the uncertainty of a fit ---------


Values = Callable[[str], list[float]]
"""From a metric to its values at several places, in the order of measuring."""


def judged(
    recipe: Recipe,
    found: Mapping[str, Quantity],
    *,
    unlisted: Collection[str] = (),
    values: Values | None = None,
    decided: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    unsure: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return what was measured, and the verdict of each check.

    `values` serves rules over several; `decided` has what a step itself says of its check, with the verdict;
    `unsure` the reasons why a number is not known well enough for any.
    """
    entries = []
    verdicts = []
    for i, stated in enumerate(recipe.checks):
        of_fit = stated.get("U_from") == "fit"
        check = {**stated, "U": FROM_FIT} if of_fit else stated
        metric, place = check["metric"], recipe.place("[[check]]", i)
        if metric not in found:
            known = ", ".join(found)
            raise place.error(
                f'metric = "{metric}" is not in this result; there are {known}', "metric"
            )
        quantity = found[metric]
        given = check.get("U")
        for key in ("lower", "upper", "U"):
            if key in check and check[key] != FROM_FIT:
                problem = limit_problem(key, check[key], metric, quantity.unit)
                if problem is not None:
                    raise place.error(problem, key)
        limits = {k: float(check[k]) if k in check else None for k in ("lower", "upper")}
        guard = check.get("guard_factor", 1.0)
        expanded: float | None
        verdict: Verdict
        k, source = _origin(check, quantity)
        more: dict[str, Any] = {"u_source": source, "k": k}
        more |= {"p": check["p"]} if "p" in check else {}
        if metric in unsure:
            verdict, expanded = "inconclusive", None if given in (None, FROM_FIT) else float(given)
            more["reason"] = unsure[metric]
        elif metric in decided:
            more = dict(decided[metric])
            expanded, verdict = more["U"], more["verdict"]
        elif given == FROM_FIT or (given is None and quantity.u_source == _OF_FIT):
            expanded, guard, verdict, more = _by_the_fit(check, found, limits, place)
        elif given is None and quantity.u is None:
            expanded, verdict = None, "inconclusive"
            more = {"reason": _no_u(metric, quantity.unit), "u_source": "not stated"}
        else:
            expanded = float(given) if given is not None else k * float(quantity.u or 0.0)
            verdict = decide(quantity.value, **limits, U=expanded, guard_factor=guard)
        if "rule" in check or check.get("sequential"):
            spread = (expanded, guard, quantity.unit)
            verdict, said = _by_rule(check, limits, spread, values, place)
            more = {**more, **said}
        if metric in unsure:  # of several values too
            verdict = "inconclusive"
        verdicts.append(verdict)
        name = check.get("name", quantity.definition)
        entries.append(
            {**quantity.to_dict(), "metric": metric, "name": name, **limits, "U": expanded}
            | {"guard_factor": guard, "verdict": verdict, **more}
        )
    checked = {c["metric"] for c in recipe.checks}
    rest = [
        {**q.to_dict(), "metric": k, "name": q.symbol or k, "lower": None, "upper": None}
        | {"U": None, "guard_factor": None, "verdict": None}
        for k, q in found.items()
        if k not in checked and k not in unlisted
    ]
    return {"characteristics": [*entries, *rest], "verdict": worst(verdicts)}


def _no_u(metric: str, unit: str) -> str:
    """Return what to write where neither the value nor the check has an uncertainty."""
    example = {"m": "10 nm", "px": "0.1 px"}.get(unit, limit_example(unit))
    said = "0.001, or U = 0"
    if example is not None:
        said = f'"{example}", or U = "0 {example.partition(" ")[2]}"'
    return f"the uncertainty of {metric} is not known; state it: U = {said} for simple acceptance"


def _by_rule(
    check: Mapping[str, Any],
    limits: Mapping[str, float | None],
    spread: tuple[float | None, float, str],
    values: Values | None,
    place: Place,
) -> tuple[Verdict, dict[str, Any]]:
    """Return the verdict of a rule over several values, and what to say of it."""
    from metrosep.parameters.decision import judge_values

    if values is None:
        raise place.error("a rule over several values belongs to parameters of profiles", "rule")
    U, factor, unit = spread
    try:
        found = judge_values(
            values(check["metric"]),
            **limits,
            rule=check.get("rule", "16%"),
            U=0.0 if U is None else U,
            guard_factor=factor,
            sequential=check.get("sequential", False),
            unit=unit,
        )
    except DataError as exc:
        raise place.error(str(exc), "rule" if "rule" in check else "sequential") from None
    said = {"rule": found.rule, "values": list(found.values), "u_note": found.sentence}
    return ("inconclusive" if U is None else found.verdict), said


def _by_the_fit(
    check: Mapping[str, Any],
    found: Mapping[str, Quantity],
    limits: Mapping[str, float | None],
    place: Place,
) -> tuple[float | None, float, Verdict, dict[str, Any]]:
    """Return U, guard factor, verdict and what to say, of a parameter of a fit without a stated U.

    With U = "from fit" the guard band is one-sided: t_0.95 u, or what the fit says that a verdict needs
    (`FitResult.guard`). U is k u with k of 95.45 %, two-sided. A radius is judged by its curvature, which is normal where the radius is not.
    """
    from metrosep.forms._correlated import PROVEN, expanding_factor, student
    from metrosep.forms.conic import curvature_name

    metric, factor = check["metric"], check.get("guard_factor", 1.0)
    quantity = found[metric]
    if quantity.u_source != _OF_FIT:
        raise place.error(
            f'U = "{FROM_FIT}" is for parameters of a fitted form, and {metric} is not one; state '
            'U, such as U = "10 nm"',
            "U",
        )
    if "U" not in check:
        why = (
            f'no U is stated; write the expanded uncertainty of {metric} as U, or U = "{FROM_FIT}" '
            "for what the residual of this fit alone says"
        )
        return None, factor, "inconclusive", {"reason": why, "u_source": _OF_FIT}
    if quantity.dof is None:
        why = f"the fit does not know the uncertainty of {metric}: state U"
        return None, factor, "inconclusive", {"reason": why, "u_source": _OF_FIT}
    judged_by, bounds = quantity, limits
    name, _, tail = metric.partition("#")
    bent = found.get(f"{curvature_name(name)}#{tail}" if tail else curvature_name(name))
    if name.startswith("R") and bent is not None:
        judged_by, bounds = bent, _bent(limits, metric, place)
    if judged_by.u is None:
        why = f"the fit does not know the uncertainty of {metric}: state U"
        return None, factor, "inconclusive", {"reason": why, "u_source": _OF_FIT}
    one, two = student(quantity.dof, PROVEN), expanding_factor(quantity.dof)
    band = one * judged_by.u if judged_by.guard is None else judged_by.guard
    over_u = band / judged_by.u if judged_by.u > 0.0 else one
    verdict = decide(judged_by.value, **bounds, U=band, guard_factor=factor)
    said = (
        f"U from the residual of this fit, k = {two:.2f}, {quantity.dof:.3g} degrees of freedom; "
        "scale, reference and repeatability are not in it"
    )
    U = None if quantity.u is None else two * quantity.u
    if over_u > _WIDER * one:
        said += (
            f"; the guard band is {over_u:.2f} u instead of {one:.2f} u, since the deviations may rise "
            "towards waves longer than the map"
        )
    return U, factor * over_u / two, verdict, {"u_source": _OF_FIT, "u_note": said, "k": two}


def _bent(
    limits: Mapping[str, float | None], metric: str, place: Place
) -> dict[str, float | None]:
    """Return the limits of a curvature from those of its radius, which must keep clear of zero.

    R >= a > 0 is 0 <= c <= 1/a, R <= b > 0 is c >= 1/b; for negative ones the other way round.
    """
    from metrosep.forms.conic import curvature_name

    lower, upper = limits["lower"], limits["upper"]
    sign = {math.copysign(1.0, v) for v in (lower, upper) if v is not None}
    if len(sign) > 1 or 0.0 in (lower, upper):
        raise place.error(
            f"limits of {metric} on both sides of zero exclude flats and hold every short radius; "
            f"judge the curvature {curvature_name(metric)}, which is zero for a flat",
            "lower" if lower is not None else "upper",
        )
    low = None if upper is None else 1.0 / upper
    high = None if lower is None else 1.0 / lower
    if sign == {1.0}:
        return {"lower": 0.0 if low is None else low, "upper": high}
    return {"lower": low, "upper": 0.0 if high is None else high}
