"""One command for each named separation that a person can copy.

Where the examples lie beside the package, the command is that of the example's recipe and runs on
its data. Elsewhere it is made from what the method reads and needs, with names of columns to replace.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrosep.cli.named import COLUMN_OPTIONS

if TYPE_CHECKING:
    from metrosep.recipe.method import Method
    from metrosep.recipe.schema import Field

__all__ = ["example_call", "shell_text"]

_ONE_FILE = {"curves": "readings.csv", "table": "table.csv", "tables": "table.csv"}
_UNITS = {
    "length": "um", "angle": "urad", "time": "s", "position": "um", "frequency": "hz",
}  # fmt: skip
_PLACES = ("x", "y", "target", "position")
_VALUES = {
    "length": "1 mm", "size": "25 mm", "uncertainty": "2 nm", "lengths": "10 mm", "angle": "1 deg",
    "angles": "0 deg,30 deg,75 deg", "time": "2 s", "times": "0 s,30 s", "frequency": "1 kHz",
    "frequencies": "50 Hz", "speed": "4800 mm/min", "speeds": "4800 mm/min", "integer": "30",
    "integers": "8,7", "number": "1", "numbers": "1,2", "flag": "true", "limit": "2 nm", "expanded": "2 nm",
    "places": "0 mm..0 mm,4 mm..0 mm,0 mm..4 mm", "pairs": "0..0,1..0", "range": "10 mm,5 mm",
    "waves": "3", "windows": "0 min..60 min", "lag": "2 ms", "spacing": "1 mm", "degree": "2",
}  # fmt: skip


def example_call(op: str, method: Method, folder: Path | None = None) -> list[str]:
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
        step = {k: f"{place}/{v}" if kinds.get(k) == "file" else v for k, v in step.items()}
    words = ["metrosep", "separate", *files, "--method", op]
    for key, value in source.items():
        text = _typed(value)
        name = [f"--{key.replace('_', '-')}", text]
        words += name if key in COLUMN_OPTIONS else ["--column", f"{key}={text}"]
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
    for file in sorted(folder.glob("*/*.toml")):
        try:
            recipe = tomllib.loads(file.read_text("utf-8"))
        except (OSError, ValueError):
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
    for file in sorted(folder.glob("*/*.toml")):
        if re.search(rf'^op = "{op}"', file.read_text("utf-8"), re.MULTILINE):
            return f"examples/{file.parent.name}/{file.name}"
    return None


def _is_table(value: Any) -> bool:
    """Whether a value cannot be typed after ``--set``."""
    return isinstance(value, Mapping)


def _made_up(method: Method) -> tuple[dict[str, Any], dict[str, Any], list[str]]:
    """Return input, keys and files with names to be replaced."""
    source: dict[str, Any] = {}
    if method.reads == "maps":
        files = [f"{n.lower()}.csv" for n in method.names] or ["map_1.csv", "map_2.csv"]
    elif method.reads == "results":
        names = [n.replace(" ", "_") for n in method.names] or ["first", "second"]
        files = [f"{n}/result.json" for n in names]
    else:
        files = [_ONE_FILE[method.reads]]
    if method.reads == "curves":
        unit = "urad" if method.dimension == "angle" else "um"
        names = list(method.names) or [f"reading_{i}" for i in (1, 2, 3)]
        source["readings"] = [f"{n}_{unit}" for n in names]
        source |= {"angle": "angle_deg"} if method.over == "angle" else {"x": "x_mm"}
    for name, kind in method.roles.items():
        if "?" not in kind or name in ("target", "direction", "readings"):
            source[name] = _column(name, kind)
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
    return str(field.choices[0]) if field.choices else _VALUES.get(field.kind, "...")


def _typed(value: Any) -> str:
    """Return a value of a recipe as it is typed: lists with commas, pairs with two dots."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        nested = any(isinstance(v, list) for v in value)
        return ",".join("..".join(str(p) for p in v) if nested else str(v) for v in value)
    return str(value)
