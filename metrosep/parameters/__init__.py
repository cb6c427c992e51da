"""Parameters, form deviations, uncertainty and verdicts; a name loads its module on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.parameters._profile_rows import (
        ProfileElements as ProfileElements,
        profile_elements as profile_elements,
    )
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
    from metrosep.parameters.decision import (
        Acceptance as Acceptance,
        Decision as Decision,
        conformance_probability as conformance_probability,
        decide as decide,
        guard_factor as guard_factor,
        judge as judge,
        judge_values as judge_values,
    )
    from metrosep.parameters.deviation import form_deviation as form_deviation
    from metrosep.parameters.form_result import FormDeviation as FormDeviation, Support as Support
    from metrosep.parameters.gauge import (
        Capability as Capability,
        ControlLimits as ControlLimits,
        GaugeStudy as GaugeStudy,
        VarianceRow as VarianceRow,
        capability_of as capability_of,
        control_limits as control_limits,
        gauge_study as gauge_study,
    )
    from metrosep.parameters.geometry import (
        DatumAxis as DatumAxis,
        DatumPlane as DatumPlane,
        GeometricDeviation as GeometricDeviation,
        axis_zone as axis_zone,
        coaxiality as coaxiality,
        cylindricity as cylindricity,
        datum_axis as datum_axis,
        datum_plane as datum_plane,
        parallelism as parallelism,
        perpendicularity as perpendicularity,
        run_out as run_out,
        surface_profile as surface_profile,
    )
    from metrosep.parameters.grooves import (
        StepHeight as StepHeight,
        step_between as step_between,
        step_height as step_height,
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
        NoiseEstimate as NoiseEstimate,
        NoiseFromPsd as NoiseFromPsd,
        NoiseFromRepeats as NoiseFromRepeats,
        StationaryNoise as StationaryNoise,
        WhiteNoise as WhiteNoise,
        mean_of_repeats as mean_of_repeats,
        noise_of_repeats as noise_of_repeats,
        stack_repeats as stack_repeats,
    )
    from metrosep.parameters.profile import (
        SETTING_CLASSES as SETTING_CLASSES,
        ProfileParameterTable as ProfileParameterTable,
        SettingClass as SettingClass,
        profile_parameters as profile_parameters,
        setting_class as setting_class,
        settle_cutoff as settle_cutoff,
        suggested_cutoff as suggested_cutoff,
    )
    from metrosep.parameters.propagation import (
        Effect as Effect,
        MonteCarloResult as MonteCarloResult,
        MonteCarloTable as MonteCarloTable,
        drift_effect as drift_effect,
        monte_carlo as monte_carlo,
        monte_carlo_table as monte_carlo_table,
        nonlinearity_effect as nonlinearity_effect,
        scale_effect as scale_effect,
        shortest_interval as shortest_interval,
    )
    from metrosep.parameters.psd_limits import (
        BandResult as BandResult,
        PsdLimit as PsdLimit,
        PsdVerdict as PsdVerdict,
        judge_psd as judge_psd,
        psd_limit as psd_limit,
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

__getattr__, __dir__ = lazy_package(__name__)
