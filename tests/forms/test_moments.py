"""Polynomials on a grid by Legendre moments: planted polynomials, dense solution, properties."""

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    TooFewSamplesError,
)
from metrosep.forms import _orthogonal
from metrosep.forms.moments import evaluate_grid, fit_grid_polynomial, inverse_of, remove_grid

EXACT = 1e-13
"""Relative to the range of the map: some hundred roundings of double precision."""

DENSE = 1e-11
"""Relative, against an orthogonal factorisation of the whole design matrix."""


def _noise(shape, seed=1, share=0.05):
    rng = np.random.default_rng(seed)
    z = rng.standard_normal(shape)
    z[rng.random(shape) < share] = np.nan
    return z


def _dense(z, degree, kind="total", weights=None):
    """Least squares with a design matrix in monomials of coordinates on [-1, 1]."""
    v, u = np.meshgrid(
        np.linspace(-1, 1, z.shape[0]), np.linspace(-1, 1, z.shape[1]), indexing="ij"
    )
    n = degree + 1
    terms = [(i, j) for i in range(n) for j in range(n) if kind == "tensor" or i + j < n]
    design = np.stack([u**i * v**j for i, j in terms], axis=-1)
    valid = ~np.isnan(z)
    root = np.ones(z.shape) if weights is None else np.sqrt(weights)
    a, b = design[valid] * root[valid][:, None], z[valid] * root[valid]
    return design @ np.linalg.lstsq(a, b, rcond=None)[0]


@pytest.mark.parametrize("kind", ["total", "tensor"])
def test_planted_polynomial_is_removed_wholly(kind):
    y, x = np.mgrid[0:90, 0:70] * 1e-3
    z = 6e-3 + 0.2 * x - 0.1 * y + 3.0 * x**2 - 5.0 * x * y + 40.0 * x * y**2
    z[3:9, 5:40] = np.nan

    residual, fit = remove_grid(z, 3, kind=kind)

    assert np.array_equal(np.isnan(residual), np.isnan(z))
    assert np.nanmax(np.abs(residual)) < EXACT * np.nanmax(np.abs(z))
    assert fit.n_valid == 90 * 70 - 6 * 35


def test_coefficients_are_those_of_the_planted_legendre_series():
    n_y, n_x = 41, 60
    planted = np.zeros((4, 4))
    planted[0, 0], planted[1, 0], planted[0, 2], planted[2, 1] = 3.0, -2.0, 0.5, 0.25
    z = np.polynomial.legendre.leggrid2d(
        np.linspace(-1, 1, n_x), np.linspace(-1, 1, n_y), planted
    ).T

    fit = fit_grid_polynomial(z, 3)

    assert np.abs(fit.coefficients - planted).max() < EXACT * 10
    assert fit.centre == (29.5, 20.0)
    assert fit.half_width == (29.5, 20.0)


@pytest.mark.parametrize("shape", [(40, 31), (400, 333)])
@pytest.mark.parametrize("kind", ["total", "tensor"])
@pytest.mark.parametrize("refine", [True, False])
def test_agrees_with_the_dense_solution(shape, kind, refine):
    z = _noise(shape)
    z[0, 0] = z[-1, -1] = 1.0  # so that the bounding box is the grid

    residual, fit = remove_grid(z, 4, kind=kind, refine=refine)

    dense = z - _dense(z, 4, kind)
    assert np.nanmax(np.abs(residual - dense)) < DENSE
    assert fit.residual_sum == pytest.approx(np.nansum(dense**2), rel=1e-9, abs=0.0)


@pytest.mark.parametrize("shape", [(40, 31), (300, 333)])
def test_weights_agree_with_the_dense_solution(shape):
    z = _noise(shape)
    weights = np.random.default_rng(3).random(shape)
    weights[10:20] = 0.0
    z[0, 0] = z[-1, -1] = 1.0

    residual, fit = remove_grid(z, 3, weights=weights)

    dense = z - _dense(z, 3, weights=weights)
    assert np.nanmax(np.abs(residual - dense)) < DENSE
    assert fit.residual_sum == pytest.approx(np.nansum(weights * dense**2), rel=1e-9, abs=0.0)


def _riddled(shape, scale):
    """Return a map of several blocks: half its pixels missing, rows, a corner and ends of rows too."""
    z = scale * _noise(shape, seed=5, share=0.5)
    z[0, :40] = z[-1, -40:] = np.nan
    z[0, 40] = z[-1, 0] = z[40, -1] = scale  # so that the bounding box is the grid
    z[: shape[0] // 3, :30] = np.nan
    z[shape[0] // 2 : shape[0] // 2 + 9] = np.nan
    z[-20, 1:] = np.nan
    return z


# residuals below and above 1 take different ways to zeros in the gaps
@pytest.mark.parametrize("scale", [1e-6, 0.3, 1e3])
@pytest.mark.parametrize("is_weighted", [False, True])
def test_many_gaps_agree_with_the_dense_solution(scale, is_weighted):
    z = _riddled((300, 400), scale)
    weights = None
    if is_weighted:
        weights = np.random.default_rng(6).random(z.shape)
        weights[100:110] = 0.0
        z[105] = 1e9 * scale  # measured, but of no weight

    residual, fit = remove_grid(z, 4, weights=weights)

    counts = ~np.isnan(z) if weights is None else ~np.isnan(z) & (weights > 0.0)
    expected = np.where(counts, z - _dense(np.where(counts, z, np.nan), 4, weights=weights), 0.0)
    assert np.abs(residual - expected)[counts].max() < DENSE * scale
    squares = (expected**2 * (1.0 if weights is None else weights)).sum()
    assert fit.residual_sum == pytest.approx(squares, rel=DENSE, abs=0.0)
    assert fit.n_valid == counts.sum()


def test_one_row_and_one_column_with_gaps_have_their_mean():
    line = np.array([np.nan, 1.0, np.nan, 2.0, 6.0, np.nan])
    for z in (line[None, :], line[:, None]):
        fit = fit_grid_polynomial(z, 0)
        assert fit.coefficients[0, 0] == pytest.approx(3.0, rel=EXACT, abs=0.0)
        assert fit.residual_sum == pytest.approx(14.0, rel=EXACT, abs=0.0)
        assert fit.n_valid == 3


def test_weight_zero_is_the_same_as_not_measured():
    z = _noise((50, 60))
    weights = np.ones(z.shape)
    weights[:, 40:] = 0.0
    hidden = z.copy()
    hidden[:, 40:] = np.nan

    a = fit_grid_polynomial(z, 3, weights=weights)
    b = fit_grid_polynomial(hidden, 3)

    assert a.n_valid == b.n_valid
    assert np.abs(a.coefficients - b.coefficients).max() < EXACT


def test_nan_rows_are_the_same_as_cropped_rows():
    z = _noise((120, 80))
    padded = np.full((150, 95), np.nan)
    padded[20:140, 7:87] = z

    residual, fit = remove_grid(padded, 4)
    cropped, reference = remove_grid(z, 4)

    assert np.nanmax(np.abs(residual[20:140, 7:87] - cropped)) < EXACT * 10
    assert np.abs(fit.coefficients - reference.coefficients).max() < EXACT
    assert fit.centre == (reference.centre[0] + 7, reference.centre[1] + 20)


@pytest.mark.parametrize("degree", [3, 7])
def test_axes_kept_from_another_map_are_not_taken_for_those_of_this_one(degree):
    rng = np.random.default_rng(9)
    whole = rng.standard_normal((60, 60))
    top, left = whole.copy(), whole.copy()
    top[:20] = np.nan
    left[:, :15] = np.nan

    for z, cropped in ((whole, whole), (top, whole[20:]), (left, whole[:, 15:]), (whole, whole)):
        residual, fit = remove_grid(z, degree)
        expected, alone = remove_grid(np.ascontiguousarray(cropped), degree)

        assert fit.half_width == alone.half_width
        shift = 60 - cropped.shape[1], 60 - cropped.shape[0]  # what is missing is missing before
        assert fit.centre == (alone.centre[0] + shift[0], alone.centre[1] + shift[1])
        left_over = residual[60 - cropped.shape[0] :, 60 - cropped.shape[1] :] - expected
        assert np.abs(left_over).max() < EXACT * np.ptp(whole)


def test_long_axes_are_not_kept():
    before = _orthogonal._kept_values.cache_info().currsize

    fit_grid_polynomial(np.zeros((2, 100_000)), 1, kind="tensor")

    kept = _orthogonal._kept_values.cache_info()
    assert kept.currsize <= before + 1  # that of the two rows


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_measured_part_that_wanders_from_row_to_row_agrees_with_the_dense_solution(share):
    y, x = np.mgrid[:300, :300]
    z = 1e-6 * np.sin(x / 40.0) + 2e-6 * np.cos(y / 70.0)
    z[np.abs(x - y) > share * 300] = np.nan

    residual, _ = remove_grid(z, 3)

    assert np.nanmax(np.abs(residual - (z - _dense(z, 3)))) < DENSE * np.nanmax(z)


def test_a_large_tilt_does_not_hide_a_picometre():
    rows, columns = np.mgrid[0:700, 0:600]
    ripple = 1e-12 * np.cos(2 * np.pi * columns / 50)
    z = 5e-3 + 1e-5 * columns - 2e-5 * rows

    residual, _ = remove_grid(z + ripple, 1)

    alone, _ = remove_grid(ripple, 1)
    rounding_of_the_input = 4e-18
    assert np.abs(residual - alone).max() < rounding_of_the_input


def test_a_coarse_first_map_that_misleads_is_put_right():
    # 1024 pixels per side: the first polynomial comes from every 4th; a pit sits between them
    z = np.zeros((1024, 1024))
    z[::4, ::4] = 1e3
    z += _noise((1024, 1024), share=0.0) * 1e-6

    residual, _ = remove_grid(z, 2)

    assert abs(residual.mean()) < EXACT * 1e3
    assert np.abs(residual - (z - _dense(z, 2))).max() < DENSE * 1e3


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 1e6])
def test_heights_in_another_unit_give_the_same_fit(scale):
    z = _noise((60, 50))

    a, b = fit_grid_polynomial(z, 3), fit_grid_polynomial(z * scale, 3)

    assert np.abs(b.coefficients / scale - a.coefficients).max() < EXACT
    assert b.residual_sd / scale == pytest.approx(a.residual_sd, rel=1e-12, abs=0.0)


def test_flip_and_shift_of_the_heights():
    z = _noise((60, 50))

    a, b = fit_grid_polynomial(z, 3), fit_grid_polynomial(7.0 - z, 3)

    expected = -a.coefficients.copy()
    expected[0, 0] += 7.0
    assert np.abs(b.coefficients - expected).max() < EXACT * 10


def test_transposed_and_mirrored_maps():
    z = _noise((60, 50))
    sign = (-1.0) ** np.arange(4)

    a = fit_grid_polynomial(z, 3).coefficients

    assert np.abs(fit_grid_polynomial(z.T, 3).coefficients - a.T).max() < EXACT
    mirrored = fit_grid_polynomial(z[:, ::-1], 3).coefficients
    assert np.abs(mirrored - sign[:, None] * a).max() < EXACT


def test_covariance_is_the_scatter_of_repeated_fits():
    rng = np.random.default_rng(4)
    y, x = np.mgrid[-1:1:24j, -1:1:30j]
    hole = x**2 + (y - 0.4) ** 2 < 0.2
    fits = []
    for _ in range(400):
        z = 1.0 + x * y + 0.1 * rng.standard_normal(x.shape)
        z[hole] = np.nan
        fits.append(fit_grid_polynomial(z, 2))
    i, j = np.array(fits[0].terms).T
    scatter = np.cov(np.array([f.coefficients[i, j] for f in fits]).T)

    mean = np.mean([f.covariance for f in fits], axis=0)

    four_sigma_of_a_variance = 4 * np.sqrt(2 / 400)
    sd = np.sqrt(np.diag(mean))
    assert np.abs((scatter - mean) / np.outer(sd, sd)).max() < four_sigma_of_a_variance
    assert fits[0].residual_sd == pytest.approx(0.1, rel=0.15, abs=0.0)


def test_evaluate_fills_the_gaps_and_extrapolates_on_request():
    rows, columns = np.mgrid[0:30, 0:40]
    z = 1.0 + 0.1 * columns - 0.2 * rows
    holes = np.where((rows > 10) & (rows < 20), np.nan, z)

    fit = fit_grid_polynomial(holes, 1)

    assert np.abs(evaluate_grid(fit) - z).max() < EXACT * 10
    assert evaluate_grid(fit, (5, 7)).shape == (5, 7)


def test_input_is_not_changed_and_integers_are_taken():
    z = np.arange(30).reshape(5, 6) ** 2
    before = z.copy()

    residual, _ = remove_grid(z, 2)

    assert np.array_equal(z, before)
    assert np.abs(residual - remove_grid(z.astype(float), 2)[0]).max() == 0.0


def test_a_view_with_any_strides_is_taken():
    z = _noise((80, 120))

    a, _ = remove_grid(z[::2, ::-3], 2)

    assert np.nanmax(np.abs(a - remove_grid(z[::2, ::-3].copy(), 2)[0])) < EXACT


def test_single_row_has_a_mean_but_no_plane():
    z = np.arange(10.0)[None, :]

    assert fit_grid_polynomial(z, 0).coefficients[0, 0] == pytest.approx(4.5, rel=1e-9, abs=0.0)
    with pytest.raises(DegenerateFitError, match="too few rows"):
        fit_grid_polynomial(z, 1)


@pytest.mark.parametrize(
    "keep",
    [
        np.eye(40, dtype=bool),
        np.arange(1600).reshape(40, 40) // 40 == 7,
        np.isin(np.arange(1600).reshape(40, 40) % 40, (3, 9)),
    ],
    ids=["diagonal", "one row", "two columns"],
)
def test_pixels_on_a_curve_do_not_determine_a_quadratic(keep):
    z = np.where(keep, _noise((40, 40), share=0.0), np.nan)

    with pytest.raises(DegenerateFitError, match="do not determine the 6 terms"):
        fit_grid_polynomial(z, 2)


def test_all_nan_and_too_few_pixels_raise():
    z = np.full((20, 20), np.nan)
    with pytest.raises(DegenerateFitError, match="0 valid pixels cannot determine 3 terms"):
        fit_grid_polynomial(z, 1)
    z[3, 4] = z[5, 9] = 1.0
    with pytest.raises(DegenerateFitError, match="2 valid pixels"):
        fit_grid_polynomial(z, 1)


def test_as_many_pixels_as_terms_have_no_scatter():
    z = np.full((2, 2), np.nan)
    z[0, 0], z[0, 1], z[1, 0] = 1.0, 2.0, 3.0

    fit = fit_grid_polynomial(z, 1)

    assert np.nanmax(np.abs(evaluate_grid(fit) - z)) < EXACT * 10
    with pytest.raises(TooFewSamplesError, match="nothing to estimate the scatter"):
        _ = fit.covariance


def test_a_constant_map_has_no_other_term():
    fit = fit_grid_polynomial(np.full((300, 300), 2e-6), 3)

    assert fit.coefficients[0, 0] == pytest.approx(2e-6, rel=1e-15, abs=0.0)
    assert np.abs(fit.coefficients.ravel()[1:]).max() < EXACT * 2e-6


@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_infinity_raises(value):
    z = np.zeros((30, 30))
    z[4, 5] = value

    with pytest.raises(InvalidSamplesError, match="infinite"):
        fit_grid_polynomial(z, 1)


@pytest.mark.parametrize("degree", [-1, 41, 1.5])
def test_degree_out_of_range_raises(degree):
    with pytest.raises(DataError, match="degree must be a whole number"):
        fit_grid_polynomial(np.zeros((9, 9)), degree)


def test_other_bad_arguments_raise():
    z = np.zeros((9, 9))
    with pytest.raises(DataError, match="kind"):
        fit_grid_polynomial(z, 1, kind="triangle")
    with pytest.raises(InvalidSamplesError, match="2 dimensions"):
        fit_grid_polynomial(z[0], 1)
    with pytest.raises(InvalidSamplesError, match="shape of z"):
        fit_grid_polynomial(z, 1, weights=np.ones(9))
    with pytest.raises(InvalidSamplesError, match="between 0 and 1"):
        fit_grid_polynomial(z, 1, weights=np.full((9, 9), 2.0))
    with pytest.raises(InvalidSamplesError, match="between 0 and 1"):
        fit_grid_polynomial(z, 1, weights=np.full((9, 9), np.nan))


@pytest.mark.parametrize("correlation", [0.0, 0.5, -0.5, 1 - 1e-6, 1 - 1e-11])
def test_inverse_of_two_correlated_terms_and_its_condition(correlation):
    # [[1, r], [r, 1]] has the inverse [[1, -r], [-r, 1]] / (1 - r^2) and the condition
    # (1 + |r|) / (1 - |r|); each of the two ways to an inverse has its share of the cases
    scale = np.array([3.0, 0.2])
    normal = np.array([[1.0, correlation], [correlation, 1.0]]) * np.outer(scale, scale)
    inverse, condition = inverse_of(normal, "two terms")
    rest = (1.0 - correlation) * (1.0 + correlation)
    expected = np.array([[1.0, -correlation], [-correlation, 1.0]]) / np.outer(scale, scale) / rest
    loss = 1e-15 * (1 + abs(correlation)) / (1 - abs(correlation))
    np.testing.assert_allclose(inverse, expected, rtol=10 * loss)
    assert condition == pytest.approx(
        (1 + abs(correlation)) / (1 - abs(correlation)), rel=1e-15 + 10 * loss, abs=0.0
    )


@pytest.mark.parametrize("correlation", [1.0, 1 - 1e-14])
def test_terms_that_are_the_same_have_no_inverse(correlation):
    with pytest.raises(DegenerateFitError, match="do not determine two terms"):
        inverse_of(np.array([[1.0, correlation], [correlation, 1.0]]), "two terms")


def test_numpys_buffer_is_left_as_it_was():
    before = np.getbufsize()
    fit_grid_polynomial(_noise((40, 50)), 3)
    assert np.getbufsize() == before
