"""Make spindle.csv and truth.csv of this example: a simulated radial test with index pulses.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
A ball on a spindle that slows down by 2 % over 26 revolutions; one capacitive sensor at 5 kHz.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 230
RATE = 5000.0
SPEED = 20.0
TURNS = 26.5
ECCENTRICITY = 1.5e-6
CAGE = 0.43
WAVES = {2: (18e-9, 0.4), 3: (9e-9, -1.1), 5: (4e-9, 2.0), 9: (6e-9, 0.9), 16: (2e-9, -2.5)}
NOISE = 1.5e-9


def synchronous(angle):
    """Return the true radial motion in m, eccentricity apart."""
    return sum(a * np.cos(k * angle + p) for k, (a, p) in WAVES.items())


def main(folder):
    rng = np.random.default_rng(SEED)
    t = np.arange(int(TURNS / SPEED * RATE * 1.01)) / RATE
    turns = SPEED * (t - 0.01 * t**2 / t[-1]) - 0.3
    angle = 2 * np.pi * turns
    gap = synchronous(angle) + ECCENTRICITY * np.cos(angle - 0.6)
    gap += 3e-9 * np.cos(CAGE * angle + rng.uniform(0, 2 * np.pi)) + rng.normal(0, NOISE, t.size)
    # the mark passes within 6 degrees; its edge takes 4 degrees and is centred on angle 0
    near = np.degrees(angle + np.pi) % 360 - 180
    volts = 5 * (np.clip(near / 4 + 0.5, 0, 1) - np.clip((near - 6) / 4 + 0.5, 0, 1))
    volts += rng.normal(0, 0.05, t.size)
    lines = ["t_ms,gap_nm,index_V"]
    lines += [
        f"{a * 1e3:.1f},{g * 1e9:.2f},{v:.2f}" for a, g, v in zip(t, gap, volts, strict=True)
    ]
    (folder / "spindle.csv").write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")
    degrees = np.arange(360)
    rows = [
        f"{d},{r * 1e9:.4f}"
        for d, r in zip(degrees, synchronous(np.radians(degrees)), strict=True)
    ]
    text = "angle_deg,synchronous_nm\n" + "\n".join(rows) + "\n"
    (folder / "truth.csv").write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
