"""Make map_1.csv ... map_6.csv and truth.csv of this example: a mirror turned and shifted.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N, STEP_MM, NOISE_NM = 2012, 29, 1.0, 0.3
RADIUS_MM = (N - 1) / 2 * STEP_MM
POSITIONS = ((0, 0, 0), (90, 0, 0), (180, 0, 0), (0, 4, 0), (0, 0, 4), (90, -3, 2))
"""Turn in degrees, counter-clockwise, and shift in mm along x and y after the turn."""


def part(x, y):
    """Return the height of the mirror in nm; astigmatism, coma, a clover of four, a dish."""
    r2 = x**2 + y**2
    clover = x**4 - 6 * x**2 * y**2 + y**4
    return 18 * (x**2 - y**2) + 9 * (3 * r2 - 2) * y + 7 * clover + 12 * r2 + 5 * r2**2 * x


def instrument(x, y):
    """Return the error of the interferometer in nm, which stays where it is."""
    r2 = x**2 + y**2
    return 8 * x * y - 6 * (x**3 - 3 * x * y**2) + 5 * r2**2 + 4 * (x**4 - 6 * x**2 * y**2 + y**4)


def main(folder):
    rng = np.random.default_rng(SEED)
    line = np.linspace(-1.0, 1.0, N)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= 0.98
    for i, (degrees, sx, sy) in enumerate(POSITIONS, start=1):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        u, v = x - sx / RADIUS_MM, y - sy / RADIUS_MM  # from the centre of the mirror
        seen = inside & (np.hypot(u, v) <= 0.98)
        z = instrument(x, y) + part(c * u + s * v, -s * u + c * v)
        piston, tilt_x, tilt_y = 30 * rng.standard_normal(3)  # each position is aligned anew
        z = z + piston + tilt_x * x + tilt_y * y + NOISE_NM * rng.standard_normal(z.shape)
        write(folder / f"map_{i}.csv", "z_nm", [np.where(seen, z, np.nan)])
    truth = [np.where(inside, f(x, y), np.nan) for f in (part, instrument)]
    write(folder / "truth.csv", "part_nm,instrument_nm", truth)


def write(path, columns, maps):
    lines = [f"x_mm,y_mm,{columns}"]
    for i, j in np.ndindex(N, N):
        heights = ["nan" if np.isnan(z[i, j]) else f"{z[i, j]:.2f}" for z in maps]
        lines.append(",".join([f"{j * STEP_MM:g}", f"{i * STEP_MM:g}", *heights]))
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
