"""Which set-up adds most: against a Bayesian least squares of all set-ups, columns written by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from metrosep.machine import (
    Ballbar,
    Displacement,
    ReadingSet,
    calibrate,
    plan_calibration,
    presets,
)

TRAVEL, NOISE, PRIOR = 0.4, 1e-7, np.array([5e-6, 5e-6, 30e-6])
LINE = np.linspace(0.0, TRAVEL, 9)
TURN = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
SEEDS = 25
TERMS = ["EXX", "EYY", "C0Y"]


def sets():
    """Two lines, one along nothing that is asked for, a short bar and a long one about unknown balls."""

    def line(name, u, x, y, unknown=("offset",)):
        return ReadingSet(Displacement(direction=u), {"X": x, "Y": y, "Z": 0.0}, np.zeros(9), unknown=unknown, name=name)  # fmt: skip

    def circle(name, r):
        q = {"X": 0.2 + r * np.cos(TURN), "Y": 0.2 + r * np.sin(TURN), "Z": 0.0}
        bar = Ballbar(ball=(0.2, 0.2, 0.0))
        return ReadingSet(bar, q, np.zeros(24), unknown=("ball", "length"), name=name)

    return [
        line("x", (1, 0, 0), LINE, 0.0), line("y", (0, 1, 0), 0.0, LINE),
        line("z", (0, 0, 1), LINE, 0.1), line("across", (1, 0, 0), 0.1, LINE, ("offset", "slope")),
        circle("short", 0.05), circle("long", 0.15),
    ]  # fmt: skip


def rows_of(one):
    """Return columns of EXX and EYY (a straight line over the travel, zero at home), C0Y, then its own."""
    x, y = (np.broadcast_to(one.q[a], np.size(one.values)) for a in "XY")
    E = np.zeros((x.size, 3, 3))
    E[:, 0, 0], E[:, 1, 1], E[:, 0, 2] = 2.0 * x / TRAVEL, 2.0 * y / TRAVEL, -y
    if isinstance(one.instrument, Ballbar):
        away = np.stack([x - 0.2, y - 0.2, 0 * x], axis=-1)
        u = away / np.linalg.norm(away, axis=1)[:, None]
        own = np.column_stack([-u, np.ones(x.size)])  # one of the four is blind
    else:
        u = np.tile(one.instrument.direction, (x.size, 1))
        own = np.ones((x.size, 1))
        if "slope" in one.unknown:
            own = np.column_stack([own, y])
    return np.einsum("ni,nij->nj", u, E), own


def spread(chosen, places):
    """Return the RMS of u of the error vector after sets, unknowns of 1 m and all else by its prior."""
    terms, own = zip(*(rows_of(s) for s in chosen), strict=True)
    wide = sum(o.shape[1] for o in own)
    A, at = np.zeros((sum(t.shape[0] for t in terms), 3 + wide)), 3
    begin = 0
    for t, o in zip(terms, own, strict=True):
        A[begin : begin + t.shape[0], :3] = t
        A[begin : begin + t.shape[0], at : at + o.shape[1]] = o
        begin, at = begin + t.shape[0], at + o.shape[1]
    scale = np.append(PRIOR, np.full(wide, 1.0))
    whole = np.vstack([A * scale / NOISE, np.eye(3 + wide)])
    _, s, Vt = np.linalg.svd(whole, full_matrices=False)
    cov = (Vt.T / s**2) @ Vt * np.outer(scale, scale)
    x, y = places
    E = np.zeros((x.size, 3, 3))
    E[:, 0, 0], E[:, 1, 1], E[:, 0, 2] = 2.0 * x / TRAVEL, 2.0 * y / TRAVEL, -y
    return np.sqrt(np.mean(np.einsum("nij,jk,nik->n", E, cov[:3, :3], E)))


def greedy(candidates, done, places):
    order, left = [], list(candidates)
    while left:
        sizes = [spread([*done, *order, s], places) for s in left]
        order.append(left.pop(int(np.argmin(sizes))))
        yield order[-1].name, min(sizes)


@pytest.mark.parametrize("done", [(), ("x",), ("long", "x")])
def test_the_order_and_the_sizes_are_those_of_brute_force(done):
    listed = sets()
    before = [s for s in listed if s.name in done]
    candidates = [s for s in listed if s.name not in done]
    x, y = (np.array(v) for v in zip(*itertools.product(LINE, LINE), strict=True))
    found = plan_calibration(
        presets("mill_xyz"), candidates, volume={"X": x, "Y": y, "Z": 0.0}, terms=TERMS, degrees=1,
        noise=NOISE, done=before,
    )  # fmt: skip
    wanted = list(greedy(candidates, before, (x, y)))
    assert [size for _, size in found] == pytest.approx([s for _, s in wanted], rel=1e-5, abs=0.0)
    named = [n for n, _ in found]
    by_name = {s.name: s for s in listed}
    for i, (_, size) in enumerate(found):  # by its own order too: x and y are alike
        own = [*before, *(by_name[n] for n in named[: i + 1])]
        assert spread(own, (x, y)) == pytest.approx(size, rel=1e-5, abs=0.0)
    assert named[-1] == "z"  # which shows nothing of what is asked for


def test_one_short_line_can_be_asked_about():
    """Three readings for more unknowns than that: they add something all the same."""
    one = ReadingSet(
        Displacement(direction=(1, 0, 0)), {"X": np.array([0.0, 0.2, 0.4]), "Y": 0.1, "Z": 0.0},
        np.zeros(3), unknown=("offset",), name="three",
    )  # fmt: skip
    found = plan_calibration(
        presets("mill_xyz"), [one], volume={"X": LINE, "Y": 0.1, "Z": 0.0}, degrees=2
    )
    assert found[0][0] == "three"


# ---- what was foretold, against readings with noise --------------------------------------------------


@pytest.mark.parametrize("added", [("y", "long"), ("y", "short")])
def test_what_the_plan_foretells_comes_true_with_readings(added):
    """Of machines and readings drawn anew: the RMS of what is off over the volume, and the u that is stated."""
    by_name = {s.name: s for s in sets()}
    x, y = (np.array(v) for v in zip(*itertools.product(LINE, LINE), strict=True))
    volume = {"X": x, "Y": y, "Z": np.zeros(x.size)}
    E = np.zeros((x.size, 3, 3))
    E[:, 0, 0], E[:, 1, 1], E[:, 0, 2] = 2.0 * x / TRAVEL, 2.0 * y / TRAVEL, -y
    mill = presets("mill_xyz")
    plan = plan_calibration(
        mill, [by_name[n] for n in added], volume=volume, terms=TERMS, degrees=1, noise=NOISE,
        done=[by_name["x"]],
    )  # fmt: skip
    off, stated = [], []
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, 61])
        true, read = PRIOR * rng.normal(size=3), []
        for one in (by_name[n] for n in ("x", *added)):
            columns, own = rows_of(one)
            values = columns @ true + own @ (20e-6 * rng.normal(size=own.shape[1]))
            values = values + NOISE * rng.normal(size=values.size)
            read.append(replace(one, values=values, u=NOISE))
        found = calibrate(mill, read, terms=TERMS, degrees=1)
        by_term = dict(
            zip((n.split(" ")[0] for n in found.names), found.coefficients, strict=True)
        )
        off.append(np.einsum("nij,j->ni", E, [by_term[t] for t in TERMS] - true))
        stated.append(found.u_at(volume))
    foretold = plan[-1][1]
    came = math.sqrt(np.mean(np.sum(np.square(off), axis=2)))
    said = math.sqrt(np.mean(np.sum(np.square(stated), axis=2)))
    # of 3 numbers and as many seeds a scatter is known to 1/sqrt(2 n)
    assert came == pytest.approx(foretold, abs=3.0 * foretold / math.sqrt(2.0 * 3 * SEEDS))
    # u holds the orders beyond the first too, which the plan takes as zero
    assert foretold * 0.98 < said < 1.5 * foretold
