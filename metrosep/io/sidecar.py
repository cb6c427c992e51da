"""Measurements that take several files: the one that belongs to another, found by its stem only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from metrosep.core.errors import CorruptFileError, ReadError
from metrosep.core.provenance import Step
from metrosep.io.logger import text_lines, to_number
from metrosep.io.source import RawFile, open_file

__all__ = ["also_read", "beside", "number_rows"]


def also_read(data: RawFile, **parameters: Any) -> Step:
    """Return the step of a history that says which file was read beside the one of that name."""
    facts = {"file": data.name, "sha256": data.sha256, "size": data.size}
    return Step("read_columns", {**facts, **parameters})


def beside(file: RawFile, suffixes: Sequence[str]) -> RawFile:
    """Return the file of the same stem in the same folder; content never names it."""
    for suffix in suffixes:
        path = file.path.with_suffix(suffix)
        if path.name != file.name and path.is_file():
            return open_file(path)
    raise ReadError(
        f"{file.path}: describes {file.path.with_suffix(suffixes[0]).name}, which does not lie beside "
        "it; put both into one folder"
    )


def number_rows(
    file: RawFile, data: RawFile, *, skip: int = 0
) -> tuple[list[int], list[list[float]]]:
    """Return rows of numbers between blanks, all of one length."""
    lines = text_lines(data)[skip:]
    rows = [(n, s.split()) for n, s in enumerate(lines, start=skip + 1) if s.strip()]
    if not rows:
        raise CorruptFileError(
            file.path, f"there are no rows in {data.name}", field=f"line {skip + 1}"
        )
    width = len(rows[0][1])
    numbers = []
    for line, fields in rows:
        if len(fields) != width:
            raise CorruptFileError(
                file.path,
                f"a row has another length in {data.name}",
                field=f"line {line}",
                expected=width,
                found=len(fields),
                hint="check how many lines stand above the rows, or copy both files again",
            )
        name = f"a column of {data.name}"
        numbers.append([to_number(file, f, line=line, name=name) for f in fields])
    return [n for n, _ in rows], numbers
