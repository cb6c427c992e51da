"""``metrosep separate --method NAME`` for the separations of `metrosep.recipe.methods`, and ``ops``."""

from __future__ import annotations

import difflib
import json
import math
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option, name_values, say
from metrosep.cli.shortcut import quoted

if TYPE_CHECKING:
    from metrosep.recipe.methods import Method
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.result import Result
    from metrosep.recipe.schema import Field

__all__ = ["named_recipe", "ops", "print_named", "require_columns"]

_WIDTH = 100
_OF_INPUT = (
    "readings", "x", "angle", "repeat", "scale", "separator", "decimal", "encoding",
    "unit", "channel", "lateral_step",
)  # fmt: skip
_OF_RUNS = (
    "z", "feed", "run", "direction", "time", "sampling_rate", "start", "length", "shortest", "lag",
    "min_feeds", "poly", "table_", "drift", "lines", "robust",
)  # fmt: skip


@click.command()
@click.argument("name", required=False)
@json_option
def ops(name: str | None, as_json: bool) -> int:
    """List the steps of recipes, with the readings and the keys of each; or explain NAME."""
    from metrosep.recipe.methods import METHODS
    from metrosep.recipe.steps import STEPS, WHAT

    rows: list[dict[str, Any]] = [
        {
            "op": name,
            "what": WHAT[name],
            "reads": "runs",
            "readings": [],
            "columns": {},
            "keys": {k: f.kind for k, f in fields.items() if k != "op"},
        }
        for name, fields in STEPS.items()
    ] + [
        {
            "op": name,
            "what": method.what,
            "reads": method.reads,
            "readings": list(method.names),
            "columns": dict(method.roles),
            "keys": {k: f.kind for k, f in method.fields.items() if k != "op"},
        }
        for name, method in METHODS.items()
    ]
    if name is not None:
        rows = [row for row in rows if row["op"] == name]
        if not rows:
            near = difflib.get_close_matches(name, [*STEPS, *METHODS], n=1)
            hint = f" Did you mean {near[0]}?" if near else ""
            raise click.UsageError(f"there is no step {name!r}; 'metrosep ops' lists them.{hint}")
    if as_json:
        click.echo(json.dumps(rows, sort_keys=True))
        return 0
    if name is not None:
        _explain(rows[0], METHODS[name].fields if name in METHODS else STEPS[name])
        return 0
    for row in rows:
        click.echo(f"{row['op']}: {row['what']}")
        click.echo(f"    reads {_read_by(row)}")
        keys = ", ".join(row["keys"])
        if keys:
            click.echo(
                textwrap.fill(
                    f"keys {keys}", _WIDTH, initial_indent="    ", subsequent_indent="         "
                )
            )
    return 0


def _explain(row: Mapping[str, Any], fields: Mapping[str, Field]) -> None:
    """Print one step with a line for each of its keys."""
    click.echo(f"{row['op']}: {row['what']}")
    click.echo(f"    reads {_read_by(row)}")
    for key, field in fields.items():
        if key == "op":
            continue
        text = f"    {key}: {_KIND_WORDS.get(field.kind, field.kind)}"
        if field.choices:
            text += f", one of {', '.join(str(c) for c in field.choices)}"
        click.echo(text + (", needed" if field.required else ""))


_KIND_WORDS = {
    "size": 'a length above zero with its unit, "25 mm"',
    "length": 'a length with its unit, "-5 mm"',
    "uncertainty": 'a length from zero with its unit, "2 nm"',
    "angle": 'an angle with its unit, "0.1 deg"',
    "angles": 'angles with their units, "0 deg, 45 deg"',
    "lengths": 'lengths with their units, "0 mm, 10 mm"',
    "time": 'a time with its unit, "2 ms"',
    "speed": 'a feedrate with its unit, "4800 mm/min"',
    "frequency": 'a frequency with its unit, "1 kHz"',
    "integer": "a whole number",
    "number": "a number",
    "flag": "true or false",
    "limit": "a length or an angle with its unit, or a plain number",
}


def _read_by(row: Mapping[str, Any]) -> str:
    """Return what a step reads: kind, names of the readings, columns by role."""
    text = str(row["reads"])
    if row["readings"]:
        text += f" ({', '.join(row['readings'])})"
    needed = [k for k, kind in row["columns"].items() if "?" not in kind]
    free = [k for k, kind in row["columns"].items() if "?" in kind]
    if needed:
        text += f"; columns {', '.join(needed)}"
    if free:
        text += f"; where there are {', '.join(free)}"
    return text


def require_columns(options: Mapping[str, Any]) -> None:
    """Refuse a call for repeated runs without their columns.

    Parameters
    ----------
    options : mapping
        Of the command ``separate``.

    Raises
    ------
    UsageError
        If the method does not exist, ``--x`` or ``--z`` is missing, or an option is one of the
        named separations.
    """
    from metrosep.recipe.methods import METHODS

    known = ["joint", "kono", "mean", *METHODS]
    if options["method"] not in known:
        near = difflib.get_close_matches(str(options["method"]), known, n=1)
        hint = f" Did you mean {near[0]}?" if near else ""
        raise click.UsageError(
            f"--method {options['method']!r} is not one of joint, kono, mean, or the named "
            f"separations that 'metrosep ops' lists.{hint}"
        )
    for name in ("x", "z"):
        if options.get(name) is None:
            raise click.UsageError(f"Missing option '--{name}'.")
    for name in ("readings", "angle", "repeat"):
        if options.get(name):
            raise click.UsageError(
                f"--{name} belongs to a named separation, such as --method donaldson; runs have "
                "--x, --z and --run"
            )
    for name, option in (("settings", "--set"), ("columns", "--column")):
        if options.get(name):
            raise click.UsageError(
                f"{option} belongs to a named separation; runs have options of their own"
            )


def named_recipe(name: str, options: Mapping[str, Any], *, report: bool) -> str:
    """Return the recipe of a call with a named separation, as TOML.

    Parameters
    ----------
    name : str
        Of the method.
    options : mapping
        Of the command ``separate``.
    report : bool
        Whether parts and report are to be written.

    Returns
    -------
    str
        TOML that `Recipe.parse` reads.

    Raises
    ------
    UsageError
        If an option is one of repeated runs, or a ``--set`` is of the wrong kind.
    """
    from metrosep.recipe.methods import METHODS, input_fields

    method = METHODS[name]
    known = input_fields(method)
    for key in _OF_RUNS:
        if options.get(key) is not None and key not in known:
            option = key.rstrip("_").replace("_", "-")
            raise click.UsageError(
                f"--{option} belongs to repeated runs; --method {name} takes {_takes(method)}"
            )
    for key in _OF_INPUT:
        if options.get(key) and key not in known:
            raise click.UsageError(
                f"--{key.replace('_', '-')} is not read by --method {name}; it takes {_takes(method)}"
            )
    columns = dict(name_values(options.get("columns") or (), "--column"))
    lines = ["metrosep = 1", "", "[input]"]
    for key in [*known, *(k for k in columns if k not in known)]:
        value = columns.get(key, options.get(key))
        if value is not None and value != ():
            several = key in known and known[key].kind == "texts"
            lines.append(f"{key} = {_listed(value) if several else quoted(value)}")
    lines += ["", "[[step]]", f"op = {quoted(name)}"]
    for key, value in name_values(options.get("settings") or (), "--set"):
        lines.append(f"{key} = {_typed(key, value, method)}")
    if report:
        lines += ["", "[[output]]", 'kind = "parts"']
        lines += ["", "[[output]]", 'kind = "report"', 'formats = ["html"]']
    return "\n".join(lines) + "\n"


def print_named(recipe: Recipe, result: Result, *, as_json: bool) -> None:
    """Print what a named separation found.

    Parameters
    ----------
    recipe : Recipe
        That was carried out.
    result : Result
        Of it.
    as_json : bool
        Whether as JSON on standard output.
    """
    document = result.document
    if as_json:
        kept = ("characteristics", "messages", "inputs", "verdict")
        separation = {k: v for k, v in document["separation"].items() if k in _SUMMARY}
        summary = {k: document[k] for k in kept} | {"separation": separation}
        summary["files"] = [str(f) for f in result.files]
        click.echo(json.dumps(summary, sort_keys=True, allow_nan=False))
        return
    if document["separation"].get("parts") is None:
        for entry in document["characteristics"]:
            say(_value(entry))
    else:
        say(repr(result.produced))
    for feed, runs in document["separation"].get("runs") or []:
        say(f"next: {runs} run(s) at {feed:.6g} mm/min")
    for item in getattr(result.produced, "null_space", ()):
        say(f"not seen: {item}")
    for message in document["messages"]:
        say(f"note: {message}")
    if result.verdict is not None:
        say(f"verdict: {result.verdict}")
    labels = {".json": "result", ".html": "report"}
    for file in result.files:
        say(f"{labels.get(file.suffix, 'parts'):8} {file}")


def _takes(method: Method) -> str:
    """Return the options of a method, for the message on one that it does not have."""
    if method.reads == "curves":
        place = {"x": "--x", "angle": "--angle"}.get(method.over, "--x or --angle")
        return f"--readings, {place}, --repeat, --column and --set"
    roles = ", ".join(method.roles)
    return f"--column ({roles}) and --set" if roles else "--set"


def _value(entry: Mapping[str, Any]) -> str:
    from metrosep.core.quantity import Quantity

    value = math.nan if entry["value"] is None else entry["value"]
    q = Quantity(value, entry["unit"], entry["definition"], u=entry["u"])
    return f"{entry['metric']}: {q}"


_SUMMARY = ("op", "what", "method", "null_space", "noise", "audit", "units", "runs", "result")


def _typed(key: str, value: str, method: Method) -> str:
    """Return a value as TOML writes it, after the kind of its key."""
    field: Field | None = method.fields.get(key)
    kind = "text" if field is None else field.kind
    if kind in ("number", "integer", "flag"):
        return _plain(key, value)
    if kind == "frequencies" and value == "auto":
        return quoted(value)
    if kind == "waves" and value.isdecimal():
        return value
    if kind in ("numbers", "integers"):
        return "[" + ", ".join(_plain(key, v.strip()) for v in value.split(",")) + "]"
    if kind in ("windows", "places", "pairs"):
        return _nested(value, numbers=kind == "pairs")
    if kind in _LISTS:
        return _listed(value)
    return quoted(value)


def _plain(key: str, value: str) -> str:
    """Return a number or true or false as it is; refuse what TOML does not know as one."""
    import tomllib

    try:
        tomllib.loads(f"v = {value}")
    except tomllib.TOMLDecodeError:
        raise click.UsageError(
            f"--set {key}: a number, true or false is needed, found {value!r}"
        ) from None
    return value


_LISTS = ("angles", "lengths", "texts", "times", "speeds", "frequencies", "waves", "range")


def _nested(value: str, *, numbers: bool) -> str:
    """Return ``a..b, c..d`` as pairs, and a plain list as it is."""
    items = [item.strip() for item in value.split(",")]
    if not any(".." in item for item in items):
        return f"[{value}]" if numbers else _listed(value)
    pairs = []
    for item in items:
        pair = [p.strip() for p in item.split("..")]
        pairs.append("[" + ", ".join(p if numbers else quoted(p) for p in pair) + "]")
    return "[" + ", ".join(pairs) + "]"


def _listed(columns: str) -> str:
    return "[" + ", ".join(quoted(c.strip()) for c in columns.split(",")) + "]"
