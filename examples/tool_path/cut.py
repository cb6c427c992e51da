"""Cut a program on the lathe that made the error: ``python cut.py PROGRAM.nc``; no code of metrosep.

The lathe goes from block to block along straight lines in X, C and Z, and its error, which it makes
at every place again, is in truth.csv. What is left is actual minus nominal between the blocks too.
"""

import re
import sys
from pathlib import Path

import numpy as np

WORD = re.compile(r"([XCZ])(-?[\d.]+)")


def tool(program):
    """Return C in degrees, X and Z in mm of the G1 blocks, in their order."""
    text = Path(program).read_text(encoding="ascii")
    place, path = {}, []
    for line in text.splitlines():
        place.update({letter: float(number) for letter, number in WORD.findall(line)})
        if line.startswith("G0"):
            cutting = False
        elif line.startswith("G1"):
            cutting = True
        elif not line.startswith(("X", "C", "Z")):
            continue
        if cutting:
            path.append((place["C"], place["X"], place["Z"]))
    return np.array(path).T


def left_over(program):
    """Return what the part is off in nm at the places of truth.csv."""
    table = Path(__file__).parent / "truth.csv"
    c, radius, nominal, error = np.loadtxt(table, delimiter=",", skiprows=1, unpack=True)
    at, x, z = tool(program)
    if np.abs(np.interp(c, at, x) - radius).max() > 1e-4:
        raise ValueError(f"{program}: X does not follow the spiral of truth.csv")
    return 1e6 * (np.interp(c, at, z) - nominal) + error


if __name__ == "__main__":
    for program in sys.argv[1:]:
        nm = left_over(program)
        print(f"{Path(program).name}: P-V {np.ptp(nm):.0f} nm, RMS {nm.std():.1f} nm")
