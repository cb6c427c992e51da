"""Stage, straightness, polynomial, voltages, and the part before and after, beside the paper."""

from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.process import before_after, drive_table, flexure_calibration, run_polynomial

names = ("stage.csv", "face.csv", "part_before.csv", "part_after.csv")
files = [Path(__file__).parent / name for name in names]
(volt, um), (run, x, z) = (np.loadtxt(f, delimiter=",", skiprows=1).T for f in files[:2])
sweep = ms.Recording(np.arange(123.0), {"voltage": volt, "displacement": 1e-6 * um})
runs = [ms.Profile(1e-3 * x[run == k], 1e-6 * z[run == k]) for k in range(1, 6)]
stage, line = flexure_calibration(sweep), run_polynomial(runs, quantity="error", degree=2)
table = drive_table(runs[0].x, line.evaluate(runs[0].x), quantity="error", calibration=stage)
parts = before_after(*map(ms.read, files[2:]), lambda_c=0.25e-3)
print(stage.quantities["sensitivity"], table.voltage[[0, -1]], "V", table.violations, parts.ratio)
print("y =", -line.coefficients * [1e6, 1e3, 1], "um, mm; paper 0.3389, 0.48246, -0.00605")
