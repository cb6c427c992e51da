"""Make density.csv and truth.csv: disturbance of a simulated machine, measured and true.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written.
The axis stands still; a probe is read at 1 kHz for 100 s. A column mode at 150 Hz, an isolator at
12 Hz and the noise of the sensor make the record.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.signal import lfilter, welch

SEED, RATE, SECONDS, SEGMENT = 12, 1000.0, 100.0, 2000
MODES = ((150.0, 0.02, 212.0), (12.0, 0.02, 71.0))  # Hz, damping, RMS in nm
SENSOR_NM = 20.0


def coefficients(frequency, damping):
    """Two poles of a randomly excited oscillator, sampled."""
    w = 2 * np.pi * frequency / RATE
    return -2 * np.exp(-damping * w) * np.cos(w * np.sqrt(1 - damping**2)), np.exp(
        -2 * damping * w
    )


def kick(a1, a2, rms):
    """Excitation that gives this RMS."""
    return rms * np.sqrt((1 - a2) * ((1 + a2) ** 2 - a1**2) / (1 + a2))


def density(f):
    """One-sided density in nm^2/Hz of what `record` draws."""
    z = np.exp(-2j * np.pi * f / RATE)
    total = np.full(f.shape, 2 * SENSOR_NM**2 / RATE)
    for frequency, damping, rms in MODES:
        a1, a2 = coefficients(frequency, damping)
        total += 2 / RATE * (kick(a1, a2, rms) / np.abs(1 + a1 * z + a2 * z**2)) ** 2
    return total


def record(rng):
    settle = 5000
    n = int(RATE * SECONDS)
    total = SENSOR_NM * rng.standard_normal(n)
    for frequency, damping, rms in MODES:
        a1, a2 = coefficients(frequency, damping)
        drive = kick(a1, a2, rms) * rng.standard_normal(n + settle)
        total += lfilter([1.0], [1.0, a1, a2], drive)[settle:]
    return total


def main(folder):
    f, measured = welch(record(np.random.default_rng(SEED)), RATE, nperseg=SEGMENT)
    for name, values in (("density.csv", measured), ("truth.csv", density(f))):
        rows = [f"{a:.1f},{s:.4g}" for a, s in zip(f[1:-1], values[1:-1], strict=True)]
        text = "frequency_hz,psd_nm2_per_hz\n" + "\n".join(rows) + "\n"
        (folder / name).write_text(text, encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
