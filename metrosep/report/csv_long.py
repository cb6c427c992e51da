"""Results in the long form: one line for each characteristic of each file, as statistics want it."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from metrosep.core.limits import STATUS_OF_VERDICT
from metrosep.report.text import cell_text, characteristic_rows, document_writer, one_line

COLUMNS = (
    "file", "part", "serial", "characteristic", "value", "unit", "lower", "upper", "U", "verdict",
    "metric", "u", "guard", "status", "recipe",
)  # fmt: skip
"""The first line; the numbers of a line are in its unit, which is an SI unit.

``status`` is that of the whole result, ``recipe`` its hash: by meaning where a batch wrote it, of the
text otherwise.
"""

NUMBERS = frozenset({"value", "lower", "upper", "U", "u", "guard"})
"""Columns that hold numbers, in the unit of the column ``unit``; the others hold texts."""


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
    writer.writerows([_cell(v) for v in row] for row in long_rows(documents))
    return buffer.getvalue()


def long_rows(documents: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str | float | None, ...]]:
    """Yield the rows that every file in the long form holds."""
    for document in documents:
        tail = (
            STATUS_OF_VERDICT.get(str(document.get("verdict")), "measured"),
            _recipe_of(document),
        )
        for row in characteristic_rows(document):
            yield (
                *(row.file, row.part, row.serial, row.name, row.value, row.unit),
                *(row.lower, row.upper, row.U, row.verdict, row.metric, row.u, row.guard),
                *tail,
            )


write_csv = document_writer(
    "write_csv", lambda document: render_csv([document]), "the characteristics of a result",
    DataError="If the result is damaged.",
)  # fmt: skip


def _recipe_of(document: Mapping[str, Any]) -> str:
    places = ((document.get("unit"), "recipe_sha256"), (document.get("recipe"), "sha256"))
    found = [p[k] for p, k in places if isinstance(p, Mapping) and p.get(k)]
    return one_line(found[0]) if found else ""


def _cell(value: str | float | None) -> str:
    if value is None:
        return ""
    return cell_text(value) if isinstance(value, str) else repr(value)
