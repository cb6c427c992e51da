"""Error separation: machine from artefact from vibration from drift from noise.

`separate` takes repeated runs of an axis apart; every other set-up has a function of its own, most of
which return a `Separation` with its null space. A name loads its module on first use.

error = actual - nominal. What a method cannot see is listed in its result and set NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.separation.alternation import (
        AbbaDrift as AbbaDrift,
        DriftFreeDifference as DriftFreeDifference,
        abba as abba,
    )
    from metrosep.separation.averaging import (
        ThreePositions as ThreePositions,
        ball_average as ball_average,
        three_positions as three_positions,
    )
    from metrosep.separation.base import (
        DirectionEstimate as DirectionEstimate,
        ErrorEstimate as ErrorEstimate,
    )
    from metrosep.separation.circle_closure import (
        CircleClosure as CircleClosure,
        closure as closure,
    )
    from metrosep.separation.contract import (
        Separation as Separation,
        SeparationMethod as SeparationMethod,
        Unobservable as Unobservable,
        suppressed_harmonics as suppressed_harmonics,
    )
    from metrosep.separation.coupled_method import (
        CoupledGrid as CoupledGrid,
    )
    from metrosep.separation.dependence import (
        Dependence as Dependence,
        allan_deviation as allan_deviation,
        drift_against_temperature as drift_against_temperature,
        speed_dependence as speed_dependence,
    )
    from metrosep.separation.diagonals import (
        Diagonals as Diagonals,
        DiagonalTest as DiagonalTest,
        iso230_6_diagonals as iso230_6_diagonals,
    )
    from metrosep.separation.drift import (
        DriftFit as DriftFit,
        DriftTest as DriftTest,
        iso230_3_drift as iso230_3_drift,
    )
    from metrosep.separation.entry import (
        separate as separate,
        separate_mean as separate_mean,
    )
    from metrosep.separation.evidence import (
        EvidenceTable as EvidenceTable,
        evidence_table as evidence_table,
    )
    from metrosep.separation.flat_setup import (
        ThreeFlat as ThreeFlat,
    )
    from metrosep.separation.flats import (
        three_flat as three_flat,
    )
    from metrosep.separation.fourier import (
        separate_kono as separate_kono,
    )
    from metrosep.separation.iso230_straightness import (
        MotionStraightness as MotionStraightness,
        ReferenceLine as ReferenceLine,
        straightness_iso230_1 as straightness_iso230_1,
    )
    from metrosep.separation.joint import (
        separate_joint as separate_joint,
    )
    from metrosep.separation.joint_method import (
        JointDrift as JointDrift,
        JointSeparation as JointSeparation,
        joint_drift as joint_drift,
    )
    from metrosep.separation.lateral_shifts import (
        ShiftRotation as ShiftRotation,
        shift_rotation as shift_rotation,
    )
    from metrosep.separation.lattice_calibration import (
        GridCalibration as GridCalibration,
        GridView as GridView,
        grid_calibration as grid_calibration,
    )
    from metrosep.separation.mixed import (
        OrthogonalMixed as OrthogonalMixed,
        mixed_transfer as mixed_transfer,
        orthogonal_mixed as orthogonal_mixed,
    )
    from metrosep.separation.multi_probes import (
        MultiProbe as MultiProbe,
        multi_probe_straightness as multi_probe_straightness,
    )
    from metrosep.separation.periodic import (
        FringeError as FringeError,
        periodic_error as periodic_error,
    )
    from metrosep.separation.plane_fit import (
        Interaction as Interaction,
        PlaneFit as PlaneFit,
        PlaneModel as PlaneModel,
        fit_plane_model as fit_plane_model,
    )
    from metrosep.separation.plane_grid import (
        coupled_grid as coupled_grid,
    )
    from metrosep.separation.plane_model import (
        PlaneMap as PlaneMap,
        plane_map as plane_map,
    )
    from metrosep.separation.planner import (
        FeedPlan as FeedPlan,
        plan_feedrates as plan_feedrates,
        predicted_sd as predicted_sd,
    )
    from metrosep.separation.positioning import (
        PositioningSheet as PositioningSheet,
        iso230_2 as iso230_2,
        positions_from_columns as positions_from_columns,
        positions_from_profiles as positions_from_profiles,
    )
    from metrosep.separation.positioning_result import (
        PositioningTest as PositioningTest,
    )
    from metrosep.separation.probe_angles import (
        ProbeAngles as ProbeAngles,
        optimise_probe_angles as optimise_probe_angles,
        probe_gain as probe_gain,
    )
    from metrosep.separation.probe_check import (
        ProbeCheck as ProbeCheck,
        Suspect as Suspect,
        check_probes as check_probes,
    )
    from metrosep.separation.probes import (
        MultiprobeRoundness as MultiprobeRoundness,
        multiprobe as multiprobe,
    )
    from metrosep.separation.registration import (
        Registration as Registration,
        register_maps as register_maps,
        register_points as register_points,
        registration_uncertainty as registration_uncertainty,
    )
    from metrosep.separation.repeats import (
        RepeatSplit as RepeatSplit,
        repeatable as repeatable,
    )
    from metrosep.separation.resampling import (
        AngleSynchronous as AngleSynchronous,
        cubic_interpolation_error as cubic_interpolation_error,
        index_pulses as index_pulses,
        resample_by_encoder as resample_by_encoder,
        resample_by_index as resample_by_index,
    )
    from metrosep.separation.reversals import (
        StraightedgeReversal as StraightedgeReversal,
        straightedge_reversal as straightedge_reversal,
    )
    from metrosep.separation.rotations import (
        RotationTest as RotationTest,
        rotation_average as rotation_average,
    )
    from metrosep.separation.roundness_reversal import (
        DonaldsonReversal as DonaldsonReversal,
        FaceReversal as FaceReversal,
        combine_harmonics as combine_harmonics,
        donaldson as donaldson,
        face_reversal as face_reversal,
    )
    from metrosep.separation.simulate import (
        KONO_WAVES as KONO_WAVES,
        SimulatedAxis as SimulatedAxis,
        machine_axis as machine_axis,
    )
    from metrosep.separation.slope_integration import (
        SlopeIntegration as SlopeIntegration,
        integrate_slopes as integrate_slopes,
        slope_transfer as slope_transfer,
    )
    from metrosep.separation.solver import (
        TimeDensity as TimeDensity,
        time_density as time_density,
    )
    from metrosep.separation.spectra import (
        FeedSpectra as FeedSpectra,
        feed_spectra as feed_spectra,
    )
    from metrosep.separation.speed_fit import (
        SpeedFit as SpeedFit,
        fit_values as fit_values,
    )
    from metrosep.separation.speed_sweep import (
        SpeedGrowth as SpeedGrowth,
        SpeedSweep as SpeedSweep,
        fit_speed_sweep as fit_speed_sweep,
    )
    from metrosep.separation.spindle import (
        iso230_7 as iso230_7,
    )
    from metrosep.separation.spindle_method import (
        SpindleSplit as SpindleSplit,
    )
    from metrosep.separation.spindle_result import (
        SpindleHarmonics as SpindleHarmonics,
        SpindleMotion as SpindleMotion,
    )
    from metrosep.separation.squareness import (
        Squareness as Squareness,
        squareness_from_diagonals as squareness_from_diagonals,
    )
    from metrosep.separation.steps import (
        MultistepRoundness as MultistepRoundness,
        multistep as multistep,
    )
    from metrosep.separation.stitching import (
        Stitching as Stitching,
        stitch as stitch,
    )
    from metrosep.separation.three_points import (
        ThreePoint as ThreePoint,
        TwoPoint as TwoPoint,
        three_point as three_point,
        two_point as two_point,
        zero_error_sag as zero_error_sag,
    )
    from metrosep.separation.zero_adjustment import (
        ZeroAdjustment as ZeroAdjustment,
        ZeroCalibration as ZeroCalibration,
        zero_calibration as zero_calibration,
    )
    from metrosep.spectral.window import kono_weights as kono_weights

_HOMES = {
    "alternation": (
        "AbbaDrift",
        "DriftFreeDifference",
        "abba",
    ),
    "averaging": (
        "ThreePositions",
        "ball_average",
        "three_positions",
    ),
    "base": (
        "DirectionEstimate",
        "ErrorEstimate",
    ),
    "circle_closure": (
        "CircleClosure",
        "closure",
    ),
    "contract": (
        "Separation",
        "SeparationMethod",
        "Unobservable",
        "suppressed_harmonics",
    ),
    "coupled_method": ("CoupledGrid",),
    "dependence": (
        "Dependence",
        "allan_deviation",
        "drift_against_temperature",
        "speed_dependence",
    ),
    "diagonals": (
        "DiagonalTest",
        "Diagonals",
        "iso230_6_diagonals",
    ),
    "drift": (
        "DriftFit",
        "DriftTest",
        "iso230_3_drift",
    ),
    "entry": (
        "separate",
        "separate_mean",
    ),
    "evidence": (
        "EvidenceTable",
        "evidence_table",
    ),
    "flat_setup": ("ThreeFlat",),
    "flats": ("three_flat",),
    "fourier": ("separate_kono",),
    "iso230_straightness": (
        "MotionStraightness",
        "ReferenceLine",
        "straightness_iso230_1",
    ),
    "joint": ("separate_joint",),
    "joint_method": (
        "JointDrift",
        "JointSeparation",
        "joint_drift",
    ),
    "lateral_shifts": (
        "ShiftRotation",
        "shift_rotation",
    ),
    "lattice_calibration": (
        "GridCalibration",
        "GridView",
        "grid_calibration",
    ),
    "mixed": (
        "OrthogonalMixed",
        "mixed_transfer",
        "orthogonal_mixed",
    ),
    "multi_probes": (
        "MultiProbe",
        "multi_probe_straightness",
    ),
    "periodic": (
        "FringeError",
        "periodic_error",
    ),
    "plane_fit": (
        "Interaction",
        "PlaneFit",
        "PlaneModel",
        "fit_plane_model",
    ),
    "plane_grid": ("coupled_grid",),
    "plane_model": (
        "PlaneMap",
        "plane_map",
    ),
    "planner": (
        "FeedPlan",
        "plan_feedrates",
        "predicted_sd",
    ),
    "positioning": (
        "PositioningSheet",
        "iso230_2",
        "positions_from_columns",
        "positions_from_profiles",
    ),
    "positioning_result": ("PositioningTest",),
    "probe_angles": (
        "ProbeAngles",
        "optimise_probe_angles",
        "probe_gain",
    ),
    "probe_check": (
        "ProbeCheck",
        "Suspect",
        "check_probes",
    ),
    "probes": (
        "MultiprobeRoundness",
        "multiprobe",
    ),
    "registration": (
        "Registration",
        "register_maps",
        "register_points",
        "registration_uncertainty",
    ),
    "repeats": (
        "RepeatSplit",
        "repeatable",
    ),
    "resampling": (
        "AngleSynchronous",
        "cubic_interpolation_error",
        "index_pulses",
        "resample_by_encoder",
        "resample_by_index",
    ),
    "reversals": (
        "StraightedgeReversal",
        "straightedge_reversal",
    ),
    "rotations": (
        "RotationTest",
        "rotation_average",
    ),
    "roundness_reversal": (
        "DonaldsonReversal",
        "FaceReversal",
        "combine_harmonics",
        "donaldson",
        "face_reversal",
    ),
    "simulate": (
        "KONO_WAVES",
        "SimulatedAxis",
        "machine_axis",
    ),
    "slope_integration": (
        "SlopeIntegration",
        "integrate_slopes",
        "slope_transfer",
    ),
    "solver": (
        "TimeDensity",
        "time_density",
    ),
    "spectra": (
        "FeedSpectra",
        "feed_spectra",
        "kono_weights",
    ),
    "speed_fit": (
        "SpeedFit",
        "fit_values",
    ),
    "speed_sweep": (
        "SpeedGrowth",
        "SpeedSweep",
        "fit_speed_sweep",
    ),
    "spindle": ("iso230_7",),
    "spindle_method": ("SpindleSplit",),
    "spindle_result": (
        "SpindleHarmonics",
        "SpindleMotion",
    ),
    "squareness": (
        "Squareness",
        "squareness_from_diagonals",
    ),
    "steps": (
        "MultistepRoundness",
        "multistep",
    ),
    "stitching": (
        "Stitching",
        "stitch",
    ),
    "three_points": (
        "ThreePoint",
        "TwoPoint",
        "three_point",
        "two_point",
        "zero_error_sag",
    ),
    "zero_adjustment": (
        "ZeroAdjustment",
        "ZeroCalibration",
        "zero_calibration",
    ),
}

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
