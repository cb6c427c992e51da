"""Make readings.csv, flat.csv and truth.csv: a straightedge under three probes on a slide.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The middle probe is set 20 nm too low: over 300 mm that alone would bend the edge by 4.5 um.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 1997
STEP_MM, N = 10.0, 29
NOISE_NM, NOISE_URAD = 1.0, 0.05
ZEROS_NM = (0.0, -20.0, 0.0)


def truth(rng):
    x = STEP_MM * np.arange(N + 2)
    edge = (
        120 * ((x - 150) / 150) ** 2
        + 40 * np.sin(2 * np.pi * x / 170 + 1)
        + np.where(x > 205, 25, 0)
    )
    carriage = x[:N]
    slide = 900 * np.sin(2 * np.pi * carriage / 260) + 30 * rng.standard_normal(N)
    pitch = 6 * np.cos(2 * np.pi * carriage / 190) + 0.5 * rng.standard_normal(N)
    return x, edge, slide, pitch


def main(folder):
    rng = np.random.default_rng(SEED)
    x, edge, slide, pitch = truth(rng)
    probes = [
        edge[k : k + N]
        + slide
        + k * STEP_MM * pitch
        + ZEROS_NM[k]
        + NOISE_NM * rng.standard_normal(N)
        for k in range(3)
    ]
    level = pitch - 12.0 + NOISE_URAD * rng.standard_normal(N)
    write(
        folder / "readings.csv",
        "x_mm,trailing_nm,middle_nm,leading_nm,pitch_urad",
        [x[:N], *probes, level],
        (1, 3, 3, 3, 4),
    )
    flat = [ZEROS_NM[k] + NOISE_NM * rng.standard_normal(40) for k in range(3)]
    write(folder / "flat.csv", "trailing_nm,middle_nm,leading_nm", flat, (3, 3, 3))
    write(folder / "truth.csv", "x_mm,edge_nm", [x, edge], (1, 4))


def write(path, header, columns, digits):
    rows = [
        ",".join(f"{v:.{d}f}" for v, d in zip(row, digits, strict=True))
        for row in zip(*columns, strict=True)
    ]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
