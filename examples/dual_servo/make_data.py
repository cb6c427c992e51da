"""Make the data of this example: a slide of 40 mm with a piezo stage, after the dual-servo paper.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. error = actual - nominal, positive out of the material; the
polynomial of the paper, 0.3389 + 0.48246 x - 0.00605 x^2 (um, mm), is the compensation, the error
its negative.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 4040
POLYNOMIAL_UM = (0.3389, 0.48246, -0.00605)  # of the compensation, x in mm
X_MM = np.arange(0.0, 40.25, 0.5)
RUNS, NOISE_NM, OFFSET_NM, DRIFT_NM, RIPPLE_NM = 5, 20.0, 50.0, 30.0, 50.0
FULL_UM, BEND_UM, LOOP_UM = 16.6, 0.10, 0.20  # stage: 10 V, bulge of the mean, width of the loop
RATE_HZ, REST_S = 500.0, 4.0
PART_MM, STEP_MM = 4.0, 0.002


def error_um(x):
    """Return the error of the slide against the spindle face, x in mm."""
    ripple = 1e-3 * RIPPLE_NM * np.sin(2 * np.pi * x / 2.0 + 0.4)
    return -np.polyval(POLYNOMIAL_UM[::-1], x) + ripple


def stage_um(volt, rising):
    """Return the displacement of the stage: line, bulge, and half the loop to either side."""
    share = volt / 10.0
    bulge = 4.0 * share * (1.0 - share)
    return FULL_UM * share + BEND_UM * bulge + np.where(rising, -0.5, 0.5) * LOOP_UM * bulge


def coloured(rng, n, poles):
    """Return noise of unit RMS from a chain of first-order low-passes."""
    z = rng.standard_normal(n + 500)
    for pole in poles:
        for i in range(1, z.size):
            z[i] += pole * z[i - 1]
    return z[500:] / z[500:].std()


def sweeps(rng):
    """Return voltage and displacement of three sweeps up and down; the sensor resolves 5 nm."""
    rising = np.arange(0.0, 10.25, 0.5)
    once_v = np.concatenate([rising, rising[-2::-1]])
    once_d = np.concatenate([stage_um(rising, True), stage_um(rising[-2::-1], False)])
    v, d = np.tile(once_v, 3), np.tile(once_d, 3)
    return v, 0.005 * np.round((d + 3e-3 * rng.standard_normal(d.size)) / 0.005)


def runs(rng):
    """Return run number, position and reading of sensor 1, which looks at the spindle face."""
    rows = []
    for k in range(RUNS):
        start, slope = rng.standard_normal(2) * (OFFSET_NM, DRIFT_NM)
        drift = 1e-3 * (start + slope * (X_MM - 20.0) / 40.0)
        z = error_um(X_MM) + drift + 1e-3 * NOISE_NM * rng.standard_normal(X_MM.size)
        rows += [(k + 1, x, v) for x, v in zip(X_MM, z, strict=True)]
    return rows


def part(rng, waves_nm, rough_nm):
    """Return a profile of the part, piece of 4 mm: waves of 1.6 mm and 0.05 mm, and tool marks."""
    x = np.arange(0.0, PART_MM + STEP_MM / 2, STEP_MM)
    z = waves_nm[0] * np.sin(2 * np.pi * x / 1.6 + 0.7) + waves_nm[1] * np.sin(
        2 * np.pi * x / 0.05
    )
    z += rough_nm * coloured(rng, x.size, (0.7,)) + 300.0 * x  # the part lies a little askew
    return [(f"{a:.3f}", f"{b:.2f}") for a, b in zip(x, z, strict=True)]


def main(folder):
    rng = np.random.default_rng(SEED)
    pairs = zip(*sweeps(rng), strict=True)
    save(
        folder / "stage.csv",
        "voltage_V,displacement_um",
        ((f"{v:g}", f"{d:.3f}") for v, d in pairs),
    )
    save(
        folder / "face.csv", "run,x_mm,z_um", ((k, f"{x:g}", f"{z:.4f}") for k, x, z in runs(rng))
    )
    table = 12.0 * X_MM / 40.0 - 0.5 * np.sin(np.pi * X_MM / 40.0)
    table = table + 5e-3 * rng.standard_normal(X_MM.size)  # sensor 2, against the granite
    save(
        folder / "table.csv",
        "x_mm,z_um",
        ((f"{x:g}", f"{z:.4f}") for x, z in zip(X_MM, table, strict=True)),
    )
    t = np.arange(int(REST_S * RATE_HZ)) / RATE_HZ
    without, with_stage = (
        36.0 * coloured(rng, t.size, (0.98,)),
        4.2 * coloured(rng, t.size, (0.5,)),
    )
    with_stage[rng.integers(0, t.size, 4)] += 90.0  # doors: the paper's "environmental noise"
    rest = (
        (f"{a:.3f}", f"{b:.1f}", f"{c:.1f}")
        for a, b, c in zip(t, without, with_stage, strict=True)
    )
    save(folder / "at_rest.csv", "t_s,without_nm,with_nm", rest)
    volt = np.polyval(POLYNOMIAL_UM[::-1], X_MM) * 10.0 / FULL_UM  # as the paper drives it
    left = error_um(X_MM) + stage_um(np.clip(volt, 0.0, 10.0), True)
    left = left + 1e-3 * NOISE_NM * rng.standard_normal(X_MM.size)
    pair = zip(X_MM, error_um(X_MM), left, strict=True)
    save(
        folder / "driven.csv",
        "x_mm,without_um,with_um",
        ((f"{x:g}", f"{a:.4f}", f"{b:.4f}") for x, a, b in pair),
    )
    save(folder / "part_before.csv", "x_mm,z_nm", part(rng, (515.0, 66.0), 31.0))
    save(folder / "part_after.csv", "x_mm,z_nm", part(rng, (139.0, 3.5), 4.0))
    names = [f"c{k}_um_mm{k},{c}" for k, c in enumerate(POLYNOMIAL_UM)]
    truth = [*names, f"sensitivity_um_V,{FULL_UM / 10}", f"hysteresis_um,{LOOP_UM}"]
    save(folder / "truth.csv", "name,value", (row.split(",") for row in truth))


def save(path, header, rows):
    lines = [header, *(",".join(str(v) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
