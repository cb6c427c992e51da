"""Sdq and Sdr against closed forms, and what holes, edges and unequal steps do to them."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from metrosep.core.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.areal import gradient_statistics, surface_slopes

UM = 1e-6
ROUNDING = 1e-12
"""Sums of some ten thousand terms in double precision."""
SEVEN_POINTS = 2e-6
"""Relative error of the seven-point slope at 100 samples a wave, and of the quadrature."""
EDGE = 2e-3
"""Edges and holes take lower orders: error of three points at 100 samples a wave."""

AMPLITUDE, WAVELENGTH = 10 * UM, 100 * UM
SDQ_GRID = 2 * np.pi * AMPLITUDE / WAVELENGTH
SDR_GRID = 0.1780102  # quadrature of sqrt(1 + (k A)^2 (sin^2 u + sin^2 v)) - 1


def sine_grid(n, step=UM, amplitude=AMPLITUDE):
    c = np.cos(2 * np.pi * np.arange(n) * step / WAVELENGTH)
    return amplitude * (c[None, :] + c[:, None])


def test_sine_grid_has_its_closed_form():
    g = gradient_statistics(sine_grid(200), UM, UM)
    assert g.n_used == 200 * 200
    assert g.Sdq == pytest.approx(SDQ_GRID, rel=SEVEN_POINTS, abs=0.0)
    assert g.Sdr == pytest.approx(SDR_GRID, rel=SEVEN_POINTS, abs=0.0)


def test_seven_points_hold_at_ten_samples_a_wave():
    # Neighbour differences would be 1.6 % low, central ones 6.4 %.
    z = sine_grid(400, step=10 * UM)
    assert gradient_statistics(z, 10 * UM, 10 * UM).Sdq == pytest.approx(
        SDQ_GRID, rel=1e-3, abs=0.0
    )


def test_developed_area_of_a_plane_is_exact_and_of_tiny_slopes_not_cancelled():
    y, x = np.mgrid[:7, :9] * 1.0
    g = gradient_statistics(0.3 * 2 * UM * x - 0.4 * 5 * UM * y, 2 * UM, 5 * UM)
    assert g.Sdq == pytest.approx(0.5, rel=ROUNDING, abs=0.0)
    assert g.Sdr == pytest.approx(np.sqrt(1.25) - 1, rel=ROUNDING, abs=0.0)
    tiny = gradient_statistics(1e-9 * UM * x, UM, UM)
    assert tiny.Sdr == pytest.approx(0.5e-18, rel=ROUNDING, abs=0.0)


def test_slope_of_a_parabola_is_exact_up_to_the_edge_and_has_the_right_axis():
    y, x = np.mgrid[:8, :11] * 1.0
    zx, zy = surface_slopes(3 * (x * 2) ** 2 - (y * 5) ** 2, 2.0, 5.0)
    assert zx == pytest.approx(6 * x * 2, abs=1e-9)
    assert zy == pytest.approx(-2 * y * 5, abs=1e-9)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_order_of_the_stencil_far_from_and_near_a_hole(order):
    # A polynomial of the order of each rung is differentiated exactly where that rung is used.
    x = np.arange(12.0)
    z = np.tile(x**order, (3, 1))
    reach = {1: 0, 2: 1, 4: 2, 6: 3}[order]
    zx, _ = surface_slopes(z, 1.0, 1.0)
    inner = slice(reach, 12 - reach)
    assert zx[:, inner] == pytest.approx(
        order * np.tile(x ** (order - 1), (3, 1))[:, inner], rel=ROUNDING, abs=0.0
    )


def test_a_hole_adds_no_slope_of_its_own():
    z = sine_grid(200)
    z[40:60, 30:90] = np.nan
    g = gradient_statistics(z, UM, UM)
    k = 2 * np.pi / 200 * 2
    i = np.arange(200)
    s2 = (SDQ_GRID * np.sin(k * i)[None, :]) ** 2 + (SDQ_GRID * np.sin(k * i)[:, None]) ** 2
    keep = ~np.isnan(z)
    assert g.n_used == keep.sum()
    assert g.Sdq == pytest.approx(np.sqrt(s2[keep].mean()), rel=EDGE, abs=0.0)
    assert g.Sdr == pytest.approx((np.sqrt(1 + s2[keep]) - 1).mean(), rel=EDGE, abs=0.0)


def slope_by_hand(line, i, step):
    """The widest complete stencil at a pixel of a line, by the rule of the docs; NaN if none."""

    def at(k):
        return line[i + k] if 0 <= i + k < line.size else np.nan

    if np.isnan(at(0)):
        return np.nan
    for weights in (
        {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60},
        {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12},
        {-1: -0.5, 1: 0.5},
        {0: -1.5, 1: 2.0, 2: -0.5},
        {0: 1.5, -1: -2.0, -2: 0.5},
        {0: -1.0, 1: 1.0},
        {0: 1.0, -1: -1.0},
    ):
        value = sum(w * at(k) for k, w in weights.items())
        if not np.isnan(value):
            return value / step
    return np.nan


def dropouts_by_hand(z):
    """Missing pixels that lie in no block of 3 x 3 missing ones, of which those beyond the map count."""
    missing = np.pad(np.isnan(z), 2, constant_values=True)
    found = np.isnan(z)
    for i in range(missing.shape[0] - 2):
        for j in range(missing.shape[1] - 2):
            if missing[i : i + 3, j : j + 3].all():
                found[max(i - 2, 0) : i + 1, max(j - 2, 0) : j + 1] = False
    return found


@pytest.mark.parametrize(("s", "within"), [(0, 0.01), (1, 0.01), (2, 0.01)])
def test_dropouts_do_not_raise_the_slopes(s, within):
    """Of white heights one-sided slopes beside 5 % dropouts made Sdq 15 % too large.

    What is left of 150 x 150 pixels scatters by 0.4 %; the mean of twelve maps by 0.1 %.
    """
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng([seed, s])
        z = gaussian_filter(rng.standard_normal((150, 150)), s) * 1e-7
        lost = np.where(rng.random(z.shape) < 0.05, np.nan, z)
        ratios.append(gradient_statistics(lost, UM, UM).Sdq / gradient_statistics(z, UM, UM).Sdq)
    assert np.mean(ratios) == pytest.approx(1.0, abs=within)


@pytest.mark.parametrize("share", [0.0, 0.002, 0.05, 0.4])
def test_slopes_are_those_of_the_rule_pixel_by_pixel(rng, share):
    z = rng.standard_normal((40, 50))
    z[rng.random(z.shape) < share] = np.nan
    z[20, 20] = np.nan  # alone: seven points reach over it
    z[10:12, 10] = np.nan
    zx, zy = surface_slopes(z, 2.0, 3.0)
    want_x = np.array([[slope_by_hand(row, j, 2.0) for j in range(50)] for row in z])
    want_y = np.array([[slope_by_hand(column, i, 3.0) for i in range(40)] for column in z.T]).T
    assert np.array_equal(np.isnan(zx), np.isnan(want_x))
    assert np.array_equal(np.isnan(zy), np.isnan(want_y))
    assert zx == pytest.approx(want_x, rel=ROUNDING, abs=ROUNDING, nan_ok=True)
    assert zy == pytest.approx(want_y, rel=ROUNDING, abs=ROUNDING, nan_ok=True)
    used = ~np.isnan(want_x + want_y)
    for i, j in zip(*np.nonzero(dropouts_by_hand(z)), strict=True):
        used[max(i - 3, 0) : i + 4, j] = used[i, max(j - 3, 0) : j + 4] = False
    s2 = (want_x**2 + want_y**2)[used]
    if s2.size == 0:
        with pytest.raises(InvalidSamplesError, match="has a dropout within 3 pixels"):
            gradient_statistics(z, 2.0, 3.0)
        return
    g = gradient_statistics(z, 2.0, 3.0)
    assert g.n_used == s2.size
    assert g.Sdq == pytest.approx(np.sqrt(s2.mean()), rel=ROUNDING, abs=0.0)
    assert g.Sdr == pytest.approx((np.sqrt(1 + s2) - 1).mean(), rel=ROUNDING, abs=0.0)


def test_a_pixel_that_was_not_measured_does_not_count(rng):
    z = rng.standard_normal((60, 60))
    z[20, 20] = np.nan
    z[40:42, 10] = np.nan
    assert gradient_statistics(z, 1.0, 1.0).n_used == 3567  # less 12 beside one and 18 beside two
    assert all(np.isnan(s[20, 20]) for s in surface_slopes(z, 1.0, 1.0))


def test_nan_rows_give_the_numbers_of_the_cropped_map(rng):
    z = rng.normal(size=(30, 40))
    padded = np.full((41, 40), np.nan)
    padded[6:36] = z
    assert gradient_statistics(padded, 1.0, 2.0) == gradient_statistics(z, 1.0, 2.0)


def test_transposed_map_with_exchanged_steps(rng):
    z = rng.normal(size=(31, 40)) * 1e-7
    a, b = gradient_statistics(z, UM, 3 * UM), gradient_statistics(z.T, 3 * UM, UM)
    assert (a.Sdq, a.Sdr) == pytest.approx((b.Sdq, b.Sdr), rel=ROUNDING, abs=0.0)
    assert gradient_statistics(z, 3 * UM, UM).Sdq != pytest.approx(a.Sdq, rel=0.01, abs=0.0)


def test_block_borders_leave_no_trace(rng):
    z = rng.normal(size=(900, 300))
    zx, zy = surface_slopes(z, 1.0, 1.0)
    part_x, part_y = surface_slopes(z[95:125], 1.0, 1.0)
    assert np.array_equal(zx[98:122], part_x[3:-3])
    assert np.array_equal(zy[98:122], part_y[3:-3])


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0])
def test_ratios_do_not_depend_on_the_unit(rng, unit):
    z = rng.normal(size=(20, 25))
    a, b = gradient_statistics(z, 2.0, 3.0), gradient_statistics(z * unit, 2 * unit, 3 * unit)
    assert (a.Sdq, a.Sdr) == pytest.approx((b.Sdq, b.Sdr), rel=ROUNDING, abs=0.0)


def test_bad_input_is_named():
    with pytest.raises(TooFewSamplesError, match="2 x 2"):
        gradient_statistics([[1.0, 2.0]], 1.0, 1.0)
    with pytest.raises(InvalidSamplesError, match="neighbour"):
        gradient_statistics(np.full((4, 4), np.nan), 1.0, 1.0)
    with pytest.raises(InvalidSamplesError, match="dy must be positive"):
        gradient_statistics(np.zeros((4, 4)), 1.0, 0.0)
    with pytest.raises(InvalidSamplesError, match="infinite"):
        gradient_statistics([[0.0, np.inf], [0.0, 0.0]], 1.0, 1.0)
    assert gradient_statistics(np.arange(12).reshape(3, 4), 1.0, 1.0).Sdq == pytest.approx(
        17**0.5, rel=ROUNDING, abs=0.0
    )
