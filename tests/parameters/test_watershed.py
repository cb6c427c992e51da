"""Peaks and pits that can be counted by hand, and pruning at known saddles."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.areal import areal_parameters
from metrosep.parameters.watershed import (
    five_point_height,
    mean_peak_curvature,
    significant_peaks,
)

ROUNDING = 1e-12
SECOND_DIFFERENCE = 1e-3
"""(k dx)^2 / 12 of the second difference at 50 samples a wave, and a peak between pixels."""


def sine_grid(n=250, wave=50, phase=25):
    """Peaks at the middles of n / wave by n / wave cells."""
    c = np.cos(2 * np.pi * (np.arange(n) - phase) / wave)
    return c[:, None] + c[None, :]


def bumps(centres, heights, width=4.0, shape=(80, 100)):
    y, x = np.mgrid[: shape[0], : shape[1]] * 1.0
    return sum(
        h * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * width**2))
        for (cy, cx), h in zip(centres, heights, strict=True)
    )


def test_sine_grid_has_one_peak_a_cell_at_its_middle():
    peaks = significant_peaks(sine_grid())
    assert len(peaks) == 25
    assert {int(r) % 50 for r in peaks.rows} == {25}
    assert {int(c) % 50 for c in peaks.columns} == {25}
    # From a saddle at 0 to a peak at 2; only the first of equals has no higher neighbour.
    assert sorted(peaks.prominences.tolist())[:24] == pytest.approx(
        [2.0] * 24, rel=ROUNDING, abs=0.0
    )


def test_pits_and_the_edge():
    # The pits of the grid lie on the lines between the cells: 4 x 4 of them inside the map.
    assert len(significant_peaks(-sine_grid())) == 16
    assert len(significant_peaks(np.add.outer(np.arange(9.0), np.arange(7.0)))) == 0


def test_pruning_at_a_known_saddle():
    # Along the ridge of two cosines the saddle is where both are; heights are read off the map.
    z = bumps([(40, 30), (40, 42), (20, 80)], [1.0, 0.8, 0.5])
    ridge = z[40, 30:43]
    saddle = ridge.min()
    low = z[38:43, 40:45].max()
    all_ = significant_peaks(z, pruning=0.0)
    assert all_.heights == pytest.approx(
        [z.max(), low, z[18:23, 78:83].max()], rel=ROUNDING, abs=0.0
    )
    assert all_.prominences[1] == pytest.approx(low - saddle, rel=ROUNDING, abs=0.0)
    share = (low - saddle) / np.ptp(z)
    assert len(significant_peaks(z, pruning=share * 1.001)) == 2
    assert len(significant_peaks(z, pruning=share * 0.999)) == 3


def test_a_chain_of_hills_goes_over_the_highest_saddle():
    # One row of hills 5 3 4 with cuts at 2 and 1: 3 joins 5 over 2, 4 joins 5 over 1.
    row = np.interp(np.arange(61.0), [0, 10, 20, 30, 40, 50, 60], [0, 5, 2, 3, 1, 4, 0])
    z = row[None, :] - 0.5 * np.abs(np.arange(-3, 4))[:, None]
    peaks = significant_peaks(z, pruning=0.0)
    assert peaks.heights.tolist() == [5.0, 4.0, 3.0]
    assert peaks.prominences[1:] == pytest.approx([3.0, 1.0], rel=ROUNDING, abs=0.0)


def test_noise_below_the_threshold_adds_no_peak(rng):
    z = sine_grid() + 0.06 * rng.uniform(-1, 1, size=(250, 250))
    assert len(significant_peaks(z)) == 25
    assert len(significant_peaks(z, pruning=0.0)) > 50


def test_plateau_is_one_peak_at_its_middle():
    z = np.zeros((20, 30))
    z[5:10, 10:17] = 1.0
    peaks = significant_peaks(z)
    assert (peaks.rows.tolist(), peaks.columns.tolist()) == ([7], [13])


def test_a_flat_shoulder_is_not_a_peak():
    row = np.array([0.0, 1, 2, 2, 2, 3, 5, 3, 0, 0])
    z = row[None, :] - 0.1 * np.abs(np.arange(-4, 5))[:, None]
    assert significant_peaks(z, pruning=0.0).heights.tolist() == [5.0]
    steps = np.repeat(np.repeat(sine_grid(60, 20, 10).round(1), 3, axis=0), 3, axis=1)
    assert len(significant_peaks(steps, pruning=0.0)) == 9


def test_prominences_are_those_of_a_flooding(rng):
    # Another way: lower the level; h is the peak's own drop until its region meets a higher one.
    from scipy.ndimage import label

    z = rng.integers(0, 12, size=(25, 30)).astype(float) + rng.uniform(0, 1e-3, size=(25, 30))
    peaks = significant_peaks(z, pruning=0.0)
    for row, column, height, prominence in zip(
        peaks.rows, peaks.columns, peaks.heights, peaks.prominences, strict=True
    ):
        for level in np.sort(z[z < height].ravel())[::-1]:
            regions, _ = label(z >= level, structure=np.ones((3, 3)))
            if z[regions == regions[row, column]].max() > height:
                assert prominence == pytest.approx(height - level, rel=ROUNDING, abs=0.0)
                break
        else:
            assert prominence == height - z.min()


def test_holes_are_neither_peaks_nor_bridges():
    z = sine_grid()
    z[60:90, 60:90] = np.nan
    peaks = significant_peaks(z)
    assert len(peaks) == 24
    assert not np.isnan(peaks.heights).any()
    z[:, 100] = np.nan
    peaks = significant_peaks(z)  # two pieces, of which each has a highest peak
    assert np.sort(peaks.prominences)[-3:] == pytest.approx([2.0, 4.0, 4.0], rel=1e-2, abs=0.0)


def test_an_island_counts_by_its_own_height():
    z = sine_grid()
    plain = len(significant_peaks(z))
    y, x = np.mgrid[-10:11, -10:11] / 5.0
    for height, more in ((1e-6, 0), (0.19, 0), (0.21, 1)):  # 5 % of Sz 4 is 0.2
        island = z.copy()
        island[88:113, 88:113] = np.nan  # at a saddle of the grid, no peak is lost
        without = len(significant_peaks(island))
        island[90:111, 90:111] = height * np.exp(-(x**2) - y**2)
        assert without == plain
        assert len(significant_peaks(island)) == plain + more


@pytest.mark.parametrize("pruning", [0.0, 0.05, 0.3])
def test_prominences_of_islands_are_those_of_a_flooding(rng, pruning):
    # Lower the level until the peak's region holds a higher pixel; where none comes, the whole
    # island is flooded and the peak stands on its lowest pixel.
    from scipy.ndimage import gaussian_filter, label

    eight = np.ones((3, 3))
    for _ in range(4):
        z = gaussian_filter(rng.standard_normal((26, 34)), 1.0)
        z += np.linspace(0, 1, 34)
        z[:, 11], z[13] = np.nan, np.nan
        z[14:, 12:] *= 0.05  # a flat piece
        filled = np.where(np.isnan(z), -np.inf, z)
        pieces, _ = label(~np.isnan(z), structure=eight)
        want = {}
        for i in range(1, 25):
            for j in range(1, 33):
                around = z[i - 1 : i + 2, j - 1 : j + 2]
                if np.isnan(around).any() or z[i, j] < around.max():
                    continue
                base = z[pieces == pieces[i, j]].min()
                for level in np.sort(z[z < z[i, j]])[::-1]:
                    regions, _ = label(filled >= level, structure=eight)
                    if filled[regions == regions[i, j]].max() > z[i, j]:
                        base = level
                        break
                if z[i, j] - base >= pruning * np.ptp(z[~np.isnan(z)]):
                    want[i, j] = z[i, j] - base
        peaks = significant_peaks(z, pruning=pruning)
        places = list(zip(peaks.rows.tolist(), peaks.columns.tolist(), strict=True))
        assert set(places) == set(want)
        assert peaks.prominences.tolist() == pytest.approx(
            [want[p] for p in places], rel=ROUNDING, abs=0.0
        )


def drops_of_a_flooding(z):
    """Height of each flat top above the level at which it meets a higher one (the later of equals)."""
    n_y, n_x = z.shape
    root, top, drops = {}, {}, []

    def find(p):
        while root[p] != p:
            p = root[p]
        return p

    for p in sorted(np.ndindex(n_y, n_x), key=lambda p: -z[p]):
        root[p], top[p] = p, z[p]
        for q in ((p[0] + i, p[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)):
            if q in root and (r := find(q)) != (own := find(p)):
                low, high = sorted((own, r), key=lambda k: top[k])
                root[low] = high
                drops.append(top[low] - z[p])
    return sorted(d for d in [*drops, z.max() - z.min()] if d > 0)


@pytest.mark.parametrize("steps", [2, 5, 12])
def test_steps_of_the_instrument_cost_no_peak(rng, steps):
    """Heights of few steps: many saddles and tops are as high as one another."""
    for shape in ((24, 31), (31, 24)):
        z = rng.integers(0, steps + 1, size=shape).astype(float)
        z = np.pad(z, 2, constant_values=-1.0)  # no peak at the border of the map
        peaks = significant_peaks(z, pruning=0.0)
        assert sorted(peaks.prominences.tolist()) == drops_of_a_flooding(z)
        apart = significant_peaks(z, threshold=2.0)
        assert len(apart) == sum(d >= 2.0 for d in drops_of_a_flooding(z))
        assert len(np.unique(apart.hills)) == apart.n_hills == len(apart)


def test_nan_rows_are_cropped_rows_and_transposing_exchanges_axes(rng):
    from scipy.ndimage import gaussian_filter

    z = gaussian_filter(rng.normal(size=(60, 90)), 2.0)
    padded = np.full((70, 90), np.nan)
    padded[4:64] = z
    a, b, c = significant_peaks(z), significant_peaks(padded), significant_peaks(z.T)
    assert np.array_equal(a.rows, b.rows - 4)
    assert np.array_equal(a.columns, b.columns)
    assert np.array_equal(a.rows, c.columns)
    scaled = significant_peaks(1e-9 * z + 3e-9)
    assert np.array_equal(a.rows, scaled.rows)


def test_five_point_height_of_known_bumps():
    centres = [(15, 15), (15, 45), (15, 80), (60, 20), (60, 50), (60, 80)]
    z = bumps(centres, [6.0, 5.0, 4.0, 3.0, 2.0, 1.0])
    peaks = significant_peaks(z)
    assert len(peaks) == 6
    assert five_point_height(peaks, mean=0.5) == pytest.approx(4.0 - 0.5, abs=1e-6)
    with pytest.raises(TooFewSamplesError, match="the map has 3"):
        five_point_height(significant_peaks(bumps(centres[:3], [6.0, 5.0, 4.0])), 0.0)


def test_curvature_of_a_sine_grid_with_unequal_steps():
    z = sine_grid()
    k = 2 * np.pi / 50
    peaks = significant_peaks(z)
    found = mean_peak_curvature(z, peaks, 1.0, 2.0)
    assert found == pytest.approx((k**2 + (k / 2) ** 2) / 2, rel=2 * SECOND_DIFFERENCE, abs=0.0)
    assert mean_peak_curvature(3 * z, peaks, 0.1, 0.2) == pytest.approx(
        300 * found, rel=ROUNDING, abs=0.0
    )
    assert mean_peak_curvature(z.T, significant_peaks(z.T), 2.0, 1.0) == pytest.approx(
        found, rel=ROUNDING, abs=0.0
    )


def test_bad_input_is_named():
    with pytest.raises(DataError, match="pruning"):
        significant_peaks(sine_grid(), pruning=5.0)
    with pytest.raises(InvalidSamplesError, match="no pixel"):
        significant_peaks(np.full((5, 5), np.nan))
    with pytest.raises(InvalidSamplesError, match="equal"):
        significant_peaks(np.ones((5, 5), dtype=int))
    flat = significant_peaks(np.add.outer(np.arange(5.0), np.arange(5.0)))
    with pytest.raises(TooFewSamplesError, match="no significant peak"):
        mean_peak_curvature(np.zeros((5, 5)), flat, 1.0, 1.0)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("seed", [3, 17])
def test_dropouts_change_neither_the_number_of_peaks_nor_their_height(share, seed):
    """The whole map is a sum of two waves: 7 by 8 hills are counted by hand, S5p is 2 amplitudes."""
    i, j = np.mgrid[:210, :256]
    z = 30e-9 * np.cos(2 * np.pi * (i - 15) / 30) + 20e-9 * np.cos(2 * np.pi * (j - 16) / 32)
    rng = np.random.default_rng(seed)
    z[rng.random(z.shape) < share] = np.nan

    names = ["Spd", "S5p", "S10z", "Spc"]
    table = areal_parameters(ms.Surface(z, 1e-6, 2e-6), names=names)

    # One peak more or less is 2 %; a cluster of dropouts at the border of the map stays an edge.
    assert table["Spd"].value == pytest.approx(56 / (210 * 256 * 2e-12), rel=2e-3, abs=0.0)
    assert table["S5p"].value == pytest.approx(50e-9, rel=5e-3, abs=0.0)
    assert table["S10z"].value == pytest.approx(100e-9, rel=5e-3, abs=0.0)
    bend = 0.5 * (30e-9 * (2 * np.pi / 60e-6) ** 2 + 20e-9 * (2 * np.pi / 32e-6) ** 2)
    assert table["Spc"].value == pytest.approx(bend, rel=5e-3, abs=0.0)
    assert any("missing pixels lie in holes of at most 50" in n for n in table.context.notes)


def test_a_large_hole_is_an_edge_and_is_told():
    z = sine_grid()
    z[60:90, 60:90] = np.nan  # over one peak; a hole of 900 pixels is not filled

    table = areal_parameters(ms.Surface(z, 1e-6, 1e-6), names=["Spd"])

    assert table["Spd"].value * (250**2 - 900) * 1e-12 == pytest.approx(24, rel=1e-9, abs=0.0)
    assert any("900 missing pixels lie in larger holes" in n for n in table.context.notes)


def test_the_outside_of_a_round_part_is_not_filled():
    y, x = np.mgrid[-20:21, -20:21]
    z = np.where(x * x + y * y <= 24.5**2, 1.0 * x + 0.01 * y * y, np.nan)
    outside = int(np.isnan(z).sum())
    assert outside // 4 <= 50  # a corner is small enough to be a hole, were it not outside

    assert significant_peaks(z).n_filled <= 8  # two at each corner, at most
