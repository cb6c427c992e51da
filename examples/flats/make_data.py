"""Make ab.csv, ac.csv, bc.csv, ab_54.csv and truth.csv of this example: a simulated three-flat test.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N, STEP_MM, NOISE_NM, TURN_DEG = 1984, 41, 2.5, 0.3, 54.0


def flat(name, x, y):
    """Return the height of a flat, seen from its front, in nm; x, y over the radius."""
    r2 = x**2 + y**2
    if name == "A":
        return 14 * x * y + 9 * (3 * r2 - 2) * x - 5 * (4 * x**3 * y - 4 * x * y**3)
    if name == "B":
        return 11 * (2 * r2 - 1) - 8 * (x**3 - 3 * x * y**2) + 6 * (x**2 - y**2)
    return 7 * (6 * r2**2 - 6 * r2 + 1) + 10 * (3 * r2 - 2) * y


def reading(pair, turn, x, y):
    """Return the first flat turned counter-clockwise, plus the second one mirrored (it faces it)."""
    c, s = np.cos(turn), np.sin(turn)
    return flat(pair[0], c * x + s * y, -s * x + c * y) + flat(pair[1], -x, y)


def main(folder):
    rng = np.random.default_rng(SEED)
    line = np.linspace(-1.0, 1.0, N)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= 1.0
    mm = np.arange(N) * STEP_MM
    setups = {"ab": 0.0, "ac": 0.0, "bc": 0.0, "ab_54": np.radians(TURN_DEG)}
    for name, turn in setups.items():
        z = reading(name[:2].upper(), turn, x, y) + NOISE_NM * rng.standard_normal(x.shape)
        piston, tilt_x, tilt_y = 40 * rng.standard_normal(3)  # each set-up is aligned anew
        z = np.where(inside, z + piston + tilt_x * x + tilt_y * y, np.nan)
        write(folder / f"{name}.csv", "x_mm,y_mm,z_nm", mm, [z])
    truth = [np.where(inside, flat(name, x, y), np.nan) for name in "ABC"]
    write(folder / "truth.csv", "x_mm,y_mm,a_nm,b_nm,c_nm", mm, truth)


def write(path, header, mm, columns):
    lines = [header]
    for i, y in enumerate(mm):
        for j, x in enumerate(mm):
            heights = ["nan" if np.isnan(z[i, j]) else f"{z[i, j]:.2f}" for z in columns]
            lines.append(",".join([f"{x:g}", f"{y:g}", *heights]))
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
