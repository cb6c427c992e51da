"""The hash of what a recipe means: what leaves it and what moves it."""

from __future__ import annotations

import pytest

from metrosep.recipe import Recipe
from metrosep.recipe.outputs import recipe_hash

TEXT = """metrosep = 1
title = "STS"
[input]
files = ["*.x3p"]
[[step]]
op = "form"
form = "sphere: R=50 mm"
[[step]]
op = "filter"
cutoff = "25 um"
[[step]]
op = "parameters"
names = ["Sa"]
[[check]]
metric = "Sa"
upper = "6 nm"
U = "1 nm"
[view]
colour = "viridis"
"""


def hashed(text: str, **options) -> str:
    return recipe_hash(Recipe.parse(text, **options))


def changed(old: str, new: str) -> str:
    assert old in TEXT
    return hashed(TEXT.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('title = "STS"', 'title = "other"'),
        ('title = "STS"\n', ""),
        ("[[check]]", "# a comment\n\n[[check]]"),
        ('colour = "viridis"', "zoom = 3"),
        ('[view]\ncolour = "viridis"\n', ""),
        ("[view]", '[batch]\ntrend = ["Sa"]\n[view]'),
        ('cutoff = "25 um"', 'cutoff = "0.025 mm"'),
        ('cutoff = "25 um"', 'kind = "gaussian"\ncutoff = "25 um"'),
        ('cutoff = "25 um"', 'cutoff = "25 um"\nenabled = true'),
        ('upper = "6 nm"\nU = "1 nm"', 'U = "1 nm"\nupper = "6 nm"\nguard_factor = 1.0'),
        ('[[step]]\nop = "filter"', '[[step]]\nop = "outliers"\nenabled = false\n[[step]]\nop = "filter"'),
    ],
)  # fmt: skip
def test_what_changes_no_number_leaves_it(old, new):
    assert changed(old, new) == hashed(TEXT)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('cutoff = "25 um"', 'cutoff = "26 um"'),
        ('cutoff = "25 um"', 'cutoff = "25 um"\nband = "short"'),
        ('cutoff = "25 um"', 'cutoff = "25 um"\nenabled = false'),
        ('"sphere: R=50 mm"', '"sphere"'),
        ('names = ["Sa"]', 'names = ["Sa", "Sq"]'),
        ('upper = "6 nm"', 'lower = "6 nm"'),
        ('U = "1 nm"', 'U = "1.1 nm"'),
        ('U = "1 nm"', 'U = "1 nm"\nguard_factor = 0.83'),
        ("[view]", '[[output]]\nkind = "parts"\n[view]'),
        ('files = ["*.x3p"]', 'files = ["*.x3p"]\nunit = "um"'),
    ],
)
def test_what_changes_a_result_moves_it(old, new):
    assert changed(old, new) != hashed(TEXT)


def test_the_order_of_steps_counts():
    form, rest = TEXT.split("[[step]]")[1], TEXT.split("[[step]]")[2]
    assert hashed(TEXT.replace(form, "#").replace(rest, form).replace("#", rest)) != hashed(TEXT)


def test_files_that_a_step_names_count_by_their_content(tmp_path):
    text = 'metrosep = 1\n[[step]]\nop = "rank"\nmachine = "m.toml"\nradius = "10 mm"\nform = "plane"\n'
    (tmp_path / "m.toml").write_text("one")
    first = hashed(text, folder=tmp_path)
    (tmp_path / "m.toml").write_text("two")
    assert hashed(text, folder=tmp_path) != first


def test_it_is_64_digits_and_no_accident_of_the_process():
    assert len(hashed(TEXT)) == 64
    assert set(hashed(TEXT)) <= set("0123456789abcdef")


def test_extending_means_the_same_as_writing_it_out(tmp_path):
    (tmp_path / "base.toml").write_text(TEXT)
    (tmp_path / "r.toml").write_text('metrosep = 1\nextends = "base.toml"\n')
    assert recipe_hash(Recipe.load(tmp_path / "r.toml")) == hashed(TEXT)
