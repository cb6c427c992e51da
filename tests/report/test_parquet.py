"""Parquet read back by pyarrow and pandas, against the CSV read by the csv module."""

import csv
import hashlib
import io
import json
import math
import subprocess
import sys

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import metrosep as ms
from metrosep.batch import run_batch
from metrosep.batch.index import index_formats, write_index
from metrosep.cli.main import main
from metrosep.core.errors import DataError, UnsupportedFeatureError
from metrosep.recipe.preflight import report_formats
from metrosep.report import (
    render_csv,
    render_index_parquet,
    render_parquet,
    write_index_parquet,
    write_parquet,
)

NUMBERS = ["value", "lower", "upper", "U", "u", "guard"]
INDEX_NUMBERS = ["value", "lower", "upper", "U"]


def _document(*entries, **more):
    return {"schema": "metrosep.result/1", "characteristics": list(entries)} | more


def _one():
    """Every number another one, so that no two columns can be taken for each other."""
    entry = {
        "metric": "Sq", "name": "roughness", "unit": "m", "value": 0.1 + 0.2, "lower": -3e-9,
        "upper": 8e-9, "u": 1e-10, "U": 2e-10, "guard_factor": 0.5, "verdict": "reject",
    }  # fmt: skip
    bare = {"metric": "Ssk", "name": "skew", "value": None, "unit": "1"}
    return _document(
        entry,
        bare,
        verdict="reject",
        inputs=[{"name": "Prüfling 量具.datx"}],
        unit={"groups": {"part": "ring", "serial": "007"}, "recipe_sha256": "ab" * 32},
    )


def _two():
    entry = {"metric": "Sz", "name": "Sz", "unit": "m", "value": math.nan, "upper": 1e-6}
    return _document(entry, recipe={"sha256": "cd" * 32})


def _index():
    entry = {
        "metric": "Sq", "name": "roughness", "unit": "m", "value": 0.1 + 0.2, "lower": -3e-9,
        "upper": 8e-9, "U": 2e-10, "verdict": "reject",
    }  # fmt: skip
    count = {"metric": "n", "name": "n", "unit": "1", "value": 7, "verdict": None}
    row = {
        "unit": "mo/ring_007.x3p", "key": "ring_007", "hash": "0" * 64, "reason": None,
        "groups": {"part": "ring", "serial": "007"}, "status": "rejected",
        "link": "ring_007/00000000/result.json", "characteristics": [entry, count],
    }  # fmt: skip
    failed = row | {
        "unit": "bad\udcff.x3p", "key": "bad", "groups": {}, "status": "failed",
        "reason": "it ends, after\n512 bytes", "characteristics": [],
    }  # fmt: skip
    return {"schema": "metrosep.index/1", "groups": ["part", "serial"], "rows": [row, failed]}


def _read(data):
    return pq.read_table(io.BytesIO(data))


def _same(table, text, numbers):
    """Compare every cell with a CSV: an empty cell there is a null here, and the reverse."""
    head, *lines = csv.reader(io.StringIO(text, newline=""))
    assert table.column_names == head
    assert table.num_rows == len(lines) > 0
    found = table.to_pylist()
    for row, line in zip(found, lines, strict=True):
        for name, cell in zip(head, line, strict=True):
            wanted = None if cell == "" else float(cell) if name in numbers else cell
            assert row[name] == wanted, name


def test_it_holds_the_columns_and_rows_of_the_csv():
    documents = [_one(), _two()]

    table = _read(render_parquet(documents))

    _same(table, render_csv(documents), NUMBERS)
    first, second, third = table.to_pylist()
    assert (first["value"], first["guard"], first["verdict"]) == (0.1 + 0.2, 1e-10, "reject")
    assert [first[n] for n in ("lower", "upper", "u", "U")] == [-3e-9, 8e-9, 1e-10, 2e-10]
    assert (first["file"], first["serial"]) == ("Prüfling 量具.datx", "007")
    assert (second["value"], second["verdict"], second["unit"]) == (None, None, "1")
    assert (third["value"], third["part"], third["recipe"]) == (None, None, "cd" * 32)


def test_a_real_result_too(document):
    _same(_read(render_parquet([document])), render_csv([document]), NUMBERS)


@pytest.mark.parametrize("documents", [[_one(), _two()], [_two()], [_document()], []])
def test_the_types_do_not_depend_on_what_is_known(documents):
    schema = _read(render_parquet(documents)).schema

    for field in schema:
        assert field.type == (pa.float64() if field.name in NUMBERS else pa.string()), field
    assert [f.name for f in schema if f.type == pa.float64()] == NUMBERS


def test_pandas_reads_numbers_as_numbers():
    frame = pd.read_parquet(io.BytesIO(render_parquet([_one(), _two()])))

    assert [str(frame[n].dtype) for n in NUMBERS] == ["float64"] * 6
    assert frame["serial"][0] == "007"
    assert frame["value"].isna().tolist() == [False, True, True]
    assert (frame["verdict"] == "reject").tolist() == [True, False, False]


def test_the_metadata_say_what_it_is_and_where_the_units_are():
    metadata = pq.read_metadata(io.BytesIO(render_parquet([_one()]))).metadata
    index = pq.read_metadata(io.BytesIO(render_index_parquet(_index()))).metadata

    assert metadata[b"metrosep_schema"] == b"metrosep.characteristics/1"
    assert json.loads(metadata[b"metrosep_unit_columns"]) == dict.fromkeys(NUMBERS, "unit")
    assert index[b"metrosep_schema"] == b"metrosep.index-characteristics/1"
    assert json.loads(index[b"metrosep_unit_columns"]) == dict.fromkeys(INDEX_NUMBERS, "unit")


_AGAIN = """
import json, hashlib, sys
from metrosep.report import render_index_parquet, render_parquet
document, index = json.load(sys.stdin)
for data in (render_parquet([document]), render_index_parquet(index)):
    print(hashlib.sha256(data).hexdigest())
"""


@pytest.mark.slow
def test_the_bytes_are_the_same_in_another_process(tmp_path):
    document, index = _one(), _index()
    first = write_parquet(document, tmp_path / "a.parquet").read_bytes()
    second = write_index_parquet(index, tmp_path / "i.parquet").read_bytes()

    run = subprocess.run(
        [sys.executable, "-c", _AGAIN],
        input=json.dumps([document, index]), capture_output=True, text=True, check=True,
    )  # fmt: skip

    assert render_parquet([document]) == first
    assert run.stdout.split() == [hashlib.sha256(d).hexdigest() for d in (first, second)]


@pytest.mark.parametrize(
    "text", ["=1+1", "a\nb;c,d\"e'", "量具 🔧", "x" * 500, "\udcff", "\x1b[2J"]
)
def test_hostile_names_are_texts_as_they_are(text):
    document = _one()
    document["characteristics"][0]["name"] = text

    name = _read(render_parquet([document]))["characteristic"][0].as_py()

    assert name == "".join(" " if c in "\n\x1b\udcff" else c for c in text)


@pytest.mark.parametrize("damage", [{"verdict": "perhaps"}, {"value": "1"}, {"U": [1]}], ids=str)
def test_a_damaged_result_is_refused(damage):
    document = _one()
    document["characteristics"][0] |= damage

    with pytest.raises(DataError):
        render_parquet([document])


def test_the_index_holds_the_columns_and_rows_of_its_csv(tmp_path):
    document = _index()

    table = _read(render_index_parquet(document))

    text = write_index(document, tmp_path / "index.csv", "csv").read_bytes().decode("utf-8")
    _same(table, text, INDEX_NUMBERS)
    first, count, failed = table.to_pylist()
    assert (first["part"], first["serial"], first["upper"]) == ("ring", "007", 8e-9)
    assert (count["value"], count["U"], count["verdict"]) == (7.0, None, None)
    assert (failed["file"], failed["part"], failed["value"]) == ("bad\\udcff.x3p", None, None)
    assert failed["reason"] == "it ends, after\n512 bytes"


@pytest.mark.parametrize(
    "document",
    [
        {},
        {"schema": "metrosep.result/1"},
        _index() | {"rows": [{"status": "failed"}]},
        _index() | {"rows": [_index()["rows"][0] | {"characteristics": [{"value": "1"}]}]},
        _index() | {"rows": [_index()["rows"][0] | {"groups": 3}]},
    ],
    ids=["empty", "result", "poor row", "text", "groups"],
)
def test_what_is_no_index_is_refused(document):
    with pytest.raises(DataError):
        render_index_parquet(document)


@pytest.mark.parametrize(
    "render",
    [lambda: render_parquet([]), lambda: render_index_parquet(_index())],
    ids=["results", "index"],
)
def test_without_pyarrow_it_says_what_to_install(render, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    with pytest.raises(UnsupportedFeatureError, match=r'pip install "metrosep\[parquet\]"'):
        render()


def test_it_is_registered():
    assert report_formats()["parquet"].load() is write_parquet
    assert index_formats()["parquet"].load() is write_index_parquet


@pytest.fixture
def folders(tmp_path):
    for name, document in (("a", _one()), ("b", _two())):
        (tmp_path / name).mkdir()
        (tmp_path / name / "result.json").write_text(json.dumps(document | {"title": name}))
    return tmp_path


def _report(folders, *names):
    words = [str(folders / n) for n in names]
    with pytest.raises(SystemExit) as end:
        main(["report", *words, "--format", "csv,parquet", "-o", str(folders / "out")])
    return end.value.code


def test_the_command_line_writes_one_file_for_one_result(folders):
    assert _report(folders, "a") == 0

    text = (folders / "out/report.csv").read_bytes().decode("utf-8")
    _same(pq.read_table(folders / "out/report.parquet"), text, NUMBERS)


def test_the_command_line_writes_one_file_for_several_results(folders):
    assert _report(folders, "a", "b") == 0

    assert sorted(f.name for f in (folders / "out").iterdir()) == [
        "results.csv",
        "results.parquet",
    ]
    text = (folders / "out/results.csv").read_bytes().decode("utf-8")
    table = pq.read_table(folders / "out/results.parquet")
    _same(table, text, NUMBERS)
    assert table.num_rows == 3


def test_a_damaged_result_among_several_is_left_out(folders, capsys):
    damaged = _one() | {"characteristics": 3}
    (folders / "a/result.json").write_text(json.dumps(damaged))

    assert _report(folders, "a", "b") == 4
    assert pq.read_table(folders / "out/results.parquet").num_rows == 1
    assert "no csv can be made of it" in capsys.readouterr().err


@pytest.mark.parametrize("names", ["a", "ab"])
def test_the_command_line_names_the_extra(folders, names, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    assert _report(folders, *names) == 2
    assert "metrosep[parquet]" in capsys.readouterr().err


RECIPE = """metrosep = 1
[input]
files = ["*.csv"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Pt"]
[[check]]
metric = "Pt"
upper = "80 nm"
U = "2 nm"
[[output]]
kind = "report"
formats = ["csv", "parquet"]
[batch]
index = ["csv", "parquet"]
"""


def test_a_batch_writes_reports_and_index(tmp_path):
    (tmp_path / "in").mkdir()
    for name, heights in (("a", [0, 30, -20, 0, 11]), ("b", [0, 90, -20, 0, 11])):
        profile = ms.Profile([i * 1e-3 for i in range(5)], [h * 1e-9 for h in heights])
        ms.write(profile, tmp_path / "in" / f"{name}.csv")
    (tmp_path / "in" / "c.csv").write_text("nothing\n")

    report = run_batch(
        ms.Recipe.parse(RECIPE), tmp_path / "in", out=tmp_path / "qa", scheduler="serial"
    )

    assert report.messages == ()
    table = pq.read_table(tmp_path / "qa/index.parquet")
    text = (tmp_path / "qa/index.csv").read_bytes().decode("utf-8")
    _same(table, text, INDEX_NUMBERS)
    assert table["status"].to_pylist()[-1] == "failed"
    assert set(table["verdict"].to_pylist()) == {"accept", "reject", None}
    (one,) = (tmp_path / "qa/a").glob("*/report.parquet")
    _same(pq.read_table(one), one.with_suffix(".csv").read_bytes().decode("utf-8"), NUMBERS)
