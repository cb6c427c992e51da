"""``inputs`` of a result: every file that was read, also those beside the one that is named."""

from __future__ import annotations

import hashlib
import json
import shutil

import pytest

from metrosep import read
from metrosep.batch import run_batch
from metrosep.recipe import Recipe
from metrosep.recipe.method_run import sources
from metrosep.recipe.parts import input_records
from metrosep.report import render_csv, render_html

DABAM = """metrosep = 1
[input]
files = ["*.txt"]
[[step]]
op = "parameters"
names = ["Pq"]
"""


@pytest.fixture
def pair(repository, tmp_path):
    def copy(format_id, stem, *suffixes):
        place = tmp_path / "in"
        place.mkdir(exist_ok=True)
        for suffix in suffixes:
            name = f"{stem}{suffix}"
            shutil.copy(repository / "data_formats" / format_id / "pairs" / name, place / name)
        return place

    return copy


def facts(file):
    content = file.read_bytes()
    return (file.name, hashlib.sha256(content).hexdigest(), len(content))


def listed(document):
    return [(i["name"], i["sha256"], i["size"]) for i in document["inputs"]]


@pytest.mark.parametrize("named", [".txt", ".dat"])
def test_a_pair_is_listed_whole_by_run(pair, named):
    place = pair("dabam", "heights", ".txt", ".dat")
    document = Recipe.parse(DABAM).run(place / f"heights{named}").document
    assert listed(document) == [facts(place / "heights.txt"), facts(place / "heights.dat")]
    first, second = document["inputs"]
    assert first["format"] == second["format"] == "dabam"
    assert "beside" not in first
    assert second["beside"] == "heights.txt"


def test_a_scan_is_listed_whole_and_only_what_was_read(pair):
    place = pair("nmm", "line-1", ".dsc", ".dat", ".pos")
    history = read(place / "line-1.dsc", channel="line 1").history
    assert listed({"inputs": input_records(history)}) == [
        facts(place / "line-1.dsc"),
        facts(place / "line-1.dat"),
    ]


def test_a_pair_is_listed_whole_by_a_batch(pair, tmp_path):
    place = pair("dabam", "heights", ".txt", ".dat")
    report = run_batch(Recipe.parse(DABAM), place, out=tmp_path / "qa", scheduler="serial")
    document = json.loads((tmp_path / "qa" / report.rows[0]["link"]).read_text())
    assert listed(document) == [facts(place / "heights.txt"), facts(place / "heights.dat")]


def test_inputs_of_methods_list_the_pair_too(pair):
    place = pair("dabam", "heights", ".txt", ".dat")
    history, _ = sources((read(place / "heights.txt"), read(place / "heights.txt")))
    names = [i["name"] for i in input_records(history)]
    assert names == ["heights.txt", "heights.dat"] * 2


def test_reports_print_both_and_the_csv_names_the_part_by_its_file(pair):
    place = pair("dabam", "heights", ".txt", ".dat")
    document = Recipe.parse(DABAM).run(place / "heights.txt").document
    page = render_html(document)
    for name, digest, _ in (facts(place / "heights.txt"), facts(place / "heights.dat")):
        assert f"<td>{name}" in page
        assert digest in page
    assert render_csv([document]).splitlines()[1].startswith("heights.txt,")


def test_a_file_that_a_step_names_is_listed(repository):
    folder = repository / "examples" / "fts_lathe"
    document = Recipe.load(folder / "recipe.toml").run(None).document
    assert facts(folder / "machine.toml") in listed(document)
    assert {i["format"] for i in document["inputs"]} == {"named by machine"}


def test_a_file_that_a_method_lists_itself_is_listed_once(repository):
    folder = repository / "examples" / "dual_servo"
    for file in sorted(folder.glob("*.toml")):
        recipe = Recipe.load(file)
        if not recipe.is_method:
            continue
        found = listed(recipe.run(None).document)
        assert len(found) == len(set(found))
        named = [v for s in recipe.steps for k, v in s.items() if (folder / str(v)).is_file()]
        assert {name for name, _, _ in found} >= set(named)
