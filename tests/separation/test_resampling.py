"""Angle-synchronous resampling: known motions over a known, uneven rotation."""

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    TooFewSamplesError,
    UnitError,
)
from metrosep.separation.circles.resampling import (
    cubic_interpolation_error,
    index_pulses,
    resample_by_encoder,
    resample_by_index,
)

TURN = 2 * np.pi
ON_GRID = 1e-11  # rounding of cosines at angles of some hundred rad
BAND_LIMITED = 1e-4  # relative to amplitudes of some units: stop band of the windowed sinc


def motion(angle):
    """Asymmetric in angle: a reversed or shifted table cannot equal it."""
    return np.cos(2 * angle + 0.4) + 0.5 * np.sin(3 * angle) + 0.1 * np.cos(11 * angle - 1.0)


def uneven(n, per_turn, *, first=0.0):
    """Spindle angle with a slow change of speed of 3 %."""
    i = np.arange(n)
    return first + TURN / per_turn * (i + 0.03 * 800 * np.sin(i / 800))


def test_samples_on_the_grid_are_taken_as_they_are():
    angle = np.arange(5 * 64) * TURN / 64

    result = resample_by_encoder(motion(angle), angle)

    assert result.table.shape == (5, 64)
    assert result.noise_gain == 1.0
    assert result.audit["interpolation"] == "none"
    assert np.array_equal(result.table.ravel(), motion(angle))
    np.testing.assert_allclose(result.angle, np.arange(64) * TURN / 64, rtol=0, atol=ON_GRID)
    np.testing.assert_allclose(result.speed, 1 / 64, rtol=0, atol=1e-9)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("wrapped", [True, False])
def test_uneven_rotation_gives_the_motion_at_the_angle(sense, wrapped):
    angle = sense * uneven(6000, 211.7, first=1.0)
    given = np.mod(angle, TURN) if wrapped else angle

    result = resample_by_encoder(motion(angle), given, n=128, sampling_rate=5000.0)

    assert result.rotation == sense
    assert result.n_revolutions == int(np.ptp(angle) / TURN)
    np.testing.assert_allclose(
        result.table,
        np.tile(motion(result.angle), (len(result.table), 1)),
        rtol=0,
        atol=BAND_LIMITED,
    )
    assert np.all(np.abs(result.speed - 5000 / 211.7) < 0.03 * 5000 / 211.7 + 0.1)
    assert np.ptp(result.speed) > 0.5


def test_start_column_is_the_first_angle_in_time():
    angle = uneven(3000, 200.3, first=1.0)

    result = resample_by_encoder(motion(angle), angle, n=100)

    assert result.start == int(np.ceil(1.0 / (TURN / 100)))


def test_start_column_of_a_reversed_spindle():
    angle = -uneven(3000, 200.3, first=1.0)

    result = resample_by_encoder(motion(angle), angle, n=100)

    # the first grid angle met in time is -16 steps = 84
    assert result.start == (-int(np.ceil(1.0 / (TURN / 100)))) % 100


def test_drift_runs_from_the_start_column():
    angle = uneven(3000, 200.3, first=1.0)

    result = resample_by_encoder(angle.copy(), angle, n=100)
    in_time = np.roll(result.table, -result.start, axis=1).ravel()

    np.testing.assert_allclose(np.diff(in_time), TURN / 100, rtol=0, atol=BAND_LIMITED)


def test_channels_share_the_angle():
    angle = uneven(3000, 200.3)
    both = np.stack([motion(angle), 2 * motion(angle)])

    result = resample_by_encoder(both, angle, n=150)

    assert result.table.shape == (2, 14, 150)
    np.testing.assert_allclose(result.table[1], 2 * result.table[0], rtol=0, atol=ON_GRID)


def test_scatter_of_white_noise_survives():
    """A cubic spline takes 10 % of it, which would be an asynchronous motion too small."""
    rng = np.random.default_rng(5)
    noise = rng.normal(size=200_000)
    angle = np.arange(noise.size) * TURN / 400.37

    kept = resample_by_encoder(noise, angle)
    lost = resample_by_encoder(noise, angle, method="cubic")

    expected = kept.noise_gain
    assert 0.99 < expected < 1.0
    assert abs(kept.table.std() - expected) < 0.005  # 3 sd of the standard deviation
    assert lost.table.std() < 0.95
    assert np.isnan(lost.noise_gain)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.9])
def test_windowed_sinc_error(share):
    """Sines up to 0.9 of the Nyquist frequency to 2e-4, as docs say."""
    i = np.arange(4000)
    angle = i * TURN / 100.37
    wave = np.sin(np.pi * share * i + 0.3)

    result = resample_by_encoder(wave, angle, n=100)
    inner = slice(1, -1)
    position = (np.arange(result.table.size) / 100 * 100.37).reshape(result.table.shape)

    assert np.abs(result.table - np.sin(np.pi * share * position + 0.3))[inner].max() < 2e-4


@pytest.mark.parametrize("per_wave", [5.0, 8.0, 16.0])
def test_cubic_spline_stays_below_its_bound(per_wave):
    i = np.arange(2000)
    angle = i * TURN / 101.3
    wave = np.sin(TURN * i / per_wave)

    table = resample_by_encoder(wave, angle, method="cubic", n=100).table
    position = (np.arange(table.size) / 100 * 101.3).reshape(table.shape)
    error = np.abs(table - np.sin(TURN * position / per_wave))[1:-1].max()

    assert error <= cubic_interpolation_error(per_wave)
    assert error > 0.1 * cubic_interpolation_error(per_wave)


def test_quantised_encoder_is_read_at_its_edges():
    counts = 1000
    angle = uneven(20_000, 4000.0)
    read = np.floor(angle / TURN * counts) * TURN / counts

    result = resample_by_encoder(motion(angle), read, n=64)

    # an edge lies up to one sample after the count: 2 pi / 4000 rad times slope of motion (about 5)
    assert np.abs(result.table - motion(result.angle)).max() < 2 * 5 * TURN / 4000


def test_missing_sample_spoils_its_revolution_only():
    angle = uneven(3000, 200.3)
    signal = motion(angle)
    signal[1000] = np.nan

    result = resample_by_encoder(signal, angle, n=100)

    spoilt = np.isnan(result.table).any(axis=1)
    assert 1 <= spoilt.sum() <= 2
    assert any("not measured" in m for m in result.messages)
    assert not np.isnan(result.table[~spoilt]).any()
    assert np.isnan(signal).sum() == 1


# -- index pulses ------------------------------------------------------------------------------


def run_up(n_turns, *, per_turn=400.0, rise=0.02):
    """Pulse positions of a spindle whose revolutions get shorter by `rise`, and angle(sample)."""
    grid = np.linspace(0, n_turns, 40_001)
    samples = 10.3 + per_turn * (1 - np.exp(-rise * grid)) / rise
    n = int(samples[-1]) + 20
    angle = TURN * np.interp(np.arange(n), samples, grid, left=np.nan, right=np.nan)
    angle[np.isnan(angle)] = 0.0
    return np.interp(np.arange(n_turns + 1), grid, samples), angle, samples, grid


@pytest.mark.parametrize(
    ("speed", "worst", "best"),
    [("constant", 0.075, 0.04), ("linear", 3e-3, 0), ("spline", 1e-3, 0)],
)
def test_speed_between_pulses(speed, worst, best):
    """Constant speed errs by rise/8 of a turn in the middle: 2 pi 0.02/8 rad times the slope."""
    pulses, angle, _, _ = run_up(12)

    result = resample_by_index(motion(angle), pulses, n=200, speed=speed)
    error = np.abs(result.table - motion(result.angle))[1:-1].max()

    assert best <= error <= worst
    np.testing.assert_allclose(1 / result.speed, np.diff(pulses), rtol=0, atol=1e-9)


def test_index_of_a_reversed_spindle():
    pulses, angle, _, _ = run_up(12)

    result = resample_by_index(motion(-angle), pulses, n=200, rotation=-1)

    assert np.abs(result.table - motion(result.angle))[1:-1].max() < 1e-3


def test_ripple_within_a_turn_is_invisible_to_one_pulse():
    """The stated null space: s'(t) times the angle error, no more and no less."""
    i = np.arange(8200)
    even = i * TURN / 400
    true = even + 0.01 * (np.cos(even) - 1)
    pulses = np.arange(21) * 400.0

    table = resample_by_index(np.sin(true), pulses, n=200).table
    angle = np.arange(200) * TURN / 200
    expected = 0.01 * (np.cos(angle) - 1) * np.cos(angle)

    assert np.abs(table.mean(axis=0) - np.sin(angle) - expected).max() < 0.02**2 / 2


def test_missing_pulse_is_refused_with_its_revolution():
    pulses = np.delete(100.0 * np.arange(12), 5)
    signal = np.zeros(1200)

    with pytest.raises(InvalidSamplesError, match=r"revolution 4 lasts 2 times.*missing"):
        resample_by_index(signal, pulses)


@pytest.mark.parametrize("where", [430.0, 410.0, 495.0])
def test_double_pulse_is_refused_or_dropped_whole(where):
    pulses = np.sort(np.append(100.0 * np.arange(12), where))
    signal = motion(np.arange(1200) * TURN / 100)

    with pytest.raises(InvalidSamplesError, match=r"double|other part"):
        resample_by_index(signal, pulses)
    result = resample_by_index(signal, pulses, faults="drop")

    assert result.n_revolutions == 10
    assert result.audit["dropped_revolutions"] == [4, 5]
    assert sum("omitted" in m for m in result.messages) == 2
    assert np.abs(result.table - motion(result.angle)).max() < BAND_LIMITED


def test_dropped_revolutions_are_not_bridged():
    pulses = np.delete(100.0 * np.arange(12), 5)
    signal = motion(np.arange(1200) * TURN / 100)

    result = resample_by_index(signal, pulses, faults="drop")

    assert result.revolutions.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]
    assert np.abs(result.table - motion(result.angle)).max() < BAND_LIMITED


def test_index_edges_between_samples():
    true = 20.25 + 73.4 * np.arange(9)
    i = np.arange(700)
    channel = 5 * sum(
        np.clip((i - t) / 8 + 0.5, 0, 1) - np.clip((i - t - 30) / 8 + 0.5, 0, 1) for t in true
    )

    np.testing.assert_allclose(index_pulses(channel), true, rtol=0, atol=1e-9)
    np.testing.assert_allclose(index_pulses(channel, edge="falling"), true + 30, rtol=0, atol=1e-9)
    np.testing.assert_allclose(index_pulses(-channel, edge="falling"), true, rtol=0, atol=1e-9)
    ttl = 5.0 * (channel > 2.5)
    assert np.abs(index_pulses(ttl) - true).max() <= 0.5


def test_noise_on_a_slow_edge_counts_once():
    rng = np.random.default_rng(3)
    i = np.arange(4000)
    channel = np.sin(TURN * i / 400) + rng.normal(0, 0.05, i.size)

    assert index_pulses(channel, hysteresis=0.6).size == 9
    assert index_pulses(channel, hysteresis=0.0).size > 10


@pytest.mark.parametrize(
    ("channel", "options", "match"),
    [
        ([0, 0, 0.0], {}, "throughout"),
        ([0, np.nan, 1], {}, "NaN at sample 1"),
        ([0, 1, 0], {"threshold": 2.0}, "never crosses"),
        ([0, 1, 0], {"hysteresis": -1.0}, "zero or more"),
        ([0, 1, 0], {"edge": "up"}, "rising"),
    ],
)
def test_unusable_index_channels(channel, options, match):
    with pytest.raises(DataError, match=match):
        index_pulses(channel, **options)


def test_angle_in_degrees_is_named():
    i = np.arange(2000)
    with pytest.raises(UnitError, match="wrapped degrees"):
        resample_by_encoder(i * 1.0, np.mod(i * 0.9, 360.0))
    with pytest.raises(UnitError, match="360: degrees"):
        resample_by_encoder(i * 1.0, i * 0.9)
    with pytest.raises(UnitError, match="wrapped turns"):
        resample_by_encoder(i * 1.0, np.mod(i / 400.0, 1.0))
    with pytest.raises(TooFewSamplesError, match="deg2rad"):
        resample_by_encoder(i * 1.0, i * 3.7)


@pytest.mark.parametrize(
    ("angle", "error", "match"),
    [
        (np.zeros(400), TooFewSamplesError, "stands still"),
        (np.arange(399) * 0.1, InvalidSamplesError, "399 samples"),
        (np.r_[np.arange(200), np.arange(200, 0, -1)] * 0.1, InvalidSamplesError, "turns back"),
        (np.r_[np.nan, np.arange(399) * 0.1], InvalidSamplesError, "NaN at sample 0"),
        (np.arange(400) * 1e-3, TooFewSamplesError, "no whole one"),
        (np.r_[np.arange(200) * 0.1, 0.0, np.arange(199) * 0.1], InvalidSamplesError, "neither"),
    ],
)
def test_unusable_angles(angle, error, match):
    with pytest.raises(error, match=match):
        resample_by_encoder(np.zeros(400), angle)


@pytest.mark.parametrize(
    ("pulses", "error", "match"),
    [
        ([3.0], TooFewSamplesError, "needs 2"),
        ([], TooFewSamplesError, "0 index pulse"),
        ([3.0, 2.0], InvalidSamplesError, "rise"),
        ([3.0, np.nan], InvalidSamplesError, "rise"),
        ([3.0, 1e4], InvalidSamplesError, "sample numbers, not times"),
        ([0.0, 4.0, 8.0], TooFewSamplesError, "samples per revolution"),
    ],
)
def test_unusable_pulses(pulses, error, match):
    with pytest.raises(error, match=match):
        resample_by_index(np.zeros(400), pulses)


@pytest.mark.parametrize(
    "options",
    [
        {"n": 4}, {"n": 20.5}, {"n": float("nan")}, {"method": "linear"}, {"sampling_rate": 0.0},
        {"speed": "fast"}, {"rotation": 0}, {"faults": "fill"}, {"tolerance": 0.6},
    ],
)  # fmt: skip
def test_unusable_options(options):
    with pytest.raises(DataError):
        resample_by_index(np.zeros(400), [0.0, 100.0, 200.0], **options)


def test_too_few_angles_are_told():
    angle = np.arange(4000) * TURN / 400
    assert any("fold" in m for m in resample_by_encoder(np.zeros(4000), angle, n=64).messages)


def test_integers_and_lists_are_taken():
    angle = (np.arange(800) * TURN / 100).tolist()
    table = resample_by_encoder(np.arange(800), angle).table
    assert table.shape == (8, 100)
    assert table[3, 7] == 307.0


@pytest.mark.slow
def test_revolutions_are_not_resampled_one_sample_at_a_time(calls):
    angle = uneven(10 * 4096 + 5000, 4096.7)
    signal = motion(angle)

    assert calls(lambda: resample_by_encoder(signal, angle, n=4096))[0] < angle.size / 20


def test_cubic_bound_needs_more_than_two_samples():
    with pytest.raises(DataError, match="more than 2"):
        cubic_interpolation_error(2.0)


# -- hostile review ------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_double_pulse_is_called_double_first(share):
    pulses = np.arange(11) * 100.0
    twice = np.sort(np.append(pulses, 400.0 + 100 * share))
    with pytest.raises(InvalidSamplesError) as caught:
        resample_by_index(np.zeros(1001), twice)
    first = str(caught.value).split(";")[0]
    assert "double" in first
    assert "4 and 5" in first
    assert "pulse 5" in first
    found = resample_by_index(np.zeros(1001), twice, faults="drop")
    assert found.revolutions.tolist() == [0, 1, 2, 3, 6, 7, 8, 9, 10]


@pytest.mark.parametrize("rate", [1000.0, 50.0])
def test_pulse_times_are_told_from_sample_numbers(rate):
    with pytest.raises(UnitError, match="sample numbers, not times"):
        resample_by_index(np.zeros(1001), np.arange(11) * 100.0 / 1000.0 * 1000.0 / rate / 50)


def test_few_samples_between_pulses_do_not_speak_of_an_angle():
    with pytest.raises(TooFewSamplesError, match="index pulses in sample numbers"):
        resample_by_index(np.zeros(101), np.arange(0, 101, 5.0))


@pytest.mark.parametrize("signal", [np.zeros(1001) + 1j, [[1.0, 2.0], [3.0]]])
def test_signal_must_be_real_numbers(signal):
    with pytest.raises(InvalidSamplesError, match="real"):
        resample_by_index(signal, np.arange(11) * 100.0)
