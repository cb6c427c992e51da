"""Vibrations that slide: planted ones are found at every feedrate, geometry and noise are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrosep.app.map_views import Vibration, find_vibrations
from metrosep.core.runset import Run, RunSet
from metrosep.separation import separate

MM, NM = 1e-3, 1e-9
TRAVEL, STEP = 60 * MM, 1e-3
FEEDS = (0.08, 0.12, 0.16)

RESOLUTION = 0.02
"""Relative: runs of 0.4 to 0.8 s at 60 Hz resolve some 2 Hz, a clear peak is placed to a half of it."""


def runs_of(disturbance, *, feeds=FEEDS, geometry=0.0, ways=(1,), seed=0):
    rng = np.random.default_rng(seed)
    made = []
    for way in ways:
        for feed in feeds:
            for name in "ab":
                t = np.arange(0.0, TRAVEL / feed, STEP)
                x = feed * t if way > 0 else TRAVEL - feed * t
                z = 200 * NM * np.sin(2 * np.pi * x / (15 * MM))
                z = z + geometry * np.sin(2 * np.pi * x / (2 * MM) + 1.0)
                z = z + disturbance(rng, t) + 3 * NM * rng.standard_normal(t.size)
                made.append(Run(x, z, t=t, feed=feed, run_id=f"{name}{feed}{way}"))
    return RunSet(made)


def sine(frequency, amplitude=40 * NM):
    return lambda rng, t: (
        amplitude * np.sin(2 * np.pi * frequency * t + rng.uniform(0.0, 2 * np.pi))
    )


def resonance(frequency, damping=0.02, rms=40 * NM):
    """A mode that noise shakes, stepped exactly at its poles."""

    def made(rng, t):
        w = 2 * np.pi * frequency
        pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * w * STEP)
        a, b = 2 * pole.real, -(abs(pole) ** 2)
        z = np.zeros(t.size + 500)
        shock = rng.standard_normal(z.size)
        for i in range(2, z.size):
            z[i] = a * z[i - 1] + b * z[i - 2] + shock[i]
        return rms * z[500:] / z[500:].std()

    return made


def quiet(rng, t):
    return 0.0 * t


def found_in(runs, direction=1, **options):
    options.setdefault("method", "kono")
    options.setdefault("shortest", 5 * MM)
    estimate = separate(runs, start=7 * MM, length=45 * MM, **options)
    return find_vibrations(runs, estimate, direction=direction)


def test_a_vibration_lies_at_v_over_f():
    found, why = found_in(runs_of(sine(60.0)))

    assert why == ""
    (one,) = found
    assert abs(one.frequency / 60.0 - 1.0) < RESOLUTION
    assert one.source == "residual"
    for v, w in zip(FEEDS, one.wavelengths, strict=True):
        assert abs(w / (v / 60.0) - 1.0) < RESOLUTION
    assert one.wavelengths[2] > one.wavelengths[0]


def test_a_broad_resonance_is_found_too():
    found, _ = found_in(runs_of(resonance(150.0)))

    assert [abs(v.frequency / 150.0 - 1.0) < RESOLUTION for v in found] == [True]


def test_geometry_that_was_not_taken_off_is_no_vibration():
    # 2 mm: 40, 60 and 80 Hz, never the same
    found, _ = found_in(runs_of(quiet, geometry=60 * NM))
    assert found == ()


def test_both_are_told_apart():
    found, _ = found_in(runs_of(sine(110.0), geometry=60 * NM))

    assert [abs(v.frequency / 110.0 - 1.0) < RESOLUTION for v in found] == [True]


@pytest.mark.parametrize("seed", range(12))
def test_noise_alone_has_no_vibration(seed):
    def red(rng, t):
        z = np.zeros(t.size + 200)
        shock = rng.standard_normal(z.size)
        for i in range(1, z.size):
            z[i] = 0.95 * z[i - 1] + shock[i]
        return 10 * NM * z[200:]

    assert found_in(runs_of(red, seed=seed))[0] == ()


def test_each_direction_has_its_own():
    def one_way(rng, t):
        return sine(60.0)(rng, t) if len(calls) % 12 >= 6 else 0.0 * t

    calls: list[int] = []

    def counted(rng, t):
        made = one_way(rng, t)
        calls.append(1)
        return made

    runs = runs_of(counted, ways=(1, -1))  # six quiet runs forward, six that shake reverse
    assert found_in(runs, direction=1)[0] == ()
    assert len(found_in(runs, direction=-1)[0]) == 1


def test_one_feedrate_cannot_tell():
    found, why = found_in(runs_of(sine(60.0), feeds=(0.08,)))

    assert found == ()
    assert "one feedrate only" in why


def test_runs_without_a_feedrate_cannot_tell():
    runs = RunSet([Run(r.x, r.z, run_id=r.run_id) for r in runs_of(sine(60.0))])

    found, why = found_in(runs, method="mean", shortest=None)

    assert found == ()
    assert "no feedrate" in why


def test_a_gap_is_not_bridged():
    runs = runs_of(sine(60.0))
    holed = []
    for i, r in enumerate(runs):
        z = r.z.copy()
        if i == 0:
            z[300:330] = np.nan
        holed.append(Run(r.x, z, t=r.t, feed=r.feed, run_id=r.run_id))

    found, _ = found_in(RunSet(holed), method="mean", shortest=None)

    assert [abs(v.frequency / 60.0 - 1.0) < RESOLUTION for v in found] == [True]


@pytest.mark.slow
def test_a_line_that_was_taken_out_is_named_once():
    found, _ = found_in(runs_of(sine(60.0)), method="joint", lines=[60.0])

    assert [v.source for v in found] == ["line"]
    assert abs(found[0].frequency - 60.0) < 0.2


@pytest.mark.parametrize("by_direction", [False, True])
def test_lines_of_the_terms_come_first_and_once(by_direction):
    runs = runs_of(sine(60.0))
    estimate = separate(runs, method="mean", start=7 * MM, length=45 * MM)
    lines = {"lines": {"lines": {"frequency_hz": [60.2, 20.0]}}}
    estimate = replace(estimate, terms={"forward": lines} if by_direction else lines)

    found, _ = find_vibrations(runs, estimate, direction=1)

    assert [(v.frequency, v.source) for v in found] == [(20.0, "line"), (60.2, "line")]


def test_wavelengths_follow_from_the_feed():
    assert Vibration(12.5, (0.08, 0.12), "line").wavelengths == (0.08 / 12.5, 0.12 / 12.5)
