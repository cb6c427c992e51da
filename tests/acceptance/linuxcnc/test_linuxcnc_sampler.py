"""LinuxCNC's own `halsampler` as a source: `metrosep listen -` keeps what the pins were."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.controller

HAL = Path(__file__).with_name("sampler.hal")
USER = os.environ.get("METROSEP_CNC_USER", "metrosep-cnc")


@pytest.mark.skipif(shutil.which("halsampler") is None, reason="LinuxCNC is not installed")
def test_pins_of_hal_are_recorded_in_their_order_and_with_their_sign(tmp_path):
    home = tmp_path / "hal"  # halrun keeps its socket here
    home.mkdir()
    shutil.copy(HAL, home)
    command = ["halrun", "-f", str(home / HAL.name)]
    if os.getuid() == 0:
        for folder in (home, *home.parents[:4]):
            folder.chmod(0o755)
        shutil.chown(home, USER)
        command = ["runuser", "-u", USER, "--", "env", f"HOME={home}", *command]
    listen = [sys.executable, "-m", "metrosep", "listen", "-", "--columns", "x_mm,z_um", "-o"]
    with subprocess.Popen(
        command, cwd=home, env={**os.environ, "HOME": str(home)}, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as sampled:  # fmt: skip
        subprocess.run(
            [*listen, "hal.csv"], cwd=tmp_path, stdin=sampled.stdout, check=True, timeout=120,
            capture_output=True,
        )  # fmt: skip
        assert sampled.wait(timeout=60) == 0
    rows = np.loadtxt(tmp_path / "hal.csv", delimiter=",", skiprows=1)
    assert rows.shape == (400, 2)
    phase = np.unwrap(np.arctan2(rows[:, 0] - 0.25, rows[:, 1] - 0.25))
    # sine over cosine turns forward, 2 pi 10 Hz 1 ms a sample; six decimals are printed
    assert np.abs(np.diff(phase) - 0.02 * np.pi).max() < 2e-6
    assert np.abs(np.hypot(*(rows - 0.25).T) - 2.0).max() < 2e-6
