"""Figures of a tool setting: the drawn lines and maps are the errors, in the units on the axes."""

import math

import numpy as np
import pytest

from metrosep.core.errors import DataError, InvalidSamplesError
from metrosep.forms import SineGrid
from metrosep.plot.servo_chart import setting_map, setting_profiles
from metrosep.process.setting_maps import SettingError
from metrosep.process.tool_settings import ToolSetting

GRID = SineGrid(amplitude=50e-9, wavelength=100e-6)
BEFORE = ToolSetting(-3.5e-6, -3.5e-6, 100e-6)
AFTER = ToolSetting(0.25e-6, 0.25e-6, 10e-6)


def test_profiles_are_the_errors_in_nanometres():
    figure = setting_profiles(BEFORE, GRID, after=AFTER, radius=400e-6, azimuth=math.pi / 4)
    assert [a.get_title(loc="left") for a in figure.axes] == [
        "dx", "dy", "dR", "all three together",
    ]  # fmt: skip
    rho = figure.axes[0].lines[0].get_xdata() * 1e-6
    assert rho[[0, -1]] == pytest.approx([4e-6, 400e-6], abs=1e-12)
    x = rho / math.sqrt(2)
    for axes, factor in zip(figure.axes, ("dx", "dy", "dR", None), strict=True):
        for line, tool in zip(axes.lines, (BEFORE, AFTER), strict=False):
            expected = tool.error(GRID, x, x, factor=factor) * 1e9
            assert np.abs(line.get_ydata() - expected).max() < 1e-9
    assert "azimuth 45°" in figure.axes[3].get_xlabel()
    assert "nm" in figure.get_supylabel()


def test_legends_carry_value_and_peak_to_valley():
    figure = setting_profiles(BEFORE, GRID, exact=False, inner=5e-6)
    texts = [a.get_legend().get_texts()[0].get_text() for a in figure.axes]
    assert texts[0] == "dx = -3.5 µm, P-V 22 nm"
    assert texts[2] == "dR = 100 µm, P-V 493 pm"


def test_lines_that_are_empty_or_begin_in_the_core_are_refused():
    with pytest.raises(DataError, match="is empty"):
        setting_profiles(BEFORE, GRID, inner=1e-3)
    with pytest.raises(InvalidSamplesError, match="core"):
        setting_profiles(BEFORE, GRID, inner=1e-6)


@pytest.mark.parametrize("mesh", ["polar", "square"])
def test_map_has_the_values_at_their_places(mesh):
    error = BEFORE.error_map(GRID, radius=200e-6, mesh=mesh, n_rho=41, n_theta=72, step=5e-6)
    axes = setting_map(error, title="before")
    drawn = axes.collections[0]
    values = np.ma.masked_invalid(drawn.get_array()).compressed()
    assert np.ptp(values) == pytest.approx(error.peak_to_valley() * 1e9, abs=1e-9)
    low, high = drawn.get_clim()
    assert low == -high
    assert high == pytest.approx(np.nanmax(np.abs(error.z)) * 1e9, abs=1e-9)
    assert axes.get_title().startswith("before\nP-V 4")
    assert axes.get_figure().axes[1].get_ylabel() == "error = actual − nominal / nm"


def test_polar_map_is_closed_and_not_mirrored():
    error = ToolSetting(dx=1e-6).error_map(GRID, radius=100e-6, n_rho=5, n_theta=8)
    mesh = setting_map(error).collections[0]
    values = np.asarray(mesh.get_array()).reshape(5, 9)
    assert values[:, 0] == pytest.approx(values[:, 8], abs=0.0)
    corners = mesh.get_coordinates()
    # azimuth 90 degrees, outermost: up
    assert np.asarray(corners[4, 2]).tolist() == pytest.approx([0.0, 100.0], abs=1e-9)
    assert values[4, 2] == pytest.approx(error.z[4, 2] * 1e9, abs=1e-12)


def test_large_parts_are_in_millimetres_and_empty_maps_are_refused():
    big = SineGrid(amplitude=5e-6, wavelength=20e-3)
    error = ToolSetting(dx=200e-6).error_map(big, radius=20e-3, n_rho=11, n_theta=12)
    axes = setting_map(error)
    assert axes.get_xlabel() == "x / mm"
    nothing = np.full((2, 2), np.nan)
    with pytest.raises(DataError, match="nothing to draw"):
        setting_map(SettingError(np.ones((2, 2)), np.ones((2, 2)), nothing, "polar"))
