"""Commands with models of machine and process: rank, predict, plan, air."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option, name_values, option_words, say, tool_option
from metrosep.cli.shortcut import PARTS_AND_REPORT, list_of, listed, own_recipe, quoted
from metrosep.core.options import KINDS
from metrosep.core.readable import readable_text
from metrosep.separation.positions.laser_options import AIR_KEYS

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe


@click.command()
@click.argument("machine")
@click.option("--form", required=True, metavar="FORM", help='"toric: Rb=265 mm, Rd=132.5 mm" ...')
@click.option("--radius", required=True, metavar="LENGTH", help='Radius of the part: "20 mm".')
@click.option("--inner-radius", metavar="LENGTH", help="Radius of a hole in the part.")
@click.option(
    "--pivot-height",
    metavar="LENGTH",
    help="Height of the table above the axis of A, for the preset five_axis.",
)
@click.option(
    "--at",
    "places",
    multiple=True,
    metavar="AXIS=ANGLE",
    help='Where an axis of rotation is locked while the part is cut, "A=0 deg"; one that carries the part and '
    "is not named turns it, as a spindle does.",
)
@click.option(
    "--error",
    "errors",
    multiple=True,
    metavar="TERM=VALUE",
    help='"EXX=1 um", "EAC=0.2 arcsec", "EZX=wave 8 mm 1 um", "EZC=2 upr 50 nm", "EXX=table x.csv".',
)
@click.option(
    "--all-lengths", metavar="LENGTH", help='Error of every other term that is a length, "1 um".'
)
@click.option(
    "--all-angles",
    metavar="ANGLE",
    help='Error of every other term that is an angle, "0.2 arcsec".',
)
@click.option(
    "--removed",
    metavar="FREEDOMS",
    help="none, piston, plane (default), plane+defocus, rigid, mounting, zernike 11, or names.",
)
@click.option(
    "--response",
    type=click.Choice(["form", "wavefront"]),
    help="Deviation that is ranked: of the form, or of the wavefront.",
)
@click.option(
    "--mode",
    type=click.Choice(["reflect", "refract"]),
    help="Whether the surface reflects or refracts the light.",
)
@click.option("--n", type=float, metavar="INDEX", help="Refractive index of the material.")
@click.option(
    "--distribution",
    type=click.Choice(["normal", "uniform"]),
    help="Values are standard uncertainties (default) or half-widths.",
)
@click.option(
    "--spindle-errors",
    type=click.Choice(["co-rotating", "fixed"]),
    help="Errors of the spindle turn with the part (co-rotating) or stay in the machine (fixed). "
    "Default: that of the preset.",
)
@tool_option
@click.option("-o", "--out", metavar="DIR", help="Folder for report, table and result.json.")
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@json_option
@click.pass_context
def rank(
    context: click.Context,
    /,
    machine: str,
    errors: tuple[str, ...],
    places: tuple[str, ...],
    out: str | None,
    print_recipe: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Rank the error terms of MACHINE (a preset, or a file of TOML) by what they do to a part.

    Presets: five_axis, fts_lathe, mill_xyz, sts_lathe. docs/how-to/describe-a-machine.md has a file of an
    own machine to copy, with all its keys. A term that is not named has no error.
    """
    lines = ["metrosep = 1", "", "[[step]]", 'op = "rank"', f"machine = {quoted(machine)}"]
    tool = options.pop("tool")
    if tool is not None:
        lines.append(f"tool = {listed(tool)}")
    for key, value in options.items():
        if value is not None:
            lines.append(f"{key} = {value if isinstance(value, float) else quoted(value)}")
    for key, option, texts in (("at", "--at", places), ("errors", "--error", errors)):
        if texts:
            pairs = ", ".join(f"{quoted(k)} = {quoted(v)}" for k, v in name_values(texts, option))
            lines.append(f"{key} = {{ {pairs} }}")
    if context.obj is not None:
        context.obj["words"] = _ranked_words
    return _carried_out(context, lines, (), out, print_recipe=print_recipe, as_json=as_json)


def _ranked_words(message: str) -> str:
    """Return a message of the step ``rank`` with its keys as options of the command."""
    keys = ("all_lengths", "all_angles", "inner_radius", "spindle_errors", "pivot_height", "tool")
    words = re.sub(r"^form = ", "--form ", option_words(readable_text(message), keys))
    words = re.sub(r"\bat = \{ (.+?) \}", _as_options, words)
    return re.sub(r'\b(E[XYZABC]{2}) = "', r'--error "\1=', words)


def _as_options(found: re.Match[str]) -> str:
    """Return the pairs of ``at`` as they are typed."""
    return re.sub(r'(\w+) = "([^"]*)",?', r'--at "\1=\2"', found[1])


def _stated(command: Callable[..., int]) -> Callable[..., int]:
    """Add an option for each key of the step ``air``, as it is declared."""
    for name, known in reversed(list(AIR_KEYS.items())):
        kind: Any = click.Choice(known.choices) if known.choices else str
        metavar = (KINDS[known.kind].dimension or known.kind).split()[0].upper()
        command = click.option(
            f"--{name.replace('_', '-')}",
            name,
            type=kind,
            metavar=None if known.choices else metavar,
            help=_sentence(name, str(known.help)),
        )(command)
    return command


def _sentence(name: str, text: str) -> str:
    """Return the help of a key as a sentence that stands alone."""
    noun = name.replace("_", " ")
    if text.startswith(("of ", "from ", "between ")):
        text = f"{noun} {text}"
    elif text.startswith(("as ", "in place ")):
        text = f"{noun}, {text}"
    return f"{text[0].upper()}{text[1:]}."


@click.command()
@_stated
@click.option("-o", "--out", metavar="DIR", help="Folder for report, budget and result.json.")
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@json_option
@click.pass_context
def air(
    context: click.Context, /, out: str | None, print_recipe: bool, as_json: bool, **given: Any
) -> int:
    """Compute the refractive index of air, and the corrections of a laser reading.

    --temperature, --pressure and --humidity (or --dew-point, --vapour-pressure) state the air. With
    --reading, the corrections to add to that reading are printed, each with its uncertainty.
    """
    lines = ["metrosep = 1", "", "[[step]]", 'op = "air"']
    for key, value in given.items():
        if value is not None:
            plain = AIR_KEYS[key].kind == "number"
            lines.append(f"{key} = {value if plain else quoted(value)}")
    return _carried_out(context, lines, (), out, print_recipe=print_recipe, as_json=as_json)


_PREDICTED = ("predict", "cut_budget", "axis_motion")


@click.command()
@click.argument("process")
@click.option("-o", "--out", metavar="DIR", help="Folder for report, program and result.json.")
@json_option
@click.pass_context
def predict(context: click.Context, process: str, out: str | None, as_json: bool) -> int:
    """Predict the form error of a part from PROCESS, a recipe whose step is predict.

    'metrosep ops predict' lists its keys: surface, spiral, tool setting, log of the dry run. With
    -o and no [[output]] in PROCESS, program, budget and report are written. Of a program file
    that is there, the steps cut_budget (error of the part, cause by cause) and axis_motion
    (velocity, acceleration and jerk of the axes) tell what it will do.
    """
    from metrosep.cli.errors import verdict_code
    from metrosep.cli.jobs import print_named, progress
    from metrosep.recipe.recipe import Recipe

    recipe = Recipe.load(process)
    if recipe.steps[0]["op"] not in _PREDICTED:
        raise click.UsageError(
            f"{process}: its step is {recipe.steps[0]['op']!r}; predict needs one with "
            'op = "predict", "cut_budget" or "axis_motion" (or use metrosep run)'
        )
    if out is not None and not recipe.outputs:
        text = "\n".join([recipe.text.rstrip(), *PARTS_AND_REPORT, ""])
        recipe = Recipe.parse(text, name=recipe.name, folder=recipe.folder)
    _own_words(context, recipe)
    result = recipe.run(out=out, progress=progress(context))
    print_named(recipe, result, as_json=as_json)
    return verdict_code(result.verdict)


def identified(
    context: click.Context,
    file: str,
    machine: str,
    form: str,
    *,
    options: dict[str, Any],
    out: str | None,
    as_json: bool,
) -> int:
    """Run ``form FILE --identify``: error terms, or a tool setting, that explain a map."""
    op = "tool_setting" if machine == "tool" else "identify"
    lines = ["metrosep = 1", "", "[input]"]
    lines += [f"{k} = {quoted(v)}" for k, v in options.pop("reading").items() if v is not None]
    lines += ["", "[[step]]", f"op = {quoted(op)}", f"form = {quoted(form)}"]
    if op == "identify":
        lines.append(f"machine = {quoted(machine)}")
    for key, value in options.items():
        if value is None:
            continue
        if isinstance(value, dict):
            text = "{ " + ", ".join(f"{quoted(k)} = {v}" for k, v in value.items()) + " }"
        elif isinstance(value, list):
            text = list_of(value)
        else:
            text = quoted(value)
        lines.append(f"{key} = {text}")
    return _carried_out(context, lines, (file,), out, print_recipe=False, as_json=as_json)


def _carried_out(
    context: click.Context,
    lines: list[str],
    files: tuple[str, ...],
    out: str | None,
    *,
    print_recipe: bool,
    as_json: bool,
) -> int:
    """Carry out the recipe of a call."""
    from metrosep.cli.jobs import print_named, progress

    recipe = own_recipe(context, lines, report=out is not None, print_recipe=print_recipe)
    if recipe is None:
        return 0
    result = recipe.run(list(files) or None, out=out, progress=progress(context))
    if recipe.steps[0]["op"] == "rank" and not as_json:
        click.echo(result.produced.report())
        for file in result.files:
            say(f"wrote {file}")
        return 0
    print_named(recipe, result, as_json=as_json, command=True)
    return 0


def _own_words(context: click.Context, recipe: Recipe) -> None:
    """Let errors speak of the keys of the recipe."""
    import functools

    from metrosep.cli.jobs import recipe_words

    if context.obj is not None:
        context.obj["words"] = functools.partial(recipe_words, recipe)


# ---- plan: the feedrates of the next runs -------------------------------------------------------

_DIMENSIONS = {
    "v_min": "speed",
    "v_max": "speed",
    "length": "length",
    "settle_distance": "length",
    "max_time": "time",
}


@click.command()
@click.argument("result")
@click.option("--v-min", required=True, metavar="SPEED", help='Slowest feedrate: "1000 mm/min".')
@click.option("--v-max", required=True, metavar="SPEED", help='Fastest feedrate: "9600 mm/min".')
@click.option("--runs", "n_runs", type=int, required=True, metavar="N", help="Runs to plan.")
@click.option(
    "--wavelengths",
    required=True,
    metavar="LENGTH,...",
    help='Waves that matter: "10 mm,5 mm"; a range: "2 mm..20 mm".',
)
@click.option("--length", metavar="LENGTH", help="Travel of a run; as measured if omitted.")
@click.option(
    "--settle-distance",
    metavar="LENGTH",
    help="Part of the travel that is lost while the axis settles.",
)
@click.option("--max-time", metavar="TIME", help="Longest travel time of all runs together.")
@click.option(
    "--min-ratio",
    type=float,
    metavar="RATIO",
    help="Smallest ratio of two different feedrates. Default: 1.1.",
)
@json_option
@click.pass_context
def plan(
    context: click.Context,
    /,
    result: str,
    wavelengths: str,
    n_runs: int,
    as_json: bool,
    **options: Any,
) -> int:
    """Plan the feedrates of the next runs from RESULT (result.json of 'metrosep separate').

    At the planned feedrates the disturbance that was found leaves each wavelength as well known as
    possible; the predicted standard deviations tell how well.
    """
    from metrosep.recipe.methods.plan import plan_after, plan_document
    from metrosep.recipe.result import clean, load_document, stored_estimate

    if context.obj is not None:
        context.obj["words"] = _words
    given = {
        name: _parsed(value, _DIMENSIONS[name], name) if name in _DIMENSIONS else value
        for name, value in options.items()
        if value is not None
    }
    estimate = stored_estimate(load_document(result))
    found = plan_after(estimate, {**given, "n_runs": n_runs, "wavelengths": _waves(wavelengths)})
    document = plan_document(found)
    if as_json:
        kept = {k: v for k, v in document.items() if k != "charts"}
        kept["messages"] = [_words(m) for m in document["messages"]]
        click.echo(json.dumps(clean(kept), sort_keys=True, allow_nan=False))
        return 0
    for feed, number in document["runs"]:
        say(f"{number} run(s) at {feed:.6g} mm/min")
    columns = document["sd"]
    names = ("wavelength_mm", "sd_nm", "sd_geometric_feeds_nm", "sd_one_feed_nm")
    for wave, sd, even, one in zip(*(columns[k] for k in names), strict=True):
        say(
            f"{wave:.6g} mm: sd {_nm(sd)}; feedrates in equal ratios {_nm(even)}; all at the middle "
            f"feedrate {_nm(one)}"
        )
    for message in document["messages"]:
        say(f"note: {_words(message)}")
    return 0


def _words(message: str) -> str:
    """Return a message of the planner with the options of this command."""
    from metrosep.core.readable import readable_text

    def option(found: re.Match[str]) -> str:
        name = {"n_runs": "runs"}.get(found.group(1), found.group(1)).replace("_", "-")
        return f"--{name} " if found.group(2) else f"--{name}"

    names = "|".join([*_DIMENSIONS, "n_runs", "wavelengths", "min_ratio"])
    named = rf"(?<![\w\-])({names})( = |=)"
    spelled = r"(?<![\w\-])(v_min|v_max|n_runs|settle_distance|max_time|min_ratio)\b(?=())"
    return re.sub(spelled, option, re.sub(named, option, readable_text(message)))


def _nm(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3g} nm"


def _parsed(text: str, dimension: str, name: str) -> float:
    from metrosep.core.errors import UnitError
    from metrosep.core.units import parse_quantity

    try:
        return parse_quantity(text, dimension=dimension)
    except UnitError as exc:
        raise click.UsageError(f"--{name.replace('_', '-')}: {exc}") from None


def _waves(text: str) -> dict[str, float] | tuple[float, ...]:
    ends = text.split("..")
    if len(ends) == 2:
        low, high = sorted(_parsed(e.strip(), "length", "wavelengths") for e in ends)
        return {"shortest": low, "longest": high}
    return tuple(_parsed(w.strip(), "length", "wavelengths") for w in text.split(","))
