"""The report says what the document says, escaped, self-contained, with the same bytes each time."""

import base64
import re
from html.parser import HTMLParser

import pytest

from metrosep.core.errors import DataError, WriteError
from metrosep.report import render_html, write_html
from metrosep.report.certificate import catalogue

HOSTILE = "<script>alert('x')</script> & \"co\""
VOID = {"meta", "img", "br", "link", "input", "hr"}


class _Page(HTMLParser):
    """Tags that are open, every attribute, and the text of a page."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.tags, self.words = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, *a) for a in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", " ".join(self.words))


def _text(document):
    return _Page(render_html(document)).text


textual = pytest.mark.usefixtures("without_figures")
"""Of tests that read what stands beside the figures."""


def test_every_tag_is_closed(whole_page):
    page = _Page(whole_page)

    assert page.open == []


def test_nothing_is_fetched_and_nothing_runs(whole_page):
    page = _Page(whole_page)

    targets = [v for _, name, v in page.attributes if name in ("src", "href", "srcset", "data")]
    assert len(targets) == 5
    assert all(v.startswith("data:image/svg+xml;base64,") for v in targets)
    assert not {"script", "link", "iframe", "object", "form"} & set(page.tags)
    assert not [name for _, name, _ in page.attributes if name.startswith("on")]
    assert "http" not in re.sub(r'src="[^"]*"', "", whole_page)
    assert "url(" not in whole_page
    assert "@import" not in whole_page


def test_the_figures_fetch_nothing_either(whole_page):
    for _, name, value in _Page(whole_page).attributes:
        if name == "src":
            svg = base64.b64decode(value.split(",", 1)[1]).decode("utf-8")
            links = re.findall(r'(?:href|src)="([^"]*)"', svg)
            assert links
            assert all(link.startswith("#") for link in links)
            assert "<script" not in svg


def test_the_same_document_gives_the_same_bytes(document, whole_page):
    assert render_html(document) == whole_page


@textual
@pytest.mark.parametrize(
    "plant",
    [
        lambda d, s: d.update(title=s),
        lambda d, s: d["inputs"][0].update(name=s),
        lambda d, s: d["recipe"].update(text=s),
        lambda d, s: d["messages"].append(s),
        lambda d, s: d["table"].update(path=s),
        lambda d, s: d["table"]["activation"].append(s),
        lambda d, s: d["characteristics"][0].update(definition=s),
        lambda d, s: d["polynomial"].update(horner=s),
        lambda d, s: d["provenance"][0]["parameters"].update(note=s),
        lambda d, s: d["estimate"]["audit"].update(note=s),
    ],
    ids=["title", "input", "recipe", "message", "path", "activation", "definition", "polynomial",
         "step", "audit"],
)  # fmt: skip
def test_hostile_text_is_shown_not_run(document, plant):
    plant(document, HOSTILE)

    page = _Page(render_html(document))

    assert "script" not in page.tags
    assert "<script>alert('x')</script>" in page.text


def test_a_hostile_axis_name_in_a_figure_does_not_run(document):
    document["plots"] = {"feeds": document["plots"]["feeds"]}
    document["estimate"].update(residual_psd={}, feed_spectra={})
    document["table"]["axis"] = "<script>x</script>"

    assert "script" not in _Page(render_html(document)).tags


@textual
@pytest.mark.parametrize(
    ("verdict", "word", "symbol"),
    [
        ("accept", "ACCEPTED", "✓"),
        ("reject", "REJECTED", "✗"),
        ("inconclusive", "INCONCLUSIVE", "?"),
        (None, "NO VERDICT", "–"),
    ],
)
def test_the_verdict_is_a_word_and_a_symbol(document, verdict, word, symbol):
    document["verdict"] = verdict

    head = re.search(r"<header.*?</header>", render_html(document), re.DOTALL).group()

    assert f"{symbol}</span> {word}" in head


def test_an_unknown_verdict_is_refused(document):
    document["verdict"] = "maybe"

    with pytest.raises(DataError, match="maybe"):
        render_html(document)


@textual
def test_the_decision_rule_stands_beside_the_verdict(document):
    assert f"Decision rule: {document['decision_rule']}" in _text(document)


@textual
def test_values_have_unit_uncertainty_and_limit(document):
    entry = document["characteristics"][0]
    entry.update(value=0.9707e-6, u=4.6e-9, U=9.2e-9, lower=None, upper=2e-6)

    text = _text(document)

    assert "970.7 nm 4.6 9.2 ≤ 2000" in text
    assert entry["definition"][1:] in text


@textual
def test_a_negative_value_and_two_limits_read_well(document):
    entry = document["characteristics"][0]
    entry.update(value=-2.5e-7, u=2e-9, U=4e-9, lower=-3e-7, upper=3e-7)

    assert "−250.0 nm 2.0 4.0 −300 … 300" in _text(document)


@textual
def test_a_value_that_is_not_known_says_so(document):
    document["characteristics"][0].update(value=None, u=None, U=None)

    assert "not known" in _text(document)


def test_figures_say_what_was_removed_and_filtered(whole_page):
    captions = re.findall(r"<figcaption>.*?</figcaption>", whole_page, re.DOTALL)

    assert len(captions) == 5
    assert "Removed: the least-squares line over the evaluation range 0 mm … 45 mm" in captions[0]
    assert all("Filter" in c or "Removed" in c for c in captions)
    assert len(re.findall(r'<img alt="[^"]{40,}"', whole_page)) == 5


@textual
def test_the_table_states_sign_units_span_and_hash(document):
    text = _text(document)

    for wanted in (
        document["table"]["sign"],
        "cd" * 32,
        "0 mm … 45 mm",
        "position of X, correction of Z",
        "Units in the file mm",
        "500 pm",
        "Copy the file to the machine's folder.",
        "warning: The table is short. Measure the travel.",
    ):
        assert wanted in text


@textual
def test_the_dry_run_shows_every_direction_and_the_reversed_sign(document):
    text = _text(document)

    for row in document["table"]["verification"]["residuals"]:
        values = (row["before_pv_m"], row["after_pv_m"], row["wrong_sign_pv_m"])
        before, after, wrong = (f"{1e6 * v:.3f}" for v in values)
        change = f"−{100 * (1 - values[1] / values[0]):.0f} %"
        expected = f"{row['direction']} mean of 9 runs P-V, µm {before} {after} {change} {wrong}"
        assert expected in text
        assert values[1] < values[0] < values[2]
    assert "shrinks the measured error in every direction" in text


@textual
def test_a_waived_dry_run_is_a_warning(document):
    document["table"]["verification"] = "waived by the user"

    text = _text(document)

    assert "Dry-run: waived by the user." in text
    assert "not proven" in text
    assert "shrinks the measured error" not in text


@textual
def test_a_failed_dry_run_is_not_called_a_success(document):
    document["table"]["verification"]["passed"] = False

    assert "do not use it" in _text(document)


@textual
def test_wiring_is_shown(document):
    document["table"]["hal_routing"] = ["net one a => b", "net two c => d"]

    page = render_html(document)

    assert "<pre>net one a =&gt; b\nnet two c =&gt; d</pre>" in page


@textual
def test_polynomial_messages_hashes_recipe_and_versions_are_there(document):
    text = _text(document)

    assert document["polynomial"]["horner"].splitlines()[-1] in text
    assert document["messages"][0] in text
    assert "ab" * 32 in text
    assert "ef" * 32 in text
    assert 'length = "45 mm"' in text
    assert "metrosep 0.1.0, numpy 2.4.6, python 3.11.9, scipy 1.17.1" in text


@textual
def test_selected_wavelengths_are_those_of_the_document(document):
    table = document["estimate"]["spectrum"]
    rows = zip(table["selected"], table["amplitude_nm"], table["wavelength_mm"], strict=True)
    _, amplitude, wavelength = max(r for r in rows if r[0])

    text = _text(document)

    assert f"{wavelength:.2f} {amplitude:.1f}" in text


@textual
def test_messages_of_the_estimate_are_not_said_twice(document):
    document["estimate"]["messages"] = list(document["messages"])

    assert _text(document).count(document["messages"][0]) == 1


@textual
@pytest.mark.parametrize(
    "part",
    ["estimate", "plots", "characteristics", "table", "polynomial", "messages", "provenance",
     "recipe", "versions", "inputs", "decision_rule", "title"],
)  # fmt: skip
def test_a_missing_part_is_left_out(document, part):
    document[part] = None

    assert _Page(render_html(document)).open == []


def test_an_empty_document_renders():
    assert "NO VERDICT" in render_html({"schema": "metrosep.result/1"})


def test_every_method_renders(plain_document):
    page = _Page(render_html(plain_document))

    assert page.tags.count("img") == 3


@textual
def test_the_file_holds_the_page(document, tmp_path):

    path = write_html(document, tmp_path / "report.html")

    assert path.read_text(encoding="utf-8") == render_html(document)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@textual
def test_a_folder_that_does_not_exist_is_refused(document, tmp_path):
    with pytest.raises(WriteError, match="does not exist"):
        write_html(document, tmp_path / "no" / "report.html")


ENGLISH = (
    "Decision rule", "Evaluation range", "Stroke (largest", "with the sign reversed", "Each run against", "To activate",
    "is the standard uncertainty", "Strongest selected", "Error e = actual", "Every checked",
)  # fmt: skip
"""Fixed texts of the annex."""


@textual
@pytest.mark.parametrize(("language", "comma"), [("de", ","), ("zh", "."), ("ja", ".")])
def test_the_annex_speaks_the_language_and_says_what_is_english(document, language, comma):
    english = _text(document)
    document["report"] = {"language": [language]}
    text = _text(document)
    annex = text[text.index(catalogue(language)["program_texts"]) :]

    for phrase in ENGLISH:
        assert phrase in english, phrase
        assert phrase not in annex, phrase
    rows = re.search(rf"{catalogue(language)['rest_note']}", annex)
    table = annex[: rows.start()][-160:]
    assert not re.search(r"\d[.]\d" if comma == "," else r"\d,\d", table), table


@pytest.mark.parametrize(("language", "mark"), [("de", ","), ("zh", ".")])
def test_pictures_of_a_report_have_the_decimal_mark_of_its_language(document, language, mark):
    """What a picture writes stands in its SVG as comments, too."""
    document["report"] = {"language": [language]}
    inside = re.findall(r"data:image/svg\+xml;base64,([A-Za-z0-9+/=]+)", render_html(document))
    pictures = "".join(base64.b64decode(picture).decode() for picture in inside)
    written = " | ".join(re.findall(r"<!-- (.*?) -->", pictures))
    assert set(re.findall(r"\d([.,])\d", written)) == {mark}


def test_a_german_picture_has_commas_and_german_words():
    from matplotlib.figure import Figure

    from metrosep.plot.style import localise
    from metrosep.report.certificate import picture_words

    axes = Figure().add_subplot()
    axes.plot([0.0, 0.5], [-0.25, 0.25], label="before, 1.5 um")
    axes.set(xlabel="position of X / mm", ylabel="error (actual − nominal) / nm")
    axes.legend()
    localise(axes.figure, words=picture_words("de")[0], decimal=",")
    axes.figure.canvas.draw()

    assert axes.get_xlabel() == "Position von X / mm"
    assert axes.get_ylabel() == "Fehler (Ist − Soll) / nm"
    assert axes.get_legend().get_texts()[0].get_text() == "vorher, 1,5 um"
    ticks = [t.get_text() for t in axes.get_xticklabels()]
    assert "0,2" in ticks
    assert not any("." in t for t in ticks)
