"""Columns of an R-test that are not what they say: a unit of the positions, a channel that was never read."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, UnitError
from metrosep.machine import Nest, ReadingSet, calibrate, presets

UM = 1e-6
BALL = (0.07, -0.03, 0.045)
PIVOT = 0.08
Y0A, Z0A, X0C = 11 * UM, -6 * UM, 9 * UM
TERMS = ["Y0A", "Z0A", "X0C"]


def set_of(*, factor=1.0, order=(0, 1, 2), sign=1.0, unread=(), ball=BALL, noise=0.1 * UM):
    """One ball at six places of A and twelve of C; the lines act as machines.md, eq. 13 and 4, say."""
    a, c = (
        v.ravel() for v in np.meshgrid(np.radians([-90, -60, -30, 0, 15, 30]), np.arange(12) * math.pi / 6)
    )  # fmt: skip
    x = BALL[0] * np.cos(c) + BALL[1] * np.sin(c)
    y = -BALL[0] * np.sin(c) + BALL[1] * np.cos(c)
    z = BALL[2] + PIVOT
    q = {
        "X": x * factor,
        "Y": (y * np.cos(a) + z * np.sin(a)) * factor,
        "Z": (-y * np.sin(a) + z * np.cos(a)) * factor,
        "A": a,
        "C": c,
    }
    # what carries the work stands beside its place, so the tool misses it the other way
    values = -np.stack([np.full(a.size, X0C), np.full(a.size, Y0A), np.full(a.size, Z0A)], axis=1)
    values = sign * values[:, list(order)]
    values = values + noise * np.random.default_rng(5).normal(size=values.shape)
    values[:, list(unread)] = np.nan
    return ReadingSet(Nest(ball=ball), q, values, unknown=("ball",), name="ball 1")


def found_of(one, **options):
    return calibrate(presets("five_axis", pivot_height=PIVOT), [one], terms=TERMS, **options)


def test_the_lines_come_back():
    found = found_of(set_of())
    for term, true in (("Y0A", Y0A), ("Z0A", Z0A), ("X0C", X0C)):
        assert found[term].value == pytest.approx(true, abs=0.1 * UM)


def test_a_channel_that_was_never_read_leaves_its_line_open():
    """Without z nothing sees Z0A; what is left of it by rounding is no reading (5e8 m came of it)."""
    found = found_of(set_of(unread=(2,)))
    assert math.isnan(found["Z0A"].value)
    assert any(n.startswith("Z0A: no reading depends on it") for n in found.null)
    assert found["Y0A"].value == pytest.approx(Y0A, abs=0.1 * UM)
    assert found["X0C"].value == pytest.approx(X0C, abs=0.1 * UM)


@pytest.mark.parametrize("factor", [1e-3, 0.0254])
def test_positions_in_another_unit_are_refused_by_the_ball_that_is_stated(factor):
    with pytest.raises(DataError, match="from the ball that the set-up states; check the unit"):
        found_of(set_of(factor=factor))


def test_a_ball_that_is_stated_to_a_centimetre_is_found():
    found = found_of(set_of(ball=(0.08, -0.02, 0.035)))
    assert found["Y0A"].value == pytest.approx(Y0A, abs=0.1 * UM)


def test_readings_in_millimetres_are_refused_with_the_key_of_a_file():
    one = set_of()
    with pytest.raises(UnitError, match=r"check the unit of the column.*total = true in a file"):
        ReadingSet(Nest(ball=BALL), one.q, np.asarray(one.values) * 1e3 + 5.0)
