"""metrosep psd: a disc of known spectrum against limits, at the command line and by recipe."""

import csv
import json
import re

import numpy as np
import pytest
from scipy import stats

import metrosep as ms

STEP = 1e-5


@pytest.fixture
def disc(tmp_path):
    """A disc of 3 mm with dropouts and a tilt; f^-3 in two dimensions, 20 nm RMS."""
    rng, n, wide = np.random.default_rng(0), 300, 1024
    fx = np.fft.fftfreq(wide)
    f = np.hypot(fx[:, None], fx)
    f[0, 0] = f[0, 1]
    z = np.fft.ifft2(np.fft.fft2(rng.standard_normal((wide, wide))) * f**-1.5).real[:n, :n]
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    lost = (x * x + y * y > 1.0) | (rng.random(z.shape) < 0.01)
    z = np.where(lost, np.nan, z / z.std() * 20e-9 + 1e-6 * x)
    path = tmp_path / "disc.h5"
    ms.write(ms.Surface(z, STEP, STEP), path)
    return path


@pytest.mark.parametrize(
    ("limit", "code", "verdict"),
    [
        ("A = 5 nm^2 mm, B = 2 from 0.05 mm to 0.5 mm", 1, "reject"),
        ("rms = 60 nm from 0.05 mm to 0.5 mm", 0, "accept"),
        ("rms = 7 nm from 0.05 mm to 0.5 mm", 3, "inconclusive"),
    ],
)
def test_a_disc_is_judged(metrosep, disc, limit, code, verdict):
    found, out, _ = metrosep("psd", disc, "--limit", limit)
    assert found == code
    assert f"verdict: {verdict}" in out
    assert "of the outline were holes" in out

    found, out, _ = metrosep("psd", disc, "--limit", limit, "--json")
    content = json.loads(out)
    assert (found, content["verdict"]) == (code, verdict)
    assert all(b["wavelength_m"][0] < b["wavelength_m"][1] for b in content["bands"])


def test_the_recipe_says_the_same_and_draws_the_limit(metrosep, disc, tmp_path):
    recipe = tmp_path / "r.toml"
    limit = "A = 5 nm^2 mm, B = 2 from 0.05 mm to 0.5 mm"
    recipe.write_text(
        f'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n[[step]]\nop = "form"\nform = "plane"\n'
        f'[[step]]\nop = "psd"\nlimit = "{limit}"\n[[check]]\nmetric = "PSD"\n'
        '[[output]]\nkind = "report"\n',
        encoding="utf-8",
    )
    code, _, err = metrosep("run", recipe, "-o", tmp_path / "out")
    assert code == 1
    assert "bands not accepted" in err
    document = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    (entry,) = [c for c in document["characteristics"] if c["metric"] == "PSD"]
    assert entry["verdict"] == "reject"
    assert entry["u_source"] == "scatter of the spectrum"
    charts = [c["title"] for c in document["separation"]["charts"]]
    assert "Power spectral density" in charts
    assert "Power spectral density" in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_two_limits_with_names_are_told_apart_on_the_page(metrosep, disc, tmp_path):
    """A check with a name of its own does not hide what was asked: the page has both limits."""
    recipe = tmp_path / "r.toml"
    limits = ("RMS = 60 nm from 50 µm to 0.5 mm", "A = 5 nm²·mm, B = 2 from 0.05 mm to 0.5 mm")
    steps = "".join(f'[[step]]\nop = "psd"\nlimit = "{limit}"\n' for limit in limits)
    checks = (
        '[[check]]\nmetric = "PSD"\nname = "waves"\n[[check]]\nmetric = "PSD#2"\nname = "slope"\n'
    )
    recipe.write_text(
        f'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n{steps}{checks}[[output]]\nkind = "report"\n',
        encoding="utf-8",
    )
    code, _, _ = metrosep("run", recipe, "-o", tmp_path / "out")
    assert code == 1
    document = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    found = {c["name"]: c for c in document["characteristics"]}
    page = (tmp_path / "out" / "report.html").read_text("utf-8").partition("<h2>Annex")[0]
    for name, verdict, limit in zip(("waves", "slope"), ("accept", "reject"), limits, strict=True):
        assert found[name]["verdict"] == verdict
        assert found[name]["u_note"].endswith(f"; limit: {limit}")
        assert f"limit: {limit}" in page
        # the same at the command line
        _, out, _ = metrosep("psd", disc, "--limit", limit, "--json", "--form", "none")
        content = json.loads(out)
        assert content["verdict"] == verdict
        assert max(b["ratio"] for b in content["bands"]) == found[name]["value"]


@pytest.mark.parametrize(
    ("words", "message", "wanted"),
    [
        (("--limit", "A = 5, B = 2 from 0.05 mm to 0.5 mm"), "the unit of the density is needed", 2),
        (("--limit", "rms = 1 nm from 0.05 mm to 0.5 mm", "--max-filled", "0"),
         "more than the 0 % that --max-filled allows: holes would decide the spectrum; crop, or raise --max-filled", 4),
        (("--limit", "rms = 1 nm from 0.05 mm to 0.5 mm", "--max-filled", "1.5"),
         "error: --max-filled is a share from 0 to 1", 2),
    ],
)  # fmt: skip
def test_what_cannot_be_judged_is_one_sentence(metrosep, disc, words, message, wanted):
    code, _, err = metrosep("psd", disc, *words)
    assert code == wanted  # 4: the map is at fault, 2: what was typed
    assert message in err
    assert err.count("error:") == 1
    assert not re.search(r"max_filled|command line|step \d", err)


def test_a_psd_check_has_no_limits_of_its_own(metrosep, disc, tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n[[step]]\nop = "psd"\n'
        'limit = "rms = 1 nm from 0.05 mm to 0.5 mm"\n[[check]]\nmetric = "PSD"\nupper = 1.0\n',
        encoding="utf-8",
    )
    code, _, err = metrosep("run", recipe, "-o", tmp_path / "out")
    assert code == 2
    assert "r.toml:9" in err


def test_a_falling_spectrum_from_heights_says_that_its_low_bands_read_high(metrosep, disc):
    limit = "rms = 60 nm from 0.05 mm to 1.4 mm"
    found = {}
    for estimate in ("heights", "slopes", "auto"):
        _, out, _ = metrosep("psd", disc, "--limit", limit, "--estimate", estimate, "--json")
        found[estimate] = json.loads(out)

    longest = {k: v["bands"][0]["mean"] for k, v in found.items()}
    assert longest["heights"] > longest["slopes"] == longest["auto"]
    high = {k: any("reads high" in n for n in v["notes"]) for k, v in found.items()}
    assert high == {"heights": True, "slopes": False, "auto": False}


def test_slopes_cannot_keep_a_tilt(metrosep, disc, tmp_path):
    recipe = tmp_path / "r.toml"
    recipe.write_text(
        'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n[[step]]\nop = "psd"\n'
        'limit = "rms = 60 nm from 0.05 mm to 1 mm"\ndetrend = "mean"\nestimate = "slopes"\n'
        '[[check]]\nmetric = "PSD"\n',
        encoding="utf-8",
    )
    code, out, _ = metrosep("check", recipe)
    assert code == 2
    assert "r.toml:8" in out
    assert 'goes with detrend = "plane"' in out


def test_a_verdict_of_bands_has_limit_and_guard_band_in_every_output(metrosep, disc, tmp_path):
    """What other programs read has the limit 1, and value and guard band give the verdict again."""
    recipe = tmp_path / "r.toml"
    band = "from 0.05 mm to 0.5 mm"
    limits = (f"A = 5 nm^2 mm, B = 2 {band}", f"rms = 60 nm {band}", f"rms = 7 nm {band}")
    steps = "".join(f'[[step]]\nop = "psd"\nlimit = "{limit}"\n' for limit in limits)
    checks = "".join(f'[[check]]\nmetric = "PSD{n}"\n' for n in ("", "#2", "#3"))
    recipe.write_text(
        f'metrosep = 1\n[input]\nfiles = ["disc.h5"]\n{steps}{checks}[[output]]\nkind = "report"\n',
        encoding="utf-8",
    )
    metrosep("run", recipe, "-o", tmp_path / "out")
    document = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    rows = [c for c in document["characteristics"] if c["metric"].startswith("PSD")]
    assert [c["verdict"] for c in rows] == ["reject", "accept", "inconclusive"]
    for c in rows:
        assert c["upper"] == 1.0
        assert 0.0 < c["guard_factor"] * c["U"] < c["U"]
        again = ms.parameters.decide(
            c["value"], upper=1.0, U=c["U"], guard_factor=c["guard_factor"]
        )
        assert again == c["verdict"]
    # an RMS is one band: both ends by hand, from chi-square of 2 n of its sentence
    n = float(re.search(r"\(([\d.]+) independent", rows[1]["u_note"])[1])
    most = float(re.search(r"lies between .* and ([\d.]+) at", rows[1]["u_note"])[1])
    by_hand = rows[1]["value"] * 2 * n / stats.chi2.ppf(0.05, 2 * n)
    assert most == pytest.approx(by_hand, abs=2e-3 * by_hand)  # n and the ratio have three digits
    with_holes = rows[1]["value"] + rows[1]["guard_factor"] * rows[1]["U"]
    assert (
        by_hand < with_holes < 1.05 * by_hand
    )  # 1 % of the window's square was closed, (1 - 2 s)^2
    words = ("--format", "csv,qif,dfq", "-o", tmp_path / "o")
    code, _, err = metrosep("report", tmp_path / "out", *words)
    assert code in (0, 1, 3), err
    text = {p.suffix: p.read_text("utf-8-sig") for p in (tmp_path / "o").iterdir()}
    lines = [v for v in csv.DictReader(text[".csv"].splitlines()) if v["metric"].startswith("PSD")]
    assert [float(v["upper"]) for v in lines] == [1.0, 1.0, 1.0]
    assert [float(v["U"]) for v in lines] == [c["U"] for c in rows]
    assert all(0.0 < float(v["guard"]) < float(v["U"]) for v in lines)
    assert text[".qif"].count('<MaxValue unitName="1">1</MaxValue>') == 3
    assert len(re.findall(r"K2111/\d+ 1\b", text[".dfq"])) == 3
