"""Known terms of a mill to the map Z(X, Y) of three controllers: ``python maps.py FOLDER``."""

import sys
from pathlib import Path

import numpy as np

from metrosep import controllers
from metrosep.compensation import rank_one, tables_from_machine
from metrosep.machine import Chain
from metrosep.machine.terms import TableTerm

here, terms, SI = Path(__file__).parent, {}, {"mm": 1e-3, "um": 1e-6, "urad": 1e-6}
for axis in "xy":
    columns = np.genfromtxt(here / f"{axis}_terms.csv", delimiter=",", names=True)
    at, *names = columns.dtype.names
    for name, unit in (n.split("_") for n in names):
        values = columns[f"{name}_{unit}"] * SI[unit]
        terms[name] = TableTerm(columns[at] * SI["mm"], values)
grid = {"X": np.linspace(0.0, 0.4, 21), "Y": np.linspace(0.0, 0.3, 16)}
mill = Chain.from_toml(here / "machine.toml")
tables = tables_from_machine(
    mill, terms, over=("X", "Y"), positions=grid, at={"Z": 0.0}, corrects=["Z"]
)
print(tables, *tables.messages, *rank_one(tables["Z"]).messages, sep="\n")


def error(x, y):
    """Return the error of Z by the chain, for the dry-run of the very files."""
    return tables.residual({"X": x, "Y": y}, sign=0)[..., 2]


MAPS = {
    "csv-map": ("z_of_xy.csv", {}),
    "linuxcnc-eoffset": ("z_of_xy.py", {}),
    "aerotech": ("z_of_xy.cal", {"row_axis": 2, "column_axis": 1, "corrected_axis": 3,
                                 "row_sign": 1, "column_sign": 1, "corrected_sign": -1}),
}  # fmt: skip
for name, (file, facts) in MAPS.items():
    target = Path(sys.argv[1]) / file
    proof = controllers.write(tables["Z"], target, name, verified_against=error, **facts)
    print(f"{name}: dry-run {proof.before_rms * 1e9:.0f} -> {proof.after_rms * 1e9:.1f} nm RMS")
