"""Three readings of one nest with unequal noise, and harmonics that few places cannot tell apart.

The table turns about Z; u is that of means and Fourier sums, which sines of equal places have in closed form.
"""

import math

import numpy as np
import pytest

from metrosep.machine import Nest, ReadingSet, calibrate, presets

UM = 1e-6
TERMS = ["X0C", "Y0C", "EXC", "EYC", "EZC"]
BALL = (0.07, -0.03, 0.045)


def turned(n, turns, noise, *, seed=3, x0c=9 * UM, u=None, bad=()):
    """One ball on a table that goes round some times; the three readings with noises of their own."""
    rng = np.random.default_rng(seed)
    machine = presets("five_axis", pivot_height=0.08)
    c = np.tile(np.arange(n) * 2.0 * math.pi / n, turns)
    # where the tool must stand, by hand: the ball on a circle about C, the table turns the other way
    x = BALL[0] * np.cos(c) + BALL[1] * np.sin(c)
    y = -BALL[0] * np.sin(c) + BALL[1] * np.cos(c)
    q = {"X": x, "Y": y, "Z": np.full(c.size, BALL[2] + 0.08), "A": np.zeros(c.size), "C": c}
    # the line of C stands beside its place by +x, so the work does: the tool misses it by -x
    values = np.tile([-x0c, 0.0, 0.0], (c.size, 1)) + rng.normal(size=(c.size, 3)) * noise
    for i, channel, by in bad:
        values[i, channel] += by
    nest = ReadingSet(Nest(ball=BALL), q, values, unknown=("ball",), u=u, name="ball 1")
    return calibrate(machine, [nest], terms=TERMS, degrees=2)


def test_a_loud_height_leaves_the_place_in_the_plane_as_well_known_as_it_is():
    quiet = turned(12, 4, (0.2 * UM, 0.2 * UM, 0.2 * UM))
    loud = turned(12, 4, (0.2 * UM, 0.2 * UM, 3.0 * UM))
    closed = 0.2 * UM / math.sqrt(48)
    for found in (quiet, loud):
        assert found["X0C"].value == pytest.approx(9 * UM, abs=4 * closed)  # 4 u
        # Student's t, drift that cannot be excluded and what the orders leave out raise it
        assert closed * 0.8 < found["X0C"].u < closed * 1.6
    # u of the loud height is 15 times that of the quiet one, and of nothing else
    at = np.linspace(0, 6, 40)
    ratio = np.median(loud["EZC"].sd(at)) / np.median(quiet["EZC"].sd(at))
    assert ratio == pytest.approx(15.0, abs=4.5)  # a standard deviation of 40 readings: 11 % each
    said = " ".join(loud.messages)
    assert "ball 1: its readings in x, y and z have a white noise of" in said
    assert "have a white noise of" not in " ".join(quiet.messages)
    rms = math.sqrt((2 * 0.2**2 + 3.0**2) / 3) * UM
    assert loud.noise["ball 1"] == pytest.approx(rms, rel=0, abs=0.3 * rms)


def test_a_bad_reading_of_the_quiet_channel_is_seen_beside_a_loud_one():
    """2 um are 10 times the noise in x, and less than one of the height."""
    found = turned(12, 4, (0.2 * UM, 0.2 * UM, 3.0 * UM), bad=[(17, 0, 2 * UM), (30, 2, 2 * UM)])
    refused = np.isnan(found.residuals["ball 1"])
    assert refused[17, 0]
    assert np.count_nonzero(refused) == 1


def test_few_readings_and_a_stated_noise_share_one_scale():
    few = turned(12, 2, (0.2 * UM, 0.2 * UM, 3.0 * UM))
    assert few["X0C"].u > 3 * 0.2 * UM / math.sqrt(24)
    said = " ".join(few.messages)
    assert "fewer than 30 readings in each series" in said
    stated = turned(12, 4, (0.2 * UM, 0.2 * UM, 0.2 * UM), u=0.4 * UM)
    assert stated["X0C"].u > 0.9 * 0.4 * UM / math.sqrt(48)


@pytest.mark.parametrize(("places", "said"), [(6, True), (7, False), (12, False)])
def test_harmonics_that_look_alike_at_few_places_are_named(places, said):
    found = turned(places, 6, (0.2 * UM,) * 3)
    named = f"C was read at {places} places: there harmonics from {places - 2} on look like those"
    assert (named in " ".join(found.messages)) is said
    if said:  # by hand: at 60 degrees cos 4C is cos 2C
        c = np.arange(6) * math.pi / 3
        assert np.cos(4 * c) == pytest.approx(np.cos(2 * c), abs=1e-12)
        assert "read 7 places or more" in " ".join(found.messages)
