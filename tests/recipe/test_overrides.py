"""`-s key=value`: what is run is the recipe as a person would have edited it, and it says so."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import RecipeError
from metrosep.recipe.outputs import recipe_hash
from metrosep.recipe.written.extends import split_record
from metrosep.recipe.written.overrides import with_overrides, with_value

EXAMPLES = [
    file
    for file in sorted((Path(__file__).parents[2] / "examples").glob("*/*.toml"))
    if "[[step]]" in file.read_text(encoding="utf-8")
]

RECIPE = """# lens
metrosep = 1
title = "lens"

[input]
files = ["part.x3p"]

[[step]]
op = "form"
form = "polynomial: degree=2"  # as drawn
fix = { R = "50 mm" }

[[step]]
op = "filter"
cutoff = "20 um"

[[step]]
op = "filter"
cutoff = "20 um"
band = "short"

[[step]]
op = "parameters"
names = [
  "Sa",  # of the drawing
  "Sq",
]

[[check]]
name = "roughness 1.5"
metric = "Sa"
upper = "10 nm"
U = "0.3 nm"

[[output]]
kind = "report"
formats = ["html"]
"""
PLAIN = RECIPE.replace('fix = { R = "50 mm" }\n', "")


def parsed(text, *overrides, **options):
    return ms.Recipe.parse(text, overrides=overrides, **options)


EDITS = [
    ("title=other lens", 'title = "lens"', 'title = "other lens"'),
    ("step.form.form=sphere", '"polynomial: degree=2"', '"sphere"'),
    ("step.1.form=sphere", '"polynomial: degree=2"', '"sphere"'),
    (
        "step.3.cutoff=5 um",
        '[[step]]\nop = "filter"\ncutoff = "20 um"\nband',
        '[[step]]\nop = "filter"\ncutoff = "5 um"\nband',
    ),
    ("step.2.enabled=false", 'cutoff = "20 um"\n\n', 'cutoff = "20 um"\nenabled = false\n\n'),
    (
        'step.parameters.names=["PV", "Sa"]',
        '[\n  "Sa",  # of the drawing\n  "Sq",\n]',
        '["PV", "Sa"]',
    ),
    ("step.4.names=Sa", '[\n  "Sa",  # of the drawing\n  "Sq",\n]', '["Sa"]'),
    ('check."roughness 1.5".upper=12 nm', '"10 nm"', '"12 nm"'),
    ('check.Sa.upper="12 nm"', '"10 nm"', '"12 nm"'),
    ("check.1.guard_factor=0.5", 'U = "0.3 nm"', 'U = "0.3 nm"\nguard_factor = 0.5'),
    ("input.lateral_step=2 um", '["part.x3p"]', '["part.x3p"]\nlateral_step = "2 um"'),
    ('output.report.formats=["html", "csv"]', '["html"]', '["html", "csv"]'),
]


@pytest.mark.parametrize(("given", "old", "new"), EDITS)
def test_an_override_is_the_recipe_edited_by_hand(given, old, new):
    assert PLAIN.count(old) >= 1
    made, by_hand = parsed(PLAIN, given), parsed(PLAIN.replace(old, new, 1))
    if "names=Sa" not in given:  # a text stands for a list of one
        assert tomllib.loads(made.text) == tomllib.loads(by_hand.text)
    assert recipe_hash(made) == recipe_hash(by_hand)
    assert made.title == by_hand.title
    if not given.startswith("title"):
        assert recipe_hash(made) != recipe_hash(parsed(PLAIN))
    assert made.recorded["overrides"] == [given]
    again = ms.Recipe.parse(made.recorded["text"])
    assert (recipe_hash(again), again.recorded) == (recipe_hash(made), made.recorded)


def test_comments_order_and_line_numbers_stay():
    text = with_overrides(
        PLAIN,
        "r.toml",
        Path(),
        ["step.parameters.names=PV", "step.form.form=sphere"],
    )
    lines, before = text.split("\n"), PLAIN.split("\n")
    assert len(lines) == len(before)
    changed = {i: line for i, line in enumerate(lines) if line != before[i]}
    assert list(changed.values()) == [
        'form = "sphere"  # as drawn  # set by -s step.form.form=sphere',
        'names = "PV"  # set by -s step.parameters.names=PV',
        "",
        "",
        "",
    ]


def test_the_same_line_in_another_step_is_left_alone():
    made = parsed(PLAIN, "step.2.cutoff=20 um")
    lines = [line for line in made.text.split("\n") if line.startswith("cutoff")]
    assert lines == ['cutoff = "20 um"  # set by -s step.2.cutoff=20 um', 'cutoff = "20 um"']
    made = parsed(PLAIN, "step.3.cutoff=20 um")
    lines = [line for line in made.text.split("\n") if line.startswith("cutoff")]
    assert lines == ['cutoff = "20 um"', 'cutoff = "20 um"  # set by -s step.3.cutoff=20 um']


@pytest.mark.parametrize(
    ("given", "path", "value"),
    [
        ("title=5", ("title",), "5"),
        ('title="5"', ("title",), "5"),
        ("title=", ("title",), ""),
        ("title=a = b", ("title",), "a = b"),
        ("title=true", ("title",), "true"),
        ("title=1 # 2", ("title",), "1 # 2"),
        ("title=Prüfling „7“", ("title",), "Prüfling „7“"),
        ("title=a\\b", ("title",), "a\\b"),
        ("step.form.robust=tukey", ("step", 0, "robust"), "tukey"),
        ("step.2.order=1", ("step", 1, "order"), 1),
        ("step.2.enabled=false", ("step", 1, "enabled"), False),
        ("step.2.tension=0.5", ("step", 1, "tension"), 0.5),
        ("step.2.radius=5 um", ("step", 1, "radius"), "5 um"),
        ("step.2.radius=5", ("step", 1, "radius"), 5),
        ("step.2.order=x", ("step", 1, "order"), "x"),
        ("step.form.fix.R=51 mm", ("step", 0, "fix", "R"), "51 mm"),
        ("step.form.fix.k=-1", ("step", 0, "fix", "k"), -1),
        ("step.form.start.k=-1", ("step", 0, "start", "k"), -1),
        ('step.form.start={ R = "3 mm" }', ("step", 0, "start", "R"), "3 mm"),
        ("step.4.names=all", ("step", 3, "names"), "all"),
        ("check.1.upper=12 nm", ("check", 0, "upper"), "12 nm"),
        ("check.1.upper=12", ("check", 0, "upper"), 12),
        ("check.1.metric=5", ("check", 0, "metric"), "5"),
        ("batch.pattern=(?P<n>\\d+)[.]x3p", ("batch", "pattern"), "(?P<n>\\d+)[.]x3p"),
        ("batch.trend=Sa", ("batch", "trend"), "Sa"),
        ('input.x={ column = "X", unit = "mm" }', ("input", "x", "unit"), "mm"),
        (" step . 2 . order = 1 ", ("step", 1, "order"), 1),
    ],
)
def test_the_value_is_of_the_kind_of_the_key(given, path, value):
    held = tomllib.loads(with_overrides(RECIPE, "r.toml", Path(), [given]))
    for key in path:
        held = held[key]
    assert held == value
    assert type(held) is type(value)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ("step.form.fom=plane", r'unknown key "fom" in step 1 \(form\); known: op, .*"form"\?$'),
        ("titel=x", r'unknown key "titel"; what can be set: title, .*Did you mean "title"\?$'),
        ("step.filter.cutoff=5 um", r"step filter is ambiguous;.*write step.2 or step.3$"),
        ("step.5.form=plane", r"there is no step 5; the recipe has 1 form, 2 filter, 3 filter"),
        ("step.0.form=plane", "there is no step 0;"),
        ("step.from.form=plane", r"adds no step. Did you mean \"form\"\?"),
        ("check.Sq.upper=3 nm", r"no check Sq; the recipe has 1 roughness 1.5;"),
        ("output.table.path=x", r"no output table; the recipe has 1 report"),
        ("step.1=plane", r"this is all of step 1 \(form\); name one of its keys: op, form"),
        ("step=plane", "say which step, by its number or name; the recipe has 1 form"),
        ("input=x", r"this is all of \[input\]; name one of its keys: files"),
        ("input.files.first=x", r"files of \[input\] is not a table"),
        ("step.2.cutoff.unit=um", r"cutoff of step 2 \(filter\) is not a table"),
        ("input.x.colum=X", r'unknown key "colum" in x of \[input\]; known: column, unit'),
        ("title.de=x", "title is a text"),
        ("step.form.form", r"write KEY=VALUE, such as"),
        ("=5", "write KEY=VALUE"),
        ("step..form=5", "a part of the key is empty"),
        ("step.form.=5", "a part of the key is empty"),
        ("title=a\nb", "a line break or the like cannot stand here"),
        ("metrosep=2", 'unknown key "metrosep"'),
        ("extends=x.toml", 'unknown key "extends"'),
    ],
)
def test_what_cannot_be_set_is_refused_in_one_sentence(given, match):
    with pytest.raises(RecipeError, match=match) as caught:
        parsed(PLAIN, given)
    message = str(caught.value)
    assert message.startswith("-s ")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("step.form.form=plane", "step.1.form=sphere"),
        ("check.Sa.upper=3 nm", 'check."roughness 1.5".upper=4 nm'),
        ("step.form.fix.R=3 mm", 'step.form.fix={ R = "4 mm" }'),
        ('step.form.fix={ R = "4 mm" }', "step.form.fix.R=3 mm"),
    ],
)
def test_a_key_is_given_once(first, second):
    with pytest.raises(RecipeError, match="sets it too; leave one of them out"):
        parsed(RECIPE, first, second)


def test_a_key_in_what_is_no_table_says_how_to_give_all_of_it():
    text = PLAIN.replace('files = ["part.x3p"]', 'x = "X"\nz = "Z"')
    with pytest.raises(
        RecipeError, match=r"x of \[input\] is 'X' in the recipe, no table; .*'input.x={"
    ):
        parsed(text, "input.x.unit=mm")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("step.form.form=plan", r"recipe.toml, -s step.form.form=plan: step 1 \(form\): "),
        ("step.2.order=7", r"recipe.toml, -s step.2.order=7: order = 7 is not one of 0, 1, 2"),
        ("step.2.cutoff=5", r"recipe.toml, -s step.2.cutoff=5: cutoff = 5: a length"),
        ("check.1.upper=5 V m", r"recipe.toml, -s check.1.upper=5 V m: upper = '5 V m': "),
        (
            "batch.pattern=(",
            r"recipe.toml, -s batch.pattern=\(: pattern is not a regular expression",
        ),
    ],
)
def test_a_wrong_value_is_told_by_its_override(given, message):
    with pytest.raises(RecipeError, match=message):
        parsed(PLAIN, given)


def test_lines_below_a_new_key_are_called_by_their_number_in_the_file():
    wrong = PLAIN.replace('band = "short"', 'band = "shrt"')
    line = wrong.split("\n").index('band = "shrt"') + 1
    with pytest.raises(RecipeError, match=rf"^recipe.toml:{line}: ") as plain:
        parsed(wrong)
    with pytest.raises(RecipeError) as caught:
        parsed(wrong, "input.unit=um", "step.form.robust=tukey", "step.4.names=PV")
    assert (str(caught.value), caught.value.line) == (str(plain.value), line)
    with pytest.raises(RecipeError, match=rf"^recipe.toml:{line}: "):
        parsed(wrong, "check.1.guard_factor=0.5")


LAYOUTS = [
    # a table of its own for a part of a step; the same key elsewhere
    '[[step]]\nop = "form"\n[step.fix]\nR = "1 mm"\n[[step]]\nop = "form"\n[step.fix]\nR = "1 mm"\n',
    '[[step]]\nop = "form"\nfix.R = "1 mm"\n[[step]]\nop = "form"\nfix . "R" = "1 mm"\n',
    '[[step]]\nop = "form"\n[[step]]\nop = "form"\n\'fix\' = {k = 1, R = "1 mm"} # { R = 2 }\n',
    'step = [{op = "a"}, {op = "form", fix = {R = "1 mm"}}]\n',
    '[[step]]\nnote = """\nR = "1 mm"\n[step.fix]\n"""\n[[step]]\nfix = {\'R\' = """\nR\n"""}\n',
    '[[step]]\nR = "1 mm"\n[[step]]\n# [step.fix]\n# R = "1 mm"\n[step.fix] # R = "1 mm"\nR="1 mm"#c\n',
    '[[step]]\r\nop = "a"\r\n[[step]]\r\nfix = { R = "1 mm" }\r\nnames = [\r\n1,\r\n2]\r\n',
    "[[step]]\n[[step]]\n[step.fix]\nk = 1\n[step.more]\nk = 2",
    "[[step]]\n[[step]]\nk = 1\n[step.more]\nk = 2\n[other]\nk = 3",
    "[[step]]\n[[step]]",
]


@pytest.mark.parametrize("text", LAYOUTS)
def test_every_way_to_write_a_recipe_is_found(text):
    wanted = tomllib.loads(text)
    wanted["step"][1].setdefault("fix", {})["R"] = ["2 mm", {"a b": "c\n\x7f", "t": True}]
    made = with_value(text, ("step", 1, "fix", "R"), wanted["step"][1]["fix"]["R"], "k=v")
    assert tomllib.loads(made) == wanted
    assert made.count("by -s k=v") == 1
    if "set by" in made:
        assert made.count("\n") == text.count("\n")
    elif "more" in text or "other" in text:
        assert made.count("\n") == text.count("\n") + 1


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_every_key_of_every_example_can_be_changed(file):
    text = file.read_text(encoding="utf-8")
    for path in paths_of(tomllib.loads(text)):
        wanted = tomllib.loads(text)
        holder = wanted
        for key in path[:-1]:
            holder = holder[key]
        holder[path[-1]] = "other"
        made = with_value(text, path, "other", "k=other")
        assert made is not None, path
        assert tomllib.loads(made) == wanted
        assert made.count("\n") == text.count("\n")


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda f: f"{f.parent.name}/{f.name}")
def test_a_key_can_be_added_to_every_table_of_every_example(file):
    text = file.read_text(encoding="utf-8")
    for path in {p[:-1] for p in paths_of(tomllib.loads(text))}:
        wanted = tomllib.loads(text)
        holder = wanted
        for key in path:
            holder = holder[key]
        holder["new key"] = 5
        made = with_value(text, (*path, "new key"), 5, "k=5")
        assert made is not None, path
        assert tomllib.loads(made) == wanted
        assert made.count("\n") - text.count("\n") == made.count("# added by -s k=5")


def paths_of(value, path=()):
    """Give the way to every value that is not a table."""
    in_tables = path in (("step",), ("check",), ("output",))
    if isinstance(value, dict) or (in_tables and isinstance(value, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from paths_of(inner, (*path, key))
    else:
        yield path


def test_the_numbers_are_those_of_the_recipe_edited_by_hand(tmp_path):
    y, x = np.mgrid[0:40, 0:50] * 1e-6
    z = (
        3.0 * (x - 1e-5) ** 2
        + 40.0 * y**3
        + 1e-9 * np.random.default_rng(3).standard_normal(x.shape)
    )
    ms.write(ms.Surface(z, 1e-6, 1e-6), tmp_path / "part.x3p")
    text = PLAIN.replace('"20 um"', '"8 um"')
    overrides = (
        "step.form.form=polynomial: degree=3",
        "step.3.enabled=false",
        "check.1.upper=1 pm",
    )
    made = parsed(text, *overrides, folder=tmp_path).run()
    by_hand = parsed(
        text.replace("degree=2", "degree=3")
        .replace('band = "short"', 'band = "short"\nenabled = false')
        .replace('"10 nm"', '"1 pm"'),
        folder=tmp_path,
    ).run()
    plain = parsed(text, folder=tmp_path).run()
    keys = ("characteristics", "separation", "verdict", "provenance", "messages", "inputs")
    assert {k: made.document[k] for k in keys} == {k: by_hand.document[k] for k in keys}
    assert (plain.verdict, made.verdict) == ("accept", "inconclusive")
    assert plain.document["characteristics"] != made.document["characteristics"]
    assert made.document["recipe"]["overrides"] == list(overrides)
    assert set(plain.document["recipe"]) == {"name", "text", "sha256"}
    assert plain.document["recipe"]["text"] == text
    assert json.loads(made.to_json())["recipe"]["text"].count("# set by -s ") == 2


def test_the_list_is_in_the_order_of_the_recipe_whatever_the_order_given():
    given = ("check.1.upper=3 nm", "title=x", "step.3.end=cut")
    one, other = parsed(PLAIN, *given), parsed(PLAIN, *reversed(given))
    assert one.text == other.text
    assert one.overrides == ("title=x", "step.3.end=cut", "check.1.upper=3 nm")


def test_keys_of_one_line_keep_a_mark_each_and_the_last_value_of_a_key_counts():
    text = RECIPE.replace('{ R = "50 mm" }', '{ R = "50 mm", k = 0 }')
    made = with_overrides(text, "r.toml", Path(), ["step.form.fix.R=1 mm", "step.form.fix.k=2"])
    assert (
        'fix = { R = "1 mm", k = 2 }  # set by -s step.form.fix.R=1 mm  # set by -s step' in made
    )
    again = with_overrides(
        made, "r.toml", Path(), ["step.form.fix.R=3 mm", "step.form.robust=huber"]
    )
    again = with_overrides(again, "r.toml", Path(), ["step.form.robust=tukey"])
    assert "R=1 mm" not in again
    assert again.count("robust") == 2
    assert 'robust = "tukey"  # added by -s step.form.robust=tukey' in again


def test_a_line_that_was_edited_since_is_no_override_any_more():
    made = parsed(PLAIN, "step.2.end=cut", "title=x").text
    edited = ms.Recipe.parse(made.replace('end = "cut"', 'end = "moment"'))
    assert edited.overrides == ("title=x",)
    edited = ms.Recipe.parse(edited.text.replace('"x"', '"y"'))
    assert "overrides" not in edited.recorded


def test_a_comment_of_a_person_is_no_override():
    text = PLAIN.replace("# as drawn", "# set by -s nothing at all")
    assert parsed(text).recorded["text"] == text
    assert "overrides" not in parsed(text).recorded


def test_the_view_is_left_out_and_the_overrides_stay():
    view = PLAIN + '\n[view]\ntab = "report"\n'
    made = parsed(view, "batch.trend=Sa", "step.2.end=cut")
    assert "[view]" in made.text
    assert "[view]" not in made.recorded["text"]
    assert made.recorded["overrides"] == ["step.2.end=cut", "batch.trend=Sa"]
    assert made.batch_options["trend"] == ("Sa",)


BASE = """metrosep = 1
title = "base"
[input]
files = ["part.x3p"]
unit = "um"
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


@pytest.fixture
def layered(tmp_path):
    (tmp_path / "base.toml").write_text(BASE)
    (tmp_path / "near.toml").write_text(
        'metrosep = 1\nextends = "base.toml"\n[input]\nlateral_step = "1 um"\n'
    )
    return tmp_path


@pytest.mark.parametrize(
    ("given", "by_hand"),
    [
        ("step.form.form=sphere", ('"plane"', '"sphere"')),
        ("check.Sa.lower=1 nm", ('upper = "10 nm"', 'upper = "10 nm"\nlower = "1 nm"')),
        ("input.unit=nm", ('"um"', '"nm"')),
        ("input.channel=2", ('unit = "um"', 'unit = "um"\nchannel = "2"')),
    ],
)
def test_a_key_of_the_recipe_below_is_overridden_in_the_record(layered, given, by_hand):
    made = ms.Recipe.load(layered / "near.toml", overrides=[given])
    assert (layered / "base.toml").read_text() == BASE
    (layered / "base.toml").write_text(BASE.replace(*by_hand))
    edited = ms.Recipe.load(layered / "near.toml")
    assert recipe_hash(made) == recipe_hash(edited)
    assert made.overrides == (given,)
    (layered / "base.toml").unlink()
    again = ms.Recipe.parse(made.text, name="near.toml", folder=layered)
    assert recipe_hash(again) == recipe_hash(made)
    assert split_record(again.text)[1][0][0] == "base.toml"


def test_the_nearest_recipe_takes_what_it_says_itself(layered):
    made = ms.Recipe.load(layered / "near.toml", overrides=["input.lateral_step=2 um", "title=x"])
    own, bases = split_record(made.text)
    assert 'lateral_step = "2 um"  # set by -s input.lateral_step=2 um' in own
    assert 'title = "x"' in bases[0][1]
    assert made.title == "x"


def test_a_wrong_value_in_the_recipe_below_is_told_by_its_override(layered):
    with pytest.raises(RecipeError, match=r"^base.toml, -s check.1.U=3 pints: U = '3 pints': "):
        ms.Recipe.load(layered / "near.toml", overrides=["check.1.U=3 pints"])
    wrong = BASE.replace('Sa"\nupper', 'Sa"\nuper')
    (layered / "base.toml").write_text(wrong)
    with pytest.raises(RecipeError, match=r"^base.toml:14: unknown key"):
        ms.Recipe.load(layered / "near.toml", overrides=["step.1.robust=huber"])


def test_columns_of_repeated_runs_and_names_of_methods():
    text = 'metrosep = 1\n[input]\nx = { column = "X", unit = "mm" }\nz = "z_um"\n[[step]]\nop = "separate"\n'
    made = parsed(text, "input.x.unit=um", "step.separate.lag=fit", "step.separate.lines=auto")
    assert made.input["x"]["unit"] == "um"
    assert (made.steps[0]["lag"], made.steps[0]["lines"]) == ("fit", "auto")
    with pytest.raises(RecipeError, match='unknown key "readings"'):
        parsed(text, "input.readings=a")


def checks(*each):
    """Give a recipe with these checks: (name or None, metric)."""
    text = 'metrosep = 1\n[input]\n[[step]]\nop = "parameters"\nnames = ["Sa", "Sq", "Sz"]\n'
    for name, metric in each:
        label = "" if name is None else f"name = {json.dumps(name)}\n"
        text += f'[[check]]\n{label}metric = "{metric}"\nupper = "1 nm"\n'
    return text


NUMBERS = checks(("2", "Sa"), ("1", "Sq"), ("fine", "Sz"))
AMBIGUOUS = [
    (
        NUMBERS,
        "2",
        "it is the name of check 1 and the number of check 2; write check.Sa or check.Sq",
    ),
    (
        NUMBERS,
        "1",
        "it is the number of check 1 and the name of check 2; write check.Sa or check.Sq",
    ),
    (
        checks(("Sq", "Sa"), ("y", "Sq")),
        "Sq",
        "it is the name of check 1 and the metric of check 2; write check.1 or check.2",
    ),
    (
        checks(("inner zone", "Sa"), (None, "Sa")),
        "Sa",
        "it is the metric of check 1 and the metric of check 2; write check.1 or check.2",
    ),
    (
        checks((None, "Sa"), ("x", "Sz"), ("y", "Sa"), ("Sa", "Sq")),
        "Sa",
        (
            "it is the metric of check 1, the metric of check 3 and the name of check 4; "
            "write check.1, check.3 or check.4"
        ),
    ),
    (
        checks(("2", "Sa"), ("x.y", "Sa"), ("1", "Sq")),
        "2",
        (
            'it is the name of check 1 and the number of check 2; write check."x.y" for check 2, and '
            "give check 1 another name in r.toml"
        ),
    ),
    (
        checks(("2", "Sa"), ("1", "Sa")),
        "1",
        (
            "it is the number of check 1 and the name of check 2; "
            "give check 1 and check 2 other names in r.toml"
        ),
    ),
]


@pytest.mark.parametrize(("text", "word", "message"), AMBIGUOUS)
def test_a_word_that_fits_several_is_refused_whatever_it_is_to_each(text, word, message):
    with pytest.raises(RecipeError) as caught:
        parsed(text, f"check.{word}.upper=50 um", name="r.toml")
    start = f"-s check.{word}.upper=50 um: check {word} is ambiguous; "
    assert str(caught.value) == start + message


@pytest.mark.parametrize(
    ("text", "word", "which"),
    [
        (checks(("1", "Sa"), ("2", "Sq")), "2", 1),  # a name that is its own number
        (checks(("Sa", "Sa"), ("2", "Sq")), "Sa", 0),
        (NUMBERS, "3", 2),
        (NUMBERS, "fine", 2),
        (NUMBERS, "Sa", 0),
        (checks(("4", "Sa"), ("x", "Sq")), "4", 0),  # there is no fourth
        (checks(("x.y", "Sa"), ("1", "Sa")), '"x.y"', 0),
    ],
)
def test_a_word_that_fits_one_is_that_one(text, word, which):
    made = parsed(text, f"check.{word}.upper=50 um")
    exact = 1e-18  # m, rounding of a text to SI
    changed = [c["upper"] == pytest.approx(50e-6, abs=exact) for c in made.checks]
    assert changed == [n == which for n in range(len(changed))]


def test_each_way_that_a_refusal_proposes_sets_the_one_that_it_names():
    text = checks(("2", "Sa"), ('it\'s "x.y"', "Sq"), ("a=b", "Sz"), (None, "Sz"))
    with pytest.raises(RecipeError, match=r"write check.1 or check.Sq$"):
        parsed(text, "check.2.upper=3 nm")
    with pytest.raises(RecipeError, match=r"write check.3 or check.4$"):
        parsed(text, "check.Sz.upper=3 nm")
    text = checks(("3", "Sa"), (None, "Sq"), ("a=b.c", "Sa"), (None, "Sq"))
    with pytest.raises(RecipeError, match=r'write check.1 or check."a=b.c"$'):
        parsed(text, "check.3.upper=3 nm")
    made = parsed(text, 'check."a=b.c".upper=3 nm')
    assert [c["upper"] > 2e-9 for c in made.checks] == [False, False, True, False]


MARKED = "a # set by -s title=b"


@pytest.mark.parametrize(
    "given",
    [
        "title=Lot 7  # set by -s title=Lot 8",
        "title=Lot 7  # added by -s title=Lot 8",
        "title=Lot 7  # set by -s",
        'check."a  # set by -s b".upper=3 nm',
    ],
)
def test_what_looks_like_the_mark_of_an_override_is_refused(given):
    with pytest.raises(RecipeError, match=r'two blanks and "# set by -s" .* cannot stand in one'):
        parsed(PLAIN, given)


def test_every_override_that_is_done_is_listed():
    made = parsed(PLAIN, f"title={MARKED}")
    assert (made.title, made.overrides) == (MARKED, (f"title={MARKED}",))


DIGITS = "7" * 5000


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (f"title={DIGITS}", "the value cannot be read: .*digits.* a text goes in quotes$"),
        (f"step.2.order={DIGITS}", "the value cannot be read: "),
        ("step.form.fix=" + "[" * 3000, "the value cannot be read: it is nested too deeply"),
        ("step.form.fix=" + "[" * 3000 + "]" * 3000, "it is nested too deeply"),
        ("step.form.fix={ k = " + "[" * 40 + "]" * 40 + " }", "it is nested too deeply"),
        ("step.form.fix={ " + ".".join("a" * 3000) + " = 1 }", "it is nested too deeply"),
        ("step.2.order=0x" + "F" * 5000, "whole number .* more than 64 bits"),
        ("check.1.guard_factor=" + "9" * 400, "whole number .* more than 64 bits"),
        ("check.1.upper=" + "9" * 400, "whole number .* more than 64 bits"),
        ("check.1.upper=nan", "the value cannot be read: nan is not a number"),
        (f"step.{DIGITS}.form=plane", "there is no step 777"),
        ("step.form.fix." + ".".join("a" * 3000) + "=1", "the key has 3003 parts"),
    ],
)
def test_a_value_beyond_all_measure_is_refused(given, match):
    with pytest.raises(RecipeError, match=match) as caught:
        parsed(PLAIN, given)
    longest = 600  # letters, a message that a terminal shows
    assert len(str(caught.value)) < longest


@pytest.mark.parametrize("title", ["7" * 23, "x" * 5000, f'"{DIGITS}"'])
def test_a_long_text_is_a_text(title):
    made = parsed(PLAIN, f"title={title}")
    assert (made.title, made.overrides) == (title.strip('"'), (f"title={title}",))


@pytest.mark.parametrize("value", [DIGITS, "[" * 3000, "9" * 400])
def test_such_a_value_in_the_recipe_is_refused_too(value):
    with pytest.raises(RecipeError, match=r"^r.toml"):
        parsed(PLAIN.replace('"10 nm"', value), name="r.toml")
    marked = PLAIN.replace('"10 nm"', f'"10 nm"  # set by -s check.1.upper={value}')
    assert parsed(marked).overrides == ()


KINDS_OF_LIMITS = checks((None, "Sku")).replace('upper = "1 nm"', "lower = 1\nupper = 9\nU = 0")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            "check.Sku.upper=3 nm",
            (
                "recipe.toml, -s check.Sku.upper=3 nm: lower is a pure number, but upper is a length; "
                "both limits of a check are of one kind"
            ),
        ),
        (
            "check.Sku.lower=12",
            "recipe.toml, -s check.Sku.lower=12: the limits 12 ... 9 are not in order",
        ),
        (
            "check.Sku.upper=0.5",
            "recipe.toml, -s check.Sku.upper=0.5: the limits 1 ... 0.5 are not in order",
        ),
        (
            "check.Sku.guard_factor=-1",
            (
                "recipe.toml, -s check.Sku.guard_factor=-1: guard_factor must be finite and not "
                "negative, got -1"
            ),
        ),
        ("check.Sku.U=-1", "recipe.toml, -s check.Sku.U=-1: U must be finite and not negative"),
    ],
)
def test_limits_that_do_not_fit_are_told_by_the_override(given, message):
    with pytest.raises(RecipeError) as caught:
        parsed(KINDS_OF_LIMITS, given)
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("line", "new", "at"),
    [("U = 0", "U = -1", 10), ("upper = 9", "upper = 0.5", 9), ("U = 0", "guard_factor = -1", 10)],
)
def test_limits_that_do_not_fit_name_their_line(line, new, at):
    with pytest.raises(RecipeError, match=rf"^r.toml:{at}: "):
        parsed(KINDS_OF_LIMITS.replace(line, new), name="r.toml")


STEP = '[[step]]\nop = "rank"\nmachine = "{}"\nradius = "10 mm"\nform = "plane"\n'


@pytest.fixture
def two_folders(tmp_path):
    for name in ("base", "near"):
        (tmp_path / name).mkdir()
        for file in ("machine.toml", "other.toml"):
            (tmp_path / name / file).write_text(f"# {file} of {name}\n")
    (tmp_path / "base" / "identify.toml").write_text(
        "metrosep = 1\n" + STEP.format("machine.toml")
    )
    (tmp_path / "near" / "r.toml").write_text('metrosep = 1\nextends = "../base/identify.toml"\n')
    return tmp_path


@pytest.mark.parametrize(
    "value", ["machine.toml", "./machine.toml", "other.toml", "../base/other.toml", "nowhere.toml"]
)
def test_a_file_is_named_from_the_folder_of_the_recipe_that_is_run(two_folders, value):
    plain = ms.Recipe.load(two_folders / "near" / "r.toml")
    made = ms.Recipe.load(two_folders / "near" / "r.toml", overrides=[f"step.1.machine={value}"])
    assert plain.steps[0]["machine"] == "../base/machine.toml"
    assert made.steps[0]["machine"] == value
    assert made.overrides == (f"step.1.machine={value}",)
    # as if it stood in that recipe
    (two_folders / "near" / "hand.toml").write_text("metrosep = 1\n" + STEP.format(value))
    by_hand = ms.Recipe.load(two_folders / "near" / "hand.toml")
    assert recipe_hash(made) == recipe_hash(by_hand)
    assert recipe_hash(made) != recipe_hash(plain)
    again = ms.Recipe.parse(made.text, name=made.name, folder=made.folder)
    assert (again, again.overrides) == (made, made.overrides)


def test_a_file_that_stands_elsewhere_too_stays_that_of_its_folder(two_folders):
    (two_folders / "base" / "identify.toml").write_text(
        'metrosep = 1\n[input]\nx = "X"\nreadings = ["a"]\n[[step]]\nop = "dual_servo"\n'
        'quantity = "error"\nbefore = "machine.toml"\nafter = "other.toml"\n'
    )

    def files(*given):
        overrides = [f"step.1.{key}" for key in given]
        made = ms.Recipe.load(two_folders / "near" / "r.toml", overrides=overrides)
        again = ms.Recipe.parse(made.text, name=made.name, folder=made.folder)
        assert (again, again.overrides) == (made, tuple(overrides))
        return [made.steps[0][key] for key in ("before", "after")]

    assert files("before=machine.toml") == ["machine.toml", "../base/other.toml"]
    assert files("before=./other.toml") == ["./other.toml", "../base/other.toml"]
    assert files("before=other.toml", "after=other.toml") == ["other.toml", "other.toml"]
    assert files("before=other.toml", "after=machine.toml") == ["other.toml", "machine.toml"]
    with pytest.raises(RecipeError) as caught:
        files("before=other.toml")
    assert str(caught.value) == (
        "-s step.1.before=other.toml: identify.toml names the file other.toml of its own folder "
        "elsewhere, and the record could not tell the two apart; write ./other.toml for the one in "
        "the folder of r.toml, ../base/other.toml for the other"
    )
