"""Terms from what other parts of metrosep return: signs, phases, directions, units."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import metrosep as ms
from metrosep.compensation.polynomial import fit_polynomial
from metrosep.core.errors import DataError, InvalidSamplesError, UnitError
from metrosep.core.runset import Run, RunSet
from metrosep.forms import Plane
from metrosep.machine.chains import presets
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.terms import CallableTerm, FourierTerm, as_term
from metrosep.process.straightness_runs import run_polynomial

NM = 1e-9
SWEEP = np.linspace(0.0, 0.04, 401)
BOW = 6e-3 * SWEEP**2 + 2e-5 * SWEEP  # m; asymmetric: neither its sign nor its end can be swapped
NOISE = 1e-8  # m
FAST = {"shortest": 3e-3}
STEP = 4e-3  # s
START = 0.0235  # m; half a wavelength of 10 mm off, and then some


def bow_runs(n=3):
    rng = np.random.default_rng(7)
    return [ms.Profile(SWEEP, BOW + NOISE * rng.standard_normal(SWEEP.size)) for _ in range(n)]


def on_the_mill(term, x, **options):
    q = {"X": x, "Y": 0.0, "Z": 0.0}
    return presets("mill_xyz").volumetric_error(q, ErrorSet({"EZX": term}, **options))[:, 2]


# sign -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["error", "compensation"])
@pytest.mark.parametrize("maker", ["run_polynomial", "fit_polynomial"])
def test_a_polynomial_moves_the_tool_by_the_error_whatever_it_states(maker, quantity):
    runs = bow_runs()
    if maker == "run_polynomial":
        # what the runs hold is stated: the same planted error, written as its compensation
        sign = -1.0 if quantity == "compensation" else 1.0
        runs = [ms.Profile(r.x, sign * r.z) for r in runs]
        polynomial = run_polynomial(runs, quantity=quantity, degree=2)
    else:
        polynomial = fit_polynomial(RunSet(runs), quantity=quantity, degree=2)
    got = on_the_mill(polynomial, SWEEP)
    assert np.abs(got - BOW).max() < 3 * NOISE  # of an error of 10 um
    u = as_term(polynomial).sd(SWEEP)
    assert np.abs(u - polynomial.sd(SWEEP)).max() < 1e-20
    assert (u > 0.0).all()
    covariance = presets("mill_xyz").volumetric_covariance(
        {"X": SWEEP, "Y": 0.0, "Z": 0.0}, ErrorSet({"EZX": polynomial})
    )
    assert np.abs(np.sqrt(covariance[:, 2, 2]) - u).max() < 1e-20


def test_a_compensation_without_an_error_of_its_own_is_turned_round():
    table = SimpleNamespace(
        quantity="compensation", evaluate=lambda x: 1e-6 + 1e-5 * x, sd=lambda x: 2e-8 + 0 * x
    )
    x = np.array([0.0, 0.3])
    assert np.abs(as_term(table).evaluate(x) - [-1e-6, -4e-6]).max() < 1e-20
    assert (as_term(table).sd(x) == 2e-8).all()


def test_the_function_of_a_compensation_is_refused():
    fit = fit_polynomial(RunSet(bow_runs()), quantity="compensation", degree=2)
    with pytest.raises(DataError, match="compensation"):
        as_term(fit.evaluate)


def test_another_quantity_is_refused():
    odd = SimpleNamespace(quantity="slope", evaluate=lambda x: x, sd=lambda x: x)
    with pytest.raises(DataError, match="'slope'"):
        as_term(odd)


# phase ------------------------------------------------------------------------------------------


def form(x):
    return 0.8e-6 * np.cos(2 * np.pi * x / 10e-3 + 0.6) + 0.3e-6 * np.sin(
        2 * np.pi * x / 5e-3 - 0.4
    )


def straight(z, x):
    return z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())


def feed_runs(start, direction=1, offset=0.0, phase=0.0):
    rng = np.random.default_rng(int(1e5 * abs(start)) + direction + 5)
    runs = []
    for i, feed in enumerate((0.08, 0.12, 0.16)):
        x = start + np.arange(0.0, 50e-3, feed * STEP)[::direction]
        t = np.arange(x.size) * STEP
        z = form(x + phase) + 0.1e-6 * np.sin(2 * np.pi * 70 * t + i) + offset
        z = z + 5e-9 * rng.standard_normal(x.size)
        runs.append(Run(x, z, t=t, feed=feed, run_id=f"{direction}{i}"))
    return runs


@pytest.fixture(scope="module")
def estimate():
    return ms.separation.separate(RunSet(feed_runs(START)), **FAST)


def test_origin_of_a_fourier_term():
    term = FourierTerm([1e-6], [0.01], [0.3], origin=2e-3)
    x = np.linspace(-0.01, 0.02, 31)
    assert (
        np.abs(term.evaluate(x) - 1e-6 * np.cos(2 * np.pi * (x - 2e-3) / 0.01 + 0.3)).max() < 1e-20
    )
    with pytest.raises(InvalidSamplesError, match="origin"):
        FourierTerm([1e-6], [0.01], [0.3], origin=np.nan)


def test_fourier_term_of_an_estimate_that_starts_elsewhere(estimate):
    assert estimate.start == pytest.approx(START, abs=1e-9)
    term = FourierTerm.from_estimate(estimate)
    assert term.origin == estimate.start
    x = np.linspace(estimate.start, estimate.stop, 700)
    # left over: wavelengths with up to 20 nm that were not selected, and a line
    assert np.std(straight(term.evaluate(x) - estimate.evaluate(x), x)) < 25 * NM
    assert np.corrcoef(term.evaluate(x), form(x))[0, 1] > 0.99
    # with its phases taken at position 0 it would be another error
    wrong = FourierTerm(term.amplitudes, term.wavelengths, term.phases, term.mean)
    assert np.std(wrong.evaluate(x) - form(x)) > 500 * NM
    assert abs(np.mean(term.evaluate(x) - estimate.evaluate(x))) < 1 * NM


def test_whole_spectrum_with_the_origin_is_the_estimate_but_for_a_line(estimate):
    rows = estimate.spectrum[estimate.spectrum.amplitude_nm > 0]
    series = (rows.amplitude_nm * 1e-9, rows.wavelength_mm * 1e-3, rows.phase_rad)
    x = np.linspace(estimate.start, estimate.stop, 700)
    # the estimate is a mean over what lag and wavelengths of its waves may be, the table names one
    small = 0.25 * np.sqrt(np.mean(estimate.sd(x) ** 2))
    for origin, least, most in ((estimate.start, 0.0, small), (0.0, 500 * NM, 1.0)):
        rest = FourierTerm(*series, origin=origin).evaluate(x) - estimate.evaluate(x)
        assert least <= np.std(straight(rest, x)) < most


def test_uncertainty_of_the_fourier_term_holds_what_was_left_out(estimate):
    term = FourierTerm.from_estimate(estimate)
    x = np.linspace(estimate.start, estimate.stop, 501)
    rest = straight(term.evaluate(x) - estimate.evaluate(x), x)
    expected = np.sqrt(np.mean(estimate.sd(x) ** 2) + np.mean(rest**2))
    assert term.u == pytest.approx(expected, abs=1e-3 * NM)
    assert FourierTerm.from_estimate(estimate, u=3e-9).u == 3e-9


def test_fourier_term_needs_a_spectrum_with_selected_lines():
    mean = ms.separation.separate(RunSet(bow_runs()), method="mean")
    with pytest.raises(DataError, match="no selected wavelength"):
        FourierTerm.from_estimate(mean)
    with pytest.raises(DataError, match="spectrum"):
        FourierTerm.from_estimate(3.0)


# directions -------------------------------------------------------------------------------------

LOST = 2e-6


@pytest.fixture(scope="module")
def both():
    runs = feed_runs(START) + feed_runs(START, -1, offset=LOST, phase=1e-3)
    return ms.separation.separate(RunSet(runs), **FAST)


def test_a_term_takes_the_direction_that_it_is_told(both):
    x = np.linspace(both.start, both.stop, 301)
    forward = as_term(both, direction="forward")
    backward = as_term(both, direction="backward")
    assert (as_term(both).evaluate(x) == both.evaluate(x)).all()
    assert (forward.evaluate(x) == both.evaluate(x, direction=1)).all()
    assert (forward.sd(x) == both.sd(x, direction=1)).all()
    # planted: the way back runs 2 um higher and 1 mm shifted; forward is the reference. Their
    # lines, which each curve is about, differ by some 0.1 um.
    assert np.mean(backward.evaluate(x) - forward.evaluate(x)) == pytest.approx(LOST, abs=150 * NM)
    assert np.std(straight(backward.evaluate(x) - form(x + 1e-3), x)) < 60 * NM
    assert np.std(straight(backward.evaluate(x) - form(x), x)) > 300 * NM
    expected = np.hypot(both.sd(x, direction=-1), both.lost_motion.u)
    assert np.abs(backward.sd(x) - expected).max() < 1e-20
    assert (as_term(both, direction="reverse").evaluate(x) == backward.evaluate(x)).all()


def test_a_set_says_that_it_took_the_mean_of_both_directions(both):
    x = np.linspace(both.start, both.stop, 11)
    taken = ErrorSet({"EZX": both, "EYX": 0.0})
    assert len(taken.messages) == 1
    for part in ("EZX", "mean", "lost motion", "um", "direction"):
        assert part in taken.messages[0]
    assert not ErrorSet({"EZX": both}, direction="forward").messages
    assert not ErrorSet({"EZX": 1e-6}).messages
    by_name = ErrorSet({"EZX": both, "EYX": both}, direction={"EZX": "backward", "EYX": "forward"})
    at = by_name.at({"X": x})
    assert np.mean(at["EZX"] - at["EYX"]) == pytest.approx(LOST, abs=150 * NM)
    assert (on_the_mill(both, x, direction="forward") == both.evaluate(x, direction=1)).all()


def test_fourier_term_of_one_direction(both):
    x = np.linspace(both.start, both.stop, 301)
    for direction in ("mean", "forward", "backward"):
        term = FourierTerm.from_estimate(both, direction=direction)
        expected = as_term(both, direction=direction).evaluate(x)
        assert np.std(straight(term.evaluate(x) - expected, x)) < 20 * NM
        assert abs(np.mean(term.evaluate(x) - expected)) < 1 * NM


def test_directions_that_are_not_there_are_refused(both, estimate):
    with pytest.raises(DataError, match="forward runs only"):
        as_term(estimate, direction="backward")
    for bad in ("up", 1, None, ["forward"]):
        with pytest.raises(DataError, match="mean, forward, backward"):
            as_term(both, direction=bad)
        with pytest.raises(DataError, match="direction"):
            ErrorSet({"EZX": both}, direction={"EZX": bad})
    with pytest.raises(DataError, match="belongs to no term"):
        ErrorSet({"EZX": both}, direction={"EYX": "forward"})
    # what has no direction is the same in both
    assert as_term(1e-6, direction="backward").evaluate(0.0) == 1e-6


def test_lost_motion_that_is_not_known_is_left_out_with_a_message():
    x = np.linspace(0.0, 1.0, 3)
    source = SimpleNamespace(
        directions=(-1, 1),
        lost_motion=SimpleNamespace(value=np.nan, u=None, unit="m"),
        evaluate=lambda x, direction=None: 1e-6 * (direction or 0) + 0 * x,
        sd=lambda x, direction=None: 0 * x,
    )
    assert (as_term(source, direction="backward").evaluate(x) == -1e-6).all()
    message = ErrorSet({"EZX": source}, direction="backward").messages
    assert len(message) == 1
    assert "lost motion is not known" in message[0]


# units and things that are not terms --------------------------------------------------------------


def test_a_length_is_no_angle(estimate):
    polynomial = fit_polynomial(RunSet(bow_runs()), degree=2)
    for value in (estimate, polynomial, run_polynomial(bow_runs(), quantity="error", degree=2)):
        for name in ("EBX", "B0Z", "EB0Z"):
            with pytest.raises(UnitError, match="is an angle"):
                ErrorSet({name: value})
    assert ErrorSet({"EBX": estimate.evaluate}).names == ("EBX",)


@pytest.mark.parametrize("value", [Plane(), FourierTerm, CallableTerm, float])
def test_a_form_and_a_class_are_no_terms(value):
    with pytest.raises(DataError, match=r"Plane|class"):
        as_term(value)
    with pytest.raises(DataError, match="EXX"):
        ErrorSet({"EXX": value})
