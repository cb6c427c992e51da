"""Limits and U in messages stand as the recipe has them, and numbers are those that were typed."""

import pytest

from metrosep.core.errors import RecipeError, UnitError
from metrosep.core.units import parse_quantity
from metrosep.recipe import Recipe

TEXT = """metrosep = 1
[input]
files = ["*.x3p"]
[[step]]
op = "form"
form = "plane"
[[step]]
op = "parameters"
names = ["Sq"]
[[check]]
metric = "Sq"
"""


@pytest.mark.parametrize(
    ("check", "wanted"),
    [
        ('lower = "14 nm"\nupper = "12 nm"\nU = "0.3 nm"', "the limits 14 nm ... 12 nm are not"),
        ('upper = "12 nm"\nU = "-0.3 nm"', "U must be finite and not negative, got -300 pm"),
        ('lower = "0.014 um"\nupper = "12 nm"\nU = "0.3 nm"', "the limits 14 nm ... 12 nm are"),
    ],
)
def test_a_message_has_units(check, wanted, tmp_path):
    with pytest.raises(RecipeError) as error:
        Recipe.parse(TEXT + check).run(tmp_path / "a.x3p")
    assert wanted in str(error.value)


@pytest.mark.parametrize(
    ("text", "dimension", "wanted"),
    [
        ("12 nm", "length", 12e-9),
        ("14 nm", "length", 14e-9),
        ("-1.4e1 nm", "length", -14e-9),
        ("0.3 um", "length", 0.3e-6),
        (".7 mm", "length", 0.7e-3),
        ("5. cm", "length", 5e-2),
        ("7 angstrom", "length", 7e-10),
        ("3 m", "length", 3.0),
        ("9.3 urad", "angle", 9.3e-6),
        ("1.1 ms", "time", 1.1e-3),
        ("7 kHz", "frequency", 7000.0),
        ("0.7 mm/s", "speed", 0.7e-3),
        ("33 mV", "voltage", 33e-3),
        ("7 %", "number", 0.07),
        ("1 in", "length", 0.0254),
    ],
)
def test_a_quantity_is_the_float_nearest_to_what_was_typed(text, dimension, wanted):
    assert parse_quantity(text, dimension=dimension) == wanted


def test_every_decimal_in_nm_is_exact():
    for n in range(1, 3000):
        assert parse_quantity(f"{n / 10} nm", dimension="length") == float(f"{n}e-10")


@pytest.mark.parametrize("exponent", ["400", "9" * 5000])
def test_a_number_without_end_is_refused(exponent):
    with pytest.raises(UnitError):
        parse_quantity(f"1e{exponent} nm", dimension="length")
    assert parse_quantity(f"1e-{exponent} nm", dimension="length") == 0.0


def test_other_units_are_multiplied():
    assert parse_quantity("60 mm/min", dimension="speed") == 60.0 * (1e-3 / 60.0)
    assert parse_quantity("2 in", dimension="length") == 2.0 * 0.0254
