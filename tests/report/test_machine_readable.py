"""CSV and workbooks re-read by readers that know nothing of metrosep; bars by hand."""

import csv
import io
import math
import sys
import time

import openpyxl
import pytest

from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.core.units import parse_quantity
from metrosep.report.csv_long import render_csv, write_csv
from metrosep.report.text import CharacteristicRow, characteristic_rows
from metrosep.report.view import bar_of
from metrosep.report.workbook import render_workbook, write_workbook

FRACTION = 1e-4  # bars are rounded to four digits
HOSTILE = [
    "<script>alert(1)</script>",
    "=1+1",
    "a\nb;c,d\"e'",
    "Prüfling 量具 🔧",
    "x" * 500,
    "\x1b[2J",
]


def _entry(metric="Sq", value=66.5e-9, unit="m", **more):
    return {"metric": metric, "name": f"name of {metric}", "value": value, "unit": unit} | more


def _document(*entries, **more):
    return {
        "schema": "metrosep.result/1",
        "title": "Ring",
        "characteristics": list(entries),
    } | more


def _lines(*documents):
    return list(csv.DictReader(io.StringIO(render_csv(documents), newline="")))


def _book(document):
    return openpyxl.load_workbook(io.BytesIO(render_workbook(document)))


def _cells(sheet):
    return [c.value for row in sheet.iter_rows() for c in row if c.value is not None]


def test_csv_holds_a_line_for_each_characteristic_and_every_bit():
    value = 0.1 + 0.2
    unit = {"groups": {"part": "ring", "serial": "007"}}
    entries = _entry(value=value, upper=1e-6, U=1e-9, verdict="accept"), _entry("Ssk", None, "1")

    first, second = _lines(_document(*entries, unit=unit, inputs=[{"name": "a.datx"}]))

    wanted = "file,part,serial,characteristic,value,unit,lower,upper,U,verdict"
    assert list(first)[:10] == wanted.split(",")
    assert (first["file"], first["part"], first["serial"]) == ("a.datx", "ring", "007")
    assert float(first["value"]) == value
    assert (first["lower"], first["upper"], first["verdict"]) == ("", "1e-06", "accept")
    assert (second["value"], second["unit"], second["verdict"]) == ("", "1", "")


@pytest.mark.parametrize("text", HOSTILE)
def test_csv_of_hostile_names_is_one_line_each_and_no_formula(text):
    groups = {"part": text, "serial": text}
    document = _document(_entry() | {"name": text}, unit={"groups": groups})

    (line,) = _lines(document)

    assert len(render_csv([document]).split("\r\n")) == 3
    assert not line["characteristic"].startswith("=")
    assert "\x1b" not in line["part"]
    assert len(line["serial"]) >= len(text)


@pytest.mark.parametrize("bad", [math.nan, math.inf, None])
def test_what_is_not_known_is_an_empty_cell(bad):
    (line,) = _lines(_document(_entry(value=bad, u=bad)))

    assert (line["value"], line["u"]) == ("", "")
    assert "nan" not in render_csv([_document(_entry(value=bad))]).lower()


def test_the_guard_band_is_that_of_the_recipe():
    text = '[[check]]\nmetric = "Sq"\nupper = "80 nm"\nguard_factor = 0.5\n'
    entry = _entry(upper=80e-9, U=4e-9, verdict="accept")

    (row,) = characteristic_rows(_document(entry, recipe={"text": text}))
    (own,) = characteristic_rows(_document(entry | {"guard_factor": 0.0}, recipe={"text": text}))
    (none,) = characteristic_rows(_document(entry))

    assert (row.guard, own.guard, none.guard) == (2e-9, 0.0, None)


@pytest.mark.parametrize("render", [lambda d: render_csv([d]), render_workbook])
@pytest.mark.parametrize(
    "entry",
    [{"verdict": "perhaps"}, {"value": "1"}, {"U": [1]}, {"upper": True}],
    ids=str,
)
def test_a_damaged_characteristic_is_refused(render, entry):
    with pytest.raises(DataError):
        render(_document(_entry() | entry))


@pytest.mark.parametrize("document", [{}, {"characteristics": None}, {"inputs": None}])
def test_missing_parts_are_left_out(document):
    assert _lines(document) == []
    assert _book(document).sheetnames == ["Summary", "Characteristics", "Profiles", "Provenance"]


def test_the_workbook_says_what_the_document_says(document):
    book = _book(document)

    summary, rows = (
        _cells(book["Summary"]),
        list(book["Characteristics"].iter_rows(values_only=True)),
    )
    assert summary[0] == "Test report (DRAFT)"
    assert summary[1] == document["title"]
    assert summary[2] == "✓ ACCEPTED"
    head = dict(zip(rows[0], range(len(rows[0])), strict=True))
    pv, entry = rows[1], document["characteristics"][0]
    assert pv[head["unit"]] == "nm"
    assert pv[head["value"]] * 1e-9 == pytest.approx(entry["value"], abs=1e-20)
    assert pv[head["upper"]] == pytest.approx(2000.0, abs=1e-9)
    assert pv[head["verdict"]] == "✓ ACCEPT"
    provenance = _cells(book["Provenance"])
    assert any(document["inputs"][0]["sha256"] in str(c) for c in provenance)
    assert all(line in provenance for line in document["recipe"]["text"].splitlines())


@pytest.mark.parametrize("nm", [100, 120, 0.1, 33.3])
def test_a_cell_holds_the_limit_as_the_person_wrote_it(nm):
    limit = parse_quantity(f"{nm} nm", dimension="length")

    sheet = _book(_document(_entry(value=limit, upper=limit, U=0.0)))["Characteristics"]

    factor = {"pm": 1000, "nm": 1}[sheet.cell(2, 4).value]
    assert (sheet.cell(2, 3).value, sheet.cell(2, 6).value) == (nm * factor, nm * factor)


def test_profiles_keep_their_gaps_and_units(document):
    document["plots"]["feeds"][0]["before_nm"][1] = None
    sheet = _book(document)["Profiles"]

    columns = {c[1].value: c for c in sheet.iter_cols()}
    feed = document["plots"]["feeds"][0]
    name = next(n for n in columns if n.startswith("mean run before") and feed["direction"] in n)
    values = [c.value for c in columns[name][3 : 3 + len(feed["before_nm"])]]
    assert columns[name][2].value == "nm"
    assert values[1] is None
    sixteen_digits = 1e-12  # of some hundred nm, as the sheet holds them
    assert values[2] == pytest.approx(feed["before_nm"][2], abs=sixteen_digits)


def test_the_spectrum_is_a_native_chart_with_two_logarithmic_axes(document):
    book, spectrum = _book(document), document["estimate"]["spectrum"]
    found = {}
    for chart in book["Charts"]._charts:
        title = "".join(r.t for p in chart.title.tx.rich.p for r in p.r)
        found[title] = [a.scaling.logBase for a in (chart.x_axis, chart.y_axis)]
    assert found["Amplitude over wavelength"] == [10.0, 10.0]
    assert found["Error over position"] == [None, None]
    columns = [
        c for c in book["Profiles"].iter_cols() if c[0].value == "Amplitude over wavelength"
    ]
    held = {c[1].value: [x.value for x in c[3:] if x.value is not None] for c in columns}
    for way in dict.fromkeys(spectrum["direction"]):
        wanted = [
            a
            for a, w in zip(spectrum["amplitude_nm"], spectrum["direction"], strict=True)
            if w == way
        ]
        assert held[f"amplitude, {way}"] == pytest.approx(wanted, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("text", HOSTILE)
def test_a_workbook_of_hostile_names_holds_texts_only(text):
    document = _document(_entry() | {"name": text, "definition": text}, title=text)
    document |= {"messages": [text], "recipe": {"text": text, "sha256": text}}

    book = _book(document)

    for sheet in book:
        for row in sheet.iter_rows():
            assert all(c.data_type != "f" and c.hyperlink is None for c in row)
    assert "\x1b" not in str(_cells(book["Summary"]))


def test_a_text_that_no_cell_holds_goes_on_below():
    text = "long " * 20_000

    cells = _cells(_book(_document(messages=[text], recipe={"text": text}))["Provenance"])

    assert "".join(str(c) for c in cells).count("long") == 20_000


def test_the_bytes_do_not_depend_on_the_clock(document, tmp_path, monkeypatch):
    first = write_workbook(document, tmp_path / "a.xlsx").read_bytes()
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 1e6)

    assert render_workbook(document) == first
    assert write_csv(document, tmp_path / "a.csv").read_bytes() == render_csv([document]).encode()


def test_without_xlsxwriter_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "xlsxwriter", None)

    with pytest.raises(UnsupportedFeatureError, match="pip install"):
        render_workbook(_document())


def _bar(value, lower=None, upper=None, U=1.0, guard=1.0):
    return bar_of(
        CharacteristicRow("", "", "", "q", "q", "1", value, lower, upper, None, U, guard, "accept")
    )


def test_a_bar_between_two_limits():
    """From -2 to 10: a quarter of the range of 8 beyond both limits."""
    bar = _bar(4.0, 0.0, 8.0, guard=0.0)

    assert bar["limits"] == pytest.approx([1 / 6, 5 / 6], abs=FRACTION)
    assert bar["value"] == pytest.approx(0.5, abs=FRACTION)
    assert bar["spread"] == pytest.approx([5 / 12, 7 / 12], abs=FRACTION)
    assert bar["zone"] == pytest.approx(bar["limits"], abs=FRACTION)
    assert (bar["guards"], bar["beyond"]) == ([], 0)


def test_the_guard_band_lies_on_both_sides_of_an_upper_limit():
    """From 0 to 8 + 1 + 2 = 11: the guard band ends at 9."""
    bar = _bar(4.0, upper=8.0)

    assert bar["guards"] == [pytest.approx([7 / 11, 9 / 11], abs=FRACTION)]
    assert bar["zone"] == pytest.approx([0.0, 7 / 11], abs=FRACTION)
    assert bar["value"] == pytest.approx(4 / 11, abs=FRACTION)


def test_a_lower_limit_accepts_above():
    bar = _bar(4.0, lower=2.0)

    assert bar["zone"][1] == 1.0
    assert bar["zone"][0] > bar["limits"][0]


@pytest.mark.parametrize(("value", "beyond"), [(1e6, 1), (-1e6, -1), (3.0, 0)])
def test_a_value_far_out_is_drawn_at_the_end(value, beyond):
    bar = _bar(value, 0.0, 8.0)

    assert bar["beyond"] == beyond
    assert 0.0 <= bar["value"] <= 1.0


def test_guard_bands_that_meet_leave_no_zone():
    assert _bar(4.0, 0.0, 8.0, U=5.0, guard=5.0)["zone"] is None


@pytest.mark.parametrize("arguments", [(None, 0.0, 1.0), (1.0, None, None)])
def test_without_value_or_limit_there_is_no_bar(arguments):
    assert _bar(*arguments) is None


@pytest.mark.parametrize("limit", [0.0, -3.0, 1e-30])
def test_one_limit_of_any_sign_gives_a_bar(limit):
    for bar in (_bar(limit, upper=limit, U=0.0, guard=0.0), _bar(limit, lower=limit, U=None)):
        assert 0.0 <= bar["limits"][0] <= 1.0
