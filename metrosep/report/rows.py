"""The characteristics of a result as rows that every machine-readable report shares."""

from __future__ import annotations

import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from metrosep.core.errors import DataError
from metrosep.report.comparison import known_number
from metrosep.report.text import stamp

__all__ = ["CharacteristicRow", "cell_text", "characteristic_rows", "guard_factors", "one_line"]

Document = Mapping[str, Any]

_FORMULA = ("=", "+", "-", "@")


@dataclass(frozen=True, slots=True)
class CharacteristicRow:
    """One characteristic of one result."""

    file: str  # name of the input; several are joined by a semicolon
    part: str  # of the unit, where a batch found them in the name; empty otherwise
    serial: str
    metric: str  # short name, and the words of the check or the definition
    name: str
    unit: str  # SI unit of all numbers; ``"1"`` for pure ones
    # value, limits, standard and expanded uncertainty; ``None`` where not known or not given
    value: float | None
    lower: float | None
    upper: float | None
    u: float | None
    U: float | None
    guard: float | None  # guard band, guard factor times U; ``None`` where it is not known
    # ``accept``, ``reject``, ``inconclusive``; ``None`` where it was not judged
    verdict: str | None
    definition: str = ""  # what the number is


def characteristic_rows(document: Document) -> list[CharacteristicRow]:
    """Return the characteristics of a result."""
    entries = document.get("characteristics") or []
    if not isinstance(entries, Sequence) or not all(isinstance(e, Mapping) for e in entries):
        raise DataError("the characteristics are not a list of values; the result is damaged")
    groups = (document.get("unit") or {}).get("groups") or {}
    inputs = [i for i in document.get("inputs") or [] if not i.get("beside")]
    names = [one_line(i.get("name") or "not named") for i in inputs]
    factors = guard_factors(document)
    return [
        _row(entry, "; ".join(names), groups, factor)
        for entry, factor in zip(entries, factors, strict=True)
    ]


def guard_factors(document: Document) -> list[float | None]:
    """Return the guard factor of each characteristic."""
    entries = document.get("characteristics") or []
    judged = [e for e in entries if e.get("verdict") is not None]
    checks: Sequence[Mapping[str, Any]] = _checks(document)
    if [c.get("metric") for c in checks] != [e.get("metric") for e in judged]:
        checks = [{"guard_factor": None}] * len(judged)
    left = iter(checks)
    found: list[float | None] = []
    for entry in entries:
        factor = next(left).get("guard_factor", 1.0) if entry.get("verdict") is not None else None
        found.append(known_number(entry.get("guard_factor", factor), "a guard factor"))
    return found


def one_line(text: Any) -> str:
    r"""Return a text without line ends and other control characters.

    Examples
    --------
    >>> one_line("a\nb\x00 ü")
    'a b  ü'
    """
    kinds = ("Cc", "Cf", "Cs", "Zl", "Zp")
    return "".join(" " if unicodedata.category(c) in kinds else c for c in str(text))


def cell_text(text: Any) -> str:
    """Return a text for a cell: one line, and nothing that a table program takes for a formula.

    Examples
    --------
    >>> cell_text("=1+1"), cell_text("part 7")
    ("'=1+1", 'part 7')
    """
    line = one_line(text)
    return f"'{line}" if line.lstrip().startswith(_FORMULA) else line


def _row(
    entry: Document, file: str, groups: Mapping[str, Any], factor: float | None
) -> CharacteristicRow:
    metric = one_line(entry.get("metric") or entry.get("symbol") or entry.get("name") or "")
    verdict = entry.get("verdict")
    stamp(verdict)  # refuses an unknown one
    numbers = {
        k: known_number(entry.get(k), f"{k} of {metric}")
        for k in ("value", "lower", "upper", "u", "U")
    }
    expanded = numbers["U"]
    return CharacteristicRow(
        file,
        one_line(groups.get("part") or ""),
        one_line(groups.get("serial") or ""),
        metric,
        one_line(entry.get("name") or metric),
        one_line(entry.get("unit") or "1"),
        **numbers,
        guard=None if factor is None or expanded is None else factor * expanded,
        verdict=verdict,
        definition=one_line(entry.get("definition") or ""),
    )


def _checks(document: Document) -> list[Mapping[str, Any]]:
    """Return the checks of the recipe that the document holds; none where it cannot be read."""
    try:
        checks = tomllib.loads(str((document.get("recipe") or {}).get("text") or "")).get("check")
    except (tomllib.TOMLDecodeError, RecursionError):
        return []
    return checks if isinstance(checks, list) else []
