"""Make measured.sdf, dry_run.csv and truth.csv of this example: a turned sine grid, and its dry run.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep: the cut is that of a tool that stands dx, dy off, with a nose
radius that is dR too large; the map was then taken by a microscope whose centre was off by SHIFT_UM.
"""

import sys
from pathlib import Path

import numpy as np

SEED, NOISE_NM = 2018, 1.0
A_NM, WAVE_UM = 50.0, 100.0
DX_UM, DY_UM, DR_UM = -3.5, -3.5, 100.0
SHIFT_UM = (1.2, -0.8)
HALF, STEP_UM = 45, 5.0  # the map: 91 x 91 points
RADIUS_UM, FEED_UM, RPM, RATE_HZ = 60.0, 2.0, 20.0, 50.0  # the dry run of a pilot part
DRY_NOISE_NM, CV_S, CA_S2 = 0.3, -2e-3, -7.5e-4


def grid(x, y):
    """Return the height of the nominal surface in nm."""
    k = 2 * np.pi / WAVE_UM
    return A_NM * (np.sin(k * x) + np.cos(k * y))


def cut(x, y):
    """Return the height in nm that the tool leaves at x, y in um about the spindle axis."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    rho = np.maximum(rho, abs(DY_UM))
    r, t = np.sqrt(rho**2 - DY_UM**2) - DX_UM, theta - np.arcsin(DY_UM / rho)
    step = 1e-3  # slope of the surface in the plane of the rake, nm/um
    slope = (grid((r + step) * np.cos(t), (r + step) * np.sin(t))
             - grid((r - step) * np.cos(t), (r - step) * np.sin(t))) / (2 * step)  # fmt: skip
    lower = DR_UM * 1e3 * (np.sqrt(1 + (slope * 1e-3) ** 2) - 1)
    return grid(r * np.cos(t), r * np.sin(t)) - lower


def measured(rng):
    line = np.arange(-HALF, HALF + 1) * STEP_UM
    x, y = np.meshgrid(line, line)
    z = cut(x - SHIFT_UM[0], y - SHIFT_UM[1]) + 12.0 + 0.02 * x - 0.03 * y  # piston, tilts
    return z + NOISE_NM * rng.standard_normal(z.shape)


def dry_run(rng):
    """Return time in s, command and actual in nm: a lag, and no acceleration feedforward."""
    t = np.arange(int(RADIUS_UM / FEED_UM * 60 / RPM * RATE_HZ)) / RATE_HZ

    def command(t):
        turn = 2 * np.pi * RPM / 60 * t
        rho = RADIUS_UM - FEED_UM * RPM / 60 * t
        return grid(rho * np.cos(turn), rho * np.sin(turn))

    h = 1e-3
    velocity = (command(t + h) - command(t - h)) / (2 * h)
    acceleration = (command(t + h) - 2 * command(t) + command(t - h)) / h**2
    error = CV_S * velocity + CA_S2 * acceleration + DRY_NOISE_NM * rng.standard_normal(t.size)
    return t, command(t), command(t) + error


def main(folder):
    rng = np.random.default_rng(SEED)
    z = measured(rng)
    head = {
        "ManufacID": "metrosep", "CreateDate": "010120260000", "ModDate": "010120260000",
        "NumPoints": z.shape[1], "NumProfiles": z.shape[0], "Xscale": f"{STEP_UM * 1e-6:.3e}",
        "Yscale": f"{STEP_UM * 1e-6:.3e}", "Zscale": "1e-11", "Zresolution": "-1",
        "Compression": 0, "DataType": 7, "CheckType": 0,
    }  # fmt: skip
    lines = ["aBCR-1.0", *(f"{k} = {v}" for k, v in head.items()), "*"]
    lines += [" ".join(f"{v * 100:.0f}" for v in row) for row in z]
    save(folder / "measured.sdf", [*lines, "*", "simulated", "*"])
    rows = zip(*dry_run(rng), strict=True)
    save(
        folder / "dry_run.csv",
        ["t_s,command_nm,actual_nm", *(f"{a:.2f},{b:.3f},{c:.3f}" for a, b, c in rows)],
    )
    truth = [
        f"dx_um,{DX_UM}",
        f"dy_um,{DY_UM}",
        f"dR_um,{DR_UM}",
        f"cv_s,{CV_S}",
        f"ca_s2,{CA_S2}",
    ]
    save(folder / "truth.csv", ["name,value", *truth])


def save(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
