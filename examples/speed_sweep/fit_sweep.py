"""Spindle values over speed: growth, and the speed that stands out, against the truth."""

import csv
from pathlib import Path

import numpy as np

from metrosep.separation import fit_speed_sweep

here = Path(__file__).parent
NAMES = ("synchronous", "asynchronous")


def main():
    table = np.genfromtxt(here / "sweep.csv", delimiter=",", names=True)
    result = fit_speed_sweep(
        table["speed_rev_per_min"] / 60,
        {name: table[f"{name}_nm"] * 1e-9 for name in NAMES},
        u={name: table[f"u_{name}_nm"] * 1e-9 for name in NAMES},
        natural_frequency=171.0,
    )
    with (here / "truth.csv").open(encoding="ascii", newline="") as file:
        truth = {row["value"]: row for row in csv.DictReader(file)}
    for name in NAMES:
        fit = result[name]
        for power, key in ((0, "at_rest_nm"), (2, "growth_nm_s2")):
            q, true = fit.coefficient(power), float(truth[name][key])
            away = (q.value * 1e9 - true) / (q.u * 1e9)
            print(f"{name}.c{power}: {q.value * 1e9:.4g}, truth {true:.4g}, {away:+.1f} u away")
    for message in result.messages:
        print("-", message)


if __name__ == "__main__":
    main()
