"""``metrosep report``: formats, several results, inputs untouched, exit codes."""

import csv
import json
import sys

import pytest

from metrosep.cli.main import main


def _result(value=6e-9, **more):
    entry = {"metric": "Sq", "name": "Sq", "unit": "m", "value": value, "u": None}
    return {"schema": "metrosep.result/1", "title": "Ring", "characteristics": [entry]} | more


@pytest.fixture
def run(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as end:
            main(["report", *map(str, words)])
        return end.value.code, *capsys.readouterr()

    return call


@pytest.fixture
def results(tmp_path):
    """Three results in folders as a batch leaves them, two of the same short name."""
    places = ["ring/aa", "ring/bb", "disc/aa"]
    for i, place in enumerate(places):
        folder = tmp_path / "qa" / place
        folder.mkdir(parents=True)
        (folder / "result.json").write_text(json.dumps(_result(i * 1e-9)), encoding="utf-8")
    return tmp_path / "qa"


def _names(folder):
    return sorted(f.name for f in folder.iterdir())


def test_one_result_in_every_format(run, results, tmp_path):
    pytest.importorskip("typst")
    out = tmp_path / "deep" / "out"

    code, _, err = run(results / "ring/aa", "--format", "html, PDF,xlsx,csv,dfq,html", "-o", out)

    assert code == 0
    assert _names(out) == [f"report.{k}" for k in ("csv", "dfq", "html", "pdf", "xlsx")]
    assert len(err.splitlines()) == 5


def test_many_results_by_their_folder(run, results, tmp_path):
    before = {f: f.read_bytes() for f in results.rglob("result.json")}

    code, _, _ = run(results, "--format", "csv,dfq", "-o", tmp_path / "out")

    assert code == 0
    assert _names(tmp_path / "out") == ["disc_aa.dfq", "results.csv", "ring_aa.dfq", "ring_bb.dfq"]
    with (tmp_path / "out" / "results.csv").open(encoding="utf-8", newline="") as lines:
        assert [float(r["value"]) for r in csv.DictReader(lines)] == [2e-9, 0.0, 1e-9]
    assert {f: f.read_bytes() for f in results.rglob("*") if f.is_file()} == before


def test_the_same_input_gives_the_same_bytes_and_no_result_twice(run, results, tmp_path):
    for out in ("a", "b"):
        words = (results, results / "ring/aa", results / "ring/aa/result.json")
        assert run(*words, "--format", "html,xlsx,csv,dfq", "-o", tmp_path / out)[0] == 0

    assert _names(tmp_path / "a") == _names(tmp_path / "b")
    assert len(_names(tmp_path / "a")) == 10
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"schema": "x"}', json.dumps(_result(verdict="perhaps"))]
)
def test_an_unreadable_result_gives_4_and_the_others_are_done(run, results, tmp_path, content):
    (results / "ring/aa/result.json").write_text(content, encoding="utf-8")

    code, _, err = run(results, "--format", "html,csv", "-o", tmp_path / "out")

    assert code == 4
    assert "error: " in err
    assert _names(tmp_path / "out") == ["disc_aa.html", "results.csv", "ring_bb.html"]


@pytest.mark.parametrize(
    "damage",
    [{"characteristics": 3}, {"inputs": 3}, {"recipe": "text"}, {"table": [1]}, {"unit": 7}],
    ids=str,
)
def test_a_damaged_part_is_no_bug_of_ours(run, tmp_path, damage):
    (tmp_path / "r.json").write_text(json.dumps(_result() | damage), encoding="utf-8")

    code, _, err = run(tmp_path / "r.json", "-o", tmp_path / "out")

    assert code == 4
    assert "no html can be made of it" in err


def test_without_typst_the_engine_must_be_asked_for(run, results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "typst", None)

    code, _, err = run(results / "ring/aa", "--format", "pdf", "-o", tmp_path / "out")
    asked = run(
        results / "ring/aa",
        "--format",
        "pdf",
        "--pdf-engine",
        "matplotlib",
        "-o",
        tmp_path / "out",
    )

    assert code == 2
    assert "pip install" in err
    assert asked[0] == 0
    assert _names(tmp_path / "out") == ["report.pdf"]


def test_the_standard_reaches_the_engine(run, results, tmp_path):
    pytest.importorskip("typst")

    words = ("--format", "pdf", "--pdf-standard", "a-2b", "-o", tmp_path / "out")
    assert run(results / "ring/aa", *words)[0] == 0

    assert b"<pdfaid:part>2<" in (tmp_path / "out" / "report.pdf").read_bytes()


@pytest.mark.parametrize(
    "words",
    [
        ("--format", "docx"),
        ("--format", ","),
        ("--pdf-engine", "word"),
        ("--format", "pdf", "--pdf-engine", "matplotlib", "--pdf-standard", "a-2b"),
    ],
)
def test_wrong_usage_gives_2(run, results, tmp_path, words):
    code, _, err = run(results / "ring/aa", *words, "-o", tmp_path / "out")

    assert code == 2
    assert err.startswith("error: ")


def test_a_folder_without_results_gives_2(run, tmp_path):
    (tmp_path / "empty").mkdir()

    assert run(tmp_path / "empty", "-o", tmp_path / "out")[0] == 2


def test_an_output_that_is_a_file_gives_2(run, results, tmp_path):
    (tmp_path / "out").write_text("x", encoding="utf-8")

    assert run(results / "ring/aa", "-o", tmp_path / "out")[0] == 2


def test_a_name_that_is_not_there_gives_4(run, tmp_path):
    assert run(tmp_path / "none.json", "-o", tmp_path / "out")[0] == 4


def _batch_index(folder, links):
    rows = [{"unit": n, "status": "measured", "link": n} for n in links]
    text = json.dumps({"schema": "metrosep.index/1", "rows": rows})
    (folder / "index.json").write_text(text, encoding="utf-8")


def test_the_index_of_a_batch_says_which_results_count(run, results, tmp_path):
    (results / "disc").rename(results / "disc 7 ü")
    _batch_index(results, ["ring/bb/result.json", "disc 7 ü/aa/result.json", "x/cc/failed.json"])

    code, _, err = run(results, "--format", "csv", "-o", tmp_path / "out")

    assert code == 0
    with (tmp_path / "out" / "results.csv").open(encoding="utf-8", newline="") as lines:
        assert [float(r["value"]) for r in csv.DictReader(lines)] == [1e-9, 2e-9]
    assert "1 result(s) below" in err
    assert "note: no report of x/cc/failed.json: by " in err


@pytest.mark.parametrize("links", [[], ["../ring/aa/result.json"], ["ring/aa/failed.json"]])
def test_an_index_without_results_is_refused(run, results, tmp_path, links):
    _batch_index(results, links)
    code, _, err = run(results, "--format", "csv", "-o", tmp_path / "out")
    assert code == 4
    assert "no row of it has a result" in err


def test_a_damaged_index_is_refused(run, results, tmp_path):
    (results / "index.json").write_text("{", encoding="utf-8")
    assert run(results, "--format", "csv", "-o", tmp_path / "out")[0] == 4


def test_the_csv_names_recipe_and_status(run, results, tmp_path):
    more = {
        "verdict": "reject",
        "unit": {"recipe_sha256": "ab" * 32},
        "recipe": {"sha256": "cd" * 32},
    }
    document = _result(**more)
    (results / "ring/aa/result.json").write_text(json.dumps(document), encoding="utf-8")
    assert run(results / "ring/aa", "--format", "csv", "-o", tmp_path / "out")[0] == 0
    with (tmp_path / "out" / "report.csv").open(encoding="utf-8", newline="") as lines:
        (row,) = csv.DictReader(lines)
    assert row["status"] == "rejected"
    assert row["recipe"] == "ab" * 32


def test_workers_change_the_time_and_not_the_bytes(run, results, tmp_path):
    (results / "ring/aa/result.json").write_text("{", encoding="utf-8")
    told = []
    for workers in (1, 2):
        out = tmp_path / f"out{workers}"
        code, _, err = run(results, "--format", "html,csv", "-o", out, "--workers", workers)
        assert code == 4
        # under load a line of progress comes every 10 s
        lines = [line for line in err.splitlines() if not line.startswith("metrosep: ")]
        told.append("\n".join(lines).replace(str(out), "OUT"))

    assert told[0] == told[1]
    assert "ring/aa/result.json" in told[0]
    assert _names(tmp_path / "out1") == ["disc_aa.html", "results.csv", "ring_bb.html"]
    for file in (tmp_path / "out1").iterdir():
        assert file.read_bytes() == (tmp_path / "out2" / file.name).read_bytes()


@pytest.mark.parametrize("workers", [1, 2])
def test_a_report_that_cannot_be_written_is_told(run, results, tmp_path, workers):
    (tmp_path / "out" / "ring_bb.html").mkdir(parents=True)

    code, _, err = run(results, "-o", tmp_path / "out", "--workers", workers)

    assert code == 2
    assert "ring_bb.html: is a folder" in err
    assert "Traceback" not in err


def test_no_worker_gives_2(run, results, tmp_path):
    assert run(results, "-o", tmp_path, "--workers", 0)[0] == 2
