"""Make edge.csv and truth.csv of this example: a straightedge reversed on a slide.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_PASSES, LENGTH_MM, STEP_MM = 1988, 6, 400.0, 4.0
NOISE_NM, SHIFT_MM = 15.0, 0.2


def edge(x):
    """Return the form of the straightedge in nm, x in mm from its end: a bow, and a nick."""
    bow = 320 * ((x - 200) / 200) ** 2 + 60 * np.sin(x / 31)
    return bow - 90 * np.exp(-(((x - 272) / 9) ** 2))


def slide(x):
    """Return the straightness error of the slide in nm, positive towards the edge of set-up 1."""
    return 240 * np.sin(x / 70 + 0.5) + 45 * np.cos(x / 8)


def main(folder):
    rng = np.random.default_rng(SEED)
    x = np.arange(0.0, LENGTH_MM + STEP_MM / 2, STEP_MM)
    # set-up 2: the edge turned about its long axis, the probe on its other side; both see the
    # same face, and the slide moves the other way. The edge came back 0.2 mm too far.
    setups = (edge(x) + slide(x), edge(x - SHIFT_MM) - slide(x))
    lines = ["pass,x_mm,m1_nm,m2_nm"]
    for number in range(1, N_PASSES + 1):
        columns = [
            z + 3000 * rng.standard_normal() + askew * x + NOISE_NM * rng.standard_normal(x.size)
            for z, askew in zip(setups, (6.0, -4.0), strict=True)
        ]
        rows = zip(x, *columns, strict=True)
        lines += [f"{number},{a:g},{p:.1f},{q:.1f}" for a, p, q in rows]
    write(folder / "edge.csv", lines)
    rows = [f"{a:g},{t:.3f},{s:.3f}" for a, t, s in zip(x, edge(x), slide(x), strict=True)]
    write(folder / "truth.csv", ["x_mm,edge_nm,slide_nm", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
