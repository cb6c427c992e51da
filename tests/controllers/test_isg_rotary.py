"""kw.ssfk of an axis that turns: 0.0001 deg, modulo; read by a parser of the documents (P-COMP-00019 to -00024)."""

import re

import numpy as np
import pytest
from controllers.turning import error, table

from metrosep import controllers
from metrosep.compensation import CompensationMap, CompensationTable
from metrosep.errors import MetrosepError, TableError

UNIT = np.deg2rad(1e-4)
HALF = 0.5 * UNIT * (1 + 1e-6)
"""Half an entry, and the rounding of doubles."""
EXACT = UNIT * 1e-4
"""REAL64 lists print 0.1 pm of 0.1 um: six decimals of a step; a hundred times that."""


def settings(text):
    """Return the keys and numbers of a list, as the start-up of the kernel reads them."""
    plain = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    rows = (line.partition("#")[0].split() for line in plain.splitlines())
    return {r[0]: r[1] for r in rows if len(r) == 2}


def added(found, degrees, direction):
    """Return what the kernel takes off, in 0.0001 deg, so minus the error of the list."""
    n = int(found["kw.ssfk.kw_nr_max"])
    start, step = float(found["kw.ssfk.kw_startpos"]), float(found["kw.ssfk.interval"])
    name = "pos" if direction > 0 else "neg"
    values = [float(found[f"kw.ssfk.table[{i}].{name}"]) for i in range(n)]
    place = (degrees * 1e4 - start) / step
    place = place % (n - 1) if found.get("kw.ssfk.modulo") == "1" else min(max(place, 0), n - 1)
    i = min(int(place), n - 2)
    return -(values[i] + (place - i) * (values[i + 1] - values[i]))


def written(tmp_path, made, **options):
    path = tmp_path / "c.lis"
    controllers.write(
        made,
        path,
        "isg-axis",
        axis_number=4,
        sign_confirmed=True,
        allow_unverified=True,
        **options,
    )
    return path


def test_integers_are_those_of_the_specification(tmp_path):
    path = written(tmp_path, table(), number_type="integer", modulo=True)

    found = settings(path.read_text())
    ring = [int(found[f"kw.ssfk.table[{i}].pos"]) for i in range(13)]
    assert ring == [0, 5, -2, -9, -11, -12, -20, -35, -51, -55, -41, -18, 0]
    assert found["kw.ssfk.kw_nr_max"] == "13"
    assert found["kw.ssfk.kw_startpos"] == "0"
    assert found["kw.ssfk.interval"] == "300000"
    assert found["kw.ssfk.modulo"] == "1"
    assert "entry = +e in 0.0001 deg" in path.read_text()  # the comment tells the unit too


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("kind", "bound"), [("integer", HALF), ("real", EXACT)])
def test_round_trip_over_three_turns(tmp_path, direction, kind, bound):
    made = table(lag=2.3)
    path = written(tmp_path, made, number_type=kind, modulo=True)
    found, lookup = settings(path.read_text()), controllers.simulate(path, "isg-axis")

    for degrees in np.linspace(-360, 720, 433):
        wanted = made.correction(np.deg2rad(degrees % 360.0), direction)[0]
        assert abs(added(found, degrees, direction) * UNIT - wanted) < bound
        assert abs(float(lookup(np.deg2rad(degrees), direction)) - wanted) < bound


def test_part_of_a_turn_is_an_ordinary_table_that_holds_its_ends(tmp_path):
    angles = np.deg2rad(np.linspace(-90, 90, 19))
    made = CompensationTable(angles, -error(angles), None, "B", "B", 0.0, is_exact_inverse=True)
    path = written(tmp_path, made, number_type="integer")
    found = settings(path.read_text())

    assert "kw.ssfk.modulo" not in found
    for degrees in np.linspace(-180, 180, 61):
        wanted = made.correction(np.deg2rad(degrees))[0]
        assert abs(added(found, degrees, 1) * UNIT - wanted) < HALF
    back = controllers.read(path, "isg-axis")
    assert back.axis == "B"
    assert np.abs(back.positions - angles).max() < HALF


def test_what_does_not_close_or_is_of_the_other_kind_is_refused(tmp_path):
    made = table()
    net = CompensationTable(
        made.positions,
        made.forward + made.positions * 1e-5,
        None,
        "C",
        "C",
        0.0,
        is_exact_inverse=True,
    )
    short = CompensationTable(made.positions[:-1], made.forward[:-1], None, "C", "C", 0.0)
    straight = CompensationTable([0.0, 0.1, 0.2], [0.0, 1e-6, 0.0], None, "X", "X", 0.0)
    with pytest.raises(TableError, match=r"differs by 12\.96 arcsec"):
        written(tmp_path, net, modulo=True)
    with pytest.raises(TableError, match=r"one turn, this one covers 0 \.\.\. 330 deg"):
        written(tmp_path, short, modulo=True)
    with pytest.raises(TableError, match=r"X is linear"):
        written(tmp_path, straight, modulo=True)
    with pytest.raises(MetrosepError, match=r"interval='5 mm'.*C turns"):
        written(tmp_path, made, modulo=True, interval="5 mm")
    assert list(tmp_path.iterdir()) == []


def test_damaged_ring_is_refused(tmp_path):
    path = written(tmp_path, table(), number_type="integer", modulo=True)
    text = path.read_text()
    path.with_suffix(".lis.json").unlink()
    path.write_text(text.replace("table[12].pos 0", "table[12].pos 7"))
    with pytest.raises(MetrosepError, match=r"first value equal to the last"):
        controllers.read(path, "isg-axis")


def test_interval_is_an_angle_that_divides_the_turn(tmp_path):
    path = written(tmp_path, table(step=10), number_type="integer", modulo=True, interval="40 deg")
    found = settings(path.read_text())
    assert found["kw.ssfk.interval"] == "400000"
    assert found["kw.ssfk.kw_nr_max"] == "10"
    coarse = np.round(-table(step=40).forward / UNIT)
    entries = [int(found[f"kw.ssfk.table[{i}].pos"]) for i in range(10)]
    assert entries == coarse.astype(int).tolist()
    with pytest.raises(MetrosepError, match=r"one turn is 5\.14285714 intervals of 70 deg"):
        written(tmp_path, table(step=10), modulo=True, interval="70 deg", overwrite=True)


def cross_written(tmp_path, made, **options):
    path = tmp_path / "x.lis"
    more = {"axis_number": 3, "master_number": 1, "number_type": "integer", **options}
    controllers.write(made, path, "isg-cross", sign_confirmed=True, allow_unverified=True, **more)
    return path


def cross_added(found, setpoint):
    """Return the correction of the slave at a setpoint of the master, each in 0.0001 of its unit."""
    n = int(found["kw.crosscomp.last_index"]) + 1
    p = [float(found[f"kw.crosscomp.table[{i}].setpoint"]) for i in range(n)]
    c = [float(found[f"kw.crosscomp.table[{i}].correction"]) for i in range(n)]
    return float(np.interp(setpoint, p, c))


STEP = 1e-7
"""0.1 um in m."""


@pytest.mark.parametrize(
    ("axis", "slave", "at", "size", "along", "entry"),
    [
        ("C", "X", np.deg2rad(np.arange(0, 271, 15)), 2e-6, UNIT, STEP),  # wobble of a table
        ("X", "C", np.arange(0, 0.181, 0.01), 40 * UNIT, STEP, UNIT),  # yaw put into the table
        ("A", "C", np.deg2rad(np.arange(-90, 91, 15)), 40 * UNIT, UNIT, UNIT),
    ],
)
def test_mixed_pairs_each_in_its_own_unit(tmp_path, axis, slave, at, size, along, entry):
    values = size * np.sin(3 * at / np.ptp(at)) * (at != 0)
    made = CompensationTable(at, values, None, axis, slave, 0.0, is_exact_inverse=True)
    path = cross_written(tmp_path, made)
    found, lookup = settings(path.read_text()), controllers.simulate(path, "isg-cross")

    assert f"in {'0.0001 deg' if entry == UNIT else '0.1 um'}," in path.read_text()
    for place in np.linspace(at[0] - 0.1, at[-1] + 0.1, 67):
        wanted = made.correction(place)[0]
        for sign in (1, -1):
            bound = 0.5 * entry * (1 + 1e-6)
            assert abs(cross_added(found, place / along) * entry - wanted) < bound
            assert abs(float(lookup(place, sign)) - wanted) < bound
    (tmp_path / "x.lis.json").unlink()
    back = controllers.read(path, "isg-cross", master_name=axis, entry_sign=-1)
    assert float(np.abs(back.positions - at).max()) < 0.5 * along
    assert float(np.abs(back.forward - values).max()) <= 0.5 * entry * (1 + 1e-6)
    assert (back.axis, back.compensates) == (axis, slave)


def test_interval_of_a_pair_is_along_the_master(tmp_path):
    at = np.deg2rad(np.arange(0, 271, 15))
    made = CompensationTable(at, 2e-6 * np.sin(at), None, "C", "X", 0.0, is_exact_inverse=True)
    path = cross_written(tmp_path, made, interval="45 deg")
    assert settings(path.read_text())["kw.crosscomp.table[1].setpoint"] == "450000"
    with pytest.raises(MetrosepError, match=r"interval='5 mm'.*C turns"):
        cross_written(tmp_path, made, interval="5 mm", overwrite=True)


def test_plane_of_a_slave_that_turns(tmp_path):
    x, y = np.arange(0, 0.031, 0.01), np.arange(0, 0.041, 0.02)
    values = 30 * UNIT * np.outer(1 + y / 0.03, np.sin(x / 0.02))
    made = CompensationMap(x, y, values, ("X", "Y"), "C", (0.0, 0.0), is_exact_inverse=True)
    path = tmp_path / "p.lis"
    numbers = {"axis_number": 3, "master1_number": 1, "master2_number": 2}
    controllers.write(
        made, path, "isg-plane", sign_confirmed=True, allow_unverified=True, **numbers
    )
    found, lookup = settings(path.read_text()), controllers.simulate(path, "isg-plane")
    assert found["kw.crosscomp2.interval"] == "100000"
    for row, place in enumerate(np.arange(0, 0.041, 0.01)):
        for column, along in enumerate(x):
            entry = int(found[f"kw.crosscomp2.table[{row}][{column}].correction"])
            wanted = float(made.correction(along, place)[0])
            assert abs(entry * UNIT - wanted) < HALF
            assert abs(float(lookup(along, place)) - wanted) < HALF
    assert controllers.read(path, "isg-plane").compensates == "C"
    turned = CompensationMap(x, y, values, ("X", "C"), "Z", (0.0, 0.0))
    with pytest.raises(TableError, match=r"C turns.*70184"):
        controllers.write(
            turned, tmp_path / "q.lis", "isg-plane", sign_confirmed=True, stroke="1 mm", **numbers
        )
