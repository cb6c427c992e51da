"""Every recipe of the examples runs as it stands, is judged, and writes what it says."""

import re
import tomllib

import numpy as np
import pytest

import metrosep as ms
from metrosep.recipe.result import load_document

NAMES = [
    "reversal/recipe.toml",
    "multiprobe/recipe.toml",
    "multistep/recipe.toml",
    "three_point/recipe.toml",
    "mirror_slopes/recipe.toml",
    "positioning/recipe.toml",
    "positioning/diagonals.toml",
    "drift/recipe.toml",
    "drift/sequence.toml",
    "drift/speeds.toml",
    "spindle/recipe.toml",
    "xy_plane/recipe.toml",
    "feedrate_plan/recipe.toml",
    "flats/recipe.toml",
    "rotation_test/recipe.toml",
    "periodic_error/recipe.toml",
    "laser_axis/recipe.toml",
    "stitching/recipe.toml",
    "face_reversal/recipe.toml",
    "circle_closure/recipe.toml",
    "orthogonal_mixed/recipe.toml",
    "spheres/recipe.toml",
    "spheres/positions.toml",
    "shift_rotation/recipe.toml",
    "machine_straightness/recipe.toml",
    "coupled_grid/recipe.toml",
    "grid_plate/recipe.toml",
    "speed_sweep/recipe.toml",
    "multiprobe/check.toml",
    "multiprobe/angles.toml",
    "straightedge/recipe.toml",
    "fiducials/recipe.toml",
    "machine_straightness/repeatable.toml",
    "slow_tool_servo/recipe.toml",
    "slow_tool_servo/identify.toml",
    "slow_tool_servo/follow_up.toml",
    "slow_tool_servo/pilot.toml",
    "dual_servo/recipe.toml",
    "fts_lathe/recipe.toml",
    "fts_lathe/wavefront.toml",
    "fts_lathe/identify.toml",
    "motion_error_fourier/recipe.toml",
    "motion_error_fourier/joint.toml",
    "measured_part/recipe.toml",
    "five_axis_calibration/recipe.toml",
    "five_axis_calibration/circle.toml",
    "thermal/recipe.toml",
    "roundness_traces/recipe.toml",
    "cut_path/torus.toml",
    "cut_path/grid.toml",
    "cut_path/toric.toml",
    "cut_path/asphere.toml",
    "cut_path/again.toml",
    "cut_budget/budget.toml",
    "cut_budget/motion.toml",
    "stage_hysteresis/stage.toml",
    "mill_instruments/indicator.toml",
    "mill_instruments/level.toml",
    "mill_instruments/laser_linear.toml",
    "mill_instruments/laser_angular.toml",
    "mill_instruments/ballbar.toml",
    "mill_instruments/tracker.toml",
]


DRAWN = True
"""The pages are looked at."""


NO_RECIPE = {"fts_lathe/machine.toml", "volumetric_map/machine.toml", "carriers/recipe.toml"}
"""Chains of axes; the carriers have tests of their own (test_carrier_examples.py)."""

OWN_LIMITS = {"cut_budget/motion.toml"}
"""Judged by limits that the step itself states."""

NO_CHART = {"fiducials/recipe.toml", "cut_budget/motion.toml"}


LONG = {
    "fts_lathe/wavefront.toml",
    "slow_tool_servo/recipe.toml",
    "dual_servo/recipe.toml",
    "cut_path/torus.toml",
    "cut_path/asphere.toml",
    "cut_path/again.toml",
    "motion_error_fourier/joint.toml",
    "cut_budget/budget.toml",
    "roundness_traces/recipe.toml",
}
"""Run at other doors as well (tests/examples, test_cutting_steps, app/test_machine_answers)."""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in LONG else []) for n in NAMES]
)
def test_recipe_runs_as_it_stands(name, repository, tmp_path):
    recipe = repository / "examples" / name
    result = ms.Recipe.load(recipe).run(out=tmp_path / "out")

    checks = tomllib.loads(recipe.read_text("utf-8")).get("check", [])
    assert result.verdict == ("accept" if checks or name in OWN_LIMITS else None)
    smallest = 5_000 if name in NO_CHART else 20_000
    assert (tmp_path / "out" / "report.html").stat().st_size > smallest
    assert (tmp_path / "out" / "result.json").stat().st_size < 1_000_000
    document = load_document(tmp_path / "out")
    assert document["characteristics"]


WITHOUT = {"straightness", "carriers", "tool_path", "volumetric_map"}
"""They have tests of their own."""


def test_every_example_has_a_recipe(repository):
    folders = {f.name for f in (repository / "examples").iterdir() if f.is_dir()}
    assert folders - WITHOUT <= {name.split("/")[0] for name in NAMES}


def test_every_recipe_of_the_examples_is_tested(repository):
    found = {
        f"{f.parent.name}/{f.name}"
        for f in (repository / "examples").glob("*/*.toml")
        if f.parent.name != "straightness"
    }
    assert found - NO_RECIPE == set(NAMES)


TRUTHS = {
    "flats/recipe.toml": {"A": 2, "B": 3, "C": 4},
    "multiprobe/recipe.toml": {"artefact": 1, "x": 2, "y": 3},
    "reversal/recipe.toml": {"artefact": 1, "spindle": 2},
    "multistep/recipe.toml": {"artefact": 1, "spindle": 2},
}
"""Column of truth.csv, in nm, of each part."""


@pytest.mark.parametrize("name", TRUTHS)
def test_recipe_finds_what_was_planted(name, repository):
    produced = ms.Recipe.load(repository / "examples" / name).run().produced
    table = repository / "examples" / name.split("/")[0] / "truth.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    for part, column in TRUTHS[name].items():
        found = produced.parts[part].ravel()
        rest = found - rows[:, column] * 1e-9
        known = np.isfinite(rest)
        place = rows[known, :2] if name.startswith("flats") else _once(rows[known, 0])
        basis = np.column_stack([np.ones(known.sum()), place])  # what alignment decides
        rest = rest[known] - basis @ np.linalg.lstsq(basis, rest[known], rcond=None)[0]
        u = produced.u[part].ravel()[known]
        assert rest.std() < 2.0 * np.sqrt(np.mean(u**2)), part


def _once(degrees):
    angle = np.radians(degrees)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def test_every_example_is_listed_where_one_chooses(repository):
    page = (repository / "docs" / "how-to" / "choose-a-separation.md").read_text("utf-8")
    cells = [line.rstrip("| ").rsplit("|", 1)[-1] for line in page.splitlines() if "`" in line]
    listed = {name.split("/")[0] for cell in cells for name in re.findall(r"`([\w/.]+)`", cell)}
    folders = {f.name for f in (repository / "examples").iterdir() if f.is_dir()}
    assert folders <= listed
