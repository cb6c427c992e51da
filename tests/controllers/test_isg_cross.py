"""ISG lists over one axis: examples of the documents, a small list reader of its own, refusals."""

import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import Profile, controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.isg import IsgAxis, IsgCross
from metrosep.controllers.options import checked_options
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignNotConfirmedError,
    TableError,
)

ROUNDING = 1e-15
"""0.1 um times whole numbers in double."""

CROSS = """\
kopf.achs_nr 3
kopf.log_achs_name Z
kw.crosscomp.unit 1
kw.crosscomp.last_index 2
kw.crosscomp.master_ax_nr 1
kw.crosscomp.n_cycles 10
kw.crosscomp.table[0].setpoint 0
kw.crosscomp.table[0].correction 0
kw.crosscomp.table[1].setpoint 50000
kw.crosscomp.table[1].correction 30
kw.crosscomp.table[2].setpoint 100000
kw.crosscomp.table[2].correction 0
"""
"""From the notes on controllers: +3 um at 5 mm of 10 mm, metrosep's own comment apart."""
CROSS_COMMENT = (
    "# metrosep: entry = -e in 0.1 um, sign not documented: dry-run on the machine first\n"
)

AXIS = """\
# metrosep: entry = +e in 0.1 um, sign not documented: dry-run on the machine first
kopf.achs_nr 2
kopf.log_achs_name Y
kw.ssfk.interval 0
kw.ssfk.kw_startpos 0
kw.ssfk.kw_nr_max 3
kw.ssfk.unit 1
kw.ssfk.bilateral 1
kw.ssfk.table[0].setpoint 0
kw.ssfk.table[1].setpoint 198667
kw.ssfk.table[2].setpoint 300000
kw.ssfk.table[0].pos 0
kw.ssfk.table[1].pos -102
kw.ssfk.table[2].pos 24
kw.ssfk.table[0].neg 0
kw.ssfk.table[1].neg 80
kw.ssfk.table[2].neg 67
"""
"""The documents' calculation: setpoint 19866.7 um, actual 19856.5 (pos), 19874.7 um (neg)."""


def axis(table, **given):
    known = checked_options({"axis_number": 2, **given}, IsgAxis.options, "isg-axis")
    return IsgAxis().encode(table, **known)


def cross(table, **given):
    given = {"axis_number": 3, "master_number": 1, **given}
    return IsgCross().encode(table, **checked_options(given, IsgCross.options, "isg-cross"))


def read_axis(data, **given):
    return IsgAxis().decode(data, Path("absent.lis"), **given)


def read_cross(data, **given):
    return IsgCross().decode(data, Path("absent.lis"), **given)


def entries_of(data):
    words = {}
    for line in data.decode().splitlines():
        if line and not line.startswith("#"):
            key, value = line.split()
            words[key] = value
    return words


def held(p, places, values):
    if p <= places[0]:
        return values[0]
    for i in range(len(places) - 1):
        if p <= places[i + 1]:
            s = (p - places[i]) / (places[i + 1] - places[i])
            return values[i] + s * (values[i + 1] - values[i])
    return values[-1]


def kernel_axis(data, mm, direction):
    """Error (mm) that the kernel takes out at a position: actual minus setpoint, per direction."""
    w = entries_of(data)
    n, step = int(w["kw.ssfk.kw_nr_max"]), float(w["kw.ssfk.interval"])
    start = float(w["kw.ssfk.kw_startpos"])
    places = [
        start + i * step if step else float(w[f"kw.ssfk.table[{i}].setpoint"]) for i in range(n)
    ]
    field = "pos" if direction > 0 else "neg"
    values = [float(w[f"kw.ssfk.table[{i}].{field}"]) for i in range(n)]
    return held(mm * 1e4, places, values) * 1e-4


def kernel_cross(data, mm):
    """What is added to the slave (mm) at a position of the master."""
    w = entries_of(data)
    n = int(w["kw.crosscomp.last_index"]) + 1
    places = [float(w[f"kw.crosscomp.table[{i}].setpoint"]) for i in range(n)]
    values = [float(w[f"kw.crosscomp.table[{i}].correction"]) for i in range(n)]
    return held(mm * 1e4, places, values) * 1e-4


def test_cross_example_byte_for_byte():
    table = CompensationTable([0, 5e-3, 10e-3], [0, 3e-6, 0], None, "X", "Z", 0.0)

    assert cross(table).data.decode() == CROSS_COMMENT + CROSS


def test_cross_example_reads_as_corrections():
    table = read_cross(CROSS.encode(), entry_sign=-1)

    np.testing.assert_allclose(table.positions, [0, 5e-3, 10e-3], atol=1e-17, rtol=0)
    np.testing.assert_allclose(table.forward, [0, 3e-6, 0], atol=ROUNDING, rtol=0)
    assert (table.compensates, table.reverse) == ("Z", None)


def test_axis_example_byte_for_byte():
    """Actual minus setpoint by hand: 19856.5 - 19866.7 = -10.2 um, 19874.7 - 19866.7 = +8.0 um."""
    p = [0, 19.8667e-3, 30e-3]
    table = CompensationTable(p, [0, 10.2e-6, -2.4e-6], [0, -8.0e-6, -6.7e-6], "Y", "Y", 0.0)

    assert axis(table).data.decode() == AXIS


def test_axis_example_reads_as_corrections():
    table = read_axis(AXIS.encode())

    np.testing.assert_allclose(table.positions, [0, 19.8667e-3, 30e-3], atol=1e-17, rtol=0)
    np.testing.assert_allclose(table.forward, [0, 10.2e-6, -2.4e-6], atol=ROUNDING, rtol=0)
    np.testing.assert_allclose(table.reverse, [0, -8.0e-6, -6.7e-6], atol=ROUNDING, rtol=0)
    assert (table.axis, table.compensates) == ("Y", "Y")


def test_equal_spacing_needs_no_setpoints():
    table = CompensationTable([-1e-3, 0, 1e-3], [1e-6, 0, -2e-6], None, "Y", "Y", 0.0)

    words = entries_of(axis(table).data)

    assert words["kw.ssfk.interval"] == "10000"
    assert words["kw.ssfk.kw_startpos"] == "-10000"
    assert "kw.ssfk.table[0].setpoint" not in words
    assert words["kw.ssfk.table[2].pos"] == words["kw.ssfk.table[2].neg"] == "20"
    back = read_axis(axis(table).data)
    assert back.reverse is None
    np.testing.assert_allclose(back.positions, table.positions, atol=1e-17, rtol=0)


def test_comments_of_both_kinds_and_blank_lines_are_taken():
    text = (
        CROSS_COMMENT
        + "/* list of\n kw.crosscomp.unit 7 */\n\n"
        + CROSS.replace("unit 1", "unit 1   /* 0.1 um */")
        .replace("n_cycles 10", "n_cycles 10 # smooth")
        .replace("\n", "\r\n")
    )

    assert read_cross(text.encode()).positions.size == 3


@pytest.mark.parametrize("sign", [1, -1])
def test_sign_is_that_of_the_option(sign):
    table = CompensationTable([0, 5e-3], [0, 3e-6], None, "X", "Z", 0.0)
    own = CompensationTable([0, 5e-3], [0, 3e-6], None, "X", "X", 0.0)

    a, b = cross(table, entry_sign=sign).data, axis(own, entry_sign=sign).data

    assert entries_of(a)["kw.crosscomp.table[1].correction"] == str(-30 * sign)
    assert entries_of(b)["kw.ssfk.table[1].pos"] == str(-30 * sign)
    assert read_cross(a).forward[1] == pytest.approx(3e-6, abs=ROUNDING)
    assert read_axis(b).forward[1] == pytest.approx(3e-6, abs=ROUNDING)


@given(
    steps=st.lists(st.floats(2e-6, 5e-2), min_size=1, max_size=30),
    start=st.floats(-0.5, 0.5),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["integer", "real"]),
    even=st.booleans(),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_quantisation_and_resampling(steps, start, seed, kind, even):
    rng = np.random.default_rng(seed)
    p = start + np.concatenate([[0.0], np.cumsum([steps[0]] * len(steps) if even else steps)])
    c, d = rng.uniform(-5e-6, 5e-6, (2, p.size))
    own = CompensationTable(p, c, d, "X", "X", float(p[0]))
    slave = CompensationTable(p, c, None, "X", "Z", float(p[0]))

    one, two = axis(own, number_type=kind), cross(slave, number_type=kind)

    at = rng.uniform(p[0] - 1e-2, p[-1] + 1e-2, 25)
    half = 0.5e-7 if kind == "integer" else 0.5e-13
    for encoded in (one, two):
        assert encoded.quantisation <= half * 1.001
        margin = encoded.quantisation + encoded.resampling_error + 1e-14
        for direction in (1, -1):
            if encoded is one:
                seen = [-1e-3 * kernel_axis(encoded.data, q * 1e3, direction) for q in at]
                wanted, back = own.correction(at, direction), read_axis(encoded.data)
            else:
                seen = [1e-3 * kernel_cross(encoded.data, q * 1e3) for q in at]
                wanted, back = slave.correction(at), read_cross(encoded.data)
            np.testing.assert_allclose(seen, wanted, atol=margin, rtol=0)
            np.testing.assert_allclose(
                back.correction(at, direction),
                seen,
                atol=1e-9 * 5e-6 / 2e-6 * 1e-3 + 1e-14,
                rtol=0,
            )


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bump, table):
    x = np.linspace(0, 50, 401)
    for direction in (1, -1):
        left = {}
        lost = 0.7e-6 if direction < 0 else 0.0
        for name, made in (("right", table), ("wrong", table.negated())):
            data = axis(made, number_type="real").data
            c = -1e-3 * np.array([kernel_axis(data, p, direction) for p in x])
            left[name] = np.abs(bump(x * 1e-3 + c) + lost - bump(0.0) + c).max()
        before = np.abs(bump(x * 1e-3) + lost - bump(0.0)).max()
        assert left["right"] < 0.03e-6  # chords of 0.5 mm over bumps 2 and 3 mm wide
        assert left["wrong"] > 1.9 * before


def test_written_only_when_the_sign_was_tried(tmp_path, table, measured):
    path = tmp_path / "achskw1.lis"
    with pytest.raises(SignNotConfirmedError, match="isg-axis"):
        controllers.write(table, path, "isg-axis", axis_number=1)

    done = controllers.write(
        table, path, "isg-axis", verified_against=measured, sign_confirmed=True, axis_number=1
    )

    assert done.after_pv < 0.05 * done.before_pv
    back = controllers.read(path, "isg-axis")
    assert np.abs(back.forward - table.forward).max() <= 0.5e-7 + ROUNDING
    assert np.abs(back.reverse - table.reverse).max() <= 0.5e-7 + ROUNDING
    with pytest.raises(CorruptFileError, match="another axis"):
        controllers.read(path, "isg-axis", axis_number=2)


def test_whole_numbers_are_too_coarse_for_nanometres(tmp_path):
    x = np.linspace(0.0, 50e-3, 101)
    fine = Profile(x, 0.3e-6 * np.sin(2 * np.pi * x / 50e-3))
    made = CompensationTable.from_error(fine, positions=x, axis="X")

    with pytest.raises(LimitError, match="steps of 100 nm"):
        controllers.write(made, tmp_path / "a.lis", "isg-axis", sign_confirmed=True, axis_number=1)
    controllers.write(
        made,
        tmp_path / "a.lis",
        "isg-axis",
        sign_confirmed=True,
        axis_number=1,
        number_type="real",
    )
    with pytest.raises(CorruptFileError, match="not a whole number"):
        controllers.read(tmp_path / "a.lis", "isg-axis", number_type="integer")


def test_knots_lie_where_the_error_needs_them():
    """A kink at 37 mm of 50 mm: 5 even points miss it, 5 knots do not."""
    x = np.linspace(0.0, 50e-3, 501)
    c = np.where(x < 37e-3, 0.0, (x - 37e-3) * 1e-3)
    table = CompensationTable(x, c, None, "X", "Z", 0.0)

    placed = cross(table, capacity=5, number_type="real")
    even = cross(table, capacity=5, number_type="real", interval=12.5e-3)

    assert placed.carried.positions.size == 5
    assert placed.resampling_error < 1e-10
    assert even.resampling_error > 1e-7
    assert np.abs(read_cross(placed.data).correction(x) - c).max() < 1e-10


def test_two_columns_of_too_many_points_are_spaced_evenly(table):
    encoded = axis(table, capacity=51)

    assert encoded.carried.positions.size == 51
    assert 0.0 < encoded.resampling_error < 0.2e-6
    with pytest.raises(LimitError, match="takes 51"):
        axis(table, capacity=51, interval=0.5e-3)


def test_written_with_more_points_than_the_controller_takes(tmp_path, bump):
    x = np.linspace(0.0, 50e-3, 401)
    made = CompensationTable.from_error(
        Profile(x, bump(x)), positions=x, axis="X", compensates="Z"
    )

    done = controllers.write(
        made,
        tmp_path / "a.lis",
        "isg-cross",
        sign_confirmed=True,
        axis_number=3,
        master_number=1,
        capacity=40,
        number_type="real",
    )

    assert done.after_pv < 0.03 * done.before_pv
    back = controllers.read(tmp_path / "a.lis", "isg-cross")
    assert (back.axis, back.compensates, back.positions.size) == ("X", "Z", 40)


def test_what_cannot_be_carried_is_refused(table):
    x = [0.0, 1e-3]
    with pytest.raises(TableError, match="controller='isg-cross'"):
        axis(CompensationTable(x, [0, 0], None, "X", "Z", 0.0))
    with pytest.raises(TableError, match="direction='both'"):
        cross(table)
    with pytest.raises(TableError, match="are the same"):
        cross(CompensationTable(x, [0, 0], None, "X", "Z", 0.0), master_number=3)
    with pytest.raises(TableError, match="not a name for a list"):
        axis(CompensationTable(x, [0, 0], None, "slide 1", "slide 1", 0.0))
    with pytest.raises(TableError, match="fall together"):
        cross(CompensationTable([0.0, 2e-8], [0, 0], None, "X", "Z", 0.0))
    with pytest.raises(LimitError, match="position 300 m of entry 1 exceeds 214 m"):
        cross(CompensationTable([0.0, 300.0], [0, 0], None, "X", "Z", 0.0))


def test_numbers_of_the_axes_are_asked_for(tmp_path, table):
    with pytest.raises(DataError, match="axis_number"):
        controllers.write(table, tmp_path / "a.lis", "isg-axis", sign_confirmed=True)
    with pytest.raises(DataError, match="entry_sign"):
        read_cross(CROSS.encode())


def test_unilateral_leadscrew_list_is_refused():
    with pytest.raises(CorruptFileError, match="bilateral"):
        read_axis(AXIS.replace("bilateral 1", "bilateral 0").encode())


def test_no_exponents():
    table = CompensationTable([0, 1e-6, 1.0], [0, 1e-12, -1e-3], None, "X", "Z", 0.0)

    values = entries_of(cross(table, number_type="real").data).values()

    assert all(re.fullmatch(r"-?[0-9]+(\.[0-9]{6})?|Z", v) for v in values)


def test_list_of_more_points_than_the_kernel_takes_is_refused():
    text = (CROSS_COMMENT + CROSS).replace("last_index 2", "last_index 9999999")
    with pytest.raises(LimitError, match=r"10000000 points.*takes 1001.*P-COMP-00060.*capacity="):
        read_cross(text.encode())
    with pytest.raises(LimitError, match="takes 2"):
        read_axis(AXIS.encode(), capacity=2)


def test_table_of_the_axis_itself_is_no_cross_compensation():
    """Names say X -> X, numbers 1 -> 3: one of them is wrong."""
    own = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "X", "X", 0.0)

    with pytest.raises(TableError, match="X -> X; write controller='isg-axis'"):
        cross(own)


def test_name_of_the_master_must_fit(tmp_path):
    text = (CROSS_COMMENT + CROSS).replace("log_achs_name Z", "log_achs_name X")
    with pytest.raises(DataError, match=r"corrects X over another axis.*master_name="):
        read_cross(text.encode())
    made = read_cross(text.encode(), master_name="Y")
    assert (made.axis, made.compensates) == ("Y", "X")
    with pytest.raises(CorruptFileError, match="so has its master"):
        read_cross((CROSS_COMMENT + CROSS).replace("achs_nr 3", "achs_nr 1").encode())
    table = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "Y", "Z", 0.0)
    with pytest.raises(TableError, match="looked up over Y"):
        cross(table, master_name="X")
    path = tmp_path / "a.lis"
    path.write_text(CROSS_COMMENT + CROSS)
    beside = path.with_name("a.lis.json")
    beside.write_text(json.dumps({"table": {"axis": "Y", "compensates": "Z"}}))
    assert controllers.read(path, "isg-cross").axis == "Y"
    with pytest.raises(DataError, match="its sidecar says master_name='Y', you say"):
        controllers.read(path, "isg-cross", master_name="X")
    beside.write_text(json.dumps({"table": {"axis": "Y", "compensates": "W"}}))
    with pytest.raises(DataError, match="the file says the corrected axis='Z', its sidecar"):
        controllers.read(path, "isg-cross")


@pytest.mark.parametrize("option", [{"entry_sign": 1}, {"cycles": 11}])
def test_option_that_contradicts_the_list_is_refused(tmp_path, option):
    with pytest.raises(DataError, match=r"the file says .*you say"):
        read_cross((CROSS_COMMENT + CROSS).encode(), **option)
    path = tmp_path / "a.lis"
    path.write_text(CROSS_COMMENT + CROSS)
    path.with_name("a.lis.json").write_text(json.dumps({"options": option}))
    with pytest.raises(DataError, match="the file says"):
        controllers.read(path, "isg-cross")


def test_two_comments_that_contradict_each_other_are_refused():
    other = CROSS_COMMENT.replace("-e", "+e")

    with pytest.raises(CorruptFileError, match="two comments contradict each other"):
        read_cross((CROSS_COMMENT + other + CROSS).encode())
    assert read_cross((CROSS_COMMENT + CROSS_COMMENT + CROSS).encode()).forward[1] == 3e-6


def test_room_for_more_points_is_reserved_in_the_list():
    """last_index < max_points (P-COMP-00060); kw_nr_max < max_points (P-COMP-00020)."""
    x = np.arange(1502) * 1e-4
    slave = CompensationTable(x, 1e-6 * np.sin(x * 40), None, "X", "Z", 0.0)
    own = CompensationTable(x, 1e-6 * np.sin(x * 40), None, "X", "X", 0.0)

    for encoded, structure in (
        (cross(slave, capacity=1502), "crosscomp"),
        (axis(own, capacity=1502), "ssfk"),
    ):
        words = entries_of(encoded.data)
        reserved = int(words[f"kw.{structure}.max_points"])
        used = int(words.get("kw.ssfk.kw_nr_max", words.get("kw.crosscomp.last_index")))
        assert used < reserved == (1502 if structure == "crosscomp" else 1503)
        back = (read_cross if structure == "crosscomp" else read_axis)(encoded.data)
        assert back.positions.size == 1502
    assert "max_points" not in cross(slave, capacity=20, interval=10e-3).data.decode()
    both = CompensationTable(x, own.forward, 0.5 * own.forward, "X", "X", 0.0)
    assert int(entries_of(axis(both).data)["kw.ssfk.kw_nr_max"]) == 1499


def test_reserved_room_of_the_list_counts():
    small = (CROSS_COMMENT + CROSS).replace("unit 1", "max_points 2\nkw.crosscomp.unit 1")
    with pytest.raises(LimitError, match="3 points, the kernel takes 2"):
        read_cross(small.encode())
    usual = (CROSS_COMMENT + CROSS).replace("unit 1", "max_points 0\nkw.crosscomp.unit 1")
    assert read_cross(usual.encode()).positions.size == 3


def test_comments_that_are_not_closed_cost_no_time():
    start = time.perf_counter()
    with pytest.raises(CorruptFileError, match="line 1: the comment /\\* is not closed"):
        read_cross(b"/*\n" * 200_000, entry_sign=-1)
    assert time.perf_counter() - start < 2.0  # quadratic it took minutes


def test_sign_within_another_comment_and_blocks_with_hashes_are_passed_over():
    text = "/* # metrosep: old */\n" + CROSS_COMMENT + CROSS.replace("10\n", "10 # /* open\n", 1)

    assert read_cross(text.encode()).forward[1] == pytest.approx(3e-6, abs=ROUNDING)


def test_interval_beyond_the_table_is_refused():
    table = CompensationTable([0.0, 1e-3, 2e-3], [0, 1e-6, 0], None, "X", "Z", 0.0)

    with pytest.raises(LimitError, match=r"larger than the table, which spans 2 mm"):
        cross(table, interval=3e-3)


def test_list_on_the_page_is_whole(repository):
    page = (repository / "docs" / "controllers" / "twincat.md").read_text("utf-8")

    assert f"```text\n{CROSS}```" in page


class TestIsgCross(DialectContract):
    name = "isg-cross"
    hand = CROSS_COMMENT + CROSS
    reading = (("master_name", "X"),)
    lines = (
        "",
        "hello",
        "kw.other 1",
        "kopf.achs_nr",
        "a.b 1e3",
    )
    damage = (
        ("setpoint 50000", "setpoint 0"),
        ("setpoint 50000", "setpoint 200000"),
        ("last_index 2", "last_index 1"),
        ("last_index 2", "last_index 0"),
        ("last_index 2", "last_index 3"),
        ("unit 1", "unit 0"),
        ("correction 30", "correction 3000000000"),
        ("correction 30", "correction nan"),
        ("correction 30", "correction 3,0"),
        ("table[1].setpoint", "table[0].setpoint"),
        ("kopf.achs_nr 3", "kopf.achs_nr 3 /* open"),
        ("log_achs_name Z", "log_achs_name Z\nkw.crosscomp.modulo 1"),
    )


class TestIsgAxis(DialectContract):
    name = "isg-axis"
    hand = AXIS
    lines = (
        "",
        "hello",
        "kw.other 1",
        "kopf.achs_nr",
        "a.b 1e3",
    )
