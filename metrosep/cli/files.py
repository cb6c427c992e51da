"""Commands about files: info, check, convert, formats."""

from __future__ import annotations

import json
from typing import Any

import click

from metrosep.cli.options import file_options, json_option, override_option, read_aloud, say

__all__ = ["check", "convert", "formats", "info"]


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@file_options
@json_option
def info(
    files: tuple[str, ...],
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Say what is in FILE: format, shape, steps, heights, gaps, hash."""
    from metrosep.cli.errors import exit_code_of, report_error
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
            report_error(exc, verbosity=0, names=_names_of(info))
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
@click.option(
    "--explain", is_flag=True, help="Of recipes: print what holds where a key is left out."
)
@override_option
@json_option
def check(
    files: tuple[str, ...],
    reading: dict[str, Any],
    explain: bool,
    overrides: tuple[str, ...],
    as_json: bool,
) -> int:
    """Say what is odd about FILE: level, problem, fix.

    The exit code is 0 without errors (there may be warnings), 1 with errors, 4 when a file cannot
    be read. Of recipes (.toml) every mistake that shows without data is told, with its line; the exit
    code is 0, or 2 with mistakes.
    """
    from metrosep.cli.checking_recipes import are_recipes, check_recipes

    if are_recipes(files):
        return check_recipes(files, as_json=as_json, explain=explain, overrides=overrides)
    if explain or overrides:
        option = "--explain" if explain else "-s"
        raise click.UsageError(f"{option} is for recipes (.toml); leave it out for data")
    from metrosep.cli.errors import as_options
    from metrosep.io.check import check_file

    found = {name: check_file(name, **reading) for name in files}
    if as_json:
        items = [{"file": n, "findings": [f.to_dict() for f in fs]} for n, fs in found.items()]
        content = items[0] if len(items) == 1 else {"files": items}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    for name, findings in found.items():
        if not as_json:
            click.echo(
                f"{name}: {'nothing odd' if not findings else ''}".rstrip(": ")
                + ":" * bool(findings)
            )
        for finding in () if as_json else findings:
            fix = as_options(finding.fix, _names_of(check))
            click.echo(
                f"  {finding.level:8} {as_options(finding.problem, _names_of(check))}\n{'':11}{fix}"
            )
    every = [f for fs in found.values() for f in fs]
    if any(f.level == "error" and f.unreadable for f in every):
        return 4
    return int(any(f.level == "error" for f in every))


def _names_of(command: click.Command) -> set[str]:
    return {p.name for p in command.params if p.name}


def _print_description(name: str, found: dict[str, Any]) -> None:
    from metrosep.core.units import format_length

    click.echo(f"{name}")
    shape = " x ".join(str(n) for n in found["shape"])
    click.echo(f"  format    {found['format']}, {found['kind']}, {shape}")
    if found["kind"] in ("surface", "profile"):
        steps = [found["dx_m"]] + ([found["dy_m"]] if found["kind"] == "surface" else [])
        missing = "not calibrated" if found["kind"] == "surface" else "not uniform"
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
        from metrosep.io.text.delimited_maps import shown_columns

        click.echo(f"  columns   {shown_columns(tuple(_column_text(c) for c in columns))}")
    for warning in found["metadata"].get("warnings") or ():
        click.echo(f"  warning   {warning}")
    click.echo(f"  sha256    {found['sha256']}")


def _column_text(column: Any) -> str:
    if isinstance(column, dict):
        unit = column.get("unit")
        return f"{column.get('name')}" + (f" [{unit}]" if unit else "")
    return str(column)


@click.command()
@click.argument("source", metavar="SRC")
@click.argument("target", metavar="DST")
@click.option("--format", "target_format", help="Format of DST; follows from its suffix.")
@file_options
@click.option("--force", is_flag=True, help="Replace DST if it exists.")
def convert(
    source: str,
    target: str,
    target_format: str | None,
    reading: dict[str, Any],
    force: bool,
) -> int:
    """Read SRC and write it as DST (csv, h5, int, sdf, sur, x3p, xyz)."""
    from pathlib import Path

    from metrosep.core.errors import WriteError
    from metrosep.io.write import WITHOUT_HISTORY, write

    if Path(target).exists() and not force:
        raise WriteError(f"{target}: exists already; choose another name or give --force")
    obj = read_aloud(source, reading)
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
    """List the file formats, and on what the claim rests that they are read rightly."""
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
