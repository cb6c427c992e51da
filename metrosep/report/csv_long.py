"""Results in the long form: one line for each characteristic of each file, as statistics want it."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.report.rows import CharacteristicRow, cell_text, characteristic_rows

__all__ = ["COLUMNS", "render_csv", "write_csv"]

COLUMNS = (
    "file", "part", "serial", "characteristic", "value", "unit", "lower", "upper", "U", "verdict",
    "metric", "u", "guard", "status", "recipe",
)  # fmt: skip
"""The first line; the numbers of a line are in its unit, which is an SI unit.

``status`` is that of the whole result, ``recipe`` its hash: by meaning where a batch wrote it, of the
text otherwise.
"""

_STATUS = {"accept": "accepted", "reject": "rejected", "inconclusive": "inconclusive"}


def render_csv(documents: Iterable[Mapping[str, Any]]) -> str:
    """Return results as CSV.

    Parameters
    ----------
    documents : iterable of mapping
        Contents of result.json.

    Returns
    -------
    str
        Comma separated, CRLF, decimal points, numbers that read back to the same bits; a value that
        is not known is an empty cell.

    Raises
    ------
    DataError
        If a result is damaged.

    Examples
    --------
    >>> entry = {"metric": "Sq", "value": 6e-9, "unit": "m", "upper": 8e-9}
    >>> render_csv([{"characteristics": [entry]}]).splitlines()[1]
    ',,,Sq,6e-09,m,,8e-09,,,Sq,,,measured,'
    """
    buffer = io.StringIO(newline="")
    writer = csv.writer(buffer, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    for document in documents:
        tail = [_STATUS.get(str(document.get("verdict")), "measured"), _recipe_of(document)]
        for row in characteristic_rows(document):
            writer.writerow([*_cells(row), *tail])
    return buffer.getvalue()


def write_csv(document: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
    """Write the characteristics of a result.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    path : str or path
        File.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If the result is damaged.
    WriteError
        If it cannot be written.
    """
    return atomic_write(path, render_csv([document]).encode("utf-8"))


def _recipe_of(document: Mapping[str, Any]) -> str:
    places = ((document.get("unit"), "recipe_sha256"), (document.get("recipe"), "sha256"))
    found = [p[k] for p, k in places if isinstance(p, Mapping) and p.get(k)]
    return cell_text(found[0]) if found else ""


def _cells(row: CharacteristicRow) -> list[str]:
    texts = (row.file, row.part, row.serial, row.name)
    judged = row.verdict or ""
    limits = (row.lower, row.upper, row.U)
    return [
        *(cell_text(t) for t in texts),
        _number(row.value),
        row.unit,
        *(_number(n) for n in limits),
        judged,
        cell_text(row.metric),
        _number(row.u),
        _number(row.guard),
    ]


def _number(value: float | None) -> str:
    return "" if value is None else repr(value)
