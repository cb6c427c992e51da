"""What a result document holds of any result: quantities, tables, maps and charts.

One function for every kind of result of the toolbox. The kinds are told apart by their class name,
so that no module of the toolbox is loaded before it is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrosep.core.errors import DataError
from metrosep.recipe.describe_checks import (
    evidence_of,
    probe_angles_of,
    probe_check_of,
    speed_sweep_of,
)
from metrosep.recipe.describe_drift import (
    dependence_of,
    difference_of,
    drift_test_of,
    joint_drift_of,
)
from metrosep.recipe.describe_machine import identification_of, sensitivity_of, wavefront_of
from metrosep.recipe.describe_maps import plane_map_of, registration_of, surfaces_of
from metrosep.recipe.describe_process import (
    calibration_of,
    dual_servo_of,
    follow_up_of,
    prediction_of,
    setting_of,
)
from metrosep.recipe.describe_quality import gauge_of, series_of
from metrosep.recipe.describe_separation import separation_of
from metrosep.recipe.describe_tests import (
    diagonals_of,
    positions_of,
    spindle_of,
    straightness_of,
    zero_of,
)
from metrosep.recipe.description import Description
from metrosep.recipe.plan import feed_plan_of

__all__ = ["Description", "describe"]

_KINDS: Mapping[str, Any] = {
    "Separation": separation_of,
    "PositioningTest": positions_of,
    "SpindleMotion": spindle_of,
    "MotionStraightness": straightness_of,
    "DriftTest": drift_test_of,
    "DriftFreeDifference": difference_of,
    "JointDrift": joint_drift_of,
    "Dependence": dependence_of,
    "DiagonalTest": diagonals_of,
    "ZeroCalibration": zero_of,
    "PlaneMap": plane_map_of,
    "PlaneFit": surfaces_of,
    "FeedPlan": feed_plan_of,
    "Registration": registration_of,
    "ProbeCheck": probe_check_of,
    "ProbeAngles": probe_angles_of,
    "EvidenceTable": evidence_of,
    "SpeedSweep": speed_sweep_of,
    "SensitivityTable": sensitivity_of,
    "Identification": identification_of,
    "WavefrontResult": wavefront_of,
    "SettingFit": setting_of,
    "FollowUp": follow_up_of,
    "FlexureCalibration": calibration_of,
    "JobResult": prediction_of,
    "DualServoResult": dual_servo_of,
    "GaugeStudy": gauge_of,
    "PartSeries": series_of,
}


def describe(produced: Any, inputs: Any = None) -> Description:
    """Return what a document holds of a result."""
    kind = type(produced).__name__
    if kind not in _KINDS:
        raise DataError(f"a {kind} cannot be put into a result document")
    described: Description = _KINDS[kind](produced, inputs)
    return described
