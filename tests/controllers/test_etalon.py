"""Etalon exchange format: a file of our own numbers, an interpreter of its own, what is refused."""

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.etalon import Etalon
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignNotConfirmedError,
    TableError,
    UnsupportedFeatureError,
)

QUANTUM = 0.5e-15
"""Half of the twelfth decimal of a millimetre, in m."""
FLOAT = 1e-18
"""Rounding of micrometres in double, in m."""
NOWHERE = Path("nowhere.txt")

HAND = """[EXY]
Gridpoints = {
          -10.0 -0.001250000000
          0.0 0.000000000000
          15.5 0.000400000000
}  // end of EXY
"""
"""Layout of the TF5280 pages, with numbers of our own: X is 1.25 um too far in - at Y = -10 mm."""


def interpreter(text):
    """Return the error parameters of a file by name, each a function over the axis; no library."""
    found = {}
    plain = "\n".join(s.split("//")[0] for s in text.splitlines())
    for name, body in re.findall(r"\[(E\w\w)\]\s*Gridpoints\s*=\s*\{([^}]*)\}", plain):
        rows = sorted(tuple(map(float, s.split())) for s in body.strip().splitlines())
        found[name] = rows

    def at(name, p):
        rows = found[name]
        if p <= rows[0][0]:
            return rows[0][1]
        for (p0, e0), (p1, e1) in itertools.pairwise(rows):
            if p <= p1:
                return e0 + (e1 - e0) * (p - p0) / (p1 - p0)
        return rows[-1][1]

    return at


def test_hand_made_file_reads_as_corrections():
    back = Etalon().decode(HAND.encode(), NOWHERE, entry_sign=1)

    np.testing.assert_allclose(back.positions, [-10e-3, 0, 15.5e-3], atol=1e-17, rtol=0)
    np.testing.assert_allclose(back.forward, [1.25e-6, 0, -0.4e-6], atol=FLOAT, rtol=0)
    assert (back.axis, back.compensates) == ("Y", "X")  # EXY: error in X over Y


def test_the_same_file_is_written_after_its_comments():
    made = CompensationTable([-10e-3, 0, 15.5e-3], [1.25e-6, 0, -0.4e-6], None, "Y", "X", 0.0)

    text = Etalon().encode(made).data.decode()

    comments, _, rest = text.partition("[")
    assert "[" + rest == HAND
    assert comments.startswith(
        "// entry = +e, sign not documented: dry-run on the machine first\n"
        "// metrosep: entry_sign=1 parameter=EXY rows=3 check="
    )


@pytest.mark.parametrize("sign", [1, -1])
def test_error_disappears_when_the_kernel_subtracts_it(bump, sign):
    """A kernel that takes the parameter times `sign` as the error and subtracts it."""
    p = np.linspace(0.0, 50e-3, 101)
    made = CompensationTable.from_error(bump, positions=p, axis="Y", compensates="X")
    at = interpreter(Etalon().encode(made, entry_sign=sign).data.decode())
    wrong = interpreter(Etalon().encode(made.negated(), entry_sign=sign).data.decode())

    for y in (3e-3, 11.2e-3, 20e-3, 33e-3):
        error = bump(y) - bump(0.0)
        # (0.5 mm)^2/8 * 2 * 3 um/(3 mm)^2 = 21 nm between the entries
        assert error - sign * at("EXY", y * 1e3) * 1e-3 == pytest.approx(0.0, abs=21e-9)
    top = bump(12e-3) - bump(0.0)
    assert top - sign * wrong("EXY", 12.0) * 1e-3 == pytest.approx(2 * top, abs=1e-12)


def test_simulator_is_the_interpreter(bump):
    p = np.array([0.0, 3e-3, 11e-3, 12e-3, 40e-3])
    made = CompensationTable.from_error(bump, positions=p, axis="X", compensates="Z")
    data = Etalon().encode(made).data
    lookup, at = Etalon().lookup(data, NOWHERE), interpreter(data.decode())

    for x in np.random.default_rng(5).uniform(-10e-3, 60e-3, 50):
        assert lookup(x) == pytest.approx(-at("EZX", x * 1e3) * 1e-3, abs=1e-16)


def test_angles_are_rad_over_mm_and_lengths_over_degrees():
    pitch = CompensationTable([0, 20e-3], [0, -5e-6], None, "X", "B", 0.0)
    radial = CompensationTable([0, np.pi / 2], [0, -5e-6], None, "C", "X", 0.0)

    assert b"[EBX]\nGridpoints = {\n          0.0 0.000000000000\n          20.0 0.000005" in (
        Etalon().encode(pitch).data
    )
    assert b"          90.0 0.005000000000\n}  // end of EXC" in Etalon().encode(radial).data
    back = Etalon().decode(Etalon().encode(radial).data, NOWHERE)
    assert back.positions[1] == pytest.approx(np.pi / 2, abs=1e-11)
    assert back.forward[1] == pytest.approx(-5e-6, abs=FLOAT)


def test_parameter_names():
    made = CompensationTable([0, 1e-3], [0, 1e-9], None, "Y1", "X1", 0.0)

    with pytest.raises(DataError, match="EX1Y1"):
        Etalon().encode(made)
    assert b"[EXY]" in Etalon().encode(made, parameter="EXY").data
    with pytest.raises(DataError, match="lengths and angles"):
        Etalon().encode(made, parameter="EAY")
    with pytest.raises(DataError, match="no error parameter"):
        Etalon().encode(made, parameter="C0B")


def test_unconfirmed_sign_is_not_written(tmp_path, table):
    with pytest.raises(SignNotConfirmedError, match="etalon"):
        controllers.write(table, tmp_path / "x.txt", "etalon", allow_unverified=True)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DataError, match="entry_sign=1"):
        Etalon().decode(HAND.encode(), NOWHERE)


def test_written_verified_and_read(tmp_path, table, measured):
    both = CompensationTable(table.positions, table.forward, None, "X", "X", table.reference)

    result = controllers.write(
        both, tmp_path / "x.txt", "etalon", verified_against=measured, sign_confirmed=True
    )

    assert result.passed
    back = controllers.read(tmp_path / "x.txt", "etalon")
    np.testing.assert_allclose(back.forward, both.forward, atol=QUANTUM + FLOAT, rtol=0)


def test_two_directions_and_too_many_rows_are_refused(table):
    with pytest.raises(TableError, match="direction="):
        Etalon().encode(table)
    both = CompensationTable(table.positions, table.forward, None, "X", "X", 0.0)
    with pytest.raises(LimitError, match=r"101 rows, the control keeps 100"):
        Etalon().encode(both, records_limit=100)
    close = CompensationTable([0.0, 1e-13, 1e-3], [0, 0, 0], None, "X", "X", 0.0)
    with pytest.raises(TableError, match="closer than"):
        Etalon().encode(close)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 50),
    size=st.floats(1e-12, 1e-3),
    sign=st.sampled_from([1, -1]),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_the_quantisation(seed, n, size, sign):
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, 1) + np.cumsum(rng.uniform(1e-5, 5e-2, n))
    made = CompensationTable(p, size * rng.normal(size=n), None, "X", "Z", float(p[0]))

    encoded = Etalon().encode(made, entry_sign=sign)
    back = Etalon().decode(encoded.data, NOWHERE)

    assert encoded.quantisation <= QUANTUM * 1.001 + size * 1e-14
    np.testing.assert_allclose(back.positions, p, atol=1e-12, rtol=0)
    np.testing.assert_allclose(
        back.forward, made.forward, atol=encoded.quantisation * 1.01, rtol=0
    )
    assert re.search(rb"[0-9]e[+-]?[0-9]", encoded.data) is None


def test_one_of_several_parameters_is_chosen():
    text = "// 21 errors\n[C0B]\nVALUE = 0.0000223\n" + HAND + HAND.replace("EXY", "EZY")

    with pytest.raises(UnsupportedFeatureError, match="EXY, EZY"):
        Etalon().decode(text.encode(), NOWHERE, entry_sign=1)
    assert (
        Etalon().decode(text.encode(), NOWHERE, entry_sign=1, parameter="EZY").compensates == "Z"
    )
    with pytest.raises(DataError, match="EXX"):
        Etalon().decode(text.encode(), NOWHERE, entry_sign=1, parameter="EXX")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[EXY]\n", "", "line 1"),
        ("[EXY]", "[EXQ]", "EXQ is no error over an axis"),
        ("[EXY]", "[EXY", "line 1"),
        ("[EXY]", "[C0B]", "C0B is no error over an axis"),
        ("Gridpoints", "Points", "followed by"),
        ("= {", "=", "followed by"),
        ("}  // end", "// end", "cut short"),
        ("-10.0 -0.00125", "-10.0 -0.00125 1", "line 3"),
        ("-10.0 -0.00125", "-10,0 -0.00125", "line 3"),
        ("0.000400000000", "4e-4", "line 5"),
        ("0.000400000000", "nan", "line 5"),
        ("0.000400000000", "", "line 5"),
        ("15.5 ", "0.0 ", "line 5: the position does not rise"),
        ("15.5 ", "-5 ", "line 5: the position does not rise"),
        ("}  // end of EXY\n", "}\n" + HAND, r"line 7: a second \[EXY\]"),
        ("}  // end of EXY\n", "}\nnoise\n", "line 7"),
        (
            "          0.0 0.000000000000\n          15.5 0.000400000000\n",
            "",
            "at least 2 rows",
        ),
    ],
)
def test_damage_is_refused(old, new, words):
    assert old in HAND

    with pytest.raises(CorruptFileError, match=words) as caught:
        Etalon().decode(HAND.replace(old, new, 1).encode(), NOWHERE, entry_sign=1)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("end", range(0, HAND.index("}") + 1, 5))
def test_cut_file_is_refused(end):
    with pytest.raises(CorruptFileError):
        Etalon().decode(HAND[:end].encode(), NOWHERE, entry_sign=1)


@pytest.mark.parametrize("data", [b"\xff\xfe\x00", b"[C0B]\nVALUE = 1\n", b"// nothing\n"])
def test_other_content_is_refused(data):
    with pytest.raises(CorruptFileError):
        Etalon().decode(data, NOWHERE, entry_sign=1)


@pytest.mark.parametrize("parameter", ["EXY", "EZY", "EXX", "EYX"])
def test_parameter_must_be_that_of_the_axes(parameter):
    """X -> Z is EZX: an error in Z over X."""
    made = CompensationTable([0, 1e-3], [0, 1e-9], None, "X", "Z", 0.0)

    with pytest.raises(DataError, match=rf"{parameter} is the error in .*X -> Z, which is EZX"):
        Etalon().encode(made, parameter=parameter)
    assert Etalon().encode(made, parameter="EZX")


def test_machine_axes_are_lengths():
    made = CompensationTable([0, 1e-3], [0, 1e-9], None, "AX1", "AX3", 0.0)
    turns = CompensationTable([0, 1], [0, 1e-9], None, "C1", "AX3", 0.0)

    assert b"[EZX]" in Etalon().encode(made, parameter="EZX").data
    with pytest.raises(DataError, match="AX1 -> AX3 mix"):
        Etalon().encode(made, parameter="EAA")
    assert b"[EZC]" in Etalon().encode(turns, parameter="EZC").data
    with pytest.raises(DataError, match="mix lengths and angles"):
        Etalon().encode(turns, parameter="EZX")


def written(axis, sign):
    made = CompensationTable([0, 1e-3, 3e-3], [0, 1e-6, -2e-6], None, axis, axis, 0.0)
    return Etalon().encode(made, entry_sign=sign).data


@pytest.mark.parametrize("signs", [(1, -1), (-1, 1)])
def test_comment_with_the_sign_belongs_to_its_own_section(signs):
    both = (
        written("X", signs[0]) + written("Y", signs[1]) + b"[C0B]\nVALUE = 1.0\n" + HAND.encode()
    )

    for parameter in ("EXX", "EYY"):
        back = Etalon().decode(both, NOWHERE, parameter=parameter)
        np.testing.assert_allclose(back.forward, [0, 1e-6, -2e-6], atol=FLOAT, rtol=0)
    with pytest.raises(DataError, match="entry_sign=1"):  # of others, without a comment
        Etalon().decode(both, NOWHERE, parameter="EXY")


def test_contradicting_signs_are_refused():
    data = written("X", -1)

    with pytest.raises(DataError, match="entry_sign=1, the comment in the file says -1"):
        Etalon().lookup(data, NOWHERE, entry_sign=1)
    for more in (b"// metrosep: entry_sign=1\n" + data, data + b"// metrosep: entry_sign=1\n"):
        with pytest.raises(CorruptFileError, match="contradict each other: entry_sign"):
            Etalon().decode(more, NOWHERE)
    with pytest.raises(CorruptFileError, match="entry_sign='x'"):
        Etalon().decode(
            HAND.replace("[EXY]", "// metrosep: entry_sign=x\n[EXY]").encode(), NOWHERE
        )


def test_every_changed_line_is_found_without_a_sidecar(bump):
    made = CompensationTable.from_error(bump, positions=np.linspace(0.0, 50e-3, 26), axis="X")
    lines = Etalon().encode(made).data.decode().splitlines()
    for i in range(4, len(lines)):
        tries = [[*lines[:i], *lines[i + 1 :]], [*lines[: i + 1], *lines[i:]]]
        if i < len(lines) - 1:
            tries.append([*lines[:i], lines[i][:-2], *lines[i + 1 :]])
        for changed in tries:
            with pytest.raises(CorruptFileError):
                Etalon().decode("\n".join(changed).encode(), NOWHERE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("15.5 ", "9" * 400 + " "),
        ("0.000400000000", "9" * 5000),
        ("15.5 ", "\N{ARABIC-INDIC DIGIT NINE}9.0 "),
        ("0.000400000000", "\N{ARABIC-INDIC DIGIT ZERO}.0"),
    ],
)
def test_numbers_beyond_all_bounds_are_refused(old, new):
    with pytest.raises(CorruptFileError, match="line 5") as caught:
        Etalon().decode(HAND.replace(old, new, 1).encode(), NOWHERE, entry_sign=1)
    assert len(str(caught.value)) < 400
