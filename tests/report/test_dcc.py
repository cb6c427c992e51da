"""The digital certificate against the published schema, and what a reader without our code finds in it."""

import re

import pytest
from defusedxml import ElementTree

from metrosep.cli.main import main
from metrosep.core.errors import DataError, RecipeError, WriteError
from metrosep.report.dcc import dsi_unit, missing_for_dcc, render_dcc, write_dcc
from metrosep.report.schemas import require_valid

from .test_certificate import REPORT

NAMES = {"d": "https://ptb.de/dcc", "s": "https://ptb.de/si"}
PDF = b"%PDF-1.7 stands for the page"


@pytest.fixture
def document(certified):
    """A measured ring with every field of a report."""
    return certified


def quantities(xml):
    """Return value, unit, U, k, p and verdict of each result by its name: read with the standard library."""
    found = {}
    for result in ElementTree.fromstring(xml).iterfind(".//d:results/d:result", NAMES):
        get = lambda path, e=result: e.findtext(path, None, NAMES)  # noqa: E731
        spread = ".//d:data/d:quantity/s:real/s:measurementUncertaintyUnivariate/s:expandedMU"
        found[get("d:name/d:content")] = {
            "value": get("d:data/d:quantity/s:real/s:value"),
            "unit": get("d:data/d:quantity/s:real/s:unit"),
            "U": get(f"{spread}/s:valueExpandedMU"),
            "k": get(f"{spread}/s:coverageFactor"),
            "p": get(f"{spread}/s:coverageProbability"),
            "verdict": get(".//d:conformity"),
        }
    return found


def test_a_certificate_fits_the_published_schema(document, schemas):
    require_valid(render_dcc(document, pdf=PDF), schemas, "dcc")


def test_a_separation_with_curves_fits_the_schema(make_document, schemas):
    made = make_document("joint", (1, -1))
    import tomllib

    from metrosep.recipe.report_fields import checked_report

    made["report"] = checked_report(tomllib.loads(REPORT)["report"])
    xml = render_dcc(made, pdf=PDF)
    require_valid(xml, schemas, "dcc")
    lists = ElementTree.fromstring(xml).findall(".//s:realListXMLList", NAMES)
    x = [float(v) for v in lists[0].findtext("s:valueXMLList", None, NAMES).split()]
    e = [float(v) for v in lists[1].findtext("s:valueXMLList", None, NAMES).split()]
    plots = made["plots"]
    assert len(x) == len(e) == len(plots["x_mm"])
    assert x[7] == pytest.approx(plots["x_mm"][7] * 1e-3, abs=1e-15)
    assert e[7] == pytest.approx(plots["directions"][0]["estimate_nm"][7] * 1e-9, abs=1e-20)


def test_values_units_and_uncertainties_come_back(document):
    found = quantities(render_dcc(document, pdf=PDF))
    for entry in document["characteristics"]:
        if entry["verdict"] is None:
            continue
        row = found[entry["name"]]
        assert float(row["value"]) == entry["value"]
        assert row["unit"] == {"m": r"\metre", "1": r"\one"}[entry["unit"]]
        assert float(row["U"]) == entry["U"]
        assert float(row["k"]) == entry["k"]
        assert row["p"] == "0.954499736"  # of a typed k too, where no other is stated
    assert found["height"]["verdict"] == "fail"
    assert found["skewness"]["verdict"] in ("conditionalPass", "conditionalFail")


def test_a_stated_coverage_probability_is_in_the_certificate(document):
    entries = [{**e, "k": 2.37, "p": 0.99} for e in document["characteristics"]]
    found = quantities(render_dcc({**document, "characteristics": entries}, pdf=PDF))
    assert (found["height"]["k"], found["height"]["p"]) == ("2.37", "0.99")


def test_the_distribution_is_named_where_k_and_p_are_of_it(document):
    judged = [e for e in document["characteristics"] if e["verdict"] is not None]
    for k, named in ((2.0, len(judged)), (2.37, 0)):
        entries = [{**e, "k": k} for e in judged]
        xml = render_dcc({**document, "characteristics": entries}, pdf=PDF)
        assert xml.count(b"<si:distribution>normal</si:distribution>") == named + 1  # temperature


def test_a_draft_gives_no_certificate(document):
    held = {**document["report"]}
    held.pop("number")
    with pytest.raises(RecipeError, match="number"):
        render_dcc({**document, "report": held}, pdf=PDF)
    assert set(missing_for_dcc({})) >= {"number", "measured", "location", "customer.name"}


def test_a_country_that_is_no_code_is_named(document):
    held = {**document["report"], "customer": {"name": "A", "city": "B", "country": "Swiss"}}
    with pytest.raises(RecipeError, match=r"customer\.country.*'Swiss'"):
        render_dcc({**document, "report": held}, pdf=PDF)


def test_what_does_not_fit_the_schema_is_not_written(document, tmp_path, monkeypatch, schemas):
    pytest.importorskip("typst")
    monkeypatch.setattr("metrosep.report.dcc.VERSION", "9.9.9")
    with pytest.raises(WriteError, match="schemaVersion"):
        write_dcc(document, tmp_path / "x.dcc.xml", schemas=schemas)
    assert not (tmp_path / "x.dcc.xml").exists()


def test_a_folder_without_schemas_is_named(tmp_path):
    pytest.importorskip("lxml")
    with pytest.raises(WriteError, match=re.escape(str(tmp_path))):
        require_valid(b"<a/>", tmp_path, "dcc")


@pytest.mark.parametrize(
    ("unit", "name"),
    [("m", r"\metre"), ("1", r"\one"), ("1/m", r"\metre\tothe{-1}"), ("rad", r"\radian"),
     ("m/s", r"\metre\second\tothe{-1}"), ("m^3/m^2", r"\metre"), ("1/m^2", r"\metre\tothe{-2}")],
)  # fmt: skip
def test_units_have_the_names_of_dsi(unit, name):
    assert dsi_unit(unit) == name


@pytest.mark.parametrize("unit", ["nm", "mm", "furlong", "m/s/s"])
def test_a_unit_without_a_name_is_refused(unit):
    with pytest.raises(DataError, match="D-SI"):
        dsi_unit(unit)


def test_at_the_door_the_certificate_is_checked_and_repeats(document, tmp_path, schemas):
    pytest.importorskip("typst")
    from metrosep.recipe.result import Result

    Result(document, None).write(tmp_path / "result.json")
    made = []
    for name in ("a", "b"):
        with pytest.raises(SystemExit) as ended:
            main(["-q", "report", str(tmp_path), "-o", str(tmp_path / name), "--format", "dcc",
                  "--dcc-schema", str(schemas)])  # fmt: skip
        assert ended.value.code == 0
        made.append((tmp_path / name / "report.dcc.xml").read_bytes())
    assert made[0] == made[1]
    page = ElementTree.fromstring(made[0]).findtext("d:document/d:dataBase64", None, NAMES)
    assert page.startswith("JVBERi")  # %PDF


def test_a_schema_that_cannot_be_used_is_refused_before_a_report_is_made(
    tmp_path, monkeypatch, capsys
):
    """The report that would take half a minute is never begun, and nothing is written."""
    from metrosep.cli import reporting

    pytest.importorskip("lxml")
    monkeypatch.setattr(reporting, "rendered", lambda task: pytest.fail("a report was begun"))
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "dcc-3.2.1.xsd").write_text("<no/>")
    (tmp_path / "result.json").write_text("{}")
    words = [
        "report",
        str(tmp_path),
        "-o",
        str(tmp_path / "r"),
        "--dcc-schema",
        str(tmp_path / "s"),
    ]
    for form, said in (
        ("html,dcc", "cannot be used"),
        ("qif", "no QIFDocument.xsd"),
        ("html", "leave it out"),
    ):
        with pytest.raises(SystemExit) as stop:
            main([*words, "--format", form])
        assert stop.value.code == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "r").exists()
