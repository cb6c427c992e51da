"""Numbers and verdicts as a reader wants them: one unit and one last digit for a row.

Micro is printed as "µ" here, since a report is typeset; programs and files write "u".
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from metrosep.core import readable
from metrosep.core.errors import DataError
from metrosep.core.units import format_length

__all__ = ["Stamp", "decimals_for", "length", "number", "readable_unit", "size", "span", "stamp"]

_MISSING = "–"


class Stamp(NamedTuple):
    """A verdict as it is shown: never by colour alone."""

    word: str  # in capitals
    symbol: str  # one character
    colour: str  # background, dark enough for white letters
    meaning: str  # one sentence


_STAMPS: Mapping[str | None, Stamp] = {
    "accept": Stamp("ACCEPT", "✓", "#00695C", "Every checked value conforms to its limits."),
    "reject": Stamp("REJECT", "✗", "#B3261E", "At least one checked value breaks its limits."),
    "inconclusive": Stamp(
        "INCONCLUSIVE",
        "?",
        "#7A5200",
        "The uncertainty is too large to decide at least one check, and none is broken.",
    ),
    None: Stamp("NO VERDICT", "–", "#555B62", "No limits were given, so nothing was decided."),
}


def stamp(verdict: str | None) -> Stamp:
    """Return word, symbol and colour of a verdict.

    Examples
    --------
    >>> stamp("accept").word
    'ACCEPT'
    """
    if verdict not in _STAMPS:
        raise DataError(
            f"unknown verdict {verdict!r}; expected 'accept', 'reject', 'inconclusive' or null"
        )
    return _STAMPS[verdict]


def length(value: float | None, *, digits: int = 4) -> str:
    """Return a length in m for a reader.

    Examples
    --------
    >>> length(1.25e-6)
    '1.25 µm'
    """
    return format_length(value, digits=digits).replace(" um", " µm").replace("-", "−", 1)


def readable_unit(values: list[float | None], unit: str) -> tuple[str, float]:
    """Return the unit in which the largest of some values reads well.

    Examples
    --------
    >>> readable_unit([2.7e-7, 2e-8], "m")
    ('nm', 1e-09)
    """
    name, factor = readable.readable_unit(values, unit)
    if re.match(r"u(m|rad|s)\b", name):
        name = f"µ{name[1:]}"
    return name, factor


_MOST_ZEROS = 6
"""A number with more zeros behind the point is printed with a power of ten."""


def decimals_for(u: float | None, largest: float) -> int:
    """Return how many decimals to print: two digits of the uncertainty, else four of the value."""
    if u is not None and u > 0.0:
        wanted = 1 - math.floor(math.log10(u))
    elif largest > 0.0:
        wanted = 3 - math.floor(math.log10(largest))
    else:
        wanted = 0
    return min(max(wanted, 0), 12)


def number(value: float | None, factor: float, decimals: int) -> str:
    """Return a number in a unit with a true minus sign.

    Examples
    --------
    >>> number(-2.5e-7, 1e-9, 1)
    '−250.0'
    """
    if value is None:
        return _MISSING
    shown = value / factor
    if decimals > _MOST_ZEROS and 0.0 < abs(shown) < 10.0**-_MOST_ZEROS:
        return f"{shown:.2e}".replace("-", "−")
    text = f"{shown:.{decimals}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")  # what rounds to zero has no sign
    return text.replace("-", "−")


def size(n_bytes: Any) -> str:
    """Return the size of a file with its unit.

    Examples
    --------
    >>> size(812345)
    '812 345 bytes'
    """
    return _MISSING if n_bytes is None else f"{int(n_bytes):,} bytes".replace(",", "\u202f")


def span(low: float, high: float) -> str:
    """Return a range of positions with one unit for both ends.

    Examples
    --------
    >>> span(0.0, 45e-3)
    '0 mm … 45 mm'
    """
    unit, factor = readable_unit([low, high], "m")
    first, last = (f"{v / factor:.6g}".replace("-", "−") for v in (low, high))
    return f"{first} {unit} … {last} {unit}"
