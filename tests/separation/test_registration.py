"""Registration of maps and fiducials: planted shift and turn, uncertainty, gradient times shift."""

import math
import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    MetrosepError,
    NotConvergedError,
    TooFewSamplesError,
)
from metrosep.separation.maps._map_input import map_stack, mirror, turned
from metrosep.separation.maps.registration import (
    Registration,
    register_maps,
    register_points,
    registration_uncertainty,
)

N = 128
G = np.linspace(-1.0, 1.0, N)
GX, GY = np.meshgrid(G, G)
STEP = G[1] - G[0]
ROUND = np.hypot(GX, GY) <= 1.0


def heights(x, y):
    """Irregular analytic surface of about 30 nm RMS."""
    return 30e-9 * (
        np.sin(4 * x + y) * np.cos(3 * y - x**2) + 0.5 * x**3 * y + 0.3 * np.cos(9 * x)
    )


def moved(sx, sy, angle, z=heights):
    u, v = GX - sx, GY - sy
    c, s = math.cos(angle), math.sin(angle)
    return z(c * u + s * v, -s * u + c * v)


def masked(z, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    tilt = 1e-7 * rng.standard_normal(3)
    z = z + tilt[0] + tilt[1] * GX + tilt[2] * GY + noise * rng.standard_normal(z.shape)
    return np.where(ROUND, z, np.nan)


@pytest.mark.parametrize(
    ("sx", "sy", "angle"),
    [(0.5, 0.0, 0.0), (-3.2, 7.7, 0.02), (15.0, -11.0, -0.05), (0.3, 0.2, math.pi / 2)],
)
def test_planted_shift_in_pixels_and_turn(sx, sy, angle):
    start = (0.0, 0.0, angle if abs(angle) > 1 else 0.0)
    found = register_maps(
        masked(heights(GX, GY)), masked(moved(sx * STEP, sy * STEP, angle), seed=1),
        dx=STEP, start=start,
    )  # fmt: skip

    assert abs(found.shift_x / STEP - sx) < 1e-4
    assert abs(found.shift_y / STEP - sy) < 1e-4
    assert abs(found.angle - angle) < 1e-6
    assert not found.messages


@pytest.mark.slow
def test_uncertainty_is_the_scatter():
    fixed, shifted, sd = heights(GX, GY), moved(0.5 * STEP, -0.3 * STEP, 1e-3), 2e-9
    found = [
        register_maps(masked(fixed, sd, 2 * k), masked(shifted, sd, 2 * k + 1), dx=STEP,
                      start=(0.5 * STEP, -0.3 * STEP, 1e-3)) for k in range(40)
    ]  # fmt: skip
    scatter = np.std([(f.shift_x, f.shift_y, f.angle) for f in found], axis=0, ddof=1)
    stated = np.sqrt(np.mean([np.diag(f.cov) for f in found], axis=0))

    # 40 trials: the scatter is known to 11 %; interpolation at half pixels smooths some noise
    np.testing.assert_allclose(stated, scatter, rtol=0.35)
    assert found[0].u_shift[0] == pytest.approx(stated[0], rel=0.1, abs=0.0)
    assert found[0].u_angle == pytest.approx(stated[2], rel=0.1, abs=0.0)


def test_shift_alone_keeps_the_angle():
    found = register_maps(
        masked(heights(GX, GY)), masked(moved(STEP, 2 * STEP, 0.0)), rotation=False, dx=STEP
    )
    assert found.angle == 0.0
    assert found.cov[2, 2] == 0.0
    assert abs(found.shift_y / STEP - 2.0) < 1e-4


def turn_map(z, angle, *, shift=(0.0, 0.0), dx=None, dy=None):
    stack, grid, _ = map_stack([z], what="test", dx=dx, dy=dy)
    return turned(stack, angle, grid, shift=shift)[0][0]


def test_registered_map_undoes_the_turn():
    sx, sy, angle = 2.3 * STEP, -1.6 * STEP, 0.03
    other = masked(moved(sx, sy, angle))
    found = register_maps(masked(heights(GX, GY)), other, dx=STEP)
    again = turn_map(
        masked(heights(GX, GY)), found.angle, shift=(found.shift_x, found.shift_y), dx=STEP
    )
    difference = again - other
    ok = np.isfinite(difference)
    a = np.column_stack([np.ones(ok.sum()), GX[ok], GY[ok]])
    left = difference[ok] - a @ np.linalg.lstsq(a, difference[ok], rcond=None)[0]
    assert np.abs(left).max() < 1e-13


def test_what_does_not_show_is_named():
    dish = np.where(ROUND, 1e-8 * (GX**2 + GY**2), np.nan)
    with pytest.raises(DegenerateFitError, match="do not show"):
        register_maps(dish, dish)
    leaf = np.where(ROUND, 1e-8 * np.cos(6 * np.hypot(GX, GY)), np.nan)
    with pytest.raises(DegenerateFitError, match="the turn"):
        register_maps(leaf, leaf)
    wave = 1e-8 * np.cos(7 * GX)
    with pytest.raises(DegenerateFitError, match="shift along y"):
        register_maps(wave, wave, rotation=False)


def test_mirrored_and_foreign_maps():
    z = masked(heights(GX, GY))
    with pytest.raises(NotConvergedError, match="looks mirrored"):
        register_maps(z, mirror(z, "x"), dx=STEP)
    with pytest.raises(NotConvergedError, match="do not resemble"):
        register_maps(z, masked(30e-9 * np.cos(13 * GX * GY + 5 * GY)), dx=STEP)


@pytest.mark.parametrize("noise", [1e-9, 5e-9])
def test_noise_neither_stops_it_nor_counts_as_mirroring(noise):
    """Identical maps of about 14 nm and noise: every one of 12 is registered, u is the scatter."""
    n = 61
    g = np.linspace(-1.0, 1.0, n)
    x, y = np.meshgrid(g, g)
    z = np.where(np.hypot(x, y) <= 1.0, heights(x, y), np.nan)
    rng = np.random.default_rng(11)
    found = [
        register_maps(
            *(z + noise * rng.standard_normal(z.shape) for _ in range(2)), dx=g[1] - g[0]
        )
        for _ in range(12)
    ]
    assert not any(f.messages for f in found)
    pulls = [
        (f.shift_x / f.u_shift[0], f.shift_y / f.u_shift[1], f.angle / f.u_angle) for f in found
    ]
    # 36 values of variance 1: their RMS has a standard deviation of 12 %
    assert 0.6 < math.sqrt(np.mean(np.square(pulls))) < 1.4


def test_bad_input():
    z = masked(heights(GX, GY))
    with pytest.raises(DataError, match="looks like degrees"):
        register_maps(z, z, start=(0.0, 0.0, 90.0))
    with pytest.raises(DataError, match="start holds"):
        register_maps(z, z, start=(0.0, math.nan, 0.0))
    for start in ((1,), None, ("a", 0.0, 0.0)):
        with pytest.raises(DataError, match="start holds"):
            register_maps(z, z, start=start)
    with pytest.raises(DataError, match="one shape"):
        register_maps(z, z[1:])
    with pytest.raises(DataError, match="do not overlap"):
        register_maps(
            np.where(GX < -0.5, z, np.nan), np.where(GX > 0.5, z, np.nan), rotation=False
        )
    with pytest.raises(MetrosepError, match="not mixed"):
        register_maps(ms.Surface(z, STEP, STEP), z)


class TestPoints:
    P = np.array([[1.0, 0.2], [-0.8, 0.9], [0.1, -1.1], [0.7, 0.8]]) * 10e-3

    def placed(self, angle, shift):
        c, s = math.cos(angle), math.sin(angle)
        return self.P @ np.array([[c, s], [-s, c]]) + shift

    @pytest.mark.parametrize("angle", [0.0, 0.3, -2.0, math.pi / 2])
    def test_planted(self, angle):
        found = register_points(self.P, self.placed(angle, [2e-3, -1e-3]))
        assert abs(found.angle - angle) < 1e-12
        assert abs(found.shift_x - 2e-3) < 1e-15
        assert abs(found.shift_y + 1e-3) < 1e-15

    def test_covariance_is_the_scatter(self):
        rng, sd = np.random.default_rng(1), 5e-6
        found = [
            register_points(self.P, self.placed(0.4, 0.0) + sd * rng.standard_normal((4, 2)))
            for _ in range(2000)
        ]
        scatter = np.cov(np.array([(f.shift_x, f.shift_y, f.angle) for f in found]).T)
        stated = np.mean([f.cov for f in found], axis=0)
        np.testing.assert_allclose(np.diag(stated), np.diag(scatter), rtol=0.1)
        assert abs(stated[0, 2] / scatter[0, 2] - 1) < 0.3

    def test_two_points_have_no_uncertainty(self):
        found = register_points(self.P[:2], self.placed(0.1, 0.0)[:2])
        assert abs(found.angle - 0.1) < 1e-12
        assert math.isnan(found.u_angle)
        assert "three or more" in found.messages[0]

    def test_mirrored_fiducials_are_said(self):
        found = register_points(self.P, self.placed(0.1, 0.0) * [-1.0, 1.0])
        assert any("mirrored" in m for m in found.messages)

    def test_bad_points(self):
        with pytest.raises(TooFewSamplesError):
            register_points(self.P[:1], self.P[:1])
        with pytest.raises(DegenerateFitError):
            register_points(np.zeros((3, 2)), self.P[:3])
        for bad in ([[math.nan, 0.0]] * 4, np.zeros(4), [["a", "b"]] * 4):
            with pytest.raises(DataError):
                register_points(self.P, bad)
        with pytest.raises(DataError, match="4 fixed points and 3"):
            register_points(self.P, self.P[:3])


class TestGradientTimesShift:
    def test_is_the_error_of_a_shift(self):
        """S16: half a pixel, error against u within 20 %; here within 2 %."""
        d = 0.5 * STEP
        for shift, u in (((d, 0.0), (d, 0.0)), ((0.0, d), (0.0, d))):
            error = np.where(ROUND, moved(*shift, 0.0) - heights(GX, GY), np.nan)
            stated = registration_uncertainty(
                masked(heights(GX, GY) * 1.0) * 1.0, u_shift=u, dx=STEP
            )
            plane = registration_uncertainty(
                np.where(ROUND, heights(GX, GY), np.nan), u_shift=u, dx=STEP
            )
            assert np.isfinite(stated).sum() == ROUND.sum()
            assert np.sqrt(np.nanmean(plane**2)) == pytest.approx(
                np.sqrt(np.nanmean(error**2)), rel=0.02, abs=0.0
            )

    def test_turn(self):
        error = np.where(ROUND, moved(0.0, 0.0, 1e-3) - heights(GX, GY), np.nan)
        z = np.where(ROUND, heights(GX, GY), np.nan)
        stated = registration_uncertainty(z, u_angle=1e-3, dx=STEP)
        assert np.sqrt(np.nanmean(stated**2)) == pytest.approx(
            np.sqrt(np.nanmean(error**2)), rel=0.02, abs=0.0
        )

    def test_bad_uncertainty(self):
        with pytest.raises(DataError, match="u_shift"):
            registration_uncertainty(heights(GX, GY), u_shift=-1.0)
        with pytest.raises(DataError, match="u_angle"):
            registration_uncertainty(heights(GX, GY), u_angle=math.nan)
        for bad in ("1 um", (1.0, 2.0, 3.0)):
            with pytest.raises(DataError, match="u_shift"):
                registration_uncertainty(heights(GX, GY), u_shift=bad)


class TestTurnMap:
    def test_error_law_of_waves(self):
        """Docstring: below 0.005 (2 pi/L)**6 of the amplitude."""
        columns = np.arange(200.0)
        for length in (8, 12, 20, 40):
            z = np.tile(np.cos(2 * np.pi * columns / length + 0.3), (20, 1))
            found = turn_map(z, 0.0, shift=(0.5, 0.0))
            true = np.cos(2 * np.pi * (columns - 0.5) / length + 0.3)
            assert (
                0.3 < np.nanmax(np.abs(found - true)) / (0.005 * (2 * np.pi / length) ** 6) <= 1.0
            )

    def test_polynomials_of_degree_five_are_exact(self):
        def z(x, y):
            return x**5 - 3 * x**2 * y**3 + y**4 - x * y + 0.5

        found = turn_map(z(GX, GY), 0.7)
        true = moved(0.0, 0.0, 0.7, z)
        assert np.nanmax(np.abs(found - true)) < 1e-13

    @pytest.mark.parametrize("quarters", [-3, -1, 0, 1, 2, 3, 4])
    def test_right_angles_are_exact_and_keep_the_rim(self, quarters):
        z = masked(heights(GX, GY))
        np.testing.assert_array_equal(turn_map(z, quarters * np.pi / 2), np.rot90(z, -quarters))

    def test_missing_pixel_costs_its_neighbours_only(self):
        z = heights(GX, GY)
        z[60, 60] = np.nan
        whole, found = turn_map(heights(GX, GY), 0.3), turn_map(z, 0.3)
        lost = np.isnan(found) & np.isfinite(whole)
        assert 25 <= lost.sum() <= 45
        known = np.isfinite(found)
        np.testing.assert_array_equal(found[known], whole[known])

    def test_whole_pixels_only_move(self):
        z = heights(GX, GY)
        found = turn_map(z, 0.0, shift=(3.0, -2.0))
        np.testing.assert_array_equal(found[:-2, 3:], z[2:, :-3])
        assert np.isnan(found[-2:]).all()
        assert np.isnan(found[:, :3]).all()

    def test_rectangular_grids_and_pixels(self):
        x, y = np.linspace(-1, 1, 101), np.linspace(-1, 1, 151)
        z = x**3 - 2 * x * y[:, None] ** 2
        found = turn_map(z, np.pi / 2, dx=0.02, dy=2 / 150)
        u, v = y[:, None] + 0 * x, -x + 0 * y[:, None]
        assert np.nanmax(np.abs(found - (u**3 - 2 * u * v**2))) < 1e-12

    def test_mirrors(self):
        np.testing.assert_array_equal(mirror(GX, "x"), GX[:, ::-1])
        np.testing.assert_array_equal(mirror(GY, "y"), GY[::-1])


def test_a_registration_is_stored_and_copied_read_only():
    found = Registration(1e-3, 0.0, 0.1, np.eye(3), 0.0, (0.0, 0.0), audit={"n_fiducials": 4})
    found.cov.setflags(write=False)

    again = pickle.loads(pickle.dumps(found))  # noqa: S301 - bytes of its own

    assert again.to_dict() == found.to_dict()
    assert again.to_dict()["audit"] == {"n_fiducials": 4}
    assert not again.cov.flags.writeable
    with pytest.raises(TypeError):
        again.audit["n_fiducials"] = 5
