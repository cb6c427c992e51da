"""Plan, tool setting, follow-up error, budget and corrected program of a turned sine grid."""

from pathlib import Path

import metrosep as ms
from metrosep.process import TurningJob, follow_up, identify_setting, setting_tolerance

folder, grid = Path(__file__).parent, ms.forms.SineGrid(amplitude=50e-9, wavelength=100e-6)
print("blocks for 1 nm:", TurningJob(grid, 500e-6, 2e-6, rpm=20).plan(1e-9).n_points)
print(setting_tolerance(grid, 1e-9, radius=500e-6, azimuths=0.0))
found = identify_setting(ms.read(folder / "measured.sdf"), grid, region=(20e-6, 220e-6))
dry, names = ms.read(folder / "dry_run.csv"), {"command": "command_nm", "actual": "actual_nm"}
log = follow_up(dry, **names, spiral=(60e-6, 2e-6, 2.0943951))
pilot = TurningJob(grid, 60e-6, 2e-6, rpm=20, core=4e-6)
path = pilot.path(step=5e-6, distribution="CAL")
print(found.report(), log.coefficients["ca"], sep="\n")  # true: -3.5, -3.5, 100 um; -0.00075 s^2
print(pilot.predict(path, tool=found.setting, follow_up=log).budget.to_frame().to_string())
pilot.compensated(path, tool=found.setting, follow_up=log).to_frame().to_csv("pilot-program.csv")
