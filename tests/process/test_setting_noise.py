"""The uncertainty of a tool setting where the noise of neighbouring points is not independent.

Monte Carlo: maps are cut once without library code, noise of a known correlation is added many
times, and the scatter of the settings is held against the uncertainty that each fit states.
"""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.forms import PointSet, SineGrid
from metrosep.process.tool_settings import identify_setting

NM, UM = 1e-9, 1e-6
A, WAVE = 50e-9, 100e-6
K = 2 * np.pi / WAVE
GRID = SineGrid(amplitude=A, wavelength=WAVE)
TRUTH = (-2e-6, 1.5e-6, 0.0)
AXIS = 4e-6 * np.arange(-50, 51)
SCATTER = (0.45, 1.65)
"""RMS z-score of 10 maps: 0.46 ... 1.59 at 0.5 % each side, and the correlation is estimated."""


def cut(x, y):
    rho, theta = np.hypot(x, y), np.arctan2(y, x)
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.sqrt(rho**2 - TRUTH[1] ** 2) - TRUTH[0]
        azimuth = theta - np.arcsin(TRUTH[1] / rho)
    return A * np.sin(K * r * np.cos(azimuth)) + A * np.cos(K * r * np.sin(azimuth))


X, Y = np.meshgrid(AXIS, AXIS)
CUT = cut(X, Y)


def smoothed(shape, sigma_x, sigma_y, rng):
    """White noise after a Gaussian of the given widths in pixels, 1 nm RMS; 0 leaves an axis."""
    halves = [int(np.ceil(5 * sigma)) for sigma in (sigma_y, sigma_x)]
    noise = rng.standard_normal([n + 2 * half for n, half in zip(shape, halves, strict=True)])
    for axis, (half, sigma) in enumerate(zip(halves, (sigma_y, sigma_x), strict=True)):
        if sigma:
            kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)
            kernel /= np.sqrt((kernel**2).sum())
            noise = np.apply_along_axis(np.convolve, axis, noise, kernel, "valid")
    return NM * noise


def z_scores(sigma_x, sigma_y, n, **options):
    scores, inflations, said = [], [], set()
    for seed in range(n):
        rng = np.random.default_rng(seed)
        z = CUT + smoothed(X.shape, sigma_x, sigma_y, rng)
        found = identify_setting(
            Surface(z, 4e-6, 4e-6, origin=(AXIS[0], AXIS[0])), GRID, **options
        )
        tool = found.setting
        u = np.array([tool.u_dx, tool.u_dy, tool.u_dR])
        scores.append((tool.values - TRUTH) / u)
        inflations.append(found.audit["u_raised"])
        said |= {m for m in found.messages if "neighbouring points correlate" in m}
    return np.array(scores), np.array(inflations), said


CASES = {"along x": (6.0, 0.0), "along y": (0.0, 6.0), "light": (0.5, 0.5), "4 pixels": (4.0, 4.0)}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_u_covers_correlated_noise(name):
    scores, raised, said = z_scores(*CASES[name], 10)
    spread = np.sqrt((scores**2).mean(axis=0))
    assert ((spread > SCATTER[0]) & (spread < SCATTER[1])).all(), spread
    assert said
    assert raised.min() > 1.2


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_u_covers_correlated_noise_of_many_maps(name):
    scores, _, _ = z_scores(*CASES[name], 50)
    # 50 z-scores: 0.75 ... 1.26 at 0.5 % each side; a tenth more for the estimated correlation
    spread = np.sqrt((scores**2).mean(axis=0))
    assert ((spread > 0.67) & (spread < 1.4)).all(), spread


def test_white_noise_leaves_u_as_it_was():
    scores, raised, said = z_scores(0.0, 0.0, 10)
    spread = np.sqrt((scores**2).mean(axis=0))
    assert ((spread > SCATTER[0]) & (spread < SCATTER[1])).all(), spread
    # one in a hundred maps shows a neighbour beyond three standard deviations by chance
    assert np.count_nonzero(raised > 1.0) <= 2
    assert raised.max() < 1.15
    assert not said or np.count_nonzero(raised > 1.0)


def test_a_stated_noise_is_raised_as_well():
    scores, raised, _ = z_scores(0.0, 6.0, 5, noise=NM)
    assert raised.min() > 1.5
    assert np.sqrt((scores**2).mean(axis=0)).max() < 2.2


def test_the_average_of_copied_pixels_counts_once():
    """Every pixel written four times: nothing is added, so u must be that of the single map."""
    rng = np.random.default_rng(3)
    axis = 8e-6 * np.arange(-25, 26)
    x, y = np.meshgrid(axis, axis)
    noise = NM * rng.standard_normal(x.shape)
    single = identify_setting(Surface(cut(x, y) + noise, 8e-6, 8e-6, origin=(axis[0],) * 2), GRID)
    fine = 4e-6 * np.arange(2 * axis.size) + axis[0]
    fx, fy = np.meshgrid(fine, fine)
    z = cut(fx, fy) + np.repeat(np.repeat(noise, 2, axis=0), 2, axis=1)
    fourfold = identify_setting(Surface(z, 4e-6, 4e-6, origin=(fine[0],) * 2), GRID)
    for name in ("dx", "dy", "dR"):
        # the fine map reaches 4 um further
        assert fourfold.u[name] == pytest.approx(single.u[name], rel=0.15, abs=0.0), name


def test_profiles_and_scattered_points():
    x = np.arange(-300e-6, 300e-6, 1e-6)
    x = x[np.abs(x) > 10e-6]
    noise = smoothed((1, x.size), 5.0, 0.0, np.random.default_rng(2))[0]
    z = cut(x, 0 * x)
    rough = identify_setting(Profile(x, z + noise), GRID)
    white = identify_setting(
        Profile(x, z + NM * np.random.default_rng(1).standard_normal(x.size)), GRID
    )
    assert white.audit["u_raised"] == 1.0
    assert rough.u["dx"] > 2.0 * white.u["dx"]

    # scattered points have no lags to sum over: said, not raised
    keep = (np.hypot(X, Y) > 5e-6) & (np.random.default_rng(0).random(X.shape) < 0.7)
    z = CUT + smoothed(X.shape, 4.0, 4.0, np.random.default_rng(5))
    found = identify_setting(PointSet(X[keep], Y[keep], z[keep]), GRID)
    assert any("neighbouring points correlate" in m and "too small" in m for m in found.messages)
    plain = CUT + NM * np.random.default_rng(5).standard_normal(X.shape)
    found = identify_setting(PointSet(X[keep], Y[keep], plain[keep]), GRID)
    assert not any("neighbouring" in m for m in found.messages)


def test_gaps_do_not_hide_the_correlation():
    z = CUT + smoothed(X.shape, 0.0, 6.0, np.random.default_rng(9))
    z[:, 1::2] = np.nan
    found = identify_setting(Surface(z, 4e-6, 4e-6, origin=(AXIS[0], AXIS[0])), GRID)
    assert found.audit["u_raised"] > 2.0
    assert any("along y" in m for m in found.messages)
