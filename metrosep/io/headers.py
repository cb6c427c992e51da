"""Names and units of columns, as people and loggers write them above a table."""

from __future__ import annotations

import csv
import difflib
import re
from collections.abc import Sequence

from metrosep.core.errors import FormatMismatchError, UnitError
from metrosep.core.units import Unit, column_unit, parse_unit

__all__ = ["bare_unit", "find_column", "header_unit", "split_header"]

_IN = re.compile(r"^(.+?)\s+in\s+(\S+)$")
_SLASH = re.compile(r"^(.+?)\s*/\s*(\S+)$")
_SPACED = re.compile(r"^(.+?)\s+(pm|nm|um|\u00b5m|\u03bcm|mm|cm|urad|mrad|arcsec|deg|ms|us|mV)$")
_BRACKETS = re.compile(r"^[\[(<]\s*(.*?)\s*[\])>]$")


def bare_unit(field: str) -> Unit | None:
    """Return the unit that a field names and nothing else, such as ``"[um]"``."""
    text = field.strip().strip('"').strip()
    match = _BRACKETS.match(text)
    try:
        return parse_unit(match.group(1) if match else text)
    except UnitError:
        return None


def header_unit(header: str) -> tuple[str, Unit | None]:
    """Return the bare name of a column and the unit that its header declares.

    Examples
    --------
    >>> header_unit("s / mm")[0], header_unit("s / mm")[1].name
    ('s', 'mm')
    """
    name, unit = column_unit(header)
    if unit is not None:
        return name, unit
    text = header.strip()
    if bare_unit(text) is not None:
        return text, None
    for pattern in (_IN, _SLASH, _SPACED):
        match = pattern.match(text)
        if match is not None:
            unit = bare_unit(match.group(2))
            if unit is not None and unit.dimension != "number":
                return match.group(1).strip(" _"), unit
    return text, None


def split_header(line: str, separator: str, n_columns: int) -> list[str] | None:
    """Return the names of `n_columns` columns from a line above a table."""
    text = line.strip()
    patterns = {
        "\t": r"\t",
        ";": ";",
        "|": r"\|",
        ",": ",",
        ", ": r",\s+",
        " ": r"\s{2,}|\t",
    }
    order = [separator, *(s for s in patterns if s != separator)]
    for mark in order:
        if len(mark) == 1 and mark != " ":
            fields = next(csv.reader([text], delimiter=mark, skipinitialspace=True), [])
        else:
            fields = re.split(patterns[mark], text)
        names = [n.strip().strip('"').strip() for n in fields]
        while len(names) > n_columns and not names[-1]:
            names.pop()
        if len(names) == n_columns and all(names):
            return names
        if mark == separator == " ":
            names = re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)
            if len(names) == n_columns:
                return names
    names = text.split()
    return names if len(names) == n_columns else None


def find_column(wanted: str, names: Sequence[str], path: object, *, role: str) -> str:
    """Return the column that a caller means."""
    key = wanted.strip().casefold()
    for candidates in (
        [n for n in names if n == wanted],
        [n for n in names if n.casefold() == key],
        [n for n in names if header_unit(n)[0].casefold() == key],
    ):
        if len(candidates) == 1:
            return candidates[0]
        if candidates:
            raise FormatMismatchError(
                f"{path}: {role} column {wanted!r} may be {' or '.join(candidates)}; give the full name"
            )
    near = difflib.get_close_matches(key, [n.casefold() for n in names], n=1, cutoff=0.5)
    guess = next((n for n in names if near and n.casefold() == near[0]), None)
    hint = f"; did you mean {guess!r}?" if guess else ""
    raise FormatMismatchError(
        f"{path}: has no {role} column {wanted!r}; the columns are {', '.join(names)}{hint}"
    )
