"""A recipe that builds on another: whose keys win, whose line is named, and that it stands alone."""

from __future__ import annotations

import pytest

from metrosep.core.errors import RecipeError
from metrosep.recipe import Recipe
from metrosep.recipe.outputs import recipe_hash
from metrosep.recipe.written.extends import split_record

BASE = """metrosep = 1
title = "base"
[input]
files = ["*.x3p"]
unit = "um"
[batch]
trend = ["Sa"]
on_error = "stop"
[[step]]
op = "form"
form = "sphere"
[[step]]
op = "parameters"
names = ["Sa"]
[[check]]
metric = "Sa"
upper = "6 nm"
U = "1 nm"
"""


@pytest.fixture
def home(tmp_path):
    (tmp_path / "base.toml").write_text(BASE)
    return tmp_path


def load(home, text, name="batch.toml"):
    (home / name).write_text(text)
    return Recipe.load(home / name)


def test_tables_are_merged_and_lists_replaced_whole(home):
    recipe = load(
        home,
        """metrosep = 1
extends = "base.toml"
[input]
unit = "nm"
[batch]
on_error = "continue"
[[step]]
op = "form"
form = "plane"
""",
    )
    assert recipe.title == "base"
    assert dict(recipe.input) == {"files": ["*.x3p"], "unit": "nm"}
    assert [s["op"] for s in recipe.steps] == ["form"]
    assert recipe.steps[0]["form"] == "plane"
    assert [c["metric"] for c in recipe.checks] == ["Sa"]
    assert recipe.batch_options["trend"] == ("Sa",)
    assert recipe.batch_options["on_error"] == "continue"


def test_a_chain_of_recipes(home):
    (home / "middle.toml").write_text('metrosep = 1\nextends = "base.toml"\ntitle = "middle"\n')
    recipe = load(home, 'metrosep = 1\nextends = "middle.toml"\n[input]\nunit = "mm"\n')
    assert (recipe.title, recipe.input["unit"]) == ("middle", "mm")
    assert [name for name, _ in recipe.bases] == ["middle.toml", "base.toml"]


def test_the_text_of_a_result_stands_alone(home):
    recipe = load(home, 'metrosep = 1\nextends = "base.toml"\ntitle = "mine"\n')
    (home / "base.toml").unlink()
    again = Recipe.parse(recipe.text, name="batch.toml", folder=home)
    assert again == recipe
    assert split_record(recipe.text)[1] == (("base.toml", BASE),)


def test_the_hash_of_the_text_covers_the_base(home):
    text = 'metrosep = 1\nextends = "base.toml"\n'
    before = load(home, text).sha256
    (home / "base.toml").write_text(BASE.replace("6 nm", "7 nm"))
    assert load(home, text).sha256 != before


@pytest.mark.parametrize(
    ("own", "where"),
    [
        ('metrosep = 1\nextends = "base.toml"\n[input]\nunti = "nm"\n', r"batch\.toml:4: .*unti"),
        ('metrosep = 1\nextends = "base.toml"\n[[step]]\nop = "from"\n', r"batch\.toml:4: "),
        ('metrosep = 1\nextends = "base.toml"\n[[check]]\nmetric = "Sa"\n', r"batch\.toml:3: "),
        ('metrosep = 1\nextends = "nowhere.toml"\n', r"batch\.toml:2: .*cannot be read"),
        ('metrosep = 1\nextends = "batch.toml"\n', r"batch\.toml:2: .*in a circle"),
        ("metrosep = 1\nextends = 3\n", r"batch\.toml:2: "),
        ('metrosep = 1\nextnds = "base.toml"\n', r'Did you mean "extends"'),
    ],
)
def test_errors_name_the_own_line(home, own, where):
    with pytest.raises(RecipeError, match=where):
        load(home, own)


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ('unit = "um"', 'unti = "um"', r"base\.toml:5: .*unti"),
        ('form = "sphere"', 'frm = "sphere"', r"base\.toml:11: .*frm"),
        ('upper = "6 nm"', 'upper = "6 parsecs"', r"base\.toml:17: .*parsecs"),
        ('trend = ["Sa"]', 'trnd = ["Sa"]', r"base\.toml:7: .*trnd"),
        ("[input]", "[input", r"base\.toml: not valid TOML"),
    ],
)
def test_errors_in_the_base_name_its_line(home, old, new, where):
    (home / "base.toml").write_text(BASE.replace(old, new))
    with pytest.raises(RecipeError, match=where):
        load(home, 'metrosep = 1\nextends = "base.toml"\ntitle = "mine"\n')


def test_going_round_is_refused(home):
    (home / "a.toml").write_text('metrosep = 1\nextends = "b.toml"\n')
    with pytest.raises(RecipeError, match=r"a\.toml:2: .*in a circle"):
        load(home, 'metrosep = 1\nextends = "a.toml"\n', name="b.toml")


def test_files_of_steps_are_found_beside_the_recipe_that_names_them(home):
    (home / "lib").mkdir()
    (home / "lib" / "m.toml").write_text("x")
    (home / "lib" / "rank.toml").write_text(
        'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "m.toml"\nradius = "10 mm"\nform = "plane"\n'
    )
    recipe = load(home, 'metrosep = 1\nextends = "lib/rank.toml"\n')
    assert recipe.steps[0]["machine"] == "lib/m.toml"


RANK = """metrosep = 1
[[step]]
op = "rank"
machine = "{machine}"
radius = "10 mm"
form = "plane"
"""


@pytest.mark.parametrize(
    ("base", "machine", "expected"),
    [
        ("lib/rank.toml", "m.toml", "lib/m.toml"),
        ("lib/rank.toml", "../m.toml", "m.toml"),
        ("../rank.toml", "own/m.toml", "m.toml"),
        ("lib/rank.toml", "nowhere.toml", "nowhere.toml"),
    ],
)
def test_the_record_of_a_base_in_another_folder_names_the_same_file(
    tmp_path, base, machine, expected
):
    own = tmp_path / "own"
    (own / "lib").mkdir(parents=True)
    for folder, text in ((own, "own"), (own / "lib", "lib")):
        (folder / "m.toml").write_text(f"# of {text}\n")
    (own / base).write_text(RANK.format(machine=machine))

    recipe = load(own, f'metrosep = 1\nextends = "{base}"\n')
    again = Recipe.parse(recipe.text, name=recipe.name, folder=own)

    assert recipe.steps[0]["machine"] == expected
    assert again == recipe
    assert recipe_hash(again) == recipe_hash(recipe)
    assert again.recorded == recipe.recorded
    elsewhere = Recipe.parse(recipe.text, name=recipe.name, folder=tmp_path / "nowhere")
    assert elsewhere.steps == recipe.steps
    assert str(tmp_path) not in recipe.text


def test_a_chain_over_three_folders_keeps_the_file_of_each(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "m.toml").write_text("# m\n")
    (tmp_path / "a" / "b" / "rank.toml").write_text(RANK.format(machine="m.toml"))
    (tmp_path / "a" / "mid.toml").write_text('metrosep = 1\nextends = "b/rank.toml"\n')
    recipe = load(tmp_path, 'metrosep = 1\nextends = "a/mid.toml"\n')
    assert recipe.steps[0]["machine"] == "a/b/m.toml"
    again = Recipe.parse(recipe.text, name=recipe.name, folder=tmp_path)
    assert (again, recipe_hash(again)) == (recipe, recipe_hash(recipe))


@pytest.mark.parametrize(
    "old_new",
    [
        ('"base"', '"ba\u2028se"'),
        ('"base"', '"ba\u0085se"'),
        ('"base"', '"ba\u2029se"'),
        ('title = "base"', "title = '''rough  \nness \n\n  \n\t\n'''"),
        ('title = "base"', "title = '''\n#: name\n#| line\n#@ seen\n#> file\n'''"),
        ("on_error", "pattern = '''\n(?P<a>.*)  \n'''\non_error"),
        ("\n", "\r\n"),
        ('U = "1 nm"\n', 'U = "1 nm"'),
        ('U = "1 nm"\n', 'U = "1 nm"\n\n\n# end  \n \n'),
    ],
)
def test_the_record_keeps_every_letter(home, old_new):
    text = BASE.replace(*old_new)
    assert text != BASE
    (home / "base.toml").write_bytes(text.encode("utf-8"))
    recipe = load(home, 'metrosep = 1\nextends = "base.toml"\n')

    again = Recipe.parse(recipe.text, name=recipe.name, folder=home)

    assert again == recipe
    assert recipe_hash(again) == recipe_hash(recipe)
    assert again.recorded == recipe.recorded
    kept = text.replace("\r\n", "\n").removesuffix("\n") + "\n"
    assert split_record(recipe.text)[1] == (("base.toml", kept),)


def test_the_record_stays_where_the_own_text_ends_in_a_view(home):
    recipe = load(home, 'metrosep = 1\nextends = "base.toml"\n[view]\ntab = "report"\n')
    again = Recipe.parse(recipe.recorded["text"], name=recipe.name, folder=home / "nowhere")
    assert recipe_hash(again) == recipe_hash(recipe)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("pattern = '(?P<a'", r"r\.toml:3: pattern is not a regular expression"),
        ("key = ['part']", r"r\.toml:3: key names groups of a pattern"),
        ("pattern = '(?P<a>.*)'\nkey = ['b']", r'r\.toml:4: .*no group "b"; it has a'),
        ("pattern = '(?P<a>.*)'\nkey = []", r"r\.toml:4: key is empty"),
        ("index = ['csv', 'csv']", r'index names "csv" twice'),
        ("on_error = 'stpo'", 'Did you mean "stop"'),
        ("trend = ['']", "trend holds an empty text"),
        ("patern = '.*'", 'Did you mean "pattern"'),
    ],
)
def test_a_wrong_batch_table_names_its_line(table, message):
    text = f"metrosep = 1\n[batch]\n{table}\n[input]\n[[step]]\nop = 'parameters'\n"
    with pytest.raises(RecipeError, match=message):
        Recipe.parse(text, name="r.toml")
