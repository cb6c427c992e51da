"""Warm-up, A-B-B-A sequence and speed series in; ranges and coefficients against the truth out."""

import csv
from pathlib import Path

import numpy as np

from metrosep.separation import abba, iso230_3_drift, joint_drift
from metrosep.separation.drift.dependence import drift_against_temperature, speed_dependence

folder = Path(__file__).parent


def read(name):
    with (folder / name).open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def line(name, value, u, true, unit):
    print(f"{name:<22}{value:8.3f} {unit}, u {u:.3f} {unit}, truth {true:.3f} {unit}")


table = read("truth.csv")
truth = dict(zip(table["name"], table["value"].astype(float), strict=True))

data = read("warm_up.csv")
t = data["t_s"].astype(float)
channels = {n: data[f"{n}_um"].astype(float) * 1e-6 for n in ("EX0C", "EY0C", "EZ0C")}
test = iso230_3_drift(
    t, channels, kind="spindle", windows=[(0, t[-1]), (0, 3600), (t[-1] - 3600, t[-1])]
)
print(test.to_frame().round(3).to_string(index=False))
q = test.combined[0]
line("combined range, 4 h", q.value * 1e6, q.u * 1e6, truth["combined_range_um"], "um")

fit = drift_against_temperature(data["temperature_degC"].astype(float), channels["EZ0C"])
q = fit.coefficients["c1"]
line("EZ0C per kelvin", q.value * 1e6, q.u * 1e6, truth["per_kelvin_um"], "um")

data = read("sequence.csv")
t, z = data["t_s"].astype(float), data["reading_nm"].astype(float) * 1e-9
plain = abba(z, t=t)
line("A - B, A-B-B-A", plain.difference * 1e9, plain.u * 1e9, truth["step_nm"], "nm")
value, u = joint_drift(t, z, data["master"].tolist(), degree=2).difference("A", "B")
line("A - B, joint fit", value * 1e9, u * 1e9, truth["step_nm"], "nm")

data = read("speeds.csv")
fit = speed_dependence(
    data["speed_rev_per_s"].astype(float), data["amplitude_nm"].astype(float) * 1e-9
)
q = fit.coefficients["c0"]
line("amplitude at rest", q.value * 1e9, q.u * 1e9, truth["rest_nm"], "nm")
q = fit.coefficients["c2"]
line("growth with speed^2", q.value * 1e12, q.u * 1e12, truth["per_speed2_pm"], "pm")
