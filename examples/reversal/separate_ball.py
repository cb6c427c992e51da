"""Ball and spindle from a Donaldson reversal, scored against the truth of the simulation."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import donaldson

here = Path(__file__).parent


def without_centring(z, angle):
    basis = np.column_stack([np.ones(angle.size), np.cos(angle), np.sin(angle)])
    return z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]


def main():
    data = read_readings(
        here / "donaldson.csv", readings=["m1_nm", "m2_nm"], angle="angle_deg", repeat="revolution"
    )
    result = donaldson(*data.values)
    print(result)
    for item in result.null_space:
        print("not seen:", item)
    angle, ball, spindle = np.loadtxt(
        here / "truth.csv", delimiter=",", skiprows=1, unpack=True
    ) * np.array([[np.pi / 180], [1e-9], [1e-9]])
    for name, found, true in (
        ("ball", result.artefact, ball),
        ("spindle", result.spindle, spindle),
    ):
        rest = found - without_centring(true, angle)
        print(f"{name}: RMS against truth {np.sqrt(np.mean(rest**2)) * 1e9:.2f} nm")


if __name__ == "__main__":
    main()
