"""Feedforward: apply the error to the corrected path, written here, and nothing must remain."""

import numpy as np
import pytest

from metrosep import Surface
from metrosep.core.errors import DataError, InvalidSamplesError, NotConvergedError
from metrosep.forms import SineGrid, Sphere, Toric
from metrosep.process.feedforward import CorrectedPath, corrected_path, corrected_points
from metrosep.process.tool_settings import ToolSetting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
NOTHING = 1e-6 * NM
"""The bound of the specification; rounding of 1e-7 m is 1e-23 m."""


def spiral(n=20001, outer=500e-6, inner=10e-6, feed=2e-6):
    rho = np.linspace(outer, inner, n)
    return rho, 2 * np.pi * (outer - rho) / feed


def height(x, y):
    return A * np.sin(K * x) + A * np.cos(K * y)


def landed(rho, theta, dx, dy):
    """Where a tool off by dx, dy cuts on the part, as complex numbers."""
    return (rho + dx + 1j * dy) * np.exp(1j * theta)


def residual(path, dx, dy):
    at = landed(path.rho, path.theta, dx, dy)
    return path.z - height(at.real, at.imag)


def test_nothing_remains_of_dx_and_dy():
    rho, theta = spiral()
    path = corrected_path(GRID, ToolSetting(-3.5e-6, -3.5e-6), rho, theta)
    assert np.abs(residual(path, -3.5e-6, -3.5e-6)).max() < NOTHING
    assert np.ptp(path.change) > 40 * NM
    at = landed(rho, theta, -3.5e-6, -3.5e-6)
    assert np.abs(path.cut_rho - np.abs(at)).max() < 1e-18
    turned = np.exp(1j * path.cut_theta) - at / np.abs(at)
    assert np.abs(turned).max() < 1e-12


def test_the_flipped_sign_doubles_the_error():
    rho, theta = spiral(inner=20e-6)
    truth = (-1.5e-6, 0.8e-6)
    plain = corrected_path(GRID, ToolSetting(), rho, theta)
    assert np.abs(plain.change).max() == 0.0
    flipped = corrected_path(GRID, ToolSetting(1.5e-6, -0.8e-6), rho, theta)
    before, after = (np.ptp(residual(p, *truth)) for p in (plain, flipped))
    assert before > 10 * NM
    assert after / before == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_every_sign_of_both_factors_is_inverted(signs):
    rho, theta = spiral(2001, inner=20e-6)
    dx, dy = 2e-6 * signs[0], 5e-6 * signs[1]
    path = corrected_path(GRID, ToolSetting(dx, dy), rho, theta)
    assert np.abs(residual(path, dx, dy)).max() < NOTHING


def section(azimuth, setting, x):
    path = corrected_path(GRID, setting, x, np.full(x.size, azimuth))
    return path.z


def test_all_three_factors_against_the_envelope_of_the_commanded_section():
    """Each spindle angle cuts a plane section; its normal comes from differences here."""
    setting = ToolSetting(-3.5e-6, 2.5e-6, 0.4e-3)
    rng = np.random.default_rng(6)
    for azimuth in rng.uniform(-3, 3, 4):
        rho, h = np.linspace(20e-6, 400e-6, 301), 20e-9
        z = section(azimuth, setting, rho)
        slope = (section(azimuth, setting, rho + h) - section(azimuth, setting, rho - h)) / (2 * h)
        phi = np.arctan(slope)
        reached = landed(rho + 0.4e-3 * np.sin(phi), azimuth, -3.5e-6, 2.5e-6)
        cut = z + 0.4e-3 * (1 - np.cos(phi))
        assert np.abs(cut - height(reached.real, reached.imag)).max() < 1e-5 * NM


def lowest(radius, centres, heights, where, sign):
    """Brute-force rolling: the lowest centre over a profile, or the envelope under the centres."""
    out = np.empty(where.size)
    for i, x in enumerate(where):
        near = np.abs(centres - x) < 25e-6
        arc = np.sqrt(radius**2 - (centres[near] - x) ** 2)
        out[i] = (heights[near] + arc).max() if sign > 0 else (heights[near] - arc).min()
    return out


def test_a_corrected_path_cut_by_the_larger_nose_by_brute_force():
    """No slope and no normal: roll the programmed nose over the command, cut with the real one."""
    form = SineGrid(amplitude=0.1e-6, wavelength=100e-6, phase_x=0.4, amplitude_y=0.0)
    R, dR, dx = 1e-3, 0.3e-3, 4e-6
    s = np.linspace(40e-6, 260e-6, 44001)
    command = corrected_path(form, ToolSetting(dx=dx, dR=dR), s, np.zeros(s.size)).z
    centres = np.linspace(70e-6, 230e-6, 3201)
    tip = lowest(R, s, command, centres, 1) - R
    at = np.linspace(100e-6, 200e-6, 41)
    cut = lowest(R + dR, centres + dx, tip + R + dR, at, -1)
    # the 50 nm steps of the path leave cusps of 3e-13 m, the steps of s sag by 1e-12 m
    assert np.abs(cut - form(at)).max() < 0.02 * NM
    uncorrected = ToolSetting(dx=dx, dR=dR).error(form, at)
    assert np.abs(uncorrected).max() > 15 * NM


def test_identified_setting_is_inverted_by_the_error_model_of_the_library():
    """The same model forwards: what is commanded, cut, and then compared with `error`."""
    toric, setting = Toric(Rb=0.265, Rd=0.1325), ToolSetting(4e-6, -6e-6)
    rho, theta = spiral(501, 20e-3, 1e-3, 0.5e-3)
    plain = toric(rho * np.cos(theta), rho * np.sin(theta))
    at = landed(rho, theta, 4e-6, -6e-6)
    expected = plain - toric(at.real, at.imag)
    assert np.abs(setting.error(toric, at.real, at.imag) - expected).max() < 1e-16
    path = corrected_path(toric, setting, rho, theta)
    assert np.abs(path.change + expected).max() < 1e-16


def test_residual_of_a_setting_known_to_u():
    """6.283 nm per um: 0.05 um leave 0.31 nm P-V on the line."""
    rho = np.linspace(5e-6, 500e-6, 20001)
    setting = ToolSetting(-3.5e-6, u_dx=0.05e-6)
    path = corrected_path(GRID, setting, rho, 0 * rho)
    assert path.residual_pv["dx"] == pytest.approx(2 * A * K * 0.05e-6, abs=1e-4 * NM)
    assert path.residual_pv["dx"] / NM == pytest.approx(0.314, abs=0.001)
    assert path.residual_pv["rss"] == path.residual_pv["dx"]
    # applied with a truth that is one u away
    assert np.ptp(residual(path, -3.45e-6, 0.0)) == pytest.approx(
        path.residual_pv["dx"], rel=0.01, abs=0
    )


def test_u_along_the_path_is_the_scatter_of_true_settings():
    rho, theta = spiral(41, 300e-6, 100e-6)
    u = (0.05e-6, 0.1e-6)
    path = corrected_path(GRID, ToolSetting(-3.5e-6, 2e-6, u_dx=u[0], u_dy=u[1]), rho, theta)
    rng = np.random.default_rng(4)
    draws = [
        residual(path, -3.5e-6 + u[0] * rng.standard_normal(), 2e-6 + u[1] * rng.standard_normal())
        for _ in range(4000)
    ]
    assert np.abs(np.std(draws, axis=0) / path.u - 1).max() < 0.06


def test_unknown_uncertainty_and_the_core_are_said():
    rho, theta = spiral(101)
    path = corrected_path(GRID, ToolSetting(1e-6, 2e-6), rho, theta)
    assert path.u is None
    assert not path.residual_pv
    assert any("not predicted" in m for m in path.messages)
    assert any("nothing within rho = 2 um" in m for m in path.messages)
    lost = corrected_path(GRID, ToolSetting(1e-6, u_dx=1e-9, u_dy=np.inf), rho, theta)
    assert any("dy is not determined" in m for m in lost.messages)
    bowl = corrected_path(
        Sphere(R=10e-3), ToolSetting(1e-6, u_dx=1e-9, u_dy=np.inf), rho, 0 * theta
    )
    assert bowl.residual_pv["dy"] == 0.0


def test_bad_paths_are_refused():
    with pytest.raises(InvalidSamplesError, match="rho is nan at point 1"):
        corrected_path(GRID, ToolSetting(), [1e-4, np.nan], [0, 0])
    with pytest.raises(InvalidSamplesError, match="equally long"):
        corrected_path(GRID, ToolSetting(), [1e-4, 2e-4], [0])
    with pytest.raises(DataError, match=r"not defined where point 1 is cut, rho = 10\.02 mm"):
        corrected_path(Sphere(R=10e-3), ToolSetting(dx=20e-6), [9e-3, 10e-3], [0, 0])
    with pytest.raises(DataError, match="must be a ToolSetting"):
        corrected_path(GRID, (1e-6, 0, 0), [1e-4], [0])
    steep = SineGrid(amplitude=10e-6, wavelength=100e-6)
    with pytest.raises(NotConvergedError, match="smaller nose"):
        corrected_path(steep, ToolSetting(dR=5e-3), *spiral(500))
    with pytest.raises(InvalidSamplesError, match="equally long"):
        CorrectedPath([0, 1], [0], [0], [0], [0], [0], [0])


def test_integers_and_one_point_are_taken_and_nothing_is_mutated():
    rho, theta = np.array([1e-4, 2e-4]), np.array([0, 1])
    path = corrected_path(GRID, ToolSetting(dx=1e-6), rho, theta)
    assert path.z.shape == (2,)
    assert not path.z.flags.writeable
    assert rho.flags.writeable
    assert corrected_path(GRID, ToolSetting(dx=1e-6), 1e-4, 0).z.shape == (1,)


def volumetric(x, y, z):
    """A skew machine: squareness, straightness with a period, positioning; 20 um over 0.3 m."""
    return (
        5e-6 * np.sin(2 * np.pi * x / 20e-3) + 30e-6 * y,
        -20e-6 * x + 2e-6 * np.cos(2 * np.pi * z / 10e-3),
        8e-6 * np.sin(2 * np.pi * x / 15e-3 + 1) + 50e-6 * z,
    )


def volume(n=500):
    return np.random.default_rng(9).uniform(-0.15, 0.15, (n, 3))


def test_points_reach_their_target_when_the_error_is_applied():
    wanted = volume()
    found = corrected_points(volumetric, wanted)
    reached = found.command + np.stack(volumetric(*found.command.T), axis=1)
    assert np.abs(reached - wanted).max() < 1e-12
    assert found.steps > 1
    assert 0.0 < found.contraction < 0.01
    assert not found.messages
    # one step, the usual negative, misses by what the error is at the wrong place
    once = wanted - np.stack(volumetric(*wanted.T), axis=1)
    left = once + np.stack(volumetric(*once.T), axis=1) - wanted
    assert np.abs(left).max() > 5 * NM


def test_the_flipped_sign_doubles_the_volumetric_error():
    wanted = volume()
    wrong = corrected_points(lambda x, y, z: tuple(-e for e in volumetric(x, y, z)), wanted)
    before = np.stack(volumetric(*wanted.T), axis=1)
    after = wrong.command + np.stack(volumetric(*wrong.command.T), axis=1) - wanted
    assert np.abs(after).max() / np.abs(before).max() == pytest.approx(2.0, abs=0.02)


def test_an_error_steeper_than_its_argument_is_refused():
    with pytest.raises(NotConvergedError, match="no longer shrinks"):
        corrected_points(lambda x, y, z: (0 * x, 0 * y, 1.5 * z), [[0, 0, 1e-3]])
    with pytest.raises(NotConvergedError, match="allow more steps"):
        corrected_points(lambda x, y, z: (0 * x, 0 * y, 0.9 * z), [[0, 0, 1e-3]], most_steps=5)
    slow = corrected_points(lambda x, y, z: (0 * x, 0 * y, 0.3 * z), [[0, 0, 1e-3]])
    assert any("check its units" in m for m in slow.messages)
    assert slow.command[0, 2] == pytest.approx(1e-3 / 1.3, abs=1e-12)


def test_bad_points_and_errors_are_named():
    with pytest.raises(DataError, match=r"shape \(n, 3\)"):
        corrected_points(volumetric, [1, 2, 3])
    with pytest.raises(InvalidSamplesError, match="point 1 is"):
        corrected_points(volumetric, [[0, 0, 0], [0, np.nan, 0]])
    with pytest.raises(InvalidSamplesError, match="measured volume"):
        corrected_points(lambda x, y, z: (np.where(x > 0.1, np.nan, 0), 0, 0), [[0.2, 0, 0]])
    with pytest.raises(InvalidSamplesError, match="got 2 parts"):
        corrected_points(lambda x, y, z: (x, y), [[0, 0, 0]])
    with pytest.raises(InvalidSamplesError, match="must return"):
        corrected_points(lambda x, y, z: (np.zeros(7), 0, 0), [[0, 0, 0]])
    with pytest.raises(DataError, match="tolerance must be positive"):
        corrected_points(volumetric, [[0, 0, 0]], tolerance=-1.0)
    points = volume(3)
    before = points.copy()
    corrected_points(volumetric, points)
    np.testing.assert_array_equal(points, before)


def test_what_the_identification_could_not_tell_stays_with_the_path():
    """Above all that the sign of dy rests on how the map was read."""
    axis = 5e-6 * np.arange(-40, 41) + 1e-6
    x, y = np.meshgrid(axis, axis)
    z = GRID(x, y) + ToolSetting(dx=-2e-6, dy=1e-6).error(GRID, x, y)
    tool = ToolSetting.identify(Surface(z, 5e-6, 5e-6, origin=(axis[0], axis[0])), GRID)
    path = corrected_path(GRID, tool, [100e-6], [0.5])
    assert any("the sign of dy rests on the orientation" in m for m in path.messages)
    assert set(tool.messages) <= set(path.messages)
