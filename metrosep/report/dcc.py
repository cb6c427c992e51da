"""The digital calibration certificate: an issued report as XML after the public schema of PTB, units after D-SI.

Values, limits and uncertainties are in SI base units with every digit; what is not known is
``noQuantity`` with its reason. A draft gives no certificate. The page that a person reads is inside,
as PDF/A. The schemas themselves are not part of the package: name a folder of local copies to have a
certificate checked against them.
"""

from __future__ import annotations

import base64
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError, RecipeError
from metrosep.core.limits import COVERAGE
from metrosep.recipe.report_fields import missing_fields
from metrosep.report.certificate import (
    certificate,
    coverage_of,
    fields_of,
    is_inside,
    languages_of,
    method_of,
    standards_of,
)
from metrosep.report.schemas import element, require_valid, xml_bytes
from metrosep.report.text import CharacteristicRow, characteristic_rows, one_line

Document = Mapping[str, Any]

VERSION = "3.2.1"
"""Of the schema that is written."""

_DCC, _SI = "https://ptb.de/dcc", "https://ptb.de/si"

_NAMES = {
    "m": r"\metre", "rad": r"\radian", "s": r"\second", "kg": r"\kilogram", "A": r"\ampere",
    "K": r"\kelvin", "mol": r"\mole", "cd": r"\candela", "V": r"\volt", "Hz": r"\hertz",
    "N": r"\newton", "Pa": r"\pascal", "W": r"\watt", "J": r"\joule",
}  # fmt: skip
_FACTOR = re.compile(r"([A-Za-z]+)(?:\^?([+-]?\d+))?")


def dsi_unit(unit: str) -> str:
    r"""Return an SI unit as D-SI writes it.

    Examples
    --------
    >>> print(dsi_unit("1/m"), dsi_unit("m^3/m^2"), dsi_unit("1"))
    \metre\tothe{-1} \metre \one
    """
    powers: dict[str, int] = {}
    for sign, side in zip((1, -1), unit.split("/"), strict=False):
        for part in side.replace("·", " ").split():
            found = _FACTOR.fullmatch(part)
            if part == "1":
                continue
            if found is None or found[1] not in _NAMES or unit.count("/") > 1:
                raise DataError(
                    f"the unit {unit!r} has no name in D-SI; a digital certificate needs SI units"
                )
            powers[found[1]] = powers.get(found[1], 0) + sign * int(found[2] or 1)
    texts = [
        _NAMES[name] + ("" if n == 1 else rf"\tothe{{{n}}}") for name, n in powers.items() if n
    ]
    return "".join(texts) or r"\one"


def missing_for_dcc(document: Document) -> list[str]:
    """Return which fields a digital certificate needs and the report does not state."""
    fields = fields_of(document)
    missing = missing_fields(fields)
    lab, customer = fields.get("laboratory") or {}, fields.get("customer") or {}
    needed = {
        "measured": fields.get("measured"),
        "location": fields.get("location"),
        "laboratory.city": lab.get("city"),
        "laboratory.country": lab.get("country"),
        "customer.name": customer.get("name"),
        "customer.city": customer.get("city") or customer.get("country"),
    }
    missing += [k for k, v in needed.items() if not v]
    for name, held in (("laboratory", lab), ("customer", customer)):
        country = str(held.get("country") or "DE")
        if not re.fullmatch("[A-Z]{2}", country):
            missing.append(f"{name}.country (two capital letters, found {country!r})")
    return missing


def render_dcc(document: Document, *, pdf: bytes | None = None) -> bytes:
    """Return the digital certificate of an issued report."""
    missing = missing_for_dcc(document)
    if missing:
        raise RecipeError(
            "a draft gives no digital certificate; state these fields of [report] first: "
            + ", ".join(missing)
        )
    units = {r.unit: dsi_unit(r.unit) for r in characteristic_rows(document)}
    if pdf is None:
        from metrosep.report.typeset import render_pdf, require_typst

        require_typst("the page in a digital certificate", "dcc")
        pdf = render_pdf(document, standard="a-2b")
    fields, c = fields_of(document), certificate(document)
    language = languages_of(document)[0]
    root = _dcc("digitalCalibrationCertificate", {"schemaVersion": VERSION})
    root.append(_administrative(document, fields, c, language))
    results = _dcc("measurementResults")
    results.append(_measurement(document, fields, c, language, units))
    root.append(results)
    root.append(
        _dcc(
            "document",
            _dcc("fileName", one_line(f"{fields['number']}.pdf")),
            _dcc("mimeType", "application/pdf"),
            _dcc("dataBase64", base64.b64encode(pdf).decode("ascii")),
        )
    )
    return xml_bytes(root, {"dcc": _DCC, "si": _SI})


def write_dcc(
    document: Document,
    path: str | os.PathLike[str],
    *,
    schemas: str | os.PathLike[str] | None = None,
) -> Path:
    """Write the digital certificate of an issued report; it appears whole or not at all."""
    made = render_dcc(document)
    if schemas is not None:
        require_valid(made, Path(schemas), "dcc")
    return atomic_write(path, made)


# ---- elements: the schema fixes the order of children --------------------------------------------


def _dcc(name: str, *inside: Any) -> Any:
    return element(_DCC, name, *inside)


def _si(name: str, *inside: Any) -> Any:
    return element(_SI, name, *inside)


def _replaced(fields: Mapping[str, Any]) -> str:
    """Return the identifier of the replaced report: its number and revision, as it bears them itself."""
    name, revision = str(fields["replaces"]), int(fields.get("revision", 0))
    if name == str(fields["number"]):
        return f"{name}-{max(revision - 1, 0)}"
    return name if re.search(r"-\d+$", name) else f"{name}-0"


def _words(text: Any) -> str:
    """Return a text without line ends and blanks at its ends."""
    return " ".join(one_line(text).split())


def _text(name: str, text: Any, language: str = "") -> Any:
    return _dcc(name, _dcc("content", _words(text), {"lang": language} if language else {}))


def _if(text: Any, name: str) -> Any:
    return _dcc(name, _words(text)) if text else None


def _contact(name: str, held: Mapping[str, Any]) -> Any:
    place = _dcc("location")
    for key, tag in (("city", "city"), ("country", "countryCode"), ("street", "street")):
        if held.get(key):
            place.append(_dcc(tag, _words(held[key])))
    if held.get("contact"):
        place.append(_text("further", held["contact"]))
    return _dcc(name, _text("name", held["name"]), place if len(place) else None)


def _administrative(
    document: Document, fields: Mapping[str, Any], c: Mapping[str, Any], language: str
) -> Any:
    lab, customer = fields["laboratory"], fields["customer"]
    days = str(fields["measured"]).split("/")
    place = re.sub(r" (\w)", lambda m: m[1].upper(), fields["location"])
    software = _dcc(
        "dccSoftware",
        _dcc(
            "software",
            _text("name", "metrosep"),
            _dcc("release", _words(document.get("metrosep") or "not recorded")),
            _dcc("type", "application"),
        ),
    )
    replaced = None
    if fields.get("replaces"):
        replaced = _dcc(
            "reportAmendedSubstituted",
            _dcc("typeOfChange", fields["change"]),
            _dcc("replacedUniqueIdentifier", _words(_replaced(fields))),
        )
    order = _identifications([("customer", customer.get("order"), c["t"]["order"])])
    core = _dcc(
        "coreData",
        _dcc("countryCodeISO3166_1", lab["country"]),
        *(_dcc("usedLangCodeISO639_1", n) for n in dict.fromkeys((language, "en"))),
        _dcc("mandatoryLangCodeISO639_1", language),
        _dcc("uniqueIdentifier", _words(f"{fields['number']}-{fields.get('revision', 0)}")),
        order,
        _if(str(fields.get("received") or "")[:10], "receiptDate"),
        _dcc("beginPerformanceDate", days[0][:10]),
        _dcc("endPerformanceDate", days[-1][:10]),
        _dcc("performanceLocation", place),
        _dcc("issueDate", str(fields["issued"])[:10]),
        replaced,
    )
    accreditation = _if(lab.get("accreditation"), "calibrationLaboratoryCode")
    return _dcc(
        "administrativeData",
        software,
        core,
        _items(fields, c["t"]),
        _dcc("calibrationLaboratory", accreditation, _contact("contact", lab)),
        _persons(fields),
        _contact("customer", customer),
        _statements(fields, c, language),
    )


def _identifications(rows: Iterable[tuple[str, Any, str]]) -> Any:
    found = [
        _dcc(
            "identification",
            _dcc("issuer", who),
            _dcc("value", _words(value)),
            _text("name", what),
        )
        for who, value, what in rows
        if value
    ]
    return _dcc("identifications", *found) if found else None


def _items(fields: Mapping[str, Any], t: Mapping[str, str]) -> Any:
    items = _dcc("items")
    for key in ("item", "machine"):
        held = fields.get(key) or {}
        name = held.get("name") or held.get("model")
        if not name or not held.get("serial"):
            continue
        about = [
            f"{t[k]}: {held[k]}"
            for k in ("material", "condition", "controller", "axes")
            if held.get(k)
        ]
        maker = held.get("manufacturer")
        items.append(
            _dcc(
                "item",
                _text("name", name),
                _text("description", "; ".join(about)) if about else None,
                _dcc("manufacturer", _text("name", maker)) if maker else None,
                _if(held.get("model"), "model"),
                _identifications(
                    [
                        ("manufacturer", held["serial"], t["serial"]),
                        ("other", held.get("drawing"), t["drawing"]),
                    ]
                ),
            )
        )
    return items


def _persons(fields: Mapping[str, Any]) -> Any:
    people = _dcc("respPersons")
    for role in ("released", "checked", "measured"):
        name = (fields.get("persons") or {}).get(role)
        if name:
            people.append(
                _dcc(
                    "respPerson",
                    _dcc("person", _text("name", name)),
                    _dcc("role", role),
                    _dcc("mainSigner", "true" if role == "released" else "false"),
                )
            )
    return people


def _statements(fields: Mapping[str, Any], c: Mapping[str, Any], language: str) -> Any:
    t = c["t"]
    rows = [(t["statement"], t["statement"])]
    rows += [(t["decision_rule"], c["rule"])] if c["rule"] else []
    rows += [(t["u_origin"], o) for o in c["origins"]]
    rows += [(t["traceability"], c["traceability"])] if c["traceability"] else []
    rows += [(t["deviations"], d) for d in c["deviations"]]
    rows += [(t["external"], c["external"])] if c["external"] else []
    rows += [(t["revision"], c["replaces"])] if c["replaces"] else []
    return _dcc(
        "statements",
        *(
            _dcc("statement", _text("name", n, language), _text("declaration", text, language))
            for n, text in rows
        ),
    )


# ---- the results -------------------------------------------------------------------------------------


def _measurement(
    document: Document,
    fields: Mapping[str, Any],
    c: Mapping[str, Any],
    language: str,
    units: Mapping[str, str],
) -> Any:
    method = method_of(document)
    reference = fields.get("procedure")
    results = _dcc("results")
    entries = document.get("characteristics") or []
    for entry, row in zip(entries, characteristic_rows(document), strict=True):
        results.append(
            _dcc(
                "result",
                _text("name", row.name, "en"),
                _text("description", row.definition, "en") if row.definition else None,
                _dcc("data", _quantity(entry, row, c["t"], units[row.unit])),
            )
        )
    for curve in _curves(document):
        results.append(curve)
    return _dcc(
        "measurementResult",
        _text("name", document.get("title") or c["kind"], "en"),
        _dcc(
            "usedMethods",
            _dcc(
                "usedMethod",
                _text("name", method or c["kind"], "en"),
                *(_dcc("norm", _words(n)) for n in standards_of(document)),
                _if(reference, "reference"),
            ),
        ),
        _equipment(fields, c["t"]),
        _conditions(fields, c["t"], language),
        results,
    )


def _equipment(fields: Mapping[str, Any], t: Mapping[str, str]) -> Any:
    found = []
    for each in fields.get("instrument") or ():
        name = each.get("name") or each.get("model") or each.get("serial")
        if not name:
            continue
        about = [f"{t[k]}: {each[k]}" for k in ("certificate_date", "due") if each.get(k)]
        hashed = None
        if each.get("certificate") and each.get("sha256"):
            hashed = _dcc(
                "certificate",
                _text("referral", t["certificate"]),
                _dcc("referralID", _words(each["certificate"])),
                _dcc("procedure", "SHA-256"),
                _dcc("value", _words(each["sha256"])),
            )
        maker = each.get("manufacturer")
        found.append(
            _dcc(
                "measuringEquipment",
                _text("name", name),
                _text("description", "; ".join(about)) if about else None,
                hashed,
                _dcc("manufacturer", _text("name", maker)) if maker else None,
                _if(each.get("model"), "model"),
                _identifications(
                    [
                        ("manufacturer", each.get("serial"), t["serial"]),
                        ("calibrationLaboratory", each.get("certificate"), t["certificate"]),
                    ]
                ),
            )
        )
    return _dcc("measuringEquipments", *found) if found else None


def _conditions(fields: Mapping[str, Any], t: Mapping[str, str], language: str) -> Any:
    found = []
    for key, unit in (("temperature", "K"), ("humidity", "1"), ("pressure", "Pa")):
        if fields.get(key) is None:
            continue
        U = fields.get("temperature_U") if key == "temperature" else None
        real = _real(float(fields[key]), dsi_unit(unit), U, 2.0 if U else None, COVERAGE)
        found.append(
            _dcc(
                "influenceCondition",
                _text("name", t[key], language),
                _dcc("data", _dcc("quantity", real)),
            )
        )
    return _dcc("influenceConditions", *found) if found else None


def _number(value: float) -> str:
    return repr(float(value))


def _real(
    value: float,
    unit: str,
    U: float | None,
    k: float | None,
    p: float | None,
    *,
    u: float | None = None,
) -> Any:
    spread = None
    if U is not None and k is not None and p is not None and k >= 1.0:
        spread = _si(
            "expandedMU",
            _si("valueExpandedMU", _number(U)),
            _si("coverageFactor", f"{k:.9f}".rstrip("0").rstrip(".")),
            _si("coverageProbability", f"{p:.9f}".rstrip("0")),
            # any other k for this p is of Student's distribution, whose name D-SI leaves open
            _si("distribution", "normal")
            if abs(math.erf(k / math.sqrt(2.0)) - p) < 1e-3
            else None,
        )
    elif u is not None:
        spread = _si("standardMU", _si("valueStandardMU", _number(u)))
    return _si(
        "real",
        _si("value", _number(value)),
        _si("unit", unit),
        _si("measurementUncertaintyUnivariate", spread) if spread is not None else None,
    )


def _quantity(entry: Document, row: CharacteristicRow, t: Mapping[str, str], unit: str) -> Any:
    if row.value is None:
        reason = entry.get("reason") or "the value could not be determined"
        return _dcc("quantity", _text("noQuantity", reason, "en"), _verdict(row, t, unit))
    U, k, p = coverage_of(entry, row)
    return _dcc("quantity", _real(row.value, unit, U, k, p, u=row.u), _verdict(row, t, unit))


_CONFORMITY = {"accept": "pass", "reject": "fail"}


def _verdict(row: CharacteristicRow, t: Mapping[str, str], unit: str) -> Any:
    """Return limits and verdict; inconclusive is conditional, after the side of the limit."""
    if row.verdict is None:
        return None
    inside = "conditionalPass" if is_inside(row) else "conditionalFail"
    word = _CONFORMITY.get(row.verdict, inside)
    if row.value is None:
        word = "noPass"
    limits = [
        _dcc("quantity", _text("name", name, "en"), _real(limit, unit, None, None, None))
        for name, limit in (("lower limit", row.lower), ("upper limit", row.upper))
        if limit is not None
    ]
    return _dcc(
        "measurementMetaData",
        _dcc(
            "metaData",
            _text("declaration", t[row.verdict]),
            _dcc("conformity", word),
            _dcc("data", *limits) if limits else None,
        ),
    )


def _curves(document: Document) -> list[Any]:
    """Return the separated error over position with its uncertainty, as lists in SI."""
    plots = document.get("plots") or {}
    if not plots.get("x_mm"):
        return []
    found = []
    for part in plots.get("directions") or []:
        x, e, sd = ([*column] for column in (plots["x_mm"], part["estimate_nm"], part["sd_nm"]))
        known = [i for i, v in enumerate(e) if v is not None and sd[i] is not None]
        if not known:
            continue
        position = _list([1e-3 * x[i] for i in known], None)
        error = _list([1e-9 * e[i] for i in known], [2e-9 * sd[i] for i in known])
        found.append(
            _dcc(
                "result",
                _text("name", f"error over position, {part['direction']}", "en"),
                _dcc(
                    "data",
                    _dcc(
                        "list",
                        _dcc("quantity", _text("name", "position", "en"), position),
                        _dcc(
                            "quantity", _text("name", "error, actual minus nominal", "en"), error
                        ),
                    ),
                ),
            )
        )
    return found


def _list(values: Sequence[float], U: Sequence[float] | None) -> Any:
    spread = None
    if U is not None:
        spread = _si(
            "measurementUncertaintyUnivariateXMLList",
            _si(
                "expandedMUXMLList",
                _si("valueExpandedMUXMLList", " ".join(map(_number, U))),
                _si("coverageFactorXMLList", "2"),
                _si("coverageProbabilityXMLList", f"{COVERAGE}"),
            ),
        )
    return _si(
        "realListXMLList",
        _si("valueXMLList", " ".join(map(_number, values))),
        _si("unitXMLList", r"\metre"),
        spread,
    )
