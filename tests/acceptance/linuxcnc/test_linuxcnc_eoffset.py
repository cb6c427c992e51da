"""A map over X and Y on a real controller: Z gets it as an external offset.

Under test is the program that `metrosep.controllers.write` made, started by LinuxCNC with the HAL
and INI lines of the sidecar; only ideal motors are added.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep.compensation.maps import CompensationMap
from metrosep.controllers.linuxcnc_eoffset import LinuxCNCEoffset

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None,
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

HERE = Path(__file__).parent
LIMIT_S = 60.0  # of one LinuxCNC session
NOWHERE = Path("/nowhere/xy-z.py")
PROGRAM = "table.comp"  # where run.py puts the file under test

MM = 1e-3  # m
UM = 1e-3  # mm
RATIO = 0.5
# The ramp stops within 0.001 a T^2 of its target, a = RATIO * 1000 mm/s^2, T = 1 ms.
RAMP_MM = 0.001 * RATIO * 1000.0 * 1e-6
COUNT_MM = 1e-7
TOLERANCE_MM = RAMP_MM + COUNT_MM / 2 + 1e-10  # and half a count
REST_S = 0.4  # two hundred look-ups; beside a busy test suite the component gets few of them
OFF_BEFORE = 9  # target before which the machine is turned off, where the correction is not zero

SEED = 20261122

PINS = ("axis.x.pos-cmd", "axis.y.pos-cmd", "axis.z.pos-cmd", "axis.z.eoffset")
PINS += ("joint.2.pos-cmd", "joint.2.motor-pos-cmd", "joint.1.motor-pos-cmd")
PINS += ("comp-map.counts", "comp-map.active", "comp-map.fault", "axis.z.eoffset-scale")

MOTORS = "net y-motor joint.1.motor-pos-cmd => joint.1.motor-pos-fb\n"
MOTORS += "net z-motor joint.2.motor-pos-cmd => joint.2.motor-pos-fb\n"


def map_of(rng: np.random.Generator) -> CompensationMap:
    """Rough corrections at uneven nodes, more columns than rows, not symmetric in any sense."""
    x = np.linspace(-30.0, 50.0, 9) + rng.uniform(-2.0, 2.0, 9)
    y = np.linspace(-20.0, 15.0, 5) + rng.uniform(-2.0, 2.0, 5)
    values = np.cumsum(rng.normal(0.2, 1.5, (5, 9)), axis=1) * UM
    return CompensationMap(x * MM, y * MM, values * MM, reference=(x[3] * MM, y[2] * MM))


def targets_of(table: CompensationMap) -> list[list[float]]:
    """[X, Y, Z]: nodes, middles of edges and cells, outside on every side; Z elsewhere each time."""
    x, y = table.x / MM, table.y / MM
    places = [(a, b) for b in y[::2] for a in x[::2]]
    places += [(0.3 * x[i] + 0.7 * x[i + 1], y[1]) for i in (0, 4, 7)]
    places += [(x[5], 0.6 * y[j] + 0.4 * y[j + 1]) for j in (0, 3)]
    places += [
        (0.25 * x[i] + 0.75 * x[i + 1], 0.1 * y[j] + 0.9 * y[j + 1])
        for i in (1, 6)
        for j in (0, 2)
    ]
    places += [(x[0] - 9.0, y[0] - 9.0), (x[-1] + 9.0, y[3]), (x[2], y[-1] + 9.0)]
    z = [2.0 + 1.5 * (i % 3) for i in range(len(places))]
    return [
        [round(float(a), 9), round(float(b), 9), c] for (a, b), c in zip(places, z, strict=True)
    ]


def machine(notes: dict) -> tuple[str, str]:
    """HAL and INI of an XYZ machine with the lines of the sidecar: machine.* with Y between."""
    lines = (HERE / "machine.hal").read_text().splitlines(keepends=True)
    kept = "".join(line for line in lines if not line.startswith("net z-motor"))
    wired = "\n".join(notes["hal"]).replace("<this file>", PROGRAM)
    ini = (HERE / "machine.ini").read_text()
    ini = ini.replace("COMP_FILE_TYPE = 0\nCOMP_FILE = table.comp\n", "")
    ini = ini.replace("coordinates=XZ", "coordinates=XYZ").replace("JOINTS = 2", "JOINTS = 3")
    ini = ini.replace("COORDINATES = X Z", "COORDINATES = X Y Z")
    before, rest = ini.split("[AXIS_Z]\n")
    axis, joints = rest.split("[JOINT_0]\n")
    assert notes["ini"][0] == "[AXIS_Z]"
    offset = "\n".join(notes["ini"])
    ini = f"{before}[AXIS_Y]\n{axis}{offset}\n{axis}[JOINT_0]\n{joints}"
    return kept + MOTORS + wired + "\n", ini + "\n[JOINT_2]\n" + joints.split("[JOINT_1]\n")[1]


def visit(folder: Path, program: bytes, notes: dict, targets_mm) -> dict:
    """What LinuxCNC did at the targets with the program, values as arrays in mm."""
    hal, ini, under_test, targets = (
        folder / n for n in ("m.hal", "m.ini", "z.py", "targets.json")
    )
    for path, text in zip((hal, ini), machine(notes), strict=True):
        path.write_text(text)
    under_test.write_bytes(program)
    targets.write_text(json.dumps(targets_mm))
    command = [sys.executable, HERE / "run.py", under_test, targets, "--limit", f"{LIMIT_S:g}"]
    command += ["-o", folder / "result.json", "--hal", hal, "--ini", ini, "--axes", "XYZ"]
    command += ["--off-before", f"{OFF_BEFORE}"]
    command += ["--rest", f"{REST_S:g}", *[word for pin in PINS for word in ("--pin", pin)]]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=2 * LIMIT_S + 20
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads((folder / "result.json").read_text())
    readings = result["readings"]
    found = {pin: np.array([r["more_mm"][pin] for r in readings]) for pin in PINS}
    places = np.array([r["targets_mm"] for r in readings]).T
    return found | {
        "x": places[0],
        "y": places[1],
        "z": places[2],
        "messages": result["messages"],
        "rest": result["before_first_move"],
    }


@pytest.fixture(scope="module")
def table() -> CompensationMap:
    return map_of(np.random.default_rng(SEED))


@pytest.fixture(scope="module")
def encoded(table: CompensationMap):
    return LinuxCNCEoffset().encode(table, count=COUNT_MM * MM, av_ratio=RATIO)


@pytest.fixture(scope="module")
def seen(table, encoded, tmp_path_factory) -> dict:
    """The machine with the map."""
    folder = tmp_path_factory.mktemp("map")
    return visit(folder, encoded.data, encoded.notes, targets_of(table))


def test_component_starts_and_finds_no_fault(seen):
    assert seen["messages"] == []
    assert seen["comp-map.active"].all()
    assert not seen["comp-map.fault"].any()
    assert seen["axis.z.eoffset-scale"].tolist() == [COUNT_MM] * seen["x"].size


def test_z_gets_the_map_at_nodes_and_between(seen, table, record_property):
    expected = table.correction(seen["x"] * MM, seen["y"] * MM) / MM
    deviation = np.abs(seen["joint.2.pos-cmd"] - seen["z"] - expected).max()

    record_property("max_deviation_mm", float(deviation))
    print(f"{seen['x'].size} readings, largest deviation {deviation:.2e} mm")
    assert seen["x"].size >= 25
    assert np.ptp(expected) > 5 * UM
    assert deviation <= TOLERANCE_MM


def test_counts_are_those_that_metrosep_simulates(seen, encoded):
    lookup = LinuxCNCEoffset().lookup(encoded.data, NOWHERE)
    simulated = lookup(seen["x"] * MM, seen["y"] * MM) / MM

    assert seen["comp-map.counts"].tolist() == np.rint(simulated / COUNT_MM).tolist()
    np.testing.assert_allclose(seen["axis.z.eoffset"], simulated, rtol=0, atol=RAMP_MM)


def test_motor_moves_by_the_offset_and_the_display_of_z_does_not(seen):
    moved = seen["joint.2.motor-pos-cmd"] - seen["axis.z.eoffset"]

    np.testing.assert_allclose(moved, seen["z"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(seen["axis.z.pos-cmd"], seen["z"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(seen["axis.x.pos-cmd"], seen["x"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(seen["joint.1.motor-pos-cmd"], seen["y"], rtol=0, atol=1e-12)


def test_offset_is_whole_again_after_the_machine_was_off(seen):
    # LinuxCNC forgets counts that change while it is off: a component that does not clear the offset
    # would be wrong by the correction of the target before, from then on.
    forgotten = seen["axis.z.eoffset"][OFF_BEFORE - 1]
    after = seen["axis.z.eoffset"][OFF_BEFORE:] - seen["comp-map.counts"][OFF_BEFORE:] * COUNT_MM

    assert abs(forgotten) > 1 * UM
    assert np.abs(after).max() <= RAMP_MM
