"""Make mixed.csv and truth.csv of this example: a ball read by a displacement and a slope probe.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_ANGLES, N_REVOLUTIONS = 1997, 180, 6
RADIUS_MM = 12.5
NOISE_NM, NOISE_URAD = 1.0, 0.2
WAVES = ((2, 20.0, 0.4), (3, 9.0, -1.1), (5, 4.0, 2.0), (11, 2.0, 0.6))
DIRT_NM, DIRT_AT, DIRT_WIDTH = 8.0, 4.0, 0.12


def ball(phi):
    """Return roundness in nm and its slope in nm/rad at the angle phi of the ball."""
    r = sum(a * np.cos(k * phi + p) for k, a, p in WAVES)
    slope = sum(-k * a * np.sin(k * phi + p) for k, a, p in WAVES)
    u = (phi % (2 * np.pi) - DIRT_AT) / DIRT_WIDTH
    dirt = DIRT_NM * np.exp(-(u**2))
    return r + dirt, slope - 2 * u / DIRT_WIDTH * dirt


def motion(theta):
    """Return the motion of the spindle towards the displacement probe in nm."""
    return 7 * np.cos(2 * theta - 0.9) + 5 * np.sin(6 * theta) + 1.5 * np.cos(20 * theta)


def main(folder):
    rng = np.random.default_rng(SEED)
    theta = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    lines = ["revolution,angle_deg,d_nm,s_urad"]
    for revolution in range(1, N_REVOLUTIONS + 1):
        # 0.3 um of eccentricity moves with the ball; it shows in both probes
        x = motion(theta) + 300 * np.cos(theta - 0.7)
        d = ball(theta)[0] + x + NOISE_NM * rng.standard_normal(theta.size)
        # a ball that moves by x under the slope probe at 90 deg shows it a point steeper by -x/R
        s = (ball(theta + np.pi / 2)[1] - x) / RADIUS_MM  # nm/mm is urad
        s = s + NOISE_URAD * rng.standard_normal(theta.size)
        rows = zip(theta, d, s, strict=True)
        lines += [f"{revolution},{np.degrees(a):.0f},{p:.2f},{q:.3f}" for a, p, q in rows]
    write(folder / "mixed.csv", lines)
    rows = zip(theta, ball(theta)[0], motion(theta), strict=True)
    lines = [f"{np.degrees(a):.0f},{r:.4f},{x:.4f}" for a, r, x in rows]
    write(folder / "truth.csv", ["angle_deg,ball_nm,x_nm", *lines])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
