"""The joint separator under the contract: runs triggered by position, several feedrates."""

import math

import numpy as np
import pytest
from contracts.separation import EXACT, SeparationContract

from metrosep import Run, RunSet
from metrosep.core.errors import MetrosepError, NotSeparableError
from metrosep.separation import separate
from metrosep.separation.runs.joint_method import JointSeparation

NM = 1e-9
LENGTH, N = 30e-3, 97
X = np.linspace(0.0, LENGTH, N) + 0.1
FEEDS = (0.05, 0.08, 0.08, 0.05)
HERTZ = 8.0
SHORTEST = 3e-3

FLOOR = 0.5 * NM
"""Noise that is always in the readings: the method learns a noise model, and needs some noise."""

U_FACTOR = 1.5
"""u over the scatter of 20 trials: 1/sqrt(2 * 20) is 16 % of a single number; 3 of them."""

LEVEL = 1.25
"""What the learnt level of the noise adds to u with four runs (separation-joint, Uncertainty); the
scatter of trials at one truth does not hold it."""

EVERYWHERE = np.linspace(X[0], X[-1], 20001)
"""Positions for the line of the truth: dense, so that the rule does not matter."""


def wavy(rng, amplitude=300 * NM):
    """Random waves of 37.5 mm / k, their line over the range taken out."""
    waves = [
        (k, amplitude / k * rng.choice([-1, 1]) * rng.uniform(0.5, 1), rng.uniform(0, 2 * math.pi))
        for k in (3, 5, 8)
    ]

    def raw(at):
        return sum(a * np.sin(2 * math.pi * k * (at - X[0]) / 37.5e-3 + p) for k, a, p in waves)

    return raw(X) - np.polyval(np.polyfit(EVERYWHERE - 0.1, raw(EVERYWHERE), 1), X - 0.1)


class TestOneDirection(SeparationContract):
    has_redundancy = True
    takes_repeats = False
    sd = 5 * NM
    exact = 5e-3
    """Readings with FLOOR have errors of about 0.3 FLOOR; the truth has hundreds of nm."""
    directions = ("forward",) * 4
    feeds = FEEDS
    min_feeds = 2

    def method(self):
        return JointSeparation(
            tuple(X.tolist()), self.feeds, self.directions, SHORTEST, self.min_feeds
        )

    def draw(self, seed):
        rng, truth, errors, readings = super().draw(seed)
        floor = FLOOR * np.random.default_rng(1000 + seed).standard_normal(readings.shape)
        return rng, truth, errors, readings + floor

    def truth(self, rng):
        return {"slope": 2e-5 * rng.choice([-1, 1]) * rng.uniform(0.5, 1)}

    def errors(self, rng):
        return {way: wavy(rng) for way in dict.fromkeys(self.directions)}

    def readings(self, truth, errors):
        zero = np.zeros(N)
        middle = (X[0] + X[-1]) / 2
        out = np.zeros((len(self.feeds), N))
        for r, way in enumerate(self.directions):
            for i in range(N):
                out[r, i] = errors.get(way, zero)[i] + truth.get("artefact", zero)[i]
                out[r, i] += truth.get("slope", 0.0) * (X[i] - middle)
                out[r, i] += truth.get("offset", np.zeros(len(self.feeds)))[r]
                seconds = abs(X[i] - (X[0] if way == "forward" else X[-1])) / self.feeds[r]
                for size in errors.get("locked", ()):
                    out[r, i] += size * np.sin(2 * math.pi * HERTZ * seconds)
        return out

    trials = 20
    widest = LEVEL * U_FACTOR

    def check_scatter(self, separate):
        """u is calibrated on simulations, not predicted; one draw of the prior for each truth."""
        rng, truth, errors, readings = self.draw(10)
        results = [
            separate(readings + self.sd * rng.standard_normal(readings.shape))
            for _ in range(self.trials)
        ]
        for name in (*truth, *errors):
            scatter = np.std([r.parts[name] for r in results], axis=0, ddof=1)
            stated = np.sqrt(np.mean([r.u[name] ** 2 for r in results], axis=0))
            ratio = math.sqrt(float(np.mean(stated**2) / np.mean(scatter**2)))
            assert 1.0 / U_FACTOR < ratio < self.widest, name
        return math.sqrt(float(np.mean([r.noise.value**2 for r in results])))

    def invisible(self, rng):
        form = wavy(rng)
        ways = dict.fromkeys(self.directions)
        yield {"artefact": form}, dict.fromkeys(ways, -form)
        middle = (X[0] + X[-1]) / 2
        yield {"artefact": 1e-5 * (X - middle), "slope": -1e-5}, {}
        level = 1e-6
        yield {"artefact": np.full(N, level), "offset": np.full(len(self.feeds), -level)}, {}

    @pytest.mark.parametrize("seed", [3, 4])
    def test_library_simulates_like_the_independent_code(self, seed):
        rng = np.random.default_rng(seed)
        truth = {**self.truth(rng), "artefact": wavy(rng), "offset": rng.normal(0, 1e-6, 4)}
        errors = self.errors(rng)
        simulated, expected = self.method().simulate(truth, errors), self.readings(truth, errors)
        np.testing.assert_allclose(
            simulated, expected, rtol=0, atol=EXACT * np.abs(expected).max()
        )

    def test_offsets_of_the_runs_change_nothing_and_are_not_invented(self):
        rng, _, _, readings = self.draw(20)
        moved = readings + 1e-6 * rng.standard_normal((len(self.feeds), 1))
        plain, seen = self.method().separate(readings), self.method().separate(moved)
        for way in dict.fromkeys(self.directions):
            np.testing.assert_allclose(seen.parts[way], plain.parts[way], rtol=0.0, atol=FLOOR)
        for hidden in ("artefact", "offset"):
            assert np.isnan(seen.parts[hidden]).all()
            assert np.isnan(seen.u[hidden]).all()
            assert any(i.part == hidden for i in seen.null_space)

    def test_direction_without_runs_is_not_invented(self):
        result = self.method().separate(self.draw(21)[3])
        for way in {"forward", "reverse"} - set(self.directions):
            assert np.isnan(result.parts[way]).all()
            assert any(i.part == way and "all of it" in i.indices for i in result.null_space)


class TestReverseOnly(TestOneDirection):
    directions = ("reverse",) * 4


class TestBothDirections(TestOneDirection):
    directions = ("forward", "reverse", "forward", "reverse")

    # One run of 97 samples at each sampling interval: the noise model has order 19 from one run, takes
    # chance for resonances, and u is three times the scatter ("Few readings" of separation-joint).
    widest = 3.5


class TestOneFeed(TestOneDirection):
    """Averaging was accepted: a vibration locked to the start then passes for the error."""

    feeds = (0.06,) * 4
    min_feeds = 1

    def invisible(self, rng):
        yield from super().invisible(rng)
        size = 100 * NM * rng.uniform(0.5, 1)
        wave = size * np.sin(2 * math.pi * HERTZ * (X - X[0]) / 0.06)
        yield {"artefact": -wave}, {"locked": (size,)}


def small(directions=("forward", "reverse", "forward", "reverse"), **options):
    return JointSeparation(tuple(X.tolist()), FEEDS, directions, SHORTEST, **options)


def readings_of(method, seed, **curves):
    """Readings with white noise of 1 nm, by hand."""
    rng = np.random.default_rng(seed)
    rows = [curves[way] + rng.normal(0, 1 * NM, N) for way in method.directions]
    return np.array(rows)


def test_it_is_the_joint_separator_that_works():
    """Reverse rows are turned for the fit, and the results back: the wave is not symmetric."""
    rng = np.random.default_rng(31)
    method = small()
    up, down = wavy(rng), wavy(rng)
    readings = readings_of(method, 1, forward=up, reverse=down + 400 * NM)
    runs = []
    for row, feed, way in zip(readings, FEEDS, method.directions, strict=True):
        at, z = (X, row) if way == "forward" else (X[::-1], row[::-1])
        runs.append(Run(at, z, t=abs(at - at[0]) / feed))
    same = separate(RunSet(runs), start=X[0], length=X[-1] - X[0], shortest=SHORTEST)
    found = method.separate(readings)
    for way, sign, truth in (("forward", 1, up), ("reverse", -1, down)):
        np.testing.assert_allclose(
            found.parts[way], same.evaluate(X, direction=sign), rtol=0.0, atol=1e-6 * NM
        )
        np.testing.assert_allclose(
            found.u[way], same.sd(X, direction=sign), rtol=0.0, atol=1e-6 * NM
        )
        np.testing.assert_allclose(found.parts[way], truth, rtol=0.0, atol=3 * NM)
    assert found.audit["lost_motion_nm"] == pytest.approx(400.0, abs=3.0)
    assert found.history[-1].name == "separate"


def test_what_was_not_measured_is_not_filled():
    method = small()
    wave = wavy(np.random.default_rng(32))
    readings = readings_of(method, 2, forward=wave, reverse=wave)
    readings[[0, 2], 40:43] = np.nan
    readings[1, 70] = np.nan
    found = method.separate(readings)
    assert np.flatnonzero(np.isnan(found.forward)).tolist() == [40, 41, 42]
    assert np.flatnonzero(np.isnan(found.u["forward"])).tolist() == [40, 41, 42]
    assert np.isfinite(found.reverse).all()
    assert np.isnan(method.correct(readings)[0, 40:43]).all()


def test_wavelengths_that_a_locked_vibration_can_fake_are_named():
    """|f/v1 - f/v2| < 1/L: wavelengths at the fast feed from L (1 - 50/80) = 11.25 mm."""
    named = [i for i in small().null_space() if i.kind == "wavelength" and i.part == "reverse"]
    assert named[0].indices == ("11.25 mm and longer",)
    assert named[1].indices == ("shorter than 3 mm",)
    one = JointSeparation(tuple(X.tolist()), (0.05, 0.05), min_feeds=1).null_space()
    assert any(i.indices == ("every wavelength",) for i in one)


def test_scatter_beyond_the_stated_uncertainty_is_told():
    method = small()
    wave = wavy(np.random.default_rng(33))
    readings = readings_of(method, 3, forward=wave, reverse=wave)
    quiet, loud = (method.separate(readings, u_reading=u) for u in (1 * NM, 0.3 * NM))
    assert not any("u_reading" in m for m in quiet.messages)
    assert any("u_reading" in m for m in loud.messages)
    assert loud.noise.value == pytest.approx(1 * NM, abs=0.15 * NM)
    assert loud.audit["u_reading_stated_nm"] == pytest.approx(0.3, abs=1e-9)


def test_one_feedrate_is_refused():
    with pytest.raises(NotSeparableError, match="the reverse runs have 1 feedrate"):
        JointSeparation(tuple(X.tolist()), FEEDS, ("forward", "reverse", "forward", "forward"))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: JointSeparation((0.0, 1e-3, 1e-3), FEEDS), "finite and rising"),
        (lambda: JointSeparation((0.0, 1e-3), FEEDS), "x"),
        (lambda: JointSeparation(tuple(X), (0.05, -0.08)), "must be positive"),
        (lambda: JointSeparation(tuple(X), ()), "feeds"),
        (lambda: JointSeparation(tuple(X[::-1]), FEEDS), "whatever the direction"),
        (lambda: small(("forward",)), "one for each of the 4"),
        (lambda: small(("up", "up", "up", "up")), "'forward' or 'reverse'"),
        (lambda: small(min_feeds=1.5), "min_feeds"),
        (lambda: small().separate(np.zeros((4, 5))), "97 positions"),
        (
            lambda: small().separate(np.zeros((4, N)), u_reading=-1.0),
            "u_reading must be zero or more",
        ),
        (
            lambda: small(("forward",) * 4).simulate({}, {"reverse": np.ones(N)}),
            "no run goes reverse",
        ),
        (lambda: small().simulate({}, {"forward": np.ones(3)}), "must have the shape"),
    ],
)
def test_wrong_input_is_named(make, said):
    with pytest.raises(MetrosepError, match=said):
        make()


@pytest.mark.parametrize("seed", [1, 2])
def test_one_strong_wave_in_little_noise(seed):
    """200 nm at 6 mm, which is not a harmonic of 37.5 mm, and 2 nm of white noise; no vibration."""
    x = np.linspace(0.0, LENGTH, 121)
    wave = 200 * NM * np.cos(2 * math.pi * x / 6e-3)
    noise = 2 * NM * np.random.default_rng(seed).standard_normal((4, x.size))
    found = JointSeparation(tuple(x.tolist()), (0.05, 0.08, 0.05, 0.08)).separate(wave + noise)
    assert np.abs(found.forward - wave).max() < 6 * NM  # 4.2 nm with the white noise estimated
