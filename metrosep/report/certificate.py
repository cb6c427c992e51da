"""The first page of a report: what it is, of what and for whom, the verdict, the numbers that were judged.

Every text comes from the result or from the catalogue of a language (`languages/*.toml`); nothing is
made up: what ISO/IEC 17025 asks and the result does not state is listed as missing. The same rows
serve the page, the PDF, the workbook and the digital certificate.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from decimal import Decimal
from functools import cache, partial
from itertools import zip_longest
from typing import Any

from metrosep.core.limits import COVERAGE
from metrosep.core.options import options_of
from metrosep.parameters.decision import conformance_probability
from metrosep.recipe.look import Look
from metrosep.recipe.report_fields import (
    LANGUAGES,
    flat_fields,
    is_draft,
    measured_at,
    missing_fields,
    problems_of,
)
from metrosep.report.text import (
    CharacteristicRow,
    capital,
    characteristic_rows,
    limits_text,
    names_said,
    one_line,
    printing,
    rounded_pair,
    stamp,
)

Document = Mapping[str, Any]

_MOST_ROWS, _MOST_WARNINGS = 8, 3
_NORMAL_K = 2.0
_NBSP = "\u00a0"
"""Between what stays on one line."""


# ---- the texts of one or two languages -------------------------------------------------------------


@cache
def catalogue(name: str) -> Mapping[str, Any]:
    """Return the fixed texts of a language, the words in pictures or the sentences of the program."""
    from importlib.resources import files

    place = files("metrosep.report").joinpath(f"languages/{name}.toml")
    return tomllib.loads(place.read_text("utf-8"))


_OF_ONE_SENTENCE = r"(?:(?!\. ).)+?"
_IN_SLOT: Mapping[str, str] = dict.fromkeys(("mm", "feed", "last"), r"[\d.]+")
"""What a place holds where it is not any part of one sentence."""
_TYPED = ("instrument", "due", "day")
"""Places of what a person typed."""
_NAMED = ("name", "what", "standard", "standards")
"""Places of names, whose points are no decimal points."""


@cache
def _sentences(language: str) -> list[tuple[re.Pattern[str], str]]:
    """Return the sentences of the program with what they are in a language; the one that says most comes first."""
    made = []
    for each in catalogue("sentences")["say"]:
        parts = re.split(r"\{(\w+)\}", each["en"])
        first = f"(?i:{parts[0][0]})" if parts[0][:1].isalpha() else ""
        words = [re.escape(p) for p in parts[::2]]
        words[0] = first + re.escape(parts[0][len(first[:1]) :])
        names = [rf"(?P<{n}>{_IN_SLOT.get(n, _OF_ONE_SENTENCE)})" for n in parts[1::2]]
        said_so = "".join(a + b for a, b in zip_longest(words, names, fillvalue=""))
        made.append((sum(map(len, parts[::2])), re.compile(said_so), each[language]))
    return [(pattern, to) for _, pattern, to in sorted(made, key=lambda m: -m[0])]


def _one_said(text: str, language: str) -> str:
    """Return a sentence in a language; the text itself where none is known."""
    bare = text.removesuffix(".")
    for pattern, to in _sentences(language):
        found = pattern.fullmatch(bare)
        if found is None:
            continue
        held = {k: _phrase(k, v, language) for k, v in found.groupdict().items()}
        made = to.format(**held)
        stop = "." if language == "de" else "。"
        begins = text[:1].isupper() and to[1:].partition("}")[0] not in _TYPED
        return (capital(made) if begins else made) + stop * (bare != text)
    return text


def _phrase(slot: str, text: str, language: str) -> str:
    """Return what stands in a place of a sentence: a known phrase, or a list of them; a typed text as it is."""
    whole = text if slot in _TYPED else _one_said(text, language)
    if whole != text or slot in _TYPED:
        return whole
    comma = ", " if language == "de" else "、"
    parts = [(p, _one_said(p, language)) for p in text.split(", ")]
    return comma.join(
        printed(p, language) if p == own and slot not in _NAMED else own for p, own in parts
    )


def said(text: str, language: str) -> str:
    """Return a text of the program in a language, sentence by sentence; what is not known stays English.

    Examples
    --------
    >>> said("Gaps were not measured. 5 of 9 pixels not measured or removed: grey.", "de")
    'Lücken wurden nicht gemessen. 5 von 9 Bildpunkten nicht gemessen oder entfernt: grau.'
    """
    if language == "en" or not text:
        return text
    whole = _one_said(text, language)
    if whole != text:
        return whole
    parts = [_one_said(p, language) for p in re.split(r"(?<=\.) (?=[A-Z0-9−])", text)]
    return re.sub("。 ", "。", " ".join(parts))


def picture_words(language: str) -> tuple[Mapping[str, str], str | None]:
    """Return the words of pictures in a language and the font that has its letters; none where no font has them."""
    from metrosep.plot.style import font_with

    words = catalogue("pictures").get(language, {})
    font = font_with("".join(words.values())) if words else None
    return (words if font else {}), font


def quoted(text: str, language: str) -> str:
    """Return a message in a language, or as a quotation in English where it is not known."""
    made = said(text, language)
    return str(catalogue(language)["quoted"]).format(text=text) if made == text else made


def texts_of(languages: Sequence[str]) -> dict[str, str]:
    """Return the fixed texts in a language, or in two with a slash between where they differ.

    Examples
    --------
    >>> texts_of(["de"])["value"], texts_of(["en", "zh"])["verdict"]
    ('Messwert', 'verdict / 判定')
    """
    chosen = [n for n in languages if n in LANGUAGES] or ["en"]
    catalogues = [catalogue(n) for n in chosen]
    return {k: " / ".join(dict.fromkeys(c[k] for c in catalogues if c[k])) for k in catalogues[0]}


def printed(number: str, language: str) -> str:
    """Return a number as a language prints it: with a decimal comma in German.

    Examples
    --------
    >>> printed("2.32", "de"), printed("2.32", "zh")
    ('2,32', '2.32')
    """
    return re.sub(r"(?<=\d)\.(?=\d)", ",", number) if language == "de" else number


def languages_of(document: Document) -> list[str]:
    """Return the languages of a report: as it states, else those of the template, else English."""
    fields = fields_of(document)
    look = fields.get("look") or {}
    return list(fields.get("language") or look.get("language") or ["en"])


def fields_of(document: Document) -> dict[str, Any]:
    """Return the fields of a report; the date of measuring from the file where none is stated."""
    fields = dict(document.get("report") or {})
    if not fields.get("measured") and measured_at(document):
        moments = measured_at(document)
        fields["measured"] = "/".join(m[:10] for m in moments.split("/"))
    return fields


# ---- the page ----------------------------------------------------------------------------------------


def certificate(document: Document, messages: Sequence[str] = ()) -> dict[str, Any]:
    """Return what the first page shows, as texts; of the messages the three that matter most."""
    fields, languages = fields_of(document), languages_of(document)
    t = texts_of(languages)
    if languages[0] != "en" and not picture_words(languages[0])[0]:
        t["program_texts"] += f" {t['no_font']}"
    look = {name: declared.default for name, declared in options_of(Look).items()}
    look |= fields.get("look") or {}
    kind = str(fields.get("kind") or "test report").replace(" ", "_")
    rows = _rows(document, t, languages[0])
    judged = [r for r in rows if r["stamp"] is not None]
    shown = judged or [r for r in rows if r["value"] != "–"]
    missing = missing_fields(fields)
    # the badge counts the rows that make its verdict: REJECTED (2 of 3)
    alike = sum(r["verdict"] == document.get("verdict") for r in judged)
    agree = problems_of(fields, measured_at(document))
    # fields may have been typed after the run, which then knew nothing of what disagrees
    held = [m for m in messages if not any(p.lower() in m.lower() for p in agree)]
    warnings = [quoted(w, languages[0]) for w in (*(f"{capital(p)}." for p in agree), *held)]
    mark = stamp(document.get("verdict"))
    return {
        "t": t,
        "language": languages[0],
        "look": look,
        "kind": t[kind],
        "heading": _heading(t[kind], fields, t),
        "draft": is_draft(fields),
        "missing": t["missing"].format(fields=", ".join(missing)) if missing else "",
        "number": str(fields.get("number") or ""),
        "revision": int(fields.get("revision") or 0),
        "issued": str(fields.get("issued") or ""),
        "replaces": _replaces(fields, languages),
        "verdict": t[document.get("verdict") or "no_verdict"].upper(),
        "stamp": mark,
        "of": t["of"].format(n=alike, total=len(judged)) if judged else "",
        "blocks": _blocks(document, fields, t),
        "rows": shown[:_MOST_ROWS],
        "further": t["further"].format(n=len(shown) - _MOST_ROWS)
        if len(shown) > _MOST_ROWS
        else "",
        "rule": t["rule"] if judged else "",
        "origins": origins_of(document, t),
        "deviations": traces(document, fields, t),
        "external": str(fields.get("external") or ""),
        "traceability": str(fields.get("traceability") or ""),
        "warnings": warnings[:_MOST_WARNINGS],
        "more_warnings": (
            t["more_warnings"].format(n=len(warnings) - _MOST_WARNINGS)
            if len(warnings) > _MOST_WARNINGS
            else ""
        ),
        "persons": [
            (t[f"{who}_by"], str((fields.get("persons") or {}).get(who) or ""))
            for who in ("measured", "checked", "released")
        ],
    }


def _heading(kind: str, fields: Document, t: Mapping[str, str]) -> str:
    """Return kind and number as one line, for the formats that are not typeset."""
    draft = f" ({t['draft']})" if is_draft(fields) else ""
    return f"{capital(kind)} {fields.get('number') or ''}".strip() + draft


def _replaces(fields: Document, languages: Sequence[str]) -> str:
    """Return which report this one replaces, in each language by itself."""
    if not fields.get("replaces"):
        return ""
    said_in = (
        t["replaces"].format(
            number=fields["replaces"],
            change=t.get(str(fields.get("change") or ""), t["not_stated"]),
            reason=fields.get("reason") or t["not_stated"],
        )
        for t in (texts_of([language]) for language in languages)
    )
    return " / ".join(dict.fromkeys(said_in))


_IN_BLOCK: Mapping[str, tuple[str, ...]] = {
    "laboratory": ("name", "street", "city", "country", "accreditation"),
    "customer": ("name", "city", "country", "contact", "order"),
    "item": ("name", "drawing", "material", "manufacturer", "model", "serial", "condition"),
    "machine": (
        "manufacturer", "model", "serial", "controller", "axes", "compensation", "warm_up",
    ),
    "instrument": (
        "name", "manufacturer", "model", "serial", "certificate", "certificate_date", "due",
    ),
}  # fmt: skip
_ALWAYS = {"laboratory": ("name",), "item": ("name", "serial")}
"""Printed as "not stated" where they are missing; other fields only where they are stated."""


def _blocks(
    document: Document, fields: Document, t: Mapping[str, str]
) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return who, what, with what, when and where: a title and rows each."""
    comma = partial(printed, language=languages_of(document)[0])
    blocks = []
    for block, keys in _IN_BLOCK.items():
        held = fields.get(block) or {}
        several = held if isinstance(held, list) else [held]
        for each in several:
            rows = [
                (t[k], _value(each[k], t) if each.get(k) else t["not_stated"])
                for k in keys
                if each.get(k) or k in _ALWAYS.get(block, ())
            ]
            if rows:
                blocks.append((t[block], rows))
    rows = [(t["measured"], _days(fields.get("measured")) or t["not_stated"])]
    rows += [(t["received"], _days(fields["received"]))] if fields.get("received") else []
    place = [t[f"in_{fields['location'].replace(' ', '_')}"]] if fields.get("location") else []
    place += [str(fields["place"])] if fields.get("place") else []
    rows += [(t["location"], ", ".join(place))] if place else []
    rows.append((t["temperature"], comma(_temperature(fields)) or t["not_stated"]))
    if fields.get("humidity") is not None:
        rows.append((t["humidity"], comma(f"{100.0 * fields['humidity']:.3g} %")))
    if fields.get("pressure") is not None:
        rows.append((t["pressure"], comma(f"{fields['pressure'] / 100.0:.5g} hPa")))
    rows.append((t["method"], said(method_of(document), languages_of(document)[0])))
    rows += [(t["procedure"], str(fields["procedure"]))] if fields.get("procedure") else []
    names = [one_line(i.get("name") or "") for i in document.get("inputs") or []]
    if names:
        more = f" (+ {len(names) - 2})" if len(names) > 2 else ""
        rows.append((t["file"], ", ".join(names[:2]) + more))
    blocks.append((t["conditions"], rows))
    return blocks


def _value(value: Any, t: Mapping[str, str]) -> str:
    return t[value] if value in ("on", "off") else str(value)


def _days(span: Any) -> str:
    return " … ".join(str(span or "").split("/")) if span else ""


def _temperature(fields: Document) -> str:
    kelvin, spread = fields.get("temperature"), fields.get("temperature_U")
    if kelvin is None:
        return ""
    celsius = float(Decimal(repr(float(kelvin))) - Decimal("273.15"))
    if spread is None:
        return f"{celsius:.6g} °C"
    value, U, _ = rounded_pair(celsius, spread, "1")
    return f"({value}{_NBSP}±{_NBSP}{U}){_NBSP}°C"


def method_of(document: Document) -> str:
    """Return the steps with the standards and editions that they follow."""
    separation, estimate = document.get("separation") or {}, document.get("estimate") or {}
    name = str(separation.get("what") or "")
    if estimate.get("method"):
        name = f"separation of repeated runs, method {estimate['method']}"
    texts = [str(v) for v in (separation.get("audit") or {}).values() if isinstance(v, str)]
    standards = []
    for text in texts:
        _, found, after = text.partition(" after ")
        standards += [s.strip() for s in after.split(";")] if found else []
    kept = list(dict.fromkeys(standards))
    return one_line(name + (f" ({', '.join(kept)})" if kept else ""))


def standards_of(document: Document) -> list[str]:
    """Return the standards that the method names, with their editions."""
    norm = r"(?:ISO|ASME|DIN|EN|IEC)[ /][\w.:-]*\d(?:-\d+)?(?::\d{4})?"
    return list(dict.fromkeys(re.findall(norm, method_of(document))))


def traces(document: Document, fields: Document, t: Mapping[str, str]) -> list[str]:
    """Return the deviations: as stated, steps that were switched off, checks that were waived."""
    found = [str(fields["deviations"])] if fields.get("deviations") else []
    found += [
        f"{t['switched_off']}: {step['index'] + 1}, {step['op']}"
        for step in (document.get("separation") or {}).get("steps") or []
        if step.get("enabled") is False
    ]
    tables = [document.get("table"), *(document.get("more_tables") or [])]
    for table in (x for x in tables if x):
        waived = [f["check"] for f in table.get("findings") or [] if f.get("waived")]
        found += [f"{t['waived']}: {one_line(w)}" for w in dict.fromkeys(waived)]
    return found


# ---- the numbers ---------------------------------------------------------------------------------------


def expanded_of(entry: Document, row: CharacteristicRow) -> tuple[float | None, float | None]:
    """Return U and k of a value: of its check, else from u and its degrees of freedom; None if not known."""
    if row.U is not None:
        k = entry.get("k")
        return row.U, None if k is None else float(k)
    if row.u is None or entry.get("reason"):
        return None, None
    k = _NORMAL_K
    if entry.get("dof") is not None:
        from metrosep.forms._correlated import expanding_factor

        k = expanding_factor(float(entry["dof"]))
    return k * row.u, k


def coverage_of(
    entry: Document, row: CharacteristicRow
) -> tuple[float | None, float | None, float | None]:
    """Return U, k and the coverage probability of a value: 95.45 % but where another is stated; None if not known."""
    U, k = expanded_of(entry, row)
    if (
        not U or k is None
    ):  # simple acceptance: there is no distribution of which k and p could speak
        return U, None, None
    return U, k, float(entry.get("p", COVERAGE))


def _rows(document: Document, t: Mapping[str, str], language: str) -> list[dict[str, Any]]:
    entries = document.get("characteristics") or []
    order = {"reject": 0, "inconclusive": 1, "accept": 2, None: 3}
    pairs = list(zip(entries, characteristic_rows(document), strict=True))
    pairs.sort(key=lambda p: (order[p[1].verdict], p[1].name if p[1].verdict else ""))
    named = names_said(document, partial(said, language=language))
    made = [_row(e, r, t, bar_of(r), language) for e, r in pairs]
    return [{**m, "name": named(e, m["name"])} for m, (e, _) in zip(made, pairs, strict=True)]


def _row(
    entry: Document, row: CharacteristicRow, t: Mapping[str, str], bar: Any, language: str
) -> dict[str, Any]:
    U, k, _ = coverage_of(entry, row)
    limits = (row.lower, row.upper)
    value, spread, unit = rounded_pair(row.value, U, row.unit, limits=limits)
    p = _probability(entry, row, U, k)
    texts = {
        "value": value,
        "U": spread,
        "k": "–" if k is None else f"{k:.2f}",
        "limits": limits_text(*limits, printing(row.value, U, row.unit, limits).factor),
        "probability": "–" if p is None else _percent(p),
    }
    texts = {key: printed(text, language) for key, text in texts.items()}
    name = row.name if row.verdict is not None else (entry.get("symbol") or row.name)
    name = name.replace("_", " ") if name == row.metric else name
    return {
        "name": str(name),
        "unit": unit,
        **texts,
        "bar": bar,
        "verdict": row.verdict,
        "stamp": None if row.verdict is None else stamp(row.verdict),
        "word": t[row.verdict] if row.verdict else t["not_judged"],
        "conditional": _conditional(row, t),
    }


def _probability(
    entry: Document, row: CharacteristicRow, U: float | None, k: float | None
) -> float | None:
    """Return the probability of conformity of a judged value (JCGM 106), u = U / k; None if not known."""
    if row.verdict is None or row.value is None or not U or not k:
        return None
    if (row.lower, row.upper) == (None, None):
        return None
    own = entry.get("u_source") not in ("stated", "repeats") and not str(
        entry.get("u_source")
    ).startswith(("budget", "certificate"))
    dof = entry.get("dof") if own else None
    return conformance_probability(
        row.value, U / k, lower=row.lower, upper=row.upper, dof=None if dof is None else float(dof)
    )


def _percent(p: float) -> str:
    """Return a probability in percent that never claims certainty.

    Examples
    --------
    >>> _percent(0.9999999), _percent(0.806938), _percent(1e-9)
    ('> 99.9 %', '80.7 %', '< 0.1 %')
    """
    if p > 0.999:
        return "> 99.9 %"
    return "< 0.1 %" if p < 0.001 else f"{100.0 * p:.1f} %"


def is_inside(row: CharacteristicRow) -> bool:
    """Return whether a value lies inside its limits, whatever its uncertainty."""
    if row.value is None:
        return False
    low = -math.inf if row.lower is None else row.lower
    return low <= row.value <= (math.inf if row.upper is None else row.upper)


def _conditional(row: CharacteristicRow, t: Mapping[str, str]) -> str:
    """Return how ILAC-G8 calls a value that is inconclusive; empty for others."""
    if row.verdict != "inconclusive" or row.value is None or row.U is None:
        return ""
    return t["conditional_pass" if is_inside(row) else "conditional_fail"]


def origins_of(document: Document, t: Mapping[str, str]) -> list[str]:
    """Return one sentence for each origin of U: which values, where from, k and p."""
    found: dict[str, list[str]] = {}
    comma = partial(printed, language=languages_of(document)[0])
    named = names_said(document, partial(said, language=languages_of(document)[0]))
    entries = document.get("characteristics") or []
    for entry, row in zip(entries, characteristic_rows(document), strict=True):
        U, k, p = coverage_of(entry, row)
        if row.verdict is None or U is None:
            continue
        source = one_line(entry.get("u_source") or "of the method")
        name, _, what = source.partition(":")
        word = {"stated": "u_stated", "repeats": "u_repeats", "budget": "u_budget"}.get(name)
        word = word or {"certificate": "u_certificate", "fit residual": "u_fit"}.get(
            name, "u_method"
        )
        words = t[word].format(what=what.strip())
        if k is not None:
            words += f", k = {comma(f'{k:.2f}')}"
        if p is not None:
            words += f", {t['coverage'].format(p=comma(f'{100 * p:.2f} %'))}"
        found.setdefault(words, []).append(named(entry, row.name))
    return [f"{', '.join(dict.fromkeys(names))}: {words}" for words, names in found.items()]


def stated_pairs(document: Document) -> list[tuple[str, str]]:
    """Return every field that is stated, by its key with points, for the other formats."""
    return [(k, str(v)) for k, v in flat_fields(fields_of(document)) if k != "template"]


# ---- where a value lies between its limits, as fractions of a bar: limits, guard bands, U, value ----
# The guard band of a limit is the zone around it in which nothing is decided: limit - g to limit + g.

_MARGIN = 0.25
"""Of the range between the limits (or of the limit itself), shown beyond it."""

_MOST = 3.0
"""Ranges beyond a limit at which a bar ends; a value further out is drawn at the end."""


def bar_of(row: CharacteristicRow) -> dict[str, Any] | None:
    """Return the bar of a characteristic.

    Examples
    --------
    >>> row = CharacteristicRow("", "", "", "Sq", "Sq", "m", 4.0, 0.0, 8.0, None, 1.0, 1.0, "accept")
    >>> bar_of(row)["limits"]
    [0.2143, 0.7857]
    """
    limits = [v for v in (row.lower, row.upper) if v is not None]
    if not limits or row.value is None:
        return None
    low, high = _range(row, limits)
    guard = row.guard or 0.0
    start = low if row.lower is None else row.lower + guard
    stop = high if row.upper is None else row.upper - guard

    def at(number: float) -> float:
        return round(min(max((number - low) / (high - low), 0.0), 1.0), 4)

    spread = row.U
    return {
        "value": at(row.value),
        "spread": None if spread is None else [at(row.value - spread), at(row.value + spread)],
        "limits": [at(v) for v in limits],
        "guards": [[at(v - guard), at(v + guard)] for v in limits if guard > 0.0],
        "zone": [at(start), at(stop)] if start < stop else None,
        "beyond": -1 if row.value < low else int(row.value > high),
    }


def _range(row: CharacteristicRow, limits: list[float]) -> tuple[float, float]:
    """Return the ends of the bar: limits with a margin, the value with U as far as that is sensible."""
    value, spread, guard = row.value or 0.0, row.U or 0.0, row.guard or 0.0
    if len(limits) == 2:
        low, high = limits
    elif row.upper is not None:
        low, high = min(0.0, row.upper), max(0.0, row.upper)
    else:
        low, high = limits[0], limits[0] + abs(limits[0])
    size = (high - low) or abs(high) or max(abs(value), spread, guard) or 1.0
    first = min(low, value - spread, *(v - guard for v in limits))
    last = max(high, value + spread, *(v + guard for v in limits))
    one_sided = len(limits) == 1 and row.upper is not None and value - spread >= 0.0 and low == 0.0
    below = 0.0 if one_sided else _MARGIN * size
    return (
        max(first - below, low - _MOST * size),
        min(last + _MARGIN * size, high + _MOST * size),
    )
