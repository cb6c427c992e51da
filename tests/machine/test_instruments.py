"""Machines of bodies, planes and lines in space, and what instruments on them read.

No product of a chain: carriages are rigid bodies that turn by true rotations about bearing centres
somewhere in the machine, an indicator is the distance from its tip to a plane of an artefact along
a line, an autocollimator reads the attitude of a mirror, a nest reads the centre of a ball. A chain
that is given these readings must return them, and what follows from them elsewhere.
"""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.compensation.from_machine import tables_from_machine
from metrosep.forms import Plane
from metrosep.machine import Chain, presets, rank
from metrosep.machine.chains import preset_table
from metrosep.machine.terms import TableTerm

SECOND = 3e-9
"""m; products of errors that first order leaves out: 65 urad times 65 urad times 0.7 m."""


def turned(axis, angle, v):
    """Turn v about a unit axis (Rodrigues)."""
    k, v = np.asarray(axis, dtype=float), np.asarray(v, dtype=float)
    return v * np.cos(angle) + np.cross(k, v) * np.sin(angle) + k * (k @ v) * (1.0 - np.cos(angle))


def tilted(w, v):
    """Turn v by a rotation vector."""
    size = float(np.linalg.norm(w))
    return np.asarray(v, dtype=float) if size == 0.0 else turned(np.asarray(w) / size, size, v)


class Body:
    """A carriage on ways: it travels, and turns by w(q) about its own bearing centre, moved by d(q)."""

    def __init__(self, way, bearing, d, w):
        self.way, self.bearing, self.d, self.w = (
            np.array(way, dtype=float),
            np.array(bearing),
            d,
            w,
        )

    def point(self, q, p):
        """Where a point of the body stands that is at p when q is 0 and nothing is wrong."""
        return self.bearing + self.way * q + self.d(q) + tilted(self.w(q), p - self.bearing)

    def arrow(self, q, v):
        return tilted(self.w(q), v)


class Mill:
    """Work on X on Y on the bed, tool on Z on the bed; each carriage with its own bearings."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)

        def wavy(size):
            # zero at home; different curves in all three directions
            a, k, f = (
                size * rng.normal(size=(2, 3)),
                rng.uniform(4, 9, (2, 3)),
                rng.uniform(0, 6, (2, 3)),
            )
            return lambda q: (a * (np.sin(k * q + f) - np.sin(f))).sum(axis=0)

        def carriage(way):
            return Body(way, rng.uniform(-0.4, 0.4, 3), wavy(3e-6), wavy(15e-6))

        self.x, self.y, self.z = carriage((-1, 0, 0)), carriage((0, -1, 0)), carriage((0, 0, 1))

    def work(self, q, p):
        return self.y.point(q["Y"], self.x.point(q["X"], np.asarray(p, dtype=float)))

    def work_arrow(self, q, v):
        return self.y.arrow(q["Y"], self.x.arrow(q["X"], np.asarray(v, dtype=float)))

    def tip(self, q, t):
        return self.z.point(q["Z"], np.asarray(t, dtype=float))

    def indicator(self, q, t, along, point, normal):
        """Distance along a line from a plane on the table to the tip of an indicator in the spindle."""
        p, n = self.work(q, point), self.work_arrow(q, normal)
        return n @ (self.tip(q, t) - p) / (n @ along)

    def error(self, q, t):
        """Place of the tip on the work, against where it should be."""
        # three planes through the nominal point meet it in three distances: solved for the place
        goal = np.asarray(t, dtype=float) + np.array([q["X"], q["Y"], q["Z"]])
        axes = np.array([self.work_arrow(q, e) for e in np.eye(3)])
        return axes @ (self.tip(q, t) - self.work(q, goal))

    def attitude(self, q):
        """Turn of the tool against the work, as autocollimators on both read it (A, B, C)."""
        y_tool, z_tool, x_tool = (self.z.arrow(q["Z"], e) for e in np.eye(3)[[1, 2, 0]])
        x, y, z = (self.work_arrow(q, e) for e in np.eye(3))
        return np.array([y_tool @ z, z_tool @ x, x_tool @ y])


HOME = {"X": 0.0, "Y": 0.0, "Z": 0.0}
PLACES = {
    "X": np.linspace(-0.1, 0.4, 41),
    "Y": np.linspace(-0.15, 0.2, 36),
    "Z": np.linspace(-0.1, 0.25, 36),
}


def measured(mill, t):
    """Tables of 18 curves: each axis alone, all else at home, indicators and mirrors at the tool."""
    curves = {}
    for axis, places in PLACES.items():
        k = "XYZ".index(axis)
        rows = []
        for q in places:
            at = {**HOME, axis: q}
            row = []
            for j in range(3):
                along = np.eye(3)[j]
                # straightedges through the tool's line; along the travel the faces of a step gauge
                point = np.array(t) + (q * along if j == k else 0.0)
                row.append(mill.indicator(at, t, along, point, along))
            rows.append([*row, *mill.attitude(at)])
        for letter, values in zip("XYZABC", np.array(rows).T, strict=True):
            curves[f"E{letter}{axis}"] = TableTerm(places, values)
    return curves


def states(n, seed):
    rng = np.random.default_rng(seed)
    return [{a: float(rng.choice(p)) for a, p in PLACES.items()} for _ in range(n)]


def mill_read_at(point):
    table = preset_table("mill_xyz")
    for element in table["element"]:
        element["measured_at_mm"] = [1e3 * c for c in point]
    return Chain.from_dict(table)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.03, -0.02, -0.14)])
def test_a_mill_of_rigid_bodies_is_where_its_instruments_say(point, exact):
    mill = Mill(seed=11)
    curves = measured(mill, point)
    chain = presets("mill_xyz") if not any(point) else mill_read_at(point)
    worst = size = 0.0
    for i, q in enumerate(states(60, seed=3)):
        # another tool than the one that was in the spindle when the axes were measured
        t = np.array(point) + [(0, 0, 0), (0.05, 0.02, -0.08), (-0.04, 0.07, 0.03)][i % 3]
        truth = mill.error(q, t)
        found = chain.volumetric_error(q, curves, tool=t, exact=exact)
        worst, size = max(worst, np.abs(found - truth).max()), max(size, np.abs(truth).max())
    assert size > 5e-6  # or nothing is tested
    assert worst < SECOND


@pytest.mark.parametrize("axis", "XYZ")
def test_an_indicator_at_the_tool_reads_its_own_table(axis):
    """EZX = 0 and a pitch: an indicator along the line of the tool reads nothing."""
    mill = Mill(seed=5)
    curves = measured(mill, (0, 0, 0))
    angles = {n: t for n, t in curves.items() if n[1] in "ABC" and n[2] == axis}
    q = {**dict.fromkeys("XYZ", 0.0), axis: PLACES[axis]}
    for name in ("mill_xyz", "five_axis"):
        rest = {"A": 0.0, "C": 0.0} if name == "five_axis" else {}
        chain = presets(name, **({"pivot_height": 0.08} if rest else {}))
        assert np.abs(chain.volumetric_error({**q, **rest}, angles)).max() < 1e-12
        whole = chain.volumetric_error(
            {**q, **rest}, {n: t for n, t in curves.items() if n[2] == axis}
        )
        for k, d in enumerate("XYZ"):
            assert np.abs(whole[:, k] - curves[f"E{d}{axis}"].evaluate(PLACES[axis])).max() < 1e-12


@pytest.mark.parametrize("name", ["fts_lathe", "sts_lathe"])
def test_an_indicator_in_place_of_the_lathe_tool_reads_the_table(name):
    """Of X and of the axis along Z: a turn of the carriage is not a straightness at the tool."""
    along = "FTS" if name == "fts_lathe" else "Z"
    chain = presets(name, **({"radius": 0.02} if name == "fts_lathe" else {}))
    travel = np.linspace(0.0, 0.02, 9)
    for axis in ("X", along):
        q = {"C": 0.0, "X": 0.0, along: 0.0, axis: travel}
        pitch = {f"E{w}{axis}": TableTerm(travel, 1e-3 * travel) for w in "ABC"}
        assert np.abs(chain.volumetric_error(q, pitch)).max() < 1e-12, axis


def test_a_z_table_from_measured_bow_and_pitch_makes_the_machine_better():
    mill = Mill(seed=23)
    curves = measured(mill, (0, 0, 0))
    known = {n: curves[n] for n in ("EZX", "EBX")}
    x = PLACES["X"]
    tables = tables_from_machine(
        presets("mill_xyz"), known, over="X", positions=x, corrects="Z", at={"Y": 0.0, "Z": 0.0}
    )
    left = []
    for sign in (0, 1, -1):
        z = sign * tables["Z"].correction(x)
        heights = [
            mill.error({"X": q, "Y": 0.0, "Z": c}, (0, 0, 0))[2] + c
            for q, c in zip(x, z, strict=True)
        ]
        left.append(np.ptp(heights))
    before, after, wrong = left
    assert before > 2e-6
    assert after < 0.02 * before  # what stays: Z's own straightness over some um of correction
    assert wrong > 1.9 * before


# Reference values of specs/machines.md section 3, made by lines in space; um.
def test_reference_values_of_the_mill():
    x, y, z, sin, pi = 0.5, 0.4, 0.3, np.sin, np.pi
    errors = {
        "EXX": lambda q: 8e-6 * q / x,
        "EYX": lambda q: 1.2e-6 * sin(2 * pi * q / x),
        "EZX": lambda q: 3e-6 * sin(pi * q / x),
        "EAX": lambda q: -9e-6 * (q / x) ** 2,
        "EBX": lambda q: 14e-6 * (sin(pi * q / x + 0.7) - sin(0.7)),
        "ECX": lambda q: 5e-6 * sin(2 * pi * q / x),
        "EAY": lambda q: 6e-6 * q / y,
        "EBY": lambda q: -4e-6 * (q / y) ** 2,
        "ECY": lambda q: 7e-6 * sin(pi * q / y),
        "EAZ": lambda q: 3e-6 * q / z,
        "EBZ": lambda q: -8e-6 * q / z,
        "ECZ": lambda q: 2e-6 * (q / z) ** 2,
        "C0Y": 12e-6,
        "B0Z": -7e-6,
        "A0Z": 9e-6,
    }
    chain = presets("mill_xyz")
    for state, tool, expected in [
        ((0.13, 0.0, 0.0), (0, 0, 0), (2.08, 1.197632, 2.186906)),
        ((0.13, 0.21, 0.17), (0, 0, 0), (-2.022058, -0.764440, 2.059142)),
        ((0.37, 0.05, 0.28), (0.04, -0.03, -0.11), (3.147289, -2.722069, 2.578499)),
    ]:
        q = dict(zip("XYZ", state, strict=True))
        found = 1e6 * chain.volumetric_error(q, errors, tool=tool)
        assert np.abs(found - expected).max() < 1e-6, state


BALL = np.array([0.07, -0.03, 0.045])
POSES = [(0, 30), (-50, 200), (25, 310)]


class Trunnion:
    """Ball on a C table on an A table; what its axes do wrong is a motion of their rotors."""

    def __init__(self, height, motion_c=None, line_a=(0,) * 6, line_c=(0,) * 6):
        line_a, line_c = np.array(line_a), np.array(line_c)
        self.height, self.motion, self.line_a, self.line_c = height, motion_c, line_a, line_c

    def ball(self, a, c, b, *, wrong):
        """Centre of the ball in the machine."""
        shift, tilt = self.motion(c) if wrong else (np.zeros(3), np.zeros(3))
        lines = (self.line_a, self.line_c) if wrong else (np.zeros(6), np.zeros(6))
        # the rotor turns about the tool's +Z backwards, then errs in the directions of its stator
        p = turned((0, 0, 1), -c, b)
        p = tilted(tilt, p) + shift
        p = np.array([0, 0, self.height]) + tilted(lines[1][3:], p) + lines[1][:3]
        return tilted(lines[0][3:], turned((1, 0, 0), -a, p)) + lines[0][:3]


def reached(chain, trunnion, a, c):
    """Axis positions that put the nest on the nominal ball: its place in the machine."""
    place = trunnion.ball(a, c, BALL, wrong=False)
    return {"X": place[0], "Y": place[1], "Z": place[2], "A": a, "C": c}


def in_machine(a, c, v):
    """Directions of the workpiece in the machine."""
    return turned((1, 0, 0), -a, turned((0, 0, 1), -c, v))


@pytest.mark.parametrize("case", ["motions", "lines"])
def test_a_nest_in_the_spindle_reads_the_table_of_the_five_axis(case):
    height = 0.08

    def motion(c):
        # errors of the tool against the work: the rotor moves the other way
        e = np.array([4e-6 * np.cos(3 * c), 0.0, 1e-6 * np.sin(2 * c)])
        w = np.array([0.0, 6e-6 * np.cos(2 * c), 0.0])
        return (-e, -w) if case == "motions" else (np.zeros(3), np.zeros(3))

    errors = {
        "EXC": lambda c: 4e-6 * np.cos(3 * c),
        "EZC": lambda c: 1e-6 * np.sin(2 * c),
        "EBC": lambda c: 6e-6 * np.cos(2 * c),
    }
    printed = [
        (0.135, 0, 0.729160),
        (-1.793168, -0.687879, 0.577199),
        (-3.510987, -0.386266, -0.828351),
    ]
    a0, c0 = np.zeros(6), np.zeros(6)
    if case == "lines":
        errors = {"Y0A": 11e-6, "Z0A": -6e-6, "B0A": 20e-6, "C0A": -15e-6}
        errors |= {"X0C": 9e-6, "Y0C": 4e-6, "A0C": -13e-6, "B0C": 17e-6}
        a0, c0 = np.array([0, 11, -6, 0, 20, -15]) * 1e-6, np.array([9, 4, 0, -13, 17, 0]) * 1e-6
        printed = None
    trunnion = Trunnion(height, motion, a0, c0)
    chain = presets("five_axis", pivot_height=height)
    for i, pose in enumerate(POSES):
        a, c = np.radians(pose)
        q = reached(chain, trunnion, a, c)
        # the nest stands on the nominal place; the ball is elsewhere
        read = trunnion.ball(a, c, BALL, wrong=False) - trunnion.ball(a, c, BALL, wrong=True)
        found = in_machine(a, c, chain.volumetric_error(q, errors))
        assert np.abs(found - read).max() < SECOND, pose
        if printed:
            assert np.abs(1e6 * found - printed[i]).max() < 1e-6, pose


def test_reference_values_of_the_five_axis():
    """All 11 location errors of specs/machines.md, tool against ball in machine directions, um."""
    errors = {"Y0A": 11, "Z0A": -6, "B0A": 20, "C0A": -15, "X0C": 9, "Y0C": 4}
    errors |= {"A0C": -13, "B0C": 17, "C0Y": 8, "B0Z": -10, "A0Z": 5}
    chain = presets("five_axis", pivot_height=0.08)
    trunnion = Trunnion(0.08)
    expected = [
        (-12.112442, -15.525673, 6.895256),
        (-11.941871, -15.177536, 1.206292),
        (-14.659116, -13.952614, 10.749151),
    ]
    for pose, row in zip(POSES, expected, strict=True):
        a, c = np.radians(pose)
        q = reached(chain, trunnion, a, c)
        found = in_machine(
            a, c, chain.volumetric_error(q, {n: 1e-6 * v for n, v in errors.items()})
        )
        assert np.abs(1e6 * found - row).max() < 1e-6, pose


def test_a_nest_over_the_c_axis_reads_its_radial_motion():
    """EXC = a cos nC: the probe along X reads a cos nC, and not its product with cos C."""
    c = np.radians(np.arange(0.0, 360.0, 15.0))
    for name in ("five_axis", "sts_lathe"):
        chain = presets(name, **({"pivot_height": 0.05} if name == "five_axis" else {}))
        rest = {a: 0.0 for a in chain.axes if a != "C"}
        sense = 1.0 if name == "five_axis" else -1.0  # the lathe's spindle has errors of its body
        for n in (2, 3, 5):
            error = {"EXC": lambda q, n=n: 1e-6 * np.cos(n * q)}
            found = chain.volumetric_error({**rest, "C": c}, error)
            # the table turns against C, the lathe's spindle with it
            turn = -c if name == "five_axis" else c
            read = np.array([turned((0, 0, 1), t, v) for t, v in zip(turn, found, strict=True)])
            assert np.abs(read[:, 0] - sense * 1e-6 * np.cos(n * c)).max() < 1e-12
            assert np.abs(read[:, 1:]).max() < 1e-12


@pytest.mark.parametrize(
    ("height", "slope", "rho", "phi", "expected"),
    [
        (0.0, 0.0, 5e-3, 0.3, -52.952663),
        (0.0, 0.0, 17e-3, 2.2, -26.136914),
        (lambda r: 60e-3 - np.sqrt(60e-3**2 - r**2), None, 17e-3, 2.2, -41.581699),
        (lambda r: -45e-3 + np.sqrt(45e-3**2 - r**2), None, 9e-3, 4.0, -9.180786),
    ],
)
def test_turned_part_of_a_lathe_with_its_spindle_in_the_machine(height, slope, rho, phi, expected):
    """Equation 20 of specs/machines.md and its printed values, nm."""
    errors = {
        "EZX": lambda x: 40e-9 * np.cos(2 * np.pi * x / 12e-3),
        "EXX": lambda x: 70e-9 * (x / 22e-3) ** 2,
        "EZC": lambda c: 25e-9 * np.cos(2 * c + 0.4),
        "EXC": lambda c: 30e-9 * np.sin(3 * c),
        "EBC": lambda c: 1.5e-6 * np.cos(2 * c),
    }
    z = height(rho) if callable(height) else height
    if slope is None:
        radius = 60e-3 if z > 0.0 else 45e-3
        slope = np.sign(z) * rho / np.sqrt(radius**2 - rho**2)
    chain = presets("sts_lathe")
    found = chain.volumetric_error({"C": -phi, "X": rho, "Z": z}, errors)
    radial = found[0] * np.cos(phi) + found[1] * np.sin(phi)
    assert 1e9 * (found[2] - slope * radial) == pytest.approx(expected, abs=1e-6)


def own_mill(**keys):
    return Chain.from_dict(
        {
            "element": [
                {"name": "Z", "branch": "tool", "kind": "linear", "direction": "+Z"},
                {"name": "X", "branch": "workpiece", "kind": "linear", "direction": "-X", **keys},
            ]
        }
    )


def test_a_machine_of_my_own_reads_like_the_presets():
    q, pitch = {"X": 0.4, "Z": 0.0}, {"EBX": 1e-5}
    tool = own_mill(errors_of="tool")
    assert np.abs(tool.volumetric_error(q, pitch)).max() < 1e-18
    assert tool.messages == ()
    stated = own_mill(errors_of="tool", error_frame="after")
    assert stated.volumetric_error(q, pitch)[2] == pytest.approx(-4e-6, abs=1e-18)
    assert "own travel is not a lever" in tool.describe()
    assert "own travel is not a lever" not in stated.describe()


def test_own_travel_as_a_lever_is_said_where_nobody_chose_it():
    body = own_mill()
    assert body.volumetric_error({"X": 0.4, "Z": 0.0}, {"EBX": 1e-5})[2] == pytest.approx(
        4e-6, abs=1e-18
    )
    for chosen in (own_mill(error_frame="after"), own_mill(errors="XYZ")):
        assert chosen.messages == ()
    said = "its own travel is a lever"
    assert said in " ".join(body.messages)
    table = tables_from_machine(
        body,
        {"EZX": lambda x: 1e-5 * x},
        over="X",
        positions=[0.0, 0.1],
        at={"Z": 0.0},
        corrects="Z",
    )
    assert said in " ".join(table.messages)
    ranked = rank(
        body,
        Plane(),
        radius=0.01,
        errors={"EBX": 1e-5},
        positions=lambda x, y, z: {"X": x, "Z": z},
        n_rho=4,
        n_azimuth=8,
    )
    assert said in " ".join(ranked.messages)


@pytest.mark.parametrize("name", presets())
def test_the_presets_choose_and_say_nothing(name):
    options = {"fts_lathe": {"radius": 0.02}, "five_axis": {"pivot_height": 0.05}}.get(name, {})
    chain = presets(name, **options)
    assert chain.messages == ()
    assert len(chain.describe().splitlines()) == len(chain.elements)
