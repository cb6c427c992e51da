"""Symbols of three real profiles through `metrosep measure`, against definitions written down once more here.

Nothing of the package but its reader is used. One export of a stylus instrument, one section of an optical
one with missing samples at its ends, one of a probe; the last two are levelled and filtered here, sample by sample.
"""

import json
from itertools import pairwise

import numpy as np
import pytest
from click.testing import CliRunner

import metrosep as ms
from metrosep.cli.main import cli

pytestmark = pytest.mark.usefixtures("without_figures")

PROFILES = {
    "st/mitutoyo_2_mock.xlsx": (None, 4, ["--kind", "R", "--sections", "4"]),
    "upm/1023-WLI-2D.csv": (80e-6, 10, ["--form", "plane", "--lambda-c", "80 um"]),
    "st/opdx-3.opdx": (8e-6, 6, ["--form", "plane", "--lambda-c", "8 um"]),
}
"""File; cut-off / m, None of a file that holds an R profile; sections; options."""
WITHIN = 1e-6
"""Of the value: both sides sum the same samples."""
CORE = 0.01
"""Of the core family: which samples are the flattest 40 % changes by one where two windows are alike."""


def local_line(x, z, cutoff):
    """The waviness: at each sample a line through its neighbours under a Gaussian."""
    alpha, seen, found = np.sqrt(np.log(2) / np.pi), ~np.isnan(z), np.empty(z.size)
    for i, here in enumerate(x):
        near = seen & (np.abs(x - here) <= cutoff)
        t = x[near] - here
        k = np.exp(-np.pi * (t / (alpha * cutoff)) ** 2)
        A = [[k.sum(), k @ t], [k @ t, k @ t**2]]
        found[i] = np.linalg.solve(A, [k @ z[near], k @ (t * z[near])])[0]
    return found


def portions(x, z):
    """Sign, left and right crossing, height of what lies between the crossings of zero."""
    found, sign, first, left = [], np.where(z >= 0, 1, -1), 0, x[0]
    for i in range(1, z.size + 1):
        if i < z.size and sign[i] == sign[first]:
            continue
        right = x[-1]
        if i < z.size:
            right = x[i - 1] + (x[i] - x[i - 1]) * z[i - 1] / (z[i - 1] - z[i])
        found.append((sign[first], left, right, np.abs(z[first:i]).max()))
        first, left = i, right
    return found


def elements(x, z, up, down):
    """Width and height of each two neighbouring portions, along x and back; what an end cuts is in none."""
    found = []
    for xs, zs in ((x, z), (-x[::-1], z[::-1])):
        p, merged = portions(xs, zs), []
        for k, (sign, left, _, height) in enumerate(p):
            if height < (up if sign > 0 else down):
                continue
            if merged and merged[-1][0] == sign:
                merged[-1][2] = max(merged[-1][2], height)
                merged[-1][4] = k
            else:
                merged.append([sign, left, height, k, k])
        edges = [m[1] for m in merged[1:]] + [p[-1][1] if merged[-1][4] < len(p) - 1 else np.nan]
        found += [
            (end - one[1], one[2] + two[2])
            for one, two, end in zip(merged, merged[1:], edges[1:], strict=False)
            if one[3] > 0 and not np.isnan(end)
        ]
    return np.array(found)


def elements_1997(x, z, height, width):
    """Width and height of pairs of portions from the first crossing on, in one section."""
    p = portions(x, z)
    kept = [k for k, q in enumerate(p) if q[3] >= height and q[2] - q[1] >= width]
    merged = []
    for k in kept:
        if merged and merged[-1][0] == p[k][0]:
            merged[-1][2] = max(merged[-1][2], p[k][3])
        else:
            merged.append([p[k][0], p[k][1], p[k][3]])
    left = [m[1] for m in merged]
    pairs = range(1, len(merged) - 2, 2)
    return np.array([(left[i + 2] - left[i], merged[i][2] + merged[i + 1][2]) for i in pairs])


def derivatives(v, dx):
    """First and second derivative in the middle of seven samples."""
    one = (45 * (v[4] - v[2]) - 9 * (v[5] - v[1]) + v[6] - v[0]) / (60 * dx)
    two = 2 * (v[0] + v[6]) - 27 * (v[1] + v[5]) + 270 * (v[2] + v[4]) - 490 * v[3]
    return one, two / (180 * dx * dx)


def slopes(z, dx):
    return derivatives([z[k : z.size - 6 + k] for k in range(7)], dx)[0]


def prominent(z, least):
    """Peaks that stand so much over the higher of their saddles; one at an end is none."""
    found = []
    for i in range(1, z.size - 1):
        if not z[i - 1] < z[i] > z[i + 1]:
            continue
        saddles, lowest = [], z[i]
        for side in (z[i::-1], z[i:]):
            higher = np.flatnonzero(side > z[i])
            if higher.size:
                saddles.append(side[: higher[0]].min())
            lowest = min(lowest, side.min())
        if z[i] - (max(saddles) if saddles else lowest) >= least:
            found.append(i)
    return found


def core(z):
    """The flattest 40 %, a line through it, triangles of equal area above and below."""
    h = np.sort(z)[::-1]
    wide = round(0.4 * h.size)
    start = int(np.argmin(h[: h.size - wide] - h[wide:]))
    ratio = (np.arange(start, start + wide) + 0.5) / h.size
    slope, top = np.polyfit(ratio, h[start : start + wide], 1)
    bottom = top + slope
    one, two = np.mean(np.maximum(h - top, 0)), np.mean(np.maximum(bottom - h, 0))
    peak, valley = np.mean(h > top), np.mean(h < bottom)
    found = {"Rk": top - bottom, "Rmrk1": peak, "Rmrk2": 1 - valley, "Rak1": one, "Rak2": two}
    found |= {"Rpk": 2 * one / peak, "Rvk": 2 * two / valley}
    return found | {"Rpkx": h[0] - top, "Rvkx": bottom - h[-1]}


def volumes(z):
    h = np.sort(z)[::-1]

    def cut(p):
        return np.interp(p * h.size, np.arange(h.size) + 0.5, h)

    over, under = (
        (lambda p: np.mean(np.maximum(h - cut(p), 0))),
        (lambda p: np.mean(np.maximum(cut(p) - h, 0))),
    )
    found = {"Rvmp": over(0.1), "Rvmc": over(0.8) - over(0.1), "Rvvv": under(0.8)}
    return found | {"Rvvc": under(0.1) - under(0.8), "Rdc(20 %, 80 %)": cut(0.2) - cut(0.8)}


def of_2021(x, z, dx, n):
    edge = borders(z.size, n)
    parts = [z[a:b] for a, b in pairwise(edge)]
    p, v = np.mean([q.max() for q in parts]), -np.mean([q.min() for q in parts])
    rms, d, wide = np.sqrt(np.mean(z * z)), z - z.mean(), round(z.size / n)
    found = {"Ra": np.abs(z).mean(), "Rq": rms, "Rp": p, "Rv": v, "Rz": p + v, "Rpt": z.max()}
    found |= {"Rvt": -z.min(), "Rt": np.ptp(z), "Rku": np.mean(z**4) / rms**4}
    found["Rsk"] = np.mean(z**3) / rms**3
    found["Rzx"] = max(np.ptp(z[i : i + wide]) for i in range(z.size - wide + 1))
    g, length = slopes(z, dx), np.hypot(dx, np.diff(z)).sum()
    found |= {"Rdq": np.sqrt(np.mean(g * g)), "Rda": np.abs(g).mean(), "Rdt": np.abs(g).max()}
    found |= {"Rdl": length, "Rdr": length / (dx * (z.size - 1)) - 1}
    acf = [np.mean(d[: z.size - k] * d[k:]) / np.mean(d * d) for k in range(z.size // 2)]
    k = next(k for k, value in enumerate(acf) if value <= 0.2)
    found["Rsal"] = (k - (0.2 - acf[k]) / (acf[k - 1] - acf[k])) * dx
    found["Rsw"] = z.size * dx / (1 + np.argmax(np.abs(np.fft.rfft(d))[1:]))
    pairs = elements(x, z, 0.1 * p, 0.1 * v)
    found |= {"Rsm": pairs[:, 0].mean(), "Rc": pairs[:, 1].mean()}
    for side, names in ((z, ("Rpd", "R5p", "Rmpc")), (-z, ("Rvd", "R5v", "Rmvc"))):
        tops = prominent(side, 0.05 * (p + v))
        inner = np.array([side[k - 3 : k + 4] for k in tops if 3 <= k < z.size - 3]).T
        one, two = derivatives(inner, dx)
        five = np.mean(sorted(side[tops])[-5:])
        values = (len(tops) / (z.size * dx), five, np.mean(-two / (1 + one**2) ** 1.5))
        found |= dict(zip(names, values, strict=True))
    found["R10z"] = found["R5p"] + found["R5v"]
    sides = [
        [
            sorted(q[3] for q in portions(np.arange(s.size), s) if q[0] == k and q[3] > limit)
            for s in parts
            for k in (1, -1)
        ]
        for limit in (0.1 * (p + v), 0.0)
    ]
    if min(map(len, sides[0])) >= 5:
        found["RzJIS"] = 2 * np.mean([np.mean(s[-5:]) for s in sides[0]])
    if min(map(len, sides[1])) >= 3:
        found["R3z"] = 2 * np.mean([s[-3] for s in sides[1]])
    return found | core(z) | volumes(z)


def of_1997(x, z, dx, n):
    edge = borders(z.size, n)
    rows = []
    for a, b in pairwise(edge):
        s = z[a:b]
        rms, g, height = np.sqrt(np.mean(s * s)), slopes(s, dx), np.ptp(s)
        e = elements_1997(x[a:b], s, 0.1 * height, 0.01 * (b - a) * dx)
        row = [np.abs(s).mean(), rms, np.mean(s**3) / rms**3, np.mean(s**4) / rms**4]
        row += [s.max(), -s.min(), height, np.sqrt(np.mean(g * g)), *e.mean(axis=0)]
        rows.append(row)
    names = ("Ra", "Rq", "Rsk", "Rku", "Rp", "Rv", "Rz", "Rdq", "RSm", "Rc")
    found = dict(zip(names, np.mean(rows, axis=0), strict=True))
    return found | {"Rz1max": max(r[6] for r in rows), "Rt": np.ptp(z)}


def borders(size, n):
    """Of sections of equal length; a sample that a border halves is in the earlier one."""
    return [(2 * k * size + n) // (2 * n) for k in range(n + 1)]


def measured(path, options, names):
    call = ["measure", str(path), *options, "--params", ",".join(names), "--json"]
    run = CliRunner().invoke(cli, call)
    assert run.exit_code == 0, run.output
    return {k: v["value"] for k, v in json.loads(run.stdout)["parameters"].items()}


@pytest.mark.parametrize("name", PROFILES)
def test_symbols_of_real_profiles(corpus, name):
    cutoff, n, options = PROFILES[name]
    profile = ms.read(corpus / name)
    x, z = np.asarray(profile.x), np.asarray(profile.z)
    seen = np.flatnonzero(~np.isnan(z))
    x, z = (v[seen[0] : seen[-1] + 1] for v in (x, z))
    assert not np.isnan(z).any()
    if cutoff is not None:
        z = z - np.polyval(np.polyfit(x - x.mean(), z, 1), x - x.mean())
        z = z - local_line(x, z, cutoff)
    dx = (x[-1] - x[0]) / (x.size - 1)

    for own, edition in (
        (of_2021(x, z, dx, n), "ISO 21920-2:2021"),
        (of_1997(x, z, dx, n), "ISO 4287:1997"),
    ):
        found = measured(corpus / name, [*options, "--edition", edition], own)
        assert set(found) == set(own)
        for symbol, value in own.items():
            tolerance = CORE if symbol in core(z) else WITHIN
            assert found[symbol] == pytest.approx(value, rel=tolerance, abs=0.0), (symbol, edition)
