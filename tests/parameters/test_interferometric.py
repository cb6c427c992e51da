"""PV, RMS, PVr, PVq and PV20 against closed forms, and one file three tools agree on."""

import math

import numpy as np
import pytest

import metrosep as ms
from metrosep import Surface
from metrosep.core.errors import DataError, InvalidSamplesError, TooFewSamplesError
from metrosep.parameters.interferometric import (
    interferometric_parameters,
    robust_peak_to_valley,
    smallest_circle,
)

NM = 1e-9
EXACT = 1e-9
"""Least squares of 36 terms in double precision."""
SAMPLED_DISC = 2e-2
"""A disc of 201 pixels across: its terms are orthogonal to about one pixel of rim."""
FILE = 1e-6
"""Row I01, nine digits printed by three tools."""


def disc(function, n=201, step=1e-3):
    y, x = np.mgrid[-1 : 1 : n * 1j, -1 : 1 : n * 1j]
    r, t = np.hypot(x, y), np.arctan2(y, x)
    return Surface(np.where(r <= 1 + 1e-12, function(r, t), np.nan), step, step)


def radial_12(r):
    """Fringe term 37, of radial order 12: the first that PVr must not fit."""
    return 924 * r**12 - 2772 * r**10 + 3150 * r**8 - 1680 * r**6 + 420 * r**4 - 42 * r**2 + 1


def radial_10(r):
    """Fringe term 36, the last that it must fit."""
    return 252 * r**10 - 630 * r**8 + 560 * r**6 - 210 * r**4 + 30 * r**2 - 1


def test_sine_grid_with_a_large_piston():
    c = 50 * NM * np.cos(2 * np.pi * np.arange(500) / 100)
    table = interferometric_parameters(Surface(c[:, None] + c[None, :] + 1e-3, 1e-6, 1e-6))
    assert table["PV"].value == pytest.approx(200 * NM, rel=EXACT, abs=0.0)
    assert table["RMS"].value == pytest.approx(50 * NM, rel=EXACT, abs=0.0)
    # 25 pixels lie at the top and 25 at the bottom.
    assert table["PV20"].value == pytest.approx(200 * NM, rel=EXACT, abs=0.0)
    assert "not a disc" in table.unavailable["PVr"]
    assert {q.unit for q in table.values()} == {"m"}
    assert table.context.n_valid == 250_000


@pytest.mark.parametrize(
    "shape",
    [
        lambda r, t: 2 * r**2 - 1,
        lambda r, t: r**3 * np.cos(3 * t) + 0.3 * (3 * r**3 - 2 * r) * np.sin(t) + 5,
        lambda r, t: r**5 * np.sin(5 * t),
        lambda r, t: radial_10(r),
    ],
    ids=["power", "trefoil", "pentafoil", "last"],
)
def test_what_the_terms_hold_has_its_peak_to_valley(shape):
    surface = disc(lambda r, t: 100 * NM * shape(r, t))
    expected = np.nanmax(surface.z) - np.nanmin(surface.z)
    assert robust_peak_to_valley(surface) == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_what_the_terms_do_not_hold_counts_three_rms():
    # Orders from 12 on are orthogonal to the terms; their RMS over the disc is A / sqrt(13).
    surface = disc(lambda r, t: 100 * NM * radial_12(r))
    expected = 3 * 100 * NM / math.sqrt(13)
    assert robust_peak_to_valley(surface) == pytest.approx(expected, rel=2 * SAMPLED_DISC, abs=0.0)
    assert robust_peak_to_valley(surface) == pytest.approx(86.322 * NM, abs=5e-4 * NM)  # pvr.md
    both = disc(lambda r, t: 100 * NM * (2 * r**2 - 1) + 10 * NM * np.sign(np.sin(60 * r**2 * 9)))
    assert robust_peak_to_valley(both) == pytest.approx((200 + 30) * NM, rel=SAMPLED_DISC, abs=0.0)


def test_one_bad_pixel_moves_pv_but_not_the_robust_values():
    clean = disc(lambda r, t: 100 * NM * (2 * r**2 - 1))
    z = np.array(clean.z)
    z[100, 150] = 5000 * NM
    dirty = interferometric_parameters(Surface(z, clean.dx, clean.dy))
    assert dirty["PV"].value == pytest.approx(5100 * NM, rel=EXACT, abs=0.0)
    assert dirty["PVr"].value < 450 * NM
    assert dirty["PVq"].value == pytest.approx(200 * NM, rel=1e-2, abs=0.0)


def test_quantile_range_and_means_of_known_heights():
    z = np.arange(100_000.0).reshape(250, 400)
    table = interferometric_parameters(Surface(z), names=["PVq", "PV20"])
    assert table["PVq"].value == pytest.approx(0.999 * 99_999, rel=EXACT, abs=0.0)
    assert table["PV20"].value == pytest.approx(99_999 - 9, rel=EXACT, abs=0.0)
    assert "99.9 %" in table["PVq"].definition
    few = interferometric_parameters(Surface(z[:1, :19]), names=["PV20"])
    assert "needs 20" in few.unavailable["PV20"]


def test_quantile_range_of_gaussian_heights():
    from scipy.stats import norm

    z = norm.isf((np.arange(200_000) + 0.5) / 200_000).reshape(400, 500)
    found = interferometric_parameters(Surface(z), names=["PVq"])["PVq"].value
    assert found == pytest.approx(2 * norm.isf(0.0005), rel=1e-3, abs=0.0)


def test_disc_off_centre_in_a_larger_map_with_unequal_pixels():
    y, x = np.mgrid[:160, :300] * 1.0
    u, v = (x - 170) / 90, (y * 2 - 140) / 90
    inside = u**2 + v**2 <= 1
    z = np.where(inside, 100 * NM * (2 * (u**2 + v**2) - 1) + 7, np.nan)
    found = robust_peak_to_valley(Surface(z, 1e-3, 2e-3))
    assert found == pytest.approx(np.nanmax(z) - np.nanmin(z), rel=1e-6, abs=0.0)
    swapped = robust_peak_to_valley(Surface(z.T, 2e-3, 1e-3))
    assert swapped == pytest.approx(found, rel=EXACT, abs=0.0)
    with pytest.raises(DataError, match="not a disc"):
        robust_peak_to_valley(Surface(z, 1e-3, 1e-3))


@pytest.mark.parametrize("factor", [1e-9, -1.0, 1e6])
def test_scale_and_flip(factor, rng):
    a = disc(lambda r, t: r**3 * np.cos(t) + 0.05 * rng.normal(size=r.shape), n=81)
    one = interferometric_parameters(a)
    other = interferometric_parameters(Surface(a.z * factor, a.dx, a.dy))
    for symbol, quantity in one.items():
        assert other[symbol].value == pytest.approx(
            abs(factor) * quantity.value, rel=1e-8, abs=0.0
        )


def test_holes_are_said_and_do_not_count():
    ring = disc(lambda r, t: np.where(r > 0.6, 2 * r**2 - 1, np.nan), n=801)
    table = interferometric_parameters(ring)
    assert table["PVr"].value == pytest.approx(table["PV"].value, rel=1e-4, abs=0.0)
    assert any("64 % of the disc" in n for n in table.context.notes)


def testsmallest_circle_around_known_points(rng):
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [1.0, 1.0]])
    assert smallest_circle(square) == pytest.approx((1.0, 1.0, math.sqrt(2)), rel=EXACT, abs=0.0)
    obtuse = np.array([[-3.0, 0.0], [5.0, 0.0], [0.0, 1.0]])
    assert smallest_circle(obtuse) == pytest.approx((1.0, 0.0, 4.0), rel=EXACT, abs=0.0)
    points = rng.normal(size=(300, 2))
    x, y, r = smallest_circle(points)
    assert np.hypot(points[:, 0] - x, points[:, 1] - y).max() <= r * (1 + 1e-12)
    on = points[np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - r) < 1e-9]
    angles = np.sort(np.arctan2(on[:, 1] - y, on[:, 0] - x))
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    assert gaps.max() <= np.pi + 1e-9  # no circle moved away from all carriers can be smaller


def test_bad_input_is_named():
    with pytest.raises(InvalidSamplesError, match="none of the"):
        interferometric_parameters(Surface(np.full((9, 9), np.nan)))
    with pytest.raises(DataError, match=r"Sa .*not offered as an interferometric"):
        interferometric_parameters(disc(lambda r, t: r), names=["Sa"])
    with pytest.raises(DataError, match="sequence"):
        interferometric_parameters(disc(lambda r, t: r), names="PV")
    with pytest.raises(DataError, match="not calibrated"):
        robust_peak_to_valley(Surface(disc(lambda r, t: r).z, 1e-3))
    with pytest.raises(TooFewSamplesError, match="line or a point"):
        robust_peak_to_valley(Surface([[1.0, 2.0, 4.0]], 1e-3, 1e-3))
    constant = interferometric_parameters(Surface(np.full((30, 30), 3, dtype=int), 1.0, 1.0))
    assert constant["PV"].value == constant["RMS"].value == 0.0


def test_metropro_file(corpus):
    from metrosep.forms.conic import Plane
    from metrosep.forms.fit import fit

    surface = ms.read(corpus / "st" / "metropro-1.dat")
    raw = interferometric_parameters(surface, names=["PV", "RMS"])
    assert raw["PV"].value == pytest.approx(1363.05633 * NM, rel=FILE, abs=0.0)
    assert raw["RMS"].value == pytest.approx(75.28822 * NM, rel=FILE, abs=0.0)
    assert "No form removal" in raw.context.notes[0]
    flat = interferometric_parameters(fit(surface, Plane()).residual, names=["RMS"])
    assert flat["RMS"].value == pytest.approx(13.33498 * NM, rel=FILE, abs=0.0)
    assert flat.context.notes == ()


@pytest.mark.parametrize("call", [interferometric_parameters, robust_peak_to_valley])
@pytest.mark.parametrize("obj", [np.zeros((9, 9)), None])
def test_what_is_no_surface_is_refused(call, obj):
    with pytest.raises(DataError, match=f"needs a Surface, got {type(obj).__name__}"):
        call(obj)


@pytest.mark.parametrize("names", [[1], 1])
def test_names_that_are_no_texts_are_refused(names):
    with pytest.raises(DataError, match="names"):
        interferometric_parameters(Surface(np.eye(9), 1e-3, 1e-3), names=names)


@pytest.mark.parametrize("size", [1e-207, 1e-100, 1e100, 1e153, 1e300])
def test_heights_beyond_any_instrument_are_refused(rng, size):
    surface = Surface(rng.normal(size=(60, 60)) * size, 1e-3, 1e-3)
    with pytest.raises(DataError, match=r"range of the heights|heights reach"):
        interferometric_parameters(surface)
