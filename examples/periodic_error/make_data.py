"""Make scan.csv and truth.csv: position error of an interferometer with quadrature errors.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
"""

import sys
from pathlib import Path

import numpy as np

SEED = 633
WAVELENGTH_NM = 632.8
OFFSET, RATIO, QUADRATURE = 0.035, 0.02, 0.015
"""Offset of the cosine signal and ratio of amplitudes less one, both of the radius; radian."""

SLOPE_NM_PER_UM = 1.3
NOISE_NM = 0.4


def main(folder):
    rng = np.random.default_rng(SEED)
    fringe = WAVELENGTH_NM / 2
    true_nm = np.sort(rng.uniform(0.0, 9000.0, 2500))
    phase = 2 * np.pi * true_nm / fringe
    cosine = (1 + RATIO) * np.cos(phase) + OFFSET
    sine = np.sin(phase + QUADRATURE)
    read = np.unwrap(np.arctan2(sine, cosine)) * fringe / (2 * np.pi)
    read += fringe * np.round((true_nm[0] - read[0]) / fringe)
    other = true_nm + 1e-3 * SLOPE_NM_PER_UM * true_nm + NOISE_NM * rng.normal(size=true_nm.size)
    rows = [f"{p:.3f},{p - q:.3f}" for p, q in zip(read, other, strict=True)]
    _write(folder / "scan.csv", ["position_nm,difference_nm", *rows])

    scale = fringe / (2 * np.pi)
    radius = 1 + RATIO / 2
    second = np.hypot(RATIO / radius, QUADRATURE) / 2
    truth = {
        "first_harmonic_nm": OFFSET / radius * scale,
        "second_harmonic_nm": second * scale,
        "noise_nm": NOISE_NM,
        "period_nm": fringe,
    }
    _write(folder / "truth.csv", ["name,value", *(f"{k},{v:.4f}" for k, v in truth.items())])


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
