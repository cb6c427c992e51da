"""Carrying out a recipe: read, separate, fit, check, write; result.json last."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep._version import __version__
from metrosep.compensation.measured import fold_estimates, source_hashes, used_runs
from metrosep.core._arrays import by_number
from metrosep.core.errors import MetrosepError, ReadError, RecipeError
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length
from metrosep.recipe.characteristics import DECISION_RULE, characteristics
from metrosep.recipe.outputs import (
    WrittenTable,
    dry_runs,
    polynomial_of,
    require_free,
    staged,
    table_names,
    write_reports,
    write_tables,
)
from metrosep.recipe.parts import input_records, write_arrays
from metrosep.recipe.preflight import RESULT_NAME
from metrosep.recipe.report_fields import report_of
from metrosep.recipe.result import (
    SCHEMA,
    Result,
    clean,
    measured_runs,
    plot_data,
    run_records,
    versions,
)
from metrosep.recipe.schema import reading_options
from metrosep.separation.runs.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

PathLike = str | os.PathLike[str]
Progress = Callable[[str], None]


def run_recipe(
    recipe: Recipe,
    inputs: PathLike | Iterable[PathLike] | None,
    *,
    out: PathLike | None,
    progress: Progress | None,
    with_result: bool = True,
    more: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    beside: Sequence[PathLike] = (),
) -> Result:
    """Run a recipe; see `Recipe.run`. Without `out` its tables may have places of their own."""
    tell = progress or _silent
    folder = None if out is None else Path(out)
    places = [folder / n for n in table_names(recipe)] if folder else [Path(p) for p in beside]
    if places and not overwrite:
        require_free(recipe, places)
    files = input_files(recipe, inputs)
    if recipe.is_pipeline:
        from metrosep.recipe.pipeline_run import run_pipeline

        return run_pipeline(
            recipe, files, out=folder, tell=tell, with_result=with_result, more=more
        )
    if recipe.is_method:
        from metrosep.recipe.method_run import run_method

        return run_method(
            recipe, files, out=folder, tell=tell, with_result=with_result, more=more,
            overwrite=overwrite, beside=() if folder else places,
        )  # fmt: skip
    tell(f"reading {len(files)} file(s)")
    runs = read_inputs(recipe, files)
    if places and not overwrite:
        require_free(recipe, places, source_hashes(runs.history))
    if folder is None and not places:
        alone = separated_result(recipe, runs, separate_inputs(recipe, runs, tell))
        document = {**alone.document, **(more or {})}
        document |= report_of(recipe, files, document, runs.metadata)
        return Result(document, alone.produced)
    if folder is None:
        estimate = separate_inputs(recipe, runs, tell)
        basis = table_basis(recipe, runs, estimate)
        tables = write_tables(recipe, basis, places, None, tell, overwrite=overwrite)
        document, _ = _document(recipe, runs, estimate, basis, tables)
        return Result(document, estimate, tuple(f for t in tables for f in t.files))
    with staged(folder, tables=table_names(recipe)) as stage:
        estimate = separate_inputs(recipe, runs, tell)
        basis = table_basis(recipe, runs, estimate)
        tables = write_tables(recipe, basis, places, stage, tell, overwrite=overwrite)
        document, names = _document(recipe, runs, estimate, basis, tables)
        document |= more or {}
        document |= report_of(recipe, files, document, runs.metadata)
        result = Result(document, estimate)
        names += write_arrays(recipe, estimate, document, stage, tell)
        names += write_reports(recipe, document, stage, tell)
        if with_result:
            result.write(stage / RESULT_NAME)
            names.append(RESULT_NAME)
    return Result(document, estimate, tuple(folder / n for n in names))


def separated_result(recipe: Recipe, runs: RunSet, estimate: ErrorEstimate) -> Result:
    """Return the result of runs that were separated already; nothing is written."""
    basis = table_basis(recipe, runs, estimate)
    document, _ = _document(recipe, runs, estimate, basis, dry_runs(recipe, basis))
    return Result(document, estimate)


def table_basis(recipe: Recipe, runs: RunSet, estimate: ErrorEstimate) -> dict[str, Any]:
    """Return what tables are made of and judged by, as the document stores it."""
    runs = used_runs(estimate.history, runs)
    found = clean({"estimate": estimate.to_dict(), "runs": run_records(runs)})
    return {
        **found,
        **clean(_folds(runs, measured_runs(found), estimate)),
        "polynomial": clean(_polynomial(recipe, measured_runs(found), estimate)),
    }


def _folds(runs: RunSet, stored: RunSet, estimate: ErrorEstimate) -> dict[str, Any]:
    """Return the estimates without each run, or why there are none; nothing where the stored runs make them."""
    if [r.sha256 for r in runs] == [r.sha256 for r in stored]:
        return {"folds": []}
    try:
        made = fold_estimates(runs, estimate.history, (estimate.start, estimate.stop))
    except MetrosepError as exc:
        return {"folds": [], "no_folds": str(exc)}  # which a table says when it is judged
    return {"folds": [{"left_out": list(o), "estimate": _bare(e).to_dict()} for o, e in made]}


def _bare(estimate: ErrorEstimate) -> ErrorEstimate:
    """Return an estimate that evaluates to the same, without what a judged table does not need."""
    parts = {d: replace(p, modes=None) for d, p in estimate.directions_data.items()}
    return replace(
        estimate, directions_data=parts, spectrum_data={}, feed_spectra_data={}, residual_psd_data={}, evidence_data={},
        audit={}, terms={}, messages=(), history=(),
    )  # fmt: skip


def _document(
    recipe: Recipe,
    runs: RunSet,
    estimate: ErrorEstimate,
    basis: dict[str, Any],
    tables: list[WrittenTable],
) -> tuple[dict[str, Any], list[str]]:
    """Return the content of result.json, and the names of the files of the tables."""
    described = [t.description for t in tables]
    plan = _plan(recipe, estimate)
    content = {
        "schema": SCHEMA,
        "metrosep": __version__,
        "title": recipe.title or "Separation of repeated runs",
        "inputs": input_records(runs.history),
        "plots": plot_data(runs, estimate),
        "table": described[0] if described else None,
        "more_tables": described[1:],
        "messages": [
            *runs.metadata.get("warnings", ()),
            *estimate.messages,
            *_about_tables(described),
            *_about_polynomial(basis["polynomial"], estimate),
            *(plan or {}).get("messages", ()),
        ],
        "provenance": history_as_dicts(estimate.history),
        "recipe": recipe.recorded,
        "versions": versions(),
        "decision_rule": DECISION_RULE,
        **characteristics(recipe, estimate, [t.verification for t in tables]),
    }
    content["characteristics"] += runs.metadata.get("laser", [])
    if plan is not None:
        content["plan"] = plan
    return {**clean(content), **basis}, [f.name for t in tables for f in t.files]


def _about_tables(described: list[dict[str, Any]]) -> list[str]:
    if len(described) < 2:
        return []
    names = ", ".join(str(d.get("path", "not written")) for d in described)
    text = (
        f"{len(described)} tables were made ({names}); the first is described here, each has its "
        "sidecar, and limits are judged on the worst of them"
    )
    return [text]


def _silent(message: str) -> None:
    """Tell nobody."""


def input_files(recipe: Recipe, inputs: PathLike | Iterable[PathLike] | None) -> list[Path]:
    """Return the files that a recipe reads."""
    if recipe.reads_nothing:
        if inputs is not None:
            raise RecipeError(
                f"{recipe.name}: this recipe reads no inputs; its keys name the files that it needs"
            )
        return []
    if inputs is None:
        places = [recipe.folder]
        if "files" not in recipe.input:
            raise RecipeError(
                f'{recipe.name}: name the inputs, or add files = ["run*.csv"] to [input]'
            )
    elif isinstance(inputs, str | os.PathLike):
        places = [Path(inputs)]
    else:
        places = [Path(p) for p in inputs]
    found: list[Path] = []
    for place in places:
        if not place.is_dir():
            found.append(place)
            continue
        result = place / RESULT_NAME
        if recipe.is_method and "files" not in recipe.input and result.is_file():
            found.append(result)  # the folder of a result stands for it, as elsewhere
            continue
        patterns = recipe.input.get("files", ["*.csv"])
        found += _in_order(place, patterns) if recipe.is_method else _sorted(place, patterns)
    return found


def _sorted(place: Path, patterns: Iterable[str]) -> list[Path]:
    inside = sorted({f for p in patterns for f in _matching(place, p)})
    if not inside:
        raise ReadError(f"{place}: no file matches {', '.join(patterns)}")
    return inside


def _matching(place: Path, pattern: str) -> list[Path]:
    """Return the files of a pattern in a folder; a whole path names its file."""
    try:
        found = [Path(pattern)] if Path(pattern).is_absolute() else place.glob(pattern)
        return [f for f in found if f.is_file()]
    except (OSError, ValueError, NotImplementedError, IndexError) as exc:
        why = getattr(exc, "strerror", None) or exc
        raise ReadError(f"{place}: {pattern[:80]!r} is not a name of files ({why})") from None


def _in_order(place: Path, patterns: Iterable[str]) -> list[Path]:
    """Return the files as they are listed: a separation tells its readings by their order.

    Those of one pattern are sorted by name, numbers in it by their value. A name without a file is
    refused: without it the others would move up.
    """
    found: list[Path] = []
    for pattern in patterns:
        inside = _matching(place, pattern)
        if not inside:
            raise ReadError(f"{place}: no file matches {pattern}")
        found += sorted((f for f in inside if f not in found), key=lambda f: by_number(f.name))
    return found


def read_inputs(recipe: Recipe, files: list[Path]) -> RunSet:
    """Return the runs that a recipe separates."""
    from metrosep.io.runs import read_runs

    runs = read_runs(files, **reading_options(recipe.input))
    step = next((s for s in recipe.steps if s["op"] == "laser_setup"), None)
    return runs if step is None else _corrected(runs, step)


def _corrected(runs: RunSet, step: Mapping[str, Any]) -> RunSet:
    """Return the readings of a laser with the corrections of the step ``laser_setup`` added."""
    from metrosep.recipe.describe.describe_tests import laser_quantities
    from metrosep.separation.positions.laser_setup import LaserSetup

    options = {k: v for k, v in step.items() if k != "op"}
    stated = {k: v for k, v in options.items() if k != "values"}
    found, far = LaserSetup(**stated).corrected(runs, values=options.get("values", "deviation"))
    values = laser_quantities(far.air, far)
    beside = (
        f"the readings of the laser were corrected: {values['correction.total']}; this u is common to all runs and not in "
        "the band"
    )
    told = (*runs.metadata.get("warnings", ()), *far.messages, beside)
    entries = [
        {"name": q.definition, **q.to_dict(), "metric": k, **_UNJUDGED} for k, q in values.items()
    ]
    metadata = {**runs.metadata, "warnings": told, "laser": entries}
    history = (*runs.history, Step("laser_setup", options))
    return RunSet(found, metadata=metadata, history=history)


_UNJUDGED: Mapping[str, Any] = dict.fromkeys(("lower", "upper", "U", "guard_factor", "verdict"))


def separate_inputs(recipe: Recipe, runs: RunSet, tell: Progress = _silent) -> ErrorEstimate:
    """Return what the step ``separate`` of a recipe makes of runs."""
    from metrosep.separation.runs.entry import separate

    _require_references(recipe, runs)
    tell(f"separating {len(runs)} runs")
    step = next(s for s in recipe.steps if s["op"] == "separate")
    options = {k: v for k, v in step.items() if k != "op"}
    found: ErrorEstimate = separate(runs, **options)
    return found


def _require_references(recipe: Recipe, runs: RunSet) -> None:
    """Refuse a place of zero correction that no run reaches, before anything is separated."""
    from metrosep.compensation.area_errors import format_position
    from metrosep.core.errors import TableError

    low, high = runs.full_travel
    for output in (o for o in recipe.outputs if o["kind"] == "table"):
        wanted, axis = output.get("reference"), str(output.get("axis", "X"))
        if isinstance(wanted, float) and not low <= wanted <= high:
            raise TableError(
                f"the reference {format_position(axis, wanted)} lies outside the travel of the runs, "
                f"{format_position(axis, low)} ... {format_position(axis, high)}"
            )


def _polynomial(recipe: Recipe, runs: RunSet, estimate: ErrorEstimate) -> dict[str, Any] | None:
    for step in recipe.steps:
        if step["op"] == "polynomial":
            options = {k: v for k, v in step.items() if k != "op"}
            if options.get("on_axis") is None:
                options["on_axis"] = _on_axis(recipe)
            fit = polynomial_of(estimate, runs, **options)
            return {**fit.to_dict(), "effect": fit.effect(estimate)}
    return None


def _on_axis(recipe: Recipe) -> bool:
    """Return whether the tables of a recipe correct the axis along itself."""
    tables = [o for o in recipe.outputs if o["kind"] == "table" and "axis" in o]
    return bool(tables) and all(o.get("compensates", o["axis"]) == o["axis"] for o in tables)


def _about_polynomial(polynomial: Mapping[str, Any] | None, estimate: ErrorEstimate) -> list[str]:
    if not polynomial:
        return []
    out = []
    if polynomial["removed"] == "line":
        out.append(
            f"the polynomial is that of the separated error, without its line (slope {estimate.slope}, the "
            "alignment); for an axis measured along itself set on_axis = true in the step polynomial"
        )
    effect = polynomial.get("effect") or {}
    if not effect or effect["helps"]:
        return out
    low, high = (format_length(effect[f"{k}_pv_m"], digits=3) for k in ("after", "before"))
    return [
        *out,
        (
            f"the polynomial of degree {polynomial['degree']} does not help: of the separated error "
            f"{100 * effect['rest']:.3g} % of the RMS stay, P-V {high} -> {low}; write a table, or take a "
            "higher degree"
        ),
    ]


def _plan(recipe: Recipe, estimate: ErrorEstimate) -> dict[str, Any] | None:
    from metrosep.recipe.methods.plan import plan_after, plan_document

    for step in recipe.steps:
        if step["op"] == "plan_feedrates":
            return plan_document(plan_after(estimate, step))
    return None
