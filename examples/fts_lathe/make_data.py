"""Make measured.sdf and truth.csv of this example: a toric surface cut on a lathe with known errors.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. The tool stands EXX too far out, EYX too far towards growing
azimuth and EZX too far out of the material; B0Z turns the travel of X, so that the tool is lower by
B0Z times the way from the rim. The part was then lying askew on the microscope's table.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NOISE_NM = 331, 5.0
RB_MM, RD_MM, RADIUS_MM = 265.0, 132.5, 20.0
EXX_UM, EYX_UM, EZX_UM, B0Z_DEG = 2.0, -1.5, 3.0, 0.001
HALF, STEP_MM = 40, 0.5  # the map: 81 x 81 points
ASKEW = (4e-6, -7e-6)  # slopes


def toric(x, y):
    """Return the height in mm, eq 12 with y = rho sin(theta)."""
    return RB_MM - np.sqrt((RB_MM - RD_MM + np.sqrt(RD_MM**2 - y**2)) ** 2 - x**2)


def cut(x, y):
    """Return the height in mm that the tool leaves at x, y in mm."""
    rho, azimuth = np.hypot(x, y), np.arctan2(y, x)
    out, along = 1e-3 * EXX_UM, 1e-3 * EYX_UM
    moved_x = out * np.cos(azimuth) - along * np.sin(azimuth)
    moved_y = out * np.sin(azimuth) + along * np.cos(azimuth)
    lower = np.radians(B0Z_DEG) * (RADIUS_MM - rho)
    return toric(x - moved_x, y - moved_y) + 1e-3 * EZX_UM - lower


def main(folder):
    rng = np.random.default_rng(SEED)
    line = np.arange(-HALF, HALF + 1) * STEP_MM
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= RADIUS_MM
    z = cut(x, y) + ASKEW[0] * x + ASKEW[1] * y + 1e-6 * NOISE_NM * rng.standard_normal(x.shape)
    head = {
        "ManufacID": "metrosep", "CreateDate": "010120260000", "ModDate": "010120260000",
        "NumPoints": z.shape[1], "NumProfiles": z.shape[0], "Xscale": f"{STEP_MM * 1e-3:.3e}",
        "Yscale": f"{STEP_MM * 1e-3:.3e}", "Zscale": "1e-9", "Zresolution": "-1",
        "Compression": 0, "DataType": 7, "CheckType": 0,
    }  # fmt: skip
    lines = ["aBCR-1.0", *(f"{k} = {v}" for k, v in head.items()), "*"]
    lines += [
        " ".join(f"{h * 1e6:.0f}" if seen else "BAD" for h, seen in zip(*row, strict=True))
        for row in zip(z, inside, strict=True)
    ]
    save(folder / "measured.sdf", [*lines, "*", "simulated", "*"])
    truth = {"EXX_um": EXX_UM, "EYX_um": EYX_UM, "EZX_um": EZX_UM, "B0Z_deg": B0Z_DEG}
    save(folder / "truth.csv", ["name,value", *(f"{k},{v}" for k, v in truth.items())])


def save(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
