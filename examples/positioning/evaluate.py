"""Positioning test and diagonals in; ISO 230-2 values and squareness against the truth out."""

import csv
from pathlib import Path

from metrosep.separation.planes.diagonals import iso230_6_diagonals
from metrosep.separation.positions.positioning import iso230_2, positions_from_columns

folder = Path(__file__).parent
SIZE = (0.5, 0.4, 0.3)  # m


def positions(rows):
    """Columns of a CSV in mm to the arguments of iso230_2 in m."""
    reached = [[float(v) * 1e-3 for k, v in r.items() if k.startswith("reached")] for r in rows]
    return positions_from_columns(
        [float(r["target_mm"]) * 1e-3 for r in rows], [r["direction"] for r in rows], reached
    )


def read(name):
    with (folder / name).open(encoding="ascii", newline="") as file:
        return list(csv.DictReader(file))


truth = {row["name"]: float(row["value"]) for row in read("truth.csv")}
test = iso230_2(*positions(read("runs.csv")))
print(test)
low, high = test.R_interval
rows = [
    ("E", test["E"].value, test["E"].u, truth["systematic_um"]),
    ("B_mean", test["B_mean"].value, test["B_mean"].u, truth["reversal_um"]),
    ("M", test["M"].value, test["M"].u, truth["mean_range_um"]),
    ("R", test["R"].value, test["R"].u, truth["repeatability_um"]),
    ("R_unbiased", test.R_unbiased, (high - low) / 3.92, truth["repeatability_um"]),
]
for name, value, u, true in rows:
    print(f"{name:<11}{value * 1e6:8.2f} um, u {u * 1e6:.2f} um, truth {true:.2f} um")

table = read("diagonals.csv")
names = dict.fromkeys(row["diagonal"] for row in table)
diagonals = iso230_6_diagonals(
    {name: positions([r for r in table if r["diagonal"] == name]) for name in names}, size=SIZE
)
for pair, q in diagonals.squareness.angles.items():
    print(
        f"a_{pair}       {q.value * 1e6:8.2f} urad, u {q.u * 1e6:.2f} urad, "
        f"truth {truth[f'a_{pair}_urad']:.2f} urad"
    )
