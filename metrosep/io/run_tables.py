"""The columns from which runs are cut, whatever format the file is: text, logger or metrosep's own."""

from __future__ import annotations

from typing import Any

import numpy as np

from metrosep.core.errors import AmbiguousFormatError, FormatMismatchError, UnknownFormatError
from metrosep.core.recording import Recording
from metrosep.core.runset import RunSet
from metrosep.core.units import parse_unit
from metrosep.io import registry
from metrosep.io.source import RawFile
from metrosep.io.table import Column, Table, read_table

__all__ = ["TIME", "columns_of", "stored_runs"]

TIME = "t_s"
"""Name of the column of time of a recording."""

_OWN = "metrosep-h5"
_TEXT = "delimited"


def stored_runs(file: RawFile) -> RunSet | None:
    """Return the runs of a file that metrosep wrote as a whole, else ``None``."""
    if _format(file) != _OWN:
        return None
    from metrosep.io.native import read

    obj = read(file)
    if isinstance(obj, RunSet):
        return obj
    if isinstance(obj, Recording):
        return None
    raise FormatMismatchError(
        f"{file.path}: holds a {type(obj).__name__.lower()}, not runs; use metrosep.read"
    )


def columns_of(file: RawFile, layout: dict[str, Any]) -> tuple[Table, str]:
    """Return the columns of a file and the format that they were read as."""
    known = _format(file)
    if known in (None, _TEXT):
        return read_table(file, **layout), _TEXT
    if layout:
        raise FormatMismatchError(
            f"{file.path}: is recognised as {known}, which takes no {next(iter(layout))}; leave it out"
        )
    obj = registry.get(str(known)).load_reader().read(file)
    if not isinstance(obj, Recording):
        raise FormatMismatchError(
            f"{file.path}: holds a {type(obj).__name__.lower()} ({known}), not channels over time; runs "
            "are cut from recordings and tables"
        )
    columns = [Column(TIME, parse_unit("s"), obj.t)]
    for name, values in obj.channels.items():
        unit = obj.units.get(name)
        columns.append(Column(name, parse_unit(unit) if unit else None, values))
    warnings = tuple(obj.metadata.get("warnings", ()))
    lines = np.arange(1, len(obj) + 1, dtype=np.int64)
    return Table(tuple(columns), lines, {}, warnings), str(known)


def _format(file: RawFile) -> str | None:
    try:
        return registry.find(file).id
    except (UnknownFormatError, AmbiguousFormatError):
        return None
