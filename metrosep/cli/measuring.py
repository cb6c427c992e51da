"""Commands that measure: measure, form; verify-softgauge has a module of its own."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import (
    INPUT_KEYS,
    file_options,
    json_option,
    name_values,
    phase,
    read_aloud,
    report_option,
    say,
    say_next,
)
from metrosep.cli.shortcut import input_lines, option_error, quoted
from metrosep.core.limits import RULES
from metrosep.core.units import format_length

if TYPE_CHECKING:
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe

_CALL = "command line"
_PLAIN = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?:SI)?\s*")
_USUAL = {"line": "lsq", "reference": "MZ"}
_WORST_FIRST = (4, 2, 1, 3)
"""Exit codes: a file that was not measured, then reject, then inconclusive."""


def _pairs(texts: tuple[str, ...], option: str) -> dict[str, str]:
    return dict(name_values(texts, option))


def _names(text: str | None) -> tuple[str, ...]:
    """Return the symbols of a list; commas between brackets are those of arguments."""
    return tuple(n.strip() for n in re.split(r",(?![^(]*\))", text or "") if n.strip())


def flat_values(quantities: Any) -> dict[str, float | None]:
    """Return parameters as flat keys with unit suffixes: ``sq_nm``, ``rsm_um``, ``ssk``."""
    import math

    lateral = {"rsm", "wsm", "psm", "sal"}
    found: dict[str, float | None] = {}
    for symbol, quantity in quantities.items():
        name, suffix, factor = symbol.lower(), "", 1.0
        if symbol == "Pv":  # the deepest valley of a P profile; pv_nm is peak to valley everywhere
            name = "p_v"
        if quantity.unit == "m":
            suffix, factor = ("_um", 1e6) if name in lateral else ("_nm", 1e9)
        elif quantity.unit == "rad":
            suffix, factor = "_deg", math.degrees(1.0)
        elif quantity.unit == "1/m":
            suffix, factor = "_per_mm", 1e-3
        elif quantity.unit == "1/m^2":
            suffix, factor = "_per_mm2", 1e-6
        elif quantity.unit in ("m^2", "m^3"):
            power = int(quantity.unit[-1])
            suffix, factor = f"_um{power}", 1e6**power
        value = quantity.value * factor
        found[name + suffix] = None if math.isnan(value) else value
    return found


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option(
    "--form",
    "form_text",
    default="none",
    show_default=True,
    metavar="FORM",
    help='Removed first: plane, sphere, "conic: R=50 mm", "polynomial: degree=5" ...',
)
@click.option("--lambda-s", metavar="LENGTH", help="S-filter: remove shorter waves (Gaussian).")
@click.option("--lambda-c", metavar="LENGTH", help="L-filter: remove longer waves (Gaussian).")
@click.option(
    "--end",
    type=click.Choice(["moment", "renormalise", "cut", "closed"]),
    default="moment",
    show_default=True,
    help="Rule of the filters at the ends of the data.",
)
@click.option(
    "--core-filter",
    type=click.Choice(["gaussian", "13565-1", "robust"]),
    help="Filter behind --lambda-c; the last two follow a plateau with deep valleys (Rk).",
)
@click.option(
    "--kind", type=click.Choice(["P", "W", "R"]), help="Kind of the profile after the filters."
)
@click.option(
    "--edition",
    help='"ISO 21920-2:2021" (default), "ISO 4287:1997" or "ASME B46.1"; of a map '
    '"ISO 25178-2:2021" (default) or "ISO 25178-2:2012".',
)
@click.option(
    "--sections",
    type=click.IntRange(min=1),
    help="Number of section lengths. Default: as many cut-offs as fit, or 5.",
)
@click.option(
    "--centre", is_flag=True, help="Subtract the mean after filtering; instruments do not."
)
@click.option(
    "--line",
    type=click.Choice(["lsq", "secant"]),
    default="lsq",
    show_default=True,
    help="Core line of the Rk family.",
)
@click.option(
    "--params", metavar="SYMBOLS", help="Parameters, Sa,Sq,PV; all that apply if omitted."
)
@click.option(
    "--reference",
    type=click.Choice(["MZ", "LS", "EP", "MC", "MI"]),
    default="MZ",
    show_default=True,
    help="Reference of straightness (STRt), flatness (FLTt), roundness (RONt).",
)
@click.option("--upper", multiple=True, metavar="SYMBOL=VALUE", help='Limit, "Sq=5 nm".')
@click.option("--lower", multiple=True, metavar="SYMBOL=VALUE", help="Lower limit.")
@click.option(
    "--U",
    "expanded",
    multiple=True,
    metavar="SYMBOL=VALUE",
    help='Expanded uncertainty of a value, "Sq=0.3 nm".',
)
@click.option(
    "--guard-factor", default=1.0, show_default=True, help="Guard band as a multiple of U."
)
@click.option(
    "--rule",
    type=click.Choice(RULES),
    help="Judge several values: those of the sections of one FILE, or of several FILES in turn.",
)
@click.option("--sequential", is_flag=True, help="Stages of the 16 % rule: 1, 3, 6, 12 values.")
@click.option(
    "-o", "--out", metavar="DIR", help="Folder for the report and result.json of one FILE."
)
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@report_option
@file_options
@json_option
def measure(
    files: tuple[str, ...],
    form_text: str,
    lambda_s: str | None,
    lambda_c: str | None,
    end: str,
    core_filter: str | None,
    kind: str | None,
    edition: str | None,
    sections: int | None,
    centre: bool,
    line: str,
    params: str | None,
    reference: str,
    upper: tuple[str, ...],
    lower: tuple[str, ...],
    expanded: tuple[str, ...],
    guard_factor: float,
    rule: str | None,
    sequential: bool,
    out: str | None,
    print_recipe: bool,
    fields: tuple[str, ...],
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Remove the form, filter, and give the parameters of FILE, with a verdict where limits are set.

    The exit code is the worst of all files: 4 a file that cannot be read, 2 options that do not fit it,
    1 rejected, 3 inconclusive, 0 accepted or no limit.
    """
    from metrosep.cli.errors import exit_code_of, flags_of, report_error, verdict_code
    from metrosep.core.errors import MetrosepError

    options: dict[str, Any] = {
        "form": form_text, "lambda_s": lambda_s, "lambda_c": lambda_c, "end": end, "kind": kind,
        "edition": edition, "sections": sections, "centre": centre, "line": line,
        "names": _names(params), "reference": reference, "guard_factor": guard_factor,
        "rule": rule, "sequential": sequential, "core_filter": core_filter,
        "lower": _pairs(lower, "--lower"), "upper": _pairs(upper, "--upper"), "U": _pairs(expanded, "--U"),
    }  # fmt: skip
    limits = {**options["lower"], **options["upper"]}
    if options["U"]:
        from metrosep.parameters.symbol_units import same_parameter

        options["U"] = {
            next((s for s in limits if same_parameter(s, name)), name): u
            for name, u in options["U"].items()
        }
    idle = [s for s in options["U"] if s not in limits]
    if idle:
        raise click.UsageError(f"--U is given for {', '.join(idle)}, which has no limit")
    if (rule or sequential) and not limits:
        raise click.UsageError("--rule judges values by a limit: give --upper or --lower")
    if fields and out is None:
        raise click.UsageError(
            "--report states a field of the report: add -o DIR, where it is written"
        )
    if print_recipe or out is not None:
        _require_recipe_of_one(files, reading)
    recipe = _recipe(
        files[0] if print_recipe or out is not None else None, options, reading, report=fields
    )
    if print_recipe:
        click.echo(recipe.text, nl=False)
        every = f'input.files=["*{Path(files[0]).suffix}"]'
        say_next("batch", "RECIPE", "FOLDER", "-o", "qa", "-s", every)
        return 0
    results: list[dict[str, Any]] = []
    codes = []
    several = _several(files, recipe, reading) if len(files) > 1 and rule else None
    for name in files:
        try:
            found = _measured(name, recipe, reading, several)
        except MetrosepError as error:
            if len(files) == 1:
                raise
            report_error(error, verbosity=0, names=flags_of(measure))
            codes.append(exit_code_of(error))
            results.append({"file": Path(name).name, "error": str(error)})
            continue
        codes.append(verdict_code(found["verdict"]))
        results.append({k: v for k, v in found.items() if k != "measured"})
        if not as_json:
            _print_measured(name, found)
    if as_json:
        content = results[0] if len(files) == 1 else {"files": results}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    if out is not None:
        for path in recipe.run([files[0]], out=out, progress=phase).files:
            say(f"{'report' if path.suffix == '.html' else 'result':8} {path}")
        own = () if find_spec("typst") else ("--pdf-engine", "matplotlib")
        say_next("report", out, "--format", "pdf", *own, "-o", "reports")
    return next((c for c in _WORST_FIRST if c in codes), 0)


def _require_recipe_of_one(files: Sequence[str], reading: Mapping[str, Any]) -> None:
    """Refuse a recipe of several files, or with options of readers that recipes do not have."""
    if len(files) != 1:
        raise click.UsageError("a recipe, a report and result.json are of one FILE: name one")
    stray = [k for k in reading if k not in INPUT_KEYS]
    if stray:
        raise click.UsageError(f"--set {stray[0]} has no key in a recipe that measures")


def _recipe(
    file: str | None,
    options: Mapping[str, Any],
    reading: Mapping[str, Any],
    *,
    report: Sequence[str] = (),
) -> Recipe:
    """Return the recipe of a call, checked."""
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.preflight import require_limits
    from metrosep.recipe.recipe import Recipe

    text = _recipe_text(file, options, reading)
    try:
        recipe = Recipe.parse(text, name=_CALL, report=report)
        require_limits(recipe)
    except RecipeError as error:
        raise _as_typed(error, text) from None
    return recipe


def _recipe_text(file: str | None, given: Mapping[str, Any], reading: Mapping[str, Any]) -> str:
    """Return the recipe of a call as TOML."""
    cuts = [k for k in ("lambda_s", "lambda_c") if given[k] is not None]
    if given["end"] != "moment" and not cuts:
        raise click.UsageError(
            "--end says what a filter does at the ends; give --lambda-s or --lambda-c"
        )
    if given["core_filter"] is not None and given["lambda_c"] is None:
        raise click.UsageError(
            "--core-filter says how --lambda-c makes roughness: give --lambda-c"
        )
    lines = ["metrosep = 1", "", "[input]"]
    if file is not None:
        lines += [f"files = [{quoted(file)}]", *input_lines(reading, INPUT_KEYS)]
    if given["form"].strip().lower() != "none":
        lines += ["", "[[step]]", 'op = "form"', f"form = {quoted(given['form'])}"]
    if cuts:
        lines += ["", "[[step]]", 'op = "filter"', *(f"{k} = {quoted(given[k])}" for k in cuts)]
        if "lambda_c" in cuts and given["kind"] == "W":
            lines.append('profile = "W"')
        elif "lambda_c" in cuts and given["sections"] is not None:
            lines.append(f"sections = {given['sections']}")
        if given["end"] != "moment":
            lines.append(f"end = {quoted(given['end'])}")
        if given["core_filter"] is not None:
            lines.append(f"core_filter = {quoted(given['core_filter'])}")
    names = ", ".join(quoted(n) for n in given["names"] or ("all",))
    lines += ["", "[[step]]", 'op = "parameters"', f"names = [{names}]"]
    edition = given["edition"] and _edition(given["edition"])
    texts = {
        "kind": given["kind"],
        "edition": edition,
        "line": given["line"],
        "reference": given["reference"],
    }
    lines += [f"{k} = {quoted(v)}" for k, v in texts.items() if v not in (None, _USUAL.get(k))]
    if given["sections"] is not None:
        lines.append(f"sections = {given['sections']}")
    if given["centre"]:
        lines.append("centre = true")
    for symbol in {**given["lower"], **given["upper"]}:
        lines += ["", "[[check]]", f"metric = {quoted(symbol)}"]
        limits = ((k, given[k].get(symbol)) for k in ("lower", "upper", "U"))
        lines += [f"{k} = {limit_text(text)}" for k, text in limits if text is not None]
        if given["guard_factor"] != 1.0:
            lines.append(f"guard_factor = {given['guard_factor']!r}")
        if given["rule"] is not None:
            lines.append(f"rule = {quoted(given['rule'])}")
        if given["sequential"]:
            lines.append("sequential = true")
    return "\n".join([*lines, "", "[[output]]", 'kind = "report"', ""])


def _edition(text: str) -> str:
    """Return an edition as recipes spell it; spaces and case do not count."""
    plain = "".join(text.lower().split())
    from metrosep.recipe.pipeline_checks import AREAL_EDITIONS

    known = ("ISO 21920-2:2021", "ISO 4287:1997", "ASME B46.1", *AREAL_EDITIONS)
    return next((e for e in known if "".join(e.lower().split()) == plain), text)


def limit_text(text: str) -> str:
    """Return a limit as TOML has it: with its unit in quotes, a pure number or SI without."""
    number = _PLAIN.fullmatch(text)
    return quoted(text) if number is None else repr(float(number[1]))


def _as_typed(error: RecipeError, text: str) -> RecipeError:
    """Return an error in the recipe of a call in terms of its options."""
    from metrosep.core.errors import RecipeError

    message = re.sub(r"\b(names|kind|edition|form) = ", r"--\1 ", option_error(error))
    message = message.replace("--names", "--params")
    message = re.sub(
        r'\b(\w+) = ("[^"]*") in \[input\]',
        lambda m: f"--{m[1].replace('_', '-')} {m[2]}",
        message,
    )
    before = text.splitlines()[: error.line or 0]
    headers = [line for line in before if line.startswith("[")]
    if headers[-1:] != ["[[check]]"]:
        return RecipeError(message)
    symbol = json.loads(
        next(x for x in reversed(before) if x.startswith("metric")).split(" = ")[1]
    )

    def option(found: re.Match[str]) -> str:
        value = found[2].strip('"')
        quote = "'" if re.search(r"[\s=(]", symbol + value) else ""
        return f"--{found[1]} {quote}{symbol}={value}{quote}"

    message = re.sub(r"^--metric:? ", "", message)
    own = re.escape(symbol)
    message = re.sub(rf'^metric = "{own}"|^"{own}" (?=is )', lambda _: f"{symbol} ", message)
    message = message.replace("is made by no step", "has a limit but is not among --params")
    message = re.sub(r"^--(lower|upper|U):? ", lambda m: f"--{m[1]} of {symbol}: ", message)
    message = re.sub(r'\b(lower|upper|U) = ("[^"]*"|[\d.]+)', option, message)
    return RecipeError(" ".join(message.split()))


def _several(
    files: Sequence[str], recipe: Recipe, reading: Mapping[str, Any]
) -> Callable[[str], list[float]]:
    """Return the values of a metric in files, which one rule judges together."""
    from metrosep.io.read import read_for_recipe as read
    from metrosep.recipe.pipeline_run import measure_object

    measured = [measure_object(recipe, read(Path(f), **reading)) for f in files]
    return lambda metric: [m.found[metric].value for m in measured]


def _measured(
    name: str,
    recipe: Recipe,
    reading: Mapping[str, Any],
    values: Callable[[str], list[float]] | None = None,
) -> dict[str, Any]:
    """Return what the steps of a recipe find in a file, as it is printed, and the `Measurement`."""
    phase(f"measuring {name}")
    from metrosep.core.errors import RecipeError
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.io.findings import height_findings
    from metrosep.recipe.pipeline_run import judge_measurement, measure_object

    obj = read_aloud(name, reading)
    for finding in height_findings(obj) if isinstance(obj, Surface | Profile) else ():
        say(f"warning: {Path(name).name}: {finding.problem}; {finding.fix}")
    try:
        measured = measure_object(recipe, obj)
        judged = judge_measurement(recipe, measured, values=values)
    except RecipeError as error:
        raise _as_typed(error, recipe.text) from None
    tables = [t.to_dict() for t in measured.stages[-1].detail]
    limits = ("verdict", "lower", "upper", "U")
    reasons = ("reason", "k", "p", "u_source", "u_note", "rule", "values")
    return {
        "measured": measured,
        "file": Path(name).name,
        "parameters": {s: q for t in tables for s, q in t["parameters"].items()},
        "unavailable": {s: why for t in tables for s, why in t["unavailable"].items()},
        "evaluations": [
            {k: v for k, v in t.items() if k not in ("parameters", "unavailable")} for t in tables
        ],
        "verdicts": {
            c["metric"]: {k: c[k] for k in limits} | {k: c[k] for k in reasons if k in c}
            for c in judged["characteristics"]
            if c["verdict"] is not None
        },
        "verdict": judged["verdict"],
        **flat_values(measured.stages[-1].found),
    }


def _print_measured(name: str, found: Mapping[str, Any]) -> None:
    click.echo(name)
    stages = found["measured"].stages
    for line in (
        line
        for s in stages
        if s.op == "form" and s.detail is not None
        for line in s.detail.report().splitlines()
    ):
        click.echo(f"  form  {line}")
    for table in stages[-1].detail:
        context = table.context
        click.echo(
            f"  {context.edition}; {context.chain}; {context.n_valid} of {context.n_total} valid"
        )
        for symbol, quantity in table.items():
            verdict = found["verdicts"].get(symbol)
            mark = f"   {verdict['verdict'].upper()}" if verdict else ""
            click.echo(f"    {symbol:<7} {quantity!s:<22} {quantity.definition}{mark}")
        for symbol, why in table.unavailable.items():
            click.echo(f"    {symbol:<7} not available: {why}")
        for note in context.notes:
            click.echo(f"    note: {note}")
    for symbol, verdict in found["verdicts"].items():
        for key in ("u_note", "reason"):
            if verdict.get(key):
                said = re.sub(
                    r'\bU = (?:"([^"]*)"|([\d.]+))', rf'--U "{symbol}=\1\2"', str(verdict[key])
                )
                click.echo(f"  {symbol}: {said}")
    if found["verdict"] is not None:
        click.echo(f"  verdict: {found['verdict']}")


@click.command()
@click.argument("file")
@click.option(
    "--form",
    "form_text",
    default="plane",
    show_default=True,
    metavar="FORM",
    help='Form: sphere, "conic: R=50 mm", "zernike: terms=36, order=fringe".',
)
@click.option(
    "--free",
    metavar="NAMES",
    help="Parameters that are fitted: piston,tilt_x,tilt_y,shift_x,R ...",
)
@click.option(
    "--fix", multiple=True, metavar="NAME=VALUE", help='Parameter that is held, "R=50 mm".'
)
@click.option(
    "--start", multiple=True, metavar="NAME=VALUE", help='Start value of a parameter, "R=50 mm".'
)
@click.option(
    "--robust", type=click.Choice(["tukey", "huber"]), help="Reduce the weight of outliers."
)
@click.option(
    "--tilt",
    type=click.Choice(["plane", "rotation"]),
    default="plane",
    show_default=True,
    help="A tilted part is a plane that is added, or the turned form.",
)
@click.option(
    "--direction",
    type=click.Choice(["vertical", "normal"]),
    default="vertical",
    show_default=True,
    help="Direction of the deviation.",
)
@click.option("--centre", metavar="X,Y", help='Origin of the form in the data: "1.5 mm, 2 mm".')
@click.option("--residual", metavar="FILE", help="Write what is left: x3p, sur, h5, csv, int ...")
@click.option(
    "--identify",
    metavar="MACHINE",
    help="Errors that explain the map: of the tool setting (tool), a preset or a file of TOML.",
)
@click.option("--terms", metavar="TERMS", help="Error terms that may be at work (--identify).")
@click.option(
    "--curves",
    metavar="TERM=N,...",
    help='Terms that are curves (--identify), with their orders or auto: "EZX=auto,EZC=3".',
)
@click.option("--radius", metavar="LENGTH", help="Radius of the part (--identify).")
@click.option("-o", "--out", metavar="DIR", help="Folder for the report (--identify).")
@file_options
@json_option
@click.pass_context
def form(
    context: click.Context,
    file: str,
    form_text: str,
    free: str | None,
    fix: tuple[str, ...],
    start: tuple[str, ...],
    robust: Any,
    tilt: Any,
    direction: Any,
    centre: str | None,
    residual: str | None,
    identify: str | None,
    terms: str | None,
    curves: str | None,
    radius: str | None,
    out: str | None,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Fit an ideal surface to FILE: parameters with uncertainties, and what is left.

    With --identify: the errors of the machine, or of the tool setting, that explain the map;
    'metrosep identify MACHINE FILE' is that call.
    """
    if identify is not None:
        given = {"fix": fix, "start": start, "robust": robust, "residual": residual}
        _refuse_beside_identify(
            given, identify, free=free, terms=terms, curves=curves, radius=radius
        )
        own = {"free": free, "terms": terms, "curves": curves, "radius": radius, "centre": centre}
        return _identify(context, file, identify, form_text, own, out, reading, as_json)
    for name, value in (("terms", terms), ("curves", curves), ("radius", radius), ("out", out)):
        if value is not None:
            raise click.UsageError(f"--{name} goes with --identify MACHINE")
    from metrosep.io.write import write
    from metrosep.recipe.pipeline import run_step
    from metrosep.recipe.pipeline_checks import StepError

    step = {
        "form": form_text,
        "free": None if free is None else list(_names(free)),
        "fix": _pairs(fix, "--fix") or None,
        "start": _pairs(start, "--start") or None,
        "robust": robust,
        "tilt": tilt,
        "direction": direction,
        "centre": None if centre is None else [c.strip() for c in centre.split(",")],
    }
    phase(f"reading {file}")
    obj = read_aloud(file, reading)
    phase(f"fitting {form_text.partition(':')[0]} to {Path(file).name}")
    try:
        given = {k: v for k, v in step.items() if v is not None}
        stage = run_step(obj, {"op": "form", **given})
    except StepError as error:
        text = str(error).removeprefix(f"{error.key}: ")
        raise click.UsageError(f"--{error.key}: {text}") from None
    if residual is not None:
        write(stage.obj, residual)
        say(f"residual -> {residual}")
    fit = stage.detail  # none of a map without scale: its parameters would be per pixel
    facts = stage.audit if fit is None else fit.to_dict()
    rms, pv = facts["rms_m"], facts["pv_m"]
    if as_json:
        content = {"file": Path(file).name, **facts, "rms_nm": rms * 1e9, "pv_nm": pv * 1e9}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    else:
        over = f"{facts['form']} fitted to {facts['n_points']} points"
        left = f"residual RMS {format_length(rms)}, P-V {format_length(pv)}"
        click.echo("\n".join((over, left, *stage.messages)) if fit is None else fit.report())
        if residual is not None:
            say_next("path", "IN.nc", "--error", residual, "-o", "OUT.nc")
    return 0


def _refuse_beside_identify(
    given: dict[str, Any],
    machine: str,
    *,
    free: str | None,
    terms: str | None,
    curves: str | None,
    radius: str | None,
) -> None:
    for name, value in given.items():
        if value:
            raise click.UsageError(f"--{name} does not go with --identify")
    of_machines = {"terms": terms, "curves": curves, "radius": radius}
    wrong = of_machines if machine == "tool" else {"free": free}
    for name, value in wrong.items():
        if value is not None:
            raise click.UsageError(f"--{name} does not go with --identify {machine}")


def _identify(
    context: click.Context,
    file: str,
    machine: str,
    form_text: str,
    own: dict[str, str | None],
    out: str | None,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    from metrosep.cli.modelling import identified

    centre = own["centre"]
    options: dict[str, Any] = {
        "reading": reading,
        "free": list(_names(own["free"])) or None,
        "terms": list(_names(own["terms"])) or None,
        "curves": None if own["curves"] is None else _orders(own["curves"]),
        "radius": own["radius"],
        "centre": None if centre is None else [c.strip() for c in centre.split(",")],
    }
    return identified(context, file, machine, form_text, options=options, out=out, as_json=as_json)


def _orders(text: str) -> dict[str, int | str]:
    """Return terms and orders that were typed."""
    found: dict[str, int | str] = {}
    for name, order in name_values(tuple(text.split(",")), "--curves"):
        if order.strip().lower() == "auto":
            found[name.strip()] = "auto"
            continue
        if not order.strip().isdecimal():
            raise click.UsageError(
                f"--curves {name}={order}: a whole number of orders is needed, or auto"
            )
        found[name.strip()] = int(order)
    return found


# ---- command verify-softgauge: our parameters against those that a software gauge expects ------

_CODES = {"verified": 0, "differs": 1, "not verified": 3}


@click.command("verify-softgauge")
@click.argument("file")
@click.option("--lambda-c", metavar="LENGTH", help="Cut-off, where the file names none.")
@click.option(
    "--kind",
    type=click.Choice(["P", "W", "R"]),
    default="P",
    show_default=True,
    help="Kind of the profile in the file; R: it is filtered already.",
)
@click.option(
    "--edition",
    default="ISO 4287:1997",
    show_default=True,
    help='Standard of the parameters, such as "ISO 21920-2:2021".',
)
@click.option("--sections", type=int, help="Sampling lengths; as many as fit if omitted.")
@click.option("--centre", is_flag=True, help="Subtract the mean of each section.")
@click.option(
    "--line",
    type=click.Choice(["lsq", "secant"]),
    default="lsq",
    show_default=True,
    help="Core line of the Rk family.",
)
@click.option(
    "--expect",
    multiple=True,
    metavar="SYMBOL=VALUE",
    help='Published value, "Sa=0.4213 um": of a map (SDF), or in place of those of the file.',
)
@click.option(
    "--relative-tolerance",
    default=0.0,
    show_default=True,
    help="Tolerance beside the digits of the gauge, as a share of the value.",
)
@file_options
@json_option
def verify_softgauge(
    file: str,
    lambda_c: str | None,
    kind: Any,
    edition: str,
    sections: int | None,
    centre: bool,
    line: str,
    expect: tuple[str, ...],
    relative_tolerance: float,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Compare our parameters with those that a software gauge FILE (ISO 5436-2 .smd, or a map) expects.

    The exit code is 0 when all agree, 1 when one does not, 3 when nothing is proved: a value was
    not compared, or heights are missing. A wrong checksum is reported with the result.
    """
    from pathlib import Path

    from metrosep.core.errors import InvalidSamplesError
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.core.units import parse_quantity
    from metrosep.parameters.softgauge import verify_softgauge as compare

    cutoff = (
        None if lambda_c is None else parse_quantity(lambda_c, dimension="length", name="lambda_c")
    )
    profile = read_aloud(file, reading)
    if not isinstance(profile, Profile | Surface):
        raise InvalidSamplesError(
            f"{file}: a software gauge is a profile or a map, this is {type(profile).__name__}"
        )
    found = compare(
        profile,
        expected=_pairs(expect, "--expect") if expect else None,
        lambda_c=cutoff,
        kind=kind,
        edition=edition,
        sections=sections,
        centre=centre,
        line=line,
        relative_tolerance=relative_tolerance,
    )
    if as_json:
        content = {"file": Path(file).name, **found.to_dict()}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    else:
        for row in found:
            click.echo(_gauge_line(row))
        click.echo(f"result {found.result}, {found.n_agree} of {len(found)} agree")
        for reason in found.reasons:
            click.echo(f"  {reason}")
    return _CODES[found.result]


def _gauge_line(row: Any) -> str:
    from metrosep.core.units import format_engineering

    head = f"{row.expected.symbol:<6} expected {row.expected.printed:<16}"
    if row.agrees is None:
        return f"{head} not compared: {row.reason}"
    computed = format_engineering(row.computed, row.unit, digits=7)
    off = format_engineering(row.deviation, row.unit, digits=3)
    allowed = format_engineering(row.tolerance, row.unit, digits=3)
    word = "agrees" if row.agrees else "DIFFERS"
    return f"{head} computed {computed:<14} off by {off} (allowed {allowed})  {word}"
