"""Symbols of three real maps through `metrosep measure`, against definitions written down once more here.

Nothing of the package but its reader is used: heights sorted, flooding by falling height, least squares,
the autocorrelation by its definition along rays.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.ndimage import gaussian_filter
from scipy.special import erf

import metrosep as ms
from metrosep.cli.main import cli

pytestmark = pytest.mark.usefixtures("without_figures")

MAPS = ("al3d-1.al3d", "opd-1.opd", "x3p-2.x3p")
"""Whole and small; with voids; with unequal steps."""
WITHIN = 0.02
"""Of the value, or the rule that differs is named (issue of the step)."""
SAME = 1e-6
"""Of the value, where both sides sum the same pixels."""
SUMMED = {
    "Sa",
    "Sq",
    "Ssk",
    "Sku",
    "Sp",
    "Sv",
    "Sz",
    "Ssw",
    "Spd",
    "Svd",
    "S5p",
    "S5v",
    "S10z",
}


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
    above, below = np.mean(np.maximum(h - top, 0)), np.mean(np.maximum(bottom - h, 0))
    found |= {"Sak1": above, "Sak2": below, "Spk": 2 * above / peak, "Svk": 2 * below / valley}
    found |= {"Spkx": h[0] - top, "Svkx": bottom - h[-1]}
    found |= {"Smr(10 nm)": np.mean(h >= 10e-9), "Smc(30 %)": cut(0.3)}
    return found | {"Sdc(5 %, 90 %)": cut(0.05) - cut(0.9)}


def two_lines(z):
    """Plateau and dales on the material probability curve: the best bend, once more without its surroundings."""
    h = np.sort(z[~np.isnan(z)])[::-1]
    s = np.linspace(-3, 3, 2000)
    share = 0.5 * (1 - erf(s / np.sqrt(2)))  # of the pixels, above the height of s
    c = np.interp(share[::-1], (np.arange(h.size) + 0.5) / h.size, h)[::-1]

    def bend(s, c):
        found = []
        for at in np.linspace(-2.9, 2.9, 291):
            A = np.stack([np.ones(s.size), np.minimum(s - at, 0), np.maximum(s - at, 0)], axis=1)
            slopes, rest = np.linalg.lstsq(A, c, rcond=None)[:2]
            found.append((rest[0], at, slopes[1], slopes[2]))
        return min(found)[1:]

    at = bend(s, c)[0]
    sides = np.flatnonzero(s < at), np.flatnonzero(s >= at)[::-1]  # outermost first
    kept = np.sort(np.concatenate([v[round(0.02 * v.size) : round(0.9 * v.size)] for v in sides]))
    at, dales, plateau = bend(s[kept], c[kept])
    if dales < 1.2 * plateau:
        return {}
    return {"Spq": plateau, "Svq": dales, "Smq": 0.5 * (1 - erf(at / np.sqrt(2)))}


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
    squares = np.where(np.isnan(z), np.nan, squares)
    return {"Sdq": np.sqrt(np.nanmean(squares)), "Sdr": np.nanmean(np.sqrt(1 + squares)) - 1}


def wavelength(z, dx, dy):
    """Of the largest magnitude of the transform, what is missing at the mean."""
    n_y, n_x = z.shape
    found = np.abs(np.fft.rfft2(np.nan_to_num(z - np.nanmean(z))))
    found[0, 0] = 0.0
    j, i = np.unravel_index(np.argmax(found), found.shape)
    return 1 / np.hypot(np.fft.fftfreq(n_y, dy)[j], np.fft.rfftfreq(n_x, dx)[i])


def lags(z, dx, dy):
    """Where the autocorrelation falls to 0.2 first, along 720 rays in steps of a tenth of a pixel."""
    seen = ~np.isnan(z)
    d = np.where(seen, z - np.nanmean(z), 0.0)
    shape = [2 * n for n in z.shape]
    sums, pairs = (
        np.fft.irfft2(np.abs(np.fft.rfft2(v, shape)) ** 2, shape) for v in (d, seen.astype(float))
    )
    acf = sums / np.maximum(pairs, 1) / (sums[0, 0] / pairs[0, 0])
    ends = []
    for angle in np.pi * np.arange(720) / 720:
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
            ends.append(np.hypot(u[k] * dx, v[k] * dy))
    whole = (
        {"Str": min(ends) / max(ends)} if len(ends) == 720 else {}
    )  # else the lobe is not seen whole
    return {"Sal": min(ends)} | whole


LARGEST = 50
"""Pixels of a hole that is filled to find hills (a rule of the package, see its page)."""


def around(i, shape):
    y, x = divmod(i, shape[1])
    rows, columns = (
        range(max(y - 1, 0), min(y + 2, shape[0])),
        range(max(x - 1, 0), min(x + 2, shape[1])),
    )
    return [yy * shape[1] + xx for yy in rows for xx in columns if (yy, xx) != (y, x)]


def without_holes(z):
    """Small holes inside filled by a quadratic through what lies within four pixels, weighted by distance."""
    missing, filled = set(np.flatnonzero(np.isnan(z)).tolist()), z.copy()
    n_y, n_x = z.shape
    while missing:
        hole, ahead = set(), [missing.pop()]
        while ahead:
            i = ahead.pop()
            hole.add(i)
            near = missing.intersection(around(i, z.shape))
            missing -= near
            ahead += near
        edge = any(i // n_x in (0, n_y - 1) or i % n_x in (0, n_x - 1) for i in hole)
        for i in hole if len(hole) <= LARGEST and not edge else ():
            y, x = divmod(i, n_x)
            v, u = (t.ravel() for t in np.mgrid[-4:5, -4:5])
            there = (
                (y + v >= 0) & (y + v < n_y) & (x + u >= 0) & (x + u < n_x) & (u**2 + v**2 <= 16)
            )
            u, v = u[there], v[there]
            h = z[y + v, x + u]
            u, v, h = (t[~np.isnan(h)] for t in (u, v, h))
            w = np.exp(-(u**2 + v**2) / 16)  # sigma 2 pixels, root of the weight
            A = np.stack([np.ones(u.size), u, v, u * u, u * v, v * v], axis=1)
            filled[y, x] = np.linalg.lstsq(A * w[:, None], h * w, rcond=None)[0][0]
    return filled


def hills(z, threshold):
    """Peaks, the highest first, and the peak of each pixel: flooded pixel by pixel from the highest.

    A hill is what flows up to its peak by the highest pixel around each. Where two meet, the lower one
    ends; if it stands less than the threshold above, it joins the hill across.
    """
    flat = np.where(np.isnan(z), -np.inf, z).ravel().tolist()
    of, top, across = [-1] * len(flat), [-1] * len(flat), {}
    kept = []

    def root(i):
        while of[i] != i:
            of[i] = of[of[i]]
            i = of[i]
        return i

    for i in sorted(np.flatnonzero(~np.isnan(z)).tolist(), key=lambda k: -flat[k]):
        higher = [k for k in around(i, z.shape) if of[k] >= 0]
        meeting = {}
        for k in sorted(higher, key=lambda k: -flat[k]):
            meeting.setdefault(root(k), top[k])
        tops = sorted(meeting, key=lambda k: -flat[k])
        of[i] = tops[0] if tops else i
        top[i] = top[max(higher, key=lambda k: flat[k])] if higher else i
        for low in tops[1:]:
            of[low] = tops[0]
            if flat[low] - flat[i] >= threshold:
                kept.append(low)
            else:
                across[low] = meeting[tops[0]]
    kept += [i for i in range(len(flat)) if of[i] == i]

    def stands(i):
        while i in across:
            i = across[i]
        return i

    owner = np.array([stands(i) if i >= 0 else -1 for i in top]).reshape(z.shape)
    return sorted(kept, key=lambda k: -flat[k]), owner


def at_edge(z):
    """Border of the map, and what lies beside a pixel without height."""
    wide = np.pad(np.isnan(z), 1, constant_values=True)
    n_y, n_x = z.shape
    return np.any([wide[j : j + n_y, i : i + n_x] for j in range(3) for i in range(3)], axis=0)


def features(measured, dx, dy):
    found, filled = {}, without_holes(measured)
    x, y = (t.ravel() for t in np.meshgrid([-dx, 0, dx], [-dy, 0, dy]))
    quadratic = np.linalg.pinv(np.stack([np.ones(9), x, y, x * x, x * y, y * y], axis=1))
    mean, height = np.nanmean(measured), np.nanmax(measured) - np.nanmin(measured)
    level = np.nanmedian(measured)
    for side, names in ((1, "Spd S5p Spc Sha Shv"), (-1, "Svd S5v Svc Sda Sdv")):
        z, edge = side * filled, at_edge(filled)
        tops, owner = hills(z, 0.05 * height)
        inner = [k for k in tops if not edge.ravel()[k]]
        density = len(inner) / (np.count_nonzero(~np.isnan(filled)) * dx * dy)
        five = np.mean(z.ravel()[inner[:5]]) - side * mean
        bends = []
        for k in inner:
            j, i = divmod(k, z.shape[1])
            c = quadratic @ (side * measured[j - 1 : j + 2, i - 1 : i + 2].ravel())
            bends.append(-c[3] - c[5])
        high = z >= side * level
        inverse = np.unique(owner[high], return_inverse=True)[1]
        open_ = np.bincount(inverse, edge[high]) > 0
        area = np.bincount(inverse)[~open_] * dx * dy
        volume = np.bincount(inverse, z[high] - side * level)[~open_] * dx * dy
        values = (density, five, np.nanmean(bends), area.mean(), volume.mean())
        found |= dict(zip(names.split(), values, strict=True))
    return found | {"S10z": found["S5p"] + found["S5v"]}


@pytest.mark.parametrize(
    "name", [MAPS[0], *(pytest.param(m, marks=pytest.mark.slow) for m in MAPS[1:])]
)
def test_symbols_of_real_maps(corpus, name):
    surface = ms.read(corpus / "st" / name)
    z, steps = levelled(surface), (surface.dx, surface.dy)
    own = heights(z) | slopes(z, *steps) | lags(z, *steps) | {"Ssw": wavelength(z, *steps)}
    own |= features(z, *steps) | two_lines(z - np.nanmean(z))
    path, names = str(corpus / "st" / name), ",".join(own)
    run = CliRunner().invoke(
        cli, ["measure", path, "--form", "plane", "--params", names, "--json"]
    )
    assert run.exit_code == 0, run.output
    found = {k: v["value"] for k, v in json.loads(run.stdout)["parameters"].items()}

    assert set(found) == set(own)
    for symbol, value in own.items():
        within = SAME if symbol in SUMMED else WITHIN
        assert found[symbol] == pytest.approx(value, rel=within, abs=0.0), symbol


def hostile(kind):
    """A tilted map of oblong pixels with lay, spikes, dropouts and a hole; or one of 16 x 16 pixels in mm."""
    rng = np.random.default_rng(77)
    shape, steps = ((90, 120), (0.7e-6, 2.1e-6)) if kind == "lay" else ((16, 16), (1e-3, 1e-3))
    z = gaussian_filter(rng.standard_normal(shape), (1.5, 6.0) if kind == "lay" else 1.2) * 1e-6
    y, x = np.mgrid[: shape[0], : shape[1]]
    if kind == "lay":
        where = rng.integers(5, 85, (2, 25))
        z[tuple(where)] += rng.choice([-1.0, 1.0], 25) * 3 * z.std()
        lost = rng.random(shape) < 0.03
        lost[30:42, 50:61] = True
        lost[[0, -1]] = lost[:, [0, -1]] = (
            False  # there the rule for small holes is another, see its page
        )
        z[lost] = np.nan
    return ms.Surface(z + 3e-3 * x * steps[0] - 2e-3 * y * steps[1] + 1e-3, *steps)


NAMED = {
    "lay": {"Sdq": 0.12, "Sdr": 0.25},
    "tiny": dict.fromkeys(
        ["Sk", "Spk", "Svk", "Smrk1", "Smrk2", "Sak1", "Sak2", "Spkx", "Svkx", "Sal", "Str"], 0.5
    ),
}
"""Rules that differ: pixels within three of a dropout have no slope, theirs one that is shorter
(docs/parameters/sdq.md); of 256 samples two windows of 40 % are nearly as flat, and a lag of two pixels is between pixels."""


@pytest.mark.parametrize("kind", ["lay", "tiny"])
def test_symbols_of_hostile_maps_by_command_recipe_and_csv(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    surface = hostile(kind)
    ms.write(surface, "map.h5")
    z, steps = levelled(surface), (surface.dx, surface.dy)
    own = heights(z) | slopes(z, *steps) | lags(z, *steps) | {"Ssw": wavelength(z, *steps)}
    if kind == "lay":
        own |= features(z, *steps)
    names = ",".join(own)

    def run(*words):
        found = CliRunner().invoke(cli, [str(w) for w in words])
        assert found.exit_code == 0, found.output
        return found.stdout

    out = run("measure", "map.h5", "--form", "plane", "--params", names, "--json")
    found = {k: v["value"] for k, v in json.loads(out)["parameters"].items()}
    assert set(found) == set(own)
    for symbol, value in own.items():
        within = NAMED[kind].get(symbol, SAME if symbol in SUMMED else WITHIN)
        assert found[symbol] == pytest.approx(value, rel=within, abs=0.0), symbol

    listed = ", ".join(f'"{v}"' for v in own)
    Path("r.toml").write_text(
        'metrosep = 1\n[input]\nfiles = ["map.h5"]\n[[step]]\nop = "form"\nform = "plane"\n'
        f'[[step]]\nop = "parameters"\nnames = [{listed}]\n[[output]]\nkind = "report"\n',
        encoding="utf-8",
    )
    run("run", "r.toml", "-o", "one")
    document = json.loads(Path("one/result.json").read_text(encoding="utf-8"))
    rows = {c["metric"]: c["value"] for c in document["characteristics"]}
    run("report", "one", "--format", "csv", "-o", "table")
    table = Path("table/report.csv").read_text(encoding="utf-8-sig").splitlines()
    lines = {r["metric"]: float(r["value"]) for r in csv.DictReader(table)}
    for symbol, value in found.items():
        assert (rows[symbol], lines[symbol]) == (value, value), symbol
