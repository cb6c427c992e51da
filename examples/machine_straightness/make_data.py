"""Make runs.csv and truth.csv of this example: straightness of an X slide of a machining centre.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_RUNS, TRAVEL_MM, STEP_MM = 2012, 5, 600.0, 15.0
NOISE_UM, ASKEW_UM_PER_MM = 0.08, 0.035


def straightness(x_mm):
    """Return the true straightness error EYX in um: a bent slide, a rail joint, a pitch of 120 mm."""
    s = x_mm / TRAVEL_MM
    bent = 3.0 * s * (1 - s) * (1 + 0.8 * s)
    joint = 0.7 / (1 + np.exp(-(x_mm - 390) / 8))
    return bent + joint + 0.25 * np.sin(2 * np.pi * x_mm / 120 + 0.6)


def main(folder):
    rng = np.random.default_rng(SEED)
    x = np.arange(0.0, TRAVEL_MM + STEP_MM / 2, STEP_MM)
    lines = ["run,x_mm,dy_um"]
    for run in range(1, N_RUNS + 1):
        # the straightedge lies askew and stays; the indicator is set to zero anew
        reading = straightness(x) + ASKEW_UM_PER_MM * x + 5 * rng.standard_normal()
        reading += NOISE_UM * rng.standard_normal(x.size)
        lines += [f"{run},{a:g},{z:.2f}" for a, z in zip(x, reading, strict=True)]
    write(folder / "runs.csv", lines)
    rows = [f"{a:g},{z:.4f}" for a, z in zip(x, straightness(x), strict=True)]
    write(folder / "truth.csv", ["x_mm,dy_um", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
