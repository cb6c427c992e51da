"""Klipper meshes: a hand-written section, the mesh applied in the test, what is refused."""

import configparser
import functools
import math
import os
from pathlib import Path

import numpy as np
import pytest
from contracts.dialect import DialectContract
from hypothesis import given, settings, strategies as st

from metrosep import controllers
from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.options import checked_options
from metrosep.controllers.reprap import Klipper
from metrosep.errors import CorruptFileError, DataError, LimitError, TableError

NOWHERE = Path(os.devnull)
ROUNDING = 1e-15
"""Heights of 10 um as decimals of mm in double."""
QUANTUM = 0.5e-12
"""Nine decimals of mm: half a picometre."""

HAND = """[bed_mesh metrosep]
version = 1
points =
  0.003000000, 0.000000000, -0.001000000
  0.000000000, -0.002000000, 0.000000001
x_count = 3
y_count = 2
mesh_x_pps = 0
mesh_y_pps = 0
algo = direct
tension = 0.2
min_x = 10
max_x = 50
min_y = -5
max_y = 20.5
"""
VALUES = [[3e-6, 0.0, -1e-6], [0.0, -2e-6, 1e-12]]


def encode(table, **options):
    dialect = Klipper()
    return dialect.encode(table, **checked_options(options, dialect.options, "klipper"))


def hand_map():
    return CompensationMap([10e-3, 30e-3, 50e-3], [-5e-3, 20.5e-3], VALUES)


def bumps(x, y):
    """+3 um at (12, 40) mm and -1 um at (20, 10) mm: neither mirror nor exchange keeps it."""
    return 3e-6 * np.exp(-(((x - 12e-3) / 8e-3) ** 2 + ((y - 40e-3) / 6e-3) ** 2)) - 1e-6 * np.exp(
        -(((x - 20e-3) / 6e-3) ** 2 + ((y - 10e-3) / 9e-3) ** 2)
    )


@functools.cache
def parsed(text):
    """The section and its points, by Python's own parser of such files."""
    config = configparser.RawConfigParser()
    config.read_string(text)
    mesh = config[config.sections()[0]]
    return mesh, [[float(v) for v in r.split(",")] for r in mesh["points"].strip().splitlines()]


def mesh_z(text, x, y):
    """Klipper's rule from its manual: height in mm."""
    mesh, rows = parsed(text)

    def cell(v, low, high, n):
        u = (v - low) / ((high - low) / (n - 1))
        i = min(max(math.floor(u), 0), n - 2)
        return i, min(max(u - i, 0.0), 1.0)

    i, s = cell(x, mesh.getfloat("min_x"), mesh.getfloat("max_x"), mesh.getint("x_count"))
    j, t = cell(y, mesh.getfloat("min_y"), mesh.getfloat("max_y"), mesh.getint("y_count"))
    low = rows[j][i] * (1 - s) + rows[j][i + 1] * s
    high = rows[j + 1][i] * (1 - s) + rows[j + 1][i + 1] * s
    return low * (1 - t) + high * t


def test_hand_written_section_is_written_byte_for_byte():
    assert encode(hand_map()).data.decode() == HAND


def test_hand_written_section_is_read():
    found = Klipper().decode(HAND.encode(), NOWHERE)

    assert found.values == pytest.approx(np.array(VALUES), abs=ROUNDING)
    assert found.x == pytest.approx([10e-3, 30e-3, 50e-3], abs=1e-15)
    assert found.y == pytest.approx([-5e-3, 20.5e-3], abs=1e-15)
    assert (found.axes, found.compensates) == (("X", "Y"), "Z")


def test_section_with_colons_comments_and_blank_lines_is_read():
    text = "# made by hand\n\n" + HAND.replace(" = ", ": ").replace("points =", "points:")

    assert Klipper().decode(text.encode(), NOWHERE).values[0, 0] == pytest.approx(3e-6, abs=1e-15)


def test_height_is_what_is_added_to_z():
    """An error of +3 um (too high) needs -0.003 mm: status RUN of the sign table."""
    error = CompensationMap.from_error(
        lambda x, y: 3e-6 * (x > 5e-3) + 0 * y, x=[0.0, 10e-3], y=[0.0, 10e-3]
    )

    assert b"points =\n  0.000000000, -0.003000000\n" in encode(error).data


def test_mesh_removes_the_error():
    x, y = np.linspace(0, 30e-3, 61), np.linspace(0, 60e-3, 121)
    text = encode(CompensationMap.from_error(bumps, x=x, y=y)).data.decode()
    rng = np.random.default_rng(5)
    places = rng.uniform(0, [30e-3, 60e-3], (300, 2))
    before = np.array([bumps(*p) for p in places])
    height = np.array([mesh_z(text, *(p * 1e3)) for p in places]) * 1e-3

    # 0.5 mm nodes on a bump of 6 mm: 3 um x 2 / 6^2 x 0.5^2 / 8 = 5 nm
    assert np.ptp(before + height) < 15e-9
    assert np.ptp(before - height) == pytest.approx(2 * np.ptp(before), abs=15e-9)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 8),
    m=st.integers(2, 8),
    size=st.floats(1e-9, 1e-4),
)
@settings(derandomize=True, deadline=None, max_examples=40)
def test_round_trip_and_lookup(seed, n, m, size):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.2, 0.2) + np.linspace(0, rng.uniform(0.01, 0.3), n)
    y = rng.uniform(-0.2, 0.2) + np.linspace(0, rng.uniform(0.01, 0.3), m)
    table = CompensationMap(x, y, size * rng.uniform(-1, 1, (m, n)))
    made = encode(table)
    lookup = Klipper().lookup(made.data, NOWHERE)
    places = rng.uniform(-0.5, 0.8, (30, 2))

    assert made.quantisation <= QUANTUM * 1.0001
    seen = lookup(*places.T)
    # positions are printed to 1 pm, the steepest slope is 2 size / 1 mm
    assert np.abs(seen - table.correction(*places.T)).max() < QUANTUM * 1.01 + 2e-9 * size
    by_hand = np.array([mesh_z(made.data.decode(), *(p * 1e3)) for p in places]) * 1e-3
    assert np.abs(seen - by_hand).max() < 1e-14 + 1e-12 * size


def test_write_read_simulate_with_uneven_nodes(tmp_path):
    path = tmp_path / "mesh.cfg"
    x = np.r_[0, 1.0, 3.0, np.arange(4, 31)] * 1e-3
    table = CompensationMap.from_error(bumps, x=x, y=np.linspace(0, 60e-3, 61))

    with pytest.raises(TableError, match="give x_spacing="):
        controllers.write(table, path, "klipper", allow_unverified=True)
    controllers.write(table, path, "klipper", allow_unverified=True, x_spacing="1 mm")

    found = controllers.read(path, "klipper")
    assert found.x.size == 31
    place = np.array([7.3e-3, 12e-3]), np.array([33e-3, 41e-3])
    assert found.correction(*place) == pytest.approx(table.correction(*place), abs=1e-12)
    seen = controllers.simulate(path, "klipper")(*place)
    assert seen == pytest.approx(table.correction(*place), abs=1e-12)


def test_it_says_that_moves_are_not_split():
    made = encode(hand_map())
    text = " ".join(f.problem for f in made.findings)

    assert "every 5 mm for changes of 25 um" in text
    assert "within a move they are not followed at all" in text
    tall = CompensationMap([0.0, 2e-3], [0.0, 2e-3], [[0, 50e-6], [0, 0]])
    words = " ".join(f.problem for f in encode(tall).findings)
    assert "not followed at all" not in words
    assert "nodes lie 2 mm apart, nearer than the 5 mm" in words


def test_options_keep_to_what_klipper_takes():
    with pytest.raises(DataError, match="split_delta_z"):
        encode(hand_map(), split_delta_z="5 um")
    with pytest.raises(DataError, match="move_check_distance"):
        encode(hand_map(), move_check_distance="1 mm")
    with pytest.raises(TableError, match="name of a mesh"):
        encode(hand_map(), profile="a]b")
    with pytest.raises(TableError, match="name of a mesh"):
        encode(hand_map(), profile="two words")
    assert encode(hand_map(), profile="steel").data.startswith(b"[bed_mesh steel]\n")


@pytest.mark.parametrize(
    ("axes", "target"), [(("Y", "X"), "Z"), (("X", "Z"), "Y"), (("X", "Y"), "X")]
)
def test_maps_of_other_axes_are_refused(axes, target):
    table = CompensationMap([0.0, 1e-3], [0.0, 1e-3], np.zeros((2, 2)), axes, target)

    with pytest.raises(TableError, match="corrects Z over X"):
        encode(table)


@pytest.mark.parametrize("gone", range(15))
def test_section_without_a_line_is_refused(gone):
    lines = HAND.splitlines()
    del lines[gone]

    with pytest.raises(CorruptFileError):
        Klipper().decode("\n".join(lines).encode(), NOWHERE)


def test_sign_is_confirmed():
    assert Klipper.info.sign == "confirmed"
    assert Klipper.info.entry.endswith("-e")


@pytest.mark.parametrize("name", ["a#b", "a;b", "a=b", "x" * 61, "sch\u00f6n"])
def test_name_that_klipper_would_cut_is_refused(name):
    """Its parser ends a line at # and ;, so the section would lose its bracket."""
    with pytest.raises(TableError, match="cannot be the name of a mesh"):
        encode(hand_map(), profile=name)


@pytest.mark.parametrize(("x", "c"), [(1e300, 1e-6), (0.1, 1e6)])
def test_units_that_are_mistaken_are_refused(x, c):
    with pytest.raises(LimitError, match=r"exceeds 1(000)? m; check the units"):
        encode(CompensationMap([0.0, x], [0.0, 0.1], [[0, 0], [0, c]]))


class TestKlipper(DialectContract):
    name = "klipper"
    hand = HAND
    damage = (
        ("version = 1", "version = 2"),
        ("algo = direct", "algo = bicubic"),
        ("mesh_x_pps = 0", "mesh_x_pps = 2"),
        ("0.003000000, ", ""),
        ("0.003000000", "high"),
        ("0.003000000", "nan"),
        ("0.003000000", "3e-3"),
        ("x_count = 3", "x_count = 4"),
        ("x_count = 3", "x_count = 3.0"),
        ("y_count = 2", "y_count = 1"),
        ("max_x = 50", "max_x = 10"),
        ("max_x = 50", "max_x = wide"),
        ("tension = 0.2", "tension = tight"),
        ("tension = 0.2", "tension = 0.2\ntension = 0.3"),
        ("tension = 0.2", "tension = 0.2\nfade = 1"),
        ("[bed_mesh metrosep]", "[bed_mesh]"),
        ("max_y = 20.5\n", "max_y = 20.5\n[bed_mesh b]\n"),
        ("direct", "dïrect"),
    )
