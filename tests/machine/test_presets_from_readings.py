"""Every error term of every preset from readings of indicators, levels, lasers, a ballbar and a nest.

The machines are those of `drawn_machines`: bodies that quaternions turn.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from machine.calibration_rates import Rate, calibrated
from machine.drawn_machines import DRAWINGS, PIVOT, RADIUS, Machine, draw, unit

from metrosep.machine import (
    Angle,
    Ballbar,
    Displacement,
    Nest,
    ReadingSet,
    calibrate,
    correct_path,
    presets,
)

NM = 1e-9  # m or rad: what the issue asks for; products of two errors of 2 um or urad are 1e-12


def readings(machine, rng, lines=6, n=13):
    """Lines of each axis by indicator, laser and level at random places and tools; a ballbar and a nest."""
    sets = []
    for axis, _, way, *_ in machine.bodies():
        for k in range(lines + 4):
            # all the others stand at a random place
            q = {
                a: np.full(n, rng.uniform(*(v or (-3, 3))))
                for a, v in machine.drawing["travel"].items()
            }
            q[axis] = draw(machine, axis, n, rng)
            t = rng.uniform(-0.1, 0.1, 3)
            if k < lines:
                u = np.abs(way) if k == 0 else unit(rng)  # the laser runs along the axis
                values = machine.missed(q, t) @ u + rng.normal() * 1e-5
                sets.append(
                    ReadingSet(Displacement(direction=u), q, values, tool=t, unknown=("offset",))
                )
            else:
                u = unit(rng)
                values = machine.turned(q) @ u + rng.normal() * 1e-5
                sets.append(ReadingSet(Angle(direction=u), q, values, tool=t, unknown=("offset",)))
    turns = {
        a: rng.uniform(*(v or (-3, 3)), 60)
        for a, v in machine.drawing["travel"].items()
        if a in "AC"
    }
    plane = "Y" not in machine.drawing["travel"]
    ball, t, bar = (0.0, 0.0, 0.0), (0.0, 0.0, -0.03), 0.01
    if not plane:
        ball, t, bar = (0.05, 0.03, 0.04), (0.02, -0.01, -0.06), 0.06
    away = rng.normal(size=(60, 3)) * ((1, 0, 1) if plane else (1, 1, 1))
    away *= bar / np.linalg.norm(away, axis=1)[:, None]
    if plane and turns:  # the tool stays in the plane of X and Z, whatever the spindle does
        away = machine.on_work(
            {"X": 0 * turns["C"], "Z": 0 * turns["C"], "FTS": 0 * turns["C"], **turns},
            away,
            wrong=0.0,
            free=True,
        )
    q = machine.follow(np.array(ball) + away, t, turns)
    real = np.add(ball, 3e-6 * rng.normal(size=3))  # where nobody knows it stands
    long = np.linalg.norm(machine.tool_on_work(q, t) - real, axis=1)
    sets.append(ReadingSet(Ballbar(ball=ball), q, long - bar, tool=t, unknown=("ball",)))
    q = machine.follow(np.tile(ball, (60, 1)), t, turns)
    off = machine.tool_on_work(q, t) - np.add(ball, 2e-6 * rng.normal(size=3))
    values = machine.place("work", q, off, wrong=0.0, free=True)
    sets.append(ReadingSet(Nest(ball=ball), q, values, tool=t, unknown=("ball",)))
    for axis, travel in machine.drawing[
        "travel"
    ].items():  # places beyond it would move the reference lines
        assert travel is None or all(travel[0] <= v <= travel[1] for s in sets for v in s.q[axis])
    return sets


def largest_miss(name, seed):
    """Return the number of terms that came back, of all, and the largest miss of a curve or number."""
    rng = np.random.default_rng(seed)
    machine = Machine(name, rng)
    options = {"fts_lathe": {"radius": RADIUS}, "five_axis": {"pivot_height": PIVOT}}.get(name, {})
    chain = presets(name, **options)
    degrees = {a: 3 if v is None else 4 for a, v in machine.drawing["travel"].items()}
    found = calibrate(chain, readings(machine, rng), degrees=degrees)
    assert set(found.errors) == {*machine.motions, *machine.lines} == set(chain.terms)
    misses = {}
    for term, truth in machine.motions.items():
        low, high = machine.drawing["travel"][term[2:]] or (0.0, 6.2)
        x = np.linspace(low, high, 101)
        misses[term] = float(np.abs(found.errors[term].evaluate(x) - truth(x)).max())
    for term, value in machine.lines.items():
        misses[term] = abs(found.errors[term].value - value)
    return misses, found


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWINGS)
@pytest.mark.parametrize("seed", [1, 2])
def test_all_terms_of_each_preset_come_back_from_its_instruments(name, seed):
    misses, found = largest_miss(name, seed)
    assert found.null == ()
    assert all(np.isfinite(v) for v in misses.values())
    worst = max(misses, key=misses.get)
    print(
        f"{name}: {len(misses)} terms, largest miss {misses[worst] / NM:.3f} nm or nrad ({worst})"
    )
    assert misses[worst] < NM


# ---- how far u may be trusted ----------------------------------------------------------------------


@pytest.mark.slow
def test_95_of_100_truths_are_within_2_u_with_balls_of_unknown_place():
    """80 seeds of the table that tools/calibration_coverage.py makes: 11 lines, 6 motions of the table."""
    rate = Rate()
    for seed in range(80):
        assert calibrated("R-test", seed, rate).null == ()
    share, worst, least, _ = Rate.of(rate.numbers)
    print(f"R-test: {share:.4f}, worst {worst} {least:.3f}")
    assert 0.93 <= share <= 0.975
    assert least > 0.85  # four binomial deviations below 0.95


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mill_xyz", "five_axis"])
@pytest.mark.parametrize("seed", [41, 403, 404])
def test_poses_and_tools_that_were_not_used_are_ten_times_better_when_corrected(name, seed):
    """Readings of 0.1 um noise; the commands of `correct_path` go to the drawn machine, not to the model."""
    rng = np.random.default_rng(seed)
    machine = Machine(name, rng)
    chain = presets(name, **({"pivot_height": PIVOT} if name == "five_axis" else {}))
    sets = []
    for one in readings(machine, rng):
        values = np.squeeze(np.asarray(one.values))
        values = values + 0.1e-6 * rng.normal(size=values.shape)
        sets.append(dataclasses.replace(one, values=values))
    degrees = {a: 3 if v is None else 4 for a, v in machine.drawing["travel"].items()}
    found = calibrate(chain, sets, degrees=degrees)
    q = {
        a: rng.uniform(*(np.multiply(v, 0.95) if v else (-3, 3)), 200)
        for a, v in machine.drawing["travel"].items()
    }
    t = (-0.05, 0.07, -0.09)
    meant = machine.tool_on_work(q, t, wrong=0.0)
    path = correct_path(chain, found.fitted, q, tool=t)
    rms = []
    for sign in (0.0, 1.0, -1.0):
        commands = {a: v + sign * path.correction.get(a, 0.0) for a, v in q.items()}
        off = machine.tool_on_work(commands, t) - meant
        rms.append(float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
    before, after, flipped = rms
    print(
        f"{name}, seed {seed}: {before * 1e6:.3f} -> {after * 1e6:.4f} um, wrong sign {flipped * 1e6:.3f} um"
    )
    assert after < before / 10
    assert flipped > 1.8 * before
