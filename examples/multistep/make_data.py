"""Make readings.csv and truth.csv of this example: a ring indexed to 8 and then to 7 positions.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The simulator uses no code of metrosep. A step of alpha brings the point theta + alpha of the ring
to the probe.
"""

import sys
from pathlib import Path

import numpy as np

SEED, N_ANGLES, N_REVOLUTIONS = 1974, 90, 2
STEPS = (8, 7)
NOISE_NM, INDEX_DEG = 1.5, 0.02


def ring(angle):
    """Return roundness in nm over the angle of the ring, eccentricity included."""
    return (
        150 * np.cos(angle - 0.7)
        + 25 * np.cos(2 * angle + 0.4)
        + 6 * np.cos(7 * angle)
        + 5 * np.cos(8 * angle - 1.0)
        + 3 * np.cos(16 * angle + 2.0)
    )


def spindle(angle):
    """Error of the spindle towards the probe in nm."""
    return 10 * np.cos(2 * angle - 1.1) + 4 * np.cos(7 * angle + 0.3) + 4 * np.sin(8 * angle)


def main(folder):
    rng = np.random.default_rng(SEED)
    angle = 2 * np.pi * np.arange(N_ANGLES) / N_ANGLES
    columns, names = [], []
    for steps in STEPS:
        for step in range(steps):
            names.append(f"n{steps}_s{step}_nm")
            alpha = 2 * np.pi * step / steps + np.radians(INDEX_DEG) * rng.standard_normal()
            reading = ring(angle + alpha) + spindle(angle) + rng.uniform(-50, 50)
            columns.append(reading + NOISE_NM * rng.standard_normal((N_REVOLUTIONS, N_ANGLES)))
    lines = ["revolution,angle_deg," + ",".join(names)]
    for revolution in range(N_REVOLUTIONS):
        lines += [
            f"{revolution + 1},{np.degrees(t):.0f},"
            + ",".join(f"{c[revolution, j]:.2f}" for c in columns)
            for j, t in enumerate(angle)
        ]
    (folder / "readings.csv").write_text("\n".join(lines) + "\n", "ascii", newline="\n")
    rows = [
        f"{np.degrees(t):.0f},{r:.4f},{s:.4f}"
        for t, r, s in zip(angle, ring(angle), spindle(angle), strict=True)
    ]
    text = "angle_deg,ring_nm,spindle_nm\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, "ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
