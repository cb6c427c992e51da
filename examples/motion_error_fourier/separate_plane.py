"""Both slides after Kono and by the joint method, the map of the plane, and what it leaves."""

from pathlib import Path

import numpy as np

import metrosep as ms
from metrosep.separation.planes.plane_model import plane_map

columns = {"z": "z_um", "feed": "feed_mm_min", "time": "t_ms", "run": "run"}
at, sizes = Path(__file__).parent, {"x": 45e-3, "y": 70e-3}
x, y, z = np.loadtxt(at / "plane.csv", delimiter=",", skiprows=1).T * [[1e-3], [1e-3], [1e-6]]
runs = {a: ms.read_runs(at / f"runs_{a}.csv", x=f"{a}_mm", **columns) for a in "xy"}
line = np.c_[x, y, np.ones(x.size)]  # alignments and piston
for how in ({"method": "kono"}, {"method": "kono", "shortest": 4e-3}, {"method": "joint"}):
    e = [ms.separation.separate(runs[a], start=0, length=sizes[a], **how) for a in "xy"]
    left = z - plane_map(*e, dx=3e-3, dy=0.5e-3).surface.z.T.ravel()
    pv = [1e6 * np.ptp(v - line @ np.linalg.lstsq(line, v)[0]) for v in (z, left)]
    print(how, f"m {e[1].audit.get('m')}: {pv[0]:.2f} -> {pv[1]:.2f} um (paper 1.3 -> 0.5)")
