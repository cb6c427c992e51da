"""A chain of lincurves on a real controller: a table of X moves Z, more than one curve can hold.

Under test is the HAL file that `metrosep.controllers.write` made, loaded as it is; only ideal drives
and encoders are added around it. Encoders are read at the start of the servo period and drives
written at its end, joint 0 homes to an offset, and a following error above 1e-6 mm stops the machine.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep.compensation import CompensationTable
from metrosep.controllers.linuxcnc import CHAIN_POINTS, LinuxCNCLincurve

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None,
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

HERE = Path(__file__).parent
LIMIT_S = 60.0  # of one LinuxCNC session; the longest takes about 15 s
NOWHERE = Path("/nowhere/x-z.hal")

MM = 1e-3  # m
UM = 1e-3  # mm
TOLERANCE_MM = 1e-9  # HAL's doubles; nothing ramps a lincurve
FOLLOWING_MM = 1e-6
ROUNDING_MM = 1e-12
PRINT_MM = 1.1e-10  # ten decimals of position and correction

SEED = 20261121
HOME_MM = 3.5  # where joint 0 says it stands after homing on the spot
N_POINTS = 100  # seven curves

PINS = ("joint.0.motor-pos-cmd", "joint.0.f-error", "joint.1.f-error")
PINS += ("joint.1.motor-pos-cmd", "joint.1.pos-fb", "drive.out", "comp-0-1-cmd.in1")

BEFORE = """\
loadrt scale names=encoder,drive
setp encoder.gain 1
setp drive.gain 1
addf encoder servo-thread
net comp-0-1-encoder encoder.out
net x-motor joint.0.motor-pos-cmd => joint.0.motor-pos-fb
"""
AFTER = """\
addf drive servo-thread
net comp-0-1-drive => drive.in
net z-position drive.out => encoder.in
"""
REPLACED = ("net x-motor", "net z-motor", "addf motion-")  # by the file, as its activation says


def table_of(rng: np.random.Generator, n: int) -> CompensationTable:
    """Rough corrections at uneven positions, not symmetric in any sense."""
    position = np.linspace(-40.0, 60.0, n) + rng.uniform(-0.3, 0.3, n) * 100.0 / n
    correction = np.cumsum(rng.normal(0.1, 1.0, n)) * UM
    return CompensationTable(position * MM, correction * MM, None, "X", "Z", 0.0)


def targets_of(table: CompensationTable, wanted: int) -> list[list[float]]:
    """[X, Z]: X at knots, between and beyond both ends and back, Z elsewhere each time, mm."""
    knots = table.positions / MM
    shared = knots[15::15]
    middle = (knots[1:] + knots[:-1]) / 2
    some = np.concatenate([knots, middle])[:: max(1, 2 * knots.size // (wanted // 2))]
    way = np.sort(np.concatenate([some, shared[:6], [knots[0] - 7.0, knots[-1] + 9.0]]))
    x = np.concatenate([way, way[::-1][1:]])
    z = 4.0 + 0.07 * x + 1.5 * (np.arange(x.size) % 3)
    return np.round(np.column_stack([x, z]), 9).tolist()


def visit(folder: Path, written: bytes, targets_mm) -> dict:
    """What LinuxCNC did at the targets with a HAL file, values as arrays in mm."""
    lines = (HERE / "machine.hal").read_text().splitlines(keepends=True)
    kept = "".join(line for line in lines if not line.startswith(REPLACED))
    hal, ini, targets = (folder / name for name in ("m.hal", "m.ini", "targets.json"))
    hal.write_text(kept + BEFORE + written.decode() + AFTER)
    settings = (
        (HERE / "machine.ini").read_text().replace("FERROR = 1000", f"FERROR = {FOLLOWING_MM:g}")
    )
    settings = settings.replace("COMP_FILE_TYPE = 0\nCOMP_FILE = table.comp\n", "")
    home = f"HOME = {HOME_MM}\nHOME_OFFSET = {HOME_MM}\nHOME_SEQUENCE"
    ini.write_text(settings.replace("HOME_SEQUENCE", home, 1))
    targets.write_text(json.dumps(targets_mm))
    command = [sys.executable, HERE / "run.py", hal, targets, "--limit", f"{LIMIT_S:g}"]
    command += ["-o", folder / "result.json", "--hal", hal, "--ini", ini]
    command += [word for pin in PINS for word in ("--pin", pin)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=2 * LIMIT_S + 20
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads((folder / "result.json").read_text())
    readings = result["readings"]
    found = {pin: np.array([r["more_mm"][pin] for r in readings]) for pin in PINS}
    found["correction"] = found["drive.out"] - found["joint.1.motor-pos-cmd"]
    found |= {
        name: np.array([r["targets_mm"] for r in readings])[:, i] for i, name in enumerate("xz")
    }
    return found | {"messages": result["messages"], "rest": result["before_first_move"]}


@pytest.fixture(scope="module")
def table() -> CompensationTable:
    return table_of(np.random.default_rng(SEED), N_POINTS)


@pytest.fixture(scope="module")
def written(table: CompensationTable) -> bytes:
    return LinuxCNCLincurve().encode(table, source_joint=0, target_joint=1).data


@pytest.fixture(scope="module")
def seen(
    table: CompensationTable, written: bytes, tmp_path_factory: pytest.TempPathFactory
) -> dict:
    """The machine with seven curves."""
    return visit(tmp_path_factory.mktemp("chain"), written, targets_of(table, 30))


def test_chain_loads_and_no_following_error_ever_exceeds_the_limit(seen):
    assert seen["messages"] == []
    assert np.abs(seen["joint.1.f-error"]).max() <= ROUNDING_MM


def test_homing_offset_is_planted_and_only_the_table_moves_the_drive(seen, table):
    assert seen["rest"]["pins_mm"]["pos-cmd"] == HOME_MM
    moved = seen["rest"]["more_mm"]["drive.out"]
    assert moved == pytest.approx(float(table.correction(HOME_MM * MM)[0]) / MM, rel=0, abs=1e-9)


def test_drive_of_z_gets_the_correction_of_the_table(seen, table, record_property):
    expected = table.correction(seen["x"] * MM) / MM
    deviation = np.abs(seen["correction"] - expected).max()

    record_property("max_deviation_mm", float(deviation))
    print(f"{seen['x'].size} readings, largest deviation {deviation:.2e} mm")
    assert seen["x"].size >= 40
    assert np.ptp(expected) > 5 * UM
    assert deviation <= TOLERANCE_MM


def test_drive_of_z_gets_what_metrosep_simulates(seen, written):
    simulated = LinuxCNCLincurve().lookup(written, NOWHERE)(seen["x"] * MM) / MM

    np.testing.assert_allclose(seen["correction"], simulated, rtol=0, atol=PRINT_MM)
    np.testing.assert_allclose(seen["comp-0-1-cmd.in1"], simulated, rtol=0, atol=ROUNDING_MM)


def test_display_shows_the_target_and_x_is_not_moved(seen):
    np.testing.assert_allclose(seen["joint.1.pos-fb"], seen["z"], rtol=0, atol=ROUNDING_MM)
    drive_x = seen["joint.0.motor-pos-cmd"] + HOME_MM
    np.testing.assert_allclose(drive_x, seen["x"], rtol=0, atol=ROUNDING_MM)


def test_as_many_curves_as_the_controller_loads(tmp_path):
    table = table_of(np.random.default_rng(SEED + 1), CHAIN_POINTS)
    written = LinuxCNCLincurve().encode(table, source_joint=0, target_joint=1).data

    seen = visit(tmp_path, written, targets_of(table, 8))

    expected = table.correction(seen["x"] * MM) / MM
    print(
        f"{CHAIN_POINTS} points, largest deviation {np.abs(seen['correction'] - expected).max():.2e} mm"
    )
    assert written.count(b"addf comp-0-1-s-") == 63
    assert seen["messages"] == []
    np.testing.assert_allclose(seen["correction"], expected, rtol=0, atol=TOLERANCE_MM)


def test_reader_takes_the_file_that_the_controller_took(table, written):
    back = LinuxCNCLincurve().decode(written, NOWHERE)

    np.testing.assert_allclose(back.forward / MM, table.forward / MM, rtol=0, atol=PRINT_MM)
