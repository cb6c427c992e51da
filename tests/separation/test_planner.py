"""Feedrate planner: information against Monte Carlo, the plan against brute force, bad input.

The Monte Carlo simulates oscillators by their exact state equation (tests/contracts/machine.py has
the same machine) and estimates by generalised least squares with the covariance of the oscillator
in closed form; neither uses code of metrosep.
"""

import copy
import itertools
import json
import pickle
import re

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import expm, toeplitz

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotSeparableError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.core.profile import Profile
from metrosep.separation.runs.planner import plan_feedrates, predicted_sd
from metrosep.spectral.density import profile_psd

NM = 1e-9
MODES = ((150.0, 0.02, 0.212e-6), (12.0, 0.02, 0.071e-6))  # Hz, damping, RMS m
SENSOR = 20 * NM
RATE = 1000.0
EXACT = 1e-12  # the formula itself, rounding only
TRIALS = 4000  # scatter of a variance 2.2 %, pooled over a and b 1.6 %: three of them 4.7 %
MC_TOLERANCE = 0.05  # goal S10


def oscillator_density(f, f0, damping, rms):
    """One-sided; integrates to rms^2."""
    w, w0 = 2 * np.pi * np.asarray(f, float), 2 * np.pi * f0
    return 8 * damping * w0**3 * rms**2 / ((w0**2 - w**2) ** 2 + (2 * damping * w0 * w) ** 2)


def machine_density(f):
    return sum(oscillator_density(f, *m) for m in MODES) + 2 * SENSOR**2 / RATE


def oscillator_covariance(t, f0, damping, rms):
    w0 = 2 * np.pi * f0
    wd = w0 * np.sqrt(1 - damping**2)
    decay = rms**2 * np.exp(-damping * w0 * t)
    return decay * (np.cos(wd * t) + damping * w0 / wd * np.sin(wd * t))


def simulated_oscillators(rng, n_trials, n):
    """Stationary responses, shape (n_trials, n), from the state equation."""
    out = SENSOR * rng.standard_normal((n_trials, n))
    for f0, damping, rms in MODES:
        w = 2 * np.pi * f0
        step = expm(np.array([[0.0, 1.0], [-w * w, -2 * damping * w]]) / RATE)
        still = np.diag([1.0, w * w])
        kick = np.linalg.cholesky(still - step @ still @ step.T + 1e-13 * still)
        state = rng.standard_normal((n_trials, 2)) * [1.0, w]
        for i in range(n):
            out[:, i] += rms * state[:, 0]
            state = state @ step.T + rng.standard_normal((n_trials, 2)) @ kick.T
    return out


def monte_carlo_variance(feeds, wavelengths, length, seed):
    """Mean variance of a and b of each wave by GLS on simulated noise, offsets free."""
    rng = np.random.default_rng(seed)
    normal = [np.zeros((2, 2)) for _ in wavelengths]
    right = [np.zeros((2, TRIALS)) for _ in wavelengths]
    for v in feeds:
        n = round(length / v * RATE)
        t = np.arange(n) / RATE
        lags = sum(oscillator_covariance(t, *m) for m in MODES)
        lags[0] += SENSOR**2
        inverse = np.linalg.inv(toeplitz(lags))
        noise = simulated_oscillators(rng, TRIALS, n)
        one = np.ones(n)
        for k, wave in enumerate(wavelengths):
            basis = np.column_stack(
                [np.cos(2 * np.pi * v * t / wave), np.sin(2 * np.pi * v * t / wave)]
            )
            weights = inverse - np.outer(inverse @ one, one @ inverse) / (one @ inverse @ one)
            normal[k] += basis.T @ weights @ basis
            right[k] += basis.T @ weights @ noise.T
    fits = [np.linalg.solve(a, b) for a, b in zip(normal, right, strict=True)]
    return np.array([np.mean(f**2) for f in fits])


WAVES = np.array([20.0, 10.0, 5.0, 4.6, 10 / 3]) * 1e-3


# --- closed forms -----------------------------------------------------------------------------


def test_density_of_the_test_integrates_to_the_variance():
    """One-sided in Hz: otherwise every sd below would be off by sqrt(2) or sqrt(2 pi)."""
    f = np.linspace(0.0, 500.0, 2_000_001)

    total = np.trapezoid(machine_density(f), f)

    assert total == pytest.approx(sum(m[2] ** 2 for m in MODES) + SENSOR**2, rel=1e-3, abs=1e-20)


def test_white_noise_gives_two_sigma_squared_over_n():
    """var(a) = 2 sigma^2 / N for a sine in N white samples; S = 2 sigma^2 / rate."""
    sigma, length, v = 20 * NM, 50e-3, 0.1
    density = 2 * sigma**2 / RATE
    n_samples = length / v * RATE

    plan = predicted_sd(lambda f: density + 0 * f, [v, v], (5e-3, 10e-3), length)

    closed = sigma * np.sqrt(2 / (2 * n_samples))
    assert plan.information == pytest.approx([1 / closed**2] * 121, rel=EXACT, abs=1.0)
    assert plan.sd["sd_long_record_nm"].to_numpy() == pytest.approx(
        [closed / NM] * 121, rel=1e-9, abs=1e-9
    )
    # finite record, offset free: whole waves in the record, so only the end sample matters
    whole = plan.sd["sd_nm"].to_numpy()[[0, -1]]
    assert whole == pytest.approx(closed / NM, rel=0.01, abs=1e-9)


def test_information_is_the_formula_of_the_specification():
    feeds = np.array([0.08, 0.12, 0.16, 0.16])

    plan = predicted_sd(machine_density, feeds, WAVES, 70e-3)

    formula = [sum(70e-3 / v / machine_density(v / w) for v in feeds) for w in WAVES]
    assert plan.information == pytest.approx(formula, rel=EXACT, abs=1.0)
    assert plan.sd["wavelength_mm"].to_numpy() == pytest.approx(WAVES * 1e3, rel=EXACT, abs=0.0)


def test_specification_numbers_hold_for_the_long_record_formula():
    """56 nm (7200 x 3) and 32 nm (7200 x 9) are 1/sqrt(J) at 87.5 mm (70 mm with guard zones)."""
    waves = [10e-3, 5e-3, 4.6e-3]

    three = predicted_sd(machine_density, [0.12] * 3, waves, 87.5e-3)
    nine = predicted_sd(machine_density, [0.12] * 9, waves, 87.5e-3)

    assert three.sd["sd_long_record_nm"][0] == pytest.approx(56.0, abs=1.0)
    assert nine.sd["sd_long_record_nm"][0] == pytest.approx(32.0, abs=0.5)


def test_three_feeds_are_worth_more_than_one():
    """3.8 nm of the specification fits a travel of 45 mm: 3.74 nm."""
    waves = [10e-3, 5e-3, 4.6e-3]

    spread = predicted_sd(machine_density, [0.08, 0.12, 0.16] * 3, waves, 45e-3)

    assert spread.sd["sd_long_record_nm"][0] == pytest.approx(3.8, abs=0.1)
    assert spread.sd["sd_one_feed_nm"][0] > 5 * spread.sd["sd_nm"][0]


def test_sd_never_exceeds_the_disturbance_itself():
    """12 Hz, 71 nm RMS, 3 runs: a tone cannot disturb by more than 71 / sqrt(3) = 41 nm.

    The long-record formula says 69 nm; the exact value for the finite record stays below 41.
    """
    plan = predicted_sd(machine_density, [0.12] * 3, [10e-3], 56.25e-3)

    assert plan.sd["sd_long_record_nm"][0] > 60.0
    assert plan.sd["sd_nm"][0] < 71.0 / np.sqrt(3)


# --- goal S10: Monte Carlo --------------------------------------------------------------------


@pytest.mark.slow
def test_predicted_variance_is_that_of_monte_carlo_with_three_feeds():
    feeds, length = [0.08, 0.12, 0.16], 87.5e-3

    plan = predicted_sd(machine_density, feeds, WAVES, length)
    drawn = monte_carlo_variance(feeds, WAVES, length, seed=4)

    assert (plan.sd["sd_nm"].to_numpy() * NM) ** 2 == pytest.approx(
        drawn, rel=MC_TOLERANCE, abs=0.0
    )
    # off the narrow resonance the long-record information is right as well
    assert 1 / plan.information == pytest.approx(drawn, rel=1.6 * MC_TOLERANCE, abs=0.0)


def test_predicted_variance_holds_on_the_resonance():
    """All runs at 7200 mm/min: 12 Hz on the 10 mm wave, where 1/J is almost four times too large."""
    feeds, length = [0.12], 56.25e-3

    plan = predicted_sd(machine_density, feeds, WAVES, length)
    drawn = monte_carlo_variance(feeds, WAVES, length, seed=5)

    assert (plan.sd["sd_nm"].to_numpy() * NM) ** 2 == pytest.approx(
        drawn, rel=MC_TOLERANCE, abs=0.0
    )
    assert 3.0 < 1 / plan.information[1] / drawn[1] < 4.5


# --- the plan ---------------------------------------------------------------------------------


def test_plan_avoids_the_isolator_on_the_lead():
    plan = plan_feedrates(machine_density, [10e-3, 5e-3, 4.6e-3], 0.08, 0.16, 9, length=70e-3)

    assert len(plan.feeds) == 9
    assert np.unique(plan.feeds).size >= 2
    assert np.all((plan.feeds >= 0.08) & (plan.feeds <= 0.16))
    assert np.min(np.abs(plan.feeds / 12.0 - 10e-3)) > 1e-3
    assert plan.sd["sd_nm"].max() < 0.2 * plan.sd["sd_one_feed_nm"].max()


def test_plan_is_as_good_as_brute_force():
    """On all waves up to the travel; a listed one asks for three times the information."""
    waves = np.array([10e-3, 5e-3, 4.6e-3])
    every = np.geomspace(4.6e-3, 70e-3, 200)
    grid = np.geomspace(0.08, 0.16, 41)
    table = 70e-3 / grid[:, None] / machine_density(grid[:, None] / every)
    listed = 70e-3 / grid[:, None] / machine_density(grid[:, None] / waves) / 3.0
    both = np.hstack([table, listed])
    brute = max(
        both[list(c)].sum(axis=0).min()
        for c in itertools.combinations_with_replacement(range(41), 3)
        if grid[max(c)] >= 1.1 * grid[min(c)]
    )

    plan = plan_feedrates(machine_density, waves, 0.08, 0.16, 3, length=70e-3)

    own = [sum(70e-3 / v / machine_density(v / w) for v in plan.feeds) for w in (*every, *waves)]
    assert np.min(own / np.repeat([1.0, 3.0], [200, 3])) >= 0.999 * brute
    assert 0.8 < plan.audit["efficiency"] <= 1.0 + 1e-9


# --- all waves, not only those that are listed ----------------------------------------------------


def two_modes(f):
    """Sensor of 20 nm at 1 kHz; 12 Hz, 100 nm and 33 Hz, 80 nm, both of 3 % damping."""
    out = 2 * SENSOR**2 / RATE + 0.0 * np.asarray(f, float)
    for f0, rms in ((12.0, 100 * NM), (33.0, 80 * NM)):
        h = 0.03 * f0
        out = out + rms**2 / np.pi * h / ((f - f0) ** 2 + h**2)
    return out


@pytest.mark.parametrize(
    ("feeds", "sd_nm", "worst_nm", "worst_mm"),
    [
        ([0.08] * 3 + [0.12] * 3 + [0.16] * 3, (3.15914, 3.8255, 4.91126, 4.27842), None, None),
        ([0.05] * 3 + [0.12984234] * 6, (19.1101, 2.79119, 2.79139, 2.52274), 19.14, 3.99),
        (np.geomspace(0.05, 0.2, 9), (2.99503, 4.09032, 3.00794, 2.69609), 4.15, None),
    ],
    ids=["usual", "old plan", "geometric"],
)
def test_reference_numbers_of_the_specification(feeds, sd_nm, worst_nm, worst_mm):
    plan = predicted_sd(two_modes, feeds, [4e-3, 6e-3, 10e-3, 12e-3], 56e-3)
    fine = predicted_sd(two_modes, feeds, (3.9e-3, 56e-3), 56e-3)

    assert plan.sd["sd_long_record_nm"].to_numpy() == pytest.approx(sd_nm, abs=6e-6, rel=2e-6)
    if worst_nm is not None:
        assert fine.audit["worst_sd_nm"] == pytest.approx(worst_nm, rel=5e-3, abs=0.0)
    if worst_mm is not None:  # the 200 steps are 1.3 % apart
        assert fine.audit["worst_wavelength_mm"] == pytest.approx(worst_mm, rel=0.01, abs=0.0)


def test_no_wave_is_sacrificed_to_the_listed_ones():
    """The 33 Hz mode fell onto 4 mm at 7790 mm/min: 19 nm where geometric feeds have 3 nm."""
    waves = [6e-3, 10e-3, 12e-3, 4e-3]

    plan = plan_feedrates(two_modes, waves, 0.05, 0.2, 9, length=56e-3)

    every = np.geomspace(4e-3, 56e-3, 5001)
    own, even = (
        1 / np.sqrt(sum(56e-3 / v / two_modes(v / every) for v in feeds))
        for feeds in (plan.feeds, np.geomspace(0.05, 0.2, 9))
    )
    assert own.max() < 1.02 * even.max()  # between the 200 waves that were planned for
    said = plan.messages[-2]
    numbers = re.findall(r"([\d.]+) nm at ([\d.]+) mm", said)
    assert float(numbers[0][0]) == pytest.approx(own.max() / NM, rel=0.01, abs=0.0)
    assert float(numbers[1][0]) == pytest.approx(even.max() / NM, rel=0.01, abs=0.0)
    assert "3000 to 12000 mm/min" in said


def test_what_becomes_worse_than_with_geometric_feeds_is_said():
    plan = plan_feedrates(two_modes, (2e-3, 20e-3), 0.05, 0.2, 9, length=56e-3)

    share, wave, own, even = map(
        float,
        re.search(
            r"makes (\d+) % of them worse .* most at ([\d.]+) mm: ([\d.]+) nm instead of ([\d.]+) nm",
            plan.messages[-1],
        ).groups(),
    )
    at = wave * 1e-3
    for feeds, sd in ((plan.feeds, own), (np.geomspace(0.05, 0.2, 9), even)):
        j = sum(56e-3 / v / two_modes(v / at) for v in feeds)
        assert 1e9 / np.sqrt(j) == pytest.approx(sd, rel=0.02, abs=0.0)  # 3 digits of the wave
    assert 1 <= share <= 50


def test_the_share_that_becomes_worse_is_counted_from_the_stated_five_per_cent():
    plan = plan_feedrates(two_modes, (2e-3, 20e-3), 0.05, 0.2, 9, length=56e-3)

    every = np.geomspace(2e-3, 56e-3, 5001)
    own, even = (
        1 / np.sqrt(sum(56e-3 / v / two_modes(v / every) for v in feeds))
        for feeds in (plan.feeds, np.geomspace(0.05, 0.2, 9))
    )
    share, by = map(
        float, re.search(r"makes (\d+) % .* by more than (\d+) %", plan.messages[-1]).groups()
    )
    assert by == 5.0
    # the planner looks at 200 waves, here are 5001
    assert share == pytest.approx(100 * np.mean(own > 1.05 * even), abs=2.0)


def test_a_plan_that_is_far_worse_than_geometric_feeds_is_refused():
    """Two feeds two octaves apart meet the same modes, one octave apart each, at one wave."""

    def comb(f):
        lines = [1e-15 / (1 + ((f - c) / (0.02 * c)) ** 2) for c in (10.0, 20.0, 40.0, 80.0)]
        return 1e-19 + sum(lines)

    with pytest.raises(
        NotSeparableError, match=r"sd of 1\d[\d.]* nm at [\d.]+ mm; .* smaller min_ratio"
    ):
        plan_feedrates(comb, (1e-3, 20e-3), 0.05, 0.2, 6, length=56e-3, min_ratio=3.9)
    assert plan_feedrates(comb, (1e-3, 20e-3), 0.05, 0.2, 6, length=56e-3).feeds.size == 6


def test_given_feeds_that_miss_a_wave_are_named():
    plan = predicted_sd(two_modes, [0.05] * 3 + [0.12984234] * 6, [6e-3, 10e-3, 4e-3], 56e-3)

    assert "19.1 nm at 4 mm" in plan.messages[-1]
    assert "geometric progression" in plan.messages[-1]


@pytest.mark.slow
@pytest.mark.parametrize("listed", [True, False])
def test_the_promise_of_a_plan_is_the_scatter_of_simulated_amplitudes(listed):
    """Runs at the planned feeds are simulated; least squares knows nothing of the planner."""
    wanted = WAVES if listed else (2e-3, 20e-3)
    plan = plan_feedrates(machine_density, wanted, 0.08, 0.16, 5, length=56e-3)
    waves = np.array([*WAVES, plan.audit["worst_wavelength_mm"] * 1e-3])

    promised = predicted_sd(machine_density, plan.feeds, waves, 56e-3).sd["sd_nm"].to_numpy()
    scatter = np.sqrt(monte_carlo_variance(plan.feeds, waves, 56e-3, seed=11)) / NM

    assert promised == pytest.approx(scatter, rel=MC_TOLERANCE / 2, abs=0.0)
    if listed:
        assert promised[:-1] == pytest.approx(plan.sd["sd_nm"].to_numpy(), rel=1e-9, abs=0.0)


def test_same_input_gives_the_same_plan():
    one, two = (
        plan_feedrates(machine_density, (2e-3, 20e-3), 0.05, 0.2, 5).feeds for _ in range(2)
    )

    assert one.tolist() == two.tolist()


def test_white_noise_still_gets_two_feeds():
    """With white noise slow is best; a plan of one feed cannot tell vibration from geometry."""
    plan = plan_feedrates(lambda f: 1e-18 + 0 * f, (2e-3, 20e-3), 0.05, 0.2, 4, min_ratio=1.5)

    v, count = np.unique(plan.feeds, return_counts=True)
    # Twice as fast: half as many waves of a vibration in the travel, one less than two.
    assert v == pytest.approx([0.05, 0.1], rel=1e-6, abs=0.0)
    assert count.tolist() == [2, 2]


def test_limits_are_kept():
    plan = plan_feedrates(
        machine_density, (2e-3, 20e-3), 0.02, 0.3, 6, length=60e-3, max_time=2.4, min_ratio=1.3
    )

    assert np.sum(60e-3 / plan.feeds) <= 2.4 * (1 + 1e-9)
    assert plan.audit["time_s"] == pytest.approx(np.sum(60e-3 / plan.feeds), rel=1e-9, abs=0.0)
    distinct = np.unique(plan.feeds)
    assert np.all(distinct[1:] / distinct[:-1] >= 1.3 * (1 - 1e-9))


def test_runs_already_done_count():
    waves = [10e-3, 5e-3, 4.6e-3]

    plan = plan_feedrates(machine_density, waves, 0.08, 0.16, 1, length=70e-3, fixed=[0.12] * 3)

    assert plan.feeds.size == 1
    assert abs(plan.feeds[0] - 0.12) > 0.01
    both = predicted_sd(machine_density, [0.12] * 3 + [plan.feeds[0]], waves, 70e-3)
    assert plan.information == pytest.approx(both.information, rel=EXACT, abs=0.0)


def test_settling_shortens_the_record_but_not_the_time():
    free = predicted_sd(machine_density, [0.1], WAVES, 60e-3)
    lost = predicted_sd(machine_density, [0.1], WAVES, 80e-3, settle_distance=20e-3)

    assert lost.information == pytest.approx(free.information, rel=EXACT, abs=0.0)
    assert lost.audit["time_s"] == pytest.approx(0.8, abs=1e-12)


def test_more_runs_shrink_the_sd_by_the_root():
    one = predicted_sd(machine_density, [0.09, 0.13], WAVES, 70e-3).sd
    four = predicted_sd(machine_density, [0.09, 0.13] * 4, WAVES, 70e-3).sd

    assert four["sd_nm"].to_numpy() == pytest.approx(
        one["sd_nm"].to_numpy() / 2, rel=1e-9, abs=0.0
    )


def test_default_length_is_said():
    plan = plan_feedrates(machine_density, [10e-3, 5e-3, 4e-3], 0.08, 0.16, 3)

    assert plan.audit["length_mm"] == pytest.approx(20.0, abs=1e-12)
    assert "longest wavelength" in plan.audit["length_chosen_by"]


# --- words ------------------------------------------------------------------------------------


def test_message_names_frequency_wavelength_feed_and_remedy():
    plan = predicted_sd(machine_density, [0.12] * 3, [10e-3, 5e-3, 4.6e-3], 70e-3)

    text = next(m for m in plan.messages if "12.0 Hz" in m)
    assert "12.0 Hz disturbance maps onto 10.0 mm at 7200 mm/min; add a run at " in text
    remedy = float(text.split("add a run at ")[1]) / 6e4
    better = predicted_sd(machine_density, [0.12] * 3 + [remedy], [10e-3, 5e-3, 4.6e-3], 70e-3)
    assert better.sd["sd_nm"][0] < 0.3 * plan.sd["sd_nm"][0]


def test_one_feed_is_called_what_it_is():
    plan = predicted_sd(machine_density, [0.1, 0.1], WAVES, 70e-3)

    assert any("one feed cannot tell vibration from geometry" in m for m in plan.messages)


BLIND = re.compile(r"waves longer than ([\d.]+) mm repeat like a vibration that starts with")


@pytest.mark.parametrize(("slow", "fast"), [(0.1, 0.11), (0.05, 0.07)])
def test_feeds_too_close_for_the_waves_are_said_with_their_limit(slow, fast):
    """A tone read as the stated wave at the slow feed: at the fast one it has one wave less in 60 mm."""
    plan = predicted_sd(machine_density, [slow, slow, fast], [30e-3, 3e-3], 60e-3)
    limit = float(next(m for m in map(BLIND.search, plan.messages) if m)[1]) * 1e-3
    tone = slow / limit

    assert 60e-3 / limit - 60e-3 * tone / fast == pytest.approx(1.0, abs=0.01)  # 3 digits said
    apart = predicted_sd(machine_density, [0.05, 0.05, 0.15], [30e-3, 3e-3], 60e-3)
    assert not any(map(BLIND.search, apart.messages))


def white(f):
    """10 nm^2/Hz."""
    return 1e-17 + 0.0 * np.asarray(f)


def worst_bias(feeds, wave, travel, tones):
    """Error of the amplitude of a wave, over that of a tone that starts with each run, at worst.

    Least squares with the offset of each run free, samples of 1 kHz with equal weights.
    """
    normal, right = np.zeros((2, 2)), np.zeros((2, 2 * len(tones)))
    for v in feeds:
        t = np.arange(0.0, travel / v, 1e-3)
        basis = np.column_stack(
            [np.cos(2 * np.pi * v * t / wave), np.sin(2 * np.pi * v * t / wave)]
        )
        basis -= basis.mean(axis=0)
        phase = 2 * np.pi * t[:, None] * tones
        normal += basis.T @ basis
        right += basis.T @ np.hstack([np.cos(phase), np.sin(phase)])
    cosine, sine = np.split(np.linalg.solve(normal, right), 2, axis=1)
    matrices = np.stack([cosine, sine], axis=-1).transpose(1, 0, 2)  # from the tone to the wave
    return np.linalg.svd(matrices, compute_uv=False)[:, 0].max()


@pytest.mark.parametrize("wave", [4e-3, 10e-3, 25e-3], ids=["short", "listed", "half the travel"])
def test_a_vibration_that_nobody_listed_cannot_spoil_a_wave(wave):
    """Without a limit of time 8 of 9 runs were at the slowest feed, where a locked tone is the wave."""
    plan = plan_feedrates(white, [10e-3, 4e-3], 1 / 60, 0.16, 9, length=60e-3)

    tones = np.unique(np.concatenate([v / wave * np.linspace(0.9, 1.1, 21) for v in plan.feeds]))
    usual = worst_bias([1 / 60] * 8 + [1.1 / 60], wave, 60e-3, tones)

    assert worst_bias(plan.feeds, wave, 60e-3, tones) < 0.75 < 0.85 < usual


def test_what_the_spread_costs_is_said():
    plan = plan_feedrates(white, [10e-3, 5e-3], 1 / 60, 0.16, 9, length=60e-3)

    text = next(m for m in plan.messages if "more than half of the time and one run" in m)
    own, free = map(float, re.search(r": ([\d.]+) nm instead of ([\d.]+) nm", text).groups())
    # white noise: J = sum of L / (v S), all runs but one at the slowest feed at best
    assert own == pytest.approx(
        1e9 * (60e-3 / 1e-17 * np.sum(1 / plan.feeds)) ** -0.5, rel=2e-3, abs=0.0
    )
    best = 60 * (8 + 1 / 1.1)
    assert free == pytest.approx(1e9 * (60e-3 / 1e-17 * best) ** -0.5, rel=2e-3, abs=0.0)


def test_the_spread_keeps_the_time_and_says_where_it_is_less():
    plan = plan_feedrates(white, [10e-3, 5e-3], 1 / 60, 0.16, 9, length=60e-3, max_time=4.0)

    assert np.sum(60e-3 / plan.feeds) <= 4.0 * (1 + 1e-9)
    assert any("no wider spread" in m for m in plan.messages)
    ratio = float(
        next(filter(None, (re.search(r"no ratio of ([\d.]+) ", m) for m in plan.messages)))[1]
    )
    inside = [(plan.feeds >= v) & (plan.feeds < v * ratio * 0.99) for v in plan.feeds]
    rest = [np.sum(1 / plan.feeds[some]) - 1 / plan.feeds[some].min() for some in inside]
    assert max(rest) <= 0.5 * np.sum(1 / plan.feeds) * (1 + 1e-9)


def test_covered_collision_asks_for_no_run():
    plan = predicted_sd(machine_density, [0.08, 0.12, 0.16] * 3, WAVES, 70e-3)

    text = next(m for m in plan.messages if "10.0 mm at 7200" in m)
    assert "add a run" not in text


# --- forms of the density ---------------------------------------------------------------------


def test_table_samples_and_function_agree():
    f = np.arange(1.0, 501.0, 0.25)
    s = machine_density(f)
    table = pd.DataFrame({"frequency_hz": f, "psd_nm2_per_hz": s * 1e18})

    made = [predicted_sd(p, [0.1, 0.13], WAVES, 70e-3).information for p in (table, (f, s))]

    assert made[0] == pytest.approx(made[1], rel=1e-9, abs=0.0)
    direct = predicted_sd(machine_density, [0.1, 0.13], WAVES, 70e-3).information
    assert made[1] == pytest.approx(direct, rel=0.02, abs=0.0)


def test_psd_object_over_time_and_over_position_agree():
    rng = np.random.default_rng(3)
    t = np.arange(4000) / RATE
    z = 30 * NM * rng.standard_normal(t.size)
    over_time = profile_psd(Profile(t, z))
    over_position = profile_psd(Profile(0.1 * t, z))

    one = predicted_sd(over_time, [0.1, 0.13], WAVES, 70e-3)
    two = predicted_sd(over_position, [0.1, 0.13], WAVES, 70e-3, psd_feed=0.1)

    assert two.information == pytest.approx(one.information, rel=1e-9, abs=0.0)


def test_beyond_the_known_band_nothing_is_invented():
    f = np.linspace(1.0, 30.0, 300)

    plan = predicted_sd((f, machine_density(f)), [0.08, 0.16], [20e-3, 4e-3, 2e-3], 70e-3)

    assert plan.information[2] == 0.0
    assert np.isnan(plan.sd["sd_nm"][2])
    assert plan.information[1] == pytest.approx(
        70e-3 / 0.08 / machine_density(20.0), rel=0.01, abs=0.0
    )
    assert any("not known above 30 Hz" in m for m in plan.messages)
    assert not any("e+" in m for m in plan.messages)
    fast = predicted_sd((f, machine_density(f)), [0.08] + [0.16] * 3, [20e-3, 3e-3], 70e-3)
    slow = predicted_sd((f, machine_density(f)), [0.16] * 3 + [0.2], [20e-3, 5e-3], 70e-3)
    assert fast.audit["worst_sd_nm"] > 0.0
    assert np.isnan(slow.audit["worst_sd_nm"])
    json.dumps(slow.to_dict(), allow_nan=False)


def test_below_the_first_frequency_the_hold_is_said():
    f = np.linspace(5.0, 200.0, 300)

    plan = predicted_sd((f, 1e-18 + 0 * f), [0.08, 0.16], [50e-3, 40e-3, 4e-3], 100e-3)

    assert any("not measured below 5 Hz" in m for m in plan.messages)


def test_density_of_an_estimate_is_accepted():
    from metrosep.separation import machine_axis, separate

    estimate = separate(machine_axis(seed=3).runs)

    plan = plan_feedrates(estimate.residual_psd, (2e-3, 20e-3), 0.08, 0.16, 4)

    assert np.isfinite(plan.sd["sd_nm"]).all()


# --- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"v_min": 4800.0, "v_max": 9600.0}, UnitError, "0.16 m/s"),
        ({"v_min": -0.1}, DataError, "positive"),
        ({"v_min": 0.2}, DataError, "swap"),
        ({"v_min": 0.16}, NotSeparableError, "one feed cannot"),
        ({"n_runs": 1}, TooFewSamplesError, "two"),
        ({"n_runs": 2.5}, DataError, "whole number"),
        ({"wavelengths": [np.nan, 1e-3, 2e-3]}, DataError, "wavelengths"),
        ({"wavelengths": []}, TooFewSamplesError, "wavelengths"),
        ({"wavelengths": [2e-3, 500.0, 3.0]}, UnitError, "500 mm is 0.5"),
        ({"length": 5e-3}, DataError, "less than one wave"),
        ({"max_time": 0.01}, DataError, "allow more time"),
        ({"min_ratio": 0.9}, DataError, "min_ratio"),
        ({"psd": lambda f: -1.0 + 0 * f}, InvalidSamplesError, "above zero"),
        ({"psd": ([1.0, 2.0, 3.0], [1e-18, 0.0, 1e-18])}, InvalidSamplesError, "above zero"),
        ({"psd": ([1.0, 3.0, 2.0], [1e-18] * 3)}, InvalidSamplesError, "rising"),
        ({"psd": ([1.0, 2.0], [1e-18] * 3)}, InvalidSamplesError, "equally long"),
        ({"psd": ([1.0, 200.0], [1.0, 1.0])}, UnitError, "1 nm"),
        ({"psd": "table.csv"}, DataError, "psd must be"),
        ({"psd": pd.DataFrame({"f": [1.0]})}, DataError, "frequency_hz"),
        ({"psd": ([1.0, 2.0], [1e-18, 1e-18])}, NotSeparableError, "known up to"),
    ],
)
def test_refuses(change, error, match):
    arguments = {
        "psd": machine_density,
        "wavelengths": (2e-3, 20e-3),
        "v_min": 0.08,
        "v_max": 0.16,
        "n_runs": 4,
    }

    with pytest.raises(error, match=match):
        plan_feedrates(**{**arguments, **change})


def test_inputs_are_not_changed():
    feeds, waves = np.array([0.16, 0.08]), WAVES.copy()

    plan = predicted_sd(machine_density, feeds, waves, 70e-3)

    assert feeds.tolist() == [0.16, 0.08]
    assert waves.tolist() == WAVES.tolist()
    with pytest.raises(ValueError, match="read-only"):
        plan.information[0] = 0.0


def test_a_tuple_is_a_range_and_a_list_of_two_is_two_waves():
    density = (np.array([1.0, 1000.0]), np.array([1e-18, 1e-18]))

    as_range = plan_feedrates(density, (5e-3, 10e-3), 0.05, 0.2, 4, length=70e-3)
    as_list = plan_feedrates(density, [5e-3, 10e-3], 0.05, 0.2, 4, length=70e-3)

    assert len(as_range.sd) == 121
    np.testing.assert_allclose(sorted(as_list.sd["wavelength_mm"]), [5.0, 10.0], rtol=1e-12)


# -- hostile review ------------------------------------------------------------------------------


def _raises(f):
    raise RuntimeError("no data base")


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"n_runs": np.nan}, DataError, "whole number"),
        ({"n_runs": "6"}, DataError, "whole number"),
        ({"n_runs": np.inf}, DataError, "whole number"),
        ({"min_ratio": "a"}, DataError, "min_ratio must be a number"),
        ({"v_min": 8.0, "v_max": 16.0}, UnitError, "16 mm/s is 0.016 m/s"),
        ({"v_min": [0.08, 0.1]}, DataError, "v_min must be a number in m/s"),
        ({"wavelengths": [10.0, 5.0]}, UnitError, "10 mm is 0.01"),
        ({"wavelengths": [1e-2 + 1j, 2e-2]}, DataError, "complex"),
        ({"psd": _raises}, InvalidSamplesError, "RuntimeError: no data base"),
        ({"psd": lambda f: 1e-18 + 1j * f}, InvalidSamplesError, "complex"),
        ({"psd": lambda f: 1e-18 / 1e-6**2 + 0 * f}, UnitError, "1 um.2/Hz is 1e-12"),
        ({"psd": ([1.0, 200.0], [1e-9, 1e-9])}, UnitError, "1 um.2/Hz is 1e-12"),
        ({"psd": ([1.0, 200.0], [1e-18j, 1e-18])}, InvalidSamplesError, "complex"),
        ({"psd_feed": "a", "psd": profile_psd(Profile(np.arange(64) * 1e-3, np.sin(np.arange(64)) * 1e-9))},
         DataError, "psd_feed must be a number"),
    ],
)  # fmt: skip
def test_refuses_what_is_typed_wrong(change, error, match):
    usual = {
        "psd": machine_density,
        "wavelengths": (2e-3, 20e-3),
        "v_min": 0.08,
        "v_max": 0.16,
        "n_runs": 4,
    }
    with pytest.raises(error, match=match):
        plan_feedrates(**{**usual, **change})


def test_long_waves_are_planned_on_a_stated_travel_with_a_hint():
    white = (np.array([1e-3, 1e3]), np.array([1e-18, 1e-18]))
    plan = predicted_sd(white, [0.1, 0.2], [3.0], 12.0)
    assert "12 m: both are in m" in plan.messages[0]
    assert not any("both are in m" in m for m in predicted_sd(white, [0.1], [1.9], 12.0).messages)


def test_plan_is_plain_and_copied():
    white = (np.array([1.0, 1e3]), np.array([1e-18, 1e-18]))
    plan = predicted_sd(white, [0.1, 0.2], [5e-3, 1.0], 1.0)
    document = json.loads(json.dumps(plan.to_dict(), allow_nan=False))
    assert document["feeds"] == [0.1, 0.2]
    assert "mm" in plan._repr_html_()
    for again in (copy.copy(plan), copy.deepcopy(plan), pickle.loads(pickle.dumps(plan))):  # noqa: S301
        assert again.to_dict() == plan.to_dict()
        assert again.sd.equals(plan.sd)
        assert again.density(np.array([2.0])) == 1e-18
        with pytest.raises(ValueError, match="read-only"):
            again.feeds[0] = 1.0
    by_formula = copy.deepcopy(predicted_sd(lambda f: 1e-18 + 0 * f, [0.1], [5e-3], 0.1))
    assert by_formula.density.source == "function S(f)"
