"""Print how often U of a fitted form holds the truth, on drawn maps with correlated deviations.

    python tools/form_coverage.py [--seeds 40] [--size 64] [--first 2000] [--fields g0,g2,g5]
                                  [--forms "plane square,zernike 36 disc"]

Fields: gS, white noise under a Gaussian of sigma S pixels; eS, exponential correlation of S pixels;
fB, spectrum f^-B; w3/Q, f^-3 of 1/Q of the RMS of white noise; lay, 2 x 40 pixels. Supports: square,
disc, gaps (a fifth missing), 1/K (the middle 1/K of the rows, a narrow map).
The piston is left out. Printed are the share of errors within U, the median of U over twice the scatter
of the errors, false accepts of a part on its limit with the guard band of the fit, and ms of one u. The shares
have their standard errors: the errors of one map hang together, so that they are those of the maps' means.
"""

import argparse
import time
import zlib

import numpy as np

import metrosep as ms

STEP, RMS = 1e-4, 10e-9


def filtered(rng, n, wide, psd):
    """Return white noise on a torus of `wide` pixels under the root of a spectrum, its first n x n pixels."""
    fx, fy = np.fft.fftfreq(wide)[:, None], np.fft.rfftfreq(wide)[None, :]
    noise = np.fft.rfft2(rng.standard_normal((wide, wide)))
    return np.fft.irfft2(noise * np.sqrt(psd(fx, fy)), (wide, wide))[:n, :n]


def gaussian(rng, n, s_x, s_y):
    """Return noise of unit variance."""
    if s_x == 0:
        return rng.standard_normal((n, n))

    def psd(fx, fy):
        return np.exp(-((2 * np.pi) ** 2) * (s_x**2 * fx**2 + s_y**2 * fy**2))

    z = filtered(rng, n, n + int(10 * max(s_x, s_y)), psd)
    return z * 2 * np.sqrt(np.pi * s_x * s_y)


def exponential(rng, n, s):
    """Return noise of unit variance, exp(-d/s)."""

    def psd(fx, fy):
        return (1 + (2 * np.pi * s) ** 2 * (fx * fx + fy * fy)) ** -1.5

    return filtered(rng, n, max(2 * n, n + 16 * s), psd) * np.sqrt(2 * np.pi) * s


def power(rng, n, B):
    """Return noise of spectrum f^-B with a period of three maps; RMS of about 1 on the map."""

    def psd(fx, fy):
        square = fx * fx + fy * fy
        square[0, 0] = np.inf
        return square ** (-B / 2)

    level = [np.var(filtered(np.random.default_rng([k, n]), n, 3 * n, psd)) for k in range(8)]
    return filtered(rng, n, 3 * n, psd) / np.sqrt(np.mean(level))


def field(name, rng, n):
    """Return the deviations of a name, n x n, without unit."""
    if name == "lay":
        return gaussian(rng, n, 40, 2)
    if name.startswith("w3/"):
        return power(rng, n, 3) / float(name[3:]) + gaussian(rng, n, 0, 0)
    kind, value = name[0], float(name[1:])
    if kind == "g":
        return gaussian(rng, n, value, value)
    return exponential(rng, n, int(value)) if kind == "e" else power(rng, n, value)


def support(name, n):
    """Return where a map has values: whole, a disc, without a fifth in squares, the middle 1/K of its rows."""
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    if name == "disc":
        return x * x + y * y <= 1
    there = np.ones((n, n), bool)
    if name.startswith("1/"):
        rows = round(n / float(name[2:]))
        there[: (n - rows) // 2] = there[(n - rows) // 2 + rows :] = False
    rng, w = np.random.default_rng(99), n // 8
    while name == "gaps" and there.mean() > 0.8:
        i, j = rng.integers(0, n - w, 2)
        there[i : i + w, j : j + w] = False
    return there


def planted(form, n):
    """Return the form, its heights and the truth of its parameters (0 where it is not named)."""
    y, x = (np.mgrid[:n, :n] - (n - 1) / 2) * STEP
    square, side = x * x + y * y, n * STEP
    if form in ("sphere", "conic"):
        c, k = (1 / (8 * side), 0.0) if form == "sphere" else (1 / side, -0.6)
        z = c * square / (1 + np.sqrt(1 - (1 + k) * c * c * square))
        return ms.forms.form_from_text(form), z, {"c": c, "k": k}
    text = {"zernike": "zernike: terms=", "polynomial": "polynomial: degree="}
    kind, _, number = form.partition(" ")
    return ms.forms.form_from_text(text.get(kind, kind) + number), 0 * x, {}


def judged(name, where, form, n, seeds):
    """Return errors, U and guard of each seed and parameter but the piston, and seconds of one u."""
    ideal, heights, truth = planted(form, n)
    there, rows, spent = support(where, n), [], 0.0
    for seed in seeds:
        rng = np.random.default_rng([seed, n, zlib.crc32(name.encode())])
        z = np.where(there, heights + RMS * field(name, rng, n), np.nan)
        found = ms.forms.fit(ms.Surface(z, STEP, STEP, origin=(-STEP * (n - 1) / 2,) * 2), ideal)
        begin = time.process_time()
        u = dict(found.u)
        spent += time.process_time() - begin
        if form.startswith(("zernike", "polynomial")):
            del u[next(iter(u))]
        off = {k: found.params[k] - truth.get(k, 0.0) for k in u if k not in ("R", "piston")}
        own = np.array([u[k] for k in off])
        guard = np.array([found.guard[k] for k in off])
        rows.append((np.array([*off.values()]), found.coverage_factor * own, guard))
    return (*(np.array(v) for v in zip(*rows, strict=True)), spent / len(rows))


def share_and_error(hits, known):
    """Return the share of hits of the known ones in per cent, and its standard error from map to map."""
    share = hits[known].mean()
    off = np.where(known, hits - share, 0.0).sum(axis=1)  # of a ratio of sums, linearised
    return f"{100 * share:.1f} ± {100 * np.sqrt(np.square(off).sum()) / known.sum():.1f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=2000)
    parser.add_argument("--size", type=int, default=64, help="pixels along a side")
    parser.add_argument("--fields", default="g0,g1,g2,g5,g10,e2,e5,f1,f2,f3,w3/3,lay")
    parser.add_argument(
        "--forms",
        default="plane square,plane gaps,sphere disc,conic disc,polynomial 4 gaps,zernike 36 disc",
    )
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    print(
        "| field | form | % within U | U over 2 sd | % false accepts | ms |\n|---|---|---|---|---|---|"
    )
    for name in chosen.fields.split(","):
        for text in chosen.forms.split(","):
            form, _, where = text.rpartition(" ")
            off, U, guard, spent = judged(name, where, form, chosen.size, seeds)
            known = np.isfinite(U)
            held = share_and_error(np.abs(off) <= U, known)
            wide = np.nanmedian(U / (2 * np.sqrt(np.mean(off**2, axis=0))))
            false = share_and_error(0.5 * (np.abs(off) > guard), known)
            share = "" if known.all() else f" ({1 - known.mean():.2f} unknown)"
            row = f"{held}{share} | {wide:.2f} | {false} | {1e3 * spent:.0f}"
            print(f"| {name} | {text} | {row} |", flush=True)


if __name__ == "__main__":
    main()
