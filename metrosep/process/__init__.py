"""Process models: tool path, tool setting, servo and flexure, error budgets, before and after cutting.

Errors are actual minus nominal along z, out of the material. A name loads its module on first use.
"""

# ruff: noqa: F403

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:  # a module states its names in ``__all__``
    from metrosep.process.chip import *
    from metrosep.process.cutting.budgets import *
    from metrosep.process.cutting.edge_errors import *
    from metrosep.process.cutting.machine_terms import *
    from metrosep.process.cutting.measured_parts import *
    from metrosep.process.cutting.motion import *
    from metrosep.process.cutting.programs import *
    from metrosep.process.cutting.virtual_part import *
    from metrosep.process.drive import *
    from metrosep.process.dual_servo import *
    from metrosep.process.feedforward import *
    from metrosep.process.flexure import *
    from metrosep.process.follow_ups import *
    from metrosep.process.hysteresis import *
    from metrosep.process.interpolation import *
    from metrosep.process.jobs import *
    from metrosep.process.learning import *
    from metrosep.process.machining_times import *
    from metrosep.process.nose import *
    from metrosep.process.nose_checks import *
    from metrosep.process.path_errors import *
    from metrosep.process.path_points import *
    from metrosep.process.predictions import *
    from metrosep.process.servo import *
    from metrosep.process.setting_maps import *
    from metrosep.process.static_errors import *
    from metrosep.process.straightness_runs import *
    from metrosep.process.tips import *
    from metrosep.process.tool_settings import *

# fmt: off
_HOMES = {
    "chip": ["approximate_chip_thickness", "cusp_height", "cusp_ra", "max_chip_thickness"],
    "drive": [
        "DriveTable", "GainSweep", "drive_table", "stability_limits", "stage_displacement",
        "sweep_gains",
    ],
    "dual_servo": ["BeforeAfter", "CumulativeError", "before_after", "cumulative_error"],
    "feedforward": ["CorrectedPath", "CorrectedPoints", "corrected_path", "corrected_points"],
    "flexure": ["FlexureCalibration", "flexure_calibration"],
    "follow_ups": ["FollowUp", "FollowUpMap", "TermShare", "follow_up"],
    "hysteresis": [
        "DriveResiduals", "HysteresisFit", "PrandtlIshlinskii", "compare_drives",
    ],
    "interpolation": [
        "angle_at_length", "arc_length", "evaluate", "fitted_heights", "knot_slopes",
    ],
    "jobs": ["JobPlan", "TurningJob"],
    "learning": ["LearningStep", "learn_step", "low_pass"],
    "machining_times": ["MachiningTime", "machining_time"],
    "cutting.budgets": ["CutBudget", "PathDeviation", "cut_budget"],
    "cutting.machine_terms": ["machine_deviations"],
    "cutting.measured_parts": ["CauseFit", "EdgeFit", "fit_causes", "identify_edge"],
    "cutting.edge_errors": ["cusp_heights", "edge_error"],
    "cutting.motion": ["AxisLimits", "AxisMotion", "axis_motion"],
    "cutting.programs": ["TurningProgram"],
    "cutting.virtual_part": ["VirtualPart", "virtual_cut"],
    "nose": ["EdgeProfile", "RoundNose", "rake_error"],
    "nose_checks": ["NoseCheck", "clearance_check", "gouge_check", "window_check"],
    "path_errors": ["PathErrorMap", "estimated_points", "sine_path_error", "sine_path_step"],
    "path_points": [
        "CountCurve", "PathPoints", "PointPlan", "SpiralPath", "errors_by_count",
        "points_for_tolerance",
    ],
    "predictions": [
        "BudgetTotal", "Contribution", "ErrorBudget", "Prediction",
    ],
    "servo": ["Gains", "ServoModel", "error_ratio", "retuned_error"],
    "setting_maps": ["SettingError", "SettingTolerance", "setting_tolerance"],
    "static_errors": ["StaticComparison", "compare_static"],
    "straightness_runs": [
        "RunPolynomial", "StraightnessLines", "run_polynomial", "straightness_lines",
    ],
    "tips": ["TipPath", "tip_path"],
    "tool_settings": ["SettingFit", "ToolSetting", "identify_setting"],
}
# fmt: on

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return list(__all__)
