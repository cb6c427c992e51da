"""Distribution of heights and waves in all directions, against the closed forms of the specification."""

import math

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.app.field_views import (
    aperture_of,
    distribution,
    extremes_near,
    heights_view,
    waves_view,
)
from metrosep.core.errors import DataError, TooFewSamplesError

UM, NM = 1e-6, 1e-9


def wave(holes: bool = False) -> Surface:
    """Return the map of C-7; its wave runs to +x and +y, not to +x and -y."""
    j, i = np.mgrid[:192, :256]
    z = 10 * NM * np.cos(2 * np.pi * (12 * i / 256 + 9 * j / 192) + 0.3)
    if holes:
        z[60:64, 100:120] = np.nan
    return Surface(z, UM, 1.5 * UM)


def test_material_ratios_of_a_sine_are_those_of_the_closed_form():
    n = 400_000
    z = 5 * NM * np.sin(2 * np.pi * (np.arange(n) + 0.5) / n) + 3.0 * UM
    found = distribution(Profile(np.arange(n) * UM, z))
    header, arrays = heights_view(found, [2.5 * NM, 4 * NM])
    # Mr = arccos(c / A) / pi (C-6); one sample of 400 000 is 0.00025 %
    assert header["ratios"] == pytest.approx([1 / 3, 0.204833], abs=5e-6)
    assert header["mean"] == pytest.approx(3.0 * UM, abs=1e-15)
    usual, _ = heights_view(found, None)
    assert usual["at"][0] == pytest.approx(4.75528 * NM, abs=1e-14)  # c(10 %)
    assert arrays["curve"][0] == 1.0
    assert (np.diff(arrays["curve"]) <= 0).all()  # less material the higher
    assert arrays["shares"].sum() + header["below"] + header["above"] == pytest.approx(
        1.0, abs=1e-12
    )


@pytest.mark.parametrize("at", [[1e-9], "x", [math.nan, 0.0], [1, 2, 3]])
def test_wrong_heights_are_refused(at):
    with pytest.raises((DataError, ValueError)):
        heights_view(distribution(wave()), at)


def test_a_flat_map_has_no_distribution():
    with pytest.raises(TooFewSamplesError):
        distribution(Surface(np.zeros((9, 9)), UM, UM))


def test_the_strongest_wave_has_its_length_direction_and_amplitude():
    header, arrays = waves_view(wave())
    assert header["peak"]["wavelength"] == pytest.approx(17.7504063 * UM, abs=1e-13)
    assert math.degrees(header["peak"]["direction"]) == pytest.approx(33.6900675, abs=1e-6)
    assert header["amplitude"] == pytest.approx(10 * NM, abs=1e-4 * NM)  # the plane takes a little
    # the largest fy is row 0: the wave and its image lie upper right and lower left
    index, (x0, y0, x1, y1) = arrays["index"], header["window"]
    rows, columns = np.nonzero(index == 255)
    fx = x0 + (columns + 0.5) / index.shape[1] * (x1 - x0)
    fy = y1 - (rows + 0.5) / index.shape[0] * (y1 - y0)
    assert sorted(np.round(fx)) == [-46875.0, 46875.0]
    assert (np.sign(fx) == np.sign(fy)).all()
    assert header["notes"] == ["Hann window, plane removed"]


def test_waves_of_a_map_without_scale_are_in_pixels():
    header, _ = waves_view(Surface(wave().z))
    # 12 waves on 256 columns and 9 on 192 rows: 3/64 per pixel along both
    assert header["unit"] == "px"
    assert header["peak"]["wavelength"] == pytest.approx(64 / 3 / math.sqrt(2), abs=1e-9)
    assert math.degrees(header["peak"]["direction"]) == pytest.approx(45.0, abs=1e-9)
    assert header["amplitude"] == pytest.approx(10 * NM, abs=1e-4 * NM)
    assert waves_view(wave())[0]["unit"] == "m"


def test_gaps_are_filled_for_the_picture_and_their_share_is_said():
    header, _ = waves_view(wave(holes=True))
    assert "not measured" in header["notes"][1]
    assert header["peak"]["wavelength"] == pytest.approx(17.7504063 * UM, abs=1e-13)
    assert header["amplitude"] == pytest.approx(10 * NM, abs=0.05 * NM)


def test_a_large_map_is_averaged_and_the_shortest_wave_is_said():
    i = np.arange(2200)
    z = np.tile(7 * NM * np.cos(2 * np.pi * i / 110), (64, 1))
    header, _ = waves_view(Surface(z, UM, UM))
    assert header["peak"]["wavelength"] == pytest.approx(110 * UM, abs=0.2 * UM)
    assert "3 × 3 pixels; waves from 6 um on" in header["notes"][1]


def test_peak_and_valley_near_a_point_and_the_aperture():
    z = np.zeros((50, 80))
    z[20, 30], z[22, 34], z[5, 5] = 3.0, -2.0, 99.0
    surface = Surface(z, UM, 2 * UM, origin=(100 * UM, 0.0))
    peak, valley = extremes_near(surface, [131 * UM, 41 * UM], 8 * UM)
    assert peak == pytest.approx([130 * UM, 40 * UM], abs=1e-12)
    assert valley == pytest.approx([134 * UM, 44 * UM], abs=1e-12)
    assert extremes_near(surface, [0.0, 0.0], UM) == (None, None)  # beside the map
    (x, y), radius = aperture_of(surface)
    assert (x, y) == pytest.approx((139.5 * UM, 49 * UM), abs=1e-12)
    assert radius == pytest.approx(39.5 * UM, abs=1e-12)  # the shorter half: x
