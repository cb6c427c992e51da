"""Process models: tool path, tool setting, servo and flexure, error budgets, before and after cutting.

Errors are actual minus nominal along z, out of the material. A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.process.arc_lengths import (
        angle_at_length as angle_at_length,
        arc_length as arc_length,
    )
    from metrosep.process.chip import (
        approximate_chip_thickness as approximate_chip_thickness,
        cusp_height as cusp_height,
        cusp_ra as cusp_ra,
        max_chip_thickness as max_chip_thickness,
    )
    from metrosep.process.drive import (
        DriveTable as DriveTable,
        GainSweep as GainSweep,
        drive_table as drive_table,
        stability_limits as stability_limits,
        stage_displacement as stage_displacement,
        sweep_gains as sweep_gains,
    )
    from metrosep.process.dual_servo import (
        BeforeAfter as BeforeAfter,
        CumulativeError as CumulativeError,
        before_after as before_after,
        cumulative_error as cumulative_error,
    )
    from metrosep.process.feedforward import (
        CorrectedPath as CorrectedPath,
        CorrectedPoints as CorrectedPoints,
        corrected_path as corrected_path,
        corrected_points as corrected_points,
    )
    from metrosep.process.flexure import (
        FlexureCalibration as FlexureCalibration,
        flexure_calibration as flexure_calibration,
    )
    from metrosep.process.follow_ups import (
        FollowUp as FollowUp,
        FollowUpMap as FollowUpMap,
        TermShare as TermShare,
        follow_up as follow_up,
    )
    from metrosep.process.interpolation import (
        evaluate as evaluate,
        fitted_heights as fitted_heights,
        knot_slopes as knot_slopes,
    )
    from metrosep.process.jobs import JobPlan as JobPlan, TurningJob as TurningJob
    from metrosep.process.learning import (
        LearningStep as LearningStep,
        learn_step as learn_step,
        low_pass as low_pass,
    )
    from metrosep.process.machining_times import (
        MachiningTime as MachiningTime,
        machining_time as machining_time,
    )
    from metrosep.process.nose import RoundNose as RoundNose, rake_error as rake_error
    from metrosep.process.nose_checks import (
        NoseCheck as NoseCheck,
        clearance_check as clearance_check,
        gouge_check as gouge_check,
        window_check as window_check,
    )
    from metrosep.process.path_errors import (
        PathErrorMap as PathErrorMap,
        estimated_points as estimated_points,
        sine_path_error as sine_path_error,
        sine_path_step as sine_path_step,
    )
    from metrosep.process.path_points import (
        CountCurve as CountCurve,
        PathPoints as PathPoints,
        PointPlan as PointPlan,
        SpiralPath as SpiralPath,
        errors_by_count as errors_by_count,
        points_for_tolerance as points_for_tolerance,
    )
    from metrosep.process.predictions import (
        BudgetTotal as BudgetTotal,
        Contribution as Contribution,
        CorrectedProgram as CorrectedProgram,
        ErrorBudget as ErrorBudget,
        Prediction as Prediction,
    )
    from metrosep.process.servo import (
        Gains as Gains,
        ServoModel as ServoModel,
        error_ratio as error_ratio,
        retuned_error as retuned_error,
    )
    from metrosep.process.setting_fit import (
        SettingFit as SettingFit,
        identify_setting as identify_setting,
    )
    from metrosep.process.setting_maps import (
        SettingError as SettingError,
        SettingTolerance as SettingTolerance,
        setting_tolerance as setting_tolerance,
    )
    from metrosep.process.static_errors import (
        StaticComparison as StaticComparison,
        compare_static as compare_static,
    )
    from metrosep.process.straightness_runs import (
        RunPolynomial as RunPolynomial,
        StraightnessLines as StraightnessLines,
        run_polynomial as run_polynomial,
        straightness_lines as straightness_lines,
    )
    from metrosep.process.tips import TipPath as TipPath, tip_path as tip_path
    from metrosep.process.tool_settings import ToolSetting as ToolSetting

# fmt: off
_HOMES = {
    "arc_lengths": ["angle_at_length", "arc_length"],
    "chip": ["approximate_chip_thickness", "cusp_height", "cusp_ra", "max_chip_thickness"],
    "drive": [
        "DriveTable", "GainSweep", "drive_table", "stability_limits", "stage_displacement",
        "sweep_gains",
    ],
    "dual_servo": ["BeforeAfter", "CumulativeError", "before_after", "cumulative_error"],
    "feedforward": ["CorrectedPath", "CorrectedPoints", "corrected_path", "corrected_points"],
    "flexure": ["FlexureCalibration", "flexure_calibration"],
    "follow_ups": ["FollowUp", "FollowUpMap", "TermShare", "follow_up"],
    "interpolation": ["evaluate", "fitted_heights", "knot_slopes"],
    "jobs": ["JobPlan", "TurningJob"],
    "learning": ["LearningStep", "learn_step", "low_pass"],
    "machining_times": ["MachiningTime", "machining_time"],
    "nose": ["RoundNose", "rake_error"],
    "nose_checks": ["NoseCheck", "clearance_check", "gouge_check", "window_check"],
    "path_errors": ["PathErrorMap", "estimated_points", "sine_path_error", "sine_path_step"],
    "path_points": [
        "CountCurve", "PathPoints", "PointPlan", "SpiralPath", "errors_by_count",
        "points_for_tolerance",
    ],
    "predictions": [
        "BudgetTotal", "Contribution", "CorrectedProgram", "ErrorBudget", "Prediction",
    ],
    "servo": ["Gains", "ServoModel", "error_ratio", "retuned_error"],
    "setting_fit": ["SettingFit", "identify_setting"],
    "setting_maps": ["SettingError", "SettingTolerance", "setting_tolerance"],
    "static_errors": ["StaticComparison", "compare_static"],
    "straightness_runs": [
        "RunPolynomial", "StraightnessLines", "run_polynomial", "straightness_lines",
    ],
    "tips": ["TipPath", "tip_path"],
    "tool_settings": ["ToolSetting"],
}
# fmt: on

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return list(__all__)
