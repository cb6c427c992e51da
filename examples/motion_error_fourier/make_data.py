"""Make the data of this example: two slides measured at three feedrates, a plane, and a cut profile.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. Geometric error has a fixed wavelength (the lead of the screw
is 10 mm), the vibration of the column a fixed frequency: 0.533, 0.8 and 1.067 mm at the three feeds.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 2008
LENGTH_MM = {"x": 45.0, "y": 70.0}
WAVES_UM = {  # wavelength in mm: amplitude; X has an aerostatic guide and a fifth of Y's error
    "x": {42.0: 0.02, 20.0: 0.012, 10.0: 0.076, 5.0: 0.01},
    "y": {63.0: 0.06, 31.0: 0.03, 10.0: 0.38, 5.0: 0.06},
}
FEEDS, RUNS, RATE_HZ = (4800, 7200, 9600), 2, 500.0  # mm/min
VIBRATION_HZ, VIBRATION_UM, NOISE_UM, COPIED = 150.0, 0.15, 0.02, 0.25
ALPHA_UM_MM, BETA_UM_MM = 0.002, -0.003  # alignment along y and along x
PICK_MM, PLANE_STEP_MM, LOW_PASS_HZ = 3.0, 0.5, 50.0


def truth(axis, position):
    """Return the geometric error in um, no line removed; phases belong to the axis."""
    phase = np.random.default_rng([SEED, ord(axis)])
    waves = [
        a * np.sin(2 * np.pi * position / w + phase.uniform(0, 2 * np.pi))
        for w, a in WAVES_UM[axis].items()
    ]
    return np.sum(waves, axis=0)


def shaking(rng, t):
    """Return the vibration of the column: 150 Hz, its phase wanders, and differs from run to run."""
    wander = np.cumsum(rng.standard_normal(t.size)) * np.sqrt(40.0 * (t[1] - t[0]))
    return VIBRATION_UM * np.sqrt(2) * np.sin(2 * np.pi * VIBRATION_HZ * t + wander)


def runs(rng, axis):
    """Return rows of run, feed, time, position and reading; the travel is longer than the range."""
    rows, length = [], LENGTH_MM[axis]
    for feed in FEEDS:
        for _ in range(RUNS):
            t = np.arange(0.0, 1.25 * length / (feed / 60.0), 1.0 / RATE_HZ)
            x = -length / 8 + feed / 60.0 * t
            z = truth(axis, x) + shaking(rng, t) + NOISE_UM * rng.standard_normal(t.size)
            z += 0.05 * rng.standard_normal() + {"x": BETA_UM_MM, "y": ALPHA_UM_MM}[axis] * x
            number = 1 + (rows[-1][0] if rows else 0)
            rows += [
                (number, feed, f"{1e3 * a:.0f}", f"{b:.2f}", f"{c:.3f}")
                for a, b, c in zip(t, x, z, strict=True)
            ]
    return rows


def low_pass(z, rate):
    """Return z after the 50 Hz filter of the paper, taken as first order, once each way: no delay."""
    pole = np.exp(-2 * np.pi * LOW_PASS_HZ / rate)
    for _ in range(2):
        out, last = np.empty_like(z), z[0]
        for i, value in enumerate(z):
            last = out[i] = pole * last + (1 - pole) * value
        z = out[::-1]
    return z


def lines(rng):
    """Return rows of x, y, z of the plane: lines along y at 7200 mm/min, filtered at 50 Hz."""
    rows = []
    speed = 7200 / 60.0
    for x in np.arange(0.0, LENGTH_MM["x"] + 0.1, PICK_MM):
        t = np.arange(-10.0, LENGTH_MM["y"] + 10.0, speed / 1000.0) / speed
        y = speed * t
        z = truth("x", x) + truth("y", y) + ALPHA_UM_MM * y + BETA_UM_MM * x
        z = low_pass(z + shaking(rng, t) + NOISE_UM * rng.standard_normal(t.size), 1000.0)
        kept = np.arange(0.0, LENGTH_MM["y"] + 0.1, PLANE_STEP_MM)
        rows += [
            (f"{x:g}", f"{b:g}", f"{c:.3f}")
            for b, c in zip(kept, np.interp(kept, y, z), strict=True)
        ]
    return rows


def profile(rng):
    """Return rows of y, relative displacement and cut profile on the middle line, unfiltered."""
    t = np.arange(0.0, LENGTH_MM["y"] / 120.0, 1e-3)
    y, shake = 120.0 * t, shaking(rng, t)
    moved = truth("y", y) + shake + NOISE_UM * rng.standard_normal(t.size)
    cut = truth("y", y) + COPIED * shake
    return [(f"{a:.2f}", f"{b:.4f}", f"{c:.4f}") for a, b, c in zip(y, moved, cut, strict=True)]


def main(folder):
    rng = np.random.default_rng(SEED)
    for axis in "xy":
        save(folder / f"runs_{axis}.csv", f"run,feed_mm_min,t_ms,{axis}_mm,z_um", runs(rng, axis))
    save(folder / "plane.csv", "x_mm,y_mm,z_um", lines(rng))
    save(folder / "profile.csv", "y_mm,displacement_um,cut_um", profile(rng))
    at = {axis: np.arange(0.0, length + 0.1, 1.0) for axis, length in LENGTH_MM.items()}
    rows = [
        (a, f"{p:g}", f"{e:.5f}")
        for a in "xy"
        for p, e in zip(at[a], truth(a, at[a]), strict=True)
    ]
    save(folder / "truth.csv", "axis,position_mm,e_um", rows)


def save(path, header, rows):
    text = "\n".join([header, *(",".join(str(v) for v in row) for row in rows)]) + "\n"
    path.write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
