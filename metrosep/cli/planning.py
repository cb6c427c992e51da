"""``metrosep plan``: feedrates of the next runs, from the disturbance that a result holds."""

from __future__ import annotations

import json
import re
from typing import Any

import click

from metrosep.cli.options import json_option, say

_DIMENSIONS = {
    "v_min": "speed",
    "v_max": "speed",
    "length": "length",
    "settle_distance": "length",
    "max_time": "time",
}


@click.command()
@click.argument("result")
@click.option("--v-min", required=True, metavar="SPEED", help='Slowest feedrate: "1000 mm/min".')
@click.option("--v-max", required=True, metavar="SPEED", help='Fastest feedrate: "9600 mm/min".')
@click.option("--runs", "n_runs", type=int, required=True, metavar="N", help="Runs to plan.")
@click.option(
    "--wavelengths",
    required=True,
    metavar="LENGTH,...",
    help='Waves that matter: "10 mm,5 mm"; a range: "2 mm..20 mm".',
)
@click.option("--length", metavar="LENGTH", help="Travel of a run; as measured if omitted.")
@click.option(
    "--settle-distance",
    metavar="LENGTH",
    help="Part of the travel that is lost while the axis settles.",
)
@click.option("--max-time", metavar="TIME", help="Longest travel time of all runs together.")
@click.option(
    "--min-ratio",
    type=float,
    metavar="RATIO",
    help="Smallest ratio of two different feedrates. Default: 1.1.",
)
@json_option
@click.pass_context
def plan(
    context: click.Context,
    /,
    result: str,
    wavelengths: str,
    n_runs: int,
    as_json: bool,
    **options: Any,
) -> int:
    """Plan the feedrates of the next runs from RESULT (result.json of 'metrosep separate').

    At the planned feedrates the disturbance that was found leaves each wavelength as well known as
    possible; the predicted standard deviations tell how well.
    """
    from metrosep.recipe.methods.plan import plan_after, plan_document
    from metrosep.recipe.result import clean, load_document, stored_estimate

    if context.obj is not None:
        context.obj["words"] = _words
    given = {
        name: _parsed(value, _DIMENSIONS[name], name) if name in _DIMENSIONS else value
        for name, value in options.items()
        if value is not None
    }
    estimate = stored_estimate(load_document(result))
    found = plan_after(estimate, {**given, "n_runs": n_runs, "wavelengths": _waves(wavelengths)})
    document = plan_document(found)
    if as_json:
        kept = {k: v for k, v in document.items() if k != "charts"}
        kept["messages"] = [_words(m) for m in document["messages"]]
        click.echo(json.dumps(clean(kept), sort_keys=True, allow_nan=False))
        return 0
    for feed, number in document["runs"]:
        say(f"{number} run(s) at {feed:.6g} mm/min")
    columns = document["sd"]
    names = ("wavelength_mm", "sd_nm", "sd_geometric_feeds_nm", "sd_one_feed_nm")
    for wave, sd, even, one in zip(*(columns[k] for k in names), strict=True):
        say(
            f"{wave:.6g} mm: sd {_nm(sd)}; feedrates in equal ratios {_nm(even)}; all at the middle "
            f"feedrate {_nm(one)}"
        )
    for message in document["messages"]:
        say(f"note: {_words(message)}")
    return 0


def _words(message: str) -> str:
    """Return a message of the planner with the options of this command."""
    from metrosep.core.readable import readable_text

    def option(found: re.Match[str]) -> str:
        name = {"n_runs": "runs"}.get(found.group(1), found.group(1)).replace("_", "-")
        return f"--{name} " if found.group(2) else f"--{name}"

    names = "|".join([*_DIMENSIONS, "n_runs", "wavelengths", "min_ratio"])
    named = rf"(?<![\w\-])({names})( = |=)"
    spelled = r"(?<![\w\-])(v_min|v_max|n_runs|settle_distance|max_time|min_ratio)\b(?=())"
    return re.sub(spelled, option, re.sub(named, option, readable_text(message)))


def _nm(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3g} nm"


def _parsed(text: str, dimension: str, name: str) -> float:
    from metrosep.core.errors import UnitError
    from metrosep.core.units import parse_quantity

    try:
        return parse_quantity(text, dimension=dimension)
    except UnitError as exc:
        raise click.UsageError(f"--{name.replace('_', '-')}: {exc}") from None


def _waves(text: str) -> dict[str, float] | tuple[float, ...]:
    ends = text.split("..")
    if len(ends) == 2:
        low, high = sorted(_parsed(e.strip(), "length", "wavelengths") for e in ends)
        return {"shortest": low, "longest": high}
    return tuple(_parsed(w.strip(), "length", "wavelengths") for w in text.split(","))
