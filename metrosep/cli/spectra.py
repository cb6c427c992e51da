"""Command that compares a spectrum with a limit: psd."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from metrosep.cli.options import INPUT_KEYS, file_options, json_option, phase, read_aloud, say
from metrosep.cli.shortcut import input_lines, option_error, quoted


@click.command()
@click.argument("file")
@click.option(
    "--limit",
    required=True,
    metavar="LIMIT",
    help='"A = 0.02 um^3, B = 2 from 0.1 mm to 5 mm" (PSD = A / f^B, f in 1/um; "nm^2 mm": f in '
    '1/mm), or "rms = 5 nm from 0.1 mm to 5 mm".',
)
@click.option(
    "--form", "form_text", default="plane", show_default=True, help="Form to remove first."
)
@click.option(
    "--max-filled",
    default=0.1,
    show_default=True,
    help="Largest share of holes that may be filled.",
)
@click.option(
    "--estimate",
    type=click.Choice(["auto", "heights", "slopes"]),
    default="auto",
    show_default=True,
    help="What is transformed; auto: slopes where the spectrum falls faster than 1/f.",
)
@click.option("-o", "--out", metavar="DIR", help="Folder for the report and result.json.")
@file_options
@json_option
def psd(
    file: str,
    limit: str,
    form_text: str,
    max_filled: float,
    estimate: str,
    out: str | None,
    reading: dict[str, Any],
    as_json: bool,
) -> int:
    """Compare the power spectrum of FILE, a map with any outline or a profile, with a limit (ISO 10110-8).

    The exit code is 0 accepted, 1 rejected, 3 inconclusive.
    """
    from metrosep.cli.errors import verdict_code
    from metrosep.core.errors import RecipeError
    from metrosep.recipe.pipeline_run import measure_object
    from metrosep.recipe.recipe import Recipe

    lines = ["metrosep = 1", "", "[input]", f"files = [{quoted(file)}]"]
    lines += input_lines(reading, INPUT_KEYS)
    if form_text.strip().lower() != "none":
        lines += ["", "[[step]]", 'op = "form"', f"form = {quoted(form_text)}"]
    lines += [
        "",
        "[[step]]",
        'op = "psd"',
        f"limit = {quoted(limit)}",
        f"max_filled = {max_filled}",
        f"estimate = {quoted(estimate)}",
    ]
    lines += ["", "[[check]]", 'metric = "PSD"', "", "[[output]]", 'kind = "report"', ""]
    try:
        recipe = Recipe.parse("\n".join(lines), name="command line")
    except RecipeError as exc:
        said = option_error(exc).replace(": limit: ", ": ", 1)
        raise click.UsageError(said, ctx=click.get_current_context()) from None
    try:
        measured = measure_object(recipe, read_aloud(file, reading))
    except RecipeError as exc:
        raise RecipeError(option_error(exc)) from None
    found = measured.stages[-1].detail
    bands = measured.stages[-1].audit["bands"]
    if as_json:
        content = {
            "file": Path(file).name,
            "limit": found.limit.text,
            "verdict": found.verdict,
            "sentence": found.sentence,
            "notes": list(found.notes),
            **measured.stages[-1].audit,
        }
        click.echo(json.dumps(content, sort_keys=True, allow_nan=False))
    else:
        taken = measured.stages[-1].audit["estimate"]
        click.echo(f"{Path(file).name}: {found.limit.text}, spectrum from {taken}")
        click.echo("  wavelengths / mm      density / limit   verdict")
        for band in bands:
            low, high = (1e3 * w for w in band["wavelength_m"])
            click.echo(
                f"  {low:9.4g} to {high:<9.4g} {band['ratio']:12.3g}       {band['verdict']}"
            )
        click.echo(f"  {found.sentence}")
        for note in found.notes:
            click.echo(f"  note: {note}")
        click.echo(f"  verdict: {found.verdict}")
    if out is not None:
        for path in recipe.run([file], out=out, progress=phase).files:
            say(f"{'report' if path.suffix == '.html' else 'result':8} {path}")
    return verdict_code(found.verdict)
