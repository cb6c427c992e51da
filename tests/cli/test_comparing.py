"""``metrosep diff``: exit codes, kinds of files, and what is printed."""

import hashlib
import json
import os
import subprocess
import sys

import pytest

from metrosep.cli.main import main


def _result(value, **more):
    entry = {"metric": "pv", "name": "pv", "unit": "m", "value": value, "u": None}
    return {"schema": "metrosep.result/1", "verdict": None, "characteristics": [entry | more]}


@pytest.fixture
def run(capsys):
    def call(*words):
        with pytest.raises(SystemExit) as end:
            main(["diff", *map(str, words)])
        return end.value.code, *capsys.readouterr()

    return call


@pytest.fixture
def pair(tmp_path):
    """Two result folders, 4 nm apart with U = 3 nm and 4 nm."""
    for name, value, U in (("a", 100e-9, 3e-9), ("b", 96e-9, 4e-9)):
        (tmp_path / name).mkdir()
        text = json.dumps(_result(value, U=U))
        (tmp_path / name / "result.json").write_text(text, encoding="utf-8")
    return tmp_path / "a", tmp_path / "b"


def _table(folder, name, entry, axis="X"):
    data = b"0 0 0\n"
    sidecar = {
        "schema": "metrosep.table/1",
        "file_sha256": hashlib.sha256(data).hexdigest(),
        "table": {"axis": axis, "positions_m": [0.0, 1.0], "forward_m": [0.0, entry]},
    }
    (folder / name).write_bytes(data)
    (folder / f"{name}.json").write_text(json.dumps(sidecar), encoding="utf-8")
    return folder / name


def test_a_result_is_equal_to_itself_by_folder_and_by_file(run, pair):
    assert run(pair[0], pair[0] / "result.json")[0] == 0


def test_a_difference_is_printed_with_its_uncertainty_and_gives_1(run, pair):
    code, out, err = run(*pair)

    assert code == 1
    assert "100 nm -> 96 nm" in out
    assert "difference -4 nm (U = 5 nm, within it)" in out
    assert err.strip() == "different"


@pytest.mark.parametrize(("tolerance", "code"), [("pv=5 nm", 0), ("pv=3 nm", 1), ("*=U", 0)])
def test_tolerances(run, pair, tolerance, code):
    assert run(*pair, "--tolerance", tolerance)[0] == code


def test_json_is_one_object(run, pair):
    code, out, _ = run(*pair, "--json")

    found = json.loads(out)
    assert code == 1
    assert found["equal"] is False
    assert found["rows"][0]["exceeds"] is False


@pytest.mark.parametrize(
    "words",
    [
        ("--tolerance", "pv=5"),
        ("--tolerance", "pv=5 mrad"),
        ("--tolerance", "Sq=5 nm"),
        ("--tolerance", "pv"),
        ("--tolerance", "pv=5 nm", "--tolerance", "pv=6 nm"),
    ],
)
def test_a_wrong_tolerance_gives_2(run, pair, words):
    code, _, err = run(*pair, *words)

    assert code == 2
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1


def test_two_kinds_give_2(run, pair, tmp_path):
    code, _, err = run(pair[0], _table(tmp_path, "t.comp", 1e-9))

    assert code == 2
    assert "is a result" in err
    assert "is a table" in err


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        "{}",
        '{"schema": "x"}',
        '{"schema": "metrosep.result/1", "characteristics": 3}',
    ],
)
def test_what_is_no_result_gives_4(run, pair, tmp_path, content):
    (tmp_path / "x.json").write_text(content, encoding="utf-8")

    code, _, err = run(pair[0], tmp_path / "x.json")

    assert code == 4
    assert err.startswith("error: ")


@pytest.mark.parametrize("command", ["diff {0} {0}", "verify {0} --format csv --against {1}"])
def test_a_pipe_is_refused_and_not_waited_for(run, pair, tmp_path, command):
    pipe = tmp_path / "p.csv"
    os.mkfifo(pipe)
    words = command.format(pipe, pair[0]).split()
    if words[0] == "verify":
        words += ["--x", "x_mm", "--z", "z_um"]

    done = subprocess.run(
        [sys.executable, "-m", "metrosep", *words],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip

    assert done.returncode == 4
    assert "it is a device or a pipe, not a file" in done.stderr


@pytest.mark.parametrize("name", ["absent", "absent.json", "absent.toml"])
def test_what_is_not_there_gives_4(run, pair, tmp_path, name):
    other = tmp_path / "r.toml"
    other.write_text("a = 1\n", encoding="utf-8")

    assert run(other if name.endswith("toml") else pair[0], tmp_path / name)[0] == 4


def test_another_file_gives_4(run, tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n", encoding="utf-8")

    assert run(tmp_path / "a.csv", tmp_path / "a.csv")[0] == 4


def test_tables_are_compared_by_their_sidecars(run, tmp_path):
    a, b = _table(tmp_path, "a.comp", 1e-9), _table(tmp_path, "b.comp", -1e-9)

    code, out, _ = run(a, b)

    assert code == 1
    assert "difference 2 nm" in out
    assert run(a, b, "--tolerance", "table=3 nm")[0] == 0
    assert run(a, f"{b}.json")[0] == 1


def test_a_table_that_was_edited_gives_4(run, tmp_path):
    a, b = _table(tmp_path, "a.comp", 1e-9), _table(tmp_path, "b.comp", 1e-9)
    b.write_bytes(b"1 1 1\n")

    code, _, err = run(a, b)

    assert code == 4
    assert "edited" in err


def test_tables_of_two_axes_give_2(run, tmp_path):
    code, _, err = run(
        _table(tmp_path, "a.comp", 1e-9), _table(tmp_path, "b.comp", 1e-9, axis="Y")
    )

    assert code == 2
    assert "axis" in err


def test_recipes_are_compared_by_key(run, tmp_path):
    a, b = tmp_path / "a.toml", tmp_path / "b.toml"
    a.write_text("x = 1\n", encoding="utf-8")
    b.write_text("x = 2  # more\n", encoding="utf-8")

    code, out, _ = run(a, b)

    assert code == 1
    assert "x: 1 and 2" in out
    assert run(a, a)[0] == 0
    assert run(a, b, "--tolerance", "x=1")[0] == 2


def test_a_recipe_that_is_no_text_gives_4(run, tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")

    assert run(tmp_path / "a.toml", tmp_path / "a.toml")[0] == 4


def test_names_cannot_move_the_cursor(run, tmp_path):
    for folder, name in (("a", "x"), ("b", "\x1b[2Jy\n")):
        (tmp_path / folder).mkdir()
        content = _result(1e-9) | {"inputs": [{"name": name, "sha256": folder * 64}]}
        (tmp_path / folder / "result.json").write_text(json.dumps(content), encoding="utf-8")

    assert "\x1b" not in run(tmp_path / "a", tmp_path / "b")[1]
