"""Command that judges form and position: geometry."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.measuring import limit_text
from metrosep.cli.options import READING, force_option, json_option, name_values
from metrosep.cli.shortcut import input_lines, list_of, of_reader, option_error, quoted, typed
from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.core.options import Option
    from metrosep.recipe.recipe import Recipe

GEOMETRY: Mapping[str, tuple[str, ...]] = {
    "step_height": ("d", "h"),
    "surface_profile": ("t",),
    "line_profile": ("t",),
    "roundness": ("RONt", "RONp", "RONv", "RONq"),
    "cylindricity": ("CYLt",),
    "run_out": ("CRO", "TRO"),
    "coaxiality": ("COX",),
    "parallelism": ("PAR",),
    "perpendicularity": ("PER",),
}
"""What is judged, and the symbols of its values; the first is meant where a limit names none."""

_COLUMNS = ("x", "y", "z", "angle", "radius", "height", "section", "element")


def _columns(command: Any) -> Any:
    """Add the options that name columns and say how a file is written."""
    texts = {
        "x": "of x, x_mm", "y": "of y", "z": "of z, or of the heights of a profile",
        "angle": "of the angle of a trace, angle_deg", "radius": "of the radius of a trace, or of its deviation",
        "height": "of the height of a trace along z", "section": "that names the section of a point",
        "element": "that names the element (A, B) of a point",
    }  # fmt: skip
    made = [
        click.option(f"--{n}", metavar="COLUMN", help=f"Column {t}.") for n, t in texts.items()
    ]
    made += [click.option(f"--{n.replace('_', '-')}", help=t) for n, t in TEXT_OPTIONS.items()]
    made += [
        click.option(
            "--unit", help="Maps and profiles: unit of the heights, if the file has none."
        ),
        click.option("--lateral-step", help='Maps and profiles: overrides the file, "1.1 um".'),
        click.option("--channel", help="Channel of a file that holds several."),
        click.option("--as", "format", metavar="FORMAT", help="Read the file as this format."),
    ]
    return functools.reduce(lambda c, o: o(c), reversed(made), command)


@click.command()
@click.argument("what", type=click.Choice(list(GEOMETRY)))
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help='Key of the step, "width=100 um", "datum=A"; metrosep ops WHAT lists them.',
)
@_columns
@click.option("--upper", multiple=True, metavar="[SYMBOL=]VALUE", help='Limit, "5 um".')
@click.option("--lower", multiple=True, metavar="[SYMBOL=]VALUE", help="Lower limit.")
@click.option(
    "--U",
    "expanded",
    multiple=True,
    metavar="[SYMBOL=]VALUE",
    help='Expanded U, "0.4 um"; of a step height also "from fit".',
)
@click.option(
    "--guard-factor", default=1.0, show_default=True, help="Guard band as a multiple of U."
)
@click.option("-o", "--out", metavar="DIR", help="Folder for the report and result.json.")
@force_option
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@json_option
@click.pass_context
def geometry(
    context: click.Context,
    /,
    what: str,
    files: tuple[str, ...],
    settings: tuple[str, ...],
    upper: tuple[str, ...],
    lower: tuple[str, ...],
    expanded: tuple[str, ...],
    guard_factor: float,
    out: str | None,
    force: bool,
    print_recipe: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Judge form, orientation, location or run-out of FILE: ISO 1101, 12180, 5436-1.

    step_height takes a profile or a map across a groove, surface_profile a map, line_profile a
    profile, roundness traces (angle, radius); the others take points (columns x, y, z) or traces of
    a roundness instrument (angle, radius, height). The exit code is 0 accepted or no limit, 1 rejected, 3 inconclusive.
    """
    from metrosep.cli.errors import verdict_code
    from metrosep.cli.jobs import print_named, progress
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.preflight import require_limits
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.step_help import step_words

    given = {
        key: _by_symbol(texts, f"--{key}", GEOMETRY[what])
        for key, texts in (("lower", lower), ("upper", upper), ("U", expanded))
    }
    idle = [s for s in given["U"] if s not in {**given["lower"], **given["upper"]}]
    if idle:
        raise click.UsageError(f"--U is given for {', '.join(idle)}, which has no limit")
    text = _recipe_text(what, files, settings, given, guard_factor, options)
    if print_recipe:
        click.echo(text, nl=False)
        return 0
    try:
        recipe: Recipe = Recipe.parse(text, name="command line")
        require_limits(recipe)
    except RecipeError as exc:
        named = [name for name, _ in name_values(settings, "--set")]
        raise click.UsageError(
            f"{option_error(exc, settings=named)}; 'metrosep ops {what}' explains its keys",
            ctx=context,
        ) from None
    if context.obj is not None:
        context.obj["words"] = functools.partial(step_words, op=what, command=True)
    try:
        result = recipe.run(list(files), out=out, progress=progress(context), overwrite=force)
    except RecipeError as exc:
        raise click.UsageError(option_error(exc), ctx=context) from None
    print_named(recipe, result, as_json=as_json, command=True)
    return verdict_code(result.verdict)


def _by_symbol(texts: Sequence[str], option: str, known: Sequence[str]) -> dict[str, str]:
    """Return limits by symbol; one without a symbol is that of the first."""
    found: dict[str, str] = {}
    for text in texts:
        symbol, _, value = (part.strip() for part in text.rpartition("="))
        symbol = symbol or known[0]
        if symbol not in known:
            raise click.UsageError(f"{option} {text!r}: the values here are {', '.join(known)}")
        if symbol in found:
            raise click.UsageError(f"{option} is given twice for {symbol}")
        found[symbol] = value
    return found


def _recipe_text(
    what: str,
    files: Sequence[str],
    settings: tuple[str, ...],
    given: Mapping[str, Mapping[str, str]],
    guard_factor: float,
    options: Mapping[str, Any],
) -> str:
    """Return the recipe of a call as TOML."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.pipeline import MEASURING
    from metrosep.recipe.schema import input_fields
    from metrosep.recipe.steps import MEASURING_INPUT

    of_points = what in METHODS
    fields: Mapping[str, Option] = METHODS[what].fields if of_points else MEASURING[what].fields
    known = input_fields(METHODS[what]) if of_points else MEASURING_INPUT
    for key in (*_COLUMNS, *READING):
        if options.get(key) is not None and key not in known:
            raise click.UsageError(f"--{key.replace('_', '-')} is not read by {what}")
    if not of_points and len(files) > 1:
        raise click.UsageError(
            f"{what} is of one FILE, got {len(files)}; of many parts take metrosep batch with the "
            "recipe that --print-recipe prints"
        )
    lines = ["metrosep = 1", "", "[input]", f"files = {list_of(files)}"]
    of_input, of_step = of_reader(name_values(settings, "--set"), known, fields)
    reading = {k: v for k, v in options.items() if k in known} | of_input
    lines += input_lines(reading, reading)
    lines += ["", "[[step]]", f"op = {quoted(what)}"]
    for key, value in of_step:
        name = key.replace("-", "_")
        lines.append(f"{name} = {typed(name, value, fields)}")
    for symbol in {**given["lower"], **given["upper"]}:
        lines += ["", "[[check]]", f"metric = {quoted(symbol)}"]
        limits = ((k, given[k].get(symbol)) for k in ("lower", "upper", "U"))
        lines += [f"{k} = {limit_text(v)}" for k, v in limits if v is not None]
        if guard_factor != 1.0:
            lines.append(f"guard_factor = {guard_factor!r}")
    if of_points:
        lines += ["", "[[output]]", 'kind = "parts"']
    return "\n".join([*lines, "", "[[output]]", 'kind = "report"', ""])
