"""The first page of a report: every field that is stated, none that is not; drafts, languages, templates."""

import hashlib
import io
import json
import re
import shutil
import struct
import subprocess
import sys
import tomllib
import zlib
from html import unescape

import numpy as np
import openpyxl
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.core.errors import DataError, RecipeError, UnsupportedFeatureError
from metrosep.parameters import conformance_probability
from metrosep.recipe import Recipe
from metrosep.recipe.look import clean_svg
from metrosep.recipe.report_fields import (
    LANGUAGES,
    checked_report,
    flat_fields,
    missing_fields,
    report_tables,
)
from metrosep.report import render_dfq, render_html
from metrosep.report.certificate import catalogue, quoted, said
from metrosep.report.issuing import Register
from metrosep.report.text import capital, rounded_pair
from metrosep.report.view import view
from metrosep.report.workbook import render_workbook

PROBABILITY = 5e-7
"""Half of the last digit of the values that were computed elsewhere."""

STEPS = """metrosep = 1
title = "Ring"
[input]
files = ["part.x3p"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sq", "Sz"]
[[check]]
metric = "Sq"
upper = "60 nm"
U = "2.13 nm"
k = 2.13
U_from = "certificate: PTB 4711"
"""

REPORT = """[report]
kind = "calibration certificate"
number = "2026-0815"
revision = 1
replaces = "2026-0800"
change = "substituted"
reason = "wrong drawing number"
location = "laboratory"
place = "room 0.17"
procedure = "AA 12"
received = 2026-03-01
measured = ["2026-03-02", "2026-03-04"]
issued = 2026-03-05
temperature = "20.1 degC"
temperature_U = "0.2 K"
humidity = "45 %"
pressure = "1013.2 hPa"
traceability = "Traceable to the SI through PTB 4711."
deviations = "Probe at 12 mm instead of 10 mm."
external = "Hardness by a partner."
[report.laboratory]
name = "Pruefstelle Sued"
street = "Ringweg 3"
city = "80331 Munich"
country = "DE"
accreditation = "D-K-12345"
[report.customer]
name = "Optik AG"
city = "Jena"
country = "CH"
contact = "Frau Lang"
order = "B-77"
[report.item]
name = "Mirror"
drawing = "Z-100"
material = "OFHC copper"
manufacturer = "Dreherei"
model = "M1"
serial = "A-0042"
condition = "clean"
[report.machine]
manufacturer = "Maker"
model = "L200"
serial = "M-9"
controller = "PMAC 3"
axes = "X, Z at 10 mm"
compensation = "off"
warm_up = "2 h at 1000 rpm"
[[report.instrument]]
name = "Interferometer"
manufacturer = "Zeta"
model = "I-1"
serial = "I-77"
certificate = "PTB 4711"
certificate_date = 2025-06-01
due = 2026-06-01
sha256 = "0f3b4c5d6e7f80910f3b4c5d6e7f80910f3b4c5d6e7f80910f3b4c5d6e7f8091"
[report.persons]
measured = "Mia Messer"
checked = "Carl Check"
released = "Rita Reich"
"""


@pytest.fixture
def part(tmp_path):
    """A map of 50 nm amplitude, written once as x3p."""
    x = np.arange(48) * 100e-6
    z = 60e-9 * np.sin(np.add.outer(x, x) / 1e-3)
    ms.write(ms.Surface(z, 100e-6, 100e-6), tmp_path / "part.x3p")
    return tmp_path / "part.x3p"


def run(part, more="", *, out=None, **options):
    """Return the document of the recipe with a table [report]."""
    text = STEPS + more
    return Recipe.parse(text, folder=part.parent, **options).run(part, out=out).document


def words(page):
    """Return the text of a page."""
    flat = re.sub(r"<style>.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL)
    return " ".join(unescape(flat).split())


def command(*arguments):
    """Return the exit code of the command line."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code


# ---- fields ------------------------------------------------------------------------------------


def test_every_field_that_is_stated_is_on_the_page(part):
    document = run(part, REPORT)
    shown = words(render_html(document))

    as_shown = {"temperature": "(20.10 ± 0.20) °C", "temperature_U": "0.20", "humidity": "45 %",
                "pressure": "1013.2 hPa", "measured": "2026-03-02 … 2026-03-04", "location": "laboratory",
                "machine.compensation": "off", "revision": "revision 1"}  # fmt: skip
    for key, value in flat_fields(document["report"]):
        assert as_shown.get(key, str(value)) in shown, key
    assert "DRAFT" not in shown
    assert "Not stated" not in shown


def test_this_file_states_every_field_that_there_is():
    stated = checked_report(tomllib.loads(REPORT)["report"])
    keys = {re.sub(r"\.\d+\.", ".", k) for k, _ in flat_fields(stated)}
    declared = {
        f"{table}.{k}".lstrip(".") for table, keys in report_tables().items() for k in keys
    }
    tables = set(report_tables()) | {"template", "language"}
    assert keys == declared - tables


def test_without_a_report_the_page_is_a_draft_that_names_what_is_missing(part):
    document = run(part)
    shown = words(render_html(document))
    assert "report" not in document
    assert "DRAFT" in shown
    for key in missing_fields({}):
        assert key in shown


@pytest.mark.parametrize("key", missing_fields({}))
def test_a_report_is_a_draft_while_one_field_is_missing(part, key):
    document = run(part, REPORT)
    held = document["report"]
    table, _, own = key.rpartition(".")
    (held[table] if table else held).pop(own)
    shown = words(render_html(document))
    assert "DRAFT" in shown
    assert key in shown


def test_a_report_changes_no_hash_and_no_number(part):
    plain, stated = run(part), run(part, REPORT)
    assert plain["recipe"]["sha256"] == stated["recipe"]["sha256"]
    assert plain["characteristics"] == stated["characteristics"]


def test_another_instrument_brings_no_certificate_of_the_one_before(part):
    typed = ["instrument.serial=NEW-1"]
    found = run(part, REPORT, report=typed)["report"]
    (instrument,) = [i for i in found["instrument"] if i.get("serial") == "NEW-1"]
    assert set(instrument) == {"serial"}


def test_the_order_of_precedence_is_command_line_file_beside_recipe(part):
    part.with_name("part.x3p.report.toml").write_text('number = "beside"\n[item]\nserial = "S1"\n')
    found = run(part, REPORT, report=["number=typed", "customer.name={file}"])["report"]
    assert (found["number"], found["item"]["serial"]) == ("typed", "S1")
    assert found["item"]["name"] == "Mirror"
    assert found["customer"]["name"] == "part.x3p"
    origins = [found["origin"][k] for k in ("number", "item.serial", "item.name")]
    assert origins == ["command line", "file beside the input", "recipe"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[report]\nnummer = "7"\n', 'unknown key "nummer".*Did you mean "number"'),
        ('[report]\nissued = "05.03.2026"\n', "year-month-day"),
        ('[report]\nmeasured = ["2026-03-05", "2026-03-04"]\n', "lies behind"),
        ('[report]\ntemperature = "20.1"\n', "temperature"),
        ('[report]\nlanguage = "fr"\n', "not one of en, de, zh, ja"),
        ("[report]\nrevision = -1\n", "revision"),
        ('[report.item]\nname = "' + "x" * 10_000 + '"\n', "10000 characters"),
        ('[report]\nnumber = "{serial}"\n', r"\{serial\}.*not known"),
    ],
)
def test_what_is_wrong_in_a_report_is_one_sentence(part, text, says):
    with pytest.raises(RecipeError, match=says):
        run(part, text)


def test_an_instrument_out_of_calibration_is_a_warning_on_the_first_page(part):
    document = run(part, REPORT.replace("due = 2026-06-01", "due = 2026-03-03"))
    first = words(render_html(document)).partition("Annex")[0]
    assert "was due on 2026-03-03, before the measurement on 2026-03-04" in first


@pytest.mark.parametrize(
    ("moment", "agrees"), [("2026-03-04T23:30:00", True), ("2026-03-05T01:00:00", True),
                           ("2026-03-06T08:00:00", False), ("2026-02-27T08:00:00", False)],
)  # fmt: skip
def test_a_stated_date_that_the_file_contradicts_is_a_warning_on_the_first_page(
    part, moment, agrees
):
    document = run(part, REPORT)
    document["inputs"][0]["measured_at"] = moment
    first = words(render_html(document)).partition("Annex")[0]
    told = f"measured 2026-03-02 to 2026-03-04, the measured file {moment[:10]}"
    assert (told not in first) == agrees


# ---- numbers on paper ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "U", "unit", "shown"),
    [
        (2.32441e-9, 0.196e-9, "m", ("2.32", "0.20", "nm")),
        (1.3634567e-6, 0.1049e-6, "m", ("1.36", "0.10", "µm")),
        (50.616486e-6, 0.0000642e-6, "m", ("50.616486", "0.000064", "µm")),
        (-15.79e-6, 0.3152e-6, "rad", ("−15.79", "0.32", "µrad")),
        (0.84137e-12, 0.0996e-12, "m", ("0.84", "0.10", "pm")),
        (100.00449e-3, 0.000995e-3, "m", ("100.0045", "0.0010", "mm")),
        (0.0, 2.5e-9, "m", ("0.0", "2.5", "nm")),
        (0.5e-6, 120e-9, "m", ("0.50", "0.12", "µm")),
        (1363.4, 120.0, "1", ("1360", "120", "")),
        (-427e-12, 65e-6, "m", ("0", "65", "µm")),
        (1.3634567e-6, 99.96e-9, "m", ("1.36", "0.10", "µm")),
    ],
)
def test_value_and_uncertainty_are_rounded_to_the_same_place(value, U, unit, shown):
    assert rounded_pair(value, U, unit) == shown


@pytest.mark.parametrize(
    ("value", "u", "U", "shown"),
    [
        (-427e-12, 32.5e-6, 65e-6, ("0", "32", "65", "µm")),
        (1.3634567e-6, 0.0498e-6, 0.0996e-6, ("1.36", "0.05", "0.10", "µm")),
        (2.32441e-9, None, 0.196e-9, ("2.32", "–", "0.20", "nm")),
        (100.00449e-3, 0.000995e-3, None, ("100.0045", "0.0010", "–", "mm")),
        (1e-6, 1e-9, 5e-6, ("1.0", "0.001", "5.0", "µm")),  # u of a fit beside a typed U
        (1e-6, 1e-40, None, ("1.000", "1e-34", "–", "µm")),  # below the digits of the value
    ],
)
def test_page_annex_workbook_and_exchange_file_round_alike(value, u, U, shown):
    judged = {"U": U, "k": 2.0, "upper": 2e-3, "verdict": "accept"} if U else {"dof": 1e9}
    entry = {"metric": "m", "name": "m", "value": value, "unit": "m", "u": u, **judged}
    document = {"characteristics": [entry], "inputs": [], "recipe": {}}
    seen = view(document)
    annex, (first,) = seen["characteristics"][0], seen["c"]["rows"]
    assert (annex["value"], annex["u"], annex["U"], annex["unit"]) == shown
    assert (first["value"], first["unit"]) == (shown[0], shown[3])
    if U or u > 1e-20:
        assert first["U"] == (shown[2] if U else "0.0020")
    book = openpyxl.load_workbook(io.BytesIO(render_workbook(document)))["Characteristics"]
    head = {c.value: c.column for c in book[1]}
    cell = book.cell(2, head["value"])
    digits = len(cell.number_format.partition(".")[2])
    assert digits == len(shown[0].partition(".")[2])
    assert book.cell(2, head["unit"]).value == shown[3]
    dfq = render_dfq([document]).decode("cp1252")
    if U:  # in mm, the unit of the limit
        power = {"µm": 3, "nm": 6, "mm": 0}[shown[3]]
        assert f"K2022/1 {digits + power}\r\n" in dfq


def test_the_probability_of_conformity_is_that_of_the_guide():
    assert conformance_probability(9.87, 0.15, upper=10.0) == pytest.approx(
        0.806938, abs=PROBABILITY
    )
    both = conformance_probability(101.2, 0.2, lower=100.0, upper=101.5)
    assert both == pytest.approx(0.933193, abs=PROBABILITY)
    few = conformance_probability(9.87, 0.15, upper=10.0, dof=3.0)
    assert few == pytest.approx(0.7751, abs=5e-5)


def test_k_follows_the_degrees_of_freedom():
    from metrosep.forms._correlated import expanding_factor
    from metrosep.parameters import coverage_factor

    known = {3: 3.306822, 5: 2.648649, 10: 2.283678, 20: 2.133025, 50: 2.051248}
    for dof, k in known.items():
        assert expanding_factor(dof) == pytest.approx(k, abs=PROBABILITY)
        assert coverage_factor(dof=dof) == pytest.approx(k, abs=PROBABILITY)


def test_k_and_origin_of_the_uncertainty_stand_on_the_first_page(part):
    first = words(render_html(run(part, REPORT))).partition("Annex")[0]
    assert re.search(r"Sq|root mean square", first)
    assert "from the certificate PTB 4711, k = 2.13, coverage probability 95.45" in first
    stated = Recipe.parse(STEPS + 'p = "96 %"\n', folder=part.parent).run(part).document
    assert "k = 2.13, coverage probability 96.00 %" in words(render_html(stated))


@pytest.mark.parametrize(
    ("upper", "word"), [("43.5 nm", "conditional pass"), ("42 nm", "conditional fail")]
)
def test_an_inconclusive_value_says_on_which_side_it_lies(part, upper, word):
    text = STEPS.replace('upper = "60 nm"', f'upper = "{upper}"')
    document = Recipe.parse(text, folder=part.parent).run(part).document
    assert document["verdict"] == "inconclusive"
    value = document["characteristics"][0]["value"]
    assert (value < float(upper.split()[0]) * 1e-9) == (word == "conditional pass")
    shown = words(render_html(document))
    assert word in shown
    assert (
        "at least one check, and none is rejected." in shown
    )  # a limit may be broken all the same


# ---- languages -----------------------------------------------------------------------------------


def test_every_language_has_every_text_with_the_same_places():
    english = catalogue("en")
    for language in LANGUAGES:
        own = catalogue(language)
        assert own.keys() == english.keys()
        for key, text in own.items():
            assert sorted(re.findall(r"{\w+}", text)) == sorted(re.findall(r"{\w+}", english[key]))


@pytest.mark.parametrize(
    ("language", "texts"),
    [
        ('"de"', ["Kalibrierschein", "ANGENOMMEN", "Auftraggeber", "2,13", "Erweiterungsfaktor"]),
        ('"zh"', ["校准证书", "合格", "客户", "签发日期", "包含因子"]),
        ('"ja"', ["校正証明書", "合格", "依頼者", "発行日", "包含係数"]),
        ('["en", "zh"]', ["calibration certificate / 校准证书", "ACCEPTED / 合格"]),
    ],
)
def test_the_page_speaks_the_language(part, language, texts):
    shown = words(
        render_html(
            run(part, REPORT.replace("[report]\n", f"[report]\nlanguage = {language}\n", 1))
        )
    )
    for text in texts:
        assert text in shown


FOREIGN = [n for n in LANGUAGES if n != "en"]


def test_every_sentence_of_the_program_is_in_every_language_with_the_same_places():
    english = set()
    for entry in catalogue("sentences")["say"]:
        assert set(entry) == set(LANGUAGES)
        places = sorted(re.findall(r"{\w+}", entry["en"]))
        for language in FOREIGN:
            assert entry[language] != entry["en"]
            assert sorted(re.findall(r"{\w+}", entry[language])) == places
        english.add(entry["en"].lower())
    assert len(english) == len(catalogue("sentences")["say"])
    words = catalogue("pictures")
    assert set(words) == set(FOREIGN)
    assert len({frozenset(words[n]) for n in FOREIGN}) == 1


@pytest.mark.parametrize(
    "language",
    ["de", "ja", pytest.param("zh", marks=pytest.mark.slow)],  # the places are those of ja
)
def test_no_sentence_of_a_certificate_is_english_but_what_a_person_wrote(part, language):
    text = REPORT.replace("[report]\n", f'[report]\nlanguage = "{language}"\n', 1)
    document = run(part, text)
    # a warning of each kind: one that is known, and one that no catalogue holds
    document["messages"] = [
        "outliers: 12 of 10869 measured heights removed (robust sigma 1.488 nm); nothing is filled",
        "a sentence of tomorrow's version",
    ]
    page = render_html(document)
    shown = words(page[: page.index("<pre")] if "<pre" in page else page)
    assert quoted("A sentence of tomorrow's version.", language) in shown
    for english in (
        "What is left after", "not measured or removed", "root mean square", "measured heights removed",
        "step by step", "heights about their mean", "Through the middle", "standard uncertainty u",
        "before any further step", "guard band ",
    ):  # fmt: skip
        assert english not in shown.replace("A sentence of tomorrow's version", "")
    comma = "," if language == "de" else "."
    assert f"1{comma}488 nm" in shown


def test_what_a_level_map_without_a_form_step_says_is_in_the_language(part):
    """A wave of whole periods: the mean of its heights is the rounding of their sum, not a piston."""
    wave = 50e-9 * np.sin(2 * np.pi * np.arange(64) / 16)
    ms.write(ms.Surface(np.tile(wave, (64, 1)), 100e-6, 100e-6), part)
    text = '[[step]]\nop = "parameters"\nnames = ["Sq"]\n[report]\nlanguage = "de"\n'
    text = f'metrosep = 1\n[input]\nfiles = ["{part.name}"]\n{text}'
    page = render_html(Recipe.parse(text, folder=part.parent).run(part).document)
    shown = words(page[: page.index("<pre")])
    assert "Es wurde keine Form entfernt: Neigung, Form und Welligkeit" in shown
    assert "No form removal" not in shown
    assert "abgezogen" not in shown


def test_captions_of_a_map_with_pixels_far_from_the_mean_are_in_the_language(repository):
    """The part of the examples has chips: sections go through one, and the histogram leaves some out."""
    map_ = repository / "examples/measured_part/measured.sdf"
    text = (
        f'metrosep = 1\n[input]\nfiles = ["{map_.name}"]\n[[step]]\nop = "form"\nform = "sphere"\n'
    )
    text += '[[step]]\nop = "parameters"\nnames = ["Sq"]\n[report]\nlanguage = "de"\n'
    page = render_html(Recipe.parse(text, folder=map_.parent).run(map_).document)
    shown = words(page[: page.index("<pre")])
    for own in (
        "Durch die Mitte und durch den Bildpunkt", "Höhen liegen unter", "Messung einer Höhenkarte",
        "Rest nach Abzug der Form",
    ):  # fmt: skip
        assert own in shown
    for english in ("Through the middle", "heights below", "Measurement of"):
        assert english not in shown


@pytest.mark.parametrize("language", FOREIGN)
def test_a_sentence_keeps_every_number_and_the_order_of_limits(language):
    english = "ppp: R is the largest of few: 1.31 times what it would be with many runs (interval 2.981 nm to 7.242 nm)"
    own = said(english, language)
    numbers = re.findall(r"\d+[.,]\d+", own)
    assert [n.replace(",", ".") for n in numbers] == ["1.31", "2.981", "7.242"]
    # a sentence that ends where another begins is not swallowed by a place that is open
    both = said("Drawn up to 60. Gaps were not measured. Strange.", language)
    assert both.count("60") == 1
    assert "Gaps" not in both
    assert "Strange." in both
    assert said("Drawn up to 60", "en") == "Drawn up to 60"


@pytest.mark.parametrize("language", FOREIGN)
def test_what_a_person_typed_is_printed_as_typed(part, language):
    text = REPORT.replace("[report]\n", f'[report]\nlanguage = "{language}"\n', 1)
    text = text.replace('"Interferometer"', '"filter, FX-3.2"').replace("2026-06-01", "2026-03-03")
    steps = STEPS.replace('metric = "Sq"', 'metric = "Sq"\nname = "Filter 0.8"')
    two = '[[check]]\nmetric = "Sz"\nname = "form"\nupper = "1 um"\nU = "2 nm"\n'
    made = Recipe.parse(steps + two + text, folder=part.parent).run(part).document
    made["messages"] = ["u of a message that no catalogue holds"]
    shown = words(render_html(made))
    assert "u of a message that no" in shown
    assert "U of a message" not in shown
    assert shown.count("filter, FX-3.2") >= 2  # among the instruments and in the warning
    page = view(made)
    for rows in (page["c"]["rows"], page["characteristics"]):
        assert {"Filter 0.8", "form"} <= {r["name"] for r in rows}
    assert any(o.startswith("Filter 0.8: ") for o in page["c"]["origins"])
    assert said("form", language) != "form"  # as a step it is the program's
    typed = "The calibration of probe 12.345 was due on 05.01.2026, before the measurement on 06.01.2026."
    for kept in ("probe 12.345", "05.01.2026", "06.01.2026"):
        assert kept in quoted(typed, language)


@pytest.mark.parametrize("language", FOREIGN)
def test_a_standard_uncertainty_keeps_its_letter(language):
    english = (
        "u from the correlation of the residual (5.2 steps, about 12 independent cells), 10 degrees of "
        "freedom, k = 2.28 for 95.45 %; scale, reference and repeatability are not in it."
    )
    assert capital(english) == english
    for own in (
        said(english, language),
        said(f"U{english[1:]}", language),
    ):  # of an older result too
        assert own.startswith("u")
        assert "U" not in own.replace("Unsicherheit", "")
    assert [capital(s) for s in ("a map", "x: 3", "σ of", "uneven")] == [
        "A map",
        "x: 3",
        "σ of",
        "Uneven",
    ]


@pytest.mark.parametrize(
    ("language", "pairs", "runs"),
    [
        (
            "de",
            ["9,9 mm bei 7200 mm/min", "6,6 mm bei 4800 mm/min"],
            "2400, 9600 und 12000 mm/min",
        ),
        ("zh", ["7200 mm/min 时 9.9 mm", "4800 mm/min 时 6.6 mm"], "2400、9600 和 12000 mm/min"),
        ("ja", ["7200 mm/min で 9.9 mm", "4800 mm/min で 6.6 mm"], "2400、9600 及び 12000 mm/min"),
    ],
)
def test_each_wavelength_of_a_disturbance_keeps_its_feed(language, pairs, runs):
    by_hand = [7200 / 60 / 12.1, 4800 / 60 / 12.1]  # mm: feed per period
    sentence = (
        f"12.1 Hz disturbance maps onto {by_hand[0]:.1f} mm at 7200 mm/min, {by_hand[1]:.1f} mm at "
        "4800 mm/min; the runs at 2400, 9600 and 12000 mm/min distinguish it from the geometry."
    )
    own = said(sentence, language)
    assert re.split(" at | and ", own) == [own]
    for text in (*pairs, runs):
        assert text in own
    one = said("12.1 Hz disturbance maps onto 9.9 mm at 7200 mm/min; the runs at 4800 and 9600 mm/min distinguish it from the geometry", language)  # fmt: skip
    assert pairs[0] in one
    # a place for digits takes no words
    assert said("The gap of 3 mm at 7200 mm/min", language) == "The gap of 3 mm at 7200 mm/min"


DIRECTED = {  # English: what stands for it in de, zh, ja, in this order
    "actual − nominal": ("Ist − Soll", "实际 − 标称", "実際 − 公称"),
    "reached − target": ("erreicht − Ziel", "实际 − 目标", "到達 − 目標"),
    "c = −e": ("c = −e", "c = −e", "c = −e"),
    "forward - backward": ("vorwärts − rückwärts", "正向 − 反向", "正方向 − 負方向"),
    "mean forward": ("Mittel vorwärts", "正向平均值", "正方向の平均"),
    "mean backward": ("Mittel rückwärts", "反向平均值", "負方向の平均"),
    "forward": ("vorwärts", "正向", "正方向"),
    "reverse": ("rückwärts", "反向", "負方向"),
    "backward": ("rückwärts", "反向", "負方向"),
    "before the table": ("vor der Tabelle", "使用补偿表前", "補正前"),
    "after the table": ("nach der Tabelle", "使用补偿表后", "補正後"),
    "{below} pixels below": ("{below} Bildpunkte unter", "低于色标 {below}", "目盛より下 {below}"),
    "{above} above the picture": ("{above} über", "上方 {above}", "上 {above}"),
    "{below} heights below": ("{below} Höhen liegen unter", "下方另有 {below}", "下 {below}"),
    "{low} to {high}": ("{low} bis {high}", "{low} 至 {high}", "{low} ～ {high}"),
    "{before} -> {after}": ("{before} -> {after}",) * 3,
    "inside the limit": ("innerhalb", "在限值内", "限界内"),
    "outside the limit": ("außerhalb", "超出限值", "限界外"),
    "share above": ("darüber", "高于", "上の割合"),
    "heights above": ("darüber", "高于", "上の割合"),
}
WORDS = {  # whole texts of the catalogue
    "accept": ("angenommen", "合格", "合格"),
    "reject": ("zurückgewiesen", "不合格", "不合格"),
    "conditional_pass": ("bedingt bestanden", "有条件合格", "条件付き合格"),
    "conditional_fail": ("bedingt nicht bestanden", "有条件不合格", "条件付き不合格"),
    "before": ("vorher", "补偿前", "補正前"),
    "after": ("nachher", "补偿后", "補正後"),
    "on": ("ein", "开", "有効"),
    "off": ("aus", "关", "無効"),
    "reversed_sign": ("mit falschem Vorzeichen", "符号相反", "符号を逆"),
    "sign_note": ("zum Sollwert addiert", "加到指令上", "指令に加え"),
    "means_accept": ("liegen innerhalb", "均符合", "適合している"),
    "means_reject": ("liegt außerhalb", "超出限值", "外れている"),
}


@pytest.mark.parametrize("language", FOREIGN)
def test_signs_and_directions_are_those_of_the_english_text(language):
    """By a table made by hand: an opposite translation has every place and no English."""
    at = ["de", "zh", "ja"].index(language)
    fixed, english = catalogue(language), catalogue("en")
    texts = [(e["en"], e[language]) for e in catalogue("sentences")["say"]]
    texts += [(english[k], fixed[k]) for k in english]
    texts += list(catalogue("pictures")[language].items())
    for phrase, own in DIRECTED.items():
        found = [
            (en, to) for en, to in texts
            if re.search(rf"(?<![\w{{]){re.escape(phrase)}(?![\w}}])", en)
        ]  # fmt: skip
        assert found, phrase
        for en, to in found:
            assert any(word in to for word in own[at].split("|")), (en, to)
            if (
                phrase in ("forward", "reverse", "backward")
                and len(re.findall("forward|reverse|backward", en)) == 1
            ):
                against = DIRECTED["reverse" if phrase == "forward" else "forward"][at].split("|")
                assert not any(word in to for word in against), (en, to)
    for key, own in WORDS.items():
        assert fixed[key].startswith(own[at]) or own[at] in fixed[key][1:], (key, fixed[key])


def test_pictures_without_a_font_stay_english_and_the_page_says_so(part, monkeypatch):
    from metrosep.plot import style

    text = REPORT.replace("[report]\n", '[report]\nlanguage = "ja"\n', 1)
    document = run(part, text)
    plain = style.font_with.__wrapped__
    monkeypatch.setattr(style, "font_with", lambda letters: None)
    assert "Noto Sans CJK" in words(render_html(document))
    assert plain("\U0010fffd") is None
    assert plain("Höhe") == "DejaVu Sans"


# ---- the template of the house -------------------------------------------------------------------

SVG = (
    b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><rect width="9" height="9"/></svg>'
)


def png(rows=2):
    """Return the bytes of a small PNG, written chunk by chunk."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", 2, rows, 8, 0, 0, 0, 0)
    body = zlib.compress(b"\0\0\0" * rows)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


def with_template(part, text, **files):
    """Return the document of a report with a template."""
    for name, data in files.items():
        (part.parent / name.replace("_", ".")).write_bytes(data)
    (part.parent / "house.toml").write_text(text, encoding="utf-8")
    return run(part, '[report]\ntemplate = "house.toml"\n')


@pytest.mark.parametrize(("name", "data"), [("logo.svg", SVG), ("logo.png", png())])
def test_a_logo_is_embedded(part, name, data):
    (part.parent / name).write_bytes(data)
    document = with_template(part, f'logo = "{name}"\ncolour = "#004b87"\nfooter = "Tel. 12"\n')
    page = render_html(document)
    assert document["report"]["look"]["logo"] in page
    assert "#004b87" in page
    assert "Tel. 12" in page


def test_a_script_in_a_template_is_a_text_that_nothing_runs(part):
    evil = "</style><script>alert(1)</script>"
    page = render_html(with_template(part, f'header = "{evil}"\nfooter = "{evil}"\n'))
    assert "<script" not in page
    assert page.count("</style>") == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('colour = "red;}body{display:none"\n', "six digits"),
        ("font = 'x\"} body {'\n", "name of one font"),
        ('logo = "../secret.png"\n', "beside the template"),
        ('logo = "text.png"\n', "not a PNG or SVG"),
        ('logo = "cut.png"\n', "damaged PNG"),
        ('logo = "big.svg"\n', "larger than"),
        ('logo = "gone.png"\n', "gone.png"),
        ('script = "x"\n', 'unknown key "script"'),
        ('language = "fr"\n', "the template: language = 'fr' is not one of en, de, zh, ja"),
        ('language = ["en", "de", "zh"]\n', "one or two languages, got 3"),
    ],
)
def test_a_wrong_template_is_refused_before_anything_is_written(part, text, says):
    out = part.parent / "out"
    files = {"text.png": b"hello", "cut.png": png()[:-20], "big.svg": SVG + b" " * 600_000}
    for name, data in files.items():
        (part.parent / name).write_bytes(data)
    (part.parent / "house.toml").write_text(text, encoding="utf-8")
    with pytest.raises(RecipeError, match=says):
        run(part, '[report]\ntemplate = "house.toml"\n', out=out)
    assert not out.exists()


def test_a_cleaned_svg_keeps_shapes_only():
    made = clean_svg(
        b'<svg xmlns="http://www.w3.org/2000/svg" xmlns:x="http://www.w3.org/1999/xlink" onload="a()">'
        b'<script>b()</script><a x:href="http://h"><rect/></a><switch><circle r="2"/></switch><image x:href="file:///etc/passwd"/>'
        b'<foreignObject><p xmlns="http://www.w3.org/1999/xhtml">c</p></foreignObject>'
        b'<rect width="3" style="fill:url(http://h/x);stroke:#fff" onclick="d()"/>'
        b'<style>@import "http://h"</style></svg>'
    )
    shapes = b'<g><rect /></g><g><circle r="2" /></g><rect width="3" stroke="#fff" />'
    assert made == b'<svg xmlns="http://www.w3.org/2000/svg">' + shapes + b"</svg>"
    for bad in (
        b"<svg>",
        b"<html xmlns='http://www.w3.org/1999/xhtml'/>",
        b"<!DOCTYPE svg [<!ENTITY a 'b'>]><svg/>",
    ):
        with pytest.raises(DataError, match="logo"):
            clean_svg(bad)


# ---- issuing, at the door ---------------------------------------------------------------------------


def issue(result, out, *more, number="2026-1", name="Rita Reich"):
    """Return the exit code of issuing a report."""
    words = ["--number", number, "--date", "2026-03-05", "--released", name]
    return command("-q", "report", result, "-o", out, "--issue", *words, *more)


FIELDS = (
    "--report",
    "laboratory.name=L",
    "--report",
    "item.name=ring",
    "--report",
    "item.serial=7",
)


@pytest.fixture
def results(part):
    """Two folders with results whose bytes differ."""
    folder = part.parent
    for name in ("a", "b"):
        run(part, f'[report.item]\nmaterial = "{name}"\n', out=folder / name)
    return folder / "a", folder / "b"


def test_a_number_belongs_to_one_result_for_good(results, tmp_path, capsys):
    a, b = results
    out = tmp_path / "issued"
    assert issue(a, out, *FIELDS) == 0
    first = {f.name: f.read_bytes() for f in out.iterdir()}
    assert sorted(first) == ["2026-1.html", "issue.json"]
    assert "DRAFT" not in first["2026-1.html"].decode()

    assert issue(a, out, *FIELDS) == 0
    assert issue(b, out, *FIELDS) == 2
    said = capsys.readouterr().err
    for folder in (a, b):
        assert hashlib.sha256((folder / "result.json").read_bytes()).hexdigest() in said
    assert issue(a, out, *FIELDS, name="Somebody else") == 2
    assert {f.name: f.read_bytes() for f in out.iterdir()} == first

    assert issue(b, out, *FIELDS, number="2026-2") == 0
    rows = json.loads((out / "issue.json").read_text())["issued"]
    assert [r["number"] for r in rows] == ["2026-1", "2026-2"]


def test_two_processes_do_not_issue_into_one_folder_at_once(results, tmp_path, capsys):
    out = tmp_path / "issued"
    out.mkdir()
    with Register.held(out):
        assert issue(results[0], out, *FIELDS) == 2
        assert "another report is being issued into this folder" in capsys.readouterr().err
    assert not [*out.iterdir()]
    assert issue(results[0], out, *FIELDS) == 0


def test_issuing_without_a_serial_writes_nothing(results, tmp_path, capsys):
    out = tmp_path / "issued"
    assert issue(results[0], out, *FIELDS[:-2]) == 2
    assert "item.serial" in capsys.readouterr().err
    assert not out.exists() or not [*out.iterdir()]


def test_no_number_is_issued_for_a_certificate_that_cannot_be_made(
    results, tmp_path, capsys, monkeypatch
):
    out = tmp_path / "issued"
    assert (
        issue(results[0], out, *FIELDS, "--format", "dcc") == 2
    )  # a place and a customer are missing
    said = capsys.readouterr().err
    assert "customer.name" in said
    assert "was not issued" in said
    monkeypatch.setitem(sys.modules, "typst", None)  # as where it is not installed
    assert issue(results[0], out, *FIELDS, "--format", "pdf") == 2
    assert 'pip install "metrosep[pdf]"' in capsys.readouterr().err
    assert not [*out.iterdir()]


def test_a_number_without_issue_is_refused(results, tmp_path, capsys):
    assert command("report", results[0], "-o", tmp_path / "r", "--number", "7") == 2
    assert "--number goes with --issue" in capsys.readouterr().err


def test_a_full_disk_leaves_the_register_as_it_was(results, tmp_path, monkeypatch):
    out = tmp_path / "issued"
    assert issue(results[0], out, *FIELDS) == 0
    before = (out / "issue.json").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    assert issue(results[1], out, *FIELDS, number="2026-2") == 2
    assert (out / "issue.json").read_bytes() == before
    assert not (out / "2026-2.html").exists()


def test_chinese_names_of_files_and_numbers_are_kept(part, tmp_path):
    named = part.rename(part.with_name("镜子.x3p"))
    run(named, '[report.item]\nserial = "{file}"\n', out=tmp_path / "结果")
    assert issue(tmp_path / "结果", tmp_path / "发布", *FIELDS[:4], number="检-1") == 0
    assert "镜子.x3p" in (tmp_path / "发布" / "检-1.html").read_text(encoding="utf-8")


# ---- PDF ------------------------------------------------------------------------------------------


def test_each_page_of_the_pdf_has_number_and_page_of_pages(part, tmp_path):
    pytest.importorskip("typst")
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler) is not installed")
    from metrosep.report import render_pdf

    (tmp_path / "x.pdf").write_bytes(render_pdf(run(part, REPORT)))
    made = subprocess.run(
        ["pdftotext", "-layout", str(tmp_path / "x.pdf"), "-"], check=True, capture_output=True
    )
    pages = made.stdout.decode().rstrip("\f").split("\f")
    for i, page in enumerate(pages, start=1):
        assert f"page {i} / {len(pages)}" in page
        assert "2026-0815" in page
    assert "End of report: 2026-0815" in pages[-1]
    flat = re.sub(r"\s+", "", made.stdout.decode().replace("\u200b", ""))
    for text in ("Pruefstelle", "A-0042", "RitaReich", "D-K-12345", "Optik", "1013.2hPa"):
        assert text in flat


def test_letters_that_no_font_has_are_one_sentence(part, monkeypatch):
    pytest.importorskip("typst")
    from metrosep.report import render_pdf

    monkeypatch.setattr("metrosep.report.typeset._SYSTEM_FONTS", False)
    document = run(part, '[report]\nlanguage = "zh"\n')
    with pytest.raises(UnsupportedFeatureError, match="no font on this computer has the Chinese"):
        render_pdf(document)
    render_html(document)


# ---- workbook and plain pages ----------------------------------------------------------------------


def test_the_workbook_states_the_same_and_draws_native_charts(part, tmp_path):
    import io
    import zipfile

    import openpyxl

    from metrosep.report.workbook import render_workbook

    data = render_workbook(run(part, REPORT.replace("due = 2026-06-01", "due = 2026-03-03")))
    book = openpyxl.load_workbook(io.BytesIO(data))
    text = " ".join(str(c.value) for row in book["Summary"].iter_rows() for c in row if c.value)
    for wanted in ("Calibration certificate 2026-0815", "A-0042", "Optik AG",
                   "certificate PTB 4711, k = 2.13", "was due on 2026-03-03"):  # fmt: skip
        assert wanted in text
    charts = [n for n in zipfile.ZipFile(io.BytesIO(data)).namelist() if "charts/chart" in n]
    assert len(charts) == len({c.value for c in book["Profiles"][1]})
    drawn = zipfile.ZipFile(io.BytesIO(data)).read(charts[0]).decode()
    assert "Profiles!$B$4" in drawn
    assert "position / m" in drawn


def test_the_letters_of_a_number_stay_as_they_are(part):
    from metrosep.report.typeset import _lines
    from metrosep.report.view import view

    shown = view(run(part, REPORT.replace('"2026-0815"', '"KB-2026-aB"')))
    assert shown["c"]["heading"] == "Calibration certificate KB-2026-aB"
    assert next(_lines(shown)) == ("title", "Calibration certificate KB-2026-aB")


def test_no_message_is_lost_between_first_page_and_annex(part):
    from metrosep.report.typeset import _lines
    from metrosep.report.view import view

    document = run(part, REPORT)
    document["messages"] = [f"message number {i}" for i in range(7)]
    shown = words(render_html(document))
    plain = " ".join(text for _, text in _lines(view(document)))
    for i in range(7):
        assert shown.count(f"essage number {i}") == 1
        assert plain.count(f"essage number {i}") == 1


# ---- ISO/IEC 17025:2017, clause by clause, through the files that the command line writes ---------

CLAUSES = {
    "7.8.2.1 a": ["kind"],
    "7.8.2.1 b": ["laboratory.name", "laboratory.street", "laboratory.city", "laboratory.country"],
    "7.8.2.1 c": ["location", "place"],
    "7.8.2.1 d": ["number", "revision"],
    "7.8.2.1 e": ["customer.name", "customer.city", "customer.country", "customer.contact", "customer.order"],
    "7.8.2.1 f": ["procedure"],
    "7.8.2.1 g": ["item.name", "item.drawing", "item.material", "item.manufacturer", "item.model",
                  "item.serial", "item.condition"],
    "7.8.2.1 h, i": ["received", "measured"],
    "7.8.2.1 j": ["issued"],
    "7.8.2.1 n": ["deviations"],
    "7.8.2.1 o": ["persons.measured", "persons.checked", "persons.released"],
    "7.8.2.1 p": ["external"],
    "7.8.4.1 b": ["temperature", "temperature_U", "humidity", "pressure"],
    "7.8.4.1 c": ["traceability", "instrument.name", "instrument.manufacturer", "instrument.model",
                  "instrument.serial", "instrument.certificate", "instrument.certificate_date", "instrument.due",
                  "instrument.sha256"],
    "7.8.8": ["replaces", "reason", "change"],
    "ISO 230": ["machine.manufacturer", "machine.model", "machine.serial", "machine.controller",
                "machine.axes", "machine.compensation", "machine.warm_up"],
    "accreditation": ["laboratory.accreditation"],
}  # fmt: skip
"""Fields of `[report]` by clause; what the program makes itself (e: f, k, l, m) is looked for by its words."""

MADE = {
    "7.8.2.1 f, method": r"ISO 25178-2:2021",
    "7.8.2.1 l": r"relate only to the items named",
    "7.8.2.1 m, value and unit": r"43\.1 2\.1 nm|43\.1\s+2\.1\s+nm",
    "7.8.4.1 a, U and k": r"k = 2\.13",
    "7.8.6.2 rule": r"Accepted if the value lies inside its limits by the guard band",
    "7.8.2.1 d, end": r"End of (the )?report",
}


@pytest.fixture(scope="module")
def files_of_a_laboratory(tmp_path_factory):
    """The text of page, workbook and PDF of a recipe with every field, from the command line."""
    openpyxl = pytest.importorskip("openpyxl")
    folder = tmp_path_factory.mktemp("iso17025")
    x = np.arange(48) * 100e-6
    ms.write(
        ms.Surface(60e-9 * np.sin(np.add.outer(x, x) / 1e-3), 100e-6, 100e-6), folder / "part.x3p"
    )
    (folder / "recipe.toml").write_text(STEPS + REPORT, "utf-8")
    assert command("-q", "run", folder / "recipe.toml", "-o", folder / "out") == 0
    texts = {}
    formats = "html,xlsx,pdf" if shutil.which("pdftotext") else "html,xlsx"
    if "pdf" in formats:
        pytest.importorskip("typst")
    assert command("-q", "report", folder / "out", "--format", formats, "-o", folder / "r") == 0
    texts["html"] = words((folder / "r/report.html").read_text("utf-8"))
    sheets = openpyxl.load_workbook(folder / "r/report.xlsx").worksheets
    cells = (c.value for s in sheets for row in s.iter_rows() for c in row if c.value is not None)
    texts["xlsx"] = " ".join(map(str, cells))
    if "pdf" in formats:
        made = subprocess.run(
            ["pdftotext", "-layout", str(folder / "r/report.pdf"), "-"],
            check=True, capture_output=True, text=True,
        )  # fmt: skip
        texts["pdf"] = made.stdout.replace("\u200b", "")
    return texts


def test_the_checklist_names_every_field_there_is():
    keys = {
        re.sub(r"\.\d+\.", ".", k)
        for k, _ in flat_fields(checked_report(tomllib.loads(REPORT)["report"]))
    }
    assert {k for listed in CLAUSES.values() for k in listed} == keys


@pytest.mark.parametrize("clause", CLAUSES)
@pytest.mark.parametrize("form", ["html", "pdf", "xlsx"])
def test_a_clause_of_iso_17025_is_in_the_file(files_of_a_laboratory, clause, form):
    if form not in files_of_a_laboratory:
        pytest.skip("pdftotext (poppler) is not installed")
    shown = re.sub(r"\s+", " ", files_of_a_laboratory[form]).lower()
    stated = flat_fields(checked_report(tomllib.loads(REPORT)["report"]))
    printed = {re.sub(r"\.\d+\.", ".", k): str(v) for k, v in stated}
    printed |= {"temperature": "(20.10 ± 0.20) °C", "temperature_U": "± 0.20", "humidity": "45 %",
                "pressure": "1013.2 hPa", "measured": "2026-03-02 … 2026-03-04", "revision": "revision 1"}  # fmt: skip
    for key in CLAUSES[clause]:
        # in columns of the PDF a value of two words may stand in two lines, and a hash does
        for word in re.findall(r"\S{1,32}", printed[key].lower()):
            assert word in shown, (clause, key)


@pytest.mark.parametrize("clause", MADE)
@pytest.mark.parametrize("form", ["html", "pdf", "xlsx"])
def test_what_the_program_adds_for_iso_17025_is_in_the_file(files_of_a_laboratory, clause, form):
    if form not in files_of_a_laboratory:
        pytest.skip("pdftotext (poppler) is not installed")
    if form == "xlsx" and clause in ("7.8.2.1 m, value and unit", "7.8.2.1 d, end"):
        pytest.skip("a workbook has numbers in cells and no last page")
    assert re.search(MADE[clause], re.sub(r"\s+", " ", files_of_a_laboratory[form]), re.IGNORECASE)


def test_every_page_has_number_revision_and_n_of_n(files_of_a_laboratory):
    if "pdf" not in files_of_a_laboratory:
        pytest.skip("pdftotext (poppler) is not installed")
    pages = files_of_a_laboratory["pdf"].rstrip("\f").split("\f")
    for i, page in enumerate(pages, start=1):
        flat = re.sub(r"\s+", " ", page)
        assert f"page {i} / {len(pages)}" in flat
        assert "2026-0815 revision 1" in flat


def test_what_a_report_replaces_is_said_in_each_language_by_itself(part):
    text = REPORT.replace("[report]\n", '[report]\nlanguage = ["en", "zh"]\n', 1)
    english, _, chinese = view(run(part, text))["c"]["replaces"].partition(" / ")
    assert "substituted" in english
    assert "替换" not in english
    assert "替换" in chinese
    assert "substituted" not in chinese
