"""Commands about controllers' tables: table, verify."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from metrosep.cli.options import (
    USUAL_SPACING,
    columns_of,
    file_options,
    force_option,
    json_option,
    key_values,
    lacking_facts,
    missing_options,
    note_facts,
    optional_read_options,
    phase,
    read_aloud,
    say,
    say_next,
    table_options,
    with_expansion,
)
from metrosep.cli.positioning import (
    cycles_document,
    is_list,
    list_options,
    listed_cycles,
    listed_document,
    refuse_columns,
    refuse_list_options,
)

if TYPE_CHECKING:
    from metrosep.core.runset import RunSet
    from metrosep.separation.runs.base import ErrorEstimate


@click.command()
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE")
@click.option("--format", "format_", default="linuxcnc", show_default=True, help="Controller.")
@click.option("-o", "--out", required=True, metavar="FILE", help="Table to write.")
@list_options()
@optional_read_options
@click.option(
    "--method",
    type=click.Choice(["joint", "kono", "mean"]),
    help="Method that separates runs. Default: joint, as for 'separate'.",
)
@table_options
@click.option("--over", metavar="AXIS,AXIS", help='Axes of a map, "X,Y".')
@click.option("--poly", metavar="DEGREE", help="Degree of a polynomial: 2, or auto.")
@click.option("--trial", metavar="LENGTH", help='One bump to try the sign on the machine: "2 um".')
@click.option(
    "--from-machine",
    metavar="MACHINE",
    expose_value=False,
    help="Tables of the errors of a machine, as 'metrosep machine-tables MACHINE ERRORS...'.",
)
@force_option
@file_options
@json_option
def table(
    sources: tuple[str, ...],
    format_: str,
    out: str,
    force: bool,
    reading: dict[str, Any],
    as_json: bool,
    **options: Any,
) -> int:
    """Write a controller's file from SOURCE, after a dry-run of its very bytes.

    SOURCE is a result.json of 'separate' or 'run' (or its folder) for tables over one axis and
    polynomials; a list of a positioning test (laser, ISO 230-2) for the pitch error of an axis; runs,
    which are separated first (--x, --z); or the measured map of an error for controllers that hold
    maps. 'metrosep controllers NAME' lists what a controller needs (--machine NAME=VALUE).

    Exit code 1: it makes the error larger, removes less than 30 % of it, exceeds a limit, or its sign
    is not confirmed. 3: the readings do not show whether it helps. Nothing is written then.
    No reading shows what a reversal found of a slide: its table is written, and reported as predicted,
    if its own uncertainty is small against the corrections; else the exit code is 3.
    """
    from metrosep.controllers.base import sidecar_path
    from metrosep.controllers.registry import find
    from metrosep.recipe.result import load_document

    info = find(format_).info
    if options["poly"] is not None and info.carries != "polynomial":
        raise click.UsageError(
            f"--poly is for controllers that hold a polynomial, and {info.id} holds a {info.carries}: "
            "leave --poly out, or write --format plc-st"
        )
    of_runs = any(options.get(k) for k in ("x", "z")) or (
        info.carries != "map" and _hold_runs(sources, options)
    )
    if len(sources) > 1 and not of_runs:
        raise click.UsageError(
            f"one file gives one table, got {len(sources)}; several files of runs need --x and --z"
        )
    lacking = lacking_facts(info.id, options["machine"])
    if info.carries == "map":
        _require_nothing(lacking)
        refuse_columns(options)
        made, against, folds = _map_of(sources[0], options, reading), None, None
    else:
        if of_runs:
            document = _separated(sources, options, reading, lacking)
        elif is_list(sources[0], options):
            _own_axis(options, lacking)
            document = listed_document(sources[0], options, reading, lacking)
        else:
            refuse_columns(options)
            _refuse_measured(sources[0])
            document = load_document(sources[0])
        made, against, folds = _carried_of(document, info.id, options, lacking)
    if options["trial"] is not None:
        made, against, folds = _trial(made, options["trial"]), None, None
    sidecar = _write(made, out, format_, options, against=against, folds=folds, force=force)
    print_table(out, sidecar, warnings_only=as_json)
    if as_json:
        click.echo(json.dumps(sidecar, sort_keys=True, allow_nan=False))
    for file in (out, str(sidecar_path(Path(out)))):
        say(f"wrote {file}")
    if options["trial"] is None:
        # the readings of the proof are laid out as these were
        asked = [n for k in _LAID_OUT if options.get(k) for n in (f"--{k}", options[k])]
        what = "MAP" if info.carries == "map" else "NEW.csv"
        say_next("verify", out, "--against", what, *asked)
    return 0


def _hold_runs(files: tuple[str, ...], options: dict[str, Any]) -> bool:
    """Whether files are tables of runs whose columns need no names: no results, maps or lists."""
    from metrosep.cli.named import tells_runs
    from metrosep.core.errors import MetrosepError
    from metrosep.core.text_options import TEXT_OPTIONS
    from metrosep.io.runs import names_of_columns

    if any(Path(f).is_dir() or Path(f).suffix == ".json" or is_list(f, options) for f in files):
        return False
    layout = {k: options[k] for k in TEXT_OPTIONS if options.get(k) is not None}
    try:
        return tells_runs(options, files) and not any(  # the rows of a list are cycles and no runs
            re.search(r"(?<![^\W_])targets?(?![^\W_])", name, re.IGNORECASE)
            for f in files
            for name in names_of_columns(f, layout)
        )
    except (MetrosepError, OSError):  # said where it is read
        return False


def _refuse_measured(file: str) -> None:
    """Refuse a table of numbers whose columns nobody named, where a result is expected."""
    columns = "" if Path(file).is_dir() or file.lower().endswith(".json") else columns_of(file)
    if columns:
        raise click.UsageError(
            f"{Path(file).name} has {columns}: name the columns of a list of targets with --target, "
            "--direction and --readings, or of runs with --x, --z and --run; 'metrosep check' of the file "
            "suggests them where it recognises the columns"
        )


_LAID_OUT = (
    "x", "z", "feed", "run", "direction", "time", "target", "readings", "cycle", "deviation",
)  # fmt: skip


def _separated(
    files: tuple[str, ...],
    options: dict[str, Any],
    reading: dict[str, Any],
    lacking: dict[str, str],
) -> dict[str, Any]:
    """Return the result of runs, as 'separate' makes it of the same options."""
    from metrosep.cli.named import require_columns
    from metrosep.cli.shortcut import RUN_INPUT, axis_of_columns, option_error, recipe_text
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe

    given = {k: options.get(k) for k in RUN_INPUT} | {"method": options["method"] or "joint"}
    require_columns({**given, "readings": options.get("readings")}, files, lacking)
    refuse_list_options({**options, "direction": None})
    for name in reading:
        raise click.UsageError(
            f"--{name.replace('_', '-')} is not an option of runs: leave it out"
        )
    turned = _turned_runs(files, options, lacking)
    if turned is not None:
        return cycles_document(turned)
    if options.get("compensates") is None:
        axis = options.get("axis") or axis_of_columns([options["x"]] if options["x"] else [])
        _require_target(axis, options, lacking)
    _require_nothing(lacking)
    text = recipe_text(given, tables=(), report=False)
    try:
        recipe = Recipe.parse(text, name="command line")
    except RecipeError as exc:
        raise click.UsageError(option_error(exc)) from None
    document = dict(recipe.run(list(files), progress=phase).document)
    for message in document["messages"]:
        say(f"note: {message}")
    return document


def _turned_runs(
    files: tuple[str, ...], options: dict[str, Any], lacking: dict[str, str]
) -> RunSet | None:
    """Return continuous runs of an axis that turns as cycles; None where their positions are lengths."""
    from metrosep.cli.shortcut import RUN_INPUT
    from metrosep.core.units import parse_quantity
    from metrosep.io.runs import are_over_an_angle
    from metrosep.recipe.methods.turned import cycles_of

    given = {k: options[k] for k in RUN_INPUT if options.get(k) is not None}
    if not any(are_over_an_angle(file, given) for file in files):
        return None
    runs = read_runs_of(files, options, angles=True)
    if options["method"] not in (None, "mean"):
        raise click.UsageError(
            f"--method {options['method']} separates along a length; over an angle the runs are averaged: "
            "leave --method out"
        )
    if options["spacing"] is None:
        lacking["spacing"] = 'over an angle the entries are such as --spacing "5 deg"'
        if options.get("axis") is None and options.get("compensates") is None:
            lacking["axis"] = "the axis that turned, such as --axis C"
    _require_nothing(lacking)
    spacing = parse_quantity(options["spacing"], dimension="angle", name="--spacing")
    return cycles_of(runs, spacing)


def _carried_of(
    document: dict[str, Any], controller: str, options: dict[str, Any], lacking: dict[str, str]
) -> tuple[Any, RunSet | ErrorEstimate, Any]:
    """Return the table or polynomial of a result, the runs to dry-run it against, and its folds."""
    from metrosep.recipe.outputs import carried_of
    from metrosep.recipe.result import is_positioning

    shape = {**_shape(options, controller), **_axes_of(document, options, lacking)}
    if not is_positioning(document):
        shape.setdefault("spacing", USUAL_SPACING)
    return carried_of(document, shape)


def _axes_of(
    document: dict[str, Any], options: dict[str, Any], lacking: dict[str, str]
) -> dict[str, str]:
    """Return the axes of a result's own tables, where the user states none; refuse others."""
    from metrosep.recipe.result import is_positioning

    if is_positioning(document):
        record = document["runs"][0]
        if "x_rad" in record and "z_m" in record:  # such as the run-out of Z over C
            return _over_turning(options, lacking)
        found = _own_axis(options, lacking)
        _require_nothing(lacking)
        return found
    tables = [t for t in (document.get("table"), *document.get("more_tables", ())) if t]
    known = [(str(t["axis"]), str(t["compensates"])) for t in tables if "axis" in t]
    if not known:
        axis = options.get("axis") or _axis_of_columns(document)
        _require_target(axis, options, lacking)
        return {"axis": axis}
    _require_nothing(lacking)
    fits = [
        pair
        for pair in known
        if options.get("axis") in (None, pair[0]) and options.get("compensates") in (None, pair[1])
    ]
    if not fits:
        words = " or ".join(f"{c} over {a}" for a, c in dict.fromkeys(known))
        raise click.UsageError(
            f"the result is the error of {words}; --axis and --compensates say otherwise: separate "
            "again with the axes that were measured"
        )
    if len(set(fits)) > 1:
        words = " and ".join(f"{c} over {a}" for a, c in dict.fromkeys(fits))
        raise click.UsageError(
            f"the result has tables of {words}: say which one with --axis and --compensates"
        )
    return {"axis": fits[0][0], "compensates": fits[0][1]}


def _axis_of_columns(document: dict[str, Any]) -> str:
    """Return the axis that the columns of positions of a result are called after."""
    from metrosep.cli.shortcut import axis_of_columns

    history = (document.get("separation") or {}).get("history") or ()
    steps = [s.get("parameters") or {} for s in (*document.get("provenance", ()), *history)]
    return axis_of_columns(str(p["x"]) for p in steps if p.get("x") not in (None, "None"))


def _require_nothing(lacking: dict[str, str]) -> None:
    """Refuse a call that lacks options, all of them at once."""
    if lacking:
        raise missing_options([*lacking], None, *lacking.values())


def _require_target(axis: str, options: dict[str, Any], lacking: dict[str, str]) -> None:
    """Refuse a call that does not say which axis the table of an axis corrects, and what else it lacks."""
    if options.get("compensates") is None:
        from metrosep.recipe.preflight import which_axis

        lacking["compensates"] = which_axis(axis, "--compensates ")
    _require_nothing(lacking)


def _own_axis(options: dict[str, Any], lacking: dict[str, str]) -> dict[str, str]:
    """Return the axis of a positioning test, which is looked up and corrected; or that it is lacking."""
    axis = options.get("axis") or options.get("compensates")
    if axis is None:
        lacking["axis"] = (
            "--axis X, or another: the list does not name the axis that was measured, which the table corrects "
            "along itself"
        )
        return {}
    if options.get("compensates") not in (None, axis):
        raise click.UsageError(
            f"a positioning test is the error of {axis} along itself: --compensates {options['compensates']} "
            "would write it onto another axis; leave it out"
        )
    return {"axis": axis, "compensates": axis}


def _over_turning(options: dict[str, Any], lacking: dict[str, str]) -> dict[str, str]:
    """Return the axes of lengths that were read over an angle."""
    for name, hint in (("axis", "C turned"), ("compensates", "Z is corrected")):
        if options.get(name) is None:
            lacking[name] = f"lengths over an angle: --{name} {hint[0]} if {hint}"
    _require_nothing(lacking)
    return {"axis": options["axis"], "compensates": options["compensates"]}


def _shape(options: dict[str, Any], controller: str) -> dict[str, Any]:
    """Return the options of a table as an output of a recipe has them."""
    from metrosep.cli.shortcut import of_table
    from metrosep.core.units import parse_quantity

    shape = {k: options[name] for k, name in of_table().items() if options.get(name) is not None}
    shape.setdefault("axis", "X")
    if options.get("reference") is not None:
        shape["reference"] = parse_quantity(
            options["reference"], dimension=_dimension(options.get("axis")), name="--reference"
        )
    degree = options.get("poly")
    if degree is not None and degree != "auto":
        if not str(degree).isdecimal():
            raise click.UsageError(f"--poly {degree}: a degree is a whole number, or auto")
        shape["degree"] = int(degree)
    return {**shape, "controller": controller, "machine": _facts(options)}


def _dimension(axis: str | None) -> str:
    """Return what positions of an axis are: lengths, or angles where it turns."""
    from metrosep.compensation.area_errors import is_rotary

    return "angle" if is_rotary(axis or "X") else "length"


def _map_of(file: str, options: dict[str, Any], reading: dict[str, Any]) -> Any:
    """Return the map of corrections of a measured error map."""
    from metrosep.compensation.maps import CompensationMap
    from metrosep.core.units import parse_quantity

    if file.endswith(".json") or Path(file).is_dir():
        raise click.UsageError(
            f"this controller holds maps: give the measured map of the error, not {file}"
        )
    error = _read_map(file, reading)
    axes = tuple(a.strip() for a in (options.get("over") or "X,Y").split(","))
    if len(axes) != 2 or not all(axes):
        raise click.UsageError("--over names two axes, such as X,Y")
    where = options.get("reference")
    reference = None
    if where is not None:
        parts = [
            parse_quantity(p, dimension="length", name="--reference") for p in where.split(",")
        ]
        if len(parts) != 2:
            raise click.UsageError('--reference of a map is two lengths, "0 mm, 0 mm"')
        reference = (parts[0], parts[1])
    return CompensationMap.from_error(
        error,
        x=options["spacing"] or USUAL_SPACING,
        y=options["spacing"] or USUAL_SPACING,
        axes=(axes[0], axes[1]),
        compensates=options.get("compensates") or "Z",
        reference=reference,
    )


def _trial(made: Any, amplitude: str) -> Any:
    from metrosep.compensation.maps import CompensationMap
    from metrosep.compensation.table import CompensationTable
    from metrosep.compensation.trial import trial_map, trial_table
    from metrosep.core.units import parse_quantity

    dimension = _dimension(getattr(made, "compensates", None))
    size = parse_quantity(amplitude, dimension=dimension, name="--trial")
    if isinstance(made, CompensationMap):
        trial: Any = trial_map(made, size)
    elif isinstance(made, CompensationTable):
        trial = trial_table(made, size)
    else:
        raise click.UsageError("--trial has no meaning for a polynomial: its sign is stated")
    for text in (trial.instruction, trial.if_right, trial.if_wrong):
        say(f"trial: {text}")
    return trial


def _facts(options: dict[str, Any]) -> dict[str, Any]:
    """Return what --machine says."""
    return key_values(options.get("machine") or (), "--machine")


def write_arguments(options: dict[str, Any]) -> dict[str, Any]:
    """Return the arguments of `metrosep.controllers.write` that the options of a table give."""
    machine = _facts(options)
    if options.get("cross_axis") is not None:
        machine["cross_axis"] = options["cross_axis"]
    return {
        **machine,
        "active": options.get("active"),
        "waive": tuple(options.get("waive") or ()),
        "sign_confirmed": bool(options.get("sign_confirmed")),
    }


def _write(
    made: Any,
    path: str,
    controller: str,
    options: dict[str, Any],
    *,
    against: Any,
    folds: Any,
    force: bool,
) -> dict[str, Any]:
    """Write a table; returns what its sidecar says."""
    phase(f"making {Path(path).name} and applying it to the readings")
    from metrosep.controllers.base import own_part
    from metrosep.controllers.files import prepare

    prepared = prepare(
        made,
        path,
        controller,
        verified_against=against,
        folds=folds,
        overwrite=force,
        **write_arguments(options),
    )
    prepared.write()
    sidecar: dict[str, Any] = json.loads(prepared.sidecar)
    return cast("dict[str, Any]", own_part(sidecar, getattr(made, "compensates", None)))


@click.command()
@click.argument("table_file", metavar="TABLE")
@click.option(
    "--against", "files", multiple=True, required=True, metavar="FILE", help="Runs, or a map."
)
@click.option("--format", "format_", metavar="NAME", help="Controller; from the sidecar if there.")
@click.option(
    "--machine",
    multiple=True,
    metavar="NAME=VALUE",
    help="Setting that neither the file nor its sidecar states.",
)
@click.option("--unit", help="Unit of the heights of a map that declares none.")
@click.option("--lateral-step", help='Lateral step of a map that declares none, "1.1 um".')
@click.option(
    "--unknown",
    type=click.Choice(["offset", "offsets", "line"]),
    help="What the runs cannot show: a constant (square or beam known), one for each direction (the "
    "sensor was set to zero between them), or constant and line (alignment).",
)
@click.option(
    "--active", metavar="FILE|none", help="Table that was active while the runs were taken."
)
@list_options()
@with_expansion
@optional_read_options
@json_option
def verify(
    table_file: str,
    files: tuple[str, ...],
    unknown: Any,
    format_: str | None,
    machine: tuple[str, ...],
    active: str | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Dry-run TABLE against measured runs (or a map), as its controller would apply it.

    Runs that made the table are omitted one by one: each is judged with the table made without it.

    Exit code 0: the machine is better with it. 1: it is not, or less than 30 % of the error goes. 3:
    the readings do not show it. 4: table or runs cannot be read, or the table is not the one that its
    sidecar describes.
    """
    from metrosep import controllers
    from metrosep.cli.errors import exit_code_of
    from metrosep.compensation.area_errors import is_rotary
    from metrosep.controllers.active import active_file
    from metrosep.controllers.base import load_sidecar, own_part
    from metrosep.controllers.files import NONE, dry_run_carried, lookup_of_folds
    from metrosep.controllers.options import checked_options
    from metrosep.core.errors import TableError
    from metrosep.core.units import parse_quantity
    from metrosep.separation.positions.expansion import Expansion
    from metrosep.separation.positions.pitch import require_unit

    path = Path(table_file)
    sidecar = load_sidecar(path)
    name = format_ or _controller_of(path, sidecar)
    note_facts(name)
    known = key_values(machine, "--machine")
    ends = {k: known.pop(k, None) for k in ("travel_low", "travel_high")}
    loaded = controllers.read(path, name, **known)
    lookup = controllers.simulate(path, name, **known)
    turns = is_rotary(getattr(loaded, "axis", "X"))
    kind = "angle" if turns else "length"
    stated = [
        None if text is None else parse_quantity(text, dimension=kind, name=f"--machine {k}")
        for k, text in ends.items()
    ]
    more: dict[str, Any] = {}
    was_active: Any = None
    if controllers.find(name).info.carries == "map":
        if len(files) != 1:
            raise click.UsageError("a map is verified against one map: give --against once")
        given = {k: options[k] for k in ("unit", "lateral_step") if options.get(k)}
        measured: Any = _read_map(files[0], given)
    else:
        beside = own_part(sidecar, getattr(loaded, "compensates", None))
        loaded, known_travel = _as_made(loaded, beside, path)
        measured = _against(files, options, _cells_of(loaded))
        was_active = beside.get("active") if active is None else None
        _refuse_without_active(path, was_active, loaded, measured)
        phase(f"applying {path} to the readings")
        if active not in (None, NONE):
            was = active_file(active, loaded, name, known)
            lookup = was.increment(lookup)
            told = beside.get("active") or {}
            if told.get("sha256") == was.sha256 and "increment" in told:
                # what the readings made is the increment: it is made again without each of them
                dialect = controllers.find(name)
                options_of = checked_options(beside["options"], dialect.options, name)
                more["of"] = lookup_of_folds(dialect, options_of, was, loaded.positions)
                loaded, _ = _as_made(loaded, {**beside, "table": told["increment"]}, path)
        pairs = zip(stated, known_travel, strict=True)
        require_unit(measured, "rad" if turns else "m")
        heat = Expansion.of_options(options)
        more |= {
            "heat": heat,
            "unknown": unknown,
            "travel": tuple(b if a is None else a for a, b in pairs),
        }
    result = dry_run_carried(loaded, lookup, measured, **more)
    found = result.to_dict() | {
        "headline": getattr(loaded, "headline", None),
        "warnings": [f.problem for f in getattr(result, "findings", ())],
    }
    if as_json:
        from metrosep.recipe.result import clean

        click.echo(json.dumps(clean(found), sort_keys=True, allow_nan=False))
    else:
        if hasattr(loaded, "headline"):
            say(f"table {loaded.headline}")
        # the sentence of what is not accepted is that of the error below
        said = found["sentences"] if result.passed else found["sentences"][:-1]
        print_verification({**found, "sentences": said})
        for finding in getattr(result, "findings", ()):
            say(f"warning: {path}: {_typed(finding.problem)}")
    try:
        result.require(str(path))
    except TableError as exc:
        text = re.sub(r"; nothing was written.*", "", str(exc))
        if was_active:
            file = _file_of(path, was_active)
            text += f"; if {Path(file).name} was active, as when the table was made, say --active {shlex.quote(file)}"
        say("error: " + _typed(text, hints=exc.hints))
        return exit_code_of(exc)
    return 0


def _refuse_without_active(
    path: Path, told: Mapping[str, Any] | None, loaded: Any, measured: RunSet
) -> None:
    """Refuse readings that made a table while another was active, where nobody says that it was."""
    from metrosep.compensation.measured import made_of

    kind, others = made_of(loaded.history, measured)
    if told and (kind != "none" or len(others) < len(measured)):
        file = _file_of(path, told)
        raise click.UsageError(
            f"these readings made {path.name} while {Path(file).name} was active, and without that they do "
            f"not show what {path.name} does: say --active {shlex.quote(file)}"
        )


def _file_of(path: Path, told: Mapping[str, Any]) -> str:
    """Return the file that was active, beside the table that took its place, where it is still there."""
    from metrosep.controllers.base import kept_files

    named = path.with_name(told["name"])
    for file in (named, *kept_files(named)):
        if file.is_file() and sha256(file.read_bytes()).hexdigest() == told["sha256"]:
            return str(file)
    return str(told["name"])


def _against(files: tuple[str, ...], options: dict[str, Any], step: float | None = None) -> RunSet:
    """Return the readings to judge a table with: a list of targets, or runs; in cells as it was made."""
    from metrosep.cli.named import tells_runs
    from metrosep.separation.positions.pitch import celled_runs

    if is_list(files[0], options):
        return listed_cycles(files, options, {})
    refuse_list_options({**options, "direction": None})
    told = not (options.get("x") or options.get("z")) and tells_runs(options, files)
    if step is not None and (told or (options.get("x") and options.get("z"))):
        return celled_runs(read_runs_of(files, options, angles=True), step)
    for column in ("x", "z"):
        if not told and options.get(column) is None:
            raise click.UsageError(
                f"--{column} names the column of the runs, such as --{column} {column}_mm (of a list "
                "of targets: --target, --direction, --readings)"
            )
    return read_runs_of(files, options)


def _cells_of(loaded: Any) -> float | None:
    """Return the cells of the runs that a table over an angle is made of and judged with, rad."""
    import numpy as np

    from metrosep.compensation.area_errors import is_rotary
    from metrosep.recipe.methods.turned import cell_of

    if not hasattr(loaded, "positions"):
        return None
    steps = (s.parameters["step_rad"] for s in loaded.history if s.name in ("cells", "indexed"))
    spacing = float(np.median(np.diff(loaded.positions))) if is_rotary(loaded.axis) else None
    return next(steps, spacing and cell_of(spacing))


def _as_made(loaded: Any, sidecar: dict[str, Any], path: Path) -> tuple[Any, tuple[Any, Any]]:
    """Return a table as its sidecar says that it was made, and the travel that was stated."""
    from metrosep.compensation.area_errors import numbers_of
    from metrosep.compensation.table import CompensationTable
    from metrosep.controllers.active import held_as
    from metrosep.controllers.base import sidecar_path
    from metrosep.core.errors import CorruptFileError, DataError
    from metrosep.core.provenance import Step

    told, limits = numbers_of(sidecar.get("table")), sidecar.get("limits") or {}
    travel = (limits.get("travel_low"), limits.get("travel_high"))
    if not isinstance(loaded, CompensationTable) or not isinstance(told, dict):
        return loaded, travel
    try:
        history = tuple(Step(s["step"], s["parameters"], s["version"]) for s in told["history"])
        over = told.get("made_over_m")
        table = dataclasses.replace(
            loaded,
            positions=told["positions_m"],
            forward=told["forward_m"],
            reverse=told["reverse_m"],
            u=told["u_m"],
            axis=told["axis"],
            compensates=told["compensates"],
            reference=told["reference_m"],
            removed=told["not_in_table"],
            **held_as(path, sidecar),
            notes=tuple(told.get("notes", ())),
            made_over=None if over is None else tuple(over),
            source_sha256=tuple(told["source_sha256"]),
            history=history,
        )
    except (KeyError, TypeError, ValueError, DataError) as exc:
        raise CorruptFileError(
            sidecar_path(path),
            f"it is not the sidecar of a table ({type(exc).__name__}: {exc})",
            field="table",
            hint="write the table again, or move the sidecar away and give --format",
        ) from None
    return table, travel


def _controller_of(path: Path, sidecar: dict[str, Any]) -> str:
    """Return the controller of a table by its sidecar, or by a suffix that only one has."""
    stated = sidecar.get("controller")
    by_suffix = {".csv": "csv", ".comp": "linuxcnc"}.get(path.suffix.lower())
    found = stated if isinstance(stated, str) else by_suffix
    if found is None:
        raise click.UsageError(
            f"{path} has no sidecar that tells its controller; give --format, one of those that "
            "'metrosep controllers' lists"
        )
    return found


def _read_map(file: str, reading: dict[str, Any]) -> Any:
    from metrosep.core.errors import DataError
    from metrosep.core.surface import Surface

    found = read_aloud(file, reading)
    if not isinstance(found, Surface):
        raise DataError(f"{file}: a map is needed, it holds a {type(found).__name__}")
    return found


def read_runs_of(files: Sequence[str], options: dict[str, Any], *, angles: bool = False) -> RunSet:
    """Return the runs that files hold."""
    phase(f"reading {files[0]}" if len(files) == 1 else f"reading {len(files)} files")
    from metrosep.core.text_options import TEXT_OPTIONS
    from metrosep.io.runs import read_runs

    keys = ("feed", "run", "direction", "time", "sampling_rate", "scale")
    return read_runs(
        files,
        x=options["x"],
        z=options["z"],
        angles=angles,
        **{k: options.get(k) for k in keys},
        **{k: options[k] for k in TEXT_OPTIONS if options.get(k) is not None},
    )


def print_table(path: str, made: dict[str, Any], *, warnings_only: bool = False) -> None:
    """Print the dry-run of a table and every warning that its sidecar holds, of each column of a file."""
    from metrosep.controllers.base import columns_in
    from metrosep.controllers.safety import sidecar_warnings

    for name, column in columns_in(made).items():
        print_table(f"{path} {name}", column, warnings_only=warnings_only)
    verification = made.get("verification")
    numbers = verification if isinstance(verification, dict) and not warnings_only else {}
    if {"residuals", "before_pv_m"} & numbers.keys():
        headline = (made.get("table") or made).get("headline")
        if headline:
            say(f"table {headline}")
        print_verification(numbers)
    for found in sidecar_warnings(made):
        waived = f" (accepted with --waive {found['check']})" if found["waived"] else ""
        way = f"; {found['fix']}" if found["fix"] else ""
        problem = _typed(found["problem"] + waived, "active")
        say(f"warning: {path}: {problem}{_typed(way, 'active', hints=None)}")


def _typed(message: str, *names: str, hints: Sequence[Mapping[str, Any]] | None = ()) -> str:
    """Return a message with facts of the machine, and some options, as they are typed."""
    from metrosep.cli.errors import as_options

    facts = (click.get_current_context().obj or {}).get("facts", ())
    return as_options(message, names, facts, hints)


def print_verification(verification: dict[str, Any]) -> None:
    """Print a dry-run for the person."""
    for text in verification.get("sentences", ()):
        say(text)
    if "residuals" not in verification:
        _print_line("dry-run", verification)
        return
    turns = "span_rad" in verification
    low, high = verification["span_rad" if turns else "span_m"]
    factor, unit = (180 / math.pi, "deg") if turns else (1e3, "mm")
    for r in verification["residuals"]:
        words = f"dry-run {r['direction']}, {low * factor:.6g} ... {high * factor:.6g} {unit}"
        _print_line(words, r)


def _print_line(what: str, r: dict[str, Any]) -> None:
    turns = "before_pv_rad" in r
    factor, unit = (1e6, "urad") if turns else (1e9, "nm")
    keys = ("before_pv", "after_pv", "before_rms", "after_rms", "wrong_sign_rms")
    v = [r[f"{k}_{'rad' if turns else 'm'}"] * factor for k in keys]
    pv, rms = (".4g", ".4g") if turns else (".0f", ".1f")
    u = r.get(f"u_after_rms_{'rad' if turns else 'm'}")
    if u is not None and r.get("n_runs") == 1:  # an estimate: no reading shows what stays
        say(
            f"{what}: P-V {v[0]:{pv}} {unit}, RMS {v[2]:{rms}} {unit} -> known to u = "
            f"{u * factor:{rms}} {unit} (reversed sign: {v[4]:{rms}} {unit})"
        )
        return
    say(
        f"{what}: P-V {v[0]:{pv}} -> {v[1]:{pv}} {unit}, RMS {v[2]:{rms}} -> {v[3]:{rms}} {unit} "
        f"(reversed sign: {v[4]:{rms}} {unit})"
    )
