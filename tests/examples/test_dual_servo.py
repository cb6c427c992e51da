"""The example of a dual servo: data, truth, the paper's numbers, recipe and script that agree."""

import re
import runpy

import numpy as np
import pytest

import metrosep as ms

NAME = "dual_servo"
MOST_LINES = 15
"""Issue 6: a script under 15 lines, comments and blank lines left out."""


@pytest.fixture
def folder(repository):
    return repository / "examples" / NAME


@pytest.fixture(scope="module")
def result(request):
    folder = request.config.rootpath / "examples" / NAME
    return ms.Recipe.load(folder / "recipe.toml").run()


@pytest.fixture
def found(result):
    return {c["metric"]: (c["value"], c["u"]) for c in result.document["characteristics"]}


def test_data_are_made_by_their_script(made_again):
    made_again(NAME)


def test_polynomial_is_the_true_one_within_its_uncertainty(result, found):
    true = (-0.3389e-6, -0.48246e-3, 0.00605)  # the error is the negative of the compensation
    for k, value in enumerate(true):
        coefficient, u = found[f"c{k}"]
        assert abs(coefficient - value) < 3.0 * u
    assert found["c0"][1] == pytest.approx(50e-9 / np.sqrt(5), abs=12e-9)  # drift, not noise
    assert "not noise" in " ".join(result.document["messages"])


def test_stage_straightness_and_voltages(result, found):
    """papers.md section 2: 1.66 um/V; 9.6185 um, of it 2.420 um straightness; 0.2042 to 5.998 V."""
    assert found["stage.sensitivity"][0] == pytest.approx(1.66e-6, abs=2e-9)
    assert found["stage.hysteresis"][0] == pytest.approx(0.20 / 16.6, abs=4e-4)
    assert found["total"][0] == pytest.approx(9.6185e-6, abs=0.15e-6)  # the ripple adds
    assert found["straightness.least-squares"][0] == pytest.approx(2.42e-6, abs=0.1e-6)
    assert found["slope.least-squares"][0] == pytest.approx(-0.24046e-3, abs=1.5e-6)
    assert found["voltage_min"][0] == pytest.approx(0.2042, abs=0.02)
    assert found["voltage_max"][0] == pytest.approx(5.998, abs=0.06)
    assert found["violations"][0] == 0
    assert result.verdict == "accept"
    # the stage moves against the error
    table, line = result.produced.table, result.produced.polynomial
    assert np.abs(table.displacement + line.evaluate(table.x)).max() < 1e-12


def test_pairs_are_those_of_the_paper(found):
    assert found["at_rest.ratio_db"][0] == pytest.approx(
        20.0, abs=3.0 * found["at_rest.ratio_db"][1]
    )
    for name, before, after in (("Ra", 48e-9, 4e-9), ("Pt", 1.285e-6, 0.3e-6)):
        assert found[f"before.{name}"][0] == pytest.approx(before, abs=0.1 * before)
        assert found[f"after.{name}"][0] == pytest.approx(after, abs=0.15 * after)


def test_polynomial_for_the_controller_has_all_digits(result):
    text = result.document["separation"]["polynomial_text"]
    numbers = [float(v) for v in re.findall(r"[-+]?\d\.\d+", text.split("=")[1])]

    assert text.startswith("compensation_um")
    for k, (value, c) in enumerate(
        zip(numbers, result.produced.polynomial.coefficients, strict=True)
    ):
        assert value == pytest.approx(-c * 1e6 * 1e-3**k, abs=1e-9)


def test_files_beside_the_runs_are_recorded(result):
    keys = " ".join(result.document["separation"]["audit"])
    for name in ("stage.csv", "at_rest.csv", "part_before.csv", "part_after.csv"):
        assert name in keys


def test_script_and_recipe_agree(folder, scripted, result, found):
    text = re.sub(r'^""".*?"""', "", (folder / "compensate.py").read_text(), flags=re.DOTALL)
    names, out = scripted(NAME, "compensate.py")

    assert sum(1 for v in text.splitlines() if v.strip()) < MOST_LINES
    assert (
        np.abs(names["line"].coefficients - result.produced.polynomial.coefficients).max() < 1e-15
    )
    assert names["stage"].sensitivity == pytest.approx(found["stage.sensitivity"][0], abs=1e-15)
    assert "paper" in out


@pytest.mark.slow
def test_figures_are_drawn(folder, tmp_path):
    runpy.run_path(str(folder / "figures.py"))["main"](tmp_path)

    assert len(list(tmp_path.glob("fig*.png"))) == 6
