"""Parameters, form deviations, uncertainty and verdicts."""

from __future__ import annotations

from metrosep.parameters.areal import ArealParameterTable, areal_parameters
from metrosep.parameters.budget import Budget, Contribution, coverage_factor, report_value
from metrosep.parameters.budget_lines import (
    alternatives_line,
    certificate_line,
    drift_line,
    lateral_scale_line,
    nonlinearity_line,
    repeatability_line,
    scale_line,
)
from metrosep.parameters.decision import decide
from metrosep.parameters.effects import Effect, drift_effect, nonlinearity_effect, scale_effect
from metrosep.parameters.elements import ProfileElements, profile_elements
from metrosep.parameters.form_deviation import form_deviation
from metrosep.parameters.form_result import FormDeviation, Support
from metrosep.parameters.guard import Decision, conformance_probability, guard_factor, judge
from metrosep.parameters.interferometric import (
    interferometric_parameters,
    robust_peak_to_valley,
)
from metrosep.parameters.material_ratio import AbbottCurve, CoreHeight, abbott_curve, core_height
from metrosep.parameters.monte_carlo import MonteCarloResult, monte_carlo, shortest_interval
from metrosep.parameters.noise import (
    CorrelatedNoise,
    Noise,
    NoiseFromPsd,
    NoiseFromRepeats,
    StationaryNoise,
    WhiteNoise,
)
from metrosep.parameters.profile import ProfileParameterTable, profile_parameters
from metrosep.parameters.repeat_noise import (
    NoiseEstimate,
    mean_of_repeats,
    noise_of_repeats,
    stack_repeats,
)
from metrosep.parameters.repeats import (
    NoiseFreeRms,
    RepeatResult,
    TypeA,
    from_repeats,
    noise_free_rms,
    type_a,
)
from metrosep.parameters.settings import (
    SETTING_CLASSES,
    SettingClass,
    setting_class,
    settle_cutoff,
    suggested_cutoff,
)
from metrosep.parameters.softgauge import verify_softgauge
from metrosep.parameters.table import Context, ParameterTable
from metrosep.parameters.uncertainty import (
    NoiseInfluence,
    effective_number,
    expected_range,
    linear_uncertainty,
    noise_influence,
    scale_uncertainty,
)

__all__ = [
    "SETTING_CLASSES",
    "AbbottCurve",
    "ArealParameterTable",
    "Budget",
    "Context",
    "Contribution",
    "CoreHeight",
    "CorrelatedNoise",
    "Decision",
    "Effect",
    "FormDeviation",
    "MonteCarloResult",
    "Noise",
    "NoiseEstimate",
    "NoiseFreeRms",
    "NoiseFromPsd",
    "NoiseFromRepeats",
    "NoiseInfluence",
    "ParameterTable",
    "ProfileElements",
    "ProfileParameterTable",
    "RepeatResult",
    "SettingClass",
    "StationaryNoise",
    "Support",
    "TypeA",
    "WhiteNoise",
    "abbott_curve",
    "alternatives_line",
    "areal_parameters",
    "certificate_line",
    "conformance_probability",
    "core_height",
    "coverage_factor",
    "decide",
    "drift_effect",
    "drift_line",
    "effective_number",
    "expected_range",
    "form_deviation",
    "from_repeats",
    "guard_factor",
    "interferometric_parameters",
    "judge",
    "lateral_scale_line",
    "linear_uncertainty",
    "mean_of_repeats",
    "monte_carlo",
    "noise_free_rms",
    "noise_influence",
    "noise_of_repeats",
    "nonlinearity_effect",
    "nonlinearity_line",
    "profile_elements",
    "profile_parameters",
    "repeatability_line",
    "report_value",
    "robust_peak_to_valley",
    "scale_effect",
    "scale_line",
    "scale_uncertainty",
    "setting_class",
    "settle_cutoff",
    "shortest_interval",
    "stack_repeats",
    "suggested_cutoff",
    "type_a",
    "verify_softgauge",
]
