"""The joint separator through its door with readings that are not tidy; the simulator is ours alone.

mm, nm, s. A late reading shows the error of the place x - v d, v signed. Noise: 5 nm white and a line
of 37 Hz, 60 nm, whose phase wanders.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep import Run, RunSet
from metrosep.core.errors import DataError, UnitError
from metrosep.separation import separate

pytestmark = pytest.mark.slow
"""A minute together; the faults that each of these found have a fast test in test_joint_attacks.py."""

L_MM, RATE_HZ, FEEDS = 60.0, 500.0, (40.0, 80.0, 130.0)
GOOD_NM = 1.0
"""What is left of 150 nm RMS: six runs of 230 to 750 readings average 5 nm to some 0.4 nm."""


def error(x):
    """Not symmetric in x: a wave, a shorter one, a bow about 21 mm."""
    return (
        200 * np.cos(2 * math.pi * x / 11.3 + 0.3)
        + 60 * np.sin(2 * math.pi * x / 4.1)
        + 0.02 * (x - 21) ** 2
    )


def sets(ways=(1,), *, zero=0.0, slope=0.0, lag=0.0, white=5.0, line=60.0, change=None):
    rng = np.random.default_rng(7)
    runs = []
    for way in ways:
        for v in FEEDS:
            for _ in range(2):
                n = int(L_MM / v * RATE_HZ) + 1
                t = np.arange(n) / RATE_HZ
                x = v * t if way > 0 else L_MM - v * t
                phase = rng.uniform(0, 2 * math.pi) + 0.5 * np.cumsum(
                    rng.normal(size=n)
                ) / math.sqrt(RATE_HZ)
                z = error(x - way * v * lag) + slope * x + rng.normal() * 100
                z = z + white * rng.normal(size=n) + line * np.sin(2 * math.pi * 37 * t + phase)
                if change:
                    z = change(len(runs), x, z)
                runs.append(Run((x + zero) * 1e-3, z * 1e-9, t=t, run_id=f"r{len(runs)}"))
    return RunSet(runs)


def left(runs, *, zero=0.0, **options):
    """RMS of estimate minus truth, and of its sd, in nm, offset and line removed; the estimate."""
    estimate = separate(runs, start=(1 + zero) * 1e-3, length=58e-3, **options)
    x = np.linspace(1.5, 58.5, 400)
    rest = estimate.evaluate((x + zero) * 1e-3) * 1e9 - error(x)
    rest = rest - np.polyval(np.polyfit(x, rest, 1), x)
    assert np.isfinite(rest).all()
    return (
        float(np.sqrt(np.mean(rest**2))),
        float(np.sqrt(np.mean(estimate.sd((x + zero) * 1e-3) ** 2))) * 1e9,
        estimate,
    )


@pytest.mark.parametrize("way", [1, -1])
def test_a_late_reading_is_put_back_in_either_direction(way):
    rms, _, estimate = left(sets((way,), lag=1e-3))
    assert rms < GOOD_NM
    assert estimate.lag == pytest.approx(1e-3, rel=0.0, abs=0.15e-3)  # four of its u


@pytest.mark.parametrize(
    "change",
    [
        lambda i, x, z: np.where(np.arange(z.size) % 10 == 3, np.nan, z),
        lambda i, x, z: np.where((x > 20) & (x < 23), np.nan, z) if i % 2 else z,
        lambda i, x, z: np.where(np.arange(z.size) < 30, np.nan, z),
    ],
    ids=["every tenth", "a stretch of some runs", "the start"],
)
def test_missing_readings_are_neither_zeros_nor_the_end_of_a_run(change):
    rms, sd, _ = left(sets(change=change))
    assert rms < GOOD_NM
    assert sd < GOOD_NM


def test_a_steep_alignment_is_neither_error_nor_a_coarse_sensor():
    """5 mm/m: each reading is 1 um beyond the last, as if the sensor had steps of 1 um."""
    rms, sd, estimate = left(sets(slope=5000.0))
    assert rms < GOOD_NM
    assert sd < GOOD_NM
    assert not any("steps" in m for m in estimate.messages)
    assert estimate.slope.value == pytest.approx(5e-3, rel=1e-3, abs=0.0)


def test_a_travel_far_from_zero_changes_nothing():
    near, far = left(sets())[2], left(sets(zero=1200.0), zero=1200.0)[2]
    x = np.linspace(2e-3, 58e-3, 50)
    np.testing.assert_allclose(
        far.evaluate(x + 1.2), near.evaluate(x), rtol=0.0, atol=1e-12
    )  # positions of 1.2 m have 1e-16 m of rounding, the fit multiplies it


def test_readings_without_noise_give_the_error_itself():
    rms, _, _ = left(sets(white=0.0, line=0.0))
    assert rms < 0.02  # a ten-thousandth of the readings, below which no noise is believed


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"slip": "no"}, DataError, "slip is one of geometry, sparse"),
        ({"waves": ["4.1"]}, UnitError, "has no unit"),
        ({"waves": [-1e-3]}, UnitError, "-0.001|positive"),
    ],
)
def test_a_wrong_option_is_refused_in_one_sentence(options, kind, text):
    with pytest.raises(kind, match=text):
        separate(sets(), **options)


def test_stated_waves_take_their_units():
    rms, _, estimate = left(sets(), waves=["4.1 mm", "11.3 mm"])
    assert rms < GOOD_NM
    found = [w["wavelength_mm"] for w in estimate.audit["waves"]]
    assert found == pytest.approx([11.3, 4.1], rel=2e-3, abs=0.0)
