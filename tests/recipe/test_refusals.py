"""Recipes that cannot end well are refused before anything is read, computed or written."""

import pytest

from metrosep import Recipe
from metrosep.errors import RecipeError

GOOD = """metrosep = 1
[input]
x = { column = "x_mm", unit = "mm" }
z = "z_um"
[[step]]
op = "separate"
start = "0 mm"
length = "30 mm"
[[check]]
metric = "pv"
upper = "5 um"
[[output]]
kind = "table"
controller = "linuxcnc"
axis = "X"
spacing = "0.5 mm"
path = "x.comp"
compensates = "X"
"""
REPORT = '[[output]]\nkind = "report"\n'
OTHER = '[[output]]\nkind = "table"\ncontroller = "csv"\naxis = "X"\ncompensates = "X"\nspacing = "1 mm"\n'
POLYNOMIAL = '[[step]]\nop = "polynomial"\nquantity = "error"\n'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('upper = "5 um"', 'U = "1 nm"', r"r.toml:9: a decision needs a lower or an upper limit"),
        ('upper = "5 um"', 'upper = "1 um"\nlower = "2 um"', r"r.toml:11: the limits .*in order"),
        ('upper = "5 um"', 'upper = "1 um"\nU = "-1 nm"', r"r.toml:12: U = .*zero or more"),
        ('upper = "5 um"', 'upper = "1 um"\nguard_factor = nan', r"r.toml:12: .*finite number"),
        ('length = "30 mm"', 'length = "0 mm"', r"r.toml:8: length = .*positive"),
        ('length = "30 mm"', 'shortest = "-1 mm"', r"r.toml:8: shortest = .*positive"),
        ('length = "30 mm"', "false_discovery_rate = inf", r"r.toml:8: .*finite number"),
        ('spacing = "0.5 mm"', 'spacing = "0 mm"', r"r.toml:16: spacing = .*positive"),
        ('spacing = "0.5 mm"', "spacing = 1", r"r.toml:16: spacing = 1: .*at least 2 points"),
        (
            '"linuxcnc"',
            '"fanuk"',
            r"r.toml:14: unknown controller 'fanuk'; there are linuxcnc, csv",
        ),
        ('path = "x.comp"', 'path = "../x.comp"', r"r.toml:17: .*must be a plain file name"),
        ('path = "x.comp"', 'path = "a/x.comp"', r"r.toml:17: .*must be a plain file name"),
        ('path = "x.comp"', 'path = ""', r"r.toml:17: .*must be a plain file name"),
        ('path = "x.comp"', 'path = "result.json"', r"r.toml:17: two outputs would be called"),
        (
            'path = "x.comp"',
            'path = "x.comp"\nmachine = { strok = "1 um" }',
            r"r.toml:18: unknown machine limit 'strok'; known: max_points, stroke",
        ),
        (
            'path = "x.comp"',
            'path = "x.comp"\nmachine = { stroke = 5 }',
            r"r.toml:18: machine stroke = 5 needs a unit",
        ),
        (
            'path = "x.comp"',
            'path = "x.comp"\nmachine = { stroke = "5 s" }',
            r"r.toml:18: machine .*'s' is a time",
        ),
        ('op = "separate"', 'op = ["separate"]', r"r.toml:6: \[\[step\]\] needs op = one of"),
        (
            'x = { column = "x_mm", unit = "mm" }',
            'x = { column = "x_mm", unti = "mm" }',
            r'r.toml:3: .*unknown key "unti".*Did you mean "unit"',
        ),
        (
            'x = { column = "x_mm", unit = "mm" }',
            "x = { column = 3 }",
            r"r.toml:3: .*are texts, in quotes",
        ),
    ],
)
def test_a_wrong_part_names_its_line(old, new, message):
    assert old in GOOD
    with pytest.raises(RecipeError, match=message):
        Recipe.parse(GOOD.replace(old, new, 1), name="r.toml")


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        (REPORT + 'formats = ["docx"]\n', r"r.toml:21: no report format 'docx'.*there are .*html"),
        (
            REPORT + 'path = "result.json"\n',
            r"r.toml:21: two outputs would be called 'result.json'",
        ),
        (REPORT + 'path = "x.comp.json"\n', r"r.toml:21: two outputs would be called"),
        (OTHER + 'path = "X.comp"\n', r"r.toml:25: two outputs would be called 'X.comp'"),
        (POLYNOMIAL * 2, r"r.toml:23: a recipe fits at most one polynomial"),
        ('[[step]]\nop = "separate"\n', r"exactly one \[\[step\]\]"),
    ],
)
def test_parts_that_collide_are_refused(extra, message):
    with pytest.raises(RecipeError, match=message):
        Recipe.parse(GOOD + extra, name="r.toml")


def test_what_a_controller_lacks_is_asked_for_beside_what_was_given():
    """Written as it is printed, with the dots filled in, it is enough."""
    old = 'controller = "linuxcnc"'
    given = 'controller = "sinumerik-cec"\nmachine = { input_axis = "AX1", table_index = 3 }'
    text = GOOD.replace(old, given).replace("x.comp", "x.mpf")
    assert old in GOOD
    with pytest.raises(RecipeError) as refused:
        Recipe.parse(text, name="r.toml")
    wanted = str(refused.value).partition("write ")[2]
    assert wanted.startswith('machine = { input_axis = "AX1", table_index = 3, ')
    line = next(t for t in text.splitlines() if t.startswith("machine = "))
    Recipe.parse(text.replace(line, wanted.replace('"..."', '"AX2"')), name="r.toml")


def test_a_check_of_the_dry_run_needs_a_table():
    text = GOOD[: GOOD.index("[[output]]")].replace('"pv"', '"after_rms"')

    with pytest.raises(RecipeError, match=r'r.toml:10: metric "after_rms".*kind "table"'):
        Recipe.parse(text, name="r.toml")


def test_lines_are_right_behind_texts_comments_and_odd_headers():
    text = GOOD.replace(
        "metrosep = 1\n", 'metrosep = 1\ntitle = """\n[[step]]\nstrat = 1\n"""\n'
    ).replace('[[step]]\nop = "separate"', '  [[ step ]]  # main\n  op = "separate"')
    text = text.replace('start = "0 mm"', 'strat = "0 mm"')

    with pytest.raises(RecipeError, match=r'r.toml:11: unknown key "strat"') as caught:
        Recipe.parse(text, name="r.toml")
    assert caught.value.line == 11
    assert text.splitlines()[10].startswith("strat")
