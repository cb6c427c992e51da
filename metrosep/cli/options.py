"""Options that several commands share, and how they become arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

__all__ = [
    "file_options",
    "given_options",
    "json_option",
    "read_options",
    "say",
    "table_options",
]

F = TypeVar("F", bound=Callable[..., Any])


def json_option(command: F) -> F:
    """Add ``--json``.

    Parameters
    ----------
    command : callable
        To decorate.

    Returns
    -------
    callable
        Decorated.
    """
    return click.option(
        "as_json", "--json", is_flag=True, help="One JSON object on standard output."
    )(command)


def file_options(command: F) -> F:
    """Add the options that say how a file is to be read.

    Parameters
    ----------
    command : callable
        To decorate.

    Returns
    -------
    callable
        Decorated.
    """
    for option in (
        click.option("--unit", help="Unit of the heights where the file declares none."),
        click.option("--lateral-step", help='Overrides the lateral step of the file, "1.1 um".'),
        click.option("--channel", help="Channel of a file that holds several."),
        click.option("--as", "format", metavar="FORMAT", help="Read it as this format."),
        click.option(
            "--set",
            "settings",
            multiple=True,
            metavar="NAME=VALUE",
            help='Option of the format, "sampling_rate=2 kHz"; may be repeated.',
        ),
    ):
        command = option(command)
    return command


def given_options(settings: tuple[str, ...], **options: str | None) -> dict[str, Any]:
    """Return the options that were given, for `metrosep.io.read.read`.

    Parameters
    ----------
    settings : tuple of str
        Texts ``NAME=VALUE``.
    **options : str or None
        Others; None is left out.

    Returns
    -------
    dict
        By name.

    Raises
    ------
    UsageError
        If a setting is no NAME=VALUE.
    """
    given: dict[str, Any] = {k: v for k, v in options.items() if v is not None}
    for setting in settings:
        name, mark, value = setting.partition("=")
        if not mark or not name.strip() or not value.strip():
            raise click.UsageError(f"--set takes NAME=VALUE, found {setting!r}")
        text = value.strip()
        given[name.strip().replace("-", "_")] = int(text) if text.isdecimal() else text
    return given


def read_options(command: F) -> F:
    """Add the options that say what the columns of run files are.

    Parameters
    ----------
    command : callable
        To decorate.

    Returns
    -------
    callable
        Decorated.
    """
    for option in reversed(
        (
            click.option(
                "--x", required=True, metavar="COLUMN", help='Position: x_mm or "pos:mm".'
            ),
            click.option(
                "--z", required=True, metavar="COLUMN", help='Reading: z_um or "probe:V".'
            ),
            click.option(
                "--feed", metavar="COLUMN|VALUE", help='Feedrate: feed_mm_min or "7200 mm/min".'
            ),
            click.option("--run", metavar="COLUMN", help="Column that tells runs apart."),
            click.option("--direction", metavar="COLUMN", help="Column with fwd/rev."),
            click.option("--time", metavar="COLUMN", help='Time: t_s or "t:ms".'),
            click.option("--sampling-rate", metavar="RATE", help='Such as "1 kHz".'),
            click.option(
                "--scale", metavar="SENSITIVITY", help='Of a sensor in volts: "2.5 um/V".'
            ),
            click.option("--separator", help="Between the columns, where it is not clear."),
            click.option("--decimal", help="Decimal mark, where it is not clear."),
            click.option("--encoding", help="Of the text, where it is not clear: utf-16."),
        )
    ):
        command = option(command)
    return command


def table_options(command: F) -> F:
    """Add the options that shape a compensation table.

    Parameters
    ----------
    command : callable
        To decorate.

    Returns
    -------
    callable
        Decorated.
    """
    for option in reversed(
        (
            click.option("--axis", default="X", show_default=True, help="Axis that is looked up."),
            click.option("--compensates", metavar="AXIS", help="Axis that is corrected."),
            click.option(
                "--spacing", default="1 mm", show_default=True, help="Between the entries."
            ),
            click.option(
                "--cross-axis",
                type=click.Choice(["hal"]),
                help="Carry a cross-axis table through LinuxCNC's HAL.",
            ),
            click.option("--reference", metavar="LENGTH", help="Position of zero correction."),
        )
    ):
        command = option(command)
    return command


def say(message: str) -> None:
    """Print a line for the person, on standard error.

    Parameters
    ----------
    message : str
        Line.
    """
    click.echo(message, err=True)
