"""Three probes on a slide: the parabola of the zero error, and two ways to be rid of it."""

from pathlib import Path

import numpy as np

from metrosep.separation.lines.three_points import three_point, zero_error_sag
from metrosep.separation.lines.zero_adjustment import zero_calibration

STEP, NM, URAD = 10e-3, 1e-9, 1e-6
U_READING, U_PITCH = 1e-9, 0.05e-6


def columns(name):
    path = Path(__file__).parent / name
    return np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)


def level(z):
    t = np.linspace(-1, 1, z.size)
    return z - np.polyval(np.polyfit(t, z, 1), t)


def main():
    x, *probes, pitch = columns("readings.csv")
    m, x, pitch = np.array(probes) * NM, x * 1e-3, pitch * URAD
    edge = level(columns("truth.csv")[1] * NM)
    flat = zero_calibration(np.array(columns("flat.csv")) * NM, STEP, flat=0.0, u_flat=0.5e-9)
    print(f"zero from the flat: {flat.quantity} (true 40 nm)")
    print(f"its sag over 300 mm: {zero_error_sag(flat.zero, 0.3, STEP) / NM:.0f} nm")

    common = {"x": x, "u_reading": U_READING}
    results = {
        "zero taken as 0": three_point(m, STEP, zero=0.0, **common),
        "zero from the flat": three_point(m, STEP, zero_cal=flat, **common),
        "with the pitch sensor": three_point(
            m, STEP, method="least_squares", pitch=pitch, u_pitch=U_PITCH, **common
        ),
    }
    for name, result in results.items():
        rest = result.artefact - edge
        u = np.sqrt(np.mean(result.u["artefact"] ** 2))
        print(f"{name:22s} RMS error {rest.std() / NM:7.2f} nm, RMS u {u / NM:6.2f} nm")
    unknown = three_point(m, STEP, **common)
    for text in unknown.messages:
        print(f"without any: {text}")
    return results


if __name__ == "__main__":
    main()
