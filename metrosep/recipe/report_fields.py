"""The table ``[report]``: what a laboratory states beside the numbers (ISO/IEC 17025:2017, 7.8.2).

Each field is declared once, on a dataclass; the recipe, ``--report KEY=VALUE``, the file
``NAME.report.toml`` beside an input, the pages and the digital certificate read it from there. No
field changes a number, so none counts in the hash of a recipe. What is missing is named by
`missing_fields` and never made up: a report without number, date and a person is a draft.
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path
from typing import Any

from metrosep.core.atomic import RECIPE_BYTES, read_plain_text
from metrosep.core.errors import DataError, RecipeError
from metrosep.core.options import Option, checked, not_one_of, option, options_of
from metrosep.core.readable import did_you_mean, said_value

KINDS_OF_REPORT = ("test report", "calibration certificate", "inspection report")
LANGUAGES = ("en", "de", "zh", "ja")
PLACES = ("laboratory", "customer", "laboratory branch", "customer branch", "other")
ORIGINS = ("command line", "file beside the input", "recipe", "measured file")
"""Where a field can come from; an earlier one goes before a later one."""

_LONGEST, _LONGEST_TEXT = 400, 4000
"""Characters of a field, and of one that holds sentences."""
_SENTENCES = ("deviations", "procedure", "external", "traceability", "reason", "condition")


@dataclass(frozen=True, slots=True)
class Laboratory:
    """Who measured."""

    name: str = option("", kind="text", help="name of the laboratory")
    street: str = option("", kind="text", help="street and number")
    city: str = option("", kind="text", help="post code and city of the laboratory")
    country: str = option("", kind="text", help="country, two letters (ISO 3166): DE")
    accreditation: str = option("", kind="text", help="number of the accreditation")


@dataclass(frozen=True, slots=True)
class Customer:
    """For whom."""

    name: str = option("", kind="text", help="name of the customer")
    city: str = option("", kind="text", help="post code and city of the customer")
    country: str = option("", kind="text", help="country, two letters (ISO 3166)")
    contact: str = option("", kind="text", help="person or address to contact")
    order: str = option("", kind="text", help="number of the order")


@dataclass(frozen=True, slots=True)
class Item:
    """What was measured."""

    name: str = option("", kind="text", help="name of the item")
    drawing: str = option("", kind="text", help="number of its drawing")
    material: str = option("", kind="text", help="material")
    manufacturer: str = option("", kind="text", help="manufacturer of the item")
    model: str = option("", kind="text", help="model of the item")
    serial: str = option("", kind="text", help="serial number of the item")
    condition: str = option("", kind="text", help="condition on receipt")


@dataclass(frozen=True, slots=True)
class MachineUnderTest:
    """The machine of a test after ISO 230."""

    manufacturer: str = option("", kind="text", help="manufacturer of the machine")
    model: str = option("", kind="text", help="model of the machine")
    serial: str = option("", kind="text", help="serial number of the machine")
    controller: str = option("", kind="text", help="controller and its version")
    axes: str = option("", kind="text", help="axes under test, positions of the others")
    compensation: str = option(
        "", kind="text", help="whether the controller compensated", choices=("on", "off", "")
    )
    warm_up: str = option("", kind="text", help="how the machine was warmed up")


@dataclass(frozen=True, slots=True)
class Instrument:
    """With what."""

    name: str = option("", kind="text", help="name of the instrument or standard")
    manufacturer: str = option("", kind="text", help="manufacturer of the instrument")
    model: str = option("", kind="text", help="model of the instrument")
    serial: str = option("", kind="text", help="serial number of the instrument")
    certificate: str = option("", kind="text", help="number of its calibration certificate")
    certificate_date: str = option("", kind="date", help="date of that certificate")
    due: str = option("", kind="date", help="date at which the next calibration is due")
    sha256: str = option("", kind="text", help="SHA-256 of the file of the certificate")


@dataclass(frozen=True, slots=True)
class Persons:
    """Who answers for it."""

    measured: str = option("", kind="text", help="who measured (the operator)")
    checked: str = option("", kind="text", help="who checked")
    released: str = option("", kind="text", help="who released the report")


@dataclass(frozen=True, slots=True)
class ReportFields:
    """The table ``[report]`` of a recipe."""

    kind: str = option("test report", kind="text", help="what it is", choices=KINDS_OF_REPORT)
    number: str = option("", kind="text", help="number of the report")
    revision: int = option(0, kind="integer", help="revision, 0 for the first issue", low=0)
    replaces: str = option("", kind="text", help="number of the report that it replaces")
    change: str = option(
        "", kind="text", help="how a revision changes it", choices=("amended", "substituted", "")
    )
    reason: str = option("", kind="text", help="why it was issued again")
    laboratory: Any = option(None, kind="table", help="who measured")
    location: str = option("", kind="text", help="where it was measured", choices=(*PLACES, ""))
    place: str = option("", kind="text", help="room or address of the measurement")
    customer: Any = option(None, kind="table", help="for whom")
    item: Any = option(None, kind="table", help="what was measured")
    machine: Any = option(None, kind="table", help="the machine of a test after ISO 230")
    instrument: Any = option(None, kind="any", help="with what: a table, or several")
    procedure: str = option("", kind="text", help="procedure of the house")
    received: str = option("", kind="dates", help="date on which the item was received")
    measured: str = option("", kind="dates", help="date of measuring, or first and last date")
    issued: str = option("", kind="date", help="date of issue")
    temperature: float = option(
        None, kind="temperature", help="temperature of the measurement", required=False
    )
    temperature_U: float = option(
        None, kind="temperature difference", help="its expanded uncertainty", required=False
    )
    humidity: float = option(None, kind="share", help="relative humidity", required=False)
    pressure: float = option(None, kind="pressure", help="air pressure", required=False)
    traceability: str = option("", kind="text", help="statement of traceability")
    deviations: str = option("", kind="text", help="deviations from the method")
    external: str = option("", kind="text", help="results of others that it holds")
    persons: Any = option(None, kind="table", help="who measured, checked and released")
    template: str = option("", kind="file", help="look of the house: a TOML file")
    language: Any = option("en", kind="texts", help="language, or two: en, de, zh, ja", choices=())


_TABLES: Mapping[str, type] = {
    "laboratory": Laboratory,
    "customer": Customer,
    "item": Item,
    "machine": MachineUnderTest,
    "persons": Persons,
}
_INSTRUMENT = "instrument"

_NEEDED = (
    "number",
    "issued",
    "laboratory.name",
    "item.name",
    "item.serial",
    "persons.released",
)
"""Without these a report is a draft."""


def report_tables() -> dict[str, dict[str, Option]]:
    """Return the options of ``[report]`` and of each of its tables, by the name of the table.

    Examples
    --------
    >>> sorted(report_tables())
    ['', 'customer', 'instrument', 'item', 'laboratory', 'machine', 'persons']
    """
    tables = {name: options_of(cls) for name, cls in _TABLES.items()}
    return {"": options_of(ReportFields), **tables, _INSTRUMENT: options_of(Instrument)}


# ---- checking what a person wrote ---------------------------------------------------------------


def checked_report(data: Any, where: str = "[report]") -> dict[str, Any]:
    """Return a table ``[report]`` with its values in SI, or refuse it; empty fields are omitted.

    Raises DataError with the key, what is wrong and the nearest spelling.
    """
    if not isinstance(data, Mapping):
        raise DataError(f"{where} is a table: write [report] in brackets")
    tables = report_tables()
    found = checked_table(data, tables[""], where)
    for name in _TABLES:
        if name in found:
            found[name] = checked_table(found[name], tables[name], f"[report.{name}]")
    if _INSTRUMENT in found:
        given = found[_INSTRUMENT]
        several = [given] if isinstance(given, Mapping) else given
        if not isinstance(several, list | tuple) or not all(
            isinstance(i, Mapping) for i in several
        ):
            raise DataError(f"instrument of {where} is a table: write [[report.instrument]]")
        found[_INSTRUMENT] = [
            checked_table(i, tables[_INSTRUMENT], f"[[report.instrument]] {k}")
            for k, i in enumerate(several, start=1)
        ]
    if "language" in found:
        found["language"] = checked_languages(found["language"], where)
    return {k: v for k, v in found.items() if v not in ("", {}, [], None)}


def checked_languages(given: Sequence[str], where: str) -> list[str]:
    """Return one or two languages, each once, or refuse them."""
    for name in given:
        if name not in LANGUAGES:
            raise DataError(f"{where}: {not_one_of('language', name, LANGUAGES)}")
    if len(given) > 2:
        raise DataError(f"{where}: language takes one or two languages, got {len(given)}")
    return list(dict.fromkeys(given))


def checked_table(data: Any, options: Mapping[str, Option], where: str) -> dict[str, Any]:
    """Return one table with its values in SI; texts are one line, empty ones are omitted."""
    if not isinstance(data, Mapping):
        raise DataError(f"{where} is a table, found {said_value(data)}")
    found = {}
    for key, value in data.items():
        if key not in options:
            hint = did_you_mean(key, options)
            raise DataError(f'unknown key "{key}" in {where}; known: {", ".join(options)}.{hint}')
        declared = options[key]
        try:
            made = checked(declared, value, key, bare=False)
        except DataError as exc:
            text = str(exc)
            raise DataError(
                f"{where}: {text if key in text else f'{key} = {said_value(value)}: {text}'}"
            ) from None
        if isinstance(made, str):
            _require_short(key, made, where)
            made = " ".join(made.split())
        if made not in ("", None):
            found[key] = made
    return found


def _require_short(key: str, text: str, where: str) -> None:
    most = _LONGEST_TEXT if key in _SENTENCES else _LONGEST
    if len(text) > most:
        raise DataError(
            f"{where}: {key} has {len(text)} characters, and a page holds {most} of it; shorten it"
        )


def typed_fields(texts: Sequence[str]) -> dict[str, Any]:
    """Return what ``--report KEY=VALUE`` gave as nested tables, not yet checked.

    Examples
    --------
    >>> typed_fields(["number=2026-7", "item.serial=A 12", "instrument.2.serial=9"])
    {'number': '2026-7', 'item': {'serial': 'A 12'}, 'instrument': [{}, {'serial': '9'}]}
    """
    found: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        parts = [p.strip() for p in name.strip().split(".")]
        if not sign or not all(parts):
            raise DataError(f"--report takes KEY=VALUE, such as item.serial=A12; found {text!r}")
        value = value.strip()
        if parts[0] == _INSTRUMENT:
            rest = parts[1:]
            number = int(rest.pop(0)) if rest and rest[0].isdecimal() else 1
            if len(rest) != 1 or not 1 <= number <= 99:
                raise DataError(
                    f"--report {text}: write instrument.serial=..., or instrument.2.serial=..."
                )
            _put(found, f"{_INSTRUMENT}.{number}.{rest[0]}", value)
        elif len(parts) == 2 and parts[0] in _TABLES:
            _put(found, ".".join(parts), value)
        elif len(parts) == 1:
            found[parts[0]] = _typed(parts[0], value)
        else:
            hint = did_you_mean(parts[0], _TABLES)
            raise DataError(
                f'--report {text}: unknown table "{parts[0]}"; known: '
                f"{', '.join([*_TABLES, _INSTRUMENT])}.{hint}"
            )
    return found


def _typed(key: str, value: str) -> Any:
    """Return a value of the command line as TOML would hold it."""
    if key == "revision" and value.isdecimal():
        return int(value)
    if key == "language":
        return [v.strip() for v in value.split(",")]
    if key in ("measured", "received") and ".." in value:
        return [v.strip() for v in value.split("..")]
    return value


# ---- one report from the places that state something of it ----------------------------------------


def stated_report(
    recipe_fields: Mapping[str, Any],
    files: Sequence[Path],
    *,
    typed: Mapping[str, Any] | None = None,
    groups: Mapping[str, Any] | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the fields of a report with the origin of each (key ``origin``); empty where none is stated.

    The command line goes before ``NAME.report.toml`` beside the first input, that before the
    recipe. An instrument with another serial number is another one: of the lower source none of
    its fields is taken. ``{file}``, ``{meta.KEY}`` and ``{group}`` of a batch are filled in.
    """
    sources = [
        (ORIGINS[0], dict(typed or {})),
        (ORIGINS[1], _beside(files)),
        (ORIGINS[2], dict(recipe_fields)),
    ]
    merged: dict[str, Any] = {}
    origin: dict[str, str] = {}
    for name, fields in sources:
        stated = list(flat_fields(fields))
        # another serial number is another instrument: its certificate is not that of the one before
        others = {
            key.removesuffix("serial")
            for key, value in stated
            if key.startswith(_INSTRUMENT)
            and key.endswith(".serial")
            and key in origin
            and value != _of(merged, key)
        }
        for key, value in stated:
            if key not in origin and not key.startswith(tuple(others)):
                origin[key] = name
                _put(merged, key, value)
    if not merged:
        return {}
    known = {str(k): v for k, v in (groups or {}).items()}
    known |= {"file": files[0].name if files else ""}
    known |= {f"meta.{k}": v for k, v in (metadata or {}).items()}
    filled = _filled(merged, known)
    return {**_checked_again(filled), "origin": dict(sorted(origin.items()))}


def report_of(
    recipe: Any,
    files: Sequence[Path],
    document: Mapping[str, Any],
    metadata: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the entry ``report`` of a document, with what does not agree among its messages."""
    groups = (document.get("unit") or {}).get("groups")
    fields = stated_report(
        recipe.report, files, typed=recipe.typed, groups=groups, metadata=metadata
    )
    if recipe.look:
        fields["look"] = dict(recipe.look)
    if not fields:
        return {}
    told = problems_of(fields, measured_at(document))
    return {"report": fields, "messages": [*document.get("messages", ()), *told]}


def report_hash(recipe: Any, files: Sequence[Path]) -> str:
    """Return the SHA-256 of what is stated for a report; empty where nothing is.

    The fields are outside the hash of the recipe, and change no number: a batch that is resumed must
    still not keep a report that names somebody else.
    """
    stated = [dict(recipe.report), dict(recipe.typed), dict(recipe.look), _beside(files)]
    if not any(stated):
        return ""
    text = json.dumps(stated, sort_keys=True, default=str)
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def measured_at(document: Mapping[str, Any]) -> str:
    """Return the first and last moment of measuring that the files state; empty where none does."""
    known = sorted(i["measured_at"] for i in document.get("inputs") or () if i.get("measured_at"))
    return "/".join(dict.fromkeys([known[0], known[-1]])) if known else ""


def _checked_again(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields that were filled in with their lengths checked once more, without empty ones."""
    for key, value in flat_fields(fields):
        if isinstance(value, str):
            _require_short(key.rpartition(".")[2], value, "[report]")
    return {k: v for k, v in fields.items() if v not in ("", {}, [], None)}


def _beside(files: Sequence[Path]) -> dict[str, Any]:
    """Return the fields of ``NAME.report.toml`` beside the first input, none where there is no such file."""
    if not files:
        return {}
    first = files[0]
    for place in (first.with_name(f"{first.name}.report.toml"), first.with_suffix(".report.toml")):
        if place.is_file():
            try:
                return checked_report(
                    tomllib.loads(read_plain_text(place, RECIPE_BYTES)), place.name
                )
            except tomllib.TOMLDecodeError as exc:
                raise RecipeError(f"{place} is not a TOML file: {exc}") from None
            except OSError as exc:
                raise RecipeError(f"{place}: cannot be read ({exc.strerror})") from None
            except DataError as exc:
                raise RecipeError(f"{place}: {exc}") from None
    return {}


def flat_fields(fields: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the fields by a key with points: ``item.serial``, ``instrument.1.due``.

    Examples
    --------
    >>> list(flat_fields({"number": "7", "instrument": [{"serial": "9"}]}))
    [('number', '7'), ('instrument.1.serial', '9')]
    """
    for key, value in fields.items():
        if key in ("origin", "look"):
            continue
        if isinstance(value, Mapping):
            yield from ((f"{key}.{k}", v) for k, v in value.items())
        elif key == _INSTRUMENT:
            for i, each in enumerate(value, start=1):
                yield from ((f"{key}.{i}.{k}", v) for k, v in each.items())
        else:
            yield key, value


def _of(fields: Mapping[str, Any], key: str) -> Any:
    """Return what `_put` put under a key."""
    return dict(flat_fields(fields)).get(key)


def _put(fields: dict[str, Any], key: str, value: Any) -> None:
    name, _, rest = key.partition(".")
    if not rest:
        fields[name] = value
    elif name == _INSTRUMENT:
        number, _, own = rest.partition(".")
        items = fields.setdefault(name, [])
        items += [{} for _ in range(int(number) - len(items))]
        items[int(number) - 1][own] = value
    else:
        fields.setdefault(name, {})[rest] = value


def _filled(value: Any, known: Mapping[str, Any]) -> Any:
    """Return values with ``{name}`` replaced by what is known of the unit or the file."""
    if isinstance(value, dict):
        return {k: _filled(v, known) for k, v in value.items()}
    if isinstance(value, list):
        return [_filled(v, known) for v in value]
    if not isinstance(value, str) or "{" not in value:
        return value
    out, rest = "", value
    while "{" in rest:
        before, _, rest = rest.partition("{")
        name, closed, rest = rest.partition("}")
        if not closed:
            raise RecipeError(f"[report]: {value!r} opens a brace and does not close it")
        if name not in known:
            names = [n for n in known if not n.startswith("meta.")] or ["file"]
            hint = did_you_mean(f"{{{name}}}", [f"{{{n}}}" for n in known])
            raise RecipeError(
                f"[report]: {{{name}}} in {value!r} is not known; there are "
                f"{', '.join(f'{{{n}}}' for n in names)} and {{meta.KEY}} of the file.{hint}"
            )
        out += f"{before}{known[name]}"
    return " ".join((out + rest).split())


# ---- what is missing, and what does not agree ------------------------------------------------------


def missing_fields(fields: Mapping[str, Any]) -> list[str]:
    """Return which fields an issued report needs and does not have.

    Examples
    --------
    >>> missing_fields({"number": "7", "item": {"name": "ring"}})
    ['issued', 'laboratory.name', 'item.serial', 'persons.released']
    """
    known = dict(flat_fields(fields))
    needed = list(_NEEDED)
    if known.get("revision"):
        needed += ["replaces", "change", "reason"]
    return [k for k in needed if known.get(k) in (None, "")]


def is_draft(fields: Mapping[str, Any]) -> bool:
    """Return whether something is missing without which a report is not issued."""
    return bool(missing_fields(fields))


def problems_of(fields: Mapping[str, Any], measured: str = "") -> list[str]:
    """Return what does not agree: an instrument out of calibration, dates out of order.

    `measured`: the moments that the measured files state.
    """
    last = str(fields.get("measured") or measured).split("/")[-1][:10]
    out = []
    for each in fields.get(_INSTRUMENT) or ():
        name = each.get("name") or each.get("serial") or "the instrument"
        if each.get("due") and last and each["due"] < last:
            out.append(
                f"the calibration of {name} was due on {each['due']}, before the measurement on {last}"
            )
    issued = str(fields.get("issued") or "")
    if issued and last and issued < last:
        out.append(f"the date of issue {issued} lies before the measurement on {last}")
    if fields.get("measured") and measured:
        stated, found = (
            [date.fromisoformat(d[:10]) for d in (text.split("/")[0], text.split("/")[-1])]
            for text in (str(fields["measured"]), measured)
        )
        day = timedelta(days=1)  # clocks of instruments know no time zone
        if found[0] < stated[0] - day or found[1] > stated[1] + day:
            span = " to ".join(dict.fromkeys(str(d) for d in found))
            out.append(
                f"the report says measured {str(fields['measured']).replace('/', ' to ')}, the measured "
                f"file {span}"
            )
    return out
