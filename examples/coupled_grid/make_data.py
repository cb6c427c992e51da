"""Make lines.csv and truth.csv of this example: a stage plane read along lines in x and in y.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NX, NY, STEP_X_MM, STEP_Y_MM = 404, 13, 9, 25.0, 25.0
N_REPEATS, NOISE_NM = 2, 12.0


def plane(x, y):
    """Return the true height error in nm, x and y in mm: two guideways, and a dent near a corner."""
    dent = 180 * np.exp(-(((x - 215) / 45) ** 2) - ((y - 140) / 35) ** 2)
    return 150 * np.sin(x / 60 + 0.3) + 90 * np.cos(y / 45) + dent


def main(folder):
    rng = np.random.default_rng(SEED)
    x, y = np.arange(NX) * STEP_X_MM, np.arange(NY) * STEP_Y_MM
    error = plane(x, y[:, None])
    lines = ["repeat,line,x_mm,y_mm,z_nm"]
    for repeat in range(1, N_REPEATS + 1):
        # the straightedge is put down anew for each line of each repeat
        offset_x, slope_x = rng.standard_normal((2, NY, 1))
        offset_y, slope_y = rng.standard_normal((2, NX))
        along_x = error + 2000 * offset_x + 15 * slope_x * x
        along_y = error + 2000 * offset_y + 15 * slope_y * y[:, None]
        for name, readings in (("x", along_x), ("y", along_y)):
            z = readings + NOISE_NM * rng.standard_normal(readings.shape)
            for i, j in np.ndindex(z.shape):
                lines.append(f"{repeat},{name},{x[j]:g},{y[i]:g},{z[i, j]:.1f}")
    write(folder / "lines.csv", lines)
    rows = [f"{x[j]:g},{y[i]:g},{error[i, j]:.3f}" for i, j in np.ndindex(error.shape)]
    write(folder / "truth.csv", ["x_mm,y_mm,error_nm", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
