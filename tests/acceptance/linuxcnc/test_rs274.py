"""Rewritten tool paths, understood by LinuxCNC's own RS274 interpreter at full precision.

The interpreter runs under the system's Python (`interpret.py`) on the original and on the corrected
program; nothing of metrosep parses here. The correction is evaluated by a formula of the test.
"""

import json
import math
import os
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from metrosep.controllers.gcode.corrections import error_correction
from metrosep.controllers.gcode.paths import rewrite_path
from metrosep.core.surface import Surface

PYTHON = "/usr/bin/python3"
INTERPRETER = Path(__file__).with_name("interpret.py")


def interpreter_is_there() -> bool:
    if not os.access(PYTHON, os.X_OK):
        return False
    done = subprocess.run([PYTHON, "-c", "import gcode"], capture_output=True, check=False)
    return done.returncode == 0


pytestmark = [
    pytest.mark.controller,
    pytest.mark.skipif(
        not interpreter_is_there(),
        reason="LinuxCNC is not installed: bash tests/acceptance/linuxcnc/install.sh",
    ),
]

SEED = 20261121
INCH_MM = 25.4
HALF_MM = 0.5e-6  # six digits in mm
HALF_INCH_MM = 0.5e-8 * INCH_MM
# The interpreter works in inches: 50 mm / 25.4 * 25.4 in double precision.
BINARY_MM = 4e-14
DEGREES = 1e-9  # a C of 36 000 degrees to some units of the last binary digit
SLOPES = (2e-5, -1.2e-5)  # m per m: not the same along x and y, and not odd in x


def interpret(program: Path) -> np.ndarray:
    """Line, rapid, X, Y, Z, A, B, C, feed of each move."""
    parameters = program.with_suffix(".var")
    parameters.touch()
    done = subprocess.run(
        [PYTHON, INTERPRETER, program, parameters],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return np.array([json.loads(line) for line in done.stdout.splitlines()], dtype=float)


def error_m(x, y):
    """Error of the part in m at x, y in m: a bilinear function, which a bilinear map holds exactly."""
    return SLOPES[0] * x + SLOPES[1] * y + 0.05 * x * y


def part_map() -> Surface:
    steps = np.linspace(-25e-3, 25e-3, 101)
    x, y = np.meshgrid(steps, steps)
    return Surface(error_m(x, y), dx=0.5e-3, dy=0.5e-3, origin=(-25e-3, -25e-3))


def wanted_mm(moves: np.ndarray, *, sense: int = 1, zero: float = 0.0) -> np.ndarray:
    radius, angle = moves[:, 2] * 1e-3, sense * np.deg2rad(moves[:, 7]) + zero
    return -1e3 * error_m(radius * np.cos(angle), radius * np.sin(angle))


def spiral(n: int, rng: np.random.Generator) -> str:
    """A slow-tool-servo path: every way to write a block that post-processors have."""
    x = np.linspace(20.0, -4.0, n)
    c = np.linspace(0.0, 36_000.0, n)
    z = 0.05 * np.cos(x) + 0.02 * np.sin(2 * np.deg2rad(c))
    lines = [
        "%",
        "(spiral, X20 C0)",
        "G21 G90 G17 G40",
        "G94",
        "M3 S1",
        "G0 Z5.",
        "G0 X20. C0.",
        "Z1.",
    ]
    lines += ["g93", "g1 z.5 f100"]
    for i in range(n):
        words = [f"X{x[i]:.5f}", f"C{c[i]:.4f}", f"Z{z[i]:.6f}"]
        kind = rng.integers(6)
        words = [words, words[::-1], words[:2], words[1:2], words[2:], words][kind]
        text = (" " if rng.integers(2) else "").join(
            [f"N{i + 1}", *words, f"F{rng.uniform(50, 6000):.2f}"]
        )
        lines.append(text.lower() if kind == 5 else text + " (X1 Z1)" * int(rng.integers(2)))
    return "\n".join([*lines, "G94", "G0 Z5.", "M5", "M2", "%", ""])


@pytest.mark.parametrize(("sense", "zero"), [(1, 0.0), (-1, 0.7)])
def test_only_z_moves_and_by_the_correction(tmp_path, sense, zero, record_property):
    source, target = tmp_path / "in.ngc", tmp_path / "out.ngc"
    source.write_text(spiral(4000, np.random.default_rng(SEED)))
    result = rewrite_path(source, target, error_correction(part_map(), c_sense=sense, c_zero=zero))

    before, after = interpret(source), interpret(target)
    known = slice(2, None)  # Z5., and X20. C0. where Z is 5 and gets its correction

    assert before.shape == after.shape
    assert before.shape[0] > 4000
    assert np.array_equal(before[:, 0] + 1, after[:, 0])  # line: the mark of the correction is one
    assert np.array_equal(before[:, 1:4], after[:, 1:4])  # rapid, X, Y
    assert np.array_equal(before[:, 5:8], after[:, 5:8])  # A, B, C
    wanted = wanted_mm(before, sense=sense, zero=zero)[known]
    deviation = np.abs((after - before)[known, 4] - wanted)
    record_property("largest_deviation_mm", float(deviation.max()))
    print(
        f"{deviation.size} moves, |dZ - c| <= {deviation.max():.3e} mm, c P-V {np.ptp(wanted):.3e} mm"
    )
    assert np.ptp(wanted) > 5e-4
    assert deviation.max() <= HALF_MM + BINARY_MM
    assert result.n_inserted > 500


def test_flipped_sense_is_caught(tmp_path):
    source, target = tmp_path / "in.ngc", tmp_path / "out.ngc"
    source.write_text(spiral(500, np.random.default_rng(SEED)))
    rewrite_path(source, target, error_correction(part_map(), c_sense=-1))

    before, after = interpret(source), interpret(target)

    wrong = np.abs((after - before)[2:, 4] - wanted_mm(before)[2:])
    assert wrong.max() > 100 * HALF_MM


def test_inches(tmp_path):
    source, target = tmp_path / "in.ngc", tmp_path / "out.ngc"
    source.write_text("G20 G90\nG0 X.5 C0. Z.1\nG1 F10 X.4 C90.\nZ.05\nC123.4\nM2\n")
    rewrite_path(source, target, error_correction(part_map()))

    before, after = interpret(source), interpret(target)

    np.testing.assert_allclose(
        (after - before)[:, 4], wanted_mm(before), rtol=0, atol=HALF_INCH_MM + BINARY_MM
    )


def test_diameter_mode(tmp_path):
    source, target = tmp_path / "in.ngc", tmp_path / "out.ngc"
    source.write_text("G21 G90 G7\nG0 X40. C0. Z1.\nG1 F10 X30. C90.\nX12.5 C200.\nM2\n")
    rewrite_path(source, target, error_correction(part_map()))

    before, after = interpret(source), interpret(target)

    assert before[:, 2].tolist() == pytest.approx([20.0, 15.0, 6.25], abs=BINARY_MM)
    assert np.array_equal(before[:, 2], after[:, 2])
    np.testing.assert_allclose(
        (after - before)[:, 4], wanted_mm(before), rtol=0, atol=HALF_MM + BINARY_MM
    )


def test_splitting_keeps_the_way_and_the_time(tmp_path):
    source, target = tmp_path / "in.ngc", tmp_path / "out.ngc"
    tolerance = 5e-9
    source.write_text(
        "G21 G90\nG0 X20. C0. Z1.\nG93\nN5 G1 X15. C90. Z.5 F6. (one)\nX14. C300. F30.\nZ0.25 F60.\nM2\n"
    )
    # LinuxCNC takes C along its numbers, 90 to 300 deg in one block too
    result = rewrite_path(
        source, target, error_correction(part_map()), tolerance=tolerance, c_rollover=False
    )

    before, after = interpret(source), interpret(target)

    assert result.n_added == after.shape[0] - before.shape[0] > 10
    ends = [int(np.argmin(np.abs(after[:, [2, 7]] - row[[2, 7]]).sum(1))) for row in before]
    ends[-1] = after.shape[0] - 1  # Z alone
    assert np.array_equal(after[ends][:, [2, 7]], before[:, [2, 7]])
    for row, (a, b) in enumerate(pairwise(ends)):
        start, end, part = before[row], before[row + 1], after[a : b + 1]
        share = np.arange(b - a + 1) / (b - a)
        for column, half in ((2, 2 * HALF_MM), (7, 1e-6)):
            line = start[column] + share * (end[column] - start[column])
            np.testing.assert_allclose(part[:, column], line, rtol=0, atol=half + DEGREES)
        nominal = start[4] + share * (end[4] - start[4])
        np.testing.assert_allclose(part[:, 4], nominal + wanted_mm(part), rtol=0, atol=2 * HALF_MM)
        way = np.hypot(*np.diff(part[:, [2, 4]], axis=0).T)
        time_s = 60 * (way / part[1:, 8]).sum()
        assert time_s == pytest.approx(60 / [6.0, 30.0, 60.0][row], abs=1e-4)
        fine = np.linspace(0, 1, 2001)
        dense = np.zeros((2001, 9))
        for column in (2, 7):
            dense[:, column] = start[column] + fine * (end[column] - start[column])
        chord = np.interp(fine, share, wanted_mm(part))
        assert np.abs(chord - wanted_mm(dense)).max() <= tolerance * 1e3 + HALF_MM
    assert math.isfinite(result.shortest_block)
