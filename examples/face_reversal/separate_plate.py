"""Plate, axial and tilt error motion from a face reversal, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import face_reversal

here = Path(__file__).parent
RADIUS = 25e-3


def without(z, angle, highest):
    """Return a curve without its harmonics up to `highest`: what the method does not see."""
    terms = [f(k * angle) for k in range(1, highest + 1) for f in (np.cos, np.sin)]
    basis = np.column_stack([np.ones(angle.size), *terms])
    return z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]


def main():
    data = read_readings(
        here / "face.csv",
        readings=["F1_nm", "F2_nm", "A_nm"],
        angle="angle_deg",
        repeat="revolution",
    )
    result = face_reversal(*data.values, RADIUS)
    print(result)
    for item in result.null_space:
        print("not seen:", item)
    table = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1).T
    angle, truth = np.radians(table[0]), table[1:] * 1e-9
    rows = (("artefact", "nm", 1), ("axial", "nm", 0), ("tilt", "nrad", 1))
    for (name, unit, highest), true in zip(rows, truth, strict=True):
        rest = result.parts[name] - without(true, angle, highest)
        u = np.sqrt(np.mean(result.u[name] ** 2)) * 1e9
        print(f"{name}: RMS against truth {rest.std() * 1e9:.2f} {unit}, u {u:.2f} {unit}")


if __name__ == "__main__":
    main()
