"""Results in the Q-DAS ASCII transfer format (AQDEF), one .dfq file with description and values.

A line is ``Knnnn value``, or ``Knnnn/i value`` for characteristic i from 1. Values follow, one line for
each result: characteristics are separated by 0x0F, the fields of one by 0x14 (value, attribute,
date and time, events, batch). Attribute 0 is a valid value, 256 is not measured.

Fields: K0100 number of characteristics; K1001 part number, K1002 description, K1900 remark with the
hashes; K2001 number, K2002 name, K2004 kind (0, a variable), K2022 decimals, K2110 and K2111 lower and
upper limit, K2142 unit, K2900 remark with definition, U and guard band.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from decimal import Decimal
from typing import Any

from metrosep.core.errors import DataError
from metrosep.core.readable import readable_unit
from metrosep.recipe.report_fields import measured_at
from metrosep.report.text import (
    CharacteristicRow,
    characteristic_rows,
    decimals_for,
    document_writer,
    exchange_names,
    one_line,
    printing,
)

_BETWEEN, _FIELD = "\x0f", "\x14"
_VALID, _NOT_MEASURED = "0", "256"
_ENCODING = "cp1252"
_UNITS = {"m": ("nm", 1e-9), "rad": ("urad", 1e-6), "s": ("ms", 1e-3)}
"""Of values without limits: the same for every part, whatever its value."""

_SHORT, _NUMBER, _TEXT, _REMARK = 20, 40, 80, 255
"""Letters that a field of each kind holds."""


def render_dfq(documents: Sequence[Mapping[str, Any]]) -> bytes:
    """Return results as a .dfq file.

    Parameters
    ----------
    documents : sequence of mapping
        Contents of result.json, all with the same characteristics and limits.

    Returns
    -------
    bytes
        Windows-1252, CRLF; a character outside of it is a question mark.

    Raises
    ------
    DataError
        If there is no result or no characteristic, a result is damaged, or the results do not have
        the same characteristics.

    Notes
    -----
    A value has the unit of its limits, else nm, urad or ms: the same for all parts, so that they can
    be put together. 15 digits are written; K2022 says how many mean something. The third field of a value
    is the last moment of measuring, as the report or the file states it; empty where neither does. The
    serial is given as batch. Field numbers and
    lengths follow descriptions of version 12 by others; the official text was not at hand.
    """
    if not documents:
        raise DataError("a .dfq file needs at least one result, got none")
    all_rows = [characteristic_rows(d) for d in documents]
    first = all_rows[0]
    if not first:
        raise DataError("this result holds no characteristic, so there is nothing for a .dfq file")
    for number, rows in enumerate(all_rows[1:], start=2):
        _require_same(first, rows, number)
    scales = [_scale(row) for row in first]
    lines = [*_head(documents, first), *_description(first, scales)]
    lines += [
        _values(rows, scales, _moment(document))
        for document, rows in zip(documents, all_rows, strict=True)
    ]
    return ("\r\n".join(lines) + "\r\n").encode(_ENCODING, errors="replace")


write_dfq = document_writer(
    "write_dfq", lambda document: render_dfq([document]), "a result as a .dfq file",
    DataError="If the result is damaged or holds no characteristic.",
)  # fmt: skip


def _require_same(
    first: Sequence[CharacteristicRow], rows: Sequence[CharacteristicRow], number: int
) -> None:
    described = [
        [
            (r.metric, name, r.unit, r.lower, r.upper)
            for r, name in zip(x, exchange_names(x), strict=True)
        ]
        for x in (first, rows)
    ]
    if described[0] == described[1]:
        return
    odd = next((b for a, b in zip(*described, strict=False) if a != b), None)
    what = f"{len(rows)} characteristics, not {len(first)}" if odd is None else f"{odd[0]!r}"
    raise DataError(
        f"result {number} does not have the characteristics and limits of the first ({what}); write "
        "a .dfq file for each recipe"
    )


def _head(
    documents: Sequence[Mapping[str, Any]], rows: Sequence[CharacteristicRow]
) -> Iterator[str]:
    document = documents[0]
    recipe = document.get("recipe") or {}
    hashes = [f"recipe {str(recipe.get('sha256') or 'none')[:12]}"]
    if len(documents) == 1:
        hashes += [f"input {str(i.get('sha256'))[:12]}" for i in document.get("inputs") or []]
    part = rows[0].part or (rows[0].file if len(documents) == 1 else "") or "not named"
    yield f"K0100 {len(rows)}"
    yield _line("K1001", part, _NUMBER)
    yield _line("K1002", document.get("title") or part, _TEXT)
    yield _line("K1900", f"metrosep {document.get('metrosep')}; {'; '.join(hashes)}", _REMARK)


def _description(
    rows: Sequence[CharacteristicRow], scales: Sequence[tuple[str, float]]
) -> Iterator[str]:
    names = exchange_names(rows, _TEXT)
    for i, (row, name, (unit, factor)) in enumerate(
        zip(rows, names, scales, strict=True), start=1
    ):
        yield _line(f"K2001/{i}", str(i), _SHORT)
        yield _line(f"K2002/{i}", name, _TEXT)
        yield f"K2004/{i} 0"
        yield f"K2022/{i} {_decimals(row, factor)}"
        for field, limit in (("K2110", row.lower), ("K2111", row.upper)):
            if limit is not None:
                yield f"{field}/{i} {_scaled(limit, factor)}"
        if unit != "1":
            yield _line(f"K2142/{i}", unit, _SHORT)
        yield _line(f"K2900/{i}", _remark(row, unit, factor), _REMARK)


def _remark(row: CharacteristicRow, unit: str, factor: float) -> str:
    tail = "" if unit == "1" else f" {unit}"
    texts = [f"metric {row.metric}"]
    for name, value in (("U", row.U), ("guard band", row.guard)):
        if value is not None:
            texts.append(f"{name} {_plain(float(f'{value / factor:.3g}'))}{tail}")
    return "; ".join([*texts, row.definition] if row.definition else texts)


def _moment(document: Mapping[str, Any]) -> str:
    """Return the last moment of measuring as DD.MM.YYYY/HH:MM:SS; empty where nobody states it.

    Examples
    --------
    >>> _moment({"report": {"measured": "2026-03-04"}}), _moment({})
    ('04.03.2026/00:00:00', '')
    """
    stated = (document.get("report") or {}).get("measured") or measured_at(document)
    if not stated:
        return ""
    try:
        moment = datetime.fromisoformat(str(stated).split("/")[-1])
    except ValueError:
        return ""
    return f"{moment:%d.%m.%Y/%H:%M:%S}"


def _values(
    rows: Sequence[CharacteristicRow], scales: Sequence[tuple[str, float]], moment: str
) -> str:
    """Return the line of a result; events stay empty."""
    cells = []
    for row, (_, factor) in zip(rows, scales, strict=True):
        known = row.value is not None
        fields = [
            _scaled(row.value, factor) if row.value is not None else "0",
            _VALID if known else _NOT_MEASURED,
        ]
        fields += [moment] if moment else []
        if row.serial:
            fields += [*([] if moment else [""]), "", "#" + _ascii_safe(row.serial)[:_SHORT]]
        cells.append(_FIELD.join(fields))
    return _BETWEEN.join(cells)


def _scale(row: CharacteristicRow) -> tuple[str, float]:
    limits = [v for v in (row.lower, row.upper) if v]
    if limits:
        return readable_unit(limits, row.unit)
    return _UNITS.get(row.unit, (row.unit, 1.0))


def _decimals(row: CharacteristicRow, factor: float) -> int:
    """Return the decimals of a row in the unit of its limits: to the place that U has on paper."""
    of = printing(row.value, row.U or row.u, row.unit, (row.lower, row.upper))
    if of.place is None:
        sizes = [abs(v) / factor for v in (row.value, row.lower, row.upper) if v is not None]
        return decimals_for(None, max(sizes, default=0.0))
    return max(-of.place - round(math.log10(of.factor / factor)), 0)


def _scaled(value: float, factor: float) -> str:
    """Return a number in its unit with 15 digits: what a person wrote as 100 nm is 100 again."""
    return _plain(float(f"{value / factor:.15g}"))


def _plain(value: float) -> str:
    """Return a number with all of its digits and no exponent."""
    return format(Decimal(repr(value)), "f").removesuffix(".0")


def _line(field: str, text: Any, most: int) -> str:
    return f"{field} {_ascii_safe(text)[:most].strip() or '-'}"


def _ascii_safe(text: Any) -> str:
    """Return a text in one line, its letters composed so that the encoding holds most of them."""
    return unicodedata.normalize("NFC", one_line(text))
