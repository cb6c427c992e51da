"""Results in the Quality Information Framework (QIF 3.0): one XML file with limits, values and verdicts.

A value stands in the unit of its row (nm, urad ...), which the file defines with its factor to the SI
unit; decimals are exact and have no exponent. ``combinedUncertainty`` is the standard uncertainty u.
QIF has no place for U, k and p: they are attributes of the measurement, U in the unit of the value. All
fields of the report are attributes of the results, those for which QIF has a place stand there as well.
The schema is not part of the package: name a folder of local copies to have a file checked against it.
"""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple

from metrosep.core.atomic import atomic_write
from metrosep.core.errors import DataError
from metrosep.core.provenance import hash_bytes
from metrosep.core.readable import readable_unit
from metrosep.recipe.report_fields import missing_fields
from metrosep.report.certificate import (
    coverage_of,
    fields_of,
    method_of,
    standards_of,
    stated_pairs,
)
from metrosep.report.schemas import element, require_valid, xml_bytes
from metrosep.report.text import CharacteristicRow, characteristic_rows, exchange_names, one_line

Document = Mapping[str, Any]

_QIF = "http://qifstandards.org/xsd/qif3"


class _Kind(NamedTuple):
    """A kind of unit that QIF knows; its characteristics are UserDefined<name>Characteristic."""

    name: str
    si: str  # name of the SI unit
    words: str  # name of the attribute of a value
    units: tuple[str, ...]  # SI units of this kind


_KINDS = (  # in the order of the schema
    _Kind("Area", "square meter", "areaUnit", ("m^2",)),
    _Kind("Angular", "radian", "angularUnit", ("rad",)),
    _Kind("Force", "newton", "forceUnit", ("N",)),
    _Kind("Linear", "meter", "linearUnit", ("m", "m^3/m^2")),
    _Kind("Mass", "kilogram", "massUnit", ("kg",)),
    _Kind("Pressure", "pascal", "pressureUnit", ("Pa",)),
    _Kind("Speed", "meter per second", "speedUnit", ("m/s",)),
    _Kind("Temperature", "kelvin", "temperatureUnit", ("K",)),
    _Kind("Time", "second", "timeUnit", ("s",)),
)
_OTHER = _Kind("Unit", "", "unitName", ())
"""Of units that QIF does not know, 1 and 1/m: such values need a limit."""

_STATUS = {
    "accept": "PASS",
    "reject": "FAIL",
    "inconclusive": "INDETERMINATE",
    None: "NOT_ANALYZED",
}
_INSPECTION = {
    "accept": "PASS",
    "reject": "FAIL",
    "inconclusive": "UNKNOWN",
    None: "NOT_CALCULATED",
}


class _Row(NamedTuple):
    """A characteristic with its kind, unit and number."""

    entry: Document
    row: CharacteristicRow
    kind: _Kind
    unit: str
    factor: Decimal  # of the unit to SI

    def number(self, value: float) -> str:
        return _plain(Decimal(repr(float(value))) / self.factor)

    def value(self, name: str, value: float, **more: str) -> Any:
        return _qif(name, self.number(value), {self.kind.words: self.unit, **more})


def render_qif(document: Document) -> bytes:
    """Return a result as a QIF 3.0 document.

    Parameters
    ----------
    document : mapping
        Content of a result.json; of a draft as well, which is stated in its header.

    Returns
    -------
    bytes
        XML in UTF-8; the same document gives the same bytes.

    Raises
    ------
    DataError
        If the result holds no characteristic, or is damaged.

    Notes
    -----
    The nominal value of a characteristic whose unit QIF does not know (Ssk, Sdq) is mandatory there; no
    result states one, so the middle of its limits, or its only limit, stands there and is described as such.
    Without limits such a value is an attribute of the results.
    """
    entries, held = document.get("characteristics") or [], characteristic_rows(document)
    names = exchange_names(held)
    rows = [_row_of(e, replace(r, name=n)) for e, r, n in zip(entries, held, names, strict=True)]
    placed = [r for r in rows if r.kind is not _OTHER or _limits(r.row)]
    if not placed:
        raise DataError(
            "this result holds no characteristic with a limit or a unit of QIF, so there is nothing for a "
            "QIF file"
        )
    fields, ids = fields_of(document), _Ids()
    standards = _standards(document, ids)
    devices = _devices(fields, ids)
    part, component = ids.new(), ids.new()
    definitions, nominals, items, measured = _characteristics(placed, ids, component, devices)
    seal = hash_bytes(json.dumps(document, sort_keys=True, default=str).encode("utf-8"))
    results = _results(document, fields, rows, measured, component, ids)
    missing = missing_fields(fields)
    root = _qif(
        "QIFDocument",
        _qif("QPId", str(uuid.UUID(seal[:32]))),
        _qif(
            "Header",
            _qif(
                "Application", _qif("Name", f"metrosep {document.get('metrosep') or ''}".strip())
            ),
            _qif("Description", f"draft; not stated: {', '.join(missing)}") if missing else None,
        ),
        _counted("StandardsDefinitions", [s for s, _ in standards]),
        _qif(
            "PreInspectionTraceability",
            _organization(fields),
            _if("PurchaseOrderNumber", (fields.get("customer") or {}).get("order")),
            _if("ReportNumber", _number_of(fields)),
            _qif("FormalStandardId", standards[0][1]),
        ),
        _file_units(placed),
        _qif("MeasurementResources", _counted("MeasurementDevices", [d for d, _ in devices]))
        if devices
        else None,
        _product(document, fields, nominals, part),
        _qif(
            "Characteristics",
            _qif("FormalStandardId", standards[0][1]),
            _counted("CharacteristicDefinitions", definitions),
            _counted("CharacteristicNominals", nominals),
            _counted("CharacteristicItems", items),
        ),
        results,
    )
    root.attrib.update({"versionQIF": "3.0.0", "idMax": str(ids.last)})
    return xml_bytes(root, {"": _QIF})


def write_qif(
    document: Document,
    path: str | os.PathLike[str],
    *,
    schemas: str | os.PathLike[str] | None = None,
) -> Path:
    """Write a result as a QIF 3.0 document; the file appears whole or not at all.

    Parameters
    ----------
    document : mapping
        Content of a result.json.
    path : str or path
        File.
    schemas : str or path, optional
        Folder with the published schemas, against which the file is checked before it is written.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        As `render_qif`.
    UnsupportedFeatureError
        If what checks schemas is not installed.
    WriteError
        If it does not fit the schema or cannot be written.
    """
    made = render_qif(document)
    if schemas is not None:
        require_valid(made, Path(schemas), "qif")
    return atomic_write(path, made)


# ---- elements: the schema fixes the order of children --------------------------------------------


class _Ids:
    """Numbers of the elements of a file, from 1."""

    def __init__(self) -> None:
        self.last = 0

    def new(self) -> str:
        self.last += 1
        return str(self.last)


def _qif(name: str, *inside: Any) -> Any:
    return element(_QIF, name, *inside)


def _if(name: str, text: Any) -> Any:
    return _qif(name, _words(text)) if text else None


def _words(text: Any) -> str:
    return " ".join(one_line(text).split())


def _counted(name: str, inside: Sequence[Any]) -> Any:
    return _qif(name, {"n": str(len(inside))}, *inside)


def _plain(value: Decimal) -> str:
    """Return a decimal with all of its digits and no exponent."""
    text = format(value, "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


def _attributes(numbers: Mapping[str, str], texts: Mapping[str, Any]) -> Any:
    found = [_qif("AttributeD1", {"name": k, "value": v}) for k, v in numbers.items()]
    found += [_qif("AttributeStr", {"name": k, "value": _words(v)}) for k, v in texts.items()]
    return _counted("Attributes", found) if found else None


# ---- the characteristics ---------------------------------------------------------------------------


def _limits(row: CharacteristicRow) -> list[float]:
    return [v for v in (row.upper, row.lower) if v is not None]


def _row_of(entry: Document, row: CharacteristicRow) -> _Row:
    kind = next((k for k in _KINDS if row.unit in k.units), _OTHER)
    if row.unit not in ("m", "rad", "s", "m/s"):
        return _Row(entry, row, kind, row.unit, Decimal(1))
    unit, factor = readable_unit([row.value, *_limits(row)], row.unit)
    return _Row(entry, row, kind, unit, Decimal(repr(factor)))


def _file_units(rows: Sequence[_Row]) -> Any:
    """Return the SI units that occur, and those that rows have, with their factors."""
    primary, others = [], []
    for kind in _KINDS:
        held = {r.unit: r for r in rows if r.kind is kind}
        if held:
            si = kind.units[0] if kind.units[0] in held else next(iter(held.values())).row.unit
            primary.append(
                _qif(f"{kind.name}Unit", _qif("SIUnitName", kind.si), _qif("UnitName", si))
            )
            others += [
                _qif(
                    f"{kind.name}Unit",
                    _qif("UnitName", unit),
                    _qif("UnitConversion", _qif("Factor", _plain(r.factor))),
                )
                for unit, r in held.items()
                if unit != si
            ]
    named: dict[str, list[str]] = {}
    for each in (r for r in rows if r.kind is _OTHER):
        named.setdefault(each.unit, []).append(each.row.metric)
    own = [
        _qif("UserDefinedUnit", _qif("WhatIsMeasured", ", ".join(m)), _qif("UnitName", unit))
        for unit, m in named.items()
    ]
    return _qif(
        "FileUnits",
        _qif("PrimaryUnits", *primary),
        _counted("OtherUnits", others) if others else None,
        _counted("UserDefinedUnits", own) if own else None,
    )


def _characteristics(
    rows: Sequence[_Row], ids: _Ids, component: str, devices: Sequence[tuple[Any, str]]
) -> tuple[list[Any], list[Any], list[Any], list[Any]]:
    """Return definitions, nominals, items and measurements, one of each for a row."""
    found: tuple[list[Any], list[Any], list[Any], list[Any]] = ([], [], [], [])
    used = _ids_of("MeasurementDeviceIds", [i for _, i in devices]) if devices else None
    for each in rows:
        row, stem = each.row, f"UserDefined{each.kind.name}Characteristic"
        definition, nominal, item, measured = (ids.new() for _ in range(4))
        name = _qif("Name", _words(row.name))
        own = each.kind is _OTHER
        limits = [
            each.value(tag, v)
            for tag, v in (("MaxValue", row.upper), ("MinValue", row.lower))
            if v is not None
        ]
        absolute = _qif("DefinedAsLimit", "true")
        tolerance = (
            _qif("Tolerance", *limits, absolute) if limits else _qif("NonTolerance", "MEASURED")
        )
        found[0].append(
            _qif(
                f"{stem}Definition",
                {"id": definition},
                _if("Description", row.definition),
                name,
                *(() if own else (tolerance, _qif("WhatToMeasure", _words(row.metric)))),
            )
        )
        target: tuple[Any, ...] = ()
        if own:
            both = _limits(row)
            target = (each.value("TargetValue", sum(both) / len(both)), *limits, absolute)
        found[1].append(
            _qif(
                f"{stem}Nominal",
                {"id": nominal},
                _qif(
                    "Description", "No nominal value is stated; the target is made of the limits."
                )
                if own
                else None,
                _qif("CharacteristicDefinitionId", definition),
                name,
                *target,
            )
        )
        found[2].append(
            _qif(f"{stem}Item", {"id": item}, name, _qif("CharacteristicNominalId", nominal))
        )
        found[3].append(
            _measurement(each, f"{stem}Measurement", (measured, item, component), used)
        )
    return found


def _measurement(each: _Row, name: str, ids: tuple[str, str, str], devices: Any) -> Any:
    row, (own, item, component) = each.row, ids
    U, k, p = coverage_of(each.entry, row)
    u = U / k if U is not None and k is not None else row.u
    numbers = {} if U is None else {"expandedUncertainty": each.number(U)}
    numbers |= {} if k is None else {"coverageFactor": repr(k)}
    numbers |= {} if p is None else {"coverageProbability": f"{p:.9g}"}
    source = each.entry.get("u_source") if U is not None else None
    spread = {} if u is None else {"combinedUncertainty": each.number(u)}
    return _qif(
        name,
        {"id": own},
        _attributes(numbers, {"uncertaintySource": source} if source else {}),
        _if("Description", each.entry.get("reason") if row.value is None else ""),
        _qif("Status", _qif("CharacteristicStatusEnum", _STATUS[row.verdict])),
        _qif("CharacteristicItemId", item),
        _qif("ActualComponentId", component),
        devices,
        None if row.value is None else each.value("Value", row.value, **spread),
    )


def _ids_of(name: str, ids: Iterable[str]) -> Any:
    return _counted(name, [_qif("Id", i) for i in ids])


# ---- who, what, with what and when ----------------------------------------------------------------


def _number_of(fields: Document) -> str:
    number, revision = fields.get("number"), int(fields.get("revision") or 0)
    return f"{number} rev. {revision}" if number and revision else str(number or "")


def _standards(document: Document, ids: _Ids) -> list[tuple[Any, str]]:
    """Return the recipe, after which the values are judged, and the standards of its steps."""
    seal = str((document.get("recipe") or {}).get("sha256") or "not recorded")
    found = []
    for name in (f"recipe SHA-256 {seal}", *standards_of(document)):
        own = ids.new()
        body = next((b for b in ("ISO", "ASME", "DIN", "IEC") if name.startswith(b)), None)
        organization = (
            _qif(
                "OtherStandardsOrganization", "metrosep" if name.startswith("recipe") else "other"
            )
            if body is None
            else _qif("StandardsOrganizationEnum", body)
        )
        found.append(
            (
                _qif(
                    "Standard",
                    {"id": own},
                    _qif("Organization", organization),
                    _qif("Designator", _words(name)),
                ),
                own,
            )
        )
    return found


def _organization(fields: Document) -> Any:
    held = fields.get("laboratory") or {}
    if not held.get("name"):
        return None
    address = [
        _if(tag, held.get(key))
        for key, tag in (("street", "Street"), ("city", "Town"), ("country", "Country"))
        if held.get(key)
    ]
    return _qif(
        "InspectingOrganization",
        _qif("Name", _words(held["name"])),
        _qif("Address", *address) if address else None,
    )


def _devices(fields: Document, ids: _Ids) -> list[tuple[Any, str]]:
    found = []
    for held in fields.get("instrument") or ():
        name = held.get("name") or held.get("model") or held.get("serial")
        if name:
            own = ids.new()
            rows = (
                ("manufacturer", "Manufacturer"),
                ("model", "ModelNumber"),
                ("serial", "SerialNumber"),
            )
            parts = [_if(tag, held.get(key)) for key, tag in rows]
            found.append(
                (_qif("MeasurementDevice", {"id": own}, _qif("Name", _words(name)), *parts), own)
            )
    return found


def _product(document: Document, fields: Document, nominals: Sequence[Any], part: str) -> Any:
    item = fields.get("item") or {}
    name = item.get("name") or document.get("title") or "not named"
    return _qif(
        "Product",
        _qif(
            "PartSet",
            {"n": "1"},
            _qif(
                "Part",
                {"id": part},
                _qif("Header", _qif("Name", _words(name))),
                _if("ModelNumber", item.get("drawing") or item.get("model")),
                _ids_of("CharacteristicNominalIds", [n.get("id") for n in nominals]),
            ),
        ),
        _qif("RootPart", _qif("Id", part)),
    )


def _results(
    document: Document,
    fields: Document,
    rows: Sequence[_Row],
    measured: Sequence[Any],
    component: str,
    ids: _Ids,
) -> Any:
    item, persons = fields.get("item") or {}, fields.get("persons") or {}
    first, last = (
        (str(fields.get("measured") or "").split("/") * 2)[:2]
        if fields.get("measured")
        else ("", "")
    )
    status = _qif("InspectionStatusEnum", _INSPECTION[document.get("verdict")])
    loose = {
        f"{r.row.name} ({r.unit})": repr(r.row.value)
        for r in rows
        if r.kind is _OTHER and not _limits(r.row) and r.row.value is not None
    }
    traceability = _qif(
        "InspectionTraceability",
        _organization(fields),
        _if("PurchaseOrderNumber", (fields.get("customer") or {}).get("order")),
        _if("ReportNumber", _number_of(fields)),
        _if("InspectionStart", _moment(first, "00:00:00")),
        _if("InspectionEnd", _moment(last, "23:59:59")),
        _person("InspectionOperator", persons.get("measured")),
        _person("ReportPreparer", persons.get("released")),
        _if("ReportPreparationDate", _moment(str(fields.get("issued") or ""), "00:00:00")),
        _if("ReportType", fields.get("kind")),
        _attributes({}, {"method": method_of(document), **dict(stated_pairs(document))}),
    )
    serial = rows[0].row.serial or item.get("serial")
    return _qif(
        "Results",
        _counted(
            "MeasurementResultsSet",
            [
                _qif(
                    "MeasurementResults",
                    {"id": ids.new()},
                    _attributes(loose, {}),
                    traceability,
                    _qif(
                        "MeasuredCharacteristics",
                        _counted("CharacteristicMeasurements", measured),
                    ),
                    _qif("InspectionStatus", status),
                    _ids_of("ActualComponentIds", [component]),
                )
            ],
        ),
        _counted(
            "ActualComponentSets",
            [
                _counted(
                    "ActualComponentSet",
                    [
                        _qif(
                            "ActualComponent",
                            {"id": component},
                            _if("SerialNumber", serial),
                            _qif("Status", _copy(status)),
                        )
                    ],
                )
            ],
        ),
    )


def _copy(made: Any) -> Any:
    return _qif(made.tag.rpartition("}")[2], made.text)


def _person(name: str, who: Any) -> Any:
    return _qif(name, _qif("Name", _words(who))) if who else None


def _moment(text: str, time: str) -> str:
    """Return a date with the time of a day's beginning or end, or a moment as it is stated."""
    return f"{text}T{time}" if len(text) == len("2026-03-04") else text.replace(" ", "T")
