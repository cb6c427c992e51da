"""Axes that turn on a real controller: LinuxCNC counts an ANGULAR joint in degrees.

Joint 0 is C, of TYPE = ANGULAR; it carries a table of its own, moves Z, or is moved by Z. The expected
values are worked out here from the errors in rad and m, not from the file.
"""

import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from metrosep import controllers
from metrosep.compensation import CompensationTable
from metrosep.controllers.linuxcnc import LinuxCNCLincurve

pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None,
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

HERE = Path(__file__).parent
LIMIT_S = 60.0  # of one LinuxCNC session; each takes about 10 s

DEGREE = math.pi / 180.0
FILE = 1.1e-10  # ten decimals of degrees or mm
# the trim of type 0 is frozen one servo period before the axis stops: slope * a * T^2 in degrees
TRIM = 2e-6
ARC_SECOND = DEGREE / 3600.0

AXES = (
    ("coordinates=XZ", "coordinates=CZ"),
    ("COORDINATES = X Z", "COORDINATES = C Z"),
    ("[AXIS_X]", "[AXIS_C]"),
    ("TYPE = LINEAR", "TYPE = ANGULAR"),
)
TABLE = "COMP_FILE_TYPE = 0\nCOMP_FILE = table.comp\n"
DRIVE = """\
loadrt scale names=encoder,drive
setp encoder.gain 1
setp drive.gain 1
addf encoder servo-thread
net comp-{a}-{b}-encoder encoder.out
net other-motor joint.{a}.motor-pos-cmd => joint.{a}.motor-pos-fb
"""
AFTER = "addf drive servo-thread\nnet comp-{a}-{b}-drive => drive.in\nnet b-position drive.out => encoder.in\n"
REPLACED = ("net x-motor", "net z-motor", "addf motion-")


def visit(folder, targets, *, table=None, chain=None, source=0, target=1):
    """Readings of LinuxCNC at [C in degrees, Z in mm], with a type-0 file or a chain of lincurves."""
    settings = (HERE / "machine.ini").read_text()
    for old, new in AXES:
        settings = settings.replace(old, new, 1)
    hal, ini, wanted = (folder / name for name in ("m.hal", "m.ini", "targets.json"))
    lines = (HERE / "machine.hal").read_text()
    if chain is not None:
        settings = settings.replace(TABLE, "")
        kept = "".join(s for s in lines.splitlines(keepends=True) if not s.startswith(REPLACED))
        lines = (
            kept
            + DRIVE.format(a=source, b=target)
            + chain.decode()
            + AFTER.format(a=source, b=target)
        )
    hal.write_text(lines)
    ini.write_text(settings)
    wanted.write_text(json.dumps(np.asarray(targets, dtype=float).tolist()))
    pins = (
        [f"comp-{source}-{target}-cmd.in1", "drive.out", f"joint.{target}.motor-pos-cmd"]
        if chain
        else []
    )
    command = [sys.executable, HERE / "run.py", table or hal, wanted, "--limit", f"{LIMIT_S:g}"]
    command += ["-o", folder / "result.json", "--hal", hal, "--ini", ini, "--axes", "CZ"]
    command += [word for pin in pins for word in ("--pin", pin)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=2 * LIMIT_S + 20
    )
    assert done.returncode == 0, done.stdout + done.stderr
    result = json.loads((folder / "result.json").read_text())
    assert result["messages"] == []
    return result["readings"]


def test_table_of_c_is_applied_in_degrees(tmp_path):
    """4 arc seconds at 90 degrees and 2 more in return, not symmetric about it."""

    def error(angle):
        return 4 * ARC_SECOND * np.sin(angle) + 3 * ARC_SECOND * np.sin(2 * angle)

    table = CompensationTable.from_error(
        error,
        reverse=lambda a: error(a) + 2 * ARC_SECOND,
        positions=np.arange(0, 361, 10) * DEGREE,
        axis="C",
        direction="split",
        reference=0.0,
    )
    path = tmp_path / "c.comp"
    controllers.write(
        table, path, "linuxcnc", joint_type="angular", travel_low="0 deg", travel_high="360 deg"
    )
    knots = [10, 40, 90, 130, 220, 350]
    way = np.array([*knots, *knots[-2::-1]])

    readings = visit(tmp_path, way[:, None], table=path)

    seen = np.array([r["offset_mm"] for r in readings])  # of an angular joint it is degrees
    returns = np.arange(way.size) >= len(knots)
    expected = -(error(way * DEGREE) + 2 * ARC_SECOND * returns) / DEGREE
    assert np.ptp(expected) > 1e-3
    # the exact inverse asks for the error where the motor stands: less than 1e-8 degrees off
    np.testing.assert_allclose(seen, expected, rtol=0, atol=TRIM)
    simulated = controllers.simulate(path, "linuxcnc")
    applied = simulated(way * DEGREE, np.where(returns, -1, 1)) / DEGREE
    np.testing.assert_allclose(seen, applied, rtol=0, atol=TRIM)


def test_chain_over_c_moves_z_by_millimetres(tmp_path):
    def error(angle):
        return 3e-6 * np.sin(angle) + 1e-6 * np.sin(3 * angle)

    angles = np.arange(0, 361, 10) * DEGREE
    table = CompensationTable.from_error(
        error, positions=angles, axis="C", compensates="Z", direction="both"
    )
    data = LinuxCNCLincurve().encode(table, source_joint=0, target_joint=1).data
    way = np.array(
        [[10, 1], [90, 2], [95, 5], [200, 3], [350, 4], [365, 1], [-20, 2]], dtype=float
    )

    readings = visit(tmp_path, way, chain=data)

    at = np.clip(way[:, 0], 0, 360)
    expected = -np.interp(at, np.arange(0, 361, 10), error(angles)) * 1e3
    applied = [r["more_mm"]["drive.out"] - r["more_mm"]["joint.1.motor-pos-cmd"] for r in readings]
    assert np.abs(expected).max() > 2e-3
    np.testing.assert_allclose(applied, expected, rtol=0, atol=FILE + 1e-12)


def test_chain_over_z_turns_c_by_degrees(tmp_path):
    def error(z):
        return 5 * ARC_SECOND * np.sin(z / 7e-3)

    places = np.linspace(0, 60e-3, 61)
    table = CompensationTable.from_error(
        error, positions=places, axis="Z", compensates="C", direction="both"
    )
    data = LinuxCNCLincurve().encode(table, source_joint=1, target_joint=0).data
    way = np.array([[3, 11], [20, 10.5], [-7, 40], [100, 59], [0, 80]], dtype=float)

    readings = visit(tmp_path, way, chain=data, source=1, target=0)

    expected = -np.interp(way[:, 1] * 1e-3, places, error(places)) / DEGREE
    applied = [r["more_mm"]["drive.out"] - r["more_mm"]["joint.0.motor-pos-cmd"] for r in readings]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(applied, expected, rtol=0, atol=FILE + 1e-12)
