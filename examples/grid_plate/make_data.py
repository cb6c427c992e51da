"""Make views.csv and truth.csv of this example: a grid plate on an XY stage, four placements.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N, PITCH_MM, N_REPEATS = 1997, 9, 10.0, 2
NOISE_NM, SLIP_NM, SKEW_URAD = 8.0, 3000.0, 20.0
VIEWS = {"initial": (0, 0, 0), "rotated": (1, 0, 0), "shifted": (0, 1, 0), "back": (2, 0, 1)}
"""Quarter turns of the plate from x towards y, and shift in pitches along x and y after the turn."""


def stage(x, y):
    """Return what the stage adds to a reading, in nm; x and y in mm from its centre."""
    bent = np.stack([0.06 * y**2 - 1.2 * x, 0.04 * x**2 + 0.7 * x * y / 10], axis=-1)
    wave = np.stack([40 * np.sin(y / 9 + 0.3), 25 * np.cos(x / 7)], axis=-1)
    return bent + wave


def plate(rng):
    """Return the errors of the marks in nm, by row and column of the plate: writing errors."""
    rows = 30 * np.sin(np.arange(N) * 1.1)[:, None]
    out = 35 * rng.standard_normal((N, N, 2))
    out[..., 0] += rows
    return out


def placed(marks, turns, right, up):
    """Return mark errors by site of the stage: plate turned, then shifted; NaN where no mark is."""
    for _ in range(turns):  # a quarter turn from x to y: the mark at (x, y) comes to (-y, x)
        marks = np.rot90(marks, -1)
        marks = np.stack([-marks[..., 1], marks[..., 0]], axis=-1)
    out = np.full_like(marks, np.nan)
    out[up:, right:] = marks[: N - up, : N - right]
    return out


def main(folder):
    rng = np.random.default_rng(SEED)
    line = (np.arange(N) - (N - 1) / 2) * PITCH_MM
    x, y = np.meshgrid(line, line)
    own, marks = stage(x, y), plate(rng)
    lines = ["repeat,view,x_mm,y_mm,ex_nm,ey_nm"]
    for name, (turns, right, up) in VIEWS.items():
        slip, skew = SLIP_NM * rng.standard_normal(2), SKEW_URAD * rng.standard_normal()
        turned = skew * np.stack([-y, x], axis=-1)  # urad times mm is nm
        seen = own + placed(marks, turns, right, up) + slip + turned
        for repeat in range(1, N_REPEATS + 1):
            e = seen + NOISE_NM * rng.standard_normal(seen.shape)
            for i, j in np.ndindex(N, N):
                if np.isfinite(e[i, j]).all():
                    row = f"{repeat},{name},{line[j]:g},{line[i]:g}"
                    lines.append(f"{row},{e[i, j, 0]:.1f},{e[i, j, 1]:.1f}")
    write(folder / "views.csv", lines)
    lines = ["x_mm,y_mm,stage_x_nm,stage_y_nm,plate_x_nm,plate_y_nm"]
    for i, j in np.ndindex(N, N):
        values = ",".join(f"{v:.3f}" for v in (*own[i, j], *marks[i, j]))
        lines.append(f"{line[j]:g},{line[i]:g},{values}")
    write(folder / "truth.csv", lines)


def write(path, lines):
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
