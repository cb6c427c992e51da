"""Recipes as editors save them: a byte order mark in front is not part of the text."""

import pytest

import metrosep as ms
from metrosep.cli.files import recipe_errors
from metrosep.core.errors import RecipeError

RECIPE = 'metrosep = 1\n[input]\n[[step]]\nop = "form"\nform = "plane"\n'
MARK = b"\xef\xbb\xbf"


def saved(path, text, *, crlf=False):
    path.write_bytes(MARK + text.replace("\n", "\r\n" if crlf else "\n").encode())
    return path


@pytest.mark.parametrize("crlf", [False, True])
def test_a_recipe_with_a_byte_order_mark_is_the_one_without(tmp_path, crlf):
    made = ms.Recipe.load(saved(tmp_path / "r.toml", RECIPE, crlf=crlf))
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "r.toml").write_text(RECIPE)
    assert made.recorded == ms.Recipe.load(tmp_path / "plain" / "r.toml").recorded
    assert made.text == RECIPE
    assert ms.Recipe.parse("\ufeff" + RECIPE).text == RECIPE


@pytest.mark.parametrize("crlf", [False, True])
def test_the_line_of_a_mistake_is_that_of_the_file(tmp_path, crlf):
    file = saved(tmp_path / "r.toml", RECIPE.replace("form =", "fom ="), crlf=crlf)
    with pytest.raises(RecipeError, match=r"^r.toml:5: unknown key") as caught:
        ms.Recipe.load(file)
    assert caught.value.line == 5
    with pytest.raises(RecipeError, match=r"^r.toml:1: unknown key \"metrosp\""):
        ms.Recipe.load(saved(file, RECIPE.replace("metrosep", "metrosp")))
    with pytest.raises(RecipeError, match=r"not valid TOML.*line 2"):
        ms.Recipe.load(saved(file, "metrosep = 1\n[input\n"))
    errors = recipe_errors("\ufeff" + RECIPE.replace("plane", "x"), name="r.toml", folder=tmp_path)
    assert errors[0].startswith("r.toml:5: ")


def test_a_recipe_that_is_extended_may_have_one_too(tmp_path):
    saved(tmp_path / "base.toml", RECIPE)
    near = saved(tmp_path / "near.toml", 'metrosep = 1\nextends = "base.toml"\n')
    made = ms.Recipe.load(near)
    assert "\ufeff" not in made.text
    assert ms.Recipe.parse(made.text).steps == made.steps
    saved(tmp_path / "base.toml", RECIPE.replace("form =", "fom ="))
    with pytest.raises(RecipeError, match=r"^base.toml:5: unknown key"):
        ms.Recipe.load(near)


def test_a_mark_elsewhere_is_still_refused(tmp_path):
    file = tmp_path / "r.toml"
    file.write_bytes(RECIPE.encode() + MARK)
    with pytest.raises(RecipeError, match="not valid TOML"):
        ms.Recipe.load(file)
