"""Commands about files: info, check, convert, formats."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import file_options, json_option, override_option, phase, read_aloud, say

if TYPE_CHECKING:
    from metrosep.controllers.base import Dialect
    from metrosep.controllers.options import Option
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.schema import Field, Place


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@file_options
@json_option
def info(
    files: tuple[str, ...],
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Describe FILE: format, shape, steps, heights, gaps, hash."""
    from metrosep.cli.errors import exit_code_of, flags_of, report_error
    from metrosep.core.errors import MetrosepError
    from metrosep.io.check import describe

    results: list[dict[str, Any]] = []
    code = 0
    for name in files:
        try:
            results.append(describe(name, **reading))
        except MetrosepError as exc:
            if len(files) == 1:
                raise
            report_error(exc, verbosity=0, names=flags_of(info))
            code = max(code, exit_code_of(exc))
            continue
        if not as_json:
            _print_description(name, results[-1])
    if as_json:
        content = results[0] if len(files) == 1 else {"files": results}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    return code


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@file_options
@click.option("--explain", is_flag=True, help="Print the default of each key of a recipe.")
@override_option
@json_option
def check(
    files: tuple[str, ...],
    reading: dict[str, Any],
    explain: bool,
    overrides: tuple[str, ...],
    as_json: bool,
) -> int:
    """Check FILE and suggest a fix for each problem.

    The exit code is 0 without errors (there may be warnings), 1 with errors, 4 when a file cannot
    be read. Of recipes (.toml) every mistake that shows without data is reported, with its line; the exit
    code is 0, or 2 with mistakes.
    """
    if are_recipes(files):
        return check_recipes(files, as_json=as_json, explain=explain, overrides=overrides)
    if explain or overrides:
        option = "--explain" if explain else "-s"
        raise click.UsageError(f"{option} is for recipes (.toml); leave it out for data")
    from metrosep.cli.errors import as_options, flags_of
    from metrosep.io.check import check_file

    found = {name: check_file(name, **reading) for name in files}
    if as_json:
        items = [{"file": n, "findings": [f.to_dict() for f in fs]} for n, fs in found.items()]
        content = items[0] if len(items) == 1 else {"files": items}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    for name, findings in found.items():
        if not as_json:
            click.echo(
                f"{name}: {'no problem found' if not findings else ''}".rstrip(": ")
                + ":" * bool(findings)
            )
        for finding in () if as_json else findings:
            fix = as_options(finding.fix, flags_of(check))
            click.echo(
                f"  {finding.level:8} {as_options(finding.problem, flags_of(check))}\n{'':11}{fix}"
            )
    every = [f for fs in found.values() for f in fs]
    if any(f.level == "error" and f.unreadable for f in every):
        return 4
    return int(any(f.level == "error" for f in every))


def _print_description(name: str, found: dict[str, Any]) -> None:
    from metrosep.cli.errors import as_options, flags_of
    from metrosep.core.units import PIXEL, format_length

    click.echo(f"{name}")
    shape = " x ".join(str(n) for n in found["shape"])
    click.echo(f"  format    {found['format']}, {found['kind']}, {shape}")
    if found["kind"] in ("surface", "profile"):
        steps = [found["dx_m"]] + ([found["dy_m"]] if found["kind"] == "surface" else [])
        missing = "not calibrated" if found["kind"] == "surface" else "not uniform"
        if found["metadata"].get("lateral_unit") == PIXEL:
            missing = "not calibrated, x counts pixels"
        texts = [missing if s is None else format_length(s, digits=7) for s in steps]
        click.echo(f"  step      {', '.join(texts)}")
        pv, sq = (format_length(found[k] * 1e-9, digits=7) for k in ("pv_nm", "sq_nm"))
        click.echo(f"  heights   P-V {pv}, Sq {sq} about the mean, nothing removed")
        click.echo(f"  invalid   {found['n_invalid']}")
    if found["kind"] == "runs":
        feeds = ", ".join(f"{v * 6e4:.6g} mm/min" for v in found["metadata"]["feeds_m_s"])
        click.echo(f"  feeds     {feeds or 'not known'}")
    if found["kind"] == "recording":
        for name, unit in found["channels"].items():
            click.echo(f"  channel   {name}" + (f" [{unit}]" if unit else ""))
        click.echo(
            f"  time      {found['duration_s']:.6g} s, usual step {found['time_step_s']:.6g} s"
        )
    columns = found["metadata"].get("columns")
    if columns and found["kind"] == "table":
        from metrosep.io.text.matrices import shown_columns

        click.echo(f"  columns   {shown_columns(tuple(_column_text(c) for c in columns))}")
        click.echo(f"  no object {as_options(found['reason'], flags_of(info))}")
    for warning in found["metadata"].get("warnings") or ():
        click.echo(f"  warning   {as_options(warning, flags_of(info))}")
    click.echo(f"  sha256    {found['sha256']}")


def _column_text(column: Any) -> str:
    if isinstance(column, dict):
        unit = column.get("unit")
        return f"{column.get('name')}" + (f" [{unit}]" if unit else "")
    return str(column)


@click.command()
@click.argument("source", metavar="SRC")
@click.argument("target", metavar="DST")
@click.option("--format", "target_format", help="Format of DST. Default: that of its suffix.")
@file_options
@click.option("--force", is_flag=True, help="Replace DST if it exists.")
def convert(
    source: str,
    target: str,
    target_format: str | None,
    reading: dict[str, Any],
    force: bool,
) -> int:
    """Read SRC and write it as DST (csv, h5, int, pro, sdf, smd, sur, x3p, xyz)."""
    from pathlib import Path

    from metrosep.core.errors import WriteError
    from metrosep.io.write import WITHOUT_HISTORY, write

    if Path(target).exists() and not force:
        raise WriteError(f"{target}: exists already; choose another name or give --force")
    phase(f"reading {source}")
    obj = read_aloud(source, reading, runs=True)
    phase(f"writing {target}")
    write(obj, target, format=target_format)
    say(f"{obj!r} -> {target}")
    name = (target_format or Path(target).suffix.lstrip(".")).lower()
    if name in WITHOUT_HISTORY and any(s.name != "read" for s in obj.history):
        say(f"{name} holds no history: {target} does not tell what was removed or filtered before")
    if name == "int":
        say(
            "Code V INT holds 16 bits and neither steps nor the mean height; both stand in its comments"
        )
    return 0


@click.command()
@json_option
def formats(as_json: bool) -> int:
    """List the file formats and how each was verified."""
    from metrosep.io.registry import formats as known

    rows = [
        {
            "id": f.id,
            "title": f.title,
            "kind": f.kind,
            "suffixes": list(f.suffixes),
            "reads": f.reads,
            "writes": f.writes,
            "status": f.status,
        }
        for f in known()
    ]
    if as_json:
        click.echo(json.dumps({"formats": rows}, sort_keys=True))
        return 0
    for row in rows:
        does = "/".join(w for w, yes in (("read", row["reads"]), ("write", row["writes"])) if yes)
        click.echo(f"{row['id']:16} {row['kind']:22} {does:11} {row['status']:24} {row['title']}")
    return 0


# ---- ``metrosep check RECIPE``: every mistake of a recipe that shows without reading data ------


def are_recipes(files: Sequence[str]) -> bool:
    """Return whether `check` is given recipes, and not data.

    Examples
    --------
    >>> are_recipes(["ring.toml"]), are_recipes(["ring.x3p"])
    (True, False)
    """
    return bool(files) and all(Path(f).suffix.lower() == ".toml" for f in files)


def check_recipes(
    files: Sequence[str], *, as_json: bool, explain: bool, overrides: Sequence[str] = ()
) -> int:
    """Print what is wrong in recipes."""
    from metrosep.recipe.preflight import guard_notes

    found = {name: _checked(name, overrides) for name in files}
    warned = {name: list(guard_notes(r)) if r else [] for name, (r, _) in found.items()}
    if as_json:
        items = [
            {
                "file": n,
                "errors": errors,
                "warnings": warned[n],
                **({"defaults": _defaults(r)} if explain and r else {}),
            }
            for n, (r, errors) in found.items()
        ]
        content = items[0] if len(items) == 1 else {"files": items}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    for name, (recipe, errors) in {} if as_json else found.items():
        for error in errors:
            click.echo(f"error: {error}")
        for warning in warned[name]:
            click.echo(f"warning: {warning}")
        if not errors and not warned[name]:
            click.echo(f"{name}: nothing wrong")
        if explain and recipe is not None:
            for line in _explained(recipe):
                click.echo(line)
    return 2 if any(errors for _, errors in found.values()) else 0


def _checked(name: str, overrides: Sequence[str]) -> tuple[Recipe | None, list[str]]:
    """Return the recipe, if it can be had, and what is wrong."""
    from metrosep.core.atomic import RECIPE_BYTES, read_plain_text
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.written.overrides import with_overrides

    target = Path(name)
    try:
        text = read_plain_text(target, RECIPE_BYTES)
    except OSError as exc:
        reason = exc.strerror or exc
        return None, [f"{name}: the recipe cannot be read ({reason})"]
    folder = target.resolve().parent
    errors = []
    try:
        text = with_overrides(text, target.name, folder, overrides) if overrides else text
    except RecipeError as exc:
        errors.append(str(exc))
    errors += [e for e in recipe_errors(text, name=target.name, folder=folder) if e not in errors]
    try:
        return Recipe.parse(text, name=target.name, folder=folder), errors
    except RecipeError:
        return None, errors


def recipe_errors(text: str, *, name: str, folder: Path) -> list[str]:
    """Return every mistake in the text of a recipe that shows without data.

    Notes
    -----
    Each key is checked by itself: unknown, missing, of the wrong kind or unit. What the parts make
    together is checked only when each is right, and tells its first mistake.

    Examples
    --------
    >>> text = '''metrosep = 1
    ... [input]
    ... [[step]]
    ... op = "form"
    ... fom = "plane"
    ... '''
    >>> for error in recipe_errors(text, name="r.toml", folder=Path(".")):
    ...     print(error[:36])
    r.toml:5: unknown key "fom" in [[ste
    r.toml:3: [[step]] 1 (form) needs th
    """
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.preflight import limit_errors
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.written.extends import layers_of

    try:
        layers = layers_of(text, name, folder)
    except RecipeError as exc:
        return [str(exc)]
    errors = list(dict.fromkeys(str(e) for e in _of_tables(layers, name)))
    try:
        recipe = Recipe.parse(text, name=name, folder=folder)
    except RecipeError as exc:
        return errors or [str(exc)]
    return errors + [str(e) for e in (*limit_errors(recipe), *_of_plugins(recipe))]


def _of_tables(layers: Any, name: str) -> Iterator[Exception]:
    """Yield the mistakes of each table, key by key."""
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.map_sections import SECTIONS
    from metrosep.recipe.schema import batch_table
    from metrosep.recipe.steps import (
        ALL_STEPS,
        CHECK,
        METHOD_CHECK,
        METHOD_OUTPUTS,
        OUTPUTS,
        TOP,
    )
    from metrosep.recipe.written.extends import LayeredPlace
    from metrosep.recipe.written.overrides import input_fields_of

    def place(header: str = "", number: int = 0) -> Place:
        return LayeredPlace(name, layers.text, header, number, layers.bases)

    data = layers.data
    yield from _of_table(data, TOP, place(), "the recipe")
    ops = ALL_STEPS
    first = next((s.get("op") for s in _tables(data, "step")), None)
    fields = input_fields_of(first)
    if fields is not None and isinstance(data.get("input"), Mapping):
        yield from _of_table(data["input"], fields, place("[input]"), "[input]")
    plain = first in ("separate", "polynomial", "plan_feedrates")
    outputs = OUTPUTS if plain else METHOD_OUTPUTS
    for key, kinds, selector in (
        ("step", ops, "op"),
        ("section", SECTIONS, "kind"),
        ("check", {"": CHECK if plain else METHOD_CHECK}, ""),
        ("output", outputs, "kind"),
    ):
        if key in ("check", "output") and fields is None:
            continue  # which keys there are depends on the steps
        for number, item in enumerate(_tables(data, key)):
            where = place(f"[[{key}]]", number)
            yield from _of_item(item, kinds, selector, where, f"[[{key}]] {number + 1}")
    if isinstance(data.get("batch"), Mapping):
        try:
            batch_table(data["batch"], place("[batch]"))
        except RecipeError as exc:
            yield exc


def _tables(data: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    found = data.get(key, [])
    return [t for t in found if isinstance(t, Mapping)] if isinstance(found, list) else []


def _of_item(
    item: Mapping[str, Any],
    kinds: Mapping[str, Mapping[str, Field]],
    selector: str,
    place: Place,
    what: str,
) -> Iterator[Exception]:
    from metrosep.core.errors import DataError
    from metrosep.core.readable import did_you_mean
    from metrosep.recipe.pipeline import MEASURING, checked_step
    from metrosep.recipe.schema import checked_table

    kind = item.get(selector, "") if selector else ""
    if not isinstance(kind, str) or kind not in kinds:
        hint = did_you_mean(kind, kinds)
        known = ", ".join(f'"{k}"' for k in kinds)
        yield place.error(
            f"{what} needs {selector} = one of {known}, found {kind!r}.{hint}", selector
        )
        return
    title = what + (f" ({kind})" if kind else "")
    errors = list(_of_table(item, kinds[kind], place, title))
    yield from errors
    if selector == "op" and kind in MEASURING and not errors:
        try:
            checked_step(checked_table(item, kinds[kind], place, what=title))
        except DataError as exc:
            yield place.error(f"{title}: {exc}", getattr(exc, "key", None))


def _of_table(
    data: Mapping[str, Any], fields: Mapping[str, Field], place: Place, what: str
) -> Iterator[Exception]:
    """Yield what is wrong with each key of a table, and with each that is missing."""
    from dataclasses import replace

    from metrosep.core.errors import RecipeError
    from metrosep.recipe.schema import checked_table

    free = {k: replace(f, required=False) for k, f in fields.items()}
    for key, value in data.items():
        try:
            checked_table({key: value}, free, place, what=what)
        except RecipeError as exc:
            yield exc
    for key, field in fields.items():
        if field.required and key not in data:
            try:
                checked_table({}, {key: field}, place, what=what)
            except RecipeError as exc:
                yield exc


def _of_plugins(recipe: Recipe) -> Iterator[Exception]:
    """Yield the first format that nothing installed writes; reports and controllers were checked before."""
    from metrosep.batch.index import format_error

    wrong = format_error(recipe)
    if wrong is not None:
        yield wrong


def _defaults(recipe: Recipe) -> list[dict[str, Any]]:
    """Return for each step the keys that the recipe leaves out."""
    from metrosep.recipe.step_help import described_steps

    known = {s["op"]: s for s in described_steps()["steps"]}
    return [
        {
            "op": step["op"],
            "what": known[step["op"]]["what"],
            "keys": [
                {k: key[k] for k in ("name", "default", "help")}
                for key in known[step["op"]]["keys"]
                if key["name"] not in step
            ],
        }
        for step in recipe.steps
        if step["op"] in known
    ]


def _explained(recipe: Recipe) -> Iterator[str]:
    for step in _defaults(recipe):
        yield f"{step['op']}: {step['what']}; keys that are not given, and what holds:"
        for key in step["keys"]:
            value = "none" if key["default"] is None else json.dumps(key["default"])
            yield f"  {key['name']:16} {value:12} {key['help']}"


# ---- the command that lists the controllers: what an entry is, limits, status, what they need ----

_STATUS = {
    "confirmed": "sign proven",
    "documented": "sign documented",
    "stated": "sign by a machine fact that you give",
    "unconfirmed": "sign NOT documented: try it on the machine, then --sign-confirmed",
}
_SOURCE = {"table": "result.json", "polynomial": "result.json", "map": "error_map.sdf"}


@click.command()
@click.argument("name", required=False)
@json_option
def controllers(name: str | None, as_json: bool) -> int:
    """List the controllers; with NAME all about one: options, limits, activation, an example."""
    from metrosep.controllers.registry import find, names

    found = [find(n) for n in ([name] if name else names())]
    if as_json:
        text = {"controllers": [_as_dict(d) for d in found]}
        click.echo(json.dumps(text, sort_keys=True, default=str))
    elif name:
        click.echo("\n".join(_page(found[0])))
    else:
        for d in found:
            click.echo("\n".join(_summary(d)))
        click.echo("\nmetrosep controllers NAME lists options, activation and an example.")
    return 0


def _as_dict(dialect: Dialect) -> dict[str, Any]:
    info = {**asdict(dialect.info), "example": dict(dialect.info.example)}
    return {**info, "options": [asdict(o) for o in dialect.options]}


def _summary(dialect: Dialect) -> list[str]:
    d = dialect.info
    limit = "no limit of points" if d.max_points is None else f"at most {d.max_points} points"
    return [
        f"{d.id:20} {d.title}",
        f"{'':20} holds   {_holds(dialect)}; {limit}",
        f"{'':20} entry   {d.entry}",
        f"{'':20} sign    {_STATUS[d.sign]} ({d.sign_status})",
    ]


def _holds(dialect: Dialect) -> str:
    d = dialect.info
    what = {
        "table": "corrections over one axis",
        "map": "corrections over two axes",
        "polynomial": "a polynomial",
    }[d.carries]
    if d.carries == "polynomial":
        return what
    ways = "both directions" if d.directions == "two" else "one value both ways"
    return f"{what}, {d.spacing} spacing, {ways}"


def _page(dialect: Dialect) -> list[str]:
    d = dialect.info
    limit = "no limit" if d.max_points is None else str(d.max_points)
    facts = {
        "holds": _holds(dialect),
        "entry": d.entry,
        "sign": f"{_STATUS[d.sign]} ({d.sign_status})",
        "units": d.units,
        "resolution": d.resolution or "not stated",
        "points": limit,
        "outside": d.outside,
        "reference": d.reference_rule or "free",
        "proof": d.proof,
    }
    lines = [f"{d.id}: {d.title}", ""]
    lines += [f"  {name:11} {value}" for name, value in facts.items()]
    lines += ["", "options (--machine NAME=VALUE)"]
    lines += [f"  {_option(o)}" for o in dialect.options] or ["  none"]
    lines += ["", "limits that can be checked (--machine NAME=VALUE)", f"  {_limits()}"]
    lines += ["", "activation"]
    lines += [f"  {i}. {step}" for i, step in enumerate(d.activation, start=1)]
    return [*lines, "", "example", f"  {_example(dialect)}"]


def _option(option: Option) -> str:
    if option.required:
        status = "required"
    elif option.default is None:
        status = "optional"
    else:
        status = f"default {option.default}"
    kind = "/".join(map(str, option.choices)) if option.choices else option.kind
    return f"{option.name:18} {kind}, {status}: {option.help}"


def _limits() -> str:
    from metrosep.controllers.options import LIMIT_DIMENSIONS

    return ", ".join(["max_points", *LIMIT_DIMENSIONS])


def _example(dialect: Dialect) -> str:
    d = dialect.info
    words = ["metrosep", "table", _SOURCE[d.carries], "--format", d.id, "-o", f"x{d.suffix}"]
    for name, value in d.example.items():
        words += ["--machine", f'"{name}={value}"']
    if d.sign == "unconfirmed":
        words.append("--sign-confirmed")
    return " ".join(words)
