"""Make sweep.csv and truth.csv of this example: values of spindle tests at fourteen speeds.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 2307
SPEED_PER_MIN = np.arange(600, 6001, 400)
U_SYNCHRONOUS_NM, U_ASYNCHRONOUS_NM = 0.5, 0.3
FORM = {"synchronous": (18.0, 2.4e-3), "asynchronous": (4.0, 0.8e-3)}
"""Value at rest in nm, and growth with the square of the speed in nm per (rev/s)^2."""

NATURAL_HZ, WIDTH_HZ, GAIN_NM, ORDER = 171.0, 3.0, 9.0, 3
"""The mount answers where the third undulation of the spindle meets its natural frequency."""


def main(folder):
    rng = np.random.default_rng(SEED)
    n = SPEED_PER_MIN / 60.0
    true = {name: a + b * n**2 for name, (a, b) in FORM.items()}
    resonance = GAIN_NM / (1 + ((ORDER * n - NATURAL_HZ) / WIDTH_HZ) ** 2)
    synchronous = true["synchronous"] + resonance
    synchronous = synchronous + U_SYNCHRONOUS_NM * rng.standard_normal(n.size)
    asynchronous = true["asynchronous"] + U_ASYNCHRONOUS_NM * rng.standard_normal(n.size)
    lines = ["speed_rev_per_min,synchronous_nm,u_synchronous_nm,asynchronous_nm,u_asynchronous_nm"]
    for v, s, a in zip(SPEED_PER_MIN, synchronous, asynchronous, strict=True):
        lines.append(f"{v},{s:.2f},{U_SYNCHRONOUS_NM},{a:.2f},{U_ASYNCHRONOUS_NM}")
    write(folder / "sweep.csv", lines)
    rows = [f"{name},{a},{b}" for name, (a, b) in FORM.items()]
    write(folder / "truth.csv", ["value,at_rest_nm,growth_nm_s2", *rows])


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
