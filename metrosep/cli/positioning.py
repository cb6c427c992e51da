"""Lists of a positioning test for tables: targets, directions, readings of each cycle."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from metrosep.core.runset import RunSet

F = TypeVar("F", bound=Callable[..., Any])
_ROLES = ("target", "direction", "readings", "cycle")
_SENSES = ("reached-minus-target", "target-minus-reached")
_WHICH_SENSE = (
    "--deviation reached-minus-target (the axis went too far where they are positive), or --deviation "
    "target-minus-reached; it is not assumed"
)


def list_options() -> Callable[[F], F]:
    """Add the options that name the columns of a list of targets, beside --direction."""
    options = [
        click.option(
            "--target", metavar="COLUMN", help="Column of the targets of a list, target_mm."
        ),
        click.option(
            "--readings",
            metavar="COLUMN,...",
            help="Columns of the readings of a list, one for each cycle.",
        ),
        click.option(
            "--cycle", metavar="COLUMN", help="Column of the cycle of a list, if it has one."
        ),
        click.option(
            "--deviation",
            type=click.Choice(_SENSES),
            help="Sense of the deviations of a list, never assumed.",
        ),
    ]

    def decorate(command: F) -> F:
        return functools.reduce(lambda c, o: o(c), reversed(options), command)

    return decorate


def is_list(file: str, options: Mapping[str, Any]) -> bool:
    """Return whether a file is a list of targets: its columns are named, or it is of that format."""
    if options.get("target") or options.get("readings"):
        return True
    from metrosep.io.declared import Match
    from metrosep.io.source import open_file
    from metrosep.io.text.machine_tests import iso230_2_list

    path = Path(file)
    return path.is_file() and iso230_2_list.sniff(open_file(path)) is not Match.NO


def refuse_list_options(options: Mapping[str, Any]) -> None:
    """Refuse what belongs to a list of targets where something else is given."""
    for name in (*_ROLES, "deviation"):
        if options.get(name):
            raise click.UsageError(
                f"--{name} belongs to a list of targets: name --target and --readings too, or leave "
                "it out"
            )


def refuse_columns(options: Mapping[str, Any]) -> None:
    """Refuse what names columns or describes a text where a result or a map is given."""
    from metrosep.cli.shortcut import RUN_INPUT

    refuse_list_options(options)
    for name in (*RUN_INPUT, "method"):
        if options.get(name):
            raise click.UsageError(
                f"--{name.replace('_', '-')} belongs to runs, with --x and --z: leave it out"
            )


def listed_cycles(
    files: Sequence[str],
    options: Mapping[str, Any],
    reading: Mapping[str, Any],
    lacking: Mapping[str, str] = MappingProxyType({}),
) -> RunSet:
    """Return the cycles of a list of targets as runs of deviations actual - target.

    What else the call lacks, by option with its hint, is refused together with what the list lacks.
    """
    from metrosep.cli.options import missing_options
    from metrosep.cli.shortcut import RUN_INPUT
    from metrosep.core.methods import METHODS
    from metrosep.core.text_options import TEXT_OPTIONS
    from metrosep.recipe.method_run import load_inputs, sources
    from metrosep.recipe.result import POSITIONING
    from metrosep.separation.positions.pitch import cycle_runs
    from metrosep.separation.positions.positioning import (
        are_deviations,
        as_positions,
        reached,
        target_unit,
    )

    for name in (*RUN_INPUT, "method"):
        if name not in (*_ROLES, *TEXT_OPTIONS) and options.get(name):
            raise click.UsageError(
                f"--{name.replace('_', '-')} belongs to runs; a list of targets has --target, "
                "--direction, --readings, --cycle"
            )
    reading = {**reading, **{k: options[k] for k in TEXT_OPTIONS if options.get(k) is not None}}
    roles = {k: options[k] for k in _ROLES if options.get(k)}
    missing = [k for k in ("target", "direction", "readings") if k not in roles]
    if roles and missing:
        one_way = "a list of one direction: --direction forward, or reverse"
        maybe = "" if options.get("deviation") else f"readings that are deviations: {_WHICH_SENSE}"
        hints = (one_way if "direction" in missing else "", maybe, *lacking.values())
        raise missing_options([*missing, *lacking], files[0], *hints)
    if "readings" in roles:
        roles["readings"] = [c.strip() for c in roles["readings"].split(",") if c.strip()]
        twice = [c for i, c in enumerate(roles["readings"]) if c in roles["readings"][:i]]
        if twice:
            raise click.UsageError(
                f"--readings names {twice[0]} twice: a cycle that counts twice looks like one that repeats"
            )
    places = [Path(f).resolve() for f in files]
    if len(set(places)) < len(places):
        raise click.UsageError(
            "a list is named twice: readings that count twice look like ones that repeat"
        )
    data: Any = load_inputs(METHODS[POSITIONING], [Path(f) for f in files], {**roles, **reading})
    unit = target_unit(data)
    deviations = are_deviations(data)
    sense = options.get("deviation")
    if deviations and sense is None:
        lacking = {
            "deviation": f"the readings are deviations, say which: {_WHICH_SENSE}",
            **lacking,
        }
    if lacking:
        raise missing_options([*lacking], None, *lacking.values())
    if not deviations and sense is not None:
        raise click.UsageError(
            "the readings are positions reached, not deviations: leave --deviation out"
        )
    target, up, down = reached(as_positions(data, "deviation" if deviations else "position"))
    sign = -1.0 if sense == "target-minus-reached" else 1.0
    ways = (None if v is None else sign * (v - target[:, None]) for v in (up, down))
    history, _ = sources(data)
    return cycle_runs(target, *ways, unit=unit, history=history)


def listed_document(
    file: str,
    options: Mapping[str, Any],
    reading: Mapping[str, Any],
    lacking: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return a list of targets as a result holds it."""
    return cycles_document(listed_cycles([file], options, reading, lacking))


def cycles_document(runs: RunSet) -> dict[str, Any]:
    """Return the cycles of a positioning test as a result holds them."""
    from metrosep.core.provenance import history_as_dicts
    from metrosep.recipe.result import POSITIONING, SCHEMA, clean, run_records

    return {
        "schema": SCHEMA,
        "estimate": None,
        "separation": {"op": POSITIONING},
        "runs": clean(run_records(runs)),
        "provenance": history_as_dicts(runs.history),
    }
