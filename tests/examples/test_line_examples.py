"""Straightedge reversal and registration by marks: data, scores, recipes that agree."""

import numpy as np
import pytest

import metrosep as ms

HONEST = (0.6, 1.4)
"""RMS against truth over stated u."""


@pytest.mark.parametrize("name", ["straightedge", "fiducials"])
def test_data_are_made_by_their_script(name, made_again):
    made_again(name)


def test_edge_and_slide_are_told_apart(repository, scripted, scores):
    names, out = scripted("straightedge", "separate_edge.py")
    folder = repository / "examples" / "straightedge"
    result = ms.Recipe.load(folder / "recipe.toml").run()

    x, edge, slide = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1, unpack=True)
    for part, true in (("artefact", edge), ("machine", slide)):
        rms, u = scores(out, part)
        assert HONEST[0] < rms / u < HONEST[1]
        found = result.produced.parts[part] * 1e9
        assert (found - names["without_line"](true, x)).std() == pytest.approx(rms, abs=0.006)
        assert (found + names["without_line"](true, x)).std() > 20 * rms  # no flipped sign
    assert result.verdict == "accept"


def test_marks_tell_shift_and_turn(repository, scripted):
    _, out = scripted("fiducials", "register.py")
    result = ms.Recipe.load(repository / "examples" / "fiducials" / "recipe.toml").run()

    found = {c["metric"]: c["value"] for c in result.document["characteristics"]}
    values = (found["shift_x"] * 1e3, found["shift_y"] * 1e3, np.degrees(found["angle"]))
    for name, value in zip(("shift_x", "shift_y", "turn"), values, strict=True):
        line = out.split(f"{name}: ")[1].splitlines()[0]
        shown, u, true = (
            float(p.split()[k]) for p, k in zip(line.split(", "), (0, 1, 1), strict=True)
        )
        assert abs(shown - true) < 3 * u
        assert value == pytest.approx(shown, abs=6e-5)
    # 3 um in both set-ups: sqrt(2) * 3 um, root of two coordinates, six marks less 3 / 2
    left = float(out.split("left of the distances")[1].split("um")[0])
    assert 0.4 < left / (3 * 2 * np.sqrt(9 / 12)) < 1.6
    assert result.verdict == "accept"


def test_runs_of_the_slide_repeat(repository):
    result = ms.Recipe.load(
        repository / "examples" / "machine_straightness" / "repeatable.toml"
    ).run()

    known = np.isfinite(result.produced.parts["sd"])
    assert np.median(result.produced.parts["sd"][known]) == pytest.approx(80e-9, abs=20e-9)
    assert result.verdict == "accept"
