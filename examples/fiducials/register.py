"""Shift and turn between two set-ups from marks, against the truth."""

from pathlib import Path

import numpy as np

from metrosep.separation import register_points

here = Path(__file__).parent


def main():
    marks = np.loadtxt(here / "marks.csv", delimiter=",", skiprows=1) * 1e-3
    found = register_points(marks[:, :2], marks[:, 2:])
    truth = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1)
    rows = (
        ("shift_x", found.shift_x * 1e3, found.u_shift[0] * 1e3, truth[0], "mm"),
        ("shift_y", found.shift_y * 1e3, found.u_shift[1] * 1e3, truth[1], "mm"),
        ("turn", np.degrees(found.angle), np.degrees(found.u_angle), truth[2], "deg"),
    )
    for name, value, u, true, unit in rows:
        print(f"{name}: {value:.4f} {unit}, u {u:.4f} {unit}, truth {true:g} {unit}")
    print(f"left of the distances {found.rms * 1e6:.1f} um RMS")


if __name__ == "__main__":
    main()
