"""A sensor and an index channel in; spindle error motion after ISO 230-7 and its score out."""

from pathlib import Path

import numpy as np

from metrosep.separation.circles.resampling import index_pulses, resample_by_index
from metrosep.separation.circles.spindle import iso230_7

folder = Path(__file__).parent
t_ms, gap_nm, index = np.loadtxt(folder / "spindle.csv", delimiter=",", skiprows=1, unpack=True)
rate = 1e3 / (t_ms[1] - t_ms[0])
table = resample_by_index(gap_nm * 1e-9, index_pulses(index), sampling_rate=rate)
result = iso230_7(table, direction="radial", kmax=30)
print(f"speed {table.speed[0] * 60:.0f} to {table.speed[-1] * 60:.0f} rev/min")
for symbol in ("synchronous", "asynchronous", "total", "asynchronous_4s", "eccentricity"):
    print(f"{symbol:16} {result[symbol]}")
for message in result.messages:
    print("-", message)

degrees, truth_nm = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, unpack=True)
curve_nm = np.interp(
    degrees, np.degrees(result.angle), result.synchronous_motion * 1e9, period=360
)
print(f"synchronous value of the truth {np.ptp(truth_nm):.2f} nm")
print(f"RMS against truth {np.std(curve_nm - truth_nm):.2f} nm")
