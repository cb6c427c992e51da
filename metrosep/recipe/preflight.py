"""What a recipe must satisfy as a whole, checked before anything is read, computed or written.

A mistake that shows only after the tables are written leaves a machine file of a run that failed;
so all that can be known from the recipe alone is refused here, with its line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.compensation.area_errors import is_rotary
from metrosep.core.errors import DataError, Example, RecipeError
from metrosep.core.limits import (
    COVERAGE,
    FROM_FIT,
    Limit,
    limit_example,
    limit_problem,
    order_problem,
)
from metrosep.core.plugins import entries
from metrosep.core.readable import PREFIXED, said_value, typed_number
from metrosep.core.units import parse_quantity
from metrosep.parameters.decision import decide
from metrosep.recipe.methods.turned import AVERAGED, TurnedRuns
from metrosep.recipe.pipeline import MEASURING, lost_pixels
from metrosep.recipe.pipeline_checks import EVALUATING, SPECTRUM, known_unit, makes_metric
from metrosep.recipe.result import POSITIONING
from metrosep.recipe.schema import COMMAND, Place

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

RESULT_NAME = "result.json"

_ROUNDED_P = 0.5e-4
"""A share is typed to a hundredth of a per cent."""

_NORMAL_TOO = 3.0
"""GUM 6.3.3 names 2 and 3 as usual factors, and 3 is that of 99.73 %; between them t (G.3) is meant."""

_OF_DRY_RUN = ("after_pv", "after_rms")


def check_recipe(recipe: Recipe) -> None:
    """Refuse a recipe whose parts do not fit together."""
    seen: set[str] = set()
    for i, step in enumerate(recipe.steps):
        op, place = step["op"], recipe.place("[[step]]", i)
        if op in MEASURING and not recipe.is_pipeline:
            raise place.error(
                f'op = "{op}" measures one map or profile and does not go with '
                f'"{recipe.steps[0]["op"]}"; put it into a recipe of its own',
                "op",
            )
        if op == "polynomial" and op in seen:
            raise place.error("a recipe fits at most one polynomial", "op")
        if op == "plan_feedrates" and (op in seen or "separate" not in seen):
            raise place.error(
                "plan_feedrates uses the disturbance that the step separate finds: keep one of it, after that step",
                "op",
            )
        if op == "laser_setup" and seen:
            raise place.error("laser_setup corrects the readings: one step, before separate", "op")
        seen.add(op)
    _check_tables(recipe)
    if recipe.method is TurnedRuns:
        _check_turned(recipe)
    has_table = any(o["kind"] == "table" for o in recipe.outputs)
    for i, check in enumerate(recipe.checks):
        _check_limits(check, recipe.place("[[check]]", i), has_table=has_table)
    taken = {RESULT_NAME}
    for i, output in enumerate(recipe.outputs):
        place = recipe.place("[[output]]", i)
        for name in _names(output, place):
            if name.casefold() in taken:
                raise place.error(
                    f"two outputs would be called {name!r}; give one another path", "path"
                )
            taken.add(name.casefold())


def _check_tables(recipe: Recipe) -> None:
    """Refuse a table of a method that gives no error over the position of an axis."""
    named = recipe.is_method and recipe.method is not TurnedRuns
    for i, output in enumerate(recipe.outputs if named else ()):
        if output["kind"] == "table" and recipe.steps[0]["op"] != POSITIONING:
            raise recipe.place("[[output]]", i).error(
                f'a table is made by "separate" and "{POSITIONING}", not by "{recipe.steps[0]["op"]}"',
                "kind",
            )


def _check_turned(recipe: Recipe) -> None:
    """Refuse what belongs to runs along a length where the runs are over an angle."""
    if len(recipe.steps) > 1:
        op = recipe.steps[1]["op"]
        raise recipe.place("[[step]]", 1).error(
            f"over an angle the runs are averaged: {op} is of runs along a length, leave it out",
            "op",
        )
    for key, value in recipe.steps[0].items():
        if key != "op" and (key, value) != ("method", "mean"):
            raise recipe.place("[[step]]", 0).error(AVERAGED, key)
    for i, output in enumerate(recipe.outputs):
        if isinstance(output.get("spacing"), int):
            raise recipe.place("[[output]]", i).error(
                'over an angle the spacing is an angle, such as "5 deg"', "spacing"
            )


def _check_places(output: Mapping[str, Any], place: Place) -> None:
    """Refuse a position of a table that is a length where its axis turns, and the like."""
    dimension = "angle" if is_rotary(output["axis"]) else "length"
    spacing, reference = output.get("spacing"), output.get("reference")
    try:
        if isinstance(spacing, str):
            parse_quantity(spacing, dimension=dimension)
    except DataError as exc:
        raise place.error(f"spacing = {spacing!r}: {exc}", "spacing") from None
    unit = "rad" if dimension == "angle" else "m"
    problem = reference is not None and limit_problem(
        "reference", reference, f"the position of {output['axis']}", unit
    )
    if problem:
        raise place.error(problem, "reference")


def _check_limits(check: Mapping[str, Any], place: Place, *, has_table: bool) -> None:
    if check["metric"] in _OF_DRY_RUN and not has_table:
        raise place.error(
            f'metric "{check["metric"]}" is of the dry-run of a table: add an [[output]] of kind "table"',
            "metric",
        )
    if check["metric"].partition("#")[0] == SPECTRUM:
        stray = next((k for k in check if k not in ("metric", "name")), None)
        if stray is not None:
            raise place.error("PSD is judged by the limit of its step; leave this key out", stray)
        return
    origin = str(check.get("U_from", "stated"))
    if origin == "fit" and check.get("U", FROM_FIT) != FROM_FIT:
        raise place.error('U_from = "fit" takes U from the fit; leave U out', "U_from")
    if origin not in ("fit", "repeats", "stated") and not re.match(
        r"(budget|certificate): *\S", origin
    ):
        raise place.error(
            f'U_from = "{origin}" is not known; write fit, repeats, stated, "budget: FILE" or '
            '"certificate: NUMBER"',
            "U_from",
        )
    if check.get("U_from", "fit") not in ("fit", "repeats") and "U" not in check:
        raise place.error(
            f'U_from = "{origin}" says where a stated U comes from, and none is stated: write U',
            "U_from",
        )
    stray = next((key for key in ("k", "p") if key in check), None)
    if stray and check.get("U", FROM_FIT) == FROM_FIT:
        raise place.error(
            f"{stray} belongs to a stated U; without one metrosep expands u itself, to p = "
            f"{100 * COVERAGE:.2f} %. State U, or leave {stray} out",
            stray,
        )
    if not 0.5 < check.get("p", COVERAGE) < 1.0:
        raise place.error(
            f"p = {100 * check['p']:g} %: a coverage probability lies between 50 % and 100 %", "p"
        )
    k = check.get("k", 2.0)
    if not k >= 1.0:
        raise place.error(f"k = {k:g}: a coverage factor is at least 1", "k")
    normal = math.erf(k / math.sqrt(2.0))  # of every Student distribution the same k covers less
    if "p" not in check and k >= _NORMAL_TOO:
        raise place.error(
            f"k = {k:g} without p: {100 * COVERAGE:.2f} % of few degrees of freedom, or "
            f"{100 * normal:.2f} % of a normal distribution? State p",
            "k",
        )
    p = check.get("p", COVERAGE)
    if "k" in check and p > normal + _ROUNDED_P:
        raise place.error(
            f"p = {100 * p:.2f} % with k = {k:g}: no distribution of GUM G.3 covers more "
            f"than {100 * normal:.2f} % there; state p, or correct k",
            "p" if "p" in check else "k",
        )
    try:
        decide(
            0.0,
            lower=check.get("lower"),
            upper=check.get("upper"),
            U=0.0 if check.get("U") == FROM_FIT else check.get("U", 0.0),
            guard_factor=check.get("guard_factor", 1.0),
        )
    except DataError as exc:
        problem, named = str(exc), str(exc).partition(" ")[0]
        keys = [k for k in ("upper", "lower") if k in check]
        if named in check:  # U or guard_factor
            keys = [named]
        elif len(keys) > 1:
            problem = order_problem(check["lower"], check["upper"]) or problem
        errors = [place.error(problem, k) for k in keys] or [place.error(problem)]
        given = (e for e in errors if e.line is None)  # an override wrote it
        raise next(given, errors[0]) from None


def require_limits(recipe: Recipe) -> None:
    """Refuse limits of another kind than their value, where that shows without data."""
    for error in limit_errors(recipe):
        raise error


def limit_errors(recipe: Recipe) -> Iterator[RecipeError]:
    """Return what does not fit together though each key does: order of steps, metrics, limits.

    Examples
    --------
    >>> from metrosep.recipe import Recipe
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "parameters"
    ... names = ["Sku"]
    ... [[check]]
    ... metric = "Sku"
    ... upper = "3 nm"
    ... '''
    >>> [error.line for error in limit_errors(Recipe.parse(text))]
    [8]
    """
    if recipe.is_pipeline:
        yield from _order_errors(recipe)
    more: dict[str, str] = {}
    if recipe.sections:
        from metrosep.recipe.map_sections import section_metrics

        more = {k: u for s in recipe.sections for k, u in section_metrics(s).items()}
    for i, check in enumerate(recipe.checks if recipe.is_pipeline else ()):
        problem = makes_metric(recipe.steps, check["metric"], more)
        if problem:
            why, near = problem
            error = recipe.place("[[check]]", i).error(why, "metric")
            yield error if near is None else error.hinting(metric=near)
            continue
        unit = known_unit(recipe.steps, check["metric"], more)
        if unit is None:
            continue
        keys = [k for k in ("lower", "upper", "U") if k in check and check[k] != FROM_FIT]
        for key in keys:
            wrong = limit_problem(key, check[key], check["metric"], unit)
            if wrong is not None:
                error, example = (
                    recipe.place("[[check]]", i).error(wrong, key),
                    limit_example(unit),
                )
                yield error.hinting(**{key: Example(example)}) if example else error


def _order_errors(recipe: Recipe) -> Iterator[RecipeError]:
    """Yield a line for each evaluation behind which a step changes what was evaluated."""
    done = [(i, s) for i, s in enumerate(recipe.steps) if s.get("enabled", True)]
    drawn = [("[[step]]", "op", i, s, recipe.steps[:i]) for i, s in done]
    drawn += [("[[section]]", "name", i, s, recipe.steps) for i, s in enumerate(recipe.sections)]
    for header, key, i, table, before in drawn:
        if lost := lost_pixels(before, table):
            yield recipe.place(header, i).error(lost, key)
    for i, step in done:
        changing = [k for k, s in done if k > i and s["op"] not in EVALUATING]
        if step["op"] not in EVALUATING or step.get("intermediate", False) or not changing:
            continue
        place, later = recipe.place("[[step]]", i), recipe.place("[[step]]", changing[0])
        where = later.line_of("op")
        yield place.error(
            f"step {i + 1} evaluates what step {changing[0] + 1} ({recipe.steps[changing[0]]['op']}"
            f"{'' if where is None else f', line {where}'}) changes afterwards, so that one surface is "
            "shown and another judged; put that step first, or write intermediate = true here",
            "op",
        ).hinting(intermediate=True)


def _names(output: Mapping[str, Any], place: Place) -> list[str]:
    """File names of an output, all that it needs being known."""
    if output["kind"] == "table":
        from metrosep.controllers import names

        if output["controller"] not in names():
            raise place.error(
                f"unknown controller {output['controller']!r}; there are {', '.join(names())}",
                "controller",
            )
        _require_carrier(output, place)
        _check_places(output, place)
        if "compensates" not in output:
            raise place.error(which_axis(output["axis"], "compensates = "), "compensates")
        machine_limits(output, place)
        name = output_name(output["path"], place)
        return [name, f"{name}.json"]
    if output["kind"] == "program":
        name = output_name(output["path"], place)
        return [name, f"{name}.json"]
    if output["kind"] == "parts":
        return [_parts_name(output_name(output.get("path", "parts.csv"), place), place)]
    known = report_formats()
    formats = output.get("formats", ["html"])
    for name in formats:
        if name not in known:
            raise place.error(
                f"no report format {name!r} in this version; there are {', '.join(sorted(known)) or 'none'}",
                "formats",
            )
    return [output_name(output.get("path", report_name(name)), place) for name in formats]


def _require_carrier(output: Mapping[str, Any], place: Place) -> None:
    """Refuse a controller that holds no errors of one axis, and keys of a table that it has no use for."""
    from metrosep.controllers.registry import find
    from metrosep.controllers.safety import checked_waivers

    name = output["controller"]
    carries = find(name).info.carries
    if carries == "map":
        raise place.error(
            f"{name} holds maps over two axes, this is the error of one axis; use 'metrosep table MAP "
            "--format ...' with a measured map",
            "controller",
        )
    if "degree" in output and carries != "polynomial":
        raise place.error(
            f"degree is for controllers that hold a polynomial, and {name} holds a {carries}; leave it out",
            "degree",
        )
    try:
        checked_waivers(output.get("waive", ()))
    except DataError as exc:
        raise place.error(str(exc), "waive") from None


def _parts_name(name: str, place: Place) -> str:
    """Return the name of the file of parts, if it ends as one of any kind does."""
    from metrosep.io.write import SUFFIXES

    suffix, known = Path(name).suffix.lower(), dict.fromkeys((*SUFFIXES, ".txt", ".dat"))
    if suffix in known or (not suffix and not name.startswith(".") and not name.endswith(".")):
        return name
    raise place.error(
        f"path: {name!r} does not say the format of the parts; give a name that ends in "
        f"{', '.join(known)}",
        "path",
    )


def report_formats() -> dict[str, Any]:
    """Return the installed report writers by format."""
    return entries("metrosep.reports")


def report_name(kind: str, stem: str = "report") -> str:
    """Return the name of a report of a format."""
    return f"{stem}.dcc.xml" if kind == "dcc" else f"{stem}.{kind}"


def output_name(name: str, place: Place) -> str:
    """Return the name of an output file, which must not lead out of the output folder."""
    if name in ("", ".", "..") or Path(name).name != name or "\\" in name or "\0" in name:
        raise place.error(
            f"output path {name!r} must be a plain file name; the folder is given with -o", "path"
        )
    return name


def machine_limits(output: Mapping[str, Any], place: Place) -> dict[str, Any]:
    """Return ``machine`` of an output in SI; quantities are texts with units."""
    from metrosep.controllers.options import (
        LIMIT_DIMENSIONS,
        checked_limits,
        checked_options,
        split_machine,
    )
    from metrosep.controllers.registry import find

    dialect, name = find(output["controller"]), output["controller"]
    given = dict(output.get("machine", {}))
    dimensions = {**LIMIT_DIMENSIONS, **{o.name: o.kind for o in dialect.options}}
    plain = ("integer", "number", "text", "flag", "choice", "object")
    for key, value in given.items():
        if dimensions.get(key, "text") not in plain and not isinstance(value, str):
            raise place.error(
                f"machine {key} = {said_value(value)} needs a unit, as a text", "machine"
            )
    try:
        options, limits = split_machine(given, dialect.options, name)
        checked = checked_options(options, dialect.options, name)
        return {**{k: checked[k] for k in options}, **checked_limits(limits, name)}
    except DataError as exc:
        text = str(exc)
        if place.file != COMMAND:
            from metrosep.recipe.step_help import table_words
            from metrosep.recipe.written.overrides import toml_text

            wanted = {**given, **{k: v for hint in exc.hints for k, v in hint.items()}}
            text = table_words(text, name)
            text += f": write machine = {toml_text(wanted)}" if exc.hints else ""
        named = text.startswith("unknown machine")
        raise place.error(text if named else f"machine {text}", "machine") from None


def which_axis(axis: str, key: str) -> str:
    """Return the question which axis the corrections are of: both answers, and how to give them."""
    return (
        f"which axis do the readings of {axis} show, and shall the table correct? {key}{_said(axis, key)} "
        f"if {axis} corrects itself (positioning, pitch), or another axis such as "
        f"{key}{_said('Z' if axis != 'Z' else 'X', key)} (straightness); it is not assumed"
    )


def _said(axis: str, key: str) -> str:
    return f'"{axis}"' if "=" in key else axis


# ---- limits whose guard bands leave no room: a part between them can never be accepted ---------

_DIGITS = 6


def guard_notes(recipe: Recipe) -> Iterator[str]:
    """Return which checks can accept nothing, whatever is measured.

    Examples
    --------
    >>> from metrosep.recipe import Recipe
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "parameters"
    ... names = ["Sa"]
    ... [[check]]
    ... metric = "Sa"
    ... lower = "9 nm"
    ... upper = "12 nm"
    ... U = "2 nm"
    ... '''
    >>> print(*guard_notes(Recipe.parse(text, name="r.toml")))
    r.toml:10: nothing can be accepted: with U = 2 nm a value must be at least 11 nm and at most 10 nm
    """
    for i, check in enumerate(recipe.checks):
        if not all(isinstance(check.get(k), float | int) for k in ("lower", "upper", "U")):
            continue
        lower, upper, U = check["lower"], check["upper"], check["U"]
        factor = check.get("guard_factor", 1.0)
        guard = factor * U
        middle = lower + 0.5 * (upper - lower)
        limits = {"lower": lower, "upper": upper, "U": U, "guard_factor": factor}
        if decide(float(middle), **limits) == "accept":
            continue
        shown = [_shown(v, lower) for v in (U, lower + guard, upper - guard)]
        times = "" if factor == 1.0 else f" and guard_factor = {factor:g}"
        yield str(
            _error(
                recipe,
                i,
                f"nothing can be accepted: with U = {shown[0]}{times} a value must be at least "
                f"{shown[1]} and at most {shown[2]}",
            )
        )


def _error(recipe: Recipe, number: int, text: str) -> RecipeError:
    return recipe.place("[[check]]", number).error(text, "U")


def _shown(value: float, like: Any) -> str:
    """Return a value as the limits are given: lengths with their unit."""
    dimension = like.dimension if isinstance(like, Limit) else ""
    if dimension in PREFIXED:
        return typed_number(float(value), PREFIXED[dimension], digits=_DIGITS)
    return f"{float(value):.{_DIGITS}g} {dimension}".strip()
