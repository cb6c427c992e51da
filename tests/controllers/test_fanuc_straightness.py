"""Fanuc straightness: hand-made parameters, knots against closed form and search, refusals."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from metrosep import Profile, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.fanuc import FanucStraightness
from metrosep.controllers.options import checked_options
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignNotConfirmedError,
    TableError,
)

ROUNDING = 1e-15
"""Doubles of 10 um."""
SOLVER = 1e-10
"""Linear programs end within 1e-7 of a value of 1 um; the search of knots within 1e-5."""

HEAD = (
    "%(FANUC STRAIGHTNESS X TO Y, DETECTION UNIT 0.0001 MM, POINTS EVERY 5 MM, POINT 40 AT 0 MM, "
    "ENTRY = -E, SIGN NOT DOCUMENTED: DRY-RUN ON THE MACHINE FIRST - MADE BY METROSEP)\n"
)
HAND = HEAD + (
    "N5711P1\nN5721P2\n"
    "N5731P40\nN5732P42\nN5733P45\nN5734P50\n"
    "N5761P0\nN5762P-25\nN5763P10\nN5764P0\n%\n"
)
"""By hand: e = 0 at 0, +2.5 um at 10 mm, -1 um at 25 mm, 0 at 50 mm; entries -e in 0.1 um."""

FACTS = {"detection_unit": 1e-7, "interval": 5e-3, "reference_number": 40}


def encode(table, **given):
    known = checked_options({**FACTS, **given}, FanucStraightness.options, "fanuc-straightness")
    return FanucStraightness().encode(table, **known)


def decode(data, **given):
    return FanucStraightness().decode(data, Path("absent.txt"), **given)


def control(data, mm, *, unit_um, every_mm, number=40, at_mm=0.0):
    """Shift (um) of the compensated axis: straight between four points, held beyond."""
    word = {int(line[1:5]): int(line.split("P")[1]) for line in data.decode().splitlines()[1:-1]}
    places = [at_mm + (word[5731 + i] - number) * every_mm for i in range(4)]
    values = [word[5761 + i] * unit_um for i in range(4)]
    if mm <= places[0]:
        return values[0]
    for i in range(3):
        if mm <= places[i + 1]:
            share = (mm - places[i]) / (places[i + 1] - places[i])
            return values[i] + share * (values[i + 1] - values[i])
    return values[3]


def cross(x, c, reference=0.0):
    return CompensationTable(x, c, None, "X", "Y", reference)


@pytest.fixture
def bow():
    """Straightness of three different slopes with a ripple: +3 um at 12 mm, -1 um at 30 mm."""
    x = np.linspace(0.0, 50e-3, 101)
    e = np.interp(x, [0.0, 12e-3, 30e-3, 50e-3], [0.0, 3e-6, -1e-6, 0.5e-6])
    return Profile(x, e + 0.05e-6 * np.sin(2 * np.pi * x / 7e-3))


@pytest.fixture
def bow_table(bow):
    return CompensationTable.from_error(
        bow, positions=101, axis="X", compensates="Y", source_sha256=("ab" * 32,)
    )


def test_hand_made_parameters_byte_for_byte():
    x = np.arange(0, 51, 5) * 1e-3
    e = np.interp(x, [0.0, 10e-3, 25e-3, 50e-3], [0.0, 2.5e-6, -1e-6, 0.0])

    assert encode(cross(x, -e)).data.decode() == HAND


def test_hand_made_parameters_read_as_corrections():
    table = decode(HAND.encode())

    assert (table.axis, table.compensates) == ("X", "Y")
    np.testing.assert_allclose(table.positions, [0, 10e-3, 25e-3, 50e-3], atol=1e-17, rtol=0)
    np.testing.assert_allclose(table.forward, [0, -2.5e-6, 1e-6, 0], atol=ROUNDING, rtol=0)


def test_other_sign_negates_the_entries():
    table = decode(HAND.encode())

    other = encode(table, entry_sign=1).data

    assert b"N5762P25\n" in other
    np.testing.assert_allclose(decode(other).forward, table.forward, atol=ROUNDING, rtol=0)


@pytest.mark.parametrize("set_number", [1, 2, 3])
def test_sets_have_their_own_parameters(set_number):
    data = encode(decode(HAND.encode()), set_number=set_number).data.decode()

    names = [int(line[1:5]) for line in data.splitlines()[1:-1]]
    s = set_number - 1
    assert names[:3] == [5711 + s, 5721 + s, 5731 + 10 * s]
    assert names[6:] == [5761 + 10 * s + i for i in range(4)]


def test_parabola_has_three_equal_segments_and_a_sixteenth():
    """Curvature 2 a: 2 a h^2 / 16 for free values over segments of 20 mm, on points every 1 mm."""
    x = np.linspace(0.0, 60e-3, 601)
    a = 1e-3  # 1/m: 3.6 um over 60 mm

    encoded = encode(cross(x, a * x**2), interval=1e-3, detection_unit=1e-9)

    p = encoded.carried.positions
    np.testing.assert_allclose(p, [0, 20e-3, 40e-3, 60e-3], atol=1e-15, rtol=0)
    assert encoded.resampling_error == pytest.approx(2 * a * (20e-3) ** 2 / 16, abs=SOLVER)
    assert encoded.notes["knots"]["n_knots"] == 4


def best_by_search(x, c, grid):
    """Smallest deviation over all pairs of inner knots, values by linear programming."""
    best = np.inf
    for inner in itertools.combinations(range(1, grid.size - 1), 2):
        knots = grid[[0, *inner, grid.size - 1]]
        basis = np.array([np.interp(x, knots, row) for row in np.eye(4)]).T
        ones = np.ones((x.size, 1))
        done = linprog(
            [0, 0, 0, 0, 1],
            A_ub=np.vstack([np.hstack([basis, -ones]), np.hstack([-basis, -ones])]),
            b_ub=np.r_[c, -c],
            bounds=[(None, None)] * 5,
        )
        best = min(best, done.fun)
    return best


@pytest.mark.parametrize("seed", range(4))
def test_knots_are_near_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 50e-3, 11)
    c = np.cumsum(rng.uniform(-1, 1, 11))

    encoded = encode(cross(x, c * 1e-6), detection_unit=1e-10)

    best = best_by_search(x, c, x) * 1e-6
    assert best - SOLVER <= encoded.resampling_error <= 1.25 * best


@given(
    n=st.integers(4, 40),
    seed=st.integers(0, 2**32 - 1),
    unit=st.sampled_from([1e-8, 1e-7]),
    sign=st.sampled_from([-1, 1]),
)
@settings(derandomize=True, deadline=None, max_examples=25)
def test_round_trip_is_within_rounding_and_residual(n, seed, unit, sign):
    rng = np.random.default_rng(seed)
    x = (5 + 5 * np.arange(n)) * 1e-3
    table = cross(x, rng.uniform(-3e-6, 3e-6, n), 5e-3)

    encoded = encode(table, detection_unit=unit, entry_sign=sign)

    assert encoded.quantisation <= unit / 2 + ROUNDING
    at = rng.uniform(x[0] - 5e-3, x[-1] + 5e-3, 40)
    seen = [
        -sign * control(encoded.data, p * 1e3, unit_um=unit * 1e6, every_mm=5.0, at_mm=5.0)
        for p in at
    ]
    margin = encoded.quantisation + encoded.resampling_error + ROUNDING
    np.testing.assert_allclose(np.array(seen) * 1e-6, table.correction(at), atol=margin, rtol=0)
    back = decode(encoded.data)
    np.testing.assert_allclose(back.correction(at), np.array(seen) * 1e-6, atol=1e-14, rtol=0)


def test_written_with_the_residual_in_the_sidecar(tmp_path, bow, bow_table):
    path = tmp_path / "x.txt"

    with pytest.raises(SignNotConfirmedError):
        controllers.write(bow_table, path, "fanuc-straightness", **FACTS)
    done = controllers.write(
        bow_table,
        path,
        "fanuc-straightness",
        verified_against=bow,
        sign_confirmed=True,
        **{**FACTS, "interval": "1 mm"},
    )

    assert done.after_pv < 0.06 * done.before_pv
    assert done.wrong_sign_pv > 1.9 * done.before_pv
    assert b"knots" in (tmp_path / "x.txt.json").read_bytes()
    back = controllers.read(path, "fanuc-straightness")
    assert (back.axis, back.compensates, back.positions.size) == ("X", "Y", 4)


def test_error_that_three_segments_cannot_follow_is_refused_unless_waived(tmp_path):
    x = np.linspace(0.0, 50e-3, 101)
    wave = Profile(x, 1e-6 * np.sin(2 * np.pi * x / 10e-3))
    table = CompensationTable.from_error(wave, positions=101, axis="X", compensates="Y")

    with pytest.raises(LimitError, match="between its entries"):
        controllers.write(
            table, tmp_path / "x.txt", "fanuc-straightness", sign_confirmed=True, **FACTS
        )


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bow, bow_table):
    x, e = bow.x, bow.z
    left = {}
    for name, table in (("right", bow_table), ("wrong", bow_table.negated())):
        data = encode(table, interval=1e-3).data
        left[name] = np.ptp(
            e + 1e-6 * np.array([control(data, p * 1e3, unit_um=0.1, every_mm=1.0) for p in x])
        )

    assert left["right"] < 0.25e-6  # ripple of 0.05 um, rounding of 0.05 um, knots off by 0.5 mm
    assert left["wrong"] > 1.9 * np.ptp(e)


def test_what_cannot_be_carried_is_refused(table):
    x = np.arange(0, 51, 5) * 1e-3
    zero = np.zeros(11)
    with pytest.raises(TableError, match="direction='both'"):
        encode(table)
    with pytest.raises(TableError, match="controller='fanuc'"):
        encode(CompensationTable(x, zero, None, "X", "X", 0.0))
    with pytest.raises(TableError, match="not a Fanuc axis"):
        encode(CompensationTable(x, zero, None, "X", "slide", 0.0))
    with pytest.raises(TableError, match="numbers of two axes"):
        encode(cross(x, zero), moving_axis=2)
    with pytest.raises(TableError, match="four points need three"):
        encode(cross(x, zero), interval=20e-3 + 5e-3)
    with pytest.raises(LimitError, match="1023"):
        encode(cross(x, zero), interval=1e-6)
    with pytest.raises(LimitError, match="points -5 to"):
        encode(cross(x - 25e-3, zero), reference_number=0)
    with pytest.raises(LimitError, match="exceeds 32767"):
        encode(cross(x, zero + 4e-3))


def test_facts_are_asked_for(tmp_path, bow_table):
    with pytest.raises(DataError, match=r"detection_unit.*interval.*reference_number"):
        controllers.write(bow_table, tmp_path / "x.txt", "fanuc-straightness", sign_confirmed=True)
    bare = HAND.replace(HEAD, "%\n").encode()
    with pytest.raises(DataError, match="detection_unit"):
        decode(bare)
    back = decode(bare, **FACTS, reference_position=0.0, entry_sign=-1)
    assert back.forward[1] == pytest.approx(-2.5e-6, abs=ROUNDING)


def test_parameters_of_another_axis_are_refused():
    with pytest.raises(CorruptFileError, match="another axis"):
        decode(HAND.encode(), compensated_axis=3)


def test_axis_that_turns_is_refused():
    with pytest.raises(TableError, match="axis B turns"):
        encode(CompensationTable(np.arange(9) * 5e-3, np.zeros(9), None, "B", "Y", 0.0))


@pytest.mark.parametrize(
    ("name", "other"),
    [("entry_sign", 1), ("detection_unit", 1e-5), ("interval", 1e-2), ("reference_number", 7)],
)
def test_option_that_contradicts_the_file_is_refused(name, other):
    with pytest.raises(DataError, match=f"the file says {name}=.*you say"):
        decode(HAND.encode(), **{name: other})


@pytest.mark.parametrize(("x", "c"), [(1e5, 1e-6), (0.06, 1e6), (0.06, 1e300)])
def test_numbers_that_no_word_holds_are_refused_with_their_entry(x, c):
    with pytest.raises(LimitError, match=r"of entry 1 exceeds") as caught:
        encode(CompensationTable([0.0, x], [0, c], None, "X", "Z", 0.0))
    assert len(str(caught.value)) < 200


class TestFanucStraightness(DialectContract):
    name = "fanuc-straightness"
    hand = HAND
    lines = (
        "",
        "N5711P",
        "N5735P1",
        "N5731P1.5",
        "N5711P32768",
    )
    damage = (
        ("N5732P42\n", "N5732P40\n"),
        ("N5734P50\n", "N5734P1024\n"),
        ("N5731P40\n", "N5731P-1\n"),
        ("N5761P0\n", "N5761P32768\n"),
        ("N5721P2\n", "N5721P1\n"),
        ("N5711P1\n", "N5712P1\n"),
        ("N5761P0\n", "N5761P0\nN5761P0\n"),
    )
