"""Chained lincurves: a hand-made file, a small HAL of its own, what is refused."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.linuxcnc import LinuxCNCLincurve
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    TableError,
    WriteError,
)

ROUNDING = 1e-15
"""Sums of corrections of 1e-2 mm in double, in m: far below."""
QUANTUM = 0.5e-13 * 1.001
"""Half of ten decimals of a millimetre."""
PLACE = 0.5e-13
"""Rounding of a position, m."""

HAND = """\
# metrosep: X (joint 0) -> Z (joint 1), 18 points
# adds the correction -e (mm) to the motor command and takes it out of the feedback
loadrt lincurve names=comp-0-1-0,comp-0-1-1 personality=16,3
loadrt sum2 names=comp-0-1-s-1,comp-0-1-cmd,comp-0-1-fb
setp comp-0-1-fb.gain1 -1
{points}
addf comp-0-1-fb servo-thread
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf comp-0-1-0 servo-thread
addf comp-0-1-1 servo-thread
addf comp-0-1-s-1 servo-thread
addf comp-0-1-cmd servo-thread
net comp-0-1-position joint.0.pos-cmd
net comp-0-1-position comp-0-1-0.in
net comp-0-1-position comp-0-1-1.in
net comp-0-1-below-1 comp-0-1-0.out comp-0-1-s-1.in0
net comp-0-1-piece-1 comp-0-1-1.out comp-0-1-s-1.in1
net comp-0-1-value comp-0-1-s-1.out comp-0-1-cmd.in1 comp-0-1-fb.in1
net comp-0-1-motor joint.1.motor-pos-cmd comp-0-1-cmd.in0
net comp-0-1-drive comp-0-1-cmd.out
net comp-0-1-encoder comp-0-1-fb.in0
net comp-0-1-feedback comp-0-1-fb.out joint.1.motor-pos-fb
"""
HAND_X = [*range(-30, 0, 3), 0, 1, 3, 6, 10, 12, 20, 21]  # mm
HAND_Y = [0.4, 0.1, 0, 0, -0.2, -0.1, 0, 0.2, 0.1, 0, 0, -0.3, -0.5, 0, 1.0, 3.0, 2.5, 4.0]  # um
"""The 16th point, 3 um at 12 mm, ends the first curve and begins the second."""


def hand_text():
    lines = []
    for curve, numbers, zero in ((0, range(16), 0.0), (1, range(15, 18), 3.0)):
        for i, k in enumerate(numbers):
            y = (HAND_Y[k] - zero) * 1e-3
            lines.append(f"setp comp-0-1-{curve}.x-val-{i:02d} {HAND_X[k]:.10f}")
            lines.append(f"setp comp-0-1-{curve}.y-val-{i:02d} {y:.10f}")
    return HAND.format(points="\n".join(lines))


class Hal:
    """As much of HAL as such a file needs: lincurve, sum2, signals, one thread."""

    def __init__(self, text):
        self.kind, self.size, self.value, self.signal, self.thread = {}, {}, {}, {}, []
        for line in text.splitlines():
            words = line.split("#")[0].split()
            if words:
                getattr(self, words[0])(*words[1:])

    def loadrt(self, kind, names, personality=None):
        for i, name in enumerate(names.removeprefix("names=").split(",")):
            self.kind[name] = kind
            if personality:
                self.size[name] = int(personality.removeprefix("personality=").split(",")[i])
            for pin in ("gain0", "gain1"):
                self.value[f"{name}.{pin}"] = 1.0

    def setp(self, pin, value):
        self.value[pin] = float(value)

    def addf(self, function, _thread):
        self.thread.append(function)

    def net(self, signal, *pins):
        for pin in pins:
            self.signal[pin] = signal

    def get(self, pin):
        return self.value.get(self.signal.get(pin, pin), 0.0)

    def put(self, pin, value):
        self.value[self.signal.get(pin, pin)] = value

    def period(self, joints):
        """One servo period; ``joints`` are the pins that the motion controller puts out."""
        for name in self.thread:
            if name == "motion-controller":
                for pin, value in joints.items():
                    self.put(pin, value)
            elif self.kind.get(name) == "lincurve":
                points = range(self.size[name])
                x, y = ([self.value[f"{name}.{a}-val-{i:02d}"] for i in points] for a in "xy")
                self.put(f"{name}.out", float(np.interp(self.get(f"{name}.in"), x, y)))
            elif self.kind.get(name) == "sum2":
                terms = [self.get(f"{name}.in{i}") * self.value[f"{name}.gain{i}"] for i in (0, 1)]
                self.put(f"{name}.out", sum(terms))


def applied(text, positions, a=0, b=1):
    """Corrections in m that the drive gets on top of its command, as the little HAL makes them."""
    hal, found = Hal(text), []
    for x in np.asarray(positions) * 1e3:
        hal.period({f"joint.{a}.pos-cmd": x, f"joint.{b}.motor-pos-cmd": 0.0})
        found.append(hal.get(f"comp-{a:x}-{b:x}-cmd.out") * 1e-3)
    return np.array(found)


@pytest.fixture
def dialect():
    return LinuxCNCLincurve()


@pytest.fixture
def one_way(bump):
    return CompensationTable.from_error(
        bump, positions=np.linspace(0.0, 50e-3, 101), axis="X", compensates="Z", direction="both"
    )


def hand_table():
    return CompensationTable(
        positions=np.array(HAND_X) * 1e-3,
        forward=np.array(HAND_Y) * 1e-6,
        reverse=None,
        axis="X",
        compensates="Z",
        reference=0.0,
    )


def test_hand_made_file_is_written_byte_for_byte(dialect):
    encoded = dialect.encode(hand_table(), source_joint=0, target_joint=1)

    assert encoded.data.decode() == hand_text()
    assert encoded.quantisation <= ROUNDING


def test_hand_made_file_is_read(dialect, tmp_path):
    table = dialect.decode(hand_text().encode(), tmp_path / "x.hal")

    assert table.positions == pytest.approx(np.array(HAND_X) * 1e-3, abs=ROUNDING)
    assert table.forward == pytest.approx(np.array(HAND_Y) * 1e-6, abs=ROUNDING)
    assert table.reverse is None
    assert (table.axis, table.compensates) == ("X", "Z")


@pytest.mark.parametrize(
    ("x_mm", "c_um"),
    [
        (-99, 0.4),
        (-28.5, 0.25),
        (3, -0.5),
        (11, 2.0),
        (12, 3.0),
        (16, 2.75),
        (20.5, 3.25),
        (77, 4),
    ],
)
def test_hand_made_file_is_looked_up_as_a_small_hal_does(x_mm, c_um, dialect, tmp_path):
    lookup = dialect.lookup(hand_text().encode(), tmp_path / "x.hal")

    assert lookup(x_mm * 1e-3) == pytest.approx(c_um * 1e-6, abs=ROUNDING)
    assert applied(hand_text(), [x_mm * 1e-3])[0] == pytest.approx(c_um * 1e-6, abs=ROUNDING)


def test_feedback_shows_the_command_without_the_correction():
    hal = Hal(hand_text())
    joints = {"joint.0.pos-cmd": 12.0, "joint.1.motor-pos-cmd": 5.0}
    hal.period(joints)
    hal.put("comp-0-1-fb.in0", hal.get("comp-0-1-cmd.out"))  # an ideal drive: 5.003 mm
    hal.period(joints)

    assert hal.get("comp-0-1-cmd.out") == pytest.approx(5.003, abs=1e-12)
    assert hal.get("joint.1.motor-pos-fb") == pytest.approx(5.0, abs=1e-12)


def test_entry_is_minus_the_error_and_negated_doubles_it(one_way, bump, tmp_path):
    path = tmp_path / "x.hal"
    done = controllers.write(
        one_way, path, "linuxcnc-lincurve", source_joint=0, target_joint=1, verified_against=None
    )
    at = np.linspace(0.0, 50e-3, 1777)
    before = bump(at)

    added = applied(path.read_text(), at)
    after, wrong = before + added, before - added

    assert np.ptp(before) == pytest.approx(4e-6, abs=3e-8)
    assert np.ptp(after) < 0.05 * np.ptp(before)
    assert np.ptp(wrong) == pytest.approx(2 * np.ptp(before), abs=1e-7)
    assert done is not None
    assert controllers.simulate(path, "linuxcnc-lincurve")(at) == pytest.approx(
        added, abs=ROUNDING
    )
    back = controllers.read(path, "linuxcnc-lincurve")
    assert back.forward == pytest.approx(one_way.forward, abs=QUANTUM)
    assert back.reference == one_way.reference


@settings(max_examples=40, deadline=None)
@given(data=st.data(), n=st.sampled_from([2, 3, 15, 16, 17, 31, 32, 46, 90]))
def test_any_table_reads_back_and_is_applied_to_the_quantum(data, n):
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    positions = np.cumsum(rng.uniform(1e-4, 5e-3, n)) - 0.05
    table = CompensationTable(
        positions=positions,
        forward=rng.normal(0.0, 3e-6, n),
        reverse=None,
        axis="X",
        compensates="Z",
        reference=0.0,
    )
    a, b = rng.permutation(9)[:2].tolist()
    dialect = LinuxCNCLincurve()
    encoded = dialect.encode(table, source_joint=a, target_joint=b)
    nowhere = Path("/nowhere/x.hal")
    back = dialect.decode(encoded.data, nowhere, source_joint=a, target_joint=b)
    at = rng.uniform(positions[0] - 0.01, positions[-1] + 0.01, 60)

    slope = np.abs(np.diff(table.forward) / np.diff(table.positions)).max()
    margin = QUANTUM * (1 + 2 * slope) + ROUNDING
    assert encoded.quantisation <= QUANTUM
    assert np.abs(back.forward - table.forward).max() <= encoded.quantisation + 1e-18
    assert np.abs(back.positions - table.positions).max() <= PLACE + 1e-16
    seen = applied(encoded.data.decode(), at, a, b)
    assert np.abs(seen - table.correction(at)).max() <= margin
    assert np.abs(dialect.lookup(encoded.data, nowhere)(at) - seen).max() <= ROUNDING


@pytest.mark.parametrize(
    ("n", "sizes"),
    [
        (2, "2"),
        (16, "16"),
        (17, "16,2"),
        (31, "16,16"),
        (32, "16,16,2"),
        (961, ",".join(["16"] * 64)),
    ],
)
def test_curves_hold_sixteen_points_and_share_their_ends(n, sizes, dialect):
    x = np.linspace(0.0, 0.1, n)
    table = CompensationTable(x, 1e-6 * np.sin(40 * x), None, "X", "Z", 0.0)

    text = dialect.encode(table, source_joint=0, target_joint=1).data.decode()

    assert text.splitlines()[2].endswith(f"personality={sizes}")
    assert max(map(len, text.splitlines())) < 1024  # halcmd cuts longer lines


def test_962_points_are_refused(dialect):
    x = np.linspace(0.0, 0.1, 962)
    table = CompensationTable(x, np.zeros(962), None, "X", "Z", 0.0)

    with pytest.raises(LimitError, match=r"962 points, 64 lincurves take 961.*0\.1042 mm"):
        dialect.encode(table, source_joint=0, target_joint=1)


def test_two_directions_are_refused(dialect, table):
    with pytest.raises(TableError, match="direction='both'"):
        dialect.encode(replace(table, compensates="Z"), source_joint=0, target_joint=1)


@pytest.mark.parametrize(("compensates", "joints"), [("Z", (1, 1)), ("X", (0, 1))])
def test_joints_that_contradict_the_axes_are_refused(compensates, joints, dialect):
    table = replace(hand_table(), compensates=compensates)

    with pytest.raises(TableError, match="one of the two is wrong"):
        dialect.encode(table, source_joint=joints[0], target_joint=joints[1])


def test_positions_that_fall_together_in_print_are_refused(dialect):
    table = CompensationTable([0.0, 1e-14, 1e-3], [0.0, 0.0, 1e-6], None, "X", "Z", 0.0)

    with pytest.raises(TableError, match="closer than 1e-10 mm"):
        dialect.encode(table, source_joint=0, target_joint=1)


@pytest.mark.parametrize("thread", ["servo thread", "servo-thread\nsetp x 1", "#", ""])
def test_a_thread_that_is_no_name_is_refused(thread, tmp_path):
    with pytest.raises(DataError, match="thread"):
        controllers.write(
            hand_table(),
            tmp_path / "x.hal",
            "linuxcnc-lincurve",
            source_joint=0,
            target_joint=1,
            thread=thread,
            allow_unverified=True,
        )
    assert list(tmp_path.iterdir()) == []


def test_joints_must_be_told_and_existing_files_stay(tmp_path):
    path = tmp_path / "x.hal"
    with pytest.raises(DataError, match=r"source_joint= .*target_joint="):
        controllers.write(hand_table(), path, "linuxcnc-lincurve", allow_unverified=True)
    path.write_text("mine\n")
    with pytest.raises(WriteError, match="exists"):
        controllers.write(
            hand_table(),
            path,
            "linuxcnc-lincurve",
            source_joint=0,
            target_joint=1,
            allow_unverified=True,
        )
    assert path.read_text() == "mine\n"


def test_every_line_that_is_lost_doubled_or_exchanged_is_noticed(dialect, tmp_path):
    lines = hand_text().splitlines(keepends=True)
    path = tmp_path / "x.hal"
    for i in range(2, len(lines)):
        damages = [lines[:i] + lines[i + 1 :], [*lines[: i + 1], *lines[i:]]]
        if i + 1 < len(lines):
            damages.append([*lines[:i], lines[i + 1], lines[i], *lines[i + 2 :]])
        for damaged in damages:
            with pytest.raises(CorruptFileError):
                dialect.decode("".join(damaged).encode(), path)


def test_a_file_of_old_is_read_and_names_of_two_files_differ(dialect):
    old = hand_text().replace("comp-0-1-s-", "comp-sum-").replace("comp-0-1-", "comp-")
    assert dialect.decode(old.encode(), Path(os.devnull)).forward.tolist() == (
        dialect.decode(hand_text().encode(), Path(os.devnull)).forward.tolist()
    )
    mixed = hand_text().replace("comp-0-1-cmd.out", "comp-0-2-cmd.out")
    with pytest.raises(CorruptFileError, match="not that of a lincurve chain"):
        dialect.decode(mixed.encode(), Path(os.devnull))
    table = CompensationTable([0.0, 1e-3], [0.0, 1e-6], None, "X", "Z", 0.0)
    names = [
        set(
            re.findall(
                r"comp-[\w-]+", dialect.encode(table, source_joint=0, target_joint=t).data.decode()
            )
        )
        for t in (1, 2)
    ]
    assert not names[0] & names[1]


def test_comments_and_blanks_do_not_matter(dialect, tmp_path):
    text = hand_text().replace("addf comp-0-1-0 ", "\n# mine\naddf   comp-0-1-0  ") + "# end\n"

    table = dialect.decode(text.encode(), tmp_path / "x.hal", target_joint=1)

    assert table.positions.size == 18


def test_an_option_that_contradicts_the_file_is_refused(dialect, tmp_path):
    with pytest.raises(DataError, match="the file says target_joint=1, you say target_joint=2"):
        dialect.lookup(hand_text().encode(), tmp_path / "x.hal", target_joint=2)


@pytest.mark.parametrize("direction", [0, 2, np.array([1, -1, 3])])
def test_lookup_wants_a_direction(direction, dialect, tmp_path):
    with pytest.raises(DataError, match="direction"):
        dialect.lookup(hand_text().encode(), tmp_path / "x.hal")(0.01, direction)


def test_lookup_takes_arrays_and_integers_and_leaves_them_alone(dialect, tmp_path):
    lookup = dialect.lookup(hand_text().encode(), tmp_path / "x.hal")
    places = np.array([[0, 1], [-1, 0]])

    assert lookup(places, -1).shape == (2, 2)
    assert places.tolist() == [[0, 1], [-1, 0]]
    assert np.isnan(lookup(np.nan)).all()


DEGREE = np.pi / 180


@pytest.mark.parametrize(
    ("axis", "compensates", "unit", "unit_c", "comment"),
    [
        ("C", "Z", DEGREE, 1e-3, "C (joint 3, degrees) -> Z (joint 2)"),
        ("Z", "C1", 1e-3, DEGREE, "Z (joint 3) -> C1 (joint 2, degrees)"),
        ("B", "C", DEGREE, DEGREE, "B (joint 3, degrees) -> C (joint 2, degrees)"),
    ],
)
@pytest.mark.parametrize("beside", [True, False])
def test_axes_that_turn_are_in_degrees(axis, compensates, unit, unit_c, comment, beside, tmp_path):
    path = tmp_path / "c.hal"
    table = CompensationTable(
        np.array([0.0, 30.0, 90.0]) * unit,
        np.array([0.0, 0.002, -0.001]) * unit_c,
        None,
        axis,
        compensates,
        0.0,
    )
    where = {"source_joint": 3, "target_joint": 2}
    controllers.write(table, path, "linuxcnc-lincurve", allow_unverified=True, **where)
    text = path.read_text()
    if not beside:
        path.with_name("c.hal.json").unlink()

    assert text.startswith(f"# metrosep: {comment}, 3 points\n")
    hal = Hal(text)
    hal.period({"joint.3.pos-cmd": 60.0, "joint.2.motor-pos-cmd": 5.0})
    assert hal.get("comp-3-2-cmd.out") == pytest.approx(5.0005, abs=1e-12)
    back = controllers.read(path, "linuxcnc-lincurve")
    assert (back.axis, back.compensates) == (axis, compensates)
    assert back.positions == pytest.approx(table.positions, abs=2e-12)
    assert back.forward == pytest.approx(table.forward, abs=2e-12)
    lookup = controllers.simulate(path, "linuxcnc-lincurve")
    assert lookup(60.0 * unit) == pytest.approx(0.0005 * unit_c, abs=2e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("X (joint 0)", "C (joint 0)"),  # as earlier versions wrote it, in thousandths of a radian
        ("X (joint 0)", "X (joint 0, degrees)"),
        ("Z (joint 1)", "B2 (joint 1)"),
    ],
)
def test_a_comment_that_leaves_degrees_open_is_refused(old, new, dialect, tmp_path):
    with pytest.raises(CorruptFileError, match="degrees"):
        dialect.decode(hand_text().replace(old, new, 1).encode(), tmp_path / "x.hal")


def test_comment_and_sidecar_must_agree_on_degrees(dialect, tmp_path):
    path = tmp_path / "x.hal"
    path.with_name("x.hal.json").write_text('{"table": {"axis": "C", "compensates": "Z"}}')

    with pytest.raises(CorruptFileError, match="contradict each other"):
        dialect.decode(hand_text().encode(), path)


def test_a_backslash_would_swallow_the_next_line(dialect, tmp_path):
    """HAL joins a line that ends in a backslash with the next one, also in a comment."""
    text = hand_text().replace("# adds", "# mine \\\n# adds")
    with pytest.raises(CorruptFileError, match="line 2 holds a backslash"):
        dialect.decode(text.encode(), tmp_path / "x.hal")
    last = hand_text().replace("addf comp-0-1-0", "# path c:\\x\naddf comp-0-1-0")
    with pytest.raises(CorruptFileError, match="backslash"):
        dialect.decode(last.encode(), tmp_path / "x.hal")


@pytest.mark.parametrize(
    "name", ["X\nsetp comp-0-1-fb.gain1 1", "X\\", "X\t", "\u03a7", "X (joint 7)"]
)
@pytest.mark.parametrize("field", ["axis", "compensates"])
def test_a_name_that_does_not_fit_into_a_comment_is_refused(name, field, dialect):
    with pytest.raises(TableError, match="name"):
        dialect.encode(replace(hand_table(), **{field: name}), source_joint=0, target_joint=1)


def test_the_comment_with_the_axes_is_found_wherever_it_stands(dialect, tmp_path):
    path = tmp_path / "x.hal"
    turned = hand_text().replace("X (joint 0)", "C (joint 0, degrees)")
    first, rest = turned.split("\n", 1)

    moved = dialect.decode(f"\n# mine\n{rest}  {first} \n".encode(), path)

    assert (moved.axis, moved.positions[-1]) == ("C", pytest.approx(21 * DEGREE, abs=1e-15))
    with pytest.raises(CorruptFileError, match="2 comments that name the axes"):
        dialect.decode((turned + hand_text().split("\n", 1)[0] + "\n").encode(), path)


@pytest.mark.parametrize("number", ["9" * 13, "1" * 5000, "0." + "1" * 5000])
def test_endless_numbers_are_refused(number, dialect, tmp_path):
    text = hand_text().replace(
        "comp-0-1-0.y-val-04 -0.0002000000", f"comp-0-1-0.y-val-04 {number}"
    )

    with pytest.raises(CorruptFileError, match="once"):
        dialect.decode(text.encode(), tmp_path / "x.hal")


class TestLincurve(DialectContract):
    name = "linuxcnc-lincurve"
    hand = hand_text()
    damage = (
        ("gain1 -1", "gain1 1", "line 5"),
        (
            "comp-0-1-0.x-val-03 -21.0",
            "comp-0-1-0.x-val-03 -24.0",
            "line 12: the position does not rise",
        ),
        (
            "comp-0-1-1.x-val-00 12.0",
            "comp-0-1-1.x-val-00 13.0",
            "does not start at zero where comp-0-1-0",
        ),
        ("comp-0-1-1.y-val-00 0.0", "comp-0-1-1.y-val-00 0.1", "does not start at zero"),
        ("personality=16,3", "personality=16,2", "is not that of"),
        ("personality=16,3", "personality=17,3", "personality"),
        ("setp comp-0-1-0.y-val-04 -0.0002000000", "setp comp-0-1-0.y-val-04 nan", "once"),
        ("setp comp-0-1-0.y-val-04 -0.0002000000", "setp comp-0-1-0.y-val-04 -2e-4", "once"),
        ("joint.0.pos-cmd", "joint.0.motor-pos-cmd", "wiring is missing"),
        ("comp-0-1-position", "komp-position", "net comp-position joint.N.pos-cmd"),
        ("joint.1.motor-pos-fb", "joint.2.motor-pos-fb", "joint.1.motor-pos-fb"),
        ("addf comp-0-1-1 servo-thread", "addf comp-0-1-1 base-thread", "servo-thread"),
        ("\n", "\r\n", "control characters"),
        ("X (joint", "\N{GREEK CAPITAL LETTER CHI} (joint", "not ASCII"),
    )
