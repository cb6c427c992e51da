"""What `metrosep measure` prints of plateaus with pits, whose parameters are sums done by hand."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from metrosep.cli.main import cli

pytestmark = pytest.mark.usefixtures("without_figures")

DIGITS = 1e-9
"""Relative: heights are written with 12 digits, sums of 10 000 samples round below."""


def measured(path, symbols, *options):
    done = CliRunner().invoke(cli, ["measure", str(path), "--params", symbols, "--json", *options])
    assert done.exit_code == 0, done.output
    return {k: v["value"] for k, v in json.loads(done.stdout)["parameters"].items()}


def expect(found, **wanted):
    for symbol, value in wanted.items():
        assert found[symbol] == pytest.approx(value, rel=DIGITS, abs=1e-18), symbol


@pytest.fixture
def profile(tmp_path):
    """Return a function that writes 50 pits, 1.0 to 2.8 um deep, 20 of 200 samples, as a file."""
    i = np.arange(10_000)
    depth = 1.0 + (i // 200 % 10) * 0.2
    triangle = np.clip(1 - np.abs(i % 200 - 99.5) / 10, 0, None)

    def written(sign=1, step=1):
        z = -sign * (triangle * depth)[::step]
        rows = [f"{x:.4f},{h:.12g}" for x, h in zip(i * 0.5e-3, z, strict=True)]
        path = tmp_path / "pits.csv"
        path.write_text("x_mm,z_um\n" + "\n".join(rows) + "\n")
        return path

    return written


SECTIONS = ("--kind", "R", "--sections", "5", "--centre")


@pytest.mark.parametrize("step", [1, -1])
def test_pits_of_a_profile(profile, step):
    found = measured(
        profile(step=step),
        "Rp,Rv,Rz,Rpt,R5v,Rvd,Rsm,Rmr(-0.5 um),Rmr(0 %,0.5 um),Rcm(80 %),Rvv(80 %),Rvm(80 %)",
        *SECTIONS,
    )
    # Mean of the triangle 10 / 20 of a tenth of the length, mean depth 1.9: 95 nm below the plateau.
    expect(found, Rp=95e-9, Rpt=95e-9, Rv=2.66e-6 - 95e-9, Rz=2.66e-6, R5v=2.66e-6 - 95e-9)
    expect(found, Rvd=1 / 100e-6, Rsm=100e-6)
    expect(found, **{"Rcm(80 %)": 0.0, "Rvv(80 %)": 95e-9, "Rvm(80 %)": 0.0})
    # Triangle samples .05, .15 ... .95, each twice: 595 nm below the plateau, depth by depth.
    deeper = [
        sum((2 * k + 1) * (10 + 2 * d) > edge for k in range(10) for d in range(10)) * 2 / 2000
        for edge in (119, 100)
    ]
    expect(found, **{"Rmr(-500 nm)": 1 - deeper[0], "Rmr(0 %, 500 nm)": 1 - deeper[1]})


def test_peaks_are_pits_upside_down(profile):
    found = measured(profile(sign=-1), "Rp,Rv,Rpd,Rcm(80 %),Rvm(20 %),Rsk", *SECTIONS)
    expect(found, Rp=2.66e-6 - 95e-9, Rv=95e-9, Rpd=1 / 100e-6)
    expect(found, **{"Rcm(80 %)": -2.66e-6, "Rvm(20 %)": 95e-9})
    assert found["Rsk"] > 4.0


def test_names_of_asme_are_asked_for_at_the_door(profile):
    found = measured(
        profile(), "Rpm,Rp,Rtm,Rmax,Rt,tp(-0.5 um)", *SECTIONS, "--edition", "ASME B46.1"
    )
    expect(found, Rpm=95e-9, Rp=95e-9, Rz=2.66e-6, Rmax=2.66e-6, Rt=2.66e-6)
    assert found["Rmr(-500 nm)"] == measured(profile(), "Rmr(-500 nm)", *SECTIONS)["Rmr(-500 nm)"]
    limits = ("--lower", "tp(-0.5 um)=93 %", "--U", "tp(-0.5 um)=0.1 %")
    measured(profile(), "tp(-0.5 um)", *SECTIONS, "--edition", "ASME B46.1", *limits)


@pytest.mark.parametrize(("sign", "valley", "peak"), [(1, 1.9e-6, 0.0), (-1, 0.0, 1.9e-6)])
def test_robust_line_stays_on_the_plateau(profile, sign, valley, peak):
    found = measured(
        profile(sign=sign), "Rk,Rpk,Rvk", "--lambda-c", "0.8 mm", "--core-filter", "robust"
    )
    # Twice the mean 95 nm over the tenth of the length that the pits take.
    assert found["Rvk"] == pytest.approx(valley, abs=1e-12)
    assert found["Rpk"] == pytest.approx(peak, abs=1e-12)
    assert found["Rk"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("step", [1, -1])
def test_paraboloid_pits_of_a_map(tmp_path, sign, step):
    """100 pits of 0.5 um depth and 10 um radius on 250 x 400 pixels of 2 um by 1 um."""
    y, x = np.mgrid[:250, :400]
    r2 = (x % 40 - 19.0) ** 2 + (2.0 * (y % 25 - 12)) ** 2
    z = -sign * 500.0 * np.clip(1 - r2 / 100, 0, None)[:, ::step]
    path = tmp_path / "pits.sdf"
    path.write_text(
        "aISO-1.0\nManufacID   = x\nCreateDate  = 010120200000\nModDate     = 010120200000\n"
        "NumPoints   = 400\nNumProfiles = 250\nXscale      = 1e-6\nYscale      = 2e-6\n"
        "Zscale      = 1e-9\nZresolution = -1.0\nCompression = 0\nDataType    = 7\n"
        "CheckType   = 0\n*\n"
        + "\n".join(" ".join(f"{v:.9g}" for v in row) for row in z)
        + "\n*\n"
    )
    share = np.mean(z != 0)
    mean = np.abs(z).mean() * 1e-9
    if sign == 1:
        deep, flat, density, curvature, five = "Sv", "Sp", "Svd", "Svc", "S5v"
        core, ratio, volume = "Svk", "Smrk2", "Vv(80 %)"
        at = "Smr(-0.2 um),Sda(95 %)"
    else:
        deep, flat, density, curvature, five = "Sp", "Sv", "Spd", "Spc", "S5p"
        core, ratio, volume = "Spk", "Smrk1", "Vm(20 %)"
        at = "Smr(0.2 um),Sha(5 %)"
    found = measured(
        path, f"{deep},{flat},{density},{curvature},{five},{core},{ratio},{volume},Sk,{at}"
    )
    expect(
        found, **{deep: 500e-9 - mean, flat: mean, five: 500e-9 - mean, volume: mean, "Sk": 0.0}
    )
    expect(found, **{density: 1 / 2000e-12, core: 2 * mean / share, curvature: 2 * 0.5e-6 / 1e-10})
    expect(found, **{ratio: 1 - share if sign == 1 else share})
    below = np.mean(np.abs(z) * 1e-9 - mean > 200e-9)
    expect(found, **{"Smr(-200 nm)": 1 - below} if sign == 1 else {"Smr(200 nm)": below})
    level = np.sort(np.abs(z).ravel())[-z.size // 20]
    area = np.sum(np.abs(z) >= level) / 100 * 2e-12
    expect(found, **{"Sda(95 %)" if sign == 1 else "Sha(5 %)": area})


@pytest.mark.parametrize("shape", [(1, 80), (80, 1), (2, 60)])
def test_of_a_map_that_is_all_border_no_peak_is_counted(tmp_path, shape):
    """A row, a column, two rows, and a map of which every other row is missing: no pixel has all neighbours.

    The row had 14 peaks for each mm^2 and the column none, and Spd of the others was 0.
    """
    z = np.fromfunction(lambda y, x: np.sin(1.3 * (x + y)) + 0.1 * y, shape)
    holed = np.repeat(np.atleast_2d(z), 2, axis=0)
    holed[1::2] = np.nan
    for name, heights in (("bare", z), ("holed", holed)):
        path = tmp_path / f"{name}.npy"
        np.save(path, heights * 1e-7)
        options = [
            "--unit",
            "m",
            "--lateral-step",
            "2 um",
            "--params",
            "Spd,S10z,Sha,Sq",
            "--json",
        ]
        done = CliRunner().invoke(cli, ["measure", str(path), *options])
        found = json.loads(done.stdout)
        assert set(found["parameters"]) == {"Sq"}
        assert "at the border of the map or of a hole" in found["unavailable"]["Spd"]


def test_an_uncertainty_that_is_not_known_is_not_printed_as_a_number(tmp_path):
    np.save(tmp_path / "small.npy", 1e-9 * np.arange(9.0).reshape(3, 3) ** 2)
    options = ["--unit", "m", "--lateral-step", "2 um", "--form", "sphere"]
    printed = CliRunner().invoke(cli, ["form", str(tmp_path / "small.npy"), *options]).output
    assert printed.count("u = not known") == 5
    assert "nan" not in printed
