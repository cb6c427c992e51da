"""Commands that measure: measure, form; verify-softgauge has a module of its own."""

from __future__ import annotations

import json
from typing import Any

import click

from metrosep.cli.options import file_options, json_option, name_values, read_aloud, say
from metrosep.cli.softgauge import verify_softgauge
from metrosep.core.text_options import TEXT_OPTIONS

_WORST_FIRST = (4, 2, 1, 3)
"""Exit codes: a file that was not measured, then reject, then inconclusive."""

__all__ = ["form", "measure", "verify_softgauge"]


def _pairs(texts: tuple[str, ...], option: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, value in name_values(texts, option):
        if name in found:
            raise click.UsageError(f"{option} is given twice for {name}")
        found[name] = value
    return found


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(n.strip() for n in (text or "").split(",") if n.strip())


def _length(text: str | None, name: str) -> float | None:
    from metrosep.core.units import parse_quantity

    return None if text is None else parse_quantity(text, dimension="length", name=name)


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
@click.option("--lambda-s", metavar="LENGTH", help="S-filter: shorter waves go (Gaussian).")
@click.option("--lambda-c", metavar="LENGTH", help="L-filter: longer waves go (Gaussian).")
@click.option(
    "--end",
    type=click.Choice(["moment", "renormalise", "cut", "closed"]),
    default="moment",
    show_default=True,
    help="What the filters do at the ends.",
)
@click.option("--kind", type=click.Choice(["P", "W", "R"]), help="Which profile it is then.")
@click.option("--edition", help='"ISO 21920-2:2021" (default) or "ISO 4287:1997".')
@click.option(
    "--sections",
    type=click.IntRange(min=1),
    help="Section lengths; as many cut-offs as fit, else 5.",
)
@click.option("--centre", is_flag=True, help="Subtract the mean again (instruments do not).")
@click.option("--line", type=click.Choice(["lsq", "secant"]), default="lsq", show_default=True)
@click.option("--params", metavar="SYMBOLS", help="Such as Sa,Sq,PV; all that apply if omitted.")
@click.option(
    "--reference",
    type=click.Choice(["MZ", "LS", "EP", "MC", "MI"]),
    default="MZ",
    show_default=True,
    help="Of straightness (STRt), flatness (FLTt), roundness (RONt).",
)
@click.option("--upper", multiple=True, metavar="SYMBOL=VALUE", help='Limit, "Sq=5 nm".')
@click.option("--lower", multiple=True, metavar="SYMBOL=VALUE", help="Limit from below.")
@click.option("--U", "expanded", multiple=True, metavar="SYMBOL=VALUE", help="Expanded U.")
@click.option("--guard-factor", default=1.0, show_default=True, help="Guard band over U.")
@click.option(
    "-o", "--out", metavar="DIR", help="Folder for the report and result.json of one FILE."
)
@click.option("--print-recipe", is_flag=True, help="Print the recipe of this call and stop.")
@file_options
@json_option
def measure(
    files: tuple[str, ...],
    form_text: str,
    lambda_s: str | None,
    lambda_c: str | None,
    end: str,
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
    out: str | None,
    print_recipe: bool,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Remove the form, filter, and give the parameters of FILE, with a verdict where limits are set.

    The exit code is the worst of all files: 4 unreadable or 2 not to be measured so, 1 rejected,
    3 inconclusive, 0 accepted or no limit.
    """
    from pathlib import Path

    from metrosep.cli.errors import exit_code_of, report_error, verdict_code
    from metrosep.cli.evaluation import Limits, Settings, evaluate
    from metrosep.core.errors import MetrosepError

    how = Settings(
        form=form_text,
        lambda_s=_length(lambda_s, "lambda_s"),
        lambda_c=_length(lambda_c, "lambda_c"),
        end=end,
        kind=kind,
        edition=edition,
        sections=sections,
        centre=centre,
        line=line,
        names=_names(params),
        reference=reference,
    )
    limits = Limits(
        lower=_pairs(lower, "--lower"),
        upper=_pairs(upper, "--upper"),
        U=_pairs(expanded, "--U"),
        guard_factor=guard_factor,
    )
    recipe: Any = None
    if print_recipe or out is not None:
        lengths = {"lambda_s": lambda_s, "lambda_c": lambda_c}
        recipe = _recipe(files, how, limits, reading, lengths)
        if print_recipe:
            click.echo(recipe.text, nl=False)
            return 0
    results: list[dict[str, Any]] = []
    codes = []
    for name in files:
        try:
            found = evaluate(read_aloud(name, reading), how, limits)
        except MetrosepError as error:
            if len(files) == 1:
                raise
            report_error(error, verbosity=0, names={p.name for p in measure.params if p.name})
            codes.append(exit_code_of(error))
            results.append({"file": Path(name).name, "error": str(error)})
            continue
        codes.append(0 if found.verdict is None else verdict_code(found.verdict))
        results.append(_measured(name, found))
        if not as_json:
            _print_measured(name, found)
    if as_json:
        content = results[0] if len(files) == 1 else {"files": results}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    if out is not None:
        for path in recipe.run([files[0]], out=out).files:
            say(f"{'report' if path.suffix == '.html' else 'result':8} {path}")
    return next((c for c in _WORST_FIRST if c in codes), 0)


def _recipe(
    files: tuple[str, ...],
    how: Any,
    limits: Any,
    reading: dict[str, Any],
    lengths: dict[str, str | None],
) -> Any:
    """Return the recipe of this call, checked."""
    from metrosep.cli.measure_recipe import measure_recipe
    from metrosep.cli.shortcut import option_error
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe

    if len(files) != 1:
        raise click.UsageError("a recipe, a report and result.json are of one FILE: name one")
    known = ("unit", "lateral_step", "channel", "format", *TEXT_OPTIONS)
    stray = [k for k in reading if k not in known]
    if stray:
        raise click.UsageError(f"--set {stray[0]} has no key in a recipe that measures")
    text = measure_recipe(files[0], how, limits, reading, lengths)
    try:
        return Recipe.parse(text, name="command line")
    except RecipeError as error:
        raise RecipeError(option_error(error)) from None


def _measured(name: str, found: Any) -> dict[str, Any]:
    from pathlib import Path

    tables = [t.to_dict() for t in found.tables]
    parameters = {s: q for t in tables for s, q in t["parameters"].items()}
    unavailable = {s: why for t in tables for s, why in t["unavailable"].items()}
    contexts = [
        {k: v for k, v in t.items() if k not in ("parameters", "unavailable")} for t in tables
    ]
    return {
        "file": Path(name).name,
        "parameters": parameters,
        "unavailable": unavailable,
        "evaluations": contexts,
        "verdicts": found.verdicts,
        "verdict": found.verdict,
        **flat_values(found.quantities),
    }


def _print_measured(name: str, found: Any) -> None:
    click.echo(name)
    for line in found.removed.splitlines():
        click.echo(f"  form  {line}")
    for table in found.tables:
        context = table.context
        click.echo(
            f"  {context.edition}; {context.chain}; {context.n_valid} of {context.n_total} valid"
        )
        for symbol, quantity in table.items():
            verdict = found.verdicts.get(symbol)
            mark = f"   {verdict['verdict'].upper()}" if verdict else ""
            click.echo(f"    {symbol:<7} {quantity!s:<22} {quantity.definition}{mark}")
        for symbol, why in table.unavailable.items():
            click.echo(f"    {symbol:<7} not available: {why}")
        for note in context.notes:
            click.echo(f"    note: {note}")
    if found.verdict is not None:
        click.echo(f"  verdict: {found.verdict}")


@click.command()
@click.argument("file")
@click.option(
    "--form",
    "form_text",
    default="plane",
    show_default=True,
    metavar="FORM",
    help='Such as sphere, "conic: R=50 mm", "zernike: terms=36, order=fringe".',
)
@click.option("--free", metavar="NAMES", help="What may move: piston,tilt_x,tilt_y,shift_x,R ...")
@click.option("--fix", multiple=True, metavar="NAME=VALUE", help='Held: "R=50 mm".')
@click.option("--start", multiple=True, metavar="NAME=VALUE", help="Where to begin.")
@click.option("--robust", type=click.Choice(["tukey", "huber"]), help="Weigh outliers down.")
@click.option(
    "--tilt", type=click.Choice(["plane", "rotation"]), default="plane", show_default=True
)
@click.option(
    "--direction",
    type=click.Choice(["vertical", "normal"]),
    default="vertical",
    show_default=True,
    help="Of the deviation.",
)
@click.option("--centre", metavar="X,Y", help='Origin of the form in the data: "1.5 mm, 2 mm".')
@click.option("--residual", metavar="FILE", help="Write what is left: x3p, sur, h5, csv, int ...")
@click.option(
    "--identify",
    metavar="MACHINE",
    help="Errors that explain the map: of the tool setting (tool), a preset or a file of TOML.",
)
@click.option("--terms", metavar="TERMS", help="Error terms that may be at work (--identify).")
@click.option("--radius", metavar="LENGTH", help="Of the part (--identify).")
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
    radius: str | None,
    out: str | None,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Fit an ideal surface to FILE: parameters with uncertainties, and what is left.

    With --identify: the errors of the machine, or of the tool setting, that explain the map.
    """
    if identify is not None:
        given = {"fix": fix, "start": start, "robust": robust, "residual": residual}
        _refuse_beside_identify(given, identify, free=free, terms=terms, radius=radius)
        return _identify(
            context, file, identify, form_text, free, terms, radius, centre, out, reading, as_json
        )
    for name, value in (("terms", terms), ("radius", radius), ("out", out)):
        if value is not None:
            raise click.UsageError(f"--{name} goes with --identify MACHINE")
    from pathlib import Path

    from metrosep.core.errors import InvalidSamplesError
    from metrosep.core.profile import Profile
    from metrosep.core.surface import Surface
    from metrosep.forms.catalogue import form_from_text
    from metrosep.forms.fit import fit
    from metrosep.io.write import write

    ideal = form_from_text(form_text)
    obj = read_aloud(file, reading)
    if not isinstance(obj, Surface | Profile):
        raise InvalidSamplesError(
            f"{file}: a form needs a profile or a map; this is a {type(obj).__name__}"
        )
    result = fit(
        obj,
        ideal,
        free=_names(free) if free is not None else None,
        fixed=_numbers(fix, "--fix", ideal),
        start=_numbers(start, "--start", ideal),
        robust=robust,
        tilt=tilt,
        direction=direction,
        centre=_centre(centre),
    )
    if residual is not None:
        left = result.residual
        assert isinstance(left, Surface | Profile)  # noqa: S101
        write(left, residual)
        say(f"residual -> {residual}")
    if as_json:
        content = {"file": Path(file).name, **result.to_dict()}
        content.update(rms_nm=result.rms * 1e9, pv_nm=result.peak_to_valley * 1e9)
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    else:
        click.echo(result.report())
    return 0


def _refuse_beside_identify(
    given: dict[str, Any],
    machine: str,
    *,
    free: str | None,
    terms: str | None,
    radius: str | None,
) -> None:
    for name, value in given.items():
        if value:
            raise click.UsageError(f"--{name} does not go with --identify")
    wrong = {"terms": terms, "radius": radius} if machine == "tool" else {"free": free}
    for name, value in wrong.items():
        if value is not None:
            raise click.UsageError(f"--{name} does not go with --identify {machine}")


def _identify(
    context: click.Context,
    file: str,
    machine: str,
    form_text: str,
    free: str | None,
    terms: str | None,
    radius: str | None,
    centre: str | None,
    out: str | None,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    from metrosep.cli.modelling import identified

    options: dict[str, Any] = {
        "reading": reading,
        "free": list(_names(free)) or None,
        "terms": list(_names(terms)) or None,
        "radius": radius,
        "centre": None if centre is None else [c.strip() for c in centre.split(",")],
    }
    return identified(context, file, machine, form_text, options=options, out=out, as_json=as_json)


def _centre(text: str | None) -> tuple[float, float] | None:
    from metrosep.core.units import parse_quantity

    if text is None:
        return None
    parts = text.split(",")
    if len(parts) > 2:
        raise click.UsageError(f"--centre takes X,Y with units, found {text!r}")
    x, y = (*parts, "0 m")[:2]
    return (
        parse_quantity(x.strip(), dimension="length", name="centre x"),
        parse_quantity(y.strip(), dimension="length", name="centre y"),
    )


def _numbers(texts: tuple[str, ...], option: str, ideal: Any) -> dict[str, float]:
    from metrosep.forms.base import RIGID
    from metrosep.forms.catalogue import parameter_value

    units = {**RIGID, **ideal.units_of()}
    found = {}
    for name, text in _pairs(texts, option).items():
        if name not in units:
            raise click.UsageError(f"{option}: {name} is none of {', '.join(units)}")
        found[name] = parameter_value(text, units[name], name)
    return found
