"""Make face.csv and truth.csv of this example: a simulated face reversal on an air-bearing spindle.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_ANGLES, N_REVOLUTIONS = 1977, 180, 6
RADIUS_MM, NOISE_NM, WANDER_NM = 25.0, 1.0, 1.5


def plate(angle):
    """Return the height of the plate in nm on the circle of the face probe, over its own angle."""
    dirt = 9 * np.exp(-(((angle % (2 * np.pi) - 1.2) / 0.07) ** 2))
    return 14 * np.cos(2 * angle + 0.5) + 6 * np.cos(3 * angle - 1.0) + dirt


def axial(angle):
    """Return the axial error motion in nm, its fundamental among it."""
    return 7 * np.cos(angle - 0.3) + 4 * np.cos(2 * angle + 1.1) + 2 * np.cos(12 * angle)


def tilt(angle):
    """Return the tilt error motion in nrad, positive where it lifts the face probe of set-up 1."""
    return 300 * np.cos(2 * angle - 0.8) + 120 * np.sin(5 * angle)


def face_reading(angle, probe, mounted):
    """Return what the face probe reads in nm at the angle `probe`, the plate mounted at `mounted`."""
    lift = RADIUS_MM * 1e-3 * tilt(angle) * np.cos(probe)
    return axial(angle) + lift + plate(angle + probe - mounted)


def main(folder):
    rng = np.random.default_rng(SEED)
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    readings = [
        face_reading(angle, 0.0, 0.0) + 400 * np.cos(angle - 0.9),  # the plate stands askew
        face_reading(angle, np.pi, np.pi) + 520 * np.cos(angle + 2.0),
        axial(angle),
    ]
    lines = ["revolution,angle_deg,F1_nm,F2_nm,A_nm"]
    for revolution in range(1, N_REVOLUTIONS + 1):
        columns = []
        for reading in readings:
            wander = WANDER_NM * np.cos(angle * rng.uniform(0.3, 0.7) + rng.uniform(0, 6.28))
            columns.append(reading + wander + NOISE_NM * rng.standard_normal(angle.size))
        lines += [
            f"{revolution},{np.degrees(a):.0f},{p:.2f},{q:.2f},{c:.2f}"
            for a, p, q, c in zip(angle, *columns, strict=True)
        ]
    write(folder / "face.csv", lines)
    parts = zip(angle, plate(angle), axial(angle), tilt(angle), strict=True)
    rows = [f"{np.degrees(a):.0f},{p:.4f},{x:.4f},{t:.4f}" for a, p, x, t in parts]
    write(folder / "truth.csv", ["angle_deg,plate_nm,axial_nm,tilt_nrad", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
