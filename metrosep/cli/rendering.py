"""The reports of one result, in this process or in a worker of `metrosep report`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["TOGETHER", "RenderTask", "Rendered", "Writer", "rendered"]

TOGETHER = frozenset({"csv", "parquet"})
"""Formats that hold all results in one file."""

Writer = Callable[[Mapping[str, Any], Path], Any]


@dataclass(frozen=True, slots=True)
class RenderTask:
    """The reports of one result."""

    file: Path  # the result
    name: str  # of the reports, without ending
    folder: Path  # for the reports
    writers: Mapping[str, Writer]  # mapping of str to callable: by format
    alone: bool  # whether it is the only result, so that the long forms are its own too


@dataclass(frozen=True, slots=True)
class Rendered:
    """What became of it."""

    written: tuple[Path, ...] = ()  # the reports
    # mapping: the result, where the caller writes it into a file with others
    document: Mapping[str, Any] | None = None
    unread: str = ""  # why the result could not be read, if it could not
    missing: str = ""  # what is not installed or cannot be written at all, if so


def rendered(task: RenderTask) -> Rendered:
    """Write the reports of one result; what is wrong with it is told with its name."""
    from metrosep.core.errors import (
        CorruptFileError,
        DataError,
        ReadError,
        UnsupportedFeatureError,
    )
    from metrosep.recipe.result import load_document
    from metrosep.report.csv_long import long_rows

    try:
        document = load_document(task.file)
    except ReadError as exc:
        return Rendered(unread=str(exc))
    written: list[Path] = []
    shared = None
    for kind, write in task.writers.items():
        target = task.folder / f"{task.name}.{kind}"
        try:
            if kind in TOGETHER and not task.alone:
                list(long_rows([document]))  # written by the caller; what is damaged is told here
                shared = document
                continue
            write(document, target)
        except UnsupportedFeatureError as exc:
            return Rendered(tuple(written), missing=str(exc))
        except (DataError, AttributeError, KeyError, TypeError, ValueError) as exc:
            told = CorruptFileError(
                task.file, f"no {kind} can be made of it: {exc}", hint="run the recipe again"
            )
            return Rendered(tuple(written), unread=str(told))
        written.append(target)
    return Rendered(tuple(written), shared)
