"""HEIDENHAIN value tables: a hand-written one, a small reader of its own, what is refused."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.heidenhain import Heidenhain
from metrosep.controllers.options import checked_options
from metrosep.errors import (
    CorruptFileError,
    DataError,
    LimitError,
    SignCheckFailedError,
    SignNotConfirmedError,
    TableError,
    WriteError,
)

ROUNDING = 1e-15
"""Millimetres to metres in double."""

HAND = (
    "BEGIN Y_Y.COM MM\r\n"
    "NR    AXISPOS         BACKLASH        Y\r\n"
    "0     -90.0000        0.0005          0.0000\r\n"
    "1     -85.0000        0.0035          0.0030\r\n"
    "2     -80.0000        -0.0005         -0.0010\r\n"
    "[END]\r\n"
)
"""Axis 3 um too far at -85 mm, 1 um short at -80 mm; 0.5 um more while moving in - direction."""

SAG = (
    "BEGIN Y_Z.COM MM\r\n"
    "NR    AXISPOS         BACKLASH        Z\r\n"
    "0     -90.0000                        0.0000\r\n"
    "1     -85.0000                        0.0030\r\n"
    "[END]\r\n"
)


def encode(table, **given):
    return Heidenhain().encode(table, **checked_options(given, Heidenhain.options, "heidenhain"))


def decode(data, **given):
    return Heidenhain().decode(data, Path("absent.com"), **{"entry_sign": 1, **given})


def control(data, mm, direction):
    """Error (mm) that the control takes out: straight between lines, held beyond, by direction."""
    rows = [line.split() for line in data.decode().split("\r\n")[2:-2]]
    places = [float(r[1]) for r in rows]
    values = [float(r[2] if direction < 0 and len(r) == 4 else r[-1]) for r in rows]
    if mm <= places[0]:
        return values[0]
    for i in range(len(rows) - 1):
        if mm <= places[i + 1]:
            s = (mm - places[i]) / (places[i + 1] - places[i])
            return values[i] + s * (values[i + 1] - values[i])
    return values[-1]


def test_hand_written_table_byte_for_byte():
    x = np.array([-90, -85, -80]) * 1e-3
    e, r = np.array([0, 3e-6, -1e-6]), np.array([0.5e-6, 3.5e-6, -0.5e-6])

    assert encode(CompensationTable(x, -e, -r, "Y", "Y", -0.09)).data.decode() == HAND
    sag = CompensationTable(x[:2], -e[:2], None, "Y", "Z", -0.09)
    assert encode(sag).data.decode() == SAG


def test_hand_written_table_reads_as_corrections():
    table = decode(HAND.encode())

    np.testing.assert_allclose(
        table.positions, np.array([-90, -85, -80]) * 1e-3, atol=1e-16, rtol=0
    )
    np.testing.assert_allclose(table.forward, [0, -3e-6, 1e-6], atol=ROUNDING, rtol=0)
    np.testing.assert_allclose(table.reverse, [-0.5e-6, -3.5e-6, 0.5e-6], atol=ROUNDING, rtol=0)
    assert (table.axis, table.compensates) == ("Y", "Y")
    sag = decode(SAG.encode())
    assert (sag.axis, sag.compensates, sag.reverse) == ("Y", "Z", None)


@pytest.mark.parametrize(
    ("mm", "direction", "um"),
    [(-99, 1, 0), (-87.5, 1, -1.5), (-85, 1, -3), (-85, -1, -3.5), (0, 1, 1), (0, -1, 0.5)],
)
def test_lookup(tmp_path, mm, direction, um):
    path = tmp_path / "y.com"
    path.write_bytes(HAND.encode())

    seen = controllers.simulate(path, "heidenhain", entry_sign=1)(mm * 1e-3, direction)

    assert seen == pytest.approx(um * 1e-6, abs=ROUNDING)
    assert -control(HAND.encode(), mm, direction) == pytest.approx(um * 1e-3, abs=1e-12)


def test_sign_is_that_of_the_option():
    table = CompensationTable([0.0, 1e-3], [0, -3e-6], None, "X", "X", 0.0)

    other = encode(table, entry_sign=-1).data

    assert b"-0.0030" in other
    assert decode(other, entry_sign=-1).forward[1] == pytest.approx(-3e-6, abs=ROUNDING)
    with pytest.raises(DataError, match="entry_sign"):
        Heidenhain().decode(other, Path("absent.com"))


@given(
    n=st.integers(2, 40),
    start=st.floats(-0.5, 0.5),
    step=st.floats(1e-4, 2e-2),
    seed=st.integers(0, 2**32 - 1),
    resolution=st.sampled_from([1e-6, 1e-7, 1e-8, 1e-9]),
    split=st.booleans(),
    even=st.booleans(),
)
@settings(derandomize=True, deadline=None, max_examples=60)
def test_round_trip_is_within_quantisation_and_resampling(
    n, start, step, seed, resolution, split, even
):
    rng = np.random.default_rng(seed)
    gaps = np.full(n, round(step, 7)) if even else rng.uniform(0.5, 1.0, n) * step
    x = start + np.concatenate([[0.0], np.cumsum(gaps)])
    c, d = rng.uniform(-5e-6, 5e-6, (2, n + 1))
    table = CompensationTable(x, c, d if split else None, "X", "X", float(x[0]))

    encoded = encode(table, resolution=resolution)

    assert encoded.quantisation <= resolution / 2 * 1.001
    at = rng.uniform(x[0] - 1e-2, x[-1] + 1e-2, 25)
    margin = encoded.quantisation + encoded.resampling_error + 1e-14
    back = decode(encoded.data)
    for direction in (1, -1):
        seen = [-1e-3 * control(encoded.data, p * 1e3, direction) for p in at]
        np.testing.assert_allclose(seen, table.correction(at, direction), atol=margin, rtol=0)
        np.testing.assert_allclose(back.correction(at, direction), seen, atol=1e-14, rtol=0)


def test_planted_error_shrinks_and_the_negated_table_doubles_it(bump, table):
    x = np.linspace(0, 50, 401)
    for direction, lost in ((1, 0.0), (-1, 0.7e-6)):
        left = {}
        for name, made in (("right", table), ("wrong", table.negated())):
            data = encode(made).data
            c = -1e-3 * np.array([control(data, p, direction) for p in x])
            left[name] = np.abs(bump(x * 1e-3 + c) + lost - bump(0.0) + c).max()
        assert left["right"] < 0.09e-6  # half of 0.1 um and chords of 0.5 mm
        assert left["wrong"] > 1.9 * np.abs(bump(x * 1e-3) + lost - bump(0.0)).max()


def test_written_only_when_the_sign_was_tried(tmp_path, table, measured):
    path = tmp_path / "x.com"
    with pytest.raises(SignNotConfirmedError, match="heidenhain"):
        controllers.write(table, path, "heidenhain")

    done = controllers.write(
        table, path, "heidenhain", verified_against=measured, sign_confirmed=True
    )

    assert done.after_pv < 0.05 * done.before_pv
    back = controllers.read(path, "heidenhain")
    assert np.abs(back.forward - table.forward).max() <= 0.5e-7 + ROUNDING
    assert np.abs(back.reverse - table.reverse).max() <= 0.5e-7 + ROUNDING
    with pytest.raises(WriteError, match="exists already"):
        controllers.write(table, path, "heidenhain", sign_confirmed=True)


def test_points_are_limited_to_256():
    x = np.arange(257) * 1e-3

    assert decode(encode(CompensationTable(x[:256], 0 * x[:256], None, "X", "X", 0.0)).data)
    table = CompensationTable(x, 0 * x, None, "X", "X", 0.0)
    with pytest.raises(LimitError, match=r"257 points.*takes 256.*interval="):
        encode(table)
    assert decode(encode(table, interval="2 mm").data).positions.size == 129
    text = "BEGIN X.COM MM\r\n" + HAND.split("\r\n")[1].replace("Y", "X") + "\r\n"
    text += "".join(f"{i:<6d}{i:<16.4f}{'':16s}0.0000\r\n" for i in range(257)) + "[END]\r\n"
    with pytest.raises(LimitError, match="257 lines"):
        decode(text.encode())


def test_what_cannot_be_carried_is_refused(table):
    x = [0.0, 1e-3]
    with pytest.raises(TableError, match="not a HEIDENHAIN axis"):
        encode(CompensationTable(x, [0, 0], None, "slide", "slide", 0.0))
    with pytest.raises(TableError, match=r"BACKLASH belongs to X.*X -> Z"):
        encode(CompensationTable(x, [0, 0], [0, 1e-6], "X", "Z", 0.0))
    with pytest.raises(DataError, match="power of ten"):
        encode(table, resolution=2e-7)
    with pytest.raises(TableError, match="not a multiple"):
        encode(table, interval=0.25e-7)
    with pytest.raises(LimitError, match="of entry 1 exceeds 9 m"):
        encode(CompensationTable(x, [0, 10.0], None, "X", "X", 0.0))


def test_steep_neighbours_are_warned_of():
    """1/64 of 1 mm is 15.6 um."""
    for um, n in ((15.0, 0), (16.0, 1)):
        table = CompensationTable([0.0, 1e-3], [0, um * 1e-6], None, "X", "X", 0.0)
        assert len(encode(table).findings) == n


def test_name_without_axes_keeps_the_axis_of_the_sidecar():
    text = HAND.replace("BEGIN Y_Y", "BEGIN AXY")

    assert decode(text.encode()).compensates == "Y"


UNNAMED = SAG.replace("BEGIN Y_Z", "BEGIN AXISY")


def test_name_that_does_not_tell_the_axis_is_asked_for():
    """A column Z in AXISY.COM is the sag of Z over Y, and not of Z over X."""
    with pytest.raises(DataError, match=r"does not state over which axis.*looked_up_axis="):
        decode(UNNAMED.encode())
    made = decode(UNNAMED.encode(), looked_up_axis="Y")
    assert (made.axis, made.compensates) == ("Y", "Z")


def test_backlash_tells_that_the_axis_is_its_own():
    text = HAND.replace("BEGIN Y_Y", "BEGIN AXISY").encode()

    assert decode(text).axis == "Y"
    with pytest.raises(DataError, match="BACKLASH says"):
        decode(text, looked_up_axis="X")


def test_axis_that_contradicts_the_name_is_refused():
    with pytest.raises(DataError, match="the file says"):
        decode(SAG.encode(), looked_up_axis="X")
    with pytest.raises(TableError, match="looked_up_axis"):
        encode(CompensationTable([0.0, 1e-3], [0, 0], None, "X", "X", 0.0), looked_up_axis="Y")


def test_sign_that_contradicts_the_sidecar_is_refused(tmp_path, table):
    path = tmp_path / "x.com"
    controllers.write(table, path, "heidenhain", sign_confirmed=True)

    with pytest.raises(DataError, match=r"its sidecar says entry_sign=1, you say entry_sign=-1"):
        controllers.read(path, "heidenhain", entry_sign=-1)
    sidecar = path.with_name("x.com.json")
    changed = sidecar.read_text().replace('"entry_sign": 1', '"entry_sign": -1')
    assert changed != sidecar.read_text()
    sidecar.write_text(changed)
    with pytest.raises(CorruptFileError, match="contradicts the corrections in its sidecar"):
        controllers.read(path, "heidenhain")


def test_table_of_another_axis_warns_that_only_one_is_active():
    sag = CompensationTable([0.0, 1e-3], [0, 1e-6], None, "X", "Z", 0.0)

    (finding,) = encode(sag).findings
    assert "switches off a table X -> X" in finding.problem
    assert any("exclude each other" in step for step in Heidenhain.info.activation)
    with pytest.raises(CorruptFileError, match="cannot be read"):
        decode(HAND.replace("        Y\r", "        Y               Z\r").encode())


def test_interval_beyond_the_table_is_refused():
    table = CompensationTable([0.0, 1e-3, 2e-3], [0, 1e-6, 0], None, "X", "X", 0.0)

    with pytest.raises(LimitError, match=r"larger than the table, which spans 2 mm"):
        encode(table, interval=3e-3)


def test_columns_that_would_touch_are_refused():
    far = CompensationTable([-20.0, -10.0], [0, 1e-6], None, "X", "X", -20.0)

    assert encode(far, resolution=1e-9).data
    with pytest.raises(LimitError, match=r"-20000\.000000000 leaves no gap"):
        encode(far, resolution=1e-12)
    with pytest.raises(LimitError, match="of entry 1 exceeds"):
        encode(CompensationTable([0.0, 1e6], [0, 1e-6], None, "X", "X", 0.0))


# ---- several dependent axes over one axis are columns of one file ------------------------------------

COLUMNS = (
    "BEGIN Y_Y_Z.COM MM\r\n"
    "NR    AXISPOS         BACKLASH        Y               Z\r\n"
    "0     -90.0000        0.0005          0.0000          0.0000\r\n"
    "1     -85.0000        0.0035          0.0030          -0.0020\r\n"
    "2     -80.0000        -0.0005         -0.0010         0.0040\r\n"
    "[END]\r\n"
)
"""The axis of HAND, and Z 2 um too low at -85 mm, 4 um too high at -80 mm."""


def own_and_sag(sag_error=(0.0, -2e-6, 4e-6), at=(-90, -85, -80)):
    x = np.array([-90, -85, -80]) * 1e-3
    e, r = np.array([0, 3e-6, -1e-6]), np.array([0.5e-6, 3.5e-6, -0.5e-6])
    own = CompensationTable(x, -e, -r, "Y", "Y", -0.09, is_exact_inverse=True)
    sag = CompensationTable(
        np.array(at) * 1e-3, -np.array(sag_error), None, "Y", "Z", at[0] * 1e-3
    )
    return own, sag


def write_columns(tables, path, **options):
    more = {"sign_confirmed": True, "allow_unverified": True, **options}
    return controllers.write(tables, path, "heidenhain", **more)


def test_columns_of_one_file_byte_for_byte_and_back(tmp_path):
    path = tmp_path / "y.com"
    write_columns([*own_and_sag()], path)

    assert path.read_bytes().decode() == COLUMNS
    for made in own_and_sag():
        back = controllers.read(path, "heidenhain", column=made.compensates)
        assert (back.axis, back.compensates, back.reference) == ("Y", made.compensates, -0.09)
        assert float(np.abs(back.forward - made.forward).max()) < ROUNDING
        lookup = controllers.simulate(path, "heidenhain", column=made.compensates)
        for mm in (-99.0, -88.0, -85.0, -81.0, 0.0):
            for way in (1, -1):
                wanted = float(made.correction(mm * 1e-3, way)[0])
                assert float(lookup(mm * 1e-3, way)) == pytest.approx(wanted, rel=0, abs=ROUNDING)
    with pytest.raises(DataError, match=r"a column for each of Y, Z; choose one with column="):
        controllers.read(path, "heidenhain")
    with pytest.raises(DataError, match=r"no column 'X'"):
        controllers.read(path, "heidenhain", column="X")


def test_columns_without_a_sidecar_read_by_their_name(tmp_path):
    path = tmp_path / "y.com"
    path.write_bytes(COLUMNS.encode())
    sag = controllers.read(path, "heidenhain", column="Z", entry_sign=1)
    assert (sag.axis, sag.compensates, sag.reverse) == ("Y", "Z", None)
    own = controllers.read(path, "heidenhain", column="Y", entry_sign=1)
    assert own.reverse[1] == pytest.approx(-3.5e-6, rel=0, abs=ROUNDING)


def test_columns_are_judged_one_by_one_and_the_sidecar_keeps_each(tmp_path):
    x = np.linspace(0.0, 50e-3, 51)
    own = lambda p: 3e-6 * np.sin(p / 9e-3)  # noqa: E731
    sag = lambda p: 2e-6 * (1 - np.cos(p / 6e-3))  # noqa: E731
    tables = [
        CompensationTable.from_error(own, positions=x, axis="X"),
        CompensationTable.from_error(sag, positions=x, axis="X", compensates="Z"),
    ]
    path = tmp_path / "x.com"
    options = {"resolution": "10 nm", "sign_confirmed": True}
    done = controllers.write(tables, path, "heidenhain", verified_against=[own, sag], **options)

    assert [d.passed for d in done] == [True, True]
    beside = json.loads((tmp_path / "x.com.json").read_text())
    assert [*beside["columns"]] == ["X", "Z"]
    assert beside["columns"]["Z"]["table"]["compensates"] == "Z"
    assert beside["file_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert "never writes" in beside["columns"]["X"]["cma"]
    problems = [f["problem"] for part in beside["columns"].values() for f in part["findings"]]
    assert not any("switches off" in p for p in problems)
    with pytest.raises(SignCheckFailedError):  # one bad column stops the file
        controllers.write(
            [tables[0], tables[1].negated()], tmp_path / "y.com", "heidenhain",
            verified_against=[own, sag], **options,
        )  # fmt: skip
    with pytest.raises(DataError, match="a list of 2"):
        controllers.write(tables, path, "heidenhain", verified_against=own, **options)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.com", "x.com.json"]


def test_columns_that_do_not_belong_together_are_refused(tmp_path):
    own, sag = own_and_sag()
    path = tmp_path / "y.com"
    with pytest.raises(TableError, match=r"positions for Y and Z are not the same"):
        write_columns([own, own_and_sag(at=(-90, -80, -70))[1]], path)
    with pytest.raises(TableError, match=r"two tables correct Z"):
        write_columns([sag, sag], path)
    other = CompensationTable(own.positions, sag.forward, None, "X", "Z", -0.09)
    with pytest.raises(TableError, match=r"looked up over X, Y"):
        write_columns([own, other], path)
    with pytest.raises(TableError, match=r"linuxcnc holds one table in a file; write 2 files"):
        controllers.write([own, own], path, "linuxcnc", allow_unverified=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("        Y               Z\r", "        Z               Z\r", "the same name: Z, Z"),
        ("BEGIN Y_Y_Z", "BEGIN Y_Z_Y", "name and column"),
        ("-0.0020", "", "cannot be read"),
        ("0.0035 ", "       ", "BACKLASH is empty here"),
    ],
)
def test_damaged_columns_are_refused(old, new, words):
    assert old in COLUMNS
    with pytest.raises(CorruptFileError, match=words):
        decode(COLUMNS.replace(old, new, 1).encode(), column="Y")


def test_the_file_of_assignments_is_never_written(tmp_path):
    config = tmp_path / "config.CMA"
    config.write_text("of the control")
    with pytest.raises(TableError, match=r"\.CMA assigns tables to axes"):
        write_columns([*own_and_sag()], config, overwrite=True)
    with pytest.raises(TableError, match=r"\.CMA assigns tables to axes"):
        write_columns(own_and_sag()[0], config, overwrite=True)
    assert config.read_text() == "of the control"


class TestHeidenhain(DialectContract):
    name = "heidenhain"
    hand = HAND
    reading = (("entry_sign", 1),)
    end = "\r\n"
    lines = (
        "",
        "hello",
        "1     -85.0000",
        "NR",
        "9     1.0 1.0 1.0",
    )
    damage = (
        ("-85.0000", "-95.0000"),
        ("-85.0000", "-84.0000"),
        ("-85.0000", "-90.0000"),
        ("0.0030", "0,0030"),
        ("0.0030", "3e-3  "),
        ("0.0030", "nan   "),
        ("0.0035 ", "       "),
        (" MM", " INCH"),
        ("BEGIN Y_Y", "BEGIN Y_Z"),
        ("        Y\r", "        Y       Z\r"),
        ("AXISPOS", "POSAXIS"),
    )
