"""Make traces.csv: five traces of a roundness instrument over a pin of 24 mm diameter.

Run ``python make_data.py [FOLDER]``; without a folder the file beside this script is written. The pin is
oval (2 um), tapered (1.5 um over 32 mm) and stands shifted and tilted on the table.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 12180
HEIGHTS_MM = (0.0, 8.0, 16.0, 24.0, 32.0)
RADIUS_MM = 12.0
NOISE_UM = 0.02


def readings(rng, height):
    """Angle in degrees and deviation from a circle of 12 mm about the spindle, um, of one trace."""
    angle = np.arange(0.0, 360.0, 5.0)
    a = np.radians(angle)
    form = 2.0 * np.cos(2 * a + 0.3) + 0.4 * np.cos(3 * a) * (height / 32) + 1.5 * height / 32
    x, y = 4.0 - 0.1 * height, -3.0 + 0.05 * height  # um: where the axis passes
    centred = x * np.cos(a) + y * np.sin(a)
    square = -((x * np.sin(a) - y * np.cos(a)) ** 2) / (2 * RADIUS_MM * 1e3)
    return angle, form + centred + square + NOISE_UM * rng.standard_normal(a.size)


def main(folder):
    rng = np.random.default_rng(SEED)
    lines = ["height_mm,angle_deg,deviation_um"]
    for height in HEIGHTS_MM:
        angle, deviation = readings(rng, height)
        lines += [f"{height:g},{a:g},{d:.3f}" for a, d in zip(angle, deviation, strict=True)]
    (Path(folder) / "traces.csv").write_text("\n".join(lines) + "\n", "utf-8", newline="\n")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parent)
