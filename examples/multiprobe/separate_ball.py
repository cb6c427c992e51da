"""Ball and spindle motion from four probes, scored against the truth of the simulation."""

from pathlib import Path

import numpy as np

from metrosep.io.readings import read_readings
from metrosep.separation.circles.probe_angles import probe_gain
from metrosep.separation.circles.probe_check import check_probes
from metrosep.separation.circles.probes import multiprobe

here = Path(__file__).parent
ANGLES = np.deg2rad([0.0, 20.6, 47.8, 326.5])
KMAX = 30


def main():
    data = read_readings(
        here / "readings.csv",
        readings=[f"p{i}_nm" for i in range(4)],
        angle="angle_deg",
        repeat="revolution",
    )
    check = check_probes(data.values, ANGLES, KMAX, u_reading=2e-9)
    print("check:", check.message)
    result = multiprobe(data.values, ANGLES, KMAX)
    print(result)
    gain = probe_gain(ANGLES, KMAX)
    print(f"noise gain: {np.sqrt(np.mean(gain[2:] ** 2)):.2f} RMS, {gain[2:].max():.2f} at worst")
    hidden = [k for k, g in enumerate(probe_gain(np.deg2rad([0, 45, 135]), KMAX)) if np.isinf(g)]
    print("angles 0/45/135 would not show k =", ", ".join(str(k) for k in hidden[2:]))

    truth = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1, unpack=True)[1:] * 1e-9
    for name, true in zip(("artefact", "x", "y"), truth, strict=True):
        rms = np.sqrt(np.mean((result.parts[name] - true) ** 2))
        u = np.sqrt(np.mean(result.u[name] ** 2))
        print(f"{name}: RMS against truth {rms * 1e9:.2f} nm, stated u {u * 1e9:.2f} nm")


if __name__ == "__main__":
    main()
