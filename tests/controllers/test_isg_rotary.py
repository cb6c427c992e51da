"""kw.ssfk of an axis that turns: 0.0001 deg, modulo; read by a parser of the documents (P-COMP-00019 to -00024)."""

import re

import numpy as np
import pytest

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.errors import MetrosepError, TableError

ARCSEC = np.pi / 180 / 3600
UNIT = np.deg2rad(1e-4)
HALF = 0.5 * UNIT * (1 + 1e-6)
"""Half an entry, and the rounding of doubles."""
EXACT = UNIT * 1e-4
"""REAL64 lists print 0.1 pm of 0.1 um: six decimals of a step; a hundred times that."""


def error(angle):
    """Return 9" sin(a + 23 deg) + 4" cos 2a, zero at 0: the example of the specification."""
    shape = lambda a: 9 * np.sin(a + np.deg2rad(23)) + 4 * np.cos(2 * a)  # noqa: E731
    return (shape(angle) - shape(0.0)) * ARCSEC


def table(lag=0.0, step=30):
    angles = np.deg2rad(np.arange(0, 361, step))
    ahead = -error(angles)
    ahead[-1] = ahead[0]
    reverse = ahead - lag * ARCSEC if lag else None
    return CompensationTable(angles, ahead, reverse, "C", "C", 0.0, is_exact_inverse=True)


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
    with pytest.raises(TableError, match="X is linear"):
        written(tmp_path, straight, modulo=True)
    with pytest.raises(MetrosepError, match="interval= is a length"):
        written(tmp_path, made, modulo=True, interval="5 mm")
    assert list(tmp_path.iterdir()) == []


def test_damaged_ring_is_refused(tmp_path):
    path = written(tmp_path, table(), number_type="integer", modulo=True)
    text = path.read_text()
    path.with_suffix(".lis.json").unlink()
    path.write_text(text.replace("table[12].pos 0", "table[12].pos 7"))
    with pytest.raises(MetrosepError, match="first value equal to the last"):
        controllers.read(path, "isg-axis")
