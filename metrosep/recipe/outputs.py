"""The outputs of a recipe: tables after their dry-run, and reports."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.compensation import CompensationTable, Verification
from metrosep.compensation.folds import Folds
from metrosep.controllers.safety import waived_names
from metrosep.core.errors import CorruptFileError, DataError, TableError
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length, parse_quantity
from metrosep.recipe.preflight import machine_limits, output_name, report_formats
from metrosep.recipe.result import measured_runs, stored_estimate
from metrosep.recipe.schema import Place
from metrosep.separation.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe

__all__ = [
    "WrittenTable",
    "carried_of",
    "dry_runs",
    "make_carried",
    "make_table",
    "write_reports",
    "write_tables",
]

Progress = Callable[[str], None]

_MOST_ENTRIES = 100_000
"""Far beyond what any controller takes, and still made in no time."""


@dataclass(frozen=True, slots=True)
class WrittenTable:
    """A table of a recipe."""

    description: dict[str, Any]  # for the result document
    verification: Verification  # its dry-run
    names: tuple[str, ...] = ()  # files that hold it


def make_table(estimate: ErrorEstimate, output: Mapping[str, Any]) -> CompensationTable:
    """Return the table that an output describes."""
    spacing = output["spacing"]
    n = (
        spacing
        if isinstance(spacing, int)
        else (estimate.stop - estimate.start) / parse_quantity(spacing, dimension="length")
    )
    if n > _MOST_ENTRIES:
        span = format_length(estimate.stop - estimate.start)
        raise TableError(
            f"spacing {spacing} over {span} needs {n:.3g} entries, at most {_MOST_ENTRIES} are made; "
            "use a coarser spacing"
        )
    return CompensationTable.from_error(
        estimate,
        positions=spacing,
        axis=output["axis"],
        compensates=output.get("compensates"),
        direction=output.get("direction", "auto"),
        reference=output.get("reference"),
    )


def make_carried(
    estimate: ErrorEstimate, output: Mapping[str, Any], runs: RunSet, *, degree: Any = "aicc"
) -> Any:
    """Return what the controller of an output holds: a table, or a polynomial."""
    from metrosep.compensation.polynomial import fit_polynomial
    from metrosep.controllers.registry import find

    carries = find(output["controller"]).info.carries
    if carries == "map":
        raise TableError(
            f"{output['controller']} holds maps over two axes, this is the error of one axis; use "
            "'metrosep table MAP --format ...' with a measured map"
        )
    if carries == "polynomial":
        return fit_polynomial(
            runs,
            degree=output.get("degree", degree),
            quantity="compensation",
            domain=(estimate.start, estimate.stop),
        )
    return make_table(estimate, output)


def carried_of(
    document: Mapping[str, Any], output: Mapping[str, Any]
) -> tuple[Any, RunSet, Folds | None]:
    """Return what an output holds, the runs for its dry-run, and what it is without each of them."""
    estimate, runs = stored_estimate(document), measured_runs(document)
    degree = (document.get("polynomial") or {}).get("degree", "aicc")
    made = make_carried(estimate, output, runs, degree=degree)
    return made, runs, _folds_in(document, made)


def _folds_in(document: Mapping[str, Any], made: Any) -> Folds | None:
    """Return what `made` is without some of the runs, as far as a result stores it; else None."""
    if not document.get("folds") or not isinstance(made, CompensationTable):
        return None
    try:
        stored = [
            (fold["left_out"], ErrorEstimate.from_dict(fold["estimate"]))
            for fold in document["folds"]
        ]
    except (AttributeError, KeyError, TypeError, ValueError, DataError) as exc:
        raise CorruptFileError(
            "result.json",
            f"a part of it is missing or damaged ({exc})",
            field="folds",
            hint="run the separation again",
        ) from None
    return [(out, made.remade(estimate)) for out, estimate in stored]


def dry_runs(recipe: Recipe, document: Mapping[str, Any]) -> list[WrittenTable]:
    """Return the tables of a recipe with their dry-runs; nothing is written."""
    found = []
    for output, place in _tables_of(recipe):
        made, runs, folds = carried_of(document, output)
        limits = machine_limits(output, place)
        verification = _dry_run(
            made,
            runs,
            folds=folds,
            travel=(limits.get("travel_low"), limits.get("travel_high")),
            waived=waived_names(output.get("waive", ())),
        )
        description = {**made.to_dict(), "verification": verification.to_dict()}
        found.append(WrittenTable(description, verification))
    return found


def write_tables(
    recipe: Recipe,
    document: Mapping[str, Any],
    folder: Path,
    stage: Path,
    tell: Progress,
    *,
    overwrite: bool = False,
) -> list[WrittenTable]:
    """Write the tables of a recipe, each after a dry-run of its very bytes."""
    from metrosep.controllers.base import sidecar_path
    from metrosep.controllers.files import prepare

    written = []
    for output, place in _tables_of(recipe):
        tell(f"dry-running and writing {output['path']}")
        made, runs, folds = carried_of(document, output)
        prepared = prepare(
            made,
            folder / output_name(output["path"], place),
            output["controller"],
            verified_against=runs,
            folds=folds,
            waive=tuple(output.get("waive", ())),
            sign_confirmed=output.get("sign_confirmed", False),
            overwrite=overwrite,
            **machine_limits(output, place),
        )
        path = prepared.target
        if prepared.verification is None:
            raise TableError(f"{path}: the table was written without a dry-run")
        prepared.write(stage)
        sidecar = json.loads(prepared.sidecar)
        description = {**sidecar.pop("table"), **sidecar, "path": path.name}
        names = (path.name, sidecar_path(path).name)
        written.append(WrittenTable(description, prepared.verification, names))
    return written


def table_names(recipe: Recipe) -> list[str]:
    """Return the names of the tables of a recipe."""
    return [output_name(output["path"], place) for output, place in _tables_of(recipe)]


def _dry_run(made: Any, runs: RunSet, *, waived: tuple[str, ...], **more: Any) -> Verification:
    """Return the dry-run of a table or polynomial as it is, before a controller rounds it."""
    from metrosep.controllers.base import table_lookup
    from metrosep.controllers.files import dry_run_carried

    result: Verification = dry_run_carried(made, table_lookup(made), runs, **more)
    result.require("the table", waived=waived)
    return result


def write_reports(
    recipe: Recipe, document: Mapping[str, Any], folder: Path, tell: Progress
) -> list[str]:
    """Write the reports of a recipe."""
    writers = report_formats()
    written = []
    for i, output in enumerate(recipe.outputs):
        if output["kind"] != "report":
            continue
        for name in output.get("formats", ["html"]):
            tell(f"writing the report ({name})")
            file = output_name(output.get("path", f"report.{name}"), recipe.place("[[output]]", i))
            writers[name].load()(dict(document), folder / file)
            written.append(file)
    return written


def _tables_of(recipe: Recipe) -> Iterator[tuple[Mapping[str, Any], Place]]:
    for i, output in enumerate(recipe.outputs):
        if output["kind"] == "table":
            yield output, recipe.place("[[output]]", i)
