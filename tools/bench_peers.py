"""Run one benchmark case with another package, in an environment of its own.

Called by tools/benchmarks.py with the interpreter of that environment; speaks JSON lines: a case
and the folder with its data in, seconds and a number to compare out. Nothing of metrosep is
imported here, and nothing of the peers is imported by metrosep.
"""

import importlib
import importlib.metadata
import json
import sys
import time
from pathlib import Path

import numpy as np


def disc(n):
    x = np.linspace(-1, 1, n)
    X, Y = np.meshgrid(x, x)
    return X, Y, np.hypot(X, Y), np.arctan2(Y, X)


def prysm_polynomial(z):
    from prysm.polynomials import lstsq, sum_of_2d_modes

    n = z.shape[0]
    X, Y, _, _ = disc(n)
    powers = [(i, j) for i in range(6) for j in range(6 - i)]
    modes = np.stack([X**i * Y**j for i, j in powers])
    left = z - sum_of_2d_modes(modes, lstsq(modes, z))
    return left


def surfalize_polynomial(z):
    from surfalize import Surface

    left = Surface(z * 1e6, 1.0, 1.0).detrend_polynomial(degree=5)
    return left.data * 1e-6


def prysm_zernike(z):
    from prysm.polynomials import lstsq, noll_to_nm, zernike_nm_sequence

    _, _, r, t = disc(z.shape[0])
    modes = np.stack(list(zernike_nm_sequence([noll_to_nm(j) for j in range(1, 37)], r, t)))
    return float(lstsq(modes, z)[5])


def surfalize_gaussian(z):
    from surfalize import Surface

    low = Surface(z * 1e6, 1.0, 1.0).filter("lowpass", 80.0)
    return float(low.data[100, 200]) * 1e-6


def surfalize_heights(z):
    from surfalize import Surface

    s = Surface(z * 1e6, 1.0, 1.0)
    return float(np.ravel([s.Sa(), s.Sq(), s.Ssk(), s.Sku(), s.Sz()])[1]) * 1e-6


def lmfit_conic(z):
    import lmfit

    n = z.shape[0]
    x = np.linspace(-10e-3, 10e-3, n)
    X, Y = np.meshgrid(x, x)
    good = ~np.isnan(z)
    X, Y, Z = X[good], Y[good], z[good]

    def residual(p):
        v = p.valuesdict()
        r2 = (X - v["dx"]) ** 2 + (Y - v["dy"]) ** 2
        sag = v["c"] * r2 / (1 + np.sqrt(1 - (1 + v["k"]) * v["c"] ** 2 * r2))
        return (Z - sag - v["dz"] - v["tx"] * X - v["ty"] * Y) * 1e6

    p = lmfit.Parameters()
    for name, value in {"c": 19.5, "k": -1.0, "dx": 0, "dy": 0, "dz": 0, "tx": 0, "ty": 0}.items():
        p.add(name, value=value)
    found = lmfit.minimize(residual, p)
    return 1.0 / found.params["c"].value


CASES = {
    f.__name__: f
    for f in (
        prysm_polynomial,
        surfalize_polynomial,
        prysm_zernike,
        surfalize_gaussian,
        surfalize_heights,
        lmfit_conic,
    )
}


def main():
    for name in ("lmfit", "prysm.polynomials", "surfalize"):  # to import them is not the task
        importlib.import_module(name)
    for line in sys.stdin:
        job = json.loads(line)
        if job["case"] == "versions":
            names = ("prysm", "surfalize", "lmfit", "numpy", "scipy")
            answer = {n: importlib.metadata.version(n) for n in names}
        else:
            z = np.load(Path(job["data"]))
            started = time.perf_counter()
            result = CASES[job["case"]](z)
            seconds = time.perf_counter() - started
            # a map is compared by its standard deviation, which is not part of the task
            value = float(np.nanstd(result)) if np.ndim(result) else float(result)
            answer = {"seconds": seconds, "value": value}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
