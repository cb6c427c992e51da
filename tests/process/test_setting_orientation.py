"""What a map read the other way round, or a period away, does to the sign and size of a setting.

The parts are cut here without library code: where each commanded point lands.
"""

import numpy as np
import pytest

from metrosep import Surface
from metrosep.core.errors import NotConvergedError
from metrosep.forms import PointSet, Polynomial, SineGrid, Sphere, Toric
from metrosep.process.tool_settings import identify_setting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
AXIS = 6e-6 * np.arange(-42, 43) + 1e-6
"""Off by a micrometre: no pixel on the spindle axis, and no row its own mirror."""
TRUTH = (-2e-6, 1.5e-6)


def grid_height(x, y):
    return A * np.sin(K * x) + A * np.cos(K * y)


def toric_height(x, y, Rb=5e-3, Rd=2.5e-3):
    return Rb - np.sqrt((Rb - Rd + np.sqrt(Rd**2 - y**2)) ** 2 - x**2)


def saddle_height(x, y):
    """The same with x and y exchanged, not with one of them reversed."""
    return 30.0 * x * y


def lopsided_height(x, y):
    """The same under no mirror of the axes: x, y and the diagonals are all told apart."""
    return 20.0 * x**2 + 12.0 * x * y + 35.0 * y**2


SADDLE = Polynomial(2, coefficients=[[0.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, 0.0]])
LOPSIDED = Polynomial(2, coefficients=[[0.0, 0.0, 35.0], [0.0, 12.0, 0.0], [20.0, 0.0, 0.0]])


def part(height, dx, dy, *, shift=(0.0, 0.0), noise=NM, seed=0, axis=AXIS):
    x, y = np.meshgrid(axis, axis)
    px, py = x - shift[0], y - shift[1]
    rho, theta = np.hypot(px, py), np.arctan2(py, px)
    with np.errstate(invalid="ignore"):
        r, azimuth = np.sqrt(rho**2 - dy**2) - dx, theta - np.arcsin(dy / rho)
    z = height(r * np.cos(azimuth), r * np.sin(azimuth))
    return z + noise * np.random.default_rng(seed).standard_normal(x.shape)


def as_map(z, axis=AXIS, origin=None):
    step = axis[1] - axis[0]
    return Surface(z, step, step, origin=(axis[0], axis[0]) if origin is None else origin)


def said(found, words):
    return [m for m in found.messages if words in m]


@pytest.mark.parametrize(
    ("form", "height"), [(GRID, grid_height), (Toric(Rb=5e-3, Rd=2.5e-3), toric_height)]
)
def test_rows_in_the_other_order_turn_the_sign_of_dy_and_this_is_always_said(form, height):
    z = part(height, *TRUTH)
    right = identify_setting(as_map(z), form)
    turned = identify_setting(as_map(z[::-1], origin=(AXIS[0], -AXIS[-1])), form)
    assert right.setting.dy == pytest.approx(1.5e-6, abs=0.05 * UM)
    assert turned.setting.dy == pytest.approx(-1.5e-6, abs=0.05 * UM)
    assert turned.setting.dx == pytest.approx(right.setting.dx, abs=1e-3 * NM)
    # nothing else tells the one from the other
    assert turned.rms == pytest.approx(right.rms, rel=1e-9, abs=0.0)
    for found in (right, turned):
        (message,) = said(found, "the sign of dy rests on the orientation of the map")
        assert "rows" in message
        assert "-dy" in message


def test_columns_and_the_diagonal_are_tried_too():
    z = part(toric_height, *TRUTH)
    mirrored = identify_setting(
        as_map(z[:, ::-1], origin=(-AXIS[-1], AXIS[0])), Toric(Rb=5e-3, Rd=2.5e-3)
    )
    assert mirrored.setting.dy == pytest.approx(-1.5e-6, abs=0.05 * UM)
    assert "columns" in said(mirrored, "the sign of dy rests")[0]

    z = part(saddle_height, *TRUTH)
    right, exchanged = (identify_setting(as_map(v), SADDLE) for v in (z, z.T))
    assert right.setting.dy == pytest.approx(1.5e-6, abs=0.05 * UM)
    assert exchanged.setting.dy == pytest.approx(-1.5e-6, abs=0.05 * UM)
    assert "transposed" in said(right, "the sign of dy rests")[0]
    assert "in the other order" not in said(right, "the sign of dy rests")[0]


def test_a_form_without_a_mirror_and_one_without_dy_are_not_doubted():
    z = part(lopsided_height, *TRUTH)
    found = identify_setting(as_map(z), LOPSIDED)
    assert found.setting.dy == pytest.approx(1.5e-6, abs=0.05 * UM)
    assert not said(found, "the sign of dy rests")
    with pytest.raises(NotConvergedError, match="mirrored"):
        identify_setting(as_map(z[::-1], origin=(AXIS[0], -AXIS[-1])), LOPSIDED)

    R = 20e-3
    z = part(lambda x, y: R - np.sqrt(R**2 - x**2 - y**2), -2e-6, 0.0)
    assert not said(identify_setting(as_map(z), Sphere(R=R)), "the sign of dy rests")


@pytest.mark.parametrize(
    "shift",
    [
        (60e-6, -5e-6),
        pytest.param((-55e-6, 58e-6), marks=pytest.mark.slow),
        (130e-6, 8e-6),
    ],
)
def test_a_shift_into_another_period_is_found(shift):
    """A grid one period on is the same grid, but the apex of the setting is not there."""
    found = identify_setting(as_map(part(grid_height, -3.5e-6, 2.5e-6, shift=shift)), GRID)
    assert found.values["shift_x"] == pytest.approx(shift[0], abs=0.1 * UM)
    assert found.values["shift_y"] == pytest.approx(shift[1], abs=0.1 * UM)
    assert abs(found.setting.dx + 3.5e-6) < 4 * found.setting.u_dx
    assert abs(found.setting.dy - 2.5e-6) < 4 * found.setting.u_dy
    assert abs(found.setting.dR) < 4 * found.setting.u_dR
    assert found.rms < 1.1 * NM
    assert said(found, "shifted by")


@pytest.mark.slow
def test_a_corner_of_a_map_without_an_origin_finds_the_axis_outside():
    """Its middle is taken for the axis, a period and a half off along both."""
    axis = 4e-6 * np.arange(75) + 3e-6
    z = part(grid_height, -3.5e-6, 2.5e-6, axis=axis)
    step = axis[1] - axis[0]
    found = identify_setting(Surface(z, step, step), GRID)
    middle = float(axis.mean())
    assert found.values["shift_x"] == pytest.approx(-middle, abs=0.3 * UM)
    assert found.values["shift_y"] == pytest.approx(-middle, abs=0.3 * UM)
    assert abs(found.setting.dx + 3.5e-6) < 4 * found.setting.u_dx
    assert abs(found.setting.dy - 2.5e-6) < 4 * found.setting.u_dy
    assert said(found, "shifted by")


def test_scattered_points_find_their_period_too():
    rng = np.random.default_rng(8)
    x, y = rng.uniform(-250e-6, 250e-6, (2, 5000))
    px, py = x - 60e-6, y + 5e-6
    rho, theta = np.hypot(px, py), np.arctan2(py, px)
    keep = rho > 5e-6
    x, y, rho, theta = x[keep], y[keep], rho[keep], theta[keep]
    r, azimuth = np.sqrt(rho**2 - (2e-6) ** 2) + 3e-6, theta - np.arcsin(2e-6 / rho)
    z = grid_height(r * np.cos(azimuth), r * np.sin(azimuth)) + NM * rng.standard_normal(x.size)
    found = identify_setting(PointSet(x, y, z), GRID)
    assert abs(found.setting.dx + 3e-6) < 4 * found.setting.u_dx
    assert found.values["shift_x"] == pytest.approx(60e-6, abs=0.1 * UM)


def test_a_well_set_grid_stays_in_its_period():
    found = identify_setting(as_map(part(grid_height, 0.0, 0.0)), GRID)
    assert abs(found.values["shift_x"]) < 0.05 * UM
    assert abs(found.setting.dx) < 4 * found.setting.u_dx
    assert not said(found, "another period")
