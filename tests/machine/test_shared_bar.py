"""Ballbar sets that were taken with one bar share its error of length; a point of two slides and a rod say what was read."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.io.reading_sets import read_reading_set
from metrosep.machine import Ballbar, ReadingSet, calibrate, plan_calibration, presets

UM = 1e-6
SCALE_X, SCALE_Y, SQUARE, LONGER = 23 * UM, -14 * UM, 31 * UM, 9 * UM
TERMS = ["EXX", "EYY", "C0Y"]
STANDS = (0.2 + 40 * UM, 0.15 - 25 * UM)
"""Where the ball really stands; it should be at 200 mm, 150 mm."""


def circle(radius, longer=LONGER, step=5.0):
    """Places, and what a rod that is longer than it says shows of them: the gap that is left is read as change."""
    a = np.radians(np.arange(0.5, 360.0, step))
    x, y = 0.2 + radius * np.cos(a), 0.15 + radius * np.sin(a)
    at = x * (1 + SCALE_X) - SQUARE * y, y * (1 + SCALE_Y)
    return x, y, np.hypot(at[0] - STANDS[0], at[1] - STANDS[1]) - radius + longer


def taken(radius, name, *, artefact="bar 7", unknown=("ball", "length"), noise=0.0, u=None):
    x, y, change = circle(radius)
    change = change + noise * np.random.default_rng(round(radius * 1e3)).normal(size=x.size)
    return ReadingSet(
        Ballbar(ball=(0.2, 0.15, 0.0)),
        {"X": x, "Y": y, "Z": 0.0},
        change,
        unknown=unknown,
        name=name,
        artefact=artefact,
        u=u,
    )


def found_of(sets):
    return calibrate(presets("mill_xyz"), sets, terms=TERMS, degrees=1)


def scale(found, term):
    return float(found.fitted[term].evaluate(0.1) / 0.1)


def test_two_circles_of_one_bar_tell_the_scales_and_its_length():
    found = found_of([taken(0.05, "small"), taken(0.15, "large")])
    # the ball 50 um off its place is second order: (50 um)^2 / 50 mm is 50 nm
    assert scale(found, "EXX") == pytest.approx(SCALE_X, abs=0.1 * UM)
    assert scale(found, "EYY") == pytest.approx(SCALE_Y, abs=0.1 * UM)
    assert found["C0Y"].value == pytest.approx(SQUARE, abs=0.1 * UM)
    for label in ("small", "large"):
        assert found.unknowns[label]["length"][0] == pytest.approx(LONGER, abs=10e-9)
    assert not any("length" in n for n in found.null)


def test_bars_that_nothing_says_are_one_leave_scale_and_length_one():
    for artefact in ("", None):
        sets = [
            taken(r, n, artefact=artefact if artefact is not None else f"bar of {n}")
            for r, n in ((0.05, "small"), (0.15, "large"))
        ]
        found = found_of(sets)
        assert any("length" in n and "EXX" in n for n in found.null)
        assert math.isnan(float(found["EXX"].evaluate(0.1)))


def test_the_unknown_is_named_by_the_bar():
    sets = [taken(0.1, "one"), taken(0.1, "two")]
    found = found_of(sets)
    assert any("length of bar 7" in n for n in found.null)
    assert not any("length of one" in n for n in found.null)


def test_a_bar_whose_length_is_stated_is_not_shared():
    with pytest.raises(DataError, match=r"artefact 'bar 7' is named.*add length to its unknown"):
        taken(0.1, "one", unknown=("ball",))


def test_a_file_names_its_bar(tmp_path):
    sets = []
    for radius, name in ((0.05, "small"), (0.15, "large")):
        x, y, change = circle(radius)
        head = [
            '# instrument = "ballbar"', '# ball = "200 mm, 150 mm, 0 mm"', '# at = { Z = "0 mm" }',
            '# unknown = ["ball", "length"]', '# artefact = "bar 7"', "X_mm,Y_mm,reading_um",
        ]  # fmt: skip
        rows = [f"{1e3 * a:.6f},{1e3 * b:.6f},{1e6 * c:.4f}" for a, b, c in zip(x, y, change, strict=True)]  # fmt: skip
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
        sets.append(read_reading_set(file, presets("mill_xyz")))
    found = found_of(sets)
    assert scale(found, "EYY") == pytest.approx(SCALE_Y, abs=0.1 * UM)


def test_the_plan_knows_that_a_second_circle_of_the_bar_tells_its_length():
    done = [taken(0.05, "small", u=0.2 * UM)]
    volume = {"X": np.linspace(0.0, 0.4, 5), "Y": 0.1, "Z": 0.0}
    said = {
        of: plan_calibration(
            presets("mill_xyz"),
            [taken(0.15, "large", artefact=of, u=0.2 * UM)],
            volume=volume, degrees=1, terms=TERMS, done=done,
        )[0][1]
        for of in ("bar 7", "bar 8")
    }  # fmt: skip
    assert said["bar 7"] < 0.25 * said["bar 8"]
