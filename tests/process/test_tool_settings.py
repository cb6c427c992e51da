"""Tool setting: the paper's numbers, a numerical envelope of a circular nose, symmetries, refusals."""

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotConvergedError,
    UnitError,
)
from metrosep.forms import SineGrid, Sphere, Toric
from metrosep.process.setting_maps import SettingError
from metrosep.process.tool_settings import ToolSetting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
BEFORE = ToolSetting(-3.5e-6, -3.5e-6, 100e-6)
AFTER = ToolSetting(0.25e-6, 0.25e-6, 10e-6)
REGION = (5e-6, 500e-6)
LINE = np.linspace(5e-6, 500e-6, 20001)
EXACT = 1e-20
"""m: rounding of heights of 1e-7 m."""


def height(x, y):
    return A * np.sin(K * x) + A * np.cos(K * y)


def envelope(profile, at, R, dx, dR):
    """Height that a nose of radius R + dR leaves, its path made for R: a brute-force envelope.

    The nominal tool centre is found as the lowest one that does not cut below the profile, so no
    slope and no normal enter; the real nose hangs from the same tip path.
    """
    s = np.linspace(at.min() - 60e-6, at.max() + 60e-6, 60001)
    z = profile(s)

    def lowest(radius, centres, heights, where, sign):
        out = np.empty(where.size)
        for i, x in enumerate(where):
            near = np.abs(centres - x) < 25e-6
            arc = np.sqrt(radius**2 - (centres[near] - x) ** 2)
            out[i] = (heights[near] + arc).max() if sign > 0 else (heights[near] - arc).min()
        return out

    path = np.linspace(at.min() - 30e-6, at.max() + 30e-6, 3001)
    tip = lowest(R, s, z, path, 1) - R
    return lowest(R + dR, path + dx, tip + R + dR, at, -1)


@pytest.mark.parametrize(("dx", "dR"), [(0.0, 0.3e-3), (0.0, -0.3e-3), (4e-6, 0.2e-3)])
def test_the_sign_of_the_radius_error_is_that_of_a_brute_force_envelope(dx, dR):
    """Eq. (20) independently; a steep, skew section makes the error 10 nm and asymmetric."""
    form = SineGrid(amplitude=0.15e-6, wavelength=100e-6, phase_x=0.4, amplitude_y=0.0)
    at = np.linspace(100e-6, 200e-6, 41)

    found = ToolSetting(dx=dx, dR=dR).error(form, at)
    cut = envelope(form, at, 1e-3, dx, dR)

    brute = cut - form(at)
    assert np.ptp(brute) > 10 * NM
    # 10 nm steps of the path leave 0.05 nm of cusp at most
    assert np.abs(found - brute).max() < 0.1 * NM
    assert np.corrcoef(found, brute)[0, 1] > 0.9999


def test_position_errors_follow_from_where_the_tool_really_cuts():
    """Cut at commanded points, look where they land on the part, compare there."""
    rng = np.random.default_rng(3)
    r, theta = rng.uniform(20e-6, 500e-6, 2000), rng.uniform(-np.pi, np.pi, 2000)
    dx, dy = 2.5e-6, -4.5e-6
    x_machine = r + dx
    turn = np.cos(theta) + 1j * np.sin(theta)
    landed = (x_machine + 1j * dy) * turn

    error = ToolSetting(dx=dx, dy=dy).error(GRID, landed.real, landed.imag)

    cut = height(r * turn.real, r * turn.imag)
    assert np.ptp(error) > 30 * NM
    assert np.abs(height(landed.real, landed.imag) + error - cut).max() < EXACT


@pytest.mark.parametrize(
    ("tool", "line", "whole"),
    [
        (BEFORE, (21.991, 5.599, 0.4935), (31.06, 31.04, 0.985, 43.8)),
        (AFTER, (1.5708, 0.0414, 0.0493), (2.22, 2.22, 0.099, 3.15)),
    ],
)
def test_the_table_of_the_paper(tool, line, whole):
    factors = ("dx", "dy", "dR")
    for factor, expected in zip(factors, line, strict=True):
        pv = np.ptp(tool.error(GRID, LINE, exact=False, factor=factor)) / NM
        assert pv == pytest.approx(expected, abs=0.001)
    for factor, expected in zip((*factors, None), whole, strict=True):
        found = tool.error_map(GRID, region=REGION, exact=False, factor=factor)
        assert found.peak_to_valley() / NM == pytest.approx(expected, abs=0.01)


def test_the_closed_form_of_dx_on_the_line():
    assert np.ptp(ToolSetting(dx=0.25e-6).error(GRID, LINE, exact=False)) == pytest.approx(
        2 * A * K * 0.25e-6, abs=1e-6 * NM
    )
    # exact: a finite difference of the sine, 2 A sin(k dx / 2) each way
    exact = np.ptp(ToolSetting(dx=3.5e-6).error(GRID, LINE))
    assert exact == pytest.approx(4 * A * np.sin(K * 3.5e-6 / 2), abs=1e-5 * NM)


def test_dy_does_nothing_on_the_paper_line_but_acts_at_45_degrees():
    tool = ToolSetting(dy=-3.5e-6)
    diagonal = LINE / np.sqrt(2)
    assert np.ptp(tool.error(GRID, LINE[LINE > 100e-6])) < NM
    paper = tool.error(GRID, diagonal, diagonal, exact=False)
    assert np.ptp(paper) / NM == pytest.approx(23.6, abs=0.05)


def test_the_linear_formulas_are_the_first_order_of_the_exact_ones():
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-400e-6, 400e-6, (2, 500))
    far = np.hypot(x, y) > 100e-6
    x, y = x[far], y[far]
    worst = []
    for size in (1.0, 0.1):
        tool = ToolSetting(2e-6 * size, -3e-6 * size, 50e-6 * size)
        worst.append(np.abs(tool.error(GRID, x, y) - tool.error(GRID, x, y, exact=False)).max())
    assert worst[0] / worst[1] == pytest.approx(100.0, abs=15.0)
    x5, y5 = LINE / np.sqrt(2), -LINE / np.sqrt(2)
    both = ToolSetting(-3.5e-6, -3.5e-6)
    near = np.abs(both.error(GRID, x5, y5) - both.error(GRID, x5, y5, exact=False)).max()
    assert 2 * NM < near < 12 * NM


def test_a_sphere_shows_dx_as_a_cone_and_cannot_see_a_small_dy():
    R = -20e-3
    rho = np.linspace(0.1e-3, 2e-3, 50)
    e = ToolSetting(dx=1e-6).error(Sphere(R=R), rho)
    slope = rho / np.sqrt(R**2 - rho**2) * np.sign(R)
    assert np.abs(e + 1e-6 * slope).max() < 0.05 * NM
    # dy moves the radius by dy^2 / 2 rho only: 5e-10 m at 1 mm, times the slope
    second = np.abs(ToolSetting(dy=1e-6).error(Sphere(R=R), rho))
    assert 0.0 < second.max() < 0.05 * NM


def test_radius_error_of_a_sphere_is_a_sphere_of_another_radius():
    """The envelope of a larger nose on a sphere is the sphere of radius R - dR for a concave one."""
    R, dR = 10e-3, 50e-6
    rho = np.linspace(0.0, 3e-3, 40)
    e = ToolSetting(dR=dR).error(Sphere(R=R), rho)
    expected = ((R + dR) - np.sqrt((R + dR) ** 2 - rho**2)) - (R - np.sqrt(R**2 - rho**2))
    assert np.abs(e - expected).max() < 1e-6 * NM


def test_a_mirrored_part_with_mirrored_setting_has_the_mirrored_error():
    rng = np.random.default_rng(8)
    x, y = rng.uniform(20e-6, 400e-6, (2, 300))
    form = SineGrid(amplitude=A, wavelength=WAVE, phase_x=0.3, phase_y=0.9)
    mirrored = SineGrid(amplitude=A, wavelength=WAVE, phase_x=0.3, phase_y=-0.9)
    e = ToolSetting(1e-6, 2e-6, 50e-6).error(form, x, y)
    assert np.abs(e - ToolSetting(1e-6, -2e-6, 50e-6).error(mirrored, x, -y)).max() < EXACT
    assert np.abs(e - ToolSetting(1e-6, -2e-6, 50e-6).error(form, x, y)).max() > NM


def test_core_is_masked_with_a_message_and_refused_at_single_points():
    found = ToolSetting(dy=-4e-6).error_map(GRID, radius=40e-6, n_rho=41, n_theta=36)
    assert np.isnan(found.z[found.rho < 3.9e-6]).all()
    assert not np.isnan(found.z[found.rho > 4.1e-6]).any()
    assert found.n_invalid == 4 * 36
    assert "144 points" in found.messages[0]
    assert "core" in found.messages[0]
    assert np.isfinite(found.peak_to_valley())
    with pytest.raises(InvalidSamplesError, match=r"rho = 1 um .*core of radius .* 4 um"):
        ToolSetting(dy=-4e-6).error(GRID, [9e-6, 1e-6])


def test_passes_beyond_the_centre_are_said():
    said = " ".join(ToolSetting(dx=5e-6).error_map(GRID, radius=50e-6).messages)
    assert "past the centre" in said
    said = " ".join(ToolSetting(dx=-5e-6).error_map(GRID, radius=50e-6).messages)
    assert "passed twice" in said
    assert not ToolSetting(dx=-5e-6).error_map(GRID, region=(6e-6, 50e-6)).messages


def test_map_on_square_pixels_is_the_same_function():
    tool = ToolSetting(1e-6, 2e-6, 50e-6)
    square = tool.error_map(GRID, radius=200e-6, mesh="square", step=4e-6)
    outside = square.rho > 200e-6 * (1 + 1e-9)
    assert np.isnan(square.z[outside]).all()
    ok = ~np.isnan(square.z)
    assert np.abs(square.z[ok] - tool.error(GRID, square.x[ok], square.y[ok])).max() < EXACT
    surface = tool.error_map(GRID, radius=200e-6).to_surface(4e-6)
    assert surface.shape == square.z.shape
    assert surface.origin == pytest.approx((-200e-6, -200e-6), abs=1e-15)
    np.testing.assert_allclose(surface.z, square.z, rtol=0, atol=EXACT)
    assert surface.z[50, 60] == pytest.approx(tool.error(GRID, 40e-6, 0.0).item(), abs=EXACT)


def test_map_of_an_annulus_keeps_its_hole_and_weights_by_area():
    found = ToolSetting(dx=1e-6).error_map(Sphere(R=-0.1), region=(1e-3, 3e-3), n_rho=801)
    # a cone c rho on an annulus: variance of rho with weight rho
    a, b = 1e-3, 3e-3
    m1 = 2 / 3 * (b**3 - a**3) / (b**2 - a**2)
    m2 = (b**4 - a**4) / (b**2 - a**2) / 2
    assert found.rms() == pytest.approx(1e-6 / 0.1 * np.sqrt(m2 - m1**2), rel=2e-3, abs=0)
    assert np.isnan(found.to_surface(100e-6).z[30, 30])
    assert found.peak_to_valley((2e-3, 3e-3)) == pytest.approx(10 * NM, abs=0.01 * NM)


def test_uncertainty_of_the_map_is_the_scatter_of_draws():
    tool = ToolSetting(1e-6, -1e-6, 20e-6, u_dx=20e-9, u_dy=50e-9, u_dR=5e-6)
    found = tool.error_map(GRID, region=(100e-6, 300e-6), n_rho=5, n_theta=9)
    rng = np.random.default_rng(2)
    draws = [
        ToolSetting(*(tool.values + rng.standard_normal(3) * [20e-9, 50e-9, 5e-6])).error(
            GRID, found.x, found.y
        )
        for _ in range(800)
    ]
    ratio = np.std(draws, axis=0) / found.u
    assert abs(ratio.mean() - 1) < 0.05
    assert BEFORE.error_map(GRID, n_rho=3, n_theta=4).u is None


def test_audit_messages_and_default_radius():
    found = BEFORE.error_map(GRID, n_rho=5, n_theta=8)
    assert "no radius was given" in found.messages[0]
    assert found.audit["dx_um"] == pytest.approx(-3.5, abs=1e-12)
    assert found.audit["outer_um"] == pytest.approx(500.0, abs=1e-9)
    assert found.rho.shape == found.theta.shape == found.z.shape == (5, 8)
    assert not found.z.flags.writeable


def test_undefined_surface_is_nan_with_a_message_or_refused():
    ball = Sphere(R=1e-3)
    found = ToolSetting(dx=-1e-6).error_map(ball, radius=1e-3, n_rho=21, n_theta=8)
    assert any("not defined" in m for m in found.messages)
    with pytest.raises(DataError, match=r"not defined at x = 2 mm"):
        ToolSetting(dx=1e-6).error(ball, 2e-3)
    with pytest.raises(DataError, match="anywhere"):
        ToolSetting(dx=1e-6).error_map(ball, region=(2e-3, 3e-3), n_rho=4, n_theta=4)


@pytest.mark.parametrize("name", ["dx", "dy", "dR"])
@pytest.mark.parametrize("value", [3.5, -0.25, 100.0])
def test_micrometres_are_refused(name, value):
    with pytest.raises(UnitError, match=f"{name} = .* metres"):
        ToolSetting(**{name: value})
    with pytest.raises(UnitError, match="metres"):
        ToolSetting(**{f"u_{name}": abs(value)})


@pytest.mark.parametrize("value", [np.nan, np.inf, "3", None])
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(DataError, match=r"dx (must be|'3' has no unit)"):
        ToolSetting(dx=value)


def test_lengths_may_be_texts_with_their_unit():
    told = ToolSetting(dx="-3.5 um", dR="0.1 mm", u_dx="2 nm")
    assert (told.dx, told.dR, told.u_dx) == (-3.5e-6, 1e-4, 2e-9)
    small = {"n_rho": 11, "n_theta": 8}
    named, plain = (told.error_map(GRID, radius=r, **small) for r in ("0.5 mm", 5e-4))
    np.testing.assert_array_equal(named.z, plain.z)


def test_bad_input_is_named():
    with pytest.raises(DataError, match="u_dy must be zero or more"):
        ToolSetting(u_dy=-1e-9)
    with pytest.raises(InvalidSamplesError, match="3 x 3"):
        ToolSetting(cov=np.eye(2))
    with pytest.raises(DataError, match="no covariance"):
        ToolSetting(cov=1e-18 * np.array([[1, 2, 0], [2, 1, 0], [0, 0, 1]]))
    with pytest.raises(DataError, match="no value for R"):
        BEFORE.error_map(Sphere())
    with pytest.raises(DataError, match="must be a form"):
        BEFORE.error_map(lambda x, y: x)
    with pytest.raises(DataError, match="factor of the setting"):
        BEFORE.error(GRID, 1e-4, factor="dz")
    with pytest.raises(InvalidSamplesError, match="x is nan at point 1"):
        BEFORE.error(GRID, [1e-4, np.nan])
    with pytest.raises(DataError, match="either a radius or a region"):
        BEFORE.error_map(GRID, radius=1e-3, region=(0, 1e-3))
    for radius in (0.0, -1.0, np.nan):
        with pytest.raises(DataError, match=r"0 <= inner < outer|outer radius .* got nan"):
            BEFORE.error_map(GRID, radius=radius)
    with pytest.raises(DataError, match="polar"):
        BEFORE.error_map(GRID, mesh="hexagonal")
    with pytest.raises(DataError, match="n_rho"):
        BEFORE.error_map(GRID, n_rho=1)
    with pytest.raises(DataError, match="step"):
        BEFORE.error_map(GRID, mesh="square", step=1.0)
    with pytest.raises(DataError, match="coarser"):
        BEFORE.error_map(GRID, mesh="square", step=1e-9)


def test_a_nose_error_beyond_the_curvature_is_refused():
    steep = SineGrid(amplitude=5e-6, wavelength=100e-6)
    with pytest.raises(NotConvergedError, match="gouges"):
        ToolSetting(dR=-2e-3).error_map(steep, n_rho=50, n_theta=36)


def test_other_forms_and_integer_positions():
    toric = Toric(Rb=0.265, Rd=0.1325)
    found = ToolSetting(2e-6, 3e-6, 10e-6).error_map(toric, radius=20e-3, n_rho=41, n_theta=72)
    assert 0.1e-6 < found.peak_to_valley() < 2e-6
    assert ToolSetting(dx=1e-6).error(Sphere(R=-0.5), [0, 0], [0, 0]).shape == (2,)


def test_map_object_refuses_wrong_shapes_and_regions():
    z = np.zeros((2, 3))
    with pytest.raises(InvalidSamplesError, match="shape"):
        SettingError(z, z, np.zeros((3, 2)), "polar")
    found = SettingError(z + 1, z, z, "polar")
    with pytest.raises(DataError, match="no model"):
        found.to_surface()
    with pytest.raises(DataError, match="pair"):
        found.peak_to_valley(3.0)
    assert np.isnan(found.peak_to_valley((0.2, 0.3)))
    assert np.isnan(found.rms((0.2, 0.3)))
    assert "SettingError(polar 2 x 3" in repr(found)
