"""Straightness of an X slide after ISO 230-1 from five runs, against that of the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation import straightness_iso230_1

here = Path(__file__).parent


def narrowest(x, z):
    """Return the width of the narrowest band that holds all points, by trying slopes."""
    slopes = np.linspace(-0.01, 0.01, 20001)
    return min(np.ptp(z - b * x) for b in slopes)


def main():
    data = read_readings(here / "runs.csv", readings=["dy_um"], x="x_mm", repeat="run")
    x, runs = data.position, data.values[0]
    mean = runs.mean(axis=0)
    rest = (runs - mean).T
    rest = rest - np.polyval(np.polyfit(x, rest, 1), x[:, None])  # a run's own zero and line
    sd = np.sqrt(np.sum(rest**2) / (len(runs) - 1) / (x.size - 2) / len(runs))
    result = straightness_iso230_1(x, mean, sd=sd)
    for name in ("MZ", "LS", "EP"):
        print(f"{name}: {result.values[name]}")
    print(f"removed: slope {result.slopes['MZ'].value * 1e3:.3f} um/mm, planted 0.035 um/mm askew")
    for message in result.messages:
        print("-", message)
    x, z = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1, unpack=True)
    print(f"minimum zone of the truth {narrowest(x, z):.3f} um, found {result.value * 1e6:.3f} um")


if __name__ == "__main__":
    main()
