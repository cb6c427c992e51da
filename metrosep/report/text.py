"""Numbers and verdicts as a reader wants them: one unit and one last digit for a row.

Micro is printed as "µ" here, since a report is typeset; programs and files write "u".
"""

from __future__ import annotations

import math
import os
import re
import tomllib
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_EVEN, ROUND_HALF_UP, Decimal
from pathlib import Path
from typing import Any, NamedTuple

from metrosep.core import readable
from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError
from metrosep.core.units import format_length
from metrosep.recipe.step_help import step_words
from metrosep.report.comparison import known_number

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
        "The uncertainty is too large to decide at least one check, and none is rejected.",
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


# ---- a value with its expanded uncertainty, GUM 7.2.6 ----------------------------------------------


_DIGITS = 2.0**-52
"""Of a number: an uncertainty below that share of a value says nothing of its digits."""


class Printing(NamedTuple):
    """How the numbers of a row are printed: one unit and one last digit, those of U where it is known."""

    unit: str  # ``"1"`` for pure numbers
    factor: float
    place: int | None  # power of ten of the last digit in this unit; ``None`` without U
    decimals: int

    def text(self, value: float | None, rounding: str = ROUND_HALF_EVEN) -> str:
        """Return a number of the row; decimal, on the shortest text of each float."""
        if value is None or self.place is None:
            return number(value, self.factor, self.decimals)
        scaled = Decimal(repr(float(value))) / Decimal(repr(self.factor))
        kept = scaled.quantize(Decimal(1).scaleb(self.place), rounding)
        return f"{abs(kept) if kept == 0 else kept:f}".replace("-", "−")


def printing(
    value: float | None, U: float | None, unit: str, limits: Sequence[float | None] = ()
) -> Printing:
    """Return how a value, its U and its limits are printed: U has two digits, and fewer than three before the point.

    Examples
    --------
    >>> printing(-427e-12, 65e-6, "m").text(-427e-12), printing(-427e-12, 65e-6, "m").unit
    ('0', 'µm')
    """
    name, factor = readable_unit([value] if value else [*limits], unit)
    if U is None or not _DIGITS * abs(value or 0.0) < U:
        sizes = [abs(v) / factor for v in ([value] if value else limits) if v is not None]
        whole = isinstance(value, int)  # a count
        return Printing(
            name, factor, None, 0 if whole else decimals_for(None, max(sizes, default=0.0))
        )
    if not value and not any(limits):
        name, factor = readable_unit([U], unit)
    while U / factor >= 99.5:
        larger, more = readable_unit([1.0001e3 * factor], unit)
        if more <= factor:
            break
        name, factor = larger, more
    spread = Decimal(repr(float(U))) / Decimal(repr(factor))
    place = spread.adjusted() - 1
    rounded = spread.quantize(Decimal(1).scaleb(place), ROUND_HALF_UP)
    place += rounded.adjusted() - spread.adjusted()  # 0.0996 is 0.10
    return Printing(name, factor, place, max(-place, 0))


def rounded_pair(
    value: float | None, U: float | None, unit: str, *, limits: Sequence[float | None] = ()
) -> tuple[str, str, str]:
    """Return value and U to the same place with their unit: U half up, the value half even.

    Examples
    --------
    >>> rounded_pair(1.3634567e-6, 0.1049e-6, "m"), rounded_pair(0.84137e-12, 0.0996e-12, "m")
    (('1.36', '0.10', 'µm'), ('0.84', '0.10', 'pm'))
    """
    row = printing(value, U, unit, limits)
    spread = row.text(U, ROUND_HALF_UP) if U != 0.0 else "0"
    return row.text(value), spread, "" if row.unit == "1" else row.unit


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


# ---- the characteristics of a result as rows that every machine-readable report shares ---------

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
    item = (document.get("report") or {}).get("item") or {}
    stated = {"part": item.get("drawing") or item.get("name"), "serial": item.get("serial")}
    groups = {**stated, **((document.get("unit") or {}).get("groups") or {})}
    inputs = [i for i in document.get("inputs") or [] if not i.get("beside")]
    names = [one_line(i.get("name") or "not named") for i in inputs]
    factors = guard_factors(document)
    return [
        _row(entry, "; ".join(names), groups, factor)
        for entry, factor in zip(entries, factors, strict=True)
    ]


def exchange_names(rows: Sequence[CharacteristicRow], most: int | None = None) -> list[str]:
    """Return a name for each row that is the same for every part and that no other row has.

    That of its check, else its metric: a definition is long, and equal for two sections. `most` is the
    number of letters that the format holds.
    """
    found: list[str] = []
    for row in rows:
        own = row.metric if row.name == row.definition else row.name
        stem, n = " ".join((own or row.metric or "not named").split()), 1
        name = stem[:most].strip()
        while name in found:
            n += 1
            tail = f" ({n})"
            name = stem[: None if most is None else most - len(tail)].strip() + tail
        found.append(name)
    return found


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


def capital(text: str) -> str:
    """Return a text with a capital first letter, the others as they are; a symbol and a file keep theirs.

    Examples
    --------
    >>> capital("report B-7"), capital("u from the scatter")
    ('Report B-7', 'u from the scatter')
    """
    # U is another quantity than u, and A.csv another file than a.csv
    if re.match(r"[b-zα-ω](?![A-Za-z'’])|[\w-]+\.\w", text):
        return text
    return text[:1].upper() + text[1:]


def limits_text(lower: float | None, upper: float | None, factor: float = 1.0) -> str:
    """Return limits in the unit of a row.

    Examples
    --------
    >>> limits_text(-1e-6, 2e-6, 1e-6), limits_text(None, 3.0), limits_text(None, None)
    ('−1 … 2', '≤ 3', '–')
    """
    low, high = (
        None if v is None else f"{v / factor:.6g}".replace("-", "−") for v in (lower, upper)
    )
    if low is not None and high is not None:
        return f"{low} … {high}"
    if high is not None:
        return f"≤ {high}"
    return _MISSING if low is None else f"≥ {low}"


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


def names_said(
    document: Document, say: Callable[[str], str]
) -> Callable[[Mapping[str, Any], str], str]:
    """Return what says the name of a value in the language of a report; that of a check stays as typed."""
    typed = {(c.get("metric"), one_line(c["name"])) for c in _checks(document) if "name" in c}

    def named(entry: Mapping[str, Any], name: str) -> str:
        is_typed = (
            entry.get("verdict") is not None and (entry.get("metric"), one_line(name)) in typed
        )
        return name if is_typed else say(name)

    return named


# ---- what a report says about a named separation: method, noise, null space, audit -------------

_MOST_INDICES = 16
_PLURALS = {"frequency": "frequencies", "radius": "radii"}

SEPARATED_NOTE = (
    "The standard uncertainty u holds what the readings tell and what was stated for the method; "
    "linearity of the sensor and temperature are in it only where they were given."
)


def separation_rows(separation: Document) -> list[tuple[str, str]]:
    """Return the summary of a separation."""
    if not separation:
        return []
    rows = [("Method", f"{separation.get('op')}: {separation.get('what')}")]
    if separation.get("runs"):
        rows += plan_rows(separation)
    noise = separation.get("noise") or {}
    if noise.get("definition"):
        rows.append(("Noise", f"{_value(noise)}: {noise['definition']}"))
    op = str(separation.get("op"))
    rows += [(f"Not seen, {parts}", step_words(what, op)) for parts, what in not_seen(separation)]
    return rows


def not_seen(separation: Document) -> list[tuple[str, str]]:
    """Return what a separation cannot see, once where it is the same for several parts."""
    found: dict[str, list[str]] = {}
    for item in separation.get("null_space") or []:
        parts = found.setdefault(_unobservable(item), [])
        parts.append(str(item["part"]).replace("_", " "))
    return [(", ".join(parts), what) for what, parts in found.items()]


def plan_rows(plan: Document) -> list[tuple[str, str]]:
    """Return the summary of a plan of feedrates."""
    if not plan:
        return []
    runs = ", ".join(f"{n} at {v:.6g} mm/min" for v, n in plan.get("runs") or [])
    rows = [("Next runs, as planned", runs)]
    quantities = plan.get("quantities") or {}
    for key, name in (("worst_sd", "Predicted sd, at worst"), ("time", "Travel time of them")):
        q = quantities.get(key)
        if q and q.get("value") is not None:
            rows.append((name, _value(q)))
    return rows


def separation_audit(separation: Document) -> dict[str, Any]:
    """Return the settings of a separation, one level deep, for the list of what was done."""
    return dict(separation.get("audit") or {})


def _value(noise: Document) -> str:
    value = noise.get("value")
    if value is None:
        return "not known"
    unit, factor = readable_unit([value], noise.get("unit") or "m")
    return f"{value / factor:.3g} {unit}"


def _unobservable(item: Document) -> str:
    indices = list(item.get("indices") or [])
    if item.get("kind") == "wavelength":
        indices = [length(float(i)) for i in indices]
    shown = ", ".join(f"{i:.6g}" if isinstance(i, float) else str(i) for i in indices)
    kind = _PLURALS.get(str(item.get("kind")), "{}s").format(item.get("kind"))
    if len(indices) == 1:
        kind = str(item.get("kind"))
    if item.get("kind") == "polynomial":
        kind += " of degree"
    if len(indices) > _MOST_INDICES:
        first = ", ".join(str(i) for i in indices[:_MOST_INDICES])
        shown = f"{first}, … ({len(indices)} in all)"
    return f"{kind} {shown}: {item.get('reason')}"


# ---- from a function that renders a document to the one that writes it as a file ---------------

_WRITER = """Write {what}; the file appears whole or not at all.

Parameters
----------
document : mapping
    Content of {article} {of}.
path : str or path
    File.

Returns
-------
Path
    The file.

Raises
------
{raises}
WriteError
    If it cannot be written.
"""


def document_writer(
    name: str,
    render: Callable[[Mapping[str, Any]], str | bytes],
    what: str,
    *,
    of: str = "result.json",
    **raises: str,
) -> Callable[[Mapping[str, Any], str | os.PathLike[str]], Path]:
    """Return the public function of a name that writes what `render` makes of a document."""

    def write(document: Mapping[str, Any], path: str | os.PathLike[str]) -> Path:
        made = render(document)
        return atomic_write(path, made.encode("utf-8") if isinstance(made, str) else made)

    errors = "\n".join(f"{error}\n    {when}" for error, when in raises.items())
    article = "an" if of[0] in "aeiou" else "a"
    write.__doc__ = _WRITER.format(what=what, article=article, of=of, raises=errors)
    write.__name__ = write.__qualname__ = name
    write.__module__ = render.__module__
    return write
