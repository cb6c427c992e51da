"""Heights of a mirror from the slopes of an autocollimator, with their uncertainty."""

from pathlib import Path

import numpy as np

from metrosep.separation.lines.slope_integration import integrate_slopes, slope_transfer

NM, URAD = 1e-9, 1e-6


def columns(name):
    path = Path(__file__).parent / name
    return np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)


def main():
    x, *passes = columns("slopes.csv")
    x, slopes = x * 1e-3, np.array(passes) * URAD
    truth = columns("truth.csv")[1] * NM
    truth = truth - np.polyval(np.polyfit(x, truth, 1), x)
    results = {}
    for method in ("trapezoid", "simpson", "spline", "fourier"):
        result = results[method] = integrate_slopes(slopes, x, method=method)
        rest = result.height - truth
        gain = slope_transfer([5e-3], 1e-3, method=method)[0]
        u = np.sqrt(np.mean(result.u["height"] ** 2))
        print(
            f"{method:10s} RMS error {rest.std() / NM:5.2f} nm, RMS u {u / NM:5.2f} nm, "
            f"a wave of 5 mm is {gain:.3f} high"
        )
    print(f"noise of one slope, from the passes: {result.noise}")
    return results, truth


if __name__ == "__main__":
    main()
