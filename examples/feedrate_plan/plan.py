"""Measured disturbance in; feeds of nine runs out, checked with the true disturbance."""

from pathlib import Path

import pandas as pd

from metrosep.separation.runs.planner import plan_feedrates, predicted_sd

folder = Path(__file__).parent
measured = pd.read_csv(folder / "density.csv")
true = pd.read_csv(folder / "truth.csv")
LENGTH = 70e-3
WAVES = [20e-3, 10e-3, 5e-3, 3.3e-3, 2e-3]  # the lead is 10 mm

usual = predicted_sd(measured, [0.12] * 9, WAVES, LENGTH)
plan = plan_feedrates(measured, WAVES, 0.08, 0.16, 9, length=LENGTH)
check = predicted_sd(true, plan.feeds, WAVES, LENGTH)

print("nine runs at 7200 mm/min:", *usual.messages, sep="\n  ")
print(f"plan: {plan}, {plan.audit['efficiency']:.0%} of the best that any plan can reach")
print(
    f"travel: {usual.audit['time_s']:.1f} s at 7200, {plan.audit['time_s']:.1f} s in the plan",
    *plan.messages,
    sep="\n",
)
for row, sure, old in zip(plan.sd.itertuples(), check.sd["sd_nm"], usual.sd["sd_nm"], strict=True):
    print(
        f"{row.wavelength_mm:5.1f} mm: all at 7200 {old:5.1f} nm, plan {row.sd_nm:4.2f} nm, "
        f"with the true disturbance {sure:4.2f} nm"
    )
