"""Carrying out a recipe whose step is one of the named separations (`metrosep.core.methods`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metrosep._version import __version__
from metrosep.core.errors import (
    DataError,
    FormatMismatchError,
    InvalidSamplesError,
    MetrosepError,
    ReadNameError,
    WriteError,
)
from metrosep.core.limits import limit_problem
from metrosep.core.methods import Method, NamedFiles, Readings, Results, RoleColumns
from metrosep.core.profile import Profile
from metrosep.core.provenance import Step, history_as_dicts
from metrosep.core.runset import FORWARD, REVERSE, RunSet
from metrosep.core.surface import Surface
from metrosep.core.units import format_length
from metrosep.io._roles import tells_direction
from metrosep.io.readings import read_readings
from metrosep.io.role_columns import Role, read_roles
from metrosep.io.runs import columns_of
from metrosep.io.source import open_file
from metrosep.recipe.characteristics import DECISION_RULE, judged
from metrosep.recipe.describe.described import describe
from metrosep.recipe.describe.description import Description
from metrosep.recipe.methods.turned import TurnedError
from metrosep.recipe.outputs import (
    WrittenTable,
    dry_runs,
    staged,
    table_names,
    write_reports,
    write_tables,
)
from metrosep.recipe.parts import input_records, named_files, write_parts
from metrosep.recipe.preflight import RESULT_NAME, output_name
from metrosep.recipe.report_fields import report_of
from metrosep.recipe.result import (
    SCHEMA,
    Result,
    clean,
    load_document,
    run_records,
    stored_estimate,
)
from metrosep.recipe.schema import file_of_curve, reading_options
from metrosep.recipe.steps import PROGRAM_FILE, PROGRAM_PROOF
from metrosep.separation.contract import Separation
from metrosep.separation.inputs import require_count

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


def run_method(
    recipe: Recipe,
    files: list[Path],
    *,
    out: Path | None,
    tell: Callable[[str], None],
    with_result: bool = True,
    more: Mapping[str, Any] | None = None,
    overwrite: bool = False,
    beside: Sequence[Path] = (),
) -> Result:
    """Read, separate, judge and write."""
    step, method = recipe.steps[0], recipe.method
    if method is None:
        raise DataError(f"{recipe.name}: is not a recipe of a named method")
    if method.reads != "nothing":
        tell(f"reading {len(files)} file(s)")
    inputs = load_inputs(method, files, {k: v for k, v in recipe.input.items() if k != "files"})
    _require_kind(recipe, inputs)
    alone = method.reads in ("nothing", "files")
    doing = {"separate": "separating", "geometry": "evaluating"}[method.verb]
    tell(f"{'computing' if alone else doing}: {method.what}")
    options = _options(method, step, recipe.folder)
    named = named_files(options, method.fields)
    tables = [o for o in recipe.outputs if o["kind"] == "table"]
    turned = {"tables": tables} if method.reads == "runs" else {}
    produced = method.from_inputs(inputs, {**options, **turned})
    history, warnings = sources(inputs)
    history = (*history, *getattr(produced, "beside", ()))
    described = describe(produced, inputs)
    records = input_records(history, inputs if isinstance(inputs, tuple) else (inputs,))
    known = {(i["name"], i["sha256"]) for i in records}
    records += [n for n in named if (n["name"], n["sha256"]) not in known]
    document = _document(recipe, method, produced, described, history, warnings, records)
    cycles = getattr(produced, "cycles", None)
    if cycles is not None:
        document["runs"] = run_records(cycles)
    document |= more or {}
    document |= report_of(recipe, files, document)
    if out is None and beside:
        made = write_tables(recipe, document, beside, None, tell, overwrite=overwrite)
        files_of = tuple(f for t in made for f in t.files)
        return Result({**document, **_described(made)}, produced, files_of)
    if out is None:
        document |= _described(dry_runs(recipe, document))
        document["messages"] = [*document["messages"], *try_programs(recipe, produced, tell)]
        return Result(document, produced)
    with staged(out, tables=[*table_names(recipe), *program_names(recipe)]) as stage:
        made = write_tables(
            recipe,
            document,
            [out / n for n in table_names(recipe)],
            stage,
            tell,
            overwrite=overwrite,
        )
        document |= _described(made)
        names = [f.name for t in made for f in t.files]
        programs, said = write_programs(recipe, produced, stage, tell)
        if not overwrite:
            refuse_replaced(recipe, stage, out)
        names += programs
        document["messages"] = [*document["messages"], *said]
        names += write_parts(recipe, described, stage, tell, document)
        names += write_reports(recipe, document, stage, tell)
        if with_result:
            Result(document, produced).write(stage / RESULT_NAME)
            names.append(RESULT_NAME)
    return Result(document, produced, tuple(out / n for n in names))


def _described(tables: Sequence[WrittenTable]) -> dict[str, Any]:
    """Return what a document says of its tables; nothing where there are none."""
    told = [t.description for t in tables]
    return {"table": told[0], "more_tables": told[1:]} if told else {}


_OF_ROLE = {"tolerance": "value", "u_reading": "reading"}
"""Keys that are lengths or angles, as the columns of a role are."""


def _require_kind(recipe: Recipe, inputs: Any) -> None:
    """Refuse a key of a step that is an angle where the readings are lengths, and the like."""
    step, units = recipe.steps[0], getattr(inputs, "units", None) or {}
    for key, field in (recipe.method.fields if recipe.method else {}).items():
        unit = units.get(_OF_ROLE.get(key, "")) if field.kind == "limit" else None
        if key not in step or unit is None:
            continue
        problem = limit_problem(key, step[key], f"the {_OF_ROLE[key]} column", unit)
        if problem is not None:
            raise recipe.place("[[step]]", 0).error(problem, key)


def _options(method: type[Method], step: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the keys of a step; names of files are looked for beside the recipe."""
    options: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in step.items() if k != "op"
    }
    for key, value in options.items():
        if method.fields[key].kind == "file" and (folder / value).exists():
            options[key] = str(folder / value)
        elif method.fields[key].kind == "table" and isinstance(value, Mapping):
            options[key] = {k: _beside(v, folder) for k, v in value.items()}
    return options


def _beside(value: Any, folder: Path) -> Any:
    """Return the text of a curve with its file where it lies."""
    file = file_of_curve(value)
    found = file is not None and (folder / file).exists()
    return f"table {folder / str(file)}" if found else value


def _document(
    recipe: Recipe,
    method: type[Method],
    produced: Any,
    described: Description,
    history: Iterable[Step],
    warnings: tuple[str, ...],
    inputs: list[dict[str, Any]],
) -> dict[str, Any]:
    from metrosep.recipe.result import versions

    if isinstance(produced, TurnedError):  # what its tables are made of, as of any list of targets
        steps = produced.cycles.history
    else:
        steps = (*history, Step(method.name, dict(recipe.steps[0])))
    messages = (*getattr(produced, "messages", ()), *described.messages)
    return clean(  # type: ignore[no-any-return]
        {
            "schema": SCHEMA,
            "metrosep": __version__,
            "title": recipe.title or method.what[0].upper() + method.what[1:],
            "inputs": inputs,
            "estimate": None,
            "separation": {
                "op": method.name,
                "what": method.what,
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
            "provenance": history_as_dicts(steps),
            "recipe": recipe.recorded,
            "versions": versions(),
            "decision_rule": DECISION_RULE,
            **judged(
                replace(recipe, checks=(*recipe.checks, *described.checks)),
                described.quantities,
                unlisted=described.unlisted,
            ),
        }
    )


# ---- inputs of the separations that recipes name: curves and columns from tables, maps from files ----

Inputs = (
    Readings
    | RunSet
    | RoleColumns
    | Results
    | NamedFiles
    | tuple[RoleColumns, ...]
    | tuple[Surface | Profile, ...]
)
_POSITIONS = ("target", "direction", "readings")


def load_inputs(method: type[Method], files: Sequence[Path], options: Mapping[str, Any]) -> Inputs:
    """Return what a method reads."""
    if method.reads == "nothing":
        return ()
    if method.reads == "results":
        return _results(method, files)
    if method.reads == "files":
        history = [s for f in files for s in open_file(f).history("text")]
        return NamedFiles(tuple(files), dict(options), tuple(history))
    if method.reads == "runs":
        from metrosep.io.runs import read_runs

        return read_runs(files, angles=True, **reading_options(options))
    if method.reads == "maps":
        return _maps(method, files, options)
    roles, rest = _roles(method, options)
    if method.reads == "curves":
        data = read_readings(files, dimension=method.dimension, extra=roles, **rest)
        require_count(method, len(data.values), data.names)
        return data
    if "direction" in method.roles and not set(_POSITIONS) & set(roles):
        tests = tuple(_listed_test(file, rest) for file in files)
        if method.reads == "tables":
            return tests
        if len(tests) == 1:
            return tests[0]
        raise InvalidSamplesError(
            f"one list of a positioning test is needed, got {len(files)} files; evaluate each alone"
        )
    _require_all(method, roles)
    if method.reads == "tables":
        return tuple(_columns([file], roles, rest) for file in files)
    return _columns(files, roles, rest)


def _columns(
    files: Sequence[Path], roles: Mapping[str, Role], rest: Mapping[str, Any]
) -> RoleColumns:
    """Return the columns of a table; a list without a column of the direction may say it for all rows."""
    way = roles.get("direction")
    try:
        return read_roles(files, roles, **rest)
    except ReadNameError:
        word = "" if way is None else str(way.column).strip().casefold()
        if word not in FORWARD | REVERSE:
            raise
    data = read_roles(files, {k: v for k, v in roles.items() if k != "direction"}, **rest)
    _require_one_way(files, rest, word, data)
    rows = np.asarray(data.values["target"]).size
    return replace(data, values={**data.values, "direction": np.full(rows, word)})


def _require_one_way(
    files: Sequence[Path], rest: Mapping[str, Any], word: str, data: RoleColumns
) -> None:
    """Refuse a direction that is said for all rows of a list which tells, or runs, the other one too."""
    layout = {k: v for k, v in rest.items() if v is not None}
    used = {name for names in data.columns.values() for name in names}
    for file in files:
        _, table, _ = columns_of(open_file(file), layout)
        for column in table.columns:
            if column.name in used or not tells_direction(column):
                continue
            values = [] if column.values is None else np.unique(column.values).tolist()
            if len(values) == 1:
                continue  # a count that is 1 in each row
            ways = {str(w).strip().casefold() for w in column.labels or values}
            if ways & (REVERSE if word in FORWARD else FORWARD):
                raise DataError(
                    f"{file.name}: column {column.name!r} tells the direction of each row, and not {word} "
                    f"alone; name it: direction = {column.name!r}"
                )
    steps = np.sign(np.diff(np.asarray(data.values["target"])))
    turned = [np.any((steps[1:] == way) & (steps[:-1] == way)) for way in (1.0, -1.0)]
    if "cycle" not in data.values and all(turned):
        raise DataError(
            f"{files[0].name}: the targets rise and fall from row to row, so the list may hold both "
            f"directions; name the column of the direction, or that of the cycle if all are {word}"
        )


def _results(method: type[Method], files: Sequence[Path]) -> Results:
    """Return what a method goes on from: the separations or the estimates of result documents."""
    items: list[Any] = []
    history: list[Step] = []
    for file in files:
        document = load_document(file)
        if "Separation" not in method.accepts:
            estimate = stored_estimate(document)
            came_from = Step("read_result", {"result": file.resolve().parent.name})
            items.append(replace(estimate, history=(*estimate.history, came_from)))
        else:
            stored = document.get("separation") or {}
            if not stored.get("parts"):
                raise DataError(
                    f"{file.name}: holds no parts over a revolution; give results of donaldson, "
                    "multiprobe, multistep or another separation of roundness"
                )
            items.append(Separation.from_dict(stored))
        history += open_file(file).history("metrosep-result", {})
    return Results(tuple(items), tuple(history))


def _roles(
    method: type[Method], options: Mapping[str, Any]
) -> tuple[dict[str, Role], dict[str, Any]]:
    """Return the columns by role, and the other options of the reader."""
    roles = {
        name: Role(options[name], kind.strip("*?"))
        for name, kind in method.roles.items()
        if name in options
    }
    return roles, {k: v for k, v in options.items() if k not in roles}


def _require_all(method: type[Method], roles: Mapping[str, Role]) -> None:
    """Refuse a positioning test without one of its columns."""
    if "direction" not in method.roles:
        return
    for name in _POSITIONS:
        if name not in roles:
            raise FormatMismatchError(
                f"the column of {name} is not named; a positioning test has target, direction and "
                'readings: target = "target_mm", direction = "direction", readings = ["run1_mm"]'
            )


def _listed_test(file: Path, layout: Mapping[str, Any]) -> RoleColumns:
    """Return targets and positions of a list of a positioning test (format iso230-2)."""
    from metrosep.io.declared import Match
    from metrosep.io.source import open_file
    from metrosep.io.text.machine_tests import ISO230_2, iso230_2_list, read_targets

    source = open_file(file)
    if iso230_2_list.sniff(source) is Match.NO:
        raise FormatMismatchError(
            f"{file}: is not a list of a positioning test; for a table name its columns: "
            'target = "target_mm", direction = "direction", readings = ["run1_mm", "run2_mm"]'
        )
    target, forward, backward = read_targets(source)
    values = {"target": target, "forward": forward, "backward": backward}
    return RoleColumns(values, file.stem, tuple(source.history(ISO230_2, {})))


def _maps(
    method: type[Method], files: Sequence[Path], options: Mapping[str, Any]
) -> tuple[Surface | Profile, ...]:
    from metrosep.io.read import read_for_recipe as read

    objects: list[Surface | Profile] = []
    for file in files:
        obj = read(file, **options)
        if type(obj).__name__ not in method.accepts or not isinstance(obj, Surface | Profile):
            raise FormatMismatchError(
                f"{file}: holds a {type(obj).__name__.lower()}, this method needs maps of heights"
            )
        objects.append(obj)
    require_count(method, len(objects), [f.name for f in files])
    return tuple(objects)


def sources(inputs: Inputs) -> tuple[tuple[Step, ...], tuple[str, ...]]:
    """Return the steps that led to inputs, and what was unusual about their files."""
    each: tuple[Any, ...] = inputs if isinstance(inputs, tuple) else (inputs,)
    history: list[Step] = []
    warnings: list[str] = []
    for item in each:
        history += item.history
        own = (
            item.metadata.get("warnings", ())
            if isinstance(item, Surface | Profile | RunSet)
            else item.warnings
        )
        warnings += [str(w) for w in own]
    return tuple(history), tuple(dict.fromkeys(warnings))


# ---- programs -----------------------------------------------------------------------------------


def try_programs(recipe: Recipe, produced: Any, tell: Callable[[str], None]) -> list[str]:
    """Return what the virtual parts of the programs say; the files are written nowhere that lasts."""
    if all(output["kind"] != "program" for output in recipe.outputs):
        return []
    from metrosep.recipe.outputs import temporary_folder

    with temporary_folder("program") as folder:
        try:
            return write_programs(recipe, produced, folder, tell)[1]
        except MetrosepError as exc:
            exc.args = (str(exc).replace(f"{folder}{os.sep}", ""), *exc.args[1:])
            raise


def program_names(recipe: Recipe) -> list[str]:
    """Return the names of the program files of a recipe."""
    return [
        output_name(output["path"], recipe.place("[[output]]", i))
        for i, output in enumerate(recipe.outputs)
        if output["kind"] == "program"
    ]


def refuse_replaced(recipe: Recipe, stage: Path, folder: Path) -> None:
    """Refuse programs that would replace another one of their name, unless their output says overwrite."""
    from metrosep.controllers.base import is_copy, sidecar_path

    free = [o.get("overwrite", False) for o in recipe.outputs if o["kind"] == "program"]
    for name, replaces in zip(program_names(recipe), free, strict=True):
        there = folder / name
        taken = next((p for p in (there, sidecar_path(there)) if p.exists()), None)
        if taken is not None and not replaces and not is_copy(stage / name, there):
            raise WriteError(
                f"{taken}: is another program, and a machine may be using it; choose another path or folder, or "
                "write overwrite = true into the output (the old one is kept as NAME.1)"
            )


def write_programs(
    recipe: Recipe, produced: Any, folder: Path, tell: Callable[[str], None]
) -> tuple[list[str], list[str]]:
    """Return the names of the program files that were written, and what their virtual parts say."""
    names: list[str] = []
    said: list[str] = []
    for i, output in enumerate(recipe.outputs):
        if output["kind"] != "program":
            continue
        place = recipe.place("[[output]]", i)
        name = output_name(output["path"], place)
        program = getattr(produced, "program", None)
        nose = getattr(produced, "nose", None)
        if program is None:
            raise place.error(
                "there is no program to write: give the nose of the tool (nose_radius), or a setting or a "
                "log that it makes up for",
                "kind",
            )
        tell(f"writing {name}")
        names += [name, f"{name}.json"]
        try:
            said += _written(output, program, nose, produced, folder / name)
        except MetrosepError as exc:
            if name not in str(exc):  # a recipe may write several
                exc.args = (f"{name}: {exc}", *exc.args[1:])
            raise
    return names, said


def _written(
    output: Mapping[str, Any], program: Any, nose: Any, produced: Any, target: Path
) -> list[str]:
    from metrosep.controllers.gcode.lathe import LatheAxes
    from metrosep.controllers.gcode.turning import write_program

    axes = LatheAxes(
        **{k: v for k, v in output.items() if k not in {**PROGRAM_FILE, **PROGRAM_PROOF}}
    )
    if nose is None and not output.get("cut_points", False):
        raise DataError(
            "the step has no nose (nose_radius): its points are points of the surface, no tip path; a "
            "program of them needs cut_points = true"
        )
    made = write_program(
        program,
        target,
        axes,
        nose=nose,
        form=produced.form,
        setting=produced.setting,
        kind=output.get("format", "gcode"),
        **{k: output[k] for k in PROGRAM_PROOF if k in output},
    )
    if made.check is None:
        return [f"{target.name}: was not cut in a virtual part"]
    check = made.check
    text = (
        f"{target.name}: the part cut from the file is off by {format_length(check.peak_to_valley)} P-V, "
        f"{format_length(check.form_error)} without the cusps of the feed, up to "
        f"{format_length(check.cusp)}; from the program it differs by "
        f"{format_length(check.difference)}, digits may cost {format_length(check.rounding)} "
        f"({check.interpolation} between blocks)"
    )
    return [text, *(f"{target.name}: {m}" for m in check.messages)]
