"""Errors of a stage and of a grid plate from four placements, scored against the truth."""

from pathlib import Path

import numpy as np

from metrosep.separation import GridView, grid_calibration

here = Path(__file__).parent
N, PITCH = 9, 10e-3
VIEWS = {
    "initial": (0, (0, 0)),
    "rotated": (1, (0, 0)),
    "shifted": (0, (1, 0)),
    "back": (2, (0, 1)),
}


def view(table, name):
    """Return the readings of a placement, (repeats, n_y, n_x, 2) in m, NaN where no mark is."""
    out = np.full((2, N, N, 2), np.nan)
    for row in table[table["view"] == name]:
        i, j = (round(row[k] * 1e-3 / PITCH) + N // 2 for k in ("y_mm", "x_mm"))
        out[row["repeat"] - 1, i, j] = row["ex_nm"] * 1e-9, row["ey_nm"] * 1e-9
    return out


def separable(e):
    """Return error vectors without translation, rotation and scale, which no view tells."""
    y, x = np.mgrid[:N, :N] - (N - 1) / 2
    one, none = np.ones((N, N)), np.zeros((N, N))
    terms = [(one, none), (none, one), (-y, x), (x, y)]
    a = np.stack([np.stack(t, axis=-1).ravel() for t in terms], axis=1)
    return e - (a @ np.linalg.lstsq(a, e.ravel(), rcond=None)[0]).reshape(e.shape)


def main():
    table = np.genfromtxt(
        here / "views.csv", delimiter=",", names=True, dtype=None, encoding="ascii"
    )
    views = [GridView(view(table, name), *place) for name, place in VIEWS.items()]
    result = grid_calibration(views, pitch=PITCH)
    print(f"noise of a reading {result.noise.value * 1e9:.1f} nm, planted 8 nm")
    for item in result.null_space:
        print("not seen:", item)
    truth = np.loadtxt(here / "truth.csv", delimiter=",", skiprows=1) * 1e-9
    for name, columns in (("stage", truth[:, 2:4]), ("plate", truth[:, 4:6])):
        rest = result.parts[name] - separable(columns.reshape(N, N, 2))
        rms, u = (np.sqrt(np.mean(v**2)) * 1e9 for v in (rest, result.u[name]))
        print(f"{name}: RMS against truth {rms:.1f} nm, u {u:.1f} nm")


if __name__ == "__main__":
    main()
