"""A mesh on Klipper's own code: what it reads, what it adds to Z, what it does within a move."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.options import checked_options
from metrosep.controllers.reprap import Klipper

SOURCE = Path(os.environ.get("KLIPPER_SOURCE", os.devnull))

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        not (SOURCE / "klippy" / "extras" / "bed_mesh.py").is_file(),
        reason="Klipper is not here: KLIPPER_SOURCE=<folder> "
        "bash tests/acceptance/klipper/install.sh, and run with KLIPPER_SOURCE set",
    ),
]

RUN = Path(__file__).with_name("run.py")
LIMIT_S = 60.0
FINEST = "[bed_mesh]\nsplit_delta_z: 0.01\nmove_check_distance: 3\n\n"
HEIGHT_MM = 1e-9  # heights are printed to 1 pm, positions to 1 pm on slopes below 1e-3


def klipper(data, places=(), path=()):
    """What Klipper makes of a file, in mm."""
    job = {
        "config": FINEST + data.decode(),
        "profile": "metrosep",
        "places": [[float(v) for v in p] for p in places],
        "path": [[float(v) for v in p] for p in path],
    }
    done = subprocess.run(
        [sys.executable, str(RUN), str(SOURCE)],
        input=json.dumps(job),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(done.stdout)


def encode(table):
    dialect = Klipper()
    return dialect.encode(table, **checked_options({}, dialect.options, "klipper")).data


def bumps(x, y):
    return 3e-6 * np.exp(-(((x - 12e-3) / 8e-3) ** 2 + ((y - 40e-3) / 6e-3) ** 2)) - 1e-6 * np.exp(
        -(((x - 20e-3) / 6e-3) ** 2 + ((y - 10e-3) / 9e-3) ** 2)
    )


@pytest.fixture(scope="module")
def table():
    return CompensationMap.from_error(
        bumps, x=np.linspace(0, 30e-3, 31), y=np.linspace(0, 60e-3, 41)
    )


def test_mesh_is_what_our_lookup_says(table):
    data = encode(table)
    rng = np.random.default_rng(4)
    places = rng.uniform([-20, -20], [60, 90], (200, 2))

    seen = np.array(klipper(data, places)["heights"])

    ours = Klipper().lookup(data, Path(os.devnull))(*(places.T * 1e-3)) * 1e3
    assert np.abs(seen - ours).max() < HEIGHT_MM
    assert np.abs(seen - table.correction(*(places.T * 1e-3)) * 1e3).max() < HEIGHT_MM


def test_dense_path_loses_its_error_and_a_negated_mesh_doubles_it(table):
    """The toolhead is at Z + mesh: the error there plus what was added is what is left."""
    x = np.linspace(0, 30, 121)
    path = [[v, 40.0, 1.0] for v in x]
    before = bumps(x * 1e-3, 40e-3) * 1e3

    left = {}
    for sign, mesh in ((1, table), (-1, table.negated())):
        moves = np.array(klipper(encode(mesh), path=path)["moves"])
        assert np.array_equal(moves[:, 0], x)
        left[sign] = np.ptp(before + moves[:, 2] - 1.0)

    assert left[1] < 0.02 * np.ptp(before)
    assert left[-1] == pytest.approx(2 * np.ptp(before), abs=0.02 * np.ptp(before))


def test_bump_within_a_move_is_not_followed(table):
    """Specification: 3 um in mid-move are below the 10 um at which Klipper acts."""
    moves = klipper(encode(table), path=[[0, 40, 1], [30, 40, 1]])["moves"]

    assert len(moves) == 2
    ends = table.correction(np.array([0, 30e-3]), 40e-3) * 1e3
    assert np.array(moves)[:, 2] - 1.0 == pytest.approx(ends, abs=HEIGHT_MM)


def test_bump_of_thirty_microns_is_followed_in_steps():
    """Specification: a move of 20 mm over 30 um breaks at 6 and 18 mm only."""
    x = np.linspace(0, 20e-3, 201)
    high = 30e-6 * np.exp(-(((x - 10e-3) / 4e-3) ** 2))
    table = CompensationMap(x, [0.0, 10e-3], np.array([high, high]))

    moves = np.array(klipper(encode(table), path=[[0, 0, 1], [20, 0, 1]])["moves"])

    # breaks lie at multiples of 3 mm; between them Z runs straight
    assert set(moves[1:-1, 0].round(9)) <= {3.0, 6.0, 9.0, 12.0, 15.0, 18.0}
    assert 1 <= len(moves) - 2 <= 6
    straight = np.interp(x * 1e3, moves[:, 0], moves[:, 2] - 1.0)
    assert np.abs(straight - high * 1e3).max() > 0.003


def test_ragged_row_loads_and_dies_on_the_first_move(table):
    lines = encode(table).decode().splitlines()
    lines[5] = lines[5].rsplit(", ", 10)[0]
    data = ("\n".join(lines) + "\n").encode()

    assert klipper(data)["moves"] == []
    with pytest.raises(RuntimeError, match="IndexError"):
        klipper(data, path=[[30, 3, 1]])
