"""Figures of tool-path errors: the data drawn, their place, signs and labels."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.toolpath_chart import path_error_counts, path_error_figure, path_error_line
from metrosep.process.path_points import SpiralPath, errors_by_count

NM = 1e-9


def form(x, y):
    """Waves on the right side, more of them at the top: tells x from y and left from right."""
    return 50e-9 * np.sin(2 * np.pi * x / 60e-6) * np.exp((2 * x + y) / 150e-6)


@pytest.fixture(scope="module")
def made():
    return SpiralPath(150e-6, 2e-6, "CA", math.radians(9), "linear").error_map(form)


def test_maps_share_a_scale_and_name_their_paths(made):
    fine = SpiralPath(150e-6, 2e-6, "CAL", 5e-6).error_map(form)

    figure = path_error_figure([made, fine], n_pixels=61)

    first, second = (a.get_images()[0] for a in figure.axes[:2])
    assert first.get_clim() == second.get_clim()
    assert first.get_clim()[0] == -first.get_clim()[1]
    assert figure.axes[-1].get_ylabel() == "path - ideal / nm"
    title = figure.axes[0].get_title()
    assert title.startswith("CA 9°, 3000 points, linear\nP-V ")
    assert float(title.split()[-2]) == pytest.approx(made.peak_to_valley() / NM, abs=0.5)
    assert "CAL 5 µm" in figure.axes[1].get_title()


def test_map_is_the_right_way_round(made):
    figure = path_error_figure([made], n_pixels=61)

    image = figure.axes[0].get_images()[0]
    drawn = image.get_array()
    assert image.origin == "lower"
    assert image.get_extent() == pytest.approx([-152.5, 152.5, -152.5, 152.5], abs=1e-9)
    assert np.ma.getmaskarray(drawn)[0, 0]
    size = np.abs(drawn)
    assert size[:, 31:].mean() > 3 * size[:, :30].mean()
    assert size[31:].mean() > 1.3 * size[:30].mean()
    expected = made.to_surface(61).z / NM
    kept = np.isfinite(expected)
    assert np.abs(np.ma.getdata(drawn)[kept] - expected[kept]).max() < 1e-9


def test_line_has_both_halves(made):
    axes = path_error_line(made, azimuth=math.radians(4.5))

    (line,) = axes.get_lines()
    x, z = line.get_xdata(), line.get_ydata()
    assert x[0] < -140.0
    assert x[-1] > 140.0
    assert (np.diff(x) > 0.0).all()
    half = made.line(math.radians(4.5))
    assert z[-half.z.size :] == pytest.approx(half.z / NM, abs=1e-9)
    assert "4.5°" in axes.get_xlabel()
    assert axes.get_ylabel() == "path - ideal / nm"


def test_four_curves_against_the_count():
    curves = errors_by_count(form, 150e-6, 5e-6, [1200, 600, 2400], annulus=(20e-6, None))

    axes = path_error_counts(curves, tolerance=1e-9)

    *lines, tolerance = axes.get_lines()
    assert [line.get_label() for line in lines] == [
        "CA, linear",
        "CA, spline",
        "CAL, linear",
        "CAL, spline",
    ]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == 4
    assert lines[0].get_xdata().tolist() == [600, 1200, 2400]
    direct = SpiralPath.with_points(150e-6, 5e-6, 2400, distribution="CAL").error_map(form)
    expected = direct.peak_to_valley(annulus=(20e-6, None)) / NM
    assert lines[3].get_ydata()[2] == pytest.approx(expected, abs=1e-9)
    assert list(tolerance.get_ydata()) == [1.0, 1.0]
    assert axes.get_xscale() == axes.get_yscale() == "log"
    assert axes.get_legend() is not None


def test_refuses_nothing():
    with pytest.raises(DataError, match="no map"):
        path_error_figure([])
    with pytest.raises(DataError, match="no curve"):
        path_error_counts([])
    with pytest.raises(DataError, match="no count"):
        errors_by_count(form, 150e-6, 5e-6, [])
