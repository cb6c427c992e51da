"""Maps of parts: values, orientation, common scale, invalid pixels, null space."""

import numpy as np
import pytest

from metrosep.core.errors import DataError
from metrosep.plot.maps import separation_maps
from metrosep.separation.contract import Unobservable

PARTS = {
    "A": np.array([[5e-9, 0.0, 0.0], [0.0, np.nan, -1e-9]]),
    "B": np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -20e-9]]),
}


def images(figure):
    return [a.get_images()[0] for a in figure.axes if a.get_images() and a.get_title()]


def test_values_orientation_and_common_scale():
    figure = separation_maps(PARTS, dx=1e-3, dy=2e-3)

    a, b = images(figure)
    assert np.ma.getdata(a.get_array())[0, 0] == pytest.approx(5.0, abs=1e-9)
    assert a.origin == "lower"
    assert a.get_extent() == pytest.approx([-0.5, 2.5, -1.0, 3.0], abs=1e-12)
    assert a.get_clim() == b.get_clim() == pytest.approx((-20.0, 20.0), abs=1e-9)
    bar = figure.axes[-1]
    assert bar.get_ylabel() == "value / nm"


def test_invalid_pixels_are_masked_not_coloured():
    (a, _) = images(separation_maps(PARTS, dx=1e-3, dy=2e-3))

    assert np.ma.getmaskarray(a.get_array()).tolist() == [[False] * 3, [False, True, False]]
    red, green, blue, _ = a.cmap.get_bad()
    assert red == green == blue


def test_titles_tell_name_and_peak_to_valley():
    figure = separation_maps(PARTS, dx=1e-3, dy=2e-3, titles={"B": "plate"})

    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == ["A\nP-V 6 nm", "plate\nP-V 20 nm"]


def test_vector_parts_give_two_maps():
    figure = separation_maps({"stage": np.zeros((3, 3, 2))}, dx=None, dy=None, unit="rad")

    assert len(images(figure)) == 2
    assert figure.axes[0].get_xlabel() == "x / pixel"
    assert figure.axes[-1].get_ylabel() == "value / nrad"


def test_null_space_is_written():
    item = Unobservable("A", "term", ("twist xy",), "each line has its own slope")

    figure = separation_maps(PARTS, dx=1e-3, dy=1e-3, null_space=(item,))

    assert "twist xy" in figure.get_supxlabel()


def test_all_invalid_part_says_so():
    figure = separation_maps({"A": np.full((2, 2), np.nan)}, dx=1e-3, dy=1e-3)

    assert "not determined" in figure.axes[0].get_title()


@pytest.mark.parametrize(
    ("parts", "titles", "match"),
    [({}, None, "no part"), ({"A": np.zeros(3)}, None, "not a map"), (PARTS, ["one"], "1 titles")],
)
def test_refuses(parts, titles, match):
    with pytest.raises(DataError, match=match):
        separation_maps(parts, dx=1e-3, dy=1e-3, titles=titles)


def test_axes_begin_where_the_map_does():
    figure = separation_maps(
        {"A": np.array([[0.0, 1e-9, 2e-9]])}, dx=1e-3, dy=2e-3, origin=(-4e-3, 3e-3)
    )
    assert figure.axes[0].images[0].get_extent() == pytest.approx([-4.5, -1.5, 2.0, 4.0], abs=1e-9)
