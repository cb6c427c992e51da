"""Tool settings on smooth parts, where a shift of the map is nearly a tilt and dy acts by its square.

The parts are cut here without library code: where each commanded point lands.
"""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.forms import Conic, SineGrid, Toric
from metrosep.process.tool_settings import ToolSetting, identify_setting

NM, UM = 1e-9, 1e-6
AXIS = 4e-6 * np.arange(-25, 26)
CHI2_15 = (4.0, 34.9)
"""chi-square of 15 values lies outside with a probability of 0.25 % on each side."""


def conic_height(R, k):
    def height(x, y):
        square = x**2 + y**2
        return square / R / (1 + np.sqrt(1 - (1 + k) * square / R**2))

    return height


def toric_height(Rb, Rd):
    return lambda x, y: Rb - np.sqrt((Rb - Rd + np.sqrt(Rd**2 - y**2)) ** 2 - x**2)


FORMS = {
    "sphere": (Conic(R=5e-3, k=0.0), conic_height(5e-3, 0.0)),
    "parabola": (Conic(R=5e-3, k=-1.0), conic_height(5e-3, -1.0)),
    "ellipse": (Conic(R=2e-3, k=-0.5), conic_height(2e-3, -0.5)),
    "toric": (Toric(Rb=5e-3, Rd=2.5e-3), toric_height(5e-3, 2.5e-3)),
    "flat toric": (Toric(Rb=20e-3, Rd=10e-3), toric_height(20e-3, 10e-3)),
}


def cut(height, x, y, dx=0.0, dy=0.0):
    """Heights of a part cut with a tool off by dx and dy."""
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.sqrt(rho**2 - dy**2) - dx
        azimuth = theta - (np.arcsin(dy / rho) if dy else 0.0)
    return height(r * np.cos(azimuth), r * np.sin(azimuth))


def part(height, dx=0.0, dy=0.0, *, shift=(0.0, 0.0), noise=NM, seed=0, axis=AXIS):
    x, y = np.meshgrid(axis, axis)
    z = cut(height, x - shift[0], y - shift[1], dx, dy)
    z = z + noise * np.random.default_rng(seed).standard_normal(x.shape)
    step = axis[1] - axis[0]
    return Surface(z, step, step, origin=(axis[0], axis[0]))


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("truth", [(0.0, 0.0), (-0.2e-6, 0.1e-6), (-2e-6, 1e-6)])
def test_well_and_badly_set_smooth_parts_are_found_within_their_uncertainty(name, truth):
    form, height = FORMS[name]
    truth = truth if "toric" in name else (truth[0], 0.0)
    scores = []
    for seed in range(15):
        tool = ToolSetting.identify(part(height, *truth, seed=seed), form)
        row = [(tool.dx - truth[0]) / tool.u_dx, tool.dR / tool.u_dR]
        if "toric" in name:
            row.append((tool.dy - truth[1]) / tool.u_dy)
        else:
            assert tool.u_dy == np.inf
        scores.append(row)
        assert tool.u_dx < 60 * NM
    chi2 = np.square(scores).sum(axis=0)
    assert ((chi2 > CHI2_15[0]) & (chi2 < CHI2_15[1])).all(), chi2


def test_a_shift_that_is_nearly_a_tilt_is_held_by_name():
    """34 um of shift change a sphere of 5 mm by 1 nm beyond a tilt: it is not determined."""
    form, height = FORMS["sphere"]
    found = identify_setting(part(height), form)
    assert {"shift_x", "shift_y"} <= set(found.held)
    assert any(m.startswith("shift_x") and "tilt_x" in m and "held" in m for m in found.messages)
    # A setting gives the map an apex where the spindle axis is: then the shift shows.
    shifted = identify_setting(part(height, dx=-2e-6, shift=(3e-6, -1e-6)), form)
    assert "shift_x" not in shifted.held
    for name, truth in (("dx", -2e-6), ("shift_x", 3e-6), ("shift_y", -1e-6)):
        assert abs(shifted.values[name] - truth) < 4 * shifted.u[name], name
    assert shifted.u["shift_x"] < 0.5 * UM


def test_a_large_part_still_finds_its_shift():
    """On 20 mm the shift shows well, however far: nothing is held because it is large."""
    axis = 0.5e-3 * np.arange(-40, 41)
    form, height = Toric(Rb=0.265, Rd=0.1325), toric_height(0.265, 0.1325)
    surface = part(height, 4e-6, -6e-6, shift=(80e-6, -50e-6), axis=axis, noise=2 * NM)
    found = identify_setting(surface, form, region=(0.0, 20e-3))
    assert abs(found.values["shift_x"] - 80e-6) < 4 * found.u["shift_x"]
    assert abs(found.values["shift_y"] + 50e-6) < 4 * found.u["shift_y"]
    assert abs(found.setting.dx - 4e-6) < 4 * found.setting.u_dx
    assert abs(found.setting.dy + 6e-6) < 4 * found.setting.u_dy


@pytest.mark.parametrize("noise", [0.0, 0.1 * NM])
@pytest.mark.parametrize("name", ["sphere", "flat toric"])
def test_quiet_maps_settle_too(name, noise):
    form, height = FORMS[name]
    found = identify_setting(part(height, noise=noise), form)
    assert abs(found.setting.dx) <= 4 * max(found.setting.u_dx, 1e-3 * NM)
    moved = identify_setting(part(height, dx=-1.5e-6, noise=noise), form).setting
    assert abs(moved.dx + 1.5e-6) <= 4 * max(moved.u_dx, 1e-3 * NM)


WAVE, HEIGHT = 100e-6, 50e-9
GRID = SineGrid(amplitude=HEIGHT, wavelength=WAVE)


def grid_height(x, y):
    return HEIGHT * np.sin(2 * np.pi * x / WAVE) + HEIGHT * np.cos(2 * np.pi * y / WAVE)


def one_sided(dy, noise=0.0, seed=0):
    x = np.arange(20e-6, 300e-6, 1e-6)
    z = cut(grid_height, x, 0 * x, -3.5e-6, dy)
    return Profile(x, z + noise * np.random.default_rng(seed).standard_normal(x.size))


def test_an_unseen_dy_moves_dx_by_its_square_and_its_size_is_said():
    """rho becomes sqrt(rho^2 - dy^2): the part looks cut dy^2 / (2 rho) nearer to the axis."""
    plain = identify_setting(one_sided(0.0), GRID)
    assert plain.setting.dx == pytest.approx(-3.5e-6, abs=0.01 * NM)
    assert "dy" in plain.held
    per_um = plain.audit["dx_by_1um_of_dy_nm"] * NM
    for dy in (2.5e-6, -2.5e-6, 5e-6):
        biased = identify_setting(one_sided(dy), GRID).setting.dx + 3.5e-6
        assert biased > 30 * NM
        assert per_um * (dy / UM) ** 2 == pytest.approx(biased, rel=0.1, abs=0.0)
    noisy = identify_setting(one_sided(2.5e-6, NM), GRID)
    (message,) = [m for m in noisy.messages if "square" in m]
    assert "dx" in message
    assert "1 um" in message
    assert f"{per_um / NM:.2g}"[:3] in message


def test_a_known_uncertainty_of_an_unseen_dy_enters_that_of_dx():
    for dy in (2.5e-6, -2.5e-6):
        surface = one_sided(dy, NM)
        told = identify_setting(surface, GRID, start=ToolSetting(u_dy=2.5e-6)).setting
        assert abs(told.dx + 3.5e-6) < 2 * told.u_dx
        assert told.u_dy == 2.5e-6
        assert told.dy == 0.0
    untold = identify_setting(surface, GRID).setting
    assert told.u_dx > 2 * untold.u_dx
    sure = identify_setting(surface, GRID, start=ToolSetting(u_dy=0.0)).setting
    assert sure.u_dx == pytest.approx(untold.u_dx, rel=1e-6, abs=0.0)
    # a dy known from elsewhere is modelled: no bias is left
    free = ["dx", "dR", "piston", "tilt_x"]
    start = ToolSetting(dy=5e-6, u_dy=0.1e-6)
    known = identify_setting(one_sided(5e-6), GRID, start=start, free=free)
    assert known.setting.dx == pytest.approx(-3.5e-6, abs=0.01 * NM)
    assert (known.setting.dy, known.setting.u_dy) == (5e-6, 0.1e-6)
    assert known.setting.u_dx > 5 * NM
    assert any("the 5 um it is held at" in m for m in known.messages)


@pytest.mark.parametrize("free", [None, ["dx", "dR", "piston", "tilt_x", "tilt_y"]])
def test_a_sphere_hides_dy_the_same_way(free):
    form, height = FORMS["sphere"]
    found = identify_setting(part(height, -2e-6, 0.0, noise=0.0), form, free=free)
    per_um = found.audit["dx_by_1um_of_dy_nm"] * NM
    biased = identify_setting(part(height, -2e-6, 3e-6, noise=0.0), form, free=free)
    assert per_um * 9 == pytest.approx(biased.setting.dx + 2e-6, rel=0.15, abs=0.0)
    assert any("square" in m and "dy" in m for m in biased.messages)
    # where dy is found, nothing is hidden
    form, height = FORMS["toric"]
    assert "dx_by_1um_of_dy_nm" not in identify_setting(part(height, -2e-6, 1e-6), form).audit


def test_a_dy_that_shows_but_is_not_fitted_is_said_to_act_in_proportion():
    form, height = FORMS["toric"]
    free = ["dx", "dR", "piston", "tilt_x", "tilt_y"]
    axis = 4e-6 * np.arange(-5, 46)  # lopsided, so that dy does not cancel in dx
    found = identify_setting(part(height, -2e-6, 0.0, noise=0.0, axis=axis), form, free=free)
    per_um = found.audit["dx_by_1um_of_dy_nm"] * NM
    moved = identify_setting(part(height, -2e-6, 1e-6, noise=0.0, axis=axis), form, free=free)
    assert per_um == pytest.approx(moved.setting.dx + 2e-6, rel=0.15, abs=0.0)
    assert any("it grows with dy;" in m for m in found.messages)
