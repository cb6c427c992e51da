"""A limit of another kind than its value is refused before anything is read, where the steps tell."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.cli.files import recipe_errors
from metrosep.core.errors import ReadError, RecipeError
from metrosep.parameters.symbol_units import unit_of_symbol
from metrosep.recipe.preflight import limit_errors

RECIPE = """metrosep = 1
[input]
files = ["part.x3p"]
[[step]]
op = "form"
form = "{form}"
[[step]]
op = "parameters"
names = ["{name}"]
[[check]]
metric = "{metric}"
{limits}
"""


def text_of(metric, limits, form="sphere"):
    symbol = metric.partition("#")[0]
    name = symbol if unit_of_symbol(symbol) else "Sku"
    text = RECIPE.format(metric=metric, limits=limits, form=form, name=name)
    twice = f'op = "parameters"\nnames = ["{name}"]\n[[step]]\n'
    return (
        text.replace('op = "parameters"', twice + 'op = "parameters"') if "#" in metric else text
    )


WRONG = [
    ("Sku", 'upper = "3 nm"\nU = 0.1', r"^r.toml:12: upper is a length, but Sku is a pure number"),
    ("Sku", 'upper = 3\nU = "1 nm"', r"^r.toml:13: U is a length"),
    ("Sa", "upper = 3\nU = 0", r"^r.toml:12: upper is a pure number, but Sa is a length"),
    ("Sa", 'lower = "-3 urad"\nupper = "3 nm"', r"^r.toml:12: lower is an angle, but Sa"),
    ("Sa#2", 'upper = "3 urad"', r"^r.toml:15: upper is an angle, but Sa#2"),
    ("Spd", 'upper = "3 nm"', r"upper is a length, but Spd is in 1/m\^2"),
    ("PVr", "upper = 3", r"but PVr is a length"),
    ("FLTt", "upper = 3", r"but FLTt is a length"),
    ("Rku", 'upper = "3 nm"', r"but Rku is a pure number"),
    ("RSm", "upper = 3", r"but RSm is a length"),
    ("residual.pv", "upper = 3", r"but residual.pv is a length"),
    ("R", "upper = 3", r"but R is a length"),
    ("tilt_x", 'upper = "3 nm"', r"upper is a length, but tilt_x is an angle"),
]


@pytest.mark.parametrize(("metric", "limits", "match"), WRONG)
def test_it_is_refused_without_data(tmp_path, metric, limits, match):
    text = text_of(metric, limits)
    (error,) = recipe_errors(text, name="r.toml", folder=tmp_path)
    recipe = ms.Recipe.parse(text, name="r.toml", folder=tmp_path)  # may be edited further
    with pytest.raises(RecipeError, match=match) as caught:
        recipe.run(tmp_path / "missing.x3p", out=tmp_path / "out")
    assert str(caught.value) == error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("metric", "limits", "form"),
    [
        ("Sku", "upper = 3\nU = 0.1", "sphere"),
        ("Sa", 'upper = "3 nm"\nU = 0', "sphere"),
        ("k", "upper = 3\nU = 0", "conic"),
    ],
)
def test_what_may_be_right_goes_on_to_the_data(tmp_path, metric, limits, form):
    text = text_of(metric, limits, form)
    assert recipe_errors(text, name="r.toml", folder=tmp_path) == []
    with pytest.raises(ReadError):
        ms.Recipe.parse(text, folder=tmp_path).run(tmp_path / "missing.x3p")


def test_a_step_that_is_switched_off_makes_nothing():
    text = text_of("R", "upper = 3").replace('form = "sphere"', 'form = "sphere"\nenabled = false')
    (error,) = limit_errors(ms.Recipe.parse(text))
    assert 'metric = "R" is made by no step' in str(error)


def test_each_limit_is_told(tmp_path):
    text = text_of("Sku", 'lower = "1 nm"\nupper = "3 nm"\nU = "1 nm"')
    text += '[[check]]\nmetric = "residual.pv"\nupper = 3\n'
    lines = [e.line for e in limit_errors(ms.Recipe.parse(text))]
    assert lines == [12, 13, 14, 17]


def test_units_of_symbols_are_those_of_the_values():
    """Every parameter that is evaluated has the unit that is known without data."""
    rng = np.random.default_rng(11)
    surface = ms.Surface(1e-8 * rng.standard_normal((60, 70)), 1e-6, 2e-6)
    profile = ms.Profile(np.arange(4000) * 1e-6, 1e-8 * rng.standard_normal(4000))
    both = ("ISO 21920-2:2021", "ISO 4287:1997")
    cases = [(surface, {"names": ["all"]}), (surface, {"names": ["FLTt", "PVr", "PVq", "PV20"]})]
    cases += [
        (profile, {"names": ["all"], "kind": kind, "edition": edition})
        for kind in ("P", "W", "R")
        for edition in both
    ]
    cases += [(profile, {"names": ["STRt", "STRp", "STRv", "STRq"]})]
    seen = set()
    for obj, options in cases:
        from metrosep.recipe.pipeline import run_step

        found = run_step(obj, {"op": "parameters", **options}).found
        assert {s: unit_of_symbol(s) for s in found} == {s: q.unit for s, q in found.items()}
        seen |= set(found)
    assert len(seen) > 100
    assert unit_of_symbol("STR") is None


@pytest.mark.parametrize(
    "form", ["sphere", "cylinder", "conic", "polynomial: degree=3", "zernike: terms=9", "plane"]
)
def test_units_of_forms_are_those_of_the_fit(form):
    from metrosep.recipe.pipeline import run_step
    from metrosep.recipe.pipeline_checks import known_unit

    y, x = np.mgrid[0:41, 0:41] * 1e-4
    z = ((x - 2e-3) ** 2 + (y - 2.1e-3) ** 2) / 0.1 + 1e-9 * np.cos(x * 5e3)
    step = {"op": "form", "form": form}
    found = run_step(ms.Surface(z, 1e-4, 1e-4), step).found
    assert len(found) > 2
    assert {k: known_unit([step], k) for k in found} == {k: q.unit for k, q in found.items()}
