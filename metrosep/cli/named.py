"""``metrosep separate --method NAME`` for the separations of `metrosep.recipe.methods`, and ``ops``."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option, name_values, say

if TYPE_CHECKING:
    from metrosep.recipe.methods import Method
    from metrosep.recipe.recipe import Recipe
    from metrosep.recipe.result import Result
    from metrosep.recipe.schema import Field

__all__ = ["named_recipe", "ops", "print_named", "require_columns"]

_OF_RUNS = (
    "z", "feed", "run", "direction", "time", "sampling_rate", "start", "length", "shortest", "lag",
    "min_feeds", "poly", "table_",
)  # fmt: skip
_CURVE_INPUT = ("readings", "x", "angle", "repeat", "scale", "separator", "decimal", "encoding")
_MAP_INPUT = ("unit", "channel", "lateral_step")


@click.command()
@json_option
def ops(as_json: bool) -> int:
    """List the steps of recipes, with the readings and the keys of each."""
    from metrosep.recipe.methods import METHODS
    from metrosep.recipe.steps import STEPS

    rows: list[dict[str, Any]] = [
        {
            "op": name,
            "what": "error of an axis from repeated runs (joint, kono, mean)"
            if name == "separate"
            else "polynomial of the error or the compensation over position",
            "reads": "runs",
            "readings": [],
            "keys": {k: f.kind for k, f in fields.items() if k != "op"},
        }
        for name, fields in STEPS.items()
    ] + [
        {
            "op": name,
            "what": method.what,
            "reads": method.reads,
            "readings": list(method.names),
            "keys": {k: f.kind for k, f in method.fields.items() if k != "op"},
        }
        for name, method in METHODS.items()
    ]
    if as_json:
        click.echo(json.dumps(rows, sort_keys=True))
        return 0
    for row in rows:
        readings = f" ({', '.join(row['readings'])})" if row["readings"] else ""
        click.echo(f"{row['op']}: {row['what']}")
        click.echo(f"    reads {row['reads']}{readings}; keys {', '.join(row['keys']) or 'none'}")
    return 0


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
    if options.get("settings"):
        raise click.UsageError(
            "--set belongs to a named separation; runs have options of their own"
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
    from metrosep.recipe.methods import METHODS

    method = METHODS[name]
    for key in _OF_RUNS:
        if options.get(key) is not None:
            option = key.rstrip("_").replace("_", "-")
            raise click.UsageError(
                f"--{option} belongs to repeated runs; --method {name} takes "
                + (
                    "--readings, --x or --angle, --repeat and --set"
                    if method.reads == "curves"
                    else "--set"
                )
            )
    keys = _CURVE_INPUT if method.reads == "curves" else _MAP_INPUT
    lines = ["metrosep = 1", "", "[input]"]
    for key in keys:
        value = options.get(key)
        if value is not None and value != ():
            lines.append(f"{key} = {_listed(value) if key == 'readings' else _quoted(value)}")
    lines += ["", "[[step]]", f"op = {_quoted(name)}"]
    for key, value in name_values(options.get("settings") or (), "--set"):
        lines.append(f"{key} = {_typed(key, value, method)}")
    if report:
        suffix = "csv" if method.reads == "curves" else "h5"
        lines += ["", "[[output]]", 'kind = "parts"', f'path = "parts.{suffix}"']
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
    say(repr(result.produced))
    for item in getattr(result.produced, "null_space", ()):
        say(f"not seen: {item}")
    for message in document["messages"]:
        say(f"note: {message}")
    if result.verdict is not None:
        say(f"verdict: {result.verdict}")
    labels = {".json": "result", ".html": "report"}
    for file in result.files:
        say(f"{labels.get(file.suffix, 'parts'):8} {file}")


_SUMMARY = ("op", "what", "method", "null_space", "noise", "audit", "units")


def _typed(key: str, value: str, method: Method) -> str:
    """Return a value as TOML writes it, after the kind of its key."""
    field: Field | None = method.fields.get(key)
    kind = "text" if field is None else field.kind
    if kind in ("number", "integer", "flag"):
        return value
    if kind in ("angles", "lengths", "texts"):
        return "[" + ", ".join(_quoted(v.strip()) for v in value.split(",")) + "]"
    if kind == "numbers":
        return f"[{value}]"
    return _quoted(value)


def _listed(columns: str) -> str:
    return "[" + ", ".join(_quoted(c.strip()) for c in columns.split(",")) + "]"


def _quoted(value: object) -> str:
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
