"""Move the mill with each map and see where the tool goes: ``python check.py FOLDER``; no code of metrosep.

FOLDER holds what maps.py wrote. The files are read here anew, interpolated by hand, and the tool is
placed by the product of rigid bodies of make_machine.py, at 400 places that are not nodes.
"""

import re
import runpy
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
TOOL_Z = runpy.run_path(str(HERE / "make_machine.py"))["tool_z"]
X, Y, TRUTH = np.loadtxt(HERE / "truth.csv", delimiter=",", skiprows=1, unpack=True)


def from_csv(path):
    """Return the columns' and rows' positions in mm and the correction in um."""
    x, y, um = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
    xs, ys = np.unique(x), np.unique(y)
    grid = np.empty((ys.size, xs.size))
    grid[np.searchsorted(ys, y), np.searchsorted(xs, x)] = um
    return xs, ys, grid


def from_cal(path, *, sign):
    """Return the same of an Aerotech file; Z's encoder counts with the axis (1) or against it (-1)."""
    lines = path.read_text("ascii").splitlines()
    start = next(n for n in lines if n.startswith(":START2D") and "=" not in n)
    step_x, step_y = map(float, re.findall(r"\d+\.\d+", start))
    rows = [[float(v) for v in n.split()[2::3]] for n in lines if n[:1].isdigit()]
    grid = sign * np.array(rows)
    return step_x * np.arange(grid.shape[1]), step_y * np.arange(grid.shape[0]), grid


def looked_up(xs, ys, grid, x, y):
    """Return the bilinear value between nodes."""
    along = np.array([np.interp(x, xs, row) for row in grid])
    row = np.clip(np.searchsorted(ys, y) - 1, 0, ys.size - 2)
    share, at = (y - ys[row]) / (ys[row + 1] - ys[row]), np.arange(x.size)
    return (1 - share) * along[row, at] + share * along[row + 1, at]


def left_over(found, sign=1):
    """Return where the tool stands off in nm with the corrections, about the machine zero."""
    c = sign * looked_up(*found, X, Y)
    zero = np.zeros(1)
    return 1e6 * (TOOL_Z(X, Y, 1e-3 * c) - TOOL_Z(zero, zero, zero))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    print(f"without: P-V {np.ptp(TRUTH):.0f} nm, RMS {TRUTH.std():.1f} nm")
    for name, found in (
        ("csv-map", from_csv(folder / "z_of_xy.csv")),
        ("aerotech", from_cal(folder / "z_of_xy.cal", sign=-1)),
    ):
        for word, sign in (("with", 1), ("sign flipped", -1)):
            nm = left_over(found, sign)
            print(f"{name} {word}: P-V {np.ptp(nm):.0f} nm, RMS {nm.std():.1f} nm")
