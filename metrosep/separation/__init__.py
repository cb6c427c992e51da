"""Error separation: machine from artefact from vibration from drift from noise.

`separate` takes repeated runs of an axis apart; every other set-up has a function of its own, most of
which return a `Separation` with its null space. A name loads its module on first use.

error = actual - nominal. What a method cannot see is listed in its result and set NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.separation.circles.circle_closure import (
        CircleClosure as CircleClosure,
        closure as closure,
    )
    from metrosep.separation.circles.mixed import (
        OrthogonalMixed as OrthogonalMixed,
        mixed_transfer as mixed_transfer,
        orthogonal_mixed as orthogonal_mixed,
    )
    from metrosep.separation.circles.probe_angles import (
        ProbeAngles as ProbeAngles,
        optimise_probe_angles as optimise_probe_angles,
        probe_gain as probe_gain,
    )
    from metrosep.separation.circles.probe_check import (
        ProbeCheck as ProbeCheck,
        Suspect as Suspect,
        check_probes as check_probes,
    )
    from metrosep.separation.circles.probes import (
        MultiprobeRoundness as MultiprobeRoundness,
        multiprobe as multiprobe,
    )
    from metrosep.separation.circles.resampling import (
        AngleSynchronous as AngleSynchronous,
        cubic_interpolation_error as cubic_interpolation_error,
        index_pulses as index_pulses,
        resample_by_encoder as resample_by_encoder,
        resample_by_index as resample_by_index,
    )
    from metrosep.separation.circles.roundness_reversal import (
        DonaldsonReversal as DonaldsonReversal,
        FaceReversal as FaceReversal,
        combine_harmonics as combine_harmonics,
        donaldson as donaldson,
        face_reversal as face_reversal,
    )
    from metrosep.separation.circles.speed_sweep import (
        SpeedFit as SpeedFit,
        SpeedGrowth as SpeedGrowth,
        SpeedSweep as SpeedSweep,
        fit_speed_sweep as fit_speed_sweep,
        fit_values as fit_values,
    )
    from metrosep.separation.circles.spindle import (
        SpindleSplit as SpindleSplit,
        iso230_7 as iso230_7,
    )
    from metrosep.separation.circles.spindle_result import (
        SpindleHarmonics as SpindleHarmonics,
        SpindleMotion as SpindleMotion,
    )
    from metrosep.separation.circles.steps import (
        MultistepRoundness as MultistepRoundness,
        multistep as multistep,
    )
    from metrosep.separation.contract import (
        Separation as Separation,
        SeparationMethod as SeparationMethod,
        Unobservable as Unobservable,
        suppressed_harmonics as suppressed_harmonics,
    )
    from metrosep.separation.drift.alternation import (
        AbbaDrift as AbbaDrift,
        DriftFreeDifference as DriftFreeDifference,
        abba as abba,
    )
    from metrosep.separation.drift.dependence import (
        Dependence as Dependence,
        allan_deviation as allan_deviation,
        drift_against_temperature as drift_against_temperature,
        speed_dependence as speed_dependence,
    )
    from metrosep.separation.drift.drift import (
        DriftFit as DriftFit,
        DriftTest as DriftTest,
        iso230_3_drift as iso230_3_drift,
    )
    from metrosep.separation.lines._line_problem import ZeroCalibration as ZeroCalibration
    from metrosep.separation.lines.iso230_straightness import (
        MotionStraightness as MotionStraightness,
        ReferenceLine as ReferenceLine,
        straightness_iso230_1 as straightness_iso230_1,
    )
    from metrosep.separation.lines.reversals import (
        StraightedgeReversal as StraightedgeReversal,
        slide_error as slide_error,
        straightedge_reversal as straightedge_reversal,
    )
    from metrosep.separation.lines.slope_integration import (
        SlopeIntegration as SlopeIntegration,
        integrate_slopes as integrate_slopes,
        slope_transfer as slope_transfer,
    )
    from metrosep.separation.lines.three_points import (
        MultiProbe as MultiProbe,
        ThreePoint as ThreePoint,
        TwoPoint as TwoPoint,
        multi_probe_straightness as multi_probe_straightness,
        three_point as three_point,
        two_point as two_point,
        zero_error_sag as zero_error_sag,
    )
    from metrosep.separation.lines.zero_adjustment import (
        ZeroAdjustment as ZeroAdjustment,
        zero_calibration as zero_calibration,
    )
    from metrosep.separation.maps.averaging import (
        ThreePositions as ThreePositions,
        ball_average as ball_average,
        three_positions as three_positions,
    )
    from metrosep.separation.maps.flats import (
        ThreeFlat as ThreeFlat,
        three_flat as three_flat,
    )
    from metrosep.separation.maps.lateral_shifts import (
        ShiftRotation as ShiftRotation,
        shift_rotation as shift_rotation,
    )
    from metrosep.separation.maps.registration import (
        Registration as Registration,
        register_maps as register_maps,
        register_points as register_points,
        registration_uncertainty as registration_uncertainty,
    )
    from metrosep.separation.maps.rotations import (
        RotationTest as RotationTest,
        rotation_average as rotation_average,
    )
    from metrosep.separation.maps.stitching import (
        Stitching as Stitching,
        stitch as stitch,
    )
    from metrosep.separation.planes.coupled_method import (
        CoupledGrid as CoupledGrid,
        coupled_grid as coupled_grid,
    )
    from metrosep.separation.planes.diagonals import (
        Diagonals as Diagonals,
        DiagonalTest as DiagonalTest,
        iso230_6_diagonals as iso230_6_diagonals,
    )
    from metrosep.separation.planes.lattice_calibration import (
        GridCalibration as GridCalibration,
        GridView as GridView,
        grid_calibration as grid_calibration,
    )
    from metrosep.separation.planes.plane_fit import (
        Interaction as Interaction,
        PlaneFit as PlaneFit,
        PlaneModel as PlaneModel,
        fit_plane_model as fit_plane_model,
    )
    from metrosep.separation.planes.plane_model import (
        PlaneMap as PlaneMap,
        plane_map as plane_map,
    )
    from metrosep.separation.planes.squareness import (
        Squareness as Squareness,
        squareness_from_diagonals as squareness_from_diagonals,
    )
    from metrosep.separation.positions.expansion import Expansion as Expansion
    from metrosep.separation.positions.laser_setup import (
        LaserCorrections as LaserCorrections,
        LaserReadings as LaserReadings,
        LaserSetup as LaserSetup,
        laser_positions as laser_positions,
    )
    from metrosep.separation.positions.periodic import (
        FringeError as FringeError,
        periodic_error as periodic_error,
    )
    from metrosep.separation.positions.pitch import (
        PitchErrors as PitchErrors,
        pitch_errors as pitch_errors,
    )
    from metrosep.separation.positions.positioning import (
        PositioningSheet as PositioningSheet,
        iso230_2 as iso230_2,
        positions_from_columns as positions_from_columns,
        positions_from_profiles as positions_from_profiles,
    )
    from metrosep.separation.positions.positioning_result import (
        PositioningTest as PositioningTest,
    )
    from metrosep.separation.positions.repeats import (
        RepeatSplit as RepeatSplit,
        repeatable as repeatable,
    )
    from metrosep.separation.runs.base import (
        DirectionEstimate as DirectionEstimate,
        ErrorEstimate as ErrorEstimate,
    )
    from metrosep.separation.runs.entry import (
        separate as separate,
    )
    from metrosep.separation.runs.evidence import (
        EvidenceTable as EvidenceTable,
        evidence_table as evidence_table,
    )
    from metrosep.separation.runs.joint_method import (
        JointDrift as JointDrift,
        JointSeparation as JointSeparation,
        joint_drift as joint_drift,
    )
    from metrosep.separation.runs.planner import (
        FeedPlan as FeedPlan,
        plan_feedrates as plan_feedrates,
        predicted_sd as predicted_sd,
    )
    from metrosep.separation.runs.simulate import (
        KONO_WAVES as KONO_WAVES,
        SimulatedAxis as SimulatedAxis,
        machine_axis as machine_axis,
    )
    from metrosep.separation.runs.solver import (
        TimeDensity as TimeDensity,
        time_density as time_density,
    )
    from metrosep.separation.runs.spectra import (
        FeedSpectra as FeedSpectra,
        feed_spectra as feed_spectra,
    )
    from metrosep.spectral.window import kono_weights as kono_weights


METHODS = {
    "donaldson": "circles.roundness_reversal:DonaldsonReversal",
    "face_reversal": "circles.roundness_reversal:FaceReversal",
    "multiprobe": "circles.probes:MultiprobeRoundness",
    "orthogonal_mixed": "circles.mixed:OrthogonalMixed",
    "multistep": "circles.steps:MultistepRoundness",
    "closure": "circles.circle_closure:CircleClosure",
    "iso230_7": "circles.spindle:SpindleTest",
    "straightedge_reversal": "lines.reversals:StraightedgeReversal",
    "reversal_of_estimates": "lines.reversals:EstimatesReversed",
    "two_point": "lines.three_points:TwoPoint",
    "three_point": "lines.three_points:ThreePoint",
    "zero_calibration": "lines.zero_adjustment:ZeroTest",
    "multi_probe_straightness": "lines.three_points:MultiProbe",
    "integrate_slopes": "lines.slope_integration:SlopeIntegration",
    "straightness_iso230_1": "lines.iso230_straightness:StraightnessTest",
    "abba": "drift.alternation:AbbaDrift",
    "joint_drift": "drift.drift:DriftFit",
    "iso230_3_drift": "drift.drift:DriftOfChannels",
    "speed_dependence": "drift.dependence:OverSpeed",
    "drift_against_temperature": "drift.dependence:OverTemperature",
    "repeatable": "positions.repeats:RepeatSplit",
    "periodic_error": "positions.periodic:FringeError",
    "iso230_2": "positions.positioning:PositioningOfAxis",
    "laser_positions": "positions.laser_setup:LaserPositions",
    "air": "positions.laser_setup:AirOnce",
    "iso230_6_diagonals": "planes.diagonals:DiagonalsOfTables",
    "three_flat": "maps.flats:ThreeFlat",
    "rotation_average": "maps.rotations:RotationTest",
    "shift_rotation": "maps.lateral_shifts:ShiftRotation",
    "repeatable_maps": "positions.repeats:RepeatedMaps",
    "register_maps": "maps.registration:MapsRegistered",
    "ball_average": "maps.averaging:BallTest",
    "three_positions": "maps.averaging:ThreePositions",
    "stitch": "maps.stitching:Stitching",
    "fit_plane_model": "planes.plane_fit:PlaneOfTable",
    "coupled_grid": "planes.coupled_method:CoupledGrid",
    "grid_calibration": "planes.lattice_calibration:GridCalibration",
    "plane_map": "planes.plane_model:AxesCombined",
    "combine_harmonics": "circles.roundness_reversal:Combination",
    "check_probes": "circles.probe_check:ProbesChecked",
    "optimise_probe_angles": "circles.probe_angles:ProbesChosen",
    "evidence_table": "runs.evidence:EvidenceOfTable",
    "register_points": "maps.registration:PointsRegistered",
    "fit_speed_sweep": "circles.speed_sweep:SpeedTest",
}
"""Module and class of each method that has a name, in the order in which they are listed."""

__getattr__, __dir__ = lazy_package(__name__)
