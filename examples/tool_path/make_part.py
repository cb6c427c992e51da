"""Make part.nc, measured.sdf and truth.csv of this example: a mirror that a lathe cuts with an error.

Run ``python make_part.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. The mirror is a paraboloid, cut along a spiral from the rim
to the middle. The spindle is not square to the slide, its bearing has two lobes, and where the chuck
clamps, the part bulges: what the tool leaves depends on the radius and on C. Then the part was
measured from the front, where C goes against the polar angle, and mounted 30 degrees round.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NOISE_NM = 707, 3.0
RADIUS_MM, PITCH_MM, PER_TURN = 5.0, 0.2, 120  # 25 turns, 3000 blocks
CURVATURE_MM = 200.0
C_SENSE, C_ZERO_DEG = -1, 30.0  # polar angle on the map = C_ZERO_DEG + C_SENSE C
HALF, STEP_MM, MAP_RADIUS_MM = 27, 0.2, 5.4


def form(radius):
    """Return the nominal height in mm."""
    return radius**2 / (2 * CURVATURE_MM)


def error(x, y):
    """Return actual minus nominal in nm at a place of the map in mm; + is too high."""
    tilt = 50.0 * x - 30.0 * y
    lobes = 12.0 * (x**2 - y**2) + 8.0 * x * y
    bulge = 400.0 * np.exp(-((x - 2.0) ** 2 + (y - 1.5) ** 2) / 1.2**2)
    return tilt + lobes + bulge


def place(radius, c_deg):
    """Return where on the map the tool is."""
    polar = np.radians(C_ZERO_DEG + C_SENSE * c_deg)
    return radius * np.cos(polar), radius * np.sin(polar)


def program():
    """Return the blocks: X is the radius, C goes on over 360, F is 1 / minutes of a block."""
    turns = np.arange(RADIUS_MM / PITCH_MM * PER_TURN + 1) / PER_TURN
    radius, c = RADIUS_MM - PITCH_MM * turns, 360.0 * turns
    blocks = [
        f"G1 X{r:.4f} C{a:.1f} Z{z:.6f} F{7200 if a else 60}"
        for r, a, z in zip(radius, c, form(radius), strict=True)
    ]
    head = ["(paraboloid, 60 rpm)", "G21 G90 G94", f"G0 X{RADIUS_MM:.4f} C0.0 Z0.2", "G93"]
    return [*head, *blocks, "G94", "G0 Z5.0", "M30"]


def measured(rng):
    """Return the heights in nm on the grid, NaN beyond the part."""
    line = np.arange(-HALF, HALF + 1) * STEP_MM
    x, y = np.meshgrid(line, line)
    z = error(x, y) + NOISE_NM * rng.standard_normal(x.shape)
    return np.where(np.hypot(x, y) <= MAP_RADIUS_MM, z, np.nan)


def sdf(z):
    """Return the lines of a map, heights in steps of 0.1 nm."""
    head = {
        "ManufacID": "metrosep", "CreateDate": "010120260000", "ModDate": "010120260000",
        "NumPoints": z.shape[1], "NumProfiles": z.shape[0], "Xscale": f"{STEP_MM * 1e-3:.3e}",
        "Yscale": f"{STEP_MM * 1e-3:.3e}", "Zscale": "1e-10", "Zresolution": "-1",
        "Compression": 0, "DataType": 7, "CheckType": 0,
    }  # fmt: skip
    rows = [" ".join("BAD" if np.isnan(h) else f"{10 * h:.0f}" for h in row) for row in z]
    return [
        "aBCR-1.0",
        *(f"{k} = {v}" for k, v in head.items()),
        "*",
        *rows,
        "*",
        "simulated",
        "*",
    ]


def truth():
    """Return rows of places on the spiral, between the blocks too."""
    c = np.arange(0.5, RADIUS_MM / PITCH_MM * 360.0, 10.1)
    radius = RADIUS_MM - PITCH_MM * c / 360.0
    rows = zip(c, radius, form(radius), error(*place(radius, c)), strict=True)
    return [f"{a:.1f},{r:.6f},{z:.7f},{e:.2f}" for a, r, z, e in rows]


def main(folder):
    save(folder / "part.nc", program())
    save(folder / "measured.sdf", sdf(measured(np.random.default_rng(SEED))))
    save(folder / "truth.csv", ["C_deg,X_mm,nominal_mm,error_nm", *truth()])


def save(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
