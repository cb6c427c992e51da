"""Interferometer and sphere: a random ball, and three positions, scored against the truth."""

from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.separation import ball_average, three_positions

here = Path(__file__).parent


def without_alignment(z):
    """Return a map without piston, tilt and power, which alignment and radius decide."""
    y, x = np.mgrid[: z.shape[0], : z.shape[1]] - (z.shape[0] - 1) / 2
    inside = np.isfinite(z)
    a = np.stack([np.ones_like(x), x, y, x**2 + y**2], axis=-1)
    return z - a @ np.linalg.lstsq(a[inside], z[inside], rcond=None)[0]


def score(result, name, values):
    rest = result.parts[name] - without_alignment(values.reshape(result.parts[name].shape) * 1e-9)
    rms, u = (np.sqrt(np.nanmean(v**2)) * 1e9 for v in (rest, result.u[name]))
    print(f"  {name}: RMS against truth {rms:.2f} nm, u {u:.2f} nm")


def main():
    patches = [ms.read(f) for f in sorted(here.glob("patch_*.csv"))]
    result = ball_average(patches)
    print(f"random ball, {len(patches)} patches")
    truth = np.loadtxt(here / "truth_ball.csv", delimiter=",", skiprows=1)
    score(result, "instrument", truth[:, 2])

    names = ("confocal", "confocal_180", "cats_eye")
    result = three_positions(*(ms.read(here / f"{name}.csv") for name in names))
    print(f"three positions, noise of a pixel {result.noise.value * 1e9:.2f} nm")
    truth = np.loadtxt(here / "truth_positions.csv", delimiter=",", skiprows=1)
    score(result, "part", truth[:, 2])
    score(result, "instrument", truth[:, 3])
    for item in result.null_space:
        print("not seen:", item)


if __name__ == "__main__":
    main()
