"""Zernike: published index tables, orthonormality, closed forms, planted coefficients, properties."""

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    NotUniformError,
)
from metrosep.forms.zernike import (
    Zernike,
    ansi_to_nm,
    fringe_to_nm,
    nm_to_ansi,
    nm_to_fringe,
    nm_to_noll,
    noll_to_nm,
    term_indices,
    term_name,
    to_nm,
)

COEFFICIENT = 1e-12
"""Relative to coefficients of 1: what a fit to noise-free data may be off."""

ROUNDING = 1e-13
"""Relative to terms of 1, order 10."""

# Fringe table as printed in manuals of interferometers, by (n, m), terms 1 to 16
FRINGE = [(0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0)]
FRINGE += [(3, 3), (3, -3), (4, 2), (4, -2), (5, 1), (5, -1), (6, 0)]

# Noll 1976, Table I: columns are m, rows n; terms 1 to 21
NOLL = [(0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3)]
NOLL += [(4, 0), (4, 2), (4, -2), (4, 4), (4, -4), (5, 1), (5, -1), (5, 3), (5, -3), (5, 5)]
NOLL += [(5, -5)]

# cartesian closed forms, 1 at the rim
CLOSED = {
    (0, 0): lambda x, y: 1.0 + 0.0 * x,
    (1, 1): lambda x, y: x,
    (1, -1): lambda x, y: y,
    (2, 0): lambda x, y: 2 * (x**2 + y**2) - 1,
    (2, 2): lambda x, y: x**2 - y**2,
    (2, -2): lambda x, y: 2 * x * y,
    (3, 1): lambda x, y: x * (3 * (x**2 + y**2) - 2),
    (3, -1): lambda x, y: y * (3 * (x**2 + y**2) - 2),
    (3, 3): lambda x, y: x**3 - 3 * x * y**2,
    (3, -3): lambda x, y: 3 * x**2 * y - y**3,
    (4, 0): lambda x, y: 6 * (x**2 + y**2) ** 2 - 6 * (x**2 + y**2) + 1,
    (4, 2): lambda x, y: (x**2 - y**2) * (4 * (x**2 + y**2) - 3),
    (6, 0): lambda x, y: (
        20 * (x**2 + y**2) ** 3 - 30 * (x**2 + y**2) ** 2 + 12 * (x**2 + y**2) - 1
    ),
}


def _disc(n=41, radius=0.05):
    x = np.linspace(-radius, radius, n)
    return x, *np.meshgrid(x, x)


def _planted(form, n=129, share=0.05, seed=3):
    rng = np.random.default_rng(seed)
    a = rng.standard_normal(len(form.names))
    x, X, Y = _disc(n)
    full = Zernike(
        form.indices, form.order, coefficients=a, radius=0.05, normalisation=form.normalisation
    )
    z = full(X, Y)
    z[rng.random(z.shape) < share] = np.nan
    return a, x, z


@pytest.mark.parametrize(
    ("ansi", "noll", "fringe", "nm"),
    [(12, 11, 9, (4, 0)), (8, 8, 7, (3, 1)), (3, 5, 6, (2, -2))],
)
def test_indices_of_the_acceptance_table(ansi, noll, fringe, nm):
    assert ansi_to_nm(ansi) == noll_to_nm(noll) == fringe_to_nm(fringe) == nm


def test_printed_tables():
    assert [fringe_to_nm(j) for j in range(1, 17)] == FRINGE
    assert [noll_to_nm(j) for j in range(1, 22)] == NOLL
    assert [ansi_to_nm(j) for j in range(6)] == [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2)]
    assert fringe_to_nm(36) == (10, 0)
    assert fringe_to_nm(49) == (12, 0)


def test_every_term_has_one_number_in_each_order():
    for j in range(1, 400):
        assert nm_to_ansi(*ansi_to_nm(j)) == j
        assert nm_to_noll(*noll_to_nm(j)) == j
        assert nm_to_fringe(*fringe_to_nm(j)) == j
    terms = {(n, m) for n in range(12) for m in range(-n, n + 1, 2)}
    assert {ansi_to_nm(j) for j in range(78)} == {noll_to_nm(j) for j in range(1, 79)} == terms


def test_names_of_terms():
    names = [term_name(*fringe_to_nm(j)) for j in (1, 2, 4, 6, 7, 9, 11, 12, 15, 17, 36)]

    assert names == [
        "piston",
        "tilt x",
        "defocus",
        "astigmatism 45 deg",
        "coma x",
        "primary spherical",
        "trefoil 30 deg",
        "secondary astigmatism 0 deg",
        "secondary coma y",
        "tetrafoil 0 deg",
        "quaternary spherical",
    ]
    assert term_name(9, 9) == "Z(9, 9)"


@pytest.mark.parametrize(
    "call",
    [
        lambda: ansi_to_nm(-1),
        lambda: noll_to_nm(0),
        lambda: fringe_to_nm(0),
        lambda: fringe_to_nm(1.5),
        lambda: nm_to_ansi(2, 1),
        lambda: nm_to_noll(1, 3),
        lambda: nm_to_fringe(-1, 1),
        lambda: term_indices(0, "ansi"),
        lambda: term_indices([1, 1], "noll"),
        lambda: term_indices([0], "noll"),
        lambda: to_nm(1, "zemax"),
    ],
    ids=range(11),
)
def test_terms_that_do_not_exist_raise(call):
    with pytest.raises(DataError):
        call()


@pytest.mark.parametrize("nm", CLOSED, ids=str)
def test_closed_forms(nm):
    _, X, Y = _disc(radius=1.0)
    form = Zernike([nm_to_ansi(*nm)], coefficients=[1.0], radius=1.0, normalisation="peak")

    z = form(X, Y)

    inside = np.hypot(X, Y) <= 1.0 + 1e-12
    assert np.array_equal(~np.isnan(z), inside)
    assert np.abs(z - CLOSED[nm](X, Y))[inside].max() < ROUNDING


def test_terms_are_orthonormal_in_the_mean_over_the_disc():
    n = 66
    nodes, weights = np.polynomial.legendre.leggauss(12)
    rho = np.sqrt((nodes + 1) / 2)  # uniform in rho^2
    theta = 2 * np.pi * np.arange(24) / 24
    x, y = np.outer(rho, np.cos(theta)), np.outer(rho, np.sin(theta))
    area = np.repeat(weights / 2, 24).reshape(x.shape) / 24

    for order in ("ansi", "noll"):
        basis = Zernike(n, order, radius=1.0).basis(x, y)
        gram = np.einsum("iab,jab,ab->ij", basis, basis, area)
        assert np.abs(gram - np.eye(n)).max() < ROUNDING


def test_fringe_terms_are_one_at_the_rim():
    form = Zernike(36, "fringe", radius=2.0)
    angle = np.linspace(0, 2 * np.pi, 721)

    rim = form.basis(2.0 * np.cos(angle), 2.0 * np.sin(angle))

    assert np.abs(rim.max(axis=1) - 1.0).max() < 1e-12
    assert form.normalisation == "peak"
    assert Zernike(3).normalisation == "rms"


def test_order_100_is_bounded_by_one():
    form = Zernike([nm_to_ansi(100, 0), nm_to_ansi(99, 1)], radius=1.0, normalisation="peak")

    values = form.basis(np.linspace(-1, 1, 2001), np.zeros(2001))

    assert np.abs(values).max() < 1.0 + 1e-11
    assert values[0, [0, 1000, 2000]] == pytest.approx([1, 1, 1], abs=1e-11)


def test_slopes_agree_with_differences_and_are_finite_at_the_centre():
    rng = np.random.default_rng(4)
    form = Zernike(45, coefficients=rng.standard_normal(45), radius=2.0)
    x, y = rng.uniform(-1.2, 1.2, (2, 40))
    x[0] = y[0] = 0.0
    h = 1e-5

    dx, dy = form.gradient(x, y)

    assert np.abs(dx - (form(x + h, y) - form(x - h, y)) / (2 * h)).max() < 1e-7
    assert np.abs(dy - (form(x, y + h) - form(x, y - h)) / (2 * h)).max() < 1e-7


def test_outside_the_disc_everything_is_nan_and_the_rim_is_inside():
    form = Zernike(3, coefficients=[1.0, 2.0, 3.0], radius=0.05)
    x = np.array([0.05, 0.05 * (1 + 1e-12), 0.0501])

    assert np.isnan(form(x)).tolist() == [False, False, True]
    assert np.isnan(form.gradient(x)[0]).tolist() == [False, False, True]
    assert np.isnan(form.basis(x, 0 * x)).all(axis=0).tolist() == [False, False, True]


@pytest.mark.parametrize(
    ("terms", "order"),
    [
        (36, "ansi"),
        (36, "fringe"),
        (21, "noll"),
        (91, "ansi"),
        ([0, 4, 12], "ansi"),
        ([4], "fringe"),
    ],
)
def test_planted_coefficients_come_back(terms, order):
    form = Zernike(terms, order, radius=0.05)
    a, x, z = _planted(form)

    fit = form.fit_grid(x, x, z)

    found = np.array(list(fit.form.parameters.values()))
    assert np.abs(found - a).max() < COEFFICIENT * (10 if terms == 91 else 1)
    assert fit.n_valid == np.count_nonzero(~np.isnan(z))


def test_axes_kept_from_another_map_are_not_taken_for_those_of_this_one():
    x, _, _ = _disc(60)
    elsewhere = x * 0.5 + 0.01  # as many pixels, closer and off the centre

    for u, v in ((x, x), (x, elsewhere), (elsewhere, x), (x, x)):
        z = u**2 + 3.0 * v[:, None] ** 2 + 0.1 * u
        fit = Zernike(6, radius=0.05).fit_grid(u, v, z)

        left = fit.form(*np.meshgrid(u, v)) - z
        assert np.nanmax(np.abs(left)) < COEFFICIENT * z.max()


def test_many_terms_in_blocks():
    form = Zernike(120, radius=0.05)
    a, x, z = _planted(form, n=201)

    found = np.array(list(form.fit_grid(x, x, z).form.parameters.values()))

    assert np.abs(found - a).max() < COEFFICIENT


def test_map_and_points_and_both_ways_of_a_map_agree():
    rng = np.random.default_rng(5)
    x, X, Y = _disc(150)
    z = rng.standard_normal(X.shape)
    z[rng.random(z.shape) < 0.1] = np.nan
    weights = rng.random(z.shape)

    for terms in (28, 110):
        form = Zernike(terms, radius=0.045)
        grid = form.fit_grid(x, x, z, weights=weights)
        points = form.fit_points(X.ravel(), Y.ravel(), z.ravel(), weights=weights.ravel())
        a, b = (np.array(list(f.form.parameters.values())) for f in (grid, points))
        assert np.abs(a - b).max() < COEFFICIENT
        assert grid.n_valid == points.n_valid
        assert grid.residual_sum == pytest.approx(points.residual_sum, rel=1e-9, abs=0.0)
        assert np.abs(grid.inverse - points.inverse).max() < 1e-9 * np.abs(grid.inverse).max()


def test_what_lies_beyond_the_radius_has_no_part():
    form = Zernike(15, radius=0.03)
    _a, x, z = _planted(Zernike(15), share=0.0)
    inner = form.fit_grid(x, x, z).form.parameters
    spoiled = z.copy()
    spoiled[np.hypot(*np.meshgrid(x, x)) > 0.0301] = 1e3

    assert form.fit_grid(x, x, spoiled).form.parameters == pytest.approx(inner, abs=1e-11)


# residuals below and above 1 take different ways to zeros in the gaps
@pytest.mark.parametrize("scale", [1e-7, 1e3])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_many_gaps_and_pixels_off_the_disc_agree_with_the_dense_solution(scale, is_weighted):
    x, y = np.linspace(-0.06, 0.055, 310), np.linspace(-0.05, 0.065, 270)
    X, Y = np.meshgrid(x, y)
    inside = np.hypot(X, Y) <= 0.05
    rng = np.random.default_rng(8)
    z = scale * (1.0 + 30.0 * X + rng.standard_normal(X.shape))
    z[~inside] = 1e6 * scale  # measured, but off the disc
    z[rng.random(z.shape) < 0.4] = np.nan
    z[90:97] = np.nan
    z[150, inside[150].argmax()] = z[150, -1] = z[0, 0] = z[-1, -1] = np.nan
    weights = rng.random(z.shape) if is_weighted else None
    if weights is not None:
        weights[120:125] = 0.0
    form = Zernike(15, "noll", radius=0.05)

    fit = form.fit_grid(x, y, z, weights=weights)

    counts = inside & ~np.isnan(z) if weights is None else inside & ~np.isnan(z) & (weights > 0.0)
    root = np.ones(z.shape) if weights is None else np.sqrt(weights)
    design = form.basis(X[counts], Y[counts]).T * root[counts][:, None]
    heights = z[counts] * root[counts]
    expected = np.linalg.lstsq(design, heights, rcond=None)[0]
    assert fit.n_valid == counts.sum()
    assert list(fit.form.parameters.values()) == pytest.approx(
        expected, rel=0.0, abs=COEFFICIENT * 10 * scale
    )
    normal = np.linalg.inv(design.T @ design)
    assert np.abs(fit.inverse - normal).max() < COEFFICIENT * 10 * normal.max()
    squares = ((heights - design @ expected) ** 2).sum()
    assert fit.residual_sum == pytest.approx(squares, rel=COEFFICIENT * 10, abs=0.0)


def test_radius_by_default_reaches_the_farthest_valid_pixel():
    x, X, Y = _disc()
    z = np.where(np.hypot(X, Y) <= 0.0331, 1.0, np.nan)

    form = Zernike(4).fit_grid(x, x, z).form

    assert form.radius == pytest.approx(np.hypot(X, Y)[~np.isnan(z)].max(), rel=1e-15, abs=0.0)
    assert form.parameters["Z0"] == pytest.approx(1.0, rel=1e-9, abs=0.0)


def test_coefficient_is_the_rms_of_its_term_and_covariance_follows_the_noise():
    rng = np.random.default_rng(6)
    x, X, Y = _disc(101)
    form = Zernike(10, radius=0.05)
    fits = []
    for _ in range(300):
        z = np.where(np.hypot(X, Y) <= 0.05, 1e-9 * rng.standard_normal(X.shape), np.nan)
        fits.append(form.fit_grid(x, x, z))
    scatter = np.std([list(f.form.parameters.values()) for f in fits], axis=0)

    u = np.sqrt(np.diag(fits[0].covariance))

    assert np.abs(scatter / u - 1).max() < 4 / np.sqrt(600)
    assert u == pytest.approx(1e-9 / np.sqrt(fits[0].n_valid), rel=0.05, abs=0.0)


def test_transposed_and_mirrored_maps():
    form = Zernike(36, radius=0.05)
    a, x, z = _planted(form)

    flat = form.fit_grid(x, x, z.T).form.parameters
    mirrored = form.fit_grid(x, x, z[:, ::-1]).form.parameters

    for name, value, (_n, m) in zip(form.names, a, form.nm, strict=True):
        # theta -> pi/2 - theta; theta -> pi - theta
        if m >= 0 and m % 2 == 0:
            assert flat[name] == pytest.approx((-1) ** (m // 2) * value, abs=1e-11)
        if m < 0 and m % 2 == 0:
            assert flat[name] == pytest.approx((-1) ** (m // 2 + 1) * value, abs=1e-11)
        sign = (-1) ** m if m >= 0 else -((-1) ** m)
        assert mirrored[name] == pytest.approx(sign * value, abs=1e-11)
    assert flat["Z1"] == pytest.approx(a[2], abs=1e-11)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_other_units_of_length_and_height(scale):
    form = Zernike(21)
    _a, x, z = _planted(form)

    fit = form.fit_grid(x * scale, x * scale, z * scale)
    reference = form.fit_grid(x, x, z)

    assert fit.form.radius == pytest.approx(reference.form.radius * scale, rel=1e-9, abs=0.0)
    for name, value in reference.form.parameters.items():
        assert fit.form.parameters[name] / scale == pytest.approx(value, abs=1e-12)


def test_off_centre_rows_of_nan_are_the_same_as_a_crop():
    form = Zernike(15, radius=0.05)
    _, x, z = _planted(form)
    z[:20] = np.nan

    a = form.fit_grid(x, x, z).form.parameters
    b = form.fit_grid(x, x[20:], z[20:]).form.parameters

    assert a == pytest.approx(b, abs=1e-12)


def test_with_parameters_derivatives_and_words():
    form = Zernike([1, 4], "fringe", coefficients=[1e-6, 2e-6], radius=1e-3)
    x = np.array([0.5e-3])

    moved = form.with_parameters(Z4=3e-6)

    (by_z4,) = form.derivatives(x, 0 * x, ["Z4"])
    assert moved(x) - form(x) == pytest.approx(1e-6 * by_z4, rel=1e-9, abs=0.0)
    assert form.labels == {"Z1": "piston", "Z4": "defocus"}
    assert form.units == {"Z1": "m", "Z4": "m"}
    assert form.spanned == {"piston"}
    assert Zernike(6).spanned == {"piston", "tilt_x", "tilt_y"}
    assert form.start(x, x, x) is form
    assert "fringe" in repr(form)


def test_start_finds_coefficients_and_radius():
    full = Zernike(3, coefficients=[1.0, 2.0, 3.0], radius=0.05)
    _x, X, Y = _disc(21)
    keep = np.hypot(X, Y) <= 0.05

    form = Zernike(3).start(X[keep], Y[keep], full(X, Y)[keep])

    assert form.radius == pytest.approx(0.05, rel=1e-9, abs=0.0)
    assert form.parameters == pytest.approx(full.parameters, rel=1e-9, abs=0.0)


def test_degenerate_maps_raise():
    x, X, _Y = _disc(31)
    form = Zernike(6, radius=0.05)
    with pytest.raises(DegenerateFitError, match="0 valid points inside"):
        form.fit_grid(x, x, np.full(X.shape, np.nan))
    with pytest.raises(DegenerateFitError, match="no pixel"):
        Zernike(6).fit_grid(x, x, np.full(X.shape, np.nan))
    row = np.full(X.shape, np.nan)
    row[15] = 1.0
    with pytest.raises(DegenerateFitError, match="6 Zernike terms"):
        form.fit_grid(x, x, row)
    with pytest.raises(DegenerateFitError, match="6 Zernike terms"):
        form.fit_points(x, 0 * x, x)
    with pytest.raises(DegenerateFitError, match="0 valid points"):
        Zernike(1).fit_points([0.0], [0.0], [np.nan])
    with pytest.raises(DegenerateFitError, match="centre"):
        Zernike(1).fit_points([0.0], [0.0], [1.0])


def test_bad_data_raise():
    x, X, _Y = _disc(31)
    form = Zernike(6, radius=0.05)
    with pytest.raises(InvalidSamplesError, match="infinite"):
        form.fit_grid(x, x, np.where(X == 0.0, np.inf, 0.0))
    with pytest.raises(InvalidSamplesError, match="infinite"):
        Zernike(110, radius=0.05).fit_grid(x, x, np.where(X == 0.0, np.inf, 0.0))
    with pytest.raises(InvalidSamplesError, match="shape"):
        form.fit_grid(x, x, np.zeros((3, 3)))
    with pytest.raises(InvalidSamplesError, match="weights"):
        form.fit_grid(x, x, 0 * X, weights=[1.0])
    with pytest.raises(InvalidSamplesError, match="weights"):
        form.fit_grid(x, x, 0 * X, weights=0 * X - 1)
    with pytest.raises(InvalidSamplesError, match="must grow"):
        form.fit_grid(x[::-1], x, 0 * X)
    with pytest.raises(NotUniformError, match="positions x"):
        form.fit_grid(x**3, x, 0 * X)
    with pytest.raises(InvalidSamplesError, match="equally long"):
        form.fit_points([0, 1], [0], [0])
    with pytest.raises(InvalidSamplesError, match="not finite"):
        form.fit_points([0, np.inf], [0, 0], [0, 0])
    with pytest.raises(InvalidSamplesError, match="weights"):
        form.fit_points([0, 1], [0, 0], [0, 0], weights=[1, -1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"terms": 0}, "at least one"),
        ({"order": "zemax"}, "order"),
        ({"normalisation": "p-v"}, "normalisation"),
        ({"radius": -1.0}, "positive"),
        ({"radius": 0.0}, "radius"),
        ({"terms": 2, "coefficients": [1.0]}, "as many"),
        ({"terms": 1, "coefficients": [np.nan]}, "finite"),
        ({"terms": 1, "coefficients": {"Z9": 1.0}}, "no parameter 'Z9'"),
    ],
)
def test_bad_arguments_raise(arguments, message):
    with pytest.raises(DataError, match=message):
        Zernike(**arguments)


def test_unknown_coefficients_or_radius_cannot_be_evaluated():
    with pytest.raises(DataError, match="Z0"):
        Zernike(1, radius=1.0)(0.0, 0.0)
    with pytest.raises(DataError, match="radius"):
        Zernike(1, coefficients=[1.0])(0.0, 0.0)
