"""Figures of results and separations, as Axes, SVG or PNG; a name loads its module on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metrosep.core._lazy import lazy_package

if TYPE_CHECKING:
    from metrosep.plot.charts import (
        draw_bars as draw_bars,
        draw_chart as draw_chart,
        plan_density as plan_density,
        plan_sd as plan_sd,
        positioning_chart as positioning_chart,
    )
    from metrosep.plot.evidence_chart import evidence_plot as evidence_plot, feed_map as feed_map
    from metrosep.plot.left_out import left_out_plot as left_out_plot
    from metrosep.plot.maps import (
        flat_maps as flat_maps,
        overlap_mismatch as overlap_mismatch,
        separation_maps as separation_maps,
        stitch_layout as stitch_layout,
        stitched_surface as stitched_surface,
    )
    from metrosep.plot.multipoint import (
        probe_gain_chart as probe_gain_chart,
        probe_layout as probe_layout,
        probe_residuals as probe_residuals,
        probe_transfer as probe_transfer,
        speed_plot as speed_plot,
        straightness_parts as straightness_parts,
    )
    from metrosep.plot.polar import (
        circle_chart as circle_chart,
        harmonic_bars as harmonic_bars,
        polar_plot as polar_plot,
    )
    from metrosep.plot.sensitivity_chart import (
        sensitivity_bars as sensitivity_bars,
        sensitivity_maps as sensitivity_maps,
        sensitivity_pareto as sensitivity_pareto,
    )
    from metrosep.plot.series_chart import allan_plot as allan_plot, drift_chart as drift_chart
    from metrosep.plot.servo_chart import (
        before_after_chart as before_after_chart,
        calibration_chart as calibration_chart,
        closed_loop_maps as closed_loop_maps,
        closed_loop_plot as closed_loop_plot,
        follow_up_chart as follow_up_chart,
        knots_plot as knots_plot,
        loop_history_plot as loop_history_plot,
        setting_map as setting_map,
        setting_profiles as setting_profiles,
        static_error_chart as static_error_chart,
        straightness_chart as straightness_chart,
    )
    from metrosep.plot.spectra import residual_psd as residual_psd, spectrum as spectrum
    from metrosep.plot.style import (
        COLOURS as COLOURS,
        DASHED as DASHED,
        DOTTED as DOTTED,
        axes_or_new as axes_or_new,
        figure_png as figure_png,
        figure_svg as figure_svg,
        house_style as house_style,
        label_decades as label_decades,
    )
    from metrosep.plot.summary import (
        before_after as before_after,
        charts_of as charts_of,
        drawable as drawable,
        overview as overview,
        parts_plot as parts_plot,
        reversal_quartet as reversal_quartet,
        separation_parts as separation_parts,
        table_plot as table_plot,
    )
    from metrosep.plot.toolpath_chart import (
        path_error_counts as path_error_counts,
        path_error_figure as path_error_figure,
        path_error_line as path_error_line,
    )
    from metrosep.plot.wavefront_chart import (
        contrast_plot as contrast_plot,
        disc_map as disc_map,
        wavefront_map as wavefront_map,
        zernike_bars as zernike_bars,
    )

__getattr__, __dir__ = lazy_package(__name__)
