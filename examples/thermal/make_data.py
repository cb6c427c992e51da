"""Make warm_up.csv, today.csv and truth.csv: a spindle column that heats up, and what probes read.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written. The
column is a steel rod of 400 mm, heated at its upper end (the spindle), cooled by the room, cut into
slices and integrated by small steps: no library code. The spindle hangs from its upper end, so its nose
sinks as the rod grows; a second rod behind it stays cooler, and the column nods. Thermometers stand near
the bearing, on the column and in the room, none of them where the heat is made.
"""

import sys
from pathlib import Path

import numpy as np

GROWTH = 11.5e-6  # 1/K
LENGTH, DEPTH = 0.4, 0.3  # m, of a rod, and between both rods
SLICES = 40
CONDUCT = 14e-6  # m^2/s
LOSS = 1 / (3 * 3600.0)  # 1/s, to the room
STEP = 120.0  # s


def rods(power, room):
    """Growth of the hot and the cool rod, and temperatures at 60 and 260 mm of the hot one, degC."""
    dx = LENGTH / SLICES
    n = int(np.ceil(STEP * CONDUCT / dx**2 / 0.4))
    h = STEP / n
    both = np.full((2, SLICES), room[0])
    share = np.array([1.0, 0.35])  # of the heat
    rows = []
    for heat, air in zip(power, room, strict=True):
        grown = GROWTH * dx * (both - 20.0).sum(axis=1)
        rows.append([*grown, both[0, int(0.06 / dx)], both[0, int(0.26 / dx)]])
        for _ in range(n):
            flow = np.diff(both, axis=1) * CONDUCT / dx**2
            change = -LOSS * (both - air)
            change[:, :-1] += flow
            change[:, 1:] -= flow
            change[:, 0] += heat * share
            both = both + h * change
    return np.array(rows).T


def record(rng, hours):
    """Time, three thermometers, drop of the nose and nod of the column; the truth of both."""
    n = int(hours * 3600 / STEP)
    t = STEP * np.arange(n)
    power, at = np.zeros(n), 10
    while at < n:
        spell = int(rng.integers(12, 50))
        power[at : at + spell] = rng.choice([0.0, 0.008, 0.02])
        at += spell
    room = 20.0 + 0.8 * (1 - np.cos(2 * np.pi * t / (8 * 3600.0)))
    hot, cool, near, far = rods(power, room)
    drop = -(hot - hot[0])
    nod = (hot - hot[0] - cool + cool[0]) / DEPTH  # rad
    sensors = [v + 0.01 * rng.normal(size=n) for v in (near, far, room)]
    return t, sensors, drop, nod


def write(path, rng, hours):
    """Write one record; return its last row of truth."""
    t, sensors, drop, nod = record(rng, hours)
    read = drop + 30e-9 * rng.normal(size=t.size), nod + 0.1e-6 * rng.normal(size=t.size)
    rows = ["t_s,bearing_degC,column_degC,room_degC,EZZ_um,EBX_urad"]
    for i in range(t.size):
        temperatures = ",".join(f"{s[i]:.3f}" for s in sensors)
        rows.append(f"{t[i]:.0f},{temperatures},{read[0][i] * 1e6:.3f},{read[1][i] * 1e6:.2f}")
    path.write_text("\n".join(rows) + "\n", "utf-8")
    return drop[-1], nod[-1]


def main(folder):
    rng = np.random.default_rng(2303)
    write(folder / "warm_up.csv", rng, 20.0)
    drop, nod = write(folder / "today.csv", rng, 6.0)
    rows = ["quantity,value", f"EZZ_um,{drop * 1e6:.3f}", f"EBX_urad,{nod * 1e6:.3f}"]
    (folder / "truth.csv").write_text("\n".join(rows) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
