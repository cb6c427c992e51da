"""Kinematic chains: adjoint Jacobian against complex step, paper eq 11, exact against linear."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.machine.chains import Chain, presets
from metrosep.machine.elements import Element
from metrosep.machine.error_sets import ErrorSet

MACHINE = 1e-12  # rounding of products of lengths below 1 m; spec row 36
NANOMETRE = 1e-9
STEP = 1e-30  # complex step: no cancellation, so any tiny number will do
DIRECTIONS = "XYZABC"


# The simulator: exact products in complex numbers, without library code.
def hat(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def displacement(xi):
    """Return Trans . (I + hat), enough for a first derivative."""
    pose = np.eye(4, dtype=complex)
    pose[:3, :3] += hat(xi[3:])
    pose[:3, 3] = xi[:3]
    return pose


def shift(v):
    pose = np.eye(4, dtype=complex)
    pose[:3, 3] = v
    return pose


def spin(axis, angle):
    pose = np.eye(4, dtype=complex)
    k = hat(axis)
    pose[:3, :3] += np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    return pose


def product(elements, q, xi, line, tool):
    """Return the tool point in the workpiece; xi and line are errors by element name."""
    ends = {"tool": np.eye(4, dtype=complex), "workpiece": np.eye(4, dtype=complex)}
    for e in elements:
        if e.kind == "linear":
            move = shift(q[e.name] * np.array(e.direction))
        else:
            move = spin(np.array(e.direction), e.angle if e.kind == "fixed" else q[e.name])
        displaced = displacement(line[e.name])
        move = displaced @ move
        if e.kind == "linear":  # only its travel turns, not the carriage
            move = move @ np.linalg.inv(displaced)
        side = -1 if (e.errors_of, e.branch) == ("tool", "workpiece") else 1
        at = shift(e.measured_at)
        error = at @ displacement(side * xi[e.name]) @ np.linalg.inv(at)
        both = error @ move if e.error_frame == "before" else move @ error
        ends[e.branch] = ends[e.branch] @ shift(e.location) @ both
    return (np.linalg.inv(ends["workpiece"]) @ ends["tool"] @ np.append(tool, 1.0))[:3]


def random_chain(rng):
    """Return a chain of five elements of all kinds, at random places and attitudes."""
    elements = []
    for i in range(int(rng.integers(2, 7))):
        direction = rng.normal(size=3)
        kind = ("linear", "rotary", "fixed")[int(rng.integers(3))]
        weights = rng.normal(size=6)
        elements.append(
            Element(
                f"K{i}",
                ("tool", "workpiece")[i % 2]
                if i < 2
                else ("tool", "workpiece")[int(rng.integers(2))],
                kind,
                direction=direction / np.linalg.norm(direction),
                location=rng.normal(size=3),
                error_frame=("after", "before")[int(rng.integers(2))],
                errors_of=("body", "tool")[int(rng.integers(2))],
                measured_at=rng.normal(size=3) * int(rng.integers(2)),
                errors=DIRECTIONS,
                location_errors={} if kind == "fixed" else {f"C0K{i}": weights},
                angle=float(rng.normal()) if kind == "fixed" else 0.0,
            )
        )
    return Chain(elements)


def complex_step(chain, q, tool):
    """Return the Jacobian by complex step, in the order of the chain's terms."""
    columns = []
    for e in chain.elements:
        for j in range(6 + len(e.location_errors)):
            xi = {k.name: np.zeros(6, dtype=complex) for k in chain.elements}
            line = {k.name: np.zeros(6, dtype=complex) for k in chain.elements}
            if j < 6:
                xi[e.name][j] = 1j * STEP
            else:
                line[e.name] = 1j * STEP * np.array(e.location_errors[f"C0{e.name}"])
            columns.append(product(chain.elements, q, xi, line, tool).imag / STEP)
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("seed", range(40))
def test_jacobian_of_random_chains_is_the_complex_step(seed):
    rng = np.random.default_rng(seed)
    chain = random_chain(rng)
    tool = rng.normal(size=3)
    q = {name: float(rng.normal()) for name in chain.axes}
    expected = complex_step(chain, q, tool)
    got = chain.jacobian(q, tool=tool)
    assert got.shape == (3, len(chain.terms))
    assert np.abs(got - expected).max() < 1e-12 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("rule", ["small-angle", "orthonormal"])
@pytest.mark.parametrize("seed", range(20))
def test_exact_products_are_those_of_matrices(seed, rule):
    rng = np.random.default_rng(100 + seed)
    chain = random_chain(rng)
    tool = rng.normal(size=3)
    q = {name: float(rng.normal()) for name in chain.axes}
    # large, 9 mm and 0.09 rad: the second order must be right
    size = {t: 0.09 if t.removeprefix("E")[0] in "ABC" else 9e-3 for t in chain.terms}
    errors = {t: size[t] * rng.uniform(-1.0, 1.0) for t in chain.terms}

    def small(xi):
        if rule == "small-angle":
            return displacement(xi)
        turns = [spin(axis, angle) for axis, angle in zip(np.eye(3), xi[3:], strict=True)]
        return shift(xi[:3]) @ turns[0] @ turns[1] @ turns[2]

    ends = {"tool": np.eye(4, dtype=complex), "workpiece": np.eye(4, dtype=complex)}
    for e in chain.elements:
        side = -1 if (e.errors_of, e.branch) == ("tool", "workpiece") else 1
        xi = side * np.array([errors[f"E{d}{e.name}"] for d in DIRECTIONS])
        if e.kind == "linear":
            move = shift(q[e.name] * np.array(e.direction))
        else:
            move = spin(np.array(e.direction), e.angle if e.kind == "fixed" else q[e.name])
        for name, weights in e.location_errors.items():
            line = small(errors[name] * np.array(weights))
            move = line @ move @ (np.linalg.inv(line) if e.kind == "linear" else np.eye(4))
        at = shift(e.measured_at)
        error = at @ small(xi) @ np.linalg.inv(at)
        both = error @ move if e.error_frame == "before" else move @ error
        ends[e.branch] = ends[e.branch] @ shift(e.location) @ both
    pose = (np.linalg.inv(ends["workpiece"]) @ ends["tool"]).real
    point = pose @ np.append(tool, 1.0)
    got = chain.transform(q, errors, tool=tool, exact=rule)
    assert np.abs(got[:3, :3] - pose[:3, :3]).max() < MACHINE
    assert np.abs(got[:, 3] - point).max() < 10 * MACHINE
    nominal = chain.transform(q, tool=tool)[:3, 3]
    shifted = chain.volumetric_error(q, errors, tool=tool, exact=rule)
    assert np.abs(shifted - (point[:3] - nominal)).max() < 10 * MACHINE


def eq_11(theta, x, s, radius):
    """Return the columns of eq 11 (Micromachines 11, 331) by the paper's names, (n, 3) each."""
    c, n, zero, one = np.cos(theta), np.sin(theta), 0 * theta, 1 + 0 * theta
    stack = lambda *parts: np.stack(parts, axis=-1)  # noqa: E731
    columns = {
        "EXX": stack(c, -n, zero),
        "EYX": stack(n, c, zero),
        "EZX": stack(zero, zero, one),
        "EAX": stack(-s * n, -s * c, zero),
        "EBX": stack(s * c, -s * n, zero),
        "ECX": stack(zero, zero, zero),
        "ECC": stack((x - radius) * n, (x - radius) * c, zero),
        "EXC": stack(-one, zero, zero),
        "EYC": stack(zero, -one, zero),
        "EZC": stack(zero, zero, -one),
        "EAC": stack(zero, s, (radius - x) * n),
        "EBC": stack(-s, zero, (radius - x) * c),
        "B0Z": stack(zero, zero, -x),
    }
    for d in "XYZ":
        columns[f"E{d}FTS"] = columns[f"E{d}X"]
    for term in ("EAFTS", "EBFTS", "ECFTS", *(f"E{d}Z" for d in DIRECTIONS)):
        columns[term] = stack(zero, zero, zero)
    return columns


def lathe_states(n=50, radius=0.02):
    rng = np.random.default_rng(11)
    theta, x = rng.uniform(-7, 7, n), rng.uniform(0, radius, n)
    return theta, x, rng.uniform(-2e-3, 2e-3, n)


def test_lathe_has_the_columns_of_eq_11():
    radius = 0.02
    theta, x, s = lathe_states(radius=radius)
    chain = presets("fts_lathe", radius=radius)
    expected = eq_11(theta, x, s, radius)
    assert set(expected) == set(chain.terms)
    assert len(chain.terms) == 25
    got = chain.jacobian({"C": theta, "X": x, "FTS": s})
    for i, term in enumerate(chain.terms):
        assert np.abs(got[..., i] - expected[term]).max() < MACHINE, term


def test_lathe_turns_the_workpiece_to_azimuth_minus_theta():
    theta, x, s = lathe_states()
    point = presets("fts_lathe", radius=0.02).transform({"C": theta, "X": x, "FTS": s})[..., :3, 3]
    rho = 0.02 - x
    expected = np.stack([rho * np.cos(theta), -rho * np.sin(theta), s], axis=-1)
    assert np.abs(point - expected).max() < MACHINE


def test_tool_offset_adds_the_terms_of_the_specification():
    theta, x, s = lathe_states()
    xt, yt, zt = 0.031, -0.017, 0.06
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": theta, "X": x, "FTS": s}
    extra = chain.jacobian(q, tool=(xt, yt, zt)) - chain.jacobian(q)
    c, n = np.cos(theta), np.sin(theta)
    expected = {"EBX": zt * c, "EAX": -zt * n, "ECX": xt * n - yt * c, "EBC": -zt + 0 * c}
    expected |= {"EBFTS": zt * c, "EAFTS": -zt * n, "ECFTS": xt * n - yt * c}
    expected["ECC"] = -(xt * n - yt * c)
    for i, term in enumerate(chain.terms):
        assert np.abs(extra[..., 0, i] - expected.get(term, 0 * c)).max() < MACHINE, term


def test_abbe_example():
    chain = presets("fts_lathe", radius=0.02)
    second = np.deg2rad(1 / 3600)
    q = {"C": 0.0, "X": 0.01, "FTS": 0.0}
    error = chain.volumetric_error(q, {"EAFTS": second}, tool=(0, 0, 60e-3))
    assert error[1] == pytest.approx(-0.2909e-6, abs=1e-10)  # 60 mm: 0.291 um/arcsec
    error = chain.volumetric_error(q, {"EBFTS": second}, tool=(0, 0, 60e-3))
    assert error[0] == pytest.approx(0.2909e-6, abs=1e-10)


# Row 43: 1 um and 0.001 deg on the terms of Table 2, z = 1 mm. EZC is on beside EZX.
TABLE_2 = ["EXX", "EYX", "EZX", "EAX", "EBX", "ECC", "EXC", "EYC", "EZC", "EAC", "EBC", "B0Z"]


@pytest.mark.parametrize(
    ("rule", "factor", "expected_nm"),
    [("small-angle", 1, 0.0415), ("orthonormal", 1, 0.0433), ("small-angle", 10, 4.15)],
)
def test_row_43_exact_minus_linear(rule, factor, expected_nm):
    chain = presets("fts_lathe", radius=0.02)
    q = {
        "C": np.deg2rad(np.arange(0, 360, 10))[:, None],
        "X": 0.02 - np.array([1e-3, 10e-3, 20e-3]),
        "FTS": 1e-3,
    }
    unit = {"A": np.deg2rad(1e-3), "B": np.deg2rad(1e-3), "C": np.deg2rad(1e-3)}
    errors = {t: factor * unit.get(t[1] if t[0] == "E" else "B", 1e-6) for t in TABLE_2}
    difference = chain.volumetric_error(q, errors, exact=rule) - chain.volumetric_error(q, errors)
    assert np.abs(difference).max() / NANOMETRE == pytest.approx(
        expected_nm, abs=0.001 * expected_nm + 1e-4
    )


def test_error_frames_of_the_spindle_are_cone_and_tilt():
    theta = np.linspace(0, 6, 30)
    q = {"C": theta, "X": 0.005, "FTS": 0.0}
    tilt = presets("fts_lathe", radius=0.02).volumetric_error(q, {"EBC": 1e-6})
    cone = presets("fts_lathe", radius=0.02, spindle_errors="fixed").volumetric_error(
        q, {"EBC": 1e-6}
    )
    assert np.abs(tilt[:, 2] - 0.015e-6 * np.cos(theta)).max() < 1e-6 * MACHINE
    assert np.abs(cone[:, 2] - 0.015e-6).max() < 1e-6 * MACHINE
    fixed = presets("fts_lathe", radius=0.02, spindle_errors="fixed")
    both = fixed.jacobian(q, terms=["EXC", "EXX"])
    assert np.abs(both[..., 0] + both[..., 1]).max() < MACHINE  # dcx acts like -dxx


def test_linear_error_is_jacobian_times_errors():
    rng = np.random.default_rng(5)
    chain = random_chain(rng)
    q = {name: rng.normal(size=(4, 1)) for name in chain.axes}
    tool = rng.normal(size=(4, 3, 3))
    values = rng.normal(size=len(chain.terms)) * 1e-6
    errors = dict(zip(chain.terms, values, strict=True))
    got = chain.volumetric_error(q, errors, tool=tool)
    assert got.shape == (4, 3, 3)
    assert np.abs(got - chain.jacobian(q, tool=tool) @ values).max() < 1e-6 * MACHINE
    pose = chain.transform(q, errors, tool=tool, exact=False)
    nominal = chain.transform(q, {}, tool=tool)
    assert np.abs(pose[..., :3, 3] - nominal[..., :3, 3] - got).max() < MACHINE
    step = chain.transform(q, {k: 1e-3 * v for k, v in errors.items()}, tool=tool)
    turn = (step - nominal)[..., :3, :3] * 1e3
    assert np.abs(pose[..., :3, :3] - nominal[..., :3, :3] - turn).max() < 1e-11  # second order


def test_terms_chosen_come_in_the_order_asked():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": [0.3, 0.4], "X": 0.01, "FTS": 1e-3}
    whole = chain.jacobian(q)
    part = chain.jacobian(q, terms=["ECC", "EXX"])
    order = [chain.terms.index("ECC"), chain.terms.index("EXX")]
    assert part.shape == (2, 3, 2)
    assert (part == whole[..., order]).all()


def test_parked_axis_is_no_joint_until_it_is_given():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": 0.3, "X": 0.01, "FTS": 1e-3}
    assert not chain.jacobian(q, terms=["EBZ"]).any()
    assert (chain.volumetric_error(q, {"EBZ": 1e-6}) == 0).all()
    moved = chain.jacobian({**q, "Z": 0.0}, terms=["EBZ"])
    assert moved[2, 0] == pytest.approx(-0.01, abs=MACHINE)


def test_covariance_is_that_of_draws():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": np.array([0.3, 2.0]), "X": 0.01, "FTS": 1e-3}
    errors = ErrorSet(
        {"EXX": 0.0, "ECC": 0.0, "EZZ": 0.0},
        u={"EXX": 1e-7, "ECC": 1e-5, "EZZ": 1e-3},
        correlations={("EXX", "ECC"): -0.6},
    )
    got = chain.volumetric_covariance(q, errors)
    sigma = np.array([[1e-14, -0.6e-12, 0], [-0.6e-12, 1e-10, 0], [0, 0, 0]])
    jac = chain.jacobian(q, terms=["EXX", "ECC", "EZZ"])
    assert np.abs(got - jac @ sigma @ np.swapaxes(jac, 1, 2)).max() < 1e-14 * MACHINE
    draws = np.random.default_rng(1).multivariate_normal(np.zeros(2), sigma[:2, :2], 200_000)
    cloud = np.cov(draws @ jac[0, :, :2].T, rowvar=False)
    assert np.abs(got[0] - cloud).max() < 0.02 * np.abs(cloud).max()  # 2e5 draws: 0.3 %


def test_nan_position_is_nan_in_every_column():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": [0.0, 1.0, 2.0], "X": [0.01, np.nan, 0.0], "FTS": 0.0}
    got = chain.jacobian(q)
    assert np.isnan(got[1]).all()
    assert np.isfinite(got[[0, 2]]).all()
    for exact in (False, True, "small-angle"):
        error = chain.volumetric_error(q, {"EXX": lambda x: 1e-4 * x, "EAC": 1e-6}, exact=exact)
        assert np.isnan(error[1]).all()
        assert np.isfinite(error[[0, 2]]).all()
    assert np.isnan(chain.transform(q)[1]).all()


def test_integer_and_masked_positions():
    chain = presets("fts_lathe", radius=1)
    whole = chain.jacobian({"C": 0, "X": np.array([0, 1]), "FTS": 0})
    assert whole.shape == (2, 3, 25)
    masked = np.ma.array([0.0, 1.0], mask=[False, True])
    assert np.isnan(chain.jacobian({"C": 0, "X": masked, "FTS": 0})[1]).all()


def test_inputs_are_not_changed():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": np.linspace(0, 1, 5), "X": np.full(5, 0.01), "FTS": np.zeros(5)}
    before = {k: v.copy() for k, v in q.items()}
    got = chain.jacobian(q)
    got[:] = 7.0
    chain.volumetric_error(q, {"EXX": 1e-6}, exact=True)[:] = 7.0
    assert all((q[k] == before[k]).all() for k in q)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ({"C": 0.0, "X": 0.0}, "'FTS' .*is missing"),
        ({"C": 0.0, "X": 0.0, "FTS": 0.0, "Y": 0.0}, "no axis 'Y'"),
        ({"C": 0.0, "X": np.inf, "FTS": 0.0}, "'X' is infinite"),
        ({"C": 0.0, "X": 1j, "FTS": 0.0}, "real numbers"),
        ({"C": [0.0, 1.0], "X": [0.0, 1.0, 2.0], "FTS": 0.0}, r"do not broadcast: .*C \(2,\)"),
        ([0.0, 1.0], "mapping"),
    ],
)
def test_bad_positions(q, message):
    with pytest.raises((DataError, InvalidSamplesError), match=message):
        presets("fts_lathe", radius=0.02).jacobian(q)


def test_bad_terms_tools_and_products():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": 0.0, "X": 0.0, "FTS": 0.0}
    with pytest.raises(DataError, match="'EXQ' is not an error term"):
        chain.jacobian(q, terms=["EXQ"])
    with pytest.raises(DataError, match=r"'dxx' .* paper.*EXX"):
        chain.volumetric_error(q, {"dxx": 1e-6})
    with pytest.raises(DataError, match="small-angle"):
        chain.volumetric_error(q, {}, exact="rigorous")
    with pytest.raises(InvalidSamplesError, match="3 coordinates"):
        chain.jacobian(q, tool=(0, 0))
    with pytest.raises(InvalidSamplesError, match="EXX"):
        chain.volumetric_error(q, {"EXX": np.nan})
    with pytest.raises(InvalidSamplesError, match=r"EXX.*X = 0"):
        chain.volumetric_error(q, {"EXX": lambda x: x * np.nan})


def linear(name, direction, **options):
    return Element(name, options.pop("branch", "tool"), "linear", direction=direction, **options)


TABLE = linear("T", (0, 1, 0), branch="workpiece")


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([linear("X", (1, 0, 0))], "does not close.*'workpiece'"),
        ([TABLE], "does not close.*'tool'"),
        ([TABLE, linear("X", (1, 0, 0)), linear("X", (0, 0, 1))], "'X' is used twice"),
        ([TABLE, linear("X", (1, 0, 0)), linear("U", (-1, 0, 0))], "parallel_to"),
        ([TABLE, "X"], "Element objects"),
    ],
)
def test_chains_that_cannot_be(elements, message):
    with pytest.raises(DataError, match=message):
        Chain(elements)


def test_axes_that_repeat_each_other_on_purpose_pass():
    chain = Chain([TABLE, linear("X", (1, 0, 0)), linear("U", (1, 0, 0), parallel_to="X")])
    assert chain.axes == ("T", "X", "U")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kind": "helical"}, "one of linear, rotary, fixed, got 'helical'"),
        ({"branch": "bed"}, "one of tool, workpiece, got 'bed'"),
        ({"error_frame": "around"}, "one of after, before"),
        ({"errors_of": "bed"}, "one of body, tool"),
        ({"direction": (1, 1, 0)}, "length 1.41"),
        ({"direction": (1, 0)}, "3 finite numbers"),
        ({"location": (0, 0, np.nan)}, "3 finite numbers"),
        ({"errors": "XQ"}, "'Q'; known directions"),
        ({"errors": "XX"}, "repeat"),
        ({"angle": 0.1}, "fixed angle"),
        ({"location_errors": {"squareness": (0, 0, 0, 0, 0, 1)}}, "C0Y"),
        ({"location_errors": {"C0Y": (0, 0, 1)}}, "6 finite numbers"),
        ({"name": "2nd"}, "'2nd'"),
    ],
)
def test_elements_that_cannot_be(options, message):
    base = {"name": "X", "branch": "tool", "kind": "linear", "direction": (1, 0, 0)}
    with pytest.raises((DataError, InvalidSamplesError), match=message):
        Element(**{**base, **options})


def test_jacobian_of_1e5_states_needs_no_loop(calls):
    chain = presets("fts_lathe", radius=0.02)

    def effort(n):
        theta, x, s = lathe_states(n)
        q = {"C": theta, "X": x, "FTS": s}
        return calls(lambda: chain.jacobian(q))[0]

    assert effort(100_000) == effort(10)


@pytest.mark.parametrize("seed", range(10))
def test_where_the_bed_stands_does_not_matter(seed):
    rng = np.random.default_rng(300 + seed)
    chain = random_chain(rng)
    q = {name: float(rng.normal()) for name in chain.axes}
    axis = rng.normal(size=3)
    place = {
        "kind": "fixed",
        "direction": axis / np.linalg.norm(axis),
        "angle": float(rng.normal()),
        "location": rng.normal(size=3),
    }
    bases = [Element(f"base_{b}", b, **place) for b in ("tool", "workpiece")]
    moved = Chain([*bases, *chain.elements])
    assert moved.terms == chain.terms
    expected = chain.jacobian(q, tool=(0.1, 0.2, 0.3))
    difference = moved.jacobian(q, tool=(0.1, 0.2, 0.3)) - expected
    assert np.abs(difference).max() < 1e-12 * max(1.0, np.abs(expected).max())


def test_one_rigid_motion_of_tool_and_workpiece_is_invisible():
    # Null space: what moves both ends alike (the first element of either branch) leaves no error.
    place = {"location": (0.1, -0.2, 0.3), "errors": DIRECTIONS}
    chain = Chain(
        [
            Element("foot", "tool", "fixed", **place),
            linear("X", (1, 0, 0)),
            Element("plate", "workpiece", "fixed", **place),
            Element("C", "workpiece", "rotary"),
        ]
    )
    q = {"X": 0.2, "C": 0.7}
    for d in DIRECTIONS:
        both = {f"E{d}foot": 1e-6, f"E{d}plate": 1e-6}
        one = chain.volumetric_error(q, {f"E{d}foot": 1e-6})
        assert np.abs(one).max() > 1e-9 or d == "A"
        for exact in (False, "orthonormal", "small-angle"):
            assert np.abs(chain.volumetric_error(q, both, exact=exact)).max() < 1e-15


def test_empty_states_and_no_terms():
    chain = presets("fts_lathe", radius=0.02)
    q = {"C": np.zeros(0), "X": 0.01, "FTS": 0.0}
    assert chain.jacobian(q).shape == (0, 3, 25)
    assert chain.volumetric_error(q, {"EXC": np.sin}, exact=True).shape == (0, 3)
    assert chain.jacobian({**q, "C": 0.0}, terms=[]).shape == (3, 0)
    assert (chain.volumetric_error({**q, "C": 0.0}, {}) == 0).all()


def test_chains_travel_to_other_processes():
    chain = presets("five_axis", pivot_height=0.1)
    copy = pickle.loads(pickle.dumps(chain))  # noqa: S301
    q = {"X": 0.1, "Y": 0.2, "Z": 0.3, "A": 0.4, "C": 0.5}
    assert copy == chain
    assert (copy.jacobian(q) == chain.jacobian(q)).all()
