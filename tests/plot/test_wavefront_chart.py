"""What the figures of a wavefront show."""

from __future__ import annotations

import numpy as np
import pytest

from metrosep.errors import DataError
from metrosep.forms import Plane, Toric
from metrosep.optics import wavefront
from metrosep.plot.wavefront_chart import contrast_plot, disc_map, wavefront_map, zernike_bars

PAPER = Toric(Rb=265e-3, Rd=132.5e-3)


def test_map_draws_the_path_difference_in_its_unit():
    front = wavefront(PAPER, radius=10e-3, samples=(20, 36)).remove(["piston", "defocus"])
    axes = wavefront_map(front)
    assert axes.get_xlabel() == "x / mm"
    assert "without piston, defocus" in axes.get_title()
    drawn = axes.collections[0].get_array()
    assert float(np.max(drawn)) == pytest.approx(1e6 * float(np.nanmax(front.opd)), abs=1e-9)


def test_map_puts_plus_x_to_the_right():
    x, y = np.meshgrid([0.0, 1e-3, 2e-3], [0.0, 1e-3])
    z = np.array([[0.0, 0.0, 5e-9], [0.0, 0.0, np.nan]])
    axes = disc_map(x, y, z)
    drawn = axes.collections[0].get_array()
    assert drawn[0, 2] == pytest.approx(5.0, abs=1e-12)
    assert axes.get_title() == "P-V 5 nm"


def test_bars_are_the_coefficients():
    front = wavefront(PAPER, radius=10e-3, samples=(40, 72))
    table = front.zernike(6)
    axes = zernike_bars({"ideal": table, "again": table})
    heights = [bar.get_height() for bar in axes.containers[0]]
    assert heights == pytest.approx([1e6 * v for v in table.values()[1:]], abs=1e-9)
    assert axes.get_ylabel() == "coefficient / µm"
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["ideal", "again"]


def test_contrast_of_a_plane_lies_on_the_ideal_line():
    transfer = wavefront(Plane(), radius=5e-3).point_spread(633e-9, pad=2).modulation_transfer()
    axes = contrast_plot(transfer)
    along_x, _, ideal = axes.lines
    at_half = np.interp(0.5, along_x.get_xdata(), along_x.get_ydata())
    assert at_half == pytest.approx(np.interp(0.5, ideal.get_xdata(), ideal.get_ydata()), abs=5e-3)


def test_refusals():
    table = wavefront(PAPER, radius=10e-3, samples=(20, 36))
    with pytest.raises(DataError, match="different terms"):
        zernike_bars({"a": table.zernike(6), "b": table.zernike(5)})
    with pytest.raises(DataError, match="no table"):
        zernike_bars({})
    with pytest.raises(DataError, match="nothing to draw"):
        disc_map(*(np.full((2, 2), np.nan),) * 3)
    with pytest.raises(DataError, match="one shape"):
        disc_map(np.zeros(3), np.zeros(3), np.zeros(3))
