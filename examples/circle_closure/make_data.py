"""Make closure.csv and truth.csv of this example: a polygon on an index table, read in 12 set-ups.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N, NOISE_ARCSEC = 2718, 12, 0.03
ZERO_ARCSEC = 40.0
SHADED = (4, 7)
"""Set-up and table index at which the clamp hid the face from the autocollimator."""


def truth(rng):
    """Return the angle errors of faces and table in arcsec, cumulative, about a mean of zero."""
    j = np.arange(N)
    faces = 1.2 * rng.standard_normal(N) + 0.8 * np.cos(2 * np.pi * j / N + 0.3)
    table = (
        2.5 * np.cos(2 * np.pi * j / N - 1.0) + 0.9 * np.cos(4 * np.pi * j / N) + 0.2 * (j == 5)
    )
    return faces - faces.mean(), table - table.mean()


def main(folder):
    rng = np.random.default_rng(SEED)
    faces, table = truth(rng)
    zeros = ZERO_ARCSEC * rng.standard_normal(N)
    # the polygon is put on p faces further: index j shows face j + p
    m = np.array([[faces[(j + p) % N] - table[j] + zeros[p] for p in range(N)] for j in range(N)])
    m += NOISE_ARCSEC * rng.standard_normal(m.shape)
    m[SHADED[1], SHADED[0]] = np.nan
    header = ",".join(["index", *(f"p{p}_arcsec" for p in range(N))])
    write(folder / "closure.csv", header, [[f"{v:.3f}" for v in row] for row in m])
    rows = [[f"{f:.4f}", f"{t:.4f}"] for f, t in zip(faces, table, strict=True)]
    write(folder / "truth.csv", "index,faces_arcsec,table_arcsec", rows)


def write(path, header, rows):
    lines = [header, *(",".join([str(j), *row]) for j, row in enumerate(rows))]
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
