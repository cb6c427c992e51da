"""Contract of every shape: the textbook formula, its derivatives by complex step, units, freezing.

The textbook formulas below share no code with metrosep and are not rearranged against cancellation;
they take complex numbers, so that one complex step gives each derivative to the last digits.
"""

import copy
import dataclasses
import pickle

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.forms.conic import Asphere, Conic, Cylinder, Plane, Sphere
from metrosep.forms.expression import Expression
from metrosep.forms.sine_grid import SineGrid
from metrosep.forms.toric import Biconic, Toric

STEP = 1e-30
RELATIVE = 2e-13
"""Rounding of the textbook formulas, which lose up to three digits by cancellation."""


def sphere(x, y, R):
    return R - np.sign(R.real) * np.sqrt(R * R - x * x - y * y)


def cylinder(x, y, R, angle):
    t = -x * np.sin(angle) + y * np.cos(angle)
    return R - np.sign(R.real) * np.sqrt(R * R - t * t)


def conic(x, y, R, k):
    r2 = x * x + y * y
    return r2 / R / (1 + np.sqrt(1 - (1 + k) * r2 / R**2))


def asphere(x, y, R, k, **a):
    r = np.sqrt(x * x + y * y)
    return conic(x, y, R, k) + sum(v * r ** int(n[1:]) for n, v in a.items())


def asphere_normalised(x, y, R, k, **a):
    r = np.sqrt(x * x + y * y) / 0.5
    return conic(x, y, R, k) + sum(v * r ** int(n[1:]) for n, v in a.items())


def toric(x, y, Rb, Rd):
    inner = Rb - Rd + np.sign(Rd.real) * np.sqrt(Rd * Rd - y * y)
    return Rb - np.sign(Rb.real) * np.sqrt(inner * inner - x * x)


def biconic(x, y, Rx, Ry, kx, ky):
    w = 1 - (1 + kx) * x * x / Rx**2 - (1 + ky) * y * y / Ry**2
    return (x * x / Rx + y * y / Ry) / (1 + np.sqrt(w))


def grid_tied(x, y, amplitude, wavelength, phase_x, phase_y):
    return grid(x, y, amplitude, wavelength, amplitude, wavelength, phase_x, phase_y)


def grid(x, y, amplitude, wavelength, amplitude_y, wavelength_y, phase_x, phase_y):
    along = amplitude * np.sin(2 * np.pi * x / wavelength + phase_x)
    return along + amplitude_y * np.cos(2 * np.pi * y / wavelength_y + phase_y)


def formula(x, y, a, b, L):
    r2 = x * x + y * y
    return a * np.sqrt(r2) ** 3 / L**2 + b * np.exp(-r2 / L**2) * np.cos(2 * np.pi * y / L)


CASES = {
    "plane": (Plane(), lambda x, y: 0 * x),
    "sphere": (Sphere(R=1.5), sphere),
    "convex sphere": (Sphere(R=-1.1), sphere),
    "cylinder": (Cylinder(R=1.5, angle=0.3), cylinder),
    "convex cylinder": (Cylinder(R=-1.2, angle=-1.1), cylinder),
    "oblate conic": (Conic(R=1.7, k=0.7), conic),
    "hyperbolic conic": (Conic(R=-0.9, k=-2.5), conic),
    "asphere": (Asphere(R=1.5, k=-0.6, coefficients=[0.1, -0.05]), asphere),
    "odd asphere": (Asphere(-2.0, 0.2, {4: 0.1, 2: 0.03}, odd={3: -0.02, 7: 0.05}), asphere),
    "normalised asphere": (
        Asphere(R=2.0, k=-1.0, coefficients=[0.01], odd=[0.02], norm_radius=0.5),
        asphere_normalised,
    ),
    "toric": (Toric(Rb=2.65, Rd=1.325), toric),
    "convex toric": (Toric(Rb=-1.9, Rd=-1.4), toric),
    "saddle toric": (Toric(Rb=1.8, Rd=-1.4), toric),
    "biconic": (Biconic(Rx=1.5, Ry=-2.1, kx=-0.4, ky=0.8), biconic),
    "sine grid": (SineGrid(amplitude=0.05, wavelength=0.4), grid_tied),
    "sine grid of two": (SineGrid(0.05, 0.4, 0.07, 0.3, phase_x=0.3, phase_y=-0.8), grid),
    "expression": (
        Expression(
            "a * r**3 / L**2 + b * exp(-r**2 / L**2) * cos(2*pi*y/L)",
            a=0.3, b=-0.2, L=0.7, units={"a": "1", "b": "m", "L": "m"},
        ),
        formula,
    ),
}  # fmt: skip


@pytest.fixture(params=CASES.values(), ids=CASES.keys())
def case(request):
    return request.param


@pytest.fixture
def points(rng):
    """Points of a disc, asymmetric, none at the centre, where odd powers have no complex step."""
    angle, radius = rng.uniform(0, 2 * np.pi, 200), 0.8 * np.sqrt(rng.uniform(0.01, 1, 200))
    return radius * np.cos(angle), radius * np.sin(angle)


def values_of(form):
    return {n: complex(v) for n, v in form.parameters.items()}


def assert_same(actual, expected):
    assert actual.dtype == np.float64
    np.testing.assert_allclose(
        actual, expected, rtol=RELATIVE, atol=RELATIVE * max(1.0, np.abs(expected).max())
    )


def test_height_is_the_textbook_formula(case, points):
    form, textbook = case

    expected = textbook(points[0] + 0j, points[1] + 0j, **values_of(form)).real

    assert_same(form(*points), expected)


def test_slopes_are_derivatives_of_the_textbook_formula(case, points):
    form, textbook = case
    x, y = points

    gx, gy = form.gradient(x, y)

    assert_same(gx, textbook(x + 1j * STEP, y + 0j, **values_of(form)).imag / STEP)
    assert_same(gy, textbook(x + 0j, y + 1j * STEP, **values_of(form)).imag / STEP)


def test_parameter_derivatives_are_those_of_the_textbook_formula(case, points):
    form, textbook = case
    x, y = points
    names = list(form.parameters)[::-1]

    found = form.derivatives(x, y, names)

    assert len(found) == len(names)
    for name, column in zip(names, found, strict=True):
        moved = values_of(form)
        moved[name] += 1j * STEP
        assert_same(column, textbook(x + 0j, y + 0j, **moved).imag / STEP)


def test_one_derivative_alone_is_the_same(case, points):
    form, _ = case
    names = list(form.parameters)

    together = form.derivatives(*points, names)

    for name, column in zip(names, together, strict=True):
        np.testing.assert_array_equal(form.derivatives(*points, [name])[0], column)


def power_of_length(unit):
    return {"m": 1, "1": 0, "rad": 0}[unit] if "^" not in unit else int(unit.split("^")[1])


@pytest.mark.parametrize("factor", [1e-9, 1e-6, 1e-3, 1e3])
def test_unit_of_length_does_not_matter(case, points, factor):
    form, _ = case
    if getattr(form, "norm_radius", None):
        pytest.skip("the normalising radius is not a parameter")
    x, y = points
    scaled = form.with_parameters(
        **{n: v * factor ** power_of_length(form.units[n]) for n, v in form.parameters.items()}
    )

    assert_same(scaled(factor * x, factor * y) / factor, form(x, y))
    assert_same(scaled.gradient(factor * x, factor * y)[1], form.gradient(x, y)[1])


def test_units_name_every_parameter_in_order(case):
    form, _ = case

    assert list(form.units) == list(form.parameters)


def test_form_is_frozen(case):
    form, _ = case

    with pytest.raises(dataclasses.FrozenInstanceError):
        form.R = 3.0
    for name, value in form.parameters.items():
        other = form.with_parameters(**{name: 1.25 * value + 0.01})
        assert other.parameters[name] == 1.25 * value + 0.01
        assert form.parameters[name] == value
        assert {k: v for k, v in other.parameters.items() if k != name} == {
            k: v for k, v in form.parameters.items() if k != name
        }


def test_input_is_not_changed_and_may_be_read_only(case, points):
    form, _ = case
    x, y = (p.copy() for p in points)
    for array in (x, y):
        array.flags.writeable = False

    form.height(x, y)
    form.slopes(x, y)
    form.derivatives(x, y, list(form.parameters))

    np.testing.assert_array_equal(x, points[0])


def test_broadcast_integers_and_scalars(case):
    form, _ = case

    z = form(np.array([[0], [1]]) * 0.1, [0, 0, 0])

    assert z.shape == (2, 3)
    assert z.dtype == np.float64
    assert form(0, 0).size == 1
    assert form(0.1).item() == form(0.1, 0.0).item()


def test_nan_positions_give_nan_without_a_warning(case):
    form, _ = case
    x, y = np.array([np.nan, 0.1, 50.0]), np.array([0.1, 0.2, 50.0])

    z, (gx, _) = form(x, y), form.gradient(x, y)

    if form.name != "plane":
        assert np.isnan(z[0])
    assert np.isfinite(z[1])
    assert np.isfinite(gx[1])


def test_centre_is_finite(case):
    form, _ = case

    assert np.isfinite(form(0.0, 0.0))
    assert np.isfinite(form.gradient(0.0, 0.0)).all()
    zero = np.zeros(1)
    assert all(np.isfinite(d).all() for d in form.derivatives(zero, zero, list(form.parameters)))


def test_copies_and_pickles(case, points):
    form, _ = case

    for other in (copy.deepcopy(form), pickle.loads(pickle.dumps(form))):  # noqa: S301
        assert other == form
        assert hash(other) == hash(form)
        np.testing.assert_array_equal(other(*points), form(*points))


def test_unknown_parameter_name_raises(case, points):
    form, _ = case

    with pytest.raises(DataError, match="has no parameter wobble"):
        form.with_parameters(wobble=1.0)
    with pytest.raises(DataError, match="has no parameter wobble"):
        form.derivatives(*points, ["wobble"])


def test_values_that_are_not_finite_raise(case):
    form, _ = case

    for name in form.parameters:
        for bad in (np.nan, np.inf):
            with pytest.raises(DataError, match=name):
                form.with_parameters(**{name: bad})


def test_known_form_starts_as_itself(case, points):
    form, _ = case

    assert form.start(*points, form(*points)) == form
