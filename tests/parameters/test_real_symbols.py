"""Symbols of three real maps through `metrosep measure`, against definitions written down once more here.

Nothing of the package but its reader is used: heights sorted, flooding by falling height, least squares,
the autocorrelation by its definition along rays.
"""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import metrosep as ms
from metrosep.cli.main import cli

MAPS = ("al3d-1.al3d", "opd-1.opd", "x3p-2.x3p")
"""Whole and small; with voids; with unequal steps."""
WITHIN = 0.02
"""Of the value, or the rule that differs is named (issue of the step)."""


def levelled(surface):
    """Heights less their least-squares plane."""
    n_y, n_x = surface.z.shape
    y, x = np.mgrid[-1 : 1 : n_y * 1j, -1 : 1 : n_x * 1j]
    seen = ~np.isnan(surface.z)
    A = np.stack([np.ones(int(seen.sum())), x[seen], y[seen]], axis=1)
    c = np.linalg.lstsq(A, surface.z[seen], rcond=None)[0]
    return surface.z - (c[0] + c[1] * x + c[2] * y)


def heights(z):
    h = np.sort(z[~np.isnan(z)])[::-1]
    q = np.sqrt(np.mean(h**2))
    found = {"Sa": np.mean(np.abs(h)), "Sq": q, "Sp": h[0], "Sv": -h[-1], "Sz": h[0] - h[-1]}
    found |= {"Ssk": np.mean(h**3) / q**3, "Sku": np.mean(h**4) / q**4}

    def cut(p):
        return h[int(p * h.size)]

    over, under = (
        (lambda p: np.mean(np.maximum(h - cut(p), 0))),
        (lambda p: np.mean(np.maximum(cut(p) - h, 0))),
    )
    found |= {"Vmp": over(0.1), "Vmc": over(0.8) - over(0.1), "Vvv": under(0.8)}
    found |= {"Vvc": under(0.1) - under(0.8), "Sxp": cut(0.025) - cut(0.5)}
    # The core: the flattest 40 %, a line through it, triangles above and below.
    wide = round(0.4 * h.size)
    start = int(np.argmin(h[: h.size - wide] - h[wide:]))
    slope, level = np.polyfit(
        (np.arange(start, start + wide) + 0.5) / h.size, h[start : start + wide], 1
    )
    top, bottom = level, level + slope
    peak, valley = np.mean(h > top), np.mean(h < bottom)
    found |= {"Sk": top - bottom, "Smrk1": peak, "Smrk2": 1 - valley}
    found |= {"Spk": 2 * np.mean(np.maximum(h - top, 0)) / peak}
    return found | {"Svk": 2 * np.mean(np.maximum(bottom - h, 0)) / valley}


def slopes(z, dx, dy):
    """The widest stencil of valid pixels along both axes: seven, five or three points, at the border three."""

    def along(v):
        found = np.gradient(v, axis=1, edge_order=2)
        five = (8 * (v[:, 3:-1] - v[:, 1:-3]) - v[:, 4:] + v[:, :-4]) / 12
        seven = (45 * (v[:, 4:-2] - v[:, 2:-4]) - 9 * (v[:, 5:-1] - v[:, 1:-5])) / 60
        seven += (v[:, 6:] - v[:, :-6]) / 60
        for reach, wider in ((2, five), (3, seven)):
            inner = found[:, reach:-reach]
            inner[:] = np.where(np.isnan(wider), inner, wider)
        return found

    squares = (along(z) / dx) ** 2 + (along(z.T).T / dy) ** 2
    return np.sqrt(np.nanmean(np.where(np.isnan(z), np.nan, squares)))


def shortest_lag(z, dx, dy):
    """Where the autocorrelation falls to 0.2 first, along 360 rays in steps of a tenth of a pixel."""
    seen = ~np.isnan(z)
    d = np.where(seen, z - np.nanmean(z), 0.0)
    shape = [2 * n for n in z.shape]
    sums, pairs = (
        np.fft.irfft2(np.abs(np.fft.rfft2(v, shape)) ** 2, shape) for v in (d, seen.astype(float))
    )
    acf = sums / np.maximum(pairs, 1) / (sums[0, 0] / pairs[0, 0])
    best = np.inf
    for angle in np.pi * np.arange(360) / 360:
        t = 0.1 * np.arange(1, 5 * min(z.shape))
        u, v = t * np.cos(angle), t * np.sin(angle)
        i, j = np.floor(v).astype(int), np.floor(u).astype(int)
        a, b = v - i, u - j
        value = sum(
            wy * wx * acf[(i + k) % shape[0], (j + m) % shape[1]]
            for k, wy in ((0, 1 - a), (1, a))
            for m, wx in ((0, 1 - b), (1, b))
        )
        below = np.flatnonzero(value < 0.2)
        if below.size:
            k = below[0]
            best = min(best, np.hypot(u[k] * dx, v[k] * dy))
    return best


def peaks(z, threshold):
    """Heights of the hills that stand over their saddle: pixels flooded one by one, from the highest."""
    n_y, n_x = z.shape
    flat = z.ravel().tolist()
    of = [-1] * len(flat)
    kept = []

    def root(i):
        while of[i] != i:
            of[i] = of[of[i]]
            i = of[i]
        return i

    for i in sorted(range(len(flat)), key=lambda k: -flat[k]):
        y, x = divmod(i, n_x)
        around = {
            root(n)
            for n in (
                yy * n_x + xx
                for yy in range(max(y - 1, 0), min(y + 2, n_y))
                for xx in range(max(x - 1, 0), min(x + 2, n_x))
            )
            if of[n] >= 0
        }
        tops = sorted(around, key=lambda k: -flat[k])
        of[i] = tops[0] if tops else i
        for low in tops[1:]:
            of[low] = tops[0]
            if flat[low] - flat[i] >= threshold:
                kept.append(low)
    kept.append(int(np.argmax(z)))
    inside = [k for k in kept if 0 < k // n_x < n_y - 1 and 0 < k % n_x < n_x - 1]
    return sorted((flat[k] for k in inside), reverse=True)


@pytest.mark.parametrize(
    "name", [MAPS[0], *(pytest.param(m, marks=pytest.mark.slow) for m in MAPS[1:])]
)
def test_symbols_of_real_maps(corpus, name):
    surface = ms.read(corpus / "st" / name)
    z = levelled(surface)
    own = heights(z) | {"Sdq": slopes(z, surface.dx, surface.dy)}
    own["Sal"] = shortest_lag(z, surface.dx, surface.dy)
    if name.startswith("al3d"):
        for sign, symbols in ((1, ("Spd", "S5p")), (-1, ("Svd", "S5v"))):
            found = peaks(sign * z, 0.05 * own["Sz"])
            own[symbols[0]] = len(found) / (z.size * surface.dx * surface.dy)
            own[symbols[1]] = np.mean(found[:5]) - sign * z.mean()
    run = CliRunner().invoke(
        cli,
        [
            "measure",
            str(corpus / "st" / name),
            "--form",
            "plane",
            "--params",
            ",".join(own),
            "--json",
        ],
    )
    assert run.exit_code == 0, run.output
    found = {k: v["value"] for k, v in json.loads(run.stdout)["parameters"].items()}

    assert set(found) == set(own)
    for symbol, value in own.items():
        assert found[symbol] == pytest.approx(value, rel=WITHIN, abs=0.0), symbol
