"""A band taken out: what is left of waves that are planted in it, at its ends and beside it."""

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.errors import DataError, TooFewSamplesError
from metrosep.filters import band_edges, band_stop

UM, NM = 1e-6, 1e-9
DX, DY, SHAPE = 1 * UM, 1.5 * UM, (192, 256)  # 256 x 288 um

Y, X = (np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float).T * (DX, DY)[::-1]).T


def holed(kind):
    """Where nothing was measured: nowhere; a window and single pixels; outside of an aperture too."""
    hole = np.zeros(SHAPE, dtype=bool)
    if kind != "whole":
        hole[60:100, 80:140] = True
        hole |= np.random.default_rng(3).random(SHAPE) < 0.05
    if kind == "round":
        hole |= np.hypot((Y - Y.mean()) / Y.max(), (X - X.mean()) / X.max()) > 0.5
    return hole


def left_of(length, degrees, phase, hole, **band):
    """Return the amplitude that is left of a wave of amplitude 1."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    angle = 2 * np.pi / length * (c * X + s * Y) + phase
    z = np.where(hole, np.nan, np.cos(angle))
    left = band_stop(ms.Surface(z, DX, DY), **band).z
    np.testing.assert_array_equal(np.isnan(left), hole)
    known = ~hole
    basis = np.stack([np.cos(angle[known]), np.sin(angle[known])], axis=1)
    return float(np.hypot(*np.linalg.lstsq(basis, left[known], rcond=None)[0]))


@pytest.mark.parametrize("kind", ["whole", "holes", "round"])
@pytest.mark.parametrize(("short", "long"), [(12, 20), (4, 6), (15, 60), (16, 17)])
def test_waves_in_the_band_are_gone_to_its_ends_and_those_beside_its_edges_stay(kind, short, long):
    hole, band = holed(kind), {"shortest": short * UM, "longest": long * UM}
    edges = band_edges(ms.Surface(np.zeros(SHAPE), DX, DY), **band)
    for degrees, phase in ((0, 0.3), (37, 1.1), (90, 2.0), (120, 0.0)):
        for length in (edges.shortest, np.sqrt(short * long) * UM, edges.longest):
            assert left_of(length, degrees, phase, hole, **band) < 0.05, (length, degrees)
        beside = [edges.shorter, 2.6 * UM] + [edges.longer] * bool(np.isfinite(edges.longer))
        for length in beside:
            assert left_of(length, degrees, phase, hole, **band) > 0.95, (length, degrees)


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_long_waves_stay_where_single_samples_are_missing(share):
    hole = np.random.default_rng(8).random(SHAPE) < share
    band = {"shortest": 3.2 * UM, "longest": 20 * UM}
    longer = band_edges(ms.Surface(np.zeros(SHAPE), DX, DY), **band).longer
    for degrees, phase in ((0, 0.3), (37, 1.1), (90, 2.0)):
        for length in (longer, 96 * UM, 128 * UM):
            assert left_of(length, degrees, phase, hole, **band) > 0.95, (length, degrees)
        for length in (3.2 * UM, 8 * UM, 20 * UM):
            assert left_of(length, degrees, phase, hole, **band) < 0.05, (length, degrees)


def test_the_edges_are_the_resolution_of_what_was_measured():
    edges = band_edges(ms.Surface(np.zeros(SHAPE), DX, DY), shortest="12 um", longest="20 um")
    cell = 6 / (256 * UM)  # the shorter side
    assert 1 / edges.shorter == pytest.approx(1 / (12 * UM) + cell, abs=1e-6 * cell)
    assert 1 / edges.longer == pytest.approx(1 / (20 * UM) - cell, abs=1e-6 * cell)
    wide = band_edges(ms.Surface(np.zeros(SHAPE), DX, DY), shortest="12 um", longest="60 um")
    assert np.isinf(wide.longer)


@pytest.mark.parametrize("kind", ["whole", "round"])
def test_a_parabola_with_piston_of_a_millimetre_stays(kind):
    z = 1e-3 + 2e-3 * X - 1e-3 * Y + 0.4 * X**2 - 0.3 * X * Y + 0.7 * Y**2
    z = np.where(holed(kind), np.nan, z)
    left = band_stop(ms.Surface(z, DX, DY), shortest=12 * UM, longest=20 * UM)
    # rounding of 1 mm in 64 bit is 0.0002 nm, of the fit some of that
    np.testing.assert_allclose(left.z, z, rtol=0.0, atol=0.01 * NM)


@pytest.mark.parametrize("wave", [20, 31, 50])
def test_a_profile_loses_its_band_and_keeps_the_wave_beside_it(wave):
    x = np.arange(1000) * UM
    mark = 20 * NM * np.sin(2 * np.pi * x / (wave * UM) + 0.4)
    part = 60 * NM * np.sin(2 * np.pi * x / (5.3 * UM))
    left = band_stop(ms.Profile(x, mark + part), shortest="20 um", longest="50 um")
    basis = np.stack(
        [f(2 * np.pi * x / v) for v in (wave * UM, 5.3 * UM) for f in (np.sin, np.cos)], axis=1
    )
    found = np.linalg.lstsq(basis, left.z, rcond=None)[0]
    assert np.hypot(found[0], found[1]) < 0.05 * 20 * NM
    assert found[2] == pytest.approx(60 * NM, abs=0.01 * 60 * NM)
    assert left.history[-1].parameters["longest_m"] == pytest.approx(50 * UM, abs=1e-15)


@pytest.mark.parametrize(
    ("short", "long", "match"),
    [
        (20 * UM, 12 * UM, "must be shorter than"),
        (12 * UM, 65 * UM, "more than a quarter of what was measured, 64 um"),
        (3 * UM, 20 * UM, "does not exceed two steps, 3 um"),
        (0.0, 20 * UM, "positive"),
        ("12 s", 20 * UM, "length"),
    ],
)
def test_what_is_no_band_is_refused(short, long, match):
    with pytest.raises(DataError, match=match):
        band_stop(ms.Surface(np.zeros(SHAPE), DX, DY), shortest=short, longest=long)


def test_a_map_without_steps_or_without_heights_is_refused():
    with pytest.raises(DataError, match="no lateral step"):
        band_stop(ms.Surface(np.zeros(SHAPE)), shortest=12 * UM, longest=20 * UM)
    with pytest.raises(TooFewSamplesError, match="nothing was measured"):
        band_stop(ms.Surface(np.full(SHAPE, np.nan), DX, DY), shortest=12 * UM, longest=20 * UM)
