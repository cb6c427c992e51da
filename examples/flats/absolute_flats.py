"""Three absolute flats from their sums two by two and one turned reading, scored against the truth."""

from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.separation.maps.flats import three_flat

here = Path(__file__).parent
TURN = np.radians(54.0)


def without_plane(z):
    inside = np.isfinite(z)
    y, x = np.mgrid[: z.shape[0], : z.shape[1]]
    a = np.column_stack([np.ones(inside.sum()), x[inside], y[inside]])
    c = np.linalg.lstsq(a, z[inside], rcond=None)[0]
    return z - c[0] - c[1] * x - c[2] * y


def main():
    ab, ac, bc, ab_54 = (ms.read(here / f"{n}.csv") for n in ("ab", "ac", "bc", "ab_54"))
    rows = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1)
    truth = dict(zip("ABC", rows[:, 2:].T.reshape(3, *ab.shape) * 1e-9, strict=True))

    diameter = three_flat(ab, ac, bc)
    print(diameter.messages[0])
    result = three_flat(ab, ac, bc, ab_54, TURN, method="zernike", terms=36)
    print(f"noise of a pixel {result.noise.value * 1e9:.2f} nm")
    for item in result.null_space:
        print("not seen:", item)
    for name in "ABC":
        rest = without_plane(result.parts[name] - truth[name])
        rms, u = (np.sqrt(np.nanmean(v**2)) * 1e9 for v in (rest, result.u[name]))
        print(f"{name}: RMS against truth {rms:.3f} nm, stated u {u:.3f} nm")


if __name__ == "__main__":
    main()
