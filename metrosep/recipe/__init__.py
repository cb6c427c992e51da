"""Recipes: TOML lists of steps, and the result document they produce."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.recipe.recipe import Recipe as Recipe
    from metrosep.recipe.result import Result as Result


METHODS = {
    "plan_from_density": "methods.plan:PlanFromDensity",
    "rank": "methods.ops_machine:Ranking",
    "identify": "methods.ops_machine:TermsIdentified",
    "wavefront": "methods.ops_machine:WavefrontOfMap",
    "calibrate": "methods.ops_readings:MachineCalibrated",
    "circle": "methods.ops_readings:CircleTested",
    "thermal": "methods.ops_readings:ThermalLearnt",
    "tool_setting": "methods.ops_process:SettingFound",
    "follow_up": "methods.ops_process:FollowUpOfLog",
    "flexure_calibration": "methods.ops_process:FlexureCalibrated",
    "predict": "methods.ops_process:JobPredicted",
    "cut_budget": "methods.cutting:CutBudgeted",
    "axis_motion": "methods.cutting:AxesMoved",
    "hysteresis": "methods.cutting:HysteresisIdentified",
    "dual_servo": "methods.dual_servo:DualServo",
    "gauge_study": "methods.ops_quality:GaugeStudied",
    "part_series": "methods.ops_quality:SeriesOfParts",
    "roundness": "methods.ops_geometry:Roundness",
    "cylindricity": "methods.ops_geometry:Cylindricity",
    "run_out": "methods.ops_geometry:RunOut",
    "coaxiality": "methods.ops_geometry:Coaxiality",
    "parallelism": "methods.ops_geometry:Parallelism",
    "perpendicularity": "methods.ops_geometry:Perpendicularity",
}
"""Methods of the upper layers that have a name: module and class of each."""

__getattr__, __dir__ = lazy_package(__name__)
