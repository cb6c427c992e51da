"""Faces of a polygon and divisions of its table from a full closure, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import closure

here = Path(__file__).parent
N = 12
ARCSEC = np.pi / 180 / 3600


def main():
    names = [f"p{p}_arcsec" for p in range(N)]
    data = read_readings(here / "closure.csv", readings=names, dimension="angle")
    result = closure(data.values[:, 0])
    print(f"noise of a reading {result.noise.value / ARCSEC:.4f} arcsec")
    for item in result.null_space:
        print("not seen:", item)
    table = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1).T
    for name, true in (("artefact", table[1]), ("machine", table[2])):
        rest = result.parts[name] / ARCSEC - true
        u = np.sqrt(np.mean(result.u[name] ** 2)) / ARCSEC
        print(f"{name}: RMS against truth {rest.std():.4f} arcsec, u {u:.4f} arcsec")
    pitch = np.diff(np.append(result.artefact, result.artefact[0])) / ARCSEC
    print(
        f"largest pitch error of the polygon {np.abs(pitch).max():.2f} arcsec; sum {pitch.sum():.0e}"
    )


if __name__ == "__main__":
    main()
