"""Command verify-softgauge: our parameters against those that a software gauge expects."""

from __future__ import annotations

import json
from typing import Any

import click

from metrosep.cli.options import file_options, json_option, read_aloud

__all__ = ["verify_softgauge"]

_CODES = {"verified": 0, "differs": 1, "not verified": 3}


@click.command("verify-softgauge")
@click.argument("file")
@click.option("--lambda-c", metavar="LENGTH", help="Cut-off, where the file names none.")
@click.option(
    "--kind",
    type=click.Choice(["P", "W", "R"]),
    default="P",
    show_default=True,
    help="What the profile in the file is; R: it is filtered already.",
)
@click.option("--edition", default="ISO 4287:1997", show_default=True)
@click.option("--sections", type=int, help="Sampling lengths; as many as fit if omitted.")
@click.option("--centre", is_flag=True, help="Subtract the means again.")
@click.option("--line", type=click.Choice(["lsq", "secant"]), default="lsq", show_default=True)
@click.option(
    "--relative-tolerance", default=0.0, show_default=True, help="Added, share of the value."
)
@file_options
@json_option
def verify_softgauge(
    file: str,
    lambda_c: str | None,
    kind: Any,
    edition: str,
    sections: int | None,
    centre: bool,
    line: str,
    relative_tolerance: float,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Compare our parameters with those that a software gauge FILE (ISO 5436-2 .smd) expects.

    The exit code is 0 when all agree, 1 when one does not, 3 when nothing is proved: a value was
    not compared, or heights are missing. A wrong checksum is told with the result.
    """
    from pathlib import Path

    from metrosep.core.errors import InvalidSamplesError
    from metrosep.core.profile import Profile
    from metrosep.core.units import parse_quantity
    from metrosep.parameters.softgauge import verify_softgauge as compare

    cutoff = (
        None if lambda_c is None else parse_quantity(lambda_c, dimension="length", name="lambda_c")
    )
    profile = read_aloud(file, reading)
    if not isinstance(profile, Profile):
        raise InvalidSamplesError(
            f"{file}: a software gauge is a profile, this is {type(profile).__name__}"
        )
    found = compare(
        profile,
        lambda_c=cutoff,
        kind=kind,
        edition=edition,
        sections=sections,
        centre=centre,
        line=line,
        relative_tolerance=relative_tolerance,
    )
    if as_json:
        content = {"file": Path(file).name, **found.to_dict()}
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    else:
        for row in found:
            click.echo(_gauge_line(row))
        click.echo(f"result {found.result}, {found.n_agree} of {len(found)} agree")
        for reason in found.reasons:
            click.echo(f"  {reason}")
    return _CODES[found.result]


def _gauge_line(row: Any) -> str:
    from metrosep.core.units import format_engineering

    head = f"{row.expected.symbol:<6} expected {row.expected.printed:<16}"
    if row.agrees is None:
        return f"{head} not compared: {row.reason}"
    computed = format_engineering(row.computed, row.unit, digits=7)
    off = format_engineering(row.deviation, row.unit, digits=3)
    allowed = format_engineering(row.tolerance, row.unit, digits=3)
    word = "agrees" if row.agrees else "DIFFERS"
    return f"{head} computed {computed:<14} off by {off} (allowed {allowed})  {word}"
