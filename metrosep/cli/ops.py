"""``metrosep ops``: the steps of recipes, with what each reads, its keys and a command to copy."""

from __future__ import annotations

import json
import re
import textwrap
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.named import COLUMN_OPTIONS
from metrosep.cli.options import json_option
from metrosep.core.readable import did_you_mean

if TYPE_CHECKING:
    from metrosep.core.methods import Method
    from metrosep.recipe.schema import Field

_WIDTH = 100


@click.command()
@click.argument("name", required=False)
@json_option
def ops(name: str | None, as_json: bool) -> int:
    """List the steps of recipes, with the readings and the keys of each; or explain NAME."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.pipeline import MEASURING
    from metrosep.recipe.steps import STEPS, WHAT

    rows: list[dict[str, Any]] = [
        {
            "op": name,
            "what": WHAT[name],
            "reads": "a map or a profile" if name in MEASURING else "runs",
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
            "readings": list(method.readings),
            "columns": dict(method.roles),
            "keys": {k: f.kind for k, f in method.fields.items() if k != "op"},
        }
        for name, method in METHODS.items()
    ]
    if name is not None:
        rows = [row for row in rows if row["op"] == name]
        if not rows:
            hint = did_you_mean(name, [*STEPS, *METHODS])
            raise click.UsageError(f"there is no step {name!r}; 'metrosep ops' lists them.{hint}")
    if as_json:
        click.echo(json.dumps(rows, sort_keys=True))
        return 0
    if name is not None:
        _explain(rows[0], METHODS[name].fields if name in METHODS else STEPS[name])
        return 0
    for row in rows:
        click.echo(textwrap.fill(f"{row['op']}: {row['what']}", _WIDTH, subsequent_indent="    "))
        click.echo(_indented(f"reads {_read_by(row)}"))
        keys = ", ".join(row["keys"])
        if keys:
            click.echo(_indented(f"keys {keys}"))
    return 0


def _indented(text: str) -> str:
    return textwrap.fill(text, _WIDTH, initial_indent="    ", subsequent_indent="         ")


def _explain(row: Mapping[str, Any], fields: Mapping[str, Field]) -> None:
    """Print one step: how its data are given, a line for each key, a command to copy."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.pipeline import MEASURING
    from metrosep.recipe.step_help import key_words, kind_words

    click.echo(textwrap.fill(f"{row['op']}: {row['what']}", _WIDTH, subsequent_indent="    "))
    click.echo(_indented(f"reads {_read_by(row)}"))
    method = METHODS.get(str(row["op"]))
    if method is not None:
        click.echo("\ndata")
        for line in data_words(method):
            click.echo(_indented(line))
    if len(fields) > 1:
        click.echo(
            "\nkeys (in the step of a recipe)"
            if row["op"] in MEASURING
            else "\nkeys"
            if method is None
            else "\nkeys (--set NAME=VALUE, or in the step of a recipe)"
        )
    for key, field in fields.items():
        if key == "op":
            continue
        about = key_words(str(row["op"]), key)
        plain = about and ('"' in about or field.kind in ("text", "file", "table", "any"))
        kind = "" if plain else kind_words(field.kind)
        if field.choices:
            kind = f"one of {', '.join(str(c) for c in field.choices)}"
        text = f"    {key}: " + "; ".join(part for part in (about, kind) if part)
        text += ", needed" if field.required else ""
        click.echo(textwrap.fill(text, _WIDTH, subsequent_indent="        "))
        for name, inner in _inner_keys(str(row["op"]), key).items():
            choices = ", ".join(str(c) for c in inner.choices)
            line = f"        {name}: {inner.help}" + (f"; one of {choices}" if choices else "")
            click.echo(textwrap.fill(line, _WIDTH, subsequent_indent="            "))
    if method is not None:
        click.echo("\nexample")
        click.echo(_wrapped(example_call(str(row["op"]), method)))


def _inner_keys(op: str, key: str) -> Mapping[str, Any]:
    """Return the keys of a table in a step that measures; none of any other."""
    from metrosep.recipe.pipeline import MEASURING

    known = MEASURING[op].all_keys if op in MEASURING else {}
    return known[key].inner if key in known else {}


def _wrapped(words: Iterable[str]) -> str:
    """Return a command on lines that a shell joins again."""
    lines = [""]
    for word in (shell_text([w]) for w in words):
        if lines[-1] and len(lines[-1]) + len(word) > _WIDTH - 8:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return " \\\n".join(f"    {'' if i == 0 else '  '}{line}" for i, line in enumerate(lines))


def data_words(method: type[Method]) -> list[str]:
    """Return how files, columns and repeats of a method are given."""
    if method.reads == "nothing":
        return ["no file: the keys of the step say all"]
    if method.reads == "maps":
        names = ", ".join(method.readings)
        order = (
            f"in this order: {names}"
            if names
            else "as many as there are, in the order of the keys"
        )
        more = (
            "; further files follow them" if method.readings and "angles" in method.fields else ""
        )
        return [
            f"one file for each map, {order}{more}",
            "what was not measured is empty (NaN) in a map and stays so",
        ]
    if method.reads == "results":
        names = ", ".join(method.readings) or "as many as there are"
        return [f"result.json of 'metrosep separate -o DIR', one for each: {names}"]
    if method.verb == "geometry":
        words = [
            "points have x, y and z; traces of a roundness instrument angle, radius and height",
            "one file of all, one file for each trace (with heights), or one for each element",
        ]
        words += [f"--{k} COLUMN: {_role_words(k, kind)}" for k, kind in method.roles.items()]
        return [*words, _UNITS_OF_COLUMNS]
    lines = _curves(method) if method.reads == "curves" else _rows(method)
    lines += [
        f"--column {k}=COLUMN: {_role_words(k, kind)}"
        for k, kind in method.roles.items()
        if k not in COLUMN_OPTIONS
    ]
    lines += [
        f"--{k} {'COLUMN,COLUMN,...' if '*' in kind else 'COLUMN'}: {_role_words(k, kind)}"
        for k, kind in method.roles.items()
        if k in COLUMN_OPTIONS
    ]
    if any(k not in ("direction", "label", "run", "repeat") for k in method.roles) or (
        method.reads == "curves"
    ):
        lines.append(_UNITS_OF_COLUMNS)
    return lines


_UNITS_OF_COLUMNS = (
    'units stand in the names of the columns (m1_nm, "gap [um]") or behind: "m1:nm"'
)


def _curves(method: type[Method]) -> list[str]:
    quantity = "an angle" if method.dimension == "angle" else "a length"
    if method.readings:
        names = ", ".join(method.readings)
        first = f"--readings COLUMN,...: one column for each reading, {quantity}, in this order: {names}"
        if method.spare:
            first += f"; {method.spare} more may follow"
    else:
        order = next((k for k in _ORDERS if k in method.fields), None)
        which = f" in the order of {order}" if order else " in the order of measuring"
        first = f"--readings COLUMN,...: one column for each probe or set-up, {quantity},{which}"
    lines = [first]
    if method.over != "x":
        turn = "--angle COLUMN: the angle of each row"
        lines.append(turn + ("" if method.over == "angle" else ", for readings over a revolution"))
    if method.over != "angle":
        line = "--x COLUMN: the position of each row"
        lines.append(line + ("" if method.over == "x" else ", for readings along a line"))
    lines.append(
        "--repeat COLUMN: where there are several passes or revolutions they stand below each "
        "other, and this column numbers them (1, 1, ..., 2, 2, ...); all columns of a row belong to "
        "the same pass. No array of repeats is needed: leave it out where there is one pass"
    )
    if not method.roles:
        lines.append("or one file for each reading, with the same name of the column in each")
    return lines


_ORDERS = ("angles", "steps", "positions", "offsets", "distance", "labels", "order")
"""Keys that say where the readings of a free number were taken."""


def _rows(method: type[Method]) -> list[str]:
    if method.reads == "files" and not method.roles:
        return ["one file for each set-up, with the set-up in comment lines above its columns"]
    if method.reads == "files":
        return [
            "one file, or one for each run; columns whose names say what they are are found, others named:"
        ]
    if method.reads == "tables":
        return ["one table for each test, or one table with a column that tells them apart"]
    lines = ["one table; what each of its columns is, is named:"]
    if "direction" in method.roles and "target" in method.roles:
        lines = ["a list of a positioning test (format iso230-2) as it is, or a table with:"]
    return lines


def _role_words(name: str, kind: str) -> str:
    plain = kind.strip("*?")
    text = {"label": "a text or a number that tells rows apart", "any": "numbers"}.get(plain)
    text = text or {"position": "lengths or angles"}.get(plain, f"{plain}s")
    if "*" in kind:
        text += ", one column or several"
    return text + ("" if "?" in kind else ", needed")


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


# ---- one command for each named separation that a person can copy ------------------------------
# Where the examples lie beside the package, the command is that of the example's recipe and runs on
# its data. Elsewhere it is made from what the method reads and needs, with names of columns to replace.

_ONE_FILE = {
    "curves": "readings.csv", "table": "table.csv", "tables": "table.csv", "files": "readings.csv",
}  # fmt: skip
_UNITS = {
    "length": "um", "angle": "urad", "time": "s", "position": "um", "frequency": "hz",
}  # fmt: skip
_PLACES = ("x", "y", "target", "position")


def example_call(op: str, method: type[Method], folder: Path | None = None) -> list[str]:
    """Return the words of a command for a named separation."""
    folder = folder or Path(__file__).resolve().parents[2] / "examples"
    if method.reads == "nothing":
        return ["metrosep", "run", _recipe_of(op, folder) or "recipe.toml", "-o", "out"]
    found = _example(op, folder)
    if found is None:
        source, step, files = _made_up(method)
    else:
        recipe, step = found
        source = {**recipe["input"]}
        place = f"examples/{recipe['folder']}"
        files = [f"{place}/{f}" for f in source.pop("files")]
        kinds = {k: f.kind for k, f in method.fields.items()}
        own = folder / recipe["folder"]  # a machine may be a preset as well as a file
        step = {
            k: f"{place}/{v}" if kinds.get(k) == "file" and (own / str(v)).exists() else v
            for k, v in step.items()
        }
    direct = method.verb != "separate"  # a command with an option for each column
    words = ["metrosep", method.verb, *([op, *files] if direct else [*files, "--method", op])]
    for key, value in source.items():
        text = _typed(value)
        name = [f"--{key.replace('_', '-')}", text]
        words += name if direct or key in COLUMN_OPTIONS else ["--column", f"{key}={text}"]
    for key, value in step.items():
        words += ["--set", f"{key}={_typed(value)}"]
    return words


def shell_text(words: Iterable[str]) -> str:
    """Return words as a shell takes them, those with blanks in double quotes.

    Examples
    --------
    >>> shell_text(["--set", "radius=25 mm"])
    '--set "radius=25 mm"'
    """
    return " ".join(w if re.fullmatch(r"[\w.,=:/*+-]+", w) else f'"{w}"' for w in words)


def _example(op: str, folder: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Return the recipe of the examples with this step alone, and the keys of the step."""
    for file, text in _with_step(op, folder):
        try:
            recipe = tomllib.loads(text)
        except ValueError:
            continue
        steps = recipe.get("step")
        if not isinstance(steps, list) or len(steps) != 1 or steps[0].get("op") != op:
            continue
        if "files" in recipe.get("input", {}) and not any(map(_is_table, steps[0].values())):
            step = {k: v for k, v in steps[0].items() if k != "op"}
            return {"input": recipe["input"], "folder": file.parent.name}, step
    return None


def _recipe_of(op: str, folder: Path) -> str | None:
    """Return the recipe of the examples whose first step this is."""
    file = next((file for file, _ in _with_step(op, folder)), None)
    return None if file is None else f"examples/{file.parent.name}/{file.name}"


def _with_step(op: str, folder: Path) -> Iterator[tuple[Path, str]]:
    """Yield the files of the examples that have this step, with their text."""
    for file in sorted(folder.glob("*/*.toml")):
        text = file.read_text("utf-8", errors="replace")
        if re.search(rf'^op = "{op}"', text, re.MULTILINE):
            yield file, text


def _is_table(value: Any) -> bool:
    """Whether a value cannot be typed after ``--set``."""
    return isinstance(value, Mapping)


def _made_up(method: type[Method]) -> tuple[dict[str, Any], dict[str, Any], list[str]]:
    """Return input, keys and files with names to be replaced."""
    source: dict[str, Any] = {}
    if method.reads == "maps":
        files = [f"{n.lower()}.csv" for n in method.readings] or ["map_1.csv", "map_2.csv"]
    elif method.reads == "results":
        names = [n.replace(" ", "_") for n in method.readings] or ["first", "second"]
        files = [f"{n}/result.json" for n in names]
    else:
        files = [_ONE_FILE[method.reads]]
    if method.reads == "curves":
        unit = "urad" if method.dimension == "angle" else "um"
        names = list(method.readings) or [f"reading_{i}" for i in (1, 2, 3)]
        source["readings"] = [f"{n}_{unit}" for n in names]
        source |= {"angle": "angle_deg"} if method.over == "angle" else {"x": "x_mm"}
    for name, kind in method.roles.items():
        if "?" not in kind or name in ("target", "direction", "readings"):
            source[name] = _column(name, kind)
    if method.verb == "geometry":
        source |= {k: f"{k}_mm" for k in ("x", "y", "z") if k in method.roles}
    needed = {k: f for k, f in method.fields.items() if f.required and k != "op"}
    return source, {k: _value(f) for k, f in needed.items()}, files


def _column(name: str, kind: str) -> Any:
    plain = kind.strip("*?")
    unit = "mm" if name in _PLACES else _UNITS.get(plain)
    column = name if unit is None else f"{name}_{unit}"
    if plain == "speed":
        column = f"{name}_mm_min:mm/min"
    return (
        [f"{column.removesuffix(f'_{unit}')}_{i}_{unit}" for i in (1, 2)]
        if "*" in kind
        else column
    )


def _value(field: Field) -> str:
    from metrosep.core.options import KINDS

    return str(field.choices[0]) if field.choices else KINDS[field.kind].example


def _typed(value: Any) -> str:
    """Return a value of a recipe as it is typed: lists with commas, pairs with two dots."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        nested = any(isinstance(v, list) for v in value)
        return ",".join("..".join(str(p) for p in v) if nested else str(v) for v in value)
    return str(value)
