"""Commands that separate: demo, run, separate."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import (
    force_option,
    json_option,
    name_values,
    named_options,
    optional_read_options,
    override_option,
    report_option,
    require_place,
    say,
    say_next,
    table_options,
)
from metrosep.core.errors import ReadError

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.result import Result

_AT_ONCE = 0.5
"""Seconds in which nobody wants to know what a command is at."""


def progress(context: click.Context) -> Callable[[str], None]:
    """Return what is shown of the steps of a run: nothing where the user wants quiet."""
    told = context.obj if isinstance(context.obj, dict) else {}
    began = time.monotonic()

    def tell(message: str) -> None:
        told["phase"] = message  # for what a long command is at
        if not told.get("quiet") and time.monotonic() - began > _AT_ONCE:
            say(f"metrosep: {message}")

    return tell


@click.command()
@click.option("-o", "--out", default="metrosep-demo", show_default=True, help="Folder to write.")
@force_option
@json_option
@click.pass_context
def demo(context: click.Context, out: str, force: bool, as_json: bool) -> int:
    """Run the main job on the shipped example: nine runs -> machine error -> table -> report."""
    from metrosep.cli.errors import verdict_code
    from metrosep.recipe.recipe import Recipe

    recipe = Recipe.load(example_folder("straightness") / "recipe.toml")
    result = recipe.run(out=out, progress=progress(context), overwrite=force)
    _print_result(result, as_json=as_json)
    return verdict_code(result.verdict)


@click.command()
@click.argument("recipe")
@click.argument("inputs", nargs=-1, metavar="INPUT...")
@click.option("-o", "--out", required=True, help="Folder for tables, reports and result.json.")
@override_option
@report_option
@force_option
@json_option
@click.pass_context
def run(
    context: click.Context,
    recipe: str,
    inputs: tuple[str, ...],
    out: str,
    overrides: tuple[str, ...],
    fields: tuple[str, ...],
    force: bool,
    as_json: bool,
) -> int:
    """Run RECIPE on INPUT files or folders.

    The exit code is the verdict: 0 accepted, 1 rejected, 3 inconclusive. If anything fails, nothing
    new appears in the output folder.
    """
    from metrosep.cli.errors import verdict_code
    from metrosep.recipe.recipe import Recipe

    loaded = Recipe.load(recipe, overrides=overrides, report=fields)
    if context.obj is not None:
        context.obj["words"] = functools.partial(recipe_words, loaded)
    result = loaded.run(list(inputs) or None, out=out, progress=progress(context), overwrite=force)
    _print_of(loaded, result, as_json=as_json)
    return verdict_code(result.verdict)


@click.command()
@click.argument("runs", nargs=-1, required=True, metavar="RUNS...")
@optional_read_options
@click.option(
    "--method",
    default="joint",
    show_default=True,
    help="Method: joint, kono or mean; or a named separation, donaldson (metrosep ops lists them).",
)
@named_options
@click.option(
    "--flexure",
    is_flag=True,
    help="RUNS are sweeps of a stage: --method flexure_calibration, columns voltage, displacement.",
)
@click.option("--start", metavar="LENGTH", help='Where the evaluation range begins: "0 mm".')
@click.option("--length", metavar="LENGTH", help='Length of the evaluation range: "45 mm".')
@click.option("--shortest", metavar="LENGTH", help='Shortest wavelength: "1.2 mm".')
@click.option("--lag", metavar="TIME", help='Delay of the reading: "1 ms", auto or fit.')
@click.option("--exclude", metavar="RUN,...", help="Runs to leave out; suspect: all with a fault.")
@click.option("--accept", metavar="RUN,...", help="Runs to keep although they are refused.")
@click.option("--min-feeds", type=int, metavar="N", help="Feedrates that must be there (joint).")
@click.option("--drift", type=int, metavar="0|1|2", help="Polynomial in time of each run (joint).")
@click.option("--lines", metavar="auto|FREQ,...", help='Disturbing lines: auto, "50 Hz" (joint).')
@click.option(
    "--robust", is_flag=True, default=None, help="Reduce the weight of outliers (joint, mean)."
)
@click.option(
    "--table",
    "table_",
    multiple=True,
    metavar="FORMAT=FILE;...",
    help='Write a table: linuxcnc=x.comp; options of this table follow: "linuxcnc=x.comp; spacing=0.5 mm; '
    'compensates=Z". May be repeated.',
)
@table_options
@click.option("--poly", metavar="DEGREE", help="Fit a polynomial: 2, or auto.")
@click.option("-o", "--out", metavar="DIR", help="Folder for report, table and result.json.")
@force_option
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@json_option
@click.pass_context
def separate(
    context: click.Context,
    /,
    runs: tuple[str, ...],
    table_: tuple[str, ...],
    out: str | None,
    force: bool,
    print_recipe: bool,
    as_json: bool,
    flexure: bool,
    **options: Any,
) -> int:
    """Separate the repeatable error of an axis from repeated RUNS.

    With a named method (metrosep ops): separate the readings of RUNS into their parts.

    Exit code 1: the table makes the error larger, removes less than 30 % of it, or exceeds a limit.
    2: a wrong option, or an output that cannot be written. 3: the readings do not show whether the
    table helps. 4: runs that cannot be read or separated.
    """
    from metrosep.cli.named import named_recipe, require_columns
    from metrosep.cli.shortcut import named_tables, of_table, option_error, recipe_text
    from metrosep.core.errors import RecipeError
    from metrosep.core.methods import METHODS
    from metrosep.recipe.preflight import require_limits
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.run import run_recipe

    if flexure:
        _as_flexure(context, options)
    if options["method"] in METHODS:
        if all(Path(file).suffix == ".json" or Path(file).is_dir() for file in runs):
            from metrosep.separation.inputs import method_of_results

            options["method"] = method_of_results(options["method"])
        given = {**options, "table_": table_ or None}
        text = named_recipe(options["method"], given, report=out is not None)
        return _separate_named(
            context,
            text,
            runs,
            out,
            method=options["method"],
            settings=[name for name, _ in name_values(options["settings"], "--set")],
            columns=[name for name, _ in name_values(options["columns"], "--column")],
            print_recipe=print_recipe,
            as_json=as_json,
        )
    require_columns(options, runs)
    for name in (*of_table().values(), "cross_axis", "machine"):
        if not table_ and name not in ("axis", "spacing") and options.get(name):
            raise click.UsageError(f"--{name.replace('_', '-')} shapes a table: add --table")
    tables = named_tables(table_, options, inside=out is not None)
    for made in tables if out is None and not print_recipe else ():
        require_place(made["target"], folder=False)
    text = recipe_text(options, tables=tables, report=out is not None)
    if print_recipe:
        click.echo(text, nl=False)
        return 0
    try:
        recipe = Recipe.parse(text, name="command line")
    except RecipeError as exc:
        settings = [name for name, _ in name_values(options["settings"], "--set")]
        said = option_error(exc, settings=settings, text=text, tables=tables)
        raise click.UsageError(said, ctx=context) from None
    beside = [] if out is not None else [made["target"] for made in tables]
    require_limits(recipe)
    result = run_recipe(
        recipe, runs, out=out, progress=progress(context), overwrite=force, beside=beside
    )
    _print_of(recipe, result, as_json=as_json)
    _say_next(out, tables, options)
    return 0


def _say_next(
    out: str | None,
    tables: Sequence[Mapping[str, Any]],
    options: Mapping[str, Any],
) -> None:
    """Print what one would do next: a table after a result, a check of the table after a table."""
    columns = [
        w for n in ("x", "z", "feed", "run") if options.get(n) for w in (f"--{n}", options[n])
    ]
    if tables:
        made = Path(out or "") / tables[0]["path"] if out else tables[0]["target"]
        say_next("verify", made, "--against", "NEW.csv", *columns)
    elif out is not None:
        # not every controller's file corrects another axis than its own
        axis = options.get("compensates") or "AXIS"
        say_next("table", out, "--compensates", axis, "--format", "csv", "-o", "table.csv")


def _as_flexure(context: click.Context, options: dict[str, Any]) -> None:
    """Make the call one of the calibration of a flexure; columns have usual names."""
    source = context.get_parameter_source("method")
    if source is not None and source.name != "DEFAULT":
        raise click.UsageError(
            "--flexure stands for --method flexure_calibration; give one of them"
        )
    options["method"] = "flexure_calibration"
    named = [name for name, _ in name_values(options["columns"], "--column")]
    usual = {"voltage": "voltage_V", "displacement": "displacement_um"}
    options["columns"] += tuple(f"{k}={v}" for k, v in usual.items() if k not in named)


def _separate_named(
    context: click.Context,
    text: str,
    files: tuple[str, ...],
    out: str | None,
    *,
    method: str,
    settings: list[str],
    columns: list[str],
    print_recipe: bool,
    as_json: bool,
) -> int:
    from metrosep.cli.shortcut import option_error
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.step_help import step_words

    if print_recipe:
        click.echo(text, nl=False)
        return 0
    try:
        recipe = Recipe.parse(text, name="command line")
    except RecipeError as exc:
        text = option_error(exc, settings=settings, columns=columns)
        raise click.UsageError(
            f"{text}; 'metrosep ops {method}' explains its keys", ctx=context
        ) from None
    if context.obj is not None:
        context.obj["words"] = functools.partial(step_words, op=method, command=True)
    result = recipe.run(list(files), out=out, progress=progress(context))
    print_named(recipe, result, as_json=as_json, command=True)
    return 0


def _print_of(recipe: Recipe, result: Result, *, as_json: bool) -> None:
    """Print the result of a recipe, and its tables."""
    if recipe.is_method:
        _print_tables(result, warnings_only=as_json)
        print_named(recipe, result, as_json=as_json)
    else:
        _print_result(result, as_json=as_json)


def _print_result(result: Result, *, as_json: bool) -> None:
    """Print a result and its tables."""
    files = [str(f) for f in result.files]
    if as_json:
        _print_tables(result, warnings_only=True)
        click.echo(json.dumps(_summary(result, files), sort_keys=True, allow_nan=False))
        return
    estimate = result.estimate
    say("error " + repr(estimate).removeprefix(f"{type(estimate).__name__}(").removesuffix(")"))
    for feed, number in (result.document.get("plan") or {}).get("runs", ()):
        say(f"next: {number} run(s) at {feed:.6g} mm/min")
    for message in result.document["messages"]:
        say(f"note: {message}")
    _print_tables(result)
    if result.document["polynomial"] is not None:
        say(result.document["polynomial"]["horner"])
        _print_polynomial_u(result.document["polynomial"])
    if result.verdict is not None:
        say(f"verdict: {result.verdict}")
    print_files(result, "table")


def _print_polynomial_u(polynomial: dict[str, Any]) -> None:
    """Print the greatest standard uncertainty of a polynomial and where it comes from."""
    from metrosep.core.units import format_length

    u, source = polynomial["u_greatest_m"], polynomial["covariance_from"]
    removed = "" if polynomial["removed"] == "line" else ", mean removed"
    say(
        f"u of the polynomial{removed}: {'' if u is None else f'up to {format_length(u, digits=2)}, from the '}{source}"
    )


def _print_tables(result: Result, *, warnings_only: bool = False) -> None:
    for made in (result.document["table"], *result.document["more_tables"]):
        if made is not None:
            from metrosep.cli.tables import print_table

            print_table(str(made.get("path", "table")), made, warnings_only=warnings_only)


def _summary(result: Result, files: list[str]) -> dict[str, Any]:
    estimate = result.estimate
    pv = estimate.peak_to_valley()
    spectrum = estimate.spectrum
    selected = (
        spectrum[spectrum["selected"].astype(bool)][["wavelength_mm", "amplitude_nm", "sd_nm"]]
        if len(spectrum)
        else spectrum
    )
    from metrosep.recipe.result import clean

    summary: dict[str, Any] = clean(
        {
            "method": estimate.method,
            "start_mm": estimate.start * 1e3,
            "stop_mm": estimate.stop * 1e3,
            "pv_nm": pv.value * 1e9,
            "u_pv_nm": None if pv.u is None else pv.u * 1e9,
            "residual_rms_nm": estimate.residual_rms * 1e9,
            "slope_urad": estimate.slope.value * 1e6,
            "lag_ms": estimate.lag * 1e3,
            "lag_sd_ms": estimate.lag_sd * 1e3,
            "messages": list(result.document["messages"]),
            "selected": selected.to_dict("records"),
            "verification": (result.document["table"] or {}).get("verification"),
            "polynomial": result.document["polynomial"],
            "verdict": result.verdict,
            "files": files,
            "inputs": result.document["inputs"],
        }
    )
    return summary


# ---- what is printed about a named separation, and in which words ------------------------------

_SUMMARY = ("op", "what", "method", "null_space", "noise", "audit", "units", "runs", "result")


def recipe_words(recipe: Recipe, message: str) -> str:
    """Return a message of the library with its arguments as keys of a recipe."""
    from metrosep.recipe.step_help import recipe_words

    message = message.replace(" or say overwrite", " or give --force")
    return recipe_words(recipe, message)


def print_named(recipe: Recipe, result: Result, *, as_json: bool, command: bool = False) -> None:
    """Print what a named separation found."""
    from metrosep.recipe.step_help import step_words
    from metrosep.report.text import not_seen

    op, document = recipe.steps[0]["op"], result.document
    messages = [step_words(m, op, command=command) for m in document["messages"]]
    if as_json:
        kept = ("characteristics", "messages", "inputs", "verdict")
        separation = {k: v for k, v in document["separation"].items() if k in _SUMMARY}
        summary = {k: document[k] for k in kept} | {"separation": separation}
        summary["messages"] = messages
        summary["files"] = [str(f) for f in result.files]
        click.echo(json.dumps(summary, sort_keys=True, allow_nan=False))
        return
    for line in _values(document["characteristics"]):
        say(line)
    for feed, runs in document["separation"].get("runs") or []:
        say(f"next: {runs} run(s) at {feed:.6g} mm/min")
    for parts, what in not_seen(document["separation"]):
        say(f"not seen: {parts}: {step_words(what, op, command=command)}".replace("µ", "u"))
    for message in messages:
        say(f"note: {message}")
    for entry in document["characteristics"]:
        if entry.get("reason") or entry.get("u_note"):
            say(f"{entry['metric']}: {entry['verdict']}: {entry.get('reason') or entry['u_note']}")
    if result.verdict is not None:
        say(f"verdict: {result.verdict}")
    print_files(result, "parts")


def print_files(result: Result, usual: str) -> None:
    """Print what was written: tables and their sidecars are known by the document."""
    of_tables = [result.document.get("table"), *result.document.get("more_tables", ())]
    tables = {t.get("path") for t in of_tables if t}
    for file in result.files:
        label = {".json": "result", ".html": "report", ".pdf": "report", ".xlsx": "report"}.get(
            file.suffix, usual
        )
        if file.name in tables:
            label = "table"
        elif file.name.removesuffix(".json") in tables:
            label = "sidecar"
        say(f"{label:8} {file}")


def _values(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return a line for each value; P-V and RMS of one part share theirs."""
    from metrosep.core.readable import value_text

    lines: dict[str, list[str]] = {}
    for entry in entries:
        part, _, kind = str(entry["metric"]).rpartition(".")
        text = value_text(entry["value"], entry["unit"], entry["u"])
        if part and kind in _EXTREMES:
            lines.setdefault(part, []).append(f"{_EXTREMES[kind]} {text}")
        else:
            lines.setdefault(str(entry["metric"]), []).append(text)
    return [f"{name}: {', '.join(texts)}" for name, texts in lines.items()]


_EXTREMES = {"pv": "P-V", "rms": "RMS"}


# ---- where the shipped examples lie: in the checkout, or inside the installed package ----------


def example_folder(name: str) -> Path:
    """Return the folder of a shipped example."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package.parent / "examples" / name, package / "_examples" / name):
        if (folder / "recipe.toml").is_file():
            return folder
    raise ReadError(
        f"the example {name!r} is not part of this installation; install metrosep again"
    )
