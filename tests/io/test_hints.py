"""Whoever is refused follows the hints of the message, at whatever door, and gets on.

Untidy files at every door: read, read_runs and open_stream in Python, the verbs of the command line,
a recipe. The first hint of each message is given as it is printed; what the message leaves open
("...", UNIT) is filled in as a person would. After each hint the message must be another one, and no
door may say that it does not know the option.
"""

import re
import shlex

import numpy as np
import openpyxl
import pytest

import metrosep as ms
from metrosep.cli.main import main
from metrosep.io.stream import open_stream

pytestmark = pytest.mark.usefixtures("without_figures")

X = [round(0.1 * k, 1) for k in range(60)]
Z = [round(float(np.sin(0.4 * k)) + 1e-3 * k, 4) for k in range(60)]
ROWS = [f"{x},{z}" for x, z in zip(X, Z, strict=True)]
THREE = [f"{r},{x},{round(z + 0.01 * r, 4)}" for r in range(3) for x, z in zip(X, Z, strict=True)]
MOST = 5  # hints that a person follows


def text(*lines):
    return "\n".join(lines) + "\n"


UNTIDY = {
    "title": text("x_mm,z_um", "By hand and in spring", *ROWS),
    "text inside": text("x_mm,z_um", *ROWS[:30], "pause, new part", *ROWS[30:]),
    "marker": text("x_mm,z_um", *ROWS[:30], "2.95,-9999", *ROWS[30:]),
    "word": text("x_mm,z_um", *ROWS[:30], "2.95,broken", *ROWS[30:]),
    "no unit": text("x,z", *ROWS),
    "no names": text(*ROWS),
    "no position": text("x_mm,z_um", *ROWS[:20], ",1.0", ",2.0", *ROWS[20:]),
    "thousands": text(
        "x_mm;z_um", *(f"{x};{1 + k % 5},{(137 * k) % 900 + 100}" for k, x in enumerate(X))
    ),
    "volts": text("x_mm,probe_V", *ROWS),
    "three": text("x_mm,z_um,b_um", *(f"{x},{z},{z + 1:.4f}" for x, z in zip(X, Z, strict=True))),
    "runs": text("run,x_mm,z_um", *THREE),
    "runs with a marker": text("run,x_mm,z_um", *THREE, *(f"3,{x},-9999" for x in X[:5])),
    "coarse clock": text("time,z_um", *(f"14:07:{k // 10:02d},{z}" for k, z in enumerate(Z))),
    "dates": text(
        "time,z_um", *(f"{1 + k % 9}/{2 + k % 5}/2026 14:07:{k:02d},{z}" for k, z in enumerate(Z))
    ),
    "sheets": {"Log": [["n", "v"], [1, 2]], "Data": [["x_mm", "z_um"], *zip(X, Z, strict=True)]},
    "texts in cells": {
        "Data": [
            ["x_mm", "z_um"],
            *([x, f"{1 + k % 5},{(137 * k) % 900 + 100}"] for k, x in enumerate(X)),
        ]
    },
    "odd cell": {"Data": [["x_mm", "z_um"], *zip(X, Z, strict=True), [6.0, "broken"], [6.1, 0.5]]},
}
FILLED = {
    "sampling_rate": "1 kHz", "sampling-rate": "1 kHz", "lateral_step": "0.1 mm",
    "lateral-step": "0.1 mm", "x": "x_mm", "z": "z_um", "unit": "um", "scale": "2.5 um/V",
}  # fmt: skip
"""What a person gives where a message leaves it open."""

VERBS = {
    "info": "info {}",
    "check": "check {}",
    "measure": "measure {} --params Pt",
    "convert": "convert {} {}.out.h5 --force",
    "separate": "separate {} --x x_mm --z z_um --feed '90 mm/min' --method mean",
}
UNKNOWN = ("takes no option", "No such option", "Usage:", "Traceback", "requires an argument")


@pytest.fixture
def untidy(tmp_path):
    """Write an untidy file: a text, or a workbook of sheets."""

    def write(name):
        content = UNTIDY[name]
        path = tmp_path / ("data.csv" if isinstance(content, str) else "data.xlsx")
        if isinstance(content, str):
            path.write_text(content, "utf-8")
            return path
        made = openpyxl.Workbook()
        made.remove(made.active)
        for title, rows in content.items():
            sheet = made.create_sheet(title)
            for row in rows:
                sheet.append(row)
        made.save(path)
        return path

    return write


def printed(said):
    """Return the hints of a message of a command: option and value, in their order."""
    pattern = r'--set "(\w+)=([^"]*)"|--([a-z][a-z-]+)(?: (?:"([^"]*)"|([^\s;,()]+)))?'
    found = []
    for key, value, option, quoted, plain in re.findall(pattern, said):
        name = key or option
        if name in ("set", "help", "json", "force", "feed", "method", "exclude", "accept"):
            continue
        given = value or quoted or plain
        given = FILLED.get(name, "") if given in ("", "...", "UNIT") else given
        found.append((bool(key), name, given))
    return found


def code_and_words(capsys, *words):
    with pytest.raises(SystemExit) as stop:
        main(list(words))
    return stop.value.code or 0, " ".join("".join(capsys.readouterr()).split())


def follow(call, hints_of):
    """Call, follow the first hint that was not given yet, and so on; return the last message, if any."""
    given: dict[str, str] = {}
    messages: list[str] = []
    for _ in range(MOST):
        message = call(given)
        if message is None:
            return None
        assert not any(u in message for u in UNKNOWN), (given, message)
        assert message not in messages, (given, message)
        messages.append(message)
        fresh = [(name, value) for name, value in hints_of(message) if given.get(name) != value]
        if not fresh:
            return message
        given = given | dict(fresh[:1])
    return messages[-1]


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("name", UNTIDY)
def test_hints_of_a_command_lead_on(untidy, capsys, name, verb):
    path = untidy(name)
    whole: list[str] = []

    def call(given):
        words = shlex.split(VERBS[verb].format(path, path))
        for option, value in given.items():
            is_key, bare = option.split(":", 1)
            words += ["--set", f"{bare}={value}"] if is_key == "True" else [f"--{bare}", value]
        code, said = code_and_words(capsys, *words)
        whole[:] = [said]
        return None if code in (0, 1, 3) else said

    def hints_of(said):
        # a gap is what the file is; its hint is for positions that are only rounded
        if "separate them with: metrosep" in said or "not uniform" in said:
            return []
        return [(f"{is_key}:{option}", value) for is_key, option, value in printed(said)]

    last = follow(call, hints_of)

    if last is not None and (found := re.search(r"separate them with: metrosep (.*)", last)):
        words = [*shlex.split(found[1]), "--method", "mean"]
        code, said = code_and_words(capsys, *words)
        if code == 4:
            ((_, option, value),) = printed(said)
            code, said = code_and_words(capsys, *words, f"--{option}", value)
        assert code in (0, 1, 3), said
        return
    # what the file is, not what a hint says
    excused = ("not uniform", "has no x column", "has no z column", "need a profile or a map")
    assert last is None or any(e in last for e in excused), last


def keywords(message):
    """Return the hints of a message of the library."""
    found = []
    for name, value in re.findall(r"(?<![\w.])([a-z_]+)=(?:'([^']*)')?", message):
        given = FILLED.get(name, "") if value in ("", "...") else value.replace("UNIT", "um")
        if given and name != "time":
            found.append((name, given))
    return found


def streamed(path, **options):
    with open_stream(path, **options) as stream:
        for _ in stream.chunks():
            pass


DOORS = {
    "read": ms.read,
    "read_runs": lambda path, **o: ms.read_runs(
        path, **{"x": "x_mm", "z": "z_um", "sampling_rate": "1 kHz", **o}
    ),
    "open_stream": streamed,
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", UNTIDY)
def test_hints_of_a_function_lead_on(untidy, name, door):
    path = untidy(name)

    def call(given):
        try:
            DOORS[door](path, **given)
        except ms.errors.MetrosepError as exc:
            return str(exc)
        return None

    last = follow(call, keywords)

    excused = ("has no x column", "has no z column", "name the other channels", "monotonic")
    assert last is None or any(e in last for e in excused), last


@pytest.mark.parametrize(
    "name",
    [n for n in UNTIDY if n not in ("volts", "no names", "no unit", "coarse clock", "dates")],
)
def test_hints_of_a_recipe_are_keys_of_its_input(untidy, capsys, name):
    path = untidy(name)
    recipe = path.with_name("runs.toml")

    def call(given):
        held = {"x": "x_mm", "z": "z_um", "sampling_rate": "1 kHz", **given}
        lines = [f'{k} = "{v}"' for k, v in held.items()]
        recipe.write_text(
            text(
                "metrosep = 1", "[input]", f'files = ["{path.name}"]', *lines, "[[step]]",
                'op = "separate"', 'method = "mean"',
            ),
            "utf-8",
        )  # fmt: skip
        code, said = code_and_words(capsys, "run", str(recipe), "-o", str(path.with_name("out")))
        return None if code in (0, 1, 3) else said

    def hints_of(said):
        return re.findall(r'(\w+) = "([^"]*)" in \[input\]', said)

    assert follow(call, hints_of) is None


STANDARD = text(
    "Reference data",
    "File format:   ASCII",
    "",
    "Data:          1 Response (y = gap)",
    "               8 Observations",
    "               Lower difficulty",
    "",
    "        Starting values   Certified values",
    "  b1 =    2.5   2.4E+00",
    "Number of observations:   8",
    "",
    "Data:   y               x",
    *(f"  {1.5 + 0.1 * (k % 3):.2f}E0   {k}.5E0" for k in range(8)),
)
TURNING = text(
    "x_mm,z_um", *(f"{x},{0.1 * (k % 3):.1f}" for k, x in enumerate((0, 1, 2, 1.5, 3, 2.5, 4)))
)
SPIKE = text("x_mm,z_um", *(f"{x},{0.1 * (k % 3):.1f}" for k, x in enumerate((0, 1, 6, 3, 4, 5))))


@pytest.mark.parametrize(
    ("content", "steps", "x"),
    [
        (STANDARD, 2, [k + 0.5 for k in range(8)]),
        (text(*ROWS), 1, X),
        (TURNING, 1, [0, 1, 2, 3, 4]),
        (SPIKE, 1, [0, 1, 3, 4, 5]),
        (text("x_mm,z_um", "0,1", "1,oops", "2,1", "3,1", "4,bump", "5,1"), 2, [0, 2, 3, 5]),
    ],
    ids=["text above", "two units", "turns back", "one spike", "one line after the other"],
)
def test_each_hint_is_complete_and_keeps_what_was_given(tmp_path, content, steps, x):
    path = tmp_path / "data.txt"
    path.write_text(content, "utf-8")
    given: dict[str, str] = {}
    for _ in range(steps):
        with pytest.raises(ms.errors.MetrosepError) as caught:
            ms.read(path, **given)
        hints = dict(re.findall(r"(unit|skip_\w+)='([^']*)'", str(caught.value)))
        name = next(iter(hints))
        given[name] = hints[name].replace("um", "mm")  # what a person knows

    assert list(ms.read(path, **given).x) == pytest.approx([1e-3 * v for v in x], abs=1e-15)


def test_a_second_word_for_not_measured_stands_beside_the_first(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text("x_mm,z_um", "0,1", "1,-9999", "2,oops", "3,1", "4,2", "5,3"), "utf-8")

    with pytest.raises(ms.errors.MetrosepError, match="missing='-9999,oops'"):
        ms.read(path, missing="-9999")

    assert np.isnan(ms.read(path, missing="-9999,oops").z[[1, 2]]).all()


def test_names_far_above_text_and_rows_are_not_taken_from_another_table(tmp_path):
    path = tmp_path / "data.txt"
    path.write_text(STANDARD, "utf-8")

    with pytest.raises(ms.errors.MetrosepError, match="skip_rows='12'") as caught:
        ms.read(path)

    assert "if line 8" in str(caught.value)


def test_a_row_of_units_alone_gives_units_not_names(tmp_path):
    path = tmp_path / "data.txt"
    path.write_text(text("mm um", *ROWS), "utf-8")

    profile = ms.read(path)

    assert profile.x[1] == pytest.approx(1e-4, abs=1e-15)
    assert profile.z[1] == pytest.approx(Z[1] * 1e-6, abs=1e-15)


def test_info_says_why_a_table_is_no_object_and_refuses_with_options_that_make_none(
    tmp_path, capsys
):
    path = tmp_path / "data.csv"
    path.write_text(UNTIDY["three"].replace("_mm", "").replace("_um", ""), "utf-8")

    code, said = code_and_words(capsys, "info", str(path))
    assert code == 0
    assert "no object has 3 column(s) of numbers" in said
    code, said = code_and_words(capsys, "info", str(path), "--unit", "um")
    assert code == 4
    assert "3 column(s) of numbers" in said


def test_units_by_name_are_given_to_a_command_as_its_hints_print_them(tmp_path, capsys):
    from metrosep.cli.errors import as_options

    path = tmp_path / "data.csv"
    path.write_text(UNTIDY["no names"], "utf-8")
    hint = as_options("declare unit={'column1': 'mm'}", ("unit", "settings"))
    assert hint == "declare --unit column1:mm"

    code, said = code_and_words(capsys, "info", str(path), "--unit", "column1:mm,column2:um")

    assert code == 0
    assert "step 100 um" in said


def test_a_name_that_is_no_column_names_the_file_once(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(UNTIDY["three"], "utf-8")

    with pytest.raises(ms.errors.MetrosepError) as caught:
        ms.read(path, x="foo", z="z_um")

    assert str(caught.value).count(str(path)) == 1


REFUSED = ("st/nonsense_txt_file.txt", "upm/D906-1-result.txt")
"""Files of the corpus that hold no measurement."""


def corpus_files():
    import os
    from pathlib import Path

    folder = Path(
        os.environ.get("METROSEP_CORPUS", Path(__file__).parents[3] / "shared" / "corpus")
    )
    every = sorted(folder.rglob("*"))
    return [
        str(p.relative_to(folder))
        for p in every
        if p.is_file() and p.suffix not in (".md", ".tsv", ".json")
    ]


@pytest.mark.parametrize("name", corpus_files())
def test_info_of_a_real_file_gets_on_with_the_hints_that_it_prints(corpus, capsys, name):
    words = ["info", str(corpus / name)]
    for _ in range(4):
        code, said = code_and_words(capsys, *words)
        if code == 0 or name in REFUSED:
            break
        assert not any(u in said for u in UNKNOWN), said
        fresh = [(k, n, v) for k, n, v in printed(said) if v and f"{n}={v}" not in words]
        is_key, option, value = fresh[0]
        words += ["--set", f"{option}={value}"] if is_key else [f"--{option}", value]

    assert code == (4 if name in REFUSED else 0), said
