"""Nine runs in; machine error, proven table and the score against the known truth out."""

from pathlib import Path

import numpy as np

import metrosep as ms

folder = Path(__file__).parent
runs = ms.read_runs(
    folder / "runs.csv", x="x_mm", z="z_um", feed="feed_mm_min", time="t_ms", run="run"
)
estimate = ms.separation.separate(runs, start=0.0, length=45e-3)
table = ms.compensation.CompensationTable.from_error(
    estimate, positions="0.25 mm", axis="X", compensates="Z"
)
proof = table.verify(runs, travel=(0.0, 45e-3))  # the runs reach beyond the travel that is used
x_mm, truth_um = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, unpack=True)
rest = estimate.evaluate(x_mm * 1e-3) - truth_um * 1e-6
rest -= np.polyval(np.polyfit(x_mm, rest, 1), x_mm)
print(estimate)
print(*proof.sentences, sep="\n")
print(f"dry-run RMS {proof.before_rms * 1e9:.0f} -> {proof.after_rms * 1e9:.0f} nm")
print(f"RMS against truth {rest.std() * 1e9:.1f} nm")
