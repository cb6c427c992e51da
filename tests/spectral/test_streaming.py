"""Chunks leave no trace: the whole at once, closed forms and SciPy are the truth."""

import numpy as np
import pytest
from scipy import signal

from metrosep.errors import InvalidSamplesError, TooFewSamplesError
from metrosep.spectral import BinnedMean, StreamedPsd

ROUNDING = 1e-12  # sums of a few thousand doubles, relative


def in_chunks(n, rng):
    edges = np.sort(rng.integers(0, n, size=17))
    return np.split(np.arange(n), edges)


def test_density_is_that_of_scipy_whatever_the_chunks(rng):
    z = rng.standard_normal(10_007) + 3.0
    truth = signal.welch(
        z, fs=200.0, window=signal.get_window("hann", 512), noverlap=256, detrend="constant"
    )
    psd = StreamedPsd(5e-3, 512)

    for part in in_chunks(z.size, rng):
        psd.add(z[part])

    np.testing.assert_allclose(psd.frequency, truth[0][1:], rtol=ROUNDING)
    np.testing.assert_allclose(psd.density, truth[1][1:], rtol=1e-9)
    assert psd.n_segments == 38


def test_white_noise_integrates_to_its_variance(rng):
    psd = StreamedPsd(1e-3, 1024)

    psd.add(0.5 * rng.standard_normal(400_000))

    assert psd.density.sum() / (1024 * 1e-3) == pytest.approx(0.25, rel=0.01, abs=0.0)


def test_segments_with_a_gap_are_left_out_and_counted(rng):
    z = rng.standard_normal(64 * 40)
    z[1000] = np.nan
    psd = StreamedPsd(1.0, 64)

    psd.add(z)

    assert (psd.n_left_out, psd.n_segments) == (2, 77)
    assert np.isfinite(psd.density).all()


def test_no_segment_spans_two_records(rng):
    z = rng.standard_normal(100)
    psd = StreamedPsd(1.0, 64)

    psd.add(z[:50])
    psd.new_record()
    psd.add(z[50:])

    with pytest.raises(TooFewSamplesError, match="no unbroken segment of 64"):
        _ = psd.density


def test_bins_hold_what_numpy_gives_of_the_whole(rng):
    x, z = rng.uniform(-1.0, 11.0, 5000), 1e3 + rng.standard_normal(5000)
    z[::50] = np.nan
    bins = BinnedMean(0.0, 10.0, 20)

    for part in in_chunks(x.size, rng):
        bins.add(x[part], z[part])

    for i, centre in enumerate(bins.centres):
        members = z[(x >= centre - 0.25) & (x < centre + 0.25) & ~np.isnan(z)]
        assert bins.count[i] == members.size
        assert bins.mean[i] == pytest.approx(members.mean(), rel=ROUNDING, abs=0.0)
        assert bins.sd[i] == pytest.approx(members.std(ddof=1), rel=1e-9, abs=0.0)
    assert bins.n_invalid == 100
    assert bins.n_outside + bins.count.sum() == 4900


def test_edges_belong_to_the_upper_bin_and_the_last_to_the_last():
    bins = BinnedMean(0.0, 3.0, 3)

    bins.add([0.0, 1.0, 2.0, 3.0, -1e-9], [1.0, 2.0, 4.0, 8.0, 99.0])

    np.testing.assert_array_equal(bins.count, [1, 1, 2])
    np.testing.assert_array_equal(bins.mean, [1.0, 2.0, 6.0])


def test_a_turn_is_folded_with_its_sense():
    bins = BinnedMean(0.0, 360.0, 4, period=360.0)

    bins.add([10.0, 370.0, -350.0, 100.0], [1.0, 2.0, 6.0, 5.0])

    np.testing.assert_array_equal(bins.mean, [3.0, 5.0, np.nan, np.nan])


@pytest.mark.parametrize(
    ("low", "high", "n_bins", "period"),
    [(1.0, 1.0, 3, None), (0.0, 1.0, 0, None), (0.0, np.nan, 2, None), (0.0, 1.0, 2, -1.0)],
    ids=["empty range", "no bin", "NaN", "negative period"],
)
def test_bins_that_cannot_be_are_refused(low, high, n_bins, period):
    with pytest.raises(InvalidSamplesError):
        BinnedMean(low, high, n_bins, period=period)


def test_unequal_lengths_are_refused():
    with pytest.raises(InvalidSamplesError, match="1 and 2"):
        BinnedMean(0.0, 1.0, 2).add([1.0], [1.0, 2.0])


def test_segments_that_cannot_be_are_refused():
    with pytest.raises(TooFewSamplesError):
        StreamedPsd(1.0, 8)
    with pytest.raises(InvalidSamplesError):
        StreamedPsd(0.0)
