"""Make slopes.csv and truth.csv: four passes of an autocollimator over a mirror of 400 mm.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 2016
STEP_MM, N, PASSES = 1.0, 401, 4
NOISE_URAD = 0.05


def height_nm(x_mm, derivative=False):
    """Mirror with polishing ripple; height in nm, or slope in urad (nm/mm)."""
    rng = np.random.default_rng(SEED)
    out = np.zeros_like(x_mm)
    for k in range(1, 60):
        w = 2 * np.pi * k / 430.0
        a, phase = 60.0 / k**1.6 * rng.uniform(0.5, 1.5), rng.uniform(0, 2 * np.pi)
        out += a * (w * np.cos(w * x_mm + phase) if derivative else np.sin(w * x_mm + phase))
    return out


def main(folder):
    x = STEP_MM * np.arange(N)
    rng = np.random.default_rng(SEED + 1)
    slope = height_nm(x, derivative=True)
    zero = rng.normal(0.0, 2.0, PASSES)
    passes = slope + zero[:, None] + NOISE_URAD * rng.standard_normal((PASSES, N))
    head = "x_mm," + ",".join(f"pass{i + 1}_urad" for i in range(PASSES))
    rows = [
        f"{a:.1f}," + ",".join(f"{v:.4f}" for v in s) for a, s in zip(x, passes.T, strict=True)
    ]
    write(folder / "slopes.csv", [head, *rows])
    rows = [f"{a:.1f},{z:.4f}" for a, z in zip(x, height_nm(x), strict=True)]
    write(folder / "truth.csv", ["x_mm,height_nm", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
