"""Maps of flats: the drawn values, the steps, the null space said once."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.maps import flat_maps
from metrosep.separation.maps.flats import three_flat
from metrosep.separation.maps.rotations import rotation_average

X = np.linspace(-1, 1, 33)
GX, GY = np.meshgrid(X, X)
A, B, C = 20e-9 * GX**3 * GY, 9e-9 * (GX**2 - GY**2), 7e-9 * GX * GY**2
READINGS = [A + np.fliplr(B), A + np.fliplr(C), B + np.fliplr(C), np.rot90(A, -1) + np.fliplr(B)]


def drawn(figure):
    return {a.get_title().split("\n")[0]: a.get_images()[0] for a in figure.axes if a.get_title()}


def test_maps_are_the_parts_in_millimetres():
    result = three_flat(*READINGS[:3], READINGS[3], np.pi / 2, dx=1e-3)
    images = drawn(flat_maps(result))

    assert list(images) == ["A", "B", "C"]
    for name, image in images.items():
        values = np.ma.getdata(image.get_array())
        limit = image.get_clim()[1]
        assert values.max() <= limit
        scale = values[4, 7] / result.parts[name][4, 7]
        assert scale == pytest.approx(1e9, rel=1e-9, abs=0.0)
        assert image.origin == "lower"
        assert image.get_extent() == pytest.approx([-0.5, 32.5, -0.5, 32.5], abs=1e-9)


def test_null_space_is_said_once_for_all_flats():
    result = three_flat(*READINGS[:3], READINGS[3], np.pi / 2, dx=1e-3)
    text = flat_maps(result).get_supxlabel()

    assert text.count("angular orders 4, 8, 12") == 1
    assert "A, B, C" in text
    assert "tilt x" in text


def test_diameter_alone_and_uncertainty_and_pixels():
    result = three_flat(*READINGS[:3], u_reading=1e-9)
    figure = flat_maps(result, parts=["A", "even_A"], uncertainty=True)
    images = drawn(figure)

    assert list(images) == ["u(A)", "u(even_A)"]
    mask = np.ma.getmaskarray(images["u(A)"].get_array())
    assert mask.sum() == 33 * 32
    assert figure.axes[0].get_xlabel() == "x / pixel"


def test_rotation_test_is_drawn():
    turned = [np.rot90(A, -k) + C for k in range(4)]
    result = rotation_average(turned, np.radians([0, 90, 180, 270]), dx=1e-3)
    assert list(drawn(flat_maps(result))) == ["part", "instrument", "unseparated"]


def test_unknown_parts_are_refused():
    result = three_flat(*READINGS[:3])
    with pytest.raises(DataError, match="no map 'diameter_A'"):
        flat_maps(result, parts=["diameter_A"])
    with pytest.raises(DataError, match="no map 'D'"):
        flat_maps(result, parts=["D"])
