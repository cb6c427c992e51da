"""Straightedge and slide from a reversal, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import straightedge_reversal

here = Path(__file__).parent


def without_line(z, x):
    return z - np.polyval(np.polyfit(x, z, 1), x)


def main():
    data = read_readings(here / "edge.csv", readings=["m1_nm", "m2_nm"], x="x_mm", repeat="pass")
    result = straightedge_reversal(*data.values, x=data.position, u_registration=0.2e-3)
    print(result)
    for item in result.null_space:
        print("not seen:", item)
    x, edge, slide = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1, unpack=True)
    for name, true in (("artefact", edge), ("machine", slide)):
        rest = result.parts[name] * 1e9 - without_line(true, x)
        u = np.sqrt(np.mean(result.u[name] ** 2)) * 1e9
        print(f"{name}: RMS against truth {rest.std():.2f} nm, u {u:.2f} nm")


if __name__ == "__main__":
    main()
