"""Make position_000.csv ... position_270.csv and truth.csv of this example: a simulated rotation test.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N, STEP_MM, NOISE_NM = 1996, 41, 1.0, 0.4
TURNS_DEG = (0, 90, 180, 270)


def part(x, y):
    """Return the height of the turned mirror in nm: astigmatism, coma, a tool mark, and a dish."""
    mark = 12 * np.exp(-(((x - 0.45) / 0.15) ** 2) - ((y + 0.2) / 0.15) ** 2)
    return 18 * (x**2 - y**2) + 9 * (3 * (x**2 + y**2) - 2) * y + mark + 15 * (x**2 + y**2)


def instrument(x, y):
    """Return the error of the interferometer in nm, which stays where it is."""
    return 8 * x * y - 6 * (x**3 - 3 * x * y**2) + 5 * (x**2 + y**2) ** 2


def main(folder):
    rng = np.random.default_rng(SEED)
    line = np.linspace(-1.0, 1.0, N)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= 1.0
    mm = np.arange(N) * STEP_MM
    for degrees in TURNS_DEG:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        z = instrument(x, y) + part(c * x + s * y, -s * x + c * y)
        piston, tilt_x, tilt_y = 30 * rng.standard_normal(3)  # each set-up is aligned anew
        z = z + piston + tilt_x * x + tilt_y * y + NOISE_NM * rng.standard_normal(z.shape)
        name = f"position_{degrees:03d}.csv"
        write(folder / name, "x_mm,y_mm,z_nm", mm, [np.where(inside, z, np.nan)])
    truth = [np.where(inside, f(x, y), np.nan) for f in (part, instrument)]
    write(folder / "truth.csv", "x_mm,y_mm,part_nm,instrument_nm", mm, truth)


def write(path, header, mm, columns):
    lines = [header]
    for i, y in enumerate(mm):
        for j, x in enumerate(mm):
            heights = ["nan" if np.isnan(z[i, j]) else f"{z[i, j]:.2f}" for z in columns]
            lines.append(",".join([f"{x:g}", f"{y:g}", *heights]))
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
