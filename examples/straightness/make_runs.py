"""Make runs.csv and truth.csv of this example: a simulated slide with a known error.

Run ``python make_runs.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np

from metrosep.separation import machine_axis

SEED = 2008


def main(folder):
    axis = machine_axis(seed=SEED, disturbance="floor")
    lines = ["run,feed_mm_min,t_ms,x_mm,z_um"]
    for run in axis.runs:
        lines += [
            f"{run.run_id},{run.feed * 6e4:.0f},{t * 1e3:.0f},{x * 1e3:.4f},{z * 1e6:.5f}"
            for t, x, z in zip(run.t, run.x, run.z, strict=True)
        ]
    (folder / "runs.csv").write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")
    x = np.linspace(axis.start, axis.stop, 451)
    rows = [f"{a * 1e3:.1f},{e * 1e6:.6f}" for a, e in zip(x, axis.truth(x), strict=True)]
    text = "x_mm,e_um\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
