"""Polynomials: NIST StRD, planted coefficients, conversions of basis and domain, properties."""

import numpy as np
import pytest
from numpy.polynomial import chebyshev, legendre, polynomial as power

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.forms.polynomial import XY, Chebyshev, Legendre, Polynomial

CERTIFIED = 1e-12
"""Relative: Filip is certified to 15 digits; 8 are asked for."""

WAMPLER = 1e-9
"""Absolute, coefficients of 1 under heights of 3e6; 1e-8 is asked for."""

EXACT = 1e-12
"""Relative to the largest height."""

FILIP = """
-6.860120914 0.8116, -4.324130045 0.9072, -4.358625055 0.9052, -4.358426747 0.9039
-6.955852379 0.8053, -6.661145254 0.8377, -6.355462942 0.8667, -6.118102026 0.8809
-7.115148017 0.7975, -6.815308569 0.8162, -6.519993057 0.8515, -6.204119983 0.8766
-5.853871964 0.8885, -6.109523091 0.8859, -5.79832982 0.8959, -5.482672118 0.8913
-5.171791386 0.8959, -4.851705903 0.8971, -4.517126416 0.9021, -4.143573228 0.909
-3.709075441 0.9139, -3.499489089 0.9199, -6.300769497 0.8692, -5.953504836 0.8872
-5.642065153 0.89, -5.031376979 0.891, -4.680685696 0.8977, -4.329846955 0.9035
-3.928486195 0.9078, -8.56735134 0.7675, -8.363211311 0.7705, -8.107682739 0.7713
-7.823908741 0.7736, -7.522878745 0.7775, -7.218819279 0.7841, -6.920818754 0.7971
-6.628932138 0.8329, -6.323946875 0.8641, -5.991399828 0.8804, -8.781464495 0.7668
-8.663140179 0.7633, -8.473531488 0.7678, -8.247337057 0.7697, -7.971428747 0.77
-7.676129393 0.7749, -7.352812702 0.7796, -7.072065318 0.7897, -6.774174009 0.8131
-6.478861916 0.8498, -6.159517513 0.8741, -6.835647144 0.8061, -6.53165267 0.846
-6.224098421 0.8751, -5.910094889 0.8856, -5.598599459 0.8919, -5.290645224 0.8934
-4.974284616 0.894, -4.64454848 0.8957, -4.290560426 0.9047, -3.885055584 0.9129
-3.408378962 0.9209, -3.13200249 0.9219, -8.726767166 0.7739, -8.66695597 0.7681
-8.511026475 0.7665, -8.165388579 0.7703, -7.886056648 0.7702, -7.588043762 0.7761
-7.283412422 0.7809, -6.995678626 0.7961, -6.691862621 0.8253, -6.392544977 0.8602
-6.067374056 0.8809, -6.684029655 0.8301, -6.378719832 0.8664, -6.065855188 0.8834
-5.752272167 0.8898, -5.132414673 0.8964, -4.811352704 0.8963, -4.098269308 0.9074
-3.66174277 0.9119, -3.2644011 0.9228
"""
# x y pairs of NIST StRD Filip

FILIP_COEFFICIENTS = [
    -1467.48961422980,
    -2772.17959193342,
    -2316.37108160893,
    -1127.97394098372,
    -354.478233703349,
    -75.1242017393757,
    -10.8753180355343,
    -1.06221498588947,
    -0.670191154593408e-01,
    -0.246781078275479e-02,
    -0.402962525080404e-04,
]

FILIP_SD = [
    298.084530995537,
    559.779865474950,
    466.477572127796,
    227.204274477751,
    71.6478660875927,
    15.2897178747400,
    2.23691159816033,
    0.221624321934227,
    0.142363763154724e-01,
    0.535617408889821e-03,
    0.896632837373868e-05,
]

ARANGE = np.arange(21.0)

_HALF = [759, -2048, 2048, -2048, 2523, -2048, 2048, -2048, 1838, -2048]
WAMPLER_NOISE = np.array([*_HALF, 2048, *_HALF[::-1]])
# NIST StRD Wampler3: the sum of powers plus this; Wampler4 has 100 times as much


def _filip():
    return np.array(FILIP.replace(",", " ").split(), dtype=float).reshape(-1, 2).T


def _values(fit):
    return np.array(list(fit.form.parameters.values()))


def _grid(n_x=23, n_y=31):
    x, y = 2e-3 + 1e-4 * np.arange(n_x), -1e-3 + 2e-4 * np.arange(n_y)
    return x, y, *np.meshgrid(x, y)


def test_filip_has_its_certified_coefficients_and_scatter():
    x, y = _filip()

    fit = Polynomial(10).fit_profile(x, y)

    assert list(fit.form.parameters) == [f"c{i}" for i in range(11)]
    assert np.abs(_values(fit) / FILIP_COEFFICIENTS - 1).max() < CERTIFIED
    assert fit.residual_sd == pytest.approx(0.334801051324544e-02, rel=1e-12, abs=0.0)
    assert np.abs(np.sqrt(np.diag(fit.covariance)) / FILIP_SD - 1).max() < 1e-9


def test_wampler_1():
    y = sum(ARANGE**k for k in range(6))

    fit = Polynomial(5).fit_profile(ARANGE, y)

    assert np.abs(_values(fit) - 1).max() < WAMPLER


def test_wampler_2():
    y = sum((ARANGE / 10) ** k for k in range(6))

    fit = Polynomial(5).fit_profile(ARANGE, y)

    assert np.abs(_values(fit) / 10.0 ** -np.arange(6) - 1).max() < CERTIFIED


@pytest.mark.parametrize(
    ("factor", "sd0", "sd5"),
    [(1, 2152.32624678170, 0.112324854679312), (100, 215232.624678170, 11.2324854679312)],
)
def test_wampler_3_and_4(factor, sd0, sd5):
    y = sum(ARANGE**k for k in range(6)) + factor * WAMPLER_NOISE

    fit = Polynomial(5).fit_profile(ARANGE, y)

    assert np.abs(_values(fit) - 1).max() < 1e-7
    sd = np.sqrt(np.diag(fit.covariance))
    assert sd[0] == pytest.approx(sd0, rel=1e-12, abs=0.0)
    assert sd[5] == pytest.approx(sd5, rel=1e-12, abs=0.0)


@pytest.mark.parametrize("maker", [XY, Legendre, Chebyshev])
def test_planted_powers_come_back_from_a_map_with_gaps(maker):
    x, y, X, Y = _grid()
    z = 1e-6 + 2e-3 * X - 5e-3 * Y + 3.0 * X**2 - 7.0 * X * Y + 400.0 * X * Y**2
    z[2:9, 3:8] = np.nan

    fit = maker(3).fit_grid(x, y, z)

    assert np.nanmax(np.abs(fit.form(X, Y) - z)) < EXACT * np.nanmax(np.abs(z))
    dx, dy = fit.form.gradient(X, Y)
    assert np.abs(dx - (2e-3 + 6.0 * X - 7.0 * Y + 400.0 * Y**2)).max() < 1e-9 * np.abs(dx).max()
    assert np.abs(dy - (-5e-3 - 7.0 * X + 800.0 * X * Y)).max() < 1e-9 * np.abs(dy).max()


def test_power_parameters_have_names_values_and_units():
    x, y, X, Y = _grid()

    fit = XY(2).fit_grid(x, y, 1e-6 + 2e-3 * X - 7.0 * X * Y)

    names = ["c_0_0", "c_1_0", "c_0_1", "c_2_0", "c_1_1", "c_0_2"]
    assert list(fit.form.parameters) == names
    assert list(fit.form.units.values()) == ["m", "1", "1", "m^-1", "m^-1", "m^-1"]
    assert fit.form.parameters["c_1_0"] == pytest.approx(2e-3, rel=1e-9, abs=0.0)
    assert fit.form.parameters["c_1_1"] == pytest.approx(-7.0, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("maker", "evaluate"), [(Legendre, legendre.legval2d), (Chebyshev, chebyshev.chebval2d)]
)
@pytest.mark.parametrize("kind", ["total", "tensor"])
def test_scaled_bases_are_those_of_numpy(maker, evaluate, kind):
    rng = np.random.default_rng(2)
    c = rng.standard_normal((4, 4))
    if kind == "total":
        c[np.add.outer(range(4), range(4)) > 3] = 0.0
    form = maker(3, kind=kind, coefficients=c, centre=(1.0, -2.0), half_width=(3.0, 0.5))
    x, y = rng.uniform(-2, 4, 50), rng.uniform(-2.5, -1.5, 50)

    expected = evaluate((x - 1.0) / 3.0, (y + 2.0) / 0.5, c)

    assert np.abs(form(x, y) - expected).max() < 1e-12
    assert np.abs(form.coefficients - c).max() == 0.0


@pytest.mark.parametrize("basis", ["power", "legendre", "chebyshev"])
@pytest.mark.parametrize("variables", [1, 2])
def test_slopes_and_derivatives_agree_with_differences(basis, variables):
    rng = np.random.default_rng(5)
    shape = (5,) if variables == 1 else (5, 5)
    domain = {} if basis == "power" else {"centre": 0.1, "half_width": 0.9}
    c = rng.standard_normal(shape)
    form = Polynomial(4, kind="tensor", basis=basis, coefficients=c, **domain)
    x, y = rng.uniform(-1, 1, (2, 7))
    h = 1e-6

    dx, dy = form.gradient(x, y)

    assert np.abs(dx - (form(x + h, y) - form(x - h, y)) / (2 * h)).max() < 1e-7
    assert np.abs(dy - (form(x, y + h) - form(x, y - h)) / (2 * h)).max() < 1e-7
    for name, function in zip(form.names, form.derivatives(x, y, form.names), strict=True):
        moved = form.with_parameters(**{name: form.parameters[name] + 1.0})
        assert np.abs(moved(x, y) - form(x, y) - function).max() < 1e-12


def test_profile_in_each_basis_is_the_same_curve():
    rng = np.random.default_rng(6)
    x = np.sort(rng.uniform(10e-3, 40e-3, 300))
    z = 1e-6 * np.sin(x / 5e-3) + 1e-8 * rng.standard_normal(x.size)
    z[::7] = np.nan

    fits = [Polynomial(6, basis=b).fit_profile(x, z) for b in ("power", "legendre", "chebyshev")]

    reference = np.polynomial.Polynomial.fit(x[~np.isnan(z)], z[~np.isnan(z)], 6)(x)
    for fit in fits:
        assert np.abs(fit.form(x) - reference).max() < 1e-17
        assert fit.n_valid == np.count_nonzero(~np.isnan(z))
    powers = power.polyval(x, fits[0].form.coefficients)
    assert np.abs(powers - reference).max() < 1e-15
    # the scatter of the curve does not depend on the functions it is written in
    scatter = []
    for fit in fits[1:]:
        functions = fit.form.basis(x, x)
        scatter.append(np.einsum("in,ij,jn->n", functions, fit.covariance, functions))
    assert np.abs(scatter[0] / scatter[1] - 1).max() < 1e-9


def test_legendre_fit_has_the_domain_of_the_valid_data():
    x, y, X, Y = _grid()
    z = X * Y
    z[:, :3] = np.nan

    form = Legendre(2).fit_grid(x, y, z).form

    assert form.centre == pytest.approx(
        ((x[3] + x[-1]) / 2, (y[0] + y[-1]) / 2), rel=1e-9, abs=0.0
    )
    assert form.half_width == pytest.approx(
        ((x[-1] - x[3]) / 2, (y[-1] - y[0]) / 2), rel=1e-9, abs=0.0
    )


def test_a_given_domain_is_kept():
    x, y, X, Y = _grid()

    form = Chebyshev(3, centre=(1e-3, 0.0), half_width=5e-3).fit_grid(x, y, X**2 * Y).form

    assert form.centre == (1e-3, 0.0)
    assert form.half_width == (5e-3, 5e-3)
    assert np.abs(form(X, Y) - X**2 * Y).max() < EXACT * np.abs(X**2 * Y).max()


def test_map_points_and_falling_axes_agree():
    x, y, X, Y = _grid()
    rng = np.random.default_rng(8)
    z = 1e-6 * rng.standard_normal(X.shape)
    z[rng.random(z.shape) < 0.1] = np.nan

    for maker in (XY, Legendre):
        a = maker(3).fit_grid(x, y, z)
        b = maker(3).fit_points(X.ravel(), Y.ravel(), z.ravel())
        c = maker(3).fit_grid(x[::-1], y, z[:, ::-1])
        for other in (b, c):
            assert np.abs(other.form(X, Y) - a.form(X, Y)).max() < 1e-17
            ratio = np.diag(other.covariance) / np.diag(a.covariance)
            assert np.abs(ratio - 1).max() < 1e-6
            assert other.residual_sum == pytest.approx(a.residual_sum, rel=1e-10, abs=0.0)


def test_weights_of_a_profile_count_as_repeats():
    rng = np.random.default_rng(9)
    x = np.linspace(0.0, 1.0, 40)
    z = rng.standard_normal(40)
    weights = rng.integers(0, 4, 40).astype(float)

    a = Polynomial(3).fit_profile(x, z, weights=weights)
    b = Polynomial(3).fit_profile(
        np.repeat(x, weights.astype(int)), np.repeat(z, weights.astype(int))
    )

    assert np.abs(_values(a) - _values(b)).max() < 1e-10
    assert np.abs(a.inverse / b.inverse - 1).max() < 1e-9


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_other_units_of_length_and_height(scale):
    rng = np.random.default_rng(10)
    x = np.linspace(0.01, 0.03, 200)
    z = rng.standard_normal(200)

    a = _values(Polynomial(4).fit_profile(x, z))
    b = _values(Polynomial(4).fit_profile(x * scale, z * scale))

    assert np.abs(b * scale ** (np.arange(5) - 1.0) / a - 1).max() < 1e-9


def test_mirrored_profile_and_more_points_than_a_block():
    x = np.linspace(-1.0, 1.0, 40_001)
    z = np.exp(x)

    a, b = (Polynomial(5).fit_profile(x, v).form for v in (z, z[::-1]))

    assert np.abs(a.coefficients - b.coefficients * (-1.0) ** np.arange(6)).max() < 1e-12
    assert np.abs(a(x) - np.polynomial.Legendre.fit(x, z, 5)(x)).max() < 1e-13


def test_start_determines_the_unknown_coefficients():
    x = np.linspace(0, 1e-3, 50)
    form = Polynomial(2, variables=1).start(x, np.zeros(50), 1e-6 + 3.0 * x**2)

    assert form.parameters["c2"] == pytest.approx(3.0, rel=1e-9, abs=0.0)
    assert form.start(x, x, x) is form


def test_what_a_form_holds_of_the_rigid_body():
    assert Polynomial(0).spanned == {"piston", "shift_x", "shift_y"}
    assert Legendre(1).spanned == {"piston", "tilt_x", "tilt_y"}
    assert Polynomial(3).is_linear
    assert not Polynomial(3).has_centre


def test_mapping_of_coefficients():
    form = Polynomial(1, coefficients={"c0": 1e-6, "c1": 2.0})

    assert form.variables == 1
    assert form(0.5) == pytest.approx(1.0 + 1e-6, rel=1e-9, abs=0.0)
    assert form(0.5, 7.0) == form(0.5)


def test_too_few_or_degenerate_points_raise():
    with pytest.raises(DegenerateFitError, match="3 valid points cannot determine 4"):
        Polynomial(3).fit_profile([0, 1, 2, 3], [1, 2, 3, np.nan])
    with pytest.raises(DegenerateFitError, match="0 valid points"):
        Polynomial(1).fit_profile([0, 1], [np.nan, np.nan])
    with pytest.raises(DegenerateFitError, match="do not determine"):
        Polynomial(2).fit_profile([0, 0, 1, 1], [1, 2, 3, 4])
    line = np.arange(9.0)
    with pytest.raises(DegenerateFitError, match="do not determine"):
        XY(2).fit_points(line, 2 * line, line)
    with pytest.raises(TooFewSamplesError, match="nothing to estimate"):
        _ = Polynomial(1).fit_profile([0, 1], [1, 2]).covariance


def test_bad_data_raise():
    with pytest.raises(InvalidSamplesError, match="infinite"):
        Polynomial(1).fit_profile([0, 1, 2], [1, np.inf, 2])
    with pytest.raises(InvalidSamplesError, match="position x"):
        Polynomial(1).fit_profile([0, np.nan, 2], [1, 1, 2])
    with pytest.raises(InvalidSamplesError, match="equally long"):
        Polynomial(1).fit_profile([0, 1], [1, 1, 2])
    with pytest.raises(InvalidSamplesError, match="weights"):
        Polynomial(1).fit_profile([0, 1], [1, 1], weights=[1, -1])
    with pytest.raises(InvalidSamplesError, match="position y"):
        XY(0).fit_points([0, 1], [0, np.inf], [1, 1])
    with pytest.raises(NotUniformError, match="positions x"):
        XY(0).fit_grid([0, 1, 3], [0, 1], np.zeros((2, 3)))
    with pytest.raises(NotUniformError, match="positions y"):
        XY(0).fit_grid([0, 1, 2], [1, 1], np.zeros((2, 3)))
    with pytest.raises(InvalidSamplesError, match="shape"):
        XY(0).fit_grid([0, 1, 2], [0, 1], np.zeros((3, 2)))
    with pytest.raises(InvalidSamplesError, match="list of positions"):
        XY(0).fit_grid([], [0, 1], np.zeros((2, 0)))
    with pytest.raises(DataError, match="two variables"):
        Polynomial(1, variables=1).fit_grid([0, 1], [0, 1], np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"degree": -1}, "degree"),
        ({"degree": 2.5}, "degree"),
        ({"degree": 1, "basis": "fourier"}, "basis"),
        ({"degree": 1, "kind": "round"}, "kind"),
        ({"degree": 1, "variables": 3}, "variables"),
        ({"degree": 1, "coefficients": [1, 2, 3]}, "shape"),
        ({"degree": 1, "coefficients": [1, np.nan]}, "finite"),
        ({"degree": 1, "coefficients": [[1, 2], [3, 4]]}, "tensor"),
        ({"degree": 1, "coefficients": {"c7": 1.0}}, "no parameter 'c7'"),
        ({"degree": 1, "half_width": 2.0}, "powers are of metres"),
        ({"degree": 1, "basis": "legendre", "coefficients": [1, 2]}, "without their domain"),
        ({"degree": 1, "basis": "legendre", "centre": 2.0}, "both"),
        ({"degree": 1, "basis": "legendre", "centre": 0.0, "half_width": 0.0}, "positive"),
        ({"degree": 1, "centre": np.inf}, "finite"),
    ],
)
def test_bad_arguments_raise(arguments, message):
    with pytest.raises(DataError, match=message):
        Polynomial(**arguments)


def test_unknown_coefficients_cannot_be_evaluated():
    with pytest.raises(DataError, match="c_0_0"):
        Polynomial(1)(0.0, 0.0)
    with pytest.raises(DataError, match="not known yet"):
        _ = Polynomial(1).coefficients
    with pytest.raises(DataError, match="no parameter"):
        Polynomial(1).with_parameters(q=1.0)
    assert "not fitted" in repr(Polynomial(2))
