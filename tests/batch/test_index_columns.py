"""Columns of the index: no group of the pattern vanishes, whatever it is called."""

from __future__ import annotations

import csv
import json

import pytest

from metrosep.batch import run_batch
from metrosep.batch.index import write_index
from metrosep.cli.main import main
from metrosep.core.errors import RecipeError
from metrosep.recipe import Recipe
from metrosep.recipe.schema import COLUMNS

USAGE = 2
"""Exit code of a wrong recipe."""


def cells(file):
    with file.open(newline="") as handle:
        return list(csv.reader(handle))


def with_pattern(text, pattern, more=""):
    return f"{text}[batch]\npattern = '{pattern}'\n{more}"


@pytest.mark.parametrize("name", COLUMNS)
def test_a_group_that_is_called_like_a_column_is_refused_with_its_line(recipe_text, name):
    text = with_pattern(recipe_text, rf"(?P<{name}>\w)_(?P<serial>\d)\.\w+")
    line = text.splitlines().index(next(n for n in text.splitlines() if "pattern" in n)) + 1
    with pytest.raises(RecipeError, match=rf":{line}: pattern: the group \"{name}\".*part_{name}"):
        Recipe.parse(text)


def test_every_column_of_the_csv_is_taken(recipe, inbox, tmp_path):
    run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="serial")
    head = cells(tmp_path / "qa/index.csv")[0]
    assert set(head) <= set(COLUMNS)


def test_check_names_such_a_group(recipe_text, tmp_path, capsys):
    file = tmp_path / "r.toml"
    file.write_text(with_pattern(recipe_text, r"(?P<verdict>\w)_\d\.\w+"))
    with pytest.raises(SystemExit) as end:
        main(["check", str(file)])
    assert end.value.code == USAGE
    told = capsys.readouterr()
    assert 'the group "verdict"' in told.out + told.err
    assert "part_verdict" in told.out + told.err


def test_groups_that_do_not_name_the_folder_are_columns_too(recipe_text, inbox, tmp_path):
    text = with_pattern(recipe_text, r"(?P<day>\w+)/(?P<part>\w)_(?P<serial>\d)\.\w+",
                        "key = ['serial', 'part']\n")  # fmt: skip
    report = run_batch(Recipe.parse(text), inbox, out=tmp_path / "qa", scheduler="serial")
    head, *lines = cells(tmp_path / "qa/index.csv")
    assert head[:5] == ["file", "key", "serial", "part", "day"]
    assert {n[head.index("day")] for n in lines} == {"mo", "tu"}
    assert report.rows[0]["key"] == "0_P"


def test_an_index_of_before_keeps_such_a_group_beside_the_column(recipe, inbox, tmp_path):
    report = run_batch(recipe, inbox, out=tmp_path / "qa", scheduler="serial")
    document = json.loads(json.dumps(report.document))
    document["groups"] = ["value"]
    for row in document["rows"]:
        row["groups"] = {"value": "of the name"}
    head, first, *_ = cells(write_index(document, tmp_path / "old.csv", "csv"))
    assert len(set(head)) == len(head)
    assert first[head.index("value (group)")] == "of the name"
    assert float(first[head.index("value")]) > 0.0


def test_renamed_groups_show_in_what_was_done_before(recipe_text, inbox, tmp_path):
    old = Recipe.parse(with_pattern(recipe_text, r"(?P<a>\w)_(?P<serial>\d)\.\w+"))
    new = Recipe.parse(with_pattern(recipe_text, r"(?P<part>\w)_(?P<serial>\d)\.\w+"))
    run_batch(old, inbox, out=tmp_path / "qa", scheduler="serial")
    report = run_batch(new, inbox, out=tmp_path / "qa", scheduler="serial")
    assert report.counts["skipped"] == report.counts["total"] == 6
    head, *lines = cells(tmp_path / "qa/index.csv")
    assert "a" not in head
    assert {n[head.index("part")] for n in lines} == {"P"}
