"""Error separation: machine from artefact from vibration from drift from noise.

`separate` takes repeated runs of an axis apart; every other set-up has a function of its own, most of
which return a `Separation` with its null space. A name loads its module on first use.

error = actual - nominal. What a method cannot see is listed in its result and set NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.separation.abba_method import (
        AbbaDrift as AbbaDrift,
    )
    from metrosep.separation.alternation import (
        DriftFreeDifference as DriftFreeDifference,
        abba as abba,
    )
    from metrosep.separation.average import (
        separate_mean as separate_mean,
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
    from metrosep.separation.combine import (
        combine_harmonics as combine_harmonics,
    )
    from metrosep.separation.contract import (
        Separation as Separation,
        SeparationMethod as SeparationMethod,
    )
    from metrosep.separation.coupled_method import (
        CoupledGrid as CoupledGrid,
    )
    from metrosep.separation.dependence import (
        Dependence as Dependence,
        drift_against_temperature as drift_against_temperature,
        speed_dependence as speed_dependence,
    )
    from metrosep.separation.diagonal_method import (
        Diagonals as Diagonals,
    )
    from metrosep.separation.diagonals import (
        DiagonalTest as DiagonalTest,
        iso230_6_diagonals as iso230_6_diagonals,
    )
    from metrosep.separation.drift import (
        DriftTest as DriftTest,
        iso230_3_drift as iso230_3_drift,
    )
    from metrosep.separation.drift_fit_method import (
        DriftFit as DriftFit,
    )
    from metrosep.separation.entry import (
        separate as separate,
    )
    from metrosep.separation.evidence import (
        EvidenceTable as EvidenceTable,
        evidence_table as evidence_table,
    )
    from metrosep.separation.face import (
        FaceReversal as FaceReversal,
        face_reversal as face_reversal,
    )
    from metrosep.separation.fiducials import (
        Registration as Registration,
        register_points as register_points,
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
    from metrosep.separation.index_detection import (
        index_pulses as index_pulses,
    )
    from metrosep.separation.iso230_straightness import (
        MotionStraightness as MotionStraightness,
        straightness_iso230_1 as straightness_iso230_1,
    )
    from metrosep.separation.joint import (
        separate_joint as separate_joint,
    )
    from metrosep.separation.joint_fit import (
        JointDrift as JointDrift,
        joint_drift as joint_drift,
    )
    from metrosep.separation.joint_method import (
        JointSeparation as JointSeparation,
    )
    from metrosep.separation.lateral_shifts import (
        shift_rotation as shift_rotation,
    )
    from metrosep.separation.lattice_calibration import (
        GridView as GridView,
        grid_calibration as grid_calibration,
    )
    from metrosep.separation.lattice_method import (
        GridCalibration as GridCalibration,
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
    from metrosep.separation.noise_density import (
        TimeDensity as TimeDensity,
        time_density as time_density,
    )
    from metrosep.separation.null_space import (
        Unobservable as Unobservable,
        suppressed_harmonics as suppressed_harmonics,
    )
    from metrosep.separation.periodic import (
        FringeError as FringeError,
        periodic_error as periodic_error,
    )
    from metrosep.separation.plane_fit import (
        Interaction as Interaction,
        PlaneFit as PlaneFit,
        fit_plane_model as fit_plane_model,
    )
    from metrosep.separation.plane_grid import (
        coupled_grid as coupled_grid,
    )
    from metrosep.separation.plane_method import (
        PlaneModel as PlaneModel,
    )
    from metrosep.separation.plane_model import (
        PlaneMap as PlaneMap,
        plane_map as plane_map,
    )
    from metrosep.separation.planner import (
        plan_feedrates as plan_feedrates,
        predicted_sd as predicted_sd,
    )
    from metrosep.separation.planner_result import (
        FeedPlan as FeedPlan,
    )
    from metrosep.separation.positioning import (
        iso230_2 as iso230_2,
        positions_from_columns as positions_from_columns,
        positions_from_profiles as positions_from_profiles,
    )
    from metrosep.separation.positioning_method import (
        PositioningSheet as PositioningSheet,
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
        register_maps as register_maps,
        registration_uncertainty as registration_uncertainty,
    )
    from metrosep.separation.repeats import (
        RepeatSplit as RepeatSplit,
        repeatable as repeatable,
    )
    from metrosep.separation.resampling import (
        AngleSynchronous as AngleSynchronous,
        cubic_interpolation_error as cubic_interpolation_error,
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
        donaldson as donaldson,
    )
    from metrosep.separation.shift_setup import (
        ShiftRotation as ShiftRotation,
    )
    from metrosep.separation.simulate import (
        KONO_WAVES as KONO_WAVES,
        SimulatedAxis as SimulatedAxis,
        machine_axis as machine_axis,
    )
    from metrosep.separation.slope_integration import (
        integrate_slopes as integrate_slopes,
        slope_transfer as slope_transfer,
    )
    from metrosep.separation.slope_method import (
        SlopeIntegration as SlopeIntegration,
    )
    from metrosep.separation.spectra import (
        FeedSpectra as FeedSpectra,
        feed_spectra as feed_spectra,
    )
    from metrosep.separation.speed_fit import (
        SpeedFit as SpeedFit,
        fit_values as fit_values,
    )
    from metrosep.separation.speed_method import (
        SpeedGrowth as SpeedGrowth,
    )
    from metrosep.separation.speed_sweep import (
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
    from metrosep.separation.stability import (
        allan_deviation as allan_deviation,
    )
    from metrosep.separation.steps import (
        MultistepRoundness as MultistepRoundness,
        multistep as multistep,
    )
    from metrosep.separation.stitching import (
        Stitching as Stitching,
        stitch as stitch,
    )
    from metrosep.separation.straightness_method import (
        ReferenceLine as ReferenceLine,
    )
    from metrosep.separation.three_points import (
        ThreePoint as ThreePoint,
        three_point as three_point,
        zero_error_sag as zero_error_sag,
    )
    from metrosep.separation.two_points import (
        TwoPoint as TwoPoint,
        two_point as two_point,
    )
    from metrosep.separation.zero_adjustment import (
        ZeroCalibration as ZeroCalibration,
        zero_calibration as zero_calibration,
    )
    from metrosep.separation.zero_method import (
        ZeroAdjustment as ZeroAdjustment,
    )
    from metrosep.spectral.window import kono_weights as kono_weights

_HOMES = {
    "abba_method": ("AbbaDrift",),
    "alternation": (
        "DriftFreeDifference",
        "abba",
    ),
    "average": ("separate_mean",),
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
    "combine": ("combine_harmonics",),
    "contract": (
        "Separation",
        "SeparationMethod",
    ),
    "coupled_method": ("CoupledGrid",),
    "dependence": (
        "Dependence",
        "drift_against_temperature",
        "speed_dependence",
    ),
    "diagonal_method": ("Diagonals",),
    "diagonals": (
        "DiagonalTest",
        "iso230_6_diagonals",
    ),
    "drift": (
        "DriftTest",
        "iso230_3_drift",
    ),
    "drift_fit_method": ("DriftFit",),
    "entry": ("separate",),
    "evidence": (
        "EvidenceTable",
        "evidence_table",
    ),
    "face": (
        "FaceReversal",
        "face_reversal",
    ),
    "fiducials": (
        "Registration",
        "register_points",
    ),
    "flat_setup": ("ThreeFlat",),
    "flats": ("three_flat",),
    "fourier": ("separate_kono",),
    "index_detection": ("index_pulses",),
    "iso230_straightness": (
        "MotionStraightness",
        "straightness_iso230_1",
    ),
    "joint": ("separate_joint",),
    "joint_fit": (
        "JointDrift",
        "joint_drift",
    ),
    "joint_method": ("JointSeparation",),
    "lateral_shifts": ("shift_rotation",),
    "lattice_calibration": (
        "GridView",
        "grid_calibration",
    ),
    "lattice_method": ("GridCalibration",),
    "mixed": (
        "OrthogonalMixed",
        "mixed_transfer",
        "orthogonal_mixed",
    ),
    "multi_probes": (
        "MultiProbe",
        "multi_probe_straightness",
    ),
    "noise_density": (
        "TimeDensity",
        "time_density",
    ),
    "null_space": (
        "Unobservable",
        "suppressed_harmonics",
    ),
    "periodic": (
        "FringeError",
        "periodic_error",
    ),
    "plane_fit": (
        "Interaction",
        "PlaneFit",
        "fit_plane_model",
    ),
    "plane_grid": ("coupled_grid",),
    "plane_method": ("PlaneModel",),
    "plane_model": (
        "PlaneMap",
        "plane_map",
    ),
    "planner": (
        "plan_feedrates",
        "predicted_sd",
    ),
    "planner_result": ("FeedPlan",),
    "positioning": (
        "iso230_2",
        "positions_from_columns",
        "positions_from_profiles",
    ),
    "positioning_method": ("PositioningSheet",),
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
        "register_maps",
        "registration_uncertainty",
    ),
    "repeats": (
        "RepeatSplit",
        "repeatable",
    ),
    "resampling": (
        "AngleSynchronous",
        "cubic_interpolation_error",
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
        "donaldson",
    ),
    "shift_setup": ("ShiftRotation",),
    "simulate": (
        "KONO_WAVES",
        "SimulatedAxis",
        "machine_axis",
    ),
    "slope_integration": (
        "integrate_slopes",
        "slope_transfer",
    ),
    "slope_method": ("SlopeIntegration",),
    "spectra": (
        "FeedSpectra",
        "feed_spectra",
        "kono_weights",
    ),
    "speed_fit": (
        "SpeedFit",
        "fit_values",
    ),
    "speed_method": ("SpeedGrowth",),
    "speed_sweep": (
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
    "stability": ("allan_deviation",),
    "steps": (
        "MultistepRoundness",
        "multistep",
    ),
    "stitching": (
        "Stitching",
        "stitch",
    ),
    "straightness_method": ("ReferenceLine",),
    "three_points": (
        "ThreePoint",
        "three_point",
        "zero_error_sag",
    ),
    "two_points": (
        "TwoPoint",
        "two_point",
    ),
    "zero_adjustment": (
        "ZeroCalibration",
        "zero_calibration",
    ),
    "zero_method": ("ZeroAdjustment",),
}

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
