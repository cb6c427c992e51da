"""``metrosep diff`` finds the one result below a folder of a batch, and names what it would have to choose from."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.main import main

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "qa-for-the-engineer.md"


def result(value):
    entry = {"metric": "pv", "name": "pv", "unit": "m", "value": value, "u": None}
    return {"schema": "metrosep.result/1", "verdict": None, "characteristics": [entry]}


@pytest.fixture
def put(tmp_path):
    def write(name, value=1e-9):
        file = tmp_path / name / "result.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(result(value)), encoding="utf-8")

    return write


@pytest.fixture
def run(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as end:
            main([*map(str, words)])
        return end.value.code, *capsys.readouterr()

    return call


def test_the_only_result_below_a_folder_is_taken(run, put, tmp_path):
    put("qa/A1_0001/0a1b2c3d")
    put("qa/A1_0002/99999999", 3e-9)

    code, out, _ = run("diff", tmp_path / "qa/A1_0001", tmp_path / "qa/A1_0002")

    assert code == 1
    assert "difference 2 nm" in out


def test_a_result_of_its_own_comes_first(run, put, tmp_path):
    put("a")
    put("a/below", 2e-9)
    assert run("diff", tmp_path / "a", tmp_path / "a")[0] == 0


def test_of_several_the_candidates_are_named(run, put, tmp_path):
    put("qa/A1_0001/0a1b2c3d")
    put("qa/A1_0001/ffffffff", 3e-9)
    put("b")

    code, _, err = run("diff", tmp_path / "b", tmp_path / "qa/A1_0001")

    assert code == 2
    assert "holds 2 results" in err
    assert "0a1b2c3d, " in err
    assert "ffffffff" in err


def test_of_many_some_are_named(run, put, tmp_path):
    for i in range(12):
        put(f"qa/P_{i:02}/0a1b2c3d")

    code, _, err = run("diff", tmp_path / "qa", tmp_path / "qa")

    assert code == 2
    assert "holds 12 results" in err
    assert "and 4 more" in err


def test_a_folder_without_any_gives_4(run, put, tmp_path):
    put("b")
    (tmp_path / "empty" / "x").mkdir(parents=True)

    code, _, err = run("diff", tmp_path / "empty", tmp_path / "b")

    assert code == 4
    assert "result.json" in err


def test_what_failed_is_told(run, put, tmp_path):
    put("b")
    (tmp_path / "qa/A/0a1b2c3d").mkdir(parents=True)
    failed = {"schema": "metrosep.failed/1", "reason": "it ends too early"}
    (tmp_path / "qa/A/0a1b2c3d/failed.json").write_text(json.dumps(failed), encoding="utf-8")

    code, _, err = run("diff", tmp_path / "qa/A", tmp_path / "b")

    assert code == 4
    assert "failed: it ends too early" in err


@pytest.mark.slow
def test_the_commands_of_the_page_run(run, tmp_path, monkeypatch):
    """Recipe, batch, report and diff of docs/how-to/qa-for-the-engineer.md on three parts."""
    monkeypatch.chdir(tmp_path)
    text = PAGE.read_text(encoding="utf-8")
    recipe = re.search(r"```toml\n(.*?)```", text, re.DOTALL)[1]
    lines = [
        line.split("#")[0].split()
        for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
        for line in block.splitlines()
    ]
    Path("recipe.toml").write_text(recipe, encoding="utf-8")
    Path("inbox").mkdir()
    wave = np.cos(2 * np.pi * (np.arange(64) + 0.5) / 16)
    for i in range(1, 4):
        ms.write(ms.Surface(np.outer(1e-8 * i * wave, wave), 1e-6, 1e-6), f"inbox/A1_000{i}.sdf")

    codes = {words[1]: run(*words[1:])[0] for words in lines}

    assert codes == {"batch": 0, "report": 0, "diff": 1}
    assert len(list(Path("reports").glob("*.pdf"))) == 3
