"""A formula as text: exact derivatives of every part, and no way to run anything."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms.expression import Expression

STEP = 1e-30
RELATIVE = 1e-14
"""Two operations of rounding."""

PARTS = {
    "sin(x)": np.sin, "cos(x)": np.cos, "tan(x)": np.tan,
    "arcsin(x)": np.arcsin, "asin(x)": np.arcsin, "arccos(x)": np.arccos, "acos(x)": np.arccos,
    "arctan(x)": np.arctan, "atan(x)": np.arctan,
    "sinh(x)": np.sinh, "cosh(x)": np.cosh, "tanh(x)": np.tanh,
    "exp(x)": np.exp, "log(x)": np.log, "ln(x)": np.log, "log10(x)": np.log10, "sqrt(x)": np.sqrt,
    "x**3": lambda x: x**3, "x**-2.5": lambda x: x**-2.5, "2**x": lambda x: 2**x,
    "x**x": lambda x: np.exp(x * np.log(x)), "1/x": lambda x: 1 / x, "x/(1+x)": lambda x: x / (1 + x),
    "-x + +x*2 - 1": lambda x: x - 1, "x*x": lambda x: x * x, "(1 - x)**2": lambda x: (1 - x) ** 2,
}  # fmt: skip


@pytest.mark.parametrize("text", PARTS)
def test_every_part_and_its_derivative(text):
    x = np.linspace(0.1, 0.9, 9)

    form = Expression(text)

    np.testing.assert_allclose(form(x), PARTS[text](x + 0j).real, rtol=RELATIVE, atol=RELATIVE)
    slope = PARTS[text](x + 1j * STEP).imag / STEP
    np.testing.assert_allclose(form.gradient(x)[0], slope, rtol=10 * RELATIVE, atol=RELATIVE)


def test_absolute_value():
    form = Expression("abs(x)")

    assert form([-2.0, 3.0]).tolist() == [2.0, 3.0]
    assert form.gradient([-2.0, 3.0])[0].tolist() == [-1.0, 1.0]


def test_operators_bind_as_in_mathematics():
    assert Expression("-x**2 + 2*x*3**2/6 - 1")(2.0).item() == -4.0 + 6.0 - 1.0
    assert Expression("2**-x")(2.0).item() == 0.25
    assert Expression("1 - 2 - x")(3.0).item() == -4.0


def test_polar_coordinates_and_their_slopes():
    x, y = np.array([3.0, -1.0, 0.3]), np.array([4.0, 2.0, -0.7])
    astigmatism = Expression("r**2 * cos(2*theta)")

    np.testing.assert_allclose(astigmatism(x, y), x * x - y * y, rtol=1e-14, atol=1e-13)
    gx, gy = astigmatism.gradient(x, y)
    np.testing.assert_allclose(gx, 2 * x, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(gy, -2 * y, rtol=1e-14, atol=1e-14)
    assert astigmatism.gradient(0.0, 0.0)[0].item() == 0.0


def test_powers_at_zero_have_the_right_slopes():
    assert Expression("x**1")(0.0).item() == 0.0
    assert Expression("x**1").gradient(0.0)[0].item() == 1.0
    assert Expression("x**0").gradient(0.0)[0].item() == 0.0
    assert Expression("x**n", n=2.0).derivatives(np.zeros(1), np.zeros(1), ["n"])[0].item() == 0.0


def test_outside_the_domain_is_nan_without_a_warning():
    form = Expression("sqrt(x) + a/y", a=1.0)

    z = form([-1.0, 1.0, 1.0], [1.0, 0.0, 1.0])

    assert np.isnan(z).tolist() == [True, True, False]
    assert np.isnan(form.gradient([-1.0], [1.0])).all()
    assert np.isnan(form.derivatives(np.array([-1.0]), np.ones(1), ["a"])[0]).all()


def test_a_constant_formula_fills_the_map():
    z = Expression("a", a=2e-6)(np.zeros((2, 3)), np.zeros((2, 3)))

    assert z.tolist() == [[2e-6] * 3] * 2
    assert z.flags.writeable


def test_text_shows_in_the_representation():
    assert repr(Expression("a*x", a=2.0)) == "Expression('a*x', a=2)"
    assert repr(Expression("x")) == "Expression('x')"


def test_unknown_value_is_named():
    form = Expression("a*x + b", a=1.0, b=None)

    with pytest.raises(DataError, match="no value for b"):
        form(1.0)
    with pytest.raises(DataError, match="no rule to guess"):
        form.start(np.zeros(3), np.zeros(3), np.zeros(3))
    assert form.with_parameters(b=2.0)(1.0).item() == 3.0


def test_units_of_parameters_are_kept():
    form = Expression("a*x", a=1.0, units={"a": "1"}).with_parameters(a=2.0)

    assert form.units == {"a": "1"}
    with pytest.raises(DataError, match="not a parameter"):
        Expression("a*x", a=1.0, units={"b": "m"})


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "x.__class__",
        "(lambda: 0)()",
        "[x for x in (1, 2)]",
        "x if x else y",
        "x < y",
        "x and y",
        "not x",
        "~1",
        "x // y",
        "x % y",
        "x @ y",
        "x << 1",
        "'text'",
        "1j",
        "True",
        "None",
        "...",
        "{}",
        "f'{x}'",
        "(q := 3)",
        "x, y",
        "x[0]",
        "open('file')",
        "eval('1')",
        "exec('1')",
        "sin(x, y)",
        "sin()",
        "sin(x=1)",
        "sin(*x)",
        "sin",
        "np.sin(x)",
        "q*x",
        "x^2",
        "x +",
        "",
        "   ",
        "x\n+ y",
        "x; y",
        "import os",
        "x = 1",
        "\x00",
        "1e999",
        "1" + "0" * 400,
        "9" * 1999,
        "(" * 300 + "x" + ")" * 300,
        "-" * 1500 + "x",
        "sin(" * 120 + "x" + ")" * 120,
        "x" + "+x" * 900,
        "x" * 3000,
        "1 if " * 300 + "x",
        "🙂",
        "x" + "()" * 500,
    ],
)
def test_hostile_text_raises_a_named_error(text):
    with pytest.raises(DataError, match="formula"):
        Expression(text)


@pytest.mark.parametrize("text", [None, 3, b"x", ["x"]])
def test_what_is_no_text_raises(text):
    with pytest.raises(DataError, match="formula is text"):
        Expression(text)


def test_large_powers_neither_hang_nor_warn():
    form = Expression("9**9**9**9**9 + x")

    assert math.isnan(form(1.0).item())


@pytest.mark.parametrize("name", ["x", "theta", "pi", "sin", "piston", "shift_x"])
def test_reserved_parameter_names_raise(name):
    with pytest.raises(DataError, match=name):
        Expression("x", **{name: 1.0})


def test_idle_parameter_raises():
    with pytest.raises(DataError, match="does not hold the parameter b"):
        Expression("a*x", a=1.0, b=2.0)
