"""One correction X -> Z, a file for each controller that holds it: ``python tables.py FOLDER``."""

import sys
from pathlib import Path

import metrosep as ms

CARRIERS = {  # facts of this machine, where they are not those of the controller's own example
    "linuxcnc": {"cross_axis": "hal"}, "csv": {}, "linuxcnc-lincurve": {}, "pmac": {"target_motor": 2},
    "aerotech-line": {"corrected_axis": 3}, "sinumerik-cec": {}, "isg-cross": {},
    "heidenhain": {}, "mitsubishi": {"cross_axis": "tried"},
    "pi-gcs": {}, "nv200": {}, "voltage": {}, "etalon": {},
}  # fmt: skip
columns = {"x": "x_mm", "z": "z_um", "feed": "feed_mm_min", "time": "t_ms", "run": "run"}
recorded = Path(__file__).parents[1] / "straightness" / "runs.csv"
runs = ms.read_runs(recorded, **columns)
error = ms.separation.separate(runs, start=0.0, length=45e-3)
table = ms.compensation.CompensationTable.from_error(
    error, positions="0.25 mm", axis="X", compensates="Z"
)
for name, facts in CARRIERS.items():
    info = ms.controllers.find(name).info
    used = {"travel_low": 0.0, "travel_high": 45e-3}  # the runs reach beyond it
    options = {"verified_against": runs, **used, **info.example, **facts}
    tried = info.sign == "unconfirmed"  # on a real machine: only after the trial table was seen
    file = Path(sys.argv[1]) / f"{name}{info.suffix}"
    proof = ms.controllers.write(table, file, name, sign_confirmed=tried, **options)
    print(f"{name:17s} dry-run {proof.before_rms * 1e9:.1f} -> {proof.after_rms * 1e9:.1f} nm RMS")
