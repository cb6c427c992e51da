"""Carrying out a recipe whose step is one of the named separations (`metrosep.recipe.methods`)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.quantity import Quantity
from metrosep.parameters.decision import decide, worst
from metrosep.recipe.characteristics import DECISION_RULE
from metrosep.recipe.described import describe
from metrosep.recipe.description import Description
from metrosep.recipe.inputs_read import input_records, named_files
from metrosep.recipe.limits import limit_problem
from metrosep.recipe.method import Method
from metrosep.recipe.method_inputs import load_inputs, sources
from metrosep.recipe.methods import METHODS
from metrosep.recipe.outputs import write_reports
from metrosep.recipe.parts import write_parts
from metrosep.recipe.preflight import RESULT_NAME
from metrosep.recipe.result import SCHEMA, Result, clean
from metrosep.recipe.staging import staged

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = ["judged", "run_method"]


def run_method(
    recipe: Recipe,
    files: list[Path],
    *,
    out: Path | None,
    tell: Callable[[str], None],
    with_result: bool = True,
    more: Mapping[str, Any] | None = None,
) -> Result:
    """Read, separate, judge and write.

    Parameters
    ----------
    recipe : Recipe
        Whose step names a method.
    files : list of Path
        Inputs, in order.
    out : Path or None
        Folder for the results.
    tell : callable
        Told what is being done.
    with_result : bool, optional
        Also write result.json into `out`.
    more : mapping, optional
        Further keys of the document, such as the unit of a batch; the reports hold them too.

    Returns
    -------
    Result
        Document, separation, files.

    Raises
    ------
    MetrosepError
        Of any kind of its tree; nothing is left in `out` then.
    """
    step = recipe.steps[0]
    method = METHODS[step["op"]]
    if method.reads != "nothing":
        tell(f"reading {len(files)} file(s)")
    inputs = load_inputs(method, files, {k: v for k, v in recipe.input.items() if k != "files"})
    _require_kind(recipe, inputs)
    tell(f"{'computing' if method.reads == 'nothing' else 'separating'}: {method.what}")
    options = _options(method, step, recipe.folder)
    named = named_files(options, method.fields)
    produced = method.call(inputs, options)
    history, warnings = sources(inputs)
    history = (*history, *getattr(produced, "beside", ()))
    described = describe(produced, inputs)
    records = input_records(history, inputs if isinstance(inputs, tuple) else (inputs,))
    known = {(i["name"], i["sha256"]) for i in records}
    records += [n for n in named if (n["name"], n["sha256"]) not in known]
    document = _document(recipe, produced, described, history, warnings, records)
    document |= more or {}
    if out is None:
        return Result(document, produced)
    with staged(out) as stage:
        names = write_parts(recipe, described, stage, tell, document)
        names += write_reports(recipe, document, stage, tell)
        if with_result:
            Result(document, produced).write(stage / RESULT_NAME)
            names.append(RESULT_NAME)
    return Result(document, produced, tuple(out / n for n in names))


_OF_ROLE = {"tolerance": "value", "u_reading": "reading"}
"""Keys that are lengths or angles, as the columns of a role are."""


def _require_kind(recipe: Recipe, inputs: Any) -> None:
    """Refuse a key of a step that is an angle where the readings are lengths, and the like."""
    step, units = recipe.steps[0], getattr(inputs, "units", None) or {}
    for key, field in METHODS[step["op"]].fields.items():
        unit = units.get(_OF_ROLE.get(key, "")) if field.kind == "limit" else None
        if key not in step or unit is None:
            continue
        problem = limit_problem(key, step[key], f"the {_OF_ROLE[key]} column", unit)
        if problem is not None:
            raise recipe.place("[[step]]", 0).error(problem, key)


def _options(method: Method, step: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the keys of a step; names of files are looked for beside the recipe."""
    options = {k: v for k, v in step.items() if k != "op"}
    for key, value in options.items():
        if method.fields[key].kind == "file" and (folder / value).exists():
            options[key] = str(folder / value)
    return options


def _document(
    recipe: Recipe,
    produced: Any,
    described: Description,
    history: Iterable[Step],
    warnings: tuple[str, ...],
    inputs: list[dict[str, Any]],
) -> dict[str, Any]:
    from metrosep.recipe.run import versions

    steps = tuple(history)
    name = recipe.steps[0]["op"]
    messages = (*getattr(produced, "messages", ()), *described.messages)
    return clean(  # type: ignore[no-any-return]
        {
            "schema": SCHEMA,
            "metrosep": __version__,
            "title": recipe.title or METHODS[name].what.capitalize(),
            "inputs": inputs,
            "estimate": None,
            "separation": {
                "op": name,
                "what": METHODS[name].what,
                "result": type(produced).__name__,
                "audit": dict(described.audit),
                "messages": list(messages),
                **described.document,
                "charts": list(described.charts),
            },
            "plots": None,
            "table": None,
            "more_tables": [],
            "polynomial": None,
            "messages": [*warnings, *messages],
            "provenance": history_as_dicts((*steps, Step(name, dict(recipe.steps[0])))),
            "recipe": recipe.recorded,
            "versions": versions(),
            "decision_rule": DECISION_RULE,
            **judged(recipe, described.quantities, unlisted=described.unlisted),
        }
    )


def judged(
    recipe: Recipe, found: Mapping[str, Quantity], *, unlisted: Collection[str] = ()
) -> dict[str, Any]:
    """Return what was measured, and the verdict of each check.

    Parameters
    ----------
    recipe : Recipe
        With its checks.
    found : mapping of str to Quantity
        By metric.
    unlisted : collection of str, optional
        Metrics that are not listed unless a check names them.

    Returns
    -------
    dict
        ``characteristics`` and ``verdict`` of a result document.

    Raises
    ------
    RecipeError
        If a check names a metric that is not there, a limit or U is of another kind than the value,
        or the uncertainty is not known.
    """
    entries = []
    verdicts = []
    for i, check in enumerate(recipe.checks):
        metric, place = check["metric"], recipe.place("[[check]]", i)
        if metric not in found:
            known = ", ".join(found)
            raise place.error(
                f'metric = "{metric}" is not in this result; there are {known}', "metric"
            )
        quantity = found[metric]
        for key in ("lower", "upper", "U"):
            if key in check:
                problem = limit_problem(key, check[key], metric, quantity.unit)
                if problem is not None:
                    raise place.error(problem, key)
        expanded = check.get("U", None if quantity.u is None else 2.0 * quantity.u)
        if expanded is None:
            raise place.error(
                f'the uncertainty of {metric} is not known; state it: U = "10 nm"', "metric"
            )
        expanded = float(expanded)
        limits = {k: float(check[k]) if k in check else None for k in ("lower", "upper")}
        guard = check.get("guard_factor", 1.0)
        verdict = decide(quantity.value, **limits, U=expanded, guard_factor=guard)
        verdicts.append(verdict)
        name = check.get("name", quantity.definition)
        entries.append(
            {**quantity.to_dict(), "metric": metric, "name": name, **limits, "U": expanded}
            | {"guard_factor": guard, "verdict": verdict}
        )
    checked = {c["metric"] for c in recipe.checks}
    rest = [
        {**q.to_dict(), "metric": k, "name": q.symbol or k, "lower": None, "upper": None}
        | {"U": None, "guard_factor": None, "verdict": None}
        for k, q in found.items()
        if k not in checked and k not in unlisted
    ]
    return {"characteristics": [*entries, *rest], "verdict": worst(verdicts)}
