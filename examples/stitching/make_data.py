"""Make maps.csv and truth.csv: nine sub-apertures of a flat, with the error of the interferometer.

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

    rows = ["map,x0_mm,y0_mm,row,column,z_nm"]
    number = 0
    for j in STARTS:
        for i in STARTS:
            number += 1
            a, b, c = 400 * rng.normal(size=3)
            z = part[j : j + SIDE, i : i + SIDE] + reference + a + b * u + c * v
            z = z + NOISE_NM * rng.normal(size=z.shape)
            place = f"{number},{i * STEP_MM:.0f},{j * STEP_MM:.0f}"
            rows += [f"{place},{r},{k},{z[r, k]:.2f}" for r in range(SIDE) for k in range(SIDE)]
    _write(folder / "maps.csv", rows)

    rows = ["part,row,column,z_nm"]
    for name, z in (("surface", part), ("reference", reference)):
        rows += [f"{name},{r},{k},{z[r, k]:.3f}" for r, k in np.ndindex(z.shape)]
    _write(folder / "truth.csv", rows)


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
