"""Heights of the view in three dimensions: no extreme is lost, and they lie where the map has them."""

import numpy as np
import pytest

from metrosep.app.map_views import relief_view
from metrosep.core.errors import DataError
from metrosep.core.surface import Surface

UM, NM = 1e-6, 1e-9


def reference() -> np.ndarray:
    """Return reference map 1 of the specification: one pixel of 1.2 um among waves of 3 nm."""
    j, i = np.mgrid[:480, :640]
    z = 3 * NM * np.sin(2 * np.pi * i / 64) * np.cos(2 * np.pi * j / 96)
    z[313, 427] += 1.2 * UM
    z[10:20, 600:640] = np.nan
    return z


def test_a_defect_of_one_pixel_is_drawn_as_high_as_it_is() -> None:
    z = reference()
    header, shown = relief_view(Surface(z + 0.05, UM, 2 * UM, origin=(7 * UM, 3 * UM)), side=223)
    assert shown.shape == (160, 214)
    assert header["step"] == pytest.approx([3 * UM, 6 * UM], abs=1e-18)
    highest = np.unravel_index(np.nanargmax(shown), shown.shape)
    assert highest == (313 // 3, 427 // 3)
    mean = np.nanmean(z)
    # a float32 of 1.2 um is good to 6e-14 m, and 50 mm of piston leave 7e-18 m of rounding
    assert float(shown[highest]) == pytest.approx(np.nanmax(z) - mean, abs=1e-13)
    x, y = (header["origin"][k] + header["step"][k] * highest[1 - k] for k in (0, 1))
    assert x == pytest.approx(7 * UM + 427 * UM, abs=1.01 * UM)  # within its block of 3 pixels
    assert y == pytest.approx(3 * UM + 313 * 2 * UM, abs=2.01 * UM)


def test_what_was_not_measured_stays_so() -> None:
    z = reference()
    _, shown = relief_view(Surface(z, UM, UM), side=640)
    np.testing.assert_array_equal(np.isnan(shown), np.isnan(z))


def test_a_relief_of_nothing_and_of_no_size_is_refused() -> None:
    with pytest.raises(DataError, match="nothing measured"):
        relief_view(Surface(np.full((9, 9), np.nan), UM, UM))
    for side in (True, 5, 1e3, 5000):
        with pytest.raises(DataError, match="whole number"):
            relief_view(Surface(np.zeros((9, 9)), UM, UM), side=side)
