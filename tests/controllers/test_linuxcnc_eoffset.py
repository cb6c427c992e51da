"""External offset from a map: a hand-made program, LinuxCNC's book-keeping, what is refused."""

import ast
import hashlib
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.linuxcnc_eoffset import LinuxCNCEoffset
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    TableError,
    WriteError,
)

NOWHERE = Path("/nowhere/z.py")
ROUNDING = 1e-15
"""Sums of corrections of 1e-5 m in double: far below."""
COUNT = 1e-10
"""Length of a count by default, m."""

X = np.array([0.0, 10e-3, 30e-3])
Y = np.array([-5e-3, 5e-3])
VALUES = np.array([[0.0, 1e-6, -2e-6], [0.5e-6, 3e-6, 0.0]])
HAND = {
    "AXES": ("X", "Y", "Z"),
    "COUNT_MM": 1e-7,
    "X_MM": (0, 10, 30),
    "Y_MM": (-5, 5),
    "COUNTS": ((0, 10000, -20000), (5000, 30000, 0)),
}
"""What the program must hold for them, in counts of 0.1 nm."""


def map_of(x=X, y=Y, values=VALUES, **more):
    return CompensationMap(x, y, values, **more)


def constants(text):
    """The data of a program, read by Python's own parser."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and node.targets[0].id.isupper():
            found[node.targets[0].id] = ast.literal_eval(node.value)
    return found


def applied(text, x, y):
    """Correction in m of a program at x, y in m, by a bilinear lookup of its own."""
    data = constants(text)
    xs, ys, counts = (np.array(data[k], dtype=float) for k in ("X_MM", "Y_MM", "COUNTS"))
    x, y = np.clip(x * 1e3, xs[0], xs[-1]), np.clip(y * 1e3, ys[0], ys[-1])
    along = np.array([np.interp(x, xs, row) for row in counts])
    at = np.array([np.interp(v, ys, column) for v, column in zip(y, along.T, strict=True)])
    return np.rint(at) * data["COUNT_MM"] * 1e-3


@pytest.fixture
def dialect():
    return LinuxCNCEoffset()


@pytest.fixture
def program(dialect):
    return dialect.encode(map_of()).data.decode()


def hill(x, y):
    """Error of +3 um at (12, 20) mm, and a smaller one of -1 um at (30, 5) mm."""
    return 3e-6 * np.exp(-(((x - 12e-3) / 6e-3) ** 2) - ((y - 20e-3) / 9e-3) ** 2) - 1e-6 * np.exp(
        -(((x - 30e-3) / 5e-3) ** 2) - ((y - 5e-3) / 5e-3) ** 2
    )


@pytest.fixture
def hill_map():
    return CompensationMap.from_error(
        hill, x=np.linspace(0.0, 50e-3, 51), y=np.linspace(0.0, 30e-3, 31)
    )


def test_program_holds_the_numbers_of_the_map(program):
    data = constants(program)

    assert {k: data[k] for k in HAND} == HAND
    assert program.startswith("#!/usr/bin/python3\n")
    assert re.search(r"^    OFFSET_AV_RATIO = 0\.1$", program, re.MULTILINE)


def test_program_is_read_back(program, dialect):
    back = dialect.decode(program.encode(), NOWHERE)

    assert back.x == pytest.approx(X, abs=ROUNDING)
    assert back.y == pytest.approx(Y, abs=ROUNDING)
    assert back.values == pytest.approx(VALUES, abs=ROUNDING)
    assert (back.axes, back.compensates, back.reference) == (("X", "Y"), "Z", (0.0, 0.0))


@pytest.mark.parametrize(
    ("x_mm", "y_mm", "c_um"),
    [
        (10, 5, 3.0),
        (30, -5, -2.0),
        (5, -5, 0.5),
        (10, 0, 2.0),
        (20, 0, 0.5),  # mean of 1, -2, 3 and 0
        (15, 2.5, 1.75),  # 3/4 of 2.25 above and 1/4 of 0.25 below
        (-9, 99, 0.5),
        (99, -99, -2.0),
    ],
)
def test_lookup_is_bilinear_and_holds_the_edge(x_mm, y_mm, c_um, program, dialect):
    place = x_mm * 1e-3, y_mm * 1e-3
    expected = pytest.approx(c_um * 1e-6, abs=ROUNDING)

    assert dialect.lookup(program.encode(), NOWHERE)(*place) == expected
    assert namespace(program)["correction"](x_mm, y_mm) * COUNT == expected
    assert applied(program, *(np.array([p]) for p in place))[0] == expected


def signed(text):
    """The program with the checksum of what it holds now."""
    zeros = re.sub(r'(?<=CHECKSUM = ")[0-9a-f]{64}', "0" * 64, text)
    return zeros.replace("0" * 64, hashlib.sha256(zeros.encode()).hexdigest())


def namespace(program):
    """The program as a module, not run."""
    names = {"__name__": "component"}
    exec(compile(program, "z.py", "exec"), names)  # noqa: S102
    return names


def test_entries_are_minus_the_error_and_negated_double_it(hill_map, tmp_path):
    path = tmp_path / "z.py"
    controllers.write(hill_map, path, "linuxcnc-eoffset")
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0, 50e-3, 67), np.linspace(0, 30e-3, 43)))
    before = hill(x, y)

    after = before + applied(path.read_text(), x, y)
    wrong = before - applied(path.read_text(), x, y)

    assert np.ptp(before) > 3.9e-6
    assert np.ptp(after) < 0.03 * np.ptp(before)
    assert np.ptp(wrong) == pytest.approx(2 * np.ptp(before), abs=2e-7)
    simulated = controllers.simulate(path, "linuxcnc-eoffset")(x, y)
    assert simulated == pytest.approx(applied(path.read_text(), x, y), abs=1.01 * COUNT)
    back = controllers.read(path, "linuxcnc-eoffset")
    assert back.values == pytest.approx(hill_map.values, abs=0.51 * COUNT)
    assert back.reference == hill_map.reference


def test_negated_and_exchanged_maps_are_refused(hill_map, tmp_path):
    turned = CompensationMap(
        hill_map.y, hill_map.x, hill_map.values.T, axes=("X", "Y"), source=hill_map.source
    )
    for wrong in (hill_map.negated(), turned):
        with pytest.raises(SignCheckFailedError):
            controllers.write(wrong, tmp_path / "z.py", "linuxcnc-eoffset", verified_against=hill)
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(2, 9), st.integers(2, 9)),
    st.sampled_from([1e-9, 1e-10, 2.5e-10, 1e-12]),
)
def test_any_map_reads_back_and_is_applied_to_half_a_count(seed, shape, count):
    rng = np.random.default_rng(seed)
    x, y = (np.cumsum(rng.uniform(1e-4, 9e-3, n)) - 0.02 for n in shape)
    table = map_of(x, y, rng.normal(0.0, 3e-6, shape[::-1]), axes=("Y", "W"), compensates="U")
    dialect = LinuxCNCEoffset()

    encoded = dialect.encode(table, count=count)
    back = dialect.decode(encoded.data, NOWHERE, count=count)
    px, py = (rng.uniform(p[0] - 0.01, p[-1] + 0.01, 40) for p in (x, y))
    seen = applied(encoded.data.decode(), px, py)

    steps = np.diff(table.values, axis=0), np.diff(table.values, axis=1)
    slope = max(np.abs(s).max() for s in steps) / min(np.diff(x).min(), np.diff(y).min())
    assert encoded.quantisation <= 1.0 * count * 1.001  # half at the nodes, half between them
    assert encoded.step == pytest.approx(count, abs=1e-18)
    assert np.abs(back.values - table.values).max() <= 0.5 * count * 1.001 + 1e-18
    assert (back.axes, back.compensates) == (("Y", "W"), "U")
    assert np.abs(seen - table.correction(px, py)).max() <= 1.001 * count + 2e-13 * slope
    lookup = dialect.lookup(encoded.data, NOWHERE)
    assert np.abs(lookup(px, py) - seen).max() <= 1.001 * count  # a tie may round either way


class Motion:
    """LinuxCNC's book-keeping of an external offset: it counts steps, and forgets some of them."""

    def __init__(self):
        self.old, self.target = 0, 0.0

    def period(self, part):
        """One servo period; without the ramp."""
        delta, self.old = part["counts"] - self.old, part["counts"]
        if part["clear"]:
            self.target = 0.0
        elif part["machine-on"] and part["homed"]:
            self.target += delta * part["scale"]
        if not part["machine-on"]:
            self.target = 0.0
        part["requested"] = self.target


class CourseEndedError(Exception):
    """The end of a run of the component."""


def run(program, monkeypatch, course, period=None):
    """Offsets in mm that the component brings about; ``course`` sets pins at steps of 1 ms."""
    part, motion, clock, log = {}, Motion(), [0], []

    class Component:
        def __init__(self, name):
            assert name == "comp-map"

        def newpin(self, name, kind, _way):
            part[name] = {"float": 0.0, "s32": 0, "bit": False}[kind]

        def ready(self):
            part["is-ready"] = True

        def __getitem__(self, name):
            return part[name]

        def __setitem__(self, name, value):
            assert isinstance(value, int) or name == "scale"
            part[name] = value

    def sleep(seconds):
        for _ in range(max(1, round(seconds * 1000))):
            part.update(course.get(clock[0], {}))
            if clock[0] > max(course):
                raise CourseEndedError
            (period or motion.period)(part)
            log.append((part["requested"], part["active"], part["fault"]))
            clock[0] += 1

    fake = types.SimpleNamespace(
        component=Component, HAL_FLOAT="float", HAL_S32="s32", HAL_BIT="bit", HAL_IN=1, HAL_OUT=2
    )
    monkeypatch.setitem(sys.modules, "hal", fake)
    names = namespace(program)
    names["time"] = types.SimpleNamespace(sleep=sleep, monotonic=lambda: clock[0] / 1000)
    with pytest.raises(CourseEndedError):
        names["main"]()
    return log


NODE = {"x": 10.0, "y": 5.0}  # mm; the correction is 3 um there
ON = {"machine-on": True}


def test_offset_comes_when_the_machine_is_on_and_homed_and_not_before(program, monkeypatch):
    course = {0: NODE, 100: ON, 300: {"homed": True}, 600: {}}

    log = run(program, monkeypatch, course)

    assert all(offset == 0.0 and not active for offset, active, _ in log[:300])
    assert log[-1] == (pytest.approx(3e-3, abs=1e-9), True, False)


@pytest.mark.parametrize("lost", [{"machine-on": False}, {"homed": False}])
def test_offset_is_whole_again_after_the_machine_was_off_or_not_homed(lost, program, monkeypatch):
    again = {**ON, "homed": True}
    course = {0: {**NODE, **again}, 400: lost, 450: {"x": 30.0, "y": -5.0}, 500: again, 900: {}}

    log = run(program, monkeypatch, course)

    assert log[399][0] == pytest.approx(3e-3, abs=1e-9)
    assert log[480][0] == 0.0
    assert log[-1] == (pytest.approx(-2e-3, abs=1e-9), True, False)


def test_an_offset_that_is_not_taken_is_a_fault(program, monkeypatch):
    def deaf(part):
        part["requested"] = 0.0

    log = run(program, monkeypatch, {0: {**NODE, **ON, "homed": True}, 2500: {}}, period=deaf)

    assert not any(fault for *_, fault in log[:1000])
    assert log[-1][2]


def test_a_position_that_is_not_a_number_is_a_fault_and_moves_nothing(program, monkeypatch):
    course = {0: {**NODE, **ON, "homed": True}, 400: {"x": float("nan")}, 500: {}}

    log = run(program, monkeypatch, course)

    assert log[-1] == (pytest.approx(3e-3, abs=1e-9), True, True)


@pytest.mark.parametrize(
    ("axes", "third"), [(("X", "C"), "Z"), (("X", "Y"), "A"), (("x", "Y"), "Z")]
)
def test_other_axes_than_linear_ones_are_refused(axes, third, dialect):
    with pytest.raises(TableError, match="no linear axis of LinuxCNC"):
        dialect.encode(map_of(axes=axes, compensates=third))


def test_a_correction_beyond_32_bits_is_refused_with_its_place(dialect):
    values = VALUES.copy()
    values[1, 2] = 0.3  # somebody meant um

    with pytest.raises(LimitError, match=r"X = 30 mm, Y = 5 mm is 3000000000 counts.*214\.748"):
        dialect.encode(map_of(values=values))


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"count": "1 um"}, "count"),
        ({"count": 0.0}, "above zero"),
        ({"av_ratio": 0.95}, r"must lie in 0\.001 \.\.\. 0\.9"),
        ({"period": "2 mm"}, "period"),
        ({"joint": 2}, "unknown machine limit.* 'joint'"),
    ],
)
def test_options_out_of_range_are_refused(option, message, tmp_path):
    with pytest.raises(DataError, match=message):
        controllers.write(
            map_of(), tmp_path / "z.py", "linuxcnc-eoffset", allow_unverified=True, **option
        )
    assert list(tmp_path.iterdir()) == []


def test_options_are_in_the_program_and_in_the_sidecar(tmp_path):
    path = tmp_path / "z.py"
    given = {"count": "1 nm", "av_ratio": 0.5, "period": "4 ms"}
    controllers.write(map_of(), path, "linuxcnc-eoffset", allow_unverified=True, **given)

    data = constants(path.read_text())
    beside = path.with_name("z.py.json").read_text()

    assert (data["COUNT_MM"], data["AV_RATIO"], data["PERIOD_S"]) == (1e-6, 0.5, 0.004)
    assert '"OFFSET_AV_RATIO = 0.5"' in beside
    assert "axis.z.eoffset-counts" in beside
    with pytest.raises(DataError, match="count is 1e-09 in the file, not 1e-10"):
        controllers.read(path, "linuxcnc-eoffset", count=1e-10)
    with pytest.raises(WriteError, match="exists"):
        controllers.write(map_of(), path, "linuxcnc-eoffset", allow_unverified=True)


def test_a_table_is_refused(table, tmp_path):
    with pytest.raises(TableError, match="CompensationMap"):
        controllers.write(table, tmp_path / "z.py", "linuxcnc-eoffset")


def test_every_line_that_is_lost_or_doubled_is_noticed(program, dialect):
    lines = program.splitlines(keepends=True)
    for i in range(len(lines)):
        for damaged in (lines[:i] + lines[i + 1 :], lines[: i + 1] + lines[i:]):
            with pytest.raises(CorruptFileError):
                dialect.decode("".join(damaged).encode(), NOWHERE)


def test_every_cut_is_noticed(program, dialect):
    for end in range(0, len(program) - 1, 11):
        with pytest.raises(CorruptFileError):
            dialect.decode(program[:end].encode(), NOWHERE)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("    10,\n", "    30,\n", "does not rise"),
        ("(0, 10000, -20000)", "(0, 10000)", "2 entries, X_MM has 3"),
        ("    (0, 10000, -20000),\n", "", "at least 2 entries"),
        ("    (0, 10000, -20000),\n", "    (0, 1e4, -20000),\n", "no entry of COUNTS"),
        ("COUNT_MM = 0.0000001", "COUNT_MM = -0.0000001", "above zero"),
        ("COUNT_MM = 0.0000001", "COUNT_MM = 1e-7", "COUNT_MM"),
        ("(1.0 - s) * low[i]", "(1.0 + s) * low[i]", "is not that of the program"),
        ("\n", "\r\n", "AXES"),
        ("# one line", "# on\N{LATIN SMALL LETTER E WITH ACUTE} line", "not ASCII"),
    ],
)
def test_damage_is_named(old, new, message, program, dialect):
    assert old in program

    with pytest.raises(CorruptFileError, match=message):
        dialect.decode(program.replace(old, new).encode(), NOWHERE)


def test_an_entry_beyond_32_bits_is_not_read(program, dialect):
    with pytest.raises(LimitError, match="32 bits"):
        dialect.decode(signed(program.replace("30000", "2147483648")).encode(), NOWHERE)


def test_sidecar_of_something_else_is_refused(program, dialect, tmp_path):
    (tmp_path / "z.py.json").write_text('{"table": {"reference_si": 3}}')

    with pytest.raises(CorruptFileError, match="not that of a map"):
        dialect.decode(program.encode(), tmp_path / "z.py")


@pytest.mark.parametrize("direction", [0, 2, np.array([1, -1, 3])])
def test_lookup_wants_a_direction(direction, program, dialect):
    with pytest.raises(DataError, match="direction"):
        dialect.lookup(program.encode(), NOWHERE)(0.01, 0.0, direction)


def test_lookup_broadcasts_and_leaves_its_arguments_alone(program, dialect):
    lookup = dialect.lookup(program.encode(), NOWHERE)
    x, y = np.array([0, 1, 2]), np.array([[0], [1]])

    assert lookup(x, y).shape == (2, 3)
    assert x.tolist() == [0, 1, 2]
    assert np.isnan(lookup(np.nan, 0.0)).all()


ROW = "    (0, 10000, -20000),\n"
OTHER_ROW = "    (5000, 30000, 0),\n"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (ROW + OTHER_ROW, OTHER_ROW + ROW),
        ("(5000, 30000, 0)", "(30000, 5000, 0)"),
        ("(5000, 30000, 0)", "(5000, -30000, 0)"),
        ("    -5,\n", "    -4,\n"),
        ("COUNT_MM = 0.0000001", "COUNT_MM = 0.000001"),
        ("PERIOD_S = 0.002", "PERIOD_S = 0.02"),
    ],
)
def test_numbers_that_were_changed_or_exchanged_are_noticed(old, new, program, dialect):
    assert old in program

    with pytest.raises(CorruptFileError, match="changed or exchanged"):
        dialect.decode(program.replace(old, new).encode(), NOWHERE)


def test_checksum_is_that_of_the_file_with_zeros_in_its_place(program):
    found = re.search(r'^CHECKSUM = "([0-9a-f]{64})"$', program, re.MULTILINE)[1]
    data = program.replace(found, "0" * 64).encode()

    assert hashlib.sha256(data).hexdigest() == found


@pytest.mark.parametrize("digits", [16, 400, 5000])
@pytest.mark.parametrize("old", ["30000", "    10,\n", "COUNT_MM = 0.0000001"])
def test_endless_numbers_are_no_entries(digits, old, program, dialect):
    new = re.sub(r"[\d.]+", "9" * digits, old)

    with pytest.raises(CorruptFileError):
        dialect.decode(program.replace(old, new).encode(), NOWHERE)


@pytest.mark.parametrize("name", ["X\nimport os", '"', "Z\\", "\u0416"])
def test_names_that_would_break_the_program_are_refused(name, dialect):
    for more in ({"axes": (name, "Y")}, {"compensates": name}):
        with pytest.raises(TableError, match=r"no linear axis|name"):
            dialect.encode(map_of(**more))
