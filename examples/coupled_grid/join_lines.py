"""Error map of a plane from lines along x and along y, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.separation import coupled_grid

here = Path(__file__).parent
NX, NY, STEP = 13, 9, 25e-3


def lines(name):
    """Return the lines along one direction, shape (repeats, n_y, n_x), in m."""
    table = np.genfromtxt(
        here / "lines.csv", delimiter=",", names=True, dtype=None, encoding="ascii"
    )
    return table["z_nm"][table["line"] == name].reshape(-1, NY, NX) * 1e-9


def separable(z):
    """Return a map without 1, x, y and xy, which lines of free slope do not see."""
    y, x = (t.ravel() for t in np.mgrid[-1 : 1 : NY * 1j, -1 : 1 : NX * 1j])
    a = np.stack([np.ones_like(x), x, y, x * y], axis=1)
    return z - (a @ np.linalg.lstsq(a, z.ravel(), rcond=None)[0]).reshape(z.shape)


def main():
    result = coupled_grid(lines("x"), lines("y"), dx=STEP, dy=STEP)
    print(f"noise of a reading {result.noise.value * 1e9:.1f} nm, planted 12 nm")
    for item in result.null_space:
        print("not seen:", item)
    truth = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1)[:, 2].reshape(NY, NX) * 1e-9
    rest = result.error - separable(truth)
    u = np.sqrt(np.mean(result.u["error"] ** 2))
    print(f"map: RMS against truth {rest.std() * 1e9:.1f} nm, u {u * 1e9:.1f} nm")
    alone = separable(truth)
    alone = alone - alone.mean(axis=0) - alone.mean(axis=1, keepdims=True)
    print(f"a table for each axis would leave {alone.std() * 1e9:.0f} nm")


if __name__ == "__main__":
    main()
