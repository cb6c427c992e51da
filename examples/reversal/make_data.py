"""Make donaldson.csv and truth.csv of this example: a simulated reversal on an air-bearing spindle.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_ANGLES, N_REVOLUTIONS = 1972, 180, 8
NOISE_NM, ASYNCHRONOUS_NM = 1.5, 2.0


def truth():
    """Return angle (rad), roundness of the ball and radial error motion of the spindle, nm."""
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    ball = 22 * np.cos(2 * angle + 0.4) + 9 * np.cos(3 * angle - 1.1) + 3 * np.cos(7 * angle)
    spindle = 8 * np.cos(2 * angle - 0.9) + 5 * np.sin(6 * angle) + 1.5 * np.cos(24 * angle)
    ball += 12 * np.exp(-(((angle - 4.0) / 0.06) ** 2))  # a grain of dirt
    return angle, ball, spindle


def main(folder):
    rng = np.random.default_rng(SEED)
    angle, ball, spindle = truth()
    lines = ["revolution,angle_deg,m1_nm,m2_nm"]
    for revolution in range(1, N_REVOLUTIONS + 1):
        columns = []
        for sign, throw, phase in ((1, 240.0, 0.7), (-1, 310.0, 2.9)):
            wander = ASYNCHRONOUS_NM * np.cos(angle * rng.uniform(0.3, 0.7) + rng.uniform(0, 6.28))
            reading = ball + sign * spindle + throw * np.cos(angle - phase) + wander
            columns.append(reading + NOISE_NM * rng.standard_normal(angle.size))
        lines += [
            f"{revolution},{np.degrees(a):.0f},{p:.2f},{q:.2f}"
            for a, p, q in zip(angle, *columns, strict=True)
        ]
    (folder / "donaldson.csv").write_text("\n".join(lines) + "\n", "ascii", newline="\n")
    rows = [
        f"{np.degrees(a):.0f},{b:.4f},{s:.4f}"
        for a, b, s in zip(angle, ball, spindle, strict=True)
    ]
    text = "angle_deg,ball_nm,spindle_nm\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
