"""What a person reads at the command line: the word list of the style page holds on every help line and message."""

import ast
import contextlib
import json
import re
import shlex
from functools import cache

import click
import pytest
from contracts.sources import PACKAGE, trees

from metrosep.cli.main import _GROUPS, _HOMES, cli, main

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
def pages():
    """Return the docstrings that `help()` shows, of the whole package."""
    return tuple(page for path, tree in trees().items() for page in _pages(tree, path.name))


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
        quiet = set()  # a parent comes before its children
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr):
                quiet.add(id(node.value))
            elif (
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
    assert [(where, t) for where, t in pages() if re.search(WORDS[word], t)] == []


def test_the_help_of_an_option_stands_alone():
    bad = [(where, text) for where, text in helps() if HEADLESS.match(text)]
    assert bad == []


def commands():
    context = click.Context(cli, info_name="metrosep")
    return {name: cli.get_command(context, name) for name in cli.list_commands(context)}


def test_every_option_has_a_help_line():
    assert [
        (name, option.opts)
        for name, command in commands().items()
        for option in command.params
        if isinstance(option, click.Option) and not option.help
    ] == []


def test_every_command_shows_examples_first_that_it_would_take():
    """Each example is parsed by its own command: an option that it lacks, or one that is missing, fails."""
    for name, command in commands().items():
        page = command.get_help(click.Context(command, info_name=f"metrosep {name}"))
        lines = page.partition("Examples:")[2].partition("\n\n")[0].splitlines()
        examples = [v.strip() for v in lines if f"metrosep {name}" in v]
        assert examples, name
        assert page.index("Examples:") < page.index("Options:"), name
        for text in examples:
            if text.startswith("eval"):
                continue
            _, _, typed = text.partition(f"metrosep {name}")
            given = shlex.split(typed.partition(" > ")[0])
            options, words, _ = command.make_parser(click.Context(command)).parse_args(given)
            for option in command.params:
                found = options.get(option.name)
                assert found is not None or not option.required, (text, option.name)
                if found is not None and isinstance(option, click.Option):
                    option.type_cast_value(click.Context(command), found)
            assert words == [], text


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
        ("table err.csv --from-machine mi", "plain,mill_xyz"),
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


def test_progress_begins_after_half_a_second(capsys, monkeypatch):
    from metrosep.cli import jobs

    clock = iter([10.0, 10.4, 10.6])
    monkeypatch.setattr(jobs.time, "monotonic", lambda: next(clock))
    context = click.Context(cli, obj={})
    tell = jobs.progress(context)
    tell("reading")
    tell("fitting")
    assert capsys.readouterr().err == "metrosep: fitting\n"
    assert context.obj["phase"] == "fitting"


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
            "argument 'ERRORS...' and options '--over' and '--spacing' and '--radius'.",
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


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("controllers linuxncc", "linuxcnc"),
        ("ops donaldsn", "donaldson"),
        ("info {file} --as delimitd", "delimited"),
        ("measure {file} --form spher", "sphere"),
        ("measure {file} --set seperator=tab", "separator"),
        ("convert {file} {out}/part.x3pp", "x3p"),
        ("geometry run_ot {file}", "run_out"),
        ("measure {file} --kind p", "P"),
        ("completion bsh", "bash"),
        ("report {out} --format htm -o {out}/r", "html"),
        ("rank sts_lath --form plane --radius '1 mm'", "sts_lathe"),
        ("rank sts_lathe --form plane --radius '1 mm' --all-lengths '1 um' --removed pistn", "piston"),
        ("run {out}/step.toml -o {out}/r", "form"),
    ],
)  # fmt: skip
def test_a_word_that_is_nearly_known_is_asked_for(words, meant, repository, tmp_path, capsys):
    (tmp_path / "step.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["a"]\n[[step]]\nop = "frm"\n'
    )
    part = repository / "examples/measured_part/measured.sdf"
    if "seperator" in words or "delimitd" in words:
        part = tmp_path / "a.csv"
        part.write_text("x_mm,z_um\n" + "".join(f"{i},{i % 3}\n" for i in range(20)))
    assert run(*shlex.split(words.format(file=part, out=tmp_path))) != 0
    assert f'Did you mean "{meant}"?' in capsys.readouterr().err
