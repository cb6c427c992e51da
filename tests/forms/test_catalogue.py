"""Forms from text."""

import numpy as np
import pytest

from metrosep.core.errors import DataError, UnitError
from metrosep.forms.catalogue import form_from_text, form_names, parameter_value

EXACT = 1e-15


@pytest.mark.parametrize("name", form_names())
def test_every_name_makes_a_form_or_says_what_it_needs(name):
    needs = {
        "polynomial": ": degree=2",
        "qforbes": ": radius=10 mm",
        "expression": ": a*x**2; a",
    }

    form = form_from_text(name + needs.get(name, ""))

    assert form.name.replace(" ", "_") in (name, "sine_grid", "Q asphere", form.name)
    if name in needs:
        with pytest.raises(DataError):
            form_from_text(name)


def test_values_carry_units():
    form = form_from_text("conic: R=-50 mm, k=-1.2")

    assert form.parameters == {"R": -0.05, "k": -1.2}


def test_what_is_not_given_is_not_known():
    assert form_from_text("conic: k=0").parameters == {"R": None, "k": 0.0}
    assert form_from_text("Sine-Grid: wavelength=100 um").parameters["amplitude"] is None


def test_coefficients_of_an_asphere():
    form = form_from_text("asphere: R=50 mm, k=-1, a4=1.5e3 SI, terms=6")

    assert form.parameters["a4"] == 1.5e3
    assert form.parameters["a6"] is None


@pytest.mark.parametrize(
    "a4",
    [
        "A4=2e-7 /mm^3",
        "a4=2e-7 mm^-3",
        "a4=2E-7 1/mm3",
        "a4=200 SI",
        "a4=2e-7 /mm³",
        "a4=2e-7 mm⁻³",
        "a4=2e-7 1/mm³",
        "a4=2e−7 mm−3",
        "a4=2e−7 mm^−3",
    ],
)
def test_coefficients_of_an_asphere_have_the_unit_of_the_drawing(a4):
    form = form_from_text(f"asphere: R=40 mm, k=-1, {a4}, a6=-3e-10 /mm^5, a2=1e-3 /mm")

    r = 7.5  # mm; a paraboloid and the terms of the drawing
    sag = r**2 / 80.0 + 1e-3 * r**2 + 2e-7 * r**4 - 3e-10 * r**6
    assert form(r * 1e-3, 0.0) == pytest.approx(sag * 1e-3, abs=1e-17)  # rounding of float64


def test_a_typeset_minus_is_read_in_every_value():
    form = form_from_text("conic: R=−50 mm, k=−1.5")
    assert form.parameters == {**form.parameters, "R": -0.05, "k": -1.5}
    form = form_from_text("expression: a*x − b; a=−2, b=−3e−3")
    assert form(1.0, 0.0) == pytest.approx(-2.0 + 3e-3, abs=1e-15)  # rounding of float64
    assert form_from_text("asphere: a4=−200 SI, k=−1").parameters["a4"] == -200.0
    assert parameter_value("−1.2", "1", "k") == -1.2  # of a recipe: at = { k = "−1.2" }


def test_expression_keeps_its_formula():
    form = form_from_text("expression: a*x**2 + sin(y/L); a=2, L=1e-3")

    np.testing.assert_allclose(form(1e-3, 0.0), 2e-6, rtol=EXACT, atol=0)


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        ("cone", DataError, "there is no form 'cone'"),
        ("conic: R=50", UnitError, "unit"),
        ("conic: R=50 kg", UnitError, "kg"),
        ("conic: R", DataError, "key=value"),
        ("conic: R=1 mm, R=2 mm", DataError, "twice"),
        ("conic: Q=3", DataError, "conic has no Q"),
        ("plane: tilt=1", DataError, "no parameters"),
        ("polynomial: degree=two", DataError, "degree is 'two'"),
        ("zernike: order=latin", DataError, "order"),
        ("asphere: a4=3 mm", UnitError, r"such as 2e-7 /mm\^3.* only with norm_radius="),
        ("asphere: a4=2 e-7 /mm^3", UnitError, r"such as 2e-7 /mm\^3, without blanks"),
        (
            "asphere: a4=2e-7 mm³",
            UnitError,
            r"a number per length to the power 3, such as 2e-7 /mm\^3",
        ),
        *[
            (f"asphere: a4={number}", UnitError, r"write .* such as 2e-7 /mm\^3")
            for number in ("2⁴ /mm^3", "2⁴ SI", "2e⁻7 /mm³", "⁻2 mm⁻³", "2·10⁻⁷ mm⁻³", "2 /mm3³")
        ],
        ("conic: R=5² mm", UnitError, "R of conic"),
        ("conic: k=⁻1", UnitError, "a pure number is needed"),
        ("asphere: a4=2*10^-7 /mm^3", UnitError, r"such as 2e-7 /mm\^3"),
        ("asphere: a4=2,0e-7 /mm^3", DataError, "numbers have a decimal point"),
        ("asphere: terms=4,6", DataError, "terms=4 6 8"),
        ("asphere: a1=2", DataError, "power of an asphere is an integer from 2 to 40, got 1"),
        ("asphere: R=50 mm; a4=2e-7 /mm^3", DataError, "a comma stands between values"),
        ("asphere: a4=2e-7", UnitError, r"such as 2e-7 /mm\^3, or SI"),
        ("asphere: a4=2e-7 /mm^4", UnitError, "to the power -3, not -4"),
        ("asphere: coefficients=2", DataError, "such as a4=2e-7 /mm"),
        ("asphere: a4=1 SI, A4=2 SI", DataError, "given twice"),
        ("asphere: a4=1 SI, a04=2 SI", DataError, "given twice"),
        ("asphere: terms=4 6, a4=2 SI", DataError, "given twice"),
        ("asphere: terms=4 a4", DataError, "given twice"),
        ("expression: a*x; a=", DataError, "a="),
    ],
)
def test_wrong_text_is_one_clear_sentence(text, error, match):
    with pytest.raises(error, match=match):
        form_from_text(text)


def test_a_value_in_an_odd_unit_says_si():
    assert parameter_value("3 SI", "m^-3", "a4") == 3.0
    with pytest.raises(UnitError, match="3 SI"):
        parameter_value("3", "m^-3", "a4")
