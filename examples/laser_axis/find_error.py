"""Readings of a laser in; errors of the axis out, and ISO 230-2 of the corrected positions."""

import csv
from pathlib import Path

import numpy as np

from metrosep.recipe import Recipe
from metrosep.separation import iso230_2
from metrosep.separation.positions.positioning import positions_from_columns

folder = Path(__file__).parent

with (folder / "truth.csv").open(encoding="ascii", newline="") as file:
    truth = np.array([float(row["error_nm"]) for row in csv.DictReader(file)])

found = Recipe.load(folder / "recipe.toml").run().produced
error = 1e9 * found.separation.error.reshape(5, -1).mean(axis=0)
as_read = 1e9 * found.separation.as_read.reshape(5, -1).mean(axis=0)
u = 1e9 * float(found.made.u[found.made.farthest])
print(f"as read   largest difference from the truth {np.abs(as_read - truth).max():.1f} nm")
print(
    f"corrected largest difference from the truth {np.abs(error - truth).max():.1f} nm, u {u:.1f} nm"
)
for name, value in found.made.budget().items():
    print(f"    {name:<28} u {1e9 * value:.1f} nm")

table = dict(found.table)
runs = np.column_stack([table[k] for k in table if k.startswith("run")])
test = iso230_2(*positions_from_columns(table["target_m"], table["direction"], runs))
print(f"B_mean {test['B_mean'].value * 1e9:.1f} nm, truth 800.0 nm")
