"""Process models: tool path, tool setting, servo and flexure, error budgets, before and after cutting.

Errors are actual minus nominal along z, out of the material. A name loads its module on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.process._motion import (
        FollowUp as FollowUp,
        FollowUpMap as FollowUpMap,
        TermShare as TermShare,
    )
    from metrosep.process.chip import (
        approximate_chip_thickness as approximate_chip_thickness,
        cusp_height as cusp_height,
        cusp_ra as cusp_ra,
        max_chip_thickness as max_chip_thickness,
    )
    from metrosep.process.cutting.budgets import (
        CutBudget as CutBudget,
        PathDeviation as PathDeviation,
        cut_budget as cut_budget,
    )
    from metrosep.process.cutting.edge_errors import (
        cusp_heights as cusp_heights,
        edge_error as edge_error,
    )
    from metrosep.process.cutting.machine_terms import machine_deviations as machine_deviations
    from metrosep.process.cutting.measured_parts import (
        CauseFit as CauseFit,
        EdgeFit as EdgeFit,
        fit_causes as fit_causes,
        identify_edge as identify_edge,
    )
    from metrosep.process.cutting.motion import (
        AxisLimits as AxisLimits,
        AxisMotion as AxisMotion,
        axis_motion as axis_motion,
    )
    from metrosep.process.cutting.programs import TurningProgram as TurningProgram
    from metrosep.process.cutting.virtual_part import (
        VirtualPart as VirtualPart,
        virtual_cut as virtual_cut,
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
    from metrosep.process.follow_ups import follow_up as follow_up
    from metrosep.process.hysteresis import (
        DriveResiduals as DriveResiduals,
        HysteresisFit as HysteresisFit,
        PrandtlIshlinskii as PrandtlIshlinskii,
        compare_drives as compare_drives,
    )
    from metrosep.process.interpolation import (
        angle_at_length as angle_at_length,
        arc_length as arc_length,
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
    from metrosep.process.nose import (
        EdgeProfile as EdgeProfile,
        RoundNose as RoundNose,
        rake_error as rake_error,
    )
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
        ErrorBudget as ErrorBudget,
        Prediction as Prediction,
    )
    from metrosep.process.servo import (
        Gains as Gains,
        ServoModel as ServoModel,
        error_ratio as error_ratio,
        retuned_error as retuned_error,
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
    from metrosep.process.tool_settings import (
        SettingFit as SettingFit,
        ToolSetting as ToolSetting,
        identify_setting as identify_setting,
    )

__getattr__, __dir__ = lazy_package(__name__)
