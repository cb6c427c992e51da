"""Ring and spindle from 8 steps, then from 8 and 7 steps, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation.circles.steps import multistep

here = Path(__file__).parent
KMAX = 20
NAMES = [f"n{n}_s{step}_nm" for n in (8, 7) for step in range(n)]


def main():
    data = read_readings(
        here / "readings.csv", readings=NAMES, angle="angle_deg", repeat="revolution"
    )
    truth = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1, unpack=True)[1:] * 1e-9
    for steps, rows in (((8,), 8), ((8, 7), 15)):
        result = multistep(data.values[:rows], steps=steps, kmax=KMAX)
        print(f"steps {steps}: not separated k =", result.suppressed)
        for name, true in zip(("artefact", "spindle"), truth, strict=True):
            rms = np.sqrt(np.mean((result.parts[name] - true) ** 2))
            u = np.sqrt(np.mean(result.u[name] ** 2))
            print(f"{name}: RMS against truth {rms * 1e9:.2f} nm, stated u {u * 1e9:.2f} nm")


if __name__ == "__main__":
    main()
