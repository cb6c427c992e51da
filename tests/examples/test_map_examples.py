"""Spheres, shift-rotation and stitching: data, scores, and recipes that agree with the scripts."""

import numpy as np
import pytest

import metrosep as ms

HONEST = (0.6, 1.4)
"""RMS against truth over stated u."""


def recipe(repository, name):
    return ms.Recipe.load(repository / "examples" / name).run()


def column(repository, name, k, shape):
    table = np.loadtxt(repository / "examples" / name, delimiter=",", skiprows=1)
    return table[:, k].reshape(shape) * 1e-9


@pytest.mark.parametrize("name", ["spheres", "shift_rotation", "stitching"])
def test_data_are_made_by_their_script(name, made_again):
    made_again(name)


def test_spheres_are_separated_both_ways(repository, scripted, scores):
    names, out = scripted("spheres", "separate_spheres.py")
    ball, positions = out.split("three positions")
    shown = {
        ("recipe", "instrument"): (scores(ball, "instrument"), "truth_ball.csv", 2),
        ("positions", "part"): (scores(positions, "part"), "truth_positions.csv", 2),
        ("positions", "instrument"): (scores(positions, "instrument"), "truth_positions.csv", 3),
    }
    for (file, part), ((rms, u), truth, k) in shown.items():
        assert HONEST[0] < rms / u < HONEST[1]
        result = recipe(repository, f"spheres/{file}.toml")
        found = result.produced.parts[part]
        true = names["without_alignment"](column(repository, f"spheres/{truth}", k, found.shape))
        rest = found - true
        assert np.sqrt(np.nanmean(rest**2)) * 1e9 == pytest.approx(rms, abs=0.006)
        mirrored = found - true[:, ::-1]
        assert np.sqrt(np.nanmean(mirrored**2)) * 1e9 > 1.5 * rms
        assert result.verdict == "accept"


def test_shifts_bring_back_what_turns_hide(repository, scripted, scores):
    names, out = scripted("shift_rotation", "separate_mirror.py")
    result = recipe(repository, "shift_rotation/recipe.toml")
    for k, part in enumerate(("part", "instrument"), start=2):
        rms, u = scores(out, part)
        assert rms < 1.4 * u  # u holds power and piston of the common area, the score does not
        found = result.produced.parts[part]
        true = column(repository, "shift_rotation/truth.csv", k, found.shape)
        rest = names["separable"](found - true)
        assert np.sqrt(np.nanmean(rest**2)) * 1e9 == pytest.approx(rms, abs=6e-4)
    assert 0.27 < float(out.split("noise of a pixel")[1].split("nm")[0]) < 0.33
    assert "term defocus not observable" in out
    # a clover of four looks alike at 0, 90 and 180 degrees: only the shifts tell whose it is
    order, turns = (result.produced.coordinates[f"zernike_{c}"] for c in "nm")
    clover = np.flatnonzero((order == 4) & (turns == 4))[0]
    scale = (result.produced.audit["radius_mm"] / 14.0) ** 4  # planted over a radius of 14 mm
    for part, planted in (("part", 7e-9), ("instrument", 4e-9)):
        found = result.produced.parts[f"zernike_{part}"][clover]
        u = result.produced.u[f"zernike_{part}"][clover]
        assert abs(found - scale * planted) < 4 * u


def test_stitching_recipe_gives_what_the_script_gives(repository, scripted):
    names, out = scripted("stitching", "stitch_flat.py")
    result = recipe(repository, "stitching/recipe.toml")
    for name in ("surface", "reference"):
        shown = float(out.split(f"{name:<10}wrong by")[1].split("nm")[0])
        assert names["score"](result.produced.parts[name], names[name]) == pytest.approx(
            shown, abs=6e-4
        )
    assert result.verdict == "accept"
