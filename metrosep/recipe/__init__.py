"""Recipes: TOML lists of steps, and the result document they produce."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe as Recipe
    from metrosep.recipe.result import Result as Result


METHODS = {
    "straightedge_reversal": "methods:OLD/straightedge_reversal",
    "two_point": "methods:OLD/two_point",
    "three_point": "methods:OLD/three_point",
    "zero_calibration": "methods:OLD/zero_calibration",
    "multi_probe_straightness": "methods:OLD/multi_probe_straightness",
    "integrate_slopes": "methods:OLD/integrate_slopes",
    "straightness_iso230_1": "methods:OLD/straightness_iso230_1",
    "abba": "methods:OLD/abba",
    "joint_drift": "methods:OLD/joint_drift",
    "iso230_3_drift": "methods:OLD/iso230_3_drift",
    "speed_dependence": "methods:OLD/speed_dependence",
    "drift_against_temperature": "methods:OLD/drift_against_temperature",
    "repeatable": "methods:OLD/repeatable",
    "periodic_error": "methods:OLD/periodic_error",
    "iso230_2": "methods:OLD/iso230_2",
    "iso230_6_diagonals": "methods:OLD/iso230_6_diagonals",
    "dual_servo": "methods:OLD/dual_servo",
    "evidence_table": "methods:OLD/evidence_table",
    "register_points": "methods:OLD/register_points",
    "fit_plane_model": "methods:OLD/fit_plane_model",
    "coupled_grid": "methods:OLD/coupled_grid",
    "grid_calibration": "methods:OLD/grid_calibration",
    "three_flat": "methods:OLD/three_flat",
    "rotation_average": "methods:OLD/rotation_average",
    "shift_rotation": "methods:OLD/shift_rotation",
    "repeatable_maps": "methods:OLD/repeatable_maps",
    "register_maps": "methods:OLD/register_maps",
    "ball_average": "methods:OLD/ball_average",
    "three_positions": "methods:OLD/three_positions",
    "stitch": "methods:OLD/stitch",
    "gauge_study": "methods:OLD/gauge_study",
    "part_series": "methods:OLD/part_series",
    "plan_from_density": "methods:OLD/plan_from_density",
    "rank": "methods:OLD/rank",
    "identify": "methods:OLD/identify",
    "wavefront": "methods:OLD/wavefront",
    "tool_setting": "methods:OLD/tool_setting",
    "follow_up": "methods:OLD/follow_up",
    "flexure_calibration": "methods:OLD/flexure_calibration",
    "predict": "methods:OLD/predict",
}

__getattr__, __dir__ = lazy_package(__name__)
