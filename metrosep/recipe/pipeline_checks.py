"""Checks of steps that measure, and their values in SI: before anything is read."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from metrosep.core.errors import DataError
from metrosep.recipe.key_values import DIMENSIONS
from metrosep.recipe.kinds import KINDS
from metrosep.recipe.pipeline_keys import Key

__all__ = ["CHECKS", "StepError", "form_options", "known_unit", "makes_metric", "normal_values"]

Check = Callable[[Mapping[str, Any]], None]


class StepError(DataError):
    """A step that cannot be carried out as it is written, or not on this kind of data."""

    def __init__(self, message: str, key: str | None = None) -> None:
        super().__init__(message)
        self.key = key


def normal_values(given: Mapping[str, Any], keys: Mapping[str, Key], what: str) -> dict[str, Any]:
    """Return the values of a step in SI."""
    values: dict[str, Any] = {}
    for name, value in given.items():
        if name not in keys:
            near = difflib.get_close_matches(str(name), list(keys), n=1)
            hint = f' Did you mean "{near[0]}"?' if near else ""
            raise StepError(
                f'unknown key "{name}" in {what}; known: {", ".join(keys)}.{hint}', str(name)
            )
        key = keys[name]
        choices = key.field.choices
        if choices and (value not in choices or isinstance(value, bool)):
            known = ", ".join(str(c) for c in choices)
            raise StepError(f"{name} = {value!r} is not one of {known}", name)
        if name == "centre" and not key.field.required and key.field.kind == "any":
            values[name] = _centre(value)
        elif key.inner:
            if not isinstance(value, Mapping):
                raise StepError(
                    f"{name} is a table, such as {{ {next(iter(key.inner))} = ... }}", name
                )
            try:
                values[name] = normal_values(value, key.inner, f"{name} of {what}")
            except StepError as exc:
                raise StepError(str(exc), name) from None
        else:
            values[name] = _normal(value, key, name)
    for name, key in keys.items():
        if key.field.required and name not in given:
            raise StepError(f'{what} needs the key "{name}"')
    return values


def _normal(value: Any, key: Key, name: str) -> Any:
    kind = key.field.kind
    try:
        if kind in DIMENSIONS and not isinstance(value, str):
            if isinstance(value, list | tuple):
                one = KINDS["length" if kind == "lengths" else kind]
                return tuple(one(v) if isinstance(v, str) else _number(v, kind) for v in value)
            return _number(value, kind)
        if kind == "texts" and isinstance(value, tuple):
            value = list(value)
        if kind == "table":
            value = dict(value)
        return KINDS[kind](value)
    except (TypeError, ValueError) as exc:
        raise StepError(f"{name} = {value!r}: {exc}", name) from None


def _number(value: Any, kind: str) -> float:
    number: float = KINDS["number"](value)
    if kind == "size" and number <= 0.0:
        raise ValueError("it must be more than zero")
    return number


def _centre(value: Any) -> Any:
    if value == "fit":
        return "fit"
    if isinstance(value, str) or not isinstance(value, list | tuple) or not 1 <= len(value) <= 2:
        raise StepError(
            f'centre = {value!r}: "fit", or x and y such as ["5 mm", "5 mm"] are needed here',
            "centre",
        )
    try:
        return tuple(
            KINDS["length"](v) if isinstance(v, str) else _number(v, "length") for v in value
        )
    except (TypeError, ValueError) as exc:
        raise StepError(f"centre = {list(value)!r}: {exc}", "centre") from None


def form_options(options: Mapping[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Return the ideal form of a step, and the options of its fit."""
    from metrosep.forms.catalogue import form_from_text

    try:
        ideal = form_from_text(options["form"])
    except DataError as exc:
        raise StepError(str(exc), "form") from None
    rest = {k: v for k, v in options.items() if k in ("robust", "tilt", "direction")}
    if "free" in options:
        rest["free"] = tuple(options["free"])
    for key, name in (("fix", "fixed"), ("start", "start")):
        if key in options:
            rest[name] = _form_numbers(options[key], ideal, key)
    if "centre" in options:
        centre = tuple(options["centre"])
        if len(centre) > 2:
            raise StepError(f"centre has x and y, got {len(centre)} values", "centre")
        rest["centre"] = (*centre, 0.0)[:2]
    return ideal, rest


def _form_numbers(given: Mapping[str, Any], ideal: Any, key: str) -> dict[str, float]:
    from metrosep.forms.catalogue import parameter_value
    from metrosep.forms.freedoms import RIGID

    units = {**RIGID, **ideal.units_of()}
    found = {}
    for name, value in given.items():
        if name not in units:
            raise StepError(f"{key}: {name} is none of {', '.join(units)}", key)
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            raise StepError(f"{key}: {name} = {value!r} is no number with a unit", key)
        pure = units[name] in ("1", "")
        if not isinstance(value, str) and not pure:
            raise StepError(
                f'{key}: {name} = {value!r} needs its unit, such as {name} = "{value} mm", or '
                f'"{value} SI"',
                key,
            )
        try:
            found[name] = parameter_value(str(value), units[name], name)
        except DataError as exc:
            raise StepError(f"{key}: {exc}", key) from None
    return found


_OF_KIND = {
    "gaussian": (
        "lambda_s",
        "lambda_c",
        "profile",
        "sections",
        "cutoff",
        "band",
        "end",
        "refilter",
    ),
    "spline": ("cutoff", "band", "end", "tension", "refilter"),
    "robust": ("cutoff", "band", "order", "refilter"),
    "closing": ("radius", "length", "band", "refilter"),
    "opening": ("radius", "length", "band", "refilter"),
}


def _check_filter(options: Mapping[str, Any]) -> None:
    kind = options.get("kind", "gaussian")
    given = {k for k in options if k not in ("op", "enabled", "kind")}
    stray = next((k for k in options if k in given - set(_OF_KIND[kind])), None)
    if stray is not None:
        raise StepError(f"{stray} does not belong to kind = {kind!r}", stray)
    if kind in ("closing", "opening"):
        if len(given & {"radius", "length"}) != 1:
            raise StepError(f'{kind} needs radius = "5 um", or length = "10 um"', "kind")
        return
    pair = given & {"lambda_s", "lambda_c"}
    if kind != "gaussian" and "cutoff" not in given:
        raise StepError(f'kind = {kind!r} needs cutoff = "25 um"', "kind")
    if bool(pair) == ("cutoff" in given):
        raise StepError(
            'a gaussian filter needs lambda_s, lambda_c or both, or cutoff = "25 um" with a band',
            "cutoff" if pair else "op",
        )
    if pair:
        for key in ("band", "refilter"):
            if key in given:
                raise StepError(f"{key} goes with cutoff, not with lambda_s and lambda_c", key)
    for key in ("profile", "sections"):
        if key in given and "lambda_c" not in given:
            raise StepError(f'{key} goes with lambda_c = "0.8 mm"', key)
    ends = (
        ("natural", "closed") if kind == "spline" else ("moment", "renormalise", "cut", "closed")
    )
    if options.get("end", ends[0]) not in ends:
        raise StepError(f"end of a {kind} filter is one of {', '.join(ends)}", "end")
    low, high = options.get("lambda_s"), options.get("lambda_c")
    if low is not None and high is not None and not low < high:
        raise StepError("lambda_s must be shorter than lambda_c", "lambda_s")
    for key in ("sections",):
        if options.get(key, 1) < 1:
            raise StepError(f"{key} is a whole number from 1", key)


def _check_form(options: Mapping[str, Any]) -> None:
    form_options(options)


def _check_mask(options: Mapping[str, Any]) -> None:
    from metrosep.recipe.pipeline_mask import check_sizes

    aperture = options["aperture"]
    try:
        check_sizes(aperture["shape"], aperture, is_profile="height" not in aperture)
    except DataError as exc:
        raise StepError(str(exc), "aperture") from None


def _check_outliers(options: Mapping[str, Any]) -> None:
    from metrosep.forms.catalogue import form_from_text
    from metrosep.recipe.pipeline_outliers import SMOOTH

    if options.get("threshold", 6.0) <= 0.0:
        raise StepError("threshold must be more than zero", "threshold")
    window = options.get("window", 5)
    if window < 3 or window % 2 == 0:
        raise StepError(f"window is an odd number of samples from 3, got {window}", "window")
    text = options.get("form", SMOOTH)
    if text.strip().lower() != SMOOTH:
        try:
            form_from_text(text)
        except DataError as exc:
            raise StepError(str(exc), "form") from None


def _check_parameters(options: Mapping[str, Any]) -> None:
    names = options.get("names")
    if names is not None and (not names or not all(n.strip() for n in names)):
        raise StepError('names lists symbols such as ["Sa", "PV"], or "all"', "names")
    if options.get("sections", 1) < 1:
        raise StepError("sections is a whole number from 1", "sections")


CHECKS: Mapping[str, Check] = {
    "mask": _check_mask,
    "outliers": _check_outliers,
    "form": _check_form,
    "filter": _check_filter,
    "parameters": _check_parameters,
}


def known_unit(steps: Sequence[Mapping[str, Any]], metric: str) -> str | None:
    """Return the SI unit that a metric has, where the steps tell it without data.

    Examples
    --------
    >>> steps = [{"op": "form", "form": "sphere"}, {"op": "parameters"}]
    >>> [known_unit(steps, name) for name in ("Sku", "R", "tilt_x", "thing")]
    ['1', 'm', 'rad', None]
    """
    symbol = metric.partition("#")[0]
    carried_out = (s for s in steps if s.get("enabled", True))
    found = {u for s in carried_out if (u := _unit_in(s, symbol)) is not None}
    return found.pop() if len(found) == 1 else None


def makes_metric(steps: Sequence[Mapping[str, Any]], metric: str) -> str | None:
    """Return why no step makes a metric, as far as that shows without data.

    Examples
    --------
    >>> makes_metric([{"op": "parameters", "names": ["Sq"]}], "Sa")
    'metric = "Sa" is made by no step; did you mean "Sq"?'
    """
    symbol, _, number = metric.partition("#")
    carried_out = [s for s in steps if s.get("enabled", True)]
    n = sum(_makes(s, symbol) for s in carried_out)
    if n >= (int(number) if number.isdecimal() else 1):
        return None
    known = sorted({name for s in carried_out for name in _named(s)})
    near = difflib.get_close_matches(symbol, known, n=1, cutoff=0.4)
    if n:
        return f'metric = "{metric}": {symbol} is made {n} time{"s" if n > 1 else ""} only'
    hint = f'; did you mean "{near[0]}"?' if near else f"; there are {', '.join(known) or 'none'}"
    return f'metric = "{metric}" is made by no step{hint}'


def _makes(step: Mapping[str, Any], symbol: str) -> bool:
    named = _named(step)
    if step["op"] != "parameters" or symbol in named:
        return symbol in named
    from metrosep.parameters.symbol_units import is_of_all, same_parameter

    if "all" in step.get("names", ()):
        return is_of_all(symbol)
    return any(same_parameter(symbol, name) for name in named)


def _named(step: Mapping[str, Any]) -> set[str]:
    """Return the metrics that a step makes, in one spelling; with "all" some are left out."""
    if step["op"] == "parameters":
        from metrosep.recipe.pipeline_steps import USUAL_OF_MAPS, USUAL_OF_PROFILES

        usual = {*USUAL_OF_MAPS, *(k + s for k in "PWR" for s in USUAL_OF_PROFILES)}
        return set(step.get("names") or usual) - {"all"}
    if step["op"] != "form":
        return set()
    return set(_units_of_form(step))


def _unit_in(step: Mapping[str, Any], symbol: str) -> str | None:
    if step["op"] == "parameters":
        from metrosep.parameters.symbol_units import unit_of_symbol

        return unit_of_symbol(symbol)
    if step["op"] != "form":
        return None
    return _units_of_form(step).get(symbol)


def _units_of_form(step: Mapping[str, Any]) -> dict[str, str]:
    """Return the unit of each value that the fit of a form finds; a radius also as a curvature."""
    from metrosep.forms._curvature import curvature_name
    from metrosep.forms.freedoms import RIGID

    ideal = form_options(step)[0]
    bent = dict.fromkeys((curvature_name(n) for n in ideal.radii), "1/m")
    left = dict.fromkeys(("residual.pv", "residual.rms"), "m")
    return {**left, **RIGID, **ideal.units_of(), **bent}
