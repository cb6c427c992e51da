"""``metrosep check RECIPE``: every mistake at once, with its line, and nothing read."""

import json

import pytest

from metrosep.cli.main import main

GOOD = """metrosep = 1
[input]
files = ["*.x3p"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sa"]
[[check]]
metric = "Sa"
upper = "10 nm"
U = "1 nm"
"""

BAD = """metrosep = 1
[input]
fils = ["*.x3p"]
[[step]]
op = "form"
fom = "plane"
[[step]]
op = "filtre"
[[step]]
op = "filter"
cutoff = "0.8 kg"
[[check]]
metric = "Sa"
uper = "10 nm"
U = "1 nn"
[batch]
on_error = "halt"
"""


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def call(text, *words):
        (tmp_path / "r.toml").write_text(text, encoding="utf-8")
        with pytest.raises(SystemExit) as end:
            main(["check", "r.toml", *words])
        return end.value.code, *capsys.readouterr()

    return call


def test_a_right_recipe_ends_with_0_and_needs_no_data(run):
    assert run(GOOD) == (0, "r.toml: nothing wrong\n", "")


def test_every_mistake_is_told_with_its_line_and_the_nearest_word(run):
    code, out, _ = run(BAD)
    assert code == 2
    lines = out.splitlines()
    for line, words in {
        3: ('"fils"', '"files"'),
        6: ('"fom"', '"form"'),
        4: ('needs the key "form"',),
        8: ("filtre", '"filter"'),
        11: ("cutoff", "0.8 kg"),
        14: ('"uper"', '"upper"'),
        15: ("1 nn",),
        17: ("halt",),
    }.items():
        told = [t for t in lines if t.startswith(f"error: r.toml:{line}:")]
        assert len(told) == 1, (line, out)
        assert all(w in told[0] for w in words)
    assert len(lines) == 8


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("metrosep = 1", "metrosep = 2", ":1: metrosep = 2"),
        ("[[step]]", "[[step", "line 4"),
        ('op = "form"', 'op = "separate"', "r.toml:"),
        ('upper = "10 nm"', 'upper = "10 nm"\nlower = "20 nm"', "r.toml:1"),
        (
            '["Sa"]',
            '["Sa", "Smr(0,5 um)"]',
            "r.toml:9: [[step]] 2 (parameters): Smr(0,5 um): the comma",
        ),
        ('["Sa"]', '["Sa", "Smr(120 %, 1 um)"]', "between 0 % and 100 %, got 120 %"),
        ("[input]", "[batch]\nindex = ['foo']\n[input]", ":3: Unknown index format 'foo'"),
        ("[input]", "[batch]\npattern = '('\n[input]", ":3: pattern is not a regular expression"),
    ],
)
def test_each_mistake_ends_with_2(run, old, new, words):
    code, out, _ = run(GOOD.replace(old, new, 1))
    assert code == 2
    assert words in out


def test_a_recipe_that_is_not_there_ends_with_2(capsys):
    with pytest.raises(SystemExit) as end:
        main(["check", "nowhere.toml"])
    assert end.value.code == 2
    assert "cannot be read" in capsys.readouterr().out


def test_explain_prints_what_holds_where_a_key_is_left_out(run):
    code, out, _ = run(GOOD, "--explain")
    assert code == 0
    assert 'direction        "vertical"' in out
    assert "\n  names " not in out  # it is given


def test_json(run):
    code, out, _ = run(BAD, "--json")
    assert code == 2
    assert len(json.loads(out)["errors"]) == 8
    _, out, _ = run(GOOD, "--json", "--explain")
    found = json.loads(out)
    assert found["errors"] == []
    assert {k["name"]: k["default"] for k in found["defaults"][0]["keys"]}["tilt"] == "plane"


def test_explain_is_for_recipes(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("0,0\n")
    with pytest.raises(SystemExit) as end:
        main(["check", str(tmp_path / "a.csv"), "--explain"])
    assert end.value.code == 2
    assert "recipes" in capsys.readouterr().err
