"""Ball and spindle from a displacement and a slope probe, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import orthogonal_mixed

here = Path(__file__).parent
RADIUS, KMAX = 12.5e-3, 40


def without_centring(z, angle):
    basis = np.column_stack([np.ones(angle.size), np.cos(angle), np.sin(angle)])
    return z - basis @ np.linalg.lstsq(basis, z, rcond=None)[0]


def main():
    common = {"angle": "angle_deg", "repeat": "revolution"}
    displacement = read_readings(here / "mixed.csv", readings=["d_nm"], **common)
    slope = read_readings(here / "mixed.csv", readings=["s_urad"], dimension="angle", **common)
    result = orthogonal_mixed(
        displacement.values[0], slope.values[0], KMAX, radius=RADIUS, angle=displacement.position
    )
    print(result)
    for item in result.null_space:
        print("not seen:", item)
    degrees, ball, x = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1, unpack=True)
    for name, true in (("artefact", ball), ("x", x)):
        rest = result.parts[name] * 1e9 - without_centring(true, np.radians(degrees))
        u = np.sqrt(np.mean(result.u[name] ** 2)) * 1e9
        print(f"{name}: RMS against truth {rest.std():.2f} nm, u {u:.2f} nm")


if __name__ == "__main__":
    main()
