"""Make readings.csv and truth.csv: an axis measured with a laser in a room that warms up.

Run ``python make_data.py [FOLDER]``; without a folder the files beside this script are written. The
laser counts fringes; the index of the air is Ciddor's as NIST prints it, densities in kg/m3.
"""

import math
import sys
from pathlib import Path

import numpy as np

SEED = 1996
WAVELENGTH = 632.9908e-9
DEAD_PATH = 0.25
"""m; from the interferometer to the reflector where the reading was set to zero."""

OFFSET = 0.06
"""m; the tool is above the beam, on the side that a positive pitch moves forwards."""

EXPANSION = 11.5e-6
LOST = 0.8e-6
"""m; the axis stays behind on the way back."""

NOISE = 5e-9


def main(folder):
    rng = np.random.default_rng(SEED)
    targets = 1e-3 * np.array([0, 53, 104, 151, 203, 249, 302, 351, 404, 452, 498])
    x = np.concatenate([targets, targets[::-1]])
    way = ["fwd"] * targets.size + ["bwd"] * targets.size
    error = 1.5e-6 * np.sin(11.0 * x) + 2e-6 * x - LOST * (np.array(way) == "bwd")
    error -= error[0]
    part = np.round(20.4 + 0.01 * np.arange(x.size), 2)
    pitch = np.round(12.0 * (x / 0.5) ** 2 - 3.0 * x / 0.5, 2)  # arcsec
    rows, n_zero = [], None
    for run in range(5):
        since = np.arange(x.size) + run * x.size
        t, p = np.round(20.0 + 0.008 * since, 3), np.round(1003.0 + 0.02 * since, 2)
        n = np.array([index(*air, 41.0) for air in zip(t, 100.0 * p, strict=True)])
        n_zero = n[0] if n_zero is None else n_zero  # set to zero once, at the start
        at_20 = x + error + NOISE * rng.standard_normal(x.size)
        tool = at_20 * (1.0 + EXPANSION * (part - 20.0))
        beam = tool - OFFSET * np.radians((pitch - pitch[0]) / 3600.0)
        fringes = 2.0 * (n * (DEAD_PATH + beam) - n_zero * DEAD_PATH) / WAVELENGTH
        laser = fringes * WAVELENGTH / 2.0  # as if in vacuum
        rows += [
            f"{run + 1},{x[i] * 1e3:.0f},{way[i]},{laser[i] * 1e3:.6f},{t[i]:.3f},{p[i]:.2f},41,"
            f"{part[i]:.2f},{pitch[i]:.2f}"
            for i in range(x.size)
        ]
    head = "run,target_mm,way,laser_mm,air_degC,pressure_hPa,humidity [%],part_degC,pitch_arcsec"
    _write(folder / "readings.csv", [head, *rows])
    truth = [f"{a * 1e3:.0f},{w},{e * 1e9:.3f}" for a, w, e in zip(x, way, error, strict=True)]
    _write(folder / "truth.csv", ["target_mm,way,error_nm", *truth])


def index(t, p, percent):
    """Index of air after Ciddor with the printed constants of NIST's page; degC, Pa, percent."""
    k, s = t + 273.15, (1e-6 / WAVELENGTH) ** 2
    f = 1.00062 + 3.14e-8 * p + 5.6e-7 * t * t
    xv = percent / 100.0 * f * _saturation(k) / p
    dry = 1e-8 * (5792105 / (238.0185 - s) + 167917 / (57.362 - s))
    wet = 1.022e-8 * (295.235 + 2.6422 * s - 0.03238 * s**2 + 0.004028 * s**3)
    z = 1 - p / k * (
        1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t * t
        + (5.707e-6 - 2.051e-8 * t) * xv + (1.9898e-4 - 2.376e-6 * t) * xv**2
    ) + (p / k) ** 2 * (1.83e-11 - 0.765e-8 * xv**2)  # fmt: skip
    r, ma = 8.314472, 0.0289635 + 1.2011e-8 * 50
    standard = 101325 * ma / (0.9995922115 * r * 288.15)
    vapour = xv * p * 0.018015 / (z * r * k) / 0.00985938
    return 1 + (1 - xv) * p * ma / (z * r * k) / standard * dry + vapour * wet


def _saturation(k):
    """Saturation pressure over water in Pa, Hyland and Wexler 1983 (within 0.02 % of IF97 here)."""
    return math.exp(
        -0.58002206e4 / k + 0.13914993e1 - 0.48640239e-1 * k + 0.41764768e-4 * k**2
        - 0.14452093e-7 * k**3 + 0.65459673e1 * math.log(k)
    )  # fmt: skip


def _write(path, lines):
    path.write_text("\n".join(lines) + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
