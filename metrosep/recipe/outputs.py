"""The outputs of a recipe: tables after their dry-run, and reports."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.compensation import CompensationTable, PolynomialFit, Verification
from metrosep.compensation.area_errors import is_rotary
from metrosep.compensation.measured import Folds
from metrosep.compensation.sampling import USUAL_ENTRIES, rounded_spacing, spaced_with_zero
from metrosep.controllers.options import checked_options
from metrosep.controllers.registry import find
from metrosep.core.errors import CorruptFileError, DataError, MetrosepError, TableError, WriteError
from metrosep.core.methods import METHODS
from metrosep.core.provenance import hash_bytes
from metrosep.core.runset import RunSet
from metrosep.core.units import format_length, parse_quantity
from metrosep.recipe.methods.turned import lengths_only
from metrosep.recipe.pipeline import MEASURING, checked_step
from metrosep.recipe.preflight import (
    RESULT_NAME,
    machine_limits,
    output_name,
    report_formats,
    report_name,
)
from metrosep.recipe.result import is_positioning, measured_runs, stored_estimate
from metrosep.recipe.schema import COMMAND, Place
from metrosep.separation.positions.expansion import Expansion
from metrosep.separation.positions.pitch import PitchErrors, pitch_errors_of
from metrosep.separation.runs.base import ErrorEstimate

if TYPE_CHECKING:
    from metrosep.controllers.base import Prepared
    from metrosep.recipe.recipe import Recipe

Progress = Callable[[str], None]

_BOTH = "bidirectional"
"""The option of controls that hold a list for each direction if they are told to."""

_MOST_ENTRIES = 100_000
"""Far beyond what any controller takes, and still made in no time."""


@dataclass(frozen=True, slots=True)
class WrittenTable:
    """A table of a recipe."""

    description: dict[str, Any]  # for the result document
    verification: Verification  # its dry-run
    files: tuple[Path, ...] = ()  # that hold it


def make_table(estimate: ErrorEstimate, output: Mapping[str, Any]) -> CompensationTable:
    """Return the table that an output describes."""
    turning = [a for a in (output["axis"], output.get("compensates") or "") if is_rotary(a)]
    if turning:
        raise lengths_only(turning[0])
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
        ).hinting(spacing=rounded_spacing((estimate.stop - estimate.start) / USUAL_ENTRIES))
    return CompensationTable.from_error(
        estimate,
        positions=_entries(estimate, output),
        axis=output["axis"],
        compensates=output.get("compensates"),
        direction=output.get("direction", "auto"),
        reference=output.get("reference"),
        reference_direction=output.get("reference_direction", "forward"),
        heat=Expansion.of_options(output),
    )


def pitch_table(runs: RunSet, output: Mapping[str, Any]) -> CompensationTable:
    """Return the table that an output describes of a list of targets: the axis along itself."""
    axis = output["axis"]
    target = output.get("compensates", axis)
    info = find(output["controller"]).info
    if info.carries != "table":
        raise TableError(
            f"{info.id} holds a {info.carries}; a list of targets gives a table over one axis"
        )
    errors = pitch_errors_of(
        runs,
        reference=output.get("reference") or 0.0,
        reference_direction=output.get("reference_direction", "forward"),
        unit="rad" if is_rotary(axis) else "m",
        heat=Expansion.of_options(output),
    )
    lengths = runs.metadata.get("z_unit", runs.metadata.get("unit", "m")) == "m"
    if is_rotary(target) == lengths:
        is_what, asks = (
            ("lengths", "an axis that moves along") if lengths else ("angles", "one that turns")
        )
        raise DataError(
            f"the readings are {is_what}, and {target} is not: the corrected axis (compensates) must be {asks}"
        )
    direction = output.get("direction", "auto")
    return CompensationTable.from_error(
        errors,
        positions=_entries(errors, output),
        axis=axis,
        compensates=target,
        direction="both" if direction == "auto" and not _holds_both(output) else direction,
    )


def _entries(error: ErrorEstimate | PitchErrors, output: Mapping[str, Any]) -> Any:
    """Return the entries, or their spacing: a format that takes any gets the reference as one more of them."""
    spacing, zero = output.get("spacing"), output.get("reference")
    if not isinstance(spacing, str) or zero is None:
        return spacing
    if find(output["controller"]).info.spacing != "free":
        return spacing
    return spaced_with_zero(error, spacing, output["axis"], zero)


def _holds_both(output: Mapping[str, Any]) -> bool:
    """Return whether the file of an output holds a column for each direction."""
    dialect = find(output["controller"])
    asked = {k: v for k, v in output.get("machine", {}).items() if k == _BOTH}
    if any(o.name == _BOTH for o in dialect.options):
        return bool(checked_options(asked, dialect.options, "", partial=True).get(_BOTH))
    return dialect.info.directions != "one"


def make_carried(
    estimate: ErrorEstimate,
    output: Mapping[str, Any],
    runs: RunSet | None,
    *,
    degree: Any = "aicc",
) -> Any:
    """Return what the controller of an output holds: a table, or a polynomial."""
    carries = find(output["controller"]).info.carries
    if carries == "polynomial":
        return polynomial_of(
            estimate,
            runs,
            degree=output.get("degree", degree),
            quantity="compensation",
            on_axis=output.get("compensates", output["axis"]) == output["axis"],
        )
    return make_table(estimate, output)


def polynomial_of(estimate: ErrorEstimate, runs: RunSet | None, **options: Any) -> PolynomialFit:
    """Return the polynomial of an estimate with its covariance; of "kono" and "mean" that of the runs."""
    from metrosep.compensation.polynomial import fit_polynomial

    data = runs if runs is not None and estimate.method in ("kono", "mean") else estimate
    return fit_polynomial(data, domain=(estimate.start, estimate.stop), **options)


def carried_of(
    document: Mapping[str, Any], output: Mapping[str, Any]
) -> tuple[Any, RunSet | ErrorEstimate, Folds | None]:
    """Return what an output holds, the runs for its dry-run, and what it is without each of them.

    A reversal has no runs that read the slide alone: its dry-run is against what it found.
    """
    if is_positioning(document):
        cycles = measured_runs(document)
        return pitch_table(cycles, output), cycles, None
    estimate = stored_estimate(document)
    if document.get("estimate") is None:
        return make_carried(estimate, output, None), estimate, None
    runs = measured_runs(document)
    degree = (document.get("polynomial") or {}).get("degree", "aicc")
    made = make_carried(estimate, output, runs, degree=degree)
    return made, runs, _folds_in(document, made)


def _folds_in(document: Mapping[str, Any], made: Any) -> Folds | None:
    """Return what `made` is without some of the runs, as far as a result stores it; else None."""
    if not document.get("folds") or all(s.name != "separate" for s in made.history):
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
    """Return the tables of a recipe after every check of their files; nothing is written."""
    found = []
    for prepared, written in _prepared(recipe, document, [Path(n) for n in table_names(recipe)]):
        description = {k: v for k, v in written.description.items() if k != "path"}
        found.append(WrittenTable(description, prepared.verification))
    return found


def write_tables(
    recipe: Recipe,
    document: Mapping[str, Any],
    targets: Sequence[Path],
    stage: Path | None,
    tell: Progress,
    *,
    overwrite: bool = False,
) -> list[WrittenTable]:
    """Write the tables of a recipe (into `stage`, if given) after dry-runs of the very bytes of all."""
    ready, written = [], []
    for prepared, table in _prepared(recipe, document, targets, tell, overwrite=overwrite):
        prepared.require_free()
        ready.append(prepared)
        written.append(table)
    for prepared in ready:
        prepared.write(stage)
    return written


def _prepared(
    recipe: Recipe,
    document: Mapping[str, Any],
    targets: Sequence[Path],
    tell: Progress | None = None,
    *,
    overwrite: bool = False,
) -> Iterator[tuple[Prepared, WrittenTable]]:
    """Yield each table of a recipe, checked to the bytes of its file: all doors ask here."""
    if not targets:
        return
    from metrosep.controllers.base import own_part, sidecar_path
    from metrosep.controllers.files import prepare
    from metrosep.recipe.step_help import in_table_words

    for (output, place), target in zip(_tables_of(recipe), targets, strict=True):
        if tell is not None:
            tell(f"dry-running and writing {output['path']}")
        controller = output["controller"]
        typed = recipe.name == COMMAND  # options, which the command line makes of the arguments
        with contextlib.nullcontext() if typed else in_table_words(controller):
            made, runs, folds = carried_of(document, output)
            prepared = prepare(
                made,
                target,
                controller,
                verified_against=runs,
                folds=folds,
                waive=tuple(output.get("waive", ())),
                sign_confirmed=output.get("sign_confirmed", False),
                overwrite=overwrite,
                active=active_of(output, recipe),
                **machine_of(output, recipe, place),
            )
        path = prepared.target
        if prepared.verification is None:
            raise TableError(f"{path}: the table was written without a dry-run")
        sidecar = own_part(json.loads(prepared.sidecar), getattr(made, "compensates", None))
        description = {**sidecar.pop("table"), **sidecar, "path": path.name}
        files = (path, sidecar_path(path))
        yield prepared, WrittenTable(description, prepared.verification, files)


def active_of(output: Mapping[str, Any], recipe: Recipe) -> str | None:
    """Return the file that was active, which a recipe names from its own folder."""
    return _in_folder(output.get("active"), recipe)


def machine_of(output: Mapping[str, Any], recipe: Recipe, place: Place) -> dict[str, Any]:
    """Return ``machine`` of an output, the file of other columns named from the folder of the recipe."""
    machine = machine_limits(output, place)
    beside = {"beside": _in_folder(machine["beside"], recipe)} if "beside" in machine else {}
    return {**machine, **beside}


def _in_folder(name: str | None, recipe: Recipe) -> str | None:
    """Return the path of a file that lies in the folder of a recipe, others as they are."""
    there = recipe.folder / (name or "")
    return str(there) if name and there.is_file() else name


def table_names(recipe: Recipe) -> list[str]:
    """Return the names of the tables of a recipe."""
    return [output_name(output["path"], place) for output, place in _tables_of(recipe)]


def require_free(
    recipe: Recipe, targets: Sequence[Path], sources: Collection[str] | None = None
) -> None:
    """Refuse, before anything is computed, tables in the way that cannot be those of a recipe."""
    from metrosep.controllers.files import refuse_other

    for (output, _), target in zip(_tables_of(recipe), targets, strict=True):
        refuse_other(target, output["controller"], sources)


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
            file = output_name(
                output.get("path", report_name(name)), recipe.place("[[output]]", i)
            )
            writers[name].load()(dict(document), folder / file)
            written.append(file)
    return written


def _tables_of(recipe: Recipe) -> Iterator[tuple[Mapping[str, Any], Place]]:
    for i, output in enumerate(recipe.outputs):
        if output["kind"] == "table":
            yield output, recipe.place("[[output]]", i)


# ---- outputs of a run that appear together or not at all ---------------------------------------


@contextmanager
def staged(folder: Path, *, tables: Collection[str] = ()) -> Iterator[Path]:
    """Give a hidden folder inside `folder`; at the end its files move into `folder`.

    Notes
    -----
    An older result.json goes first, then the files are renamed one by one, the new result.json
    last: where it is, all that it names is there and of the same run.
    """
    made = not folder.exists()
    stage = _hidden_folder(folder)
    try:
        try:
            yield stage
        except MetrosepError as exc:
            exc.args = (str(exc).replace(f"{stage}", f"{folder}"), *exc.args[1:])
            raise
        _move(stage, folder, tables)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        if made:
            with contextlib.suppress(OSError):  # not empty: the run succeeded
                folder.rmdir()


@contextmanager
def temporary_folder(what: str) -> Iterator[Path]:
    """Give a folder for a file that is tried and never kept."""
    try:
        made = tempfile.TemporaryDirectory(prefix=f"metrosep-{what}-", ignore_cleanup_errors=True)
    except OSError as exc:
        raise WriteError(
            f"the {what} cannot be tried in a temporary folder ({exc.strerror or exc}); make room, or "
            "set TMPDIR to another folder",
            exc,
        ) from None
    with made as folder:
        yield Path(folder)


def _hidden_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise WriteError(
            f"{folder}: the output folder cannot be made ({exc.strerror or exc}); choose another with -o",
            exc,
        ) from None
    stage = folder / f".metrosep-{secrets.token_hex(6)}"
    try:
        stage.mkdir()
    except OSError as exc:
        raise WriteError(
            f"{folder}: the output folder cannot be written ({exc.strerror or exc}); choose another "
            "with -o",
            exc,
        ) from None
    return stage


def keep_replaced(
    stage: Path, folder: Path, tables: Collection[str], *, overwrite: bool = True
) -> None:
    """Keep the tables of a folder that other ones of a stage will replace, or refuse that."""
    from metrosep.controllers.base import is_copy, keep_old, refuse_existing

    for name in tables:
        if (stage / name).is_file() and not is_copy(stage / name, folder / name):
            if not overwrite:
                refuse_existing(folder / name)
            keep_old(folder / name)


def _move(stage: Path, folder: Path, tables: Collection[str]) -> None:
    keep_replaced(stage, folder, tables)
    files = sorted(stage.iterdir(), key=lambda f: (f.name == RESULT_NAME, f.name))
    for file in files:
        try:
            if file is files[0]:
                (folder / RESULT_NAME).unlink(missing_ok=True)
            os.replace(file, folder / file.name)  # noqa: PTH105  # replaces on every system
        except OSError as exc:
            raise WriteError(
                f"{folder / file.name}: cannot be replaced ({exc.strerror or exc}); close the program "
                "that holds it, or choose another folder with -o",
                exc,
            ) from None


# ---- the hash of what a recipe means, whatever it looks like -----------------------------------


def recipe_hash(recipe: Recipe) -> str:
    """Return the SHA-256 of a recipe's canonical form.

    Notes
    -----
    Canonical form: JSON with sorted keys of ``[input]``, the steps, checks and outputs, in SI, with
    the defaults of steps that measure and of the guard factor filled in. Title, comments, order of
    keys, spelling of units (1 mm, 1000 um; numbers count to 14 digits), ``[view]`` and ``[batch]`` do not count: none of them
    changes a number of a result. Files that a step names count by their content. Steps that are
    switched off do not count.

    Examples
    --------
    >>> from metrosep.recipe import Recipe
    >>> text = '''metrosep = 1
    ... title = "one"
    ... [input]
    ... [[step]]
    ... op = "filter"
    ... cutoff = "1 mm"
    ... '''
    >>> other = text.replace("one", "two").replace("1 mm", "1000 um")
    >>> recipe_hash(Recipe.parse(text)) == recipe_hash(Recipe.parse(other))
    True
    """
    content = {
        "metrosep": 1,
        "input": recipe.input,
        "steps": [_filled(s) for s in recipe.steps if s.get("enabled", True)],
        "checks": [{"guard_factor": 1.0, **c} for c in recipe.checks],
        "outputs": list(recipe.outputs),
        "files": _files(recipe),
    }
    text = json.dumps(
        _plain(content), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _filled(step: Mapping[str, Any]) -> dict[str, Any]:
    op = MEASURING.get(step["op"])
    if op is None:
        return dict(step)
    defaults = {k: key.default for k, key in op.keys.items() if key.default is not None}
    given = {k: v for k, v in step.items() if k != "enabled"}
    return {**{k: v for k, v in defaults.items() if _goes(step, k, v)}, **given}


def _goes(step: Mapping[str, Any], key: str, value: Any) -> bool:
    """Whether a default may be written out in this step: it goes with the other keys."""
    from metrosep.recipe.pipeline_checks import StepError

    if key in step:
        return False
    try:
        checked_step({**step, key: value})
    except StepError:
        return False
    return True


def _files(recipe: Recipe) -> list[str]:
    """Return the hash of each file that a step names, in order."""
    found = []
    for step in recipe.steps:
        method = METHODS.get(step["op"])
        for key, field in sorted(method.fields.items()) if method is not None else ():
            if field.kind == "file" and key in step:
                target = recipe.folder / step[key]
                found.append(hash_bytes(target.read_bytes()) if target.is_file() else "")
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return float(f"{value:.14g}") if isinstance(value, float) else value
