"""Maps: signs and orientation against planted asymmetric errors, closed forms, what is refused."""

import json

import numpy as np
import pytest

from metrosep import Surface
from metrosep.compensation.area_errors import ErrorMap, bilinear
from metrosep.compensation.limits import Limits
from metrosep.compensation.maps import CompensationMap
from metrosep.core.provenance import Step
from metrosep.errors import (
    DataError,
    InvalidSamplesError,
    LimitError,
    TableError,
    UnitError,
)

ROUND = 1e-20
"""Rounding of heights of 1 um in double precision, with a margin of a hundred."""
PM = 1e-13
"""The fixed point stops at 0.1 pm."""
X = np.linspace(0.0, 80e-3, 9)
Y = np.linspace(-30e-3, 30e-3, 7)


def lopsided(x, y):
    """Nothing about it is symmetric: not in x, not in y, not under their exchange."""
    return 1e-5 * x - 3e-5 * y + 2e-3 * x * y + 4e-4 * x * x + 5e-6


def bump(x, y):
    return 2e-6 * np.exp(-(((x - 50e-3) / 15e-3) ** 2) - ((y + 8e-3) / 9e-3) ** 2)


def by_hand(grid_x, grid_y, values, x, y):
    """Bilinear lookup of one place with loops and no library code; clamped outside."""
    x = min(max(x, grid_x[0]), grid_x[-1])
    y = min(max(y, grid_y[0]), grid_y[-1])
    for i in range(len(grid_x) - 1):
        for j in range(len(grid_y) - 1):
            if grid_x[i] <= x <= grid_x[i + 1] and grid_y[j] <= y <= grid_y[j + 1]:
                s = (x - grid_x[i]) / (grid_x[i + 1] - grid_x[i])
                t = (y - grid_y[j]) / (grid_y[j + 1] - grid_y[j])
                low = (1 - s) * values[j][i] + s * values[j][i + 1]
                high = (1 - s) * values[j + 1][i] + s * values[j + 1][i + 1]
                return (1 - t) * low + t * high
    raise AssertionError


def made(error=lopsided, **options):
    return CompensationMap.from_error(error, **{"x": X, "y": Y} | options)


def test_entries_are_the_negated_error_about_the_reference():
    table = made()

    assert table.values.shape == (7, 9)
    assert table.reference == (0.0, 0.0)
    assert table.offset_removed == pytest.approx(5e-6, abs=ROUND)
    for j, y in enumerate(Y):
        for i, x in enumerate(X):
            assert table.values[j, i] == pytest.approx(5e-6 - lopsided(x, y), abs=ROUND)
    assert table.values[3, 0] == 0.0
    assert not table.is_on_axis
    assert not table.is_exact_inverse


def test_rows_are_y_and_columns_x_as_in_a_surface():
    surface = Surface(
        [[0.0, 1e-6], [0.0, 3e-6], [0.0, 7e-6]], dx=10e-3, dy=5e-3, origin=(0.0, 0.0)
    )
    table = CompensationMap.from_error(surface)

    assert table.x.tolist() == [0.0, 10e-3]
    assert table.y.tolist() == [0.0, 5e-3, 10e-3]
    assert table.correction(10e-3, 10e-3)[0] == pytest.approx(-7e-6, abs=ROUND)
    assert table.correction(0.0, 10e-3)[0] == 0.0


def test_lookup_is_bilinear_and_clamped():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(5, 4)) * 1e-6
    gx, gy = np.array([-1e-3, 0.0, 4e-3, 5e-3]), np.array([0.0, 1e-3, 5e-3, 6e-3, 20e-3])
    table = CompensationMap(gx, gy, values)
    px, py = rng.uniform(-3e-3, 8e-3, 200), rng.uniform(-5e-3, 30e-3, 200)

    found = table.correction(px, py)

    assert found == pytest.approx(
        [by_hand(gx, gy, values, x, y) for x, y in zip(px, py, strict=True)], abs=ROUND
    )
    assert np.array_equal(table.correction(gx, gy[:, None]), values)
    assert np.array_equal(table.correction(px, py, -1), found)
    assert np.isnan(table.correction(np.nan, 0.0)[0])


def test_interpolation_error_of_a_parabola():
    """Between nodes h apart a x^2 is missed by a h^2 / 4 in the middle; a x y not at all."""
    table = made(lambda x, y: 4e-4 * x * x)
    assert table.interpolation_error == pytest.approx(4e-4 * 10e-3**2 / 4, abs=ROUND)
    both = made(lambda x, y: 4e-4 * x * x + 4e-4 * y * y)
    assert both.interpolation_error == pytest.approx(2 * 4e-4 * 10e-3**2 / 4, abs=ROUND)
    assert made(lambda x, y: 1e-3 * x * y).interpolation_error == pytest.approx(0.0, abs=ROUND)


def test_interpolation_error_of_a_surface_is_exact():
    """One pixel of 1 um between the nodes of the map: it misses all of it."""
    z = np.zeros((9, 9))
    z[3, 5] = 1e-6
    table = CompensationMap.from_error(Surface(z, dx=1e-3, dy=1e-3), x="2 mm", y="2 mm")
    assert table.values.shape == (5, 5)
    assert table.interpolation_error == pytest.approx(1e-6, abs=ROUND)
    assert table.limits()[0].level == "warning"


def test_reference_elsewhere_and_mean_is_kept():
    table = made(lambda x, y: np.full(np.shape(x), 3e-6))
    assert table.stroke == 0.0
    assert table.offset_removed == 3e-6

    other = made(reference=(80e-3, -30e-3))
    assert other.values[0, -1] == 0.0
    assert other.offset_removed == pytest.approx(lopsided(80e-3, -30e-3), abs=ROUND)
    assert abs(other.values.mean()) > 1e-7

    between = made(reference=(12e-3, 3e-3))
    assert between.correction(12e-3, 3e-3)[0] == pytest.approx(0.0, abs=ROUND)


@pytest.mark.parametrize(("axis", "along"), [("X", 0), ("Y", 1)])
def test_on_axis_map_is_the_exact_inverse_along_its_axis(axis, along):
    steep = made(lambda x, y: 300 * bump(x, y), compensates=axis)
    x, y = np.meshgrid(X, Y)
    moved = (x + steep.values, y) if along == 0 else (x, y + steep.values)

    zero = 300 * bump(0.0, 0.0)
    inside = (moved[0] <= X[-1]) & (moved[1] >= Y[0]) & (moved[0] >= 0) & (moved[1] <= Y[-1])
    rest = 300 * bump(*moved) - zero + steep.values

    assert steep.is_on_axis
    assert steep.is_exact_inverse
    assert inside.sum() > 40
    assert np.abs(rest[inside]).max() < PM
    plain = made(lambda x, y: 300 * bump(x, y), compensates=axis, exact=False)
    moved = (x + plain.values, y) if along == 0 else (x, y + plain.values)
    assert np.abs(300 * bump(*moved) - zero + plain.values)[inside].max() > 1e-6
    assert plain.exact_inverse().is_exact_inverse
    assert plain.exact_inverse().exact_inverse().values.shape == (7, 9)


def test_third_axis_needs_no_inverse():
    table = made()
    assert table.exact_inverse() is table


def test_border_of_zeros_with_free_spacing():
    table = made(border="zero", u=1e-8)
    assert table.values.shape == (9, 11)
    assert np.array_equal(table.values[1:-1, 1:-1], made().values)
    for edge in (table.values[0], table.values[-1], table.values[:, 0], table.values[:, -1]):
        assert not edge.any()
    assert table.x[0] == pytest.approx(-10e-3, abs=ROUND * 1e6)
    assert table.y[-1] == pytest.approx(40e-3, abs=ROUND * 1e6)
    assert table.inner_span == ((0.0, 80e-3), (-30e-3, 30e-3))
    assert table.correction(1.0, 1.0)[0] == 0.0
    assert np.isnan(table.u[0]).all()
    assert (table.u[1:-1, 1:-1] == 1e-8).all()
    assert table.to_dict()["u_m"][0][0] is None


def test_sources_of_all_kinds_agree():
    x, y = np.meshgrid(X, Y)
    z = lopsided(x, y)
    surface = Surface(z, dx=10e-3, dy=10e-3, origin=(0.0, -30e-3))
    wanted = made().values
    for table in (
        CompensationMap.from_error(surface),
        CompensationMap.from_error(ErrorMap(X, Y, z)),
        CompensationMap.from_error(z, x=X, y=Y),
        CompensationMap.from_error(z.tolist(), x=X.tolist(), y=Y.tolist()),
        CompensationMap.from_error(surface, x="10 mm", y=7),
    ):
        assert table.values == pytest.approx(wanted, abs=ROUND * 100)


def test_rotary_axis_in_degrees():
    angle = np.radians(np.arange(0, 361, 10.0))
    grid = ErrorMap(angle, X, 1e-6 * np.cos(angle) * np.ones((9, 1)))
    table = CompensationMap.from_error(grid, x="30 deg", axes=("C", "X"), compensates="Z")
    assert table.x.size == 13
    assert table.correction(np.pi, 0.0)[0] == pytest.approx(2e-6, abs=ROUND * 100)
    assert "C = 0 deg" in repr(table)
    with pytest.raises(UnitError):
        CompensationMap.from_error(grid, x="30 mm", axes=("C", "X"))


def test_result_is_frozen_and_input_untouched():
    z = np.zeros((7, 9))
    z[0, 0] = 1e-6
    kept = z.copy()
    table = CompensationMap.from_error(z, x=X, y=Y, reference=(0.0, 0.0))
    assert np.array_equal(z, kept)
    for array in (table.x, table.y, table.values):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_history_and_hash_travel():
    surface = Surface(
        np.zeros((3, 3)), dx=1e-3, dy=1e-3, history=(Step("read", {"sha256": "ab"}),)
    )
    table = CompensationMap.from_error(surface)
    assert table.source_sha256 == ("ab",)
    assert [s.name for s in table.history] == ["read", "map"]
    assert json.loads(json.dumps(table.to_dict(), allow_nan=False))["compensates"] == "Z"


def test_slopes_add_up_in_speed_and_twist_in_acceleration():
    """c = a x y: at the corner |c_x| vx + |c_y| vy = a (y vx + x vy); acceleration 2 a vx vy."""
    a, vx, vy = 1e-3, 0.05, 0.02
    table = made(lambda x, y: a * x * y, x=[0.0, 0.05, 0.1], y=[0.0, 0.1, 0.2])
    speed = a * (0.2 * vx + 0.1 * vy)
    feeds = {"X": vx, "Y": vy}

    assert not table.limits(Limits(velocity_share=speed * 1.001), feeds=feeds)
    found = table.limits(Limits(velocity_share=speed * 0.999), feeds=feeds)
    assert [f.level for f in found] == ["error"]
    bound = 2 * a * vx * vy
    assert not table.limits(Limits(acceleration_share=bound * 1.001), feeds=feeds)
    with pytest.raises(LimitError, match="accelerates"):
        table.require_limits(Limits(acceleration_share=bound * 0.999), feeds=feeds)
    assert not table.limits(feed=vy, velocity_share=a * 0.3 * vy * 1.001)
    assert table.limits(feed=vy, velocity_share=a * 0.3 * vy * 0.999)


def test_bending_along_one_axis_in_acceleration():
    """c = a y^2: curvature 2 a, acceleration 2 a vy^2; X does not bend it."""
    table = made(lambda x, y: 4e-4 * y * y)
    feeds = {"X": 1.0, "Y": 0.1}
    assert not table.limits(Limits(acceleration_share=2 * 4e-4 * 0.01 * 1.001), feeds=feeds)
    assert table.limits(Limits(acceleration_share=2 * 4e-4 * 0.01 * 0.999), feeds=feeds)


def test_limits_of_points_stroke_slope():
    table = made(lambda x, y: 5e-3 * y)
    assert not table.limits(max_points=63)[1:]
    assert "63 points" in table.limits(max_points=62)[0].problem
    assert table.limits(stroke=1.4e-4)[0].level == "error"
    assert "along Y" in table.limits()[0].problem
    falls = CompensationMap([0, 1e-3], [0, 1e-3], [[0, -1.1e-3], [0, 0]], compensates="X")
    assert "turns back" in falls.limits()[0].problem
    turned = made(axes=("C", "X"), x=[0.0, 1.0], y=[0.0, 0.1])
    assert "feed is not known" in turned.limits(feed=0.1, velocity_share=1.0)[1].problem
    with pytest.raises(DataError, match="feeds name 'Q'"):
        table.limits(Limits(velocity_share=1.0), feeds={"Q": 1.0})


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"x": [0.0, 0.0, 1.0]}, TableError, "rise strictly"),
        ({"x": [0.0]}, TableError, "at least 2"),
        ({"x": [0.0, np.nan]}, TableError, "finite"),
        ({"x": "5 mm"}, TableError, "range is not known"),
        ({"x": None}, TableError, "range is not known"),
        ({"axes": ("X", "X")}, TableError, "two axes"),
        ({"axes": "XY"}, TableError, "two axes"),
        ({"axes": ("X",)}, TableError, "two axes"),
        ({"compensates": " "}, TableError, "must name an axis"),
        ({"reference": (1.0, 0.0)}, TableError, "lies outside"),
        ({"reference": (np.nan, 0.0)}, TableError, "give a position"),
        ({"reference": 0.0}, TableError, "position of each axis"),
        ({"axes": None}, TableError, "two axes"),
        ({"x": [0.0, 1j]}, TableError, "real numbers"),
        ({"border": "one"}, TableError, "border="),
        ({"removed": "line"}, TableError, "removed="),
        ({"u": [1.0, 2.0]}, TableError, "u has shape"),
        ({"u": -1e-9}, TableError, "not negative"),
        ({"u": np.inf}, InvalidSamplesError, "infinite"),
    ],
)
def test_bad_options_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        made(**options)


@pytest.mark.parametrize(
    ("source", "options", "error", "message"),
    [
        (Surface(np.zeros((3, 3))), {}, DataError, "not calibrated"),
        (np.zeros((3, 3)), {}, DataError, "does not say where"),
        (np.zeros((9, 7)), {"x": X, "y": Y}, TableError, "transpose"),
        ("map", {}, DataError, "str"),
        (lambda x, y: np.zeros(3), {"x": X, "y": Y}, DataError, "shape"),
        (lambda x, y: 1j * x, {"x": X, "y": Y}, DataError, "real numbers"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": [0.0, 3e-3]}, TableError, "extrapolated"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": "3 mm"}, TableError, "at most"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": "1"}, UnitError, "unit"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": "1e-6 mm"}, TableError, "check the unit"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": 1}, TableError, "needs 2"),
        (Surface(np.zeros((3, 3)), 1e-3, 1e-3), {"x": 5e-3}, TableError, "count"),
        (lambda x, y: 2.0 * x, {"x": X, "y": Y, "compensates": "X"}, TableError, "turn back"),
    ],
)
def test_bad_sources_are_refused(source, options, error, message):
    with pytest.raises(error, match=message):
        CompensationMap.from_error(source, **options)


def test_a_gap_is_refused_with_its_place_and_never_filled():
    z = np.zeros((5, 5))
    z[1, 3] = np.nan
    surface = Surface(z, dx=1e-3, dy=1e-3)
    with pytest.raises(TableError, match="X = 3 mm, Y = 1 mm"):
        CompensationMap.from_error(surface, x=[0.0, 4e-3], y=[0.0, 4e-3])
    assert CompensationMap.from_error(surface, y=[2e-3, 3e-3, 4e-3]).values.shape == (3, 5)
    with pytest.raises(TableError, match="not known"):
        CompensationMap.from_error(surface, x=[0.0, 2.5e-3], y=[0.0, 4e-3])
    with pytest.raises(TableError, match="not known"):
        made(lambda x, y: np.where(x > 75e-3, np.nan, x))


def test_values_are_checked():
    with pytest.raises(TableError, match="exchanged"):
        CompensationMap(X, Y, np.zeros((9, 7)))
    with pytest.raises(TableError, match="X = 10 mm, Y = -30 mm is NaN"):
        CompensationMap(X, Y, np.where(np.arange(63).reshape(7, 9) == 1, np.nan, 0.0))
    with pytest.raises(InvalidSamplesError):
        CompensationMap(X, Y, np.full((7, 9), np.inf))
    with pytest.raises(TableError, match="reference"):
        CompensationMap(X, Y, np.zeros((7, 9)), reference=(0.0,))
    with pytest.raises(DataError, match="direction"):
        made().correction(0.0, 0.0, 0)
    with pytest.raises(DataError, match="broadcast"):
        made().correction([0.0, 1.0], [0.0, 1.0, 2.0])


def test_integers_are_numbers():
    table = CompensationMap([0, 1], [0, 2], [[0, 0], [0, 1]])
    assert table.correction(1, 1).tolist() == [0.5]


def test_corner_without_weight_does_not_count():
    grid = np.array([0.0, 1.0])
    values = np.array([[1.0, np.nan], [2.0, 3.0]])
    assert bilinear(grid, grid, values, 0.0, 0.5).tolist() == [1.5]
    assert np.isnan(bilinear(grid, grid, values, 0.5, 0.5)[0])


def test_repr_for_people():
    assert "9 columns x 7 rows" in repr(made())
    assert "added to the command" in made()._repr_html_()
    assert "not measured" in repr(made().source)


def parabola(x, y):
    return 1e-3 * x**2 + 0 * y


def test_a_reference_that_is_no_node_is_zero_where_a_third_axis_is_corrected():
    assert made(parabola, reference=(45e-3, 0.0)).correction(45e-3, 0.0)[0] == pytest.approx(
        0.0, abs=ROUND
    )


def test_a_reference_that_is_no_node_of_an_inverted_map_is_reported_with_its_amount():
    """0.1 x^2 at 40 and 50 mm is -+45 um about the chord at 45 mm, slopes 8e-3 and 1e-2.

    To second order c = -E + E E', so halfway (-45 um * 8e-3 + 45 um * 1e-2)/2 = 45 nm are left.
    """
    steep = lambda x, y: 100 * parabola(x, y)  # noqa: E731
    between = made(steep, compensates="X", reference=(45e-3, 0.0))
    node = made(steep, compensates="X", reference=(40e-3, 0.0))

    there = between.correction(45e-3, 0.0)[0]
    assert there == pytest.approx(45e-9, abs=1.5e-9)  # third order: E E' times 2 %
    (finding,) = (f for f in between.limits() if f.check == "reference")
    assert finding.level == "warning"
    assert f"X = 45 mm, Y = 0 mm is {there * 1e9:.3g} nm, not zero" in finding.problem
    assert "make the reference a node" in finding.fix
    assert "reference" not in [f.check for f in node.limits()]


@pytest.mark.parametrize("name", ["X\nM30", "X\x00", " ", ""])
def test_axes_that_cannot_be_printed_are_refused(name):
    with pytest.raises(TableError, match="axes are the names"):
        CompensationMap([0, 1], [0, 1], np.zeros((2, 2)), axes=(name, "Y"))
    with pytest.raises(TableError, match="compensates must name an axis"):
        CompensationMap([0, 1], [0, 1], np.zeros((2, 2)), compensates=name)
