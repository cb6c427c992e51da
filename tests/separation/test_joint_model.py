"""The parts of the joint model against closed forms, draws and planted asymmetries.

Reference numbers of independent code stand in test_joint_reference.py. Units: mm, nm, s.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from acceptance.coverage.machine import Mode, oscillator
from scipy.fft import dct
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.special import i0e
from scipy.stats import cauchy, invgamma, norm, t as student

from metrosep.core.errors import DegenerateFitError
from metrosep.separation.runs.design import PreparedRun
from metrosep.separation.runs.geometry import (
    Extension,
    Sensor,
    Spectrum,
    extension,
    filtered,
)
from metrosep.separation.runs.leave_out import RunScore, displacement, run_scores
from metrosep.separation.runs.lines import Terms
from metrosep.separation.runs.noise import (
    MissingSamples,
    NoiseModel,
    burg,
    exact_rows,
    fit_noise,
    level_spread,
)
from metrosep.separation.runs.posterior import Model, RunEquations, Slip, Wave, averaged
from metrosep.separation.runs.sensor import LAG_PRIOR, chance_of_lag, lag_score, likely_lag
from metrosep.separation.runs.slip import what_repeats
from metrosep.separation.runs.system import System
from metrosep.separation.runs.waves import _scores, find_slip

DT, SPEEDS, SIZES, K = 0.004, (80.0, 120.0, 160.0), (76, 51, 39), 6
DIGITS = 1e-6
"""Relative: the references have eight to ten digits, some are differences of larger numbers."""


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=DIGITS, atol=1e-9)


def reading(r):
    i = np.arange(SIZES[r])
    x, t = SPEEDS[r] * DT * i, DT * i
    noise = 8 * np.sin(1.7 * i**2 + 0.9 * r) + 5 * np.cos(2 * math.pi * 11 * t + r)
    return x, 100 * np.cos(2 * math.pi * x / 6.5 + 0.4) + noise, noise


@pytest.fixture(scope="module")
def noise():
    filters, variances = burg([reading(r)[2] for r in range(3)], 3)
    return NoiseModel(filters, variances, DT)


@pytest.fixture
def model(noise):
    """The model of the notes: no line, no waves, s_k^2 = 3000 k^-2.5."""
    extension = Extension(0.0, 24.0, K)
    equations = []
    for r in range(3):
        x, z, _ = reading(r)
        basis = extension.basis(x)
        basis[:, 0] = 0.0
        table = np.column_stack([basis, z - z.mean(), np.ones(x.size)])
        rows = exact_rows([table], noise, [slice(0, x.size)])
        a, y, o = rows[:, :-2], rows[:, -2], rows[:, -1]
        oo = float(o @ o)
        equations.append(
            RunEquations(
                a.T @ a - np.outer(a.T @ o, a.T @ o) / oo,
                a.T @ y - a.T @ o * float(o @ y) / oo,
                a.T @ o / oo,
                float(o @ y) / oo,
                oo,
                SPEEDS[r],
                r,
                24.0,
            )
        )
    made = Model(extension, Spectrum(K), slip_is_geometry=False)
    made.spectrum.hats = np.column_stack([np.ones(K), np.log(np.arange(1, K + 1))])
    made.spectrum.phi = np.array([math.log(3000.0), -2.5])
    made.take(equations)
    made.solve()
    return made


def slip_of_4():
    """The fourth harmonic, as a wave that slips."""
    return Slip(4.0 / 33.6, np.eye(1 + 2 * K)[:, [4, 4 + K]], 400.0)


def test_unknown_samples_are_those_of_a_gaussian_process_given_the_known():
    """Noise of first order with variance 1/(1 - c^2) and covariance c^|k| of it, by its own matrix."""
    c, n, rng = 0.8, 40, np.random.default_rng(5)
    noise = NoiseModel((np.ones(1), np.array([1.0, -c])), np.array([1.0 / (1.0 - c * c), 1.0]), DT)
    covariance = c ** np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / (1.0 - c * c)
    z = np.linalg.cholesky(covariance) @ rng.standard_normal(n)
    unknown = np.zeros(n, dtype=bool)
    unknown[[3, 4, 5, 11, 13, 30]] = True
    parts, zeroed = [slice(0, n)], np.where(unknown, 0.0, z)[:, None]

    made = MissingSamples(unknown, noise, parts)
    rows = exact_rows([zeroed], noise, parts)
    expected, drawn = made.expected(rows)[:, 0], made.drawn(rng, 40_000)
    made.take_out(rows)

    known = ~unknown
    gain = covariance[np.ix_(unknown, known)] @ np.linalg.inv(covariance[np.ix_(known, known)])
    np.testing.assert_allclose(expected, gain @ z[known], rtol=0.0, atol=1e-12)
    likelihood = z[known] @ np.linalg.solve(covariance[np.ix_(known, known)], z[known])
    assert float(rows[:, 0] @ rows[:, 0]) == pytest.approx(likelihood, abs=1e-10)
    spread = covariance[np.ix_(unknown, unknown)] - gain @ covariance[np.ix_(known, unknown)]
    # 40,000 draws know a covariance to about sqrt(2/40000) = 0.007 of a variance of 1 to 2; 5 sd
    np.testing.assert_allclose(np.cov(drawn), spread, rtol=0.0, atol=0.07)


def test_whitening_is_exact_from_the_first_sample(noise):
    z = reading(0)[1][:60]
    white = exact_rows([z[:, None]], noise, [slice(0, 60)])[:, 0]
    # the autocovariance of the model, by its innovations form, and its Cholesky factor
    size, lead = 60, 4000
    response = np.zeros(lead)
    response[0] = 1.0
    for i in range(1, lead):
        response[i] = -sum(noise.filters[-1][m] * response[i - m] for m in range(1, min(i, 3) + 1))
    r = [noise.variance * response[: lead - k] @ response[k:] for k in range(size)]
    covariance = np.array([[r[abs(i - j)] for j in range(size)] for i in range(size)])
    np.testing.assert_allclose(
        white, np.linalg.solve(np.linalg.cholesky(covariance), z), rtol=1e-9, atol=1e-9
    )


def test_curve_and_its_band(model):
    x = np.arange(241) * 0.1
    basis = model.extension.basis(x)[:, 1:]
    line = np.column_stack([np.ones(x.size), x])
    basis = basis - line @ np.linalg.lstsq(line, basis, rcond=None)[0]
    at = [0, 60, 120, 180, 240]
    curve = basis @ model.post.theta[1:]
    sd = np.sqrt(np.sum((basis @ model.post.full_root[1:]) ** 2, axis=1))
    close(curve[at], [99.36404368, 99.97297734, 89.86607992, 56.18704737, 13.92192335])
    close(sd[at], [3.40017033, 2.1335241, 2.27998164, 2.13032216, 3.14722336])


@pytest.mark.parametrize("velocity", [120.0, -120.0])
def test_a_late_reading_shows_the_error_of_the_place_before(velocity):
    """Coefficients through a delay are those of g(x - v d), for both directions of travel."""
    rng = np.random.default_rng(3)
    extension = Extension(0.0, 24.0, K)
    theta = np.concatenate([[0.0], rng.normal(size=2 * K)])
    x = np.linspace(3.0, 20.0, 40)
    read = filtered(theta, Sensor(2e-3, 0.0).response(extension.wavenumbers, velocity))
    np.testing.assert_allclose(
        extension.basis(x)[:, 1:] @ read[1:],
        extension.basis(x - velocity * 2e-3)[:, 1:] @ theta[1:],
        rtol=0.0,
        atol=1e-12 * float(np.abs(theta).sum()),
    )


@pytest.mark.parametrize(("apart", "groups", "away"), [(2e-5, 3, 1e-5), (1e-2, 6, 1e-12)])
def test_runs_of_one_velocity_are_turned_as_one(model, apart, groups, away):
    """Against each run by itself, slip as an unknown of its own and the sensor as a matrix.

    The mean velocity of two is off by 1e-5: 1e-6 of a phase of up to 0.2 rad, squared sums of it.
    """
    more = [
        replace(r, gram=1.3 * r.gram, right=0.7 * r.right, velocity=r.velocity * (1.0 + apart))
        for r in model.runs
    ]
    c, w = model.extension.wave(0.11), model.extension.wavenumbers  # between harmonics
    model.slip, model.sensor = [Slip(0.11, c, 400.0)], Sensor(1e-3, 2.5e-7)
    model.take([*model.runs, *more])
    gram, right = 0.0, 0.0
    for run in model.runs:
        own = np.linalg.inv(c.T @ run.gram @ c + np.eye(2) / 400.0)
        h = np.exp(-1j * w * run.velocity * 0.5e-3) / (1 + 1j * w * run.velocity * 0.5e-3)
        turn = np.eye(1 + 2 * K)
        turn[1:, 1:] = np.block(
            [[np.diag(h.real), np.diag(h.imag)], [np.diag(-h.imag), np.diag(h.real)]]
        )
        held = run.gram @ c @ own
        gram = gram + turn.T @ (run.gram - held @ c.T @ run.gram) @ turn
        right = right + turn.T @ (run.right - held @ c.T @ run.right)

    assert len(model.by_speed) == groups
    assert np.abs(model.total[0] - gram).max() < away * np.abs(gram).max()
    assert np.abs(model.total[1] - right).max() < away * np.abs(right).max()
    each = sum(run.gram for run in model.seen)
    assert np.abs(each - gram).max() < 1e-12 * np.abs(gram).max()


def test_what_separations_of_one_travel_share_is_of_that_travel_and_stays_as_it_is():
    """Columns of a wave from the origin of each; what one separation could write into, the next would read."""
    HELD = 1e-5  # of a wave between harmonics; the ridge of the basis leaves 2e-6
    x = np.linspace(3.0, 20.0, 40)
    for start, travel, n, origin in ((0.0, 24.0, 40, 0.0), (1.0, 24.0, 40, 0.0), (0.0, 23.0, 40, 0.0),
                                     (0.0, 24.0, 41, 0.0), (0.0, 24.0, 40, 2.0)):  # fmt: skip
        for _ in range(2):
            ext = extension(start, travel, n, origin)
            basis, (pair, *_) = ext.basis(x), np.hsplit(ext.wave(0.11), 1)
            expected = np.cos(2.0 * np.pi * 0.11 * (x - origin))
            np.testing.assert_allclose(basis @ pair[:, 0], expected, rtol=0.0, atol=HELD)
            assert (ext.n, ext.travel, ext.start, ext.origin) == (n, travel, start, origin)
            for shared in (ext.grid, *ext.scan()):
                with pytest.raises(ValueError, match="read-only"):
                    shared[0] = 1.0
    assert extension(0.0, 24.0, 40, 2.0) is ext


@pytest.mark.parametrize("odd", ["none", "gap", "place", "gain"])
def test_equations_of_runs_at_one_place_are_those_of_each_alone(odd):
    """Four passes with readings of their own, one with a gap, elsewhere, or read with another gain.

    Against the inverse of the covariance of the noise, whose first samples know no earlier one.
    """
    rng = np.random.default_rng(8)
    x, step, k = np.linspace(0.0, 24.0, 40), 0.005, 5
    z = rng.standard_normal((4, x.size))
    z[2, 17:20] = np.nan if odd == "gap" else z[2, 17:20]
    places = [x, x, x + (0.01 if odd == "place" else 0.0), x]
    runs = [
        PreparedRun(p, own, 120.0, step, 1, 0.0, str(i), step * np.arange(x.size))
        for i, (p, own) in enumerate(zip(places, z, strict=True))
    ]
    terms = Terms(runs, drift=0, locked=False, several_feeds=False, set_up_anew=False)
    extension = Extension(0.0, 24.0, k)
    system = System(runs, extension=extension, terms=terms)
    system.noise = [NoiseModel((np.ones(1), np.array([1.0, -0.6])), np.array([1.0, 0.64]), step)]
    if odd == "gain":
        system.gain[2] = 1.3
    found = system.equations(Model(extension, Spectrum(k)))

    lag = np.abs(np.subtract.outer(np.arange(x.size), np.arange(x.size)))
    for i, run in enumerate(found):
        known = ~np.isnan(z[i])
        inverse = np.linalg.inv(
            (0.6**lag)[np.ix_(known, known)]
        )  # of unit variance: 0.64/(1 - 0.36)
        gains = np.append(1.0, np.full(2 * k, system.gain[i]))
        a, y = (extension.basis(places[i]) * gains)[known], system.z[i][known]
        one = inverse.sum(axis=0)
        inverse -= np.outer(one, one) / one.sum()  # the offset is free
        np.testing.assert_allclose(run.gram, a.T @ inverse @ a, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(run.right, a.T @ inverse @ y, rtol=0.0, atol=1e-10)
        assert run.level_right == pytest.approx(one @ y / one.sum(), abs=1e-12)
        np.testing.assert_allclose(run.level, one @ a / one.sum(), rtol=0.0, atol=1e-12)


def test_a_solution_follows_whatever_changed_since_the_last(model):
    """Waves, their strength, the spectrum, the harmonics in use or the matrix, against a dense solution."""
    ext = model.extension

    def check():
        post, on, columns = model.solve(), model.used(), [w.columns for w in model.waves]
        table = np.hstack([np.eye(1 + 2 * K)[:, on], *columns])
        normal = table.T @ model.total[0] @ table + np.diag(model.precision())
        covariance = table @ np.linalg.inv(normal) @ table.T
        close(post.theta, covariance @ model.total[1])
        close(post.covariance(), covariance)
        side = table.T @ model.total[1]
        logs = np.linalg.slogdet(normal)[1] - np.log(model.precision()).sum()
        close(post.evidence, 0.5 * (side @ np.linalg.solve(normal, side) - logs))

    check()
    model.waves = [Wave(0.11, ext.wave(0.11), 500.0), Wave(0.17, ext.wave(0.17), 80.0)]
    check()
    model.waves[1].variance = 9.0
    check()
    pair = model.post.mean[model.wave_parts()[0]]
    change = ext.wave_change(0.11, pair)
    model.waves[0].columns = np.column_stack([ext.wave(0.11), change])
    check()
    model.spectrum.phi = model.spectrum.phi + 0.7
    check()
    model.kept = K - 2
    check()
    model.sensor = Sensor(2e-3, 1e-6)
    model.apply()
    close(model.total[0], sum(r.gram for r in model.seen))
    check()
    model.take([replace(r, gram=2.0 * r.gram, right=1.5 * r.right) for r in model.runs])
    check()
    model.waves.clear()
    check()


@pytest.mark.parametrize("level", [1e-9, 1e9])
@pytest.mark.parametrize("steep", [-2.5, -6.0, 1.0])
def test_octaves_that_are_not_seen_go_back_to_the_power_law(steep, level):
    """Two octaves are seen: of the slope's distance from -2.5 a share rho is left in each further one.

    Slopes of sd 1.5 that change by sd 1/ln 2 from octave to octave: 2 1.5^2 (1 - rho) = 1/ln^2 2.
    The level has no part in it: its prior would else bend the unseen octaves up.
    """
    spectrum, sure = Spectrum(64), np.zeros(64)  # knots at 1, 2, 4 ... 64
    sure[:2] = 1e6
    seen = math.log(level) + np.array([0.0, steep * math.log(2.0)])
    for _ in range(60):
        score = np.zeros(64)
        score[:2] = 1e6 * (seen - np.log(spectrum.variance[:2]))
        spectrum.step(score, sure)

    rho = 1.0 - 1.0 / (2.0 * 1.5**2 * math.log(2.0) ** 2)
    slopes = np.diff(np.log(spectrum.variance[[0, 1, 3, 7, 15, 31, 63]])) / math.log(2.0)
    # what is seen holds against the priors by 1e6; the ridge of the equations is 1e-9
    assert np.abs(slopes - (-2.5 + (steep + 2.5) * rho ** np.arange(6))).max() < 1e-4


def test_the_mean_of_two_answers_holds_both():
    """Mean and covariance of draws of which a share p comes from one, the rest from the other."""
    rng = np.random.default_rng(4)
    one = np.array([3.0, -1.0]), np.array([[2.0, 0.3], [0.3, 1.0]])
    none = np.array([0.0, 1.0]), np.array([[0.5, -0.1], [-0.1, 0.7]])
    n, p = 400_000, 0.3
    first = rng.random(n) < p
    draws = np.where(
        first[:, None],
        rng.multivariate_normal(*one, n),
        rng.multivariate_normal(*none, n),
    )
    mean, covariance = averaged([p, 1.0 - p], [one[0], none[0]], [one[1], none[1]])
    four_sd = 4.0 * math.sqrt(float(np.trace(covariance)) / n)
    np.testing.assert_allclose(mean, draws.mean(axis=0), rtol=0.0, atol=four_sd)
    np.testing.assert_allclose(covariance, np.cov(draws.T), rtol=0.0, atol=5 * four_sd)


def test_a_displaced_run_is_found_where_it_is(model):
    """A run that shows the error of the place x - 0.5 mm is displaced by +0.5 mm."""
    moved = Extension(0.0, 24.0, K)
    before = run_scores(model)[1]
    theta = model.post.theta
    h = np.exp(-1j * moved.wavenumbers * 0.5)
    change = filtered(theta, h) - theta
    runs = list(model.runs)
    run = runs[1]
    runs[1] = type(run)(
        run.gram,
        run.right + run.gram @ change,
        run.level,
        run.level_right + float(run.level @ change),
        run.level_information,
        run.velocity,
        run.feed,
        run.length,
    )
    model.take(runs)
    model.solve()
    found = run_scores(model)[1]
    assert abs(found.shift - 0.5) < 4.0 * found.u_shift
    assert found.shift > 8.0 * found.u_shift
    # what is left of the misfit is that of the run before it was moved
    assert found.chi2 > 3.0 * found.chi2_placed
    assert found.chi2_placed == pytest.approx(before.chi2, abs=0.5)


def places(rng, sd):
    """Return a model and scores that hold the places of nine runs and no more."""
    model = Model(Extension(0.0, 24.0, K), Spectrum(K))
    empty = np.empty(0)
    model.runs = [
        RunEquations(empty, empty, empty, 0.0, 1.0, 1e-3 * v, feed, 24.0)
        for feed, v in enumerate(SPEEDS)
        for _ in range(3)
    ]
    at = sd * rng.standard_normal(len(model.runs))
    return model, [RunScore(1.0, 10, 1.0, 1e-3, d, 1e-9, empty) for d in at]


def test_the_size_of_a_displacement_is_known_as_six_degrees_of_freedom_know_it():
    """Sum of squares S about the feedrates: the mean variance is S/(6 - 2), not S/6 or less."""
    for seed in range(5):
        model, scores = places(np.random.default_rng(seed), 30e-6)
        shifts = np.array([s.shift for s in scores]).reshape(3, 3)
        squares = float(((shifts - shifts.mean(axis=1, keepdims=True)) ** 2).sum())
        squares *= (8.0 / 9.0) ** 2  # a run moves the others, too
        found = displacement(model, scores)
        assert found.sd**2 == pytest.approx(invgamma(3.0, scale=squares / 2.0).mean(), abs=2e-12)
        assert found.of_mean == pytest.approx(found.sd**2 / 9.0, abs=1e-15)


@pytest.mark.parametrize("t", [0.5, 2.0, 3.1, 5.0])
def test_a_lag_of_displaced_runs_is_as_likely_as_student_says(t):
    """Without a lag the lag over its estimated u is t of six degrees, whose tails are long."""
    model, scores = places(np.random.default_rng(3), 30e-6)
    found = displacement(model, scores)
    model.lag_variances = found.lags
    scale = math.sqrt(model.lag_variance * 4.0 / 6.0)  # of t: the mean variance is 6/4 of it
    lag = t * scale
    # a lag of the machine beside what the displacement is: the sum of both, by steps
    grid = lag + np.linspace(-60.0, 60.0, 40_001) * scale
    with_lag = cauchy.pdf(grid, scale=LAG_PRIOR) * student.pdf((lag - grid) / scale, 6) / scale
    some = with_lag.sum() * (grid[1] - grid[0])
    none = student.pdf(t, 6) / scale
    p = chance_of_lag(lag, 1e-14, displaced=model.lag_variances)
    assert p == pytest.approx(some / (some + none), abs=2e-3)


def read_with_a_lag(lag, u):
    """Density of a lag that is read with u, where the machine has one: an integral by steps."""

    def both(angle):  # lag = LAG_PRIOR tan(angle) is even in the angle
        return norm.pdf(lag, loc=LAG_PRIOR * math.tan(angle), scale=u) / math.pi

    edge = 0.5 * math.pi
    parts = sorted({-edge, math.atan(lag / LAG_PRIOR), edge, 1.5, -1.5, 1.57, -1.57})
    return sum(quad(both, a, b, epsabs=1e-12, limit=200)[0] for a, b in pairwise(parts))


@pytest.mark.parametrize(("read", "u"), [(0.3e-3, 0.9e-3), (-2.5e-3, 0.9e-3), (9e-3, 0.3e-3)])
def test_a_lag_is_drawn_to_none_as_far_as_it_is_not_known(read, u):
    """Mean and variance by draws of the prior, weighed by what is read; a long lag stays."""
    drawn = LAG_PRIOR * np.tan(math.pi * (np.arange(2_000_000) + 0.5) / 2_000_000 - 0.5 * math.pi)
    weight = np.exp(-0.5 * ((drawn - read) / u) ** 2)
    weight /= weight.sum()
    mean = float(weight @ drawn)

    found, variance = likely_lag(read, u**2, LAG_PRIOR)

    assert found == pytest.approx(mean, abs=2e-3 * u)
    assert math.sqrt(variance) == pytest.approx(
        math.sqrt(float(weight @ (drawn - mean) ** 2)), abs=5e-3 * u
    )
    assert likely_lag(read, u**2, 0.0) == (read, u**2)  # lag="fit" takes what is read


def test_the_chance_of_a_lag_holds_where_the_runs_lie_far_apart():
    """Variances of 0 and 2 s^2 beside an own one of 1e-17: their mean takes all its digits."""
    sizes = np.array([0.0, 2.0]), np.array([0.5, 0.5])
    for lag in (0.0, 3e-9, 1e-3):
        few = norm.pdf(lag, scale=math.sqrt(1e-17)) + norm.pdf(lag, scale=math.sqrt(2.0))
        # beside the lag the first variance is nothing, and beside the second the lag is
        some = cauchy.pdf(lag, scale=LAG_PRIOR) + read_with_a_lag(lag, math.sqrt(2.0))
        p = chance_of_lag(lag, 1e-17, displaced=sizes)
        assert p == pytest.approx(some / (some + few), abs=1e-9)


def test_a_wave_of_any_wavelength_is_a_column_of_the_basis():
    """Up to 0.9 of the highest wavenumber the extension holds a wave to a thousandth."""
    extension = Extension(0.0, 56.0, 60)
    x = np.linspace(0.0, 56.0, 999)
    for wavelength in (55.0, 9.37, 3.001, extension.period / 60 / 0.9):
        columns = extension.basis(x) @ extension.wave(1.0 / wavelength)
        phase = 2 * math.pi * x / wavelength
        np.testing.assert_allclose(columns[:, 0], np.cos(phase), rtol=0.0, atol=1e-3)
        np.testing.assert_allclose(columns[:, 1], np.sin(phase), rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("way", [1, -1])
def test_a_late_reading_of_a_wave_is_right_from_the_first_sample(way):
    """What the sensor saw before the run began is the wave itself, not a basis that falls away."""
    extension = Extension(0.0, 56.0, 196)
    x, tau, v = np.linspace(0.0, 56.0, 999), 3.2e-3, 160.0 * way
    for wavelength in (49.0, 12.0, 5.3, 4.0):
        w = 2.0 * math.pi / wavelength
        read = np.exp(1j * w * x) / (1.0 + 1j * w * v * tau)  # first order, after all start-up
        h = Sensor(tau, tau**2).response(extension.wavenumbers, v)
        found = extension.basis(x) @ filtered(extension.wave(1.0 / wavelength), h)
        # 0.34 of the wave of 12 mm were missing at the start of a run; the line is not filtered
        np.testing.assert_allclose(found[:, 0] - read.real, 0.0, rtol=0.0, atol=2e-3)
        np.testing.assert_allclose(found[:, 1] - read.imag, 0.0, rtol=0.0, atol=2e-3)


@pytest.mark.parametrize(("lag", "constant"), [(1e-3, 0.5e-3), (3e-3, 3e-3), (-1e-3, 2e-3)])
def test_the_gradient_of_the_evidence_with_the_lag_is_its_difference_quotient(
    model, lag, constant
):
    """The spread of the solution counts: without it the time constant is drawn to zero."""

    def evidence(lag, spread):
        model.sensor = Sensor(lag, spread)
        model.apply()
        return model.solve().evidence

    evidence(lag, constant**2)
    at = lag_score(model)
    dl, dq = 1e-7, 1e-10
    slope = [
        (evidence(lag + dl, constant**2) - evidence(lag - dl, constant**2)) / (2.0 * dl),
        (evidence(lag, constant**2 + dq) - evidence(lag, constant**2 - dq)) / (2.0 * dq),
    ]
    np.testing.assert_allclose(at.gradient, slope, rtol=1e-4)
    assert abs(at.trace[1]) > 0.01 * abs(slope[1])


def test_equations_of_a_slipping_run_that_have_no_factor_are_refused(model):
    """A matrix that no readings can have: what came of it passed as a solution."""
    broken = replace(model.runs[0], gram=-1e6 * np.eye(model.runs[0].gram.shape[0]))
    model.slip = [slip_of_4()]
    model.take([broken, *model.runs[1:]])

    with pytest.raises(DegenerateFitError, match="do not determine"):
        _ = model.total


@pytest.mark.parametrize("n_extra", [0, 2])
def test_the_score_of_a_wave_is_by_how_much_two_free_columns_lessen_the_sum_of_squares(n_extra):
    rng = np.random.default_rng(5)
    ext = Extension(0.0, 24.0, K)
    n, rows = 1 + 2 * K, 40
    a, y = rng.standard_normal((rows, n + n_extra)), rng.standard_normal(rows)
    a[:, n:] += 2.0 * a[:, 1 : 1 + n_extra]  # a drift looks like the longest waves
    model = Model(ext, Spectrum(K), n_extra=n_extra, extra_precision=np.full(n_extra, 0.3))
    model.waves.append(Wave(0.13, ext.wave(0.13), 0.7))
    model.kept = 4
    own = RunEquations(a.T @ a, y @ a, np.zeros(n + n_extra), 0.0, 1.0, 80.0, 0, 24.0)
    model.take([own])
    pairs = np.hstack([ext.wave(0.07), ext.wave(0.2)])

    k = np.arange(4)
    used = np.concatenate([[0], 1 + k, 1 + K + k, n + np.arange(n_extra)])
    seen = np.hstack([a[:, used], a[:, :n] @ model.waves[0].columns])
    prior = np.sqrt(model.precision())

    def least_squares(*more):
        free = np.hstack([np.empty((rows, 0)), *more])
        table = np.block([[seen, free], [np.diag(prior), np.zeros((prior.size, free.shape[1]))]])
        side = np.concatenate([y, np.zeros(prior.size)])
        rest = side - table @ np.linalg.lstsq(table, side, rcond=None)[0]
        return rest @ rest

    found = _scores(model, pairs, model.total[0][:, :n] @ pairs)
    expected = [least_squares() - least_squares(a[:, :n] @ pairs[:, i : i + 2]) for i in (0, 2)]
    assert found == pytest.approx(expected, abs=1e-8)
    assert min(expected) > 1e-3


def test_runs_that_agree_have_no_slip(model):
    assert not find_slip(model)


class DrawnSlip:
    """Draws of what repeats and of the size of what slips, with their chances; phases are summed over.

    Before: kappa 1 or a half, a quarter and so on down to the noise, ln Lambda flat over some room, c of
    0 to 1 of what slips, and beside c what the spectrum has. Or nothing slips, and turns of the runs
    (three sizes, each over its step of the logarithm) leave one circle about nothing.
    """

    def __init__(self, rng, reads, noise, middle, spread, count, *, beside=0.0, turns=None):
        weights = 1.0 / (np.median(noise) + np.asarray(noise))
        away = reads - weights @ reads / weights.sum()
        size = 0.5 * weights @ np.sum(away**2, axis=1) / weights.sum()
        size *= len(reads) / (len(reads) - 1.0)
        halves = 2 + math.ceil(0.5 * math.log2(size / np.median(noise)))
        room = 1.0 + 3.0 / math.sqrt(len(reads) - 1.0)
        kappa = 0.5 ** rng.integers(1, halves, count)
        self.size = size * np.exp(rng.uniform(-room, room, count))
        before = beside + (0.25 * rng.integers(0, 5, count)) ** 2 * self.size
        some = before > 0.0
        self.sum = some * (middle + spread * rng.normal(size=(2, count)))
        drawn = 0.5 * np.sum((self.sum - middle) ** 2, axis=0) / spread**2
        drawn -= 0.5 * np.sum(self.sum**2, axis=0) / np.maximum(before, 1e-9)
        drawn -= np.log(np.maximum(before, 1e-9) / spread**2)
        self.logs = np.where(some, drawn, 0.0)
        self.turned = (rng.random(count) < 0.5) & (turns is not None)
        kappa = np.where(self.turned | (rng.random(count) < 0.5), kappa, 1.0)
        kappa = np.where(self.turned, 0.5 ** rng.integers(1, halves, count), kappa)
        self.scatter = kappa**2 * self.size
        self.radius = np.sqrt(2.0 * (self.size - ~self.turned * self.scatter))
        self.angle = rng.uniform(0.0, 2.0 * np.pi, count)
        self.phases = np.zeros(count)
        if turns is not None:
            at = rng.choice(len(turns[0]), count, p=turns[1])
            step = math.log(turns[0][-1] / turns[0][1]) / (len(turns[0]) - 2.0)
            turn = np.array(turns[0])[at] * np.exp(step * rng.uniform(-0.5, 0.5, count))
            self.logs = np.where(self.turned, np.where(at > 0, 0.0, -1e9), self.logs)
            self.phases = np.where(self.turned, 1.0 / np.maximum(turn, 0.1) ** 2, 0.0)
            own = self.radius * np.array([np.cos(self.angle), np.sin(self.angle)])
            self.sum = np.where(self.turned, own, self.sum)
            before = np.where(self.turned, beside + self.size, before)
        self.share = beside / np.maximum(before, 1e-9)  # of the spectrum in the sum

    def shown(self, pairs, noise):
        """Take what a run shows, shape (2, n), its noise (2, 2)."""
        inverse = np.linalg.inv(noise + self.scatter[:, None, None] * np.eye(2))
        centre = np.where(self.turned, 0.0, self.sum)
        total = 0.0
        for phase in np.arange(80) * np.pi / 40.0:
            away = pairs - centre - self.radius * np.array([[np.cos(phase)], [np.sin(phase)]])
            near = np.exp(self.phases * (np.cos(phase - self.angle) - 1.0)) / i0e(self.phases)
            total = total + near * np.exp(-0.5 * np.einsum("ik,kij,jk->k", away, inverse, away))
        self.logs += np.log(total + 1e-300) + 0.5 * np.log(np.linalg.det(inverse))

    def of(self, values):
        """Mean, root of the variances and number of draws of values."""
        chance = np.exp(self.logs - self.logs.max())
        chance /= chance.sum()
        mean = values @ chance
        return mean, np.sqrt((values - mean[:, None]) ** 2 @ chance), 1.0 / (chance @ chance)


NOWHERE = np.zeros(1), np.ones(1)
TURNS = np.array([0.0, 0.2, 0.3, 0.45]), np.array([0.4, 0.2, 0.2, 0.2])


@pytest.mark.parametrize("own", [20.0, 900.0])
@pytest.mark.parametrize(
    ("size", "angle", "turns"),
    [
        (60.0, [0.3, 1.6, 3.5, 5.4], None),
        ([20.0, 90.0, 70.0, 45.0], [0.3, 1.6, 3.5, 5.4], None),
        (80.0, [0.3, 1.3, 0.7, 1.6], TURNS),
    ],
    ids=["alike", "scattered", "turned"],
)
def test_what_repeats_under_a_slip_is_the_centre_of_what_the_runs_show(size, angle, turns, own):
    """Against draws of all that is not known: sizes, phases, what repeats beside the spectrum and in it."""
    rng, count = np.random.default_rng(8), 200_000
    sd = np.array([14.0, 20.0, 17.0, 25.0])
    pairs = (np.asarray(size) * np.array([np.cos(angle), np.sin(angle)])).T
    if turns is None:
        pairs = pairs + np.array([25.0, -30.0])
    found = what_repeats(pairs, sd**2, own, turns or NOWHERE)

    middle = 0.5 * pairs.mean(axis=0)[:, None]
    draws = DrawnSlip(rng, pairs, sd**2, middle, 30.0, count, beside=own, turns=turns)
    for pair, u in zip(pairs, sd, strict=True):
        draws.shown(pair[:, None], u**2 * np.eye(2))
    spectrum = np.sqrt(own * (1.0 - draws.share)) * rng.normal(size=(2, count))
    spectrum += draws.share * draws.sum
    mean, spread, n = draws.of(np.vstack([spectrum, draws.sum - spectrum]))
    assert n > 1500
    # 4 sd of a mean and of a variance of so many draws, and a grid that blurs both by 2 %
    assert (found.mean - mean) / spread == pytest.approx(0.0, abs=4.0 / math.sqrt(n) + 0.02)
    ratio = np.sqrt(np.diag(found.covariance)) / spread
    assert ratio == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * n) + 0.02)


def test_the_answer_beside_a_slip_is_that_of_all_unknowns_together(model, monkeypatch):
    """Against draws of the geometry with the slip free in each run, weighed by what that leaves of it."""
    monkeypatch.setattr(Model, "_louder", lambda self: [])  # the level of the noise is known
    rng, n, count = np.random.default_rng(9), 1 + 2 * K, 60_000
    angle = np.array([0.4, 2.3, 4.6])
    shown = 60.0 * np.array([np.cos(angle), np.sin(angle)]).T + [20.0, 15.0]
    columns = slip_of_4().columns
    runs = [
        # ten times the noise, so that 80 phases of a circle of 60 lie within it
        replace(r, gram=0.01 * r.gram, right=0.01 * (r.right + r.gram @ columns @ pair))
        for r, pair in zip(model.runs, shown, strict=True)
    ]
    model = Model(Extension(0.0, 24.0, K), Spectrum(K))
    model.spectrum.phi = model.spectrum.phi + math.log(3000.0)
    model.slip = [slip_of_4()]
    model.take(runs)
    found = model.answer()

    gram, right = (
        np.diag(np.append(model.line_sd**-2, np.tile(1 / model.spectrum.variance, 2))),
        0.0,
    )
    for run in runs:
        free = run.gram @ columns @ np.linalg.inv(columns.T @ run.gram @ columns)
        gram = gram + run.gram - free @ columns.T @ run.gram
        right = right + run.right - free @ columns.T @ run.right
    mean = np.linalg.solve(gram, right)
    geometry = mean[:, None] + np.linalg.cholesky(np.linalg.inv(gram)) @ rng.normal(
        size=(n, count)
    )
    reads = [
        np.linalg.solve(
            columns.T @ r.gram @ columns, columns.T @ (r.right[:, None] - r.gram @ geometry)
        )
        for r in runs
    ]
    noise = [np.linalg.inv(columns.T @ r.gram @ columns) for r in runs]
    middle = np.mean(reads, axis=0)
    squares = [0.5 * np.trace(u) for u in noise]
    draws = DrawnSlip(rng, np.mean(reads, axis=2), squares, 0.5 * middle, 25.0, count)
    for pairs, u in zip(reads, noise, strict=True):
        draws.shown(pairs, u)
    mean, spread, seen = draws.of(geometry + columns @ draws.sum)
    assert seen > 2000
    assert (found.mean - mean) / spread == pytest.approx(0.0, abs=0.1)
    assert np.sqrt(np.diag(found.plain)) / spread == pytest.approx(1.0, abs=0.1)
    assert model.slip[0].variance == slip_of_4().variance  # as it was


def test_a_slip_that_is_taken_for_all_there_is_of_its_length_has_one_answer(model):
    """`slip="sparse"`: nothing of it repeats."""
    runs = model.runs
    model = Model(Extension(0.0, 24.0, K), Spectrum(K), slip_is_geometry=False)
    model.spectrum.phi = model.spectrum.phi + math.log(3000.0)
    model.slip = [slip_of_4()]
    model.take(runs)
    close(model.answer().mean, model.solve().theta)


def test_what_is_not_known_of_the_spectrum_is_in_the_band_twice(model):
    """By differences of the mean: as it scatters with the spectrum, and as the variance comes out too small."""
    runs = model.runs
    model = Model(Extension(0.0, 24.0, K), Spectrum(K))
    model.spectrum.phi = model.spectrum.phi + math.log(3000.0)
    model.take(runs)
    post = model.solve()
    found = model.answer()
    found = found.covariance - found.plain
    at, steps = model.spectrum.phi.copy(), 1e-4 * np.eye(model.spectrum.phi.size)

    def mean(phi):
        model.spectrum.phi = phi
        return model.solve().theta

    moved = np.column_stack([(mean(at + d) - mean(at - d)) / 2e-4 for d in steps])
    model.spectrum.phi = at
    known = 1.0 - np.diag(post.covariance())[1:].reshape(2, -1) / model.spectrum.variance
    hats = model.spectrum.hats
    information = hats.T @ (0.5 * np.sum(known**2, axis=0)[:, None] * hats)
    spread = np.linalg.inv(information + model.spectrum.precision)
    expected = 2.0 * moved @ spread @ moved.T

    # central differences of 1e-4 in ln s^2 are good to 1e-8, the inverse to a ridge of 1e-9
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.diag(expected).max())
    assert np.diag(expected).max() > 1e-4 * np.diag(post.covariance())[1:].max()


def test_a_resonance_is_found():
    """A second-order process has its density, whatever the order."""
    rng = np.random.default_rng(5)
    a = (-1.6, 0.9)
    draws = [lfilter([1.0], [1.0, *a], rng.normal(size=4000))[:, None] for _ in range(4)]
    model = fit_noise(draws, time_step=1e-3, most=48)
    np.testing.assert_allclose(model.filters[2][1:], a, rtol=0.0, atol=0.02)  # 4 / sqrt(16000)
    assert model.variance == pytest.approx(1.0, rel=0.05, abs=0.0)
    f = np.array([10.0, 50.0, 90.0, 200.0]) * 1e-3
    true = np.abs(np.exp(-2j * np.pi * np.outer(f, range(3))) @ np.array([1.0, *a])) ** -2.0
    found = np.abs(np.exp(-2j * np.pi * np.outer(f, range(49))) @ model.filters[-1]) ** -2.0
    # a density of 48 coefficients from 16000 samples is known to sqrt(2 * 48 / 16000) = 8 %
    np.testing.assert_allclose(found / true, 1.0, rtol=0.0, atol=0.25)


def test_slow_noise_of_short_runs_has_its_density():
    """What lasts a run is resolved: its level decides how wide the band of long waves is."""
    dt, f0, zeta = 1e-3, 3.0, 0.5
    r = np.exp(-zeta * 2.0 * np.pi * f0 * dt)
    own = [1.0, -2.0 * np.cos(2.0 * np.pi * f0 * np.sqrt(1.0 - zeta**2) * dt) * r, r * r]
    f = np.array([2.0, 3.0, 4.0])
    true = np.abs(np.exp(-2j * np.pi * dt * np.outer(f, np.arange(3))) @ own) ** -2.0
    logs = []
    for seed in range(12):
        rng = np.random.default_rng([77, seed])
        draws = []
        for length in (700, 700, 350, 350):
            n = lfilter([1.0], own, rng.standard_normal(length + 3000))[3000:]
            draws.append(n[:, None])
        size = np.sqrt(np.mean(np.concatenate(draws) ** 2))
        jitter = 0.2 * np.random.default_rng(seed).standard_normal((2100, 1))  # of the reading
        ends = np.cumsum([0, 700, 700, 350, 350])
        scaled = [
            d / size + jitter[a:b] for d, a, b in zip(draws, ends[:-1], ends[1:], strict=True)
        ]
        model = fit_noise(scaled, time_step=dt)
        z = np.exp(-2j * np.pi * dt * np.outer(f, np.arange(model.order + 1)))
        found = model.variance * size**2 / np.abs(z @ model.filters[-1]) ** 2
        logs.append(np.log(found / true))
    # two runs of 0.7 s and two of 0.35 s hold 9 degrees of freedom between 2 and 4 Hz: a factor of
    # 1.6 in each set, of 1.2 in the mean of twelve
    assert 0.6 < np.exp(np.mean(logs)) < 1.4


def test_slow_noise_beside_a_vibration_has_its_density():
    """A memory of 48 ms leaves 0.4 of noise of 2 Hz and doubles what lies at 8 Hz, where waves are read."""
    modes = ((2.0, 0.6, 120.0), (55.0, 0.05, 60.0), (150.0, 0.02, 200.0))  # Hz, damping, nm
    f, dt, white = np.array([2.0, 3.0, 4.0, 6.0, 8.0, 12.0]), 1e-3, 20.0
    # x'' + 2 D w x' + w^2 x = white noise: r^2 = int S df
    true = 2.0 * dt * white**2 + sum(
        4.0 * d * f0**3 * rms**2 / np.pi / ((f0**2 - f**2) ** 2 + (2.0 * d * f0 * f) ** 2)
        for f0, d, rms in modes
    )
    logs = []
    for seed in range(12):
        rng = np.random.default_rng([88, seed])
        draws = [
            sum(oscillator(rng, Mode(*m), dt, n) for m in modes) + white * rng.standard_normal(n)
            for n in (700, 700, 700, 467, 467, 467, 350, 350, 350)
        ]
        size = float(np.std(np.concatenate(draws)))
        model = fit_noise([d[:, None] / size for d in draws], time_step=dt)
        z = np.exp(-2j * np.pi * dt * np.outer(f, np.arange(model.order + 1)))
        found = 2.0 * dt * model.variance * size**2 / np.abs(z @ model.filters[-1]) ** 2
        logs.append(np.log(found / true))
    # each set knows them to 12 to 32 %, the mean of twelve to 9 %; the slowest are longer than a run
    ratio = np.exp(np.mean(logs, axis=0))
    assert 0.6 < ratio.min() < ratio.max() < 1.6


def test_a_level_that_is_learnt_from_few_cycles_widens_the_band():
    """Mean variance of the scaled inverse chi-square that few degrees and one witness leave."""
    cycles, runs = np.array([1.5, 4.0, 30.0]), 4
    for c, factor in zip(cycles, level_spread(cycles, runs), strict=True):
        degrees = 2.0 * c / math.sqrt(2.0) * 3.0 / 4.0 + 2.0  # both of a pair, an octave about it
        mean = invgamma(degrees / 2.0, scale=degrees / 2.0).mean()
        assert factor == pytest.approx(mean, rel=1e-9, abs=0.0)
    alone = level_spread(np.array([1.0]), 1)[0]
    assert alone == pytest.approx(1.0 + math.sqrt(2.0), rel=1e-12, abs=0.0)


LOUD = 0.3
"""Of what is added to the standard deviation: a wave that the ends cut off has no sharp octave."""


def model_of(ends, harmonics=30):
    """Return the model of runs that each read some mm of 24 mm, 500 a second, noise of 0.1, and rows."""
    extension = Extension(0.0, 24.0, harmonics)
    model, rows, equations = Model(extension, Spectrum(harmonics)), [], []
    for i, (low, high) in enumerate(ends):
        speed = SPEEDS[i % 3]
        basis = extension.basis(np.arange(low, high, speed / 500.0))
        rows.append((basis - basis.mean(axis=0)) / 0.1)
        gram, zeros = rows[-1].T @ rows[-1], np.zeros(basis.shape[1])
        equations.append(
            RunEquations(gram, zeros, zeros, 0.0, basis.shape[0] * 100.0, speed, i % 3, high - low)
        )
    model.take(equations)
    return model, rows


def test_the_widened_band_is_that_of_louder_noise():
    """Noise that is louder in its cosines over the time of each run, through the same solution."""
    model, rows = model_of([(0.0, 24.0)] * 3)
    post = model.solve()
    plain, extra = post.covariance(), np.zeros((61, 61))
    for a in rows:
        cosines = dct(a, axis=0, norm="ortho")
        periods = np.maximum(np.arange(len(a)) * 1.4 / 2.0, 0.7)  # k in the period of 1.4 travels
        louder = 2.0 / (math.sqrt(2.0) * periods * 3.0 / 1.4 * 2.0 / 3.0)
        extra += plain @ cosines.T @ (louder[:, None] * cosines) @ plain

    x = np.linspace(0.0, 24.0, 97)
    line = np.column_stack([np.ones(97), x])
    curves = model.extension.basis(x)
    curves = curves - line @ np.linalg.lstsq(line, curves, rcond=None)[0]

    def sd(covariance):
        return np.sqrt(np.sum(curves @ covariance * curves, axis=1))

    found, true = sd(model.covariance(post)) / sd(plain) - 1.0, sd(plain + extra) / sd(plain) - 1.0
    np.testing.assert_allclose(found, true, rtol=0.0, atol=LOUD * true.max())
    assert true.max() > 0.05


def test_the_level_of_each_noise_model_is_learnt_from_its_own_runs():
    """Three runs of one model, or three models of one run each: a third of the cycles tells each level."""
    model, _ = model_of([(0.0, 24.0)] * 3)
    post = model.solve()
    plain = post.covariance()
    together = model.covariance(post) - plain
    model.take([replace(run, group=i) for i, run in enumerate(model.runs)])
    apart = model.covariance(model.solve()) - plain
    np.testing.assert_allclose(apart, 3.0 * together, rtol=0.0, atol=0.1 * np.abs(apart).max())


def test_the_level_of_the_noise_widens_nothing_that_no_reading_shows():
    """Where half of the travel is not read, no direction gains more than the loudest octave."""
    model, _ = model_of([(0.0, 12.0)] * 3)
    post = model.solve()
    loudest = 1.0 + 2.0 / (math.sqrt(2.0) * 3.0 * 12.0 / 33.6 * 2.0 / 3.0)
    root = np.linalg.inv(np.linalg.cholesky(post.covariance()))
    gain = np.linalg.eigvalsh(root @ model.covariance(post) @ root.T)
    assert gain.min() > 1.0 - DIGITS
    assert 1.05 < gain.max() < loudest * (1.0 + DIGITS)  # F G F: 0.03 to 107
