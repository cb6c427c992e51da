"""``metrosep``: the group of commands and its error handling."""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from metrosep._version import __version__
from metrosep.cli.batches import batch
from metrosep.cli.carriers import controllers
from metrosep.cli.comparing import diff
from metrosep.cli.files import check, convert, formats, info
from metrosep.cli.jobs import demo, run, separate
from metrosep.cli.measuring import form, measure, verify_softgauge
from metrosep.cli.modelling import predict, rank
from metrosep.cli.ops import ops
from metrosep.cli.paths import path
from metrosep.cli.planning import plan
from metrosep.cli.reporting import report
from metrosep.cli.tables import table, verify
from metrosep.cli.workbench import ui

__all__ = ["cli", "main"]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="metrosep")
@click.option("-v", "--verbose", count=True, help="More words; twice for a traceback.")
@click.option("-q", "--quiet", is_flag=True, help="No progress on standard error.")
@click.pass_context
def cli(context: click.Context, verbose: int, quiet: bool) -> None:
    """Separate the errors of precision machines and compensate them.

    Errors are actual minus nominal; corrections are added to the command. Exit codes: 0 accepted;
    1 rejected, also a table that would not shrink the error or exceeds a limit; 2 usage or recipe
    error, also an output that cannot be written; 3 inconclusive; 4 input unreadable or unusable;
    5 internal error; 130 interrupted.
    """
    context.obj = {} if context.obj is None else context.obj
    context.obj |= {"verbose": verbose, "quiet": quiet}


for _command in (
    demo,
    info,
    check,
    convert,
    measure,
    form,
    separate,
    table,
    path,
    report,
    diff,
    verify,
    verify_softgauge,
    run,
    batch,
    plan,
    rank,
    predict,
    formats,
    controllers,
    ops,
    ui,
):
    cli.add_command(_command)


def _global_first(words: list[str]) -> list[str]:
    """Move -v and -q to the front: people add them behind the command that failed."""
    end = words.index("--") if "--" in words else len(words)
    is_global = [
        i < end and (w in ("--verbose", "--quiet", "-q") or (w[:2] == "-v" and not w.strip("-v")))
        for i, w in enumerate(words)
    ]
    first = [w for w, yes in zip(words, is_global, strict=True) if yes]
    return first + [w for w, yes in zip(words, is_global, strict=True) if not yes]


def _verbosity(arguments: list[str]) -> int:
    count = 0
    for argument in arguments:
        if not argument.startswith("-"):
            break
        if argument == "--verbose":
            count += 1
        elif set(argument[1:]) == {"v"}:
            count += len(argument) - 1
    return count


def _parameters(words: list[str]) -> set[str]:
    """Names of the parameters of the command that was called."""
    command = next((cli.commands[w] for w in words if w in cli.commands), None)
    return {p.name for p in command.params if p.name} if command is not None else set()


def _give_up_standard_output() -> None:
    """Let the interpreter flush into nothing at its end, so that it does not complain a second time."""
    import contextlib

    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


def main(arguments: list[str] | None = None) -> Any:
    """Run the command line and exit."""
    from metrosep.cli.errors import is_standard_output, report_error

    # two spinning BLAS threads cost more than they give on the small products here
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    words = _global_first(sys.argv[1:] if arguments is None else arguments)
    told: dict[str, Any] = {}  # holds "words" where a command has words of its own
    try:
        code = cli.main(args=words, prog_name="metrosep", standalone_mode=False, obj=told)
    except click.exceptions.Abort:
        sys.exit(report_error(KeyboardInterrupt(), verbosity=0))
    except click.ClickException as exc:
        line = " ".join(exc.format_message().split())
        hint = ""
        if isinstance(exc, click.UsageError) and exc.ctx is not None:
            hint = f" (see '{exc.ctx.command_path} --help')"
        click.echo(f"error: {line}{hint}", err=True)
        sys.exit(2)
    except SystemExit as exc:  # click ends so, with 1, where the reader of a pipe has gone
        sys.exit(2 if exc.code == 1 else exc.code)
    except (KeyboardInterrupt, Exception) as exc:  # every error becomes one line and a code
        if is_standard_output(exc):
            _give_up_standard_output()
        names, verbosity = _parameters(words), _verbosity(words)
        sys.exit(report_error(exc, verbosity=verbosity, names=names, words=told.get("words")))
    sys.exit(code if isinstance(code, int) else 0)
