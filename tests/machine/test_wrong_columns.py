"""Columns of an R-test that are not what they say: a unit of the positions, a channel that was never read."""

import dataclasses
import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, UnitError
from metrosep.machine import Length, Nest, ReadingSet, calibrate, presets

UM = 1e-6
BALL = (0.07, -0.03, 0.045)
PIVOT = 0.08
Y0A, Z0A, X0C = 11 * UM, -6 * UM, 9 * UM
TERMS = ["Y0A", "Z0A", "X0C"]


def turned(point, a, c):
    """Where a point of the table is on the bed: C takes x towards -y, then A takes y towards -z."""
    x, y = (
        point[0] * np.cos(c) + point[1] * np.sin(c),
        -point[0] * np.sin(c) + point[1] * np.cos(c),
    )
    return x, y * np.cos(a) + point[2] * np.sin(a), -y * np.sin(a) + point[2] * np.cos(a)


def set_of(
    *,
    factor=1.0,
    order=(0, 1, 2),
    sign=1.0,
    unread=(),
    ball=BALL,
    noise=0.1 * UM,
    beside=(0.0, 0.0, 0.0),
    name="ball 1",
):
    """One ball at six places of A and twelve of C; the lines act as machines.md, eq. 13 and 4, say."""
    a, c = (
        v.ravel() for v in np.meshgrid(np.radians([-90, -60, -30, 0, 15, 30]), np.arange(12) * math.pi / 6)
    )  # fmt: skip
    x, y, z = turned(np.add(BALL, (0.0, 0.0, PIVOT)), a, c)
    q = {"X": x * factor, "Y": y * factor, "Z": z * factor, "A": a, "C": c}
    # what carries the work stands beside its place, so the tool misses it the other way
    values = -np.stack([np.full(a.size, X0C), np.full(a.size, Y0A), np.full(a.size, Z0A)], axis=1)
    values = values - np.stack(turned(beside, a, c), axis=1)  # and so does a ball beside its place
    values = sign * values[:, list(order)]
    values = values + noise * np.random.default_rng(5).normal(size=values.shape)
    values[:, list(unread)] = np.nan
    return ReadingSet(Nest(ball=ball), q, values, unknown=("ball",), name=name)


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


# ---- channels that changed places or sign ---------------------------------------------------------

BESIDE = (31 * UM, -17 * UM, 44 * UM)
"""By how much a ball stands beside its place: of it each channel shows something else at each pose."""


def said_of(sets):
    found = calibrate(presets("five_axis", pivot_height=PIVOT), sets, terms=TERMS)
    return found, [m for m in found.messages if "would fall from" in m]


@pytest.mark.parametrize(
    ("order", "sign", "words"),
    [
        ((1, 0, 2), (1, 1, 1), "with reading_x and reading_y exchanged what"),
        ((0, 2, 1), (1, 1, 1), "with reading_y and reading_z exchanged what"),
        ((2, 1, 0), (1, 1, 1), "with reading_x and reading_z exchanged what"),
        ((0, 1, 2), (1, -1, 1), "with the sign of reading_y turned what"),
        ((0, 1, 2), (1, 1, -1), "with the sign of reading_z turned what"),
        ((1, 0, 2), (1, -1, 1), "with reading_x and reading_y exchanged, then the sign of reading_x turned what"),
        ((1, 2, 0), (1, 1, 1), "reading_x taken from reading_z, reading_y taken from reading_x, reading_z taken from reading_y what"),
    ],
)  # fmt: skip
def test_channels_that_changed_places_or_sign_are_named(order, sign, words):
    _, said = said_of([set_of(order=order, sign=np.array(sign), beside=BESIDE)])
    assert len(said) == 1
    assert said[0].startswith("ball 1: ")
    assert words in said[0]


def test_the_set_that_changed_is_named_and_not_the_others():
    other = set_of(ball=None, beside=(-25 * UM, 40 * UM, 12 * UM), name="ball 2")
    _, said = said_of([set_of(order=(1, 0, 2), beside=BESIDE), other])
    assert len(said) == 1
    assert said[0].startswith("ball 1: ")


def test_all_sets_of_one_wrong_wiring_are_named_together():
    sets = [
        set_of(order=(0, 2, 1), beside=BESIDE),
        set_of(order=(0, 2, 1), beside=(-25 * UM, 40 * UM, 12 * UM), name="ball 2"),
    ]
    _, said = said_of(sets)
    assert len(said) == 1
    assert said[0].startswith("ball 1, ball 2: ")
    assert "reading_y and reading_z exchanged" in said[0]


def test_the_remedy_that_is_named_brings_the_lines_back():
    wrong = set_of(order=(1, 0, 2), sign=np.array((1, -1, 1)), beside=BESIDE)
    values = np.asarray(wrong.values)[:, [1, 0, 2]] * (-1, 1, 1)  # exchanged, then x turned
    found, said = said_of([dataclasses.replace(wrong, values=values)])
    assert said == []
    for term, true in (("Y0A", Y0A), ("Z0A", Z0A), ("X0C", X0C)):
        assert found[term].value == pytest.approx(true, abs=0.1 * UM)


@pytest.mark.parametrize("seed", range(6))
def test_readings_in_their_places_are_not_called_exchanged(seed):
    """Also with three readings that are far off, and drift beside the noise."""
    rng = np.random.default_rng([seed, 88])
    one = set_of(beside=BESIDE, noise=0.0)
    values = np.asarray(one.values) + 0.3 * UM * rng.normal(size=(72, 3))
    values = values + np.cumsum(0.2 * UM * rng.normal(size=(72, 3)), axis=0)
    values[rng.choice(72, 3, replace=False)] += 40 * UM
    assert said_of([dataclasses.replace(one, values=values)])[1] == []


def test_a_refusal_by_the_stated_noise_says_it_too():
    wrong = dataclasses.replace(set_of(order=(1, 0, 2), beside=BESIDE), u=0.1 * UM)
    with pytest.raises(DataError, match=r"contradicts .* reading_x and reading_y exchanged"):
        calibrate(presets("five_axis", pivot_height=PIVOT), [wrong], terms=TERMS, robust=False)


STATIONS = [(-0.35, -0.3, -0.2), (0.8, -0.25, -0.15), (0.15, 0.75, -0.25)]


def lengths(factor=1.0, away=(0.0, 0.0, 0.0), terms=("EXX", "EYY")):
    """Distances from three trackers on a mill with a scale of X of 10 um/m; one file is multiplied by a factor."""
    grid = np.stack(np.meshgrid([0.0, 0.2, 0.5], [0.0, 0.2, 0.4], [0.0, 0.1, 0.3]), axis=-1)
    p, sets = grid.reshape(-1, 3), []
    for k, station in enumerate(STATIONS):
        real = np.add(station, (2e-3, -1e-3, 3e-3))
        long = np.linalg.norm(p * [1 + 10e-6, 1, 1] - real, axis=1) + 0.4e-3
        stated = np.add(station, away) if k == 1 else station
        of = Length(station=tuple(stated))
        q = dict(zip("XYZ", p.T, strict=True))
        sets.append(
            ReadingSet(
                of,
                q,
                factor * long if k == 1 else long,
                unknown=("station", "dead_path"),
                total=True,
                name=f"tracker {k + 1}",
            )
        )
    return calibrate(presets("mill_xyz"), sets, terms=terms, degrees=2)


@pytest.mark.parametrize(
    ("away", "terms"), [((0.5, -0.4, 0.6), ("EXX", "EYY")), ((-0.9, 0.6, 0.3), None)]
)
def test_a_tracker_far_from_its_stated_station_is_found(away, terms):
    """With all terms free the sets together ran away, the stations to 100 m."""
    found = lengths(away=away, terms=terms)
    assert found.unknowns["tracker 2"]["station"][0] == pytest.approx(
        np.add(STATIONS[1], (2e-3, -1e-3, 3e-3)), abs=1e-5
    )
    if terms:  # the scale of one axis against the other: that of all is the unit of the lengths
        x, y = (found.fitted[n].evaluate(0.4) for n in terms)
        assert x - y == pytest.approx(4e-6, abs=1e-8)


@pytest.mark.parametrize("factor", [-1.0, 25.4, 1 / 25.4])
def test_lengths_that_no_station_explains_are_refused_by_the_name_of_their_set(factor):
    with pytest.raises(DataError, match=r"tracker 2: there is no station .* unit and the sign"):
        lengths(factor)


def test_a_channel_that_stands_is_named_and_does_not_outweigh_the_others():
    """A column of one value (a probe that was never connected) was taken for a reading without noise."""
    listed = [set_of(), set_of(name="ball 2", noise=0.12 * UM)]
    values = np.array(listed[0].values)
    values[:, 0] = -26.103 * UM
    stands = dataclasses.replace(listed[0], values=values)
    found = calibrate(presets("five_axis", pivot_height=PIVOT), [stands, listed[1]], terms=TERMS)
    said = " ".join(found.messages)
    assert "ball 1: its readings in x are -26.1 um at all poses" in said
    # no number better than the noise of 144 poses, 0.1 um each, could make it
    assert found["X0C"].u > 0.1 * UM / math.sqrt(144)
    right = calibrate(presets("five_axis", pivot_height=PIVOT), listed, terms=TERMS)
    assert "at all poses" not in " ".join(right.messages)


def test_a_set_at_one_pose_is_said_to_add_nothing_and_not_judged_by_a_tool_or_a_unit():
    rng = np.random.default_rng(5)
    listed = [set_of(), set_of(name="ball 2", noise=0.12 * UM)]
    q = {a: np.full(60, np.ravel(v)[7]) for a, v in listed[0].q.items()}
    values = np.asarray(listed[0].values)[7] + 0.1 * UM * rng.normal(size=(60, 3))
    alone = dataclasses.replace(listed[0], q=q, values=values, name="ball 3")
    found = calibrate(presets("five_axis", pivot_height=PIVOT), [*listed, alone], terms=TERMS)
    of_it = [m for m in found.messages if m.startswith("ball 3")]
    assert any("adds nothing" in m for m in of_it)
    assert not any("tool point" in m or "times what the other sets" in m for m in of_it)
