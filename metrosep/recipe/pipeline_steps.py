"""The steps that measure: what each does to one map or profile, and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from metrosep.core.profile import Profile
from metrosep.core.quantity import Quantity
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.recipe.pipeline_checks import (
    USUAL_OF_MAPS,
    USUAL_OF_PROFILES,
    Evaluating,
    StepError,
    form_options,
    iso_filtered,
    parameter_tables,
)
from metrosep.recipe.pipeline_mask import Measured, masked, without_outliers

__all__ = ["APPLY", "Done", "usual_names"]


@dataclass(frozen=True, slots=True)
class Done:
    """What a step made."""

    obj: Measured  # or Profile: after the step; the very object where the step only evaluates
    # mapping of str to Quantity: by metric
    found: Mapping[str, Quantity] = field(default_factory=dict)
    messages: tuple[str, ...] = ()  # what the user should know
    audit: Mapping[str, Any] = field(default_factory=dict)  # mapping: what was done, plain values
    detail: Any = None  # `FitResult` of a form, tuple of `ParameterTable` of parameters, else None


def _mask(obj: Measured, options: Mapping[str, Any]) -> Done:
    result, audit = masked(obj, options["aperture"], outside=options.get("outside", True))
    x, y = audit["centre_m"]
    where = (
        format_length(x)
        if isinstance(obj, Profile)
        else f"({format_length(x)}, {format_length(y)})"
    )
    text = f"mask about {where}: {audit['taken_out']} measured heights taken out, {audit['left']} left"
    return Done(result, messages=(text,), audit=audit)


def _outliers(obj: Measured, options: Mapping[str, Any]) -> Done:
    given = {k: v for k, v in options.items() if k in ("threshold", "window", "form")}
    result, audit = without_outliers(obj, **given)
    n, measured = audit["taken_out"], audit["taken_out"] + audit["left"]
    text = (
        f"outliers: {n} of {measured} measured heights taken out (robust sigma "
        f"{format_length(audit['sigma_m'])}); nothing is filled"
    )
    messages = [text]
    if audit["not_judged"]:
        messages.append(
            f"outliers: {audit['not_judged']} heights at an edge or a gap have no opposite "
            "neighbours and were not judged; a smaller aperture removes the rim"
        )
    return Done(result, messages=tuple(messages), audit=audit)


def _form(obj: Measured, options: Mapping[str, Any]) -> Done:
    from metrosep.forms.fit import fit

    ideal, rest = form_options(options)
    result = fit(obj, ideal, **rest)
    left = result.residual
    assert isinstance(left, Surface | Profile)  # noqa: S101  # as obj is
    u, name = result.u, result.form.name
    found = {
        k: Quantity(
            result.params[k],
            result.units[k],
            f"{k.replace('_', ' ')} of the fitted {name}",
            u=float(v) if np.isfinite(v) else None,
            symbol=k,
            dof=result.dof_effective if np.isfinite(result.dof_effective) else None,
            u_source="fit residual",
        )
        for k, v in u.items()
    }
    text = f"of what the {name} leaves, before any further step"
    found["residual.pv"] = Quantity(
        result.peak_to_valley, "m", f"P-V {text}", symbol="PV residual"
    )
    found["residual.rms"] = Quantity(result.rms, "m", f"RMS {text}", symbol="RMS residual")
    messages = [*result.warnings, *result.notes, *([result.assumption] if u else [])]
    lost = left.n_invalid - obj.n_invalid
    if lost:
        messages.append(f"{lost} measured heights lie where the {name} has no value")
    return Done(left, found, tuple(messages), result.to_dict(), result)


def _filter(obj: Measured, options: Mapping[str, Any]) -> Done:
    kind = options.get("kind", "gaussian")
    if isinstance(obj, Surface):
        for key in ("profile", "sections"):
            if key in options:
                raise StepError(f"{key} belongs to profiles, and this is a map", key)
    if "lambda_s" in options or "lambda_c" in options:
        result = iso_filtered(
            obj,
            lambda_s=options.get("lambda_s"),
            lambda_c=options.get("lambda_c"),
            end=options.get("end", "moment"),
            kind=options.get("profile"),
            sections=options.get("sections"),
        )
    else:
        result = _one_cutoff(obj, kind, options)
    shape: Any = result.z.shape
    messages = []
    if shape != obj.z.shape:
        messages.append(
            f"filter: the ends were cut, {obj.z.size - result.z.size} samples are gone"
        )
    elif result.n_invalid > obj.n_invalid:
        messages.append(
            f"filter: {result.n_invalid - obj.n_invalid} heights have too few measured ones within "
            "the cut-off and were taken out"
        )
    return Done(result, messages=tuple(messages), audit={"left": result.z.size - result.n_invalid})


def _one_cutoff(obj: Measured, kind: str, options: Mapping[str, Any]) -> Any:
    from metrosep import filters

    name = {"robust": "robust_gaussian"}.get(kind, kind)
    keys = ("band", "end", "order", "tension", "refilter", "radius", "length")
    rest = {k: options[k] for k in keys if k in options}
    if "cutoff" in options:
        rest["nesting_index" if isinstance(obj, Surface) else "cutoff"] = options["cutoff"]
    return getattr(filters, name)(obj, **rest)


_OF_PROFILES = ("kind", "edition", "sections", "centre")


def _parameters(obj: Measured, options: Mapping[str, Any]) -> Done:
    if isinstance(obj, Surface):
        for key in _OF_PROFILES:
            if options.get(key):
                raise StepError(f"{key} belongs to profiles, and this is a map", key)
    settings = {k: v for k, v in options.items() if k in (*_OF_PROFILES, "line", "reference")}
    names = options.get("names")
    asked = usual_names(obj, options.get("kind")) if names is None else tuple(names)
    if "all" in asked:
        asked = ()
    tables = parameter_tables(obj, Evaluating(names=asked, **settings))
    found = {symbol: quantity for table in tables for symbol, quantity in table.items()}
    messages = [note for table in tables for note in table.context.notes]
    messages += [
        f"{s} is not available: {why}" for t in tables for s, why in t.unavailable.items()
    ]
    if options.get("intermediate", False):
        messages.append(
            f"intermediate: {', '.join(found)} are of the surface before the steps that follow, not of "
            "the one that is shown as judged"
        )
    contexts = [t.to_dict() for t in tables]
    audit = {
        "evaluations": [
            {k: t[k] for k in ("edition", "n_valid", "n_total", "chain", "settings")}
            for t in contexts
        ],
        "unavailable": {s: why for t in contexts for s, why in t["unavailable"].items()},
    }
    return Done(obj, found, tuple(dict.fromkeys(messages)), audit, tables)


def usual_names(obj: Measured, kind: str | None = None) -> tuple[str, ...]:
    """Return the parameters that are evaluated where none are named."""
    if isinstance(obj, Surface):
        return USUAL_OF_MAPS
    from metrosep.filters import profile_kind

    letter = kind or profile_kind(obj) or "P"
    return tuple(f"{letter}{s}" for s in USUAL_OF_PROFILES)


APPLY: Mapping[str, Callable[[Measured, Mapping[str, Any]], Done]] = {
    "mask": _mask,
    "outliers": _outliers,
    "form": _form,
    "filter": _filter,
    "parameters": _parameters,
}
