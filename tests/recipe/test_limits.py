"""Limits know their dimension: one of another kind than the value is refused with file and line."""

import copy
import json
import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import RecipeError, UnitError
from metrosep.core.limits import Limit, dimension_of, limit_problem, parse_limit

ROUNDING = 1e-14
"""Relative, of a product of a number and a unit."""

RECIPE = """metrosep = 1
[input]
files = ["a.x3p"]
[[step]]
op = "parameters"
names = ["Sa", "Sku"]
[[check]]
metric = "{metric}"
{limits}
"""


@pytest.fixture
def part(tmp_path):
    z = 1e-8 * np.random.default_rng(5).standard_normal((40, 50))
    ms.write(ms.Surface(z, 1e-6, 2e-6), tmp_path / "a.x3p")
    return tmp_path


def judge(folder, limits, metric="Sa"):
    text = RECIPE.format(metric=metric, limits=limits)
    return ms.Recipe.parse(text, folder=folder).run(None)


@pytest.mark.parametrize(
    ("limits", "match"),
    [
        (
            'upper = "10 urad"\nU = "0.3 nm"',
            r"recipe.toml:9.*upper is an angle, but Sa is a length",
        ),
        ('upper = 10\nU = "0.3 nm"', r"recipe.toml:9.*upper is a pure number"),
        ('lower = -10\nupper = "10 nm"\nU = "0.3 nm"', r"recipe.toml:9.*lower is a pure number"),
        ('upper = "10 nm"\nU = 0.3', r"recipe.toml:10.*U is a pure number"),
        ('upper = "10 nm"\nU = "0.3 urad"', r"recipe.toml:10.*U is an angle"),
        ('upper = "10 nm^2"\nU = "1 nm"', r"recipe.toml:9.*upper is in m\^2"),
        ('upper = "10 s"\nU = "1 nm"', r"recipe.toml:9.*upper is a time"),
        ('upper = "10 nm"\nU = "5 %"', r"recipe.toml:10.*U is a pure number, but Sa is a length"),
    ],
)
def test_a_limit_of_another_kind_is_refused(part, limits, match):
    with pytest.raises(RecipeError, match=match):
        judge(part, limits)


def test_a_length_is_no_limit_of_a_number(part):
    with pytest.raises(RecipeError, match=r":9.*upper is a length, but Sku is a pure number"):
        judge(part, 'upper = "3 nm"\nU = 0.1', "Sku")
    with pytest.raises(RecipeError, match=r":10.*U is a length"):
        judge(part, 'upper = 3\nU = "1 nm"', "Sku")


@pytest.mark.parametrize(
    ("metric", "limits", "verdict"),
    [
        ("Sa", 'upper = "20 nm"\nU = "0.3 nm"', "accept"),
        ("Sa", 'upper = "0.000001 mm"\nU = "0.3 nm"', "reject"),
        ("Sa", 'lower = 0\nupper = "20 nm"\nU = 0', "accept"),
        ("Sku", "upper = 4\nU = 0.1", "accept"),
        ("Sku", "lower = 4.5\nU = 0.1", "reject"),
    ],
)
def test_a_limit_of_the_same_kind_is_judged(part, metric, limits, verdict):
    result = judge(part, limits, metric)
    assert result.verdict == verdict
    stored = json.loads(result.to_json())["characteristics"][0]
    assert all(type(stored[k]) in (float, type(None)) for k in ("lower", "upper", "U"))


@pytest.mark.parametrize(
    ("text", "value", "dimension"),
    [
        ("120 nm", 1.2e-7, "m"),
        ("-2 arcsec", -2 * np.pi / 648e3, "rad"),
        ("3 mm^2", 3e-6, "m^2"),
        ("3 mm2", 3e-6, "m^2"),
        ("5 1/mm^2", 5e6, "m^-2"),
        ("4 nm/s", 4e-9, "m s^-1"),
        ("60 mm/min", 1e-3, "m s^-1"),
        ("5 mm^3/m^2", 5e-9, "m"),
        ("2 ms", 2e-3, "s"),
        ("2 kHz", 2e3, "s^-1"),
    ],
)
def test_units_of_limits(text, value, dimension):
    found = parse_limit(text)
    assert abs(found - value) <= ROUNDING * abs(value)
    assert found.dimension == dimension


@pytest.mark.parametrize(
    "text", ["5", "nm", "5 foo", "nan nm", "inf nm", "5 nm/s/s", "", "1e999 mm^2"]
)
def test_what_is_no_limit_is_refused(text):
    with pytest.raises(UnitError):
        parse_limit(text)


def test_a_limit_is_a_float_and_survives_copies():
    limit = parse_limit("120 nm")
    assert json.dumps(limit) == json.dumps(float(limit))
    for again in (copy.deepcopy(limit), pickle.loads(pickle.dumps(limit))):  # noqa: S301
        assert isinstance(again, Limit)
        assert (again, again.dimension) == (limit, "m")


def test_a_plain_number_belongs_to_pure_numbers_only():
    assert limit_problem("upper", 0.3, "x", "1") is None
    assert limit_problem("upper", 0.0, "x", "m") is None
    assert limit_problem("upper", 0.3, "x", "m") is not None
    assert limit_problem("upper", 0.3, "x", "thing") is None  # a unit that is not known
    assert "'thing'" in limit_problem("upper", parse_limit("3 nm"), "x", "thing")
    assert dimension_of("m/m") == ""


GAUGE = """metrosep = 1
[input]
files = ["study.csv"]
part = "part"
value = "sz_nm"
[[step]]
op = "gauge_study"
tolerance = {tolerance}
"""


def test_the_tolerance_of_a_gauge_study_has_the_unit_of_its_readings(tmp_path):
    rows = [f"P{i},{300 + 10 * i + j * j}" for i in range(5) for j in range(3)]
    (tmp_path / "study.csv").write_text("\n".join(["part,sz_nm", *rows]) + "\n")
    for tolerance in ('"500 urad"', "500"):
        with pytest.raises(RecipeError, match=r"recipe.toml:8.*tolerance is a.*length"):
            ms.Recipe.parse(GAUGE.format(tolerance=tolerance), folder=tmp_path).run(None)
    found = ms.Recipe.parse(GAUGE.format(tolerance='"500 nm"'), folder=tmp_path).run(None)
    assert 0.0 < found.produced.share_of_tolerance < 1.0


def test_a_share_is_a_limit_of_a_pure_number_and_of_nothing_else():
    assert parse_limit("5 %") == 0.05
    assert parse_limit("5 %").dimension == ""
