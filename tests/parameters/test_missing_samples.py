"""Dropouts and missing rows: what a finer measurement would give, or a sentence that it cannot be given."""

import math

import numpy as np
import pytest

import metrosep as ms
from metrosep.parameters import areal_parameters, profile_parameters

UM = 1e-6
WAVE = 40 * UM
STEP = 0.5 * UM
DIRECTION = math.atan2(1 / 40, 1 / 25)  # rad: of the wave of `waves`, from +x
OF_ANGLE = math.radians(0.5)  # two bins of the angular spectrum
ROUNDING = 1e-12  # relative: the same samples in another array


def sine(n=4000, amplitude=60e-9):
    """Two waves, so that hills differ: 40 um, and 1 % of a slow one."""
    x = np.arange(n) * STEP
    return x, amplitude * np.sin(2 * np.pi * x / WAVE + 0.3) * (
        1 + 0.01 * np.sin(2 * np.pi * x / 470e-6)
    )


def waves(n=200):
    """A wave whose lay is at an angle, on a map of n x n pixels of 1 um."""
    y, x = np.mgrid[:n, :n] * UM
    return 60e-9 * np.cos(2 * np.pi * (x / (25 * UM) + y / (40 * UM)) + 0.4)


def without(z, share, seed):
    return np.where(np.random.default_rng(seed).random(z.shape) < share, np.nan, z)


@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
@pytest.mark.parametrize("edition", ["ISO 21920-2:2021", "ISO 4287:1997"])
def test_dropouts_do_not_shorten_elements(share, edition):
    """With 5 % missing RSm was half the wavelength: long portions are hit more often than short ones."""
    x, z = sine()
    table = profile_parameters(
        ms.Profile(x, without(z, share, 7)), kind="R", sections=5, edition=edition
    )

    symbol = "Rsm" if edition.endswith("2021") else "RSm"
    assert table[symbol].value == pytest.approx(WAVE, abs=2e-3 * WAVE)
    assert table["Rc"].value == pytest.approx(120e-9, abs=1.5e-9)  # 1 % of the slow wave
    assert any("filled to find peaks, pits and elements" in n for n in table.context.notes)


def test_dropouts_hide_and_make_no_peaks():
    """One peak and one pit per wave, over the length that was measured."""
    x, z = sine()
    for seed in (1, 2, 3):
        table = profile_parameters(ms.Profile(x, without(z, 0.2, seed)), kind="R", sections=5)
        for symbol in ("Rpd", "Rvd"):
            # 50 waves; one at each end may be open
            assert 48 <= table[symbol].value * 4000 * STEP <= 51
        assert table["RzJIS"].value == pytest.approx(120e-9, abs=2e-9)


@pytest.mark.parametrize("period", [6.3, 12.0, math.inf])
def test_what_is_filled_makes_no_height_up(period):
    """Gaps of up to 7 samples in short waves of 60 nm, or in noise: R5p was 236 nm, above all that was measured."""
    rng = np.random.default_rng(11)
    n = np.arange(4000)
    z = (
        60e-9 * np.sin(2 * np.pi * n / period)
        if math.isfinite(period)
        else rng.normal(size=4000) * 50e-9
    )
    for k in rng.choice(3900, 60, replace=False):
        z[k + 20 : k + 20 + rng.integers(1, 8)] = np.nan
    table = profile_parameters(ms.Profile(n * STEP, z), kind="R", sections=5)
    for symbol, most in (
        ("R5p", np.nanmax(z)),
        ("R5v", -np.nanmin(z)),
        ("RzJIS", np.nanmax(z) - np.nanmin(z)),
    ):
        assert (
            table[symbol].value <= most + 1e-12
        )  # the mean line of a section moves by nothing: not centred
    assert table["R3z"].value <= np.nanmax(z) - np.nanmin(z) + 1e-12


def test_a_long_gap_is_no_length_that_was_measured():
    x, z = sine()
    z[1000:3000] = np.nan
    table = profile_parameters(ms.Profile(x, z), kind="R", sections=1)

    assert table["Rpd"].value == pytest.approx(1 / WAVE, abs=0.1 / WAVE)  # 24 or 25 of 25
    assert any("wide ones more than of narrow ones" in n for n in table.context.notes)


def test_developed_length_goes_with_its_ratio():
    """Rdr = Rdl / le - 1, whatever is missing."""
    x, z = sine(amplitude=4 * UM)
    whole = profile_parameters(ms.Profile(x, z), kind="R")
    gaps = without(z, 0.1, 3)
    gaps[[0, -1]] = z[[0, -1]]  # the length stays what it is
    table = profile_parameters(ms.Profile(x, gaps), kind="R")
    le = x[-1]

    polygon = np.hypot(np.diff(x), np.diff(z)).sum()
    assert whole["Rdl"].value == pytest.approx(polygon, abs=ROUNDING * polygon)
    assert table["Rdl"].value / le - 1 == pytest.approx(table["Rdr"].value, abs=1e-9)
    # 10 % of the steps are not there: the mean of their lengths is known to 1e-3
    assert table["Rdl"].value == pytest.approx(polygon, abs=2e-3 * polygon)


@pytest.mark.parametrize(("rows", "columns"), [(2, 1), (1, 2), (3, 2)])
def test_a_map_of_which_rows_were_left_out_is_one_of_larger_steps(rows, columns):
    """Std was 1.65 rad instead of 0.56 with every other row missing, and nothing was said."""
    z = np.full((200, 200), np.nan)
    z[1::rows, 1::columns] = waves()[1::rows, 1::columns]
    thinned = ms.Surface(waves()[1::rows, 1::columns], columns * UM, rows * UM)
    table = areal_parameters(ms.Surface(z, UM, UM))
    expected = areal_parameters(thinned)

    assert table["Std"].value == pytest.approx(DIRECTION, abs=OF_ANGLE)
    assert table["Ssw"].value == pytest.approx(1 / math.hypot(1 / 25, 1 / 40) * UM, abs=0.2 * UM)
    assert list(table) == list(expected)
    for symbol in table:
        size = abs(expected[symbol].value)
        assert table[symbol].value == pytest.approx(expected[symbol].value, abs=1e-9 * size)
    assert any("the map is evaluated at these steps" in n for n in table.context.notes)
    assert table.context.valid_share == pytest.approx(1 / rows / columns, abs=0.01)


def test_every_other_sample_of_a_profile():
    x, z = sine()
    z[1::2] = np.nan
    table = profile_parameters(ms.Profile(x, z), kind="R", sections=5)

    assert table["Rsw"].value == pytest.approx(WAVE, abs=1e-3 * WAVE)
    # of a cosine: the lag at which it is 0.2
    assert table["Rsal"].value == pytest.approx(
        math.acos(0.2) / (2 * math.pi) * WAVE, abs=5e-3 * WAVE
    )
    slope = 60e-9 * 2 * math.pi / WAVE / math.sqrt(2)
    assert table["Rdq"].value == pytest.approx(slope, abs=2e-3 * slope)
    assert table.context.settings["dx_m"] == pytest.approx(2 * STEP, abs=1e-12)
    assert any("One sample in 2" in n for n in table.context.notes)
    assert table.context.valid_share == pytest.approx(0.5, abs=1e-3)


def test_lags_that_are_not_known_are_said():
    """Of a chessboard no lag to a neighbour is known; of a profile in pairs none of 2 to 8 samples."""
    z = waves()
    z[np.indices(z.shape).sum(axis=0) % 2 == 1] = np.nan
    assert "missing in a pattern" in areal_parameters(ms.Surface(z, UM, UM)).unavailable["Sal"]

    x, y = sine()
    y[np.arange(4000) % 10 > 1] = np.nan
    reason = profile_parameters(ms.Profile(x, y), kind="R").unavailable["Rsal"]
    assert "not known at a lag of 2 samples" in reason


def test_fewer_than_five_peaks_are_named():
    x, z = sine(n=320)  # four waves
    notes = profile_parameters(ms.Profile(x, z), kind="R", sections=1, names=["R5p"]).context.notes
    assert any("stands for that of five" in n for n in notes)
