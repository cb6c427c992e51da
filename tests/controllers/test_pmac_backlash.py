"""Turbo PMAC BLCOMP: sign, Ixx86, pairs of files, an interpreter of the manual's rule."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.options import checked_options
from metrosep.controllers.pmac_backlash import PMACBacklash
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    ReadError,
    SignCheckFailedError,
    TableError,
)

COUNT = 10e-9
ROUNDING = 1e-15
"""m; corrections of um in double: far below."""
NOWHERE = Path("/nonexistent/x.pmc")

HAND = """DELETE GATHER
#1 DELETE BLCOMP
#1 DEFINE BLCOMP 4,4000000
160 -320 480 0
I186=1120
I51=1
SAVE
"""
TOLD = {"count": COUNT, "source_sign": 1, "motor_zero": 0.0}
"""What that file does not say of the machine."""
HAND_LOST_UM = [0.7, 0.8, 0.5, 1.0, 0.7]
"""e_rev - e_fwd at 0, 10, 20, 30, 40 mm: 1120 sixteenths of 10 nm are 0.7 um."""


def interpret(text, count):
    """Return what the manual subtracts while the motor moves negative; no code of the library."""
    code = re.sub(r";.*", "", text).upper()
    define = re.search(r"#(\d+)\s*DEFINE BLCOMP (\d+),(\d+)\n", code)
    motor, n, span = (int(g) for g in define.groups())
    words = code[define.end() :].split()
    table = [0, *map(int, words[:n])]
    constant = int(re.search(rf"\nI{motor}86=(\d+)\n", code)[1])

    def subtracted(position):
        u = position / count % span * n / span
        k = int(u)
        return (constant + table[k] + (u - k) * (table[min(k + 1, n)] - table[k])) / 16 * count

    return np.vectorize(subtracted)


def encode(table, **options):
    dialect = PMACBacklash()
    return dialect.encode(table, **checked_options(options, dialect.options, "pmac-backlash"))


def without_comments(data):
    return "".join(
        line + "\n" for line in data.decode("ascii").splitlines() if not line.startswith(";")
    )


def hand_table():
    p = np.arange(5) * 10e-3
    e_fwd = np.array([0.0, 2.0, -1.0, 3.0, 0.0]) * 1e-6
    e_rev = e_fwd + np.array(HAND_LOST_UM) * 1e-6
    return CompensationTable(p, -e_fwd, -e_rev, "X", "X", 0.0)


def test_hand_made_file_is_written_to_the_byte():
    encoded = encode(hand_table(), count="10 nm", span="40 mm")

    assert without_comments(encoded.data) == HAND.removesuffix("SAVE\n")
    assert encoded.quantisation <= ROUNDING
    assert encoded.resampling_error <= ROUNDING
    assert encoded.notes["I186"] == 1120


def test_hand_made_file_reads_as_the_difference():
    table = PMACBacklash().decode(HAND.encode(), NOWHERE, **TOLD)

    assert not table.forward.any()
    np.testing.assert_allclose(
        table.reverse, -np.array(HAND_LOST_UM) * 1e-6, atol=ROUNDING, rtol=0
    )


def test_simulator_subtracts_while_moving_negative():
    look = PMACBacklash().lookup(HAND.encode(), NOWHERE, **TOLD)

    seen = look(np.array([10e-3, 10e-3, -10e-3, 15e-3, 0.0]), np.array([1, -1, -1, -1, -1]))

    np.testing.assert_allclose(
        seen, [0.0, -0.8e-6, -1.0e-6, -0.65e-6, -0.7e-6], atol=1e-13, rtol=0
    )
    with pytest.raises(DataError, match="direction"):
        look(0.0, 0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shift", [0.0, -20e-3, -50e-3])
def test_with_the_forward_table_both_directions_are_corrected(tmp_path, bump, sign, shift):
    """Forward file and difference file, each interpreted by hand, add up to both corrections."""

    def forward(x):
        return bump(x - shift) - bump(-shift)

    def reverse(x):
        return forward(x) + 0.7e-6 + 0.2e-6 * np.sin((x - shift) / 8e-3)

    p = np.linspace(0.0, 50e-3, 101) + shift
    both = CompensationTable.from_error(
        forward, reverse=reverse, positions=p, axis="X", reference=0.0
    )
    data = encode(both, count=COUNT, source_sign=sign).data
    subtracted = interpret(data.decode(), COUNT)(sign * p)

    base = both.forward if sign > 0 else both.reverse
    motor_negative = sign * base - subtracted  # in the direction of the motor's counts
    wanted = both.reverse if sign > 0 else both.forward
    np.testing.assert_allclose(sign * motor_negative, wanted, atol=COUNT / 16, rtol=0)
    look = PMACBacklash().lookup(data, NOWHERE)
    for d in (1, -1):
        added = base + look(p, d)
        np.testing.assert_allclose(
            added, both.forward if d > 0 else both.reverse, atol=COUNT / 16, rtol=0
        )


def test_pair_of_files_passes_the_dry_run_and_a_wrong_sign_does_not(tmp_path, bump):
    p = np.linspace(0.0, 50e-3, 101)
    both = CompensationTable.from_error(
        bump, reverse=lambda x: bump(x) + 0.7e-6 + 20e-6 * x, positions=p, axis="X"
    )
    one = CompensationTable.from_error(bump, positions=p, axis="X", direction="both")
    controllers.write(one, tmp_path / "comp.pmc", "pmac", count="10 nm", source_motor=1)

    result = controllers.write(
        both, tmp_path / "back.pmc", "pmac-backlash", count="10 nm", motor=1,
        comp=str(tmp_path / "comp.pmc"), rate=16,
    )  # fmt: skip

    assert result.passed
    assert result.lost_motion is not None
    text = (tmp_path / "back.pmc").read_text()
    assert "I185=16\n" in text
    assert "I186=1120\n" in text
    pair = controllers.simulate(
        tmp_path / "back.pmc", "pmac-backlash", comp=str(tmp_path / "comp.pmc")
    )
    for d in (1, -1):
        np.testing.assert_allclose(pair(p, d), both.correction(p, d), atol=COUNT / 8, rtol=0)
    swapped = CompensationTable(p, both.reverse, both.forward, "X", "X", 0.0)
    with pytest.raises(LimitError, match="check which runs are forward"):
        encode(swapped, count=COUNT)


def test_alone_it_does_not_pass_the_dry_run(tmp_path, table):
    with pytest.raises(TableError, match=r"pointless|does not shrink"):
        controllers.write(table, tmp_path / "x.pmc", "pmac-backlash", count="10 nm", motor=1)
    assert any("comp=" in f.fix for f in encode(table, count=COUNT).findings)


def test_mean_table_besides_is_noticed(tmp_path, bump):
    p = np.linspace(0.0, 50e-3, 101)
    both = CompensationTable.from_error(
        bump, reverse=lambda x: bump(x) + 100e-6 * x, positions=p, axis="X"
    )
    mean = CompensationTable.from_error(lambda x: bump(x) + 50e-6 * x, positions=p, axis="X")
    path = tmp_path / "comp.pmc"
    controllers.write(mean, path, "pmac", count="10 nm", source_motor=1)

    findings = encode(both, count=COUNT, comp=str(path)).findings

    assert any("direction='forward'" in f.fix for f in findings)


def test_missing_table_besides_is_refused(tmp_path, table):
    with pytest.raises(ReadError, match="no such file"):
        encode(table, count=COUNT, comp=str(tmp_path / "none.pmc"))


@given(
    start=st.floats(-0.2, 0.2),
    steps=st.lists(st.floats(1e-4, 2e-2), min_size=1, max_size=20),
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(1e-9, 1e-5),
)
@settings(derandomize=True, deadline=None, max_examples=50)
def test_round_trip_is_within_quantisation_and_resampling(start, steps, seed, size):
    rng = np.random.default_rng(seed)
    p = start + np.concatenate([[0.0], np.cumsum(steps)])
    forward = size * rng.uniform(-1, 1, p.size)
    lost = size * rng.uniform(0, 1, p.size)
    table = CompensationTable(p, forward, forward - lost, "X", "X", float(p[0]))

    encoded = encode(table, count=COUNT, long_span=True)

    x = np.linspace(p[0], p[-1], 301)
    # a position within 1e-6 of a step of a node is that node
    bound = encoded.quantisation + encoded.resampling_error + 2e-6 * size + 1e-15
    wanted = np.interp(x, p, lost)
    assert encoded.quantisation <= 1.52 * COUNT / 32 + 1e-15  # Ixx86 at zero is rounded, too
    assert np.abs(interpret(encoded.data.decode(), COUNT)(x) - wanted).max() <= bound
    back = PMACBacklash().decode(encoded.data, NOWHERE)
    assert not back.forward.any()
    assert np.abs(back.correction(x, -1) + wanted).max() <= bound


def test_one_direction_and_cross_axis_are_refused():
    one = CompensationTable([0.0, 1e-3], [0.0, 1e-6], None, "X", "X", 0.0)
    cross = CompensationTable([0.0, 1e-3], [0.0, 1e-6], [0.0, 0.0], "X", "Z", 0.0)

    with pytest.raises(TableError, match="needs forward and reverse"):
        encode(one, count=COUNT)
    with pytest.raises(TableError, match="its own axis"):
        encode(cross, count=COUNT)


@pytest.mark.parametrize(
    ("options", "kind", "text"),
    [
        ({"span": "39 mm"}, TableError, "shorter than the travel"),
        ({"count": "1 nm"}, LimitError, "long_span"),
        ({"rate": 0}, DataError, "rate"),
        ({"first": "1 mm"}, TableError, "first="),
        ({"count": None}, DataError, "count="),
    ],
)
def test_bad_options(options, kind, text):
    with pytest.raises(kind, match=text):
        encode(hand_table(), **{"count": COUNT, **options})


def pair(tmp_path, bump, **forward):
    """The table of both directions, and a file of forward corrections beside it."""
    p = np.linspace(0.0, 50e-3, 101)
    both = CompensationTable.from_error(
        bump, reverse=lambda x: bump(x) + 0.7e-6 + 20e-6 * x, positions=p, axis="X"
    )
    names = {k: forward.pop(k) for k in ("axis", "compensates") if k in forward}
    one = CompensationTable.from_error(
        bump, positions=p, reference=forward.pop("reference", 0.0), **{"axis": "X", **names}
    )
    path = tmp_path / "comp.pmc"
    controllers.write(one, path, "pmac", **{"count": "10 nm", "source_motor": 1, **forward})
    return both, path


@pytest.mark.parametrize(
    ("forward", "text"),
    [
        ({"axis": "Y"}, "its axis is Y"),
        ({"source_motor": 2}, "its owner is 2"),
        ({"owner": 4}, "its owner is 4"),
        (
            {"axis": "X", "compensates": "Z", "target_motor": 3, "owner": 1},
            "its target_motor is 3",
        ),
        ({"source_sign": -1}, "its source_sign is -1"),
        ({"motor_zero": "50 mm", "reference": 50e-3}, "its motor_zero is 0.05"),
        ({"count": "20 nm"}, "its count is 2e-08"),
    ],
)
def test_table_besides_must_be_that_of_the_motor(tmp_path, bump, forward, text):
    """A file of motor 2 of Y passed the dry-run of motor 1 of X."""
    both, path = pair(tmp_path, bump, **forward)

    with pytest.raises(TableError, match=text):
        controllers.write(
            both, tmp_path / "b.pmc", "pmac-backlash", count="10 nm", motor=1, comp=str(path)
        )
    assert not (tmp_path / "b.pmc").exists()


def test_table_besides_that_was_edited_or_exchanged_is_refused(tmp_path, bump):
    both, path = pair(tmp_path, bump)
    back = tmp_path / "b.pmc"
    controllers.write(both, back, "pmac-backlash", count="10 nm", motor=1, comp=str(path))
    controllers.simulate(back, "pmac-backlash")

    whole = path.read_bytes()
    path.write_bytes(whole.replace(b"DEFINE COMP", b"DEFINE  COMP"))
    with pytest.raises(CorruptFileError, match="cut short, edited"):
        controllers.simulate(back, "pmac-backlash")
    path.with_name(path.name + ".json").unlink()
    with pytest.raises(CorruptFileError, match="written with"):
        controllers.simulate(back, "pmac-backlash")


def test_a_count_that_is_a_length_is_not_taken_for_an_angle():
    angle = np.linspace(0.0, 6.0, 7)
    table = CompensationTable(angle, 0 * angle, 0 * angle - 1e-6, "C", "C", 0.0)

    with pytest.raises(DataError, match=r"count='1 um'.*C turns"):
        encode(table, count="1 um")


@pytest.mark.parametrize("name", ["source_sign", "motor_zero"])
def test_comment_that_was_dropped_is_asked_for(name):
    data = encode(hand_table(), count=COUNT, source_sign=-1, motor_zero=40e-3).data
    lines = data.splitlines(keepends=True)
    data = b"".join(line for line in lines if not line.startswith(f"; {name} =".encode()))

    with pytest.raises(DataError, match=rf"states {name} \("):
        PMACBacklash().lookup(data, NOWHERE)


@pytest.mark.parametrize(("name", "value"), [("count", 1e-9), ("source_sign", -1), ("motor", 2)])
def test_option_that_contradicts_the_file_is_refused(name, value):
    data = encode(hand_table(), count=COUNT).data

    with pytest.raises(DataError, match=rf"{name}=.*{name}="):
        PMACBacklash().decode(data, NOWHERE, **{name: value})


def already_forward():
    """Forward is compensated to nm, the reverse direction is 1 um and a slope off."""
    p = np.linspace(0.0, 50e-3, 51)
    left = np.random.default_rng(1).normal(0.0, 5e-9, 51)

    def forward(x):
        return np.interp(x, p, left)

    return CompensationTable.from_error(
        forward, reverse=lambda x: forward(x) + 1e-6 + 2e-5 * x, positions=p, axis="X"
    )


def test_where_forward_is_compensated_the_lost_motion_alone_is_judged(tmp_path):
    table, path = already_forward(), tmp_path / "b.pmc"
    controllers.write(table, path, "pmac-backlash", count="10 nm", motor=1, forward_active=True)

    judged = json.loads(path.with_name("b.pmc.json").read_text())["verification"]
    assert judged["before_m"] == pytest.approx(2e-6, abs=1e-8)
    assert judged["after_m"] <= COUNT / 8
    assert judged["wrong_sign_m"] == pytest.approx(4e-6, abs=2e-8)


def test_lost_motion_that_would_grow_is_refused():
    table = already_forward()
    other = dataclasses.replace(table.negated(), source=table.source)  # e_rev - e_fwd as -1 um

    with pytest.raises((LimitError, SignCheckFailedError), match=r"lost motion|Ixx86"):
        encode(other, count=COUNT, forward_active=True)
    flat = CompensationTable(
        table.positions, table.forward, table.forward - 8e-6, "X", "X", 0.0, source=table.source
    )
    with pytest.raises(SignCheckFailedError, match="lost motion: 2 um -> 7 um"):
        encode(flat, count=COUNT, forward_active=True)
    with pytest.raises(TableError, match="say one of them"):
        encode(table, count=COUNT, forward_active=True, comp="x.pmc")


class TestPMACBacklash(DialectContract):
    name = "pmac-backlash"
    hand = HAND
    reading = TOLD
    whole = "SAVE\n"
    damage = (
        ("I186=1120\n", "", "I186"),
        ("I186=1120", "I286=1120", "does not belong"),
        ("I186=1120", "I186=99999999", "I186"),
        ("I186=1120", "I186=-5", "does not belong"),
        ("I186=1120", "I186=1120\nI185=0", "rate is 0"),
        ("I186=1120", "I186=1120\nI186=1121", "does not belong"),
        ("I51=1\n", "", "I51"),
        ("480 0", "480 1", "jump"),
        ("480 0", "480", "3 of 4"),
        ("BLCOMP 4", "BLCOMP 3", "3 entries"),
        ("BLCOMP 4,", "COMP 4,", "DEFINE line"),
        ("4000000", "3", "not a table"),
    )
