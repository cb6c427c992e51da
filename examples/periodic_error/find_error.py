"""Scan of an interferometer against a second one in; harmonics of the fringe out."""

import csv
from pathlib import Path

import numpy as np

from metrosep.separation.positions.periodic import periodic_error

folder = Path(__file__).parent

with (folder / "truth.csv").open(encoding="ascii", newline="") as file:
    truth = {row["name"]: float(row["value"]) for row in csv.DictReader(file)}
position, difference = (
    np.loadtxt(folder / "scan.csv", delimiter=",", skiprows=1, unpack=True) * 1e-9
)
period = truth["period_nm"] * 1e-9

before = periodic_error(position, difference, period=period)
after = periodic_error(position, before.corrected, period=period)
for k, name in enumerate(("first", "second")):
    a, u, left = (
        r.audit[n][k]
        for r, n in (
            (before, "amplitudes_nm"),
            (before, "u_amplitudes_nm"),
            (after, "amplitudes_nm"),
        )
    )
    print(
        f"{name:<7} harmonic {a:.3f} nm, u {u:.3f} nm, truth {truth[f'{name}_harmonic_nm']:.3f} nm, left {left:.6f} nm"
    )
print(f"noise of a reading {before.noise.value * 1e9:.3f} nm, truth {truth['noise_nm']:.3f} nm")
for item in before.null_space:
    print(f"not seen: {item}")
