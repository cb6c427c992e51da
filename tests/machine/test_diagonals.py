"""Diagonals and reversals: what a laser reads along lines drawn in space, and what the readings can tell."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.machine import Displacement, ReadingSet, calibrate, presets

NM, URAD = 1e-9, 1e-6
SPAN = np.array([0.5, 0.4, 0.3])  # m
MILL = presets("mill_xyz")
SQUARE = {"C0Y": 12e-6, "B0Z": -7e-6, "A0Z": 9e-6}
SCALE = {"EXX": 8e-6, "EYY": -5e-6, "EZZ": 3e-6}  # per m


def lines(square=SQUARE, scale=SCALE):
    """Ways of the three axes in space: the tool against the work, per metre of travel."""
    x = np.array([1.0, 0.0, 0.0]) * (1.0 + scale["EXX"])
    y = np.array([-square["C0Y"], 1.0, 0.0]) * (1.0 + scale["EYY"])
    z = np.array([square["B0Z"], -square["A0Z"], 1.0]) * (1.0 + scale["EZZ"])
    return np.stack([x, y, z])


def diagonal(flips, n=11):
    """Direction and commanded places of one body diagonal from its corner."""
    start = np.where(np.array(flips) > 0, 0.0, SPAN)
    s = np.linspace(0.0, 1.0, n)[:, None]
    return np.array(flips) * SPAN / np.linalg.norm(SPAN), start + s * (np.array(flips) * SPAN)


def steps(flips, n=6):
    """The same corners, reached by steps of X, then Y, then Z."""
    start = np.where(np.array(flips) > 0, 0.0, SPAN)
    places, at = [start.copy()], start.copy()
    for _ in range(n):
        for axis in range(3):
            at = at + np.eye(3)[axis] * np.array(flips) * SPAN / n
            places.append(at.copy())
    return np.array(flips) * SPAN / np.linalg.norm(SPAN), np.array(places)


BODY = [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)]


def q_of(places):
    return dict(zip("XYZ", places.T, strict=True))


def laser(u, places, rng=None, noise=0.0, off=(0.0, 0.0, 0.0)):
    """What a laser along u (turned by a little) says of the actual places, minus what was commanded."""
    beam = u + np.array(off)
    beam = beam / np.linalg.norm(beam)
    actual = places @ lines()
    read = (actual - actual[0]) @ beam - (places - places[0]) @ u
    return read + (0.0 if rng is None else noise * rng.normal(size=read.size))


@pytest.mark.parametrize("way", [diagonal, steps])
def test_the_chain_reads_what_lines_in_space_say(way):
    errors = {**SQUARE, **{n: (lambda x, k=k: k * x) for n, k in SCALE.items()}}
    for flips in BODY:
        u, places = way(flips)
        read = MILL.read(Displacement(direction=tuple(u)), q_of(places), errors)
        # first order: products of two errors of 12e-6 over 0.7 m are 0.1 nm
        assert_allclose(read - read[0], laser(u, places), rtol=0, atol=0.2 * NM)


def test_the_four_diagonals_give_squareness_with_its_sign():
    rng = np.random.default_rng(1)
    sets = []
    for flips in BODY:
        u, places = diagonal(flips)
        values = laser(u, places, rng, 20 * NM) + 1e-6 * rng.normal()
        sets.append(
            ReadingSet(Displacement(direction=tuple(u)), q_of(places), values, unknown=("offset",))
        )
    found = calibrate(MILL, sets, terms=[*SQUARE, *SCALE], degrees=1)
    for name, value in SQUARE.items():
        term = found.errors[name]
        assert abs(term.value - value) < 4.0 * term.u < 0.5 * URAD
    # three scales act alike on all four: only their sum is known, and that is said
    assert all(np.isnan(found.errors[n].evaluate(0.1)) for n in SCALE)
    assert any(
        {"EXX order 1", "EYY order 1", "EZZ order 1"} & set(s.split(", ")) for s in found.null
    )


ALL = [f"E{d}{a}" for a in "XYZ" for d in "XYZABC"] + list(SQUARE)


def rank_of(way, degree, unknown, terms=ALL, n=11):
    rng = np.random.default_rng(2)
    sets = []
    for flips in BODY:
        u, places = way(flips, n)
        values = laser(u, places, rng, 20 * NM)
        sets.append(
            ReadingSet(Displacement(direction=tuple(u)), q_of(places), values, unknown=unknown)
        )
    found = calibrate(MILL, sets, terms=list(terms), degrees=degree, robust=False)
    per_line = sum({"offset": 1, "beam": 2}[name] for name in unknown)
    return len(found.names), found.audit["rank"] - 4 * per_line


def test_what_body_diagonals_can_tell():
    """Numbers of machines.md, section 6."""
    assert rank_of(diagonal, 1, ("offset",)) == (15, 7)
    assert rank_of(diagonal, 3, ("offset",)) == (51, 15)
    assert rank_of(diagonal, 1, ("offset",), [*SQUARE, *SCALE]) == (6, 4)


def test_what_step_diagonals_can_tell_depends_on_the_beam():
    """A beam that is off looks like scale: with its direction unknown the steps lose two directions a line."""
    assert rank_of(steps, 1, ("offset",)) == (15, 11)
    assert rank_of(steps, 1, ("offset", "beam")) == (15, 9)
    assert rank_of(steps, 1, ("offset",), [*SQUARE, *SCALE]) == (6, 6)
    assert rank_of(steps, 1, ("offset", "beam"), [*SQUARE, *SCALE]) == (6, 4)


def test_a_beam_that_is_off_does_not_become_scale():
    rng = np.random.default_rng(3)
    sets, blind = [], []
    for flips in BODY:
        u, places = steps(flips, 11)
        across = np.cross(u, rng.normal(size=3))
        values = laser(u, places, rng, 20 * NM, off=2e-4 * across / np.linalg.norm(across))
        setup = Displacement(direction=tuple(u)), q_of(places), values
        sets.append(ReadingSet(*setup, unknown=("offset", "beam")))
        blind.append(ReadingSet(*setup, unknown=("offset",)))
    terms = [*SQUARE, *SCALE]
    found = calibrate(MILL, sets, terms=terms, degrees=1)
    for name, value in SQUARE.items():
        assert abs(found.errors[name].value - value) < 4.0 * found.errors[name].u
    trusted = calibrate(MILL, blind, terms=terms, degrees=1, robust=False)
    worst = max(abs(float(trusted.fitted[n].evaluate(0.5)) / 0.5 - k) for n, k in SCALE.items())
    assert worst > 20e-6  # what a beam that is taken for true makes of the scales


# ---- reversal --------------------------------------------------------------------------------------


def bow(x):
    """Straightness of X in Y, actual minus nominal."""
    return 3e-6 * ((x - 0.25) / 0.25) ** 2 + 0.6e-6 * np.sin(2 * np.pi * x / 0.5)


def profile(x):
    """Height of the straightedge out of its surface: a dent on one side, a rough end."""
    return -2e-6 * np.exp(-(((x - 0.12) / 0.05) ** 2)) + 0.5e-6 * (x > 0.4)


def edge(sign, rng=None, noise=0.0, *, x=None, slope=0.0, name="edge"):
    """An indicator in the spindle on a straightedge on the table, its plunger in the direction sign Y.

    The gap between tool and surface shrinks when the tool goes towards the surface, and by the height of
    the surface: the plunger goes in by the sum.
    """
    x = np.linspace(0.0, 0.5, 26) if x is None else x
    read = sign * bow(x) + profile(x) + slope * x + 4e-6
    read = read + (0.0 if rng is None else noise * rng.normal(size=x.size))
    return ReadingSet(
        Displacement(direction=(0.0, sign, 0.0)),
        {"X": x, "Y": 0.2, "Z": 0.0},
        read,
        unknown=("offset", "slope", "form"),
        artefact="straightedge 7",
        name=name,
    )


def about_line(x, y):
    return y - np.polyval(np.polyfit(x, y, 1), x)


def test_a_straightedge_is_told_apart_by_its_reversal():
    rng = np.random.default_rng(5)
    sets = [
        edge(1, rng, 20 * NM, slope=8e-6),
        edge(-1, rng, 20 * NM, slope=-3e-6, name="reversed"),
    ]
    x = np.linspace(0.0, 0.5, 26)
    found = calibrate(MILL, sets, terms=["EYX"], degrees=9, robust=False)

    shape = about_line(x, found.errors["EYX"].evaluate(x))
    form, u = found.unknowns["edge"]["form"]

    assert found.null == ()
    assert_allclose(shape, about_line(x, bow(x)), rtol=0, atol=60 * NM)
    assert_allclose(about_line(x, form), about_line(x, profile(x)), rtol=0, atol=80 * NM)
    assert u.max() < 40 * NM
    # the reversed sign would be wrong by twice the bow
    assert np.abs(shape + about_line(x, bow(x))).max() > 2e-6


def test_one_side_alone_cannot_tell_and_says_so():
    with pytest.raises(DataError, match="straightedge 7 was read from one side only"):
        calibrate(MILL, [edge(1), edge(1, name="again")], terms=["EYX"], degrees=4)


def test_the_order_of_the_places_does_not_matter():
    there = np.linspace(0.0, 0.5, 26)
    sets = [edge(1), edge(-1, x=there[::-1], name="reversed")]
    found = calibrate(MILL, sets, terms=["EYX"], degrees=9, robust=False)
    form, _ = found.unknowns["edge"]["form"]
    back, _ = found.unknowns["reversed"]["form"]
    assert_allclose(back[::-1], form, rtol=0, atol=1e-15)
    assert_allclose(
        about_line(there, form), about_line(there, profile(there)), rtol=0, atol=60 * NM
    )


def test_a_square_is_told_apart_by_its_reversal():
    """Its first leg lies along X; the second is off by the angle of the square, and has a profile."""
    rng = np.random.default_rng(6)
    y = np.linspace(0.0, 0.4, 17)
    off, sets = 25e-6, []
    for sign in (1.0, -1.0):
        # C0Y = 12e-6: the tool moves to -X when it goes along Y
        read = (
            sign * (-SQUARE["C0Y"] * y)
            + off * y
            + 1e-6 * np.sin(9 * y)
            + 20 * NM * rng.normal(size=17)
        )
        sets.append(
            ReadingSet(
                Displacement(direction=(sign, 0.0, 0.0)),
                {"X": 0.0, "Y": y, "Z": 0.0},
                read,
                unknown=("offset", "form"),
                artefact="square",
                name=f"leg {sign:+.0f}",
            )
        )
    found = calibrate(MILL, sets, terms=["C0Y"])
    term = found.errors["C0Y"]
    assert abs(term.value - SQUARE["C0Y"]) < 4.0 * term.u < 0.5 * URAD
    form, _ = found.unknowns["leg +1"]["form"]
    assert (
        abs(np.polyfit(y, form, 1)[0] - off - np.polyfit(y, 1e-6 * np.sin(9 * y), 1)[0])
        < 0.3 * URAD
    )


def test_too_few_places_and_wrong_unknowns_are_refused():
    x = np.array([0.0, 0.5, 0.5])
    sides = [
        ReadingSet(
            Displacement(direction=(sign, 0.0, 0.0)),
            {"X": 0.0, "Y": x, "Z": 0.0},
            x * 1e-6,
            unknown=("offset", "form"),
            artefact="square",
        )
        for sign in (1.0, -1.0)
    ]
    with pytest.raises(TooFewSamplesError, match="3 places along it"):
        calibrate(MILL, sides, terms=["C0Y"])
    with pytest.raises(DataError, match="form"):
        ReadingSet(presets_level(), {"X": x, "Y": 0.0, "Z": 0.0}, x * 1e-6, unknown=("form",))


def presets_level():
    from metrosep.machine import Angle

    return Angle(direction=(0, 1, 0))
