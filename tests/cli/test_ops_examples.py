"""The command that ``metrosep ops NAME`` prints for every method: it parses, and runs on its data."""

import contextlib
import io
import shlex

import pytest

from metrosep.cli.main import main
from metrosep.cli.ops import data_words, example_call
from metrosep.core.methods import METHODS
from metrosep.recipe.recipe import Recipe

WIDTH = 100
SLOW = {"stitch", "three_flat", "shift_rotation", "evidence_table", "tool_setting"}


def called(*words):
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as stop,
    ):
        main([str(w) for w in words])
    return stop.value.code, out.getvalue(), err.getvalue()


def printed_example(name):
    code, out, err = called("ops", name)
    assert code == 0, err
    assert max(len(line) for line in out.split("\nexample\n")[0].splitlines()) <= WIDTH + 40
    return shlex.split(out.split("\nexample\n")[1].replace("\\\n", " "))


READING = [name for name, method in METHODS.items() if method.reads != "nothing"]


@pytest.mark.parametrize("name", READING)
def test_printed_example_makes_a_recipe(name):
    words = printed_example(name)
    assert words[:2] == ["metrosep", METHODS[name].verb]
    code, out, err = called(*words[1:], "--print-recipe")
    assert code == 0, err
    recipe = Recipe.parse(out, name="printed")
    assert recipe.steps[0]["op"] == name


@pytest.mark.parametrize("name", READING)
def test_example_without_data_makes_a_recipe(name, tmp_path):
    """Where the examples are not installed the command is made from the method alone."""
    words = example_call(name, METHODS[name], tmp_path)
    code, out, err = called(*words[1:], "--print-recipe")
    assert code == 0, err
    assert Recipe.parse(out, name="made up").steps[0]["op"] == name


def with_data():
    found = []
    for name in READING:
        if any("examples/" in w for w in example_call(name, METHODS[name])):
            marks = [pytest.mark.slow] if name in SLOW else []
            found.append(pytest.param(name, marks=marks))
    return found


@pytest.mark.parametrize("name", with_data())
def test_printed_example_runs_on_its_data(name, repository, monkeypatch):
    monkeypatch.chdir(repository)
    words = []
    for word in printed_example(name)[1:]:  # the shell would expand these
        words += sorted(str(f) for f in repository.glob(word)) if "*" in word else [word]
    code, out, err = called(*words, "--json")
    assert code == 0, err
    assert '"characteristics"' in out


@pytest.mark.parametrize("name", [n for n in METHODS if n not in READING])
def test_a_method_without_data_is_run_from_a_recipe(name):
    words = printed_example(name)
    assert words[:2] == ["metrosep", "run"]
    assert "no file" in " ".join(data_words(METHODS[name]))


def test_columns_and_repeats_are_explained():
    several = " ".join(data_words(METHODS["multiprobe"]))
    assert "one column for each probe or set-up" in several
    assert "in the order of angles" in several
    assert "--repeat COLUMN" in several
    named = " ".join(data_words(METHODS["donaldson"]))
    assert "in this order: m1, m2" in named
    table = " ".join(data_words(METHODS["iso230_3_drift"]))
    assert "--time COLUMN: times, needed" in table
    assert "--readings COLUMN,COLUMN,...: lengths, one column or several, needed" in table


@pytest.mark.parametrize("name", METHODS)
def test_every_column_that_is_read_is_explained(name):
    words = " ".join(data_words(METHODS[name]))
    for role in METHODS[name].roles:
        assert f"--column {role}=" in words or f"--{role} " in words, role
