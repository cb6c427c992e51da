"""QIF 3.0 results against the published schema, and what a reader without our code finds in them."""

import re
from decimal import Decimal

import pytest
from defusedxml import ElementTree

from metrosep.cli.main import main
from metrosep.core.errors import DataError, WriteError
from metrosep.report.qif import render_qif
from metrosep.report.schemas import require_valid

ROUNDED_P = 5e-6
"""Of 95.45 %, which is a rounded number."""

NAMES = {"q": "http://qifstandards.org/xsd/qif3"}
VERDICTS = {
    "accept": "PASS",
    "reject": "FAIL",
    "inconclusive": "INDETERMINATE",
    None: "NOT_ANALYZED",
}


def tag(element):
    return element.tag.rpartition("}")[2]


def characteristics(xml):
    """Return SI value, u, U, k, p, limits and status by name, as a reader of QIF follows the ids."""
    root = ElementTree.fromstring(xml)
    factors = {"m": Decimal(1), "rad": Decimal(1), "1": Decimal(1)}
    for unit in root.iterfind(".//q:OtherUnits/*", NAMES):
        text = unit.findtext("q:UnitConversion/q:Factor", None, NAMES)
        factors[unit.findtext("q:UnitName", None, NAMES)] = Decimal(text)
    by_id = {e.get("id"): e for e in root.iter() if e.get("id")}

    def si(element, text=None):
        (unit,) = (v for k, v in element.attrib.items() if k.endswith(("Unit", "unitName")))
        return float(Decimal(element.text if text is None else text) * factors[unit])

    found = {}
    for m in root.iterfind(".//q:CharacteristicMeasurements/*", NAMES):
        item = by_id[m.findtext("q:CharacteristicItemId", None, NAMES)]
        nominal = by_id[item.findtext("q:CharacteristicNominalId", None, NAMES)]
        definition = by_id[nominal.findtext("q:CharacteristicDefinitionId", None, NAMES)]
        stems = {re.sub("(Definition|Nominal|Item|Measurement)$", "", tag(e))
                 for e in (m, item, nominal, definition)}  # fmt: skip
        value = m.find("q:Value", NAMES)
        spread = {a.get("name"): a.get("value") for a in m.iterfind("q:Attributes/*", NAMES)}
        limits = {}
        for e in [*definition.iter(), *nominal.iter()]:
            if tag(e) in ("MaxValue", "MinValue"):
                limits[tag(e)] = si(e)
        found[item.findtext("q:Name", None, NAMES)] = {
            "stems": stems,
            "value": None if value is None else si(value),
            "u": None
            if value is None or value.get("combinedUncertainty") is None
            else si(value, value.get("combinedUncertainty")),
            "U": si(value, spread["expandedUncertainty"])
            if "expandedUncertainty" in spread
            else None,
            "k": spread.get("coverageFactor"),
            "p": spread.get("coverageProbability"),
            "limits": limits,
            "status": m.findtext("q:Status/q:CharacteristicStatusEnum", None, NAMES),
        }
    return found


def test_results_fit_the_published_schema(certified, schemas):
    require_valid(render_qif(certified), schemas, "qif")


def test_a_draft_without_a_report_fits_too_and_says_so(certified, schemas):
    xml = render_qif({k: v for k, v in certified.items() if k != "report"})
    require_valid(xml, schemas, "qif")
    stated = ElementTree.fromstring(xml).findtext("q:Header/q:Description", None, NAMES)
    assert stated.startswith("draft; not stated: number, issued")
    assert b"<Description>draft" not in render_qif(certified)


@pytest.mark.parametrize(
    ("unit", "kind", "value"),
    [("m/s", "Speed", 1.25e-6), ("s", "Time", 3.5e-3), ("m^2", "Area", 2e-6), ("K", "Temperature", 293.25),
     ("Pa", "Pressure", 101320.0), ("N", "Force", 0.1), ("kg", "Mass", 0.25), ("rad", "Angular", -3e-7),
     ("m^3/m^2", "Linear", 4e-9), ("1/m", "Unit", 120.5)],
)  # fmt: skip
def test_every_kind_of_unit_fits_the_schema(certified, schemas, unit, kind, value):
    entry = {"metric": "q", "name": "q", "unit": unit, "value": value, "upper": 2.0 * abs(value),
             "lower": -abs(value), "U": 0.1 * abs(value), "k": 2.0, "verdict": "accept"}  # fmt: skip
    xml = render_qif({**certified, "characteristics": [entry], "verdict": "accept"})
    require_valid(xml, schemas, "qif")
    root = ElementTree.fromstring(xml)
    measured = root.find(".//q:CharacteristicMeasurements/*", NAMES)
    assert tag(measured) == f"UserDefined{kind}CharacteristicMeasurement"
    text = measured.findtext("q:Value", None, NAMES)
    factor = root.findtext(".//q:OtherUnits/*/q:UnitConversion/q:Factor", "1", NAMES)
    assert float(Decimal(text) * Decimal(factor)) == value
    assert "e" not in text.lower()


def test_values_limits_and_uncertainties_come_back_to_the_last_digit(certified):
    found = characteristics(render_qif(certified))
    judged = [e for e in certified["characteristics"] if e["verdict"] is not None]
    assert {e["verdict"] for e in judged} == {"accept", "reject", "inconclusive"}
    for entry in judged:
        named = entry["name"] != entry["definition"]  # else no check gave a name
        row = found[entry["name"] if named else entry["metric"]]
        assert len(row["stems"]) == 1  # a definition, nominal, item and measurement of one kind
        assert row["value"] == entry["value"]
        assert row["U"] == entry["U"]
        assert float(row["k"]) == entry["k"]
        assert row["u"] == pytest.approx(entry["U"] / entry["k"], abs=1e-15 * abs(entry["U"]))
        assert float(row["p"]) == pytest.approx(entry.get("p", 0.9545), abs=ROUNDED_P)
        limits = {"MaxValue": entry.get("upper"), "MinValue": entry.get("lower")}
        assert row["limits"] == {k: v for k, v in limits.items() if v is not None}
        assert row["status"] == VERDICTS[entry["verdict"]]


def test_what_has_no_place_in_qif_is_an_attribute(certified):
    root = ElementTree.fromstring(render_qif(certified))
    (kurtosis,) = (e for e in certified["characteristics"] if e["metric"] == "Sku")
    loose = root.find(".//q:MeasurementResults/q:Attributes/*", NAMES)
    assert (loose.get("name"), float(loose.get("value"))) == ("Sku (1)", kurtosis["value"])


def test_every_field_of_the_report_is_in_the_file(certified):
    from metrosep.report.certificate import stated_pairs

    root = ElementTree.fromstring(render_qif(certified))
    held = {a.get("name"): a.get("value") for a in root.iterfind(".//q:InspectionTraceability/q:Attributes/*", NAMES)}  # fmt: skip
    assert held.items() >= dict(stated_pairs(certified)).items()
    stated = ".//q:InspectionTraceability/q:"
    assert root.findtext(f"{stated}InspectionStart", None, NAMES) == "2026-03-02T00:00:00"
    assert root.findtext(f"{stated}InspectionEnd", None, NAMES) == "2026-03-04T23:59:59"
    assert root.findtext(f"{stated}ReportNumber", None, NAMES) == "2026-0815 rev. 1"
    assert root.findtext(".//q:ActualComponent/q:SerialNumber", None, NAMES) == "A-0042"
    assert root.findtext(".//q:MeasurementDevice/q:SerialNumber", None, NAMES) == "I-77"


def test_a_value_that_is_not_known_is_absent_with_its_reason(certified, schemas):
    entry = {**certified["characteristics"][0], "value": None, "u": None, "verdict": "inconclusive",
             "reason": "too few samples"}  # fmt: skip
    xml = render_qif({**certified, "characteristics": [entry]})
    require_valid(xml, schemas, "qif")
    measured = ElementTree.fromstring(xml).find(".//q:CharacteristicMeasurements/*", NAMES)
    assert measured.find("q:Value", NAMES) is None
    assert measured.findtext("q:Description", None, NAMES) == "too few samples"


def test_a_result_without_characteristics_is_refused(certified):
    with pytest.raises(DataError, match="no characteristic"):
        render_qif({**certified, "characteristics": []})


def test_what_does_not_fit_the_schema_is_not_written(certified, tmp_path, monkeypatch, schemas):
    from metrosep.report.qif import write_qif

    monkeypatch.setattr("metrosep.report.qif._STATUS", dict.fromkeys(VERDICTS, "PERHAPS"))
    with pytest.raises(WriteError, match="PERHAPS"):
        write_qif(certified, tmp_path / "x.qif", schemas=schemas)
    assert not (tmp_path / "x.qif").exists()


def test_at_the_door_the_file_is_checked_and_repeats(certified, tmp_path, schemas):
    from metrosep.recipe.result import Result

    Result(certified, None).write(tmp_path / "result.json")
    made = []
    for name in ("a", "b"):
        with pytest.raises(SystemExit) as ended:
            main(["-q", "report", str(tmp_path), "-o", str(tmp_path / name), "--format", "qif",
                  "--dcc-schema", str(schemas)])  # fmt: skip
        assert ended.value.code == 0
        made.append((tmp_path / name / "report.qif").read_bytes())
    assert made[0] == made[1]
    require_valid(made[0], schemas, "qif")


def test_names_are_of_the_metric_where_no_check_gives_one_and_no_k_and_p_of_no_u(certified):
    what = "height of the second face over the first, one plane for both, section "
    rows = [
        ("section.left.h", what + "left", {"U": 1e-9, "k": 2.0, "u_source": "stated"}),
        ("section.right.h", what + "right", {"U": 0.0, "k": 2.0, "u_source": "stated"}),
        ("section.right.h", what + "right", {"U": 2e-9, "k": 2.1, "u_source": "fit residual"}),
        ("Sq", "Sq", {"U": 1e-9, "k": 2.0, "u_source": "stated"}),
    ]
    entries = [
        {"metric": m, "name": n, "definition": n, "unit": "m", "value": 25e-9, "upper": 30e-9,
         "lower": None, "verdict": "accept", **more}
        for m, n, more in rows
    ]  # fmt: skip
    found = characteristics(render_qif({**certified, "characteristics": entries}))
    assert list(found) == ["section.left.h", "section.right.h", "section.right.h (2)", "Sq"]
    assert [(e["k"], e["p"] is not None) for e in found.values()] == [
        ("2.0", True), (None, False), ("2.1", True), ("2.0", True),
    ]  # fmt: skip
    assert found["section.right.h"]["U"] == 0.0
