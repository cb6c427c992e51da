"""Make plane.csv and truth.csv: a simulated XY plane, measured three times.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The plane is e(x) + e(y) + alpha y + beta x as in eq. 3 of the paper, plus a twist of 40 nm at the
corners that no sum of two axes can describe.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NOISE_UM, TWIST_UM = 3, 0.015, 0.040
X_MM, Y_MM = np.arange(0.0, 46.0, 3.0), np.arange(0.0, 71.0, 5.0)
ALPHA_URAD, BETA_URAD = 4.0, -2.5


def axis(x, waves, phase):
    return sum(a * np.cos(2 * np.pi * x / w + phase + w) for w, a in waves.items())


def without_line(x, z):
    return z - np.polyval(np.polyfit(x, z, 1), x)


def main(folder):
    rng = np.random.default_rng(SEED)
    e_x = without_line(X_MM, axis(X_MM, {31.0: 0.06, 10.0: 0.08}, 0.4))
    e_y = without_line(Y_MM, axis(Y_MM, {63.0: 0.15, 31.0: 0.06, 12.0: 0.40}, 1.1))
    across = (X_MM - X_MM.mean()) / np.ptp(X_MM) * 2
    along = (Y_MM - Y_MM.mean()) / np.ptp(Y_MM) * 2
    plane = e_x + e_y[:, None] + 1e-3 * (ALPHA_URAD * Y_MM[:, None] + BETA_URAD * X_MM)
    plane = plane + TWIST_UM * np.outer(along, across)
    lines = ["repeat,x_mm,y_mm,z_um"]
    for repeat in range(1, 4):
        z = plane + NOISE_UM * rng.standard_normal(plane.shape) + 0.1 * repeat
        lines += [
            f"{repeat},{X_MM[i]:.1f},{Y_MM[j]:.1f},{z[j, i]:.4f}" for j, i in np.ndindex(z.shape)
        ]
    (folder / "plane.csv").write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")
    rows = [f"x,{a:.1f},{e:.6f}" for a, e in zip(X_MM, e_x, strict=True)]
    rows += [f"y,{a:.1f},{e:.6f}" for a, e in zip(Y_MM, e_y, strict=True)]
    text = "axis,position_mm,e_um\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
