"""The command that compares two results, recipes or tables: diff."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option, name_values, say

if TYPE_CHECKING:
    from metrosep.report.comparison import Comparison, Row

__all__ = ["diff"]

_MOST_LINES = 8


@click.command()
@click.argument("a", metavar="A")
@click.argument("b", metavar="B")
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    metavar="NAME=VALUE",
    help='Allowed difference of a value, "PV=5 nm"; "PV=U": its expanded uncertainty; "*=U": of '
    "all. May be repeated.",
)
@json_option
def diff(a: str, b: str, tolerances: tuple[str, ...], as_json: bool) -> int:
    """Compare A and B: two results (result.json or their folders), recipes (.toml) or tables.

    A folder of a batch stands for the one result below it. A difference is B minus A. Values are compared with the uncertainty of their difference, tables
    entry by entry at the same positions. Exit code 0: equal within the tolerances; 1: different; 2:
    usage; 4: unreadable.
    """
    from metrosep.core.errors import DataError, ReadError

    pairs = name_values(tolerances, "--tolerance")
    allowed: dict[str, float | str] = dict(pairs)
    if len(allowed) < len(pairs):
        raise click.UsageError("--tolerance names a value twice; give one tolerance for each")
    (kind, one), (kind_b, two) = _load(a), _load(b)
    if kind != kind_b:
        raise click.UsageError(f"{a} is a {kind} and {b} is a {kind_b}; give two of one kind")
    if kind == "recipe" and allowed:
        raise click.UsageError("--tolerance is for values; recipes are compared key by key")
    try:
        found = _compared(kind, one, two, allowed, (a, b))
    except DataError as exc:
        if "is damaged" in str(exc):
            raise ReadError(str(exc)) from None
        raise
    if as_json:
        click.echo(json.dumps(found.to_dict(), sort_keys=True, allow_nan=False))
    else:
        _print(found)
    return 0 if found.equal else 1


def _load(name: str) -> tuple[str, Any]:
    """Return what a file is, and its content."""
    from metrosep.controllers.base import load_sidecar, require_unchanged, sidecar_path
    from metrosep.core.errors import ReadError
    from metrosep.recipe.result import load_document
    from metrosep.report.table_comparison import TABLE_SCHEMA

    path = Path(name)
    if path.suffix.lower() == ".toml":
        return "recipe", _text(path)
    if not path.is_dir() and sidecar_path(path).is_file():
        require_unchanged(path, _bytes(path))
        return "table", load_sidecar(path)
    if path.suffix.lower() == ".json" and path.is_file():
        content = _json(path)
        if isinstance(content, dict) and content.get("schema") == TABLE_SCHEMA:
            return "table", content
    elif path.is_file():
        raise ReadError(
            f"{name} is no result.json, no recipe (.toml), and no table with its {path.name}.json "
            "beside it; give one of these"
        )
    return "result", load_document(_with_result(path) if path.is_dir() else path)


def _with_result(folder: Path) -> Path:
    """Return the folder of a result: this one, or the only one of a batch below it."""
    from metrosep.core.errors import ReadError

    if (folder / "result.json").is_file():
        return folder
    found = _below(folder, "result.json")
    if len(found) == 1:
        return found[0]
    if found:
        shown = ", ".join(f.relative_to(folder).as_posix() for f in found[:_MOST_LINES])
        more = f" and {len(found) - _MOST_LINES} more" if len(found) > _MOST_LINES else ""
        raise click.UsageError(
            f"{folder} holds {len(found)} results; give one of its folders: {shown}{more}"
        )
    failed = _below(folder, "failed.json")
    reason = _json(failed[0] / "failed.json") if len(failed) == 1 else None
    if isinstance(reason, dict) and reason.get("reason"):
        raise ReadError(f"{folder} holds no result, since its unit failed: {reason['reason']}")
    return folder


def _below(folder: Path, name: str) -> list[Path]:
    """Return the folders of a file one or two below: a batch writes <key>/<8 digits>/result.json."""
    found = [f.parent for pattern in (f"*/{name}", f"*/*/{name}") for f in folder.glob(pattern)]
    return sorted(f for f in found if not any(p.startswith(".") for p in f.parts[-2:]))


def _bytes(path: Path) -> bytes:
    from metrosep.core.errors import ReadError

    try:
        return path.read_bytes()
    except OSError as exc:
        raise ReadError(
            f"{path}: cannot be read ({exc.strerror or exc}); check the name"
        ) from None


def _text(path: Path) -> str:
    from metrosep.core.errors import CorruptFileError

    try:
        return _bytes(path).decode("utf-8")
    except UnicodeDecodeError as exc:
        raise CorruptFileError(
            path, "not UTF-8", offset=exc.start, hint="save the recipe as UTF-8"
        ) from None


def _json(path: Path) -> Any:
    from metrosep.core.errors import CorruptFileError

    try:
        return json.loads(_bytes(path))
    except (ValueError, RecursionError) as exc:
        raise CorruptFileError(path, f"not JSON ({exc})", hint="write it again") from None


def _compared(
    kind: str, a: Any, b: Any, allowed: dict[str, float | str], names: tuple[str, str]
) -> Comparison:
    if kind == "recipe":
        from metrosep.report.recipe_comparison import compare_recipes

        return compare_recipes(a, b, names=names)
    if kind == "table":
        from metrosep.report.table_comparison import compare_tables

        return compare_tables(a, b, tolerances=allowed)
    from metrosep.report.compare import compare_documents

    return compare_documents(a, b, tolerances=allowed)


def _print(found: Comparison) -> None:
    for row in found.rows:
        click.echo(_line(row))
    for title, lines in (
        ("recipe", found.recipe),
        ("input", found.inputs),
        ("version", found.versions),
        ("beside", found.other),
    ):
        shown = lines[:_MOST_LINES] if title == "beside" else lines
        for line in shown:
            click.echo(f"{title}: {_printable(line)}")
        if len(shown) < len(lines):
            click.echo(
                f"{title}: and {len(lines) - len(shown)} further places (--json lists them)"
            )
    for message in found.messages:
        say(f"note: {message}")
    say("equal within the tolerances" if found.equal else "different")


def _printable(text: str) -> str:
    """Return a text of a document without what would move the cursor of a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)


def _line(row: Row) -> str:
    """Return a row in one line: mark, values, difference with its uncertainty, reason."""
    from metrosep.core.readable import value_text

    parts = [f"{'=' if row.equal else '!'} {row.metric}"]
    if (row.value_a, row.value_b) != (None, None):
        parts.append(" -> ".join(value_text(v, row.unit) for v in (row.value_a, row.value_b)))
    if row.difference is not None:
        text = f"difference {value_text(row.difference, row.unit)}"
        if row.U is not None:
            text += (
                f" (U = {value_text(row.U, row.unit)}, {'above' if row.exceeds else 'within'} it)"
            )
        parts.append(text)
    if row.tolerance is not None:
        parts.append(f"tolerance {value_text(row.tolerance, row.unit)}")
    if row.message:
        parts.append(row.message)
    return _printable("; ".join(parts))
