"""``metrosep separate --method NAME``: the recipe of a call with a named separation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

from metrosep.cli.options import name_values
from metrosep.cli.shortcut import input_lines, listed, of_reader, quoted, typed
from metrosep.core.readable import did_you_mean
from metrosep.core.text_options import TEXT_OPTIONS

if TYPE_CHECKING:
    from metrosep.core.methods import Method

_OF_INPUT = (
    "readings", "x", "angle", "repeat", "scale", *TEXT_OPTIONS, "unit", "channel", "lateral_step",
)  # fmt: skip
COLUMN_OPTIONS = (*_OF_INPUT, "z", "feed", "run", "direction", "time")
"""Keys of the input that have an option of their own; the others are given with ``--column``."""
_OF_RUNS = (
    "z", "feed", "run", "direction", "time", "sampling_rate", "start", "length", "shortest", "lag",
    "min_feeds", "poly", "table_", "drift", "lines", "robust",
    "exclude", "accept",
)  # fmt: skip


def require_columns(
    options: Mapping[str, Any],
    files: Sequence[str],
    lacking: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Refuse a call for repeated runs without their columns, and what else it lacks, with hints."""
    from metrosep.cli.options import missing_options
    from metrosep.core.methods import METHODS

    known = ["joint", "kono", "mean", *METHODS]
    if options["method"] not in known:
        hint = did_you_mean(options["method"], known)
        raise click.UsageError(
            f"--method {options['method']!r} is not one of joint, kono, mean, or the named "
            f"separations that 'metrosep ops' lists.{hint}"
        )
    for name in ("readings", "angle", "repeat"):
        if options.get(name):
            raise click.UsageError(
                f"--{name} belongs to a named separation, such as --method donaldson; runs have "
                "--x, --z and --run"
            )
    if options.get("columns"):
        raise click.UsageError(
            "--column belongs to a named separation; runs have --x, --z and --run"
        )
    missing = [name for name in ("x", "z") if options.get(name) is None]
    if missing and not (len(missing) == 2 and tells_runs(options, files)):
        raise missing_options([*missing, *lacking], files[0], *lacking.values())


def tells_runs(options: Mapping[str, Any], files: Sequence[str]) -> bool:
    """Return whether files tell by themselves which columns are run, position and reading."""
    from metrosep.cli.shortcut import RUN_INPUT
    from metrosep.core.errors import FormatMismatchError, UnitError
    from metrosep.io.runs import told_columns

    given = {k: options[k] for k in RUN_INPUT if options.get(k) is not None}
    try:
        return all(told_columns(file, given) for file in files)
    except (FormatMismatchError, UnitError):
        return False


def named_recipe(name: str, options: Mapping[str, Any], *, report: bool) -> str:
    """Return the recipe of a call with a named separation, as TOML."""
    from metrosep.core.methods import METHODS
    from metrosep.recipe.schema import input_fields

    method = METHODS[name]
    known = input_fields(method)
    for key in _OF_RUNS:
        if options.get(key) is not None and key not in known:
            option = key.rstrip("_").replace("_", "-")
            raise click.UsageError(
                f"--{option} belongs to repeated runs; --method {name} takes {_takes(method)}"
            )
    for key in _OF_INPUT:
        if options.get(key) and key not in known:
            raise click.UsageError(
                f"--{key.replace('_', '-')} is not read by --method {name}; it takes {_takes(method)}"
            )
    columns = dict(name_values(options.get("columns") or (), "--column"))
    settings = name_values(options.get("settings") or (), "--set")
    of_input, settings = of_reader(settings, known, method.fields)
    columns |= of_input
    lines = ["metrosep = 1", "", "[input]"]
    for key in [*known, *(k for k in columns if k not in known)]:
        value = columns.get(key, options.get(key))
        if value is not None and value != ():
            several = key in known and known[key].kind == "texts"
            lines += [f"{key} = {listed(value)}"] if several else input_lines({key: value}, [key])
    lines += ["", "[[step]]", f"op = {quoted(name)}"]
    for key, value in settings:
        lines.append(f"{key} = {typed(key, value, method.fields)}")
    if report:
        lines += ["", "[[output]]", 'kind = "parts"']
        lines += ["", "[[output]]", 'kind = "report"', 'formats = ["html"]']
    return "\n".join(lines) + "\n"


def _takes(method: type[Method]) -> str:
    """Return the options of a method, for the message on one that it does not have."""
    if method.reads == "curves":
        place = {"x": "--x", "angle": "--angle"}.get(method.over, "--x or --angle")
        return f"--readings, {place}, --repeat, --column and --set"
    roles = ", ".join(method.roles)
    return f"--column ({roles}) and --set" if roles else "--set"
