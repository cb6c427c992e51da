"""Recipes: TOML lists of steps, and the result document they produce."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe as Recipe
    from metrosep.recipe.result import Result as Result


METHODS = {
    "plan_from_density": "plan:PlanFromDensity",
    "rank": "ops_machine:Ranking",
    "identify": "ops_machine:TermsIdentified",
    "wavefront": "ops_machine:WavefrontOfMap",
    "tool_setting": "ops_process:SettingFound",
    "follow_up": "ops_process:FollowUpOfLog",
    "flexure_calibration": "ops_process:FlexureCalibrated",
    "predict": "ops_process:JobPredicted",
    "dual_servo": "dual_servo:DualServo",
    "gauge_study": "ops_quality:GaugeStudied",
    "part_series": "ops_quality:SeriesOfParts",
}
"""Methods of the upper layers that have a name: module and class of each."""

__getattr__, __dir__ = lazy_package(__name__)
