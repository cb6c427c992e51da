"""Figures show the numbers of the document, with units, and leave gaps where nothing was measured."""

import matplotlib as mpl
import matplotlib.figure
import numpy as np
import pytest
from matplotlib.colors import to_hex

from metrosep.core.errors import DataError
from metrosep.plot import (
    before_after,
    drawable,
    figure_png,
    figure_svg,
    overview,
    residual_psd,
    spectrum,
    table_plot,
)

EXACT = 1e-9  # in the unit of the axis: only rounding of a factor lies between document and axis


def _lines(ax, start):
    return [line for line in ax.lines if str(line.get_label()).startswith(start)]


def test_the_estimates_on_the_axes_are_those_of_the_document(document):
    ax = before_after(document)

    for way in document["plots"]["directions"]:
        (line,) = _lines(ax, f"estimate, {way['direction']}")
        np.testing.assert_allclose(line.get_xdata(), document["plots"]["x_mm"], rtol=0, atol=EXACT)
        np.testing.assert_allclose(line.get_ydata(), way["estimate_nm"], rtol=0, atol=EXACT)


def test_the_band_is_two_standard_uncertainties_wide(mean_document):
    plots = mean_document["plots"]
    i = 300

    ax = before_after(mean_document)

    (band,) = [c for c in ax.collections if len(c.get_paths()[0].vertices) > 10]
    vertices = band.get_paths()[0].vertices
    at = vertices[np.abs(vertices[:, 0] - plots["x_mm"][i]) < EXACT, 1]
    width = at.max() - at.min()
    assert plots["sd_nm"][i] > 1.0
    assert abs(width - 4.0 * plots["sd_nm"][i]) < EXACT


def test_every_feed_is_drawn_before_and_after(document):
    ax = before_after(document)

    drawn = [np.asarray(line.get_ydata()) for line in ax.lines]
    for feed in document["plots"]["feeds"]:
        for key in ("before_nm", "after_nm"):
            wanted = np.array(feed[key])
            assert any(d.shape == wanted.shape and np.abs(d - wanted).max() < EXACT for d in drawn)
    assert len(_lines(ax, "before, ")) == len(
        {f["feed_mm_min"] for f in document["plots"]["feeds"]}
    )


def test_not_measured_stays_a_gap(document):
    feed = document["plots"]["feeds"][0]
    feed["before_nm"][10:20] = [None] * 10

    ax = before_after(document)

    gaps = [np.isnan(line.get_ydata()).sum() for line in _lines(ax, "before, ")]
    assert sorted(gaps) == [0, 0, 10]


def test_the_guard_zones_are_outside_the_evaluation_range(document):
    plots = document["plots"]

    ax = before_after(document)

    zones = [p for p in ax.patches if p.get_width() > 0]
    edges = sorted((p.get_x(), p.get_x() + p.get_width()) for p in zones)
    wanted = [
        (plots["fit_low_mm"], plots["start_mm"]),
        (plots["stop_mm"], plots["fit_high_mm"]),
    ]
    np.testing.assert_allclose(edges, wanted, rtol=0, atol=EXACT)


def test_a_large_error_is_drawn_in_micrometres(mean_document):
    plots = mean_document["plots"]
    plots["estimate_nm"] = [v if v is None else 100.0 * v for v in plots["estimate_nm"]]
    plots["directions"] = []

    ax = before_after(mean_document)

    (line,) = _lines(ax, "estimate")
    assert ax.get_ylabel().endswith("/ µm")
    np.testing.assert_allclose(
        line.get_ydata(), np.array(plots["estimate_nm"]) / 1e3, rtol=0, atol=EXACT
    )


def test_runs_without_a_feedrate_say_so(mean_document):
    for feed in mean_document["plots"]["feeds"]:
        feed["feed_mm_min"] = None
    spectra = mean_document["estimate"]["feed_spectra"]
    spectra["feed_mm_min"] = [None] * len(spectra["feed_mm_min"])

    assert _lines(before_after(mean_document), "before, feedrate not known")
    assert _lines(spectrum(mean_document), "readings, feedrate not known")


def test_filled_markers_are_the_selected_wavelengths(document):
    table = document["estimate"]["spectrum"]

    ax = spectrum(document)

    rows = zip(
        table["direction"],
        table["wavelength_mm"],
        table["amplitude_nm"],
        table["selected"],
        strict=True,
    )
    wanted = sorted((w, a) for d, w, a, chosen in rows if chosen and d == "forward")
    (line,) = _lines(ax, "selected, forward")
    assert sorted(zip(line.get_xdata(), line.get_ydata(), strict=True)) == wanted
    assert to_hex(line.get_markerfacecolor()) == "#0072b2"
    assert _lines(ax, "not selected, forward")[0].get_markerfacecolor() == "none"


def test_a_vibration_slides_with_the_feedrate(document):
    ax = spectrum(document)

    peaks = {}
    for line in _lines(ax, "readings, "):
        x, y = line.get_data()
        short = np.asarray(x) < 2.0
        speed = float(line.get_label().split()[1])
        peaks[speed] = np.asarray(x)[short][np.argmax(np.asarray(y)[short])]
    hertz = [speed / 60.0 / wavelength for speed, wavelength in peaks.items()]
    assert len(peaks) == 3
    assert min(hertz) > 140.0
    assert max(hertz) < 160.0


def test_the_wavelength_axis_is_logarithmic(document):
    assert spectrum(document).get_xscale() == "log"


def test_the_psd_names_its_strongest_peak(document):
    ax = residual_psd(document)

    (label,) = [t.get_text() for t in ax.texts]
    number, unit = label.split()
    assert unit == "Hz"
    assert 145.0 < float(number) < 155.0
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


def test_the_psd_shows_measurement_and_model(document):
    table = document["estimate"]["residual_psd"]

    ax = residual_psd(document)

    frequency = np.array(table["frequency_hz"])
    way = np.array(table["direction"])
    for name in ("forward", "reverse"):
        keep = (frequency > 0.0) & (way == name)
        (measured,) = _lines(ax, f"measured, {name}")
        (model,) = _lines(ax, f"noise model, {name}")
        for line, key in ((measured, "psd_nm2_per_hz"), (model, "model_nm2_per_hz")):
            np.testing.assert_allclose(
                line.get_ydata(), np.array(table[key])[keep], rtol=0, atol=EXACT
            )


def test_the_table_is_drawn_with_its_sign(document):
    table = document["table"]

    ax = table_plot(document)

    for way in ("forward", "reverse"):
        (line,) = _lines(ax, f"correction, {way}")
        wanted = np.array(table[f"{way}_m"]) * 1e9
        np.testing.assert_allclose(line.get_ydata(), wanted, rtol=0, atol=EXACT)
    x = np.array(document["plots"]["x_mm"])
    e_20 = np.interp(20.0, x, document["plots"]["directions"][0]["estimate_nm"])
    c_20 = np.interp(
        20.0, np.array(table["positions_m"]) * 1e3, np.array(table["forward_m"]) * 1e9
    )
    c_25 = np.interp(
        25.0, np.array(table["positions_m"]) * 1e3, np.array(table["forward_m"]) * 1e9
    )
    e_25 = np.interp(25.0, x, document["plots"]["directions"][0]["estimate_nm"])
    assert np.sign(c_25 - c_20) == -np.sign(e_25 - e_20)


@pytest.mark.parametrize(
    ("draw", "x_unit", "y_unit"),
    [
        (before_after, "/ mm", "/ nm"),
        (spectrum, "/ mm", "/ nm"),
        (residual_psd, "/ Hz", "/ (nm²/Hz)"),
        (table_plot, "/ mm", "/ nm"),
    ],
)
def test_labels_carry_quantity_and_unit(document, draw, x_unit, y_unit):
    ax = draw(document)

    assert ax.get_xlabel().endswith(x_unit)
    assert ax.get_ylabel().endswith(y_unit)
    assert len(ax.get_ylabel()) > len(y_unit) + 3


@pytest.mark.parametrize("draw", [before_after, spectrum, residual_psd, table_plot])
def test_nothing_to_draw_is_an_error(draw):
    with pytest.raises(DataError, match="nothing to draw"):
        draw({"plots": None, "estimate": None, "table": None})


@pytest.mark.parametrize("draw", [before_after, spectrum, residual_psd, table_plot])
def test_axes_that_are_given_are_used(document, draw):
    from matplotlib.figure import Figure

    ax = Figure().add_subplot()

    assert draw(document, ax) is ax


def test_drawable_names_what_the_document_holds(document, mean_document):
    assert list(drawable(document)) == [
        "before_after",
        "spectrum",
        "residual_psd",
        "left_out_plot",
        "table_plot",
    ]
    assert list(drawable(mean_document)) == ["before_after", "spectrum", "table_plot"]
    assert drawable({"schema": "metrosep.result/1"}) == {}


def test_every_method_gives_an_overview(plain_document):
    assert len(overview(plain_document).axes) == 2


def test_the_overview_without_spectra_has_one_panel(mean_document):
    mean_document["estimate"]["feed_spectra"] = None

    assert len(overview(mean_document).axes) == 1


@pytest.mark.parametrize("draw", [before_after, spectrum, residual_psd, table_plot, overview])
def test_the_same_document_gives_the_same_bytes(document, draw):
    assert figure_svg(draw, document) == figure_svg(draw, document)


def test_png_bytes_are_stable_and_a_png(document):
    first, second = figure_png(table_plot, document), figure_png(table_plot, document)

    assert first == second
    assert first.startswith(b"\x89PNG")


def test_settings_of_the_user_change_nothing_and_stay(document):
    plain = figure_svg(table_plot, document)

    with mpl.rc_context({"font.size": 30.0, "svg.hashsalt": "x", "lines.linewidth": 9.0}):
        assert figure_svg(table_plot, document) == plain
        assert mpl.rcParams["font.size"] == 30.0


def test_no_legend_covers_the_curves(document):
    drawn = {name: draw(document) for name, draw in drawable(document).items()}
    assert isinstance(drawn.pop("left_out_plot"), mpl.figure.Figure)  # strips, without a legend
    for ax in drawn.values():
        ax.figure.canvas.draw()
        legend, inside = ax.get_legend().get_window_extent(), ax.get_window_extent()
        figure = ax.figure.bbox
        assert legend.y0 >= inside.y1 - 1.0
        assert legend.x0 >= figure.x0
        assert legend.x1 <= figure.x1 + 1.0
        assert legend.y1 <= figure.y1 + 1.0


def test_drawing_does_not_change_the_document(document):
    before = repr(document)

    for draw in drawable(document).values():
        draw(document)

    assert repr(document) == before
