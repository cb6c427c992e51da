"""A file that cannot be read asks for keys of ``[input]``, in ``run`` and in ``batch`` alike."""

from __future__ import annotations

import re

import pytest

from metrosep.batch import run_batch
from metrosep.cli.main import main
from metrosep.recipe import Recipe
from metrosep.recipe.step_help import reading_words

PIPELINE = """metrosep = 1
[input]
files = ["*.csv"]
[[step]]
op = "parameters"
names = ["Sa"]
"""
PYTHON = re.compile(r"(?<![\"\w])(unit|lateral_step|skip_rows|scale|sampling_rate|x|z)=")
CONVERT = "metrosep convert takes it"


@pytest.fixture
def told(tmp_path, capsys):
    """Return what `run` and `batch` say of one file, and that they say the same."""

    def both(text: str, name: str) -> tuple[str, str]:
        (tmp_path / "r.toml").write_text(text)
        with pytest.raises(SystemExit):
            main(
                [
                    "run",
                    str(tmp_path / "r.toml"),
                    str(tmp_path / "in" / name),
                    "-o",
                    str(tmp_path / "o"),
                ]
            )
        of_run = capsys.readouterr().err.strip().splitlines()[-1]
        recipe = Recipe.load(tmp_path / "r.toml")
        report = run_batch(recipe, tmp_path / "in", out=tmp_path / "qa", scheduler="serial")
        of_batch = report.rows[0]["reason"]
        assert of_run.replace(f"{tmp_path}/in/", "") == f"error: {of_batch}"
        return of_run, of_batch

    return both


def test_numbers_without_steps_ask_for_keys_of_input(tmp_path, told):
    (tmp_path / "in").mkdir()
    rows = "\n".join(",".join(str((i * j) % 7) for j in range(8)) for i in range(6))
    (tmp_path / "in/a.csv").write_text(rows + "\n")
    for text in told(PIPELINE, "a.csv"):
        assert 'unit = "nm" in [input]' in text
        assert 'lateral_step = "3 um" in [input]' in text
        assert not PYTHON.search(text), text
        assert CONVERT in text


def test_lines_that_are_no_numbers_name_a_key_that_the_recipe_has(tmp_path, told):
    (tmp_path / "in").mkdir()
    letter = (
        "no table at all\nof any kind; 3 here\n" + "a long letter stands above the rows\n" * 30
    )
    (tmp_path / "in/a.csv").write_text(letter + "1;2;3\n4;5;6\n7;8;9\n")
    for text in told(PIPELINE, "a.csv"):
        assert not PYTHON.search(text), text
        assert "skip_rows = 32" in text
        assert "in [input]" in text


def test_what_convert_is_said_to_take_it_takes(tmp_path, capsys):
    """The advice is carried out: two lines of prose above a map, left out by convert."""
    rows = "\n".join(",".join(str((i * j) % 7) for j in range(8)) for i in range(6))
    (tmp_path / "a.csv").write_text("no table\nof any kind\n" + rows + "\n")
    words = ["--set", "skip_rows=2", "--unit", "nm", "--lateral-step", "3 um"]
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "convert",
                str(tmp_path / "a.csv"),
                str(tmp_path / "a.x3p"),
                *words,
                "--as",
                "delimited",
            ]
        )
    assert ended.value.code == 0, capsys.readouterr().err
    result = Recipe.parse(PIPELINE.replace("*.csv", "*.x3p")).run(tmp_path / "a.x3p")
    assert any(c["unit"] == "m" for c in result.document["characteristics"])


METHOD = """metrosep = 1
[input]
files = ["*.csv"]
x = "a"
z = "b"
[[step]]
op = "separate"
"""


@pytest.mark.parametrize(
    ("op", "message", "words"),
    [
        ("parameters", "give unit='nm' or scale='2.5 um/V'", 'scale = "2.5 um/V" in [input]'),
        ("parameters", "name two with x= and z=, or no", 'x = "COLUMN" in [input]'),
        ("form", "leave it out with skip_rows=4, or no", "skip_rows = 4 in [input]"),
        ("form", "give servo_period=4, or no", '--set "servo_period=4"'),
        ("separate", "name them with x='x_mm'", 'x = "x_mm" in [input]'),
        ("no step", "give unit='nm'", "unit='nm'"),
    ],
)
def test_arguments_become_keys(op, message, words):
    assert words in reading_words(message, op)


def test_runs_are_read_in_these_words_too(tmp_path, told):
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.csv").write_text("a,b\n1,2\n2,3\n3,4\n")
    for text in told(METHOD + '[batch]\neach = "file"\n', "a.csv"):
        assert not PYTHON.search(text), text


ABBA = """metrosep = 1
[input]
files = ["*.csv"]
readings = ["m_nm"]
[[step]]
op = "abba"
"""


def test_the_keys_of_a_step_are_named_too(tmp_path, told):
    """One reading of a part: its scatter has to be given."""
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.csv").write_text("m_nm\n1\n2\n2\n1.5\n")
    for text in told(ABBA, "a.csv"):
        assert not re.search(r"\bsd=|\brepeat=", text), text
