"""What a person reads at the command line: the word list of the style page holds on every help line and message."""

import ast
import contextlib
import json
import re
import shlex
from functools import cache
from pathlib import Path

import click
import pytest

import metrosep
from metrosep.cli.main import _GROUPS, _HOMES, cli, main

PACKAGE = Path(metrosep.__file__).parent

WORDS = {
    "doubt": r"\bdoubt(?:s|ful)?\b",
    "told": r"\b(?:is|are|be|was) told\b(?! apart)",
    "cannot be told": r"\bcannot be told\b",
    "more words": r"\b[Mm]ore words\b",
    "stands twice": r"\bstands? twice\b",
    "carried out": r"\b[Cc]arr(?:y|ied) out\b",
    "odd": r"\bodd about\b|\bnothing odd\b",
    "taken out": r"\btaken out\b",
    "left out": r"\bleft out\b",
    "is no": r"(?<!there )(?<!There )\b(?:is|are) no (?!longer|more|worse|better|larger|\w+ (?:is|are|lies)\b)\w+",
}
"""Words of the style page that nobody says at the machine; each with what a person would say instead."""

HEADLESS = re.compile(r"^(?:Of|Such as|Between|Not|Fact) ")
ELSEWHERE = {
    "told of anything": r"\btold\b",
    "said": r"\bis said\b",
    "sensor in volts": r"\bsensor in volts\b",
    "please": r"\b[Pp]lease\b(?! report)",
}
"""Looked for in messages, not in the help."""

DOORS = ("cli", "report", "batch")
"""Folders that are looked at one by one; the whole package is looked at as one."""


def helps():
    """Yield every text of the help: of the group, of each command, of each option."""
    for name in _HOMES:
        command = cli.get_command(click.Context(cli), name)
        yield name, command.help or ""
        for option in command.params:
            if getattr(option, "help", None):
                yield f"{name} {option.opts[0]}", option.help


@cache
def messages(folder):
    """Return the texts in code that a user can see: no docstring, no comment of a constant."""
    return tuple(_texts(folder))


@cache
def trees():
    return {p: ast.parse(p.read_text(encoding="utf-8")) for p in sorted(PACKAGE.rglob("*.py"))}


def _pages(node, path):
    """Yield the docstrings of what has no underscore: `help()` shows them."""
    for each in ast.iter_child_nodes(node):
        if isinstance(each, ast.FunctionDef | ast.ClassDef) and not each.name.startswith("_"):
            yield f"{path}:{each.lineno}", ast.get_docstring(each) or ""
            yield from _pages(each, path)


def _texts(folder):
    for path, tree in trees().items():
        if not path.is_relative_to(PACKAGE / folder):
            continue
        quiet = {
            id(node.value)
            for node in ast.walk(tree)
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        }
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.Constant)
                and isinstance(node.value, str)
                and id(node) not in quiet
            ):
                yield f"{path.relative_to(PACKAGE)}:{node.lineno}", node.value


@pytest.mark.parametrize("word", WORDS)
def test_no_help_line_has_a_word_of_the_list(word):
    found = [(where, text) for where, text in helps() if re.search(WORDS[word], text)]
    assert found == []


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("folder", DOORS)
def test_no_message_of_the_doors_has_a_word_of_the_list(folder, word):
    found = [(where, text) for where, text in messages(folder) if re.search(WORDS[word], text)]
    assert found == []


@pytest.mark.parametrize("word", [*WORDS, *ELSEWHERE])
def test_no_message_of_the_package_has_a_word_of_the_list(word):
    """A text of one word is a name or a key; what people read has a blank in it."""
    pattern = {**WORDS, **ELSEWHERE}[word]
    found = [(w, t) for w, t in messages(".") if " " in t.strip() and re.search(pattern, t)]
    assert found == []


@pytest.mark.parametrize("word", WORDS)
def test_no_page_of_the_reference_has_a_word_of_the_list(word):
    pages = (page for path, tree in trees().items() for page in _pages(tree, path.name))
    assert [(where, t) for where, t in pages if re.search(WORDS[word], t)] == []


def test_the_help_of_an_option_stands_alone():
    bad = [(where, text) for where, text in helps() if HEADLESS.match(text)]
    assert bad == []


# ---- rules of the command line -------------------------------------------------------------------


def run(*words):
    with pytest.raises(SystemExit) as ended:
        main([str(w) for w in words])
    return ended.value.code


def test_alone_it_shows_groups_and_examples_and_is_no_error(capsys):
    assert run() == 2
    said = capsys.readouterr().err
    assert "error:" not in said
    for group in (*_GROUPS, "Examples"):
        assert f"{group}:" in said
    assert "…" not in said
    assert "..." not in said.replace("[ARGS]...", "")
    assert len(said.splitlines()) > 50


@pytest.mark.parametrize("word", ["mesure", "reprot", "batc"])
def test_a_command_that_is_mistyped_gets_its_neighbour(capsys, word):
    assert run(word) == 2
    assert "Did you mean" in capsys.readouterr().err


def test_a_format_that_is_mistyped_gets_its_neighbour(capsys, tmp_path):
    assert run("report", tmp_path, "-o", tmp_path / "r", "--format", "htm") == 2
    assert "Unknown report format 'htm'" in (said := capsys.readouterr().err)
    assert 'Did you mean "html"?' in said
    assert not (tmp_path / "r").exists()


def test_doctor_lists_what_is_installed(capsys):
    assert run("doctor", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["versions"]["numpy"]
    assert 'pip install "metrosep[' in " ".join(found["extras"].values()) or found["extras"]
    assert "can be written" in found["places"]["scratch"]


@pytest.mark.parametrize(
    ("shell", "text"),
    [("bash", "_METROSEP_COMPLETE=bash_complete"), ("zsh", "#compdef metrosep"),
     ("fish", "_METROSEP_COMPLETE=fish_complete"), ("powershell", "Register-ArgumentCompleter")],
)  # fmt: skip
def test_completion_prints_a_script(capsys, shell, text):
    assert run("completion", shell) == 0
    assert text in capsys.readouterr().out


def test_completion_answers(capsys, monkeypatch):
    monkeypatch.setenv("_METROSEP_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "metrosep mea")
    monkeypatch.setenv("COMP_CWORD", "1")
    run()
    assert "plain,measure" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("iden", "plain,identify"),
        ("identify fts", "plain,fts_lathe"),
        ("identify fts_lathe ma", "file,ma"),
        ("identify fts_lathe map.x3p --cur", "plain,--curves"),
        ("table --from", "plain,--from-machine"),
        ("table --from-machine mi", "plain,mill_xyz"),
        ("table --from-machine mill_xyz er", "file,er"),
        ("table --from-machine=mill_xyz --ov", "plain,--over"),
        ("measure pa", "file,pa"),
        ("measure part.x3p --out re", "dir,re"),
    ],
)
def test_completion_knows_both_doors_and_where_files_stand(capsys, monkeypatch, typed, said):
    monkeypatch.setenv("_METROSEP_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"metrosep {typed}")
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split())))
    run()
    assert capsys.readouterr().out.split() == [said]


def test_completion_in_powershell_asks_the_program(capsys, monkeypatch):
    assert run("completion", "powershell") == 0
    script = capsys.readouterr().out
    assert "powershell_complete" in script
    assert "--help" not in script
    monkeypatch.setenv("_METROSEP_COMPLETE", "powershell_complete")
    monkeypatch.setenv("COMP_WORDS", "metrosep mea")
    monkeypatch.setenv("COMP_CWORD", "1")
    run()
    assert capsys.readouterr().out.split("\n")[:2] == ["plain", "measure"]


def test_completion_without_a_shell_of_this_click_is_refused(capsys, monkeypatch):
    monkeypatch.setattr("click.shell_completion.get_completion_class", lambda _name: None)
    assert run("completion", "powershell") == 2
    assert "pip install --upgrade click" in capsys.readouterr().err


def test_a_long_command_says_what_it_is_at(monkeypatch, capsys):
    from metrosep.cli import main as module

    beat = module._Heartbeat(["run"], {"phase": "step 3: form"})
    monkeypatch.setattr(beat, "_on_terminal", True)
    pauses = iter([False, True])
    beat._done = type("Done", (), {"wait": lambda _self, _pause: next(pauses)})()
    beat._beat()
    assert "metrosep: step 3: form, 0 s" in capsys.readouterr().err
    assert module._Heartbeat(["-q", "run"], {})._quiet
    assert module._Heartbeat(["--help"], {})._quiet


@pytest.mark.parametrize(
    ("words", "phase"),
    [
        ("measure {map} --form sphere --params Sq", "measuring"),
        ('psd {map} --limit "rms = 5 nm from 0.3 mm to 3 mm" -o {out}/psd', "writing the report"),
        ("report {result} -o {out} --format csv", "1 of 1 reports"),
        ("form {map} --form plane", "fitting plane to measured.sdf"),
        ("convert {map} {out}/part.x3p", "writing "),
        ("diff {result} {result}", "comparing "),
    ],
)
def test_verbs_beside_the_recipe_name_their_phase(words, phase, repository, tmp_path, monkeypatch):
    from metrosep.cli import main as module

    held: list[dict] = []
    monkeypatch.setattr(
        module, "_Heartbeat", lambda _words, told: held.append(told) or contextlib.nullcontext()
    )
    part = repository / "examples/measured_part/measured.sdf"
    if "{result}" in words:
        assert run("-q", "measure", str(part), "--params", "Sq", "-o", str(tmp_path / "r")) == 0
    run("-q", *shlex.split(words.format(map=part, out=tmp_path, result=tmp_path / "r")))
    assert phase in held[-1]["phase"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("rank fts_lathe", "Missing options '--form' and '--radius'."),
        (
            "machine-tables fts_lathe -o out",
            "argument 'ERRORS...' and options '--over' and '--spacing'.",
        ),
        ("batch parts -o out", "metrosep batch RECIPE DIR -o OUT"),
        ("rank fts_lathe --form 'sphere: R=1 m' --radius '9 mm'", '--error "EXX=1 um"'),
        ("rank fts_lathe --form 'sphere: R=1 m' --radius '9 mm'", "--all-lengths"),
        (
            "rank fts_lathe --form sphere --radius '9 mm' --error 'EXX=1 um'",
            '--form "sphere" has no',
        ),
    ],
)
def test_all_that_is_missing_is_said_at_once_in_words_of_the_command(words, says, capsys):
    assert run(*shlex.split(words)) in (2, 4)
    assert says in capsys.readouterr().err
