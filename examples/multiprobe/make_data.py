"""Make readings.csv and truth.csv of this example: four probes round a ball on a spindle.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. The part turns against the count of the probe angles: the
probe at phi sees the point theta + phi of the ball.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_ANGLES, N_REVOLUTIONS = 1976, 180, 6
PROBES_DEG = (0.0, 20.6, 47.8, 326.5)
NOISE_NM, ASYNCHRONOUS_NM, ECCENTRICITY_NM = 2.0, 6.0, 400.0


def ball(angle):
    """Return roundness in nm over the angle of the ball."""
    return (
        18 * np.cos(2 * angle + 0.5)
        + 9 * np.cos(3 * angle - 1.2)
        + 4 * np.cos(7 * angle + 2.0)
        + 2 * np.cos(15 * angle - 0.3)
    )


def motion(angle):
    """Return synchronous motion x, y of the axis in nm."""
    x = 12 * np.cos(2 * angle - 0.4) + 3 * np.cos(6 * angle)
    y = 7 * np.sin(3 * angle + 0.9) + 2 * np.cos(11 * angle)
    return x, y


def main(folder):
    rng = np.random.default_rng(SEED)
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    x, y = motion(angle)
    names = [f"p{i}_nm" for i in range(len(PROBES_DEG))]
    lines = ["revolution,angle_deg," + ",".join(names)]
    for revolution in range(1, N_REVOLUTIONS + 1):
        a, b = ASYNCHRONOUS_NM * rng.standard_normal(2)
        wander = a * np.cos(1.5 * angle), b * np.sin(1.5 * angle)
        columns = []
        for phi in np.radians(PROBES_DEG):
            reading = ball(angle + phi) + ECCENTRICITY_NM * np.cos(angle + phi - 1.0)
            reading = reading + (x + wander[0]) * np.cos(phi) + (y + wander[1]) * np.sin(phi)
            columns.append(reading + NOISE_NM * rng.standard_normal(N_ANGLES))
        lines += [
            f"{revolution},{np.degrees(t):.0f}," + ",".join(f"{v:.2f}" for v in row)
            for t, row in zip(angle, np.transpose(columns), strict=True)
        ]
    (folder / "readings.csv").write_text("\n".join(lines) + "\n", "ascii", newline="\n")
    rows = [
        f"{np.degrees(t):.0f},{b:.4f},{u:.4f},{v:.4f}"
        for t, b, u, v in zip(angle, ball(angle), x, y, strict=True)
    ]
    text = "angle_deg,ball_nm,x_nm,y_nm\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
