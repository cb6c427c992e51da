"""`calibrate` on readings of a display with few digits: its steps are neither a form nor a proof."""

import numpy as np
import pytest

from metrosep.core.errors import MetrosepError
from metrosep.machine import Displacement, ReadingSet, calibrate, presets

REACH = 0.4
DIGIT = 1e-6


def read(truth, places, runs, noise, digit, seed):
    """A laser along X whose display shows whole digits."""
    rng = np.random.default_rng([seed, 11])
    x = np.tile(np.linspace(0.0, REACH, places), runs)
    y = truth(x) + rng.normal(0.0, noise, x.size)
    y = np.round(y / digit) * digit if digit else y
    laser = Displacement(direction=(1, 0, 0))
    return ReadingSet(laser, {"X": x, "Y": 0.0, "Z": 0.0}, y, unknown=("offset",), name="laser")


@pytest.mark.parametrize(("places", "runs", "noise"), [(11, 3, 50e-9), (21, 5, 150e-9)])
def test_the_steps_of_a_display_are_not_followed(places, runs, noise):
    """2 um over 400 mm shown in whole micrometres: truth within 2 u, no reading refused or accused."""
    inside = []
    x = np.linspace(0.0, REACH, places)
    for seed in range(6):
        one = read(lambda x: 2e-6 * x / REACH, places, runs, noise, DIGIT, seed)
        found = calibrate(presets("mill_xyz"), [one], terms=["EXX"])
        term = found.errors["EXX"]
        off = np.abs(term.evaluate(x) - 2e-6 * x / REACH)[1:]
        inside.append(np.mean(off <= 2.0 * term.sd(x)[1:]))
        said = " ".join(found.messages)
        assert not any(w in said for w in ("pasted", "refused", "repeats every", "not determined"))
    assert np.mean(inside) > 0.9  # 0.95 with normal noise


def test_readings_pasted_twice_are_still_reported():
    one = read(lambda x: 2e-6 * x / REACH, 11, 1, 50e-9, 1e-10, 0)
    twice = ReadingSet(
        one.instrument, {a: np.tile(v, 2) if np.ndim(v) else v for a, v in one.q.items()},
        np.tile(np.ravel(one.values), 2), unknown=("offset",), name="laser",
    )  # fmt: skip
    found = calibrate(presets("mill_xyz"), [twice], terms=["EXX"])
    assert "pasted twice" in " ".join(found.messages)


def test_sets_that_do_not_determine_a_term_foretell_nothing_of_it():
    """A yaw of 19 urad shows at Y = 200 mm only: 20 times the reading at Y = 0 is no wrong unit."""
    rng = np.random.default_rng(3)
    x = np.tile(np.r_[np.linspace(0.0, REACH, 11), np.linspace(REACH, 0.0, 11)], 3)
    sets = [
        ReadingSet(
            Displacement(direction=(1, 0, 0)), {"X": x, "Y": y, "Z": 0.0},
            slope * x + rng.normal(0.0, 1e-7, x.size), unknown=("offset",), name=f"at {y}",
        )
        for y, slope in ((0.0, 0.5e-6), (0.2, 10e-6))
    ]  # fmt: skip
    found = calibrate(presets("mill_xyz"), sets, terms=["EXX", "ECX"])
    assert "foretell" not in " ".join(found.messages)
    yaw = -(10e-6 - 0.5e-6) / 0.2 * REACH  # at the end of the travel: dx = -Y ECX
    assert found.errors["ECX"].evaluate(REACH).item() == pytest.approx(yaw, abs=1.5e-6)


def test_u_holds_the_digit_of_the_display_however_often_it_is_read():
    """One slope through whole micrometres without noise: repeats show the same digits and prove nothing."""
    x = np.linspace(0.0, REACH, 11)
    u = []
    for runs in (1, 9):
        one = read(lambda x: 2e-6 * x / REACH, 11, runs, 0.0, DIGIT, 0)
        found = calibrate(presets("mill_xyz"), [one], terms=["EXX"], degrees=1, robust=False)
        u.append(found.errors["EXX"].sd(x)[-1])
    # closed form: slope of independent errors q/sqrt(12) at eleven places
    spread = DIGIT / np.sqrt(12.0) * REACH / np.sqrt(np.sum((x - x.mean()) ** 2))
    # and half of it for a curve that is as small as the digits, which no number of runs shows
    assert 0.999 * spread <= u[1] <= 1.5 * spread
    assert u[0] >= 0.999 * spread


def test_readings_of_one_value_need_the_resolution_of_their_display():
    q = {"X": np.linspace(0.0, REACH, 11), "Y": 0.0, "Z": 0.0}
    laser, flat = Displacement(direction=(1, 0, 0)), np.full(11, 3e-6)
    plain = ReadingSet(laser, q, flat, unknown=("offset",))
    found = calibrate(presets("mill_xyz"), [plain], terms=["EXX"], degrees=1)
    assert "give its resolution" in " ".join(found.messages)
    stated = ReadingSet(laser, q, flat, unknown=("offset",), resolution=DIGIT)
    found = calibrate(presets("mill_xyz"), [stated], terms=["EXX"], degrees=1)
    assert found.errors["EXX"].sd(REACH).item() > 0.2e-6
    with pytest.raises(MetrosepError, match="resolution"):
        ReadingSet(laser, q, flat, resolution=-1e-6)
