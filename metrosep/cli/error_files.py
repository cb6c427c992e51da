"""Error terms of a machine that commands take: files, and folders that 'calibrate' wrote."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click


def terms_of(
    files: Sequence[str], kinds: Mapping[str, str]
) -> tuple[Any, dict[str, tuple[float, float]]]:
    """Return the error terms of files, and how far each axis is known by all of its terms.

    What the reader of a table warns of is printed.
    """
    from metrosep.cli.options import say
    from metrosep.io.term_files import read_term_table
    from metrosep.machine.elements import axis_of
    from metrosep.machine.error_sets import ErrorSet

    values: dict[str, Any] = {}
    spreads: dict[str, str] = {}
    known: dict[str, list[tuple[float, float]]] = {}
    for file in _term_files(files):
        notes: list[str] = []
        is_list = file.endswith(".toml")
        read = _of_toml(file, spreads) if is_list else read_term_table(file, kinds, notes)
        for note in notes:
            say(f"note: {note}")
        for name, (value, span) in read.items():
            if name in values:
                raise click.UsageError(f"{file}: {name} is given twice")
            values[name] = value
            axis = axis_of(name)
            if span is not None and axis is not None:
                known.setdefault(axis, []).append(span)
    common = {a: (max(s[0] for s in v), min(s[1] for s in v)) for a, v in known.items()}
    return ErrorSet(values, u=spreads), common


def _term_files(given: Sequence[str]) -> list[str]:
    """Return the files, those of a folder that 'calibrate' or 'identify' wrote in its place."""
    found: list[str] = []
    for file in given:
        folder = Path(file)
        if not folder.is_dir():
            found.append(file)
            continue
        found += _calibrated(folder)
    return found


def _calibrated(folder: Path) -> list[str]:
    """Return the files of the terms that the calibration of a folder found; older ones are not its own."""
    from metrosep.core.errors import DataError
    from metrosep.io.term_files import term_file

    try:
        terms = json.loads((folder / "calibration.json").read_text("utf-8"))["terms"]
    except (OSError, ValueError, KeyError, TypeError):
        raise click.UsageError(
            f"{folder} is a folder without calibration.json and its terms: give a folder that 'calibrate' "
            "wrote, or the files of errors"
        ) from None
    found = []
    files: dict[str, bool] = {}
    for name, term in terms.items():
        file = term_file(name, is_constant=term["basis"] == "constant")
        files[file] = files.get(file, False) or term["values"] is not None
    for file, is_known in files.items():
        if (folder / file).is_file():
            found.append(str(folder / file))
        elif is_known:
            raise DataError(f"{folder / file}: the calibration names it, and it is not there")
    return found


def _of_toml(
    file: str, spreads: dict[str, str]
) -> dict[str, tuple[Any, tuple[float, float] | None]]:
    """Return constants, and results of separations, of a TOML file; u of constants join the spreads."""
    from metrosep.core.errors import DataError
    from metrosep.machine.chain_files import toml_table
    from metrosep.recipe.result import load_document, stored_estimate

    found: dict[str, tuple[Any, tuple[float, float] | None]] = {}
    for name, value in toml_table(file).items():
        if not isinstance(value, str):
            raise DataError(
                f'{file}: {name} = {value!r}; a text is needed: a value with its unit, "2 um", or a result, '
                '"folder/result.json"'
            )
        if value.endswith(".json"):
            estimate = stored_estimate(load_document(Path(file).parent / value))
            found[name] = (estimate, estimate.fit_range)
        else:
            found[name] = (value, None)
    for key in [k for k in found if k.startswith("u_")]:
        name = key.removeprefix("u_")
        if name not in found or found[name][1] is not None or found[key][1] is not None:
            raise DataError(f"{file}: {key} is the uncertainty of a constant that is not there")
        spreads[name] = found.pop(key)[0]
    return found
