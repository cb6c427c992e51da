"""Polynomial fits: coefficients, sign, degree, covariance, printed form."""

import json

import numpy as np
import pytest

from metrosep import Profile, Run, RunSet
from metrosep.compensation import fit_polynomial
from metrosep.errors import DataError, DegenerateFitError, TooFewSamplesError

PM = 1e-12
L = 40e-3
PAPER = (0.3389, 0.48246, -0.00605)
"""Dual-servo paper: y = 0.3389 + 0.48246 x - 0.00605 x^2, x in mm 0..40, y in um."""


def paper(x):
    return np.polyval(PAPER[::-1], np.asarray(x) * 1e3) * 1e-6


def profile(function, n=401, low=0.0, high=L):
    x = np.linspace(low, high, n)
    return Profile(x, function(x))


def runs(*functions, n=401):
    x = np.linspace(0.0, L, n)
    return RunSet(Run(x, f(x), feed=0.1, run_id=str(i)) for i, f in enumerate(functions))


def value_of_printed(text, x):
    """Evaluate the last line as a controller would: no code of metrosep."""
    line = text.splitlines()[-1]
    assert line.startswith("y = ")
    return np.array([eval(line[4:], {"__builtins__": {}}, {"x": float(v)}) for v in x])  # noqa: S307


def test_coefficients_of_the_paper_come_back():
    fit = fit_polynomial(profile(paper), degree=2)

    # um to m, and mm to m once for each power
    np.testing.assert_allclose(
        fit.coefficients, [0.3389e-6, 0.48246e-3, -0.00605], rtol=1e-10, atol=0
    )
    assert fit.residual_rms < PM
    assert fit.domain == (0.0, L)


def test_peak_to_valley_and_vertex_of_the_paper():
    """Papers notes, section 2, no. 25: 9.6185 um, 39.873 mm."""
    fit = fit_polynomial(profile(paper), degree=2)

    c = fit.coefficients
    assert np.ptp(fit.evaluate(np.linspace(0.0, L, 40001))) == pytest.approx(9.6185e-6, abs=1e-10)
    assert -c[1] / (2 * c[2]) == pytest.approx(39.873e-3, abs=1e-6)


def test_compensation_is_the_negated_error():
    error = fit_polynomial(profile(paper), degree=2, quantity="error")
    compensation = fit_polynomial(profile(paper), degree=2, quantity="compensation")
    x = np.linspace(0.0, L, 7)

    np.testing.assert_allclose(compensation.evaluate(x), -paper(x), atol=PM, rtol=0)
    np.testing.assert_allclose(error.evaluate(x), paper(x), atol=PM, rtol=0)
    assert "subtract it" in error.horner()
    assert "add it to the command" in compensation.horner()


def test_quantity_is_never_inferred():
    with pytest.raises(DataError, match="state 'error' or 'compensation'"):
        fit_polynomial(profile(paper), quantity="correction")


@pytest.mark.parametrize("how", ["aicc", "f-test"])
@pytest.mark.parametrize("planted", [0, 1, 2, 3, 5])
def test_planted_degree_is_found_without_noise(how, planted):
    series = np.polynomial.Legendre([0.2, 1, -0.7, 0.5, 0.4, -0.6][: planted + 1], [0.0, L])

    fit = fit_polynomial(profile(lambda x: 1e-6 * series(x)), degree=how)

    assert fit.degree == planted
    assert [s["degree"] for s in fit.scores] == list(range(7))


@pytest.mark.parametrize("n_runs", [1, 5])
@pytest.mark.parametrize(("how", "share"), [("aicc", 0.55), ("f-test", 0.85)])
def test_planted_degree_is_found_in_noise(how, share, n_runs):
    """A cubic of 200 nm in 20 nm noise, runs that drift: never less, seldom more.

    By its nature AIC takes one of three superfluous degrees in a quarter of cases, the F-test at
    1 % in three of a hundred.
    """
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        series = np.polynomial.Legendre([0, 1e-6, -0.4e-6, 0.2e-6], [0.0, L])
        fit = fit_polynomial(
            runs(
                *(
                    lambda x, rng=rng, series=series: (
                        series(x)
                        + 20e-9 * rng.standard_normal(x.size)
                        + 50e-9 * rng.standard_normal()
                        + 30e-9 * rng.standard_normal() * x / L
                    )
                    for _ in range(n_runs)
                )
            ),
            degree=how,
        )
        found.append(fit.degree)

    assert min(found) == 3
    assert np.mean(np.array(found) == 3) >= share


@pytest.mark.parametrize("n_runs", [1, 3, 9])
@pytest.mark.parametrize("how", ["aicc", "f-test"])
def test_noise_alone_makes_no_high_degree(how, n_runs):
    found = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        fit = fit_polynomial(
            runs(*(lambda x, rng=rng: 20e-9 * rng.standard_normal(x.size),) * n_runs), degree=how
        )
        found.append(fit.degree)

    assert np.mean(np.array(found) >= 4) <= 0.2
    assert np.median(found) <= 1


@pytest.mark.parametrize("how", ["aicc", "f-test"])
@pytest.mark.parametrize("n_runs", [2, 3, 4])
def test_offset_and_slope_of_single_runs_are_drift(how, n_runs):
    """Each run leans its own way about a common parabola: degree 2, and nothing is left."""
    lean = np.arange(n_runs) ** 2 * 0.2e-6

    fit = fit_polynomial(
        runs(*(lambda x, a=a: paper(x) + a + a * x / L for a in lean)), degree=how
    )

    assert fit.degree == 2
    assert fit.scores[1]["residual_rms_m"] > 0.3e-6
    assert fit.scores[2]["residual_rms_m"] < PM


@pytest.mark.parametrize("how", ["aicc", "f-test"])
def test_slope_common_to_all_runs_is_shape(how):
    fit = fit_polynomial(runs(*(lambda x: 1e-6 * x / L,) * 3), degree=how)

    assert fit.degree == 1


def correlated(rng, x):
    """Vibration of the slide: noise over 20 samples, 20 nm."""
    smooth = np.convolve(rng.standard_normal(x.size + 19), np.ones(20), mode="valid")
    return 20e-9 * smooth / np.sqrt(20)


@pytest.mark.parametrize("n_runs", [1, 5])
def test_correlated_noise_is_not_taken_for_shape(n_runs):
    found = []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        functions = (lambda x, rng=rng: correlated(rng, x),) * n_runs
        found.append(fit_polynomial(runs(*functions), degree="f-test").degree)

    assert np.mean(np.array(found) >= 2) <= 0.3


@pytest.mark.parametrize("scale", [1e-3, 1e9])
@pytest.mark.parametrize("how", ["aicc", "f-test"])
def test_choice_does_not_depend_on_the_unit_of_height(rng, how, scale):
    x = np.linspace(0.0, L, 301)
    z = paper(x) + 50e-9 * np.sin(2 * np.pi * x / 9e-3) + 20e-9 * rng.standard_normal(301)

    fit = fit_polynomial(Profile(x, z), degree=how)
    scaled = fit_polynomial(Profile(x, scale * z), degree=how)

    assert scaled.degree == fit.degree
    np.testing.assert_allclose(
        scaled.legendre_coefficients, scale * fit.legendre_coefficients, rtol=1e-9
    )


def test_unit_of_position_does_not_matter(rng):
    x = np.linspace(0.0, L, 301)
    z = paper(x) + 20e-9 * rng.standard_normal(301)

    fit = fit_polynomial(Profile(x, z))
    in_mm = fit_polynomial(Profile(1e3 * x, z))

    assert in_mm.degree == fit.degree
    np.testing.assert_allclose(in_mm.evaluate(1e3 * x), fit.evaluate(x), atol=PM, rtol=0)


def test_degree_thirty_is_well_conditioned():
    series = np.polynomial.Legendre(1e-6 / (1.0 + np.arange(31)), [100e-3, 140e-3])

    fit = fit_polynomial(profile(series, 2001, 100e-3, 140e-3), degree=30)

    x = np.linspace(100e-3, 140e-3, 777)
    np.testing.assert_allclose(fit.evaluate(x), series(x), atol=1e-3 * PM, rtol=0)
    np.testing.assert_allclose(fit.legendre_coefficients, series.coef, atol=1e-3 * PM, rtol=0)


def test_outside_is_nan_or_held():
    fit = fit_polynomial(profile(paper), degree=2)

    assert np.isnan(fit.evaluate([-1e-3, 41e-3])).all()
    assert np.isnan(fit.sd([-1e-3])).all()
    np.testing.assert_allclose(
        fit.evaluate([-1e-3, 41e-3], clamp=True), paper([0.0, L]), atol=PM, rtol=0
    )


@pytest.mark.parametrize("digits", [3, 6, 9, 17])
@pytest.mark.parametrize(("x_unit", "x_factor"), [("mm", 1e-3), ("um", 1e-6), ("m", 1.0)])
def test_printed_form_gives_the_polynomial(digits, x_unit, x_factor):
    fit = fit_polynomial(profile(paper), degree=2)
    x = np.linspace(0.0, L, 101)

    text = fit.horner(x_unit=x_unit, y_unit="nm", digits=digits)

    told = fit.printing_error(x_unit=x_unit, y_unit="nm", digits=digits)
    printed = value_of_printed(text, x / x_factor) * 1e-9
    np.testing.assert_allclose(printed, fit.evaluate(x), atol=1.001 * told + 1e-18, rtol=0)
    assert told < 10.0 ** (3 - digits) * 10e-6


def test_printed_form_of_degree_twelve_states_what_it_costs():
    series = np.polynomial.Legendre(1e-6 / (1.0 + np.arange(13)), [0.0, L])
    fit = fit_polynomial(profile(series), degree=12)
    x = np.linspace(0.0, L, 101)

    told = fit.printing_error(digits=9)

    printed = value_of_printed(fit.horner(digits=9), 1e3 * x) * 1e-6
    assert np.abs(printed - fit.evaluate(x)).max() <= 1.001 * told + 1e-15
    assert told > PM  # cancellation in powers of x is not hidden


def test_printed_form_names_units_and_range():
    text = fit_polynomial(profile(paper), degree=2).horner()

    assert "x in mm, y in um" in text
    assert "valid for 0 <= x <= 40" in text
    assert text.splitlines()[-1] == "y = 0.3389 + x*(0.48246 + x*(-0.00605))"


@pytest.mark.parametrize("digits", [2, 18])
def test_useless_number_of_digits_is_refused(digits):
    with pytest.raises(DataError, match="digits"):
        fit_polynomial(profile(paper), degree=2).horner(digits=digits)


def drifting(seed, n_runs=5):
    """The paper's curve, 20 nm noise; each run drifts by 50 nm and 30 nm over 40 mm."""
    rng = np.random.default_rng(seed)
    return runs(
        *(
            lambda x: (
                paper(x)
                + 20e-9 * rng.standard_normal(x.size)
                + 50e-9 * rng.standard_normal()
                + 30e-9 * rng.standard_normal() * x / L
            )
            for _ in range(n_runs)
        )
    )


def test_uncertainty_is_that_of_the_drift_between_runs():
    """At x = 0 the drift gives 50 nm / sqrt(5) = 22 nm, noise of 5 x 401 samples gives 1.3 nm."""
    fits = [fit_polynomial(drifting(seed), degree=2) for seed in range(120)]

    at_zero = np.array([f.evaluate(0.0)[0] for f in fits])
    told = np.array([f.sd(0.0)[0] for f in fits])
    expected = np.hypot(50e-9, 20e-9 * 3 / np.sqrt(401)) / np.sqrt(5)
    assert np.sqrt(np.mean(told**2)) == pytest.approx(expected, rel=0.1, abs=0.0)
    assert np.std(at_zero - paper(0.0)) == pytest.approx(expected, rel=0.2, abs=0.0)
    assert "scatter of 5 runs" in fits[0].cov_source


def test_uncertainty_at_the_end_holds_the_slope_too():
    told = [fit_polynomial(drifting(seed), degree=2).sd(L)[0] for seed in range(120)]

    expected = np.sqrt(50e-9**2 + 30e-9**2 + (20e-9 * 3) ** 2 / 401) / np.sqrt(5)
    assert np.sqrt(np.mean(np.square(told))) == pytest.approx(expected, rel=0.1, abs=0.0)


def test_one_run_tells_no_uncertainty():
    fit = fit_polynomial(profile(paper), degree=2)

    assert fit.cov is None
    assert np.isnan(fit.sd([0.0, L])).all()
    assert "unknown" in fit.cov_source


def test_estimate_hands_its_band_on(one_way_estimate):
    fit = fit_polynomial(one_way_estimate, degree=3)
    x = np.linspace(5e-3, 40e-3, 5)

    assert fit.cov_source == "covariance of the estimate"
    band = one_way_estimate.sd(x)
    assert (fit.sd(x) > 0.05 * band).all()
    assert (fit.sd(x) < 2 * band).all()


def test_reverse_runs_are_not_mirrored():
    x = np.linspace(L, 0.0, 401)

    fit = fit_polynomial(RunSet([Run(x, paper(x), feed=0.1)]), degree=2)

    np.testing.assert_allclose(fit.evaluate(x), paper(x), atol=PM, rtol=0)


def test_domain_takes_part_of_the_data():
    fit = fit_polynomial(profile(np.abs, low=-L), degree=1, domain=(0.0, L))

    np.testing.assert_allclose(fit.coefficients, [0.0, 1.0], atol=PM)
    assert np.isnan(fit.evaluate(-1e-3)[0])


def test_domain_beyond_the_data_is_refused():
    with pytest.raises(DataError, match=r"domain .* not extrapolated"):
        fit_polynomial(profile(paper), degree=2, domain=(0.0, 2 * L))


def test_missing_samples_are_left_out():
    x = np.linspace(0.0, L, 401)
    z = np.where((x > 10e-3) & (x < 12e-3), np.nan, paper(x))

    fit = fit_polynomial(Profile(x, z), degree=2)

    np.testing.assert_allclose(fit.evaluate(x), paper(x), atol=PM, rtol=0)


@pytest.mark.parametrize(
    ("degree", "options", "message"),
    [
        (-1, {}, "0 to 60"),
        (61, {}, "0 to 60"),
        ("best", {}, "a number"),
        (True, {}, "a number"),
        ("aicc", {"max_degree": -1}, "max_degree"),
        ("aicc", {"max_degree": 13}, "max_degree"),
    ],
)
def test_useless_degrees_are_refused(degree, options, message):
    with pytest.raises(DataError, match=message):
        fit_polynomial(profile(paper), degree=degree, **options)


def test_numpy_integer_is_a_degree():
    assert fit_polynomial(profile(paper), degree=np.int64(2)).degree == 2


def test_too_few_samples_are_refused():
    with pytest.raises(TooFewSamplesError, match="degree 5 needs 7 samples, got 6"):
        fit_polynomial(profile(paper, 6), degree=5)


def test_nothing_measured_is_refused():
    with pytest.raises(TooFewSamplesError, match="no valid sample"):
        fit_polynomial(Profile([0.0, 1.0], [np.nan, np.nan]))


def test_clustered_positions_do_not_determine_a_cubic():
    x = np.concatenate([1e-17 * np.arange(10), 1.0 + 1e-15 * np.arange(10)])

    with pytest.raises(DegenerateFitError, match="lower the degree"):
        fit_polynomial(Profile(x, np.zeros(20)), degree=3)


@pytest.mark.parametrize("domain", [(L, 0.0), (0.01, 0.01)])
def test_domain_without_length_is_refused(domain):
    with pytest.raises(DegenerateFitError, match="no length"):
        fit_polynomial(profile(paper), degree=1, domain=domain)


def test_something_else_is_refused():
    with pytest.raises(DataError, match="got list"):
        fit_polynomial([1.0, 2.0])


def test_plain_values_are_json():
    back = json.loads(json.dumps(fit_polynomial(drifting(0)).to_dict(), allow_nan=False))

    assert back["degree"] >= 2
    assert back["degree_chosen_by"] == "AICc"
    assert len(back["legendre_covariance_m2"]) == back["degree"] + 1
