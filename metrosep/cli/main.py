"""``metrosep``: the group of commands and its error handling."""

from __future__ import annotations

import importlib
import os
import re
import sys
from functools import cache, partial
from typing import Any

import click

from metrosep._version import __version__

_GROUPS = {
    "Measure": {
        "info": "files", "check": "files", "convert": "files", "measure": "measuring", "form": "measuring",
        "psd": "spectra", "geometry": "geometry", "circle": "machines", "verify-softgauge": "measuring",
    },
    "Separate": {
        "run": "jobs", "batch": "batches", "separate": "jobs", "plan": "modelling", "calibrate": "machines",
        "thermal": "machines", "air": "modelling",
    },
    "Compensate": {
        "table": "tables", "machine-tables": "machine_tables", "volume": "machine_tables", "path": "paths",
        "verify": "tables", "read": "machines", "rank": "modelling", "predict": "modelling",
    },
    "Report": {"report": "reporting", "diff": "reporting"},
    "Tools": {
        "demo": "jobs", "ui": "workbench", "listen": "listening", "formats": "files", "controllers": "files", "ops": "ops",
        "doctor": "doctor", "completion": "doctor",
    },
}  # fmt: skip
_HOMES = {name: home for group in _GROUPS.values() for name, home in group.items()}
"""The module of each command, which is loaded when the command is called."""


class _Place(click.types.StringParamType):
    """A text that a shell completes as the name of a file, a folder or a machine."""

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[Any]:
        """Return the machines that begin so; else what lets the shell name files or folders."""
        from click.shell_completion import CompletionItem

        words = _metavar(param)
        if ctx.info_name == "identify" and not ctx.params.get("identify"):
            words = "MACHINE"  # its first argument, which stands before the file
        if "MACHINE" in words:
            from metrosep.machine import presets

            names = (
                (*presets(), "tool") if "identify" in (param.name, ctx.info_name) else presets()
            )
            found = [n for n in names if n.startswith(incomplete)]
            if found:
                return [CompletionItem(n) for n in found]
        is_folder = any(w in words for w in ("DIR", "FOLDER"))
        return [CompletionItem(incomplete, type="dir" if is_folder else "file")]


def _metavar(param: click.Parameter) -> str:
    return param.metavar or (param.name or "").upper()


def _is_place(param: click.Parameter) -> bool:
    """Return whether a value is the name of a file, a folder or a machine: arguments are, but for names."""
    if param.type is not click.STRING:
        return False
    if isinstance(param, click.Argument):
        return param.name not in ("name", "process", "source")
    words = _metavar(param)
    return any(w in words for w in ("FILE", "DIR", "FOLDER", "MACHINE", "RESULT", "SET", "MAP"))


class _Choice(click.Choice[Any]):
    """A choice whose refusal names the nearest word."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the choice that was typed."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as exc:
            from metrosep.core.readable import did_you_mean

            raise click.BadParameter(
                f"{exc.message}{did_you_mean(value, self.choices)}", ctx, param
            ) from None


class _Commands(click.Group):
    """A group that lists its commands without loading them."""

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[Any]:
        """Return the commands, and the other door of 'form', that begin so."""
        from click.shell_completion import CompletionItem

        found = super().shell_complete(ctx, incomplete)
        if "identify".startswith(incomplete):
            found.append(
                CompletionItem("identify", help="Errors of a machine that explain a map.")
            )
        return found

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names, in alphabetical order."""
        return sorted(_HOMES)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, from its module."""
        if cmd_name not in _HOMES:
            return None
        module = importlib.import_module(f"metrosep.cli.{_HOMES[cmd_name]}")
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        for option in command.params:  # the place of the output is checked before anything is read
            if option.name == "out" and option.callback is None:
                option.callback = _require_place
            if _is_place(option):
                option.type = _Place()
            if type(option.type) is click.Choice:
                option.type = _Choice(option.type.choices, option.type.case_sensitive)
        if "format_help_text" not in vars(command):
            vars(command)["format_help_text"] = partial(
                _help_text, type(command), command, cmd_name
            )
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is called; of a name that is none, say which one is near."""
        from metrosep.core.readable import did_you_mean

        typed, args = args[0], _other_door(args)
        near = did_you_mean(args[0], _HOMES)
        if args[0] in _HOMES or not near or args[0].startswith("-"):
            name, command, rest = super().resolve_command(ctx, args)
            if command is not None and not ctx.resilient_parsing:
                inner = click.Context(
                    command, info_name=name, parent=ctx, **command.context_settings
                )
                _refuse_repeated(command, inner, rest)
            return typed if ctx.resilient_parsing else name, command, rest
        return ctx.fail(f"No such command {args[0]!r}.{near}")

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands in groups, each with the first sentence of its docstring, and examples."""
        for group, homes in _GROUPS.items():
            with formatter.section(group):
                formatter.write_dl([(n, _first_sentence(n)) for n in homes], col_max=18)
        with formatter.section("Examples"):
            formatter.write_text("\b\n" + "\n".join(_EXAMPLES))


def _help_text(
    kind: type[click.Command],
    command: click.Command,
    name: str,
    ctx: click.Context,
    formatter: click.HelpFormatter,
) -> None:
    """Write what a command does, and calls to copy, which are loaded for this page only."""
    from metrosep.cli.examples import EXAMPLES

    kind.format_help_text(command, ctx, formatter)
    formatter.write_paragraph()
    with formatter.indentation():
        formatter.write_text("\b\nExamples:\n" + "\n".join(f"  {v}" for v in EXAMPLES[name]))


def _other_door(args: list[str]) -> list[str]:
    """Return the call that ``identify MACHINE FILE`` and ``table --from-machine MACHINE`` are."""
    if args[0] == "identify":
        machine = [v for v in args[1:2] if not v.startswith("-")]
        return ["form", *args[1 + len(machine) :], *(f"--identify={v}" for v in machine)]
    end = args.index("--") if "--" in args else len(args)
    at = next((i for i, v in enumerate(args[:end]) if v.partition("=")[0] == "--from-machine"), 0)
    if args[0] != "table" or not at:
        return args
    _, is_joined, value = args[at].partition("=")
    after = at + (1 if is_joined else 2)
    machine = [value] if is_joined else args[at + 1 : after]
    if not machine:  # still to come: 'table' says so, and a shell completes the machines
        return args
    return ["machine-tables", *machine, *args[1:at], *args[after:]]


def _refuse_repeated(command: click.Command, ctx: click.Context, words: list[str]) -> None:
    """Refuse an option that takes one value and is given twice: the last would count in silence."""
    given = command.make_parser(ctx).parse_args(args=list(words))[2]
    for option in dict.fromkeys(given):
        once = isinstance(option, click.Option) and not (
            option.multiple or option.count or (option.is_flag and not option.secondary_opts)
        )
        if once and given.count(option) > 1:
            ctx.fail(f"{option.opts[-1]} is given twice and takes one value: keep one.")


def _require_place(_: click.Context, option: click.Parameter, value: Any) -> Any:
    from metrosep.cli.options import require_place

    if value is not None:
        require_place(value, folder=option.metavar != "FILE")
    return value


_EXAMPLES = (
    'metrosep measure part.x3p --form plane --params Sq,Sz --upper "Sq=5 nm" -o out',
    'metrosep separate runs.csv --x x_mm --z z_um --table "linuxcnc=x.comp" --axis X -o out',
    "metrosep report out --format html,pdf -o reports",
)


def _first_sentence(command: str) -> str:
    text = " ".join(_docstring(command).split())
    return re.split(r"(?<=[.:])(?: |$)", text, maxsplit=1)[0].rstrip(":.") + "."


def _docstring(command: str) -> str:
    """Return the docstring of a command as its source has it: the module is not loaded for it."""
    source = _source(_HOMES[command])
    name = command.replace("-", "_")
    return source.partition(f"\ndef {name}(")[2].partition('"""')[2].partition('"""')[0]


@click.group(
    cls=_Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="metrosep")
@click.option("-v", "--verbose", count=True, help="Show details; -vv also shows a traceback.")
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


def _global_first(words: list[str]) -> list[str]:
    """Move -v and -q to the front: people add them behind the command that failed."""
    end = words.index("--") if "--" in words else len(words)
    is_global = [
        i < end and (w in ("--verbose", "--quiet", "-q") or (w[:2] == "-v" and not w.strip("-v")))
        for i, w in enumerate(words)
    ]
    first = [w for w, yes in zip(words, is_global, strict=True) if yes]
    return first + [w for w, yes in zip(words, is_global, strict=True) if not yes]


_OTHER_WORDS = {"upper": ("limit", "max", "tolerance"), "lower": ("min",)}
"""What people call an option whose name is not near that word, by option."""


def _other_word(error: click.ClickException) -> str:
    """Return the message for an option that a command has by another word, or nothing."""
    if not isinstance(error, click.NoSuchOption) or error.ctx is None:
        return ""
    words = error.option_name.lstrip("-").removesuffix("s")
    known = {p.name for p in error.ctx.command.params}
    meant = [k for k, ways in _OTHER_WORDS.items() if words in ways and k in known]
    if words == "limit" and "lower" in known:
        meant.append("lower")
    options = " or ".join(f"--{k}" for k in meant)
    return f"No such option {error.option_name!r}. Did you mean {options}?" if meant else ""


def _all_missing(error: click.ClickException, words: list[str]) -> str:
    """Return the message of options that a call needs and lacks, all at once; empty for other errors."""
    if not isinstance(error, click.MissingParameter) or error.ctx is None:
        return ""
    given = {w.partition("=")[0] for w in words} | {w[:2] for w in words if not w.startswith("--")}
    lacking = [
        p.opts[-1]
        for p in error.ctx.command.params
        if p.required and isinstance(p, click.Option) and not given & {*p.opts}
    ]
    if "pivot_height" in {p.name for p in error.ctx.command.params}:  # the command takes presets
        from metrosep.recipe.methods.ops_machine import PRESET_NEEDS

        needs = [f"--{PRESET_NEEDS[w][0].replace('_', '-')}" for w in words if w in PRESET_NEEDS]
        lacking += [option for option in needs if option not in {*given, *lacking}]
    first = error.format_message().rstrip(".") if isinstance(error.param, click.Argument) else ""
    if len(lacking) + bool(first) < 2:
        return ""
    options = f"option{'s' if len(lacking) > 1 else ''} " + " and ".join(f"'{n}'" for n in lacking)
    return f"{first} and {options}." if first else f"Missing {options}."


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


def _parameters(words: list[str]) -> dict[str, str]:
    """Names of the parameters of the command that was called, and their options."""
    from metrosep.cli.errors import flags_of

    name = next((w for w in words if w in _HOMES), None)
    command = None if name is None else cli.get_command(click.Context(cli), name)
    return {} if command is None else flags_of(command)


def _give_up_standard_output() -> None:
    """Let the interpreter flush into nothing at its end, so that it does not complain a second time."""
    import contextlib

    with contextlib.suppress(OSError, ValueError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, sys.stdout.fileno())
        os.close(nothing)


@cache
def _source(module: str) -> str:
    with open(f"{os.path.dirname(__file__)}/{module}.py", encoding="utf-8") as file:  # noqa: PTH120, PTH123
        return file.read()


class _Heartbeat:
    """Says on standard error what a long command is at: from 0.5 s on a terminal, else every 10 s."""

    _SILENT = ("ui", "batch", "listen", "completion")  # they have words of their own

    def __init__(self, words: list[str], told: dict[str, Any]) -> None:
        self._name = next((w for w in words if w in _HOMES), "")
        self._told = told
        self._quiet = (
            not self._name or self._name in self._SILENT or "-q" in words or "--quiet" in words
        )
        self._on_terminal = sys.stderr is not None and sys.stderr.isatty()
        self._done: Any = None

    def __enter__(self) -> None:
        if self._quiet:
            return
        import threading

        self._done = threading.Event()
        threading.Thread(target=self._beat, daemon=True).start()

    def __exit__(self, *_: object) -> None:
        if self._done is not None:
            self._done.set()

    def _beat(self) -> None:
        import time

        began, shown = time.monotonic(), False
        pause = 0.5 if self._on_terminal else 10.0
        while not self._done.wait(pause):
            phase = self._told.get("phase") or self._name
            text = f"metrosep: {phase}, {time.monotonic() - began:.0f} s"
            click.echo(f"\r{text[:78]:<78}" if self._on_terminal else text, err=True,
                       nl=not self._on_terminal)  # fmt: skip
            shown = True
            pause = 1.0 if self._on_terminal else 10.0
        if shown and self._on_terminal:
            click.echo(f"\r{'':78}\r", err=True, nl=False)


def main(arguments: list[str] | None = None) -> Any:
    """Run the command line and exit."""
    # two spinning BLAS threads cost more than they give on the small products here
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    words = _global_first(sys.argv[1:] if arguments is None else arguments)
    told: dict[
        str, Any
    ] = {}  # "words" where a command has its own, "facts" that its --machine takes
    if not words and "_METROSEP_COMPLETE" not in os.environ:
        context = cli.make_context("metrosep", [], resilient_parsing=True)
        click.echo(context.get_help(), err=True)
        sys.exit(2)
    beat = _Heartbeat(words, told)
    try:
        with beat:
            code = cli.main(args=words, prog_name="metrosep", standalone_mode=False, obj=told)
    except click.exceptions.Abort:
        from metrosep.cli.errors import report_error

        sys.exit(report_error(KeyboardInterrupt(), verbosity=0))
    except click.ClickException as exc:
        line = " ".join(
            (_all_missing(exc, words) or _other_word(exc) or exc.format_message()).split()
        )
        hint = ""
        if isinstance(exc, click.UsageError) and exc.ctx is not None:
            hint = f" (see '{exc.ctx.command_path} --help')"
        click.echo(f"error: {line}{hint}", err=True)
        sys.exit(2)
    except SystemExit as exc:  # click ends so, with 1, where the reader of a pipe has gone
        sys.exit(2 if exc.code == 1 else exc.code)
    except (KeyboardInterrupt, Exception) as exc:  # every error becomes one line and a code
        from metrosep.cli.errors import is_standard_output, report_error

        if is_standard_output(exc):
            _give_up_standard_output()
        names, verbosity = _parameters(words), _verbosity(words)
        how = {"facts": told.get("facts", ()), "words": told.get("words")}
        sys.exit(report_error(exc, verbosity=verbosity, names=names, **how))
    sys.exit(code if isinstance(code, int) else 0)
