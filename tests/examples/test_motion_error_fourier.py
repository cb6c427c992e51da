"""The example of Kono's method: data, truth of both slides, the plane, recipes and script."""

import re
import runpy

import numpy as np
import pytest

import metrosep as ms

NAME = "motion_error_fourier"
MOST_LINES = 15
"""Issue 6: a script under 15 lines, comments and blank lines left out."""


@pytest.fixture
def folder(repository):
    return repository / "examples" / NAME


def rms(folder, estimate, axis):
    """Return RMS against the truth in m, offset and line removed."""
    rows = [r.split(",") for r in (folder / "truth.csv").read_text("ascii").split()[1:]]
    x, e = np.array([(float(p) * 1e-3, float(v) * 1e-6) for a, p, v in rows if a == axis]).T
    rest = estimate.evaluate(x) - e
    return float((rest - np.polyval(np.polyfit(x, rest, 1), x)).std())


def test_data_are_made_by_their_script(made_again):
    made_again(NAME)


@pytest.mark.parametrize(("recipe", "most"), [("recipe", 12e-9), ("joint", 8e-9)])
def test_recipes_find_the_slide(folder, recipe, most):
    result = ms.Recipe.load(folder / f"{recipe}.toml").run()

    # the amplitude at the lead is 380 nm, the vibration 150 nm RMS
    assert rms(folder, result.estimate, "y") < most
    assert result.verdict == "accept"


def test_vibration_is_not_in_the_series(folder):
    """150 Hz stands at 0.533, 0.8 and 1.067 mm; m is 17 for 70 mm and 4 mm (papers.md, row 33)."""
    columns = {"z": "z_um", "feed": "feed_mm_min", "time": "t_ms", "run": "run"}
    runs = ms.read_runs(folder / "runs_y.csv", x="y_mm", **columns)
    literal = ms.separation.separate(
        runs, method="kono", start=0.0, length=70e-3, shortest=4e-3, modelling_length=70e-3
    )
    table = literal.spectrum

    assert literal.audit["m"] == 17
    assert table.loc[table["selected"], "wavelength_mm"].min() == pytest.approx(70 / 17, abs=1e-6)
    best = table.loc[table["amplitude_nm"].idxmax(), "wavelength_mm"]
    assert best == pytest.approx(10.0, abs=1e-6)


def test_plane_and_script(folder, scripted):
    names, out = scripted(NAME, "separate_plane.py")
    found = [
        tuple(float(v) for v in re.findall(r"(\d\.\d\d) (?:->|um)", r)) for r in out.splitlines()
    ]
    (before, literal), (_, kono), (_, joint) = found

    assert 1.0 < before < 1.3
    assert joint <= kono < 0.25 * before
    assert kono < 0.5 * literal  # the printed thresholds let vibration in
    for axis, estimate in zip("xy", names["e"], strict=True):
        assert rms(folder, estimate, axis) < 8e-9
    flipped = names["z"] + (names["z"] - names["left"])
    assert np.ptp(flipped) > 1.7 * np.ptp(names["z"])  # the sign


def test_script_is_short(folder):
    text = re.sub(r'^""".*?"""', "", (folder / "separate_plane.py").read_text(), flags=re.DOTALL)
    code = [v for v in text.splitlines() if v.strip() and not v.strip().startswith("#")]
    assert len(code) < MOST_LINES


@pytest.mark.slow
def test_figures_are_drawn(folder, tmp_path):
    runpy.run_path(str(folder / "figures.py"))["main"](tmp_path)

    assert len(list(tmp_path.glob("fig*.png"))) == 5
