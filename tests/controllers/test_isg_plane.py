"""ISG plane lists: a hand-made one whose corners all differ, a reader of its own, refusals."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.isg import IsgPlane
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

HAND = """\
# metrosep: entry = -e in 0.1 um, sign not documented: dry-run on the machine first
kopf.achs_nr 3
kopf.log_achs_name Z
kw.crosscomp2.unit 1
kw.crosscomp2.interval 50000
kw.crosscomp2.last_index_master1 2
kw.crosscomp2.last_index_master2 1
kw.crosscomp2.start_position_master1 -50000
kw.crosscomp2.start_position_master2 20000
kw.crosscomp2.master1_ax_nr 1
kw.crosscomp2.master2_ax_nr 2
kw.crosscomp2.n_cycles 10
kw.crosscomp2.table[0][0].correction 10
kw.crosscomp2.table[0][1].correction 0
kw.crosscomp2.table[0][2].correction -20
kw.crosscomp2.table[1][0].correction 30
kw.crosscomp2.table[1][1].correction 5
kw.crosscomp2.table[1][2].correction 0
"""
"""The first index counts the second master axis (P-COMP-00016): rows are y."""

GRID = (np.array([-5.0, 0.0, 5.0]) * 1e-3, np.array([2.0, 7.0]) * 1e-3)
VALUES = np.array([[1.0, 0.0, -2.0], [3.0, 0.5, 0.0]]) * 1e-6


NUMBERS = {"axis_number": 3, "master1_number": 1, "master2_number": 2}


def encode(made, **given):
    known = checked_options({**NUMBERS, **given}, IsgPlane.options, "isg-plane")
    return IsgPlane().encode(made, **known)


def decode(data, **given):
    return IsgPlane().decode(data, Path("absent.lis"), **given)


def kernel(data, x_mm, y_mm):
    """What is added to the slave (mm): bilinear, held at the edges, from the entries themselves."""
    w = dict(line.split() for line in data.decode().splitlines() if line[0] != "#")
    step = float(w["kw.crosscomp2.interval"])
    at = []
    for i, p in ((1, x_mm), (2, y_mm)):
        last = int(w[f"kw.crosscomp2.last_index_master{i}"])
        t = (p * 1e4 - float(w[f"kw.crosscomp2.start_position_master{i}"])) / step
        t = min(max(t, 0.0), float(last))
        k = min(int(t), last - 1)
        at.append((k, t - k))
    (i, s), (j, t) = at

    def entry(row, column):
        return float(w[f"kw.crosscomp2.table[{row}][{column}].correction"]) * 1e-4

    low = entry(j, i) * (1 - s) + entry(j, i + 1) * s
    high = entry(j + 1, i) * (1 - s) + entry(j + 1, i + 1) * s
    return low * (1 - t) + high * t


@pytest.fixture(scope="module")
def bump_map():
    """Error of +3 um at (12, 20) mm and -1 um at (30, 8) mm of 40 x 25 mm."""

    def error(x, y):
        first = 3e-6 * np.exp(-(((x - 12e-3) / 4e-3) ** 2) - ((y - 20e-3) / 5e-3) ** 2)
        return first - 1e-6 * np.exp(-(((x - 30e-3) / 5e-3) ** 2) - ((y - 8e-3) / 4e-3) ** 2)

    return error


def test_hand_made_list_byte_for_byte():
    assert encode(CompensationMap(*GRID, VALUES)).data.decode() == HAND


def test_hand_made_list_reads_as_the_map():
    made = decode(HAND.encode())

    np.testing.assert_allclose(made.x, GRID[0], atol=1e-17, rtol=0)
    np.testing.assert_allclose(made.y, GRID[1], atol=1e-17, rtol=0)
    np.testing.assert_allclose(made.values, VALUES, atol=ROUNDING, rtol=0)
    assert (made.axes, made.compensates) == (("X", "Y"), "Z")


@pytest.mark.parametrize(
    ("x", "y", "um"),
    [(-5, 2, 1), (5, 2, -2), (-5, 7, 3), (5, 7, 0), (-2.5, 2, 0.5), (0, 4.5, 0.25), (-9, 9, 3)],
)
def test_lookup(tmp_path, x, y, um):
    path = tmp_path / "a.lis"
    path.write_text(HAND)

    seen = controllers.simulate(path, "isg-plane")(x * 1e-3, y * 1e-3)

    assert seen == pytest.approx(um * 1e-6, abs=ROUNDING)
    assert kernel(HAND.encode(), x, y) == pytest.approx(um * 1e-3, abs=1e-12)


@given(
    n=st.integers(2, 9),
    m=st.integers(2, 9),
    start=st.floats(-0.2, 0.2),
    ratio=st.sampled_from([1.0, 2.0, 1.5]),
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from(["integer", "real"]),
    sign=st.sampled_from([1, -1]),
)
@settings(derandomize=True, deadline=None, max_examples=40)
def test_round_trip_is_within_quantisation_and_resampling(n, m, start, ratio, seed, kind, sign):
    rng = np.random.default_rng(seed)
    x = round(start, 7) + 4e-3 * np.arange(n)
    y = -round(start, 7) + 4e-3 * ratio * np.arange(m)
    made = CompensationMap(x, y, rng.uniform(-5e-6, 5e-6, (m, n)))

    encoded = encode(made, number_type=kind, entry_sign=sign)

    assert encoded.quantisation <= (0.5e-7 if kind == "integer" else 0.5e-13) * 1.001
    if ratio != 1.5:
        assert encoded.resampling_error < 1e-14
    ax = rng.uniform(x[0] - 5e-3, x[-1] + 5e-3, 20)
    ay = rng.uniform(y[0] - 5e-3, y[-1] + 5e-3, 20)
    seen = [
        -sign * 1e-3 * kernel(encoded.data, p * 1e3, q * 1e3) for p, q in zip(ax, ay, strict=True)
    ]
    margin = encoded.quantisation + encoded.resampling_error + 1e-14
    np.testing.assert_allclose(seen, made.correction(ax, ay), atol=margin, rtol=0)
    np.testing.assert_allclose(decode(encoded.data).correction(ax, ay), seen, atol=1e-14, rtol=0)


def test_planted_error_shrinks_and_the_negated_map_doubles_it(bump_map):
    x, y = np.arange(0, 41) * 1e-3, np.arange(0, 26) * 1e-3
    made = CompensationMap(x, y, -bump_map(x, y[:, None]))
    places = [(p, q) for p in np.arange(0, 40.1, 1.7) for q in np.arange(0, 25.1, 1.3)]
    e = np.array([bump_map(p * 1e-3, q * 1e-3) for p, q in places])
    left = {}
    swapped = CompensationMap(x[:26], y, -bump_map(x[:26], y[:, None]).T)
    for name, one in (("right", made), ("wrong", made.negated()), ("swapped", swapped)):
        data = encode(one).data
        left[name] = np.ptp(e + np.array([kernel(data, p, q) for p, q in places]) * 1e-3)

    assert left["right"] < 0.1 * np.ptp(e)
    assert left["wrong"] > 1.9 * np.ptp(e)
    assert left["swapped"] > np.ptp(e)


def test_write_read(tmp_path, bump_map):
    x, y = np.arange(0, 41) * 1e-3, np.arange(0, 26) * 1e-3
    made = CompensationMap.from_error(lambda p, q: bump_map(p, q) - bump_map(0.0, 0.0), x=x, y=y)
    path = tmp_path / "a.lis"
    with pytest.raises(SignNotConfirmedError):
        controllers.write(made, path, "isg-plane", **NUMBERS)

    controllers.write(made, path, "isg-plane", sign_confirmed=True, **NUMBERS)

    back = controllers.read(path, "isg-plane")
    assert np.abs(back.values - made.values).max() <= 0.5e-7 + ROUNDING
    assert (back.axes, back.compensates, back.reference) == (("X", "Y"), "Z", made.reference)
    with pytest.raises(CorruptFileError, match="must not be swapped"):
        controllers.read(path, "isg-plane", master1_number=2)


def test_table_of_one_axis_is_refused(tmp_path, table):
    with pytest.raises(TableError, match="CompensationMap"):
        controllers.write(table, tmp_path / "a.lis", "isg-plane", sign_confirmed=True, **NUMBERS)


def test_what_cannot_be_carried_is_refused():
    made = CompensationMap(*GRID, VALUES)
    with pytest.raises(TableError, match="axis C turns"):
        encode(CompensationMap(*GRID, VALUES, axes=("X", "C")))
    with pytest.raises(TableError, match="both master axes"):
        encode(made, master2_number=1)
    with pytest.raises(TableError, match="do not say the same"):
        encode(made, axis_number=1)
    with pytest.raises(TableError, match="do not say the same"):
        encode(CompensationMap(*GRID, VALUES, compensates="X"))
    with pytest.raises(LimitError, match=r"3 x 2 points.*takes 5"):
        encode(made, capacity=5)
    with pytest.raises(LimitError, match="interval="):
        encode(made, interval=1e-7)
    with pytest.raises(TableError, match="not a multiple"):
        encode(made, interval=2.5e-7)
    with pytest.raises(DataError, match="entry_sign"):
        decode(HAND.split("\n", 1)[1].encode())


def test_coarser_interval_is_resampled_and_its_error_told():
    x, y = np.arange(5) * 1e-3, np.arange(3) * 1e-3
    values = np.zeros((3, 5))
    values[1, 1] = 2e-6

    encoded = encode(CompensationMap(x, y, values), interval=2e-3)

    assert encoded.resampling_error == pytest.approx(2e-6, abs=ROUNDING)
    assert encoded.carried.values.shape == (2, 3)


def test_no_exponents():
    made = CompensationMap(*GRID, VALUES * 1e-6)

    text = encode(made, number_type="real").data.decode()

    assert not re.search(r"\d[eE][-+]?\d", text)


def test_list_of_more_points_than_the_kernel_takes_is_refused():
    with pytest.raises(LimitError, match=r"takes 10201.*capacity="):
        decode(HAND.replace("last_index_master2 1", "last_index_master2 9999").encode())


def test_room_along_an_axis():
    """Both last indices up to 100 where max_points is not given: 101 x 101 = 10201 points."""
    x, y = np.arange(201) * 1e-3, np.arange(21) * 1e-3
    values = 1e-6 * np.sin(40 * x) * (1 + y[:, None])
    long = CompensationMap(x, y, values)

    with pytest.raises(LimitError, match=r"201 x 21 points.*101 along each axis.*capacity=4221"):
        encode(long)
    data = encode(long, capacity=4221).data
    assert b"kw.crosscomp2.max_points 4221\n" in data
    assert decode(data).values.shape == (21, 201)
    bare = data.replace(b"kw.crosscomp2.max_points 4221\n", b"")
    with pytest.raises(LimitError, match="201 points, the kernel takes 101, along an axis"):
        decode(bare)
    square = CompensationMap(x[:101], y, values[:, :101])
    assert b"max_points" not in encode(square).data
    assert b"max_points" not in encode(square, capacity=5000).data


def test_interval_beyond_the_map_is_refused():
    """x spans 10 mm, y 5 mm: 6 mm would hold one row."""
    made = CompensationMap(*GRID, VALUES)

    for interval in (6e-3, 100.0):
        with pytest.raises(LimitError, match=r"larger than the table, which spans"):
            encode(made, interval=interval)


def test_border_of_a_map_is_kept(tmp_path):
    values = np.zeros((4, 5))
    values[1:-1, 1:-1] = 2e-6
    x, y = np.arange(5) * 1e-3, np.arange(4) * 1e-3
    made = CompensationMap(x, y, values, border="zero")

    controllers.write(
        made,
        tmp_path / "a.lis",
        "isg-plane",
        sign_confirmed=True,
        allow_unverified=True,
        **NUMBERS,
    )

    assert controllers.read(tmp_path / "a.lis", "isg-plane").border == "zero"


@pytest.mark.parametrize(
    "table",
    [None, 5, {"axes": ["C", "X"], "reference_si": [0, 0]}, {"axes": ["X", "X"]}, {"axes": ["X"]}],
)
def test_sidecar_of_something_else_is_refused(tmp_path, table):
    path = tmp_path / "a.lis"
    path.write_text(HAND)
    path.with_name("a.lis.json").write_text(json.dumps({"table": table}))

    with pytest.raises(CorruptFileError, match="sidecar"):
        controllers.read(path, "isg-plane")


def test_numbers_and_names_of_the_axes_must_fit():
    with pytest.raises(CorruptFileError, match="numbers and names"):
        decode(HAND.replace("log_achs_name Z", "log_achs_name X").encode())
    with pytest.raises(CorruptFileError, match="numbers and names"):
        decode(HAND.replace("kopf.achs_nr 3", "kopf.achs_nr 2").encode())
    with pytest.raises(CorruptFileError, match="numbers and names"):
        decode(HAND.replace("master2_ax_nr 2", "master2_ax_nr 1").encode())


def test_option_that_contradicts_the_list_is_refused():
    for option in ({"entry_sign": 1}, {"cycles": 11}):
        with pytest.raises(DataError, match=r"the file says .*you say"):
            decode(HAND.encode(), **option)


def test_errors_of_the_plane_compensation_are_told_right():
    """70182 and 70183 are reactions of class 7 and 3: the axis stops."""
    text = " ".join(IsgPlane.info.activation)
    assert "70182 and 70183 stop the axis" in text
    assert "without a stop" not in text


class TestIsgPlane(DialectContract):
    name = "isg-plane"
    hand = HAND
    lines = (
        "",
        "hello",
        "kw.other 1",
        "a.b 1e3",
    )
    damage = (
        ("interval 50000", "interval 0"),
        ("interval 50000", "interval -1"),
        ("last_index_master1 2", "last_index_master1 1"),
        ("last_index_master2 1", "last_index_master2 0"),
        ("table[1][2]", "table[2][1]"),
        ("unit 1", "unit 0"),
    )
