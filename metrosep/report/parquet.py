"""Results and the index of a batch as Parquet: the rows of the CSV files with types.

Numbers are float64 in SI, texts are UTF-8; what is not known, and an empty text, is null. The
metadata of the file hold ``metrosep_schema`` and ``metrosep_unit_columns``, a JSON object that names
for each column of numbers the column with its unit. Same document, same bytes.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any

from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.recipe import index_rows
from metrosep.report import csv_long
from metrosep.report.comparison import known_number
from metrosep.report.index import require_index
from metrosep.report.text import document_writer

SCHEMA = "metrosep.characteristics/1"
"""Of the characteristics of results."""

INDEX_SCHEMA = "metrosep.index-characteristics/1"
"""Of the index of a batch."""


def render_parquet(documents: Iterable[Mapping[str, Any]]) -> bytes:
    """Return results in the long form as the bytes of a Parquet file.

    Parameters
    ----------
    documents : iterable of mapping
        Contents of result.json.

    Returns
    -------
    bytes
        Columns and rows of `metrosep.report.render_csv`, numbers to the same bits.

    Raises
    ------
    DataError
        If a result is damaged.
    UnsupportedFeatureError
        If pyarrow is not installed.
    """
    rows = list(csv_long.long_rows(documents))
    return _table(csv_long.COLUMNS, rows, csv_long.NUMBERS, SCHEMA)


write_parquet = document_writer(
    "write_parquet", lambda document: render_parquet([document]), "the characteristics of a result",
    DataError="If the result is damaged.", UnsupportedFeatureError="If pyarrow is not installed.",
)  # fmt: skip


def render_index_parquet(document: Mapping[str, Any]) -> bytes:
    """Return the index of a batch as the bytes of a Parquet file.

    Parameters
    ----------
    document : mapping
        Content of an index.json (schema ``metrosep.index/1``).

    Returns
    -------
    bytes
        Columns and rows of index.csv: one for each characteristic, one for each unit without any.

    Raises
    ------
    DataError
        If it is not an index, or is damaged.
    UnsupportedFeatureError
        If pyarrow is not installed.
    """
    require_index(document)
    try:
        names, rows = index_rows.index_columns(document), list(index_rows.index_rows(document))
    except (AttributeError, KeyError, TypeError) as exc:
        raise DataError(f"the index has no {exc}; it is damaged, run the batch again") from exc
    return _table(names, rows, index_rows.NUMBERS, INDEX_SCHEMA)


write_index_parquet = document_writer(
    "write_index_parquet", render_index_parquet, "the index of a batch", of="index.json",
    DataError="If it is not an index, or is damaged.",
    UnsupportedFeatureError="If pyarrow is not installed.",
)  # fmt: skip


def _table(
    names: Sequence[str], rows: Sequence[Sequence[Any]], numbers: frozenset[str], schema: str
) -> bytes:
    arrow, parquet = _pyarrow()
    columns = []
    for i, name in enumerate(names):
        values = [row[i] for row in rows]
        if name in numbers:
            columns.append(arrow.array([known_number(v, name) for v in values], arrow.float64()))
        else:
            columns.append(arrow.array([_text(v) for v in values], arrow.string()))
    units = {name: "unit" for name in names if name in numbers}
    metadata = {"metrosep_schema": schema, "metrosep_unit_columns": json.dumps(units)}
    table = arrow.table(columns, names=list(names)).replace_schema_metadata(metadata)
    stream = io.BytesIO()
    # stated, so that another version of pyarrow does not choose otherwise
    parquet.write_table(table, stream, version="2.6", compression="snappy")
    return stream.getvalue()


def _text(value: Any) -> str | None:
    """Return a text as it is, None for an empty one; a name that is not UTF-8 keeps its marks."""
    if value is None or value == "":
        return None
    return str(value).encode("utf-8", "backslashreplace").decode("utf-8")


def _pyarrow() -> tuple[Any, Any]:
    try:
        return import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError:
        raise UnsupportedFeatureError(
            "Parquet files need pyarrow, which is not installed; install it: pip install "
            '"metrosep[parquet]"'
        ) from None
