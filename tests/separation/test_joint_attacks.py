"""Attacks on the joint separation through its door; the simulator here shares no code with it.

A late reading shows the error of the place that was passed `lag` seconds ago; waves are sines of
x in mm, heights in nm.
"""

import math
import warnings

import numpy as np
import pytest

from metrosep.core.errors import DataError, MetrosepError, UnitError
from metrosep.core.runset import Run, RunSet
from metrosep.separation import separate

WAVES = ((12.0, 90.0, 0.4), (6.3, 60.0, 1.9), (27.0, 120.0, 2.2))
FEEDS = (80.0, 120.0, 160.0)


def truth_nm(x_mm):
    return sum(a * np.sin(2.0 * np.pi * x_mm / wave + p) for wave, a, p in WAVES)


def runs_of(
    *,
    noise_nm=20.0,
    shape=truth_nm,
    slope_nm_per_mm=0.0,
    change=None,
    lag_s=0.0,
    step_s=2e-3,
    direction=1,
):
    rng = np.random.default_rng(5)
    out = []
    for i, feed in enumerate(np.repeat(FEEDS, 2)):
        t = np.arange(int(50.0 / (feed * step_s)) + 1) * step_s
        x = feed * t if direction > 0 else 50.0 - feed * t
        seen = x - direction * feed * lag_s
        z = shape(seen) + slope_nm_per_mm * x + rng.normal(0.0, noise_nm, x.size) + 100.0 * i
        if change is not None:
            z = change(z)
        out.append(Run(x * 1e-3, z * 1e-9, t=t, feed=feed * 1e-3, run_id=f"r{i}"))
    return RunSet(out)


def error_and_band_nm(estimate, shown=truth_nm):
    x = np.linspace(estimate.start, estimate.stop, 500)
    rest = estimate.evaluate(x) * 1e9 - shown(x * 1e3)
    rest = rest - np.polyval(np.polyfit(x, rest, 1), x)
    return math.sqrt(np.mean(rest**2)), math.sqrt(np.mean(estimate.sd(x) ** 2)) * 1e9


def test_a_steep_alignment_slope_is_not_called_a_step_of_the_readings():
    """5 mm/m is 1600 nm a sample at 160 mm/s and 2 ms: the readings are no multiples of it."""
    estimate = separate(runs_of(slope_nm_per_mm=5000.0))
    error, band = error_and_band_nm(estimate)
    assert not [m for m in estimate.messages if "steps of" in m]
    # 20 nm white over about 1400 samples leaves about 3 nm; a step of 800 nm would add 230
    assert error < 3.0 * band
    assert band < 10.0


def test_steps_are_found_beside_a_slope():
    """Readings in steps of 100 nm that rise by about 0.6 steps a sample."""
    runs = runs_of(slope_nm_per_mm=300.0, change=lambda z: 100.0 * np.round(z / 100.0))
    estimate = separate(runs)
    assert [m for m in estimate.messages if "steps of 100 nm" in m]


def test_robust_takes_readings_of_which_every_tenth_is_missing():
    """The slope was taken from every 20th part of a run, which may be the missing samples only."""

    def holes(z):
        z = z.copy()
        z[:: z.size // 20] = np.nan
        return z

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        error, band = error_and_band_nm(separate(runs_of(change=holes), robust=True))
    assert error < 3.0 * band < 30.0


@pytest.mark.parametrize("waves", [[0.0], [-5e-3], [math.nan], [math.inf]])
def test_a_wavelength_must_be_positive(waves):
    with pytest.raises(UnitError, match="a wavelength of waves is"):
        separate(runs_of(), waves=waves)


def test_a_wavelength_that_is_not_looked_for_is_named():
    """The travel is 50 mm, the shortest wave 2.5 pitches of 0.32 mm, which its neighbours hold."""
    told = [m for m in separate(runs_of(), waves=[0.2, 12e-3, 1e-5]).messages if "waves " in m]
    assert len(told) == 2
    assert told[0].startswith(
        "waves 200 mm: not looked for, since they are longer than the travel"
    )
    assert told[1].startswith("waves 10 um: not looked for, since only waves from ")
    assert "the samples of the fastest run are 320 um apart and do not show them" in told[1]


def test_what_a_wave_below_two_pitches_reads_as_is_said():
    """Triggered every 0.5 mm at both feedrates: a wave of 0.7 mm is one of 1.75 mm to all runs."""
    x = np.arange(0.0, 40.01, 0.5)
    rng = np.random.default_rng(5)
    wave = 80.0 * np.cos(2 * math.pi * x / 0.7)
    np.testing.assert_allclose(wave, 80.0 * np.cos(2 * math.pi * x / 1.75), rtol=0.0, atol=1e-9)
    runs = RunSet(
        [
            Run(
                x * 1e-3,
                (wave + rng.normal(0.0, 5.0, x.size)) * 1e-9,
                t=x / v,
                feed=v * 1e-3,
                run_id=f"{v:g}-{k}",
            )
            for v in (10.0, 23.0)
            for k in range(2)
        ]
    )

    told = [m for m in separate(runs, waves=[0.7e-3, 8e-3]).messages if "one pitch of" in m]

    assert len(told) == 1
    assert "a wave below two pitches reads as a longer one (700 um as 1.75 mm)" in told[0]


def test_one_wavelength_needs_no_list():
    assert separate(runs_of(), waves=12e-3).audit["options"]["waves_mm"] == [
        pytest.approx(12.0, abs=0.0)
    ]


@pytest.mark.parametrize("slip", ["Geometry", None, 1])
def test_slip_is_one_of_its_words(slip):
    """Any other word was taken for the other answer."""
    with pytest.raises(DataError, match="slip is one of geometry, sparse"):
        separate(runs_of(), slip=slip)


def test_constant_readings_are_refused_whatever_their_last_bit():
    """0.1 + 0.2 is not 0.3: the mean of equal numbers may differ from them."""
    runs = [
        Run(r.x, np.full(r.x.size, 1e-7 * (i + 1) / 3.0), t=r.t, feed=r.feed, run_id=r.run_id)
        for i, r in enumerate(runs_of())
    ]
    with pytest.raises(MetrosepError, match=r"constant|everywhere"):
        separate(RunSet(runs), accept="suspect")


@pytest.mark.parametrize("direction", [1, -1])
def test_a_late_reading_has_a_positive_lag_in_both_directions(direction):
    estimate = separate(runs_of(lag_s=2e-3, direction=direction))
    error, band = error_and_band_nm(estimate)
    # 5 of its uncertainties; the sign of the lag is 10 of them away
    assert abs(estimate.lag - 2e-3) < 5.0 * estimate.lag_sd < 2e-3
    assert error < 3.0 * band


def test_the_order_of_the_runs_does_not_matter():
    runs = list(runs_of())
    x = np.linspace(0.0, 49e-3, 300)
    one, other = separate(RunSet(runs)), separate(RunSet(runs[::-1]))
    assert np.abs(one.evaluate(x) - other.evaluate(x)).max() < 1e-9 * 1e-7


def test_an_estimate_that_holds_the_error_is_not_called_nothing():
    """A long wave of 500 nm under 300 nm of noise: no single row of the spectrum is selected."""

    def shape(x_mm):
        return truth_nm(x_mm) + 500.0 * np.sin(2.0 * np.pi * x_mm / 81.0 + 0.2)

    estimate = separate(runs_of(noise_nm=300.0, shape=shape))
    error, band = error_and_band_nm(estimate, shape)
    assert error < 3.0 * band < 150.0
    assert not [m for m in estimate.messages if "nothing to compensate" in m]
