"""Plans after a separation, and planes from two results: same numbers as the calls, refusals."""

import json
from pathlib import Path

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import MetrosepError, RecipeError
from metrosep.recipe.methods.plan import plan_after
from metrosep.recipe.result import load_document, stored_estimate
from metrosep.separation import plan_feedrates, plane_map

PLAN = """[[step]]
op = "plan_feedrates"
v_min = "4800 mm/min"
v_max = "9600 mm/min"
n_runs = 6
wavelengths = ["10 mm", "5 mm"]
"""


FOLDER = Path(__file__).parents[2] / "examples" / "straightness"
RUNS = FOLDER / "runs.csv"


@pytest.fixture(scope="module")
def example():
    text = (FOLDER / "recipe.toml").read_text("utf-8")
    return text[: text.index("[[step]]")] + '[[step]]\nop = "separate"\nlength = "45 mm"\n'


@pytest.fixture(scope="module")
def separated(tmp_path_factory, example):
    out = tmp_path_factory.mktemp("plan") / "out"
    text = example + PLAN + '[[output]]\nkind = "report"\n'
    return ms.Recipe.parse(text).run(RUNS, out=out), out


def test_plan_uses_the_disturbance_and_the_travel_of_the_runs(separated):
    result, out = separated
    estimate = result.estimate
    low, high = estimate.fit_range
    psd = estimate.residual_psd
    called = plan_feedrates(
        (psd["frequency_hz"].to_numpy(), psd["psd_nm2_per_hz"].to_numpy() * 1e-18),
        np.array([10e-3, 5e-3]),
        0.08,
        0.16,
        6,
        length=high - low,
    )
    plan = load_document(out)["plan"]
    np.testing.assert_allclose(plan["feeds_mm_per_min"], called.feeds * 6e4, rtol=1e-5)
    np.testing.assert_allclose(plan["sd"]["sd_nm"], called.columns["sd_nm"], rtol=1e-5)
    assert sum(n for _, n in plan["runs"]) == 6
    assert set(called.messages) <= set(result.document["messages"])
    page = (out / "report.html").read_text("utf-8")
    assert "Next runs, as planned" in page
    assert "Plan of feedrates" in page


def test_a_range_of_wavelengths(separated):
    _, out = separated
    text = PLAN.replace(
        '["10 mm", "5 mm"]', '{ shortest = "5 mm", longest = "20 mm" }\nlength = "45 mm"'
    )
    head = 'metrosep = 1\n[input]\nx = "x"\nz = "z"\n[[step]]\nop = "separate"\n'
    options = ms.Recipe.parse(head + text).steps[1]
    plan = plan_after(stored_estimate(load_document(out)), options)
    assert plan.wavelengths.size > 10
    assert plan.wavelengths.min() == pytest.approx(5e-3, abs=1e-9)
    assert plan.wavelengths.max() == pytest.approx(20e-3, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (PLAN + '[[step]]\nop = "separate"\n', "keep one of it, after that step"),
        ('[[step]]\nop = "separate"\n' + PLAN + PLAN, "keep one of it, after that step"),
        (
            '[[step]]\nop = "separate"\n' + PLAN.replace('"4800 mm/min"', "4800"),
            r":9: v_min.*unit",
        ),
        (
            '[[step]]\nop = "separate"\n' + PLAN.replace('["10 mm", "5 mm"]', "[]"),
            "list is needed",
        ),
        ('[[step]]\nop = "donaldson"\n' + PLAN, "exactly one"),
    ],
)
def test_plans_at_the_wrong_place_are_refused_with_their_line(text, match):
    with pytest.raises(RecipeError, match=match):
        ms.Recipe.parse('metrosep = 1\n[input]\nx = "x"\nz = "z"\n' + text)


def test_a_separation_without_a_density_cannot_plan(example):
    text = example + 'method = "mean"\n' + PLAN
    with pytest.raises(MetrosepError, match="no density of the disturbance"):
        ms.Recipe.parse(text).run(RUNS)


@pytest.mark.slow
def test_options_of_the_joint_separation_reach_it(example):
    text = example + 'drift = 1\nlines = ["50 Hz"]\nrobust = true\n'
    estimate = ms.Recipe.parse(text).run(RUNS).estimate
    plain = ms.Recipe.parse(example).run(RUNS).estimate
    step = estimate.history[-1].parameters
    assert (step["drift"], list(step["lines"]), step["robust"]) == (1, [50.0], True)
    assert "drift" not in plain.history[-1].parameters
    assert estimate.peak_to_valley().value != plain.peak_to_valley().value
    with pytest.raises(RecipeError, match="not one of 0, 1, 2"):
        ms.Recipe.parse(example + "drift = 3\n")
    with pytest.raises(RecipeError, match="frequency"):
        ms.Recipe.parse(example + 'lines = ["50 mm"]\n')


def test_plan_from_a_density(tmp_path):
    f = np.linspace(0.5, 400, 800)
    s = 2.0 + 6e3 / (1 + ((f - 12.0) / 0.25) ** 2)
    file = tmp_path / "d.csv"
    rows = [f"{a:.6f},{b:.6f}" for a, b in zip(f, s, strict=True)]
    file.write_text("\n".join(["frequency_hz,psd_nm2_per_hz", *rows]) + "\n", "ascii")
    text = (
        'metrosep = 1\n[input]\nfrequency = "frequency_hz"\npsd = "psd_nm2_per_hz"\n'
        + PLAN.replace("plan_feedrates", "plan_from_density")
        + 'length = "60 mm"\n'
    )
    result = ms.Recipe.parse(text).run(file)
    called = plan_feedrates((f, s * 1e-18), np.array([10e-3, 5e-3]), 0.08, 0.16, 6, length=60e-3)
    np.testing.assert_allclose(result.produced.feeds, called.feeds, rtol=1e-6)
    found = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    assert found["worst_sd"] == pytest.approx(
        called.columns["sd_nm"].max() * 1e-9, rel=1e-4, abs=0.0
    )


PLANE = """metrosep = 1
[input]
[[step]]
op = "plane_map"
dx = "1 mm"
dy = "2 mm"
alpha = "4 urad"
u_alpha = "0.2 urad"
[[output]]
kind = "parts"
"""


def test_plane_of_two_results(separated, tmp_path):
    result, out = separated
    second = tmp_path / "y.json"
    document = load_document(out)
    document["title"] = "along y"
    second.write_text(json.dumps(document), "utf-8")
    made = ms.Recipe.parse(PLANE).run([out / "result.json", second], out=tmp_path / "o")

    estimate = result.estimate
    called = plane_map(estimate, estimate, dx=1e-3, dy=2e-3, alpha=4e-6)
    np.testing.assert_allclose(made.produced.surface.z, called.surface.z, rtol=0.0, atol=1e-15)
    found = {c["metric"]: c for c in made.document["characteristics"]}
    assert found["alpha"]["u"] == pytest.approx(0.2e-6, abs=1e-12)
    assert found["plane.pv"]["value"] == pytest.approx(float(np.ptp(called.surface.z)), abs=1e-14)
    assert [f.name for f in made.files][:2] == ["parts-error.h5", "parts-u.h5"]
    assert made.document["inputs"][0]["format"] == "metrosep-result"
    with pytest.raises(MetrosepError, match="two results are needed"):
        ms.Recipe.parse(PLANE).run([second])
    bad = tmp_path / "bad.json"
    bad.write_text("{}", "utf-8")
    with pytest.raises(MetrosepError, match="not a result of metrosep"):
        ms.Recipe.parse(PLANE).run([bad, second])
