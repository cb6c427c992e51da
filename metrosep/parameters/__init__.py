"""Parameters, form deviations, uncertainty and verdicts; a name loads its module on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_names

if TYPE_CHECKING:
    from metrosep.parameters.areal import (
        ArealParameterTable as ArealParameterTable,
        areal_parameters as areal_parameters,
    )
    from metrosep.parameters.budget import (
        Budget as Budget,
        Contribution as Contribution,
        coverage_factor as coverage_factor,
        report_value as report_value,
    )
    from metrosep.parameters.budget_lines import (
        alternatives_line as alternatives_line,
        certificate_line as certificate_line,
        drift_line as drift_line,
        lateral_scale_line as lateral_scale_line,
        nonlinearity_line as nonlinearity_line,
        repeatability_line as repeatability_line,
        scale_line as scale_line,
    )
    from metrosep.parameters.capability import (
        Capability as Capability,
        ControlLimits as ControlLimits,
        capability_of as capability_of,
        control_limits as control_limits,
    )
    from metrosep.parameters.decision import decide as decide
    from metrosep.parameters.deviation import form_deviation as form_deviation
    from metrosep.parameters.effects import (
        Effect as Effect,
        drift_effect as drift_effect,
        nonlinearity_effect as nonlinearity_effect,
        scale_effect as scale_effect,
    )
    from metrosep.parameters.elements import (
        ProfileElements as ProfileElements,
        profile_elements as profile_elements,
    )
    from metrosep.parameters.form_result import FormDeviation as FormDeviation, Support as Support
    from metrosep.parameters.gauge import (
        GaugeStudy as GaugeStudy,
        VarianceRow as VarianceRow,
        gauge_study as gauge_study,
    )
    from metrosep.parameters.guard import (
        Decision as Decision,
        conformance_probability as conformance_probability,
        guard_factor as guard_factor,
        judge as judge,
    )
    from metrosep.parameters.interferometric import (
        interferometric_parameters as interferometric_parameters,
        robust_peak_to_valley as robust_peak_to_valley,
    )
    from metrosep.parameters.material_ratio import (
        AbbottCurve as AbbottCurve,
        CoreHeight as CoreHeight,
        abbott_curve as abbott_curve,
        core_height as core_height,
    )
    from metrosep.parameters.noise import (
        CorrelatedNoise as CorrelatedNoise,
        Noise as Noise,
        NoiseFromPsd as NoiseFromPsd,
        NoiseFromRepeats as NoiseFromRepeats,
        StationaryNoise as StationaryNoise,
        WhiteNoise as WhiteNoise,
    )
    from metrosep.parameters.profile import (
        ProfileParameterTable as ProfileParameterTable,
        profile_parameters as profile_parameters,
    )
    from metrosep.parameters.propagation import (
        MonteCarloResult as MonteCarloResult,
        monte_carlo as monte_carlo,
        shortest_interval as shortest_interval,
    )
    from metrosep.parameters.repeat_noise import (
        NoiseEstimate as NoiseEstimate,
        mean_of_repeats as mean_of_repeats,
        noise_of_repeats as noise_of_repeats,
        stack_repeats as stack_repeats,
    )
    from metrosep.parameters.repeats import (
        NoiseFreeRms as NoiseFreeRms,
        RepeatResult as RepeatResult,
        TypeA as TypeA,
        from_repeats as from_repeats,
        noise_free_rms as noise_free_rms,
        type_a as type_a,
    )
    from metrosep.parameters.series import (
        PartSeries as PartSeries,
        TermSeries as TermSeries,
        part_series as part_series,
    )
    from metrosep.parameters.settings import (
        SETTING_CLASSES as SETTING_CLASSES,
        SettingClass as SettingClass,
        setting_class as setting_class,
        settle_cutoff as settle_cutoff,
        suggested_cutoff as suggested_cutoff,
    )
    from metrosep.parameters.softgauge import verify_softgauge as verify_softgauge
    from metrosep.parameters.table import Context as Context, ParameterTable as ParameterTable
    from metrosep.parameters.uncertainty import (
        NoiseInfluence as NoiseInfluence,
        effective_number as effective_number,
        expected_range as expected_range,
        linear_uncertainty as linear_uncertainty,
        noise_influence as noise_influence,
        scale_uncertainty as scale_uncertainty,
    )

_HOMES = {
    "areal": (
        "ArealParameterTable",
        "areal_parameters",
    ),
    "budget": (
        "Budget",
        "Contribution",
        "coverage_factor",
        "report_value",
    ),
    "budget_lines": (
        "alternatives_line",
        "certificate_line",
        "drift_line",
        "lateral_scale_line",
        "nonlinearity_line",
        "repeatability_line",
        "scale_line",
    ),
    "capability": (
        "Capability",
        "ControlLimits",
        "capability_of",
        "control_limits",
    ),
    "decision": ("decide",),
    "deviation": ("form_deviation",),
    "effects": (
        "Effect",
        "drift_effect",
        "nonlinearity_effect",
        "scale_effect",
    ),
    "elements": (
        "ProfileElements",
        "profile_elements",
    ),
    "form_result": (
        "FormDeviation",
        "Support",
    ),
    "gauge": (
        "GaugeStudy",
        "VarianceRow",
        "gauge_study",
    ),
    "guard": (
        "Decision",
        "conformance_probability",
        "guard_factor",
        "judge",
    ),
    "interferometric": (
        "interferometric_parameters",
        "robust_peak_to_valley",
    ),
    "material_ratio": (
        "AbbottCurve",
        "CoreHeight",
        "abbott_curve",
        "core_height",
    ),
    "noise": (
        "CorrelatedNoise",
        "Noise",
        "NoiseFromPsd",
        "NoiseFromRepeats",
        "StationaryNoise",
        "WhiteNoise",
    ),
    "profile": (
        "ProfileParameterTable",
        "profile_parameters",
    ),
    "propagation": (
        "MonteCarloResult",
        "monte_carlo",
        "shortest_interval",
    ),
    "repeat_noise": (
        "NoiseEstimate",
        "mean_of_repeats",
        "noise_of_repeats",
        "stack_repeats",
    ),
    "repeats": (
        "NoiseFreeRms",
        "RepeatResult",
        "TypeA",
        "from_repeats",
        "noise_free_rms",
        "type_a",
    ),
    "series": (
        "PartSeries",
        "TermSeries",
        "part_series",
    ),
    "settings": (
        "SETTING_CLASSES",
        "SettingClass",
        "setting_class",
        "settle_cutoff",
        "suggested_cutoff",
    ),
    "softgauge": ("verify_softgauge",),
    "table": (
        "Context",
        "ParameterTable",
    ),
    "uncertainty": (
        "NoiseInfluence",
        "effective_number",
        "expected_range",
        "linear_uncertainty",
        "noise_influence",
        "scale_uncertainty",
    ),
}

__all__ = sorted(name for names in _HOMES.values() for name in names)  # noqa: PLE0605

__getattr__ = lazy_names(__name__, _HOMES)


def __dir__() -> list[str]:
    return __all__
