"""Make map_1.csv ... map_9.csv and truth.csv: sub-apertures of a flat, with the interferometer's error.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 1705
SIDE = 24
STEP_MM = 1.0
STARTS = (0, 9, 20)
"""First pixel of the sub-apertures in x and in y: steps of 9 and 11 without a common divisor."""

NOISE_NM = 0.5


def main(folder):
    rng = np.random.default_rng(SEED)
    side = STARTS[-1] + SIDE
    y, x = np.mgrid[0:side, 0:side]
    part = 40 * np.sin(x / 6.0 + 0.4) * np.cos(y / 8.0) + 8 * np.sin(0.9 * x + 0.5 * y)
    v, u = np.mgrid[0:SIDE, 0:SIDE] / (SIDE - 1) * 2 - 1
    reference = 15 * u**3 - 9 * u * v**2 + 4 * np.sin(6 * u) * np.cos(5 * v)

    number = 0
    for j in STARTS:
        for i in STARTS:
            number += 1
            a, b, c = 400 * rng.normal(size=3)
            z = part[j : j + SIDE, i : i + SIDE] + reference + a + b * u + c * v
            z = z + NOISE_NM * rng.normal(size=z.shape)
            places = np.ndindex(z.shape)
            rows = [
                f"{(i + k) * STEP_MM:g},{(j + r) * STEP_MM:g},{z[r, k]:.2f}" for r, k in places
            ]
            _write(folder / f"map_{number}.csv", ["x_mm,y_mm,z_nm", *rows])

    rows = ["part,row,column,z_nm"]
    for name, z in (("surface", part), ("reference", reference)):
        rows += [f"{name},{r},{k},{z[r, k]:.3f}" for r, k in np.ndindex(z.shape)]
    _write(folder / "truth.csv", rows)


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
