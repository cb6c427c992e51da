"""Make marks.csv and truth.csv of this example: marks on a mirror in two set-ups of an instrument.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NOISE_UM = 6, 3.0
MARKS_MM = ((-18, -11), (-6, 17), (14, 15), (19, -4), (5, -19), (-16, 6))
SHIFT_MM, TURN_DEG = (0.42, -0.17), 1.3


def main(folder):
    rng = np.random.default_rng(SEED)
    x, y = np.array(MARKS_MM, dtype=float).T
    c, s = np.cos(np.radians(TURN_DEG)), np.sin(np.radians(TURN_DEG))
    # turned from x towards y about the centre, then shifted
    moved = c * x - s * y + SHIFT_MM[0], s * x + c * y + SHIFT_MM[1]
    columns = [v + NOISE_UM * 1e-3 * rng.standard_normal(x.size) for v in (x, y, *moved)]
    rows = [",".join(f"{v:.4f}" for v in row) for row in zip(*columns, strict=True)]
    write(folder / "marks.csv", ["x1_mm,y1_mm,x2_mm,y2_mm", *rows])
    truth = f"{SHIFT_MM[0]},{SHIFT_MM[1]},{TURN_DEG}"
    write(folder / "truth.csv", ["shift_x_mm,shift_y_mm,turn_deg", truth])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
