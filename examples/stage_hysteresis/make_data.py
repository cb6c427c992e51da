"""Make the loops of a piezo stage and a course to be driven; nothing of metrosep is used.

``python make_data.py [FOLDER]``. Plays one by one: a play stays where it is until the voltage has moved
by its width, and follows then.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

WIDTHS, WEIGHTS = (0.0, 0.6, 1.5, 3.0), (1.50, 0.09, 0.05, 0.04)  # V, um/V
NOISE = 2e-3  # um


def stage(voltages):
    """Return displacements in um of a stage that was never driven before."""
    plays, found = [0.0] * len(WIDTHS), []
    for v in voltages:
        plays = [min(max(p, v - r), v + r) for p, r in zip(plays, WIDTHS, strict=True)]
        found.append(sum(w * p for w, p in zip(WEIGHTS, plays, strict=True)))
    return np.array(found)


def through(corners, step):
    """Return a course through corners by steps."""
    parts = [np.linspace(a, b, round(abs(b - a) / step) + 1)[1:] for a, b in pairwise(corners)]
    return np.concatenate([[corners[0]], *parts])


def main(folder):
    """Write the files: full strokes, then two nested minor loops; and a course of partial strokes."""
    voltages = through([0, 10, 0, 10, 0, 10, 0, 8, 2, 6, 3, 8, 0, 10, 0], 0.1)
    logged = stage(voltages) + np.random.default_rng(8).normal(0.0, NOISE, voltages.size)
    rows = [f"{0.01 * i:.2f},{v:.3f},{d:.5f}" for i, (v, d) in enumerate(zip(voltages, logged, strict=True))]  # fmt: skip
    (folder / "loops.csv").write_text("\n".join(["t_s,voltage_V,displacement_um", *rows, ""]))
    course = through([0.249, 11.749, 3.749, 8.749, 1.749], 0.25)
    (folder / "course.csv").write_text("\n".join(["displacement_um", *map("{:.4f}".format, course), ""]))  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
