"""From a result to the texts and rows of a report: no number that the result does not hold."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from metrosep.compensation.area_errors import AxisUnits, is_rotary, numbers_of
from metrosep.core import readable
from metrosep.core.readable import digits_of, typeset
from metrosep.core.units import parse_unit
from metrosep.plot.left_out import lag_words, run_rows
from metrosep.recipe.result import clean
from metrosep.recipe.schema import Field, shown
from metrosep.recipe.step_help import keys_of_step, step_words
from metrosep.report.certificate import (
    bar_of,
    certificate,
    expanded_of,
    printed,
    quoted,
    said,
    texts_of,
)
from metrosep.report.text import (
    SEPARATED_NOTE,
    CharacteristicRow,
    capital,
    characteristic_rows,
    decimals_for,
    length,
    limits_text,
    names_said,
    number,
    one_line,
    plan_rows,
    printing,
    readable_unit,
    rounded_pair,
    separation_audit,
    separation_rows,
    size,
    span,
    stamp,
)

Document = Mapping[str, Any]

_METHODS = {
    "joint": "joint fit of the repeatable error and a time-series model of the disturbance",
    "kono": "Fourier selection after Kono, by amplitude and scatter over feedrates",
    "mean": "mean over the runs",
}
_MAX_WAVELENGTHS = 16
_NOT_IN_BAND = (
    "The standard uncertainty u is type A: what the readings tell. The artefact's own form, the "
    "sensor's linearity and temperature are not in it."
)


def view(document: Document) -> dict[str, Any]:
    """Return what the template shows."""
    estimate = document.get("estimate") or {}
    separation = document.get("separation") or {}
    messages = _messages(document, estimate)
    first = certificate(document, messages)
    rule = _sentence(document.get("decision_rule"))
    own = texts_of([first["language"]])  # of cells: two languages are for what stands beside them
    t, number_of = first["t"], partial(printed, language=first["language"])
    spoken = partial(said, language=first["language"])
    quotes = [quoted(m, first["language"]) for m in messages]
    return {
        "c": first,
        "title": spoken(document.get("title") or "Separation of repeated runs"),
        "version": document.get("metrosep") or "",
        "stamp": stamp(document.get("verdict"))._replace(
            meaning=t[f"means_{document.get('verdict') or 'none'}"]
        ),
        "decision_rule": rule if first["language"] == "en" or not rule else t["rule"],
        "summary": [
            (capital(t["method"]) if k == "Method" else spoken(k), spoken(v))
            for k, v in (
                *_summary(document, estimate, t, own, number_of),
                *separation_rows(separation),
                *plan_rows(document.get("plan") or {}),
            )
        ],
        "characteristics": _characteristics(document, first),
        "header": header_rows(document),
        "hashes": short_hashes(document),
        "uncertainty_note": spoken(SEPARATED_NOTE if separation else _NOT_IN_BAND),
        "messages": [m for m in quotes if m not in first["warnings"]],
        "runs": [
            {k: v if k in _AS_TYPED else number_of(v) for k, v in row.items()}
            for row in _run_rows(document, own)
        ],
        "wavelengths": [
            {k: number_of(v) for k, v in row.items()}
            for row in _wavelengths(estimate.get("spectrum") or {}, own)
        ],
        "table": _table(document.get("table"), document.get("more_tables") or (), first),
        "polynomial": _polynomial(document.get("polynomial"), t),
        "settings": _settings(
            estimate.get("audit") or separation_audit(separation),
            str(separation.get("op") or "separate"),
            by_direction=bool(estimate.get("audit")),
        ),
        "inputs": [
            *(input_row(i) for i in document.get("inputs") or []),
            *_certificates(document, first["t"]),
        ],
        "steps": [step_row(s) for s in document.get("provenance") or []],
        "recipe": document.get("recipe") or None,
        "versions": sorted((document.get("versions") or {}).items()),
    }


def _sentence(text: Any) -> str:
    """Return the text as a sentence of its own: capital first letter, full stop."""
    words = str(text or "").strip()
    if not words:
        return ""
    return capital(words) + ("" if words[-1] in ".!?" else ".")


_AS_TYPED = ("run", "short", "found")
"""Cells of a run that are no numbers."""

Texts = Mapping[str, str]


def _summary(
    document: Document, estimate: Document, t: Texts, own: Texts, number_of: Callable[[str], str]
) -> list[tuple[str, str]]:
    rows = []
    if estimate.get("method"):
        name = estimate["method"]
        rows.append(
            (capital(t["method"]), f"{name}: {_METHODS.get(name, 'see the documentation')}")
        )
    if estimate.get("start_m") is not None:
        rows.append(
            (
                capital(t["evaluation_range"]),
                number_of(span(estimate["start_m"], estimate["stop_m"])),
            )
        )
    if estimate.get("fit_range_m"):
        rows.append((capital(t["modelled_travel"]), number_of(span(*estimate["fit_range_m"]))))
    feeds = (document.get("plots") or {}).get("feeds") or []
    rows.append((capital(t["runs"]), number_of(_runs(feeds, own))))
    for way, phrase in lag_words(document) if estimate else []:
        rows.append((f"Delay of the reading{', ' + way if way else ''}", phrase))
    return [(k, v) for k, v in rows if v]


def _runs(feeds: Sequence[Document], t: Texts) -> str:
    parts = []
    for way in ("forward", "reverse", "both"):
        rows = [f for f in feeds if f.get("direction") == way]
        if rows:
            speeds = ", ".join(
                t["not_known"] if f.get("feed_mm_min") is None else f"{f['feed_mm_min']:.6g}"
                for f in rows
            )
            n = sum(f.get("n_runs") or 0 for f in rows)
            said = t["runs_at"].format(n=n, way=t[way], feeds=speeds)
            parts.append(said.replace(f"{t['not_known']} mm/min", t["not_known"]))
    return "; ".join(parts)


def _characteristics(document: Document, first: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return all values as text, numbers and verdicts in the language of the report."""
    rows = characteristic_rows(document)
    entries = clean(document.get("characteristics") or [])
    say = partial(said, language=first["language"])
    named, made = names_said(document, say), []
    for entry, row in zip(entries, rows, strict=True):
        texts = _characteristic(entry, row)
        for key in ("value", "u", "U", "limits", "guard"):
            texts[key] = printed(texts[key], first["language"])
        texts["name"] = named(entry, texts["name"])
        texts["definition"] = say(texts["definition"])
        if texts["stamp"] is not None:
            texts["stamp"] = texts["stamp"]._replace(word=first["t"][entry["verdict"]].upper())
        made.append({**texts, "bar": bar_of(row)})
    return made


def _characteristic(entry: Document, row: CharacteristicRow) -> dict[str, Any]:
    """Return the texts of a value: rounded as on the first page, and u to the place of U."""
    U, _ = expanded_of(entry, row)
    limits = (row.lower, row.upper)
    of = printing(entry.get("value"), U or row.u, row.unit, limits)
    return {
        "name": _plain_name(entry),
        "symbol": entry.get("symbol") or "",
        "value": "not known" if row.value is None else of.text(row.value),
        "unit": "" if of.unit == "1" else of.unit,
        "u": of.text(row.u) if not row.u or float(of.text(row.u)) else f"{row.u / of.factor:.2g}",
        "U": rounded_pair(row.value, row.U, row.unit, limits=limits)[1],
        "limits": limits_text(*limits, of.factor),
        "definition": _sentence(entry.get("definition")),
        "stamp": None if row.verdict is None else stamp(row.verdict),
        # empty where it is not known
        "guard": ""
        if row.guard is None
        else f"{row.guard / of.factor:.3g} {'' if of.unit == '1' else of.unit}".strip(),
    }


def _plain_name(entry: Document) -> str:
    """Return the name of a value; one that is a metric of the program without its underscores."""
    name = str(entry.get("name") or entry.get("symbol") or "")
    is_words = name == entry.get("metric") and len(name.split("_", maxsplit=1)[0]) > 1
    return name.replace("_", " ") if is_words else name


def _messages(document: Document, estimate: Document) -> list[str]:
    both = [*(document.get("messages") or []), *(estimate.get("messages") or [])]
    op = str((document.get("separation") or {}).get("op") or "separate")
    return [_sentence(typeset(step_words(str(m), op))) for m in dict.fromkeys(both)]


def _run_rows(document: Document, t: Texts) -> list[dict[str, str]]:
    """Return each run against the others, as text; empty where nothing was compared."""
    rows = run_rows(document) if document.get("estimate") else []
    several = len({r["direction"] for r in rows}) > 1
    placed = any(r["offset_mm"] is not None for r in rows)

    def text(value: float | None, form: str) -> str:
        if value is None:
            return "–"
        written = format(value, form)
        return written.lstrip("+-") if float(written) == 0.0 else written.replace("-", "−")

    return [
        {
            "run": r["run"],
            "short": r["short"],
            "direction": t.get(r["direction"], r["direction"]) if several else "",
            "feed": text(r["feed_mm_min"], ".6g"),
            "misfit": text(r["misfit"], ".2f"),
            "gain": text(r["gain"], ".3f"),
            "u_gain": text(r["u_gain"], "#.2g"),
            "shift": text(r["shift_mm"], ".3f"),
            "u_shift": text(r["u_shift_mm"], "#.2g"),
            "offset": text(r["offset_mm"], "+.3f") if placed else "",
            "u_offset": text(r["u_offset_mm"], "#.2g") if placed else "",
            "found": "; ".join(
                p for p in ("" if r["used"] else "excluded", typeset(r["finding"])) if p
            ),
        }
        for r in rows
    ]


def _wavelengths(spectrum: Document, t: Texts) -> list[dict[str, str]]:
    """Return the strongest selected wavelengths, the longest first."""
    keys = ("direction", "wavelength_mm", "amplitude_nm", "sd_nm", "phase_rad", "selected")
    n = len(spectrum.get("wavelength_mm") or [])
    columns = [spectrum.get(k) or [None] * n for k in keys]
    rows = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    chosen = [r for r in rows if r["selected"] and r["amplitude_nm"] is not None]
    strongest = sorted(chosen, key=lambda r: -r["amplitude_nm"])[:_MAX_WAVELENGTHS]
    strongest.sort(key=lambda r: (r["direction"] or "", -r["wavelength_mm"]))
    return [
        {
            "direction": t.get(r["direction"] or "", r["direction"] or ""),
            "wavelength": number(r["wavelength_mm"], 1.0, 2),
            "amplitude": number(r["amplitude_nm"], 1.0, 1),
            "u": number(r["sd_nm"], 1.0, 1),
            "phase": number(r["phase_rad"], 1.0, 2),
        }
        for r in strongest
    ]


def _table(
    table: Document | None, others: Sequence[Document], first: Mapping[str, Any]
) -> dict[str, Any] | None:
    """Return what is shown of the first table, with the warnings of all of them."""
    from metrosep.controllers.safety import sidecar_warnings

    if not table:
        return None
    t, own = first["t"], texts_of([first["language"]])
    table = {**table, **numbers_of(table)}
    check = table.get("verification")
    units = AxisUnits(str(table.get("axis") or "X"), str(table.get("compensates") or "X"))

    def place(key: str) -> str | None:
        value = table.get(key)
        if not is_rotary(units.looked_up):
            return _known(value)
        return None if value is None else units.place(value)

    def amount(key: str) -> str | None:
        value = table.get(key)
        if not is_rotary(units.corrected):
            return _known(value, digits=4 if key == "stroke_m" else 3)
        return None if value is None else units.amount(value)

    low_high = table.get("span_m")
    axis, target = table.get("axis") or "?", table.get("compensates") or "?"
    ways = own["one_column" if table.get("reverse_m") is None else "two_columns"]
    rows = [
        ("table_file", table.get("path")),
        ("table_sha", table.get("file_sha256")),
        ("controller", table.get("controller")),
        ("sign", table.get("sign")),
        ("entry", table.get("entry")),
        ("file_units", table.get("units")),
        ("sign_known", table.get("sign_status")),
        ("looked_up", own["looked_up_at"].format(axis=axis, target=target)),
        ("span", _span(low_high, units) if low_high else None),
        ("outside", table.get("outside")),
        ("points", f"{table['n_points']}, {ways}" if table.get("n_points") else None),
        ("reference", place("reference_m")),
        ("stroke", amount("stroke_m")),
        ("interpolation", amount("interpolation_error_m")),
        ("rounding", amount("quantisation_m")),
    ]
    return {
        "rows": [(capital(t[k]), str(v)) for k, v in rows if v],
        "wiring": "\n".join(table.get("hal_routing") or []),
        "wiring_of": f"{axis} to {target}",
        "activation": [_sentence(s) for s in table.get("activation") or []],
        "findings": [
            {
                "level": f.get("level") or "note",
                "problem": _sentence(
                    (f"{one.get('path') or 'table'}: " if others else "") + f["problem"]
                ),
                "fix": _sentence(f.get("fix"))
                + (f" Accepted: {f['check']} was waived." if f["waived"] else ""),
            }
            for one in (table, *others)
            for f in sidecar_warnings(one)
        ],
        "verification": _verification(check, units, first) if isinstance(check, Mapping) else None,
        "waived": check if isinstance(check, str) else ("not done" if check is None else ""),
    }


def _known(value: float | None, *, digits: int = 4) -> str | None:
    if value == 0.0:
        return "0 mm"
    return None if value is None else length(value, digits=digits)


def _span(ends: Sequence[float], units: AxisUnits) -> str:
    """Return a range along the looked-up axis."""
    if not is_rotary(units.looked_up):
        return span(*ends)
    return f"{units.place(ends[0])} to {units.place(ends[1])}"


def _verification(check: Document, units: AxisUnits, first: Mapping[str, Any]) -> dict[str, Any]:
    t = texts_of([first["language"]])
    check = {**check, **numbers_of(check)}
    removed = {
        "plane": "mean and plane of the measurement",
        "offset": "mean of the measurement",
    }.get(str(check.get("removed")), "")
    if check.get("unknown_text"):
        removed = f"{check['unknown_text']} of the measurement"
    return {
        "passed": bool(check.get("passed")),
        "definition": _sentence(check.get("definition")),
        "removed": removed,
        "span": _span(check["span_m"], units) if check.get("span_m") else "",
        "rows": [
            {
                k: printed(v, first["language"])
                for k, v in _residual(r, q, t, turns=is_rotary(units.corrected)).items()
            }
            for r in check.get("residuals") or []
            for q in ("pv", "rms")
        ],
    }


def _residual(row: Document, quantity: str, t: Texts, *, turns: bool) -> dict[str, str]:
    row = numbers_of(row)
    before, after, wrong = (
        row.get(f"{k}_{quantity}_m") for k in ("before", "after", "wrong_sign")
    )
    u = row.get("u_after_rms_m") if quantity == "rms" else None
    unit, factor = ("µrad", 1e-6) if turns else readable_unit([before, after, wrong], "m")
    largest = max((abs(v) / factor for v in (before, after, wrong) if v is not None), default=0.0)
    decimals = min(decimals_for(None if u is None else u / factor, largest), 3)
    n = row.get("n_runs") or 1
    return {
        "direction": t.get(str(row.get("direction")), str(row.get("direction") or "")),
        "quantity": ("P-V" if quantity == "pv" else "RMS") + f", {unit}",
        "n_runs": t["mean_of"].format(n=n) if n > 1 else t["one_curve"],
        "before": number(before, factor, decimals),
        "after": number(after, factor, decimals)
        + ("" if u is None else f" (u = {number(u, factor, decimals)})"),
        "wrong": number(wrong, factor, decimals),
        "change": "–" if not before or after is None else _percent(after / before),
    }


def _percent(ratio: float) -> str:
    return f"{100.0 * (ratio - 1.0):+.0f} %".replace("-", "−")


def _polynomial(fit: Document | None, t: Texts) -> dict[str, Any] | None:
    if not fit:
        return None
    rows = [
        ("Degree", f"{fit['degree']}, chosen by {fit.get('degree_chosen_by') or 'the user'}"),
        ("Valid for", span(*fit["domain_m"]) if fit.get("domain_m") else None),
        ("Left over (RMS of the data about it)", _known(fit.get("residual_rms_m"))),
        ("Uncertainty from", fit.get("covariance_from")),
        ("Greatest standard uncertainty (of runs: mean removed)", _known(fit.get("u_greatest_m"))),
    ]
    what = "the_compensation" if fit.get("quantity") == "compensation" else "the_error"
    return {
        "rows": [(k, str(v)) for k, v in rows if v],
        "horner": fit.get("horner") or "",
        "heading": capital(t["polynomial"].format(what=t[what])),
    }


def _settings(
    audit: Document, op: str, *, by_direction: bool
) -> list[tuple[str, list[tuple[str, str]]]]:
    """Return what the method did: one group, or one for each direction of runs."""
    keys = keys_of_step(op)
    fields = {} if keys is None else keys.step
    groups = {k: v for k, v in audit.items() if by_direction and isinstance(v, Mapping)}
    own = {k: v for k, v in audit.items() if k not in groups}
    named = [("", own), *sorted(groups.items())] if own else sorted(groups.items())
    words = {"forward": "forward runs", "reverse": "reverse runs", "both": "all runs"}
    return [(words.get(name, in_words(name)), settings(group, fields)) for name, group in named]


# ---- where a result comes from, as texts of a report: part and file, inputs with their hashes, steps ----


def header_rows(document: Document) -> list[tuple[str, str]]:
    """Return part, serial and other names that a batch found, with the file where there is one."""
    unit = document.get("unit") or {}
    groups = sorted((unit.get("groups") or {}).items())  # as a result.json holds them
    rows = [(in_words(str(k)), str(v)) for k, v in groups]
    if unit.get("name"):
        rows.append(("file", str(unit["name"])))
    return [(name.capitalize(), one_line(value)) for name, value in rows]


def _certificates(document: Document, t: Texts) -> list[dict[str, str]]:
    """Return the certificates of instruments whose hash is stated, as rows beside the inputs."""
    return [
        {
            "name": one_line(each.get("certificate") or each.get("name") or t["not_stated"]),
            "format": t["certificate"],
            "size": "–",
            "sha256": one_line(each["sha256"]),
        }
        for each in (document.get("report") or {}).get("instrument") or []
        if each.get("sha256")
    ]


def short_hashes(document: Document) -> str:
    """Return the short hashes of recipe and inputs, for the foot of a page."""
    recipe = str((document.get("recipe") or {}).get("sha256") or "none")[:12]
    inputs = [str(i.get("sha256") or "none")[:12] for i in document.get("inputs") or []]
    more = f" and {len(inputs) - 1} more" if len(inputs) > 1 else ""
    return f"recipe {recipe}, input {inputs[0] if inputs else 'none'}{more}"


def input_row(entry: Document) -> dict[str, str]:
    """Return a file that was read.

    Examples
    --------
    >>> input_row({"name": "m1.dat", "beside": "m1.txt", "size": 56})["name"]
    'm1.dat (read beside m1.txt)'
    """
    name = str(entry.get("name") or "not named")
    notes = [f"read beside {entry['beside']}"] if entry.get("beside") else []
    notes += [f"measured {entry['measured_at']}"] if entry.get("measured_at") else []
    return {
        "name": f"{name} ({'; '.join(notes)})" if notes else name,
        "size": size(entry.get("size")),
        "format": str(entry.get("format") or "–"),
        "sha256": str(entry.get("sha256") or "–"),
    }


def step_row(step: Document) -> dict[str, str]:
    """Return a step of the history."""
    name = str(step.get("step") or "")
    keys = keys_of_step(name)
    fields = {} if keys is None else keys.step
    in_table = name in ("read", "read_columns")  # of the inputs
    told = ("op", "sha256", "size") if in_table else ("op",)
    given = {k: v for k, v in (step.get("parameters") or {}).items() if k not in told}
    return {
        "name": name,
        "parameters": step_parameters(given, fields),
        "version": str(step.get("version") or ""),
    }


# ---- what a separation did, as rows of a report: every number with its unit, four digits -------
# A key of the audit tells the unit by its suffix (``travel_mm``); a key of the step tells its
# dimension by the kind of its field, and is stored in SI.

Fields = Mapping[str, Field]

_UNITS = {
    "_nm_per_m_per_min": "nm per m/min",
    "_nm_per_revolution": "nm per revolution",
    "_nm2_per_hz": "nm²/Hz",
    "_mm_per_min": "mm/min",
    "_mm_min": "mm/min",
    "_rev_per_s": "rev/s",
    "_nm2": "nm²",
    "_mm": "mm",
    "_um": "µm",
    "_nm": "nm",
    "_pm": "pm",
    "_mrad": "mrad",
    "_urad": "µrad",
    "_nrad": "nrad",
    "_rad": "rad",
    "_deg": "deg",
    "_ppm": "ppm",
    "_khz": "kHz",
    "_hz": "Hz",
    "_min": "min",
    "_ms": "ms",
    "_us": "µs",
    "_h": "h",
    "_m": "m",
    "_s": "s",
    "_si": "SI",
}
"""By suffix, the longer ones first where one ends like another."""

_SCALED = ("length", "angle")
_LEAST, _SETTINGS_MOST = 0.1, 1e4
"""Outside of these a length or an angle gets another unit than that of its key."""

_MOST_ITEMS, _MOST_TABLES = 12, 4


def settings(audit: Mapping[str, Any], fields: Fields) -> list[tuple[str, str]]:
    """Return what was done, as rows."""
    return [setting(k, v, fields) for k, v in sorted(audit.items())]


def setting(key: str, value: Any, fields: Fields) -> tuple[str, str]:
    """Return one entry of an audit in words.

    Examples
    --------
    >>> setting("travel_mm", 600.0, {}), setting("distance", [0.02], {"distance": Field("lengths")})
    (('travel', '600 mm'), ('distance', '20 mm'))
    >>> setting("wavelength_um", 123000.0, {}), setting("n_repeats", 6, {})
    (('wavelength', '123 mm'), ('number of repeats', '6'))
    >>> setting("waves", [{"wavelength_mm": 12.0}], {"waves": Field("lengths")})  # found, not given
    ('waves', 'wavelength 12 mm')
    """
    suffix = next((s for s in _UNITS if key.endswith(s)), "")
    base = key.removesuffix(suffix)
    unit = _UNITS.get(suffix, "")
    if base in fields and unit == "rad" and _is_number(value):
        return in_words(base), typeset(shown(value, fields[base]))
    if suffix:
        return in_words(base), _text(value, unit)
    if key in fields and not _is_found(value):
        return in_words(key), typeset(_shortened(value, lambda v: shown(v, fields[key])))
    return in_words(key), _text(value, "")


def _is_found(value: Any) -> bool:
    """Whether a value is a table of what was found, which may have the name of an option."""
    several = isinstance(value, list | tuple)
    return several and (not value or any(isinstance(v, Mapping) for v in value))


def step_parameters(parameters: Mapping[str, Any], fields: Fields) -> str:
    """Return the parameters of a step in one line.

    Examples
    --------
    >>> step_parameters({"u_reading": 1e-9, "kmax": 30}, {"u_reading": Field("uncertainty")})
    'kmax = 30; u_reading = 1 nm'
    """
    texts = []
    for key, value in sorted(parameters.items()):
        suffix = next((s for s in _UNITS if key.endswith(s)), "")
        if key in fields:
            text = typeset(shown(value, fields[key]))
        elif suffix and value is not None:
            text = _text(value, _UNITS[suffix])
        else:
            text, suffix = _text(value, ""), ""
        texts.append(f"{key if key in fields else key.removesuffix(suffix)} = {text}")
    return "; ".join(texts) or "–"


def in_words(key: str) -> str:
    """Return a key without its underscores.

    Examples
    --------
    >>> in_words("n_samples"), in_words("u_reading"), in_words("noise_source")
    ('number of samples', 'u reading', 'noise source')
    """
    words = "number of " + key[2:] if key.startswith("n_") else key
    words = words.replace("number of not_", "readings not_")
    return words.replace("_", " ")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Any, unit: str) -> str:
    if _is_number(value):
        number, name = _scaled([float(value)], unit)
        whole = isinstance(value, int) and number == [value]
        return f"{value if whole else _digits(number[0])} {name}".strip()
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        pairs = [(k, *setting(str(k), v, {})) for k, v in value.items()]
        texts = [f"{w} {_text(value[k], unit) if unit else t}" for k, w, t in pairs]
        return ", ".join(texts) or "none"
    if isinstance(value, list | tuple):
        return _list(value, unit)
    return str(value)


def _list(values: Sequence[Any], unit: str) -> str:
    if not values:
        return "none"
    if all(v is None or _is_number(v) for v in values):
        known = [float(v) for v in values if v is not None]
        numbers, name = _scaled(known, unit)
        each = iter(numbers)
        shortened = ["–" if v is None else _digits(next(each)) for v in values]
        tail = f" {name}" if name else ""
        if len(shortened) > _MOST_ITEMS:
            return f"{', '.join(shortened[:_MOST_ITEMS])}{tail}, … ({len(shortened)} in all)"
        return ", ".join(shortened) + tail
    between = "; " if any(isinstance(v, Mapping) for v in values) else ", "
    most = _MOST_TABLES if between == "; " else _MOST_ITEMS
    texts = [_text(v, unit) for v in values[:most]]
    nested = any(isinstance(v, list | tuple) for v in values)
    texts = [f"({t})" if nested else t for t in texts]
    rest = f"{between}… ({len(values)} in all)" if len(values) > most else ""
    return between.join(texts) + rest


def _shortened(value: Any, text: Any) -> str:
    if isinstance(value, list | tuple) and len(value) > _MOST_ITEMS:
        return f"{text(value[:_MOST_ITEMS])}, … ({len(value)} in all)"
    return str(text(value))


def _scaled(values: Sequence[float], unit: str) -> tuple[list[float], str]:
    """Return numbers in a unit in which the largest of them reads well."""
    plain = unit.replace("µ", "u")
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    if (
        not unit
        or largest == 0.0
        or _LEAST <= largest < _SETTINGS_MOST
        or " " in unit
        or "²" in unit
    ):
        return list(values), unit
    if plain in ("mm/min", "Hz", "kHz", "ppm", "SI", "deg", "rev/s"):
        return list(values), unit
    known = parse_unit(plain)
    if known.dimension not in _SCALED:
        return list(values), unit
    si = "m" if known.dimension == "length" else "rad"
    name, factor = readable.readable_unit([largest * known.factor], si)
    return [v * known.factor / factor for v in values], typeset(name)


def _digits(value: float) -> str:
    return digits_of(value).replace("-", "−") if math.isfinite(value) else "–"
