"""Tables of machines: signs against an independent product of 4 x 4 matrices, closed loop, refusals."""

import numpy as np
import pytest

from metrosep import Surface
from metrosep.compensation.area_errors import ErrorMap
from metrosep.compensation.from_machine import tables_from_machine
from metrosep.compensation.maps import CompensationMap
from metrosep.compensation.table import CompensationTable
from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    SignCheckFailedError,
    TableError,
)
from metrosep.machine.chains import presets
from metrosep.machine.error_sets import ErrorSet
from metrosep.machine.terms import FourierTerm, PolynomialTerm, TableTerm

PM = 1e-12
ROUND = 1e-16
"""Rounding of coordinates of 0.3 m in double precision."""
SECOND = 2e-10
"""Products of errors, which the first order leaves out: 10 urad times 10 um, twice."""
KINDS = [(False, SECOND), ("small-angle", 2 * PM)]
"""First order, and the product that the simulator takes: there but the fixed point is left."""
RADIUS = 20e-3
TIP = np.array([0.01, -0.02, -0.12, 1.0])


# The simulator: true products of small-angle matrices, without library code.
def hat(x=0.0, y=0.0, z=0.0, a=0.0, b=0.0, c=0.0):
    return np.array([[1, -c, b, x], [c, 1, -a, y], [-b, a, 1, z], [0, 0, 0, 1.0]])


def shift(x=0.0, y=0.0, z=0.0):
    return hat(x, y, z)


def turn_z(angle):
    m = np.eye(4)
    m[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return m


def mill_point(x, y, z, e, tip=TIP):
    """Tool point in the workpiece: bed - Z - tool, bed - Y - X - table; errors of X, Y are the tool's."""
    at = {name: f({"X": x, "Y": y, "Z": z}[name[2]]) for name, f in e.items()}

    def six(axis, sign):
        return hat(*(sign * at.get(f"E{d}{axis}", 0.0) for d in "XYZABC"))

    tool = shift(z=z) @ six("Z", 1)
    # read in place of the tool, so the slide turns about that place and not about its own zero
    work = six("Y", -1) @ shift(y=-y) @ six("X", -1) @ shift(x=-x)
    return (np.linalg.inv(work) @ tool @ tip)[:3]


MILL = {
    "EXX": lambda x: 4e-6 * np.sin(x / 20e-3) + 6e-5 * x,
    "EYX": lambda x: 3e-4 * x * x,
    "EZX": lambda x: 2e-6 * np.cos(x / 30e-3),
    "EBX": lambda x: 8e-5 * x - 4e-6,
    "ECX": lambda x: 1e-4 * x,
    "EYY": lambda y: -7e-5 * y,
    "EXY": lambda y: 2e-6 * np.sin(y / 25e-3),
    "EAY": lambda y: 2e-4 * y,
    "EZY": lambda y: 5e-4 * y * y,
    "EZZ": lambda z: 4e-5 * z,
    "EBZ": lambda z: 3e-5 * z,
}
AT = {"Y": 30e-3, "Z": -15e-3}
X = np.linspace(0.0, 100e-3, 21)
Y = np.linspace(-50e-3, 50e-3, 11)


def mill_tables(errors=MILL, **options):
    chain = presets("mill_xyz")
    options = {"over": "X", "positions": X, "at": AT, "tool": TIP[:3]} | options
    return tables_from_machine(chain, errors, **options)


def mill_left(tables, x, y, z, sign):
    """What the independent machine does at the corrected command, minus the nominal place."""
    places = (x, y) if len(tables.over) == 2 else (x,)
    c = {a: sign * float(t.correction(*places)[0]) for a, t in tables.items()}
    actual = mill_point(x + c["X"], y + c["Y"], z + c["Z"], MILL)
    return actual - mill_point(x, y, z, {})


@pytest.mark.parametrize(("exact", "tolerance"), KINDS)
def test_tables_on_a_mill_cancel_an_independent_machine(exact, tolerance):
    tables = mill_tables(exact=exact)
    before = np.array([mill_left(tables, x, 30e-3, -15e-3, 0) for x in X])
    after = np.array([mill_left(tables, x, 30e-3, -15e-3, 1) for x in X])
    wrong = np.array([mill_left(tables, x, 30e-3, -15e-3, -1) for x in X])

    assert set(tables) == {"X", "Y", "Z"}
    assert all(np.ptp(before, axis=0) > 2e-6)
    assert np.ptp(after, axis=0).max() < tolerance
    assert np.ptp(wrong, axis=0) == pytest.approx(2 * np.ptp(before, axis=0), rel=1e-3, abs=0.0)
    for axis, k in (("X", 0), ("Y", 1), ("Z", 2)):
        assert tables[axis].compensates == axis
        assert tables[axis].axis == "X"
        assert tables[axis].forward[0] == 0.0
        assert tables[axis].offset_removed == pytest.approx(before[0, k], abs=SECOND)


@pytest.mark.parametrize(("exact", "tolerance"), KINDS)
def test_maps_on_a_mill_cancel_an_independent_machine(exact, tolerance):
    tables = mill_tables(over=("X", "Y"), positions=(X, Y), at={"Z": -15e-3}, exact=exact)
    places = [(x, y) for x in X[::4] for y in Y[::2]]
    before, after, wrong = (
        np.array([mill_left(tables, x, y, -15e-3, s) for x, y in places]) for s in (0, 1, -1)
    )
    assert isinstance(tables["Z"], CompensationMap)
    assert tables["Z"].values.shape == (11, 21)
    assert np.ptp(after, axis=0).max() < tolerance
    assert np.ptp(wrong, axis=0) == pytest.approx(2 * np.ptp(before, axis=0), rel=1e-3, abs=0.0)


def lathe_point(x, s, theta, e):
    """Tool on FTS on X, workpiece on C; x runs from the rim to the centre; errors of C turn."""
    at = {n: f({"X": x, "FTS": s, "C": theta}[n[2:]]) for n, f in e.items()}

    def six(axis):
        return hat(*(at.get(f"E{d}{axis}", 0.0) for d in "XYZABC"))

    tool = shift(x=RADIUS) @ shift(x=-x) @ six("X") @ shift(z=s) @ six("FTS")
    work = turn_z(theta) @ six("C")
    return (np.linalg.inv(work) @ tool @ TIP)[:3]


LATHE = {
    "EXX": lambda x: 5e-5 * x,
    "EYX": lambda x: 3e-6 * np.sin(x / 7e-3),
    "EZX": lambda x: 2e-6 * np.cos(x / 5e-3),
    "EBX": lambda x: 3e-5 * x,
    "EZC": lambda t: 1e-6 * np.sin(2 * t + 0.3),
    "EXC": lambda t: 0.7e-6 * np.cos(3 * t),
    "EBC": lambda t: 5e-6 * np.sin(t) + 2e-6,
    "EZFTS": lambda s: 1e-6 + 3e-5 * s,
}
THETA = np.linspace(0.0, 2 * np.pi, 73)
XL = np.linspace(0.0, 18e-3, 13)


def lathe_tables(errors=LATHE, **options):
    chain = presets("fts_lathe", radius=RADIUS)
    options = {
        "over": ("C", "X"),
        "positions": {"C": THETA, "X": XL},
        "at": {"FTS": 1e-4},
    } | options
    return tables_from_machine(chain, errors, **({"tool": TIP[:3]} | options))


def lathe_left(tables, theta, x, sign):
    """Error seen by someone who stands still beside the spindle: radial, tangential, axial."""
    c = {a: sign * float(t.correction(theta, x)[0]) for a, t in tables.items()}
    actual = lathe_point(x + c["X"], 1e-4 + c["FTS"], theta, LATHE)
    return turn_z(theta)[:3, :3] @ (actual - lathe_point(x, 1e-4, theta, {}))


@pytest.mark.parametrize(("exact", "tolerance"), KINDS)
def test_maps_on_a_fast_tool_lathe_cancel_an_independent_machine(exact, tolerance):
    tables = lathe_tables(exact=exact)
    places = [(t, x) for t in THETA[::5] for x in XL[::3]]
    before, after, wrong = (
        np.array([lathe_left(tables, t, x, s) for t, x in places]) for s in (0, 1, -1)
    )
    assert list(tables) == ["X", "FTS"]
    assert np.ptp(after[:, [0, 2]], axis=0).max() < tolerance
    size = np.ptp(before, axis=0)
    assert np.ptp(wrong, axis=0)[[0, 2]] == pytest.approx(2 * size[[0, 2]], rel=2e-3, abs=0.0)
    assert np.ptp(after[:, 1]) == pytest.approx(size[1], rel=1e-2, abs=0.0)
    assert size.min() > 1e-6


def test_what_no_axis_corrects_is_said_with_its_amount():
    """EYC of 2 um stays as it is: neither X nor FTS moves the tool across."""
    tables = lathe_tables({"EYX": lambda x: 2e-6 * (x / 18e-3)}, over="X", positions=XL,
                          at={"C": 0.0, "FTS": 0.0})  # fmt: skip
    assert tables["X"].stroke < ROUND
    assert tables.left[:, 1] == pytest.approx(2e-6 * XL / 18e-3, abs=PM)
    assert "workpiece Y" in tables.messages[-1]
    assert "2 um" in tables.messages[-1]
    with pytest.raises(SignCheckFailedError):
        tables.verify()


def test_position_error_of_the_lathe_runs_against_its_axis():
    """EXX is along +X of the workpiece, x along -X: e of the slide is -EXX, c(x + c) = +EXX."""
    tables = lathe_tables({"EXX": lambda x: 1e-4 * x}, over="X", positions=XL,
                          at={"C": 0.0, "FTS": 0.0})  # fmt: skip
    assert tables["X"].forward == pytest.approx(1e-4 * XL / (1 - 1e-4), abs=PM)


@pytest.mark.parametrize(
    ("term", "axis", "error"),
    [
        ("EZX", "Z", lambda x: 1e-5 * x),
        ("EYX", "Y", lambda x: 2e-4 * x * x),
    ],
)
def test_cross_tables_are_the_negated_error(term, axis, error):
    tables = mill_tables({term: error})
    assert tables[axis].forward == pytest.approx(-error(X), abs=ROUND)
    for other in {"X", "Y", "Z"} - {axis}:
        assert tables[other].stroke < ROUND


def test_on_axis_table_is_the_exact_inverse():
    """e = a x: c = -a x / (1 + a)."""
    tables = mill_tables({"EXX": lambda x: 1e-3 * x})
    assert tables["X"].forward == pytest.approx(-1e-3 * X / 1.001, abs=2e-13)
    assert tables["X"].is_exact_inverse


def test_cross_table_sees_where_the_corrected_axis_is():
    """X runs 1 per mille too far and Z follows b x: at command p the slide goes to p / 1.001."""
    tables = mill_tables({"EXX": lambda x: 1e-3 * x, "EZX": lambda x: 1e-3 * x})
    assert tables["Z"].forward == pytest.approx(-1e-3 * X / 1.001, abs=2e-13)


def test_a_constant_is_an_offset_and_no_table():
    tables = mill_tables({"EXX": 3e-6, "EZX": -2e-6})
    assert tables["X"].stroke < ROUND
    assert tables["X"].offset_removed == pytest.approx(3e-6, abs=ROUND)
    assert tables["Z"].offset_removed == pytest.approx(-2e-6, abs=ROUND)
    assert np.abs(tables.left).max() < ROUND


@pytest.mark.parametrize(
    ("term", "error"),
    [
        (PolynomialTerm([1e-6, 2e-5, -1e-4]), lambda x: 2e-5 * x - 1e-4 * x * x),
        (
            FourierTerm([1e-6], [40e-3], [0.4]),
            lambda x: 1e-6 * (np.cos(2 * np.pi * x / 40e-3 + 0.4) - np.cos(0.4)),
        ),
        (TableTerm(X, 1e-5 * X), lambda x: 1e-5 * x),
    ],
)
def test_terms_of_all_kinds(term, error):
    tables = mill_tables({"EZX": term})
    assert tables["Z"].forward == pytest.approx(-error(X), abs=PM)


def test_interpolation_error_is_that_of_a_parabola():
    tables = mill_tables({"EZX": lambda x: 4e-4 * x * x})
    assert tables["Z"].interpolation_error == pytest.approx(4e-4 * 5e-3**2 / 4, abs=PM)


def test_the_tables_hold_at_one_place_and_residual_tells_elsewhere():
    """EBX of b x and a point dz higher than where the table was made: b x dz along X stays."""
    tables = mill_tables({"EBX": lambda x: 1e-5 * x})
    here = tables.residual({"X": X})
    there = tables.residual({"X": X, "Z": -15e-3 + 50e-3})
    assert np.abs(here).max() < SECOND
    assert there[:, 0] == pytest.approx(1e-5 * X * 50e-3, abs=SECOND)
    assert tables.residual({"X": 50e-3}).shape == (3,)


def test_dry_run_refuses_the_reversed_sign():
    tables = mill_tables()
    result = tables.verify()
    assert result["passed"]
    assert result["wrong_sign_rms_m"] == pytest.approx(
        2 * result["before_rms_m"], rel=1e-3, abs=0.0
    )
    assert result["after_rms_m"] < result["before_rms_m"] / 100
    with pytest.raises(SignCheckFailedError, match="reversed sign"):
        tables.negated().verify()


def test_uncertainty_of_the_terms_is_that_of_the_table():
    """u(EZX) = 30 nm along Z; u(ECX) = 1 urad times the offset of the tool; own travel is not a lever."""
    errors = ErrorSet({"EZX": 0.0, "ECX": 0.0}, u={"EZX": 30e-9, "ECX": 1e-6})
    tables = mill_tables(errors)
    lever = np.full(X.size, TIP[0])
    assert tables["Z"].u == pytest.approx(30e-9, abs=PM)
    assert tables["Y"].u == pytest.approx(1e-6 * np.abs(lever), abs=PM)
    assert mill_tables({"EZX": 0.0}, corrects="Z")["Z"].u is None
    assert mill_tables(ErrorSet({"EZX": 1e-6}))["Z"].u is None


def test_measured_heights_go_to_the_axis_that_moves_there():
    z = 1e-6 * np.outer(np.arange(5.0), np.arange(4.0))
    surface = Surface(z, dx=10e-3, dy=5e-3)
    tables = mill_tables(
        surface,
        over=("X", "Y"),
        positions=(np.arange(4) * 10e-3, np.arange(5) * 5e-3),
        at={"Z": 0.0},
    )
    assert list(tables) == ["Z"]
    assert tables["Z"].values == pytest.approx(-z, abs=ROUND)
    assert any("X gets no table" in m for m in tables.messages)
    assert any("workpiece X: not measured" in m for m in tables.messages)
    assert np.isnan(tables.left[..., :2]).all()
    assert tables.verify()["before_pv_m"] == [None, None, pytest.approx(12e-6, abs=ROUND)]


def test_measured_vectors_of_a_lathe_turn_with_the_workpiece():
    """1 um along workpiece X at every angle: radially cos(theta), as seen at azimuth -theta."""
    vectors = np.zeros((73, 3))
    vectors[:, 0] = 1e-6
    tables = lathe_tables(
        vectors, over="C", positions=THETA, at={"X": 0.0, "FTS": 0.0}, tool=(0, 0, 0)
    )
    e = -1e-6 * (np.cos(THETA) - 1.0)  # x runs inwards
    assert tables["X"].forward == pytest.approx(-e, abs=PM)
    assert tables["FTS"].stroke < ROUND
    across = np.abs(tables.left[:, 1] * np.cos(THETA) + tables.left[:, 0] * np.sin(THETA))
    assert np.abs(across - 1e-6 * np.abs(np.sin(THETA))).max() < PM


def test_a_measured_component_may_be_missing_as_a_whole():
    vectors = np.stack([1e-5 * X, np.full(21, np.nan), 2e-5 * X], axis=-1)
    tables = mill_tables(vectors)
    assert set(tables) == {"X", "Z"}
    assert tables["Z"].forward == pytest.approx(-2e-5 * X, abs=1e-9)
    vectors[4, 0] = np.nan
    with pytest.raises(DataError, match="X = 20 mm"):
        mill_tables(vectors)


def test_axes_at_the_end_of_a_term_are_held_there():
    """Z stands at the very end of its table; its correction leads out of it by nanometres."""
    end = TableTerm([0.0, 0.1], [0.0, 1e-6])
    tables = mill_tables({"EZX": lambda x: 1e-5 * x, "EXZ": end}, at={"Y": 0.0, "Z": 0.0})
    assert tables["Z"].forward == pytest.approx(-1e-5 * X, abs=ROUND)


def test_other_axes_move_with_their_corrections():
    """Error of Z of 1 per mille is taken where Z then is: c = -(b x) / 1.001."""
    tables = mill_tables({"EZX": lambda x: 1e-3 * x, "EZZ": lambda z: 1e-3 * z})
    assert tables["Z"].forward == pytest.approx(-1e-3 * X / 1.001, abs=2e-13)


def test_one_axis_may_be_chosen():
    tables = mill_tables(corrects="Z")
    assert list(tables) == ["Z"]
    assert isinstance(tables["Z"], CompensationTable)
    assert "workpiece X" in tables.messages[-2]
    assert "up to" in tables.messages[-2]
    with pytest.raises(KeyError, match="no table corrects 'X'"):
        tables["X"]
    assert "Z" in tables
    assert len(tables) == 1
    assert "X -> Z" in repr(tables)


def test_reference_elsewhere():
    tables = mill_tables({"EZX": lambda x: 1e-5 * x}, reference=50e-3)
    assert tables["Z"].forward[10] == 0.0
    assert tables["Z"].forward == pytest.approx(-1e-5 * (X - 50e-3), abs=ROUND)
    assert tables["Z"].offset_removed == pytest.approx(0.5e-6, abs=ROUND)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"over": "Q"}, DataError, "no axis 'Q'"),
        ({"over": ("X", "Y", "Z")}, DataError, "arrays for 3 axes"),
        ({"over": ("X", "Y", "Z", "X")}, DataError, "one axis, or two"),
        ({"over": ("X", "X")}, DataError, "two different"),
        ({"at": {"Y": 0.0}}, DataError, "'Z'"),
        ({"at": {"X": 0.0, **AT}}, DataError, "looked up"),
        ({"at": {"Y": [0.0, 1.0], "Z": 0.0}}, DataError, r"at\['Y'\] must be a number in m"),
        ({"corrects": ("X", "Q")}, DataError, "not a linear axis"),
        ({"corrects": ()}, DataError, "each axis once"),
        ({"corrects": ("X", "X")}, DataError, "each axis once"),
        ({"positions": X[::-1]}, TableError, "rise"),
        ({"positions": {"Y": X}}, DataError, "over names X"),
        ({"at": [0.0]}, DataError, "axis names"),
        ({"at": {"Y": "0", "Z": 0.0}}, DataError, "has no unit"),
        ({"at": {"Y": "3 deg", "Z": 0.0}}, DataError, "a length is needed"),
        ({"positions": 0.1, "over": ("X", "Y"), "at": {"Z": 0.0}}, DataError, "1 arrays for 2"),
        ({"reference": "rim"}, DataError, "reference 'rim' is not a number"),
        ({"reference": 1.0}, TableError, "outside"),
        ({"reference": (0.0, 0.0)}, TableError, "2 positions for 1"),
    ],
)
def test_bad_requests_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        mill_tables(**options)


@pytest.mark.parametrize(
    ("errors", "error", "message"),
    [
        ({"EZX": lambda x: np.where(x > 0.05, np.nan, x)}, InvalidSamplesError, "not known"),
        ({"EXX": lambda x: -1.5 * x}, TableError, "turn back"),
        ({"dxy": 1e-6}, DataError, "dxy"),
        ({"EZX": TableTerm([0.0, 0.05], [0.0, 1e-6])}, DataError, "0.055"),
        ("errors", DataError, "str"),
        (np.zeros((20, 3)), TableError, "is needed"),
        (np.full((21, 3), np.inf), InvalidSamplesError, "infinite"),
        (np.full((21, 3), np.nan), DataError, "not known"),
        (ErrorMap([0, 1], [0, 1], np.zeros((2, 2))), DataError, "two axes"),
    ],
)
def test_bad_errors_are_refused(errors, error, message):
    with pytest.raises(error, match=message):
        mill_tables(errors)


def test_what_cannot_be_told_apart_is_refused():
    chain = presets("fts_lathe", radius=RADIUS)
    options = {"over": "X", "positions": XL}
    with pytest.raises(DataError, match="same direction"):
        tables_from_machine(chain, LATHE, at={"C": 0.0, "FTS": 0.0, "Z": 0.0}, **options)
    with pytest.raises(DataError, match="turns"):
        tables_from_machine(chain, LATHE, at={"C": 0.0, "FTS": 0.0}, corrects="C", **options)
    with pytest.raises(DataError, match="where it stands"):
        tables_from_machine(chain, LATHE, at={"C": 0.0, "FTS": 0.0}, corrects="Z", **options)
    with pytest.raises(DataError, match="Chain"):
        tables_from_machine({}, LATHE, **options)


def test_an_axis_that_is_not_looked_up_may_be_too_steep_as_well():
    with pytest.raises(NotConvergedError, match="settle"):
        mill_tables(
            {"EZX": lambda x: 1e-5 * x, "EZZ": lambda z: 1.01 * z}, at={"Y": 0.0, "Z": 1e-3}
        )


def test_gap_of_a_measured_map_is_refused():
    z = np.zeros((5, 5))
    z[2, 2] = np.nan
    with pytest.raises(TableError, match="not known at X = 20 mm"):
        mill_tables(
            Surface(z, dx=10e-3, dy=10e-3),
            over=("X", "Y"),
            positions=([0, 40e-3], [0, 40e-3]),
            at={"Z": 0.0},
        )


def test_a_reference_that_is_no_node_is_told_with_its_amount():
    """EXX = 1e-3 x^2 over nodes each 10 mm: halfway the chord is h^2/8 * 2e-3 = 25 nm off."""
    mill = presets("mill_xyz")
    grid = np.linspace(0.0, 80e-3, 9)

    def tables(reference):
        return tables_from_machine(
            mill,
            {"EXX": lambda x: 1e-3 * x**2},
            over="X",
            positions=grid,
            at={"Y": 0.0, "Z": 0.0},
            reference=reference,
        )

    told = [m for m in tables(45e-3).messages if "not a node" in m]
    there = abs(float(tables(45e-3)["X"].correction(45e-3)[0]))
    assert there == pytest.approx(25e-9, abs=0.1e-9)  # times 1 + 2e-3 x
    assert len(told) == 1
    assert "X = 45 mm, which is not a node, X is corrected by " in told[0]
    assert "25 nm" in told[0]
    assert not [m for m in tables(40e-3).messages if "not a node" in m]
