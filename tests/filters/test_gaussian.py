"""Gaussian filter of profiles: closed forms, a sum written out here, invariances, bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest

from metrosep.core.errors import (
    DataError,
    InvalidSamplesError,
    NotUniformError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.core.surface import Surface
from metrosep.filters._arguments import DoubleFilterError, profile_kind
from metrosep.filters.gaussian import gaussian, gaussian_support
from metrosep.spectral.dft import Band

UM = 1e-6
NM = 1e-9
GAIN = 2e-4
"""Acceptance row F01: projection over a window that is not a whole number of waves."""

ROUNDING = 1e-14
"""Relative to the largest height: some operations of 2e-16 each."""

WINDOW_TAIL = 1e-10
"""The filter leaves out 3e-12 of the weight; gaps magnify it by 1 / support."""


def _cosine(wavelength: float, n: int = 2001, dx: float = 0.5 * UM) -> Profile:
    x = np.arange(n) * dx
    return Profile(x, np.cos(2.0 * np.pi * x / wavelength))


def _gain(result: Profile, source: Profile) -> float:
    middle = slice(len(source) // 4, 3 * len(source) // 4)
    return float(result.z[middle] @ source.z[middle] / (source.z[middle] @ source.z[middle]))


def _written_out(x: np.ndarray, z: np.ndarray, cutoff: float, order: int) -> np.ndarray:
    """Local regression, point by point, with the weighting function as in ISO 16610-21."""
    a = math.sqrt(math.log(2.0) / math.pi)
    out = np.empty(x.size)
    valid = ~np.isnan(z)
    for i in range(x.size):
        u = (x - x[i])[valid] / cutoff
        root = np.sqrt(np.exp(-math.pi * (u / a) ** 2))
        design = np.column_stack([np.ones(u.size), u])[:, : order + 1]
        out[i] = np.linalg.lstsq(design * root[:, None], z[valid] * root, rcond=None)[0][0]
    return out


@pytest.mark.parametrize(("wavelength", "gain"), [(40, 0.0625), (80, 0.5), (160, 0.8408964)])
def test_transmission_of_a_cosine(wavelength: float, gain: float) -> None:
    """Acceptance F01, ISO 16610-21: 2^-(Lc / L)^2."""
    wave = _cosine(wavelength * UM)

    assert _gain(gaussian(wave, cutoff=80 * UM), wave) == pytest.approx(gain, abs=GAIN)
    assert _gain(gaussian(wave, cutoff=80 * UM, band="short"), wave) == pytest.approx(
        1.0 - gain, abs=GAIN
    )


@pytest.mark.parametrize("end", ["moment", "cut"])
def test_tilt_and_constant_pass_unchanged_over_the_whole_length(end: str) -> None:
    """Acceptance F03, ISO 16610-28."""
    x = np.arange(2001) * 0.5 * UM
    for z in (1e-3 * x, np.full(x.size, 3.7 * UM), 5.0 - 2e-3 * x):
        low = gaussian(Profile(x, z), cutoff=80 * UM, end=end)
        kept = np.isin(x, low.x)

        assert np.abs(low.z - z[kept]).max() <= ROUNDING * np.abs(z).max()


def test_tilt_stays_exact_beside_gaps_and_inside_them() -> None:
    x = np.arange(1000) * UM
    z = 1e-3 * x - 2e-4
    holes = z.copy()
    holes[300:360] = np.nan
    holes[np.random.default_rng(1).random(x.size) < 0.1] = np.nan
    low = gaussian(Profile(x, holes), cutoff=100 * UM, fill=True, min_support=0.05)

    assert low.n_invalid == 0
    assert np.abs(low.z - z).max() <= ROUNDING * np.abs(z).max()


def test_a_level_of_a_metre_costs_no_digits() -> None:
    """The heights are multiples of 2^-40 m, so that adding 1 m is exact."""
    rng = np.random.default_rng(2)
    z = rng.integers(-1000, 1000, 800) * 2.0**-40
    x = np.arange(800) * UM
    low = gaussian(Profile(x, z), cutoff=80 * UM).z
    high = gaussian(Profile(x, z + 1.0), cutoff=80 * UM).z

    assert np.abs(high - 1.0 - low).max() <= 4e-16


def test_renormalised_weights_bend_a_trend_at_the_end() -> None:
    """Half a Gaussian has its centre at sd sqrt(2 / pi) = 0.1495 Lc (spec 2.6: 0.148).

    The sum begins with the whole weight of the end sample instead of half of it, which draws the
    centre nearer by 1 / (1 + dx / (sd sqrt(2 pi))).
    """
    x = np.arange(2001) * 0.5 * UM
    cutoff, slope = 80 * UM, 1e-3
    low = gaussian(Profile(x, slope * x), cutoff=cutoff, end="renormalise")
    bend = float(low.z[0]) / (slope * cutoff)

    sd = math.sqrt(math.log(2.0)) / (math.pi * math.sqrt(2.0)) * 160.0  # in samples
    centre = math.sqrt(math.log(2.0) / math.pi**3) / (1.0 + 1.0 / (sd * math.sqrt(2.0 * math.pi)))

    assert bend == pytest.approx(centre, rel=1e-3, abs=0.0)


def test_complete_windows_do_not_depend_on_the_end_rule() -> None:
    rng = np.random.default_rng(3)
    p = Profile(np.arange(1500) * UM, rng.normal(size=1500) * NM)
    results = {e: gaussian(p, cutoff=80 * UM, end=e) for e in ("moment", "renormalise", "cut")}
    inner = slice(120, -120)

    assert np.abs(results["moment"].z - results["renormalise"].z)[inner].max() < WINDOW_TAIL * NM
    assert len(results["cut"]) == 1500 - 2 * 80
    assert results["cut"].x[0] == p.x[80]
    assert np.array_equal(results["cut"].z, results["moment"].z[80:-80])


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize("cutoff", [3.0, 16.0, 110.0])
@pytest.mark.parametrize("gaps", [False, True])
def test_agrees_with_the_regression_written_out(order: int, cutoff: float, gaps: bool) -> None:
    rng = np.random.default_rng(4)
    x = np.arange(300.0) * UM
    z = rng.normal(size=300)
    if gaps:
        z[40:90] = np.nan
        z[rng.random(300) < 0.1] = np.nan
    end = "moment" if order else "renormalise"
    low = gaussian(Profile(x, z), cutoff=cutoff * UM, end=end, min_support=0.01)
    truth = _written_out(x, z, cutoff * UM, order)

    assert np.array_equal(np.isnan(low.z), np.isnan(z))
    assert np.nanmax(np.abs(low.z - truth)) < WINDOW_TAIL


def test_long_profile_in_blocks_equals_the_sum() -> None:
    """Longer than one block of the transforms: 8192 samples."""
    rng = np.random.default_rng(5)
    z = rng.normal(size=30_000)
    low = gaussian(Profile(np.arange(z.size) * UM, z), cutoff=60 * UM).z
    sd = math.sqrt(math.log(2.0)) / (math.pi * math.sqrt(2.0)) * 60.0
    u = np.arange(-150, 151)
    weights = np.exp(-0.5 * (u / sd) ** 2)
    truth = np.convolve(z, weights / weights.sum(), mode="valid")

    assert np.abs(low[150:-150] - truth).max() < WINDOW_TAIL


def test_long_profile_with_a_gap_equals_its_parts() -> None:
    """Blocks with gaps take another way than blocks without."""
    z = np.random.default_rng(6).normal(size=30_000)
    x = np.arange(z.size) * UM
    whole = gaussian(Profile(x, z), cutoff=60 * UM).z
    z[14_990:15_010] = np.nan
    holed = gaussian(Profile(x, z), cutoff=60 * UM).z
    far = np.abs(np.arange(z.size) - 15_000) > 100

    assert np.abs(holed - whole)[far].max() < WINDOW_TAIL


@pytest.mark.parametrize("harmonic", [1, 5, 15, 50, 150, 300])
def test_closed_transmission_of_each_harmonic(harmonic: int) -> None:
    """Acceptance F07, ISO 16610-21 closed: 2^-(f / fc)^2."""
    t = 2.0 * np.pi * np.arange(720) / 720
    wave = Profile(t, 3.0 + 1e-6 * np.cos(harmonic * t + 0.3))
    low = gaussian(wave, upr=15, end="closed")
    gain = 2.0 ** -((harmonic / 15.0) ** 2)

    assert np.abs(low.z - 3.0 - gain * (wave.z - 3.0)).max() < 2e-15


def test_closed_cutoff_may_be_an_arc_or_a_count() -> None:
    arc = np.arange(360) * 0.1e-3
    p = Profile(arc, np.random.default_rng(7).normal(size=360))
    by_count = gaussian(p, upr=50, end="closed")
    by_length = gaussian(p, cutoff=36e-3 / 50, end="closed")

    assert np.abs(by_count.z - by_length.z).max() < ROUNDING


def test_closed_rotates_with_the_profile_and_keeps_constants_beside_gaps() -> None:
    t = 2.0 * np.pi * np.arange(720) / 720
    z = np.random.default_rng(8).normal(size=720)
    z[5:20] = np.nan
    low = gaussian(Profile(t, z), upr=15, end="closed", fill=True).z
    turned = gaussian(Profile(t, np.roll(z, 100)), upr=15, end="closed", fill=True).z
    flat = gaussian(Profile(t, np.where(np.isnan(z), np.nan, 7.0)), upr=15, end="closed").z

    assert np.abs(turned - np.roll(low, 100)).max() < ROUNDING * 10
    assert np.array_equal(np.isnan(flat), np.isnan(z))
    assert np.nanmax(np.abs(flat - 7.0)) == 0.0


def test_closed_profile_that_repeats_its_first_sample_is_refused() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 721)
    with pytest.raises(InvalidSamplesError, match="drop the last sample"):
        gaussian(Profile(t, np.cos(t)), upr=15, end="closed")


def test_band_is_an_s_filter_and_then_an_l_filter() -> None:
    x = np.arange(4000) * 0.5 * UM
    waves = {w: Profile(x, np.cos(2 * np.pi * x / (w * UM))) for w in (10, 50, 400)}
    for w, p in waves.items():
        result = gaussian(p, band=Band(20 * UM, 200 * UM))
        gain = 2.0 ** -((20 / w) ** 2) * (1.0 - 2.0 ** -((200 / w) ** 2))
        assert _gain(result, p) == pytest.approx(gain, abs=1e-3)
        assert profile_kind(result) == "R"
        assert [s.parameters["cutoff_m"] for s in result.history] == [20 * UM, 200 * UM]
    p = waves[50]
    only_s = gaussian(p, band=Band(shortest=20 * UM))
    only_l = gaussian(p, band=Band(longest=200 * UM))
    assert np.array_equal(only_s.z, gaussian(p, cutoff=20 * UM).z)
    assert np.array_equal(only_l.z, gaussian(p, cutoff=200 * UM, band="short").z)


def test_long_and_short_add_up_and_the_input_is_kept() -> None:
    p = Profile(np.arange(500) * UM, np.random.default_rng(9).normal(size=500))
    before = p.z.copy()
    total = gaussian(p, cutoff=50 * UM).z + gaussian(p, cutoff=50 * UM, band="short").z

    assert np.abs(total - p.z).max() < ROUNDING
    assert np.array_equal(p.z, before)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1e3])
def test_units_flip_and_mirror(scale: float) -> None:
    rng = np.random.default_rng(10)
    z = rng.normal(size=400)
    z[100:120] = np.nan
    x = np.arange(400) * 1.0
    low = gaussian(Profile(x, z), cutoff=50.0).z
    scaled = gaussian(Profile(x * scale, z * scale), cutoff=50.0 * scale).z / scale
    flipped = -gaussian(Profile(x, -z), cutoff=50.0).z
    mirrored = gaussian(Profile(x, z[::-1]), cutoff=50.0).z[::-1]
    shifted = gaussian(Profile(x + 7.0, z + 2.0), cutoff=50.0).z - 2.0

    for other in (scaled, flipped, mirrored, shifted):
        assert np.nanmax(np.abs(other - low)) < 10 * ROUNDING


def test_rim_that_was_not_measured_changes_nothing() -> None:
    z = np.random.default_rng(11).normal(size=300)
    x = np.arange(300) * UM
    padded = np.concatenate([np.full(40, np.nan), z, np.full(9, np.nan)])
    low = gaussian(Profile(np.arange(349) * UM, padded), cutoff=50 * UM, fill=True).z

    assert np.isnan(low[:40]).all()
    assert np.isnan(low[-9:]).all()
    assert np.nanmax(np.abs(low[40:-9] - gaussian(Profile(x, z), cutoff=50 * UM).z)) < ROUNDING


def test_support_is_the_share_of_weight_on_measured_samples() -> None:
    z = np.zeros(400)
    z[200:] = np.nan
    support = gaussian_support(Profile(np.arange(400) * UM, z), cutoff=60 * UM)
    sd = math.sqrt(math.log(2.0)) / (math.pi * math.sqrt(2.0)) * 60.0
    # half a step beyond the middle between samples the share is the normal integral
    truth = 0.5 * math.erfc((0.5 + 10) / sd / math.sqrt(2.0))

    assert support.metadata["quantity"] == "support"
    assert support.n_invalid == 0
    assert float(support.z[210]) == pytest.approx(truth, abs=1e-4)
    assert float(support.z[100]) == pytest.approx(1.0, abs=1e-11)


def test_low_support_is_reported_and_not_trusted() -> None:
    z = np.full(1000, np.nan)
    z[:300] = 0.0
    z[400] = 50.0
    p = Profile(np.arange(1000) * UM, z)

    assert np.isnan(gaussian(p, cutoff=100 * UM).z[400])
    assert gaussian(p, cutoff=100 * UM, min_support=0.01).z[400] == pytest.approx(50.0, abs=5.0)


def test_isolated_sample_without_neighbours_gives_itself() -> None:
    """No slope is fitted through one sample: order 0 takes over."""
    z = np.full(400, np.nan)
    z[[0, 200, 399]] = 1.0, 5.0, 2.0
    low = gaussian(Profile(np.arange(400) * UM, z), cutoff=10 * UM, min_support=0.01)

    assert low.z[200] == pytest.approx(5.0, abs=1e-9)


def test_kind_and_history() -> None:
    p = Profile(np.arange(300) * UM, np.zeros(300), metadata={"profile_kind": "P", "part": "7"})
    long, short = (gaussian(p, cutoff=50 * UM, band=b) for b in ("long", "short"))

    assert (profile_kind(long), profile_kind(short)) == ("P", "R")
    assert short.metadata["part"] == "7"
    assert short.history[-1].parameters["cutoff_m"] == 50 * UM
    for band in ("long", "short"):
        with pytest.raises(DoubleFilterError, match="roughness profile already"):
            gaussian(short, cutoff=50 * UM, band=band)
    assert profile_kind(gaussian(short, cutoff=50 * UM, band="short", refilter=True)) == "R"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nesting_index": 50 * UM}, "nesting_index is for surfaces"),
        ({}, "needs cutoff="),
        ({"cutoff": 2.0 * UM}, "sampling limit"),
        ({"cutoff": 301 * UM}, "longer than"),
        ({"cutoff": -1.0}, "positive and finite"),
        ({"cutoff": float("nan")}, "positive and finite"),
        ({"cutoff": 50 * UM, "band": "mid"}, "band is one of"),
        ({"cutoff": 50 * UM, "end": "mirror"}, "end is one of"),
        ({"cutoff": 50 * UM, "upr": 15}, "closed"),
        ({"cutoff": 50 * UM, "upr": 15, "end": "closed"}, "not both"),
        ({"upr": 0.5, "end": "closed"}, "at least 1"),
        ({"cutoff": 50 * UM, "band": Band(5 * UM, 50 * UM)}, "holds the cut-offs"),
        ({"band": Band()}, "open on both sides"),
        ({"cutoff": 50 * UM, "min_support": 0.0}, "min_support"),
        ({"cutoff": 160 * UM, "end": "cut"}, "leaves 0 samples"),
    ],
)
def test_bad_options(options: dict[str, object], message: str) -> None:
    p = Profile(np.arange(300) * UM, np.zeros(300))
    with pytest.raises(DataError, match=message):
        gaussian(p, **options)


def test_bad_profiles() -> None:
    x = np.arange(300) * UM
    with pytest.raises(TooFewSamplesError, match="measured samples"):
        gaussian(Profile(x, np.full(300, np.nan)), cutoff=50 * UM)
    with pytest.raises(DataError):
        gaussian(Profile([0.0], [1.0]), cutoff=50 * UM)
    with pytest.raises(NotUniformError):
        gaussian(Profile(x**2, x), cutoff=50 * UM)
    sparse = np.full(300, np.nan)
    sparse[::100] = 1.0
    with pytest.raises(TooFewSamplesError, match="lower min_support"):
        gaussian(Profile(x, sparse), cutoff=100 * UM)


def test_integers_and_a_cutoff_of_the_whole_length_are_taken() -> None:
    p = Profile(np.arange(100), np.arange(100) % 7)
    low = gaussian(p, cutoff=100)

    assert np.isfinite(low.z).all()


@pytest.mark.parametrize("filtered", [gaussian, gaussian_support])
@pytest.mark.parametrize("start", [0.0, -math.pi, 1.0])
def test_closed_by_cutoff_that_repeats_its_first_sample_is_refused(filtered, start: float) -> None:
    """As with upr=: the closed period n dx would be one step longer than the turn."""
    t = np.linspace(start, start + 2.0 * np.pi, 721)
    with pytest.raises(InvalidSamplesError, match="drop the last sample"):
        filtered(Profile(t, np.cos(t)), cutoff=0.4, end="closed")
    assert len(filtered(Profile(t[:-1], np.cos(t[:-1])), cutoff=0.4, end="closed")) == 720
    assert len(filtered(Profile(t, np.cos(t)), cutoff=0.4)) == 721


def test_waviness_stays_waviness_in_both_bands() -> None:
    p = Profile(np.arange(300) * UM, np.zeros(300), metadata={"profile_kind": "W"})

    for band in ("long", "short"):
        assert profile_kind(gaussian(p, cutoff=50 * UM, band=band)) == "W"


def test_surface_is_not_filtered_short_twice() -> None:
    """A surface has no kind; its history says that the waviness is out already."""
    s = Surface(np.random.default_rng(12).normal(size=(40, 40)), UM, UM)
    for first in ("short", Band(5 * UM, 20 * UM)):
        index = {"nesting_index": 20 * UM} if first == "short" else {}
        rough = gaussian(s, band=first, **index)
        with pytest.raises(
            DoubleFilterError, match=r"refilter=True in Python does it all the same"
        ):
            gaussian(rough, nesting_index=20 * UM, band="short")
        with pytest.raises(DoubleFilterError, match="gaussian"):
            gaussian(rough, band=Band(5 * UM, 20 * UM))
        again = gaussian(rough, nesting_index=20 * UM, band="short", refilter=True)
        assert again.shape == (40, 40)
        # an S-filter after the L-filter takes another part away
        assert gaussian(rough, nesting_index=5 * UM).shape == (40, 40)
    long = gaussian(s, nesting_index=5 * UM)
    assert gaussian(long, nesting_index=20 * UM, band="short").shape == (40, 40)


@pytest.mark.parametrize("filtered", [gaussian, gaussian_support])
@pytest.mark.parametrize("obj", [np.zeros(300), [0.0] * 300, None])
def test_what_is_no_profile_and_no_surface_is_refused(filtered, obj: object) -> None:
    with pytest.raises(DataError, match="needs a Profile or Surface, got"):
        filtered(obj, cutoff=50 * UM)


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"upr": "a", "end": "closed"}, "upr"),
        ({"cutoff": 50 * UM, "min_support": "a"}, "min_support"),
        ({"cutoff": "a"}, "cutoff"),
        ({"cutoff": True}, "cutoff"),
    ],
)
def test_options_that_are_no_numbers_are_refused(options: dict[str, object], match: str) -> None:
    with pytest.raises(DataError, match=match):
        gaussian(Profile(np.arange(300) * UM, np.zeros(300)), **options)
