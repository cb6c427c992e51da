"""Mirror and interferometer from turns and lateral shifts, scored against the truth."""

from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.separation import shift_rotation

here = Path(__file__).parent
TURNS_DEG = (0, 90, 180, 0, 0, 90)
SHIFTS_MM = ((0, 0), (0, 0), (0, 0), (4, 0), (0, 4), (-3, 2))


def separable(z):
    """Return a map without piston, tilt and power, which are not seen."""
    y, x = np.mgrid[: z.shape[0], : z.shape[1]] - (z.shape[0] - 1) / 2
    inside = np.isfinite(z)
    a = np.stack([np.ones_like(x), x, y, x**2 + y**2], axis=-1)
    return z - a @ np.linalg.lstsq(a[inside], z[inside], rcond=None)[0]


def main():
    maps = [ms.read(here / f"map_{i}.csv") for i in range(1, 7)]
    result = shift_rotation(maps, np.radians(TURNS_DEG), np.array(SHIFTS_MM) * 1e-3)
    print(f"noise of a pixel {result.noise.value * 1e9:.2f} nm")
    for item in result.null_space:
        print("not seen:", item)
    rows = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1)
    for name, values in zip(("part", "instrument"), rows[:, 2:].T, strict=True):
        rest = separable(result.parts[name] - values.reshape(maps[0].shape) * 1e-9)
        rms, u = (np.sqrt(np.nanmean(v**2)) * 1e9 for v in (rest, result.u[name]))
        print(f"{name}: RMS against truth {rms:.3f} nm, u {u:.3f} nm")


if __name__ == "__main__":
    main()
