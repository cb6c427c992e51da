"""``metrosep batch``: one recipe over a folder of files."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import json_option, override_option, report_option, say, say_next

if TYPE_CHECKING:
    from metrosep.batch.index import BatchReport

Tell = Callable[[dict[str, Any]], None]
_OF_UNITS = (1, 3, 6)
"""Exit codes that say what became of the units; a bug or an interruption stays one."""


@click.command()
@click.argument("recipe")
@click.argument("folder", metavar="DIR", required=False)
@click.option(
    "-o", "--out", required=True, help="Folder for the results, one in it for each file."
)
@click.option(
    "--workers",
    type=int,
    metavar="N",
    help="Number of units at once. Default: one for each processor.",
)
@click.option(
    "--scheduler",
    default="processes",
    show_default=True,
    metavar="NAME",
    help="processes, threads, serial, dask, or dask=tcp://HOST:PORT.",
)
@click.option(
    "--resume/--fresh",
    "resume",
    default=True,
    help="Keep what is done (default), or do all again.",
)
@click.option("--fail-fast", is_flag=True, help="Stop after the first failure.")
@click.option("--watch", is_flag=True, help="Wait for new files until Ctrl-C.")
@click.option(
    "--every",
    type=float,
    metavar="SECONDS",
    help="Seconds between two looks (--watch). Default: 5.",
)
@click.option("--dry-run", is_flag=True, help="List what would be done, without doing it.")
@click.option(
    "--exit-zero",
    is_flag=True,
    help="End with 0 also where units are rejected, inconclusive or failed.",
)
@override_option
@report_option
@json_option
@click.pass_context
def batch(
    context: click.Context,
    /,
    recipe: str,
    folder: str | None,
    every: float | None,
    watch: bool,
    exit_zero: bool,
    overrides: tuple[str, ...],
    fields: tuple[str, ...],
    as_json: bool,
    **options: Any,
) -> int:
    """Run RECIPE on every file below DIR, each with its own verdict.

    Start a batch that was stopped or killed again: it goes on where it was. Exit codes, the
    worst counts: 5 internal error, 6 files that failed or folders that cannot be read, 1 rejected,
    3 inconclusive, 0 all accepted; 130 interrupted.
    """
    from metrosep.batch import run_batch
    from metrosep.recipe.preflight import require_limits
    from metrosep.recipe.recipe import Recipe

    if folder is None:
        raise click.UsageError(
            "a batch needs a recipe and a folder, metrosep batch RECIPE DIR -o OUT; 'metrosep measure "
            'FILE ... --print-recipe\' prints a recipe, of which files = ["*.x3p"] takes every file'
        )
    if every is not None and not watch:
        raise click.UsageError("--every needs --watch")
    seconds = (5.0 if every is None else every) if watch else None
    quiet = bool((context.obj or {}).get("quiet"))
    loaded = Recipe.load(recipe, overrides=overrides, report=fields)
    require_limits(loaded)
    with _progress(quiet=quiet) as tell:
        report = run_batch(loaded, folder, watch=seconds, tell=tell, **options)
    if as_json:
        click.echo(json.dumps(_summary(report), sort_keys=True, allow_nan=False))
    code = 0 if exit_zero and report.exit_code in _OF_UNITS else report.exit_code
    if as_json or quiet:
        return code
    for message in report.messages:
        say(f"note: {_one_line(message)}")
    for row in report.rows if options["dry_run"] else ():
        say(_one_line(f"{row['status']:12} {row['unit']} -> {row['link'] or row['reason']}"))
    say(report.summary())
    if report.out is not None:
        page = report.out / "index.html"
        say(f"index    {page if page.is_file() else report.out / 'index.json'}")
        best = "xlsx" if find_spec("xlsxwriter") else "csv"
        say_next("report", report.out, "--format", best, "-o", "reports")
    return code


def _summary(report: BatchReport) -> dict[str, Any]:
    from metrosep.recipe.result import clean

    summary: dict[str, Any] = clean(
        {
            "counts": report.counts,
            "exit_code": report.exit_code,
            "seconds": report.seconds,
            "messages": report.messages,
            "stopped": report.stopped,
            "index": None if report.out is None else str(report.out / "index.json"),
            "rows": [{k: v for k, v in r.items() if k != "messages"} for r in report.rows],
        }
    )
    return summary


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Tell | None]:
    """Give what tells of each unit: nothing, a line each, or one line on a terminal."""
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield _line
        return
    with contextlib.ExitStack() as stack:
        try:
            yield _rich(stack)
        except ImportError:
            stack.callback(print, file=sys.stderr)
            yield _rewritten


def _one_line(text: str) -> str:
    """Return a text with names of files for one line of a terminal."""
    from metrosep.batch.units import one_line_name

    return one_line_name(text)


def _line(event: Mapping[str, Any]) -> None:
    reason = f": {event['reason']}" if event["reason"] else ""
    text = f"{event['done']}/{event['total']} {event['status']} {event['unit']}{reason}"
    say(f"metrosep: {_one_line(text)}")


def _rewritten(event: Mapping[str, Any]) -> None:
    """Write the state over the line before; what failed keeps its line."""
    if event["status"] in ("failed", "refused"):
        print("\r\033[K", end="", file=sys.stderr)
        _line(event)
    left = "" if event["eta_s"] is None else f", {_duration(event['eta_s'])} left"
    text = _one_line(f"{event['done']}/{event['total']} units{left}  {event['unit']}")[:78]
    print(f"\r\033[K{text}", end="", file=sys.stderr, flush=True)


def _rich(stack: contextlib.ExitStack) -> Tell:
    """Return what tells through a bar of the package rich."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[words]}"))
    bar = stack.enter_context(Progress(*columns, console=Console(stderr=True)))
    number = bar.add_task("", total=None, words="")

    def tell(event: Mapping[str, Any]) -> None:
        left = "" if event["eta_s"] is None else f"{_duration(event['eta_s'])} left  "
        words = _one_line(f"{left}{event['status']} {event['unit']}")
        bar.update(number, completed=event["done"], total=event["total"], words=words)
        if event["status"] in ("failed", "refused"):
            bar.console.print(
                _one_line(f"{event['status']} {event['unit']}: {event['reason']}"),
                markup=False,
                highlight=False,
            )

    return tell


def _duration(seconds: float) -> str:
    whole = round(seconds)
    hours, minutes = divmod(whole // 60, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {whole % 60:02d} s" if minutes else f"{whole} s"
