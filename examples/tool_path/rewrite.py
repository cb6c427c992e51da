"""Put the measured error of the part into its program: ``python rewrite.py CORRECTED.nc``."""

import math
import sys
from pathlib import Path

import metrosep as ms
from metrosep.controllers import error_correction, rewrite_path

folder = Path(__file__).parent
error = ms.read(folder / "measured.sdf")  # actual - nominal, in nm out of the material
found = error_correction(error, c_sense=-1, c_zero=math.radians(30.0), centre="middle")
done = rewrite_path(folder / "part.nc", sys.argv[1], found, tolerance=2e-9)
low, high = (f"{1e9 * c:.0f} nm" for c in done.correction)
print(f"{done.n_changed} of {done.n_blocks} blocks, {low} to {high}, {done.n_added} added")
