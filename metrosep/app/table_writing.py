"""Files of a table that the user asks for: the table, or a trial of its sign."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from metrosep.app.messages import plain
from metrosep.app.wanted_tables import Wanted
from metrosep.compensation.table import CompensationTable
from metrosep.compensation.trial import TrialTable, trial_table
from metrosep.controllers.base import load_bytes, load_sidecar, sidecar_path
from metrosep.core.errors import CorruptFileError, DataError, WriteError
from metrosep.core.runset import RunSet
from metrosep.core.units import parse_quantity
from metrosep.separation.base import ErrorEstimate

__all__ = ["make_trial", "trial_words", "write_file", "write_trial"]

_SCHEMA = "metrosep.table/1"


def write_file(
    wanted: Wanted,
    estimate: ErrorEstimate,
    runs: RunSet,
    target: Path,
    *,
    overwrite: bool,
) -> dict[str, Any]:
    """Write a table and its sidecar, as a run of the recipe does."""
    replaces = _replaces(target, overwrite=overwrite)
    verification = wanted.write(wanted.carried(estimate, runs), target, runs, overwrite=replaces)
    said = None if verification is None else verification.to_dict()
    return {**_files(target), "verification": plain(said)}


def make_trial(
    wanted: Wanted, estimate: ErrorEstimate, runs: RunSet, height: object
) -> TrialTable:
    """Return one bump that tells the sign on the machine, as ``metrosep table --trial`` has it."""
    if not isinstance(height, str):
        raise DataError(f"trial is a height with its unit, such as 2 um; got {height!r}")
    size = parse_quantity(height, dimension="length", name="trial")
    made = wanted.carried(estimate, runs)
    if not isinstance(made, CompensationTable):
        raise DataError("a trial has no meaning for a polynomial: its sign is stated")
    return trial_table(made, size)


def trial_words(trial: TrialTable) -> dict[str, Any]:
    """Return what a trial of the sign asks for."""
    return {
        "instruction": trial.instruction,
        "if_right": trial.if_right,
        "if_wrong": trial.if_wrong,
    }


def write_trial(
    wanted: Wanted, trial: TrialTable, target: Path, *, overwrite: bool
) -> dict[str, Any]:
    """Write a trial of the sign."""
    replaces = _replaces(target, overwrite=overwrite)
    wanted.write(trial, target, None, overwrite=replaces)
    return {**_files(target), "trial": trial_words(trial)}


def _replaces(target: Path, *, overwrite: bool) -> bool:
    """Return whether a table of metrosep is to be replaced; refuse any other file."""
    if not target.exists():
        return False
    if target.is_dir():
        raise WriteError(f"{target}: is a folder; name a file")
    if not _is_ours(target):
        raise WriteError(
            f"{target}: exists already, not written by metrosep or changed since, and a machine may be "
            "using it; choose another name"
        )
    if not overwrite:
        raise DataError(
            f"{target.name}: exists already and a machine may be using it; choose another name or "
            "overwrite it"
        )
    return True


def _is_ours(target: Path) -> bool:
    try:
        beside = load_sidecar(target)
    except CorruptFileError:
        return False
    if beside.get("schema") != _SCHEMA:
        return False
    return beside.get("file_sha256") == hashlib.sha256(load_bytes(target)).hexdigest()


def _files(target: Path) -> dict[str, Any]:
    return {
        "files": [str(target), str(sidecar_path(target))],
        "sha256": hashlib.sha256(target.read_bytes()).hexdigest(),
    }
