"""Make runs.csv, diagonals.csv and truth.csv: a simulated three-axis machine with known errors.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import math
import sys
from pathlib import Path

import numpy as np

SEED = 231
SIZE = (0.5, 0.4, 0.3)
"""Travel of X, Y, Z in m."""

ANGLES = {"xy": 18e-6, "xz": -7e-6, "yz": 11e-6}
"""Positive axes enclose pi/2 minus this, rad."""

SPREAD = 0.4e-6
PLAY = -1.8e-6
"""Mean forward minus mean backward: the axis stays behind on both sides."""


def lead(x):
    """Error of the scale of X, m: a little long, and one wave."""
    return 6e-6 * x / 0.5 + 1.5e-6 * np.sin(2 * np.pi * x / 0.35)


def main(folder):
    rng = np.random.default_rng(SEED)
    targets = np.round(np.arange(11) * 0.05 - 0.005 * rng.uniform(size=11), 5)
    targets = np.abs(targets)
    lines = ["target_mm,direction," + ",".join(f"reached_{j}_mm" for j in range(1, 6))]
    for name, side in (("fwd", 0.5), ("bwd", -0.5)):
        for t in targets:
            reached = t + lead(t) + side * PLAY + SPREAD * rng.normal(size=5)
            lines.append(f"{t * 1e3:.2f},{name}," + ",".join(f"{r * 1e3:.5f}" for r in reached))
    _write(folder / "runs.csv", lines)

    lines = ["diagonal,target_mm,direction," + ",".join(f"reached_{j}_mm" for j in range(1, 6))]
    length = math.sqrt(sum(v * v for v in SIZE))
    x, y, z = SIZE
    for name in ("ppp", "npp", "pnp", "nnp"):
        sx, sy, sz = (1 if letter == "p" else -1 for letter in name)
        shear = sx * sy * ANGLES["xy"] * x * y + sx * sz * ANGLES["xz"] * x * z
        growth = (shear + sy * sz * ANGLES["yz"] * y * z) / length + 3e-6
        along = np.round(np.linspace(0, length, 8) * (1 - 0.01 * rng.uniform(size=8)), 5)
        for way, side in (("fwd", 0.5), ("bwd", -0.5)):
            for t in along:
                reached = t + growth * t / length + side * PLAY + SPREAD * rng.normal(size=5)
                cells = ",".join(f"{r * 1e3:.5f}" for r in reached)
                lines.append(f"{name},{t * 1e3:.2f},{way},{cells}")
    _write(folder / "diagonals.csv", lines)

    errors = lead(targets)
    truth = {
        "systematic_um": (np.ptp(errors) - PLAY) * 1e6,
        "reversal_um": PLAY * 1e6,
        "repeatability_um": (4 * SPREAD - PLAY) * 1e6,
        "mean_range_um": np.ptp(errors) * 1e6,
        **{f"a_{pair}_urad": value * 1e6 for pair, value in ANGLES.items()},
    }
    _write(folder / "truth.csv", ["name,value", *(f"{k},{v:.4f}" for k, v in truth.items())])


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
