"""Make warm_up.csv, sequence.csv, speeds.csv and truth.csv: drift of a simulated spindle.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 2303
GROWTH = {"EX0C": 2.0e-6, "EY0C": -3.0e-6, "EZ0C": 9.0e-6}
"""Change of each displacement for a fully warm spindle, m."""

TIME_CONSTANT = 2400.0
PER_KELVIN = 1.5e-6
"""Of EZ0C, m/K; the spindle warms by 6 K."""

STEP = 42e-9
"""Height of master A above master B, m."""

REST, PER_SPEED2 = 18e-9, 9e-12
"""Synchronous amplitude at rest, m, and its growth with the square of speed, m s^2."""


def main(folder):
    rng = np.random.default_rng(SEED)
    t = np.arange(0.0, 4 * 3600.0 + 1, 60.0)
    warm = 1.0 - np.exp(-t / TIME_CONSTANT)
    columns = [20.0 + 6.0 * warm + 0.02 * rng.normal(size=t.size)]
    columns += [g * warm * 1e6 + 0.02 * rng.normal(size=t.size) for g in GROWTH.values()]
    names = ",".join(f"{n}_um" for n in GROWTH)
    _table(
        folder / "warm_up.csv",
        f"t_s,temperature_degC,{names}",
        "%.0f,%.3f,%.4f,%.4f,%.4f",
        [t, *columns],
    )

    labels = "ABBA" * 6
    t = 30.0 * np.arange(24)
    level = np.array([STEP if name == "A" else 0.0 for name in labels])
    reading = level + 1.2e-10 * t + 8e-14 * t**2 + 1.5e-9 * rng.normal(size=24)
    rows = [f"{a:.0f},{n},{z * 1e9:.3f}" for a, n, z in zip(t, labels, reading, strict=True)]
    _write(folder / "sequence.csv", ["t_s,master,reading_nm", *rows])

    speed = np.array([5, 10, 15, 20, 25, 30, 35, 40, 45, 50], dtype=float)
    amplitude = REST + PER_SPEED2 * speed**2 + 0.4e-9 * rng.normal(size=10)
    _table(
        folder / "speeds.csv",
        "speed_rev_per_s,amplitude_nm",
        "%.0f,%.3f",
        [speed, amplitude * 1e9],
    )

    truth = {
        "combined_range_um": np.sqrt(sum((g * warm[-1]) ** 2 for g in GROWTH.values())) * 1e6,
        "per_kelvin_um": PER_KELVIN * 1e6,
        "step_nm": STEP * 1e9,
        "rest_nm": REST * 1e9,
        "per_speed2_pm": PER_SPEED2 * 1e12,
    }
    _write(folder / "truth.csv", ["name,value", *(f"{k},{v:.4f}" for k, v in truth.items())])


def _table(path, header, form, columns):
    _write(path, [header, *(form % row for row in zip(*columns, strict=True))])


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
