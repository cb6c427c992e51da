"""A million blocks: below 200 MB, in a process of its own. `make bench` has the seconds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

BLOCKS = 1_000_000
MEGABYTES = 200.0
"""What is promised."""

PROGRAM = """
import json, sys
import numpy as np
from metrosep.controllers.gcode.corrections import error_correction
from metrosep.controllers.gcode.paths import rewrite_path
from metrosep.core.surface import Surface
y, x = np.mgrid[-21e-3:21e-3:512j, -21e-3:21e-3:512j]
step = 42e-3 / 511
surface = Surface(1e-6 * np.sin(x / 3e-3) * np.cos(y / 4e-3), dx=step, dy=step, origin=(-21e-3,) * 2)
result = rewrite_path(sys.argv[1], sys.argv[2], error_correction(surface))
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
peak = float(status["VmHWM"].split()[0]) / 1e3  # of this program; ru_maxrss begins at its parent's
print(json.dumps([peak, result.n_moves, result.n_changed, result.read_back_error]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux tells the peak there")
def test_a_million_blocks(tmp_path, spiral_program):
    spiral_program(tmp_path / "in.nc", BLOCKS)
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path / "in.nc", tmp_path / "out.nc"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    peak, moves, changed, deviation = json.loads(done.stdout)

    assert moves == BLOCKS + 4
    assert changed > 0.9 * BLOCKS
    assert deviation <= 0.5e-9 * (1 + 1e-6)
    assert peak < MEGABYTES
