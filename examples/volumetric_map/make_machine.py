"""Make x_terms.csv, y_terms.csv and truth.csv of this example: a mill whose slides are known.

Run ``python make_machine.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep: rigid bodies one after the other, with whole rotations. The
workpiece lies on X on Y, the tool hangs on Z; all errors are those of the tool against the workpiece,
read where an indicator in the spindle stands at Z = 0: a carriage turns about that point, so its own
travel is not a lever. Y takes the guide of X away from the spindle: the roll of X has Y as its lever.
"""

import sys
from pathlib import Path

import numpy as np

SEED, PLACES = 17, 400
X_MM, Y_MM, STEP_MM = 400.0, 300.0, 20.0


def x_errors(x):
    """Return EZX in um, EAX, EBX in urad of the X slide at x in mm."""
    s = x / X_MM
    bow = 3.0 * s * (1.0 - s) * (1.0 + 0.8 * s) - 0.6 * np.sin(7.0 * s)
    return bow, 9.0 * s**2 - 3.0 * np.sin(4.0 * s), 4.0 * np.sin(5.0 * s) + 2.0 * s


def y_errors(y):
    """Return EZY in um, EAY, EBY in urad of the Y slide at y in mm."""
    s = y / Y_MM
    return 1.8 * s**2 - 1.1 * np.sin(4.5 * s), 6.0 * s - 5.0 * s**3, 3.0 * np.cos(3.0 * s)


def turned(a, b, point):
    """Return a point turned about x by a, then about y by b, in rad."""
    x, y, z = point
    y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
    return x * np.cos(b) + z * np.sin(b), y, z * np.cos(b) - x * np.sin(b)


def in_mm(errors):
    """Return errors in mm and rad."""
    return 1e-3 * errors[0], 1e-6 * errors[1], 1e-6 * errors[2]


def tool_z(x, y, z):
    """Return the height in mm of the tool over the table for commands in mm: z if all were right."""
    up, a, b = in_mm(y_errors(y))
    px, py, pz = turned(a, b, (np.zeros_like(x), np.zeros_like(y), z))
    point = px, py + y, pz + up  # now in the carriage of Y, on which X is guided
    up, a, b = in_mm(x_errors(x))
    return turned(a, b, point)[2] + up


def main(folder):
    for letter, length, errors in (("x", X_MM, x_errors), ("y", Y_MM, y_errors)):
        at = np.arange(0.0, length + 1.0, STEP_MM)
        name = letter.upper()
        rows = zip(at, *errors(at), strict=True)
        head = f"{letter}_mm,EZ{name}_um,EA{name}_urad,EB{name}_urad"
        lines = [f"{p:.0f},{z:.4f},{a:.4f},{b:.4f}" for p, z, a, b in rows]
        save(folder / f"{letter}_terms.csv", [head, *lines])
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(0.0, X_MM, PLACES), rng.uniform(0.0, Y_MM, PLACES)
    zero = np.zeros(1)
    off = 1e6 * (tool_z(x, y, np.zeros_like(x)) - tool_z(zero, zero, zero))
    rows = zip(x, y, off, strict=True)
    save(
        folder / "truth.csv",
        ["x_mm,y_mm,error_nm", *(f"{a:.3f},{b:.3f},{e:.1f}" for a, b, e in rows)],
    )


def save(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
