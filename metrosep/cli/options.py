"""Options that several commands share, and how they become arguments."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.machine import Chain

USUAL_SPACING = "1 mm"
USUAL_TURN = "1 deg"
"""Between the entries of a table over runs or a map; over an axis that turns."""

F = TypeVar("F", bound=Callable[..., Any])

READING = ("unit", "lateral_step", "channel", "format")
"""Options of a file beside --set."""

INPUT_KEYS = (*READING, *TEXT_OPTIONS)
"""Options of readers that a recipe has keys for."""


def json_option(command: F) -> F:
    """Add ``--json``."""
    return click.option(
        "as_json", "--json", is_flag=True, help="One JSON object on standard output."
    )(command)


def force_option(command: F) -> F:
    """Add ``--force``."""
    return click.option(
        "--force", is_flag=True, help="Replace another table of that name; it stays as NAME.1."
    )(command)


def machine_options(command: F) -> F:
    """Add what the presets of machines need to know."""
    for name, text in (
        ("--pivot-height", "Height of the table above the axis of A, for the preset five_axis."),
        ("--radius", "Radius of the part, for the preset fts_lathe."),
    ):
        command = click.option(name, metavar="LENGTH", help=text)(command)
    return command


def tool_option(command: F) -> F:
    """Add ``--tool``."""
    return click.option(
        "--tool",
        metavar="X,Y,Z",
        help='Tool point in the frame of the last element: "0 mm,0 mm,-80 mm".',
    )(command)


def chain_of(machine: str, options: dict[str, Any]) -> Chain:
    """Return the machine of a command with `machine_options`."""
    from metrosep.core.errors import DataError
    from metrosep.core.numbers import quantity
    from metrosep.recipe.methods.ops_machine import machine_of

    given = {"radius": options["radius"], "pivot_height": options["pivot_height"]}
    sizes = {
        k: None if v is None else quantity(v, f"--{k.replace('_', '-')}", "length")
        for k, v in given.items()
    }
    try:
        found: Chain = machine_of(
            {"machine": machine, "pivot_height": sizes["pivot_height"]}, sizes["radius"]
        )
    except DataError as exc:
        raise click.UsageError(
            option_words(str(exc), ["pivot_height"]).replace("radius = ", "--radius ")
        ) from None
    return found


def override_option(command: F) -> F:
    """Add ``-s``, which overrides a key of a recipe."""
    return click.option(
        "-s",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help='A key of the recipe: step.form.form=sphere, step.2.degree=5, check.Sa.upper="12 nm"; '
        "may be repeated.",
    )(command)


def report_option(command: F) -> F:
    """Add ``--report``, which states a field of the report."""
    return click.option(
        "--report",
        "fields",
        multiple=True,
        metavar="KEY=VALUE",
        help='Field of the report: number=2026-7, item.serial="A 12", customer.name=...; may be repeated.',
    )(command)


def file_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the options that say how a file is to be read."""

    @functools.wraps(command)
    def with_reading(settings: tuple[str, ...], **options: Any) -> int:
        plain = {name: options.pop(name) for name in READING}
        reading = {name: value for name, value in plain.items() if value is not None}
        return command(reading={**reading, **_settings(settings)}, **options)

    decorated: Callable[..., int] = with_reading
    for option in (
        click.option("--unit", help="Unit of the heights where the file declares none."),
        click.option("--lateral-step", help='Overrides the lateral step of the file, "1.1 um".'),
        click.option("--channel", help="Channel of a file that holds several."),
        click.option("--as", "format", metavar="FORMAT", help="Read the file as this format."),
        click.option(
            "--set",
            "settings",
            multiple=True,
            metavar="NAME=VALUE",
            help='Option of the format, "sampling_rate=2 kHz"; may be repeated.',
        ),
    ):
        decorated = option(decorated)
    return decorated


def _settings(texts: tuple[str, ...]) -> dict[str, Any]:
    """Return what ``--set`` gave, by name."""
    given = key_values(texts, "--set")
    return {k: value if whole(value) is None else int(value) for k, value in given.items()}


def name_values(texts: tuple[str, ...], option: str) -> list[tuple[str, str]]:
    """Return the names and values of an option that is written NAME=VALUE, each name once."""
    found: dict[str, tuple[str, str]] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not name or not value:
            raise click.UsageError(f"{option} takes NAME=VALUE, found {text!r}")
        key = name.replace("-", "_")
        if key in found:
            raise click.UsageError(f"{option} {name} is given twice: keep one")
        found[key] = (name, value)
    return list(found.values())


def key_values(texts: Iterable[str], option: str) -> dict[str, str]:
    """Return the values that are written NAME=VALUE by key: in a key ``_`` stands for ``-``."""
    return {name.replace("-", "_"): v for name, v in name_values(tuple(texts), option)}


def whole(text: str) -> str | None:
    """Return a typed count as TOML writes it, 06 as 6; None of anything else.

    Examples
    --------
    >>> whole("06"), whole("6 um"), whole("-6")
    ('6', None, None)
    """
    digits = text.strip()
    return str(int(digits)) if digits.isdecimal() and len(digits) <= _LONGEST else None


_LONGEST = 18
"""Digits of a count: more do not fit into the 63 bits that a number of TOML has."""


def named_options(command: F) -> F:
    """Add the options of the named separations."""
    for option in reversed(
        (
            click.option(
                "--readings",
                metavar="COLUMN,...",
                help="Named: columns of the readings, in their order: m1_um,m2_um.",
            ),
            click.option("--angle", metavar="COLUMN", help="Named: angle of each sample."),
            click.option(
                "--repeat",
                metavar="COLUMN",
                help="Named: column that numbers passes, revolutions.",
            ),
            click.option(
                "--set",
                "settings",
                multiple=True,
                metavar="NAME=VALUE",
                help='Any other key of the method (metrosep ops), "radius=25 mm"; may be repeated.',
            ),
            click.option(
                "--column",
                "columns",
                multiple=True,
                metavar="ROLE=COLUMN",
                help='Named: another column of the method, "pitch=pitch_urad"; may be repeated.',
            ),
            click.option("--unit", help="Named, maps: unit of the heights, if the file has none."),
            click.option("--channel", help="Named, maps: channel of a file that holds several."),
            click.option(
                "--lateral-step", help='Named, maps: overrides that of the file, "1 um".'
            ),
        )
    ):
        command = option(command)
    return command


def optional_read_options(command: F) -> F:
    """Add the options that say what the columns of run files are; the method decides which it needs."""
    for option in reversed(
        (
            click.option("--x", metavar="COLUMN", help='Position: x_mm or "pos:mm".'),
            click.option("--z", metavar="COLUMN", help='Reading: z_um or "probe:V".'),
            click.option(
                "--feed", metavar="COLUMN|VALUE", help='Feedrate: feed_mm_min or "7200 mm/min".'
            ),
            click.option(
                "--run",
                metavar="COLUMN",
                help="Column that distinguishes the runs; columns, if each is a column; blocks, if one stands below the other.",
            ),
            click.option(
                "--direction",
                metavar="COLUMN|WORD",
                help="Column with fwd/rev; of a list in one direction also forward or reverse.",
            ),
            click.option("--time", metavar="COLUMN", help='Time: t_s or "t:ms".'),
            click.option("--sampling-rate", metavar="RATE", help='Sampling rate, "1 kHz".'),
            click.option(
                "--scale",
                metavar="SENSITIVITY",
                help='Sensitivity, for sensors with voltage output: "2.5 um/V".',
            ),
            *(
                click.option(f"--{name.replace('_', '-')}", help=text)
                for name, text in TEXT_OPTIONS.items()
            ),
        )
    ):
        command = option(command)
    return command


def expansion_options() -> list[Callable[[F], F]]:
    """Return the options of temperature and expansion, as `Expansion` declares them."""
    from metrosep.core.options import KINDS, options_of
    from metrosep.separation.positions.expansion import Expansion

    made: list[Any] = []
    for name, declared in options_of(Expansion).items():
        words = f"{declared.help[0].upper()}{declared.help[1:]}."
        noun = {"expansion": "Coefficient of expansion", "temperature": "Temperature"}
        if declared.kind in noun and not name.startswith("u_"):
            words = f"{noun[declared.kind]} {declared.help}."
        flag = declared.kind == "flag"
        more: dict[str, Any] = (
            {"is_flag": True} if flag else {"metavar": f'"{KINDS[declared.kind].example}"'}
        )
        made.append(click.option(f"--{name.replace('_', '-')}", help=words, **more))
    return made


def with_expansion(command: F) -> F:
    """Add the options of temperature and expansion."""
    return functools.reduce(lambda c, o: o(c), reversed(expansion_options()), command)


def table_options(command: F) -> F:
    """Add the options that shape a compensation table."""
    for option in reversed(
        (
            click.option(
                "--axis",
                help="Axis whose position selects the entry. Default: axis of the result, or the one "
                "that the column of positions is called after (y_mm), or X.",
            ),
            click.option(
                "--compensates",
                metavar="AXIS",
                help="Axis that is corrected, never assumed: X itself (positioning), or Z "
                "(straightness).",
            ),
            click.option(
                "--spacing",
                help=f"Distance of the entries. Default: {USUAL_SPACING} ({USUAL_TURN}); of a list its targets.",
            ),
            click.option(
                "--cross-axis",
                type=click.Choice(["hal"]),
                help="Carry a cross-axis table through LinuxCNC's HAL.",
            ),
            click.option("--reference", metavar="LENGTH", help="Position of zero correction."),
            click.option(
                "--reference-direction",
                type=click.Choice(["forward", "reverse", "middle"]),
                help="Direction in which the reference is reached; forward by default.",
            ),
            *expansion_options(),
            click.option(
                "--table-direction",
                type=click.Choice(["auto", "both", "split", "forward", "reverse"]),
                help="Directions of the table: both in one column (both), a column for each (split), or those of "
                "one; auto splits where the error differs.",
            ),
            click.option(
                "--active",
                "--add-to",
                metavar="FILE|none",
                help="Table that was active during the measurement: the new file holds both. none: no "
                "table was.",
            ),
            click.option(
                "--machine",
                multiple=True,
                metavar="NAME=VALUE",
                help='Machine setting or limit, "count=10 nm", "stroke=5 um"; may be repeated.',
            ),
            click.option(
                "--waive",
                multiple=True,
                metavar="CHECK",
                help="Ignore the named check. The result records it.",
            ),
            click.option(
                "--sign-confirmed", is_flag=True, help="The sign was tried on this machine."
            ),
        )
    ):
        command = option(command)
    return command


def read_aloud(file: str, reading: Mapping[str, Any], *, runs: bool = False) -> Any:
    """Read a file for a command, perhaps one of runs, and print what its reader warns of, on standard error."""
    from metrosep.cli.errors import as_options, flags_of
    from metrosep.io.read import read, read_one

    obj = (read if runs else read_one)(file, **reading)
    names = flags_of(click.get_current_context().command)
    for warning in getattr(obj, "metadata", {}).get("warnings") or ():
        say(f"warning: {file}: {as_options(warning.removeprefix(f'{file}: '), names)}")
    return obj


def require_place(out: str, *, folder: bool) -> None:
    """Refuse a folder or file that cannot be written, before anything is read."""
    from metrosep.core.errors import WriteError

    target = Path(out)
    place = target if folder else target.parent
    if not folder and not place.is_dir():
        raise WriteError(
            f"{out}: the folder {place} does not exist; create it first or choose another"
        )
    there = place
    while not there.exists() and there != there.parent:
        there = there.parent
    if not there.is_dir():
        raise WriteError(f"{out}: {there} is a file, not a folder; choose another with -o")
    if not os.access(there, os.W_OK | os.X_OK):
        raise WriteError(f"{out}: you may not write in {there}; choose another with -o")


def columns_of(file: str) -> str:
    """Return the names of the columns of a table as text; empty where it is none."""
    from metrosep.core.errors import MetrosepError
    from metrosep.io.check import describe
    from metrosep.io.runs import names_of_columns

    try:
        told = describe(file)
        found = told["metadata"].get("columns") or ()
        if told["kind"] == "recording":  # its channels and its clock
            found = names_of_columns(file, {})
    except (MetrosepError, OSError):  # the file itself is refused when it is read
        return ""
    return ", ".join(str(c.get("name") if isinstance(c, dict) else c) for c in found)


def lacking_facts(controller: str, given: Iterable[str]) -> dict[str, str]:
    """Return what a controller needs and no ``--machine`` gives, by option, with what it is."""
    from metrosep.controllers.options import missing_facts, split_machine
    from metrosep.controllers.registry import find

    note_facts(controller)
    dialect = find(controller)
    known = {k.rpartition(".")[2]: v for k, v in key_values(given, "--machine").items()}
    missing = missing_facts(known, dialect.options)
    if missing:
        split_machine(known, dialect.options, controller)  # a name may be misspelt
    such = {k: f', as in --machine "{k}={v}"' for k, v in dialect.info.example.items()}
    return {f"machine {o.name}=...": f"{o.name}: {o.help}{such.get(o.name, '')}" for o in missing}


def note_facts(controller: str) -> None:
    """Keep what ``--machine`` takes for a controller, in whose words messages of this call are written."""
    from metrosep.controllers.options import LIMIT_NAMES
    from metrosep.controllers.registry import find

    context = click.get_current_context(silent=True)
    told = None if context is None else context.obj
    if told is not None:
        own = (*LIMIT_NAMES, *(o.name for o in find(controller).options))
        told["facts"] = {*told.get("facts", ()), *own}


def missing_options(missing: Sequence[str], file: str | None, *hints: str) -> click.UsageError:
    """Return the error of options that are missing, all at once, with the columns of the file."""
    names = " and ".join(f"'--{name}'" for name in missing)
    columns = columns_of(file) if file else ""
    has = f"; {Path(file or '').name} has {columns}" if columns else ""
    more = "".join(f"; {hint}" for hint in hints if hint)
    return click.UsageError(f"Missing option{'s' if len(missing) > 1 else ''} {names}{has}{more}.")


def say_next(command: str, *words: object) -> None:
    """Print the command that one would type next, as the last line."""
    say(f"next: {typed_line(command, *words)}")


def typed_line(command: str, *words: object) -> str:
    """Return a command as one types it."""
    marks = (("'" if '"' in w else '"', w) for w in map(str, words))
    typed = " ".join(w if re.fullmatch(r"[\w.,=:/*+-]+", w) else f"{q}{w}{q}" for q, w in marks)
    return f"metrosep {command} {typed}"


def preset_words(options: Mapping[str, Any]) -> list[str]:
    """Return what a preset of a machine was given, as it is typed."""
    return [
        word
        for option in ("pivot_height", "radius")
        if options[option]
        for word in (f"--{option.replace('_', '-')}", options[option])
    ]


def option_words(message: str, keys: Iterable[str]) -> str:
    """Return a message with keys of a step as options of the command that has these.

    A key that is a word of English too ("tool") is one only where it begins the message or has a value.
    """
    found = "|".join(rf"{k}\b" if "_" in k else rf"(?:(?<=^){k}\b|{k}(?= = ))" for k in keys)
    return re.sub(
        rf"(?<![-\w])({found})(?: = )?",
        lambda m: "--" + m[1].replace("_", "-") + (" " if m[0].endswith(" = ") else ""),
        message,
    )


def phase(message: str) -> None:
    """State what the command is at: shown with the elapsed time once it takes long."""
    context = click.get_current_context(silent=True)
    if context is not None and isinstance(context.obj, dict):
        context.obj["phase"] = message


def say(message: str) -> None:
    """Print a line for the person, on standard error."""
    click.echo(message, err=True)
