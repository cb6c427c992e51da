"""The PDF: its words by pdftotext where that is, its bytes, its attachment, and bad input."""

import json
import math
import re
import shutil
import subprocess
import sys

import pytest

from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.report.typeset import render_plain_pdf, write_plain_pdf

HOSTILE = [
    "<script>alert(1)</script>",
    "#panic() $x$ *b* _i_ `r` @a",
    "a\nb",
    "Prüfling Ω",
    "x" * 500,
]
typst_only = pytest.mark.skipif(
    shutil.which("pdftotext") is None, reason="pdftotext (poppler) is not installed"
)


@pytest.fixture
def render():
    pytest.importorskip("typst")
    from metrosep.report.typeset import render_pdf

    return render_pdf


@pytest.fixture
def small():
    entry = {"metric": "Sq", "name": "Sq", "unit": "m", "value": 6e-9, "upper": 8e-9, "U": 1e-9}
    return {
        "schema": "metrosep.result/1",
        "metrosep": "0.1.0",
        "title": "Ring",
        "verdict": "accept",
        "decision_rule": "accept if inside",
        "characteristics": [entry | {"verdict": "accept", "guard_factor": 1.0}],
        "inputs": [{"name": "a.datx", "sha256": "ab" * 32, "size": 12, "format": "datx"}],
        "recipe": {"text": "metrosep = 1\n", "sha256": "cd" * 32},
    }


def _words(data, tmp_path):
    (tmp_path / "x.pdf").write_bytes(data)
    command = ["pdftotext", "-layout", str(tmp_path / "x.pdf"), "-"]
    return subprocess.run(command, check=True, capture_output=True).stdout.decode("utf-8")


def test_the_bytes_are_the_same(render, small):
    before = json.dumps(small, sort_keys=True)

    assert render(small) == render(json.loads(before))
    assert json.dumps(small, sort_keys=True) == before


@typst_only
def test_the_words_are_all_there(render, document, tmp_path):
    words = _words(render(document), tmp_path)

    flat = re.sub(r"\s+", " ", words.replace("\u200b", ""))
    for text in (
        document["title"], "✓ ACCEPT", "Decision rule: Accepted if the value", "All results",
        "Figure 1. Error over position.", "Figure 5. Compensation table.", "Compensation table",
        "To activate it", "Strongest selected wavelengths", "Measured by", "guard band",
        "SHA-256 " + document["recipe"]["sha256"],
    ):  # fmt: skip
        assert re.sub(r"\s+", " ", text) in flat, text
    for line in document["recipe"]["text"].splitlines():
        assert line in flat
    pages = re.findall(r"page (\d+) / (\d+)", flat)
    assert [int(n) for n, _ in pages] == list(range(1, len(pages) + 1))
    assert {int(n) for _, n in pages} == {len(pages)}
    assert flat.count("recipe efefefefefef, input abababababab") == len(pages)


@typst_only
@pytest.mark.parametrize(
    ("verdict", "words"), [("reject", "✗ REJECT"), ("inconclusive", "? INCONCLUSIVE")]
)
def test_the_stamp_is_symbol_and_word(render, small, tmp_path, verdict, words):
    small["verdict"] = small["characteristics"][0]["verdict"] = verdict

    text = _words(render(small), tmp_path)

    assert text.count(words) == 2
    assert "ACCEPT" not in text


@pytest.mark.skipif(
    shutil.which("pdfdetach") is None, reason="pdfdetach (poppler) is not installed"
)
@pytest.mark.parametrize(("standard", "n"), [(None, 1), ("a-2b", 0), ("a-3b", 1)])
def test_the_result_is_attached(render, small, tmp_path, standard, n):
    (tmp_path / "x.pdf").write_bytes(render(small, standard=standard))

    listed = subprocess.run(
        ["pdfdetach", "-list", str(tmp_path / "x.pdf")], check=True, capture_output=True
    )
    assert f"{n} embedded files" in listed.stdout.decode()
    if n:
        subprocess.run(
            ["pdfdetach", "-saveall", "-o", str(tmp_path), str(tmp_path / "x.pdf")], check=True
        )
        assert json.loads((tmp_path / "result.json").read_text("utf-8")) == small


@pytest.mark.parametrize("standard", ["a-2b", "a-3b"])
def test_archive_files_say_which_they_are(render, small, standard):
    part = standard[2].encode()

    assert b"<pdfaid:part>" + part + b"</pdfaid:part>" in render(small, standard=standard)


@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize("plain", [True, False])
def test_hostile_texts_are_texts(render, small, text, plain):
    small |= {"title": text, "messages": [text], "decision_rule": text}
    small["characteristics"][0] |= {"name": text, "symbol": text, "definition": text}
    small["inputs"][0] |= {"name": text, "format": text, "sha256": text}
    small["recipe"] = {"text": text, "sha256": text}
    small["unit"] = {"name": text, "groups": {text: text}}

    assert (render_plain_pdf if plain else render)(small).startswith(b"%PDF")


@pytest.mark.parametrize("plain", [True, False])
@pytest.mark.parametrize("document", [{}, {"characteristics": [], "recipe": None, "inputs": None}])
def test_missing_parts_are_left_out(render, plain, document):
    assert (render_plain_pdf if plain else render)(document).startswith(b"%PDF")


@pytest.mark.parametrize("plain", [True, False])
def test_nan_is_not_known(render, small, plain):
    small["characteristics"][0] |= {"value": math.nan, "U": math.inf}

    assert (render_plain_pdf if plain else render)(small).startswith(b"%PDF")


@pytest.mark.parametrize("plain", [True, False])
def test_an_unknown_verdict_is_refused(render, small, plain):
    small["characteristics"][0]["verdict"] = "perhaps"

    with pytest.raises(DataError, match="perhaps"):
        (render_plain_pdf if plain else render)(small)


def test_an_unknown_standard_is_refused(render, small):
    with pytest.raises(DataError, match="a-2b, a-3b"):
        render(small, standard="a-9z")


def test_without_typst_it_says_what_to_install(small, monkeypatch):
    from metrosep.report.typeset import render_pdf

    monkeypatch.setitem(sys.modules, "typst", None)

    with pytest.raises(UnsupportedFeatureError, match=r"pip install.*--pdf-engine matplotlib"):
        render_pdf(small)


def test_plain_pages_have_the_same_bytes_each_time(mean_document, tmp_path):
    made = render_plain_pdf(mean_document)

    assert write_plain_pdf(mean_document, tmp_path / "p.pdf").read_bytes() == made


def test_plain_pages_hold_every_figure(document):
    assert len(re.findall(rb"/Type /Page\b(?!s)", render_plain_pdf(document))) > 4
