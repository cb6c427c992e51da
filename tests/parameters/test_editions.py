"""Where editions of a standard differ: each one's number through the command line, worked out here.

Triangles of known width and height, five sections: hills are highest in the second, dales deepest in the
third, and the fourth is so low that the edition of 2021 (thresholds of the whole length) passes over it
while that of 1997 (thresholds of each section) counts it.
"""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from metrosep.cli.main import cli
from metrosep.core.errors import MetrosepError

N = 2400  # samples of a section, 0.5 um each
HALF = (120, 60, 100, 150, 200)  # samples of a hill, and of a dale
HILLS = (1.0, 2.5, 1.2, 0.05, 1.6)  # um
DALES = (0.8, 1.5, 3.0, 0.04, 1.1)
DX = 0.5e-6
OPTIONS = ("--kind", "R", "--sections", "5")
DIGITS = 1e-9
"""Relative: heights are written with 12 digits."""


def sections():
    """Rows of the profile in um; samples at half steps, so that a crossing lies between two of them."""
    rows = []
    for m, hill, dale in zip(HALF, HILLS, DALES, strict=True):
        t = 1 - np.abs(2 * (np.arange(m) + 0.5) / m - 1)
        rows.append(np.tile(np.concatenate([hill * t, -dale * t]), N // (2 * m)))
    return np.array(rows)


def top(k, heights):
    """The highest sample of a triangle, which lies half a step off its corner."""
    return heights[k] * (1 - 1 / HALF[k])


def measured(tmp_path, symbols, edition, z):
    path = tmp_path / "profile.csv"
    rows = (f"{1e3 * DX * i:.4f},{h:.12g}" for i, h in enumerate(z))
    path.write_text("x_mm,z_um\n" + "\n".join(rows) + "\n")
    done = CliRunner().invoke(
        cli,
        ["measure", str(path), "--params", symbols, "--json", "--edition", edition, *OPTIONS],
    )
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)["parameters"]


def slopes(z):
    """The 7-point formula, term by term, 1 per sample."""
    c = {1: 45, 2: -9, 3: 1}
    n = z.size
    return sum(w * (z[3 + k : n - 3 + k] - z[3 - k : n - 3 - k]) for k, w in c.items()) / 60


def field(z):
    q = np.sqrt(np.mean(z**2))
    return {
        "Ra": np.mean(np.abs(z)),
        "Rq": q,
        "Rsk": np.mean(z**3) / q**3,
        "Rku": np.mean(z**4) / q**4,
        "Rdq": np.sqrt(np.mean(slopes(z) ** 2)),
    }


def elements_of_2021():
    """Mean width in samples and height of the elements over the whole length, by their portions.

    The fourth section is below the thresholds: it belongs to what came before it, which is the last
    dale of the third section from the left and the first hill of the fifth from the right.
    """
    size, height = [], []
    for k in (0, 1, 2, 4):
        size += [float(HALF[k])] * (N // HALF[k])
        height += [top(k, HILLS), top(k, DALES)] * (N // (2 * HALF[k]))
    border = sum(N // HALF[k] for k in (0, 1, 2))  # the portion that follows the low section

    # Crossings lie half way but where two slopes meet: the share of the step is that of the heights.
    def off(left, right):
        return left / (left + right) - 0.5

    joints = np.cumsum([N // HALF[k] for k in (0, 1, 2)])
    slope_of_dale, slope_of_hill = (
        [v / m for v, m in zip(h, HALF, strict=True)] for h in (DALES, HILLS)
    )
    for at, k in zip(joints[:2], (0, 1), strict=True):
        late = off(slope_of_dale[k], slope_of_hill[k + 1])
        size[at - 1] += late
        size[at] -= late
    widths = []
    for side in (0, 1):
        own = list(size)
        if side == 0:  # up to the hill of the fifth section
            late = off(slope_of_dale[3], slope_of_hill[4])
            own[border - 1] += N + late
            own[border] -= late
        else:  # down to the dale of the third
            late = off(slope_of_dale[2], slope_of_hill[3])
            own[border - 1] += late
            own[border] += N - late
        inner = np.array(own[1:-1])  # the ends are not whole
        widths.append(np.mean(inner[:-1] + inner[1:]))
    inner = np.array(height[1:-1])
    return np.mean(widths), np.mean(inner[:-1] + inner[1:])


EXPECTED_SECTIONS = {  # of each edition: means over the sections of these
    "Rp": [top(k, HILLS) for k in range(5)],
    "Rv": [top(k, DALES) for k in range(5)],
    "Rz": [top(k, HILLS) + top(k, DALES) for k in range(5)],
}
RZ1MAX = 1e-6 * max(EXPECTED_SECTIONS["Rz"])
RZX = 1e-6 * (top(1, HILLS) + top(2, DALES))
LENGTHS = {"Ra", "Rq"}


def expect(found, symbol, value):
    assert found[symbol]["value"] == pytest.approx(value, rel=DIGITS, abs=0.0), symbol


@pytest.mark.parametrize("step", [1, -1])
def test_edition_of_1997(tmp_path, step):
    """Reversed, a section begins with a dale; nothing else changes."""
    rows = sections()
    z = rows.ravel()[::step]
    found = measured(tmp_path, "Ra,Rq,Rsk,Rku,Rdq,Rp,Rv,Rz,Rt,Rz1max,RSm,Rc", "ISO 4287:1997", z)
    each = [field(row[::step]) for row in rows]
    for symbol in each[0]:
        unit = 1e-6 if symbol in LENGTHS else 1e-6 / DX if symbol == "Rdq" else 1.0
        expect(found, symbol, unit * np.mean([e[symbol] for e in each]))
    for symbol, values in EXPECTED_SECTIONS.items():
        expect(found, symbol, 1e-6 * np.mean(values))
    expect(found, "Rt", RZX)
    expect(found, "Rz1max", RZ1MAX)
    expect(found, "RSm", DX * np.mean([2 * m for m in HALF]))
    expect(found, "Rc", 1e-6 * np.mean(EXPECTED_SECTIONS["Rz"]))


@pytest.mark.parametrize("step", [1, -1])
def test_edition_of_2021(tmp_path, step):
    z = sections().ravel()[::step]
    found = measured(
        tmp_path, "Ra,Rq,Rsk,Rku,Rdq,Rp,Rv,Rz,Rt,Rzx,Rsm,Rc,Rpt,Rvt", "ISO 21920-2:2021", z
    )
    for symbol, value in field(z).items():
        unit = 1e-6 if symbol in LENGTHS else 1e-6 / DX if symbol == "Rdq" else 1.0
        expect(found, symbol, unit * value)
    for symbol, values in EXPECTED_SECTIONS.items():
        expect(found, symbol, 1e-6 * np.mean(values))
    expect(found, "Rpt", 1e-6 * top(1, HILLS))
    expect(found, "Rvt", 1e-6 * top(2, DALES))
    expect(found, "Rzx", RZX)
    width, height = elements_of_2021()
    expect(found, "Rsm", DX * width)
    expect(found, "Rc", 1e-6 * height)


def test_edition_of_asme(tmp_path):
    z = sections().ravel()
    found = measured(tmp_path, "Ra,Rq,Rsk,Rku,Rdq,Rp,Rv,Rpm,Rvm,Rtm,Rmax,Rt", "ASME B46.1", z)
    for symbol, value in field(z).items():
        unit = 1e-6 if symbol in LENGTHS else 1e-6 / DX if symbol == "Rdq" else 1.0
        expect(found, symbol, unit * value)
    expect(found, "Rp", 1e-6 * top(1, HILLS))
    expect(found, "Rv", 1e-6 * top(2, DALES))
    for symbol, values in EXPECTED_SECTIONS.items():
        expect(found, {"Rp": "Rpm", "Rv": "Rvm", "Rz": "Rz"}[symbol], 1e-6 * np.mean(values))
    expect(found, "Rmax", RZ1MAX)


@pytest.mark.parametrize("edition", ["ISO 25178-2:2012", "ISO 25178-2:2021"])
def test_editions_of_maps(tmp_path, edition):
    """Heights of a material ratio curve of three straight pieces, in any order: 4, 1.5, -0.39, -3.39 um."""
    n = 200
    m = (np.arange(n * n) + 0.5) / (n * n)
    z = np.random.default_rng(5).permutation(
        np.interp(m, [0, 0.12, 0.75, 1], [4, 1.5, -0.39, -3.39])
    )
    path = tmp_path / "map.sdf"
    path.write_text(
        "aISO-1.0\nManufacID   = x\nCreateDate  = 010120200000\nModDate     = 010120200000\n"
        f"NumPoints   = {n}\nNumProfiles = {n}\nXscale      = 1e-6\nYscale      = 1e-6\n"
        "Zscale      = 1e-6\nZresolution = -1.0\nCompression = 0\nDataType    = 7\n"
        "CheckType   = 0\n*\n" + "\n".join(f"{v:.12g}" for v in z) + "\n*\n"
    )
    own, other = ("Smr1", "Smr2"), ("Smrk1", "Smrk2")
    only_new = "Sak1,Sak2,Spkx,Svkx"
    if edition == "ISO 25178-2:2021":
        own, other = other, own
    asked = ["Sk", "Spk", "Svk", "Sxp", "Sdc(2.5 %,50 %)", *other]
    options = ["--edition", edition, "--json"]
    run = CliRunner().invoke(cli, ["measure", str(path), "--params", ",".join(asked), *options])
    assert run.exit_code == 0, run.output
    document = json.loads(run.stdout)
    found = {k: v["value"] for k, v in document["parameters"].items()}
    # The line of the middle piece runs from 1.86 um at 0 to -1.14 um at 1: it meets the outer ones
    # where these are as high; peaks and valleys are triangles of that share.
    peak, valley = 0.12 * 2.14 / 2.5, 0.25 * 2.25 / 3.0
    wanted = {"Sk": 3e-6, "Spk": 2.14e-6, "Svk": 2.25e-6, own[0]: peak, own[1]: 1.0 - valley}
    high, middle = 4 - 2.5 * 0.025 / 0.12, 1.5 - 1.89 * 0.38 / 0.63
    wanted |= {"Sxp": 1e-6 * (high - middle), "Sdc(2.5 %, 50 %)": 1e-6 * (high - middle)}
    assert set(found) == set(wanted)
    for symbol, value in wanted.items():
        # The curve has a step of 1/40000 of the area: that much of a peak's share is 2e-4 of it.
        assert found[symbol] == pytest.approx(value, rel=3e-4, abs=0.0), symbol
    assert document["evaluations"][0]["edition"] == edition
    more = CliRunner().invoke(cli, ["measure", str(path), "--params", only_new, *options])
    if edition == "ISO 25178-2:2012":  # it has no such symbols: refused with the edition's name
        assert isinstance(more.exception, MetrosepError)
        assert edition in str(more.exception)
    else:
        values = {k: v["value"] for k, v in json.loads(more.stdout)["parameters"].items()}
        expected = {"Sak1": 0.5e-6 * 2.14 * peak, "Sak2": 0.5e-6 * 2.25 * valley}
        for symbol, value in (expected | {"Spkx": 2.14e-6, "Svkx": 2.25e-6}).items():
            assert values[symbol] == pytest.approx(value, rel=3e-4, abs=0.0), symbol
