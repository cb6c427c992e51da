"""Make the maps and truths of this example: an interferometer with a transmission sphere.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
patch_01.csv ... are maps of a ball turned at random, confocal.csv, confocal_180.csv and cats_eye.csv
those of a concave mirror in three positions. The simulator uses no code of metrosep.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_PATCHES, NOISE_NM = 1998, 12, 0.3
BALL_N, SPHERE_N, STEP_MM = 21, 25, 1.0
HALF_ANGLE = np.radians(20.0)
"""Of the aperture, seen from the centre of the ball."""


def arm(x, y):
    """Return the error of the reference arm in nm, over the unit disc."""
    return 9 * (x**3 - x * y**2) + 4 * x * y


def diverger(x, y):
    """Return the error of the diverger in nm; it has odd and even shares."""
    return (
        7 * (3 * (x**2 + y**2) - 2) * y
        - 5 * (x**2 + y**2) ** 2
        + 3 * np.exp(-((x - 0.4) ** 2) * 9)
    )


def mirror(x, y):
    """Return the form of the concave mirror in nm."""
    return 11 * (x**2 - y**2) + 6 * x * (x**2 + y**2) + 8 * np.exp(-((x + 0.3) ** 2 + y**2) / 0.03)


def ball(rng):
    """Return the form of a ball in nm as a function of the direction (3, ...): waves over its volume."""
    k = 9.0 * rng.standard_normal((40, 3))
    phase = rng.uniform(0, 2 * np.pi, 40)
    return lambda n: 1.2 * np.cos(np.tensordot(k, n, 1) + phase[:, None, None]).sum(axis=0)


def turned(rng):
    """Return a random rotation (3, 3), all attitudes alike."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def disc(n):
    line = np.linspace(-1.0, 1.0, n)
    x, y = np.meshgrid(line, line)
    return x, y, np.hypot(x, y) <= 0.98


def main(folder):
    rng = np.random.default_rng(SEED)
    x, y, inside = disc(BALL_N)
    sx, sy = np.sin(HALF_ANGLE) * x, np.sin(HALF_ANGLE) * y
    direction = np.stack([sx, sy, np.sqrt(1 - np.minimum(sx**2 + sy**2, 0.99))])
    form = ball(rng)
    instrument = arm(x, y) + diverger(x, y)
    for i in range(1, N_PATCHES + 1):
        z = instrument + form(np.tensordot(turned(rng), direction, 1)) + aligned(rng, x, y)
        z += NOISE_NM * rng.standard_normal(z.shape)
        write(folder / f"patch_{i:02d}.csv", "z_nm", inside, [z])
    write(folder / "truth_ball.csv", "instrument_nm", inside, [instrument])

    x, y, inside = disc(SPHERE_N)
    both = arm(x, y) + diverger(x, y)
    cats_eye = arm(x, y) + (diverger(x, y) + diverger(-x, -y)) / 2
    maps = {
        "confocal": both + mirror(x, y),
        "confocal_180": both + mirror(-x, -y),
        "cats_eye": cats_eye,
    }
    for name, seen in maps.items():
        z = seen + aligned(rng, x, y) + NOISE_NM * rng.standard_normal(seen.shape)
        write(folder / f"{name}.csv", "z_nm", inside, [z])
    truth = [mirror(x, y), both]
    write(folder / "truth_positions.csv", "part_nm,instrument_nm", inside, truth)


def aligned(rng, x, y):
    """Return piston, tilt and power of one alignment."""
    a, b, c, d = 25 * rng.standard_normal(4)
    return a + b * x + c * y + d * (x**2 + y**2)


def write(path, columns, inside, maps):
    lines = [f"x_mm,y_mm,{columns}"]
    for i, j in np.ndindex(inside.shape):
        heights = [f"{z[i, j]:.1f}" if inside[i, j] else "nan" for z in maps]
        lines.append(",".join([f"{j * STEP_MM:g}", f"{i * STEP_MM:g}", *heights]))
    path.write_text("\n".join(lines) + "\n", "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
