"""What the dialog about a table shows: its first lines, the roles of its columns, the lines that are no rows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from metrosep.core.errors import MetrosepError
from metrosep.core.text_options import TEXT_OPTIONS

_SHOWN, _AROUND, _LONGEST = 8, 2, 160
"""Lines from the first on; lines on each side of one that is refused; characters of each."""

_WHY = {
    "declaration": "says which separator the file has",
    "comment": "a comment",
    "preamble": "text above the table",
    "count": "says how many rows there are",
    "units": "the units",
    "names": "the names of the columns",
    "repeated header": "the names again, within the table",
    "footer": "text below the table",
    "set aside": "omitted as you said",
}
"""Why a line of each class is no row."""

_HINT = re.compile(rf"\b({'|'.join(TEXT_OPTIONS)})=(?:'([^']*)'|\"([^\"]*)\")?")


def text_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a text among those of reading."""
    return {k: v for k, v in given.items() if k in TEXT_OPTIONS and v not in (None, "")}


def ask_for(message: str, given: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a field for each option of a text that a message names, with the values that it proposes."""
    proposed: dict[str, list[str]] = {}
    for name, quoted, other in _HINT.findall(message):
        values = proposed.setdefault(name, [])
        value = quoted or other
        if value and value not in values:
            values.append(value)
    return [
        {
            "name": name,
            "label": TEXT_OPTIONS[name].rstrip("."),
            "value": str(given.get(name) or ""),
            "choices": values,
            "hint": f"such as {values[0]}" if values else "",
        }
        for name, values in proposed.items()
    ]


def first_lines(file: Path, given: Mapping[str, Any], why: str = "") -> dict[str, Any]:
    """Return lines, columns and what is omitted, as plain values; empty where the file is not a text.

    Of a file that is refused the lines around the first that its message names are added.
    """
    from metrosep.io._roles import role_of
    from metrosep.io.source import open_file
    from metrosep.io.text.encoding import decode
    from metrosep.io.text.table import read_table, text_of

    options = text_options(given)
    try:
        source = text_of(open_file(file), options)
        coded = source.written.get("encoding") or options.get("encoding")
        texts = decode(source.head_lines, file.name, coded)[0].split("\n")
    except MetrosepError:
        return {}
    try:
        table = read_table(source, **options)
    except MetrosepError:
        table = None
    listed = {} if table is None else dict(table.ledger.get("listed", {}))
    kinds = {n: kind for kind, held in listed.items() for n in _numbers(held["numbers"])}
    wanted = set(range(1, _SHOWN + 1))
    found = re.search(r"\bline (\d+)", why)
    if found:
        at = int(found[1])
        wanted |= set(range(at - _AROUND, at + _AROUND + 1))
        kinds[at] = "refused"
    lines = [
        {"number": n, "kind": kinds.get(n, _plain_kind(text, table)), "text": text[:_LONGEST]}
        for n, text in enumerate(texts, start=1)
        if n in wanted and (n < len(texts) or text)
    ]
    columns = [
        {
            "name": c.name,
            "unit": "" if c.unit is None else c.unit.name,
            "role": "text" if c.values is None else role_of(c.name) or "",
        }
        for c in (() if table is None else table.columns)
    ]
    left: list[dict[str, Any]] = [
        {"lines": held["numbers"], "text": held["texts"][0][:_LONGEST], "why": _WHY[kind]}
        for kind, held in listed.items()
        if kind in _WHY and kind not in ("names", "units")
    ]
    left.sort(key=lambda one: min(_numbers(one["lines"])))
    return {
        "part": getattr(source, "part", ""),
        "lines": lines,
        "columns": columns,
        "left": left,
        "n_rows": None if table is None else len(table),
    }


def _plain_kind(text: str, table: object) -> str:
    if not text.strip():
        return "blank"
    return "" if table is None else "row"


def _numbers(ranges: str) -> set[int]:
    """Return the lines that a ledger lists as ``1-3, 7``, as far as they may be shown."""
    found: set[int] = set()
    for part in filter(None, ranges.split(", ")):
        first, _, last = part.partition("-")
        found |= set(range(int(first), min(int(last or first), int(first) + 1000) + 1))
    return found
